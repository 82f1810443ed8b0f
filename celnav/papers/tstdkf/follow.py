"""Filters on simulated runs, and what is kept of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.records import Filter, FilterError
from celnav.filters.run import steps
from celnav.gaussian.belief import nees
from celnav.gaussian.linalg import Array, block, cholesky, matvec
from celnav.papers.tstdkf.config import Config
from celnav.papers.tstdkf.estimators import boosted, filters
from celnav.papers.tstdkf.scenario import Scenario

Found = dict[str, Array]
"""``<case>/<filter>/<what>`` -> ``(K, runs, ...)``; cases count from 0."""


class View(NamedTuple):
    """What a filter says: orbit and bias ``mean (runs, 6 or 9)``, and ``cov(part)``, the covariance of a part of the runs."""

    label: str
    mean: Array
    cov: Callable[[slice], Array]


def views(name: str, state: Any) -> Iterator[View]:
    """The filters that are inside of a filter's state: EKF is the first stage of TKF, TDKF lies beside TSTDKF."""
    if name == "aug":
        chosen = np.r_[0:6, 15:18]
        yield View("aug", state.belief.mean[..., chosen], lambda part: state.belief.cov[part, chosen[:, None], chosen])
        return
    free, own, Lambda = state.first.belief, state.bias, state.Lambda

    shared = own.cov[0] if own.cov.ndim > free.cov.ndim else own.cov  # TDKF and TSTDKF differ in the mean alone

    def both(part: slice) -> Array:
        cross = Lambda[part] @ shared[part]
        return block([[free.cov[part] + cross @ Lambda[part].mT, cross], [cross.mT, shared[part]]])

    if name != "tstdkf":
        yield View(name.replace("tkf", "ekf"), free.mean, lambda part: np.asarray(free.cov[part]))
    labels = ("tdkf", "tstdkf") if name == "tstdkf" else (name,)
    means = own.mean if name == "tstdkf" else own.mean[None]
    for label, bias in zip(labels, means, strict=True):
        yield View(label, np.concatenate([free.mean + matvec(Lambda, bias), bias], -1), both)


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
    showcase: whether ``first/mean (9)``, ``cov (9, 9)``, ``nis``, ``residual (3)``, ``residual std``, ``lambda (3)`` are kept of
        the first run of the first case.
    consistency: the filters whose ``nees`` is kept (of orbit and bias for aug, with its ``nis``; of the orbit for the others).

    Returns
    -------
    Squared errors ``position``, ``velocity`` (km^2, km^2/s^2) and, where it is estimated, ``bias`` (km^2), and what is asked for.

    Raises
    ------
    FilterError: if a run is lost.
    """
    cases = tuple(believed) or sim.cases
    if filter is None:
        filter = boosted(cases, sim.runs, also_plain=True) if name == "tstdkf" else filters(cases, sim.runs)[name]

    rows = _Rows(len(sim.truth) - 1)
    for epoch, state, (info,) in steps(filter, sim.prior, sim.epochs()):
        for view in views(name, state):
            error = view.mean - epoch.truth[..., : view.mean.shape[-1]]
            squares = np.square(error).reshape(*error.shape[:-1], -1, 3).sum(-1)
            for i, what in zip(range(squares.shape[-1]), ("position", "velocity", "bias"), strict=False):
                rows.add(f"{view.label}/{what}", squares[..., i])
            if view.label in consistency:
                n = error.shape[-1] if name == "aug" else 6
                rows.add(f"{view.label}/nees", nees(error[..., :n], cholesky(view.cov(slice(None))[..., :n, :n])))
                if name == "aug":
                    rows.add(f"{view.label}/nis", np.square(np.asarray(info.whitened)).sum(-1))
            if showcase:
                rows.add(f"{view.label}/first/mean", view.mean[:1])
                rows.add(f"{view.label}/first/cov", view.cov(slice(1)))
        if showcase:
            for what, value in _inside(name, state, info).items():
                rows.add(what, value)
        rows.next()
    found: Found = {}
    for key, track in rows.tracks.items():
        if not np.isfinite(track).all():
            raise FilterError(f"{key}: lost a run at step {1 + int(np.argmax(~np.isfinite(track).reshape(len(track), -1).all(1)))}")
        whole = track.shape[1] == sum(sim.runs)
        parts = np.split(track, np.cumsum(sim.runs)[:-1], 1) if whole else [track]
        found |= {f"{i}/{key}": part for i, part in enumerate(parts)}
    return found


class _Rows:
    """Tracks ``(K, ...)`` by name, written row by row in place: lists of rows would need twice the memory at the end."""

    def __init__(self, length: int) -> None:
        self.tracks: Found = {}
        self._length, self._row = length, 0

    def add(self, key: str, row: Array) -> None:
        """Write the present row."""
        if self._row == 0:
            self.tracks[key] = np.empty((self._length, *row.shape))
        self.tracks[key][self._row] = row

    def next(self) -> None:
        """Go on to the next row."""
        self._row += 1


def _inside(name: str, state: Any, info: Any) -> dict[str, Array]:
    """Innovations of the first run, and the factors of strong tracking."""
    # TDKF and TSTDKF lie along a leading axis, once there is a difference to update with.
    both = info.whitened.ndim > 2
    innovation, white, root = ((found[-1] if both else found)[:1] for found in (info.innovation, info.whitened, info.sqrt_S))
    out = {"residual": innovation, "residual std": np.sqrt(np.square(root).sum(-1)), "nis": np.square(white).sum(-1)}
    out = {f"{name}/first/{what}": value for what, value in out.items()}
    if name == "tstdkf":
        out["tstdkf/first/lambda"] = state.memory.factors[1, :1]
    return out
