"""``celnav run``: fly one mission."""

from __future__ import annotations

import argparse
import sys

from celnav.commands.arguments import UsageError, folder_of, fraction, workers
from celnav.files import Outputs, locked
from celnav.progress import RunProgress

RECORDING = "mission.rrd"


def run(options: argparse.Namespace) -> int:
    """Everything is computed before anything is written."""
    from celnav.campaign import WorkError, fly
    from celnav.campaign.figures import figures, stems
    from celnav.campaign.page import names, write
    from celnav.campaign.showcase import errors, record, showcase
    from celnav.campaign.table import summary
    from celnav.mission import read

    study = read(options.mission, fraction(options.effort))
    pool = workers(options.jobs, -(-study.runs // study.block))
    if study.swept:
        listed = ", ".join(f"config.{key}" for key in study.swept)
        raise UsageError(f"{options.mission}: {listed}: a list of values is a study; use: celnav campaign {options.mission}")
    outputs = Outputs(options.out or folder_of("missions", options.mission))
    outputs.check([*names([*stems(study), "errors"]), "summary.txt", RECORDING])
    try:
        with RunProgress(study.title) as progress:
            outcome = fly(study, pool, progress=progress)
    except WorkError as error:
        print(f"celnav: {error}", file=sys.stderr)
        return 1
    print(summary(outcome.rows))
    first, recorded = showcase(study), ""
    drawings = figures(outcome) | ({"errors": errors(first)} if first else {})
    with locked(outputs.directory):
        try:
            if first:
                with outputs.path_for(RECORDING) as path:
                    record(first, outcome, path)
                recorded = RECORDING
        except (ImportError, OSError, RuntimeError, ValueError) as error:
            print(f"celnav: no recording ({error}); everything else is written", file=sys.stderr)
        write(outcome, drawings, outputs, recorded)
        outputs.text("summary.txt", summary(outcome.rows) + "\n")
    print(f"wrote {outputs.directory / 'index.html'}")
    return 0
