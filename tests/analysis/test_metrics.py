"""Statistics and linear analysis against what they claim."""

from __future__ import annotations

import numpy as np

from celnav.analysis import bounds as linear_covariance
from celnav.analysis import metrics


def test_linear_analysis_of_a_white_filter_is_its_riccati_equation():
    F, H, Q, R, P0 = (
        np.tile([[1.0, 1.0], [0.0, 1.0]], (30, 1, 1)),
        np.array([[1.0, 0.0]]),
        0.1 * np.eye(2),
        np.eye(1),
        np.eye(2),
    )
    solved = linear_covariance.riccati(F, H, Q, R, P0)
    actual = linear_covariance.actual_covariance(F, H, solved.gains, Q, np.zeros((1, 1)), R, P0, R)
    np.testing.assert_allclose(actual, solved.covariances, rtol=1e-10)
    bound = linear_covariance.colored_bound(F, H, np.zeros((1, 1)), Q, R, P0)
    np.testing.assert_allclose(bound, solved.covariances, rtol=1e-10)


def test_bands_and_intervals_cover_as_they_say():
    rng = np.random.default_rng(2)
    low, high = metrics.chi_square_band(6, 100)
    np.testing.assert_allclose([low, high], [5.34, 6.70], atol=0.01)
    errors = rng.normal(size=(2000, 50, 1))
    a, b = metrics.rmse_interval(errors)
    assert abs(((a <= 1) & (b >= 1)).mean() - 0.95) < 0.02
    covered = [metrics.bootstrap(np.mean, rng.normal(size=30), resamples=200) for _ in range(200)]
    assert np.mean([c[0] <= 0 <= c[1] for c in covered]) > 0.88


def test_blocks_of_time_cover_where_errors_are_correlated_and_single_epochs_do_not():
    """RMS of 300 series of 2000 epochs, correlated by 0.9 from one to the next: a tenth as many of them are independent."""
    rng, phi = np.random.default_rng(3), 0.9
    series = rng.standard_normal((300, 2000))
    for k in range(1, 2000):
        series[:, k] = phi * series[:, k - 1] + np.sqrt(1.0 - phi**2) * series[:, k]

    def covered(block):
        found = [
            metrics.bootstrap(metrics.rms, np.square(one), block=block, resamples=100)
            for one in series
        ]
        return np.mean([low <= 1.0 <= high for low, high in found])

    assert 0.90 < covered(100) < 0.985
    assert covered(1) < 0.75


def test_a_block_of_one_is_none_and_blocks_go_round():
    samples = np.random.default_rng(0).normal(size=31)
    assert metrics.bootstrap(np.mean, samples, block=1) == metrics.bootstrap(np.mean, samples)
    low, high = metrics.bootstrap(len, samples, block=10)  # the last block is cut
    assert low == high == 31
