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
    figure,
    level,
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

SRUKF = Line("SRUKF", colors.COMPARISON)
CSRUKF = Line("CSRUKF", colors.ESTIMATE)
OPEN = Line("open loop", colors.OPEN_LOOP, "--")
LINES = {"srukf": SRUKF, "csrukf": CSRUKF}
WHITE = {
    "srukf": SRUKF._replace(width=2.2),
    "csrukf": CSRUKF._replace(style="--"),
    "lagged": Line("CSRUKF as printed (uses the next sample)", colors.TRUTH, width=0.7),
}
AXES = ("x", "y", "z", "v_x", "v_y", "v_z")
TIME = "time (s)"
QUANTITIES = [f"absolute position error ${a}$ (km)" for a in AXES[:3]] + [
    f"velocity error ${a}$ (m/s)" for a in AXES[3:]
]
COLUMNS = ("x_km", "y_km", "z_km", "vx_m_per_s", "vy_m_per_s", "vz_m_per_s")


# -- figures ---------------------------------------------------------------------------------------
def geometry(r: Results) -> Figure:
    """Two stars, the Earth's limb, and the three angles."""
    fig, ax = figure(6.0, 5.2, subplot_kw={"projection": "3d"})
    c = r.parts["0"].config
    path = c.nominal()[:, :3]
    stars = sightings.star_directions(c.separation)
    here = path[0]
    u, v = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
    globe = EARTH.radius_km * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    ax.plot_wireframe(*globe, color=colors.MEASUREMENT, linewidth=0.4, alpha=0.6)
    ax.plot(*path.T, color=colors.TRUTH, label="orbit, 600 s")
    ax.plot(
        *np.stack([np.zeros(3), 1.5 * here]).T,
        color=colors.SIGMA,
        linestyle="--",
        linewidth=1,
        label="position vector",
    )
    edges = np.array(sightings.limb(here, np.cross(here, [0.0, 0.0, 1.0])))
    for i, limb in enumerate(edges):
        ax.plot(
            *np.stack([here, limb]).T,
            color=colors.ESTIMATE,
            label=None if i else "sight lines to the limb",
        )
    rays = [*stars, *(edges - here), here]
    s = np.linspace(0.0, 1.0, 31)[:, None]
    A = np.degrees(sightings.angles(here, stars))
    for i, (a, b) in enumerate(((0, 4), (1, 4), (2, 3))):  # the angles as arcs
        arc = (1.0 - s) * rays[a] / np.linalg.norm(rays[a]) + s * rays[b] / np.linalg.norm(rays[b])
        where = (here + (2500.0 - 600.0 * i) * arc / np.linalg.norm(arc, axis=1, keepdims=True)).T
        ax.plot(
            *where,
            color=(colors.PAPER, colors.OPEN_LOOP, colors.REFERENCE)[i],
            linewidth=1.4,
            label=f"$A_{i + 1}$ = {A[i]:.2f}°",
        )
    for i, star in enumerate(stars):
        ax.quiver(*here, *(5000.0 * star), color=colors.COMPARISON, arrow_length_ratio=0.1)
        ax.text(*(here + 5600.0 * star), f"star {i + 1}", fontsize=8)
    ax.set(
        xlabel="x (km)",
        ylabel="y (km)",
        zlabel="z (km)",
        title="Figure 1: the measured angles",
        aspect="equal",
    )
    ax.view_init(45, 100)
    ax.legend(loc="upper left", fontsize=7)
    fig.set_layout_engine(
        "constrained", rect=(0.0, 0.05, 1.0, 0.95)
    )  # the layout ignores axis labels in 3-D
    return fig


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
    """The printed RMSE of a component, for both filters."""
    return level(
        *(row[i] for row in table.values()),
        label="printed RMSE of both filters",
        color=colors.PAPER,
        style="--",
    )


def white(i: int, r: Results) -> Figure:
    """Error of a component under white noise."""
    title = f"Figure {i + 2}: ${AXES[i]}$, $\\Phi = 0$"
    items = [*component(r, "0", i, WHITE, "csrukf"), printed(TABLE_1, i)]
    top = {"ylim": (0.0 if i < 3 else -0.15, 0.2 if i < 3 else 0.15)}
    return panels(Panel(title, items, TIME, QUANTITIES[i], more=top), size=(7.0, 3.6))


