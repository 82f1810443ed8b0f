"""Results of positioning a receiver: a summary, a table, figures and a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from celnav.files import Outputs
from celnav.filters.records import FilterError
from celnav.gaussian.linalg import Array
from celnav.models.gnss import GEO_NUMBERS
from celnav.receiver.filters import CLOCKS, COMPACT, OVEN, PHONE, filters
from celnav.receiver.geodesy import ELLIPSOID, ecef2geodetic
from celnav.receiver.integrity import probability
from celnav.receiver.position import Log
from celnav.receiver.rinex import SYSTEMS
from celnav.receiver.sky import GROUND_M, local_axes, on_earth
from celnav.receiver.tracks import DOUBTS, civil, table
from celnav.receiver.trust import SOUND_M, guarded
from celnav.show import colors
from celnav.show.draw import (
    WIDTH,
    Panel,
    components,
    curve,
    figure,
    panels,
    picture_names,
    pictures,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KIND_COLORS = {
    "GEO": colors.PAPER,
    "IGSO": colors.ESTIMATE,
    "MEO": colors.COMPARISON,
    "GPS": colors.TRUTH,
    "Galileo": colors.MEASUREMENT,
}
HEIGHTS_M = (-1e3, 5e4, 1.6e5)
"""Heights above the ellipsoid, m. A receiver is between the first two, or in orbit above the third.
"""
BOUND = 5.0
"""Largest error, in standard deviations, that the tests may miss."""
STILL = 0.01
"""Density of the acceleration of a receiver that is almost at rest, m^2/s^3."""
MOST_LINES = 5
"""Most damaged lines that a summary lists."""
IGSO_NUMBERS = frozenset({*range(6, 11), 13, 16, 31, 38, 39, 40, 56})
"""Inclined geosynchronous satellites of BeiDou-2 and -3."""


def kinds(names: Sequence[str]) -> Array:
    """For each satellite name: GEO, IGSO or MEO of BeiDou, or the name of another system."""
    named = [(name[0], int(name[1:])) for name in names]
    return np.array(
        [
            SYSTEMS[s].name
            if s != "C"
            else "GEO"
            if n in GEO_NUMBERS
            else "IGSO"
            if n in IGSO_NUMBERS
            else "MEO"
            for s, n in named
        ]
    )


class ClockNoise(NamedTuple):
    """Process noise of a clock: its source, and the densities of white frequency noise (m^2/s) and
    of the frequency's random walk (m^2/s^3).
    """

    source: str
    densities: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Positioned:
    """A receiver's track.

    Attributes
    ----------
    log: the filter's input. filter: its name. mean: ``(T, 8 + k)`` states. cov: ``(T, 3, 3)`` m^2,
        of the position.
    reference: ``(3,)`` m, a known position of the antenna to compare with; None if there is none.
        of: the source of that position.
    nis: normalized innovation squared per degree of freedom; for "ls", normalized squared residuals
        of the fixes.
    apart, trust: ``(T,)``, see `celnav.receiver.trust.Guarded`. clock, acceleration: the assumed
        process noise; the acceleration in m^2/s^3.
    """

    log: Log
    filter: str
    mean: Array
    cov: Array
    reference: Array | None
    of: str
    nis: float
    apart: Array
    trust: Array
    clock: ClockNoise
    acceleration: float

    @property
    def measured(self) -> Array:
        """Epochs ``(T,)`` whose position used at least one range. The other positions are
        predictions, which averages leave out.
        """
        return np.isfinite(self.mean[:, 0]) & self.log.used.any(-1)

    @property
    def reported(self) -> Array:
        """Epochs ``(T,)`` of exported tracks: measured, or predicted although there were ranges."""
        return np.asarray(self.measured | (np.isfinite(self.mean[:, 0]) & (self.trust != "")))

    @property
    def trusted(self) -> Array:
        """Epochs ``(T,)`` with a measured position that agrees with the track, or all `reported`
        epochs if there is no such epoch.
        """
        trusted = self.measured & (self.trust == "")
        return np.asarray(trusted if trusted.any() else self.reported)

    @property
    def place(self) -> Array:
        """The mean of `trusted` positions, m."""
        return np.asarray(self.mean[self.trusted, :3].mean(0))

    @property
    def origin(self) -> Array:
        """Origin of the local frame, m: the known position, else the mean position."""
        return self.place if self.reference is None else self.reference

    @cached_property
    def axes(self) -> Array:
        """East, north and up at the origin, the rows of ``(3, 3)``."""
        latitude, longitude, _ = ecef2geodetic(*self.origin, ell=ELLIPSOID, deg=False)
        return local_axes(latitude, longitude)

    def local(self, positions: Array) -> Array:
        """East, north, up ``(..., 3)`` m of positions ``(..., 3 or more)``."""
        return np.asarray((positions[..., :3] - self.origin) @ self.axes.T)

    @property
    def local_cov(self) -> Array:
        """Covariance ``(T, 3, 3)`` m^2 of east, north and up."""
        return np.asarray(self.axes @ self.cov @ self.axes.T)

    @property
    def local_std(self) -> Array:
        """Standard deviations ``(T, 3)`` m of east, north and up."""
        return np.sqrt(self.local_cov.diagonal(0, -2, -1))

    @cached_property
    def integrity(self) -> Array:
        """How far the ranges at each epoch support its position, a word ``(T,)``.

        If `trust` is not empty, its word is used. Otherwise:

        - "tested": the ranges agree.
        - "excluded": the ranges agree without those that are excluded.
        - "contradiction": the ranges disagree, and none is used.
        - "no ranges": no range is used.
        - "untested": there is no redundancy, or the test is off.
        - "implausible height": the height is outside `HEIGHTS_M`.
        - "weak": `BOUND` standard deviations of the distance between the position and the epoch's
          fix exceed `SOUND_M`.
        """
        log, there = self.log, np.isfinite(self.mean[:, :1])
        height = np.ravel(
            ecef2geodetic(*np.where(there, self.mean[:, :3], self.origin).T, ell=ELLIPSOID)[2]
        )
        low, high, orbit = HEIGHTS_M
        both = np.where(there[..., None], self.cov + np.nan_to_num(log.fix_cov), 0.0)
        deviation = np.sqrt(np.linalg.eigvalsh(both)[:, -1])
        return np.select(
            [
                self.trust != "",
                log.unusable[:, 0],
                ~log.used.any(1),
                (height < low) | ((height > high) & (height < orbit)),
                log.tested[:, 0] & (BOUND * deviation > SOUND_M),
                log.excluded[:, : len(log.names)].any(1),
                log.tested[:, 0],
            ],
            [
                self.trust,
                "contradiction",
                "no ranges",
                "implausible height",
                "weak",
                "excluded",
                "tested",
            ],
            "untested",
        )

    @property
    def doubtful(self) -> Array:
        """Positions ``(T,)`` that may have a large error although no residual shows it, see
        `DOUBTS`.
        """
        return self.reported & np.isin(self.integrity, list(DOUBTS))

    @property
    def distrusted(self) -> Array:
        """Epochs ``(T,)`` at which track and ranges contradict each other, or contradicted each
        other before.
        """
        return np.asarray(self.reported & (self.trust != ""))

    @property
    def minutes(self) -> Array:
        """Time since the first fix, ``(T,)`` min."""
        return np.asarray((self.log.times - self.log.times[0]) / 60.0)


def position(
    log: Log,
    filter: str,
    reference: Array | None,
    *,
    acceleration: float | None = None,
    clock: str = "auto",
    false_alarm: float = 1e-5,
    of: str = "known",
) -> Positioned:
    """The track that a filter of `celnav.receiver.filters.filters` computes from a log; "ls" uses
    each epoch alone.

    Positions that are not near the Earth become nan. Each epoch is compared with the track, see
    `celnav.receiver.trust`; for "ls" with the track of the ekf. Ranges that contradict the track
    are not used.

    Parameters
    ----------
    acceleration: density of the receiver's acceleration, m^2/s^3; None: estimated from the log, at
        least `STILL`. clock: process noise of the clock: "crystal", "phone", or "auto" (estimated
        from the log).
    false_alarm: probability that a sound epoch is found to contradict the track; 0: no test.
    of: see `Positioned`.

    Raises
    ------
    ValueError: for an unknown filter or clock, or a reference that is far from the Earth's surface.
    FilterError: if the filter fails.
    """
    noise = clock_noise(log, clock)
    if acceleration is None:
        acceleration = max(STILL, log.acceleration or 0.0)
    named = filters(
        len(log.names), second=log.second, acceleration=acceleration, clock=noise.densities
    )
    if reference is not None:
        on_earth("reference", reference)
    if filter not in ("ls", *named):
        raise ValueError(f"filter: expected one of ls, {', '.join(named)}, got {filter!r}")
    used = "ekf" if filter == "ls" else filter
    track = guarded(named[used], log, probability(false_alarm), used in COMPACT)
    mean, cov, nis, dof = track[:4]
    if filter == "ls":
        mean, cov, nis = log.fixes, log.fix_cov, log.misfit
        dof = np.where(np.isfinite(nis), np.maximum(log.spare, 0), 0)
    else:
        unused = np.isin(track.trust, ("apart", "distrusted"))
        log = replace(log, z=np.where(unused[:, None], np.nan, log.z))
        size = np.linalg.norm(mean[:, :3], axis=-1)
        there = (size > GROUND_M[0]) & (size < GROUND_M[1])
        if not (there & (unused | log.used.any(-1))).any():
            raise FilterError("its positions are far from the Earth")
        mean = np.where(there[:, None], mean, np.nan)
        cov = np.where(there[:, None, None], cov, np.nan)
    nis_per_degree = float(np.nansum(nis) / max(int(dof.sum()), 1))
    results = mean, cov, reference, of, nis_per_degree, track.apart, track.trust, noise
    return Positioned(log, filter, *results, acceleration)


def clock_noise(log: Log, clock: str) -> ClockNoise:
    """Process noise of a "crystal" or a "phone"; with "auto" estimated from the log, at least the
    noise of an oven-controlled crystal. ValueError for another clock.
    """
    if clock in CLOCKS:
        return ClockNoise(clock, CLOCKS[clock])
    if clock != "auto":
        raise ValueError(f"clock: expected one of {', '.join(CLOCKS)}, auto, got {clock!r}")
    if log.clock is None:
        return ClockNoise("a phone's, as there are too few fixes to estimate it", PHONE)
    white, walk = np.maximum(log.clock.cautious, OVEN).tolist()
    return ClockNoise(f"estimated from {log.clock.steps} steps of the fixes' clocks", (white, walk))


def _rms(vectors: Array) -> float:
    """Root mean square length."""
    return float(np.sqrt(np.nanmean(np.square(vectors).sum(-1))))


def summary(result: Positioned) -> str:
    """The lines of the summary: verdict, epochs, satellites, DOP, integrity and noise; then mean
    and scatter of the trusted positions, and their error if a position is known.
    """
    log, local, measured = result.log, result.local(result.mean), result.measured
    used, there, trusted = log.used, np.isfinite(result.mean[:, 0]), result.trusted
    fixes, positions = log.fixes[trusted, :3], result.mean[trusted, :3]
    count, fixed = used.sum(1), np.isfinite(log.fixes[:, 0])
    latitude, longitude, height = ecef2geodetic(*result.place, ell=ELLIPSOID)
    names = [log.names[s] for s in np.flatnonzero(used.any(0))]
    left_out = [f"{number} {reason}" for reason, number in log.left_out.items() if number]
    ionosphere = "by the broadcast coefficients"
    if not log.ionosphere:
        ionosphere = (
            "typical, not broadcast: no file has Klobuchar's coefficients, --ion gives them"
        )
    lines = [
        _verdict(result),
        f"epochs       {len(log.times)}, {civil(log.times[0])} to {civil(log.times[-1])} BDT; "
        f"{measured.sum()} with a position, "
        f"{(there & ~measured).sum()} more predicted without a range that is used, "
        f"{(~there).sum()} without a position",
        *([f"damaged      {_damaged(log.damaged)}"] if log.damaged else []),
        f"systems      {_systems(result)}",
        f"satellites   {len(names)} ({', '.join(names)}); {count.min()} to {count.max()} at a "
        f"time, mean {count.mean():.1f}",
        f"alone        {(fixed & (log.spare == 0)).sum()} epochs with just enough ranges; "
        f"{(~fixed).sum()} without a fix",
        f"integrity    {_integrity(log)}",
        f"DOP          median PDOP {np.nanmedian(log.dilution.position):.2f}, HDOP "
        f"{np.nanmedian(log.dilution.horizontal):.2f}, "
        f"VDOP {np.nanmedian(log.dilution.vertical):.2f}",
        f"left out     {'; '.join(left_out) or 'nothing'}",
        f"ionosphere   {ionosphere}",
        f"noise        ranges {_noise(log, 0, 'm')}; rates {_noise(log, 1, 'm/s')}",
        f"modeled      {_modeled(log)}",
        f"lasting      {_lasting(log)}",
        *(["motion       the receiver moved: no single position is right"] if log.moved else []),
        f"clock        {_clock(result)}",
        f"filter       {result.filter}; NIS {result.nis:.3f} per degree of freedom, 1 if noise and "
        f"motion are as assumed and noise is white; acceleration "
        f"{result.acceleration:.3g} m^2/s^3",
        f"mean         {' '.join(f'{v:.3f}' for v in result.place)} m; {latitude:.7f}°, "
        f"{longitude:.7f}°, {height:.2f} m",
        f"scatter      {_rms(positions - result.place):.3f} m in 3-D about its mean; "
        f"of the fixes of single epochs {_rms(fixes - np.nanmean(fixes, 0)):.3f} m",
    ]
    if result.reference is not None:
        parts = np.sqrt(np.square(local[trusted]).mean(0))
        ratio = np.square(local[trusted] / result.local_std[trusted]).mean(0)
        lines += [
            f"reference    {' '.join(f'{v:.3f}' for v in result.reference)} m, of the antenna: "
            f"{result.of}",
            f"error        {_rms(local[trusted]):.3f} m RMS in 3-D: east {parts[0]:.3f}, north "
            f"{parts[1]:.3f}, up {parts[2]:.3f}; "
            f"of the fixes of single epochs {_rms(fixes - result.reference):.3f} m",
            f"predicted    (error / deviation)^2: east {ratio[0]:.2f}, north {ratio[1]:.2f}, up "
            f"{ratio[2]:.2f}; 1 if the "
            "deviations are right; they lack errors common to all satellites, which residuals hide",
        ]
    return "\n".join(lines)


def _verdict(result: Positioned) -> str:
    """The headline: whether all positions are sound, or how many are not, when and why."""
    total, times = result.reported.sum(), result.log.times[result.doubtful]
    counts = Counter(result.integrity[result.doubtful].tolist())
    typical = "" if result.log.ionosphere else "; ionosphere: typical, not broadcast"
    if not times.size:
        return f"SOUND        all {total} positions agree with the ranges of their epochs{typical}"
    reasons = "; ".join(f"{n} {word} ({DOUBTS[word]})" for word, n in counts.items())
    since = f"from {civil(times[0])} to {civil(times[-1])} BDT"
    return (
        f"NOT SOUND    do not trust {times.size} of {total} positions, {since}: {reasons}{typical}"
    )


def _clock(result: Positioned) -> str:
    """The clock's process noise, the source of it, and how often the clock was set."""
    log, (source, (white, walk)) = result.log, result.clock
    set_by = [f"{np.count_nonzero(np.diff(log.jumps))} times by whole milliseconds"]
    if log.clock is not None:
        steps = np.count_nonzero(log.clock.reset[~result.distrusted])
        set_by.append(f"{steps} times by another step")
    return (
        f"noise of frequency {white:.3g} m^2/s white, {walk:.3g} m^2/s^3 random walk, {source}; "
        f"set {', '.join(set_by)}"
    )


