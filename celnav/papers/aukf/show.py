"""Figures and tables with the numbers of [Fan], further ones, and recordings."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.filters.run import run
from celnav.models.gnss import satellites
from celnav.papers.aukf import study
from celnav.papers.aukf.scenario import (
    STANDARD,
    START_S,
    axes,
    circle,
    filters,
    noise_factors,
    simulate,
)
from celnav.papers.aukf.study import (
    AXES,
    DENSITIES,
    FILTERS,
    HALVES,
    INITIAL_KM,
    NORMAL_ERROR,
    TILTS_DEG,
    medians,
    rms,
)
from celnav.receiver import day
from celnav.receiver.constellation import synthetic
from celnav.receiver.geodesy import ELLIPSOID
from celnav.receiver.report import KIND_COLORS, kinds, record_positioned
from celnav.show import colors, scenes, showcase
from celnav.show.draw import (
    Item,
    Line,
    Panel,
    curve,
    figure,
    interval,
    level,
    panels,
    quantiles,
)
from celnav.show.estimates import Estimate
from celnav.show.figures import Rows, errors
from celnav.show.plots import Curve, Plot
from celnav.show.showcase import SceneView, Showcase
from celnav.study.montecarlo import generator
from celnav.study.study import Results
from celnav.study.trial import Group

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

__all__ = ["FIGURES", "RECORDINGS", "TABLES", "record"]

LINES = {
    "ls": Line("LS", colors.MEASUREMENT),
    "ekf": Line("EKF", colors.SIGMA, width=2.4),
    "ukf": Line("UKF", colors.COMPARISON, width=0.9),
    "aukf": Line("AUKF", colors.ESTIMATE),
    "group": Line("group parity", colors.TRUTH, "--"),
    "channel": Line("channel parity", colors.OPEN_LOOP),
    "sage-husa": Line("Sage–Husa", "#332288"),
    "student": Line("Student", "#8C564B"),
    "huber": Line("Huber", colors.PAPER),
    "gate": Line("gate", colors.FAINT, ":"),
}


# -- figures ---------------------------------------------------------------------------------------
def receiver(_: Results) -> Figure:
    """A receiver, from the antenna to a position."""
    fig, ax = figure(9.0, 2.0)
    arrow: dict[str, Any] = {"arrowstyle": "->", "color": colors.SIGMA}
    look: dict[str, Any] = {"ha": "center", "va": "center"}
    blocks = (
        "antenna, radio\nfrequency, intermediate\nfrequency, carrier and code\nwipe-off, "
        "navigation\nmessage, positioning"
    )
    for i, text in enumerate(blocks.split(", ")):
        ax.text(
            i,
            0.0,
            text,
            fontsize=7,
            bbox={"boxstyle": "round,pad=0.8", "fc": "none", "ec": colors.COMPARISON},
            **look,
        )
        if i:
            ax.annotate("", (i - 0.38, 0.0), (i - 0.62, 0.0), arrowprops=arrow)
    ax.annotate(
        "", (3.0, -0.4), (5.0, -0.4), arrowprops={**arrow, "connectionstyle": "bar,fraction=-0.08"}
    )
    ax.text(4.0, -0.8, "expected delay and Doppler", color=colors.FAINT, **look)
    ax.text(
        2.5,
        0.7,
        "baseband: the third and fourth blocks run once for each satellite",
        color=colors.FAINT,
        **look,
    )
    ax.set(xlim=(-0.5, 5.5), ylim=(-0.9, 0.8), xticks=[], yticks=[], title="Figure 1: the receiver")
    ax.set_axis_off()
    return fig


def planes(r: Results) -> Figure:
    """Orbital planes and the equator, and the uncertainty of the node by inclination."""
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    dots = dict[str, Any](linestyle="", color=colors.PAPER)

    def orbit(degrees: float, line: Line) -> Item:
        i = np.radians(degrees)
        return curve(np.cos(angle), np.sin(angle) * (0.35 * np.cos(i) + 0.9 * np.sin(i)), line)

    equator = orbit(0.0, Line("equator", colors.SIGMA))
    nodes = curve([-1.0, 1.0], [0.0, 0.0], marker="o", label="nodes", **dots)
    bare: dict[str, Any] = {"ylim": (-1.1, 1.1), "aspect": "equal", "xticks": [], "yticks": []}
    dense = np.geomspace(min(TILTS_DEG), max(TILTS_DEG), 60)
    formula = curve(
        dense,
        np.degrees(NORMAL_ERROR / np.sin(np.radians(dense))),
        Line("δn / sin i", colors.COMPARISON, "--"),
    )
    simulated = curve(TILTS_DEG, r.get("nodes", "node"), marker="s", label="simulated", **dots)
    return panels(
        [
            *(
                Panel(
                    f"({title} inclination, {i:g}°",
                    [equator, orbit(i, Line("orbit", colors.COMPARISON)), nodes],
                    more=bare,
                )
                for title, i in (("a) large", 55.0), ("b) small", 5.0))
            ),
            Panel(
                f"error of the normal δn = {NORMAL_ERROR:g} rad",
                [formula, simulated],
                "inclination (deg)",
                "σ of the node (deg)",
                "xy",
            ),
        ],
        size=(9.0, 3.2),
    )


def polar(r: Results) -> Figure:
    """The unscented transform from polar to Cartesian coordinates: sigma points, their images, and
    the resulting means and standard deviations."""
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    ellipses = list[Item]()
    methods = (
        ("linearized", colors.OPEN_LOOP, "-"),
        ("exact", colors.TRUTH, "-"),
        ("unscented", colors.COMPARISON, "--"),
    )
    for kind, color, style in methods:
        mean, std = r.get("polar", kind)
        x, y = mean[:, None] + std[:, None] * np.stack([np.cos(angle), np.sin(angle)])
        ellipses += [
            curve(*mean, marker="x", color=color),
            curve(x, y, Line(f"{kind}: mean y = {mean[1]:.4f}", color, style)),
        ]
    dots = Line("samples", colors.SIGMA, ""), Line("sigma points", colors.PAPER, "")
    clouds = [
        (r.get("polar", what).T, line, size)
        for what, line, size in zip(("draws", "images"), dots, (1.0, 6.0))
    ]
    polar_clouds = [
        curve(np.degrees(np.arctan2(y, x)), np.hypot(x, y), dot, marker=".", ms=size)
        for (x, y), dot, size in clouds
    ]
    images = [curve(x, y, dot, marker=".", ms=size) for (x, y), dot, size in clouds]
    return panels(
        [
            Panel(
                "Figure 3: r = 1 ± 0.02, θ = 90° ± 15°",
                polar_clouds,
                "θ (deg)",
                "r (-)",
                more={"xlim": (150.0, 30.0)},
            ),
            Panel("x = r cos θ, y = r sin θ", [*images, *ellipses], "x (-)", "y (-)"),
            Panel("means and 1σ ellipses", ellipses, "x (-)"),
        ],
        size=(10.0, 3.3),
    )


def run_of(r: Results, i: int, part: str, title: str, at: str, limit: float, **more: Any) -> Panel:
    """The first run of EKF, UKF and AUKF, the quantiles of all runs of the AUKF, and its RMSE over
    the UKF's."""
    ratio = rms(r, part, "aukf", at, AXES[i].name) / rms(r, part, "ukf", at, AXES[i].name)
    names = [name for name in ("ekf", "ukf", "aukf") if f"{name}/error" in r.data[part]]
    shown = [
        errors(r, part, name, LINES[name], "position", i, spread=name == "aukf") for name in names
    ]
    burst = [interval(*r.parts[part].config.burst_s)] if at == "burst" else []
    return Panel(
        f"{title}: AUKF / UKF {ratio:.2f}",
        [*burst, *shown],
        "time (s)",
        f"error of {AXES[i].name} (m)",
        more={"ylim": (-limit, limit), **more},
    )


