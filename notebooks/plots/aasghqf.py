"""Drawings of notebook 04."""

from __future__ import annotations

from itertools import product

import numpy as np
from matplotlib.colors import LogNorm

from celnav.show import colors
from celnav.show.draw import STYLES, Line, Panel, bars, curve, panels

SQUARE = {
    "xlim": (-4.4, 4.4),
    "ylim": (-4.4, 4.4),
    "aspect": "equal",
    "xticks": (-3, 0, 3),
    "yticks": (-3, 0, 3),
}
LOOKS = (colors.ESTIMATE, colors.COMPARISON, colors.OPEN_LOOP)
AGREES = "background-color: #cfe8d8; color: black; font-weight: bold"


def dots(nodes, weights, scale=90.0):
    """Points ``(points, 2)``: the area shows the weight, orange is negative."""
    shades = np.where(weights > 0.0, colors.COMPARISON, colors.PAPER)
    areas = 4.0 + scale * np.sqrt(np.abs(weights))
    return lambda ax: ax.scatter(*nodes.T, areas, c=shades, alpha=0.8)


def levels(g, coefficients):
    """Levels of two rules: products within the budget, with their coefficients, and beyond it."""

    def item(ax):
        ax.grid(False)
        for index in product((1, 2, 3), repeat=2):
            c = coefficients.get(index, 0)
            face = colors.COMPARISON if c > 0 else colors.PAPER if c < 0 else "white"
            edge = "black" if index in coefficients else colors.BODY
            ax.scatter(*index, 260, marker="s", color=face, edgecolor=edge, alpha=0.8)
            text = f"{c:+d}" if c else "0" if index in coefficients else ""
            ax.annotate(text, index, ha="center", va="center", color="white" if c else "black")
        budget = 2 * min(g) + 0.5
        x = np.array([0.5, 3.6])
        ax.plot(x, 1.0 + (budget - (x - 1.0) * g[0]) / g[1], color="black", linestyle="--")

    return item


def idea(*grids):
    """For each grid (weights, coefficients, nodes, weights of the nodes): products and points."""
    rows = []
    limits = {"xlim": (0.5, 3.6), "ylim": (0.5, 3.6), "xticks": (1, 2, 3), "yticks": (1, 2, 3)}
    names = "level of $x_1$", "level of $x_2$"
    for g, coefficients, nodes, weights in grids:
        left = Panel(f"weights {g}: products", [levels(g, coefficients)], *names, "", limits)
        right = Panel(
            f"their sum: {len(weights)} points",
            [dots(nodes, weights)],
            "$x_1$",
            "$x_2$",
            "",
            SQUARE,
        )
        rows.append([left, right])
    title = "Isotropic and anisotropic grid (blue: positive, orange: negative weights)"
    return panels(*rows, height=2.2, title=title)


def products(*grids, columns):
    """Small panels, each with a title, nodes and weights."""
    shown = [Panel(title, [dots(*points, 60.0)], more=SQUARE) for title, *points in grids]
    rows = [shown[i : i + columns] for i in range(0, len(shown), columns)]
    return panels(*rows, height=1.55, sharex=True, sharey=True)


def truth(t, angles, position, fixes, residuals):
    """Errors of the inertial system: angles (deg), position and radar fixes (km), residuals."""

    def lines(values, names):
        looks = zip(names, LOOKS, STYLES)
        return [curve(t, y, Line(*look)) for y, look in zip(values.T, looks)]

    def marks(values, names):
        return [
            curve(t, y, label=name, color=color, marker=marker, linestyle="", markersize=3.0)
            for y, name, color, marker in zip(values.T, names, LOOKS, "osD")
        ]

    def legend(place):
        return lambda ax: ax.legend(loc=place, ncols=3)

    span = {"xlim": (t[0], t[-1])}
    tilts = [*lines(angles, ("φx", "φy", "φz")), legend("center left")]
    places = lines(position, ("longitude", "latitude"))
    places.append(curve(t, fixes, color="black", marker=".", linestyle="", markersize=4.0))
    stars = marks(residuals, "xyz")
    return panels(
        Panel("misalignment", tilts, "time (s)", "error (deg)", more=span),
        Panel(
            "position; dots: radar fixes",
            [*places, legend("upper left")],
            "time (s)",
            "error (km)",
            more=span,
        ),
        Panel(
            "measured residuals of star 1",
            [*stars, legend("center right")],
            "time (s)",
            "residual (-)",
            more=span,
        ),
        height=1.5,
        legend=False,
        sharex=True,
    )


def nonlinear(star, step, names):
    """Mixed differences of all pairs of channels ``(13, 13)``, of two models."""

    def item(values):
        def draw(ax):
            ax.grid(False)
            ax.tick_params(axis="x", rotation=90)
            shown = np.where(values > 1e-6, values, np.nan)
            image = ax.imshow(shown, norm=LogNorm(1e-6, 1e3), cmap="viridis_r")
            if values is step:
                ax.figure.colorbar(image, ax=ax, shrink=0.8)

        return draw

    ticks = {"xticks": range(13), "yticks": range(13), "xticklabels": names, "yticklabels": names}
    return panels(
        [
            Panel("star residuals (σ of the noise)", [item(star)], more=ticks),
            Panel("one step (σ of the prior)", [item(step)], more=ticks),
        ],
        height=2.9,
        title="Mixed differences of two channels; white: none",
    )


def grid_errors(names, errors):
    """Bars of the error of a covariance, one for each grid."""
    heights = {"error": (errors, colors.COMPARISON)}
    item = bars(names, heights, across=True)
    panel = Panel("", [item], "relative error of the covariance of the star residuals (-)", log="x")
    return panels(panel, height=2.2, title="Channels of weight 1, and points", legend=False)


def marked(table, agrees, **formats):
    """A table whose cells in the mask ``agrees`` have a green background."""
    style = table.style.apply(lambda _: np.where(agrees, AGREES, ""), axis=None)
    return style.format(**formats)