def _damaged(messages: tuple[str, ...]) -> str:
    """How many damaged epochs and broadcast sets were left out, and their lines."""
    lines = "; ".join(messages[:MOST_LINES])
    rest = f"; and {len(messages) - MOST_LINES} more" if len(messages) > MOST_LINES else ""
    return f"{len(messages)} epochs or broadcast sets left out: {lines}{rest}"


def _systems(result: Positioned) -> str:
    """Which systems are used, how their clocks differ, and which systems are not used."""
    words = " and ".join(
        f"{SYSTEMS[letter].name} {SYSTEMS[letter].signal}" for letter in result.log.systems
    )
    for letter, offset in zip(result.log.systems[1:], result.mean.T[8:], strict=True):
        finite_offsets = offset[np.isfinite(offset)]
        longer = np.median(finite_offsets) if finite_offsets.size else np.nan
        words += f"; ranges of {SYSTEMS[letter].name} are longer by {longer:.2f} m (median)"
    if result.log.systems[1:]:
        words += ": clocks, and the receiver's delays"
    return words + (f"; not used: {', '.join(result.log.others)}" if result.log.others else "")


def _integrity(log: Log) -> str:
    """How many epochs were tested, and what was excluded."""
    S, tested = len(log.names), int(log.tested[:, 0].sum())
    if not log.tested.any():
        return (
            "not tested: no epoch has redundancy, or it was turned off; a faulty satellite would "
            "go unnoticed"
        )
    words = [f"{tested} epochs tested by their residuals"]
    for kind, part in (("ranges", slice(S)), ("rates", slice(S, 2 * S))):
        many = log.excluded[:, part].sum(0)
        named = ", ".join(
            f"{log.names[s]} {many[s]}" for s in np.argsort(-many, kind="stable") if many[s]
        )
        words.append(
            f"{kind} excluded at {log.excluded[:, part].any(1).sum()} epochs"
            + (f" ({named})" if named else "")
        )
    ranges, rates = log.unusable.sum(0)
    words.append(
        f"ranges of {ranges} epochs and rates of {rates} not used, as they contradict each other"
    )
    words.append(f"{len(log.times) - tested} without redundancy, which nothing tests")
    return "; ".join(words)


