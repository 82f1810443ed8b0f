"""Drawings that several studies share, by part, filter and group; the style is in `drawing`, the colors are in `colors`.

matplotlib is imported when something is drawn: processes that only compute start in a third of the time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.checks import integer, number
from celnav.gaussian.linalg import Array
from celnav.show import colors
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def figure(width: float, height: float, rows: int = 1, columns: int = 1, **axes: Any) -> tuple[Figure, Any]:
    """An empty figure (inches) and its axes in celnav's style, outside pyplot's list of open figures."""
    from matplotlib import rc_context

    from celnav.show.drawing import STYLE, Drawing

    size = number("width", width, above=0.0), number("height", height, above=0.0)
    rows, columns = integer("rows", rows, 1, 100), integer("columns", columns, 1, 100)
    with rc_context(STYLE):
        fig = Drawing(figsize=size)
        return fig, fig.subplots(rows, columns, **axes)


def band(ax: Axes, t: Array, low: Array, high: Array, *, color: str, label: str | None = None) -> None:
    """A translucent band, for quantiles of a Monte Carlo."""
    ax.fill_between(t, low, high, color=color, alpha=0.22, linewidth=0.0, label=label)


class Line(NamedTuple):
    """How a filter looks, in every figure of a study."""

    label: str
    color: str
    style: str = "-"
    width: float = 1.1


def errors(
    ax: Axes, results: Results, part: str, filter: str, line: Line, group: str, axis: int, *, absolute: bool = False, runs: int = 1,
    spread: bool = False,
) -> None:  # fmt: skip
    """A component of the error over time, of the first ``runs``; ``spread``: from 5 to 95 % of all of them too, as a band."""
    t, error = results.times(part), results.error(part, filter, group)[..., axis]
    error = np.abs(error) if absolute else error
    if spread:
        band(ax, t, *np.quantile(error, [0.05, 0.95], axis=1), color=line.color, label=f"{line.label}, 5-95 % of runs")
    ax.plot(t, error[:, 0], color=line.color, linestyle=line.style, linewidth=line.width, label=f"{line.label}, run 1")
    if runs > 1:
        ax.plot(t, error[:, 1:runs], color=line.color, linewidth=0.4, alpha=0.6)


def sigma(ax: Axes, results: Results, part: str, filter: str, name: str, group: str, axis: int, *, absolute: bool = False) -> None:
    """Three of the deviations that a filter takes for those of its first run."""
    t, std = results.times(part), 3.0 * results.error(part, filter, group, "std")[:, 0, axis]
    sign = "" if absolute else "±"
    ax.plot(t, std, color=colors.SIGMA, linestyle=":", label=f"{sign}3σ of {name}")
    if not absolute:
        ax.plot(t, -std, color=colors.SIGMA, linestyle=":")


def rmse(ax: Axes, results: Results, part: str, filter: str, line: Line, group: str) -> None:
    """Root mean square length of a group's error over the runs, against time."""
    square = np.square(results.error(part, filter, group)).sum(-1)
    ax.semilogy(
        results.times(part), np.sqrt(square.mean(1)), color=line.color, linestyle=line.style, linewidth=line.width, label=line.label
    )


def consistency(ax: Axes, results: Results, part: str, lines: Mapping[str, Line], what: str, dof: int) -> None:
    """NEES or NIS of filters, averaged over the runs, with the 95 % band of a consistent one."""
    for filter, line in lines.items():
        values = results.get(part, f"{filter}/{what}")
        ax.semilogy(results.times(part)[1:], values[1:].mean(1), color=line.color, label=line.label, linewidth=0.9)
    low, high = chi_square_band(dof, values.shape[1])
    ax.axhspan(low, high, color=colors.SIGMA, alpha=0.4, label="95 % band")


def rmse_table(
    results: Results, part: str, printed: Mapping[str, Sequence[float]], groups: Sequence[str], columns: Sequence[str], **first: str
) -> list[dict[str, str | float]]:
    """Rows of RMSE by component: what is printed for a filter, named in capitals, ours at the end, and averaged over time."""
    rows: list[dict[str, str | float]] = []
    for filter, row in printed.items():
        at_end, averaged = (
            np.sqrt(np.concatenate([results.squares(part, filter.lower(), group, at).mean(0) for group in groups]))
            for at in (-1, slice(1, None))
        )
        for source, values in (("paper", row), ("ours, final RMSE", at_end), ("ours, time-averaged RMSE", averaged)):
            rows.append({**first, "filter": filter, "source": source, **dict(zip(columns, map(float, values), strict=True))})
    return rows
