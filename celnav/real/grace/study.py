"""A satellite's GPS fixes, whose errors are correlated from one to the next: what filters claim, and where it really was.

GRACE-A, 1 to 3 August 2008. The fixes of 2 and 3 August decide all that is set (`SETTINGS`, the gate, the prior), by likelihood and
by correlation of residuals; then filters fly 1 August, for which there are positions good to 3 to 6 cm. These were not looked at
before the settings were written down. Units: m, s; Earth-fixed axes, errors radial, along and across the track.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from celnav.analysis.metrics import ratio, rms
from celnav.analysis.tuning import Tuned, maximize_likelihood
from celnav.filters.adaptive import gate
from celnav.filters.colored import augmented, colored
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Filter, epochs
from celnav.filters.run import run
from celnav.filters.sequential import ukf
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, matvec
from celnav.models import earth, ephemeris, gravity, orbit
from celnav.real import found
from celnav.real.grace.positions import STEP_S, Positions, aligned, axes, read
from celnav.study.ledger import Bounds, Number, check, finding
from celnav.study.numbers import Decided, all_of, correlation, lagged, of, over_time
from celnav.study.study import Part, Results, Rngs, Study
from celnav.study.trial import Group

CITATION = """@misc{GRACE2008,
  author = {Zhang, Shoujian},
  title  = {KineOrbits: kinematic and single-point positions of GRACE-A, of Level-1B data of NASA and GFZ},
  year   = {2008},
  note   = {gravity: Pavlis et al., EGM2008}
}"""
TITLE = "GPS fixes of a satellite: GRACE-A"
INPUTS = ("grace",)
FIXES = tuple(f"*2008-08-0{day}*.pos.spp*" for day in (1, 2, 3))
TRUTH, FIELD = "*2008-08-01*.svr.*", "*.gfc"
POLE = (0.24 * np.pi / 648000.0, 0.47 * np.pi / 648000.0)
TT_GPS_S, GPS_UTC_S, UT1_UTC_S = 51.184, 14.0, -0.458
"""Motion of the pole, x and y, rad; differences of time scales."""


# -- what is believed ----------------------------------------------------------------------------------------------------------
class Around(NamedTuple):
    """By epoch, on Earth-fixed axes ``(T, 3)``: how these turn (rad/s), Sun and Moon from the Earth's center (m)."""

    spin: Array
    sun: Array
    moon: Array


def orientation(times: Array) -> tuple[Array, Array]:
    """Rotations ``(T, 3, 3)`` from celestial to Earth-fixed axes at GPS seconds since 2000-01-01 12:00, and TT ``(T, 2)``."""
    tt = np.stack([np.full(times.shape, 2451545.0), (times + TT_GPS_S) / 86400.0], -1)
    return earth.orientation(tt, tt - [0.0, (TT_GPS_S + GPS_UTC_S - UT1_UTC_S) / 86400.0], POLE), tt


def around(times: Array) -> Around:
    """What acts besides gravity at GPS seconds."""
    fixed, tt = orientation(np.append(times, times[-1] + STEP_S))
    date, kernel = ephemeris.from_tt(*tt[:-1].T), ephemeris.de421()
    center, *bodies = (kernel.state(body, date).position for body in ("earth", "sun", "moon"))
    sun, moon = (matvec(fixed[:-1], 1e3 * (body - center)) for body in bodies)
    return Around(earth.spin(fixed, STEP_S), sun, moon)


def step(x: Array, epoch: Any, field: gravity.Gravity) -> Array:
    """State ``(..., 6)`` m, m/s on Earth-fixed axes after an interval: one Runge-Kutta step of order 4 (10 s: 0.01 mm)."""
    h, r, v = epoch.dt, x[..., :3], x[..., 3:]
    spin, sun, moon = epoch.u

    def pull(r: Array, v: Array) -> Array:
        bodies = orbit.third_body(r, sun, 1e9 * ephemeris.GM["sun"]) + orbit.third_body(r, moon, 1e9 * ephemeris.GM["moon"])
        return np.asanyarray(field.acceleration(r) + earth.inertial_forces(r, v, spin) + bodies)

    a1 = pull(r, v)
    v2 = v + 0.5 * h * a1
    a2 = pull(r + 0.5 * h * v, v2)
    v3 = v + 0.5 * h * a2
    a3 = pull(r + 0.5 * h * v2, v3)
    v4 = v + h * a3
    a4 = pull(r + h * v3, v4)
    return np.concatenate([r + h / 6.0 * (v + 2.0 * (v2 + v3) + v4), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)], -1)


