"""The satellite as missions and campaigns see it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from celnav.filters.colored import augmented, colored
from celnav.filters.driver import Epoch, Filter
from celnav.gaussian import Gaussian
from celnav.linalg import Array
from celnav.models.noise import initial_covariance
from celnav.papers.csrukf.config import Config
from celnav.papers.csrukf.scenario import H, angle_model, dynamics, filters, simulate
from celnav.points import unscented
from celnav.trial import REFERENCE, Group, Trial

GROUPS = (Group("position", "km", slice(0, 3)), Group("velocity", "m/s", slice(3, 6), 1e3))


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """One run with each generator."""
    sim = simulate(config, rngs)

    def epochs(name: str) -> Iterable[Epoch]:
        if name != REFERENCE:
            return sim.epochs_of(name)
        return sim.epochs() if sim.angles is None else sim.angle_epochs()

    return Trial(GROUPS, filters(config), sim.prior, epochs, _compare, reference(config), lambda x: x[..., :3])


def reference(config: Config) -> Filter:
    """The exact filter: it knows the color of the noise and uses the first sample."""
    f, Q = dynamics(config), config.sqrt_Q
    if config.measured == "positions":
        return augmented(f, H, unscented(9), config.Phi, Q=Q @ Q.T, R=config.R, Sigma0=config.Sigma0)
    R = np.diag(config.sigma_angles**2)
    Sigma0 = initial_covariance(config.first_noise, config.Phi, R)
    return colored(f, angle_model(config), unscented(12), config.Phi, sqrt_Q=Q, R=R, Sigma0=Sigma0, first_rule=config.rule)


def _compare(truth: Array, belief: Gaussian) -> tuple[Array, Array]:
    return belief.mean[..., :6] - truth, belief.root[..., :6, :6]
