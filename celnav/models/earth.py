"""The ellipsoid WGS-84: radii of curvature, rotation, normal gravity. Units: m, s, rad."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.linalg import Array

SEMI_MAJOR_M = 6378137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
ROTATION_RATE = 7.2921151467e-5
"""rad/s."""
GRAVITY_PARAMETER = 3.986004418e14
"""m^3/s^2."""
STANDARD_GRAVITY = 9.80665
"""m/s^2, what a "g" of an accelerometer is."""
_EQUATOR, _SOMIGLIANA = 9.7803253359, 0.00193185265241


def meridian_radius(latitude: ArrayLike) -> Array:
    """Radius of curvature along a meridian, R_M, m."""
    s = np.sin(latitude)
    return np.asarray(SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED) / (1.0 - ECCENTRICITY_SQUARED * s * s) ** 1.5)


def transverse_radius(latitude: ArrayLike) -> Array:
    """Radius of curvature across the meridian, R_N, m."""
    s = np.sin(latitude)
    return np.asarray(SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_SQUARED * s * s))


def normal_gravity(latitude: ArrayLike, height_m: ArrayLike) -> Array:
    """Gravity (down, with the centrifugal part) of the normal ellipsoid, m/s^2: Somigliana's formula, to second order in height."""
    s2 = np.square(np.sin(latitude))
    surface = _EQUATOR * (1.0 + _SOMIGLIANA * s2) / np.sqrt(1.0 - ECCENTRICITY_SQUARED * s2)
    m = ROTATION_RATE**2 * SEMI_MAJOR_M**3 * (1.0 - FLATTENING) / GRAVITY_PARAMETER
    h = np.asarray(height_m) / SEMI_MAJOR_M
    return np.asarray(surface * (1.0 - 2.0 * (1.0 + FLATTENING + m - 2.0 * FLATTENING * s2) * h + 3.0 * h * h))


def earth_rate(latitude: ArrayLike) -> Array:
    """Rotation of the Earth on east, north, up axes, ``(..., 3)`` rad/s."""
    L = np.asarray(latitude, dtype=np.float64)
    return np.stack([np.zeros_like(L), ROTATION_RATE * np.cos(L), ROTATION_RATE * np.sin(L)], -1)


def transport_rate(velocity: Array, latitude: ArrayLike, height_m: ArrayLike) -> Array:
    """Rotation of the east, north, up axes over the Earth, ``(..., 3)`` rad/s, at ``velocity (..., 2 or 3)`` m/s."""
    north, east = meridian_radius(latitude) + height_m, transverse_radius(latitude) + height_m
    spin = velocity[..., 0] / east
    return np.stack([-velocity[..., 1] / north, spin, spin * np.tan(latitude)], -1)
