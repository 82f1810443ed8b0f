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
    SERIES,
    STYLES,
    Item,
    Line,
    Panel,
    curve,
    grid,
    interval,
    level,
    panels,
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
    "ls": Line("LS", colors.MEASUREMENT, ":"),
    "ekf": Line("EKF", colors.SIGMA, width=2.6),
    "ukf": Line("UKF", colors.COMPARISON, "--"),
    "aukf": Line("AUKF", colors.ESTIMATE),
    "group": Line("group parity", colors.OPEN_LOOP, "-."),
    "channel": Line("channel parity", colors.REFERENCE, ":"),
    "sage-husa": Line("Sage–Husa", colors.SIGMA),
    "student": Line("Student's t", colors.SIGMA),
    "huber": Line("Huber", colors.FAINT, STYLES[5]),
    "gate": Line("innovation gate", colors.SIGMA),
}
CIRCLE = np.linspace(0.0, 2.0 * np.pi, 181)
BLOCKS = (
    "antenna, radio\nfrequency, intermediate\nfrequency, carrier\nand code\nwipe-off, "
    "navigation\nmessage, positioning"
)
RATIO = "the AUKF's RMSE is {:.2f} of the UKF's"


# -- figures ---------------------------------------------------------------------------------------
def receiver(_: Results) -> Figure:
    """A receiver, from the antenna to a position; lengths in inches."""
    arrow = dict[str, Any](arrowstyle="-|>", shrinkA=0, shrinkB=0)

    def item(ax: Any) -> None:
        ax.set_axis_off()
        ax.barh(0.0, 2.1, 0.75, left=3.24, color=colors.BOUND, alpha=0.3)
        for i, text in enumerate(BLOCKS.split(", ")):
            left = 1.1 * i
            ax.barh(0.0, 0.88, 0.6, left=left, color="white", ec=colors.COMPARISON)
            ax.text(left + 0.44, 0.0, text, ha="center", va="center")
            if i:
                ax.annotate("", (left, 0.0), (left - 0.22, 0.0), arrowprops=arrow)
        arrow["connectionstyle"] = "bar,fraction=-0.2"
        ax.annotate("", (3.74, -0.3), (5.94, -0.3), arrowprops=arrow)
        ax.text(3.24, 0.43, "baseband, once for each satellite")
        ax.text(4.84, -0.95, "expected delay and Doppler", ha="center")

    return panels(
        Panel("", [item], more={"xlim": (-0.02, 6.4), "ylim": (-1.0, 0.6)}),
        height=1.75,
        title="Figure 1: the receiver",
    )


def planes(r: Results) -> Figure:
    """Orbital planes and the equator, and the uncertainty of node and position by inclination."""

    def ellipse(around: Any, degrees: float, line: Line) -> Item:
        i = np.radians(degrees)
        return curve(np.cos(around), np.sin(around) * (0.35 * np.cos(i) + 0.9 * np.sin(i)), line)

    nodes = Line("nodes, if the normal is off by up to 2°", colors.ESTIMATE, width=5.0)
    normal = np.radians(2.0) * np.linspace(-1.0, 1.0, 21)[:, None]
    above = [
        Panel(
            f"{title} inclination, {i:g}°",
            [
                lambda ax: ax.set_axis_off(),
                ellipse(CIRCLE, 0.0, Line("equator", colors.SIGMA, "--")),
                ellipse(CIRCLE, i, Line("orbit", colors.COMPARISON)),
                ellipse(normal / np.sin(np.radians(i)) + [0.0, np.pi], 0.0, nodes),
            ],
            more={"aspect": "equal"},
        )
        for title, i in (("large", 55.0), ("small", 5.0))
    ]
    dense = np.geomspace(min(TILTS_DEG), max(TILTS_DEG), 60)
    below = [
        Panel(
            f"σ of the {words}",
            [
                curve(
                    dense,
                    np.degrees(NORMAL_ERROR / divisor),
                    Line(f"formula, δn = {NORMAL_ERROR:g} rad", colors.COMPARISON, "--"),
                ),
                curve(
                    TILTS_DEG,
                    r.get("nodes", name),
                    Line("simulated", colors.PAPER, ""),
                    marker="s",
                ),
            ],
            "inclination i (deg)",
            "σ (deg)",
            "xy",
        )
        for name, words, divisor in (
            ("node", "node: δn / sin i", np.sin(np.radians(dense))),
            ("place", "position: δn", dense**0.0),
        )
    ]
    return panels(
        above,
        below,
        title="Figure 2: a small inclination leaves the node uncertain, not the position",
        sharey="row",
    )


