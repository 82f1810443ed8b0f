"""``python -m benchmarks.sparse``: a cycle of the covariance filter with rules of many points,
against its model alone.

The model is that of the second paper (13 states, 8 measurements, 50 runs); numbers are CPU time of
one run's cycle. "Model inside" is the time that the filter spends in its model; "model alone"
evaluates the same points again and again, which then stay in cache: less than any filter can reach.
    "One run" is a run that is flown alone, its cycle the least of all rounds.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from time import process_time

from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch
from celnav.filters.run import run
from celnav.filters.sequential import sigma_point
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule
from celnav.gaussian.sparse_grid import smolyak
from celnav.papers.aasghqf import scenario
from celnav.papers.aasghqf.scenario import PAPER_WEIGHTS, A
from celnav.study.montecarlo import generator

RUNS, STEPS = 50, 10
CACHED = 131072
"""Numbers in the sigma points of a block."""


def rules() -> dict[str, Rule]:
    """27, 75, 417 and 3195 points."""
    return {
        "level 2, 27 points": smolyak(13, 2),
        "level 3, 75 points": smolyak(13, 3, PAPER_WEIGHTS),
        "level 3, 417 points": smolyak(13, 3),
        "level 4, 3195 points": smolyak(13, 4, (1,) * 11 + (2,) * 2),
    }


class Timed:
    """A model function that counts its own CPU time."""

    def __init__(self, function: Callable[..., Array]):
        self.function, self.seconds = function, 0.0

    def __call__(self, x: Array, epoch: Epoch) -> Array:
        start = process_time()
        out = self.function(x, epoch)
        self.seconds += process_time() - start
        return out


def work(rule: Rule, block: int, runs: int = RUNS) -> Callable[[], tuple[float, float, float]]:
    """One pass over all runs in blocks: CPU microseconds of a run's cycle, of the model inside, and
    of the model alone.
    """
    config = replace(A, steps=STEPS)
    firsts = range(0, runs, block)
    parts = [
        scenario.simulate(config, [generator(0, 0, r) for r in range(i, min(i + block, runs))])
        for i in firsts
    ]
    epochs: list[list[Epoch]] = [list(part.epochs()) for part in parts]
    f, h = Timed(scenario.dynamics), Timed(scenario.measurement)
    motion, sensor = (
        Motion(f, sqrt_Q=config.sqrt_Q),
        Sensor(h, sqrt_R=lambda _, epoch: epoch.u.sqrt_R),
    )
    filter = sigma_point(motion, sensor, rule=rule, form=scenario.FORM)
    points: list[Array] = [
        rule.points(part.prior.mean, 1e-3 * part.prior.sqrt_cov)[0] for part in parts
    ]

    def once() -> tuple[float, float, float]:
        f.seconds = h.seconds = 0.0
        start = process_time()
        for part, at in zip(parts, epochs, strict=True):
            run(filter, part.prior, at, keep="nothing", engine="numpy")
        cycle = process_time() - start
        start = process_time()
        for x, at in zip(points, epochs, strict=True):
            for epoch in at:
                scenario.measurement(x, epoch)
                if epoch.k:
                    scenario.dynamics(x, epoch)
        alone = process_time() - start
        cycle, inside, alone = (
            1e6 * t / (runs * STEPS) for t in (cycle, f.seconds + h.seconds, alone)
        )
        return cycle, inside, alone

    return once


def main(arguments: list[str] | None = None) -> int:
    """Measure in interleaved rounds, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sparse", description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, help="interleaved rounds (default 7)")
    parser.add_argument(
        "--out", type=Path, default=Path("out/benchmarks"), help="folder of the results"
    )
    options = parser.parse_args(arguments)
    if options.rounds < 1:
        parser.error("rounds: expected a positive integer")
    passes, single = {}, {name: work(rule, 1, 1) for name, rule in rules().items()}
    for name, rule in rules().items():
        block = max(1, min(RUNS, CACHED // rule.nodes.size))
        passes[name] = work(rule, block)
        passes[name]()
        print(f"ready: {name}, blocks of {block}", file=sys.stderr, flush=True)
    rounds = [{name: once() for name, once in passes.items()} for _ in range(options.rounds)]
    lone = {name: min(once()[0] for _ in range(options.rounds)) for name, once in single.items()}
    first = next(iter(passes))
    lines = [
        "| rule | cycle, us | model inside, us | model alone, us | filter / inside | filter / "
        "alone | against 27 | one run, us |",
        "|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    result = {}
    for name in passes:
        cycle, inside, alone = (median(r[name][i] for r in rounds) for i in range(3))
        over = [median(r[name][0] / r[name][i] for r in rounds) for i in (1, 2)]
        against = median(r[name][0] / r[first][0] for r in rounds)
        lines.append(
            f"| {name} | {cycle:.1f} | {inside:.1f} | {alone:.1f} | {over[0]:.2f} | {over[1]:.2f} "
            f"| {against:.2f} | "
            f"{lone[name]:.0f} |"
        )
        result[name] = {
            "cycle_us": cycle,
            "inside_us": inside,
            "alone_us": alone,
            "filter_to_inside": over[0],
            "filter_to_alone": over[1],
            "to_27_points": against,
            "one_run_us": lone[name],
        }
    print("\n".join(lines))
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "sparse.json").write_text(
        json.dumps({"rounds": options.rounds, "rules": result}, indent=1) + "\n"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
