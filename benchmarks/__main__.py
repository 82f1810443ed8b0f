"""``python -m benchmarks [CELL ...]``: CPU time of celnav and its peers, one thread each."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from benchmarks.cells import cells
from benchmarks.measure import measure, processes
from benchmarks.report import machine, markdown, quote, write


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write; 1 if two methods disagree on the estimates."""
    known = {cell.name: cell for cell in cells()}
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("cells", nargs="*", help=f"of {', '.join(known)} (default: all)")
    parser.add_argument("--rounds", type=int, default=5, help="of each cell (default 5)")
    parser.add_argument("--beside", type=Path, help="another checkout of celnav, pass by pass")
    parser.add_argument(
        "--quote", action="store_true", help="write benchmarks/speed.json and the READMEs"
    )
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks"), help="a folder")
    options = parser.parse_args(arguments)
    unknown = set(options.cells) - set(known)
    if unknown or options.rounds < 1 or (options.quote and options.beside):
        parser.error(
            f"expected some of {', '.join(known)}; rounds of 1 or more; --quote or --beside"
        )
    result: dict[str, Any] = {"machine": machine(), "cells": {}}
    with processes(options.beside) as found:
        for name, cell in known.items():
            if options.cells and name not in options.cells:
                continue
            result["cells"][name] = measure(cell, options.rounds, found, say)
            write(result, options.out)  # after each cell: an interruption loses no other
    print(markdown(result))
    if options.quote:
        quote(result)
    rows = [row for cell in result["cells"].values() for row in cell["rows"]]
    wrong = [row for row in rows if not row.get("agrees", True)]
    for row in wrong:
        say(f"other estimates: {row['problem']}, {row['method']}: {row['apart']}")
    return 1 if wrong else 0


def say(text: str) -> None:
    """How far it is."""
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
