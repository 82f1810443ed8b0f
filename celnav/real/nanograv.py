"""The Earth's place by arrival times of millisecond pulsars, 2004 to 2020 [Agazie2023], and
ephemerides that were wrong about it.

Written down before a result of the years flown was seen:

- Timing models are fitted on the years before 2017, and the rest is flown; nothing is fitted again.
  A pulsar takes part that was
  observed for three years before, on 30 days or more.
- Level and color of the noise of weekly fixes are those of 2015 and 2016, with models fitted before
  2015.
- A week has a fix if six pulsars or more were heard in it; or four of the solitary ones where they
  are flown alone, since the
  orbits of the others were fitted on all years.
- Filters start 10 km and 0.1 m/s off on each axis, know the Sun's error to 100 km, and are judged
  after their first year.

DE440 counts as the truth. Older ephemerides are what filters are given wrong: their barycenter lies
117 km off, since DE440 counts what is beyond Neptune [Park2021]. About the Sun the Earth's orbit
differs by 0.2 km in DE421, by 1.1 km in DE405.
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
from celnav.show.draw import Line, Panel, bars, curve, level, panels
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

TITLE = "The Earth's place by millisecond pulsars"
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
"""Without a companion whose orbit takes less than centuries."""
GROUPS = (Group("position", "km", slice(0, 3)),)
STARTED, SUN_KM, DRIFT_KM = np.repeat([10.0, 1e-4], 3), 100.0, 1.0
"""Deviations of the start, km and km/s; of the Sun's error, and of its growth in a year."""
FILTERS = ("ekf", "tkf", "tdkf", "tstdkf", "aug")


# -- flights ---------------------------------------------------------------------------------------
class Flight(NamedTuple):
    """The Earth around the Sun, among pulsars timed with DE440, by an older ephemeris, or by DE440
    ("").
    """

    folder: Path
    old: str = ""


def tuned(folder: Path) -> tuple[float, float]:
    """Level and color of the noise of fixes, in claimed deviations, in the years before those that
    are flown.
    """
    before = clocks(folder, TUNED, FLOWN)
    y = weekly(before, [c.early for c in before], TUNED, FLOWN).y
    return float(np.sqrt(np.square(y).mean())), float((y[1:] * y[:-1]).sum() / np.square(y).sum())


def trial(c: Flight, _rngs: Rngs) -> Trial:
    """The filters of [Xu2023] on weekly fixes: the Earth about the Sun for a satellite about the
    Earth, the Sun's place for the Earth's. "drift" lets the Sun's error grow evenly, and "clocks"
    has arrivals in place of fixes, so that it knows that a timing model's error stays. The
    barycentric place is judged, orbit and Sun's error together."""
    heard, years = clocks(c.folder, FLOWN, END), differences()
    seen = weekly(heard, [k.early for k in heard], FLOWN, END)
    day, t = seen.day, DAY_S * (seen.day - seen.day[0])
    earth, sun = (
        years[f"{c.old}/{body}"] if c.old else (lambda at: np.zeros((*np.shape(at), 3)))
        for body in ("earth", "sun")
    )
    truth = earth(day)
    z = seen.y + (seen.R @ truth[..., None])[..., 0]
    early = [k.early + k.seen(earth(k.arrivals.day + 0.5), False) for k in heard]

    level, F = tuned(c.folder)
    rates, past = np.repeat([1e-10, 1e-17], 3), day - 6.0 * YEAR  # km/s, km/s^2: as good as none
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
    known = paper.filters(
        paper.Config(bias_prior_km=SUN_KM, walk_km=float(step)), paper.LINEAR, noise
    )
    for name, m in (("drift", 3), ("clocks", 12)):
        sensor = Sensor(Linear(lambda epoch: epoch.u[1]), R=np.eye(m))
        known[name] = ekf(Motion(Linear(lambda epoch: epoch.u[0]), Q=np.zeros((12, 12))), sensor)

    Phi = np.stack([transition(*pair) for pair in pairwise(day)])
    each = np.stack([block_diag(P, np.eye(6)) + 0.0 for P in Phi])
    each[:, 6:9, 9:] = np.diff(day)[:, None, None] / YEAR * np.eye(3)
    moves = np.stack(list(accumulate(each, lambda before, move: move @ before, initial=np.eye(12))))
    place = np.eye(3, 12) + np.eye(3, 12, 6)
    twelve = {
        "drift": (seen.R @ place / level, z / level),
        "clocks": remembered(heard, early, day, moves),
    }

    def epochs(name: str) -> Iterator[Epoch]:
        H, y = twelve.get(name, (seen.R, z))
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
    return Trial(GROUPS, known, Gaussian(start[None], np.diag(STARTED**2)), epochs, compare)


