"""Conversion and checks of the arguments of commands."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from celnav import papers
from celnav.papers import is_file
from celnav.papers.own import name_of
from celnav.study.montecarlo import effort

if TYPE_CHECKING:
    from celnav.campaign.executors import Workers
    from celnav.campaign.table import TableRow

MOST_PER_CORE = 4
"""Largest number of processes for each core."""


class UsageError(Exception):
    """An invalid argument of a command: one line is printed, and the exit status is 2."""


def check_name(study: str) -> None:
    """Raise UsageError for a file that has the name of one of celnav's studies."""
    name = name_of(study)
    if is_file(study) and name in (*papers.PAPERS, *papers.REAL):
        raise UsageError(
            f"{study}: expected a name other than {name}, which celnav uses; rename the file"
        )


def load(study: str) -> ModuleType:
    """The module of a study from `celnav.papers.load`, or UsageError."""
    check_name(study)
    try:
        return papers.load(study)
    except ValueError as error:
        raise UsageError(error) from None


def whole(name: str, text: str, least: int) -> int:
    """The integer of an option, or UsageError."""
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise UsageError(f"--{name}: expected a whole number of at least {least}, got {text!r}")
    return value


def workers(jobs: str | None, units: int | None = None) -> Workers:
    """Worker processes for ``--jobs`` (None: one for each core), at most ``units``; with 1 the work
    runs in this process. UsageError for an invalid number.
    """
    from celnav.campaign.executors import processes, serial

    count = cores() if jobs is None else whole("jobs", jobs, 1)
    most = MOST_PER_CORE * cores()
    if count > most:
        warn(
            f"--jobs: {count} processes on {cores()} cores would slow each other down; "
            f"{most} are started"
        )
    count = min(count, most, units or most)
    return processes(count) if count > 1 else serial()


def fraction(text: str | None) -> float:
    """The effort from the option, or else from the environment; UsageError if it is invalid."""
    try:
        return effort(text)
    except ValueError as error:
        raise UsageError(error if text is None else f"--{error}") from None


def number(name: str, text: str) -> float:
    """The number of an option, or UsageError."""
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"--{name}: expected a number, got {text!r}") from None


def cores() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def warn(line: str) -> None:
    """Print a line for the user to stderr."""
    print(f"celnav: {line}", file=sys.stderr)


def done(rows: Sequence[TableRow]) -> int:
    """Exit status of runs: 1, with a warning, if all runs failed; else 0."""
    if any(row["runs"] for row in rows):
        return 0
    warn("every run of every filter failed")
    return 1


def folder_of(kind: str, file: str) -> Path:
    """Default folder for the results of a file: ``out/KIND/NAME``."""
    return Path("out", kind) / (re.sub(r"[^\w.-]+", "-", Path(file).stem).strip(".-") or "mission")
