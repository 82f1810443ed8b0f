"""How good, and how honest, an estimate is: RMSE with intervals, consistency bands, bounds and linear covariance analysis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv, ndtri, stdtrit

from celnav.gaussian import Gaussian
from celnav.linalg import Array, whiten
from celnav.spaces import EUCLIDEAN, Space


def rmse(error: Array, axis: int = 1) -> Array:
    """Root mean square over the runs; errors are ``(T, runs, n)`` unless ``axis`` says otherwise."""
    return np.asarray(np.sqrt(np.mean(np.square(error), axis=axis)))


def rms(squares: Array) -> float:
    """Root of the mean of squares over everything."""
    return float(np.sqrt(squares.mean()))


def ratio(a: Array, b: Array) -> float:
    """Ratio of the roots of the means of two sets of squares."""
    return rms(a) / rms(b)


def rmse_interval(error: Array, level: float = 0.95, axis: int = 1) -> tuple[Array, Array]:
    """Confidence interval of `rmse` for Gaussian errors of mean zero, independent from run to run."""
    runs = error.shape[axis]
    value = rmse(error, axis)
    low, high = _chi_square(level, runs)
    return value * np.sqrt(runs / high), value * np.sqrt(runs / low)


def chi_square_band(dof: float, runs: int, level: float = 0.95) -> tuple[float, float]:
    """Band in which the mean over ``runs`` of a chi-square variable of ``dof`` lies with probability ``level``.

    For the NEES of a consistent filter ``dof`` is the dimension of the state, for the NIS that of the measurement.
    """
    low, high = _chi_square(level, dof * runs)
    return low / runs, high / runs


def _chi_square(level: float, dof: float) -> tuple[float, float]:
    """Central interval of a chi-square variable."""
    low, high = 2.0 * gammaincinv(0.5 * dof, [0.5 - level / 2, 0.5 + level / 2])
    return float(low), float(high)


def bootstrap(
    statistic: Callable[..., Any], *samples: Array, level: float = 0.95, resamples: int = 400, seed: int = 0
) -> tuple[float, float]:
    """Expanded percentile interval of ``statistic(*samples)``, resampling the runs of all samples together.

    Each sample has its runs first. The same runs are drawn for all of them, so ratios of paired quantities keep what they
    gain from common noise. The interval is widened about the value as Student's t asks for few runs [Hesterberg 2015].
    """
    runs = len(samples[0])
    index = np.random.default_rng(seed).integers(0, runs, (resamples, runs))
    values = [float(statistic(*(sample[rows] for sample in samples))) for rows in index]
    low, high = np.quantile(values, [0.5 - level / 2, 0.5 + level / 2])
    value = float(statistic(*samples))
    upper = 0.5 + level / 2
    wider = float(np.sqrt(runs / (runs - 1)) * stdtrit(runs - 1, upper) / ndtri(upper))
    return value + wider * float(low - value), value + wider * float(high - value)


class Moments(NamedTuple):
    """Sums over the epochs of a stream, for each run: see `error_moments`."""

    epochs: int
    error: Array
    square: Array
    nees: Array

    @property
    def rmse(self) -> Array:
        """Root mean square error over all epochs, ``(..., n)``."""
        return np.asarray(np.sqrt(self.square / self.epochs))


def error_moments(space: Space = EUCLIDEAN) -> Callable[[Any, Any, Any, Any], Moments]:
    """A reduction for ``run(reduce=...)``: sums of the error, its square and the NEES against ``epoch.truth``, per run."""

    def add(total: Moments | None, epoch: Any, state: Any, info: Any) -> Moments:  # noqa: ARG001
        belief: Gaussian = state.belief
        error = space.minus(epoch.truth, belief.mean)
        white = whiten(belief.root, error)
        new = Moments(1, error, error * error, np.einsum("...i,...i->...", white, white))
        if total is None:
            return new
        return Moments(total.epochs + 1, total.error + new.error, total.square + new.square, total.nees + new.nees)

    return add


class Riccati(NamedTuple):
    """Gains ``(T, ..., n, m)`` and covariances after the update ``(T + 1, ..., n, n)``, the prior first."""

    gains: Array
    covariances: Array


def _gain(cross: Array, S: Array) -> Array:
    gain: Array = np.linalg.solve(S, cross.mT).mT
    return gain


def riccati(F: Array, H: ArrayLike, Q: ArrayLike, R: ArrayLike, P0: ArrayLike) -> Riccati:
    """Kalman filter covariances for ``x' = F x + w`` and white measurement noise.

    ``F (T, n, n)`` in time; ``Q``, ``R (T or 1, ..., m, m)`` or constant, and ``P0`` broadcast over leading batch axes.
    """
    h, q, r, P = (np.asarray(a, dtype=np.float64) for a in (H, Q, R, P0))
    gains, covariances = [], [P]
    eye = np.eye(P.shape[-1])
    for f in F:
        P = f @ P @ f.T + q
        K = _gain(P @ h.T, h @ P @ h.T + r)
        rest = eye - K @ h
        P = rest @ P @ rest.mT + K @ r @ K.mT
        gains.append(K)
        covariances.append(P)
    batch = np.broadcast_shapes(*(c.shape for c in covariances))
    return Riccati(np.stack(gains), np.stack([np.broadcast_to(c, batch) for c in covariances]))


def actual_covariance(
    F: Array, H: ArrayLike, gains: Array, Q: ArrayLike, Phi: ArrayLike, R: ArrayLike, P0: ArrayLike, Sigma0: ArrayLike
) -> Array:
    """True error covariances ``(T + 1, ..., n, n)`` of a filter with given gains when its noise is really colored.

    Exact for linear models: the covariance of ``[x_hat - x; V]`` is carried through prediction and update, with
    ``V' = Phi V + zeta``, ``zeta ~ N(0, R)``, ``V_0 ~ N(0, Sigma0)``. Arguments broadcast over leading batch axes.
    """
    h, q, phi, r, P, V = (np.asarray(a, dtype=np.float64) for a in (H, Q, Phi, R, P0, Sigma0))
    m, n = h.shape
    batch = np.broadcast_shapes(gains.shape[1:-2], *(a.shape[:-2] for a in (q, phi, r, P, V)))
    P, V = np.broadcast_to(P, (*batch, n, n)), np.broadcast_to(V, (*batch, m, m))
    C = np.zeros((*batch, n, m))
    out = [P]
    eye = np.eye(n)
    for f, K in zip(F, gains, strict=True):
        P, C, V = f @ P @ f.T + q, f @ C @ phi.mT, phi @ V @ phi.mT + r
        A = eye - K @ h
        cross = A @ C @ K.mT
        # The error after the update is A e + K V (of estimate minus truth).
        P, C = A @ P @ A.mT + cross + cross.mT + K @ V @ K.mT, A @ C + K @ V
        out.append(P)
    return np.stack(out)


def colored_bound(
    F: Array, H: ArrayLike, Phi: ArrayLike, Q: ArrayLike, R: ArrayLike, P0: ArrayLike, Sigma0: ArrayLike | None = None
) -> Array:
    """Posterior Cramer-Rao bounds ``(T + 1, ..., n, n)`` under colored measurement noise, for small process noise.

    ``F (T, n, n)`` along the true trajectory. ``Sigma0``: covariance of the first noise sample, if the first measurement is
    used; without it only differences of measurements inform. Arguments broadcast over leading batch axes.
    """
    h, phi, q, r, P = (np.asarray(a, dtype=np.float64) for a in (H, Phi, Q, R, P0))
    eye = np.eye(P.shape[-1])
    if Sigma0 is not None:
        sigma = np.asarray(Sigma0, dtype=np.float64)
        K = _gain(P @ h.T, h @ P @ h.T + sigma)
        rest = eye - K @ h
        P = rest @ P @ rest.mT + K @ sigma @ K.mT
    out = [P]
    for f in F:
        G = h @ f - phi @ h
        K = _gain(f @ P @ G.mT + q @ h.T, G @ P @ G.mT + h @ q @ h.T + r)
        A, B = f - K @ G, eye - K @ h
        P = A @ P @ A.mT + B @ q @ B.mT + K @ r @ K.mT
        out.append(P)
    batch = np.broadcast_shapes(*(p.shape for p in out))
    return np.stack([np.broadcast_to(p, batch) for p in out])
