"""Work units: what a process does at a time, here a block of runs of one configuration, all filters on the same noise."""

from __future__ import annotations

import hashlib
import json
import platform
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from time import process_time
from typing import Any, Protocol

import numpy as np

from celnav.campaign.missions import Study
from celnav.campaign.scores import Failure, Scores, check_scores, merge, score
from celnav.filters.run import ENGINE, repeated
from celnav.gaussian.linalg import Array
from celnav.lazy import needed_by
from celnav.papers import load
from celnav.papers.own import identity, place
from celnav.store import Keyed, code
from celnav.study.montecarlo import blocks, generator
from celnav.study.trial import Noiseless, Trial, bound, follow
from celnav.tape.cuda import CudaError

with needed_by("a campaign or a mission", "papers"):
    from threadpoolctl import threadpool_limits

__all__ = [
    "STUDY",
    "Result",
    "Unit",
    "VersionError",
    "Work",
    "WorkError",
    "execute",
    "pack",
    "units_of",
    "unpack",
]

STUDY = 0
"""Of `celnav.study.montecarlo.generator`, for all configurations: they share their random numbers, so differences are sharp."""
EXPECTED = 8
"""Units with equal filters that a worker is taken to do; not counted, for the engine of a unit must not depend on the others."""


class WorkError(RuntimeError):
    """Work that could not be done."""


class VersionError(WorkError):
    """A worker runs another celnav than the one that handed out the work."""


class Work(Keyed, Protocol):
    """A unit of any kind: the engine hands it out, the store keeps what it gives."""

    @property
    def title(self) -> str:
        """What it is, for people."""

    def do(self) -> dict[str, Array]:
        """The result, as arrays by name."""


@dataclass(frozen=True)
class Unit:
    """Runs ``first`` to ``last - 1`` of a configuration, which are scored and forgotten."""

    paper: str
    config: Any
    filters: tuple[str, ...]
    seed: int
    first: int
    last: int
    every: int
    settle_s: float | None
    limits: tuple[tuple[str, float], ...]
    engine: str = "auto"

    @property
    def key(self) -> str:
        """Hash of everything that determines the result, but the code."""
        table = asdict(self)
        table["config"].pop("runs")  # how many there are in all matters to none of them
        table["paper"] = identity(self.paper)
        text = json.dumps(table, sort_keys=True, ensure_ascii=False)
        return hashlib.sha256(text.encode("utf-8")).hexdigest()[:24]

    @property
    def title(self) -> str:
        """Runs and key."""
        return f"runs {self.first} to {self.last - 1} of unit {self.key}"

    @property
    def runs(self) -> int:
        """How many."""
        return self.last - self.first

    def do(self) -> dict[str, Array]:
        """Arrays of the `Result`. Exceptions of models and filters are failures of their runs."""
        token = ENGINE.set(self.engine)
        try:
            with warnings.catch_warnings(), repeated(EXPECTED):
                warnings.simplefilter("ignore")  # said once, where the study is read
                return pack(_Flight(self).result())
        finally:
            ENGINE.reset(token)

    def check(self, arrays: dict[str, Array]) -> None:
        """Raise ValueError unless a `Result` can be made of them."""
        unpack(arrays, self.filters)


@dataclass(frozen=True, eq=False)
class Result:
    """What a unit comes to.

    Attributes
    ----------
    groups: name and unit of what is judged; empty if nothing could be simulated.
    scores: of each filter that has a run left. failures: of each filter; none of a filter that the configuration does not have.
    bound: mean squares ``(K, groups)``, in the unit of the first runs only.
    cpu_s, steps: of each filter: CPU seconds, and run-steps done in them.
    trace: where the first exception came from, if there was one.
    """

    groups: tuple[tuple[str, str], ...]
    scores: dict[str, Scores]
    failures: dict[str, list[Failure]]
    bound: Array | None
    cpu_s: dict[str, float]
    steps: dict[str, int]
    trace: str = ""


def units_of(study: Study) -> list[list[Unit]]:
    """Units of each configuration, in the order in which they are merged."""
    limits = tuple(sorted(study.limits.items()))
    return [
        [
            Unit(
                study.paper,
                point.config,
                study.filters,
                study.seed,
                part.start,
                part.stop,
                study.every,
                study.settle_s,
                limits,
                study.engine,
            )
            for part in blocks(study.runs, study.block)
        ]
        for point in study.configurations
    ]


def execute(unit: Work, made_by: dict[str, str]) -> dict[str, Array]:
    """Do a unit, on one thread of linear algebra: the same numbers wherever it runs.

    Raises
    ------
    VersionError: if this is another celnav than ``made_by``. Whatever the unit raises.
    """
    if made_by != code():
        theirs, ours = (
            ", ".join(f"{k} {c[k]}" for k in c if made_by.get(k) != code().get(k))
            for c in (code(), made_by)
        )
        raise VersionError(
            f"the worker on {platform.node()} has {theirs}, this has {ours}; install the same on both"
        )
    with threadpool_limits(1):
        try:
            return unit.do()
        except Exception as error:
            if (where := place(error)) is not None:
                error.add_note("{}, line {}: {}".format(*where))
            raise


