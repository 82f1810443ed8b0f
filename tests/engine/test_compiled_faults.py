"""Models that a recording could misinterpret: each gives numpy's results, or raises an error every
time.
"""

from __future__ import annotations

import functools
import math
import re

import numpy as np
import pytest
from twice import assert_same, twice

import celnav
from celnav.engine.compiled import Compiled
from celnav.tape import llvm
from celnav.tape.tape import CannotCompile

pytestmark = pytest.mark.usefixtures("eager")

RNG = np.random.default_rng(5)
TIMES = np.arange(6.0)
MOTION = celnav.Motion(lambda x, _epoch: 0.9 * x, 0.05 * np.eye(2))
PRIOR = celnav.Gaussian([0.2, 0.4], 0.3 * np.eye(2))
Z = RNG.standard_normal((6, 4, 2))
R = 0.5 * np.eye(2)

SEEN = {
    "truth values add up to truth": lambda x, _epoch: x * ((x > 0.0) + (x > 0.5)) * 1.0,
    "any over one component": lambda x, _epoch: (
        x * np.where(x[..., :1].any(-1), 1.0, 2.0)[..., None]
    ),
    "whole numbers are truncated": lambda x, _epoch: (2.0 * x).astype(int) * 0.5,
    "as truth values": lambda x, _epoch: np.where(x.astype(bool) & (x > 0.0), x, 0.5 * x),
    "a choice by time": lambda x, epoch: x * np.where(epoch.t > 2, 1.0, 0.5),
    "a large angle": lambda x, epoch: x + np.where(np.cos(7e8 * (epoch.t + 3.0)) > 0.0, 1.0, -1.0),
    "sign": lambda x, _epoch: x + np.sign(x),
    "floor division": lambda x, _epoch: x + 0.1 * (x // 0.3),
}


@pytest.mark.parametrize("name", SEEN)
def test_what_numpy_means_is_recorded(name):
    assert_same(*twice(celnav.ukf(MOTION, celnav.Sensor(SEEN[name], R)), PRIOR, TIMES, Z))


@pytest.mark.parametrize(
    "h", [lambda x, _e: (x > -9.0) * np.log(x + 1.0), lambda x, _e: x + np.sign(np.sqrt(x + 0.8))]
)
def test_nan_loses_a_run_though_a_choice_follows(h):
    prior = celnav.Gaussian([[0.2, 0.4], [0.1, 0.3], [-0.9, 0.3], [0.3, 0.3]], 1e-3 * np.eye(2))
    with np.errstate(invalid="ignore"):
        known, found = twice(
            celnav.ukf(MOTION, celnav.Sensor(h, R)), prior, TIMES, Z, on_failure="flag"
        )
    assert (known.failed_at >= 0).any()
    np.testing.assert_array_equal(found.failed_at, known.failed_at)


def test_a_noise_of_one_component_may_be_a_function():
    sensor = celnav.Sensor(
        lambda x, _epoch: x[..., :1],
        R=lambda _mean, epoch: np.array([[0.05]]) * (1.0 + 0.1 * epoch.k),
    )
    assert_same(*twice(celnav.ukf(MOTION, sensor), PRIOR, TIMES, Z[..., :1]))


def test_a_model_that_looks_at_its_argument_is_refused_every_time():
    filter = celnav.ukf(
        MOTION, celnav.Sensor(lambda x, _epoch: x * (1.0 if x.dtype == object else 2.0), R)
    )
    kept = celnav.compiled(filter)
    for _ in range(2):
        with pytest.raises(CannotCompile, match="the model gives other values when it is recorded"):
            celnav.run(filter, PRIOR, TIMES, Z, engine="compiled")
        with pytest.raises(CannotCompile, match="the model gives other values when it is recorded"):
            kept.run(PRIOR, TIMES, Z)
        track = celnav.run(filter, PRIOR, TIMES, Z, engine="auto")
        assert track.engine.startswith(
            "numpy: the model gives other values when it is recorded (step 0: another mean): "
            "it depends on more than the numbers that it is given; engine='numpy' runs it as it is"
        )


@pytest.mark.parametrize(
    ("h", "told"),
    [
        (
            lambda x, _epoch: x.astype(np.float32) * 1.0,
            "numbers are recorded as float64, not as float32",
        ),
        (lambda x, _epoch: x if x.dtype == np.float64 else 1 / 0, "ZeroDivisionError"),
    ],
)
def test_other_refusals_let_numpy_go_on(h, told):
    filter = celnav.ukf(MOTION, celnav.Sensor(h, R))
    with pytest.raises(CannotCompile, match=rf"{told}.*test_compiled_faults.py, line \d+"):
        celnav.run(filter, PRIOR, TIMES, Z, engine="compiled")


def test_inputs_of_all_runs_and_of_each():
    motion = celnav.Motion(
        lambda x, e: 0.9 * x + (0.0 if e.u is None else 0.1 * e.u[..., :2]), 0.05 * np.eye(2)
    )
    filter = celnav.ukf(motion, celnav.Sensor(np.eye(2), R))
    shared, own = (
        RNG.standard_normal((5, 4)),
        RNG.standard_normal((5, 4, 2)),
    )  # four numbers, and four runs
    for u in (shared, own):
        assert_same(*twice(filter, PRIOR, TIMES, Z, u))
    listed = [
        celnav.Epoch(k, float(k), float(k > 0), [0.1, 0.2] if k else None, Z[k]) for k in range(6)
    ]
    assert_same(
        *twice(
            celnav.ukf(
                celnav.Motion(lambda x, e: x + (0.0 if e.u is None else np.array(e.u)), R),
                *filter.sensors,
            ),
            PRIOR,
            listed,
        )
    )


def test_what_is_kept_is_that_of_numpy():
    filter = celnav.ukf(MOTION, celnav.Sensor(np.eye(2), R))
    for keep in ("nothing", "cov"):
        known, found = twice(filter, PRIOR, TIMES, Z, keep=keep, every=2)
        assert_same(known, found)
        assert [(e.k, e.t, e.dt) for e in known.epochs] == [(e.k, e.t, e.dt) for e in found.epochs]


@pytest.mark.parametrize("make", [celnav.ukf, celnav.ekf])
def test_what_was_compiled_once_is_not_compiled_again(make, monkeypatch):
    filter = make(MOTION, celnav.Sensor(lambda x, _epoch: np.sin(x), R))
    first = celnav.run(filter, PRIOR, TIMES, Z, engine="compiled")
    monkeypatch.setattr(llvm, "source", lambda *_: pytest.fail("compiled again"))
    np.testing.assert_array_equal(
        celnav.run(filter, PRIOR, TIMES, Z, engine="compiled").mean, first.mean
    )


@pytest.mark.parametrize("r", [1e-2, 1e-5, 1e-8])
def test_a_combination_known_exactly_stays_known(r, monkeypatch):
    """In covariance form, by machine code alone: numpy repeats no run."""
    a = np.random.default_rng(1).normal(size=(40, 3))
    filter = celnav.ukf(
        celnav.Motion(np.eye(3), np.zeros((3, 3))),
        celnav.Sensor([[1.0, 0.5, -0.3]], [[r]]),
        form="covariance",
    )
    given = (
        celnav.Gaussian(np.zeros((40, 3)), a[:, :, None] * a[:, None, :]),
        np.arange(30.0),
        np.ones((30, 40, 1)),
    )
    known = celnav.run(filter, *given, keep="cov")
    monkeypatch.setattr(Compiled, "_rerun_failed", lambda *_, **__: pytest.fail("a run is lost"))
    found = celnav.run(filter, *given, keep="cov", engine="compiled")
    np.testing.assert_allclose(found.mean, known.mean, atol=1e-6)
    np.testing.assert_allclose(found.std, known.std, atol=1e-6)


# -- what the first epochs do not show -------------------------------------------------------------
LATER = np.arange(60.0)
MANY = RNG.standard_normal((60, 4, 2))
BURNS, TABLE = {50: 1.0}, np.arange(60.0)


@functools.cache
def burn(k):
    return float(k == 50)


NUMPYS = {
    "a quotient": lambda x, e: x + np.floor(e.t / 49.0 * 7.0),
    "a fused product": lambda x, e: x + np.floor(e.t * 0.3 - 3.0),
    "floor division": lambda x, e: x + 0.1 * (e.t // 0.1),
    "a remainder": lambda x, e: x + 10.0 * (e.t % 0.1),
    "divmod": lambda x, e: x + sum(divmod(e.t, 0.7)),
    "fmod": lambda x, e: x + np.fmod(e.t, 0.7),
    "every seventh": lambda x, e: x + np.where(e.k % 7 == 0, 1.0, 0.0),
    "rounded": lambda x, e: x + round(0.5 * e.t) + math.floor(e.t / 3.0),
    "logarithms": lambda x, e: (
        x + np.floor(np.log2(e.k + 1.0)) + np.floor(np.log10(10.0 * e.k + 10.0))
    ),
    "powers": lambda x, e: x + 2.0**e.k % 3.0,
    "lengths": lambda x, e: x + np.floor(np.hypot(3.0 * e.k, 4.0 * e.k)),
    "short lengths": lambda x, e: x + 1e200 * np.hypot(1e-200 * (e.t + 1.0), 0.0),
    "a table": lambda x, e: x + np.interp(e.t, TABLE, np.sin(TABLE)),
    "cases": lambda x, e: x + np.select([e.t < 10.0, e.t < 20.0], [1.0, 2.0], 3.0),
    "no arc": lambda x, _e: x + np.where(np.isnan(np.arccos(0.5 * x)), 1.0, 2.0),
    "no logarithm": lambda x, _e: x + np.where(np.log(x) != np.log(x), 1.0, 2.0),
    "no quotient": lambda x, e: x + np.where(np.isnan((x - x) / (e.t - 50.0)), 1.0, 2.0),
    "zero times nothing": lambda x, _e: x + np.where(np.isnan(0.0 * np.log(x)), 1.0, 0.0),
    "the larger of nothing": lambda x, _e: x + np.where(np.maximum(x, np.log(x)) > 0.0, 1.0, 0.0),
    "the cut of angles": lambda x, e: x + np.arctan2(0.0 - np.floor(e.t / 30.0), -1.0),
    "the sign of zero": lambda x, e: x + np.arctan2(-0.0 * e.t + 0.0, -1.0),
    "counts of truth": lambda x, _e: x * ((x > 0.0) * 1.0 + (x > 0.5) * 1.0),
    "running counts": lambda x, _e: x + np.cumsum(x > 0.0, -1),
    "a system": lambda x, e: (
        x + np.linalg.solve(np.eye(2)[::-1] * (1.0 + e.t), np.array([1.0, 2.0]))
    ),
    "the middle": lambda x, _e: x + np.median(x, -1, keepdims=True) + np.sort(x, -1),
}
LOOKED_UP = (
    "is looked up in a dict, a set or a cache; put the table into u, or choose by numpy.where"
)
WRITTEN = "a number that is known only when the filter runs is written as text or bytes"
INDEX = "is asked for as an index or a whole number; put the table into u"
REFUSED = {
    "get": (lambda x, e: x + BURNS.get(e.k, 0.0), LOOKED_UP),
    "member": (lambda x, e: x + (1.0 if e.k in {50} else 0.0), LOOKED_UP),
    "cached": (lambda x, e: x + burn(e.k), LOOKED_UP),
    "text": (lambda x, e: x + (1.0 if str(e.k) == "50" else 0.0), WRITTEN),
    "formatted": (lambda x, e: x + (1.0 if f"{e.t:.0f}" == "50" else 0.0), WRITTEN),
    "listed": (lambda x, e: x + TABLE.tolist()[e.k], INDEX),
    "taken": (lambda x, e: x + np.take(TABLE, e.k), INDEX),
    "one of": (lambda x, e: x + (1.0 if e.k in [50] else 0.0), "a branch depends on a number"),
    "equal": (lambda x, e: x + np.array_equal(e.t, 50.0), r"numpy\.array_equal cannot be recorded"),
    "bits": (lambda x, e: x + (e.k & 1), "bitwise operations on integers are not recorded"),
    "two truths": (
        lambda x, e: x + ((e.t > 3) + (e.t > 4)),
        "another number in Python than in numpy",
    ),
    "by pieces": (
        lambda x, _e: np.piecewise(x, [x < 0.0], [lambda v: -v, lambda v: v]),
        r"numpy\.piecewise cannot be recorded; numpy\.where and arithmetic can",
    ),
}


JUMPING = ("zero times nothing", "counts of truth", "the middle")
"""Models that depend on the state: across a discontinuity numpy's numerical derivative differs."""


@pytest.mark.parametrize(
    ("name", "make"),
    [(name, celnav.ukf) for name in NUMPYS]
    + [(name, celnav.ekf) for name in NUMPYS if name not in JUMPING],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_model_has_the_values_of_numpy_in_every_epoch(name, make):
    filter = make(MOTION, celnav.Sensor(NUMPYS[name], R))
    assert_same(*twice(filter, PRIOR, LATER, MANY))


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_first_epochs_do_not_show_is_refused(name):
    model, why = REFUSED[name]
    filter = celnav.ukf(MOTION, celnav.Sensor(model, R))
    with pytest.raises(CannotCompile) as caught:
        celnav.run(filter, PRIOR, LATER, MANY, engine="compiled")
    told, _, place = str(caught.value).partition(" (test_compiled_faults.py, line ")
    assert re.search(why, told)
    assert place


def test_what_fails_only_where_a_step_is_recorded_is_told_with_its_place():
    """The line of the model if the model fails, else the expected form."""

    def failing(x, _e):
        if x.dtype == object:
            raise ValueError("expected floats")
        return x

    def narrow(x, _e):
        return x[..., :1] if x.dtype == object else x

    for h, told in (
        (
            failing,
            r"^ValueError where a step .*numpy' \(test_compiled_faults\.py, line \d+: raise ",
        ),
        (narrow, r"^h returned shape \(5, 1\), expected \(5, 2\); points are "),
    ):
        with pytest.raises(CannotCompile, match=told):
            celnav.run(celnav.ukf(MOTION, celnav.Sensor(h, R)), PRIOR, TIMES, Z, engine="compiled")


def test_inputs_may_be_missing_also_in_a_later_run():
    def motion(x, e):
        return 0.9 * x + (0.0 if e.u is None else np.where(np.isnan(e.u), 0.5, 0.0))

    filter = celnav.ukf(celnav.Motion(motion, 0.05 * np.eye(2)), celnav.Sensor(np.eye(2), R))
    kept, complete = celnav.compiled(filter), RNG.standard_normal((59, 2))
    gaps = np.where(np.arange(59)[:, None] % 20 == 13, np.nan, complete)
    for u in (complete, gaps):
        known = celnav.run(filter, PRIOR, LATER, MANY, u)
        assert_same(known, kept.run(PRIOR, LATER, MANY, u))
        assert_same(known, celnav.run(filter, PRIOR, LATER, MANY, u, engine="compiled"))


def test_a_zero_times_an_input_that_is_missing_is_missing():
    def motion(x, e):
        return 0.9 * x + (0.0 if e.u is None else np.where(np.isnan(0.0 * e.u), 0.5, 0.0))

    filter = celnav.ukf(celnav.Motion(motion, 0.05 * np.eye(2)), celnav.Sensor(np.eye(2), R))
    u = np.where(np.arange(59)[:, None] % 20 == 13, np.nan, np.ones((59, 2)))
    assert_same(*twice(filter, PRIOR, LATER, MANY, u))


def test_a_noise_of_each_run_in_a_function_is_refused_with_the_cure():
    each = np.stack([0.1 * (i + 1.0) * np.eye(2) for i in range(4)])
    for filter, name in (
        (
            celnav.ukf(celnav.Motion(np.eye(2), lambda _m, _e: each), celnav.Sensor(np.eye(2), R)),
            "Q",
        ),
        (celnav.ukf(MOTION, celnav.Sensor(np.eye(2), lambda _m, _e: each)), "R"),
    ):
        with pytest.raises(
            CannotCompile, match=f"^{name}: a function that gives a matrix for each"
        ):
            celnav.run(filter, PRIOR, TIMES, Z, engine="compiled")


def test_measurements_that_are_complete_cost_no_masks_whatever_the_model():
    """The prediction is not checked: a run whose model returns nan fails, and numpy repeats it."""
    counts = {}
    for gap in (0.0, np.nan):
        z = MANY[:6].copy()
        z[2, 1, 0] += gap
        sensor = celnav.Sensor(lambda x, _e: np.sqrt(x * x + 1.0) / np.log(x * x + 2.0), R)
        kept = celnav.compiled(celnav.ukf(MOTION, sensor))
        kept.run(PRIOR, TIMES, z)
        counts[gap == 0.0] = [
            sum(op[0] == "eq" and op[1] == op[2] for op in made.kernel.tape.ops)
            for made in kept._cache.records.values()
        ]
    assert max(counts[True]) == 0
    assert max(counts[False]) > 0
