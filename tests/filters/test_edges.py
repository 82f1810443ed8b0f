"""Edge cases: no noise, missing components, axes of runs in one argument only, angles at +-pi,
intervals of 0.
"""

import numpy as np
import pytest

import celnav
from celnav.filters.adaptive import (
    channel_parity,
    gate,
    group_parity,
    huber,
    innovation_window,
    sage_husa,
    student_t,
)
from celnav.filters.run import explain
from celnav.gaussian.linalg import Covariance
from celnav.receiver.least_squares import least_squares

EYE = np.eye(2)
FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])
H = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0], [0.5, 2.0], [2.0, 0.5]])


def still(x, epoch):
    return x


def seen(x, epoch):
    return x @ H.T


MOTION, SENSOR = celnav.Motion(still, EYE), celnav.Sensor(EYE, EYE)
PRIOR, MANY = celnav.Gaussian(np.zeros(2), EYE), celnav.Gaussian(np.zeros((3, 2)), EYE)


CORRELATED = np.array([[1.0, 0.3], [0.3, 2.0]])


def updated(filter, prior, z):
    """Belief and `Info` after one measurement."""
    state, (info,) = filter.update(filter.start(prior), celnav.Epoch(z=z))
    return state.belief, info


def exact(h, form, none, **options):
    """A filter for a measurement without noise."""
    return celnav.ukf(MOTION, celnav.Sensor(h, **none), form=form, **options)


def test_noise_through_the_points_needs_a_function():
    for make in (
        lambda: celnav.Sensor(EYE, augment=(EYE,)),
        lambda: celnav.Motion(EYE, augment=(EYE,)),
    ):
        with pytest.raises(
            ValueError,
            match=r"augment: expected a function [fh]\(points, epoch, \*noise\) with it, got a matrix",
        ):
            make()
    for augment in (EYE, (1.0,)):
        for make in (
            lambda e=augment: celnav.Motion(still, augment=e),
            lambda e=augment: celnav.Sensor(seen, augment=e),
        ):
            with pytest.raises(ValueError, match="augment: expected a sequence of matrices"):
                make()


@FORMS
def test_a_prescribed_gain_has_no_part_in_what_is_missing(form):
    """Covariance of a filter with the gain K for the measured row alone: (I - K H) P (I - K H)' + K
    R K', in any unit of z.
    """
    K, P, R = np.array([[0.4, 10.0], [0.1, 5.0]]), 0.01 * EYE, 1e-4 * EYE
    for h in (EYE, lambda x, e: x):
        filter = celnav.ukf(MOTION, celnav.Sensor(h, R), gain=K, form=form)
        belief, info = updated(filter, celnav.Gaussian(np.zeros(2), P), [0.1, np.nan])
        own = K * [1.0, 0.0]
        expected = (EYE - own) @ P @ (EYE - own).T + own @ R @ own.T
        np.testing.assert_allclose(belief.cov, expected, atol=1e-15)
        np.testing.assert_array_equal(info.gain(), own)


@FORMS
def test_a_silent_sensor_leaves_a_blank_of_its_own(form):
    """The track of two sensors: the values of one sensor are stored also if the other has no
    measurement, or none so far.
    """
    filter = celnav.ukf(MOTION, celnav.Sensor([[1.0, 0.0]], [[1.0]]), SENSOR, form=form)
    z = [(None, np.ones(2)), (np.ones(1), None), None, (np.ones(1), np.ones(2))]
    when = [celnav.Epoch(k, float(k), float(k > 0), z=value) for k, value in enumerate(z)]
    track = celnav.run(filter, PRIOR, when)
    np.testing.assert_array_equal(track.used, [[0, 1, 1], [1, 0, 0], [0, 0, 0], [1, 1, 1]])
    np.testing.assert_array_equal(np.isnan(track.innovation), ~track.used)
    np.testing.assert_array_equal(track.dof, [2, 1, 0, 3])
    _, _, infos = list(celnav.steps(filter, PRIOR, when))[2]
    assert len(infos) == 2