def polar(r: Results) -> Figure:
    """The unscented transform from polar to Cartesian coordinates: sigma points, their images, and
    the resulting means and standard deviations."""
    left, right = list[Item](), list[Item]()
    for what, line, marker in (
        ("draws", Line("samples", colors.SIGMA, ""), ","),
        ("images", Line("sigma points", colors.COMPARISON, ""), "."),
    ):
        x, y = r.get("polar", what).T
        angle, radius = np.degrees(np.arctan2(y, x)), np.hypot(x, y)
        left.append(curve(angle, radius, line, marker=marker, ms=8.0))
        right.append(curve(x, y, line, marker=marker, ms=8.0))
    for kind, color, style in (
        ("linearized", colors.OPEN_LOOP, "-."),
        ("exact", colors.TRUTH, "-"),
        ("unscented", colors.COMPARISON, "--"),
    ):
        mean, std = r.get("polar", kind)[..., None]
        x, y = mean + std * [np.cos(CIRCLE), np.sin(CIRCLE)]
        right += [
            curve(*mean, marker="x", color=color),
            curve(x, y, Line(f"{kind}: mean y = {mean[1, 0]:.4f}", color, style, 1.8)),
        ]
    shown = [
        Panel("r = 1 ± 0.02, θ = 90° ± 15°", left, "θ (deg)", "r (-)", "", {"xlim": (150, 30)}),
        Panel("images, means and 1σ ellipses", right, "x (-)", "y (-)"),
    ]
    return panels(shown, height=2.9, title="Figure 3: unscented transform of polar coordinates")


def run_of(r: Results, i: int, part: str, title: str, at: str, limit: float, **more: Any) -> Panel:
    """The first run of EKF, UKF and AUKF, the quantiles of all runs of the AUKF, and its RMSE over
    the UKF's."""
    axis = AXES[i].name
    ratio = rms(r, part, "aukf", at, axis) / rms(r, part, "ukf", at, axis)
    shown = [
        errors(r, part, name, LINES[name], "position", i, spread=name == "aukf")
        for name in ("ekf", "ukf", "aukf")
        if f"{name}/error" in r.data[part]
    ]
    if at == "burst":
        start, end = r.parts[part].config.burst_s
        shown.insert(0, interval(start, end, "burst", colors.SIGMA))
    more = {"xmargin": 0.0, "ylim": (-limit, limit)} | more
    return Panel(title.format(ratio), shown, "time (s)", f"error of {axis} (m)", "", more)


def quiet(i: int, r: Results) -> Figure:
    """Error of an axis without a burst, and with more noise than the filters assume."""
    return panels(
        run_of(r, i, "none", f"noise of 3 m, as assumed: {RATIO}", "all", 1.5),
        run_of(r, i, "mistuned", f"noise of 10 m, assumed 3 m: {RATIO}", "all", 4.0),
        title=f"Figure {i + 4}: error of {AXES[i].name} without a burst",
    )


def struck(i: int, r: Results) -> Figure:
    """Error of an axis with the burst on all ranges."""
    part = "ranges, 10 Hz"
    start, end = r.parts[part].config.burst_s
    near = np.arange(start - 5.0, end + 11.0, 5.0)
    return panels(
        run_of(r, i, part, f"in the burst {RATIO}", "burst", 16.0),
        run_of(r, i, part, "enlarged", "burst", 3.0, xlim=near[[0, -1]], xticks=near),
        title=f"Figure {i + 7}: error of {AXES[i].name} with a burst on all ranges",
    )


def factors(r: Results) -> Figure:
    """Factors by which the AUKF multiplies R: means over the satellites, medians of the runs."""
    right = 1.0 + (STANDARD.burst_sigma / STANDARD.sigma_range_m) ** 2
    part = "ranges, 10 Hz"
    start, end = r.parts[part].config.burst_s
    shown = [
        interval(start, end, "burst", colors.SIGMA),
        level(right, label=f"correct for ranges in the burst: {right:.0f}", color=colors.TRUTH),
    ]
    for i, half in enumerate(HALVES):
        A = np.median(r.get(part, f"aukf/{half}"), 1)
        shown.append(curve(r.times(part), A, Line(half, SERIES[i], STYLES[i])))
    return panels(
        Panel("", shown, "time (s)", "factor (-)", "y", {"xmargin": 0.0}),
        title="Figure 10 (not in the paper): factor by which the AUKF multiplies R",
    )


def baselines(r: Results) -> Figure:
    """Stronger baselines, by the disturbed measurements."""
    lines = [LINES[name] for name in FILTERS]

    def bars(case: str, ax: Any) -> None:
        at = "all" if case == "mistuned" else "burst"
        values = [rms(r, "baselines", f"{case}/{name}", at) for name in FILTERS]
        labels = [line.label for line in lines]
        drawn = ax.barh(labels, values, color=[line.color for line in lines])
        ax.bar_label(drawn, fmt=lambda v: f"{float(f'{v:.3g}'):g}", padding=2)

    more = {"xlim": (0.3, 9000.0), "ylim": (len(lines) - 0.5, -0.5)}
    shown = [
        Panel(text, [partial(bars, case)], "position RMSE (m)", "", "x", more)
        for case, text in (
            ("ranges", "burst on all ranges"),
            ("both", "burst on ranges and rates"),
            ("one", "burst on one range"),
            ("mistuned", "noise of 10 m, assumed 3 m"),
        )
    ]
    return panels(
        *grid(shown, 2),
        title="Figure 11 (not in the paper): stronger filters, by the disturbed measurements",
        sharex=True,
        sharey=True,
    )


