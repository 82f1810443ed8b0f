"""The recording: the first run, satellite and sensors as they turn, the errors as if under a microscope, plots."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celnav.papers.ssukf.config import ARCSEC, UNITS
from celnav.papers.ssukf.errata import RADIUS_M
from celnav.papers.ssukf.evidence import AXES
from celnav.papers.ssukf.figures import COLORS, LABELS
from celnav.papers.ssukf.study import Result
from celnav.show import colors, scenes, showcase
from celnav.show.estimates import Group, estimates
from celnav.show.plots import Curve, Plot
from celnav.show.showcase import Showcase, Space

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.gaussian.linalg import Array
    from celnav.show.recording import Recorder

RECORDINGS = ["ssukf.rrd"]
NAMES = {key: (LABELS[key], COLORS[key]) for key in ("ssukf", "aukf", "mekf")}
EARTH_KM, ORBIT_KM, ARM_KM, EXAGGERATION = 6378.0, RADIUS_M / 1e3, 1500.0, 1000.0
SPACES = (
    Space("world", "orbit, km (inertial axes)", (11e3, -9e3, -15e3), (1e3, 0.0, -2e3), (0.0, -1.0, 0.0)),
    Space("body", f"axes: truth, and estimates with errors x{EXAGGERATION:g}", (3.0, -2.0, 2.0), up=(0.0, 0.0, -1.0)),
)


def record(result: Result, outputs: Outputs) -> list[str]:
    """Write the recording among ``outputs``; returns its name. Needs rerun."""
    t, data, c, counted = result.times, result.data["paper"], result.config, result.facts["evaluations"]
    truth, found = data["truth"][:, 0], estimates(data, NAMES, 1.0 / UNITS)
    drift = Group("drift", "deg/h", slice(3, 6), 1.0 / UNITS[3], truth=truth[:, 4:] / UNITS[3])
    apart = np.abs(data["ssukf/error"] - data["aukf/error"])[:, 0, :3].max(1)
    points = {key: Curve(sum(counted[c.ratio][key]) * np.arange(len(t)) / 1e3, *NAMES[key][::-1]) for key in NAMES}
    cost = {
        "difference": Plot("log10 |SSUKF - AUKF|, arcsec", {"apart": Curve(apart, colors.ESTIMATE, "SSUKF - AUKF")}, log=True),
        "points": Plot("points evaluated at 100 Hz, thousands", points),
    }
    saved = tuple(1.0 - sum(counted[per]["ssukf"]) / sum(counted[per]["aukf"]) for per in (1, c.ratio))
    run = Showcase(
        "ssukf", NOTES.format(saved, c), t, found, (Group("attitude", "arcsec", slice(0, 3), 1.0 / ARCSEC, AXES), drift), truth,
        np.eye(3, 6) / ARCSEC, "arcsec", nis_dof=3, spaces=SPACES, plots={"cost": cost}, counter="star_epoch", parameters=vars(c),
        scene=lambda out: _scene(out, c.orbit_rate_rad_per_s * t, truth[:, :4], {k: found[k].errors[:, 0, :3] for k in NAMES}),
        legend={colors.MEASUREMENT: "nadir", colors.STAR: "sight lines of the star sensor"},
        facts={"paper": "ssukf", "seed": result.seed, "runs": result.runs, "exaggeration": EXAGGERATION},
    )  # fmt: skip
    return showcase.write({RECORDINGS[0]: run}, outputs)


def _scene(out: Recorder, angles: Array, truth: Array, errors: dict[str, Array]) -> None:
    """The satellite at ``angles (T,)`` along its orbit, its attitudes ``(T, 4)``, and their errors ``(T, 3)``."""
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    place, orbit = (ORBIT_KM * np.stack([np.sin(at), 0.0 * at, -np.cos(at)], -1) for at in (angles, turn))
    out.globe("world/earth", EARTH_KM)
    out.path("world/orbit", [orbit], colors.FAINT)
    out.arrow("world/nadir", place, -0.6 * ARM_KM / ORBIT_KM * place, colors.MEASUREMENT, "nadir")
    out.pose("world/sat", place, truth)
    out.axes("world/sat/body", ARM_KM, ("#E63946", "#2A9D8F", "#457B9D"), AXES)
    sights = np.sqrt(2.0) * ARM_KM * np.array([[[0.0, 0.0, 0.0], [0.0, sign, -1.0]] for sign in (1.0, -1.0)])
    out.path("world/sat/boresights", list(sights), colors.STAR, radius=1.0)
    out.axes("body/truth", 1.0, [colors.TRUTH] * 3, AXES, radius=1.0)
    turned = {key: (error, COLORS[key]) for key, error in errors.items()}
    scenes.turning(out, "world/sat", turned, 0.8 * ARM_KM)
    scenes.turning(out, "body", turned, 0.9, EXAGGERATION)


NOTES = """# Wu et al. (2012): state-switching UKF for attitude

* **Equal accuracy of SSUKF and AUKF: true, and an identity.** At equal spread they are one filter to round-off.
* **A third less time: counted in points {0[0]:.0%} at 1:1, {0[1]:.0%} at the paper's {1.ratio}:1.**
* **Faster convergence: not so.** In filter time both converge alike, to the sample.

A satellite turns freely at 800 km. Gyros and a star sensor give attitude; axes red, green, blue: roll, pitch, yaw. The first star
sample takes an error of degrees to {1.star_arcsec:g} arcsec: what follows is shown under a microscope.
"""
