"""Whether a figure is readable: its boxes, the size of its text, its colors and line styles."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.text import Text

WIDTH, POINTS, DISTANCE = 6.5, 9.0, 15.0
"""Largest width of a figure, inches; smallest text, points; smallest color distance, CIELAB."""
VISION = {
    "normal": np.eye(3),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
}
"""What dichromats see, on linear RGB: Machado, Oliveira and Fernandes 2009, severity 1."""
XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.072175],
        [0.0193339, 0.119192, 0.9503041],
    ]
)
WHITE = np.array([0.95047, 1.0, 1.08883])


def cielab(color, vision="normal"):
    """CIELAB of an sRGB color, as eyes with a vision see it."""
    rgb = np.asarray(to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    t = XYZ @ np.clip(VISION[vision] @ linear, 0.0, 1.0) / WHITE
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def color_distance(a, b):
    """The smallest CIELAB distance of two colors over the three visions."""
    return min(float(np.linalg.norm(cielab(a, v) - cielab(b, v))) for v in VISION)


def alike(fig):
    """Curves that cannot be told apart: by color in the figure, or by style in their axes."""
    labeled = {}
    for ax in fig.axes:
        curves = [line for line in ax.lines if _is_labeled(line) and len(line.get_xdata())]
        for line in curves:
            labeled.setdefault(to_rgb(line.get_color()), line.get_label())
        for a, b in combinations(curves, 2):
            if _style(a) == _style(b) and to_rgb(a.get_color()) != to_rgb(b.get_color()):
                yield f"one style: {a.get_label()!r} and {b.get_label()!r} in {ax.get_title()!r}"
        for bars in ax.containers:
            if hasattr(bars, "patches") and bars.patches and _is_labeled(bars):
                labeled.setdefault(to_rgb(bars.patches[0].get_facecolor()), bars.get_label())
        for points in ax.collections:
            colors = points.get_facecolor()
            if _is_labeled(points) and not isinstance(points, LineCollection) and len(colors) == 1:
                alpha = colors[0][3]
                flat = tuple(1.0 - alpha * (1.0 - c) for c in colors[0][:3])
                if alpha > 0.5:  # a band is told from a curve by its shape
                    labeled.setdefault(flat, points.get_label())
    for (a, one), (b, other) in combinations(labeled.items(), 2):
        if (distance := color_distance(a, b)) < DISTANCE:
            yield f"colors {distance:.0f} apart: {one!r} and {other!r}"


def _is_labeled(artist):
    return artist.get_label() and not str(artist.get_label()).startswith("_")


def _style(line):
    """What is left of a line's look without color: dashes, marker, and whether it is wide."""
    dashes = line._dash_pattern if line.get_linestyle() != "None" else None
    relative = (
        None
        if dashes is None or dashes[1] is None
        else tuple(np.round(np.asarray(dashes[1]) / line.get_linewidth(), 3))
    )
    shape = "none" if dashes is None else relative
    return shape, line.get_marker(), line.get_linewidth() >= 2.5


def faults(fig):
    """What cannot be read, in words: clipped or small texts, texts over one another, legends over
    data, curves that look alike.
    """
    renderer, found = FigureCanvasAgg(fig).get_renderer(), [*alike(fig)]
    if fig.get_size_inches()[0] > WIDTH:
        found.append(f"wider than {WIDTH} inches: {fig.get_size_inches()[0]:g}")
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
        if text.get_fontsize() < POINTS - 1e-6:
            found.append(f"text of {text.get_fontsize():g} points: {text.get_text()!r}")
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
