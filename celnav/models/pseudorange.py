"""Pseudoranges and their rates: where satellites were when they sent, what a receiver then measures, and how well that fixes it.

Positions are Earth-fixed at the time of reception, m; clocks are in m (times the speed of light). The state of a receiver is
``(p, v, b, d)``: position, velocity, clock bias and drift. A measurement has all ranges first, then all rates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.models.beidou import LIGHT, ROTATION_RATE, Broadcast, SatelliteState, satellites, turned


class Sources(NamedTuple):
    """Satellites as a receiver sees them: positions ``q (..., S, 3)`` m at emission in the Earth-fixed frame of reception, and
    ``w (..., S, 3)`` m/s with which the rate of the range is ``e.(w - v)``, e the unit vector to q; clocks (m, m/s).
    """

    q: Array
    w: Array
    clock: Array
    drift: Array


def sources(broadcast: Broadcast, t: Array | float, position: Array, velocity: Array | float = 0.0) -> Sources:
    """All satellites for a receiver at ``position (..., 3)``, moving by ``velocity``, at times of reception ``t (...)``.

    A position that is off by 10 m changes them by less than 1e-5 m, a velocity by 10 m/s hardly at all.
    """
    when, place = np.asarray(t, dtype=np.float64)[..., None], np.asarray(position)[..., None, :]
    delay = np.full(np.broadcast_shapes(when.shape, place.shape[:-1]), 0.08)
    for _ in range(4):
        state = satellites(broadcast, when - delay)
        q = turned(state.position, ROTATION_RATE * delay)
        delay = np.linalg.norm(q - place, axis=-1) / LIGHT
    return _seen(state, q, delay, place, velocity)


def emitted(broadcast: Broadcast, t: Array | float, pseudorange: Array, position: Array, velocity: Array | float = 0.0) -> Sources:
    """The same from measured pseudoranges ``(..., S)`` m: the receiver's clock, which says ``t``, cancels.

    The Earth turns by the geometric delay; a ``position (..., 3)`` that is off by a kilometer moves satellites by a centimeter.
    """
    when, place = np.asarray(t, dtype=np.float64)[..., None], np.asarray(position)[..., None, :]
    sent = when - pseudorange / LIGHT
    state = satellites(broadcast, sent - satellites(broadcast, sent).clock)
    q = state.position
    for _ in range(3):
        delay = np.linalg.norm(q - place, axis=-1) / LIGHT
        q = turned(state.position, ROTATION_RATE * delay)
    return _seen(state, q, delay, place, velocity)


def _seen(state: SatelliteState, q: Array, delay: Array, place: Array, velocity: Array | float) -> Sources:
    """With the Doppler effect of the satellite's own motion folded into its velocity."""
    moved = turned(state.velocity, ROTATION_RATE * delay)
    inertial = moved + ROTATION_RATE * np.stack([-q[..., 1], q[..., 0], np.zeros_like(q[..., 2])], -1)
    e = _unit(q - place)
    own = np.asarray(velocity, dtype=np.float64)
    own = own[..., None, :] if own.ndim else own
    rate = (e * (moved - own)).sum(-1) / (1.0 + (e * inertial).sum(-1) / LIGHT)
    return Sources(q, moved - rate[..., None] / LIGHT * inertial, LIGHT * state.clock, LIGHT * state.drift)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def measure(x: Array, q: Array, w: Array) -> Array:
    """Ranges (m) and rates (m/s) ``(..., 2 S)`` of states ``x (..., 8)`` from satellites ``q, w (..., S, 3)``."""
    away = q - x[..., None, :3]
    distance = np.linalg.norm(away, axis=-1)
    rate = (away * (w - x[..., None, 3:6])).sum(-1) / distance
    return np.concatenate([distance + x[..., 6:7], rate + x[..., 7:8]], -1)


def jacobian(x: Array, q: Array, w: Array) -> Array:
    """Derivative ``(..., 2 S, 8)`` of `measure`."""
    away, relative = q - x[..., None, :3], w - x[..., None, 3:6]
    distance = np.linalg.norm(away, axis=-1, keepdims=True)
    e = away / distance
    across = (relative - (e * relative).sum(-1, keepdims=True) * e) / distance
    one, zero = np.ones_like(distance), np.zeros_like(distance)
    ranges = np.concatenate([-e, np.zeros_like(e), one, zero], -1)
    return np.concatenate([ranges, np.concatenate([-across, -e, zero, one], -1)], -2)


def local_axes(latitude: Array | float, longitude: Array | float) -> Array:
    """East, north and up, the rows of ``(..., 3, 3)``, on Earth-fixed axes; geodetic angles in rad."""
    sin_l, cos_l, sin_f, cos_f = np.sin(longitude), np.cos(longitude), np.sin(latitude), np.cos(latitude)
    zero = np.zeros_like(sin_l)
    rows = [[-sin_l, cos_l, zero], [-sin_f * cos_l, -sin_f * sin_l, cos_f], [cos_f * cos_l, cos_f * sin_l, sin_f]]
    return np.moveaxis(
        np.array(np.broadcast_arrays(*(cell for row in rows for cell in row))).reshape(3, 3, *np.shape(sin_l)), (0, 1), (-2, -1)
    )


class Sky(NamedTuple):
    """Elevation and azimuth (from north by east) of satellites, rad ``(..., S)``."""

    elevation: Array
    azimuth: Array


def look(q: Array, position: Array, axes: Array) -> Sky:
    """Where satellites ``q (..., S, 3)`` stand over ``position (..., 3)`` with its `local_axes` ``(..., 3, 3)``."""
    east, north, up = np.moveaxis(_unit(q - position[..., None, :]) @ np.swapaxes(axes, -1, -2), -1, 0)
    return Sky(np.arcsin(up), np.arctan2(east, north) % (2.0 * np.pi))


class Dilution(NamedTuple):
    """Dilution of precision ``(...)``: geometric, position, horizontal, vertical, time."""

    geometric: Array
    position: Array
    horizontal: Array
    vertical: Array
    time: Array


SINGULAR = 1e-6
"""Directions this close to each other, rad, or satellites this close to a cone, are no geometry."""


def dilution(q: Array, position: Array, axes: Array, used: Array | None = None) -> Dilution:
    """What a fix from ranges alone makes of their noise; nan where satellites ``used (..., S)`` do not determine one."""
    e = _unit(q - position[..., None, :]) @ np.swapaxes(axes, -1, -2)
    rows = np.concatenate([-e, np.ones_like(e[..., :1])], -1)
    if used is not None:
        rows = np.where(used[..., None], rows, 0.0)
    R: Array = np.linalg.qr(np.concatenate([rows, np.zeros((*rows.shape[:-2], 4, 4))], -2)).R
    enough = (np.abs(R.diagonal(0, -2, -1)).min(-1) > SINGULAR)[..., None, None]
    # (R.T R)^-1 has the sums of squares of the rows of R^-1 on its diagonal.
    root = np.where(enough, np.linalg.solve(np.where(enough, R, np.eye(4)), np.broadcast_to(np.eye(4), R.shape)), np.nan)
    east, north, up, time = np.moveaxis(np.square(root).sum(-1), -1, 0)
    flat = east + north
    return Dilution(*(np.sqrt(v) for v in (flat + up + time, flat + up, flat, up, time)))
