"""The compiled engine beyond the common workload: larger states, two threads, a campaign."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any

import numpy as np

from benchmarks.engines import orbit_filter, prior
from benchmarks.measure import fresh, seconds
from benchmarks.workload import BLOCK, Workload
from celnav.filters.compiled import compiled
from celnav.filters.model import Motion, Sensor
from celnav.filters.run import run
from celnav.filters.sequential import ukf
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array

SIZES = (9, 13, 15)
"""Components of a Lorenz-96 state."""
STEP = 0.01
ATTAINED = 1.7
"""Where two processes are so much faster than one, the machine gives both of its cores."""
PARTS, PART = 50, 2000
"""A campaign is flown in so many parts, of so many runs each."""


def wall(work: Callable[[], object]) -> float:
    """Seconds on the clock."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


# -- by dimension --------------------------------------------------------------------------------------------------------------
def lorenz(x: Array, _epoch: Any) -> Array:
    """Lorenz-96 with a forcing of 8, a Runge-Kutta step of order 4."""

    def rate(x: Array) -> Array:
        ring: Array = np.concatenate([x[..., -2:], x, x[..., :1]], -1)
        return (ring[..., 3:] - ring[..., :-3]) * ring[..., 1:-2] - x + 8.0

    a = rate(x)
    b = rate(x + 0.5 * STEP * a)
    c = rate(x + 0.5 * STEP * b)
    return x + STEP / 6.0 * (a + 2.0 * (b + c) + rate(x + STEP * c))


def lorenz_works(
    n: int, runs: int = BLOCK, steps: int = 40
) -> tuple[Callable[[], Array], Callable[[], Array]]:
    """The filter in numpy and compiled; every other component is measured."""
    rng = np.random.default_rng(n)
    H = np.eye(n)[: n - 1 : 2]
    x = 8.0 + rng.standard_normal((runs, n))
    z = np.empty((steps + 1, runs, len(H)))
    for k in range(steps + 1):
        if k:
            x = lorenz(x, None) + 0.1 * rng.standard_normal((runs, n))
        z[k] = x @ H.T + rng.standard_normal((runs, len(H)))
    filter = ukf(Motion(lorenz, sqrt_Q=0.1 * np.eye(n)), Sensor(H, np.eye(len(H))))
    start, times, flown = (
        Gaussian(np.full((runs, n), 8.0), np.eye(n)),
        STEP * np.arange(steps + 1),
        compiled(filter),
    )
    return lambda: np.asarray(
        run(filter, start, times, z, engine="numpy").mean
    ), lambda: np.asarray(flown.run(start, times, z).mean)


def lorenz_first(n: int) -> float:
    """CPU seconds until there is a first result."""
    return seconds(lorenz_works(n)[1])[0]


def dimensions(rounds: int) -> dict[str, Any]:
    """CPU time by dimension, in interleaved rounds."""
    works, apart = {n: lorenz_works(n) for n in SIZES}, {}
    firsts = {n: fresh(lorenz_first, n) for n in SIZES}
    for n, (ours, theirs) in works.items():
        apart[n] = float(np.abs(ours() - theirs()).max())
    found = [
        {n: (*seconds(ours)[:1], *seconds(theirs)) for n, (ours, theirs) in works.items()}
        for _ in range(rounds)
    ]
    rows = []
    for n in SIZES:
        us = 1e6 * np.array([part[n] for part in found]) / (BLOCK * 40)
        numpy, own, inside = np.median(us, 0).tolist()
        ratio = float(np.median(us[:, 0] / us[:, 1]))
        rows.append({"n": n, "m": n // 2, "numpy_us": numpy, "compiled_us": own, "inside_us": inside,
                     "numpy_to_compiled": ratio, "first_s": firsts[n], "difference": apart[n]})  # fmt: skip
    return {"runs": BLOCK, "steps": 40, "rows": rows}


# -- two threads ---------------------------------------------------------------------------------------------------------------
def orbit_flight(runs: int, steps: int, jobs: int) -> Callable[[], object]:
    """A flight of the common workload, compiled already."""
    z, flown, times = (
        Workload(steps, runs).z,
        compiled(orbit_filter(), jobs=jobs),
        np.arange(steps + 1),
    )
    flown.run(prior(runs), times, z)
    return lambda: flown.run(prior(runs), times, z)


_OWN: list[Callable[[], object]] = []
"""What a bare process does again and again."""


def _ready(runs: int, steps: int) -> None:
    _OWN.append(orbit_flight(runs, steps, 1))


def _bare(_: int) -> None:
    _OWN[0]()


