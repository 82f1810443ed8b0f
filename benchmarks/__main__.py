"""``python -m benchmarks [CELL ...]``: CPU time of celnav and its peers, one thread each."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

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
    parser.add_argument("--quote", action="store_true", help="write speed.json and the READMEs")
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks"), help="a folder")
    options = parser.parse_args(arguments)
    unknown = set(options.cells) - set(known)
    if unknown or options.rounds < 1 or (options.quote and options.beside):
        parser.error(
            f"expected some of {', '.join(known)}; rounds of 1 or more; --quote or --beside"
        )
    with processes(options.beside) as found:
        measured = {
            name: measure(cell, options.rounds, found, lambda text: print(text, file=sys.stderr))
            for name, cell in known.items()
            if not options.cells or name in options.cells
        }
    result = {"machine": machine(), "cells": measured}
    print(markdown(result))
    write(result, options.out)
    if options.quote:
        quote(result)
    rows = [row for cell in measured.values() for row in cell["rows"]]
    wrong = [row for row in rows if not row.get("agrees", True)]
    for row in wrong:
        print(
            f"other estimates: {row['problem']}, {row['method']}: {row['apart']}", file=sys.stderr
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
