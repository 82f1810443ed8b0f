"""[Sun2015] shown: figures and tables as the paper numbers them, those beyond it, recordings."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from celnav.filters.run import run
from celnav.models import sightings
from celnav.models.orbit import EARTH
from celnav.papers.csrukf.scenario import filters, simulate
from celnav.papers.csrukf.study import PHIS, SWEEP, TABLE_1, TABLE_2, TABLE_3
from celnav.show import colors, scenes, showcase
from celnav.show.estimates import Group, again
from celnav.show.figures import Line, consistency, errors, figure, rmse, rmse_table, sigma
from celnav.show.plots import Curve, Plot
from celnav.show.showcase import Showcase
from celnav.study.montecarlo import generator
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

SRUKF, CSRUKF = Line("SRUKF", colors.COMPARISON), Line("CSRUKF", colors.ESTIMATE)
LATE, OPEN = Line("CSRUKF lagged (has seen the next sample)", colors.TRUTH, width=0.7), Line("open loop", colors.OPEN_LOOP, "--")
AXES = ("x", "y", "z", "v_x", "v_y", "v_z")
COLUMNS = ("x_km", "y_km", "z_km", "vx_m_per_s", "vy_m_per_s", "vz_m_per_s")
GROUPS = ("position", "velocity")


def geometry(results: Results) -> Figure:
    """Two stars, the Earth's limb, and the three angles."""
    fig, ax = figure(6.0, 5.2, subplot_kw={"projection": "3d"})
    config = results.parts["0"].config
    path, separation = config.nominal()[:, :3], float(np.radians(config.separation_deg))
    r, stars = path[0], sightings.star_directions(separation)
    u, v = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
    globe = EARTH.radius_km * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    ax.plot_wireframe(*globe, color=colors.MEASUREMENT, linewidth=0.4, alpha=0.6)
    ax.plot(*path.T, color=colors.TRUTH, label="orbit, 600 s")
    ax.plot(*np.stack([np.zeros(3), r]).T, color=colors.SIGMA, linestyle="--", linewidth=1)
    A = np.degrees(sightings.angles(r, stars))
    for i, star in enumerate(stars):
        ax.quiver(*r, *(5000.0 * star), color=colors.COMPARISON, arrow_length_ratio=0.1)
        ax.text(*(r + 5600.0 * star), f"star {i + 1}, $A_{i + 1}$ = {A[i]:.2f}°", fontsize=8)
    for limb in sightings.limb(r, np.cross(r, [0.0, 0.0, 1.0])):
        ax.plot(*np.stack([r, limb]).T, color=colors.ESTIMATE)
    ax.text(*(r * 1.03), f"satellite, $A_3$ = {A[2]:.2f}°", fontsize=8)
    ax.set(xlabel="x (km)", ylabel="y (km)", zlabel="z (km)", title="Figure 1: measured angles")
    ax.set_aspect("equal")
    ax.view_init(22, 15)
    ax.legend(loc="upper left")
    return fig


