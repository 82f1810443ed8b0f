"""Spherical harmonics of gravity: against closed forms, sums by Legendre functions, Laplace's
equation, and other files.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import lpmv

import celnav
from celnav.files import InputError
from celnav.models import earth, gravity, orbit

RNG = np.random.default_rng(4)
GM, RADIUS = 3.986004415e14, 6378136.3
J2 = 1.08262668e-3


def random(degree):
    """A field with random coefficients that decrease like the Earth's."""
    C, S = (
        RNG.standard_normal((2, degree + 1, degree + 1))
        * 1e-5
        / np.maximum(np.arange(degree + 1), 1)[:, None] ** 2
    )
    C[0, 0] = 1.0
    return gravity.Gravity(GM, RADIUS, C, S)


def places(*shape):
    """Places above all latitudes, including poles and equator."""
    r = RNG.standard_normal((*shape, 3))
    r.reshape(-1, 3)[:3] = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    return 6.8e6 * r / np.linalg.norm(r, axis=-1, keepdims=True)


def summed(field, r):
    """The potential at a place, term by term, by scipy's Legendre functions (which have the phase
    of Condon and Shortley).
    """
    size = np.linalg.norm(r)
    sine, longitude, total = r[2] / size, np.arctan2(r[1], r[0]), 0.0
    for n in range(field.degree + 1):
        for m in range(n + 1):
            norm = math.sqrt(
                (2 - (m == 0)) * (2 * n + 1) * math.factorial(n - m) / math.factorial(n + m)
            )
            P = (-1) ** m * norm * lpmv(m, n, sine)
            wave = field.C[n, m] * np.cos(m * longitude) + field.S[n, m] * np.sin(m * longitude) * (
                m > 0
            )
            total += (field.radius / size) ** n * P * wave
    return field.gm / size * total


def slope(function, r, step):
    """Central differences of the sixth order, ``(..., k, 3)``: good to 1e-11 of the function here."""
    weights = {1: 45.0, 2: -9.0, 3: 1.0}
    parts = [
        sum(w * (np.asarray(function(r + k * e)) - function(r - k * e)) for k, w in weights.items())
        for e in step * np.eye(3)
    ]
    return np.stack(parts, -1) / (60.0 * step)


def test_two_bodies_and_j2_are_those_of_the_orbit():
    C = np.zeros((3, 3))
    C[0, 0], C[2, 0] = 1.0, -J2 / math.sqrt(5.0)
    r = places(7)
    found = gravity.Gravity(GM, RADIUS, C, np.zeros((3, 3))).acceleration(r)
    exact = 1e3 * orbit.acceleration(1e-3 * r.T, orbit.Earth(GM * 1e-9, RADIUS * 1e-3, J2)).T
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-13 * 9.8)


@pytest.mark.parametrize("degree", [0, 1, 2, 5, 12])
def test_the_potential_is_the_sum_of_its_terms_and_the_acceleration_its_slope(degree):
    field = random(degree)
    for r in places(6):
        np.testing.assert_allclose(field.potential(r), summed(field, r), rtol=1e-14)
        beside = (
            slope(lambda x: summed(field, x), r, 2e4)
            if abs(r[2]) < 6.7e6
            else slope(field.potential, r, 2e4)
        )
        np.testing.assert_allclose(field.acceleration(r), beside, atol=1e-9)


def test_the_gradient_is_the_slope_of_the_acceleration_and_empty_space_has_none():
    """Laplace's equation: the trace of the gradient is zero, also at the poles."""
    field, r = random(20), places(2, 4)
    found = field.gradient(r)
    np.testing.assert_allclose(found, slope(field.acceleration, r, 2e4), atol=1e-14)
    np.testing.assert_array_equal(found, found.mT)
    assert np.abs(np.trace(found, axis1=-2, axis2=-1)).max() < 1e-13 * np.abs(found).max()


def test_places_are_a_batch_and_orders_above_the_degree_and_sines_of_order_zero_are_nothing():
    field, r = random(6), places(3, 4)
    each = np.stack([[field.acceleration(x) for x in row] for row in r])
    np.testing.assert_allclose(field.acceleration(r), each, rtol=1e-14)
    S = np.tril(field.S)
    S[:, 0] = 0.0
    clean = gravity.Gravity(GM, RADIUS, np.tril(field.C), S)
    np.testing.assert_array_equal(field.gradient(r), clean.gradient(r))
    assert field.truncated(2).degree == 2
    with pytest.raises(ValueError, match="degree: expected an integer from 0 to 6, got 7"):
        field.truncated(7)
    with pytest.raises(ValueError, match=r"S: expected the shape of C, \(7, 7\), got \(2, 2\)"):
        gravity.Gravity(GM, RADIUS, field.C, np.zeros((2, 2)))


def test_a_field_equals_only_itself():
    """It can be a dictionary key, although its arrays cannot."""
    field, other = (gravity.Gravity(GM, RADIUS, np.eye(3), np.zeros((3, 3))) for _ in range(2))
    assert field == field != other
    assert len({field, field}) == 1


@pytest.mark.parametrize("degree", [2, 4])
def test_a_filter_of_it_is_compiled(degree):
    """Recorded once, with numpy's result."""
    field = random(degree)

    def f(x, epoch):
        r, v, h = x[..., :3], x[..., 3:], epoch.dt
        a = field.acceleration(r + 0.5 * h * v) + earth.inertial_forces(r, v)
        return np.concatenate([r + h * v + 0.5 * h * h * a, v + h * a], -1)

    filter = celnav.ukf(
        celnav.Motion(f, 1e-4 * np.eye(6)), celnav.Sensor(np.eye(3, 6), 9.0 * np.eye(3))
    )
    prior = celnav.Gaussian(np.array([6.8e6, 0.0, 0.0, 0.0, 1e3, 7e3]), np.eye(6))
    z = prior.mean[:3] + RNG.standard_normal((4, 3))
    one, other = (
        celnav.run(filter, prior, np.arange(4.0), z, engine=engine)
        for engine in ("numpy", "compiled")
    )
    np.testing.assert_allclose(one.mean, other.mean, rtol=0, atol=1e-8)


