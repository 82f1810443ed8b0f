"""Recordings: the first run of setting 1, about the Earth and around the Sun, with its errors; the year is in `record_year`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celnav.analysis.metrics import rms
from celnav.models.ephemeris import de421
from celnav.papers.tstdkf.config import DAY_S
from celnav.papers.tstdkf.ephemerides import table
from celnav.papers.tstdkf.evidence import AXES
from celnav.papers.tstdkf.figures import COLORS, SHADES
from celnav.papers.tstdkf.record_year import year
from celnav.papers.tstdkf.study import Result
from celnav.show import colors, scenes, showcase
from celnav.show.estimates import Estimate, Group
from celnav.show.plots import Curve, Plot, curves
from celnav.show.showcase import Showcase, Space

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.gaussian.linalg import Array
    from celnav.papers.tstdkf.config import Config
    from celnav.show.recording import Recorder

RECORDINGS = ["tstdkf.rrd", "tstdkf_year.rrd"]
SHOWN = ("tstdkf", "aug", "tkf", "ekf")
ARROW_KM, EARTH_KM, AU_KM, EXAGGERATION = 4000.0, 6378.137, 1.495978707e8, 1000.0
SPACES = (
    Space("world", f"about the Earth, km (errors x{EXAGGERATION:g})", (15e3, 11e3, 9e3)),
    Space("sun", "around the Sun, AU", (0.5, -2.2, 1.6)),
)


def record(result: Result, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    return showcase.write(dict(zip(RECORDINGS, (_month(result), year(result)), strict=True)), outputs)


def _month(result: Result) -> Showcase:
    every = 9 if len(result.times) > 180 else 1  # an orbit has 20 steps: every tenth would show two of its places only
    t, whole = result.times[::every], {key[2:]: v[:, 0] for key, v in result.data["table 5"].items() if key.startswith("1/")}
    data = {key: array[::every] for key, array in whole.items()}
    truth, found = data["truth"], {}
    for key in SHOWN:
        mean, nis = data[f"{key}/first/mean"], data.get(f"{key}/first/nis")
        error = (mean - truth[:, : mean.shape[1]])[:, None]
        found[key] = Estimate(key.upper(), COLORS[key], error, data[f"{key}/first/cov"], nis=nis)
    pulls = {body: result.facts["pulls"][body][1::every] for body in ("moon", "sun", "venus", "jupiter")}
    sizes = [np.linalg.norm(pull, axis=1) for pull in pulls.values()]
    # The table has an instant every five hours; between them the difference is smooth to a meter.
    at = np.asarray(table().dates.rest) * DAY_S
    ephemeris = [np.interp(t, at - at[0], column) for column in table().less_de421["de405"]["earth"].T]
    residuals = {}
    for i, pulsar in enumerate(result.config.pulsars):
        std = {"aug": data["aug/first/residual std"][:, i]}
        seen = {key: Curve(data[f"{key}/first/residual"][:, i], COLORS[key], key.upper(), std.get(key)) for key in SHOWN[:3]}
        residuals[pulsar] = Plot(f"residual of {pulsar}, km", seen)
    models = {
        "factors": Plot("factors of strong tracking", curves(AXES, data["tstdkf/first/lambda"].T, SHADES), limits=(0.0, 12.0)),
        "pulls": Plot("log10 of third bodies' pull, km/s²", curves(pulls, sizes, (*SHADES, colors.PAPER)), log=True),
        "ephemeris": Plot("DE405 - DE421 of the Earth, km", curves(AXES, ephemeris, SHADES)),
    }

    def scene(out: Recorder) -> None:
        tracks = {"truth": whole["truth"][:, :3]}
        tracks |= {key: tracks["truth"] + EXAGGERATION * (whole[f"{key}/first/mean"][:, :3] - tracks["truth"]) for key in SHOWN}
        orbits = np.stack([scenes.behind(points, 20, every) for points in tracks.values()], 1)
        shades = [colors.TRUTH, *(COLORS[key] for key in SHOWN)]
        out.globe("world/earth", EARTH_KM)
        out.points("world/sat/truth", truth[:, :3], colors.TRUTH, radius=5.0)
        out.strips("world/sat/orbits", orbits, shades, labels=[key.upper() for key in tracks])
        covariance = EXAGGERATION**2 * data["aug/first/cov"][:, :3, :3]
        out.ellipsoids("world/sat/aug", truth[:, :3], covariance, COLORS["aug"], alpha=0.1)
        for body, color in (("sun", colors.STAR), ("moon", colors.BODY)):
            out.arrow(f"world/pull/{body}", truth[:, :3], ARROW_KM / max(s.max() for s in sizes[:2]) * pulls[body], color, body)
        _around_the_sun(out, result.config, t, truth[:, :3])

    groups = (
        Group("position", "km", slice(0, 3)),
        Group("velocity", "m/s", slice(3, 6), 1e3),
        Group("bias", "km", slice(6, 9), truth=truth[:, 6:]),
    )
    return Showcase(
        "tstdkf", _notes(result), t, found, groups, truth, np.eye(3, 9), "km", nis_dof=3, scene=scene, spaces=SPACES,
        plots={"residuals": residuals, "models": models}, legend={colors.STAR: "Sun, pulsars", colors.BODY: "Moon, Earth"},
        parameters=vars(result.config), counter="step",
        facts={"paper": "tstdkf", "seed": result.seed, "runs": result.runs, "exaggeration": EXAGGERATION},
    )  # fmt: skip


def _around_the_sun(out: Recorder, c: Config, times: Array, place: Array) -> None:
    earth, sun = (de421().state(body, c.start.after(times)).position / AU_KM for body in ("earth", "sun"))
    days = c.start.after(np.linspace(0.0, 365.25 * DAY_S, 366))
    out.path("sun/orbit", [(de421().state("earth", days).position - de421().state("sun", days).position) / AU_KM], colors.FAINT)
    out.points("sun/sun", np.zeros_like(earth), colors.STAR, radius=9.0, label="Sun")
    out.points("sun/barycenter", -sun, colors.BODY, radius=3.0, label="barycenter")
    out.points("sun/earth", earth - sun, colors.BODY, radius=5.0, label="Earth")
    for name, direction in zip(c.pulsars, c.timing.directions, strict=True):
        out.arrow(f"sun/pulsar/{name}", earth - sun, np.tile(0.5 * direction, (len(times), 1)), colors.STAR, name)
        out.arrow(f"world/pulsar/{name}", place, np.tile(ARROW_KM * direction, (len(times), 1)), colors.STAR, name)


def _notes(result: Result) -> str:
    size = {name: rms(result.squares(name, "position")) for name in (*SHOWN, "tkf-fair")}
    ekf, tkf = (100.0 * (1.0 - size["tstdkf"] / size[name]) for name in ("ekf", "tkf"))
    return f"""# Xu et al. (2024): two stages and strong tracking for X-ray pulsars

* **{ekf:.0f} % below the EKF, {tkf:.0f} % below the two-stage filter (TKF):** attained with tuned parameters.
* **Most of the second gain is tuning of the baseline:** TKF with the covariances that the noise really has comes to
  {size["tkf-fair"]:.4f} km, TSTDKF to {size["tstdkf"]:.4f} km.
* **The exact filter (AUG) takes what is there:** {size["aug"]:.4f} km.

A satellite times three pulsars; the Earth's ephemeris is wrong by some hundred meters (bias), the noise is colored and correlated.
Lines: the last orbit and what the filters made of it, errors {EXAGGERATION:g} times as large. Arrows: the pulls of Sun and Moon.
Occultation by the Earth, exclusion near the Sun and one detector for three pulsars are left out, as in the paper.
"""
