"""Progress of a command: a bar on a terminal, plain lines otherwise."""

from __future__ import annotations

import sys
from textwrap import shorten
from time import monotonic
from typing import Any

EVERY_S = 5.0
"""Least time between plain lines about runs."""
BASIS = 0.1
"""Part of the work that must be measured before the time left is estimated."""


class Progress:
    """Progress of work whose cost is known: the share that is done, the time left, and the present
    piece.

    ``total``: cost of all work in any unit; ``done``: the part that was done before. The time left
    is estimated from the work after the first finished piece, since processes start and code is
    compiled before. For Monte-Carlo runs only a name is needed, see `runs`.
    """

    def __init__(self, name: str, total: float = 0.0, done: float = 0.0):
        self._name, self._total, self._said = name, 0.0, float("-inf")
        self._bar: Any = None
        self._basis: tuple[float, float] | None = None  # time and work at the first finished piece
        self._label = ""
        if total:
            self._begin(total, done)

    def _begin(self, total: float, done: float) -> None:
        self._total, self._done = total, done
        if _has_cursor():
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bar
            from rich.table import Column

            title = shorten(self._name, 24, placeholder="...")
            name = TextColumn(f"{title} {{task.percentage:.0f}} %", markup=False)
            one_line = Column(no_wrap=True, ratio=1)
            what = TextColumn("{task.description}", markup=False, table_column=one_line)
            # What is printed meanwhile stands above the bar, if it goes to the same terminal.
            self._bar = Bar(
                *(name, BarColumn(14), TimeElapsedColumn(), what),
                console=Console(stderr=True),
                expand=True,
                transient=True,
                redirect_stdout=sys.stdout.isatty(),
                refresh_per_second=2,
            )
            self._bar.add_task("", total=total, completed=done)
            self._bar.start()
        elif done:
            print(f"{self._name}: {done / total:.0%} was done before", flush=True)

    def _time_left(self) -> str:
        """The time left; empty while it cannot be estimated, and at the end."""
        start, before = self._basis or (0.0, self._done)
        here, left = self._done - before, self._total - self._done
        if here <= BASIS * (self._total - before) or left <= 0.0:
            return ""
        return f"{_duration((monotonic() - start) * left / here)} left"

    def add(self, cost: float, label: str = "") -> None:
        """Report finished work of a cost; ``label``: what was done, or what begins now."""
        self._done += cost
        if cost and self._basis is None:
            self._basis = monotonic(), self._done
        left = self._time_left()
        if self._bar is not None:
            self._label = label or self._label
            text = ", ".join(filter(None, [left, self._label]))
            self._bar.update(self._bar.task_ids[0], completed=self._done, description=text)
        elif label:
            share = f"{self._done / self._total:.0%}"
            print(f"{self._name}: {', '.join(filter(None, [share, left]))}: {label}", flush=True)

    def runs(self, done: int, total: int) -> None:
        """Report ``done`` of ``total`` runs. The first call gives how many were done before."""
        if not self._total:
            self._begin(total, done)
        now, label = monotonic(), ""
        if self._bar is not None or done == total or now - self._said >= EVERY_S:
            label = f"{done}/{total} runs"
            if self._basis is not None and now > self._basis[0]:
                label += f", {(done - self._basis[1]) / (now - self._basis[0]):.0f} a second"
            self._said = now
        self.add(done - self._done, label)

    def close(self) -> None:
        """Remove the bar at the end of the work."""
        if self._bar is not None:
            self._bar.stop()


def _has_cursor() -> bool:
    """Whether standard error is a terminal on which a bar can be drawn anew; a dumb one is none."""
    if not sys.stderr.isatty():
        return False
    from rich.console import Console

    return not Console(stderr=True).is_dumb_terminal


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"
