"""[Xu2024] shown: figures and tables as the paper numbers them, those beyond it, recordings."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.metrics import rms
from celnav.gaussian.linalg import Array
from celnav.models.ephemeris import de421
from celnav.models.pulsar import LIGHT_KM_S, pulsars
from celnav.papers.tstdkf import scenario as s
from celnav.papers.tstdkf.scenario import DAY_S, SETTINGS, Config
from celnav.papers.tstdkf.study import (
    ALL,
    BOTH,
    COMPARED,
    COUPLINGS,
    LARGER,
    LATE,
    PRINTED,
    PULLING,
    TRENDS,
    VARIANTS,
    ephemerides,
    squares,
)  # fmt: skip
from celnav.show import colors, scenes, showcase
from celnav.show.estimates import Estimate, Group
from celnav.show.figures import figure
from celnav.show.plots import Curve, Plot, curves
from celnav.show.showcase import Showcase, Space
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

AXES, TKF, EKF = ("x", "y", "z"), colors.COMPARISON, colors.OPEN_LOOP
COLORS = {
    "ekf": EKF, "tkf": TKF, "fair": colors.MEASUREMENT, "tdkf": colors.FAINT, "tstdkf": colors.ESTIMATE, "aug": colors.REFERENCE,
    "B": colors.PAPER, "C": colors.ESTIMATE,
}  # fmt: skip
SHADES = (colors.COMPARISON, colors.ESTIMATE, colors.TRUTH)
"""Of axes and of pulsars."""
DAYS, BESIDE = "time (days)", {"loc": "upper left", "bbox_to_anchor": (1.01, 1.0)}


def config(results: Results) -> Config:
    """Of the month."""
    found: Config = results.parts["month"].config
    return found


# -- figures -----------------------------------------------------------------------------------------------------------------
def over_time(ax: Axes, results: Results, part: str, filter: str, group: str, **style: Any) -> None:
    """RMSE over the runs and an orbit, in which it swings."""
    square = np.square(results.error(part, filter, group)[..., 0]).mean(1)
    width = min(20, len(square))
    values = np.sqrt(np.convolve(square, np.full(width, 1.0 / width), "valid"))
    name = filter.split("/")[-1]
    ax.semilogy(results.times(part)[width - 1 :] / DAY_S, values, **({"color": COLORS.get(name), "label": name.upper()} | style))


def lines(ax: Axes, t: Array, values: Array, names: Any = AXES, **style: Any) -> None:
    """A line for each component of ``values (T, 3)``, ``t`` in s."""
    for name, color, column in zip(names, SHADES, values.T, strict=True):
        ax.plot(t / DAY_S, column, color=color, label=name, **style)


def principle(results: Results) -> Figure:
    """What a timing measures, in the plane of Earth and pulsar."""
    c, (fig, ax) = config(results), figure(6.2, 4.2)
    seen, timing = s.sky(c), c.timing
    earth, n, place = seen.earth[0], timing.directions[0], seen.earth[0] + c.orbit[:3]
    delay, roemer, shapiro = (
        float(x) / LIGHT_KM_S for x in (timing.delay(place, seen.sun[0])[0], n @ place, timing.shapiro(place, seen.sun[0])[0])
    )
    across = earth - (earth @ n) * n
    plane = np.stack([n, across / np.linalg.norm(across)])
    at = plane @ earth / np.linalg.norm(earth)
    satellite, ahead = at + 0.35 * (plane @ c.orbit[:3]) / np.linalg.norm(c.orbit[:3]), np.array([0.45, 0.0])
    for start, end, label, color in ((0.0 * at, at, "Earth (ephemeris)", TKF), (at, satellite, "orbit", colors.ESTIMATE)):
        ax.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": color, "lw": 1.6})
        ax.annotate(label, 0.5 * (start + end), color=color, xytext=(6, -10), textcoords="offset points")
    for foot in (0.0 * at, satellite):
        ax.annotate("", foot + ahead, foot, arrowprops={"arrowstyle": "->", "color": colors.SIGMA})
    ax.plot([satellite[0]] * 2, [satellite[1], 0.0], color=colors.SIGMA, linestyle=":", linewidth=1.0)
    ax.plot([0.0, satellite[0]], [-0.06, -0.06], color=colors.PAPER, linewidth=2.0)
    parts = f"n·r {roemer:.6f} s, parallax {1e6 * (delay - roemer - shapiro):.3f} µs, Shapiro {1e6 * shapiro:.2f} µs"
    ax.text(0.0, -0.11, f"Δt = {delay:.6f} s\n{parts}", color=colors.PAPER, va="top")
    for name, where in (("barycenter", 0.0 * at), ("Earth", at), ("satellite", satellite)):
        ax.plot(*where, "o", color="black", markersize=4)
        ax.annotate(name, where, xytext=(-4, 6), textcoords="offset points", ha="right")
    ax.annotate(f"to {c.pulsars[0]}", satellite + ahead, xytext=(-10, 6), textcoords="offset points")
    ax.set(xlim=(-0.45, satellite[0] + 0.7), ylim=(-0.45, max(at[1], satellite[1]) + 0.2), title="Figure 1: the delay of a pulse")
    ax.set_axis_off()
    return fig


def difference(ax: Axes, values: Array, title: str) -> None:
    """A difference of ephemerides and its norm."""
    t = ephemerides()[0].since(ephemerides()[0]._replace(rest=np.asarray(ephemerides()[0].rest)[0]))
    lines(ax, t, values)
    ax.plot(t / DAY_S, np.linalg.norm(values, axis=1), color="black", linewidth=0.8, linestyle="--", label="norm")
    ax.set(title=title)


def newer(results: Results) -> Figure:
    """The Earth, DE405 - DE421."""
    fig, ax = figure(6.5, 3.2)
    difference(ax, results.get("sky", "de405/earth"), "Figure 2: Earth, DE405 − DE421")
    ax.set(xlabel="days since 2015-10-17 04:00 UTC", ylabel="difference (km)")
    ax.legend(ncols=4)
    return fig


def others(results: Results) -> Figure:
    """Other ephemerides, the Sun, and the Earth seen from the Sun."""
    (fig, axes), d = figure(10.0, 5.2, 2, 2, sharex=True), results.data["sky"]
    difference(axes[0, 0], d["de423/earth"], "Earth, DE423 − DE421")
    difference(axes[0, 1], d["de406/earth"], "Earth, DE406 − DE421")
    difference(axes[1, 0], d["de405/sun"], "Sun, DE405 − DE421")
    difference(axes[1, 1], d["de405/earth"] - d["de405/sun"], "Earth from the Sun, DE405 − DE421")
    for ax, side in zip(axes[1], axes[:, 0], strict=True):
        ax.set(xlabel="days since 2015-10-17 04:00 UTC")
        side.set(ylabel="difference (km)")
    axes[1, 0].legend(loc="center right")
    return fig


def ignorant(number: int, group: str, unit: str, results: Results) -> Figure:
    """RMSE of an EKF that ignores the ephemeris error."""
    fig, ax = figure(8.0, 3.2)
    over_time(ax, results, "month", "5/ekf", group, label="EKF, ephemeris error", color=TKF)
    over_time(ax, results, "variants", "12/ekf", group, label=f"error {LARGER:.3g} times as large", color=colors.PAPER)
    over_time(ax, results, "variants", "13/ekf", group, label="no ephemeris error", color=colors.TRUTH)
    if group == "position":
        over_time(ax, results, "month", "5/tkf", group, label="TKF, ephemeris error", color=colors.ESTIMATE)
        over_time(ax, results, "month", "5/ekf", "bias", label="size of the ephemeris error", color=colors.SIGMA, linestyle=":")
    ax.set(xlabel=DAYS, ylabel=f"{group} RMSE ({unit})", title=f"Figure {number}: what an ephemeris error does (white noise)")
    ax.legend(**BESIDE)
    return fig


def three_trends(results: Results) -> Figure:
    """The ephemeris error."""
    fig, axes = figure(9.0, 2.8, 1, 3, sharey=True)
    for ax, trend, equation in zip(axes, TRENDS, (17, 69, 70), strict=True):
        lines(ax, results.times("year"), results.get("year", f"{trend}/truth")[:, 0, 6:])
        ax.set(xlabel=DAYS, title=f"Eq. {equation}: {trend}")
    axes[0].set_ylabel("ephemeris error (km)")
    axes[0].legend()
    return fig


def model_error(results: Results) -> Figure:
    """What the ephemeris error makes of the timings."""
    c, (fig, ax) = config(results), figure(6.5, 3.0)
    seen = s.sky(c)
    Gamma = c.timing.gradient(seen.earth + s.nominal_orbit(c)[:, :3], seen.sun)
    lines(ax, c.times, (Gamma @ c.bias(c.times)[..., None])[..., 0], c.pulsars)
    ax.set(xlabel=DAYS, ylabel="c B = Γ δr (km)", title="Figure 6: model error of the timings")
    ax.legend()
    return fig


def third_bodies(results: Results) -> Figure:
    """Acceleration by Sun, Moon and planets, and of each body its largest."""
    fig, axes = figure(10.0, 3.2, 1, 2, width_ratios=(2, 1))
    each = {body: results.get("pulls", body) for body in PULLING}
    lines(axes[0], results.parts["pulls"].config.times, 1e9 * np.asarray(sum(each.values())), linewidth=0.4, alpha=0.7)
    axes[0].set(xlabel=DAYS, ylabel="acceleration (10⁻⁹ km/s²)", title="Figure 7: third bodies")
    axes[0].legend(ncols=3, loc="upper right")
    largest = sorted((float(np.linalg.norm(a, axis=1).max()), body) for body, a in each.items())
    axes[1].barh([body for _, body in largest], [size for size, _ in largest], color=colors.MEASUREMENT)
    axes[1].set(xscale="log", xlabel="largest (km/s²)")
    return fig


def spectrum(results: Results) -> Figure:
    """Two groups of lines."""
    (fig, ax), power = figure(6.5, 3.2), results.get("pulls", "power")
    lines(ax, DAY_S * results.get("pulls", "cycles")[1:], power[1:] / power.max(), linewidth=0.7)
    ax.set(xlim=(0.0, 60.0), yscale="log", title="Figure 8: spectrum of the acceleration")
    ax.set(xlabel="frequency (cycles/day)", ylabel="power (-)")
    ax.legend()
    return fig


def one_month(results: Results) -> Figure:
    """Setting 1: position, velocity and bias."""
    (fig, axes), t, bound = figure(10.0, 3.4, 1, 3), results.times("month"), results.get("covariances", "1/aug").diagonal(0, 1, 2)
    for i, (ax, group, unit, scale) in enumerate(zip(axes, (*BOTH, "bias"), ("km", "m/s", "km"), (1.0, 1e3, 1.0), strict=True)):
        for filter in ("1/ekf", "1/tkf", "fair/tkf", "1/tdkf", "1/tstdkf", "1/aug"):
            style = {"color": COLORS["fair"], "label": "TKF, stationary"} if filter == "fair/tkf" else {}
            if (group, filter) != ("bias", "1/ekf"):
                over_time(ax, results, "month", filter, group, linestyle="--" if filter in ("1/tdkf", "fair/tkf") else "-", **style)
        std = scale * np.sqrt(bound[:, 3 * i : 3 * i + 3].sum(1))
        ax.semilogy(t / DAY_S, std, color=colors.SIGMA, linewidth=3.0, alpha=0.5, zorder=0, label="bound")
        ax.set(xlabel=DAYS, ylabel=f"{group} RMSE ({unit})")
    axes[0].legend(ncols=2)
    axes[1].set_title("Figure 9: setting 1")
    return fig


def one_run(results: Results) -> Figure:
    """The first run's bias as estimated."""
    (fig, axes), t = figure(10.0, 3.0, 1, 3), results.times("month")
    std = 3.0 * np.sqrt(results.get("covariances", "1/aug").diagonal(0, 1, 2)[:, 6:])
    for i, (ax, axis) in enumerate(zip(axes, AXES, strict=True)):
        for filter in ("tkf", "tstdkf", "aug"):
            ax.plot(t / DAY_S, results.get("month", f"1/{filter}/first")[:, 0, 6 + i], color=COLORS[filter], label=filter.upper())
        mean = results.get("month", "1/aug/first")[:, 0, 6 + i]
        ax.fill_between(t / DAY_S, mean - std[:, i], mean + std[:, i], color=COLORS["aug"], alpha=0.3, label="±3σ AUG")
        ax.plot(t / DAY_S, config(results).bias(t)[:, i], color="black", label="truth")
        ax.set(xlabel=DAYS, title=axis, ylim=(-0.35, 0.35))
    axes[0].set_ylabel("ephemeris error (km)")
    axes[0].legend()
    return fig


