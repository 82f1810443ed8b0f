"""How far a command is: a bar on a terminal, plain lines otherwise."""

from __future__ import annotations

import sys
from time import monotonic
from typing import Any

EVERY_S = 5.0
"""Between plain lines about runs."""
FORM = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"


class Progress:
    """Of work of known cost in any unit, ``total`` in all, ``done`` of it before: the share, the
    time left, and what is done.

    Of Monte-Carlo runs only a name is needed, see `runs`.
    """

    def __init__(self, name: str, total: float = 0.0, done: float = 0.0):
        self._name, self._total, self._said = name, 0.0, float("-inf")
        self._bar: Any = None
        if total:
            self._begin(total, done)

    def _begin(self, total: float, done: float) -> None:
        self._total, self._done, self._before = total, done, done
        self._start = monotonic()
        if sys.stderr.isatty():
            from tqdm import tqdm

            more: Any = {"bar_format": FORM, "smoothing": 0.0, "file": sys.stderr}
            self._bar = tqdm(total=total, initial=done, desc=self._name, **more)
        elif done:
            print(f"{self._name}: {done / total:.0%} was done before", flush=True)

    def add(self, cost: float, label: str = "") -> None:
        """So much more is done; ``label``: what it was, or what begins now."""
        self._done += cost
        if self._bar is not None:
            self._bar.update(cost)
            self._bar.set_postfix_str(label or self._bar.postfix)
        elif label:
            here, left = self._done - self._before, max(self._total - self._done, 0.0)
            time = f", {_duration((monotonic() - self._start) * left / here)} left" if here else ""
            print(f"{self._name}: {self._done / self._total:.0%}{time}: {label}", flush=True)

    def runs(self, done: int, total: int) -> None:
        """So many runs of all are done. The first call says how many were done before."""
        if not self._total:
            self._begin(total, done)
        cost, now = done - self._done, monotonic()
        label = ""
        if self._bar is not None or done == total or now - self._said >= EVERY_S:
            seconds, here = max(now - self._start, 1e-9), done - self._before
            label = f"{done}/{total} runs" + (f", {here / seconds:.0f} a second" if here else "")
            self._said = now
        self.add(cost, label)

    def say(self, line: str) -> None:
        """A line of its own."""
        if self._bar is not None:
            self._bar.clear()
        print(line, flush=True)

    def close(self) -> None:
        """Nothing more comes."""
        if self._bar is not None:
            self._bar.close()


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"
