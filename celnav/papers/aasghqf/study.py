"""The study: every run behind the figures, tables and claims, from a configuration and a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from time import process_time
from typing import Any

import numpy as np

from celnav.filters.records import Epoch, Filter, FromFunctions
from celnav.filters.run import run
from celnav.filters.sequential import ekf
from celnav.gaussian.belief import Gaussian, nees
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule
from celnav.gaussian.sparse_grid import smolyak
from celnav.papers.aasghqf import analysis, errata, scenario
from celnav.papers.aasghqf.config import MICRO_G, PRESETS, T3, A, Config
from celnav.study.montecarlo import Outcome, Plan, Progress, Unit, blocks, carry_out, generator, run_count

COMPARED = ("ukf", "sghqf", "aasghqf")
"""The paper's three filters."""
CASES: dict[str, tuple[str, ...]] = {
    "T3": (*COMPARED, "nonlinear", "ghqf3", "triad-ekf"),
    "A": (*COMPARED, "nonlinear", "ckf", "ckf5", "ekf", "iekf", "triad-ekf"),
    "A-slow": (*COMPARED, "nonlinear", "delayed", "ckf", "ckf5", "ghqf3", "ekf", "iekf", "triad-ekf"),
    "T3-arcmin": COMPARED,
}
"""Preset -> filters run on it."""
START = ("ukf", "sghqf", "aasghqf", "nonlinear", "level4", "delayed", "ckf", "ckf5", "ghqf3", "ghqf5", "ekf", "triad-ekf")
"""Filters whose first star fix is studied over the size of the misalignment."""
CYCLES = ("ukf", "nonlinear", "aasghqf", "sghqf")


def units(config: Config) -> Array:
    """From radians and SI to the units of figures and tables, ``(13,)``: deg, m/s, m, deg/h, micro g."""
    degrees = np.degrees(1.0)
    return np.concatenate([np.full(3, degrees), np.ones(2), config.meters, np.full(3, 3600.0 * degrees), np.full(3, 1.0 / MICRO_G)])


@dataclass(frozen=True)
class Result:
    """Everything that figures, tables, claims and recordings read.

    ``data[preset][name]`` are arrays ``(T, runs, ...)``: ``<filter>/error`` (13; deg, m/s, m, deg/h, micro g), ``<filter>/std``
    of the first run, ``<filter>/nees``, ``<filter>/redone`` and ``<filter>/failed`` counts ``(1, runs)``; ``start/<deg>`` holds the
    NEES after the first star fix. ``facts`` hold what needs no simulation, ``timings`` CPU seconds.
    """

    config: Config
    seed: int
    runs: int
    full: bool
    data: dict[str, dict[str, Array]]
    facts: dict[str, Any]
    timings: dict[str, float] = field(default_factory=dict)

    def times(self, preset: str = "T3") -> Array:
        """Epochs ``(T,)`` s."""
        return np.asarray(self.config.step_s * np.arange(len(self.data[preset]["ukf/nees"])))

    def arrays(self) -> dict[str, Array]:
        """Arrays to store: RMSE over the runs, mean NEES, and the first run's errors and deviations."""
        out = {"times": self.times()}
        for preset, names in CASES.items():
            for name in names:
                data, key = self.data[preset], f"{preset}/{name}"
                out[f"{key}/rmse"] = np.sqrt(np.square(data[f"{name}/error"]).mean(1))
                out[f"{key}/nees"] = data[f"{name}/nees"].mean(1)
                out[f"{key}/first/error"], out[f"{key}/first/std"] = data[f"{name}/error"][:, 0], data[f"{name}/std"][:, 0]
        return out


