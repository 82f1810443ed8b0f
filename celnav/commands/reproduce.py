"""``celnav reproduce``: do the studies of papers, and one's own, write everything that they show."""

from __future__ import annotations

import argparse
import csv
import io
import json
import platform
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from importlib import metadata
from pathlib import Path
from time import process_time
from types import ModuleType
from typing import Any

import numpy as np

import celnav
from celnav import papers, real
from celnav.campaign.engine import UnfinishedError, compute
from celnav.commands.arguments import UsageError, cores, fraction, module, whole, workers
from celnav.files import Outputs, locked, remove_leftovers
from celnav.filters.run import ENGINE
from celnav.gaussian.linalg import Array
from celnav.papers import own
from celnav.show.progress import Progress
from celnav.store import RESULTS, Store, resumed
from celnav.study.ledger import Claim
from celnav.study.study import Results, Unit
from celnav.tape.cuda import device

__all__ = ["run"]

KINDS = ("png", "svg")
"""Of each figure."""
WRITING_S = {"ledger": 1.0, "figures": 5.0, "recordings": 4.0}
"""CPU seconds of what is made of a paper's results, roughly, whatever the effort."""


def run(options: argparse.Namespace) -> int:
    """Do the papers side by side where there are several processes, and write each as soon as it is done."""
    from celnav.commands.index import OWN, described, index

    words = list(dict.fromkeys(options.papers)) or [
        *papers.PAPERS,
        *(s for s in real.STUDIES if getattr(options, s) is not None),
    ]
    modules = {own.name_of(word): module(word) for word in words}
    chosen, files = list(modules), {own.name_of(word): word for word in words if own.is_own(word)}
    if len(chosen) < len(words):
        raise UsageError(
            f"{', '.join(filter(own.is_own, words))}: expected files of different names; rename one"
        )
    part, seed = fraction(options.effort), whole("seed", options.seed, 0)
    pool = workers(options.jobs)
    for name, taken in {
        "rinex": "a paper that takes a receiver's log (aukf)",
        **{s: f"the study {s}" for s in real.STUDIES},
    }.items():
        if getattr(options, name) is not None and not any(
            name in getattr(one, "INPUTS", ()) for one in modules.values()
        ):
            raise UsageError(f"--{name}: expected {taken}, got {', '.join(chosen)}")
        if name in chosen and getattr(options, name) is None:
            raise UsageError(
                f"{name}: expected --{name} DIR with it, a folder of {real.STUDIES[name]}"
            )
    if options.engine == "cuda":
        device()  # told at once, not by each unit
    if part < 1.0:
        print(
            f"celnav: {part:.3g} of the runs: intervals are wide, and what they do not decide is undecided"
        )
    out = Path(options.out)
    top, folders = Outputs(out), {paper: Outputs(out / paper) for paper in chosen}
    top.check(["index.html"])
    for paper, one in modules.items():
        _check(one, folders[paper])
    surprises = undecided = 0
    with locked(out):
        remove_leftovers(
            out, *(out / paper / below for paper in chosen for below in ("", "figures", "tables"))
        )
        stores = {paper: resumed(out / paper / RESULTS) for paper in modules}
        token = ENGINE.set(options.engine)
        units = {
            paper: one.STUDY.units(effort=part, seed=seed, **_inputs(one, options))
            for paper, one in modules.items()
        }
        ENGINE.reset(token)
        left = {
            paper: [unit for unit in all if not _kept(stores[paper], unit)]
            for paper, all in units.items()
        }
        total, missing = (
            sum(unit.cost for some in which.values() for unit in some) for which in (units, left)
        )
        progress = Progress("celnav", total + len(units) * sum(WRITING_S.values()), total - missing)

        def written(paper: str) -> None:
            nonlocal surprises, undecided
            done = units.pop(paper)
            results = modules[paper].STUDY.results(done, map(stores[paper].read, done), effort=part)
            claims = _write(paper, modules[paper], results, folders[paper], progress)
            surprises += sum(claim.surprise for claim in claims)
            undecided += sum(claim.verdict == "undecided" != claim.expected for claim in claims)
            if paper in files:
                folders[paper].text(OWN, described(modules[paper], files[paper]))
            stores[paper].forget_all_but(done)

        def keep(unit: Unit, arrays: dict[str, Array]) -> None:
            stores[unit.study].write(unit, arrays)
            left[unit.study].remove(unit)
            progress.add(unit.cost, f"{unit.study}: {unit.part}")
            if not left[unit.study]:
                written(unit.study)

        with closing(progress):
            for paper in [paper for paper, some in left.items() if not some]:
                written(paper)
            # The longest first: the end is then made of short ones, and all processes are busy until it.
            try:
                compute(
                    sorted(
                        (unit for some in left.values() for unit in some),
                        key=lambda unit: -unit.cost,
                    ),
                    pool,
                    keep,
                )
            except UnfinishedError as error:
                raise OSError(
                    f"{error}; what is finished is kept: the same command goes on from there"
                ) from None
        top.text("index.html", index(out))
    told = [f"{surprises} not as expected, see above"] if surprises else []
    if part < 1.0 and undecided:
        told.append(f"{undecided} undecided with {part:.3g} of the runs")
    print(f"wrote {out / 'index.html'}: {', '.join(told) or 'all as expected'}")
    return 1 if options.strict and surprises else 0


