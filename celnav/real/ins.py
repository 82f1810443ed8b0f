"""A car with a consumer-grade IMU and RTK fixes, with repeated simulated outages of 15 s
[GnssImu2025].

Settings come from the data sheet, from the receiver, and from the noise in the first half minute,
while the car is at rest. A factor multiplies this noise: the element of `FACTORS` with the largest
likelihood of the fixes in the first two minutes, outside outages. The owner of the log provides the
mounting angles, the delay `LATE_S` of the samples, and the outages.

This is not a blind test. We knew the errors in outages when we chose the additional states and
sensors, with the first values tried, and when we introduced the factor.

Standstill is not detected. Limits on the IMU's vibration that accept the car's first rest also
accept seconds of a ride at 10 m/s. In real time only fixes show a rest, and they already measure
the speed. With measurements of standstill from fixes, the largest drift with wheels increased and
the median drift decreased, each by at most half a meter.

A first evaluation of the antenna's position neglected the estimated lag. The smoother's NEES of 150
revealed this mistake.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import celnav
from celnav.filters.merge import Merged, merge
from celnav.filters.records import Epoch
from celnav.filters.run import run
from celnav.filters.smoother import smooth
from celnav.gaussian import attitude
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.models import earth, inertial
from celnav.papers import citation
from celnav.real import found
from celnav.real.drive import read_imu, read_pos
from celnav.show import colors
from celnav.show.draw import Line, Panel, bars, panels
from celnav.show.figures import Rows
from celnav.study.ledger import Bounds, Number, Sentence, check, estimate, finding
from celnav.study.numbers import Decided, of
from celnav.study.study import Part, Results, Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs

TITLE = "A car with an inertial unit, without fixes for 15 s"
CITATION = citation("GnssImu2025")
INPUTS = ("ins",)
FILES = ("imu*.csv*", "imu*.tag", "gnss*.pos*")

MOUNT = np.radians([180.0, -6.79, 185.35])  # roll, pitch, yaw of the unit's axes
LEVER = np.array([0.0, -0.05, 0.0])  # m, from the unit to the antenna: forward, right, down
LATE_S = 0.125
GYRO_WALK = np.radians(3.8e-5)  # from the data sheet
ACCELEROMETER_WALK = 7.0 * inertial.MICRO_G
REST_S, TUNED_S = 30.0, 120.0
FACTORS = (1.0, 2.0, 3.0, 4.0)
FACTOR = 3.0
"""The factor with the largest likelihood."""
BIASES = {"gyro_bias": np.radians(0.2), "accelerometer_bias": 0.2}
FIX = {"sigma_position": 0.01, "sigma_velocity": 0.0577}  # as the receiver reports
START = {
    "sigma_level": 0.03,
    "sigma_heading": np.radians(10.0),
    "sigma_velocity": 0.1,
    "sigma_position": 0.05,
}
MOVES = 1.0  # m/s; above this speed the course equals the heading
# Outages: first start, length, margin before the end. Fixes between them last twice as long.
FIRST_S, LENGTH_S, LAST_S = 40.0, 15.0, 30.0
MORE = {"lag": 0.05, "lever": 0.1, "mount": np.radians(2.0), "axle": 1.0}
SIDEWAYS, SIDEWAYS_S, AXLE = 0.1, 0.25, np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Drive:
    """A filter and the folder of its log.

    kind: name of a filter. error: see `celnav.models.inertial.strapdown`.
    constrained: whether to add the states `MORE` and a sideways speed of zero.
    factor: factor of the white noise at rest.
    end_s: end of the used log, s. smoothed: whether to run the smoother too.
    """

    folder: Path
    kind: str = "ekf"
    error: str = "invariant"
    constrained: bool = False
    factor: float = FACTOR
    end_s: float = np.inf
    smoothed: bool = False


FLOWN: dict[str, dict[str, Any]] = {
    "rest": {"factor": 1.0},
    "fixes": {},
    "body": {"error": "body"},
    "ukf": {"kind": "ukf"},
    "wheels": {"constrained": True},
    "wheels-ukf": {"constrained": True, "kind": "ukf"},
    "smoothed": {"constrained": True, "smoothed": True},
}
"""Runs by name, as changes of a `Drive`."""
PEER = {"fixes": (6.82, 12.79), "wheels": (5.09, 10.59)}
"""Median and largest drift (m) after 15 s, on the same outages, of the program published with the
log.

