"""Table 1, whose body is lost, and tables of what lies beyond the paper."""

from __future__ import annotations

import numpy as np

from celnav.analysis.metrics import rms
from celnav.gaussian.linalg import Array
from celnav.papers.aukf.analysis import TIMED
from celnav.papers.aukf.evidence import AXES, COMPARED, LABELS, real_rms, size
from celnav.papers.aukf.study import Result
from celnav.papers.aukf.sweeps import FROM_A_FIX, INITIAL_KM, PROCESS_NOISE, SMALL_ALPHA, WINDOWS

Row = dict[str, str | float]
CASES = {
    "ranges": "burst on all ranges",
    "both": "burst on ranges and rates",
    "one": "burst on one range",
    "mistuned": "mistuned R",
}


def table_1(result: Result) -> list[Row]:
    """Table 1: RMSE of X, Y and Z by filter; the paper's numbers are lost."""
    rows: list[Row] = []
    for study, case, text, filters in (
        ("main", "none", "as tuned", ("ls", "ekf", "ukf", "aukf")),
        ("disturbed", "mistuned", "noise of ranges mistuned", ("ukf", "aukf")),
    ):
        for filter in filters:
            values = {f"{axis} (m)": rms(result.squares(study, f"{case}/{filter}", "all", axis=i)) for i, axis in enumerate(AXES)}
            rows.append({"case": text, "filter": LABELS[filter], "paper": "lost", **values})
    return rows


def table_2(result: Result) -> list[Row]:
    """Beyond the paper: position RMSE (m) of all filters by where the disturbance is."""
    rows: list[Row] = []
    for case, text in CASES.items():
        for filter in COMPARED:
            key = f"{case}/{filter}"
            values = {f"{w} (m)": rms(result.squares("baselines", key, w)) for w in ("quiet", "burst", "after", "all")}
            values["peak (m)"] = float(result.peaks("baselines", key).mean())
            rows.append({"case": text, "filter": LABELS[filter], **values})
    return rows


def table_3(result: Result) -> list[Row]:
    """Beyond the paper: quiet position RMSE (m) by interval and process noise."""
    rows: list[Row] = []
    for interval, densities in PROCESS_NOISE.items():
        for density in densities:
            key, data = f"{interval:g}/{density:g}", result.data["process noise"]
            row: Row = {"interval (s)": interval, "process noise (m^2/s^3)": density, "NIS / dof, EKF": nis(result, key, interval)}
            for filter in ("ekf", "aukf", "group"):
                found = rms(result.squares("process noise", f"{key}/{filter}", "quiet", interval_s=interval))
                row[f"{LABELS[filter]} (m)"] = found
            factor = data[f"{key}/aukf/factor"][result.window("quiet", interval)]
            row["mean factor of the rates"] = float(factor[..., factor.shape[-1] // 2 :].mean())
            rows.append(row)
    return rows


def nis(result: Result, key: str, interval: float) -> float:
    """Mean NIS per degree of freedom of the EKF, quiet."""
    data = result.data["process noise"]
    values = data[f"{key}/ekf/nis"][result.window("quiet", interval)]
    return float(values.mean() / data[f"{key}/aukf/factor"].shape[-1])


def table_4(result: Result) -> list[Row]:
    """Beyond the paper: position RMSE (m) in the burst and after it, by rate and length of the window."""
    rows: list[Row] = []
    for (label, interval, density), lengths in WINDOWS.items():
        for filter in ("ukf", *(f"M = {M}" for M in lengths), "group"):
            row: Row = {"rate": label, "process noise (m^2/s^3)": density or result.config.acceleration_noise}
            name = f"AUKF, {filter}" if filter.startswith("M") else LABELS[filter]
            found = rms(result.late(label, interval, filter))
            rows.append({**row, "filter": name, "RMSE (m)": found})
    return rows


def table_5(result: Result) -> list[Row]:
    """Beyond the paper: median position error (m) after the first updates, by the initial error."""
    rows: list[Row] = []
    for km in INITIAL_KM:
        for filter in ("ekf", "ukf", SMALL_ALPHA, "aukf", FROM_A_FIX):
            errors = medians(result, km, filter)
            row: Row = {"initial error (km)": km, "filter": LABELS.get(filter, filter)}
            rows.append(row | {f"after epoch {k} (m)": float(errors[k]) for k in (0, 1, 5, 30) if k < len(errors)})
    return rows


def medians(result: Result, km: float, filter: str) -> Array:
    """Median over the runs of the position error ``(T,)`` m."""
    return np.asarray(np.median(size(result.data["initial errors"][f"{km:g}/{filter}/error"]), axis=1))


def table_6(result: Result) -> list[Row]:
    """Beyond the paper: consistency where the truth moves as the filters think it does."""
    data, rows, settled = result.data["matched"], [], result.window("all", 1.0)
    bound = float(data["bound"][settled][..., :3].sum(-1).mean())
    for filter in ("ekf", "ukf", "aukf", "group", "channel", "no redraw"):
        error, nees = data[f"{filter}/error"][settled], data[f"{filter}/nees"][settled]
        row: Row = {"filter": LABELS.get(filter, filter), "NEES (8 if consistent)": float(nees.mean())}
        row["NIS / dof"] = float(data[f"{filter}/nis"][settled].mean() / (2 * len(result.facts["geometry"].names)))
        row["position RMSE / bound"] = float(np.sqrt(np.square(error[..., :3]).sum(-1).mean() / bound))
        rows.append(row)
    return rows


def table_7(result: Result) -> list[Row]:
    """Beyond the paper: CPU time of a step on the machine at hand."""
    return [
        {
            "filter": LABELS[filter],
            "one run alone (ms)": 1e3 * result.timings[f"step {filter}, 1 run, s"],
            "one run among 100 (ms)": 1e3 * result.timings[f"step {filter}, 100 runs, s"],
        }
        for filter in TIMED
    ]


def table_8(result: Result) -> list[Row]:
    """Beyond the paper: the first half of a real receiver's day, position from the header's."""
    if result.real is None:
        return [{"filter": "input absent", "RMS (m)": "", "RMS with an added burst (m)": ""}]
    rows: list[Row] = []
    for filter in result.real.tracks:
        burst = real_rms(result.real, result.real.burst[filter], burst=True)
        value = real_rms(result.real, result.real.tracks[filter])
        rows.append({"filter": LABELS[filter], "RMS (m)": value, "RMS with an added burst (m)": burst})
    return rows