def _run(name: str, filter: Filter, sim: scenario.Scenario, out: dict[str, Array]) -> None:
    """Run a filter over a batch and file its errors, NEES, events, and the deviations of the first run."""
    scale = units(sim.config)

    def also(epoch: Epoch, state: Any, info: Any) -> dict[str, Any]:  # noqa: ARG001
        belief = state.belief
        error = belief.mean - epoch.truth
        return {"error": error * scale, "nees": nees(error, belief.sqrt_cov), "std": belief.std[:1] * scale, "cov": belief.cov[:1]}

    track = run(filter, sim.prior, sim.epochs(), keep="nothing", also=also, on_failure="flag")
    out |= {f"{name}/{key}": value for key, value in track.extra.items()}
    out[f"{name}/redone"] = np.broadcast_to(track.events["redone"], sim.prior.mean.shape[:1])[None].astype(float)
    out[f"{name}/failed"] = (track.failed_at >= 0)[None].astype(float)


def bound_filter(config: Config) -> Filter:
    """The extended filter linearized at the truth: its covariance is the conditional Cramer-Rao bound, its mean the truth."""
    motion, sensor = scenario.model(config)
    parts = ekf(motion, sensor, form=scenario.FORM)

    def step(state: Any, epoch: Epoch) -> tuple[Any, Any]:
        # Measurements as the prediction would have them: the update then moves nothing but the covariance.
        missing = np.where(np.isnan(epoch.z), np.nan, 0.0)
        z = scenario.measurement(epoch.truth[None], epoch)[0] + missing
        after, infos = parts.step(state, epoch._replace(z=z))
        return after._replace(belief=after.belief._replace(mean=epoch.truth)), infos

    return FromFunctions(parts.start, step)


def _case(config: Config, seed: int, study: int, runs: range, names: tuple[str, ...], bound: bool) -> dict[str, Array]:
    sim = scenario.simulate(config, [generator(seed, study, r) for r in runs])
    known = scenario.filters(config)
    out: dict[str, Array] = {"truth": sim.truth[:, :1], "z": sim.z[:, :1]}
    for name in names:
        _run(name, known[name], sim, out)
    if bound:
        stds = run(bound_filter(config), Gaussian(sim.truth[0], sim.prior.cov), sim.epochs(), keep="std").std
        assert stds is not None
        out["bound/std"] = stds * units(config)
    return out


def _start(config: Config, seed: int, study: int, runs: range) -> dict[str, Array]:
    """NEES after the first star fix for each of `START`, and whether the update was done again."""
    short = replace(config, steps=1, star_interval=1, sar_interval=10)
    sim = scenario.simulate(short, [generator(seed, study, r) for r in runs])
    epoch = next(iter(sim.epochs()))
    known = scenario.filters(short)
    known["level4"] = scenario.quadrature_filter(smolyak(13, 4, [1] * 3 + [3] * 10), short)
    out: dict[str, Array] = {}
    for name in START:
        state, (info,) = known[name].step(known[name].start(sim.prior), epoch)
        out[f"{name}/nees"] = nees(state.belief.mean - epoch.truth, state.belief.sqrt_cov)[None]
        redone = np.zeros(len(runs)) if info.redone is None else np.broadcast_to(info.redone, (len(runs),))
        out[f"{name}/redone"] = redone[None].astype(float)
    return out


def _coarse(config: Config, seed: int, study: int, runs: range) -> dict[str, Array]:
    """Largest differences, in deviations, of rules that must agree: 43 to 75 points over the flight, 57 to 417 in 50 s."""
    sim = scenario.simulate(config, [generator(seed, study, r) for r in runs])
    known = scenario.filters(config)
    known["43"] = scenario.quadrature_filter(smolyak(13, 3, [1, 1] + [2] * 11), config)
    tracks = {n: run(known[n], sim.prior, sim.epochs(), on_failure="flag") for n in ("43", "aasghqf", "nonlinear", "sghqf")}

    def apart(a: str, b: str, last: int | None) -> Array:
        one, two = tracks[a], tracks[b]
        assert one.mean is not None
        assert two.mean is not None
        assert two.std is not None
        return np.asarray((np.abs(one.mean - two.mean) / two.std)[:last].max((0, 2)))[None]

    return {"43-75": apart("43", "aasghqf", None), "57-417": apart("nonlinear", "sghqf", 51)}


