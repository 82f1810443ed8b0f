"""Epochs from arrays: their intervals for any slice, and their use of memory."""

import re
import tracemalloc
from datetime import UTC, datetime, timedelta
from typing import NamedTuple
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
import pytest

import celnav
from celnav.engine import runs
from celnav.engine.recording import tree_leaves

pytestmark = pytest.mark.usefixtures("eager")

SLOPE = 2.0


def speed(epochs, prior=None):
    """The track of a point that moves at a constant speed."""
    move = lambda x, e: np.stack([x[..., 0] + e.dt * x[..., 1], x[..., 1]], -1)  # noqa: E731
    filter = celnav.ukf(
        celnav.Motion(move, sqrt_Q=np.zeros((2, 0))), celnav.Sensor([[1.0, 0.0]], [[0.01]])
    )
    return celnav.run(
        filter,
        celnav.Gaussian([0.0, 0.0], 100.0 * np.eye(2)) if prior is None else prior,
        epochs,
        keep="cov",
    )


def last(track):
    """The last belief of a track."""
    return type(track.belief)(track.belief[0][-1], track.belief[1][-1])


LINE = celnav.ukf(
    celnav.Motion(lambda x, e: x + e.u * e.dt, [[0.1]]), celnav.Sensor([[1.0]], [[1.0]])
)
START = celnav.Gaussian([0.0], [[1.0]])
TIMES = np.array([0.0, 1.0, 2.5, 3.0, 4.0, 6.0, 7.0, 8.5])
WHOLE = celnav.epochs(TIMES, SLOPE * TIMES[:, None], truth=TIMES)


def test_a_stride_has_intervals_of_its_own():
    """Every other measurement of a point at 2 m/s gives 2 m/s, as do epochs made from these
    measurements alone.
    """
    for taken in (WHOLE[::2], WHOLE[:][::2], WHOLE[::2][:]):
        found, expected = speed(taken), speed(celnav.epochs(TIMES[::2], SLOPE * TIMES[::2, None]))
        np.testing.assert_array_equal(found.mean, expected.mean)
        assert found.mean[-1, 1] == pytest.approx(SLOPE, abs=1e-3)
        assert [e.k for e in taken] == [0, 1, 2, 3]
        assert [e.truth for e in taken] == TIMES[::2].tolist()
    assert [(e.k, e.dt) for e in WHOLE[1::3]] == [(1, 1.0), (2, 3.0), (3, 4.5)]
    assert [e.dt for e in WHOLE[::2][1::2]] == [2.5, 4.5]


def test_a_part_goes_on_where_the_one_before_it_ended():
    whole = speed(WHOLE)
    for k in (1, 3, 7):
        first = speed(WHOLE[:k])
        second = speed(WHOLE[k:], last(first))
        np.testing.assert_array_equal(np.concatenate([first.mean, second.mean]), whole.mean)
    half = speed(WHOLE[::2])
    first = speed(WHOLE[::2][:2])
    second = speed(WHOLE[::2][2:], last(first))
    np.testing.assert_array_equal(np.concatenate([first.mean, second.mean]), half.mean)
    np.testing.assert_array_equal(speed(WHOLE[:3] + WHOLE[3:]).mean, whole.mean)
    assert [(e.k, e.t, e.dt) for e in WHOLE[5:7]] == [(5, 6.0, 2.0), (6, 7.0, 1.0)]
    assert (WHOLE[-1].k, WHOLE[-1].t, WHOLE[-1].dt) == (7, 8.5, 1.5)
    assert (len(WHOLE[9:]), repr(WHOLE[9:]), repr(WHOLE[2:])) == (
        0,
        "Epochs(0)",
        "Epochs(6 from 2.5 to 8.5 s)",
    )


def test_inputs_belong_to_intervals():
    when = celnav.epochs(TIMES, u=np.arange(7.0))
    assert [e.u for e in when] == [None, *np.arange(7.0)]
    assert [e.u for e in when[2:4]] == [1.0, 2.0]
    with pytest.raises(ValueError, match="epochs: an interval of 2 epochs has 2 inputs"):
        when[::2]


