"""``celnav run``: run one mission."""

from __future__ import annotations

import argparse
import json
from contextlib import closing
from pathlib import Path

from celnav.commands.arguments import UsageError, done, folder_of, fraction, warn, workers
from celnav.commands.terminal import paragraph
from celnav.files import InputError, Outputs, locked, read_json
from celnav.show.progress import Progress

RECORDING = "mission.rrd"
ORIGIN = "mission.json"
"""File that names the source of the mission in a folder."""


def run(options: argparse.Namespace) -> int:
    """Run a mission and write its outputs; everything is computed before anything is written."""
    from celnav.campaign import WorkError, campaign
    from celnav.campaign.figures import figures, stems
    from celnav.campaign.missions import read
    from celnav.campaign.page import names, write
    from celnav.campaign.showcase import errors, first_run, record
    from celnav.campaign.table import summary

    study = read(options.mission, fraction(options.effort))
    pool = workers(options.jobs, -(-study.runs // study.block))
    if study.swept:
        listed = ", ".join(f"config.{key}" for key in study.swept)
        raise UsageError(
            f"{options.mission}: {listed}: a list of values is a study; use: celnav campaign "
            f"{options.mission}"
        )
    outputs = Outputs(options.out or folder_of("missions", options.mission))
    _check_origin(outputs.directory, options.mission)
    outputs.check([*names([*stems(study), "errors"]), "summary.txt", RECORDING, ORIGIN])
    try:
        with closing(Progress(study.title)) as progress:
            outcome = campaign(study, workers=pool, progress=progress.runs)
    except WorkError as error:
        warn(str(error))
        return 1
    paragraph(summary(outcome.rows, outcome.groups), 4)
    first, recorded = first_run(study), ""
    drawings = figures(outcome) | ({"errors": errors(first)} if first else {})
    with locked(outputs.directory):
        try:
            if first:
                with outputs.path_for(RECORDING) as path:
                    record(first, outcome, path)
                recorded = RECORDING
        except (ImportError, OSError, RuntimeError, ValueError) as error:
            warn(f"no recording ({error}); everything else is written")
        write(outcome, drawings, outputs, recorded)
        outputs.text("summary.txt", summary(outcome.rows, outcome.groups) + "\n")
        outputs.text(ORIGIN, json.dumps({"file": str(Path(options.mission).resolve())}) + "\n")
    print(f"wrote {outputs.directory / 'index.html'}")
    return done(outcome.rows)


def _check_origin(folder: Path, file: str) -> None:
    """Raise InputError if the folder contains another mission or a campaign, which is not
    overwritten.
    """
    from celnav.study.store import MANIFEST

    if (folder / MANIFEST).exists():
        raise InputError(
            f"{folder}: contains a campaign; choose another --out, or remove the folder"
        )
    if not (folder / ORIGIN).exists():
        return
    try:
        other = str(read_json(folder / ORIGIN)["file"])
    except (ValueError, KeyError, TypeError):
        other = str(folder / ORIGIN)
    # A folder that was moved together with its mission file still belongs to this mission.
    if other != str(Path(file).resolve()) and Path(other).exists():
        raise InputError(
            f"{folder}: contains the mission {other}; choose another --out, or remove the folder"
        )