def _noise(log: Log, kind: int, unit: str) -> str:
    """The receiver's noise of ranges or rates, for each system with a separate estimate."""
    noise, words = log.noise[kind], []
    for j, (level, zenith) in enumerate(zip(noise.level, noise.zenith, strict=True)):
        name = f"{SYSTEMS[log.systems[j]].name} " if len(noise.level) > 1 else ""
        constant = f"{level:.4g} {unit} and " if level else ""
        words.append(f"{name}{constant}{zenith:.4g} {unit} / sin(elevation)")
    source = (
        f"estimated from {noise.redundancy} redundant ones" if noise.redundancy else "not estimated"
    )
    return f"{', '.join(words)}, {source}"


def _modeled(log: Log) -> str:
    """The size of the modeled range errors, which are not the receiver's noise."""
    sizes = np.sqrt(log.modeled[log.used])
    if not sizes.any():
        return "nothing: the given deviations include everything"
    return (
        f"what atmosphere and orbits leave in ranges, {np.median(sizes):.2f} m (median), "
        f"{sizes.min():.2f} to {sizes.max():.2f} m"
    )


def _lasting(log: Log) -> str:
    """Which part of the errors is correlated in time, and its correlation time."""
    words = [
        f"{kind.short:.0%} of the variance of {name} over {kind.time:.0f} s, {kind.long:.0%} for "
        "as long as a satellite is seen"
        for name, kind in zip(("ranges", "rates"), log.correlation, strict=True)
    ]
    return "; ".join(words)


