"""[Liang2014] judged: the runs, what the paper states and prints, what is wrong in it, and what we found beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise, product
from math import prod
from time import process_time
from typing import Any

import numpy as np
from scipy.linalg import sqrtm

from celnav.analysis import observability
from celnav.filters.joint import condition
from celnav.filters.model import Sensor
from celnav.filters.records import Epoch, Filter, FromFunctions
from celnav.filters.run import run
from celnav.filters.sequential import ekf, sigma_point
from celnav.gaussian.belief import Gaussian, nees
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule, gauss_hermite, simplex, tensor_product
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.gaussian.sparse_grid import ORDERS, integrates, point_count, smolyak
from celnav.models import earth, inertial
from celnav.papers.aasghqf.scenario import (
    ARCMIN, DEGREE, FORM, MICRO_G, NONLINEAR_WEIGHTS, PAPER_WEIGHTS, PRESETS, T3, A, Config, filters, groups, interval_before,
    measurement, model, quadrature_filter, rules, simulate, trial,
)  # fmt: skip
from celnav.study.ledger import Bounds, Number, Row, Tiers, estimate
from celnav.study.montecarlo import generator
from celnav.study.numbers import Decided, all_of, given, of, tiers
from celnav.study.study import Part, Results, Rngs, Study, fly
from celnav.study.trial import Noiseless, Trial

GROUPS = groups(A, DEGREE, "deg")
COMPARED = ("ukf", "sghqf", "aasghqf")
"""The paper's three filters."""
FLOWN = {
    "T3": (*COMPARED, "nonlinear", "triad-ekf"),
    "A": (*COMPARED, "nonlinear", "ckf", "ekf", "triad-ekf"),
    "A-slow": (*COMPARED, "nonlinear", "ckf", "ekf", "iekf", "triad-ekf"),
    "T3-arcmin": (*COMPARED, "nonlinear"),
}
MANY, MANY_RUNS = "T3, 200 runs", 200
START = ("ukf", "sghqf", "aasghqf", "nonlinear", "level4", "delayed", "ckf", "ckf5", "ghqf3", "ghqf5", "ekf", "triad-ekf")
"""Filters whose first star fix is studied over the size of the misalignment."""
MISALIGNMENTS_DEG = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0)
DIMENSIONS = (2, 4, 6, 8, 10, 13, 16, 20, 25, 30, 40)
TABLE_1_WEIGHTS = ((1,), (2, 1), (2, 1, 1), (2, 2, 1, 1), (2, 2, 1, 1, 1), (2, 2, 2, 1, 1, 1))
TABLE_1 = {"SGHQF": [7, 21, 37, 57, 81, 109], "AASGHQF": [7, 9, 23, 25, 41, 43]}
EXAMPLE = {(1, 1): [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (3, 1)], (2, 1): [(1, 1), (1, 3), (2, 1)]}
"""Weights -> indices that the paper lists for n = 2, level 3."""
TABLE_2 = [9.845, 9.845, 4.635, 1.0, 1.0, 9.639, 9.639, 6.984e-5, 6.937e-6, 5.937e-5, 6.686e-6, 3.795e-5, 3.652e-7]
TABLE_3 = {
    "UKF": [0.350, 0.367, 0.412, 0.527, 0.609, 18.163, 17.821], "SGHQF": [0.217, 0.203, 0.251, 0.328, 0.397, 16.274, 16.183],
    "AASGHQF": [0.223, 0.201, 0.256, 0.303, 0.426, 15.997, 16.285],
}  # fmt: skip
TABLE_4 = {"UKF": (27, 0.0021), "SGHQF": (417, 0.0065), "AASGHQF": (99, 0.0028)}
"""Points, and seconds of a cycle, as printed."""
SEVEN = ("φx", "φy", "φz", "east velocity", "north velocity", "longitude", "latitude")
PHI, POSITION = inertial.PHI, inertial.POSITION


# -- what is flown -----------------------------------------------------------------------------------------------------------
def judged(config: Config, rngs: Rngs) -> Trial:
    """A trial in the units of the paper."""
    return trial(config, rngs)._replace(groups=groups(config, DEGREE, "deg"))


def flown(names: Sequence[str], config: Config, rngs: Rngs) -> dict[str, Array]:
    """Filters by name, at all epochs."""
    return fly(judged(config, rngs), names)


def bound_filter(config: Config) -> Filter:
    """The extended filter linearized at the truth: its covariance is the conditional Cramer-Rao bound, its mean the truth."""
    linearized = ekf(*model(config), form=FORM)

    def step(state: Any, epoch: Epoch) -> tuple[Any, Any]:
        # Measurements as the prediction would have them: the update then moves nothing but the covariance.
        z = measurement(epoch.truth[None], epoch)[0] + np.where(np.isnan(epoch.z), np.nan, 0.0)
        after, infos = linearized.step(state, epoch._replace(z=z))
        return after._replace(belief=after.belief._replace(mean=epoch.truth)), infos

    return FromFunctions(linearized.start, step)


def bound(config: Config, rngs: Rngs) -> dict[str, Array]:
    """Deviations of the conditional Cramer-Rao bound for the misalignment, ``std (T, runs, 3)`` deg."""
    sim = simulate(config, rngs)
    std = run(bound_filter(config), Gaussian(sim.truth[0], sim.prior.cov), sim.epochs(), keep="std").std
    return {"std": np.asarray(std)[..., PHI] / DEGREE}


def start(config: Config, rngs: Rngs) -> dict[str, Array]:
    """NEES after the first star fix ``(1, runs)``, and whether it was done again with a positive rule."""
    sim = simulate(config, rngs)
    epoch, known, out = next(sim.epochs()), filters(config), {}
    known["level4"] = quadrature_filter(smolyak(13, 4, [1] * 3 + [3] * 10), config)
    for name in START:
        state, (info,) = known[name].step(known[name].start(sim.prior), epoch)
        out[f"{name}/nees"] = nees(state.belief.mean - epoch.truth, state.belief.sqrt_cov)[None]
        out[f"{name}/redone"] = np.zeros((1, len(rngs))) + (0.0 if info.redone is None else info.redone)
    return out


def alike(config: Config, rngs: Rngs) -> dict[str, Array]:
    """Largest differences ``(1, runs)``, in deviations, of rules that must agree: 43 to 75 points, and 57 to 417 in 50 s."""
    sim, known = simulate(config, rngs), filters(config)
    known["43"] = quadrature_filter(smolyak(13, 3, [1, 1] + [2] * 11), config)
    tracks: dict[str, Any] = {n: run(known[n], sim.prior, sim.epochs()) for n in ("43", "aasghqf", "nonlinear", "sghqf")}

    def apart(a: str, b: str, last: int | None) -> Array:
        return np.asarray((np.abs(tracks[a].mean - tracks[b].mean) / tracks[b].std)[:last].max((0, 2)))[None]

    return {"43-75": apart("43", "aasghqf", None), "57-417": apart("nonlinear", "sghqf", 51)}


