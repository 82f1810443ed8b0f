"""[Liang2014] shown: figures and tables as the paper numbers them, those beyond it, recordings."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.observability import threshold_weights
from celnav.gaussian.linalg import matvec, semidefinite_root
from celnav.gaussian.sparse_grid import point_count, smolyak
from celnav.models import inertial
from celnav.papers.aasghqf import study
from celnav.papers.aasghqf.scenario import BORESIGHTS, NONLINEAR_WEIGHTS, PAPER_WEIGHTS, PRESETS, rules
from celnav.papers.aasghqf.study import COMPARED, GROUPS, MISALIGNMENTS_DEG, TABLE_1, TABLE_2, TABLE_3, TABLE_4
from celnav.show import colors, scenes
from celnav.show.estimates import Group, again
from celnav.show.figures import Line, band, consistency, errors, figure, rmse, sigma
from celnav.show.showcase import Showcase, Space, write
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

LINES = {
    "sghqf": Line("SGHQF, 417", colors.ESTIMATE), "ukf": Line("UKF, 27", colors.COMPARISON),
    "aasghqf": Line("AASGHQF, 75", colors.OPEN_LOOP), "nonlinear": Line("by nonlinearity, 57", colors.TRUTH, "--", 2.0),
    "ckf": Line("CKF, 26", "#999999"), "ckf5": Line("CKF of degree 5, 339", "#56B4E9"), "delayed": Line("delayed, 339", "#B15928"),
    "ghqf3": Line("GHQF, 3 points", "#8C6BB1"), "ghqf5": Line("GHQF, 5 points", "#B15928"), "ekf": Line("EKF", "#D55E00"),
    "triad-ekf": Line("EKF started by Wahba", "#000000"),
}  # fmt: skip
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
    for column, (part, title) in enumerate((p, title) for p in ("A-slow", "T3") for title in ("first minute", "whole flight")):
        t = results.times(part)
        for i, ax in enumerate(axes[:, column]):
            for name in COMPARED:
                errors(ax, results, part, name, LINES[name], group, i)
            sigma(ax, results, part, "sghqf", "SGHQF", group, i)
            if title == "whole flight":
                error, std = (results.error(part, "sghqf", group, what)[:, 0, i] for what in ("error", "std"))
                late = 3.0 * np.abs(error[len(t) // 10 :]).max() + 9.0 * std[-1]
                ax.set_ylim(-late, late)
            ax.set_xlim(0.0, t[-1] if title == "whole flight" else min(60.0, t[-1]))
            axes[i, 0].set_ylabel(f"{study.SEVEN[first + i]} error ({results.group(group).unit})")
        axes[0, column].set_title(f"{part}, {title}")
        axes[-1, column].set_xlabel("time (s)")
    fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return fig


def against_bound(results: Results) -> Figure:
    """RMSE of the misalignment over the runs, and of the closed solution that starts an EKF."""
    fig, axes = figure(9.0, 3.0, 1, 3, sharey=True)
    for ax, part in zip(axes, ("A", "A-slow", "T3")):
        for name in (*COMPARED, "nonlinear", "triad-ekf"):
            rmse(ax, results, part, name, LINES[name], "misalignment")
        ax.set(title=part, xlabel="time (s)")
    best = np.sqrt(results.get("bound", "square")[:, 0])
    axes[0].semilogy(results.times("A"), best, color=colors.BOUND, linewidth=2.5, zorder=0, label="Cramér–Rao bound")
    axes[0].set_ylabel("misalignment, RMSE over the runs (deg)")
    axes[0].legend()
    return fig


def consistent(results: Results) -> Figure:
    """Consistency over time."""
    fig, axes = figure(9.0, 3.0, 1, 3, sharey=True)
    for ax, part in zip(axes, ("A", "A-slow", "T3")):
        consistency(ax, results, part, {name: LINES[name] for name in study.FLOWN[part]}, "nees", 13)
        ax.set(title=part, xlabel="time (s)")
    axes[0].set_ylabel("NEES, mean over the runs (-)")
    fig.legend(*axes[1].get_legend_handles_labels(), loc="outside right center")
    return fig


def first_fix(results: Results) -> Figure:
    """The first star fix; from 45 deg on some draws lie beyond the chart of the angles, where Wahba's takes another branch."""
    fig, axes = figure(9.0, 3.4, 1, 2)
    for name in study.START:
        look: dict[str, Any] = {"color": LINES[name].color, "linestyle": LINES[name].style, "marker": "."}
        after = [results.nees(f"start/{angle:g}", name, 0).mean() for angle in MISALIGNMENTS_DEG]
        axes[0].loglog(MISALIGNMENTS_DEG, after, **look, label=LINES[name].label)
        if name != "triad-ekf":
            least = results.get("fixes", f"{name}/least")
            axes[1].loglog(MISALIGNMENTS_DEG, np.where(least > 0.0, least, np.nan), **look)
    exact = results.get("fixes", "exact/least")
    axes[1].loglog(MISALIGNMENTS_DEG, exact, color=colors.SIGMA, linewidth=2.5, zorder=0, label="exact moments")
    axes[0].axhline(13.0, color=colors.SIGMA, linestyle=":")
    axes[0].set(xlabel="misalignment, 1σ of each angle (deg)", ylabel="NEES after the first star fix (-)")
    axes[1].set(xlabel="misalignment, 1σ of each angle (deg)", ylabel="least variance of the misalignment,\nposterior to prior (-)")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    axes[1].legend()
    return fig


