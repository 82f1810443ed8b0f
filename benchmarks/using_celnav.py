"""celnav: each function makes a `Work`, a pass that is timed and returns its estimates."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import celnav
from benchmarks.problems import linear_matrix, measurements, problem
from celnav.models import orbit

Work = Callable[[], Any]


def filter_of(name: str, form: str = "square root") -> Any:
    """The unscented filter of a problem; the Kalman filter of a linear one."""
    given = problem(name)
    sensor = celnav.Sensor(given.H, given.R)
    if name.startswith("linear"):
        F = linear_matrix(len(given.mean))
        return celnav.ekf(celnav.Motion(F, given.Q), sensor, form=form)
    step = partial(orbit.step, dt=1.0) if name == "orbit" else given.step(np)
    return celnav.ukf(celnav.Motion(lambda x, _epoch: step(x), given.Q), sensor, form=form)


def data_of(name: str, runs: int, epochs: int) -> tuple[Any, Any, Any]:
    """Prior, times and measurements."""
    given = problem(name)
    prior = celnav.Gaussian(given.mean, given.P)
    return prior, np.arange(float(epochs)), measurements(given, runs, epochs)


def run(name: str, runs: int, epochs: int, engine: str, form: str = "square root") -> Work:
    """`celnav.run`, with an engine by name."""
    filter, data = filter_of(name, form), data_of(name, runs, epochs)
    return lambda: celnav.run(filter, *data, engine=engine).mean


def compiled(
    name: str, runs: int, epochs: int, form: str = "square root", keep: str = "std", jobs: int = 1
) -> Work:
    """Machine code, which is kept from pass to pass."""
    fast, data = celnav.compiled(filter_of(name, form), jobs=jobs), data_of(name, runs, epochs)
    return lambda: fast.run(*data, keep=keep).mean


# -- a stream --------------------------------------------------------------------------------------
def step(engine: str, lag: int = 0) -> Work:
    """One orbit, one step at a time, by hand; with a lag the filter keeps so many epochs."""
    filter, (prior, times, z) = filter_of("orbit"), data_of("orbit", 1, 300)
    if engine == "compiled":
        filter = celnav.compiled(filter)
    if lag:
        filter = celnav.filters.fixed_lag.FixedLag(filter, lag)
    epochs = list(celnav.epochs(times, z))

    def work() -> Any:
        state = filter.start(prior)
        means = []
        for epoch in epochs:
            state, _ = filter.step(state, epoch)
            means.append(state.belief.mean)
        return np.array(means)

    return work


def steps(engine: str) -> Work:
    """The same by `celnav.steps`."""
    filter, (prior, times, z) = filter_of("orbit"), data_of("orbit", 1, 300)
    if engine == "compiled":
        filter = celnav.compiled(filter)
    epochs = celnav.epochs(times, z)
    return lambda: np.array([s.belief.mean for _, s, _ in celnav.steps(filter, prior, epochs)])


# -- smoothing -------------------------------------------------------------------------------------
def smooth(runs: int, epochs: int, engine: str) -> Work:
    """The filter, then the smoother backwards."""
    filter, data = filter_of("orbit"), data_of("orbit", runs, epochs)
    forward = partial(celnav.run, filter, engine="numpy")
    options = {"engine": engine}
    if engine == "compiled":
        forward = celnav.compiled(filter).run
        try:
            celnav.smooth(forward(*data, keep="cov"), **options)
        except TypeError:  # celnav 0.2 smooths by numpy alone
            options = {}
    return lambda: celnav.smooth(forward(*data, keep="cov"), **options).mean


def iterated(runs: int, epochs: int, engine: str) -> Work:
    """Three passes of the iterated smoother."""
    filter, data = filter_of("orbit"), data_of("orbit", runs, epochs)
    return lambda: celnav.iterated_smoother(filter, *data, iterations=3, engine=engine).mean


# -- simulation and campaigns ----------------------------------------------------------------------
def simulate(runs: int, epochs: int) -> Work:
    """Truth and measurements of pendulums; each run has a generator of its own."""
    given = problem("pendulum")
    swing = given.step(np)
    motion = celnav.Motion(lambda x, _epoch: swing(x), given.Q)
    sensor = celnav.Sensor(given.H, given.R)
    prior, times = celnav.Gaussian(given.mean, given.P), np.arange(float(epochs))

    def work() -> None:
        celnav.simulate(motion, sensor, prior, times, runs=runs)

    return work


def campaign(engine: str) -> Work:
    """A unit of a campaign: 100 runs of 600 epochs, simulated, filtered and judged."""
    from celnav.campaign.missions import study
    from celnav.campaign.units import units_of

    mission = {"paper": "csrukf", "filters": ["csrukf+z0"], "runs": 100_000, "engine": engine}
    work = study(mission | {"config": {"phi": 0.8, "steps": 600}})
    units = iter([unit for units in units_of(work) for unit in units])

    def one() -> None:
        next(units).do()

    return one
