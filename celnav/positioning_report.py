"""What comes of positioning a receiver: a summary, a table, figures and a recording."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from pymap3d import ecef2geodetic

from celnav import colors
from celnav.figures import figure
from celnav.files import Outputs
from celnav.filters.driver import run
from celnav.linalg import Array
from celnav.models import pseudorange
from celnav.models.beidou import ELLIPSOID, GEO_NUMBERS
from celnav.models.receiver import on_earth
from celnav.positioning import Log
from celnav.positioning_filters import filters
from celnav.rinex import BDT_BEGINNING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KIND_COLORS = {"GEO": colors.PAPER, "IGSO": colors.ESTIMATE, "MEO": colors.COMPARISON}
IGSO_NUMBERS = frozenset({*range(6, 11), 13, 16, 31, 38, 39, 40, 56})
"""Inclined geosynchronous satellites of BeiDou-2 and -3."""


def kinds(names: Sequence[str]) -> Array:
    """GEO, IGSO or MEO, of satellites by name."""
    numbers = [int(name[1:]) for name in names]
    return np.array(["GEO" if n in GEO_NUMBERS else "IGSO" if n in IGSO_NUMBERS else "MEO" for n in numbers])


@dataclass(frozen=True)
class Positioned:
    """A receiver's track.

    Attributes
    ----------
    log: what the filter took. filter: its name. mean: ``(T, 8)`` states. cov: ``(T, 3, 3)`` m^2 of the position.
    reference: ``(3,)`` m, a known position to compare with; None if there is none.
    """

    log: Log
    filter: str
    mean: Array
    cov: Array
    reference: Array | None

    @property
    def origin(self) -> Array:
        """Of the local frame: the known position, else the mean one."""
        return np.nanmean(self.mean[:, :3], 0) if self.reference is None else self.reference

    @cached_property
    def axes(self) -> Array:
        """East, north and up there, the rows of ``(3, 3)``."""
        latitude, longitude, _ = ecef2geodetic(*self.origin, ell=ELLIPSOID, deg=False)
        return pseudorange.local_axes(latitude, longitude)

    def local(self, positions: Array) -> Array:
        """East, north, up ``(..., 3)`` m of positions ``(..., 3 or more)``."""
        return np.asarray((positions[..., :3] - self.origin) @ self.axes.T)

    @property
    def minutes(self) -> Array:
        """Since the first fix, ``(T,)``."""
        return np.asarray((self.log.times - self.log.times[0]) / 60.0)


def position(log: Log, filter: str, reference: Array | None, *, acceleration: float = 0.01) -> Positioned:
    """Run a filter of `celnav.positioning_filters.filters` over a log; "ls" takes each epoch by itself.

    Raises
    ------
    ValueError: for an unknown filter, or a reference that is far from the Earth's surface. FilterError: if the filter is lost.
    """
    known = filters(len(log.names), acceleration=acceleration)
    if reference is not None:
        on_earth("reference", reference)
    if filter == "ls":
        return Positioned(log, filter, log.fixes, log.fix_cov, reference)
    if filter not in known:
        raise ValueError(f"filter: expected one of ls, {', '.join(known)}, got {filter!r}")
    track = run(known[filter], log.prior(), log.epochs(), keep="spread")
    assert track.mean is not None
    return Positioned(log, filter, track.mean, track.cov[:, :3, :3], reference)


def _rms(vectors: Array) -> float:
    """Root mean square length."""
    return float(np.sqrt(np.nanmean(np.square(vectors).sum(-1))))


def summary(found: Positioned) -> str:
    """In lines: epochs, satellites, DOP, scatter, and the error if a position is known."""
    log, local = found.log, found.local(found.mean)
    used, there = log.used, np.isfinite(found.mean[:, 0])
    count, fixed = used.sum(1), np.isfinite(log.fixes[:, 0])
    place = np.nanmean(found.mean[:, :3], 0)
    latitude, longitude, height = ecef2geodetic(*place, ell=ELLIPSOID)
    names = [log.names[s] for s in np.flatnonzero(used.any(0))]
    scatter = local - np.nanmean(local, 0)
    lines = [
        f"epochs       {len(log.times)}, {civil(log.times[0])} to {civil(log.times[-1])} BDT; {there.sum()} with a position",
        f"satellites   {len(names)} ({', '.join(names)}); {count.min()} to {count.max()} at a time, mean {count.mean():.1f}",
        f"alone        {(fixed & (count == 4)).sum()} epochs with four, no redundancy; {(~fixed).sum()} with fewer",
        f"DOP          median PDOP {np.nanmedian(log.dilution.position):.2f}, HDOP {np.nanmedian(log.dilution.horizontal):.2f}, "
        f"VDOP {np.nanmedian(log.dilution.vertical):.2f}",
        f"left out     {'; '.join(f'{number} {reason}' for reason, number in log.left_out.items())}",
        f"ionosphere   {'by the broadcast coefficients' if log.ionosphere else 'not corrected: the header has no GPSA and GPSB'}",
        f"clock        set {np.count_nonzero(np.diff(log.jumps))} times by whole milliseconds",
        f"filter       {found.filter}",
        f"mean         {place[0]:.3f} {place[1]:.3f} {place[2]:.3f} m; {latitude:.7f}°, {longitude:.7f}°, {height:.2f} m",
        f"scatter      {_rms(scatter):.3f} m in 3-D about its mean; of each epoch by itself "
        f"{_rms(log.fixes[:, :3] - np.nanmean(log.fixes[:, :3], 0)):.3f} m",
    ]
    if found.reference is not None:
        parts = np.sqrt(np.nanmean(np.square(local), 0))
        alone = _rms(log.fixes[:, :3] - found.reference)
        lines.append(
            f"error        {_rms(local):.3f} m RMS in 3-D: east {parts[0]:.3f}, north {parts[1]:.3f}, up {parts[2]:.3f}; "
            f"of each epoch by itself {alone:.3f} m"
        )
    return "\n".join(lines)


def civil(t: float) -> str:
    """Date and time of seconds of BDT."""
    return str(BDT_BEGINNING + np.timedelta64(round(t * 1e3), "ms"))[:19]


COLUMNS = ("time_bdt", "seconds_bdt", "x_m", "y_m", "z_m", "vx_m_per_s", "vy_m_per_s", "vz_m_per_s", "clock_m", "drift_m_per_s",
           "east_m", "north_m", "up_m", "std_east_m", "std_north_m", "std_up_m", "satellites", "pdop")  # fmt: skip


def table(found: Positioned) -> str:
    """All epochs as CSV; empty where there is nothing. ``clock_m`` is the receiver's clock with what it was set by."""
    local, log = found.local(found.mean), found.log
    std = np.sqrt((found.axes @ found.cov @ found.axes.T).diagonal(0, -2, -1))
    mean = found.mean.copy()
    mean[:, 6] += log.jumps
    numbers = np.column_stack([log.times, mean, local, std, log.used.sum(1), log.dilution.position])
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for t, row in zip(log.times, numbers, strict=True):
        writer.writerow([civil(t), *(f"{v:.4f}".rstrip("0").rstrip(".") if np.isfinite(v) else "" for v in row)])
    return text.getvalue()


