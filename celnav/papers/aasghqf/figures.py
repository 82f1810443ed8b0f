"""Figures 1 to 5 of the paper, and those of what lies beyond it. They draw what a `Result` holds and compute nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule
from celnav.gaussian.sparse_grid import smolyak
from celnav.papers.aasghqf.analysis import DIMENSIONS, MISALIGNMENTS_DEG
from celnav.papers.aasghqf.study import COMPARED, Result
from celnav.show import colors
from celnav.show.figures import band, figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = {"ukf": colors.COMPARISON, "sghqf": colors.ESTIMATE, "aasghqf": colors.OPEN_LOOP, "nonlinear": colors.TRUTH}
LABELS = {
    "ukf": "UKF, 27",
    "sghqf": "SGHQF, 417",
    "aasghqf": "AASGHQF, 75",
    "nonlinear": "by nonlinearity, 57",
    "level4": "level 4 by nonlinearity, 179",
    "delayed": "delayed, 339",
    "ckf": "CKF, 26",
    "ckf5": "CKF of degree 5, 339",
    "ghqf3": "GHQF, 3 points",
    "ghqf5": "GHQF, 5 points",
    "ekf": "EKF",
    "iekf": "iterated EKF",
    "triad-ekf": "EKF started by Wahba",
}
OTHERS = {"ckf": "#999999", "ckf5": "#56B4E9", "ghqf3": "#8C6BB1", "ghqf5": "#B15928", "ekf": "#D55E00", "triad-ekf": "#000000"}
PRESETS = ("A-slow", "T3")


def _points(rule: Rule, title: str) -> Figure:
    fig, ax = figure(3.6, 3.4)
    for sign, color, label in ((1.0, colors.COMPARISON, "positive weight"), (-1.0, colors.PAPER, "negative weight")):
        chosen = rule.wm * sign > 0.0
        size = 12.0 + 500.0 * np.sqrt(np.abs(rule.wm[chosen]))
        ax.scatter(*rule.nodes[chosen].T, s=0.25 * size, color=color, label=label, alpha=0.8)
    ax.set(xlabel="$x_1$ (-)", ylabel="$x_2$ (-)", title=title, xlim=(-4.2, 4.2), ylim=(-4.2, 4.2), aspect="equal")
    ax.legend(loc="upper right")
    return fig


def figure_1(result: Result) -> Figure:  # noqa: ARG001
    """Fig. 1: the 21 points of the isotropic rule, n = 2, level 3; area by the weight's magnitude."""
    return _points(smolyak(2, 3), "isotropic, level 3: 21 points")


def figure_2(result: Result) -> Figure:  # noqa: ARG001
    """Fig. 2: the 9 points of the anisotropic rule with weights 2, 1."""
    return _points(smolyak(2, 3, (2, 1)), "weights 2, 1, level 3: 9 points")


