"""Attitudes as unit quaternions, scalar last; their differences are generalized Rodrigues
parameters.

Conventions. ``q = [rho, q4]``; ``matrix(q)`` maps inertial components to body components;
``matrix(multiply(q, p)) == matrix(q) @ matrix(p)``; an error is ``multiply(q, inverse(q_hat))``, in
body axes. These are the inverse of scipy's rotations: ``Rotation.from_quat(q).as_matrix()`` is the
transpose of ``matrix(q)``. All functions accept leading batch axes. They are smooth at the identity
and several times as fast as scipy's objects. Only `unit`, `from_euler` and `attitude` check their
arguments.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import choice, number, numbers
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import Space, component_major, points_last

__all__ = ["attitude"]

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
UNIT_TOLERANCE = 1e-6
_TINY = 1e-300


def unit(q: ArrayLike, name: str = "q") -> Array:
    """Check quaternions ``(..., 4)`` and return them normalized; a row of nan (not measured) stays
    nan.

    ValueError if a row is infinite or partly nan, or if its norm differs from 1 by more than 1e-6.
    """
    array = numbers(name, q, (..., 4))
    missing = np.isnan(array)
    if np.isinf(array).any() or (missing.any(-1) != missing.all(-1)).any():
        raise ValueError(
            f"{name}: expected finite quaternions (or rows of nan), got "
            f"{array[~np.isfinite(array).all(-1)][:1]}"
        )
    norm = np.linalg.norm(array, axis=-1, keepdims=True)
    wrong = np.abs(norm - 1.0) > UNIT_TOLERANCE
    if wrong.any():
        raise ValueError(f"{name}: expected unit quaternions, got a norm of {norm[wrong][0]:.6g}")
    return np.asanyarray(array / norm)


# Component k of a product q p is the sum over i of q_i SIGN[k, i] p_j with j = INDEX[k, i].
INDEX = np.array([[3, 2, 1, 0], [2, 3, 0, 1], [1, 0, 3, 2], [0, 1, 2, 3]])
SIGN = np.array(
    [
        [1.0, -1.0, 1.0, 1.0],
        [1.0, 1.0, -1.0, 1.0],
        [-1.0, 1.0, 1.0, 1.0],
        [-1.0, -1.0, -1.0, 1.0],
    ]
)


def multiply(q: Array, p: Array) -> Array:
    """Product ``(..., 4)``: first p, then q."""
    ndim = max(q.ndim, p.ndim)
    # Components first (4, ...): for large batches the inner loop then runs along the batch.
    a = q.reshape((1,) * (ndim - q.ndim) + q.shape).T
    b = p.reshape((1,) * (ndim - p.ndim) + p.shape).T
    # (4, 4, ...), the matrix of p: its product with the column q is q p.
    matrix_of_p = b[INDEX] * SIGN.reshape(4, 4, *(1,) * (ndim - 1))
    return np.asanyarray(np.einsum("ki...,i...->k...", matrix_of_p, a).T)


def inverse(q: Array) -> Array:
    """Inverse rotation ``(..., 4)``."""
    return np.asanyarray(q * np.array([-1.0, -1.0, -1.0, 1.0]))


def positive(q: Array) -> Array:
    """``q`` or ``-q`` ``(..., 4)``, the same attitude, with a scalar part that is not negative."""
    return np.asanyarray(q * np.copysign(1.0, q[..., 3:]))


def matrix(q: Array) -> Array:
    """Direction cosines ``A(q) (..., 3, 3)``, inertial to body."""
    a, b, c, d = component_major(q)
    rows = (
        (d * d + a * a - b * b - c * c, 2.0 * (a * b + c * d), 2.0 * (a * c - b * d)),
        (2.0 * (a * b - c * d), d * d - a * a + b * b - c * c, 2.0 * (b * c + a * d)),
        (2.0 * (a * c + b * d), 2.0 * (b * c - a * d), d * d - a * a - b * b + c * c),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def rotate(q: Array, v: ArrayLike) -> Array:
    """``matrix(q) @ v``: body components ``(..., 3)`` of vectors with inertial components ``v``."""
    (a, b, c, d), (x, y, z) = component_major(q), component_major(numbers("v", v))
    # t = 2 v x rho, then v + q4 t + t x rho.
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    rows = (
        x + d * tx + ty * c - tz * b,
        y + d * ty + tz * a - tx * c,
        z + d * tz + tx * b - ty * a,
    )
    return points_last(np.stack(rows))


def exp(phi: Array) -> Array:
    """Quaternion ``(..., 4)`` of a rotation vector ``(..., 3)`` rad."""
    vector = phi.T  # components first: (3, ...)
    quarter = np.maximum(0.25 * np.sqrt(np.add.reduce(vector * vector)), _TINY)
    # With t = tan(theta / 4): rho = 2 t / (1 + t^2) phi / theta, q4 = (1 - t^2) / (1 + t^2).
    # One tangent is as accurate as a sine and a cosine, and several times as fast.
    t = np.tan(quarter)
    t2 = t * t
    rho, q4 = vector * (t / (quarter * (2.0 + 2.0 * t2))), (1.0 - t2) / (1.0 + t2)
    return np.asanyarray(np.concatenate([rho, q4[None]]).T)


def log(q: Array) -> Array:
    """Rotation vector ``(..., 3)`` rad, of length at most pi."""
    p = positive(q)
    sine = np.linalg.norm(p[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, p[..., 3:])
    small = sine < 1e-9
    # The limit of angle / sin(angle / 2) at 0 is 2.
    factor = np.where(small, 2.0, angle / np.where(small, 1.0, sine))
    return np.asanyarray(factor * p[..., :3])


def angle(q: Array) -> Array:
    """Rotation angle ``(...)`` rad, between 0 and pi."""
    return np.asanyarray(np.linalg.norm(log(q), axis=-1))


def from_euler(angles: ArrayLike) -> Array:
    """Quaternion ``(..., 4)`` of roll, pitch, yaw ``(..., 3)`` rad,
    ``A = R1(roll) R2(pitch) R3(yaw)``.
    """
    turns = exp(numbers("angles", angles, (..., 3))[..., None] * np.eye(3))
    return multiply(turns[..., 0, :], multiply(turns[..., 1, :], turns[..., 2, :]))


def to_euler(q: Array) -> Array:
    """Roll, pitch, yaw ``(..., 3)`` rad; the pitch is between -pi/2 and pi/2."""
    A = matrix(q)
    pitch = np.arcsin(np.clip(-A[..., 0, 2], -1.0, 1.0))
    return np.stack(
        [np.arctan2(A[..., 1, 2], A[..., 2, 2]), pitch, np.arctan2(A[..., 0, 1], A[..., 0, 0])], -1
    )


def to_rodrigues(q: Array, a: float = 1.0, b: float = 4.0) -> Array:
    """Generalized Rodrigues parameters ``b rho / (a + q4)``, ``(..., 3)``, of the shorter rotation
    [Crassidis2003].

    ``a = 0`` is the Gibbs vector, ``a = 1`` the modified Rodrigues parameters; with
    ``b = 2 (a + 1)`` they are the rotation vector to first order. The defaults are
    ``4 tan(angle / 4)`` along the axis.
    """
    # Transposed, components come first: (3, ...) and (...).
    rho, q4 = q.T[:3], q.T[3]
    return np.asanyarray((rho * (np.copysign(b, q4) / (a + np.abs(q4)))).T)


def from_rodrigues(p: Array, a: float = 1.0, b: float = 4.0) -> Array:
    """Unit quaternion ``(..., 4)`` of generalized Rodrigues parameters ``(..., 3)``."""
    # Transposed, components come first: (3, ...) and (...).
    vector = p.T
    square = np.add.reduce(vector * vector)
    root = b if a == 1.0 else np.sqrt(b * b + (1.0 - a * a) * square)
    q4 = (b * root - a * square) / (b * b + square)
    return np.asanyarray(np.concatenate([vector * ((a + q4) / b), q4[None]]).T)


def cross(v: Array) -> Array:
    """Matrix ``[v x] (..., 3, 3)``."""
    x, y, z = component_major(v)
    o = np.zeros_like(x)
    return np.stack([np.stack(row, -1) for row in ((o, -z, y), (z, o, -x), (-y, x, o))], -2)


def cross_product(a: Array, b: Array) -> Array:
    """Vector products ``a x b (..., 3)``; unlike numpy's, it also accepts traced numbers."""
    (x, y, z), (u, v, w) = ([vector[..., i] for i in range(3)] for vector in (a, b))
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], -1)