def _inputs(one: ModuleType, options: argparse.Namespace) -> dict[str, Path]:
    return {
        name: Path(given)
        for name in getattr(one, "INPUTS", ())
        if (given := getattr(options, name)) is not None
    }


def _check(one: ModuleType, outputs: Outputs) -> None:
    """Refuse what could not be written before anything is computed."""
    outputs.check(f"figures/{stem}.{kind}" for stem in one.FIGURES for kind in KINDS)
    outputs.check(f"tables/{stem}.csv" for stem in one.TABLES)
    outputs.check(
        ["claims.json", "checks.json", "timings.json", "result.npz", "study.json", *one.RECORDINGS]
    )


def _kept(store: Store, unit: Unit) -> bool:
    try:
        return store.has(unit)
    except ValueError as error:
        print(f"celnav: {error}; it is computed again", file=sys.stderr)
        return False


def _write(
    paper: str, one: ModuleType, results: Results, outputs: Outputs, progress: Progress
) -> list[Claim]:
    """Write everything that a paper shows. Returns its claims."""
    from celnav.show.claims import dumps
    from celnav.show.drawing import render

    timings: dict[str, float] = {
        f"cpu_s {part}": float(arrays["cpu_s"].sum()) for part, arrays in results.data.items()
    }

    def stage(name: str, work: Callable[[], Any]) -> Any:
        progress.add(0.0, f"{paper}: {name}")
        start = process_time()
        value = work()
        timings[f"cpu_s {name}"] = process_time() - start
        progress.add(WRITING_S[name])
        return value

    claims = stage("ledger", results.claims)
    outputs.text("claims.json", dumps(claim for claim in claims if claim.kind != "check"))
    outputs.text("checks.json", dumps(claim for claim in claims if claim.kind == "check"))
    outputs.npz("result.npz", _arrays(results.data))
    for stem, (_, function) in one.TABLES.items():
        if rows := function(results):  # none without what a person may give
            outputs.text(f"tables/{stem}.csv", _csv(rows))

    def draw() -> None:
        for stem, (_, function) in one.FIGURES.items():
            if (drawing := function(results)) is not None:
                for kind in KINDS:
                    outputs.bytes(f"figures/{stem}.{kind}", render(drawing, kind))

    stage("figures", draw)
    try:
        stage("recordings", lambda: one.record(results, outputs))
    except (ImportError, OSError, RuntimeError) as error:
        print(
            f"celnav: {paper}: no recordings ({error}); everything else is written", file=sys.stderr
        )
    versions = {name: metadata.version(name) for name in ("numpy", "scipy", "matplotlib")}
    machine = f"{platform.system()} {platform.machine()}, {cores()} cores"
    about = {
        "celnav": celnav.__version__,
        "python": platform.python_version(),
        **versions,
        "machine": machine,
    }
    record = {
        "about": about,
        "effort": results.effort,
        "cpu_s": sum(timings.values()),
        "timings": timings,
    }
    outputs.text("timings.json", json.dumps(record, indent=1) + "\n")
    for kind in ("statement", "finding", "check"):
        if count := Counter(claim.verdict for claim in claims if claim.kind == kind):
            progress.say(
                f"{paper}: {kind}s: {', '.join(f'{number} {verdict}' for verdict, number in sorted(count.items()))}"
            )
    for claim in claims:
        if claim.surprise:
            progress.say(
                f"{paper}: not as expected: {claim.id}: {claim.verdict}, expected {claim.expected}: {claim.row.says}"
            )
    return list(claims)


def _arrays(data: Mapping[str, Mapping[str, Array]]) -> dict[str, Array]:
    """What is stored: times, and over the runs the root mean squares of errors and the means of NEES and NIS."""
    out = {}
    for part, arrays in data.items():
        for name, values in arrays.items():
            what = name.rpartition("/")[2]
            if what in ("error", "nees", "nis") and values.ndim < 2:  # without runs
                out[f"{part}/{name}"] = values
            elif what == "error":
                out[f"{part}/{name} rms"] = np.sqrt(np.square(values).mean(1))
            elif what in ("nees", "nis"):
                out[f"{part}/{name}"] = values.mean(1)
            elif what == "times":
                out[f"{part}/times"] = values
    return out


def _csv(rows: Sequence[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in line.items()} for line in rows
    )
    return text.getvalue()
