"""Figures, tables and recordings of [Xu2023], with the paper's numbers, and figures beyond it."""

from __future__ import annotations

from collections.abc import Iterable
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
    Item,
    Line,
    Panel,
    band,
    bars,
    components,
    curve,
    figure,
    level,
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
TRACKED = ("tkf", "C", "B", "aug")
LINES = {
    "ekf": Line("EKF", colors.OPEN_LOOP),
    "tkf": Line("TKF", colors.COMPARISON),
    "tdkf": Line("TDKF", colors.FAINT, "--", 0.9),
    "tstdkf": Line("TSTDKF", colors.ESTIMATE, width=1.9),
    "aug": Line("AUG (exact)", colors.REFERENCE),
    "fair": Line("TKF, stationary covariances", colors.MEASUREMENT, "--"),
    "C": Line("TSTDKF, form C", colors.ESTIMATE),
    "B": Line("TSTDKF, form B", colors.PAPER),
}
SWEPT = (colors.ESTIMATE, colors.PAPER, colors.ESTIMATE, colors.PAPER, colors.REFERENCE)


# -- figures ---------------------------------------------------------------------------------------
def orbital(results: Results, part: str, filter: str, group: str, line: Line | None = None) -> Item:
    """RMSE over the runs and over one orbit, since it oscillates with the orbit."""
    square = np.square(results.error(part, filter, group)[..., 0]).mean(1)
    width = min(20, len(square))
    name = filter.split("/")[-1]
    values = np.sqrt(np.convolve(square, np.full(width, 1.0 / width), "valid"))
    return curve(results.times(part)[width - 1 :] / DAY_S, values, line or LINES[name])


def principle(results: Results) -> Figure:
    """Geometry of a timing, in the plane of Earth and pulsar."""
    c = results.parts["month"].config
    fig, ax = figure(6.2, 4.2)
    earth, sun = (part[0] for part in s.sky(c)[:2])
    n = c.timing.directions[0]
    place = earth + c.orbit[:3]
    across = earth - (earth @ n) * n
    delay, shapiro = (
        float(x[0]) / LIGHT_KM_S for x in (c.timing.delay(place, sun), c.timing.shapiro(place, sun))
    )
    roemer = float(n @ place) / LIGHT_KM_S
    plane = np.stack([n, across / np.linalg.norm(across)])
    zero = np.zeros(2)
    ahead = np.array([0.45, 0.0])
    at = plane @ earth / np.linalg.norm(earth)
    satellite = at + 0.35 * (plane @ c.orbit[:3]) / np.linalg.norm(c.orbit[:3])
    for start, end, label, color in (
        (zero, at, "Earth (ephemeris)", colors.COMPARISON),
        (at, satellite, "orbit", colors.ESTIMATE),
        (zero, ahead, "", colors.SIGMA),
        (satellite, satellite + ahead, f"to {c.pulsars[0]}", colors.SIGMA),
    ):
        ax.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": color, "lw": 1.6})
        ax.annotate(
            label, 0.5 * (start + end), color=color, xytext=(6, -13), textcoords="offset points"
        )
    for name, where in (("barycenter", zero), ("Earth", at), ("satellite", satellite)):
        ax.annotate(name, where, xytext=(-4, 6), textcoords="offset points", ha="right")
    ax.plot(*np.stack([zero, at, satellite], 1), "o", color="black", markersize=4)
    ax.plot(
        [satellite[0]] * 2, [satellite[1], 0.0], color=colors.SIGMA, linestyle=":", linewidth=1.0
    )
    ax.plot([0.0, satellite[0]], [-0.06, -0.06], color=colors.PAPER, linewidth=2.0)
    terms = (
        f"n·r {roemer:.6f} s, parallax {1e6 * (delay - roemer - shapiro):.3f} µs, Shapiro "
        f"{1e6 * shapiro:.2f} µs"
    )
    ax.text(0.0, -0.11, f"Δt = {delay:.6f} s\n{terms}", color=colors.PAPER, va="top")
    ax.set(
        xlim=(-0.45, satellite[0] + 0.7),
        ylim=(-0.45, max(at[1], satellite[1]) + 0.2),
        title="Figure 1: geometry of a timing (not to scale)",
    )
    ax.set_axis_off()
    return fig