def _block(rule: Any, block: int) -> int:
    """Runs at once: few of them for rules of many points, which then stay in cache."""
    return min(block, 25) if isinstance(rule, Rule) and len(rule.nodes) > 100 else block


def _units(config: Config, seed: int, runs: int, block: int) -> list[Unit]:
    out: list[Unit] = []
    presets = {name: replace(preset, steps=min(preset.steps, config.steps)) for name, preset in PRESETS.items()}
    for study, (name, names) in enumerate(CASES.items()):
        sizes = {n: _block(scenario.rules().get(n), block) for n in names}
        for size in sorted(set(sizes.values())):
            group = tuple(n for n in names if sizes[n] == size)
            for part in blocks(runs, size):
                arguments = (presets[name], seed, study, part, group, name == "A" and group[0] == names[0])
                out.append(Unit(f"{name}/{size}", _case, arguments))
    for i, degrees in enumerate(analysis.MISALIGNMENTS_DEG):
        preset = replace(A, misalignment_deg=(degrees,) * 3)
        for part in blocks(runs, block):
            out.append(Unit(f"start/{degrees:g}", _start, (preset, seed, 10 + i, part)))
    few = max(1, min(5, runs))
    out.append(Unit("coarse", _coarse, (replace(presets["A"], steps=min(60, config.steps)), seed, 30, range(few))))
    return out


def cycle_times(config: Config) -> dict[str, float]:
    """CPU seconds of a cycle (predict and update): of one run alone, and of one run among 50."""
    out = {}
    short = replace(config, steps=20)
    for runs in (1, 50):
        sim = scenario.simulate(short, [generator(0, 98, r) for r in range(runs)])
        epochs = list(sim.epochs())
        known = scenario.filters(short)
        for name in CYCLES:
            times = []
            for _ in range(3):
                start = process_time()
                run(known[name], sim.prior, epochs, keep="nothing")
                times.append((process_time() - start) / (short.steps * runs))
            out[f"cycle {name}, {runs} run{'s' if runs > 1 else ''}, s"] = min(times)
    return out


def plan(
    config: Config = T3,
    *,
    runs: int | None = None,
    seed: int = 0,
    effort: float = 1.0,
    block: int = 64,
) -> Plan[Result]:
    """The whole study, to be carried out. Pure: reads and writes no files.

    Parameters
    ----------
    config: gives runs, steps and the deterministic analysis; the presets run as they are.
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
        facts: dict[str, Any] = {
            "observability": analysis.observe(config),
            "mean_error": {n: analysis.mean_error(scenario.rules()[n], 10.0, config) for n in (*COMPARED, "nonlinear")},
            "root_errors": analysis.root_errors(config, generator(seed, 50, 0)),
            "first_fixes": analysis.first_fixes(config),
            "growth": analysis.growth(),
            "adapted": analysis.adapted(A),
            "small": analysis.small_misalignment(A),
            "mechanization": {d: errata.against_mechanization(config, d) for d in ((20.0, -15.0, 40.0), (2.0, -1.5, 4.0))},
        }
        timings = {f"cpu_s {label}": outcome.cpu_s for label, outcome in outcomes.items()}
        timings |= {"cpu_s analysis": process_time() - start, **cycle_times(A)}
        data: dict[str, dict[str, Array]] = {}
        for label, outcome in outcomes.items():
            name = label if label.startswith("start") else label.split("/")[0]
            data[name] = data.get(name, {}) | outcome.arrays
        return Result(config, seed, count, count >= config.runs, data, facts, timings)

    return Plan(_units(config, seed, count, block), result)


def reproduce(config: Config = T3, *, jobs: int = 1, progress: Progress | None = None, **options: Any) -> Result:
    """Carry out `plan` in ``jobs`` processes; the other arguments are those of `plan`."""
    return carry_out(plan(config, **options), jobs=jobs, progress=progress)
