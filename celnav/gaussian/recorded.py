"""Versions for traced numbers, which have no values yet, of the kernels of `celnav.gaussian.linalg`
that branch on values.

They accept one matrix, because a recorded step has no axis of runs. An entry that is the constant 0
emits no operations.
"""

from __future__ import annotations

from functools import cache
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np

from celnav.tape.numbers import LONG_PRODUCT, TracedArray, each_row, tape_of, traced
from celnav.tape.routine import Loop, LoopBody, LoopRecorder
from celnav.tape.tape import TracedScalar, emit, total

Array = Any
SUMS = 4
LONG = 20_000
"""Number of operations above which a factorization is compiled as a loop. A loop runs a third
slower, but its compilation time does not grow.
"""
LONG_SOLUTION = 10_000
"""The same limit for a triangular system."""
SMALLEST = 1e-290  # below this square of its norm the rest of a row is treated as zero


def present(x: Array) -> Array:
    """Mask of the components that were measured (are not nan).

    Only inputs of an epoch may be missing. If a model returns nan, the run fails, and numpy repeats
    it.
    """

    def is_present(v: Any) -> Any:
        return emit("eq", v, v) if type(v) is not TracedScalar or v.tape.absent[v.i] else True

    return traced(np.array([is_present(v) for v in x.flat], object).reshape(x.shape))


def _zero(x: Any) -> bool:
    return isinstance(x, float) and x == 0.0


def _product(a: list[Any], b: list[Any]) -> Any:
    """Inner product of two rows in `SUMS` partial sums, so that additions run in parallel."""
    return total(
        total(emit("mul", x, y) for x, y in zip(a[k::SUMS], b[k::SUMS], strict=True))
        for k in range(SUMS)
    )


class Mirror(NamedTuple):
    """A reflection that maps a row ``(a, rest)`` to ``(length, 0, ...)``; ``there``: whether the
    rest differs from zero (the constant False if there is no rest).
    """

    a: Any
    rest: list[Any]
    length: Any
    inverse: Any
    scale: Any
    there: Any


def _mirror(a: Any, rest: list[Any]) -> Mirror:
    """Householder reflection ``I - v v' / (length (length - a))`` of a row.

    v is the row with ``a - length`` as its first entry. For a > 0 that is ``-s / (length + a)``,
    which does not cancel; s is the square of the rest.
    """
    if not rest:
        return Mirror(a, rest, emit("abs", a), 0.0, 0.0, False)
    s = _product(rest, rest)
    length = emit("sqrt", s if _zero(a) else emit("add", s, emit("mul", a, a)))
    has_rest = emit("lt", SMALLEST, emit("mul", length, length) if _zero(a) else s)
    inverse = emit("div", 1.0, length)
    if _zero(a):
        return Mirror(a, rest, length, inverse, inverse, has_rest)
    # a > 0: length - a = s / (length + a); else length - a = length + |a|.
    grown, positive = emit("add", length, emit("abs", a)), emit("lt", 0.0, a)
    scale = emit("div", emit("select", positive, grown, 1.0), emit("select", positive, s, grown))
    return Mirror(a, rest, length, inverse, scale, has_rest)


def _reflected(mirror: Mirror, along: Any, rest: list[Any]) -> tuple[Any, list[Any]]:
    """Reflect another row ``(along, rest)``: its new first entry and its new rest."""
    turned = emit("mul", emit("copysign", 1.0, mirror.a), along)
    if mirror.there is False:
        return turned, rest
    across = _product(rest, mirror.rest)
    inner = (
        across
        if _zero(mirror.a) or _zero(along)
        else emit("add", across, emit("mul", mirror.a, along))
    )
    # (x, y)' -> (inner / length, y - d rest) with d = (across / (length - a) - x) / length.
    d = emit("mul", emit("sub", emit("mul", across, mirror.scale), along), mirror.inverse)
    first = emit("select", mirror.there, emit("mul", inner, mirror.inverse), turned)
    if _zero(d):
        return first, rest
    d = emit("select", mirror.there, d, 0.0)
    return first, [
        emit("sub", x, emit("mul", d, y)) for x, y in zip(rest, mirror.rest, strict=True)
    ]


def outer(A: Array) -> Array:
    """``A @ A.mT``, each product computed once for both triangles; a loop if there are many."""
    if not any(isinstance(x, TracedScalar) for x in A.flat):  # other objects, such as decimals
        return A @ A.mT
    n, q = A.shape
    rows = [[A[i, j] for j in range(q)] for i in range(n)]
    full: Array = np.array([[not _zero(x) for x in row] for row in rows], float)
    # One product and one sum for each pair of entries that are not zero.
    if (full @ full.T).sum() >= LONG_PRODUCT:
        return A @ A.mT
    P = TracedArray((n, n))
    for i in range(n):
        for j in range(i + 1):
            P[i, j] = P[j, i] = total(map(emit, repeat("mul"), rows[i], rows[j]))
    return P


def tria(A: Array) -> Array:
    """Lower root with a diagonal that is not negative, by Householder reflections
    [Golub1996, Sec. 5.1].
    """
    n, q = A.shape
    # Constant zeros stay the float 0.0, so that they emit no operation.
    rows = [[A[i, j] for j in range(q)] + [0.0] * max(n - q, 0) for i in range(n)]
    tape, L = tape_of(A), TracedArray((n, n))
    if (
        tape is not None
        and tape.rolled
        and 4 * sum((n - i) * max(q - i, 0) for i in range(n)) >= LONG
    ):
        routine, positions = _rolled(tuple(tuple(not _zero(x) for x in row) for row in rows))
        for at, x in zip(positions, routine(tape, (x for row in rows for x in row)), strict=True):
            L[at] = x
        return L
    for i in range(n):
        rest = [j for j in range(i + 1, len(rows[i])) if not _zero(rows[i][j])]
        mirror = _mirror(rows[i][i], [rows[i][j] for j in rest])
        L[i, i] = mirror.length
        for r in range(i + 1, n):
            L[r, i], moved = _reflected(mirror, rows[r][i], [rows[r][j] for j in rest])
            for j, x in zip(rest, moved, strict=True):
                rows[r][j] = x
    return L


