"""Runs of compiled filters: gaps, failed runs, shapes, stored rows, reproducible bytes, and models
that cannot be compiled.
"""

from __future__ import annotations

import inspect
import math
import pickle
import re
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from twice import FIELDS, assert_same, told, twice

import celnav
from celnav.engine.recording import map_run_constants
from celnav.filters.adaptive import gate, huber, innovation_window
from celnav.filters.records import FromFunctions, Info, State
from celnav.filters.switching import Fallback
from celnav.gaussian.linalg import Covariance, SquareRoot
from celnav.tape.tape import CannotCompile

pytestmark = pytest.mark.usefixtures("eager")

pytest.importorskip("llvmlite")

EYE, TIMES = np.eye(2), np.arange(6.0)
RNG = np.random.default_rng(5)
PRIOR = celnav.Gaussian([1.0, 0.5], 0.3 * EYE)
Z = RNG.standard_normal((6, 4, 2)) + 1.0


def bend(x, _epoch):
    return 0.8 * x + 0.3 * np.cos(2.0 * x[..., ::-1])


def cubic(x, _epoch):
    return x + 0.05 * x**3


def total(x, _epoch):
    return np.sqrt(1.0 + np.square(x).sum(-1, keepdims=True))


MOTION, SENSOR, OTHER = (
    celnav.Motion(bend, 0.01 * EYE),
    celnav.Sensor(cubic, 0.05 * EYE),
    celnav.Sensor(total, [[0.1]]),
)
FILTER = celnav.ukf(MOTION, SENSOR)


# -- gaps ------------------------------------------------------------------------------------------
GAPPED = {
    "plain": FILTER,
    "covariance": celnav.ukf(MOTION, SENSOR, form="covariance"),
    "window": celnav.ukf(MOTION, SENSOR, hooks=[innovation_window(2)]),
    "window skip": celnav.ukf(MOTION, SENSOR, hooks=[innovation_window(2, "skip")]),
    "colored": celnav.colored(MOTION, SENSOR, np.diag([0.9, 0.5])),
    "decorrelated": celnav.decorrelated(
        MOTION, celnav.Sensor(EYE, 0.05 * EYE), np.diag([0.9, 0.5])
    ),
}


@pytest.mark.parametrize("name", GAPPED)
@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    missing=arrays(bool, Z.shape, elements=st.booleans()),
    silent=arrays(bool, 6, elements=st.booleans()),
)
def test_any_components_may_be_missing(name, missing, silent):
    assert_same(
        *twice(
            GAPPED[name],
            PRIOR,
            TIMES,
            np.where(missing | silent[:, None, None], np.nan, Z),
            keep="cov",
        )
    )


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    missing=arrays(bool, (6, 4, 2), elements=st.booleans()),
    other=arrays(bool, (6, 4, 1), elements=st.booleans()),
    none=arrays(bool, (6, 2), elements=st.booleans()),
)
def test_any_sensor_may_be_missing(missing, other, none):
    parts = np.where(missing, np.nan, Z), np.where(other, np.nan, np.abs(Z[..., :1]) + 1.0)
    there = [
        tuple(None if gone else part[k] for gone, part in zip(none[k], parts)) for k in range(6)
    ]
    epochs = [celnav.Epoch(k, float(k), float(k > 0), None, z) for k, z in enumerate(there)]
    assert_same(*twice(celnav.ukf(MOTION, SENSOR, OTHER), PRIOR, epochs))


# -- shapes ----------------------------------------------------------------------------------------
def many(*batch):
    return celnav.Gaussian(
        np.linspace(-1.0, 1.0, 2 * math.prod(batch)).reshape(*batch, 2), 0.3 * EYE
    )


BATCHES = {
    "one run": (PRIOR, Z[:, 0]),
    "runs of z": (PRIOR, Z),
    "runs of the prior": (many(4), Z[:, 0]),
    "runs of both": (many(4), Z),
    "covariances of runs": (
        celnav.Gaussian([1.0, 0.5], EYE * np.linspace(0.1, 0.5, 4)[:, None, None]),
        Z,
    ),
    "one run of a batch": (many(1), Z[:, :1]),
    "nine runs": (many(9), Z[:, 1]),
    "two axes": (many(2, 3), RNG.standard_normal((6, 2, 3, 2))),
    "axes that meet": (many(3, 1), Z[:, None]),
    "no measurement": (many(3), None),
}


