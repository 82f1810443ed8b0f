"""The covariance of [Sun2015]'s filter in five forms, in the precision of the arrays that are
given.

Neither celnav nor numpy computes in single precision: a `celnav.Gaussian` holds doubles, and numpy
factors in double whatever it is given and rounds at the end. So factorizations are written out
here. What has no root is nan, and so is all that follows from it.
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
"""Configurations of as many steps, and how many of the units of length, in which all is computed,
are a kilometer."""

FORMS = {
    "plain": "P - K S K'",
    "symmetrized": "symmetrized",
    "Joseph": "Joseph's form",
    "downdated": "QR and downdate, as printed",
    "array": "one QR",
}
"""An update: of the covariance, the same made symmetric, as a sum; of the root [Sun2015, Eqs.
32-37], and without a difference."""
ROOTS = ("downdated", "array")


def tria(A: Array) -> Array:
    """Lower root ``(..., n, n)`` of the columns ``A (..., n, q)``, by Householder's reflections of
    its rows."""
    A, n = A.copy(), A.shape[-2]
    for i in range(n):
        v = A[..., i, i:].copy()
        size = np.sqrt((v * v).sum(-1))
        v[..., 0] += np.where(v[..., 0] < 0, -size, size)
        square = (v * v).sum(-1, keepdims=True)
        unit = v / np.sqrt(np.where(square > 0, square, 1))  # a row of zeros stays one
        rest = A[..., i:, i:]
        rest -= 2 * (rest * unit[..., None, :]).sum(-1, keepdims=True) * unit[..., None, :]
    signs = np.where(A[..., range(n), range(n)] < 0, -1, 1).astype(A.dtype)
    return np.asarray(np.tril(A[..., :n]) * signs[..., None, :])


def cholesky(P: Array) -> Array:
    """Lower root ``(..., n, n)`` of a covariance, of which it reads the lower triangle."""
    L = np.zeros_like(P)
    for j in range(P.shape[-1]):
        row = L[..., j, :j]
        L[..., j, j] = _sqrt(P[..., j, j] - (row * row).sum(-1))
        L[..., j + 1 :, j] = (P[..., j + 1 :, j] - matvec(L[..., j + 1 :, :j], row)) / L[
            ..., j, j, None
        ]
    return L


def downdate(L: Array, V: Array) -> Array:
    """Lower root of ``L L' - V V'``, column after column as `cholupdate` does it [Sun2015, Eq. 37],
    by LINPACK's rotations."""
    L = L.copy()
    for v in np.moveaxis(V, -1, 0):
        p = _solve(L, v[..., None])[..., 0]
        a = _sqrt(1 - (p * p).sum(-1, keepdims=True))
        gone = np.zeros_like(v)
        for i in reversed(range(L.shape[-1])):
            length = np.sqrt(a * a + p[..., i, None] * p[..., i, None])
            c = a / length
            s = p[..., i, None] / length
            a = length
            gone, L[..., i] = c * gone + s * L[..., i], c * L[..., i] - s * gone
    return L


def _sqrt(x: Array) -> Array:
    return np.asarray(np.sqrt(np.where(x > 0, x, np.nan)))


def _solve(L: Array, B: Array) -> Array:
    """``L^-1 B``."""
    X = np.zeros_like(B)
    for i in range(L.shape[-1]):
        X[..., i, :] = (B[..., i, :] - (L[..., i, None, :i] @ X[..., :i, :])[..., 0, :]) / L[
            ..., i, i, None
        ]
    return X


def updated(form: str, spread: Array, D: Array, E: Array, sqrt_R: Array) -> tuple[Array, Array]:
    """Gain ``(..., n, m)``, and the covariance or root given a measurement [Sun2015, Eqs. 32-37].

    ``spread``: what it was. ``D (..., n, q)``, ``E (..., m, q)``: deviations of state and
    measurement.
    """
    # The deviations stand before the noise, as printed: of a precise measurement they are larger,
    # and reflections that
    # begin with what is large keep the digits of what is small.
    m = E.shape[-2]
    noisy = side_by_side([E, sqrt_R])
    if form == "array":
        still = np.zeros((D.shape[-2], sqrt_R.shape[-1]), D.dtype)
        L = tria(np.concatenate([noisy, side_by_side([D, still])], -2))
        S = L[..., :m, :m]
        U = L[..., m:, :m]
        after = L[..., m:, m:]
    else:
        S = tria(noisy) if form == "downdated" else cholesky(outer(noisy))
        U = _solve(S, E @ D.mT).mT
    K = _solve(S[..., ::-1, ::-1].mT, U.mT[..., ::-1, :])[..., ::-1, :].mT
    if form == "downdated":
        after = downdate(spread, U)
    elif form == "Joseph":
        after = outer(side_by_side([D - K @ E, K @ sqrt_R]))
    elif form != "array":
        after = spread - K @ outer(noisy) @ K.mT
        after = after if form == "plain" else (after + after.mT) / 2
    return K, after


