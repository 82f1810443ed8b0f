"""The flight as missions and campaigns see it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from celnav.gaussian.linalg import Array, Belief
from celnav.papers.aasghqf.config import MICRO_G, Config
from celnav.papers.aasghqf.scenario import filters, simulate
from celnav.study.trial import Group, Trial

JUDGED = {"misalignment": "arcmin", "velocity": "m/s", "position": "m", "drift": "deg/h", "bias": "ug"}


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """One run with each generator."""
    sim, known = simulate(config, rngs), filters(config)
    arcmin = float(np.degrees(1.0)) * 60.0
    east, north = config.meters.tolist()
    parts = (slice(0, 3), slice(3, 5), slice(5, 7), slice(7, 10), slice(10, 13))
    scales: tuple[float | tuple[float, float], ...] = (arcmin, 1.0, (east, north), 60.0 * arcmin, 1.0 / MICRO_G)
    groups = tuple(Group(*each) for each in zip(JUDGED, JUDGED.values(), parts, scales, strict=True))
    return Trial(groups, known, sim.prior, lambda _name: sim.epochs(), _compare, "ekf")


def _compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
    return belief.mean - truth, belief.sqrt_cov