class Setting(NamedTuple):
    """Deviation (m) and correlation over a step of a fix's errors; velocity (m/s) that unknown forces add in a step, per axis."""

    sigma: float
    phi: float
    q: float


Settings = Setting | Array
"""One, or several as runs ``(3, runs)``."""


def motion(field: gravity.Gravity, q: Any) -> Motion:
    """Gravity to a degree, and white accelerations that make ``q`` m/s in a step."""
    white = np.array([[STEP_S**2 / 3.0, STEP_S / 2.0], [STEP_S / 2.0, 1.0]])
    return Motion(partial(step, field=field), np.square(q)[..., None, None] * np.kron(white, np.eye(3)))


def believed(field: gravity.Gravity, setting: Settings) -> tuple[Motion, Sensor, Array]:
    """Motion, sensor and coefficient of its noise."""
    sigma, phi, q = (np.asarray(part, float)[..., None, None] for part in setting)
    return motion(field, q[..., 0, 0]), Sensor(np.eye(3, 6), sigma**2 * np.eye(3)), phi * np.eye(3)


def prior(log: Positions) -> Gaussian:
    """Position and velocity from a polynomial through the first two minutes, taken for much worse than it is."""
    there = np.flatnonzero(~np.isnan(log.z[:, 0]))[:13]
    fit = np.polynomial.polynomial.polyfit(log.times[there] - log.times[0], log.z[there], 5)
    return Gaussian(np.concatenate([fit[0], fit[1]]), np.diag([100.0**2] * 3 + [1.0] * 3))


# -- settings, from 2 and 3 August ---------------------------------------------------------------------------------------------
DEGREE, TRAINED = 16, 8500
"""Of gravity; epochs of each day that the likelihood is of."""
SETTINGS = {
    "colored": Setting(1.47, 0.905, 4e-4),
    "colored, by correlation": Setting(3.35, 0.9907, 9.1e-5),
    "colored, of four hours": Setting(6.1, 0.9943, 9.1e-5),
    "white": Setting(1.47, 0.0, 4e-4),
    "white, by NIS": Setting(1.034, 0.0, 4e-4),
    "white, by likelihood": Setting(0.46, 0.0, 0.0205),
    "white, of four hours": Setting(6.1, 0.0, 9.1e-5),
}
"""What filters believe. colored: most probable. By correlation: deviation of residuals, and the lag at which their correlation is
1/e. Of four hours: most probable by the first 1500 epochs of both days, with a motion that lacked Sun, Moon and precession.
white: each of the most probable without its correlation; with an R that makes NIS right; the most probable R and Q of white noise,
of four hours.

Written down before the truth was looked at: those of four hours, by correlation, and by likelihood. The colored one failed: errors
across the track grew over the day. Then motion and likelihood were redone, the latter with whole days, again of 2 and 3 August
alone, and gave the others."""
SCREEN, SCREENED_M = Setting(4.0, 0.95, 1e-4), 6.0
"""Fixes that a filter so set finds this far from where it expects them are not in the likelihood, which no gate may judge."""


class Training(NamedTuple):
    """Two days of fixes as two runs: seconds ``(T,)``, fixes ``(T, 2, 3)``, what is `around`, ``(T, 2, 3)`` each, prior of both."""

    times: Array
    z: Array
    u: Around
    prior: Gaussian


def training(paths: Sequence[Path], field: gravity.Gravity, count: int) -> Training:
    """The first ``count`` epochs of two days, without outliers."""
    logs = [read(path) for path in paths]
    each = [prior(log) for log in logs]
    both = Gaussian(np.stack([one.mean for one in each]), each[0].cov)
    times, z = STEP_S * np.arange(count), np.stack([log.z[:count] for log in logs], 1)
    u = Around(*(np.stack(parts, 1) for parts in zip(*(around(log.times[:count]) for log in logs), strict=True)))
    M, S, Phi = believed(field, SCREEN)
    far = np.abs(run(colored(M, S, Phi), both, times, z, u, keep="mean").innovation) > SCREENED_M
    far[0] = False
    return Training(times, np.where(far.any(-1, keepdims=True), np.nan, z), u, both)


