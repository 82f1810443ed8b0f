"""The kernels of `celnav.gaussian.linalg` that look at numbers on their way, for numbers that are not known yet.

One matrix each: while a step is recorded there is no axis of runs. What is known to be zero costs nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from celnav.tape.numbers import Numbers
from celnav.tape.tape import do, total

Array = Any
SMALLEST = 1e-290  # squares below are no reflection


def _zero(x: Any) -> bool:
    return isinstance(x, float) and x == 0.0


def tria(A: Array) -> Array:
    """Lower root with a diagonal that is not negative, by Householder reflections [Golub & Van Loan 1996, 5.1]."""
    n, q = A.shape
    rows = [[A[i, j] for j in range(q)] + [0.0] * max(n - q, 0) for i in range(n)]
    L = Numbers((n, n))
    for i in range(n):
        row = rows[i]
        rest = [j for j in range(i + 1, len(row)) if not _zero(row[j])]
        a, below = row[i], range(i + 1, n)
        if not rest:
            L[i, i] = do("abs", a)
            sign = do("copysign", 1.0, a)
            for r in below:
                L[r, i] = do("mul", sign, rows[r][i])
            continue
        s = total(do("mul", row[j], row[j]) for j in rest)
        length = do("sqrt", s if _zero(a) else do("add", s, do("mul", a, a)))
        there = do("lt", SMALLEST, do("mul", length, length) if _zero(a) else s)
        L[i, i] = length
        # I - v v' / (length (length - a)) takes the row to (length, 0, ...), with v = row but v_i = a - length = -s / (length + a):
        # of the two forms of v_i the one without cancellation.
        inverse = do("div", 1.0, length)
        if _zero(a):
            scale = inverse
        else:
            grown, positive = do("add", length, do("abs", a)), do("lt", 0.0, a)
            scale = do("div", do("select", positive, grown, 1.0), do("select", positive, s, grown))
        for r in below:
            across = total(do("mul", rows[r][j], row[j]) for j in rest)
            along = rows[r][i]
            inner = across if _zero(a) or _zero(along) else do("add", across, do("mul", a, along))
            moved = do("mul", inner, inverse)
            d = do("mul", do("sub", do("mul", across, scale), along), inverse)
            L[r, i] = do("select", there, moved, do("mul", do("copysign", 1.0, a), along))
            if _zero(d):
                continue
            d = do("select", there, d, 0.0)
            for j in rest:
                rows[r][j] = do("sub", rows[r][j], do("mul", d, row[j]))
    return L


def cholesky(P: Array) -> Array:
    """Lower root; nan where a pivot is not positive."""
    n = len(P)
    L = Numbers((n, n))
    for i in range(n):
        for j in range(i + 1):
            left = do("sub", P[i, j], total(do("mul", L[i, k], L[j, k]) for k in range(j)))
            if i == j:
                L[i, i] = do("sqrt", do("select", do("lt", 0.0, left), left, -1.0))
            else:
                L[i, j] = do("div", left, L[j, j])
    return L


def semidefinite_root(P: Array, nothing: float) -> Array:
    """Lower root of a matrix that may be singular: a pivot that is ``nothing`` of its variance has a column of zeros, one below
    minus that is lost."""
    n = len(P)
    L = Numbers((n, n))
    for j in range(n):
        left = [do("sub", P[i, j], total(do("mul", L[i, k], L[j, k]) for k in range(j))) for i in range(j, n)]
        least = do("mul", nothing, do("abs", P[j, j]))
        positive = do("lt", least, left[0])
        root = do("sqrt", do("select", positive, left[0], 1.0))
        absent = do("sqrt", do("select", do("le", do("neg", least), left[0]), 0.0, -1.0))
        for i, x in zip(range(j, n), left, strict=True):
            L[i, j] = do("select", positive, root if i == j else do("div", x, root), absent)
    return L


def solve_lower(L: Array, B: Array) -> Array:
    """``L^-1 B``, by substitution; what a zero on the diagonal gives is not finite."""
    n = len(L)
    X = Numbers(B.shape)
    inverse = [do("div", 1.0, L[i, i]) for i in range(n)]
    for i in range(n):
        for k in np.ndindex(*B.shape[1:]):
            left = do("sub", B[(i, *k)], total(do("mul", L[i, j], X[(j, *k)]) for j in range(i)))
            X[(i, *k)] = do("mul", left, inverse[i])
    return X
