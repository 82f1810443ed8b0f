"""How a filter did against the truth: errors and claims of each component, consistency, sensors, events; in words and as a figure.

>>> print(track.report(truth))
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from celnav.analysis.diagnose import (
    Interval,
    SensorConsistency,
    autocorrelation,
    forgotten_wraps,
    grid_index,
)
from celnav.analysis.metrics import bootstrap, chi_square_band
from celnav.filters.model import Motion
from celnav.filters.track import Track
from celnav.gaussian.belief import nees
from celnav.gaussian.checks import instance, number, numbers, sequence
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.show import colors
from celnav.show.diagnosis import size
from celnav.show.figures import Item, Panel, curve, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Report", "report"]

WIDTH = 110
CORRELATED = (
    "below its band while NEES is above it: the noise of the measurements is correlated "
    "(see celnav.diagnose), or its model is wrong"
)
MOST_PANELS = 12
"""Components that are drawn."""


class Component(NamedTuple):
    """What is said of one component of the error, in its own unit.

    rmse, interval: over all runs and epochs, and by a bootstrap over runs; nan for fewer than two. claimed: rms of the filter's
    deviations. mean: of the error. inside: part of the errors that lie within what the filter claims to hold the `Report.level`.
    """

    name: str
    rmse: float
    interval: Interval
    claimed: float
    mean: float
    inside: float


class Report(NamedTuple):
    """How a track did; ``print`` it for a table, `figure` draws it.

    times: ``(T,)`` s, those that are judged. runs: how many. level: of all intervals and bands.
    components: of the error, as the filter's space has it: rotation vectors of attitudes, angles wrapped.
    nees: NEES over the dimension and its band, None without covariances; ``shared``: epochs that vary as one, since errors do.
    within: part of the epochs at which the mean NEES of the runs lies in the band of a consistent filter.
    sensors: NIS over the degrees of freedom, what was not measured left out, with the band of a consistent filter.
    rejected: measured components of each sensor that did not take part.
    events: of all runs and epochs, see `celnav.filters.track.Track`. lost: ``(run, t)`` of runs without an estimate from there.
    wraps: angles whose wrap seems forgotten, a sentence for each sensor, and for the motion.
    rms, claims: ``(T, n)``, over the runs.

    >>> track.report(truth).components[0].rmse
    """

    times: Array
    runs: int
    level: float
    components: tuple[Component, ...]
    nees: SensorConsistency | None
    within: float
    sensors: tuple[SensorConsistency, ...]
    rejected: tuple[int, ...]
    events: dict[str, int]
    lost: tuple[tuple[int, float], ...]
    wraps: tuple[str, ...]
    rms: Array
    claims: Array

    def __str__(self) -> str:
        runs, percent = (
            "one run" if self.runs == 1 else f"{self.runs} runs",
            f"{100 * self.level:.3g} %",
        )
        lines = [
            f"{runs}, {len(self.times)} epochs from {self.times[0]:g} to {self.times[-1]:g} s",
            "",
            *self._table(percent),
            "",
        ]
        said = [("wrap", line) for line in self.wraps] + [("NEES", self._nees(percent))]
        for k, (sensor, rejected) in enumerate(zip(self.sensors, self.rejected, strict=True)):
            used = f"of {int(sensor.dof.sum())} components used" + (
                f", {rejected} rejected" if rejected else ""
            )
            said.append(
                (f"NIS {k}", f"{', '.join(sensor.names)}: {_ratio(sensor, percent)}; {used}")
            )
        if self.nees is not None and self.nees.nis > self.nees.band[1]:
            said += [
                (f"NIS {k}", CORRELATED)
                for k, sensor in enumerate(self.sensors)
                if sensor.nis < sensor.band[0]
            ]
        events = [
            f"{count} {'steps' if what == 'redone' else 'components'} {what}"
            for what, count in self.events.items()
            if count
        ]
        if self.lost:
            run, t = min(self.lost, key=lambda one: one[1])
            events.append(
                f"{len(self.lost)} of {runs} lost, the first (run {run}) at {t:g} s; what was before counts"
            )
        said.append(("events", ", ".join(events) or "none: nothing missing, rejected or lost"))
        return "\n".join(
            lines
            + [
                textwrap.fill(f"{head:8} {text}", WIDTH, subsequent_indent=9 * " ")
                for head, text in said
            ]
        )

    def _table(self, percent: str) -> list[str]:
        many = self.runs > 1
        rows = [
            [
                "component",
                "RMSE",
                *([percent] * many),
                "predicted σ",
                "mean error",
                f"inside {percent}",
            ]
        ]
        for c in self.components:
            between = [f"{c.interval[0]:.4g} to {c.interval[1]:.4g}"] * many
            rows.append(
                [
                    c.name,
                    f"{c.rmse:.4g}",
                    *between,
                    f"{c.claimed:.4g}",
                    f"{c.mean:.3g}",
                    f"{100 * c.inside:.1f} %",
                ]
            )
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return [
            f"{row[0]:{widths[0]}}  "
            + "  ".join(x.rjust(n) for x, n in zip(row[1:], widths[1:], strict=True))
            for row in rows
        ]

    def _nees(self, percent: str) -> str:
        if self.nees is None:
            return "no covariances are stored: run with keep='cov'"
        often = (
            f"; in the band of the runs' mean at {100 * self.within:.0f} % of the epochs"
            if self.runs > 1
            else ""
        )
        return f"over {len(self.components)}: {_ratio(self.nees, percent)}, correlation of errors counted{often}"

    def figure(self) -> Figure:
        """Errors and claims of each component over time (rms over the runs), NEES and NIS in their bands."""
        said = "RMSE over the runs" if self.runs > 1 else "|error|"
        percent, columns = f"{100 * self.level:.3g} %", 3 if len(self.components) > 4 else 2
        shown = [
            Panel("", [curve(self.times, self.rms[:, i], color=colors.ESTIMATE, label=said, linewidth=0.9),
                       curve(self.times, self.claims[:, i], color=colors.SIGMA, label="predicted σ", linestyle="--")],
                  "time (s)", c.name)
            for i, c in enumerate(self.components[:MOST_PANELS])
        ]  # fmt: skip
        judged = [*([("NEES / n", self.nees)] * (self.nees is not None)),
                  *((f"NIS / dof: {', '.join(sensor.names)}", sensor) for sensor in self.sensors)]  # fmt: skip
        last = [
            Panel(
                title,
                [
                    size(
                        self.times,
                        sensor,
                        self.level,
                        f"{percent} band if consistent",
                        "mean of bins",
                    )
                ],
                "time (s)",
            )
            for title, sensor in judged
            if sensor is not None
        ]
        rows = [
            part[i : i + columns] for part in (shown, last) for i in range(0, len(part), columns)
        ]
        blank: list[Item] = [lambda ax: ax.set_axis_off()]
        return panels(
            *([*row, *[Panel("", blank)] * (columns - len(row))] for row in rows),
            size=(3.2 * columns, 1.9 * len(rows) + 0.4),
        )


def report(
    track: Track, truth: ArrayLike, *, names: Sequence[str] | None = None, start: float | None = None, space: Space | None = None,
    level: float = 0.95,
) -> Report:  # fmt: skip
    """What `celnav.Track.report` gives, which says the arguments."""
    instance("track", track, Track, "what celnav.run gave")
    level = number("level", level, above=0.0, below=1.0)
    if track.mean is None or track.std is None:
        raise ValueError(
            "track: expected one with means and deviations; run with keep='cov', or 'std'"
        )
    chosen = (
        _space_of(track.filter)
        if space is None
        else instance("space", space, Space, "a Space, such as celnav.attitude()")
    )
    from_here = (
        slice(None)
        if start is None
        else slice(int(np.searchsorted(track.times, number("start", start))), None)
    )
    times = track.times[from_here]
    if not len(times):
        raise ValueError(
            f"start: expected at most {track.times[-1]:g}, the last epoch, got {start!r}"
        )
    error, n = _errors(track, truth, chosen)
    called = (
        [f"x{i}" for i in range(n)]
        if names is None
        else list(sequence("names", names, "['x', 'y']"))
    )
    if len(called) != n or not all(isinstance(name, str) for name in called):
        raise ValueError(
            f"names: expected {n} words, one for each component of the error, got {names!r:.80}"
        )
    error, std = (x[from_here].reshape(len(times), -1, n) for x in (error, track.std[..., :n]))
    std = np.where(np.isfinite(error), std, np.nan)
    runs = error.shape[1]
    components = tuple(_component(called[i], error[..., i], std[..., i], level) for i in range(n))
    with np.errstate(invalid="ignore", divide="ignore"):  # where nothing is known there is nan
        rms, claims = (np.sqrt(np.nansum(x * x, 1) / np.isfinite(x).sum(1)) for x in (error, std))
    judged, within = None, np.nan
    if track.belief is not None:
        judged, within = _consistency(error, track.sqrt_cov[from_here][..., :n, :n], times, level)
    sensors, rejected = _sensors(track, from_here, level)
    wraps = forgotten_wraps(error, (n,), called, model="Motion")
    if track.sensors:
        innovation = track.innovation[from_here].reshape(len(times), -1, sum(track.sensors))
        wraps = forgotten_wraps(innovation, track.sensors, track.measured) + wraps
    lost = np.flatnonzero(track.failed_at.ravel() >= 0)
    gone = np.isnan(track.mean.reshape(len(track.times), -1, track.mean.shape[-1])[:, lost]).any(-1)
    since = np.where(
        gone.any(0), track.times[gone.argmax(0)], np.nan
    )  # a run may be lost after all epochs that are stored
    return Report(
        times, runs, level, components, judged, within, sensors, rejected,
        {what: int(count.sum()) for what, count in track.events.items()}, tuple(zip(lost.tolist(), since.tolist(), strict=True)),
        wraps, rms, claims,
    )  # fmt: skip


def _space_of(filter: Any) -> Space:
    """Of a filter's states, or of those of the filters within it."""
    if isinstance(motion := getattr(filter, "motion", None), Motion):
        return motion.space
    within = (getattr(filter, name, None) for name in ("first", "filter", "filters"))
    found = next((one[0] if isinstance(one, tuple) else one for one in within if one), None)
    return EUCLIDEAN if found is None else _space_of(found)


