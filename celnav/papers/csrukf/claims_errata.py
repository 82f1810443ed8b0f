"""What the paper prints or states wrongly, each shown by a number; ids carry the number of the erratum (`errata.ERRATA`)."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.papers.csrukf.evidence import Evidence, ratio3, rms3
from celnav.papers.csrukf.published import TABLE_1, TABLE_2, TABLE_3
from celnav.study.claims import Claim


def errata_claims(j: Evidence) -> list[Claim]:
    """In the order of their numbers."""
    return [*_formulas(j), *_statements(j), *_tables(j)]


def _formulas(j: Evidence) -> list[Claim]:
    f, out = j.result.facts, []
    text = "Eq. 41 as printed gives another radius than R_e / sin(A3 / 2) (ratio)"
    note = f"printed {f['printed_radius_km']:.0f} km where the orbit has {f['true_radius_km']:.1f} km"
    value = f["printed_radius_km"] / f["true_radius_km"]
    out.append(j.number("erratum-1-printed-radius", "erratum", text, value, (0.39, 0.41), paper=1.0, note=note))
    text = "With the positive root of Eq. 42 the position is wrong by this much (km), 300 s after z has changed sign"
    note = f"z turns negative {f['equator_s']:.0f} s after the start"
    out.append(j.number("erratum-2-hemisphere", "erratum", text, f["wrong_sign_km"], (3900.0, 4100.0), paper=0.0, note=note))
    text = "Q* and R* in the QR of Eqs. 27, 32 in place of their roots: final NEES (6 if consistent)"
    samples = [j.get("P/0", "printed_roots/nees")[-1]]
    out.append(j.statistic("erratum-9-roots-nees", "erratum", text, np.mean, samples, (1e3, None), note="Phi = 0, units km"))
    samples = [j.final("P/0", n)[:, 3:] for n in ("printed_roots", "csrukf")]
    text = "The same: velocity RMSE against the corrected filter"
    out.append(j.statistic("erratum-9-roots-velocity", "erratum", text, ratio3, samples, (5.0, None)))
    text = "The same under strong process noise, Phi = I: mean NEES"
    samples = [j.mean_nees("stress/I", "printed_roots")]
    out.append(j.statistic("erratum-9-stress", "erratum", text, np.mean, samples, (50.0, None), paper=6.0))
    text = "A center of negative weight is a downdate, which can fail: variance of |x|^2 of six unit Gaussians by kappa = -3"
    note = "the exact variance is 12"
    out.append(j.number("erratum-10-downdate", "erratum", text, f["variance_by_negative_center"], (None, 0.0), note=note))
    text = "Eqs. 29-32 reuse the propagated points: largest difference to the Kalman filter in one linear step"
    note = f"with redrawn points {f['redraw_with']:.1e}"
    value = f["redraw_without"]
    out.append(j.number("erratum-11-redraw", "erratum", text, value, (0.01, None), paper=0.0, note=note))
    text = "The same under strong process noise, Phi = 0 (3-D position, second half, ratio to SRUKF)"
    samples = [later(j, "0", n) for n in ("no_redraw", "srukf")]
    out.append(j.statistic("erratum-11-stress", "erratum", text, rms_ratio, samples, (1.005, 1.05), paper=1.0))
    text = "The printed loop loses the first sample: r.m.s. change of the final position (m)"
    samples = [(j.final("P/0", "without_first_update") - j.final("P/0", "csrukf"))[:, :3]]
    out.append(j.statistic("erratum-12-first-update", "erratum", text, lambda d: 1e3 * rms3(d), samples, (1e-6, None), paper=0.0))
    text = "The first sample's absolute information is thrown away: final error with it against without, poor prior, Phi = I"
    samples = [j.final("D/I", n)[:, :3] for n in ("csrukf+z0", "csrukf")]
    out.append(j.statistic("erratum-13-first-sample", "erratum", text, ratio3, samples, (None, 0.6), paper=1.0))
    text = "Eqs. 35-37 need lower roots: covariance of the points drawn with an upper one, relative error"
    note = f"with the lower root {f['lower_root']:.1e}"
    out.append(j.number("erratum-15-upper-root", "erratum", text, f["upper_root"], (0.1, None), paper=0.0, note=note))
    return out


def _statements(j: Evidence) -> list[Claim]:
    out = []
    text = "The paper's x_k has seen z_k+1: it is a smoothed estimate, better than the filter at the same time (3-D ratio)"
    samples = [j.get("P/0", "lagged/error")[-1, :, :3], j.get("P/0", "csrukf/error")[-2, :, :3]]
    out.append(j.statistic("erratum-14-lagged", "erratum", text, ratio3, samples, (0.94, 0.999), paper=1.0))
    text = "The same under strong process noise (second half)"
    samples = [later(j, "0", n) for n in ("lagged", "csrukf")]
    out.append(j.statistic("erratum-14-stress", "erratum", text, rms_ratio, samples, (0.8, 0.95), paper=1.0))
    text = "SRUKF does not diverge: its final error is that of the noise walk itself (ratio of 3-D RMSE to that of V)"
    samples = [j.final("P/I", "srukf")[:, :3], j.get("P/I", "noise")[-1]]
    out.append(j.statistic("erratum-18-divergence", "erratum", text, ratio3, samples, (0.8, 1.2)))
    text = (
        "Noise that walks in angle space must be whitened there: 3-D error against whitening pseudo-positions, poor prior, Phi = I"
    )
    samples = [j.final("sensor/D/I", n)[:, :3] for n in ("angles", "csrukf-isotropic")]
    out.append(j.statistic("erratum-23-angle-space", "erratum", text, ratio3, samples, (None, 0.95), paper=1.0))
    return out


def _tables(j: Evidence) -> list[Claim]:
    growth = float((TABLE_2["CSRUKF"][:3] / TABLE_1["CSRUKF"][:3]).max())
    between = float((TABLE_3["I"]["SRUKF"][:3] / TABLE_2["SRUKF"][:3]).max())
    spread = float(TABLE_2["SRUKF"][:3].max() / TABLE_2["SRUKF"][:3].min())
    axes = np.sqrt(np.square(j.get("P/I", "srukf/error")[..., :3]).mean(0))
    settings, alone = j.result.theory["settings"], "computed from the paper's tables alone"
    out = []
    text = "CSRUKF 'changes little' from Table 1 to Table 2: the paper's own largest growth in position"
    out.append(j.number("erratum-19-growth", "erratum", text, growth, (3.0, None), note=alone))
    text = "Tables 2 and 3, both Phi = I: the paper's own largest ratio of SRUKF errors"
    out.append(j.number("erratum-20-contradiction", "erratum", text, between, (3.0, None), note=alone))
    text, note = (
        "Smallest growth of SRUKF from Phi = 0.8 I to I (time average) over random settings",
        f"{len(settings.growth)} settings",
    )
    value = float(settings.growth.min())
    out.append(
        j.number("erratum-21-growth", "erratum", text, value, (5.0, None), paper=2.0, note=f"{note} of sigma, P0, Q, Sigma0")
    )
    text, value = "Largest gain of any filter over SRUKF at Phi = 0.8 I over the same settings", float(settings.gain.max())
    out.append(j.number("erratum-21-gain", "erratum", text, value, (None, 5.0), paper=26.0))
    text = "Table 2 as a statistic of 100 runs: chance that three axes of equal true error differ as the paper's"
    note = f"largest to smallest axis {spread:.2f} in the paper"
    out.append(j.number("erratum-22-axes", "erratum", text, _chance_of_spread(100, spread), (None, 0.01), note=note))
    text, samples = "Axes of one run's time-rms error: median of largest to smallest at Phi = I", [axes.max(-1) / axes.min(-1)]
    note = "which is what Tables 2 and 3 look like"
    out.append(j.statistic("erratum-22-single-run", "beyond", text, np.median, samples, (2.0, 5.0), note=note))
    return out


def _chance_of_spread(runs: int, spread: float) -> float:
    variances = np.random.default_rng(0).chisquare(runs, (20000, 3))
    return float((np.sqrt(variances.max(-1) / variances.min(-1)) >= spread).mean())


def later(j: Evidence, phi: str, filter: str) -> Array:
    """3-D position error of each run of the stress case, rms over the second half, ``(runs,)`` km."""
    error = j.get(f"stress/{phi}", f"{filter}/error")
    return np.asarray(np.sqrt(np.square(error[len(error) // 2 :, :, :3]).sum(-1).mean(0)))


def rms_ratio(a: Array, b: Array) -> float:
    """Ratio of two r.m.s. values."""
    return float(np.sqrt(np.mean(a**2) / np.mean(b**2)))
