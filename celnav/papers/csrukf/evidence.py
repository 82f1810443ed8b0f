"""How the claims of this study read its result."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.papers.csrukf.study import Result
from celnav.study.claims import Judge


class Evidence(Judge):
    """A `Judge` with the result at hand."""

    def __init__(self, result: Result):
        super().__init__(result.full)
        self.result = result

    def get(self, study: str, name: str) -> Array:
        """Any array of the result."""
        return self.result.data[study][name]

    def final(self, study: str, name: str) -> Array:
        """Errors at the end, ``(runs, 6)`` km, m/s."""
        return np.asarray(self.get(study, f"{name}/error")[-1])

    def mean_nees(self, study: str, name: str) -> Array:
        """NEES of each run, averaged over time, ``(runs,)``."""
        return np.asarray(self.get(study, f"{name}/nees")[1:].mean(0))


def rms3(error: Array) -> float:
    """3-D RMSE of ``(runs, 3)``."""
    return float(np.sqrt(np.square(error).sum(-1).mean()))


def ratio3(a: Array, b: Array) -> float:
    """Ratio of two 3-D RMSE."""
    return rms3(a) / rms3(b)
