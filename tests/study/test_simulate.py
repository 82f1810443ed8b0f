"""Drawn runs: moments against exact covariances, and a filter with the same models is consistent on
them.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from celnav import (
    Gaussian,
    Linear,
    Motion,
    Sensor,
    angles,
    augmented,
    colored,
    ekf,
    run,
    simulate,
    ukf,
)
from celnav.gaussian.attitude import attitude, log, multiply, rotate
from celnav.gaussian.belief import nees
from celnav.gaussian.spaces import EUCLIDEAN, product

RUNS = 4000
F = np.array([[1.0, 0.5], [-0.1, 0.8]])
H = np.array([[1.0, 0.0], [0.5, -1.0]])
Q, R = np.array([[0.3, 0.1], [0.1, 0.2]]), np.array([[0.5, 0.2], [0.2, 0.4]])
MEAN, P0 = np.array([1.0, -2.0]), np.array([[2.0, 0.5], [0.5, 1.0]])
PRIOR = Gaussian(MEAN, P0)
MOTION, SENSOR = Motion(F, Q), Sensor(H, R)
TIMES = np.arange(12.0)


def draw(motion=MOTION, sensor=SENSOR, prior=PRIOR, times=TIMES, runs=RUNS, **options):
    return simulate(motion, sensor, prior, times, runs=runs, **options)


def prior_of(runs=RUNS, prior=PRIOR):
    return Gaussian(np.tile(prior.mean, (runs, 1)), prior.cov)


def matches(samples, cov, other=None):
    """Whether the second moments ``(..., a, b)`` of zero-mean samples ``(..., runs, a)`` are within
    4.5 standard deviations.
    """
    other = samples if other is None else other
    products = samples[..., :, None] * other[..., None, :]
    error = products.mean(-3) - cov
    assert (np.abs(error) <= 4.5 * products.std(-3) / np.sqrt(samples.shape[-2]) + 1e-12).all(), (
        error
    )


def centered(samples, mean):
    """Differences of samples ``(runs, a)`` from their expected mean, after a check within 4.5
    standard deviations.
    """
    left = samples - mean
    assert (np.abs(left.mean(-2)) <= 4.5 * left.std(-2) / np.sqrt(left.shape[-2]) + 1e-12).all(), (
        left.mean(-2)
    )
    return left


def consistent(values, dof, level=1e-5):
    """Whether a sum of chi-square values agrees with its degrees of freedom."""
    low, high = chi2.ppf([level, 1.0 - level], dof)
    assert low < values < high, (values, dof)


def test_one_run_has_no_axis_of_runs():
    truth, z = simulate(MOTION, SENSOR, PRIOR, TIMES)
    batch = draw(runs=1)
    np.testing.assert_array_equal(truth, batch[0][:, 0])
    np.testing.assert_array_equal(z, batch[1][:, 0])
    _, both = simulate(MOTION, [SENSOR, SENSOR], PRIOR, TIMES)
    assert [one.ndim for one in both] == [2, 2]


def test_moments_are_those_of_the_model():
    """Mean and covariance of the state at every epoch, of the measurement, and of the state with
    the state one interval before.
    """
    truth, z = draw()
    assert truth.shape == z.shape == (12, RUNS, 2)
    mean, P = MEAN, P0
    for k in range(12):
        if k:
            before = centered(truth[k - 1], mean)
            mean, lagged = F @ mean, F @ P
            P = F @ P @ F.T + Q
            matches(truth[k] - mean, lagged, before)
        x = centered(truth[k], mean)
        matches(x, P)
        matches(centered(z[k], H @ mean), H @ P @ H.T + R)
        matches(z[k] - truth[k] @ H.T, 0.0 * R, x)  # noise is independent of the state
    w, v = truth[1:] - truth[:-1] @ F.T, z - truth @ H.T
    matches(w, Q)
    matches(v, R)
    matches(w[1:], 0.0 * Q, w[:-1])
    matches(v[1:], 0.0 * R, v[:-1])
    matches(v[1:], np.zeros((2, 2)), w)


@pytest.mark.parametrize("form", ["square root", "covariance"])
def test_the_filter_of_the_same_records_is_consistent(form):
    """NEES at each epoch, and NIS over all epochs; both deviate for a filter that assumes twice the
    noise.
    """
    truth, z = draw()
    track = run(ukf(MOTION, SENSOR, form=form), prior_of(), TIMES, z, keep="cov")
    for k in range(12):
        root = np.broadcast_to(track.sqrt_cov[k], (RUNS, 2, 2))
        consistent(nees(track.mean[k] - truth[k], root).sum(), 2 * RUNS)
    consistent(track.nis.sum(), track.dof.sum())
    assert track.dof.sum() == 12 * RUNS * 2
    wrong = run(ukf(Motion(F, 2.0 * Q), SENSOR, form=form), prior_of(), TIMES, z)
    assert wrong.nis.sum() < chi2.ppf(1e-5, wrong.dof.sum())


def test_several_sensors_have_noises_of_their_own():
    """Each is drawn from its model; the filter with both sensors is consistent, and accepts the
    drawn measurements unchanged.
    """
    other = Sensor(lambda x, _epoch: x[..., :1] ** 2, np.array([[0.09]]))
    truth, z = draw(sensor=[SENSOR, other])
    assert isinstance(z, tuple)
    assert [part.shape for part in z] == [(12, RUNS, 2), (12, RUNS, 1)]
    v, w = z[0] - truth @ H.T, z[1] - truth[..., :1] ** 2
    matches(v, R)
    matches(w, np.array([[0.09]]))
    matches(v, np.zeros((2, 1)), w)
    linear = [SENSOR, Sensor(np.array([[0.0, 2.0]]), [[0.2]])]
    truth, z = draw(sensor=linear)
    track = run(ukf(MOTION, *linear), prior_of(), TIMES, z, keep="cov")
    consistent(
        nees(track.mean[-1] - truth[-1], np.broadcast_to(track.sqrt_cov[-1], (RUNS, 2, 2))).sum(),
        2 * RUNS,
    )
    consistent(track.nis.sum(), track.dof.sum())
    (alone,) = draw(sensor=[SENSOR])[1]
    np.testing.assert_array_equal(alone, draw()[1])


PHI = np.array([[0.9, 0.1], [0.0, 0.6]])


@pytest.mark.parametrize("Phi", [PHI, lambda epoch: PHI], ids=["constant", "function"])
def test_colored_noise_is_stationary(Phi):
    """Covariance R at every epoch, ``Phi R`` one epoch apart and ``Phi^2 R`` two epochs apart, also
    for a full Phi.
    """
    truth, z = draw(Phi=Phi)
    V = z - truth @ H.T
    for k in range(12):
        matches(V[k], R)
        if k > 1:
            matches(V[k], PHI @ R, V[k - 1])
            matches(V[k], PHI @ PHI @ R, V[k - 2])
    matches(V[1:], np.zeros((2, 2)), truth[1:] - truth[:-1] @ F.T)


def test_filters_of_colored_noise_are_consistent_on_it_and_those_of_white_noise_are_not():
    truth, z = draw(Phi=PHI)
    for make in (colored, augmented):
        track = run(make(MOTION, SENSOR, PHI), prior_of(), TIMES, z, keep="cov")
        error, root = (
            track.mean[..., :2] - truth,
            np.broadcast_to(track.sqrt_cov[..., :2, :2], (*truth.shape, 2)),
        )
        for k in range(12):
            consistent(nees(error[k], root[k]).sum(), 2 * RUNS)
        consistent(track.nis.sum(), track.dof.sum())
    white = run(ukf(MOTION, SENSOR), prior_of(), TIMES, z)
    assert white.nis.sum() < chi2.ppf(1e-5, white.dof.sum()) or white.nis.sum() > chi2.ppf(
        1.0 - 1e-5, white.dof.sum()
    )


@pytest.mark.parametrize(
    ("several", "Phi"),
    [(False, None), (False, PHI), (True, None)],
    ids=["white", "colored", "two sensors"],
)
def test_runs_have_the_same_numbers_however_many_there_are(several, Phi):
    """And other numbers with another seed; the same numbers with the same seed."""
    motion = Motion(lambda x, epoch: np.sin(x) + epoch.dt, Q)
    sensor = [SENSOR, Sensor(lambda x, _epoch: np.cos(x), R)] if several else SENSOR

    def all_of(**options):
        truth, z = draw(motion, sensor, Phi=Phi, **options)
        return (truth, *(z if several else (z,)))

    for few, many, other in zip(
        all_of(runs=3, seed=7), all_of(runs=8, seed=7), all_of(runs=8, seed=8), strict=True
    ):
        np.testing.assert_allclose(many[:, :3], few, rtol=0, atol=1e-14)
        assert (np.abs(many - other).max(0) > 1e-3).all()
        assert np.abs(np.diff(many, axis=1)).min() > 0.0  # each run has its numbers
    for one, again in zip(all_of(runs=5), all_of(runs=5, seed=0), strict=True):
        np.testing.assert_array_equal(one, again)


def test_noise_through_the_points_and_beside_them():
    """``x' = x (1 + w) + u``, ``z = x v + e``: products of Gaussians, whose moments are known."""
    a, b = np.array([[0.2]]), np.array([[0.3]])
    motion = Motion(lambda x, epoch, w: x * (1.0 + w) + epoch.u, [[0.04]], augment=(a,))
    sensor = Sensor(lambda x, _epoch, v: x * v, [[0.01]], augment=(b,))
    truth, z = draw(
        motion,
        sensor,
        Gaussian([3.0], [[0.25]]),
        np.arange(3.0),
        20_000,
        u=np.array([[1.0], [-2.0]]),
    )
    mean, second = 3.0, 9.25
    for k, u in enumerate((None, 1.0, -2.0)):
        if u is not None:
            mean, second = mean + u, 1.04 * second + 2.0 * u * mean + u**2 + 0.04
        matches(centered(truth[k], [mean]), [[second - mean**2]])
        matches(z[k], [[0.09 * second + 0.01]])
        matches(z[k], [[0.0]], truth[k])
    only = Sensor(lambda x, _epoch, v: x + v, augment=(b,))  # all the noise there is
    truth, z = draw(
        motion, only, Gaussian([3.0], [[0.25]]), np.arange(3.0), 20_000, u=np.zeros((2, 1))
    )
    matches(z - truth, [[0.09]])


