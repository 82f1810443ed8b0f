"""Figures, tables and recordings of [Liang2014] with the paper's numbers, and figures beyond it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from celnav.analysis.observability import threshold_weights
from celnav.gaussian.linalg import matvec, semidefinite_root
from celnav.gaussian.sparse_grid import point_count, smolyak
from celnav.models import misalignment
from celnav.papers.aasghqf import study
from celnav.papers.aasghqf.scenario import (
    BORESIGHTS,
    NONLINEAR_WEIGHTS,
    PAPER_WEIGHTS,
    PRESETS,
    rules,
)
from celnav.papers.aasghqf.study import (
    COMPARED,
    MISALIGNMENTS_DEG,
    TABLE_2,
    TABLE_3,
    TABLE_4,
)
from celnav.show import colors, scenes
from celnav.show.draw import STYLES, Item, Line, Panel, curve, panels
from celnav.show.estimates import estimates_of, sensor_states
from celnav.show.figures import consistency, errors, rmse, sigma
from celnav.show.showcase import SceneView, Showcase, write
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

__all__ = ["FIGURES", "RECORDINGS", "TABLES", "record", "showcase"]

LINES = {
    "sghqf": Line("SGHQF, 417", colors.ESTIMATE, width=2.2),
    "ukf": Line("UKF, 27", colors.COMPARISON, STYLES[4]),
    "aasghqf": Line("AASGHQF, 75", colors.OPEN_LOOP, "--", 1.4),
    "nonlinear": Line("by nonlinearity, 57", colors.TRUTH, ":", 1.8),
    "triad-ekf": Line("EKF from Wahba's solution", "black", "-."),
    "ghqf3": Line("GHQF, 3 points an axis", colors.REFERENCE, "-."),
    "ghqf5": Line("GHQF, 5 points an axis", colors.FAINT, STYLES[5]),
}
AXES = {"misalignment": "xyz", "velocity": ("east", "north"), "position": ("longitude", "latitude")}
PAPER_LINES = {f: LINES[f] for f in ("sghqf", "ukf", "aasghqf")}
SPAN = {"xlim": (1.0, 500.0)}


# -- figures ---------------------------------------------------------------------------------------
def points(number: int, weights: tuple[int, int], _: Results) -> Figure:
    """Points of a rule in two dimensions: area shows the weight's magnitude, color its sign."""
    rule = smolyak(2, 3, weights)
    shades = np.where(rule.wm > 0.0, colors.COMPARISON, colors.PAPER)

    def dots(ax: Axes) -> None:
        size = 3.0 + 125.0 * np.sqrt(np.abs(rule.wm))
        x, y = rule.nodes.T
        ax.scatter(x, y, size, shades.tolist(), alpha=0.8)

    square = Panel(
        "blue: positive weights; orange: negative",
        [dots],
        "$x_1$ (-)",
        "$x_2$ (-)",
        more={"xlim": (-4.2, 4.2), "ylim": (-4.2, 4.2), "aspect": "equal"},
    )
    title = f"Figure {number}: {rule.num_sigmas()} points, weights {weights}"
    return panels(square, height=3.0, title=title)


def one_run(
    title: str, part: str, group: str, end: float, scale: float, results: Results
) -> Figure:
    """Errors of the first run in each state of a group until ``end`` seconds; ``scale``: the y
    limit, in late standard deviations."""
    judged = results.group(group)
    rows = []
    for i, state in enumerate(study.SEVEN[judged.part]):
        limit = scale * results.error(part, "sghqf", group, "std")[-30:, 0, i].max()
        items = [
            errors(results, part, f, line, group, i, label=line.label)
            for f, line in PAPER_LINES.items()
        ]
        items.append(sigma(results, part, "sghqf", "SGHQF", group, i))
        rows.append(
            Panel(
                state,
                items,
                "time (s)",
                f"error ({judged.unit})",
                more={"xlim": (0.0, end), "ylim": (-limit, limit)},
            )
        )
    return panels(*rows, height=1.6, title=title, sharex=True)


def angles(results: Results, part: str, lines: Mapping[str, Line]) -> list[Item]:
    """RMSE of the misalignment over the runs, by filter."""
    return [rmse(results, part, f, line, "misalignment") for f, line in lines.items()]


def over_time(results: Results) -> Figure:
    """RMSE of the misalignment over the runs, with an EKF from Wahba's closed solution, and
    NEES."""
    lines = {f: LINES[f] for f in study.FLOWN}
    parts = study.SHOWN
    best = curve(
        results.times("A"),
        np.sqrt(results.get("bound", "square")[:, 0]),
        Line("Cramér–Rao bound", colors.BOUND, width=4.0),
        zorder=0,
    )
    return panels(
        [
            Panel(
                p,
                [*angles(results, p, lines), *[best] * (p == "A")],
                "",
                "misalignment, RMSE (deg)",
                "xy",
                SPAN,
            )
            for p in parts
        ],
        [
            Panel(
                "",
                [consistency(results, p, lines, "nees", 13)],
                "time (s)",
                "NEES, mean (-)",
                "xy",
                SPAN,
            )
            for p in parts
        ],
        title="Figure 6 (not in the paper): errors and consistency",
        sharex=True,
        sharey="row",
    )


