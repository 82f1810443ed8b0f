"""[Fan] shown: figures and tables as the paper numbers them, those beyond it, recordings."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.filters.run import run
from celnav.models import pseudorange
from celnav.models.beidou import ELLIPSOID, GRAVITY_PARAMETER, ROTATION_RATE, satellites, turned
from celnav.papers.aukf.scenario import STANDARD, START_S, axes, circle, filters, middle, simulate, visible
from celnav.papers.aukf.study import (
    AXES,
    FILTERS,
    INCLINATIONS_DEG,
    INITIAL_KM,
    NORMAL_ERROR,
    PROCESS_NOISE,
    TIMED,
    WINDOWS,
    Flown,
    medians,
    noise,
    squares,
    variants,
    when,
    window,
)  # fmt: skip
from celnav.receiver import day
from celnav.receiver.constellation import synthetic
from celnav.receiver.report import KIND_COLORS, kinds, record_positioned
from celnav.receiver.sky import dilution
from celnav.show import colors, scenes, showcase
from celnav.show.estimates import Group, estimates
from celnav.show.figures import Line, band, errors, figure
from celnav.show.plots import Plot, curves
from celnav.show.showcase import Showcase, Space
from celnav.study.montecarlo import generator
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.papers.aukf.scenario import Config
    from celnav.show.recording import Recorder

LINES = {
    "ls": Line("LS", colors.MEASUREMENT), "ekf": Line("EKF", colors.SIGMA, width=2.4),
    "ukf": Line("UKF", colors.COMPARISON, width=0.9),
    "aukf": Line("AUKF", colors.ESTIMATE), "group": Line("group parity", colors.TRUTH, "--"),
    "channel": Line("channel parity", colors.OPEN_LOOP),
    "sage-husa": Line("Sage–Husa", "#332288"), "student": Line("Student", "#8C564B"), "huber": Line("Huber", colors.PAPER),
    "gate": Line("gate", colors.FAINT, ":"), "no redraw": Line("UKF, no redraw", colors.FAINT),
    "from a fix": Line("EKF from a fix", colors.TRUTH), "small": Line("UKF, α = 0.001", colors.OPEN_LOOP),
}  # fmt: skip
LABELS = {"ukf": "EKF, UKF"}
"""Where the EKF was not flown, as it is the UKF."""
CASES = {
    "ranges": "burst on all ranges",
    "both": "burst on ranges and rates",
    "one": "burst on one range",
    "mistuned": "mistuned R",
}
BLOCKS = (
    "antenna",
    "radio\nfrequency",
    "intermediate\nfrequency",
    "carrier and code\nwipe-off",
    "navigation\nmessage",
    "positioning",
)
STARTED = {
    "ekf": ("ekf", 1.0),
    "ukf": ("ukf", 1.0),
    "small": ("ukf", 1e-3),
    "aukf": ("aukf", 1.0),
    "from a fix": ("from a fix", 1.0),
}
"""Line -> filter and its alpha."""
Row = dict[str, str | float]


def rms(r: Results, a: Flown, during: str, group: str = "position") -> float:
    """RMSE of a group in a window, m."""
    return float(np.sqrt(squares(r, a, during, group).mean()))


# -- figures -------------------------------------------------------------------------------------------------------------------
def receiver(_: Results) -> Figure:
    """From the antenna to a position."""
    from matplotlib.patches import FancyBboxPatch

    fig, ax = figure(9.0, 2.0)
    for i, text in enumerate(BLOCKS):
        ax.add_patch(FancyBboxPatch((i, 0.0), 0.72, 0.5, boxstyle="round,pad=0.03", facecolor="none", edgecolor=colors.COMPARISON))
        ax.text(i + 0.36, 0.25, text, ha="center", va="center", fontsize=7)
        if i:
            ax.annotate("", (i - 0.04, 0.25), (i - 0.24, 0.25), arrowprops={"arrowstyle": "->", "color": colors.SIGMA})
    back = {"arrowstyle": "->", "color": colors.SIGMA, "connectionstyle": "bar,fraction=-0.08"}
    ax.annotate("", (3.36, -0.04), (5.36, -0.04), arrowprops=back)
    ax.text(4.36, -0.3, "expected delay and Doppler", ha="center", va="center", color=colors.FAINT)
    ax.text(2.5, 0.72, "baseband: the third and fourth block run once for each satellite", ha="center", color=colors.FAINT)
    ax.set(xlim=(-0.1, 5.85), ylim=(-0.45, 0.85), title="Figure 1: a receiver")
    ax.set_axis_off()
    return fig


def planes(results: Results) -> Figure:
    """Orbits' planes against the equator, and how well their nodes are known."""
    from matplotlib.patches import Circle

    fig, axes = figure(9.0, 3.0, 1, 3)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    for ax, i, title in ((axes[0], 55.0, "(a) large inclination"), (axes[1], 5.0, "(b) small inclination")):
        for tilt, color, label in ((0.0, colors.SIGMA, "equator"), (np.radians(i), colors.COMPARISON, f"orbit, i = {i:g}°")):
            ax.plot(np.cos(angle), np.sin(angle) * (0.35 * np.cos(tilt) + 0.9 * np.sin(tilt)), color=color, label=label)
        ax.plot([-1.0, 1.0], [0.0, 0.0], "o", color=colors.PAPER, markersize=4, label="nodes")
        ax.add_patch(Circle((0.0, 0.0), 0.16, color=colors.MEASUREMENT, alpha=0.6))
        ax.set(title=title, xlim=(-1.15, 1.15), ylim=(-1.1, 1.1), aspect="equal")
        ax.legend(loc="lower right")
        ax.set_axis_off()
    dense = np.geomspace(min(INCLINATIONS_DEG), max(INCLINATIONS_DEG), 60)
    axes[2].loglog(dense, np.degrees(NORMAL_ERROR / np.sin(np.radians(dense))), color=colors.COMPARISON, label="δn / sin i")
    axes[2].loglog(INCLINATIONS_DEG, results.get("nodes", "drawn"), "o", color=colors.PAPER, label="drawn")
    axes[2].set(xlabel="inclination (deg)", ylabel="deviation of the node (deg)", title=f"δn = {NORMAL_ERROR:g} rad")
    axes[2].legend()
    return fig


