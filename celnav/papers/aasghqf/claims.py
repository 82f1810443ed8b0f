"""What is judged, from the numbers of this very run: figures and tables here, errata and the rest in ``claims_*``."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.sparse_grid import point_count, smolyak
from celnav.papers.aasghqf.analysis import threshold_weights
from celnav.papers.aasghqf.claims_beyond import beyond_claims
from celnav.papers.aasghqf.claims_errata import errata_claims
from celnav.papers.aasghqf.config import PAPER_WEIGHTS
from celnav.papers.aasghqf.evidence import PHI, POSITION, VELOCITY, Evidence, median_ratio, ratio, time_mean
from celnav.papers.aasghqf.published import TABLE_1, TABLE_1_WEIGHTS, TABLE_2_DEGREE, TABLE_3, TABLE_4
from celnav.papers.aasghqf.study import Result
from celnav.study.claims import Bounds, Claim

FIT = "misalignment, fix intervals and process noise are not in the paper; T3 was chosen so that the levels of Table 3 come out"


def claims(result: Result) -> list[Claim]:
    """All claims, in the order of the paper, then its errata and what it leaves out."""
    j = Evidence(result)
    return [*_grids(j), *_observability(j), *_table_3(j), *_transient(j), *_table_4(j), *errata_claims(j), *beyond_claims(j)]


def _grids(j: Evidence) -> list[Claim]:
    one, two = smolyak(2, 3), smolyak(2, 3, (2, 1))
    wrong = sum(point_count(len(g), 3) != count for g, count in zip(TABLE_1_WEIGHTS, TABLE_1["SGHQF"], strict=True))
    wrong += sum(point_count(len(g), 3, g) != count for g, count in zip(TABLE_1_WEIGHTS, TABLE_1["AASGHQF"], strict=True))
    text = "Table 1: of twelve numbers of points, those that differ"
    return [
        j.number("figure-1-points", "paper", "Fig. 1: points of the isotropic rule, n = 2", one.num_sigmas(), (21, 21), paper=21),
        j.number("figure-1-sum", "paper", "Fig. 1: the weights sum to 1 (difference)", abs(one.wm.sum() - 1.0), (None, 1e-13)),
        j.number("figure-1-least", "paper", "Fig. 1: least weight", one.wm.min(), (-0.0557, -0.0555), note="1/18 of opposite sign"),
        j.number("figure-2-points", "paper", "Fig. 2: points of the anisotropic rule", two.num_sigmas(), (9, 9), paper=9),
        j.number("figure-2-positive", "paper", "Fig. 2: all weights are positive (least)", two.wm.min(), (0.0, None)),
        j.number("table-1", "paper", text, wrong, (0, 0), paper=0),
    ]


def _observability(j: Evidence) -> list[Claim]:
    o, out = j.result.facts["observability"], []
    differ = sum(a != b for a, b in zip(threshold_weights(TABLE_2_DEGREE, 5.0), PAPER_WEIGHTS, strict=True))
    text = "Table 2: the paper's degrees give the paper's weights by the rule of a threshold of 5 (states that differ)"
    out.append(j.number("table-2-selector", "paper", text, differ, (0, 0), paper=0))
    for id, at, accept, paper, text in (
        ("tilt-x", 0, (9.5, 10.1), 9.845, "degree of phi_x"),
        ("tilt-y", 1, (9.5, 10.1), 9.845, "degree of phi_y"),
        ("velocity", 4, (0.9, 1.1), 1.0, "degree of the north velocity"),
        ("drift", 7, (1e-6, 1e-4), 7e-5, "degree of the first gyro drift"),
        ("drift-z", 9, (1e-6, 1e-4), 7e-6, "degree of the last gyro drift"),
    ):
        text = f"Table 2: {text}, by singular values in rad, m/s, m, deg/h, micro g"
        out.append(j.number(f"table-2-{id}", "paper", text, float(o.svd[at]), accept, paper=paper))
    for id, at, accept, paper, text in (
        ("heading", 2, (3.5, 6.0), 4.635, "degree of phi_z"),
        ("longitude", 5, (8.0, 11.0), 9.639, "degree of the longitude"),
        ("latitude", 6, (8.0, 11.0), 9.639, "degree of the latitude"),
    ):
        note = "1.00 by any computable reading that gives the tilts"
        value, text = float(o.svd[at]), f"Table 2: {text}"
        out.append(j.number(f"table-2-{id}", "paper", text, value, accept, paper=paper, expected=False, note=note))
    text, note = "Table 2: degrees of the accelerometer biases (largest)", "the paper has 4e-5 to 4e-7"
    out.append(j.number("table-2-bias", "beyond", text, float(o.svd[10:12].max()), (None, 1e-5), note=note))
    text = "Table 2: degree of the vertical accelerometer bias, which nothing sees"
    out.append(j.number("table-2-bias-z", "beyond", text, float(o.svd[12]), (None, 1e-7)))
    return out


def _table_3(j: Evidence) -> list[Claim]:
    """Levels and ratios at T3."""
    out = []
    for i, (name, accept) in enumerate(
        (
            ("phi_x", (0.09, 0.33)),
            ("phi_y", (0.09, 0.33)),
            ("phi_z", (0.09, 0.33)),
            ("east velocity", (0.4, 0.75)),
            ("north velocity", (0.4, 0.75)),
            ("longitude", (13.0, 22.0)),
            ("latitude", (13.0, 22.0)),
        )
    ):
        id, printed = f"table-3-sghqf-{name.replace('_', '-').replace(' ', '-')}", float(TABLE_3["SGHQF"][i])
        text, samples = f"Table 3, SGHQF, {name} (deg, m/s, m), preset T3", [j.squares("T3", "sghqf", i)]
        out.append(j.statistic(id, "calibrated", text, time_mean, samples, accept, paper=printed, note=FIT))
    wanted: dict[str, tuple[slice, Bounds]] = {
        "attitude": (PHI, (1.2, 2.2)),
        "east-velocity": (slice(3, 4), (1.3, None)),
        "north-velocity": (slice(4, 5), (1.3, None)),
        "position": (POSITION, (1.05, None)),
    }
    for id, (part, bounds) in wanted.items():
        text, samples = f"Table 3: UKF against SGHQF, {id.replace('-', ' ')}, T3", j.pair("T3", "ukf", "sghqf", part)
        paper = round(float(TABLE_3["UKF"][part].sum() / TABLE_3["SGHQF"][part].sum()), 3)
        out.append(j.statistic(f"table-3-ukf-{id}", "calibrated", text, ratio, samples, bounds, paper=paper, note=FIT))
    alike = TABLE_3["AASGHQF"] / TABLE_3["SGHQF"]
    for name, i, expected in (("phi-x", 0, True), ("phi-y", 1, False)):
        samples, text = j.pair("T3", "aasghqf", "sghqf", i), f"Table 3: AASGHQF is as good as SGHQF in {name}, T3 (ratio)"
        paper = round(float(alike[i]), 3)
        out.append(j.statistic(f"table-3-alike-{name}", "paper", text, ratio, samples, (None, 1.1), paper=paper, expected=expected))
    return out


def _transient(j: Evidence) -> list[Claim]:
    """Figs 3 to 5: the same filters at A-slow and A, where the mechanism is seen."""
    out = []
    for id, part, least in (("attitude", PHI, 3.0), ("east-velocity", slice(3, 4), 2.0)):
        text = f"Figs 3-5: UKF is worse than SGHQF, {id.replace('-', ' ')}, A-slow (time-mean RMSE, ratio)"
        out.append(j.statistic(f"figure-3-ukf-{id}", "paper", text, ratio, j.pair("A-slow", "ukf", "sghqf", part), (least, None)))
    text = "Figs 3-5: AASGHQF is as good as SGHQF in phi_x, A-slow (time-rms of the median run, ratio)"
    samples, note = j.pair("A-slow", "aasghqf", "sghqf", 0), "in the mean a few runs decide, which take minutes to settle"
    out.append(j.statistic("figure-3-alike-phi-x", "paper", text, median_ratio, samples, (None, 1.1), note=note))
    text = "Fig. 3: phi_z after the first star fix, UKF against SGHQF, A (RMSE, ratio)"
    samples = [s[:, :1] for s in j.pair("A", "ukf", "sghqf", 2)]
    out.append(j.statistic("figure-3-first-fix", "beyond", text, ratio, samples, (2.0, None)))
    text = "Figs 4, 5: velocity of SGHQF at T3 is no worse than that of UKF at any epoch after the first minute (largest ratio)"
    late = [np.sqrt(s[:, min(60, s.shape[1] // 2) :].sum(-1).mean(0)) for s in j.pair("T3", "sghqf", "ukf", VELOCITY)]
    out.append(j.number("figure-4-late", "beyond", text, float((late[0] / late[1]).max()), (None, 1.5)))
    return out


def _table_4(j: Evidence) -> list[Claim]:
    out = []
    for name, count in (("UKF", point_count(13, 2)), ("SGHQF", point_count(13, 3))):
        text, paper = f"Table 4: points of {name}", TABLE_4[name][0]
        out.append(j.number(f"table-4-{name.lower()}", "paper", text, count, (paper, paper), paper=paper))
    count, paper = point_count(13, 3, PAPER_WEIGHTS), TABLE_4["AASGHQF"][0]
    text = "Table 4: points of AASGHQF with the weights of Table 2"
    out.append(j.number("table-4-aasghqf", "paper", text, count, (paper, paper), paper=paper, expected=False, note="75: erratum 1"))
    text, order = "Table 4: the order of cost, UKF < AASGHQF < SGHQF (points of SGHQF to AASGHQF)", point_count(13, 3) / count
    out.append(j.number("table-4-order", "paper", text, order, (3.0, None), paper=round(417 / 99, 2)))
    return out
