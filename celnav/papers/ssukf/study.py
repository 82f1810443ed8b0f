"""The study: every run behind the figures, tables and claims, from a configuration and a seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import process_time
from typing import Any

import numpy as np

from celnav.filters.records import Filter
from celnav.filters.run import run
from celnav.gaussian.belief import Gaussian, nees
from celnav.gaussian.linalg import Array
from celnav.papers.ssukf import checks, draws, scenario, theory, vector
from celnav.papers.ssukf.config import ARCSEC, PRESETS, STANDARD, UNITS, Config
from celnav.papers.ssukf.variants import spin
from celnav.study.montecarlo import Outcome, Plan, Progress, Unit, blocks, carry_out, generator, run_count

PAPER = ("aukf", "ssukf", "mekf")
"""Filters run from the paper's initial error."""
DRAWN = {"ssukf": np.inf, "aukf": 60.0, "usque": 60.0, "mekf": 60.0}
"""Filters run from initial errors drawn from the prior, and for how long (s): in the end all of them are one filter."""
TIMED = ("aukf", "ssukf", "additive", "mekf")


@dataclass(frozen=True)
class Result:
    """Everything that figures, tables, claims and recordings read.

    ``data["paper"]`` and ``data["drawn"]`` (initial errors of the paper, or drawn from the prior) hold arrays ``(T, runs, ...)``
    at the star epochs, ``<filter>/...``: ``error`` (6: rotation vector in arcsec, drift in deg/h), ``euler`` (3: roll, pitch, yaw
    in arcsec), ``nees``, ``nis``, and of the first run ``std`` (6, as the errors), ``mean`` and ``cov``. The other entries are what
    the functions of `celnav.papers.ssukf.checks` and `celnav.papers.ssukf.vector` return. ``facts`` hold what needs no Monte
    Carlo, ``timings`` CPU seconds.
    """

    config: Config
    seed: int
    runs: int
    full: bool
    data: dict[str, dict[str, Array]]
    facts: dict[str, Any]
    timings: dict[str, float] = field(default_factory=dict)

    @property
    def times(self) -> Array:
        """Star epochs ``(T,)`` s, the start first."""
        return np.asarray(np.arange(len(self.data["paper"]["aukf/nees"])) / self.config.star_hz)

    def at(self, seconds: float) -> int:
        """The star epoch at a time, or the last one of a shorter study."""
        return min(round(seconds * self.config.star_hz), len(self.times) - 1)

    def arrays(self) -> dict[str, Array]:
        """Arrays to store: RMSE over the runs, mean NEES and NIS, and the first run's errors and deviations."""
        out = {"times": self.times}
        for kind, names in (("paper", PAPER), ("drawn", DRAWN)):
            data = self.data[kind]
            for name in names:
                key = f"{kind}/{name}"
                out[f"{key}/rmse"] = np.sqrt(np.square(data[f"{name}/error"]).mean(1))
                out[f"{key}/nees"], out[f"{key}/nis"] = data[f"{name}/nees"].mean(1), data[f"{name}/nis"].mean(1)
                if kind == "paper":
                    out[f"{key}/first/error"], out[f"{key}/first/std"] = data[f"{name}/error"][:, 0], data[f"{name}/std"][:, 0]
        for name in vector.FILTERS:
            for degrees in vector.PRIORS_DEG:
                error = self.data["vector"][f"{name}/{degrees:g}/error"]
                out[f"vector/{name}/{degrees:g}/rmse"] = np.sqrt(np.square(error).mean(1))
        return out


def compare(config: Config, rngs: Sequence[np.random.Generator], names: Sequence[str] = ("aukf", "ssukf")) -> dict[str, Array]:
    """Filters on simulated runs of a configuration, from the paper's initial error; see `Result`.

    ``PRESETS["100 Hz"]`` with 200 generators is the paper's own rate in full: 60,000 time updates of 200 runs for each filter.
    """
    sim = scenario.simulate(config, rngs)
    known, out = scenario.filters(config), {"truth": sim.truth[:, :1], "stars": sim.stars[:, :1]}
    for name in names:
        out |= _follow(name, known[name], sim, sim.prior)
    return out


