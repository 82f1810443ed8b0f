"""Figures 1 to 9 of the paper, and those of what lies beyond it, drawn from what a `Result` holds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.metrics import rms
from celnav.gaussian.linalg import Array
from celnav.papers.aukf.analysis import INCLINATIONS_DEG, NORMAL_ERROR
from celnav.papers.aukf.evidence import AXES, COMPARED, LABELS, real_rms, size
from celnav.papers.aukf.study import Result
from celnav.papers.aukf.sweeps import FROM_A_FIX, INITIAL_KM, MISTUNED_M, PROCESS_NOISE, SMALL_ALPHA, WINDOWS
from celnav.papers.aukf.tables import CASES, medians
from celnav.show import colors
from celnav.show.figures import band, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = {
    "ls": colors.MEASUREMENT, "ekf": colors.SIGMA, "ukf": colors.COMPARISON, "aukf": colors.ESTIMATE, "group": colors.REFERENCE,
    "channel": colors.OPEN_LOOP, "gate": colors.FAINT, "huber": colors.PAPER, "student": "#8C564B", "sage-husa": "#332288",
}  # fmt: skip
UNDER_START = {
    "ekf": colors.SIGMA,
    "ukf": colors.COMPARISON,
    SMALL_ALPHA: colors.OPEN_LOOP,
    "aukf": colors.ESTIMATE,
    FROM_A_FIX: colors.TRUTH,
}
BLOCKS = (
    "antenna",
    "radio\nfrequency",
    "intermediate\nfrequency",
    "carrier and code\nwipe-off",
    "navigation\nmessage",
    "positioning",
)


def figure_1(_result: Result) -> Figure:
    """Fig. 1: the receiver: from the antenna to a position."""
    from matplotlib.patches import FancyBboxPatch

    fig, ax = figure(9.0, 2.0)
    for i, text in enumerate(BLOCKS):
        ax.add_patch(FancyBboxPatch((i, 0.0), 0.72, 0.5, boxstyle="round,pad=0.03", facecolor="none", edgecolor=colors.COMPARISON))
        ax.text(i + 0.36, 0.25, text, ha="center", va="center", fontsize=7)
        if i:
            ax.annotate("", (i - 0.04, 0.25), (i - 0.24, 0.25), arrowprops={"arrowstyle": "->", "color": colors.SIGMA})
    ax.annotate("", (3.36, -0.04), (5.36, -0.04),
                arrowprops={"arrowstyle": "->", "color": colors.SIGMA, "connectionstyle": "bar,fraction=-0.08"})  # fmt: skip
    ax.text(4.36, -0.3, "expected delay and Doppler", ha="center", va="center", color=colors.FAINT)
    ax.text(2.5, 0.72, "baseband: the third and fourth block run once for each satellite", ha="center", color=colors.FAINT)
    ax.set(xlim=(-0.1, 5.85), ylim=(-0.45, 0.85), title="Figure 1: a receiver")
    ax.set_axis_off()
    return fig


def figure_2(result: Result) -> Figure:
    """Fig. 2: an orbit's plane against the equator: the flatter it lies, the less is its node known."""
    from matplotlib.patches import Circle

    fig, axes = figure(9.0, 3.0, 1, 3)
    for ax, i, title in ((axes[0], 55.0, "(a) large inclination"), (axes[1], 5.0, "(b) small inclination")):
        angle = np.linspace(0.0, 2.0 * np.pi, 181)
        for tilt, color, label in ((0.0, colors.SIGMA, "equator"), (np.radians(i), colors.COMPARISON, f"orbit, i = {i:g}°")):
            ax.plot(
                np.cos(angle), np.sin(angle) * (0.35 * np.cos(tilt)) + 0.9 * np.sin(angle) * np.sin(tilt), color=color, label=label
            )
        ax.plot([-1.0, 1.0], [0.0, 0.0], "o", color=colors.PAPER, markersize=4, label="nodes")
        ax.add_patch(Circle((0.0, 0.0), 0.16, color=colors.MEASUREMENT, alpha=0.6))
        ax.set(title=title, xlim=(-1.15, 1.15), ylim=(-1.1, 1.1), aspect="equal")
        ax.legend(loc="lower right")
        ax.set_axis_off()
    nodes = result.facts["nodes"]
    dense = np.geomspace(min(INCLINATIONS_DEG), max(INCLINATIONS_DEG), 60)
    axes[2].loglog(dense, np.degrees(NORMAL_ERROR / np.sin(np.radians(dense))), color=colors.COMPARISON, label="δn / sin i")
    axes[2].loglog(INCLINATIONS_DEG, nodes.drawn, "o", color=colors.PAPER, label="drawn")
    axes[2].set(xlabel="inclination (deg)", ylabel="deviation of the node (deg)", title=f"δn = {NORMAL_ERROR:g} rad")
    axes[2].legend()
    return fig


