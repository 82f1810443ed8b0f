"""Pseudoranges and their rates: where satellites were when they sent, what the atmosphere adds, what a receiver then measures.

Positions are Earth-fixed at the time of reception, m; angles in rad; clocks are in m (times the speed of light). The state of a
receiver is ``(p, v, b, d)``: position, velocity, clock bias and drift. A measurement has all ranges first, then all rates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import finite, numbers
from celnav.gaussian.linalg import Array
from celnav.models.beidou import LIGHT, ROTATION_RATE, Broadcast, SatelliteState, satellites, spun, turned

GPS_L1_HZ = 1575.42e6
CRYSTAL = (LIGHT**2 * 2e-19 / 2.0, 2.0 * np.pi**2 * LIGHT**2 * 2e-20)
"""A compensated crystal's noise of frequency, white (m^2/s) and walking (m^2/s^3): h0 = 2e-19, h-2 = 2e-20."""
GROUND_M = (6.3e6, 1e7)
"""From the middle of the Earth, where receivers are: near its surface or in a low orbit."""
SINGULAR = 1e-6
"""Directions this close to each other, rad, or satellites this close to a cone, are no geometry."""


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
    delay = np.asarray(0.08)
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
    inertial = moved + spun(q, ROTATION_RATE)
    e = _unit(q - place)
    own = np.asarray(velocity)[..., None, :] if np.ndim(velocity) else velocity
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


def transition(dt: float) -> Array:
    """Matrix ``(8, 8)`` of a receiver at constant velocity, with a clock of constant drift, over ``dt`` seconds."""
    F = np.eye(8)
    F[:3, 3:6] = dt * np.eye(3)
    F[6, 7] = dt
    return F


def process_noise(dt: float, acceleration: float, white: float, walk: float) -> Array:
    """Covariance ``(8, 8)`` of what an interval adds to it.

    ``acceleration``: density of the white acceleration, m^2/s^3. ``white``, ``walk``: of the clock, see `CRYSTAL`.
    """
    Q, block = np.zeros((8, 8)), np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    Q[:6, :6] = acceleration * np.kron(block, np.eye(3))
    Q[6:, 6:] = walk * block
    Q[6, 6] += white * dt
    return Q


def on_earth(name: str, position: Array) -> None:
    """Raise ValueError unless a position ``(3,)`` may be a receiver's: Earth-fixed meters, near the surface or in a low orbit."""
    position = numbers(name, position, (3,))
    if not GROUND_M[0] < math.hypot(*position) < GROUND_M[1]:  # nan is in no interval
        raise ValueError(f"{name}: expected Earth-fixed meters, 6300 to 10000 km from the middle, got {position}")