def polar(results: Results) -> Figure:
    """The unscented transform, from polar to Cartesian coordinates."""
    fig, axes = figure(9.0, 3.0, 1, 2)
    m, angle = results.data["polar"], np.linspace(0.0, 2.0 * np.pi, 121)
    axes[0].plot(*m["draws"].T, ".", markersize=1.0, color=colors.SIGMA, alpha=0.6)
    axes[0].plot(*m["images"].T, "o", markersize=4, color=colors.PAPER, label="images of the points (gray: draws)")
    for kind, color, label in (("linear", colors.OPEN_LOOP, "linearized"),
                               ("exact", colors.TRUTH, "exact mean, deviation of draws"),
                               ("unscented", colors.COMPARISON, "unscented")):  # fmt: skip
        mean, std = m[f"{kind} mean"], m[f"{kind} std"]
        for ax in axes:
            ax.plot(*mean, "x", color=color)
            ax.plot(*(mean + std * np.stack([np.cos(angle), np.sin(angle)], -1)).T, color=color,
                    linestyle="--" if kind == "unscented" else "-", label=f"{label}: mean y = {mean[1]:.4f}")  # fmt: skip
            ax.set(xlabel="x (-)")
    axes[0].set(ylabel="y (-)", title="Figure 3: r = 1 ± 0.02, θ = 90° ± 15°")
    axes[1].set(title="means and deviations", ylim=(0.9, 1.04), xlim=(-0.3, 0.3))
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return fig


def run_of(ax: Axes, results: Results, part: str, case: str, axis: int, limit: float) -> None:
    """The first run of EKF, UKF and AUKF, and the quantiles of all of the last."""
    for name in ("ekf", "ukf", "aukf"):
        if f"{case}/{name}/error" in results.data[part]:
            errors(ax, results, part, f"{case}/{name}", LINES[name], "position", axis, spread=name == "aukf")
    ax.set(xlabel="time (s)", ylim=(-limit, limit))