@pytest.mark.parametrize("name", BATCHES)
@pytest.mark.parametrize("keep", ["std", "cov", "mean"])
def test_batches_and_what_is_kept(name, keep):
    for every in (1, 2, 4, 100):
        assert_same(
            *twice(FILTER, BATCHES[name][0], TIMES, BATCHES[name][1], keep=keep, every=every)
        )


@pytest.mark.parametrize(
    "epochs",
    [
        celnav.epochs([0.0], Z[:1]),
        celnav.epochs(TIMES, Z)[2:],
        celnav.epochs(TIMES, Z)[::2],
        [celnav.Epoch(10 + k, 5.0 + k, 1.0, None, z) for k, z in enumerate(Z)],
        [celnav.Epoch(k, 0.0, 0.0, None, z) for k, z in enumerate(Z)],
        celnav.epochs(np.cumsum([1.0, 0.3, 0.3, 2.0, 0.1, 0.7]), Z),
        [
            celnav.Epoch(0, 0.0, 0.0, None, None),
            celnav.Epoch(1, 1.0, 1.0, None, None),
            celnav.Epoch(2, 2.0, 1.0, None, Z[0]),
        ],
    ],
    ids=["one", "the end", "every second", "from a later one", "no interval", "irregular", "late"],
)
def test_epochs_of_all_kinds(epochs):
    motion = celnav.Motion(
        lambda x, epoch: x * np.exp(-0.1 * epoch.dt) + 0.01 * np.sin(epoch.t) + 0.001 * epoch.k,
        0.01 * EYE,
    )
    known, found = twice(celnav.ukf(motion, SENSOR), PRIOR, epochs, keep="cov")
    assert_same(known, found)
    assert tuple(found.epochs) == known.epochs


def test_a_stream_of_epochs():
    known = celnav.run(FILTER, PRIOR, TIMES, Z)
    assert_same(known, celnav.run(FILTER, PRIOR, iter(celnav.epochs(TIMES, Z)), engine="compiled"))


INPUTS = {
    "a number": RNG.standard_normal(5),
    "shared": RNG.standard_normal((5, 2)),
    "of each run": RNG.standard_normal((5, 4, 2)),
    "a matrix": RNG.standard_normal((5, 3, 2)),
}


@pytest.mark.parametrize("name", INPUTS)
def test_inputs(name):
    def driven(x, epoch):
        u = epoch.u if name != "a matrix" else epoch.u.sum(0)
        return bend(x, epoch) + 0.1 * u

    assert_same(
        *twice(celnav.ukf(celnav.Motion(driven, 0.01 * EYE), SENSOR), PRIOR, TIMES, Z, INPUTS[name])
    )


def test_inputs_that_come_and_go():
    def driven(x, epoch):
        return bend(x, epoch) if epoch.u is None else bend(x, epoch) + 0.1 * epoch.u[0] + epoch.u[1]

    u = [None, None, (np.ones(2), 0.1), (np.zeros(2), 0.2), None, (-np.ones(2), 0.0)]
    epochs = [celnav.Epoch(k, float(k), float(k > 0), one, Z[k]) for k, one in enumerate(u)]
    assert_same(*twice(celnav.ukf(celnav.Motion(driven, 0.01 * EYE), SENSOR), PRIOR, epochs))


def test_a_compiled_track_can_be_smoothed_and_sent_away():
    known, found = twice(FILTER, PRIOR, TIMES, Z, keep="cov")
    np.testing.assert_allclose(celnav.smooth(found).mean, celnav.smooth(known).mean, rtol=1e-9)
    assert_same(known, pickle.loads(pickle.dumps(found)))


