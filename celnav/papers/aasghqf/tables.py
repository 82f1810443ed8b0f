"""Tables 1 to 4: the paper's numbers beside ours, all columns."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.sparse_grid import point_count
from celnav.models.inertial import STATES
from celnav.papers.aasghqf.config import PAPER_WEIGHTS
from celnav.papers.aasghqf.published import TABLE_1, TABLE_1_WEIGHTS, TABLE_2_DEGREE, TABLE_3, TABLE_4
from celnav.papers.aasghqf.study import Result

Row = dict[str, str | float]
COLUMNS = ("phi_x_deg", "phi_y_deg", "phi_z_deg", "v_east_m_per_s", "v_north_m_per_s", "longitude_m", "latitude_m")


def table_1(result: Result) -> list[Row]:  # noqa: ARG001
    """Table 1: points of the sparse grids, n = 1 to 6, level 3."""
    rows: list[Row] = []
    for n, g in enumerate(TABLE_1_WEIGHTS, start=1):
        for name, weights in (("SGHQF", None), ("AASGHQF", g)):
            shown = "1" * n if weights is None else "".join(map(str, weights))
            ours = point_count(n, 3, weights)
            rows.append({"n": n, "filter": name, "weights": shown, "paper": TABLE_1[name][n - 1], "ours": ours})
    return rows


def table_2(result: Result) -> list[Row]:
    """Table 2: degree of observability and weight of each state; ours in two units, free of units, and by nonlinearity."""
    o = result.facts["observability"]
    columns = zip(
        STATES, TABLE_2_DEGREE, PAPER_WEIGHTS, o.svd, o.by_threshold, o.svd_degrees, o.by_threshold_degrees, o.information,
        o.by_nonlinearity, strict=True,
    )  # fmt: skip
    names = (
        "state", "degree, paper", "weight, paper", "degree (phi in rad)", "weight (phi in rad)", "degree (phi in deg)",
        "weight (phi in deg)", "prior / posterior deviation", "weight by nonlinearity",
    )  # fmt: skip
    return [dict(zip(names, (c if isinstance(c, str) else float(c) for c in row), strict=True)) for row in columns]


def table_3(result: Result) -> list[Row]:
    """Table 3: RMSE over the runs, averaged over the epochs, of the first seven states; presets T3 and A-slow."""
    rows: list[Row] = []
    for filter, printed in TABLE_3.items():
        rows.append({"filter": filter, "source": "paper", **dict(zip(COLUMNS, map(float, printed), strict=True))})
        for preset in result.data:
            if preset.startswith("start") or preset == "coarse":
                continue
            error = result.data[preset][f"{filter.lower()}/error"][..., :7]
            ours = np.sqrt(np.square(error).mean(1)).mean(0)
            rows.append({"filter": filter, "source": f"ours, {preset}", **dict(zip(COLUMNS, map(float, ours), strict=True))})
    return rows


def table_4(result: Result) -> list[Row]:
    """Table 4: points, and CPU time of a cycle; ours of one run alone and of one run among 50, on the machine at hand."""
    counts = {"UKF": point_count(13, 2), "SGHQF": point_count(13, 3), "AASGHQF": point_count(13, 3, PAPER_WEIGHTS)}
    return [
        {
            "filter": name,
            "points, paper": TABLE_4[name][0],
            "points, ours": count,
            "time of a cycle, paper (s)": TABLE_4[name][1],
            "one run alone (s)": result.timings[f"cycle {name.lower()}, 1 run, s"],
            "one run among 50 (s)": result.timings[f"cycle {name.lower()}, 50 runs, s"],
        }
        for name, count in counts.items()
    ]
