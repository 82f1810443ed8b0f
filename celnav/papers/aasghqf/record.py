"""Recordings: the first run of a preset in full, as the filters see it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.linalg import Array, matvec, semidefinite_root
from celnav.models import inertial
from celnav.papers.aasghqf.config import PRESETS
from celnav.papers.aasghqf.figures import COLORS, LABELS
from celnav.papers.aasghqf.scenario import BORESIGHTS, rules
from celnav.papers.aasghqf.study import COMPARED, Result, units
from celnav.show import colors

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.show.recording import Recorder

CASES = {"A-slow": "aasghqf_A_slow.rrd", "T3": "aasghqf_T3.rrd"}
RECORDINGS = list(CASES.values())
AXES = ("x", "y", "z")
STAR_M = 25000.0
"""Length of a drawn sight line."""


def record(result: Result, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    for preset, name in CASES.items():
        with outputs.path_for(name) as path:
            record_preset(result, preset, path)
    return RECORDINGS


def record_preset(result: Result, preset: str, path: Any) -> None:
    """Record the first run of a preset: the flight, the errors in a space of their own, sigma points, plots.

    Raises
    ------
    OSError: if ``path`` cannot be written. ValueError: if it is a file that celnav did not make.
    """
    from celnav.show import recording

    times = result.times(preset)
    facts = {"paper": "aasghqf", "preset": preset, "seed": result.seed, "runs": result.runs}
    layout = _layout(times)
    with recording.recording(path, times, name=f"aasghqf: {preset}", layout=layout, properties=facts) as out:
        out.text("info", _notes(result, preset))
        _flight(out, result, preset)
        _errors(out, result, preset)
        _points(out, result, preset)
        _plots(out, result, preset)
        found = result.facts["adapted"].coefficients
        out.bars("rule/index_set", list(found.values()), colors.COMPARISON)
        out.bars("eta", result.facts["observability"].svd, colors.ESTIMATE)
        for filter in COMPARED:
            covariance = result.data[preset][f"{filter}/cov"][:, 0]
            out.exact(f"state/{filter}", error=result.data[preset][f"{filter}/error"][:, 0], covariance=covariance)


def _layout(times: Array) -> Any:
    from celnav.show import views

    growing = {"world/aircraft/trail": np.inf, "world/sins/trail": np.inf}
    scene = views.space("world", "flight, m (east, north, up)", eye=(60e3, -70e3, 70e3), target=(90e3, 20e3, 0.0), growing=growing)
    errors = views.space("error", "position errors, m (origin: truth)", eye=(0.0, -90.0, 240.0), growing={"error/sar_fix": 60.0})
    cloud = views.tabs(
        *(views.space(f"points/{f}", f"sigma points of {LABELS[f]}, σ of SGHQF", eye=(9.0, -9.0, 6.0)) for f in COMPARED)
    )
    plots = views.rows(
        views.tabs(*(views.plot(f"att/{a}", f"log10 |φ{a}| error, deg", times) for a in AXES)),
        views.tabs(*(views.plot(f"attitude/{a}", f"φ{a} error, deg", times) for a in AXES)),
        views.tabs(*(views.plot(f"vel/{a}", f"{a} velocity error, m/s", times) for a in ("east", "north"))),
        views.tabs(*(views.plot(f"pos/{a}", f"{a} error, m", times, limits=(-100.0, 100.0)) for a in ("longitude", "latitude"))),
        views.plot("nees", "log10 NEES / 13 (gray: band)", times),
    )
    bars = views.tabs(views.text("info", "about"), views.bar_chart("eta", "degree of observability by state"),
                  views.bar_chart("rule/index_set", "coefficients of the adaptive grid"))  # fmt: skip
    return views.columns(views.rows(scene, views.columns(errors, cloud), bars, shares=(5, 4, 4)), plots, shares=(6, 5))


def _notes(result: Result, preset: str) -> str:
    c = PRESETS[preset]
    return f"""# Liang et al. (2014), preset {preset}

**The UKF's first star fix leaves it overconfident, and it takes minutes to forget; a sparse grid with 57 points is as good as
that of 417.**

An aircraft turns at 200 m/s and 20 km. Its inertial system starts with a large misalignment and drifts away (gray) while star
sensors and SAR fixes let filters estimate its error. Left above: truth (green), the system (gray), the stars where they are
(white) and where the system expects them (blue). Below: position errors with 3σ ellipsoids, and the sigma points of the
misalignment about the truth (green): blue of positive, red of negative weight. Blue: UKF. Orange: SGHQF. Purple: AASGHQF.

