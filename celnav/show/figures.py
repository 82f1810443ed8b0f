"""Drawings that several studies share: a figure is panels, a panel is items, and an item draws itself on axes.

>>> panels(Panel("Figure 2", [errors(r, "0", "srukf", SRUKF, "position", 0)], "time (s)", "error of x (km)"), size=(7.0, 3.2))

The style is in `drawing`, the colors are in `colors`. matplotlib is imported when something is drawn: processes that only compute
start in a third of the time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.checks import integer, number
from celnav.gaussian.linalg import Array
from celnav.show import colors
from celnav.study.study import Results, When

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "Item", "Line", "Panel", "Rows", "band", "bars", "components", "consistency", "curve", "errors", "figure", "interval", "level",
    "panels", "quantiles", "rmse", "rmse_table", "sigma",
]  # fmt: skip

Item = Callable[["Axes"], Any]
"""Draws something."""


def figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **axes: Any
) -> tuple[Figure, Any]:
    """An empty figure (inches) and its axes in celnav's style, outside pyplot's list of open figures."""
    from celnav.show.drawing import Drawing, styled

    size = number("width", width, above=0.0), number("height", height, above=0.0)
    rows, columns = integer("rows", rows, 1, 100), integer("columns", columns, 1, 100)
    with styled():
        fig = Drawing(figsize=size)
        return fig, fig.subplots(rows, columns, **axes)


class Panel(NamedTuple):
    """What one pair of axes shows.

    Attributes
    ----------
    title, x, y: texts. items: drawn one after the other. log: which axes are logarithmic, "x", "y" or "xy". more: of `Axes.set`.
    """

    title: str
    items: Iterable[Item]
    x: str = ""
    y: str = ""
    log: str = ""
    more: Mapping[str, Any] = {}


def panels(
    *rows: Panel | Sequence[Panel],
    size: tuple[float, float],
    legend: Any = "outside lower center",
    **axes: Any,
) -> Figure:
    """A figure of rows of panels, and below them one legend of all labels.

    ``axes``: as of `figure`; where they share x or y (``sharex="col"``) the outer ones alone are labeled.
    """
    from celnav.show.drawing import styled

    grid = [[row] if isinstance(row, Panel) else list(row) for row in rows]
    fig, drawn = figure(*size, len(grid), len(grid[0]), squeeze=False, **axes)
    known: dict[str, Any] = {}
    with styled():
        for ax, panel in zip(drawn.flat, (panel for row in grid for panel in row), strict=True):
            for item in panel.items:
                item(ax)
            scales = {f"{axis}scale": "log" for axis in panel.log}
            x, y = panel.x, panel.y
            if axes.get("sharex") and not ax.get_subplotspec().is_last_row():
                x = ""
            if axes.get("sharey") and not ax.get_subplotspec().is_first_col():
                y = ""
            ax.set(title=panel.title, xlabel=x, ylabel=y, **scales, **panel.more)
            for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
                known.setdefault(label, handle)
        if known and legend:
            each = max(map(len, known)) * 0.05 + 0.45  # inches that a label takes
            columns = 1 if "right" in str(legend) else max(1, min(len(known), int(size[0] / each)))
            fig.legend(known.values(), known, loc=legend, ncols=columns)
    return fig


# -- items of any numbers ------------------------------------------------------------------------------------------------------
class Line(NamedTuple):
    """How a filter looks, in every figure of a study."""

    label: str
    color: str
    style: str = "-"
    width: float = 1.1

    @property
    def look(self) -> dict[str, Any]:
        """The same as matplotlib has it."""
        return {
            "label": self.label,
            "color": self.color,
            "linestyle": self.style,
            "linewidth": self.width,
        }


def curve(x: Any, y: Any, line: Line | None = None, **look: Any) -> Item:
    """``y (T,)`` or ``(T, k)`` over ``x``; ``look``: as of `Axes.plot`, over that of the line."""
    return lambda ax: ax.plot(x, y, **(line.look if line else {}) | look)


def components(
    x: Any, y: Array, names: Sequence[str], shades: Sequence[str], **look: Any
) -> list[Item]:
    """A curve for each column of ``y (T, k)``."""
    return [
        curve(x, column, label=name, color=c, **look)
        for column, name, c in zip(y.T, names, shades, strict=False)
    ]


def level(
    *values: float,
    label: str = "",
    color: str = colors.SIGMA,
    style: str = ":",
    upright: bool = False,
) -> Item:
    """Lines across the axes, the first with a label."""

    def item(ax: Axes) -> None:
        for i, value in enumerate(values):
            line = ax.axvline if upright else ax.axhline
            line(
                value,
                color=color,
                linestyle=style,
                linewidth=0.8,
                label=None if i else label or None,
            )

    return item


def interval(start: float, end: float, label: str = "", color: str = colors.BOUND) -> Item:
    """A part of the time, shaded."""
    return lambda ax: ax.axvspan(
        start, end, color=color, alpha=0.25, linewidth=0.0, label=label or None
    )


def band(
    ax: Axes, t: Array, low: Array, high: Array, *, color: str, label: str | None = None
) -> None:
    """A translucent band, for quantiles of a Monte Carlo."""
    ax.fill_between(t, low, high, color=color, alpha=0.22, linewidth=0.0, label=label)


def quantiles(x: Array, values: Array, line: Line, *, median: bool = True) -> Item:
    """From 5 to 95 % of ``values (T, runs)`` as a band, and their median."""

    def item(ax: Axes) -> None:
        low, middle, high = np.quantile(values, [0.05, 0.5, 0.95], axis=1)
        band(ax, x, low, high, color=line.color, label=f"{line.label}, 5-95 % of runs")
        if median:
            ax.plot(x, middle, **line.look | {"label": f"{line.label}, median"})

    return item


def bars(
    ticks: Sequence[str],
    heights: Mapping[str, tuple[Sequence[float], Any]],
    *,
    across: bool = False,
) -> Item:
    """Groups of bars: label -> values, one for each tick, and color; ``across``: from the left, the first at the top."""

    def item(ax: Axes) -> None:
        place, width = np.arange(len(ticks)), 0.84 / len(heights)
        draw, name = (ax.barh, ax.set_yticks) if across else (ax.bar, ax.set_xticks)
        for k, (label, (values, color)) in enumerate(heights.items()):
            draw(
                place + width * (k - 0.5 * (len(heights) - 1)),
                values,
                0.92 * width,
                color=color,
                label=label,
            )
        name(place, ticks)
        if across:
            ax.invert_yaxis()

    return item


# -- items of results, by part, filter and group -------------------------------------------------------------------------------
def errors(
    results: Results, part: str, filter: str, line: Line, group: str, axis: int, *, absolute: bool = False, runs: int = 1,
    spread: bool = False, **look: Any,
) -> Item:  # fmt: skip
    """A component of the error over time, of the first ``runs``; ``spread``: from 5 to 95 % of all of them too, as a band."""

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
    """Three of the deviations that a filter takes for those of its first run."""

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
    """RMSE over the runs of the length of a group's error, or with ``each`` of its components, against time."""
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


# -- tables ----------------------------------------------------------------------------------------------------------------------
Rows = list[dict[str, str | float]]


def rmse_table(
    results: Results,
    part: str,
    printed: Mapping[str, Sequence[float]],
    groups: Sequence[str],
    columns: Sequence[str],
    **first: str,
) -> Rows:
    """Rows of RMSE by component: what is printed for a filter, named in capitals, ours at the end, and averaged over time."""
    rows: Rows = []
    moments: dict[str, When] = {"ours, final RMSE": -1, "ours, time-averaged RMSE": slice(1, None)}
    for filter, row in printed.items():
        ours = {source: np.sqrt(np.concatenate([results.squares(part, filter.lower(), group, at).mean(0) for group in groups]))
                for source, at in moments.items()}  # fmt: skip
        for source, values in {"paper": row, **ours}.items():
            rows.append(
                {
                    **first,
                    "filter": filter,
                    "source": source,
                    **dict(zip(columns, map(float, values), strict=True)),
                }
            )
    return rows
