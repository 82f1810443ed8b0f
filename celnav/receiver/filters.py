"""Filters of a moving receiver's log, by name: EKF and UKF, which differ in what they do to the
noise.
"""

from __future__ import annotations

import numpy as np

from celnav.filters.adaptive import (
    channel_parity,
    gate,
    group_parity,
    huber,
    innovation_window,
    sage_husa,
    student_t,
)
from celnav.filters.joint import Hook
from celnav.filters.model import Linear, Motion, Sensor
from celnav.filters.records import Epoch
from celnav.filters.sequential import Sequential, ekf, ukf
from celnav.gaussian.linalg import Array, block, cholesky
from celnav.models import pseudorange
from celnav.models.gnss import LIGHT

CRYSTAL = (LIGHT**2 * 2e-19 / 2.0, 2.0 * np.pi**2 * LIGHT**2 * 2e-20)
"""A compensated crystal's noise of frequency, white (m^2/s) and walking (m^2/s^3): h0 = 2e-19, h-2
= 2e-20.
"""
OVEN = (LIGHT**2 * 8e-20 / 2.0, 2.0 * np.pi**2 * LIGHT**2 * 4e-23)
"""Of a crystal in an oven, h0 = 8e-20, h-2 = 4e-23: a clock that looks better counts as one."""
PHONE = (100.0, 1.0)
"""Of a phone's clock, which may be set anew at each epoch: 10 m and 1 m/s in a second."""
CLOCKS = {"crystal": CRYSTAL, "phone": PHONE}
OFFSET_WALK = 1e-5
"""Of the offset between two systems' clocks, m^2/s: a meter a day, as their times and orbits
wander.
"""


COMPACT = ("ekf", "ukf", "gate", "huber", "student")
"""Filters to which satellites that are not measured make no difference: they have no memory of
single ones, and no groups of them.
"""


RATE = np.zeros((8, 8))
"""Derivative of the state by time: velocities are those of positions, the drift is the clock's."""
RATE[[0, 1, 2, 6], [3, 4, 5, 7]] = 1.0


def transition(dt: float) -> Array:
    """Matrix ``(8, 8)`` of a receiver at constant velocity, with a clock of constant drift, over
    ``dt`` seconds.
    """
    return np.asanyarray(np.eye(8) + dt * RATE)


def process_noise(dt: float, acceleration: float, white: float, walk: float) -> Array:
    """Covariance ``(8, 8)`` of what an interval adds to it.

    ``acceleration``: density of the white acceleration, m^2/s^3. ``white``, ``walk``: of the clock,
        see `CRYSTAL`.
    """
    density = np.diag([0.0, 0.0, 0.0, *[acceleration] * 3, white, walk])
    # The integral of F(s) D F(s)' over the interval, with F(s) = I + s A: cubic, as A A = 0.
    once = RATE @ density
    return np.asanyarray(
        dt * density + dt**2 / 2.0 * (once + once.T) + dt**3 / 3.0 * (once @ RATE.T)
    )


def hooks(S: int, window: int = 10, systems: int = 1) -> dict[str, tuple[Hook, ...]]:
    """What each filter does to the noise of S ranges and S rates before it uses them; the ukf
    nothing.

    ``systems``: of satellites: so many clocks do the ranges determine.
    """
    ranges, rates = range(S), range(S, 2 * S)
    parity = (
        (group_parity((ranges, rates), 4),)
        if systems == 1
        else (group_parity((ranges,), 3 + systems), group_parity((rates,), 4))
    )
    return {
        "ukf": (),
        "aukf": (innovation_window(window),),
        "group": parity,
        "channel": (channel_parity(window),),
        "gate": (gate(4.0),),
        "huber": (huber(),),
        "student": (student_t(4.0),),
        "sage-husa": (sage_husa(0.95),),
    }


def filters(
    S: int,
    *,
    second: Array | None = None,
    acceleration: float = 0.01,
    clock: tuple[float, float] = CRYSTAL,
    window: int = 10,
) -> dict[str, Sequential]:
    """Filters of a `Log` by name: ekf, and those of `hooks`, which are EKF but for ukf and aukf.

    ``second (k, S)``: offsets of the clocks of more systems, as in `celnav.models.pseudorange`;
    None: there is one system. ``acceleration``: density of the white acceleration, m^2/s^3: 0.01
    for a receiver at rest or nearly so, ``a^2 T`` for one that turns with the acceleration a,
    measured each T seconds. ``clock``: densities of its process noise, such as `CRYSTAL`; at an
    epoch to which it was set the step counts as noise, too.

    Raises
    ------
    ValueError: unless it is positive.
    """
    if not 0.0 < acceleration < np.inf:
        raise ValueError(
            f"acceleration: expected a positive density in m^2/s^3, got {acceleration!r}"
        )

    def root(_mean: Array, epoch: Epoch) -> Array:
        Q = process_noise(epoch.dt, acceleration, *clock) + epoch.u[3] ** 2 * reset
        return cholesky(Q if second is None else block([[Q, 0], [0, OFFSET_WALK * epoch.dt * one]]))

    def matrix(epoch: Epoch) -> Array:
        F = transition(epoch.dt)
        return F if second is None else block([[F, 0], [0, one]])

    one = np.eye(0 if second is None else len(second))
    reset = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    motion = Motion(Linear(matrix), sqrt_Q=root)
    sensor = Sensor(
        lambda x, epoch: pseudorange.measure(x, *_sources(epoch)),
        sqrt_R=_noise,
        jacobian=lambda x, epoch: pseudorange.jacobian(x, *_sources(epoch)),
    )
    kinds: dict[str, Sequential] = {"ekf": ekf(motion, sensor, form="covariance")}
    for name, hook in hooks(S, window, 1 + len(one)).items():
        if name in ("ukf", "aukf"):
            kinds[name] = ukf(motion, sensor, beta=2.0, form="covariance", hooks=hook)
        else:
            kinds[name] = ekf(motion, sensor, form="covariance", hooks=hook)
    return kinds


def _sources(epoch: Epoch) -> tuple[Array, ...]:
    """What a measurement depends on besides the state: q, w and, if there are any, offsets."""
    q, w, _, _, *offsets = epoch.u
    return q, w, *offsets


def _noise(_mean: Array, epoch: Epoch) -> Array:
    return np.asarray(np.eye(epoch.u[2].shape[-1]) * epoch.u[2])