@FORMS
@pytest.mark.parametrize(
    "h", [np.array([[0.6, 1.0]]), lambda x, e: x @ [[0.6], [1.0]]], ids=["matrix", "function"]
)
def test_a_measurement_without_noise_of_what_is_known_is_told(form, h):
    """The first measurement is exact. The second would divide round-off by round-off."""
    filter, epoch = exact(h, form, {"sqrt_R": np.zeros((1, 0))}), celnav.Epoch(z=[1.0])
    known, _ = filter.update(filter.start(celnav.Gaussian(np.zeros(2), CORRELATED)), epoch)
    np.testing.assert_allclose([0.6, 1.0] @ known.belief.mean, 1.0, rtol=1e-12)
    again, _ = filter.update(known, epoch)
    assert np.isnan(again.belief.mean).all()
    why = explain(filter, known, again, epoch)
    assert why.startswith(
        "the innovation covariance is not positive definite; a measurement without noise must "
        "not repeat what"
    )
    assert why.endswith("leave out all but one (z is nan), or give them a small R")
    with pytest.raises(celnav.FilterError, match="innovation covariance is not positive definite"):
        celnav.run(filter, known.belief, [0.0], [[1.0]])


@FORMS
def test_redundant_perfect_sensors_are_told_with_what_to_do(form):
    """Two equal sensors; leaving one out loses nothing. With noise the message does not mention
    missing noise.
    """
    twice = exact(lambda x, e: x[..., [0, 0]], form, {"R": np.zeros((2, 2))})
    with pytest.raises(
        celnav.FilterError, match=r"leave out all but one \(z is nan\), or give them a small R \("
    ):
        celnav.run(twice, PRIOR, [0.0], [[1.0, 1.0]])
    np.testing.assert_allclose(updated(twice, PRIOR, [1.0, np.nan])[0].mean, [1.0, 0.0], atol=1e-15)
    for R in (0.0025 * np.eye(6), lambda mean, epoch: 0.0025 * np.eye(6)):
        bent = celnav.Sensor(lambda x, e: np.cos(3.0 * x[..., :6]), R)
        filter = celnav.ckf(
            celnav.Motion(np.eye(13), np.zeros((13, 13))), bent, degree=5, form=form
        )
        with pytest.raises(
            celnav.FilterError, match=r"the innovation covariance is not positive definite \("
        ):
            celnav.run(
                filter, celnav.Gaussian(np.zeros(13), 9.0 * np.eye(13)), [0.0], np.ones((1, 6))
            )


def test_a_run_lost_in_covariance_form_is_nan_in_its_epoch_and_the_model_is_not_blamed():
    bent = celnav.Motion(lambda x, e: 50.0 * x * x + 0.1 * x, [[1e-3]])
    filter = celnav.ukf(bent, celnav.Sensor([[1.0]], [[1.0]]), kappa=-0.9, form="covariance")
    prior = celnav.Gaussian([[0.0], [0.0]], [[[1e-6]], [[1.0]]])
    track = celnav.run(
        filter, prior, np.arange(2.0), np.full((2, 2, 1), np.nan), on_failure="flag", keep="cov"
    )
    np.testing.assert_array_equal(track.failed_at, [-1, 1])
    np.testing.assert_array_equal(np.isnan(track.mean[1, :, 0]), [False, True])
    np.testing.assert_array_equal(np.isnan(track.cov[1, :, 0, 0]), [False, True])
    filter, epoch = celnav.ukf(MOTION, form="covariance"), celnav.Epoch(1, 1.0, 1.0)
    before = filter.start(Covariance(np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]])))
    why = explain(filter, before, filter.predict(before, epoch), epoch)
    assert (
        why
        == "the covariance lost positive definiteness in the step before; the square-root form has twice the digits"
    )


def test_a_variance_that_was_zero_has_a_deviation():
    """A variance that round-off made negative without a failure gives no nan in the standard
    deviations either.
    """
    known = Covariance(
        np.zeros((2, 2)), np.array([[[1.0, 0.0], [0.0, -1e-17]], [[1.0, 0.0], [0.0, -1e-3]]])
    )
    np.testing.assert_array_equal(known.std, [[1.0, 0.0], [1.0, np.nan]])


