"""What is judged, from the numbers of this very run: figures and Table 1 here, errata and the rest in ``claims_*``.

Table 1 is judged by what it counts; seconds depend on the machine and stand in ``timings.json`` only.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from celnav.analysis.metrics import rms
from celnav.gaussian.linalg import Array
from celnav.papers.ssukf.claims_beyond import beyond_claims
from celnav.papers.ssukf.claims_errata import errata_claims
from celnav.papers.ssukf.evidence import ATTITUDE, AXES, DRIFT, Evidence
from celnav.papers.ssukf.study import Result
from celnav.study.claims import Bounds, Claim, order

GYRO = "the paper does not say what its gyro numbers are densities of; this reading is the plausible one (table 2)"
SOON_S = 180.0
"""By then the errors are below all levels that are judged."""


def claims(result: Result) -> list[Claim]:
    """All claims, in the order of the paper, then its errata and what it leaves out."""
    j = Evidence(result)
    return [*_figures(j), *_steady_state(j), *_table_1(j), *errata_claims(j), *beyond_claims(j)]


def _figures(j: Evidence) -> list[Claim]:
    """Figs 1 to 3: how the errors of roll, pitch and yaw settle, and that both filters do so alike."""
    out = []
    for i, (axis, degrees) in enumerate(zip(AXES, (1.0, 2.0, 10.0), strict=True)):
        id, fig, euler = f"figure-{i + 1}", f"Fig. {i + 1}: {axis} error", _euler(j, i)
        start = float(np.abs(euler["ssukf"][0]).mean() / 3600.0)
        out.append(
            j.number(f"{id}-start", "paper", f"{fig} at the start (deg)", start, (degrees - 1e-3, degrees + 1e-3), paper=degrees)
        )
        for filter in ("aukf", "ssukf"):
            samples, text = (
                [j.squares(filter, i, first=0.25, last=0.25)],
                f"{fig} after the first star sample, {filter.upper()} (arcsec)",
            )
            out.append(j.statistic(f"{id}-first-{filter}", "calibrated", text, rms, samples, (18.0, 23.0)))
        both = [j.squares(filter, i, last=SOON_S) for filter in ("aukf", "ssukf")]
        for level, accept in ((10.0, (None, 2.0)), (5.0, (None, 15.0)), (2.0, _crossing(j, 2.0))):
            settled = [j.settles(s, level) for s in both]
            text = f"{fig} of SSUKF below {level:g} arcsec from (s)"
            samples = [both[1]]
            if j.full or level > 2.0:  # the RMSE of few runs dips below a level long before it stays there
                id_level = f"{id}-below-{level:g}"
                out.append(j.statistic(id_level, "calibrated", text, _settling(j, level), samples, accept, note=GYRO))
            text = f"{fig} falls below {level:g} arcsec at the same star sample in both filters (difference, s)"
            out.append(j.number(f"{id}-same-{level:g}", "paper", text, settled[1] - settled[0], (0.0, 0.0)))
        apart = order(float(np.abs(euler["ssukf"] - euler["aukf"])[1:].max()))
        text = f"{fig}: equal accuracy of SSUKF and AUKF (largest difference, power of ten, arcsec)"
        out.append(j.number(f"{id}-equal", "paper", text, apart, (None, 1e-5)))
    text, samples = "Figs 1-3: errors of SSUKF below 2 arcsec from (s), three axes", [j.squares("ssukf", ATTITUDE, last=SOON_S)]
    if j.full:
        out.append(j.statistic("figures-below-2", "calibrated", text, _settling(j, 2.0), samples, (80.0, 115.0), note=GYRO))
    text = "Fig. 3: SSUKF converges faster in yaw than AUKF: below 5 arcsec earlier by (s)"
    earlier = j.settles(j.squares("aukf", 2), 5.0) - j.settles(j.squares("ssukf", 2), 5.0)
    note = "in filter time it cannot be: the two filters are one"
    out.append(j.number("figure-3-faster", "paper", text, earlier, (0.25, None), expected=False, note=note))
    return out


def _settling(j: Evidence, level: float) -> Callable[[Array], float]:
    return lambda squares: j.settles(squares, level)


def _crossing(j: Evidence, level: float) -> Bounds:
    """When the RMSE on one axis may reach a level: three deviations of an RMSE of the full number of runs about the exact one."""
    exact, scatter = j.result.facts["exact"][:, 0], 3.0 / np.sqrt(2.0 * j.result.config.runs)
    early, late = (int(np.argmax(exact < level * factor)) for factor in (1.0 + scatter, 1.0 - scatter))
    return float(j.times[early]), float(j.times[late])


def _euler(j: Evidence, i: int) -> dict[str, Array]:
    return {filter: j.result.data["paper"][f"{filter}/euler"][..., i] for filter in ("aukf", "ssukf")}


def _steady_state(j: Evidence) -> list[Claim]:
    out = []
    late = float(j.times[-1]) * 2.0 / 3.0
    for filter in ("aukf", "ssukf"):
        text = f"Figs 1-3: posterior RMSE of {filter.upper()}, last third (400-600 s), three axes (arcsec)"
        samples = [j.squares(filter, ATTITUDE, first=late).mean(1)]
        out.append(j.statistic(f"steady-attitude-{filter}", "calibrated", text, rms, samples, (0.97, 1.16), note=GYRO))
        text, samples = f"The same of the drift of {filter.upper()} (deg/h)", [j.squares(filter, DRIFT, first=late).mean(1)]
        out.append(j.statistic(f"steady-drift-{filter}", "calibrated", text, rms, samples, (0.0067, 0.0075), note=GYRO))
    text, samples = "Drift of SSUKF below 0.1 deg/h from (s)", [j.squares("ssukf", DRIFT, last=SOON_S)]
    out.append(j.statistic("steady-drift-from", "calibrated", text, _settling(j, 0.1), samples, (45.0, 56.0), note=GYRO))
    return out


def _table_1(j: Evidence) -> list[Claim]:
    out = []
    for per, wanted in ((1, {"aukf": 62, "ssukf": 44}), (25, {"aukf": 806, "ssukf": 644})):
        counted = {name: sum(pair) for name, pair in j.result.facts["evaluations"][per].items()}
        for name, points in wanted.items():
            text = f"Table 1: evaluations of f and h from star to star, {per}:1, {name.upper()} (counted)"
            out.append(j.number(f"table-1-points-{per}-{name}", "paper", text, counted[name], (points, points)))
        saved = 1.0 - counted["ssukf"] / counted["aukf"]
        text = f"Table 1: the SSUKF needs a third less, counted in points at {per}:1 (part saved)"
        note = "as time of point-by-point code 19 to 38 %, of arrays nothing for one run: see the benchmarks"
        id, near, holds = f"table-1-third-{per}", (0.25, 0.40), per == 1
        out.append(j.number(id, "paper", text, saved, near, paper=0.333, expected=holds, note=note))
    return out