def difference(results: Results, title: str, name: str, less: str = "") -> Panel:
    """A difference of ephemerides from DE421, every 5 hours, and its norm."""
    values = results.get("sky", name) - (results.get("sky", less) if less else 0.0)
    t = np.arange(len(values)) * 5.0 / 24.0
    norm = np.linalg.norm(values, axis=1)
    items = [
        *components(t, values, AXES, SHADES),
        curve(t, norm, color="black", linewidth=0.8, linestyle="--", label="norm"),
    ]
    return Panel(title, items, "days since 2015-10-17 04:00 UTC", "difference (km)")


def others(results: Results) -> Figure:
    """Other ephemerides, the Sun, and the Earth seen from the Sun."""
    show = partial(difference, results)
    above = show("Earth, DE423 − DE421", "de423/earth"), show("Earth, DE406 − DE421", "de406/earth")
    below = (
        show("Sun, DE405 − DE421", "de405/sun"),
        show("Earth from the Sun, DE405 − DE421", "de405/earth", "de405/sun"),
    )
    return panels(above, below, size=(10.0, 6.0), sharex=True)


def ignorant(number: int, group: str, unit: str, results: Results) -> Figure:
    """RMSE of an EKF that ignores the ephemeris error."""
    shown = {
        ("month", "5/ekf"): Line("EKF, ephemeris error", colors.COMPARISON),
        ("variants", f"white, ephemeris error × {LARGER:.3g}/ekf"): Line(
            f"EKF, error {LARGER:.3g} times as large", colors.PAPER
        ),
        ("variants", "white, no ephemeris error/ekf"): Line(
            "EKF, no ephemeris error", colors.TRUTH
        ),
        ("month", "5/tkf"): Line("TKF, ephemeris error", colors.ESTIMATE),
    }
    items = [orbital(results, *flown, group, line) for flown, line in shown.items()]
    if group == "position":
        items.append(
            orbital(
                results,
                "month",
                "5/ekf",
                "bias",
                Line("norm of the ephemeris error", colors.SIGMA, ":"),
            )
        )
    title = f"Figure {number}: effect of an ephemeris error (white noise)"
    return panels(Panel(title, items, DAYS, f"{group} RMSE ({unit})", "y"), size=(7.5, 3.6))


def three_trends(results: Results) -> Figure:
    """The ephemeris error over a year, three trends."""
    c = results.parts["year"].config
    t = np.arange(0.0, 366.0 * DAY_S, 0.5 * DAY_S)
    heads = zip(
        ("Figure 5, Eq. 17", "for Figure 10, Eq. 69", "for Figure 10, Eq. 70"), TRENDS, strict=True
    )
    lines = (
        (f"{head}: {name}", components(t / DAY_S, replace(c, trend=name).bias(t), AXES, SHADES))
        for head, name in heads
    )
    row = [Panel(*line, DAYS, ERROR) for line in lines]
    return panels(row, size=(9.0, 3.2), sharey=True)


def model_error(results: Results) -> Figure:
    """Effect of the ephemeris error on the timings over a year, at the Earth's center. A
    satellite's orbit does not change it noticeably."""
    c = results.parts["month"].config
    t = np.arange(0.0, 366.0 * DAY_S, 0.5 * DAY_S)
    earth, sun = (
        de421().state(body, from_utc(c.start_utc).after(t)).position for body in ("earth", "sun")
    )
    items = components(
        t / DAY_S, (c.timing.gradient(earth, sun) @ c.bias(t)[..., None])[..., 0], c.pulsars, SHADES
    )
    return panels(
        Panel("Figure 6: error of the timing model", items, DAYS, "c B = Γ δr (km)"),
        size=(6.5, 3.4),
    )


