"""The study of [Fan]: the runs, and the numbers that decide the paper's statements and our
findings.

The paper's curves and Table 1 are lost. A check that needs a level uses the level of an independent
prototype with ten runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.adaptive import innovation_window
from celnav.filters.joint import condition, joint
from celnav.filters.records import Epoch, Filter, FromFunctions, Info, State
from celnav.filters.run import run
from celnav.gaussian.belief import Gaussian, nees
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import unscented
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.models import pseudorange
from celnav.papers.aukf.scenario import (
    GROUPS,
    STANDARD,
    Config,
    adapted,
    burst,
    filters,
    noise_factors,
    simulate,
    trial,
    ukf,
)
from celnav.receiver import day
from celnav.study import numbers
from celnav.study.ledger import Bounds, Decision, Number, Tiers, estimate, read_ledger
from celnav.study.montecarlo import BRIEF
from celnav.study.numbers import (
    SAME_ORDER,
    Decided,
    all_of,
    consistency,
    constant,
    count_holding,
    of,
    ratio,
    rmse,
    tiers,
)
from celnav.study.operations import counted
from celnav.study.study import Part, Results, Rngs, Study
from celnav.study.trial import Group

__all__ = [
    "AXES",
    "DENSITIES",
    "FILTERS",
    "HALVES",
    "INITIAL_KM",
    "INPUTS",
    "NORMAL_ERROR",
    "ROBUST",
    "STRUCK",
    "STUDY",
    "TILTS_DEG",
    "WINDOWS",
    "Flight",
    "counted",
    "gap",
    "later",
    "medians",
    "no_redraw",
    "nodes",
    "parts",
    "polar",
    "rms",
    "run_filters",
    "windows",
]

Arrays = dict[str, Array]
Change = Mapping[str, Any]
INPUTS = ("rinex",)
"""Arguments of `parts` that are also options of the command line: folders."""
AXES = tuple(Group(name, "m", slice(i, i + 1)) for i, name in enumerate("XYZ"))
SETTLED_S = 10.0
AFTER_S = 5.0
"""Errors before `SETTLED_S` are not counted; length of the window after the burst."""


def windows(c: Config, times: Array) -> dict[str, slice]:
    """Windows of a run: before, in and after the burst, its first epoch, just before it, the last
    half, all but the start, and all before the burst."""
    start, end = c.burst_s
    spans = {
        "quiet": (SETTLED_S, start),
        "burst": (start, end),
        "after": (end, end + AFTER_S),
        "first": (start, start + c.interval_s),
        "before": (start - 2.0, start),
        "settled": (0.5 * times[-1], np.inf),
        "all": (SETTLED_S, np.inf),
        "start": (0.0, start),
    }
    return {
        name: slice(*np.searchsorted(times, np.subtract(span, 1e-6)).tolist())
        for name, span in spans.items()
    }


# -- runs ------------------------------------------------------------------------------------------
PAIR = ("ukf", "aukf")
THREE = ("ekf", "ukf", "aukf")
HALVES = ("ranges", "rates")
FILTERS = ("ls", *PAIR, "group", "channel", "sage-husa", "student", "huber", "gate")
"""Without the EKF, which gives the same estimates as the UKF."""
BURSTS = ("ranges", "both", "one")
DENSITIES = {
    "1 Hz": (1.0, 10.0, 100.0, 300.0, 1000.0),
    "10 Hz": (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0),
}
"""Densities of the white acceleration in the filters, m^2/s^3."""
INITIAL_KM = (1.0, 10.0, 100.0, 1000.0)
SPANS = {
    "none": "without a burst",
    "all": "all epochs",
    "burst": "in the burst",
    "after": "after the burst",
}
"""Parts and windows in words."""
WRONG = {
    "near/Q 0.1": "process noise Q times 0.1",
    "near/Q 10": "process noise Q times 10",
    "near/R 0.3": "σ of the ranges times 0.3",
    "near/R 3": "σ of the ranges times 3",
    "far": "initial error times 10",
}
"""Parts with wrong statistics, in words."""
STARTS = ("10/10", "1e3/1e3", "1e3/10", "1e5/1e5", "1e5/10", "1e6/1e6", "1e6/10")
"""Standard deviations of the initial position, m: true / assumed."""
START_M = (10.0, 1e2, 1e3, 1e4, 1e5, 1e6)
WINDOWS = (1, 2, 5, 10, 20, 50, 100)
"""Initial standard deviations of the position at 10 Hz, each assumed correctly and as a tenth; and
epochs in the window of the AUKF."""
SHAPES = {"noise": "noise of 50 m", "constant": "an error of 50 m"}
STRUCK = range(1, 13)
ROBUST = (*PAIR, "group", "channel", "huber")
"""Errors that are added to bad ranges (a constant on all ranges is a clock step), numbers of bad
ranges of twelve, and the compared filters."""
READINGS = tuple(
    f"{channels}, {rate}"
    for rate in ("10 Hz", "1 Hz")
    for channels in ("ranges", "ranges and rates", "one range")
)
"""Parts for the possible interpretations of the burst, which the paper does not specify."""


class Flight(NamedTuple):
    """Filters by name that run on the standard configuration with a change, and with the further
    changes of each case.

    cases: by a prefix of the filters' names. anew: whether each case has its own random numbers.
    """

    names: Sequence[str]
    change: Change = {}  # noqa: RUF012
    cases: Mapping[str, Change] = {"": {}}
    anew: bool = False


def parts(effort: float = 1.0, rinex: Path | None = None) -> dict[str, Part]:
    """All parts of the study; ``rinex``: folder of a station's files. At an effort below `BRIEF`
    the burst at 10 Hz is earlier and shorter, and operations are counted with fewer satellites."""
    standard = STANDARD
    sky = STANDARD
    end = 15.0
    slower = {}
    if effort < BRIEF:
        standard = replace(STANDARD, burst_s=(15.0, 20.0), duration_s=25.0)
        sky = replace(STANDARD, mask_deg=50.0)
        end = 8.0
        slower = {"burst_s": STANDARD.burst_s, "duration_s": STANDARD.duration_s}
    few = 20
    many = STANDARD.runs
    rest = STANDARD.deviation[1:]
    Q = "acceleration_noise_m2_per_s3"
    quiet: dict[str, Any] = {"burst": "none"}
    second = {"interval_s": 1.0, **slower}
    mistuned = {"true_sigma_range_m": 10.0}
    # The first ends where a burst would start, the second with the last window that is evaluated.
    before = {**quiet, "duration_s": standard.burst_s[0]}
    judged = {"duration_s": standard.burst_s[1] + AFTER_S}
    slow = {**quiet, **second}
    short = {**quiet, "duration_s": 15.0}
    one_range = {"burst": "one", "burst_s": (15.0, 25.0)}
    bursts = {f"{burst}/": {"burst": burst} for burst in BURSTS}
    change: dict[str, Any]
    cases: dict[str, dict[str, Any]]
    out: dict[str, Part] = {}

    def add(number: int, runs: int, *draws: Mapping[str, Flight]) -> None:
        """Add parts with a number. Their random numbers are drawn one after the other; flights in
        the same dict share them."""
        earlier: list[Config] = []
        for draw in draws:
            for name, flight in draw.items():
                c = replace(standard, **flight.change)
                cost = 3e-5 * runs * c.samples * len(flight.names) * len(flight.cases)
                out[name] = Part(
                    partial(run_filters, flight, tuple(earlier)), c, number, runs, cost=cost
                )
            earlier.append(c)

    none = Flight(("ls", *THREE), quiet)
    add(0, many, {"none": none}, {"ranges, 10 Hz": Flight((*THREE, "group"))})

    disturbed = {**bursts, "mistuned/": {**quiet, **mistuned}}
    add(1, few, {"baselines": Flight(FILTERS, judged, disturbed, anew=True)})

    densities = []
    for rate, values in DENSITIES.items():
        cases = {f"{q:g}/": {Q: q} for q in values}
        change = slow if rate == "1 Hz" else before
        densities.append({f"densities, {rate}": Flight(("ekf", "aukf", "group"), change, cases)})
    add(2, few, *densities)

    initial = []
    for km in INITIAL_KM:
        change = {**slow, "deviation": (1e3 * km, *rest), "duration_s": 30.0}
        initial.append({f"{km:g} km": Flight(("ls", *THREE), change)})
    add(4, few, *initial)

    points = ("ukf", "no redraw")
    add(5, 2 * few, {"matched": Flight(points, {**slow, Q: 100.0, "motion": "model"})})
    add(6, few, {"redraw": Flight(points, before)})
    add(7, many, {"ranges and rates, 10 Hz": Flight(PAIR, bursts["both/"])})

    slow_bursts = zip(READINGS[3:], bursts.values(), strict=True)
    add(8, many, *({part: Flight(PAIR, {**burst, **second})} for part, burst in slow_bursts))

    add(9, many, {"one range, 10 Hz": Flight(PAIR, {**one_range, "duration_s": 40.0})})

    several = []
    for k in (3, 8):
        change = {**one_range, "duration_s": 25.0, "burst_count": k}
        several.append({f"{k} ranges": Flight(PAIR, change)})
    add(10, many, *several)

    near = {"deviation": (1e3, *rest), "burst_s": (10.0, 12.0), "duration_s": 12.0}
    add(11, many, {"burst from 1 km": Flight(THREE, near)})

    wrong = {}
    for scale in (0.01, 0.1, 1.0, 10.0):
        change = {**short, Q: scale * STANDARD.acceleration_noise}
        wrong[f"near/Q {scale:g}"] = Flight(PAIR, change)
    for scale in (0.3, 3.0):
        change = {**short, "sigma_range_m": scale * STANDARD.sigma_range_m}
        wrong[f"near/R {scale:g}"] = Flight(PAIR, change)
    far = {**short, "deviation": (100.0, *rest), "assumed_m": 10.0}
    add(12, many, wrong, {"far": Flight(PAIR, far)})

    starts = []
    for true in ("10", "1e3", "1e5", "1e6"):
        change = {**slow, "deviation": (float(true), *rest)}
        change["duration_s"] = 120.0 if true == "1e6" else 60.0
        flights = {}
        for assumed in (true, "10"):
            flights[f"{true}/{assumed}"] = Flight(THREE, {**change, "assumed_m": float(assumed)})
        starts.append(flights)
    add(13, 2 * many, *starts)

    lengths = ("ukf", *(f"M {m}" for m in WINDOWS))
    rates = {"windows, 10 Hz": Flight(lengths, judged), "windows, 1 Hz": Flight(lengths, second)}
    add(14, many, rates)

    cases = {}
    for shape, k in product(SHAPES, STRUCK):
        cases[f"{shape} {k}/"] = {"burst": "one", "burst_shape": shape, "burst_count": k}
    change = {"mask_deg": 20.0, "burst_s": (5.0, end), "duration_s": end}
    add(15, few, {"struck": Flight(ROBUST, change, cases)})

    cases = {}
    for true_m, k in product(START_M, (1, 10)):
        assumed_m = true_m / k
        cases[f"{true_m:g}/{assumed_m:g}/"] = {
            "deviation": (true_m, *rest),
            "assumed_m": assumed_m,
        }
    add(16, 3 * few // 2, {"starts": Flight(PAIR, {**quiet, "duration_s": 20.0}, cases)})

    add(17, 5 * many, {"mistuned": Flight(PAIR, {**quiet, **mistuned})})
    add(18, 8 * many, {"quiet": Flight(PAIR, before)})
    for number, work in enumerate((nodes, polar, transform, operations), 50):
        out[work.__name__] = Part(work, sky, number)
    out["orbits"] = Part(day.formulas, tuple(STANDARD.times[::100].tolist()))
    if (files := day.found(rinex)) is not None:
        real = partial(
            day.run_filters,
            names=(*THREE, "group"),
            sigma=STANDARD.burst_sigma,
            mask_deg=STANDARD.mask_deg,
        )
        out["real"] = Part(real, files, 60, cost=15.0)
    return out


def run_filters(flight: Flight, earlier: Sequence[Config], config: Config, rngs: Rngs) -> Arrays:
    """Filters on a configuration, with random numbers that follow those of ``earlier``
    configurations.

    Returns
    -------
    times ``(T,)`` s. For each filter ``<case><filter>/error (T, runs, 3)`` m of the position, nan
    after a run has failed; nis and nees ``(T, runs)``. For the AUKF the results of `of_factors`,
    ``(T, runs)``.
    """
    for before in earlier:
        simulate(before, rngs)
    sims = [
        simulate(replace(config, **change), rngs if flight.anew else deepcopy(rngs))
        for change in flight.cases.values()
    ]
    truth, z = (
        np.stack([getattr(sim, what) for sim in sims], 1) for what in ("truth", "z")
    )  # (T, cases, runs, ...)
    prior = Gaussian(
        *(np.stack([getattr(sim.prior, what) for sim in sims]) for what in ("mean", "cov"))
    )
    S = len(sims[0].satellites.names)
    Q = np.stack([sim.config.Q for sim in sims])[:, None]
    struck = np.stack([burst(sim.config, S)[:, None, :S] > 0.0 for sim in sims], 1)
    bank = {**filters(config, S, Q), "no redraw": no_redraw(config, S)}
    bank |= {f"M {m}": adapted(config, S, ukf(config), innovation_window(m), Q=Q) for m in WINDOWS}
    epochs = list(sims[0]._replace(truth=truth, z=z).epochs())
    out = {"times": config.times}
    for name in flight.names:
        rows = ("mean", "cov", "innovation")
        track = run(bank[name], prior, epochs, keep=rows, on_failure="flag")
        errors = np.asarray(track.mean) - truth
        columns = {
            "error": errors[..., :3],
            "nis": track.nis,
            "nees": nees(errors, track.sqrt_cov),
        }
        if name == "aukf":
            columns |= of_factors(noise_factors(track, config, S), struck)
        for i, case in enumerate(flight.cases):
            out |= {f"{case}{name}/{what}": values[:, i] for what, values in columns.items()}
    return out


def of_factors(A: Array, struck: Array) -> Arrays:
    """Mean noise factors of the AUKF, and the share of factors above 1 or 2, by name.

    A: factors of ranges and rates ``(T, ..., 2 S)``. struck: which ranges are disturbed ``(T, ...,
    S)``.
    """
    ranges, rates = np.split(A, 2, -1)
    out: Arrays = {}
    for half, factors in zip(HALVES, (ranges, rates), strict=True):
        out |= {half: factors.mean(-1), f"{half} above 1": (factors > 1.0).mean(-1)}

    def mean_over(mask: Array, values: Array) -> Array:
        return np.asarray((values * mask).sum(-1) / np.maximum(mask.sum(-1), 1))

    return out | {
        "bad": mean_over(struck, ranges),
        "good": mean_over(~struck, ranges),
        "good above 2": mean_over(~struck, ranges > 2.0),
    }


def no_redraw(config: Config, S: int) -> Filter:
    """UKF whose update uses the sigma points of the prediction, which lack the process noise."""
    plain = filters(config, S)["ukf"]
    W = np.linalg.cholesky(config.Q)
    V = np.sqrt(config.R(S))

    def moved(points: Array, epoch: Epoch) -> tuple[Array, Array]:
        points = points @ config.F.T
        return pseudorange.measure(points, *epoch.u), points

    def step(state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        if not epoch.dt:
            return plain.step(state, epoch)
        both = joint(
            ukf(config),
            state.belief,
            moved,
            epoch,
            z=np.asarray(epoch.z),
            process_noise=W,
            measurement_noise=V,
        )
        posterior, info, _ = condition(type(state.belief), both, EUCLIDEAN)
        return State(posterior, state.memory), (info,)

    return FromFunctions(plain.start, step)


# -- results without filters on runs ---------------------------------------------------------------
TILTS_DEG = (55.0, 10.0, 1.0, 0.1, 0.01)
NORMAL_ERROR = 1e-4
"""Standard deviation of the direction of an orbit's normal on each axis, rad."""


