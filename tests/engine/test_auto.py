"""The choice of engine="auto": machine code if it repays compiling or exists already, otherwise
numpy.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from twice import assert_same

import celnav
from celnav.engine import compiled
from celnav.engine.recording import Engine
from celnav.engine.sentinels import SAMPLE
from celnav.engine.stepper import Plan
from celnav.filters.adaptive import innovation_window
from celnav.filters.run import ENGINE, REPEATED
from celnav.tape.tape import CannotCompile

pytest.importorskip("llvmlite")

PRIOR = celnav.Gaussian([0.0, 1.0], np.diag([1.0, 0.5]))
RADAR = celnav.Sensor(lambda x, _epoch: x[..., :1] + 0.1 * np.sin(x[..., :1]), 0.1)


def swing(x, epoch):
    return np.stack([x[..., 0] + epoch.dt * np.sin(x[..., 1]), x[..., 1]], -1)


def filter_of(f=swing):
    return celnav.ukf(celnav.Motion(f, 0.02), RADAR)


def data(steps, runs):
    """Times and measurements ``(steps, runs, 1)``."""
    times = 0.1 * np.arange(steps)
    return times, drawn(steps, runs).copy()


@functools.cache
def drawn(steps, runs):
    motion, times = celnav.Motion(swing, 0.02), 0.1 * np.arange(steps)
    return celnav.simulate(motion, RADAR, PRIOR, times, runs=runs)[1]


@pytest.fixture
def records(monkeypatch):
    """The recorded steps."""
    counts, record = [], Engine.record
    monkeypatch.setattr(Engine, "record", lambda *given: counts.append(1) or record(*given))
    return counts


def test_auto_is_what_nobody_asks_for():
    assert ENGINE.get() == "auto"


def test_ten_epochs_never_wait_for_a_compiler(records):
    track = celnav.run(filter_of(), PRIOR, *data(10, 20))
    assert track.engine == "numpy: 10 steps of 20 runs take less time than compiling one"
    assert not records
    alone = celnav.run(filter_of(), PRIOR, np.arange(10.0), data(10, 1)[1][:, 0])
    assert alone.engine == "numpy: 10 steps of one run take less time than compiling one"


def test_a_filter_that_flies_again_and_again_is_compiled(records):
    """Not a filter that is created for each run, nor if the number of runs was stated."""
    times, z = data(20, 20)
    again = filter_of(lambda x, epoch: swing(1.001 * x, epoch))  # which no other test records
    engines = [celnav.run(again, PRIOR, times, z).engine for _ in range(40)]
    assert engines[0].startswith("numpy")
    assert engines[-1] == "compiled"
    assert engines == sorted(engines, reverse=True)  # and it remains compiled
    assert len(records) == 2
    assert all(celnav.run(filter_of(), PRIOR, times, z).engine[:5] == "numpy" for _ in range(40))
    token = REPEATED.set(2)
    other = filter_of()
    assert all(celnav.run(other, PRIOR, times, z).engine[:5] == "numpy" for _ in range(40))
    REPEATED.reset(token)


def test_long_and_many_runs_are_compiled_and_the_record_is_kept(records):
    """Also for a short run of the same filter, whose numbers equal numpy's up to round-off."""
    filter, many = filter_of(), data(100, 3000)
    known, found = (celnav.run(filter, PRIOR, *many, engine=one) for one in ("numpy", None))
    assert np.abs((found.mean - known.mean) / known.std).max() < 1e-6
    assert celnav.run(filter, PRIOR, *many).engine == "compiled"
    count = len(records)
    short = data(10, 3)
    assert_same(
        celnav.run(filter, PRIOR, *short, engine="numpy"), celnav.run(filter, PRIOR, *short)
    )
    assert len(records) == count == 2  # with an interval and without
    celnav.run(filter, PRIOR, *short, engine="compiled")
    celnav.run(filter, PRIOR, *short, engine="compiled")
    assert len(records) == count


