"""Recordings: the first run with the burst, and, where its files are given, the receiver's half day."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from pymap3d import geodetic2ecef

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.linalg import Array
from celnav.models import pseudorange
from celnav.models.beidou import ELLIPSOID, GRAVITY_PARAMETER, ROTATION_RATE, Broadcast, satellites, turned
from celnav.papers.aukf.constellation import synthetic
from celnav.papers.aukf.evidence import AXES, LABELS, size
from celnav.papers.aukf.figures import COLORS
from celnav.papers.aukf.scenario import START_S, TOE_S, axes, circle, visible
from celnav.papers.aukf.study import Result
from celnav.receiver.report import KIND_COLORS, kinds, record_positioned
from celnav.show import colors

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.show.recording import Recorder

BURST, REAL = "aukf_burst.rrd", "aukf_real.rrd"
RECORDINGS = [BURST, REAL]
CASE = "ranges"
SHOWN = ("ls", "ekf", "aukf", "group")
EARTH_KM = ELLIPSOID.semimajor_axis / 1e3


def record(result: Result, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    with outputs.path_for(BURST) as path:
        record_burst(result, path)
    if result.real is None:
        return [BURST]
    with outputs.path_for(REAL) as path:
        record_positioned(result.real.positioned(), path)
    return RECORDINGS


def record_burst(result: Result, path: Any) -> None:
    """Record the first run with the burst: satellites about the Earth, the track, its errors, plots.

    Raises
    ------
    OSError: if ``path`` cannot be written. ValueError: if it is a file that celnav did not make.
    """
    from celnav.show import recording

    times = result.times()
    facts = {"paper": "aukf", "preset": "burst", "seed": result.seed, "runs": result.runs}
    with recording.recording(path, times, name="aukf: burst", layout=_layout(times), properties=facts) as out:
        out.text("info", _notes(result))
        start, end = result.config.burst_s
        out.event("events/burst", start, f"{result.config.burst_sigma:g} m of noise on all ranges begin")
        out.event("events/burst", end, "they end")
        _sky(out, result)
        _track(out, result)
        _plots(out, result)
        for filter in ("ekf", "aukf"):
            data = result.data["main"]
            key = f"{CASE}/{filter}"
            out.exact(f"state/{filter}", error=data[f"{key}/error"][:, 0], covariance=data[f"{key}/cov"][:, 0])


def _layout(times: Array) -> Any:
    from celnav.show import views

    growing = {f"track/{name}": np.inf for name in ("truth", *SHOWN)}
    scenes = views.tabs(
        views.space("world", "satellites, 1000 km (Earth-fixed)", eye=(-45.0, 68.0, 40.0)),
        views.space("track", "track, m (east, north, up)", eye=(0.0, -9e3, 9e3), growing=growing),
    )
    errors = views.space("error", "position errors, m (origin: truth)", eye=(4.0, -12.0, 9.0))
    plots = [
        views.plot("err/3d", "log10 position error, m", times),
        *(views.plot(f"err/{axis.lower()}", f"error of {axis}, m", times, limits=(-4.0, 4.0)) for axis in AXES),
    ]
    bottom = views.tabs(
        views.plot("adapt/A_rho", "log10 A of the ranges", times),
        views.plot("adapt/A_rr", "log10 A of the rates", times),
        views.plot("nis", "log10 NIS per measurement (gray: band)", times),
        views.plot("dop", "dilution of precision", times),
        views.log("events", "events"),
    )
    left = views.rows(scenes, views.tabs(errors, views.text("info", "about")), shares=(5, 4))
    return views.rows(views.columns(left, views.rows(*plots), shares=(6, 5)), bottom, shares=(7, 3))


def _notes(result: Result) -> str:
    c = result.config
    return f"""# Fan et al., {c.burst_sigma:g} m of noise on all ranges from {c.burst_s[0]:g} to {c.burst_s[1]:g} s

**Adapting the noise of the measurement shrugs the burst off; the EKF (gray), which equals the UKF, takes it for position.**

A receiver circles with {c.acceleration_g:g} g at {c.speed_m_per_s:g} m/s. Orange: AUKF. Green: group parity, which knows the
noise from what no position explains, and needs no window. Light blue: each epoch by itself.

