"""How claims, tables and figures read the result."""

from __future__ import annotations

from typing import Any

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.papers.aukf.real import Real
from celnav.papers.aukf.study import Result
from celnav.papers.aukf.sweeps import FROM_A_FIX, SMALL_ALPHA
from celnav.study.claims import Bounds, Claim, Judge

AXES = ("X", "Y", "Z")
LABELS = {
    "ls": "LS", "ekf": "EKF", "ukf": "UKF", "aukf": "AUKF", "group": "group parity", "channel": "channel parity", "gate": "gate",
    "huber": "Huber", "student": "Student", "sage-husa": "Sage–Husa", "no redraw": "UKF, no redraw",
    SMALL_ALPHA: "UKF, α = 0.001", FROM_A_FIX: "EKF from a fix",
}  # fmt: skip
COMPARED = ("ls", "ekf", "ukf", "aukf", "group", "channel", "sage-husa", "student", "huber", "gate")


class Evidence(Judge):
    """A `Judge` with the result at hand."""

    def __init__(self, result: Result):
        super().__init__(result.full)
        self.result = result

    def pair(self, study: str, case: str, filters: tuple[str, str], window: str, **chosen: Any) -> list[Array]:
        """Mean squares ``(runs,)`` of two filters on the same runs."""
        return [self.result.squares(study, f"{case}/{filter}", window, **chosen) for filter in filters]

    def absent(self, id: str, statement: str, accept: Bounds) -> Claim:
        """A claim on the receiver's day where that is absent."""
        return Claim(id, "beyond", statement, None, accept, True, full=self.full, note="needs --rinex DIR")


def size(error: Array) -> Array:
    """Sizes ``(...)`` of position errors ``(..., 8)``."""
    return np.asarray(np.sqrt(np.square(error[..., :3]).sum(-1)))


def real_rms(real: Real, means: Array, *, burst: bool = False) -> float:
    """Root mean square distance (m) from the header's position, of all epochs or those of the burst."""
    chosen = real.during if burst else np.ones(len(means), bool)
    return float(np.sqrt(np.nanmean(np.square(means[chosen, :3] - real.reference).sum(-1))))
