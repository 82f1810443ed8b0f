"""Figures 1 to 13 of the paper, and those of what lies beyond it. They draw what a `Result` holds and compute nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.linalg import Array
from celnav.models import sightings
from celnav.models.orbit import EARTH
from celnav.papers.csrukf import theory
from celnav.papers.csrukf.study import NAMES, WRONG, Result
from celnav.show import colors
from celnav.show.figures import band, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SRUKF, CSRUKF, OPEN = colors.COMPARISON, colors.ESTIMATE, colors.OPEN_LOOP
AXES = ("x", "y", "z", "v_x", "v_y", "v_z")


def figure_1(result: Result) -> Figure:
    """Fig. 1: geometry of the measurement: two stars, the Earth's limb, and the three angles."""
    fig, ax = figure(6.0, 5.2, subplot_kw={"projection": "3d"})
    path = result.config.nominal()[:, :3]
    r = path[0]
    u, v = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
    globe = EARTH.radius_km * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    ax.plot_wireframe(*globe, color=colors.MEASUREMENT, linewidth=0.4, alpha=0.6)
    ax.plot(*path.T, color=colors.TRUTH, label="orbit, 600 s")
    ax.plot(*np.stack([np.zeros(3), r]).T, color=colors.SIGMA, linestyle="--", linewidth=1)
    stars = sightings.star_directions(result.config.separation)
    A = np.degrees(sightings.angles(r, stars))
    for i, star in enumerate(stars):
        ax.quiver(*r, *(5000.0 * star), color=SRUKF, arrow_length_ratio=0.1)
        ax.text(*(r + 5600.0 * star), f"star {i + 1}, $A_{i + 1}$ = {A[i]:.2f}°", fontsize=8)
    for limb in _limb(r):
        ax.plot(*np.stack([r, limb]).T, color=CSRUKF)
    ax.text(*(r * 1.03), f"satellite, $A_3$ = {A[2]:.2f}°", fontsize=8)
    ax.set(xlabel="x (km)", ylabel="y (km)", zlabel="z (km)", title="Figure 1: measured angles")
    ax.set_aspect("equal")
    ax.view_init(22, 15)
    ax.legend(loc="upper left")
    return fig


def _limb(r: Array) -> Array:
    """Two points ``(2, 3)`` where lines of sight from ``r`` touch the Earth."""
    radius = np.linalg.norm(r)
    along = r / radius
    across = np.cross(along, [0.0, 0.0, 1.0])
    across = across / np.linalg.norm(across)
    sine = EARTH.radius_km / radius
    return np.stack([EARTH.radius_km * (sine * along + side * np.sqrt(1.0 - sine**2) * across) for side in (1.0, -1.0)])


def _white(result: Result, i: int) -> Figure:
    """An error under white noise: SRUKF and CSRUKF coincide; the lagged curve is what the paper draws."""
    data, t, unit = result.data["P/0"], result.times, "km" if i < 3 else "m/s"
    kind = "absolute position error" if i < 3 else "velocity error"
    fig, ax = figure(7.0, 3.2)
    sign = np.abs if i < 3 else np.asarray
    ax.plot(t, sign(data["srukf/error"][:, 0, i]), color=SRUKF, linewidth=2.2, label="SRUKF, run 1")
    ax.plot(t, sign(data["csrukf/error"][:, 0, i]), color=CSRUKF, linestyle="--", label="CSRUKF without latency, run 1")
    ax.plot(
        t[:-1],
        sign(data["lagged/error"][:, 0, i]),
        color=colors.TRUTH,
        linewidth=0.7,
        label="CSRUKF lagged (uses the next sample)",
    )
    _sigma(ax, t, data["csrukf/std"][:, 0, i], both=i >= 3)
    ax.set(
        xlabel="time (s)", ylabel=f"{kind} ${AXES[i]}$ ({unit})", title=f"Figure {i + 2}: ${AXES[i]}$, $\\Phi = 0$", xlim=(0, t[-1])
    )
    ax.legend(ncols=2)
    return fig


def _sigma(ax: Axes, t: Array, std: Array, *, both: bool, label: str = "±3σ of CSRUKF") -> None:
    ax.plot(t, 3.0 * std, color=colors.SIGMA, linestyle=":", label=label if both else label.replace("±", ""))
    if both:
        ax.plot(t, -3.0 * std, color=colors.SIGMA, linestyle=":")


