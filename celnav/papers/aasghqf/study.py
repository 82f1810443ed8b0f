"""The study of [Liang2014]: its runs, the paper's statements and printed numbers, its errors, and
our own findings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice, product
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from celnav.analysis.observability import lie_gradients, state_singular_values, threshold_weights
from celnav.filters.joint import condition
from celnav.filters.records import Epoch
from celnav.filters.run import run
from celnav.filters.sequential import sigma_point
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import gauss_hermite, simplex, tensor_product
from celnav.gaussian.sparse_grid import ORDERS, index_set, integrates, point_count, smolyak
from celnav.models import earth, misalignment
from celnav.papers.aasghqf import scenario
from celnav.papers.aasghqf.scenario import (
    DEGREE,
    PAPER_WEIGHTS,
    PRESETS,
    T3,
    A,
    Config,
    filters,
    measurement,
    rules,
    simulate,
    weighted,
)
from celnav.study import trial as trials
from celnav.study.ledger import Bounds, Decision, Number, Tiers, estimate, read_ledger, read_printed
from celnav.study.montecarlo import BRIEF, normals
from celnav.study.numbers import (
    Decided,
    PartFilter,
    all_of,
    consistency,
    constant,
    count_holding,
    of,
    operations,
)
from celnav.study.operations import counted
from celnav.study.study import Part, Results, Rngs, Study, When, evaluate_filters, monte_carlo

__all__ = ["STUDY"]

COMPARED = ("ukf", "sghqf", "aasghqf")  # the paper's three filters
FLOWN = (*COMPARED, "nonlinear", "triad-ekf")
MANY = "T3, 200 runs"
SHOWN = ("T3", "A-slow", "A")
PHI = misalignment.PHI
SIX = replace(T3, step_s=5.0, steps=24, star_interval=6, sar_interval=5)
"""T3 with longer steps, for two minutes only, with fixes at the same times: a tensor rule needs ten
times as long as all other filters together."""
LEVELS = (2, 3, 4)
MISALIGNMENTS_DEG = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0)
TEN = itemgetter(MISALIGNMENTS_DEG.index(10.0))
LATE = slice(-100, None)
THRESHOLD = 5.0
UNDISTURBED: Any = (trials.Noiseless(),)
LAST = slice(-11, None)  # the same 100 s if every tenth epoch is stored
SEVEN = ("φx", "φy", "φz", "east velocity", "north velocity", "longitude", "latitude")
CHOICES: dict[str, Callable[[Config], scenario.Choose]] = {
    "unweighed": scenario.by_observability,
    "weighed": partial(scenario.by_observability, weigh=True),
    "bends": lambda _: scenario.by_nonlinearity(),
    "bends, 0.01": lambda _: scenario.by_nonlinearity(0.01),
    "bends, 1": lambda _: scenario.by_nonlinearity(1.0),
}
"""Weights that are chosen online: by Eqs. 15 and 19, with or without weighting of singular vectors
by the filter's covariance; by nonlinearity ("bends")."""
MOUNTINGS = (0, 20, 60, 200)
"""Mounting errors in arc seconds, on each axis of each star sensor (chosen)."""
POINTS = ("UKF", 2, None), ("SGHQF", 3, None), ("AASGHQF", 3, PAPER_WEIGHTS)
LEDGER = Path(__file__).with_name("ledger.toml")
PRINTED = read_printed(LEDGER)
TABLE_1 = PRINTED["table-1-counts"]
TABLE_2 = PRINTED["degrees-of-observability"]
TABLE_3 = PRINTED["table-3-levels"]
TABLE_4 = PRINTED["saving-grows"]
EXAMPLE = {(1, 1): ("11 12 13 21 22 31", 21), (2, 1): ("11 13 21", 9)}
"""The example as printed: indices and number of points, by weights. The tables above are printed
values too: points by n; degrees by state; RMSE in deg, m/s and m; points, and seconds per cycle."""


# -- the parts of the study ------------------------------------------------------------------------
def shown(sim: scenario.Scenario) -> trials.Trial:
    """The trial of simulated runs, in the paper's units."""
    return scenario.trial_of(sim, DEGREE, "deg")


def judged(config: Config, rngs: Any) -> trials.Trial:
    """A simulated trial in the paper's units."""
    return shown(simulate(config, rngs))


def bound(config: Config, _: Rngs) -> dict[str, Array]:
    """Linearized posterior Cramer-Rao bound along the flight without errors: mean squared errors
    ``square (T, groups)``."""
    return {"square": np.asarray(trials.bound(judged(config, UNDISTURBED)))}


def six_states(names: Sequence[str], config: Config, rngs: Rngs) -> dict[str, Array]:
    """Filters with six states: errors of the misalignment ``<name>/error (T, runs, 3)`` deg, and
    the norm of the initial misalignment ``start (1, runs)`` deg."""
    sim, filters, prior = scenario.six_states(config, rngs)
    phi = sim.truth[..., PHI]
    out = {"start": np.linalg.norm(phi[:1], axis=-1) / DEGREE}
    for name in names:
        track = run(
            filters[name], prior, sim.epochs(), keep="mean", on_failure="flag", engine="numpy"
        )
        out[f"{name}/error"] = (track.mean[..., PHI] - phi) / DEGREE
    return out


def cycles(config: Config, _: Rngs) -> dict[str, Array]:
    """Arithmetic operations of a cycle (prediction and update) for one run, counted in the recorded
    step. They do not depend on the machine.

    The steps of SGHQF and of the six-state tensor rule are too long to record. Their counts are
    lower bounds. Each further point adds two operations to each entry of three covariances: of the
    prediction, of the measurement, and between both.
    """
    c = replace(config, steps=1)
    sim = simulate(c, UNDISTURBED)
    pairs: Any = filters(c)
    out = counted({name: pairs[name].first for name in ("ukf", "aasghqf")}, sim.prior, sim.epochs())
    sim, pairs, prior = scenario.six_states(c, UNDISTURBED)
    out |= counted({"six/sghqf": pairs["sghqf"].first}, prior, sim.epochs())
    points = rules(config.level) | scenario.six_rules()
    for n, name, fewer in ((13, "sghqf", "aasghqf"), (6, "six/ghqf", "six/sghqf")):
        more = points[name].num_sigmas() - points[fewer].num_sigmas()
        # Distinct entries of the covariances of n states, of 8 measurements, and between both.
        entries = n * (n + 1) // 2 + 8 * 9 // 2 + 8 * n
        out[name] = out[fewer] + 2 * entries * more
    return out


