"""Accuracy and consistency of an estimate: RMSE with intervals, and the bands of a consistent
filter.
"""

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
    """Root of the mean of ``squares`` of any shape over everything, a number."""
    return float(np.sqrt(_samples("squares", squares).mean()))


def ratio(a: ArrayLike, b: ArrayLike) -> float:
    """Ratio of the roots of the means of two sets of squares, a number."""
    return rms(_samples("a", a)) / rms(_samples("b", b))


def rmse(error: ArrayLike, axis: int = 1) -> Array:
    """Root mean square over the runs; errors are ``(T, runs, n)`` unless ``axis`` is another
    one.
    """
    array, axis = _runs(error, axis)
    return np.asarray(np.sqrt(np.mean(np.square(array), axis=axis)))


def rmse_interval(error: ArrayLike, level: float = 0.95, axis: int = 1) -> tuple[Array, Array]:
    """Confidence interval of `rmse`, its ends of the same shape, for Gaussian errors of mean zero,
    independent from run to run.
    """
    array, axis = _runs(error, axis)
    runs, value = array.shape[axis], rmse(array, axis)
    # runs * mean square / variance is a chi-square variable of as many degrees.
    low, high = _chi_square(level, runs)
    return value * np.sqrt(runs / high), value * np.sqrt(runs / low)


def chi_square_band(dof: float, runs: float, level: float = 0.95) -> tuple[float, float]:
    """Band, its two ends, in which the mean over ``runs`` of a chi-square variable of ``dof`` lies
    with probability ``level``.

    For the NEES of a consistent filter ``dof`` is the dimension of the state, for the NIS the
    dimension of the measurement.

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
    """Expanded percentile interval, its two ends, of ``statistic(*samples)``: the runs of all
    samples are resampled together.

    Each sample has its runs first, at least two. The same runs are drawn for all samples, so ratios
    of paired quantities benefit from common noise. The interval is widened about the value by
    Student's t for few runs [Hesterberg2015]; for a positive statistic of non-negative samples,
    such as an RMSE, in the logarithm.

    block: number of consecutive samples that are drawn together, in a circle [Politis1992]: for
        samples that are epochs of one run instead of runs. It should be several times the
        correlation length of the errors; the samples must be many blocks long.

    >>> low, high = bootstrap(ratio, squares_of_one_filter, squares_of_another)
    """
    function("statistic", statistic, f"({', '.join(['sample'] * max(1, len(samples)))})")
    arrays = [np.atleast_1d(numbers("samples", sample)) for sample in samples]
    runs = min((len(array) for array in arrays), default=0)
    if runs < 2 or any(len(array) != runs for array in arrays):
        raise ValueError(
            "samples: expected two runs or more, as many in each, got "
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
    # A positive statistic of squares stays positive: it is widened by a factor.
    if value > 0.0 and low >= 0.0 and all((array >= 0.0).all() for array in arrays):
        return value * float(low / value) ** wider, value * float(high / value) ** wider
    return value + wider * float(low - value), value + wider * float(high - value)


def _runs(error: ArrayLike, axis: int) -> tuple[Array, int]:
    """Errors, nan where a run has failed, and their axis of runs, with at least one run."""
    array = numbers("error", error)
    if (
        array.shape not in ((), (0,))
        and array.shape[axis := integer("axis", axis, -array.ndim, array.ndim - 1)]
    ):
        return array, axis
    raise ValueError(f"error: expected at least one run, got shape {array.shape}")


def _samples(name: str, values: ArrayLike) -> Array:
    """At least one number; nan is passed on."""
    array = numbers(name, values)
    if not array.size:
        raise ValueError(f"{name}: expected at least one number, got {values!r:.80}")
    return array


def _chi_square(level: float, dof: float) -> tuple[float, float]:
    """Central interval of a chi-square variable."""
    level = number("level", level, above=0.0, below=1.0)
    low, high = 2.0 * special.gammaincinv(0.5 * dof, [0.5 - level / 2, 0.5 + level / 2])
    return float(low), float(high)
