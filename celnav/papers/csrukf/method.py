"""The covariance of [Sun2015]'s filter in five forms, in the precision of the given arrays.

Neither celnav nor numpy factors in single precision: a `celnav.Gaussian` has doubles, and numpy
computes in double precision and rounds at the end. So this module has its own factorizations. A
matrix without a square root gives nan, which propagates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise, product
from typing import Any

import numpy as np

from celnav.filters.colored import decorrelation
from celnav.gaussian.linalg import Array, matvec, outer, side_by_side
from celnav.models import orbit, sightings
from celnav.papers.csrukf.scenario import Config, H, Scenario, simulate

__all__ = ["FORMS", "ROOTS", "cholesky", "compared", "downdate", "fly", "step", "tria", "updated"]

Cases = Sequence[tuple[Config, float]]
"""Configurations with the same number of steps, each with the unit of length of its computation,
as units per kilometer."""

FORMS = {
    "plain": "P - K S K'",
    "symmetrized": "symmetrized",
    "Joseph": "Joseph's form",
    "downdated": "QR and downdate, as printed",
    "array": "one QR",
}
"""Forms of an update: covariance, symmetrized covariance, covariance as a sum; square root with a
downdate [Sun2015, Eqs. 32-37], and square root without a difference."""
ROOTS = ("downdated", "array")


def tria(A: Array) -> Array:
    """Lower-triangular root ``(..., n, n)`` of ``A A'`` from the columns ``A (..., n, q)``, by
    Householder reflections of the rows."""
    A, n = A.copy(), A.shape[-2]
    for i in range(n):
        v = A[..., i, i:].copy()
        size = np.sqrt((v * v).sum(-1))
        v[..., 0] += np.where(v[..., 0] < 0, -size, size)
        square = (v * v).sum(-1, keepdims=True)
        unit = v / np.sqrt(np.where(square > 0, square, 1))  # a row of zeros stays zero
        rest = A[..., i:, i:]
        rest -= 2 * (rest * unit[..., None, :]).sum(-1, keepdims=True) * unit[..., None, :]
    signs = np.where(A[..., range(n), range(n)] < 0, -1, 1).astype(A.dtype)
    return np.asarray(np.tril(A[..., :n]) * signs[..., None, :])


def cholesky(P: Array) -> Array:
    """Lower-triangular root ``(..., n, n)`` of a covariance; reads its lower triangle only."""
    L = np.zeros_like(P)
    for j in range(P.shape[-1]):
        row = L[..., j, :j]
        L[..., j, j] = _sqrt(P[..., j, j] - (row * row).sum(-1))
        below = P[..., j + 1 :, j] - matvec(L[..., j + 1 :, :j], row)
        L[..., j + 1 :, j] = below / L[..., j, j, None]
    return L


def downdate(L: Array, V: Array) -> Array:
    """Lower-triangular root of ``L L' - V V'``, by LINPACK's rotations, one column after the other
    as `cholupdate` works [Sun2015, Eq. 37]."""
    L = L.copy()
    for v in np.moveaxis(V, -1, 0):
        p = _solve(L, v[..., None])[..., 0]
        a = _sqrt(1 - (p * p).sum(-1, keepdims=True))
        gone = np.zeros_like(v)
        for i in reversed(range(L.shape[-1])):
            length = np.sqrt(a * a + p[..., i, None] * p[..., i, None])
            c = a / length
            s = p[..., i, None] / length
            gone, L[..., i] = c * gone + s * L[..., i], c * L[..., i] - s * gone
            a = length
    return L


def _sqrt(x: Array) -> Array:
    return np.asarray(np.sqrt(np.where(x > 0, x, np.nan)))


def _solve(L: Array, B: Array) -> Array:
    """``L^-1 B``."""
    X = np.zeros_like(B)
    for i in range(L.shape[-1]):
        above = (L[..., i, None, :i] @ X[..., :i, :])[..., 0, :]
        X[..., i, :] = (B[..., i, :] - above) / L[..., i, i, None]
    return X


def updated(form: str, factor: Array, D: Array, E: Array, sqrt_R: Array) -> tuple[Array, Array]:
    """Gain ``(..., n, m)``, and the covariance or root given a measurement [Sun2015, Eqs. 32-37].

    factor: the covariance or root before the update. ``D (..., n, q)``, ``E (..., m, q)``: weighted
    deviations of the sigma points of state and measurement, so that ``P = D D'`` and
    ``S = E E' + R``.
    """
    # The deviations precede the noise, as printed. For a precise measurement they are larger, and
    # reflections that start with large columns preserve the digits of the small columns.
    A = side_by_side([E, sqrt_R])
    m = E.shape[-2]
    if form == "array":
        # tria [E sqrt_R; D 0] = [sqrt_S 0; K sqrt_S  sqrt_P]
        L = tria(np.concatenate([A, side_by_side([D, 0 * D[..., :m]])], -2))
        U = L[..., m:, :m]
        return _divided(U, L[..., :m, :m]), L[..., m:, m:]
    sqrt_S = tria(A) if form == "downdated" else cholesky(outer(A))
    U = _solve(sqrt_S, E @ D.mT).mT
    K = _divided(U, sqrt_S)
    if form == "downdated":
        return K, downdate(factor, U)
    if form == "Joseph":
        return K, outer(side_by_side([D - K @ E, K @ sqrt_R]))
    P = factor - K @ outer(A) @ K.mT
    return K, P if form == "plain" else (P + P.mT) / 2


def _divided(U: Array, L: Array) -> Array:
    """``U L^-1``; with rows and columns in reverse order ``L'`` is lower triangular again."""
    return _solve(L[..., ::-1, ::-1].mT, U.mT[..., ::-1, :])[..., ::-1, :].mT