def test_an_orbit_on_turning_axes_is_the_one_in_space():
    """Forces in rotating axes against ERFA's rotation from celestial axes, over ten minutes."""
    field = random(4)
    h, steps, pole = 10.0, 60, (1e-6, 2e-6)

    def turned(t):
        return earth.orientation(
            [2454679.5, 0.5 + t / 86400.0], [2454679.5, 0.5 + (t - 65.6) / 86400.0], pole
        )

    def rk4(rate, x, t):
        k1 = rate(x, t)
        k2 = rate(x + 0.5 * h * k1, t + 0.5 * h)
        k3 = rate(x + 0.5 * h * k2, t + 0.5 * h)
        k4 = rate(x + h * k3, t + h)
        return x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)

    def fixed(x, t):
        return np.concatenate(
            [x[3:], field.acceleration(x[:3]) + earth.inertial_forces(x[:3], x[3:], rate)]
        )

    def free(x, t):
        R = turned(t)
        return np.concatenate([x[3:], R.T @ field.acceleration(R @ x[:3])])

    x = np.array([4e6, 1e6, 5.4e6, 5e3, -4e3, -3e3])
    R = turned(0.0)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    rate = earth.spin(np.stack([turned(0.0), turned(10.0)]), 10.0)[0]
    np.testing.assert_allclose(
        rate, earth.ROTATION_RATE * np.array([pole[0], -pole[1], 1.0]), atol=2e-11
    )
    y = np.concatenate([R.T @ x[:3], R.T @ (x[3:] + np.cross(rate, x[:3]))])
    for k in range(steps):
        x, y = rk4(fixed, x, k * h), rk4(free, y, k * h)
    apart = turned(steps * h) @ y[:3] - x[:3]
    assert np.linalg.norm(apart) < 1e-3  # of 4,500 km


def test_the_angle_of_the_earth_is_what_textbooks_have():
    """[Montenbruck2000, Exercise 5.2]: 1999 March 4, 0 h UTC."""
    UTC = 2451241.5
    found = earth.orientation(
        [UTC, (32.0 + 32.184) / 86400.0],
        [UTC, 0.649232 / 86400.0],
        np.radians([0.06740 / 3600, 0.24713 / 3600]),
    )
    printed = [
        [-0.94737803, 0.32011696, -0.00008431],
        [-0.32011696, -0.94737803, -0.00006363],
        [-0.00010024, -0.00003330, 1.0],
    ]
    np.testing.assert_allclose(found, printed, atol=2e-7)


HEAD = "a model\nearth_gravity_constant 0.3986004415E+15\nradius 0.63781363D+07\nnorm fully_normalized\nend_of_head ====\n"
BODY = "gfc 0 0 1.0d0 0.0d0 0 0\ngfc 2 0 -0.48D-03 0.0\ngfct 2 1 1e-9 2e-9 0 0 20050101\ntrnd 2 1 1e-12 1e-12\ngfc 2 2 2e-6 -1e-6\n"


def test_a_file_is_read(tmp_path):
    path = tmp_path / "field.gfc"
    path.write_text(HEAD + BODY)
    field = gravity.read(path)
    assert (field.gm, field.radius, field.degree) == (GM, RADIUS, 2)
    assert field.C[0, 0] == 1.0
    assert (field.C[2, 0], field.C[2, 1], field.S[2, 1], field.S[2, 2]) == (
        -0.48e-3,
        1e-9,
        2e-9,
        -1e-6,
    )
    assert gravity.read(path, degree=0).degree == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected a gravity field in ICGEM's format"),
        (BODY, "expected a gravity field in ICGEM's format"),
        (HEAD, "expected coefficients up to degree 0, got degree -1"),
        (HEAD + "gfc 2\n", "line 6: expected gfc with degree, order, C and S, got 'gfc 2'"),
        (HEAD + BODY + "gfc 2 x 1 1\n", "line 11: expected gfc with degree, order, C and S"),
        (HEAD + "gfc 1 2 0 0\n", "line 6: expected 0 <= order <= degree and finite numbers"),
        (HEAD + "gfc 1 1 nan 0\n", "line 6: expected 0 <= order <= degree and finite numbers"),
        (HEAD + "gfc 999999 1 0 0\n", "line 6: expected 0 <= order <= degree"),
        (
            HEAD.replace("radius", "size") + BODY,
            "expected a number for radius in the header, got 'none'",
        ),
        (
            HEAD.replace("0.39", "many") + BODY,
            "expected a number for earth_gravity_constant in the header, got 'many",
        ),
        (
            HEAD.replace("fully_", "un") + BODY,
            "norm: expected fully_normalized, got 'unnormalized'",
        ),
    ],
)
def test_what_is_none_is_refused_by_file_and_line(tmp_path, text, message):
    path = tmp_path / "field.gfc"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        gravity.read(path)
    assert str(path) in str(error.value)
    assert message in str(error.value)


def test_a_degree_that_is_not_there_is_refused(tmp_path):
    path = tmp_path / "field.gfc"
    path.write_text(HEAD + BODY)
    with pytest.raises(InputError, match="expected coefficients up to degree 3, got degree 2"):
        gravity.read(path, degree=3)