def small(config: Config, rngs: Rngs) -> dict[str, Array]:
    """Largest difference to the Kalman filter ``(1, runs)``, in deviations of the prior, where the misalignment is 1e-5 rad."""
    sim, known = simulate(config, rngs), filters(config)
    names = ("ekf", "ukf", "sghqf", "aasghqf", "nonlinear", "ckf", "ghqf3")
    exact, *others = (np.asarray(run(known[name], sim.prior, sim.epochs(), keep="mean").mean) for name in names)
    return {"apart": np.max([np.abs((mean - exact) / config.sigma0).max((0, 2)) for mean in others], axis=0)[None]}


def timings(rounds: int, config: Config, _: Rngs) -> dict[str, Array]:
    """CPU seconds of a cycle (prediction and update) in each round ``(rounds,)``, of one run alone and of one among 50."""
    cases = {}
    for runs, steps in ((1, 20), (50, 10)):
        short = replace(config, steps=steps)
        sim, known = simulate(short, [generator(0, 98, r) for r in range(runs)]), filters(short)
        for name in COMPARED:
            cases[f"{name}, {runs}"] = (known[name], sim.prior, list(sim.epochs()), steps * runs)
    found: dict[str, list[float]] = {name: [] for name in cases}
    for _round in range(rounds):
        for name, (filter, prior, epochs, cycles) in cases.items():
            begin = process_time()
            run(filter, prior, epochs, keep="nothing")
            found[name].append((process_time() - begin) / cycles)
    return {name: np.array(seconds) for name, seconds in found.items()}


# -- what needs no runs ------------------------------------------------------------------------------------------------------
def first_epochs(config: Config) -> list[Epoch]:
    """The first two epochs of a flight without any error."""
    undisturbed: Any = [Noiseless()]
    return list(simulate(replace(config, steps=1), undisturbed).epochs())