def _walk(result: Result, i: int) -> Figure:
    """An error under random-walk noise: SRUKF follows the noise, CSRUKF the open loop."""
    data, t, unit = result.data["P/I"], result.times, "km" if i < 3 else "m/s"
    kind = "absolute position error" if i < 3 else "velocity error"
    fig, (left, right) = figure(7.0, 3.4, 1, 2)
    sign = np.abs if i < 3 else np.asarray
    for ax, names in ((left, ("srukf", "csrukf")), (right, ("csrukf", "openloop"))):
        for name, color, title in (("srukf", SRUKF, "SRUKF"), ("csrukf", CSRUKF, "CSRUKF"), ("openloop", OPEN, "open loop")):
            if name not in names:
                continue
            error = sign(data[f"{name}/error"][..., i])
            style = "--" if name == "openloop" else "-"
            band(ax, t, *np.quantile(error, [0.05, 0.95], axis=1), color=color, label=f"{title}, 5-95 % of runs")
            ax.plot(t, error[:, 0], color=color, linestyle=style, label=f"{title}, run 1")
            if name != "openloop":
                ax.plot(t, error[:, 1:4], color=color, linewidth=0.4, alpha=0.6)
        ax.set(xlabel="time (s)", xlim=(0, t[-1]))
        ax.legend(fontsize=6.5)
    _sigma(right, t, data["csrukf/std"][:, 0, i], both=i >= 3)
    left.set_ylabel(f"{kind} ${AXES[i]}$ ({unit})")
    right.set_title("CSRUKF against open loop")
    left.set_title(f"Figure {i + 8}: ${AXES[i]}$, $\\Phi = I$")
    return fig


def figure_2(result: Result) -> Figure:
    """Fig. 2: absolute position error x, white noise: both filters are one filter."""
    return _white(result, 0)


def figure_3(result: Result) -> Figure:
    """Fig. 3: absolute position error y, white noise: both filters are one filter."""
    return _white(result, 1)


def figure_4(result: Result) -> Figure:
    """Fig. 4: absolute position error z, white noise: both filters are one filter."""
    return _white(result, 2)


def figure_5(result: Result) -> Figure:
    """Fig. 5: velocity error v_x, white noise: both filters are one filter."""
    return _white(result, 3)


def figure_6(result: Result) -> Figure:
    """Fig. 6: velocity error v_y, white noise: both filters are one filter."""
    return _white(result, 4)


def figure_7(result: Result) -> Figure:
    """Fig. 7: velocity error v_z, white noise: both filters are one filter."""
    return _white(result, 5)


def figure_8(result: Result) -> Figure:
    """Fig. 8: absolute position error x, noise that walks at random: SRUKF follows it; CSRUKF is the open loop."""
    return _walk(result, 0)


def figure_9(result: Result) -> Figure:
    """Fig. 9: absolute position error y, noise that walks at random: SRUKF follows it; CSRUKF is the open loop."""
    return _walk(result, 1)


def figure_10(result: Result) -> Figure:
    """Fig. 10: absolute position error z, noise that walks at random: SRUKF follows it; CSRUKF is the open loop."""
    return _walk(result, 2)


def figure_11(result: Result) -> Figure:
    """Fig. 11: velocity error v_x, noise that walks at random: SRUKF follows it; CSRUKF is the open loop."""
    return _walk(result, 3)


def figure_12(result: Result) -> Figure:
    """Fig. 12: velocity error v_y, noise that walks at random: SRUKF follows it; CSRUKF is the open loop."""
    return _walk(result, 4)


def figure_13(result: Result) -> Figure:
    """Fig. 13: velocity error v_z, noise that walks at random: SRUKF follows it; CSRUKF is the open loop."""
    return _walk(result, 5)


def figure_14(result: Result) -> Figure:
    """Beyond the paper: consistency, NEES and NIS averaged over the runs with their 95 % bands."""
    fig, axes = figure(7.0, 4.6, 2, 3, sharex=True)
    t = result.times
    for column, name in enumerate(("0", "0.8", "I")):
        for row, (key, dof) in enumerate((("nees", 6), ("nis", 3))):
            ax = axes[row, column]
            for filter, color in (("srukf", SRUKF), ("csrukf", CSRUKF)):
                mean = result.data[f"P/{name}"][f"{filter}/{key}"][1:].mean(1)
                ax.semilogy(t[1:], mean, color=color, label=filter.upper(), linewidth=0.9)
            low, high = chi_square_band(dof, result.runs)
            ax.axhspan(low, high, color=colors.SIGMA, alpha=0.4, label="95 % band")
            ax.set_title(f"$\\Phi = {name}$" if row == 0 else "")
        axes[1, column].set_xlabel("time (s)")
    axes[0, 0].set_ylabel("mean NEES (-)")
    axes[1, 0].set_ylabel("mean NIS (-)")
    axes[0, 0].legend()
    return fig