def fly_all(c: Flight, rngs: Rngs) -> Arrays:
    """Errors, deviations, NEES of the filters, ``(T, 1, ...)``."""
    flown = trial(c, rngs)
    free = Gaussian(np.zeros((1, 6)), np.diag(np.repeat([SUN_KM, DRIFT_KM], 3) ** 2))
    whole = Gaussian(
        np.hstack([flown.prior.mean, free.mean]), block_diag(flown.prior.cov, free.cov)
    )
    return evaluate_filters(flown, FILTERS) | evaluate_filters(
        flown._replace(prior=whole), ["drift", "clocks"]
    )


def fixes(folder: Path, _rngs: Rngs) -> Arrays:
    """Weekly fixes of the years flown: with all pulsars, and with solitary ones alone."""
    out: Arrays = {}
    for name, least in {"all": 6, "solitary": 4}.items():
        heard = [
            c for c in clocks(folder, FLOWN, END) if name == "all" or c.arrivals.name in SOLITARY
        ]
        w = weekly(heard, [c.early for c in heard], FLOWN, END, least)
        found = {"day": w.day, "error": w.fix[:, None], "std": w.std[:, None], "heard": w.heard}
        out |= {f"{name}/{key}": values for key, values in found.items()} | {
            f"{name}/nees": np.square(w.y).sum(1)[:, None]
        }
    return out


PERIODS = np.unique(
    np.concatenate([np.geomspace(0.15, 40.0, 61), 1.0 + 0.04 * np.arange(-5, 6), [0.5]])
)
"""Years."""


def window(folder: Path, _rngs: Rngs) -> Arrays:
    """What is left to see, without noise, of an Earth that is elsewhere since always: ``share`` in
    claimed deviations, by period of a swing; of errors of old ephemerides ``shown (T, 1, 3)`` km by
    fixes, and what the errors of Earth and Sun are."""
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


# -- what is found ---------------------------------------------------------------------------------
SHOWN = ("tkf", "tstdkf", "drift")
FLIGHTS = {"DE440": "", "DE405": "de405", "DE421": "de421"}
BLOCK, LONG = 8, 26
"""Weeks that are drawn together: of fixes, of which neighbors are nearly independent, and of
filters.
"""


ADDED = (
    "2026-11-23: added when the first results did not tell the drift of the Sun's error from the "
    "memory of the clocks."
)


def parts(_effort: float = 1.0, nanograv: Path | None = None) -> dict[str, Part]:
    """All that is computed; ``nanograv``: folder of the arrival times."""
    if nanograv is None:
        return {}
    read(nanograv)  # what is no such folder is refused before anything is computed
    flown = {name: Part(fly_all, Flight(nanograv, old), cost=4.0) for name, old in FLIGHTS.items()}
    return {
        "fixes": Part(fixes, nanograv, cost=4.0),
        "window": Part(window, nanograv, cost=3.0),
        **flown,
    }


def squares(r: Results, part: str, name: str) -> Array:
    """Squared lengths ``(T,)`` of errors, of filters after their first year."""
    square = np.square(r.get(part, f"{name}/error")).sum((1, 2))
    return np.asarray(
        square if part in ("fixes", "window") else square[r.times(part) > YEAR * DAY_S]
    )


def rms(part: str, name: str, low: float | None, most: float | None) -> Decided:
    """RMS length of an error, km."""
    about, block = f"{part}, {name}: RMS error (km)", BLOCK if part == "fixes" else LONG
    return lambda r: estimate(about, metrics.rms, [squares(r, part, name)], (low, most), block)