def _follow(name: str, filter: Filter, sim: scenario.Scenario, prior: Gaussian) -> dict[str, Array]:
    every = len(sim.gyro) // (len(sim.truth) - 1)
    track = run(filter, prior, sim.epochs(), keep="cov", every=every)
    assert track.mean is not None
    assert track.std is not None
    error = scenario.errors(sim.truth, track.mean)
    out = {
        "error": error / UNITS,
        "euler": scenario.euler_errors(sim.truth, track.mean) / ARCSEC,
        "nees": nees(error, track.sqrt_cov),
        "nis": track.nis,
        "std": track.std[:, :1] / UNITS,
        "mean": track.mean[:, :1],
        "cov": track.cov[:, :1],
    }
    return {f"{name}/{key}": value for key, value in out.items()}


def _main(config: Config, rngs: Sequence[np.random.Generator]) -> dict[str, Array]:
    """The paper's initial errors and drawn ones on the same noise: ``paper/...`` and ``drawn/...``; one batch where it can be."""
    sim, known = scenario.simulate(config, rngs), scenario.filters(config)
    both = scenario.repeated(sim, 2)
    prior = Gaussian(np.concatenate([sim.prior.mean, sim.drawn.mean]), both.prior.cov)
    out = {"paper/truth": sim.truth[:, :1], "paper/stars": sim.stars[:, :1]}
    for name in dict.fromkeys([*PAPER, *DRAWN]):
        whole = DRAWN[name] >= config.duration_s
        if name in PAPER and whole:
            for key, value in _follow(name, known[name], both, prior).items():
                parts = (value, value) if value.shape[1] == 1 else np.split(value, 2, 1)
                out[f"paper/{key}"], out[f"drawn/{key}"] = parts
            continue
        if name in PAPER:
            out |= {f"paper/{key}": value for key, value in _follow(name, known[name], sim, sim.prior).items()}
        part = sim.shortened(DRAWN[name])
        out |= {f"drawn/{key}": value for key, value in _follow(name, known[name], part, sim.drawn).items()}
    return out


def by_kind(arrays: dict[str, Array]) -> dict[str, dict[str, Array]]:
    """``paper/...`` and ``drawn/...`` taken apart."""
    out: dict[str, dict[str, Array]] = {}
    for key, value in arrays.items():
        kind, _, name = key.partition("/")
        out.setdefault(kind, {})[name] = value
    return out


def _vector_steps(config: Config) -> int:
    """As much of the 1000 s as the study has of its 600 s."""
    return max(101, round(vector.STEPS * min(1.0, config.duration_s / STANDARD.duration_s)))


def _block(what: str, config: Config, seed: int, study: int, runs: range) -> dict[str, Array]:
    """One piece of work, by name."""
    rngs = [generator(seed, study, r) for r in runs]
    functions: dict[str, Any] = {
        "runs": lambda: _main(config, rngs),
        "vector": lambda: vector.compare(config, rngs, steps=_vector_steps(config)),
        "vector, short": lambda: vector.compare(config, rngs, ("aukf", "ssukf, c = 15", "usque", "ssukf, c = 7"), 100),
        "identities": lambda: checks.identities(config, rngs),
        "rates": lambda: checks.rates(config, rngs),
        "variants": lambda: checks.variants(config, rngs),
        "alphas": lambda: checks.alphas(config, rngs),
        "priors": lambda: checks.priors(config, rngs),
        "turns": lambda: checks.turns(config, rngs),
        "linear": lambda: checks.linear(config, rngs),
    }
    return dict(functions[what]())


SHORT: dict[str, tuple[float, int]] = {
    "identities": (3.0, 20),
    "rates": (20.0, 20),
    "variants": (30.0, 50),
    "alphas": (60.0, 10),
    "priors": (60.0, 20),
    "turns": (1.0, 100),
    "linear": (100.0, 5),
    "vector": (0.0, vector.RUNS),
    "vector, short": (0.0, 20),
}
"""Seconds and runs at most of the smaller studies; those of `vector` have their own length."""