def quiet(i: int, results: Results) -> Figure:
    """An error without a burst; and where the noise is larger than the filters think."""
    fig, axes = figure(10.0, 2.9, 1, 2)
    for ax, part, case, limit in ((axes[0], "main", "none", 2.0), (axes[1], "disturbed", "mistuned", 4.0)):
        run_of(ax, results, part, case, i, limit)
        ratio = rms(results, (part, f"{case}/aukf"), "all", AXES[i].name) / rms(results, (part, f"{case}/ukf"), "all", AXES[i].name)
        title = f"Figure {i + 4}" if case == "none" else f"10 m of noise, {STANDARD.sigma_range_m:g} m assumed"
        ax.set(title=f"{title}: RMSE of AUKF {ratio:.2f} of UKF")
    axes[0].set(ylabel=f"error of {AXES[i].name} (m)")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return fig


def struck(i: int, case: str, results: Results) -> Figure:
    """An error with the burst on all ranges, or on the rates as well."""
    aukf, ukf, limits, channels = {"ranges": (("main", "ranges/aukf"), ("main", "ranges/ukf"), (20.0, 3.0), "ranges"),
                                   "both": (("disturbed", "both/aukf"), ("disturbed", "both/ukf"), (150.0, 60.0),
                                            "ranges and rates")}[case]  # fmt: skip
    fig, axes = figure(9.5, 2.9, 1, 2, width_ratios=(3, 2))
    (start, end), name = results.parts[aukf[0]].config.burst_s, AXES[i].name
    for ax, limit in zip(axes, limits, strict=True):
        ax.axvspan(start, end, color=colors.BOUND, alpha=0.25, linewidth=0.0)
        run_of(ax, results, aukf[0], case, i, limit)
    if case == "both":
        errors(axes[0], results, "baselines", "both/gate", LINES["gate"], "position", i)
    axes[1].set(xlim=(start - 2.0, end + 8.0), title="the burst")
    ratio = rms(results, aukf, "burst", name) / rms(results, ukf, "burst", name)
    title = f"Figure {i + 7}{'b' * (case == 'both')}: burst on {channels}: RMSE of AUKF {ratio:.2f} of UKF"
    axes[0].set(ylabel=f"error of {name} (m)", title=title)
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return fig


def factors(results: Results) -> Figure:
    """What the filter multiplies the noise by."""
    fig, axes = figure(9.0, 2.8, 1, 2, sharey=True)
    t, c = results.times("main"), results.parts["main"].config
    for ax, part, title in zip(axes, np.split(results.get("main", "ranges/aukf/factor"), 2, -1), ("ranges", "rates"), strict=True):
        ax.axvspan(*c.burst_s, color=colors.BOUND, alpha=0.25, linewidth=0.0)
        low, middle, high = np.quantile(part.reshape(len(t), -1), [0.05, 0.5, 0.95], axis=1)
        band(ax, t, low, high, color=colors.ESTIMATE, label="5-95 % of runs and satellites")
        ax.semilogy(t, middle, color=colors.ESTIMATE, label="median")
        ax.semilogy(t, part.mean((1, 2)), color=colors.COMPARISON, linestyle="--", label="mean")
        ax.set(title=f"A of the {title}", xlabel="time (s)")
    right = 1.0 + (c.burst_sigma / c.sigma_range_m) ** 2
    axes[0].axhline(right, color=colors.PAPER, linestyle=":", label=f"right in the burst: {right:.0f}")
    axes[0].set(ylabel="factor (-)")
    axes[0].legend(loc="upper left")
    return fig


