"""Monte Carlo: one generator per run, blocks of runs that stay in cache, and work spread over processes.

A run's random numbers depend on ``(seed, study, run)`` alone, where ``study`` numbers the configuration: not on the size of a
block, the number of processes or the order of the work. Every array that a block returns has its run axis second,
``(T, runs, ...)``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from celnav.linalg import Array

Progress = Callable[[int, int, str], None]
"""``(done, total, label)``, called when a unit of work is done."""


def generator(seed: int, study: int, run: int) -> np.random.Generator:
    """The generator of one run of one study."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(study, run)))


def normals(rngs: Sequence[np.random.Generator], *shapes: tuple[int, ...]) -> list[Array]:
    """Standard normal arrays, one of each shape from each generator, with the run axis before the last: ``(..., runs, n)``."""
    draws = [[rng.standard_normal(shape) for shape in shapes] for rng in rngs]
    return [np.stack(column, -2) for column in zip(*draws, strict=True)]


def blocks(runs: int, size: int) -> list[range]:
    """Consecutive ranges of at most ``size`` runs.

    Raises
    ------
    ValueError: if a number is not positive.
    """
    for name, value in (("runs", runs), ("block", size)):
        if int(value) != value or value < 1:
            raise ValueError(f"{name}: expected a positive integer, got {value!r}")
    return [range(first, min(first + size, runs)) for first in range(0, runs, size)]


def run_count(full: int, runs: int | None, effort: float) -> int:
    """Number of runs of a study: ``runs``, or the full number times the effort, at least 2.

    Raises
    ------
    ValueError: unless ``0 < effort <= 1`` and ``runs`` is an integer of at least 2 or None.
    """
    if not 0.0 < effort <= 1.0:
        raise ValueError(f"effort: expected a number in (0, 1], got {effort!r}")
    count = max(2, round(full * effort)) if runs is None else runs
    if int(count) != count or count < 2:
        raise ValueError(f"runs: expected an integer of at least 2, got {runs!r}")
    return int(count)


class Unit(NamedTuple):
    """One piece of work: ``function(*arguments)`` gives a dict of arrays. Units of one ``label`` are joined over runs."""

    label: str
    function: Callable[..., dict[str, Array]]
    arguments: tuple[Any, ...]


class Outcome(NamedTuple):
    """Joined arrays of one label, and the CPU time they took in seconds."""

    arrays: dict[str, Array]
    cpu_s: float


def work(units: Iterable[Unit], *, jobs: int = 1, progress: Progress | None = None) -> dict[str, Outcome]:
    """Do all units, in ``jobs`` processes, and join those of one label along the run axis, in the order given."""
    todo = list(units)
    if int(jobs) != jobs or jobs < 1:
        raise ValueError(f"jobs: expected a positive integer, got {jobs!r}")
    results: list[tuple[dict[str, Array], float]] = []

    def done(result: tuple[dict[str, Array], float]) -> None:
        results.append(result)
        if progress is not None:
            progress(len(results), len(todo), todo[len(results) - 1].label)

    if jobs == 1 or len(todo) < 2:
        for unit in todo:
            done(_timed(unit))
    else:
        with ProcessPoolExecutor(min(jobs, len(todo)), mp_context=get_context("spawn")) as pool:
            for result in pool.map(_timed, todo):
                done(result)
    joined: dict[str, Outcome] = {}
    for label in dict.fromkeys(unit.label for unit in todo):
        parts = [result for unit, result in zip(todo, results, strict=True) if unit.label == label]
        names = parts[0][0]
        arrays = {name: np.concatenate([part[name] for part, _ in parts], 1) for name in names}
        joined[label] = Outcome(arrays, sum(cpu for _, cpu in parts))
    return joined


def _timed(unit: Unit) -> tuple[dict[str, Array], float]:
    start = process_time()
    arrays = unit.function(*unit.arguments)
    return arrays, process_time() - start
