"""Attitudes: unit quaternions, scalar last, and the Rodrigues parameters that filters take their
differences in.

Conventions. ``q = [rho, q4]``; ``matrix(q)`` takes inertial components to body components;
``matrix(multiply(q, p)) == matrix(q) @ matrix(p)``; an error is ``multiply(q, inverse(q_hat))``, in
body axes. These are the inverse of scipy's rotations: ``Rotation.from_quat(q).as_matrix()`` is the
transpose of ``matrix(q)``. All functions take leading batch axes, are several times as fast as
scipy's objects, and smooth at the identity. Only `unit`, `from_euler` and `attitude` check their
arguments.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import choice, number, numbers
from celnav.gaussian.linalg import Array, is_concretely_true
from celnav.gaussian.spaces import Space, component_major, points_last

__all__ = ["attitude"]

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
UNIT_TOLERANCE = 1e-6
_TINY = 1e-300


def _rows(count: int, like: Array, of: Array) -> Array:
    """Empty components ``(count, ...)`` of a vector, each contiguous in memory, in the axis order
    of ``like``.
    """
    if like.flags.f_contiguous and not like.flags.c_contiguous:
        return np.empty((count, *like.shape[::-1]), like=of).transpose(
            (0, *range(like.ndim, 0, -1))
        )
    return np.empty((count, *like.shape), like=of)


def unit(q: ArrayLike, name: str = "q") -> Array:
    """Checked quaternions ``(..., 4)``, normalized at round-off; rows of nan (nothing measured) are
    left as they are.

    Raises ValueError if a row is infinite or partly nan, or its norm differs from 1 by more than
    1e-6.
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


# Component k of a product q p is the sum of sign q_i p_j over the rows (k, i, j, sign).
_TERMS = np.array(
    [
        (0, 3, 0, 1),
        (0, 0, 3, 1),
        (0, 1, 2, -1),
        (0, 2, 1, 1),
        (1, 3, 1, 1),
        (1, 1, 3, 1),
        (1, 2, 0, -1),
        (1, 0, 2, 1),
        (2, 3, 2, 1),
        (2, 2, 3, 1),
        (2, 0, 1, -1),
        (2, 1, 0, 1),
        (3, 3, 3, 1),
        (3, 0, 0, -1),
        (3, 1, 1, -1),
        (3, 2, 2, -1),
    ]
)
_PRODUCT = np.zeros((4, 16))
_PRODUCT[_TERMS[:, 0], 4 * _TERMS[:, 1] + _TERMS[:, 2]] = _TERMS[:, 3]


def multiply(q: Array, p: Array) -> Array:
    """Product ``(..., 4)``: first p, then q."""
    a, b = component_major(q), component_major(p)
    if a.ndim != b.ndim:
        ndim = max(a.ndim, b.ndim)
        a, b = (c.reshape(4, *(1,) * (ndim - c.ndim), *c.shape[1:]) for c in (a, b))
    # (4, 4, ...): pairs[i, j] = q_i p_j.
    pairs = a[:, None] * b[None]
    # One matrix product for all components: an order of magnitude fewer calls than sixteen products
    # and their sums.
    # Transposing batch axes that lie in Fortran order avoids a copy by the reshape.
    backwards = not pairs.flags.c_contiguous
    if backwards:
        pairs = pairs.transpose((0, 1, *range(pairs.ndim - 1, 1, -1)))
    rows = (_PRODUCT @ pairs.reshape(16, -1)).reshape(4, *pairs.shape[2:])
    return rows.T if backwards else points_last(rows)


def inverse(q: Array) -> Array:
    """The opposite rotation ``(..., 4)``."""
    return np.asanyarray(q * np.array([-1.0, -1.0, -1.0, 1.0]))


