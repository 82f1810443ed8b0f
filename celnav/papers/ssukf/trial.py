"""The satellite's attitude as missions and campaigns see it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from celnav.gaussian.linalg import Array, Belief
from celnav.papers.ssukf.config import ARCSEC, DEG_PER_H, Config
from celnav.papers.ssukf.scenario import errors, filters, simulate
from celnav.study.trial import Group, Trial

GROUPS = (Group("attitude", "arcsec", slice(0, 3), 1.0 / ARCSEC), Group("drift", "deg/h", slice(3, 6), 1.0 / DEG_PER_H))
JUDGED = {group.name: group.unit for group in GROUPS}


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """One run with each generator; the initial errors are drawn from the prior."""
    sim, known = simulate(config, rngs), filters(config)
    return Trial(GROUPS, known, sim.drawn, lambda _name: sim.epochs(), _compare, "mekf")


def _compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
    return errors(truth, belief.mean), belief.sqrt_cov
