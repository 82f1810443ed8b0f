"""``celnav diagnose``: are the residuals in a table white, unbiased and as large as predicted?"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from celnav.commands.arguments import UsageError, number, whole
from celnav.files import InputError, Outputs
from celnav.gaussian.linalg import Array
from celnav.lazy import require
from celnav.show.draw import picture_names, pictures

__all__ = ["read", "run"]

FILES = ("diagnosis.txt", "diagnosis.json", *picture_names(["diagnosis"]))
TIMES = ("t", "time", "times", "seconds", "epoch")
CLAIMS = ("std_", "sigma_")
EMPTY = ("", "nan", "null", "none", "na", "-")


class Table(NamedTuple):
    """Residuals ``(T, runs, m)`` at ``times (T,)``, and their predicted σ where columns have it."""

    times: Array
    residuals: Array
    std: Array | None
    names: list[str]
    ignored: list[str]


def run(options: argparse.Namespace) -> int:
    """Everything is computed before anything is written."""
    from celnav.analysis.diagnose import diagnose

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
        found = diagnose(
            table.residuals, table.times, std=table.std, names=table.names, lags=lags, level=level
        )
    except ValueError as error:
        raise InputError(f"{options.residuals}: {str(error).partition(': ')[2]}") from None
    words = f"{options.residuals}: {found}"
    if table.ignored:
        words += f"\n\nnot looked at: {', '.join(table.ignored)} (--columns chooses)"
    print(words)
    if outputs is not None:
        from celnav.show.diagnosis import figure

        drawn = pictures([("diagnosis", figure(found))])
        listed = json.dumps(_plain(found), indent=1) + "\n"
        outputs.publish({"diagnosis.txt": words + "\n", "diagnosis.json": listed}, drawn)
        print(f"wrote {outputs.directory}")
    return 0


def _plain(x: Any) -> Any:
    """A diagnosis as JSON has it; nan is null."""
    if hasattr(x, "_asdict"):
        return {name: _plain(part) for name, part in x._asdict().items()}
    if isinstance(x, tuple | list | np.ndarray):
        return [_plain(part) for part in x]
    x = x.item() if isinstance(x, np.generic) else x
    return None if isinstance(x, float) and not np.isfinite(x) else x


def read(path: Path, time: str | None = None, columns: Sequence[str] | None = None) -> Table:
    """A table with a line of names, then one for each epoch (and run).

    A line has a time that increases, a ``run`` if there are several, and components. A component
    ``x`` may have its predicted σ beside it, as ``std_x``. What is empty or nan is missing.

    time: the column of times; None: the first one of that name.
    columns: the components; None: those with a predicted σ, or else all that are numbers.

    InputError names the file, and the line where something is wrong.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected a table of text, got bytes that are none") from None
    lines = [
        (i, line)
        for i, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.startswith("#")
    ]
    if not lines:
        raise InputError(
            f"{path}: expected a line of names and lines of numbers, got an empty file"
        )
    mark = next((mark for mark in ",;\t" if mark in lines[0][1]), None)
    split = (lambda line: next(csv.reader([line], delimiter=mark))) if mark else str.split
    rows = [(i, [cell.strip() for cell in split(line)]) for i, line in lines]
    names = rows[0][1]
    if all(_value(name) is not None for name in names):
        raise InputError(
            f"{path}, line {rows[0][0]}: expected names of columns, such as t,x,std_x, got numbers"
        )
    if len(set(names)) != len(names):
        raise InputError(
            f"{path}, line {rows[0][0]}: expected names that differ, got {', '.join(names)}"
        )
    for i, cells in rows[1:]:
        if len(cells) != len(names):
            raise InputError(f"{path}, line {i}: expected {len(names)} columns, got {len(cells)}")
    body = (
        dict(zip(names, zip(*(cells for _, cells in rows[1:]), strict=True), strict=True))
        if rows[1:]
        else {}
    )
    numeric = [
        name
        for name, cells in body.items()
        if any(_value(cell) is not None and cell.lower() not in EMPTY for cell in cells)
    ]
    for name in (*([time] if time else []), *(columns or ())):
        if name not in names:
            raise InputError(f"{path}: expected a column {name!r}, got {', '.join(names)}")

    def column(name: str) -> Array:
        values = [_value(cell) for cell in body[name]]
        for (i, _), value, cell in zip(rows[1:], values, body[name], strict=True):
            if value is None or np.isinf(value):
                raise InputError(
                    f"{path}, line {i}: expected a finite number or nothing as {name}, got {cell!r:.40}"
                )
        return np.array(values, np.float64)

    when = time or next((name for name in numeric if name.lower().partition("_")[0] in TIMES), None)
    if when is None:
        raise InputError(
            f"{path}: expected a column of times, such as t, got {', '.join(names)}; --time names it"
        )
    claims = {name: claim + name for name in numeric for claim in CLAIMS if claim + name in numeric}
    others = [name for name in numeric if name not in (when, "run") and not name.startswith(CLAIMS)]
    chosen = list(columns or claims or others)
    if not chosen:
        raise InputError(f"{path}: expected components beside {when}, got {', '.join(names)}")
    t, run_of = column(when), column("run") if "run" in names else np.zeros(len(rows) - 1)
    if np.isnan(t).any() or np.isnan(run_of).any():
        bad = int(np.flatnonzero(np.isnan(t) | np.isnan(run_of))[0])
        raise InputError(f"{path}, line {rows[1 + bad][0]}: expected a time, got nothing")
    times, at = np.unique(t, return_inverse=True)
    runs, of = np.unique(run_of, return_inverse=True)
    for r in range(len(runs)):
        mine = np.flatnonzero(of == r)
        back = np.flatnonzero(np.diff(t[mine]) <= 0.0)
        if len(back):
            line, before = rows[1 + mine[back[0] + 1]][0], t[mine[back[0]]]
            raise InputError(
                f"{path}, line {line}: expected a time after {before:g}, got {t[mine[back[0] + 1]]:g}"
            )

    def whole_of(chosen: Sequence[str]) -> Array:
        out = np.full((len(times), len(runs), len(chosen)), np.nan)
        out[at, of] = np.stack([column(name) for name in chosen], -1)
        return out

    std = (
        whole_of([claims[name] for name in chosen])
        if all(name in claims for name in chosen)
        else None
    )
    used = {when, "run", *chosen, *(claims[name] for name in chosen if std is not None)}
    return Table(times, whole_of(chosen), std, chosen, [name for name in names if name not in used])


def _value(cell: str) -> float | None:
    """The number of a cell, nan where it is empty, None where it is none."""
    if cell.lower() in EMPTY:
        return np.nan
    try:
        return float(cell)
    except ValueError:
        return None
