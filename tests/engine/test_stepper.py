"""Single steps by machine code equal numpy's: for every kind of filter, epoch and batch, in
threads, and after a change.
"""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

import celnav
from celnav.filters.adaptive import huber, innovation_window
from celnav.filters.fixed_lag import FixedLag
from celnav.tape.tape import CannotCompile

pytest.importorskip("llvmlite")

T = 12
RNG = np.random.default_rng(3)
TIMES = np.cumsum(RNG.uniform(0.5, 1.5, T))
PRIOR = celnav.Gaussian([0.0, 1.0], np.diag([1.0, 0.5]))
MANY = celnav.Gaussian(PRIOR.mean + RNG.standard_normal((11, 2)), PRIOR.cov)


def swing(x, epoch):
    return np.stack([x[..., 0] + epoch.dt * np.sin(x[..., 1]), x[..., 1]], -1)


def pushed(x, epoch):
    u = np.zeros(2) if epoch.u is None else epoch.u
    return swing(x, epoch) + u


def seen(x, _epoch):
    return np.stack([np.hypot(x[..., 0], 3.0), x[..., 1] ** 3], -1)


MOTION = celnav.Motion(swing, np.diag([0.02, 0.05]))
RADAR = celnav.Sensor(seen, np.diag([0.1, 0.3]))
GPS = celnav.Sensor([[1.0, 0.0]], [[0.2]])
Z = RNG.standard_normal((T, 2)) + np.array([3.0, 1.0])
GAPS = np.where(RNG.random(Z.shape) < 0.3, np.nan, Z)
FILTERS = {
    "ukf": celnav.ukf(MOTION, RADAR),
    "covariance": celnav.ukf(MOTION, RADAR, form="covariance"),
    "ckf": celnav.ckf(MOTION, RADAR),
    "linear": celnav.ukf(
        celnav.Motion([[1.0, 0.1], [0.0, 0.9]], 0.02), celnav.Sensor(np.eye(2), 1.0)
    ),
    "window": celnav.ukf(MOTION, RADAR, hooks=[huber(), innovation_window(3)]),
    "colored": celnav.colored(MOTION, RADAR, 0.5 * np.eye(2)),
    "augmented": celnav.augmented(MOTION, RADAR, 0.5 * np.eye(2)),
    "two stages": celnav.two_stage(
        MOTION, RADAR, np.eye(2), celnav.Gaussian(np.zeros(2), np.eye(2))
    ),
    "models": celnav.imm(
        [celnav.ukf(MOTION, RADAR), celnav.ukf(celnav.Motion(swing, 1.0), RADAR)],
        [[0.9, 0.1], [0.1, 0.9]],
    ),
}


def stepped(filter, prior, epochs):
    """States and `Info` records after each epoch."""
    state, found = filter.start(prior), []
    for epoch in epochs:
        state, infos = filter.step(state, epoch)
        found.append((state, infos))
    return found


def assert_alike(found, known):
    """Compare beliefs, innovations, likelihoods and the masks of used components."""
    for (state, infos), (expected, records) in zip(found, known, strict=True):
        runs = state.belief.mean.shape[:-1]
        pairs = [(state.belief.mean, expected.belief.mean), (state.belief.cov, expected.belief.cov)]
        for x, y in pairs:
            assert x.shape[: len(runs)] == runs
            np.testing.assert_allclose(x, np.broadcast_to(y, x.shape), 1e-9, 1e-9)
        total = sum(np.nan_to_num(info.log_likelihood) for info in infos if not info.silent)
        wanted = sum(info.log_likelihood for info in records if not info.silent)
        np.testing.assert_allclose(total, wanted, 1e-9, 1e-9)
        for info, record in zip(infos, records, strict=True):
            assert info.silent == record.silent
            if not info.silent:
                assert info.used.dtype == bool
                for name in ("innovation", "nis", "used"):
                    x, y = getattr(info, name), getattr(record, name)
                    np.testing.assert_allclose(x, np.broadcast_to(y, x.shape), 1e-8, 1e-9)


