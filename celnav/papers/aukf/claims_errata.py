"""What the paper prints that is wrong, by the numbers of `celnav.papers.aukf.errata.ERRATA`."""

from __future__ import annotations

import numpy as np

from celnav.analysis.metrics import ratio, rms
from celnav.papers.aukf.analysis import INCLINATIONS_DEG
from celnav.papers.aukf.evidence import Evidence
from celnav.papers.aukf.sweeps import CASES
from celnav.papers.aukf.tables import medians
from celnav.study.claims import Claim, about, within


def errata_claims(j: Evidence) -> list[Claim]:
    """In the order of their numbers."""
    return [*_noise(j), *_same(j), *_maneuvers(j), *_redraw(j), *_rest(j)]


def _noise(j: Evidence) -> list[Claim]:
    r, out = j.result, []
    burst = r.window("burst")
    spread = {f: r.data["main"][f"ranges/{f}/cov"][burst][..., :3, :3].trace(0, -2, -1).mean() for f in ("aukf", "ukf")}
    text = "E1: in the burst the filter trusts its data less, a fading one trusts them more: variance of AUKF to UKF (ratio)"
    out.append(j.whole(j.number("erratum-1-inflates", "erratum", text, spread["aukf"] / spread["ukf"], (1.0, None))))
    for M, near in ((5, 0.244), (10, 0.176), (30, 0.102)):
        text = f"E2: a clipped mean of {M} squares exceeds 1 by"
        out.append(j.number(f"erratum-2-clipped-{M}", "erratum", text, r.facts["clipped"][M], within(near, 6e-4)))
        text = f"E2: the approximation by 1 / sqrt(π M), M = {M}, exceeds it by"
        away = 1.0 / np.sqrt(np.pi * M) - r.facts["clipped"][M]
        out.append(j.number(f"erratum-2-approximate-{M}", "beyond", text, away, (0.0, 0.01)))
    factor = r.data["main"]["none/aukf/factor"][r.window("quiet")]
    exact = [(factor[..., : factor.shape[-1] // 2] == 1.0).mean((0, 2))]
    text = "E2: sampling makes A smaller than 1, and so clips it, about half the time: part of the ranges' factors that are 1"
    out.append(j.lengthy("erratum-2-half", "erratum", text, np.mean, exact, (0.45, 0.65)))
    text = "E2: A is not 1 where the noise is as the filter thinks: mean factor of the ranges"
    samples = [r.range_factors("none", "quiet")]
    out.append(j.lengthy("erratum-2-mean", "erratum", text, np.mean, samples, (1.1, 1.25)))
    return out


def _same(j: Evidence) -> list[Claim]:
    r, out = j.result, []
    apart = max(np.abs(r.data["main"][f"{c}/ekf/error"] - r.data["main"][f"{c}/ukf/error"])[..., :3].max() for c in CASES)
    text = "E3: EKF and UKF are the same: largest difference of position, all runs, with and without the burst (m)"
    out.append(j.number("erratum-3-same", "erratum", text, apart, (None, 1e-5)))
    late = np.abs(r.data["redraw"]["late ekf/error"] - r.data["redraw"]["ekf/error"])[..., :3].max()
    text = "E3: nor does it matter where the Jacobian is taken: the last estimate for the predicted one, largest difference (m)"
    out.append(j.number("erratum-3-late", "erratum", text, late, (None, 1e-3)))
    for away, near, unit, scale in ((10.0, 2.4, "µm", 1e6), (1e3, 2.4, "cm", 1e2), (1e5, 240.0, "m", 1.0)):
        text = f"E3: a range linearized {away:g} m away is wrong by ({unit})"
        value = scale * r.facts["curvature"][away]
        out.append(j.number(f"erratum-3-curvature-{away:g}", "erratum", text, value, about(near, 0.1)))
    return out


def _maneuvers(j: Evidence) -> list[Claim]:
    r, out = j.result, []
    for filter, accept, text in (("aukf", (1e3, None), "AUKF diverges"), ("ekf", (None, 1.0), "EKF does not")):
        samples = [r.squares("process noise", f"0.1/1/{filter}", "quiet", interval_s=0.1)]
        text = f"E4: little process noise, 10 Hz: {text}: position RMSE, quiet (m)"
        out.append(j.lengthy(f"erratum-4-{filter}", "erratum", text, rms, samples, accept))
    late = {f: medians(r, 1000.0, f)[-1] for f in ("ukf", "aukf")}
    text = "E5: from 1000 km AUKF is slower: its median error after half a minute to UKF's (ratio)"
    out.append(j.whole(j.number("erratum-5-slower", "erratum", text, late["aukf"] / late["ukf"], (2.0, None))))
    return out


def _redraw(j: Evidence) -> list[Claim]:
    r, out = j.result, []
    samples = [r.squares("redraw", f, "quiet") for f in ("no redraw", "ukf")]
    text = "E6: points of the prediction used again: position RMSE to UKF's, quiet, 10 Hz (ratio)"
    out.append(j.lengthy("erratum-6-worse", "erratum", text, ratio, samples, about(4.95 / 0.62, 0.15)))
    nees = r.data["redraw"]["no redraw/nees"][r.window("quiet")].mean(0) / 8.0
    text = "E6: the same: NEES per state (1 if consistent)"
    out.append(j.lengthy("erratum-6-nees", "erratum", text, np.mean, [nees], (10.0, None), note="38 by a prototype"))
    settled = r.window("all", 1.0)
    nis = r.data["matched"]["no redraw/nis"][settled].mean(0) / (2 * len(r.facts["geometry"].names))
    text = "E6: truth from the model, 1 Hz: NIS per measurement (1 if consistent)"
    out.append(j.lengthy("erratum-6-nis", "erratum", text, np.mean, [nis], about(1.88, 0.1)))
    return out


def _rest(j: Evidence) -> list[Claim]:
    r, out = j.result, []
    text = f"E7: evaluations of the measurement in a step: UKF and AUKF, where the EKF has {r.facts['evaluations']['ekf']}"
    out.append(j.number("erratum-7-evaluations", "erratum", text, r.facts["evaluations"]["ukf"], (17, 17)))
    samples = [r.squares("baselines", f"{case}/aukf", "burst") for case in ("both", "ranges")]
    text = "E8: the same burst on the rates as well: position RMSE of AUKF to that with ranges alone (ratio)"
    out.append(j.lengthy("erratum-8-channels", "erratum", text, ratio, samples, (10.0, None)))
    misplaced = r.facts["geometry"].misplaced_m / 1e3
    text = "E9: a geostationary satellite by the others' formula is misplaced by at least (km)"
    out.append(j.number("erratum-9-least", "erratum", text, misplaced.min(), (600.0, None)))
    text = "E9: and by at most (km)"
    out.append(j.number("erratum-9-most", "erratum", text, misplaced.max(), about(3677.0, 0.01)))
    nodes = r.facts["nodes"].drawn
    text = "E10: the node of an orbit inclined by 0.1° is known worse than at 55° by (ratio): ill-conditioned, not unsolvable"
    value = nodes[INCLINATIONS_DEG.index(0.1)] / nodes[INCLINATIONS_DEG.index(55.0)]
    out.append(
        j.number("erratum-10-nodes", "erratum", text, value, about(np.sin(np.radians(55.0)) / np.sin(np.radians(0.1)), 0.03))
    )
    return out