def test_what_is_compiled_runs_again_with_other_data():
    flown = celnav.compiled(FILTER)
    for z, prior in (
        (Z, PRIOR),
        (Z[:3], many(4)),
        (np.where(Z > 1.0, np.nan, Z), PRIOR),
        (Z[:, 0], PRIOR),
    ):
        for keep in ("std", "cov"):
            assert_same(
                celnav.run(FILTER, prior, TIMES[: len(z)], z, keep=keep),
                flown.run(prior, TIMES[: len(z)], z, keep=keep),
            )


# -- bytes -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("gaps", [False, True])
def test_the_bytes_do_not_depend_on_threads_or_company(gaps):
    z, prior = RNG.standard_normal((6, 37, 2)), many(37)
    if gaps:
        z[RNG.random(z.shape) < 0.3] = np.nan
        z[np.isnan(z).all(-1)] = 0.5  # a single run without a measurement is a different case
    filter = celnav.ukf(
        celnav.Motion(
            lambda x, e: bend(x, e) / np.hypot(x, 3.0) + np.exp(-np.square(x)), 0.01 * EYE
        ),
        SENSOR,
    )

    def fly(runs, **options):
        return celnav.run(
            filter,
            celnav.Gaussian(prior.mean[runs], prior.cov),
            TIMES,
            z[:, runs],
            engine="compiled",
            **options,
        )

    whole = fly(slice(None))
    for jobs in (2, 3, 64):
        assert content(fly(slice(None), jobs=jobs)) == content(whole)
    for runs in (0, 36, slice(3, 4), slice(5, 16), slice(36, None, -1)):
        assert content(fly(runs)) == content(whole, runs)


def content(track, runs=slice(None)):
    """The bytes of a track for some of its runs; a single run equals a run in a batch."""
    found = {}
    for name in FIELDS[1:]:
        x = getattr(track, name)
        over_time = name not in ("log_likelihood", "failed_at")
        if track.failed_at.ndim:
            x = x[:, runs] if over_time else x[runs]
        found[name] = np.ascontiguousarray(x).tobytes()
    return found


# -- lost runs -------------------------------------------------------------------------------------
def explode(x, _epoch):
    return np.where(x[..., :1] > 2.5, np.nan, 1.3) * x


def logarithm(x, _epoch):
    return np.log(3.0 - x)


GROWING = celnav.Gaussian(np.linspace(-1.0, 2.0, 6)[:, None] * np.ones(2), 0.01 * EYE)
SEEN = np.linspace(-1.0, 2.0, 6)[:, None] * np.ones(2) * 1.3 ** np.arange(6)[:, None, None]
EXPLODING, LINEAR = celnav.Motion(explode, 0.001 * EYE), celnav.Sensor(EYE, 0.01 * EYE)
LOST = {
    f"{name}, {form}": make(form)
    for form in ("square root", "covariance")
    for name, make in {
        "motion": lambda form: celnav.ukf(EXPLODING, LINEAR, form=form),
        "slope": lambda form: celnav.ekf(EXPLODING, LINEAR, form=form),
        "sensor": lambda form: celnav.ukf(
            celnav.Motion(1.3 * EYE, 0.001 * EYE), celnav.Sensor(logarithm, 0.05 * EYE), form=form
        ),
        "colored": lambda form: celnav.colored(EXPLODING, LINEAR, 0.5 * EYE, form=form),
        "augmented": lambda form: celnav.augmented(EXPLODING, LINEAR, 0.5 * EYE, form=form),
        "twice the same": lambda form: celnav.ukf(
            celnav.Motion(EYE, 0.0 * EYE),
            celnav.Sensor([[1.0, 0.0], [1.0, 0.0]], 0.0 * EYE),
            form=form,
        ),
        "two stages": lambda form: celnav.two_stage(
            EXPLODING, LINEAR, EYE, celnav.Gaussian(np.zeros(2), EYE), form=form
        ),
    }.items()
}


