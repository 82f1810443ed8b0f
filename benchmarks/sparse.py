"""``python -m benchmarks.sparse``: a cycle of the covariance filter with rules of many points, against its model alone.

The model is that of the second paper (13 states, 8 measurements, 50 runs); numbers are CPU time of one run's cycle.
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

import numpy as np

from celnav.filters.driver import Epoch, run, sequential
from celnav.filters.step import predict, update
from celnav.linalg import Array
from celnav.montecarlo import generator
from celnav.papers.aasghqf import scenario
from celnav.papers.aasghqf.config import PAPER_WEIGHTS, A
from celnav.points import Rule
from celnav.spaces import EUCLIDEAN
from celnav.sparse_grid import smolyak

RUNS, STEPS = 50, 10


def rules() -> dict[str, Rule]:
    """27, 75, 417 and 3195 points."""
    return {
        "level 2, 27 points": smolyak(13, 2),
        "level 3, 75 points": smolyak(13, 3, PAPER_WEIGHTS),
        "level 3, 417 points": smolyak(13, 3),
        "level 4, 3195 points": smolyak(13, 4, (1,) * 11 + (2,) * 2),
    }


def work(rule: Rule, block: int) -> tuple[Callable[[], None], Callable[[], None]]:
    """A pass of the filter over all runs in blocks, and the model evaluations of that pass alone."""
    config = replace(A, steps=STEPS)
    parts = [scenario.simulate(config, [generator(0, 0, r) for r in range(i, min(i + block, RUNS))]) for i in range(0, RUNS, block)]
    epochs: list[list[Epoch]] = [list(part.epochs()) for part in parts]
    filter = sequential(
        predict(scenario.dynamics, rule, sqrt_Q=config.sqrt_Q), update(scenario.measurement, rule, sqrt_R=scenario.sqrt_R)
    )
    roots = [part.prior.root for part in parts]

    def whole() -> None:
        for part, at in zip(parts, epochs, strict=True):
            run(filter, part.prior, at, keep="nothing")

    points: list[Array] = [rule.points(part.prior.mean, 1e-3 * root, EUCLIDEAN)[0] for part, root in zip(parts, roots, strict=True)]

    def model() -> None:
        for x, at in zip(points, epochs, strict=True):
            for epoch in at:
                scenario.measurement(x, epoch)
                if epoch.k:
                    scenario.dynamics(x, epoch)

    return whole, model


def timed(function: Callable[[], None]) -> float:
    """CPU microseconds of a run's cycle."""
    start = process_time()
    function()
    return (process_time() - start) / (RUNS * STEPS) * 1e6


def main(arguments: list[str] | None = None) -> int:
    """Measure in interleaved rounds, print, write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sparse", description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, help="interleaved rounds (default 7)")
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks"), help="folder of the results")
    options = parser.parse_args(arguments)
    if options.rounds < 1:
        parser.error("rounds: expected a positive integer")
    passes = {}
    for name, rule in rules().items():
        block = max(1, min(RUNS, 262144 // rule.nodes.size))
        passes[name] = work(rule, block)
        print(f"ready: {name}, blocks of {block}", file=sys.stderr, flush=True)
    for pair in passes.values():
        for function in pair:
            function()
    rounds = [{name: tuple(timed(f) for f in pair) for name, pair in passes.items()} for _ in range(options.rounds)]
    first = next(iter(passes))
    lines = ["| rule | cycle, us | model alone, us | filter / model | against 27 points |", "|---|--:|--:|--:|--:|"]
    result = {}
    for name in passes:
        cycle, model = (median(r[name][i] for r in rounds) for i in (0, 1))
        over, against = median(r[name][0] / r[name][1] for r in rounds), median(r[name][0] / r[first][0] for r in rounds)
        lines.append(f"| {name} | {cycle:.1f} | {model:.1f} | {over:.2f} | {against:.2f} |")
        result[name] = {"cycle_us": cycle, "model_us": model, "filter_to_model": over, "to_27_points": against}
    print("\n".join(lines))
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "sparse.json").write_text(json.dumps({"rounds": options.rounds, "rules": result}, indent=1) + "\n")
    assert np.isfinite([v["cycle_us"] for v in result.values()]).all()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
