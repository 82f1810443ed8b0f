"""Estimates of runs for a showcase: errors, covariances and consistency, by group."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from celnav.filters.run import run
from celnav.gaussian.linalg import Array
from celnav.show.draw import Line
from celnav.study.study import Results
from celnav.study.trial import Group, scales


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimates of one filter for all runs, in the units of the state.

    Attributes
    ----------
    label, color: in legends.
    errors: means minus truth ``(T, runs, n)``; the first run is the one that is shown in full.
    cov: covariance ``(T, n, n)`` of that run, or only the variances ``(T, n)``; None: unknown.
    nees, nis: ``(T,)`` of that run, nan where there is none; None: unknown.
    states: what became of its measurements ``(T,)``, see `measurement_states`; None: not shown.
    """

    label: str
    color: str
    errors: Array
    cov: Array | None = None
    nees: Array | None = None
    nis: Array | None = None
    states: Sequence[str] | None = None

    def error(self, group: Group) -> Array:
        """Errors of all runs in a group, ``(T, runs, k)`` in its unit; k is 0 if the filter does
        not estimate the group.
        """
        return np.asarray(self.errors[..., group.part] * np.asarray(group.scale))

    def sigma(self, group: Group) -> Array | None:
        """Standard deviations ``(T, k)`` of a group, in its unit; None: unknown."""
        if self.cov is None:
            return None
        variance = (self.cov if self.cov.ndim == 2 else self.cov.diagonal(0, -2, -1))[:, group.part]
        return np.asarray(
            np.sqrt(np.where(variance >= 0.0, variance, np.nan)) * np.asarray(group.scale)
        )


def measurement_states(innovation: Array, used: Array) -> Array:
    """What became of the measurements of a run: "missing", "used", "used in part" or "rejected".

    innovation, used: ``(T, m)`` of a track. Returns ``(T,)`` texts.

    >>> celnav.show.estimates.measurement_states(track.innovation, track.used)
    """
    measured = np.isfinite(innovation)
    some, every = used.any(-1), (used | ~measured).all(-1)
    names = ["missing", "used", "used in part"]
    return np.select([~measured.any(-1), some & every, some], names, "rejected")


def estimates_of(
    results: Results, part: str, lines: Mapping[str, Line]
) -> tuple[dict[str, Estimate], Array, Array]:
    """Estimates of a part's filters with the covariances of the first run, and that run's truth
    ``(T, n)`` and measurements ``(T, m)``. All filters have the same epochs.
    """
    first, name = results.first(part), next(iter(lines))
    epochs = list(first.epochs(name))
    scale = scales(results.study.groups, results.get(part, f"{name}/error").shape[-1])
    estimates = {}
    for name, line in lines.items():
        error, cov, nees, nis = (
            results.get(part, f"{name}/{what}") for what in ("error", "cov", "nees", "nis")
        )
        of_first = cov[:, 0], nees[:, 0], nis[:, 0]
        estimates[name] = Estimate(line.label, line.color, error / scale, *of_first)
    truth, z = ([getattr(epoch, what)[0] for epoch in epochs] for what in ("truth", "z"))
    return estimates, np.stack(truth), np.stack(z)


def sensor_states(results: Results, part: str, name: str, **sizes: int) -> dict[str, Sequence[str]]:
    """What became of each sensor's measurements, ``(T,)`` texts by title, in the first run of a
    part, which the filter ``name`` runs again.

    sizes: the number of components of each sensor by title, in their order.

    >>> sensor_states(results, "A-slow", "ukf", stars=6, SAR=2)
    """
    first = results.first(part)
    track = run(first.filters[name], first.prior, first.epochs(name))
    y, used = track.innovation[:, 0], track.used[:, 0]
    ends = accumulate(sizes.values())
    rows = [slice(end - size, end) for size, end in zip(sizes.values(), ends, strict=True)]
    return {
        title: measurement_states(y[:, k], used[:, k]).tolist()
        for title, k in zip(sizes, rows, strict=True)
    }