def figures(result: Positioned) -> dict[str, Figure]:
    """Drawings by file stem: the track, and the sky."""
    return {"track": _track(result), "sky": _sky(result)}


def _track(result: Positioned) -> Figure:
    alone, local = result.local(result.log.fixes), result.local(result.mean)
    dots = dict[str, Any](linestyle="", marker=".", markersize=2.0)
    both = [
        curve(
            alone[:, 0], alone[:, 1], color=colors.MEASUREMENT, label="each epoch by itself", **dots
        ),
        curve(local[:, 0], local[:, 1], color=colors.ESTIMATE, label=result.filter, **dots),
    ]
    if result.doubtful.any():
        east, north, _ = local[result.doubtful].T
        doubtful = dots | {"marker": "x", "markersize": 5.0}
        both.append(curve(east, north, color=colors.PAPER, label="doubtful", **doubtful))
    shades = (colors.COMPARISON, colors.TRUTH, colors.ESTIMATE)
    moved = components(result.minutes, local, ("east", "north", "up"), shades, linewidth=0.9)
    title = f"from the {'known' if result.reference is not None else 'mean'} position"
    return panels(
        [
            Panel(title, both, "east (m)", "north (m)", more={"aspect": "equal"}),
            Panel(
                f"{result.filter}: {len(local)} epochs",
                moved,
                "time since the first fix (min)",
                "position (m)",
            ),
        ],
        height=3.4,
        width_ratios=(2, 3),
    )