def third_bodies(results: Results) -> Figure:
    """Acceleration by Sun, Moon and planets in a day, and the largest of each body in a month."""
    c = results.parts["pulls"].config
    each = accelerations(c)
    day = slice(0, round(DAY_S / c.step_s) + 1)
    total = 1e9 * np.asarray(sum(each.values()))[day]
    row = [
        Panel(
            f"Figure 7: third bodies, {axis}",
            [curve(c.times[day] / 3600.0, total[:, i], color=SHADES[i])],
            "time (h)",
        )
        for i, axis in enumerate(AXES)
    ]
    row[0] = row[0]._replace(y="acceleration (10⁻⁹ km/s²)")
    sizes = sorted((float(np.linalg.norm(a, axis=1).max()), body) for body, a in each.items())
    largest = curve(
        [size for size, _ in sizes],
        [body for _, body in sizes],
        color=colors.FAINT,
        marker="o",
        linestyle="",
    )
    return panels(
        [
            *row,
            Panel("largest of each body in a month", [largest], "acceleration (km/s²)", log="x"),
        ],
        size=(11.0, 3.2),
    )


def spectrum(results: Results) -> Figure:
    """Spectrum of the third-body acceleration: groups of lines at multiples of the orbital rate."""
    power = results.get("pulls", "power")[1:]
    cycles = results.get("pulls", "cycles")[1:]
    items = components(cycles, power / power.max(), AXES, SHADES, linewidth=0.7)
    title = "Figure 8: spectrum of the acceleration"
    more = {"xlim": (0.0, 60.0)}
    return panels(
        Panel(title, items, "frequency (cycles/day)", "power over its maximum (-)", "y", more),
        size=(6.5, 3.6),
    )


