"""Kinematic motions against the matrix exponential, over intervals of any length; run by both
engines.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import celnav
from celnav.models import motion
from celnav.models.noise import van_loan

CHAINS = [(motion.constant_velocity, 2), (motion.constant_acceleration, 3)]
RATES = [0.0, 1e-9, 1e-3, 0.0999, 0.1001, 0.7, -0.7, 4.0]
TURN = motion.coordinated_turn(0.2, 1e-3)


def at(dt, k=1):
    return SimpleNamespace(k=k, t=dt, dt=dt, u=None)


def noise(model, mean, dt):
    root = model.noise(mean, at(dt))
    return root @ np.swapaxes(root, -1, -2)


@pytest.mark.parametrize(("make", "order"), CHAINS)
@pytest.mark.parametrize("dt", [0.0, 1e-3, 0.5, 30.0])
def test_integrated_noise_is_that_of_the_matrix_exponential(make, order, dt):
    q, dim = np.array([0.1, 0.4]), 2
    model, n = make(dim, q), order * dim
    G = np.zeros((n, dim))
    G[-dim:] = np.eye(dim)
    F, Q = van_loan(np.eye(n, k=dim), G, np.diag(q), dt)
    np.testing.assert_allclose(model.f.at(at(dt), n), F, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        noise(model, np.zeros(n), dt), Q, rtol=1e-9, atol=1e-12 * np.abs(Q).max()
    )


def of_a_turn(rate, q, dt):
    A = np.block(
        [
            [np.zeros((2, 2)), np.eye(2)],
            [np.zeros((2, 2)), rate * np.array([[0.0, -1.0], [1.0, 0.0]])],
        ]
    )
    return van_loan(A, np.eye(4, 2, k=-2), q * np.eye(2), dt)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("dt", [0.01, 1.0, 8.0])
def test_a_turn_is_the_matrix_exponential(rate, dt):
    F, Q = of_a_turn(rate, 0.3, dt)
    model = motion.known_turn(rate, 0.3)
    np.testing.assert_allclose(model.f.at(at(dt), 4), F, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(noise(model, np.zeros(4), dt), Q, rtol=1e-8, atol=1e-9 * Q.max())


def test_a_turn_at_no_rate_is_constant_velocity():
    straight, turn = motion.constant_velocity(2, 0.3), motion.known_turn(0.0, 0.3)
    np.testing.assert_allclose(
        noise(turn, np.zeros(4), 2.0), noise(straight, np.zeros(4), 2.0), rtol=1e-13
    )
    np.testing.assert_array_equal(turn.f.at(at(2.0), 4), straight.f.at(at(2.0), 4))


@pytest.mark.parametrize("rate", RATES)
def test_a_rate_in_the_state_turns_and_its_jacobian_is_exact(rate):
    x, dt, step = np.array([10.0, -5.0, 3.0, 7.0, rate]), 1.5, 1e-5
    expected = np.append(of_a_turn(rate, 0.2, dt)[0] @ x[:4], rate)
    np.testing.assert_allclose(TURN.f(x[None], at(dt))[0], expected, rtol=1e-12)
    sides = [TURN.f((x + sign * step * np.eye(5)), at(dt)) for sign in (1.0, -1.0)]
    np.testing.assert_allclose(
        TURN.jacobian(x, at(dt)), ((sides[0] - sides[1]) / (2.0 * step)).T, atol=3e-9
    )
    Q = np.zeros((5, 5))
    Q[:4, :4], Q[4, 4] = of_a_turn(rate, 0.2, dt)[1], 1e-3 * dt
    np.testing.assert_allclose(noise(TURN, x, dt), Q, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize(
    "model",
    [
        motion.constant_velocity(3, 0.1),
        motion.constant_acceleration(2, [0.1, 0.2]),
        motion.known_turn(0.4, 0.1),
    ],
)
def test_two_steps_are_one_over_both(model):
    n = model.f.matrix(at(1.0)).shape[-1]
    F, first = model.f.at(at(0.7), n), noise(model, np.zeros(n), 0.4)
    np.testing.assert_allclose(
        model.f.at(at(1.1), n), F @ model.f.at(at(0.4), n), rtol=1e-12, atol=1e-14
    )
    np.testing.assert_allclose(
        noise(model, np.zeros(n), 1.1), F @ first @ F.T + noise(model, np.zeros(n), 0.7), atol=1e-14
    )


@pytest.mark.parametrize("form", ["square root", "covariance"])
@pytest.mark.parametrize("make", [celnav.ukf, celnav.ekf])
@pytest.mark.parametrize("times", [np.arange(9.0), np.cumsum([0.0, 0.5, 0.5, 2.0, 0.1])])
def test_engines_agree(make, form, times):
    for model, n in (
        (motion.constant_velocity(2, 0.1), 4),
        (motion.known_turn(0.3, 0.1), 4),
        (TURN, 5),
    ):
        sensor, prior = (
            celnav.Sensor(np.eye(2, n), 0.5 * np.eye(2)),
            celnav.Gaussian(0.1 * np.arange(1.0, n + 1.0), np.eye(n)),
        )
        _, z = celnav.simulate(model, sensor, prior, times, runs=5)
        plain, machine = (
            celnav.run(make(model, sensor, form=form), prior, times, z, engine=e)
            for e in ("numpy", "compiled")
        )
        np.testing.assert_allclose(machine.mean, plain.mean, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(machine.std, plain.std, rtol=1e-8)


def test_runs_may_have_intervals_of_their_own():
    sensor, prior = (
        celnav.Sensor(np.eye(2, 5), 0.5 * np.eye(2)),
        celnav.Gaussian(np.ones((2, 5)), np.eye(5)),
    )
    z, dts = np.zeros((2, 2)), (0.5, 2.0)
    both = [celnav.Epoch(0, 0.0, 0.0, z=z), celnav.Epoch(1, np.array(dts), np.array(dts), z=z)]
    for make in (celnav.ukf, celnav.ekf):
        together = [state.belief for _, state, _ in celnav.steps(make(TURN, sensor), prior, both)][
            -1
        ]
        for i, dt in enumerate(dts):
            alone = celnav.run(
                make(TURN, sensor),
                celnav.Gaussian(np.ones(5), np.eye(5)),
                [0.0, dt],
                np.zeros((2, 2)),
            )
            np.testing.assert_allclose(together.mean[i], alone.mean[-1], rtol=1e-12)
            np.testing.assert_allclose(together.std[i], alone.std[-1], rtol=1e-12)


def test_a_filter_of_what_happens_is_consistent():
    sensor, prior = (
        celnav.Sensor(np.eye(2, 5), 4.0 * np.eye(2)),
        celnav.Gaussian([0.0, 0.0, 20.0, 0.0, 0.1], np.diag([25, 25, 1, 1, 1e-4])),
    )
    times = 0.5 * np.arange(80.0)
    _, z = celnav.simulate(TURN, sensor, prior, times, runs=200)
    track = celnav.run(celnav.ukf(TURN, sensor), prior, times, z)
    assert track.nis.sum() / track.dof.sum() == pytest.approx(
        1.0, abs=3.0 * np.sqrt(2.0 / track.dof.sum()) + 0.005
    )


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: motion.constant_velocity(0, 1.0), "dim: expected an integer from 1 to 100, got 0"),
        (
            lambda: motion.constant_velocity(2, [1.0, 2.0, 3.0]),
            "q: expected a spectral density >= 0, or 2 of them",
        ),
        (
            lambda: motion.constant_acceleration(2, -1.0),
            "q: expected a spectral density >= 0",
        ),
        (lambda: motion.known_turn([1.0, 2.0], 1.0), "rate: expected a finite number"),
        (
            lambda: motion.coordinated_turn(1.0, -1.0),
            "q_rate: expected a number of at least 0, got -1.0",
        ),
    ],
)
def test_what_cannot_be_is_refused(call, text):
    with pytest.raises(ValueError) as error:
        call()
    assert text in str(error.value)
