"""Gyros, and attitude filters made of the common parts: exact cases."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

from celnav import Gaussian, Motion, Sensor, epochs, run, sigma_point
from celnav.filters.adaptive import chi_square_gate, innovation_window
from celnav.gaussian import attitude as at
from celnav.gaussian.rules import Taylor, cubature, unscented
from celnav.gaussian.spaces import EUCLIDEAN, product
from celnav.models.gyro import Body, Gyro, preintegrate, steady_state
from celnav.models.noise import van_loan

ARCSEC, DEG_H = np.pi / 648000.0, np.pi / 648000.0
GYRO = Gyro(sigma_v=2.424e-7, sigma_u=2.285e-9, tau=3600.0)
WALK = Gyro(sigma_v=2.424e-7, sigma_u=2.285e-9)
J = np.array([[52.0, 1.2, -0.8], [1.2, 47.0, 0.6], [-0.8, 0.6, 61.0]])
SPACE = product((at.attitude(), 4, 3), (EUCLIDEAN, 3, 3))
STAR = at.attitude()
SIGMA_N = 20.0 * ARCSEC


def test_process_noise_is_the_integral_of_a_random_walk():
    A, G = np.block([[np.zeros((3, 3)), -np.eye(3)], [np.zeros((3, 6))]]), np.eye(6)
    Q = np.diag(np.repeat([WALK.sigma_v**2, WALK.sigma_u**2], 3))
    _, expected = van_loan(A, G, Q, 0.25)
    np.testing.assert_allclose(WALK.process_noise(0.25), expected, rtol=1e-9, atol=1e-30)


def test_drift_is_stationary():
    stationary = GYRO.sigma_u * np.sqrt(GYRO.tau / 2.0)
    after = GYRO.factor(50.0) ** 2 * stationary**2 + GYRO.drift_std(50.0) ** 2
    np.testing.assert_allclose(after, stationary**2, rtol=1e-12)
    np.testing.assert_allclose(Gyro(0.0, 1.0, 1e12).drift_std(1.0), 1.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("v", "u", "T"),
    [
        (2.424e-7, 2.285e-9, 0.25),
        (2.424e-7, 9.7e-7, 0.25),
        (1.45e-4, 1.6e-9, 1.0),
        (1e-6, 1e-10, 10.0),
        (1e-7, 1e-8, 60.0),
    ],
)
def test_steady_state_is_the_riccati_solution(v, u, T):
    gyro = Gyro(v, u)
    F, H, R = np.array([[1.0, -T], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.array([[SIGMA_N**2]])
    Q = gyro.process_noise(T)[np.ix_([0, 3], [0, 3])]
    scale = np.diag([SIGMA_N, SIGMA_N / T])
    back = np.diag(1.0 / scale.diagonal())
    P = scale @ solve_discrete_are((back @ F @ scale).T, (H @ scale).T, back @ Q @ back, R) @ scale
    after = P - P @ H.T @ H @ P / (P[0, 0] + R[0, 0])
    expected = np.sqrt([P[0, 0], after[0, 0], P[1, 1], after[1, 1]])
    np.testing.assert_allclose(steady_state(SIGMA_N, gyro, T), expected, rtol=1e-6)


def test_the_published_base_case():
    settled = steady_state(SIGMA_N, WALK, 0.25)
    np.testing.assert_allclose(np.array(settled[:2]) / ARCSEC, [1.04578, 1.04435], rtol=2e-4)
    np.testing.assert_allclose(np.array(settled[2:]) / DEG_H, [0.0071772, 0.0071734], rtol=3e-4)


def test_a_gyro_without_noise_gives_the_attitude_back():
    path = Body(J, (0.0, -2.0, 0.0), orbit_rate=1e-3).propagate(
        np.append(at.from_euler([0.1, -0.2, 0.3]), [1e-3, 2e-3, -1e-3]), 0.05, 40
    )
    drift = np.full((41, 3), 5e-6)
    samples = Gyro(0.0, 0.0).measure(path[:, :4], drift, np.zeros((40, 3)), 0.05)
    x = np.append(path[0, :4], drift[0])
    for sample in samples:
        x = Gyro(0.0, 0.0).propagate(x, sample, 0.05)
    np.testing.assert_allclose(at.positive(x[:4]), at.positive(path[-1, :4]), atol=1e-13)
    whole = preintegrate(samples, drift[0], 0.05)
    once = Gyro(0.0, 0.0).propagate(np.append(path[0, :4], drift[0]), whole, 2.0)
    np.testing.assert_allclose(at.positive(once[:4]), at.positive(path[-1, :4]), atol=1e-13)


@pytest.mark.parametrize("size", [1.0, 1e-4], ids=["large", "small"])
def test_the_transition_of_errors_is_the_integral_of_their_equation(size):
    """For a constant rate w, errors of attitude and drift follow a' = -w x a - b, b' = 0."""
    rate, dt = size * np.array([0.3, -0.5, 0.4]), 1.5
    x = np.concatenate([at.exp(np.array([0.4, -0.7, 0.2])), [1e-3, -2e-3, 3e-3]])
    w = at.cross(rate)
    A = np.block([[-w, -np.eye(3)], [np.zeros((3, 6))]])
    np.testing.assert_allclose(
        WALK.transition(x, rate + x[4:], dt), expm(A * dt), rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize("T", [2, 3, 7])
@pytest.mark.parametrize("runs", [(), (4,)], ids=["one", "runs"])
def test_a_sample_is_the_mean_rate_and_the_drift_at_its_start(T, runs):
    """With drifts for T attitudes, for T - 1 samples, or constant drifts for each run."""
    rng, dt = np.random.default_rng(T), 0.5
    turns, noise = 0.1 * rng.standard_normal((2, T - 1, *runs, 3))
    q = [at.exp(0.3 * rng.standard_normal((*runs, 3)))]
    for turn in turns:
        q.append(at.multiply(at.exp(turn), q[-1]))
    drift = 0.01 * rng.standard_normal((T, *runs, 3))
    white = WALK.sigma_v / np.sqrt(dt) * noise
    for given, expected in (
        (drift, drift[:-1]),
        (drift[:-1], drift[:-1]),
        (drift[0], drift[0]),
        (np.array([1e-3, 0.0, -2e-3]), np.array([1e-3, 0.0, -2e-3])),
    ):
        samples = WALK.measure(np.stack(q), given, noise, dt)
        assert samples.shape == (T - 1, *runs, 3)
        np.testing.assert_allclose(samples, turns / dt + expected + white, rtol=0, atol=1e-12)


def test_drifts_of_more_attitudes_than_there_are_are_refused():
    q = np.broadcast_to(at.IDENTITY, (5, 4))
    with pytest.raises(
        ValueError,
        match=r"^q, drift, noise: expected batch axes that broadcast, got \(4,\), \(6,\), \(4,\)",
    ):
        WALK.measure(q, np.zeros((6, 3)), np.zeros((4, 3)), 0.5)


def test_rotation_is_eulers_equation_and_keeps_momentum():
    body = Body(J, (0.0, -2.0, 0.0))
    start = np.append(at.from_euler([0.1, -0.2, 0.3]), [0.02, -0.01, 0.03])
    path = body.propagate(start, 0.05, 400)

    def rate(_, x):
        q, w = x[:4], x[4:]
        W = np.array(
            [
                [0, w[2], -w[1], w[0]],
                [-w[2], 0, w[0], w[1]],
                [w[1], -w[0], 0, w[2]],
                [-w[0], -w[1], -w[2], 0],
            ]
        )
        return np.append(0.5 * W @ q, np.linalg.solve(J, -np.cross(w, J @ w + body.wheels)))

    known = solve_ivp(rate, (0.0, 20.0), start, rtol=1e-12, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(path[-1], known, atol=1e-8)
    momentum = np.einsum("tji,tj->ti", at.matrix(path[:, :4]), path[:, 4:] @ J + body.wheels)
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=1e-9)


def test_gravity_gradient_vanishes_on_a_principal_axis():
    body = Body(np.diag([1.0, 2.0, 3.0]), orbit_rate=1e-3)
    still = body.rates(np.append(at.IDENTITY, np.zeros(3)), 0.0)
    np.testing.assert_array_equal(still[4:], 0.0)
    np.testing.assert_allclose(
        body.nadir(at.IDENTITY, np.pi / 2 * 1e3), [-1.0, 0.0, 0.0], atol=1e-12
    )


def simulated(runs=5, steps=40, dt=0.25):
    rng = np.random.default_rng(1)
    path = Body(J, (0.0, -2.0, 0.0), orbit_rate=1e-3).propagate(
        np.append(at.from_euler(np.radians([1, 2, 10])), np.radians([0.01, 0.01, 0.05])), dt, steps
    )
    q = np.broadcast_to(path[:, None, :4], (steps + 1, runs, 4))
    drift = np.broadcast_to(np.full(3, DEG_H), (steps + 1, runs, 3))
    gyro = GYRO.measure(q, drift, rng.standard_normal((steps, runs, 3)), dt)
    sign = np.where(rng.random((steps + 1, runs, 1)) < 0.5, -1.0, 1.0)
    z = sign * at.multiply(at.exp(SIGMA_N * rng.standard_normal((steps + 1, runs, 3))), q)
    z[0] = np.nan
    return q, gyro, z


FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])


def f(x, epoch, *noise):
    """The drift's noise is additive; the first noise argument is the gyro's."""
    if not noise:
        return GYRO.propagate(x, epoch.u, epoch.dt)
    y = GYRO.propagate(x, epoch.u, epoch.dt, noise[0][..., :3])
    y[..., 4:] += noise[0][..., 3:6]
    return y


def h(x, _epoch, *noise):
    """The last noise argument is the star tracker's."""
    return at.multiply(at.exp(noise[-1]), x[..., :4]) if noise else x[..., :4]


