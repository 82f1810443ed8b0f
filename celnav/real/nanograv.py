"""Position of the Earth from arrival times of millisecond pulsars, 2004 to 2020 [Agazie2023], with
older ephemerides, which have errors.

We wrote these rules before we saw any result of the test years:

- Timing models are fitted to the years before 2017; the filters run over the later years without a
  new fit. A pulsar is used if it was observed for three years before 2017, on at least 30 days.
- Size and correlation of the noise of weekly fixes come from 2015 and 2016, with models fitted
  before 2015.
- A week has a fix if at least six pulsars were observed. With solitary pulsars alone, four suffice;
  they are tested separately because the orbits of the others were fitted to all years.
- Filters start with errors of 10 km and 0.1 m/s on each axis and a prior σ of 100 km for the Sun's
  error. They are evaluated after their first year.

DE440 is treated as the truth. The filters use older ephemerides, whose barycenter is displaced by
117 km, because DE440 includes bodies beyond Neptune [Park2021]. Relative to the Sun, the Earth's
orbit differs by 0.2 km in DE421 and by 1.1 km in DE405.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate, pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from celnav.analysis import metrics
from celnav.filters.model import Linear, Motion, Sensor
from celnav.filters.records import Epoch
from celnav.filters.sequential import ekf
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief, cholesky
from celnav.models.ephemeris import DAY_S, Tdb, de421
from celnav.models.noise import ar1_noise
from celnav.papers import citation
from celnav.papers.tstdkf import scenario as paper
from celnav.real.arrivals import (
    YEAR,
    Weeks,
    clocks,
    differences,
    read,
    remembered,
    transition,
    weekly,
)
from celnav.show import colors
from celnav.show.draw import MARKERS, STYLES, Line, Panel, bars, curve, level, panels
from celnav.show.figures import Rows
from celnav.show.plots import Curve, Plot
from celnav.show.showcase import SceneView, Showcase, write
from celnav.study.ledger import Number, Sentence, estimate, finding
from celnav.study.numbers import Decided, all_of, of
from celnav.study.study import Part, Results, Rngs, Study, evaluate_filters
from celnav.study.trial import Group, Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

TITLE = "Position of the Earth from millisecond pulsars"
CITATION = citation("Agazie2023")
INPUTS = ("nanograv",)
Arrays = dict[str, Array]
TUNED, FLOWN, END = 57023.0, 57754.0, 59072.0
"""MJD: 1 January 2015 and 2017, and the day after the last."""
SOLITARY = (
    "J0030+0451",
    "J0340+4130",
    "J0645+5158",
    "J0931-1902",
    "J1024-0719",
    "J1730-2304",
    "J1744-1134",
    "J1747-4036",
    "J1832-0836",
    "J1843-1113",
    "J1923+2515",
    "J1944+0907",
    "J2010-1323",
    "J2124-3358",
    "J2322+2057",
)
"""Pulsars without a companion, or with one whose orbital period is centuries."""
GROUPS = (Group("position", "km", slice(0, 3)),)
STARTED, SUN_KM, DRIFT_KM = np.repeat([10.0, 1e-4], 3), 100.0, 1.0
"""Standard deviations of the initial state (km, km/s), of the Sun's error and of its growth per
year (km)."""
FILTERS = ("ekf", "tkf", "tdkf", "tstdkf", "aug")


# -- parts -----------------------------------------------------------------------------------------
class Flight(NamedTuple):
    """The Earth's orbit about the Sun, with pulsar timing by DE440. old: ephemeris of the filters;
    DE440 if empty.
    """

    folder: Path
    old: str = ""


def tuned(folder: Path) -> tuple[float, float]:
    """Standard deviation (in predicted σ) and weekly correlation of the fixes' errors, in the two
    years before the test years.
    """
    before = clocks(folder, TUNED, FLOWN)
    y = weekly(before, [c.early for c in before], TUNED, FLOWN).y
    return float(np.sqrt(np.square(y).mean())), float((y[1:] * y[:-1]).sum() / np.square(y).sum())


def trial(c: Flight, _rngs: Rngs) -> Trial:
    """The filters of [Xu2023] on weekly fixes.

    The Earth's orbit about the Sun replaces the satellite's orbit about the Earth, and the Sun's
    ephemeris error replaces the Earth's. "drift" models an error of the Sun that grows linearly.
    "clocks" also does this, but uses arrival times instead of fixes, and so models persistent
    errors of timing models. The barycentric position is evaluated: orbit plus the Sun's error.
    """
    heard, years = clocks(c.folder, FLOWN, END), differences()
    observed = weekly(heard, [k.early for k in heard], FLOWN, END)
    day, t = observed.day, DAY_S * (observed.day - observed.day[0])
    earth, sun = (
        years[f"{c.old}/{body}"] if c.old else (lambda at: np.zeros((*np.shape(at), 3)))
        for body in ("earth", "sun")
    )
    truth = earth(day)
    z = observed.y + (observed.R @ truth[..., None])[..., 0]
    early = [k.early + k.seen(earth(k.arrivals.day + 0.5), False) for k in heard]

    level, F = tuned(c.folder)
    rates, past = (
        np.repeat([1e-10, 1e-17], 3),
        day - 6.0 * YEAR,
    )  # km/s, km/s^2: negligible process noise
    noise = ar1_noise(
        F * np.eye(3),
        np.zeros((6, 6)),
        np.zeros((6, 3)),
        level**2 * (1.0 - F**2) * np.eye(3),
        np.diag(rates**2),
    )
    step = np.sqrt(
        np.square(np.diff(years["de421/sun"](past) - years["de405/sun"](past), axis=0)).mean()
    )
    by_name = paper.filters(
        paper.Config(bias_prior_km=SUN_KM, walk_km=float(step)), paper.LINEAR, noise
    )
    for name, m in (("drift", 3), ("clocks", 12)):
        sensor = Sensor(Linear(lambda epoch: epoch.u[1]), R=np.eye(m))
        by_name[name] = ekf(Motion(Linear(lambda epoch: epoch.u[0]), Q=np.zeros((12, 12))), sensor)

    Phi = np.stack([transition(*pair) for pair in pairwise(day)])
    each = np.stack([block_diag(P, np.eye(6)) + 0.0 for P in Phi])
    each[:, 6:9, 9:] = np.diff(day)[:, None, None] / YEAR * np.eye(3)
    moves = np.stack(list(accumulate(each, lambda before, move: move @ before, initial=np.eye(12))))
    place = np.eye(3, 12) + np.eye(3, 12, 6)
    twelve = {
        "drift": (observed.R @ place / level, z / level),
        "clocks": remembered(heard, early, day, moves),
    }

    def epochs(name: str) -> Iterator[Epoch]:
        H, y = twelve.get(name, (observed.R, z))
        for k in range(1, len(day)):
            u = (
                (each[k - 1], H[k])
                if name in twelve
                else (Phi[k - 1], (t[k] - t[k - 1]) * np.eye(6), H[k])
            )
            yield Epoch(k, t[k], t[k] - t[k - 1], u, y[k][None], truth[k][None])

    def compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
        n = belief.mean.shape[-1]
        both = np.eye(3, n) + (np.eye(3, n, {9: 6, 12: 6, 18: 15}[n]) if n > 6 else 0.0)
        return belief.mean @ both.T - truth, cholesky(both @ belief.cov @ both.T)

    start = np.concatenate([earth(day[0]) - sun(day[0]), np.zeros(3)]) + STARTED
    return Trial(GROUPS, by_name, Gaussian(start[None], np.diag(STARTED**2)), epochs, compare)


def fly_all(c: Flight, rngs: Rngs) -> Arrays:
    """Errors, standard deviations and NEES of the filters, ``(T, 1, ...)``."""
    flown = trial(c, rngs)
    free = Gaussian(np.zeros((1, 6)), np.diag(np.repeat([SUN_KM, DRIFT_KM], 3) ** 2))
    whole = Gaussian(
        np.hstack([flown.prior.mean, free.mean]), block_diag(flown.prior.cov, free.cov)
    )
    return evaluate_filters(flown, FILTERS) | evaluate_filters(
        flown._replace(prior=whole), ["drift", "clocks"]
    )


def fixes(folder: Path, _rngs: Rngs) -> Arrays:
    """Weekly fixes in the test years, with all pulsars and with solitary pulsars alone."""
    out: Arrays = {}
    for name, least in {"all": 6, "solitary": 4}.items():
        heard = [
            c for c in clocks(folder, FLOWN, END) if name == "all" or c.arrivals.name in SOLITARY
        ]
        w = weekly(heard, [c.early for c in heard], FLOWN, END, least)
        arrays = {"day": w.day, "error": w.fix[:, None], "std": w.std[:, None], "heard": w.heard}
        out |= {f"{name}/{key}": values for key, values in arrays.items()} | {
            f"{name}/nees": np.square(w.y).sum(1)[:, None]
        }
    return out


PERIODS = np.unique(
    np.concatenate([np.geomspace(0.15, 40.0, 61), 1.0 + 0.04 * np.arange(-5, 6), [0.5]])
)
"""Years."""


def window(folder: Path, _rngs: Rngs) -> Arrays:
    """Visible part of an error of the Earth's position that exists in all years, without noise.

    Returns
    -------
    share: visible fraction of an oscillation by its period (years), in predicted σ. For errors of
    old ephemerides: ``shown (T, 1, 3)`` km, the error in the fixes, and the errors of Earth and
    Sun.
    """
    heard = clocks(folder, FLOWN, END)
    out: Arrays = {"periods": PERIODS}

    def shown(moved: Sequence[Array], learned: bool = True) -> Weeks:
        return weekly(
            heard, [c.seen(d, learned) for c, d in zip(heard, moved, strict=True)], FLOWN, END
        )

    angles = [2.0 * np.pi * (c.arrivals.day[:, None] - FLOWN) / YEAR / PERIODS for c in heard]
    swings = [
        (np.stack([np.cos(a), np.sin(a)], 1)[:, None, None] * np.eye(3)[:, :, None, None])
        for a in angles
    ]
    left, whole = (
        np.square(shown(swings, learned).y).sum((0, 1, 2, 3)) for learned in (True, False)
    )
    for old, body in product(("de421", "de405"), ("earth", "sun")):
        error = differences()[f"{old}/{body}"]
        w = shown([error(c.arrivals.day + 0.5) for c in heard])
        out |= {f"{old}/{body} shown": w.fix[:, None], f"{old}/{body}": error(w.day)[:, None]}
    return out | {"share": np.sqrt(left / whole)}


# -- rows ------------------------------------------------------------------------------------------
SHOWN = ("tkf", "tstdkf", "drift")
FLIGHTS = {"DE440": "", "DE405": "de405", "DE421": "de421"}
BLOCK, LONG = 8, 26
"""Block lengths of the bootstrap in weeks: for fixes, which are nearly independent, and for
filters.
"""


ADDED = (
    "2026-11-23: added because the first results did not separate the drift of the Sun's error "
    "from the memory of the timing models' errors."
)


def parts(_effort: float = 1.0, nanograv: Path | None = None) -> dict[str, Part]:
    """All parts of the study; ``nanograv``: folder of the arrival times."""
    if nanograv is None:
        return {}
    read(nanograv)  # raises for a wrong folder before anything is computed
    flown = {name: Part(fly_all, Flight(nanograv, old), cost=4.0) for name, old in FLIGHTS.items()}
    return {
        "fixes": Part(fixes, nanograv, cost=4.0),
        "window": Part(window, nanograv, cost=3.0),
        **flown,
    }


def squares(r: Results, part: str, name: str) -> Array:
    """Squared norms ``(T,)`` of errors; for filters after their first year."""
    square = np.square(r.get(part, f"{name}/error")).sum((1, 2))
    return np.asarray(
        square if part in ("fixes", "window") else square[r.times(part) > YEAR * DAY_S]
    )


def rms(part: str, name: str, low: float | None, most: float | None) -> Decided:
    """RMS norm of an error, km."""
    about, block = f"{part}, {name}: RMS error (km)", BLOCK if part == "fixes" else LONG
    return lambda r: estimate(about, metrics.rms, [squares(r, part, name)], (low, most), block)


def median(r: Results) -> Number:
    """Median norm of the errors of fixes, km."""
    return estimate(
        "median error (km)",
        lambda a: float(np.sqrt(np.median(a))),
        [squares(r, "fixes", "all")],
        block=BLOCK,
    )


def ratio(part: str, a: str, b: str, low: float | None, most: float | None) -> Decided:
    """RMS error ratio of filter ``a`` to ``b``."""
    about = f"{part}: RMS error, {a} over {b}"
    return lambda r: estimate(
        about, metrics.ratio, [squares(r, part, a), squares(r, part, b)], (low, most), LONG
    )


def claimed(part: str, a: str, b: str, low: float | None, most: float | None) -> Decided:
    """Mean NEES ratio of filter ``a`` to ``b``."""

    def number(r: Results) -> Number:
        late = r.times(part) > YEAR * DAY_S
        nees = [r.get(part, f"{name}/nees")[late, 0] for name in (a, b)]
        return estimate(
            f"{part}: NEES, {a} over {b}",
            lambda x, y: float(x.mean() / y.mean()),
            nees,
            (low, most),
            LONG,
        )

    return number


def consistency(part: str, name: str, low: float | None, most: float | None) -> Decided:
    """Mean NEES of three components, divided by three."""

    def number(r: Results) -> Number:
        nees = r.get(part, f"{name}/nees")[:, 0] / 3.0
        nees = nees if part == "fixes" else nees[r.times(part) > YEAR * DAY_S]
        return estimate(
            f"{part}, {name}: NEES / 3",
            np.mean,
            [nees],
            (low, most),
            BLOCK if part == "fixes" else LONG,
        )

    return number


def length(errors: Array) -> float:
    """RMS norm of errors ``(T, 1, 3)``."""
    return float(np.sqrt(np.square(errors).sum((1, 2)).mean()))


def size(name: str, label: str, low: float | None, most: float | None) -> Decided:
    """RMS norm of an array of the part "window", km, without sampling error."""
    return of("window", name, f"{label} (km)", (low, most), length)


def share(period: float, low: float | None, most: float | None) -> Decided:
    """Visible fraction of an oscillation with this period (years)."""
    label = f"visible fraction, period {period:g} years"
    return lambda r: Number(
        label,
        float(np.interp(period, r.get("window", "periods"), r.get("window", "share"))),
        (low, most),
    )


ROWS = (
    finding(
        "nanograv-fixes",
        "One week of arrival times gives the Earth's position to better than 20 km, the accuracy "
        "of [Deng2013] with four pulsars in a week.",
        all_of(rms("fixes", "all", None, 20.0), median),
        figure="figure_01",
        why="RMS error below 20 km. [Deng2013] found 20 km with data of the decade before, for an "
        "X-ray telescope on the way to Mars.",
        found="The RMS error of the fixes is {0} km, and the median error {1} km. The timing "
        "models are up to three and a half years old.",
    ),
    finding(
        "nanograv-honest",
        "The errors of the fixes agree with their predicted covariance.",
        consistency("fixes", "all", 0.5, 1.5),
        figure="figure_01",
        expected="undecided",
        why="NEES / 3 is 1 if the covariance is correct. Between 0.5 and 1.5 the predicted σ is "
        "correct to about a quarter.",
        found="The mean NEES / 3 is {0}.",
    ),
    finding(
        "nanograv-solitary",
        "Pulsars without a companion give fixes of the same quality. Nothing of their models was "
        "fitted in the test years.",
        all_of(rms("fixes", "solitary", None, 20.0), consistency("fixes", "solitary", 0.5, 1.5)),
        expected="undecided",
        why="as for all pulsars: RMS error below 20 km, NEES / 3 between 0.5 and 1.5",
        found="The RMS error is {0} km, and NEES / 3 is {1}.",
    ),
    finding(
        "nanograv-swallowed",
        "An old ephemeris has an error of 100 km. Timing models fitted with it hide all but 1 km.",
        all_of(
            size("de405/earth", "error of DE405", 100.0, None),
            size("de405/earth shown", "visible error of DE405", None, 1.0),
            size("de421/earth", "error of DE421", 100.0, None),
            size("de421/earth shown", "visible error of DE421", None, 1.0),
        ),
        figure="figure_02",
        why="the visible part is below 1 % of 100 km",
        found="The error of DE405 is {0} km, of which {1} km are visible. For DE421 it is {2} km, "
        "of which {3} km are visible.",
    ),
    finding(
        "nanograv-window",
        "Timing models hide oscillations with periods of a year and of decades, and no others.",
        all_of(
            share(1.0, None, 0.1),
            share(40.0, None, 0.1),
            share(0.5, 0.5, None),
            share(3.0, 0.5, None),
        ),
        figure="figure_02",
        why="hidden means a visible fraction below 0.1, visible means above 0.5. A fraction above "
        "1 means that the models extrapolate a wrong trend.",
        found="The visible fraction is {0} for a period of 1 year, {1} for 40 years, {2} for half "
        "a year, and {3} for 3 years.",
    ),
    finding(
        "nanograv-ignored",
        "An EKF that does not model the ephemeris error fails if the timing models were fitted "
        "with another ephemeris.",
        all_of(
            ratio("DE405", "ekf", "tkf", 2.0, None),
            *(rms("DE405", name, None, None) for name in ("ekf", *SHOWN)),
        ),
        figure="figure_03",
        why="its error is at least twice that of a two-stage filter, which models the error",
        found="Its RMS error is {1} km, {0} times that of a two-stage filter ({2} km). With strong "
        "tracking the error is {3} km, and with a linearly growing Sun's error {4} km.",
    ),
    finding(
        "nanograv-tracking",
        "Strong tracking is more accurate than an ordinary second stage, as [Xu2023] states.",
        all_of(
            ratio("DE405", "tstdkf", "tkf", None, 1.0), ratio("DE421", "tstdkf", "tkf", None, 1.0)
        ),
        figure="figure_03",
        expected="undecided",
        why="a smaller error, as the paper states for every setting with colored noise",
        found="Its error is {0} (DE405) and {1} (DE421) times that of the ordinary filter.",
    ),
    finding(
        "nanograv-claims",
        "Filters that treat fixes of different weeks as independent are overconfident. A filter "
        "that models the persistent errors of timing models is consistent.",
        all_of(
            consistency("DE440", "ekf", 2.0, None),
            *(consistency(by, "clocks", None, 1.5) for by in ("DE440", "DE405")),
        ),
        figure="figure_03",
        expected="undecided",
        why="NEES / 3 is at least 2 for the EKF, and at most 1.5 for the filter with the memory",
        found="NEES / 3 of the EKF is {0} with the correct ephemeris. For the other filter it is "
        "{1}, and {2} with DE405.",
    ),
    finding(
        "nanograv-drift",
        "A filter whose Sun's error grows linearly is more accurate than TKF and TSTDKF.",
        all_of(
            *(
                ratio(by, "drift", name, None, 1.0)
                for by in ("DE405", "DE421")
                for name in ("tkf", "tstdkf")
            )
        ),
        why="a smaller error than each of them",
        figure="figure_03",
        revised=ADDED,
        found="With DE405 its error is {0} (TKF) and {1} (TSTDKF) times theirs, with DE421 {2} and "
        "{3} times.",
    ),
    finding(
        "nanograv-memory",
        "Arrival times instead of fixes do not make that filter more accurate, but several times "
        "less overconfident.",
        all_of(
            ratio("DE405", "clocks", "drift", 0.5, 2.0),
            *(claimed(by, "drift", "clocks", 2.0, None) for by in FLIGHTS),
        ),
        why="the errors agree within a factor of 2; the NEES with fixes is at least twice that "
        "with arrival times",
        figure="figure_03",
        revised=ADDED,
        found="With arrival times the error is {0} times that with fixes. The NEES with fixes is "
        "{1}, {2} and {3} times that with arrival times (DE440, DE405, DE421).",
    ),
)

STUDY = Study(
    "nanograv",
    GROUPS,
    trial,
    parts,
    ROWS,
    says="NANOGrav's millisecond pulsars, timed until 2017, give the Earth's position in the years "
    "after. How accurate is it? How do the filters of [Xu2023] cope with ephemerides that had real "
    "errors?",
    found=(
        Sentence(
            "Weekly fixes have an RMS error of {nanograv-fixes[0]:.2f} km and a median error of "
            "{nanograv-fixes[1]:.2f} km.",
            {"nanograv-fixes": "shown"},
        ),
        Sentence(
            "DE405 and DE421 have errors of {nanograv-swallowed[0]:.0f} km. Timing models fitted "
            "with them hide all but {nanograv-swallowed[1]:.1f} and "
            "{nanograv-swallowed[3]:.1f} km.",
            {"nanograv-swallowed": "shown"},
        ),
        Sentence(
            "With timing models from another ephemeris the error is {nanograv-ignored[1]:.0f} km "
            "(EKF), {nanograv-ignored[2]:.1f} km (two stages) and {nanograv-ignored[3]:.1f} km "
            "(strong tracking). It is {nanograv-ignored[4]:.1f} km if the filter lets the "
            "ephemeris error grow linearly.",
            {"nanograv-ignored": "shown"},
        ),
        Sentence(
            "A filter that models the persistent errors of the timing models is the least "
            "overconfident.",
            {"nanograv-memory": "shown"},
        ),
    ),
    figure="figure_02",
)


# -- figures, table, recording ---------------------------------------------------------------------
AXES, SHADES = ("x", "y", "z"), (colors.COMPARISON, colors.ESTIMATE, colors.TRUTH)
LINES = {
    "ekf": Line("EKF", colors.OPEN_LOOP, STYLES[2]),
    "tkf": Line("TKF", colors.COMPARISON, STYLES[4]),
    "tdkf": Line("TDKF", colors.FAINT, STYLES[1]),
    "tstdkf": Line("TSTDKF", colors.ESTIMATE),
    "aug": Line("augmented", colors.PAPER, STYLES[3]),
    "drift": Line("Sun's error grows linearly", colors.MEASUREMENT, width=2.5),
    "clocks": Line("the same, with arrival times", colors.TRUTH, STYLES[5], 1.9),
}


def weeks(r: Results) -> Figure:
    """Weekly fixes with their predicted standard deviation."""
    t, error, std = (
        2017.0 + (r.get("fixes", "all/day") - FLOWN) / YEAR,
        r.get("fixes", "all/error")[:, 0],
        r.get("fixes", "all/std")[:, 0],
    )
    dots: Any = {"linestyle": "", "marker": ".", "markersize": 3}
    above = [
        curve(t, error[:, i], label=name, color=c, **dots | {"marker": MARKERS[i]})
        for i, (name, c) in enumerate(zip(AXES, SHADES, strict=True))
    ]
    below = [
        curve(t, std, Line("predicted σ", colors.SIGMA)),
        curve(t, np.linalg.norm(error, axis=1), color="black", label="error", **dots),
    ]
    more = {"ylim": (-1.0, 1.0)}
    return panels(
        Panel("Weekly fixes of the Earth minus DE440", above, "year", "error (km)", more=more),
        Panel("Norm of the error, and predicted σ", below, "year", "km", "y"),
        height=2.6,
        sharex=True,
    )


def hidden(r: Results) -> Figure:
    """Visible fraction of an oscillation, and of the errors of old ephemerides."""
    swing = [
        curve(r.get("window", "periods"), r.get("window", "share"), color=colors.COMPARISON),
        level(1.0),
    ]
    off, left = (
        [length(r.get("window", f"{old}/{what}")) for old in ("de405", "de421")]
        for what in ("earth", "earth shown")
    )
    error = bars(
        ("DE405", "DE421"),
        {"error": (off, colors.PAPER), "visible part": (left, colors.COMPARISON)},
    )
    return panels(
        [
            Panel(
                "Oscillation after the fit",
                swing,
                "period (years)",
                "visible fraction (-)",
                "xy",
            ),
            Panel(
                "Error of the Earth, 2017 to 2020",
                [error],
                "",
                "RMS error (km)",
                "y",
                {"ylim": (0.05, 500.0)},
            ),
        ],
        height=2.6,
    )


def flights(r: Results) -> Figure:
    """Errors of the filters for each ephemeris."""
    rows = []
    for part in FLIGHTS:
        t = r.times(part) / DAY_S / YEAR
        lengths = {
            name: np.linalg.norm(r.get(part, f"{name}/error")[:, 0], axis=1) for name in LINES
        }
        rows.append(
            Panel(
                f"Earth by {part}",
                [curve(t, lengths[name], LINES[name]) for name in LINES],
                "time (years)",
                "error (km)",
                "y",
            )
        )
    return panels(*rows, height=2.0, sharex=True)


def table(r: Results) -> Rows:
    """RMS errors and NEES of the filters for each ephemeris."""
    rows: Rows = []
    for part, name in product(FLIGHTS if FLIGHTS.keys() <= r.data.keys() else (), LINES):
        error, nees = rms(part, name, None, None)(r), consistency(part, name, None, None)(r)
        rows.append(
            {
                "ephemeris": part,
                "filter": name,
                "RMS error (km)": error.value,
                "NEES / 3": nees.value,
            }
        )
    return rows


FIGURES = {
    "figure_01": (
        "Errors of weekly fixes of the Earth from pulsars alone, with their predicted σ.",
        weeks,
    ),
    "figure_02": (
        "What fitted timing models hide: visible fraction of an oscillation of the Earth by its "
        "period, and errors of old ephemerides.",
        hidden,
    ),
    "figure_03": (
        "Position errors of the filters with DE440, DE405 and DE421 as ephemeris.",
        flights,
    ),
}
TABLES = {"table_1": ("RMS error and NEES by ephemeris and filter, after the first year.", table)}
RECORDINGS = ["nanograv.rrd"]


def record(r: Results, outputs: Outputs) -> list[str]:
    """The pulsars around the barycenter, the Earth on its orbit, and its fixes with errors enlarged
    ten million times.
    """
    folder: Path = r.parts["fixes"].config
    stars = np.stack([c.arrivals.n for c in clocks(folder, FLOWN, END)])
    day, error = r.get("fixes", "all/day"), r.get("fixes", "all/error")[:, 0]
    earth = de421().state("earth", Tdb(2400000.5, day)).position / 1.495978707e8

    def scene(out: Recorder) -> None:
        out.path("sky/pulsars", [np.stack([1.5 * n, 1.9 * n]) for n in stars], colors.STAR)
        out.trail("sky/earth", earth, colors.TRUTH)
        out.points("sky/earth/now", earth, colors.TRUTH, radius=5.0, label="Earth")
        out.points("sky/fix", earth + error / 15.0, colors.ESTIMATE, radius=4.0)

    plots = {
        axis: Plot(
            f"error of the fix, {axis} (km)",
            {"fix": Curve(error[:, i], colors.ESTIMATE, "weekly fix")},
        )
        for i, axis in enumerate("xyz")
    }
    notes = "# The Earth's position from millisecond pulsars\nRays point to the pulsars. Unit: AU."
    sky = SceneView("sky", "Earth and pulsars", (2.5, -2.5, 1.8), growing=("sky/earth",))
    show = Showcase(
        "nanograv",
        notes,
        DAY_S * (day - day[0]),
        scene=scene,
        spaces=[sky],
        legend={
            colors.ESTIMATE: "weekly fixes, errors enlarged 10 million times",
            colors.STAR: "pulsars",
        },
        plots={"fix": plots},
    )
    return write({"nanograv.rrd": show}, outputs)
