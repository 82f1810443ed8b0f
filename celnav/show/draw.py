"""Drawings of any numbers: a figure has panels, a panel has items, and an item draws on axes.

>>> panel = Panel("Residuals", [curve(times, residuals, label="x")], "time (s)", "residual (m)")
>>> panels(panel, height=2.8)

The style is in `drawing`, the colors are in `colors`. matplotlib is imported when something is
drawn, so processes that only compute start in a third of the time. This module does not depend on
studies, since it also draws reports of tracks and logs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from celnav.gaussian.checks import integer, number
from celnav.gaussian.linalg import Array
from celnav.show import colors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "KINDS",
    "MARKERS",
    "SERIES",
    "STYLES",
    "Item",
    "Line",
    "Panel",
    "band",
    "bars",
    "components",
    "curve",
    "figure",
    "grid",
    "interval",
    "level",
    "look",
    "note",
    "panels",
    "picture_names",
    "pictures",
    "quantiles",
]

WIDTH, ROW = 6.5, 2.3
"""Width of a figure, that of a page's text, and height of a row of panels; inches."""
KINDS = ("png", "svg")
"""Formats in which each figure is written."""
Item = Callable[["Axes"], Any]
"""A function that draws on axes."""
SERIES = (
    colors.ESTIMATE,
    colors.COMPARISON,
    colors.OPEN_LOOP,
    colors.REFERENCE,
    colors.PAPER,
    colors.MEASUREMENT,
)
MARKERS = "osD^vP"
STYLES = ("-", "--", "-.", ":", (0, (8, 2)), (0, (5, 1, 1, 1, 1, 1)))
"""Styles of lines that differ in print without color."""


def figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **axes: Any
) -> tuple[Figure, Any]:
    """An empty figure (inches) and its axes in celnav's style, not registered with pyplot."""
    from celnav.show.drawing import Drawing, styled

    size = number("width", width, above=0.0), number("height", height, above=0.0)
    rows, columns = integer("rows", rows, 1, 100), integer("columns", columns, 1, 100)
    with styled():
        fig = Drawing(figsize=size)
        return fig, fig.subplots(rows, columns, **axes)


class Panel(NamedTuple):
    """The content of one pair of axes.

    Attributes
    ----------
    title, x, y: texts. items: drawn one after the other. log: which axes are logarithmic, "x", "y"
        or "xy". more: further arguments of `Axes.set`.
    """

    title: str
    items: Iterable[Item]
    x: str = ""
    y: str = ""
    log: str = ""
    more: Mapping[str, Any] = {}


def grid(drawn: Sequence[Panel], columns: int) -> list[list[Panel]]:
    """Rows of ``columns`` panels each; empty panels fill the last row."""
    empty: list[Item] = [lambda ax: ax.set_axis_off()]
    filled = [*drawn, *[Panel("", empty)] * (-len(drawn) % columns)]
    return [filled[i : i + columns] for i in range(0, len(filled), columns)]


def panels(
    *rows: Panel | Sequence[Panel],
    height: float = ROW,
    title: str = "",
    legend: bool = True,
    **axes: Any,
) -> Figure:
    """A figure as wide as a page's text, with rows of panels and one legend of all labels below.

    ``height``: of a row, inches. ``title``: of the figure; titles of several panels get the
        letters (a), (b), ... ``legend``: False leaves it out, for curves with labels beside them.
    ``axes``: as for `figure`. If axes share x or y (``sharex="col"``), only the outer ones have
        labels.
    """
    from celnav.show.drawing import legend_below, styled

    every = [[row] if isinstance(row, Panel) else list(row) for row in rows]
    flat = [panel for row in every for panel in row]
    height = number("height", height, above=0.0) * len(every)
    fig, drawn = figure(WIDTH, height, len(every), len(every[0]), squeeze=False, **axes)
    handles: dict[str, Any] = {}
    with styled():
        for ax, panel, letter in zip(drawn.flat, flat, _letters(flat), strict=True):
            for item in panel.items:
                item(ax)
            place, inside = ax.get_subplotspec(), {"title": f"{letter}{panel.title}"}
            if place.is_last_row() or not axes.get("sharex"):
                inside["xlabel"] = panel.x
            if place.is_first_col() or not axes.get("sharey"):
                inside["ylabel"] = panel.y
            scales = {f"{axis}scale": "log" for axis in panel.log}
            ax.set(**inside, **scales, **panel.more)
            for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
                handles.setdefault(label, handle)
        if title:
            fig.suptitle(title)
        if handles and legend:
            legend_below(fig, handles)
    return fig