def median(r: Results) -> Number:
    """Median length of the errors of fixes, km."""
    return estimate(
        "median error (km)",
        lambda a: float(np.sqrt(np.median(a))),
        [squares(r, "fixes", "all")],
        block=BLOCK,
    )


def ratio(part: str, a: str, b: str, low: float | None, most: float | None) -> Decided:
    """RMS error of a filter over that of another."""
    about = f"{part}: RMS of {a} / {b}"
    return lambda r: estimate(
        about, metrics.ratio, [squares(r, part, a), squares(r, part, b)], (low, most), LONG
    )


def claimed(part: str, a: str, b: str, low: float | None, most: float | None) -> Decided:
    """NEES of a filter over that of another."""

    def number(r: Results) -> Number:
        late = r.times(part) > YEAR * DAY_S
        nees = [r.get(part, f"{name}/nees")[late, 0] for name in (a, b)]
        return estimate(
            f"{part}: NEES of {a} / {b}",
            lambda x, y: float(x.mean() / y.mean()),
            nees,
            (low, most),
            LONG,
        )

    return number


def consistency(part: str, name: str, low: float | None, most: float | None) -> Decided:
    """Mean NEES of three components over three."""

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
    """RMS length of errors ``(T, 1, 3)``."""
    return float(np.sqrt(np.square(errors).sum((1, 2)).mean()))


def size(name: str, label: str, low: float | None, most: float | None) -> Decided:
    """RMS length of an array of the window, km: no sampling error."""
    return of("window", name, f"{label} (km)", (low, most), length)


def share(period: float, low: float | None, most: float | None) -> Decided:
    """What is left of a swing of a period."""
    label = f"share of a swing of {period:g} years"
    return lambda r: Number(
        label,
        float(np.interp(period, r.get("window", "periods"), r.get("window", "share"))),
        (low, most),
    )


