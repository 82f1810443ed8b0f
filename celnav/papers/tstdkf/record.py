"""The recording: the first run of setting 1, about the Earth and around the Sun, the errors as if under a microscope, plots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.metrics import chi_square_band, rms
from celnav.gaussian.linalg import Array
from celnav.models.ephemeris import de421
from celnav.papers.tstdkf.config import DAY_S, SETTINGS
from celnav.papers.tstdkf.ephemerides import table
from celnav.papers.tstdkf.evidence import AXES
from celnav.papers.tstdkf.figures import COLORS, SHADES
from celnav.papers.tstdkf.scenario import PULLING
from celnav.papers.tstdkf.study import PAPER, Result
from celnav.papers.tstdkf.year import TRENDS
from celnav.show import colors

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.show.recording import Recorder

RECORDINGS = ["tstdkf.rrd", "tstdkf_year.rrd"]
SHOWN = (*PAPER, "aug")
EVERY, EVERY_YEAR = 9, 6
"""Steps from one row to the next. An orbit has 20: every tenth would show two of its places only."""
ORBIT = 20
"""Steps of an orbit."""
EXAGGERATION = 1000.0
"""By how much errors of a position are drawn larger than they are."""
ARROW_KM, AU_KM = 4000.0, 1.495978707e8
EARTH_KM = 6378.137


def record(result: Result, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    from celnav.show import recording

    every = EVERY if len(result.times) > 20 * EVERY else 1
    times = result.times[::every]
    facts = {"paper": "tstdkf", "seed": result.seed, "runs": result.runs, "exaggeration": EXAGGERATION}
    with outputs.path_for(RECORDINGS[0]) as path:
        layout = _layout(times)
        with recording.recording(path, times, name="tstdkf", layout=layout, properties=facts, counter="step") as out:
            out.text("info", _notes(result))
            _about_the_earth(out, result, every)
            _around_the_sun(out, result, times)
            _plots(out, result, every)
            for filter in SHOWN:
                data = result.data["table 5"]
                mean, cov = data[f"1/{filter}/first/mean"][::every, 0], data[f"1/{filter}/first/cov"][::every, 0]
                out.exact(f"state/{filter}", mean=mean, covariance=cov)
    _record_year(result, outputs, facts)
    return RECORDINGS


def _layout(times: Array) -> Any:
    from celnav.show import views

    earth = views.space(
        "world", "about the Earth, km (errors x1000)", eye=(15e3, 11e3, 9e3), target=(0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0)
    )
    sun = views.space("sun", "around the Sun, AU", eye=(0.5, -2.2, 1.6), target=(0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0))
    errors = views.space("error_view", "position error (km) with 3σ ellipsoid of AUG", eye=(0.9, -0.9, 0.6), up=(0.0, 0.0, 1.0))
    plots = views.rows(
        views.tabs(
            views.plot("err/pos", "position error, km", times, limits=(0.0, 0.8)),
            views.plot("err/vel", "velocity error, m/s", times, limits=(0.0, 0.8)),
        ),
        views.tabs(*(views.plot(f"bias/{a}", f"ephemeris error {a}, km", times, limits=(-0.4, 0.4)) for a in AXES)),
        views.tabs(
            views.plot("lambda", "factors of strong tracking", times, limits=(0.0, 12.0)),
            views.plot("nis", "NIS", times, limits=(0.0, 20.0)),
        ),
        views.tabs(*(views.plot(f"residual/{i}", f"residual of pulsar {i + 1}, km", times, limits=(-2.0, 2.0)) for i in range(3))),
        views.tabs(
            views.plot("accel", "log10 of third bodies' pull, km/s²", times),
            views.plot("ephem", "DE405 - DE421 of the Earth, km", times),
        ),
    )
    below = views.tabs(views.text("info", "about"), errors)
    return views.columns(views.rows(views.tabs(earth, sun), below, shares=(5, 4)), plots, shares=(6, 5))


def _notes(result: Result) -> str:
    c, s = result.config, SETTINGS[1]
    size = {name: rms(result.squares(name, "position")) for name in (*SHOWN, "tkf-fair")}
    ekf, tkf = (100.0 * (1.0 - size["tstdkf"] / size[name]) for name in ("ekf", "tkf"))
    return f"""# Xu et al. (2024): two stages and strong tracking for X-ray pulsars

* **{ekf:.0f} % below the EKF, {tkf:.0f} % below the two-stage filter (TKF):** attained with tuned parameters.
* **Most of the second gain is tuning of the baseline:** TKF with the covariances that the noise really has comes to
  {size["tkf-fair"]:.4f} km, TSTDKF to {size["tstdkf"]:.4f} km.