def bars(results: Results) -> Figure:
    """Stronger baselines, by where the disturbance is."""
    fig, axes = figure(10.0, 3.2, 1, 4)
    names = list(FILTERS)
    for ax, (case, text) in zip(axes, CASES.items(), strict=True):
        values = [rms(results, ("baselines", f"{case}/{name}"), "all" if case == "mistuned" else "burst") for name in names]
        ax.barh(range(len(names)), values, color=[LINES[name].color for name in names], log=True)
        ax.set(title=text, xlabel="position RMSE (m)", xlim=(0.3 * min(values), 4.0 * max(values)))
        ax.set_yticks(range(len(names)), [LABELS.get(name, LINES[name].label) for name in names] if case == "ranges" else [])
        ax.invert_yaxis()
        for i, value in enumerate(values):
            ax.text(value * 1.1, i, f"{value:.3g}", va="center", fontsize=6.5)
    return fig


def densities(results: Results) -> Figure:
    """Where the filter breaks: little process noise, and the turn is taken for noise of the rates."""
    fig, axes = figure(9.0, 3.0, 1, 2, sharey=True)
    for ax, T in zip(axes, (0.1, 1.0), strict=True):
        for name in ("ekf", "aukf", "group"):
            values, line = [rms(results, noise(T, q, name), "quiet") for q in PROCESS_NOISE[T]], LINES[name]
            label = "EKF, UKF" if name == "ekf" else line.label
            ax.loglog(PROCESS_NOISE[T], values, marker="o", markersize=3, color=line.color, linestyle=line.style, label=label)
        ax.axvline(STANDARD.acceleration_noise * T / STANDARD.interval_s, color=colors.PAPER, linestyle=":", label="a² T")
        ax.set(title=f"T = {T:g} s", xlabel="process noise (m²/s³)")
    axes[0].set(ylabel="position RMSE, quiet (m)")
    axes[0].legend()
    return fig


def lengths(results: Results) -> dict[tuple[str, str], float]:
    """RMSE (m) in the burst and after it by label and filter, "M = 5" or a name."""
    out: dict[tuple[str, str], float] = {}
    for (label, _, q), Ms in WINDOWS.items():
        others = {name: ("main", f"ranges/{name}") if q is None else window(label, 10, name) for name in ("ukf", "group")}
        flown = {"ukf": others["ukf"], **{f"M = {M}": window(label, M) for M in sorted(Ms)}, "group": others["group"]}
        out |= {(label, name): rms(results, a, "late") for name, a in flown.items()}
    return out


def windows_and_starts(results: Results) -> Figure:
    """The window must be shorter than the burst; the initial error that a UKF helps with."""
    fig, axes = figure(9.5, 3.0, 1, 2)
    found = lengths(results)
    for (label, T, density), color in zip(WINDOWS, (colors.PAPER, colors.COMPARISON, colors.ESTIMATE), strict=True):
        Ms, q = sorted(WINDOWS[label, T, density]), density or STANDARD.acceleration_noise
        text = f"AUKF, {1.0 / T:g} Hz, {q:.4g} m²/s³"
        axes[0].loglog(Ms, [found[label, f"M = {M}"] for M in Ms], marker="o", markersize=3, color=color, label=text)
        for name, style in (("ukf", "--"), ("group", ":")):
            axes[0].axhline(found[label, name], color=color, linestyle=style, linewidth=0.8)
    axes[0].set(xlabel="window M (epochs)", ylabel="position RMSE, burst and after (m)", title="dashed: UKF, dotted: group parity")
    axes[0].legend()
    for km, style in zip(INITIAL_KM, (":", "-.", "--", "-"), strict=True):
        for key, (name, alpha) in STARTED.items():
            named = {"label": LINES[key].label} if km == INITIAL_KM[-1] else {}
            axes[1].semilogy(medians(results, km, name, alpha), color=LINES[key].color, linestyle=style, **named)
    title = "initial error " + ", ".join(f"{km:g}" for km in INITIAL_KM) + " km"
    axes[1].set(xlabel="epoch (1 Hz)", ylabel="median position error (m)", title=title)
    axes[1].legend()
    return fig


def half_day(results: Results) -> Figure | None:
    """A real receiver, and a burst that is added to it; None if its files were not given."""
    return day.drawn(results.data["real"], LINES, STANDARD.burst_sigma) if "real" in results.data else None


