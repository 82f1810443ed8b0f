"""Plots of a recording: curves with bounds at three standard deviations, logarithms, bands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array

if TYPE_CHECKING:
    from celnav.show.recording import Recorder


class Curve(NamedTuple):
    """Values ``(T,)`` and, if given, bounds at three standard deviations ``sigma (T,)`` about a
    ``center``.

    Unless ``shown``, the bounds are hidden until clicked in the legend; without ``sigma``, the
    values are.
    """

    values: Array
    color: str
    label: str
    sigma: Array | None = None
    center: Array | float = 0.0
    shown: bool = True
    width: float = 1.5


class Plot(NamedTuple):
    """Curves by name, or their decimal logarithms. ``band``: range of a consistent filter."""

    title: str
    curves: Mapping[str, Curve]
    log: bool = False
    limits: tuple[float, float] | None = None
    band: tuple[float, float] | None = None
    legend: bool = True


def draw(out: Recorder, entity: str, plot: Plot) -> None:
    """Record a plot: each curve below ``entity`` under its name."""
    for name, c in plot.curves.items():
        path, shown = f"{entity}/{name}", plot.log or c.shown or c.sigma is not None
        out.curve(path, c.values, c.color, c.label, width=c.width, shown=shown, log=plot.log)
        if c.sigma is not None and plot.log:
            out.curve(f"{path}/3s", 3.0 * c.sigma, c.color, f"3σ {c.label}", width=0.8, log=True)
        elif c.sigma is not None:
            out.bounds(path, c.sigma, c.label, center=c.center, shown=c.shown, color=c.color)
    if plot.band is not None:
        for end, level in zip(("low", "high"), plot.band, strict=True):
            out.level(
                f"{entity}/band/{end}",
                float(np.log10(level)) if plot.log else level,
                f"95 % band, {end}",
            )