def first_fix(results: Results) -> Figure:
    """The first star fix with each rule, compared with exact moments: why the filters differ."""
    titles = {
        "least": "smallest variance after the fix, over the correct one",
        "mean": "mean of the residuals, relative error",
        "cov": "covariance of the residuals, relative error",
    }
    x = "misalignment, 1σ of each angle (deg)"
    return panels(
        *(
            Panel(
                title,
                [
                    curve(MISALIGNMENTS_DEG, results.get("fixes", f"{f}/{what}"), line, marker=".")
                    for f, line in LINES.items()
                    if f in rules()
                ],
                x,
                "ratio (-)",
                "xy",
            )
            for what, title in titles.items()
        ),
        height=1.7,
        title="Figure 7 (not in the paper): the first star fix",
        sharex=True,
    )


def along(results: Results) -> Figure:
    """Degrees of observability of the misalignment on both flights; points and errors of filters
    that choose their weights online."""
    slow = "A-slow, on line"
    shades = ("black", colors.MEASUREMENT, colors.REFERENCE)
    t = results.times(slow)
    whole = results.parts["along"].config.times
    lines = {
        "weighed": Line("by observability", colors.PAPER, "-."),
        "bends": Line("by nonlinearity", colors.TRUTH, ":", 1.8),
    }
    return panels(
        [
            Panel(
                title,
                [
                    curve(whole, values, Line(name, shade, style))
                    for values, name, shade, style in zip(degrees.T, study.SEVEN, shades, STYLES)
                ],
                "time (s)",
                "degree of observability (-)",
                more={"xlim": (0.0, 500.0), "ylim": (0.0, 20.0)},
            )
            for title, degrees in zip(
                ("the paper's flight", "flight turning at 2 deg/s"), results.get("along", "degrees")
            )
        ],
        [
            Panel(
                "A-slow: points, mean of the runs",
                [
                    curve(t, results.get(slow, f"{f}/points").mean(1), line)
                    for f, line in lines.items()
                ],
                "time (s)",
                "points (-)",
                "x",
                SPAN,
            ),
            Panel(
                "A-slow: misalignment errors",
                angles(results, "A-slow", PAPER_LINES) + angles(results, slow, lines),
                "time (s)",
                "RMSE (deg)",
                "xy",
                SPAN,
            ),
        ],
        title="Figure 8 (not in the paper): weights chosen online",
    )


FIGURES = {
    "figure_01": (
        "Fig. 1: points of the isotropic grid, n = 2, level 3.",
        partial(points, 1, (1, 1)),
    ),
    "figure_02": (
        "Fig. 2: points of the grid with weights (2, 1).",
        partial(points, 2, (2, 1)),
    ),
    **{
        f"figure_{i:02d}": (
            f"Fig. {i}: {group} errors of one run of T3, and ±3σ that SGHQF predicts. Numbers in "
            "the legend: sigma points.",
            partial(
                one_run, f"Figure {i}: {group} errors of one run (T3)", "T3", group, 500.0, 6.0
            ),
        )
        for i, group in enumerate(AXES, 3)
    },
    "figure_06": (
        "Beyond the paper: RMSE of the misalignment, and NEES (13 if consistent), from 1 s on.",
        over_time,
    ),
    "figure_07": (
        "Beyond the paper: the first star fix, by rule and misalignment. Numbers: points.",
        first_fix,
    ),
    "figure_08": (
        "Beyond the paper: degrees of observability; weights chosen online (57 points at time 0).",
        along,
    ),
    "figure_09": (
        "Beyond the paper: misalignment errors of one run with slower fixes (A-slow).",
        partial(
            one_run,
            "Figure 9 (not in the paper): misalignment errors of one run (A-slow)",
            "A-slow",
            "misalignment",
            500.0,
            12.0,
        ),
    ),
    "figure_10": (
        "Beyond the paper: misalignment errors of the run of Figure 3 in its first minute.",
        partial(
            one_run,
            "Figure 10 (not in the paper): misalignment errors, first minute of T3",
            "T3",
            "misalignment",
            60.0,
            95.0,
        ),
    ),
}


