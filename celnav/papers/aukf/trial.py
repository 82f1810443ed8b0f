"""The receiver as missions and campaigns see it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from celnav.gaussian.linalg import Array, Belief
from celnav.papers.aukf.config import Config
from celnav.papers.aukf.scenario import filters, simulate
from celnav.study.trial import Group, Trial

GROUPS = (Group("position", "m", slice(0, 3)), Group("velocity", "m/s", slice(3, 6)))
JUDGED = {group.name: group.unit for group in GROUPS}


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """One run with each generator. There is no bound: the turns of the track are not drawn from the filters' model."""
    sim = simulate(config, rngs)
    return Trial(GROUPS, filters(config), sim.prior, lambda _name: sim.epochs(), _compare)


def _compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
    return belief.mean - truth, belief.sqrt_cov
