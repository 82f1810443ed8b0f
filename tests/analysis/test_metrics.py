"""Statistics and linear analysis against their definitions."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy import stats

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
    """RMS of 300 series of 2000 epochs with a correlation of 0.9 from one epoch to the next: about
    a tenth of the epochs are independent.
    """
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


@pytest.mark.parametrize(
    ("error", "axis", "text"),
    [
        (3.0, 0, r"error: expected at least one run, got shape \(\)"),
        ([], 0, r"error: expected at least one run, got shape \(0,\)"),
        ([], 1, r"error: expected at least one run, got shape \(0,\)"),
        (np.ones((5, 0, 2)), 1, r"error: expected at least one run, got shape \(5, 0, 2\)"),
        (np.ones((5, 0, 2)), -2, r"error: expected at least one run, got shape \(5, 0, 2\)"),
        (np.ones((5, 4, 2)), 3, r"axis: expected an integer from -3 to 2, got 3"),
        (np.ones((5, 4, 2)), -4, r"axis: expected an integer from -3 to 2, got -4"),
        (np.ones((5, 4, 2)), 1.5, r"axis: expected an integer from -3 to 2, got 1.5"),
        (np.ones(4), 1, r"axis: expected an integer from -1 to 0, got 1"),
    ],
)
@pytest.mark.parametrize("measure", [metrics.rmse, metrics.rmse_interval])
def test_errors_without_runs_are_refused(measure, error, axis, text):
    with pytest.raises(ValueError, match=f"^{text}$"):
        measure(error, axis=axis)


@pytest.mark.parametrize("axis", [0, 1, 2, -1, -2, -3])
def test_the_rmse_is_the_length_over_the_runs(axis):
    """Along any axis, also without epochs or components; nan of a failed run is propagated."""
    error = np.random.default_rng(5).normal(size=(4, 5, 6))
    error[2, 3, 1] = np.nan
    found = metrics.rmse(error, axis)
    expected = np.linalg.norm(error, axis=axis) / np.sqrt(error.shape[axis])
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    assert np.isnan(found).sum() == 1
    low, high = metrics.rmse_interval(error, 0.9, axis)
    runs = error.shape[axis]
    np.testing.assert_allclose(low, found * np.sqrt(runs / stats.chi2.ppf(0.95, runs)), rtol=1e-12)
    np.testing.assert_allclose(high, found * np.sqrt(runs / stats.chi2.ppf(0.05, runs)), rtol=1e-12)
    assert metrics.rmse(np.ones((0, 3, 2))).shape == (0, 2)
    assert metrics.rmse([3.0, 4.0], axis=0) == np.sqrt(12.5)
    assert metrics.rmse([-3.0], axis=0) == 3.0


def test_the_interval_of_a_positive_quantity_is_positive():
    """Also for few runs, one of which is much worse; the interval of a mean may be negative."""
    squares = np.array([0.01, 0.02, 0.01, 4.0])
    low, high = metrics.bootstrap(metrics.rms, squares)
    value = metrics.rms(squares)
    assert 0.0 < low < value < high
    assert metrics.bootstrap(np.mean, np.append(squares, -1e-9))[0] < 0.0
    assert metrics.bootstrap(metrics.rms, np.zeros(4)) == (0.0, 0.0)
    # Many runs: the normal approximation, for which a factor and a sum agree.
    many = np.random.default_rng(6).chisquare(1.0, 4000)
    found, half = metrics.bootstrap(np.mean, many), 1.96 * np.sqrt(2.0 / 4000)
    np.testing.assert_allclose(found, many.mean() + np.array([-half, half]), rtol=0.01)


@pytest.mark.parametrize("runs", [5, 10, 30])
def test_intervals_of_an_rmse_cover_for_few_runs_too(runs):
    """For squares of Gaussian errors, in at least 90 % of 400 experiments."""
    squares = np.random.default_rng(runs).chisquare(1.0, (400, runs))
    found = [metrics.bootstrap(metrics.rms, one, resamples=200) for one in squares]
    assert min(low for low, _ in found) > 0.0
    held = np.mean([low <= 1.0 <= high for low, high in found])
    assert held > 0.9 - 4.0 * np.sqrt(0.09 / 400)


@pytest.mark.parametrize("block", [1, 3])
@pytest.mark.parametrize("level", [0.95, 0.8])
def test_an_interval_is_widened_as_students_t_asks(block, level):
    """For a statistic with values given by hand; for a positive statistic on a logarithmic scale."""
    drawn = np.random.default_rng(5).uniform(1.0, 4.0, 60)

    def ends(sample, first=2.0):
        values = iter([first, *drawn])
        return metrics.bootstrap(
            lambda _: next(values), sample, block=block, level=level, resamples=60
        )

    blocks, upper = 12 / block, (1.0 + level) / 2.0
    wider = stats.t(blocks - 1).ppf(upper) / stats.norm.ppf(upper)
    wider *= np.sqrt(blocks / (blocks - 1))
    outer = np.quantile(drawn, [1.0 - upper, upper])
    for sample, first in ((-np.ones(12), 2.0), (np.ones(12), -2.0)):
        expected = first + wider * (outer - first)
        np.testing.assert_allclose(ends(sample, first), expected, rtol=1e-12)
    expected = np.exp(np.log(2.0) + wider * (np.log(outer) - np.log(2.0)))
    np.testing.assert_allclose(ends(np.ones(12)), expected, rtol=1e-12)


@pytest.mark.parametrize("samples", [(), ([1.0],), ([1.0], [1.0]), ([1.0, 2.0, 3.0], [1.0, 2.0])])
def test_samples_have_as_many_runs_two_or_more(samples):
    lengths = re.escape(str([len(sample) for sample in samples]))
    with pytest.raises(ValueError, match=f"^samples: expected two runs or more, .* got {lengths}"):
        metrics.bootstrap(lambda *_: 1.0, *samples)