def index_set(level: int, weights: Sequence[int]) -> dict[tuple[int, ...], int]:
    """Indices ``i`` from 1 with ``sum (i_j - 1) g_j <= (L - 1) min(g)``, and their coefficients [Liang2014, Eqs. 16, 17]."""
    budget, c = (level - 1) * min(weights), np.ones(1)
    for g in weights:  # a coefficient depends on the slack alone: [t^slack] prod_j (1 - t^g_j) / (1 - t)
        c = np.convolve(c, [1, *[0] * (g - 1), -1])
    coefficients, found = c.cumsum(), {}
    for index in product(*(range(1, budget // g + 2) for g in weights)):
        slack = budget - sum((i - 1) * g for i, g in zip(index, weights, strict=True))
        if slack >= 0:
            found[index] = int(coefficients[min(slack, len(c) - 1)])
    return found


def grid(indices: Mapping[tuple[int, ...], int]) -> dict[tuple[float, ...], list[float]]:
    """Union of the points of tensor rules, and the terms of a point's weight, one for each index that has it [Eqs. 13, 14]."""
    found: dict[tuple[float, ...], list[float]] = {}
    for index, c in indices.items():
        lines = [smolyak(1, i) for i in index]
        for part in product(*(zip(line.nodes[:, 0].tolist(), line.wm.tolist(), strict=True) for line in lines)):
            found.setdefault(tuple(x for x, _ in part), []).append(c * prod(w for _, w in part))
    return found


def printed_count(level: int, weights: Sequence[int], *, strict: bool) -> int:
    """Points over the index set as Eq. 18 prints it, its lower bound strict or not."""
    low = (level - 1) * min(weights) - sum(weights)
    cost = {index: sum((i - 1) * g for i, g in zip(index, weights, strict=True)) for index in index_set(level, weights)}
    return len(grid({index: 1 for index, value in cost.items() if value > low or (not strict and value == low)}))


def merged_at_the_origin(level: int, weights: Sequence[int]) -> int:
    """Number of points if those that tensor rules share elsewhere than at the origin are counted twice."""
    return 1 + sum(prod(ORDERS[i - 1] for i in index) - 1 for index, c in index_set(level, weights).items() if c)


def exactness(level: int, weights: Sequence[int]) -> int:
    """Total degree to which a grid is exact: one less than that of the first even monomial that it fails."""
    powers = product((0, 2, 4, 6, 8), repeat=len(weights))
    return min(sum(p) for p in powers if not integrates(p, level, weights)) - 1


def svd_degree(matrix: Array, reference: int | None = None) -> Array:
    """Degrees of observability ``(..., n)`` by singular values of observability matrices ``(..., rows, n)`` [Liang2014, Eq. 15].

    A state gets the singular value whose right vector has its largest component there, over that of the state ``reference``.
    """
    _, values, Vt = np.linalg.svd(matrix, full_matrices=False)
    degree = np.asarray(np.take_along_axis(values, np.abs(Vt).argmax(-2), -1))
    return degree if reference is None else degree / degree[..., reference, None]


def threshold_weights(degree: Any, threshold: float) -> tuple[int, ...]:
    """Weights by degrees of observability: 1 above the threshold, 2 at and below it [Liang2014, Eq. 19]."""
    return tuple(np.where(np.asarray(degree) > threshold, 1, 2).tolist())


def degrees(config: Config, _: Rngs) -> dict[str, Array]:
    """Observability at the start of the flight.

    every: degrees ``(288, 13)`` for every unit of angles, positions, drifts and biases, and of star residuals and fixes, the one
    that comes nearest to Table 2 first: rad, m, deg/h, micro g, 1, m. in degrees: the same with the misalignment in deg.
    information: prior over posterior deviation after a minute. weights: by nonlinearity.
    """
    first, second = first_epochs(config)
    nav = interval_before(config, 1, np.zeros(13))
    start = inertial.navigation(config.flight, 0, np.zeros(3), np.zeros(3))
    meters = config.meters
    unit = np.concatenate([np.ones(5), 1.0 / meters, np.full(3, DEGREE / 3600.0), np.full(3, MICRO_G)])

    def f(x: Array) -> Array:
        return inertial.derivative(x * unit, start) / unit

    def h(x: Array) -> Array:
        return measurement(x * unit, first) * np.concatenate([np.ones(6), meters])

    gradients, radius, sigma = observability.lie_gradients(f, h, np.zeros(13), 3), float(meters.mean()), config.sigma_z(0.0)
    units = product((1.0, DEGREE, ARCMIN, ARCMIN / 60.0), (1.0, radius, radius * DEGREE), (1.0, 3600.0 / DEGREE), (1.0, 1.0 / MICRO_G),
                    (1.0, 1.0 / sigma[0]), (1.0, 1.0 / radius, 1.0 / config.sar_m))  # fmt: skip
    scales = np.array([np.repeat(u, [3, 2, 3, 3, 6, 2]) for u in units])
    columns = np.insert(scales[:, :11], [3, 3], 1.0, axis=1)
    every = svd_degree((scales[:, None, 11:, None] * gradients * columns[:, None, None]).reshape(len(scales), -1, 13), 3)
    in_degrees = svd_degree((gradients * np.repeat([DEGREE, 1.0], [3, 10])).reshape(-1, 13), 3)
    bent = [lambda x: inertial.advance(x, nav, config.step_s), lambda x: measurement(x, first)]
    weights = observability.nonlinearity_weights(bent, np.zeros(13), config.sigma0, tolerance=1e-3)
    return {"every": every, "in degrees": in_degrees, "information": information(config), "weights": np.array(weights)}


def information(config: Config) -> Array:
    """Prior over posterior deviation ``(13,)`` after 60 epochs along the flight without errors, all sensors at each."""
    undisturbed: Any = [Noiseless()]
    epochs = list(simulate(replace(config, steps=60), undisturbed).epochs())
    H = [observability.jacobian(partial(measurement, epoch=epoch), np.zeros(13)) for epoch in epochs[:-1]]
    F = [observability.jacobian(partial(inertial.advance, nav=epoch.u.interval, dt=config.step_s), np.zeros(13)) for epoch in epochs[1:-1]]
    R = np.square(epochs[0].u.sqrt_R)
    return observability.information_degree(np.diag(config.sigma0**2), np.stack(F), np.stack(H), R)


def first_fixes(config: Config, _: Rngs) -> dict[str, Array]:
    """What rules make of the first star fix, from an isotropic misalignment; "exact" by a fine tensor rule.

    <rule>/least ``(angles,)``: smallest eigenvalue of the misalignment's covariance after it, relative to the prior.
    <rule>/sampled ``(angles,)``: of the innovation covariance without R, relative to its largest.
    <rule>/mean, <rule>/cov ``(angles,)``: relative errors of the mean and covariance of the star residuals.
    """
    epoch, noise = first_epochs(config)[0], config.sigma_z(0.0)[:6]
    stars = Sensor(lambda x, e: measurement(x, e)[..., :6], sqrt_R=np.diag(noise))
    out: dict[str, Array] = {}
    known = {"exact": tensor_product(gauss_hermite(3, 20), simplex(10)), **rules(config.level)}
    exact: dict[float, tuple[Array, Array]] = {}
    for name, rule in known.items():
        filter, rows = sigma_point(model(config)[0], stars, rule=rule, form=FORM), []
        for angle in np.radians(MISALIGNMENTS_DEG).tolist():
            prior = Gaussian(np.zeros((1, 13)), np.diag(np.square(np.concatenate([[angle] * 3, config.sigma0[3:]]))))
            seen = filter.measured(rule, stars, filter.start(prior).belief, np.zeros((1, 6)), epoch)
            mean, sampled = -np.asarray(seen.innovation)[0], seen.covariances()[0].reshape(6, 6)
            values, after = np.linalg.eigvalsh(sampled), condition(filter.form, seen, EUCLIDEAN)[0].cov[0, :3, :3]
            least = np.linalg.eigvalsh(after)[0] / angle**2 if np.isfinite(after).all() else np.nan
            right = exact.setdefault(angle, (mean, sampled))
            errors = [np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip((mean, sampled), right, strict=True)]
            rows.append([least, values[0] / values[-1], *errors])
        out |= {f"{name}/{what}": column for what, column in zip(("least", "sampled", "mean", "cov"), np.array(rows).T, strict=True)}
    return out


ROOTS: dict[str, Callable[[Array], Array]] = {
    "lower Cholesky": np.linalg.cholesky,
    "symmetric": lambda P: np.real(sqrtm(P)),
    "upper Cholesky": lambda P: np.linalg.cholesky(P[::-1, ::-1])[::-1, ::-1],
}


def root_errors(config: Config, rngs: Rngs) -> dict[str, Array]:
    """Relative errors ``(50,)`` of the mean star residuals over random correlated covariances, by rule and kind of root."""
    epoch, fine, scale = first_epochs(config)[0], gauss_hermite(3, 15), np.repeat([10.0 * DEGREE, 1.0], [3, 10])
    found: dict[str, list[float]] = {f"{rule}, {kind}": [] for rule in ("nonlinear", "sghqf") for kind in ROOTS}

    def mean(rule: Rule, root: Array) -> Array:
        points = np.zeros((len(rule.nodes), 13))
        points[:, PHI] = rule.nodes @ root[:3].T
        return rule.wm @ measurement(points, epoch)[:, :6]

    for _ in range(50):
        B = rngs[0].standard_normal((13, 13))
        P = B @ B.T
        P *= np.outer(scale / np.sqrt(P.diagonal()), scale / np.sqrt(P.diagonal()))
        exact = mean(fine, np.linalg.cholesky(P[:3, :3]))
        for name, errors in found.items():
            rule, kind = name.split(", ")
            errors.append(float(np.linalg.norm(mean(rules(config.level)[rule], ROOTS[kind](P)) - exact) / np.linalg.norm(exact)))
    return {name: np.array(errors) for name, errors in found.items()}


def growth(_: Config, __: Rngs) -> dict[str, Array]:
    """Points and sums of absolute weights of isotropic sparse grids over `DIMENSIONS`, ``(n, 2)``, by level."""
    out = {}
    for level, most in ((3, 40), (4, 30)):
        grids = [smolyak(n, level) for n in DIMENSIONS if n <= most]
        out[f"level {level}"] = np.array([[rule.num_sigmas(), np.abs(rule.wm).sum()] for rule in grids])
    return out


def coriolis(config: Config, _: Rngs) -> dict[str, Array]:
    """Latitude derivative of ``(2 w_ie + w_en)_up``: by a difference, as Eq. 22 prints it, and with the Earth's rate counted twice."""
    L, flight, step = np.radians(config.latitude_deg), config.flight, 1e-4

    def rate(latitude: Any) -> Any:
        return (2.0 * earth.earth_rate(latitude) + earth.transport_rate(flight.velocity[0], latitude, config.height_m))[..., 2]

    ie, (_north, east) = earth.ROTATION_RATE * np.cos(L), earth.radii(L, config.height_m)
    en = flight.velocity[0, 0] / (np.cos(L) ** 2 * east)
    right = (rate(L + step) - rate(L - step)) / (2.0 * step)
    return {"printed": np.array([(ie + en) / right]), "corrected": np.array([(2.0 * ie + en) / right])}


def parts(effort: float = 1.0) -> dict[str, Part]:
    """All that is computed."""
    out = {
        name: Part(partial(flown, names), PRESETS[name], number, T3.runs, 50, 2.0 * len(names) + 5.0)
        for number, (name, names) in enumerate(FLOWN.items())
    }
    out[MANY] = Part(partial(flown, ("ukf", "aasghqf", "nonlinear")), T3, 0, MANY_RUNS, 100, 11.0)
    out["bound"] = Part(bound, A, 1, A.runs, 50, 1.0)
    for i, angle in enumerate(MISALIGNMENTS_DEG):
        config = replace(A, misalignment_deg=(angle,) * 3, steps=1, sar_interval=10)
        out[f"start/{angle:g}"] = Part(start, config, 10 + i, A.runs, 50, 0.1)
    tiny = (1e-5 / DEGREE,) * 3
    return out | {
        "alike": Part(alike, replace(A, steps=60), 30, 5), "small": Part(small, replace(A, steps=20, misalignment_deg=tiny), 99, 2),
        "observability": Part(degrees, T3), "fixes": Part(first_fixes, T3, cost=2.0), "roots": Part(root_errors, T3, 50),
        "growth": Part(growth, T3), "coriolis": Part(coriolis, T3), "timings": Part(partial(timings, max(2, round(20 * effort))), A, cost=8.0),
    }  # fmt: skip


# -- numbers of the ledger ---------------------------------------------------------------------------------------------------
Seen = tuple[str, str, slice]
"""Part, filter, and states."""
WHOLE, LATE, AT_START = slice(None), slice(-100, None), slice(0, 1)
FITTED = "reproduced with fitted parameters"
ONE = MISALIGNMENTS_DEG.index(10.0)


def averaged(
    label: str, statistic: Callable[..., float], seen: Sequence[Seen], accept: Bounds = (None, None), at: slice = WHOLE, **more: Any
) -> Decided:
    """A statistic of Table 3's numbers ``(states,)``, one array for each that is seen: RMSE over the runs, averaged over epochs."""

    def number(r: Results) -> Number:
        squares = [np.square(r.get(part, f"{f}/error")[at, :, states]) for part, f, states in seen]
        runs = squares[0].shape[1]
        flat = [s.swapaxes(0, 1).reshape(runs, -1) for s in squares]

        def value(drawn: Array) -> float:
            share = np.bincount(drawn.astype(int), minlength=runs) / runs  # of each run among those drawn: a product, no copies
            return statistic(*(np.sqrt(share @ f).reshape(len(s), -1).mean(0) for f, s in zip(flat, squares, strict=True)))

        return estimate(label, value, [np.arange(runs)], accept, **more)

    return number


def over(label: str, a: tuple[str, str], b: tuple[str, str], states: slice, accept: Bounds = (None, None), at: slice = WHOLE) -> Decided:
    """Ratio of such numbers, summed over the states."""
    return averaged(label, lambda x, y: float(x.sum() / y.sum()), [(*a, states), (*b, states)], accept, at)


def level(label: str, a: tuple[str, str], states: slice, accept: Bounds = (None, None), at: slice = WHOLE, **more: Any) -> Decided:
    """Such a number, averaged over the states."""
    return averaged(label, lambda x: float(x.mean()), [(*a, states)], accept, at, **more)


def each(a: str, b: str, accept: Bounds, presets: Sequence[str] = tuple(PRESETS), **more: Any) -> list[Decided]:
    """Filter ``a`` over ``b`` in each of the seven states of Table 3.

    At T3, where errors have long tails, from more runs; SGHQF is then flown with the 57 points that give its estimates.
    """
    out = []
    for preset, i in product(presets, range(7)):
        part = MANY if preset == "T3" else preset
        pair = [(part, "nonlinear" if part == MANY and f == "sghqf" else f, slice(i, i + 1)) for f in (a, b)]
        label = f"{SEVEN[i]}, {preset}, {a.upper()} over {b.upper()}"
        out.append(averaged(label, lambda x, y: float(x[0] / y[0]), pair, accept, **more))
    return out


def anees(label: str, part: str, f: str, accept: Bounds = (None, None), at: slice = LATE, statistic: Any = np.mean) -> Decided:
    """NEES over 13, averaged over epochs, of the mean or the median run."""
    return lambda r: estimate(label, statistic, [r.nees(part, f, at) / 13.0], accept)


def fix(rule: str, label: str, accept: Bounds = (None, None)) -> Decided:
    """Least eigenvalue of the misalignment's covariance after the first star fix at 10 deg, over that by exact moments."""
    return lambda r: Number(label, r.value("fixes", f"{rule}/least", ONE) / r.value("fixes", "exact/least", ONE), accept)


def degree(r: Results) -> Tiers:
    """Degrees of all scalings beside the printed ones: states that agree, and the order of the states."""
    every, printed = r.get("observability", "every"), np.array(TABLE_2)
    with np.errstate(divide="ignore", over="ignore"):
        factor = np.exp(np.abs(np.log(every / printed)))
    wrong = (factor > np.array([1.1] * 7 + [3.2] * 6)).sum(-1)
    a, b = np.nonzero(printed[:, None] > printed)  # pairs of states of which the first has the larger degree
    turned = (every[:, a] <= every[:, b]).sum(-1)
    return {
        "reproduced": [Number("states of 13 that do not agree, in the best scaling", float(wrong.min()), (None, 0.0))],
        "in part": [Number("pairs of states that are not in the printed order, in the best scaling", float(turned.min()), (None, 0.0))],
        "not reproduced": [Number(inertial.STATES[i], float(every[0, i]), printed=TABLE_2[i]) for i in range(13)],
    }  # fmt: skip


def classes(r: Results) -> Tiers:
    """Weights that differ from Table 2's, by its own degrees and by computed ones."""
    def differ(degree: Any) -> float:
        return float((np.array(threshold_weights(degree, T3.threshold)) != PAPER_WEIGHTS).sum())

    every = r.get("observability", "every")
    own = Number("by the printed degrees, of 13", differ(TABLE_2), (None, 0.0))
    nearest = Number("by the computed ones", differ(every[0]), (None, 0.0))
    extremes = [Number(f"{word} of any scaling", reduce(map(differ, every))) for word, reduce in (("fewest", min), ("most", max))]
    return {"reproduced": [own, nearest, *extremes], "in part": [own]}


def criterion(r: Results) -> list[Number]:
    """AASGHQF over 57 points that follow the nonlinearity, in every state and preset."""
    every = sorted((number(r) for number in each("aasghqf", "nonlinear", (None, 1.0))), key=lambda n: -n.value)
    return [
        Number("of 28 states and presets, those in which 57 points are better with their interval", sum(n.holds is False for n in every), (None, 0)),
        Number("in which they are worse", sum(n.ci is not None and n.ci[1] < 1.0 for n in every)), every[0],
        *(anees(f"NEES / 13 after the first fix, A, {f.upper()}", "A", f, at=AT_START)(r) for f in ("aasghqf", "nonlinear", "sghqf")),
        *(n._replace(accept=(None, None)) for n in every[1:]),
    ]  # fmt: skip


def better(r: Results) -> Tiers:
    """UKF over both sparse filters, in every state and preset; the least of them first."""
    every = sorted((n(r) for f in ("sghqf", "aasghqf") for n in each("ukf", f, (1.0, None), strict=True)), key=lambda n: n.value)
    half = np.sqrt(np.divide(TABLE_3["UKF"], TABLE_3["SGHQF"]))
    sizes = [n(r).value > bar for n, bar in zip(each("ukf", "sghqf", (None, None), ["T3"]), half, strict=True)]
    below = Number("of 56 states, presets and filters, those in which the UKF is better with its interval",
                   sum(n.ci is not None and n.ci[1] < 1.0 for n in every), (None, 0))  # fmt: skip
    unclear = Number("in which it is not worse with its interval", sum(not n.holds for n in every), (None, 0))
    confirmed = Number("of the seven ratios to SGHQF at T3, those above half-way to the printed ones", sum(sizes))
    least = min((n for n in every if "AASGHQF" not in n.label), key=lambda n: n.value)
    return {"reproduced": [below, unclear, confirmed, least._replace(label=f"{least.label}, least of these"), *every], "in part": [below]}


def levels(r: Results) -> Tiers:
    """All 21 entries of Table 3 at T3."""
    cells = [(MANY, {"SGHQF": "nonlinear"}.get(f, f.lower()), slice(0, 7)) for f in TABLE_3]
    printed = np.concatenate(list(TABLE_3.values()))

    def beyond(*ours: Array) -> float:
        return float((np.abs(np.log(np.concatenate(ours) / printed)) > np.log(1.32)).sum())

    def farthest(*ours: Array) -> float:
        return float(np.exp(np.abs(np.log(np.concatenate(ours) / printed)).max()))

    return {FITTED: [averaged("entries of 21 beyond a factor 1.32", beyond, cells, (None, 3))(r)],
            "level only": [averaged("largest factor", farthest, cells, (None, 3.2))(r)]}  # fmt: skip


def cycle(label: str, runs: int, accept: Bounds, a: str, b: str, *, difference: bool = False) -> Decided:
    """CPU time of a cycle, the least of all rounds: of ``a`` over ``b``, or ms that it takes longer."""

    def number(r: Results) -> Number:
        one, two = (float(r.get("timings", f"{f}, {runs}").min()) for f in (a, b))
        return Number(label, 1e3 * (one - two) if difference else one / two, accept)

    return number


def example(weights: tuple[int, int]) -> Number:
    """Indices in which a printed set differs from the computed one, where their coefficient is not zero."""
    found = index_set(3, weights)
    differ = {i for i, c in found.items() if c} ^ set(EXAMPLE[weights])
    return Number(f"indices that differ, weights {weights}", float(sum(found.get(i) != 0 for i in differ)), (None, 0.0))


def one_term(_: Results) -> list[Number]:
    """Points of Fig. 1 that are in several index sets, and what the weights sum to if each has one term only."""
    terms = list(grid({index: c for index, c in index_set(3, (1, 1)).items() if c}).values())
    return [Number("points in several index sets, of 21, n = 2", sum(len(t) > 1 for t in terms), (5, 5)),
            Number("sum of weights, the largest term of each", sum(map(max, terms)), (1.5, None)),
            Number("the least term of each", sum(map(min, terms)), (None, 0.0))]  # fmt: skip


def saved(iso: Sequence[int], aniso: Sequence[int], label: str, bars: tuple[float | None, float | None] = (None, None)) -> list[Number]:
    """Least step of points saved, and of their part in %, from one number of states to the next."""
    many, part = np.subtract(iso, aniso), 100.0 * (1.0 - np.divide(aniso, iso))
    steps = ("points", many, bars[0]), ("% of all points", part, bars[1])
    return [Number(f"{label}: least step, {unit}", float(np.diff(values).min()), (bar, None)) for unit, values, bar in steps]


def savings(_: Results) -> Tiers:
    """From the printed numbers and from counted ones, as the states alternate, and with half of the weights 2."""
    counted = [point_count(len(g), 3, g) for g in (*TABLE_1_WEIGHTS, PAPER_WEIGHTS)], [point_count(len(g), 3) for g in (*TABLE_1_WEIGHTS, PAPER_WEIGHTS)]
    half = [[point_count(n, 3, w) for n in (6, 12, 24) for w in ([1] * n,)], [point_count(n, 3, [2] * (n // 2) + [1] * (n // 2)) for n in (6, 12, 24)]]
    number, part = saved(*half, "half of the weights 2, n = 6, 12, 24", (1.0, 1e-9))
    printed = saved([*TABLE_1["SGHQF"], TABLE_4["SGHQF"][0]], [*TABLE_1["AASGHQF"], TABLE_4["AASGHQF"][0]], "printed, n = 1 to 6, 13")
    ends = [Number(f"part saved at n = {n}, %", 100.0 * (1.0 - b / a)) for n, a, b in zip((6, 12, 24), *half, strict=True)]
    return {"reproduced": [number, part, *ends, *printed, *saved(counted[1], counted[0], "counted, n = 1 to 6, 13")], "in part": [number]}


# -- the ledger --------------------------------------------------------------------------------------------------------------
statement, erratum, remark = partial(Row, "statement"), partial(Row, "erratum"), partial(Row, "remark")
finding, check = partial(Row, "finding"), partial(Row, "check")
ANGLES = PHI

STATEMENTS = [
    statement(
        "table-1-counts", "At level 3 the anisotropic grid needs fewer points than the isotropic one, as counted for n = 1 to 6.",
        lambda _: [Number("counts of 12 that differ", float(sum(
            point_count(n + 1, 3, g) != TABLE_1[f][n] for n, own in enumerate(TABLE_1_WEIGHTS) for f, g in (("SGHQF", None), ("AASGHQF", own))
        )), (None, 0))],
        place="§2, Table 1", why="integers, no tolerance", printed=TABLE_1, found="{0:.0f} of twelve differ.", figure="figure_09",
    ),
    statement(
        "points-for-two-states", "For n = 2 and level 3 the isotropic grid is made of six products of one-dimensional rules and, with weights 2 and 1, the "
        "anisotropic one of three; rules of different levels share the middle point only.",
        lambda _: [example((1, 1)), example((2, 1)), Number("points, isotropic", len(grid(index_set(3, (1, 1)))), (21, 21)),
                   Number("points, weights 2 and 1", smolyak(2, 3, (2, 1)).num_sigmas(), (9, 9)),
                   Number("nodes in more than one of the rules of 1, 3, 7 points", sum(len(t) > 1 for t in grid({(1,): 1, (2,): 1, (3,): 1}).values()), (1, 1))],
        place="§2, example after Eq. 20, Figs 1 and 2", why="the sets but for indices of coefficient 0, the counts and the single common node", figure="figure_01",
        found="Both sets, but for the printed (1, 1) whose coefficient is 0, {2:.0f} and {3:.0f} points, and {4:.0f} common node.",
    ),
    statement(
        "degrees-of-observability", "On a part of the flight the tilts and the position errors have degrees near 10, the heading near 5, velocities 1, drifts and "
        "biases 1e-4 and less.", degree, place="§4, Table 2", printed=TABLE_2, expected="not reproduced",
        why="one scaling of states and outputs gives the larger ones within 10 % and the small ones within a factor 3.2; in part, the printed order of the states",
        found="None of 288 scalings gives even the order ({1:.0f} pairs are turned in the best); in the nearest {0:.0f} of 13 differ: the tilts ({2:.2f}, {3:.2f}), "
        "the velocities and the first gyro ({9:.1e}) agree, heading ({4:.2f}), longitude and latitude ({7:.2f}, {8:.2f}) do not.",
    ),
    statement(
        "threshold-weights", "With a threshold of 5 the tilts, longitude and latitude get weight 1 and all others weight 2.", classes,
        place="§2, Eq. 19; §4, Table 2", printed=list(PAPER_WEIGHTS), why="all 13 weights, from the printed degrees and from computed ones", expected="in part",
        found="From the printed degrees yes ({0:.0f} of 13 differ); from the computed ones {1:.0f} differ, longitude and latitude; over all units {2:.0f} to {3:.0f}.",
    ),
    statement(
        "observability-is-the-criterion", "How many points a channel deserves is told by its observability: hardly observable ones get few, however nonlinear.",
        criterion, place="introduction; §2", why="no choice of at most 75 points is better with its interval", expected="not reproduced", figure="figure_06",
        found="57 points by nonlinearity are better in {0:.0f} of 28 states and presets and worse in {1:.0f} ({2.label}: {2}); after the first fix NEES / 13 is "
        "{3} by observability, {4} by nonlinearity, {5} with 417 points.",
    ),
    statement(
        "adapts-along-the-flight", "The filter computes the degrees of observability while it runs, and shares out the points accordingly.",
        place="title; abstract; §2; §4; §5", expected="not addressed",
    ),
    statement(
        "better-than-ukf", "Both sparse filters estimate all states better than the UKF.", better, place="abstract; §4, Table 3, Figs 3-5", figure="figure_03",
        printed={"UKF": TABLE_3["UKF"], "SGHQF": TABLE_3["SGHQF"]}, expected="not reproduced",
        why="all 95 % intervals above 1; in part, none below",
        found="SGHQF is ({3.label} {3}; {2:.0f} of seven ratios at T3 above half-way), AASGHQF is not: {4.label} {4}; {0:.0f} of 56 are below 1, "
        "{1:.0f} not above.",
    ),
    statement(
        "higher-order-is-why", "The sparse filters are better because Gauss-Hermite rules reach a higher order of the Taylor expansion.",
        lambda r: {
            "reproduced": [Number("total degree, isotropic", exactness(3, (1, 1, 1)), (4, None)), Number("weights with a 2", exactness(3, (1, 1, 2)), (4, None))],
            "in part": [Number("total degree, isotropic", exactness(3, (1, 1, 1)), (4, None)),
                        *(Number(f"SGHQF over UKF, {what}", r.value("fixes", f"sghqf/{what}", ONE) / r.value("fixes", f"ukf/{what}", ONE), (None, 1.0)) for what in ("mean", "cov")),
                        *(Number(f"AASGHQF over UKF, {what}", r.value("fixes", f"aasghqf/{what}", ONE) / r.value("fixes", f"ukf/{what}", ONE)) for what in ("mean", "cov")),
                        Number("total degree, UKF", exactness(2, (1, 1, 1)))],
        },
        place="§4, on Table 3", why="both grids exact to a higher degree than the UKF, and a smaller error of the star residual at 10 deg", expected="in part", figure="figure_10",
        found="True of SGHQF (degree {0:.0f}, error of the mean {2:.0e} of the UKF's); AASGHQF has the UKF's degree {1:.0f} and {4:.2f} of its error.",
    ),
    statement(
        "alike-sghqf", "The anisotropic filter is as accurate as the isotropic one.",
        lambda r: sorted((n(r) for n in each("aasghqf", "sghqf", (0.92, 1.08))), key=lambda n: -n.value), place="abstract; §4, Table 3; §5", figure="figure_03",
        why="within 0.92 to 1.08, the largest difference in the paper's own Table 3", printed={f: TABLE_3[f] for f in ("SGHQF", "AASGHQF")}, expected="not reproduced",
        found="Not in φy: {0.label} {0}, {1.label} {1}, {2.label} {2}; next {3.label} {3}.",
    ),
    statement(
        "table-3-levels", "Averaged over time, 50 runs have RMSEs of 0.2 to 0.4 deg, 0.3 to 0.6 m/s and 16 to 18 m.", levels, place="§4, Table 3", printed=TABLE_3,
        why="95 % band of the ratio of two RMSEs of 50 runs; of 21 entries 3 may leave it; a factor 3.2 is the same order", expected="level only",
        found="{0} of 21 entries leave the band, the farthest by {1}, with misalignment, fix intervals and process noise fitted to this table.",
    ),
    statement(
        "table-4-points", "In 13 dimensions the UKF uses 27 points, the isotropic filter 417 and the anisotropic one 99.",
        lambda _: {"reproduced": (numbers := [Number(f, float(point_count(13, n, g)), 2 * (TABLE_4[f][0],), printed=TABLE_4[f][0])
                                  for f, n, g in (("UKF", 2, None), ("SGHQF", 3, None), ("AASGHQF", 3, PAPER_WEIGHTS))]), "in part": numbers[:2]},
        place="§4, Table 4", why="integers, no tolerance", printed=[27, 417, 99], expected="in part", found="{0:.0f}, {1:.0f} and {2:.0f}.",
    ),
    statement(
        "one-millisecond-more", "A cycle of the anisotropic filter takes less than 1 ms longer than one of the UKF.",
        tiers(reproduced=[cycle("ms longer, one run alone", 1, (None, 1.0), "aasghqf", "ukf", difference=True),
                          cycle("ratio, one run alone", 1, (1.15, None), "aasghqf", "ukf"), cycle("ratio, 50 runs at once", 50, (None, None), "aasghqf", "ukf")],
              in_part=[cycle("ms longer, one run alone", 1, (None, 1.0), "aasghqf", "ukf", difference=True)]),
        place="§4, on Table 4", why="below 1 ms; and a ratio above 1.15, half-way to the printed 1.33: else it does not take longer", printed=[0.0021, 0.0028],
        expected="in part", found="{0:.3f} ms, but of one run alone the points are not what takes time: ratio {1:.2f} (of 50 at once {2:.2f}).",
    ),
    statement(
        "cheaper-than-sghqf", "The anisotropic filter needs far fewer points and less time than the isotropic one.",
        tiers(reproduced=[cycle("ratio of times, one run alone", 1, (1.52, None), "sghqf", "aasghqf"), cycle("50 at once", 50, (1.52, None), "sghqf", "aasghqf"),
                          given("ratio of points", point_count(13, 3) / point_count(13, 3, PAPER_WEIGHTS), (1.52, None))],
              in_part=[cycle("50 at once", 50, (1.52, None), "sghqf", "aasghqf")]),
        place="abstract; §4, Table 4; §5", why="half-way, on a logarithmic scale, to the printed ratio of times 2.32", printed=[0.0065, 0.0028], expected="in part",
        found="In batches only: {2:.2f} times the points take {1:.2f} times as long with 50 runs at once, {0:.2f} times alone.",
    ),
    statement(
        "saving-grows", "The more states, the more points the anisotropic grid saves.", savings, place="§4, last sentence before §5", figure="figure_09",
        why="number and part saved both rise where the share of weights 2 is fixed", printed=[7, 21, 37, 57, 81, 109, 417, 7, 9, 23, 25, 41, 43, 99],
        found="With half of the weights 2 the part rises from {2:.1f} over {3:.1f} to {4:.1f} %; as printed it does not at each step ({6:.1f} %), for the share alternates.",
    ),
]  # fmt: skip
ERRATA = [
    erratum("erratum-1-points", "99 points. Right: 75 with the weights of Table 2, by the rule that gives all other counts.",
            lambda _: [Number("by the paper's own rule", point_count(13, 3, PAPER_WEIGHTS), (75, 75), printed=99),
                       Number("merged at the origin only", merged_at_the_origin(3, PAPER_WEIGHTS), (99, 99)),
                       Number("of a state of 14 components, five of weight 1", point_count(14, 3, [1] * 5 + [2] * 9), (99, 99))],
            place="Table 4", found="{0:.0f}; {1:.0f} come out if points are merged at the origin only, or for 14 states."),
    erratum("erratum-2-bound", "The lower bound of the index set is not strict, and indices of coefficient 0 belong to it. Right: strict, and without these.",
            lambda _: [Number("as printed, n = 1", printed_count(3, (1,), strict=False), (9, 9), printed=7),
                       Number("strict, with coefficients 0, weights 2, 1", printed_count(3, (2, 1), strict=True), (11, 11), printed=9)],
            place="Eq. 18", found="As printed {0:.0f} points for the 7 of Table 1; strict, but with coefficients 0, {1:.0f} for 9."),
    erratum("erratum-3-example", "(1, 1) is among the isotropic indices, by Eq. 8. Right: without it; Eq. 13.",
            lambda _: Number("its coefficient", index_set(3, (1, 1))[1, 1], (0, 0)), place="§2, example", found="Its coefficient is {0:.0f}: harmless."),
    erratum("erratum-4-merged", "The weight of a merged point is one term. Right: the sum over all indices that contain it.",
            one_term,
            place="Eq. 14", found="{0:.0f} of 21 points are in several; one term each sums to {1:.2f} or {2:.2f}, not 1."),
    erratum("erratum-7-rate", "(δω_ie + δω_en) x V. Right: (2 δω_ie + δω_en) x V.",
            all_of(of("coriolis", "printed", "printed over right", (0.6, 0.7)), of("coriolis", "corrected", "corrected over right", (0.99, 1.01))),
            place="Eq. 22", found="The latitude derivative of the Coriolis term is {0:.3f} of what it should be, and {1:.4f} once corrected."),
]  # fmt: skip
RECONSTRUCTIONS = [
    Row("reconstruction", "reconstruction-15", "Which singular value belongs to a state, at which epoch, with which units and over which reference is unreadable.",
        place="Eq. 15", found="Ours: that of the right vector with its largest component there, Lie derivatives to third order, over that of the east velocity."),
]  # fmt: skip
REMARKS = [
    remark("erratum-9-units", "The degrees depend on the units of the states.",
           all_of(of("observability", "in degrees", "degree of φx, misalignment in deg", (0.16, 0.18), lambda d: d[0]),
                  of("observability", "in degrees", "states of weight 1 then", (0, 0), lambda d: threshold_weights(d, T3.threshold).count(1))),
           place="Eq. 15, Table 2", found="In degrees the tilts have {0:.2f} for 9.8 and {1:.0f} states get weight 1: the isotropic rule of 417 points."),
    remark("erratum-10-linear", "Longitude and latitude, which are linear, get weight 1, and the nonlinear heading weight 2.",
           of("alike", "43-75", "75 and 43 points, without those, apart by (deviations)", (None, 1e-6)), place="Table 2",
           found="Without points for longitude and latitude the filter is the same to {0:.0e} of a deviation."),
    remark("erratum-11-triad", "Table 3 is a transient from the first fixes, not the accuracy of estimation: one star reading gives 0.005 deg.",
           all_of(level("EKF started by Wahba's solution, φx at T3, deg", ("T3", "triad-ekf"), slice(0, 1), (0.045, 0.075), printed=0.2),
                  level("SGHQF over the last 100 s, mean of the angles at T3, deg", ("T3", "sghqf"), ANGLES, (0.05, 0.08), LATE, printed=0.2),
                  level("SGHQF with fixes each second (A), mean of the angles, deg", ("A", "sghqf"), ANGLES, (None, 0.01), printed=0.22)),
           place="Table 3", found="Without the transient {0} deg, at the end {1} deg, with fixes each second {2} deg.", figure="figure_06"),
    remark("remark-unsaid", "Initial misalignment, fix intervals, process noise and height are not given; no adaptation is shown; the matrix in front in Eqs. 26 and 28 "
           "must be the system's attitude; the weights in Eq. 12 are a product, printed with commas.", place="§2, §4"),
]  # fmt: skip
FINDINGS = [
    finding("nonlinear-points", "Weights by nonlinearity: 57 points are the filter of 417.",
            all_of(given("points", point_count(13, 3, NONLINEAR_WEIGHTS), (57, 57)), of("alike", "57-417", "largest difference over 50 s, A, deviations", (None, 1e-4)),
                   *(over(f"RMSE of the angles, {p}", (p, "nonlinear"), (p, "sghqf"), ANGLES, (0.999, 1.001)) for p in ("T3", "A-slow", "A"))),
            found="{0:.0f} points, apart by {1:.0e} of a deviation; RMSE of the angles {2:.4f}, {3:.4f}, {4:.4f} of theirs.", figure="figure_06"),
    finding("triad-T3", "An EKF started by Wahba's closed solution beats every quadrature filter, at the cost of an EKF.",
            all_of(*(over(f"over SGHQF, {p}", (p, "triad-ekf"), (p, "sghqf"), ANGLES, (None, most)) for p, most in (("T3", 0.6), ("A-slow", 0.8), ("A", 0.9)))),
            found="Its angles have {0}, {1}, {2} of SGHQF's RMSE.", figure="figure_06"),
    finding("triad-bound", "It is as good as any filter can be.",
            lambda r: estimate("RMSE of the angles over the conditional Cramer-Rao bound, A", lambda a, b: float(np.sqrt(a.mean(0)).mean(0).sum() / np.sqrt(b.mean(0)).mean(0).sum()),
                               [np.square(r.get("A", "triad-ekf/error")[..., PHI]).swapaxes(0, 1), np.square(r.get("bound", "std")).swapaxes(0, 1)], (0.9, 1.1)),
            found="{0} of the bound."),
    finding("nees-first-ukf", "Why the UKF loses: its first star fix leaves it overconfident in one direction, and it takes minutes to forget.",
            all_of(anees("NEES / 13 of UKF after the first fix, A", "A", "ukf", (1e3, None), AT_START), anees("of SGHQF", "A", "sghqf", (None, 2.0), AT_START),
                   fix("ukf", "least variance after the fix, UKF over exact", (None, 0.01))),
            found="NEES / 13 is {0}, of SGHQF {1}; the least variance after the fix is {2:.1e} of the right one.", figure="figure_08"),
    finding("first-fix-ghqf3", "The sixth moment of single channels decides: rules of degree 5 with three points in a channel are as overconfident as the UKF.",
            all_of(fix("delayed", "delayed sparse grid", (None, 0.01)), fix("ghqf3", "tensor rule, 3 points", (None, 0.01)), fix("sghqf", "SGHQF", (0.99, 1.01)),
                   fix("aasghqf", "AASGHQF", (0.95, 1.05))), found="Least variance {0:.1e}, {1:.1e}, of SGHQF {2:.4f}, of AASGHQF {3:.4f} of the right one.", figure="figure_08"),
    finding("nees-A-slow-ukf", "The overconfidence lasts: with slow fixes the UKF is not consistent at the end of the flight, SGHQF is.",
            all_of(anees("NEES / 13 over the last 100 s, A-slow, UKF", "A-slow", "ukf", (20.0, None)), anees("SGHQF", "A-slow", "sghqf", (0.8, 1.25))),
            found="NEES / 13 is {0} and {1}.", figure="figure_07"),
    finding("root-symmetric", "An anisotropic rule needs the nonlinear states first and a lower root.",
            lambda r: [Number(f"error of E[h], {kind} over lower, 57 points", float(np.median(r.get("roots", f"nonlinear, {kind}")) / np.median(r.get("roots", "nonlinear, lower Cholesky"))), (least, None))
                       for kind, least in (("symmetric", 20.0), ("upper Cholesky", 100.0))], found="{0:.0f} and {1:.0f} times the error with others.", figure="figure_10"),
    finding("redone-ckf5", "Negative weights lose definiteness: the cubature rule of degree 5 at the first fix in every run, sparse grids at 10 deg in none.",
            all_of(of("start/10", "ckf5/redone", "updates done again, CKF of degree 5, of one", (1, 1), np.mean),
                   *(of("start/10", f"{f}/redone", f.upper(), (0, 0), np.mean) for f in ("sghqf", "aasghqf", "nonlinear")), fix("ckf5", "least variance over exact", (None, 0.0))),
            found="In {0:.0%} of the runs; SGHQF, AASGHQF and 57 points in {1:.0f}, {2:.0f}, {3:.0f}.", figure="figure_08"),
    finding("growth", "Points of sparse grids grow like a polynomial, but so do the weights' magnitudes, which amplify round-off.",
            of("growth", "level 3", "sum of absolute weights, n = 40", (340.0, 355.0), lambda v: v[DIMENSIONS.index(40), 1]), found="Their sum is {0:.0f} for n = 40.", figure="figure_09"),
]  # fmt: skip
CHECKS = [
    *(check(f"nees-{p}-{f}", f"NEES / 13 of {f.upper()} over the last 100 s, {p} (1 if consistent)", anees("NEES / 13", p, f, accept)) for p, f, accept in (
        ("T3", "sghqf", (0.85, 1.15)), ("T3", "ukf", (1.0, None)), ("A-slow", "ckf", (10.0, None)), ("A-slow", "ekf", (20.0, None)), ("A", "ukf", (3.0, None)),
        ("A", "sghqf", (0.8, 1.2)), ("A", "triad-ekf", (0.8, 1.2)))),
    check("nees-A-slow-aasghqf", "The same of AASGHQF, A-slow: the median run", anees("NEES / 13", "A-slow", "aasghqf", (0.7, 1.3), statistic=np.median)),
    check("nees-first-ekf", "NEES / 13 of the EKF after the first fix, A", anees("NEES / 13", "A", "ekf", (1e3, None), AT_START)),
    check("figure-3-first-fix", "φz after the first star fix, UKF over SGHQF, A", over("RMSE", ("A", "ukf"), ("A", "sghqf"), slice(2, 3), (2.0, None), AT_START)),
    check("figure-4-late", "Velocity of SGHQF at T3 is never much worse than that of the UKF after the first minute (largest ratio of RMSE)",
          lambda r: Number("ratio", float(np.sqrt(np.divide(*(np.square(r.get("T3", f"{f}/error")[60:, :, 3:5]).sum(-1).mean(1) for f in ("sghqf", "ukf"))).max())), (None, 1.5))),
    check("figure-3-ukf-attitude", "UKF over SGHQF in all angles, A-slow", over("RMSE", ("A-slow", "ukf"), ("A-slow", "sghqf"), ANGLES, (3.0, None))),
    check("table-3-ukf-attitude", "The same at T3", over("RMSE", ("T3", "ukf"), ("T3", "sghqf"), ANGLES, (1.2, 2.2), )),
    check("table-3-ukf-position", "UKF over SGHQF in position, T3", over("RMSE", ("T3", "ukf"), ("T3", "sghqf"), POSITION, (1.05, None))),
    check("erratum-11-arcmin-ratio", "UKF over SGHQF in all angles, T3-arcmin: less than the paper's 1.69",
          over("RMSE", ("T3-arcmin", "ukf"), ("T3-arcmin", "sghqf"), ANGLES, (1.05, 1.6))),
    check("erratum-11-arcmin", "T3-arcmin, SGHQF, mean of the angles (deg)", level("deg", ("T3-arcmin", "sghqf"), ANGLES, (0.13, 0.26))),
    check("first-fix-exact", "Least variance after the first fix at 10 deg, relative to the prior, by exact moments", of("fixes", "exact/least", "ratio", (1.4e-4, 1.7e-4), lambda v: v[ONE])),
    *(check(f"indefinite-{f}", f"Sampled innovation covariance at 60 deg, without R: least to largest eigenvalue, {f.upper()}", of("fixes", f"{f}/sampled", "ratio", accept, lambda v: v[-1]))
      for f, accept in (("aasghqf", (None, 0.0)), ("ckf5", (None, 0.0)), ("sghqf", (0.0, None)))),
    check("root-lower", "57 points, lower root: median relative error of E[h] over correlated covariances", of("roots", "nonlinear, lower Cholesky", "error", (None, 1e-3), np.median)),
    check("triad-first", "EKF started by Wahba's solution over SGHQF after the first fix, angles, A", over("RMSE", ("A", "triad-ekf"), ("A", "sghqf"), ANGLES, (None, 0.1), AT_START)),
    check("iekf", "An iterated EKF over it, A-slow", over("RMSE", ("A-slow", "iekf"), ("A-slow", "triad-ekf"), ANGLES, (0.9, 1.2))),
    check("degenerate-small", "At 1e-5 rad all filters are the Kalman filter (deviations of the prior)", of("small", "apart", "apart", (None, 1e-6))),
    *(check(f"sensitivity-{f}", f"{f.upper()} after the first fix, {angle:g} deg: median NEES / 13", lambda r, f=f, angle=angle, accept=accept: estimate(
        "NEES / 13", np.median, [r.get(f"start/{angle:g}", f"{f}/nees")[0] / 13.0], accept)) for f, angle, accept in (("sghqf", 20.0, (None, 2.0)), ("ukf", 2.0, (2.0, None)))),
    check("failed", "Runs lost, all filters and presets", lambda r: Number("runs", float(sum((~np.isfinite(v)).any((0, 2)).sum() for part in (*FLOWN, MANY) for name, v in r.data[part].items() if name.endswith("/error"))), (0, 0))),
]  # fmt: skip
STUDY = Study("aasghqf", GROUPS, judged, parts, [*STATEMENTS, *ERRATA, *RECONSTRUCTIONS, *REMARKS, *FINDINGS, *CHECKS])
