"""Libraries take turns, each in its own process; a disturbance of the machine meets all of them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cells import Cell, Entry

ROOT = Path(__file__).resolve().parents[1]
HERE, BESIDE = "here", "beside"
MOST = {"cold": 3, "peak": 1}
"""Rounds of new processes, which take seconds."""


class Process:
    """A library of a checkout, started when it is first asked."""

    def __init__(self, library: str, checkout: Path):
        self.command = [sys.executable, "-m", "benchmarks.serve", library, str(checkout)]
        self.process: subprocess.Popen[str] | None = None
        self.cpu = self.cold = 0.0  # seconds until now, of it and of its new processes

    def ask(self, **request: Any) -> dict[str, Any]:
        """The answer; an error if the process has ended."""
        if self.process is None:
            self.process = subprocess.Popen(
                self.command,
                cwd=ROOT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            print(json.dumps(request), file=self.process.stdin, flush=True)
            line = self.process.stdout.readline()
        except BrokenPipeError:
            line = ""
        found: dict[str, Any] = json.loads(line) if line else {"error": "its process ended"}
        return found

    def once(self, **request: Any) -> dict[str, Any]:
        """CPU seconds and peak MB of a new process that does one pass."""
        process = subprocess.Popen(
            [*self.command, json.dumps(request)], cwd=ROOT, stderr=subprocess.PIPE, text=True
        )
        assert process.stderr is not None
        said = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            return {"error": (said.strip().splitlines() or ["it failed"])[-1][:200]}
        self.cold += usage.ru_utime + usage.ru_stime
        peak = usage.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
        return {"seconds": usage.ru_utime + usage.ru_stime, "peak": peak}

    def end(self) -> None:
        """Let it go."""
        if self.process is not None and self.process.stdin is not None:
            self.process.stdin.close()
            self.process.wait()


class Processes:
    """All that are asked, by checkout and library."""

    def __init__(self, beside: Path | None):
        self.checkouts = {HERE: ROOT, **({BESIDE: beside.resolve()} if beside else {})}
        self.known: dict[tuple[str, str], Process] = {}

    def of(self, entry: Entry, checkout: str) -> Process:
        """The one that does an entry."""
        key = checkout, entry.work.partition(".")[0]
        if key not in self.known:
            self.known[key] = Process(key[1], self.checkouts[checkout])
        return self.known[key]

    def forget(self) -> float:
        """What they have prepared. CPU seconds of all of them until now."""
        for process in self.known.values():
            if process.process is not None:
                process.cpu = process.ask(do="forget").get("cpu", process.cpu)
        return sum(process.cpu + process.cold for process in self.known.values())

    def turns(self, entries: list[Entry]) -> list[tuple[Entry, str]]:
        """Each entry with each checkout; beside another one only what is celnav's."""
        return [
            (entry, checkout)
            for entry in entries
            if len(self.checkouts) == 1 or entry.work.startswith("celnav")
            for checkout in self.checkouts
        ]


@contextmanager
def processes(beside: Path | None) -> Iterator[Processes]:
    """Which end with the block."""
    made = Processes(beside)
    try:
        yield made
    finally:
        for process in made.known.values():
            process.end()


def measure(
    cell: Cell, rounds: int, found: Processes, say: Callable[[str], None]
) -> dict[str, Any]:
    """A cell: of each problem and method the times of the rounds, or why there are none."""
    begin, rows = found.forget(), []
    for problem in dict.fromkeys(entry.problem for entry in cell.entries):
        entries = [entry for entry in cell.entries if entry.problem == problem]
        say(f"{cell.name}: {problem}")
        rows += [row | {"problem": problem} for row in measure_problem(entries, rounds, found)]
    for row in rows:
        scale = 1.0 if row["clock"] == "peak" else cell.scale
        row["values"] = [float(f"{scale * value:.4g}") for value in row["values"]]
    say(f"{cell.name}: {found.forget() - begin:.0f} s of CPU time")
    load = list(os.getloadavg()) if hasattr(os, "getloadavg") else []
    about = {"title": cell.title, "unit": cell.unit, "date": date.today().isoformat()}
    return {"cell": cell.name, **about, "load": load, "rounds": rounds, "rows": rows}


def measure_problem(entries: list[Entry], rounds: int, found: Processes) -> list[dict[str, Any]]:
    """Rows of one problem."""
    rows, turns = [], found.turns(entries)
    estimates: dict[int, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for i, (entry, checkout) in enumerate(turns):
            row: dict[str, Any] = {"method": entry.method, "checkout": checkout}
            rows.append(row | {"clock": entry.clock, "values": [], "apart": None, "absent": ""})
            if entry.clock not in MOST:
                file = Path(folder, f"{i}.npy")
                named = {"work": entry.work, "arguments": entry.arguments, "file": str(file)}
                answer = found.of(entry, checkout).ask(do="prepare", key=str(i), **named)
                rows[i]["absent"] = answer.get("error", "")
                if file.exists():
                    estimates[i] = np.load(file)
    for i, (entry, _) in enumerate(turns):
        if entry.apart is not None and i in estimates and i != min(estimates):
            rows[i]["apart"] = apart(estimates[i], estimates[min(estimates)])
            rows[i]["agrees"] = rows[i]["apart"] <= entry.apart
    for k in range(rounds):
        for i in range(len(turns))[:: 1 if k % 2 else -1]:
            entry, checkout = turns[i]
            if rows[i]["absent"] or k >= MOST.get(entry.clock, rounds):
                continue
            process = found.of(entry, checkout)
            if entry.clock in MOST:
                answer = process.once(work=entry.work, arguments=entry.arguments)
            else:
                answer = process.ask(do="pass", key=str(i), clock=entry.clock)
            if "error" in answer:
                rows[i]["absent"] = answer["error"]
            else:
                value = answer["peak"] if entry.clock == "peak" else answer["seconds"]
                rows[i]["values"].append(value / entry.units)
    found.forget()
    return rows


def apart(estimates: Any, reference: Any) -> float:
    """Largest difference over the largest number of a component; of one run, from the first run."""
    if estimates.ndim < reference.ndim:
        reference = reference[:, 0]
    scale = np.abs(reference).reshape(-1, reference.shape[-1]).max(0)
    return float(f"{(np.abs(estimates - reference) / scale).max():.2g}")