def figures(found: Positioned) -> dict[str, Figure]:
    """Drawings by file stem: the track, and the sky."""
    return {"track": _track(found), "sky": _sky(found)}


def _track(found: Positioned) -> Figure:
    fig, axes = figure(10.0, 4.2, 1, 2, width_ratios=(2, 3))
    alone, local, minutes = found.local(found.log.fixes), found.local(found.mean), found.minutes
    axes[0].plot(alone[:, 0], alone[:, 1], ".", markersize=2.0, color=colors.MEASUREMENT, label="each epoch by itself")
    axes[0].plot(local[:, 0], local[:, 1], ".", markersize=2.0, color=colors.ESTIMATE, label=found.filter)
    origin = "known position" if found.reference is not None else "mean position"
    axes[0].set(xlabel="east (m)", ylabel="north (m)", aspect="equal", title=f"from the {origin}")
    axes[0].legend(markerscale=3)
    for i, (name, color) in enumerate(
        zip(("east", "north", "up"), (colors.COMPARISON, colors.TRUTH, colors.ESTIMATE), strict=True)
    ):
        axes[1].plot(minutes, local[:, i], color=color, linewidth=0.9, label=name)
    axes[1].set(xlabel="time since the first fix (min)", ylabel="position (m)", title=f"{found.filter}: {len(minutes)} epochs")
    axes[1].legend()
    return fig


