"""Earth orbits: accelerations, short and long steps, Kepler elements. Units: km, km/s, s, rad.

States ``(..., 6)`` are position, then velocity, in an Earth-centered inertial equatorial frame.
Filters call `acceleration`, `third_body`, `step` (for seconds), `advance` and `flow` (for minutes)
at every step; these do not check their arguments.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from celnav.gaussian.checks import LIMIT, finite, instance, integer, number
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import component_major, points_last


class UnitWarning(UserWarning):
    """Warning of a value that is possible, but suggests another unit."""


def warn_of_degrees(name: str, angles: ArrayLike) -> None:
    """Warn (`UnitWarning`) of angles beyond a full turn, which are probably in degrees."""
    size = np.abs(angles)
    if (size > 2.0 * np.pi + 1e-9).any():
        text = f"{name}: {np.nanmax(size):.6g} rad is more than a full turn; angles are in radians"
        warnings.warn(text, UnitWarning, stacklevel=3)


@dataclass(frozen=True)
class Earth:
    """Gravitational parameter ``mu`` km^3/s^2, equatorial ``radius_km``, and ``j2`` (0 for the
    two-body problem); numbers, or arrays with one number per run.
    """

    mu: float = 398600.4418
    radius_km: float = 6378.137
    j2: float = 1.08262668e-3

    def __post_init__(self) -> None:
        finite("j2", self.j2)
        for name in ("mu", "radius_km"):
            if (finite(name, getattr(self, name)) <= 0.0).any():
                raise ValueError(
                    f"{name}: expected a positive number, got {getattr(self, name)!r:.80}"
                )


EARTH = Earth()


def acceleration(position: Array, earth: Earth = EARTH) -> Array:
    """Two-body and J2 acceleration ``(3, ...)`` km/s^2 at positions ``(3, ...)`` km, with the
    *component axis first* [Sun2015, Eq. 38].
    """
    # a_x = k x (1 + 3/2 J2 (R / r)^2 (1 - 5 z^2 / r^2)), k = -mu / r^3; in a_z, 3 replaces 1.
    squares = position * position
    inverse = 1.0 / np.add.reduce(squares)
    k = (-earth.mu * inverse) * np.sqrt(inverse)
    oblate = ((earth.j2 * earth.radius_km**2) * k) * inverse
    out = position * (k - oblate * ((7.5 * squares[2]) * inverse - 1.5))
    out[2] += (3.0 * oblate) * position[2]
    return np.asanyarray(out)


def third_body(position: Array, body: Array, gm: float) -> Array:
    """Acceleration ``(..., 3)`` km/s^2 of a satellite due to a third body with ``gm`` km^3/s^2.

    position, body: geocentric, ``(..., 3)`` km. The formula avoids the difference of two nearly
    equal attractions [Battin1987, Eqs. 8.60-8.62].
    """
    q = ((position * (position - 2.0 * body)).sum(-1) / np.square(body).sum(-1))[..., None]
    f = q * (3.0 + q * (3.0 + q)) / (1.0 + (1.0 + q) ** 1.5)
    cube = np.square(position - body).sum(-1)[..., None] ** 1.5
    return np.asanyarray(-gm / cube * (position + f * body))


def step(state: Array, dt: float, earth: Earth = EARTH) -> Array:
    """State ``(..., 6)`` after ``dt`` seconds: one Runge-Kutta step of order 4.

    After 600 steps of 1 s in a low orbit the error is below 5e-8 m.

    >>> motion = celnav.Motion(lambda x, epoch: orbit.step(x, epoch.dt), Q)
    """
    x = component_major(state)
    position, velocity, half = x[:3], x[3:], 0.5 * dt
    # Runge-Kutta for r'' = a(r), where the velocities of the stages are eliminated.
    ahead, end = position + half * velocity, position + dt * velocity
    a1 = acceleration(position, earth)
    a2 = acceleration(ahead, earth)
    a3 = acceleration(ahead + (half * half) * a1, earth)
    a4 = acceleration(end + (half * dt) * a2, earth)
    middle = a2 + a3
    out = np.empty_like(x)
    out[:3] = end + (dt * dt / 6.0) * (a1 + middle)
    out[3:] = velocity + (dt / 6.0) * (a1 + 2.0 * middle + a4)
    return points_last(out)


def transition(state: Array, dt: float, earth: Earth = EARTH) -> Array:
    """State transition matrix ``(..., 6, 6)`` of `step`, by central differences with steps of 1 km
    and 1 m/s, accurate to 1e-9.
    """
    h = np.repeat([1.0, 1e-3], 3)
    # (12, 6): plus and minus a step along each axis.
    shifted = np.concatenate([np.diag(h), -np.diag(h)])
    y = step(state[..., None, :] + shifted, dt, earth)
    return (y[..., :6, :] - y[..., 6:, :]).mT / (2.0 * h)


def check_orbit(state: ArrayLike, name: str = "state", earth: Earth = EARTH) -> Array:
    """Check an orbital state ``(..., 6)`` km, km/s and return it; ValueError if it is not finite or
    at the center of the Earth.

    It warns (`UnitWarning`) of a position inside the Earth, and of a radius or speed that suggests
    other units.
    """
    instance("earth", earth, Earth, "an Earth, such as celnav.models.orbit.EARTH")
    x = finite(name, state, (..., 6))
    r, v = np.linalg.norm(x[..., :3], axis=-1), np.linalg.norm(x[..., 3:], axis=-1)
    if (r == 0.0).any():
        raise ValueError(
            f"{name}: expected a position away from the center of the Earth, got r = 0"
        )
    if (r < earth.radius_km - 378.0).any():
        warnings.warn(
            f"{name}: a radius of {r.min():.6g} km lies inside the Earth; positions are in km",
            UnitWarning,
            stacklevel=2,
        )
    if (v > np.sqrt(2.0 * earth.mu / r) * 3.0).any() or (r > 1e7).any():
        text = (
            f"{name}: r = {r.max():.6g} km with a speed of {v.max():.6g} km/s is not an Earth "
            "orbit; units are km and km/s"
        )
        warnings.warn(text, UnitWarning, stacklevel=2)
    return x


def propagate(state: ArrayLike, dt: float, steps: int, earth: Earth = EARTH) -> Array:
    """States ``(steps + 1, ..., 6)`` at equal intervals of ``dt`` seconds, the start first."""
    out = [check_orbit(state, earth=earth)]
    dt, steps = number("dt", dt), integer("steps", steps, 0, LIMIT // max(out[0].size, 1))
    for _ in range(steps):
        out.append(step(out[-1], dt, earth))
    return np.stack(out)


def from_elements(
    a: float,
    e: float,
    i: float,
    raan: float,
    argp: float,
    true_anomaly: float,
    earth: Earth = EARTH,
) -> Array:
    """State ``(6,)`` km, km/s from Kepler elements: semi-major axis ``a > 0`` km, eccentricity
    ``0 <= e < 1``, and angles in rad.
    """
    instance("earth", earth, Earth, "an Earth, such as celnav.models.orbit.EARTH")
    a, e = number("a", a, above=0.0), number("e", e, 0.0, below=1.0)
    for name, angle in (("i", i), ("raan", raan), ("argp", argp), ("true_anomaly", true_anomaly)):
        warn_of_degrees(name, number(name, angle))
    p = a * (1.0 - e * e)
    c, s = np.cos(true_anomaly), np.sin(true_anomaly)
    r, speed = p / (1.0 + e * c), np.sqrt(earth.mu / p)
    cO, sO, ci, si, cw, sw = (
        np.cos(raan),
        np.sin(raan),
        np.cos(i),
        np.sin(i),
        np.cos(argp),
        np.sin(argp),
    )
    perigee = np.array([cO * cw - sO * sw * ci, sO * cw + cO * sw * ci, sw * si])
    along = np.array([-cO * sw - sO * cw * ci, -sO * sw + cO * cw * ci, cw * si])
    return np.concatenate([r * (c * perigee + s * along), speed * (-s * perigee + (e + c) * along)])


def to_elements(state: ArrayLike, earth: Earth = EARTH) -> Array:
    """Kepler elements ``(..., 6)`` of bound orbits: a (km), e, i, raan, argp, true anomaly (rad,
    from 0 to 2 pi).

    A circular orbit gets argp = 0, and an equatorial orbit raan = 0.
    """
    x = check_orbit(state, earth=earth)
    r, v = x[..., :3], x[..., 3:]
    radius = np.linalg.norm(r, axis=-1, keepdims=True)
    # h = r x v, and e = v x h / mu - r / |r| points to the perigee.
    h = np.cross(r, v)
    size = np.linalg.norm(h, axis=-1)
    e = np.cross(v, h) / earth.mu - r / radius
    eccentricity = np.linalg.norm(e, axis=-1)
    node = np.stack([-h[..., 1], h[..., 0], np.zeros_like(size)], -1)
    equatorial = np.linalg.norm(node, axis=-1) < 1e-11 * size
    node = np.where(equatorial[..., None], [1.0, 0.0, 0.0], node)
    perigee = np.where((eccentricity < 1e-11)[..., None], node, e)

    def angle(start: Array, end: Array) -> Array:
        """Angle from start to end, in the direction of the motion."""
        return np.asanyarray(
            np.arctan2(np.vecdot(np.cross(start, end), h) / size, np.vecdot(start, end))
            % (2.0 * np.pi)
        )

    a = 1.0 / (2.0 / radius[..., 0] - np.vecdot(v, v) / earth.mu)
    inclination = np.arctan2(np.hypot(h[..., 0], h[..., 1]), h[..., 2])
    raan = np.arctan2(node[..., 1], node[..., 0]) % (2.0 * np.pi)
    return np.stack(
        [a, eccentricity, inclination, raan, angle(node, perigee), angle(perigee, r)], -1
    )


# -- long steps, and the derivatives that filters need ---------------------------------------------
# Picard iteration fits one polynomial to the accelerations at the Gauss-Lobatto nodes of a step.
# It evaluates all nodes of all runs together, in few calls with long arrays.
class Flow(NamedTuple):
    """State ``(..., 6)`` after a step, its transition matrix ``Phi (..., 6, 6)``, and the effect
    ``G (..., 6, 6)`` of a constant disturbance.

    ``x(T) = f(x(0)) + G W`` for a constant disturbance ``W`` of the state's derivative, with
    ``dPhi/dt = A Phi`` and ``dG/dt = A G + I``.
    """

    state: Array
    Phi: Array
    G: Array


class Nodes(NamedTuple):
    """Gauss-Lobatto nodes ``(N,)`` in [0, 1], and matrices ``(N, N)`` that integrate once and twice
    from 0 to each node, exactly up to degree N - 1.
    """

    at: Array
    once: Array
    twice: Array


def _lobatto(count: int) -> Nodes:
    top = np.eye(count)[-1]
    x = np.concatenate([[-1.0], np.sort(legendre.legroots(legendre.legder(top)).real), [1.0]])
    # Legendre coefficients of the polynomials that are 1 at one node and 0 at the others.
    series = np.linalg.solve(legendre.legvander(x, count - 1), np.eye(count))
    once = 0.5 * legendre.legint(series, lbnd=-1.0)
    twice = 0.5 * legendre.legint(once, lbnd=-1.0)
    return Nodes(
        0.5 * (x + 1.0), *(np.asarray(legendre.legval(x, values).T) for values in (once, twice))
    )


NODES = _lobatto(6)
ROUNDS, ROUNDS_PHI = 6, 3
"""Numbers of Picard iterations for the orbit and for its transition matrix."""
Extra = Callable[[Array, Array], Array]
"""Function ``(positions (3, N, runs) km, times (N,) s after the start of the step)`` that returns
further accelerations ``(3, N, runs)`` km/s^2.
"""


def gradient(position: Array, earth: Earth = EARTH) -> Array:
    """Derivative ``(3, 3, ...)`` of `acceleration` for positions with the component axis first,
    ``(3, ...)``, 1/s^2.
    """
    x, y, z = position
    inverse = 1.0 / np.add.reduce(position * position)
    cube = -earth.mu * inverse * np.sqrt(inverse)
    k = 1.5 * earth.j2 * earth.radius_km**2 * inverse
    s = z * z * inverse
    plain = cube * (1.0 + k * (1.0 - 5.0 * s))
    outer = cube * inverse * (-3.0 - 5.0 * k + 35.0 * k * s)
    mixed = -10.0 * cube * k * inverse * z
    # da/dr = plain I + outer r r', plus terms in z; symmetric.
    out = np.empty((3, *position.shape), like=position)
    out[0, 0], out[1, 1] = plain + outer * x * x, plain + outer * y * y
    out[0, 1] = out[1, 0] = outer * x * y
    out[0, 2] = out[2, 0] = (outer * z + mixed) * x
    out[1, 2] = out[2, 1] = (outer * z + mixed) * y
    out[2, 2] = plain + (outer * z + 2.0 * mixed) * z + 2.0 * cube * k
    return out


def advance(state: Array, dt: float, earth: Earth = EARTH, extra: Extra | None = None) -> Array:
    """State ``(..., 6)`` after ``dt`` seconds; for 300 s in a low orbit the error is 1e-7 m."""
    return _orbit(state, dt, earth, extra)[1]


def flow(state: Array, dt: float, earth: Earth = EARTH, extra: Extra | None = None) -> Flow:
    """`Flow`: `advance` and its derivatives, without the gradient of ``extra``; for 300 s in a low
    orbit they are accurate to 2e-8.
    """
    r, end = _orbit(state, dt, earth, extra)
    A = gradient(r, earth)
    # Rows of the transition matrix for position (Y) and velocity (Z) at the nodes: Y'' = A Y, with
    # Y = [I, t I] as the first iterate.
    times, i = dt * NODES.at[:, None], np.arange(3)
    twice, once = dt * dt * NODES.twice, dt * NODES.once
    bent = np.concatenate([A, times * A], 1)
    for _ in range(ROUNDS_PHI):
        Y = twice @ bent
        Y[i, i] += 1.0
        Y[i, 3 + i] += times
        bent = np.einsum("ij...,jk...->ik...", A, Y)
    Z = once @ bent
    Z[i, 3 + i] += 1.0
    last = np.concatenate([Y[:, :, -1], Z[:, :, -1]])
    # Phi is symplectic, so its blocks give Phi^-1, and the blocks' means give the mean of Phi^-1:
    # G = Phi times the integral of Phi^-1.
    y, z = NODES.once[-1] @ Y, NODES.once[-1] @ Z
    a, b, c, d = (np.swapaxes(block, 0, 1) for block in (y[:, :3], y[:, 3:], z[:, :3], z[:, 3:]))
    inverse = np.concatenate([np.concatenate([d, -b], 1), np.concatenate([-c, a], 1)])
    Phi, mean = (
        np.ascontiguousarray(m.transpose(2, 0, 1)).reshape(*state.shape[:-1], 6, 6)
        for m in (last, inverse)
    )
    return Flow(end, Phi, dt * (Phi @ mean))


def _orbit(state: Array, dt: float, earth: Earth, extra: Extra | None) -> tuple[Array, Array]:
    """Positions ``(3, N, runs)`` at the nodes, and the state ``(..., 6)`` at the end."""
    x = component_major(state).reshape(6, -1)
    times = dt * NODES.at
    start = x[:3, None] + times[:, None] * x[3:, None]
    r = x[:3, None] + np.zeros_like(start)
    twice, once = dt * dt * NODES.twice, dt * NODES.once[-1]
    # Picard: r = r0 + v0 t + the double integral of a(r).
    for _ in range(ROUNDS):
        a = acceleration(r, earth)
        if extra is not None:
            a = a + extra(r, times)
        r = start + twice @ a
    end = np.concatenate([r[:, -1], x[3:] + once @ a])
    return r, end.T.reshape(state.shape)
