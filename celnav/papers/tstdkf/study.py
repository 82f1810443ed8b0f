"""The study: every run behind the figures, tables and claims, from a configuration and a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from time import process_time
from typing import Any

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.papers.tstdkf import analysis, sweeps, year
from celnav.papers.tstdkf.config import PRESETS, TABLE_5, Config
from celnav.study.montecarlo import Outcome, Plan, Progress, Unit, blocks, carry_out, generator, run_count

PAPER = ("ekf", "tkf", "tstdkf")
COMPARED = ("ekf", "tkf", "tdkf", "tstdkf", "aug")
FAIR = ("ekf-fair", "tkf-fair")


@dataclass(frozen=True)
class Result:
    """Everything that figures, tables, claims and recordings read.

    ``data["table 5"]``: for each setting and filter, ``1/tkf/...``: squared errors ``position``, ``velocity`` and ``bias`` ``(K,
    runs)`` in km^2 and (km/s)^2 after each timing, and of the first run of setting 1 what a recording needs; see
    `celnav.papers.tstdkf.follow`. The other entries are what the functions of `celnav.papers.tstdkf.sweeps` and
    `celnav.papers.tstdkf.year` return. ``facts`` hold what needs no Monte Carlo, ``timings`` CPU seconds. ``full``: whether runs
    and lengths are those of the paper.
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
        """Seconds since the start of each timing, ``(K,)``."""
        return self.config.step_s * np.arange(1, self.config.steps + 1)

    def squares(self, filter: str, what: str, setting: int = 1) -> Array:
        """Squared errors ``(K, runs)``."""
        return self.data["table 5"][f"{setting}/{filter}/{what}"]

    def arrays(self) -> dict[str, Array]:
        """Arrays to store: RMSE over the runs against time, and mean squares of each run over the whole."""
        out = {"times": self.times}
        for key, value in self.data["table 5"].items():
            if key.rpartition("/")[2] in ("position", "velocity", "bias") and value.ndim == 2:
                out[f"{key}/rmse"], out[f"{key}/run"] = np.sqrt(value.mean(1)), value.mean(0)
        for name in year.NAMES:
            out[f"year/{name}/bias"] = self.data["year"][f"{name}/bias"]
        return out | {"year/times": self.data["year"]["times"][:, 0], "year/bias": self.data["year"]["bias"]}


def _month(config: Config, seed: int, runs: range, few: int) -> dict[str, Array]:
    """The settings; the variants in the first runs only."""
    return sweeps.month(config, *([generator(seed, study, r) for r in part] for study, part in ((0, runs), (1, runs[:few]))))


def _smaller(what: str, config: Config, seed: int, runs: int) -> dict[str, Array]:
    """One of the other studies, by name."""
    study = sweeps.STUDIES[what]
    return dict(study.function(config, [generator(seed, study.number, r) for r in range(runs)]))


def _units(config: Config, seed: int, runs: int, block: int, effort: float) -> list[Unit]:
    """The longest first."""
    few, out = max(2, round(sweeps.FEW * effort)), []
    for part in blocks(runs, block):
        out.append(Unit("month", _month, (config, seed, part, max(0, few - part.start))))
    for what, study in sweeps.STUDIES.items():
        base = PRESETS["year"] if study.year else config
        short = replace(base, days=_days(min(study.days, 365.0 if study.year else config.days), effort))
        out.append(Unit(what, _smaller, (what, short, seed, max(2, round(study.runs * effort)))))
    return out


def _days(days: float, effort: float) -> float:
    """A length scaled, in whole timings of at least half a day."""
    return min(days, max(0.5, round(days * effort * 288.0) / 288.0))


def plan(
    config: Config = TABLE_5,
    *,
    runs: int | None = None,
    seed: int = 0,
    effort: float = 1.0,
    block: int = 50,
) -> Plan[Result]:
    """The whole study, to be carried out. Pure: reads and writes no files.

    Parameters
    ----------
    config: of the runs; the smaller studies take from it what they do not set themselves.
    runs: Monte-Carlo runs of each setting; None: those of the configuration, times ``effort``.
    seed: see `celnav.study.montecarlo`.
    effort: in (0, 1]; scales runs and, as a month in steps of five minutes is long, the days too.
    block: runs of each setting computed together at most. It changes no result beyond round-off.

    Raises
    ------
    ValueError: naming an argument that cannot be.
    """
    count = run_count(config.runs, runs, effort)
    whole, config = config, replace(config, days=_days(config.days, effort))

    def result(outcomes: Mapping[str, Outcome]) -> Result:
        start = process_time()
        facts = analysis.facts(config)
        timings = {f"cpu_s {label}": outcome.cpu_s for label, outcome in outcomes.items()}
        timings["cpu_s facts"] = process_time() - start
        data: dict[str, dict[str, Array]] = {}
        for outcome in outcomes.values():
            for key, values in outcome.arrays.items():
                study, _, rest = key.partition("/")
                data.setdefault(study, {})[rest] = values
        return Result(config, seed, count, count >= whole.runs and config.days >= whole.days, data, facts, timings)

    return Plan(_units(config, seed, count, block, effort), result)


def reproduce(config: Config = TABLE_5, *, jobs: int = 1, progress: Progress | None = None, **options: Any) -> Result:
    """Carry out `plan` in ``jobs`` processes; the other arguments are those of `plan`."""
    return carry_out(plan(config, **options), jobs=jobs, progress=progress)
