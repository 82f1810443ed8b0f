"""Tables and sentences of what was measured, and the pages that quote them.

A page quotes between two comments, ``<!-- speed: NAME -->`` and ``<!-- end of speed -->``. NAME is
that of a cell, "summary", "sentences", "machine" or "details".
"""

from __future__ import annotations

import json
import os
import platform
import re
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.cells import cells
from benchmarks.measure import BESIDE, HERE, ROOT

MEASURED = ROOT / "benchmarks" / "speed.json"
"""What the pages quote."""
PAGES = tuple(
    ROOT / path for path in ("README.md", "docs/speed.md", "benchmarks/README.md", "paper/paper.md")
)
QUOTED = re.compile(r"(<!-- speed: (\w+) -->\n).*?(<!-- end of speed -->)", re.DOTALL)
PACKAGES = ("numpy", "llvmlite", "filterpy", "numba", "stonesoup", "dynamax", "jax", "cuthbert")
Result = dict[str, Any]


def machine() -> dict[str, Any]:
    """Processor, Python and packages."""
    packages = {}
    for name in PACKAGES:
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            packages[name] = "absent"
    cpu, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.exists():
        names = re.findall(r"^model name\s*: (.*)$", info.read_text(), re.MULTILINE)
        cpu = names[0] if names else cpu
    about = {"cpu": cpu, "cores": os.cpu_count(), "python": platform.python_version()}
    return about | {"packages": packages}


# -- numbers ---------------------------------------------------------------------------------------
def row_of(result: Result, cell: str, problem: str, method: str, checkout: str = HERE) -> Any:
    """A row; None if it was not measured."""
    rows = result["cells"].get(cell, {"rows": []})["rows"]
    wanted = (problem, method, checkout)
    same = [row for row in rows if (row["problem"], row["method"], row["checkout"]) == wanted]
    return same[0] if same and same[0]["values"] else None


def needed(result: Result, cell: str, problem: str, method: str) -> Any:
    """A row that a sentence needs."""
    row = row_of(result, cell, problem, method)
    if row is None:
        raise SystemExit(f"not measured, so nothing is quoted: {cell}, {problem}, {method}")
    return row


def value_of(result: Result, cell: str, problem: str, method: str) -> float:
    """The median of the rounds."""
    return float(median(needed(result, cell, problem, method)["values"]))


def ratio(slow: Any, fast: Any) -> float:
    """The median of ratios within rounds."""
    pairs = zip(slow["values"], fast["values"], strict=False)
    return float(median(a / b for a, b in pairs))


def ratio_of(result: Result, cell: str, problem: str, slow: str, fast: str) -> float:
    """Of two methods on a problem."""
    return ratio(*(needed(result, cell, problem, method) for method in (slow, fast)))


def shown(value: float) -> str:
    """Two digits, three from 100 on."""
    if value >= 99.5:
        return f"{float(f'{value:.3g}'):.0f}"
    return f"{value:.1f}" if value >= 9.95 else f"{value:#.2g}"


# -- tables ----------------------------------------------------------------------------------------
def line(cells: list[str]) -> str:
    """A line of a table."""
    return "| " + " | ".join(cells) + " |"


def grid(head: list[str], body: list[list[str]]) -> str:
    """A table whose numbers are on the right."""
    return "\n".join([line(head), "|---|" + "--:|" * (len(head) - 1), *map(line, body)])


