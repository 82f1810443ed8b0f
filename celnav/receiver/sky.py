"""Geometry and atmosphere over a receiver: elevation and azimuth of satellites, dilution of
precision, and atmospheric delays.

Positions are Earth-fixed, m; angles in rad.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import finite, numbers
from celnav.gaussian.linalg import Array
from celnav.models.gnss import LIGHT
from celnav.models.pseudorange import undetermined

GROUND_M = (6.3e6, 1e7)
"""Least and largest distance of receivers from the Earth's center: near the surface to a low orbit.
"""
TROPOSPHERE_M = 0.12
"""Standard deviation at the zenith of the tropospheric delay after its correction."""
TYPICAL_IONOSPHERE = (
    np.array([0.1118e-7, -0.7451e-8, -0.5961e-7, 0.1192e-6]),
    np.array([0.1167e6, -0.2294e6, -0.1311e6, 0.1049e7]),
)
"""Klobuchar's coefficients alpha and beta if no message has them: the coefficients broadcast by GPS
on 1 January 2004, at medium solar activity. RTKLIB uses the same default.
"""
BROADCAST_LEFT, TYPICAL_LEFT = 0.5, 1.0
"""Standard deviation of the delay that remains after Klobuchar's model, over the delay that the
model removes: 0.5 with the coefficients of the day [Klobuchar1987], 1 with typical coefficients.
"""
SINGULAR = 1e-6
"""Least angle, rad, between the directions to satellites, and between these directions and a common
cone; below it a fix is not determined.
"""


def on_earth(name: str, position: Array) -> None:
    """Raise ValueError unless a position ``(3,)`` may be a receiver's: Earth-fixed meters, near the
    surface or in a low orbit.
    """
    position = numbers(name, position, (3,))
    if not GROUND_M[0] < math.hypot(*position) < GROUND_M[1]:  # nan is in no interval
        raise ValueError(
            f"{name}: expected Earth-fixed meters, 6300 to 10000 km from the center, got {position}"
        )


def local_axes(latitude: Array | float, longitude: Array | float) -> Array:
    """East, north and up, the rows of ``(..., 3, 3)``, on Earth-fixed axes; geodetic angles."""
    latitude, longitude, zero = np.broadcast_arrays(latitude, longitude, 0.0)
    sin_l, cos_l, sin_f, cos_f = (
        np.sin(longitude),
        np.cos(longitude),
        np.sin(latitude),
        np.cos(latitude),
    )
    rows = [
        [-sin_l, cos_l, zero],
        [-sin_f * cos_l, -sin_f * sin_l, cos_f],
        [cos_f * cos_l, cos_f * sin_l, sin_f],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


class Sky(NamedTuple):
    """Elevation and azimuth (from north by east) of satellites, rad ``(..., S)``."""

    elevation: Array
    azimuth: Array


def look(q: Array, position: Array, axes: Array) -> Sky:
    """Elevation and azimuth of satellites ``q (..., S, 3)`` from ``position (..., 3)`` with its
    `local_axes` ``(..., 3, 3)``.
    """
    east, north, up = np.moveaxis(_unit(q - position[..., None, :]) @ axes.mT, -1, 0)
    return Sky(np.arcsin(up), np.arctan2(east, north) % (2.0 * np.pi))


class Dilution(NamedTuple):
    """Dilution of precision ``(...)``: geometric, position, horizontal, vertical, time."""

    geometric: Array
    position: Array
    horizontal: Array
    vertical: Array
    time: Array


def dilution(
    q: Array, position: Array, axes: Array, used: Array | None = None, offsets: Array | None = None
) -> Dilution:
    """Dilution of precision of a fix from ranges; nan where satellites ``used (..., S)`` do not
    determine a fix.

    ``offsets (k, S)``: as in `celnav.models.pseudorange`; an offset that the satellites do not
    determine is treated as known.
    """
    e = _unit(q - position[..., None, :]) @ axes.mT
    rows = np.concatenate([-e, np.ones_like(e[..., :1])], -1)
    offsets = np.zeros((0, rows.shape[-2])) if offsets is None else offsets
    k = len(offsets)
    rows = np.concatenate([rows, np.broadcast_to(offsets.T, (*rows.shape[:-1], k))], -1)
    used = np.ones(rows.shape[:-1], bool) if used is None else used
    rows = np.where(used[..., None], rows, 0.0)
    n = rows.shape[-1]
    more = np.zeros((*rows.shape[:-2], n, n))
    more[..., range(4, n), range(4, n)] = undetermined(used, offsets)
    R: Array = np.linalg.qr(np.concatenate([rows, more], -2)).R
    enough = (np.abs(R.diagonal(0, -2, -1)).min(-1) > SINGULAR)[..., None, None]
    # The diagonal of (R' R)^-1 has the sums of squares of the rows of R^-1.
    root = np.where(
        enough,
        np.linalg.solve(np.where(enough, R, np.eye(n)), np.broadcast_to(np.eye(n), R.shape)),
        np.nan,
    )
    east, north, up, time, *_ = np.moveaxis(np.square(root).sum(-1), -1, 0)
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
    """Ionospheric delay (m) at GPS L1 [Klobuchar1987; IS-GPS-200]; at another frequency f multiply
    it by ``(L1 / f)^2``.

    Parameters
    ----------
    alpha, beta: four coefficients each, s and s per semicircle^k, as broadcast (RINEX: GPSA, GPSB).
    t: seconds of the GPS day or week. latitude, longitude: geodetic, of the receiver. elevation,
        azimuth: of the satellites.
    """
    a, b = finite("alpha", alpha, (4,)), finite("beta", beta, (4,))
    E = np.asarray(elevation) / np.pi  # angles in semicircles, as for the coefficients
    psi = 0.0137 / (E + 0.11) - 0.022
    phi = np.clip(latitude / np.pi + psi * np.cos(azimuth), -0.416, 0.416)
    lam = longitude / np.pi + psi * np.sin(azimuth) / np.cos(phi * np.pi)
    geomagnetic = phi + 0.064 * np.cos((lam - 1.617) * np.pi)
    local = np.mod(43200.0 * lam + t, 86400.0)
    powers = geomagnetic[..., None] ** np.arange(4)
    amplitude, period = np.maximum(powers @ a, 0.0), np.maximum(powers @ b, 72000.0)
    x = 2.0 * np.pi * (local - 50400.0) / period
    day = np.where(np.abs(x) < 1.57, amplitude * (1.0 - x**2 / 2.0 + x**4 / 24.0), 0.0)
    return np.asarray(LIGHT * obliquity(elevation) * (5e-9 + day))


def obliquity(elevation: Array) -> Array:
    """Length of the path through the ionosphere over the length at the zenith
    [Klobuchar1987; IS-GPS-200].
    """
    return np.asarray(1.0 + 16.0 * (0.53 - np.asarray(elevation) / np.pi) ** 3)


def atmosphere_variance(elevation: Array, ionosphere: Array) -> Array:
    """Variance (m^2) of the atmospheric delay that remains after correction.

    ``ionosphere``: standard deviation (m) of the remaining ionospheric delay. The remaining
    tropospheric delay is `TROPOSPHERE_M` at the zenith [DO-229D, A.4.2.5].
    """
    wet = TROPOSPHERE_M * 1.001 / np.sqrt(0.002001 + np.sin(elevation) ** 2)
    return np.asarray(np.square(ionosphere) + np.square(wet))


def saastamoinen(
    latitude: Array | float, height_m: Array | float, elevation: Array, *, humidity: float = 0.5
) -> Array:
    """Tropospheric delay (m) of the standard atmosphere, mapped by ``1 / sin(elevation)``
    [Saastamoinen1972].

    height_m: above sea level, from -1000 to 11,000. humidity: relative humidity of the air at the
        receiver, from 0 to 1. ValueError outside these ranges.
    """
    height = np.asarray(height_m, dtype=np.float64)
    if not ((height >= -1000.0) & (height <= 11000.0)).all():
        raise ValueError(f"height_m: expected a height from -1000 to 11000 m, got {height_m!r}")
    if not 0.0 <= humidity <= 1.0:
        raise ValueError(f"humidity: expected a fraction from 0 to 1, got {humidity!r}")
    h = np.maximum(height, 0.0)
    pressure = 1013.25 * (1.0 - 2.2557e-5 * h) ** 5.2568
    kelvin = 288.15 - 6.5e-3 * h
    vapor = 6.108 * humidity * np.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    dry = 0.0022768 * pressure / (1.0 - 0.00266 * np.cos(2.0 * latitude) - 0.00028e-3 * h)
    wet = 0.0022768 * (1255.0 / kelvin + 0.05) * vapor
    return np.asarray((dry + wet) / np.sin(elevation))