def quiet(i: int, r: Results) -> Figure:
    """Error of an axis without a burst, and with more noise than the filters assume."""
    mistuned = run_of(r, i, "mistuned", "σ = 10 m, assumed 3 m", "all", 4.0)
    return panels([run_of(r, i, "none", f"Figure {i + 4}", "all", 2.0), mistuned], size=(10.0, 3.2))


def struck(i: int, r: Results) -> Figure:
    """Error of an axis with the burst on all ranges."""
    start, end = r.parts["ranges, 10 Hz"].config.burst_s
    near = run_of(r, i, "ranges, 10 Hz", "the burst", "burst", 3.0, xlim=(start - 2.0, end + 8.0))
    return panels(
        [run_of(r, i, "ranges, 10 Hz", f"Figure {i + 7}", "burst", 20.0), near],
        size=(10.0, 3.2),
        width_ratios=(3, 2),
    )


def factors(r: Results) -> Figure:
    """The factors by which the AUKF multiplies R."""
    right = 1.0 + (STANDARD.burst_sigma / STANDARD.sigma_range_m) ** 2
    levels = [
        interval(*r.parts["ranges, 10 Hz"].config.burst_s),
        level(right, label=f"correct for ranges in the burst: {right:.0f}", color=colors.PAPER),
    ]
    A = Line("mean over satellites", colors.ESTIMATE)
    t = r.times("ranges, 10 Hz")
    return panels(
        [
            Panel(
                f"factor A of the {half}",
                [*levels, quantiles(t, r.get("ranges, 10 Hz", f"aukf/{half}"), A)],
                "time (s)",
                "factor (-)",
                "y",
            )
            for half in HALVES
        ],
        size=(9.0, 3.2),
        sharey=True,
    )