def fitted(data: Training, field: gravity.Gravity, start: Setting, color: bool = True) -> Tuned:
    """The most probable `Setting`, or its ``sigma`` and ``q`` where noise is taken for white."""

    def build(parameters: Array) -> tuple[Filter, Gaussian]:
        sigma, q, *phi = parameters
        M, S, Phi = believed(field, Setting(sigma, phi[0] if color else 0.0, q))
        return (colored(M, S, Phi) if color else ukf(M, S)), data.prior

    first, domain = [start.sigma, start.q, *([start.phi] * color)], ["positive", "positive", *(["unit interval"] * color)]
    return maximize_likelihood(build, first, epochs(data.times, data.z, data.u), domain=domain, factor=4.0, tolerance=0.1)


# -- what is flown -------------------------------------------------------------------------------------------------------------
GATE = 5.0
"""Deviations of an innovation, of which 2 and 3 August have few beyond: those are jumps of tens of meters."""
WHITE = ("white", "white, by NIS", "white, by likelihood", "white, of four hours")
COLORED = ("colored", "colored, by correlation", "colored, of four hours")
OTHERS = ("augmented", "without z_0")
NAMES = (*WHITE, *COLORED, *OTHERS)


def flights(field: gravity.Gravity, names: Sequence[str]) -> dict[tuple[str, ...], Filter]:
    """Filters by the names that they fly as runs of one batch: those of a kind differ in nothing but settings."""
    hooks, out = [gate(GATE)], dict[tuple[str, ...], Filter]()
    for kind in (WHITE, COLORED, *((name,) for name in OTHERS)):
        if own := tuple(name for name in kind if name in names):
            M, S, Phi = believed(field, np.transpose([SETTINGS.get(name, SETTINGS["colored"]) for name in own]))
            if kind == WHITE:
                out[own] = ukf(M, S, hooks=hooks)
            elif own == ("augmented",):
                out[own] = augmented(M, S, Phi, hooks=hooks)
            else:
                out[own] = colored(M, S, Phi, first=own != ("without z_0",), hooks=hooks)
    return out


class Files(NamedTuple):
    """Fixes of three days, positions of the first, gravity."""

    fixes: tuple[Path, ...]
    truth: Path
    field: Path


def flown(names: Sequence[str], degree: int, files: Files, _rngs: Rngs) -> dict[str, Array]:
    """Filters over 1 August with gravity to a degree, and the fixes themselves.

    Returns
    -------
    times ``(T,)`` s; errors of the fixes ``fixes (T, 3)`` m, radial, along and across. Of each filter ``<name>/error`` and
    ``<name>/std (T, 1, 3)`` on these axes, ``<name>/cov (T, 1, 3, 3)``; ``<name>/nees``, ``<name>/nis (T, 1)``, of three
    components, nan where there is none;
    ``<name>/white (T, 3)``, whitened innovations; ``<name>/rejected (1,)``, the share of components that the gate left out.
    """
    log, field = read(files.fixes[0]), gravity.read(files.field, degree)
    truth, times = aligned(log, read(files.truth)), log.times - log.times[0]
    frame, start, u = axes(truth), prior(log), around(log.times)
    out = {"times": times, "fixes": matvec(frame, log.z - truth)}
    for own, filter in flights(field, names).items():
        runs = Gaussian(np.tile(start.mean, (len(own), 1)), start.cov)
        track = run(filter, runs, times, np.tile(log.z[:, None], (1, len(own), 1)), u, keep="cov")
        for i, name in enumerate(own):
            error, cov = matvec(frame, track.mean[:, i, :3] - truth), frame @ track.cov[:, i, :3, :3] @ frame.mT
            used = track.used[:, i]
            out |= {
                f"{name}/error": error[:, None], f"{name}/cov": cov[:, None],
                f"{name}/std": np.sqrt(cov.diagonal(0, -2, -1))[:, None],
                f"{name}/nees": np.vecdot(error, np.linalg.solve(cov, error[..., None])[..., 0])[:, None],
                f"{name}/nis": np.where(used.all(-1), track.nis[:, i], np.nan)[:, None],
                f"{name}/white": np.where(used, track.whitened[:, i], np.nan),
                f"{name}/rejected": np.array([track.events["rejected"][i] / np.isfinite(log.z).sum()]),
            }  # fmt: skip
    return out