def _errors(track: Track, truth: Any, space: Space) -> tuple[Array, int]:
    """Errors ``(T, ..., n)`` in a space, and their dimension."""
    mean, known = track.mean, numbers("truth", truth)
    T, N = len(mean), mean.shape[-1]
    fewer = space == EUCLIDEAN and known.ndim > 1 and 0 < known.shape[-1] <= N
    if known.ndim == 2 < mean.ndim:
        known = known.reshape(len(known), *[1] * (mean.ndim - 2), known.shape[-1])
    wrong = known.ndim != mean.ndim or len(known) != T or (known.shape[-1] != N and not fewer)
    if wrong or any(
        k not in (1, m) for k, m in zip(known.shape[1:-1], mean.shape[1:-1], strict=True)
    ):
        shape = ", ".join(map(str, mean.shape))
        hint = (
            "; truth[::every] goes with a track of each every-th epoch"
            if known.ndim and len(known) > T
            else ""
        )
        raise ValueError(
            f"truth: expected shape ({shape}), at the track's epochs, got {np.shape(truth)}{hint}"
        )
    if np.isinf(known).any():
        raise ValueError(
            "truth: expected finite numbers, or nan where it is not known, got an infinite one"
        )
    width = known.shape[-1]
    if width == N and space == EUCLIDEAN and track.std.shape[-1] != N:
        raise ValueError(
            "space: expected the space of the states, which are no vectors, such as celnav.attitude(), got none"
        )
    with np.errstate(invalid="ignore"):
        mine = mean[..., :width]
        error = -space.minus(
            np.broadcast_to(known, mine.shape), mine
        )  # tangents at the mean, as covariances are
    return error, error.shape[-1]