def figure_3(result: Result) -> Figure:
    """Fig. 3: the unscented transform, from polar to Cartesian coordinates."""
    m = result.facts["polar"]
    fig, axes = figure(9.0, 3.0, 1, 2)
    axes[0].plot(m.drawn[:, 0], m.drawn[:, 1], ".", markersize=1.0, color=colors.SIGMA, alpha=0.6)
    axes[0].plot(m.images[:, 0], m.images[:, 1], "o", markersize=4, color=colors.PAPER, label="images of the points (gray: draws)")
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    rows = (
        (m.linear_mean, m.linear_std, colors.OPEN_LOOP, "linearized"),
        (m.exact_mean, m.drawn_std, colors.TRUTH, "exact mean, deviation of draws"),
        (m.unscented_mean, m.unscented_std, colors.COMPARISON, "unscented"),
    )
    for mean, std, color, label in rows:
        style = "--" if label == "unscented" else "-"
        for ax in axes:
            ax.plot(mean[0], mean[1], "x", color=color)
            ax.plot(*(mean + std * circle).T, color=color, linestyle=style, label=f"{label}: mean y = {mean[1]:.4f}")
            ax.set(xlabel="x (-)")
    axes[0].set(ylabel="y (-)", title="Figure 3: r = 1 ± 0.02, θ = 90° ± 15°")
    axes[1].set(title="means and deviations", ylim=(0.9, 1.04), xlim=(-0.3, 0.3))
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return fig


def _shade(ax: Axes, result: Result) -> None:
    ax.axvspan(*result.config.burst_s, color=colors.BOUND, alpha=0.25, linewidth=0.0)


def _errors(ax: Axes, result: Result, study: str, case: str, axis: int, shown: tuple[str, ...] = ("ekf", "ukf", "aukf")) -> None:
    """The first run, and the quantiles of all."""
    t, data = result.times(), result.data[study]
    for filter in shown:
        values = data[f"{case}/{filter}/error"][..., axis]
        style: Any = {"ekf": {"linewidth": 2.4, "alpha": 0.7}, "ukf": {"linewidth": 0.9}}.get(filter, {})
        ax.plot(t, values[:, 0], color=COLORS[filter], label=LABELS[filter], **style)
    low, high = np.nanquantile(data[f"{case}/aukf/error"][..., axis], [0.05, 0.95], axis=1)
    band(ax, t, low, high, color=COLORS["aukf"], label="AUKF, 5-95 % of the runs")


def _quiet(result: Result, axis: int) -> Figure:
    fig, axes = figure(10.0, 2.9, 1, 2)
    for ax, study, case, limit in ((axes[0], "main", "none", 2.0), (axes[1], "baselines", "mistuned", 4.0)):
        _errors(ax, result, study, case, axis)
        own = "main" if case == "none" else "disturbed"
        values = {f: rms(result.squares(own, f"{case}/{f}", "all", axis=axis)) for f in ("ukf", "aukf")}
        ratio = values["aukf"] / values["ukf"]
        title = f"Figure {axis + 4}" if case == "none" else f"{MISTUNED_M:g} m of noise, {result.config.sigma_range_m:g} m assumed"
        ax.set(title=f"{title}: RMSE of AUKF {ratio:.2f} of UKF", xlabel="time (s)", ylim=(-limit, limit))
    axes[0].set(ylabel=f"error of {AXES[axis]} (m)")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return fig


def _burst(result: Result, axis: int, case: str, number: str, limits: tuple[float, float]) -> Figure:
    study = "main" if case == "ranges" else "baselines"
    fig, axes = figure(9.5, 2.9, 1, 2, width_ratios=(3, 2))
    start, end = result.config.burst_s
    for ax, limit in zip(axes, limits, strict=True):
        _shade(ax, result)
        _errors(ax, result, study, case, axis)
        ax.set(xlabel="time (s)", ylim=(-limit, limit))
    if case == "both":
        gate = result.data[study][f"{case}/gate/error"][:, 0, axis]
        axes[0].plot(result.times(), gate, color=COLORS["gate"], linestyle=":", label="gate")
    axes[1].set(xlim=(start - 2.0, min(end + 8.0, result.times()[-1])), title="the burst")
    own = "main" if case == "ranges" else "disturbed"
    ratio = rms(result.squares(own, f"{case}/aukf", "burst", axis=axis)) / rms(
        result.squares(own, f"{case}/ukf", "burst", axis=axis)
    )
    channels = "ranges" if case == "ranges" else "ranges and rates"
    axes[0].set(ylabel=f"error of {AXES[axis]} (m)", title=f"Figure {number}: burst on {channels}: RMSE of AUKF {ratio:.2f} of UKF")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return fig