class _Flight:
    """The runs of a unit, and what goes wrong in them."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._trial = load(unit.paper).trial
        self._groups: tuple[tuple[str, str], ...] = ()
        self._trace = ""

    def result(self) -> Result:
        unit, runs = self._unit, range(self._unit.first, self._unit.last)
        scores: dict[str, Scores] = {}
        failures: dict[str, list[Failure]] = {}
        cpu_s: dict[str, float] = {}
        steps: dict[str, int] = {}
        whole = self._simulated(runs)
        for name in unit.filters:
            parts, failures[name] = [], []
            cpu_s[name], steps[name] = 0.0, 0
            for found, failed, seconds, count in self._fly(name, runs, whole):
                parts += [] if found is None else [found]
                failures[name] += failed
                cpu_s[name] += seconds
                steps[name] += count
            if parts:
                scores[name] = merge(parts)
        return Result(self._groups, scores, failures, self._bound(), cpu_s, steps, self._trace)

    def _simulated(self, runs: range) -> Trial | None:
        """The trial; None if it cannot be made for all these runs at once."""
        unit = self._unit
        try:
            trial: Trial = self._trial(
                unit.config, [generator(unit.seed, STUDY, run) for run in runs]
            )
        except MemoryError:
            raise
        except Exception:
            self._note()
            return None
        self._judged(trial)
        return trial

    def _note(self) -> None:
        self._trace = self._trace or traceback.format_exc()

    def _judged(self, trial: Trial) -> None:
        self._groups = tuple((group.name, group.unit) for group in trial.groups)

    def _fly(
        self, name: str, runs: range, whole: Trial | None
    ) -> list[tuple[Scores | None, list[Failure], float, int]]:
        """A filter on some runs. Where a batch raises it is halved until the runs are found that do."""
        unit = self._unit
        try:
            trial = whole or self._trial(
                unit.config, [generator(unit.seed, STUDY, run) for run in runs]
            )
            self._judged(trial)
            if name not in trial.filters:
                return []
            start = process_time()
            followed = follow(trial, name, unit.every)
            seconds = process_time() - start
            scores, failed = score(
                followed, trial.groups, settle_s=unit.settle_s, limits=dict(unit.limits)
            )
        except (MemoryError, CudaError):
            raise
        except Exception as error:
            self._note()
            if len(runs) > 1:
                middle = len(runs) // 2
                return [
                    *self._fly(name, runs[:middle], None),
                    *self._fly(name, runs[middle:], None),
                ]
            return [(None, [Failure(runs[0], 0.0, f"{type(error).__name__}: {error}")], 0.0, 0)]
        absolute = [failure._replace(run=runs[failure.run]) for failure in failed]
        return [(scores, absolute, seconds, followed.epochs * len(runs))]

    def _bound(self) -> Array | None:
        if self._unit.first > 0:
            return None
        noiseless: Sequence[Any] = [Noiseless()]
        try:
            return bound(self._trial(self._unit.config, noiseless), self._unit.every)
        except MemoryError:
            raise
        except Exception:
            self._note()
            return None


def pack(result: Result) -> dict[str, Array]:
    """Arrays for an npz file."""
    arrays = {
        f"{i}/{stat}": v
        for i, name in enumerate(result.failures)
        for stat, v in result.scores.get(name, {}).items()
    }
    if result.bound is not None:
        arrays["bound"] = result.bound
    about = {
        "groups": result.groups,
        "failures": result.failures,
        "cpu_s": result.cpu_s,
        "steps": result.steps,
        "trace": result.trace,
    }
    return arrays | {"about": np.array(json.dumps(about, ensure_ascii=False))}


def unpack(arrays: dict[str, Array], filters: Sequence[str]) -> Result:
    """The inverse of `pack`, of a unit with these filters.

    Raises
    ------
    ValueError: if these are not arrays of such a unit.
    """
    try:
        about = json.loads(str(arrays["about"]))
        names = list(about["failures"])
        if not names == list(about["cpu_s"]) == list(about["steps"]) == list(filters):
            raise ValueError(f"expected the filters {', '.join(filters)}")
        scores: dict[str, Scores] = {}
        for key, value in arrays.items():
            number, slash, stat = key.partition("/")
            if slash:
                scores.setdefault(names[int(number)], {})[stat] = value
        groups = tuple((str(name), str(unit)) for name, unit in about["groups"])
        for found in scores.values():
            check_scores(found, len(groups))
        if "bound" in arrays and scores:
            epochs = len(next(iter(scores.values()))["times"])
            if arrays["bound"].shape != (epochs, len(groups)):
                raise ValueError(
                    f"bound: expected shape {(epochs, len(groups))}, got {arrays['bound'].shape}"
                )
        failures = {
            name: [Failure(*one) for one in listed] for name, listed in about["failures"].items()
        }
        return Result(
            groups,
            scores,
            failures,
            arrays.get("bound"),
            about["cpu_s"],
            about["steps"],
            about["trace"],
        )
    except (KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise ValueError(f"expected the arrays of a work unit ({error})") from None