def densities(r: Results) -> Figure:
    """RMSE over the process noise. With little of it the AUKF treats the turn as noise of the
    rates."""

    def panel(rate: str, qs: tuple[float, ...]) -> Panel:
        part = f"densities, {rate}"
        curves = [
            curve(qs, [rms(r, part, f"{q:g}/{name}", "quiet") for q in qs], LINES[name], marker=".")
            for name in ("ekf", "aukf", "group")
        ]
        turn = level(
            r.parts[part].config.acceleration_noise,
            label="acceleration² × interval, our choice",
            upright=True,
        )
        return Panel(rate, [*curves, turn], "process noise (m²/s³)", "position RMSE (m)", "xy")

    return panels(
        [panel(rate, qs) for rate, qs in DENSITIES.items()],
        title="Figure 12 (not in the paper): process noise that a filter assumes, without a burst",
        sharey=True,
    )


def starts(r: Results) -> Figure:
    """Median error over time from several initial errors."""
    shown = [
        Panel(
            f"initial error {km:g} km",
            [
                curve(r.times(f"{km:g} km"), medians(r, km, name), LINES[name])
                for name in ("ls", "ekf", "ukf", "aukf")
            ],
            "time (s)",
            "median error (m)",
            "y",
            {"xmargin": 0.0},
        )
        for km in INITIAL_KM
    ]
    return panels(
        *grid(shown, 2),
        title="Figure 13 (not in the paper): start from a wrong position",
        sharex=True,
        sharey="row",
    )


def sizes(r: Results) -> Figure:
    """RMSE over the length of the window."""
    spans = {
        "quiet": Line("before the burst", colors.COMPARISON, "--"),
        "burst": Line("in the burst", colors.ESTIMATE),
        "after": Line("after the burst", colors.OPEN_LOOP, "-."),
    }

    def panel(rate: str) -> Panel:
        size = partial(rms, r, f"windows, {rate}")
        items = [level(1.0, label="UKF")]
        for at, line in spans.items():
            ratios = [size(f"M {m}", at) / size("ukf", at) for m in study.WINDOWS]
            items.append(curve(study.WINDOWS, ratios, line, marker="."))
        return Panel(rate, items, "window (epochs)", "RMSE over the UKF's (-)", "xy")

    return panels(
        [panel("10 Hz"), panel("1 Hz")],
        title="Figure 15 (not in the paper): length of the window",
        sharey=True,
    )


def outliers(r: Results) -> Figure:
    """RMSE over the number of bad ranges."""
    size = partial(rms, r, "struck")
    twice = level(2.0 * size("noise 1/aukf", "before"), label="twice the AUKF before")

    def panel(shape: str, title: str) -> Panel:
        items = [twice]
        for name in study.ROBUST:
            values = [size(f"{shape} {k}/{name}", "burst") for k in study.STRUCK]
            items.append(curve(study.STRUCK, values, LINES[name], marker="."))
        return Panel(title, items, "bad ranges of 12", "position RMSE (m)", "y")

    return panels(
        [panel("noise", "50 m of noise"), panel("constant", "50 m too long")],
        height=2.6,
        title="Figure 16 (not in the paper): several bad ranges for ten seconds",
        sharey=True,
    )


def receiver_day(r: Results) -> Figure | None:
    """Half a day of a real receiver, without and with an added burst; None without its files."""
    if "real" not in r.data:
        return None
    fig = day.drawn(r.data["real"], LINES, STANDARD.burst_sigma)
    fig.suptitle("Figure 14 (not in the paper): half a day of a real receiver")
    return fig


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
        "node. The position is as certain at any inclination.",
        planes,
    ),
    "figure_03": ("Fig. 3: the unscented transform from polar to Cartesian coordinates.", polar),
    **{
        f"figure_{i + first:02d}": (
            f"Fig. {i + first}: error of {axis.name} {words}",
            partial(draw, i),
        )
        for first, draw, words in (
            (4, quiet, "without a burst, and with more noise than the filters assume."),
            (7, struck, "with the burst on all ranges: the whole run, and 55 to 80 s enlarged."),
        )
        for i, axis in enumerate(AXES)
    },
    "figure_10": ("Beyond the paper: mean factor by which the AUKF multiplies R.", factors),
    "figure_11": (
        "Beyond the paper: stronger filters, by the disturbed measurements. The EKF's errors "
        "equal the UKF's.",
        baselines,
    ),
    "figure_12": (
        "Beyond the paper: RMSE over the process noise that a filter assumes. With little of it "
        "the AUKF treats the turn as noise of the rates. The UKF's errors equal the EKF's.",
        densities,
    ),
    "figure_13": ("Beyond the paper: median error over time from four initial errors.", starts),
    "figure_14": (
        "Beyond the paper: half a day of a real receiver, without and with an added burst.",
        receiver_day,
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
