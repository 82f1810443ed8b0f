"""How the claims of this study read its result."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.papers.ssukf.study import SHORT, Result
from celnav.study.claims import Judge

AXES = ("roll", "pitch", "yaw")
ATTITUDE, DRIFT = slice(0, 3), slice(3, 6)


class Evidence(Judge):
    """A `Judge` with the result at hand."""

    def __init__(self, result: Result):
        super().__init__(result.full)
        self.result = result
        self.times = result.times

    def squares(self, filter: str, part: slice | int, *, kind: str = "paper", first: float = 0.0, last: float = np.inf) -> Array:
        """Squared errors from ``first`` to ``last`` seconds, the mean over components: ``(runs, T)``, arcsec^2 or (deg/h)^2."""
        chosen = slice(part, part + 1) if isinstance(part, int) else part
        shown = (self.times >= first) & (self.times <= last)
        return np.asarray(np.square(self.result.data[kind][f"{filter}/error"][shown][..., chosen]).mean(-1).T)

    def worst(self, study: str, name: str) -> tuple[float, float]:
        """Largest differences of a check over its runs: arcsec and deg/h."""
        attitude, drift = self.result.data[study][name].max(1).tolist()
        return attitude, drift

    def seconds(self, study: str) -> float:
        """Length of a smaller study."""
        return min(SHORT[study][0], self.result.config.duration_s)

    def settles(self, squares: Array, level: float) -> float:
        """Time (s) at which the RMSE over the runs of squares ``(runs, T)`` is first below a level; the end if it never is."""
        below = np.flatnonzero(np.sqrt(squares.mean(0)) < level)
        return float(self.times[below[0] if below.size else squares.shape[1] - 1])
