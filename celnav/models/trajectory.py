"""The flight of an aircraft at constant height, level, with constant acceleration along the track and a constant turn."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from celnav.gaussian.checks import finite, number
from celnav.gaussian.linalg import Array, matvec
from celnav.models import earth


class Flight(NamedTuple):
    """Truth ``(T, ...)`` of a flight, on east, north, up axes n and body axes b: right, front, up.

    Attributes
    ----------
    times: ``(T,)`` s. longitude, latitude: ``(T,)`` rad. height_m: constant.
    velocity: ``(T, 3)`` m/s. attitude: ``(T, 3, 3)``, C_b^n. force: ``(T, 3)`` m/s^2, the specific force on body axes.
    """

    times: Array
    longitude: Array
    latitude: Array
    height_m: float
    velocity: Array
    attitude: Array
    force: Array


def attitude_from_heading(heading: Array) -> Array:
    """C_b^n ``(..., 3, 3)`` of a level body; the heading is clockwise from north, rad."""
    s, c, o = np.sin(heading), np.cos(heading), np.zeros_like(heading)
    rows = [np.stack(row, -1) for row in ((c, s, o), (-s, c, o), (o, o, o + 1.0))]
    return np.stack(rows, -2)


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
    """Flight at ``times (T,)`` s from the first of them: speed m/s, angles rad, acceleration m/s^2, turn rate rad/s.

    The position is integrated by Runge-Kutta steps of at most ``substep`` seconds (to 1e-12 rad in 500 s).

    Raises
    ------
    ValueError: if times are not finite and increasing, or a pole is reached.
    """
    t = finite("times", times, ("T",))
    if (np.diff(t) <= 0.0).any():
        raise ValueError(f"times: expected an increasing sequence, got shape {t.shape}")
    longitude, latitude, height_m = number("longitude", longitude), number("latitude", latitude), number("height_m", height_m)
    speed, heading, acceleration = number("speed", speed), number("heading", heading), number("acceleration", acceleration)
    turn_rate, substep = number("turn_rate", turn_rate), number("substep", substep, above=0.0)
    since = t - t[0]

    def motion(at: Array) -> tuple[Array, Array]:
        return speed + acceleration * at, heading + turn_rate * at

    def rate(at: float, where: Array) -> Array:
        v, psi = motion(np.asarray(at))
        east, north = v * np.sin(psi), v * np.cos(psi)
        along = earth.meridian_radius(where[1]) + height_m
        across = (earth.transverse_radius(where[1]) + height_m) * np.cos(where[1])
        return np.array([east / across, north / along])

    where = np.array([longitude, latitude])
    places = [where]
    for a, b in pairwise(since):
        parts = int(np.ceil((b - a) / substep))
        dt = (b - a) / parts
        for i in range(parts):
            at = a + i * dt
            k1 = rate(at, where)
            k2 = rate(at + 0.5 * dt, where + 0.5 * dt * k1)
            k3 = rate(at + 0.5 * dt, where + 0.5 * dt * k2)
            k4 = rate(at + dt, where + dt * k3)
            where = where + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        places.append(where)
    place = np.stack(places)
    if (np.abs(place[:, 1]) > np.radians(89.0)).any():
        raise ValueError("latitude: expected a flight away from the poles (within 89 degrees)")
    v, psi = motion(since)
    front = np.stack([np.sin(psi), np.cos(psi), np.zeros_like(psi)], -1)
    right = np.stack([np.cos(psi), -np.sin(psi), np.zeros_like(psi)], -1)
    velocity = v[:, None] * front
    change = acceleration * front + (v * turn_rate)[:, None] * right
    rotation = 2.0 * earth.earth_rate(place[:, 1]) + earth.transport_rate(velocity, place[:, 1], height_m)
    force = change + np.cross(rotation, velocity)
    force[:, 2] += earth.normal_gravity(place[:, 1], height_m)
    attitude = attitude_from_heading(psi)
    return Flight(t, place[:, 0], place[:, 1], height_m, velocity, attitude, matvec(attitude.mT, force))