def test_noise_may_depend_on_the_state_and_the_epoch():
    """Intervals and inputs belong to the epoch at their end; a noise function is evaluated for each
    run.
    """
    times = np.array([0.0, 0.5, 0.5, 3.0])
    motion = Motion(
        Linear(lambda epoch: np.eye(1) * (1.0 + epoch.dt)), lambda mean, epoch: epoch.dt * np.eye(1)
    )
    sensor = Sensor(np.eye(1), sqrt_R=lambda mean, _epoch: np.abs(mean)[..., None])
    truth, z = draw(motion, sensor, Gaussian([5.0], [[1.0]]), times)
    np.testing.assert_array_equal(truth[1], truth[2])  # no interval, no motion
    assert np.abs(z[1] - z[2]).min() > 0.0  # but measured twice
    matches(truth[1] - 1.5 * truth[0], [[0.5]])
    matches(truth[3] - 3.5 * truth[2], [[2.5]])
    matches((z - truth) / truth, [[1.0]])


def test_without_noise_nothing_is_drawn_but_the_start():
    truth, z = draw(
        Motion(F, np.zeros((2, 2))),
        Sensor(H, np.zeros((2, 2))),
        Gaussian(MEAN, np.zeros((2, 2))),
        runs=2,
    )
    expected = np.array([np.linalg.matrix_power(F, k) @ MEAN for k in range(12)])
    np.testing.assert_allclose(truth, np.repeat(expected[:, None], 2, 1), rtol=1e-12)
    np.testing.assert_allclose(z, truth @ H.T, rtol=1e-12)