def baselines(r: Results) -> Figure:
    """Stronger baselines, by the disturbed measurements."""
    lines = [(LINES | {"ukf": LINES["ukf"]._replace(label="EKF, UKF")})[name] for name in FILTERS]

    def bars(case: str) -> Item:
        values = [
            rms(r, "baselines", f"{case}/{name}", "all" if case == "mistuned" else "burst")
            for name in FILTERS
        ]

        def item(ax: Any) -> None:
            bars = ax.barh(
                [line.label for line in lines], values, color=[line.color for line in lines]
            )
            ax.bar_label(bars, fmt="%.3g", padding=2, fontsize=6.5)
            ax.set(xlim=(0.3 * min(values), 8.0 * max(values)), ylim=(len(lines) - 0.5, -0.5))

        return item

    cases = {
        "ranges": "burst on all ranges",
        "both": "burst on ranges and rates",
        "one": "burst on one range",
        "mistuned": "too small R",
    }
    shown = [
        Panel(text, [bars(case)], "position RMSE (m)", log="x") for case, text in cases.items()
    ]
    return panels(shown, size=(10.0, 3.2), sharey=True)


def densities(r: Results) -> Figure:
    """RMSE over the process noise. With little of it the AUKF treats the turn as noise of the
    rates."""
    lines = {
        "ekf": LINES["ekf"]._replace(label="EKF, UKF"),
        "aukf": LINES["aukf"],
        "group": LINES["group"],
    }

    def panel(part: str, qs: tuple[float, ...]) -> Panel:
        curves = [
            curve(
                qs,
                [rms(r, part, f"{q:g}/{name}", "quiet") for q in qs],
                lines[name],
                marker="o",
                ms=3,
            )
            for name in lines
        ]
        true_density = level(
            r.parts[part].config.acceleration_noise, label="a² T", color=colors.PAPER, upright=True
        )
        return Panel(
            part, [*curves, true_density], "process noise (m²/s³)", "quiet position RMSE (m)", "xy"
        )

    return panels(
        [panel(f"densities, {rate}", qs) for rate, qs in DENSITIES.items()],
        size=(9.0, 3.2),
        sharey=True,
    )


def starts(r: Results) -> Figure:
    """Median error over time from several initial errors."""
    styles = dict(zip(INITIAL_KM[::-1], ("-", "--", "-.", ":"), strict=True))
    shown = [
        curve(r.times(f"{km:g} km"), medians(r, km, name), LINES[name], linestyle=styles[km])
        for name in ("ls", "ekf", "ukf", "aukf")
        for km in styles
    ]
    title = f"initial error {', '.join(f'{km:g}' for km in INITIAL_KM[::-1])} km"
    return panels(
        Panel(title, shown, "time (s)", "median position error (m)", "y"), size=(7.0, 3.6)
    )


def sizes(r: Results) -> Figure:
    """RMSE over the length of the window."""
    spans = {"quiet": colors.TRUTH, "burst": colors.ESTIMATE, "after": colors.OPEN_LOOP}

    def panel(rate: str) -> Panel:
        size = partial(rms, r, part := f"windows, {rate}")
        curves = [
            curve(
                study.WINDOWS,
                [size(f"M {m}", at) / size("ukf", at) for m in study.WINDOWS],
                Line(at, color),
                marker=".",
            )
            for at, color in spans.items()
        ]
        return Panel(
            part,
            [level(1.0, label="UKF"), *curves],
            "window (epochs)",
            "position RMSE over the UKF's (-)",
            "xy",
        )

    return panels([panel("10 Hz"), panel("1 Hz")], size=(9.0, 3.2), sharey=True)


