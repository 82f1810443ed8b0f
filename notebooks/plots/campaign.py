"""Drawings of notebook 06: results of a campaign in words."""

from __future__ import annotations

import numpy as np

from celnav.show import colors
from celnav.show.draw import Panel, bars, curve, level, look, note, panels

FILTERS = {
    "srukf-isotropic": "positions, assumes white noise",
    "csrukf-jacobian": "positions, models the correlation",
    "angles+z0": "angles, with the first sample",
}
"""What each filter of the study uses and assumes."""
BOUND = {
    "color": "black",
    "linewidth": 0.9,
    "linestyle": (0, (4, 2)),
    "label": "bound",
    "zorder": 0,
}
CAMERA = "σ of the camera (deg)"


def over_cameras(table, names, label, extra=()):
    """A panel for each correlation, a curve for each filter over the cameras. names: columns of a
    value and the ends of its interval, and of the bound if there is one.
    """
    drawn = []
    for phi, rows in table.groupby("phi"):
        items = list(extra)
        for i, (name, words) in enumerate(FILTERS.items()):
            one = rows[rows["filter"] == name].sort_values("camera_deg")
            x, value, low, high = (one[c].to_numpy() for c in ("camera_deg", *names[:3]))
            style = look(i) | {"label": words, "capsize": 2.0}

            def item(ax, x=x, value=value, low=low, high=high, style=style):
                ax.errorbar(x, value, [value - low, high - value], **style)

            items.append(item)
        if len(names) > 3:
            items.append(curve(x, one[names[3]].to_numpy(), **BOUND))
        drawn.append(Panel(f"φ = {phi:g}", items, CAMERA, label, "xy"))
    return panels(drawn, height=2.4, sharey=True)


def accuracy(table, group, unit, target=None):
    """RMS errors over the cameras, with 95 % intervals, and the bound."""
    names = [
        f"{group}_{what}_{unit.replace('/', '_per_')}" for what in ("rms", "low", "high", "bound")
    ]
    required = (
        [level(target, label=f"required: {target:g} {unit}", color=colors.SIGMA)] if target else []
    )
    return over_cameras(table, names, f"RMS error of the {group} ({unit})", extra=required)


def consistency(table):
    """ANEES over the cameras, and the band of a consistent filter at one epoch."""
    low, high = table[["band_low", "band_high"]].iloc[0]
    shade = {
        "color": colors.SIGMA,
        "alpha": 0.25,
        "linewidth": 0.0,
        "label": "consistent (95 %, one epoch)",
    }
    return over_cameras(
        table,
        ("anees", "anees_low", "anees_high"),
        "ANEES (-)",
        extra=[lambda ax: ax.axhspan(low, high, **shade)],
    )


def over_time(outcome, group, camera_deg):
    """RMS errors of one camera over time, the errors that the filters predict, and the bound."""
    (name, unit), drawn = outcome.groups[group], []
    for point, scored in outcome.first:
        if point.values["camera_deg"] != camera_deg:
            continue
        items = []
        for i, (filter, words) in enumerate(FILTERS.items()):
            scores, style = scored.scores[filter], look(i) | {"marker": ""}
            t = scores["times"]
            rms, sigma = (
                np.sqrt(scores[a][1:, group] / scores[b][1:])
                for a, b in (("square", "count"), ("variance", "predicted"))
            )
            items.append(curve(t[1:], rms, label=words, **style))
            items.append(curve(t[1:], sigma, **style | {"linestyle": ":", "linewidth": 0.8}))
        items.append(curve(t[1:], np.sqrt(scored.bound[1:, group]), **BOUND))
        title = f"φ = {point.values['phi']:g}"
        drawn.append(
            Panel(
                title,
                items,
                "time (s)",
                f"RMS error of the {name} ({unit})",
                "y",
                {"xlim": (0.0, t[-1])},
            )
        )
    return panels(drawn, height=2.4, sharey=True)


def answer(suffices):
    """The largest σ of the camera that suffices, by correlation (rows) and filter (columns)."""
    names = {**FILTERS, "bound": "bound"}
    shades = (colors.ESTIMATE, colors.COMPARISON, colors.OPEN_LOOP, colors.SIGMA)
    heights = {
        words: (suffices[name].to_list(), color)
        for (name, words), color in zip(names.items(), shades)
    }
    numbers = []
    for k, name in enumerate(names):
        for i, value in enumerate(suffices[name]):
            numbers.append(
                note(i + 0.21 * (k - 1.5), value + 0.0018, f"{value:.3f}", ha="center", fontsize=9)
            )
    ticks = [f"φ = {phi:g}" for phi in suffices.index]
    more = {"ylim": (0.0, 0.058)}
    return panels(
        Panel(
            "",
            [bars(ticks, heights), *numbers],
            "correlation of successive samples",
            CAMERA,
            "",
            more,
        )
    )