TRACKED = {"tkf": "TKF", "C": "TSTDKF, form C", "B": "TSTDKF, form B", "aug": "AUG"}


def one_year(results: Results) -> Figure:
    """The bias of the first run along three trends."""
    (fig, axes), t = figure(10.0, 6.4, 3, 3, sharex=True), results.times("year") / DAY_S
    for row, trend in zip(axes, TRENDS, strict=True):
        for i, (ax, axis) in enumerate(zip(row, AXES, strict=True)):
            for f, label in TRACKED.items():
                first = results.get("year", f"{trend}/{f}/first")
                ax.plot(t[::24], first[::24, 0, 6 + i], color=COLORS[f], linewidth=0.9, label=label)
            ax.plot(t[::24], results.get("year", f"{trend}/truth")[::24, 0, 6 + i], color="black", linewidth=0.9, label="truth")
            ax.set(ylim=(-0.3, 0.3), title=f"{trend}, {axis}")
        row[0].set_ylabel("ephemeris error (km)")
    for ax in axes[-1]:
        ax.set(xlabel=DAYS)
    fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return fig


def bars(results: Results) -> Figure:
    """Table 5 as bars."""
    (fig, ax), x = figure(9.5, 3.2), np.arange(len(SETTINGS))
    for k, filter in enumerate(COMPARED):
        heights = [rms(squares(results, "month", f"{i}/{filter}")) for i in SETTINGS]
        ax.bar(x + 0.16 * (k - 2), heights, 0.15, color=COLORS[filter], label=filter.upper())
    ax.bar(-0.49, rms(squares(results, "month", "fair/tkf")), 0.15, color=COLORS["fair"], label="TKF, stationary covariances")
    ax.set_xticks(x, [f"{i}: F {c.F:g}, L {c.L:g}, κ {c.kappa:g}" for i, c in SETTINGS.items()])
    ax.set(ylabel="position RMSE (km)", title="Table 5")
    ax.legend(**BESIDE)
    return fig


