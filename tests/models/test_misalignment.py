"""The inertial error model against its equations in matrix form, and against a complete navigation
system.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from celnav.models import earth, misalignment
from celnav.models.earth import turning_flight
from celnav.models.misalignment import Navigation, mechanize

RNG = np.random.default_rng(0)
FLIGHT = {
    "longitude": np.radians(110.0),
    "latitude": np.radians(40.0),
    "height_m": 20000.0,
    "speed": 200.0,
    "heading": np.radians(65.0),
    "acceleration": 0.5,
    "turn_rate": np.radians(0.1),
}
STARS = np.sqrt(0.5) * np.array([[0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])
ANGLES = st.tuples(st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), st.floats(-3.1, 3.1))


def passive(axis, angle):
    """Coordinates in a frame turned by ``angle`` about ``axis``."""
    return Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix().T


def example(batch=()):
    flight = turning_flight(np.arange(3) * 0.5, **FLIGHT)
    phi, bias = 0.4 * RNG.standard_normal((*batch, 3)), 2e-3 * RNG.standard_normal((*batch, 3))
    return misalignment.navigation(flight, 1, phi, bias)


def state(shape=()):
    scale = np.repeat([0.4, 5.0, 1e-4, 1e-6, 2e-3], [3, 2, 2, 3, 3])
    return scale * RNG.standard_normal((*shape, 13))


def textbook(x, nav):
    """Eqs. 20 to 25 (corrected) with matrices and cross products, one state."""
    phi, dV, eps, nabla = x[:3], np.append(x[3:5], 0.0), x[7:10], x[10:]
    dL, L, h, V = x[6], float(nav.latitude), nav.height_m, np.append(nav.velocity, 0.0)
    C = passive(1, phi[1]) @ passive(0, phi[0]) @ passive(2, phi[2])
    sx, cx, sy, cy = np.sin(phi[0]), np.cos(phi[0]), np.sin(phi[1]), np.cos(phi[1])
    C_omega = np.array(
        [[cy, 0.0, sy], [sy * sx / cx, 1.0, -cy * sx / cx], [-sy / cx, 0.0, cy / cx]]
    )
    RM, RN, w = (
        float(earth.meridian_radius(L)) + h,
        float(earth.transverse_radius(L)) + h,
        earth.ROTATION_RATE,
    )
    ie = np.array([0.0, w * np.cos(L), w * np.sin(L)])
    en = np.array([-V[1] / RM, V[0] / RN, V[0] * np.tan(L) / RN])
    d_ie = np.array([0.0, -w * np.sin(L), w * np.cos(L)]) * dL
    d_en = np.array(
        [-dV[1] / RM, dV[0] / RN, dV[0] * np.tan(L) / RN + V[0] / np.cos(L) ** 2 * dL / RN]
    )
    turn = C_omega @ ((np.eye(3) - C) @ (ie + en) + d_ie + d_en - nav.attitude @ eps)
    change = (
        nav.force
        - C.T @ (nav.force - nav.attitude @ nabla)
        - np.cross(2 * ie + en, dV)
        - np.cross(2 * d_ie + d_en, V)
    )
    place = [dV[0] / np.cos(L) / RN + V[0] / np.cos(L) * np.tan(L) / RN * dL, dV[1] / RM]
    return np.concatenate([turn, change[:2], place, np.zeros(6)])


@given(ANGLES)
@settings(max_examples=50, deadline=None)
def test_misalignment_is_three_turns_and_back(angles):
    phi = np.array(angles)
    C = passive(1, phi[1]) @ passive(0, phi[0]) @ passive(2, phi[2])
    np.testing.assert_allclose(misalignment.misalignment_matrix(phi), C, atol=1e-14)
    np.testing.assert_allclose(misalignment.misalignment_angles(C), phi, atol=1e-9)


def test_the_rate_is_the_equations_written_out():
    for _ in range(10):
        nav, x = example(), state()
        np.testing.assert_allclose(
            misalignment.derivative(x, nav), textbook(x, nav), rtol=1e-11, atol=1e-16
        )


def test_the_rate_of_the_angles_is_that_of_the_matrix():
    """C' = -[w x] C for the rotation w = (I - C) w_in of n' against n, without other errors."""
    nav, phi, dt = example(), 0.4 * RNG.standard_normal(3), 1e-6
    rate = misalignment.derivative(np.append(phi, np.zeros(10)), nav)[:3]
    before, C, after = (
        misalignment.misalignment_matrix(phi + s * dt * rate) for s in (-1.0, 0.0, 1.0)
    )
    W = -((after - before) / (2.0 * dt)) @ C.T
    in_ = earth.earth_rate(nav.latitude) + earth.transport_rate(
        nav.velocity, nav.latitude, nav.height_m
    )
    np.testing.assert_allclose([W[2, 1], W[0, 2], W[1, 0]], (np.eye(3) - C) @ in_, atol=1e-9)


def test_without_errors_nothing_moves():
    flight = turning_flight(np.arange(3) * 0.5, **FLIGHT)
    nav = misalignment.navigation(flight, 1, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(misalignment.derivative(np.zeros(13), nav), 0.0, atol=1e-15)


def test_the_step_is_linear_in_the_other_states():
    nav, a = example(), state()
    b, c = a.copy(), a.copy()
    b[3:], c[3:] = state()[3:], state()[3:]
    mixed = np.concatenate([a[:3], 0.3 * b[3:] - 0.2 * c[3:] + 0.9 * a[3:]])
    step = [misalignment.advance(x, nav, 1.0) for x in (a, b, c, mixed)]
    np.testing.assert_allclose(
        0.9 * step[0] + 0.3 * step[1] - 0.2 * step[2], step[3], rtol=1e-12, atol=1e-18
    )


def test_the_position_moves_with_half_of_the_acceleration():
    nav, x = example(), state()
    x[3:7] = 0.0
    east = float(earth.transverse_radius(nav.latitude)) + nav.height_m
    moved = misalignment.advance(x, nav, 2.0)
    rate = misalignment.derivative(x, nav)
    np.testing.assert_allclose(
        moved[5], 0.5 * 4.0 * rate[3] / (east * np.cos(nav.latitude)), rtol=1e-12
    )


def test_a_batch_of_points_and_runs_is_each_of_them():
    nav, x = example((4,)), state((7, 4))
    together = misalignment.advance(x, nav, 1.0)
    stars = STARS @ np.eye(3)
    seen = misalignment.star_residuals(x, nav.attitude, stars)
    for run in range(4):
        alone = Navigation(
            nav.attitude[run], nav.force[run], nav.velocity, nav.latitude, nav.height_m
        )
        for point in range(7):
            np.testing.assert_allclose(
                together[point, run],
                misalignment.advance(x[point, run], alone, 1.0),
                rtol=1e-13,
                atol=1e-19,
            )
            np.testing.assert_allclose(
                seen[point, run],
                misalignment.star_residuals(x[point, run], nav.attitude[run], stars),
                atol=1e-15,
            )


def test_arguments_are_left_alone_in_any_memory_order():
    nav, x = example((3,)), state((5, 3))
    for given_x in (x, np.asfortranarray(x), x[::-1][::-1]):
        kept = given_x.copy()
        np.testing.assert_array_equal(
            misalignment.advance(given_x, nav, 1.0), misalignment.advance(x, nav, 1.0)
        )
        np.testing.assert_array_equal(given_x, kept)


def test_complex_states_give_derivatives():
    nav, x, h = example(), state(), 1e-20
    # The rate is linear in all components except the angles: a difference over any length is exact
    # there.
    lengths = np.repeat([1e-5, 1.0, 1e-3, 1e-5, 1e-2], [3, 2, 2, 3, 3])
    for j, d in enumerate(lengths):
        step = np.imag(misalignment.derivative(x + 1j * h * np.eye(13)[j], nav)) / h
        shifted = [misalignment.derivative(x + s * d * np.eye(13)[j], nav) for s in (1.0, -1.0)]
        np.testing.assert_allclose(
            step, (shifted[0] - shifted[1]) / (2 * d), rtol=1e-6, atol=1e-8 * np.abs(step).max()
        )


def test_star_residuals_are_the_difference_of_two_views():
    nav, x = example(), state()
    C = misalignment.misalignment_matrix(x[:3])
    expected = [nav.attitude.T @ (C @ r - r) for r in STARS]
    np.testing.assert_allclose(
        misalignment.star_residuals(x, nav.attitude, STARS), np.concatenate(expected), atol=1e-15
    )


@given(ANGLES)
@settings(max_examples=30, deadline=None)
def test_wahba_finds_the_misalignment(angles):
    phi, attitude = np.array(angles), misalignment.misalignment_matrix(np.array([0.2, -0.5, 1.0]))
    z = misalignment.star_residuals(np.append(phi, np.zeros(10)), attitude, STARS)
    np.testing.assert_allclose(misalignment.wahba_misalignment(z, attitude, STARS), phi, atol=1e-8)


def test_wahba_with_noise_errs_by_the_noise():
    phi, sigma = np.tile([0.2, -0.3, 0.4], (2000, 1)), 1e-4
    attitude = np.eye(3)
    z = misalignment.star_residuals(
        np.concatenate([phi, np.zeros((2000, 10))], -1), attitude, STARS
    )
    z = z + sigma * RNG.standard_normal(z.shape)
    error = misalignment.wahba_misalignment(z, attitude, STARS) - phi
    assert (np.abs(error.mean(0)) < 5 * error.std(0) / np.sqrt(2000)).all()
    assert (error.std(0) < 2.0 * sigma).all()
    assert (error.std(0) > 0.5 * sigma).all()


@pytest.mark.parametrize(
    ("degrees", "limits"),
    [((20.0, -15.0, 40.0), (0.3, 0.1, 5.0)), ((2.0, -1.5, 4.0), (0.03, 2e-3, 0.1))],
    ids=["large", "small"],
)
def test_agrees_with_a_whole_navigation_system(degrees, limits):
    dt, steps, phi = 0.05, 1200, np.radians(degrees)
    drift, bias = np.full(3, np.radians(0.1) / 3600.0), np.full(3, 200e-6 * 9.80665)
    flight = turning_flight(0.5 * dt * np.arange(2 * steps + 1), **FLIGHT)
    solved = mechanize(
        flight, misalignment.misalignment_matrix(phi) @ flight.attitude[0], drift, bias
    )
    x = np.concatenate([phi, np.zeros(4), drift, bias])
    for k in range(1, 2 * steps, 2):
        x = misalignment.advance(x, misalignment.navigation(flight, k, x[:3], bias), dt)
    attitude = misalignment.misalignment_angles(solved.attitude[-1] @ flight.attitude[-1].T)
    assert np.degrees(np.abs(x[:3] - attitude)).max() * 3600.0 < limits[0]
    assert np.abs(x[3:5] - (solved.velocity[-1] - flight.velocity[-1, :2])).max() < limits[1]
    L = flight.latitude[-1]
    meters = [(earth.transverse_radius(L) + 2e4) * np.cos(L), earth.meridian_radius(L) + 2e4]
    place = np.array(
        [solved.longitude[-1] - flight.longitude[-1], solved.latitude[-1] - flight.latitude[-1]]
    )
    assert np.abs((x[5:7] - place) * meters).max() < limits[2]


def test_a_system_without_errors_follows_the_flight():
    flight = turning_flight(0.025 * np.arange(2 * 400 + 1), **FLIGHT)
    solved = mechanize(flight, flight.attitude[0], np.zeros(3), np.zeros(3))
    assert np.abs(solved.velocity[-1] - flight.velocity[-1, :2]).max() < 1e-4
    assert np.abs(solved.longitude[-1] - flight.longitude[-1]) * 6.4e6 < 1e-2
    turned = Rotation.from_matrix(solved.attitude[-1] @ flight.attitude[-1].T).magnitude()
    assert turned < 1e-8


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_flight_without_the_middle_of_each_step_is_refused(count):
    flight = turning_flight(0.025 * np.arange(count), **FLIGHT)
    with pytest.raises(ValueError, match=f"^flight: expected an odd number.*, got {count}$"):
        mechanize(flight, flight.attitude[0], np.zeros(3), np.zeros(3))


def test_stars_are_parallel_only_if_all_pairs_are():
    """Two of three stars may be parallel: the third direction determines the rotation."""
    attitude, phi = (
        misalignment.misalignment_matrix(np.array([0.2, -0.5, 1.0])),
        np.array([0.3, 0.1, -0.2]),
    )
    stars = STARS[[0, 0, 1]]
    z = misalignment.star_residuals(np.append(phi, np.zeros(10)), attitude, stars)
    np.testing.assert_allclose(misalignment.wahba_misalignment(z, attitude, stars), phi, atol=1e-9)
    near = np.array([[1.0, 0.0, 0.0], [np.sqrt(1.0 - 1.1e-3**2), 1.1e-3, 0.0]])
    z = misalignment.star_residuals(np.append(phi, np.zeros(10)), attitude, near)
    np.testing.assert_allclose(misalignment.wahba_misalignment(z, attitude, near), phi, atol=1e-9)


@pytest.mark.parametrize(
    "stars",
    [
        STARS[[0]],
        STARS[[0, 0]],
        np.stack([STARS[0], -STARS[0]]),
        np.array([[1.0, 0.0, 0.0], [np.sqrt(1.0 - 0.9e-3**2), 0.9e-3, 0.0]]),
        np.stack([STARS, STARS[[1, 1]]]),
    ],
    ids=["one star", "one twice", "opposite", "nearly", "in one run of two"],
)
def test_parallel_stars_are_refused(stars):
    """In any run, because the misalignment would be arbitrary."""
    z = np.zeros((*stars.shape[:-2], 3 * stars.shape[-2]))
    with pytest.raises(
        ValueError,
        match=r"^stars: expected two directions that are not parallel .*, got parallel ones$",
    ):
        misalignment.wahba_misalignment(z, np.eye(3), stars)


def test_stars_of_another_length_are_refused():
    with pytest.raises(
        ValueError, match=r"^stars: expected unit vectors, got lengths from 2 to 2$"
    ):
        misalignment.wahba_misalignment(np.zeros(6), np.eye(3), 2.0 * STARS)
