"""One run over time: the errors of its components, and its innovations, within their bounds.

>>> track.plot(truth)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.track import Track, space_of
from celnav.gaussian.checks import instance, integer
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import Space
from celnav.show import colors
from celnav.show.draw import Item, Line, Panel, curve, grid, level, panels
from celnav.show.report import component_names, errors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEIGHT = 1.6
"""Height of a row of panels, inches."""
ERROR = Line("error", colors.COMPARISON, width=0.9)
SIGMA = Line("±3σ predicted", colors.SIGMA, "--")
REJECTED: dict[str, Any] = {
    "marker": "x",
    "linestyle": "none",
    "color": colors.PAPER,
    "markersize": 4.0,
}


def figure(
    track: Track,
    truth: ArrayLike | None = None,
    run: int = 0,
    *,
    names: Sequence[str] | None = None,
    space: Space | None = None,
) -> Figure:
    """The figure of `celnav.Track.plot`, which explains the arguments."""
    instance("track", track, Track, "what celnav.run gave")
    runs = max(track.failed_at.size, 1)
    run = integer("run", run, 0, runs - 1)
    drawn = [*_errors(track, truth, run, names, space), *_innovations(track, run)]
    rows = grid(drawn, 1 if len(drawn) == 1 else 2 if len(drawn) <= 6 else 3)
    return panels(*rows, height=HEIGHT)


def _errors(
    track: Track,
    truth: ArrayLike | None,
    run: int,
    names: Sequence[str] | None,
    space: Space | None,
) -> Iterator[Panel]:
    """A panel for each component of the error."""
    if truth is None:
        if track.std is None:
            raise ValueError("track: expected one with deviations; run with keep='std', or 'cov'")
        error, n = None, track.std.shape[-1]
        names = component_names(names, space_of(track.filter) if space is None else space, n)
    else:
        error, names = errors(track, truth, names, space)
        error = _of_run(error, run)
    std = _of_run(track.std, run)
    for i, name in enumerate(names):
        bounds = 3.0 * std[:, i]
        items = [curve(track.times, bounds, SIGMA), curve(track.times, -bounds, SIGMA, label="")]
        if error is not None:
            items.append(curve(track.times, error[:, i], ERROR))
        yield Panel("", items, "time (s)", name)


def _innovations(track: Track, run: int) -> Iterator[Panel]:
    """A panel for each sensor, if innovations are stored."""
    if track.whitened is None or not track.sensors:
        return
    white, used, found = (_of_run(x, run) for x in (track.whitened, track.used, track.innovation))
    start = 0
    for width in track.sensors:
        items: list[Item] = [level(-3.0, 3.0, label="±3, whitened", style="--")]
        for i in range(start, start + width):
            used_at, name = used[:, i], track.measured[i]
            items.append(curve(track.times[used_at], white[used_at, i], label=name, **_dots(i)))
            rejected = track.times[np.isfinite(found[:, i]) & ~used_at]
            if len(rejected):
                items.append(curve(rejected, np.zeros(len(rejected)), label="rejected", **REJECTED))
        yield Panel("", items, "time (s)", "innovation / σ")
        start += width


def _dots(i: int) -> dict[str, Any]:
    """Points of the ``i``-th measured component."""
    shades = colors.ESTIMATE, colors.MEASUREMENT, colors.TRUTH, colors.OPEN_LOOP
    return {
        "color": shades[i % 4],
        "marker": "o^sv"[i % 4],
        "linestyle": "none",
        "markersize": 2.0,
    }


def _of_run(x: Array, run: int) -> Array:
    """One run ``(T, k)`` of an array ``(T, ..., k)``."""
    return x.reshape(len(x), -1, x.shape[-1])[:, run]