def _sky(found: Positioned) -> Figure:
    log = found.log
    fig, axes = figure(10.0, 4.2, 1, 2, width_ratios=(2, 3))
    axes[0].remove()
    polar: Any = fig.add_subplot(1, 2, 1, projection="polar")
    polar.set_theta_zero_location("N")
    polar.set_theta_direction(-1)
    shown: set[str] = set()
    for s, kind in enumerate(kinds(log.names)):
        seen = np.where(log.used[:, s], 90.0 - np.degrees(log.elevation[:, s]), np.nan)
        label = None if kind in shown else str(kind)
        if np.isfinite(seen).any():
            shown.add(kind)
            polar.plot(log.azimuth[:, s], seen, ".", markersize=1.5, color=KIND_COLORS[kind], label=label)
            last = int(np.flatnonzero(np.isfinite(seen))[-1])
            polar.annotate(log.names[s], (log.azimuth[last, s], seen[last]), fontsize=6)
    polar.set_rlim(0.0, 90.0)
    polar.set_title("sky: zenith in the middle, north up")
    fig.legend(*polar.get_legend_handles_labels(), loc="outside lower left", markerscale=4, ncols=3)
    axes[1].step(found.minutes, log.used.sum(1), color=colors.COMPARISON, label="satellites", where="post")
    axes[1].plot(found.minutes, log.dilution.position, color=colors.ESTIMATE, label="PDOP", linewidth=0.9)
    high = max(float(log.used.sum(1).max()), 1.0)
    axes[1].set(xlabel="time since the first fix (min)", ylabel="number, PDOP (-)", ylim=(0.0, 1.3 * high))
    axes[1].legend()
    return fig


FILES = ("summary.txt", "track.csv", "track.png", "track.svg", "sky.png", "sky.svg")
RECORDING = "position.rrd"


def write(found: Positioned, outputs: Outputs) -> None:
    """Write `FILES`, all of which are made before the first is written."""
    from celnav.drawing import render

    drawn = {f"{stem}.{kind}": render(drawing, kind) for stem, drawing in figures(found).items() for kind in ("png", "svg")}
    texts = {"summary.txt": summary(found) + "\n", "track.csv": table(found)}
    for name in FILES:
        outputs.bytes(name, drawn[name] if name in drawn else texts[name].encode("utf-8"))


def record_positioned(found: Positioned, path: Any) -> None:
    """Record the track, the sky and plots. Needs rerun.

    Raises
    ------
    OSError: if ``path`` cannot be written. ValueError: if it is a file that celnav did not make.
    """
    from celnav import recording, views

    log, local, alone = found.log, found.local(found.mean), found.local(found.log.fixes)
    times = log.times - log.times[0]
    spread = 3.0 * max(_rms(local - np.nanmean(local, 0)), 0.1)
    middle = np.nanmean(local, 0)
    growing = {"track/alone": np.inf, "track/filter": np.inf}
    scatter = views.space(
        "track", "east, north, up, m", eye=middle + np.array([0.0, -spread, 4.0 * spread]), target=middle, growing=growing
    )
    left = views.rows(
        scatter,
        views.tabs(views.space("sky", "sky over the receiver", eye=(0.0, -2.2, 1.6), growing={}), views.text("info", "about")),
    )
    plots = [views.plot(name, f"{name}, m", times) for name in ("east", "north", "up")]
    layout = views.columns(left, views.rows(*plots, views.plot("sats", "satellites and PDOP", times)), shares=(1, 1))
    facts = {"filter": found.filter, "first": civil(log.times[0]), "epochs": len(times)}
    with recording.recording(path, times, name="position", layout=layout, properties=facts) as out:
        out.text("info", "```\n" + summary(found) + "\n```")
        out.points("track/alone", alone, colors.MEASUREMENT, radius=1.2)
        out.points("track/filter", local, colors.ESTIMATE, radius=1.6)
        out.points("track/here", local, colors.TRUTH, radius=5.0, label=found.filter)
        if np.isfinite(found.cov).any():
            out.ellipsoids("track/ellipsoid", local, found.axes @ found.cov @ found.axes.T, colors.ESTIMATE, sigmas=1.0)
        std = np.sqrt((found.axes @ found.cov @ found.axes.T).diagonal(0, -2, -1))
        for i, name in enumerate(("east", "north", "up")):
            out.curve(f"{name}/alone", alone[:, i], colors.MEASUREMENT, "each epoch by itself", width=1.0)
            out.curve(f"{name}/filter", local[:, i], colors.ESTIMATE, found.filter)
            out.bounds(f"{name}/filter", std[:, i], found.filter, center=local[:, i], shown=False)
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
            seen = np.where(log.used[:, s, None], unit[:, s], np.nan)
            out.points(f"sky/{log.names[s]}", seen, KIND_COLORS[kind], radius=4.0, label=log.names[s])