def nodes(_: Config, rngs: Rngs) -> Arrays:
    """Standard deviations (deg) by inclination: of the node, and of the position across the orbit,
    half-way between node and highest point."""
    i = np.radians(TILTS_DEG)
    u = np.radians(45.0)
    along, across = NORMAL_ERROR * rngs[0].standard_normal((2, 200_000, 1))
    # With the node on the x axis the normal is (0, -sin i, cos i). Its errors are along the node,
    # and perpendicular to node and normal.
    x = along
    y = -np.sin(i) - across * np.cos(i)
    z = np.cos(i) - across * np.sin(i)
    off = np.cos(u) * x + np.sin(u) * (np.cos(i) * y + np.sin(i) * z)
    return {
        name: np.degrees(np.sqrt(np.square(e).mean(0)))
        for name, e in (("node", np.arctan2(x, -y)), ("place", off))
    }


def polar(_: Config, rngs: Rngs) -> Arrays:
    """Transform from polar coordinates, 1 +- 0.02 and 90 +- 15 deg, to Cartesian coordinates:
    samples, images of the sigma points, means and standard deviations."""
    rule = unscented(2, 1.0, 0.0, 1.0)
    mean = np.array([1.0, np.pi / 2.0])
    std = np.array([0.02, np.radians(15.0)])

    def cartesian(noise: Array) -> Array:
        r, angle = np.split(mean + std * noise, 2, -1)
        return np.concatenate([r * np.cos(angle), r * np.sin(angle)], -1)

    draws, images, linear = map(
        cartesian, (rngs[0].standard_normal((1_000_000, 2)), rule.nodes, np.zeros(2))
    )
    center = rule.wm @ images
    exact = np.exp(-0.5 * std[1] ** 2) * linear
    return {
        "draws": draws[:2000],
        "images": images,
        "error": np.abs(center - exact)[1:],
        "linearized": np.stack([linear, std[::-1]]),
        "exact": np.stack([exact, draws.std(0)]),
        "unscented": np.stack([center, np.sqrt(rule.wc @ np.square(images - center))]),
    }