"fixes": the program as published. "wheels": with its own constraint on wheels. We measured each
twice with its settings, forward, without its velocity matching. Its low-pass filter uses future
samples.
"""


class Log(NamedTuple):
    """Measurements of a log, in s since the first fix.

    rate, force: ``(T, 3)`` on forward, right, down axes. fixes: ``(K, 6)``, position and velocity
    on north, east, down axes at the first fix. fixed: ``(K,)``, whether the solution is fixed.
    """

    t: Array
    rate: Array
    force: Array
    t_fix: Array
    fixes: Array
    fixed: Array
    latitude: float
    height_m: float


def log(folder: Path) -> Log:
    """Read the log in a folder."""
    table, tags, solution = found(folder, FILES)
    fixes, samples = read_pos(solution), read_imu(table, tags)
    origin = fixes.latitude[0], fixes.longitude[0], fixes.height_m[0]
    p = earth.local_position(fixes.latitude, fixes.longitude, fixes.height_m, origin)
    mounted, start = attitude.from_euler(MOUNT), fixes.t[0]
    return Log(
        samples.t - start - LATE_S,
        attitude.rotate(mounted, samples.rate),
        attitude.rotate(mounted, samples.force),
        fixes.t - start,
        np.concatenate([p, fixes.velocity], -1),
        fixes.quality == 1,
        float(origin[0]),
        float(origin[2]),
    )


def outages(t_fix: Array) -> Array:
    """Start and end times ``(K, 2)`` s of the outages, on the unit's delayed clock."""
    end = t_fix[-1] - LAST_S
    first = np.arange(FIRST_S, end, 3.0 * LENGTH_S)
    return np.stack([first, np.minimum(first + LENGTH_S, end)], -1) - LATE_S


def withheld(t_fix: Array) -> Array:
    """Index of the outage that contains each fix, -1 for none."""
    inside = [(t_fix > first) & (t_fix <= last) for first, last in outages(t_fix)]
    return np.where(np.any(inside, 0), np.argmax(inside, 0), -1)


def system(log: Log, config: Drive) -> inertial.Strapdown:
    """The strapdown system, with the noise measured at rest at the start."""
    rest = log.t < log.t[0] + REST_S
    imu = inertial.Imu.at_rest(
        log.t[rest],
        log.rate[rest],
        log.force[rest],
        **BIASES,
        gyro_walk=GYRO_WALK,
        accelerometer_walk=ACCELEROMETER_WALK,
    )
    imu = replace(
        imu,
        gyro_noise=config.factor * imu.gyro_noise,
        accelerometer_noise=config.factor * imu.accelerometer_noise,
    )
    states = MORE if config.constrained else {}
    return inertial.strapdown(log.latitude, log.height_m, imu, states, error=config.error)


def task(log: Log, config: Drive) -> tuple[Any, Gaussian, Merged, inertial.Strapdown]:
    """Filter, prior, merged measurements, and strapdown system."""
    made = system(log, config)
    used = log.fixed & (withheld(log.t_fix) < 0) & (log.t_fix <= config.end_s)
    in_time = log.t <= min(config.end_s, log.t_fix[-1])
    t, inputs = log.t[in_time], (log.rate[in_time], log.force[in_time])
    moving = int(np.flatnonzero(used & (np.hypot(*log.fixes[:, 3:5].T) > MOVES))[0])
    first = int(np.searchsorted(log.t_fix, t[0]))
    prior = made.prior(
        inertial.level(log.force[log.t < t[0] + 1.0].mean(0)),
        np.arctan2(log.fixes[moving, 4], log.fixes[moving, 3]),
        position=log.fixes[first, :3],
        velocity=log.fixes[first, 3:],
        **START,
    )
    sensors = [made.gnss(LEVER, **FIX)]
    streams: dict[str, Any] = {"fixes": (log.t_fix[used], log.fixes[used])}
    if config.constrained:
        rolling = np.arange(log.t_fix[moving], t[-1], SIDEWAYS_S)
        sensors.append(made.sideways(SIDEWAYS, lever=AXLE))
        streams["sideways"] = rolling, np.zeros((len(rolling), 2))
    filter = getattr(celnav, config.kind)(made.motion, *sensors)
    return filter, prior, merge(imu=(t, inputs), trim=True, **streams), made


def probable(config: Drive, _rngs: Sequence[Any]) -> dict[str, Array]:
    """Log-likelihood of the fixes in the first `TUNED_S` seconds, with each of `FACTORS`."""
    measured = log(config.folder)
    values = []
    for factor in FACTORS:
        filter, prior, merged, _ = task(measured, replace(config, factor=factor, end_s=TUNED_S))
        values.append(float(run(filter, prior, *merged, keep="nothing").log_likelihood))
    return {"log_likelihood": np.array(values)}