def test_angles_wrap_and_are_drawn_about_the_seam():
    """A heading that crosses +-pi, measured as an angle: states and measurements wrap, their
    difference does not.
    """
    wrapped, seen = angles([0]), angles()
    motion = Motion(
        lambda x, epoch: x @ np.array([[1.0, epoch.dt], [0.0, 1.0]]).T,
        np.diag([1e-3, 1e-4]),
        space=wrapped,
    )
    sensor = Sensor(lambda x, _epoch: x[..., :1], [[0.04]], space=seen)
    prior = Gaussian([3.0, 0.3], np.diag([0.1, 0.01]))
    truth, z = draw(motion, sensor, prior)
    for values in (truth[..., 0], z):
        assert (values >= -np.pi).all()
        assert (values < np.pi).all()
        assert values.max() > 3.0
        assert values.min() < -3.0
    matches(wrapped.minus(truth[0], prior.mean), prior.cov)
    matches(
        wrapped.minus(truth[1:], truth[:-1] @ np.array([[1.0, 1.0], [0.0, 1.0]]).T),
        np.diag([1e-3, 1e-4]),
    )
    matches(seen.minus(z, truth[..., :1]), [[0.04]])
    track = run(ukf(motion, sensor), prior_of(prior=prior), TIMES, z, keep="cov")
    error = wrapped.minus(track.mean, truth)
    consistent(nees(error[-1], track.sqrt_cov[-1]).sum(), 2 * RUNS)
    consistent(track.nis.sum(), track.dof.sum())


