"""[Liang2014] shown: figures and tables as the paper numbers them, those beyond it, recordings."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.filters.run import run
from celnav.gaussian.linalg import Array, matvec, semidefinite_root
from celnav.gaussian.sparse_grid import point_count, smolyak
from celnav.models import inertial
from celnav.papers.aasghqf.scenario import BORESIGHTS, PAPER_WEIGHTS, PRESETS, T3, rules
from celnav.papers.aasghqf.study import (
    COMPARED, DIMENSIONS, MISALIGNMENTS_DEG, ROOTS, SEVEN, TABLE_1, TABLE_1_WEIGHTS, TABLE_2, TABLE_3, TABLE_4, threshold_weights,
)  # fmt: skip
from celnav.show import colors, scenes
from celnav.show.estimates import Estimate, Group
from celnav.show.figures import Line, band, consistency, errors, figure, rmse, sigma
from celnav.show.showcase import Showcase, Space, write
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

LINES = {
    "ukf": Line("UKF, 27", colors.COMPARISON), "sghqf": Line("SGHQF, 417", colors.ESTIMATE),
    "aasghqf": Line("AASGHQF, 75", colors.OPEN_LOOP), "nonlinear": Line("by nonlinearity, 57", colors.TRUTH, "--", 2.0),
    "ckf": Line("CKF, 26", "#999999"), "ckf5": Line("CKF of degree 5, 339", "#56B4E9"), "delayed": Line("delayed, 339", "#B15928"),
    "ghqf3": Line("GHQF, 3 points", "#8C6BB1"), "ghqf5": Line("GHQF, 5 points", "#B15928"), "ekf": Line("EKF", "#D55E00"),
    "triad-ekf": Line("EKF started by Wahba", "#000000"),
}  # fmt: skip
UNITS = ("deg",) * 3 + ("m/s",) * 2 + ("m",) * 2
COLUMNS = ("phi_x_deg", "phi_y_deg", "phi_z_deg", "v_east_m_per_s", "v_north_m_per_s", "longitude_m", "latitude_m")
Row = dict[str, str | float]


# -- figures -----------------------------------------------------------------------------------------------------------------
def points(weights: tuple[int, int], title: str, _: Results) -> Figure:
    """The points of a rule in two dimensions: area by the weight's magnitude, color by its sign."""
    fig, ax = figure(3.6, 3.4)
    rule = smolyak(2, 3, weights)
    for sign, color, label in ((1.0, colors.COMPARISON, "positive weight"), (-1.0, colors.PAPER, "negative weight")):
        chosen = rule.wm * sign > 0.0
        ax.scatter(*rule.nodes[chosen].T, s=3.0 + 125.0 * np.sqrt(np.abs(rule.wm[chosen])), color=color, label=label, alpha=0.8)
    ax.set(xlabel="$x_1$ (-)", ylabel="$x_2$ (-)", title=title, xlim=(-4.2, 4.2), ylim=(-4.2, 4.2), aspect="equal")
    ax.legend(loc="upper right")
    return fig


