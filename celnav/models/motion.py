"""Kinematic motions of vehicles and targets [BarShalom2001]: constant velocity, constant
acceleration, coordinated turns.

Each is a `celnav.Motion` with white noise in continuous time, discretized exactly for any interval:
two steps equal one step over both. States have positions first, then velocities, then
accelerations, each for all axes: ``[x, y, vx, vy]``. Any units work; m and s are used below.
Intervals may differ from epoch to epoch and from run to run (``epoch.dt``).
"""

from __future__ import annotations

from functools import partial
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.model import Linear, Motion
from celnav.gaussian.attitude import turn_coefficients
from celnav.gaussian.checks import finite, integer, number
from celnav.gaussian.linalg import Array

MOST_AXES = 100


def constant_velocity(dim: int, q: ArrayLike) -> Motion:
    """Nearly constant velocity: the acceleration is white noise. States ``(..., 2 dim)`` are
    positions and velocities.

    q: spectral density of the acceleration, m^2/s^3, one number or ``(dim,)``. Over T s the
        standard deviation of a velocity change is ``sqrt(q T)``.

    >>> motion = celnav.models.motion.constant_velocity(2, q=0.1)
    """
    return _chain(dim, 2, q)


def constant_acceleration(dim: int, q: ArrayLike) -> Motion:
    """Nearly constant acceleration: the jerk is white noise. States ``(..., 3 dim)`` are positions,
    velocities and accelerations.

    q: spectral density of the jerk, m^2/s^5, one number or ``(dim,)``. Over T s the standard
        deviation of an acceleration change is ``sqrt(q T)``.

    >>> motion = celnav.models.motion.constant_acceleration(3, q=1e-4)
    """
    return _chain(dim, 3, q)


def known_turn(rate: float, q: float) -> Motion:
    """A turn in a plane at a known rate: the velocity rotates, and the acceleration is white noise.
    States ``(..., 4)`` are ``[x, y, vx, vy]``.

    rate: turn rate from x to y, rad/s; 0 gives `constant_velocity`.
    q: spectral density of the acceleration, m^2/s^3.

    >>> motion = celnav.models.motion.known_turn(rate=np.radians(3.0), q=0.1)
    """
    turn_rate, amplitude = np.array(number("rate", rate)), np.sqrt(number("q", q, 0.0))
    return Motion(
        Linear(partial(_known_turn, turn_rate)),
        sqrt_Q=partial(_known_turn_noise, turn_rate, amplitude),
    )


def _known_turn(rate: Array, epoch: Any) -> Array:
    return _turned(rate, _interval(epoch))


def _known_turn_noise(rate: Array, amplitude: Array, _mean: Array, epoch: Any) -> Array:
    return np.asanyarray(amplitude * _pushed(rate, _interval(epoch)))


def coordinated_turn(q: float, q_rate: float) -> Motion:
    """A turn in a plane at a rate that is a random walk. States ``(..., 5)`` are
    ``[x, y, vx, vy, rate]``.

    q: spectral density of the acceleration, m^2/s^3, discretized exactly for the estimated rate.
    q_rate: spectral density of the rate's derivative, rad^2/s^3. A change of the rate within an
        interval affects the velocity only after the interval.

    >>> motion = celnav.models.motion.coordinated_turn(q=0.1, q_rate=1e-5)
    """
    amplitude, change = np.sqrt(number("q", q, 0.0)), np.sqrt(number("q_rate", q_rate, 0.0))
    return Motion(_turn, sqrt_Q=partial(_turn_noise, amplitude, change), jacobian=_turn_jacobian)


def _turn(x: Array, epoch: Any) -> Array:
    # p' = p + [[a, -b], [b, a]] v, and v' = [[c, -s], [s, c]] v.
    a, b, c, s, _, _ = _angles(x[..., 4], epoch.dt)
    vx, vy = x[..., 2], x[..., 3]
    parts = (
        x[..., 0] + a * vx - b * vy,
        x[..., 1] + b * vx + a * vy,
        c * vx - s * vy,
        s * vx + c * vy,
        x[..., 4],
    )
    return np.stack(parts, -1)


