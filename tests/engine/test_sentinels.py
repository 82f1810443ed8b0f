"""Machine code is compared with numpy at epochs spread over each run; a model with memory is not
compiled.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from twice import assert_same, twice

import celnav
from celnav.engine import runs
from celnav.engine.sentinels import changed, model_contents
from celnav.tape.tape import CannotCompile

pytestmark = pytest.mark.usefixtures("eager")

pytest.importorskip("llvmlite")

T = 80
TIMES = np.arange(float(T))
Z = np.random.default_rng(0).standard_normal((T, 4, 1))
EYE = np.eye(2)
PRIOR = celnav.Gaussian(np.zeros(2), EYE)
SENSOR = celnav.Sensor(EYE[:1], EYE[:1, :1])


def filter_of(f):
    return celnav.ukf(celnav.Motion(f, 0.01 * EYE), SENSOR)


# -- models with memory ------------------------------------------------------------------------
def nonlocal_counter():
    calls = 0

    def f(x, epoch):
        nonlocal calls
        calls += 1
        return x * (0.9 if calls < 60 else 0.5)

    return f


CALLS = 0


def global_counter(x, epoch):
    global CALLS
    CALLS += 1
    return x * (0.9 if CALLS < 60 else 0.5)


class Counter:
    def __init__(self):
        self.calls = [0]

    def __call__(self, x, epoch):
        self.calls[0] += 1
        return x * (0.9 if self.calls[0] < 60 else 0.5)


def default_counter(x, epoch, calls=[0]):  # noqa: B006
    calls[0] += 1
    return x * (0.9 if calls[0] < 60 else 0.5)


def generator():
    k = 0
    while True:
        k += 1
        yield 0.9 if k < 60 else 0.5


def of_generator(values):
    return lambda x, epoch: x * next(values)


def of_random(rng):
    return lambda x, epoch: x + 1e-9 * rng.standard_normal()


class Logger:
    def __init__(self):
        self.log = []

    def f(self, x, epoch):
        self.log.append(1)
        return 0.9 * x


MEMORIES = {
    "motion.f.calls": nonlocal_counter(),
    "motion.f.CALLS": global_counter,
    "motion.f.calls.0": Counter(),
    "motion.f.defaults.0.0": default_counter,
    "motion.f.values.k": of_generator(generator()),
    "motion.f.values": of_generator(itertools.count(0.9, 1e-9)),
    "motion.f.rng": of_random(np.random.default_rng(1)),
    "motion.f.self.log": Logger().f,
}


@pytest.mark.parametrize("path", MEMORIES)
def test_a_model_that_remembers_its_calls_is_not_compiled(path):
    told = f"the model has a memory: {path} changes when it is called"
    with pytest.raises(CannotCompile, match=told):
        celnav.run(filter_of(MEMORIES[path]), PRIOR, TIMES, Z, engine="compiled")
    track = celnav.run(filter_of(MEMORIES[path]), PRIOR, TIMES, Z, engine="auto")
    assert track.engine.startswith(f"numpy: {told}")


class Lazy:
    """It stores the result of its first call."""

    F = None

    def __call__(self, x, epoch):
        if self.F is None:
            self.F = np.array([[1.0, epoch.dt], [0.0, 1.0]])
        return x @ self.F.T


def test_what_is_made_at_the_first_call_is_no_memory():
    assert_same(*twice(filter_of(Lazy()), PRIOR, TIMES, Z))


# -- kept filters ------------------------------------------------------------------------------
RATE = 0.9


def test_a_kept_filter_is_recorded_anew_where_its_model_changed():
    global RATE
    rates = np.array([0.9, 0.9])

    def of_global(x, epoch):
        return RATE * x

    for f in (of_global, lambda x, epoch: rates * x):
        kept = celnav.compiled(filter_of(f))
        for rate in (0.9, 0.5, 0.9):
            RATE = rates[:] = rate
            assert_same(celnav.run(kept.filter, PRIOR, TIMES, Z), kept.run(PRIOR, TIMES, Z))


def test_a_kept_filter_is_compared_again(monkeypatch):
    """The contents of the model's function do not show that numpy's tanh was replaced."""
    kept = celnav.compiled(filter_of(lambda x, epoch: np.tanh(x)))
    kept.run(PRIOR, TIMES, Z)
    monkeypatch.setattr(np, "tanh", lambda x: 0.5 * x)
    found = kept.run(PRIOR, TIMES, Z)
    assert_same(celnav.run(kept.filter, PRIOR, TIMES, Z), found)


def comparisons(monkeypatch, runs):
    """For each run of a reused filter after the first, the epochs that were compared with numpy."""
    compared = []

    def noted(_filter, _engine, _data, sentinel, _watched):
        compared[-1].append(sentinel.at)
        return ""

    kept = celnav.compiled(filter_of(lambda x, epoch: np.tanh(x)))
    kept.run(PRIOR, TIMES, Z)
    monkeypatch.setattr("celnav.engine.compiled.difference", noted)
    for _ in range(runs):
        compared.append([])
        kept.run(PRIOR, TIMES, Z)
    return compared


def test_each_comparison_of_a_short_run_is_at_another_epoch(monkeypatch):
    monkeypatch.setattr("celnav.engine.compiled.COMPARE_ONE", 1)
    compared = comparisons(monkeypatch, 40)
    assert [len(one) for one in compared] == [1] * 40
    assert len({at for one in compared for at in one}) > 20


def test_short_runs_are_compared_each_at_first_then_once_in_4096_steps(monkeypatch):
    steps, span = T * Z.shape[1], 4096
    compared = comparisons(monkeypatch, 60)
    assert all(len(one) <= 1 for one in compared)
    at = [i for i, one in enumerate(compared) if one]
    assert at[:4] == [0, 1, 2, 3]
    apart = np.diff(at)
    assert (apart[-2:] == -(-span // steps)).all()
    assert apart.max() * steps <= span + steps


def test_long_runs_of_a_kept_filter_compare_all_sentinels(monkeypatch):
    monkeypatch.setattr("celnav.engine.compiled.COMPARE_ALL", T * Z.shape[1])
    (compared,) = comparisons(monkeypatch, 1)
    assert {0, T - 1} < set(compared)


# -- where and how -----------------------------------------------------------------------------
def test_sentinels_are_spread_over_the_run():
    steps = [0, *[1] * 20, 2, *[1] * 40, 3, *[1] * 17]
    found = runs._sentinels(steps)
    assert {0, 1, 21, 62, T - 1} <= set(found)
    assert len([at for at in found if 2 < at < T - 1]) >= 4
    assert runs._sentinels([0]) == [0]


def test_machine_code_that_goes_wrong_late_is_found(monkeypatch):
    """The state of a watched run is changed at one epoch."""
    on_host = runs._on_host

    def spoiled(*arguments):
        begin = on_host(*arguments)

        def begun(stored, state, *others):
            through = begin(stored, state, *others)

            def run(at, end):
                through(at, end)
                if end == T:
                    state[:, 5] += 1e-3  # the first number after the tally

            return run

        return begun

    monkeypatch.setattr(runs, "_on_host", spoiled)
    told = rf"other values when it is recorded \(step {T - 1}: another mean\)"
    with pytest.raises(CannotCompile, match=told):
        celnav.run(filter_of(lambda x, e: 0.9 * x), PRIOR, TIMES, Z, engine="compiled")


def test_what_a_filter_holds_is_the_same_if_nothing_changed():
    made = {"a": [1, {"b": np.arange(3.0)}], "nan": np.nan}
    filter = filter_of(lambda x, e: x * made["a"][0])
    before = model_contents(filter)
    assert changed(before, model_contents(filter)) == ""
    made["a"][1]["b"][2] = 7.0
    assert changed(before, model_contents(filter)).endswith("'b'")


# -- round-off is judged by the state's conditioning -------------------------------------------
RATIOS = [1e-18, 1e-12, 1e-6, 1e6, 1e12]


@pytest.mark.parametrize("form", ["square root", "covariance"])
@pytest.mark.parametrize("ratio", RATIOS)
def test_ill_conditioned_problems_are_compiled(ratio, form):
    """Precise sensors after poor priors and the reverse; almost equal states."""
    F = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    H = np.array([[1.0, 1e-6, 0.0], [1.0, 0.0, 1e-6]])
    prior = celnav.Gaussian(np.array([1e3, 1.0, 1.0]), np.diag([1.0, 1e-4, 1e4]))
    z = 1e3 + np.random.default_rng(1).standard_normal((T, 3, 2))
    motions = {
        "linear": celnav.Motion(F, 1e-12 * np.eye(3)),
        "bent": celnav.Motion(lambda x, e: x @ F.T + 1e-4 * np.sin(x), 1e-12 * np.eye(3)),
        "unstable": celnav.Motion(lambda x, e: 1.1 * x @ F.T, np.zeros((3, 3))),
    }
    for motion in motions.values():
        sensor = celnav.Sensor(H, ratio * np.eye(2))
        filter = celnav.ukf(motion, sensor, form=form)
        known = celnav.run(filter, prior, TIMES, z, on_failure="flag")
        found = celnav.run(filter, prior, TIMES, z, engine="auto", on_failure="flag")
        assert found.engine == "compiled"
        np.testing.assert_array_equal(found.failed_at >= 0, known.failed_at >= 0)


def test_one_lost_run_is_flagged_by_auto_too():
    prior = celnav.Gaussian([[0.2, 0.4], [-0.9, 0.3], [0.3, 0.3]], 1e-3 * EYE)
    sensor = celnav.Sensor(lambda x, e: np.log(x[..., :1] + 0.9), EYE[:1, :1])
    filter = celnav.ukf(celnav.Motion(lambda x, e: 0.9 * x, 0.01 * EYE), sensor)
    with np.errstate(all="ignore"):
        known, found = (
            celnav.run(filter, prior, TIMES, Z[:, :3], engine=engine, on_failure="flag")
            for engine in ("numpy", "auto")
        )
    assert known.failed_at[1] >= 0
    np.testing.assert_array_equal(found.failed_at, known.failed_at)


def test_a_model_may_look_at_the_measurement():
    def f(x, epoch):
        return x + 0.1 * (0.0 if epoch.z is None else np.nan_to_num(epoch.z))

    assert_same(*twice(filter_of(f), PRIOR, TIMES, Z[:, 0]))
    track = celnav.run(filter_of(f), PRIOR, TIMES, Z, engine="auto")
    assert track.engine.startswith("numpy: a model reads epoch.z, the measurements of all")


def test_a_model_that_looks_at_the_truth_is_told_so():
    epochs = celnav.epochs(TIMES, Z, truth=np.zeros((T, 4, 2)))
    filter = filter_of(lambda x, epoch: x + 0.0 * epoch.truth.sum())
    with pytest.raises(CannotCompile, match=r"AttributeError.*test_sentinels.py, line \d+"):
        celnav.run(filter, PRIOR, epochs, engine="compiled")
    assert celnav.run(filter, PRIOR, epochs, engine="auto").engine.startswith("numpy: ")