def _component(name: str, error: Array, std: Array, level: float) -> Component:
    """Of errors ``(T, runs)`` and claims."""
    squares, counts = np.nansum(error * error, 0), np.isfinite(error).sum(0)
    if not counts.any():
        return Component(name, np.nan, (np.nan, np.nan), np.nan, np.nan, np.nan)
    known = counts > 0
    interval = np.nan, np.nan
    if known.sum() > 1:
        interval = bootstrap(
            lambda s, k: float(np.sqrt(s.sum() / k.sum())),
            squares[known],
            counts[known],
            level=level,
        )
    inside = np.abs(error) <= float(ndtri(0.5 + level / 2)) * std  # nan lies nowhere
    total = int(counts.sum())
    return Component(
        name, float(np.sqrt(squares.sum() / total)), interval, float(np.sqrt(np.nanmean(std * std))),
        float(np.nansum(error) / total), float(inside.sum() / total),
    )  # fmt: skip


def _consistency(
    error: Array, root: Array, times: Array, level: float
) -> tuple[SensorConsistency | None, float]:
    """NEES over the dimension, and how often the mean of the runs lies in its band at an epoch."""
    T, runs, n = error.shape
    with np.errstate(invalid="ignore", divide="ignore"):
        every = nees(error, np.broadcast_to(root.reshape(T, -1, n, n), (T, runs, n, n)))
    every = np.where(np.isfinite(every), every, np.nan)
    squares, count = np.nansum(every, 1), np.isfinite(every).sum(1)
    if not count.any():
        return None, np.nan
    seen = np.flatnonzero(count)
    bands = {k: chi_square_band(n, k, level) for k in set(count[seen].tolist())}
    within = np.mean(
        [
            bands[k][0] <= s / k <= bands[k][1]
            for s, k in zip(squares[seen], count[seen].tolist(), strict=True)
        ]
    )
    shared = _shared(every, times)
    total = int(count.sum())
    band = chi_square_band(1.0, n * max(total / shared, 1.0), level)
    return SensorConsistency(
        (f"NEES / {n}",), float(squares.sum() / total / n), band, squares, n * count, shared
    ), float(within)


