"""``celnav campaign``: sweep a study."""

from __future__ import annotations

import argparse
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from celnav.commands.arguments import (
    UsageError,
    cores,
    done,
    folder_of,
    fraction,
    warn,
    whole,
    workers,
)
from celnav.commands.mission import ORIGIN
from celnav.commands.terminal import paragraph
from celnav.files import InputError, Outputs, locked
from celnav.show.progress import Progress

if TYPE_CHECKING:
    from celnav.campaign.executors import Workers


def run(options: argparse.Namespace) -> int:
    """Compute the missing units of a study and write its outputs; returns the exit status."""
    from celnav.campaign import WorkError, campaign
    from celnav.campaign.figures import figures, stems
    from celnav.campaign.missions import read
    from celnav.campaign.page import names, write
    from celnav.campaign.table import summary

    pool, study = _workers(options), read(options.study, fraction(options.effort))
    folder = Path(options.out or folder_of("campaigns", options.study))
    outputs = Outputs(folder)
    if (folder / ORIGIN).exists():
        raise InputError(
            f"{folder}: contains a mission; choose another --out, or remove the folder"
        )
    outputs.check(names(stems(study)))
    try:
        with closing(Progress(folder.name)) as progress:
            outcome = campaign(study, folder, pool, progress=progress.runs, say=warn)
    except WorkError as error:
        warn(f"{error}; the others are kept in {folder}")
        return 1
    except KeyboardInterrupt:
        warn(f"interrupted; finished work is kept in {folder}; the same command resumes")
        return 130
    paragraph(summary(outcome.rows, outcome.groups), 4)
    with locked(folder):
        write(outcome, figures(outcome), outputs)
    print(f"wrote {folder / 'index.html'}")
    return done(outcome.rows)


def _workers(options: argparse.Namespace) -> Workers:
    from celnav.campaign import dask

    if options.address is not None and options.executor != "dask":
        raise UsageError("--address: expected --executor dask with it")
    if options.executor == "processes":
        return workers(options.jobs)
    try:
        return dask(
            options.address, cores() if options.jobs is None else whole("jobs", options.jobs, 1)
        )
    except ValueError as error:
        raise UsageError(f"--{error}") from None
