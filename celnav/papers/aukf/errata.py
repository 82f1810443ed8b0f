"""What the paper prints or says where it is wrong: the list, and as code what is needed to show it."""

from __future__ import annotations

import numpy as np
from scipy.special import gammainc

from celnav.filters.joint import condition, joint
from celnav.filters.records import Epoch, Filter, FromFunctions, Info, State
from celnav.gaussian.belief import symmetric
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.models import pseudorange
from celnav.papers.aukf.config import Config
from celnav.papers.aukf.scenario import adapted

ERRATA = (
    ('"adaptive fading"', "fading inflates the prediction; this inflates the noise of the measurement"),
    ("A = I when the noise is normal", "clipped at 1 it is 1 + S / R / sqrt(pi M) on average"),
    ("the UKF is better than the EKF", "they are the same to a micrometer; it takes an initial error of 10 km to tell them apart"),
    (
        "it weakens the effect of errors of the system noise",
        "it takes a maneuver for noise, and diverges where the process noise is small",
    ),
    ("faster convergence", "large innovations at the start inflate A: from 1000 km it is slower"),
    ("measurement points without drawing anew", "the gain then knows nothing of the process noise"),
    ("without extra computation", "17 evaluations of the measurement; the prediction is linear and needs none"),
    ("standard deviation 50", "has no unit and no channel: on ranges alone the rates carry the filter, on both nothing does"),
    ("geostationary satellites: the others' formula, rotated", "R_z(w t) R_x(-5 deg) P, and the node without the Earth's rate"),
    (
        "orbits of no inclination are unsolvable",
        "a receiver solves by them as by others; the fit of the node is ill-conditioned",
    ),
)
"""What is printed and what is right, in the order of their numbers (from 1)."""


def clipped_mean(M: int) -> float:
    """By how much a clipped mean of M squares of unit normals exceeds 1: ``E max(1, chi2_M / M) - 1``."""
    return float(gammainc(0.5 * M, 0.5 * M) - gammainc(0.5 * M + 1.0, 0.5 * M))


def without_redraw(config: Config, S: int, rule: Rule) -> Filter:
    """The UKF whose measurement uses the points of the prediction, which have no process noise in them."""
    ordinary = adapted(config, S, rule)
    sqrt_Q, noise = symmetric(config.Q, "Q")[1], np.diag(config.sigma(S))

    def step(state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        if not epoch.dt:
            return ordinary.step(state, epoch)

        def g(points: Array, epoch: Epoch) -> tuple[Array, Array]:
            moved = points @ config.F.T
            return pseudorange.measure(moved, *epoch.u), moved

        both = joint(rule, state.belief, g, epoch, z=np.asarray(epoch.z), process_noise=sqrt_Q, measurement_noise=noise)
        posterior, info, _ = condition(type(state.belief), both, EUCLIDEAN)
        return State(posterior, state.memory), (info,)

    return FromFunctions(ordinary.start, step)
