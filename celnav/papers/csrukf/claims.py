"""What is judged, from the numbers of this very run: the figures here, tables, errata and the rest in ``claims_*``."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.papers.csrukf.claims_beyond import beyond_claims
from celnav.papers.csrukf.claims_errata import errata_claims
from celnav.papers.csrukf.claims_tables import table_claims
from celnav.papers.csrukf.evidence import Evidence, ratio3
from celnav.papers.csrukf.study import Result
from celnav.study.claims import Claim

AXES = ("x", "y", "z", "vx", "vy", "vz")


def claims(result: Result) -> list[Claim]:
    """All claims, in the order of the paper, then its errata and what it leaves out."""
    j = Evidence(result)
    return [*_geometry(j), *_white(j), *_walk(j), *table_claims(j), *errata_claims(j), *beyond_claims(j)]


def _inside(j: Evidence, study: str, filter: str) -> Array:
    """Fraction of the epochs after the first minute within 3 sigma, for each run and component ``(runs, 6)``."""
    first = min(60, j.result.config.steps // 2)
    error, std = (j.get(study, f"{filter}/{key}")[first:] for key in ("error", "std"))
    return np.asarray((np.abs(error) <= 3.0 * std).mean(0))


def _geometry(j: Evidence) -> list[Claim]:
    text = "Three angles fix the position once the hemisphere is known (Eqs. 39-42, corrected): largest error in km"
    return [j.number("figure-1-round-trip", "paper", text, j.result.facts["round_trip_km"], (None, 1e-8))]


def _white(j: Evidence) -> list[Claim]:
    """Figures 2 to 7."""
    out = []
    error = {n: j.get("P/0", f"{n}/error") for n in ("srukf", "csrukf")}
    apart = np.abs(error["srukf"] - error["csrukf"]).max((0, 1)) * np.repeat([1e3, 1.0], 3)
    inside = _inside(j, "P/0", "csrukf")
    latency = "the estimate without latency; the paper's curve is the lagged one, which has seen one sample more"
    for i, axis in enumerate(AXES):
        unit, limit = ("m", 1e-4) if i < 3 else ("m/s", 1e-5)
        text = f"White noise: SRUKF and CSRUKF coincide in {axis} ({unit})"
        out.append(j.number(f"figure-{i + 2}-coincide", "paper", text, apart[i], (None, limit), note=latency))
        text = f"White noise: CSRUKF stays within 3 sigma in {axis} (fraction of the time after 60 s)"
        out.append(j.statistic(f"figure-{i + 2}-containment", "paper", text, np.mean, [inside[:, i]], (0.99, None)))
    return out


def _walk(j: Evidence) -> list[Claim]:
    """Figures 8 to 13."""
    out = []
    white, own = (j.get("P/I", f"{n}/error") for n in ("srukf", "csrukf"))
    inside_white, inside_own = _inside(j, "P/I", "srukf"), _inside(j, "P/I", "csrukf")
    rms_white, rms_own = (np.sqrt(np.square(e).mean(0)) for e in (white, own))
    for i, axis in enumerate(AXES):
        most, unit = (0.10, "km") if i < 3 else (0.30, "m/s")
        id, when = f"figure-{i + 8}", "(fraction of the time after 60 s)"
        text = f"Random-walk noise: SRUKF leaves its own 3 sigma in {axis}, inside {when}"
        out.append(j.statistic(f"{id}-srukf-containment", "paper", text, np.mean, [inside_white[:, i]], (None, most)))
        text = f"Random-walk noise: CSRUKF stays within 3 sigma in {axis} {when}"
        out.append(j.statistic(f"{id}-csrukf-containment", "paper", text, np.mean, [inside_own[:, i]], (0.98, None)))
        text = f"Random-walk noise: a run's time-rms error in {axis}, CSRUKF against SRUKF (ratio of medians)"
        note = f"5, 50, 95 % of the runs ({unit}): SRUKF {_three(rms_white[:, i])}, CSRUKF {_three(rms_own[:, i])}"
        samples = [rms_own[:, i], rms_white[:, i]]
        out.append(j.statistic(f"{id}-time-rms", "paper", text, _medians, samples, (None, 0.2), note=note))
    text = "Random-walk noise: CSRUKF is the open-loop propagation of the prior; the sensors add nothing in 600 s (3-D ratio)"
    samples = [own[-1, :, :3], j.final("P/I", "openloop")[:, :3]]
    out.append(j.statistic("openloop-final", "beyond", text, ratio3, samples, (0.98, 1.02)))
    return out


def _medians(a: Array, b: Array) -> Array:
    return np.asarray(np.median(a) / np.median(b))


def _three(values: Array) -> str:
    return " / ".join(f"{v:.3g}" for v in np.quantile(values, [0.05, 0.5, 0.95]))
