"""Where parts meet at their edges: no noise, missing parts, runs on one side only, angles at the seam, intervals that are none."""

import numpy as np
import pytest

import celnav
from celnav.filters.adaptive import gate, innovation_window
from celnav.filters.colored import augmented, colored
from celnav.filters.decorrelated import decorrelated
from celnav.filters.iterated import iterated
from celnav.filters.least_squares import least_squares
from celnav.filters.parity import channel_parity, group_parity
from celnav.filters.robust import huber, sage_husa, student_t
from celnav.filters.two_stage import plain, two_stage
from celnav.gaussian.belief import covariance, square_root

RULE = celnav.unscented(2)
EYE = np.eye(2)
FORMS = pytest.mark.parametrize("form", [square_root, covariance], ids=["root", "cov"])
H = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0], [0.5, 2.0], [2.0, 0.5]])


def still(x, epoch):
    return x


def seen(x, epoch):
    return x @ H.T


def test_noise_through_the_points_needs_a_function():
    with pytest.raises(ValueError, match=r"extra: expected a function h\(points, epoch, \*noise\) with it, got a matrix"):
        celnav.update(EYE, celnav.unscented(4), extra=(EYE,))
    for extra in (EYE, (1.0,)):
        for make in (lambda e=extra: celnav.predict(still, RULE, extra=e), lambda e=extra: celnav.update(seen, RULE, extra=e)):
            with pytest.raises(ValueError, match="extra: expected a sequence of matrices"):
                make()


@FORMS
def test_a_prescribed_gain_has_no_part_in_what_is_missing(form):
    """Covariance of a filter with the gain K on the measured row alone: (I - K H) P (I - K H)' + K R K', in any unit of z."""
    K, P, R = np.array([[0.4, 10.0], [0.1, 5.0]]), 0.01 * EYE, 1e-4 * EYE
    for h in (EYE, lambda x, e: x):
        belief, info, _ = celnav.update(h, RULE, R, gain=K)(form(np.zeros(2), P), [0.1, np.nan])
        own = K * [1.0, 0.0]
        expected = (EYE - own) @ P @ (EYE - own).T + own @ R @ own.T
        np.testing.assert_allclose(belief.cov, expected, atol=1e-15)
        np.testing.assert_array_equal(info.gain(), own)


@FORMS
def test_a_silent_sensor_leaves_a_blank_of_its_own(form):
    """The record of two sensors: what one of them measured is there when the other has nothing, or nothing yet."""
    filter = celnav.sequential(
        celnav.predict(still, RULE, EYE), celnav.update([[1.0, 0.0]], RULE, [[1.0]]), celnav.update(EYE, RULE, EYE)
    )
    z = [(None, np.ones(2)), (np.ones(1), None), None, (np.ones(1), np.ones(2))]
    when = [celnav.Epoch(k, float(k), float(k > 0), z=value) for k, value in enumerate(z)]
    track = celnav.run(filter, form(np.zeros(2), EYE), when)
    np.testing.assert_array_equal(track.used, [[0, 1, 1], [1, 0, 0], [0, 0, 0], [1, 1, 1]])
    np.testing.assert_array_equal(np.isnan(track.innovation), ~track.used)
    np.testing.assert_array_equal(track.dof, [2, 1, 0, 3])
    _, _, info = list(celnav.steps(filter, form(np.zeros(2), EYE), when))[2]
    assert len(info) == 2


@FORMS
@pytest.mark.parametrize("h", [np.array([[0.6, 1.0]]), lambda x, e: x @ [[0.6], [1.0]]], ids=["matrix", "function"])
def test_a_measurement_without_noise_of_what_is_known_is_told(form, h):
    """Once it is exact. The second one divides what is round-off by what is round-off."""
    exact = celnav.update(h, RULE, sqrt_R=np.zeros((1, 0)))
    known, _, _ = exact(form(np.zeros(2), [[1.0, 0.3], [0.3, 2.0]]), [1.0])
    np.testing.assert_allclose([0.6, 1.0] @ known.mean, 1.0, rtol=1e-12)
    again, info, _ = exact(known, [1.0])
    assert np.isnan(again.mean).all()
    assert info.failure.startswith("the innovation covariance is not positive definite; a measurement without noise must say what")
    assert info.failure.endswith("leave out all but one (z is nan) or give them a small R")
    filter = celnav.sequential(celnav.predict(still, RULE, EYE), exact)
    with pytest.raises(celnav.FilterError, match="innovation covariance is not positive definite"):
        celnav.run(filter, known, celnav.epochs([0.0], [[1.0]]))