def step(
    form: str, x: Array, spread: Array, model: Callable[[Array], Array], noise: Array, z: Any = None
) -> tuple[Array, Array]:
    """Mean, and covariance or root, after a motion [Sun2015, Eqs. 24-27]; or, with ``z``, given a
    measurement."""
    S = (spread if form in ROOTS else cholesky(spread)).mT
    X = x[..., None, :] + np.sqrt(S.dtype.type(S.shape[-1])) * np.concatenate(
        [S, -S], -2
    )  # no center: its weight is 0
    Y = model(X)
    root = np.sqrt(S.dtype.type(X.shape[-2]))
    y = Y[..., 0, :] + (Y - Y[..., :1, :]).mean(-2)
    D, E = ((points - mean[..., None, :]).mT / root for points, mean in ((X, x), (Y, y)))
    if z is None:
        A = side_by_side([E, noise])
        return y, tria(A) if form in ROOTS else outer(A)
    K, after = updated(form, spread, D, E, noise)
    return x + matvec(K, z - y), after


def fly(
    form: str, precision: str, cases: Cases, sims: Sequence[Scenario]
) -> Iterator[tuple[Array, Array]]:
    """CSRUKF [Sun2015, Eqs. 21-37], corrected; of angles SRUKF, for white noise.

    Yields mean, and covariance or root, at each epoch but the first, ``(cases, runs, ...)`` in km
    and km/s.
    """
    c = cases[0][0]
    angles = sims[0].angles is not None
    one = np.ones((1, 1, 1))
    rows = list[tuple[Any, ...]]()
    for (d, u), s in zip(cases, sims, strict=True):
        star = decorrelation(0.0 * H if angles else H, d.sqrt_Q, np.sqrt(d.R))
        seen, sqrt_R = (s.angles, star.sqrt_R) if angles else (s.z * u, star.sqrt_R * u)
        rows.append(
            (
                u * one,
                d.phi * one,
                s.prior.mean * u,
                seen,
                d.sqrt_P0 * u,
                star.J,
                star.sqrt_Q * u,
                sqrt_R,
            )
        )
    units, phi, x, z, *matrices = (
        np.stack(each).astype(precision) for each in zip(*rows, strict=True)
    )
    S, J, sqrt_Q, sqrt_R = (matrix[:, None] for matrix in matrices)
    spread = np.broadcast_to(S if form in ROOTS else outer(S), (*x.shape, 6))
    stars = sightings.star_directions(c.separation)

    def f(X: Array) -> Array:
        return np.asarray(orbit.step(X / units, c.step_s) * units)

    def h(X: Array) -> Array:
        return (
            sightings.angles(X[..., :3] / units, stars.astype(precision))
            if angles
            else f(X)[..., :3] - phi * X[..., :3]
        )

    def moved(z: Array, X: Array) -> Array:
        Y = f(X)
        return np.asarray(Y + (z[..., None, :] - Y[..., :3] + phi * X[..., :3]) @ J.mT)

    for before, now in pairwise(z.swapaxes(0, 1)):
        what = now if angles else now - phi[..., 0] * before
        both = (h, sqrt_R, what), (partial(moved, what), sqrt_Q, None)  # of angles J is zero
        for operation in reversed(both) if angles else both:
            x, spread = step(form, x, spread, *operation)
        yield x / units[..., 0], spread / (units if form in ROOTS else units * units)


def compared(cases: Cases, _: Config, rngs: Sequence[np.random.Generator]) -> dict[str, Array]:
    """The filter in every form, in double and in single precision throughout, on the same data.

    Of each, as ``<form>, <precision>/...`` ``(cases, runs)``: lost, 1 where a factorization failed;
    square, the mean square of the 3-D position error, km^2; apart, the largest difference from the
    array form in double precision, in its deviations.
    """
    sims = [simulate(c, rngs) for c, _ in cases]
    out = dict[str, Array]()
    exact = list[tuple[Array, Array]]()
    truth = np.stack([s.truth for s in sims], 1)
    for precision, form in product(("double", "single"), reversed(FORMS)):
        square, apart = np.zeros((2, *truth.shape[1:3]))
        with np.errstate(all="ignore"):
            for k, (x, spread) in enumerate(fly(form, precision, cases, sims)):
                if len(exact) == k:
                    exact.append((x, np.sqrt(np.vecdot(spread, spread))))
                square += np.square(x - truth[k + 1])[..., :3].sum(-1) / cases[0][0].steps
                apart = np.maximum(apart, (np.abs(x - exact[k][0]) / exact[k][1]).max(-1))
            failed = ~np.isfinite(square) | ~np.isfinite(
                spread if form in ROOTS else cholesky(spread)
            ).all((-2, -1))
        found = {"lost": failed.astype(float), "square": square, "apart": apart}
        out |= {f"{form}, {precision}/{what}": values for what, values in found.items()}
    return out