@pytest.mark.parametrize("name", LOST)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_lost_runs_are_those_of_numpy(name):
    filter, z = LOST[name], logarithm(np.minimum(SEEN, 2.9), None) if "sensor" in name else SEEN
    known, found = twice(filter, GROWING, TIMES, z, keep="cov")
    assert (known.failed_at >= 0).any()
    assert_same(known, found)
    errors = [
        told(celnav.run, filter, GROWING, TIMES, z, engine=engine)
        for engine in ("numpy", "compiled", "auto")
    ]
    assert errors[0].startswith("FilterError: step ")
    assert errors[0] == errors[1] == errors[2]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_lost_run_alone_and_in_two_axes():
    filter = celnav.ukf(EXPLODING, LINEAR)
    for shape in ((), (2, 3), (6, 1)):
        batch = slice(None) if shape else 5
        prior = celnav.Gaussian(GROWING.mean[batch].reshape(*shape, 2), GROWING.cov)
        z = SEEN[:, batch].reshape(6, *shape, 2)
        for keep in ("std", "cov", "mean"):
            for every in (1, 2):
                assert_same(*twice(filter, prior, TIMES, z, keep=keep, every=every))
        errors = [
            told(celnav.run, filter, prior, TIMES, z, engine=engine)
            for engine in ("numpy", "compiled")
        ]
        assert errors[0].startswith("FilterError: step ")
        assert errors[0] == errors[1]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("form", ["square root", "covariance"])
def test_negative_weights_that_lose_runs(form):
    """And a second filter with which they do not fail."""
    motion = celnav.Motion(lambda x, _epoch: 0.8 * x + 0.6 * np.cos(2.0 * x), 0.01 * EYE)
    sensor = celnav.Sensor(lambda x, _epoch: x**2, 0.05 * EYE)
    filter = celnav.ukf(motion, sensor, kappa=-1.5, form=form)
    prior, z = (
        celnav.Gaussian(np.linspace(-1.0, 2.0, 6)[:, None] * np.ones(2), 0.3 * EYE),
        RNG.random((6, 6, 2)) + 0.5,
    )
    known, found = twice(filter, prior, TIMES, z, keep="cov")
    assert (known.failed_at >= 0).any()
    assert_same(known, found)
    saved = Fallback(filter, celnav.ckf(motion, sensor, form=form))
    known, found = twice(saved, prior, TIMES, z, keep="cov")
    assert known.events["redone"].any()
    assert not (known.failed_at >= 0).any()
    assert_same(known, found)


# -- matrices of each run, hooks together, what is singular ----------------------------------------
OWN = np.linspace(0.5, 0.9, 4)[:, None, None] * EYE
HOLED = np.where(RNG.random(Z.shape) < 0.3, np.nan, Z)
ODD = {
    "f of runs": (celnav.ukf(celnav.Motion(OWN, 0.01 * EYE), SENSOR), PRIOR),
    "h of runs": (celnav.ukf(MOTION, celnav.Sensor(OWN, 0.05 * EYE)), PRIOR),
    "both, by Jacobians": (
        celnav.ekf(celnav.Motion(OWN, 0.01 * EYE), celnav.Sensor(OWN, 0.05 * EYE)),
        PRIOR,
    ),
    "decorrelated of runs": (
        celnav.decorrelated(MOTION, celnav.Sensor(EYE, 0.05 * EYE), OWN),
        PRIOR,
    ),
    "augmented of runs": (celnav.augmented(MOTION, celnav.Sensor(EYE, 0.05 * EYE), OWN), PRIOR),
    "bias of runs": (celnav.two_stage(MOTION, SENSOR, OWN, PRIOR), PRIOR),
    "prior of a bias of runs": (
        celnav.two_stage(MOTION, SENSOR, EYE, celnav.Gaussian(Z[0], OWN)),
        celnav.Gaussian(np.tile(PRIOR.mean, (4, 1)), PRIOR.cov),
    ),
    "three hooks": (
        celnav.ukf(MOTION, SENSOR, hooks=[gate(3.0), huber(), innovation_window(2)]),
        PRIOR,
    ),
    "a hook that counts": (
        celnav.ukf(
            MOTION, SENSOR, hooks=[lambda n, joint, _: ((0 if n is None else n) + 1, joint)]
        ),
        PRIOR,
    ),
    "a certain component": (FILTER, celnav.Gaussian([0.0, 1.0], np.diag([0.0, 0.3]))),
    "a certain state": (
        celnav.ukf(MOTION, SENSOR, form="covariance"),
        celnav.Gaussian([0.0, 1.0], 0.0 * EYE),
    ),
    "no noise": (
        celnav.ukf(celnav.Motion(lambda x, _epoch: x[..., [0, 0]], 0.0 * EYE), SENSOR),
        PRIOR,
    ),
}


