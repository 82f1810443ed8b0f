"""One style for all figures, and drawing aids without knowledge of any paper; the colors are in `celnav.colors`."""

from __future__ import annotations

import io
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from celnav.linalg import Array

STYLE: Any = {
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "savefig.dpi": 150,
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "legend.fontsize": 7.0,
    "legend.framealpha": 0.85,
    "svg.hashsalt": "celnav",
    "svg.fonttype": "path",
}


class Drawing(Figure):
    """A figure that notebooks show by itself, whatever their backend."""

    def _repr_png_(self) -> bytes:
        return render(self, "png", dpi=64)


def figure(width: float, height: float, rows: int = 1, columns: int = 1, **axes: Any) -> tuple[Figure, Any]:
    """An empty figure (inches) and its axes in celnav's style, outside pyplot's list of open figures."""
    with plt.rc_context(STYLE):
        fig = Drawing(figsize=(width, height))
        return fig, fig.subplots(rows, columns, **axes)


def band(ax: Axes, t: Array, low: Array, high: Array, *, color: str, label: str | None = None) -> None:
    """A translucent band, for quantiles of a Monte Carlo."""
    ax.fill_between(t, low, high, color=color, alpha=0.22, linewidth=0.0, label=label)


def _sparse_ticks(fig: Figure) -> None:
    """No minor ticks on logarithmic axes of many decades: nobody reads them, and they take half of the time of a drawing."""
    for axis in (axis for ax in fig.axes for axis in (ax.xaxis, ax.yaxis)):
        low, high = axis.get_view_interval()
        if axis.get_scale() == "log" and high > 100.0 * low > 0.0:
            axis.set_minor_locator(NullLocator())


def render(fig: Figure, kind: str, dpi: float = 150) -> bytes:
    """The figure as "png" or "svg"; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    _sparse_ticks(fig)
    with plt.rc_context(STYLE):
        fig.savefig(buffer, format=kind, dpi=dpi, metadata={"Date": None} if kind == "svg" else {"Software": None})
    fig.set_layout_engine("none")  # arranged once, for every kind: it takes as long as the drawing
    return buffer.getvalue()