def degrees(config: Config, _: Rngs) -> dict[str, Array]:
    """Degrees of observability at the start of the flight, by Lie derivatives to the third order.

    Returns
    -------
    every: ``(4, 72, 13)``. First axis: units of angles (rad, deg, arc minutes, arc seconds). Second
    axis: units of positions, drifts, biases, star residuals and fixes; the first combination (m,
    deg/h, micro g, 1, m) is nearest to Table 2.
    """
    epoch = next(simulate(replace(config, steps=1), UNDISTURBED).epochs())
    gradients = lie_gradients(
        lambda x: misalignment.derivative(x, epoch.u.interval),
        lambda x: measurement(x, epoch),
        np.zeros(13),
        3,
    )
    radius = config.meters().mean()
    star = 1.0 / epoch.u.sqrt_R[0, 0]
    angles = (1.0, DEGREE, DEGREE / 60.0, DEGREE / 3600.0)
    positions = (1.0, radius, radius * DEGREE)
    drifts = (1.0, 3600.0 / DEGREE)
    biases = (1.0, 1.0 / scenario.MICRO_G)
    fixes = (1.0, 1.0 / radius, 1.0 / config.sar_m)
    each = list(product(angles, (1.0,), positions, drifts, biases, (1.0, star), fixes))
    scales = np.repeat(each, [3, 2, 2, 3, 3, 6, 2], axis=1)[:, None]
    states, outputs = np.split(np.concatenate(config.units) * scales, [13], axis=-1)
    every = outputs[..., None] * gradients * states[:, None]
    values = state_singular_values(every.reshape(4, 72, -1, 13))
    return {"every": values / values[..., 3:4]}


def on_line(names: Sequence[str], config: Config, rngs: Rngs) -> dict[str, Array]:
    """Filters by `CHOICES`: ``error`` as in `evaluate_filters`; the weights encoded as a number
    (``chosen``) and the number of points (``points``), both ``(T, runs)``."""
    sim = simulate(config, rngs)
    out = {"times": config.times}
    scale = trials.scales(shown(sim).groups, 13)
    for name in names:
        track = run(
            scenario.adaptive(CHOICES[name](config), config),
            sim.prior,
            sim.epochs(),
            keep="mean",
            on_failure="flag",
            engine="numpy",
            also=lambda _, state, __: {"chosen": state.chosen},
        )
        chosen = track.extra["chosen"]
        weights, which = np.unique(chosen, return_inverse=True)
        points = [weighted(number, config.level).num_sigmas() for number in weights.tolist()]
        out[f"{name}/error"] = (track.mean - sim.truth) * scale
        out[f"{name}/points"] = np.array(points)[which]
        out[f"{name}/chosen"] = chosen
    return out


def along(config: Config, rngs: Rngs) -> dict[str, Array]:
    """Degrees of observability along the flight, for several interpretations of Eq. 15.

    Returns
    -------
    above: ``(50, runs, 2, 2, 3, 5, 13)``, states above the threshold, at the estimates of the
    filter with weights by nonlinearity. The axes between runs and states are the interpretations:
    one segment or all segments so far; without or with weighting by the filter's covariance;
    sigma_0 from the positions, the measurement or a velocity; units of Table 2, angles in degrees,
    rates not in deg/h and micro g, SI, or standard deviations.
    degrees: ``(2, T, 13)``, along the paper's flight and the turning flight, both without errors.
    """
    sim = simulate(config, rngs)
    states, outputs = config.units
    track = run(filters(config)["nonlinear"], sim.prior, sim.epochs(), keep="cov", engine="numpy")
    noise = next(sim.epochs()).u.sqrt_R.diagonal()
    units = (
        (states, outputs),
        (np.r_[[DEGREE] * 3, states[3:]], outputs),
        (np.r_[states[:7], np.ones(6)], outputs),
        (np.ones(13), np.ones(8)),
        (config.sigma0, 1.0 / noise),
    )
    # (units, 1, 1, 13) for columns; (units, 1, 32, 1) for rows, of four orders.
    states, outputs = (np.array(each) for each in zip(*units))
    columns = states[:, None, None]
    rows = np.tile(outputs, 4)[:, None, :, None]
    so_far = np.zeros((len(units), len(rngs), 13, 13))
    above = []
    for epoch in islice(sim.epochs(), 1, None, 10):
        matrix = scenario.observability(track.mean[epoch.k - 1], epoch, units[3])
        piece = rows * matrix * columns
        so_far = np.asarray(np.linalg.qr(np.concatenate([so_far, piece], -2), "r"))
        # The measurement matrix alone has rank five.
        least = np.linalg.svd(piece[..., :8, :], compute_uv=False)[..., 4]
        P = np.asarray(track.cov)[epoch.k - 1] / (columns.mT * columns)
        for matrix, cov in product((piece, so_far), (None, P)):
            values = state_singular_values(matrix, cov)
            bars = np.stack([values[..., 5:7].mean(-1), least, values[..., 3]])
            above.append(values > THRESHOLD * bars[..., None])  # (3, units, runs, 13)
    degrees = []
    for flight in (config.flight, scenario.TURNING.flight):
        nav = misalignment.navigation(
            flight, slice(0, None, 2), *np.zeros((2, config.steps + 1, 3))
        )
        stars = scenario.BORESIGHTS @ nav.attitude.mT
        epoch = Epoch(u=scenario.Inputs(nav, nav.attitude, stars, np.eye(8)))
        still = np.zeros((config.steps + 1, 13))
        values = state_singular_values(scenario.observability(still, epoch, config.units))
        degrees.append(values / values[:, 3:4])
    readings = np.moveaxis(np.reshape(above, (-1, 2, 2, *above[0].shape)), -2, 1)
    return {"above": readings, "degrees": np.array(degrees)}


