"""Orbits over long steps, with the derivatives that filters ask for. Units: km, km/s, s; states ``(..., 6)`` as in `orbit`.

``x(T) = f(x(0)) + G W`` for a disturbance ``W`` of the rates held over the step, with ``dPhi/dt = A Phi`` and
``dG/dt = A G + I``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from celnav.linalg import Array, components
from celnav.models.orbit import EARTH, Earth, runge_kutta

_CLOSED = np.array([19.0, 75.0, 50.0, 50.0, 75.0, 19.0]) / 288.0
"""Newton-Cotes weights of six equally spaced points, exact for polynomials of degree 5."""
INTERVALS = 5
"""Steps of the variational equations, of two substeps of the orbit each."""


class Flow(NamedTuple):
    """State ``(..., 6)`` after a step, transition ``Phi (..., 6, 6)`` and the effect ``G (..., 6, 6)`` of a held disturbance."""

    state: Array
    Phi: Array
    G: Array


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


def advance(state: Array, dt: float, earth: Earth = EARTH) -> Array:
    """State ``(..., 6)`` after ``dt`` seconds, in ten substeps: 300 s in a low orbit to 0.2 m."""
    x = components(state)
    r, v = x[:3], x[3:]
    for _ in range(2 * INTERVALS):
        r, v = runge_kutta(r, v, dt / (2 * INTERVALS), earth)
    return np.moveaxis(np.concatenate([r, v]), 0, -1)


def flow(state: Array, dt: float, earth: Earth = EARTH) -> Flow:
    """`advance` with its derivatives; those are exact to 1e-6 for 300 s in a low orbit."""
    x = components(state)
    r, v = x[:3], x[3:]
    batch = x.shape[1:]
    h = dt / INTERVALS
    # Positions Y and velocities Z of the transition's columns: Y'' = A Y.
    Y, Z = (np.zeros((3, 6, *batch)) for _ in range(2))
    for i in range(3):
        Y[i, i] = Z[i, 3 + i] = 1.0
    A = gradient(r, earth)
    inverses = _CLOSED[0] * _inverse(Y, Z)
    for k in range(INTERVALS):
        r, v = runge_kutta(r, v, 0.5 * h, earth)
        middle = gradient(r, earth)
        r, v = runge_kutta(r, v, 0.5 * h, earth)
        last = gradient(r, earth)
        a1 = _times(A, Y)
        ahead = Y + (0.5 * h) * Z
        a2 = _times(middle, ahead)
        a3 = _times(middle, ahead + (0.25 * h * h) * a1)
        end = Y + h * Z
        a4 = _times(last, end + (0.5 * h * h) * a2)
        both = a2 + a3
        Y, Z, A = end + (h * h / 6.0) * (a1 + both), Z + (h / 6.0) * (a1 + 2.0 * both + a4), last
        inverses += _CLOSED[k + 1] * _inverse(Y, Z)
    Phi = _matrices(np.concatenate([Y, Z]))
    return Flow(np.moveaxis(np.concatenate([r, v]), 0, -1), Phi, dt * (Phi @ _matrices(inverses)))


def _times(A: Array, Y: Array) -> Array:
    """Products of matrices ``(3, 3, ...)`` and ``(3, 6, ...)``."""
    return np.stack([A[i, 0] * Y[0] + A[i, 1] * Y[1] + A[i, 2] * Y[2] for i in range(3)])


def _inverse(Y: Array, Z: Array) -> Array:
    """Inverse ``(6, 6, ...)`` of the transition, which is symplectic: its blocks, transposed."""
    a, b, c, d = (np.swapaxes(block, 0, 1) for block in (Y[:, :3], Y[:, 3:], Z[:, :3], Z[:, 3:]))
    return np.concatenate([np.concatenate([d, -b], 1), np.concatenate([-c, a], 1)])


def _matrices(rows: Array) -> Array:
    """From ``(6, 6, ...)`` to ``(..., 6, 6)``."""
    return np.ascontiguousarray(np.moveaxis(rows, (0, 1), (-2, -1)))
