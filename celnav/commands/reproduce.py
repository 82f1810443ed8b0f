"""``celnav reproduce``: compute studies and write their outputs."""

from __future__ import annotations

import argparse
import csv
import io
import json
import platform
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from time import monotonic, process_time
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from celnav import papers
from celnav.campaign.engine import UnfinishedError, compute
from celnav.commands import crate
from celnav.commands.arguments import UsageError, cores, fraction, load, warn, whole, workers
from celnav.commands.index import USER, index, page_data
from celnav.commands.terminal import paragraph
from celnav.files import InputError, Outputs, locked, npz, remove_leftovers
from celnav.gaussian.linalg import Array
from celnav.papers.own import name_of
from celnav.real import found
from celnav.show import viewer
from celnav.show.claims import dumps
from celnav.show.draw import picture_names, pictures
from celnav.show.progress import Progress
from celnav.show.reading import read
from celnav.study.ledger import Claim
from celnav.study.store import RESULTS, resumed
from celnav.study.study import Results, Unit
from celnav.tape.cuda import device

WRITING_S = {"ledger": 1.0, "figures": 5.0, "recordings": 4.0}
"""Approximate CPU seconds of a paper's outputs, at any effort."""
FILES = ("claims.json", "checks.json", "timings.json", "result.npz", USER)
TOP = ("index.html", viewer.PAGE, viewer.SCRIPT, crate.NAME)
T = TypeVar("T")


class Task(NamedTuple):
    """A study to be reproduced; ``file``: the path of a user's study, else None."""

    name: str
    module: ModuleType
    file: str | None
    outputs: Outputs

    def check(self) -> None:
        """Raise an error before anything is computed if the outputs could not be written."""
        self.outputs.check(self.files)

    @property
    def files(self) -> list[str]:
        """Names of all files that may be written for the study."""
        tables = (f"tables/{stem}.csv" for stem in self.module.TABLES)
        figures = picture_names(f"figures/{stem}" for stem in self.module.FIGURES)
        scripts = map(viewer.script_name, self.module.RECORDINGS)
        return [*FILES, *figures, *tables, *self.module.RECORDINGS, *scripts]


def run(options: argparse.Namespace) -> int:
    """Compute the studies, in parallel if there are several processes, and write each when it is
    complete.

    Returns the exit status.
    """
    start, words = monotonic(), list(dict.fromkeys(options.papers))
    if not words:
        real = (name for name in papers.REAL if getattr(options, name) is not None)
        words = [*papers.PAPERS, *real]
    modules = {name_of(word): load(word) for word in words}
    if len(modules) < len(words):
        files = ", ".join(filter(papers.is_file, words))
        raise UsageError(f"{files}: expected files of different names; rename one")
    effort, seed = fraction(options.effort), whole("seed", options.seed, 0)
    pool = workers(options.jobs)
    _check_inputs(modules, options)
    if options.engine == "cuda":
        device()  # raises an error here, instead of in each unit
    if effort < 1.0:
        paragraph(
            f"celnav: {effort:.3g} of the runs: intervals are wide, "
            "and what they do not decide is undecided"
        )
    out = Path(options.out)
    top = Outputs(out)
    top.check(TOP)
    tasks = {
        name: Task(name, module, word if papers.is_file(word) else None, Outputs(out / name))
        for word, (name, module) in zip(words, modules.items(), strict=True)
    }
    for task in tasks.values():
        task.check()
    with locked(out):
        remove_leftovers(
            out, *(out / name / part for name in tasks for part in ("", "figures", "tables"))
        )
        claims = _do(tasks, options, effort, seed, pool)
        if not options.no_viewer and viewer.available():
            write_viewer(top, tasks)
        top.text("index.html", index(out))
        top.text(crate.NAME, _crate(out, tasks, options, effort, seed))
    surprises = sum(claim.surprise for claim in claims)
    undecided = sum(claim.verdict == "undecided" != claim.expected for claim in claims)
    notes = [f"{surprises} not as expected, see above"] if surprises else []
    if effort < 1.0 and undecided:
        notes.append(f"{undecided} undecided with {effort:.3g} of the runs")
    took = f"wrote {out / 'index.html'} in {monotonic() - start:.0f} s"
    paragraph(f"{took}: {', '.join(notes) or 'every verdict is the expected one'}")
    return 1 if options.strict and surprises else 0


