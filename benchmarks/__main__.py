"""``python -m benchmarks``: CPU time of celnav and its peers on one workload, one thread; more of the compiled engine."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks import compiled
from benchmarks.engines import celnav_engines
from benchmarks.measure import measure
from benchmarks.peers import peer_engines
from benchmarks.report import markdown, report, write
from benchmarks.workload import Workload


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write; 1 if two engines disagree on the estimate."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "--steps",
        type=int,
        default=600,
        help="steps of a run (default 600; large batches take fewer)",
    )
    parser.add_argument("--rounds", type=int, default=7, help="interleaved rounds (default 7)")
    parser.add_argument(
        "--only",
        default="",
        help="comma-separated parts of engine names, such as 'square root,filterpy'",
    )
    parser.add_argument(
        "--runs",
        default="1,100,512,4096",
        help="run counts of the batched engines (default 1,100,512,4096)",
    )
    parser.add_argument(
        "--parts",
        type=int,
        default=compiled.PARTS,
        help="of the campaign, 2000 runs each (default 50; 0: none)",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/benchmarks"), help="folder of the results"
    )
    options = parser.parse_args(arguments)
    counts = [int(count) for count in options.runs.split(",")]
    if options.steps < 1 or options.rounds < 1 or min(counts) < 1:
        parser.error("steps, rounds and runs: expected positive integers")
    engines = [*peer_engines(counts), *celnav_engines(counts)]
    wanted = [part.strip() for part in options.only.split(",") if part.strip()]
    engines = [e for e in engines if not wanted or any(part in e.name for part in wanted)]
    if not engines:
        parser.error(f"only: no engine is named like {options.only!r}")
    workload = Workload(options.steps, max(e.runs for e in engines))
    rows, absent = measure(
        engines, workload, options.rounds, lambda text: print(text, file=sys.stderr, flush=True)
    )
    result = report(rows, absent, options.steps, options.rounds)
    if not wanted:
        result["compiled"] = compiled.report(options.rounds, options.parts)
    print(markdown(result))
    write(result, options.out)
    return 0 if result["agree"] else 1


if __name__ == "__main__":
    raise SystemExit(main())
