"""Figures and tables with the numbers of [Sun2015], further ones, and recordings."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.filters.run import run
from celnav.gaussian.linalg import Array
from celnav.models import sightings
from celnav.models.orbit import EARTH
from celnav.papers.csrukf.method import FORMS
from celnav.papers.csrukf.scenario import filters, simulate
from celnav.papers.csrukf.study import (
    BOTH,
    COLORS,
    HELD,
    PHIS,
    RATIOS,
    SWEEP,
    TABLE_1,
    TABLE_2,
    TABLE_3,
)
from celnav.show import colors, scenes, showcase
from celnav.show.draw import (
    Item,
    Line,
    Panel,
    curve,
    level,
    look,
    panels,
)
from celnav.show.estimates import estimates_of
from celnav.show.figures import consistency, errors, rmse, rmse_table, sigma
from celnav.show.plots import Curve, Plot
from celnav.study.montecarlo import generator
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

__all__ = ["FIGURES", "RECORDINGS", "TABLES", "record"]

SRUKF = Line("SRUKF", colors.COMPARISON, (0, (8, 2)))
CSRUKF = Line("CSRUKF", colors.ESTIMATE)
OPEN = Line("open loop", colors.OPEN_LOOP, "-.")
LINES = {"srukf": SRUKF, "csrukf": CSRUKF}
BOUND = Line("CSRUKF with the first sample", colors.REFERENCE, ":")
AXES = ("x", "y", "z", "v_x", "v_y", "v_z")
TIME = "time (s)"
RATIO = "σ of the prior over σ of a measurement (-)"
SPAN = {"xlim": (0.0, 600.0)}
QUANTITIES = [f"|error of ${a}$| (km)" for a in AXES[:3]] + [
    f"velocity error ${a}$ (m/s)" for a in AXES[3:]
]
COLUMNS = ("x_km", "y_km", "z_km", "vx_m_per_s", "vy_m_per_s", "vz_m_per_s")


# -- figures ---------------------------------------------------------------------------------------
def geometry(r: Results) -> Figure:
    """Two stars, the Earth's limb, and the three angles."""
    c = r.parts["0"].config
    path = c.nominal()[:, :3]
    here = path[0]
    stars = sightings.star_directions(c.separation)
    edges = sightings.limb(here, np.cross(here, [0.0, 0.0, 1.0])) - here
    u, v = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
    globe = EARTH.radius_km * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    star_1, star_2, limb_1, limb_2, up = scenes.unit(np.array([*stars, *edges, here]))
    arcs = 2500.0 * scenes.arc(np.array([star_1, star_2, limb_1]), np.array([up, up, limb_2]))
    degrees = np.degrees(sightings.angles(here, stars))

    def draw(ax: Any) -> None:
        def line(points: Any, text: str, end: Any, color: str, style: str = "-") -> None:
            """Points, and a label that is centered at ``end``, relative to the satellite."""
            ax.plot(*(here + points).T, color=color, linestyle=style, linewidth=1.6)
            ax.text(*(here + end), text, color=color, ha="center", va="center")

        reach, names = np.array([[0.0], [1.0]]), ("limb", "limb", "star 1", "star 2")
        ax.plot_surface(*globe, color="white", edgecolor=colors.BODY, linewidth=0.4, shade=False)
        line(path - here, "orbit, 600 s", 1.3 * (path[-1] - here), colors.TRUTH)
        line((1.6 * reach - 1.0) * here, "position vector", 0.8 * here, colors.SIGMA, ":")
        for name, ray in zip(names, [*edges, *6000.0 * stars], strict=True):
            line(reach * ray, name, 1.2 * ray, colors.COMPARISON, "--")
        for i, (arc, angle) in enumerate(zip(arcs, degrees, strict=True), 1):
            line(arc, f"$A_{i}$ = {angle:.0f}°", 2.1 * arc[5], colors.PAPER)
        ax.set_aspect("equal")
        ax.set_axis_off()
        ax.view_init(65, 0)
        ax.set_box_aspect(None, zoom=1.7)

    look = {"projection": "3d", "computed_zorder": False}
    title = "Figure 1: the three measured angles"
    return panels(Panel("", [draw]), title=title, height=3.8, subplot_kw=look)