def transform(_: Config, rngs: Rngs) -> Arrays:
    """The unscented transform of random quadratic maps of 2 to 8 Gaussians, compared with exact
    moments.

    mean: largest relative error. slope: order of the covariance's error in the standard deviation.
    """
    (rng,) = rngs
    mean = []
    slope = []
    for n in range(2, 9):
        rule = unscented(n, 1.0, 2.0, 0.0)
        A = rng.standard_normal((3, n, n))
        J = rng.standard_normal((3, n))
        A = A + A.mT
        root = rng.standard_normal((n, n))
        errors = []
        for L in (root, 0.1 * root):
            x = rule.nodes @ L.T
            B = L.T @ A @ L
            y = x @ J.T + 0.5 * np.einsum("pi,kij,pj->pk", x, A, x)
            exact = 0.5 * np.trace(B, axis1=1, axis2=2)
            P = J @ L @ L.T @ J.T + 0.5 * np.einsum("kij,lji->kl", B, B)
            center = rule.wm @ y
            mean.append(np.abs(center - exact).max() / np.abs(exact).max())
            errors.append(np.linalg.norm((rule.wc * (y - center).T) @ (y - center) - P))
        slope.append(np.log10(errors[0] / errors[1]))
    return {"mean": np.array(mean), "slope": np.array(slope)}


