"""Physics against independent forms: potentials, integrators, closed forms, differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from celnav.jacobians import check_jacobian
from celnav.models import noise, orbit, sightings
from celnav.models.orbit import EARTH

START = orbit.from_elements(7136.635, 0.001, *np.radians([65, 30, 30, 0]))


def potential(r):
    x, y, z = r
    d = np.sqrt(x * x + y * y + z * z)
    return EARTH.mu / d * (1.0 - EARTH.j2 * (EARTH.radius_km / d) ** 2 * (1.5 * (z / d) ** 2 - 0.5))


def test_acceleration_is_the_gradient_of_the_potential():
    r = START[:3]
    h = 1.0
    gradient = [(potential(r + h * e) - potential(r - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(orbit.acceleration(r), gradient, rtol=1e-6)


def test_steps_agree_with_a_precise_integrator():
    def rate(t, x):
        return np.r_[x[3:], orbit.acceleration(x[:3])]

    exact = solve_ivp(rate, (0.0, 600.0), START, method="DOP853", rtol=1e-13, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(orbit.propagate(START, 1.0, 600)[-1], exact, atol=1e-9)


def test_steps_keep_the_energy_and_take_any_batch():
    x = orbit.propagate(np.tile(START, (2, 3, 1)), 1.0, 300)
    energy = 0.5 * np.square(x[..., 3:]).sum(-1) - potential(np.moveaxis(x[..., :3], -1, 0))
    np.testing.assert_allclose(energy, np.broadcast_to(energy[0], energy.shape), rtol=1e-11)
    np.testing.assert_array_equal(x[:, 1, 2], orbit.propagate(START, 1.0, 300))


@pytest.mark.parametrize(
    "elements", [(7136.6, 0.001, 1.1, 0.5, 0.6, 0.7), (20000.0, 0.6, 0.2, 6.0, 5.0, 4.0), (12000.0, 0.3, 2.8, 3.0, 0.1, 6.2)]
)
def test_elements_survive_a_round_trip(elements):
    np.testing.assert_allclose(orbit.to_elements(orbit.from_elements(*elements)), elements, rtol=1e-9)


@pytest.mark.parametrize("state", [[7000.0, 0, 0, 0, 7.546, 0], [0, 7000.0, 0, 0, 0, np.sqrt(EARTH.mu / 7000.0)]])
def test_circular_and_equatorial_orbits_have_elements_that_give_them_back(state):
    elements = orbit.to_elements(np.array(state, float))
    np.testing.assert_allclose(orbit.from_elements(*elements), state, atol=1e-6)


def test_the_transition_matrix_predicts_small_changes():
    d = np.array([0.1, -0.2, 0.05, 1e-4, 2e-4, -1e-4])
    F = orbit.transition(START, 1.0)
    np.testing.assert_allclose(orbit.step(START + d, 1.0) - orbit.step(START, 1.0), F @ d, atol=1e-8)


def test_angles_give_the_position_back_on_either_side():
    stars = sightings.star_directions(1.2)
    r = np.array([[4593.0, 4391.0, 3230.0], [4593.0, 4391.0, -3230.0]])
    A = sightings.angles(r, stars)
    np.testing.assert_allclose(sightings.position(A, 1.2, [1.0, -1.0]), r, atol=1e-8)
    np.testing.assert_array_equal(A[0], A[1])


def test_angles_that_belong_to_no_position_give_nan_if_asked():
    assert np.isnan(sightings.position([0.1, 0.1, 2.0], np.pi / 2, strict=False)).any()


def test_the_jacobian_of_the_position_is_right():
    A = sightings.angles(START[:3], sightings.star_directions(1.2))
    check_jacobian(lambda a: sightings.position(a, 1.2), lambda a: sightings.jacobian(a, 1.2), A)


def test_discretized_constant_velocity_has_the_closed_form():
    q, dt = 0.3, 0.7
    F, Q = noise.van_loan([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[q]], dt)
    np.testing.assert_allclose(F, [[1.0, dt], [0.0, 1.0]], atol=1e-14)
    np.testing.assert_allclose(Q, q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]), rtol=1e-12)


def test_stationary_noise_stays_stationary():
    Phi, R = np.array([[0.8, 0.1], [-0.2, 0.5]]), np.array([[1.0, 0.3], [0.3, 2.0]])
    sigma = noise.stationary_covariance(Phi, R)
    np.testing.assert_allclose(sigma, Phi @ sigma @ Phi.T + R, rtol=1e-12)
    rng = np.random.default_rng(0)
    V = noise.ar1(
        Phi, rng.normal(size=(50, 20000, 2)) @ np.linalg.cholesky(R).T, rng.normal(size=(20000, 2)) @ np.linalg.cholesky(sigma).T
    )
    np.testing.assert_allclose(np.cov(V[-1].T), sigma, atol=5 * sigma.max() * np.sqrt(2 / 20000))
    with pytest.raises(ValueError, match=r"^Phi"):
        noise.stationary_covariance(np.eye(2), R)
    np.testing.assert_allclose(noise.effective_covariance(0.8 * np.eye(2), R), 25.0 * R, rtol=1e-12)
