"""Latitude, longitude and height on the Earth's ellipsoid, computed by ERFA."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.lazy import requires_extra

with requires_extra("positioning a receiver", "rinex"):
    import erfa

__all__ = ["ELLIPSOID", "ecef2geodetic", "geodetic2ecef"]


class Ellipsoid(NamedTuple):
    """Semi-axes at the equator and at the poles, m."""

    semimajor_axis: float
    semiminor_axis: float

    @property
    def flattening(self) -> float:
        """Flattening f = 1 - b / a."""
        return 1.0 - self.semiminor_axis / self.semimajor_axis


ELLIPSOID = Ellipsoid(6378137.0, 6378137.0 * (1.0 - 1.0 / 298.257222101))  # of CGCS2000


def ecef2geodetic(
    x: Any, y: Any, z: Any, *, ell: Ellipsoid = ELLIPSOID, deg: bool = True
) -> tuple[Array, Array, Array]:
    """Latitude and longitude (degrees, or rad unless ``deg``) and height ``(...)`` m of Earth-fixed
    positions, whose components are ``x, y, z (...)`` m.
    """
    place = np.stack(np.broadcast_arrays(x, y, z), -1, dtype=np.float64)
    longitude, latitude, height = erfa.gc2gde(ell.semimajor_axis, ell.flattening, place)
    if deg:
        latitude, longitude = np.degrees(latitude), np.degrees(longitude)
    return latitude, longitude, height


def geodetic2ecef(
    lat: Any, lon: Any, alt: Any, *, ell: Ellipsoid = ELLIPSOID, deg: bool = True
) -> tuple[Array, Array, Array]:
    """Components ``x, y, z (...)`` m of Earth-fixed positions; the inverse of `ecef2geodetic`."""
    if deg:
        lat, lon = np.radians(lat), np.radians(lon)
    place = erfa.gd2gce(ell.semimajor_axis, ell.flattening, lon, lat, alt)
    x, y, z = np.moveaxis(place, -1, 0)
    return x, y, z
