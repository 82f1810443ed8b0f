"""celnav's filters as engines, and the floor under them: the model evaluations alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.workload import BLOCK, P0, SQRT_Q, X0, H, R
from celnav.filters.compiled import compiled
from celnav.filters.model import Motion, Sensor
from celnav.filters.run import run
from celnav.filters.sequential import Sequential, ukf
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import FORMS, Array
from celnav.gaussian.rules import unscented
from celnav.models import orbit
from celnav.tape import llvm

Work = Callable[[], Array | None]
"""One timed pass; returns the means ``(steps + 1, runs, 6)``, or None where there is no estimate."""


class Engine(NamedTuple):
    """``prepare(z)`` makes the work for measurements ``z (steps + 1, runs, 3)``; ImportError: the peer is not installed."""

    name: str
    runs: int
    prepare: Callable[[Array], Work]
    compiles: bool = False


class Inside:
    """CPU seconds inside the loops of compiled filters, since it was last set to zero."""

    def __init__(self) -> None:
        self.seconds, self.loop = 0.0, llvm.fly
        llvm.fly = self.fly

    def fly(self) -> Callable[..., None]:
        """The package's own loop, with a clock around it."""
        loop = self.loop()

        def timed(*arguments: Any) -> None:
            begin = time.process_time()
            loop(*arguments)
            self.seconds += time.process_time() - begin

        return timed


INSIDE = Inside()


def celnav_engines(counts: Sequence[int]) -> Iterator[Engine]:
    """Both forms, the measurement as a matrix (the normal way) and as a function; with a matrix also compiled; and the floor."""
    measurements: tuple[tuple[str, Any], ...] = (
        ("H matrix", H),
        ("h function", lambda x, _epoch: x[..., :3]),
    )
    for runs in counts:
        for form in FORMS:
            for kind, h in measurements:
                yield Engine(f"celnav {form}, {kind}", runs, _filter(form, h))
            yield Engine(f"celnav {form}, compiled", runs, _compiled(form), compiles=True)
        yield Engine("model floor", runs, _floor)


def dynamics(x: Array, _epoch: Any) -> Array:
    """The model of every numpy engine."""
    return orbit.step(x, 1.0)


def orbit_filter(form: str = "square root", h: Any = H) -> Sequential:
    """The filter of the common workload."""
    return ukf(Motion(dynamics, sqrt_Q=SQRT_Q), Sensor(h, R), form=form)


def prior(runs: int) -> Gaussian:
    """The same for all runs."""
    return Gaussian(np.broadcast_to(X0, (runs, 6)), P0)


def _filter(form: str, h: Any) -> Callable[[Array], Work]:
    def prepare(z: Array) -> Work:
        filter = orbit_filter(form, h)
        times, runs = np.arange(len(z)), z.shape[1]

        def work() -> Array:
            if runs == 1:
                return _means(run(filter, Gaussian(X0, P0), times, z[:, 0], engine="numpy").mean)[
                    :, None
                ]
            tracks = []
            for first in range(0, runs, BLOCK):
                part = z[:, first : first + BLOCK]
                tracks.append(
                    _means(run(filter, prior(part.shape[1]), times, part, engine="numpy").mean)
                )
            return tracks[0] if len(tracks) == 1 else np.concatenate(tracks, 1)

        return work

    return prepare


def _compiled(form: str) -> Callable[[Array], Work]:
    def prepare(z: Array) -> Work:
        flown = compiled(orbit_filter(form))
        times, runs = np.arange(len(z)), z.shape[1]
        if runs == 1:
            return lambda: _means(flown.run(Gaussian(X0, P0), times, z[:, 0]).mean)[:, None]
        return lambda: _means(flown.run(prior(runs), times, z).mean)

    return prepare


def _means(mean: Array | None) -> Array:
    if mean is None:
        raise RuntimeError("the track stored no means")
    return mean


def estimate(z: Array) -> Array:
    """The estimate that all are compared with: celnav's square-root filter, ``(steps + 1, runs, 6)``."""
    means = _filter("square root", H)(z)()
    return _means(means)


def _floor(z: Array) -> Work:
    """13 sigma points through the model, steps times, in blocks, in the memory layout that the filter gives them."""
    steps, runs = len(z) - 1, z.shape[1]
    root = np.sqrt(P0)

    def work() -> None:
        for first in range(0, runs, BLOCK):
            size = min(BLOCK, runs - first)
            mean = X0 if runs == 1 else np.tile(X0, (size, 1))
            (points,) = unscented(6).points(mean, root)
            for _ in range(steps):
                orbit.step(points, 1.0)

    return work
