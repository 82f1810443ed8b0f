"""Campaigns: sweeps of thousands of configurations and runs, on one machine or on a cluster,
resumable and bit for bit the same.

`campaign` does a study and keeps it in a folder, `fly` does a mission in memory. `units` says what
a piece of work is, `engine` hands the pieces out to one of `executors`, `store` keeps them, `table`
says what they come to, `figures` and `page` show it, and `showcase` follows a mission's first run.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from celnav.campaign.engine import UnfinishedError, compute
from celnav.campaign.executors import Workers, dask, given, processes, serial
from celnav.campaign.missions import Configuration, Study
from celnav.campaign.store import StoreError, open_store
from celnav.campaign.table import Row, rows_of
from celnav.campaign.units import Scored, VersionError, WorkError, units_of
from celnav.files import locked
from celnav.gaussian.linalg import Array
from celnav.lazy import modules
from celnav.study.study import Unit

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "Outcome",
    "Row",
    "StoreError",
    "UnfinishedError",
    "VersionError",
    "WorkError",
    "campaign",
    "dask",
    "fly",
    "given",
    "processes",
    "serial",
]

Progress = Callable[[int, int], None]
"""``(runs done, runs in all)``, at the start and whenever a unit is done."""
Say = Callable[[str], None]
"""Takes a line that a user should read."""


def _silent(*_: object) -> None:
    """Tell nobody."""


FOLLOWED = 6
"""Configurations whose errors over time are kept for drawing: the first that could be simulated."""


class Outcome(NamedTuple):
    """What a study comes to: one row for each configuration and filter, the first configurations
    that could be simulated in full, and where the first exception came from, if there was one."""

    study: Study
    rows: list[Row]
    first: list[tuple[Configuration, Scored]]
    trace: str


def campaign(
    study: Study,
    folder: str | Path,
    workers: Workers | None = None,
    *,
    progress: Progress = _silent,
    say: Say = _silent,
) -> Outcome:
    """Do what is missing of a study whose store is ``folder``, and merge it.

    Where the folder has the same study with fewer runs, or fewer values of what is swept, only the
    others are flown; a last block that was not whole is flown anew. The table is that of the whole
    study flown at once, byte for byte.

    Parameters
    ----------
    workers: `serial` (the default), `processes`, `dask`, or any executor as `given`.
    progress, say: see `Progress` and `Say`; `say` is told of damaged units.

    Raises
    ------
    StoreError: if the folder belongs to another study, or was begun with another celnav.
    BlockingIOError: if another process is at work there. OSError: if it cannot be written, or the
        executor is lost. UnfinishedError: if units failed; the others are kept.
    VersionError: if workers have another celnav.
    """
    Path(folder).mkdir(parents=True, exist_ok=True)
    with locked(folder):
        store = open_store(folder, study)
        try:
            return _done(
                study, workers, progress, store.write, store.read, lambda unit: store.has(unit, say)
            )
        except (ValueError, IndexError) as error:
            raise StoreError(
                f"{folder}: its units do not go together ({error}); remove the folder"
            ) from None


def fly(study: Study, workers: Workers | None = None, *, progress: Progress = _silent) -> Outcome:
    """Do a study in memory, without a store. Raises UnfinishedError if units failed."""
    results: dict[Unit, dict[str, Array]] = {}
    return _done(
        study, workers, progress, results.__setitem__, results.__getitem__, results.__contains__
    )


def _done(
    study: Study,
    workers: Workers | None,
    progress: Progress,
    write: Callable[[Unit, dict[str, Array]], None],
    read: Callable[[Unit], dict[str, Array]],
    has: Callable[[Unit], bool],
) -> Outcome:
    """Do the units that are missing, and read what each configuration comes to."""
    plan = units_of(study)
    todo = [unit for units in plan for unit in units if not has(unit)]
    total = study.runs * len(plan)
    done = total - sum(len(unit.runs) for unit in todo)
    if not todo:
        progress(done, total)

    def keep(unit: Unit, arrays: dict[str, Array]) -> None:
        nonlocal done
        write(unit, arrays)
        done += len(unit.runs)
        progress(done, total)

    compute(todo, workers or serial(), keep, lambda: progress(done, total))
    rows: list[Row] = []
    first: list[tuple[Configuration, Scored]] = []
    trace = ""
    for units, point in zip(plan, study.configurations, strict=True):
        work: Any = units[0].work.work
        scored = work.read(map(read, units))
        rows += rows_of(study, point, scored)
        trace = trace or scored.trace
        if scored.groups and len(first) < FOLLOWED:
            first.append((point, scored))
    return Outcome(study, rows, first, trace)