W, V = np.diag(np.repeat([GYRO.rate_std(0.25), GYRO.drift_std(0.25)], 3)), SIGMA_N * np.eye(3)
ADDITIVE = (
    Motion(f, GYRO.process_noise(0.25), space=SPACE),
    Sensor(h, SIGMA_N**2 * np.eye(3), space=STAR),
)
THROUGH = Motion(f, augment=(W,), space=SPACE), Sensor(h, augment=(V,), space=STAR)
FULL = Motion(f, augment=(W, V), space=SPACE), Sensor(h, augment=(W, V), space=STAR)


def filtered(parts, z, gyro, rule=unscented, form="covariance", hooks=()):
    cov = np.diag(np.radians([1, 2, 10, 1 / 3600, 1 / 3600, 1 / 3600]) ** 2)
    mean = np.append(at.IDENTITY, np.zeros(3))
    prior = Gaussian(
        np.broadcast_to(mean, (z.shape[1], 7)), np.broadcast_to(cov, (z.shape[1], 6, 6))
    )
    filter = sigma_point(*parts, rule=rule, form=form, hooks=hooks)
    return run(filter, prior, epochs(0.25 * np.arange(len(z)), z, gyro), keep="cov")


def spread(c):
    """Rules with the same spread c for any dimension."""
    return lambda L: unscented(L, 1.0, 0.0, c - L)


