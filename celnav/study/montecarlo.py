"""Monte Carlo: how many runs, one generator for each, blocks of them that stay in cache, and work spread over processes.

A run's random numbers depend on ``(seed, study, run)`` alone, where ``study`` numbers the configuration: not on the size of a
block, the number of processes or the order of the work. Every array that a block returns has its run axis second,
``(T, runs, ...)``.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from multiprocessing import get_context
from time import process_time
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from celnav.gaussian.checks import integer, kind, number, sequence
from celnav.gaussian.linalg import Array

R = TypeVar("R")
MOST_STEPS = 10_000_000
"""Of one run, at its finest rate: more take a day, and gigabytes."""
Progress = Callable[[int, int, str], None]
"""``(done, total, label)``, called when a unit of work is done."""


def generator(seed: int, study: int, run: int) -> np.random.Generator:
    """The generator of one run of one study, which are not negative."""
    key = (integer("study", study, 0), integer("run", run, 0))
    return np.random.default_rng(np.random.SeedSequence(integer("seed", seed, 0), spawn_key=key))


def normals(rngs: Sequence[np.random.Generator], *shapes: tuple[int, ...]) -> list[Array]:
    """Standard normal arrays, one of each shape from each generator, with the run axis before the last: ``(..., runs, n)``."""
    for rng in (every := sequence("rngs", rngs, "[celnav.study.montecarlo.generator(seed, study, run)]")):
        if not hasattr(rng, "standard_normal"):
            raise ValueError(f"rngs: expected generators, such as np.random.default_rng(0), got {kind(rng)}")
    if not every:
        raise ValueError("rngs: expected at least one generator, got none")
    draws = [[rng.standard_normal(shape) for shape in shapes] for rng in every]
    return [np.stack(column, -2) for column in zip(*draws, strict=True)]


def blocks(runs: int, size: int) -> list[range]:
    """Consecutive ranges of at most ``size`` runs."""
    return [range(first, min(first + size, runs)) for first in range(0, integer("runs", runs), integer("block", size))]


def effort(value: str | float | None = None) -> float:
    """A fraction in (0, 1] of the Monte-Carlo runs: the argument, else ``CELNAV_EFFORT``, which is read here only, else 1."""
    name, given = ("effort", value) if value is not None else ("CELNAV_EFFORT", os.environ.get("CELNAV_EFFORT", "1"))
    try:
        fraction = float(given)
    except (TypeError, ValueError):
        fraction = 0.0
    if not 0.0 < fraction <= 1.0:
        raise ValueError(f"{name}: expected a number in (0, 1], got {given!r}")
    return fraction


def run_count(full: int, runs: int | None, effort: float) -> int:
    """Number of runs of a study: ``runs``, or the full number times the effort, in (0, 1]; at least 2."""
    part = integer("full", full) * number("effort", effort, above=0.0, most=1.0)
    return integer("runs", max(2, round(part)) if runs is None else runs, 2)


def steps(name: str, count: float) -> int:
    """The number of steps of a run, which may come as a quotient; ValueError names what it follows from if there are too many."""
    if not 0.5 < count <= MOST_STEPS:
        raise ValueError(f"{name}: expected a run of 1 to {MOST_STEPS} steps, got {count:.10g}")
    return round(count)


class Unit(NamedTuple):
    """One piece of work: ``function(*arguments)`` gives a dict of arrays. Units of one ``label`` are joined over runs.

    ``cost``: CPU seconds, roughly, for who waits.
    """

    label: str
    function: Callable[..., dict[str, Array]]
    arguments: tuple[Any, ...]
    cost: float = 1.0


class Outcome(NamedTuple):
    """Joined arrays of one label, and the CPU time they took in seconds."""

    arrays: dict[str, Array]
    cpu_s: float


class Plan(NamedTuple, Generic[R]):
    """A study before it is carried out: its units of work, in order, and what makes the result of their outcomes by label."""

    units: list[Unit]
    result: Callable[[dict[str, Outcome]], R]


def do(unit: Unit) -> Outcome:
    """The outcome of one unit; warnings of its models and filters are errors."""
    start = process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        arrays = unit.function(*unit.arguments)
    return Outcome(arrays, process_time() - start)


def joined(units: Sequence[Unit], outcomes: Sequence[Outcome]) -> dict[str, Outcome]:
    """Outcomes of units of one label, joined along the run axis in the order given."""
    parts: dict[str, list[Outcome]] = {}
    for unit, outcome in zip(units, outcomes, strict=True):
        parts.setdefault(unit.label, []).append(outcome)
    return {label: Outcome(_joined(found), sum(outcome.cpu_s for outcome in found)) for label, found in parts.items()}


def _joined(outcomes: Sequence[Outcome]) -> dict[str, Array]:
    if len(outcomes) == 1:  # not copied: some are large
        return outcomes[0].arrays
    names = dict.fromkeys(name for outcome in outcomes for name in outcome.arrays)
    parts = {name: [o.arrays[name] for o in outcomes if name in o.arrays] for name in names}
    return {name: np.concatenate(part, 1) if part[0].ndim > 1 else part[0] for name, part in parts.items()}


def carry_out(plan: Plan[R], *, jobs: int = 1, progress: Progress | None = None) -> R:
    """Do the units of a plan, in ``jobs`` processes, and give its result."""
    count, several = len(plan.units), integer("jobs", jobs) > 1 and len(plan.units) > 1
    with ProcessPoolExecutor(min(jobs, count), mp_context=get_context("spawn")) if several else nullcontext() as pool:
        outcomes = []
        for unit, outcome in zip(plan.units, pool.map(do, plan.units) if pool else map(do, plan.units), strict=True):
            outcomes.append(outcome)
            if progress is not None:
                progress(len(outcomes), count, unit.label)
    return plan.result(joined(plan.units, outcomes))
