"""The nominal orbit, linearized: models of errors about it, with which the paper's filters share one covariance among all runs.

How far they are from filters of the states themselves is a claim of the study. Covariances need no data at all:
`celnav.papers.tstdkf.analysis` follows them along the orbit.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from celnav.filters.records import Epoch
from celnav.gaussian.linalg import Array, matvec
from celnav.models.orbit import Flow, flow
from celnav.papers.tstdkf.config import Config
from celnav.papers.tstdkf.estimators import Models
from celnav.papers.tstdkf.scenario import nominal_orbit, sky


class Step(NamedTuple):
    """A step of the nominal orbit: ``Phi, G (6, 6)`` as of a `Flow`, and the timings' slope ``Gamma (3, 3)`` after it."""

    Phi: Array
    G: Array
    Gamma: Array


def epochs(config: Config, chunk: int = 4096) -> Iterator[Epoch]:
    """Epochs of the nominal orbit, ``u`` the `Step` that leads there, linearized some at a time; nothing is measured yet."""
    orbit, seen, dt = nominal_orbit(config), sky(config), config.step_s
    for first in range(0, config.steps, chunk):
        part = slice(first, first + chunk + 1)
        x = orbit[part]
        _, Phi, G = flow(x[:-1], dt)
        Gamma = config.timing.gradient(seen.earth[part] + x[:, :3], seen.sun[part])[1:]
        for k, step in enumerate(map(Step, Phi, G, Gamma), start=first + 1):
            yield Epoch(k, k * dt, dt, step)


LINEAR = Models(
    lambda error, epoch: Flow(matvec(epoch.u.Phi, error[..., :6]), epoch.u.Phi, epoch.u.G),
    lambda error, epoch: matvec(epoch.u.Gamma, error[..., :3]),
    lambda _, epoch: epoch.u.Gamma,
    linear=True,
)
"""Models of errors, for epochs whose ``u`` is a `Step`."""