def one_run(group: str, first: int, count: int, results: Results) -> Figure:
    """Errors of one run of A-slow and T3: the first minute, and the whole flight."""
    fig, axes = figure(10.0, 1.9 * count, count, 4, squeeze=False, sharex="col")
    for column, (part, zoom) in enumerate((p, z) for p in ("A-slow", "T3") for z in (True, False)):
        t = results.times(part)
        for i, ax in enumerate(axes[:, column]):
            for filter in COMPARED:
                errors(ax, results, part, filter, LINES[filter], group, i)
            sigma(ax, results, part, "sghqf", "SGHQF", group, i)
            error, std = (results.error(part, "sghqf", group, what)[:, 0, i] for what in ("error", "std"))
            if not zoom:
                late = 3.0 * np.abs(error[len(t) // 10 :]).max() + 9.0 * std[-1]
                ax.set_ylim(-late, late)
            ax.set_xlim(0.0, min(60.0, t[-1]) if zoom else t[-1])
            if column == 0:
                ax.set_ylabel(f"{SEVEN[first + i]} error ({UNITS[first]})")
        axes[0, column].set_title(f"{part}, {'first minute' if zoom else 'whole flight'}")
        axes[-1, column].set_xlabel("time (s)")
    fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return fig


def against_bound(results: Results) -> Figure:
    """RMSE of the misalignment over the runs, and of the closed solution that starts an EKF."""
    fig, axes = figure(9.0, 3.0, 1, 3, sharey=True)
    for ax, part in zip(axes, ("A", "A-slow", "T3"), strict=True):
        for filter in (*COMPARED, "nonlinear", "triad-ekf"):
            rmse(ax, results, part, filter, LINES[filter], "misalignment")
        ax.set(title=part, xlabel="time (s)")
    best = np.sqrt(results.get("bound", "square")[:, 0])
    axes[0].semilogy(results.times("A"), best, color=colors.BOUND, linewidth=2.5, zorder=0, label="Cramér–Rao bound")
    axes[0].set_ylabel("misalignment, RMSE over the runs (deg)")
    axes[0].legend()
    return fig


def consistent(results: Results) -> Figure:
    """Consistency over time."""
    fig, axes = figure(9.0, 3.0, 1, 3, sharey=True)
    for ax, part in zip(axes, ("A", "A-slow", "T3"), strict=True):
        names = ("ukf", "sghqf", "aasghqf", *(("ckf", "ekf") if part != "T3" else ()), "triad-ekf")
        consistency(ax, results, part, {name: LINES[name] for name in names}, "nees", 13)
        ax.set(title=part, xlabel="time (s)")
    axes[0].set_ylabel("NEES, mean over the runs (-)")
    axes[1].legend(loc="upper right")
    return fig


def first_fix(results: Results) -> Figure:
    """The first star fix; from 45 degrees on some draws lie beyond the chart of the Euler angles, where Wahba's takes another branch."""
    fig, axes = figure(9.0, 3.4, 1, 2)
    for name in ("ukf", "ckf", "ekf", "ghqf3", "ghqf5", "aasghqf", "sghqf", "nonlinear", "triad-ekf"):
        label, color, style, _ = LINES[name]
        found = [results.get(f"start/{angle:g}", f"{name}/nees").mean() / 13.0 for angle in MISALIGNMENTS_DEG]
        axes[0].loglog(MISALIGNMENTS_DEG, found, color=color, marker=".", linestyle=style, label=label)
        if name != "triad-ekf":
            least = results.get("fixes", f"{name}/least")
            axes[1].loglog(MISALIGNMENTS_DEG, np.where(least > 0.0, least, np.nan), color=color, marker=".", linestyle=style)
    exact: dict[str, Any] = {"color": "black", "linewidth": 2.5, "zorder": 0, "alpha": 0.4, "label": "exact moments"}
    axes[1].loglog(MISALIGNMENTS_DEG, results.get("fixes", "exact/least"), **exact)
    axes[0].axhline(1.0, color=colors.SIGMA, linestyle=":")
    axes[0].set(ylabel="NEES / 13 after the first star fix (-)")
    axes[1].set(ylabel="least eigenvalue of the misalignment\ncovariance, posterior to prior (-)")
    for ax in axes:
        ax.set_xlabel("misalignment, 1σ of each angle (deg)")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    axes[1].legend()
    return fig


def growth(results: Results) -> Figure:
    """How points and weights grow with the dimension."""
    fig, axes = figure(7.0, 3.0, 1, 2)
    for name, color in (("level 3", colors.COMPARISON), ("level 4", colors.ESTIMATE)):
        values = results.get("growth", name)
        for ax, column in zip(axes, values.T, strict=True):
            ax.loglog(DIMENSIONS[: len(values)], column, color=color, marker="o", label=name)
    axes[0].set(xlabel="dimension n (-)", ylabel="points (-)")
    axes[1].set(xlabel="dimension n (-)", ylabel="sum of |weights|: amplification of noise (-)")
    axes[0].legend()
    return fig


def moments(results: Results) -> Figure:
    """Errors of the moments of the star residuals, by rule, and by the kind of root."""
    fig, axes = figure(9.0, 3.6, 1, 2)
    names = ("ukf", "ckf", "aasghqf", "ckf5", "delayed", "ghqf3", "sghqf", "nonlinear")
    bars = [("mean", colors.TRUTH, [results.value("fixes", f"{n}/mean", MISALIGNMENTS_DEG.index(10.0)) for n in names]),
            ("covariance", colors.ESTIMATE, [results.value("fixes", f"{n}/cov", MISALIGNMENTS_DEG.index(10.0)) for n in names])]  # fmt: skip
    _bars(axes[0], names, bars)
    axes[0].set(ylabel="relative error at 10° (-)", title="moments of the star residuals")
    tones = (colors.TRUTH, colors.ESTIMATE, colors.PAPER)
    pair = ("nonlinear", "sghqf")
    roots = [(k, c, [float(np.median(results.get("roots", f"{n}, {k}"))) for n in pair]) for k, c in zip(ROOTS, tones, strict=True)]
    _bars(axes[1], pair, roots)
    axes[1].set(ylabel="median relative error of E[h] (-)", title="root of a correlated covariance")
    return fig


def _bars(ax: Any, names: tuple[str, ...], rows: list[tuple[str, str, list[float]]]) -> None:
    """Groups of bars: a label, a color and heights by name."""
    width = 0.8 / len(rows)
    for k, (label, color, heights) in enumerate(rows):
        ax.bar(np.arange(len(names)) + (k - 0.5 * (len(rows) - 1)) * width, heights, width, color=color, label=label)
    ax.set_xticks(range(len(names)), [LINES[name].label for name in names], rotation=30, ha="right")
    ax.set_yscale("log")
    ax.legend()


def quantiles(results: Results) -> Figure:
    """The runs behind Table 3: quantiles of the misalignment error at T3."""
    fig, axes = figure(9.0, 3.0, 1, 3, sharey=True)
    for ax, filter in zip(axes, COMPARED, strict=True):
        size = np.linalg.norm(results.error("T3", filter, "misalignment"), axis=-1)
        low, middle, high = np.quantile(size, [0.05, 0.5, 0.95], axis=1)
        band(ax, results.times("T3"), low, high, color=LINES[filter].color, label="5-95 % of the runs")
        ax.semilogy(results.times("T3"), middle, color=LINES[filter].color, label="median")
        ax.set(title=LINES[filter].label, xlabel="time (s)", ylim=(1e-3, 100.0))
        ax.legend()
    axes[0].set_ylabel("misalignment error, 3-D (deg)")
    return fig


FIGURES = {
    "figure_01": ("Fig. 1: the 21 points of the isotropic rule, n = 2, level 3.", partial(points, (1, 1), "isotropic, level 3: 21 points")),
    "figure_02": ("Fig. 2: the 9 points of the anisotropic rule with weights 2, 1.", partial(points, (2, 1), "weights 2, 1, level 3: 9 points")),
    "figure_03": ("Fig. 3: misalignment errors of one run, presets A-slow and T3.", partial(one_run, "misalignment", 0, 3)),
    "figure_04": ("Fig. 4: velocity errors of one run.", partial(one_run, "velocity", 3, 2)),
    "figure_05": ("Fig. 5: position errors of one run.", partial(one_run, "position", 5, 2)),
    "figure_06": ("Beyond the paper: RMSE of the misalignment, and of an EKF started by a closed solution.", against_bound),
    "figure_07": ("Beyond the paper: consistency over time.", consistent),
    "figure_08": ("Beyond the paper: the first star fix over the size of the misalignment.", first_fix),
    "figure_09": ("Beyond the paper: how points and weights grow with the dimension.", growth),
    "figure_10": ("Beyond the paper: errors of the moments by rule, and how much the kind of root matters.", moments),
    "figure_11": ("Beyond the paper: the runs behind Table 3, quantiles of the misalignment error at T3.", quantiles),
}  # fmt: skip


# -- tables ------------------------------------------------------------------------------------------------------------------
def table_1(_: Results) -> list[Row]:
    """Points of the sparse grids, n = 1 to 6."""
    both = (("SGHQF", [None] * 6), ("AASGHQF", TABLE_1_WEIGHTS))
    return [{"n": n, "filter": f, "weights": "".join(map(str, every[n - 1] or [1] * n)), "paper": TABLE_1[f][n - 1],
             "ours": point_count(n, 3, every[n - 1])} for n in range(1, 7) for f, every in both]  # fmt: skip


def table_2(results: Results) -> list[Row]:
    """Degree of observability and weight of each state; ours in two units, free of units, and by nonlinearity."""
    every, in_degrees, information, weights = (results.get("observability", n) for n in ("every", "in degrees", "information", "weights"))
    columns = {
        "degree, paper": TABLE_2, "weight, paper": PAPER_WEIGHTS, "degree (phi in rad)": every[0],
        "weight (phi in rad)": threshold_weights(every[0], T3.threshold), "degree (phi in deg)": in_degrees,
        "weight (phi in deg)": threshold_weights(in_degrees, T3.threshold), "prior / posterior deviation": information,
        "weight by nonlinearity": weights,
    }  # fmt: skip
    return [{"state": s} | {name: float(column[i]) for name, column in columns.items()} for i, s in enumerate(inertial.STATES)]


def table_3(results: Results) -> list[Row]:
    """RMSE over the runs, averaged over the epochs, of the first seven states."""
    rows: list[Row] = []
    for f, printed in TABLE_3.items():
        ours = {p: np.sqrt(np.square(results.get(p, f"{f.lower()}/error")[..., :7]).mean(1)).mean(0) for p in PRESETS}
        for source, values in {"paper": printed, **{f"ours, {p}": v for p, v in ours.items()}}.items():
            rows.append({"filter": f, "source": source, **dict(zip(COLUMNS, map(float, values), strict=True))})
    return rows


def table_4(results: Results) -> list[Row]:
    """Points, and CPU time of a cycle, on the machine at hand: the least of all rounds."""
    counts = {"UKF": point_count(13, 2), "SGHQF": point_count(13, 3), "AASGHQF": point_count(13, 3, PAPER_WEIGHTS)}
    return [
        {"filter": f, "points, paper": TABLE_4[f][0], "points, ours": n, "time of a cycle, paper (s)": TABLE_4[f][1],
         "one run alone (s)": float(results.get("timings", f"{f.lower()}, 1").min()),
         "one run among 50 (s)": float(results.get("timings", f"{f.lower()}, 50").min())} for f, n in counts.items()
    ]  # fmt: skip


TABLES = {
    "table_1": ("Table 1: points of the sparse grids, n = 1 to 6, level 3.", table_1),
    "table_2": ("Table 2: degree of observability and weight of each state.", table_2),
    "table_3": ("Table 3: RMSE over the runs, averaged over the epochs, of the first seven states.", table_3),
    "table_4": ("Table 4: points, and CPU time of a cycle.", table_4),
}


# -- recordings --------------------------------------------------------------------------------------------------------------
CASES = {"A-slow": "aasghqf_A_slow.rrd", "T3": "aasghqf_T3.rrd"}
RECORDINGS = list(CASES.values())
SPACES = (
    Space("world", "flight, m (east, north, up)", (60e3, -70e3, 70e3), (90e3, 20e3, 0.0),
          growing=("world/aircraft/trail", "world/inertial/trail")),
    *(Space(f"points/{f}", f"sigma points of {LINES[f].label}, σ of SGHQF", (9.0, -9.0, 6.0)) for f in COMPARED),
)  # fmt: skip
WHITE, STAR_M = "#FFFFFF", 25000.0  # the length of a drawn sight line
NOTES = """# Liang et al. (2014), preset {}

**The UKF's first star fix leaves it overconfident, and it takes minutes to forget; 57 points are as good as 417.**

An aircraft turns at 200 m/s and 20 km. Its inertial system starts with a large misalignment and drifts away while star sensors and
SAR fixes let filters estimate its error. Left above: the flight, and the sigma points of the misalignment about the truth.
"""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    return write({name: showcase(results, part) for part, name in CASES.items()}, outputs)


def showcase(results: Results, part: str) -> Showcase:
    """The first run of a part, flown again in full, among the others."""
    c, first = results.parts[part].config, results.first(part)
    epochs, scale, found = list(first.epochs("")), np.ones(13), {}
    for group in results.study.groups:
        scale[group.part] = group.scale
    for f in ("sghqf", "ukf", "aasghqf"):
        cov = np.asarray(run(first.filters[f], first.prior, epochs, keep="cov").cov)[:, 0]
        own = results.get(part, f"{f}/error") / scale
        found[f] = Estimate(LINES[f].label, LINES[f].color, own, cov, results.get(part, f"{f}/nees")[:, 0])
    truth, fixes = (np.stack([getattr(epoch, name)[0] for epoch in epochs]) for name in ("truth", "z"))
    axes = np.diag(c.meters)[[0, 1, 1]] * [[1.0], [1.0], [0.0]]  # east, north, up of a place on the ground
    fix = (fixes[:, 6:] - truth[:, inertial.POSITION]) @ axes.T
    names = {"misalignment": "xyz", "velocity": ("east", "north"), "position": ("longitude", "latitude")}
    groups = [Group(g.name, g.unit, g.part, tuple(scale[g.part]), names[g.name]) for g in results.study.groups if g.name in names]

    def scene(out: Recorder) -> None:
        flight, at = c.flight, 2 * np.arange(len(truth))
        way = np.stack([flight.longitude - flight.longitude[0], flight.latitude - flight.latitude[0]], -1)[at]
        place, drifted = (x @ axes.T for x in (way, way + truth[:, inertial.POSITION]))
        scenes.track(out, "world/aircraft", place, colors.TRUTH, "aircraft", radius=2.5)
        scenes.track(out, "world/inertial", drifted, colors.SIGMA, "inertial system", radius=1.5)
        out.points("world/sar_fix", np.where(np.isfinite(fix), place, np.nan), colors.MEASUREMENT, radius=3.0)
        attitude = flight.attitude[at]
        computed = inertial.misalignment_matrix(truth[:, inertial.PHI]) @ attitude
        for k, star in enumerate(BORESIGHTS, start=1):
            out.arrow(f"world/star{k}/sight", place, STAR_M * (attitude @ star), colors.STAR, f"star {k}")
            out.arrow(f"world/star{k}/expected", place, STAR_M * (computed @ star), colors.MEASUREMENT, "")
        for f, estimate in found.items():
            _sigma_points(out, f, estimate, results.get(part, "sghqf/std")[:, 0, :3] / scale[:3])

    legend = {colors.MEASUREMENT: "fixes by radar, stars where the inertial system expects them", colors.STAR: "stars where they are",
              colors.SIGMA: "inertial system", WHITE: "points of negative weight"}  # fmt: skip
    return Showcase(
        f"aasghqf: {part}", NOTES.format(part), results.times(part), found, groups, truth,
        np.concatenate([np.zeros((3, 5)), axes, np.zeros((3, 6))], 1), "m", fix, scene=scene, spaces=SPACES, legend=legend,
        bars={"degree of observability by state": results.get("observability", "every")[0]}, parameters=vars(c),
        facts={"paper": "aasghqf", "preset": part, "seed": results.seed, "runs": results.get(part, "ukf/nees").shape[1]},
    )  # fmt: skip


def _sigma_points(out: Recorder, filter: str, estimate: Estimate, std: Array) -> None:
    """The misalignment of the sigma points about the truth, in deviations ``std (T, 3)`` of SGHQF, by the sign of their weights."""
    rule, root = rules()[filter], semidefinite_root(np.asarray(estimate.cov))
    moved = rule.nodes[:, :3].any(-1) | (np.arange(len(rule.nodes)) == 0)
    for name, chosen, color in (("positive", rule.wm > 0.0, estimate.color), ("negative", rule.wm < 0.0, WHITE)):
        places = estimate.errors[:, 0, None, :3] + matvec(root[:, None], rule.nodes[moved & chosen][None])[..., :3]
        out.points(f"points/{filter}/{name}", places / std[:, None], color, radius=2.5)
    out.points(f"points/{filter}/truth", np.zeros(std.shape), colors.TRUTH, radius=5.0)
