"""Filters on simulated runs, and what is kept of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.joint import Hook, Joint
from celnav.filters.records import Epoch, Filter, Info
from celnav.filters.run import run
from celnav.gaussian.belief import nees
from celnav.gaussian.linalg import Array, cholesky
from celnav.papers.aukf.scenario import Scenario, side_by_side

Found = dict[str, Array]
"""``<filter>/<what>`` -> ``(T, runs, ...)``."""


def watched(hook: Hook) -> Hook:
    """The hook, with what it multiplies the variances of the noise by, ``(..., m)``, beside its memory."""

    def watching(memory: Any, joint: Joint, epoch: Any) -> tuple[Any, Joint]:
        own, after = hook(None if memory is None else memory[0], joint, epoch)
        (_, before), (_, now) = joint.variances(), after.variances()
        return (own, np.broadcast_to(now / before, np.broadcast_shapes(now.shape, np.asarray(joint.innovation).shape))), after

    return watching


class Kept(NamedTuple):
    """What is kept of which filters, by name, besides the errors.

    Attributes
    ----------
    nis: ``(T, runs)``. nees: ``(T, runs)``. cov: ``(T, 1, 8, 8)`` of the first run. factor: ``(T, runs, 2 S)``, of filters whose
        first hook is `watched`.
    """

    nis: Sequence[str] = ()
    nees: Sequence[str] = ()
    cov: Sequence[str] = ()
    factor: Sequence[str] = ()


def follow(filters: dict[str, Filter], sim: Scenario, kept: Kept = Kept()) -> Found:
    """Run filters by name: ``<filter>/error (T, runs, 8)`` and what is `Kept`; a filter that loses a run keeps it as nan."""
    return _follow(filters, sim, kept, len(sim.prior.mean))


def follow_cases(filters: dict[str, Filter], cases: dict[str, Scenario], kept: Kept = Kept()) -> Found:
    """`follow` of several scenarios at once, which have as many runs each: ``<case>/<filter>/<what>``."""
    sims = list(cases.values())
    found = _follow(filters, side_by_side(sims), kept, len(sims[0].prior.mean))
    parts = {key: np.split(values, len(sims), 1) for key, values in found.items()}
    return {f"{case}/{key}": part[i] for i, case in enumerate(cases) for key, part in parts.items()}


def _follow(filters: dict[str, Filter], sim: Scenario, kept: Kept, runs: int) -> Found:
    """Covariances are kept of the first of each ``runs``."""
    out: Found = {}
    for name, filter in filters.items():

        def also(epoch: Epoch, state: Any, infos: tuple[Info, ...], name: str = name) -> dict[str, Array]:
            belief = state.belief
            found = {"error": belief.mean - epoch.truth}
            if name in kept.nis:
                found["nis"] = np.square(np.asarray(infos[0].whitened)).sum(-1)
            if name in kept.nees:
                found["nees"] = nees(found["error"], cholesky(belief.cov))
            if name in kept.cov:
                found["cov"] = belief.cov[::runs]
            if name in kept.factor:
                found["factor"] = state.memory[0][0][1]
            return found

        track = run(filter, sim.prior, sim.epochs(), keep="nothing", also=also, on_failure="flag")
        out |= {f"{name}/{what}": values for what, values in track.extra.items()}
    return out
