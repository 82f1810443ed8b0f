"""How the claims of this study read its result."""

from __future__ import annotations

import numpy as np

from celnav.analysis.metrics import ratio
from celnav.gaussian.linalg import Array
from celnav.papers.tstdkf.study import Result
from celnav.study.claims import Judge

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


def below(a: Array, b: Array) -> float:
    """By how many percent the first is below the second."""
    return 100.0 * (1.0 - ratio(a, b))


def above(a: Array, b: Array) -> float:
    """By how many percent the first is above the second."""
    return -below(a, b)
