"""Long steps of an orbit, their derivatives, and third bodies: against integration to round-off and
plain forms.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from celnav.models import orbit
from celnav.models.orbit import advance, flow, gradient

X0 = orbit.from_elements(7136.635, 1.809e-3, *np.radians([65.0, 30.0, 30.0, 0.0]))


def rates(_t, x):
    return np.concatenate([x[3:], orbit.acceleration(x[:3])])


def test_the_gradient_is_the_difference():
    rng = np.random.default_rng(0)
    r = 7000.0 * rng.normal(size=(3, 5))
    r[:, 0] = X0[:3]
    steps = 1e-2 * np.eye(3)[:, :, None]
    differences = np.stack(
        [(orbit.acceleration(r + s) - orbit.acceleration(r - s)) / 2e-2 for s in steps], 1
    )
    np.testing.assert_allclose(gradient(r), differences, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(np.trace(gradient(r)), 0.0, atol=1e-18)  # Laplace


@pytest.mark.parametrize("dt", [300.0, 60.0])
def test_a_long_step_is_the_orbit(dt):
    exact = solve_ivp(rates, (0.0, dt), X0, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    apart = advance(X0, dt) - exact
    assert np.linalg.norm(apart[:3]) < 1e-9
    assert np.linalg.norm(apart[3:]) < 1e-12
    np.testing.assert_array_equal(flow(X0, dt).state, advance(X0, dt))


def test_a_day_of_long_steps_is_the_orbit():
    x = X0
    for _ in range(288):
        x = advance(x, 300.0)
    exact = solve_ivp(rates, (0.0, 86400.0), X0, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    assert np.linalg.norm(x[:3] - exact[:3]) < 1e-5  # km


def test_further_accelerations_are_those_of_the_place_and_the_time():
    def pull(r, t):
        return 1e-7 * np.sin(1e-2 * t)[:, None] * r / 7000.0

    def rates_pulled(t, x):
        return rates(t, x) + np.concatenate(
            [np.zeros(3), pull(x[:3, None, None], np.array([t]))[:, 0, 0]]
        )

    exact = solve_ivp(rates_pulled, (0.0, 300.0), X0, method="DOP853", rtol=1e-13, atol=1e-13).y[
        :, -1
    ]
    np.testing.assert_allclose(advance(X0, 300.0, extra=pull), exact, rtol=0, atol=1e-8)
    assert np.abs(advance(X0, 300.0) - exact).max() > 1e-4
    np.testing.assert_array_equal(flow(X0, 300.0, extra=pull).state, advance(X0, 300.0, extra=pull))


def test_the_transition_and_the_held_disturbance_are_the_derivatives():
    dt = 300.0
    found = flow(X0, dt)

    def ended(x, w):
        return solve_ivp(
            lambda t, y: rates(t, y) + w, (0.0, dt), x, method="DOP853", rtol=1e-13, atol=1e-13
        ).y[:, -1]

    scale = np.repeat([1e-1, 1e-4], 3)
    for i, s in enumerate(scale):
        e = s * np.eye(6)[i]
        column = (ended(X0 + e, 0.0) - ended(X0 - e, 0.0)) / (2.0 * s)
        np.testing.assert_allclose(
            found.Phi[:, i], column, rtol=0, atol=1e-7 * np.abs(column).max()
        )
        w = e / dt
        column = (ended(X0, w) - ended(X0, -w)) / (2.0 * s / dt)
        np.testing.assert_allclose(found.G[:, i], column, rtol=0, atol=1e-7 * np.abs(column).max())


def test_batches_are_singles():
    rng = np.random.default_rng(1)
    x = X0 + np.repeat([1.0, 1e-3], 3) * rng.normal(size=(4, 3, 6))
    many, one = flow(x, 300.0), flow(x[2, 1], 300.0)
    for a, b in zip(many, one, strict=True):
        np.testing.assert_allclose(a[2, 1], b, rtol=1e-12, atol=1e-12)


def test_the_transition_is_symplectic():
    Phi = flow(X0, 300.0).Phi
    J = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
    units = np.repeat([1.0, 1.0 / 300.0], 3)  # km and km / step
    scaled = Phi / units[:, None] * units
    np.testing.assert_allclose(scaled.T @ J @ scaled, J, atol=1e-7)


def test_third_bodies_pull_by_the_difference_of_attractions():
    r, moon = X0[:3], np.array([3.0e5, -2.0e5, 1.0e5])
    away = moon - r
    plain = 4902.8 * (away / np.linalg.norm(away) ** 3 - moon / np.linalg.norm(moon) ** 3)
    np.testing.assert_allclose(orbit.third_body(r, moon, 4902.8), plain, rtol=1e-12)
    # Far away, the tide: gm / R^3 (3 (r.u) u - r).
    sun, gm = 1.5e8 * np.array([0.6, 0.8, 0.0]), 1.327e11
    u = sun / np.linalg.norm(sun)
    tide = gm / np.linalg.norm(sun) ** 3 * (3.0 * (r @ u) * u - r)
    np.testing.assert_allclose(orbit.third_body(r, sun, gm), tide, rtol=2e-4)
    batch = orbit.third_body(np.stack([r, 2.0 * r]), np.stack([moon, sun]), 1.0)
    np.testing.assert_array_equal(batch[0], orbit.third_body(r, moon, 1.0))
