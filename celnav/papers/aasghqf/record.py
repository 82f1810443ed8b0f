"""Recordings: the first run of a preset in full, as the filters see it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celnav.gaussian.linalg import matvec, semidefinite_root
from celnav.models import inertial
from celnav.papers.aasghqf.config import PRESETS
from celnav.papers.aasghqf.figures import COLORS, LABELS
from celnav.papers.aasghqf.scenario import BORESIGHTS, rules
from celnav.papers.aasghqf.study import Result, units
from celnav.show import colors, scenes, showcase
from celnav.show.estimates import Group, estimates
from celnav.show.showcase import Showcase, Space

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.show.recording import Recorder

CASES = {"A-slow": "aasghqf_A_slow.rrd", "T3": "aasghqf_T3.rrd"}
RECORDINGS = list(CASES.values())
NAMES = {key: (LABELS[key], COLORS[key]) for key in ("sghqf", "ukf", "aasghqf")}
SPACES = (
    Space("world", "flight, m (east, north, up)", (60e3, -70e3, 70e3), (90e3, 20e3, 0.0),
          growing=("world/aircraft/trail", "world/inertial/trail")),
    *(Space(f"points/{f}", f"sigma points of {LABELS[f]}, σ of SGHQF", (9.0, -9.0, 6.0)) for f in NAMES),
)  # fmt: skip
STAR_M = 25000.0  # the length of a drawn sight line


def record(result: Result, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    return showcase.write({name: _case(result, preset) for preset, name in CASES.items()}, outputs)


def _case(result: Result, preset: str) -> Showcase:
    c, data, scale = PRESETS[preset], result.data[preset], units(PRESETS[preset])
    truth, found = data["truth"][:, 0], estimates(data, NAMES, scale)
    axes = np.diag(c.meters)[[0, 1, 1]] * [[1.0], [1.0], [0.0]]  # east, north, up of a place on the ground
    fix = (data["z"][:, 0, 6:] - truth[:, inertial.POSITION]) @ axes.T
    groups = (
        Group("attitude", "deg", slice(0, 3), tuple(scale[:3])),
        Group("velocity", "m/s", slice(3, 5), 1.0, ("east", "north")),
        Group("position", "m", slice(5, 7), tuple(scale[5:7]), ("longitude", "latitude")),
    )
    adapted, degrees = result.facts["adapted"].coefficients, result.facts["observability"].svd
    bars = {"coefficients of the adaptive grid": np.array(list(adapted.values())), "degree of observability by state": degrees}
    legend = {
        colors.MEASUREMENT: "fixes by radar, stars where the inertial system expects them", colors.STAR: "stars where they are",
        colors.SIGMA: "inertial system", colors.NEGATIVE: "points of negative weight",
    }  # fmt: skip

    def scene(out: Recorder) -> None:
        flight, epochs = c.flight, 2 * np.arange(len(truth))
        way = np.stack([flight.longitude - flight.longitude[0], flight.latitude - flight.latitude[0]], -1)[epochs]
        place, drifted = (at @ axes.T for at in (way, way + truth[:, inertial.POSITION]))
        scenes.track(out, "world/aircraft", place, colors.TRUTH, "aircraft", radius=2.5)
        scenes.track(out, "world/inertial", drifted, colors.SIGMA, "inertial system", radius=1.5)
        out.points("world/sar_fix", np.where(np.isfinite(fix), place, np.nan), colors.MEASUREMENT, radius=3.0)
        attitude = flight.attitude[epochs]
        computed = inertial.misalignment_matrix(truth[:, inertial.PHI]) @ attitude
        for k, star in enumerate(BORESIGHTS, start=1):
            out.arrow(f"world/star{k}/sight", place, STAR_M * (attitude @ star), colors.STAR, f"star {k}")
            out.arrow(f"world/star{k}/expected", place, STAR_M * (computed @ star), colors.MEASUREMENT, "")
        for key, e in found.items():
            rule = rules()[key]
            moved = rule.nodes[:, :3].any(-1) | (np.arange(len(rule.nodes)) == 0)
            points = e.errors[:, 0, None] + matvec(semidefinite_root(np.asarray(e.cov))[:, None], rule.nodes[moved])
            std = data["sghqf/std"][:, :1, :3] / scale[:3]
            scenes.sigma_points(out, f"points/{key}", points[..., :3] / std, rule.wm[moved], e.color)

    return Showcase(
        f"aasghqf: {preset}", NOTES.format(preset), result.times(preset), found, groups, truth,
        np.concatenate([np.zeros((3, 5)), axes, np.zeros((3, 6))], 1), "m", fix, scene=scene, spaces=SPACES, bars=bars,
        legend=legend, parameters=vars(c), facts={"paper": "aasghqf", "preset": preset, "seed": result.seed, "runs": result.runs},
    )  # fmt: skip


NOTES = """# Liang et al. (2014), preset {}

**The UKF's first star fix leaves it overconfident, and it takes minutes to forget; a sparse grid with 57 points is as good as
that of 417.**

An aircraft turns at 200 m/s and 20 km. Its inertial system starts with a large misalignment and drifts away while star sensors and
SAR fixes let filters estimate its error. Left above: the flight, and the sigma points of the misalignment about the truth.
"""
