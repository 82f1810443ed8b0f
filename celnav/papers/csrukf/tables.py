"""Tables 1 to 3: the paper's numbers beside ours, all columns."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.papers.csrukf.published import TABLE_1, TABLE_2, TABLE_3
from celnav.papers.csrukf.study import Result

Row = dict[str, str | float]
COLUMNS = ("x_km", "y_km", "z_km", "vx_m_per_s", "vy_m_per_s", "vz_m_per_s")


def _rows(result: Result, study: str, printed: dict[str, Array]) -> list[Row]:
    rows: list[Row] = []
    for filter in ("SRUKF", "CSRUKF"):
        error = result.data[study][f"{filter.lower()}/error"]
        average = np.sqrt(np.square(error[1:]).mean((0, 1)))
        for source, values in (
            ("paper", printed[filter]),
            ("ours, final RMSE", np.sqrt(np.square(error[-1]).mean(0))),
            ("ours, time-averaged RMSE", average),
        ):
            rows.append({"filter": filter, "source": source, **dict(zip(COLUMNS, map(float, values), strict=True))})
    return rows


def table_1(result: Result) -> list[Row]:
    """Table 1: RMSE under white noise, Phi = 0."""
    return _rows(result, "P/0", TABLE_1)


def table_2(result: Result) -> list[Row]:
    """Table 2: RMSE under random-walk noise, Phi = I."""
    return _rows(result, "P/I", TABLE_2)


def table_3(result: Result) -> list[Row]:
    """Table 3: RMSE under Phi = 0.8 I and Phi = I."""
    return [
        {"Phi": name, **row}
        for name, study in (("0.8 I", "P/0.8"), ("I", "P/I"))
        for row in _rows(result, study, TABLE_3[study[2:]])
    ]
