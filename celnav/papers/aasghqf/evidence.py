"""How the claims of this study read its result."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.papers.aasghqf.study import Result
from celnav.study.claims import Judge

PHI, VELOCITY, POSITION = slice(0, 3), slice(3, 5), slice(5, 7)


class Evidence(Judge):
    """A `Judge` with the result at hand."""

    def __init__(self, result: Result):
        super().__init__(result.full)
        self.result = result

    def squares(self, preset: str, filter: str, part: slice | int) -> Array:
        """Squared errors, run axis first: ``(runs, T, k)``."""
        chosen = slice(part, part + 1) if isinstance(part, int) else part
        return np.asarray(np.square(self.result.data[preset][f"{filter}/error"][..., chosen]).swapaxes(0, 1))

    def pair(self, preset: str, a: str, b: str, part: slice | int) -> list[Array]:
        """`squares` of two filters."""
        return [self.squares(preset, filter, part) for filter in (a, b)]

    def anees(self, preset: str, filter: str, at: slice | int) -> Array:
        """NEES over 13 of each run, averaged over epochs, ``(runs,)``."""
        nees = self.result.data[preset][f"{filter}/nees"][at] / 13.0
        return np.asarray(nees if nees.ndim == 1 else nees.mean(0))


def time_mean(squares: Array) -> float:
    """Table 3's statistic: RMSE over the runs at each epoch, mean over the epochs; summed over the components."""
    return float(np.sqrt(squares.mean(0)).mean(0).sum())


def ratio(a: Array, b: Array) -> float:
    """Ratio of two such."""
    return time_mean(a) / time_mean(b)


def median_ratio(a: Array, b: Array) -> float:
    """Ratio of the medians over the runs of the error's r.m.s. over time."""
    one, two = (np.median(np.sqrt(s.sum(-1).mean(1))) for s in (a, b))
    return float(one / two)
