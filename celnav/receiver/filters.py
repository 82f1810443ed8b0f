"""Filters for a moving receiver's log, by name: EKF and UKF with different
treatments of the noise.
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
"""Frequency noise of a temperature-compensated crystal: white (m^2/s) and random walk (m^2/s^3),
for h0 = 2e-19 and h-2 = 2e-20.
"""
OVEN = (LIGHT**2 * 8e-20 / 2.0, 2.0 * np.pi**2 * LIGHT**2 * 4e-23)
"""Frequency noise of an oven-controlled crystal, for h0 = 8e-20 and h-2 = 4e-23: the least noise
that is assumed for any clock.
"""
PHONE = (100.0, 1.0)
"""Process noise of a phone's clock, which may be reset at each epoch: 10 m and
1 m/s in one second.
"""
CLOCKS = {"crystal": CRYSTAL, "phone": PHONE}
OFFSET_WALK = 1e-5
"""Process noise of the offset between two systems' clocks, m^2/s: about 1 m in a day, because
system times and orbits drift.
"""


COMPACT = ("ekf", "ukf", "gate", "huber", "student")
"""Filters with the same result if unmeasured satellites are removed: they have neither memories of
single satellites nor groups.
"""


RATE = np.zeros((8, 8))
"""Matrix A of the motion x' = A x: velocities change positions, and the drift changes the bias."""
RATE[[0, 1, 2, 6], [3, 4, 5, 7]] = 1.0


def transition(dt: float) -> Array:
    """Transition matrix ``(8, 8)`` over ``dt`` seconds, for constant velocity and clock drift."""
    return np.asanyarray(np.eye(8) + dt * RATE)


def process_noise(dt: float, acceleration: float, white: float, walk: float) -> Array:
    """Covariance ``(8, 8)`` of the process noise of an interval ``dt`` (s).

    acceleration: density of the white acceleration, m^2/s^3. white, walk: densities of the clock,
        see `CRYSTAL`.
    """
    density = np.diag([0.0, 0.0, 0.0, *[acceleration] * 3, white, walk])
    # The integral of F(s) D F(s)' over the interval, with F(s) = I + s A: cubic, as A A = 0.
    once = RATE @ density
    return np.asanyarray(
        dt * density + dt**2 / 2.0 * (once + once.T) + dt**3 / 3.0 * (once @ RATE.T)
    )


def hooks(S: int, window: int = 10, systems: int = 1) -> dict[str, tuple[Hook, ...]]:
    """Hooks of each filter, which change the noise of S ranges and S rates before an update; the
    ukf has no hooks.

    ``systems``: number of satellite systems, each of which has a clock.
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
    """Filters for a `Log` by name: ekf, and the names in `hooks`. All are EKF except ukf and aukf.

    second: ``(k, S)``, offsets of the clocks of further systems, as in `celnav.models.pseudorange`;
        None: there is one system.
    acceleration: density of the white acceleration, m^2/s^3. Use 0.01 for a receiver almost at
        rest, and ``a^2 T`` for a receiver that maneuvers with the acceleration a and measures every
        T seconds.
    clock: densities of the clock's process noise, such as `CRYSTAL`. At an epoch at which the clock
        was set, the step is added to the noise.

    Raises
    ------
    ValueError: if ``acceleration`` is not positive.
    """
    if not 0.0 < acceleration < np.inf:
        raise ValueError(
            f"acceleration: expected a positive density in m^2/s^3, got {acceleration!r}"
        )

    def root(_mean: Array, epoch: Epoch) -> Array:
        Q = process_noise(epoch.dt, acceleration, *clock) + epoch.u[3] ** 2 * reset
        return cholesky(
            Q if second is None else block([[Q, 0], [0, OFFSET_WALK * epoch.dt * identity]])
        )

    def matrix(epoch: Epoch) -> Array:
        F = transition(epoch.dt)
        return F if second is None else block([[F, 0], [0, identity]])

    identity = np.eye(0 if second is None else len(second))
    reset = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    motion = Motion(Linear(matrix), sqrt_Q=root)
    sensor = Sensor(
        lambda x, epoch: pseudorange.measure(x, *_sources(epoch)),
        sqrt_R=_noise,
        jacobian=lambda x, epoch: pseudorange.jacobian(x, *_sources(epoch)),
    )
    kinds: dict[str, Sequential] = {"ekf": ekf(motion, sensor, form="covariance")}
    for name, hook in hooks(S, window, 1 + len(identity)).items():
        if name in ("ukf", "aukf"):
            kinds[name] = ukf(motion, sensor, beta=2.0, form="covariance", hooks=hook)
        else:
            kinds[name] = ekf(motion, sensor, form="covariance", hooks=hook)
    return kinds


def _sources(epoch: Epoch) -> tuple[Array, ...]:
    """Sources of the measurements at an epoch: q, w and, with several systems, offsets."""
    q, w, _, _, *offsets = epoch.u
    return q, w, *offsets


def _noise(_mean: Array, epoch: Epoch) -> Array:
    return np.asarray(np.eye(epoch.u[2].shape[-1]) * epoch.u[2])
