"""Whether a figure is readable, from the boxes that matplotlib computes."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text


def faults(fig):
    """Messages about unreadable parts: clipped texts, overlapping texts, legends over data."""
    renderer, found = FigureCanvasAgg(fig).get_renderer(), []
    with renderer._draw_disabled():  # boxes need no pixels
        fig.draw(renderer)
    flat = [ax for ax in fig.axes if ax.name != "3d"]

    def box(artist):
        return artist.get_window_extent(renderer)

    solid = {
        text for ax in fig.axes if ax.name == "3d" for text in ax.findobj(Text)
    }  # their boxes are known only in 3-D
    hidden = {
        label for ax in flat for axis in _axes(ax) for label in _labels(axis, all_of_them=True)
    } | solid
    shown = {label for ax in flat if ax.axison for axis in _axes(ax) for label in _labels(axis)}
    texts = [
        text
        for text in fig.findobj(Text)
        if text.get_visible() and text.get_text() and (text in shown or text not in hidden)
    ]
    for text in texts:
        b = box(text)
        if b.width and (b.x0 < -1 or b.y0 < -1 or b.x1 > fig.bbox.x1 + 1 or b.y1 > fig.bbox.y1 + 1):
            found.append(f"clipped: {text.get_text()!r}")
    for ax in flat:
        for axis in _axes(ax):
            for a, b in pairwise(
                sorted((box(label) for label in _labels(axis)), key=lambda b: (b.x0, b.y0))
            ):
                if _overlap(a, b) > 1.0:
                    found.append(f"tick labels over one another: {ax.get_title()!r}")
    heads = [
        text
        for ax in flat
        for text in (ax.title, ax.xaxis.label, ax.yaxis.label)
        if text.get_text() and text.get_visible()
    ]
    for a, b in combinations(heads, 2):
        if _overlap(box(a), box(b)) > 1.0:
            found.append(f"{a.get_text()!r} over {b.get_text()!r}")
    for legend in fig.legends:
        found += [
            f"legend over {ax.get_title()!r}"
            for ax in fig.axes
            if _overlap(box(legend), ax.bbox) > 1.0
        ]
    for ax in flat:
        if (legend := ax.get_legend()) is not None:
            b = box(legend)
            for line in ax.lines:
                xy = line.get_transform().transform(np.column_stack(line.get_data()).astype(float))
                if np.any(
                    (xy[:, 0] > b.x0) & (xy[:, 0] < b.x1) & (xy[:, 1] > b.y0) & (xy[:, 1] < b.y1)
                ):
                    found.append(f"legend over {line.get_label()!r}")
    return found


def _axes(ax):
    return ax.xaxis, ax.yaxis


def _labels(axis, *, all_of_them=False):
    ticks = (
        [*axis.get_major_ticks(), *axis.get_minor_ticks()] if all_of_them else axis._update_ticks()
    )
    return [
        label
        for tick in ticks
        for label in (tick.label1, tick.label2)
        if all_of_them or (label.get_visible() and label.get_text())
    ]


def _overlap(a, b):
    """The smaller side of the overlap of two boxes, in pixels."""
    return min(min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0))