def turn_coefficients(square: Array) -> tuple[Array, Array]:
    """``(1 - cos t) / t^2`` and ``(t - sin t) / t^3`` for ``square = t^2 (...)``, without
    cancellation near 0.
    """
    small = square < 1e-2
    safe = np.where(small, 1.0, square)
    angle = np.sqrt(safe)
    first = np.where(
        small,
        0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square / 40320.0)),
        2.0 * np.sin(0.5 * angle) ** 2 / safe,
    )
    second = np.where(
        small,
        1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square / 362880.0)),
        (1.0 - np.sin(angle) / angle) / safe,
    )
    return first, second


def transport(p: Array, a: float = 1.0, b: float = 4.0) -> Array:
    """Matrix ``(..., 3, 3)`` that maps deviations at a reference to deviations at the reference
    moved by ``p (..., 3)``.

    It is the derivative of ``to_rodrigues(from_rodrigues(p + d) (x) from_rodrigues(p)^-1)`` with
    respect to d at d = 0. ValueError unless ``a`` is 0 or 1.
    """
    if a not in (0.0, 1.0):
        raise ValueError(
            f"a: expected 0 (Gibbs vector) or 1 (modified Rodrigues parameters), got {a!r}"
        )
    s = p / b
    square = np.square(s).sum(-1)[..., None, None]
    if a == 0.0:
        return np.asanyarray((np.eye(3) - cross(s)) / (1.0 + square))
    B = (1.0 - square) * np.eye(3) + 2.0 * cross(s) + 2.0 * s[..., :, None] * s[..., None, :]
    return np.asanyarray(B.mT / (1.0 + square) ** 2)