@pytest.mark.parametrize("name", ODD)
def test_what_is_seldom(name):
    assert_same(
        *twice(
            *ODD[name],
            TIMES,
            HOLED if "certain" not in name and "noise" not in name else Z,
            keep="cov",
        )
    )


def test_hooks_of_each_sensor():
    filter = celnav.ukf(MOTION, SENSOR, OTHER, hooks=[[gate(1.0)], [huber()]])
    assert_same(*twice(filter, PRIOR, TIMES, (HOLED, np.abs(Z[..., :1]) + 1.0), keep="cov"))


def test_matrices_that_are_functions_of_the_epoch():
    motion = celnav.Motion(
        celnav.Linear(
            lambda epoch: EYE * np.exp(-0.1 * epoch.dt) + 0.01 * np.eye(2, k=1) * epoch.t
        ),
        0.01 * EYE,
    )
    sensor = celnav.Sensor(
        celnav.Linear(lambda epoch: EYE * (1.0 + 0.1 * np.sin(epoch.t))), 0.05 * EYE
    )
    for make in (celnav.ukf, celnav.ekf):
        assert_same(
            *twice(
                make(motion, sensor),
                PRIOR,
                np.cumsum([0.0, 0.5, 0.7, 0.1, 2.0, 1.0]),
                HOLED,
                keep="cov",
            )
        )


# -- what cannot be compiled -----------------------------------------------------------------------
def branch(x, epoch):
    return 0.5 * x if (x < 9.0).any() else x  # here


def branch_on_time(x, epoch):
    return 0.5 * x if epoch.t > 2.0 else x  # here


def as_float(x, epoch):
    return x * float(x.flat[0]) if False else x + 0.0 * float(x.flat[0])  # here


def of_math(x, epoch):
    return x + 0.0 * math.sin(x.flat[0])  # here


def svd(x, epoch):
    return x + 0.0 * np.linalg.svd(np.outer(x.flat[:2], x.flat[:2]))[1].sum()  # here


def written(x, epoch):
    out = np.zeros(x.shape)
    out[..., 0] = x[..., 0]  # here
    return out


def rounded(x, epoch):
    return x + 0.0 * np.spacing(x)  # here


def indexed(x, epoch):
    return x * np.ones(10)[epoch.k]  # here


@pytest.mark.parametrize(
    ("model", "why"),
    [
        (branch, "a branch depends on a number that is known only when the filter runs"),
        (branch_on_time, "a branch depends on a number that is known only when the filter runs"),
        (as_float, "is asked for as a float"),
        (of_math, "is asked for as a float"),
        (svd, r"numpy\.linalg\.svd cannot be recorded"),
        (written, ""),
        (rounded, r"numpy\.spacing cannot be recorded"),
        (indexed, ""),
    ],
)
@pytest.mark.parametrize("place", ["motion", "sensor"])
def test_what_cannot_be_compiled_is_told_by_its_line(model, why, place):
    motion, sensor = (
        (celnav.Motion(model, EYE), SENSOR)
        if place == "motion"
        else (MOTION, celnav.Sensor(model, EYE))
    )
    filter = celnav.ukf(motion, sensor)
    line = next(i for i, text in enumerate(*inspect.getsourcelines(model)) if "# here" in text)
    with pytest.raises(
        CannotCompile, match=f"{why}.*\\(test_compiled_runs.py, line {line}: "
    ) as error:
        celnav.run(filter, PRIOR, TIMES, Z, engine="compiled")
    assert "\n" not in str(error.value)
    track = celnav.run(filter, PRIOR, TIMES, Z, engine="auto")
    assert track.engine == f"numpy: {error.value}"
    np.testing.assert_array_equal(track.mean, celnav.run(filter, PRIOR, TIMES, Z).mean)