def figure_15(result: Result) -> Figure:
    """Beyond the paper: RMSE of the Monte Carlo against the exact linear theory and the posterior Cramer-Rao bound."""
    fig, axes = figure(7.0, 3.0, 1, 3)
    expected = result.theory["P"]
    for i, (ax, name) in enumerate(zip(axes, ("0", "0.8", "I"), strict=True)):
        for filter, std, color in (("srukf", expected.srukf, SRUKF), ("csrukf", expected.csrukf, CSRUKF)):
            error = result.data[f"P/{name}"][f"{filter}/error"][..., :3]
            ax.semilogy(result.times, np.sqrt(np.square(error).sum(-1).mean(1)), color=color, label=f"{filter.upper()}, runs")
            ax.semilogy(result.times, theory.position(std[:, i]), color=color, linestyle=":", label="theory")
        ax.set(xlabel="time (s)", title=f"$\\Phi = {name}$")
    axes[0].set_ylabel("3-D position RMSE (km)")
    axes[0].legend()
    return fig


def figure_16(result: Result) -> Figure:
    """Beyond the paper: final position error over Phi, for the fitted prior and a poor one (linear theory)."""
    fig, axes = figure(7.0, 3.2, 1, 2, sharex=True)
    away = 1.0 - np.array(theory.SWEEP)
    place = np.arange(len(away))
    for ax, preset, title in zip(axes, ("P", "D"), ("prior 0.15 km, 0.035 m/s", "prior 10 km, 10 m/s"), strict=True):
        sweep = result.theory[f"sweep/{preset}"]
        for std, color, marker, label in (
            (sweep.srukf, SRUKF, "o", "SRUKF"),
            (sweep.csrukf, CSRUKF, "s", "CSRUKF"),
            (sweep.first, colors.TRUTH, "^", "CSRUKF with the first sample"),
        ):
            ax.semilogy(place, theory.position(std[-1]), color=color, marker=marker, markersize=4, label=label)
        ax.set_xticks(place, [f"{phi:g}" for phi in theory.SWEEP])
        ax.set(xlabel="coefficient φ of $\\Phi = \\varphi I$ (-)", title=title)
    axes[0].set_ylabel("final 3-D position error (km)")
    axes[0].legend()
    return fig


def figure_17(result: Result) -> Figure:
    """Beyond the paper: long arcs from a poor prior, SRUKF against the bound."""
    fig, ax = figure(5.5, 3.4)
    long = result.theory["long"]
    t = np.arange(1, len(long["srukf"])) * result.config.step_s
    for i, (name, style) in enumerate((("I", "-"), ("0.8 I", "--"))):
        ax.loglog(t, long["srukf"][1:, i], color=SRUKF, linestyle=style, label=f"SRUKF, $\\Phi = {name}$")
        ax.loglog(t, long["bound"][1:, i], color=CSRUKF, linestyle=style, label=f"bound, $\\Phi = {name}$")
    ax.set(xlabel="time (s)", ylabel="3-D position error (km)", title="prior 100 km, 100 m/s, first sample used")
    ax.legend()
    return fig


def figure_18(result: Result) -> Figure:
    """Beyond the paper: a wrong coefficient in the filter."""
    fig, axes = figure(7.0, 3.0, 1, 2)
    assumed = sorted({phi for true, others in WRONG.items() for phi in (true, *others)})
    for true, color in ((1.0, SRUKF), (0.8, CSRUKF)):
        name = NAMES[true]
        phis = sorted((true, *WRONG[true]))
        runs = [(f"P/{name}", "csrukf") if phi == true else (f"wrong/{name}", f"{phi:g}") for phi in phis]
        finals = [np.sqrt(np.square(result.data[a][f"{b}/error"][-1, :, :3]).sum(-1).mean()) for a, b in runs]
        means = [result.data[a][f"{b}/nees"][1:].mean() for a, b in runs]
        for ax, values in zip(axes, (finals, means), strict=True):
            ax.semilogy([assumed.index(phi) for phi in phis], values, color=color, marker="o", label=f"true φ = {true:g}")
            ax.semilogy(assumed.index(true), values[phis.index(true)], color=color, marker="o", markersize=9, fillstyle="none")
            ax.set_xticks(range(len(assumed)), [f"{phi:g}" for phi in assumed])
            ax.set_xlabel("φ assumed by the filter (circle: the true one)")
    axes[0].set_ylabel("final 3-D position RMSE (km)")
    axes[1].set_ylabel("time-mean NEES (-)")
    axes[1].axhline(6.0, color=colors.SIGMA, linestyle=":", label="consistent")
    axes[1].legend()
    return fig