def _shared(every: Array, times: Array) -> float:
    """How many epochs vary as one: errors of a consistent filter follow each other, those of different runs do not."""
    seen = np.isfinite(every).any(-1)
    place, _ = grid_index(times[seen])
    if len(place) < 4 or np.nanvar(every) == 0.0 or place[-1] < 2:
        return float(len(place))
    longer = autocorrelation(every[seen], place, 1)[2]
    return min(max(longer, 1.0), float(len(place)))


def _sensors(
    track: Track, from_here: slice, level: float
) -> tuple[tuple[SensorConsistency, ...], tuple[int, ...]]:
    """NIS over the degrees of freedom of each sensor; the innovations of a consistent filter are white."""
    found, rejected, first = [], [], 0
    for width in track.sensors:
        own = slice(first, first + width)
        white, used, innovation = (
            x[from_here][..., own] for x in (track.whitened, track.used, track.innovation)
        )
        counts = (used & np.isfinite(white)).reshape(
            len(used), -1
        )  # of a lost run there is nothing
        dof, squares = (
            counts.sum(1),
            np.where(counts, np.square(white).reshape(counts.shape), 0.0).sum(1),
        )
        total = int(dof.sum())
        band = chi_square_band(1.0, total, level) if total else (np.nan, np.nan)
        names = tuple(track.measured[first : first + width])
        found.append(
            SensorConsistency(
                names, float(squares.sum() / total) if total else np.nan, band, squares, dof, 1.0
            )
        )
        rejected.append(int((np.isfinite(innovation) & ~used).sum()))
        first += width
    return tuple(found), tuple(rejected)


def _ratio(judged: SensorConsistency, percent: str) -> str:
    """A ratio that is 1 for a consistent filter, with its band."""
    low, high = judged.band
    if np.isnan(judged.nis):
        return "nothing was used"
    said = (
        "consistent"
        if low <= judged.nis <= high
        else "overconfident"
        if judged.nis > high
        else "conservative"
    )
    return f"{judged.nis:.4g}, {said} ({percent} of consistent ones: {low:.4g} to {high:.4g})"
