"""Drawings of notebook 08."""

from __future__ import annotations

import numpy as np

from celnav.analysis.metrics import bootstrap, ratio, rms
from celnav.show import colors
from celnav.show.draw import Panel, curve, interval, level, look, panels
from celnav.show.notebook import Folded, Table

MODES = {
    "straight": colors.MEASUREMENT,
    "turn": colors.ESTIMATE,
    "straight, burst": colors.TRUTH,
    "turn, burst": colors.OPEN_LOOP,
}
TURN, BURST = (20.0, 40.0), (60.0, 70.0)


def line(i):
    """Look of curve number i without markers."""
    return look(i) | {"marker": ""}


def lines(t, curves):
    """Curves by their names."""
    return [curve(t, y, label=name, **line(i)) for i, (name, y) in enumerate(curves.items())]


def over_time(t, drawn, height=2.3, shaded=(), **more):
    """Rows of panels with curves over time. drawn: label of the y axis and curves, by title."""
    rows = [
        Panel(
            title,
            [*(interval(*span, label, color) for label, span, color in shaded), *lines(t, curves)],
            "time (s)",
            y,
            "y",
            {"xlim": (t[0], t[-1])} | more,
        )
        for title, (y, curves) in drawn.items()
    ]
    return panels(*rows, height=height, sharex=True)


def maneuver(t, position, velocity):
    """Errors of filters in a turn and a burst."""
    drawn = {"position": ("RMSE (m)", position), "velocity": ("RMSE (m/s)", velocity)}
    shaded = ("turn", TURN, colors.SIGMA), ("burst", BURST, colors.BOUND)
    return over_time(t, drawn, shaded=shaded, ylim=(0.03, 100.0))


def probabilities(t, banks):
    """Mean probabilities of the modes of banks, stacked."""
    drawn = []
    for name, p in banks.items():
        names = list(MODES)[: p.shape[1]]

        def item(ax, p=p, names=names):
            ax.stackplot(t, p.T, labels=names, colors=[MODES[mode] for mode in names])

        drawn.append(
            Panel(
                name,
                [item],
                "time (s)",
                "probability (-)",
                "",
                {"xlim": (0, t[-1]), "ylim": (0, 1)},
            )
        )
    return panels(*drawn, height=1.7, sharex=True)


def dots(*drawn):
    """Values with intervals on logarithmic axes. drawn: title, label of the x axis, values with the
    ends of their intervals by name, and the value of a consistent filter or 0, of each panel.
    """
    shades, markers = (colors.ESTIMATE, colors.COMPARISON), "sD"
    row, names = [], list(drawn[0][2])

    def item(values, k):
        def draw(ax):
            x, low, high = np.array([values[name] for name in names]).T
            place = np.arange(len(names))
            ax.errorbar(
                x,
                place,
                xerr=[x - low, high - x],
                color=shades[k],
                marker=markers[k],
                linestyle="",
                capsize=2.0,
                markersize=4.0,
            )
            for value, at in zip(x, place):
                ax.annotate(
                    f"{value:.3g}" if value < 100 else f"{value:.0f}",
                    (value, at - 0.15),
                    ha="center",
                    va="bottom",
                )
            ax.set_yticks(place, names)
            ax.set_ylim(len(names) - 0.6, -0.8)

        return draw

    for k, (title, label, values, reference) in enumerate(drawn):
        ends = [*np.ravel(list(values.values())), *([reference] if reference else [])]
        room = (max(ends) / min(ends)) ** 0.12 * 1.06
        line = level(reference, label="consistent", color="black", upright=True)
        items = [line] if reference else []
        more = {"xlim": (min(ends) / room, max(ends) * room)}
        row.append(Panel(title, [*items, item(values, k)], label, "", "x", more))
    return panels(row, height=0.75 + 0.34 * len(names), sharey=True)


def ratios(turn_once, turn_always):
    """Errors of banks over those of another filter, by part of a flight and bank."""
    shades = {
        "IMM over Q": (colors.ESTIMATE, "s", -0.14),
        "IMM over Q and R": (colors.COMPARISON, "D", 0.14),
    }

    def panel(title, found):
        def item(ax):
            for name, columns in found.items():
                color, marker, shift = shades[name]
                x, low, high = np.array([*columns.values()]).T
                place = np.arange(len(x)) + shift
                ax.errorbar(
                    x,
                    place,
                    xerr=[x - low, high - x],
                    label=name,
                    color=color,
                    marker=marker,
                    linestyle="",
                    capsize=2.0,
                    markersize=4.0,
                )
            ax.set_yticks(range(len(columns)), columns)
            ax.set_ylim(len(columns) - 0.5, -0.5)

        equal = level(1.0, label="as the AUKF", color="black", upright=True)
        return Panel(title, [equal, item], "position error over that of the AUKF (-)", "", "x")

    drawn = panel("straight, with one turn", turn_once), panel("always turning", turn_always)
    return panels(*drawn, height=1.75, sharex=True)


def with_interval(statistic, *samples):
    """A value, and the ends of its 95 % interval over the runs."""
    return [statistic(*samples), *bootstrap(statistic, *samples)]


def over(found, name, base, case, columns):
    """Position error of a filter over that of another, run by run, in parts of a flight."""
    row = {}
    for title, span in columns.items():
        pair = [found[one]["position, m"][span, case].mean(0) for one in (name, base)]
        row[title] = with_interval(ratio, *pair)
    return row


def table(found, case, columns, measures=("position, m", "velocity, m/s", "NEES / 8")):
    """RMSE and mean NEES of all filters in parts of a flight."""
    rows = {}
    for what in measures:
        statistic = np.mean if "NEES" in what else rms
        for name, one in found.items():
            row = {}
            for title, span in columns.items():
                row[title] = with_interval(statistic, one[what][span, case].mean(0))
            rows[f"{what}: {name}"] = row
    return rows


def folded(title, found):
    """A table of values with their intervals behind a click. found: values by column, by row."""
    head = ["", *next(iter(found.values()))]
    return Folded(
        title, Table(head, [[name, *map(words, row.values())] for name, row in found.items()])
    )


def words(value):
    """A number, or a number with its interval, of three digits."""
    if np.ndim(value) == 0:
        return short(value)
    middle, low, high = map(short, value)
    return f"{middle} [{low}, {high}]"


def short(x):
    """Three digits without an exponent."""
    return f"{x:.0f}" if abs(x) >= 100 else f"{x:.3g}"
