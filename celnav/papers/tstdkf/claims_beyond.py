"""What the paper lacks: a fair baseline, the exact filter, consistency, bounds, and what its result depends on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from celnav.analysis.metrics import ratio, rms
from celnav.gaussian.linalg import Array
from celnav.papers.tstdkf import analysis
from celnav.papers.tstdkf.config import SETTINGS
from celnav.papers.tstdkf.evidence import AXES, Evidence, above, below
from celnav.papers.tstdkf.sweeps import COUPLINGS, LARGER, PARAMETERS, STRONG
from celnav.study.claims import Claim, about, within


def beyond_claims(j: Evidence) -> list[Claim]:
    """In the order of the study."""
    return [*_baseline(j), *_consistency(j), *_bounds(j), *_identities(j), *_parameters(j), *_couplings(j), *_time(j)]


def _baseline(j: Evidence) -> list[Claim]:
    out, fair = [], j.squares("tkf-fair")
    text = "Position RMSE of TKF with the stationary covariances, setting 1 (km)"
    out.append(j.lengthy("fair-tkf", "beyond", text, rms, [fair], about(0.0946, 0.10)))
    text = "EKF with the stationary covariances to EKF with the others, setting 1 (position RMSE, ratio)"
    out.append(j.lengthy("fair-ekf", "beyond", text, ratio, [j.squares("ekf-fair"), j.squares("ekf")], (0.7, 1.05)))
    text = "Position RMSE of AUG below the fair TKF, setting 1 (%): the gain that is real"
    out.append(j.lengthy("fair-aug", "beyond", text, below, [j.squares("aug"), fair], within(22.0, 5.0)))
    return out


def _consistency(j: Evidence) -> list[Claim]:
    out = []
    rows = (
        ("0", "setting 1", "aug", 9, (7.7, 10.3)), ("0", "setting 1", "tkf", 6, about(94.0, 0.25)),
        ("0", "setting 1", "ekf", 6, about(1862.0, 0.35)), ("1", "white", "aug", 9, (7.7, 10.3)),
        ("1", "white", "tkf", 6, (4.7, 7.3)),
    )  # fmt: skip
    for case, where, filter, dof, accept in rows:
        samples = [j.of("consistency", f"{case}/{filter}/nees")]
        text = f"NEES of {filter.upper()}, errors and constant bias drawn from their priors, {where} ({dof} if consistent)"
        out.append(j.lengthy(f"nees-{filter}-{where.replace(' ', '-')}", "beyond", text, np.mean, samples, accept))
    for case, where in (("0", "setting 1"), ("1", "white")):
        text = f"NIS of AUG, {where} (3 if consistent)"
        samples = [j.of("consistency", f"{case}/aug/nis")]
        out.append(j.statistic(f"nis-aug-{where.replace(' ', '-')}", "beyond", text, np.mean, samples, (2.93, 3.07)))
    nees = j.result.data["table 5"]["1/aug/nees"]
    day = nees[-288:].mean(0)
    for id, samples, near, text in (("month", nees.mean(0), 11.0, "mean of the month"), ("end", day, 19.0, "last day")):
        text = f"A random walk is not a sinusoid: NEES of AUG in setting 1, {text} (9 if consistent)"
        out.append(j.lengthy(f"nees-aug-{id}", "beyond", text, np.mean, [samples], about(near, 0.25)))
    return out


def _bounds(j: Evidence) -> list[Claim]:
    out = []
    for i in SETTINGS:
        bound = float(np.sqrt(np.square(j.result.facts["bounds"][i][:, 0]).mean()))
        text = f"Setting {i}: position RMSE of AUG to the posterior Cramér-Rao bound of a walking bias (ratio)"
        samples = [j.squares("aug", setting=i)]
        note = "the bound is a mean over the prior; the true bias is smaller and smoother than the prior expects"
        out.append(j.lengthy(f"bound-{i}", "beyond", text, _relative(bound), samples, (0.85, 1.25), note=note))
    return out


def _relative(size: float) -> Callable[[Array], float]:
    return lambda squares: rms(squares) / size


def _identities(j: Evidence) -> list[Claim]:
    lost, out = j.result.facts["lost correlation"], []
    text = "Color of the process noise alone (L = 0.9): trace of the position's covariance to the exact one, less 1"
    out.append(j.number("identity-colored-process", "beyond", text, abs(lost.kept - 1.0), (None, 5e-5)))
    text = "The same without the correlation of estimate and noise: it is understated (ratio)"
    out.append(j.whole(j.number("identity-dropped", "beyond", text, lost.dropped, (None, 0.9))))
    return out


IMPROVEMENTS = {
    "M0 = (0.03 km)²": (61.8, 41.8),
    "M0 = (1 km)²": (56.7, 33.7),
    "F = 0.8": (37.8, 21.7),
    f"ephemeris error × {LARGER:.3g}": (91.1, 34.0),
    "κ = 0.5, M0 = (1 km)²": (None, -7.0),
    "κ = 5, M0 = (1 km)²": (None, 39.0),
    "κ = 8, M0 = (1 km)²": (None, 55.0),
    "F = L = 0.8, κ = 0.5, form B": (None, -53.0),
    "F = 0.9, L = 0.8, κ = 0.5, form B": (None, -114.0),
    "form B": (52.1, 27.9),
    "white, form B": (None, -51.0),
}
"""Position RMSE of TSTDKF below that of EKF and TKF (%), as an independent linear study of 50 runs has it."""
SCATTER = 8.0
"""Percents; that study found 54 and 43 with eight nonlinear runs where 50 have 57 and 35."""


def _parameters(j: Evidence) -> list[Claim]:
    out, names = [], list(PARAMETERS)
    for label, wanted in IMPROVEMENTS.items():
        i = names.index(label)
        ours = j.of("parameters", f"{i}/tstdkf/position")
        for filter, near in zip(("ekf", "tkf"), wanted, strict=True):
            if near is None:
                continue
            text = f"{label}: position RMSE of TSTDKF below {filter.upper()} (%)"
            both = [ours, j.of("parameters", f"{i}/{filter}/position")]
            size = SCATTER if near > 0.0 else 0.15 * (100.0 - near)
            out.append(j.lengthy(f"parameters-{i}-{filter}", "beyond", text, below, both, within(near, size)))
    # Over a month the same study has 56 % for the first, and 10 to 35 % for the others; these are ten days.
    for k, (label, accept) in enumerate(zip(STRONG, ((30.0, None), (5.0, 40.0), (5.0, 40.0)), strict=True)):
        both = [j.of("strong color", f"{k}/{filter}/position") for filter in ("aug", "tkf")]
        text = f"{label}: position RMSE of AUG below TKF (%): what is possible where differencing hurts"
        out.append(j.lengthy(f"strong-{k}-aug", "beyond", text, below, both, accept))
        both = [j.of("strong color", f"{k}/{filter}/position") for filter in ("tstdkf", "aug")]
        text = f"{label}: position RMSE of TSTDKF (form B) to AUG (ratio)"
        out.append(j.lengthy(f"strong-{k}-tstdkf", "beyond", text, ratio, both, (1.3, None)))
    i = names.index("white, form B")
    both = [j.of("parameters", f"{i}/{filter}/position", half=True) for filter in ("tstdkf", "tkf")]
    text = "White, form B, second half: position RMSE of TSTDKF above TKF (%)"
    out.append(j.lengthy("parameters-white-late", "beyond", text, above, both, within(19.0, 12.0)))
    return out


COUPLED = ((0.068, 0.074, 0.066), (0.068, 0.087, 0.115), (0.158, 0.179, 0.155), (0.158, 0.123, 0.100), (0.158, 0.095, 0.085),
           (0.158, 0.139, 0.265))  # fmt: skip
"""Position RMSE (km) of TKF, TSTDKF and AUG by `COUPLINGS`, second half of ten days, as an independent study has it."""


def _couplings(j: Evidence) -> list[Claim]:
    out = []
    for i, (pair, wanted) in enumerate(zip(COUPLINGS, COUPLED, strict=True)):
        for filter, near in zip(("tkf", "tstdkf", "aug"), wanted, strict=True):
            text = f"κ = {pair[0]:g} taken for {pair[1]:g}: position RMSE of {filter.upper()} (km)"
            samples = [j.of("couplings", f"{i}/{filter}/position", half=True)]
            out.append(j.lengthy(f"coupling-{i}-{filter}", "beyond", text, rms, samples, about(near, 0.20)))
    i = len(COUPLINGS) - 1
    both = [j.of("couplings", f"{i}/{filter}/position", half=True) for filter in ("aug", "tkf")]
    text = "A coupling of the wrong sign: the exact filter is the most fragile: AUG to TKF (position RMSE, ratio)"
    out.append(j.lengthy("coupling-fragile", "beyond", text, ratio, both, (1.2, None)))
    return out


def _time(j: Evidence) -> list[Claim]:
    """How long the bias takes to be told from the orbit."""
    deviations, out = j.result.facts["bias deviations"], []
    for days, wanted in ((1, (0.105, 0.027, 0.078)), (3, (0.065, 0.017, 0.048)), (30, (0.021, 0.005, 0.016))):
        row = deviations[min(288 * days, len(deviations)) - 1]
        for axis, value, near in zip(AXES, row, wanted, strict=True):
            text = f"White noise: deviation of the bias after {days} days, {axis} (km)"
            out.append(j.whole(j.number(f"bias-{days}-{axis}", "beyond", text, value, within(near, 6e-4))))
    text = "Three timings alone fix a position to (km)"
    out.append(j.number("snapshot", "beyond", text, analysis.snapshot(j.result.config), within(2.4, 0.05)))
    return out