def _check_inputs(modules: Mapping[str, ModuleType], options: argparse.Namespace) -> None:
    """Raise UsageError if no study uses a given folder, or if a required folder is missing.

    FileNotFoundError if a folder lacks the files that a study needs.
    """
    takers = {name: f"the study {name}" for name in papers.REAL}
    takers["rinex"] = "a paper that takes a receiver's log (aukf)"
    taken = {name for module in modules.values() for name in getattr(module, "INPUTS", ())}
    for name, taker in takers.items():
        folder = getattr(options, name)
        if folder is not None and name not in taken:
            raise UsageError(f"--{name}: expected {taker}, got {', '.join(modules)}")
        if folder is not None and not Path(folder).is_dir():
            raise UsageError(f"--{name}: expected a folder that exists, got {folder!r}")
    for name in modules:
        if name in papers.REAL and getattr(options, name) is None:
            folder = papers.REAL[name]
            raise UsageError(f"{name}: expected --{name} DIR with it, a folder of {folder}")
        if name in papers.REAL:
            found(getattr(options, name), getattr(modules[name], "FILES", ()))


def _folders(task: Task, options: argparse.Namespace) -> dict[str, Path]:
    """Given folders of a study's inputs, by name."""
    folders = {name: getattr(options, name) for name in getattr(task.module, "INPUTS", ())}
    return {name: Path(folder) for name, folder in folders.items() if folder is not None}


def _units(task: Task, options: argparse.Namespace, **chosen: Any) -> list[Unit]:
    inputs = _folders(task, options)
    units: list[Unit] = task.module.STUDY.units(engine=options.engine, **chosen, **inputs)
    return units


def _do(
    tasks: Mapping[str, Task], options: argparse.Namespace, effort: float, seed: int, pool: Any
) -> list[Claim]:
    """Compute missing results and write each study; returns the claims of all studies."""
    stores = {name: resumed(task.outputs.directory / RESULTS) for name, task in tasks.items()}
    units = {name: _units(task, options, effort=effort, seed=seed) for name, task in tasks.items()}
    left = {
        name: [unit for unit in all if not stores[name].has(unit, warn)]
        for name, all in units.items()
    }
    total, missing = (
        sum(unit.cost for some in which.values() for unit in some) for which in (units, left)
    )
    writing = len(units) * sum(WRITING_S.values())
    progress = Progress("celnav", total + writing, total - missing)
    claims: list[Claim] = []

    def write(name: str) -> None:
        done, store, task = units.pop(name), stores[name], tasks[name]
        results = task.module.STUDY.results(done, map(store.read, done), effort=effort)
        claims.extend(_write(task, results, progress))
        store.forget_all_but(done)

    def keep(unit: Unit, arrays: dict[str, Array]) -> None:
        stores[unit.study].write(unit, arrays)
        left[unit.study].remove(unit)
        progress.add(unit.cost, f"{unit.study}: {unit.part}")
        if not left[unit.study]:
            write(unit.study)

    with closing(progress):
        for name in [name for name, some in left.items() if not some]:
            write(name)
        todo = [unit for some in left.values() for unit in some]
        # Long units first, so that short units fill the end and all processes remain busy.
        todo.sort(key=lambda unit: -unit.cost)
        try:
            compute(todo, pool, keep)
        except UnfinishedError as error:
            if len(set(map(str, error.causes))) == 1 and isinstance(error.causes[0], InputError):
                raise error.causes[0] from None  # for example a damaged file that all units read
            raise OSError(
                f"{error}; finished work is kept: run the same command to continue"
            ) from None
    return claims