@FORMS
def test_an_exact_measurement_is_taken_where_it_says_something(form):
    """Large numbers with small variance, missing or gated components, noise in some components
    only, a prescribed gain.
    """
    far, h, none = np.array([7e6, 7e6]), lambda x, e: x.copy(), {"sqrt_R": np.zeros((2, 0))}
    for std in (1.0, 1e-3):
        one, two = (
            celnav.Gaussian(far, std**2 * EYE),
            celnav.Gaussian(np.tile(far, (2, 1)), std**2 * EYE),
        )
        after, _ = updated(exact(h, form, none), one, far + 0.5 * std)
        np.testing.assert_allclose(after.mean, far + 0.5 * std, rtol=1e-15)
        seen = far + 0.5 * std
        after, _ = updated(exact(h, form, none), two, [seen, [seen[0], np.nan]])
        np.testing.assert_allclose(after.mean, [seen, [seen[0], far[1]]], rtol=1e-15)
        after, _ = updated(
            exact(h, form, none, hooks=[gate(3.0)]), one, far + np.array([0.5, 9.0]) * std
        )
        np.testing.assert_allclose(after.mean, [seen[0], far[1]], rtol=1e-15)
    wide, _ = updated(
        exact(EYE, form, none), celnav.Gaussian(np.zeros(2), 4.9e13 * EYE), [1.0, np.nan]
    )
    np.testing.assert_allclose(wide.mean, [1.0, 0.0], atol=1e-9)
    own, _ = updated(
        exact(EYE, form, none, gain=0.5 * EYE), celnav.Gaussian(np.zeros(2), 0.0 * EYE), np.ones(2)
    )
    np.testing.assert_allclose(own.mean, 0.5)
    half, _ = updated(exact(EYE, form, {"R": np.diag([0.0, 1.0])}), PRIOR, np.ones(2))
    np.testing.assert_allclose(half.mean, [1.0, 0.5])


@FORMS
@pytest.mark.parametrize("make", [celnav.ekf, celnav.ukf])
@pytest.mark.parametrize("r", [1e-2, 1e-5, 1e-8])
def test_a_combination_known_exactly_stays_known_however_precise_the_sensor(r, make, form):
    """A prior of rank one has a single unknown number, whose variance falls by r in the first step,
    and as 1 / k from then on.
    """
    a, h = np.array([1.0, 3.0]), np.array([[1.0, 0.5]])
    z = 0.7 + np.sqrt(r) * np.random.default_rng(0).normal(size=(200, 4, 1))
    filter = make(celnav.Motion(np.eye(2), np.zeros((2, 2))), celnav.Sensor(h, [[r]]), form=form)
    track = celnav.run(
        filter, celnav.Gaussian(np.zeros((4, 2)), np.outer(a, a)), np.arange(200.0), z, keep="cov"
    )
    celnav.Gaussian(track.mean[-1], track.cov[-1])  # its belief is a valid prior
    k, sees = np.arange(1.0, 201.0)[:, None], float((h @ a)[0])
    variance = 1.0 / (1.0 + k * sees**2 / r)
    expected = variance * sees / r * z.cumsum(0)[..., 0]
    np.testing.assert_allclose(track.mean, expected[..., None] * a, rtol=1e-6)
    np.testing.assert_allclose(
        track.std[..., 1], np.broadcast_to(3.0 * np.sqrt(variance), (200, 4)), rtol=1e-2
    )


@FORMS
@pytest.mark.parametrize(
    "none", [{"sqrt_R": np.zeros((1, 0))}, {"R": np.zeros((1, 1))}], ids=["no columns", "zeros"]
)
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_what_is_known_to_be_zero_is_known_too(form, none, value):
    """Round-off can only be compared with the function's curvature over the belief."""
    for h in (lambda x, e: x @ [[0.6], [1.0]], [[0.6, 1.0]]):
        filter = exact(h, form, none)
        known, _ = filter.update(
            filter.start(celnav.Gaussian(np.zeros(2), CORRELATED)), celnav.Epoch(z=[value])
        )
        side = np.array([0.6, 1.0])
        gain = CORRELATED @ side / (side @ CORRELATED @ side)
        np.testing.assert_allclose(known.belief.mean, gain * value, rtol=1e-12)
        np.testing.assert_allclose(
            known.belief.cov, CORRELATED - np.outer(gain, side @ CORRELATED), atol=1e-12
        )
        again, _ = filter.update(known, celnav.Epoch(z=[1.0]))
        assert np.isnan(again.belief.mean).all()


def test_a_bias_stage_knows_what_a_gate_left_out():
    filter = celnav.two_stage(
        MOTION, SENSOR, EYE, celnav.Gaussian(np.zeros(2), 0.01 * EYE), hooks=[gate(3.0)]
    )
    track = celnav.run(filter, PRIOR, [0.0, 1.0], [[0.0, 0.0], [100.0, np.nan]])
    assert (track.events["rejected"], track.events["missing"]) == (1, 1)
    np.testing.assert_array_equal(np.isnan(track.innovation), [[False, False], [False, True]])


