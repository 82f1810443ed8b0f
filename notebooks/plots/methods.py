"""Drawings of notebook 08."""

from __future__ import annotations

import numpy as np

from celnav.analysis.metrics import bootstrap, ratio, rms
from celnav.show import colors, showcase
from celnav.show.draw import Panel, curve, interval, level, look, panels
from celnav.show.estimates import Estimate
from celnav.show.notebook import Folded, Table
from celnav.show.plots import Curve, Plot
from celnav.show.showcase import Showcase
from celnav.study.trial import Group

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


def noise_tables(learned, truths, columns):
    """Two flights for each kind of truth: tables of all filters, and of their position errors over
    those of the last filter. truths: number of the first flight by title. columns: parts of the
    first and of the second flight.
    """
    *others, informed = learned
    for title, case in truths.items():
        rows = {}
        for shift, parts in enumerate(columns):
            found = table(learned, case + shift, parts, ("position, m", "NEES / 8"))
            for name in others:
                ratios = over(learned, name, informed, case + shift, parts)
                found[f"position error over {informed}: {name}"] = ratios
            for name, row in found.items():
                rows[name] = rows.get(name, {}) | row
        yield folded(title, rows)


def record(file, t, tracks, truth):
    """Record the first of several runs: errors of a bank and of another filter, and which model
    holds. tracks: by name, the bank's first, with its probabilities `p` of the modes.
    """
    shades = {"bank": colors.ESTIMATE, "one": colors.COMPARISON}
    estimates = {
        key: Estimate(name, color, (track.mean - truth)[:, 0], track.cov[:, 0, 0])
        for (key, color), (name, track) in zip(shades.items(), tracks.items(), strict=True)
    }
    bank, _ = tracks.values()
    p, modes = bank.extra["p"][:, 0, 0], np.array([*MODES])
    burst, turn = ((t >= start) & (t < end) for start, end in (BURST, TURN))
    curves = {f"model_{i}": Curve(p[:, i], MODES[mode], mode) for i, mode in enumerate(modes)}
    shown = Showcase(
        "methods: interacting multiple models",
        NOTES,
        t,
        estimates,
        [Group("position", "m", slice(0, 3), axes="XYZ")],
        plots={"models": {"probability": Plot("probability of each model", curves)}},
        states={"flight": modes[turn + 2 * burst].tolist(), "bank": modes[p.argmax(1)].tolist()},
        shades=MODES,
        start=0.5 * sum(BURST),
    )
    showcase.record(shown, file)


NOTES = """# A turn and a burst

**The bank switches to the model of the turn, and to that of the burst. The AUKF has one process
noise, and enlarges the noise of its ranges in the burst.**

The lanes have the maneuver of the flight, and the most probable of the bank's four models.
"""