def operations(config: Config, rngs: Rngs) -> Arrays:
    """Arithmetic operations of a step of EKF and UKF, for one run with all satellites."""
    sim = simulate(replace(config, duration_s=config.interval_s, burst="none"), rngs)
    bank = filters(sim.config)
    return counted({name: bank[name] for name in ("ekf", "ukf")}, sim.prior, sim.epochs())


# -- numbers of the ledger -------------------------------------------------------------------------
def rms(r: Results, part: str, name: str, at: str, group: str = "position") -> float:
    """RMSE of a group in a window, m."""
    return float(np.sqrt(r.squares(part, name, group, at).sum(-1).mean()))


def over(
    label: str, part: str, a: str, b: str, at: str, accept: Bounds = (None, None), **more: Any
) -> Decided:
    """Position RMSE ratio of filters ``a`` and ``b`` of the same part, in a window."""
    return ratio(label, (part, a), (part, b), "position", accept, at=at, **more)


def by_axis(
    label: str, part: str, a: str, b: str, at: str, accept: Bounds = (None, 1.0)
) -> list[Decided]:
    """`over` for X, Y and Z."""
    return [ratio(f"{g.name}, {label}", (part, a), (part, b), g.name, accept, at=at) for g in AXES]


def apart(label: str, a: str, b: str, at: str, most: float, r: Results) -> Number:
    """RMS difference of two filters' estimates without a burst, relative to the RMSE of the
    second."""
    away = (r.error("none", a, "position") - r.error("none", b, "position"))[r.at("none", at)]
    return Number(
        label, float(np.sqrt(np.square(away).sum(-1).mean())) / rms(r, "none", b, at), (None, most)
    )


def correlation(name: str, accept: Bounds, r: Results) -> Number:
    """Correlation of the position error from one epoch to the next."""
    e = r.error("none", name, "position")[r.at("none", "all")]
    moments = [(e[1:] * e[:-1]).mean((0, 2)), np.square(e).mean((0, 2))]
    return estimate(
        f"correlation of successive position errors, {name.upper()}",
        lambda x, y: x.mean() / y.mean(),
        moments,
        accept,
    )


def same(r: Results) -> list[Number]:
    """EKF and UKF on the paper's runs: largest difference (m, and relative to the RMSE), ratios by
    axis, and initial errors from which they differ."""
    cases = [
        ("none", "all"),
        ("ranges, 10 Hz", "all"),
        ("burst from 1 km", "start"),
        ("burst from 1 km", "burst"),
    ]
    ekf, ukf = (
        [r.error(part, name, "position")[r.at(part, at)] for part, at in cases]
        for name in ("ekf", "ukf")
    )
    most = [float(np.abs(x - y).max()) for x, y in zip(ekf, ukf, strict=True)]
    far = [
        difference / rms(r, part, "ekf", at)
        for difference, (part, at) in zip(most, cases, strict=True)
    ]
    return [
        Number("largest difference of EKF and UKF (m)", max(most[:2])),
        Number("largest difference of EKF and UKF over the RMSE", max(far[:2]), (0.01, None)),
        Number("largest difference of EKF and UKF over the RMSE, from 1 km", max(far[2:])),
        *(
            Number(
                f"median position error, EKF over UKF, from {km:g} km, after 5 epochs", ahead(r, km)
            )
            for km in (10.0, 100.0)
        ),
        *(
            number(r)
            for part, at in cases
            for number in by_axis(
                f"RMSE of UKF over EKF, {SPANS.get(part, part)}, {SPANS.get(at, 'before')}",
                part,
                "ukf",
                "ekf",
                at,
            )
        ),
    ]


