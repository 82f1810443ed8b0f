"""The command line: ``celnav list | reproduce | view | position``."""

from __future__ import annotations

import argparse
import csv
import io
import json
import os
import platform
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from time import process_time
from types import ModuleType
from typing import Any

import celnav
from celnav.effort import effort
from celnav.files import InputError
from celnav.papers import PAPERS, figures, load, tables


class UsageError(Exception):
    """The command was given something it cannot use: one line, exit 2."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        options = _parser().parse_args(arguments)
        status: int = options.command(options)
        sys.stdout.flush()
        return status
    except UsageError as error:
        print(f"celnav: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (OSError, ImportError, InputError) as error:
        print(f"celnav: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("celnav: interrupted", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="celnav", description=(celnav.__doc__ or "").partition("\n")[0])
    parser.add_argument("--version", action="version", version=f"celnav {celnav.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    lists = commands.add_parser("list", help="papers, figures, filters and rules")
    lists.set_defaults(command=_list)

    reproduce = commands.add_parser("reproduce", help="run papers; write figures, tables, claims and recordings")
    reproduce.add_argument("papers", nargs="*", metavar="PAPER", help="which papers (none: all)")
    reproduce.add_argument(
        "--effort", metavar="F", help="fraction of the Monte-Carlo runs, 0 < F <= 1 (default: CELNAV_EFFORT, or 1)"
    )
    reproduce.add_argument("--seed", default="0", metavar="S", help="seed, a whole number that is not negative (default: 0)")
    reproduce.add_argument("--out", default="out", metavar="DIR", help="where to write (default: out)")
    reproduce.add_argument("--jobs", default="1", metavar="N", help="processes (default: 1)")
    reproduce.add_argument("--strict", action="store_true", help="exit 1 if a claim is not as expected")
    reproduce.add_argument("--rinex", metavar="DIR", help="folder of a receiver's RINEX files, for aukf (default: rinex, if there)")
    reproduce.set_defaults(command=_reproduce)

    view = commands.add_parser("view", help="open a paper's recording in the Rerun viewer, offline")
    view.add_argument("paper", metavar="PAPER")
    view.add_argument("--out", default="out", metavar="DIR", help="where reproduce wrote (default: out)")
    view.add_argument("--recording", metavar="NAME", help="which recording (default: the first)")
    view.set_defaults(command=_view)

    position = commands.add_parser("position", help="position a BeiDou receiver from its RINEX 3 files")
    position.add_argument("observations", metavar="OBS", help="observation file, plain, .gz or .crx")
    position.add_argument("navigation", metavar="NAV", help="navigation file of the same day")
    position.add_argument(
        "--filter",
        default="aukf",
        metavar="NAME",
        help="ls, ekf, ukf, aukf, group, channel, gate, huber, student or sage-husa (default: aukf)",
    )
    position.add_argument(
        "--position", nargs=3, metavar=("X", "Y", "Z"), help="known position, m, Earth-fixed (default: the header's)"
    )
    position.add_argument("--mask", default="10", metavar="DEG", help="least elevation of satellites (default: 10)")
    position.add_argument(
        "--acceleration-noise", default="0.01", metavar="Q", help="m^2/s^3; a^2 T for accelerations a each T s (default: 0.01)"
    )
    position.add_argument("--out", default="out/position", metavar="DIR", help="where to write (default: out/position)")
    position.set_defaults(command=_position)
    return parser


def _module(paper: str) -> ModuleType:
    try:
        return load(paper)
    except ValueError as error:
        raise UsageError(error) from None


def _whole(name: str, text: str, least: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise UsageError(f"{name}: expected a whole number of at least {least}, got {text!r}")
    return value


def _list(options: argparse.Namespace) -> int:  # noqa: ARG001
    for paper in PAPERS:
        module = load(paper)
        print(f"{paper}: {module.TITLE}\n")
        for stem, function in {**figures(module), **tables(module)}.items():
            print(f"  {stem:12} {(function.__doc__ or '').partition(chr(10))[0]}")
        print(f"\n  filters: {', '.join(module.filters(next(iter(module.PRESETS.values()))))}")
        print(f"  presets: {', '.join(module.PRESETS)}\n")
    print("rules: unscented, simplex, cubature (degree 3 and 5), gauss_hermite, smolyak, from_filterpy, Taylor (EKF)")
    return 0


def _reproduce(options: argparse.Namespace) -> int:
    from celnav.files import Outputs

    papers = list(dict.fromkeys(options.papers)) or list(PAPERS)
    modules = {paper: _module(paper) for paper in papers}
    try:
        fraction = effort(options.effort)
    except ValueError as error:
        raise UsageError(error) from None
    seed, jobs = _whole("seed", options.seed, 0), _whole("jobs", options.jobs, 1)
    if options.rinex is not None and not any("rinex" in getattr(module, "INPUTS", ()) for module in modules.values()):
        raise UsageError(f"rinex: expected a paper that takes a receiver's log (aukf), got {', '.join(papers)}")
    out = Path(options.out)
    if out.exists() and not out.is_dir():
        raise NotADirectoryError(f"{out}: expected a folder to write to")
    top = Outputs(out)
    top.check(["index.html"])
    surprises = 0
    for paper, module in modules.items():
        inputs = {name: Path(given) for name in getattr(module, "INPUTS", ()) if (given := getattr(options, name)) is not None}
        surprises += _one(paper, module, Outputs(out / paper), effort=fraction, seed=seed, jobs=jobs, **inputs)
    _index(top)
    print(f"wrote {out / 'index.html'}")
    return 1 if options.strict and surprises else 0


def _index(top: Any) -> None:
    from celnav.report import index

    top.text("index.html", index(top.directory))


def _one(paper: str, module: ModuleType, outputs: Any, **chosen: Any) -> int:
    """Reproduce one paper; returns the number of claims that are not as expected."""
    from celnav.claims import dumps
    from celnav.figures import render

    drawings, listings = figures(module), tables(module)
    outputs.check(f"figures/{stem}.{kind}" for stem in drawings for kind in ("png", "svg"))
    outputs.check(f"tables/{stem}.csv" for stem in listings)
    outputs.check(["claims.json", "timings.json", "result.npz", *module.RECORDINGS])
    timings: dict[str, float] = {}
    report = _Progress(paper)

    def stage(name: str, work: Callable[[], Any]) -> Any:
        report.stage(name)
        start = process_time()
        value = work()
        timings[f"cpu_s {name}"] = process_time() - start
        return value

    result = stage("runs", lambda: module.reproduce(**chosen, progress=report))
    claims = stage("claims", lambda: module.claims(result))
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
        stage("recordings", lambda: module.record(result, outputs))
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


class _Progress:
    """A bar on a terminal, plain lines otherwise."""

    def __init__(self, paper: str):
        self._paper = paper
        self._bar: Any = None
        self._terminal = sys.stderr.isatty()

    def stage(self, name: str) -> None:
        if not self._terminal:
            print(f"{self._paper}: {name}", flush=True)
        elif self._bar is not None:
            self._bar.set_description(f"{self._paper}: {name}")

    def __call__(self, done: int, total: int, label: str) -> None:
        if not self._terminal:
            print(f"{self._paper}: {done}/{total} {label}", flush=True)
            return
        if self._bar is None:
            from tqdm import tqdm

            self._bar = tqdm(total=total, file=sys.stderr)
        self._bar.set_description(f"{self._paper}: {label}")
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"{name}: expected a number, got {text!r}") from None


def _position(options: argparse.Namespace) -> int:
    """Everything is computed before anything is written."""
    import numpy as np

    from celnav import positioning, positioning_report, rinex
    from celnav.files import Outputs
    from celnav.filters.driver import FilterError
    from celnav.models.receiver import on_earth

    mask, noise = _number("mask", options.mask), _number("acceleration-noise", options.acceleration_noise)
    given = None if options.position is None else np.array([_number("position", text) for text in options.position])
    try:
        positioning.mask(mask)
        names = ["ls", *positioning.filters(4, acceleration=noise)]
        if given is not None:
            on_earth("position", given)
    except ValueError as error:
        raise UsageError(error) from None
    if options.filter not in names:
        raise UsageError(f"unknown filter {options.filter!r}: expected one of {', '.join(names)}")
    outputs = Outputs(options.out)
    outputs.check([*positioning_report.FILES, positioning_report.RECORDING])
    navigation, observations = rinex.read_navigation(options.navigation), rinex.read_observations(options.observations)
    log = positioning.prepare(observations, navigation, mask_deg=mask)
    reference = observations.position if given is None else given
    try:
        found = positioning_report.position(log, options.filter, reference, acceleration=noise)
    except FilterError as error:
        raise InputError(f"{options.filter} is lost on {options.observations}: {str(error).partition(' (on_failure')[0]}") from None
    print(positioning_report.summary(found))
    positioning_report.write(found, outputs)
    try:
        with outputs.path_for(positioning_report.RECORDING) as path:
            positioning_report.record_positioned(found, path)
    except (ImportError, OSError, RuntimeError, ValueError) as error:  # of one epoch there is none
        print(f"celnav: no recording ({error}); everything else is written", file=sys.stderr)
    print(f"wrote {outputs.directory}")
    return 0


def _view(options: argparse.Namespace) -> int:
    _module(options.paper)
    folder = Path(options.out) / options.paper
    recordings = sorted(path.name for path in folder.glob("*.rrd")) if folder.is_dir() else []
    if not recordings:
        raise FileNotFoundError(f"{folder}: no recording; make it with: celnav reproduce {options.paper} --out {options.out}")
    name = options.recording or recordings[0]
    if name not in recordings:
        raise UsageError(f"unknown recording {name!r}: expected one of {', '.join(recordings)}")
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise OSError(f"no display to open a window on; copy {folder / name} to a machine that has one and run: rerun {name}")
    return subprocess.run([sys.executable, "-m", "rerun", str(folder / name)], check=False).returncode