@FORMS
def test_redundant_perfect_sensors_are_told_with_what_to_do(form):
    """Two of the same; one that is left out costs nothing. Where there is noise the message does not speak of its absence."""
    twice = celnav.update(lambda x, e: x[..., [0, 0]], RULE, np.zeros((2, 2)))
    _, info, _ = twice(form(np.zeros(2), EYE), [1.0, 1.0])
    assert info.failure.endswith("leave out all but one (z is nan) or give them a small R")
    np.testing.assert_allclose(twice(form(np.zeros(2), EYE), [1.0, np.nan])[0].mean, [1.0, 0.0], atol=1e-15)
    bent = celnav.update(lambda x, e: np.cos(3.0 * x[..., :6]), celnav.cubature(13, 5), lambda mean, epoch: 0.0025 * np.eye(6))
    _, info, _ = bent(form(np.zeros(13), 9.0 * np.eye(13)), np.ones(6))
    assert info.failure == "the innovation covariance is not positive definite"


def test_a_run_lost_in_covariance_form_is_nan_in_its_epoch_and_the_model_is_not_blamed():
    rule = celnav.unscented(1, 1.0, 0.0, -0.9)
    filter = celnav.sequential(
        celnav.predict(lambda x, e: 50.0 * x * x + 0.1 * x, rule, [[1e-3]]), celnav.update([[1.0]], rule, [[1.0]])
    )
    prior = covariance([[0.0], [0.0]], [[[1e-6]], [[1.0]]])
    track = celnav.run(filter, prior, celnav.epochs(np.arange(2.0), np.full((2, 2, 1), np.nan)), on_failure="flag", keep="spread")
    np.testing.assert_array_equal(track.failed_at, [-1, 1])
    np.testing.assert_array_equal(np.isnan(track.mean[1, :, 0]), [False, True])
    np.testing.assert_array_equal(np.isnan(track.cov[1, :, 0, 0]), [False, True])
    indefinite = celnav.Gaussian(np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]]), prior.form)
    _, info = celnav.predict(still, RULE, EYE)(indefinite, celnav.Epoch())
    assert info.failure.startswith("the covariance lost positive definiteness in the step before; a prior of celnav.square_root")


def test_a_variance_that_was_zero_has_a_deviation():
    """Round-off below 0 that does not count as a failure is no nan among the deviations either."""
    known = celnav.Gaussian(
        np.zeros((2, 2)), np.array([[[1.0, 0.0], [0.0, -1e-17]], [[1.0, 0.0], [0.0, -1e-3]]]), covariance(0 * EYE[0], EYE).form
    )
    np.testing.assert_array_equal(known.std, [[1.0, 0.0], [1.0, np.nan]])


@FORMS
def test_an_exact_measurement_is_taken_where_it_says_something(form):
    """Large numbers known well, components that are missing or gated, noise of some components only, a gain of one's own."""
    far, h = np.array([7e6, 7e6]), lambda x, e: x.copy()
    for std in (1.0, 1e-3):
        exact = celnav.update(h, RULE, sqrt_R=np.zeros((2, 0)))
        after, _, _ = exact(form(far, std**2 * EYE), far + 0.5 * std)
        np.testing.assert_allclose(after.mean, far + 0.5 * std, rtol=1e-15)
        after, _, _ = exact(form(np.tile(far, (2, 1)), std**2 * EYE), [far, [far[0], np.nan]])
        assert np.isfinite(after.mean).all()
        gated = celnav.update(h, RULE, sqrt_R=np.zeros((2, 0)), hooks=[gate(3.0)])
        assert np.isfinite(gated(form(far, std**2 * EYE), far + np.array([0.5, 9.0]) * std)[0].mean).all()
    wide = celnav.update(EYE, RULE, sqrt_R=np.zeros((2, 0)))
    np.testing.assert_allclose(wide(form(np.zeros(2), 4.9e13 * EYE), [1.0, np.nan])[0].mean, [1.0, 0.0], atol=1e-9)
    own = celnav.update(EYE, RULE, sqrt_R=np.zeros((2, 0)), gain=0.5 * EYE)
    np.testing.assert_allclose(own(form(np.zeros(2), 0.0 * EYE), np.ones(2))[0].mean, 0.5)
    half = celnav.update(EYE, RULE, np.diag([0.0, 1.0]))
    np.testing.assert_allclose(half(form(np.zeros(2), EYE), np.ones(2))[0].mean, [1.0, 0.5])


