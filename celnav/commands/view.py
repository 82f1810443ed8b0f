"""``celnav view``: open a recording."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

from celnav.commands.arguments import UsageError, module, number


def run(options: argparse.Namespace) -> int:
    """Open a paper's recording, or a file."""
    path = _file(options) if options.paper.endswith(".rrd") else _of_paper(options)
    if options.picture is not None:
        return _picture(path, Path(options.picture), number("at", options.at))
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        hint = f"use --picture, or copy {path} to a machine that has one and run: rerun {path.name}"
        raise OSError(f"no display to open a window on; {hint}")
    return subprocess.run([sys.executable, "-m", "rerun", str(path)], check=False).returncode


def _picture(path: Path, target: Path, at: float) -> int:
    """A PNG, which needs no display."""
    if target.suffix.lower() != ".png":
        raise UsageError(f"picture: expected the name of a .png file, got {str(target)!r}")
    if not at >= 0.0:
        raise UsageError(f"at: expected a time that is not negative, got {at:g}")
    from celnav.picture import picture

    picture(path, target, at)
    print(f"wrote {target}")
    return 0


def _file(options: argparse.Namespace) -> Path:
    path = Path(options.paper)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such recording")
    return path


def _of_paper(options: argparse.Namespace) -> Path:
    module(options.paper)
    folder = Path(options.out, options.paper)
    recordings = sorted(path.name for path in folder.glob("*.rrd")) if folder.is_dir() else []
    if not recordings:
        raise FileNotFoundError(f"{folder}: no recording; make it with: celnav reproduce {options.paper} --out {options.out}")
    name: str = options.recording or recordings[0]
    if name not in recordings:
        raise UsageError(f"unknown recording {name!r}: expected one of {', '.join(recordings)}")
    return folder / name