def walk(i: int, r: Results) -> Figure:
    """Error of a component under random-walk noise."""
    four = component(r, "I", i, LINES, "srukf", runs=4, spread=True)
    loop = component(r, "I", i, {"openloop": OPEN})
    right = [*component(r, "I", i, {"csrukf": CSRUKF}, "csrukf", runs=4, spread=True), *loop]
    left = Panel(
        f"Figure {i + 8}: ${AXES[i]}$, $\\Phi = I$",
        [*four, printed(TABLE_2, i)],
        TIME,
        QUANTITIES[i],
    )
    return panels([left, Panel("CSRUKF and open loop", right, TIME)], size=(7.0, 3.8))


def consistent(r: Results) -> Figure:
    """NEES and NIS averaged over the runs, with their 95 % ranges."""
    nees = [
        Panel(
            f"$\\Phi = {n}$",
            [consistency(r, n, LINES, "nees", 6)],
            y="mean NEES (-)" * (n == "0"),
            log="y",
        )
        for n in PHIS
    ]
    nis = [
        Panel("", [consistency(r, n, LINES, "nis", 3)], TIME, "mean NIS (-)" * (n == "0"), log="y")
        for n in PHIS
    ]
    return panels(nees, nis, size=(7.0, 4.8), sharex=True)


def length(std: Array) -> Array:
    """3-D length of the position part of standard deviations ``(..., 6)``."""
    return np.asarray(np.linalg.norm(std[..., :3], axis=-1))


def against_theory(r: Results) -> Figure:
    """RMSE of the runs and exact linear theory."""
    row = []
    for name, phi in PHIS.items():
        items = [rmse(r, name, filter, line, "position") for filter, line in LINES.items()]
        for filter, line in LINES.items():
            std = length(r.get("theory", f"P/{filter}")[:, SWEEP.index(phi)])
            items.append(
                curve(
                    r.times(name),
                    std,
                    color=line.color,
                    linestyle=":",
                    label=f"{line.label}, theory",
                )
            )
        row.append(
            Panel(f"$\\Phi = {name}$", items, TIME, "3-D position RMSE (km)" * (name == "0"), "y")
        )
    return panels(row, size=(7.0, 3.2))


def over_phi(r: Results) -> Figure:
    """Final position error over Phi by linear theory, for the fitted prior and a poor one, by the
    quantity that is held fixed."""
    lines = {
        "srukf": (SRUKF, "o"),
        "csrukf": (CSRUKF, "s"),
        "csrukf+z0": (Line("CSRUKF with the first sample", colors.TRUTH), "^"),
    }
    rows: list[list[Panel]] = []
    for held, phis in {"": SWEEP, **dict.fromkeys(HELD, COLORS)}.items():
        rows.append([])
        ticks = {"xticks": range(len(phis)), "xticklabels": [f"{phi:g}" for phi in phis]}
        for preset, title in (("P", "prior 0.15 km, 0.035 m/s"), ("D", "prior 10 km, 10 m/s")):
            found = {
                name: length(r.get("theory", f"{held}/{preset}/{name}".lstrip("/"))[-1])
                for name in lines
            }
            items = [
                curve(range(len(phis)), y, lines[name][0], marker=lines[name][1], markersize=4)
                for name, y in found.items()
            ]
            y = f"fixed {held or 'increments'}\nfinal 3-D position error (km)" * (not rows[-1])
            rows[-1].append(
                Panel("" if held else title, items, "φ of $\\Phi = \\varphi I$ (-)", y, "y", ticks)
            )
    return panels(*rows, size=(7.0, 7.5))


def long_arcs(r: Results) -> Figure:
    """Long arcs from a poor prior: SRUKF and the bound."""
    items = []
    for i, (name, style) in enumerate((("I", "-"), ("0.8 I", "--"))):
        for key, color, label in (
            ("srukf", SRUKF.color, "SRUKF"),
            ("csrukf+z0", CSRUKF.color, "bound"),
        ):
            std = length(r.get("theory", f"long/{key}")[1:, i])
            items.append(
                curve(
                    np.arange(1, len(std) + 1),
                    std,
                    Line(f"{label}, $\\Phi = {name}$", color, style),
                )
            )
    return panels(
        Panel(
            "prior of 100 km and 100 m/s, first sample used",
            items,
            TIME,
            "3-D position error (km)",
            "xy",
        ),
        size=(5.5, 3.6),
    )