def mounting(config: Config, rngs: Rngs) -> dict[str, Array]:
    """Filters that do not model mounting errors, with errors of the sizes of `MOUNTINGS` in the
    same runs, and a filter with 19 states that estimates them ("S"). Results of `evaluate_filters`
    by ``<filter>, <size>``."""
    sim = simulate(config, rngs)
    draws = normals(rngs, (2, 3))[0].swapaxes(0, 1)
    filter, prior = scenario.mounting_filter(config, np.radians(60.0 / 3600.0), len(rngs))
    out = dict[str, Array]()
    for size in MOUNTINGS:
        trial = shown(scenario.mounted(sim, np.radians(size / 3600.0) * draws))
        arrays = evaluate_filters(trial, ("ukf", "nonlinear"), 10)
        if size == 60:
            arrays |= evaluate_filters(
                trial._replace(filters={"S": filter}, prior=prior), ("S",), 10
            )
        out |= {key.replace("/", f", {size}/"): values for key, values in arrays.items()}
    return out


def first_fixes(config: Config, _: Rngs) -> dict[str, Array]:
    """The first star fix by rule, compared with a fine tensor rule; arrays ``(angles,)``.

    Returns
    -------
    least: smallest eigenvalue of the misalignment's covariance after the fix, relative to the
    correct eigenvalue.
    mean, cov: relative errors of the moments of the star residuals.
    """
    epoch = next(simulate(replace(config, steps=1), UNDISTURBED).epochs())
    # One run for each size of the misalignment, about which the radar fix has no information.
    sigma = np.tile(config.sigma0, (len(MISALIGNMENTS_DEG), 1))
    sigma[:, PHI] = np.radians(MISALIGNMENTS_DEG)[:, None]
    prior = Gaussian(np.zeros(sigma.shape), np.square(sigma)[..., None] * np.eye(13))

    def fix(rule: Any) -> tuple[Array, ...]:
        """Smallest eigenvalue, mean ``(angles, 6)``, covariance ``(angles, 36)``."""
        filter = sigma_point(*scenario.model(config), rule=rule, form=scenario.FORM)
        (sensor,) = filter.sensors
        both = filter.measured(sensor, filter.start(prior).belief, epoch.z, epoch)
        P = condition(filter.form, both, filter.motion.space)[0].cov[:, :3, :3]
        # An indefinite covariance is nan.
        least = np.where(np.isnan(P[:, 0, 0]), np.nan, np.linalg.eigvalsh(np.nan_to_num(P))[:, 0])
        residuals = np.asarray(both.innovation)[:, :6]
        return least, -residuals, both.covariances()[0][:, :6, :6].reshape(-1, 36)

    out = dict[str, Array]()
    best, *exact = fix(tensor_product(gauss_hermite(3, 20), simplex(10)))
    for name, rule in rules(config.level).items():
        least, *moments = fix(rule)
        out[f"{name}/least"] = least / best
        for what, a, b in zip(("mean", "cov"), moments, exact):
            out[f"{name}/{what}"] = np.linalg.norm(a - b, axis=-1) / np.linalg.norm(b, axis=-1)
    return out


def parts(effort: float = 1.0) -> dict[str, Part]:
    """All parts of the study. At an effort below `BRIEF` the flights are shorter, except T3 and the
    turning flight."""

    def flight(config: Config) -> Config:
        return replace(config, steps=150) if effort < BRIEF else config

    fitted = flight(T3)
    slow = flight(PRESETS["A-slow"])
    kinds = ("unweighed", "weighed")
    filter_runs = partial(monte_carlo, judged, cov=True)
    out = {}
    for i, (name, config) in enumerate(PRESETS.items()):
        config = T3 if name == "T3" else flight(config)
        out[name] = filter_runs(FLOWN, config, i, A.runs, 50, 11.0)
    return out | {
        MANY: filter_runs(("ukf", "aasghqf", "nonlinear"), fitted, 0, 200, 100, 11.0),
        "bound": Part(bound, flight(A)),
        "observability": Part(degrees, T3),
        "fixes": Part(first_fixes, T3),
        "operations": Part(cycles, A, cost=3.0),
        "six states": Part(partial(six_states, ("ekf", "ukf", "sghqf")), SIX, 5, 1000, 100, 5.0),
        "tensor": Part(partial(six_states, ("sghqf", "ghqf")), SIX, 5, 400, 100, 10.0),
        "T3, on line": Part(partial(on_line, ("bends",)), T3, 0, A.runs, 50, 2.0),
        "first fix": filter_runs(("ukf", "sghqf"), replace(A, steps=1), 1, 1000, 100, 2.0),
        f"{MANY}, on line": Part(partial(on_line, kinds), fitted, 0, 200, 50, 16.0),
        "A-slow, on line": Part(partial(on_line, tuple(CHOICES)), slow, 2, A.runs, 50, 10.0),
        "turning": Part(partial(on_line, kinds[:1]), scenario.TURNING, 2, 10, 50, 1.0),
        "along": Part(along, PRESETS["A-slow"], 4, 10, 50, 4.0),
        "mounting": Part(mounting, slow, 2, A.runs, 50, 8.0),
    }


# -- points of grids -------------------------------------------------------------------------------
def grid(indices: Mapping[tuple[int, ...], int]) -> dict[tuple[float, ...], list[float]]:
    """Union of the points of tensor rules whose coefficient is not 0, with the terms of each
    point's weight, one for each index that contains the point [Eqs. 13, 14]."""
    terms: dict[tuple[float, ...], list[float]] = {}
    for index, c in indices.items():
        if not c:
            continue
        rule = tensor_product(*(smolyak(1, level) for level in index))
        for point, weight in zip(map(tuple, rule.nodes.tolist()), rule.wm.tolist()):
            terms.setdefault(point, []).append(c * weight)
    return terms


