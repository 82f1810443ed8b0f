"""Claims on what the paper leaves out: consistency, bounds, exactness, sweeps, stress, sensors."""

from __future__ import annotations

import numpy as np

from celnav.papers.csrukf import theory
from celnav.papers.csrukf.claims_errata import later, rms_ratio
from celnav.papers.csrukf.evidence import Evidence, ratio3, rms3
from celnav.papers.csrukf.study import NAMES
from celnav.study.claims import Claim


def beyond_claims(j: Evidence) -> list[Claim]:
    """Everything beyond the paper."""
    return [*_consistency(j), *_baselines(j), *_bounds(j), *_exactness(j), *_sweeps(j), *_stress(j), *_sensors(j)]


def _consistency(j: Evidence) -> list[Claim]:
    out = []
    for name in NAMES.values():
        text = f"Final NEES of CSRUKF at Phi = {name} (6 if consistent)"
        out.append(j.statistic(f"nees-csrukf-{name}", "beyond", text, np.mean, [j.get(f"P/{name}", "csrukf/nees")[-1]], (5.0, 7.1)))
        text, nis = f"Mean NIS of CSRUKF at Phi = {name} (3 if consistent)", j.get(f"P/{name}", "csrukf/nis")[1:].mean(0)
        out.append(j.statistic(f"nis-csrukf-{name}", "beyond", text, np.mean, [nis], (2.8, 3.2)))
    for name, accept in (("0.8", (28.0, 55.0)), ("I", (5e3, None))):
        text, nees = f"Final NEES of SRUKF at Phi = {name}: color destroys the covariance", j.get(f"P/{name}", "srukf/nees")[-1]
        out.append(j.statistic(f"nees-srukf-{name}", "beyond", text, np.mean, [nees], accept))
    return out


def _baselines(j: Evidence) -> list[Claim]:
    """White filters with inflated noise."""
    out = []
    samples = [j.final("P/0.8", n)[:, :3] for n in ("srukf-reff", "csrukf")]
    text = "Phi = 0.8 I: SRUKF with R / (1 - 0.8)^2 is as good as CSRUKF (3-D ratio)"
    out.append(j.statistic("reff-position", "beyond", text, ratio3, samples, (0.9, 1.1)))
    nees = j.get("P/0.8", "srukf-reff/nees")[-1]
    out.append(j.statistic("reff-nees", "beyond", "The same: final NEES", np.mean, [nees], (4.8, 7.1)))
    samples = [j.final("P/I", n)[:, :3] for n in ("srukf-inflated", "csrukf")]
    text = "Phi = I: no inflation helps, not even to half the final variance of the walk (SRUKF against CSRUKF, 3-D ratio)"
    out.append(j.statistic("inflated-position", "beyond", text, ratio3, samples, (5.0, None)))
    nees = j.get("P/I", "srukf-inflated/nees")[-1]
    out.append(j.statistic("inflated-nees", "beyond", "The same: final NEES", np.mean, [nees], (200.0, None)))
    return out


def _bounds(j: Evidence) -> list[Claim]:
    expected, out = j.result.theory["P"], []
    for i, name in enumerate(NAMES.values()):
        bound = float(theory.position(expected.csrukf[-1, i]))
        text = f"Phi = {name}: final 3-D position RMSE of CSRUKF against the posterior Cramer-Rao bound"
        samples = [j.final(f"P/{name}", "csrukf")[:, :3] / bound]
        out.append(j.statistic(f"pcrb-{name}", "beyond", text, rms3, samples, (0.85, 1.15)))
    long = j.result.theory["long"]
    t, end = min(3000, len(long["bound"]) - 1), len(long["bound"]) - 1
    arc = f"{t} s from a poor prior"
    text, value = f"Phi = I, {arc}: SRUKF against the bound (3-D)", long["srukf"][t, 0] / long["bound"][t, 0]
    out.append(j.number("long-arc-walk", "beyond", text, value, (1.5, 2.5)))
    text, value = f"Phi = 0.8 I, {arc}: ignoring the color costs no accuracy (the same)", long["srukf"][t, 1] / long["bound"][t, 1]
    out.append(j.number("long-arc-mild", "beyond", text, value, (1.0, 1.05)))
    config = j.result.config
    rate = np.sqrt(398600.4418 / config.semi_major_axis_km**3)
    value = long["bound"][end, 0] * rate * config.step_s * np.sqrt(end) / config.sigma_km
    text = f"Phi = I: the bound after {end} s in units of sigma / (n T sqrt N)"
    out.append(j.number("long-arc-rule", "beyond", text, value, (2.2, 2.9)))
    return out


def _exactness(j: Evidence) -> list[Claim]:
    both = ((j.get(f"P/{n}", f"{f}/error")[..., :3] for f in ("csrukf+z0", "augmented")) for n in NAMES.values())
    exact = max(np.abs(a - b).max() * 1e3 for a, b in both)
    text = "The single transform with the first sample equals the augmented filter (m, all Phi)"
    other = "SRUKF equals filterpy's UKF over one run (m)"
    return [
        j.number("exact-augmented", "beyond", text, exact, (None, 1e-4)),
        j.number("exact-filterpy", "beyond", other, j.result.facts["filterpy_m"], (None, 1e-5)),
    ]