@FORMS
@pytest.mark.parametrize("none", [{"sqrt_R": np.zeros((1, 0))}, {"R": np.zeros((1, 1))}], ids=["no columns", "zeros"])
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_what_is_known_to_be_zero_is_known_too(form, none, value):
    """Nothing to compare round-off with but how far the function bends over the belief."""
    for h in (lambda x, e: x @ [[0.6], [1.0]], [[0.6, 1.0]]):
        exact = celnav.update(h, RULE, **none)
        known, _, _ = exact(form(np.zeros(2), [[1.0, 0.3], [0.3, 2.0]]), [value])
        assert np.isfinite(known.mean).all()
        assert np.isnan(exact(known, [1.0])[0].mean).all()


def test_a_bias_stage_knows_what_a_gate_left_out():
    part = plain(celnav.predict(still, RULE, EYE), celnav.update(EYE, RULE, EYE, hooks=[gate(3.0)]))
    filter = two_stage(part, EYE, square_root(np.zeros(2), 0.01 * EYE))
    track = celnav.run(filter, square_root(np.zeros(2), EYE), celnav.epochs([0.0, 1.0], [[0.0, 0.0], [100.0, np.nan]]))
    assert (track.events["rejected"], track.events["missing"]) == (1, 1)
    np.testing.assert_array_equal(np.isnan(track.innovation), [[False, False], [False, True]])


@FORMS
def test_a_lost_spread_is_told_at_its_step(form):
    """The mean is finite still."""
    f = lambda x, e: np.stack([x[..., 0] ** 2 + x[..., 1] ** 2, x[..., 1]], -1)  # noqa: E731
    rule = celnav.unscented(2, 1.0, 0.0, -1.9)
    filter = celnav.sequential(celnav.predict(f, rule, 1e-6 * EYE))
    when = [celnav.Epoch(0, 0.0, 0.0), celnav.Epoch(1, 1.0, 1.0)]
    track = celnav.run(filter, form(np.zeros(2), EYE), when, on_failure="flag")
    assert np.isnan(track.std[1, 0])
    assert track.failed_at == 1
    with pytest.raises(celnav.FilterError, match=r"step 1, t = 1\.0: the covariance lost positive definiteness"):
        celnav.run(filter, form(np.zeros(2), EYE), when)


def test_an_innovation_stays_on_this_side_of_the_seam():
    """The mean of the prediction lies .4 beyond its center; both an angle."""
    part = celnav.update(lambda x, e: x + 0.4 * x**2, celnav.unscented(1), [[0.01]], measurement_space=celnav.angles())
    belief, info, _ = part(square_root([0.0], [[1.0]]), [-3.0])
    np.testing.assert_allclose(info.innovation, 2.0 * np.pi - 3.4, rtol=1e-12)
    assert 2.8 < belief.mean[0] < 2.9


def test_some_runs_cannot_stand_still_while_others_move():
    filter = celnav.sequential(celnav.predict(still, RULE, EYE), celnav.update(EYE, RULE, EYE))
    prior = square_root(np.zeros((2, 2)), EYE)
    with pytest.raises(ValueError, match="dt: expected an interval for every run or for none where Q is constant"):
        celnav.run(filter, prior, [celnav.Epoch(3, 1.0, np.array([0.0, 1.0]), z=np.ones(2))])
    assert celnav.run(filter, prior, [celnav.Epoch(3, 1.0, np.array([2.0, 1.0]), z=np.ones(2))]).failed_at.max() == -1
    scaled = celnav.predict(still, RULE, sqrt_Q=lambda mean, epoch: np.sqrt(epoch.dt)[:, None, None] * EYE)
    mixed = celnav.run(celnav.sequential(scaled), prior, [celnav.Epoch(1, 1.0, np.array([0.0, 3.0]))])
    np.testing.assert_allclose(mixed.std[0], [[1.0, 1.0], [2.0, 2.0]])


