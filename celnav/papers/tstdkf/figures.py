"""Figures 1 to 10 of the paper, and those of what lies beyond it. They draw what a `Result` holds and compute nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.metrics import rms
from celnav.gaussian.linalg import Array
from celnav.models.pulsar import LIGHT_KM_S
from celnav.papers.tstdkf.config import DAY_S, SETTINGS, YEAR_S
from celnav.papers.tstdkf.ephemerides import table
from celnav.papers.tstdkf.evidence import AXES
from celnav.papers.tstdkf.study import COMPARED, Result
from celnav.papers.tstdkf.sweeps import COUPLINGS, LARGER, PARAMETERS, WHITE_LARGER, WHITE_NONE
from celnav.papers.tstdkf.year import TRENDS
from celnav.show import colors
from celnav.show.figures import figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = {
    "ekf": colors.OPEN_LOOP, "tkf": colors.COMPARISON, "tkf-fair": colors.MEASUREMENT, "tdkf": colors.FAINT,
    "tstdkf": colors.ESTIMATE, "aug": colors.REFERENCE, "B": colors.PAPER, "C": colors.ESTIMATE,
}  # fmt: skip
SHADES = (colors.COMPARISON, colors.ESTIMATE, colors.TRUTH)
"""Of axes and of pulsars."""
BESIDE: Any = {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0)}


def _smooth(values: Array, steps: int = 20) -> Array:
    """Root mean square over an orbit, of squares ``(K, runs)``."""
    mean = values.mean(1)
    sums = np.cumsum(np.concatenate([[0.0], mean]))
    width = min(steps, len(mean))
    return np.asarray(np.sqrt((sums[width:] - sums[:-width]) / width))


def _over_time(ax: Axes, result: Result, filter: str, what: str, setting: int, *, scale: float = 1.0, **style: Any) -> None:
    values = scale * _smooth(result.squares(filter, what, setting))
    t = result.times[len(result.times) - len(values) :] / DAY_S
    ax.semilogy(t, values, **({"color": COLORS[filter], "label": filter.upper()} | style))


def figure_1(result: Result) -> Figure:
    """Fig. 1: principle: what a timing measures, drawn from the vectors of the start (not to scale)."""
    g = result.facts["geometry"]
    fig, ax = figure(6.2, 4.2)
    across = g.earth - (g.earth @ g.direction) * g.direction
    plane = np.stack([g.direction, across / np.linalg.norm(across)])
    earth = plane @ g.earth / np.linalg.norm(g.earth)
    satellite = earth + 0.35 * (plane @ g.satellite) / np.linalg.norm(g.satellite)
    for start, end, label, color in (
        ((0.0, 0.0), earth, "Earth (ephemeris)", colors.COMPARISON),
        (earth, satellite, "orbit", colors.ESTIMATE),
    ):
        ax.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": color, "lw": 1.6})
        ax.annotate(label, 0.5 * (np.asarray(start) + np.asarray(end)), color=color, xytext=(6, -10), textcoords="offset points")
    ahead = np.array([0.45, 0.0])
    for foot in (np.zeros(2), satellite):
        ax.annotate("", foot + ahead, foot, arrowprops={"arrowstyle": "->", "color": colors.SIGMA})
    ax.plot([satellite[0]] * 2, [satellite[1], 0.0], color=colors.SIGMA, linestyle=":", linewidth=1.0)
    ax.plot([0.0, satellite[0]], [-0.06, -0.06], color=colors.PAPER, linewidth=2.0)
    parts = f"n·r {g.roemer / LIGHT_KM_S:.6f} s, parallax {1e6 * g.parallax / LIGHT_KM_S:.3f} µs"
    text = f"Δt = {g.delay / LIGHT_KM_S:.6f} s\n{parts}, Shapiro {1e6 * g.shapiro / LIGHT_KM_S:.2f} µs"
    ax.text(0.0, -0.11, text, color=colors.PAPER, va="top")
    for name, at in (("barycenter", np.zeros(2)), ("Earth", earth), ("satellite", satellite)):
        ax.plot(*at, "o", color="black", markersize=4)
        ax.annotate(name, at, xytext=(-4, 6), textcoords="offset points", ha="right")
    ax.annotate(f"to {result.config.pulsars[0]}", satellite + ahead, xytext=(-10, 6), textcoords="offset points")
    ax.set(
        xlim=(-0.45, satellite[0] + 0.7), ylim=(-0.45, max(earth[1], satellite[1]) + 0.2), title="Figure 1: the delay of a pulse"
    )
    ax.set_axis_off()
    return fig


def _differences(name: str, bodies: tuple[str, str | None], title: str, ax: Axes) -> None:
    less, t = table().less_de421[name], np.asarray(table().dates.rest)
    values = less[bodies[0]] if bodies[1] is None else less[bodies[0]] - less[bodies[1]]
    for axis, color, column in zip(AXES, SHADES, values.T, strict=True):
        ax.plot(t - t[0], column, color=color, label=axis)
    ax.plot(t - t[0], np.linalg.norm(values, axis=1), color="black", linewidth=0.8, linestyle="--", label="norm")
    ax.set(title=title)


def figure_2(_result: Result) -> Figure:
    """Fig. 2: position of the Earth, DE405 - DE421: not "tens of kilometers" but less than two."""
    fig, ax = figure(6.5, 3.2)
    _differences("de405", ("earth", None), "Figure 2: Earth, DE405 − DE421", ax)
    ax.set(xlabel="days since 2015-10-17 04:00 UTC", ylabel="difference (km)")
    ax.legend(ncols=4)
    return fig


def figure_2b(_result: Result) -> Figure:
    """Beyond the paper: other ephemerides, the Sun, and the Earth seen from the Sun."""
    fig, axes = figure(10.0, 5.2, 2, 2, sharex=True)
    _differences("de423", ("earth", None), "Earth, DE423 − DE421", axes[0, 0])
    _differences("de406", ("earth", None), "Earth, DE406 − DE421", axes[0, 1])
    _differences("de405", ("sun", None), "Sun, DE405 − DE421", axes[1, 0])
    _differences("de405", ("earth", "sun"), "Earth from the Sun, DE405 − DE421", axes[1, 1])
    for ax in axes[1]:
        ax.set(xlabel="days since 2015-10-17 04:00 UTC")
    for ax in axes[:, 0]:
        ax.set(ylabel="difference (km)")
    axes[1, 0].legend(loc="center right")
    return fig


def _ekf(result: Result, what: str, number: int, unit: str, scale: float) -> Figure:
    fig, ax = figure(8.0, 3.2)
    _over_time(ax, result, "ekf", what, 5, scale=scale, label="EKF, ephemeris error", color=colors.COMPARISON)
    for case, label, color in (
        (WHITE_LARGER, f"error {LARGER:.3g} times as large", colors.PAPER),
        (WHITE_NONE, "no ephemeris error", colors.TRUTH),
    ):
        values = scale * _smooth(result.data["parameters"][f"{case}/ekf/{what}"])
        ax.semilogy(result.times[len(result.times) - len(values) :] / DAY_S, values, color=color, label=label)
    if what == "position":
        _over_time(ax, result, "tkf", what, 5, label="TKF, ephemeris error", color=colors.ESTIMATE)
        size = np.linalg.norm(result.config.bias(result.times), axis=1)
        ax.semilogy(result.times / DAY_S, size, color=colors.SIGMA, linestyle=":", label="size of the ephemeris error")
    ax.set(
        xlabel="time (days)", ylabel=f"{what} RMSE ({unit})", title=f"Figure {number}: what an ephemeris error does (white noise)"
    )
    ax.legend(**BESIDE)
    return fig


def figure_3(result: Result) -> Figure:
    """Fig. 3: position RMSE of the EKF under an ephemeris error, over an orbit each."""
    return _ekf(result, "position", 3, "km", 1.0)


def figure_4(result: Result) -> Figure:
    """Fig. 4: velocity RMSE of the EKF under an ephemeris error."""
    return _ekf(result, "velocity", 4, "m/s", 1e3)


def figure_5(result: Result) -> Figure:
    """Fig. 5: the ephemeris error, and the two other trends of Fig. 10."""
    fig, axes = figure(9.0, 2.8, 1, 3, sharey=True)
    t, data = result.data["year"]["times"][:, 0], result.data["year"]["bias"]
    runs = data.shape[1] // len(TRENDS)
    for k, (ax, trend) in enumerate(zip(axes, TRENDS, strict=True)):
        for i, (axis, color) in enumerate(zip(AXES, SHADES, strict=True)):
            ax.plot(t[::3] / DAY_S, data[::3, k * runs, i], color=color, label=axis)
        ax.set(xlabel="time (days)", title=f"Eq. {(17, 69, 70)[k]}: {trend}")
    axes[0].set_ylabel("ephemeris error (km)")
    axes[0].legend()
    return fig


def figure_6(result: Result) -> Figure:
    """Fig. 6: what the ephemeris error makes of the timings."""
    fig, ax = figure(6.5, 3.0)
    values = result.facts["model error"].values
    t = result.config.step_s * np.arange(len(values)) / DAY_S
    for i, (name, color) in enumerate(zip(result.config.pulsars, SHADES, strict=True)):
        ax.plot(t, values[:, i], color=color, label=name)
    ax.set(xlabel="time (days)", ylabel="c B = Γ δr (km)", title="Figure 6: model error of the timings")
    ax.legend()
    return fig


def figure_7(result: Result) -> Figure:
    """Fig. 7: acceleration by Sun, Moon and planets, and of each body its largest."""
    fig, axes = figure(10.0, 3.2, 1, 2, width_ratios=(2, 1))
    pulls = result.facts["pulls"]
    total = np.asarray(sum(pulls.values()))
    t = result.config.step_s * np.arange(len(total)) / DAY_S
    for i, (axis, color) in enumerate(zip(AXES, SHADES, strict=True)):
        axes[0].plot(t, 1e9 * total[:, i], color=color, linewidth=0.4, alpha=0.7, label=axis)
    axes[0].set(xlabel="time (days)", ylabel="acceleration (10⁻⁹ km/s²)", title="Figure 7: third bodies")
    axes[0].legend(ncols=3, loc="upper right")
    largest = sorted((float(np.linalg.norm(a, axis=1).max()), body) for body, a in pulls.items())
    axes[1].barh([body for _, body in largest], [size for size, _ in largest], color=colors.MEASUREMENT)
    axes[1].set(xscale="log", xlabel="largest (km/s²)")
    return fig


def figure_8(result: Result) -> Figure:
    """Fig. 8: its spectrum: two groups of lines, not colored noise."""
    fig, ax = figure(6.5, 3.2)
    lines = result.facts["spectrum"]
    for i, (axis, color) in enumerate(zip(AXES, SHADES, strict=True)):
        ax.semilogy(lines.cycles[1:], lines.power[1:, i] / lines.power.max(), color=color, linewidth=0.7, label=axis)
    ax.set(xlabel="frequency (cycles/day)", ylabel="power (-)", xlim=(0.0, 60.0), title="Figure 8: spectrum of the acceleration")
    ax.legend()
    return fig


def figure_9(result: Result) -> Figure:
    """Fig. 9: setting 1 over the month: position, velocity and bias; with the exact filter and the fair TKF."""
    fig, axes = figure(10.0, 3.4, 1, 3)
    for ax, what, unit, scale in zip(axes, ("position", "velocity", "bias"), ("km", "m/s", "km"), (1.0, 1e3, 1.0), strict=True):
        for filter in ("ekf", "tkf", "tkf-fair", "tdkf", "tstdkf", "aug"):
            if what != "bias" or filter != "ekf":
                style = {"linestyle": "--"} if filter in ("tdkf", "tkf-fair") else {}
                _over_time(ax, result, filter, what, 1, scale=scale, **style)
        ax.set(xlabel="time (days)", ylabel=f"{what} RMSE ({unit})")
    bound = result.facts["bounds"][1]
    for ax, column, scale in ((axes[0], 0, 1.0), (axes[1], 1, 1e3), (axes[2], 2, 1.0)):
        ax.semilogy(result.times / DAY_S, scale * bound[:, column], color=colors.BOUND, linewidth=3.0, zorder=0, label="bound")
    axes[0].legend(ncols=2)
    axes[1].set_title("Figure 9: setting 1")
    return fig


def figure_9b(result: Result) -> Figure:
    """Beyond the paper: the estimates of the first run's bias with their three deviations."""
    fig, axes = figure(10.0, 3.0, 1, 3)
    data, t = result.data["table 5"], result.times / DAY_S
    for i, (ax, axis) in enumerate(zip(axes, AXES, strict=True)):
        for filter in ("tkf", "tstdkf", "aug"):
            ax.plot(t, data[f"1/{filter}/first/mean"][:, 0, 6 + i], color=COLORS[filter], label=filter.upper())
        mean, std = data["1/aug/first/mean"][:, 0, 6 + i], np.sqrt(data["1/aug/first/cov"][:, 0, 6 + i, 6 + i])
        ax.fill_between(t, mean - 3.0 * std, mean + 3.0 * std, color=COLORS["aug"], alpha=0.15, label="±3σ AUG")
        ax.plot(t, data["1/truth"][:, 0, 6 + i], color="black", label="truth")
        ax.set(xlabel="time (days)", title=axis, ylim=(-0.35, 0.35))
    axes[0].set_ylabel("ephemeris error (km)")
    axes[0].legend()
    return fig


