"""The flight as missions and campaigns see it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from celnav.gaussian import Gaussian
from celnav.linalg import Array
from celnav.papers.aasghqf.config import MICRO_G, Config
from celnav.papers.aasghqf.scenario import filters, simulate
from celnav.trial import Group, Trial


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """One run with each generator."""
    sim, known = simulate(config, rngs), filters(config)
    arcmin = float(np.degrees(1.0)) * 60.0
    east, north = config.meters.tolist()
    groups = (
        Group("misalignment", "arcmin", slice(0, 3), arcmin),
        Group("velocity", "m/s", slice(3, 5)),
        Group("position", "m", slice(5, 7), (east, north)),
        Group("drift", "deg/h", slice(7, 10), 60.0 * arcmin),
        Group("bias", "ug", slice(10, 13), 1.0 / MICRO_G),
    )
    return Trial(groups, known, sim.prior, lambda _name: sim.epochs(), _compare, "ekf")


def _compare(truth: Array, belief: Gaussian) -> tuple[Array, Array]:
    return belief.mean - truth, belief.root