def growth(_: Results) -> Figure:
    """How points and weights grow with the dimension."""
    fig, axes = figure(7.0, 3.0, 1, 2)
    for level, n, color in ((3, (2, 4, 7, 13, 20, 40), colors.COMPARISON), (4, (2, 4, 7, 13, 20, 30), colors.ESTIMATE)):
        weights = [smolyak(k, level).wm for k in n]
        axes[0].loglog(n, [len(w) for w in weights], color=color, marker="o", label=f"level {level}")
        axes[1].loglog(n, [np.abs(w).sum() for w in weights], color=color, marker="o")
    axes[0].set(xlabel="dimension n (-)", ylabel="points (-)")
    axes[1].set(xlabel="dimension n (-)", ylabel="sum of |weights|: amplification of noise (-)")
    axes[0].legend()
    return fig


def moments(results: Results) -> Figure:
    """Errors of the mean and covariance of the star residuals at 10 deg, by rule."""
    fig, ax = figure(7.0, 3.6)
    names = ("ukf", "ckf", "aasghqf", "ckf5", "delayed", "ghqf3", "sghqf", "nonlinear")
    for what, color, shift in (("mean", colors.TRUTH, -0.2), ("cov", colors.ESTIMATE, 0.2)):
        heights = [results.value("fixes", f"{name}/{what}", study.ONE) for name in names]
        ax.bar(np.arange(len(names)) + shift, heights, 0.4, color=color, label={"cov": "covariance"}.get(what, what))
    ax.set_xticks(range(len(names)), [LINES[name].label for name in names], rotation=30, ha="right")
    ax.set(yscale="log", ylabel="relative error at 10° (-)", title="moments of the star residuals")
    ax.legend()
    return fig


def quantiles(results: Results) -> Figure:
    """The runs behind Table 3: quantiles of the misalignment error at T3."""
    fig, axes = figure(9.0, 3.0, 1, 3, sharey=True)
    for ax, name in zip(axes, COMPARED):
        size = np.linalg.norm(results.error("T3", name, "misalignment"), axis=-1)
        low, middle, high = np.quantile(size, [0.05, 0.5, 0.95], axis=1)
        band(ax, results.times("T3"), low, high, color=LINES[name].color, label="5-95 % of the runs")
        ax.semilogy(results.times("T3"), middle, color=LINES[name].color, label="median")
        ax.set(title=LINES[name].label, xlabel="time (s)", ylim=(1e-3, 100.0))
        ax.legend()
    axes[0].set_ylabel("misalignment error, 3-D (deg)")
    return fig