def _sky(result: Positioned) -> Figure:
    log = result.log
    fig, axes = figure(WIDTH, 3.4, 1, 2)
    axes[0].remove()
    polar: Any = fig.add_subplot(1, 2, 1, projection="polar")
    polar.set_theta_zero_location("N")
    polar.set_theta_direction(-1)
    shown: set[str] = set()
    for s, kind in enumerate(kinds(log.names)):
        zenith_deg = np.where(log.used[:, s], 90.0 - np.degrees(log.elevation[:, s]), np.nan)
        label = None if kind in shown else str(kind)
        there = np.pad(np.isfinite(zenith_deg), 1)
        if there.any():
            shown.add(kind)
            # A line through neighboring epochs; a dot where an epoch has no neighbor.
            lone = there[1:-1] & ~there[:-2] & ~there[2:]
            look = dict[str, Any](linewidth=1.0, marker=".", markersize=1.5, markevery=lone)
            polar.plot(log.azimuth[:, s], zenith_deg, color=KIND_COLORS[kind], label=label, **look)
            last = int(np.flatnonzero(there)[-1]) - 1
            polar.annotate(log.names[s], (log.azimuth[last, s], zenith_deg[last]))
    polar.set_rlim(0.0, 90.0)
    polar.set_title("sky: zenith in the middle, north up")
    fig.legend(*polar.get_legend_handles_labels(), loc="outside lower left", ncols=4)
    axes[1].step(
        result.minutes, log.used.sum(1), color=colors.COMPARISON, label="satellites", where="post"
    )
    axes[1].plot(
        result.minutes, log.dilution.position, color=colors.ESTIMATE, label="PDOP", linewidth=0.9
    )
    high = max(float(log.used.sum(1).max()), 1.0)
    axes[1].set(
        xlabel="time since the first fix (min)", ylabel="number, PDOP (-)", ylim=(0.0, 1.3 * high)
    )
    axes[1].legend()
    return fig


