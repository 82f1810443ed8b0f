"""Claims on Tables 1 to 3: against exact linear theory, and against the paper's numbers."""

from __future__ import annotations

import numpy as np

from celnav.analysis.metrics import rmse_interval
from celnav.gaussian.linalg import Array
from celnav.papers.csrukf import theory
from celnav.papers.csrukf.evidence import Evidence, ratio3, rms3
from celnav.papers.csrukf.published import TABLE_1, TABLE_2, TABLE_3
from celnav.study.claims import Claim

SIX_AXES = 1.0 - 0.05 / 6.0
"""Level of an interval for the worst of six axes."""
FIT = "sigma, P0 and Q are not in the paper; they were fitted to Tables 1 and 2"
PARTS = {"position": slice(0, 3), "velocity": slice(3, 6)}


def table_claims(j: Evidence) -> list[Claim]:
    """All of them, and how well presets P and B fit Tables 1 and 2 together."""
    return [*_theory(j), *_table_1(j), *_table_2(j), *_table_3(j), *_fits(j)]


def _theory(j: Evidence) -> list[Claim]:
    out = []
    expected = j.result.theory["P"]
    for table, phi, name in ((1, 0, "0"), (3, 1, "0.8"), (2, 2, "I")):
        for filter, std in (("srukf", expected.srukf), ("csrukf", expected.csrukf)):
            ratios = j.final(f"P/{name}", filter) / std[-1, phi]
            logs = np.log(np.sqrt(np.square(ratios).mean(0)))
            worst, rms = int(np.argmax(np.abs(logs))), float(np.sqrt(np.mean(logs**2)))
            low, high = (float(v[worst]) for v in rmse_interval(ratios, SIX_AXES, axis=0))
            scatter = max(np.log(high) - logs[worst], logs[worst] - np.log(low))
            id, text = f"table-{table}-{filter}-theory", f"Phi = {name}, {filter.upper()}, final RMSE against exact linear theory:"
            value = float(np.exp(logs[worst]))
            out.append(j.number(f"{id}-axes", "beyond", f"{text} ratio on the worst axis", value, (0.70, 1.35), ci=(low, high)))
            ci, note = (max(0.0, rms - scatter), rms + scatter), "a 100-run RMSE scatters by 7 %"
            out.append(j.number(f"{id}-rms", "beyond", f"{text} r.m.s. log ratio", rms, (None, 0.15), ci=ci, note=note))
    return out


def _table_1(j: Evidence) -> list[Claim]:
    out = []
    white = {n: j.final("P/0", n) for n in ("srukf", "csrukf")}
    for part, accept in (("position", (0.85, 1.4)), ("velocity", (0.8, 1.25))):
        at, text = PARTS[part], f"Table 1, {part}: our axis mean against the paper's (SRUKF)"
        printed = float(TABLE_1["SRUKF"][at].mean())

        def ratio(e: Array, printed: float = printed) -> float:
            return float(np.sqrt(np.square(e).mean(0)).mean() / printed)

        out.append(j.statistic(f"table-1-{part}", "calibrated", text, ratio, [white["srukf"][:, at]], accept, paper=1.0, note=FIT))
    text = "Table 1: with white noise CSRUKF equals SRUKF (difference of the 3-D ratio from 1)"
    samples = [white["csrukf"][:, :3], white["srukf"][:, :3]]
    out.append(j.statistic("table-1-equal", "paper", text, lambda a, b: abs(ratio3(a, b) - 1.0), samples, (None, 1e-6)))
    return out


def _table_2(j: Evidence) -> list[Claim]:
    out = []
    walk = {n: j.final("P/I", n) for n in ("srukf", "csrukf")}
    for part, most in (("position", 0.08), ("velocity", 0.12)):
        at = PARTS[part]
        printed = {n: float(np.linalg.norm(TABLE_2[n.upper()][at])) for n in walk}
        samples, paper = [walk["csrukf"][:, at], walk["srukf"][:, at]], round(printed["csrukf"] / printed["srukf"], 3)
        text = f"Table 2, {part}: CSRUKF against SRUKF, 3-D"
        out.append(j.statistic(f"table-2-{part}-ratio", "paper", text, ratio3, samples, (None, most), paper=paper))
        for n, error in walk.items():
            text = f"Table 2, {part}: our 3-D RMSE of {n.upper()} against the paper's"
            out.append(_level(j, f"table-2-{part}-{n}", "calibrated", text, error[:, at], printed[n], FIT))
    return out


def _level(j: Evidence, id: str, kind: str, text: str, error: Array, printed: float, note: str, *, expected: bool = True) -> Claim:
    """A 3-D RMSE in units of the paper's."""
    return j.statistic(id, kind, text, lambda e: rms3(e) / printed, [error], (0.6, 1.6), paper=1.0, note=note, expected=expected)


def _table_3(j: Evidence) -> list[Claim]:
    mild = {n: j.final("P/0.8", n) for n in ("srukf", "csrukf")}
    walk = j.final("P/I", "srukf")[:, :3]
    printed = {phi: {f: float(np.linalg.norm(rows[f][:3])) for f in rows} for phi, rows in TABLE_3.items()}
    why = "the levels of Table 3 fit no parameters together with Tables 1 and 2; only the order is judged"
    out = []
    text = "Table 3, Phi = 0.8 I: 3-D position RMSE of SRUKF against the paper's"
    error = mild["srukf"][:, :3]
    out.append(_level(j, "table-3-level", "paper", text, error, printed["0.8"]["SRUKF"], why, expected=False))
    text, note = (
        "Table 3, Phi = I: 3-D position RMSE of SRUKF against the paper's",
        "Tables 2 and 3 contradict each other at Phi = I",
    )
    out.append(_level(j, "table-3-walk-level", "paper", text, walk, printed["I"]["SRUKF"], note, expected=False))
    text, paper = "Table 3, Phi = 0.8 I: CSRUKF is better than SRUKF in position (3-D ratio)", printed["0.8"]
    samples, ratio = [mild["csrukf"][:, :3], mild["srukf"][:, :3]], round(paper["CSRUKF"] / paper["SRUKF"], 4)
    out.append(j.statistic("table-3-position-ratio", "paper", text, ratio3, samples, (0.55, 0.80), paper=ratio, note=why))
    text, samples = "Phi = 0.8 I: CSRUKF and SRUKF are alike in velocity (3-D ratio)", [mild["csrukf"][:, 3:], mild["srukf"][:, 3:]]
    out.append(j.statistic("table-3-velocity-ratio", "beyond", text, ratio3, samples, (0.9, 1.05)))
    text, growth = "Table 3 lets SRUKF merely double from Phi = 0.8 I to I; it grows by this factor", printed["I"]["SRUKF"]
    samples, ratio = [walk, mild["srukf"][:, :3]], round(growth / printed["0.8"]["SRUKF"], 2)
    out.append(j.statistic("table-3-growth", "erratum", text, ratio3, samples, (10.0, None), paper=ratio))
    return out


def _fits(j: Evidence) -> list[Claim]:
    text = "Tables 1 and 2 come out together (r.m.s. factor over eight numbers, linear theory), preset"
    at_end = theory.misfit(j.result.theory["P"], average=False)
    averaged = theory.misfit(j.result.theory["B"], average=True)
    return [
        j.number("fit-P", "calibrated", f"{text} P, errors at the end", at_end, (1.0, 1.3), note=FIT),
        j.number("fit-B", "calibrated", f"{text} B, errors averaged over time", averaged, (1.0, 1.3), note=FIT),
    ]
