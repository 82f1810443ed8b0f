"""Switching filters, compared with the same filters stepped by hand."""

import numpy as np
import pytest

import celnav
from celnav import Epoch, Gaussian, Motion, Sensor, epochs, run, sigma_point
from celnav.filters.records import State
from celnav.filters.switching import Switching
from celnav.gaussian.rules import Taylor, cubature
from celnav.gaussian.sparse_grid import smolyak
from celnav.tape.tape import CannotCompile

pytestmark = pytest.mark.usefixtures("eager")

FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])
PRIOR = Gaussian(
    np.array([[0.4, 0.0, 1.0], [0.1, 0.5, -1.0], [0.2, 0.2, 0.3]]), np.diag([0.2, 0.1, 0.3])
)
TIMES = np.arange(6.0)
Z = np.random.default_rng(0).standard_normal((6, 3, 2))


def filters(form="square root", **more):
    motion = Motion(lambda x, epoch: x + 0.1 * np.sin(x[..., ::-1]), 0.01 * np.eye(3))
    sensor = Sensor(
        lambda x, epoch: np.stack([np.sin(x[..., 0]), x[..., 1] * x[..., 2]], -1), 0.1 * np.eye(2)
    )
    return [
        sigma_point(motion, sensor, rule=rule, form=form, **more)
        for rule in (cubature(3), smolyak(3, 3), Taylor())
    ]


@FORMS
def test_each_run_is_that_of_its_filter_bit_for_bit(form):
    own = filters(form)
    known = [run(filter, PRIOR, TIMES, Z) for filter in own]
    both = run(
        Switching(own.__getitem__, lambda belief, epoch, chosen: np.array([2, 0, 1])),
        PRIOR,
        TIMES,
        Z,
        also=lambda epoch, state, infos: {"chosen": state.chosen},
    )
    for i, number in enumerate((2, 0, 1)):
        for name in ("mean", "std", "innovation", "whitened", "used"):
            np.testing.assert_array_equal(
                getattr(both, name)[:, i], getattr(known[number], name)[:, i]
            )
    np.testing.assert_array_equal(both.extra["chosen"], np.tile([2, 0, 1], (6, 1)))


@FORMS
def test_a_switch_is_the_second_filter_started_from_what_the_first_believes(form):
    first, second, _ = filters(form)
    turn = Switching(
        [first, second].__getitem__, lambda belief, epoch, chosen: np.full(3, int(epoch.k >= 3))
    )
    given = list(epochs(TIMES, Z))
    half = run(first, PRIOR, given[:3], keep="cov")
    state = State(type(half.belief)(*(x[-1] for x in half.belief)), (None,))
    for epoch in given[3:]:
        state, _ = second.step(state, epoch)
    whole = run(turn, PRIOR, given, keep="cov")
    np.testing.assert_array_equal(whole.mean[-1], state.belief.mean)
    np.testing.assert_array_equal(whole.belief[1][-1], state.belief[1])


def test_any_sequence_of_rules_on_a_linear_model_is_the_kalman_filter():
    motion, gps = (
        Motion(np.eye(3, k=1) * 0.1 + np.eye(3), 0.01 * np.eye(3)),
        Sensor(np.eye(2, 3), 0.1 * np.eye(2)),
    )
    every = [
        sigma_point(motion, gps, rule=rule)
        for rule in (smolyak(3, 3, (1, 1, 2)), smolyak(3, 3, (2, 1, 2)), cubature(3))
    ]
    seen = []

    def choose(belief, epoch, chosen):
        seen.append(chosen)
        return np.array([epoch.k, epoch.k + 1, 2 * epoch.k]) % 3

    turns, kalman = (
        run(filter, PRIOR, TIMES, Z)
        for filter in (Switching(every.__getitem__, choose), celnav.ekf(motion, gps))
    )
    np.testing.assert_allclose(turns.mean, kalman.mean, atol=1e-10)
    np.testing.assert_allclose(turns.std, kalman.std, atol=1e-10)
    assert seen[0] is None
    np.testing.assert_array_equal(seen[2], [1, 2, 2])


def test_runs_of_the_measurements_choose_for_themselves():
    """A prior without an axis of runs gets the number of runs from the measurements."""
    own = filters()
    alone = Gaussian(PRIOR.mean[0], PRIOR.cov)
    turns = Switching(
        own.__getitem__, lambda belief, epoch, chosen: (belief.mean[..., 0] > 0.4).astype(int)
    )
    track = run(turns, alone, TIMES, Z, also=lambda epoch, state, infos: {"chosen": state.chosen})
    assert track.extra["chosen"].shape == (6, 3)
    assert set(track.extra["chosen"].ravel().tolist()) == {0, 1}


def test_bad_choices_are_refused_by_name():
    own = filters()
    epoch = Epoch(z=Z[0])
    for wrong in (
        np.array([0.5, 1.0, 0.0]),
        np.array([True, False, True]),
        np.array([-1, 0, 0]),
        [],
    ):
        filter = Switching(own.__getitem__, lambda belief, epoch, chosen, wrong=wrong: wrong)
        with pytest.raises(ValueError, match=r"^choose: expected whole numbers"):
            filter.step(filter.start(PRIOR), epoch)
    hooked = filters(hooks=[celnav.filters.adaptive.innovation_window(3)])
    filter = Switching(hooked.__getitem__, lambda belief, epoch, chosen: np.zeros(3, int))
    with pytest.raises(ValueError, match=r"^filters: expected filters without hooks"):
        filter.step(filter.start(PRIOR), epoch)


def test_what_is_known_only_when_it_runs_is_not_compiled():
    pytest.importorskip("llvmlite")
    turn = Switching(
        filters().__getitem__, lambda belief, epoch, chosen: np.zeros(3, int) + epoch.k % 2
    )
    with pytest.raises(
        CannotCompile, match=r"^which filter makes a step is known only when it runs"
    ):
        run(turn, PRIOR, TIMES, Z, engine="compiled")
    track = run(turn, PRIOR, TIMES, Z, engine="auto")
    assert track.engine.startswith("numpy: which filter makes a step is known only when it runs")
    np.testing.assert_array_equal(track.mean, run(turn, PRIOR, TIMES, Z, engine="numpy").mean)