def medians(r: Results, km: float, name: str) -> Array:
    """Median of the position error over the runs ``(T,)`` m."""
    return np.asarray(
        np.median(np.linalg.norm(r.error(f"{km:g} km", name, "position"), axis=-1), axis=1)
    )


def ahead(r: Results, km: float) -> float:
    """Median error of the EKF over that of the UKF after five epochs."""
    return float(medians(r, km, "ekf")[5] / medians(r, km, "ukf")[5])


def undisturbed(share: bool = False) -> list[Decided]:
    """AUKF and UKF before any burst, by axis over all runs: ratio of RMSE, or ``share`` of runs in
    which the AUKF is better."""
    parts = ("none", *READINGS[:2], "quiet")

    def number(axis: str, r: Results) -> Number:
        u, a = (
            np.concatenate([r.squares(part, name, axis, "quiet")[:, 0] for part in parts])
            for name in PAIR
        )
        if share:
            return estimate(
                f"{axis}, share of runs with a smaller RMS error than the UKF's",
                np.mean,
                [(a < u) * 1.0],
                (0.95, None),
            )
        return estimate(
            f"{axis}, RMSE over the UKF's",
            lambda x, y: np.sqrt(x.mean() / y.mean()),
            [a, u],
            (None, 1.0),
        )

    return [partial(number, axis.name) for axis in AXES]


def suppressed(part: str) -> list[Decided]:
    """RMSE of the AUKF in the burst, relative to the UKF's RMSE, to its own RMSE without a burst,
    and to the UKF's RMSE by axis."""
    over_quiet = over(
        f"{part}: RMSE in the burst over that before it",
        part,
        "aukf",
        "aukf",
        "burst",
        (None, SAME_ORDER),
        to="quiet",
    )
    return [
        over(f"{part}: RMSE in the burst over the UKF's", part, "aukf", "ukf", "burst"),
        over_quiet,
        *by_axis(f"RMSE in the burst over the UKF's, {part}", part, "aukf", "ukf", "burst"),
    ]


def recovery(part: str) -> list[Decided]:
    """Time after the burst until the position error is below twice the quiet RMSE, for the AUKF and
    relative to the UKF; RMSE after the burst relative to the UKF."""

    def seconds(r: Results, name: str) -> Array:
        burst = r.at(part, "burst")
        assert isinstance(burst, slice)
        error = np.linalg.norm(r.error(part, name, "position")[burst.stop :], axis=-1)
        return float(r.parts[part].config.interval_s) * first(
            error < 2.0 * rms(r, part, name, "quiet"), 1
        )

    def faster(r: Results) -> Number:
        both = [seconds(r, name) for name in ("aukf", "ukf")]
        return estimate(
            f"{part}: recovery time over the UKF's",
            lambda x, y: x.mean() / y.mean(),
            both,
            (None, 1.0),
        )

    return [
        lambda r: estimate(
            f"{part}: recovery time (s)", np.mean, [seconds(r, "aukf")], (None, 10.0)
        ),
        faster,
        over(
            f"{part}: RMSE in the 5 s after the burst over the UKF's",
            part,
            "aukf",
            "ukf",
            "after",
            (None, 1.0),
        ),
    ]


def first(below: Array, more: int = 0) -> Array:
    """First epochs ``(runs,)`` at which ``below (T, runs)`` is true, plus ``more``; T where it
    never is."""
    return np.where(below.any(0), below.argmax(0) + more, len(below))


def outliers(count: int, at: str) -> list[Decided]:
    """RMSE of the AUKF with outliers in ``count`` ranges, at one epoch or for ten seconds, relative
    to its quiet RMSE and to the UKF's RMSE."""
    part = {1: "one range, 10 Hz", 15: "ranges, 10 Hz"}.get(count, f"{count} ranges")
    label = (
        f"{count} bad range{'s' * (count > 1)}, {'one epoch' if at == 'first' else 'ten seconds'}"
    )
    quiet_bounds, ukf_bounds = (
        ((None, None), (None, None)) if count == 15 else ((None, SAME_ORDER), (None, 1.0))
    )
    return [
        over(
            f"{label}: RMSE over that before it", part, "aukf", "aukf", at, quiet_bounds, to="quiet"
        ),
        over(f"{label}: RMSE over the UKF's", part, "aukf", "ukf", at, ukf_bounds),
    ]


def sensitive(r: Results) -> Tiers:
    """Largest increase of the RMSE if statistics, or the initial error, are wrong by at most a
    factor of 10; settling time in epochs from wrong initial errors."""
    *costs, far = [
        ratio(
            f"RMSE over that with the right values, {wrong}",
            (part, "ukf"),
            ("near/Q 1", "ukf"),
            "position",
            at="all",
        )(r)
        for part, wrong in WRONG.items()
    ]
    ends = [
        r.error(name, "ukf", "position")[-1]
        for name, part in r.parts.items()
        if part.number in (12, 13)
    ]
    lost = Number("failed runs", sum(int(np.isnan(end).any(-1).sum()) for end in ends))
    right, *epochs = [
        estimate(
            f"epochs to settle, {initial(start)}",
            np.median,
            [settling(r, start, "ukf")],
        )
        for start in STARTS
    ]
    most = max(costs, key=lambda n: n.value)
    slow = epochs[STARTS.index("1e3/10") - 1]._replace(accept=(right.value + 1.0, None))
    return {
        "reproduced": [most._replace(accept=(2.0, None))],
        "in part": [most._replace(accept=(1.01, None)), slow],
        "not reproduced": [far, lost, *epochs, *costs],
    }


