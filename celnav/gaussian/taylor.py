"""Linearization: the extended Kalman filter's way from a function of a Gaussian to a mean and columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import number, numbers
from celnav.gaussian.linalg import Array, fan, side_by_side, solve_upper_transposed
from celnav.gaussian.rules import KEEP, Image
from celnav.gaussian.spaces import EUCLIDEAN, Space

POSITIVE = np.ones(1)
"""The sign of columns that all count with +1."""


class Taylor:
    """First-order expansion about the mean: the rule that makes a filter an extended Kalman filter.

    It serves any dimension. Where a `Motion` or a `Sensor` has a ``jacobian`` that is used; else central differences along the
    columns of the root are.

    Parameters
    ----------
    step: length of the difference, in standard deviations.
    about: ``(..., N)``, the point to expand about instead of the mean, as an iterated filter does. The belief stays where it
        is: its mean is mapped by the linear function.

    Raises
    ------
    ValueError: unless ``step`` is positive.
    """

    sign = POSITIVE

    def __init__(self, step: float = 1e-3, *, about: ArrayLike | None = None):
        self.step = number("step", step, above=0.0)
        self.about = None if about is None else numbers("about", about)

    def __repr__(self) -> str:
        return "Taylor()"

    def points(self, mean: Array, root: Array, space: Space = EUCLIDEAN, augment: Sequence[Array] = ()) -> list[Array]:
        """The center and its neighbors; noise points vary in their own directions only.

        With a center of its own, the last two points lie on the way from there to the mean, a step to either side.
        """
        center = mean if self.about is None else self.about
        if center.shape[-1:] != mean.shape[-1:]:
            raise ValueError(f"about: expected shape (..., {mean.shape[-1]}), got {center.shape}")
        roots = (root, *augment)
        total, batch = sum(E.shape[-1] for E in roots), max(center.ndim - 1, root.ndim - 2)
        directions = self.step * np.hstack([np.zeros((total, 1)), np.eye(total), -np.eye(total)])
        deviations, first = [], 0
        for E in roots:
            deviations.append(fan(E, directions[first : first + E.shape[-1]], batch))
            first += E.shape[-1]
        if self.about is not None:
            way = self.step * space.minus(mean, center)
            ways = [way, *(np.zeros(way.shape[:-1] + E.shape[-2:-1]) for E in augment)]
            ways = [np.broadcast_to(w, np.broadcast_shapes(w.shape, D.shape[1:])) for w, D in zip(ways, deviations, strict=True)]
            deviations = [
                np.concatenate([np.broadcast_to(D, (len(D), *w.shape)), [w, -w]]) for w, D in zip(ways, deviations, strict=True)
            ]
        points = [space.plus(center, deviations[0])]
        return points + [np.broadcast_to(D, (*points[0].shape[:-1], D.shape[-1])) for D in deviations[1:]]

    def images(
        self,
        g: Callable[..., tuple[Any, ...]],
        mean: Array,
        root: Array,
        space: Space,
        spaces: Sequence[Space],
        augment: Sequence[Array] = (),
    ) -> list[Image]:
        """See `celnav.gaussian.rules.Rule.images`."""
        roots, n = (root, *augment), root.shape[-1]
        total, images = sum(E.shape[-1] for E in roots), []
        for y, own in zip(g(*self.points(mean, root, space, augment)), spaces, strict=True):
            if y is KEEP:
                images.append(kept_image(mean, root, augment))
                continue
            d = own.minus(y, y[0])
            shift = np.zeros(d.shape[-1])
            columns = np.moveaxis(d[1 : total + 1] - d[total + 1 : 2 * total + 1], 0, -1) / (2.0 * self.step)
            if self.about is not None:
                shift = (d[-2] - d[-1]) / (2.0 * self.step)
            images.append(Image(y[0], shift, columns, lambda A=columns: _jacobian(A[..., :n], root)))  # type: ignore[misc]
        return images


def _jacobian(columns: Array, root: Array) -> Array:
    return solve_upper_transposed(root, columns.mT).mT


def kept_image(mean: Array, root: Array, augment: Sequence[Array] = ()) -> Image:
    """The image of a state that is kept as it is: its columns are those of its root."""
    n = root.shape[-1]
    columns = side_by_side([root, *(np.zeros((n, E.shape[-1])) for E in augment)]) if augment else root
    return Image(mean, np.zeros(n), columns, lambda: np.eye(n))


def linear_image(value: Array, jacobian: Array, root: Array, augment: Sequence[Array] = ()) -> Image:
    """The image of a linear function: its value at the mean, and its matrix ``(..., k, n + noises)``."""
    n = root.shape[-1]
    width = root.shape[-2] + (sum(E.shape[-2] for E in augment) if augment else 0)
    if jacobian.shape[-1] != width:
        raise ValueError(f"jacobian: expected shape (..., {jacobian.shape[-2]}, {width}), got {jacobian.shape}")
    if not augment:
        return Image(value, np.zeros(jacobian.shape[-2]), jacobian @ root, lambda: jacobian)
    parts, first = [], 0
    for E in (root, *augment):
        parts.append(jacobian[..., first : first + E.shape[-2]] @ E)
        first += E.shape[-2]
    return Image(value, np.zeros(jacobian.shape[-2]), side_by_side(parts), lambda: jacobian[..., :n])
