"""Correlated errors: their shares are estimated from residuals, and the covariances of a filter
that treats them as white agree with simulated runs.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Covariance
from celnav.receiver.correlated import WINDOW, Correlation, Errors, correlation

TIMES = np.arange(1500.0)


def errors(shares, time, shape, seed=0):
    """Unit errors ``(T, ...)``: white, with a correlation time, and constant."""
    rng, (short, long) = np.random.default_rng(seed), shares
    phi, lasting = np.exp(-1.0 / time), rng.normal(size=shape)
    for k in range(1, shape[0]):
        lasting[k] = phi * lasting[k - 1] + np.sqrt(1.0 - phi**2) * lasting[k]
    constant = rng.normal(size=shape[1:])
    white = rng.normal(size=shape)
    return np.sqrt(1.0 - short - long) * white + np.sqrt(short) * lasting + np.sqrt(long) * constant


@pytest.mark.parametrize("shares", [(0.0, 0.0), (0.5, 0.0), (0.0, 0.4), (0.4, 0.3)])
def test_shares_are_found(shares):
    left = errors(shares, 15.0, (len(TIMES), 1000))
    kept = np.random.default_rng(1).random(left.shape) < 0.8
    found = correlation(TIMES, np.where(kept, left, 9.0), kept, 10_000)
    assert found.short == pytest.approx(shares[0], abs=0.04)
    assert found.long == pytest.approx(shares[1] + 0.01, abs=0.04)
    if shares[0]:
        assert 8.0 <= found.time <= 32.0


@pytest.mark.parametrize(("T", "redundancy"), [(12, 50), (0, 50), (1500, 0)])
def test_of_a_short_log_all_counts_as_lasting(T, redundancy):
    left = errors((0.0, 0.0), 1.0, (1500, 6))[:T]
    assert correlation(TIMES[:T], left, left < 9.0, redundancy) == Correlation(0.0, 1.0, 1.0)


SHARES, TIME, SIGMA = (0.4, 0.3), 12.0, 2.0
STEPS, RUNS = 80, 10_000


@pytest.fixture(scope="module")
def simulated():
    """A filter for a random-walk position and a clock, with errors ``(T, runs, 7)`` that it treats
    as white; errors of its state, means of distances, and the predicted covariances of both.
    """
    rng = np.random.default_rng(2)
    H = np.concatenate([rng.normal(size=(7, 3)), np.ones((7, 1))], -1)
    F, Q, R = np.eye(4) + 0.05 * np.eye(4, k=3), np.diag([0.3, 0.2, 0.4, 1.0]), SIGMA**2 * np.eye(7)
    G = np.linalg.pinv(H)[:3]
    slow = SIGMA * np.sqrt(np.repeat([SHARES], 7, 0).T)
    decay = np.repeat([[np.exp(-1.0 / TIME)], [1.0]], 7, 1)
    eps = SIGMA * errors(SHARES, TIME, (STEPS, RUNS, 7), 3)
    P = 4.0 * np.eye(4)
    e, mean = 2.0 * rng.normal(size=(RUNS, 4)), np.zeros((RUNS, 3))
    found = Errors.at_start(Covariance.of(Gaussian(np.zeros(4), P)), 7)
    for k in range(STEPS):
        before, P = P, F @ P @ F.T + Q
        e = e @ F.T - rng.normal(size=(RUNS, 4)) @ np.linalg.cholesky(Q).T
        found = found.predict(F, before, P, decay)
        distance = eps[k] @ G.T - e[:, :3] if k != 10 else None
        K = P @ H.T @ np.linalg.solve(H @ P @ H.T + R, np.eye(7)) * (k % 7 != 3)
        e = e + (eps[k] - e @ H.T) @ K.T
        if distance is not None:
            mean = mean + (distance - mean) / WINDOW
        P = (np.eye(4) - K @ H) @ P
        one = None if distance is None else distance[0]
        found = found.update(K, H, np.full(7, SIGMA**2), slow, G, one)
    np.testing.assert_allclose(found.mean, mean[0])
    return np.concatenate([e, mean], -1), found, P


def test_covariances_are_those_of_simulated_runs(simulated):
    samples, found, P = simulated
    L = np.linalg.cholesky(found.cov)
    whitened = np.linalg.solve(L, samples.T @ samples / RUNS) @ np.linalg.inv(L).T
    np.testing.assert_allclose(whitened, np.eye(7), atol=5.0 / np.sqrt(RUNS))
    # The filter's covariance is much too small.
    assert (samples[:, :3].var(0) > 1.5 * P.diagonal()[:3]).all()


def test_the_mean_distance_is_chi_square(simulated):
    samples, found, _ = simulated
    squares = np.array([found._replace(mean=m).squared_mean for m in samples[:, 4:]])
    assert squares.mean() == pytest.approx(3.0, abs=0.2)
    for p in (0.5, 0.1, 0.01):
        assert (squares > chi2.isf(p, 3)).mean() == pytest.approx(p, rel=0.1, abs=0.005)