def _turn_jacobian(mean: Array, epoch: Any) -> Array:
    a, b, c, s, da, db = _angles(mean[..., 4], epoch.dt)
    vx, vy, T = mean[..., 2], mean[..., 3], epoch.dt
    zero = 0.0 * a
    one = zero + 1.0
    rows = (
        # Rows x, y, vx, vy, rate; the last column is the derivative with respect to the rate.
        (one, zero, a, -b, da * vx - db * vy),
        (zero, one, b, a, db * vx + da * vy),
        (zero, zero, c, -s, -T * (s * vx + c * vy)),
        (zero, zero, s, c, T * (c * vx - s * vy)),
        (zero, zero, zero, zero, one),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _turn_noise(amplitude: Array, change: Array, mean: Array, epoch: Any) -> Array:
    T = _interval(epoch)
    # (..., 5, 5): acceleration noise, and rate noise in the last column.
    pushed = _WIDER @ _pushed(mean[..., 4], T) @ _WIDER.T
    return np.asanyarray(amplitude * pushed + change * np.sqrt(T) * _LAST)


_WIDER, _LAST = np.eye(5, 4), np.diag([0.0, 0.0, 0.0, 0.0, 1.0])
_J = np.array([[0.0, -1.0], [1.0, 0.0]])


def _blocks(i: int, j: int) -> tuple[Array, Array]:
    """The identity and a quarter turn as block ``i, j`` of ``(4, 4)``."""
    at = np.zeros((2, 2))
    at[i, j] = 1.0
    return np.kron(at, np.eye(2)), np.kron(at, _J)


(_PP, _PP_J), (_PV, _PV_J), (_VP, _), (_VV, _VV_J) = (
    _blocks(0, 0),
    _blocks(0, 1),
    _blocks(1, 0),
    _blocks(1, 1),
)


def _interval(epoch: Any) -> Array:
    """The epoch's interval ``(..., 1, 1)`` s, ready to multiply matrices."""
    dt: Any = np.multiply(epoch.dt, 1.0)
    return np.asanyarray(dt[..., None, None])


def _chain(dim: int, order: int, q: ArrayLike) -> Motion:
    """White noise integrated ``order`` times on each axis."""
    axes = integer("dim", dim, 1, MOST_AXES)
    densities = finite("q", q)
    if densities.shape not in ((), (axes,)) or (densities < 0.0).any():
        raise ValueError(f"q: expected a spectral density >= 0, or {axes} of them, got {q!r:.80}")
    # F = sum over k of T^k / k! on the k-th block above the diagonal.
    terms = [np.kron(np.eye(order, k=k) / factorial(k), np.eye(axes)) for k in range(order)]
    # Noise over T is T^(a + 1/2) times noise over 1 s, for the a-th integral of the driven state.
    a = np.arange(order)[::-1]
    once = [factorial(k) for k in a.tolist()]
    root = np.linalg.cholesky(1.0 / (np.multiply.outer(once, once) * (np.add.outer(a, a) + 1.0)))
    amplitude = np.sqrt(np.broadcast_to(densities, axes))
    columns = [
        np.kron(np.where((a == k)[:, None], root, 0.0), np.diag(amplitude)) for k in range(order)
    ]
    return Motion(
        Linear(partial(_polynomial, tuple(terms))), sqrt_Q=partial(_chain_noise, tuple(columns))
    )


def _chain_noise(columns: tuple[Array, ...], _mean: Array, epoch: Any) -> Array:
    return np.asanyarray(np.sqrt(_interval(epoch)) * _polynomial(columns, epoch))


def _polynomial(terms: tuple[Array, ...], epoch: Any) -> Array:
    """The sum of ``terms[k] T^k`` for an interval T."""
    total, T = terms[-1], _interval(epoch)
    for term in terms[-2::-1]:
        total = term + T * total
    return total


def _angles(rate: Array, T: Any) -> tuple[Array, ...]:
    """Over an interval: ``sin(rate T) / rate``, ``(1 - cos(rate T)) / rate``, cosine and sine; and
    the derivatives of the first two with respect to the rate.
    """
    theta = rate * T
    first, second = turn_coefficients(theta * theta)
    sinc = 1.0 - second * theta * theta
    return (
        T * sinc,
        T * theta * first,
        np.cos(theta),
        np.sin(theta),
        T * T * theta * (second - first),
        T * T * (sinc - first),
    )


def _turned(rate: Array, T: Array) -> Array:
    """Transition matrix ``(..., 4, 4)`` of a turn."""
    a, b, c, s, _, _ = _angles(rate[..., None, None], T)
    return np.asanyarray(_PP + a * _PV + b * _PV_J + c * _VV + s * _VV_J)


def _pushed(rate: Array, T: Array) -> Array:
    """Root ``(..., 4, 4)`` of the covariance from white acceleration of density 1 in a turn."""
    theta = rate[..., None, None] * T
    first, second = turn_coefficients(theta * theta)
    residual = np.sqrt(2.0 * second - first * first - (theta * second) ** 2)
    return np.asanyarray(
        np.sqrt(T) * (T * (first * _PP - theta * second * _PP_J + residual * _PV) + _VP)
    )
