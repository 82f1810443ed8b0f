"""Filters on simulated runs, and what is kept of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.driver import Epoch, Filter, run
from celnav.gaussian import nees
from celnav.linalg import Array, cholesky, matvec
from celnav.papers.tstdkf.config import Config
from celnav.papers.tstdkf.estimators import boosted, filters
from celnav.papers.tstdkf.scenario import Scenario

Found = dict[str, Array]
"""``<case>/<filter>/<what>`` -> ``(K, runs, ...)``; cases count from 0."""


class View(NamedTuple):
    """What a filter says: orbit and bias ``mean (runs, 6 or 9)``, and the covariance of that."""

    label: str
    mean: Array
    cov: Callable[[], Array]


def views(name: str, state: Any) -> Iterator[View]:
    """The filters that are inside of a filter's state: EKF is the first stage of TKF, TDKF lies beside TSTDKF."""
    if name == "aug":
        chosen = np.r_[0:6, 15:18]
        yield View("aug", state.belief.mean[..., chosen], lambda: state.belief.cov[..., chosen[:, None], chosen])
        return
    free, own = state.first.belief, state.bias
    if name != "tstdkf":
        yield View(name.replace("tkf", "ekf"), free.mean, lambda: free.cov)
    labels = ("tdkf", "tstdkf") if name == "tstdkf" else (name,)
    means = own.mean if name == "tstdkf" else own.mean[None]
    for label, bias in zip(labels, means, strict=True):
        mean = np.concatenate([free.mean + matvec(state.Lambda, bias), bias], -1)
        yield View(label, mean, lambda: state.belief.cov)


def follow(
    name: str,
    sim: Scenario,
    *,
    believed: Sequence[Config] = (),
    filter: Filter | None = None,
    showcase: bool = False,
    consistency: Sequence[str] = (),
) -> Found:
    """Run a filter of `celnav.papers.tstdkf.estimators.filters` over all cases.

    Parameters
    ----------
    name: "tkf", "tkf-fair" (these give "ekf", "ekf-fair" too), "tstdkf" (gives "tdkf" too) or "aug".
    believed: the cases as the filter takes them, if not as they are. filter: a variant, run in place of that name.
    showcase: whether ``mean (9)``, ``cov (9, 9)``, ``nis``, ``residual (3)`` with ``residual std``, and ``lambda (3)`` are kept of
        the first run of the first case.
    consistency: the filters whose ``nees`` is kept (of orbit and bias for aug, of the orbit for the others), and ``nis``.

    Returns
    -------
    Squared errors ``position``, ``velocity`` (km^2, km^2/s^2) and, where it is estimated, ``bias`` (km^2), and what is asked for.
    """
    cases = tuple(believed) or sim.cases
    if filter is None:
        filter = boosted(cases, sim.runs, also_plain=True) if name == "tstdkf" else filters(cases, sim.runs)[name]

    def also(epoch: Epoch, state: Any, info: Any) -> dict[str, Array]:
        out: dict[str, Array] = {}
        for view in views(name, state):
            error = view.mean - epoch.truth[..., : view.mean.shape[-1]]
            squares = error * error
            parts = {"position": slice(3), "velocity": slice(3, 6), "bias": slice(6, 9)}
            for what in list(parts)[: error.shape[-1] // 3]:
                out[f"{view.label}/{what}"] = squares[..., parts[what]].sum(-1)
            if view.label in consistency:
                n = error.shape[-1] if name == "aug" else 6
                out[f"{view.label}/nees"] = nees(error[..., :n], cholesky(view.cov()[..., :n, :n]))
                out[f"{view.label}/nis"] = np.square(info.white).sum(-1)
            if showcase:
                out[f"{view.label}/mean"], out[f"{view.label}/cov"] = view.mean[:1], view.cov()[:1]
        if showcase:
            out |= _inside(name, state, info)
        return out

    found: Found = {}
    for key, values in run(filter, sim.prior, sim.epochs(), keep="nothing", also=also).extra.items():
        if values.shape[1] == sim.runs * len(sim.cases):
            found |= {f"{i}/{key}": values[:, i * sim.runs : (i + 1) * sim.runs] for i in range(len(sim.cases))}
        else:
            found[f"0/{key}"] = values
    return found


def _inside(name: str, state: Any, info: Any) -> dict[str, Array]:
    """Innovations of the first run, and the factors of strong tracking."""
    root = info.innovation_root[:1]
    out = {
        "residual": info.innovation[:1],
        "residual std": np.sqrt(np.square(root).sum(-1)),
        "nis": np.square(info.white[:1]).sum(-1),
    }
    out = {f"{name}/{what}": value for what, value in out.items()}
    if name == "tstdkf":
        out["tstdkf/lambda"] = state.memory.factors[1, :1]
    return out