def test_what_cannot_be_taken():
    with pytest.raises(ValueError, match="epochs: expected a slice that runs forward"):
        WHOLE[::-1]
    for beyond in (8, -9):
        with pytest.raises(IndexError, match="index out of range"):
            WHOLE[beyond]


def test_epochs_are_made_one_at_a_time():
    """Only the given arrays are as long as the record."""
    when = celnav.epochs(np.arange(200_000.0), np.zeros((200_000, 1)))
    tracemalloc.start()
    try:
        for _ in zip(range(10), when, strict=False):
            pass
        for _ in zip(range(10), when[5:], strict=False):
            pass
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 100_000


def push(x, epoch):
    u = sum(epoch.u) if isinstance(epoch.u, tuple) else epoch.u
    return x + u * epoch.dt


PUSHED = celnav.ukf(celnav.Motion(push, sqrt_Q=np.zeros((1, 1))), celnav.Sensor([[1.0]], [[1.0]]))
ORIGIN = celnav.Gaussian([0.0], [[1.0]])


def stepped(u, times=TIMES, engine="numpy"):
    """The result of summing the inputs."""
    return celnav.run(PUSHED, ORIGIN, times, u=u, engine=engine).mean


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
def test_inputs_that_are_too_many_are_not_cut_off(engine):
    """Times at 4 Hz with an inertial unit's rows at 100 Hz: only the first 20 of 1,000 rows would
    be used.
    """
    times, rate = np.arange(21) / 4.0, np.linspace(0.0, 2.0, 1000)
    message = (
        r"^u: expected 20 rows for 21 times \(row k acts from times\[k\] to times\[k \+ 1\]\), "
        r"got 1000$"
    )
    with pytest.raises(ValueError, match=message):
        stepped(rate, times, engine)
    with pytest.raises(ValueError, match=message):
        stepped((rate[:20], rate), times, engine)
    assert stepped(np.ones(20), times, engine)[-1, 0] == 5.0


DOORS = {
    "numpy": lambda u: stepped(u),
    "compiled": lambda u: stepped(u, engine="compiled"),
    "a compiled filter": lambda u: celnav.compiled(PUSHED).run(ORIGIN, TIMES, None, u),
    "simulate": lambda u: celnav.simulate(PUSHED.motion, PUSHED.sensors[0], ORIGIN, TIMES, u=u),
    "steps": lambda u: list(celnav.steps(PUSHED, ORIGIN, celnav.epochs(TIMES, u=u))),
    "smoother": lambda u: celnav.iterated_smoother(PUSHED, ORIGIN, TIMES, np.ones((8, 1)), u),
    "problem": lambda u: celnav.Problem(PUSHED.motion, PUSHED.sensors[0], ORIGIN, TIMES, u).epochs,
}


@pytest.mark.parametrize("door", DOORS.values(), ids=DOORS)
def test_an_input_for_each_time_of_a_log_is_refused_with_both_cures(door):
    """Only the user knows whether a row of the log acts before its time or after it."""
    log = np.arange(8.0)
    message = (
        "u: expected 7 rows for 8 times (row k acts from times[k] to times[k + 1]), got 8; its "
        "rows [:-1] if row k acts from times[k] on, [1:] if it acts up to times[k]"
    )
    for u in (log, log.tolist(), pd.Series(log), (log[1:], log)):
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            door(u)
    door(log[1:])


def test_the_cures_are_the_two_meanings_of_a_log():
    """A speed that rises: held from each time on, or held up to each time."""
    log, dt = np.arange(8.0), np.diff(TIMES)
    after = [log[k] * dt[k] for k in range(7)]  # from times[k] to times[k + 1]
    before = [log[k] * (TIMES[k] - TIMES[k - 1]) for k in range(1, 8)]
    for u, moves in ((log[:-1], after), (log[1:], before)):
        np.testing.assert_allclose(stepped(u)[1:, 0], np.cumsum(moves), rtol=1e-14)


