"""How the claims of this study read its result."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from celnav.claims import Bounds, Claim, Judge
from celnav.linalg import Array
from celnav.papers.tstdkf.study import Result

AXES = ("x", "y", "z")


class Evidence(Judge):
    """A `Judge` with the result at hand."""

    def __init__(self, result: Result):
        super().__init__(result.full)
        self.result = result

    def squares(self, filter: str, what: str = "position", setting: int = 1, *, half: bool = False) -> Array:
        """Mean square errors of each run ``(runs,)`` over the whole time, or its second half: km^2, (km/s)^2."""
        return self.of("table 5", f"{setting}/{filter}/{what}", half=half)

    def of(self, study: str, key: str, *, half: bool = False) -> Array:
        """The same of another study."""
        values = self.result.data[study][key]
        return np.asarray(values[len(values) // 2 if half else 0 :].mean(0))

    def lengthy(self, *arguments: Any, **named: Any) -> Claim:
        """A `Judge.statistic` that depends on how long the runs are: undecided where they are shortened."""
        return self.whole(self.statistic(*arguments, **named))

    def whole(self, claim: Claim) -> Claim:
        """The claim, undecided unless runs have their whole length."""
        return claim if self.full else replace(claim, ci=(-np.inf, np.inf))


def about(value: float, part: float) -> Bounds:
    """A value within a part of itself."""
    return value - abs(value) * part, value + abs(value) * part


def within(value: float, size: float) -> Bounds:
    """A value within a size."""
    return value - size, value + size


def order(value: float) -> float:
    """The power of ten at or above a size of which only that means anything: the digits of round-off differ between machines."""
    return 10.0 ** float(np.ceil(np.log10(value))) if value > 0.0 else 0.0


def rms(squares: Array) -> float:
    """Root of the mean over everything."""
    return float(np.sqrt(squares.mean()))


def ratio(a: Array, b: Array) -> float:
    """Ratio of two such."""
    return rms(a) / rms(b)


def below(a: Array, b: Array) -> float:
    """By how many percent the first is below the second."""
    return 100.0 * (1.0 - ratio(a, b))


def above(a: Array, b: Array) -> float:
    """By how many percent the first is above the second."""
    return -below(a, b)
