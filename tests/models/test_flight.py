"""The ellipsoid and the flight over it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from celnav.models import earth
from celnav.models.earth import turning_flight

FLIGHT = {
    "longitude": np.radians(110.0),
    "latitude": np.radians(40.0),
    "height_m": 20000.0,
    "speed": 200.0,
    "heading": np.radians(65.0),
    "acceleration": 0.5,
    "turn_rate": np.radians(0.1),
}


def test_normal_gravity_at_known_places():
    np.testing.assert_allclose(earth.normal_gravity(0.0, 0.0), 9.7803253359, rtol=1e-10)
    np.testing.assert_allclose(earth.normal_gravity(np.pi / 4, 0.0), 9.80619777, rtol=1e-7)
    np.testing.assert_allclose(earth.normal_gravity(np.pi / 2, 0.0), 9.8321849378, rtol=1e-8)
    falloff = (earth.normal_gravity(0.7, 1000.0) - earth.normal_gravity(0.7, 0.0)) / 1000.0
    np.testing.assert_allclose(falloff, -3.086e-6, rtol=2e-3)


def test_radii_of_curvature_are_those_of_the_ellipse():
    a, e2 = earth.SEMI_MAJOR_M, earth.ECCENTRICITY_SQUARED
    np.testing.assert_allclose(earth.meridian_radius(0.0), a * (1 - e2), rtol=1e-14)
    np.testing.assert_allclose(
        earth.meridian_radius(np.pi / 2), earth.transverse_radius(np.pi / 2), rtol=1e-12
    )
    np.testing.assert_allclose(earth.transverse_radius(0.0), a)


def test_the_flight_is_its_differential_equation():
    times = np.arange(0.0, 501.0, 50.0)
    flight = turning_flight(times, **FLIGHT)

    def rate(t, x):
        v, psi = 200.0 + 0.5 * t, FLIGHT["heading"] + FLIGHT["turn_rate"] * t
        east, north = v * np.sin(psi), v * np.cos(psi)
        s = np.sin(x[1])
        q = 1.0 - earth.ECCENTRICITY_SQUARED * s * s
        RN, RM = (
            earth.SEMI_MAJOR_M / np.sqrt(q),
            earth.SEMI_MAJOR_M * (1.0 - earth.ECCENTRICITY_SQUARED) / q**1.5,
        )
        return [east / ((RN + 2e4) * np.cos(x[1])), north / (RM + 2e4)]

    start = [FLIGHT["longitude"], FLIGHT["latitude"]]
    known = solve_ivp(rate, (0.0, 500.0), start, t_eval=times, rtol=1e-12, atol=1e-14).y
    np.testing.assert_allclose(flight.longitude, known[0], atol=1e-11)
    np.testing.assert_allclose(flight.latitude, known[1], atol=1e-11)
    np.testing.assert_allclose(np.linalg.norm(flight.velocity, axis=-1), 200.0 + 0.5 * times)


def test_the_attitude_is_right_front_up():
    flight = turning_flight([0.0, 1.0], **FLIGHT)
    C = flight.attitude[0]
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(C) == pytest.approx(1.0)
    np.testing.assert_allclose(C[:, 1] * 200.0, flight.velocity[0], atol=1e-12)
    np.testing.assert_allclose(C[:, 2], [0.0, 0.0, 1.0])


def test_the_force_of_a_slow_straight_flight_is_gravity_and_thrust():
    slow = turning_flight([0.0, 1.0], **{**FLIGHT, "speed": 1e-9, "turn_rate": 0.0})
    g = float(earth.normal_gravity(FLIGHT["latitude"], 20000.0))
    np.testing.assert_allclose(slow.force[0], [0.0, 0.5, g], atol=1e-9)
    turning = turning_flight([0.0, 1.0], **{**FLIGHT, "acceleration": 0.0})
    np.testing.assert_allclose(turning.force[0, 0], 200.0 * FLIGHT["turn_rate"], atol=0.05)


def test_bad_input_is_refused_by_name():
    with pytest.raises(ValueError, match=r"^times: expected increasing times"):
        turning_flight([0.0, 0.0], **FLIGHT)
    with pytest.raises(ValueError, match=r"^times"):
        turning_flight([0.0, np.nan], **FLIGHT)
    with pytest.raises(
        ValueError, match=r"^latitude: expected a flight within 89 degrees of the equator"
    ):
        turning_flight([0.0, 100.0], **{**FLIGHT, "latitude": np.radians(88.9), "heading": 0.0})


def test_the_spin_of_axes_is_the_rotation_vector_from_each_to_the_next():
    """For rotations from zero and a microradian to nearly a right angle."""
    turns = np.random.default_rng(0).standard_normal((6, 3))
    turns *= (np.array([1e-6, 1e-3, 0.1, 0.7, 1.5, 0.0]) / np.linalg.norm(turns, axis=1))[:, None]
    start = Rotation.from_rotvec([0.3, -1.0, 0.5])
    axes = [start]
    for turn in turns:  # of the axes, by components on them: those of a fixed vector turn back
        axes.append(Rotation.from_rotvec(-turn) * axes[-1])
    found = earth.spin(np.stack([one.as_matrix() for one in axes]), 20.0)
    np.testing.assert_allclose(found, turns / 20.0, rtol=0, atol=1e-15)
