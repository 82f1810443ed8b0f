"""Figures 1 to 3 of the paper, and those of what lies beyond it. They draw what a `Result` holds and compute nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.linalg import Array
from celnav.papers.ssukf import vector
from celnav.papers.ssukf.checks import ALPHAS, PRIORS_DEG, TURNS_DEG
from celnav.papers.ssukf.config import ARCSEC
from celnav.papers.ssukf.draws import CORRELATIONS
from celnav.papers.ssukf.study import DRAWN, Result
from celnav.papers.ssukf.vector import FILTERS
from celnav.show import colors
from celnav.show.figures import figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = {
    "aukf": colors.COMPARISON,
    "ssukf": colors.ESTIMATE,
    "mekf": colors.OPEN_LOOP,
    "usque": colors.TRUTH,
    "additive": colors.SIGMA,
}
LABELS = {"aukf": "AUKF", "ssukf": "SSUKF", "mekf": "MEKF", "usque": "USQUE", "additive": "additive UKF"}
STYLES: dict[str, Any] = {"ssukf": {"linestyle": "--", "linewidth": 1.8}, "aukf": {"linewidth": 1.2}}


def _angle(result: Result, axis: int, name: str) -> Figure:
    """An Euler angle's error: size over the run, the first run at its beginning, and over wall-clock time."""
    fig, axes = figure(10.0, 3.1, 1, 3)
    t, data = result.times, result.data["paper"]
    for filter in ("aukf", "ssukf"):
        error = data[f"{filter}/euler"][..., axis]
        rms = np.sqrt(np.square(error).mean(1))
        per = result.timings[f"{filter}, {result.config.ratio}:1, 1 run, s"]
        style = {"color": COLORS[filter], "label": LABELS[filter], **STYLES[filter]}
        axes[0].semilogy(t, rms, **style)
        axes[1].semilogy(t, np.abs(error[:, 0]), **style)
        axes[2].semilogy(per * np.arange(len(t)), rms, **style)
    axes[0].semilogy(t[1:], result.facts["exact"][1:, 0], color=colors.BOUND, linewidth=3.0, zorder=0, label="exact deviation")
    for level in (10.0, 5.0, 2.0):
        axes[0].axhline(level, color=colors.SIGMA, linewidth=0.6, linestyle=":")
    axes[0].set(xlabel="time (s)", ylabel=f"{name} error (arcsec)", title=f"RMSE of {result.runs} runs")
    axes[1].set(xlabel="time (s)", xlim=(-0.2, 10.0), title="one run, the first 10 s")
    axes[2].set(xlabel="CPU time of one run alone at 100 Hz (s)", title="RMSE over the time it takes to compute")
    for ax in axes[:2]:
        ax.legend()
    return fig


def figure_1(result: Result) -> Figure:
    """Fig. 1: error of roll. AUKF and SSUKF lie on each other."""
    return _angle(result, 0, "roll")


def figure_2(result: Result) -> Figure:
    """Fig. 2: error of pitch."""
    return _angle(result, 1, "pitch")


def figure_3(result: Result) -> Figure:
    """Fig. 3: error of yaw. "SUKF converges faster" could only be true over wall-clock time, at the right."""
    return _angle(result, 2, "yaw")


def figure_4(result: Result) -> Figure:
    """Beyond the paper: what the model allows, and what is reached: attitude and drift."""
    fig, axes = figure(9.0, 3.2, 1, 2)
    t, data, exact = result.times, result.data["paper"], result.facts["exact"]
    for ax, part, i, unit in ((axes[0], slice(0, 3), 0, "attitude (arcsec)"), (axes[1], slice(3, 6), 1, "drift (deg/h)")):
        ax.loglog(t[1:], exact[1:, i], color=colors.BOUND, linewidth=4.0, label="exact deviation")
        for filter in ("aukf", "ssukf", "mekf"):
            rms = np.sqrt(np.square(data[f"{filter}/error"][1:, :, part]).mean((1, 2)))
            ax.loglog(t[1:], rms, color=COLORS[filter], label=f"RMSE {LABELS[filter]}", **STYLES.get(filter, {}))
        ax.set(xlabel="time (s)", ylabel=unit)
    axes[0].axhline(result.facts["readings"][0][1][1, 0] / ARCSEC, color=colors.SIGMA, linestyle=":", label="limit (Riccati)")
    axes[0].legend()
    return fig


