"""Recordings of the study: one showcase run in full, the Monte Carlo as an ensemble and its RMSE."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celnav.analysis.metrics import chi_square_band
from celnav.models.orbit import EARTH
from celnav.papers.csrukf import theory
from celnav.papers.csrukf.config import D
from celnav.papers.csrukf.study import Result
from celnav.papers.csrukf.theory import UNITS

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.papers.csrukf.showcase import Showcase

CASES = {"P/0.8": "csrukf_P_08.rrd", "P/0": "csrukf_P_0.rrd", "P/I": "csrukf_P_I.rrd", "D/I": "csrukf_D_I.rrd"}
RECORDINGS = list(CASES.values())
CONCLUSIONS = {
    "P/0": "White noise: both filters are the same filter; 3σ holds.",
    "P/0.8": "SRUKF looks well but its covariance is far too small; CSRUKF is consistent and a third better in position.",
    "P/I": "SRUKF follows the wandering noise. CSRUKF stays near the truth because it ignores the sensors: it coincides with the "
    "open loop.",
    "D/I": "With a poor prior the paper's filter is worse than SRUKF: differences throw the first sample's position away.",
}


def record(result: Result, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    from celnav.papers.csrukf.showcase import record_showcase

    for case, name in CASES.items():
        with outputs.path_for(name) as path:
            record_showcase(showcase(result, case), path)
    return RECORDINGS


def showcase(result: Result, case: str) -> Showcase:
    """The first run of a case with its covariances, up to 20 runs as an ensemble, and the bound."""
    from celnav.papers.csrukf.showcase import Estimate, Showcase

    data = result.data[case]
    phi = {"0": 0.0, "0.8": 0.8, "I": 1.0}[case[2:]]
    expected = result.theory[f"sweep/{case[0]}"]
    truth = data["truth"][:, 0]
    estimates = {}
    for name in ("srukf", "csrukf", "openloop"):
        root = data[f"{name}/root0"][:, 0]
        mean = truth + data[f"{name}/error"][:, 0] / UNITS
        estimates[name] = Estimate(mean, root @ root.mT, data[f"{name}/nees"][:, 0], data[f"{name}/nis"][:, 0])
    ensemble = {name: data[f"{name}/error"][:, :20, :3] for name in estimates}
    rmse = {name: np.sqrt(np.square(data[f"{name}/error"][..., :3]).sum(-1).mean(1)) for name in estimates}
    c = {"P": result.config, "D": D}[case[0]]
    notes = f"""# Sun, Zhuang & Xu (2015), Φ = {case[2:]}, preset {case[0]}

**{CONCLUSIONS[case]}**

One satellite, two stars and the Earth's limb give a pseudo-position each second; its noise is colored, V' = Φ V + ζ.
Left above: Earth, orbit, sight lines. Left below: errors about the truth, with 3σ ellipsoids and other runs as points.

| | |
|---|---|
| increments ζ | σ = {c.sigma_km:g} km per axis |
| prior | {c.prior_position_km:g} km, {c.prior_velocity_m_per_s:g} m/s |
| process noise | {c.noise_position_km:g} km, {c.noise_velocity_km_per_s:g} km/s per step |
| runs, seed | {result.runs}, {result.seed} |
"""
    return Showcase(
        title=f"csrukf {case}",
        notes=notes,
        times=result.times,
        truth=truth,
        measurements=data["z"][:, 0],
        noise=data["noise"][:, 0],
        noise_mean=data["augmented/noise"][:, 0],
        noise_std=data["augmented/noise_std"][:, 0],
        estimates=estimates,
        ensemble=ensemble,
        rmse=rmse,
        bound=theory.position(expected.csrukf[:, theory.SWEEP.index(phi)]),
        separation=c.separation,
        radius_km=EARTH.radius_km,
        nees_band=chi_square_band(6, 1),
        nis_band=chi_square_band(3, 1),
    )