ROWS = (
    finding(
        "nanograv-fixes",
        "A week of arrival times places the Earth to better than 20 km, as four pulsars in a week "
        "[Deng2013].",
        all_of(rms("fixes", "all", None, 20.0), median),
        figure="figure_01",
        why="20 km is what was found with data of a decade before, for an X-ray telescope on its "
        "way to Mars.",
        found="The fixes err {0} km RMS, {1} in the median, with timing models that are up to "
        "three and a half years old.",
    ),
    finding(
        "nanograv-honest",
        "Fixes are as good as they claim.",
        consistency("fixes", "all", 0.5, 1.5),
        figure="figure_01",
        expected="undecided",
        why="NEES over its dimension is 1 if claims are right; between a half and one and a half "
        "they are to a quarter.",
        found="Mean NEES / 3 {0}.",
    ),
    finding(
        "nanograv-solitary",
        "Pulsars without companion, of which nothing was fitted in the years flown, do as well.",
        all_of(rms("fixes", "solitary", None, 20.0), consistency("fixes", "solitary", 0.5, 1.5)),
        expected="undecided",
        why="As above.",
        found="They err {0} km, NEES / 3 is {1}.",
    ),
    finding(
        "nanograv-swallowed",
        "An old ephemeris is wrong by 100 km, of which its own timing models leave less than 1 km.",
        all_of(
            size("de405/earth", "error of DE405", 100.0, None),
            size("de405/earth shown", "DE405, left to see", None, 1.0),
            size("de421/earth", "error of DE421", 100.0, None),
            size("de421/earth shown", "DE421, left to see", None, 1.0),
        ),
        figure="figure_02",
        why="1 % of the error.",
        found="DE405 errs {0} km and shows {1}, DE421 {2} and {3}.",
    ),
    finding(
        "nanograv-window",
        "Timing models hide swings of a year and of decades, and no others.",
        all_of(
            share(1.0, None, 0.1),
            share(40.0, None, 0.1),
            share(0.5, 0.5, None),
            share(3.0, 0.5, None),
        ),
        figure="figure_02",
        why="Hidden is less than a tenth; seen is more than a half. Above 1 the models carry on a "
        "wrong trend.",
        found="Left are {0} of a swing of a year, {1} of 40 years, {2} of half a year, {3} of "
        "three.",
    ),
    finding(
        "nanograv-ignored",
        "An ephemeris error that timing models did not learn makes an EKF useless that does not "
        "know of it.",
        all_of(
            ratio("DE405", "ekf", "tkf", 2.0, None),
            *(rms("DE405", name, None, None) for name in ("ekf", *SHOWN)),
        ),
        figure="figure_03",
        why="Twice the error of a filter that does.",
        found="It errs {0} times what a two-stage filter errs: {1} km, and {2}; strong tracking "
        "{3}, growing evenly {4}.",
    ),
    finding(
        "nanograv-tracking",
        "Strong tracking is better than a plain second stage, as [Xu2023] has it.",
        all_of(
            ratio("DE405", "tstdkf", "tkf", None, 1.0), ratio("DE421", "tstdkf", "tkf", None, 1.0)
        ),
        figure="figure_03",
        expected="undecided",
        why="What the paper says of every setting with colored noise.",
        found="Its error is {0} and {1} times as large.",
    ),
    finding(
        "nanograv-claims",
        "Filters that take fixes of different weeks for independent are overconfident; one that "
        "knows "
        "that those of timing models stay is consistent.",
        all_of(
            consistency("DE440", "ekf", 2.0, None),
            *(consistency(by, "clocks", None, 1.5) for by in ("DE440", "DE405")),
        ),
        figure="figure_03",
        expected="undecided",
        why="Twice the claimed variance, and no more than one and a half times.",
        found="NEES / 3 of the EKF is {0} where its ephemeris is right, that of the other {1}, "
        "and {2} with DE405.",
    ),
    finding(
        "nanograv-drift",
        "A filter that lets the Sun's error grow evenly beats two stages, boosted or not.",
        all_of(
            *(
                ratio(by, "drift", name, None, 1.0)
                for by in ("DE405", "DE421")
                for name in ("tkf", "tstdkf")
            )
        ),
        why="Better than each.",
        figure="figure_03",
        revised=ADDED,
        found="Its error is {0} and {1} of theirs with DE405, {2} and {3} with DE421.",
    ),
    finding(
        "nanograv-memory",
        "Arrivals in place of fixes make that filter no better, but several times more honest.",
        all_of(
            ratio("DE405", "clocks", "drift", 0.5, 2.0),
            *(claimed(by, "drift", "clocks", 2.0, None) for by in FLIGHTS),
        ),
        why="The same to a factor of two; twice the ratio of errors to claims, in squares.",
        figure="figure_03",
        revised=ADDED,
        found="Its error is {0} as large; NEES with fixes is {1}, {2} and {3} times as large, by "
        "DE440, DE405 and DE421.",
    ),
)

STUDY = Study(
    "nanograv",
    GROUPS,
    trial,
    parts,
    ROWS,
    says="NANOGrav's millisecond pulsars, timed until 2017, tell where the Earth was in the years "
    "after. What can they see of it, "
    "and what do the filters of the pulsar paper make of ephemerides that were really wrong?",
    found=(
        Sentence(
            "Weekly fixes err {nanograv-fixes[0]:.2f} km RMS, {nanograv-fixes[1]:.2f} in the "
            "median.",
            {"nanograv-fixes": "shown"},
        ),
        Sentence(
            "DE405 and DE421 are wrong by {nanograv-swallowed[0]:.0f} km, but timing models made "
            "with them hide all but "
            "{nanograv-swallowed[1]:.1f} and {nanograv-swallowed[3]:.1f} km.",
            {"nanograv-swallowed": "shown"},
        ),
        Sentence(
            "Where they were made with another, an EKF errs by {nanograv-ignored[1]:.0f} km, two "
            "stages by "
            "{nanograv-ignored[2]:.1f}, strong tracking by {nanograv-ignored[3]:.1f}, a filter "
            "that lets the error grow by "
            "{nanograv-ignored[4]:.1f}.",
            {"nanograv-ignored": "shown"},
        ),
        Sentence(
            "Least overconfident of them is the one that remembers its clocks.",
            {"nanograv-memory": "shown"},
        ),
    ),
    figure="figure_02",
)


