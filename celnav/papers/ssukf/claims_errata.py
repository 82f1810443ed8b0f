"""What the paper prints or states wrongly, each shown by a number; ids carry the number of the erratum (`errata.ERRATA`)."""

from __future__ import annotations

import numpy as np

from celnav.analysis.metrics import rms
from celnav.papers.ssukf.checks import LARGE, TURNS_DEG
from celnav.papers.ssukf.config import ARCSEC
from celnav.papers.ssukf.errata import orbit_rate, printed_spread, rotation_vector
from celnav.papers.ssukf.evidence import Evidence
from celnav.papers.ssukf.scenario import spread
from celnav.study.claims import Claim, order


def errata_claims(j: Evidence) -> list[Claim]:
    """In the order of their numbers."""
    return [*_formulas(j), *_comparison(j), *_model(j)]


def _formulas(j: Evidence) -> list[Claim]:
    config, out = j.result.config, []
    text = "The printed lambda, with n for L: spread c of the AUKF's points instead of alpha^2 L (ratio)"
    c = 15.0 * config.alpha**2
    out.append(j.number("erratum-1-spread", "erratum", text, printed_spread(15, config.alpha) / c, (2.0, None), paper=1.0))
    text = "It breaks nothing: largest change of the AUKF's attitude (power of ten, arcsec)"
    out.append(j.number("erratum-1-change", "beyond", text, order(j.worst("variants", "as printed")[0]), (None, 1e-6)))
    for name, L in (("AUKF", 15), ("SSUKF, prediction", 12), ("SSUKF, update", 9), ("additive", 6)):
        text, points = f"2 (n + n_w + m) + 1 points: {name}", 2 * L + 1
        id = f"erratum-2-points-{L}"
        out.append(j.number(id, "beyond", text, spread(L, config).num_sigmas(), (points, points)))
    return out


def _comparison(j: Evidence) -> list[Claim]:
    counted, out = j.result.facts["evaluations"], []
    totals = {per: {name: sum(pair) for name, pair in counted[per].items()} for per in counted}
    text = "At the paper's own 25:1 the saving is not a third (part of the points saved)"
    saved = 1.0 - totals[25]["ssukf"] / totals[25]["aukf"]
    out.append(j.number("erratum-3-saving", "erratum", text, saved, (0.2, 0.202), paper=0.333))
    text = "An ordinary UKF is cheaper than the SSUKF (points at 1:1, ratio)"
    out.append(j.number("erratum-3-ordinary", "erratum", text, totals[1]["additive"] / totals[1]["ssukf"], (None, 0.6)))
    both = [j.result.data["paper"][f"{name}/error"] for name in ("aukf", "ssukf")]
    text = 'Fig. 3, "converges faster": largest difference of the attitudes over all runs and samples (power of ten, arcsec)'
    apart = order(float(np.abs(both[0] - both[1])[1:, :, :3].max()))
    out.append(j.number("erratum-4-identical", "erratum", text, apart, (None, 1e-6)))
    for name in LARGE:
        turned = {degrees: np.square(j.result.data["turns"][f"{name}/{degrees:g}"][1]) for degrees in TURNS_DEG}
        text = f"Error of {name.upper()} after the first star sample from an initial error of 179 deg (arcsec)"
        out.append(j.statistic(f"erratum-5-{name}", "erratum", text, rms, [turned[179.0]], (18.0, 23.0)))
        sizes = [rms(squares) for squares in turned.values()]
        text = f"The same from 10 to 179 deg, largest to smallest: none of them is large (ratio of {name.upper()})"
        out.append(j.number(f"erratum-5-ratio-{name}", "erratum", text, max(sizes) / min(sizes), (None, 1.001)))
    dead = j.result.facts["dead"]
    for name, count, wanted in (("prediction", dead[0], 6), ("update", dead[1], 12)):
        text = f"Of the AUKF's 31 points in the {name}, copies of the center"
        out.append(j.number(f"erratum-6-{name}", "erratum", text, count, (wanted, wanted)))
    text = "A UKF that adds Q and R instead of augmenting: largest difference at equal spread, 100 Hz (power of ten, arcsec)"
    value = order(j.worst("identities", "additive, c = 15")[0])
    out.append(j.number("erratum-7-additive", "erratum", text, value, (None, 1e-6)))
    return out


def _model(j: Evidence) -> list[Claim]:
    spin, out = j.result.facts["spin"], []
    text = "Total MRP without the switch, past 360 deg: largest error against that with it (ratio)"
    without, switched = spin.settled("unswitched"), spin.settled("switched")
    note, value = f"{without:.1f} arcsec; with the switch {switched:.2f}", without / switched
    out.append(j.number("erratum-9-unswitched", "erratum", text, value, (2.0, None), note=note))
    text = "Orbital rate at 800 km against the printed 0.001 rad/s (ratio)"
    out.append(
        j.number("erratum-10-rate", "erratum", text, orbit_rate() / j.result.config.orbit_rate_rad_per_s, (1.037, 1.039), paper=1.0)
    )
    settled = [limit[1, 0] / ARCSEC for _, limit in j.result.facts["readings"]]
    text = "Readings of the gyro's numbers: largest to smallest attitude deviation that settles (ratio)"
    out.append(j.number("erratum-11-readings", "erratum", text, max(settled) / min(settled), (10.0, None)))
    for axis, value, wanted in zip("xyz", rotation_vector(j.result.config), (0.823, 2.082, 9.981), strict=True):
        text = f"The initial error of 1, 2, 10 deg (Euler angles) as a rotation vector, {axis} (deg)"
        out.append(j.number(f"erratum-13-{axis}", "erratum", text, value, (wanted - 5e-4, wanted + 5e-4)))
    return out
