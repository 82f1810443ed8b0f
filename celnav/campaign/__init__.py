"""Campaigns: sweeps of thousands of configurations and runs, on one machine or on a cluster. They
are resumable, and results are identical bit for bit.

`campaign` computes a study, in memory or with a store in a folder. `units` defines the work units,
`engine` hands them out to one of `executors`, and `celnav.study.store` stores their results.
`table` lists the scores, `figures` and `page` show them, and `showcase` records a mission's first
run.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from celnav.campaign.engine import UnfinishedError, compute
from celnav.campaign.executors import Workers, dask, from_executor, processes, serial
from celnav.campaign.missions import Configuration, MissionStudy
from celnav.campaign.table import TableRow, rows_of
from celnav.campaign.units import Scored, VersionError, WorkError, units_of
from celnav.files import locked
from celnav.gaussian.linalg import Array
from celnav.lazy import modules
from celnav.study.store import StoreError, open_store
from celnav.study.study import Unit

__getattr__, __dir__ = modules(__name__)

__all__ = [
    "CampaignResult",
    "StoreError",
    "TableRow",
    "UnfinishedError",
    "VersionError",
    "WorkError",
    "campaign",
    "dask",
    "from_executor",
    "processes",
    "serial",
]

Progress = Callable[[int, int], None]
"""Called with ``(runs done, runs in all)`` at the start and whenever a unit is done."""
Say = Callable[[str], None]
"""Called with a line for the user."""


def _ignore(*_: object) -> None:
    """The default for `Progress` and `Say`: do nothing."""


MOST_DRAWN = 6
"""Largest number of configurations with figures over time: the first that could be simulated."""


class CampaignResult(NamedTuple):
    """The scores of a study.

    rows: one for each configuration and filter. first: the first configurations that could be
    simulated, with their scores over time. trace: where the first exception came from; empty if
    there was none.
    """

    study: MissionStudy
    rows: list[TableRow]
    first: list[tuple[Configuration, Scored]]
    trace: str

    @property
    def groups(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each judged group; empty if no configuration could be simulated."""
        return self.first[0][1].groups if self.first else ()


def campaign(
    study: MissionStudy,
    folder: str | Path | None = None,
    workers: Workers | None = None,
    *,
    progress: Progress = _ignore,
    say: Say = _ignore,
) -> CampaignResult:
    """The merged scores of a study, after its missing units are computed.

    The folder may have the same study with fewer runs, or with fewer values of swept keys. Then
    only the rest is computed, and a last block that was incomplete is computed again. The table is
    identical, byte for byte, to that of the whole study computed at once.

    Parameters
    ----------
    folder: of the store; None: everything stays in memory.
    workers: `serial` (the default), `processes`, `dask`, or any executor with `from_executor`.
    progress, say: see `Progress` and `Say`; `say` gets a line about each damaged unit.

    Raises
    ------
    StoreError: if the folder belongs to another study, or was begun with another celnav.
    BlockingIOError: if another process is using the folder. OSError: if the folder cannot be
        written, or the executor is lost. UnfinishedError: if units failed; the others are stored.
    VersionError: if workers have another celnav.
    """
    if folder is None:
        results: dict[Unit, dict[str, Array]] = {}
        access = results.__setitem__, results.__getitem__, results.__contains__
        return _compute(study, workers, progress, *access)
    Path(folder).mkdir(parents=True, exist_ok=True)
    with locked(folder):
        store = open_store(folder, study.to_dict(), study.may_grow)
        try:
            return _compute(
                study, workers, progress, store.write, store.read, lambda unit: store.has(unit, say)
            )
        except (ValueError, IndexError) as error:
            raise StoreError(
                f"{folder}: its units do not go together ({error}); remove the folder"
            ) from None


def _compute(
    study: MissionStudy,
    workers: Workers | None,
    progress: Progress,
    write: Callable[[Unit, dict[str, Array]], None],
    read: Callable[[Unit], dict[str, Array]],
    has: Callable[[Unit], bool],
) -> CampaignResult:
    """Compute the units that are missing, and merge those of each configuration."""
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
    rows: list[TableRow] = []
    first: list[tuple[Configuration, Scored]] = []
    trace = ""
    for units, point in zip(plan, study.configurations, strict=True):
        work: Any = units[0].work.work
        scored = work.read(map(read, units))
        rows += rows_of(study, point, scored)
        trace = trace or scored.trace
        if scored.groups and len(first) < MOST_DRAWN:
            first.append((point, scored))
    return CampaignResult(study, rows, first, trace)
