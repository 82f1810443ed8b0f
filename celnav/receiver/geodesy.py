"""Latitude, longitude and height on the Earth's ellipsoid, by pymap3d."""

from __future__ import annotations

from celnav.lazy import requires_extra

with requires_extra("positioning a receiver", "rinex"):
    from pymap3d import Ellipsoid, ecef2geodetic, geodetic2ecef

__all__ = ["ELLIPSOID", "ecef2geodetic", "geodetic2ecef"]

ELLIPSOID = Ellipsoid(6378137.0, 6378137.0 * (1.0 - 1.0 / 298.257222101))  # of CGCS2000
