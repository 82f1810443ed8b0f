"""How far a command is: a bar on a terminal, plain lines otherwise."""

from __future__ import annotations

import sys
from time import monotonic
from typing import Any, Self

EVERY_S = 5.0
"""Between plain lines about runs."""


class Progress:
    """Of units of work, and of what is made of them meanwhile."""

    def __init__(self, name: str):
        self._name = name
        self._bar: Any = None
        self._terminal = sys.stderr.isatty()

    def stage(self, name: str) -> None:
        """Something else begins."""
        if not self._terminal:
            print(f"{self._name}: {name}", flush=True)
        elif self._bar is not None:
            self._bar.set_postfix_str(name)

    def __call__(self, done: int, total: int, label: str) -> None:
        """So many units are done."""
        if not self._terminal:
            print(f"{self._name}: {done}/{total} {label}", flush=True)
            return
        if self._bar is None:
            from tqdm import tqdm

            self._bar = tqdm(total=total, desc=self._name, file=sys.stderr)
        self._bar.update(done - self._bar.n)
        self._bar.set_postfix_str(label)

    def close(self) -> None:
        """Nothing more comes."""
        if self._bar is not None:
            self._bar.close()


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