def white(i: int, results: Results) -> Figure:
    """An error under white noise."""
    fig, ax = figure(7.0, 3.2)
    group, axis, absolute = GROUPS[i // 3], i % 3, i < 3
    for name, line in (("srukf", SRUKF._replace(width=2.2)), ("csrukf", CSRUKF._replace(style="--")), ("lagged", LATE)):
        errors(ax, results, "0", name, line, group, axis, absolute=absolute)
    sigma(ax, results, "0", "csrukf", "CSRUKF", group, axis, absolute=absolute)
    unit, kind = results.group(group).unit, "absolute position error" if absolute else "velocity error"
    ax.set(
        xlabel="time (s)", ylabel=f"{kind} ${AXES[i]}$ ({unit})", title=f"Figure {i + 2}: ${AXES[i]}$, $\\Phi = 0$", xlim=(0, None)
    )
    ax.legend(ncols=2)
    return fig


def walk(i: int, results: Results) -> Figure:
    """An error under random-walk noise."""
    fig, (left, right) = figure(7.0, 3.4, 1, 2)
    group, axis, absolute = GROUPS[i // 3], i % 3, i < 3
    for ax, lines in ((left, {"srukf": SRUKF, "csrukf": CSRUKF}), (right, {"csrukf": CSRUKF, "openloop": OPEN})):
        for name, line in lines.items():
            errors(ax, results, "I", name, line, group, axis, absolute=absolute, runs=1 if name == "openloop" else 4, spread=True)
        ax.set(xlabel="time (s)", xlim=(0, None))
    sigma(right, results, "I", "csrukf", "CSRUKF", group, axis, absolute=absolute)
    for ax in (left, right):
        ax.legend(fontsize=6.5)
    unit, kind = results.group(group).unit, "absolute position error" if absolute else "velocity error"
    left.set(ylabel=f"{kind} ${AXES[i]}$ ({unit})", title=f"Figure {i + 8}: ${AXES[i]}$, $\\Phi = I$")
    right.set_title("CSRUKF against open loop")
    return fig


def consistent(results: Results) -> Figure:
    """NEES and NIS averaged over the runs with their 95 % bands."""
    fig, axes = figure(7.0, 4.6, 2, 3, sharex=True)
    for column, name in enumerate(PHIS):
        for row, (what, dof) in enumerate((("nees", 6), ("nis", 3))):
            consistency(axes[row, column], results, name, {"srukf": SRUKF, "csrukf": CSRUKF}, what, dof)
        axes[0, column].set_title(f"$\\Phi = {name}$")
        axes[1, column].set_xlabel("time (s)")
    axes[0, 0].set_ylabel("mean NEES (-)")
    axes[1, 0].set_ylabel("mean NIS (-)")
    axes[0, 0].legend()
    return fig


def against_theory(results: Results) -> Figure:
    """RMSE of the Monte Carlo against exact linear theory."""
    fig, axes = figure(7.0, 3.0, 1, 3)
    for ax, (name, phi) in zip(axes, PHIS.items(), strict=True):
        for filter, line in (("srukf", SRUKF), ("csrukf", CSRUKF)):
            rmse(ax, results, name, filter, line._replace(label=f"{line.label}, runs"), "position")
            std = np.linalg.norm(results.get("theory", f"P/{filter}")[:, SWEEP.index(phi), :3], axis=-1)
            ax.semilogy(results.times(name), std, color=line.color, linestyle=":", label="theory")
        ax.set(xlabel="time (s)", title=f"$\\Phi = {name}$")
    axes[0].set_ylabel("3-D position RMSE (km)")
    axes[0].legend()
    return fig


def over_phi(results: Results) -> Figure:
    """Final position error over Phi, for the fitted prior and a poor one, by linear theory."""
    fig, axes = figure(7.0, 3.2, 1, 2, sharex=True)
    first, place = Line("CSRUKF with the first sample", colors.TRUTH), np.arange(len(SWEEP))
    for ax, preset, title in zip(axes, ("P", "D"), ("prior 0.15 km, 0.035 m/s", "prior 10 km, 10 m/s"), strict=True):
        for name, line, marker in (("srukf", SRUKF, "o"), ("csrukf", CSRUKF, "s"), ("csrukf+z0", first, "^")):
            std = np.linalg.norm(results.get("theory", f"{preset}/{name}")[-1, :, :3], axis=-1)
            ax.semilogy(place, std, color=line.color, marker=marker, markersize=4, label=line.label)
        ax.set_xticks(place, [f"{phi:g}" for phi in SWEEP])
        ax.set(xlabel="coefficient φ of $\\Phi = \\varphi I$ (-)", title=title)
    axes[0].set_ylabel("final 3-D position error (km)")
    axes[0].legend()
    return fig


def long_arcs(results: Results) -> Figure:
    """Long arcs from a poor prior, SRUKF against the bound."""
    fig, ax = figure(5.5, 3.4)
    for i, (name, style) in enumerate((("I", "-"), ("0.8 I", "--"))):
        for key, line, label in (("srukf", SRUKF, "SRUKF"), ("csrukf+z0", CSRUKF, "bound")):
            std = np.linalg.norm(results.get("theory", f"long/{key}")[1:, i, :3], axis=-1)
            ax.loglog(np.arange(1, len(std) + 1), std, color=line.color, linestyle=style, label=f"{label}, $\\Phi = {name}$")
    ax.set(xlabel="time (s)", ylabel="3-D position error (km)", title="prior 100 km, 100 m/s, first sample used")
    ax.legend()
    return fig


def assumed(results: Results) -> Figure:
    """A wrong coefficient in the filter: error and consistency."""
    fig, axes = figure(7.0, 3.0, 1, 2)
    phis = (0.8, 0.9, 0.95, 0.99, 1.0)
    for part, color, names in (
        ("I", colors.COMPARISON, {0.95: "phi 0.95", 0.99: "phi 0.99", 1.0: "csrukf"}),
        ("0.8", colors.ESTIMATE, {0.8: "csrukf", 0.9: "phi 0.9", 1.0: "phi 1"}),
    ):
        final = [np.sqrt(results.squares(part, name, "position").sum(-1).mean()) for name in names.values()]
        mean = [results.nees(part, name, slice(1, None)).mean() for name in names.values()]
        place, true = [phis.index(phi) for phi in names], list(names).index(PHIS[part])
        for ax, values in zip(axes, (final, mean), strict=True):
            ax.semilogy(place, values, color=color, marker="o", label=f"true φ = {PHIS[part]:g}")
            ax.semilogy(place[true], values[true], color=color, marker="o", markersize=9, fillstyle="none")
            ax.set_xticks(range(len(phis)), [f"{phi:g}" for phi in phis])
            ax.set_xlabel("φ assumed by the filter (circle: the true one)")
    axes[0].set_ylabel("final 3-D position RMSE (km)")
    axes[1].set_ylabel("time-mean NEES (-)")
    axes[1].axhline(6.0, color=colors.SIGMA, linestyle=":", label="consistent")
    axes[1].legend()
    return fig


FIGURES = {
    "figure_01": ("Fig. 1: geometry of the measurement: two stars, the Earth's limb, and the three angles.", geometry),
    **{f"figure_{i + 2:02d}": (f"Fig. {i + 2}: error of {AXES[i]}, white noise: both filters are one filter.", partial(white, i))
       for i in range(6)},
    **{f"figure_{i + 8:02d}": (f"Fig. {i + 8}: error of {AXES[i]}, random walk: SRUKF follows the noise, CSRUKF is the open loop.",
                               partial(walk, i)) for i in range(6)},
    "figure_14": ("Beyond the paper: consistency, NEES and NIS averaged over the runs with their 95 % bands.", consistent),
    "figure_15": ("Beyond the paper: RMSE of the runs against linear theory, for CSRUKF the Cramér-Rao bound.", against_theory),
    "figure_16": ("Beyond the paper: final position error over Φ, for the fitted prior and a poor one (linear theory).", over_phi),
    "figure_17": ("Beyond the paper: long arcs from a poor prior, SRUKF against the bound.", long_arcs),
    "figure_18": ("Beyond the paper: a wrong coefficient in the filter.", assumed),
}  # fmt: skip
TABLES = {
    "table_1": ("Table 1: RMSE under white noise, Φ = 0.", lambda r: rmse_table(r, "0", TABLE_1, GROUPS, COLUMNS)),
    "table_2": ("Table 2: RMSE under random-walk noise, Φ = I.", lambda r: rmse_table(r, "I", TABLE_2, GROUPS, COLUMNS)),
    "table_3": ("Table 3: RMSE under Φ = 0.8 I and Φ = I.",
                lambda r: [row for name, rows in TABLE_3.items() for row in rmse_table(r, name, rows, GROUPS, COLUMNS, Phi=name)]),
}  # fmt: skip


# -- recordings --------------------------------------------------------------------------------------------------------------
CASES = {
    "0.8": "SRUKF looks well but its covariance is far too small; CSRUKF is consistent and a third better in position.",
    "0": "White noise: both filters are the same filter; 3σ holds.",
    "I": "SRUKF follows the wandering noise. CSRUKF stays near the truth because it ignores the sensors, as the open loop does.",
    "D/I": "With a poor prior the paper's filter is worse than SRUKF: differences throw the first sample's position away.",
}
RECORDINGS = ["csrukf_P_08.rrd", "csrukf_P_0.rrd", "csrukf_P_I.rrd", "csrukf_D_I.rrd"]
NOTES = """
One satellite, two stars and the Earth's limb give a pseudo-position each second; its noise is colored, V' = Φ V + ζ.
Left above: the directions i1, i2 of the stars, their angles A1, A2 to the position vector, and the sight lines to the limb, A3
apart. Estimates and truth differ by less than a line's width; hence the view of errors below."""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``: the first run of four cases in full; returns their names. Needs rerun."""
    return showcase.write({name: _case(results, case) for case, name in zip(CASES, RECORDINGS, strict=True)}, outputs)


def _case(results: Results, case: str) -> Showcase:
    c, number = results.parts[case].config, results.parts[case].number
    sim = simulate(c, [generator(results.seed, number, 0)])
    found = again(results, case, {"csrukf": CSRUKF, "srukf": SRUKF, "openloop": OPEN})[0]
    truth, z, V = sim.truth[:, 0], sim.z[:, 0], sim.noise[:, 0]
    track = run(filters(c)["augmented"], sim.prior, sim.epochs(), keep="std")
    noise = {}
    for i, axis in enumerate("xyz"):
        mean, std = np.asarray(track.mean)[:, 0, 6 + i], np.asarray(track.std)[:, 0, 6 + i]
        augmented = Curve(mean, colors.REFERENCE, "augmented filter", std, mean)
        noise[axis] = Plot(f"colored noise V {axis}, km", {"truth": Curve(V[:, i], colors.TRUTH, "true V"), "augmented": augmented})

    def scene(out: Recorder) -> None:
        stars = sightings.star_directions(float(np.radians(c.separation_deg)))
        scenes.sightings(out, "world", truth[:, :3], truth[:, 3:], stars, EARTH.radius_km)
        out.points("world/z", z, colors.MEASUREMENT, radius=1.0)
        for key, estimate in found.items():
            out.trail(f"world/{key}/trail", truth[:, :3] + estimate.errors[:, 0, :3], estimate.color, radius=1.2)

    phi = case.rpartition("/")[2]
    bound = np.linalg.norm(results.get("theory", f"{'D' if '/' in case else 'P'}/csrukf")[:, SWEEP.index(PHIS[phi]), :3], axis=-1)
    growing = ["world/z", *(f"world/{key}/trail" for key in ("truth", *found))]
    return Showcase(
        f"csrukf: {case}", f"# Sun, Zhuang & Xu (2015), Φ = {phi}\n\n**{CASES[case]}**\n{NOTES}",
        results.times(case), found, [Group(*group) for group in results.study.groups], truth, np.eye(3, 6), "km",
        z - truth[:, :3], 3, {"position": bound}, scene,
        [scenes.beside("world", "scene, km", truth[len(truth) // 2], EARTH.radius_km, growing)], {"V": noise},
        legend={colors.MEASUREMENT: "pseudo-positions", colors.STAR: "stars"}, parameters=vars(c),
        facts={"paper": "csrukf", "case": case, "seed": results.seed, "runs": results.parts[case].runs},
    )  # fmt: skip
