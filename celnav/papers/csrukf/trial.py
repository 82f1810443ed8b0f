"""The satellite as missions and campaigns see it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from celnav.gaussian.linalg import Array, Belief
from celnav.papers.csrukf.config import Config
from celnav.papers.csrukf.scenario import filters, simulate
from celnav.study.trial import Group, Trial

GROUPS = (Group("position", "km", slice(0, 3)), Group("velocity", "m/s", slice(3, 6), 1e3))
JUDGED = {group.name: group.unit for group in GROUPS}
EXACT = {"positions": "csrukf+z0", "angles": "angles+z0"}


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """One run with each generator."""
    sim, known = simulate(config, rngs), filters(config)
    return Trial(GROUPS, known, sim.prior, sim.epochs_of, _compare, EXACT[config.measured], lambda x: x[..., :3])


def _compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
    return belief.mean[..., :6] - truth, belief.sqrt_cov[..., :6, :6]
