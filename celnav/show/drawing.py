"""The common style of all figures, the figure class, and the bytes of its files."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

from celnav.lazy import requires_extra

with requires_extra("a figure", "plot"):
    import matplotlib
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator
    from PIL import Image

STYLE: Any = {
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "savefig.dpi": 150,
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "figure.titlesize": 9.0,
    "figure.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "legend.fontsize": 9.0,
    "legend.handlelength": 2.6,  # so that a style of dashes is seen
    "legend.framealpha": 0.85,
    "svg.hashsalt": "celnav",
    "svg.fonttype": "path",
}


def styled() -> AbstractContextManager[None]:
    """A context in which figures are made in celnav's style."""
    return rc_context(STYLE)


class Drawing(Figure):
    """A figure that notebooks display with any backend."""

    def draw(self, renderer: Any) -> None:
        """Draw, with tidy ticks on logarithmic axes."""
        for ax in self.axes:
            _tidy(ax.xaxis)
            _tidy(ax.yaxis)
        super().draw(renderer)

    def _repr_png_(self) -> bytes:
        """PNG in 128 colors, a quarter of the size in a notebook; rare colors keep their hue."""
        image = Image.open(io.BytesIO(render(self, "png", dpi=100))).convert("RGB")
        buffer = io.BytesIO()
        few = image.quantize(128, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        few.save(buffer, "PNG", optimize=True)
        return buffer.getvalue()


def legend_below(fig: Figure, handles: Mapping[str, Any]) -> None:
    """One legend below all axes, with as many columns as there is room for; the figure grows by the
    legend's height.
    """
    size, per_point = matplotlib.rcParams["legend.fontsize"], 1.0 / 72.0
    letters = max(map(len, handles))
    column = per_point * size * (0.52 * letters + 2.6 + 2.8)  # inches of text, handle and gaps
    width, height = fig.get_size_inches()
    columns = max(1, min(len(handles), int(width / column)))
    rows = -(-len(handles) // columns)
    fig.set_size_inches(width, height + per_point * size * (1.5 * rows + 1.0))
    fig.legend(handles.values(), handles, loc="outside lower center", ncols=columns)


def _tidy(axis: Any) -> None:
    """Ticks of a logarithmic axis: plain numbers, and no minor ticks, which are illegible and take
    half of the drawing's time.
    """
    low, high = axis.get_view_interval()
    if axis.get_scale() != "log" or not high > low > 0.0:
        return
    if high < 5.0 * low:
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    elif high < 50.0 * low:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(_plain if low > 5e-4 and high < 2e5 else _power)


def _plain(value: float, _: int) -> str:
    """A number as a person writes it: 0.01, 1390."""
    return f"{value:.6g}"


def _power(value: float, _: int) -> str:
    """A number of an axis over many decades: 10⁻⁶, 2·10⁻⁶."""
    power = math.floor(math.log10(abs(value)) + 1e-9)
    factor = f"{value / 10.0**power:g}"
    front = "" if factor == "1" else rf"{factor} \cdot "
    return f"${front}10^{{{power}}}$"


def render(fig: Figure, kind: str, dpi: float = 150) -> bytes:
    """The figure as "png" or "svg"; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    canvas: Any = (FigureCanvasSVG if kind == "svg" else FigureCanvasAgg)(fig)
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
