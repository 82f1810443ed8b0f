"""Motion and clock of a receiver: constant velocity, driven by white acceleration, and a clock whose frequency wanders.

State: position (m), velocity (m/s), clock bias (m) and drift (m/s), as in `celnav.models.pseudorange`.
"""

from __future__ import annotations

import math

import numpy as np

from celnav.gaussian.checks import numbers
from celnav.gaussian.linalg import Array
from celnav.models.beidou import LIGHT

CRYSTAL = (LIGHT**2 * 2e-19 / 2.0, 2.0 * np.pi**2 * LIGHT**2 * 2e-20)
"""A compensated crystal's noise of frequency, white (m^2/s) and walking (m^2/s^3): h0 = 2e-19, h-2 = 2e-20."""

GROUND_M = (6.3e6, 1e7)
"""From the middle of the Earth, where receivers are: near its surface or in a low orbit."""


def transition(dt: float) -> Array:
    """Over an interval, ``(8, 8)``."""
    F = np.eye(8)
    F[:3, 3:6] = dt * np.eye(3)
    F[6, 7] = dt
    return F


def process_noise(dt: float, acceleration: float, white: float, walk: float) -> Array:
    """Covariance over an interval, ``(8, 8)``.

    ``acceleration``: density of the white acceleration, m^2/s^3. ``white``, ``walk``: of the clock, see `CRYSTAL`.
    """
    Q, block = np.zeros((8, 8)), np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    Q[:6, :6] = acceleration * np.kron(block, np.eye(3))
    Q[6:, 6:] = walk * block
    Q[6, 6] += white * dt
    return Q


def on_earth(name: str, position: Array) -> None:
    """Check that a position ``(3,)`` may be a receiver's.

    Raises
    ------
    ValueError: naming it, unless it is in Earth-fixed meters, near the surface or in a low orbit.
    """
    position = numbers(name, position, (3,))
    if not GROUND_M[0] < math.hypot(*position) < GROUND_M[1]:  # nan is in no interval
        raise ValueError(f"{name}: expected Earth-fixed meters, 6300 to 10000 km from the middle, got {position}")
