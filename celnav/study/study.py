"""A study: parts that are simulated and filtered, their results by name, and a ledger that the
results decide.

The study of a paper consists of configurations, filters by name, parts, rows of a ledger, and
functions for figures and tables.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from itertools import groupby
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.records import Epoch
from celnav.filters.run import ENGINE, repeated
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import choice
from celnav.gaussian.linalg import Array
from celnav.study.ledger import Claim, Row, Sentence
from celnav.study.montecarlo import blocks, effort, generator, run_count
from celnav.study.store import RESULTS, existing
from celnav.study.trial import Group, Trial, evaluate_filter, scales

__all__ = [
    "Part",
    "Results",
    "Rngs",
    "Study",
    "Unit",
    "When",
    "evaluate_filters",
    "evaluate_from_priors",
    "monte_carlo",
]

Rngs = Sequence[np.random.Generator]
START_S = 0.5
"""Approximate CPU seconds of a unit before its runs start, mostly to compile filters."""
When = int | slice | str
"""An epoch, a slice of epochs to average over, or the name of a window, see `Study`."""


def concatenated(blocks: Iterable[dict[str, Array]]) -> dict[str, Array]:
    """Concatenate the arrays of blocks over the runs; they are removed from the blocks to save
    memory.
    """
    first, *others = blocks
    for name in list(first) if others else ():
        arrays = [first[name], *(block.pop(name) for block in others)]
        first[name] = np.concatenate(arrays, 1) if arrays[0].ndim > 1 else arrays[0]
    return first


class Part(NamedTuple):
    """Runs of one configuration, or any other computation; `Results` has its arrays by name.

    Attributes
    ----------
    work: ``(config, rngs) ->`` arrays by name. Arrays with two or more axes have the runs on the
        second, ``(T, runs, ...)``, and are joined over blocks. Other arrays must be the same in all
        blocks.
    config: first argument of ``work``. number: number of the configuration, which determines its
        random numbers.
    runs: number of runs at full effort. cost: approximate CPU seconds of all runs.
    block: largest number of runs computed together; it affects round-off only.
    join: ``(arrays of blocks) ->`` arrays of all runs, for another way to join, such as a sum; it
        raises ValueError for arrays of other work.
    """

    work: Callable[[Any, Rngs], dict[str, Array]]
    config: Any
    number: int = 0
    runs: int = 1
    block: int = 100
    cost: float = 1.0
    join: Callable[[Iterable[dict[str, Array]]], dict[str, Array]] = concatenated


def evaluate_filters(
    trial: Trial, names: Sequence[str], every: int = 1, *, cov: bool = False
) -> dict[str, Array]:
    """Errors and consistency of a trial's filters, at every ``every``-th epoch with a truth.

    Returns
    -------
    Arrays by name: ``times (T,)`` s. For each filter ``<name>/error`` and ``<name>/std``
    ``(T, runs, n)`` in the units of the groups, and ``<name>/nees`` and ``<name>/nis``
    ``(T, runs)``. NIS is nan where nothing was measured. All values of a run are nan after it
    fails. With ``cov`` also ``<name>/cov (T, 1, n, n)`` of the first run, in the state's units.
    """
    out: dict[str, Array] = {}
    for name in names:
        evaluation = evaluate_filter(trial, name, every)
        scale = scales(trial.groups, evaluation.error.shape[-1])
        arrays = {
            "error": evaluation.error * scale,
            "std": evaluation.std * scale,
            "nees": evaluation.nees,
            "nis": np.where(evaluation.dof > 0, evaluation.nis, np.nan),
        }
        if cov:
            arrays["cov"] = evaluation.cov[:, None]
        out |= {"times": evaluation.times}
        out |= {f"{name}/{what}": values for what, values in arrays.items()}
    return out


def evaluate_from_priors(
    trial: Trial, priors: Mapping[str, Gaussian], names: Sequence[str], every: int = 1
) -> dict[str, Array]:
    """Results of `evaluate_filters` for several priors on the same runs; filters have the names
    ``<filter>, <prior>``. All priors run in one batch.
    """
    count, starts = len(priors), list(priors.values())
    covs = [
        np.broadcast_to(start.cov, (len(start.mean), *start.cov.shape[-2:])) for start in starts
    ]

    def epochs(name: str) -> Iterator[Epoch]:
        for epoch in trial.epochs(name):
            tiled: Any = {
                name: np.tile(values, (count, 1))
                for name in ("u", "z", "truth")
                if (values := getattr(epoch, name)) is not None
            }
            yield epoch._replace(**tiled)

    prior = Gaussian(np.concatenate([start.mean for start in starts]), np.concatenate(covs))
    arrays = evaluate_filters(trial._replace(prior=prior, epochs=epochs), names, every)
    out = {"times": arrays.pop("times")}
    for key, values in arrays.items():
        name, what = key.split("/")
        for label, runs in zip(priors, np.split(values, count, 1), strict=True):
            out[f"{name}, {label}/{what}"] = runs
    return out


def monte_carlo(
    trial: Callable[[Any, Rngs], Trial],
    filters: Sequence[str],
    config: Any,
    number: int = 0,
    runs: int = 1,
    block: int = 100,
    cost: float = 1.0,
    *,
    every: int = 1,
    cov: bool = False,
) -> Part:
    """A `Part` that runs some of a trial's filters, see `evaluate_filters`.

    trial: ``(config, rngs) ->`` `Trial`; it must be a function of a module, because it is sent to
        other processes.
    filters: names. every, cov: as in `evaluate_filters`. The other arguments: see `Part`.

    >>> trial = lambda config, rngs: problem.trial(filters, rngs)
    >>> part = celnav.study.monte_carlo(trial, ("ukf",), None, runs=400)
    """
    return Part(partial(_evaluate, trial, filters, every, cov), config, number, runs, block, cost)


def _evaluate(
    trial: Callable[[Any, Rngs], Trial],
    names: Sequence[str],
    every: int,
    cov: bool,
    config: Any,
    rngs: Rngs,
) -> dict[str, Array]:
    return evaluate_filters(trial(config, rngs), names, every, cov=cov)


@dataclass(frozen=True, eq=False)
class Study:
    """The computations for a paper, and its ledger.

    Attributes
    ----------
    name: name of the paper. groups: components that are evaluated. rows: the ledger.
    trial: ``(config, rngs) ->`` `Trial`, see `celnav.study.trial`; None if nothing is drawn.
    parts: ``(effort) ->`` parts by name. ``effort``, in (0, 1], may shorten long runs; `units`
        scales the number of runs.
    says: the main claim of the paper. found: our answer, sentences with the verdicts that they rest
        on.
    figure: stem of the decisive figure.
    windows: ``(config, times) ->`` time intervals by name, as slices of the evaluated epochs.
    source: hash of the study's file, if it is not part of celnav.
    """

    name: str
    groups: tuple[Group, ...]
    trial: Callable[[Any, Rngs], Trial] | None
    parts: Callable[..., Mapping[str, Part]]
    rows: Sequence[Row]
    says: str = ""
    found: Sequence[Sentence] = ()
    figure: str = ""
    windows: Callable[[Any, Array], Mapping[str, slice]] | None = None
    source: str = ""

    def __post_init__(self) -> None:
        if not all(isinstance(sentence, Sentence) for sentence in self.found):
            raise ValueError(
                "found: expected sentences, such as [celnav.study.ledger.Sentence('It is so.', "
                f"{{'row': 'reproduced'}})], got {self.found!r:.80}"
            )

    def units(
        self,
        *,
        effort: float = 1.0,
        seed: int = 0,
        only: Sequence[str] = (),
        engine: str = "",
        **inputs: Any,
    ) -> list[Unit]:
        """The units of work of the study.

        only: names of the parts to compute; all if empty. engine: as in `celnav.run`; empty for the
        current engine. inputs: further arguments of `parts`. ValueError for an unknown part.
        """
        parts = self.parts(effort, **inputs)
        for name in only:
            choice("only", name, parts)
        engine = engine or ENGINE.get()
        about = f"effort {effort!r}, {sorted((key, str(value)) for key, value in inputs.items())}"
        about += "" if engine == "auto" else f", engine {engine}"
        about += f", source {self.source}" if self.source else ""
        units = []
        for name in only or parts:
            part = parts[name]
            count = part.runs if part.runs == 1 else run_count(part.runs, None, effort)
            ranges = blocks(count, part.block)
            unit = Unit(self.name, name, part, seed, ranges[0], about, engine, len(ranges))
            units += [unit._replace(runs=runs) for runs in ranges]
        return units

    def results(
        self, units: Sequence[Unit], blocks: Iterable[dict[str, Array]], *, effort: float = 1.0
    ) -> Results:
        """`Results` from the arrays of units, in the order of the units. Parts are joined one after
        the other to save memory.
        """
        parts = groupby(zip(units, blocks, strict=True), lambda pair: pair[0].part)
        works = {unit.part: unit.work for unit in units}
        joined = {name: works[name].join(arrays for _, arrays in pairs) for name, pairs in parts}
        return Results(self, units[0].seed, effort, works, joined)

    def reproduce(
        self, *, effort: float = 1.0, out: str | Path | None = None, **options: Any
    ) -> Results:
        """`Results` of all `units`, computed in this process; nothing is written.

        Results in ``out`` that ``celnav reproduce --out`` has stored with this code are reused.

        >>> results = csrukf.STUDY.reproduce(effort=0.1, only=["0", "I"], out="out")
        """
        units = self.units(effort=effort, **options)
        store = None if out is None else existing(Path(out) / self.name / RESULTS)
        arrays = (
            store.read(unit) if store is not None and store.has(unit) else unit.do()
            for unit in units
        )
        return self.results(units, arrays, effort=effort)

    def at_hand(self, out: str | Path = "out", *, small: float = 0.02) -> Results:
        """`Results` of all runs, if ``celnav reproduce --out`` has stored them with this code;
        otherwise `Results` of the fraction ``small`` of the runs.

        The environment variable ``CELNAV_EFFORT`` overrides the fraction in both cases, and
        ``CELNAV_OUT`` overrides ``out``.
        """
        out = os.environ.get("CELNAV_OUT", out)
        store = existing(Path(out) / self.name / RESULTS)
        there = store is not None and all(store.path(unit).exists() for unit in self.units())
        return self.reproduce(effort=effort(default=1.0 if there else small), out=out)


class Unit(NamedTuple):
    """Some runs of a part, which one process computes together.

    about: other inputs that affect the result, as text. units: number of units of the part.
    """

    study: str
    part: str
    work: Part
    seed: int
    runs: range
    about: str
    engine: str = "auto"
    units: int = 1

    @property
    def cost(self) -> float:
        """Approximate CPU seconds."""
        return START_S + self.work.cost * len(self.runs) / self.work.runs

    @property
    def title(self) -> str:
        """Study, part and runs."""
        return f"{self.study}: {self.part}, runs {self.runs.start} to {self.runs.stop - 1}"

    @property
    def key(self) -> str:
        """Hash of everything that determines the result, except the code."""
        return sha256(f"{self.title}, seed {self.seed}, {self.about}".encode()).hexdigest()[:24]

    def check(self, arrays: dict[str, Array]) -> None:
        """Raise ValueError unless the arrays belong to this unit's part."""
        if not arrays:
            raise ValueError(f"{self.title}: expected arrays, got none")
        self.work.join([arrays])

    def do(self) -> dict[str, Array]:
        """Compute the arrays of the part, and ``cpu_s (1, 1)``. Warnings from models and filters
        are raised as errors.
        """
        start, token = process_time(), ENGINE.set(self.engine)
        rngs = [generator(self.seed, self.work.number, run) for run in self.runs]
        try:
            with warnings.catch_warnings(), repeated(self.units):
                warnings.simplefilter("error")
                arrays = self.work.work(self.work.config, rngs)
        finally:
            ENGINE.reset(token)
        return arrays | {"cpu_s": np.array([[process_time() - start]])}