def fly(config: Drive, _rngs: Sequence[Any]) -> dict[str, Array]:
    """Run a filter through the outages.

    Returns
    -------
    drift: ``(K, 2)`` m, after two thirds of each outage and at its end: the norm of the difference
    between the error and the error at the first withheld fix.
    sigma: ``(K,)`` m, predicted σ of the position at the end. nees: ``(K,)``, at the end.
    worst: ``(K,)`` m, largest error within the outage.
    nis: sum of all NIS over the sum of the degrees of freedom.
    """
    measured = log(config.folder)
    filter, prior, merged, made = task(measured, config)
    track = run(filter, prior, *merged, keep="cov")
    ratio = track.nis.sum() / track.dof.sum()
    if config.smoothed:
        track = smooth(track)
    # Position that a fix would measure, with the lag and lever arm of the state.
    antenna = made.gnss(LEVER, sigma_position=1.0).h(track.mean, Epoch())
    q, p = made.space.part(track.mean, "q"), track.part("p")
    rows, inside = [], withheld(measured.t_fix)
    for k in range(int(inside.max()) + 1):
        at = np.flatnonzero((inside == k) & measured.fixed)
        t = measured.t_fix[at]
        if t[-1] > track.times[-1]:
            break
        there = np.stack([np.interp(t, track.times, x) for x in antenna.T], -1)
        error = there - measured.fixes[at, :3]
        drift = np.linalg.norm(error - error[0], axis=-1)
        end = int(np.searchsorted(track.times, t[-1]))
        turned = attitude.rotate(q[end], error[-1])
        P = p.cov[end] + FIX["sigma_position"] ** 2 * np.eye(3)
        last = turned if config.error == "invariant" else error[-1]
        size = np.linalg.norm(error, axis=-1).max()
        rows.append(
            [
                drift[len(drift) * 2 // 3],
                drift[-1],
                np.sqrt(np.trace(P)),
                last @ np.linalg.solve(P, last),
                size,
            ]
        )
    ten, end_of, sigma, nees, worst = np.transpose(rows)
    return {
        "drift": np.stack([ten, end_of], -1),
        "sigma": sigma,
        "nees": nees,
        "worst": worst,
        "nis": np.array(ratio),
    }


def parts(effort: float, ins: Path) -> dict[str, Part]:
    """A part for each filter; ``effort`` shortens the log."""
    end = np.inf if effort == 1.0 else max(150.0, 550.0 * effort)
    config = Drive(Path(ins), end_s=end)
    every = {
        name: Part(fly, replace(config, **changes), cost=12.0) for name, changes in FLOWN.items()
    }
    return every | {"settings": Part(probable, config, cost=20.0)}


def drifts(r: Results, name: str) -> Array:
    """Drift ``(K,)`` m at the end of each outage."""
    return r.get(name, "drift")[:, 1]


def typical(label: str, name: str, other: str | float, accept: Bounds) -> Decided:
    """Ratio of a filter's median drift to another filter's, or to a value in m."""

    def number(r: Results) -> Number:
        if isinstance(other, float):
            return estimate(label, lambda a: np.median(a) / other, [drifts(r, name)], accept)
        both = [drifts(r, name), drifts(r, other)]
        return estimate(label, lambda a, b: np.median(a) / np.median(b), both, accept)

    return number


def alike(label: str, name: str, other: str) -> Decided:
    """RMS drift ratio of two filters, accepted within 10 %."""

    def number(r: Results) -> Number:
        both = [np.square(drifts(r, one)) for one in (name, other)]
        return estimate(label, lambda a, b: np.sqrt(a.mean() / b.mean()), both, (0.9, 1.1))

    return number


def worst(label: str, name: str, of_what: str, accept: Bounds) -> Decided:
    """Largest drift at the end of an outage, or largest error within an outage."""

    def number(r: Results) -> Number:
        values = drifts(r, name) if of_what == "drift" else r.get(name, of_what)
        return Number(label, float(values.max()), accept)

    return number


def consistency(name: str, accept: Bounds) -> Decided:
    """Mean NEES at the end of the outages, divided by 3."""

    def number(r: Results) -> Number:
        values = r.get(name, "nees") / 3.0
        return estimate("NEES / 3 at the end of an outage", np.mean, [values], accept)

    return number


SEEN = "2026-11-26: this row was written when its result was known"
ROWS = [
    finding(
        "peer",
        "With fixes alone the median drift is smaller than that of the program that came with the "
        "log.",
        typical("median drift over that of the program", "fixes", PEER["fixes"][0], (None, 1.0)),
        expected="undecided",
        figure="figure_01",
        revised=SEEN,
    ),
    finding(
        "wheels",
        "A constraint of zero sideways speed at the wheels at least halves the median drift.",
        typical("median drift over that with fixes alone", "wheels", "fixes", (None, 0.5)),
        expected="undecided",
        figure="figure_01",
        revised=SEEN,
    ),
    finding(
        "wheels-peer",
        "With zero sideways speed the median drift is less than half of that of the program with "
        "its own constraint.",
        typical("median drift over that of the program", "wheels", PEER["wheels"][0], (None, 0.5)),
        expected="undecided",
        figure="figure_01",
        revised=SEEN,
    ),
    finding(
        "worst",
        "With zero sideways speed the largest drift is smaller than that of the program.",
        worst("largest drift (m)", "wheels", "drift", (None, PEER["wheels"][1])),
        figure="figure_01",
        revised=SEEN,
    ),
    finding(
        "consistent",
        "With three times the noise at rest, the errors at the end of an outage agree with their "
        "predicted covariance.",
        consistency("wheels", (0.5, 1.5)),
        revised=SEEN,
    ),
    finding(
        "rest",
        "With the noise at rest the filter is overconfident.",
        consistency("rest", (1.5, None)),
        revised=SEEN,
    ),
    finding(
        "ukf-alike",
        "The heading is well known, so the RMS drifts of UKF and EKF agree within 10 %.",
        alike("RMS drift of the UKF over that of the EKF", "ukf", "fixes"),
        revised=SEEN,
    ),
    finding(
        "errors-alike",
        "The RMS drifts with body-frame errors and with invariant errors agree within 10 %.",
        alike("RMS drift, body-frame over invariant errors", "body", "fixes"),
        revised=SEEN,
    ),
    finding(
        "smoothed",
        "In post-processing, the error of the smoother is below half a meter in all outages.",
        worst("largest error (m)", "smoothed", "worst", (None, 0.5)),
        revised=SEEN,
    ),
    check(
        "settings",
        "The factor of the noise in use has the largest likelihood of all factors.",
        of(
            "settings",
            "log_likelihood",
            "largest gain of log-likelihood with another factor",
            (None, 0.0),
            lambda x: np.max(x - x[FACTORS.index(FACTOR)]),
        ),
    ),
]
STUDY = Study(
    "ins",
    (),
    None,
    parts,
    ROWS,
    "How far does the estimated position of a car drift in 15 s without fixes?",
    (
        Sentence(
            "The largest drift is {worst[0]:.1f} m if the filter assumes that the wheels do not "
            "slip sideways.",
            {"worst": "shown"},
        ),
        Sentence(
            "The median drift is then {wheels[0]:.2f} times that with fixes alone. Eleven outages "
            "do not decide whether this ratio is below 0.5.",
            {"wheels": "undecided"},
        ),
        Sentence(
            "In post-processing, the largest error of a smoother is {smoothed[0]:.1f} m.",
            {"smoothed": "shown"},
        ),
        Sentence(
            "This is one log, and the additions to the filter were chosen on it.",
            {"worst": "shown"},
        ),
    ),
    "figure_01",
)


# -- figures and tables ----------------------------------------------------------------------------
LINES = {
    "rest": Line("EKF, noise at rest", colors.PAPER),
    "fixes": Line("EKF", colors.COMPARISON),
    "body": Line("EKF, body-frame errors", colors.OPEN_LOOP),
    "ukf": Line("UKF", colors.SIGMA),
    "wheels": Line("EKF, wheels do not slip", colors.ESTIMATE),
    "wheels-ukf": Line("UKF, wheels do not slip", colors.TRUTH),
    "smoothed": Line("smoother, wheels do not slip", colors.REFERENCE),
}


def outage_bars(r: Results) -> Figure:
    """Drift at the end of each outage."""
    count = len(drifts(r, "fixes"))
    starts = [f"{FIRST_S + 3.0 * LENGTH_S * k:.0f} s" for k in range(count)]
    heights: Any = {
        LINES[name].label: (drifts(r, name).tolist(), LINES[name].color)
        for name in ("fixes", "wheels")
    }
    panel = Panel("", [bars(starts, heights)], "start of the outage", "drift after 15 s (m)")
    return panels(panel, height=3.0)


def table(r: Results) -> Rows:
    """Drift, predicted σ and NEES of each filter."""
    rows: Rows = []
    for name, line in LINES.items():
        drift = r.get(name, "drift")
        row: dict[str, Any] = {"filter": line.label}
        for i, after in enumerate(("10 s", "15 s")):
            row[f"median after {after} (m)"] = float(np.median(drift[:, i]))
            row[f"largest after {after} (m)"] = float(drift[:, i].max())
        row["median predicted σ (m)"] = float(np.median(r.get(name, "sigma")))
        row["NEES / 3"] = float(r.get(name, "nees").mean() / 3.0)
        row["NIS / dof"] = r.value(name, "nis")
        rows.append(row)
    return rows


FIGURES = {"figure_01": ("Drift of the position at the end of each outage.", outage_bars)}
TABLES = {"table_1": ("Drift of each filter over all outages.", table)}
RECORDINGS: list[str] = []


def record(_results: Results, _outputs: Outputs) -> list[str]:
    """Return no names: this study has no recording."""
    return []