class Slotted:
    __slots__ = ("gain",)

    def __init__(self, gain):
        self.gain = gain


def table_of(last):
    return np.append(np.zeros(2 * SAMPLE - 1), last)


def with_table(table):
    """A motion that reads the end of a long table at one epoch."""
    return lambda x, epoch: swing(x, epoch) + np.where(epoch.k == 50, table[-1], 0.0)


def with_slots(held):
    return lambda x, epoch: held.gain * swing(x, epoch)


def with_number(number):
    return lambda x, epoch: number * swing(x, epoch)


@pytest.mark.parametrize(
    ("make", "first", "second", "equal"),
    [
        (with_number, 0.9, 0.9, True),
        (with_number, 0.9, 0.8, False),
        (with_slots, Slotted(0.9), Slotted(0.9), True),
        (with_slots, Slotted(0.9), Slotted(0.8), False),
        (with_table, table_of(0.0), table_of(0.5), False),
    ],
    ids=["number", "other number", "slot", "other slot", "other end of a table"],
)
def test_a_filter_made_anew_takes_what_was_recorded_of_an_equal_one(
    records, make, first, second, equal
):
    many = data(100, 5)
    celnav.run(filter_of(make(first)), PRIOR, *many, engine="compiled")
    count = len(records)
    filter = filter_of(make(second))
    known, found = (celnav.run(filter, PRIOR, *many, engine=one) for one in ("numpy", "compiled"))
    assert (len(records) == count) == equal
    assert found.engine == "compiled"
    assert np.abs((found.mean - known.mean) / known.std).max() < 1e-6


def test_one_record_serves_whatever_is_kept(records):
    filter = celnav.compiled(filter_of())
    for keep in ("std", "cov", "mean", "nothing", ("innovation",)):
        filter.run(PRIOR, *data(20, 8), keep=keep)
    assert len(records) == 2  # at the time of the prior, and after an interval


def test_the_choice_does_not_depend_on_other_filters():
    """A unit of a study gives the same bytes, whatever units its process has computed before."""
    long, short = data(100, 3000), data(20, 20)
    tracks = [celnav.run(filter_of(), PRIOR, *one) for one in (short, long, short)]
    assert [track.engine.partition(":")[0] for track in tracks] == ["numpy", "compiled", "numpy"]
    assert tracks[2].mean.tobytes() == tracks[0].mean.tobytes()


def test_flights_that_are_expected_again_are_compiled_sooner():
    flight = data(20, 200)
    assert celnav.run(filter_of(), PRIOR, *flight).engine.startswith("numpy: 20 steps of 200 runs")
    token = REPEATED.set(50)
    try:
        assert celnav.run(filter_of(), PRIOR, *flight).engine == "compiled"
    finally:
        REPEATED.reset(token)


def test_what_is_kept_is_of_the_last_filters():
    for _ in range(compiled.MOST_CACHED + 3):
        filter = celnav.ukf(celnav.Motion([[1.0]], 1.0), celnav.Sensor([[1.0]], 1.0))
        celnav.run(filter, celnav.Gaussian([0.0], 1.0), *data(3, 2), engine="compiled")
    assert len(compiled._CACHE) == compiled.MOST_CACHED
    assert (id(filter), "compiled", 1) in compiled._CACHE


def test_more_work_is_worth_longer_steps():
    found = [
        [compiled.operation_limit(steps, steps * runs, 2) for steps in (1, 30, 1000, 10**5)]
        for runs in (1, 50, 10**4)
    ]
    assert (np.diff(found, axis=0) >= 0).all()
    assert (np.diff(found, axis=1) >= 0).all()
    assert found[0][0] < 10
    assert found[-1][-1] == compiled.MOST_AUTO


