"""Layout of a recording in the viewer: views of spaces, plots, texts and logs, and containers of
views.

This module imports rerun. Import it where a recording is made, see `celnav.show.recording`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import finite, instance, number, numbers
from celnav.gaussian.linalg import Array
from celnav.lazy import requires_extra

with requires_extra("a recording", "record"):
    import rerun as rr
    import rerun.blueprint as rrb

TIMELINE = "t"
"""Name of the timeline of every recording, in seconds."""
_SPACE = [13, 16, 24]

text, log, bar_chart = rrb.TextDocumentView, rrb.TextLogView, rrb.BarChartView
"""Views of a text, of events and of bars below ``origin``."""
rows, columns, tabs = rrb.Vertical, rrb.Horizontal, partial(rrb.Tabs, active_tab=0)
"""Containers with views one below the other, side by side, and as tabs with the first in front."""


def _named(origin: str, name: str) -> dict[str, Any]:
    """Arguments with the origin and name of a view; ValueError unless both are texts."""
    texts = {"origin": origin, "name": name}
    return {
        key: instance(key, value, str, "a text, such as 'plots/error'")
        for key, value in texts.items()
    }


def space(
    origin: str,
    name: str,
    *,
    eye: ArrayLike,
    target: ArrayLike = (0.0, 0.0, 0.0),
    up: ArrayLike = (0.0, 0.0, 1.0),
    growing: Mapping[str, float] = {},
) -> Any:
    """A view of the space below ``origin`` from ``eye (3,)`` towards ``target (3,)``.

    ``growing``: entities whose past is visible, and how much of it, s (``inf``: all).
    """

    def past(seconds: float) -> Any:
        boundary, seconds = rrb.TimeRangeBoundary, float(numbers("growing", seconds, ()))
        start = (
            boundary.cursor_relative(seconds=-seconds)
            if np.isfinite(seconds)
            else boundary.infinite()
        )
        return rrb.VisibleTimeRanges(
            timeline=TIMELINE, start=start, end=boundary.cursor_relative(seconds=0.0)
        )

    controls = {"position": ("eye", eye), "look_target": ("target", target), "eye_up": ("up", up)}
    growing = instance("growing", growing, Mapping, "a table, such as {'trail': inf}")
    return rrb.Spatial3DView(
        **_named(origin, name),
        background=_SPACE,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            **{key: finite(name, value, (3,)) for key, (name, value) in controls.items()}
        ),
        overrides={entity: past(seconds) for entity, seconds in growing.items()},
    )


def plot(
    origin: str,
    name: str,
    times: Array,
    *,
    limits: tuple[float, float] | None = None,
    legend: float = 0.24,
) -> Any:
    """A plot of the curves below ``origin`` over the whole run, where the viewer's default scrolls.

    ``limits``: of the y axis. ``legend``: length of time axis after the run, as a part of the run,
        so that the legend hides nothing; 0: no legend.
    """
    legend = number("legend", legend, 0.0)
    times = finite("times", times, ("T",))
    span = float(times[-1] - times[0])
    ends = times[0] - 0.02 * span, times[-1] + (legend or 0.06) * span
    start, end = (rrb.TimeRangeBoundary.absolute(seconds=float(t)) for t in ends)
    return rrb.TimeSeriesView(
        **_named(origin, name),
        axis_x=rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
        axis_y=None
        if limits is None
        else rrb.ScalarAxis(range=finite("limits", limits, (2,)).tolist()),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=legend > 0.0),
    )


def blueprint(layout: Any, times: Array) -> rrb.Blueprint:
    """The layout, with a small and paused time panel that plays the run in about twenty seconds."""
    instance(
        "layout",
        layout,
        rrb.View | rrb.Container,
        "a view or container, such as celnav.show.views.text(...)",
    )
    speed = max(float(times[-1] - times[0]) / 20.0, 1e-3)
    panel = rrb.TimePanel(
        state="collapsed", timeline=TIMELINE, playback_speed=speed, play_state="paused"
    )
    return rrb.Blueprint(layout, panel, collapse_panels=True)