def figure_5(result: Result) -> Figure:
    """Beyond the paper: consistency, initial errors drawn from the prior."""
    fig, axes = figure(9.0, 3.0, 1, 2)
    t = result.times
    for ax, kind, dof in ((axes[0], "nees", 6), (axes[1], "nis", 3)):
        for filter in DRAWN:
            mean = result.data["drawn"][f"{filter}/{kind}"][1:].mean(1)
            ax.plot(
                t[1 : len(mean) + 1], mean, color=COLORS[filter], label=LABELS[filter], **STYLES.get(filter, {"linewidth": 0.6})
            )
        low, high = chi_square_band(dof, result.runs)
        ax.axhspan(low, high, color=colors.SIGMA, alpha=0.3, label="95 % band")
        ax.set(xlabel="time (s)", ylabel=f"{kind.upper()}, mean of {result.runs} runs (-)")
    axes[0].legend(loc="lower right")
    return fig


def figure_6(result: Result) -> Figure:
    """Beyond the paper: one measured vector separates the filters; RMS of the total attitude error."""
    fig, axes = figure(10.0, 3.4, 1, 3)
    for ax, degrees in zip(axes, vector.PRIORS_DEG, strict=True):
        for filter in FILTERS:
            base, _, rest = filter.partition(", ")
            rms = np.sqrt(np.square(result.data["vector"][f"{filter}/{degrees:g}/error"]).mean(1))
            style = ":" if rest else "-"
            ax.loglog(1.0 + np.arange(len(rms)), rms, color=COLORS[base], linestyle=style, label=f"{LABELS[base]} {rest}".strip())
        ax.set(xlabel="time (s), from 1", title=f"prior {degrees:g} deg on each axis")
    axes[0].set_ylabel("total attitude error, RMS (deg)")
    axes[0].legend()
    return fig


def figure_7(result: Result) -> Figure:
    """Beyond the paper: how far apart filters are that are the same: the difference of SSUKF and MEKF from AUKF."""
    fig, axes = figure(9.0, 3.0, 1, 2, sharey=True)
    t, data = result.times[1:], result.data["paper"]
    for ax, filter in zip(axes, ("ssukf", "mekf"), strict=True):
        apart = np.abs(data[f"{filter}/error"] - data["aukf/error"])[1:, :, :3].max(2)
        ax.semilogy(t, apart.max(1), color=COLORS[filter], label="largest of the runs")
        ax.semilogy(t, np.median(apart, 1), color=COLORS[filter], linewidth=0.7, alpha=0.6, label="median")
        ax.set(xlabel="time (s)", title=f"{LABELS[filter]} and AUKF")
        ax.legend()
    axes[0].set_ylabel("difference of attitudes (arcsec)")
    return fig


def figure_8(result: Result) -> Figure:
    """Beyond the paper: cost from one star sample to the next, in points and in time."""
    fig, axes = figure(9.0, 3.0, 1, 3)
    names = ("aukf", "ssukf", "additive")
    for k, per in enumerate((1, result.config.ratio)):
        counted = result.facts["evaluations"][per]
        heights = [sum(counted[name]) / sum(counted["aukf"]) for name in names]
        axes[0].bar(
            np.arange(3) + 0.38 * k - 0.19, heights, 0.36, color=(colors.COMPARISON, colors.MEASUREMENT)[k], label=f"{per}:1"
        )
    axes[0].axhline(2.0 / 3.0, color=colors.PAPER, linestyle="--", label='"about 1/3 less"')
    axes[0].set(ylabel="points, to AUKF (-)", title="points", ylim=(0.0, 1.5))
    axes[0].legend(loc="upper right")
    timed = (*names, "mekf")
    for ax, key, title in ((axes[1], "1:1, 1 run", "arrays, one run"), (axes[2], "1:1, 500 runs", "arrays, 500 runs")):
        heights = [result.timings[f"{name}, {key}, s"] / result.timings[f"aukf, {key}, s"] for name in timed]
        ax.bar(range(4), heights, color=[COLORS[name] for name in timed])
        ax.axhline(2.0 / 3.0, color=colors.PAPER, linestyle="--")
        ax.set(title=f"CPU time, {title}", ylabel="to AUKF (-)")
    for ax, shown in zip(axes, (names, timed, timed), strict=True):
        ax.set_xticks(range(len(shown)), [LABELS[name] for name in shown], fontsize=7)
    return fig


