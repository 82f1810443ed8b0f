"""What is measured: cells, each of which is a table of problems and methods."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple


class Entry(NamedTuple):
    """One number of a table: a method on a problem.

    Attributes
    ----------
    work: the function that makes the pass, such as "celnav.run" of the module `using_celnav`; what
        stands before the dot names the process. arguments: of that function.
    units: how many of the cell's units a pass has, such as steps of runs.
    clock: "cpu" or "wall" seconds of a pass; "cold": CPU seconds of a new process with one pass;
        "peak": MB that such a process needs.
    apart: how far the estimates may be from those of the problem's first method, relative to the
        largest number; None: another algorithm, or nothing to compare.
    """

    problem: str
    method: str
    work: str
    arguments: tuple[Any, ...]
    units: float = 1.0
    clock: str = "cpu"
    apart: float | None = 1e-9


class Cell(NamedTuple):
    """A table. scale: of seconds to the unit."""

    name: str
    title: str
    unit: str
    scale: float
    entries: list[Entry]


STEP = "µs per step of a run"
SHAPES = ((1, 300), (100, 240), (512, 120), (4096, 48))
"""Runs, and epochs of each; a step costs the same at each epoch, so that many runs may be short."""
FORMS = ("square root", "covariance")
JAX = 1e-7
"""dynamax adds 1e-9 to each diagonal that it solves with."""


def sized(runs: int, epochs: int) -> str:
    """Of a problem."""
    return f"{runs:,} run{'s' * (runs > 1)}, {epochs} epochs"


def filtering() -> Iterator[Entry]:
    """Libraries without batches take one run: many cost as much for each."""
    for runs, epochs in SHAPES:
        what, many = sized(runs, epochs), runs * epochs
        for form in FORMS:
            arguments = ("orbit", runs, epochs, "numpy", form)
            yield Entry(what, f"celnav numpy, {form}", "celnav.run", arguments, many)
        for form in FORMS:
            arguments = ("orbit", runs, epochs, form)
            yield Entry(what, f"celnav compiled, {form}", "celnav.compiled", arguments, many)
        arguments = ("orbit", runs, epochs)
        yield Entry(what, "dynamax", "dynamax.unscented", arguments, many, apart=JAX)
        if runs == 1:
            yield Entry(what, "filterpy", "filterpy.unscented", ("orbit", epochs), epochs)
            numba = ("orbit", epochs, "numba")
            yield Entry(what, "filterpy, numba model", "filterpy.unscented", numba, epochs)
            yield Entry(what, "Stone Soup", "stonesoup.unscented", (epochs,), epochs)


def streaming() -> Iterator[Entry]:
    """One orbit, one step at a time."""
    what, epochs = "1 run, 300 epochs", 300
    for engine in ("numpy", "compiled"):
        yield Entry(what, f"{engine}: step", "celnav.step", (engine,), epochs)
        yield Entry(what, f"{engine}: steps", "celnav.steps", (engine,), epochs)
        yield Entry(what, f"{engine}: FixedLag 20", "celnav.step", (engine, 20), epochs)
    yield Entry(what, "filterpy", "filterpy.unscented", ("orbit", epochs), epochs)


def smoothing() -> Iterator[Entry]:
    """There and back. dynamax adds its 1e-9 to the predicted covariance, which matters more."""
    for runs in (1, 100):
        what, many = sized(runs, 200), runs * 200
        for engine in ("numpy", "compiled"):
            arguments = (runs, 200, engine)
            yield Entry(what, f"celnav {engine}", "celnav.smooth", arguments, many)
        yield Entry(what, "dynamax", "dynamax.smooth", (runs, 200), many, apart=1e-5)
        yield Entry(what, "cuthbert, EKF", "cuthbert.smooth", (runs, 200), many, apart=1e-4)
    for engine in ("numpy", "compiled"):
        arguments, what = (1, 100, engine), "1 run, 100 epochs, 3 iterations"
        yield Entry(what, f"celnav {engine}", "celnav.iterated", arguments, 300)


def shared() -> Iterator[Entry]:
    """512 runs of a linear system have one covariance."""
    for n in (4, 10, 20, 30):
        name, runs, epochs = f"linear {n}", 512, 60
        what, many = f"n = {n}, m = {n // 2}", runs * epochs
        for engine in ("numpy", "compiled", "auto"):
            arguments = (name, runs, epochs, engine)
            yield Entry(what, f"celnav {engine}", "celnav.run", arguments, many)
        arguments = (name, runs, epochs)
        yield Entry(what, "dynamax", "dynamax.kalman", arguments, many, apart=JAX)
        yield Entry(what, "filterpy, one run", "filterpy.kalman", arguments, epochs)


def simulating() -> Iterator[Entry]:
    """celnav has a generator for each run, so that no run depends on the others."""
    what, arguments, many = sized(10_000, 101), (10_000, 101), 1.01e6
    yield Entry(what, "celnav.simulate", "celnav.simulate", arguments, many, apart=None)
    yield Entry(what, "numpy, one generator", "numpy.simulate", arguments, many, apart=None)


def campaigns() -> Iterator[Entry]:
    """A unit after another one: simulated, filtered, judged."""
    for engine in ("numpy", "compiled"):
        arguments, what = (engine,), "100 runs, 600 epochs, csrukf+z0"
        yield Entry(what, f"celnav {engine}", "celnav.campaign", arguments, 6e4, apart=None)


def sizes() -> Iterator[Entry]:
    """Lorenz-96, half of whose components are measured."""
    for n in (4, 8, 16, 32):
        name, runs, epochs = f"lorenz {n}", 128, 40
        what, many = f"n = {n}, m = {n // 2}", runs * epochs
        for engine in ("numpy", "compiled"):
            work = "celnav.compiled" if engine == "compiled" else "celnav.run"
            arguments = (name, runs, epochs) + (() if engine == "compiled" else (engine,))
            yield Entry(what, f"celnav {engine}", work, arguments, many)
        yield Entry(what, "dynamax", "dynamax.unscented", (name, runs, epochs), many, apart=JAX)


def first() -> Iterator[Entry]:
    """From the start of a process to its first estimates."""
    for runs, epochs in SHAPES[:2]:
        what, arguments = f"orbit, {sized(runs, epochs)}", ("orbit", runs, epochs)
        for engine in ("numpy", "compiled", "auto"):
            yield Entry(what, f"celnav {engine}", "celnav.run", (*arguments, engine), clock="cold")
        yield Entry(what, "dynamax", "dynamax.unscented", arguments, clock="cold")
        if runs == 1:
            yield Entry(what, "filterpy", "filterpy.unscented", ("orbit", epochs), clock="cold")
    for n in (8, 16, 32):
        what, arguments = f"Lorenz-96, n = {n}, {sized(128, 40)}", (f"lorenz {n}", 128, 40)
        yield Entry(what, "celnav compiled", "celnav.compiled", arguments, clock="cold")
        if n == 8:
            yield Entry(what, "dynamax", "dynamax.unscented", arguments, clock="cold")


def storing() -> Iterator[Entry]:
    """By machine code, which takes less time than to write much down."""
    for runs, epochs in (*SHAPES, (2000, 600)):
        for keep in ("nothing", "std", "cov") if runs != 2000 else ("nothing", "std"):
            arguments, many = ("orbit", runs, epochs, "square root", keep), runs * epochs
            what, apart = sized(runs, epochs), None if keep == "nothing" else 1e-9
            yield Entry(what, keep, "celnav.compiled", arguments, many, apart=apart)


def memory() -> Iterator[Entry]:
    """A tenth of 100,000 runs of 600 epochs. Its measurements alone are 144 MB."""
    for keep in ("nothing", "std"):
        arguments = ("orbit", 10_000, 600, "square root", keep)
        yield Entry(sized(10_000, 600), keep, "celnav.compiled", arguments, clock="peak")


def fixed() -> Iterator[Entry]:
    """One run, with what was compiled before."""
    for n, name in {2: "pendulum", 4: "ballistic", 5: "turn", 6: "orbit"}.items():
        for epochs in (3, 30, 300, 3000):
            what = f"n = {n}, {epochs} epochs"
            yield Entry(what, "celnav compiled", "celnav.compiled", (name, 1, epochs))
            arguments = (name, 1, epochs)
            yield Entry(what, "dynamax", "dynamax.unscented", arguments, apart=JAX)


def threads() -> Iterator[Entry]:
    """Of machine code, by the clock on the wall."""
    for jobs in (1, 2):
        arguments = ("orbit", 4096, 240, "square root", "std", jobs)
        what, method = sized(4096, 240), f"{jobs} thread{'s' * (jobs > 1)}"
        yield Entry(what, method, "celnav.compiled", arguments, clock="wall")


def cells() -> list[Cell]:
    """All of them."""
    makers: list[tuple[str, str, str, float, Callable[[], Iterator[Entry]]]] = [
        ("filtering", "Unscented filters of an orbit (n = 6, m = 3)", STEP, 1e6, filtering),
        ("streaming", "The same, one step at a time", "µs per step", 1e6, streaming),
        ("smoothing", "Filter and smoother of the orbit", STEP, 1e6, smoothing),
        ("shared", "Linear systems, 512 runs with one covariance, 60 epochs", STEP, 1e6, shared),
        ("simulating", "Simulated pendulums (n = 2, m = 1)", STEP, 1e6, simulating),
        ("campaign", "A unit of a campaign", STEP, 1e6, campaigns),
        ("size", "Unscented filters of Lorenz-96, 128 runs, 40 epochs", STEP, 1e6, sizes),
        ("first", "From the start of a process to its first result", "s of CPU time", 1.0, first),
        ("storing", "What `keep` costs, compiled, the orbit", STEP, 1e6, storing),
        ("memory", "Peak memory of a process, compiled, the orbit", "MB", 1.0, memory),
        ("fixed", "One run of so many epochs, compiled before", "µs per run", 1e6, fixed),
        ("threads", "Machine code in threads, the orbit", "s on the clock", 1.0, threads),
    ]
    return [
        Cell(name, title, unit, scale, list(entries()))
        for name, title, unit, scale, entries in makers
    ]
