"""Drawings of notebook 03."""

from __future__ import annotations

import numpy as np

from celnav.papers.tstdkf.scenario import DAY_S, nominal, sky
from celnav.show import colors
from celnav.show.draw import STYLES, Line, Panel, curve, panels
from celnav.show.notebook import Table

FILTERS = {
    "TKF: constant": Line("TKF: constant", colors.COMPARISON, STYLES[2]),
    "C": Line("factor 1.3, as in form C", colors.ESTIMATE, STYLES[1]),
    "B": Line("factor 8, as in form B", colors.PAPER, STYLES[3]),
    "walk": Line("random walk", colors.REFERENCE),
}
TRUTH = Line("truth", "black", width=2.5)


def three_unknowns(config, sim):
    """What the first pulsar's timings consist of, and the timings less their prediction."""
    t = sim.times / 3600.0
    earth, sun, _ = sky(config)
    orbit = nominal(config).state[:, :3]
    truth, bias, z = sim.truth[:, 0, :3], sim.bias[:, 0], sim.z[:, 0]
    n = config.timing.gradient(earth + orbit, sun)[:, 0]
    noise = (z - config.timing.delay(earth + bias + truth, sun))[:, 0]
    residual = (z - config.timing.delay(earth + orbit, sun))[:, 0]
    parts = [
        curve(t, noise, Line("noise V: correlated timings", colors.SIGMA, width=0.9)),
        curve(
            t,
            np.vecdot(n, truth - orbit),
            Line("orbit r: one oscillation per revolution", colors.ESTIMATE, width=2.5),
        ),
        curve(
            t,
            np.vecdot(n, bias),
            Line("ephemeris error b: constant for days", colors.PAPER, STYLES[1], 1.8),
        ),
    ]
    timing = [curve(t, residual, color="black", linewidth=0.9)]
    text = "time (h)", "length (km)"
    more = {"xlim": (0.0, 24.0), "xticks": range(0, 25, 6), "ylim": (-1.0, 1.0)}
    return panels(
        [
            Panel("three unknowns ...", parts, *text, more=more),
            Panel("... of which a timing has the sum", timing, *text, more=more),
        ],
        title=f"One day of timings of {config.pulsars[0]}, less their prediction",
        sharey=True,
    )


def position_rmse(values, title):
    """Position RMSE (km) by filter, as bars with their values."""
    shades = {
        "EKF": colors.OPEN_LOOP,
        "TKF": colors.COMPARISON,
        "TST": colors.ESTIMATE,
        "TDK": colors.FAINT,
        "AUG": colors.REFERENCE,
    }

    def item(ax):
        for name, value in values.items():
            hatch = "////" if "stationary" in name else None
            ax.barh(name, value, 0.7, color=shades[name[:3]], hatch=hatch, edgecolor="white")
            place = {"textcoords": "offset points", "va": "center"}
            ax.annotate(f"{value:.3f}", (value, name), (4, 0), **place)
        ax.invert_yaxis()
        ax.grid(visible=False, axis="y")

    more = {"xlim": (0.0, 1.15 * max(values.values()))}
    drawn = Panel("", [item], "position RMSE (km); hatched: with stationary covariances", more=more)
    return panels(drawn, title=title)


def constant_bias(days, deviations, size):
    """Standard deviation of a constant bias over time, with an unknown and a known orbit."""
    lines = map(Line, deviations, (colors.COMPARISON, colors.TRUTH), STYLES)
    items = [curve(days, deviations[line.label], line) for line in lines]
    items.append(curve(days, size, Line("norm of the bias itself", "black", ":")))
    more = {"xlim": (days[0], days[-1])}
    return panels(
        Panel("", items, "time (days)", "σ of the bias (km)", "xy", more),
        title="How well timings determine a constant bias",
    )


def scalar_bias(seconds, truth, tracks, gains):
    """A scalar bias that varies over a year, its estimates, and their gains."""
    every = slice(288, None, 288)
    t = seconds[every] / DAY_S
    left = [curve(t, truth[every], TRUTH)]
    left += [curve(t, values[every], FILTERS[name]) for name, values in tracks.items()]
    right = [curve(t, values[every], FILTERS[name]) for name, values in gains.items()]
    more = {"xlim": (0.0, t[-1])}
    return panels(
        [
            Panel(
                "estimate of the bias",
                left,
                "time (days)",
                "bias (km)",
                more=more | {"ylim": (-0.2, 0.2)},
            ),
            Panel("gain", right, "time (days)", "gain (-)", "y", more | {"ylim": (1e-5, 1e-1)}),
        ],
        title="Why a bias stage stops following",
    )


def step_response(days, rmse):
    """RMSE of the bias around a step, by filter."""
    looks = zip(rmse, (colors.ESTIMATE, colors.PAPER, colors.FAINT), STYLES)
    items = [curve(days, rmse[name], Line(name, color, style)) for name, color, style in looks]
    more = {"xlim": (0.0, days[-1]), "ylim": (0.0, 1.0)}
    return panels(
        Panel("", items, "time (days)", "bias RMSE (km)", more=more),
        title="A step of 0.3 km on each axis at half time",
    )


def table(rows, digits=4):
    """Rows of a table of the study, with as many digits as a reader needs."""

    def text(value):
        return value if isinstance(value, str) else f"{value:.{digits}g}"

    return Table(list(rows[0]), [list(map(text, row.values())) for row in rows])
