"""What the paper prints or says where it is wrong: the list, and as code what is needed to show it.

Numbers 4 to 7 are about equations that are lost: they hold for what the prose says of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.models.ephemeris import de421
from celnav.models.pulsar import Timing
from celnav.papers.tstdkf.config import YEAR_S, Config

ERRATA = (
    (
        "from DE405 to DE421 the Earth moves by tens of kilometers (text on Fig. 2)",
        "by 0.18 to 1.74 km; a time tag that is wrong by 1 s makes 30 km",
    ),
    (
        "Shapiro delay with ln|(n.r + |r|) / (n.b + |b|) + 1|",
        "ln((n.p + |p|) / (n.b + |b|)), p = r + b; the printed form is off by up to 8 km near the Sun",
    ),
    (
        "D from the pulsar to the barycenter, with terms of b",
        "with these terms D counts from the Sun; without them from the barycenter",
    ),
    (
        "Z' = z - F V with the last noise as estimated is h(x) + xi",
        "it has the error of the last estimate in it; the filter says less than the least possible covariance",
    ),
    (
        "bias observation matrix Gamma after differencing",
        "Gamma' = Gamma - F (Gamma + H Lambda), and -Omega Gamma' in the prediction",
    ),
    ("the last noise is known in Z' and unknown in W'", "if it is known its mean G J F V belongs in the prediction too"),
    (
        "the residual of pulsar i boosts axis i of the bias",
        "pulsars are far from the axes; a factor of S^-1 C S^-T would be consistent",
    ),
    ("third bodies as AR(1) noise", "they are two groups of lines, and follow from the ephemeris that the filter has"),
    ("EKF and TKF with the covariances of the driving noise", "P_V and P_Q + J P_V J', with which most of the gain is gone"),
    ("0.02 m/s beside 1 km of initial error", "an orbit that is off by 1 km is off by about 1 m/s"),
)
"""What is printed and what is right, in the order of their numbers (from 1)."""


class Conjunctions(NamedTuple):
    """Of each pulsar over the year: least angle from the Sun (deg), largest error (km) of the printed Shapiro term."""

    angle: Array
    error: Array


def _year(config: Config) -> tuple[Array, Array]:
    """Earth and Sun ``(T, 3)`` every three hours of a year."""
    dates = config.start.after(np.arange(0.0, YEAR_S, 10800.0))
    earth, sun = (de421().state(body, dates).position for body in ("earth", "sun"))
    return earth, sun


def conjunctions(config: Config) -> Conjunctions:
    """How far the printed Shapiro term is off, at the Earth."""
    timing: Timing = config.timing
    earth, sun = _year(config)
    apart = timing.shapiro(earth, sun) - timing.shapiro_exact(earth, sun)
    away = (sun - earth) / np.linalg.norm(sun - earth, axis=1, keepdims=True)
    return Conjunctions(np.degrees(np.arccos(away @ timing.directions.T)).min(0), np.abs(apart).max(0))


class Parallax(NamedTuple):
    """Largest error (km) of delay without its Shapiro term against exact geometry, and largest part of the terms of b."""

    error: float
    terms: float


def parallax(config: Config) -> Parallax:
    """The delay with distances from the Sun, against the difference of two distances."""
    timing: Timing = config.timing
    earth, sun = _year(config)
    b, D, n = -sun, timing.distances, timing.directions
    p = earth + b
    # |Dn - b| - |Dn - p| without the difference of two kiloparsecs.
    squares = np.square(b).sum(1) - np.square(p).sum(1)
    near, far = (np.linalg.norm(D[:, None] * n - at[:, None], axis=2) for at in (p, b))
    geometry = (squares[:, None] + 2.0 * D * (earth @ n.T)) / (near + far)
    ours = timing.delay(earth, sun) - timing.shapiro(earth, sun)
    terms = ((b @ n.T) * (earth @ n.T) - (b * earth).sum(1)[:, None]) / D
    return Parallax(float(np.abs(ours - geometry).max()), float(np.abs(terms).max()))