def assumed(r: Results) -> Figure:
    """Error and consistency of a filter with a wrong coefficient."""
    phis = (0.8, 0.9, 0.95, 0.99, 1.0)
    error = list[Item]()
    nees = [level(6.0, label="consistent: 6")]
    flown = {
        "I": (SRUKF.color, ("phi 0.95", "phi 0.99", "csrukf")),
        "0.8": (CSRUKF.color, ("csrukf", "phi 0.9", "phi 1")),
    }
    for part, (color, names) in flown.items():
        place = [phis.index(PHIS[part] if name == "csrukf" else float(name[4:])) for name in names]
        final = [np.sqrt(r.squares(part, name, "position").sum(-1).mean()) for name in names]
        mean = [r.nees(part, name, slice(1, None)).mean() for name in names]
        true = names.index("csrukf")
        for items, values in ((error, final), (nees, mean)):
            look: Any = {"color": color, "marker": "o"}
            label = f"true φ = {PHIS[part]:g}"
            items += [
                curve(place, values, **look, label=label),
                curve(place[true], values[true], **look, markersize=9, fillstyle="none"),
            ]
    x = "assumed φ (circle: true φ)"
    more = {"xticks": range(5), "xticklabels": [f"{phi:g}" for phi in phis]}
    row = ((error, "final 3-D position RMSE (km)"), (nees, "time-mean NEES (-)"))
    return panels([Panel("", items, x, y, "y", more) for items, y in row], size=(7.0, 3.3))


def forms(r: Results) -> Figure:
    """Share of failed runs for each form of the covariance, and the rounding error of the others,
    by the precision of the measurement."""
    lines = {  # several coincide, so the lower ones are wider
        "plain": Line(FORMS["plain"], colors.COMPARISON, width=4.0),
        "symmetrized": Line(FORMS["symmetrized"], colors.TRUTH, width=2.2),
        "Joseph": Line(FORMS["Joseph"], colors.OPEN_LOOP, width=4.0),
        "downdated": Line(FORMS["downdated"], colors.PAPER, "--", 1.1),
        "array": Line(FORMS["array"], colors.ESTIMATE, width=1.1),
    }
    rows = list[list[Panel]]()
    for what, y, log in (
        ("lost", "share of failed runs (-)", "x"),
        ("apart", "largest rounding error (σ)", "xy"),
    ):
        rows.append([])
        for precision in ("double", "single"):
            items = []
            for form, line in lines.items():
                values = r.get("forms/ratios", f"{form}, {precision}/{what}").mean(1)
                values = np.where((values > 0.0) | (log == "x"), values, np.nan)
                items.append(curve(10.0**RATIOS, values, line))
            title = f"{precision} precision" * (what == "lost")
            x = "σ of the prior over σ of a measurement"
            rows[-1].append(Panel(title, items, x, y * (precision == "double"), log))
    return panels(*rows, size=(7.0, 5.0), sharex="col")


FIGURES = {
    "figure_01": (
        "Fig. 1: geometry of the measurement, with two stars, the Earth's limb and three angles.",
        geometry,
    ),
    **{
        f"figure_{i + 2:02d}": (
            f"Fig. {i + 2}: error of {AXES[i]} in white noise. Both filters estimate the same.",
            partial(white, i),
        )
        for i in range(6)
    },
    **{
        f"figure_{i + 8:02d}": (
            f"Fig. {i + 8}: error of {AXES[i]} under a random walk. SRUKF follows the noise, "
            "CSRUKF follows the open loop.",
            partial(walk, i),
        )
        for i in range(6)
    },
    "figure_14": (
        "Beyond the paper: NEES and NIS averaged over the runs, with their 95 % ranges.",
        consistent,
    ),
    "figure_15": (
        "Beyond the paper: RMSE of the runs and linear theory, which is the Cramér–Rao bound for "
        "CSRUKF.",
        against_theory,
    ),
    "figure_16": (
        "Beyond the paper: final position error over Φ by linear theory, for the fitted prior and "
        "a poor one.",
        over_phi,
    ),
    "figure_17": (
        "Beyond the paper: SRUKF and the bound on long arcs from a poor prior.",
        long_arcs,
    ),
    "figure_18": (
        "Beyond the paper: error and consistency of a filter with a wrong coefficient.",
        assumed,
    ),
    "figure_19": (
        "Beyond the paper: five forms of the covariance in two precisions, over 20 steps from a "
        "prior of 10 km.",
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
    "0.8": "SRUKF looks good, but its covariance is far too small. CSRUKF is consistent, and its "
    "position error is a third smaller.",
    "0": "In white noise both filters give the same estimate, and errors stay within 3σ.",
    "I": "SRUKF follows the random walk of the noise. CSRUKF stays near the truth because it "
    "ignores the sensors, as the open loop does.",
    "D/I": "From a poor prior the paper's filter is worse than SRUKF: differences discard the "
    "position in the first sample.",
}
RECORDINGS = ["csrukf_P_08.rrd", "csrukf_P_0.rrd", "csrukf_P_I.rrd", "csrukf_D_I.rrd"]
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
            "runs": results.parts[case].runs,
        },
    )
