"""Orbits over long steps, with the derivatives that filters ask for. Units: km, km/s, s; states ``(..., 6)`` as in `orbit`.

``x(T) = f(x(0)) + G W`` for a disturbance ``W`` of the rates held over the step, with ``dPhi/dt = A Phi`` and
``dG/dt = A G + I``.

A step is one polynomial through the accelerations at Gauss-Lobatto nodes, found by Picard iteration. All nodes of all runs are
evaluated together: few calls on long arrays, where Runge-Kutta makes many on short ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from celnav.gaussian.checks import integer
from celnav.gaussian.linalg import Array, components
from celnav.models.orbit import EARTH, Earth, acceleration


class Flow(NamedTuple):
    """State ``(..., 6)`` after a step, transition ``Phi (..., 6, 6)`` and the effect ``G (..., 6, 6)`` of a held disturbance."""

    state: Array
    Phi: Array
    G: Array


class Nodes(NamedTuple):
    """Gauss-Lobatto nodes ``(N,)`` of [0, 1], and ``(N, N)`` what integrates once and twice from 0 to each of them."""

    at: Array
    once: Array
    twice: Array


def lobatto(count: int) -> Nodes:
    """Nodes, exact for polynomials of degree ``2 count - 3`` over the whole, of degree ``count - 1`` to each node."""
    count = integer("count", count, 2, 100)
    top = np.eye(count)[-1]
    x = np.concatenate([[-1.0], np.sort(legendre.legroots(legendre.legder(top)).real), [1.0]])
    series = np.linalg.solve(legendre.legvander(x, count - 1), np.eye(count))  # of the polynomials that are 1 at one node
    once = 0.5 * legendre.legint(series, lbnd=-1.0)
    twice = 0.5 * legendre.legint(once, lbnd=-1.0)
    return Nodes(0.5 * (x + 1.0), *(np.asarray(legendre.legval(x, values).T) for values in (once, twice)))


NODES = lobatto(6)
ROUNDS, ROUNDS_PHI = 6, 3
"""Picard iterations of the orbit and of its transition."""


def gradient(position: Array, earth: Earth = EARTH) -> Array:
    """Derivative ``(3, 3, ...)`` of `orbit.acceleration` for positions with the component axis first, ``(3, ...)``, 1/s^2."""
    x, y, z = position
    inverse = 1.0 / np.add.reduce(position * position)
    cube = -earth.mu * inverse * np.sqrt(inverse)
    k = 1.5 * earth.j2 * earth.radius_km**2 * inverse
    s = z * z * inverse
    plain = cube * (1.0 + k * (1.0 - 5.0 * s))
    outer = cube * inverse * (-3.0 - 5.0 * k + 35.0 * k * s)
    mixed = -10.0 * cube * k * inverse * z
    out = np.empty((3, *position.shape))
    out[0, 0], out[1, 1] = plain + outer * x * x, plain + outer * y * y
    out[0, 1] = out[1, 0] = outer * x * y
    out[0, 2] = out[2, 0] = (outer * z + mixed) * x
    out[1, 2] = out[2, 1] = (outer * z + mixed) * y
    out[2, 2] = plain + (outer * z + 2.0 * mixed) * z + 2.0 * cube * k
    return out


Extra = Callable[[Array, Array], Array]
"""Further accelerations ``(3, N, runs)`` km/s^2 of positions of that shape, ``N`` times ``(N,)`` s into the step."""


def advance(state: Array, dt: float, earth: Earth = EARTH, extra: Extra | None = None) -> Array:
    """State ``(..., 6)`` after ``dt`` seconds: 300 s, a twentieth of a low orbit, to 1e-7 m."""
    r, _, end = _orbit(state, dt, earth, extra)
    return _states(r, end, state.shape)


def flow(state: Array, dt: float, earth: Earth = EARTH, extra: Extra | None = None) -> Flow:
    """`advance` with its derivatives, exact to 2e-8 for 300 s in a low orbit; they leave out the gradient of ``extra``."""
    r, _, end = _orbit(state, dt, earth, extra)
    A = gradient(r, earth)
    # Positions Y and velocities Z of the transition's columns at the nodes: Y'' = A Y, to begin with Y = [I, t I].
    times = dt * NODES.at[:, None]
    twice, once = dt * dt * NODES.twice, dt * NODES.once
    bent = np.concatenate([A, times * A], 1)
    for _ in range(ROUNDS_PHI):
        Y = twice @ bent
        for i in range(3):
            Y[i, i] += 1.0
            Y[i, 3 + i] += times
        bent = _times(A, Y)
    Z = once @ bent
    for i in range(3):
        Z[i, 3 + i] += 1.0
    last = np.concatenate([Y[:, :, -1], Z[:, :, -1]])
    # The inverse of the transition, which is symplectic, is made of its blocks: its mean is made of their means.
    y, z = NODES.once[-1] @ Y, NODES.once[-1] @ Z
    a, b, c, d = (np.swapaxes(block, 0, 1) for block in (y[:, :3], y[:, 3:], z[:, :3], z[:, 3:]))
    inverse = np.concatenate([np.concatenate([d, -b], 1), np.concatenate([-c, a], 1)])
    Phi = _matrices(last, state.shape)
    return Flow(_states(r, end, state.shape), Phi, dt * (Phi @ _matrices(inverse, state.shape)))


def _orbit(state: Array, dt: float, earth: Earth, extra: Extra | None) -> tuple[Array, Array, Array]:
    """Positions ``(3, N, runs)`` and accelerations at the nodes, velocity ``(3, runs)`` at the end."""
    x = components(state).reshape(6, -1)
    times = dt * NODES.at
    start = x[:3, None] + times[:, None] * x[3:, None]
    r = x[:3, None] + np.zeros_like(start)
    twice, once = dt * dt * NODES.twice, dt * NODES.once[-1]
    for _ in range(ROUNDS):
        a = acceleration(r, earth)
        if extra is not None:
            a = a + extra(r, times)
        r = start + twice @ a
    return r, a, x[3:] + once @ a


def _times(A: Array, Y: Array) -> Array:
    """Products of matrices ``(3, 3, ...)`` and ``(3, 6, ...)``."""
    out = np.empty_like(Y)
    for i in range(3):
        np.multiply(A[i, 0], Y[0], out=out[i])
        out[i] += A[i, 1] * Y[1]
        out[i] += A[i, 2] * Y[2]
    return out


def _states(r: Array, v: Array, shape: tuple[int, ...]) -> Array:
    """States of that shape from positions at the nodes and velocities at the end."""
    return np.concatenate([r[:, -1], v]).T.reshape(shape)


def _matrices(rows: Array, shape: tuple[int, ...]) -> Array:
    """From ``(6, 6, runs)`` to ``(..., 6, 6)``."""
    return np.ascontiguousarray(rows.transpose(2, 0, 1)).reshape(*shape[:-1], 6, 6)