def initial(start: str) -> str:
    """Standard deviations of the initial position, true and assumed, in words."""
    return "initial error {} m, assumed {} m".format(
        *(f"{float(x):,.0f}" for x in start.split("/"))
    )


def settling(r: Results, start: str, name: str) -> Array:
    """Epochs ``(runs,)`` until the position error is below twice the settled RMSE, the RMSE of the
    last half with an initial error of 10 m."""
    errors, settled = (
        np.linalg.norm(r.error(part, name, "position"), axis=-1) for part in (start, STARTS[0])
    )
    return first(errors < 2.0 * np.sqrt(np.square(settled[len(settled) // 2 :]).mean()))


def later(label: str, part: str, case: str, most: float, r: Results, since: int = 0) -> Number:
    """Median over the runs of the delay (s) of the AUKF relative to the UKF, until the position
    error stays below a level."""

    def until(name: str) -> Array:
        below = np.linalg.norm(r.error(part, case + name, "position")[since:], axis=-1) < most
        return float(r.parts[part].config.interval_s) * (len(below) - first(~below[::-1]))

    return estimate(
        f"{label}: delay of the AUKF against the UKF (s)",
        lambda u, a: np.median(a - u),
        [until(name) for name in PAIR],
    )


def convergence(r: Results) -> list[Number]:
    """Number of initial errors from which the AUKF reaches three times the settled error of the UKF
    sooner, or later; and the delay after the burst."""
    quick, slow = (
        3.0 * rms(r, *case, "settled") for case in (("starts", "10/10/ukf"), (STARTS[0], "ukf"))
    )
    cases = [f"{true:g}/{true / k:g}" for true in START_M for k in (1, 10)]
    starts = [later(f"10 Hz, {initial(case)}", "starts", f"{case}/", quick, r) for case in cases]
    starts += [later(f"1 Hz, {initial(start)}", start, "", slow, r) for start in STARTS]
    sooner, longer = (
        [n._replace(accept=side) for n in starts] for side in ((None, -1.0), (1e-9, None))
    )
    return [
        count_holding(
            "initial errors from which the AUKF settles sooner by 1 s", sooner, (None, 0)
        ),
        count_holding("initial errors from which the AUKF settles later", longer, (1, None)),
        after_burst(r)._replace(accept=(None, -1.0)),
        *starts,
    ]


def gap(r: Results) -> list[Number]:
    """RMSE ratio of AUKF to UKF without a burst if the noise is larger than assumed, and its excess
    over the ratio with correct noise."""
    squares = [
        r.squares(part, name, "position", "all").sum(-1)
        for part in ("mistuned", "quiet")
        for name in PAIR
    ]
    least = min(map(len, squares))

    def larger(u: Array, a: Array, v: Array, b: Array) -> float:
        return float((1.0 - np.sqrt(a.mean() / u.mean())) / (1.0 - np.sqrt(b.mean() / v.mean())))

    label = "RMSE gained on the UKF over that with the right noise"
    paired = [values[:least] for values in squares]
    wider = estimate(label, larger, paired, (SAME_ORDER, None))
    return [
        over(
            "RMSE over the UKF's, noise of 10 m, assumed 3 m",
            "mistuned",
            "aukf",
            "ukf",
            "all",
            (None, 1.0),
        )(r),
        wider,
    ]


def window_range(r: Results) -> list[Number]:
    """RMSE ratio of AUKF to UKF, without and in the burst, by window length; the number of lengths
    with a smaller RMSE in both; the best length."""
    out = list[Number]()
    for rate, decade, least in (("10 Hz", (10, 20, 50, 100), None), ("1 Hz", (), 0.5)):
        part = f"windows, {rate}"
        spans = ("quiet", "burst", "after")
        ratios = {
            m: [
                over(
                    f"{rate}, window of {m} epochs: RMSE over UKF's {SPANS.get(at, 'before')}",
                    part,
                    f"M {m}",
                    "ukf",
                    at,
                    (None, 1.0 - 1e-9),
                )(r)
                for at in spans
            ]
            for m in WINDOWS
        }
        both = [
            max(n[:2], key=lambda number: (number.ci or (0.0, 0.0))[1]) for n in ratios.values()
        ]
        best = min(WINDOWS, key=lambda m: rms(r, part, f"M {m}", "burst"))
        quiet, struck, after = (n._replace(accept=(None, None)) for n in ratios[best])
        out += [
            count_holding(
                f"{rate}: windows with a smaller RMSE than the UKF's before and in the burst",
                both,
                (None, None),
            ),
            Number(f"{rate}: best window in the burst (epochs)", best),
            quiet,
            struck._replace(accept=(least, None)),
            after,
            *(n for m in decade for n in ratios[m][:2]),
        ]
    return out


def bad(shape: str, k: int, name: str, most: Bounds, own: bool = True) -> Decided:
    """RMSE in the burst on ``k`` of twelve ranges, relative to the RMSE just before it (``own``) or
    to the UKF's RMSE."""
    case = f"{shape} {k}/"
    said = {"aukf": "AUKF", "huber": "Huber's weights"}.get(name, f"{name} parity")
    label = f"RMSE over {('the UKF', 'that before it')[own]}, {said}, {SHAPES[shape]} on {k} of 12"
    return over(
        label,
        "struck",
        case + name,
        case + (name if own else "ukf"),
        "burst",
        most,
        to="before" if own else None,
    )


def limits(r: Results) -> list[Number]:
    """Number of bad ranges up to which the AUKF is better than the UKF, and below twice its quiet
    error; share of the good ranges that are inflated."""
    out = list[Number]()
    for shape, least in zip(SHAPES, (12, 6), strict=True):
        better, near_quiet = (
            [bad(shape, k, "aukf", (None, most), most > 1.0)(r) for k in STRUCK]
            for most in (1.0, 2.0)
        )
        out += [
            count_holding(
                f"{SHAPES[shape]}: number of bad ranges up to which the AUKF beats the UKF",
                better,
                (least, None),
                leading=True,
            ),
            count_holding(
                f"{SHAPES[shape]}: number of bad ranges up to which the RMSE does not double",
                near_quiet,
                (least, None),
                leading=True,
            ),
            *(near_quiet[k - 1]._replace(accept=(None, None)) for k in (6, 8, 12)),
        ]
    inflated = (
        consistency(
            "largest share of the good ranges whose R is multiplied by more than 2",
            ("struck", f"{shape} {k}/aukf"),
            (None, 0.1),
            at="burst",
            what="good above 2",
        )(r)
        for shape in SHAPES
        for k in STRUCK
    )
    means = (
        consistency(
            f"mean factor of R of the {what} ranges, 50 m on 8 of 12",
            ("struck", "constant 8/aukf"),
            at="burst",
            what=what,
        )(r)
        for what in ("bad", "good")
    )
    return [*out, max(inflated, key=lambda n: n.value), *means]


def after_burst(r: Results) -> Number:
    """Delay (s) of the AUKF relative to the UKF, until it stays below three times the quiet RMSE
    after the burst on ranges."""
    part = "ranges, 10 Hz"
    end = r.at(part, "burst").stop  # type: ignore[union-attr]
    return later("after the burst", part, "", 3.0 * rms(r, part, "ukf", "quiet"), r, end)


def converges(r: Results) -> Tiers:
    """Median number of epochs that the AUKF needs in addition to EKF and UKF; "in part" if it is
    sooner after the burst."""
    more = [
        estimate(
            f"epochs later than the {name.upper()}, {initial(start)}",
            lambda a, b: np.median(a) - np.median(b),
            [settling(r, start, "aukf"), settling(r, start, name)],
            (None, 0.5),
        )
        for start in STARTS
        for name in ("ekf", "ukf")
    ]
    least, most = (sorted(more, key=lambda n: n.value)[i] for i in (0, -1))
    return {
        "reproduced": [most, least._replace(accept=(None, -0.5)), *more],
        "in part": [after_burst(r)._replace(accept=(None, 0.0))],
    }


def rotation(r: Results) -> Tiers:
    """Growth of the standard deviations of node and position as the inclination falls by a factor
    of 10; errors of the formulas."""
    node = r.get("nodes", "node")
    place = r.get("nodes", "place")
    others = 1e-3 * r.get("orbits", "others")
    singular = [
        Number(
            "growth of the node's σ at a tenth of the inclination",
            float((node[2:4] / node[1:3]).min()),
            (10.0**0.5, None),
        ),
        Number(
            "growth of the position's σ over all inclinations",
            float(place.max() / place.min()),
            (None, 10.0**0.5),
        ),
    ]
    return {
        "reproduced": [
            *singular,
            of("orbits", "half hour", "error of the usual formula, rotated (m)", (None, 1.0))(r),
        ],
        "in part": [
            *singular,
            of("orbits", "right", "error if rotated with a node held in space (m)", (None, 1.0))(r),
        ],
        "not reproduced": [
            Number(
                "error of the usual formula, rotated, after a minute (km)",
                1e-3 * float(r.get("orbits", "minute").max()),
            ),
            Number("least error of the usual formula (km)", float(others.min())),
            Number("largest error of the usual formula (km)", float(others.max())),
        ],
    }


# -- the ledger ------------------------------------------------------------------------------------
DECISIONS: dict[str, Decision] = {
    "ls-rough": all_of(
        *by_axis("RMSE of LS over EKF", "none", "ls", "ekf", "all", (1.0, None)),
        partial(correlation, "ls", (None, 0.1)),
        partial(correlation, "ekf", (0.5, None)),
    ),
    "ukf-better-than-ekf": same,
    "no-extra-computation": all_of(
        numbers.operations("operations of a step over the EKF's", "ukf", "ekf", (None, 1.1)),
        constant("evaluations of the measurement", len(ukf(STANDARD).nodes)),
    ),
    "transform-second-order": all_of(
        of("transform", "mean", "error of the mean of random quadratic maps", (None, 1e-12)),
        of(
            "transform",
            "slope",
            "order of the covariance error in σ",
            (3.5, None),
            np.min,
        ),
        of("polar", "error", "error of the mean of y in the drawn example (m)", (None, 1e-4)),
    ),
    "ukf-sensitive": sensitive,
    "geo-needs-rotation": rotation,
    "a-is-identity": all_of(
        *(
            consistency(
                f"mean factor of R of the {half}",
                ("none", "aukf"),
                (0.99, 1.01),
                at="quiet",
                what=half,
            )
            for half in HALVES
        ),
        *(
            consistency(
                f"share of factors of {half} above 1",
                ("none", "aukf"),
                at="quiet",
                what=f"{half} above 1",
            )
            for half in HALVES
        ),
        partial(
            apart, "RMS difference of AUKF and UKF over the RMSE", "aukf", "ukf", "quiet", 0.01
        ),
    ),
    "system-noise-weakened": all_of(
        *(
            over(
                f"RMSE over the UKF's, process noise times {k}",
                f"near/Q {k}",
                "aukf",
                "ukf",
                "all",
                (None, 1.0),
            )
            for k in (0.01, 0.1, 10)
        ),
        over("RMSE over the UKF's, ten times the initial error", "far", "aukf", "ukf", "all"),
    ),
    "several-outliers": all_of(
        *(
            number
            for count in (1, 3, 8, 15)
            for at in ("first", "burst")
            for number in outliers(count, at)
        )
    ),
    "clearly-better-quiet": tiers(
        reproduced=[*undisturbed(True), *undisturbed()], in_part=undisturbed()
    ),
    "table-1-order": all_of(
        *undisturbed(),
        partial(apart, "RMS difference of EKF and UKF over the RMSE", "ekf", "ukf", "all", 1e-3),
    ),
    "burst-suppressed": tiers(
        reproduced=[n for part in READINGS for n in suppressed(part)],
        in_part=suppressed(READINGS[0]),
    ),
    "fast-recovery": tiers(
        reproduced=[n for part in READINGS for n in recovery(part)], in_part=recovery(READINGS[0])
    ),
    "faster-convergence": converges,
    "erratum-6-worse": all_of(
        over(
            "RMSE before the burst, without new sigma points over with them",
            "redraw",
            "no redraw",
            "ukf",
            "quiet",
            (5.0, None),
        ),
        consistency(
            "mean NEES without new sigma points", ("redraw", "no redraw"), (80.0, None), at="quiet"
        ),
        consistency(
            "mean NIS without new sigma points, truth from the model (30 if consistent)",
            ("matched", "no redraw"),
            (50.7, 62.1),
            at="all",
            what="nis",
        ),
    ),
    "recon-geo": of("orbits", "right", "difference from two-body orbits in space (m)", (None, 1.0)),
    "erratum-8-channels": over(
        "RMSE of the AUKF in a burst on ranges and rates over that on ranges",
        "baselines",
        "both/aukf",
        "ranges/aukf",
        "burst",
        (10.0, None),
    ),
    "baselines-group-ranges": all_of(
        over(
            "RMSE of group parity over the AUKF's, burst on ranges",
            "ranges, 10 Hz",
            "group",
            "aukf",
            "burst",
            (None, 1.1),
        ),
        over(
            "RMSE of group parity over the AUKF's, burst on rates too",
            "baselines",
            "both/group",
            "both/aukf",
            "burst",
            (None, 1.1),
        ),
        over(
            "RMSE of group parity over the AUKF's, after a burst on rates too",
            "baselines",
            "both/group",
            "both/aukf",
            "after",
            (None, 0.5),
        ),
    ),
    "baselines-group-one": over(
        "RMSE of group parity over the AUKF's, burst on one range",
        "baselines",
        "one/group",
        "one/aukf",
        "burst",
        (1.1, None),
    ),
    "figure-7b-gate": all_of(
        rmse(
            "position RMSE of the innovation gate in a burst on ranges and rates (m)",
            ("baselines", "both/gate"),
            "position",
            (100.0, None),
            at="burst",
        ),
        over(
            "RMSE of the innovation gate over the UKF's, too small R",
            "baselines",
            "mistuned/gate",
            "mistuned/ukf",
            "all",
            (1.0, None),
        ),
    ),
    "erratum-4-aukf": all_of(
        rmse(
            "position RMSE of the AUKF (m)",
            ("densities, 10 Hz", "1/aukf"),
            "position",
            (1e3, None),
            at="quiet",
        ),
        rmse(
            "position RMSE of the EKF (m)",
            ("densities, 10 Hz", "1/ekf"),
            "position",
            (None, 1.0),
            at="quiet",
        ),
    ),
    "figure-4-mistuned": gap,
    "start-ahead": lambda r: [
        Number(
            "median position error, EKF over UKF, from 1000 km, after 5 epochs",
            ahead(r, 1e3),
            (2.0, None),
        ),
        Number(
            "worst first fix by least squares, median error (m)",
            max(float(medians(r, km, "ls")[0]) for km in INITIAL_KM),
            (None, 10.0),
        ),
    ],
    "window-range": window_range,
    "outliers-limits": limits,
    "outliers-agree": all_of(
        bad("constant", 6, "aukf", (None, 2.0)),
        *(bad("constant", 6, name, (2.0, None)) for name in ROBUST[2:]),
    ),
    "convergence-paired": convergence,
    "figure-7-factor": consistency(
        "mean factor of R of the ranges",
        ("ranges, 10 Hz", "aukf"),
        (220.0, 310.0),
        at="burst",
        what="ranges",
    ),
    "process-group": all_of(
        *(
            over(
                f"RMSE of group parity over the EKF's, {rate}, {q:g} m²/s³",
                f"densities, {rate}",
                f"{q:g}/group",
                f"{q:g}/ekf",
                "quiet",
                (0.97, 1.03),
            )
            for rate, some in DENSITIES.items()
            for q in some
        )
    ),
    "process-nis": all_of(
        *(
            consistency(
                f"mean NIS of the EKF, {q} m²/s³",
                ("densities, 10 Hz", f"{q}/ekf"),
                bounds,
                at="quiet",
                what="nis",
            )
            for q, bounds in (("1", (171.0, 189.0)), ("1000", (25.5, 27.9)))
        )
    ),
    "matched-nees-ukf": consistency(
        "mean NEES of the UKF", ("matched", "ukf"), (7.4, 8.6), at="all"
    ),
}
DECISIONS |= {
    f"real-{id}": of("real", f"judged/{id}", "", accept) for id, (_, accept) in day.JUDGED.items()
}

ROWS, ANSWER = read_ledger(Path(__file__).with_name("ledger.toml"), DECISIONS)
STUDY = Study(
    "aukf",
    (*GROUPS, *AXES),
    trial,
    parts,
    ROWS,
    figure="figure_07",
    says="A UKF that adapts its measurement noise to the last innovations has smaller errors than "
    "EKF and UKF, converges faster, and is hardly affected by a burst of noise.",
    windows=windows,
    found=ANSWER,
)
