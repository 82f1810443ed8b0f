"""``celnav reproduce``: run papers, write everything that they show."""

from __future__ import annotations

import argparse
import csv
import io
import json
import platform
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor
from contextlib import closing
from functools import partial
from importlib import metadata
from pathlib import Path
from time import process_time
from types import ModuleType
from typing import Any, NamedTuple

import celnav
from celnav import papers
from celnav.campaign.engine import results
from celnav.campaign.executors import Workers
from celnav.commands.arguments import UsageError, cores, fraction, module, whole, workers
from celnav.files import Outputs, locked, remove_leftovers
from celnav.papers import figures, tables
from celnav.show.progress import Progress
from celnav.study.montecarlo import Outcome, Plan, Unit, do, joined

KINDS = ("png", "svg")
"""Of each figure."""
FIRST = ("tstdkf", "aukf", "aasghqf")
"""Papers with the longest units: the end is then made of short ones, and all processes are busy until it."""


def run(options: argparse.Namespace) -> int:
    """Run the papers, side by side where there are several processes."""
    from celnav.papers.page import few, index

    chosen = list(dict.fromkeys(options.papers)) or list(papers.PAPERS)
    modules = {paper: module(paper) for paper in chosen}
    part, seed = fraction(options.effort), whole("seed", options.seed, 0)
    pool = workers(options.jobs)
    if options.rinex is not None and not any("rinex" in getattr(study, "INPUTS", ()) for study in modules.values()):
        raise UsageError(f"--rinex: expected a paper that takes a receiver's log (aukf), got {', '.join(chosen)}")
    out = Path(options.out)
    top, folders = Outputs(out), {paper: Outputs(out / paper) for paper in chosen}
    top.check(["index.html"])
    for paper, study in modules.items():
        _check(study, folders[paper])
    surprises = 0
    with locked(out):
        remove_leftovers(out, *(out / paper / below for paper in chosen for below in ("", "figures", "tables")))
        plans = {paper: study.plan(effort=part, seed=seed, **_inputs(study, options)) for paper, study in modules.items()}
        with closing(Progress("celnav")) as progress:
            for paper, outcomes in _found(plans, pool, progress):
                plan = plans[paper]
                result = partial(plan.result, joined(plan.units, outcomes))
                spent = sum(outcome.cpu_s for outcome in outcomes)
                surprises += _write(paper, modules[paper], result, folders[paper], part, spent, progress)
                del outcomes, result
        top.text("index.html", index(out))
    print(f"wrote {out / 'index.html'}")
    if part < 1.0:
        print(f"celnav: {few(part)}", file=sys.stderr)
    return 1 if options.strict and surprises else 0


def _inputs(study: ModuleType, options: argparse.Namespace) -> dict[str, Path]:
    return {name: Path(given) for name in getattr(study, "INPUTS", ()) if (given := getattr(options, name)) is not None}


def _check(study: ModuleType, outputs: Outputs) -> None:
    """Refuse what could not be written before anything is computed."""
    outputs.check(f"figures/{stem}.{kind}" for stem in figures(study) for kind in KINDS)
    outputs.check(f"tables/{stem}.csv" for stem in tables(study))
    outputs.check(["claims.json", "timings.json", "result.npz", *study.RECORDINGS])


def _found(plans: Mapping[str, Plan[Any]], workers: Workers, progress: Progress) -> Iterator[tuple[str, list[Outcome]]]:
    """Papers with the outcomes of all of their units, as soon as they are done."""
    order = sorted(plans, key=lambda paper: FIRST.index(paper) if paper in FIRST else len(FIRST))
    todo = [_Task(paper, i, unit) for paper in order for i, unit in enumerate(plans[paper].units)]
    found: dict[str, dict[int, Outcome]] = {paper: {} for paper in plans}
    count = 0
    try:
        with workers.open() as executor:
            for task, outcome in results(executor, _do, todo, workers.ahead):
                if isinstance(outcome, Exception):
                    raise outcome
                found[task.paper][task.number] = outcome
                del outcome  # a gigabyte is not to be held here while the next paper is computed
                count += 1
                progress(count, len(todo), f"{task.paper}: {task.unit.label}")
                if len(found[task.paper]) == len(plans[task.paper].units):
                    yield task.paper, [own for _, own in sorted(found.pop(task.paper).items())]
    except BrokenExecutor:
        raise OSError("a worker process was killed, perhaps for want of memory; fewer --jobs need less") from None


class _Task(NamedTuple):
    paper: str
    number: int
    unit: Unit


def _do(task: _Task) -> Outcome:
    return do(task.unit)


def _write(
    paper: str, study: ModuleType, result: Callable[[], Any], outputs: Outputs, effort: float, spent: float, progress: Progress
) -> int:
    """Write everything that a paper shows; ``spent``: CPU seconds so far. Returns how many claims are not as expected."""
    from celnav.show.drawing import render
    from celnav.study.claims import dumps

    timings = {"cpu_s units": spent}

    def stage(name: str, work: Callable[[], Any]) -> Any:
        progress.stage(f"{paper}: {name}")
        start = process_time()
        value = work()
        timings[f"cpu_s {name}"] = process_time() - start
        return value

    found = stage("analysis", result)
    claims = stage("claims", lambda: study.claims(found))
    outputs.text("claims.json", dumps(claims))
    outputs.npz("result.npz", found.arrays())
    for stem, function in tables(study).items():
        outputs.text(f"tables/{stem}.csv", _csv(function(found)))

    def draw() -> None:
        for stem, function in figures(study).items():
            drawing = function(found)
            for kind in KINDS:
                outputs.bytes(f"figures/{stem}.{kind}", render(drawing, kind))

    stage("figures", draw)
    try:
        stage("recordings", lambda: study.record(found, outputs))
    except (ImportError, OSError, RuntimeError) as error:
        print(f"celnav: {paper}: no recordings ({error}); everything else is written", file=sys.stderr)
    versions = {name: metadata.version(name) for name in ("numpy", "scipy", "filterpy", "matplotlib")}
    machine = f"{platform.system()} {platform.machine()}, {cores()} cores"
    about = {"celnav": celnav.__version__, "python": platform.python_version(), **versions, "machine": machine}
    record = {"about": about, "effort": effort, "cpu_s": sum(timings.values()), "timings": timings | found.timings}
    outputs.text("timings.json", json.dumps(record, indent=1) + "\n")
    for verdict, number in sorted(Counter(claim.verdict for claim in claims).items()):
        print(f"{paper}: {number:4} {verdict}")
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
