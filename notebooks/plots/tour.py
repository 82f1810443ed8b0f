"""Drawings of notebook 00."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize

from celnav.show import colors
from celnav.show.draw import Line as Style
from celnav.show.draw import Panel, band, curve, level, look, panels, quantiles

BLUES = LinearSegmentedColormap.from_list("blues", ["white", colors.COMPARISON])
REDS = LinearSegmentedColormap.from_list("reds", ["white", colors.PAPER])


def fall(times, truth, z):
    """Altitude, speed and range of all runs over time."""
    names = "altitude (km)", "speed (km/s)", "measured range (km)"
    values = truth[..., 0] / 1e3, truth[..., 1] / 1e3, z[..., 0] / 1e3
    shades = colors.TRUTH, colors.TRUTH, colors.MEASUREMENT
    drawn = [
        Panel(
            name.split(" (")[0],
            [quantiles(times, y, Style("runs", color))],
            "time (s)",
            name,
            "",
            {"xlim": (0, times[-1])},
        )
        for name, y, color in zip(names, values, shades)
    ]
    return panels(
        drawn,
        height=2.0,
        legend=False,
        title="A body falls into the atmosphere: 5 to 95 % of the runs, and the median",
    )


def errors(times, error, std):
    """Spread of the errors, and three predicted standard deviations."""
    names = "altitude error (m)", "speed error (m/s)", "error of b (-)"
    drawn = []
    for i, name in enumerate(names):
        low, high = np.quantile(error[..., i], [0.05, 0.95], axis=1)
        reach = 3.0 * std[..., i].mean(1)
        largest = (
            3.0 * np.abs(np.quantile(error[20:, :, i], [0.01, 0.99])).max()
            if i < 2
            else 1.1 * reach[0]
        )
        edge = {"color": colors.SIGMA, "linestyle": "--"}

        def spread(ax, low=low, high=high):
            band(
                ax,
                times,
                low,
                high,
                color=colors.ESTIMATE,
                label="5 to 95 % of the runs",
                alpha=0.5,
            )

        items = [
            spread,
            curve(times, reach, label="±3σ of the filter", **edge),
            curve(times, -reach, **edge),
        ]
        more = {"ylim": (-largest, largest), "xlim": (0, times[-1])}
        drawn.append(Panel("", items, "time (s)", name, "", more))
    return panels(*drawn, height=1.35, sharex=True)


def judged(rows):
    """Errors and consistency of filters, with 95 % intervals."""
    names, place = [*rows], np.arange(len(rows))

    def dots(key, color, marker, label):
        def item(ax):
            values, low, high = np.array([rows[name][key] for name in names]).T
            kind = {
                "color": color,
                "marker": marker,
                "linestyle": "",
                "capsize": 2.0,
                "markersize": 4.0,
            }
            ax.errorbar(values, place, xerr=[values - low, high - values], label=label, **kind)
            for x, y in zip(values, place):
                ax.annotate(
                    f"{x:.3g}" if x < 100 else f"{x:.0f}", (x, y - 0.17), ha="center", va="bottom"
                )
            ax.set_yticks(place, names)
            ax.set_ylim(len(names) - 0.6, -0.8)

        return item

    median = [rows[name]["median"] for name in names]
    hollow = {
        "marker": "o",
        "linestyle": "",
        "markerfacecolor": "white",
        "color": colors.SIGMA,
        "markersize": 4.0,
    }
    return panels(
        [
            Panel(
                "altitude error",
                [
                    dots("rms", colors.ESTIMATE, "s", "all runs, 95 %"),
                    curve(median, place, label="median run", **hollow),
                ],
                "rms (m)",
                log="x",
                more={"xlim": wide([*median, *(x for name in names for x in rows[name]["rms"])])},
            ),
            Panel(
                "consistency",
                [
                    level(1.0, label="consistent", upright=True, color="black"),
                    dots("anees", colors.COMPARISON, "D", "ANEES, 95 %"),
                ],
                "ANEES (-)",
                log="x",
                more={"xlim": wide([1.0, *(x for name in names for x in rows[name]["anees"])])},
            ),
        ],
        height=0.75 + 0.34 * len(rows),
        sharey=True,
    )


def wide(values):
    """Limits of a logarithmic axis with room for numbers beside points."""
    low, high = min(values), max(values)
    room = (high / low) ** 0.12 * 1.06
    return low / room, high * room


def consistency(times, curves, limits):
    """NEES over its dimension of several filters, and the band of a consistent one."""
    items = [
        lambda ax: ax.axhspan(
            *limits, color=colors.SIGMA, alpha=0.3, linewidth=0.0, label="consistent (95 %)"
        )
    ]
    items += [
        curve(times, y, label=name, **look(i) | {"marker": ""})
        for i, (name, y) in enumerate(curves.items())
    ]
    return panels(Panel("", items, "time (s)", "NEES / 3 (-)", "y", {"xlim": (0, times[-1])}))


def smoothing(times, curves):
    """Errors of altitude and speed of filter and smoother."""
    drawn = [
        Panel(
            name,
            [
                curve(times, y[:, i], label=label, **look(k) | {"marker": ""})
                for k, (label, y) in enumerate(curves.items())
            ],
            "time (s)",
            f"RMSE ({unit})",
            "y",
            {"xlim": (0, times[-1])},
        )
        for i, (name, unit) in enumerate((("altitude", "m"), ("speed", "m/s")))
    ]
    return panels(drawn)


def angle(x, errors):
    """The airplane's way past the radar, and the errors of its position."""
    t, rms = errors.pop("time"), errors
    way = [
        curve(x[:, 0] / 1e3, x[:, 1] / 1e3, color=colors.TRUTH, label="airplane"),
        curve([0.0], [0.0], color="black", marker="^", linestyle="", label="radar"),
        curve([-9.0, 0.0], [0.0, 0.0], color=colors.SIGMA, linestyle=":", label="bearing ±π"),
    ]
    lines = [
        curve(t, y, label=name, **look(k) | {"marker": ""})
        for k, (name, y) in enumerate(rms.items())
    ]
    return panels(
        [
            Panel("the way", way, "east (km)", "north (km)", "", {"xlim": (-9.5, 1.5)}),
            Panel("error of position", lines, "time (s)", "RMSE (m)", "y"),
        ]
    )


def heat(efficiency, anees):
    """Efficiency and consistency of filters (rows) on problems (columns)."""
    reach = np.nanmax(anees.to_numpy())

    def squares(frame, shade, norm):
        def item(ax):
            values = frame.to_numpy()
            ax.imshow(np.ma.masked_invalid(values), cmap=shade, norm=norm, aspect="auto")
            for i, row in enumerate(values):
                for j, x in enumerate(row):
                    if np.isfinite(x):
                        dark = norm(x) > 0.7
                        ax.annotate(
                            f"{x:.2f}" if x < 10 else f"{x:.0f}",
                            (j, i),
                            ha="center",
                            va="center",
                            color="white" if dark else "black",
                        )
            ax.set_xticks(
                range(frame.shape[1]), [name.replace(", ", ",\n") for name in frame], rotation=90
            )
            ax.set_yticks(range(len(frame)), frame.index)
            ax.grid(visible=False)

        return item

    return panels(
        [
            Panel("efficiency (best: 1)", [squares(efficiency, BLUES, Normalize(0.0, 1.2))]),
            Panel(
                "ANEES (consistent: 1)",
                [squares(anees, REDS, LogNorm(1.0, 1.5 * reach, clip=True))],
            ),
        ],
        height=1.5 + 0.25 * len(efficiency),
        sharey=True,
    )