def outliers(r: Results) -> Figure:
    """RMSE over the number of bad ranges."""
    size = partial(rms, r, "struck")
    twice = level(2.0 * size("noise 1/aukf", "before"), label="twice the AUKF's quiet RMSE")

    def panel(shape: str, title: str) -> Panel:
        curves = [
            curve(
                study.STRUCK,
                [size(f"{shape} {k}/{name}", "burst") for k in study.STRUCK],
                LINES[name],
                marker=".",
            )
            for name in study.ROBUST
        ]
        return Panel(title, [twice, *curves], "bad ranges of 12", "position RMSE (m)", "y")

    return panels(
        [panel("noise", "50 m of noise"), panel("constant", "50 m too long")],
        size=(9.0, 3.4),
        sharey=True,
    )


# -- tables ----------------------------------------------------------------------------------------
def table_1(r: Results) -> Rows:
    """RMSE by axis; the printed numbers are lost."""
    cases = [("as tuned", "none", name) for name in ("ls", "ekf", "ukf", "aukf")]
    cases += [("σ = 10 m, assumed 3 m", "mistuned", name) for name in ("ukf", "aukf")]
    return [
        {
            "case": text,
            "filter": LINES[name].label,
            "paper": "lost",
            **{f"{g.name} (m)": rms(r, part, name, "all", g.name) for g in AXES},
        }
        for text, part, name in cases
    ]


def table_2(r: Results) -> Rows:
    """RMS errors of a real receiver; no rows without its files."""
    real = r.data.get("real", {})
    return [
        {
            "filter": line.label,
            "RMS (m)": day.rms(real, name),
            "RMS with an added burst (m)": day.rms(real, f"burst/{name}"),
        }
        for name, line in LINES.items()
        if name in real
    ]


FIGURES = {
    "figure_01": ("Fig. 1: the receiver, from the antenna to a position.", receiver),
    "figure_02": (
        "Fig. 2: orbital plane and equator. The smaller the inclination, the more uncertain is the "
        "node.",
        planes,
    ),
    "figure_03": ("Fig. 3: the unscented transform from polar to Cartesian coordinates.", polar),
    **{
        f"figure_{i + 4:02d}": (
            f"Fig. {i + 4}: error of {axis.name} without a burst, and with more noise than the "
            "filters assume.",
            partial(quiet, i),
        )
        for i, axis in enumerate(AXES)
    },
    **{
        f"figure_{i + 7:02d}": (
            f"Fig. {i + 7}: error of {axis.name} with the burst on all ranges.",
            partial(struck, i),
        )
        for i, axis in enumerate(AXES)
    },
    "figure_10": ("Beyond the paper: factors by which the AUKF multiplies R.", factors),
    "figure_11": (
        "Beyond the paper: stronger baselines, by the disturbed measurements.",
        baselines,
    ),
    "figure_12": (
        "Beyond the paper: RMSE over the process noise. With little of it the AUKF treats the turn "
        "as noise of the rates.",
        densities,
    ),
    "figure_13": ("Beyond the paper: median error over time from several initial errors.", starts),
    "figure_14": (
        "Beyond the paper: half a day of a real receiver, without and with an added burst.",
        lambda r: (
            day.drawn(r.data["real"], LINES, STANDARD.burst_sigma) if "real" in r.data else None
        ),
    ),
    "figure_15": ("Beyond the paper: RMSE over the length of the window.", sizes),
    "figure_16": (
        "Beyond the paper: RMSE over the number of bad ranges, with noise or a constant error.",
        outliers,
    ),
}
"""Without the receiver's files its figure is None, and its table has no rows."""
TABLES = {
    "table_1": ("Table 1: RMSE of X, Y and Z by filter; the printed numbers are lost.", table_1),
    "table_2": (
        "Beyond the paper: half a day of a real receiver, RMS distance from the header's position.",
        table_2,
    ),
}


