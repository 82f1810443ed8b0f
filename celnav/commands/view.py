"""``celnav view``: open a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from celnav.commands.arguments import UsageError, number
from celnav.commands.index import study_of
from celnav.papers import is_file
from celnav.papers.own import name_of

if TYPE_CHECKING:
    from celnav.show.reading import Recorded


def run(options: argparse.Namespace) -> int:
    """Open a paper's recording or a file; returns the exit status."""
    file = Path(options.paper)
    path = _recording(options, file) if file.suffix in ("", ".py") else _file(options, file)
    target = None if options.picture is None else Path(options.picture)
    if target is not None and target.suffix.lower() != ".png":
        raise UsageError(f"--picture: expected the name of a .png file, got {str(target)!r}")
    from celnav.show.picture import picture
    from celnav.show.reading import read
    from celnav.show.window import require_display, show

    if target is None:
        elsewhere = f"copy {path} to a machine that has one and run: celnav view {path.name}"
        require_display(f"use --picture, or {elsewhere}")
    at = _time(options, read(path))
    if target is None:
        show(path, at)
    else:
        picture(path, target, at)
        print(f"wrote {target}")
    return 0


def _time(options: argparse.Namespace, recorded: Recorded) -> float:
    """The time that is asked for, or where something is to be seen."""
    at = recorded.start if options.at is None else number("at", options.at)
    if not 0.0 <= at <= recorded.end:
        raise UsageError(
            f"--at: expected a time of the recording, from 0 to {recorded.end:g} s, got {at:g}"
        )
    return at


def _file(options: argparse.Namespace, path: Path) -> Path:
    if options.recording is not None:
        raise UsageError(f"--recording: expected a paper with it, got the file {path}")
    if path.suffix != ".rrd":
        raise UsageError(f"{path}: expected a paper that was reproduced, or a recording, FILE.rrd")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such recording")
    return path


def _recording(options: argparse.Namespace, study: Path) -> Path:
    """The recording of a reproduced study."""
    out = Path(options.out)
    folder = out / name_of(options.paper)
    names = study_of(out, folder.name, options.paper).RECORDINGS
    if not names:
        mission = "; a mission of it (celnav run) has one" if is_file(options.paper) else ""
        raise UsageError(f"{study}: has no recordings{mission}")
    recordings = [str(name) for name in names if (folder / name).is_file()]
    if not recordings:
        raise FileNotFoundError(
            f"{folder}: no recording; create it with: celnav reproduce {study} --out {out}"
        )
    if options.recording is None:
        return folder / recordings[0]
    wanted = f"{options.recording}".removesuffix(".rrd") + ".rrd"
    if wanted not in recordings:
        raise UsageError(
            f"unknown recording {options.recording!r}: expected one of {', '.join(recordings)}"
        )
    return folder / wanted
