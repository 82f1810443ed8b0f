"""Interleaved rounds of CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np

from benchmarks.engines import INSIDE, Engine, celnav_engines, estimate
from benchmarks.peers import peer_engines
from benchmarks.workload import BLOCK, Workload
from celnav.gaussian.linalg import Array


class Row(NamedTuple):
    """What was measured of one engine.

    Attributes
    ----------
    us: CPU time per run-step, of each round. inside: what of it is spent inside the compiled loop.
    start_s: what the first pass of a fresh process takes longer than the second, which is compilation; imports of the peer do
        not count; None: nothing is compiled.
    difference: largest difference ``(position km, velocity km/s)`` to celnav's square-root estimate; None: no estimate.
    """

    engine: str
    runs: int
    steps: int
    us: list[float]
    inside: list[float]
    start_s: float | None
    difference: tuple[float, float] | None


def seconds(work: Callable[[], object]) -> tuple[float, float]:
    """CPU time of one pass, and what of it is inside a compiled loop."""
    INSIDE.seconds, begin = 0.0, time.process_time()
    work()
    return time.process_time() - begin, INSIDE.seconds


def first_pass(name: str, z: Array) -> float:
    """CPU seconds that the first pass of an engine takes longer than its second."""
    runs = z.shape[1]
    engine = next(e for e in (*peer_engines([runs]), *celnav_engines([runs])) if e.name == name)
    work = engine.prepare(z)
    first, second = (seconds(work)[0] for _ in range(2))
    return max(0.0, first - second)


def fresh(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function gives in a process of its own, where nothing is compiled yet."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def measure(
    engines: Sequence[Engine], workload: Workload, rounds: int, say: Callable[[str], None]
) -> tuple[list[Row], dict[str, str]]:
    """Rows of all engines that are installed, and why the others are absent.

    Each round runs every engine once, one after another, so that a disturbance of the machine meets all of them.
    """
    works, starts, differences, absent = [], [], [], {}
    known: dict[int, Array] = {}
    for engine in engines:
        z = workload.measurements(engine.runs)
        try:
            work = engine.prepare(z)
            means = work()
        except ImportError as error:
            absent[engine.name] = str(error)
            say(f"absent: {engine.name} ({error})")
            continue
        starts.append(fresh(first_pass, engine.name, z) if engine.compiles else None)
        works.append((engine, work, len(z) - 1))
        difference = None
        if means is not None:
            # Runs do not depend on their batch: one pass over a block serves all smaller batches.
            size = engine.runs if engine.runs > BLOCK else min(BLOCK, workload.z.shape[1])
            if size not in known:
                known[size] = estimate(
                    workload.z[: workload.steps_of(engine.runs if size > BLOCK else 1) + 1, :size]
                )
            apart = np.abs(means - known[size][: len(z), : engine.runs])
            difference = (float(apart[..., :3].max()), float(apart[..., 3:].max()))
        differences.append(difference)
        say(f"ready: {engine.name}, {engine.runs} runs")
    times: list[list[tuple[float, float]]] = [[] for _ in works]
    for i in range(rounds):
        for (_, work, _), own in zip(works, times, strict=True):
            own.append(seconds(work))
        say(f"round {i + 1} of {rounds}")
    rows = []
    for (engine, _, steps), own, start, difference in zip(
        works, times, starts, differences, strict=True
    ):
        us, inside = (1e6 * np.transpose(own) / (steps * engine.runs)).tolist()
        rows.append(Row(engine.name, engine.runs, steps, us, inside, start, difference))
    return rows, absent
