"""Pseudoranges and range rates: satellite positions at emission, and the measurements of a
receiver.

Positions are in m on the Earth-fixed axes at reception. Clock errors are multiplied by the speed of
light (m, m/s). The state of a receiver is ``(p, v, b, d)``: position, velocity, clock bias and
clock drift. With k more satellite systems it is ``(p, v, b, d, o_1, ..., o_k)``; ranges of system j
have the bias ``b + o_j``. Row j of ``offsets (k, S)`` is 1 for satellites of system j, 0 for the
others. A measurement has all ranges first, then all range rates.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.models.gnss import (
    LIGHT,
    ROTATION_RATE,
    Broadcast,
    SatelliteState,
    satellites,
    spun,
    turned,
)


class Sources(NamedTuple):
    """Satellites as seen by a receiver.

    q: ``(..., S, 3)`` m, positions at emission on the Earth-fixed axes at reception.
    w: ``(..., S, 3)`` m/s, effective velocities: the range rate is ``e.(w - v)``, with the unit
        vector e to q.
    clock, drift: ``(..., S)`` m and m/s.
    """

    q: Array
    w: Array
    clock: Array
    drift: Array


def sources(
    broadcast: Broadcast, t: Array | float, position: Array, velocity: Array | float = 0.0
) -> Sources:
    """`Sources`: all satellites for a receiver at ``position (..., 3)`` m with ``velocity`` (m/s),
    at times of reception ``t (...)`` s BDT.

    A position error of 10 m changes the result by less than 1e-5 m; a velocity error of 10 m/s has
    an even smaller effect.
    """
    when, place = np.asarray(t, dtype=np.float64)[..., None], np.asarray(position)[..., None, :]
    delay = np.asarray(0.08)
    # Light time: delay = |q - p| / c, with q on the axes that the Earth has after the delay.
    for _ in range(4):
        state = satellites(broadcast, when - delay)
        q = turned(state.position, ROTATION_RATE * delay)
        delay = np.linalg.norm(q - place, axis=-1) / LIGHT
    return _seen(state, q, delay, place, _beside(velocity))


def emitted(
    broadcast: Broadcast,
    t: Array | float,
    pseudorange: Array,
    position: Array,
    velocity: Array | float = 0.0,
) -> Sources:
    """`Sources` from measured pseudoranges ``(..., S)`` m at the time ``t (...)`` of the receiver's
    clock, whose error cancels.

    ``position (..., 3)`` m gives the Earth's rotation during the signal's travel: an error of 1 km
    changes satellite positions by 1 cm.
    """
    when = np.asarray(t, dtype=np.float64)[..., None]
    return emitted_each(
        broadcast, when, pseudorange, np.asarray(position)[..., None, :], _beside(velocity)
    )


def emitted_each(
    broadcast: Broadcast,
    t: Array,
    pseudorange: Array,
    position: Array,
    velocity: Array | float = 0.0,
) -> Sources:
    """`emitted` with a time ``(..., S)``, a position and a velocity ``(..., S, 3)`` for each
    satellite.
    """
    sent = t - pseudorange / LIGHT
    state = satellites(broadcast, sent - satellites(broadcast, sent).clock)
    q = state.position
    for _ in range(3):
        delay = np.linalg.norm(q - position, axis=-1) / LIGHT
        q = turned(state.position, ROTATION_RATE * delay)
    return _seen(state, q, delay, position, velocity)


def _beside(velocity: Array | float) -> Any:
    """A velocity ``(..., 3)`` with an axis for the satellites."""
    return np.asarray(velocity)[..., None, :] if np.ndim(velocity) else velocity


def _seen(
    state: SatelliteState, q: Array, delay: Array, place: Array, velocity: Array | float
) -> Sources:
    """`Sources` whose effective velocities include the Doppler factor ``1 / (1 + e.v_i / c)``."""
    # The rate of the range is e.(v_s - v) / (1 + e.v_i / c), with v_i the inertial velocity.
    moved = turned(state.velocity, ROTATION_RATE * delay)
    inertial = moved + spun(q, ROTATION_RATE)
    away = q - place
    e = away / np.linalg.norm(away, axis=-1, keepdims=True)
    rate = (e * (moved - velocity)).sum(-1) / (1.0 + (e * inertial).sum(-1) / LIGHT)
    return Sources(
        q, moved - rate[..., None] / LIGHT * inertial, LIGHT * state.clock, LIGHT * state.drift
    )


def undetermined(used: Array, offsets: Array) -> Array:
    """Mask ``(..., k)`` of the offsets that the satellites ``used (..., S)`` do not determine.

    These are the offsets of systems without a satellite. If the first system has none, the offset
    of the next present system is undetermined too, because its clock becomes the reference.
    """
    present = (used[..., None, :] & (offsets > 0.0)).any(-1)
    first = (used & ~offsets.any(-2)).any(-1, keepdims=True)
    return np.asarray(~present | (~first & (np.cumsum(present, -1) == 1)))


def measure(x: Array, q: Array, w: Array, offsets: Array | None = None) -> Array:
    """Pseudoranges (m) and range rates (m/s) ``(..., 2 S)`` for states ``x (..., 8 + k)``.

    q, w: ``(..., S, 3)``, see `Sources`. offsets: ``(k, S)``; None for one system.
    """
    away = q - x[..., None, :3]
    distance = np.sqrt(np.vecdot(away, away))
    rate = (away * (w - x[..., None, 3:6])).sum(-1) / distance
    bias = x[..., 6:7] if offsets is None else x[..., 6:7] + x[..., 8:] @ offsets
    return np.concatenate([distance + bias, rate + x[..., 7:8]], -1)


def jacobian(x: Array, q: Array, w: Array, offsets: Array | None = None) -> Array:
    """Jacobian ``(..., 2 S, 8 + k)`` of `measure`."""
    away, relative = q - x[..., None, :3], w - x[..., None, 3:6]
    distance = np.sqrt(np.vecdot(away, away))[..., None]
    e = away / distance
    # d(e.u)/dp = -(u - (e.u) e) / distance, with u the relative velocity.
    across = (relative - (e * relative).sum(-1, keepdims=True) * e) / distance
    one, zero = np.ones_like(distance), np.zeros_like(distance)
    ranges = np.concatenate([-e, np.zeros_like(e), one, zero], -1)
    J = np.concatenate([ranges, np.concatenate([-across, -e, zero, one], -1)], -2)
    if offsets is None:
        return J
    columns = np.concatenate([offsets.T, np.zeros_like(offsets.T)])
    return np.concatenate([J, np.broadcast_to(columns, (*J.shape[:-2], *columns.shape))], -1)