def positive(q: Array) -> Array:
    """Whichever of q and -q, which are the same attitude, has a scalar part that is not negative:
    ``(..., 4)``.
    """
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
    """Components ``(..., 3)`` on body axes of vectors ``v (..., 3)`` given on inertial ones:
    ``matrix(q) @ v``.
    """
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
    vector = component_major(phi)
    quarter = np.maximum(0.25 * np.sqrt(_square(vector)), _TINY)
    # With t = tan(theta / 4): rho = 2 t / (1 + t^2) phi / theta, q4 = (1 - t^2) / (1 + t^2).
    # A tangent is as exact as a sine and a cosine, and several times as fast.
    t = np.tan(quarter)
    t2 = t * t
    rows = _rows(4, np.asanyarray(t), vector)
    np.multiply(vector, t / (quarter * (2.0 + 2.0 * t2)), out=rows[:3])
    np.divide(1.0 - t2, 1.0 + t2, out=rows[3, ...])
    return points_last(rows)


def _square(vector: Array) -> Array:
    """Square of the norm of components ``(3, ...)``."""
    x, y, z = vector
    return np.asanyarray(x * x + y * y + z * z)


def log(q: Array) -> Array:
    """Rotation vector ``(..., 3)`` rad, of at most pi."""
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
    """Quaternion of roll, pitch, yaw ``(..., 3)`` rad, ``A = R1(roll) R2(pitch) R3(yaw)``."""
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
    of_q = component_major(q)
    return points_last(of_q[:3] * (np.copysign(b, of_q[3]) / (a + np.abs(of_q[3]))))


def from_rodrigues(p: Array, a: float = 1.0, b: float = 4.0) -> Array:
    """Unit quaternion ``(..., 4)`` of generalized Rodrigues parameters ``(..., 3)``."""
    vector = component_major(p)
    square = _square(vector)
    root = b if a == 1.0 else np.sqrt(b * b + (1.0 - a * a) * square)
    rows = _rows(4, square, vector)
    np.divide(b * root - a * square, b * b + square, out=rows[3, ...])
    np.multiply(vector, (a + rows[3]) / b, out=rows[:3])
    return points_last(rows)


def cross(v: Array) -> Array:
    """Matrix ``[v x] (..., 3, 3)``."""
    x, y, z = component_major(v)
    o = np.zeros_like(x)
    return np.stack([np.stack(row, -1) for row in ((o, -z, y), (z, o, -x), (-y, x, o))], -2)


def cross_product(a: Array, b: Array) -> Array:
    """Vector products ``a x b (..., 3)``, also of traced numbers."""
    (x, y, z), (u, v, w) = ([vector[..., i] for i in range(3)] for vector in (a, b))
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], -1)


def turn_coefficients(square: Array) -> tuple[Array, Array]:
    """``(1 - cos t) / t^2`` and ``(t - sin t) / t^3`` of ``square = t^2 (...)``, without loss of
    digits near 0.
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
    """Matrix ``(..., 3, 3)`` that carries deviations about the reference to the reference moved by
    ``p``; a is 1 or 0.

    The derivative of ``to_rodrigues(from_rodrigues(p + d) (x) from_rodrigues(p)^-1)`` with respect
    to d at 0.
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

    The sign of a quaternion never matters. A measurement, and the point of a belief, must be of
    norm 1 within 1e-6. ``a``, from 0 to 1, and ``b > 0`` are those of `to_rodrigues`.
    ``transported``: the covariance follows the reference after an update. ``axes`` of the tangents:
    "body", or "reference", those from which a quaternion leads to the body.

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
    """Quaternions ``(..., 4)`` of norm 1, so that round-off does not add up; ValueError for others
    than unit ones.
    """
    square = np.square(q).sum(-1, keepdims=True)
    if is_concretely_true(np.abs(square - 1.0).max(initial=0.0) > 2.0 * UNIT_TOLERANCE):
        raise ValueError(
            f"state: expected unit quaternions, got a norm of {np.sqrt(square.max()):.6g}"
        )
    return np.asanyarray(q * (1.5 - 0.5 * square))


def _difference(a: float, b: float, body: bool, later: Array, earlier: Array) -> Array:
    back = inverse(earlier)
    return to_rodrigues(multiply(later, back) if body else multiply(back, later), a, b)