@pytest.mark.parametrize("z", [Z, GAPS], ids=["complete", "gaps"])
@pytest.mark.parametrize("name", FILTERS)
def test_a_run_alone(name, z):
    """Also filters with more memory than a belief."""
    filter, epochs = FILTERS[name], celnav.epochs(TIMES, z)
    assert_alike(stepped(celnav.compiled(filter), PRIOR, epochs), stepped(filter, PRIOR, epochs))


@pytest.mark.parametrize("name", ["ukf", "covariance", "linear", "augmented"])
def test_runs_together(name):
    """More runs than lanes in a vector, and not a multiple; measurements shared by all runs or for
    each run.
    """
    filter = FILTERS[name]
    for z in (GAPS, GAPS[:, None] + RNG.standard_normal((T, 11, 2))):
        epochs = celnav.epochs(TIMES, z)
        known = stepped(filter, MANY, epochs)
        assert_alike(stepped(celnav.compiled(filter), MANY, epochs), known)


@pytest.mark.parametrize("prior", [PRIOR, MANY], ids=["one", "runs"])
def test_inputs_intervals_and_sensors_in_turns(prior):
    """Inputs for all runs and for each run, intervals for each run, and sensors that alternate."""
    filter = celnav.ukf(celnav.Motion(pushed, 0.1), RADAR, GPS)
    batch = prior.mean.shape[:-1]
    epochs = []
    for k, epoch in enumerate(celnav.epochs(TIMES, Z)):
        z = (epoch.z if k % 3 else None, epoch.z[:1] if k % 2 else None)
        u = RNG.standard_normal(2) if k % 2 else RNG.standard_normal((*batch, 2))
        dt = np.full(batch, epoch.dt) if k % 4 == 2 else epoch.dt
        epochs.append(epoch._replace(z=z, u=u if k else None, dt=dt))
    known = stepped(filter, prior, epochs)
    assert_alike(stepped(celnav.compiled(filter), prior, epochs), known)


def test_several_runs_of_a_filter_with_a_memory_are_refused():
    with pytest.raises(CannotCompile, match="stepped by machine code for one run only"):
        stepped(celnav.compiled(FILTERS["window"]), MANY, celnav.epochs(TIMES, Z))
    with pytest.raises(ValueError, match=r"FixedLag\(celnav.compiled\(filter\), lag\) keeps them"):
        celnav.compiled(FixedLag(FILTERS["ukf"], 3)).start(PRIOR)


def test_states_stay_as_they_were():
    """A step changes neither its input state nor an earlier result; a change written into a state
    is used.
    """
    fast, epochs = celnav.compiled(FILTERS["ukf"]), celnav.epochs(TIMES, Z)
    found = stepped(fast, PRIOR, epochs)
    copies = [(state.belief.mean.copy(), state.belief.cov.copy()) for state, _ in found]
    state, _ = fast.step(found[3][0], epochs[4])
    np.testing.assert_array_equal(state.belief.mean, found[4][0].belief.mean)
    stepped(fast, PRIOR, epochs)
    for (state, _), (mean, cov) in zip(found, copies, strict=True):
        np.testing.assert_array_equal(state.belief.mean, mean)
        np.testing.assert_array_equal(state.belief.cov, cov)
    other = found[3][0]
    other.belief.mean[0] += 1.0
    moved, _ = fast.step(other, epochs[4])
    expected, _ = FILTERS["ukf"].step(other, epochs[4])
    np.testing.assert_allclose(moved.belief.mean, expected.belief.mean, 1e-9)


def test_threads_share_no_buffer():
    """Eight filters in parallel threads give the same bytes as one after the other."""
    fast = celnav.compiled(FILTERS["ukf"])
    logs = [celnav.epochs(TIMES, Z + shift) for shift in np.linspace(-1.0, 1.0, 8)]

    def ends(epochs):
        return [stepped(fast, PRIOR, epochs)[-1][0].belief.mean for _ in range(20)]

    alone = [ends(epochs) for epochs in logs]
    with ThreadPoolExecutor(8) as pool:
        np.testing.assert_array_equal(list(pool.map(ends, logs)), alone)


def test_a_pickled_filter_steps():
    fast = celnav.compiled(celnav.ukf(celnav.Motion([[1.0]], 1.0), celnav.Sensor([[1.0]], 1.0)))
    prior, epoch = celnav.Gaussian([0.0], 1.0), celnav.Epoch(z=np.array([1.0]))
    fast.step(fast.start(prior), epoch)
    state, _ = pickle.loads(pickle.dumps(fast)).step(fast.start(prior), epoch)
    assert state.belief.mean == pytest.approx([0.5])


