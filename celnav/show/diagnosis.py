"""The figure of a diagnosis: autocorrelations with their band, and the size of what each sensor leaves, over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.diagnose import Diagnosis, Sensed
from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.linalg import Array
from celnav.show import colors
from celnav.show.figures import Item, Panel, curve, panels
from celnav.show.figures import level as horizontal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["figure", "size"]

SHADES = (
    colors.COMPARISON,
    colors.ESTIMATE,
    colors.TRUTH,
    colors.OPEN_LOOP,
    colors.PAPER,
    colors.MEASUREMENT,
    colors.REFERENCE,
)
MARKS = "osv^Dx+"
BINS = 60  # means over time


def figure(found: Diagnosis) -> Figure:
    """A row for each sensor: how each component's samples follow each other, and NIS over its degrees of freedom, in bins of time.

    >>> celnav.show.diagnosis.figure(celnav.analysis.diagnose.diagnose(track))
    """
    rows, percent = [], f"{100 * found.level:.3g} %"
    for sensor in found.sensors:
        own = [c for c in found.components if c.name in sensor.names]
        lags = (found.step or 1.0) * np.arange(1, len(own[0].band) + 1)
        items: list[Item] = [
            _band(lags[: len(c.band)], c.band, f"{percent} band if white") for c in own[:1]
        ]
        for i, c in enumerate(own):
            look: dict[str, Any] = {
                "marker": MARKS[i % len(MARKS)],
                "markersize": 3.0,
                "linewidth": 0.9,
                "color": SHADES[i % len(SHADES)],
            }
            items.append(
                curve(lags[: len(c.band)], c.autocorrelation[: len(lags)], label=c.name, **look)
            )
        lag = f"lag ({'epochs' if found.step is None else 's'})"
        rows.append([Panel("Is it white?", items, lag, "autocorrelation")])
        if not np.isnan(sensor.nis):
            rows[-1].append(
                Panel(
                    "Is it as large as claimed?",
                    [
                        size(
                            found.times - found.times[0],
                            sensor,
                            found.level,
                            f"{percent} band if as claimed",
                            "NIS / dof",
                        )
                    ],
                    "time since the first epoch (s)",
                    "NIS over its degrees of freedom",
                )
            )
    return panels(*rows, size=(4.0 + 4.0 * (len(rows[0]) - 1), 2.9 * len(rows) + 0.3))


def _band(lags: Array, half: Array, label: str) -> Item:
    def item(ax: Axes) -> None:
        ax.fill_between(
            lags, -half, half, color=colors.SIGMA, alpha=0.3, linewidth=0.0, label=label
        )
        horizontal(0.0)(ax)

    return item


def size(times: Array, sensor: Sensed, level: float, band: str, label: str) -> Item:
    """Means of bins of as many epochs, each with the band of what it consists of."""
    starts = np.linspace(0, len(times), min(BINS, len(times)) + 1).astype(int)[:-1]
    squares, dof, t = (np.add.reduceat(x, starts) for x in (sensor.squares, sensor.dof, times))
    many = np.diff([*starts, len(times)])
    there = dof > 0
    bands = [
        chi_square_band(1.0, d / min(sensor.shared, n), level)
        for d, n in zip(dof[there], many[there], strict=True)
    ]
    low, high = np.array(bands).reshape(-1, 2).T
    middle = (t / many)[there]

    def item(ax: Axes) -> None:
        ax.fill_between(middle, low, high, color=colors.SIGMA, alpha=0.3, linewidth=0.0, label=band)
        curve(
            middle,
            squares[there] / dof[there],
            color=colors.FAINT,
            marker=".",
            markersize=3.0,
            linewidth=0.9,
            label=label,
        )(ax)
        horizontal(1.0)(ax)

    return item