def _errors(result: Result, first: int, names: tuple[str, ...], unit: str) -> Figure:
    """Errors of one run of both presets: the first minute, and the whole flight."""
    fig, axes = figure(10.0, 1.9 * len(names), len(names), 4, squeeze=False, sharex="col")
    for column, (preset, zoom) in enumerate((p, z) for p in PRESETS for z in (True, False)):
        t, data = result.times(preset), result.data[preset]
        shown = t <= (60.0 if zoom else t[-1])
        for row, name in enumerate(names):
            ax, i = axes[row, column], first + row
            for filter in COMPARED:
                ax.plot(t[shown], data[f"{filter}/error"][shown, 0, i], color=COLORS[filter], label=LABELS[filter])
            sigma = 3.0 * data["sghqf/std"][shown, 0, i]
            ax.plot(t[shown], sigma, color=colors.SIGMA, linestyle=":", label="3σ of SGHQF")
            ax.plot(t[shown], -sigma, color=colors.SIGMA, linestyle=":")
            late = np.abs(data["sghqf/error"][len(t) // 10 :, 0, i]).max() + sigma[-1]
            if not zoom:
                ax.set_ylim(-3.0 * late, 3.0 * late)
            if column == 0:
                ax.set_ylabel(f"{name} ({unit})")
            if row == 0:
                ax.set_title(f"{preset}, {'first minute' if zoom else 'whole flight'}")
            if row == len(names) - 1:
                ax.set_xlabel("time (s)")
    fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return fig


def figure_3(result: Result) -> Figure:
    """Fig. 3: misalignment errors of one run, presets A-slow and T3."""
    return _errors(result, 0, ("φx error", "φy error", "φz error"), "deg")


def figure_4(result: Result) -> Figure:
    """Fig. 4: velocity errors of one run."""
    return _errors(result, 3, ("east velocity", "north velocity"), "m/s")


def figure_5(result: Result) -> Figure:
    """Fig. 5: position errors of one run."""
    return _errors(result, 5, ("longitude", "latitude"), "m")


def figure_6(result: Result) -> Figure:
    """Beyond the paper: RMSE of the misalignment over the runs, and of the closed solution that starts an EKF."""
    fig, axes = figure(9.0, 3.0, 1, 3, sharey=True)
    for ax, preset in zip(axes, ("A", "A-slow", "T3"), strict=True):
        t, data = result.times(preset), result.data[preset]
        for filter in (*COMPARED, "nonlinear", "triad-ekf"):
            rms = np.sqrt(np.square(data[f"{filter}/error"][..., :3]).sum(-1).mean(1))
            color = COLORS.get(filter, OTHERS.get(filter, "#000000"))
            style: Any = {"linestyle": "--", "linewidth": 2.0} if filter == "nonlinear" else {}
            ax.semilogy(t, rms, color=color, label=LABELS[filter], **style)
        if preset == "A":
            bound = np.sqrt(np.square(data["bound/std"][..., :3]).sum(-1).mean(1))
            ax.semilogy(t, bound, color=colors.BOUND, linewidth=2.5, zorder=0, label="Cramér–Rao bound")
            ax.set_ylabel("misalignment, RMSE over the runs (deg)")
            ax.legend()
        ax.set(title=preset, xlabel="time (s)")
    return fig


def figure_7(result: Result) -> Figure:
    """Beyond the paper: consistency over time."""
    fig, axes = figure(9.0, 3.0, 1, 3, sharey=True)
    low, high = chi_square_band(13, result.runs)
    for ax, preset in zip(axes, ("A", "A-slow", "T3"), strict=True):
        t, data = result.times(preset), result.data[preset]
        for filter in ("ukf", "sghqf", "aasghqf", "ckf", "ekf", "triad-ekf"):
            if f"{filter}/nees" in data:
                color = COLORS.get(filter, OTHERS.get(filter, "#000000"))
                ax.semilogy(t, data[f"{filter}/nees"].mean(1) / 13.0, color=color, label=LABELS[filter], linewidth=0.9)
        ax.axhspan(low / 13.0, high / 13.0, color=colors.SIGMA, alpha=0.5, label="95 % band")
        ax.set(title=preset, xlabel="time (s)")
    axes[0].set_ylabel("NEES / 13, mean over the runs (-)")
    axes[1].legend(loc="upper right")
    return fig


def figure_8(result: Result) -> Figure:
    """Beyond the paper: the first star fix over the size of the misalignment.

    From 45 degrees on a part of the draws lies beyond the chart of the Euler angles, where Wahba's solution takes another branch.
    """
    fig, axes = figure(9.0, 3.4, 1, 2)
    x = np.array(MISALIGNMENTS_DEG)
    for filter in ("ukf", "ckf", "ekf", "ghqf3", "ghqf5", "aasghqf", "sghqf", "nonlinear", "triad-ekf"):
        color = COLORS.get(filter, OTHERS.get(filter, "#000000"))
        style = "--" if filter == "nonlinear" else "-"
        nees = [result.data[f"start/{s:g}"][f"{filter}/nees"].mean() / 13.0 for s in x]
        axes[0].loglog(x, nees, color=color, marker=".", linestyle=style, label=LABELS[filter])
        if filter in result.facts["first_fixes"]:
            values = result.facts["first_fixes"][filter][:, 0]
            axes[1].loglog(x, np.where(values > 0.0, values, np.nan), color=color, marker=".", linestyle=style)
    axes[1].loglog(
        x, result.facts["first_fixes"]["exact"][:, 0], color="black", linewidth=2.5, zorder=0, alpha=0.4, label="exact moments"
    )
    axes[0].axhline(1.0, color=colors.SIGMA, linestyle=":")
    axes[0].set(xlabel="misalignment, 1σ of each angle (deg)", ylabel="NEES / 13 after the first star fix (-)")
    axes[1].set(
        xlabel="misalignment, 1σ of each angle (deg)",
        ylabel="least eigenvalue of the misalignment\ncovariance, posterior to prior (-)",
    )
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    axes[1].legend()
    return fig


def figure_9(result: Result) -> Figure:
    """Beyond the paper: how points and weights grow with the dimension."""
    fig, axes = figure(7.0, 3.0, 1, 2)
    for (name, values), color in zip(result.facts["growth"].items(), (colors.COMPARISON, colors.ESTIMATE), strict=True):
        n = DIMENSIONS[: len(values)]
        for ax, column in zip(axes, values.T, strict=True):
            ax.loglog(n, column, color=color, marker="o", label=name)
    axes[0].set(xlabel="dimension n (-)", ylabel="points (-)")
    axes[1].set(xlabel="dimension n (-)", ylabel="sum of |weights|: amplification of noise (-)")
    axes[0].legend()
    return fig


def figure_10(result: Result) -> Figure:
    """Beyond the paper: what the adaptive grid finds, and how much the kind of root matters."""
    fig, axes = figure(9.0, 3.2, 1, 2)
    found = sorted(result.facts["adapted"].contributions.items(), key=lambda item: -item[1])
    found = [(i, v) for i, v in found if sum(i) and v > 1e-9]
    names = ["+".join(f"{j + 1}" + ("" if level == 1 else f"·{level}") for j, level in enumerate(i) if level) for i, _ in found]
    axes[0].bar(range(len(found)), [v for _, v in found], color=colors.COMPARISON)
    axes[0].set_xticks(range(len(found)), names, rotation=60)
    axes[0].set(yscale="log", xlabel="index: channels (·level above 1)", ylabel="contribution to the moments (-)")
    width = 0.25
    for k, (kind, color) in enumerate(
        zip(("lower Cholesky", "symmetric", "upper Cholesky"), (colors.TRUTH, colors.ESTIMATE, colors.PAPER), strict=True)
    ):
        heights: list[float] = [result.facts["root_errors"][rule][kind] for rule in ("nonlinear", "sghqf")]
        axes[1].bar(np.arange(2) + (k - 1) * width, heights, width, color=color, label=kind)
    axes[1].set_xticks(range(2), [LABELS["nonlinear"], LABELS["sghqf"]])
    axes[1].set(yscale="log", ylabel="median relative error of E[h] (-)")
    axes[1].legend(title="root of P")
    return fig


def figure_11(result: Result) -> Figure:
    """Beyond the paper: the runs behind Table 3, quantiles of the misalignment error at T3."""
    fig, axes = figure(9.0, 3.0, 1, 3, sharey=True)
    t = result.times("T3")
    for ax, filter in zip(axes, COMPARED, strict=True):
        size: Array = np.linalg.norm(result.data["T3"][f"{filter}/error"][..., :3], axis=-1)
        low, middle, high = np.quantile(size, [0.05, 0.5, 0.95], axis=1)
        band(ax, t, low, high, color=COLORS[filter], label="5-95 % of the runs")
        ax.semilogy(t, middle, color=COLORS[filter], label="median")
        ax.set(title=LABELS[filter], xlabel="time (s)", ylim=(1e-3, 100.0))
        ax.legend()
    axes[0].set_ylabel("misalignment error, 3-D (deg)")
    return fig