@FORMS
def test_a_lost_spread_is_told_at_its_step(form):
    """The mean is still finite."""
    f = lambda x, e: np.stack([x[..., 0] ** 2 + x[..., 1] ** 2, x[..., 1]], -1)  # noqa: E731
    filter = celnav.ukf(celnav.Motion(f, 1e-6 * EYE), kappa=-1.9, form=form)
    track = celnav.run(filter, PRIOR, [0.0, 1.0], on_failure="flag")
    assert np.isnan(track.std[1, 0])
    assert track.failed_at == 1
    with pytest.raises(
        celnav.FilterError, match=r"step 1, t = 1\.0: the covariance lost positive definiteness"
    ):
        celnav.run(filter, PRIOR, [0.0, 1.0])


def test_an_innovation_stays_on_this_side_of_the_seam():
    """The mean of the predicted angle is 0.4 rad past its center."""
    sensor = celnav.Sensor(lambda x, e: x + 0.4 * x**2, [[0.01]], space=celnav.angles())
    belief, info = updated(
        celnav.ukf(celnav.Motion([[1.0]], [[0.0]]), sensor), celnav.Gaussian([0.0], [[1.0]]), [-3.0]
    )
    np.testing.assert_allclose(info.innovation, 2.0 * np.pi - 3.4, rtol=1e-12)
    assert 2.8 < belief.mean[0] < 2.9


def test_some_runs_cannot_stand_still_while_others_move():
    filter, prior = celnav.ukf(MOTION, SENSOR), celnav.Gaussian(np.zeros((2, 2)), EYE)
    with pytest.raises(
        ValueError, match="dt: expected an interval in every run or in none if Q is constant"
    ):
        celnav.run(filter, prior, [celnav.Epoch(3, 1.0, np.array([0.0, 1.0]), z=np.ones(2))])
    assert (
        celnav.run(
            filter, prior, [celnav.Epoch(3, 1.0, np.array([2.0, 1.0]), z=np.ones(2))]
        ).failed_at.max()
        == -1
    )
    scaled = celnav.ukf(
        celnav.Motion(still, sqrt_Q=lambda mean, epoch: np.sqrt(epoch.dt)[:, None, None] * EYE)
    )
    mixed = celnav.run(scaled, prior, [celnav.Epoch(1, 1.0, np.array([0.0, 3.0]))])
    np.testing.assert_allclose(mixed.std[0], [[1.0, 1.0], [2.0, 2.0]])


COLORED = {"colored": celnav.colored, "decorrelated": celnav.decorrelated}


def whitened(name, hooks=()):
    given = celnav.Motion(still, 0.5 * EYE), SENSOR, 0.5 * EYE
    return COLORED[name](*given, increments=0.1 * EYE, first=False, hooks=hooks)


@pytest.mark.parametrize("name", COLORED)
def test_colored_filters_refuse_intervals_that_they_do_not_mean(name):
    filter, z = whitened(name), np.ones(2)
    with pytest.raises(ValueError, match="dt: expected 0 at the first epoch"):
        celnav.run(filter, PRIOR, [celnav.Epoch(0, 1.0, 1.0, z=z)])
    with pytest.raises(
        ValueError, match=r"dt: expected an interval after the first epoch, got 0\.0"
    ):
        celnav.run(filter, PRIOR, [celnav.Epoch(0, 0.0, 0.0, z=z), celnav.Epoch(1, 0.0, 0.0, z=z)])


@pytest.mark.parametrize("name", COLORED)
@pytest.mark.parametrize(
    ("z", "told"),
    [
        (1.0, r"z: expected shape \(\.\.\., m\), got the number 1\.0"),
        (np.ones(3), "z: expected 2 components to go with h, got 3"),
        (np.ones((3, 2)), r"^z: .*\(4,\).*\(3,\)"),
    ],
    ids=["a number", "too many", "another batch"],
)
def test_colored_filters_name_a_measurement_that_cannot_be(name, z, told):
    when = [celnav.Epoch(0, 0.0, 0.0, z=np.ones(2)), celnav.Epoch(1, 1.0, 1.0, z=z)]
    with pytest.raises(ValueError, match=told):
        celnav.run(whitened(name), celnav.Gaussian(np.zeros((4, 2)), EYE), when)