def test_numpy_flies_what_cannot_be_compiled_and_says_why(monkeypatch):
    many = data(100, 3000)

    def branching(x, epoch):
        return swing(x, epoch) if x.sum() > -np.inf else x

    track = celnav.run(filter_of(branching), PRIOR, *many)
    assert track.engine.startswith("numpy: a branch depends on a number")
    stream = celnav.run(filter_of(), PRIOR, iter(celnav.epochs(*many)))
    assert stream.engine == "numpy: a stream of epochs"
    told = celnav.run(filter_of(), PRIOR, *many, also=lambda epoch, _state, _infos: {"k": epoch.k})
    assert told.engine.startswith("numpy: also, reduce")
    monkeypatch.setattr(compiled, "find_spec", lambda _name: None)
    missing = celnav.run(filter_of(), PRIOR, *many)
    assert missing.engine == "numpy: llvmlite is not installed"


def test_numpy_computes_one_covariance_of_models_that_are_matrices_fast():
    """With such models compiling is worthwhile only for more runs, but for as few steps."""
    matrix = celnav.ekf(celnav.Motion(np.eye(4), 0.1), celnav.Sensor(np.eye(4)[:1], 1.0))
    curved = celnav.ekf(celnav.Motion(lambda x, e: np.sin(x), 0.1), matrix.sensors[0])
    prior, own = (
        celnav.Gaussian(np.zeros((3000, 4)), x * np.eye(4)) for x in (1.0, np.ones((3000, 1, 1)))
    )
    many, long = celnav.epochs(np.arange(100.0)), celnav.epochs(np.arange(9000.0))
    with pytest.raises(CannotCompile, match="100 steps of 3000 runs take less time"):
        compiled.resolve_engine("auto", matrix, 1, prior, many)
    for filter, belief, epochs in (
        (curved, prior, many),
        (matrix, own, many),
        (matrix, prior, long),
    ):
        assert compiled.resolve_engine("auto", filter, 1, belief, epochs).filter is filter


@pytest.mark.parametrize("form", ["square root", "covariance"])
@pytest.mark.parametrize("runs", [(), (7,)], ids=["one", "runs"])
def test_the_way_back_is_the_same_by_machine_code(form, runs):
    """With gaps, inputs, an interval of 0, and a run that fails in the middle."""

    def pushed(x, epoch):
        return swing(x, epoch) + (0.0 if epoch.u is None else epoch.u)

    filter = celnav.ukf(celnav.Motion(pushed, 0.02), RADAR, form=form)
    times, z = np.array([0.0, 1.0, 1.5, 1.5, 3.0, 3.5, 5.0]), data(7, 7)[1]
    z[2, 3], z[4:, 5] = np.nan, 1e200
    z = z if runs else z[:, 0]
    u = np.linspace(0.0, 0.3, 12).reshape(6, 2)
    with np.errstate(all="ignore"):
        track = celnav.run(filter, PRIOR, times, z, u, keep="cov", on_failure="flag")
        by_numpy, found = (celnav.smooth(track, engine=engine) for engine in ("numpy", "compiled"))
    assert np.isnan(found.mean[:4]).sum() == 0
    for name in ("mean", "std", "cov"):
        np.testing.assert_allclose(getattr(found, name), getattr(by_numpy, name), 1e-9, 1e-12)
    np.testing.assert_array_equal(found.failed_at, by_numpy.failed_at)


def test_the_iterated_smoother_records_each_of_its_steps_once(records):
    """For any number of iterations: forward and backward, for the filter and the relinearized
    filter.
    """
    times, z = data(9, 1)
    known = celnav.iterated_smoother(
        filter_of(), PRIOR, times, z[:, 0], iterations=4, engine="numpy"
    )
    filter = filter_of()
    found = celnav.iterated_smoother(filter, PRIOR, times, z[:, 0], iterations=4, engine="compiled")
    np.testing.assert_allclose(found.mean, known.mean, 1e-9, 1e-12)
    np.testing.assert_allclose(found.cov, known.cov, 1e-9, 1e-12)
    count = len(records)
    celnav.iterated_smoother(filter_of(), PRIOR, times, z[:, 0], iterations=9, engine="compiled")
    assert len(records) == count