def judged(files: Files, _rngs: Rngs) -> dict[str, Array]:
    """How probable settings make 2 and 3 August: that of likelihood first, then each of its parts by a fifth less and more.

    Returns
    -------
    likelihood ``(7,)``: logarithms. nis ``(1,)``: of the white filter whose R is set by it, over its degrees of freedom.
    """
    field, best = gravity.read(files.field, DEGREE), np.array(SETTINGS["colored"])
    data, factors = training(files.fixes[1:], field, TRAINED), np.ones((7, 3))
    for i, factor in product(range(3), (0, 1)):
        factors[1 + 2 * i + factor, i] = (1.0 / 1.2, 1.2)[factor]
    # A correlation is changed in its distance from 1.
    tried = np.stack([best[0] * factors[:, 0], 1.0 - (1.0 - best[1]) * factors[:, 1], best[2] * factors[:, 2]])
    M, S, Phi = believed(field, np.repeat(tried, 2, 1))
    both = Gaussian(np.tile(data.prior.mean, (7, 1)), data.prior.cov)
    track = run(colored(M, S, Phi), both, data.times, np.tile(data.z, (1, 7, 1)), _tiled(data.u, 7), keep="nothing")
    M, S, _ = believed(field, SETTINGS["white, by NIS"])
    white = run(ukf(M, S), data.prior, data.times, data.z, data.u, keep="mean")
    return {"likelihood": track.log_likelihood.reshape(7, 2).sum(1), "nis": np.array([white.nis.sum() / white.dof.sum()])}


def _tiled(u: Around, count: int) -> Around:
    return Around(*(np.tile(part, (1, count, 1)) for part in u))


DEGREES = (2, 8, DEGREE)


def parts(_effort: float, grace: Path) -> dict[str, Part]:
    """Flights by degree of gravity, and what the settings were found by; ``grace``: the folder."""
    *fixes, truth, field = found(grace, (*FIXES, TRUTH, FIELD))
    files = Files(tuple(fixes), truth, field)
    flying = {n: NAMES if n == DEGREE else (WHITE[0], COLORED[0]) for n in DEGREES}
    out = {f"degree {n}": Part(partial(flown, flying[n], n), files, cost=10.0 * len(flying[n])) for n in DEGREES}
    return out | {"settings": Part(judged, files, cost=20.0)}


# -- the ledger ----------------------------------------------------------------------------------------------------------------
BEST, OUTLIER_M, REVOLUTION, CHI_SQUARE_MEDIAN = f"degree {DEGREE}", 30.0, 564, 2.36597
"""Epochs of a revolution: nothing is judged before the first is over, and the bootstrap draws whole ones."""
Columns = Callable[[Results], Sequence[Array]]


def column(r: Results, part: str, name: str, what: str) -> Array:
    """``(T,)`` of a filter: length of its error or of its std, squared; NEES or NIS over their 3; nan where there is no truth."""
    values = r.get(part, f"{name}/{what}")[:, 0]
    return np.asarray(values / 3.0 if what in ("nees", "nis") else np.square(values).sum(-1))


def fixes(r: Results) -> Array:
    """Errors ``(T, 3)`` m of the fixes, nan for outliers."""
    error = r.get(BEST, "fixes")
    return np.where(np.linalg.norm(error, axis=1, keepdims=True) < OUTLIER_M, error, np.nan)


def over_day(label: str, statistic: Callable[..., float], columns: Columns, accept: Bounds = (None, None)) -> Decided:
    """A statistic of columns after the first revolution."""
    return lambda r: over_time(label, statistic, columns, accept, start=REVOLUTION, block=REVOLUTION)(r)


def mean(a: Array) -> float:
    """Of all epochs."""
    return float(a.mean())


