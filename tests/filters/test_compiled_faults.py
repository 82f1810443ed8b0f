"""Models that a recording could take for something else: each flies as under numpy, or is refused every time."""

from __future__ import annotations

import numpy as np
import pytest
from twice import assert_same, twice

import celnav
from celnav.filters.compiled import Compiled
from celnav.tape import llvm
from celnav.tape.tape import CannotCompile

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
        assert (
            track.engine
            == "numpy: the model gives other values when it is recorded (step 0: another mean): "
            "it depends on more than the numbers that it is given"
        )


@pytest.mark.parametrize(
    ("h", "told"),
    [
        (
            lambda x, _epoch: x.astype(np.float32) * 1.0,
            "numbers are recorded as float64, not as float32",
        ),
        (lambda x, _epoch: x if x.dtype == np.float64 else 1 / 0, "division by zero"),
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
    """In covariance form, by machine code itself: numpy flies no run again."""
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
    monkeypatch.setattr(Compiled, "_again", lambda *_, **__: pytest.fail("a run is lost"))
    found = celnav.run(filter, *given, keep="cov", engine="compiled")
    np.testing.assert_allclose(found.mean, known.mean, atol=1e-6)
    np.testing.assert_allclose(found.std, known.std, atol=1e-6)
