"""Figures, tables and recordings of [Xu2023], with the paper's numbers, and figures beyond it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.metrics import rms
from celnav.gaussian.belief import nees
from celnav.models.ephemeris import de421, from_utc
from celnav.models.pulsar import AREA_CM2, BACKGROUND, LIGHT_KM_S, pulsars
from celnav.papers.tstdkf import scenario as s
from celnav.papers.tstdkf import study
from celnav.papers.tstdkf.scenario import DAY_S, SETTINGS, Config
from celnav.papers.tstdkf.study import (
    BOTH,
    COMPARED,
    LARGER,
    PAPER,
    TRENDS,
    VARIANTS,
    accelerations,
    squares,
)
from celnav.show import colors, scenes, showcase
from celnav.show.draw import (
    MARKERS,
    STYLES,
    Item,
    Line,
    Panel,
    band,
    bars,
    components,
    curve,
    grid,
    level,
    note,
    panels,
)
from celnav.show.estimates import Estimate
from celnav.show.figures import Rows
from celnav.show.plots import Curve, Plot
from celnav.show.showcase import SceneView, Showcase
from celnav.study.study import Results
from celnav.study.trial import Group

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

__all__ = ["FIGURES", "RECORDINGS", "TABLES", "record"]

AXES = ("x", "y", "z")
SHADES = (colors.COMPARISON, colors.ESTIMATE, colors.TRUTH)
DAYS = "time (days)"
ERROR = "ephemeris error (km)"
POSITION = "position RMSE (km)"
TRACKED = ("tkf", "C", "B", "aug")
LINES = {
    "ekf": Line("EKF", colors.OPEN_LOOP, STYLES[4]),
    "tkf": Line("TKF", colors.COMPARISON, STYLES[2]),
    "fair": Line("TKF, stationary covariances", colors.MEASUREMENT, STYLES[1]),
    "tstdkf": Line("TSTDKF", colors.ESTIMATE, width=2.5),
    "tdkf": Line("TDKF", colors.FAINT, (0, (1, 9)), 2.0),
    "aug": Line("AUG (exact)", colors.REFERENCE),
    "C": Line("TSTDKF, form C", colors.ESTIMATE, STYLES[1]),
    "B": Line("TSTDKF, form B", colors.PAPER, STYLES[3]),
    "aug9": Line("nine states, random-walk bias", colors.FAINT),
}
WHOLE = {"xmargin": 0.0}
HALF_DAYS = replace(s.TABLE_5, days=366.0, step_s=0.5 * DAY_S)
CHANGED = {
    "as it is": "no change",
    "M0 = (0.03 km)²": "bias prior 0.03 km",
    "M0 = (1 km)²": "bias prior 1 km",
}
MARKS = dict(zip(LINES, 2 * MARKERS, strict=False))


# -- figures ---------------------------------------------------------------------------------------
def orbital(results: Results, part: str, filter: str, group: str, line: Line) -> Item:
    """RMSE over the runs and over one orbit, since it oscillates with the orbit."""
    square = np.square(results.error(part, filter, group)[..., 0]).mean(1)
    width = min(20, len(square))
    values = np.sqrt(np.convolve(square, np.full(width, 1.0 / width), "valid"))
    return curve(results.times(part)[width - 1 :] / DAY_S, values, line)


def principle(_: Results) -> Figure:
    """Geometry of a timing, in the plane of Earth and pulsar."""
    c = s.TABLE_5
    earth, sun = (part[0] for part in s.sky(c)[:2])
    n = c.timing.directions[0]
    r = c.orbit[:3]
    delay, shapiro = (
        float(of(earth + r, sun)[0]) / LIGHT_KM_S for of in (c.timing.delay, c.timing.shapiro)
    )
    roemer = float(n @ (earth + r)) / LIGHT_KM_S
    across = earth - (earth @ n) * n
    plane = np.stack([n, across / np.linalg.norm(across)])
    zero = np.zeros(2)
    ahead = np.array([0.45, 0.0])
    at = plane @ earth / np.linalg.norm(earth)
    satellite = at + 0.35 * (plane @ r) / np.linalg.norm(r)
    x, y = satellite
    text = (
        f"a pulse reaches the barycenter Δt = {delay:.6f} s after the satellite:\n"
        f"n·r {roemer:.6f} s, parallax {1e6 * (delay - roemer - shapiro):.3f} µs, "
        f"Shapiro delay {1e6 * shapiro:.2f} µs"
    )
    items = [
        lambda ax: ax.set_axis_off(),
        curve([x, x], [y, 0.0], color=colors.SIGMA, linestyle=":"),
        curve([0.0, x], [-0.06, -0.06], color=colors.PAPER, linewidth=2.0),
        curve([0.0, at[0], x], [0.0, at[1], y], color="black", marker="o", linestyle=""),
        note(0.0, -0.11, text, colors.PAPER, va="top"),
    ]
    for start, end, name, label, color in (
        (zero, at, "barycenter ", "Earth by the ephemeris", colors.COMPARISON),
        (at, satellite, "Earth ", "orbit", colors.ESTIMATE),
        (satellite, satellite + ahead, "satellite ", f"to {c.pulsars[0]}", colors.SIGMA),
    ):
        # An arrow from the lower right corner of the name.
        arrow = {"arrowstyle": "->", "color": color, "relpos": (1.0, 0.0), "shrinkA": 0.0}
        u, v = 0.5 * (start + end)
        items += [
            note(end[0], end[1], name, xytext=start, ha="right", va="bottom", arrowprops=arrow),
            note(u + 0.04, v - 0.05, label, color),
        ]
    drawn = Panel("", items, more={"xlim": (-0.45, 1.5), "ylim": (-0.3, 1.2)})
    return panels(drawn, height=4.0, title="Figure 1: geometry of a timing (not to scale)")


def difference(results: Results, title: str, name: str, less: str = "") -> Panel:
    """A difference of ephemerides from DE421, every 5 hours, and its norm."""
    values = results.get("sky", name) - (results.get("sky", less) if less else 0.0)
    t = np.arange(len(values)) * 5.0 / 24.0
    norm = np.linalg.norm(values, axis=1)
    items = [*components(t, values, AXES, SHADES), curve(t, norm, Line("norm", "black", STYLES[3]))]
    return Panel(title, items, "days since 2015-10-17 04:00 UTC", "difference (km)", more=WHOLE)


def others(results: Results) -> Figure:
    """Other ephemerides, the Sun, and the Earth seen from the Sun."""
    show = partial(difference, results)
    above = show("Earth, DE423 − DE421", "de423/earth"), show("Earth, DE406 − DE421", "de406/earth")
    below = (
        show("Sun, DE405 − DE421", "de405/sun"),
        show("Earth from the Sun, DE405 − DE421", "de405/earth", "de405/sun"),
    )
    title = "Figure 2b (not in the paper): other ephemerides, and the Sun"
    return panels(above, below, title=title, sharex=True)


def ignorant(number: int, group: str, unit: str, results: Results) -> Figure:
    """RMSE of an EKF that ignores the ephemeris error."""
    month = partial(orbital, results, "month")
    others = partial(orbital, results, "variants")
    large = Line(f"EKF, error {LARGER:.3g} times as large", colors.PAPER, STYLES[1])
    items = [
        month("5/ekf", group, Line("EKF, ephemeris error", colors.OPEN_LOOP)),
        others(f"white, ephemeris error × {LARGER:.3g}/ekf", group, large),
        others(
            "white, no ephemeris error/ekf",
            group,
            Line("EKF, no ephemeris error", colors.TRUTH, STYLES[4]),
        ),
        month("5/tkf", group, Line("TKF, ephemeris error", colors.COMPARISON, STYLES[2])),
    ]
    if group == "position":
        norm = Line("norm of the ephemeris error", colors.SIGMA, ":")
        items.append(month("5/ekf", "bias", norm))
    drawn = Panel("", items, DAYS, f"{group} RMSE ({unit})", "y", WHOLE)
    return panels(drawn, height=2.6, title=f"Figure {number}: effect of an ephemeris error")


def three_trends(_: Results) -> Figure:
    """The ephemeris error over a year, three trends."""
    t = HALF_DAYS.times
    row = [
        Panel(
            f"{name}, {eq}",
            components(t / DAY_S, replace(HALF_DAYS, trend=name).bias(t), AXES, SHADES),
            DAYS,
            ERROR,
            more={"xticks": range(0, 301, 100)} | WHOLE,
        )
        for name, eq in zip(TRENDS, ("Eq. 17", "Eq. 69", "Eq. 70"), strict=True)
    ]
    return panels(row, title="Figure 5: ephemeris error along three trends", sharey=True)


def model_error(_: Results) -> Figure:
    """Effect of the ephemeris error on the timings over a year, at the Earth's center. A
    satellite's orbit does not change it noticeably."""
    c = HALF_DAYS
    earth, sun = s.sky(c)[:2]
    effect = (c.timing.gradient(earth, sun) @ c.bias(c.times)[..., None])[..., 0]
    items = components(c.times / DAY_S, effect, c.pulsars, SHADES)
    drawn = Panel("", items, DAYS, "error c B = Γ δr (km)", more=WHOLE)
    return panels(drawn, title="Figure 6: error of the timings by the ephemeris error")