| | |
|---|---|
| misalignment, 1σ | {", ".join(f"{v:g}" for v in c.misalignment_deg)} deg |
| star fixes | {c.star_arcsec:g} arcsec, each {c.star_interval * c.step_s:g} s |
| SAR fixes | {c.sar_m:g} m, each {c.sar_interval * c.step_s:g} s |
| gyro | {c.drift_deg_per_h:g} deg/h, {c.angle_walk_deg_per_sqrt_h:g} deg/√h |
| accelerometer | {c.bias_ug:g} µg, {c.velocity_walk_ug_per_sqrt_hz:g} µg/√Hz |
| runs, seed | {result.runs}, {result.seed} |
"""


def _flight(out: Recorder, result: Result, preset: str) -> None:
    config, data = PRESETS[preset], result.data[preset]
    steps = len(result.times(preset)) - 1
    flight, epochs = config.flight, 2 * np.arange(steps + 1)
    east_north = (
        np.stack([flight.longitude - flight.longitude[0], flight.latitude - flight.latitude[0]], -1)[epochs] * config.meters
    )
    place = np.concatenate([east_north, np.zeros((steps + 1, 1))], -1)
    truth = data["truth"][:, 0]
    drifted = place.copy()
    drifted[:, :2] += truth[:, inertial.POSITION] * config.meters
    attitude = flight.attitude[epochs]
    computed = inertial.misalignment_matrix(truth[:, inertial.PHI]) @ attitude
    out.trail("world/aircraft/trail", place, colors.TRUTH, radius=2.5)
    out.points("world/aircraft/here", place, colors.TRUTH, radius=6.0, label="aircraft")
    out.trail("world/sins/trail", drifted, colors.SIGMA, radius=1.5)
    out.points("world/sins/here", drifted, colors.SIGMA, radius=4.0, label="inertial system")
    for k, star in enumerate(BORESIGHTS, start=1):
        out.arrow(f"world/aircraft/star{k}/sight", place, STAR_M * (attitude @ star), "#FFFFFF", f"star {k}")
        out.arrow(f"world/aircraft/star{k}/expected", place, STAR_M * (computed @ star), colors.MEASUREMENT, "")
    fix = data["z"][:, 0, 6:] - truth[:, inertial.POSITION]
    out.points("world/sar_fix", np.where(np.isfinite(fix[:, :1]), place, np.nan), colors.MEASUREMENT, radius=3.0)
    error = np.concatenate([fix * config.meters, np.zeros((steps + 1, 1))], -1)
    out.points("error/sar_fix", error, colors.MEASUREMENT, radius=2.0)


def _errors(out: Recorder, result: Result, preset: str) -> None:
    """Horizontal position errors; the ellipsoids are as thin as the height is known."""
    config, data = PRESETS[preset], result.data[preset]
    length = 50.0
    out.path("error/axes", [np.array([[0.0, 0.0, 0.0], row]) for row in length * np.eye(3)], colors.FAINT)
    for filter in COMPARED:
        error = data[f"{filter}/error"][:, 0, 5:7]
        flat = np.concatenate([error, np.zeros((len(error), 1))], -1)
        covariance = np.zeros((len(error), 3, 3))
        scale = np.outer(config.meters, config.meters)
        covariance[:, :2, :2] = data[f"{filter}/cov"][:, 0, 5:7, 5:7] * scale
        covariance[:, 2, 2] = 0.5**2
        out.points(f"error/{filter}/estimate", flat, COLORS[filter], radius=4.0)
        out.ellipsoids(f"error/{filter}/ellipsoid", flat, covariance, COLORS[filter])


def _points(out: Recorder, result: Result, preset: str) -> None:
    """The misalignment of the sigma points about the truth, in deviations of SGHQF, by the sign of their weights."""
    deviation = np.sqrt(result.data[preset]["sghqf/cov"][:, 0].diagonal(0, -2, -1))[:, :3] * np.degrees(1.0)
    for filter in COMPARED:
        rule, data = rules()[filter], result.data[preset]
        root = semidefinite_root(data[f"{filter}/cov"][:, 0])
        error = data[f"{filter}/error"][:, 0, :3]
        moved = rule.nodes[:, :3].any(-1) | (np.arange(len(rule.nodes)) == 0)
        for name, chosen, color in (("positive", rule.wm > 0.0, colors.COMPARISON), ("negative", rule.wm < 0.0, colors.PAPER)):
            nodes = rule.nodes[moved & chosen]
            spread = np.degrees(matvec(root[:, None], nodes[None]))[..., :3]
            out.points(f"points/{filter}/{name}", (error[:, None] + spread) / deviation[:, None], color, radius=2.5)
        out.points(f"points/{filter}/truth", np.zeros_like(error), colors.TRUTH, radius=5.0)


def _plots(out: Recorder, result: Result, preset: str) -> None:
    data, scale = result.data[preset], units(PRESETS[preset])
    groups = [("att", a, i) for i, a in enumerate(AXES)]
    groups += [("vel", "east", 3), ("vel", "north", 4), ("pos", "longitude", 5), ("pos", "latitude", 6)]
    for filter in COMPARED:
        std = np.sqrt(data[f"{filter}/cov"][:, 0].diagonal(0, -2, -1)) * scale
        for group, name, i in groups:
            error = data[f"{filter}/error"][:, 0, i]
            if group == "att":
                out.log_curve(f"att/{name}/{filter}", np.abs(error), COLORS[filter], LABELS[filter])
                out.log_curve(f"att/{name}/{filter}/3s", 3.0 * std[:, i], COLORS[filter], f"3σ {LABELS[filter]}", width=0.8)
            entity = f"{'attitude' if group == 'att' else group}/{name}/{filter}"
            out.curve(entity, error, COLORS[filter], LABELS[filter])
            out.bounds(entity, std[:, i], LABELS[filter], shown=filter == "sghqf", color=COLORS[filter])
        out.log_curve(f"nees/{filter}", data[f"{filter}/nees"][:, 0] / 13.0, COLORS[filter], LABELS[filter])
    for name, level in zip(("low", "high"), chi_square_band(13, 1), strict=True):
        out.level(f"nees/{name}", float(np.log10(level / 13.0)), "95 % band")
