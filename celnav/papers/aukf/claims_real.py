"""What a real receiver's day shows; undecided where its files are absent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from celnav.papers.aukf.evidence import LABELS, Evidence, real_rms
from celnav.papers.aukf.real import FILTERS, Real
from celnav.study.claims import Bounds, Claim

GEOSTATIONARY = "C05"


def real_claims(j: Evidence) -> list[Claim]:
    """Of the first half day; all absent without the files."""
    day = j.result.real
    return [_judged(j, id, text, None if day is None else value(day), accept) for id, text, value, accept in _rows()]


def _judged(j: Evidence, id: str, text: str, value: float | None, accept: Bounds) -> Claim:
    if value is None or not np.isfinite(value):
        return j.absent(f"real-{id}", f"Real receiver: {text}", accept)
    return j.number(f"real-{id}", "beyond", f"Real receiver: {text}", value, accept)


def _rows() -> list[tuple[str, str, Callable[[Real], float], Bounds]]:
    def against_ls(filter: str) -> Callable[[Real], float]:
        return lambda day: real_rms(day, day.tracks[filter]) / real_rms(day, day.tracks["ls"])

    rows: list[tuple[str, str, Callable[[Real], float], Bounds]] = [
        ("ls", "LS, 3-D RMS from the header's position (m)", lambda day: real_rms(day, day.tracks["ls"]), (None, 2.5)),
    ]
    rows += [(filter, f"{LABELS[filter]} to LS, 3-D RMS (ratio)", against_ls(filter), (None, 1.0)) for filter in FILTERS]
    rows += [
        ("same", "EKF and UKF, largest difference of position (m)", _apart, (None, 1e-3)),
        ("burst", "AUKF to UKF in an added burst, 3-D RMS (ratio)", _in_burst, (None, 0.5)),
        ("nis", "NIS of EKF per measurement: the noise is taken for generously", lambda day: day.nis, (None, 0.1)),
        ("consecutive", f"{GEOSTATIONARY} by consecutive broadcast sets, largest distance (m)", _consecutive, (None, 2.0)),
        ("formula", "a geostationary satellite by the others' formula, least distance (km)", _misplaced, (1e3, None)),
    ]  # fmt: skip
    return rows


def _apart(day: Real) -> float:
    return float(np.abs(day.tracks["ekf"] - day.tracks["ukf"])[:, :3].max())


def _in_burst(day: Real) -> float:
    return real_rms(day, day.burst["aukf"], burst=True) / real_rms(day, day.burst["ukf"], burst=True)


def _consecutive(day: Real) -> float:
    return float(day.apart[GEOSTATIONARY].max()) if GEOSTATIONARY in day.apart else float("nan")


def _misplaced(day: Real) -> float:
    return float(day.wrong.min(initial=np.inf)) / 1e3