def local_axes(latitude: Array | float, longitude: Array | float) -> Array:
    """East, north and up, the rows of ``(..., 3, 3)``, on Earth-fixed axes; geodetic angles."""
    latitude, longitude, zero = np.broadcast_arrays(latitude, longitude, 0.0)
    sin_l, cos_l, sin_f, cos_f = np.sin(longitude), np.cos(longitude), np.sin(latitude), np.cos(latitude)
    rows = [[-sin_l, cos_l, zero], [-sin_f * cos_l, -sin_f * sin_l, cos_f], [cos_f * cos_l, cos_f * sin_l, sin_f]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


class Sky(NamedTuple):
    """Elevation and azimuth (from north by east) of satellites, rad ``(..., S)``."""

    elevation: Array
    azimuth: Array


def look(q: Array, position: Array, axes: Array) -> Sky:
    """Where satellites ``q (..., S, 3)`` stand over ``position (..., 3)`` with its `local_axes` ``(..., 3, 3)``."""
    east, north, up = np.moveaxis(_unit(q - position[..., None, :]) @ axes.mT, -1, 0)
    return Sky(np.arcsin(up), np.arctan2(east, north) % (2.0 * np.pi))


class Dilution(NamedTuple):
    """Dilution of precision ``(...)``: geometric, position, horizontal, vertical, time."""

    geometric: Array
    position: Array
    horizontal: Array
    vertical: Array
    time: Array


def dilution(q: Array, position: Array, axes: Array, used: Array | None = None) -> Dilution:
    """What a fix from ranges alone makes of their noise; nan where satellites ``used (..., S)`` do not determine one."""
    e = _unit(q - position[..., None, :]) @ axes.mT
    rows = np.concatenate([-e, np.ones_like(e[..., :1])], -1)
    if used is not None:
        rows = np.where(used[..., None], rows, 0.0)
    R: Array = np.linalg.qr(np.concatenate([rows, np.zeros((*rows.shape[:-2], 4, 4))], -2)).R
    enough = (np.abs(R.diagonal(0, -2, -1)).min(-1) > SINGULAR)[..., None, None]
    # (R.T R)^-1 has the sums of squares of the rows of R^-1 on its diagonal.
    root = np.where(enough, np.linalg.inv(np.where(enough, R, np.eye(4))), np.nan)
    east, north, up, time = np.moveaxis(np.square(root).sum(-1), -1, 0)
    flat = east + north
    return Dilution(*(np.sqrt(v) for v in (flat + up + time, flat + up, flat, up, time)))


def klobuchar(
    alpha: ArrayLike,
    beta: ArrayLike,
    t: Array | float,
    latitude: Array | float,
    longitude: Array | float,
    elevation: Array,
    azimuth: Array,
) -> Array:
    """Ionospheric delay (m) at GPS L1 [Klobuchar 1987; IS-GPS-200]; at another frequency f it is ``(L1 / f)^2`` times that.

    Parameters
    ----------
    alpha, beta: four coefficients each, s and s per semicircle^k, as broadcast (RINEX: GPSA, GPSB).
    t: seconds of the GPS day or week. latitude, longitude: geodetic, of the receiver. elevation, azimuth: of the satellites.
    """
    a, b = finite("alpha", alpha, (4,)), finite("beta", beta, (4,))
    E = np.asarray(elevation) / np.pi  # all angles in semicircles, as the coefficients are
    psi = 0.0137 / (E + 0.11) - 0.022
    phi = np.clip(latitude / np.pi + psi * np.cos(azimuth), -0.416, 0.416)
    lam = longitude / np.pi + psi * np.sin(azimuth) / np.cos(phi * np.pi)
    geomagnetic = phi + 0.064 * np.cos((lam - 1.617) * np.pi)
    local = np.mod(43200.0 * lam + t, 86400.0)
    powers = geomagnetic[..., None] ** np.arange(4)
    amplitude, period = np.maximum(powers @ a, 0.0), np.maximum(powers @ b, 72000.0)
    x = 2.0 * np.pi * (local - 50400.0) / period
    day = np.where(np.abs(x) < 1.57, amplitude * (1.0 - x**2 / 2.0 + x**4 / 24.0), 0.0)
    obliquity = 1.0 + 16.0 * (0.53 - E) ** 3
    return np.asarray(LIGHT * obliquity * (5e-9 + day))


def saastamoinen(latitude: Array | float, height_m: Array | float, elevation: Array, *, humidity: float = 0.5) -> Array:
    """Tropospheric delay (m) of the standard atmosphere, mapped by ``1 / sin(elevation)`` [Saastamoinen 1972].

    ``height_m`` above the sea, from -1000 to 11,000. ``humidity``: relative, of the air at the receiver, from 0 to 1.
    """
    height = np.asarray(height_m, dtype=np.float64)
    if not ((height >= -1000.0) & (height <= 11000.0)).all():
        raise ValueError(f"height_m: expected a height from -1000 to 11000 m, got {height_m!r}")
    if not 0.0 <= humidity <= 1.0:
        raise ValueError(f"humidity: expected a part from 0 to 1, got {humidity!r}")
    h = np.maximum(height, 0.0)
    pressure = 1013.25 * (1.0 - 2.2557e-5 * h) ** 5.2568
    kelvin = 288.15 - 6.5e-3 * h
    vapor = 6.108 * humidity * np.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    dry = 0.0022768 * pressure / (1.0 - 0.00266 * np.cos(2.0 * latitude) - 0.00028e-3 * h)
    wet = 0.0022768 * (1255.0 / kelvin + 0.05) * vapor
    return np.asarray((dry + wet) / np.sin(elevation))
