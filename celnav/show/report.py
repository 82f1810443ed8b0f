"""Report of a filter against the truth: actual and predicted errors of each component, consistency,
sensors and events, as text and as a figure.

>>> print(track.report(truth))
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtr, chdtri, ndtri

from celnav.analysis.diagnose import (
    Interval,
    SensorConsistency,
    autocorrelation,
    forgotten_wraps,
    grid_index,
)
from celnav.analysis.diagnosis_text import consistency, laid_out
from celnav.analysis.metrics import bootstrap, chi_square_band
from celnav.filters.track import Track, space_of
from celnav.gaussian.belief import nees
from celnav.gaussian.checks import instance, number, numbers, sequence
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.show import colors
from celnav.show.diagnosis import size
from celnav.show.draw import Line, Panel, curve, grid, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Report", "report"]

TIME = "time (s)"
CORRELATED = (
    "below its band while NEES is above it: the noise of the measurements is correlated (see "
    "celnav.analysis.diagnose), or its model is wrong"
)
CHANCE = 1e-3
"""Probability that any run of a consistent filter counts as one with large errors."""
MOST_PANELS = 12
"""Components that are drawn at most."""


class Component(NamedTuple):
    """Statistics of one component of the error, in its own unit.

    rmse: over all runs and epochs. interval: of ``rmse``, from a bootstrap over runs; nan for fewer
        than two runs.
    claimed: rms of the predicted standard deviations. mean: of the error. inside: part of the
        errors within the interval that the filter predicts for `Report.level`.
    """

    name: str
    rmse: float
    interval: Interval
    claimed: float
    mean: float
    inside: float


class Dominant(NamedTuple):
    """A minority of the runs with errors so large that they alone make the NEES too large.

    runs: their indices, the largest first. median: of the NEES over the dimension of all runs.
    others: NEES of the other runs, in its band or below.
    """

    runs: tuple[int, ...]
    median: float
    others: SensorConsistency


class Report(NamedTuple):
    """The report of a track; ``print`` shows it as a table, `figure` draws it.

    times: ``(T,)`` s, the judged epochs. runs: number of runs. level: of all intervals and bands.
    components: of the error in the filter's space: attitudes as rotation vectors, angles wrapped.
    nees: NEES over the dimension and its band, None without covariances. Its ``shared`` is the
        number of epochs that vary together, since errors are correlated in time.
    within: part of the epochs at which the runs' mean NEES lies in the band of a consistent filter.
    dominant: the runs that alone make the NEES too large; None if there are none.
    sensors: NIS of the used components over their degrees of freedom, with the band of a consistent
        filter.
    rejected: number of measured components of each sensor that the filter rejected.
    events: of all runs and epochs, see `celnav.filters.track.Track`. lost: ``(run, t)`` of runs
        that have no estimate from t on.
    wraps: angles whose wrap seems to be missing, a sentence for each sensor and for the motion.
    rms, claims: ``(T, n)``, RMS over the runs of the errors and of the predicted standard
        deviations.

    >>> track.report(truth).components[0].rmse
    """

    times: Array
    runs: int
    level: float
    components: tuple[Component, ...]
    nees: SensorConsistency | None
    within: float
    dominant: Dominant | None
    sensors: tuple[SensorConsistency, ...]
    rejected: tuple[int, ...]
    events: dict[str, int]
    lost: tuple[tuple[int, float], ...]
    wraps: tuple[str, ...]
    rms: Array
    claims: Array

    def __str__(self) -> str:
        runs = "one run" if self.runs == 1 else f"{self.runs} runs"
        said = [*(("wrap", line) for line in self.wraps), ("NEES", self._nees())]
        if (dominant := self.dominant) is not None:
            which = f"dominated by {len(dominant.runs)} of {runs} (largest: run {dominant.runs[0]})"
            others = f"median run {dominant.median:.4g}; the others {self._ratio(dominant.others)}"
            said.append(("NEES", f"{which}; {others}"))
        for k, (sensor, rejected) in enumerate(zip(self.sensors, self.rejected, strict=True)):
            used = f"of {int(sensor.dof.sum())} components used"
            used += f", {rejected} rejected" if rejected else ""
            said.append((f"NIS {k}", f"{', '.join(sensor.names)}: {self._ratio(sensor)}; {used}"))
        if dominant is None and self.nees is not None and self.nees.nis > self.nees.band[1]:
            small = [k for k, sensor in enumerate(self.sensors) if sensor.nis < sensor.band[0]]
            said += [(f"NIS {k}", CORRELATED) for k in small]
        events = [
            f"{count} {'steps' if what == 'redone' else 'components'} {what}"
            for what, count in self.events.items()
            if count
        ]
        if self.lost:
            run, t = min(self.lost, key=lambda lost: lost[1])
            first = f"the first (run {run}) at {t:g} s; earlier epochs count"
            events.append(f"{len(self.lost)} of {runs} lost, {first}")
        said.append(("events", ", ".join(events) or "none: nothing missing, rejected or lost"))
        head = f"{runs}, {len(self.times)} epochs from {self.times[0]:g} to {self.times[-1]:g} s"
        return laid_out(head, self._table(), said)

    @property
    def _percent(self) -> str:
        return f"{100 * self.level:.3g} %"

    def _table(self) -> list[list[str]]:
        """A row for each component, with an interval if there are several runs."""
        names = ("component", "RMSE", self._percent, "predicted σ", "mean error")
        rows = [[*names, f"inside {self._percent}"]]
        for c in self.components:
            interval = f"{c.interval[0]:.4g} to {c.interval[1]:.4g}"
            sizes = f"{c.rmse:.4g}", interval, f"{c.claimed:.4g}", f"{c.mean:.3g}"
            rows.append([c.name, *sizes, f"{100 * c.inside:.1f} %"])
        return [row if self.runs > 1 else row[:2] + row[3:] for row in rows]

    def _nees(self) -> str:
        if self.nees is None:
            return "no covariances are stored: run with keep='cov'"
        often = f"; in the band of the runs' mean at {100 * self.within:.0f} % of the epochs"
        counted = f"{self._ratio(self.nees)}, correlation of errors counted"
        return f"over {len(self.components)}: {counted}{often * (self.runs > 1)}"

    def _ratio(self, judged: SensorConsistency) -> str:
        """A ratio that is 1 for a consistent filter, with its band."""
        if np.isnan(judged.nis):
            return "nothing was used"
        band = f"{judged.band[0]:.4g} to {judged.band[1]:.4g}"
        word = consistency(judged.nis, judged.band)
        return f"{judged.nis:.4g}, {word} ({self._percent} of consistent ones: {band})"

    def figure(self) -> Figure:
        """A figure of actual and predicted errors over time (rms of runs), and NEES and NIS in
        bands.
        """
        said = "RMSE over the runs" if self.runs > 1 else "|error|"
        columns = 3 if len(self.components) > 4 else 2
        errors = Line(said, colors.ESTIMATE, width=0.9)
        claims = Line("predicted σ", colors.SIGMA, "--")
        drawn = [
            Panel(
                "", [curve(self.times, rms, errors), curve(self.times, std, claims)], TIME, c.name
            )
            for c, rms, std in zip(self.components, self.rms.T, self.claims.T, strict=True)
        ][:MOST_PANELS]
        rows = grid(drawn, columns)
        judged = {} if self.nees is None else {"NEES / n": self.nees}
        judged |= {f"NIS / dof: {', '.join(sensor.names)}": sensor for sensor in self.sensors}
        labels = f"{self._percent} band if consistent", "mean of bins"
        last = [
            Panel(title, [size(self.times, sensor, self.level, *labels)], TIME)
            for title, sensor in judged.items()
        ]
        rows += grid(last, columns)
        return panels(*rows, height=1.9)


def report(
    track: Track,
    truth: ArrayLike,
    *,
    names: Sequence[str] | None = None,
    start: float | None = None,
    space: Space | None = None,
    level: float = 0.95,
) -> Report:
    """The report of `celnav.Track.report`, which explains the arguments."""
    instance("track", track, Track, "what celnav.run gave")
    level = number("level", level, above=0.0, below=1.0)
    first = 0 if start is None else int(np.searchsorted(track.times, number("start", start)))
    times = track.times[first:]
    T = len(times)
    if not T:
        raise ValueError(
            f"start: expected at most {track.times[-1]:g}, the last epoch, got {start!r}"
        )
    error, names = errors(track, truth, names, space)
    n = error.shape[-1]
    error, std = (x[first:].reshape(T, -1, n) for x in (error, track.std[..., :n]))
    std = np.where(np.isfinite(error), std, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):  # nan where no run has a value
        rms, claims = (np.sqrt(np.nansum(x * x, 1) / np.isfinite(x).sum(1)) for x in (error, std))
    judged, within, dominant = None, np.nan, None
    if track.belief is not None:
        judged, within, dominant = _judge_nees(
            error, track.sqrt_cov[first:, ..., :n, :n], times, level
        )
    wraps = forgotten_wraps(error, (n,), names, model="Motion")
    if track.sensors:
        innovation = track.innovation[first:].reshape(T, -1, sum(track.sensors))
        wraps = forgotten_wraps(innovation, track.sensors, track.measured) + wraps
    sensors = list(_sensors(track, first, level))
    return Report(
        times=times,
        runs=error.shape[1],
        level=level,
        components=tuple(
            _component(name, error[..., i], std[..., i], level) for i, name in enumerate(names)
        ),
        nees=judged,
        within=within,
        dominant=dominant,
        sensors=tuple(sensor for sensor, _ in sensors),
        rejected=tuple(rejected for _, rejected in sensors),
        events={what: int(count.sum()) for what, count in track.events.items()},
        lost=_lost(track),
        wraps=wraps,
        rms=rms,
        claims=claims,
    )


def _lost(track: Track) -> tuple[tuple[int, float], ...]:
    """Runs that failed, with the time; nan if a run failed after the last stored epoch."""
    runs = np.flatnonzero(track.failed_at.ravel() >= 0)
    missing = np.isnan(track.mean).any(-1).reshape(len(track.times), -1)[:, runs]
    since = np.where(missing.any(0), track.times[missing.argmax(0)], np.nan)
    return tuple(zip(runs.tolist(), since.tolist(), strict=True))


def errors(
    track: Track, truth: Any, names: Sequence[str] | None, space: Space | None
) -> tuple[Array, Sequence[str]]:
    """Errors ``(T, ..., n)`` in a space, and the names of their components."""
    if track.mean is None or track.std is None:
        raise ValueError(
            "track: expected one with means and deviations; run with keep='cov', or 'std'"
        )
    if space is None:
        space = space_of(track.filter)
    instance("space", space, Space, "a Space, such as celnav.attitude()")
    error = _errors(track, truth, space)
    return error, component_names(names, space, error.shape[-1])


def component_names(names: Sequence[str] | None, space: Space, n: int) -> Sequence[str]:
    """Names of ``n`` components of an error: those given, those of the space, or x0, x1, ..."""
    if names is None:
        names = space.labels[:n] or [f"x{i}" for i in range(n)]
    names = sequence("names", names, "['x', 'y']")
    if len(names) != n or not all(isinstance(name, str) for name in names):
        raise ValueError(
            f"names: expected {n} words, one for each component of the error, got {names!r:.80}"
        )
    return names


def _errors(track: Track, truth: Any, space: Space) -> Array:
    """Errors ``(T, ..., n)`` in a space."""
    mean, true = track.mean, numbers("truth", truth)
    T, N = len(mean), mean.shape[-1]
    if true.ndim == 2 < mean.ndim:
        true = true.reshape(len(true), *[1] * (mean.ndim - 2), true.shape[-1])
    width = true.shape[-1] if true.ndim else 0
    fewer = space == EUCLIDEAN and true.ndim > 1 and 0 < width <= N
    runs = zip(true.shape[1:-1], mean.shape[1:-1], strict=False)
    if (
        true.ndim != mean.ndim
        or len(true) != T
        or not (width == N or fewer)
        or any(count not in (1, every) for count, every in runs)
    ):
        shape = ", ".join(map(str, mean.shape))
        late = true.ndim and len(true) > T
        hint = "; truth[::every] goes with a track of each every-th epoch" if late else ""
        raise ValueError(
            f"truth: expected shape ({shape}), at the track's epochs, got {np.shape(truth)}{hint}"
        )
    if np.isinf(true).any():
        raise ValueError(
            "truth: expected finite numbers, or nan where it is not known, got an infinite one"
        )
    if width == N and space == EUCLIDEAN and track.std.shape[-1] != N:
        raise ValueError(
            "space: expected the space of the states, which are no vectors, "
            "such as celnav.attitude(), got none"
        )
    estimate = mean[..., :width]
    with np.errstate(invalid="ignore"):  # tangents at the mean, as covariances are
        return np.asarray(-space.minus(np.broadcast_to(true, estimate.shape), estimate))


def _component(name: str, error: Array, std: Array, level: float) -> Component:
    """Statistics of errors ``(T, runs)`` and their predicted standard deviations."""
    squares, counts = np.nansum(error * error, 0), np.isfinite(error).sum(0)
    has_error, total = counts > 0, int(counts.sum())
    if not total:
        return Component(name, np.nan, (np.nan, np.nan), np.nan, np.nan, np.nan)
    interval = np.nan, np.nan
    if has_error.sum() > 1:
        samples = squares[has_error], counts[has_error]
        interval = bootstrap(_rms, *samples, level=level)
    inside = np.abs(error) <= float(ndtri(0.5 + level / 2)) * std  # nan lies nowhere
    return Component(
        name=name,
        rmse=_rms(squares, counts),
        interval=interval,
        claimed=float(np.sqrt(np.nanmean(std * std))),
        mean=float(np.nansum(error) / total),
        inside=float(inside.sum() / total),
    )


def _rms(squares: Array, counts: Array) -> float:
    return float(np.sqrt(squares.sum() / counts.sum()))


def _judge_nees(
    error: Array, root: Array, times: Array, level: float
) -> tuple[SensorConsistency | None, float, Dominant | None]:
    """NEES over the dimension, how often the mean of the runs lies in its band at an epoch, and the
    runs that dominate it.
    """
    T, runs, n = error.shape
    with np.errstate(invalid="ignore", divide="ignore"):
        every = nees(error, np.broadcast_to(root.reshape(T, -1, n, n), (T, runs, n, n)))
    every = np.where(np.isfinite(every), every, np.nan)
    if np.isnan(every).all():
        return None, np.nan, None
    judged = _nees_consistency(every, n, times, level)
    some = judged.dof > 0
    probability = chdtr(judged.dof[some], judged.squares[some])
    within = float(np.mean(np.abs(probability - 0.5) <= level / 2))
    large = judged.nis > judged.band[1]
    return judged, within, _dominant(every, n, times, level) if large else None


def _nees_consistency(every: Array, n: int, times: Array, level: float) -> SensorConsistency:
    """Consistency of the NEES ``(T, runs)`` of ``n`` components."""
    dof = n * np.isfinite(every).sum(1)
    return _consistency((f"NEES / {n}",), np.nansum(every, 1), dof, _shared(every, times), level)


def _consistency(
    names: tuple[str, ...], squares: Array, dof: Array, shared: float, level: float
) -> SensorConsistency:
    """The ratio of sums of squares ``(T,)`` to their degrees of freedom, with its band."""
    ratio, band, total = np.nan, (np.nan, np.nan), int(dof.sum())
    if total:
        ratio, band = float(squares.sum() / total), chi_square_band(1.0, total / shared, level)
    return SensorConsistency(names, ratio, band, squares, dof, shared)


def _dominant(every: Array, n: int, times: Array, level: float) -> Dominant | None:
    """The runs that alone make the NEES ``(T, runs)`` too large; None if the others do, too.

    The mean over a run's ``count`` epochs, of which ``shared`` vary together, is about chi-square
    with ``n count / shared`` degrees of freedom, over their number. A run is *large* if its mean is
    beyond the point that a consistent filter exceeds in any run with the probability `CHANCE`.
    Large runs also make ``shared`` large, so it is that of the others, until none is found.
    """
    count = np.isfinite(every).sum(0)
    runs, means = np.count_nonzero(count), np.nansum(every, 0) / np.maximum(n * count, 1)
    large = np.zeros(len(count), bool)
    while 2 * large.sum() < runs:
        others = _nees_consistency(every[:, ~large], n, times, level)
        dof = n * np.maximum(count / others.shared, 1.0)
        new = ~large & (means > chdtri(dof, CHANCE / runs) / dof)
        if not new.any():
            if not large.any() or not others.nis <= others.band[1]:
                return None
            order = np.argsort(-means)[: large.sum()]
            return Dominant(tuple(order.tolist()), float(np.median(means[count > 0])), others)
        large |= new
    return None


def _shared(every: Array, times: Array) -> float:
    """How many epochs vary together. Errors of a consistent filter are correlated in time, but not
    between runs.
    """
    present = np.isfinite(every).any(-1)
    place, _ = grid_index(times[present])
    if len(place) < 4 or np.nanvar(every) == 0.0 or place[-1] < 2:
        return float(len(place))
    longer = autocorrelation(every[present], place, 1)[2]
    return min(max(longer, 1.0), float(len(place)))


def _sensors(track: Track, first: int, level: float) -> Iterator[tuple[SensorConsistency, int]]:
    """NIS over the degrees of freedom of each sensor, and how many components it rejected.

    The innovations of a consistent filter are white, so no epochs vary together.
    """
    start = 0
    for width in track.sensors:
        columns = slice(start, start + width)
        white, used, innovation = (
            x[first:, ..., columns] for x in (track.whitened, track.used, track.innovation)
        )
        judged = used & np.isfinite(white)  # a failed run has no innovations
        terms = np.where(judged, np.square(white), 0.0)
        dof, squares = (x.reshape(len(x), -1).sum(1) for x in (judged, terms))
        rejected = int((np.isfinite(innovation) & ~used).sum())
        names = tuple(track.measured[columns])
        yield _consistency(names, squares, dof, 1.0, level), rejected
        start += width