# -- tables --------------------------------------------------------------------------------------------------------------------
def table_1(r: Results) -> list[Row]:
    """RMSE by axis; the paper's numbers are lost."""
    flown = [("as tuned", name, ("main", f"none/{name}")) for name in ("ls", "ekf", "ukf", "aukf")]
    flown += [("noise of ranges mistuned", name, ("disturbed", f"mistuned/{name}")) for name in ("ukf", "aukf")]
    return [{"case": text, "filter": LINES[name].label, "paper": "lost",
             **{f"{g.name} (m)": rms(r, a, "all", g.name) for g in AXES}}
            for text, name, a in flown]  # fmt: skip


def table_2(r: Results) -> list[Row]:
    """Baselines by window, and the largest error in the burst, mean over the runs."""
    rows: list[Row] = []
    for case, text in CASES.items():
        for name in FILTERS:
            a = ("baselines", f"{case}/{name}")
            peak = np.sqrt(np.square(r.error(*a, "position")[when(r, *a, "burst")]).sum(-1)).max(0).mean()
            values = {f"{during} (m)": rms(r, a, during) for during in ("quiet", "burst", "after", "all")}
            rows.append({"case": text, "filter": LABELS.get(name, LINES[name].label), **values, "peak (m)": float(peak)})
    return rows


def table_3(r: Results) -> list[Row]:
    """Quiet, by interval and process noise."""
    rows: list[Row] = []
    for T, q in [(interval, density) for interval, some in PROCESS_NOISE.items() for density in some]:
        nis, factor = (r.get(*noise(T, q, what))[when(r, *noise(T, q, "ekf"), "quiet")] for what in ("ekf/nis", "aukf/factor"))
        row: Row = {"interval (s)": T, "process noise (m^2/s^3)": q, "NIS / dof, EKF": float(nis.mean() / factor.shape[-1])}
        row |= {f"{LINES[name].label} (m)": rms(r, noise(T, q, name), "quiet") for name in ("ekf", "aukf", "group")}
        rows.append(row | {"mean factor of the rates": float(np.split(factor, 2, -1)[1].mean())})
    return rows


def table_4(r: Results) -> list[Row]:
    """Burst and after it, by rate and length of the window."""
    density = {label: q or STANDARD.acceleration_noise for label, _, q in WINDOWS}
    return [{"rate": label, "process noise (m^2/s^3)": density[label],
             "filter": f"AUKF, {name}" if name.startswith("M") else LINES[name].label,
             "RMSE (m)": value} for (label, name), value in lengths(r).items()]  # fmt: skip


def table_5(r: Results) -> list[Row]:
    """Medians after the first updates, by the initial error."""
    rows: list[Row] = []
    for km, (key, how) in [(km, line) for km in INITIAL_KM for line in STARTED.items()]:
        after = {f"after epoch {k} (m)": float(medians(r, km, *how)[k]) for k in (0, 1, 5, 30)}
        rows.append({"initial error (km)": km, "filter": LINES[key].label, **after})
    return rows


def table_6(r: Results) -> list[Row]:
    """Consistency where the truth moves as the filters think it does."""
    rows: list[Row] = []
    for name in ("ekf", "ukf", "aukf", "group", "channel", "no redraw"):
        at = when(r, "matched", f"1 Hz/{name}", "all")
        nees, nis = (float(r.get("matched", f"1 Hz/{name}/{what}")[at].mean()) for what in ("nees", "nis"))
        bound = float(np.sqrt(np.square(r.get("bound", "std")[at]).sum(-1).mean()))
        rows.append({"filter": LINES[name].label, "NEES (8 if consistent)": nees, "NIS / dof": nis / 30.0,
                     "position RMSE / bound": rms(r, ("matched", f"1 Hz/{name}"), "all") / bound})  # fmt: skip
    return rows


def table_7(r: Results) -> list[Row]:
    """CPU time of a step on the machine at hand."""
    return [{"filter": LINES[name].label, "one run alone (ms)": 1e3 * r.value("timings", name, 0),
             "one run among 100 (ms)": 1e3 * r.value("timings", name, 1)} for name in TIMED]  # fmt: skip