# -- tables ----------------------------------------------------------------------------------------
COLUMNS = (
    "phi_x_deg",
    "phi_y_deg",
    "phi_z_deg",
    "v_east_m_per_s",
    "v_north_m_per_s",
    "longitude_m",
    "latitude_m",
)
TABLES = {
    "table_1": ("Table 1: points of the sparse grids, n = 1 to 6, level 3.", study.table_1),
    "table_2": (
        "Table 2: degree of observability and weight of each state.",
        lambda r: [
            {"state": state, "degree, paper": TABLE_2[i], "weight, paper": PAPER_WEIGHTS[i]}
            | {
                f"{what} (phi in {unit})": float(values[i])
                for unit, degrees in zip(("rad", "deg"), r.get("observability", "every")[:2, 0])
                for what, values in (
                    ("degree", degrees),
                    ("weight", threshold_weights(degrees, study.THRESHOLD)),
                )
            }
            | {"weight by nonlinearity": NONLINEAR_WEIGHTS[i]}
            for i, state in enumerate(misalignment.STATES)
        ],
    ),
    "table_3": (
        "Table 3: RMSE of the first seven states over the runs, averaged over the epochs.",
        lambda r: [
            {"filter": f, "source": source, **dict(zip(COLUMNS, map(float, values)))}
            for f, printed in TABLE_3.items()
            for source, values in (
                ("paper", printed),
                *(
                    (
                        f"ours, {p}",
                        np.sqrt(np.square(r.get(p, f"{f.lower()}/error")[..., :7]).mean(1)).mean(0),
                    )
                    for p in PRESETS
                ),
            )
        ],
    ),
    "table_4": (
        "Table 4: points, and arithmetic operations per cycle (for SGHQF a lower bound).",
        lambda r: [
            {
                "filter": f,
                "points, paper": TABLE_4[f][0],
                "points, ours": point_count(13, n, g),
                "cycle, paper (s)": TABLE_4[f][1],
                "operations": int(r.get("operations", f.lower())[0]),
            }
            for f, n, g in study.POINTS
        ],
    ),
}


# -- recordings ------------------------------------------------------------------------------------
CASES = {"A-slow": "aasghqf_A_slow.rrd", "T3": "aasghqf_T3.rrd"}
RECORDINGS = list(CASES.values())
NOTES = """# Liang et al. (2014), preset {}

**The first star fix makes the UKF overconfident for minutes. AASGHQF, with 75 points, is less \
accurate than SGHQF, with 417, in one angle.**

An aircraft turns. Its inertial system starts with a large misalignment and drifts away. Filters \
estimate its errors from star sensors
and SAR fixes. Top left: the flight, and the sigma points of the misalignment about the truth. \
The statements above hold over all runs."""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    return write({name: showcase(results, part) for part, name in CASES.items()}, outputs)


def showcase(results: Results, part: str) -> Showcase:
    """The first run of a part, run again in full; the other runs give the statistics."""
    c = results.parts[part].config
    estimates, truth, z = estimates_of(results, part, {f: LINES[f] for f in COMPARED})
    ground = np.diag(c.meters()) @ np.eye(2, 3)  # from longitude and latitude to east, north, up
    axes = np.zeros((3, 13))
    fix = (z[:, 6:] - truth[:, misalignment.POSITION]) @ ground
    axes[:, misalignment.POSITION] = ground.T

    def scene(out: Recorder) -> None:
        flight = c.flight
        way = np.stack([flight.longitude, flight.latitude], -1)[::2]
        way -= way[0]
        stars = 25000.0 * flight.attitude[::2] @ BORESIGHTS.T
        scenes.flight(
            out,
            "world",
            way @ ground,
            (way + truth[:, misalignment.POSITION]) @ ground,
            np.isfinite(fix[:, 0]),
            stars,
            misalignment.misalignment_matrix(truth[:, misalignment.PHI]) @ stars,
        )
        std = np.sqrt(np.asarray(estimates["sghqf"].cov).diagonal(0, -2, -1))[:, None, :3]
        for name, e in estimates.items():
            rule = rules()[name]
            moved = rule.nodes[:, :3].any(-1)
            places = e.errors[:, 0, None] + matvec(
                semidefinite_root(np.asarray(e.cov))[:, None], rule.nodes[moved]
            )
            scenes.sigma_points(
                out, f"points/{name}", places[..., :3] / std, rule.wm[moved], e.color
            )

    spaces = [
        SceneView(
            "world",
            "flight, m (east, north, up)",
            (60e3, -70e3, 70e3),
            (90e3, 20e3, 0.0),
            growing=("world/aircraft/trail", "world/inertial/trail"),
        ),
        *(
            SceneView(f"points/{f}", f"sigma points of {LINES[f].label}, σ of SGHQF", (9, -9, 6))
            for f in COMPARED
        ),
    ]
    return Showcase(
        f"aasghqf: {part}",
        NOTES.format(part),
        results.times(part),
        estimates,
        [g._replace(axes=AXES[g.name]) for g in results.study.groups if g.name in AXES],
        truth,
        axes,
        "m",
        fix,
        scene=scene,
        spaces=spaces,
        legend={
            colors.MEASUREMENT: "radar fixes, star directions that the system expects",
            colors.STAR: "true star directions",
            colors.SIGMA: "inertial system",
            colors.NEGATIVE: "points with negative weight",
        },
        states=sensor_states(results, part, "ukf", stars=6, SAR=2),
        start=0.5 * results.times(part)[-1],
        bars={"degree of observability by state": results.get("observability", "every")[0, 0]},
        parameters=vars(c),
        facts={"paper": "aasghqf", "preset": part, "seed": results.seed},
    )