def third_bodies(_: Results) -> Figure:
    """Acceleration by Sun, Moon and planets in a day, and the largest of each body in a month."""
    c = s.TABLE_5
    each = accelerations(c)
    day = slice(0, round(DAY_S / c.step_s) + 1)
    total = 1e9 * np.asarray(sum(each.values()))[day]
    more = {"xticks": range(0, 25, 6), "ylim": (-1.25, 1.25)} | WHOLE
    by_time = [
        Panel(f"{axis}, all bodies", [item], "time (h)", "acceleration (10⁻⁹ km/s²)", more=more)
        for axis, item in zip(
            AXES, components(c.times[day] / 3600.0, total, AXES, SHADES), strict=True
        )
    ]
    largest = sorted((np.linalg.norm(a, axis=1).max(), x.capitalize()) for x, a in each.items())
    sizes, names = zip(*largest, strict=True)
    items = [
        curve(sizes, names, color=colors.FAINT, marker="o", linestyle=""),
        level(c.acceleration_noise_km_per_s2, upright=True),
        note(5e-11, 0.0, "σ of the process noise", ha="right", va="bottom", rotation=90),
    ]
    bodies = Panel("largest in a month", items, "acceleration (km/s²)", log="x")
    title = "Figure 7: accelerations of the satellite by other bodies"
    return panels(*grid([*by_time, bodies], 2), title=title, legend=False)


