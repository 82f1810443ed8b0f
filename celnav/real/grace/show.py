"""Figures, table and recording of GRACE-A: errors and their predicted σ, correlations, RMS
errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.files import Outputs
from celnav.gaussian.linalg import Array, matvec
from celnav.models import earth
from celnav.real.grace.positions import EPOCH, STEP_S, aligned, axes, read
from celnav.real.grace.settings import DEGREE, SETTINGS, orientation
from celnav.real.grace.study import BEST, DEGREES, NAMES, REVOLUTION, column
from celnav.show import colors, scenes, showcase
from celnav.show.draw import (
    STYLES,
    Line,
    Panel,
    band,
    bars,
    curve,
    level,
    panels,
)
from celnav.show.estimates import Estimate, measurement_states
from celnav.show.figures import Rows
from celnav.show.showcase import SceneView, Showcase
from celnav.study.numbers import correlation, lagged
from celnav.study.study import Results
from celnav.study.trial import Group

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.show.recording import Recorder

__all__ = ["FIGURES", "RECORDINGS", "TABLES", "record"]

LINES = {
    "white": Line("errors modeled as white", colors.COMPARISON, STYLES[1]),
    "colored": Line("correlation modeled", colors.ESTIMATE),
    "robust": Line("the same, with Student's t", colors.FAINT, STYLES[3]),
    "white, gated": Line("white, with a gate", colors.PAPER, STYLES[2]),
    "white, inflated": Line("white, R inflated", colors.MEASUREMENT),
    "white, by NIS": Line("white, R by NIS", colors.OPEN_LOOP),
    "white, by likelihood": Line("white, R and Q by likelihood", colors.SIGMA),
    "screened": Line("colored, Gaussian, no outliers", colors.BOUND),
    "normal": Line("colored, Gaussian, all fixes", colors.BODY),
    "by correlation": Line("colored, by correlation", colors.OPEN_LOOP),
    "augmented": Line("noise in the state", colors.REFERENCE),
    "without z_0": Line("without the first fix", colors.REFERENCE, "--"),
    "shortest": Line("colored, shortest time constant", colors.BODY, "--"),
    "longest": Line("colored, longest time constant", colors.BOUND, "--"),
    "bound": Line("colored, range of time constants", colors.TRUTH),
}
BAND = 1.96


def day(r: Results) -> Figure:
    """Radial errors and predicted 95 % range over the day."""
    hours, limit = r.times(BEST) / 3600.0, 16.0

    def panel(name: str) -> list[Panel]:
        error, std = (r.get(BEST, f"{name}/{what}")[:, 0, 0] for what in ("error", "std"))
        inside = np.mean((np.abs(error) < BAND * std)[np.isfinite(error)])

        def claimed(ax: Any) -> None:
            band(
                ax, hours, -BAND * std, BAND * std, color=LINES[name].color, label="95 % predicted"
            )

        title = f"{LINES[name].label}: {inside:.0%} of the radial errors within the predicted 95 %"
        return [
            Panel(
                title,
                [
                    claimed,
                    curve(
                        hours, error, LINES[name]._replace(label="error", color="black", width=0.6)
                    ),
                ],
                "hours of 1 August 2008",
                "radial (m)",
                more={"ylim": (-limit, limit), "xlim": (0.0, 24.0)},
            )
        ]

    return panels(
        *map(panel, ("white", "colored", "robust")), height=1.8, sharex="col", legend=False
    )


def bursts(r: Results) -> Figure:
    """Norms of the errors over the day, and around the largest error of a fix."""
    hours, length = (
        r.times(BEST) / 3600.0,
        {name: np.sqrt(column(r, BEST, name, "error")) for name in ("fixes", *LINES)},
    )
    worst = float(hours[np.nanargmax(length["fixes"])])
    drawn = [
        curve(
            hours,
            length["fixes"],
            label="fixes",
            color=colors.SIGMA,
            linestyle="",
            marker=".",
            markersize=1.5,
        ),
        *(
            curve(hours, length[name], LINES[name])
            for name in ("white, gated", "white", "colored", "robust")
        ),
    ]
    each = {
        "the day": (0.0, float(hours[-1])),
        "around the largest error of a fix": (worst - 0.45, worst + 0.65),
    }
    rows = [
        Panel(
            title,
            drawn,
            "hours of 1 August 2008",
            "error (m)",
            "",
            {"xlim": span, "ylim": (0.0, 45.0)},
        )
        for title, span in each.items()
    ]
    return panels(*rows, height=2.6)


def autocorrelations(r: Results) -> Figure:
    """Autocorrelation of the fixes' errors, and of whitened innovations."""
    lags, minutes = (
        np.unique(np.geomspace(1.0, min(600.0, 0.3 * len(r.times(BEST))), 60).astype(int)),
        STEP_S / 60.0,
    )

    def of_lags(values: Array, lags: Array) -> list[float]:
        pairs = [lagged(values[REVOLUTION:], lag) for lag in lags.tolist()]
        return [correlation(a[known], b[known]) for a, b in pairs for known in [np.isfinite(a * b)]]

    modeled = SETTINGS["colored"].phi ** lags
    found = [
        curve(
            minutes * lags, of_lags(r.get(BEST, "fixes")[:, i], lags), Line(name, shade, STYLES[i])
        )
        for i, (name, shade) in enumerate(SHADES.items())
    ]
    found += [curve(minutes * lags, modeled, Line("model of the filter", "black", STYLES[3], 1.5))]
    near = np.arange(1, 31)
    left = [
        curve(STEP_S * near, of_lags(r.get(BEST, f"{name}/white"), near), LINES[name], marker=".")
        for name in ("white", "colored")
    ]
    return panels(
        [
            Panel("errors of the fixes", found, "lag (min)", "correlation (-)", "x"),
            Panel("whitened innovations", [*left, level(0.0)], "lag (s)", "correlation (-)"),
        ],
        height=2.6,
    )