def step(
    form: str, x: Array, factor: Array, model: Callable[[Array], Array], noise: Array, z: Any = None
) -> tuple[Array, Array]:
    """Mean, and covariance or root, after a prediction [Sun2015, Eqs. 24-27], or with ``z`` after
    an update."""
    S = (factor if form in ROOTS else cholesky(factor)).mT
    n = S.dtype.type(S.shape[-1])
    X = x[..., None, :] + np.sqrt(n) * np.concatenate([S, -S], -2)  # the center has weight 0
    Y = model(X)
    y = Y[..., 0, :] + (Y - Y[..., :1, :]).mean(-2)
    D = (X - x[..., None, :]).mT / np.sqrt(2 * n)
    E = (Y - y[..., None, :]).mT / np.sqrt(2 * n)
    if z is None:
        A = side_by_side([E, noise])
        return y, tria(A) if form in ROOTS else outer(A)
    K, after = updated(form, factor, D, E, noise)
    return x + matvec(K, z - y), after


def fly(
    form: str, precision: str, cases: Cases, sims: Sequence[Scenario]
) -> Iterator[tuple[Array, Array]]:
    """Run CSRUKF [Sun2015, Eqs. 21-37], corrected; for angles, SRUKF with white noise.

    Yields mean, and covariance or root, at each epoch but the first, ``(cases, runs, ...)`` in km
    and km/s.
    """
    config = cases[0][0]
    angles = sims[0].angles is not None
    ones = np.ones((1, 1, 1))
    columns = []
    for (c, scale), sim in zip(cases, sims, strict=True):
        star = decorrelation(0.0 * H if angles else H, c.sqrt_Q, np.sqrt(c.R))
        z: Any = sim.angles if angles else sim.z
        roots = (scale * root[None] for root in (c.sqrt_P0, star.sqrt_Q, star.sqrt_R))
        means = scale * sim.prior.mean, scale * z
        columns.append((scale * ones, c.phi * ones, star.J[None], *means, *roots))
    # Scalars (cases, 1, 1, 1), J and roots (cases, 1, n, m), x (cases, runs, 6), z (cases, T, runs,
    # 3), in the precision and the unit of all computations.
    unit, phi, J, x, z, sqrt_P0, sqrt_Q, sqrt_R = (
        np.stack(column).astype(precision) for column in zip(*columns, strict=True)
    )
    factor = np.broadcast_to(sqrt_P0 if form in ROOTS else outer(sqrt_P0), (*x.shape, 6))
    stars = sightings.star_directions(config.separation).astype(precision)

    def f(X: Array) -> Array:
        return np.asarray(orbit.step(X / unit, config.step_s) * unit)

    def h(X: Array) -> Array:
        if angles:
            return np.asarray(sightings.angles(X[..., :3] / unit, stars) * unit)
        return np.asarray(f(X)[..., :3] - phi * X[..., :3])

    def f_star(z: Array, X: Array) -> Array:
        Y = f(X)
        return np.asarray(Y + (z[..., None, :] - Y[..., :3] + phi * X[..., :3]) @ J.mT)

    for before, now in pairwise(z.swapaxes(0, 1)):
        if angles:  # they measure the state after the prediction
            x, factor = step(form, x, factor, f, sqrt_Q)
            x, factor = step(form, x, factor, h, sqrt_R, now)
        else:  # the difference measures the state before it
            difference = now - phi[..., 0] * before
            x, factor = step(form, x, factor, h, sqrt_R, difference)
            x, factor = step(form, x, factor, partial(f_star, difference), sqrt_Q)
        yield x / unit[..., 0], factor / (unit if form in ROOTS else unit * unit)


def compared(cases: Cases, _: Config, rngs: Sequence[np.random.Generator]) -> dict[str, Array]:
    """The filter in every form, in double and in single precision throughout, on the same data.

    Returns ``<form>, <precision>/...`` ``(cases, runs)``. lost: 1 where a factorization failed.
    square: mean square of the 3-D position error, km^2. apart: largest difference from the array
    form in double precision, in its standard deviations.
    """
    sims = [simulate(c, rngs) for c, _ in cases]
    truth = np.stack([sim.truth[1:] for sim in sims], 1)
    out = dict[str, Array]()
    for precision, form in product(("double", "single"), reversed(FORMS)):
        with np.errstate(all="ignore"):
            # (T, cases, runs, 6) and (T, cases, runs, 6, 6)
            means, factors = (np.array(each) for each in zip(*fly(form, precision, cases, sims)))
            root = factors[-1] if form in ROOTS else cholesky(factors[-1])
            if not out:  # the array form in double precision
                exact, std = means, np.sqrt(np.vecdot(factors, factors))
            square = np.square(means - truth)[..., :3].sum(-1).mean(0)
            apart = (np.abs(means - exact) / std).max((0, -1))
        lost = ~np.isfinite(square) | ~np.isfinite(root).all((-2, -1))
        name = f"{form}, {precision}"
        out |= {f"{name}/lost": lost * 1.0, f"{name}/square": square, f"{name}/apart": apart}
    return out