def figure_4(result: Result) -> Figure:
    """Fig. 4: error of X, without a burst; and where the noise is larger than the filters think."""
    return _quiet(result, 0)


def figure_5(result: Result) -> Figure:
    """Fig. 5: error of Y, the same."""
    return _quiet(result, 1)


def figure_6(result: Result) -> Figure:
    """Fig. 6: error of Z, the same."""
    return _quiet(result, 2)


def figure_7(result: Result) -> Figure:
    """Fig. 7: error of X with the burst on all ranges."""
    return _burst(result, 0, "ranges", "7", (20.0, 3.0))


def figure_7b(result: Result) -> Figure:
    """Fig. 7, beyond the paper: the burst is on the rates as well."""
    return _burst(result, 0, "both", "7b", (150.0, 60.0))


def figure_8(result: Result) -> Figure:
    """Fig. 8: error of Y with the burst on all ranges."""
    return _burst(result, 1, "ranges", "8", (20.0, 3.0))


def figure_8b(result: Result) -> Figure:
    """Fig. 8, beyond the paper: the burst is on the rates as well."""
    return _burst(result, 1, "both", "8b", (150.0, 60.0))


def figure_9(result: Result) -> Figure:
    """Fig. 9: error of Z with the burst on all ranges."""
    return _burst(result, 2, "ranges", "9", (20.0, 3.0))


def figure_9b(result: Result) -> Figure:
    """Fig. 9, beyond the paper: the burst is on the rates as well."""
    return _burst(result, 2, "both", "9b", (150.0, 60.0))


def figure_10(result: Result) -> Figure:
    """Beyond the paper: what the filter multiplies the noise by."""
    fig, axes = figure(9.0, 2.8, 1, 2, sharey=True)
    t, factor = result.times(), result.data["main"]["ranges/aukf/factor"]
    S = factor.shape[-1] // 2
    for ax, part, title in ((axes[0], factor[..., :S], "ranges"), (axes[1], factor[..., S:], "rates")):
        _shade(ax, result)
        low, middle, high = np.quantile(part.reshape(len(t), -1), [0.05, 0.5, 0.95], axis=1)
        band(ax, t, low, high, color=colors.ESTIMATE, label="5-95 % of runs and satellites")
        ax.semilogy(t, middle, color=colors.ESTIMATE, label="median")
        ax.semilogy(t, part.mean((1, 2)), color=colors.COMPARISON, linestyle="--", label="mean")
        ax.set(title=f"A of the {title}", xlabel="time (s)")
    expected = 1.0 + (result.config.burst_sigma / result.config.sigma_range_m) ** 2
    axes[0].axhline(expected, color=colors.PAPER, linestyle=":", label=f"right in the burst: {expected:.0f}")
    axes[0].set(ylabel="factor (-)")
    axes[0].legend(loc="upper left")
    return fig


def figure_11(result: Result) -> Figure:
    """Beyond the paper: stronger baselines, by where the disturbance is."""
    fig, axes = figure(10.0, 3.2, 1, 4)
    windows = {"ranges": "burst", "both": "burst", "one": "burst", "mistuned": "all"}
    for ax, (case, text) in zip(axes, CASES.items(), strict=True):
        values = [rms(result.squares("baselines", f"{case}/{filter}", windows[case])) for filter in COMPARED]
        ax.barh(range(len(COMPARED)), values, color=[COLORS[f] for f in COMPARED], log=True)
        ax.set(title=text, xlabel="position RMSE (m)")
        ax.set_yticks(range(len(COMPARED)), [LABELS[f] for f in COMPARED] if case == "ranges" else [])
        ax.invert_yaxis()
        ax.set_xlim(0.3 * min(values), 4.0 * max(values))
        for i, value in enumerate(values):
            ax.text(value * 1.1, i, f"{value:.3g}", va="center", fontsize=6.5)
    return fig


