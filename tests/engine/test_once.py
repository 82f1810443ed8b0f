"""Machine code computes once per epoch what all runs have in common, and its results equal numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from twice import assert_same, twice

import celnav
from celnav.engine import runs
from celnav.filters.adaptive import chi_square_gate

pytest.importorskip("llvmlite")
pytestmark = pytest.mark.usefixtures("eager")

RNG = np.random.default_rng(3)
T, RUNS, N, M = 30, 21, 4, 3
TIMES = np.arange(float(T))
F = RNG.standard_normal((N, N)) / np.sqrt(N)
H = RNG.standard_normal((M, N))
Q, R = 0.1 * np.diag([1.0, 0.5, 2.0, 0.3]), np.diag([0.5, 1.0, 0.2])
MEAN = RNG.standard_normal((RUNS, N))
PRIOR = celnav.Gaussian(MEAN, np.diag([2.0, 1.0, 0.5, 1.0]))
MOTION, SENSOR = celnav.Motion(F, Q), celnav.Sensor(H, R)
BIAS = celnav.Gaussian(np.zeros(2), np.diag([4.0, 1.0]))
MODELS = celnav.Motion(celnav.Linear(lambda e: F * (1.0 + 0.01 * e.t)), Q), SENSOR
FILTERS = {
    "ekf": celnav.ekf(MOTION, SENSOR),
    "covariance": celnav.ekf(MOTION, SENSOR, form="covariance"),
    "ukf": celnav.ukf(MOTION, SENSOR),
    "of time": celnav.ekf(*MODELS),
    "two sensors": celnav.ekf(MOTION, SENSOR, celnav.Sensor(H[:1], R[:1, :1])),
    "colored": celnav.colored(MOTION, SENSOR, Phi=0.5 * np.eye(M)),
    "two stages": celnav.two_stage(*MODELS, RNG.standard_normal((M, 2)), BIAS),
}


@pytest.fixture
def parts(monkeypatch):
    """Whether each run had a part for all runs together."""
    seen = list[bool]()
    schedule = runs._schedule

    def noted(*arguments):
        plan, fresh = schedule(*arguments)
        seen.append(any(one.once is not None for one in plan.code))
        return plan, fresh

    monkeypatch.setattr(runs, "_schedule", noted)
    return seen


def measured(name="", missing=()):
    z = np.random.default_rng(1).standard_normal((T, RUNS, M))
    for at in missing:
        z[at] = np.nan
    return (z, z[..., :1]) if name == "two sensors" else z


@pytest.mark.parametrize("keep", ["std", "cov"])
@pytest.mark.parametrize("name", FILTERS)
def test_one_covariance_of_all_runs(name, keep, parts):
    known, found = twice(FILTERS[name], PRIOR, TIMES, measured(name), keep=keep)
    assert_same(known, found)
    assert parts[0]


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize(
    "missing",
    [[(7,)], [(7, 3, 1)], [(0, 3)], [(slice(5, 9),), (12, slice(None), 1), (T - 1, 2)]],
    ids=["one epoch", "one component of one run", "one run at first", "all sorts"],
)
def test_with_measurements_missing(name, missing):
    assert_same(*twice(FILTERS[name], PRIOR, TIMES, measured(name, missing)))


def test_runs_that_miss_the_same_epoch_still_have_one_covariance(parts):
    twice(FILTERS["ekf"], PRIOR, TIMES, measured(missing=[(7,)]))
    twice(FILTERS["ekf"], PRIOR, TIMES, measured(missing=[(7, 3)]))
    assert parts == [True, False]


@pytest.mark.parametrize("jobs", [1, 3])
def test_bytes_do_not_depend_on_jobs_or_on_neighbors(jobs):
    whole = celnav.compiled(FILTERS["of time"], jobs=jobs).run(PRIOR, TIMES, measured())
    some = celnav.Gaussian(MEAN[5:8], PRIOR.cov)
    part = celnav.compiled(FILTERS["of time"]).run(some, TIMES, measured()[:, 5:8])
    for name in ("mean", "std", "whitened"):
        np.testing.assert_array_equal(getattr(whole, name)[:, 5:8], getattr(part, name))


def test_a_covariance_of_each_run_is_of_each_run(parts):
    own = celnav.Gaussian(MEAN, PRIOR.cov * np.linspace(0.5, 2.0, RUNS)[:, None, None])
    assert_same(*twice(FILTERS["ekf"], own, TIMES, measured()))
    assert parts == [False]


def test_a_gate_gives_runs_covariances_of_their_own(parts):
    filter = celnav.ekf(MOTION, SENSOR, hooks=[chi_square_gate(0.9)])
    assert_same(*twice(filter, PRIOR, TIMES, measured()))
    assert parts == [False]


def test_what_a_model_makes_of_time_is_made_once(parts):
    """The direction of a star as a series of sines is common to all runs; the covariance differs
    between runs.
    """

    def h(x, epoch):
        phase = sum(np.sin(k * epoch.t + k) / k for k in range(1, 30))
        return np.hypot(x[..., 0] - phase, x[..., 1] + phase)[..., None]

    filter = celnav.ukf(MOTION, celnav.Sensor(h, R[:1, :1]))
    assert_same(*twice(filter, PRIOR, TIMES, measured()[..., :1]))
    assert parts == [True]


def test_small_parts_stay_where_they_are(parts):
    filter = celnav.ukf(celnav.Motion(lambda x, e: np.sin(x) * np.cos(e.t), Q), SENSOR)
    assert_same(*twice(filter, PRIOR, TIMES, measured()))
    assert parts == [False]


def test_a_run_that_is_lost_takes_no_other_along():
    mean = MEAN.copy()
    mean[4] = 1e308
    with np.errstate(all="ignore"):
        known, found = twice(FILTERS["ekf"], celnav.Gaussian(mean, PRIOR.cov), TIMES, measured())
    np.testing.assert_array_equal(found.failed_at, known.failed_at)
    for name in ("mean", "std", "whitened"):
        mine, theirs = (np.delete(getattr(track, name), 4, 1) for track in (found, known))
        np.testing.assert_allclose(mine, theirs, rtol=1e-10, atol=1e-12)
    assert known.failed_at[4] >= 0
    assert (np.delete(known.failed_at, 4) < 0).all()


def test_results_that_would_fill_the_memory_are_not_kept(parts, monkeypatch):
    monkeypatch.setattr(runs, "MOST_COMMON", 10)
    found = celnav.compiled(FILTERS["ekf"]).run(PRIOR, TIMES, measured())
    assert_same(celnav.run(FILTERS["ekf"], PRIOR, TIMES, measured(), engine="numpy"), found)
    assert parts == [False]


def test_a_kept_filter_is_split_once(monkeypatch):
    kept = celnav.compiled(FILTERS["ekf"])
    kept.run(PRIOR, TIMES, measured())
    monkeypatch.setattr(runs, "_common_entries", None)
    kept.run(PRIOR, TIMES, measured())


def test_axes_of_runs_are_several():
    prior = celnav.Gaussian(MEAN.reshape(3, 7, N), PRIOR.cov)
    assert_same(*twice(FILTERS["ekf"], prior, TIMES, measured().reshape(T, 3, 7, M)))
