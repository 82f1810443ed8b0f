"""How far a command is: a bar on a terminal, plain lines otherwise."""

from __future__ import annotations

import sys
from time import monotonic
from typing import Any, Self

EVERY_S = 5.0
"""Between plain lines about runs."""


class Progress:
    """Of work of known cost, with the time left, and of what is made of it meanwhile."""

    def __init__(self, name: str):
        self._name = name
        self._bar: Any = None
        self._terminal = sys.stderr.isatty()
        self._total, self._done, self._start, self._before = 1.0, 0.0, monotonic(), 0.0

    def begin(self, total: float, done: float) -> None:
        """So much is to be done in all, in any unit, and so much of it was done before."""
        self._total, self._done, self._before, self._start = max(total, 1e-9), done, done, monotonic()
        if done > 0.0:
            self._say(f"{done / self._total:.0%} was done before")

    def stage(self, name: str) -> None:
        """Something else begins."""
        if not self._terminal:
            self._say(name)
        elif self._bar is not None:
            self._bar.set_postfix_str(name)

    def add(self, cost: float, label: str) -> None:
        """So much more is done."""
        self._done += cost
        if not self._terminal:
            passed, here = monotonic() - self._start, self._done - self._before
            left = passed * max(self._total - self._done, 0.0) / here
            self._say(f"{self._done / self._total:.0%}, {_duration(left)} left: {label}")
            return
        if self._bar is None:
            from tqdm import tqdm

            form = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"
            self._bar = tqdm(total=self._total, initial=self._before, desc=self._name, file=sys.stderr, bar_format=form)
        self._bar.update(cost)
        self._bar.set_postfix_str(label)

    def close(self) -> None:
        """Nothing more comes."""
        if self._bar is not None:
            self._bar.close()

    def _say(self, line: str) -> None:
        print(f"{self._name}: {line}", flush=True)


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"


class RunProgress:
    """Of Monte-Carlo runs, with their rate and the time left. The first call says how many were done before."""

    def __init__(self, name: str):
        self._name = name
        self._bar: Any = None
        self._terminal = sys.stderr.isatty()
        self._start: tuple[float, int] | None = None
        self._said = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, done: int, total: int) -> None:
        """So many runs are done."""
        now = monotonic()
        if self._start is None:
            self._start = now, done
            if self._terminal:
                from tqdm import tqdm

                self._bar = tqdm(total=total, initial=done, unit="run", desc=self._name, file=sys.stderr)
            else:
                print(f"{self._name}: {done}/{total} runs", flush=True)
                self._said = now
        elif self._bar is not None:
            self._bar.update(done - self._bar.n)
        elif done == total or now - self._said >= EVERY_S:
            rate = (done - self._start[1]) / max(now - self._start[0], 1e-9)
            left = (total - done) / rate if rate else float("inf")
            print(f"{self._name}: {done}/{total} runs, {rate:.0f} a second, {left:.0f} s left", flush=True)
            self._said = now