def claims(name: str, accept: Bounds, part: str = BEST) -> Decided:
    """What a filter errs over what it claims."""
    return over_day(
        "RMSE over claimed deviation", ratio, lambda r: [column(r, part, name, what) for what in ("error", "std")], accept
    )


def honest(name: str, accept: Bounds, part: str = BEST) -> Decided:
    """NEES of a position over its 3 components, which is 1 of a consistent filter."""
    return over_day(f"NEES / 3, {part}", mean, lambda r: [column(r, part, name, "nees")], accept)


def typical(name: str, accept: Bounds) -> Decided:
    """Median of NEES over that of a consistent filter."""
    return over_day(f"median NEES over a consistent one's, {name}", lambda a: float(np.median(a)) / (CHI_SQUARE_MEDIAN / 3.0),
                    lambda r: [column(r, BEST, name, "nees")], accept)  # fmt: skip


def inside(name: str) -> Decided:
    """Share of the components that lie inside of what is claimed to have 95 % of them."""

    def columns(r: Results) -> list[Array]:
        error, std = (r.get(BEST, f"{name}/{what}")[:, 0] for what in ("error", "std"))
        return [np.where(np.isfinite(error), np.abs(error) < 1.96 * std, np.nan)]

    return over_day(f"inside of 95 % claimed, {name}", mean, columns)


def against(label: str, a: str, b: str, accept: Bounds = (None, None), part: str = BEST) -> Decided:
    """RMSE of one filter over that of another with the best gravity."""
    return over_day(label, ratio, lambda r: [column(r, part, a, "error"), column(r, BEST, b, "error")], accept)


def size(name: str) -> Decided:
    """RMSE of a position, m."""
    return over_day(f"RMSE of {name}, m", rms, lambda r: [column(r, BEST, name, "error")])


def whiteness(name: str, accept: Bounds) -> Decided:
    """Correlation of whitened innovations from one epoch to the next."""
    return over_day(f"of {name}", correlation, lambda r: lagged(r.get(BEST, f"{name}/white")), accept)


def correlated(lag: int, accept: Bounds = (None, None)) -> Decided:
    """Correlation of the fixes' errors so many epochs apart."""
    return over_day(f"after {lag * STEP_S:g} s", correlation, lambda r: lagged(fixes(r), lag), accept)