FIGURES = {
    "figure_01": ("Fig. 1: points of the isotropic rule, n = 2, level 3.", partial(points, (1, 1), "level 3: 21 points")),
    "figure_02": ("Fig. 2: points of the rule with weights 2, 1.", partial(points, (2, 1), "weights 2, 1, level 3: 9 points")),
    "figure_03": ("Fig. 3: misalignment errors of one run, presets A-slow and T3.", partial(one_run, "misalignment", 0, 3)),
    "figure_04": ("Fig. 4: velocity errors of one run.", partial(one_run, "velocity", 3, 2)),
    "figure_05": ("Fig. 5: position errors of one run.", partial(one_run, "position", 5, 2)),
    "figure_06": ("Beyond the paper: RMSE of the misalignment, and of an EKF started by a closed solution.", against_bound),
    "figure_07": ("Beyond the paper: consistency over time.", consistent),
    "figure_08": ("Beyond the paper: the first star fix over the size of the misalignment.", first_fix),
    "figure_09": ("Beyond the paper: how points and weights grow with the dimension.", growth),
    "figure_10": ("Beyond the paper: errors of the moments of the first star fix, by rule.", moments),
    "figure_11": ("Beyond the paper: the runs behind Table 3, quantiles of the misalignment error at T3.", quantiles),
}


# -- tables ------------------------------------------------------------------------------------------------------------------
def table_1(_: Results) -> list[Row]:
    """Points of the sparse grids, n = 1 to 6."""
    rows = [(f, g) for n, own in enumerate(study.WEIGHTS, 1) for f, g in (("SGHQF", (1,) * n), ("AASGHQF", own))]
    return [{"n": (n := len(g)), "filter": f, "weights": "".join(map(str, g)), "paper": TABLE_1[f][n - 1],
             "ours": point_count(n, 3, g)} for f, g in rows]  # fmt: skip


def table_2(results: Results) -> list[Row]:
    """Degree of observability and weight of each state, ours in two units, and weights by nonlinearity."""
    columns: dict[str, Any] = {"degree, paper": TABLE_2, "weight, paper": PAPER_WEIGHTS}
    for unit, degree in (("rad", results.get("observability", "every")[0]), ("deg", results.get("observability", "in degrees"))):
        columns |= {f"degree (phi in {unit})": degree, f"weight (phi in {unit})": threshold_weights(degree, study.THRESHOLD)}
    columns["weight by nonlinearity"] = NONLINEAR_WEIGHTS
    return [{"state": s} | {name: float(column[i]) for name, column in columns.items()} for i, s in enumerate(inertial.STATES)]


def table_3(results: Results) -> list[Row]:
    """RMSE over the runs, averaged over the epochs, of the first seven states."""
    rows: list[Row] = []
    for f, printed in TABLE_3.items():
        ours = {f"ours, {p}": np.sqrt(np.square(results.get(p, f"{f.lower()}/error")[..., :7]).mean(1)).mean(0) for p in PRESETS}
        for source, values in {"paper": np.array(printed), **ours}.items():
            rows.append({"filter": f, "source": source, **dict(zip(COLUMNS, values.tolist()))})
    return rows


def table_4(results: Results) -> list[Row]:
    """Points, and CPU time of a cycle, on the machine at hand: the least of all rounds."""
    alone, among = ({f: float(results.get("timings", f"{f.lower()}, {runs}").min()) for f in TABLE_4} for runs in (1, 50))
    return [{"filter": f, "points, paper": TABLE_4[f][0], "points, ours": point_count(13, n, g), "cycle, paper (s)": TABLE_4[f][1],
             "one run alone (s)": alone[f], "one run among 50 (s)": among[f]} for f, n, g in study.POINTS]  # fmt: skip


