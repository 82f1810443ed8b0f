"""Extended poses (attitude, velocity and position as one element of the group SE_2(3)) and their
invariant errors [Barrau2017].
"""

from __future__ import annotations

import numpy as np

from celnav.gaussian.attitude import (
    cross_product,
    exp,
    inverse,
    multiply,
    renormalized,
    rotate,
    to_rodrigues,
    turn_coefficients,
    unit,
)
from celnav.gaussian.linalg import Array, side_by_side
from celnav.gaussian.spaces import NamedPart, Space

__all__ = ["extended_pose"]


def extended_pose() -> Space:
    """Space of extended poses: points are quaternion, velocity and position ``(..., 10)``; tangents
    ``(..., 9)`` are left-invariant errors [Barrau2017, Sec. III].

    A tangent ``(phi, a, b)``, on body axes, moves a point to ``R exp(phi)``, ``v + R J a``,
    ``p + R J b``. R is the rotation from body to reference axes and J the left Jacobian of phi. The
    propagation of this error depends on the inertial measurements only, not on the estimate. The
    named parts of the space are q, v and p.

    >>> motion = celnav.Motion(f, Q, space=extended_pose())
    """
    parts = (
        NamedPart("q", (0, 4), (0, 3)),
        NamedPart("v", (4, 7), (3, 6)),
        NamedPart("p", (7, 10), (6, 9)),
    )
    return Space(_plus, _minus, check=_check, size=10, parts=parts)


def _plus(point: Array, tangent: Array) -> Array:
    phi, q = tangent[..., :3], renormalized(point[..., :4])
    first, second = turn_coefficients((phi * phi).sum(-1, keepdims=True))
    back = inverse(q)
    moved = []
    for at in (slice(3, 6), slice(6, 9)):
        # J a = a + (1 - cos t) / t^2 phi x a + (t - sin t) / t^3 phi x (phi x a)
        across = cross_product(phi, tangent[..., at])
        moved.append(
            rotate(back, tangent[..., at] + first * across + second * cross_product(phi, across))
        )
    return side_by_side([multiply(exp(phi), q), point[..., 4:] + side_by_side(moved)])


def _minus(b: Array, a: Array) -> Array:
    q = a[..., :4]
    gibbs = to_rodrigues(multiply(b[..., :4], inverse(q)), 1.0, 1.0)  # tan(t / 4) along the axis
    square = (gibbs * gibbs).sum(-1, keepdims=True)
    phi = 4.0 * _arctan_ratio(square) * gibbs
    square = (phi * phi).sum(-1, keepdims=True)
    small = square < 1e-2
    safe = np.where(small, 1.0, square)
    first, second = turn_coefficients(square)
    # J^-1 d = d - phi x d / 2 + c phi x (phi x d),  c = (2 f - 1 + s t^2) / (2 f t^2)
    c = np.where(
        small,
        1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30240.0 + square / 1209600.0)),
        (2.0 * first - 1.0 + second * square) / (2.0 * first * safe),
    )
    moved = []
    for at in (slice(4, 7), slice(7, 10)):
        difference = rotate(q, b[..., at] - a[..., at])
        across = cross_product(phi, difference)
        moved.append(difference - 0.5 * across + c * cross_product(phi, across))
    return side_by_side([phi, *moved])


def _arctan_ratio(square: Array) -> Array:
    """``arctan(x) / x`` of ``square = x^2``, smooth at 0."""
    small = square < 1e-3
    x = np.sqrt(np.where(small, 1.0, square))
    series = 1.0 - square * (1.0 / 3.0 - square * (1.0 / 5.0 - square * (1.0 / 7.0 - square / 9.0)))
    return np.asanyarray(np.where(small, series, np.arctan(x) / x))


def _check(point: Array, name: str) -> Array:
    if point.shape[-1] != 10:
        raise ValueError(
            f"{name}: expected quaternion, velocity and position (..., 10), got {point.shape}"
        )
    return side_by_side([unit(point[..., :4], name), point[..., 4:]])
