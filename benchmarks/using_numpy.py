"""A plain loop in numpy, with one generator of random numbers for all runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks.problems import measurements, problem


def simulate(runs: int, epochs: int) -> Callable[[], Any]:
    """Measurements of pendulums."""

    def work() -> None:
        measurements(problem("pendulum"), runs, epochs)

    return work
