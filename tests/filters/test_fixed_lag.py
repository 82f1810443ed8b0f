"""Late samples give the same result as samples on time; smoothing the stored epochs equals
smoothing the full track.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from twice import assert_same, twice

import celnav
from celnav.engine.recording import Engine
from celnav.filters.adaptive import huber, innovation_window
from celnav.filters.fixed_lag import FixedLag, FixedLagState
from celnav.gaussian.belief import nees
from celnav.tape.tape import CannotCompile

pytestmark = pytest.mark.usefixtures("eager")

T, RUNS, LAG = 24, 5, 6
RNG = np.random.default_rng(1)
TIMES = np.cumsum(RNG.uniform(0.5, 1.5, T))
ONE = celnav.Gaussian([0.0, 1.0], np.diag([1.0, 0.5]))
PRIOR = celnav.Gaussian(ONE.mean + RNG.standard_normal((RUNS, 2)), ONE.cov)
MOTION = celnav.Motion(
    lambda x, e: np.stack([x[..., 0] + e.dt * np.sin(x[..., 1]), x[..., 1]], -1),
    np.diag([0.02, 0.05]),
)
RADAR = celnav.Sensor(
    lambda x, e: np.stack([np.hypot(x[..., 0], 3.0), x[..., 1] ** 3], -1), np.diag([0.1, 0.3])
)
GPS = celnav.Sensor([[1.0, 0.0]], [[0.2]])
MATRICES = celnav.Motion([[1.0, 0.1], [0.0, 0.9]], np.diag([0.02, 0.05]))
TRUTH, (Z, FIXES) = celnav.simulate(MOTION, [RADAR, GPS], ONE, TIMES, runs=RUNS, seed=2)
Z = np.where(RNG.random(Z.shape) < 0.2, np.nan, Z)
Z[9] = np.nan
FILTERS = {
    "ukf": celnav.ukf(MOTION, RADAR),
    "covariance": celnav.ukf(MOTION, RADAR, form="covariance"),
    "ekf, iterated": celnav.ekf(MOTION, RADAR, iterations=3),
    "matrices": celnav.ukf(MATRICES, celnav.Sensor(np.eye(2), np.eye(2))),
    "hooks": celnav.ukf(MOTION, RADAR, hooks=[huber(), innovation_window(3)]),
    "colored": celnav.colored(MOTION, RADAR, 0.5 * np.eye(2)),
    "two stages": celnav.two_stage(
        MOTION, RADAR, np.eye(2), celnav.Gaussian(np.zeros(2), np.eye(2))
    ),
}
EVERY = pytest.mark.parametrize("name", FILTERS)


def arriving(filter, prior, z, delay, lag=LAG, times=TIMES):
    """State of a filter whose samples ``z (T, ..., m)`` are ``delay (T, ...)`` epochs late, one
    after the other.
    """
    fixed = FixedLag(filter, lag)
    k = np.arange(len(times)).reshape(-1, *(1,) * (delay.ndim - 1))
    on_time = np.where((delay == 0)[..., None], z, np.nan)
    state = fixed.start(prior)
    for epoch in celnav.epochs(times, on_time):
        state, infos = fixed.step(state, epoch)
        for late in range(1, lag + 1):
            come = delay[max(epoch.k - late, 0)] == late
            if late <= epoch.k and come.any():
                state, infos = fixed.late(
                    state, epoch.k - late, np.where(come[..., None], z[epoch.k - late], np.nan)
                )
    assert delay.max() <= lag
    assert (k + delay <= len(times) - 1).all()
    return state, infos


def delays(*shape):
    """Mostly no delay, 1 to LAG epochs for some samples, never beyond the end."""
    late = np.where(RNG.random((T, *shape)) < 0.4, RNG.integers(1, LAG + 1, (T, *shape)), 0)
    return np.minimum(late, (T - 1 - np.arange(T)).reshape(-1, *(1,) * len(shape)))


@EVERY
def test_late_is_as_on_time(name):
    """Each run has its delays; mean, covariance and the last `Info` equal the results in order."""
    filter = FILTERS[name]
    state, infos = arriving(filter, PRIOR, Z, delays(RUNS))
    *_, (_, expected, told) = celnav.steps(filter, PRIOR, celnav.epochs(TIMES, Z))
    np.testing.assert_allclose(state.belief.mean, expected.belief.mean, rtol=0, atol=1e-13)
    np.testing.assert_allclose(state.belief.cov, expected.belief.cov, rtol=0, atol=1e-13)
    np.testing.assert_allclose(infos[0].whitened, told[0].whitened, rtol=0, atol=1e-12)


@EVERY
def test_a_run_is_late_by_itself(name):
    """Late samples with different epochs in one call: a run in a batch equals the run alone."""
    late = np.array([3, 7, 5, 4, 7])
    z = Z.copy()
    z[late, np.arange(RUNS)] = np.nan
    come = np.where(np.isnan(Z[late, np.arange(RUNS)]), 0.3, Z[late, np.arange(RUNS)])
    fixed = FixedLag(FILTERS[name], LAG)

    def flown(prior, z, k, come):
        state = fixed.start(prior)
        for epoch in celnav.epochs(TIMES[:9], z[:9]):
            state, _ = fixed.step(state, epoch)
        return fixed.late(state, k, come)[0].belief

    batch = flown(PRIOR, z, late, come)
    for i in range(RUNS):
        alone = flown(celnav.Gaussian(PRIOR.mean[i], PRIOR.cov), z[:, i], int(late[i]), come[i])
        np.testing.assert_allclose(batch.mean[i], alone.mean, rtol=0, atol=1e-11)
        cov = np.broadcast_to(batch.cov, (RUNS, *batch.cov.shape[-2:]))[i]
        np.testing.assert_allclose(cov, alone.cov, rtol=0, atol=1e-11)


def test_sensors_that_are_late_by_themselves():
    """One sensor is on time, the other always five epochs late; until then its samples are missing."""
    filter = celnav.ukf(MOTION, RADAR, GPS)
    fixed = FixedLag(filter, 5)
    state = fixed.start(PRIOR)
    for epoch in celnav.epochs(TIMES, Z):
        state, infos = fixed.step(state, epoch._replace(z=(epoch.z, None)))
        if epoch.k >= 5:
            state, infos = fixed.late(state, epoch.k - 5, (None, FIXES[epoch.k - 5]))
    fixes = FIXES.copy()
    fixes[-5:] = np.nan
    expected = celnav.run(filter, PRIOR, TIMES, (Z, fixes), keep="cov")
    np.testing.assert_allclose(state.belief.mean, expected.mean[-1], rtol=0, atol=1e-13)
    np.testing.assert_allclose(state.belief.cov, expected.cov[-1], rtol=0, atol=1e-13)
    assert infos[1].silent


@pytest.mark.parametrize("there", [None, (None, None)], ids=["none", "none of two"])
@pytest.mark.parametrize("sensors", [("radar",), ("gps",), ("radar", "gps")], ids="+".join)
def test_late_samples_of_an_epoch_in_which_nothing_was_measured(sensors, there):
    """From either sensor or from both, whether the epoch had ``z=None`` or a tuple of Nones."""
    filter = celnav.ukf(MOTION, RADAR, GPS)
    come = Z[8] if "radar" in sensors else None, FIXES[8] if "gps" in sensors else None

    def flown(there, late):
        fixed = FixedLag(filter, 5)
        state = fixed.start(PRIOR)
        for epoch in celnav.epochs(TIMES[:12], (Z[:12], FIXES[:12])):
            state, _ = fixed.step(state, epoch._replace(z=there) if epoch.k == 8 else epoch)
        return fixed, fixed.late(state, 8, late)[0] if late else state

    fixed, state = flown(there, come)
    _, expected = flown(come, None)
    np.testing.assert_array_equal(state.belief.mean, expected.belief.mean)
    np.testing.assert_array_equal(state.belief.cov, expected.belief.cov)
    before = flown(there, None)[1]
    assert np.abs(state.belief.mean - before.belief.mean).max() > 1e-4
    with pytest.raises(ValueError, match=r"^z: expected components not yet measured at epoch 8"):
        fixed.late(state, 8, come)


@pytest.mark.parametrize("there", [None, (None,)], ids=["none", "a tuple of none"])
@pytest.mark.parametrize("as_tuple", [False, True])
def test_a_late_sample_of_one_sensor_where_nothing_was_measured(there, as_tuple):
    fixed = FixedLag(FILTERS["ukf"], 5)
    state = expected = fixed.start(PRIOR)
    for epoch in celnav.epochs(TIMES[:12], Z[:12]):
        state, _ = fixed.step(state, epoch._replace(z=there) if epoch.k == 8 else epoch)
        expected, _ = fixed.step(expected, epoch)
    state, _ = fixed.late(state, 8, (Z[8],) if as_tuple else Z[8])
    np.testing.assert_array_equal(state.belief.mean, expected.belief.mean)
    np.testing.assert_array_equal(state.belief.cov, expected.belief.cov)


def test_what_never_comes_late_changes_no_bit():
    known, found = (
        celnav.run(filter, PRIOR, TIMES, Z, keep="cov")
        for filter in (FILTERS["ukf"], FixedLag(FILTERS["ukf"], 3))
    )
    np.testing.assert_array_equal(found.mean, known.mean)
    np.testing.assert_array_equal(found.belief[1], known.belief[1])
    np.testing.assert_array_equal(found.log_likelihood, known.log_likelihood)


# -- machine code ----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "name", [name for name in FILTERS if name != "ekf, iterated"]
)  # whose derivatives are differences
def test_either_engine_flies_it(name):
    pytest.importorskip("llvmlite")
    assert_same(*twice(FixedLag(FILTERS[name], LAG), PRIOR, TIMES, Z, keep="cov"))


def test_either_engine_knows_the_measurement_from_its_error():
    """With four components and three."""
    pytest.importorskip("llvmlite")
    space = celnav.attitude()
    motion = celnav.Motion(lambda q, _epoch: q, 1e-3 * np.eye(3), space=space)
    filter = celnav.ukf(motion, celnav.Sensor(lambda q, _epoch: q, 1e-2 * np.eye(3), space=space))
    prior = celnav.Gaussian([0.0, 0.0, 0.0, 1.0], 0.1 * np.eye(3))
    q = RNG.standard_normal((4, RUNS, 4)) * 0.2 + [0.0, 0.0, 0.0, 1.0]
    z = q / np.linalg.norm(q, axis=-1, keepdims=True)
    assert_same(*twice(FixedLag(filter, 2), prior, np.arange(4.0), z, keep="cov"))


def test_steps_of_any_length_share_what_is_compiled(monkeypatch):
    pytest.importorskip("llvmlite")
    counts, record = [], Engine.record
    monkeypatch.setattr(Engine, "record", lambda *arguments: counts.append(1) or record(*arguments))
    filter, times = celnav.compiled(FILTERS["ukf"]), np.cumsum(np.linspace(0.5, 1.5, 8))
    for _ in celnav.steps(filter, PRIOR, celnav.epochs(times, Z[:8])):
        pass
    assert len(counts) <= 2  # the first epoch does not move


def test_what_is_compiled_runs_so():
    pytest.importorskip("llvmlite")
    track = celnav.run(celnav.compiled(FILTERS["ukf"]), PRIOR, TIMES, Z, keep="cov")
    assert_same(celnav.run(FILTERS["ukf"], PRIOR, TIMES, Z, keep="cov"), track)
    assert celnav.smooth(track).mean.shape == track.mean.shape


def test_who_wants_the_states_flies_by_numpy():
    pytest.importorskip("llvmlite")
    fixed, also = (
        FixedLag(FILTERS["ukf"], 3),
        {"also": lambda _epoch, state, _infos: {"kept": np.array(len(state.epochs))}},
    )
    with pytest.raises(
        CannotCompile,
        match=r"^also, reduce: expected none with engine='compiled', which keeps no states",
    ):
        celnav.run(fixed, PRIOR, TIMES, Z, engine="compiled", **also)
    track = celnav.run(fixed, PRIOR, TIMES, Z, engine="auto", **also)
    assert track.engine.startswith("numpy: also, reduce")
    assert track.extra["kept"].max() == 4


STEPPED = ["ukf", "covariance", "matrices"]


@pytest.mark.parametrize("name", STEPPED)
def test_steps_by_machine_code(name):
    """Late samples included, and smoothed."""
    pytest.importorskip("llvmlite")
    late, found = delays(RUNS), []
    late[np.arange(T) % 4 > 0] = 0
    for filter in (FILTERS[name], celnav.compiled(FILTERS[name])):
        state, _ = arriving(filter, PRIOR, Z, late)
        found.append(FixedLag(filter, LAG).track(state))
    assert_same(*found, engine="numpy")
    known, smoothed = map(celnav.smooth, found)
    np.testing.assert_allclose(smoothed.mean, known.mean, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(smoothed.cov, known.cov, rtol=1e-12, atol=1e-12)


def test_steps_by_machine_code_have_no_numpy_in_them(monkeypatch):
    pytest.importorskip("llvmlite")
    filter = celnav.compiled(FILTERS["ukf"])
    fixed = FixedLag(filter, 3)

    def flown():
        state = fixed.start(PRIOR)
        for epoch in celnav.epochs(TIMES[:9], Z[:9]):
            state, _ = fixed.step(state, epoch)
        return fixed.late(state, 7, np.where(np.isnan(Z[7]), 0.3, np.nan))[0].belief.mean

    once = flown()
    monkeypatch.setattr("celnav.filters.sequential.joint", lambda *_, **__: pytest.fail("by numpy"))
    np.testing.assert_array_equal(flown(), once)


def test_steps_of_sensors_that_are_silent_in_turns_and_of_lost_runs():
    """The values of each sensor are in its columns; a failed run is nan and the other runs
    continue.
    """
    pytest.importorskip("llvmlite")
    filter = celnav.ukf(MOTION, RADAR, GPS)
    mean = np.where(np.arange(RUNS)[:, None] == 0, 1e200, PRIOR.mean)
    for prior, lost in ((PRIOR, 0), (celnav.Gaussian(mean, PRIOR.cov), 1)):
        found = []
        for one in (filter, celnav.compiled(filter)):
            fixed = FixedLag(one, LAG)
            state = fixed.start(prior)
            with np.errstate(all="ignore"):
                for epoch in celnav.epochs(TIMES, Z)[:12]:
                    z = epoch.z if epoch.k % 3 else None, FIXES[epoch.k] if epoch.k % 2 else None
                    state, infos = fixed.step(state, epoch._replace(z=z))
                    assert [info.silent for info in infos] == [part is None for part in z]
                state, _ = fixed.late(state, 9, (np.where(np.isnan(Z[9]), 0.3, np.nan), None))
            found.append(fixed.track(state))
        assert np.isnan(found[0].mean[-1]).all(-1).sum() == lost
        assert_same(*found, engine="numpy")


def test_steps_that_cannot_be_compiled():
    pytest.importorskip("llvmlite")
    fixed = FixedLag(celnav.compiled(FILTERS["hooks"]), LAG)
    with pytest.raises(CannotCompile, match=r"^a filter that remembers more than a belief"):
        fixed.step(fixed.start(PRIOR), celnav.Epoch(0, 0.0, 0.0, None, Z[0]))


# -- memory ----------------------------------------------------------------------------------------


def test_a_measurement_may_be_a_buffer():
    """A stored epoch does not change when its array is reused."""
    fixed, buffer, z = FixedLag(FILTERS["ukf"], LAG), np.empty((RUNS, 2)), Z.copy()
    z[8] = np.nan
    state = fixed.start(PRIOR)
    for epoch in celnav.epochs(TIMES, z):
        buffer[...] = epoch.z
        state, _ = fixed.step(state, epoch._replace(z=buffer))
        if epoch.k == 12:
            state, _ = fixed.late(state, 8, Z[8])
    expected = celnav.run(FILTERS["ukf"], PRIOR, TIMES, Z)
    np.testing.assert_allclose(state.belief.mean, expected.mean[-1], rtol=0, atol=1e-13)


def test_a_lost_run_is_lost_alone():
    prior = celnav.Gaussian(np.where(np.arange(RUNS)[:, None] == 2, 1e200, PRIOR.mean), PRIOR.cov)
    with np.errstate(all="ignore"):
        state, _ = arriving(FILTERS["ukf"], prior, Z, delays(RUNS))
        known = celnav.run(FILTERS["ukf"], prior, TIMES, Z, on_failure="flag")
    np.testing.assert_array_equal(known.failed_at >= 0, np.arange(RUNS) == 2)
    np.testing.assert_allclose(state.belief.mean, known.mean[-1], rtol=0, atol=1e-13)


@pytest.mark.parametrize("form", ["square root", "covariance"])
def test_fixed_lag_is_the_smoother_of_the_track_cut(form):
    """At every epoch, late samples included: means and covariances of the last epochs equal those
    from `smooth`.
    """
    filter = celnav.ukf(MOTION, RADAR, form=form)
    fixed, z = FixedLag(filter, LAG), Z.copy()
    z[10] = np.nan
    state = fixed.start(PRIOR)
    for epoch in celnav.epochs(TIMES, z):
        state, _ = fixed.step(state, epoch)
        if epoch.k == 13:
            z[10] = Z[10]
            state, _ = fixed.late(state, 10, Z[10])
        cut = celnav.run(filter, PRIOR, TIMES[: epoch.k + 1], z[: epoch.k + 1], keep="cov")
        expected, found = celnav.smooth(cut), celnav.smooth(fixed.track(state))
        rows = min(LAG + 1, epoch.k + 1)
        assert found.mean.shape == (rows, RUNS, 2)
        np.testing.assert_array_equal(found.times, TIMES[epoch.k + 1 - rows : epoch.k + 1])
        np.testing.assert_allclose(found.mean, expected.mean[-rows:], rtol=0, atol=1e-13)
        np.testing.assert_allclose(found.cov, expected.cov[-rows:], rtol=0, atol=1e-13)
        np.testing.assert_array_equal(fixed.track(state).nis, cut.nis[-rows:])


def test_the_past_is_known_better_and_honestly():
    """Over 400 runs the fixed-lag estimate has a smaller error than the filter at the same epoch,
    as large as predicted.
    """
    runs = 400
    prior = celnav.Gaussian(np.array([0.0, 0.6]), np.diag([0.3, 0.05]))
    motion, sensor = MATRICES, celnav.Sensor(np.eye(2), np.eye(2))
    truth, z = celnav.simulate(motion, sensor, prior, TIMES, runs=runs, seed=5)
    fixed = FixedLag(celnav.ukf(motion, sensor), LAG)
    prior = celnav.Gaussian(np.tile(prior.mean, (runs, 1)), prior.cov)
    state = fixed.start(prior)
    for epoch in celnav.epochs(TIMES, z):
        state, _ = fixed.step(state, epoch)
    then = fixed.track(state)
    smoothed = celnav.smooth(then)
    errors = smoothed.mean[0] - truth[T - 1 - LAG]
    assert np.square(errors).mean() < 0.9 * np.square(then.mean[0] - truth[T - 1 - LAG]).mean()
    assert nees(errors, smoothed.sqrt_cov[0]).mean() == pytest.approx(
        2.0, abs=4.0 * 2.0 / np.sqrt(runs)
    )


def test_it_holds_no_more_than_the_lag():
    fixed = FixedLag(FILTERS["ukf"], 2)
    state = fixed.start(PRIOR)
    assert isinstance(state, FixedLagState)
    for epoch in celnav.epochs(TIMES, Z):
        state, _ = fixed.step(state, epoch)
        assert len(state.epochs) == len(state.infos) == len(state.states) - 1 == min(epoch.k + 1, 3)


def after(k, lag=LAG, z=Z):
    """A filter and its state after epoch ``k``."""
    fixed = FixedLag(FILTERS["ukf"], lag)
    state = fixed.start(PRIOR)
    for epoch in celnav.epochs(TIMES, z)[: k + 1]:
        state, _ = fixed.step(state, epoch)
    return fixed, state


FIXED, STATE = after(12)
NEW = np.full((RUNS, 2), np.nan)
TWICE = NEW.copy()
TWICE[3, 1] = 0.5
THERE = Z.copy()
THERE[10, 3, 1] = 0.4


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (
            lambda: FIXED.late(STATE, 5, np.ones(2)),
            r"k: expected a stored epoch, 6 to 12 \(lag = 6\), got 5",
        ),
        (
            lambda: FIXED.late(STATE, 13, np.ones(2)),
            r"k: expected a stored epoch, 6 to 12 \(lag = 6\), got 13",
        ),
        (
            lambda: FIXED.late(STATE, 9.5, np.ones(2)),
            "k: expected a stored epoch, 6 to 12 .* got 9.5",
        ),
        (
            lambda: FIXED.late(STATE, [9, 9, 9, 2, 9], np.ones((5, 2))),
            "k: expected a stored epoch, 6 to 12 .* got 2",
        ),
        (
            lambda: FIXED.late(FIXED.start(PRIOR), 0, np.ones(2)),
            "k: expected none before the first step, got 0",
        ),
        (
            lambda: after(12, z=THERE)[0].late(after(12, z=THERE)[1], 10, TWICE),
            r"z: .* epoch 10, got \[3, 1\] a second",
        ),
        (lambda: FIXED.late(STATE, 10, np.ones(3)), r"z: expected shape \(\.\.\., 2\), got \(3,\)"),
        (
            lambda: FIXED.late(STATE, 10, (np.ones(2), np.ones(2))),
            "z: expected 1 measurements, one for each sensor, got 2",
        ),
        (
            lambda: FIXED.late(STATE, 10, [np.inf, 0.0]),
            "z: expected finite numbers or nan, got an infinite one",
        ),
        (
            lambda: FIXED.late(STATE, 9, np.ones((4, 2))),
            r"z: expected batch axes that broadcast with \(5,\) of epoch 9, got \(4,\)",
        ),
        (
            lambda: FIXED.late(STATE, [9, 9], np.ones((4, 2))),
            r"z: expected batch axes that broadcast with \(2,\) of k, got \(4,\)",
        ),
        (
            lambda: FIXED.step(STATE, celnav.Epoch(12)),
            "epoch: expected k = 13, after the last epoch, got Epoch",
        ),
        (
            lambda: FIXED.step(PRIOR, celnav.Epoch(0)),
            "state: expected what the filter's start.* got Gaussian",
        ),
        (
            lambda: FIXED.track(FIXED.start(PRIOR)),
            "state: expected a state after a step, got one before the first",
        ),
        (
            lambda: FixedLag(MOTION, 3),
            r"filter: expected a filter, such as celnav.ukf\(motion, sensor\), got Motion",
        ),
        (
            lambda: FixedLag(SimpleNamespace(step=FILTERS["ukf"].step), 3),
            r"filter: expected a filter, such as celnav.ukf\(motion, sensor\), got SimpleNamespace",
        ),
        (
            lambda: FixedLag(SimpleNamespace(start=FILTERS["ukf"].start), 3),
            r"filter: expected a filter, such as celnav.ukf\(motion, sensor\), got SimpleNamespace",
        ),
        (
            lambda: FixedLag(type(FILTERS["ukf"]), 3),
            r"filter: expected a filter, such as celnav.ukf\(motion, sensor\), got",
        ),
        (
            lambda: FixedLag(FILTERS["ukf"], -1),
            "lag: expected an integer from 0 to 1000000, got -1",
        ),
    ],
)
def test_bad_input_is_refused_by_name(make, told):
    with pytest.raises(ValueError, match=f"^{told}"):
        make()


def test_runs_without_a_sample_need_no_epoch():
    """A run without a sample does not change, whatever ``k`` is."""
    state, _ = FIXED.late(STATE, np.full(RUNS, -1), NEW)
    np.testing.assert_array_equal(state.belief.mean, STATE.belief.mean)
    assert state.epochs == STATE.epochs
