"""Interleaved rounds of CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.engines import Engine, estimate
from benchmarks.workload import BLOCK, Workload
from celnav.gaussian.linalg import Array


class Row(NamedTuple):
    """What was measured of one engine.

    Attributes
    ----------
    us: CPU time per run-step, of each round.
    start_s: what the first pass takes longer than a later one, which is compilation; imports do not count.
    difference: largest difference ``(position km, velocity km/s)`` to celnav's square-root estimate; None: no estimate.
    """

    engine: str
    runs: int
    steps: int
    us: list[float]
    start_s: float
    difference: tuple[float, float] | None


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
            begin = time.process_time()
            means = work()
        except ImportError as error:
            absent[engine.name] = str(error)
            say(f"absent: {engine.name} ({error})")
            continue
        starts.append(time.process_time() - begin)
        works.append((engine, work, len(z) - 1))
        difference = None
        if means is not None:
            # Runs do not depend on their batch: one pass over a block serves all smaller batches.
            size = engine.runs if engine.runs > BLOCK else min(BLOCK, workload.z.shape[1])
            if size not in known:
                known[size] = estimate(workload.z[: workload.steps_of(engine.runs if size > BLOCK else 1) + 1, :size])
            apart = np.abs(means - known[size][: len(z), : engine.runs])
            difference = (float(apart[..., :3].max()), float(apart[..., 3:].max()))
        differences.append(difference)
        say(f"ready: {engine.name}, {engine.runs} runs")
    times: list[list[float]] = [[] for _ in works]
    for i in range(rounds):
        for (engine, work, steps), own in zip(works, times, strict=True):
            begin = time.process_time()
            work()
            own.append((time.process_time() - begin) / (steps * engine.runs) * 1e6)
        say(f"round {i + 1} of {rounds}")
    rows = []
    for (engine, _, steps), own, start, difference in zip(works, times, starts, differences, strict=True):
        once = float(np.median(own)) * 1e-6 * steps * engine.runs
        rows.append(Row(engine.name, engine.runs, steps, own, max(0.0, start - once), difference))
    return rows, absent
