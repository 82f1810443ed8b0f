"""Noise whose time constant lies in a range: the covariance is bounded, and the bound is tight."""

from __future__ import annotations

import numpy as np
import pytest

import celnav
from celnav.filters.colored import bounding

LOW, HIGH = 5.0, 80.0
TAUS = np.geomspace(LOW, HIGH, 9)
R = np.array([[4.0, 1.0], [1.0, 2.0]])
TIMES = np.cumsum(np.r_[0.0, np.random.default_rng(3).choice([0.5, 1.0, 7.0, 40.0], 39)])


def gauss_markov(times, tau):
    """Autocovariance of a stationary process with variance 1."""
    return np.exp(-np.abs(times[:, None] - times) / tau)


def bound(times, first, stationary, tau):
    """Autocovariance of a Gauss-Markov process from a first variance, by its recursion."""
    cov, variance = np.zeros((len(times), len(times))), first
    for i, t in enumerate(times):
        if i:
            phi = np.exp(-(t - times[i - 1]) / tau)
            variance = phi**2 * variance + (1.0 - phi**2) * stationary
        cov[i, i:] = cov[i:, i] = variance * np.exp(-(times[i:] - t) / tau)
    return cov


def smallest(times, first=1.0, stationary=1.0):
    """Smallest eigenvalue of bound minus autocovariance over the time constants; the arguments
    scale the two variances of the bound.
    """
    r = np.sqrt(HIGH / LOW)
    above = bound(times, first * 2.0 / (1.0 + 1.0 / r), stationary * r, np.sqrt(LOW * HIGH))
    return min(np.linalg.eigvalsh(above - gauss_markov(times, tau))[0] for tau in TAUS)


def test_the_difference_of_covariances_is_positive_semidefinite_and_nothing_smaller_is():
    dense = np.linspace(0.0, 400.0, 801)
    for times in (TIMES, dense):
        assert smallest(times) > -1e-12
    assert smallest(dense, first=0.9) < -1e-3
    assert smallest(dense, stationary=0.95) < -1e-3


def test_the_noise_is_that_of_the_formula():
    sensor, Phi, increments = bounding(celnav.Sensor(np.eye(2), R), (LOW, HIGH))
    epoch = celnav.Epoch(dt=3.0, z=np.zeros(2))
    np.testing.assert_allclose(sensor.noise @ sensor.noise.T, 1.6 * R)  # 2 / (1 + 1 / 4)
    np.testing.assert_allclose(Phi(epoch), np.exp(-3.0 / 20.0))
    np.testing.assert_allclose(increments(None, epoch), 4.0 * (1.0 - np.exp(-6.0 / 20.0)) * R)


MOTION = celnav.Motion(np.array([[1.0, 1.0], [0.0, 1.0]]), np.diag([1e-3, 1e-4]))
GPS = celnav.Sensor(np.eye(1, 2), [[4.0]])
PRIOR = celnav.Gaussian(np.zeros(2), np.diag([100.0, 1.0]))
STEPS = 60


def batch(noise_cov):
    """The last state and the measurements as linear functions of prior, process and measurement
    noise: the gain of least squares, and the covariance of its error for another noise.
    """
    F, L = MOTION.f, np.diag(np.sqrt([1e-3, 1e-4]))
    states = [np.hstack([np.diag([10.0, 1.0]), np.zeros((2, 2 * STEPS))])]
    for k in range(STEPS):
        step = F @ states[-1]
        step[:, 2 + 2 * k : 4 + 2 * k] = L
        states.append(step)
    A = np.array([state[0] for state in states])  # of positions
    last, S = states[-1], A @ A.T + noise_cov
    K = np.linalg.solve(S, A @ last.T).T
    rest = last - K @ A
    return lambda cov: rest @ rest.T + K @ cov @ K.T


@pytest.mark.parametrize("make", [celnav.colored, celnav.augmented])
def test_the_filter_predicts_the_covariance_of_the_bound_which_no_time_constant_exceeds(make):
    times = np.arange(STEPS + 1.0)
    track = celnav.run(make(MOTION, GPS, tau=(LOW, HIGH)), PRIOR, times, 0.0 * times[:, None])
    predicted = np.square(track.std[-1].reshape(-1)[:2])
    r = np.sqrt(HIGH / LOW)
    above = 4.0 * bound(times, 2.0 / (1.0 + 1.0 / r), r, np.sqrt(LOW * HIGH))
    error = batch(above)
    np.testing.assert_allclose(predicted, np.diag(error(above)), rtol=1e-7)
    actual = np.array([np.diag(error(4.0 * gauss_markov(times, tau))) for tau in TAUS])
    assert (actual <= predicted).all()
    # A fixed time constant is overconfident for longer ones.
    for tau in (LOW, np.sqrt(LOW * HIGH)):
        fixed = 4.0 * gauss_markov(times, tau)
        error = batch(fixed)
        worst = max(np.diag(error(4.0 * gauss_markov(times, t)))[0] for t in TAUS)
        assert worst > 1.02 * np.diag(error(fixed))[0]


def test_a_range_of_one_time_constant_is_the_exact_model():
    times = np.arange(40.0)
    z = np.random.default_rng(0).standard_normal((40, 1))
    Phi = [[np.exp(-1.0 / 7.0)]]
    a = celnav.run(celnav.colored(MOTION, GPS, tau=(7.0, 7.0)), PRIOR, times, z)
    b = celnav.run(celnav.colored(MOTION, GPS, Phi), PRIOR, times, z)
    np.testing.assert_allclose(a.mean, b.mean, atol=1e-10)
    np.testing.assert_allclose(a.std, b.std, rtol=1e-10)


def test_both_engines_agree():
    times = np.arange(30.0)
    z = np.random.default_rng(0).standard_normal((30, 4, 1))
    filter = celnav.colored(MOTION, GPS, tau=(LOW, HIGH))
    a, b = (celnav.run(filter, PRIOR, times, z, engine=e) for e in ("numpy", "compiled"))
    np.testing.assert_allclose(a.mean, b.mean, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "Phi: expected the transition matrix of the noise, or tau"),
        ({"tau": (5.0, 80.0), "Phi": [[0.9]]}, "tau: expected without Phi"),
        ({"tau": (5.0, 80.0), "increments": [[0.9]]}, "tau: expected without increments"),
        ({"tau": (80.0, 5.0)}, r"tau: expected \(lo, hi\) with 0 < lo <= hi, got \(80, 5\)"),
        ({"tau": (0.0, 5.0)}, "0 < lo"),
        ({"tau": 5.0}, "tau: expected"),
    ],
)
@pytest.mark.parametrize("make", [celnav.colored, celnav.augmented])
def test_a_range_that_does_not_fit_is_named(make, arguments, message):
    with pytest.raises(ValueError, match=message):
        make(MOTION, GPS, **arguments)


def test_the_covariance_must_be_a_constant_matrix():
    sensor = celnav.Sensor(lambda x, epoch: x[..., :1], lambda mean, epoch: np.eye(1))
    with pytest.raises(ValueError, match=r"R: expected a constant covariance \(m, m\)"):
        celnav.colored(MOTION, sensor, tau=(5.0, 80.0))