def threads(rounds: int, runs: int = 4096, steps: int = 240) -> dict[str, Any]:
    """Wall time of one thread over that of two, and what two processes attain that know nothing of each other."""
    one, two = (orbit_flight(runs, steps, jobs) for jobs in (1, 2))
    found = []
    with ProcessPoolExecutor(2, get_context("spawn"), _ready, (runs // 2, steps)) as pool:
        list(pool.map(_bare, range(4)))
        alone, both = (
            partial(lambda count: list(pool.map(_bare, range(count))), count) for count in (1, 2)
        )
        for i in range(rounds):
            works: list[Callable[[], object]] = [one, two, alone, both]
            turns = [wall(work) for work in works[:: 1 - 2 * (i % 2)]]
            found.append(turns[:: 1 - 2 * (i % 2)])
    s = np.array(found)
    gains, attained = s[:, 0] / s[:, 1], 2.0 * s[:, 2] / s[:, 3]
    quiet = gains[attained >= ATTAINED].tolist()
    return {"runs": runs, "steps": steps, "one_s": float(np.median(s[:, 0])), "two_s": float(np.median(s[:, 1])),
            "threads": float(np.median(gains)), "processes": float(np.median(attained)),
            "rounds": len(gains), "quiet": len(quiet), "quiet_threads": float(np.median(quiet)) if quiet else None}  # fmt: skip


# -- a campaign ----------------------------------------------------------------------------------------------------------------
def campaign(parts: int = PARTS, steps: int = 600) -> dict[str, Any]:
    """Wall time of many runs, part by part, compiled with two threads; numpy flies a block in four of them."""
    filter, times = orbit_filter(), np.arange(steps + 1)
    flown = compiled(filter, jobs=2)
    simulated, own, nis, numpy = 0.0, 0.0, 0.0, list[float]()
    for i in range(parts):
        begin = time.perf_counter()
        z = Workload(steps, PART, seed=i).z
        simulated += time.perf_counter() - begin
        begin = time.perf_counter()
        track = flown.run(prior(PART), times, z)
        own += time.perf_counter() - begin
        nis += float(track.nis[1:].mean()) / parts
        if i % -(-parts // 4) == 0:
            numpy.append(
                wall(partial(run, filter, prior(BLOCK), times, z[:, :BLOCK], engine="numpy"))
            )
    return {"runs": parts * PART, "steps": steps, "simulated_s": simulated, "compiled_s": own, "nis": nis,
            "numpy_s": float(np.mean(numpy)) * parts * PART / BLOCK, "numpy_runs": len(numpy) * BLOCK}  # fmt: skip


def report(rounds: int, parts: int) -> dict[str, Any]:
    """All three."""
    return {
        "dimensions": dimensions(rounds),
        "threads": threads(3 * rounds),
        "campaign": campaign(parts) if parts else None,
    }


def lines(found: dict[str, Any]) -> Iterator[str]:
    """Of a report, as Markdown."""
    by, two, many = (found[name] for name in ("dimensions", "threads", "campaign"))
    yield from (
        "",
        f"By dimension: Lorenz-96, half of the components measured, {by['runs']} runs of {by['steps']} steps:",
        "",
    )
    yield "| n | m | numpy, us | compiled, us | in the loop | numpy / compiled | first result, s | difference |"
    yield "|--:|--:|--:|--:|--:|--:|--:|--:|"
    for row in by["rows"]:
        times = [
            f"{row[name]:.2f}"
            for name in ("numpy_us", "compiled_us", "inside_us", "numpy_to_compiled", "first_s")
        ]
        yield f"| {row['n']} | {row['m']} | {' | '.join(times)} | {row['difference']:.1e} |"
    yield ""
    yield (
        f"Two threads: {two['runs']} runs of {two['steps']} steps take {two['one_s']:.2f} s with one and {two['two_s']:.2f} s with "
        f"two, {two['threads']:.2f} times faster; two processes that know nothing of each other attain {two['processes']:.2f}. "
        f"They attain {ATTAINED} in {two['quiet']} of {two['rounds']} rounds"
        + (f", and two threads {two['quiet_threads']:.2f} in those." if two["quiet"] else ".")
    )
    if many is not None:
        yield ""
        yield (
            f"A campaign: {many['runs']} runs of {many['steps']} steps are filtered in {many['compiled_s']:.0f} s of wall time, "
            f"compiled and with two threads, and would be in {many['numpy_s']:.0f} s by numpy with one (measured on "
            f"{many['numpy_runs']} of them); to simulate them takes {many['simulated_s']:.0f} s. Mean NIS {many['nis']:.3f} of 3."
        )