def test_attitudes_are_drawn_by_their_deviations():
    """A quaternion and a drift, ``N = 7`` and ``n = 6``: the start and the noise are rotations with
    the given covariance.
    """
    space = product((attitude(), 4, 3), (EUCLIDEAN, 3, 3))
    mean = np.array([0.6, 0.0, 0.0, 0.8, 1.0, 2.0, 3.0])
    cov, noise = (
        np.diag([1e-2, 2e-2, 3e-2, 1.0, 2.0, 3.0]) ** 2,
        np.diag([3e-3, 2e-3, 1e-3, 0.1, 0.2, 0.3]) ** 2,
    )
    sensor = Sensor(lambda x, _epoch: rotate(x[..., :4], np.eye(3)[0]), 1e-6 * np.eye(3))
    truth, z = draw(
        Motion(lambda x, _epoch: x, noise, space=space), sensor, Gaussian(mean, cov), np.arange(3.0)
    )
    assert truth.shape == (3, RUNS, 7)
    np.testing.assert_allclose(np.linalg.norm(truth[..., :4], axis=-1), 1.0, atol=1e-12)
    conjugate = truth[:-1, :, :4] * [-1.0, -1.0, -1.0, 1.0]
    matches(log(multiply(truth[1:, :, :4], conjugate)), noise[:3, :3])
    matches(truth[1:, :, 4:] - truth[:-1, :, 4:], noise[3:, 3:])
    matches(log(multiply(truth[0, :, :4], mean[:4] * [-1.0, -1.0, -1.0, 1.0])), cov[:3, :3])
    matches(z - rotate(truth[..., :4], np.eye(3)[0]), 1e-6 * np.eye(3))