def component(
    r: Results, part: str, i: int, lines: dict[str, Line], shown: str = "", **look: Any
) -> list[Item]:
    """Errors of one of the six components, for positions without sign as in the paper, and 3 sigma
    of the filter ``shown``."""
    at: Any = (BOTH[i // 3], i % 3)
    items = [
        errors(r, part, name, line, *at, absolute=i < 3, **look) for name, line in lines.items()
    ]
    if shown:
        items.append(sigma(r, part, shown, lines[shown].label, *at, absolute=i < 3))
    return items


def printed(table: dict[str, list[float]], i: int) -> Item:
    """The printed RMSE of a component, for both filters; of velocities with both signs."""
    levels = [sign * row[i] for row in table.values() for sign in (1.0, -1.0)[: 1 + i // 3]]
    return level(*levels, label="printed RMSE", color=colors.PAPER, style="--")


def white(i: int, r: Results) -> Figure:
    """Error of a component under white noise: of all runs, and in detail of the first."""
    many = component(r, "0", i, {"csrukf": CSRUKF}, "csrukf", runs=(1, 4)[i // 3], spread=True)
    minute = []
    for name, line in {
        "srukf": SRUKF._replace(style="-", width=3.0),
        "csrukf": CSRUKF,
        "lagged": Line("as printed", colors.PAPER, "-."),
    }.items():
        t = r.times("0") - (name == "lagged")  # whose estimate is of the epoch before
        error = r.error("0", name, BOTH[i // 3])[:, 0, i % 3]
        error = np.abs(error) if i < 3 else error
        minute.append(curve(t[-61:], error[-61:], line, label=f"{line.label}, run 1"))
    limits = (0.0, 0.2) if i < 3 else None
    panel = partial(Panel, x=TIME, y=QUANTITIES[i])
    return panels(
        [
            panel("CSRUKF, all runs", [*many, printed(TABLE_1, i)], more={**SPAN, "ylim": limits}),
            panel("Run 1, last minute", minute, more={"xlim": (540.0, 600.0)}),
        ],
        title=f"Figure {i + 2}: error of ${AXES[i]}$ in white noise ($\\Phi = 0$)",
        height=2.5,
    )


def walk(i: int, r: Results) -> Figure:
    """Error of a component under random-walk noise."""
    both = component(r, "I", i, LINES, "srukf", runs=4, spread=True)
    loop = component(r, "I", i, {"openloop": OPEN})
    one = component(r, "I", i, {"csrukf": CSRUKF}, "csrukf", runs=4, spread=True)
    titles = {"SRUKF and CSRUKF": [*both, printed(TABLE_2, i)], "CSRUKF and open loop": one + loop}
    return panels(
        [Panel(title, items, TIME, QUANTITIES[i], more=SPAN) for title, items in titles.items()],
        title=f"Figure {i + 8}: error of ${AXES[i]}$ under a random walk ($\\Phi = I$)",
        height=2.5,
    )


def consistent(r: Results) -> Figure:
    """NEES of both filters, that of CSRUKF in detail, and NIS, with their 95 % ranges."""
    rows = [
        [
            Panel(
                f"$\\Phi = {n}$",
                [consistency(r, n, lines, what, dof)],
                TIME,
                f"mean {what.upper()} (-)",
                log,
                SPAN,
            )
            for n in PHIS
        ]
        for what, dof, lines, log in (
            ("nees", 6, LINES, "y"),
            ("nees", 6, {"csrukf": CSRUKF}, ""),
            ("nis", 3, LINES, "y"),
        )
    ]
    title = "Figure 14 (not in the paper): consistency; second row: the CSRUKF in detail"
    return panels(*rows, title=title, height=1.8, sharex=True, sharey="row")


def length(std: Array) -> Array:
    """3-D length of the position part of standard deviations ``(..., 6)``."""
    return np.asarray(np.linalg.norm(std[..., :3], axis=-1))


def against_theory(r: Results) -> Figure:
    """RMSE of the runs and exact linear theory."""
    rows = []
    for name, phi in PHIS.items():
        items = list[Item]()
        for (filter, line), marker in zip(LINES.items(), "os", strict=True):
            items.append(rmse(r, name, filter, line, "position"))
            std = length(r.get("theory", f"P/{filter}")[:, SWEEP.index(phi)])
            theory = Line(f"{line.label}, theory", line.color, "none")
            items.append(
                curve(r.times(name), std, theory, marker=marker, markevery=60, fillstyle="none")
            )
        rows.append(Panel(f"$\\Phi = {name}$", items, TIME, "RMSE (km)", "y", SPAN))
    title = "Figure 15 (not in the paper): the position RMSE follows linear theory"
    return panels(*rows, title=title, height=1.6, sharex=True)


def over_phi(r: Results) -> Figure:
    """Final position error over Phi by linear theory, for the fitted prior and a poor one, by the
    quantity that is held fixed."""
    rows = []
    for held in ("", *HELD):
        ticks = [f"{phi:g}".replace("0.", ".") for phi in (COLORS if held else SWEEP)]
        row = []
        for preset, prior in (("P", "0.15 km, 0.035 m/s"), ("D", "10 km, 10 m/s")):
            items = []
            for name, line, marker in (
                ("srukf", SRUKF, "o"),
                ("csrukf", CSRUKF, "s"),
                ("csrukf+z0", BOUND, "^"),
            ):
                std = length(r.get("theory", f"{held}/{preset}/{name}".lstrip("/"))[-1])
                items.append(curve(ticks, std, line, marker=marker, markersize=4))
            title = f"Fixed {held or 'increments'}\nprior {prior}"
            row.append(
                Panel(title, items, "φ of $\\Phi = \\varphi I$ (-)", "final error (km)", "y")
            )
        rows.append(row)
    return panels(
        *rows, title="Figure 16 (not in the paper): final error over φ by linear theory", height=2.1
    )


def long_arcs(r: Results) -> Figure:
    """Long arcs from a poor prior: SRUKF and the bound."""
    row = []
    for i, name in enumerate(("I", "0.8 I")):
        items = []
        for key, line in (("srukf", SRUKF), ("csrukf+z0", BOUND._replace(label="bound"))):
            std = length(r.get("theory", f"long/{key}")[1:, i])
            items.append(curve(np.arange(1, len(std) + 1), std, line))
        row.append(Panel(f"$\\Phi = {name}$", items, TIME, "3-D position error (km)", "xy"))
    title = "Figure 17 (not in the paper): long arcs from a prior of 100 km and 100 m/s"
    return panels(row, title=title, height=2.6, sharey=True)


def assumed(r: Results) -> Figure:
    """Error and consistency of a filter with a wrong coefficient."""
    cases = {
        "I": (look(1), (2, 3, 4), ("phi 0.95", "phi 0.99", "csrukf")),
        "0.8": (look(0), (0, 1, 4), ("csrukf", "phi 0.9", "phi 1")),
    }
    ticks = {"xticks": range(5), "xticklabels": [0.8, 0.9, 0.95, 0.99, 1]}
    row = list[Panel]()
    for y in ("final position RMSE (km)", "time-mean NEES (-)"):
        items = [level(6.0, label="consistent: 6")] if row else []
        for part, (style, place, names) in cases.items():
            values = [
                r.nees(part, name, slice(1, None)).mean()
                if row
                else np.sqrt(r.squares(part, name, "position").sum(-1).mean())
                for name in names
            ]
            true = {"markevery": [names.index("csrukf")], "markersize": 9, "fillstyle": "none"}
            label = f"true φ = {PHIS[part]:g}"
            items += [
                curve(place, values, **style, label=label),
                curve(place, values, **style | true),
            ]
        row.append(Panel("", items, "assumed φ (large: true φ)", y, "y", ticks))
    return panels(row, title="Figure 18 (not in the paper): a wrong coefficient", height=2.6)


def rounding(r: Results, precision: str, ax: Any) -> None:
    """Draw the rounding error of each form over the precision of the measurement, and failures."""
    lost, apart = (
        np.stack([r.get("forms/ratios", f"{f}, {precision}/{what}").mean(1) for f in FORMS])
        for what in ("lost", "apart")
    )
    look: Any = {"norm": "log", "vmin": 1e-14, "vmax": 1e6}
    shades = ax.pcolormesh(10.0**RATIOS, list(FORMS.values()), apart, **look)
    ax.figure.colorbar(shades, ax=ax, label="rounding error (σ)")
    form, ratio = np.nonzero(lost)
    ax.plot(10.0 ** RATIOS[ratio], form, "x", color=colors.PAPER, label="a run fails")
    ax.invert_yaxis()
    ax.grid(visible=False)


def forms(r: Results) -> Figure:
    """Rounding error of five forms of the covariance in two precisions."""
    rows = [
        Panel(title, [partial(rounding, r, title[:6].lower())], RATIO, log="x")
        for title in ("Double precision (reference: one QR)", "Single precision (same reference)")
    ]
    title = "Figure 19 (not in the paper): rounding error of five forms of the covariance"
    return panels(*rows, title=title)


FIGURES = {
    "figure_01": (
        "Fig. 1: geometry of the measurement, with two stars, the Earth's limb and three angles.",
        geometry,
    ),
    **{
        f"figure_{first + i:02d}": (
            f"Fig. {first + i}: error of {AXES[i]} {text}",
            partial(draw, i),
        )
        for first, draw, text in (
            (
                2,
                white,
                "in white noise. (a) All runs. (b) Both filters estimate the same; as "
                "printed, the CSRUKF has used the next sample.",
            ),
            (
                8,
                walk,
                "under a random walk. SRUKF follows the noise, CSRUKF follows the open loop.",
            ),
        )
        for i in range(6)
    },
    "figure_14": (
        "Beyond the paper: NEES and NIS averaged over the runs, with their 95 % ranges. The second "
        "row has the NEES of CSRUKF alone.",
        consistent,
    ),
    "figure_15": (
        "Beyond the paper: RMSE of the runs and linear theory, which is the Cramér–Rao bound for "
        "CSRUKF.",
        against_theory,
    ),
    "figure_16": (
        "Beyond the paper: final 3-D position error over Φ by linear theory, for the fitted prior "
        "and a poor one, with three quantities held fixed.",
        over_phi,
    ),
    "figure_17": (
        "Beyond the paper: SRUKF and the bound of all measurements on long arcs from a poor prior.",
        long_arcs,
    ),
    "figure_18": (
        "Beyond the paper: error and consistency of a filter with a wrong coefficient.",
        assumed,
    ),
    "figure_19": (
        "Beyond the paper: largest rounding error of five forms of the covariance in two "
        "precisions, over 20 steps from a prior of 10 km, and where runs fail.",
        forms,
    ),
}
TABLES = {
    "table_1": (
        "Table 1: RMSE under white noise, Φ = 0.",
        lambda r: rmse_table(r, "0, many", TABLE_1, BOTH, COLUMNS),
    ),
    "table_2": (
        "Table 2: RMSE under random-walk noise, Φ = I.",
        lambda r: rmse_table(r, "I", TABLE_2, BOTH, COLUMNS),
    ),
    "table_3": (
        "Table 3: RMSE under Φ = 0.8 I and Φ = I.",
        lambda r: [
            row
            for name, rows in TABLE_3.items()
            for row in rmse_table(r, name, rows, BOTH, COLUMNS, Phi=name)
        ],
    ),
}


# -- recordings ------------------------------------------------------------------------------------
CASES = {
    "I": "SRUKF follows the random walk of the noise. CSRUKF stays near the truth because it "
    "ignores the sensors, as the open loop does.",
    "0": "In white noise both filters give the same estimate, and errors stay within 3σ.",
    "0.8": "SRUKF looks good, but its covariance is far too small. CSRUKF is consistent, and its "
    "position error is a third smaller.",
    "D/I": "From a poor prior the paper's filter is worse than SRUKF: differences discard the "
    "position in the first sample.",
}
RECORDINGS = ["csrukf_P_I.rrd", "csrukf_P_0.rrd", "csrukf_P_08.rrd", "csrukf_D_I.rrd"]
NOTES = """
Two stars and the Earth's limb give a pseudo-position of the satellite each second. Its noise is \
colored, V' = Φ V + ζ.
Top left: the directions i1, i2 of the stars, their angles A1, A2 to the position vector, and the \
sight lines to the limb, with the angle A3
between them. Estimates and truth differ by less than the width of a line, so the errors have \
their own view below."""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recordings to ``outputs``, the first run of four cases in full, and return their
    names. Needs rerun."""
    return showcase.write(
        {name: _case(results, case) for case, name in zip(CASES, RECORDINGS, strict=True)}, outputs
    )


def _case(results: Results, case: str) -> showcase.Showcase:
    c = results.parts[case].config
    number = results.parts[case].number
    preset, phi = case.split("/") if "/" in case else ("P", case)
    sim = simulate(c, [generator(results.seed, number, 0)])
    found, truth, z = estimates_of(
        results, case, {"csrukf": CSRUKF, "srukf": SRUKF, "openloop": OPEN}
    )
    track = run(filters(c)["augmented"], sim.prior, sim.epochs(), keep="std")
    V = sim.noise[:, 0]
    noise = {}
    for i, axis in enumerate("xyz"):
        mean = np.asarray(track.mean)[:, 0, 6 + i]
        std = np.asarray(track.std)[:, 0, 6 + i]
        augmented = Curve(mean, colors.REFERENCE, "augmented filter", std, mean)
        noise[axis] = Plot(
            f"{'white' if phi == '0' else 'colored'} noise V {axis}, km",
            {"truth": Curve(V[:, i], colors.TRUTH, "true V"), "augmented": augmented},
        )

    def scene(out: Recorder) -> None:
        stars = sightings.star_directions(c.separation)
        scenes.sightings(out, "world", truth[:, :3], truth[:, 3:], stars, EARTH.radius_km)
        out.points("world/z", z, colors.MEASUREMENT, radius=1.0)
        for key, estimate in found.items():
            out.trail(
                f"world/{key}/trail",
                truth[:, :3] + estimate.errors[:, 0, :3],
                estimate.color,
                radius=1.2,
            )

    bound = length(results.get("theory", f"{preset}/csrukf")[:, SWEEP.index(PHIS[phi])])
    growing = ["world/z", *(f"world/{key}/trail" for key in ("truth", *found))]
    return showcase.Showcase(
        f"csrukf: {case}",
        f"# Sun, Zhuang & Xu (2015), Φ = {phi}, preset {preset}\n\n**{CASES[case]}**\n{NOTES}",
        results.times(case),
        found,
        results.study.groups,
        truth,
        np.eye(3, 6),
        "km",
        z - truth[:, :3],
        3,
        {"position": bound},
        scene,
        [scenes.beside("world", "scene, km", truth[len(truth) // 2], EARTH.radius_km, growing)],
        {"V": noise},
        legend={colors.MEASUREMENT: "pseudo-positions", colors.STAR: "stars"},
        parameters=vars(c),
        facts={
            "paper": "csrukf",
            "case": case,
            "seed": results.seed,
        },
    )
