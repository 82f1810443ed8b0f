"""``celnav diagnose``: are the residuals in a table white, unbiased and as large as predicted?"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from celnav.commands.arguments import UsageError, number, whole
from celnav.files import InputError, Outputs
from celnav.gaussian.linalg import Array
from celnav.lazy import require
from celnav.show.claims import plain
from celnav.show.draw import picture_names, pictures

FILES = ("diagnosis.txt", "diagnosis.json", *picture_names(["diagnosis"]))
TIMES = ("t", "time", "times", "seconds", "epoch")
CLAIMS = ("std_", "sigma_")
EMPTY = ("", "nan", "null", "none", "na", "-")


class Table(NamedTuple):
    """Residuals ``(T, runs, m)`` at ``times (T,)``, and their predicted σ if the file has such
    columns.
    """

    times: Array
    residuals: Array
    std: Array | None
    names: list[str]
    ignored: list[str]


def run(options: argparse.Namespace) -> int:
    """Print a diagnosis, and write it if requested, after everything is computed."""
    from celnav.analysis.diagnose import diagnose
    from celnav.analysis.diagnosis_text import WIDTH, page
    from celnav.commands.terminal import columns

    lags, level = whole("lags", options.lags, 1), number("level", options.level)
    if not 0.0 < level < 1.0:
        raise UsageError(f"--level: expected a number between 0 and 1, got {options.level!r}")
    if options.out is not None:
        require("diagnose --out", "papers", "matplotlib", "PIL")
    outputs = None if options.out is None else Outputs(options.out)
    if outputs is not None:
        outputs.check(FILES)
    table = read(Path(options.residuals), options.time, options.columns)
    try:
        diagnosis = diagnose(
            table.residuals, table.times, std=table.std, names=table.names, lags=lags, level=level
        )
    except ValueError as error:
        raise InputError(f"{options.residuals}: {str(error).partition(': ')[2]}") from None
    ignored = ", ".join(table.ignored)
    more = f"\n\nnot looked at: {ignored} (--columns chooses)" if ignored else ""
    words = f"{options.residuals}: {diagnosis}{more}"
    print(f"{options.residuals}: {page(diagnosis, min(columns(), WIDTH))}{more}")
    if outputs is not None:
        from celnav.show.diagnosis import figure

        drawn = pictures([("diagnosis", figure(diagnosis))])
        listed = json.dumps(plain(diagnosis, digits=17), indent=1) + "\n"
        outputs.publish({"diagnosis.txt": words + "\n", "diagnosis.json": listed}, drawn)
        print(f"wrote {outputs.directory}")
    return 0


def read(path: Path, time: str | None = None, columns: Sequence[str] | None = None) -> Table:
    """The table of a file with a line of names, then one line for each epoch (and run).

    A line has an increasing time, a ``run`` if there are several runs, and components. A component
    ``x`` may have a column ``std_x`` with its predicted σ. Empty cells and nan are missing values.

    time: the column of times; None: the first column with a usual name for times. columns: the
        components; None: the components with a predicted σ, or else all columns of numbers.

    InputError names the file, and the line of an error.
    """
    names, cells, lines = _cells(path)
    values = np.array([[_value(cell) for cell in row] for row in cells]).reshape(-1, len(names))
    listed = ", ".join(names)
    numeric = [name for name, is_numeric in zip(names, np.isfinite(values).any(0)) if is_numeric]
    for name in (*([time] if time else []), *(columns or ())):
        if name not in names:
            raise InputError(f"{path}: expected a column {name!r}, got {listed}")

    def column(name: str) -> Array:
        place = names.index(name)
        for bad in np.flatnonzero(np.isinf(values[:, place])):
            raise InputError(
                f"{path}, line {lines[bad]}: expected a finite number or nothing as {name}, "
                f"got {cells[bad][place]!r:.40}"
            )
        return np.asarray(values[:, place])

    when = time or next((name for name in numeric if name.lower().partition("_")[0] in TIMES), None)
    if when is None:
        raise InputError(
            f"{path}: expected a column of times, such as t, got {listed}; name it with --time"
        )
    claims = {name: claim + name for name in numeric for claim in CLAIMS if claim + name in numeric}
    others = [name for name in numeric if name not in (when, "run") and not name.startswith(CLAIMS)]
    chosen = list(columns or claims or others)
    if not chosen:
        raise InputError(f"{path}: expected components beside {when}, got {listed}")
    t, run = column(when), column("run") if "run" in names else np.zeros(len(lines))
    for bad in np.flatnonzero(np.isnan(t) | np.isnan(run)):
        raise InputError(f"{path}, line {lines[bad]}: expected a time, got nothing")
    times, epoch_of = np.unique(t, return_inverse=True)
    runs, run_of = np.unique(run, return_inverse=True)
    for r in range(len(runs)):
        rows = np.flatnonzero(run_of == r)
        for before, row in pairwise(rows):
            if t[row] <= t[before]:
                raise InputError(
                    f"{path}, line {lines[row]}: expected a time after {t[before]:g}, "
                    f"got {t[row]:g}"
                )

    def arranged(some: Sequence[str]) -> Array:
        out = np.full((len(times), len(runs), len(some)), np.nan)
        out[epoch_of, run_of] = np.stack([column(name) for name in some], -1)
        return out

    std, used = None, {when, "run", *chosen}
    if all(name in claims for name in chosen):
        predicted = [claims[name] for name in chosen]
        std, used = arranged(predicted), used.union(predicted)
    ignored = [name for name in names if name not in used]
    return Table(times, arranged(chosen), std, chosen, ignored)


def _cells(path: Path) -> tuple[list[str], list[list[str]], list[int]]:
    """Names of columns, the cells of each row, and the line number of each row."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected a text table, got bytes that are not text") from None
    lines = {
        i: line
        for i, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.startswith("#")
    }
    if not lines:
        raise InputError(
            f"{path}: expected a line of names and lines of numbers, got an empty file"
        )
    first, head = next(iter(lines.items()))
    mark = next((mark for mark in ",;\t" if mark in head), None)
    split = (lambda line: next(csv.reader([line], delimiter=mark))) if mark else str.split
    rows = {i: [cell.strip() for cell in split(line)] for i, line in lines.items()}
    names = rows.pop(first)
    if not np.isinf([_value(name) for name in names]).any():
        raise InputError(
            f"{path}, line {first}: expected names of columns, such as t,x,std_x, got numbers"
        )
    if len(set(names)) != len(names):
        raise InputError(
            f"{path}, line {first}: expected names that differ, got {', '.join(names)}"
        )
    for i, cells in rows.items():
        if len(cells) != len(names):
            raise InputError(f"{path}, line {i}: expected {len(names)} columns, got {len(cells)}")
    return names, list(rows.values()), list(rows)


def _value(cell: str) -> float:
    """The number of a cell, nan if it is empty, infinite if it is not a number."""
    if cell.lower() in EMPTY:
        return np.nan
    try:
        return float(cell)
    except ValueError:
        return np.inf
