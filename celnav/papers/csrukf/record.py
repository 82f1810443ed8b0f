"""Recordings of the study: the first run of four cases, the Monte Carlo as an ensemble and its RMSE."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celnav.models.orbit import EARTH
from celnav.models.sightings import star_directions
from celnav.papers.csrukf import theory
from celnav.papers.csrukf.config import D
from celnav.papers.csrukf.study import Result
from celnav.papers.csrukf.theory import UNITS
from celnav.show import colors, scenes, showcase
from celnav.show.estimates import Group, estimates
from celnav.show.plots import Curve, Plot
from celnav.show.showcase import Showcase

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.show.recording import Recorder

CASES = {
    "P/0.8": "SRUKF looks well but its covariance is far too small; CSRUKF is consistent and a third better in position.",
    "P/0": "White noise: both filters are the same filter; 3σ holds.",
    "P/I": "SRUKF follows the wandering noise. CSRUKF stays near the truth because it ignores the sensors, as the open loop does.",
    "D/I": "With a poor prior the paper's filter is worse than SRUKF: differences throw the first sample's position away.",
}
RECORDINGS = [f"csrukf_{case.replace('/', '_').replace('.', '')}.rrd" for case in CASES]
NAMES = {key: (key.upper(), color) for key, color in (("csrukf", colors.ESTIMATE), ("srukf", colors.COMPARISON))}
NAMES["openloop"] = ("open loop", colors.OPEN_LOOP)
GROUPS = (Group("position", "km", slice(0, 3)), Group("velocity", "m/s", slice(3, 6), 1e3))


def record(result: Result, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    return showcase.write({name: _case(result, case) for case, name in zip(CASES, RECORDINGS, strict=True)}, outputs)


def _case(result: Result, case: str) -> Showcase:
    data, c, phi = result.data[case], {"P": result.config, "D": D}[case[0]], {"0": 0.0, "0.8": 0.8, "I": 1.0}[case[2:]]
    truth, z, V, mean, std = (data[key][:, 0] for key in ("truth", "z", "noise", "augmented/noise", "augmented/noise_std"))
    found = estimates(data | {f"{key}/cov": data[f"{key}/root0"] @ data[f"{key}/root0"].mT for key in NAMES}, NAMES, UNITS)
    noise = {}
    for i, axis in enumerate("xyz"):
        augmented = Curve(mean[:, i], colors.REFERENCE, "augmented filter", std[:, i], mean[:, i])
        noise[axis] = Plot(f"colored noise V {axis}, km", {"truth": Curve(V[:, i], colors.TRUTH, "true V"), "augmented": augmented})

    def scene(out: Recorder) -> None:
        scenes.sightings(out, "world", truth[:, :3], truth[:, 3:], star_directions(c.separation), EARTH.radius_km)
        out.points("world/z", z, colors.MEASUREMENT, radius=1.0)
        for key, estimate in found.items():
            out.trail(f"world/{key}/trail", truth[:, :3] + estimate.errors[:, 0, :3], estimate.color, radius=1.2)

    growing = ["world/z", *(f"world/{key}/trail" for key in ("truth", *NAMES))]
    bound = theory.position(result.theory[f"sweep/{case[0]}"].csrukf[:, theory.SWEEP.index(phi)])
    return Showcase(
        f"csrukf: {case}", f"# Sun, Zhuang & Xu (2015), Φ = {case[2:]}, preset {case[0]}\n\n**{CASES[case]}**\n{NOTES}",
        result.times, found, GROUPS, truth, np.eye(3, 6), "km", z - truth[:, :3], 3, {"position": bound}, scene,
        [scenes.beside("world", "scene, km", truth[len(truth) // 2], EARTH.radius_km, growing)], {"V": noise},
        legend={colors.MEASUREMENT: "pseudo-positions", colors.STAR: "stars"}, parameters=vars(c),
        facts={"paper": "csrukf", "case": case, "seed": result.seed, "runs": result.runs},
    )  # fmt: skip


NOTES = """
One satellite, two stars and the Earth's limb give a pseudo-position each second; its noise is colored, V' = Φ V + ζ.
Left above: the directions i1, i2 of the stars, their angles A1, A2 to the position vector, and the sight lines to the limb, A3
apart. Estimates and truth differ by less than a line's width; hence the view of errors below."""