HONEST = (0.5, 2.0)
"""Of NEES over its dimension. It, and all ranges of rows that are not ``revised``, were written before the truth was looked at."""
FINDINGS = [
    finding("fixes-colored", "Errors of real fixes are correlated from one to the next.",
        all_of(correlated(1, (0.9, None)), correlated(30), correlated(90)), figure="figure_02",
        why="0.9 from one fix to the next is far from white", found="By {0} after 10 s, {1} after 5 min, {2} after 15."),
    finding("white-overconfident", "A UKF that takes them for white errs by a multiple of what it claims.",
        all_of(claims("white", (2.0, None)), honest("white", (4.0, None)), size("white")), figure="figure_01",
        why="twice the claim, four times the NEES", found="{0} times its claim, NEES/3 {1}; RMSE {2} m."),
    finding("colored-honest", "Told of the correlation, the same UKF is honest.",
        all_of(honest("colored", HONEST), claims("colored", (0.71, 1.41)), size("colored")), figure="figure_01",
        why="NEES within a factor 2 of its dimension", found="NEES/3 {0}, {1} times its claim; RMSE {2} m."),
    finding("colored-better", "It is the better estimate as well, and better than the fixes.",
        all_of(against("RMSE over white", "colored", "white", (None, 1.0)),
               over_day("over the fixes", ratio, lambda r: [column(r, BEST, "colored", "error"), np.square(fixes(r)).sum(1)],
                        (None, 1.0))),
        why="below 1", found="{0} of the white filter's RMSE, {1} of the fixes'.", figure="figure_03"),
    finding("typical", "In a typical epoch the filter that is told of the correlation is honest, the other is not.",
        all_of(typical("colored", HONEST), typical("white", (2.0, None)), inside("colored"), inside("white")), figure="figure_01",
        revised="2026-11-23: written after the truth was seen, since four bursts of the fixes' errors rule all means",
        why="the median of NEES within a factor 2 of that of a consistent filter; beyond twice that",
        found="Median NEES {0} and {1} times a consistent filter's; of the components {2:.0%} and {3:.0%} lie inside of 95 %."),
    finding("misleads", "Neither the R that makes NIS right nor the most probable R and Q make an honest filter of a white one.",
        all_of(honest("white, by NIS", (4.0, None)), claims("white, by NIS", (2.0, None)),
               honest("white, by likelihood", (4.0, None)), claims("white, by likelihood", (2.0, None))), figure="figure_03",
        why="as for the white one", found="By NIS NEES/3 {0}, {1} times its claim; by likelihood {2} and {3}."),
    finding("innovations-tell", "Innovations tell which is right without any truth: those of white filters are correlated.",
        all_of(whiteness("white", (0.3, None)), whiteness("colored", (-0.2, 0.2))), figure="figure_02",
        why="clearly correlated, and next to not", found="By {0} from one to the next; those of the colored one by {1}."),
    finding("augmented-same", "Carrying the noise in the state, the exact reference, gives the same.",
        all_of(against("RMSE over colored", "augmented", "colored", (0.95, 1.05)), honest("augmented", HONEST)),
        why="within 5 %", expected="not shown", figure="figure_03",
        found="{0} times the RMSE, NEES/3 {1}: a gate that leaves out a jump leaves its noise where it was, and locks itself out."),
    finding("first-sample", "Without the first fix, as the differences alone have it, the position is known much later.",
        lambda r: [Number("RMSE of the first revolution, over that with it", early(r, "without z_0") / early(r, "colored"),
                          (1.5, None)), against("afterwards", "without z_0", "colored")(r)],
        why="half as much again", expected="not shown",
        found="{0} times the RMSE in the first revolution, {1} afterwards: noise that is forgotten in minutes tells the position."),
    finding("gravity-matters", "Gravity to degree 2 is a motion that errs more than its process noise: neither is honest then.",
        all_of(honest("colored", (2.0, None), "degree 2"),
               against("RMSE over degree 16", "colored", "colored", (1.0, None), "degree 2"),
               honest("colored", HONEST, "degree 8")),
        why="out of the range of an honest one", found="NEES/3 {0}, {1} times the RMSE; with degree 8 NEES/3 is {2}.",
        figure="figure_03"),
]  # fmt: skip
CHECKS = [
    check("settings-likely", "On 2 and 3 August no setting a fifth off in one parameter is more probable",
        lambda r: Number("log-likelihood lost at least", float(r.get("settings", "likelihood")[0]
                         - r.get("settings", "likelihood")[1:].max()), (-0.5, None)),
        revised="2026-11-23: by more than half of its unit, which is what a standard error loses; was 0"),
    check("settings-nis", "NIS of the white filter whose R is set by it, on 2 and 3 August",
        of("settings", "nis", "NIS per component", (0.97, 1.03))),
    check("settings-correlation", "By the correlation of residuals instead of likelihood: also honest",
        all_of(honest("colored, by correlation", HONEST), honest("colored, of four hours", HONEST)), expected="does not hold"),
    check("gate-rare", "The gate leaves out less than 2 % of the components",
        all_of(*(of(BEST, f"{name}/rejected", name, (None, 0.02)) for name in NAMES)), expected="does not hold"),
]  # fmt: skip


def early(r: Results, name: str) -> float:
    """RMSE in the first revolution, m."""
    return float(np.sqrt(np.nanmean(column(r, BEST, name, "error")[:REVOLUTION])))


STUDY = Study(
    "grace", (Group("position", "m", slice(0, 3)),), None, parts, [*FINDINGS, *CHECKS], figure="figure_01",
    says="A satellite's GPS fixes have errors that follow one another. Is a filter honest that takes them for white, and one that "
    "is told?",
    found="In a typical epoch the first is not; the second is, or claims a little too much error. But four bursts of the fixes' "
    "errors rule all means, which decide little, and throw off both: the white one further, since its gate locks it out. With "
    "more R and less Q it errs like the other, and claims less. Neither NIS nor likelihood makes it honest, and what four hours "
    "called most probable failed.",
)  # fmt: skip
