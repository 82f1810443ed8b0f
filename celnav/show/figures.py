"""Drawing aids without knowledge of any paper; the style is in `celnav.show.drawing`, the colors are in `celnav.show.colors`.

matplotlib is imported when something is drawn: processes that only compute start in a third of the time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from celnav.gaussian.checks import integer, number
from celnav.gaussian.linalg import Array

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
