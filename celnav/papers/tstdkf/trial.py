"""The pulsars' satellite as missions and campaigns see it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from celnav.gaussian.linalg import Array, Belief, cholesky
from celnav.papers.tstdkf.config import Config
from celnav.papers.tstdkf.estimators import filters
from celnav.papers.tstdkf.scenario import simulate
from celnav.study.trial import Group, Trial

GROUPS = (Group("position", "km", slice(0, 3)), Group("velocity", "m/s", slice(3, 6), 1e3))
JUDGED = {group.name: group.unit for group in GROUPS}


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """One run with each generator. The orbit is judged, which all filters estimate.

    There is a bound where what is simulated is what the exact filter believes: initial errors and a constant ephemeris error that
    are drawn from their priors.
    """
    sim, known = simulate(config, rngs), filters(config)
    believed = config.initial == "drawn" and config.trend == "constant"
    return Trial(GROUPS, known, sim.prior, lambda _name: sim.epochs(), _compare, "aug" if believed else "", lambda x: x[..., :3])


def _compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
    return belief.mean[..., :6] - truth[..., :6], cholesky(belief.cov[..., :6, :6])