| | |
|---|---|
| interval | {c.interval_s:g} s |
| noise of ranges, rates | {c.true_sigma_range_m:g} m, {c.sigma_rate_m_per_s:g} m/s |
| process noise | {c.acceleration_noise:.4g} m²/s³ |
| window | {c.window} epochs |
| satellites | {len(result.facts["geometry"].names)} |
| runs, seed | {result.runs}, {result.seed} |
"""


def _orbit(broadcast: Broadcast, t: float) -> list[Array]:
    """Lines ``(points, 3)`` km: orbits as they lie in space, on axes that are Earth-fixed at the time."""
    period = 2.0 * np.pi * broadcast.sqrt_a**3 / np.sqrt(GRAVITY_PARAMETER)
    away = np.linspace(0.0, 1.0, 91)[:, None] * period
    P = satellites(broadcast, t + away).position
    return list(np.moveaxis(turned(P, -ROTATION_RATE * away), 1, 0) / 1e6)


def _sky(out: Recorder, result: Result) -> None:
    """Lengths in 1000 km: those of the ground are lost in the picture anyway."""
    c, t = result.config, result.times()
    position, velocity = circle(c)
    broadcast, seen = synthetic(TOE_S), visible(c)
    everywhere = pseudorange.sources(broadcast, START_S + t, position, velocity).q / 1e6
    out.globe("world/earth", EARTH_KM / 1e3)
    names = np.array(broadcast.names)
    for kind, color in KIND_COLORS.items():
        chosen = kinds(broadcast.names) == kind
        out.path(f"world/orbit/{kind}", _orbit(broadcast.chosen(chosen), START_S), color, radius=0.3)
        for s in np.flatnonzero(chosen):
            out.points(f"world/sat/{names[s]}", everywhere[:, s], color, radius=4.0, label=str(names[s]))
    here = np.repeat(position[:, None] / 1e6, len(seen.names), 1)
    shades = [KIND_COLORS[kind] for kind in kinds(seen.names)]
    out.strips("world/sight", np.stack([here, seen.q / 1e6], 2), shades, radius=0.5)
    out.points("world/receiver", position / 1e6, colors.TRUTH, radius=4.0, label="receiver")


def _track(out: Recorder, result: Result) -> None:
    c, data = result.config, result.data["main"]
    middle = np.array(geodetic2ecef(c.latitude_deg, c.longitude_deg, c.height_m, ell=ELLIPSOID))
    local, position = axes(c), circle(c)[0]
    truth = (position - middle) @ local.T
    out.trail("track/truth", truth, colors.TRUTH, radius=2.0)
    out.path("error/axes", [np.array([[0.0, 0.0, 0.0], row]) for row in 3.0 * np.eye(3)], colors.FAINT)
    for filter in SHOWN:
        error = data[f"{CASE}/{filter}/error"][:, 0, :3] @ local.T
        out.trail(f"track/{filter}", truth + error, COLORS[filter], radius=1.0)
        if filter == "ls":
            continue
        out.points(f"track/{filter}/here", truth + error, COLORS[filter], radius=4.0, label=LABELS[filter])
        out.points(f"error/{filter}", error, COLORS[filter], radius=4.0, label=LABELS[filter])
        if filter != "group":
            covariance = local @ data[f"{CASE}/{filter}/cov"][:, 0, :3, :3] @ local.T
            out.ellipsoids(f"error/{filter}/ellipsoid", error, covariance, COLORS[filter])
            out.ellipsoids(f"track/{filter}/ellipsoid", truth + error, covariance, COLORS[filter])


def _plots(out: Recorder, result: Result) -> None:
    data, names = result.data["main"], result.facts["geometry"].names
    for filter in SHOWN:
        error = data[f"{CASE}/{filter}/error"][:, 0]
        out.log_curve(f"err/3d/{filter}", size(error), COLORS[filter], LABELS[filter])
        if filter == "ls":
            continue
        std = np.sqrt(data[f"{CASE}/{filter}/cov"][:, 0].diagonal(0, -2, -1))
        for i, axis in enumerate(AXES):
            out.curve(f"err/{axis.lower()}/{filter}", error[:, i], COLORS[filter], LABELS[filter])
            out.bounds(f"err/{axis.lower()}/{filter}", std[:, i], LABELS[filter], shown=filter == "aukf", color=COLORS[filter])
    factor = data[f"{CASE}/aukf/factor"][:, 0]
    S = factor.shape[-1] // 2
    for s, (name, kind) in enumerate(zip(names, kinds(names), strict=True)):
        out.log_curve(f"adapt/A_rho/{name}", factor[:, s], KIND_COLORS[kind], name)
        out.log_curve(f"adapt/A_rr/{name}", factor[:, S + s], KIND_COLORS[kind], name)
    for filter in ("ekf", "aukf", "group"):
        nis = data[f"{CASE}/{filter}/nis"][:, 0] / (2 * S)
        out.log_curve(f"nis/{filter}", nis, COLORS[filter], LABELS[filter])
    for name, level in zip(("low", "high"), chi_square_band(2 * S, 1), strict=True):
        out.level(f"nis/{name}", float(np.log10(level / (2 * S))), "95 % band")
    shades = (colors.SIGMA, colors.COMPARISON, colors.TRUTH, colors.ESTIMATE, colors.OPEN_LOOP)
    for (name, values), color in zip(result.facts["geometry"].dilution._asdict().items(), shades, strict=True):
        out.curve(f"dop/{name}", values[: len(result.times())], color, name)
    out.curve("dop/satellites", np.full(len(result.times()), float(S)), colors.FAINT, "satellites", shown=False)