def one_month(results: Results) -> Figure:
    """Setting 1: position, velocity and bias. The true bias is not drawn from its prior, so there
    is no bound for the bias error."""
    t = results.times("month") / DAY_S
    told = results.get("covariances", "told/aug")
    row = list[Panel]()
    for i, (group, unit, scale) in enumerate(
        (("position", "km", 1.0), ("velocity", "m/s", 1e3), ("bias", "km", 1.0))
    ):
        items = [
            orbital(results, "month", f"1/{f}", group)
            for f in (*PAPER, "aug", "tdkf")
            if (f, group) != ("ekf", "bias")
        ]
        items += [orbital(results, "month", "fair/tkf", group, LINES["fair"])]
        if group != "bias":
            P = told[:, 3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
            n = results.error("month", "1/aug", group).shape[1]
            # 95 % range of the mean square of n runs
            size = P.trace(axis1=1, axis2=2)
            far = 1.96 * np.sqrt(2.0 / n * np.square(P).sum((1, 2)))
            low, high = (scale * np.sqrt(np.maximum(size + d, 0.1 * size)) for d in (-far, far))
            items += [
                partial(
                    band,
                    t=t,
                    low=low,
                    high=high,
                    color=colors.SIGMA,
                    label="optimal filter, 95 % range",
                )
            ]
        row.append(
            Panel(
                "Figure 9: setting 1" if i == 1 else "", items, DAYS, f"{group} RMSE ({unit})", "y"
            )
        )
    return panels(row, size=(10.5, 4.2))


def one_year(results: Results) -> Figure:
    """The bias of the first run along three trends."""
    t = results.times("year")[::24]
    rows = []
    for trend in TRENDS:
        first = {LINES[f]: results.get("year", f"{trend}/{f}/first")[::24, 0, 6:] for f in TRACKED}
        first[Line("truth", "black")] = replace(results.parts["year"].config, trend=trend).bias(t)
        items = [
            [curve(t / DAY_S, values[:, i], line) for line, values in first.items()]
            for i in range(3)
        ]
        rows.append(
            [
                Panel(f"{trend}, {i}", each, DAYS, ERROR, "", {"ylim": (-0.3, 0.3)})
                for i, each in zip(AXES, items)
            ]
        )
    return panels(*rows, size=(10.0, 7.5), sharex=True, sharey=True)


def in_settings(results: Results) -> Figure:
    """Position RMSE of Table 5 as bars."""
    heights = {f: [rms(squares(results, "month", f"{i}/{f}")) for i in SETTINGS] for f in COMPARED}
    heights["fair"] = [rms(squares(results, "month", "fair/tkf")), *[np.nan] * 4]
    ticks = [f"{i}: F {c.F:g}, L {c.L:g}, κ {c.kappa:g}" for i, c in SETTINGS.items()]
    item = bars(ticks, {LINES[f].label: (values, LINES[f].color) for f, values in heights.items()})
    return panels(
        Panel("Table 5: position RMSE over the month", [item], "", "position RMSE (km)"),
        size=(9.5, 3.6),
    )


def consistent(results: Results) -> Figure:
    """NEES with initial errors and biases drawn from their priors."""
    t = results.times("consistency") / DAY_S
    row = list[Panel]()
    for case, title in (("1", "setting 1"), ("5", "white noise")):
        nees = {f: results.get("consistency", f"{case}/{f}/nees").mean(1) for f in COMPARED}
        items = [
            curve(t, values / (9 if f == "aug" else 6), LINES[f]) for f, values in nees.items()
        ]
        items.append(level(1.0, label="consistent", color="black"))
        row.append(Panel(title, items, DAYS, "" if row else "NEES / number of states (-)", "y"))
    return panels(row, size=(9.0, 3.6), sharey=True)


def depends(results: Results) -> Figure:
    """Setting 1 with one change, and filters that assume a wrong coupling."""

    def heights(
        part: str, names: Iterable[Any], at: str, filters: Iterable[str]
    ) -> dict[str, tuple[list[float], str]]:
        sizes = {
            f: [rms(squares(results, part, f"{name}/{f}", at=at)) for name in names]
            for f in filters
        }
        return {LINES[f].label: (values, LINES[f].color) for f, values in sizes.items()}

    sizes = heights("variants", VARIANTS, "all", ("ekf", "tkf", "tstdkf"))
    names = list(VARIANTS)[::-1]
    left = [
        curve(v[::-1], names, color=c, marker="o", linestyle="", label=label)
        for label, (v, c) in sizes.items()
    ]
    right = bars(
        [f"{a:g} → {b:g}" for a, b in study.COUPLINGS],
        heights("ten days", range(6), "late", ("tkf", "tstdkf", "aug")),
    )
    said = "position RMSE (km)"
    row = (
        Panel("", left, said, log="x"),
        Panel("", [right], "true κ → assumed κ", said),
    )
    return panels(row, size=(11.0, 4.6))


def trade_off(results: Results) -> Figure:
    """A step of the ephemeris error: delay in following it, and noise of the estimate before it."""
    keys = {
        f"{what} varied, form {f}": [x for x in study.SWEEP if x.startswith(f"{f}, {what}")]
        for what in "ρτ"
        for f in "CB"
    }
    left = list[Item]()
    after = results.at("sweep", "late")
    for (label, names), color in zip(
        (keys | {"random walk varied, nine states": [*study.NINE][:-1]}).items(), SWEPT, strict=True
    ):
        days = [
            study.days(results.error("sweep", f"step/{name}", "bias")[after, :, 0].T)
            for name in names
        ]
        size = [rms(squares(results, "sweep", f"step/{name}", "bias", "steady")) for name in names]
        left.append(
            curve(
                days,
                size,
                color=color,
                marker="o",
                linestyle="--" if "τ" in label else "-",
                label=label,
            )
        )
    return panels(
        Panel(
            "",
            left,
            "days until half of the step is followed",
            "bias RMSE in the 5 days before it (km)",
        ),
        size=(6.5, 4.2),
    )


FIGURES = {
    "figure_01": (
        "Fig. 1: geometry of a timing, drawn from the vectors at the start (not to scale).",
        principle,
    ),
    "figure_02": (
        "Fig. 2: position of the Earth, DE405 - DE421. The difference is below 2 km, not tens of "
        "kilometers.",
        lambda r: panels(
            difference(r, "Figure 2: Earth, DE405 − DE421", "de405/earth"), size=(6.5, 3.6)
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
        "Fig. 5: the simulated ephemeris error, and the two other trends of Fig. 10.",
        three_trends,
    ),
    "figure_06": (
        "Fig. 6: effect of the ephemeris error on the timings of the three pulsars.",
        model_error,
    ),
    "figure_07": (
        "Fig. 7: acceleration of the satellite by Sun, Moon and planets in a day, and the largest "
        "of each body in a month.",
        third_bodies,
    ),
    "figure_08": (
        "Fig. 8: spectrum of the acceleration by Sun, Moon and planets. Five groups of lines are "
        "drawn: near zero, at the orbital rate of 14.4 cycles/day, and at 28.8, 43.2 and 57.6 "
        "cycles/day. This is not AR(1) noise.",
        spectrum,
    ),
    "figure_09": (
        "Fig. 9: RMSE of position, velocity and bias in setting 1 over the month. Beyond the "
        "paper: TDKF, the exact filter, and the TKF with stationary covariances.",
        one_month,
    ),
    "figure_10": (
        "Fig. 10: the bias over a year, three trends: truth, and estimates of TKF, TSTDKF (forms B "
        "and C) and AUG in the first run.",
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
    "figure_14": (
        "Beyond the paper: a step of the ephemeris error. Delay in following it against noise of "
        "the estimate.",
        trade_off,
    ),
    "figure_13": (
        "Beyond the paper: position RMSE in setting 1 with one change (left), and with a wrong "
        "coupling in the filters (right).",
        depends,
    ),
}


# -- tables ----------------------------------------------------------------------------------------
def parameters(_: Results) -> Rows:
    """The other parameters with their sources."""
    names = (
        "step_s",
        "error_km",
        "error_m_per_s",
        "rho",
        "tau",
        "rate_noise_km_per_s",
        "acceleration_noise_km_per_s2",
    )
    known = {
        name: Config.__dataclass_fields__[name].metadata
        for name in (*names, "amplitude_km", "bias_prior_km", "walk_km")
    }
    rows = [
        {
            "parameter": name,
            "value": str(getattr(s.TABLE_5, name)),
            **{key: about[key] for key in ("meaning", "source")},
        }
        for name, about in known.items()
    ]

    def timed(**detector: float) -> str:
        return ", ".join(
            f"{1e3 * LIGHT_KM_S * p.timing_std(300.0, **detector):.0f}"
            for p in pulsars(s.TABLE_5.pulsars)
        )

    for name, x, told in (
        ("area_cm2", AREA_CM2, "area of the detector"),
        ("background", BACKGROUND, "X-ray background, photons / cm^2 / s"),
    ):
        errs = (
            f"; with a tenth of it σ of the timings is {timed(**{name: 0.1 * x})} m, with ten "
            f"times {timed(**{name: 10.0 * x})} m"
        )
        rows.append(
            {
                "parameter": name,
                "value": f"{x:g}",
                "meaning": told + errs,
                "source": "chosen: typical value",
            }
        )
    return rows


def compared(beyond: bool, results: Results) -> Rows:
    """RMSE of the paper's filters, and reductions of TSTDKF against the others. ``beyond``: RMSE of
    the other filters, and reductions in the second half of the month."""
    rows: Rows = []
    for i, (g, unit) in product(SETTINGS, zip(BOTH, ("km", "m/s"), strict=True)):
        size, late = (
            {f: rms(squares(results, "month", f"{i}/{f}", g, at)) for f in COMPARED}
            for at in ("all", "late")
        )
        rows.append({"setting": i, "RMSE of": f"{g} ({unit})"})
        rows[-1] |= {LINES[f].label: size[f] for f in (("tdkf", "aug") if beyond else PAPER)}
        for f, printed in zip(PAPER[:2], study.PRINTED[g], strict=True):
            below = [100.0 - 100.0 * x["tstdkf"] / x[f] for x in (size, late)]
            paper = {
                f"below {f.upper()} (%)": below[0],
                f"below {f.upper()}, the paper's (%)": printed if i == 1 else "",
            }
            rows[-1] |= {f"below {f.upper()}, second half (%)": below[1]} if beyond else paper
    return rows


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