# -- recordings ------------------------------------------------------------------------------------
RECORDINGS = ["aukf_burst.rrd", "aukf_real.rrd"]
NAMES = {
    "aukf": ("AUKF", colors.ESTIMATE),
    "ekf": ("EKF (and UKF)", colors.COMPARISON),
    "group": ("group parity", colors.OPEN_LOOP),
    "ls": ("least squares, each epoch", colors.MEASUREMENT),
}
SHOWN = 8
"""Runs in the recording: the first in full, the others as points."""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recordings to ``outputs`` and return their names. Needs rerun."""
    written = showcase.write({RECORDINGS[0]: _burst(results)}, outputs)
    if "real" not in results.parts:
        return written
    with outputs.path_for(RECORDINGS[1]) as path:
        record_positioned(
            day.positioned(results.parts["real"].config, "aukf", STANDARD.mask_deg), path
        )
    return RECORDINGS


def _burst(results: Results) -> Showcase:
    """The runs of "baselines" with the burst on all ranges, which is the first case there."""
    c = results.parts["baselines"].config
    number = results.parts["baselines"].number
    sim = simulate(c, [generator(results.seed, number, run) for run in range(SHOWN)])
    local = axes(c)
    estimates = dict[str, Estimate]()
    names = list(sim.satellites.names)
    S = len(sim.satellites.names)
    factor = np.zeros(0)
    bank = filters(c, S)
    for name in NAMES:
        track = run(bank[name], sim.prior, sim.epochs(), keep="cov", on_failure="flag")
        cov = (
            None if name == "ls" else track.cov[:, 0]
        )  # estimates of single epochs have no covariance here
        estimates[name] = Estimate(
            *NAMES[name], np.asarray(track.mean - sim.truth), cov, nis=track.nis[:, 0]
        )
        if name == "aukf":
            factor = noise_factors(track, c, S)[:, 0]
    shades = [KIND_COLORS[kind] for kind in kinds(names)]
    adapt = {
        half: Plot(
            f"factor A of the {half} (powers of ten)",
            {name: Curve(*a) for name, *a in zip(names, A, shades, kinds(names), strict=True)},
            log=True,
        )
        for half, A in zip(HALVES, factor.T.reshape(2, S, -1), strict=True)
    }

    def scene(out: Recorder) -> None:
        broadcast = synthetic()
        position = circle(c)[0]
        shown = broadcast.chosen(np.isin(broadcast.names, names))
        paths = (
            satellites(shown, START_S + np.linspace(0.0, 86400.0, 145)[:, None]).position / 1e6
        )  # one day, Earth-fixed
        out.globe("world/earth", ELLIPSOID.semimajor_axis / 1e6)
        scenes.constellation(
            out, "world", sim.satellites.q / 1e6, paths, position / 1e6, shown.names, shades
        )
        truth = (position - position[0]) @ local.T
        out.trail("track/truth/trail", truth, colors.TRUTH, radius=2.0)
        for key, e in estimates.items():
            cov = None if e.cov is None else local @ e.cov[:, :3, :3] @ local.T
            scenes.track(
                out, f"track/{key}", truth + e.errors[:, 0, :3] @ local.T, e.color, e.label, cov=cov
            )

    growing = [f"track/{name}/trail" for name in ("truth", *NAMES)]
    start, end = c.burst_s
    return Showcase(
        "aukf: burst",
        NOTES.format(c),
        c.times,
        estimates,
        [
            Group("position", "m", slice(0, 3), axes="XYZ"),
            Group("velocity", "m/s", slice(3, 6), axes="XYZ"),
        ],
        axes=np.concatenate([local, np.zeros((3, 5))], 1),
        unit="m, east, north, up",
        nis_dof=2 * S,
        scene=scene,
        spaces=(
            SceneView("world", "satellites, 1000 km (Earth-fixed)", (-50.0, 75.0, 45.0)),
            SceneView(
                "track",
                "track, m (east, north, up)",
                (-4e3, -9e3, 9e3),
                (-4e3, 0.0, 0.0),
                growing=growing,
            ),
        ),
        plots={"adaptation": adapt},
        states={"noise": ["burst" if start <= t < end else "nominal" for t in c.times]},
        shades={"nominal": colors.SIGMA, "burst": colors.PAPER},
        hidden=["ls"],
        start=0.5 * (start + end),
        parameters=vars(c),
        facts={"paper": "aukf", "preset": "burst", "seed": results.seed, "runs": SHOWN},
    )


NOTES = """# Fan et al., {0.burst_sigma:g} m of noise on all ranges from {0.burst_s[0]:g} to \
{0.burst_s[1]:g} s

**A filter that adapts its measurement noise suppresses the burst. The EKF, which equals the UKF, \
treats the burst as motion.**

A receiver circles with {0.acceleration_g:g} g at {0.speed_m_per_s:g} m/s. Group parity scales R \
by the part of the residual that no position explains.
It needs no window. Satellites: GEO vermilion, IGSO orange, MEO blue.
"""
