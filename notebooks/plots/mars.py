"""Drawings of notebook 09."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from celnav.models.pulsar import LIGHT_KM_S
from celnav.papers import mars
from celnav.papers.mars.show import IGNORING, MODES
from celnav.show import colors
from celnav.show.draw import SERIES, STYLES, Line, Panel, band, curve, interval, level, panels

YEARS = "time since departure (years)"


def idea(seed=3):
    """Spin noise of B1937+21 with the fit of a timing model, and the noises of four pulsars."""
    rng, fit = np.random.default_rng(seed), 15.0
    f = np.arange(1.0, 800.0) / 64.0  # per year
    t = np.linspace(-fit, 0.7, 800)
    density = mars.spectrum(f / 31557600.0, *mars.RED["B1937+21"]) / (64.0 * 31557600.0)
    a, b = np.sqrt(density) * rng.standard_normal((2, len(f)))
    angle = 2.0 * np.pi * f * t[:, None]
    noise = LIGHT_KM_S * (np.cos(angle) @ a + np.sin(angle) @ b)
    past = t < 0.0
    model = np.polyval(np.polyfit(t[past], noise[past], 2), t)
    left = [
        interval(0.0, 0.7, "cruise"),
        curve(t, noise - model, Line("spin noise less the fit", colors.COMPARISON)),
        level(0.0, label="timing model, fitted before departure"),
    ]
    c = mars.PRESETS["large"]
    std = np.sqrt(np.diagonal(mars.spin_noise(c), 0, 1, 2)).mean(1)
    place = np.arange(4)
    look = {"linestyle": "", "markersize": 7}
    right = [
        curve(place, c.sigma_km, color=colors.ESTIMATE, marker="o", label="photons, 1 m²", **look),
        curve(place, std, color=colors.COMPARISON, marker="s", label="spin noise", **look),
    ]
    years = {"xlim": (-fit, 0.7), "xticks": (-15, -10, -5, 0)}
    names = [name.replace("+", "\n+").replace("-", "\n-") for name in c.pulsars]
    more = {"xticks": place, "xticklabels": names, "xlim": (-0.5, 3.5)}
    return panels(
        [
            Panel("B1937+21", left, YEARS, "delay (km)", more=years),
            Panel("Noise of a delay", right, "pulsar (name)", "σ (km)", "y", more),
        ],
        height=2.8,
    )


def one_run(truth, tracks, direction):
    """Errors of one run toward a pulsar, with 3σ, of two filters."""
    row, weeks = [], np.arange(1, len(truth) + 1)
    for name, line in {"ignoring": IGNORING, "modes": MODES}.items():
        mean, cov = tracks[name]
        error = (mean[:, :3] - truth[:, :3]) @ direction
        sigma = 3.0 * np.sqrt(np.einsum("i,kij,j->k", direction, cov[:, :3, :3], direction))

        def shade(ax, sigma=sigma, line=line):
            band(ax, weeks, -sigma, sigma, color=line.color, label=f"3σ of {line.label}")

        title = f"{line.label}: error toward B1937+21"
        more = {"xlim": (1, len(truth))}
        x, y = "time since departure (weeks)", "error (km)"
        row.append(Panel(title, [shade, curve(weeks, error, line)], x, y, more=more))
    return panels(row, height=2.5, sharey=True)


def areas(rms, fractions):
    """RMS position error over the telescope's area, for several accelerations."""
    items = [
        curve(list(by_area), list(by_area.values()), color=SERIES[i], linestyle=STYLES[i], label=f)
        for i, (f, by_area) in enumerate(zip(fractions, rms, strict=True))
    ]
    items.append(level(20.0, label="paper", color=colors.PAPER))
    panel = Panel("", items, "area of the telescope (m²)", "position RMSE (km)", "xy")
    return panels(panel, height=2.6)


def some_runs(config, filter, runs=20, **changes):
    """RMS length of the position error from the fifth observation on, of some runs."""
    from celnav.study.montecarlo import generator
    from celnav.study.trial import evaluate_filter

    trial = mars.trial(replace(config, **changes), [generator(1, 0, run) for run in range(runs)])
    error = evaluate_filter(trial, filter).error[4:, :, :3]
    return float(np.sqrt(np.square(error).sum(-1).mean()))
