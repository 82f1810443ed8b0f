"""A second filter repeats the runs in which the first fails, and nothing else."""

import numpy as np
import pytest

from celnav import Epoch, Gaussian, Motion, Sensor, epochs, run, sigma_point
from celnav.filters.records import FilterError
from celnav.filters.run import explain
from celnav.filters.switching import Fallback
from celnav.gaussian.rules import cubature, unscented

FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])
N = 13
FIFTH, THIRD = cubature(N, degree=5), cubature(N)
SMALL = 0.0025
WIDE = Gaussian(np.zeros((3, N)), np.array([0.2, 3.0, 0.2])[:, None, None] ** 2 * np.eye(N))


def steep(x, epoch):
    """A function with which negative weights make the middle run of `WIDE` fail."""
    return np.cos(3.0 * x)


def pair(motion, sensor, form="square root"):
    """A filter with negative weights, a filter without, and a `Fallback` of both."""
    first, second = (sigma_point(motion, sensor, rule=rule, form=form) for rule in (FIFTH, THIRD))
    return first, second, Fallback(first, second)


def steeply_measured(form="square root"):
    return pair(
        Motion(np.eye(N), np.zeros((N, N))),
        Sensor(lambda x, epoch: steep(x[..., :6], epoch), SMALL * np.eye(6)),
        form,
    )


@FORMS
def test_fallback_of_an_update(form):
    """With negative weights the middle run's innovation covariance is indefinite; a rule with
    positive weights repeats it, and the neighbors do not change by a bit.
    """
    first, second, both = steeply_measured(form)
    epoch = Epoch(z=np.ones((3, 6)))
    (alone, (lone_info,)), (again, (other,)) = (
        filter.update(filter.start(WIDE), epoch) for filter in (first, second)
    )
    alone, again = alone.belief, again.belief
    assert np.isnan(alone.mean[1]).all()
    state, (info,) = both.step(both.start(WIDE), epoch)
    after = state.belief
    np.testing.assert_array_equal(info.redone, [False, True, False])
    for name in ("mean", "cov", "sqrt_cov"):
        np.testing.assert_array_equal(getattr(after, name)[[0, 2]], getattr(alone, name)[[0, 2]])
        np.testing.assert_array_equal(getattr(after, name)[1], getattr(again, name)[1])
    for name in ("innovation", "whitened", "used", "sqrt_S"):
        np.testing.assert_array_equal(getattr(info, name)[[0, 2]], getattr(lone_info, name)[[0, 2]])
        np.testing.assert_array_equal(getattr(info, name)[1], getattr(other, name)[1])
    for name in ("gain", "jacobian"):
        np.testing.assert_array_equal(
            getattr(info, name)()[[0, 2]], getattr(lone_info, name)()[[0, 2]]
        )
        np.testing.assert_array_equal(getattr(info, name)()[1], getattr(other, name)()[1])
    likelihood = np.where([False, True, False], other.log_likelihood, lone_info.log_likelihood)
    np.testing.assert_array_equal(info.log_likelihood, likelihood)
    assert np.isfinite(likelihood).all()


@FORMS
def test_fallback_of_a_prediction_is_counted(form):
    """Also in covariance form, where an indefinite prediction is finite and
    would only fail later.
    """
    first, second, both = pair(
        Motion(steep, SMALL * np.eye(N)), Sensor(np.eye(2, N), np.eye(2)), form
    )
    when = epochs(np.arange(2), np.array([np.full((3, 2), np.nan), np.ones((3, 2))]))
    with pytest.raises(FilterError, match=r"run \(1,\)"):
        run(first, WIDE, when)
    track = run(both, WIDE, when, keep="cov")
    np.testing.assert_array_equal(track.events["redone"], [0, 1, 0])
    np.testing.assert_array_equal(track.failed_at, [-1, -1, -1])
    flagged = run(first, WIDE, when, keep="cov", on_failure="flag")
    np.testing.assert_array_equal(track.mean[:, [0, 2]], flagged.mean[:, [0, 2]])
    np.testing.assert_array_equal(track.belief[1][:, [0, 2]], flagged.belief[1][:, [0, 2]])
    np.testing.assert_array_equal(track.mean[1, 1], run(second, WIDE, when).mean[1, 1])


@FORMS
@pytest.mark.parametrize("seeing", [True, False], ids=["measured", "open loop"])
def test_redone_in_both_parts_of_a_step(form, seeing):
    """A run repeated in the prediction and another one in the update: both are counted; the first
    epoch has no prediction.
    """
    prior = Gaussian(np.zeros((3, N)), np.array([3.0, 3.0, 0.2])[:, None, None] ** 2 * np.eye(N))
    moved, measured = np.array([[True], [False], [False]]), np.array([[False], [True], [False]])

    def f(x, epoch):
        return np.where(moved, steep(x, epoch), x)

    def h(x, epoch):
        return np.where(measured, steep(x, epoch), x)[..., :6]

    sensors = (Sensor(h, SMALL * np.eye(6)),) if seeing else ()
    both = Fallback(
        *(
            sigma_point(Motion(f, SMALL * np.eye(N)), *sensors, rule=rule, form=form)
            for rule in (FIFTH, THIRD)
        )
    )
    z = np.ones((2, 3, 6))
    z[0] = np.nan
    np.testing.assert_array_equal(
        run(both, prior, epochs(np.arange(2), z)).events["redone"], [1, int(seeing), 0]
    )


def test_fallback_gives_up_where_both_fail():
    """If both filters fail, the run fails with a reason; a run that failed before is not repeated;
    without a failure nothing is repeated.
    """
    first, _, both = steeply_measured()
    epoch = Epoch(z=np.ones((3, 6)))
    twice = Fallback(first, first)
    start = twice.start(WIDE)
    state, _ = twice.step(start, epoch)
    assert np.isnan(state.belief.mean[1]).all()
    assert "not positive definite" in explain(twice, start, state, epoch)
    gone = start._replace(
        belief=start.belief._replace(
            mean=np.where(np.arange(3)[:, None] == 1, np.nan, start.belief.mean)
        )
    )
    assert both.step(gone, epoch)[1][0].redone is None

    def never(n):
        raise AssertionError("the second filter's rule")

    tame = Gaussian(np.zeros((2, N)), 0.04 * np.eye(N))
    untried = Fallback(first, sigma_point(first.motion, *first.sensors, rule=never))
    _, (info,) = untried.step(untried.start(tame), epoch._replace(z=epoch.z[:2]))
    assert info.redone is None
    with pytest.raises(AssertionError, match=r"^the second filter's rule$"):
        untried.step(untried.start(WIDE), epoch)


def test_filters_that_do_not_go_together_are_refused_by_name():
    with pytest.raises(ValueError, match=r"^second: expected"):
        Fallback(steeply_measured()[0], steeply_measured("covariance")[0])
    with pytest.raises(ValueError, match=r"^first: expected"):
        Fallback(unscented(2), steeply_measured()[0])
