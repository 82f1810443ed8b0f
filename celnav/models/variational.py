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

from celnav.gaussian.linalg import Array, components
from celnav.models.orbit import EARTH, Earth, acceleration


class Flow(NamedTuple):
    """State ``(..., 6)`` after a step, transition ``Phi (..., 6, 6)`` and the effect ``G (..., 6, 6)`` of a held disturbance."""

    state: Array
    Phi: Array
    G: Array


class Nodes(NamedTuple):
    """Gauss-Lobatto nodes ``(N,)`` of [0, 1], and ``(N, N)`` what integrates once and twice from 0 to each of them.

    Exact for polynomials of degree ``2 N - 3`` over the whole, of degree ``N - 1`` to each node.
    """

    at: Array
    once: Array
    twice: Array


def _lobatto(count: int) -> Nodes:
    top = np.eye(count)[-1]
    x = np.concatenate([[-1.0], np.sort(legendre.legroots(legendre.legder(top)).real), [1.0]])
    series = np.linalg.solve(legendre.legvander(x, count - 1), np.eye(count))  # of the polynomials that are 1 at one node
    once = 0.5 * legendre.legint(series, lbnd=-1.0)
    twice = 0.5 * legendre.legint(once, lbnd=-1.0)
    return Nodes(0.5 * (x + 1.0), *(np.asarray(legendre.legval(x, values).T) for values in (once, twice)))


NODES = _lobatto(6)
ROUNDS, ROUNDS_PHI = 6, 3
"""Picard iterations of the orbit and of its transition."""
Extra = Callable[[Array, Array], Array]
"""Further accelerations ``(3, N, runs)`` km/s^2 of positions of that shape, ``N`` times ``(N,)`` s into the step."""


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


def advance(state: Array, dt: float, earth: Earth = EARTH, extra: Extra | None = None) -> Array:
    """State ``(..., 6)`` after ``dt`` seconds: 300 s, a twentieth of a low orbit, to 1e-7 m."""
    return _orbit(state, dt, earth, extra)[1]


def flow(state: Array, dt: float, earth: Earth = EARTH, extra: Extra | None = None) -> Flow:
    """`advance` with its derivatives, exact to 2e-8 for 300 s in a low orbit; they leave out the gradient of ``extra``."""
    r, end = _orbit(state, dt, earth, extra)
    A = gradient(r, earth)
    # Positions Y and velocities Z of the transition's columns at the nodes: Y'' = A Y, to begin with Y = [I, t I].
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
    # The inverse of the transition, which is symplectic, is made of its blocks: its mean is made of their means.
    y, z = NODES.once[-1] @ Y, NODES.once[-1] @ Z
    a, b, c, d = (np.swapaxes(block, 0, 1) for block in (y[:, :3], y[:, 3:], z[:, :3], z[:, 3:]))
    inverse = np.concatenate([np.concatenate([d, -b], 1), np.concatenate([-c, a], 1)])
    Phi, mean = (np.ascontiguousarray(m.transpose(2, 0, 1)).reshape(*state.shape[:-1], 6, 6) for m in (last, inverse))
    return Flow(end, Phi, dt * (Phi @ mean))


def _orbit(state: Array, dt: float, earth: Earth, extra: Extra | None) -> tuple[Array, Array]:
    """Positions ``(3, N, runs)`` at the nodes, and the state ``(..., 6)`` at the end."""
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
    end = np.concatenate([r[:, -1], x[3:] + once @ a])
    return r, end.T.reshape(state.shape)