def test_what_has_no_states_is_told_and_auto_goes_on():
    options = {
        "reduce": lambda *_: 1,
        "also": lambda epoch, state, infos: {"mean": state.belief.mean},
    }
    for name, option in options.items():
        with pytest.raises(
            CannotCompile, match=r"^also, reduce: expected none with engine='compiled'"
        ):
            celnav.run(FILTER, PRIOR, TIMES, Z, engine="compiled", **{name: option})
        track = celnav.run(FILTER, PRIOR, TIMES, Z, engine="auto", **{name: option})
        assert re.match("numpy: also, reduce: expected none", track.engine)
        assert track.reduced == 1 or track.extra["mean"].shape == track.mean.shape


def test_which_engine_flew():
    tracks = {
        name: celnav.run(FILTER, PRIOR, TIMES, Z, engine=name)
        for name in ("numpy", "compiled", "auto")
    }
    assert {name: track.engine for name, track in tracks.items()} == {
        "numpy": "numpy",
        "compiled": "compiled",
        "auto": "compiled",
    }
    assert_same(tracks["numpy"], tracks["auto"])
    with pytest.raises(
        ValueError, match=r"^engine: expected one of numpy, compiled, cuda, auto, got 'fast'"
    ):
        celnav.run(FILTER, PRIOR, TIMES, Z, engine="fast")


def test_without_llvmlite_numpy_flies(monkeypatch):
    def absent():
        raise ImportError("engine='compiled': expected llvmlite")

    monkeypatch.setattr("celnav.tape.llvm.toolchain", absent)
    filter = celnav.ukf(celnav.Motion(lambda x, _epoch: 0.123 * x, EYE), SENSOR)
    for cached in (celnav.tape.llvm.lanes, celnav.tape.llvm.features):
        cached.cache_clear()
    try:
        with pytest.raises(ImportError, match="expected llvmlite"):
            celnav.run(filter, PRIOR, TIMES, Z, engine="compiled")
        assert celnav.run(filter, PRIOR, TIMES, Z, engine="auto").engine.startswith(
            "numpy: engine='compiled': expected llvmlite"
        )
    finally:
        monkeypatch.undo()
        for cached in (celnav.tape.llvm.lanes, celnav.tape.llvm.features):
            cached.cache_clear()


def test_a_measurement_noise_of_each_run_that_nobody_has_looked_at():
    """Compiled before numpy has run it: whether R is singular is known before the step is recorded."""
    R = np.array([0.5, 1.0, 2.0])[:, None, None]
    z = np.random.default_rng(4).standard_normal((6, 3, 1))
    motion, prior = (
        celnav.Motion(np.eye(1), 0.1 * np.eye(1)),
        celnav.Gaussian(np.zeros((3, 1)), np.eye(1)),
    )
    found = celnav.compiled(celnav.ukf(motion, celnav.Sensor(np.eye(1), R))).run(
        prior, np.arange(6.0), z
    )
    known = celnav.run(celnav.ukf(motion, celnav.Sensor(np.eye(1), R)), prior, np.arange(6.0), z)
    np.testing.assert_allclose(found.mean, known.mean, rtol=1e-12, atol=1e-14)


def test_a_run_that_keeps_nothing_needs_no_room_for_its_rows():
    """Six states and one measurement: the rows of the means alone would need 6 MB."""
    T, runs, n = 2000, 64, 6
    motion = celnav.Motion(0.9 * np.eye(n), 0.01 * np.eye(n))
    filter = celnav.compiled(celnav.ukf(motion, celnav.Sensor(np.ones((1, n)), [[0.1]])))
    prior = celnav.Gaussian(RNG.standard_normal((runs, n)), np.eye(n))
    times, z, peak = np.arange(float(T)), np.zeros((T, 1)), {}
    filter.run(prior, times, z, keep="nothing")  # this run is compiled
    for keep in ("nothing", "mean"):
        tracemalloc.start()
        track = filter.run(prior, times, z, keep=keep)
        peak[keep] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert (track.mean is None) is (keep == "nothing")
        assert np.isfinite(track.log_likelihood).all()
    rows = 8 * T * runs * n
    assert peak["nothing"] < rows / 2
    assert peak["mean"] > rows