def table(result: Result, cell: str) -> str:
    """Problems by methods; of "fixed" methods by epochs, with what does not depend on them."""
    rows = result["cells"][cell]["rows"]
    if cell == "fixed":
        return fixed_table(result)
    problems = list(dict.fromkeys(row["problem"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    head, body = [result["cells"][cell]["unit"]], []
    if len(problems) == 1:  # methods may be many
        for method in methods:
            body.append([method, cell_of(result, cell, problems[0], method)])
        return grid([head[0], problems[0]], body)
    if cell == "filtering":  # methods are more than sizes
        for method in methods:
            body.append([method, *(cell_of(result, cell, what, method) for what in problems)])
        return grid([*head, *problems], body)
    for what in problems:
        body.append([what, *(cell_of(result, cell, what, method) for method in methods)])
    return grid([*head, *methods], body)


def summary(result: Result) -> str:
    """Five methods, with one run and with many."""
    sizes = "1 run, 300 epochs", "4,096 runs, 48 epochs"
    methods = {
        "celnav, machine code": "celnav compiled, square root",
        "celnav, numpy": "celnav numpy, square root",
        "dynamax": "dynamax",
        "filterpy": "filterpy",
        "Stone Soup": "Stone Soup",
    }
    body = [
        [name, *(cell_of(result, "filtering", size, method) for size in sizes)]
        for name, method in methods.items()
    ]
    return grid(["CPU time, µs per step of a run", "1 run", "4,096 runs"], body)


def cell_of(result: Result, cell: str, problem: str, method: str) -> str:
    """A number, or nothing."""
    row = row_of(result, cell, problem, method)
    return "" if row is None else shown(median(row["values"]))


def fixed_table(result: Result) -> str:
    """Times of one run are ``a + b T``: lines through medians, relative errors being least."""
    rows = result["cells"]["fixed"]["rows"]
    places = list(dict.fromkeys(tuple(row["problem"].split(", ")) for row in rows))
    states, spans = (list(dict.fromkeys(place[i] for place in places)) for i in (0, 1))
    body = []
    for n in states:
        for method in dict.fromkeys(row["method"] for row in rows):
            measured = [row_of(result, "fixed", f"{n}, {span}", method) for span in spans]
            if None in measured:
                continue
            us = np.array([median(row["values"]) for row in measured])
            T = np.array([float(span.split()[0]) for span in spans])
            a, b = np.linalg.lstsq(np.stack([1.0 / us, T / us], -1), np.ones(len(T)))[0]
            body.append([f"{n}, {method}", *map(shown, us), shown(a), shown(b)])
    return grid(["µs per run", *spans, "fixed", "per epoch"], body)


def beside_table(result: Result) -> str:
    """Each cell of this checkout and of another one."""
    body = []
    for cell, found in result["cells"].items():
        for row in found["rows"]:
            if row["checkout"] != HERE:
                continue
            names = cell, row["problem"], row["method"]
            own, other = (row_of(result, *names, which) for which in (HERE, BESIDE))
            times = [shown(median(each["values"])) if each else "" for each in (own, other)]
            gain = f"{ratio(other, own):.2f}" if own and other else ""
            body.append([", ".join(names), found["unit"], *times, gain])
    return grid(["cell", "unit", "here", "beside", "beside / here"], body)


def details(result: Result) -> str:
    """Every cell with its table, load and largest differences."""
    texts = []
    for name, cell in result["cells"].items():
        load = f", load {cell['load'][0]:.1f}" if cell["load"] else ""
        texts.append(f"### {cell['title']}: `{name}`\n\n{table(result, name)}\n")
        rounds = max(len(row["values"]) for row in cell["rows"])
        about = f"{cell['date']}{load}, " + (
            "1 round" if rounds == 1 else f"medians of {rounds} rounds"
        )
        checked = [row for row in cell["rows"] if row["apart"] is not None]
        if checked:
            worst = max(checked, key=lambda row: row["apart"])
            about += f"; estimates differ by {worst['apart']:.1g} at most ({worst['method']})"
        lost = [row for row in cell["rows"] if row["absent"]]
        about += "".join(f"; {row['method']}, {row['problem']}: {row['absent']}" for row in lost)
        texts.append(f"{about}.\n")
    return "\n".join(texts).rstrip()


def machine_line(result: Result) -> str:
    """What it was measured on."""
    about = result["machine"]
    packages = ", ".join(f"{name} {number}" for name, number in about["packages"].items())
    return f"{about['cpu']}, {about['cores']} cores; Python {about['python']}, {packages}."


SENTENCES = """\
`python -m benchmarks` measured this on {date} on one core ({cpu}, load {load}); numbers are
medians of {rounds} interleaved rounds. With 4,096 runs numpy takes {gain_root} times as long as a
compiled filter in square-root form and {gain_cov} times in covariance form. dynamax takes
{jax_many} times the compiled filter's time with 4,096 runs, and {jax_one} times with one run of
300 epochs. One step at a time, a compiled filter takes {stream} µs and numpy {stream_numpy} µs. A
smoother of 100 runs, with its filter, takes {smooth} µs per step of a run, and dynamax
{jax_smooth} times as long. A linear system of 30 states and 512 runs takes dynamax {jax_linear}
times as long as compiled celnav. With 8, 16 and 32 states a compiled filter is {size_8},
{size_16} and {size_32} times as fast as numpy, and a new process has its first result after
{first_8}, {first_16} and {first_32} s. A campaign takes {campaign} µs per step of a run:
simulated, filtered and judged. At the rate of 2,000 runs, 100,000 runs of 600 epochs are filtered
in {total} s.
"""


def sentences(result: Result) -> str:
    """The README's, with their numbers."""
    find, over = partial(value_of, result), partial(ratio_of, result)
    one, many, hundred = "1 run, 300 epochs", "4,096 runs, 48 epochs", "100 runs, 200 epochs"
    root, cov = (f"celnav compiled, {form}" for form in ("square root", "covariance"))
    unit = "100 runs, 600 epochs, csrukf+z0"
    numbers = {
        "gain_root": over("filtering", many, "celnav numpy, square root", root),
        "gain_cov": over("filtering", many, "celnav numpy, covariance", cov),
        "jax_many": over("filtering", many, "dynamax", root),
        "jax_one": over("filtering", one, "dynamax", root),
        "stream": find("streaming", one, "compiled: step"),
        "stream_numpy": find("streaming", one, "numpy: step"),
        "smooth": find("smoothing", hundred, "celnav compiled"),
        "jax_smooth": over("smoothing", hundred, "dynamax", "celnav compiled"),
        "jax_linear": over("shared", "n = 30, m = 15", "dynamax", "celnav compiled"),
        "campaign": find("campaign", unit, "celnav compiled"),
        "total": 60.0 * find("storing", "2,000 runs, 600 epochs", "nothing"),  # 6e7 steps
    }
    for n in (8, 16, 32):
        ways = f"n = {n}, m = {n // 2}", "celnav numpy", "celnav compiled"
        numbers[f"size_{n}"] = over("size", *ways)
        what = f"Lorenz-96, n = {n}, 128 runs, 40 epochs"
        numbers[f"first_{n}"] = find("first", what, "celnav compiled")
    cell = result["cells"]["filtering"]
    about = {"cpu": result["machine"]["cpu"], "date": cell["date"], "rounds": cell["rounds"]}
    load = shown(cell["load"][0]) if cell["load"] else "unknown"
    texts = {name: shown(number) for name, number in numbers.items()}
    return SENTENCES.format(load=load, **about, **texts).rstrip()


# -- quotations ------------------------------------------------------------------------------------
def quoted(text: str, result: Result) -> str:
    """The text, with what it quotes made anew."""

    def anew(found: re.Match[str]) -> str:
        name = found[2]
        makers = {
            "summary": summary,
            "sentences": sentences,
            "machine": machine_line,
            "details": details,
        }
        made = makers[name](result) if name in makers else table(result, name)
        return f"{found[1]}{made}\n{found[3]}"

    return QUOTED.sub(anew, text)


def write(result: Result, folder: Path) -> None:
    """``speed.json`` and ``speed.md`` in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(result, indent=1, ensure_ascii=False) + "\n"
    (folder / "speed.json").write_text(text, encoding="utf-8")
    (folder / "speed.md").write_text(markdown(result), encoding="utf-8")


def markdown(result: Result) -> str:
    """The whole report."""
    beside = any(row["checkout"] == BESIDE for c in result["cells"].values() for row in c["rows"])
    body = beside_table(result) if beside else details(result)
    return f"# Speed\n\n{machine_line(result)}\n\n{body}\n"


def quote(result: Result) -> None:
    """Put cells among those that pages quote, and write the pages anew."""
    known = json.loads(MEASURED.read_text(encoding="utf-8")) if MEASURED.exists() else {}
    measured = known.get("cells", {}) | result["cells"]
    order = [cell.name for cell in cells() if cell.name in measured]
    merged = {"machine": result["machine"], "cells": {name: measured[name] for name in order}}
    # The texts are made before anything is written, because the sentences need all cells.
    texts = {path: quoted(path.read_text(encoding="utf-8"), merged) for path in PAGES}
    numbers = json.dumps(merged, ensure_ascii=False)
    texts[MEASURED] = numbers.replace('{"method"', '\n {"method"') + "\n"
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