COLORED = {
    "colored": lambda hooks=(): colored(still, EYE, RULE, 0.5 * EYE, Q=0.5 * EYE, R=0.1 * EYE, hooks=hooks),
    "decorrelated": lambda hooks=(): decorrelated(still, EYE, RULE, 0.5 * EYE, Q=0.5 * EYE, R=0.1 * EYE, hooks=hooks),
}


@pytest.mark.parametrize("name", COLORED)
def test_colored_filters_refuse_intervals_that_they_do_not_mean(name):
    filter, z = COLORED[name](), np.ones(2)
    with pytest.raises(ValueError, match="dt: expected 0 at the first epoch"):
        celnav.run(filter, square_root(np.zeros(2), EYE), [celnav.Epoch(0, 1.0, 1.0, z=z)])
    with pytest.raises(ValueError, match=r"dt: expected an interval after the first epoch, got 0\.0"):
        celnav.run(filter, square_root(np.zeros(2), EYE), [celnav.Epoch(0, 0.0, 0.0, z=z), celnav.Epoch(1, 0.0, 0.0, z=z)])


@pytest.mark.parametrize("name", COLORED)
@pytest.mark.parametrize(
    ("z", "told"),
    [
        (1.0, r"z: expected shape \(\.\.\., m\), got the number 1\.0"),
        (np.ones(3), "z: expected 2 components to go with h, got 3"),
        (np.ones((3, 2)), r"z: batch axes \(3,\) do not go with those of the belief, \(4,\)"),
    ],
    ids=["a number", "too many", "another batch"],
)
def test_colored_filters_name_a_measurement_that_cannot_be(name, z, told):
    prior = square_root(np.zeros((4, 2)), EYE)
    when = [celnav.Epoch(0, 0.0, 0.0, z=np.ones(2)), celnav.Epoch(1, 1.0, 1.0, z=z)]
    with pytest.raises(ValueError, match=told):
        celnav.run(COLORED[name](), prior, when)


def test_colored_filters_name_noises_that_cannot_be():
    for filter in (colored, decorrelated):
        with pytest.raises(ValueError, match="R: expected 2 rows to go with h, got 3"):
            filter(still, EYE, RULE, 0.5 * EYE, Q=EYE, R=np.eye(3))
    with pytest.raises(ValueError, match=r"Phi: expected shape \(\.\.\., 2, 2\), got \(3, 3\)"):
        colored(still, seen, celnav.unscented(4), 0.5 * np.eye(3), sqrt_Q=EYE, R=EYE)
    filter = colored(still, EYE, RULE, lambda e: 0.5, Q=EYE, R=EYE)
    with pytest.raises(ValueError, match=r"Phi: expected shape \(\.\.\., 2, 2\), got \(\)"):
        celnav.run(filter, square_root(np.zeros(2), EYE), celnav.epochs([0.0, 1.0], np.ones((2, 2))))
    with pytest.raises(ValueError, match="first_rule: expected a rule"):
        colored(still, seen, celnav.unscented(4), 0.5 * EYE, sqrt_Q=EYE, R=EYE, Sigma0=EYE, first_rule=celnav.unscented)


def test_a_function_of_colored_noise_may_begin_with_nothing():
    """A first epoch without a measurement: as many components as R has."""
    filter = colored(still, lambda x, e: x.copy(), celnav.unscented(4), 0.5 * EYE, sqrt_Q=EYE, R=EYE)
    when = [celnav.Epoch(0, 0.0, 0.0), celnav.Epoch(1, 1.0, 1.0, z=np.ones(2)), celnav.Epoch(2, 2.0, 1.0, z=np.ones(2))]
    track = celnav.run(filter, square_root(np.zeros(2), EYE), when)
    np.testing.assert_array_equal(track.dof, [0, 0, 2])