def figure_10(result: Result) -> Figure:
    """Fig. 10: a year of three trends: the bias of one axis as TKF, TSTDKF (forms B and C) and AUG see it."""
    fig, axes = figure(10.0, 6.4, 3, 3, sharex=True)
    data = result.data["year"]
    t, runs = data["times"][:, 0] / DAY_S, data["bias"].shape[1] // len(TRENDS)
    shown = slice(None, None, 24)  # once a day
    for k, trend in enumerate(TRENDS):
        for i, axis in enumerate(AXES):
            ax, run = axes[k, i], k * runs
            for filter, label in (("tkf", "TKF"), ("C", "TSTDKF, form C"), ("B", "TSTDKF, form B"), ("aug", "AUG")):
                ax.plot(t[shown], data[f"{filter}/bias"][shown, run, i], color=COLORS[filter], linewidth=0.9, label=label)
            ax.plot(t[shown], data["bias"][shown, run, i], color="black", label="truth")
            ax.set(ylim=(-0.3, 0.3), title=f"{trend}, {axis}")
        axes[k, 0].set_ylabel("ephemeris error (km)")
    for ax in axes[-1]:
        ax.set(xlabel="time (days)", xlim=(0.0, min(t[-1], YEAR_S / DAY_S)))
    fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return fig