def table_8(r: Results) -> list[Row]:
    """A real receiver; no rows if its files were not given."""
    found = r.data.get("real", {})
    return [{"filter": LINES[name].label, "RMS (m)": day.rms(found, name),
             "RMS with an added burst (m)": day.rms(found, f"burst/{name}")}
            for name in LINES if name in found]  # fmt: skip


FIGURES = {
    "figure_01": ("Fig. 1: the receiver, from the antenna to a position.", receiver),
    "figure_02": ("Fig. 2: an orbit's plane against the equator: the flatter it lies, the less is its node known.", planes),
    "figure_03": ("Fig. 3: the unscented transform, from polar to Cartesian coordinates.", polar),
    **{f"figure_{i + 4:02d}": (f"Fig. {i + 4}: error of {axis.name}, without a burst; and where the noise is larger than the "
                               f"filters think.",
                               partial(quiet, i)) for i, axis in enumerate(AXES)},
    **{f"figure_{i + 7:02d}{end}": (f"{text} error of {axis.name} with the burst on {channels}.", partial(struck, i, case))
       for i, axis in enumerate(AXES)
       for end, case, text, channels in (("", "ranges", f"Fig. {i + 7}:", "all ranges"),
                                         ("b", "both", "Beyond the paper:", "ranges and rates"))},
    "figure_10": ("Beyond the paper: what the filter multiplies the noise by.", factors),
    "figure_11": ("Beyond the paper: stronger baselines, by where the disturbance is.", bars),
    "figure_12": ("Beyond the paper: with little process noise the turn is taken for noise of the rates.", densities),
    "figure_13": ("Beyond the paper: the window must be shorter than the burst; the initial error that a UKF helps with.",
                  windows_and_starts),
    "figure_14": ("Beyond the paper: half a day of a real receiver, and a burst that is added to it.", half_day),
}  # fmt: skip
"""A drawing of what was not given is None, a table of it has no rows."""
TABLES = {
    "table_1": ("Table 1: RMSE of X, Y and Z by filter; the paper's numbers are lost.", table_1),
    "table_2": ("Beyond the paper: position RMSE of all filters by where the disturbance is.", table_2),
    "table_3": ("Beyond the paper: quiet position RMSE by interval and process noise.", table_3),
    "table_4": ("Beyond the paper: position RMSE in the burst and after it, by rate and length of the window.", table_4),
    "table_5": ("Beyond the paper: median position error after the first updates, by the initial error.", table_5),
    "table_6": ("Beyond the paper: consistency where the truth moves as the filters think it does.", table_6),
    "table_7": ("Beyond the paper: CPU time of a step on the machine at hand.", table_7),
    "table_8": ("Beyond the paper: the first half of a real receiver's day, position from the header's.", table_8),
}  # fmt: skip


# -- recordings ----------------------------------------------------------------------------------------------------------------
RECORDINGS = ["aukf_burst.rrd", "aukf_real.rrd"]
NAMES = {"aukf": ("AUKF", colors.ESTIMATE), "ekf": ("EKF, as UKF", colors.COMPARISON), "group": ("group parity", colors.TRUTH),
         "ls": ("each epoch by itself", colors.MEASUREMENT)}  # fmt: skip
SHOWN = 8
"""Runs that are flown again: the first in full, the others as points."""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    written = showcase.write({RECORDINGS[0]: _burst(results)}, outputs)
    if "real" not in results.parts:
        return written
    with outputs.path_for(RECORDINGS[1]) as path:
        record_positioned(day.positioned(results.parts["real"].config, "aukf", STANDARD.mask_deg), path)
    return RECORDINGS