def test_decorrelation_takes_gates_and_refuses_what_changes_noise():
    """An outlier of 100: a hook that inflates would not keep it out of the prediction; a gate does, as in `colored`."""
    z = np.zeros((6, 2))
    z[3] = 100.0
    prior, when = square_root(np.zeros(2), EYE), celnav.epochs(np.arange(6.0), z)
    for hook in (huber(), student_t(), innovation_window(1)):
        with pytest.raises(ValueError, match="hooks: expected hooks that only leave measurements out"):
            celnav.run(COLORED["decorrelated"]([hook]), prior, when)
    one, other = (celnav.run(COLORED[name]([gate(6.0)]), prior, when, keep="spread") for name in COLORED)
    np.testing.assert_array_equal(one.used, other.used)
    assert not one.used[3].any()
    np.testing.assert_allclose(other.mean[-1], one.mean[-1], atol=1e-12)
    np.testing.assert_allclose(other.cov[-1], one.cov[-1], atol=1e-12)


HOOKS = {
    "huber": huber(),
    "student": student_t(),
    "sage-husa": sage_husa(),
    "gate": gate(3.0),
    "window": innovation_window(2),
    "group": group_parity([range(6)], 2),
    "channel": channel_parity(2),
}


@FORMS
@pytest.mark.parametrize("hook", HOOKS)
def test_one_belief_serves_all_measurements(hook, form):
    """A prior of one run with measurements of many is the prior of each."""
    z = np.random.default_rng(0).normal(size=(4, 3, 6))
    z[2, 1, 0] = 30.0
    filter = celnav.sequential(celnav.predict(still, RULE, EYE), celnav.update(H, RULE, np.eye(6), hooks=[HOOKS[hook]]))
    when = celnav.epochs(np.arange(4.0), z)
    one, many = form(np.zeros(2), EYE), form(np.zeros((3, 2)), EYE)
    found, expected = (celnav.run(filter, prior, when, keep="spread") for prior in (one, many))
    np.testing.assert_allclose(found.mean, expected.mean, atol=1e-13)
    np.testing.assert_allclose(found.cov, expected.cov, atol=1e-13)
    np.testing.assert_array_equal(found.used, expected.used)


@FORMS
@pytest.mark.parametrize("rule", [RULE, celnav.Taylor()], ids=["points", "taylor"])
@pytest.mark.parametrize("hook", HOOKS)
def test_neighbors_of_a_lost_run_go_on_under_every_hook(hook, rule, form):
    z = np.random.default_rng(0).normal(size=(6, 3, 6))

    def f(x, epoch):
        return x * np.where(epoch.k == 2, [[1.0], [np.nan], [1.0]], 1.0) if x.shape[-2] == 3 else x

    filter = celnav.sequential(celnav.predict(f, rule, EYE), celnav.update(seen, rule, np.eye(6), hooks=[HOOKS[hook]]))
    together, apart = (
        celnav.run(filter, form(np.zeros((len(runs), 2)), EYE), celnav.epochs(np.arange(6.0), z[:, runs]), on_failure="flag")
        for runs in ([0, 1, 2], [0, 2])
    )
    np.testing.assert_array_equal(together.failed_at, [-1, 2, -1])
    np.testing.assert_allclose(together.mean[:, [0, 2]], apart.mean, atol=1e-12)
    np.testing.assert_allclose(together.std[:, [0, 2]], apart.std, atol=1e-12)


def test_one_belief_serves_other_parts_too():
    z = np.random.default_rng(1).normal(size=(3, 2))
    one, many = square_root(np.zeros(2), EYE), square_root(np.zeros((3, 2)), EYE)
    part = iterated(lambda x, e: x.copy(), EYE)
    np.testing.assert_allclose(part(one, z)[0].mean, part(many, z)[0].mean, atol=1e-12)
    fixes = least_squares(lambda x, e: x, lambda x, e: np.broadcast_to(EYE, (*x.shape, 2)), [1.0, 1.0])
    np.testing.assert_allclose(celnav.run(fixes, one, celnav.epochs([0.0], z[None])).mean[0], z, atol=1e-12)
    two = celnav.sequential(celnav.predict(still, RULE, EYE), celnav.update(EYE, RULE, EYE), celnav.update(EYE, RULE, EYE))
    track = celnav.run(two, one, celnav.epochs([0.0], (np.ones((1, 2)), z[None])))
    assert track.innovation.shape == (1, 3, 4)