def test_rows_go_with_the_times():
    for count in (6, 9):
        with pytest.raises(ValueError, match=rf"^u: expected 7 rows for 8 times .*, got {count}$"):
            celnav.epochs(TIMES, u=[0.0] * count)
    for count in (7, 9):
        with pytest.raises(ValueError, match=rf"^truth: expected 8 rows for 8 times, got {count}$"):
            celnav.epochs(TIMES, truth=np.zeros((count, 2)))
    for u in ({0, 1}, "of a column", 3.0, dict.fromkeys("abcdefg", 0.0)):
        with pytest.raises(ValueError, match=r"^u: expected a sequence with a row for each time"):
            celnav.epochs(TIMES, u=u)
    assert [e.u for e in celnav.epochs([0.0], u=[])] == [None]


ZONE = ZoneInfo("Europe/Berlin")
NIGHT = [datetime(2024, 3, 30, 23, 0, tzinfo=ZONE) + timedelta(hours=k) for k in (0, 1)] + [
    datetime(2024, 3, 31, hour, 0, tzinfo=ZONE) for hour in (1, 3)
]
"""Times one hour apart, at which clocks change from two to three."""
DATED = {
    "datetime64": np.datetime64("2024-03-30T22", "ms") + 3_600_000 * np.arange(4),
    "durations": np.timedelta64(1, "h") * np.arange(4),
    "datetimes of a zone": NIGHT,
    "datetimes": [t.astimezone(UTC).replace(tzinfo=None) for t in NIGHT],
    "index": pd.DatetimeIndex(NIGHT),
    "index without a zone": pd.date_range("2024-03-30T22", periods=4, freq="h"),
    "series of a zone": pd.Series(pd.DatetimeIndex(NIGHT), index=[3, 2, 1, 0]),
    "timestamps": list(pd.DatetimeIndex(NIGHT)),
    "durations of pandas": pd.timedelta_range("0h", periods=4, freq="h"),
    "series of numbers": pd.Series(3600.0 * np.arange(4), index=[3, 2, 1, 0]),
}


@pytest.mark.parametrize("times", DATED.values(), ids=DATED)
def test_dates_are_seconds_since_the_first(times):
    seconds = 3600.0 * np.arange(4)
    assert [e.t for e in celnav.epochs(times)] == seconds.tolist()
    np.testing.assert_array_equal(stepped(np.ones(3), times), stepped(np.ones(3), seconds))


def test_dates_keep_their_nanoseconds():
    start = pd.Timestamp("2024-01-01T00:00:00.123456789")
    times = [start, start + pd.Timedelta(1, "ns"), start + pd.Timedelta(3, "ns")]
    for form in (times, pd.DatetimeIndex(times), pd.DatetimeIndex(times, tz="UTC")):
        assert [e.t for e in celnav.epochs(form)] == [0.0, 1e-9, 3e-9]


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (pd.DatetimeIndex(["2024-01-01", None]), "times: expected finite numbers, got 1 that"),
        ([NIGHT[0], DATED["datetimes"][1]], "times: expected numbers, got "),
        (["2024-01-01", "2024-01-02"], "times: expected numbers, got "),
        (pd.Series(["a", "b"]), "times: expected numbers, got "),
        (pd.DataFrame({"t": [0.0, 1.0]}), r"times: expected shape \(T,\) with T > 0, got \(2, 1\)"),
        (
            pd.DatetimeIndex(NIGHT[::-1]),
            "times: expected times that do not decrease, got -3600.0 after",
        ),
        (np.array(["2024-01", "2024-02"], "M8[M]"), "times: expected numbers, got dates or"),
    ],
)
def test_what_are_no_times_is_said_of_the_times(times, message):
    with pytest.raises(ValueError, match="^" + message):
        stepped(None, times)


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
def test_tables_count_by_their_rows(engine):
    """Not by their labels: a part of a table keeps its labels, and 0 may be the name of a column."""
    push, z = np.arange(7.0), np.linspace(0.0, 1.0, 8)
    expected = celnav.run(LINE, START, TIMES, z[:, None], push[:, None], engine=engine)
    for column in ("rate", 0):
        table = pd.DataFrame({column: push}, index=np.arange(7)[::-1] + 3)
        seen = pd.DataFrame({"z": z}, index=np.arange(8) + 5)
        seconds = pd.Series(TIMES, index=np.arange(8)[::-1])
        for truth in (None, seen):
            given = celnav.epochs(seconds, seen, table, truth)
            found = celnav.run(LINE, START, given, engine=engine)
            np.testing.assert_array_equal(found.mean, expected.mean)
        assert [e.truth.tolist() for e in given] == z[:, None].tolist()
        columns = celnav.epochs(TIMES, u=(table[column], table))
        assert [e.u[0] for e in columns[1:]] == push.tolist()