TABLES = {
    "table_1": ("Table 1: points of the sparse grids, n = 1 to 6, level 3.", table_1),
    "table_2": ("Table 2: degree of observability and weight of each state.", table_2),
    "table_3": ("Table 3: RMSE over the runs, averaged over the epochs, of the first seven states.", table_3),
    "table_4": ("Table 4: points, and CPU time of a cycle.", table_4),
}


# -- recordings --------------------------------------------------------------------------------------------------------------
CASES = {"A-slow": "aasghqf_A_slow.rrd", "T3": "aasghqf_T3.rrd"}
RECORDINGS = list(CASES.values())
AXES = {"misalignment": "xyz", "velocity": ("east", "north"), "position": ("longitude", "latitude")}
TRAILS = ("world/aircraft/trail", "world/inertial/trail")
SPACES = (Space("world", "flight, m (east, north, up)", (60e3, -70e3, 70e3), (90e3, 20e3, 0.0), growing=TRAILS),
          *(Space(f"points/{f}", f"sigma points of {LINES[f].label}, σ of SGHQF", (9.0, -9.0, 6.0)) for f in COMPARED))  # fmt: skip
LEGEND = {colors.MEASUREMENT: "fixes by radar, stars where the system expects them", colors.STAR: "stars where they are",
          colors.SIGMA: "inertial system", colors.NEGATIVE: "points of negative weight"}  # fmt: skip
NOTES = """# Liang et al. (2014), preset {}

**The UKF's first star fix leaves it overconfident, and it takes minutes to forget; 57 points are as good as 417.**

An aircraft turns; its inertial system starts with a large misalignment and drifts away while star sensors and SAR fixes let filters
estimate its error. Left above: the flight, and the sigma points of the misalignment about the truth."""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    return write({name: showcase(results, part) for part, name in CASES.items()}, outputs)


def showcase(results: Results, part: str) -> Showcase:
    """The first run of a part, flown again in full, among the others."""
    c, (found, truth, z) = results.parts[part].config, again(results, part, {f: LINES[f] for f in ("sghqf", "ukf", "aasghqf")})
    axes = np.diag(c.meters)[[0, 1, 1]] * [[1.0], [1.0], [0.0]]  # east, north, up of a place on the ground
    fix = (z[:, 6:] - truth[:, inertial.POSITION]) @ axes.T

    def scene(out: Recorder) -> None:
        flight, at = c.flight, 2 * np.arange(len(truth))
        way = np.stack([flight.longitude - flight.longitude[0], flight.latitude - flight.latitude[0]], -1)[at]
        computed = inertial.misalignment_matrix(truth[:, inertial.PHI]) @ flight.attitude[at]
        scenes.flight(out, "world", way @ axes.T, (way + truth[:, inertial.POSITION]) @ axes.T, np.isfinite(fix[:, 0]),
                      25000.0 * flight.attitude[at] @ BORESIGHTS.T, 25000.0 * computed @ BORESIGHTS.T)  # fmt: skip
        std = np.sqrt(np.asarray(found["sghqf"].cov).diagonal(0, -2, -1))[:, None, :3]
        for name, e in found.items():
            rule, moved = rules()[name], rules()[name].nodes[:, :3].any(-1)
            places = e.errors[:, 0, None] + matvec(semidefinite_root(np.asarray(e.cov))[:, None], rule.nodes[moved])
            scenes.sigma_points(out, f"points/{name}", places[..., :3] / std, rule.wm[moved], e.color)

    groups = [Group(g.name, g.unit, g.part, g.scale, AXES[g.name]) for g in GROUPS if g.name in AXES]
    return Showcase(
        f"aasghqf: {part}", NOTES.format(part), results.times(part), found, groups, truth,
        np.concatenate([np.zeros((3, 5)), axes, np.zeros((3, 6))], 1), "m", fix, scene=scene, spaces=SPACES, legend=LEGEND,
        bars={"degree of observability by state": results.get("observability", "every")[0]}, parameters=vars(c),
        facts={"paper": "aasghqf", "preset": part, "seed": results.seed, "runs": found["ukf"].errors.shape[1]},
    )  # fmt: skip
