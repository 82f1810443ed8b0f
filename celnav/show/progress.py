"""How far a command is: a bar on a terminal, plain lines otherwise."""

from __future__ import annotations

import sys
from time import monotonic
from typing import Any, Self, cast

__all__ = ["Progress", "RunProgress"]

EVERY_S = 5.0
"""Between plain lines about runs."""


class Progress:
    """Of work of known cost in any unit, ``total`` in all, ``done`` of it before: the share, the time left, and what is done."""

    def __init__(self, name: str, total: float, done: float = 0.0):
        self._name, self._total, self._done, self._before = name, max(total, 1e-9), done, done
        self._start, self._bar = monotonic(), cast(Any, None)
        if sys.stderr.isatty():
            from tqdm import tqdm

            form = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"
            self._bar = tqdm(
                total=self._total,
                initial=done,
                desc=name,
                file=sys.stderr,
                bar_format=form,
                smoothing=0.0,
            )
        elif done > 0.0:
            print(f"{name}: {done / self._total:.0%} was done before", flush=True)

    def add(self, cost: float, label: str = "") -> None:
        """So much more is done; ``label``: what it was, or what begins now."""
        self._done += cost
        here, left = self._done - self._before, max(self._total - self._done, 0.0)
        if self._bar is not None:
            self._bar.update(cost)
            self._bar.set_postfix_str(label or self._bar.postfix)
        elif label:
            time = f", {_duration((monotonic() - self._start) * left / here)} left" if here else ""
            print(f"{self._name}: {self._done / self._total:.0%}{time}: {label}", flush=True)

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

                self._bar = tqdm(
                    total=total, initial=done, unit="run", desc=self._name, file=sys.stderr
                )
            else:
                print(f"{self._name}: {done}/{total} runs", flush=True)
                self._said = now
        elif self._bar is not None:
            self._bar.update(done - self._bar.n)
        elif done == total or now - self._said >= EVERY_S:
            rate = (done - self._start[1]) / max(now - self._start[0], 1e-9)
            left = (total - done) / rate if rate else float("inf")
            print(
                f"{self._name}: {done}/{total} runs, {rate:.0f} a second, {left:.0f} s left",
                flush=True,
            )
            self._said = now
