"""Monte Carlo: how many runs, one generator for each, and blocks of them that stay in cache.

A run's random numbers depend on ``(seed, study, run)`` alone, where ``study`` numbers the configuration: not on the size of a
block, the number of processes or the order of the work.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from celnav.gaussian.checks import integer, kind, number, sequence
from celnav.gaussian.linalg import Array

__all__ = ["BRIEF", "MOST_STEPS", "blocks", "effort", "generator", "normals", "run_count", "steps"]

MOST_STEPS = 10_000_000  # of one run, at its finest rate: more take a day, and gigabytes
BRIEF = 0.1
"""Effort below which studies shorten their runs too: so few of them decide little anyhow."""


def generator(seed: int, study: int, run: int) -> np.random.Generator:
    """The generator of one run of one study, which are not negative."""
    key = (integer("study", study, 0), integer("run", run, 0))
    return np.random.default_rng(np.random.SeedSequence(integer("seed", seed, 0), spawn_key=key))


def normals(rngs: Sequence[np.random.Generator], *shapes: tuple[int, ...]) -> list[Array]:
    """Standard normal arrays, one of each shape from each generator, with the run axis before the last: ``(..., runs, n)``."""
    for rng in (
        every := sequence(
            "rngs", rngs, "[celnav.study.montecarlo.generator(seed, study, run)]", least=1
        )
    ):
        if not hasattr(rng, "standard_normal"):
            raise ValueError(
                f"rngs: expected generators, such as np.random.default_rng(0), got {kind(rng)}"
            )

    draws = [[rng.standard_normal(shape) for shape in shapes] for rng in every]
    return [np.stack(column, -2) for column in zip(*draws, strict=True)]


def blocks(runs: int, size: int) -> list[range]:
    """Consecutive ranges of at most ``size`` runs."""
    return [
        range(first, min(first + size, runs))
        for first in range(0, integer("runs", runs), integer("block", size))
    ]


def effort(value: str | float | None = None, default: float = 1.0) -> float:
    """A fraction in (0, 1] of the Monte-Carlo runs: the argument, else ``CELNAV_EFFORT``, which is read only here, or a default."""
    name, given = (
        ("effort", value)
        if value is not None
        else ("CELNAV_EFFORT", os.environ.get("CELNAV_EFFORT", default))
    )
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
