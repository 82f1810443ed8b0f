"""The WGS 84 ellipsoid (radii of curvature, rotation, normal gravity), Earth-fixed axes, and the
flight of an aircraft.

Units: m, s, rad.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.attitude import cross_product
from celnav.gaussian.checks import finite, number, numbers, together
from celnav.gaussian.linalg import Array, matvec
from celnav.lazy import requires_extra

SEMI_MAJOR_M = 6378137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
ROTATION_RATE = 7.2921151467e-5  # rad/s
SPIN = np.array([0.0, 0.0, ROTATION_RATE])
GRAVITY_PARAMETER = 3.986004418e14  # m^3/s^2
STANDARD_GRAVITY = 9.80665  # m/s^2, the unit g of an accelerometer


def meridian_radius(latitude: ArrayLike) -> Array:
    """Radius of curvature along the meridian, R_M, m, in the shape of ``latitude`` (rad)."""
    s = np.sin(latitude)
    return np.asanyarray(
        SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED) / (1.0 - ECCENTRICITY_SQUARED * s * s) ** 1.5
    )


def transverse_radius(latitude: ArrayLike) -> Array:
    """Radius of curvature across the meridian, R_N, m, in the shape of ``latitude`` (rad)."""
    s = np.sin(latitude)
    return np.asanyarray(SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_SQUARED * s * s))


def radii(latitude: ArrayLike, height_m: ArrayLike) -> tuple[Array, Array]:
    """``R_M + h`` and ``R_N + h``: meters per radian along and across the meridian, in the shape of
    the arguments (rad, m).
    """
    return meridian_radius(latitude) + height_m, transverse_radius(latitude) + height_m


def normal_gravity(latitude: ArrayLike, height_m: ArrayLike) -> Array:
    """Normal gravity (downward, including the centrifugal acceleration), m/s^2, in the shape of the
    arguments (rad, m): Somigliana's formula, to second order in height.
    """
    s2 = np.square(np.sin(latitude))
    surface = (
        9.7803253359 * (1.0 + 0.00193185265241 * s2) / np.sqrt(1.0 - ECCENTRICITY_SQUARED * s2)
    )
    m = ROTATION_RATE**2 * SEMI_MAJOR_M**3 * (1.0 - FLATTENING) / GRAVITY_PARAMETER
    h = np.asanyarray(height_m) / SEMI_MAJOR_M
    return np.asanyarray(
        surface * (1.0 - 2.0 * (1.0 + FLATTENING + m - 2.0 * FLATTENING * s2) * h + 3.0 * h * h)
    )


def earth_rate(latitude: ArrayLike) -> Array:
    """Rotation rate of the Earth on east, north, up axes, ``(..., 3)`` rad/s."""
    L = numbers("latitude", latitude)
    return np.stack([np.zeros_like(L), ROTATION_RATE * np.cos(L), ROTATION_RATE * np.sin(L)], -1)


def transport_rate(velocity: Array, latitude: ArrayLike, height_m: ArrayLike) -> Array:
    """Rotation rate of the east, north, up axes relative to the Earth, ``(..., 3)`` rad/s, for
    ``velocity (..., 2 or 3)`` m/s.
    """
    north, east = radii(latitude, height_m)
    # (-v_N / (R_M + h), v_E / (R_N + h), v_E tan(L) / (R_N + h))
    spin = velocity[..., 0] / east
    return np.stack([-velocity[..., 1] / north, spin, spin * np.tan(latitude)], -1)


def fixed_position(latitude: ArrayLike, longitude: ArrayLike, height_m: ArrayLike) -> Array:
    """Earth-fixed position ``(..., 3)`` m of geodetic latitude, longitude (rad), height (m)."""
    L, lon, h = (np.asanyarray(numbers("latitude", v)) for v in (latitude, longitude, height_m))
    N = transverse_radius(L)
    across = (N + h) * np.cos(L)
    up = (N * (1.0 - ECCENTRICITY_SQUARED) + h) * np.sin(L)
    return np.stack(np.broadcast_arrays(across * np.cos(lon), across * np.sin(lon), up), -1)


def north_east_down(latitude: float, longitude: float) -> Array:
    """Matrix ``(3, 3)`` from Earth-fixed components to components on north, east, down axes."""
    s, c = np.sin(number("latitude", latitude)), np.cos(latitude)
    so, co = np.sin(number("longitude", longitude)), np.cos(longitude)
    return np.array([[-s * co, -s * so, c], [-so, co, 0.0], [-c * co, -c * so, -s]])


def local_position(
    latitude: ArrayLike,
    longitude: ArrayLike,
    height_m: ArrayLike,
    origin: tuple[float, float, float],
) -> Array:
    """Position ``(..., 3)`` m on north, east, down axes that are fixed at the ``origin``.

    Positions and the origin are geodetic: latitude, longitude (rad), height (m). ValueError if they
    are not finite or do not broadcast.

    >>> p = celnav.models.earth.local_position(lat, lon, height, (lat[0], lon[0], height[0]))
    """
    place = finite("origin", origin, (3,))
    geodetic = [
        finite(name, value)
        for name, value in (
            ("latitude", latitude),
            ("longitude", longitude),
            ("height_m", height_m),
        )
    ]
    together(latitude=geodetic[0].shape, longitude=geodetic[1].shape, height_m=geodetic[2].shape)
    offset = fixed_position(*geodetic) - fixed_position(*place)
    return offset @ north_east_down(place[0], place[1]).T


def inertial_forces(position: Array, velocity: Array, spin: Array = SPIN) -> Array:
    """Centrifugal and Coriolis acceleration ``(..., 3)`` m/s^2 on axes that rotate at
    ``spin (..., 3)`` rad/s; position (m) and velocity (m/s) are on these axes.
    """
    # -w x (w x r) - 2 w x v
    return np.asanyarray(-cross_product(spin, 2.0 * velocity + cross_product(spin, position)))


def orientation(tt: ArrayLike, ut1: ArrayLike, pole: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Rotations ``(..., 3, 3)`` from celestial components (GCRS) to terrestrial components (ITRS):
    IAU 2006/2000A, by ERFA.

    tt, ut1: Julian dates ``(..., 2)`` in terrestrial time and in UT1: days, and fractions of a day.
    pole: polar motion x and y, rad.
    """
    with requires_extra("celnav.models.earth.orientation", "papers"):
        import erfa  # imported only on request

    tt_days, ut1_days = finite("tt", tt, (..., 2)), finite("ut1", ut1, (..., 2))
    xp, yp = finite("pole", pole, (2,))
    return np.asarray(
        erfa.c2t06a(tt_days[..., 0], tt_days[..., 1], ut1_days[..., 0], ut1_days[..., 1], xp, yp)
    )