@cache
def _rolled(nonzero: tuple[tuple[bool, ...], ...]) -> tuple[Loop, list[tuple[int, int]]]:
    """`tria` as loops over rows, and the positions in L that it fills.

    nonzero: mask of the entries that are not the constant 0.
    """
    n, q = len(nonzero), len(nonzero[0])
    full: Array = np.array(nonzero)
    stages, positions = list[LoopBody](), list[tuple[int, int]]()
    # Memory: the rows (n, q), then L (n, n) from root_at, then the three numbers of a mirror.
    root_at, mirror_at = n * q, n * q + n * n
    for i in range(n):
        rest, below = i + 1 + np.flatnonzero(full[i, i + 1 :]), np.any(full[i + 1 :], axis=0)
        pivot = {"pivot": (i * q, 0), "mirror": (mirror_at, 0)}

        def row(
            stage: LoopRecorder, place: str, which: Array, i: int = i, rest: Array = rest
        ) -> tuple[Any, list[Any]]:
            first, *others = (
                stage.take(place, j) if which[j] else 0.0 for j in (i, *rest.tolist())
            )
            return first, others

        # First the pivot row i, which defines the reflection.
        stage = LoopRecorder(1, left=(root_at + i * n + i, 0), **pivot)
        mirror = _mirror(*row(stage, "pivot", full[i]))
        stage.put("left", 0, mirror.length)
        for k, x in enumerate((mirror.inverse, mirror.scale, mirror.there)):
            stage.put("mirror", k, x)
        stages.append(stage.stage())
        positions.append((i, i))
        # Then the rows below it, one loop whose addresses advance by q and by n.
        if below[[i, *rest]].any():
            stage = LoopRecorder(
                n - i - 1, row=((i + 1) * q, q), left=(root_at + (i + 1) * n + i, n), **pivot
            )
            a, others = row(stage, "pivot", full[i])
            mirror = mirror._replace(a=a, rest=others)
            if mirror.there is not False:
                inverse, scale, has_rest = (stage.take("mirror", k) for k in range(3))
                mirror = mirror._replace(
                    inverse=inverse, scale=scale, there=emit("ne", has_rest, 0.0)
                )
            first, moved = _reflected(mirror, *row(stage, "row", below))
            stage.put("left", 0, first)
            for j, x in zip(rest.tolist(), moved, strict=True):
                stage.put("row", j, x)
            stages.append(stage.stage())
            positions += [(r, i) for r in range(i + 1, n)]
            full[i + 1 :, rest] = True  # a reflection fills in
    return Loop(stages, mirror_at + 3, [root_at + i * n + j for i, j in positions]), positions


def cholesky(P: Array) -> Array:
    """Lower root; nan where a pivot is not positive."""
    n = len(P)
    L = TracedArray((n, n))
    for i in range(n):
        for j in range(i + 1):
            left = emit("sub", P[i, j], total(emit("mul", L[i, k], L[j, k]) for k in range(j)))
            if i == j:
                L[i, i] = emit("sqrt", emit("select", emit("lt", 0.0, left), left, -1.0))
            else:
                L[i, j] = emit("div", left, L[j, j])
    return L


def semidefinite_root(P: Array, nothing: float, round_off: float) -> Array:
    """Lower root of a matrix that may be singular. A pivot up to ``nothing`` times its variance
    gives a column of zeros; a pivot below ``-round_off`` times its variance gives nan.
    """
    n = len(P)
    L = TracedArray((n, n))
    for j in range(n):
        left = [
            emit("sub", P[i, j], total(emit("mul", L[i, k], L[j, k]) for k in range(j)))
            for i in range(j, n)
        ]
        size = emit("abs", P[j, j])
        # left[0] is the pivot P_jj minus the sum of L_jk^2.
        positive = emit("lt", emit("mul", nothing, size), left[0])
        root = emit("sqrt", emit("select", positive, left[0], 1.0))
        absent = emit(
            "sqrt", emit("select", emit("le", emit("mul", -round_off, size), left[0]), 0.0, -1.0)
        )
        for i, x in zip(range(j, n), left, strict=True):
            L[i, j] = emit("select", positive, root if i == j else emit("div", x, root), absent)
    return L


def solve_lower(L: Array, B: Array) -> Array:
    """``L^-1 B``, by substitution; a zero on the diagonal gives results that are not finite."""
    n = len(L)
    # One division per row; the columns of B then need products only.
    inverse = [emit("div", 1.0, L[i, i]) for i in range(n)]

    def column(b: Array) -> Array:
        """The solution ``(..., n)`` for columns of B, passed and returned as rows."""
        X = TracedArray(b.shape)
        for i in range(n):
            for k in np.ndindex(*b.shape[:-1]):
                left = emit(
                    "sub", b[(*k, i)], total(emit("mul", L[i, j], X[(*k, j)]) for j in range(i))
                )
                X[(*k, i)] = emit("mul", left, inverse[i])
        return X

    return each_row(column, B.T, least=LONG_SOLUTION).T if B.ndim == 2 else column(B)