def consistent(results: Results) -> Figure:
    """NEES of errors and biases drawn from their priors."""
    (fig, axes), t = figure(9.0, 3.0, 1, 2, sharey=True), results.times("consistency") / DAY_S
    for case, ax, title in zip(("1", "5"), axes, ("setting 1", "white noise"), strict=True):
        for filter, dof in (("ekf", 6), ("tkf", 6), ("tdkf", 6), ("aug", 9)):
            values = results.get("consistency", f"{case}/{filter}/nees").mean(1) / dof
            ax.semilogy(t, values, color=COLORS[filter], label=filter.upper())
        ax.axhline(1.0, color="black", linestyle=":", label="consistent")
        ax.set(xlabel=DAYS, title=title)
    axes[0].set_ylabel("NEES to its dimension (-)")
    axes[1].legend(**BESIDE)
    return fig


def depends(results: Results) -> Figure:
    """Setting 1 with one thing changed, and a coupling that is taken for another."""
    (fig, axes), y, x = figure(11.0, 4.2, 1, 2), np.arange(len(VARIANTS))[::-1], np.arange(len(COUPLINGS))
    for k, filter in enumerate(("tkf", "tstdkf", "aug")):
        if filter != "aug":
            widths = [rms(squares(results, "variants", f"{i}/{filter}")) for i in range(len(VARIANTS))]
            axes[0].barh(y + 0.2 - 0.4 * k, widths, 0.38, color=COLORS[filter], label=filter.upper())
        heights = [rms(squares(results, "ten days", f"{i}/{filter}", span=LATE)) for i in x]
        axes[1].bar(x + 0.26 * (k - 1), heights, 0.25, color=COLORS[filter], label=filter.upper())
    axes[0].set_yticks(y, VARIANTS)
    axes[0].set(xlabel="position RMSE (km)")
    axes[1].set_xticks(x, [f"{true:g} → {taken:g}" for true, taken in COUPLINGS])
    axes[1].set(xlabel="κ, and what filters take it for", ylabel="position RMSE (km)")
    for ax in axes:
        ax.legend()
    return fig