def test_a_column_of_measurements_is_made_a_table():
    z = pd.Series(np.zeros(8))
    with pytest.raises(ValueError, match=r"got \(8,\); one component is z.to_frame\(\)$"):
        celnav.epochs(TIMES, z)
    assert celnav.epochs(TIMES, z.to_frame())[3].z.tolist() == [0.0]


def test_a_table_of_words_is_no_input():
    with pytest.raises(ValueError, match=r"^u: expected numbers, got "):
        celnav.epochs(TIMES, u=pd.DataFrame({"gear": ["first"] * 7}))
    with pytest.raises(ValueError, match=r"^z: expected numbers, got "):
        celnav.epochs(TIMES, pd.DataFrame({"z": ["near"] * 8}))


TURN = [0.1, 0.2, 0.3]


def turned(x, epoch):
    return x[..., :1] * epoch.u


def held(x, epoch):
    return x[..., :1] * (0.0 if epoch.u is None else epoch.u)


PLACES = {
    "h": celnav.Sensor(turned, [[1.0]]),
    "h of components": celnav.Sensor(lambda x, e: x[..., :1] + e.u[..., 0], [[1.0]]),
    "h that copies": celnav.Sensor(lambda x, e: x[..., :1] + e.u.copy(), [[1.0]]),
    "R": celnav.Sensor([[1.0]], R=lambda mean, e: [[1.0 + e.u**2]]),
    "matrix": celnav.Sensor(celnav.Linear(lambda e: np.eye(1) * e.u), [[1.0]]),
}


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
@pytest.mark.parametrize("place", PLACES)
def test_a_sensor_that_uses_the_input_has_none_at_the_first_epoch(place, engine):
    """There is no interval before it; the remedies in the message work."""
    motion, times, z = celnav.Motion(lambda x, e: x, [[0.1]]), np.arange(4.0), np.ones((4, 1))
    filter, u = celnav.ukf(motion, PLACES[place]), np.array(TURN)
    u = u[:, None] if place == "h of components" else u
    message = (
        r"^u: expected models that need no input at t = 0.0: there is no interval before the first "
        r"epoch. "
        r"Make its measurement nan, or let the model use a default value if epoch.u is None"
    )
    with pytest.raises(ValueError, match=message) as error:
        celnav.run(filter, START, times, z, u, engine=engine)
    assert error.value.__notes__ == ["in step 0, t = 0.0"]
    with pytest.raises(ValueError, match=message):
        celnav.simulate(motion, PLACES[place], START, times, u=u, runs=2)
    z[0] = np.nan
    late = celnav.run(filter, START, times, z, u, engine="auto")
    assert np.isfinite(late.std).all()
    if place == "h":
        free = celnav.ukf(motion, celnav.Sensor(held, [[1.0]]))
        own = celnav.run(free, START, times, np.ones((4, 1)), u, engine=engine)
        np.testing.assert_allclose(own.mean, late.mean, atol=1e-12)  # 0 x has no information


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
def test_inputs_that_were_forgotten_are_asked_for(engine):
    with pytest.raises(
        ValueError, match=r"^u: expected an input at t = 1.0, where a model uses it"
    ):
        celnav.run(LINE, START, TIMES, np.ones((8, 1)), engine=engine)


def test_another_fault_of_a_model_is_its_own():
    broken = celnav.ukf(celnav.Motion(lambda x, e: x + {}["u"], [[1.0]]))
    with pytest.raises(KeyError, match="u"):
        celnav.run(broken, START, TIMES)
    with pytest.raises(TypeError, match="NoneType"):
        celnav.run(
            celnav.ukf(celnav.Motion(lambda x, e: x + e.about[0], [[1.0]])),
            START,
            TIMES,
            u=TIMES[1:],
        )


