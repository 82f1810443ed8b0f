"""Claims on what the paper leaves out: fewer points, consistency, baselines, degenerate cases, sensitivity, adaptive grids."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.rules import unscented
from celnav.gaussian.sparse_grid import point_count, smolyak
from celnav.papers.aasghqf.analysis import DIMENSIONS, MISALIGNMENTS_DEG
from celnav.papers.aasghqf.evidence import PHI, Evidence, ratio
from celnav.study.claims import Bounds, Claim

ONE_FIX = MISALIGNMENTS_DEG.index(10.0)


def beyond_claims(j: Evidence) -> list[Claim]:
    """Everything beyond the paper."""
    return [*_fewer_points(j), *_consistency(j), *_first_fix(j), *_baselines(j), *_degenerate(j), *_sensitivity(j), *_adaptive(j)]


def _fewer_points(j: Evidence) -> list[Claim]:
    out = []
    o = j.result.facts["observability"]
    text = "Weights by nonlinearity: points, where the isotropic rule has 417"
    out.append(j.number("nonlinear-points", "beyond", text, point_count(13, 3, o.by_nonlinearity), (57, 57)))
    text = "57 and 417 points give the same estimates over 50 s at A (largest difference in deviations)"
    out.append(j.number("nonlinear-equal", "beyond", text, float(j.result.data["coarse"]["57-417"].max()), (None, 1e-4)))
    for preset in ("T3", "A-slow", "A"):
        samples = j.pair(preset, "nonlinear", "sghqf", PHI)
        text = f"The same over the flight at {preset}: time-mean RMSE of the angles (ratio)"
        out.append(j.statistic(f"nonlinear-equal-{preset}", "beyond", text, ratio, samples, (0.999, 1.001)))
    errors = j.result.facts["root_errors"]["nonlinear"]
    text = "57 points: median relative error of E[h] over correlated covariances, lower Cholesky"
    out.append(j.number("root-lower", "beyond", text, errors["lower Cholesky"], (None, 1e-3)))
    text = "The same with a symmetric root against the lower one (ratio): the nonlinear states must come first"
    out.append(j.number("root-symmetric", "beyond", text, errors["symmetric"] / errors["lower Cholesky"], (20.0, None)))
    text = "The same with an upper root (ratio)"
    out.append(j.number("root-upper", "beyond", text, errors["upper Cholesky"] / errors["lower Cholesky"], (100.0, None)))
    return out


def _consistency(j: Evidence) -> list[Claim]:
    out = []
    late: tuple[tuple[str, str, Bounds], ...] = (
        ("T3", "sghqf", (0.85, 1.15)),
        ("T3", "ukf", (1.0, 2.5)),
        ("A-slow", "ukf", (20.0, None)),
        ("A-slow", "sghqf", (0.8, 1.2)),
        ("A-slow", "ckf", (10.0, None)),
        ("A-slow", "ekf", (20.0, None)),
        ("A", "ukf", (3.0, None)),
        ("A", "sghqf", (0.8, 1.2)),
        ("A", "triad-ekf", (0.8, 1.2)),
    )
    for preset, filter, accept in late:
        text = f"NEES / 13 of {filter.upper()} over the last 100 s, {preset} (1 if consistent)"
        nees = j.anees(preset, filter, slice(-100, None))
        out.append(j.statistic(f"nees-{preset}-{filter}", "beyond", text, np.mean, [nees], accept))
    text, nees = "The same of AASGHQF, A-slow: the median run", j.anees("A-slow", "aasghqf", slice(-100, None))
    note = f"the mean, {nees.mean():.3g}, belongs to a few runs"
    out.append(j.statistic("nees-A-slow-aasghqf", "beyond", text, np.median, [nees], (0.7, 1.2), note=note))
    start: dict[str, Bounds] = {"ukf": (1e3, None), "sghqf": (None, 2.0), "aasghqf": (2.0, None), "ekf": (1e3, None)}
    for filter, accept in start.items():
        text, first = f"NEES / 13 of {filter.upper()} after the first fix, A", j.anees("A", filter, 0)
        out.append(j.statistic(f"nees-first-{filter}", "beyond", text, np.mean, [first], accept))
    redone = {f: float(j.result.data["A-slow"][f"{f}/redone"].mean()) for f in ("ckf5", "sghqf", "aasghqf", "ukf")}
    text = "CKF of degree 5 loses definiteness at the first fix in every run (redone by the positive rule, times a run), A-slow"
    out.append(j.number("redone-ckf5", "beyond", text, redone["ckf5"], (1.0, 3.0)))
    text = "Sparse grids and UKF never lose it there (times a run)"
    out.append(j.number("redone-others", "beyond", text, redone["sghqf"] + redone["aasghqf"] + redone["ukf"], (0.0, 0.0)))
    failed = sum(
        float(v.sum()) for p in ("T3", "A", "A-slow", "T3-arcmin") for k, v in j.result.data[p].items() if k.endswith("/failed")
    )
    out.append(j.number("failed", "beyond", "Runs lost, all filters and presets", failed, (0, 0)))
    return out


def _first_fix(j: Evidence) -> list[Claim]:
    fixes, out = j.result.facts["first_fixes"], []
    exact = fixes["exact"][ONE_FIX, 0]
    text = "Least eigenvalue of the misalignment covariance after the first fix at 10 deg, to the prior's: exact moments"
    out.append(j.number("first-fix-exact", "beyond", text, exact, (1.4e-4, 1.7e-4)))
    near: Bounds = (0.99, 1.01)
    wanted: dict[str, Bounds] = {"ukf": (None, 0.01), "sghqf": near, "nonlinear": near, "aasghqf": (0.95, 1.05)}
    for name, accept in wanted.items():
        text, value = f"The same of {name.upper()} against the exact one (ratio)", float(fixes[name][ONE_FIX, 0] / exact)
        out.append(j.number(f"first-fix-{name}", "beyond", text, value, accept))
    for name in ("delayed", "ghqf3"):
        text = f"The same of {name}: the sixth moment decides, three points do not have it (ratio)"
        out.append(j.number(f"first-fix-{name}", "beyond", text, float(fixes[name][ONE_FIX, 0] / exact), (None, 0.01)))
    text = "The same of the cubature rule of degree 5: not a covariance at all"
    out.append(j.number("first-fix-ckf5", "beyond", text, float(fixes["ckf5"][ONE_FIX, 0]), (None, 0.0)))
    signs: dict[str, Bounds] = {"aasghqf": (None, 0.0), "ckf5": (None, 0.0), "sghqf": (0.0, None)}
    for name, accept in signs.items():
        text = f"Sampled innovation covariance at 60 deg, without R: least to largest eigenvalue, {name.upper()}"
        out.append(j.number(f"indefinite-{name}", "beyond", text, float(fixes[name][-1, 1]), accept))
    return out


def _baselines(j: Evidence) -> list[Claim]:
    out = []
    bound = np.square(j.result.data["A"]["bound/std"][..., :3]).swapaxes(0, 1)
    text = "EKF started by Wahba's solution against the conditional Cramer-Rao bound, A (time-mean RMSE of the angles)"
    samples = [j.squares("A", "triad-ekf", PHI), bound]
    out.append(j.statistic("triad-bound", "beyond", text, ratio, samples, (0.9, 1.1)))
    for preset, most in (("A", 0.9), ("A-slow", 0.8), ("T3", 0.6)):
        samples = j.pair(preset, "triad-ekf", "sghqf", PHI)
        text = f"The same beats the best quadrature filter at the cost of an EKF: against SGHQF, {preset} (ratio)"
        out.append(j.statistic(f"triad-{preset}", "beyond", text, ratio, samples, (None, most)))
    samples = [s[:, :1] for s in j.pair("A", "triad-ekf", "sghqf", PHI)]
    text = "Its error after the first fix against that of SGHQF, A (ratio)"
    out.append(j.statistic("triad-first", "beyond", text, ratio, samples, (None, 0.1)))
    samples = j.pair("A-slow", "iekf", "triad-ekf", PHI)
    text = "An iterated EKF against it, A-slow (time-mean RMSE of the angles, ratio)"
    out.append(j.statistic("iekf", "beyond", text, ratio, samples, (0.9, 1.2)))
    return out


def _degenerate(j: Evidence) -> list[Claim]:
    two, known = smolyak(13, 2), unscented(13, kappa=-10.0)
    order = [np.lexsort(rule.nodes.T) for rule in (two, known)]
    apart = max(np.abs(two.nodes[order[0]] - known.nodes[order[1]]).max(), np.abs(two.wm[order[0]] - known.wm[order[1]]).max())
    same = float(smolyak(13, 3, [2] * 13) is smolyak(13, 3))
    return [
        j.number("degenerate-level-1", "beyond", "Level 1: points", smolyak(13, 1).num_sigmas(), (1, 1)),
        j.number("degenerate-level-2", "beyond", "Level 2 is the UKF of kappa = 3 - n (largest difference)", apart, (None, 1e-13)),
        j.number("degenerate-equal", "beyond", "Equal weights of 2 are the isotropic rule (1: the very same)", same, (1, 1)),
        j.number("degenerate-small", "beyond", "At 1e-5 rad all filters are the Kalman filter (in prior deviations)",
                 j.result.facts["small"], (None, 1e-6)),
    ]  # fmt: skip


def _sensitivity(j: Evidence) -> list[Claim]:
    out = []

    def first(degrees: float, filter: str) -> float:
        return float(np.median(j.result.data[f"start/{degrees:g}"][f"{filter}/nees"]) / 13.0)

    text = "Largest misalignment (deg) at which SGHQF is consistent after the first fix (median NEES / 13 below 2)"
    good = [s for s in MISALIGNMENTS_DEG if first(s, "sghqf") < 2.0]
    out.append(j.number("sensitivity-sghqf", "beyond", text, max(good, default=0.0), (20.0, None)))
    text = "The same of UKF"
    good = [s for s in MISALIGNMENTS_DEG if first(s, "ukf") < 2.0]
    out.append(j.number("sensitivity-ukf", "beyond", text, max(good, default=0.0), (None, 2.0)))
    text = "Level 4 with weights 1 and 3: points"
    out.append(j.number("level-4-points", "beyond", text, point_count(13, 4, [1] * 3 + [3] * 10), (179, 179)))
    text, values = "Sum of absolute weights at level 3, n = 40: amplification of round-off", j.result.facts["growth"]["level 3"]
    out.append(j.number("growth", "beyond", text, float(values[DIMENSIONS.index(40), 1]), (340.0, 355.0)))
    text = "Slower fixes leave UKF's loss to SGHQF as it is, or larger: A-slow against A (angles; ratio of the ratios)"
    pairs = [ratio(j.squares(p, "ukf", PHI), j.squares(p, "sghqf", PHI)) for p in ("A", "A-slow")]
    out.append(
        j.number(
            "sensitivity-interval",
            "beyond",
            text,
            pairs[1] / pairs[0],
            (0.5, None),
            note=f"A {pairs[0]:.2f}, A-slow {pairs[1]:.2f}",
        )
    )
    return out


def _adaptive(j: Evidence) -> list[Claim]:
    found = j.result.facts["adapted"]
    deep = {c for index in found.contributions if sum(index) > 1 for c, level in enumerate(index) if level}
    return [
        j.number(
            "adaptive-channels", "beyond", "Channels that the adaptive grid refines, of 13: the misalignment", len(deep), (3, 3)
        ),
        j.number("adaptive-points", "beyond", "Its points", found.rule.num_sigmas(), (None, 100)),
    ]
