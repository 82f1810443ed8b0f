"""The study: every run behind the figures, tables and claims, from a configuration and a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.papers.aukf import analysis
from celnav.papers.aukf.config import STANDARD, Config
from celnav.papers.aukf.real import Real, real
from celnav.papers.aukf.sweeps import CASES, MAIN, STUDIES
from celnav.study.montecarlo import Outcome, Plan, Progress, Unit, blocks, carry_out, generator, run_count

INPUTS = ("rinex",)
"""Arguments of `reproduce` that a person may give on the command line: folders."""
SETTLED_S = 10.0
"""Errors of the start are not counted before."""
AFTER_S = 5.0
"""Length of what is judged after the burst."""
WINDOWS = ("quiet", "burst", "after", "all")


@dataclass(frozen=True)
class Result:
    """Everything that figures, tables, claims and recordings read.

    ``data[study]`` is what the functions of `celnav.papers.aukf.sweeps` return, errors ``(T, runs, 8)`` of estimate minus truth in
    m and m/s. ``facts`` hold what needs no Monte Carlo, ``real`` the day of a receiver (None: its files are absent), ``timings``
    CPU seconds. ``full``: whether runs and lengths are those of the configuration.
    """

    config: Config
    seed: int
    runs: int
    full: bool
    data: dict[str, dict[str, Array]]
    facts: dict[str, Any]
    real: Real | None
    timings: dict[str, float] = field(default_factory=dict)

    def times(self, interval_s: float | None = None) -> Array:
        """Epochs ``(T,)`` s, of the standard interval or another."""
        return self.config.times if interval_s is None else replace(self.config, interval_s=interval_s).times

    def window(self, name: str, interval_s: float | None = None) -> Array:
        """Mask ``(T,)`` of `WINDOWS`: before, in and after the burst, and all; also "late": the burst and after."""
        t, (start, end) = self.times(interval_s), self.config.burst_s
        settled = min(SETTLED_S, 0.5 * start)
        bounds = {
            "quiet": (settled, start), "burst": (start, end), "after": (end, end + AFTER_S), "late": (start, end + AFTER_S),
            "all": (settled, np.inf),
        }  # fmt: skip
        low, high = bounds[name]
        return np.asarray((t >= low - 1e-9) & (t < high - 1e-9))

    def squares(self, study: str, key: str, window: str, *, axis: int | None = None, interval_s: float | None = None) -> Array:
        """Mean square position error ``(runs,)`` m^2 of ``<case>/<filter>`` over a window, of an axis or of all three."""
        error = self.data[study][f"{key}/error"][self.window(window, interval_s)][..., :3]
        square = np.square(error)
        return np.asarray((square.sum(-1) if axis is None else square[..., axis]).mean(0))

    def late(self, label: str, interval_s: float, filter: str) -> Array:
        """Mean squares ``(runs,)`` in the burst and after it in the study of windows; what it leaves to the main one from there."""
        key = f"{label}/{filter}"
        if f"{key}/error" in self.data["windows"]:
            return self.squares("windows", key, "late", interval_s=interval_s)
        return self.squares("main", f"ranges/{filter}", "late")

    def peaks(self, study: str, key: str) -> Array:
        """Largest position error ``(runs,)`` m in the burst."""
        error = self.data[study][f"{key}/error"][self.window("burst")][..., :3]
        return np.asarray(np.sqrt(np.square(error).sum(-1)).max(0))

    def range_factors(self, case: str, window: str) -> Array:
        """Mean factor ``(runs,)`` of the ranges' noise in the filter of the paper."""
        factor = self.data["main"][f"{case}/aukf/factor"][self.window(window)]
        return np.asarray(factor[..., : factor.shape[-1] // 2].mean((0, 2)))

    def arrays(self) -> dict[str, Array]:
        """Arrays to store: position RMSE over the runs against time, and the first run's errors."""
        out = {"times": self.times()}
        for case in CASES:
            for name in MAIN:
                error = self.data["main"][f"{case}/{name}/error"]
                out[f"{case}/{name}/rmse"] = np.sqrt(np.square(error[..., :3]).mean(1))
                out[f"{case}/{name}/first"] = error[:, 0]
        if self.real is not None:
            out["real/times"] = self.real.log.times
            out |= {f"real/{name}": track for name, track in self.real.tracks.items()}
        return out


def _block(what: str, config: Config, seed: int, study: int, runs: range) -> dict[str, Array]:
    """One piece of work, by name."""
    return dict(STUDIES[what].function(config, [generator(seed, study, r) for r in runs]))


def _units(config: Config, seed: int, runs: int, block: int, effort: float) -> list[Unit]:
    out = []
    for number, (what, study) in enumerate(STUDIES.items()):
        count = runs if study.runs is None else min(study.runs, max(2, round(study.runs * effort)))
        out += [Unit(what, _block, (what, config, seed, number, part)) for part in blocks(count, block)]
    return out


def shortened(config: Config, effort: float) -> Config:
    """The configuration with less time before, in and after the burst."""
    if effort == 1.0:
        return config
    start, end = config.burst_s
    before = max(2.0, effort * start)
    length = max(2.0, effort * (end - start))
    return replace(config, burst_s=(before, before + length), duration_s=before + length + max(AFTER_S, effort * 20.0))


def plan(
    config: Config = STANDARD,
    *,
    runs: int | None = None,
    seed: int = 0,
    effort: float = 1.0,
    block: int = 100,
    rinex: Path | None = None,
) -> Plan[Result]:
    """The whole study, to be carried out. Pure but for the receiver's log, which is read at once: it writes no files.

    Parameters
    ----------
    config: of the runs; the smaller studies take from it what they do not set themselves.
    runs: Monte-Carlo runs without and with a burst; None: those of the configuration, times ``effort``.
    seed: see `celnav.study.montecarlo`.
    effort: in (0, 1]; scales runs and, as they have 900 epochs, their lengths too.
    block: runs of each case computed together at most. It changes no result beyond round-off.
    rinex: folder of a station's observation and navigation file; None: ``rinex`` here, if there is one.

    Raises
    ------
    ValueError: naming an argument that cannot be. InputError, OSError: naming a file that cannot be used.
    """
    count = run_count(config.runs, runs, effort)
    whole, config = config, shortened(config, effort)
    start = process_time()
    day = real(config, generator(seed, 60, 0), rinex)  # first: a file that cannot be used is then told at once
    seconds = process_time() - start

    def result(outcomes: Mapping[str, Outcome]) -> Result:
        timings = {"cpu_s real day": seconds} | {f"cpu_s {label}": outcome.cpu_s for label, outcome in outcomes.items()}
        start = process_time()
        facts = analysis.facts(whole, seed)
        timings |= {"cpu_s facts": process_time() - start, **analysis.step_times(config)}
        data = {label: outcome.arrays for label, outcome in outcomes.items()}
        return Result(config, seed, count, effort == 1.0 and count >= config.runs, data, facts, day, timings)

    return Plan(_units(config, seed, count, block, effort), result)


def reproduce(config: Config = STANDARD, *, jobs: int = 1, progress: Progress | None = None, **options: Any) -> Result:
    """Carry out `plan` in ``jobs`` processes; the other arguments are those of `plan`."""
    return carry_out(plan(config, **options), jobs=jobs, progress=progress)
