"""filterpy's functions of one vector as functions of all points: models, sums, differences and means."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from celnav.linalg import Array


def model_of(
    vectorized: bool, name: str, function: Callable[..., Any], m: int, given: tuple[Any, ...], options: dict[str, Any]
) -> Callable[[Array, Any], Array]:
    """A model ``(p, n) -> (p, m)`` of all points from filterpy's of one, or, if it is ``vectorized``, of all.

    Raises
    ------
    ValueError: from the model, naming the function, if it gives another number of components.
    """

    def model(points: Array, epoch: Any) -> Array:  # noqa: ARG001
        if vectorized:
            values = np.asarray(function(points.copy(), *given, **options), dtype=np.float64)
        else:
            values = np.stack([np.atleast_1d(np.asarray(function(p.copy(), *given, **options), dtype=np.float64)) for p in points])
        values = values.reshape(len(points), -1)
        if values.shape[-1] != m:
            raise ValueError(f"{name} returned shape {values.shape[1:]}, expected ({m},)")
        return values

    return model


def sums(add: Callable[[Array, Array], Array]) -> Callable[[Array, Array], Array]:
    """Sums of a point and all tangents, from filterpy's ``state_add`` of two vectors."""
    if add is np.add:
        return lambda point, tangent: point + tangent

    def plus(point: Array, tangent: Array) -> Array:
        if tangent.ndim == 1:
            return np.asarray(add(point, tangent))
        return np.stack([np.asarray(add(point, t)) for t in tangent])

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


def mean_of(function: Callable[[Array, Array], Array] | None) -> Callable[[Array, Array], Array] | None:
    """Mean of points by weights, from filterpy's; None: the space's own."""
    return None if function is None else lambda points, weights: np.asarray(function(points, weights), dtype=np.float64)