def test_a_lost_run_is_taken_by_numpy_and_its_neighbors_go_on():
    mean = np.where(np.arange(11)[:, None] == 4, 1e200, MANY.mean)
    prior, filter = celnav.Gaussian(mean, MANY.cov), FILTERS["ukf"]
    with np.errstate(all="ignore"):
        known = stepped(filter, prior, celnav.epochs(TIMES, Z))
        found = stepped(celnav.compiled(filter), prior, celnav.epochs(TIMES, Z))
    last = found[-1][0].belief.mean
    assert np.isnan(last[4]).all()
    assert np.isfinite(np.delete(last, 4, 0)).all()
    np.testing.assert_allclose(last, known[-1][0].belief.mean, 1e-9)


RATE = 1.0


def test_a_name_that_means_something_else_is_seen_at_once(monkeypatch):
    """A global number of a model, between two steps."""

    def drifting(x, epoch):
        return x + RATE * epoch.dt

    filter = celnav.ukf(celnav.Motion(drifting, np.eye(2)), RADAR)
    fast, epochs = celnav.compiled(filter), celnav.epochs(TIMES, Z)
    state = stepped(fast, PRIOR, epochs[:7])[-1][0]
    monkeypatch.setitem(globals(), "RATE", -3.0)
    found, _ = fast.step(state, epochs[7])
    expected, _ = filter.step(state, epochs[7])
    np.testing.assert_allclose(found.belief.mean, expected.belief.mean, 1e-9)


def test_a_model_that_counts_its_calls_is_refused():
    calls = []

    def counting(x, epoch):
        calls.append(1)
        return swing(x, epoch) + (len(calls) > 20)

    fast = celnav.compiled(celnav.ukf(celnav.Motion(counting, np.eye(2)), RADAR))
    with pytest.raises(CannotCompile, match="the model has a memory"):
        stepped(fast, PRIOR, celnav.epochs(TIMES, Z))


def test_what_changes_within_an_object_is_seen_where_numpy_takes_a_step():
    """These are the 1st, the 5th and the 21st step of a kind; then a new record replaces the old
    one.
    """
    settings = SimpleNamespace(rate=1.0)

    def drifting(x, epoch):
        return x + settings.rate * epoch.dt

    filter = celnav.ukf(celnav.Motion(drifting, np.eye(2)), RADAR)
    fast, epoch = celnav.compiled(filter), celnav.Epoch(1, 1.0, 1.0, z=Z[1])
    state = filter.start(PRIOR)
    for k in range(21):
        found, _ = fast.step(state, epoch)
        settings.rate = 1.0 if k < 7 else -3.0
    np.testing.assert_allclose(found.belief.mean, filter.step(state, epoch)[0].belief.mean, 1e-9)


def test_steps_and_fixed_lags_are_the_same_code(monkeypatch):
    fast, epochs = celnav.compiled(FILTERS["ukf"]), celnav.epochs(TIMES, Z)
    fixed = FixedLag(fast, 4)
    known = stepped(fast, PRIOR, epochs)[-1][0].belief
    stepped(fixed, PRIOR, epochs)
    monkeypatch.setattr("celnav.filters.sequential.joint", lambda *_, **__: pytest.fail("by numpy"))
    *_, (_, state, _) = celnav.steps(fast, PRIOR, epochs)
    np.testing.assert_array_equal(state.belief.mean, known.mean)
    np.testing.assert_array_equal(stepped(fixed, PRIOR, epochs)[-1][0].belief.mean, known.mean)


def test_measurements_that_are_none_are_refused_as_by_numpy():
    fast, state = celnav.compiled(FILTERS["ukf"]), FILTERS["ukf"].start(PRIOR)
    for z in (np.zeros(3), 4.0, (Z[0], Z[0])):
        with pytest.raises(ValueError) as by_numpy:
            FILTERS["ukf"].step(state, celnav.Epoch(z=z))
        with pytest.raises(ValueError) as refused:
            fast.step(state, celnav.Epoch(z=z))
        assert str(refused.value) == str(by_numpy.value)