@pytest.mark.parametrize("make", COLORED.values(), ids=COLORED)
@pytest.mark.parametrize(
    ("R", "Phi", "increments", "told"),
    [
        (np.eye(3), 0.5 * EYE, EYE, r"^R: expected .*2.*got .*3"),
        (EYE, 0.5 * EYE, np.eye(3), r"^increments: expected .*2.*got .*3"),
        (EYE, 0.5 * np.eye(3), EYE, r"^Phi: expected shape \(\.\.\., 2, 2\), got \(3, 3\)"),
        (EYE, lambda e: [0.5], EYE, r"^Phi: expected shape \(\.\.\., 2, 2\), got \(1,\)"),
    ],
    ids=["R", "increments", "Phi", "Phi of the epoch"],
)
def test_colored_filters_name_noises_that_cannot_be(make, R, Phi, increments, told):
    with pytest.raises(ValueError, match=told):
        celnav.run(
            make(MOTION, celnav.Sensor(EYE, R), Phi, increments=increments),
            PRIOR,
            [0.0, 1.0],
            np.ones((2, 2)),
        )


def test_a_function_of_colored_noise_may_begin_with_nothing():
    """A first epoch without a measurement has as many components as R."""
    filter = celnav.colored(
        MOTION, celnav.Sensor(lambda x, e: x.copy(), EYE), 0.5 * EYE, increments=EYE, first=False
    )
    when = [
        celnav.Epoch(0, 0.0, 0.0),
        celnav.Epoch(1, 1.0, 1.0, z=np.ones(2)),
        celnav.Epoch(2, 2.0, 1.0, z=np.ones(2)),
    ]
    np.testing.assert_array_equal(celnav.run(filter, PRIOR, when).dof, [0, 0, 2])


def test_decorrelation_takes_gates_and_refuses_what_changes_noise():
    """An outlier of 100: a hook that inflates the noise would not keep it out of the prediction; a
    gate does, as in `colored`.
    """
    z = np.zeros((6, 2))
    z[3] = 100.0
    for hook in (huber(), student_t(), innovation_window(1)):
        with pytest.raises(
            ValueError, match="hooks: expected hooks that only leave measurements out"
        ):
            celnav.run(whitened("decorrelated", [hook]), PRIOR, np.arange(6.0), z)
    one, other = (
        celnav.run(whitened(name, [gate(6.0)]), PRIOR, np.arange(6.0), z, keep="cov")
        for name in COLORED
    )
    np.testing.assert_array_equal(one.used, other.used)
    assert not one.used[3].any()
    np.testing.assert_allclose(other.mean[-1], one.mean[-1], atol=1e-12)
    np.testing.assert_allclose(other.cov[-1], one.cov[-1], atol=1e-12)


HOOKS = {
    "none": None,
    "huber": huber(),
    "student": student_t(),
    "sage-husa": sage_husa(),
    "gate": gate(3.0),
    "window": innovation_window(2),
    "group": group_parity([range(6)], 2),
    "channel": channel_parity(2),
}


@FORMS
@pytest.mark.parametrize("f", [still, EYE], ids=["function", "matrix"])
@pytest.mark.parametrize("hook", HOOKS)
def test_one_belief_serves_all_measurements(hook, f, form):
    """With one prior and measurements of many runs, each run has this prior; the same holds for a
    shared covariance.
    """
    z = np.random.default_rng(0).normal(size=(4, 3, 6))
    z[2, 1, 0] = 30.0
    z[1, 0, 2] = np.nan
    hooks = [] if HOOKS[hook] is None else [HOOKS[hook]]
    filter = celnav.ukf(celnav.Motion(f, EYE), celnav.Sensor(H, np.eye(6)), hooks=hooks, form=form)
    own = celnav.Gaussian(np.zeros((3, 2)), np.broadcast_to(EYE, (3, 2, 2)))
    expected, *found = (
        celnav.run(filter, prior, np.arange(4.0), z, keep="cov") for prior in (own, MANY, PRIOR)
    )
    for track in found:
        np.testing.assert_allclose(track.mean, expected.mean, atol=1e-13)
        np.testing.assert_allclose(track.cov, expected.cov, atol=1e-13)
        np.testing.assert_array_equal(track.used, expected.used)
        np.testing.assert_allclose(track.log_likelihood, expected.log_likelihood, rtol=1e-12)