def _letters(flat: Sequence[Panel]) -> Iterator[str]:
    """Letters before the titles of panels, if there are several and all panels have titles, except
    empty ones at the end.
    """
    titled = sum(bool(panel.title) for panel in flat)
    lettered = titled > 1 and all(panel.title for panel in flat[:titled])
    for panel, letter in zip(flat, "abcdefghijklmnopqrstuvwxyz", strict=False):
        yield f"({letter}) " if lettered and panel.title else ""


def picture_names(stems: Iterable[str]) -> list[str]:
    """Names of the files of figures, such as "figures/figure_01.png"."""
    return [f"{stem}.{kind}" for stem in stems for kind in KINDS]


def pictures(drawings: Iterable[tuple[str, Figure | None]]) -> dict[str, bytes]:
    """Contents of the files of figures, by name. ``drawings``: stems and figures, or None."""
    from celnav.show.drawing import render

    return {
        f"{stem}.{kind}": render(drawing, kind)
        for stem, drawing in drawings
        if drawing is not None
        for kind in KINDS
    }


# -- items ---------------------------------------------------------------------------------------
class Line(NamedTuple):
    """Label, color and line style of a filter in all figures of a study."""

    label: str
    color: str
    style: Any = "-"
    width: float = 1.1

    @property
    def look(self) -> dict[str, Any]:
        """The same as keyword arguments of matplotlib."""
        return {
            "label": self.label,
            "color": self.color,
            "linestyle": self.style,
            "linewidth": self.width,
        }


def look(i: int) -> dict[str, Any]:
    """Color, marker and style of curve number ``i``, as arguments of `curve`."""
    return {
        "color": SERIES[i % 6],
        "marker": MARKERS[i % 6],
        "markersize": 3.0,
        "linestyle": STYLES[(i + i // 6) % 6],
    }


def curve(x: Any, y: Any, line: Line | None = None, **look: Any) -> Item:
    """Item of ``y (T,)`` or ``(T, k)`` over ``x``; ``look``: arguments of `Axes.plot`, which
    replace those of the line.
    """
    return lambda ax: ax.plot(x, y, **(line.look if line else {}) | look)


def components(
    x: Any, y: Array, names: Sequence[str], shades: Sequence[str], **look: Any
) -> list[Item]:
    """A curve for each column of ``y (T, k)``, each of another style."""
    lines = map(Line, names, shades, STYLES)
    return [curve(x, column, line, **look) for column, line in zip(y.T, lines, strict=False)]


def level(
    *values: float,
    label: str = "",
    color: str = colors.SIGMA,
    style: str = ":",
    upright: bool = False,
) -> Item:
    """Lines across the axes; the first has the label."""

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


def note(x: float, y: float, text: str, color: str = "black", **look: Any) -> Item:
    """A label beside a curve, at ``(x, y)`` of the data; ``look``: arguments of `Axes.annotate`."""
    return lambda ax: ax.annotate(text, (x, y), **{"color": color, "va": "center"} | look)


def interval(start: float, end: float, label: str = "", color: str = colors.BOUND) -> Item:
    """A shaded interval of time."""
    return lambda ax: ax.axvspan(
        start, end, color=color, alpha=0.25, linewidth=0.0, label=label or None
    )


def band(
    ax: Axes,
    t: Array,
    low: Array,
    high: Array,
    *,
    color: str,
    label: str | None = None,
    alpha: float = 0.22,
) -> None:
    """Draw a translucent band, such as quantiles of a Monte Carlo."""
    ax.fill_between(t, low, high, color=color, alpha=alpha, linewidth=0.0, label=label)


def quantiles(x: Array, values: Array, line: Line, *, median: bool = True) -> Item:
    """Band from the 5 % to the 95 % quantile of ``values (T, runs)``, and their median."""

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
    """Groups of bars. heights: values, one for each tick, and color, by label. across: horizontal
    bars, the first at the top.
    """

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