def _sweeps(j: Evidence) -> list[Claim]:
    out = []
    poor = {n: j.final("D/I", n)[:, :3] for n in ("srukf", "csrukf", "csrukf+z0")}
    ends = [theory.position(std[-1]) for std in j.result.theory["sweep/D"][:3]]
    walk = [float(end[-1]) for end in ends]
    note = f"linear theory: SRUKF {walk[0]:.3g}, CSRUKF {walk[1]:.3g}, with the first sample {walk[2]:.3g} km"
    text = "Poor prior (10 km, 10 m/s), Phi = I: the paper's filter is worse than SRUKF (3-D ratio)"
    samples = [poor["csrukf"], poor["srukf"]]
    out.append(j.statistic("poor-prior-csrukf", "beyond", text, ratio3, samples, (1.3, None), note=note))
    text, samples = "The same with the first sample used: better than SRUKF (3-D ratio)", [poor["csrukf+z0"], poor["srukf"]]
    out.append(j.statistic("poor-prior-first-sample", "beyond", text, ratio3, samples, (None, 0.85), note=note))
    at = theory.SWEEP.index(0.999)
    text = "Poor prior, Phi = 0.999 I: the paper's filter is worse than SRUKF there too (linear theory, 3-D ratio)"
    out.append(j.number("poor-prior-0.999", "beyond", text, float(ends[1][at] / ends[0][at]), (1.3, None)))
    text = "Poor prior, Phi = 0.8 I: the color costs SRUKF nothing in accuracy, but its final NEES is"
    out.append(j.statistic("poor-prior-nees-0.8", "beyond", text, np.mean, [j.get("D/0.8", "srukf/nees")[-1]], (90.0, 250.0)))
    for name, phi, accept, text in (
        ("I", "0.95", (50.0, None), "true I, assumed 0.95: underestimating Phi ruins consistency"),
        ("I", "0.99", (6.0, 12.0), "true I, assumed 0.99"),
        ("0.8", "0.9", (4.0, 7.3), "true 0.8, assumed 0.9"),
        ("0.8", "1", (4.9, 7.3), "true 0.8, assumed I: overestimating Phi stays consistent"),
    ):
        nees = j.mean_nees(f"wrong/{name}", phi)
        out.append(j.statistic(f"wrong-phi-{name}-{phi}", "beyond", f"Time-mean NEES, {text}", np.mean, [nees], accept))
    right = j.final("P/0.8", "csrukf")[:, :3]
    for id, phi, accept in (("wrong-phi-small-cost", "0.9", (1.0, 1.3)), ("wrong-phi-cost", "1", (2.0, 4.0))):
        text = f"True 0.8, assumed {phi}: what overestimating costs in position (3-D ratio)"
        out.append(j.statistic(id, "beyond", text, ratio3, [j.final("wrong/0.8", phi)[:, :3], right], accept))
    return out


def _stress(j: Evidence) -> list[Claim]:
    out = []
    for id, name, filters, accept, text in (
        ("decorrelation", "I", ("without_correlation", "csrukf"), (1.2, None), "Phi = I: without J the error grows"),
        ("decorrelation-0", "0", ("without_correlation", "csrukf"), (1.01, 1.1), "Phi = 0: the same, less"),
        ("gain", "0.8", ("csrukf", "srukf"), (0.88, 1.0), "Phi = 0.8: CSRUKF against SRUKF"),
    ):
        text, samples = f"Strong process noise, {text} (3-D position, second half)", [later(j, name, f) for f in filters]
        out.append(j.statistic(f"stress-{id}", "beyond", text, rms_ratio, samples, accept))
    for id, name, filter, accept in (
        ("nees", "I", "csrukf", (5.0, 7.0)),
        ("srukf-nees", "I", "srukf", (300.0, None)),
        ("nees-0.8", "0.8", "csrukf", (5.0, 7.0)),
        ("srukf-nees-0.8", "0.8", "srukf", (11.0, 20.0)),
    ):
        text, nees = f"Strong process noise, Phi = {name}: mean NEES of {filter.upper()}", j.mean_nees(f"stress/{name}", filter)
        out.append(j.statistic(f"stress-{id}", "beyond", text, np.mean, [nees], accept))
    return out


def _sensors(j: Evidence) -> list[Claim]:
    out = []
    for name, accept, level in (
        ("0", (0.85, 1.0), (0.046, 0.070)),
        ("0.8", (0.85, 1.0), (0.105, 0.160)),
        ("I", (0.95, 1.05), (0.35, 0.53)),
    ):
        samples = [j.final(f"sensor/P/{name}", f"csrukf-{r}")[:, :3] for r in ("jacobian", "isotropic")]
        text = f"Angles measured, Phi = {name}: final 3-D position RMSE (km) with the true covariance of the pseudo-position"
        out.append(j.statistic(f"sensor-level-{name}", "beyond", text, rms3, samples[:1], level))
        text = "The same against an isotropic covariance (3-D ratio)"
        out.append(j.statistic(f"sensor-anisotropy-{name}", "beyond", text, ratio3, samples, accept))
    samples = [j.final("sensor/P/I", f"{n}-isotropic")[:, :3] for n in ("srukf", "csrukf")]
    text = "Angles measured, Phi = I: SRUKF against CSRUKF (3-D ratio)"
    out.append(j.statistic("sensor-white-I", "beyond", text, ratio3, samples, (8.0, None)))
    samples = [j.final("sensor/D/0", n)[:, :3] for n in ("angles", "csrukf-jacobian")]
    text = "Poor prior, white noise: angles used directly are as good as converted ones (3-D ratio)"
    out.append(j.statistic("sensor-angles-white", "beyond", text, ratio3, samples, (0.97, 1.03)))
    text, nees = "The same, converted with the true covariance: final NEES", j.get("sensor/D/0", "csrukf-jacobian/nees")[-1]
    out.append(j.statistic("sensor-nees", "beyond", text, np.mean, [nees], (5.0, 7.1)))
    return out
