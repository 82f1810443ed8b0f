"""Noise models against closed forms and against their own definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad_vec
from scipy.linalg import expm

from celnav.models.noise import ar1, effective_covariance, stationary_covariance, van_loan

PHI = np.array([[0.8, 0.1], [-0.2, 0.5]])
R = np.array([[1.0, 0.3], [0.3, 0.5]])


def test_stationary_covariance_is_the_sum_of_the_past():
    term, total = R, R
    for _ in range(400):
        term = PHI @ term @ PHI.T
        total = total + term
    np.testing.assert_allclose(stationary_covariance(PHI, R), total, rtol=1e-12)


def test_stationary_covariance_of_a_scalar():
    np.testing.assert_allclose(stationary_covariance([[0.8]], [[1.0]]), [[1.0 / 0.36]], rtol=1e-13)


def test_effective_covariance_is_the_spectrum_at_zero():
    """The sum of all autocovariances."""
    sigma = stationary_covariance(PHI, R)
    spectrum, power = sigma.copy(), np.eye(2)
    for _ in range(400):
        power = PHI @ power
        spectrum = spectrum + power @ sigma + (power @ sigma).T
    np.testing.assert_allclose(effective_covariance(PHI, R), spectrum, rtol=1e-11)
    np.testing.assert_allclose(effective_covariance(0.8 * np.eye(2), R), R / 0.04, rtol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.sampled_from([(), (3,), (2, 3)]), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_ar1_obeys_its_recursion(batch, steps, seed):
    rng = np.random.default_rng(seed)
    zeta, first = rng.normal(size=(steps, *batch, 2)), rng.normal(size=(*batch, 2))
    V = ar1(PHI, zeta, first)
    assert V.shape == (steps + 1, *batch, 2)
    np.testing.assert_array_equal(V[0], first)
    np.testing.assert_allclose(V[1:], V[:-1] @ PHI.T + zeta, atol=1e-14)


def test_ar1_of_each_run_has_its_own_coefficient():
    rng = np.random.default_rng(1)
    phi, zeta = 0.3 * rng.normal(size=(4, 2, 2)), rng.normal(size=(5, 4, 2))
    V = ar1(phi, zeta, np.zeros((4, 2)))
    for i in range(4):
        np.testing.assert_allclose(V[:, i], ar1(phi[i], zeta[:, i], np.zeros(2)), atol=1e-14)


def test_ar1_from_its_stationary_covariance_stays_there():
    rng = np.random.default_rng(2)
    sigma, runs = stationary_covariance(PHI, R), 100_000
    first = rng.normal(size=(runs, 2)) @ np.linalg.cholesky(sigma).T
    V = ar1(PHI, rng.normal(size=(3, runs, 2)) @ np.linalg.cholesky(R).T, first)
    np.testing.assert_allclose(np.cov(V[-1].T), sigma, atol=5.0 * sigma.max() * np.sqrt(2.0 / runs))


@pytest.mark.parametrize("dt", [0.0, 1e-3, 1.0, 30.0])
def test_van_loan_of_constant_velocity_is_the_closed_form(dt):
    F, Q = van_loan([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[0.7]], dt)
    np.testing.assert_allclose(F, [[1.0, dt], [0.0, 1.0]], rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(
        Q, 0.7 * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]]), rtol=1e-12
    )


def test_van_loan_of_a_markov_process_is_the_closed_form():
    beta, dt = 0.2, 3.0
    F, Q = van_loan([[-beta]], [[1.0]], [[2.0]], dt)
    np.testing.assert_allclose(F, [[np.exp(-beta * dt)]], rtol=1e-13)
    np.testing.assert_allclose(
        Q, [[2.0 * (1.0 - np.exp(-2.0 * beta * dt)) / (2.0 * beta)]], rtol=1e-13
    )


def test_van_loan_is_the_integral():
    rng = np.random.default_rng(3)
    A, G = 0.5 * rng.normal(size=(3, 3)), rng.normal(size=(3, 2))
    q = np.array([[1.0, 0.2], [0.2, 0.5]])
    F, Q = van_loan(A, G, q, 0.8)
    expected, _ = quad_vec(
        lambda s: expm(A * s) @ G @ q @ G.T @ expm(A * s).T, 0.0, 0.8, epsabs=1e-13
    )
    np.testing.assert_allclose(F, expm(0.8 * A), rtol=1e-12)
    np.testing.assert_allclose(Q, expected, rtol=1e-11)
    np.testing.assert_array_equal(Q, Q.T)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: stationary_covariance(np.eye(2), R),
            "Phi: expected a spectral radius below 1.*got 1",
        ),
        (lambda: stationary_covariance(1.5 * np.eye(2), R), "Phi"),
        (lambda: stationary_covariance(0.5, R), r"Phi: expected shape \(m, m\)"),
        (lambda: stationary_covariance(np.ones((2, 3)), R), r"Phi: expected shape \(m, m\)"),
        (lambda: stationary_covariance(PHI, np.eye(3)), "R: expected .*got shape"),
        (lambda: stationary_covariance(PHI, -R), "R: expected symmetric positive semidefinite"),
        (lambda: effective_covariance(np.eye(2), R), "Phi"),
        (
            lambda: van_loan(np.ones((2, 3)), np.ones((2, 1)), [[1.0]], 1.0),
            r"F: expected shape \(n, n\)",
        ),
        (lambda: van_loan(2.0, np.ones((2, 1)), [[1.0]], 1.0), r"F: expected shape \(n, n\)"),
        (lambda: van_loan(np.eye(2), np.ones((2, 1)), [[-1.0]], 1.0), "spectral_density"),
        (
            lambda: van_loan(np.eye(2), np.ones((2, 1)), [[1.0]], -1.0),
            "dt: expected a number of at least 0, got -1",
        ),
        (lambda: van_loan(np.eye(2), np.ones((2, 1)), [[1.0]], np.nan), "dt"),
    ],
)
def test_noise_models_refuse_and_say_what(call, words):
    with pytest.raises(ValueError, match=words):
        call()
