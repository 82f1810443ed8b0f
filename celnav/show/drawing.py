"""The common style of all figures, the figure class, and the bytes of its files."""

from __future__ import annotations

import io
from contextlib import AbstractContextManager
from typing import Any

from celnav.lazy import requires_extra

with requires_extra("a figure", "plot"):
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullLocator
    from PIL import Image

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


def styled() -> AbstractContextManager[None]:
    """A context in which figures are made in celnav's style."""
    return rc_context(STYLE)


class Drawing(Figure):
    """A figure that notebooks display with any backend."""

    def _repr_png_(self) -> bytes:
        """PNG in 256 colors, a third of the size in a notebook."""
        image = Image.open(io.BytesIO(render(self, "png", dpi=88))).convert("RGB")
        buffer = io.BytesIO()
        image.quantize(256, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
        return buffer.getvalue()


def _sparse_ticks(fig: Figure) -> None:
    """Remove minor ticks from logarithmic axes of many decades. They are illegible, and drawing
    them takes half of the time.
    """
    for axis in (axis for ax in fig.axes for axis in (ax.xaxis, ax.yaxis)):
        low, high = axis.get_view_interval()
        if axis.get_scale() == "log" and high > 100.0 * low > 0.0:
            axis.set_minor_locator(NullLocator())


def render(fig: Figure, kind: str, dpi: float = 150) -> bytes:
    """The figure as "png" or "svg"; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    canvas: Any = (FigureCanvasSVG if kind == "svg" else FigureCanvasAgg)(fig)
    _sparse_ticks(fig)
    before = fig.dpi
    fig.dpi = dpi
    # The canvas prints directly, since `Figure.savefig` would arrange the whole figure once more.
    with styled():
        if kind == "svg":
            canvas.print_svg(buffer, metadata={"Date": None})
        else:
            canvas.print_png(buffer, metadata={"Software": None})
    fig.dpi = before
    fig.set_layout_engine("none")  # arranged once, for every kind: it takes as long as the drawing
    return buffer.getvalue()
