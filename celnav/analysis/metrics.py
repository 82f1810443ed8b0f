"""Accuracy and consistency of estimates: RMSE with confidence intervals, and chi-square bands."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import LIMIT, function, integer, number, numbers
from celnav.gaussian.linalg import Array
from celnav.lazy import LazyModule

special = LazyModule("scipy.special")


def rms(squares: ArrayLike) -> float:
    """Square root of the mean of all ``squares``, of any shape: a number."""
    return float(np.sqrt(_samples("squares", squares).mean()))


def ratio(a: ArrayLike, b: ArrayLike) -> float:
    """``rms(a) / rms(b)`` for two arrays of squares: a number."""
    return rms(_samples("a", a)) / rms(_samples("b", b))


def rmse(error: ArrayLike, axis: int = 1) -> Array:
    """Root mean square error over the runs, ``(T, n)`` for errors ``(T, runs, n)``.

    axis: axis of the runs. ValueError without runs.
    """
    array, axis = _runs(error, axis)
    return np.asarray(np.sqrt(np.mean(np.square(array), axis=axis)))


def rmse_interval(error: ArrayLike, level: float = 0.95, axis: int = 1) -> tuple[Array, Array]:
    """Lower and upper confidence limits of `rmse`, each in its shape, for zero-mean Gaussian errors
    that are independent between runs.
    """
    array, axis = _runs(error, axis)
    runs, value = array.shape[axis], rmse(array, axis)
    # runs * mean square / variance is chi-square with `runs` degrees of freedom.
    low, high = _chi_square(level, runs)
    return value * np.sqrt(runs / high), value * np.sqrt(runs / low)


def chi_square_band(dof: float, runs: float, level: float = 0.95) -> tuple[float, float]:
    """Lower and upper limit that contain the mean over ``runs`` of a chi-square variable with
    ``dof`` degrees of freedom, with probability ``level``.

    For a consistent filter, ``dof`` is the dimension of the state for the NEES, and the dimension
    of the measurement for the NIS.

    >>> celnav.analysis.metrics.chi_square_band(3, 100)  # mean NIS, 3 components, 100 runs
    (2.539..., 3.498...)
    """
    runs = number("runs", runs, above=0.0)
    low, high = _chi_square(level, number("dof", dof, above=0.0) * runs)
    return low / runs, high / runs


def bootstrap(
    statistic: Callable[..., Any],
    *samples: Array,
    block: int = 1,
    level: float = 0.95,
    resamples: int = 400,
    seed: int = 0,
) -> tuple[float, float]:
    """Lower and upper limit of the expanded percentile bootstrap interval of
    ``statistic(*samples)``.

    samples: arrays with the runs on the first axis, at least two. Each resample uses the same runs
        for all samples, so ratios of paired quantities benefit from common noise.
    block: number of consecutive samples that are drawn together, in a circle [Politis1992], for
        samples that are epochs of one run. It should be several times the correlation length of the
        errors, and much less than the number of samples.

    For few runs the interval is widened about the value by Student's t [Hesterberg2015]. For a
    positive statistic of non-negative samples, such as an RMSE, it is widened in the logarithm.

    >>> low, high = bootstrap(ratio, squares_of_one_filter, squares_of_another)
    """
    function("statistic", statistic, f"({', '.join(['sample'] * max(1, len(samples)))})")
    arrays = [np.atleast_1d(numbers("samples", sample)) for sample in samples]
    runs = min((len(array) for array in arrays), default=0)
    if runs < 2 or any(len(array) != runs for array in arrays):
        raise ValueError(
            "samples: expected two runs or more, the same number in each sample, got "
            f"{[len(array) for array in arrays]}"
        )
    block = integer("block", block, 1, runs // 2)
    blocks = runs / block
    level = number("level", level, above=0.0, below=1.0)
    resamples = integer("resamples", resamples, 1, LIMIT // runs)
    # (resamples, blocks): the first sample of each block.
    starts = np.random.default_rng(integer("seed", seed, 0)).integers(
        0, runs, (resamples, -(-runs // block))
    )

    value = float(numbers("statistic", _samples("statistic", statistic(*arrays)), ()))
    drawn: Iterable[Array] = starts
    if block > 1:
        drawn = (((start[:, None] + np.arange(block)) % runs).ravel()[:runs] for start in starts)
    statistics = [statistic(*(array[rows] for array in arrays)) for rows in drawn]
    values = numbers("statistic", statistics, (resamples,))
    upper = 0.5 + level / 2
    low, high = np.quantile(values, [0.5 - level / 2, upper])
    # Student's t and the factor n / (n - 1) of the variance, for few runs.
    wider = float(
        np.sqrt(blocks / (blocks - 1)) * special.stdtrit(blocks - 1, upper) / special.ndtri(upper)
    )
    # The interval of a positive statistic stays positive: it is widened by a factor.
    if value > 0.0 and low >= 0.0 and all((array >= 0.0).all() for array in arrays):
        return value * float(low / value) ** wider, value * float(high / value) ** wider
    return value + wider * float(low - value), value + wider * float(high - value)


def _runs(error: ArrayLike, axis: int) -> tuple[Array, int]:
    """Checked errors (nan if a run has failed) and their axis of runs; ValueError without runs."""
    array = numbers("error", error)
    if (
        array.shape not in ((), (0,))
        and array.shape[axis := integer("axis", axis, -array.ndim, array.ndim - 1)]
    ):
        return array, axis
    raise ValueError(f"error: expected at least one run, got shape {array.shape}")


def _samples(name: str, values: ArrayLike) -> Array:
    """Checked numbers, which may be nan; ValueError if there are none."""
    array = numbers(name, values)
    if not array.size:
        raise ValueError(f"{name}: expected at least one number, got {values!r:.80}")
    return array


def _chi_square(level: float, dof: float) -> tuple[float, float]:
    """Lower and upper limit of the central interval of a chi-square variable."""
    level = number("level", level, above=0.0, below=1.0)
    low, high = 2.0 * special.gammaincinv(0.5 * dof, [0.5 - level / 2, 0.5 + level / 2])
    return float(low), float(high)
