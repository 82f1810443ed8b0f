"""Fixes from single measurements: against a linear solution, a known position, and undetermined
states.
"""

from __future__ import annotations

import numpy as np
import pytest

from celnav import Gaussian, Sensor, epochs, run
from celnav.models import pseudorange
from celnav.receiver.constellation import synthetic
from celnav.receiver.least_squares import least_squares

H = np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 2.0], [1.0, -1.0]])
SIGMA = np.array([0.5, 1.0, 2.0, 0.7])
FUNCTION = Sensor(
    lambda x, _e: x @ H.T,
    np.diag(SIGMA**2),
    jacobian=lambda x, _e: np.broadcast_to(H, (*x.shape[:-1], 4, 2)),
)
MATRIX = Sensor(H, np.diag(SIGMA**2))
EITHER = pytest.mark.parametrize("sensor", [FUNCTION, MATRIX], ids=["function", "matrix"])


def guess(*batch):
    return Gaussian(np.zeros((*batch, 2)), np.eye(2))


@EITHER
def test_a_linear_fix_is_the_weighted_solution(sensor):
    z = np.random.default_rng(0).normal(size=(5, 3, 4))
    z[2, 1, 0] = np.nan
    track = run(least_squares(sensor), guess(3), epochs(np.arange(5), z), keep="cov")
    for k in range(5):
        for r in range(3):
            used = ~np.isnan(z[k, r])
            G = (H / SIGMA[:, None])[used]
            expected = np.linalg.lstsq(G, (z[k, r] / SIGMA)[used], rcond=None)[0]
            np.testing.assert_allclose(track.mean[k, r], expected, atol=1e-12)
            np.testing.assert_allclose(track.cov[k, r], np.linalg.inv(G.T @ G), atol=1e-12)
            left = (z[k, r] / SIGMA)[used] - G @ expected
            np.testing.assert_allclose(track.whitened[k, r, used], left, atol=1e-12)


@EITHER
def test_what_is_not_determined_is_nan_for_that_epoch_only(sensor):
    z = np.random.default_rng(1).normal(size=(4, 2, 4))
    z[1, 0] = np.nan
    z[2, 1, 1:] = np.nan
    track = run(least_squares(sensor), guess(2), epochs(np.arange(4), z), on_failure="flag")
    assert np.isnan(track.mean[1, 0]).all()
    assert np.isnan(track.mean[2, 1]).all()
    assert np.isfinite(track.mean[3]).all()
    assert np.isfinite(track.mean[1, 1]).all()


def test_a_receiver_is_found_from_the_middle_of_the_earth():
    truth = np.array([-2613e3, 4739e3, 3365e3, 120.0, -300.0, 200.0, 3e4, 30.0])
    seen = pseudorange.sources(synthetic(), 347400.0, truth[:3], truth[3:6])
    z = pseudorange.measure(truth, seen.q, seen.w)
    sensor = Sensor(
        lambda x, _e: pseudorange.measure(x, seen.q, seen.w),
        np.diag(np.repeat([3.0, 0.1], 32) ** 2),
        jacobian=lambda x, _e: pseudorange.jacobian(x, seen.q, seen.w),
    )
    track = run(least_squares(sensor), Gaussian(np.zeros(8), np.eye(8)), epochs([0.0], z[None]))
    np.testing.assert_allclose(track.mean[0], truth, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: least_squares(lambda x, _e: x), "sensor"),
        (lambda: least_squares(Sensor(lambda x, _e: x, np.eye(2))), "sensor"),
        (lambda: least_squares(MATRIX, rounds=0), "rounds"),
        (
            lambda: run(
                least_squares(Sensor(H, np.zeros((4, 4)))), guess(), epochs([0.0], np.ones((1, 4)))
            ),
            "R",
        ),
        (lambda: run(least_squares(MATRIX), guess(), epochs([0.0], np.ones((1, 3)))), "z"),
    ],
)
def test_bad_input_is_refused_by_name(make, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        make()


@pytest.mark.parametrize("matrix", [False, True])
@pytest.mark.parametrize("shape", [(2,), (0,), (4, 2), (4, 0), (0, 2), (0, 0)])
def test_fewer_measurements_than_states_make_no_fix(shape, matrix):
    """They do not raise an error, for any axes of runs: the state is nan, and a later complete
    measurement starts from the last fix.
    """
    m, few = shape[-1], np.eye(3)[: shape[-1]]
    seen = lambda x, _e: np.broadcast_to(few, (*x.shape[:-1], m, 3))  # noqa: E731
    sensor = (
        Sensor(few, np.eye(m))
        if matrix
        else Sensor(lambda x, _e: x @ few.T, np.eye(m), jacobian=seen)
    )
    prior = Gaussian(np.zeros((*shape[:-1], 3)), np.eye(3))
    track = run(
        least_squares(sensor), prior, epochs([0.0, 1.0], np.ones((2, *shape))), on_failure="flag"
    )
    assert track.mean.shape == (2, *shape[:-1], 3)
    assert np.isnan(track.mean).all()
    np.testing.assert_array_equal(track.failed_at, np.zeros(shape[:-1]))