def spin(orientations: Array, interval: float) -> Array:
    """Mean rotation rate ``(T - 1, 3)`` rad/s of axes over each ``interval`` (s), on these axes; it
    includes precession and nutation.

    orientations: ``(T, 3, 3)``, as from `orientation`; each turn is below 90 degrees.
    """
    rotations = finite("orientations", orientations, ("T", 3, 3))
    # Relative to the rotating axes, fixed vectors turn in the opposite direction.
    turn = rotations[:-1] @ rotations[1:].mT
    sine = 0.5 * np.stack(
        [
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ],
        -1,
    )
    size = np.linalg.norm(sine, axis=-1, keepdims=True)
    return np.asarray(
        sine
        * np.arcsin(size)
        / np.where(size > 0.0, size, 1.0)
        / number("interval", interval, above=0.0)
    )


class Flight(NamedTuple):
    """Truth ``(T, ...)`` of a flight, on east, north, up axes n and body axes b: right, front, up.

    times: ``(T,)`` s. longitude, latitude: ``(T,)`` rad. height_m: a constant.
    velocity: ``(T, 3)`` m/s, on n. attitude: ``(T, 3, 3)``, C_b^n.
    force: ``(T, 3)`` m/s^2, specific force on b.
    """

    times: Array
    longitude: Array
    latitude: Array
    height_m: float
    velocity: Array
    attitude: Array
    force: Array


def turning_flight(
    times: Array,
    *,
    longitude: float,
    latitude: float,
    height_m: float,
    speed: float,
    heading: float,
    acceleration: float,
    turn_rate: float,
    substep: float = 0.5,
) -> Flight:
    """A level `Flight` at increasing ``times (T,)`` s, with constant acceleration along the track
    and a constant turn rate.

    longitude, latitude, height_m: position at the first time, rad and m.
    speed, heading: at the first time, m/s and rad clockwise from north.
    acceleration, turn_rate: m/s^2 and rad/s.
    substep: longest Runge-Kutta step of the position, s; 0.5 s integrates 500 s to 1e-12 rad.

    ValueError if the times do not increase, or if the flight comes within a degree of a pole.
    """
    t = finite("times", times, ("T",))
    if (np.diff(t) <= 0.0).any():
        raise ValueError(
            f"times: expected increasing times, got a difference of {np.diff(t).min():.6g} s"
        )
    longitude, latitude, height_m = (
        number("longitude", longitude),
        number("latitude", latitude),
        number("height_m", height_m),
    )
    speed, heading, acceleration = (
        number("speed", speed),
        number("heading", heading),
        number("acceleration", acceleration),
    )
    turn_rate, substep = number("turn_rate", turn_rate), number("substep", substep, above=0.0)

    def rate(since: float, where: Array) -> Array:
        v, psi = speed + acceleration * since, heading + turn_rate * since
        along, across = radii(where[1], height_m)
        return np.array([v * np.sin(psi) / (across * np.cos(where[1])), v * np.cos(psi) / along])

    since = t - t[0]
    places = [np.array([longitude, latitude])]
    for a, b in pairwise(since):
        parts, where = int(np.ceil((b - a) / substep)), places[-1]
        dt = (b - a) / parts
        for at in a + dt * np.arange(parts):
            k1 = rate(at, where)
            k2 = rate(at + 0.5 * dt, where + 0.5 * dt * k1)
            k3 = rate(at + 0.5 * dt, where + 0.5 * dt * k2)
            k4 = rate(at + dt, where + dt * k3)
            where = where + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        places.append(where)
    longitudes, latitudes = np.transpose(places)
    if (np.abs(latitudes) > np.radians(89.0)).any():
        raise ValueError(
            "latitude: expected a flight within 89 degrees of the equator, got "
            f"{np.degrees(np.abs(latitudes).max()):.6g} degrees"
        )

    v, psi = speed + acceleration * since, heading + turn_rate * since
    right = np.stack([np.cos(psi), -np.sin(psi), np.zeros_like(psi)], -1)
    front = np.stack([np.sin(psi), np.cos(psi), np.zeros_like(psi)], -1)
    up = np.broadcast_to([0.0, 0.0, 1.0], front.shape)
    attitude, velocity = np.stack([right, front, up], -1), v[:, None] * front
    # f = v' + (2 w_ie + w_en) x v - g, on east, north, up axes.
    change = acceleration * front + (v * turn_rate)[:, None] * right
    rotation = 2.0 * earth_rate(latitudes) + transport_rate(velocity, latitudes, height_m)
    force = change + np.cross(rotation, velocity)
    force[:, 2] += normal_gravity(latitudes, height_m)
    return Flight(
        t, longitudes, latitudes, height_m, velocity, attitude, matvec(attitude.mT, force)
    )