def _write(task: Task, results: Results, progress: Progress) -> list[Claim]:
    """Write all outputs of a study; returns its claims."""
    name, module, outputs = task.name, task.module, task.outputs
    timings = {
        f"cpu_s {part}": float(arrays["cpu_s"].sum()) for part, arrays in results.data.items()
    }

    def stage(what: str, work: Callable[[], T]) -> T:
        progress.add(0.0, f"{name}: {what}")
        start = process_time()
        value = work()
        timings[f"cpu_s {what}"] = process_time() - start
        progress.add(WRITING_S[what])
        return value

    claims = stage("ledger", results.claims)
    texts = {
        "claims.json": dumps(claim for claim in claims if claim.kind != "check"),
        "checks.json": dumps(claim for claim in claims if claim.kind == "check"),
    }
    for stem, (_, table) in module.TABLES.items():
        if rows := table(results):  # empty if an optional input is missing
            texts[f"tables/{stem}.csv"] = _csv(rows)
    if task.file is not None:
        texts[USER] = page_data(module, task.file)
    outputs.publish(texts, {"result.npz": npz(_arrays(results.data))})
    figures = {f"figures/{stem}": draw for stem, (_, draw) in module.FIGURES.items()}

    def drawn() -> dict[str, bytes]:
        return pictures((stem, draw(results)) for stem, draw in figures.items())

    outputs.publish(stage("figures", drawn))
    try:
        stage("recordings", lambda: module.record(results, outputs))
    except (ImportError, OSError, RuntimeError) as error:
        warn(f"{name}: no recordings ({error}); everything else is written")
    about = crate.versions()
    about["machine"] = f"{platform.system()} {platform.machine()}, {cores()} cores"
    record = {"about": about, "effort": results.effort, "seed": results.seed}
    record["cpu_s"] = sum(timings.values())
    outputs.text("timings.json", json.dumps(record | {"timings": timings}, indent=1) + "\n")
    for kind in ("statement", "finding", "check"):
        count = Counter(claim.verdict for claim in claims if claim.kind == kind)
        if count:
            listed = ", ".join(f"{number} {verdict}" for verdict, number in sorted(count.items()))
            print(f"{name}: {kind}s: {listed}", flush=True)
    for claim in claims:
        if claim.surprise:
            print(
                f"{name}: not as expected: {claim.id}: {claim.verdict}, "
                f"expected {claim.expected}: {claim.row.says}",
                flush=True,
            )
    return claims


def write_viewer(top: Outputs, tasks: Mapping[str, Task]) -> None:
    """Write the viewer, if it is missing, and each recording as a script; warns if the installed
    viewer has another format.
    """
    if not viewer.is_current(top.directory):
        try:
            files = viewer.viewer()
        except RuntimeError as error:
            warn(f"no viewer ({error}); everything else is written")
            return
        top.publish(files)
    for task in tasks.values():
        outputs = task.outputs
        for name in task.module.RECORDINGS:
            if (path := outputs.directory / name).is_file():
                script = viewer.as_script(path.read_bytes(), _start(path))
                outputs.bytes(viewer.script_name(name), script)


def _start(recording: Path) -> float:
    """The time s at which a recording opens; 0 if a study wrote it without celnav's recorder."""
    try:
        return read(recording).start
    except InputError:
        return 0.0


def _crate(
    out: Path, tasks: Mapping[str, Task], options: argparse.Namespace, effort: float, seed: int
) -> str:
    """The description of this run and of its files. It leaves out what does not change results."""
    users = [Path(task.file) for task in tasks.values() if task.file is not None]
    read = {path.name: path for path in users}
    words = ["celnav reproduce", *(Path(task.file or name).name for name, task in tasks.items())]
    words.append(f"--effort {effort:g} --seed {seed} --engine {options.engine}")
    for task in tasks.values():
        for option, folder in _folders(task, options).items():
            words.append(f"--{option} {folder.name}")
            for pattern in getattr(task.module, "FILES", ("*",)):
                files = [path for path in sorted(folder.glob(pattern)) if path.is_file()]
                read |= {f"{folder.name}/{path.name}": path for path in files}
    written = [
        *TOP[:-1],
        *(f"{name}/{file}" for name, task in tasks.items() for file in task.files),
    ]
    studies = {name: task.module for name, task in tasks.items()}
    license = "Results of a user's study: its author states the license." if users else ""
    return crate.crate(out, " ".join(words), written, read, studies, license)


def _arrays(data: Mapping[str, Mapping[str, Array]]) -> dict[str, Array]:
    """Arrays for the results file: times, RMS errors, mean NEES and mean NIS over the runs."""
    out = {}
    for part, arrays in data.items():
        for name, values in arrays.items():
            what = name.rpartition("/")[2]
            if what == "times" or (what in ("error", "nees", "nis") and values.ndim < 2):
                out[f"{part}/{name}"] = values
            elif what == "error":
                out[f"{part}/{name} rms"] = np.sqrt(np.square(values).mean(1))
            elif what in ("nees", "nis"):
                out[f"{part}/{name}"] = values.mean(1)
    return out


def _csv(rows: Sequence[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()})
    return text.getvalue()