def attitude(
    a: float = 1.0, b: float = 4.0, *, transported: bool = False, axes: str = "body"
) -> Space:
    """Space of attitudes: points are quaternions ``(..., 4)``, tangents Rodrigues parameters
    ``(..., 3)``.

    The sign of a quaternion has no effect. A measurement and the mean of a belief must have norm 1
    within 1e-6.

    a, b: parameters of `to_rodrigues`, ``0 <= a <= 1`` and ``b > 0``.
    transported: whether an update also maps the covariance to the new reference attitude.
    axes: axes of the tangents, "body" or "reference" (a quaternion rotates reference to body axes).

    >>> motion = celnav.Motion(f, Q, space=attitude())
    """
    a, b = number("a", a, 0.0, 1.0), number("b", b, above=0.0)
    body = choice("axes", axes, ("body", "reference")) == "body"
    carry = partial(_carried, a, b, body) if transported else None
    turned, difference = partial(_turned, a, b, body), partial(_difference, a, b, body)
    return Space(turned, difference, carry, check=unit, size=4)


def _carried(a: float, b: float, body: bool, tangent: Array) -> Array:
    return transport(tangent if body else -tangent, a, b)


def _turned(a: float, b: float, body: bool, point: Array, tangent: Array) -> Array:
    turn, point = from_rodrigues(tangent, a, b), renormalized(point)
    return multiply(turn, point) if body else multiply(point, turn)


def renormalized(q: Array) -> Array:
    """Normalize quaternions ``(..., 4)``, so that round-off does not accumulate; ValueError if a
    norm differs from 1 by more than 1e-6.
    """
    square = np.vecdot(q, q)[..., None]
    # While a step is recorded, the numbers have no values yet.
    recording = q.dtype.hasobject
    if not recording and np.abs(square - 1.0).max(initial=0.0) > 2.0 * UNIT_TOLERANCE:
        raise ValueError(
            f"state: expected unit quaternions, got a norm of {np.sqrt(square.max()):.6g}"
        )
    return np.asanyarray(q * (1.5 - 0.5 * square))


def _difference(a: float, b: float, body: bool, later: Array, earlier: Array) -> Array:
    back = inverse(earlier)
    return to_rodrigues(multiply(later, back) if body else multiply(back, later), a, b)
