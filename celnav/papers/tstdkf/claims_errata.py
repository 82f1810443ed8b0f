"""What the paper prints or states wrongly, each shown by a number; ids carry the number of the erratum (`errata.ERRATA`)."""

from __future__ import annotations

import numpy as np

from celnav.analysis.metrics import ratio, rms
from celnav.models.ephemeris import de421
from celnav.papers.tstdkf import published
from celnav.papers.tstdkf.ephemerides import table
from celnav.papers.tstdkf.evidence import Evidence
from celnav.papers.tstdkf.sweeps import KNOWN
from celnav.study.claims import Claim, about, order, within


def errata_claims(j: Evidence) -> list[Claim]:
    """In the order of their numbers."""
    return [*_ephemeris(j), *_delays(j), *_differencing(j), *_rest(j)]


def _ephemeris(j: Evidence) -> list[Claim]:
    earth, out = table().less_de421["de405"]["earth"], []
    text = "Text on Fig. 2, tens of kilometers from DE405 to DE421: largest difference on an axis (km)"
    out.append(j.number("erratum-1-size", "erratum", text, np.abs(earth).max(), (None, 1.68), paper=">= 10"))
    speed = float(np.linalg.norm(de421().state("earth", j.result.config.start).velocity))
    text = "A time tag that is wrong by a second would make it (km)"
    out.append(j.number("erratum-1-second", "beyond", text, speed, within(29.8, 0.1)))
    return out


def _delays(j: Evidence) -> list[Claim]:
    near, out = j.result.facts["conjunctions"], []
    for name, error, wanted in zip(j.result.config.pulsars, near.error, (5.8, 7.9, 0.045), strict=True):
        text = f"Printed Shapiro term against the exact one, largest of the year, {name} (km)"
        out.append(j.number(f"erratum-2-{name}", "erratum", text, error, about(wanted, 0.02)))
    for name, angle, wanted in zip(j.result.config.pulsars, near.angle, (1.3, 1.6), strict=False):
        text = f"Least angle of {name} from the Sun (deg)"
        out.append(j.number(f"erratum-2-angle-{name}", "beyond", text, angle, within(wanted, 0.05)))
    found = j.result.facts["parallax"]
    text = "Terms of b with distances from the Sun: the delay is exact geometry (km; a delay has seven digits behind the point)"
    out.append(j.number("erratum-3-sun", "beyond", text, found.error, (None, 1e-7)))
    text = "With distances from the barycenter they are wrong: their largest size (km)"
    out.append(j.number("erratum-3-terms", "erratum", text, found.terms, (1e-4, 0.0013)))
    return out


def _differencing(j: Evidence) -> list[Claim]:
    found, out = j.result.facts["overconfidence"], []
    for F, wanted in zip(found, (0.62, 0.42, 0.21, 0.18), strict=True):
        text = f"Differencing with an estimate, F = {F:g}: trace of the position's covariance to the least possible one"
        out.append(j.whole(j.number(f"erratum-4-trace-{F:g}", "erratum", text, found[F], about(wanted, 0.10), paper=">= 1")))
    text = "NEES of TDKF in setting 1 (6 expected)"
    nees = j.of("consistency", "0/tdkf/nees")
    out.append(j.lengthy("erratum-4-nees", "erratum", text, np.mean, [nees], about(25.0, 0.2), paper=6))
    sensitivity = j.result.facts["sensitivity"]
    text = "Sensitivity to the bias with Γ' against the derivative (power of ten, km per km)"
    out.append(j.number("erratum-5-right", "beyond", text, order(sensitivity.right), (None, 1e-12)))
    text = "With the Γ of measurements that are not differenced (km per km)"
    out.append(j.number("erratum-5-plain", "erratum", text, sensitivity.plain, (0.1, None), paper=0))
    found = {"plain slope": "tstdkf/position", "couplings": f"{KNOWN}/tstdkf/position"}
    both = [j.of(study, key, half=True) for study, key in found.items()]
    text = "Position RMSE of TSTDKF with that Γ to that with Γ', second half of 10 days (ratio)"
    out.append(j.lengthy("erratum-5-rmse", "erratum", text, ratio, both, (1.5, None), paper=1))
    both = [j.squares("aug"), j.squares("tdkf")]
    text = "The last noise known in Z', unknown in W': AUG, which has it in both, to TDKF (position RMSE, ratio)"
    out.append(j.lengthy("erratum-6-aug", "erratum", text, ratio, both, (None, 0.9)))
    return out


def _rest(j: Evidence) -> list[Claim]:
    out = []
    text = "Residual i boosts axis i: condition of the pulsars' directions (1 if they were the axes)"
    condition = np.linalg.cond(j.result.config.timing.directions)
    out.append(j.number("erratum-7-condition", "erratum", text, condition, within(11.3, 0.1), paper=1))
    out += _forces(j)
    both = [j.squares("tkf-fair"), j.squares("tstdkf")]
    text = "TKF with the stationary covariances to TSTDKF, setting 1 (position RMSE, ratio): most of the gain is tuning"
    note, printed = "an independent study has .0946 and .0977 km", 1.0 / (1.0 - published.POSITION_BELOW["tkf"] / 100.0)
    out.append(j.lengthy("erratum-9-fair", "erratum", text, ratio, both, (0.92, 1.02), paper=printed, note=note))
    c = j.result.config
    rate = float(np.linalg.norm(c.orbit[3:]) / np.linalg.norm(c.orbit[:3]))
    text = "Initial error: velocity that goes with 1 km on this orbit to the given one (ratio)"
    out.append(
        j.number("erratum-10-velocity", "erratum", text, rate * c.error_km[0] * 1e3 / c.error_m_per_s[0], (45.0, 60.0), paper=1)
    )
    return out


def _forces(j: Evidence) -> list[Claim]:
    """Third bodies are lines, not colored noise."""
    out, lines = [], j.result.facts["spectrum"]
    text = "Spectral flatness of the accelerations by third bodies, worst axis (power of ten; white noise: 1)"
    out.append(j.whole(j.number("erratum-8-flatness", "erratum", text, order(float(lines.flatness.max())), (None, 1e-6))))
    rows = {
        "modeled": ("modeled/tkf", "TKF that models Sun and Moon", 0.041),
        "white": ("white/tkf", "TKF that leaves them to white noise", 0.135),
        "tdkf": ("colored/tdkf", "TDKF with AR(1) noise that matches them", 0.132),
        "aug": ("colored/aug", "AUG with AR(1) noise that matches them", 0.134),
    }
    squares = {id: j.of("forces", f"{key}/position", half=True) for id, (key, _, _) in rows.items()}
    for id, (_, text, near) in rows.items():
        text = f"Sun and Moon pull: position RMSE of {text}, second half of 10 days (km)"
        out.append(j.lengthy(f"erratum-8-{id}", "beyond", text, rms, [squares[id]], about(near, 0.15)))
    text = "Modeling them is worth more than any noise: TDKF with AR(1) noise to TKF that models them (position RMSE, ratio)"
    out.append(
        j.lengthy("erratum-8-ratio", "erratum", text, ratio, [squares["tdkf"], squares["modeled"]], (2.5, None), paper="< 1")
    )
    return out