def figure_12(result: Result) -> Figure:
    """Beyond the paper: where the filter breaks: little process noise, and the turn is taken for noise of the rates."""
    fig, axes = figure(9.0, 3.0, 1, 2, sharey=True)
    for ax, interval in zip(axes, (0.1, 1.0), strict=True):
        densities = PROCESS_NOISE[interval]
        for filter in ("ekf", "aukf", "group"):
            keys = [f"{interval:g}/{density:g}/{filter}" for density in densities]
            values = [rms(result.squares("process noise", key, "quiet", interval_s=interval)) for key in keys]
            style: Any = {"linestyle": "--"} if filter == "group" else {}
            label = "EKF, UKF" if filter == "ekf" else LABELS[filter]
            ax.loglog(densities, values, marker="o", markersize=3, color=COLORS[filter], label=label, **style)
        c = result.config
        rule = c.acceleration_noise * interval / c.interval_s
        ax.axvline(rule, color=colors.PAPER, linestyle=":", label="a² T")
        ax.set(title=f"T = {interval:g} s", xlabel="process noise (m²/s³)")
    axes[0].set(ylabel="position RMSE, quiet (m)")
    axes[0].legend()
    return fig


def figure_13(result: Result) -> Figure:
    """Beyond the paper: the window must be shorter than the burst, and the initial error that a UKF helps with."""
    fig, axes = figure(9.5, 3.0, 1, 2)
    for (label, interval, density), color in zip(WINDOWS, (colors.PAPER, colors.COMPARISON, colors.ESTIMATE), strict=True):
        lengths = WINDOWS[label, interval, density]
        found = {name: rms(result.late(label, interval, name)) for name in ("ukf", "group", *(f"M = {M}" for M in lengths))}
        q = density or result.config.acceleration_noise
        axes[0].loglog(lengths, [found[f"M = {M}"] for M in lengths], marker="o", markersize=3, color=color,
                       label=f"AUKF, {1.0 / interval:g} Hz, {q:.4g} m²/s³")  # fmt: skip
        axes[0].axhline(found["ukf"], color=color, linestyle="--", linewidth=0.8)
        axes[0].axhline(found["group"], color=color, linestyle=":", linewidth=0.8)
    axes[0].set(xlabel="window M (epochs)", ylabel="position RMSE, burst and after (m)", title="dashed: UKF, dotted: group parity")
    axes[0].legend()
    for km, style in zip(INITIAL_KM, (":", "-.", "--", "-"), strict=True):
        for filter, color in UNDER_START.items():
            named = {"label": LABELS[filter]} if km == INITIAL_KM[-1] else {}
            axes[1].semilogy(medians(result, km, filter), color=color, linestyle=style, **named)
    axes[1].set(xlabel="epoch (1 Hz)", ylabel="median position error (m)",
                title="initial error " + ", ".join(f"{km:g}" for km in INITIAL_KM) + " km")  # fmt: skip
    axes[1].legend()
    return fig


def figure_14(result: Result) -> Figure:
    """Beyond the paper: half a day of a real receiver, and a burst that is added to it."""
    fig, axes = figure(10.0, 3.2, 1, 3)
    real = result.real
    if real is None:
        for ax in axes:
            ax.set_axis_off()
        axes[1].text(0.5, 0.5, "The receiver's files are absent:\ncelnav reproduce aukf --rinex DIR", ha="center", va="center")
        return fig
    hours = (real.log.times - real.log.times[0]) / 3600.0
    for filter in ("ls", "aukf"):
        local = real.positioned().local(real.tracks[filter])
        axes[0].plot(local[:, 0], local[:, 1], ".", markersize=2.0, color=COLORS[filter], label=LABELS[filter])
        axes[1].plot(hours, local[:, 2], color=COLORS[filter], linewidth=0.7, label=f"{LABELS[filter]}: up")
    axes[0].set(xlabel="east (m)", ylabel="north (m)", aspect="equal", title="position from the header's")
    axes[1].set(xlabel="hours", ylabel="up (m)", title=f"3-D RMS of LS {real_rms(real, real.tracks['ls']):.2f} m")
    late = np.flatnonzero(real.during)
    shown = slice(max(late[0] - 10, 0), late[-1] + 20)
    for filter, track in real.burst.items():
        away: Array = size(track[shown] - np.pad(real.reference, (0, 5)))
        axes[2].semilogy(hours[shown], away, color=COLORS[filter], label=LABELS[filter])
    axes[2].set(xlabel="hours", ylabel="distance (m)", title=f"with {result.config.burst_sigma:g} m added to the ranges")
    axes[0].legend(markerscale=3)
    axes[1].legend()
    axes[2].legend(loc="lower center", ncols=2)
    return fig
