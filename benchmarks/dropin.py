"""``python -m benchmarks.dropin``: a step of the drop-in against filterpy's own
`UnscentedKalmanFilter`, one run.

A chain of integrators, a product with a matrix for each model: the cheapest there is, so that what
the filters spend themselves shows most. Each round flies all three one after another, each in its
turn first, and ratios are taken within rounds.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from celnav.filters.dropin import SigmaPointUKF, SquareRootUKF
from celnav.gaussian.linalg import Array

SIZES = ((2, 1), (6, 3), (9, 4))
"""Components of the state and of the measurement."""
KINDS: tuple[Callable[..., Any], ...] = (UnscentedKalmanFilter, SquareRootUKF, SigmaPointUKF)


def filter_of(kind: Callable[..., Any], n: int, m: int) -> Any:
    """A filter, its models one vector at a time, with the points of filterpy's examples: the center
    has a negative weight.
    """
    F, H = np.eye(n) + 0.1 * np.eye(n, k=1), np.eye(m, n)
    kf = kind(
        n,
        m,
        0.1,
        lambda x: H @ x,
        lambda x, dt: F @ x,  # noqa: ARG005
        MerweScaledSigmaPoints(n, 0.1, 2.0, 3.0 - n),
    )
    kf.P, kf.Q, kf.R = 0.5 * np.eye(n), 0.01 * np.eye(n), 0.25 * np.eye(m)
    return kf


def flight(kind: Callable[..., Any], zs: Array, n: int) -> tuple[float, Array]:
    """CPU seconds of a step, and the last estimate."""
    kf = filter_of(kind, n, zs.shape[1])
    start = process_time()
    for z in zs:
        kf.predict()
        kf.update(z)
    return (process_time() - start) / len(zs), kf.x


def main(arguments: list[str] | None = None) -> int:
    """Measure in interleaved rounds, print, write; 1 if the estimates disagree."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.dropin", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--rounds", type=int, default=31, help="interleaved rounds (default 31)")
    parser.add_argument("--steps", type=int, default=200, help="steps of a flight (default 200)")
    parser.add_argument(
        "--out", type=Path, default=Path("out/benchmarks"), help="folder of the results"
    )
    options = parser.parse_args(arguments)
    if options.rounds < 1 or options.steps < 1:
        parser.error("rounds and steps: expected positive integers")
    names = [kind.__name__ for kind in KINDS]
    columns = [
        "n",
        "m",
        *(f"{name}, us" for name in names),
        *(f"{name} / filterpy" for name in names[1:]),
    ]
    print("| " + " | ".join(columns) + " |")
    print("|--:|--:|" + "--:|" * (len(columns) - 2))
    result, apart = [], 0.0
    for n, m in SIZES:
        zs = np.random.default_rng(n).normal(size=(options.steps, m))
        ends = [flight(kind, zs, n)[1] for kind in KINDS]
        apart = max([apart, *(float(np.abs(end - ends[0]).max()) for end in ends)])
        rounds = []
        for i in range(options.rounds):
            order = [(i + k) % len(KINDS) for k in range(len(KINDS))]
            found = {k: 1e6 * flight(KINDS[k], zs, n)[0] for k in order}
            rounds.append([found[k] for k in range(len(KINDS))])
        us = [median(r[k] for r in rounds) for k in range(len(KINDS))]
        ratios = [median(r[k] / r[0] for r in rounds) for k in range(1, len(KINDS))]
        print(
            f"| {n} | {m} | "
            + " | ".join(f"{t:.0f}" for t in us)
            + " | "
            + " | ".join(f"{r:.2f}" for r in ratios)
            + " |"
        )
        row = {
            "n": n,
            "m": m,
            "us": dict(zip(names, us, strict=True)),
            "ratio": dict(zip(names[1:], ratios, strict=True)),
        }
        result.append(row)
    print(f"\nLargest difference of the estimates: {apart:.1e}.")
    options.out.mkdir(parents=True, exist_ok=True)
    settings = {"rounds": options.rounds, "steps": options.steps, "apart": apart, "sizes": result}
    (options.out / "dropin.json").write_text(
        json.dumps(settings, indent=1) + "\n", encoding="utf-8"
    )
    return 0 if apart < 1e-9 else 1


if __name__ == "__main__":
    raise SystemExit(main())