def cure(results: Results) -> Figure:
    """Sun and Moon: left to white noise, to colored noise, or modeled."""
    fig, ax = figure(6.5, 3.2)
    for filter, label, color in (
        ("white/tkf", "TKF, left to white noise", TKF), ("colored/tdkf", "TDKF, AR(1) noise that matches", colors.FAINT),
        ("colored/aug", "AUG, AR(1) noise that matches", colors.REFERENCE), ("modeled/tkf", "TKF, modeled", colors.ESTIMATE),
    ):  # fmt: skip
        over_time(ax, results, "forces", filter, "position", label=label, color=color)
    ax.set(xlabel=DAYS, ylabel="position RMSE (km)", title="Third bodies follow from the ephemeris that the filter has")
    ax.legend()
    return fig


FIGURES = {
    "figure_01": ("Fig. 1: principle: what a timing measures, drawn from the vectors of the start (not to scale).", principle),
    "figure_02": ("Fig. 2: position of the Earth, DE405 - DE421: not tens of kilometers but less than two.", newer),
    "figure_02b": ("Beyond the paper: other ephemerides, the Sun, and the Earth seen from the Sun.", others),
    "figure_03": ("Fig. 3: position RMSE of the EKF under an ephemeris error.", partial(ignorant, 3, "position", "km")),
    "figure_04": ("Fig. 4: velocity RMSE of the EKF under an ephemeris error.", partial(ignorant, 4, "velocity", "m/s")),
    "figure_05": ("Fig. 5: the ephemeris error, and the two other trends of Fig. 10.", three_trends),
    "figure_06": ("Fig. 6: what the ephemeris error makes of the timings.", model_error),
    "figure_07": ("Fig. 7: acceleration by Sun, Moon and planets, and of each body its largest.", third_bodies),
    "figure_08": ("Fig. 8: its spectrum: two groups of lines, not colored noise.", spectrum),
    "figure_09": ("Fig. 9: setting 1 over the month: position, velocity and bias; the exact filter, the fair TKF.", one_month),
    "figure_09b": ("Beyond the paper: the estimates of the first run's bias; three deviations of the exact filter.", one_run),
    "figure_10": ("Fig. 10: a year of three trends: the bias as TKF, TSTDKF (forms B and C) and AUG see it.", one_year),
    "figure_11": ("Beyond the paper: Table 5 as bars: position RMSE of the month in the five settings.", bars),
    "figure_12": ("Beyond the paper: consistency: NEES of errors and biases drawn from their priors.", consistent),
    "figure_13": ("Beyond the paper: setting 1 with one thing changed, and a coupling that is taken for another.", depends),
    "figure_14": ("Beyond the paper: Sun and Moon pull: left to white noise, to colored noise, or modeled.", cure),
}