SHADES = {"radial": colors.PAPER, "along the track": colors.COMPARISON, "across": colors.TRUTH}


def rmse(r: Results, part: str, name: str, what: str = "error") -> float:
    """RMSE of a filter or of the fixes, or RMS of the predicted σ, m."""
    return float(np.sqrt(np.nanmean(column(r, part, name, what)[REVOLUTION:])))


def sizes(r: Results) -> Figure:
    """RMSE and predicted σ by filter and by degree of gravity."""
    names = {f"{LINES[name].label}": (BEST, name) for name in NAMES if name != "without z_0"}
    degrees = {
        f"{n}, {LINES[name].label}": (f"degree {n}", name)
        for n in DEGREES
        for name in ("white", "colored")
    }

    def panel(title: str, flown: dict[str, tuple[str, str]], log: str = "") -> Panel:
        each = [[rmse(r, *one, what) for one in flown.values()] for what in ("error", "std")]
        heights = {"RMSE": (each[0], colors.COMPARISON), "predicted σ": (each[1], colors.ESTIMATE)}
        return Panel(
            title, [bars(list(flown), heights, across=True), *known], "position (m)", "", log
        )

    known = [level(rmse(r, BEST, "fixes"), label="fixes", color="black", upright=True)]
    return panels(
        panel(f"gravity to degree {DEGREE}", names),
        panel("by degree of gravity", degrees, "x"),
        height=3.2,
    )


def table_1(r: Results) -> Rows:
    """RMSE, predicted σ, NEES and NIS by degree of gravity and filter."""
    rows: Rows = [{"gravity": "", "filter": "fixes", "RMSE (m)": rmse(r, BEST, "fixes")}]
    rows[0] |= dict.fromkeys(("predicted σ (m)", "NEES/3", "NIS/3", "rejected"), "")
    for part, name in (
        (f"degree {n}", name)
        for n in DEGREES
        for name in (NAMES if n == DEGREE else ("white", "colored"))
    ):
        nees, nis = (
            float(np.nanmean(column(r, part, name, what)[REVOLUTION:])) for what in ("nees", "nis")
        )
        rows.append(
            {
                "gravity": part,
                "filter": name,
                "RMSE (m)": rmse(r, part, name),
                "predicted σ (m)": rmse(r, part, name, "std"),
                "NEES/3": nees,
                "NIS/3": nis,
                "rejected": r.value(part, f"{name}/rejected", 0),
            }
        )
    return rows


