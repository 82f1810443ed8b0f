"""A whole strapdown navigation system, stepped in time: what the error model of `celnav.models.inertial` must agree with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from celnav.gaussian.checks import finite, instance
from celnav.gaussian.linalg import Array, matvec
from celnav.models import earth
from celnav.models.trajectory import Flight


class Solution(NamedTuple):
    """What the system computes, ``(T, ...)``: attitude C_b^n' ``(T, 3, 3)``, velocity ``(T, 2)`` m/s, longitude, latitude rad."""

    attitude: Array
    velocity: Array
    longitude: Array
    latitude: Array


def mechanize(flight: Flight, attitude: Array, drift: Array, bias: Array) -> Solution:
    """Navigate along a flight from a wrong initial attitude, with gyro drift (rad/s) and accelerometer bias (m/s^2).

    Horizontal channels only: the height is known. The flight is sampled twice per step (at the ends and in the middle), so it
    has an odd number of epochs; one row of the solution per step, the start first.
    """
    t = instance("flight", flight, Flight, "a Flight, such as celnav.models.trajectory.turning_flight(times, ...)").times
    if len(t) < 3 or len(t) % 2 == 0:
        raise ValueError(f"flight: expected an odd number of epochs, three or more, got {len(t)}")
    drift, bias = finite("drift", drift, (3,)), finite("bias", bias, (3,))
    dt = t[2] - t[0]
    C, h = finite("attitude", attitude, (3, 3)), flight.height_m
    V, place = flight.velocity[0, :2].copy(), np.array([flight.longitude[0], flight.latitude[0]])
    rows = [(C, V, place)]
    for k in range(0, len(t) - 2, 2):
        # What the gyros measure in the middle of the step: the body's rotation against inertial space.
        turn = flight.attitude[k].T @ flight.attitude[k + 2]
        nav_rate = earth.earth_rate(flight.latitude[k + 1]) + earth.transport_rate(
            flight.velocity[k + 1], flight.latitude[k + 1], h
        )
        middle_attitude = flight.attitude[k + 1]
        gyro = Rotation.from_matrix(turn).as_rotvec() / dt + middle_attitude.T @ nav_rate + drift
        force = flight.force[k + 1] + bias

        def rates(velocity: Array, where: Array, C: Array, force: Array = force) -> tuple[Array, Array, Array]:
            L = where[1]
            spin, transport = earth.earth_rate(L), earth.transport_rate(velocity, L, h)
            full = np.append(velocity, 0.0)
            change = matvec(C, force) - np.cross(2.0 * spin + transport, full)
            east = (earth.transverse_radius(L) + h) * np.cos(L)
            return change[:2], np.array([velocity[0] / east, velocity[1] / (earth.meridian_radius(L) + h)]), spin + transport

        # Midpoint rule: attitude, velocity and position half a step on, then the whole step with their rates.
        change, moved, rate = rates(V, place, C)
        half_V, half_place = V + 0.5 * dt * change, place + 0.5 * dt * moved
        half_C = _turned(C, gyro, rate, 0.5 * dt)
        change, moved, rate = rates(half_V, half_place, half_C)
        C, V, place = _turned(C, gyro, rate, dt), V + dt * change, place + dt * moved
        rows.append((C, V, place))
    attitudes, velocities, places = (np.stack(column) for column in zip(*rows, strict=True))
    return Solution(attitudes, velocities, places[:, 0], places[:, 1])


def _turned(C: Array, gyro: Array, rate: Array, dt: float) -> Array:
    """C_b^n' after the body turned by ``gyro`` (on b) and the axes n' by ``rate`` (on n')."""
    return Rotation.from_rotvec(-rate * dt).as_matrix() @ C @ Rotation.from_rotvec(gyro * dt).as_matrix()