def test_a_nonlinear_filter_is_nearly_consistent_on_what_its_models_draw():
    motion = Motion(
        lambda x, epoch: x + epoch.dt * np.stack([x[..., 1], -np.sin(x[..., 0])], -1),
        np.diag([1e-4, 1e-3]),
    )
    sensor = Sensor(lambda x, _epoch: np.sin(x[..., :1]), [[0.01]])
    prior, times = Gaussian([0.5, 0.0], np.diag([0.01, 0.01])), 0.1 * np.arange(40)
    truth, z = draw(motion, sensor, prior, times, runs=500)
    for filter in (ukf(motion, sensor), ekf(motion, sensor)):
        track = run(filter, prior_of(500, prior), times, z, keep="cov")
        np.testing.assert_allclose(nees(track.mean - truth, track.sqrt_cov).mean(), 2.0, rtol=0.1)
        np.testing.assert_allclose(track.nis.sum() / track.dof.sum(), 1.0, rtol=0.05)


def test_models_that_write_to_their_argument_change_nothing():
    def f(x, _epoch):
        x += 1.0
        return x

    def h(x, _epoch):
        x *= 2.0
        return x

    writing, pure = (
        (Motion(f, Q), Sensor(h, R)),
        (Motion(lambda x, _e: x + 1.0, Q), Sensor(lambda x, _e: 2.0 * x, R)),
    )
    for mine, other in zip(draw(*writing, runs=3), draw(*pure, runs=3), strict=True):
        np.testing.assert_array_equal(mine, other)


def moved(x, _epoch):
    return x @ F.T


def seen(x, _epoch):
    return x @ H.T


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motion": F}, r"^motion: expected .*celnav.Motion\(f, Q\), got ndarray"),
        ({"sensor": H}, r"^sensor: expected .*celnav.Sensor\(h, R\), got ndarray"),
        ({"sensor": [SENSOR, H]}, r"^sensor: expected .*celnav.Sensor\(h, R\), got ndarray"),
        ({"sensor": [SENSOR, SENSOR], "Phi": PHI}, r"^Phi: expected one sensor with it, got 2"),
        ({"Phi": 2.0 * np.eye(2)}, r"^Phi: expected a spectral radius of at most 1, got 2"),
        ({"Phi": np.eye(3)}, r"^Phi: expected shape \(\.\.\., 2, 2\), got \(3, 3\)"),
        (
            {"prior": Gaussian(np.zeros((3, 2)), P0)},
            r"^prior: expected one mean \(N,\) and covariance \(n, n\), got \(3, 2\)",
        ),
        ({"prior": (MEAN, P0)}, r"^prior: expected "),
        ({"prior": Gaussian(np.zeros(3), np.eye(3))}, r"^(prior|f|h): expected "),
        ({"runs": 0}, r"^runs: expected a positive integer, got 0"),
        ({"runs": 2.5}, r"^runs: expected a positive integer, got 2.5"),
        ({"times": [1.0, 0.0]}, r"^times: expected times that do not decrease"),
        ({"u": np.zeros((3, 1))}, r"^u: expected 11 rows for 12 times .*, got 3"),
        (
            {"motion": Motion(lambda x, _epoch: x[..., :1], Q)},
            r"^f returned shape \(1, 2, 1\), expected \(1, 2, 2\)",
        ),
        (
            {"sensor": Sensor(lambda x, _epoch: x[..., 0], R)},
            r"^h returned shape \(1, 2\), expected ",
        ),
        ({"motion": Motion(moved, np.eye(3))}, r"^Q: expected 2 rows"),
        (
            {"motion": Motion(moved, np.eye(1))},
            r"^Q: expected 2 rows",
        ),  # one number for both components would result
        ({"sensor": Sensor(seen, np.eye(3))}, r"^R: expected 2 rows"),
        ({"sensor": Sensor(seen, np.eye(1))}, r"^R: expected 2 rows"),
    ],
)
def test_bad_input_is_refused_by_name(change, message):
    with pytest.raises(ValueError, match=message):
        draw(**{"runs": 2} | change)
