"""Plots of a recording: curves with bounds at three standard deviations, logarithms, bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array

if TYPE_CHECKING:
    from celnav.show.recording import Recorder


CORNERS = ("RightTop", "LeftTop", "RightBottom", "LeftBottom")
ENTRY_PX = 19.0
"""Height of a legend per entry, and about that of its frame."""
LEGEND = 0.2
"""Width of a legend, as a part of the plot's."""


class Curve(NamedTuple):
    """Values ``(T,)`` and, if given, bounds at three standard deviations ``sigma (T,)`` about a
    ``center``.

    Unless ``shown``, the bounds are hidden until clicked in the legend; unless ``visible``, the
    values are.
    """

    values: Array
    color: str
    label: str
    sigma: Array | None = None
    center: Array | float = 0.0
    shown: bool = True
    width: float = 1.5
    visible: bool = True


class Plot(NamedTuple):
    """Curves by name, or their decimal logarithms. ``band``: range of a consistent filter."""

    title: str
    curves: Mapping[str, Curve]
    log: bool = False
    limits: tuple[float, float] | None = None
    band: tuple[float, float] | None = None
    legend: bool = True


def draw(out: Recorder, entity: str, plot: Plot) -> None:
    """Record a plot: each curve below ``entity`` under its name, with its bounds."""
    for name, c in plot.curves.items():
        path, bounds = f"{entity}/{name}", _bounds(plot, c)
        k = len(bounds)
        y = np.stack([_axis(plot, values) for values in (c.values, *bounds)], -1)
        names, widths = [_label(plot, c), *[_bound_label(plot, c)] * k], [c.width, *[0.8] * k]
        shown = [c.visible, *[c.shown] * k]
        there = np.isfinite(y)
        if (there == there[:, :1]).all():
            out.curves(path, y, c.color, names, widths=widths, shown=shown)
        else:  # a curve and its bounds have different gaps
            for end, part in (("", slice(1)), ("/3s", slice(1, None))):
                about: Any = {"widths": widths[part], "shown": shown[part]}
                out.curves(path + end, y[:, part], c.color, names[part], **about)
    if plot.band is not None:
        out.level(f"{entity}/band", _axis(plot, np.array(plot.band)), "95 % band")


def _bounds(plot: Plot, curve: Curve) -> list[Array]:
    """Three standard deviations, below and above the center; of a logarithm only their size."""
    if curve.sigma is None:
        return []
    if plot.log:
        return [3.0 * curve.sigma]
    return [curve.center + k * curve.sigma for k in (-3.0, 3.0)]


def _label(plot: Plot, curve: Curve) -> str:
    """Name in the legend, the same as that of its bounds if they are visible with it."""
    return _bound_label(plot, curve) if curve.sigma is not None and curve.shown else curve.label


def _bound_label(plot: Plot, curve: Curve) -> str:
    return f"{curve.label} and 3σ" if plot.log else f"{curve.label} ±3σ"


def _axis(plot: Plot, values: Array) -> Array:
    """Values as the axis of a plot has them."""
    if not plot.log:
        return values
    return np.log10(values, out=np.full(values.shape, np.nan), where=values > 0.0)


def legend_place(
    plot: Plot, times: Array, height_px: float
) -> tuple[str, tuple[float, float] | None]:
    """The corner where a legend hides no curve, and limits of the y axis that leave it free.

    Limits are extended as little as possible; ``height_px`` is the height of the plot.
    """
    lines = [np.full(len(times), end) for end in _axis(plot, np.array(plot.band or ()))]
    labels = {"95 % band"} if lines else set()
    for c in plot.curves.values():
        bounds = _bounds(plot, c)
        labels |= {_label(plot, c), *[_bound_label(plot, c)] * len(bounds)}
        lines += [_axis(plot, y) for y in [c.values] * c.visible + bounds * c.shown]
    every = np.stack(lines)
    if not np.isfinite(every).any():
        return CORNERS[0], plot.limits
    bottom, top = plot.limits or (np.nanmin(every), np.nanmax(every))
    part = min(0.6, ENTRY_PX * (0.5 + len(labels)) / height_px)
    width = LEGEND * (times[-1] - times[0])
    places = []
    for corner in CORNERS:
        right = corner.startswith("Right")
        beside = every[:, times >= times[-1] - width if right else times <= times[0] + width]
        sign = 1.0 if corner.endswith("Top") else -1.0
        near, far = (sign * top, sign * bottom) if sign > 0.0 else (sign * bottom, sign * top)
        highest = np.max(sign * beside, initial=-np.inf, where=np.isfinite(beside))
        # Above the highest point, (end - highest) / (end - far) = part.
        end = max(near, (min(highest, near) - part * far) / (1.0 - part))
        limits = (float(bottom), float(end)) if sign > 0.0 else (float(-end), float(top))
        places.append((highest > near, end - near, corner, limits))
    return min(places, key=lambda place: place[:2])[2:]
