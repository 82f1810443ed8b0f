"""How good, and how honest, an estimate is: RMSE with intervals, consistency bands, sums over a stream."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
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

    Raises
    ------
    ValueError: for less than two runs.
    """
    runs = len(samples[0])
    if runs < 2:
        raise ValueError(f"samples: expected two runs or more, got {runs}")
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
