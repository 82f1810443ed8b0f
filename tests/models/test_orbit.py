"""Orbits: against scipy's integrator, the potential, the elements and the printed check value."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from celnav.models.orbit import (
    EARTH,
    Earth,
    UnitWarning,
    acceleration,
    check_orbit,
    from_elements,
    propagate,
    step,
    to_elements,
    transition,
)

D = np.pi / 180.0
ELEMENTS = (7136.635, 0.001, 65.0 * D, 30.0 * D, 30.0 * D, 0.0)


def potential(r):
    """-mu/r (1 - J2 (Re/r)^2 (3 s - 1) / 2), its gradient's negative is the acceleration."""
    radius = np.sqrt(r @ r)
    s = r[2] ** 2 / radius**2
    return (
        -EARTH.mu
        / radius
        * (1.0 - EARTH.j2 * (EARTH.radius_km / radius) ** 2 * 0.5 * (3.0 * s - 1.0))
    )


def test_acceleration_is_the_gradient_of_the_potential():
    rng = np.random.default_rng(1)
    for direction in rng.normal(size=(20, 3)):
        r = direction / np.linalg.norm(direction) * rng.uniform(6500.0, 42000.0)
        h = 1.0
        # fourth-order differences: steps of 1 km leave a relative error of 1e-13 or so, rounding
        # 1e-11
        gradient = [
            (
                8.0 * (potential(r + h * e) - potential(r - h * e))
                - (potential(r + 2 * h * e) - potential(r - 2 * h * e))
            )
            / (12 * h)
            for e in np.eye(3)
        ]
        np.testing.assert_allclose(
            acceleration(r), -np.array(gradient), rtol=0.0, atol=1e-9 * EARTH.mu / (r @ r)
        )


def test_acceleration_is_the_printed_equation():
    r = np.array([4593.859722, 4391.854959, 3230.759943])
    radius = np.linalg.norm(r)
    c, s = EARTH.j2 * (EARTH.radius_km / radius) ** 2, r[2] ** 2 / radius**2
    factors = 1.0 - c * np.array([7.5 * s - 1.5, 7.5 * s - 1.5, 7.5 * s - 4.5])
    np.testing.assert_allclose(acceleration(r), -EARTH.mu / radius**3 * r * factors, rtol=1e-14)


def test_without_oblateness_it_is_two_bodies():
    r = np.array([7000.0, -100.0, 300.0])
    np.testing.assert_allclose(
        acceleration(r, Earth(j2=0.0)), -EARTH.mu * r / np.linalg.norm(r) ** 3, rtol=1e-14
    )


def test_the_check_value_of_the_reference_orbit():
    start = from_elements(*ELEMENTS)
    np.testing.assert_allclose(start[:3], [4593.859722, 4391.854959, 3230.759943], atol=1e-6)
    np.testing.assert_allclose(start[3:], [-4.608350, 0.500952, 5.871685], atol=1e-6)
    end = propagate(start, 1.0, 600)[-1]
    np.testing.assert_allclose(end[:3], [1128.513522, 3832.733730, 5905.955241], atol=1e-5)
    np.testing.assert_allclose(end[3:], [-6.558624, -2.301214, 2.751041], atol=1e-6)


def test_steps_of_one_second_agree_with_an_integration_to_round_off():
    start = from_elements(*ELEMENTS)
    exact = solve_ivp(
        lambda t, x: np.r_[x[3:], acceleration(x[:3])],
        (0.0, 600.0),
        start,
        method="DOP853",
        rtol=1e-13,
        atol=1e-10,
    ).y[:, -1]
    ours = propagate(start, 1.0, 600)[-1]
    assert (
        np.abs(ours[:3] - exact[:3]).max() < 2e-9
    )  # km: the stated 5e-8 m, and the integrator's own error
    assert np.abs(ours[3:] - exact[3:]).max() < 2e-12


def test_the_step_is_of_fourth_order():
    start = from_elements(*ELEMENTS)
    exact = propagate(start, 5.0, 64)[-1]
    errors = [np.linalg.norm(propagate(start, 320.0 / n, n)[-1] - exact) for n in (2, 4)]
    assert 3.5 < np.log2(errors[0] / errors[1]) < 4.7


@pytest.mark.parametrize("batch", [(3,), (2, 3), (5, 2, 3)])
def test_a_batch_of_orbits_is_each_orbit(batch):
    x = from_elements(*ELEMENTS) + np.random.default_rng(2).normal(size=(*batch, 6)) * np.repeat(
        [10.0, 0.01], 3
    )
    each = np.array([step(row, 2.0) for row in x.reshape(-1, 6)]).reshape(x.shape)
    np.testing.assert_allclose(step(x, 2.0), each, rtol=1e-14)


def test_a_step_leaves_its_argument_alone():
    x = from_elements(*ELEMENTS)
    before = x.copy()
    step(x, 1.0)
    np.testing.assert_array_equal(x, before)


def test_a_step_forth_and_back_is_the_identity():
    x = from_elements(*ELEMENTS)
    np.testing.assert_allclose(step(step(x, 1.0), -1.0), x, rtol=1e-13)