FIGURES = {
    "figure_01": (
        "Radial position errors of a real satellite, and their predicted 95 % range.",
        day,
    ),
    "figure_02": (
        "Bursts of errors. With a gate, a filter rejects its fixes for long times. Student's t "
        "also gives less weight to the steps that end a burst.",
        bursts,
    ),
    "figure_03": (
        "Autocorrelation of the fixes' errors, and of the whitened innovations of two filters.",
        autocorrelations,
    ),
    "figure_04": (
        "RMSE and predicted σ, by filter and by degree of gravity.",
        sizes,
    ),
}
TABLES = {
    "table_1": (
        "RMSE, predicted σ, NEES and NIS of the filters on 1 August, after the first orbit.",
        table_1,
    )
}
RECORDINGS = ["grace.rrd"]
LANES = {"white": "fixes without a gate", "white, gated": "fixes with a gate"}
"""Titles of the states of a filter's fixes."""
LARGER, THIN = 1e5, 3
"""Enlargement of the errors in the scene; every THIN-th epoch is recorded."""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recording among ``outputs``; returns its name. Needs rerun."""
    return showcase.write({RECORDINGS[0]: _shown(results)}, outputs)


def _shown(results: Results) -> Showcase:
    files, keep = results.parts[BEST].config, slice(None, None, THIN)
    log = read(files.fixes[0])
    truth = aligned(log, read(files.truth))
    still = orientation(log.times[keep])[0].mT
    place, local = matvec(still, truth[keep]) / 1e6, still @ axes(truth)[keep].mT
    est, drawn = dict[str, Estimate](), dict[str, tuple[Array, Array]]()
    for name in ("white", "colored", "robust"):
        error, cov, nees, nis = (
            results.get(BEST, f"{name}/{what}")[keep] for what in ("error", "cov", "nees", "nis")
        )
        est[name] = Estimate(
            LINES[name].label, LINES[name].color, error, cov[:, 0], nees[:, 0], nis[:, 0]
        )
        scale = LARGER / 1e6
        drawn[name] = matvec(local, error[:, 0]) * scale, local @ cov[:, 0] @ local.mT * scale**2
    fixes = results.get(BEST, "fixes")[keep]
    fixed = matvec(local, fixes) * LARGER / 1e6
    # The gate alone rejects; the three filters shown use every fix.
    lanes = {
        title: measurement_states(
            log.z[keep], np.isfinite(results.get(BEST, f"{name}/white")[keep])
        ).tolist()
        for name, title in LANES.items()
    }

    def scene(out: Recorder) -> None:
        out.globe("world/earth", earth.SEMI_MAJOR_M / 1e6)
        scenes.track(out, "world/truth", place, colors.TRUTH, "GRACE-A")
        out.points("world/fix", place + fixed, colors.MEASUREMENT, radius=2.0)
        for key, (error, cov) in drawn.items():
            scenes.track(out, f"world/{key}", place + error, LINES[key].color, cov=cov, radius=0.6)

    growing = [f"world/{name}/trail" for name in ("truth", *drawn)]
    return Showcase(
        "grace",
        NOTES,
        results.times(BEST)[keep],
        est,
        [Group("position", "m", slice(0, 3), axes=("radial", "along", "across"))],
        axes=np.eye(3),
        unit="m, radial, along, across",
        measured=fixes,
        nis_dof=3,
        scene=scene,
        spaces=[
            SceneView(
                "world",
                f"orbit, 1000 km, errors enlarged {LARGER:,.0f} times",
                (12.0, -16.0, 9.0),
                growing=growing,
            )
        ],
        legend={colors.MEASUREMENT: "GPS fixes"},
        parameters={key: tuple(value) for key, value in SETTINGS.items()},
        facts={"data": "GRACE-A, 2008-08-01", "dates": "GPS time"},
        states=lanes,
        start_date=str(EPOCH + np.timedelta64(round(float(log.times[0])), "s")),
    )


NOTES = """# GRACE-A, 1 August 2008: real GPS fixes and true positions

**Errors of fixes are correlated in time. The blue filter treats them as white and leaves the band
that it predicts. The orange one models their correlation and leaves its band only in a few bursts.
The slate one gives surprising fixes less weight, including the steps that end a burst.**

The fixes come every 10 s and use no model of the orbit. The true positions come from carrier phases
and have errors of 3 to 6 cm.
"""