FILES = ("summary.txt", "track.csv", *picture_names(("track", "sky")))
RECORDING = "position.rrd"


def write(result: Positioned, outputs: Outputs) -> None:
    """Write `FILES`. All contents are computed before the first file is written."""
    texts = {"summary.txt": summary(result) + "\n", "track.csv": table(result)}
    outputs.publish(texts, pictures(figures(result).items()))


def record_positioned(result: Positioned, path: Any) -> None:
    """Record the track, the sky and plots. Needs rerun.

    Raises
    ------
    OSError: if ``path`` cannot be written. ValueError: if it is a file that celnav did not make.
    """
    from celnav.show import recording, views

    log, local, alone = result.log, result.local(result.mean), result.local(result.log.fixes)
    times = log.times - log.times[0]
    middle = local[result.measured].mean(0)
    spread = 3.0 * max(_rms(local[result.measured] - middle), 0.1)
    growing = dict.fromkeys(("track/alone", "track/filter", "track/doubtful"), np.inf)
    eye = middle + np.array([0.0, -spread, 4.0 * spread])
    scatter = views.space("track", "east, north, up, m", eye=eye, target=middle, growing=growing)
    sky = views.space("sky", "sky over the receiver", eye=(0.0, -2.2, 1.6), growing={})
    left = views.rows(scatter, views.tabs(sky, views.text(origin="info", name="about")))
    plots = [views.plot(name, f"{name}, m") for name in ("east", "north", "up")]
    layout = views.columns(
        left,
        views.rows(*plots, views.plot("sats", "satellites and PDOP")),
        column_shares=(1, 1),
    )
    facts = {"filter": result.filter, "first": civil(log.times[0]), "epochs": len(times)}
    about: Any = {"name": "position", "properties": facts, "start_date": civil(log.times[0])}
    with recording.recording(path, times, layout=layout, **about) as out:
        out.text("info", "```\n" + summary(result) + "\n```")
        out.points("track/alone", alone, colors.MEASUREMENT, radius=1.2)
        out.points("track/filter", local, colors.ESTIMATE, radius=1.6)
        doubtful = np.where(result.doubtful[:, None], local, np.nan)
        out.points("track/doubtful", doubtful, colors.PAPER, radius=3.0)
        out.points("track/here", local, colors.TRUTH, radius=5.0, label=result.filter)
        if np.isfinite(result.cov).any():
            out.ellipsoids("track/ellipsoid", local, result.local_cov, colors.ESTIMATE, sigmas=1.0)
        std = result.local_std
        for i, name in enumerate(("east", "north", "up")):
            out.curve(
                f"{name}/alone", alone[:, i], colors.MEASUREMENT, "each epoch by itself", width=1.0
            )
            out.curve(f"{name}/filter", local[:, i], colors.ESTIMATE, result.filter)
            out.bounds(f"{name}/filter", std[:, i], result.filter, center=local[:, i], shown=False)
        out.curve("sats/used", log.used.sum(1), colors.COMPARISON, "satellites")
        out.curve("sats/pdop", log.dilution.position, colors.ESTIMATE, "PDOP")
        _record_sky(out, log)


def _record_sky(out: Any, log: Log) -> None:
    """Directions on a half sphere: east, north, up."""
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    rings = [
        np.stack([np.cos(e) * np.sin(angle), np.cos(e) * np.cos(angle), np.full(73, np.sin(e))], -1)
        for e in np.radians([0.0, 30.0, 60.0])
    ]
    out.path("sky/rings", [*rings, np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])], colors.FAINT)
    E, A = log.elevation, log.azimuth
    unit = np.stack([np.cos(E) * np.sin(A), np.cos(E) * np.cos(A), np.sin(E)], -1)
    for s, kind in enumerate(kinds(log.names)):
        if log.used[:, s].any():
            directions = np.where(log.used[:, s, None], unit[:, s], np.nan)
            out.points(
                f"sky/{log.names[s]}", directions, KIND_COLORS[kind], radius=4.0, label=log.names[s]
            )
