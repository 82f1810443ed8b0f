"""The figure of a diagnosis: autocorrelations with their band, and NIS of each sensor over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celnav.analysis.diagnose import Diagnosis, SensorConsistency
from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.linalg import Array
from celnav.show import colors
from celnav.show.draw import Item, Panel, curve, look, panels
from celnav.show.draw import level as horizontal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BINS = 60  # means over time


def figure(diagnosis: Diagnosis) -> Figure:
    """A row for each sensor: its autocorrelations, and NIS per degree of freedom in bins of time.

    >>> celnav.show.diagnosis.figure(celnav.analysis.diagnose.diagnose(track))
    """
    rows, percent = [], f"{100 * diagnosis.level:.3g} %"
    for k, sensor in enumerate(diagnosis.sensors):
        components = [c for c in diagnosis.components if c.sensor == k]
        regular = all(c.step is not None for c in components)
        lags = [
            (c.step or 1.0 if regular else 1.0) * np.arange(1, len(c.band) + 1) for c in components
        ]
        items: list[Item] = [_band(lags[0], components[0].band, f"{percent} band if white")]
        for i, c in enumerate(components):
            items.append(curve(lags[i], c.autocorrelation, label=c.name, linewidth=0.9, **look(i)))
        unit = "s" if regular else "samples"
        rows.append([Panel("Is it white?", items, f"lag ({unit})", "autocorrelation")])
        if not np.isnan(sensor.nis):
            means = size(
                diagnosis.times - diagnosis.times[0],
                sensor,
                diagnosis.level,
                f"{percent} band if as predicted",
                "NIS / dof",
            )
            rows[-1].append(
                Panel(
                    "Is it as large as predicted?",
                    [means],
                    "time since the first epoch (s)",
                    "NIS per degree of freedom",
                )
            )
    return panels(*rows, height=2.6)


def _band(lags: Array, half: Array, label: str) -> Item:
    def item(ax: Axes) -> None:
        ax.fill_between(
            lags, -half, half, color=colors.SIGMA, alpha=0.3, linewidth=0.0, label=label
        )
        horizontal(0.0)(ax)

    return item


def size(times: Array, sensor: SensorConsistency, level: float, band: str, label: str) -> Item:
    """Means over bins of equally many measured epochs, with the bands of a consistent filter."""
    measured = sensor.dof > 0
    squares, dof, t = (x[measured] for x in (sensor.squares, sensor.dof, times))
    starts = np.linspace(0, len(t), min(BINS, len(t)) + 1).astype(int)[:-1]
    many = np.diff([*starts, len(t)])
    squares, dof, t = (np.add.reduceat(x, starts) for x in (squares, dof, t))
    bands = [
        chi_square_band(1.0, d / min(sensor.shared, n), level)
        for d, n in zip(dof, many, strict=True)
    ]
    low, high = np.array(bands).reshape(-1, 2).T
    middle = t / many

    def item(ax: Axes) -> None:
        ax.fill_between(middle, low, high, color=colors.SIGMA, alpha=0.3, linewidth=0.0, label=band)
        curve(
            middle,
            squares / dof,
            color=colors.FAINT,
            marker=".",
            markersize=3.0,
            linewidth=0.9,
            label=label,
        )(ax)
        horizontal(1.0)(ax)

    return item
