"""filterpy's functions of one vector as functions of all points: models, sums, differences and means."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from celnav.gaussian.checks import numbers
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import EUCLIDEAN, Space


def model_of(
    vectorized: bool, name: str, function: Callable[..., Any], m: int, given: tuple[Any, ...], options: dict[str, Any]
) -> Callable[[Array, Any], Array]:
    """A model ``(p, n) -> (p, m)`` of all points from filterpy's of one, or, if it is ``vectorized``, of all.

    Raises
    ------
    ValueError: from the model, naming the function, if it gives no numbers, or another number of components.
    """

    def model(points: Array, epoch: Any) -> Array:  # noqa: ARG001
        own = points.copy()  # which the function may change
        if vectorized:
            values = numbers(name, function(own, *given, **options))
        else:
            found = [function(point, *given, **options) for point in own]
            values = np.asarray(found) if set(map(type, found)) == {np.ndarray} else numbers(name, found)
            values = values if values.dtype == np.float64 else numbers(name, found)
        if values.shape != (len(own), m):
            values = values.reshape(len(own), -1)
            if values.shape[-1] != m:
                raise ValueError(f"{name} returned shape {values.shape[1:]}, expected ({m},)")
        return values

    return model


def space_of(
    add: Callable[[Array, Array], Array],
    residual: Callable[[Array, Array], Array],
    mean: Callable[[Array, Array], Array] | None,
) -> Space:
    """The space of filterpy's ``state_add``, residual and mean; None is no mean of its own."""
    if add is np.add and residual is np.subtract and mean is None:
        return EUCLIDEAN
    own = None if mean is None else lambda points, weights: np.asarray(mean(points, weights), dtype=np.float64)
    return Space(sums(add), differences(residual), None, own)


def sums(add: Callable[[Array, Array], Array]) -> Callable[[Array, Array], Array]:
    """Sums of a point and all tangents, from filterpy's ``state_add`` of two vectors, which may change the first."""
    if add is np.add:
        return EUCLIDEAN.plus

    def plus(point: Array, tangent: Any) -> Array:
        if np.ndim(tangent) == 0:  # a mean of its own needs no shift
            return point
        if tangent.ndim == 1:
            return np.asarray(add(point.copy(), tangent), dtype=np.float64)
        return np.stack([np.asarray(add(point.copy(), t), dtype=np.float64) for t in tangent])

    return plus


def differences(residual: Callable[[Array, Array], Array]) -> Callable[[Array, Array], Array]:
    """Differences of all points to one, from filterpy's residual of two vectors."""
    if residual is np.subtract:
        return np.subtract

    def minus(b: Array, a: Array) -> Array:
        if b.ndim == 1:
            return np.asarray(residual(b, a), dtype=np.float64)
        return np.stack([np.asarray(residual(row, a), dtype=np.float64) for row in b])

    return minus