def small_spread(L):
    """Points a tenth of the dimension away."""
    return unscented(L, 1.0, 0.0, 0.1 * L - L)


def test_switching_augmentation_is_full_augmentation_at_equal_spread():
    _, gyro, z = simulated()
    a, b = (filtered(parts, z, gyro, spread(15.0)) for parts in (FULL, THROUGH))
    apart = at.angle(at.multiply(a.mean[..., :4], at.inverse(b.mean[..., :4])))
    assert apart.max() < 1e-7 * ARCSEC  # the same filter up to the order of sums
    np.testing.assert_allclose(a.std, b.std, rtol=1e-9)


@FORMS
def test_every_rule_and_form_agrees_on_this_nearly_linear_problem(form):
    q, gyro, z = simulated()
    switching = filtered(THROUGH, z, gyro, small_spread, form)
    additive, mekf = (filtered(ADDITIVE, z, gyro, rule, form) for rule in (unscented, Taylor()))
    for other in (additive, mekf):
        apart = at.angle(at.multiply(switching.mean[..., :4], at.inverse(other.mean[..., :4])))[1:]
        assert apart.max() < 0.01 * ARCSEC
    error = at.log(at.multiply(q, at.inverse(switching.mean[..., :4])))
    assert np.sqrt(np.square(error[-1]).mean()) < 12.0 * ARCSEC
    np.testing.assert_allclose(np.linalg.norm(switching.mean[..., :4], axis=-1), 1.0, atol=1e-12)