# -- tables ------------------------------------------------------------------------------------------------------------------
Rows = list[dict[str, str | float]]


def parameters(results: Results) -> Rows:
    """The other parameters, with their sources."""
    names = ("step_s", "error_km", "error_m_per_s", "rho", "tau", "rate_noise_km_per_s", "acceleration_noise_km_per_s2")
    c, known = config(results), Config.__dataclass_fields__
    return [{"parameter": name, "value": str(getattr(c, name)), **{key: known[name].metadata[key] for key in ("meaning", "source")}}
            for name in (*names, "amplitude_km", "bias_prior_km", "walk_km")]  # fmt: skip


def compared(results: Results) -> Rows:
    """RMSE of all filters in the five settings, and TSTDKF to the others."""
    rows: Rows = []
    for i in SETTINGS:
        row: dict[str, str | float] = {"setting": i}
        size = {(f, g): rms(squares(results, "month", f"{i}/{f}", g)) for f in COMPARED for g in BOTH}
        row |= {f"{f.upper()} ({unit})": size[f, g] for f in COMPARED for g, unit in zip(BOTH, ("km", "m/s"), strict=True)}
        for g in BOTH:
            for f, printed in zip(("ekf", "tkf"), PRINTED[g], strict=True):
                row[f"{g}, below {f.upper()} (%)"] = 100.0 * (1.0 - size["tstdkf", g] / size[f, g])
                row[f"the paper's, {g}, {f.upper()}"] = printed if i == 1 else ""
        rows.append(row)
    return rows


