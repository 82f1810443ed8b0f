"""Table 1 of the paper, and two beyond it. Seconds are those of the machine at hand."""

from __future__ import annotations

import numpy as np

from celnav.papers.ssukf import vector
from celnav.papers.ssukf.config import ARCSEC, DEG_PER_H
from celnav.papers.ssukf.study import TIMED, Result

Row = dict[str, str | float]


def table_1(result: Result) -> list[Row]:
    """Table 1: cost from one star sample to the next; the paper's own numbers are lost, it says "about 1/3" less."""
    rows: list[Row] = []
    times = result.timings
    for per in (1, result.config.ratio):
        counted = result.facts["evaluations"][per]
        for name in TIMED:
            points = sum(counted[name])
            label = "MEKF (and Jacobians)" if name == "mekf" else name.upper()
            row: Row = {"updates of time to measurement": f"{per}:1", "filter": label, "points": points}
            row["points to AUKF"] = points / sum(counted["aukf"])
            alone = times[f"{name}, {per}:1, 1 run, s"]
            row["one run alone (s)"] = alone
            row["to AUKF"] = alone / times[f"aukf, {per}:1, 1 run, s"]
            many = f"{name}, {per}:1, 500 runs, s"
            if many in times:
                row["one run among 500 (s)"] = times[many] / 500.0
            rows.append(row)
    return rows


def table_2(result: Result) -> list[Row]:
    """Beyond the paper: readings of its gyro numbers, and what settles with each of them."""
    return [
        {
            "reading": reading.name,
            "sigma_v (rad/s^0.5)": reading.gyro.sigma_v,
            "sigma_u (rad/s^1.5)": reading.gyro.sigma_u,
            "tau (s)": reading.gyro.tau,
            "attitude (arcsec)": float(limit[1, 0] / ARCSEC),
            "drift (deg/h)": float(limit[1, 1] / DEG_PER_H),
            "remark": reading.remark,
        }
        for reading, limit in result.facts["readings"]
    ]


def table_3(result: Result) -> list[Row]:
    """Beyond the paper: one measured vector, total attitude error over the runs by prior deviation (10, 30, 60 deg)."""
    rows: list[Row] = []
    for name in vector.FILTERS:
        row: Row = {"filter": name.upper().replace("TRANSPORTED", "transported")}
        for degrees in vector.PRIORS_DEG:
            error = result.data["vector"][f"{name}/{degrees:g}/error"]
            nees = result.data["vector"][f"{name}/{degrees:g}/nees"]
            row[f"{degrees:g} deg: RMS after 100 s (deg)"] = float(np.sqrt(np.square(error[100]).mean()))
            row[f"{degrees:g} deg: RMS after 1000 s (deg)"] = float(np.sqrt(np.square(error[-1]).mean()))
            row[f"{degrees:g} deg: runs above 1 deg at the end"] = float((error[-1] > 1.0).mean())
            row[f"{degrees:g} deg: median NEES after 10 s"] = float(np.median(nees[10]))
        rows.append(row)
    return rows