def not_lower(form):
    """A filter with a matrix that machine code stores only in part: a root that is not lower
    triangular, or a covariance that is not symmetric.
    """
    F, turn = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.8, 0.6], [-0.6, 0.8]])

    def start(prior):
        return State(form.of(prior), ())

    def step(state, _epoch):
        mean, matrix = state.belief
        moved = F @ matrix if form is Covariance else F @ matrix @ turn
        return State(form((F @ mean[..., None])[..., 0], moved), ()), (Info(silent=True),)

    return FromFunctions(start, step)


@pytest.mark.parametrize("form", [Covariance, SquareRoot])
def test_matrices_that_are_kept_in_part_are_refused(form):
    prior = celnav.Gaussian(np.zeros(2), np.eye(2))
    with pytest.raises(CannotCompile, match="another covariance"):
        celnav.run(not_lower(form), prior, np.arange(6.0), engine="compiled")


def test_matrices_of_each_run_are_read_in_every_flight():
    """They may be changed in place; with so many runs only some are compared."""
    runs, times = 9000, np.arange(5.0)
    sensor = celnav.Sensor(np.eye(1), np.ones((runs, 1, 1)))
    filter = celnav.ukf(celnav.Motion(0.9 * np.eye(1), 0.1), sensor)
    prior, z = celnav.Gaussian([0.0], 1.0), np.ones((5, runs, 1))
    kept, own = celnav.compiled(filter), []
    kept.run(prior, times, z)
    map_run_constants(filter, lambda array: own.append(array) or array)
    for array in own:
        array[3] = 9.0
    found, known = kept.run(prior, times, z), celnav.run(filter, prior, times, z, engine="numpy")
    np.testing.assert_allclose(found.mean, known.mean, rtol=1e-12)


def test_more_sensors_than_kinds_can_be_numbered():
    """Four statuses for each of 34 sensors would overflow an integer."""
    filter = celnav.ukf(celnav.Motion(0.9 * np.eye(1), 0.1), *[celnav.Sensor(np.eye(1), 4.0)] * 34)
    z = np.random.default_rng(0).standard_normal((6, 34, 1))
    epochs = [
        celnav.Epoch(
            k, 0.0, 0.0, None, tuple(None if (i, k) == (0, 0) else z[k, i] for i in range(34))
        )
        for k in range(6)
    ]
    prior = celnav.Gaussian([0.0], 1.0)
    known, found = (celnav.run(filter, prior, epochs, engine=x) for x in ("numpy", "compiled"))
    np.testing.assert_allclose(found.mean, known.mean, rtol=1e-12)
    assert found.events["missing"] == known.events["missing"] == 1


def test_a_measurement_that_is_precise_for_one_run_changes_no_other_run():
    filter = celnav.ukf(MOTION, celnav.Sensor(cubic, 1e-4 * EYE), form="covariance")
    z = np.random.default_rng(7).standard_normal((6, 12, 2))
    wide = np.where(np.arange(12) == 5, 1e3, 0.3)[:, None, None] * EYE
    prior = celnav.Gaussian(np.ones((12, 2)), wide)
    assert_same(*twice(filter, prior, TIMES, z, keep="cov"))
    whole = celnav.run(filter, prior, TIMES, z, engine="compiled", keep="cov")
    narrow = celnav.Gaussian(prior.mean, 0.3 * EYE)
    without = celnav.run(filter, narrow, TIMES, z, engine="compiled", keep="cov")
    others = np.arange(12) != 5
    assert whole.mean[:, others].tobytes() == without.mean[:, others].tobytes()
    assert whole.cov[:, others].tobytes() == without.cov[:, others].tobytes()