def setting_1(results: Results) -> Rows:
    """Setting 1 with every filter."""
    columns = {"position (km)": ("position", ALL), "velocity (m/s)": ("velocity", ALL)}
    columns |= {f"{group}, second half (km)": (group, LATE) for group in ("position", "bias")}
    return [
        {"filter": f.upper().replace("1/", "").replace("FAIR/", "fair ")}
        | {name: rms(squares(results, "month", f, *what)) for name, what in columns.items()}
        for f in ("fair/ekf", "fair/tkf", *(f"1/{f}" for f in COMPARED))
    ]  # fmt: skip


def changed(results: Results) -> Rows:
    """Setting 1 with one thing changed."""
    rows: Rows = []
    for i, label in enumerate(VARIANTS):
        found = {f: rms(squares(results, "variants", f"{i}/{f}")) for f in ("ekf", "tkf", "tdkf", "tstdkf")}
        below = {f"TSTDKF below {f.upper()} (%)": 100.0 * (1.0 - found["tstdkf"] / found[f]) for f in ("ekf", "tkf")}
        rows.append({"changed": label, **{f"{f.upper()} (km)": value for f, value in found.items()}, **below})
    return rows


def taken(results: Results) -> Rows:
    """The coupling, and what filters take it for."""
    rows: Rows = []
    for i, (true, other) in enumerate(COUPLINGS):
        sizes = {f.upper(): rms(squares(results, "ten days", f"{i}/{f}", span=LATE)) for f in ("tkf", "tstdkf", "aug")}
        rows.append({"κ": true, "taken for": other, **sizes})
    return rows


ELEMENTS = ("a (km)", "e (-)", "i (deg)", "Ω (deg)", "ω (deg)", "ν (deg)")
TABLES = {
    "table_1": ("Table 1: elements of the orbit (chosen).", lambda r: [dict(zip(ELEMENTS, config(r).elements, strict=True))]),
    "table_2": ("Table 2: parameters of the pulsars (inferred), and the deviation of a timing.",
                lambda r: [{**vars(p), "deviation_km": float(d)} for p, d in zip(pulsars(config(r).pulsars), config(r).sigma_km)]),
    "table_3": ("Table 3: the other parameters.", parameters),
    "table_4": ("Table 4: the five settings of the noise (inferred).",
                lambda _: [{"setting": i, "F": c.F, "L": c.L, "κ": c.kappa} for i, c in SETTINGS.items()]),
    "table_5": ("Table 5: RMSE of position and velocity of all filters in the five settings, and TSTDKF to the others.", compared),
    "table_6": ("Beyond the paper: setting 1 with every filter.", setting_1),
    "table_7": ("Beyond the paper: what the percentages depend on: setting 1 with one thing changed.", changed),
    "table_8": ("Beyond the paper: the coupling κ, and what filters take it for: position (km), second half of ten days.", taken),
}  # fmt: skip


# -- recordings --------------------------------------------------------------------------------------------------------------
RECORDINGS = ["tstdkf.rrd", "tstdkf_year.rrd"]
SHOWN = ("tstdkf", "aug", "tkf", "ekf")
ARROW_KM, EARTH_KM, AU_KM, EXAGGERATION = 4000.0, 6378.137, 1.495978707e8, 1000.0
SPACES = (
    Space("world", f"about the Earth, km (errors x{EXAGGERATION:g})", (15e3, 11e3, 9e3)),
    Space("sun", "around the Sun, AU", (0.5, -2.2, 1.6)),
)


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    return showcase.write(dict(zip(RECORDINGS, (month(results), year(results)), strict=True)), outputs)