@FORMS
@pytest.mark.parametrize("rule", [celnav.unscented, celnav.Taylor()], ids=["points", "taylor"])
@pytest.mark.parametrize("hook", HOOKS)
def test_neighbors_of_a_lost_run_go_on_under_every_hook(hook, rule, form):
    z = np.random.default_rng(0).normal(size=(6, 3, 6))

    def f(x, epoch):
        return x * np.where(epoch.k == 2, [[1.0], [np.nan], [1.0]], 1.0) if x.shape[-2] == 3 else x

    hooks = [] if HOOKS[hook] is None else [HOOKS[hook]]
    filter = celnav.sigma_point(
        celnav.Motion(f, EYE), celnav.Sensor(seen, np.eye(6)), rule=rule, hooks=hooks, form=form
    )
    together, apart = (
        celnav.run(
            filter,
            celnav.Gaussian(np.zeros((len(runs), 2)), EYE),
            np.arange(6.0),
            z[:, runs],
            on_failure="flag",
        )
        for runs in ([0, 1, 2], [0, 2])
    )
    np.testing.assert_array_equal(together.failed_at, [-1, 2, -1])
    np.testing.assert_allclose(together.mean[:, [0, 2]], apart.mean, atol=1e-12)
    np.testing.assert_allclose(together.std[:, [0, 2]], apart.std, atol=1e-12)


def test_one_belief_serves_other_filters_too():
    z = np.random.default_rng(1).normal(size=(3, 2))
    iterated = celnav.ekf(MOTION, celnav.Sensor(lambda x, e: x.copy(), EYE), iterations=6)
    np.testing.assert_allclose(
        updated(iterated, PRIOR, z)[0].mean, updated(iterated, MANY, z)[0].mean, atol=1e-12
    )
    fixes = least_squares(
        celnav.Sensor(still, EYE, jacobian=lambda x, e: np.broadcast_to(EYE, (*x.shape, 2)))
    )
    np.testing.assert_allclose(celnav.run(fixes, PRIOR, [0.0], z[None]).mean[0], z, atol=1e-12)
    track = celnav.run(celnav.ukf(MOTION, SENSOR, SENSOR), PRIOR, [0.0], (np.ones((1, 2)), z[None]))
    assert track.innovation.shape == (1, 3, 4)


@FORMS
@pytest.mark.parametrize("f", [still, EYE], ids=["function", "matrix"])
def test_noise_of_each_run_with_one_belief(form, f):
    each = np.array([1.0, 4.0])[:, None, None] * EYE
    moving, seeing = (
        celnav.ukf(celnav.Motion(f, each), form=form),
        celnav.ukf(MOTION, celnav.Sensor(EYE, each), form=form),
    )
    after = moving.predict(moving.start(PRIOR), celnav.Epoch(1, 1.0, 1.0)).belief
    np.testing.assert_allclose(after.std, np.sqrt([[2.0, 2.0], [5.0, 5.0]]))
    after, _ = updated(seeing, PRIOR, np.ones(2))
    np.testing.assert_allclose(after.mean, [[0.5, 0.5], [0.2, 0.2]])


@FORMS
@pytest.mark.parametrize("f", [still, EYE], ids=["function", "matrix"])
def test_a_track_of_noise_of_each_run_with_one_belief(form, f):
    filter = celnav.ukf(celnav.Motion(f, np.array([1.0, 4.0])[:, None, None] * EYE), form=form)
    track = celnav.run(filter, PRIOR, [0.0, 1.0], keep="cov")
    np.testing.assert_allclose(
        track.std, np.sqrt([[[1.0, 1.0], [1.0, 1.0]], [[2.0, 2.0], [5.0, 5.0]]])
    )
    assert track.mean.shape == (2, 2, 2)


@pytest.mark.parametrize("f", [still, EYE], ids=["function", "matrix"])
def test_noise_of_other_runs_than_the_beliefs_is_told(f):
    filter = celnav.ukf(celnav.Motion(f, np.array([1.0, 4.0])[:, None, None] * EYE))
    with pytest.raises(ValueError, match=r"^Q: .*\(3,\).*\(2,\)"):
        filter.predict(filter.start(MANY), celnav.Epoch(1, 1.0, 1.0))