@pytest.mark.parametrize("engine", ["numpy", "auto"])
def test_columns_of_a_table_name_the_components(engine):
    """In a diagnosis and a report; with several sensors one after the other."""
    pd = pytest.importorskip("pandas")
    rng = np.random.default_rng(2)
    plane = pd.DataFrame(rng.standard_normal((60, 2)), columns=["east_m", "north_m"])
    height = pd.DataFrame(rng.standard_normal((60, 1)), columns=["up_m"])
    motion = celnav.Motion(0.9 * np.eye(3), 0.1 * np.eye(3))
    sensors = [celnav.Sensor(rows, np.eye(len(rows))) for rows in (np.eye(2, 3), np.eye(3)[2:])]
    prior, times = celnav.Gaussian(np.zeros(3), np.eye(3)), np.arange(60.0)
    track = celnav.run(celnav.ukf(motion, *sensors), prior, times, (plane, height), engine=engine)
    assert track.columns == ("east_m", "north_m", "up_m")
    said = str(celnav.analysis.diagnose.diagnose(track))
    assert all(f"\n{name} " in said for name in track.columns)
    report = str(track.report(np.zeros((60, 3))))
    assert "NIS 0    east_m, north_m" in report
    assert "NIS 1    up_m" in report
    mixed = celnav.run(celnav.ukf(motion, *sensors), prior, times, (plane, height.to_numpy()))
    assert mixed.measured == ["z0", "z1", "z2"]


INPUTS = {
    "none": None,
    "numbers": np.arange(6.0),
    "vectors": np.arange(12.0).reshape(6, 2),
    "a tuple": (np.arange(6.0), np.arange(12.0).reshape(6, 2)),
    "a list": [[1.0, 2.0]] * 6,
}
PARTS = {
    "all": lambda epochs: epochs,
    "the last": lambda epochs: epochs[3:],
    "one": lambda epochs: epochs[2:3],
    "backward": lambda epochs: epochs.backward((np.arange(6.0), (np.ones((6, 2)),))),
    "backward from the middle": lambda epochs: epochs[2:].backward((np.arange(4.0),))[1:],
    "with about": lambda epochs: epochs.with_about(Named(np.arange(7.0), None))[1:],
}


class Named(NamedTuple):
    a: object
    b: object


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("u", INPUTS)
def test_columns_are_those_of_the_epochs_one_by_one(u, part):
    times = np.array([0.0, 1.0, 1.5, 1.5, 3.0, 4.0, 7.0])
    filter = celnav.ekf(celnav.Motion(np.eye(1), 1.0), celnav.Sensor(np.eye(1), 1.0))
    some = PARTS[part](celnav.epochs(times, np.arange(7.0)[:, None], INPUTS[u]))
    found, known = (runs.as_data(filter, each) for each in (some, list(some)))
    assert len(found.k) == len(some)
    for i, epoch in enumerate(some):
        mine, same = (runs.epoch_of(data, i, lambda x, _: x, ()) for data in (found, known))
        assert (mine.k, mine.t, mine.dt) == (same.k, same.t, same.dt) == epoch[:3]
        trees = [tree_leaves((one.u, one.about)) for one in (mine, same, epoch)]
        for parts in zip(*trees, strict=True):
            np.testing.assert_array_equal(*(np.asarray(x) for x, _ in parts[:2]))
            np.testing.assert_array_equal(*(np.asarray(x) for x, _ in parts[1:]))
        assert type(mine.about) is type(epoch.about)


def test_backward_epochs_have_the_intervals_that_led_up_to_them():
    times, u = np.array([0.0, 1.0, 3.0, 6.0]), np.array([10.0, 20.0, 30.0])
    some = celnav.epochs(times, np.zeros((4, 1)), u).backward((np.array([3.0, 2.0, 1.0]),))
    assert [epoch[:5] for epoch in some] == [
        (3, 6.0, 3.0, 30.0, None),
        (2, 3.0, 2.0, 20.0, None),
        (1, 1.0, 1.0, 10.0, None),
    ]
    assert [epoch.about for epoch in some] == [(3.0, None), (2.0, None), (1.0, None)]
