"""Work units of a campaign: blocks of runs of a configuration, of which only scores are kept."""

from __future__ import annotations

import json
import platform
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial, reduce
from hashlib import sha256
from itertools import groupby
from operator import add
from time import process_time
from typing import Any, TypeVar

import numpy as np

from celnav.campaign.missions import MissionStudy
from celnav.campaign.scores import Scores, check_scores, merge, score
from celnav.gaussian.linalg import Array
from celnav.lazy import requires_extra
from celnav.papers import load
from celnav.papers.own import identity, name_of, place
from celnav.study.montecarlo import renewed, run_of
from celnav.study.store import code
from celnav.study.study import Part, Rngs, Study, Unit
from celnav.study.trial import Noiseless, Trial, bound, evaluate_filter
from celnav.tape.cuda import CudaError

with requires_extra("a campaign or a mission", "papers"):
    from threadpoolctl import threadpool_limits

STUDY = 0
"""Study number for `celnav.study.montecarlo.generator`. All configurations share it, and so their
random numbers, which makes differences between them precise.
"""
EXPECTED = 8
"""Assumed number of units with equal filters per worker. It is not counted, since the engine of a
unit must not depend on other units.
"""


T = TypeVar("T")


class WorkError(RuntimeError):
    """Work that could not be done."""


class VersionError(WorkError):
    """A worker runs another celnav than the one that handed out the work."""


@dataclass(frozen=True, eq=False)
class Scored:
    """Scores of some or all runs of a configuration; `+` adds those of other runs or filters.

    Attributes
    ----------
    groups: name and unit of each judged group; empty if nothing could be simulated.
    scores: of each filter with at least one scored run. reasons: (filter, why) of failed runs.
    cpu_s, steps: of each filter: CPU seconds, and run-steps done in them.
    bound: mean squares ``(K, groups)``, computed with the first run only.
    trace: where the first exception came from, if there was one.
    """

    groups: tuple[tuple[str, str], ...] = ()
    scores: dict[str, Scores] = field(default_factory=dict)
    reasons: Counter[tuple[str, str]] = field(default_factory=Counter)
    cpu_s: Counter[str] = field(default_factory=Counter)
    steps: Counter[str] = field(default_factory=Counter)
    bound: Array | None = None
    trace: str = ""

    def __add__(self, other: Scored) -> Scored:
        scores = dict(self.scores)
        for name, more in other.scores.items():
            scores[name] = merge([scores[name], more]) if name in scores else more
        return Scored(
            self.groups or other.groups,
            scores,
            self.reasons + other.reasons,
            self.cpu_s + other.cpu_s,
            self.steps + other.steps,
            other.bound if self.bound is None else self.bound,
            self.trace or other.trace,
        )

    def arrays(self, filters: Sequence[str]) -> dict[str, Array]:
        """The scores as arrays, for an npz file."""
        arrays = {
            f"{filters.index(name)}/{stat}": value
            for name, scores in self.scores.items()
            for stat, value in scores.items()
        }
        if self.bound is not None:
            arrays["bound"] = self.bound
        reasons = [[*key, count] for key, count in self.reasons.items()]
        about = self.groups, reasons, self.cpu_s, self.steps, self.trace
        return arrays | {"about": np.array(json.dumps(about, ensure_ascii=False))}


