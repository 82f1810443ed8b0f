"""Drawings of a study's results by part, filter and group; `celnav.show.draw` draws any numbers.

>>> drawn = errors(results, "0", "srukf", SRUKF, "position", 0)
>>> panel = celnav.show.draw.Panel("Figure 2", [drawn], "time (s)", "error of x (km)")
>>> celnav.show.draw.panels(panel, height=2.8)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.metrics import chi_square_band
from celnav.show import colors
from celnav.show.draw import (
    Item,
    Line,
    curve,
    quantiles,
)
from celnav.study.study import Results, When

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# -- items of results ----------------------------------------------------------------------------
def errors(
    results: Results,
    part: str,
    filter: str,
    line: Line,
    group: str,
    axis: int,
    *,
    absolute: bool = False,
    runs: int = 1,
    spread: bool = False,
    **look: Any,
) -> Item:
    """A component of the error over time, for the first ``runs`` runs; ``spread``: also the band
    from 5 to 95 % of all runs.
    """

    def item(ax: Axes) -> None:
        t, error = results.times(part), results.error(part, filter, group)[..., axis]
        error = np.abs(error) if absolute else error
        if spread:
            quantiles(t, error, line, median=False)(ax)
        ax.plot(t, error[:, 0], **line.look | {"label": f"{line.label}, run 1"} | look)
        if runs > 1:
            ax.plot(t, error[:, 1:runs], color=line.color, linewidth=0.4, alpha=0.6)

    return item


def sigma(
    results: Results,
    part: str,
    filter: str,
    name: str,
    group: str,
    axis: int,
    *,
    absolute: bool = False,
) -> Item:
    """Three standard deviations that a filter predicts in its first run."""

    def item(ax: Axes) -> None:
        t, std = results.times(part), 3.0 * results.error(part, filter, group, "std")[:, 0, axis]
        ax.plot(
            t,
            std,
            color=colors.SIGMA,
            linestyle=":",
            label=f"{'' if absolute else '±'}3σ of {name}",
        )
        if not absolute:
            ax.plot(t, -std, color=colors.SIGMA, linestyle=":")

    return item


def rmse(
    results: Results,
    part: str,
    filter: str,
    line: Line,
    group: str,
    *,
    each: bool = False,
    start: int = 0,
) -> Item:
    """RMSE over the runs against time: of the length of a group's error, or with ``each`` of its
    components.
    """
    square = np.square(results.error(part, filter, group)[start:])
    values = np.sqrt((square.mean(-1) if each else square.sum(-1)).mean(1))
    return curve(results.times(part)[start:], values, line)


def consistency(
    results: Results, part: str, lines: Mapping[str, Line], what: str, dof: int
) -> Item:
    """NEES or NIS of filters, averaged over the runs, with the 95 % band of a consistent one."""

    def item(ax: Axes) -> None:
        for filter, line in lines.items():
            values = results.get(part, f"{filter}/{what}")
            ax.plot(
                results.times(part)[1 : len(values)],
                values[1:].mean(1),
                **line.look | {"linewidth": 0.9},
            )
        ax.axhspan(
            *chi_square_band(dof, values.shape[1]), color=colors.SIGMA, alpha=0.4, label="95 % band"
        )

    return item


# -- tables --------------------------------------------------------------------------------------
Rows = list[dict[str, str | float]]


def rmse_table(
    results: Results,
    part: str,
    printed: Mapping[str, Sequence[float]],
    groups: Sequence[str],
    columns: Sequence[str],
    **first: str,
) -> Rows:
    """Rows of RMSE by component for each filter, named in capitals: the printed value, ours at the
    end, and ours averaged over time.
    """
    rows: Rows = []
    moments: dict[str, When] = {"ours, final RMSE": -1, "ours, time-averaged RMSE": slice(1, None)}
    for filter, row in printed.items():
        sources: dict[str, Any] = {"paper": row}
        for source, at in moments.items():
            squares = [results.squares(part, filter.lower(), g, at).mean(0) for g in groups]
            sources[source] = np.sqrt(np.concatenate(squares))
        for source, values in sources.items():
            cells = dict(zip(columns, map(float, values), strict=True))
            rows.append({**first, "filter": filter, "source": source, **cells})
    return rows
