"""What the paper prints or states wrongly, each shown by a number; ids carry the number of the erratum (`errata.ERRATA`)."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.sparse_grid import integrates, point_count
from celnav.papers.aasghqf import errata
from celnav.papers.aasghqf.config import PAPER_WEIGHTS
from celnav.papers.aasghqf.evidence import PHI, Evidence, ratio, time_mean
from celnav.study.claims import Claim


def errata_claims(j: Evidence) -> list[Claim]:
    """In the order of their numbers."""
    return [*_grids(j), *_model(j), *_selection(j), *_accuracy(j)]


def _grids(j: Evidence) -> list[Claim]:
    out = []
    count = point_count(13, 3, PAPER_WEIGHTS)
    out.append(
        j.number("erratum-1-points", "erratum", "Points of Table 4's AASGHQF by the paper's own rule", count, (75, 75), paper=99)
    )
    text, value = "How 99 can arise: points merged at the origin only", errata.points_merged_at_the_origin(3, PAPER_WEIGHTS)
    out.append(j.number("erratum-1-merge", "beyond", text, value, (99, 99), paper=99))
    text, value = "How else: a state of 14 components, five of weight 1", point_count(14, 3, [1] * 5 + [2] * 9)
    out.append(j.number("erratum-1-fourteen", "beyond", text, value, (99, 99), paper=99))
    text, value = "Eq. 18 with its lower bound as printed, n = 1: points", errata.printed_count(3, (1,), strict=False)
    out.append(j.number("erratum-2-bound", "erratum", text, value, (9, 9), paper=7))
    text, value = (
        "Eq. 18, strict, but with indices of coefficient 0, weights 2, 1: points",
        errata.printed_count(3, (2, 1), strict=True),
    )
    out.append(j.number("erratum-2-zero", "erratum", text, value, (11, 11), paper=9))
    powers = [2, 0, 2]
    text = "Total degree to which a grid with a weight of 2 is exact (the first even monomial that fails has one more than)"
    degree = min(sum(p) for p in ([2, 2, 0], powers, [4, 0, 0], [6, 0, 0]) if not integrates(p, 3, (1, 1, 2))) - 1
    out.append(j.number("erratum-6-degree", "erratum", text, degree, (3, 3), paper=5))
    errors = j.result.facts["mean_error"]
    for name, accept in (("ukf", (5e-3, 1e-2)), ("aasghqf", (3e-3, 8e-3)), ("sghqf", (None, 1e-6)), ("nonlinear", (None, 1e-6))):
        text = f"Relative error of the mean star residual at 10 deg, {name.upper()}"
        kind = "erratum" if name == "aasghqf" else "beyond"
        out.append(j.number(f"erratum-6-mean-{name}", kind, text, errors[name], accept))
    return out


def _model(j: Evidence) -> list[Claim]:
    out = []
    large, small = (j.result.facts["mechanization"][a] for a in ((20.0, -15.0, 40.0), (2.0, -1.5, 4.0)))
    units = {"attitude": "arcsec", "velocity": "m_per_s", "position": "m"}
    for size, found, limits in (("large", large, (0.3, 0.1, 5.0)), ("small", small, (0.03, 2e-3, 0.1))):
        for (key, unit), limit in zip(units.items(), limits, strict=True):
            text = f"The corrected error model against a whole navigation system, 60 s, {size} misalignment: {key} ({unit})"
            out.append(j.number(f"model-{size}-{key}", "beyond", text, found[f"{key}_{unit}"], (None, limit)))
    text = "Eq. 22 as printed is further from the navigation system than corrected (velocity, small misalignment, ratio)"
    value = small["printed_velocity_m_per_s"] / small["velocity_m_per_s"]
    out.append(j.number("erratum-7-velocity", "erratum", text, value, (3.0, None), paper=1.0))
    return out


def _selection(j: Evidence) -> list[Claim]:
    o, out = j.result.facts["observability"], []
    text, note = "Degree of phi_x with misalignment in degrees (9.8 in radians): units decide", "no weight of 1 is left"
    out.append(j.number("erratum-9-units", "erratum", text, float(o.svd_degrees[0]), (0.16, 0.18), paper=9.845, note=note))
    text = "States of weight 1 by the paper's rule with misalignment in degrees"
    ones = o.by_threshold_degrees.count(1)
    out.append(
        j.number(
            "erratum-9-classes", "erratum", text, ones, (0, 0), paper=4, note="equal weights: the isotropic rule of 417 points"
        )
    )
    text = "Weight 1 for longitude and latitude buys nothing: 75 and 43 points agree (largest difference in deviations)"
    apart = float(j.result.data["coarse"]["43-75"].max())
    out.append(j.number("erratum-10-linear", "erratum", text, apart, (None, 1e-6), paper=None))
    for preset, least in (("T3", 1.4), ("A-slow", 2.0), ("A", 1.4)):
        text = f"Weight 2 for phi_z costs accuracy: AASGHQF against SGHQF in phi_y, {preset} (time-mean RMSE, ratio)"
        samples = j.pair(preset, "aasghqf", "sghqf", 1)
        out.append(j.statistic(f"erratum-10-phi-y-{preset}", "erratum", text, ratio, samples, (least, None), paper=1.0))
    return out


def _accuracy(j: Evidence) -> list[Claim]:
    out = []
    text = "Table 3 is a transient: time mean of an EKF started by Wahba's solution, phi_x at T3 (deg)"
    samples = [j.squares("T3", "triad-ekf", 0)]
    out.append(j.statistic("erratum-11-triad", "erratum", text, time_mean, samples, (0.045, 0.075), paper=0.2))
    text = "The same of SGHQF over the last 100 s, mean of the angles (deg)"
    samples = [j.squares("T3", "sghqf", PHI)[:, -100:]]
    out.append(j.statistic("erratum-11-late", "erratum", text, lambda s: time_mean(s) / 3.0, samples, (0.05, 0.08), paper=0.2))
    text = "With fixes each second the misalignment is far better than Table 3: SGHQF at A (mean of the angles, deg)"
    samples = [j.squares("A", "sghqf", PHI)]
    out.append(j.statistic("erratum-11-fast", "erratum", text, lambda s: time_mean(s) / 3.0, samples, (None, 0.01), paper=0.22))
    text = "T3-arcmin, the other reading: SGHQF, mean of the angles (deg)"
    samples = [j.squares("T3-arcmin", "sghqf", PHI)]
    note = "star noise of 20 arcmin; oracle 0.18"
    out.append(
        j.statistic("erratum-11-arcmin", "beyond", text, lambda s: time_mean(s) / 3.0, samples, (0.12, 0.26), paper=0.22, note=note)
    )
    ratios = [time_mean(j.squares("T3-arcmin", "ukf", i)) / time_mean(j.squares("T3-arcmin", "sghqf", i)) for i in range(3)]
    text = "The same: UKF against SGHQF, mean of the angles (ratio): less than the paper's"
    samples = j.pair("T3-arcmin", "ukf", "sghqf", PHI)
    note = f"by angle {np.round(ratios, 2).tolist()}; the paper 1.61, 1.81, 1.64"
    out.append(j.statistic("erratum-11-arcmin-ratio", "beyond", text, ratio, samples, (1.05, 1.6), paper=1.69, note=note))
    return out
