"""Layout of a recording in the viewer: views of spaces, plots, states and texts, and containers of
views.

This module imports rerun. Import it where a recording is made, see `celnav.show.recording`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import choice, finite, instance, numbers
from celnav.gaussian.linalg import Array
from celnav.lazy import requires_extra

with requires_extra("a recording", "record"):
    import rerun as rr
    import rerun.blueprint as rrb

TIMELINE = "t"
"""Name of the timeline of every recording, in seconds."""
DATE = "date"
"""Name of the timeline of dates, where the date of the start is known."""
_SPACE = [13, 16, 24]

__all__ = ["plot", "space", "states"]

text, bar_chart = rrb.TextDocumentView, rrb.BarChartView
"""Views of a text and of bars below ``origin``."""
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

    >>> celnav.show.views.space("world", "orbit, km", eye=[2e4, 0.0, 1e4])
    """

    def past(seconds: float) -> Any:
        boundary, seconds = rrb.TimeRangeBoundary, float(numbers("growing", seconds, ()))
        start = (
            boundary.cursor_relative(seconds=-seconds)
            if np.isfinite(seconds)
            else boundary.infinite()
        )
        until_now = rr.TimeRange(start=start, end=boundary.cursor_relative(seconds=0.0))
        return rrb.VisibleTimeRanges(
            [rrb.VisibleTimeRange(timeline, until_now) for timeline in (TIMELINE, DATE)]
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


def _whole_run() -> Any:
    """The time axis from the first to the last time, where the viewer's default scrolls."""
    end = rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rr.TimeRange(start=end, end=end))


def plot(
    origin: str, name: str, *, limits: tuple[float, float] | None = None, legend: str = "RightTop"
) -> Any:
    """A plot of the curves below ``origin`` over the whole run.

    ``limits``: of the y axis. ``legend``: its corner, such as "LeftBottom"; "": no legend.

    >>> celnav.show.views.plot("error/x", "error x, m", limits=(-1.0, 1.0), legend="LeftTop")
    """
    corners = [side + end for side in ("Left", "Right") for end in ("Top", "Bottom")]
    corner = choice("legend", legend, ["", *corners]) or corners[0]
    return rrb.TimeSeriesView(
        **_named(origin, name),
        axis_x=_whole_run(),
        axis_y=None
        if limits is None
        else rrb.ScalarAxis(range=finite("limits", limits, (2,)).tolist()),
        plot_legend=rrb.PlotLegend(rrb.Corner2D[corner], visible=legend != ""),
    )


def states(origin: str, name: str) -> Any:
    """Colored lanes of the states below ``origin`` over the whole run.

    `celnav.show.recording.Recorder.states` logs them.

    >>> celnav.show.views.states("states", "measurements")
    """
    return rrb.StateTimelineView(**_named(origin, name), time_view=_whole_run())


def blueprint(layout: Any, times: Array | None) -> rrb.Blueprint:
    """The layout, with a small and paused time panel that plays the run in about twenty seconds.

    Without ``times`` the panel follows a run that goes on.
    """
    instance(
        "layout",
        layout,
        rrb.View | rrb.Container,
        "a view or container, such as celnav.show.views.text(...)",
    )
    play: Any = {"play_state": "following"}
    if times is not None:
        speed = max(float(times[-1] - times[0]) / 20.0, 1e-3)
        play = {"play_state": "paused", "playback_speed": speed}
    panel = rrb.TimePanel(state="collapsed", timeline=TIMELINE, **play)
    return rrb.Blueprint(layout, panel, collapse_panels=True)
