"""Boosts for the bias stage of a two-stage filter: factors from what its residuals have been of late.

All keep an average ``C`` of squared residuals over the last ``tau`` measurements and compare it with what it should be. Component
i of the residual acts on component i of the bias, as the papers have it; nothing else connects the two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.model import check_function
from celnav.filters.two_stage import Boost
from celnav.gaussian.checks import finite, number, numbers
from celnav.gaussian.linalg import Array

LARGEST = 1e6
"""Factors lie between 1 and this; what is not a number counts as 1."""
Factor = Callable[[Array, Array], Array]
"""``(ratios (..., m), rho (m,)) -> factors`` from the ratios of squared residuals to their variances."""


class Window(NamedTuple):
    """Memory: how many residuals were seen, mean of their squares ``(..., m)``, and the factors last used."""

    length: int
    squares: Array
    factors: Array


def excess(ratios: Array, rho: Array) -> Array:
    """``1 + rho (ratio - 1)``: near 1 while the filter is consistent."""
    return np.asarray(1.0 + rho * (ratios - 1.0))


def proportional(ratios: Array, rho: Array) -> Array:
    """``rho ratio``: near ``rho`` even while the filter is consistent, the reading closest to the prose; 1 where ``rho`` is 0."""
    return np.where(rho > 0.0, rho * ratios, 1.0)


def strong_tracking(rho: ArrayLike, tau: float, *, factor: Factor = excess) -> Any:
    """A boost for `celnav.filters.two_stage.two_stage`.

    Parameters
    ----------
    rho: ``(..., m)``, not negative; 0 switches a component off. tau: length of the window, in measurements, at least 1.
    factor: `excess` or `proportional`.

    Raises
    ------
    ValueError: for other numbers.
    """
    weights = finite("rho", rho)
    if weights.ndim == 0 or (weights < 0.0).any():
        raise ValueError(f"rho: expected numbers (..., m) that are not negative, got {rho!r}")
    length = number("tau", tau, 1.0)
    check_function("factor", factor, "(ratios, rho)")

    def boost(memory: Window | None, seen: Boost) -> tuple[Window, Array]:
        square = seen.residual * seen.residual
        if square.shape[-1] != weights.shape[-1]:
            raise ValueError(f"rho: expected {square.shape[-1]} numbers to go with the measurement, got {weights.shape[-1]}")
        count = 1 if memory is None else memory.length + 1
        before = np.zeros_like(square) if memory is None else memory.squares
        squares = before + (square - before) / min(count, length)
        found = numbers("factor", factor(squares / seen.total.diagonal(0, -2, -1), weights), (..., square.shape[-1]))
        factors = np.clip(np.where(np.isfinite(found), found, 1.0), 1.0, LARGEST)
        return Window(count, squares, factors), factors

    return boost