def test_the_sign_of_a_star_quaternion_changes_no_bit():
    _, gyro, z = simulated()
    a, b = filtered(THROUGH, z, gyro, small_spread), filtered(THROUGH, -z, gyro, small_spread)
    np.testing.assert_array_equal(a.mean, b.mean)
    np.testing.assert_array_equal(a.std, b.std)


def test_a_half_turn_of_initial_error_is_finite_and_converges():
    _, gyro, z = simulated()
    far = at.exp(np.radians(179.0) * np.array([0.6, 0.0, 0.8]))
    turned = at.multiply(z, np.broadcast_to(at.inverse(far), z.shape))
    cov = np.diag(np.repeat([np.pi, np.radians(1 / 3600)], 3) ** 2)
    prior = Gaussian(np.append(at.IDENTITY, np.zeros(3)), cov)
    filter = sigma_point(*ADDITIVE, rule=unscented, form="covariance")
    track = run(filter, prior, epochs(0.25 * np.arange(len(z)), turned[:, 0], gyro[:, 0]))
    assert np.isfinite(track.mean).all()
    seen = at.angle(at.multiply(turned[-1, 0], at.inverse(track.mean[-1, :4])))
    assert seen < 100.0 * ARCSEC


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: Gyro(-1.0, 0.0), "sigma_v"),
        (lambda: Gyro(0.0, np.nan), "sigma_u"),
        (lambda: Gyro(0.0, 0.0, 0.0), "tau"),
        (lambda: steady_state(0.0, WALK, 1.0), "sigma_n"),
        (lambda: steady_state(1.0, WALK, -1.0), "interval"),
        (lambda: steady_state(1.0, GYRO, 1.0), "gyro"),
        (lambda: Body(-np.eye(3)), "inertia: expected a symmetric positive definite"),
        (
            lambda: Body(np.eye(3) + 0.1 * np.eye(3, k=1)),
            "inertia: expected a symmetric positive definite",
        ),
        (
            lambda: Body(np.diag([1.0, 2.0, 3.1])),
            "inertia: expected principal moments that satisfy .* got 1, 2 and 3.1",
        ),
        (lambda: Body(np.eye(3), wheels=(1.0, 2.0)), "wheels"),
        (lambda: Body(np.eye(3), orbit_rate=np.inf), "orbit_rate"),
    ],
)
def test_bad_input_is_refused_by_name(make, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        make()


def test_an_interval_without_length_is_refused():
    x = np.append(at.IDENTITY, np.zeros(3))
    with pytest.raises(ValueError, match=r"^dt: expected an interval other than 0, got 0$"):
        Body(J).propagate(x, 0.0, 3)
    still = Body(J).propagate(x, -2.0, 3)  # a negative interval is valid
    np.testing.assert_allclose(still, np.tile(x, (4, 1)), atol=1e-15)


def test_a_body_equals_only_itself():
    """It can be a dictionary key, although its arrays cannot."""
    body = Body(J)
    assert body == body != Body(J)
    assert len({body, body}) == 1


@FORMS
@pytest.mark.parametrize("rule", [unscented(6), cubature(6, degree=5), Taylor()], ids=repr)
def test_gates_and_windows_work_on_attitudes(form, rule):
    q, gyro, z = simulated()
    far = z.copy()
    far[20, 2] = at.multiply(at.exp(np.array([0.0, 0.01, 0.0])), z[20, 2])
    kept = z.copy()
    kept[20, 2] = np.nan

    gated = filtered(ADDITIVE, far, gyro, rule, form, [chi_square_gate(1.0 - 1e-9)])
    without = filtered(ADDITIVE, kept, gyro, rule, form)
    assert gated.events["rejected"].tolist() == [0, 0, 3, 0, 0]
    np.testing.assert_allclose(gated.mean, without.mean, atol=1e-12)
    fooled = filtered(ADDITIVE, far, gyro, rule, form)
    error = [
        at.angle(at.multiply(t.mean[20, 2, :4], at.inverse(q[20, 2]))) for t in (gated, fooled)
    ]
    assert error[1] > 20.0 * error[0]
    wide = filtered(ADDITIVE, far, gyro, rule, form, [innovation_window(5)])
    assert np.isfinite(wide.mean).all()
    assert at.angle(at.multiply(wide.mean[20, 2, :4], at.inverse(q[20, 2]))) < error[1]


def test_numbers_of_a_data_sheet_by_hand():
    """0.3 deg/h^(1/2) is 0.005 deg/s^(1/2); 3 deg/h^(3/2) is 3 / 3600 / 60 deg/s^(3/2); 5 deg/h is
    2.424e-5 rad/s.
    """
    walk = Gyro.datasheet(0.3, rate_random_walk=3.0)
    assert walk.sigma_v == pytest.approx(np.radians(0.005))
    assert walk.sigma_u == pytest.approx(np.radians(3.0 / 216000.0))
    assert np.isinf(walk.tau)
    # After an hour the angle random walk is 0.3 deg, and the drift of the rate random walk 3 deg/h.
    assert np.degrees(walk.rate_std(3600.0) * 3600.0) == pytest.approx(0.3)
    assert np.degrees(walk.drift_std(3600.0)) * 3600.0 == pytest.approx(3.0)
    settled = Gyro.datasheet(0.3, bias_instability=5.0, tau=600.0)
    assert settled.drift_std(1e6) == pytest.approx(2.4240684e-5)
    assert (settled.sigma_v, settled.tau) == (walk.sigma_v, 600.0)


def test_the_drift_of_a_bias_instability_has_its_allan_deviation():
    """Simulated: it peaks at 0.62 of the instability, after 1.9 correlation times."""
    gyro, rng, runs = (
        Gyro.datasheet(0.0, bias_instability=10.0, tau=20.0),
        np.random.default_rng(5),
        400,
    )
    deviation = gyro.sigma_u * np.sqrt(gyro.tau / 2.0)
    drift = gyro.drift(
        deviation * rng.standard_normal((runs, 1)), rng.standard_normal((1599, runs, 1)), 1.0
    )[..., 0]
    found = []
    for length in (16, 32, 40, 80):
        means = drift[: len(drift) // length * length].reshape(-1, length, runs).mean(1)
        found.append(
            np.sqrt(0.5 * np.square(np.diff(means, axis=0)).mean()) / np.radians(10.0 / 3600.0)
        )
    assert max(found) == pytest.approx(0.618, abs=0.02)
    assert int(np.argmax(found)) in (1, 2)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (
            {"bias_instability": 1.0, "rate_random_walk": 1.0},
            "rate_random_walk: expected 0 together with a bias_instability, got 1.0",
        ),
        ({"bias_instability": -1.0}, "bias_instability: expected a number of at least 0, got -1.0"),
        ({"bias_instability": 1.0, "tau": np.inf}, "tau: expected a positive number, got inf"),
        (
            {"angle_random_walk": None},
            "angle_random_walk: expected a number of at least 0, got None",
        ),
    ],
)
def test_a_data_sheet_that_cannot_be_is_refused(arguments, text):
    with pytest.raises(ValueError) as error:
        Gyro.datasheet(**{"angle_random_walk": 0.1} | arguments)
    assert str(error.value) == text