def figure_11(result: Result) -> Figure:
    """Beyond the paper: Table 5 as bars: position RMSE of the month in the five settings."""
    fig, ax = figure(9.5, 3.2)
    x = np.arange(len(SETTINGS))
    for k, filter in enumerate(COMPARED):
        heights = [rms(result.squares(filter, "position", i)) for i in SETTINGS]
        ax.bar(x + 0.16 * (k - 2), heights, 0.15, color=COLORS[filter], label=filter.upper())
    ax.bar(-0.49, rms(result.squares("tkf-fair", "position")), 0.15, color=COLORS["tkf-fair"], label="TKF, stationary covariances")
    ax.set_xticks(x, [f"{i}: F {s.F:g}, L {s.L:g}, κ {s.kappa:g}" for i, s in SETTINGS.items()])
    ax.set(ylabel="position RMSE (km)", title="Table 5")
    ax.legend(**BESIDE)
    return fig


def figure_12(result: Result) -> Figure:
    """Beyond the paper: consistency: NEES of errors and biases drawn from their priors."""
    fig, axes = figure(9.0, 3.0, 1, 2, sharey=True)
    data = result.data["consistency"]
    for case, (ax, title) in enumerate(zip(axes, ("setting 1", "white noise"), strict=True)):
        for filter, dof in (("ekf", 6), ("tkf", 6), ("tdkf", 6), ("aug", 9)):
            values = data[f"{case}/{filter}/nees"].mean(1) / dof
            t = result.config.step_s * np.arange(1, len(values) + 1) / DAY_S
            ax.semilogy(t, values, color=COLORS[filter], label=filter.upper())
        ax.axhline(1.0, color="black", linestyle=":", label="consistent")
        ax.set(xlabel="time (days)", title=title)
    axes[0].set_ylabel("NEES to its dimension (-)")
    axes[1].legend(**BESIDE)
    return fig


