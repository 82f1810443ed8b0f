"""Drawings of notebook 02."""

from __future__ import annotations

import numpy as np

from celnav.show import colors
from celnav.show.draw import STYLES, Panel, curve, panels

AXES = (colors.PAPER, colors.TRUTH, colors.COMPARISON)


def idle_points(c: float = 4.0):
    """Weights of sigma points at their images f(x) + w, with and without the sensor's noise."""
    x, w = np.sqrt(c) * np.array([1.0, -1.0]), 0.35 * np.sqrt(c) * np.array([1.0, -1.0])
    image = 1.2 * x + 0.1 * x**2
    one = np.full(2, 0.5 / c)

    def bars(dimensions, idle):
        center = 1.0 - dimensions / c

        def item(ax):
            look = {"width": 0.22, "edgecolor": "white"}
            ax.bar(0.0, center, color=colors.COMPARISON, label="center", **look)
            ax.bar(image, one, color=colors.ESTIMATE, label="points of the state", **look)
            ax.bar(w, one, color=colors.TRUTH, label="points of the process noise", **look)
            for k in range(idle):
                label = None if k else "points of the sensor's noise: idle"
                bottom = center + k * one[0]
                idle_look = look | {"color": colors.OPEN_LOOP, "hatch": "////"}
                ax.bar(0.0, one[0], bottom=bottom, label=label, **idle_look)
            ax.set_ylim(0.0, 0.62)

        return item

    return panels(
        [
            Panel("AUKF: L = 3, 7 points", [bars(3, 2)], "image (-)", "weight (-)"),
            Panel("SSUKF: L = 2, 5 points", [bars(2, 0)], "image (-)", "weight (-)"),
        ],
        title="Time update: the total weight of each image is the same",
        sharey=True,
    )


def sensors(t, angles, gyro, drift, stars, star_error, alone_error):
    """The true attitude, the gyro's error, and roll from each sensor by itself."""
    names = ("roll", "pitch", "yaw")
    lines = [
        curve(t, angle, label=name, color=color, linestyle=style)
        for angle, name, color, style in zip(angles, names, AXES, STYLES)
    ]
    noisy = [
        curve(t[1:], gyro, label="gyro less truth", color=colors.SIGMA, linewidth=0.3),
        curve(t, drift, label="drift of the gyro", color=colors.PAPER, linestyle="--"),
    ]
    star = {"color": colors.ESTIMATE, "marker": ".", "linestyle": "", "markersize": 3.0}
    both = [
        curve(t[stars], star_error, label="roll of the star sensor", **star),
        curve(t, alone_error, label="roll of the gyro alone", color="black", linestyle="-."),
    ]
    return panels(
        Panel("true attitude", lines, "time (s)", "angle (deg)"),
        Panel("gyro, roll", noisy, "time (s)", "rate (deg/h)"),
        Panel("roll from each sensor", both, "time (s)", "error (arcsec)"),
        height=1.5,
        sharex=True,
    )
