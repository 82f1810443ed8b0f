"""Iterated updates: linearize again where the update has led."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from celnav.filters.arguments import check_model, measurement, repetitions
from celnav.filters.conditioning import Model, noise_columns
from celnav.filters.info import Info
from celnav.filters.step import Conditioning, update
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import numbers
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.gaussian.taylor import Taylor

Start = Callable[[Gaussian, Array, Any], Array]
"""``(belief, z, epoch) -> (..., N)``: the first point to linearize about."""


def iterated(
    h: Model,
    R: Any = None,
    *,
    sqrt_R: Any = None,
    iterations: int = 6,
    start: Start | None = None,
    jacobians: Callable[[Array, Any], tuple[Array, ...]] | None = None,
    space: Space = EUCLIDEAN,
    measurement_space: Space = EUCLIDEAN,
) -> Conditioning:
    """Update part of the iterated extended Kalman filter: Gauss-Newton steps to the mode of the posterior [Bell1993].

    Parameters
    ----------
    h, R, sqrt_R, space, measurement_space: as in `celnav.filters.step.update`.
    iterations: linearizations. One with a ``start`` is an update linearized about a point known otherwise, from a closed
        solution of the measurements, say; the prior counts in full all the same.
    start: the first point; None: the prior's mean.
    jacobians: as in `Taylor`; None: differences.

    Raises
    ------
    ValueError: for a number of iterations below 1; otherwise as `update`.
    """
    if callable(h):
        check_model("h", h)
    count = repetitions("iterations", iterations)
    if start is not None:
        check_model("start", start, "(belief, z, epoch)")
    if jacobians is not None:
        check_model("jacobians", jacobians, "(mean, epoch)")
    columns = noise_columns(R, sqrt_R, "R")
    if columns is None:
        raise ValueError("R: expected measurement noise, R or sqrt_R")

    def part(belief: Gaussian, z: Any, epoch: Any = None, memory: Any = None) -> tuple[Gaussian, Info, Any]:
        z, belief = measurement(z, belief)
        at = belief.mean if start is None else numbers("start", start(belief, z, epoch), (..., belief.mean.shape[-1]))
        for _ in range(count):
            rule = Taylor(jacobians, about=at)
            once = update(h, rule, sqrt_R=columns, space=space, measurement_space=measurement_space)
            posterior, info, memory = once(belief, z, epoch, memory)
            at = posterior.mean
        return posterior, info, memory

    return Conditioning(part, space, measurement_space)