@FORMS
def test_noise_of_each_run_with_one_belief(form):
    Q, prior = np.array([1.0, 4.0])[:, None, None] * EYE, form(np.zeros(2), EYE)
    after, _ = celnav.predict(still, RULE, Q)(prior)
    np.testing.assert_allclose(after.std, np.sqrt([[2.0, 2.0], [5.0, 5.0]]))
    after, _, _ = celnav.update(EYE, RULE, Q)(prior, np.ones(2))
    np.testing.assert_allclose(after.mean, [[0.5, 0.5], [0.2, 0.2]])
    with pytest.raises(ValueError, match=r"Q: batch axes \(2,\) do not go with those of the belief, \(3,\)"):
        celnav.predict(still, RULE, Q)(form(np.zeros((3, 2)), EYE))


def test_nothing_measured_is_nothing_done():
    """None, where nan would do too, for a filter of two stages and for fixes."""
    part = plain(celnav.predict(still, RULE, EYE), celnav.update(EYE, RULE, EYE))
    filter = two_stage(part, EYE, square_root(np.zeros(2), EYE))
    prior = square_root(np.zeros(2), EYE)
    absent, nan = (celnav.run(filter, prior, [celnav.Epoch(0, 0.0, 0.0, z=z)]) for z in (None, np.full(2, np.nan)))
    np.testing.assert_array_equal(absent.std, nan.std)
    fixes = least_squares(lambda x, e: x, lambda x, e: EYE, [1.0, 1.0])
    when = [celnav.Epoch(0, 0.0, 0.0, z=None), celnav.Epoch(1, 1.0, 1.0, z=np.ones(2))]
    track = celnav.run(fixes, prior, when, on_failure="flag")
    assert np.isnan(track.mean[0]).all()
    np.testing.assert_allclose(track.mean[1], 1.0)


def test_the_augmented_filter_is_exact_and_tells_of_a_repeated_instant():
    filter = augmented(still, EYE, celnav.unscented(4), 0.5 * EYE, Q=EYE, R=EYE, Sigma0=EYE)
    prior, z = square_root(np.zeros(2), EYE), np.ones((2, 2))
    assert np.isfinite(celnav.run(filter, prior, celnav.epochs([0.0, 1.0], z)).std).all()
    with pytest.raises(celnav.FilterError, match="innovation covariance is not positive definite"):
        celnav.run(filter, prior, celnav.epochs([0.0, 0.0], z))


@pytest.mark.parametrize("value", [np.nan, np.inf, [1], "2", True, 0, 1.5])
def test_numbers_that_must_be_whole(value):
    for make in (huber, lambda rounds: innovation_window(rounds), lambda rounds: celnav.unscented(rounds)):
        with pytest.raises(ValueError, match="expected a positive integer, got"):
            make(rounds=value)
    with pytest.raises(ValueError, match="every: expected a positive integer, got"):
        celnav.run(
            celnav.sequential(celnav.predict(still, RULE, EYE)), square_root(np.zeros(2), EYE), celnav.epochs([0.0]), every=value
        )


@pytest.mark.parametrize("rule", [celnav.unscented(3, 0.1, 2.0), celnav.unscented(3, kappa=-1.5)], ids=["alpha", "kappa"])
@pytest.mark.parametrize("known", ["component", "combination", "measurement"])
def test_rules_of_negative_weight_take_what_is_known_exactly_in_both_forms(rule, known):
    """A downdate of a root that is singular; each form by its own way to the same numbers."""
    F = np.array([[1.0, 0.1, 0.0], [-0.1, 0.9, 0.2], [0.0, 0.0, 0.95]])
    if known == "component":
        P, Q, R = np.diag([1.0, 2.0, 0.0]), np.zeros((3, 3)), [[1.0]]
    elif known == "combination":
        P, Q, R = np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]) + np.diag([1.0, 0.0, 0.0]), np.zeros((3, 3)), [[1.0]]
    else:
        P, Q, R = np.eye(3), 0.1 * np.eye(3), [[0.0]]
    filter = celnav.sequential(
        celnav.predict(lambda x, e: x @ F.T, rule, Q), celnav.update(lambda x, e: x[..., :1] + x[..., 2:], rule, R)
    )
    z = np.random.default_rng(1).normal(size=(20, 1))
    root, cov = (celnav.run(filter, form(np.ones(3), P), celnav.epochs(np.arange(20.0), z)) for form in (square_root, covariance))
    np.testing.assert_allclose(root.mean, cov.mean, atol=1e-7)
    np.testing.assert_allclose(root.std, cov.std, atol=1e-6)