def test_a_plan_of_steps_is_made_once(monkeypatch):
    made, plan = [], Plan.__init__
    monkeypatch.setattr(Plan, "__init__", lambda self, *given: made.append(1) or plan(self, *given))
    fast, (times, z) = celnav.compiled(filter_of()), data(40, 1)
    for _ in celnav.steps(fast, PRIOR, celnav.epochs(times, z[:, 0])):
        pass
    assert len(made) == 2


@pytest.mark.parametrize("runs", [(), (5,)], ids=["one", "runs"])
def test_the_noise_that_hooks_leave_is_kept_by_machine_code_too(runs):
    """``track.extra["R"]``, also at epochs without a measurement, and of a second sensor without
    hooks.
    """
    motion = celnav.Motion(swing, 0.02)
    gps = celnav.Sensor([[1.0, 0.0]], 0.5)
    filter = celnav.ukf(motion, RADAR, gps, hooks=[[innovation_window(3)], []])
    times, z = data(12, 5)
    z[4], z = np.nan, z if runs else z[:, 0]
    known, found = (
        celnav.run(filter, PRIOR, times, (z, z), engine=engine) for engine in ("numpy", "compiled")
    )
    assert found.extra["R"].shape == (12, *runs, 1)
    np.testing.assert_allclose(found.extra["R"], known.extra["R"], 1e-9)


def test_a_step_that_is_too_long_is_recorded_once(records, monkeypatch):
    monkeypatch.setattr(compiled, "operation_limit", lambda *_work: 150)
    monkeypatch.setattr(compiled, "EXPECTED_OPERATIONS", (0, 0))
    filter = filter_of(lambda x, epoch: swing(1.002 * x, epoch))
    for _ in range(3):
        track = celnav.run(filter, PRIOR, *data(20, 8))
        assert "operations takes longer than it saves: at most 150" in track.engine
    assert len(records) == 1


def looped(x, _epoch):
    """A model that leaves many unneeded operations on the tape when it is recorded as a loop over
    points.
    """
    for _ in range(200):
        x = x + 0.001 * np.sin(x[..., ::-1]) * np.cos(x)
    return x


def test_the_choice_does_not_depend_on_other_filters_where_a_model_is_a_loop():
    engines = []
    for steps, runs in ((300, 20), (1000, 200), (300, 20)):
        track = celnav.run(filter_of(looped), PRIOR, *data(steps, runs))
        engines.append(track.engine.partition(":")[0])
    assert engines == ["numpy", "compiled", "numpy"]


def test_a_filter_that_was_compiled_stays_so_where_epochs_are_of_more_kinds():
    def bent(x, _epoch):
        return x[..., :1] + 0.01 * x[..., 1:] ** 2

    sensors = [celnav.Sensor(bent, R) for R in (1.0, 2.0, 3.0)]
    filter = celnav.ukf(celnav.Motion(swing, 0.02), *sensors)
    rng = np.random.default_rng(0)

    def flight(kinds):
        for k in range(250):
            z = rng.standard_normal((3, 20, 1))
            silent = k % kinds if k < 249 else 0  # a bit for each sensor
            z = tuple(None if silent >> i & 1 else z[i] for i in range(3))
            yield celnav.Epoch(k, float(k), float(k > 0), None, z)

    assert celnav.run(filter, PRIOR, list(flight(1))).engine == "compiled"
    assert celnav.run(filter, PRIOR, list(flight(8))).engine == "compiled"


def test_a_step_is_seldom_recorded_in_vain_while_work_accumulates(records, monkeypatch):
    monkeypatch.setattr(compiled, "EXPECTED_OPERATIONS", (0, 0))
    monkeypatch.setattr(compiled, "COMPILE_OPERATION_S", 1e-3)
    filter = filter_of(lambda x, epoch: looped(1.003 * x, epoch))
    times, z = data(20, 20)
    for _ in range(32):
        assert celnav.run(filter, PRIOR, times, z).engine.startswith("numpy: a step of more than")
    assert len(records) <= 2 + np.log2(32)
