"""``celnav view``: open a recording."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

from celnav.commands.arguments import UsageError, module, number
from celnav.commands.index import OWN, shown
from celnav.papers import own

__all__ = ["run"]


def run(options: argparse.Namespace) -> int:
    """Open a paper's recording, or a file."""
    path = _file(options) if Path(options.paper).suffix not in ("", ".py") else _of_paper(options)
    if options.picture is not None:
        return _picture(
            path, Path(options.picture), None if options.at is None else number("at", options.at)
        )
    if options.at is not None:
        raise UsageError(
            "--at: expected --picture FILE.png with it; in a window the time is moved by hand"
        )
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        hint = f"use --picture, or copy {path} to a machine that has one and run: rerun {path.name}"
        raise OSError(f"no display to open a window on; {hint}")
    from celnav.show.picture import command

    return subprocess.run(command(str(path)), check=False).returncode


def _picture(path: Path, target: Path, at: float | None) -> int:
    """A PNG, which needs no display."""
    if target.suffix.lower() != ".png":
        raise UsageError(f"--picture: expected the name of a .png file, got {str(target)!r}")
    from celnav.show.picture import end, picture

    last = end(path)
    if at is not None and not 0.0 <= at <= last:
        raise UsageError(
            f"--at: expected a time of the recording, from 0 to {last:g} s, got {at:g}"
        )
    picture(path, target, last if at is None else at)
    print(f"wrote {target}")
    return 0


def _file(options: argparse.Namespace) -> Path:
    path = Path(options.paper)
    if options.recording is not None:
        raise UsageError(f"--recording: expected a paper with it, got the file {path}")
    if path.suffix != ".rrd":
        raise UsageError(f"{path}: expected a paper that was reproduced, or a recording, FILE.rrd")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such recording")
    return path


def _of_paper(options: argparse.Namespace) -> Path:
    name = own.name_of(options.paper)
    folder = Path(options.out, name)
    study = shown(Path(options.out), name) if (folder / OWN).exists() else module(options.paper)
    if not study.RECORDINGS:
        mission = "; a mission of it (celnav run) has one" if options.paper.endswith(".py") else ""
        raise UsageError(f"{options.paper}: has no recordings{mission}")
    recordings = [name for name in study.RECORDINGS if (folder / name).is_file()]
    if not recordings:
        raise FileNotFoundError(
            f"{folder}: no recording; make it with: celnav reproduce {options.paper} --out {options.out}"
        )
    if options.recording is None:
        return Path(folder, recordings[0])
    wanted: str = (
        options.recording if options.recording.endswith(".rrd") else f"{options.recording}.rrd"
    )
    if wanted not in recordings:
        raise UsageError(
            f"unknown recording {options.recording!r}: expected one of {', '.join(recordings)}"
        )
    return Path(folder, wanted)