* **The exact filter (AUG) takes what is there:** {size["aug"]:.4f} km.

A satellite times three pulsars every {c.step_s:g} s for {c.days:g} days. The Earth's ephemeris is wrong by some hundred
meters (plots: ephemeris error), the noise is colored and correlated: setting 1, F = {s.F:g}, L = {s.L:g}, κ = {s.kappa:g}.
Lines: the last orbit (white) and what the filters made of it, with
errors {EXAGGERATION:g} times as large as they are. Pink: EKF. Blue: TKF. Orange: TSTDKF. Green: AUG. Arrows: white to the pulsars,
yellow and gray the pulls of Sun and Moon, as long as they are strong.

Occultation by the Earth, exclusion near the Sun and one detector for three pulsars are left out, as in the paper.
"""


def _about_the_earth(out: Recorder, result: Result, every: int) -> None:
    data = result.data["table 5"]
    truth = data["1/truth"][::every, 0, :3]
    out.globe("world/earth", EARTH_KM)
    out.points("world/sat/truth", truth, "#FFFFFF", radius=5.0)
    origin, lines = np.zeros_like(truth), [_last_orbit(data["1/truth"][:, 0, :3], every)]
    for filter in SHOWN:
        error = data[f"1/{filter}/first/mean"][:, 0, :3] - data["1/truth"][:, 0, :3]
        lines.append(_last_orbit(data["1/truth"][:, 0, :3] + EXAGGERATION * error, every))
        out.arrow(f"error_view/{filter}", origin, error[::every], COLORS[filter], filter.upper())
    shades, names = ["#FFFFFF", *(COLORS[f] for f in SHOWN)], ["truth", *(f.upper() for f in SHOWN)]
    out.strips("world/sat/orbits", np.stack(lines, 1), shades, labels=names)
    covariance = data["1/aug/first/cov"][::every, 0, :3, :3]
    out.ellipsoids("world/sat/aug/cov", truth, EXAGGERATION**2 * covariance, COLORS["aug"], alpha=0.1)
    out.ellipsoids("error_view/aug/cov", origin, covariance, COLORS["aug"], alpha=0.2)
    for name, direction in zip(result.config.pulsars, result.config.timing.directions, strict=True):
        out.arrow(f"world/pulsar/{name}", truth, np.tile(ARROW_KM * direction, (len(truth), 1)), "#FFFFFF", name)
    pulls = result.facts["pulls"]
    largest = max(float(np.linalg.norm(pulls[body], axis=1).max()) for body in PULLING)
    for body, color in zip(PULLING, (colors.BOUND, "#BBBBBB"), strict=True):
        pull = pulls[body][1::every]
        out.arrow(f"world/sun_moon/{body}", truth, ARROW_KM * pull / largest, color, body)


def _last_orbit(positions: Array, every: int) -> Array:
    """The orbit behind each row, ``(T, 21, 3)``; at the beginning as much as there is."""
    rows = np.arange(0, len(positions), every)[:, None] + np.arange(-ORBIT, 1)
    return np.asarray(positions[np.maximum(rows, 0)])


def _around_the_sun(out: Recorder, result: Result, times: Array) -> None:
    c = result.config
    earth, sun = (de421().state(body, c.start.after(times)).position / AU_KM for body in ("earth", "sun"))
    year = c.start.after(np.linspace(0.0, 365.25 * DAY_S, 366))
    around = (de421().state("earth", year).position - de421().state("sun", year).position) / AU_KM
    out.path("sun/orbit", [around], colors.FAINT)
    out.points("sun/sun", np.zeros_like(earth), colors.BOUND, radius=9.0, label="Sun")
    out.points("sun/barycenter", -sun, "#FFFFFF", radius=3.0, label="barycenter")
    out.points("sun/earth", earth - sun, colors.COMPARISON, radius=5.0, label="Earth")
    for name, direction in zip(c.pulsars, c.timing.directions, strict=True):
        out.arrow(f"sun/pulsar/{name}", earth - sun, np.tile(0.5 * direction, (len(times), 1)), "#FFFFFF", name)


def _plots(out: Recorder, result: Result, every: int) -> None:
    data = result.data["table 5"]
    truth = data["1/truth"][::every, 0]
    for what, part, scale in (("pos", slice(3), 1.0), ("vel", slice(3, 6), 1e3)):
        for filter in SHOWN:
            error = scale * np.linalg.norm(data[f"1/{filter}/first/mean"][::every, 0, part] - truth[:, part], axis=1)
            out.curve(f"err/{what}/{filter}", error, COLORS[filter], filter.upper())
        variances = data["1/aug/first/cov"][::every, 0].diagonal(0, -2, -1)[:, part]
        out.curve(f"err/{what}/aug/3s", 3.0 * scale * np.sqrt(variances.sum(1)), COLORS["aug"], "3σ AUG", width=1.0)
    for i, axis in enumerate(AXES):
        out.curve(f"bias/{axis}/truth", truth[:, 6 + i], "#FFFFFF", "truth")
        for filter in SHOWN[1:]:
            out.curve(f"bias/{axis}/{filter}", data[f"1/{filter}/first/mean"][::every, 0, 6 + i], COLORS[filter], filter.upper())
        std = np.sqrt(data["1/aug/first/cov"][::every, 0, 6 + i, 6 + i])
        out.bounds(f"bias/{axis}/aug", std, "AUG", center=data["1/aug/first/mean"][::every, 0, 6 + i], color=COLORS["aug"])
        out.curve(f"lambda/{axis}", data["1/tstdkf/first/lambda"][::every, 0, i], SHADES[i], axis)
        for filter in SHOWN[1:]:
            residual = data[f"1/{filter}/first/residual"][::every, 0, i]
            out.curve(f"residual/{i}/{filter}", residual, COLORS[filter], f"{filter.upper()}, {result.config.pulsars[i]}")
        out.bounds(f"residual/{i}/aug", data["1/aug/first/residual std"][::every, 0, i], "AUG", color=COLORS["aug"])
    for filter in SHOWN[1:]:
        out.curve(f"nis/{filter}", data[f"1/{filter}/first/nis"][::every, 0], COLORS[filter], filter.upper())
    for side, level in zip(("low", "high"), chi_square_band(3, 1), strict=True):
        out.level(f"nis/{side}", float(level), "95 % band")
    for body, color in zip(("moon", "sun", "venus", "jupiter"), (*SHADES, colors.PAPER), strict=True):
        size = np.linalg.norm(result.facts["pulls"][body][1::every], axis=1)
        out.log_curve(f"accel/{body}", size, color, body)
    # The table has an instant every five hours; between them the difference is smooth to a meter.
    at = np.asarray(table().dates.rest) * DAY_S
    for i, axis in enumerate(AXES):
        column = table().less_de421["de405"]["earth"][:, i]
        out.curve(f"ephem/de405_minus_de421/{axis}", np.interp(result.times[::every], at - at[0], column), SHADES[i], axis)


def _record_year(result: Result, outputs: Outputs, facts: dict[str, Any]) -> None:
    """The first run of each trend."""
    from celnav.show import recording, views

    data = result.data["year"]
    every = EVERY_YEAR if len(data["times"]) > 20 * EVERY_YEAR else 1
    times, runs = data["times"][::every, 0], data["bias"].shape[1] // len(TRENDS)
    names = {"tkf": "TKF", "C": "TSTDKF, form C", "B": "TSTDKF, form B", "aug": "AUG"}
    tracks = [[views.plot(f"{t}/{a}", f"{t}: ephemeris error {a}, km", times, limits=(-0.4, 0.4)) for a in AXES] for t in TRENDS]
    grid = views.rows(*(views.columns(*row) for row in tracks))
    places = views.tabs(*(views.plot(f"{t}/pos", f"{t}: position error, km", times) for t in TRENDS))
    layout = views.columns(views.text("info", "about"), views.rows(grid, places, shares=(3, 1)), shares=(1, 4))
    text = (
        "# A year of three trends\n\nThe ephemeris error (white) on three axes along a sine, a growing and a triangular trend. The "
        "two-stage filter (TKF, blue) takes it for constant and does not follow. Strong tracking follows in form B (red), hardly "
        "in form C (orange). The exact filter (AUG, green), told of a random walk, follows best. Position errors "
        "are the rms of an hour. Computed by the linear driver."
    )
    with outputs.path_for(RECORDINGS[1]) as path:
        named = recording.recording(path, times, name="tstdkf year", layout=layout, properties=facts, counter="step")
        with named as out:
            out.text("info", text)
            for k, trend in enumerate(TRENDS):
                for i, axis in enumerate(AXES):
                    out.curve(f"{trend}/{axis}/truth", data["bias"][::every, k * runs, i], "#FFFFFF", "truth")
                    for name, label in names.items():
                        out.curve(f"{trend}/{axis}/{name}", data[f"{name}/bias"][::every, k * runs, i], COLORS[name], label)
                for name, label in names.items():
                    error = np.sqrt(data[f"{name}/position"][::every, k * runs])
                    out.curve(f"{trend}/pos/{name}", error, COLORS[name], label)