def _burst(results: Results) -> Showcase:
    """Runs of "baselines" with the burst on all ranges, which come first there."""
    part = results.parts["baselines"]
    c, local = part.config, axes(part.config)
    sim = simulate(c, [generator(results.seed, part.number, run) for run in range(SHOWN)])
    S, data = len(sim.satellites.names), dict[str, Any]()
    known = {**filters(c, S), "aukf": variants(c, S, c.Q)["aukf, watched"]}
    for name in NAMES:
        also = (lambda _e, state, _i: {"factor": state.memory[0][0][1][0]}) if name == "aukf" else None
        track = run(known[name], sim.prior, sim.epochs(), keep="cov", also=also, on_failure="flag")
        data |= {f"{name}/error": track.mean - sim.truth, f"{name}/nis": track.nis, f"{name}/cov": track.cov[:, :1]}
        data |= track.extra
    del data["ls/cov"]  # a line through estimates of single epochs says nothing
    found, shades = estimates(data, NAMES), [KIND_COLORS[kind] for kind in kinds(sim.satellites.names)]
    adapt = {name: Plot(f"log10 A of the {name}", curves(sim.satellites.names, A, shades), log=True)
             for name, A in zip(("ranges", "rates"), data["factor"].T.reshape(2, S, -1), strict=True)}  # fmt: skip
    dop = dilution(sim.satellites.q, circle(c)[0], local)._asdict()
    palette = (colors.SIGMA, colors.COMPARISON, colors.TRUTH, colors.ESTIMATE, colors.OPEN_LOOP)
    adapt["dilution"] = Plot(f"dilution of precision, {S} satellites", curves(dop, dop.values(), palette))

    def scene(out: Recorder) -> None:
        _sky(out, c)
        truth = (circle(c)[0] - middle(c)) @ local.T
        out.trail("track/truth/trail", truth, colors.TRUTH, radius=2.0)
        for key, e in found.items():
            cov = None if e.cov is None else local @ e.cov[:, :3, :3] @ local.T
            scenes.track(out, f"track/{key}", truth + e.errors[:, 0, :3] @ local.T, e.color, e.label, cov=cov)

    growing = [f"track/{name}/trail" for name in ("truth", *NAMES)]
    spaces = (Space("world", "satellites, 1000 km (Earth-fixed)", (-45.0, 68.0, 40.0)),
              Space("track", "track, m (east, north, up)", (0.0, -9e3, 9e3), growing=growing))  # fmt: skip
    groups = [Group("position", "m", slice(0, 3), axes="XYZ"), Group("velocity", "m/s", slice(3, 6), axes="XYZ")]
    start, end = c.burst_s
    return Showcase(
        "aukf: burst", NOTES.format(c), c.times, found, groups, None, np.concatenate([local, np.zeros((3, 5))], 1),
        "m, east, north, up",
        nis_dof=2 * S, scene=scene, spaces=spaces, plots={"adaptation": adapt},
        events=[(start, f"{c.burst_sigma:g} m of noise on all ranges begin"), (end, "they end")], parameters=vars(c),
        facts={"paper": "aukf", "preset": "burst", "seed": results.seed, "runs": SHOWN},
    )  # fmt: skip


def _sky(out: Recorder, c: Config) -> None:
    """Lengths in 1000 km: those of the ground are lost in the picture anyway."""
    (position, velocity), broadcast = circle(c), synthetic()
    places = pseudorange.sources(broadcast, START_S + c.times, position, velocity).q
    period = 2.0 * np.pi * broadcast.sqrt_a**3 / np.sqrt(GRAVITY_PARAMETER)
    away = np.linspace(0.0, 1.0, 91)[:, None] * period  # orbits as they lie in space, on axes that are Earth-fixed at the start
    orbits = turned(satellites(broadcast, START_S + away).position, -ROTATION_RATE * away)
    seen, shades = np.isin(broadcast.names, visible(c).names), [KIND_COLORS[kind] for kind in kinds(broadcast.names)]
    out.globe("world/earth", ELLIPSOID.semimajor_axis / 1e6)
    scenes.constellation(out, "world", places / 1e6, orbits / 1e6, position / 1e6, seen, broadcast.names, shades)


NOTES = """# Fan et al., {0.burst_sigma:g} m of noise on all ranges from {0.burst_s[0]:g} to {0.burst_s[1]:g} s

**Adapting the noise of the measurement shrugs the burst off; the EKF, which equals the UKF, takes it for position.**

A receiver circles with {0.acceleration_g:g} g at {0.speed_m_per_s:g} m/s. Group parity knows the noise from what no position
explains, and needs no window. Satellites: GEO red, IGSO orange, MEO blue.
"""
