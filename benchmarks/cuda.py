"""``python -m benchmarks.cuda``: the common workload on an NVIDIA device, against the compiled
engine and JAX on the same device.

Wall time of a filter's `run`, with all that it arranges, copies and checks; "in flights" is what
its threads wait for the device together, copies among that. Before any time is taken the estimate
is compared with that of the numpy engine. Many runs are flown in parts, each of which has the same
measurements.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import celnav
from benchmarks.problems import measurements, problem
from benchmarks.using_celnav import filter_of
from celnav.gaussian.linalg import FORMS, Array
from celnav.tape import cuda

RUNS = (10_000, 100_000, 1_000_000)
PART = 100_000
"""Runs of a part: the measurements of more would not go into the memory of a small host."""
COMPARED, LEAST = 64, 1e-9
"""Runs that are compared with numpy, and how near they must be, km."""


class Inside:
    """Seconds inside the device's flights, copies among them, since it was last set to zero."""

    def __init__(self) -> None:
        self.seconds, run = 0.0, cuda.Lane.run

        def timed(lane: cuda.Lane, *arguments: Any, results: int) -> Array:
            begin = time.perf_counter()
            rows = run(lane, *arguments, results=results)
            self.seconds += time.perf_counter() - begin
            return rows

        cuda.Lane.run = timed  # type: ignore[method-assign]


def wall(work: Callable[[], object], rounds: int) -> float:
    """Median of seconds on the clock, after a first pass that is not counted."""
    work()
    found = []
    for _ in range(rounds):
        begin = time.perf_counter()
        work()
        found.append(time.perf_counter() - begin)
    return float(np.median(found))


def flights(
    form: str, engine: str, z: Array, runs: int, keep: str, jobs: int
) -> Callable[[], object]:
    """All runs, part by part."""
    flown = celnav.engine.compiled.compiled(filter_of("orbit", form), jobs=jobs, engine=engine)
    times, size = np.arange(len(z)), z.shape[1]

    def work() -> None:
        for _ in range(runs // size):
            flown.run(prior(), times, z, keep=keep)

    return work


def difference(form: str, z: Array) -> float:
    """Of positions from those of the numpy engine, km."""
    data = filter_of("orbit", form), prior(), np.arange(len(z)), z
    device, numpy = (celnav.run(*data, engine=engine).mean for engine in ("cuda", "numpy"))
    return float(np.abs(device - numpy)[..., :3].max())


def prior() -> celnav.Gaussian:
    """One for all runs."""
    given = problem("orbit")
    return celnav.Gaussian(given.mean, given.P)


def jax_flights(z: Array, runs: int) -> Callable[[], object] | None:
    """dynamax, mapped over the runs of a part at once; None where JAX has no such device."""
    os.environ.pop("JAX_PLATFORMS", None)  # `benchmarks` holds it to the processor
    os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"
    try:
        import jax

        device = jax.devices("gpu")[0]
        from benchmarks import using_dynamax

        using_dynamax.CHUNK = z.shape[1]
        with jax.default_device(device):
            one = using_dynamax.unscented("orbit", z.shape[1], len(z))
    except (ImportError, RuntimeError) as error:
        print(f"JAX: not measured ({error})")
        return None

    def work() -> None:
        with jax.default_device(device):
            for _ in range(runs // z.shape[1]):
                one()

    return work


def main() -> int:
    """The table; 1 if the device's estimate is another one, 2 if there is no device."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.cuda", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "--runs", default=",".join(map(str, RUNS)), help="numbers of runs, with commas"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="threads")
    options = parser.parse_args()
    try:
        cuda.device()
    except cuda.CudaError as error:
        print(f"no device, nothing is measured: {error}")
        return 2
    counts = [int(count) for count in options.runs.split(",")]
    largest = min(max(counts), PART)
    z, inside = measurements(problem("orbit"), largest, options.steps + 1), Inside()
    apart = {form: difference(form, z[:, :COMPARED]) for form in FORMS}
    print(f"positions differ from numpy's by {apart} km at most")
    if max(apart.values()) > LEAST:
        return 1
    print(
        "\n| filter | kept | runs | s | in flights, s | us per run-step | compiled, s | JAX, s "
        "|\n|---|---|--:|--:|--:|--:|--:|--:|"
    )
    for runs in counts:
        some = z[:, : min(runs, PART)]
        theirs = jax_flights(some, runs)
        jax = f"{wall(theirs, options.rounds):.2f}" if theirs else ""
        for form in FORMS:
            for keep in ("nothing", "std"):
                work = flights(form, "cuda", some, runs, keep, options.jobs)
                work()
                inside.seconds = 0.0
                own = wall(work, options.rounds)
                within = inside.seconds / (options.rounds + 1)
                host = wall(flights(form, "compiled", some, runs, keep, options.jobs), 1)
                step = 1e6 * own / (runs * options.steps)
                print(
                    f"| {form} | {keep} | {runs} | {own:.2f} | {within:.2f} | {step:.5f} | "
                    f"{host:.2f} | {jax} |",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