@dataclass(frozen=True, eq=False)
class Results:
    """The arrays of a study's parts, for figures, tables and the ledger.

    Attributes
    ----------
    parts: parts by name. data: ``data[part][name]``, arrays as `Part.work` returns them.
    """

    study: Study
    seed: int
    effort: float
    parts: Mapping[str, Part]
    data: Mapping[str, Mapping[str, Array]]

    def get(self, part: str, name: str) -> Array:
        """An array of a part."""
        return self.data[part][name]

    def value(self, part: str, name: str, *at: int) -> float:
        """One entry of an array of a part."""
        return float(self.data[part][name][at])

    def times(self, part: str) -> Array:
        """Evaluated epochs ``(T,)`` s."""
        return self.data[part]["times"]

    def error(self, part: str, filter: str, group: str, what: str = "error") -> Array:
        """Errors ``(T, runs, k)`` in the unit of a group, or with ``what="std"`` the predicted
        standard deviations.
        """
        return self.data[part][f"{filter}/{what}"][..., self.group(group).part]

    def at(self, part: str, when: When) -> int | slice:
        """Index or slice of epochs; a name refers to one of the study's windows (ValueError if
        unknown).
        """
        if not isinstance(when, str):
            return when
        windows = (
            self.study.windows(self.parts[part].config, self.times(part))
            if self.study.windows
            else {}
        )
        if not windows:
            raise ValueError(
                f"at: expected an epoch or a slice, because Study has no windows, got {when!r}; "
                "give Study windows=, or an epoch such as -1"
            )
        return windows[choice("at", when, windows)]

    def squares(self, part: str, filter: str, group: str, at: When = -1) -> Array:
        """Squared errors ``(runs, k)`` of a group's components at an epoch, or means over several
        epochs.
        """
        square = np.square(self.error(part, filter, group)[self.at(part, at)])
        return square if isinstance(at, int) else np.asarray(square.mean(0))

    def nees(self, part: str, filter: str, at: When = -1, what: str = "nees") -> Array:
        """NEES ``(runs,)`` at an epoch, or means over several epochs; NIS with ``what="nis"``."""
        values = self.data[part][f"{filter}/{what}"][self.at(part, at)]
        return values if isinstance(at, int) else np.asarray(values.mean(0))

    def group(self, name: str) -> Group:
        """The group with this name."""
        return next(group for group in self.study.groups if group.name == name)

    def first(self, part: str) -> Trial:
        """A `Trial` with the first run of a part, to run its filters again with all output."""
        config, number = self.parts[part].config, self.parts[part].number
        assert self.study.trial is not None, "a study that draws nothing has no runs to run again"
        return self.study.trial(config, [generator(self.seed, number, 0)])

    @property
    def full(self) -> bool:
        """Whether all runs were done."""
        return self.effort == 1.0

    def claims(self, rows: Sequence[Row] = ()) -> list[Claim]:
        """The claims of ``rows``, or of all rows of the ledger; rows that need an absent part are
        omitted.
        """
        return [
            row.judged(self, self.full)
            for row in rows or self.study.rows
            if not row.needs or row.needs in self.data
        ]