def month(results: Results) -> Showcase:
    """The first run of setting 1, about the Earth and around the Sun."""
    every = 9 if len(results.times("month")) > 180 else 1  # an orbit has 20 steps: every tenth would show two of its places only
    c, t = config(results), results.times("month")[::every]
    whole = {key: results.get("month", f"1/{key}")[:, 0] for key in ("truth", *(f"{f}/first" for f in SHOWN))}
    truth, found = whole["truth"][::every], {}
    for key in SHOWN:
        error = (whole[f"{key}/first"][::every] - truth)[:, None, : 6 if key == "ekf" else 9]
        known = results.data["covariances"].get(f"1/{key}"), results.data["month"].get(f"1/{key}/nis")
        cov, nis = (None if part is None else part[::every] for part in known)
        found[key] = Estimate(key.upper(), COLORS[key], error, cov, nis=None if nis is None else nis[:, 0])
    pulls = {body: results.get("pulls", body)[1 : 1 + len(whole["truth"]) : every] for body in ("moon", "sun", "venus", "jupiter")}
    sizes, days = [np.linalg.norm(pull, axis=1) for pull in pulls.values()], np.asarray(ephemerides()[0].rest)
    # The table has an instant every five hours; between them the difference is smooth to a meter.
    ephemeris = [np.interp(t, (days - days[0]) * DAY_S, column) for column in results.get("sky", "de405/earth").T]
    residuals = {}
    for i, pulsar in enumerate(c.pulsars):
        each = {f: Curve(results.get("month", f"1/{f}/residual")[::every, 0, i], COLORS[f], f.upper()) for f in SHOWN[:3]}
        residuals[pulsar] = Plot(f"residual of {pulsar}, km", each)
    factors = curves(AXES, results.get("month", "1/tstdkf/factors")[::every, 0].T, SHADES)
    others = {
        "factors": Plot("factors of strong tracking", factors, limits=(0.0, 12.0)),
        "pulls": Plot("log10 of third bodies' pull, km/s²", curves(pulls, sizes, (*SHADES, colors.PAPER)), log=True),
        "ephemeris": Plot("DE405 - DE421 of the Earth, km", curves(AXES, ephemeris, SHADES)),
    }

    def scene(out: Recorder) -> None:
        tracks = {"truth": whole["truth"][:, :3]}
        tracks |= {key: tracks["truth"] + EXAGGERATION * (whole[f"{key}/first"][:, :3] - tracks["truth"]) for key in SHOWN}
        orbits = np.stack([scenes.behind(points, 20, every) for points in tracks.values()], 1)
        out.globe("world/earth", EARTH_KM)
        out.points("world/sat/truth", truth[:, :3], colors.TRUTH, radius=5.0)
        shades, cov = [colors.TRUTH, *(COLORS[key] for key in SHOWN)], results.get("covariances", "1/aug")[::every, :3, :3]
        out.strips("world/sat/orbits", orbits, shades, labels=[key.upper() for key in tracks])
        out.ellipsoids("world/sat/aug", truth[:, :3], EXAGGERATION**2 * cov, COLORS["aug"], alpha=0.1)
        for body, color in (("sun", colors.STAR), ("moon", colors.BODY)):
            arrow = ARROW_KM / max(size.max() for size in sizes[:2]) * pulls[body]
            out.arrow(f"world/pull/{body}", truth[:, :3], arrow, color, body)
        around_the_sun(out, c, t, truth[:, :3])

    bias = Group("bias", "km", slice(6, 9), truth=truth[:, 6:])
    groups = (Group("position", "km", slice(0, 3)), Group("velocity", "m/s", slice(3, 6), 1e3), bias)
    return Showcase(
        "tstdkf", notes(results), t, found, groups, truth, np.eye(3, 9), "km", nis_dof=3, scene=scene, spaces=SPACES,
        plots={"residuals": residuals, "models": others},
        legend={colors.STAR: "Sun, pulsars", colors.BODY: "Moon, Earth"}, parameters=vars(c), counter="step",
        facts={"paper": "tstdkf", "seed": results.seed, "exaggeration": EXAGGERATION},
    )  # fmt: skip


