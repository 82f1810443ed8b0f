"""Rare combinations, each of which was once wrong."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import celnav
from celnav import Epoch, FilterError, Gaussian, Motion, Sensor, run
from celnav.analysis.tuning import STEP, maximize_likelihood
from celnav.filters.adaptive import innovation_window
from celnav.filters.fixed_lag import FixedLag
from celnav.filters.sequential import SingleDraw
from celnav.gaussian.linalg import POSITIVE
from celnav.gaussian.spaces import EUCLIDEAN

EYE, PRIOR, TIMES = np.eye(2), Gaussian(np.zeros(2), np.eye(2)), np.arange(3.0)


def h(x, _epoch):
    return x


def test_a_measurement_of_another_length_is_refused_on_any_space_and_by_a_pickled_filter():
    angle = celnav.ukf(Motion(EYE, EYE), Sensor(EYE, EYE, space=celnav.angles([0])))
    copied = pickle.loads(pickle.dumps(celnav.ukf(Motion(EYE, EYE), Sensor(h, EYE))))
    assert copied.motion.space is EUCLIDEAN
    for filter in (angle, copied):
        with pytest.raises(ValueError, match=r"^z: expected 2 components to go with h, got 1"):
            run(filter, PRIOR, TIMES, np.ones((3, 1)))


def test_a_single_draw_with_jacobians_takes_a_missing_measurement():
    motion = Motion(
        lambda x, e, *n: 0.9 * x + n[0],
        augment=(0.1 * np.eye(1),),
        jacobian=lambda x, e: np.array([[0.9, 1.0]]),
    )
    sensor = Sensor(lambda x, e, *n: x + n[-1], augment=(0.1 * np.eye(1),))
    z = np.array([[1.0], [np.nan], [1.0]])
    track = run(SingleDraw.of(celnav.ekf(motion, sensor)), Gaussian([0.0], [[1.0]]), TIMES, z)
    plain = celnav.ukf(Motion([[0.9]], [[0.01]]), Sensor([[1.0]], [[0.01]]))
    np.testing.assert_allclose(
        track.mean, run(plain, Gaussian([0.0], [[1.0]]), TIMES, z).mean, atol=1e-9
    )


def test_a_lost_run_of_a_filter_for_colored_noise_is_told_as_one():
    twice = Sensor(np.array([[1.0, 0.0], [1.0, 0.0]]), EYE)
    filter = celnav.colored(Motion(EYE, np.zeros((2, 2))), twice, EYE, increments=np.zeros((2, 2)))
    with pytest.raises(FilterError, match="not positive definite"):
        run(filter, PRIOR, TIMES, np.ones((3, 2)))


def test_why_an_iterated_filter_is_lost_is_told():
    filter = celnav.ekf(
        Motion(EYE, np.zeros((2, 2))),
        Sensor([[1.0, 0.0], [1.0, 0.0]], np.zeros((2, 2))),
        iterations=3,
    )
    with pytest.raises(FilterError, match="a measurement without noise must not repeat what"):
        run(filter, PRIOR, TIMES, np.ones((3, 2)))


def test_a_linear_motion_that_is_not_finite_is_blamed():
    motion = Motion(
        celnav.Linear(lambda epoch: np.full((2, 2), np.nan) if epoch.k == 2 else EYE), EYE
    )
    with pytest.raises(FilterError, match="f is not finite"):
        run(celnav.ukf(motion, Sensor(EYE, EYE)), PRIOR, TIMES, np.ones((3, 2)))


def test_an_iterated_update_with_noise_through_the_points_and_a_jacobian():
    through = Sensor(
        lambda x, e, v: x[..., :1] + v,
        augment=(0.3 * np.eye(1),),
        jacobian=lambda x, e: np.array([[1.0, 0.0, 1.0]]),
    )
    beside = Sensor([[1.0, 0.0]], [[0.09]])
    z = np.ones((3, 1))
    one, two = (
        run(celnav.ekf(Motion(EYE, EYE), s, iterations=3), PRIOR, TIMES, z)
        for s in (through, beside)
    )
    np.testing.assert_allclose(one.mean, two.mean, atol=1e-9)


@pytest.mark.parametrize("runs", [4, 5])
def test_an_iterated_filter_of_runs_that_only_the_noise_has(runs):
    R = np.linspace(0.1, 2.0, runs)[:, None, None]

    def flown(noise):
        sensor = Sensor(lambda x, e: np.sin(x[..., :1]) + x[..., 1:] ** 2, noise)
        return run(
            celnav.ekf(Motion(lambda x, e: x, 0.1 * EYE), sensor, iterations=3),
            PRIOR,
            TIMES,
            np.ones((3, 1)),
        ).mean

    np.testing.assert_allclose(flown(R), np.stack([flown(each) for each in R], 1), atol=1e-12)


def test_a_window_takes_runs_that_come_later():
    motion = Motion(EYE, np.linspace(1.0, 2.0, 3)[:, None, None] * EYE)
    track = run(
        celnav.ukf(motion, Sensor(EYE, EYE), hooks=[innovation_window(2)]),
        PRIOR,
        np.arange(5.0),
        np.ones((5, 2)),
    )
    assert track.mean.shape == (5, 3, 2)
    for i, q in enumerate((1.0, 1.5, 2.0)):
        alone = celnav.ukf(Motion(EYE, q * EYE), Sensor(EYE, EYE), hooks=[innovation_window(2)])
        np.testing.assert_allclose(
            track.mean[:, i], run(alone, PRIOR, np.arange(5.0), np.ones((5, 2))).mean, atol=1e-12
        )


def test_noise_through_the_points_may_differ_from_run_to_run():
    sensor, factors = Sensor(h, EYE), np.linspace(1.0, 2.0, 3)
    kinds = [
        lambda Q: celnav.ukf(Motion(lambda x, e, w: x + w, augment=(np.sqrt(Q),)), sensor),
        lambda Q: celnav.colored(Motion(lambda x, e: x, Q), sensor, 0.5 * EYE),
    ]
    for kind in kinds:
        together = run(kind(factors[:, None, None] * EYE), PRIOR, TIMES, np.ones((3, 2))).mean
        alone = [run(kind(q * EYE), PRIOR, TIMES, np.ones((3, 2))).mean for q in factors]
        np.testing.assert_allclose(together, np.stack(alone, 1), atol=1e-12)


def test_covariances_of_a_linear_filter_stay_definite_or_are_told():
    F = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    filter = celnav.ukf(
        Motion(F, np.zeros((3, 3))), Sensor(np.eye(1, 3), [[1e-10]]), form="covariance"
    )
    track = run(
        filter,
        Gaussian(np.zeros(3), 1e8 * np.eye(3)),
        np.arange(200.0),
        np.zeros((200, 1)),
        keep="cov",
        on_failure="flag",
    )
    assert track.failed_at == -1
    assert np.isfinite(track.sqrt_cov).all()


BODY = celnav.product((celnav.attitude(), 4, 3), (celnav.EUCLIDEAN, 3, 3))
TURNED = Motion(lambda x, e: x, np.eye(6), space=BODY)
MIDDLE = np.append([0.0, 0.0, 0.0, 1.0], np.zeros(3))


@pytest.mark.parametrize("columns", [6, 7])
@pytest.mark.parametrize("kind", [np.asarray, lambda H: celnav.Linear(lambda epoch: H)])
def test_a_matrix_cannot_measure_where_states_are_no_vectors(kind, columns):
    """One message for any shape, and its remedy works."""
    prior, z = Gaussian(MIDDLE, np.eye(6)), np.ones((3, 3))
    sensor = Sensor(kind(np.eye(3, columns)), np.eye(3))
    message = (
        r"^h: expected a function where states have 7 components, 6 differences, "
        r"such as lambda x, epoch: x\[..., -3:\], got a matrix$"
    )
    with pytest.raises(ValueError, match=message):
        run(celnav.ukf(TURNED, sensor), prior, TIMES, z)
    with pytest.raises(ValueError, match=message):
        celnav.simulate(TURNED, sensor, prior, TIMES, runs=2)
    cured = celnav.ukf(TURNED, Sensor(lambda x, epoch: x[..., -3:], np.eye(3)))
    # For the last three states alone: prior variance 1, process noise 1, measurement noise 1.
    assert run(cured, prior, TIMES[:1], z[:1]).mean[0, 4:].tolist() == pytest.approx([0.5] * 3)


@pytest.mark.parametrize(
    ("mean", "n", "message"),
    [
        (MIDDLE, 7, r"prior: expected a covariance \(6, 6\) of differences of states of 7 comp"),
        (MIDDLE[:6], 6, "prior: expected 7 components for the product space, got 6"),
        (2.0 * MIDDLE, 6, "prior: expected unit quaternions, got a norm of 2"),
    ],
)
def test_a_prior_goes_with_its_space(mean, n, message):
    filter = celnav.ukf(TURNED, Sensor(lambda x, epoch: x[..., -3:], np.eye(3)))
    with pytest.raises(ValueError, match="^" + message):
        filter.start(Gaussian(mean, np.eye(n)))


def test_a_function_of_the_wrong_width_is_told_where_noise_is_colored():
    filter = celnav.colored(
        Motion(lambda x, e: x, EYE), Sensor(lambda x, e: x[..., :1], EYE), 0.5 * EYE, first=False
    )
    with pytest.raises(ValueError, match=r"^h returned shape"):
        run(filter, PRIOR, TIMES, np.ones((3, 2)))


def test_a_hook_cannot_change_what_all_filters_share():
    def hook(memory, joint, _epoch):
        joint.sign[...] = -1.0
        return memory, joint

    filter = celnav.ukf(Motion(EYE, EYE), Sensor(EYE, EYE), hooks=[hook])
    with pytest.raises(ValueError, match="read-only"):
        filter.step(filter.start(PRIOR), Epoch(0, 0.0, 0.0, None, np.ones(2)))
    assert POSITIVE.tolist() == [1.0]


@pytest.mark.parametrize("name", ["measurement", "state"])
@pytest.mark.parametrize("field", ["center", "shift", "columns"])
def test_what_a_hook_writes_into_a_joint_stays_there(name, field):
    """The center of the state is the mean of the belief before the update."""

    def hook(memory, joint, _epoch):
        getattr(getattr(joint, name), field)[...] += 1.0
        return memory, joint

    filter = celnav.ukf(Motion(EYE, EYE), Sensor(EYE, EYE), hooks=[hook])
    state = filter.start(PRIOR)
    before = [x.copy() for x in state.belief]
    after, _ = filter.step(state, Epoch(0, 0.0, 0.0, None, np.ones(2)))
    for x, y in zip(state.belief, before, strict=True):
        np.testing.assert_array_equal(x, y)
    plain = celnav.ukf(Motion(EYE, EYE), Sensor(EYE, EYE))
    again, _ = plain.step(plain.start(PRIOR), Epoch(0, 0.0, 0.0, None, np.ones(2)))
    if name == "state":  # for the measurement only the innovation has an effect
        assert not np.array_equal(after.belief.mean, again.belief.mean)


def test_a_hook_that_takes_components_away_is_told_how_many_there_are():
    def hook(memory, joint, _epoch):
        return memory, joint._replace(innovation=joint.innovation[..., :1])

    filter = celnav.ukf(Motion(EYE, EYE), Sensor(EYE, EYE), hooks=[hook])
    with pytest.raises(
        ValueError, match=r"^hooks: expected an innovation of 2 components, .*got 1"
    ):
        filter.step(filter.start(PRIOR), Epoch(0, 0.0, 0.0, None, np.ones(2)))


def test_a_search_stays_within_its_range():
    rng, tried = np.random.default_rng(2), []
    x = np.cumsum(0.02 * rng.standard_normal(60))
    epochs = celnav.epochs(np.arange(60.0), (x + 0.5 * rng.standard_normal(60))[:, None])

    def build(p):
        tried.append(p)
        return celnav.ukf(
            Motion(np.eye(1), [[p[0] ** 2]]), Sensor(np.eye(1), [[p[1] ** 2]])
        ), Gaussian([0.0], [[1.0]])

    found = maximize_likelihood(build, [1.0, 1.0], epochs)
    assert found.parameters[0] * (1.0 + 1e-12) >= 1e-3
    assert np.min(tried) >= 1e-3 * np.exp(-2.0 * STEP) * (
        1.0 - 1e-12
    )  # numerical differences may cross the boundary
    assert not found.converged
    assert found.message == "parameter 0 ran to the end of its range, 0.001"


def test_h_is_not_blamed_for_the_points_of_a_prediction_that_failed():
    """For x^2 at 0 a center weight of -19 gives a negative variance, before the measurement."""
    filter = celnav.ukf(
        Motion(lambda x, e: np.stack([x[..., 0] ** 2, x[..., 1]], -1), 0.01 * EYE),
        Sensor(lambda x, e: np.hypot(x[..., :1], 100.0), [[1.0]]),
        kappa=-1.9,
        form="covariance",
    )
    with pytest.raises(FilterError, match=r"step 1, t = 1\.0: the covariance lost positive defin"):
        run(filter, Gaussian([0.0, 0.0], EYE), TIMES, np.full((3, 1), np.nan))
    z = np.array([[np.nan], [100.0], [100.0]])
    with pytest.raises(FilterError, match=r"step 1, t = 1\.0: the covariance lost positive defin"):
        run(filter, Gaussian([0.0, 0.0], EYE), TIMES, z)


@pytest.mark.parametrize("form", ["square root", "covariance"])
@pytest.mark.parametrize("h", [[[1.0, 0.0]], lambda x, _: x[..., :1]], ids=["matrix", "function"])
@pytest.mark.parametrize("make", [celnav.ukf, celnav.ekf])
def test_an_exact_measurement_of_what_is_known_loses_only_its_run(make, h, form):
    """The other runs have the estimate and covariance that they would have alone."""
    filter = make(Motion(EYE, np.zeros((2, 2))), Sensor(h, np.zeros((1, 1))), form=form)
    P, z = np.stack([EYE + 0.5, np.diag([0.0, 1.0]), 2.0 * EYE - 0.3]), np.full((1, 3, 1), 0.7)
    options = {"keep": "cov", "on_failure": "flag"}
    found = run(filter, Gaussian(np.zeros((3, 2)), P), [0.0], z, **options)
    assert found.failed_at.tolist() == [-1, 0, -1]
    for i in (0, 2):
        alone = run(filter, Gaussian(np.zeros(2), P[i]), [0.0], z[:, i], keep="cov")
        np.testing.assert_allclose(found.mean[0, i], [0.7, 0.7 * P[i, 0, 1] / P[i, 0, 0]])
        np.testing.assert_allclose(found.mean[0, i], alone.mean[0], rtol=1e-12)
        np.testing.assert_allclose(found.cov[0, i], alone.cov[0], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("form", [(3, 2, 1), (2, 1)], ids=["noise of each run", "of all"])
@pytest.mark.parametrize("matrix", [True, False])
def test_what_is_left_of_a_known_combination_is_round_off(matrix, form):
    """Its variance is 1e-34, not 0; the component beside it is noisy."""
    v, C = np.array([1.0 / 3.0, 0.7]), np.array([[0.7, -1.0 / 3.0], [1.0, 0.0]])
    sqrt_R = np.broadcast_to([[0.0], [0.5]], form).copy()
    sensor = Sensor(C if matrix else lambda x, _: x @ C.T, sqrt_R=sqrt_R)
    filter = celnav.ukf(Motion(EYE, np.zeros((2, 2))), sensor)
    prior = Gaussian(np.full((3, 2), 3.0), np.stack([EYE + 0.5, np.outer(v, v), 2.0 * EYE]))
    track = run(filter, prior, [0.0], np.full((1, 3, 2), 3.0), on_failure="flag")
    assert track.failed_at.tolist() == [-1, 0, -1]
    assert np.isnan(track.mean[0, 1]).all()
    np.testing.assert_allclose(track.mean[0, [0, 2]] @ C[0], 3.0, rtol=1e-12)


def test_filters_equal_only_themselves():
    """They contain arrays, whose comparison is neither true nor false."""
    motion, sensor = Motion(EYE, EYE), Sensor(EYE, EYE)
    for make in (
        lambda: celnav.ukf(motion, sensor),
        lambda: celnav.ekf(motion, sensor, iterations=3),
        lambda: celnav.colored(motion, sensor, 0.5 * EYE),
        lambda: celnav.decorrelated(motion, sensor, 0.5 * EYE),
        lambda: celnav.augmented(motion, sensor, 0.5 * EYE),
        lambda: celnav.imm([celnav.ukf(motion, sensor)] * 2, 0.5 * np.ones((2, 2))),
        lambda: FixedLag(celnav.ukf(motion, sensor), 2),
        lambda: celnav.compiled(celnav.ukf(motion, sensor)),
    ):
        one, two = make(), make()
        assert one == one
        assert one != two
        assert len({one, two, one}) == 2
        assert len(repr(one)) < 200
