"""The common workload: a low orbit with J2, steps of 1 s, measured positions. Units: km, km/s, s."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.models import orbit

SIGMA = 0.2
SQRT_Q = np.diag([7.5e-3] * 3 + [1e-8] * 3)
P0 = np.diag([0.15**2] * 3 + [3.5e-5**2] * 3)
X0 = orbit.from_elements(7136.635, 0.001, *np.radians([65.0, 30.0, 30.0, 0.0]))
R = SIGMA**2 * np.eye(3)
H = np.eye(3, 6)
BLOCK = 512
"""Runs that a batched engine takes at once."""
RUN_STEPS = 250_000
"""A batch of many runs takes fewer steps, so that a round stays short: the cost of a run-step does not depend on them."""


class Workload:
    """Measurements ``z (steps + 1, runs, 3)`` of simulated orbits; every filter starts from the same prior.

    The first sample updates the prior; ``steps`` predictions, each with its update, follow.
    """

    def __init__(self, steps: int, runs: int, seed: int = 0):
        rng = np.random.default_rng(seed)
        self.steps = steps
        self.z = np.empty((steps + 1, runs, 3))
        x = X0 + rng.standard_normal((runs, 6)) @ np.sqrt(P0)
        for k in range(steps + 1):
            if k:
                x = orbit.step(x, 1.0) + rng.standard_normal((runs, 6)) @ SQRT_Q
            self.z[k] = x[:, :3] + SIGMA * rng.standard_normal((runs, 3))

    def steps_of(self, runs: int) -> int:
        """Steps that a batch of ``runs`` takes."""
        return min(self.steps, max(20, RUN_STEPS // runs))

    def measurements(self, runs: int) -> Array:
        """``(steps_of(runs) + 1, runs, 3)``."""
        return self.z[: self.steps_of(runs) + 1, :runs]