@FORMS
def test_a_jacobian_covers_the_noises_that_go_through_the_points(form):
    """The noise columns follow the state columns; numerical differences give the same."""
    J = np.array([[1.0, 0.5, 2.0, 0.0], [0.0, 1.0, 0.3, 1.0]])
    for known in ({}, {"jacobian": lambda mean, epoch: J}):
        g = lambda x, e, w: x @ J[:, :2].T + w @ J[:, 2:].T  # noqa: E731
        motion, sensor = (
            celnav.Motion(g, augment=(EYE,), **known),
            celnav.Sensor(g, augment=(EYE,), **known),
        )
        filter, expected = celnav.ekf(motion, sensor, form=form), J @ J.T
        after = filter.predict(filter.start(PRIOR), celnav.Epoch(1, 1.0, 1.0)).belief
        np.testing.assert_allclose(after.cov, expected, atol=1e-9)
        _, info = updated(filter, PRIOR, np.ones(2))
        np.testing.assert_allclose(info.sqrt_S @ info.sqrt_S.T, expected, atol=1e-9)
        np.testing.assert_allclose(info.jacobian(), J[:, :2], atol=1e-9)


def test_nothing_measured_is_nothing_done():
    """None has the same effect as nan, for a two-stage filter and for fixes."""
    filter = celnav.two_stage(MOTION, SENSOR, EYE, PRIOR)
    absent, nan = (
        celnav.run(filter, PRIOR, [celnav.Epoch(0, 0.0, 0.0, z=z)])
        for z in (None, np.full(2, np.nan))
    )
    np.testing.assert_array_equal(absent.std, nan.std)
    fixes = least_squares(celnav.Sensor(still, EYE, jacobian=lambda x, e: EYE))
    when = [celnav.Epoch(0, 0.0, 0.0, z=None), celnav.Epoch(1, 1.0, 1.0, z=np.ones(2))]
    track = celnav.run(fixes, PRIOR, when, on_failure="flag")
    assert np.isnan(track.mean[0]).all()
    np.testing.assert_allclose(track.mean[1], 1.0)


def test_the_augmented_filter_is_exact_and_tells_of_a_repeated_instant():
    filter, z = celnav.augmented(MOTION, SENSOR, 0.5 * EYE, increments=EYE), np.ones((2, 2))
    assert np.isfinite(celnav.run(filter, PRIOR, [0.0, 1.0], z).std).all()
    with pytest.raises(celnav.FilterError, match="innovation covariance is not positive definite"):
        celnav.run(filter, PRIOR, [0.0, 0.0], z)


@pytest.mark.parametrize("value", [np.nan, np.inf, [1], "2", True, 0, 1.5])
def test_numbers_that_must_be_whole(value):
    for make in (
        huber,
        lambda rounds: innovation_window(rounds),
        lambda rounds: celnav.unscented(rounds),
    ):
        with pytest.raises(
            ValueError, match=r"expected (a positive integer|an integer from 1 to 10000), got"
        ):
            make(rounds=value)
    with pytest.raises(ValueError, match="every: expected a positive integer, got"):
        celnav.run(celnav.ukf(MOTION), PRIOR, [0.0], every=value)


@pytest.mark.parametrize(
    "rule", [celnav.unscented(3, 0.1, 2.0), celnav.unscented(3, kappa=-1.5)], ids=["alpha", "kappa"]
)
@pytest.mark.parametrize("known", ["component", "combination", "measurement"])
def test_rules_of_negative_weight_take_what_is_known_exactly_in_both_forms(rule, known):
    """The downdate of a singular root; both forms give the same numbers."""
    F = np.array([[1.0, 0.1, 0.0], [-0.1, 0.9, 0.2], [0.0, 0.0, 0.95]])
    P, Q, R = {
        "component": (np.diag([1.0, 2.0, 0.0]), np.zeros((3, 3)), [[1.0]]),
        "combination": (
            np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]) + np.diag([1.0, 0.0, 0.0]),
            np.zeros((3, 3)),
            [[1.0]],
        ),
        "measurement": (np.eye(3), 0.1 * np.eye(3), [[0.0]]),
    }[known]
    motion, sensor = (
        celnav.Motion(lambda x, e: x @ F.T, Q),
        celnav.Sensor(lambda x, e: x[..., :1] + x[..., 2:], R),
    )
    z = np.random.default_rng(1).normal(size=(20, 1))
    root, cov = (
        celnav.run(
            celnav.sigma_point(motion, sensor, rule=rule, form=form),
            celnav.Gaussian(np.ones(3), P),
            np.arange(20.0),
            z,
        )
        for form in ("square root", "covariance")
    )
    np.testing.assert_allclose(root.mean, cov.mean, atol=1e-7)
    np.testing.assert_allclose(root.std, cov.std, atol=1e-6)
