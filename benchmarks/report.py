"""Tables of the measurements, as JSON and as Markdown."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import compiled
from benchmarks.measure import Row

AGREE_KM, AGREE_KM_S = 1e-6, 1e-9
"""Engines that are further apart than this did not compute the same thing (dynamax adds 1e-9 to each diagonal by itself)."""
PACKAGES = (
    "celnav",
    "numpy",
    "scipy",
    "llvmlite",
    "filterpy",
    "numba",
    "stonesoup",
    "dynamax",
    "jax",
)


def report(rows: Sequence[Row], absent: dict[str, str], steps: int, rounds: int) -> dict[str, Any]:
    """Everything that is written: settings, machine, measurements, ratios, and whether the estimates agree."""
    differences = [row.difference for row in rows if row.difference is not None]
    return {
        "settings": {
            "steps": steps,
            "rounds": rounds,
            "unit": "us of CPU time per run-step, one thread",
        },
        "machine": _machine(),
        "rows": [
            {
                **row._asdict(),
                "median_us": float(np.median(row.us)),
                "min_us": min(row.us),
                "inside_us": float(np.median(row.inside)),
                "over_floor": _over_floor(row, rows),
                "over_numpy": _over_numpy(row, rows),
            }
            for row in rows
        ],
        "ratios": _ratios(rows),
        "absent": absent,
        "max_difference": [max(d[i] for d in differences) for i in (0, 1)] if differences else None,
        "agree": all(d[0] <= AGREE_KM and d[1] <= AGREE_KM_S for d in differences),
    }


def _machine() -> dict[str, Any]:
    found = {}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        cpu = next(
            (
                line.split(":", 1)[1].strip()
                for line in info.read_text().splitlines()
                if line.startswith("model name")
            ),
            cpu,
        )
    load = list(os.getloadavg()) if hasattr(os, "getloadavg") else None  # over 1, 5 and 15 minutes
    return {
        "cpu": cpu,
        "python": platform.python_version(),
        "system": platform.system(),
        "load": load,
        "packages": found,
    }


def _ratio(slow: Row, fast: Row) -> float:
    """Median over rounds of the ratio within a round: what disturbs a round disturbs both."""
    return float(np.median(np.array(slow.us) / np.array(fast.us)))


def _over_floor(row: Row, rows: Sequence[Row]) -> float | None:
    floor = next((r for r in rows if r.engine == "model floor" and r.runs == row.runs), None)
    return None if floor is None or not row.engine.startswith("celnav") else _ratio(row, floor)


def _over_numpy(row: Row, rows: Sequence[Row]) -> float | None:
    """How many times faster the compiled engine is than the same filter in numpy."""
    numpy = row.engine.replace("compiled", "H matrix")
    other = next((r for r in rows if r.engine == numpy and r.runs == row.runs), row)
    return None if other is row else _ratio(other, row)


def _ratios(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """How many times faster than each peer one run-step of celnav is; "100 runs": their whole cost in runs of the peer."""
    peers = [row for row in rows if not row.engine.startswith(("celnav", "model"))]
    out = []
    for row in rows:
        if not row.engine.startswith("celnav"):
            continue
        for peer in peers:
            if peer.runs not in (1, row.runs):
                continue
            faster = _ratio(peer, row)
            out.append({
                "engine": row.engine, "runs": row.runs, "peer": peer.engine, "peer_runs": peer.runs,
                "faster": faster, "batch_in_peer_runs": row.runs / faster,
            })  # fmt: skip
    return out


def markdown(result: dict[str, Any]) -> str:
    """The tables of a report."""
    machine, settings = result["machine"], result["settings"]
    packages = ", ".join(f"{name} {number}" for name, number in machine["packages"].items())
    lines = [
        "# Speed",
        "",
        f"{machine['cpu']}; Python {machine['python']}; {packages}.",
        f"Load of the machine over 1, 5 and 15 minutes: {', '.join(f'{x:.1f}' for x in machine['load'] or [])}.",
        f"CPU time per run-step on one thread, medians of {settings['rounds']} interleaved rounds.",
        "",
        "| engine | runs | steps | us per run-step | least | in the loop | numpy / compiled | over model floor | compile, s "
        "| difference, km | km/s |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in result["rows"]:
        over, floor, start = (
            "" if x is None else f"{x:.2f}"
            for x in (row["over_numpy"], row["over_floor"], row["start_s"])
        )
        inside = f"{row['inside_us']:.2f}" if row["inside_us"] else ""
        apart = ["", ""] if row["difference"] is None else [f"{d:.1e}" for d in row["difference"]]
        cells = [
            row["engine"],
            row["runs"],
            row["steps"],
            f"{row['median_us']:.2f}",
            f"{row['min_us']:.2f}",
        ]
        lines.append(_line([*cells, inside, over, floor, start, *apart]))
    for name, reason in result["absent"].items():
        lines.append(_line([name, *[""] * 3, f"absent: {reason}", *[""] * 6]))
    peers = list(dict.fromkeys((r["peer"], r["peer_runs"]) for r in result["ratios"]))
    if peers:
        lines += [
            "",
            "How many times faster a run-step of celnav is (ratios within rounds, their median):",
            "",
        ]
        lines.append(
            _line(
                [
                    "engine",
                    "runs",
                    *(f"{peer}, {runs} run{'s' * (runs > 1)}" for peer, runs in peers),
                ]
            )
        )
        lines.append("|---|--:" + "|--:" * len(peers) + "|")
        table = {(r["engine"], r["runs"], r["peer"], r["peer_runs"]): r for r in result["ratios"]}
        for engine, runs in dict.fromkeys((r["engine"], r["runs"]) for r in result["ratios"]):
            found = [table.get((engine, runs, *peer)) for peer in peers]
            lines.append(
                _line([engine, runs, *("" if r is None else f"{r['faster']:.2f}" for r in found)])
            )
        lines.append("")
        for r in result["ratios"]:
            if (
                r["runs"] == 100
                and r["peer_runs"] == 1
                and r["engine"] == "celnav square root, H matrix"
            ):
                lines.append(
                    f"- 100 runs of {r['engine']} cost as much as {r['batch_in_peer_runs']:.2f} runs of {r['peer']}."
                )
    if "compiled" in result:
        lines += compiled.lines(result["compiled"])
    if result["max_difference"] is not None:
        verdict = "the estimates agree" if result["agree"] else "THE ESTIMATES DISAGREE"
        position, velocity = result["max_difference"]
        lines += [
            "",
            f"Largest difference to celnav's square-root estimate: {position:.1e} km, {velocity:.1e} km/s; {verdict}.",
        ]
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[Any]) -> str:
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def write(result: dict[str, Any], folder: Path) -> None:
    """``speed.json`` and ``speed.md`` in a folder, made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "speed.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    (folder / "speed.md").write_text(markdown(result), encoding="utf-8")
