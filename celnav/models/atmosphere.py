"""Delays of radio signals from satellites: ionosphere by Klobuchar's model, troposphere by Saastamoinen's. Angles in rad, m."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Array
from celnav.models.beidou import LIGHT

GPS_L1_HZ = 1575.42e6


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

    Raises
    ------
    ValueError: unless there are four finite coefficients each.
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

    ``height_m`` above the sea, from -1000 to 11,000. ``humidity``: relative, of the air at the receiver.

    Raises
    ------
    ValueError: for another height or humidity.
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