def around_the_sun(out: Recorder, c: Config, times: Array, place: Array) -> None:
    """Earth, Sun, barycenter and the directions of the pulsars."""
    start = c.dates._replace(rest=np.asarray(c.dates.rest)[0])
    earth, sun = (de421().state(body, start.after(times)).position / AU_KM for body in ("earth", "sun"))
    days = start.after(np.linspace(0.0, 365.25 * DAY_S, 366))
    out.path("sun/orbit", [(de421().state("earth", days).position - de421().state("sun", days).position) / AU_KM], colors.FAINT)
    out.points("sun/sun", np.zeros_like(earth), colors.STAR, radius=9.0, label="Sun")
    out.points("sun/barycenter", -sun, colors.BODY, radius=3.0, label="barycenter")
    out.points("sun/earth", earth - sun, colors.BODY, radius=5.0, label="Earth")
    for name, direction in zip(c.pulsars, c.timing.directions, strict=True):
        out.arrow(f"sun/pulsar/{name}", earth - sun, np.tile(0.5 * direction, (len(times), 1)), colors.STAR, name)
        out.arrow(f"world/pulsar/{name}", place, np.tile(ARROW_KM * direction, (len(times), 1)), colors.STAR, name)


def notes(results: Results) -> str:
    """What the month shows."""
    size = {f: rms(squares(results, "month", f)) for f in ("1/ekf", "1/tkf", "1/tstdkf", "1/aug", "fair/tkf")}
    ekf, tkf = (100.0 * (1.0 - size["1/tstdkf"] / size[f]) for f in ("1/ekf", "1/tkf"))
    return f"""# Xu et al. (2024): two stages and strong tracking for X-ray pulsars

* **{ekf:.0f} % below the EKF, {tkf:.0f} % below the two-stage filter (TKF):** attained with tuned parameters.
* **Most of the second gain is tuning of the baseline:** TKF with the covariances that the noise really has comes to
  {size["fair/tkf"]:.4f} km, TSTDKF to {size["1/tstdkf"]:.4f} km.
* **The exact filter (AUG) takes what is there:** {size["1/aug"]:.4f} km.

A satellite times three pulsars; the Earth's ephemeris is wrong by some hundred meters (bias), the noise is colored and correlated.
Lines: the last orbit and what the filters made of it, errors {EXAGGERATION:g} times as large. Arrows: the pulls of Sun and Moon.
Deviations are those along the undisturbed orbit. Occultation by the Earth, exclusion near the Sun and one detector for three
pulsars are left out, as in the paper.
"""


def year(results: Results) -> Showcase:
    """The first run of each trend: plots alone."""
    rows, plots = slice(None, None, 6 if len(results.times("year")) > 120 else 1), dict[str, dict[str, Plot]]()
    for trend in TRENDS:
        first = {key: results.get("year", f"{trend}/{key}")[rows, 0] for key in ("truth", *(f"{f}/first" for f in TRACKED))}
        place = {f: results.error("year", f"{trend}/{f}", "position")[rows, 0, 0] for f in TRACKED}
        plots[trend] = {
            "position": Plot(f"{trend}: position error, km", {f: Curve(place[f], COLORS[f], label) for f, label in TRACKED.items()})
        }
        for i, axis in enumerate(AXES, start=6):
            tracks = {f: Curve(first[f"{f}/first"][:, i], COLORS[f], label) for f, label in TRACKED.items()}
            tracks["truth"] = Curve(first["truth"][:, i], colors.TRUTH, "truth")
            plots[trend][axis] = Plot(f"{trend}: ephemeris error {axis}, km", tracks, limits=(-0.4, 0.4))
    facts, legend = {"paper": "tstdkf", "seed": results.seed}, {COLORS[f]: label for f, label in TRACKED.items()}
    return Showcase("tstdkf year", NOTES, results.times("year")[rows], plots=plots, legend=legend, facts=facts, counter="step")


NOTES = """# A year of three trends

The ephemeris error on three axes along a sine, a growing and a triangular trend. The two-stage filter (TKF) takes it for constant
and does not follow. Strong tracking follows in form B, hardly in form C. The exact filter (AUG), told of a random walk, follows
best. Position errors are the rms of an hour. Computed by the linear driver.
"""