def half_weights(n: int) -> list[int]:
    """Weights of the example with n states in Table 1: one half is 2, the other 1."""
    return [2] * (n // 2) + [1] * (n - n // 2)


def table_1(_: Results) -> list[dict[str, Any]]:
    """Numbers of points by dimension and filter, printed and counted: rows of Table 1."""
    return [
        {
            "n": n,
            "filter": f,
            "weights": "".join(map(str, g)),
            "paper": TABLE_1[f][n - 1],
            "ours": point_count(n, 3, g),
        }
        for n in range(1, 7)
        for f, g in (("SGHQF", [1] * n), ("AASGHQF", half_weights(n)))
    ]


def growth(_: Results) -> list[Number]:
    """Number of tensor rules with other than m^n points; for each level the largest ratio
    log(points) / log(n) of sparse grids."""
    built = product([ORDERS[level - 1] for level in LEVELS], (1, 2, 3))
    differ = sum(gauss_hermite(n, m).num_sigmas() != m**n for m, n in built)
    numbers = [
        Number("number of tensor rules with a number of points other than m^n", differ, (0, 0))
    ]
    for level in LEVELS:
        power = max(np.log(point_count(n, level)) / np.log(n) for n in range(20, 41))
        numbers.append(
            Number(
                f"largest log(points)/log(n), level {level}, n = 20 to 40",
                power,
                (None, level - 0.5),
            )
        )
    for level in LEVELS:
        numbers.append(Number(f"sigma points for n = 40, level {level}", point_count(40, level)))
    return [*numbers, Number("sigma points for n = 40, tensor rule with 3 per dimension", 3.0**40)]


def printed_bound(_: Results) -> list[Number]:
    """Points at level 3 with the index set of Eq. 18 as printed, sum_j (i_j - 1) g_j >= 2 min(g) -
    |g|, and with > instead."""

    def count(g: tuple[int, ...], least: int) -> int:
        sets = [i for i in index_set(3, g) if np.subtract(i, 1) @ g >= 2 * min(g) - sum(g) + least]
        return len(grid(dict.fromkeys(sets, 1)))

    return [
        Number("sigma points by Eq. 18 as printed, n = 1", count((1,), 0), (9, 9), printed=7),
        Number(
            "sigma points by Eq. 18, strict, with coefficients 0, weights 2, 1",
            count((2, 1), 1),
            (11, 11),
            printed=9,
        ),
    ]


def two_states(_: Results) -> list[Number]:
    """The paper's example: index sets (without indices whose coefficient is 0), points, and common
    nodes."""
    wrong = 0
    points = []
    for g, (printed, count) in EXAMPLE.items():
        coefficients = index_set(3, g)
        indices = {tuple(map(int, digits)) for digits in printed.split()}
        wrong += sum(coefficients.get(index) != 0 for index in indices ^ coefficients.keys())
        rule = smolyak(2, 3, g)
        points.append(Number(f"sigma points, weights {g}", rule.num_sigmas(), (count, count)))
    common = sum(len(terms) > 1 for terms in grid({(1,): 1, (2,): 1, (3,): 1}).values())
    return [
        Number("number of indices that differ from the printed ones", wrong, (0, 0)),
        *points,
        Number("number of nodes common to several rules", common, (1, 1)),
    ]


def one_term(_: Results) -> list[Number]:
    """Number of points of Fig. 1 that occur in several products, and the sum of the weights if each
    has a single term."""
    terms = grid(index_set(3, (1, 1))).values()
    several = sum(len(weights) > 1 for weights in terms)
    return [
        Number("points of Fig. 1 that occur in several products, of 21", several, (5, 5)),
        Number("sum of the weights, largest term of each point", sum(map(max, terms)), (1.5, None)),
        Number(
            "sum of the weights, smallest term of each point", sum(map(min, terms)), (None, 0.0)
        ),
    ]


def savings(_: Results) -> Tiers:
    """Number and fraction of saved points, with half of the weights 2, and as printed."""
    sizes = (6, 12, 24)
    full = np.array([point_count(n, 3) for n in sizes])
    half = np.array([point_count(n, 3, half_weights(n)) for n in sizes])
    ours = 100.0 * (1.0 - half / full)
    theirs = 100.0 * (1.0 - np.divide([*TABLE_1["AASGHQF"], 99], [*TABLE_1["SGHQF"], 417]))
    number = Number(
        "smallest increase of the number of saved points, half of the weights 2",
        np.diff(full - half).min(),
        (1, None),
    )
    shares = [
        Number(
            "smallest increase of the saved fraction of points (%)",
            np.diff(ours).min(),
            (1e-9, None),
        ),
        Number(
            "smallest increase of the saved fraction of points, printed (%)", np.diff(theirs).min()
        ),
        *(Number(f"saved fraction of points, n = {n} (%)", share) for n, share in zip(sizes, ours)),
    ]
    return {"reproduced": [number, *shares], "in part": [number]}


# -- numbers of the ledger -------------------------------------------------------------------------
def averaged(
    label: str,
    cells: Sequence[PartFilter],
    accept: Bounds = (None, None),
    states: slice = PHI,
    *,
    at: When = slice(None),
    statistic: Any = lambda a, b: a.sum() / b.sum(),
) -> Decided:
    """RMSE over the runs, averaged over the epochs, as in Table 3.

    The number is the ratio of two filters' sums over the states, or another ``statistic`` of each
    filter's averages ``(states,)``. states: the angles by default.
    """

    def number(r: Results) -> Number:
        # Squared errors (T, runs, states) of each filter.
        squares = [
            np.square(r.get(part, f"{f}/error")[r.at(part, at), :, states]) for part, f in cells
        ]
        runs = squares[0].shape[1]

        def value(drawn: Array) -> Any:
            # The weight of each run in the resample: a product instead of copies.
            share = np.bincount(drawn.astype(int), minlength=runs) / runs
            return statistic(*(np.sqrt(share @ square).mean(0) for square in squares))

        return estimate(label, value, [np.arange(runs)], accept)

    return number


def by_state(
    r: Results, label: str, cells: Sequence[PartFilter], accept: Bounds = (None, None)
) -> list[Number]:
    """`averaged` for each state of Table 3."""
    return [
        averaged(f"RMSE of {state}, {label}", cells, accept, slice(i, i + 1))(r)
        for i, state in enumerate(SEVEN)
    ]


def each(r: Results, a: str, b: str, accept: Bounds = (None, None)) -> list[Number]:
    """RMSE ratio of filter ``a`` to ``b`` in each preset and state of Table 3. At T3 the errors
    have long tails, so more runs are used. There the 57 points replace SGHQF, because they give the
    same estimates."""
    many = {"sghqf": "nonlinear"}
    numbers = []
    for part in PRESETS:
        pair = [(MANY, many.get(f, f)) if part == "T3" else (part, f) for f in (a, b)]
        numbers += by_state(
            r,
            f"{part}, {a.upper()} over {b.upper().replace('NONLINEAR', '57 points')}",
            pair,
            accept,
        )
    return numbers


def largest_first(numbers: Sequence[Number]) -> list[Number]:
    """Numbers sorted by value, largest first."""
    return sorted(numbers, key=lambda number: -number.value)


def above_and_below(ratios: Sequence[Number], margin: float = 0.0) -> tuple[int, int]:
    """Number of ratios whose whole interval is above 1, and number below 1."""
    ends = [number.ci for number in ratios if number.ci]
    return sum(low > 1 + margin for low, _ in ends), sum(high < 1 - margin for _, high in ends)


def tenth(r: Results, part: str, name: str) -> Array:
    """Time ``(runs,)`` s until the misalignment error is a tenth of its initial value; one step
    after the end if this never happens."""
    below = np.linalg.norm(r.get(part, f"{name}/error"), axis=-1) < 0.1 * r.get(part, "start")
    return SIX.step_s * np.where(below.any(0), below.argmax(0), len(below))


def six_filters(r: Results) -> Tiers:
    """SGHQF against EKF, UKF and GHQF: RMSE of the misalignment, time to a tenth of the initial
    error, operations, and how many of the three statements hold."""
    part = {"ekf": "six states", "ukf": "six states", "ghqf": "tensor"}

    def error(name: str, most: float) -> Number:
        return averaged(
            f"misalignment RMSE, SGHQF over {name.upper()}",
            [(part[name], "sghqf"), (part[name], name)],
            (None, most),
        )(r)

    def later(name: str, most: float | None = None) -> Number:
        return estimate(
            f"time to a tenth of the initial misalignment, SGHQF minus {name.upper()} (s)",
            lambda a, b: a.mean() - b.mean(),
            [tenth(r, part[name], filter) for filter in ("sghqf", name)],
            (None, most),
        )

    better = [error("ekf", 1.0), error("ukf", 1.0), later("ekf", 0.0), later("ukf", 0.0)]
    alike = [error("ghqf", 1.05)]
    fewer = operations("operations, SGHQF over GHQF, at most", "six/sghqf", "six/ghqf", (None, 1.0))
    cheaper = [fewer(r)]
    worst = [
        min(each, key=lambda number: (False, None, True).index(number.holds))
        for each in (better, alike, cheaper)
    ]
    return {
        "reproduced": [*better, *alike, *cheaper],
        "in part": [count_holding("number of the three statements that hold", worst, (2, None))],
        "not reproduced": [later("ghqf")],
    }


def changed(r: Results, part: str, name: str) -> Array:
    """Whether the weights change at each epoch of each run, ``(T - 1, runs)``."""
    return np.asarray(np.diff(r.get(part, f"{name}/chosen"), axis=0) != 0)


def adapts(r: Results) -> Tiers:
    """Fraction of runs in which weights change, by interpretation and preset; effect on the errors;
    number of interpretations with any change."""
    shares = []
    ratios = []
    changes = []
    for part, f in product((MANY, "A-slow"), ("unweighed", "weighed")):
        online = (f"{part}, on line", f)
        change = changed(r, *online)
        shares.append(
            estimate(
                f"fraction of runs with changing weights, {f}, {part}",
                np.mean,
                [change.any(0).astype(float)],
                (0.5, None),
            )
        )
        changes.append(Number(f"changes of the weights per run, {f}, {part}", change.sum(0).mean()))
        ratios += by_state(r, f"{part}, {f} over fixed weights", [online, (part, "aasghqf")])
    worse, better = above_and_below(ratios, 1e-3)
    above = r.get("along", "above")
    ever = (above[1:] != above[:-1]).any((0, 1, -1)).sum()
    more = [
        Number("RMS errors larger than with fixed weights, of 28", worse, (None, 0)),
        Number("RMS errors smaller than with fixed weights, of 28", better),
        Number("interpretations of Eq. 15 with any change of the weights, of 60", ever),
        *changes[2:],
        max(ratios, key=lambda number: number.ci[0] if number.ci else number.value),
    ]
    return {"reproduced": [*shares, *more], "in part": largest_first(shares)[:1]}


def followed(r: Results) -> list[Number]:
    """Points and errors with weights by nonlinearity, chosen before each step, and comparison with
    other thresholds."""
    slow = "A-slow, on line"
    fast = "T3, on line"
    references = (
        (fast, ("T3", "sghqf")),
        (slow, ("A-slow", "sghqf")),
        (slow, (slow, "bends, 0.01")),
        (slow, (slow, "bends, 1")),
    )
    errors = [
        averaged(
            f"misalignment RMSE, {part}, threshold 0.1 over {b[1].replace('bends,', 'threshold')}",
            [(part, "bends"), b],
            (0.99, 1.01),
        )
        for part, b in references
    ]
    return [
        Number("mean number of points, T3", r.get(fast, "bends/points").mean(), (27, 30)),
        Number("mean number of points, A-slow", r.get(slow, "bends/points").mean(), (27, 30)),
        *(error(r) for error in errors),
        Number(
            "changes of the weights per run, A-slow",
            changed(r, slow, "bends").sum(0).mean(),
            (1, 5),
        ),
        Number(
            "number of choices with weight 1 for a linear state",
            (r.get(slow, "bends/chosen") > 7).sum(),
            (0, 0),
        ),
    ]


def gentle(r: Results) -> list[Number]:
    """Degree of the heading on the paper's flight, and the force at which it becomes large on the
    turning flight."""
    level, turning = r.get("along", "degrees")[..., 2]
    flight, force = (config.flight.force[::2] for config in (A, scenario.TURNING))
    across = (np.hypot(*force.T[:2]) / force[:, 2])[turning > THRESHOLD]
    first = across[0] if len(across) else np.nan
    return [
        Number("largest degree of observability of φz", level.max(), (None, 2)),
        Number("largest horizontal specific force (m/s²)", np.hypot(*flight.T[:2]).max()),
        Number(
            "horizontal over vertical specific force where the degree of φz exceeds 5",
            first,
            (0.95, 1.05),
        ),
        Number(
            "changes of the weights per run on the turning flight",
            changed(r, "turning", "unweighed").sum(0).mean(),
            (1, None),
        ),
    ]


def doubled(r: Results) -> Number:
    """Size of the mounting errors (arc seconds) that doubles the final RMSE of the angles, from the
    sum of squared errors."""
    none, most = (
        r.squares("mounting", f"nonlinear, {size}", "misalignment", LAST).sum(-1)
        for size in (0, 200)
    )
    bar = np.sqrt(3.0 * none.mean() / 2.5) * 3600.0  # by the closed form, 2.5 sigma^2 in all

    def doubling(a: Array, b: Array) -> Any:
        return 200.0 * np.sqrt(3.0 * a.mean() / (b.mean() - a.mean()))

    accept = 0.8 * bar, 1.25 * bar
    return estimate(
        "mounting error that doubles the misalignment RMSE (arcsec)", doubling, [none, most], accept
    )


def degree(r: Results) -> Tiers:
    """Degrees with all scalings compared with the printed ones: number of states that agree, and
    order of the states."""
    every = r.get("observability", "every")
    printed = np.array(TABLE_2)
    far = np.abs(np.log(np.maximum(every, 1e-300) / printed)) > np.log([1.1] * 7 + [3.2] * 6)
    # Pairs of states in which the first has the larger printed degree.
    a, b = np.nonzero(printed[:, None] > printed)
    turned = every[..., a] <= every[..., b]
    differ = "number of degrees of observability that disagree, of 13, in the best units"
    order = "number of pairs of states out of the printed order, in the best units"
    return {
        "reproduced": [Number(differ, far.sum(-1).min(), (None, 0))],
        "in part": [Number(order, turned.sum(-1).min(), (None, 0))],
        "not reproduced": [
            Number(
                f"degree of {key.replace('phi_', 'φ').replace('eps_', 'ε').replace('nabla_', '∇')}",
                x,
            )
            for key, x in zip(misalignment.STATES, every[0, 0].tolist())
        ],
    }


def classes(r: Results) -> Tiers:
    """Number of weights that differ from Table 2, from printed and from computed degrees."""
    degrees = TABLE_2, *r.get("observability", "every").reshape(-1, 13)
    weights = np.array([threshold_weights(each, THRESHOLD) for each in degrees])
    theirs, *computed = (weights != PAPER_WEIGHTS).sum(1)
    printed = Number("number of weights that differ with printed degrees, of 13", theirs, (None, 0))
    others = [
        Number("number of weights that differ with our degrees, of 13", computed[0], (None, 0)),
        Number(
            "number of weights that differ with our degrees, fewest in any units", min(computed)
        ),
        Number("number of weights that differ with our degrees, most in any units", max(computed)),
    ]
    return {"reproduced": [printed, *others], "in part": [printed]}


def criterion(r: Results) -> list[Number]:
    """RMSE ratio of AASGHQF to the filter with 57 points (by nonlinearity), for every state and
    preset."""
    ratios = largest_first(each(r, "aasghqf", "nonlinear"))
    above, below = above_and_below(ratios)
    return [
        Number("number of RMSE ratios whose interval is above 1, of 28", above, (None, 0)),
        Number("number of RMSE ratios whose interval is below 1, of 28", below),
        *(
            consistency(
                f"mean NEES after the first fix, A, {f.upper().replace('NONLINEAR', '57 points')}",
                ("A", f),
                at=0,
            )(r)
            for f in ("aasghqf", "nonlinear", "sghqf")
        ),
        *ratios,
    ]


def better_than_ukf(r: Results) -> Tiers:
    """RMSE ratios of the UKF to both sparse filters, for every state and preset, smallest first;
    number of ratios above 1 for each filter."""
    sghqf, aasghqf = (each(r, "ukf", f, (1.0, None)) for f in ("sghqf", "aasghqf"))
    every = largest_first([*sghqf, *aasghqf])[::-1]
    half = np.sqrt(np.divide(TABLE_3["UKF"], TABLE_3["SGHQF"]))

    def above(what: str, ratios: Sequence[Number]) -> Number:
        accept = len(ratios), None
        return count_holding(
            f"number of RMSE ratios whose interval is above 1, {what}", ratios, accept
        )

    isotropic = [
        Number(
            "number of RMSE ratios whose interval is below 1, of 28, UKF over SGHQF",
            sum(number.holds is False for number in sghqf),
            (None, 0),
        ),
        above("of 7 at T3, UKF over SGHQF", sghqf[:7]),
        Number(
            "number of RMSE ratios beyond half-way to the printed ones, of 7 at T3, UKF over SGHQF",
            sum(number.value > bar for number, bar in zip(sghqf, half)),
        ),
    ]
    least = largest_first(sghqf)[-1]._replace(accept=(None, None))
    counts = [above("of 28, UKF over SGHQF", sghqf), above("of 28, UKF over AASGHQF", aasghqf)]
    return {"reproduced": [*counts, *isotropic, least, *every], "in part": isotropic}


def levels(r: Results) -> Tiers:
    """Comparison of all 21 entries of Table 3 at T3."""
    printed = np.log(list(TABLE_3.values()))
    cells = [(MANY, f) for f in ("ukf", "nonlinear", "aasghqf")]
    entries = partial(averaged, cells=cells, states=slice(0, 7))

    def logs(rmse: Sequence[Array]) -> Any:
        """Logarithms ``(3, 7)`` of the factors from the printed entries."""
        return np.abs(np.log(rmse) - printed)

    beyond = entries(
        "printed values that differ by more than a factor of 1.32, of 21",
        accept=(None, 3),
        statistic=lambda *rmse: (logs(rmse) > np.log(1.32)).sum(),
    )
    largest = entries(
        "largest factor between a printed value and ours",
        accept=(None, 3.2),
        statistic=lambda *rmse: np.exp(logs(rmse).max()),
    )
    return {"reproduced with fitted parameters": [beyond(r)], "level only": [largest(r)]}


def orders(r: Results) -> Tiers:
    """Total degree to which each grid is exact (one less than the degree of the first even monomial
    that it fails), and errors of its moments."""
    exact = []
    monomials = list(product((0, 2, 4, 6), repeat=3))
    for name, g in (("isotropic", (1, 1, 1)), ("weights with a 2", (1, 1, 2))):
        fails = min(sum(powers) for powers in monomials if not integrates(powers, 3, g))
        exact.append(
            Number(f"total degree to which the grid is exact, {name}", fails - 1, (4, None))
        )
    errors = []
    for f, what in product(("sghqf", "aasghqf"), ("mean", "cov")):
        ours, ukf = (r.get("fixes", f"{name}/{what}") for name in (f, "ukf"))
        number = Number(
            f"error of the {what.replace('cov', 'covariance')} after a fix, {f.upper()} over UKF",
            TEN(ours / ukf),
            (None, 1.0),
        )
        errors.append(number)
    return {"reproduced": exact, "in part": [exact[0], *errors]}


def coriolis(_: Results) -> list[Number]:
    """Latitude derivative of ``(2 w_ie + w_en)_up`` by Eq. 22 over its finite difference: as
    printed, and as corrected."""
    L = np.radians(T3.latitude_deg)
    velocity = T3.flight.velocity[0]
    ends = L + np.array([-1e-4, 1e-4])
    rate = 2.0 * earth.earth_rate(ends) + earth.transport_rate(velocity, ends, T3.height_m)
    right = np.diff(rate[:, 2])[0] / 2e-4
    east = earth.radii(L, T3.height_m)[1]
    ie = earth.ROTATION_RATE * np.cos(L)
    en = velocity[0] / (np.cos(L) ** 2 * east)
    return [
        Number(
            "latitude derivative of the Coriolis rate, printed over true",
            (ie + en) / right,
            (0.6, 0.7),
        ),
        Number(
            "latitude derivative of the Coriolis rate, corrected over true",
            (2.0 * ie + en) / right,
            (0.99, 1.01),
        ),
    ]


# -- the ledger ------------------------------------------------------------------------------------
DECISIONS: dict[str, Decision] = {
    "table-1-counts": lambda r: Number(
        "number of counts that differ, of twelve",
        sum(row["paper"] != row["ours"] for row in table_1(r)),
        (0, 0),
    ),
    "points-for-two-states": two_states,
    "degrees-of-observability": degree,
    "threshold-weights": classes,
    "observability-is-the-criterion": criterion,
    "adapts-along-the-flight": adapts,
    "better-than-ukf": better_than_ukf,
    "higher-order-is-why": orders,
    "alike-sghqf": lambda r: largest_first(each(r, "aasghqf", "sghqf", (0.92, 1.08))),
    "table-3-levels": levels,
    "table-4-points": lambda _: {
        "reproduced": (
            counts := [
                Number(f"sigma points, {f}", point_count(13, n, g), (TABLE_4[f][0],) * 2)
                for f, n, g in POINTS
            ]
        ),
        "in part": counts[:2],
    },
    "one-millisecond-more": all_of(
        operations("additional operations per cycle", "aasghqf", "ukf", (None, 1e6), np.subtract),
        operations("operations per cycle over the UKF", "aasghqf", "ukf", (1.15, None)),
    ),
    "cheaper-than-sghqf": all_of(
        constant(
            "sigma points, SGHQF over AASGHQF",
            point_count(13, 3) / point_count(13, 3, PAPER_WEIGHTS),
            (1.52, None),
        ),
        operations("operations, SGHQF over AASGHQF, at least", "sghqf", "aasghqf", (1.52, None)),
    ),
    "saving-grows": savings,
    "points-grow": growth,
    "sghqf-beats-ekf-ukf-cheaper-than-ghqf": six_filters,
    "erratum-1-points": lambda _: [
        Number(
            "sigma points by the paper's rule",
            point_count(13, 3, PAPER_WEIGHTS),
            (75, 75),
            printed=99,
        ),
        Number(
            "sigma points if merged at the origin only",
            1 + sum(len(w) for x, w in grid(index_set(3, PAPER_WEIGHTS)).items() if any(x)),
            (99, 99),
        ),
        Number(
            "sigma points for 14 states, five with weight 1",
            point_count(14, 3, [1] * 5 + [2] * 9),
            (99, 99),
        ),
    ],
    "erratum-2-bound": printed_bound,
    "erratum-3-example": lambda _: Number(
        "coefficient of the index (1, 1)", index_set(3, (1, 1))[1, 1], (0, 0)
    ),
    "erratum-4-merged": one_term,
    "erratum-7-rate": coriolis,
    "erratum-9-units": all_of(
        of(
            "observability",
            "every",
            "degree of observability of φx, misalignment in deg",
            (0.16, 0.18),
            lambda d: d[1, 0, 0],
        ),
        of(
            "observability",
            "every",
            "number of states with weight 1",
            (0, 0),
            lambda d: threshold_weights(d[1, 0], THRESHOLD).count(1),
        ),
    ),
    "erratum-11-triad": all_of(
        averaged(
            "RMSE of φx, EKF started from Wahba's solution, T3 (deg)",
            [("T3", "triad-ekf")],
            (0.045, 0.075),
            slice(0, 1),
            statistic=np.mean,
        ),
        averaged(
            "mean RMSE of the angles in the last 100 s, SGHQF, T3 (deg)",
            [("T3", "sghqf")],
            (0.05, 0.08),
            at=LATE,
            statistic=np.mean,
        ),
        averaged(
            "mean RMSE of the angles, SGHQF with a fix each second, A (deg)",
            [("A", "sghqf")],
            (None, 0.01),
            statistic=np.mean,
        ),
    ),
    "nonlinear-equal": all_of(
        constant(
            "sigma points by nonlinearity", point_count(13, 3, scenario.NONLINEAR_WEIGHTS), (57, 57)
        ),
        *(
            averaged(
                f"misalignment RMSE, 57 over 417 points, {p}",
                [(p, "nonlinear"), (p, "sghqf")],
                (0.999, 1.001),
            )
            for p in SHOWN
        ),
    ),
    "triad": all_of(
        *(
            averaged(
                f"misalignment RMSE, EKF from Wahba's solution over SGHQF, {p}",
                [(p, "triad-ekf"), (p, "sghqf")],
                (None, most),
            )
            for p, most in zip(SHOWN, (0.6, 0.8, 0.9))
        ),
        lambda r: averaged(
            "misalignment RMSE, EKF from Wahba's solution over the bound, A",
            [("A", "triad-ekf")],
            (0.9, 1.1),
            statistic=lambda x: np.linalg.norm(x) / np.sqrt(r.get("bound", "square")[:, 0]).mean(),
        )(r),
    ),
    "nees-first-ukf": all_of(
        of(
            "fixes",
            "ukf/least",
            "smallest variance over the correct one after the first fix, UKF",
            (None, 0.01),
            TEN,
        ),
        consistency(
            "mean NEES of the UKF after the first fix, A", ("first fix", "ukf"), (1.3e4, None), at=0
        ),
        consistency(
            "mean NEES of the UKF, last 100 s, A-slow", ("A-slow", "ukf"), (260.0, None), at=LATE
        ),
        consistency(
            "mean NEES of SGHQF after the first fix, A", ("first fix", "sghqf"), (None, 26.0), at=0
        ),
        consistency(
            "mean NEES of SGHQF, last 100 s, A-slow", ("A-slow", "sghqf"), (None, 26.0), at=LATE
        ),
    ),
    "first-fix": all_of(
        *(
            of(
                "fixes",
                f"{f}/least",
                f"smallest variance over the correct one, {label}",
                accept,
                TEN,
            )
            for f, label, accept in (
                ("delayed", "delayed orders", (None, 0.01)),
                ("ghqf3", "GHQF with 3 points an axis", (None, 0.01)),
                ("sghqf", "SGHQF", (0.99, 1.01)),
                ("aasghqf", "AASGHQF", (0.95, 1.05)),
            )
        )
    ),
    "bends-on-line": followed,
    "unit-free": of(
        "along",
        "above",
        "fraction of epochs and runs with the weights of the nonlinear states",
        (1, 1),
        # Reading: one segment, not weighted, sigma_0 from the positions, in standard deviations.
        lambda above: (above[:, :, 0, 0, 0, 4] == np.less(range(13), 3)).all(-1).mean(),
    ),
    "gentle-flight": gentle,
    "mounting": all_of(
        doubled,
        *(
            averaged(
                f"misalignment RMSE at the end, {said} over 57 points, mounted {b[11:]} arcsec off",
                [("mounting", a), ("mounting", b)],
                accept,
                at=LAST,
            )
            for said, a, b, accept in (
                ("UKF", "ukf, 0", "nonlinear, 0", (2.0, None)),
                ("UKF", "ukf, 200", "nonlinear, 200", (None, 1.5)),
                ("19 states", "S, 60", "nonlinear, 60", (None, 1.0)),
            )
        ),
        *(
            consistency(f"mean NEES at the end, {said} arcsec", ("mounting", f), accept, at=LAST)
            for said, f, accept in (
                ("57 points, mounting errors of 20", "nonlinear, 20", (26.0, None)),
                ("19 states, mounting errors of 60", "S, 60", (None, 26.0)),
            )
        ),
    ),
    # The 57 points give the estimates of SGHQF, and have 200 runs.
    "nees-T3-sghqf": consistency(
        "mean NEES of SGHQF, T3", (MANY, "nonlinear"), (11.05, 14.95), at=LATE
    ),
    "nees-A-sghqf": consistency("mean NEES of SGHQF, A", ("A", "sghqf"), (10.4, 15.6), at=LATE),
    "nees-A-triad-ekf": consistency(
        "mean NEES of the EKF from Wahba's solution, A", ("A", "triad-ekf"), (10.4, 15.6), at=LATE
    ),
    "failed": lambda r: Number(
        "failed runs",
        sum((~np.isfinite(r.get(p, f"{f}/nees"))).any(0).sum() for p in PRESETS for f in FLOWN),
        (0, 0),
    ),
}

ROWS, ANSWER = read_ledger(LEDGER, DECISIONS)
STUDY = Study(
    "aasghqf",
    scenario.groups(A, DEGREE, "deg"),
    judged,
    parts,
    ROWS,
    figure="figure_06",
    says="99 points, placed where states are observable, equal 417 points and beat the UKF.",
    found=ANSWER,
)