def read(arrays: dict[str, Array], filters: Sequence[str]) -> Scored:
    """The scores from `Scored.arrays`; ValueError if these are not such arrays."""
    try:
        groups, reasons, cpu_s, steps, trace = json.loads(str(arrays["about"]))
        scores: dict[str, Scores] = {}
        for key, value in arrays.items():
            number, slash, stat = key.partition("/")
            if slash:
                scores.setdefault(filters[int(number)], {})[stat] = value
        scored = Scored(
            tuple((str(name), str(unit)) for name, unit in groups),
            scores,
            Counter({(name, why): count for name, why, count in reasons}),
            Counter(cpu_s),
            Counter(steps),
            arrays.get("bound"),
            trace,
        )
        if not {*scored.cpu_s, *scored.steps, *(name for name, _ in scored.reasons)} <= {*filters}:
            raise ValueError(f"expected the filters {', '.join(filters)}")
        for name in scores:
            check_scores(scores[name], len(groups), scored.bound)
    except (KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise ValueError(f"expected the arrays of a work unit ({error})") from None
    return scored


@dataclass(frozen=True)
class Scoring:
    """The work on a block of runs: each filter is run and scored. Exceptions of models and filters
    count as failures of their runs.
    """

    paper: str
    filters: tuple[str, ...]
    every: int
    settle_s: float | None
    limits: tuple[tuple[str, float], ...]

    def __call__(self, config: Any, rngs: Rngs) -> dict[str, Array]:
        """Arrays of the `Scored` of all filters, and with the first run the bound."""
        make = partial(load(self.paper).trial, config)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they were shown when the study was read
            trial, trace = _attempt(make, rngs)  # if it fails, fewer runs at once are tried
            total = Scored(trace=trace)
            for name in self.filters:
                total += self.score_filter(make, name, rngs, trial)
            if run_of(rngs[0]) == 0:
                least, trace = _attempt(lambda: bound(make([Noiseless()]), self.every))
                total += Scored(bound=least, trace=trace)
        return total.arrays(self.filters)

    def score_filter(
        self, make: Callable[[Rngs], Trial], name: str, rngs: Rngs, trial: Trial | None = None
    ) -> Scored:
        """Scores of a filter on some runs. A batch that raises is halved until the failing runs are
        found.
        """
        groups = tuple[tuple[str, str], ...]()
        try:
            trial = trial or make([renewed(rng) for rng in rngs])
            groups = tuple((group.name, group.unit) for group in trial.groups)
            if name not in trial.filters:
                return Scored(groups)
            start = process_time()
            run = evaluate_filter(trial, name, self.every)
            seconds = process_time() - start
            limits = dict(self.limits)
            scores, failures = score(run, trial.groups, settle_s=self.settle_s, limits=limits)
        except (MemoryError, CudaError):
            raise
        except Exception as error:
            failed, half = Scored(groups, trace=traceback.format_exc()), len(rngs) // 2
            if half:
                halves = (
                    self.score_filter(make, name, some) for some in (rngs[:half], rngs[half:])
                )
                return sum(halves, failed)
            failed.reasons[name, f"{type(error).__name__}: {error}"] = 1
            return failed
        reasons = Counter((name, failure.why) for failure in failures)
        steps = Counter({name: run.epochs * len(rngs)})
        return Scored(groups, {name: scores}, reasons, Counter({name: seconds}), steps)

    def join(self, blocks: Iterable[dict[str, Array]]) -> dict[str, Array]:
        """The sum of blocks in their order; ValueError for invalid or incompatible arrays."""
        return self.read(blocks).arrays(self.filters)

    def read(self, blocks: Iterable[dict[str, Array]]) -> Scored:
        """The sum of blocks as a `Scored`. Only one block is in memory at a time."""
        return reduce(add, (read(arrays, self.filters) for arrays in blocks))


def _attempt(make: Callable[..., T], *arguments: Any) -> tuple[T | None, str]:
    """The result of a model or filter, or None and the place of its exception."""
    try:
        return make(*arguments), ""
    except (MemoryError, CudaError):
        raise
    except Exception:
        return None, traceback.format_exc()


def units_of(study: MissionStudy) -> list[list[Unit]]:
    """Units of each configuration, in the order in which they are joined."""
    limits = tuple(sorted(study.limits.items()))
    work = Scoring(study.paper, study.filters, study.every, study.settle_s, limits)
    parts = {}
    for point in study.configurations:
        table = asdict(point.config)
        del table["runs"]  # results of a unit do not depend on the total number of runs
        name = sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()[:16]
        parts[name] = Part(work, point.config, STUDY, study.runs, study.block, 1.0, work.join)
    source = json.dumps([identity(study.paper), *list(asdict(work).values())[1:]])
    whole = Study(name_of(study.paper), (), None, lambda _: parts, (), source=source)
    units = whole.units(seed=study.seed, engine=study.engine)
    each = groupby((unit._replace(units=EXPECTED) for unit in units), lambda unit: unit.part)
    return [list(group) for _, group in each]


def execute(unit: Unit, made_by: dict[str, str]) -> dict[str, Array]:
    """Arrays of a unit, computed with one thread of linear algebra for identical results
    everywhere.

    Raises
    ------
    VersionError: if this celnav differs from ``made_by``. Whatever the unit raises.
    """
    if made_by != code():
        theirs, ours = (
            ", ".join(f"{k} {c[k]}" for k in c if made_by.get(k) != code().get(k))
            for c in (code(), made_by)
        )
        raise VersionError(
            f"the worker on {platform.node()} has {theirs}, this has {ours}; install the same on "
            "both"
        )
    with threadpool_limits(1):
        try:
            return unit.do()
        except Exception as error:
            if (where := place(error)) is not None:
                error.add_note("{}, line {}: {}".format(*where))
            raise