# -- shown -----------------------------------------------------------------------------------------
AXES, SHADES = ("x", "y", "z"), (colors.COMPARISON, colors.ESTIMATE, colors.TRUTH)
LINES = {
    "ekf": Line("EKF", colors.OPEN_LOOP),
    "tkf": Line("TKF", colors.COMPARISON),
    "tdkf": Line("TDKF", colors.FAINT, "--", 0.9),
    "tstdkf": Line("TSTDKF", colors.ESTIMATE),
    "aug": Line("augmented", colors.REFERENCE),
    "drift": Line("Sun's error grows evenly", colors.MEASUREMENT, width=1.9),
    "clocks": Line("so, and knows its clocks", colors.TRUTH, width=1.9),
}


def weeks(r: Results) -> Figure:
    """Fixes with what they claim."""
    t, error, std = (
        2017.0 + (r.get("fixes", "all/day") - FLOWN) / YEAR,
        r.get("fixes", "all/error")[:, 0],
        r.get("fixes", "all/std")[:, 0],
    )
    dots: Any = {"linestyle": "", "marker": ".", "markersize": 4}
    above = [
        curve(t, error[:, i], label=name, color=c, **dots)
        for i, (name, c) in enumerate(zip(AXES, SHADES, strict=True))
    ]
    below = [
        curve(t, std, Line("claimed", colors.SIGMA)),
        curve(t, np.linalg.norm(error, axis=1), color="black", label="length", **dots),
    ]
    more = {"ylim": (-1.0, 1.0)}
    return panels(
        Panel("Weekly fixes of the Earth, less DE440", above, "year", "error (km)", more=more),
        Panel("Their length, and what they claim", below, "year", "km", "y"),
        size=(8.0, 5.6),
        sharex=True,
    )


def hidden(r: Results) -> Figure:
    """What is left of a swing, and of the errors of old ephemerides."""
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
        {"how wrong it is": (off, colors.PAPER), "left to see": (left, colors.COMPARISON)},
    )
    return panels(
        [
            Panel(
                "What timing models leave of a swing",
                swing,
                "period (years)",
                "share that is seen",
                "xy",
            ),
            Panel(
                "The Earth's place, 2017 to 2020",
                [error],
                "",
                "RMS (km)",
                "y",
                {"ylim": (0.05, 500.0)},
            ),
        ],
        size=(10.0, 3.6),
    )


def flights(r: Results) -> Figure:
    """Errors of the filters, by ephemeris."""
    row = []
    for part in FLIGHTS:
        t = r.times(part) / DAY_S / YEAR
        lengths = {
            name: np.linalg.norm(r.get(part, f"{name}/error")[:, 0], axis=1) for name in LINES
        }
        row.append(
            Panel(
                f"Earth by {part}",
                [curve(t, lengths[name], LINES[name]) for name in LINES],
                "years",
                "error (km)",
                "y",
            )
        )
    return panels(row, size=(11.0, 4.0), sharey=True)


def table(r: Results) -> Rows:
    """Filters by ephemeris."""
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
    "figure_01": ("Weekly fixes of the Earth by pulsars alone.", weeks),
    "figure_02": (
        "What timing models hide: a swing of the Earth by its period, and the errors of old "
        "ephemerides.",
        hidden,
    ),
    "figure_03": ("Errors of the filters with a right ephemeris and with two wrong ones.", flights),
}
TABLES = {"table_1": ("Filters and ephemerides, after the first year.", table)}
RECORDINGS = ["nanograv.rrd"]


def record(r: Results, outputs: Outputs) -> list[str]:
    """The pulsars around the barycenter, the Earth on its way, and its fixes ten million times as
    far from it as they are.
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
            f"fix {axis}, error in km", {"fix": Curve(error[:, i], colors.ESTIMATE, "weekly fix")}
        )
        for i, axis in enumerate("xyz")
    }
    notes = "# The Earth by millisecond pulsars\nRays point to the pulsars; units are AU."
    sky = SceneView("sky", "Earth and pulsars", (2.5, -2.5, 1.8), growing=("sky/earth",))
    show = Showcase(
        "nanograv",
        notes,
        DAY_S * (day - day[0]),
        scene=scene,
        spaces=[sky],
        legend={colors.ESTIMATE: "weekly fixes, errors times 10 million", colors.STAR: "pulsars"},
        plots={"fix": plots},
    )
    return write({"nanograv.rrd": show}, outputs)