def figure_13(result: Result) -> Figure:
    """Beyond the paper: what the result depends on (setting 1, one thing changed), and a coupling that is taken for another."""
    fig, axes = figure(11.0, 4.2, 1, 2, width_ratios=(1, 1))
    labels = list(PARAMETERS)
    y = np.arange(len(labels))[::-1]
    for k, filter in enumerate(("tkf", "tstdkf")):
        widths = [rms(result.data["parameters"][f"{i}/{filter}/position"]) for i in range(len(labels))]
        axes[0].barh(y + 0.2 - 0.4 * k, widths, 0.38, color=COLORS[filter], label=filter.upper())
    axes[0].set_yticks(y, labels)
    axes[0].set(xlabel="position RMSE (km)")
    axes[0].legend()
    x = np.arange(len(COUPLINGS))
    for k, filter in enumerate(("tkf", "tstdkf", "aug")):
        values = [result.data["couplings"][f"{i}/{filter}/position"] for i in range(len(COUPLINGS))]
        axes[1].bar(x + 0.26 * (k - 1), [rms(v[len(v) // 2 :]) for v in values], 0.25, color=COLORS[filter], label=filter.upper())
    axes[1].set_xticks(x, [f"{true:g} → {taken:g}" for true, taken in COUPLINGS])
    axes[1].set(xlabel="κ, and what filters take it for", ylabel="position RMSE (km)")
    axes[1].legend()
    return fig


def figure_14(result: Result) -> Figure:
    """Beyond the paper: Sun and Moon pull: left to white noise, to colored noise, or modeled."""
    fig, ax = figure(6.5, 3.2)
    rows = (
        ("white/tkf", "TKF, left to white noise", colors.COMPARISON),
        ("colored/tdkf", "TDKF, AR(1) noise that matches", colors.FAINT),
        ("colored/aug", "AUG, AR(1) noise that matches", colors.REFERENCE),
        ("modeled/tkf", "TKF, modeled", colors.ESTIMATE),
    )
    for key, label, color in rows:
        values = _smooth(result.data["forces"][f"{key}/position"])
        length = len(result.data["forces"][f"{key}/position"])
        t = result.config.step_s * np.arange(1 + length - len(values), length + 1) / DAY_S
        ax.semilogy(t, values, color=color, label=label)
    ax.set(xlabel="time (days)", ylabel="position RMSE (km)", title="Third bodies follow from the ephemeris that the filter has")
    ax.legend()
    return fig