def _units(config: Config, seed: int, runs: int, block: int, effort: float) -> list[Unit]:
    out = [Unit("runs", _block, ("runs", config, seed, 0, part)) for part in blocks(runs, block)]
    for study, (what, (seconds, most)) in enumerate(SHORT.items(), start=1):
        few = replace(config, duration_s=min(seconds, config.duration_s)) if seconds else config
        count = max(2, round(most * effort))
        out.append(Unit(what, _block, (what, few, seed, study, range(count))))
    return out


def time_filters(config: Config, rounds: int = 3) -> dict[str, float]:
    """CPU seconds from one star sample to the next, by filter, rates and runs; the smallest of interleaved rounds."""
    out: dict[str, float] = {}
    for per, runs, stars in ((1, 1, 20), (1, 500, 2), (config.ratio, 1, 1)):
        short = replace(config, preintegrated=per == 1, duration_s=stars / config.star_hz)
        sim = scenario.simulate(short, [generator(0, 99, r) for r in range(runs)])
        epochs, known = list(sim.epochs()), scenario.filters(short)
        best = dict.fromkeys(TIMED, np.inf)
        for _ in range(rounds):
            for name in TIMED:
                start = process_time()
                run(known[name], sim.prior, epochs, keep="nothing")
                best[name] = min(best[name], (process_time() - start) / stars)
        out |= {f"{name}, {per}:1, {runs} run{'s' if runs > 1 else ''}, s": value for name, value in best.items()}
    return out


def plan(
    config: Config = STANDARD,
    *,
    runs: int | None = None,
    seed: int = 0,
    effort: float = 1.0,
    block: int = 100,
) -> Plan[Result]:
    """The whole study, to be carried out. Pure: reads and writes no files.

    Parameters
    ----------
    config: of the runs; the smaller studies take from it what they do not set themselves.
    runs: Monte-Carlo runs; None: those of the configuration, times ``effort``.
    seed: see `celnav.study.montecarlo`.
    effort: in (0, 1].
    block: runs computed together at most. It changes no result.

    Raises
    ------
    ValueError: naming an argument that cannot be.
    """
    count = run_count(config.runs, runs, effort)

    def result(outcomes: Mapping[str, Outcome]) -> Result:
        start = process_time()
        minute = replace(config, duration_s=min(60.0, config.duration_s))
        facts: dict[str, Any] = {
            "exact": theory.exact_deviations(config),
            "readings": [(r, theory.limit(r.gyro, config.sigma_n, 1.0 / config.star_hz)) for r in theory.readings(config)],
            "correlated": draws.correlated([generator(seed, 20, i) for i in range(len(draws.CORRELATIONS))]),
            "multiplied": draws.multiplied(generator(seed, 21, 0)),
            "spin": spin(config, [generator(seed, 22, r) for r in range(20)]),
            "total covariance": checks.total_covariance(minute, generator(seed, 23, 0)),
            "dead": checks.dead_points(config),
            "evaluations": {1: checks.evaluations(STANDARD), 25: checks.evaluations(PRESETS["100 Hz"])},
        }
        timings = {f"cpu_s {label}": outcome.cpu_s for label, outcome in outcomes.items()}
        timings["cpu_s facts"] = process_time() - start
        timings |= time_filters(config)
        data = {label: outcome.arrays for label, outcome in outcomes.items() if label != "runs"} | by_kind(outcomes["runs"].arrays)
        return Result(config, seed, count, count >= config.runs, data, facts, timings)

    return Plan(_units(config, seed, count, block, effort), result)


def reproduce(config: Config = STANDARD, *, jobs: int = 1, progress: Progress | None = None, **options: Any) -> Result:
    """Carry out `plan` in ``jobs`` processes; the other arguments are those of `plan`."""
    return carry_out(plan(config, **options), jobs=jobs, progress=progress)
