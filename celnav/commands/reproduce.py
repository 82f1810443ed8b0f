"""``celnav reproduce``: run papers, write everything that they show."""

from __future__ import annotations

import argparse
import csv
import io
import json
import platform
import sys
from collections import Counter
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from time import process_time
from types import ModuleType
from typing import Any

from celnav import papers
from celnav.commands.arguments import UsageError, fraction, module, whole
from celnav.files import Outputs
from celnav.papers import figures, tables
from celnav.progress import Progress


def run(options: argparse.Namespace) -> int:
    """Run the papers, one after the other."""
    chosen = list(dict.fromkeys(options.papers)) or list(papers.PAPERS)
    modules = {paper: module(paper) for paper in chosen}
    part = fraction(options.effort)
    seed, jobs = whole("seed", options.seed, 0), whole("jobs", options.jobs, 1)
    if options.rinex is not None and not any("rinex" in getattr(study, "INPUTS", ()) for study in modules.values()):
        raise UsageError(f"rinex: expected a paper that takes a receiver's log (aukf), got {', '.join(chosen)}")
    out = Path(options.out)
    if out.exists() and not out.is_dir():
        raise NotADirectoryError(f"{out}: expected a folder to write to")
    top = Outputs(out)
    top.check(["index.html"])
    surprises = 0
    for paper, study in modules.items():
        inputs = {name: Path(given) for name in getattr(study, "INPUTS", ()) if (given := getattr(options, name)) is not None}
        surprises += _one(paper, study, Outputs(out / paper), effort=part, seed=seed, jobs=jobs, **inputs)
    _index(top)
    print(f"wrote {out / 'index.html'}")
    return 1 if options.strict and surprises else 0


def _index(top: Any) -> None:
    from celnav.report import index

    top.text("index.html", index(top.directory))


def _one(paper: str, study: ModuleType, outputs: Any, **chosen: Any) -> int:
    """Reproduce one paper; returns the number of claims that are not as expected."""
    from celnav.claims import dumps
    from celnav.drawing import render

    drawings, listings = figures(study), tables(study)
    outputs.check(f"figures/{stem}.{kind}" for stem in drawings for kind in ("png", "svg"))
    outputs.check(f"tables/{stem}.csv" for stem in listings)
    outputs.check(["claims.json", "timings.json", "result.npz", *study.RECORDINGS])
    timings: dict[str, float] = {}
    report = Progress(paper)

    def stage(name: str, work: Callable[[], Any]) -> Any:
        report.stage(name)
        start = process_time()
        value = work()
        timings[f"cpu_s {name}"] = process_time() - start
        return value

    result = stage("runs", lambda: study.reproduce(**chosen, progress=report))
    claims = stage("claims", lambda: study.claims(result))
    outputs.text("claims.json", dumps(claims))
    outputs.npz("result.npz", result.arrays())
    for stem, function in listings.items():
        outputs.text(f"tables/{stem}.csv", _csv(function(result)))

    def draw() -> None:
        for stem, function in drawings.items():
            drawing = function(result)
            for kind in ("png", "svg"):
                outputs.bytes(f"figures/{stem}.{kind}", render(drawing, kind))

    stage("figures", draw)
    try:
        stage("recordings", lambda: study.record(result, outputs))
    except (ImportError, OSError, RuntimeError) as error:
        print(f"celnav: {paper}: no recordings ({error}); everything else is written", file=sys.stderr)
    report.close()
    versions = {name: metadata.version(name) for name in ("numpy", "scipy", "filterpy", "matplotlib")}
    about = {"python": platform.python_version(), "machine": platform.machine(), **versions}
    outputs.text(
        "timings.json",
        json.dumps({"about": about, "effort": chosen["effort"], "timings": {**timings, **result.timings}}, indent=1) + "\n",
    )
    for verdict, count in sorted(Counter(claim.verdict for claim in claims).items()):
        print(f"{paper}: {count:4} {verdict}")
    failures = [claim for claim in claims if claim.failure]
    for claim in failures:
        print(f"{paper}: not as expected: {claim.id} = {claim.value:.4g}, accepted {claim.accept}: {claim.statement}")
    return len(failures)


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in line.items()} for line in rows)
    return text.getvalue()