def spectrum(results: Results) -> Figure:
    """Spectrum of the third-body acceleration over a month, and its lines at the orbital rate,
    which take four months to resolve."""
    c = replace(s.TABLE_5, days=120.0)
    power, _ = study.power(np.asarray(sum(accelerations(c).values()))[:-1])
    near = components(
        np.fft.rfftfreq(c.samples, c.step_s) * DAY_S, power / power.max(), AXES, SHADES
    )
    power = results.get("pulls", "power")[1:]
    wide = components(results.get("pulls", "cycles")[1:], power / power.max(), AXES, SHADES)
    text = "frequency (cycles/day)", "power over its maximum (-)", "y"
    ends = {"xlim": (0.0, 60.0), "ylim": (1e-13, 3.0)}
    inside = {"xlim": (14.25, 14.55), "ylim": (1e-4, 3.0)}
    return panels(
        Panel("five groups of lines, a month", wide, *text, ends),
        Panel("the group at the orbital rate, 120 days", near, *text, inside),
        title="Figure 8: spectrum of the accelerations",
    )


def one_month(results: Results) -> Figure:
    """Setting 1: position, velocity and bias. The true bias is not drawn from its prior, so there
    is no bound for the bias error."""
    t = results.times("month") / DAY_S
    told = results.get("covariances", "told/aug")
    rows = list[Panel]()
    for i, (group, unit, scale) in enumerate(
        (("position", "km", 1.0), ("velocity", "m/s", 1e3), ("bias", "km", 1.0))
    ):
        items = [
            orbital(results, "month", "fair/tkf" if f == "fair" else f"1/{f}", group, LINES[f])
            for f in ("ekf", "tkf", "fair", "tstdkf", "tdkf", "aug")
            if (f, group) != ("ekf", "bias")
        ]
        if group != "bias":
            P = told[:, 3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
            n = results.error("month", "1/aug", group).shape[1]
            # 95 % range of the mean square of n runs
            size = P.trace(axis1=1, axis2=2)
            far = 1.96 * np.sqrt(2.0 / n * np.square(P).sum((1, 2)))
            low, high = (scale * np.sqrt(np.maximum(size + d, 0.1 * size)) for d in (-far, far))
            shape = {"t": t, "low": low, "high": high, "color": colors.SIGMA}
            items.append(partial(band, label="optimal filter, 95 % range", **shape))
        more = {"ylim": (0.05, 1.2) if group == "bias" else (0.03, 0.6)} | WHOLE
        rows.append(Panel(group, items, DAYS, f"RMSE ({unit})", "y", more))
    return panels(*rows, height=1.6, title="Figure 9: RMSE in setting 1", sharex=True)


def one_year(results: Results) -> Figure:
    """The bias of the first run along three trends, after the first month."""
    later = slice(len(results.times("year")) * 30 // 365, None, 24)
    t = results.times("year")[later]
    rows = []
    for trend in TRENDS:
        truth = replace(s.YEAR, trend=trend).bias(t)
        values = {Line("truth", "black", width=2.5): truth}
        values |= {
            LINES[f]: results.get("year", f"{trend}/{f}/first")[later, 0, 6:] for f in TRACKED
        }
        rows.append(
            [
                Panel(
                    f"{trend}, {axis}",
                    [curve(t / DAY_S, each[:, i], line) for line, each in values.items()],
                    DAYS,
                    ERROR,
                    more={"ylim": (-0.2, 0.2)} | WHOLE,
                )
                for i, axis in enumerate(AXES)
            ]
        )
    title = "Figure 10: estimates of the ephemeris error after the first month"
    return panels(*rows, height=1.7, title=title, sharex=True, sharey=True)


def in_settings(results: Results) -> Figure:
    """Position RMSE of Table 5 as bars."""
    heights = {f: [rms(squares(results, "month", f"{i}/{f}")) for i in SETTINGS] for f in COMPARED}
    heights["fair"] = [rms(squares(results, "month", "fair/tkf")), *[np.nan] * 4]
    ticks = [f"{i}\nF = {c.F:g}\nL = {c.L:g}\nκ = {c.kappa:g}" for i, c in SETTINGS.items()]
    item = bars(ticks, {LINES[f].label: (values, LINES[f].color) for f, values in heights.items()})
    title = "Figure 11 (not in the paper): position RMSE in the five settings"
    return panels(Panel("", [item], "setting", POSITION), title=title)


def consistent(results: Results) -> Figure:
    """NEES with initial errors and biases drawn from their priors."""
    t = results.times("consistency") / DAY_S
    text = DAYS, "NEES / number of states (-)", "y", WHOLE
    row = []
    for case, title in (("1", "setting 1"), ("5", "white noise")):
        items = [level(1.0, label="consistent", color="black", style="--")]
        for f in COMPARED:
            nees = results.get("consistency", f"{case}/{f}/nees").mean(1)
            items.append(curve(t, nees / (9 if f == "aug" else 6), LINES[f]))
        row.append(Panel(title, items, *text))
    title = "Figure 12 (not in the paper): NEES with errors drawn from the priors"
    return panels(row, title=title, sharey=True)


def depends(results: Results) -> Figure:
    """Setting 1 with one change, and filters that assume a wrong coupling."""

    def dots(cases: Mapping[tuple[str, str], str], at: str, filters: Iterable[str]) -> list[Item]:
        """Position RMSE by case, the first at the top; ``cases``: labels by part and name."""
        rows = [*cases.items()][::-1]
        labels = [label for _, label in rows]
        return [
            curve(
                [rms(squares(results, part, f"{case}/{f}", at=at)) for (part, case), _ in rows],
                labels,
                LINES[f],
                linestyle="",
                marker=MARKS[f],
            )
            for f in filters
        ]

    changes = {("variants", name): CHANGED.get(name, name) for name in VARIANTS}
    pairs = {("ten days", str(i)): f"{a:g} → {b:g}" for i, (a, b) in enumerate(study.COUPLINGS)}
    return panels(
        Panel("one change", dots(changes, "all", PAPER), POSITION, log="x"),
        Panel(
            "true coupling κ → κ in the filters",
            dots(pairs, "late", ("tkf", "tstdkf", "aug")),
            POSITION,
        ),
        title="Figure 13 (not in the paper): setting 1, and changes of it",
    )


def trade_off(results: Results) -> Figure:
    """A step of the ephemeris error: delay in following it, and noise of the estimate before it,
    by the parameters of the filters."""
    after = results.at("sweep", "late")
    walks = [1e3 * walk for walk in study.WALKS]
    rows = []
    for x, filters, values in (
        ("ρ (-)", "CB", study.RHOS),
        ("τ (timings)", "CB", study.TAUS),
        ("random walk (m per step)", ["aug9"], walks),
    ):
        ticks = [f"{value:g}" for value in values]
        delay: list[Item] = [level(15.0, label="not in 15 days", color="black")]
        noise = list[Item]()
        for f in filters:
            start = f"{f}, {x[0]}" if f in "CB" else f
            names = [y for y in (*study.SWEEP, *study.NINE) if y.startswith(start)]
            days = [
                study.days(results.error("sweep", f"step/{y}", "bias")[after, :, 0].T)
                for y in names
            ]
            size = [rms(squares(results, "sweep", f"step/{y}", "bias", "steady")) for y in names]
            delay.append(curve(ticks, days, LINES[f], marker=MARKS[f]))
            noise.append(curve(ticks, size, LINES[f], marker=MARKS[f]))
        rows.append(
            [
                Panel("time to follow half of it (days)", delay, x),
                Panel("bias RMSE before it (km)", noise, x, more={"ylim": (0.0, None)}),
            ]
        )
    title = "Figure 14 (not in the paper): a step of the ephemeris error"
    return panels(*rows, height=1.8, title=title, sharey="col")


FIGURES = {
    "figure_01": (
        "Fig. 1: geometry of a timing, drawn from the vectors at the start (not to scale).",
        principle,
    ),
    "figure_02": (
        "Fig. 2: position of the Earth, DE405 - DE421. The difference is below 2 km, not tens of "
        "kilometers.",
        lambda r: panels(
            difference(r, "", "de405/earth"), title="Figure 2: position of the Earth, DE405 − DE421"
        ),
    ),
    "figure_02b": (
        "Beyond the paper: differences of other ephemerides from DE421, of the Sun, and of the "
        "Earth relative to the Sun.",
        others,
    ),
    "figure_03": (
        "Fig. 3: position RMSE of the EKF and the TKF with an ephemeris error, white noise.",
        partial(ignorant, 3, "position", "km"),
    ),
    "figure_04": (
        "Fig. 4: velocity RMSE of the EKF and the TKF with an ephemeris error, white noise.",
        partial(ignorant, 4, "velocity", "m/s"),
    ),
    "figure_05": (
        "Fig. 5: the simulated ephemeris error (a), and the two other trends of Fig. 10.",
        three_trends,
    ),
    "figure_06": (
        "Fig. 6: effect of the ephemeris error on the timings of the three pulsars.",
        model_error,
    ),
    "figure_07": (
        "Fig. 7: acceleration by Sun, Moon and planets in a day, and the largest of each body.",
        third_bodies,
    ),
    "figure_08": (
        "Fig. 8: spectrum of the acceleration. (a) Groups of lines near zero, at the orbital rate "
        "(14.4 cycles/day) and at its multiples. (b) The Moon's motion splits the group at the "
        "orbital rate.",
        spectrum,
    ),
    "figure_09": (
        "Fig. 9: RMSE of position, velocity and bias in setting 1 over the month. Beyond the "
        "paper: TDKF, the exact filter, and the TKF with stationary covariances.",
        one_month,
    ),
    "figure_10": (
        "Fig. 10: the ephemeris error after the first month of a year, in three trends, and its "
        "estimates in the first run.",
        one_year,
    ),
    "figure_11": (
        "Beyond the paper: position RMSE of Table 5 as bars, for five settings of the noise.",
        in_settings,
    ),
    "figure_12": (
        "Beyond the paper: NEES per state, with initial errors and biases drawn from their priors "
        "(1 if consistent).",
        consistent,
    ),
    "figure_13": (
        "Beyond the paper: position RMSE (a) with one change of setting 1, and (b) with a wrong "
        "coupling in the filters.",
        depends,
    ),
    "figure_14": (
        "Beyond the paper: a step of the ephemeris error. (a) Time until an estimate follows "
        "half of it. (b) Error before it.",
        trade_off,
    ),
}


# -- tables ----------------------------------------------------------------------------------------
def parameters(_: Results) -> Rows:
    """The other parameters with their sources."""
    rows = [
        {
            "parameter": name,
            "value": ", ".join(f"{x:g}" for x in value) if isinstance(value, tuple) else str(value),
            **{key: about[key] for key in ("meaning", "source")},
        }
        for name, value in vars(s.TABLE_5).items()
        if (about := Config.__dataclass_fields__[name].metadata) and name not in OTHER_TABLES
    ]

    source = "chosen: typical value"
    area = "area of the detector; σ of a timing is proportional to 1/√area"
    background = "photons / cm² / s; matters for the two weak pulsars only"
    return [
        *rows,
        {"parameter": "area_cm2", "value": f"{AREA_CM2:g}", "meaning": area, "source": source},
        {
            "parameter": "background",
            "value": f"{BACKGROUND:g}",
            "meaning": background,
            "source": source,
        },
    ]


def compared(beyond: bool, results: Results) -> Rows:
    """RMSE of the paper's filters, and reductions of TSTDKF against the others. ``beyond``: RMSE of
    the other filters, and reductions in the second half of the month."""
    at, end = ("late", ", second half (%)") if beyond else ("all", " (%)")
    rows: Rows = []
    for i, (g, unit) in product(SETTINGS, zip(BOTH, ("km", "m/s"), strict=True)):
        month, part = (
            {f: rms(squares(results, "month", f"{i}/{f}", g, window)) for f in COMPARED}
            for window in ("all", at)
        )
        row: dict[str, Any] = {"setting": i, "RMSE of": f"{g} ({unit})"}
        row |= {LINES[f].label: month[f] for f in (("tdkf", "aug") if beyond else PAPER)}
        for f, printed in zip(PAPER[:2], study.PRINTED[g], strict=True):
            row[f"below {f.upper()}{end}"] = 100.0 - 100.0 * part["tstdkf"] / part[f]
            if not beyond:
                row[f"below {f.upper()}, the paper's (%)"] = printed if i == 1 else ""
        rows.append(row)
    return rows


OTHER_TABLES = ("elements", "pulsars")
ELEMENTS = ("a (km)", "e (-)", "i (deg)", "Ω (deg)", "ω (deg)", "ν (deg)", "source")
TABLES = {
    "table_1": (
        "Table 1: orbital elements.",
        lambda _: [dict(zip(ELEMENTS, (*s.TABLE_5.elements, "chosen"), strict=True))],
    ),
    "table_2": (
        "Table 2: parameters of the pulsars, and standard deviation of a timing.",
        lambda _: [
            {**vars(p), "deviation_km": float(d), "source": "paper: name; catalog: values"}
            for p, d in zip(pulsars(s.TABLE_5.pulsars), s.TABLE_5.sigma_km)
        ],
    ),
    "table_3": ("Table 3: the other parameters.", parameters),
    "table_4": (
        "Table 4: AR(1) coefficients F and L and coupling κ in the five settings.",
        lambda _: [
            {"setting": i, **vars(c), "source": "zeros inferred; others chosen or fitted"}
            for i, c in SETTINGS.items()
        ],
    ),
    "table_5": (
        "Table 5: RMSE over the month in the five settings, and by how much TSTDKF is below EKF "
        "and TKF (negative: above).",
        partial(compared, False),
    ),
    "table_5b": (
        "Beyond the paper: Table 5 for TDKF and the exact filter, and for the second half of the "
        "month.",
        partial(compared, True),
    ),
}


# -- recordings ------------------------------------------------------------------------------------
RECORDINGS = ["tstdkf.rrd", "tstdkf_year.rrd"]
SHOWN = {
    "tstdkf": 9,
    "aug": 9,
    "tkf": 9,
    "ekf": 6,
}  # number of components of orbit and bias that each filter estimates
ARROW_KM = 6000.0
EARTH_KM = 6378.137
AU_KM = 1.495978707e8
EXAGGERATION = 1000.0
SPACES = (
    SceneView(
        "world", f"about the Earth, km (errors enlarged {EXAGGERATION:g} times)", (20e3, 15e3, 12e3)
    ),
    SceneView("sun", "around the Sun, AU", (0.5, -2.2, 1.6)),
)
MONTH = f"""# Xu et al. (2023): two stages and strong tracking for X-ray pulsars

**EKF and TKF treat the noise as white, with the covariances of its driving noise. Their errors \
are the largest. TSTDKF models the noise and stays close to the exact filter (AUG).**

A satellite times three pulsars. The Earth's ephemeris is wrong by some hundred meters (the bias). \
The noise is colored and correlated.
Lines: the last orbit, and its estimates with errors enlarged {EXAGGERATION:g} times. \
Arrows: the accelerations by Sun and Moon.
As in the paper, there is no occultation by the Earth, no exclusion near the Sun, and one detector \
for each pulsar.
"""
ONE_YEAR = """# A year of three trends

**The two-stage filter (TKF) models the ephemeris error as constant and does not follow it. TSTDKF \
follows it in part in form B, and hardly
in form C. The exact filter (AUG) models it as a random walk and follows it best.**
"""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    return showcase.write(
        dict(zip(RECORDINGS, (month(results), year(results)), strict=True)), outputs
    )


def month(results: Results) -> Showcase:
    """The first run of setting 1, about the Earth and around the Sun; covariances along the nominal
    orbit."""
    c = results.parts["month"].config
    found = dict[str, Estimate]()
    known = results.data["covariances"]
    truth = np.stack([epoch.truth[0] for epoch in results.first("month").epochs("")])
    t = c.times[1:]
    rows = slice(
        None, None, 9 if len(t) > 180 else 1
    )  # an orbit has 20 steps: every tenth step would show only two places of it
    tracks = {"TRUTH": (colors.TRUTH, truth[:, :3])}
    for key, n in SHOWN.items():
        error = results.get("month", f"1/{key}/first")[..., :n] - truth[:, None, :n]
        color = colors.MEASUREMENT if key == "aug" else LINES[key].color
        cov = known[f"1/{key}"][rows] if f"1/{key}" in known else None
        own = None if cov is None else nees(error[rows, 0], np.linalg.cholesky(cov))
        found[key] = Estimate(key.upper(), color, error[rows], cov, own)
        tracks[key.upper()] = color, truth[:, :3] + EXAGGERATION * error[:, 0, :3]

    def scene(out: Recorder) -> None:
        place = truth[rows, :3]
        pulls = accelerations(c)
        out.globe("world/earth", EARTH_KM)
        out.points("world/sat/truth", place, colors.TRUTH, radius=5.0)
        orbits = np.stack(
            [scenes.behind(points, 20, rows.step) for _, points in tracks.values()], 1
        )
        out.strips("world/sat/orbits", orbits, [color for color, _ in tracks.values()])
        out.ellipsoids(
            "world/sat/aug",
            place,
            EXAGGERATION**2 * known["1/aug"][rows, :3, :3],
            found["aug"].color,
            alpha=0.1,
        )
        for body, color in (("sun", colors.STAR), ("moon", colors.BODY)):
            arrow = ARROW_KM / np.linalg.norm(pulls["moon"], axis=1).max() * pulls[body][1:][rows]
            out.arrow(f"world/pull/{body}", place, arrow, color, "")
        earth, sun = (
            de421().state(body, from_utc(c.start_utc).after(t[rows])).position / AU_KM
            for body in ("earth", "sun")
        )
        days = from_utc(c.start_utc).after(np.linspace(0.0, s.YEAR_S, 366))
        out.path(
            "sun/orbit",
            [(de421().state("earth", days).position - de421().state("sun", days).position) / AU_KM],
            colors.FAINT,
        )
        out.points("sun/sun", 0.0 * earth, colors.STAR, radius=9.0, label="Sun")
        out.points("sun/barycenter", -sun, colors.BODY, radius=3.0, label="barycenter")
        out.points("sun/earth", earth - sun, colors.BODY, radius=5.0, label="Earth")
        for name, direction in zip(c.pulsars, c.timing.directions, strict=True):
            out.arrow(
                f"sun/pulsar/{name}",
                earth - sun,
                np.tile(0.5 * direction, (len(earth), 1)),
                colors.STAR,
                name,
            )
            out.arrow(
                f"world/pulsar/{name}",
                place,
                np.tile(2.0 * ARROW_KM * direction, (len(earth), 1)),
                colors.STAR,
                name,
            )

    groups = (*s.GROUPS, Group("bias", "km", slice(6, 9)))
    return Showcase(
        "tstdkf",
        MONTH,
        t[rows],
        found,
        groups,
        truth[rows],
        np.eye(3, 9),
        "km",
        scene=scene,
        spaces=SPACES,
        legend={colors.STAR: "Sun, pulsars", colors.BODY: "Moon, Earth"},
        truths={"bias": truth[rows, 6:]},
        parameters=vars(c),
        counter="step",
        facts={"paper": "tstdkf", "seed": results.seed, "exaggeration": EXAGGERATION},
        start_date=c.start_utc,
        trail_s=DAY_S,
    )


def year(results: Results) -> Showcase:
    """The first run of each trend, as plots."""
    rows = slice(None, None, 6 if len(results.times("year")) > 120 else 1)
    t = results.times("year")[rows]
    plots = dict[str, dict[str, Plot]]()
    facts = {"paper": "tstdkf", "seed": results.seed}
    for trend in TRENDS:
        first = {f: results.get("year", f"{trend}/{f}/first")[rows, 0, 6:] for f in TRACKED}
        first["truth"] = replace(results.parts["year"].config, trend=trend).bias(t)
        look = {f: (line.color, line.label) for f, line in LINES.items()} | {
            "truth": (colors.TRUTH, "truth")
        }
        for i, axis in enumerate(AXES):
            tracks = {f: Curve(values[:, i], *look[f]) for f, values in first.items()}
            plots.setdefault(trend, {})[axis] = Plot(
                f"{trend}: ephemeris error {axis}, km", tracks, limits=(-0.4, 0.4)
            )
    legend = {LINES[f].color: LINES[f].label for f in TRACKED}
    return Showcase(
        "tstdkf year",
        ONE_YEAR,
        t,
        plots=plots,
        legend=legend,
        facts=facts,
        counter="step",
        start_date=results.parts["year"].config.start_utc,
    )
