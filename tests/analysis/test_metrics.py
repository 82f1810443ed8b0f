"""Statistics and linear analysis against what they claim."""

from __future__ import annotations

import numpy as np

from celnav.analysis import bounds as linear_covariance
from celnav.analysis import metrics


def test_linear_analysis_of_a_white_filter_is_its_riccati_equation():
    F, H, Q, R, P0 = np.tile([[1.0, 1.0], [0.0, 1.0]], (30, 1, 1)), np.array([[1.0, 0.0]]), 0.1 * np.eye(2), np.eye(1), np.eye(2)
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