def figure_9(result: Result) -> Figure:
    """Beyond the paper: what does not matter: the prior, the initial error, and alpha; and from where on it does."""
    fig, axes = figure(10.0, 3.2, 1, 3)
    shown = sorted(PRIORS_DEG)
    for seconds, color in ((0.25, colors.COMPARISON), (10.0, colors.ESTIMATE), (60.0, colors.TRUTH)):
        k = result.at(seconds)
        values = [np.sqrt(np.square(result.data["priors"][f"{s:g}"][k, :, :3]).mean()) for s in shown]
        axes[0].loglog(shown, values, color=color, marker="o", label=f"after {seconds:g} s")
    axes[0].set(xlabel="prior, each axis (deg); the error is 1, 2, 10 deg", ylabel="attitude, RMSE (arcsec)")
    axes[0].legend()
    for filter, marker in (("aukf", "o"), ("ssukf", "x"), ("usque", "+"), ("mekf", ".")):
        values = [np.sqrt(np.square(result.data["turns"][f"{filter}/{d:g}"][1]).mean()) for d in TURNS_DEG]
        axes[1].plot(TURNS_DEG, values, color=COLORS[filter], marker=marker, label=LABELS[filter])
    axes[1].set(xlabel="initial error (deg)", ylabel="after the first star sample (arcsec)", ylim=(0.0, 40.0))
    axes[1].legend()
    others = [a for a in ALPHAS if a != result.config.alpha]
    axes[2].loglog(others, [result.data["alphas"][f"{a:g}"][0].max() for a in others], color=colors.ESTIMATE, marker="o")
    axes[2].set(xlabel="alpha (-)", ylabel=f"largest change from alpha = {result.config.alpha:g} (arcsec)")
    return fig


def figure_10(result: Result) -> Figure:
    """Beyond the paper: what drawing anew loses: noise common to dynamics and sensor."""
    fig, ax = figure(5.0, 3.2)
    x = np.arange(len(CORRELATIONS))
    found = [result.facts["correlated"][rho] for rho in CORRELATIONS]
    rows: tuple[tuple[str, list[float], str], ...] = (
        ("exact Kalman filter", [f.exact for f in found], colors.BOUND),
        ("AUKF drawn once", [f.once for f in found], colors.TRUTH),
        ("SSUKF", [f.switching for f in found], colors.ESTIMATE),
        ("AUKF drawn anew", [f.redrawn for f in found], colors.COMPARISON),
    )
    for k, (label, heights, color) in enumerate(rows):
        ax.bar(x + 0.2 * k - 0.3, heights, 0.18, color=color, label=label)
    ax.set_xticks(x, [f"{rho:g}" for rho in CORRELATIONS])
    ax.set(xlabel="correlation of the noises (-)", ylabel="RMSE (-)")
    ax.legend()
    return fig


def figure_11(result: Result) -> Figure:
    """Beyond the paper: the total attitude as the state, in a spin past 360 deg, with and without the switch."""
    fig, ax = figure(6.0, 3.0)
    spin = result.facts["spin"]
    styles: dict[str, tuple[str, Any]] = {
        "unswitched": ("total MRP, never switched", {"color": colors.PAPER}),
        "switched": ("total MRP, switched to its shadow set", {"color": colors.COMPARISON, "linewidth": 3.0, "alpha": 0.5}),
        "local": ("local form", {"color": "black", "linewidth": 0.8}),
    }
    for name, (label, style) in styles.items():
        ax.semilogy(spin.times, _positive(spin.errors[name]), label=label, **style)
    ax.set(xlabel=f"time (s); 360 deg at {spin.crossing:g} s", ylabel="largest error of the runs (arcsec)")
    ax.legend()
    return fig


def _positive(values: Array) -> Array:
    return np.where(values > 0.0, values, np.nan)