def test_energy_and_polar_momentum_are_kept():
    track = propagate(from_elements(*ELEMENTS), 1.0, 600)
    energy = 0.5 * (track[:, 3:] ** 2).sum(-1) + np.array([potential(r) for r in track[:, :3]])
    polar = track[:, 0] * track[:, 4] - track[:, 1] * track[:, 3]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12)
    np.testing.assert_allclose(polar, polar[0], rtol=1e-12)


def test_transition_matrix_moves_small_deviations():
    x = from_elements(*ELEMENTS)
    F = transition(x, 1.0)
    d = np.array([1e-2, -2e-2, 1e-2, 1e-5, 2e-5, -1e-5])
    np.testing.assert_allclose(
        step(x + d, 1.0) - step(x - d, 1.0), 2.0 * F @ d, rtol=1e-8, atol=1e-11
    )
    np.testing.assert_allclose(np.linalg.det(F), 1.0, atol=1e-9)  # a Hamiltonian flow keeps volumes
    batch = np.stack([x, x + 1.0])
    np.testing.assert_allclose(transition(batch, 1.0)[0], F, rtol=1e-12, atol=1e-15)


angle = st.floats(0.01, 2.0 * np.pi - 0.01)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(6600.0, 50000.0),
    st.floats(1e-3, 0.7),
    st.floats(0.01, np.pi - 0.01),
    angle,
    angle,
    angle,
)
def test_elements_round_trip(a, e, i, raan, argp, anomaly):
    state = from_elements(a / (1.0 - e), e, i, raan, argp, anomaly)
    back = to_elements(state)
    np.testing.assert_allclose(back[:3], [a / (1.0 - e), e, i], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(
        np.exp(1j * back[3:]), np.exp(1j * np.array([raan, argp, anomaly])), atol=1e-9
    )


@pytest.mark.parametrize(
    ("e", "i"),
    [(0.0, 1.0), (0.2, 0.0), (0.0, 0.0), (0.2, np.pi), (0.0, np.pi)],
    ids=lambda v: f"{v:.3g}",
)
def test_elements_of_circular_and_equatorial_orbits_give_the_state_back(e, i):
    state = from_elements(9000.0, e, i, 0.7, 0.4, 0.3)
    a, ecc, inc, raan, argp, anomaly = to_elements(state)
    np.testing.assert_allclose(
        from_elements(a, min(ecc, 0.9), inc, raan, argp, anomaly), state, rtol=1e-9, atol=1e-9
    )


def test_elements_of_a_batch():
    states = np.stack([from_elements(*ELEMENTS), from_elements(8000.0, 0.1, 0.3, 1.0, 2.0, 3.0)])
    np.testing.assert_allclose(to_elements(states), [to_elements(s) for s in states], rtol=1e-12)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: check_orbit([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]), "r = 0"),
        (lambda: check_orbit([7000.0, 0.0, 0.0]), r"state: expected shape \(..., 6\), got \(3,\)"),
        (lambda: check_orbit([np.nan] * 6, "x0"), "x0: expected finite"),
        (lambda: from_elements(-1.0, 0.1, 0.1, 0.1, 0.1, 0.1), "a: expected a positive"),
        (
            lambda: from_elements(7000.0, 1.0, 0.1, 0.1, 0.1, 0.1),
            "e: expected a number of at least 0 and below 1, got 1.0",
        ),
        (
            lambda: from_elements(7000.0, 0.1, np.nan, 0.1, 0.1, 0.1),
            "i: expected a finite number, got nan",
        ),
        (
            lambda: from_elements(np.array([7000.0, 8000.0]), 0.1, 0.1, 0.1, 0.1, 0.1),
            "a: expected a positive number, got array",
        ),
    ],
)
def test_orbits_refuse_and_say_what(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (  # m and m/s
            lambda: check_orbit([4593e3, 4391e3, 3230e3, -4608.0, 500.0, 5871.0]),
            [r"state: r = 7.12807e\+06 km with a speed of 7480.13 km/s is not an Earth orbit"],
        ),
        (  # km and m/s
            lambda: check_orbit([4593.0, 4391.0, 3230.0, -4608.0, 500.0, 5871.0]),
            [r"state: r = 7128.07 km with a speed of 7480.13 km/s is not an Earth orbit"],
        ),
        (  # Earth radii
            lambda: check_orbit([0.72, 0.69, 0.51, -0.6, 0.1, 0.7]),
            ["state: a radius of 1.12009 km lies inside the Earth; positions are in km"],
        ),
        (  # degrees
            lambda: from_elements(7136.635, 0.001, 65.0, 30.0, 30.0, 0.0),
            [
                "i: 65 rad is more than a full turn; angles are in radians",
                "raan: 30 rad is more than a full turn",
                "argp: 30 rad is more than a full turn",
            ],
        ),
    ],
)
def test_numbers_in_other_units_are_warned_of(call, words):
    with pytest.warns(UnitWarning) as told:
        call()
    assert len(told) == len(words)
    for warning, text in zip(told, words, strict=True):
        assert re.match(text, str(warning.message))
