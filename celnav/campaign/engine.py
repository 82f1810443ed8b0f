"""The engine: hand out missing units, keep their results, and restart after a worker's death."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from typing import Any, TypeVar

from celnav.campaign.executors import Workers
from celnav.campaign.units import VersionError, WorkError, execute
from celnav.gaussian.linalg import Array
from celnav.study.store import code
from celnav.study.study import Unit

ATTEMPTS = 3
"""Deaths of workers in a row, without a finished unit, after which units are tried one by one."""

R = TypeVar("R")


class UnfinishedError(WorkError):
    """Some units could not be done; the results of all others are kept.

    causes: exceptions of the failed units; units whose worker died have none.
    """

    def __init__(self, message: str, causes: Sequence[Exception] = ()):
        super().__init__(message)
        self.causes = tuple(causes)


def _nothing() -> None:
    """The default for ``opened``: do nothing."""


def compute(
    units: Iterable[Unit],
    workers: Workers,
    keep: Callable[[Unit, dict[str, Array]], None],
    opened: Callable[[], None] = _nothing,
) -> None:
    """Do all units and give each result to ``keep`` as it arrives, in any order. ``opened()`` is
    called once workers are available.

    Raises
    ------
    UnfinishedError: after all others are done, if units failed or killed their workers.
        VersionError: see `execute`; at once.
    Whatever ``keep`` raises; then nothing more is handed out.
    """
    missing = dict.fromkeys(units)
    unfinished: list[str] = []
    causes: list[Exception] = []
    deaths = 0
    while missing:
        # With one unit at a time it is clear which unit kills its worker.
        alone = deaths >= ATTEMPTS
        try:
            with workers.open() as executor:
                opened()
                opened = _nothing
                for unit, outcome in results(
                    executor, execute, list(missing), 1 if alone else workers.ahead, code()
                ):
                    del missing[unit]
                    if isinstance(outcome, Exception):
                        unfinished.append(_titled(unit, _message(outcome)))
                        causes.append(outcome)
                    else:
                        keep(unit, outcome)
                        deaths = 0
        except BrokenExecutor as error:
            if not workers.again:
                raise OSError(
                    f"the executor is broken ({_message(error)}); finished work is kept"
                ) from None
            deaths += 1
            if alone:
                culprit = next(iter(missing))
                del missing[culprit]
                unfinished.append(_titled(culprit, "its worker dies"))
    if unfinished:
        rest = f" and {len(unfinished) - 3} more" if len(unfinished) > 3 else ""
        count = "1 unit is" if len(unfinished) == 1 else f"{len(unfinished)} units are"
        raise UnfinishedError(f"{count} not done: {'; '.join(unfinished[:3])}{rest}", causes)


def _titled(unit: Unit, why: str) -> str:
    return f"{unit.title} ({why})"


def _message(error: Exception) -> str:
    message = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return "; ".join([message, *getattr(error, "__notes__", ())])


def results(
    executor: Executor,
    function: Callable[..., R],
    todo: Sequence[Unit],
    ahead: int,
    *arguments: Any,
) -> Iterator[tuple[Unit, R | Exception]]:
    """Results and exceptions of ``function(unit, *arguments)`` in the order of their arrival; up to
    ``ahead`` units are handed out in advance.

    Raises
    ------
    BrokenExecutor: if a worker died. VersionError: see `execute`. OSError: if the executor dropped
        the work.
    """
    waiting: dict[Future[R], Unit] = {}
    left = iter(todo)
    while True:
        fatal: BaseException | None = None
        try:
            while len(waiting) < ahead and (unit := next(left, None)) is not None:
                waiting[executor.submit(function, unit, *arguments)] = unit
        except BrokenExecutor as broken:
            fatal = broken  # results that are already finished are kept
        if not waiting and fatal is None:
            return
        done = wait(waiting, 0.0 if fatal else None, return_when=FIRST_COMPLETED).done
        finished = [future for future in waiting if future in done]
        del done
        while finished:  # results may be large: none is held here while waiting for the next
            future = finished.pop(0)
            unit = waiting.pop(future)
            error = CancelledError() if future.cancelled() else future.exception()
            if isinstance(error, BrokenExecutor | VersionError | CancelledError):
                fatal = error
            elif error is None or isinstance(error, Exception):
                outcome: R | Exception = future.result() if error is None else error
                del future
                yield unit, outcome
                del outcome
            else:
                raise error
        if isinstance(fatal, CancelledError):
            raise OSError("the cluster dropped the work: its scheduler or its connection is gone")
        if fatal is not None:
            raise fatal
