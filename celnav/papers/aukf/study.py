"""[Fan] judged: the runs, what the paper states, and what we found beside it.

The paper's curves and Table 1 are lost: where a check wants a level, it is that of an independent prototype of ten runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from celnav.filters.adaptive import innovation_window
from celnav.filters.joint import Joint, condition, joint
from celnav.filters.records import Epoch, Filter, FromFunctions, Info, State
from celnav.filters.run import run
from celnav.gaussian.belief import Gaussian, nees, symmetric
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import unscented
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.models import pseudorange
from celnav.models.beidou import ROTATION_RATE, TILT, satellites, tilted, turned
from celnav.papers.aukf.scenario import (
    GROUPS,
    PRESETS,
    STANDARD,
    START_S,
    Config,
    Scenario,
    adapted,
    filters,
    simulate,
    trial,
    ukf,
)  # fmt: skip
from celnav.receiver import day
from celnav.receiver.constellation import GEOSTATIONARY, TOE_S, geostationary, synthetic
from celnav.study import numbers
from celnav.study.ledger import Bounds, Number, Row, Tiers, estimate
from celnav.study.montecarlo import generator
from celnav.study.numbers import SAME_ORDER, Decided, all_of, of, tiers
from celnav.study.study import Part, Results, Rngs, Study
from celnav.study.trial import Group, Noiseless

Arrays = dict[str, Array]
INPUTS = ("rinex",)
"""Arguments of `parts` that a person may give on the command line: folders."""
AFTER_S, SETTLED_S = 5.0, 10.0
"""Length of what is judged after the burst; errors of the start are not counted before."""

# -- what is flown -------------------------------------------------------------------------------------------------------------
Case = tuple[Mapping[str, Any], Sequence[str]]
Cases = Mapping[str, Case]
"""Case -> what it changes in the configuration, and the filters that are flown on it; those named "<noise>/..." share the noise."""
PAIR = ("ukf", "aukf")
FILTERS = ("ls", *PAIR, "group", "channel", "sage-husa", "student", "huber", "gate")
"""Without the EKF: it is the UKF."""
PROCESS_NOISE = {1.0: (1.0, 10.0, 100.0, 300.0, 1000.0), 0.1: (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)}
"""Interval (s) -> densities of the acceleration (m^2/s^3)."""
WINDOWS = {("1 Hz", 1.0, 1000.0): (10, 1, 2, 5), ("10 Hz", 0.1, 100.0): (10, 5, 30), ("default", 0.1, None): (1, 3, 50, 100)}
"""Name, interval (s) and process noise (None: that of the configuration) -> lengths of the window."""
INITIAL_KM = (1.0, 10.0, 100.0, 1000.0)
STARTS = ("10/10", "1e3/1e3", "1e3/10", "1e5/1e5", "1e5/10", "1e6/1e6", "1e6/10")
"""Deviations of the initial position, m, and what they are taken for."""
WRONG_Q, WRONG_R = (0.01, 0.1, 1.0, 10.0, 100.0), (0.3, 3.0)
"""Parts of the process noise of the turn, and of the ranges' true deviation, that filters assume."""
TIMED = ("ekf", "ukf", "aukf", "group", "huber")
REACHED = (0.92, 1.06)
BOUND = {"ekf": REACHED, "ukf": REACHED, "aukf": (1.03, 1.2), "group": REACHED, "channel": REACHED, "no redraw": (1.5, 1.72)}
"""Flown on truth from the model -> what part of the bound's error is accepted."""
QUIET, MISTUNED = {"burst": "none"}, {"burst": "none", "true_sigma_range_m": PRESETS["mistuned"].true_sigma_range_m}
BURSTS = {case: {"burst": case} for case in ("ranges", "both", "one")}


def plans(c: Config) -> dict[str, tuple[int, int, int, float, Sequence[str], Cases]]:
    """Part -> number of its random numbers, runs, runs in a block, when it ends (s), what is kept beside errors, and its cases."""
    second = {"interval_s": 1.0}
    densities: dict[str, Case] = {
        f"{T:g}/{q:g}": ({**QUIET, "interval_s": T, "acceleration_noise_m2_per_s3": q}, ("ekf", "aukf", "group"))
        for T in PROCESS_NOISE for q in PROCESS_NOISE[T]
    }  # fmt: skip
    lengths: dict[str, Case] = {
        f"{label}/{M}": ({"burst": "ranges", "interval_s": T, "acceleration_noise_m2_per_s3": q, "window": M},
                         ("aukf", "ukf", "group") if q and M == 10 else ("aukf",))
        for (label, T, q), Ms in WINDOWS.items() for M in Ms
    }  # fmt: skip
    slow = {**QUIET, **second, "duration_s": 30.0}
    first: dict[str, Case] = {}
    for km in INITIAL_KM:
        far = {**slow, "deviation": (1e3 * km, *c.deviation[1:])}
        first |= {f"{km:g}/1": (far, ("ekf", *PAIR, "from a fix")), f"{km:g}/0.001": ({**far, "alpha": 1e-3}, ("ukf",))}
    starts: dict[str, Case] = {}
    for start in STARTS:
        true, taken = map(float, start.split("/"))
        change = {"duration_s": 120.0 if true == 1e6 else 60.0, "deviation": (true, *c.deviation[1:]), "assumed_m": taken}
        starts[start] = ({**slow, **change}, ("ekf", *PAIR))
    short, a2T = {**QUIET, "duration_s": 15.0}, c.acceleration_noise
    wrong: dict[str, Case] = {}
    for part in WRONG_Q:
        wrong[f"near/Q {part:g}"] = (
            {**short, "acceleration_noise_m2_per_s3": part * a2T},
            ("ukf",) if part in (1.0, 100.0) else PAIR,
        )
    wrong |= {f"near/R {part:g}": ({**short, "sigma_range_m": part * c.true_sigma_range_m}, ("ukf",)) for part in WRONG_R}
    wrong["far"] = ({**short, "deviation": (10.0 * c.deviation[0], *c.deviation[1:]), "assumed_m": c.deviation[0]}, PAIR)
    few = {"burst": "one", "burst_s": (15.0, 25.0)}
    several: dict[str, Case] = {k: ({**few, "duration_s": 25.0, "burst_count": int(k)}, PAIR) for k in ("3", "8")}
    model = {**QUIET, **second, "motion": "model", "acceleration_noise_m2_per_s3": 100.0}
    near = {"deviation": (1e3, *c.deviation[1:]), "burst_s": (10.0, 12.0), "duration_s": 12.0}
    each: dict[str, Mapping[str, Any]] = {**BURSTS, "mistuned": MISTUNED}
    return {
        "main": (0, c.runs, 50, np.inf, ("nis", "factor"),
                 {"none": (QUIET, ("ls", "ekf", *PAIR)), "ranges": (BURSTS["ranges"], ("ekf", *PAIR, "group"))}),
        "baselines": (1, 20, 20, np.inf, (), {case: (change, FILTERS) for case, change in each.items()}),
        "process noise": (2, 20, 20, STANDARD.burst_s[0], ("nis", "factor"), densities),
        "windows": (3, 20, 20, c.burst_s[1] + AFTER_S, (), lengths),
        "initial errors": (4, 20, 20, np.inf, (), first),
        "matched": (5, 40, 40, np.inf, ("nis", "nees", "factor"), {"1 Hz": (model, tuple(BOUND))}),
        "redraw": (6, 20, 20, c.burst_s[0], ("nees",), {"none": (QUIET, ("ukf", "no redraw"))}),
        "disturbed": (7, c.runs, 50, np.inf, (), {"both": (BURSTS["both"], PAIR), "mistuned": (MISTUNED, PAIR)}),
        "bursts, 1 Hz": (8, c.runs, 50, np.inf, (), {k: ({**v, **second}, PAIR) for k, v in BURSTS.items()}),
        "one range": (9, c.runs, 100, np.inf, (), {"one": ({**few, "duration_s": 40.0}, PAIR)}),
        "some ranges": (10, c.runs, 50, np.inf, (), several),
        "1 km": (11, c.runs, 100, np.inf, (), {"ranges": (near, ("ekf", "ukf"))}),
        "wrong": (12, c.runs, 25, np.inf, (), wrong),
        "starts": (13, 2 * c.runs, 50, np.inf, (), starts),
    }  # fmt: skip


def flights(cases: Cases, until: float, keep: Sequence[str], config: Config, rngs: Rngs) -> Arrays:
    """Filters on cases, side by side where their epochs and what they assume of the measurement are the same.

    Returns
    -------
    ``times`` of the configuration; ``<case>/<filter>/error (T, runs, 3)`` m of the position, nan once a run is lost, and what is
    named in ``keep``: ``nis``, ``nees (T, runs)``, and ``factor (T, runs, 2 S)`` of the AUKF.
    """
    sims: dict[str, Scenario] = {}
    batches: dict[tuple[Any, ...], dict[str, Scenario]] = {}
    for case, (change, names) in cases.items():
        c = replace(config, **change)
        noise = case.partition("/")[0]
        if noise not in sims:
            sims[noise] = simulate(c, rngs)
        prior = Gaussian(sims[noise].prior.mean, np.broadcast_to(c.P0, (len(rngs), 8, 8)))
        for name in names:
            own = batches.setdefault((name, c.interval_s, c.duration_s, c.sigma_range_m, c.window, c.alpha), {})
            own[case] = sims[noise]._replace(config=c, prior=prior)
    out = {"times": config.times}
    for (name, *_), batch in batches.items():
        track = _track(name, list(batch.values()), until, keep)
        for what, values in track.items():
            out |= {f"{case}/{name}/{what}": part for case, part in zip(batch, np.split(values, len(batch), 1), strict=True)}
    return out


def _track(name: str, sims: Sequence[Scenario], until: float, keep: Sequence[str]) -> Arrays:
    """A filter on scenarios, their runs one after the other."""
    c, S = sims[0].config, len(sims[0].satellites.names)
    truth, z = (np.concatenate([getattr(sim, each) for sim in sims], 1) for each in ("truth", "z"))
    mean, cov = (np.concatenate([getattr(sim.prior, each) for sim in sims]) for each in ("mean", "cov"))
    Q = [sim.config.Q for sim in sims]
    each = Q[0] if np.ptp(Q, 0).max() == 0.0 else np.repeat(Q, len(mean) // len(sims), 0)
    filter = {**filters(c, S, each), **variants(c, S, each)}[name + (", watched" if name == "aukf" and "factor" in keep else "")]

    def also(epoch: Epoch, state: Any, infos: tuple[Info, ...]) -> Arrays:
        error = state.belief.mean - epoch.truth
        found: dict[str, Callable[[], Any]] = {
            "nis": lambda: infos[0].nis, "nees": lambda: nees(error, state.belief.sqrt_cov),
            "factor": lambda: state.memory[0][0][1],
        }  # fmt: skip
        return {"error": error[..., :3]} | {what: found[what]() for what in keep if what != "factor" or name == "aukf"}

    epochs = takewhile(lambda epoch: epoch.t < until, sims[0]._replace(truth=truth, z=z).epochs())
    return run(filter, Gaussian(mean, cov), epochs, keep="nothing", also=also, on_failure="flag").extra


def variants(config: Config, S: int, Q: Array) -> dict[str, Filter]:
    """Filters beside those of `filters`.

    aukf, watched: with its factors in its memory. from a fix: EKF from the fix of the first epoch, and so from anywhere. no redraw:
    UKF whose measurement uses the points of the prediction, which have no process noise in them.
    """
    known = filters(config, S, Q)
    fix, ekf, plain = known["ls"], known["ekf"], known["ukf"]
    window = innovation_window(config.window)

    def watched(memory: Any, joint: Joint, epoch: Any) -> tuple[Any, Joint]:
        own, after = window(None if memory is None else memory[0], joint, epoch)
        (_, before), (_, now) = joint.variances(), after.variances()
        return (own, np.broadcast_to(now / before, np.asarray(joint.innovation).shape)), after

    def from_fix(state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        if epoch.k:
            return ekf.step(state, epoch)
        found, infos = fix.step(fix.start(state.belief), epoch)
        return ekf.start(found.belief), infos

    def no_redraw(state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        if not epoch.dt:
            return plain.step(state, epoch)

        def g(points: Array, epoch: Epoch) -> tuple[Array, Array]:
            moved = points @ config.F.T
            return pseudorange.measure(moved, *epoch.u), moved

        W, V, z = symmetric(Q, "Q")[1], np.diag(config.sigma(S)), np.asarray(epoch.z)
        both = joint(ukf(config), state.belief, g, epoch, z=z, process_noise=W, measurement_noise=V)
        posterior, info, _ = condition(type(state.belief), both, EUCLIDEAN)
        return State(posterior, state.memory), (info,)

    return {
        "aukf, watched": adapted(config, S, ukf(config), watched, Q=Q),
        "from a fix": FromFunctions(ekf.start, from_fix), "no redraw": FromFunctions(plain.start, no_redraw),
    }  # fmt: skip


def bound(config: Config, _: Rngs) -> Arrays:
    """Posterior Cramer-Rao bound of the part "matched", deviations ``(T, 3)`` m: those of the EKF along the undisturbed run."""
    c = replace(config, **plans(config)["matched"][-1]["1 Hz"][0])
    sim = simulate(c, [Noiseless()])  # type: ignore[list-item]
    track = run(filters(c)["ekf"], sim.prior, sim.epochs())
    return {"std": np.asarray(track.std)[:, 0, :3]}


# -- what needs no filters on runs ---------------------------------------------------------------------------------------------
INCLINATIONS_DEG = (55.0, 10.0, 1.0, 0.1, 0.01)
NORMAL_ERROR = 1e-4
"""rad, of an orbit's normal, in each direction across it."""


def nodes(_: Config, rngs: Rngs) -> Arrays:
    """How well an orbit's node is known, if its normal is to `NORMAL_ERROR`: deviations (deg) by inclination.

    formula, drawn: of the node. place: of a satellite's direction half-way to the highest point, across the orbit (deg).
    """
    i, u = np.radians(INCLINATIONS_DEG), np.radians(45.0)
    along, across = NORMAL_ERROR * rngs[0].standard_normal((2, 200_000, 1))
    # With the node on the x axis the normal is (0, -sin i, cos i); errors lie along the node and up the slope.
    x, y, z = along, -np.sin(i) - across * np.cos(i), np.cos(i) - across * np.sin(i)
    off = np.cos(u) * x + np.sin(u) * (np.cos(i) * y + np.sin(i) * z)
    drawn, place = (np.degrees(np.sqrt(np.square(values).mean(0))) for values in (np.arctan2(x, -y), off))
    return {"formula": np.degrees(NORMAL_ERROR / np.sin(i)), "drawn": drawn, "place": place}


def polar(_: Config, rngs: Rngs) -> Arrays:
    """From polar coordinates, 1 +- 0.02 and 90 +- 15 deg, to Cartesian ones: means and deviations ``(2,)``, points, draws."""
    rule, mean, std = unscented(2, 1.0, 0.0, 1.0), np.array([1.0, np.pi / 2.0]), np.array([0.02, np.radians(15.0)])

    def cartesian(p: Array) -> Array:
        return np.asarray(p[..., :1] * np.stack([np.cos(p[..., 1]), np.sin(p[..., 1])], -1))

    samples, images = cartesian(mean + std * rngs[0].standard_normal((1_000_000, 2))), cartesian(mean + rule.nodes * std)
    center, exact = rule.wm @ images, np.exp(-0.5 * std[1] ** 2) * cartesian(mean)
    return {
        "error": np.abs(center - exact)[1:], "draws": samples[:2000], "images": images, "linear mean": cartesian(mean),
        "linear std": std[::-1],
        "exact mean": exact, "exact std": samples.std(0),
        "unscented mean": center, "unscented std": np.sqrt(rule.wc @ np.square(images - center)),
    }  # fmt: skip


def transform(_: Config, rngs: Rngs) -> Arrays:
    """The unscented transform of random quadratic maps of 2 to 8 Gaussians against exact moments, by map.

    mean: largest error, of the size of the exact one. slope: of the covariance's error, on logarithmic axes, over the deviation.
    """
    (rng,), mean, slope = rngs, [], []
    for n in range(2, 9):
        rule, A = unscented(n, 1.0, 2.0, 0.0), rng.standard_normal((3, n, n))
        J, A, root, errors = rng.standard_normal((3, n)), A + A.mT, rng.standard_normal((n, n)), []
        for deviation in (1.0, 0.1):
            L = deviation * root
            x = rule.nodes @ L.T
            y = x @ J.T + 0.5 * np.einsum("pi,kij,pj->pk", x, A, x)
            B = L.T @ A @ L
            exact, P = 0.5 * np.trace(B, axis1=1, axis2=2), J @ L @ L.T @ J.T + 0.5 * np.einsum("kij,lji->kl", B, B)
            center = rule.wm @ y
            mean.append(np.abs(center - exact).max() / np.abs(exact).max())
            errors.append(np.linalg.norm((rule.wc * (y - center).T) @ (y - center) - P))
        slope.append(np.log10(errors[0] / errors[1]))
    return {"mean": np.array(mean), "slope": np.array(slope)}


def orbits(config: Config, _: Rngs) -> Arrays:
    """Positions of the five geostationary satellites by their elements against two bodies in space: distances, m.

    others: by the formula of the others, along the track ``(T, 5)``. minute, half hour: by that and one more rotation ``(5,)``, so
    long after the reference time. right: the rotation with the node held in space ``(5,)``, half an hour after it.
    """
    own = synthetic()
    own = own.chosen(own.geostationary)

    def off(t: float, position: Array) -> Array:
        turn = ROTATION_RATE * (t - TOE_S)
        exact = np.stack([turned(1e3 * geostationary(n, t - TOE_S)[:3], np.array(turn)) for n in GEOSTATIONARY])
        return np.asarray(np.linalg.norm(position - exact, axis=-1))

    def rotated(t: float) -> Array:
        turn = np.array(ROTATION_RATE * (t - TOE_S))
        return off(t, turned(tilted(day.as_others(own, t), -TILT), turn))

    along = START_S + config.times[:: round(10.0 / config.interval_s)]
    return {
        "others": np.stack([off(t, day.as_others(own, t)) for t in along.tolist()]), "minute": rotated(TOE_S + 60.0),
        "half hour": rotated(START_S), "right": off(START_S, satellites(own, START_S).position),
    }  # fmt: skip


def timings(rounds: int, config: Config, _: Rngs) -> Arrays:
    """CPU seconds of a step of `TIMED`, ``(2,)``: of a run alone, and of one among 100; the least of interleaved rounds.

    Four of them for all but the first two, which are compared.
    """
    short = replace(config, duration_s=5 * config.interval_s, burst="none")
    known, out = filters(short), {name: np.full(2, np.inf) for name in TIMED}
    for i, runs in enumerate((1, 100)):
        sim = simulate(short, [generator(0, 98, r) for r in range(runs)])
        for name in (rounds - 4) * TIMED[:2] + 4 * TIMED:
            start = process_time()
            run(known[name], sim.prior, sim.epochs(), keep="nothing")
            out[name][i] = min(out[name][i], (process_time() - start) / (len(sim.truth) * runs))
    return out


def real(files: day.Files, rngs: Rngs) -> Arrays:
    """A receiver's half day, with and without a burst: see `celnav.receiver.day.flown`."""
    return day.flown(files, ("ekf", "ukf", "aukf", "group"), STANDARD.burst_sigma, STANDARD.mask_deg, rngs[0])


def parts(effort: float = 1.0, rinex: Path | None = None) -> dict[str, Part]:
    """All that is computed; ``rinex``: folder of a station's files. At less effort runs are shorter before and after the burst."""
    start = max(20.0, SETTLED_S + 50.0 * effort)
    c = replace(STANDARD, burst_s=(start, start + 10.0), duration_s=start + 10.0 + max(10.0, 20.0 * effort))
    out = {
        name: Part(
            partial(flights, cases, until, keep), STANDARD if "process" in name else c, number, runs, block, COST.get(name, 3.0)
        )
        for name, (number, runs, block, until, keep, cases) in plans(c).items()
    }
    out["bound"] = Part(bound, c)
    facts = {"nodes": (nodes, 50), "polar": (polar, 51), "transform": (transform, 52), "orbits": (orbits, 53)}
    out |= {name: Part(work, STANDARD, number, cost=0.3) for name, (work, number) in facts.items()}
    out["timings"] = Part(partial(timings, max(4, round(24 * effort))), STANDARD, cost=4.0)
    files = day.found(rinex)
    return out if files is None else out | {"real": Part(real, files, 60, cost=15.0)}


COST = {"main": 28.0, "baselines": 38.0, "process noise": 13.0, "windows": 11.0, "disturbed": 16.0, "starts": 9.0, "wrong": 8.0}
"""CPU seconds of those that take long."""


# -- numbers of the ledger -----------------------------------------------------------------------------------------------------
Flown = tuple[str, str]
"""Part, and case and filter."""
AXES = tuple(Group(name, "m", slice(i, i + 1)) for i, name in enumerate("XYZ"))


def when(r: Results, part: str, key: str, window: str) -> slice:
    """Epochs of a case: before, in, after and late in its burst; all but the start, or the start; or the burst's first."""
    c = r.parts[part].config
    c = replace(c, **plans(c)[part][-1][key.rpartition("/")[0]][0])
    start, end = c.burst_s
    low, high = {
        "quiet": (SETTLED_S, start), "burst": (start, end), "after": (end, end + AFTER_S), "late": (start, end + AFTER_S),
        "all": (SETTLED_S, np.inf), "start": (0.0, start), "first": (start, start + c.interval_s),
    }[window]  # fmt: skip
    return slice(int(np.ceil(low / c.interval_s - 1e-6)), None if high == np.inf else int(np.ceil(high / c.interval_s - 1e-6)))


def squares(r: Results, a: Flown, window: str, group: str = "position") -> Array:
    """Mean squares ``(runs,)`` m^2 of a group's length in a window."""
    return np.asarray(r.squares(*a, group, when(r, *a, window)).sum(-1))


def level(label: str, a: Flown, window: str, accept: Bounds = (None, None), group: str = "position") -> Decided:
    """RMSE in a window, m."""
    return lambda r: numbers.rmse(label, a, group, accept, at=when(r, *a, window))(r)


def over(
    label: str, a: Flown, b: Flown, window: str, accept: Bounds = (None, None), group: str = "position", to: str = "", **more: Any
) -> Decided:  # fmt: skip
    """RMSE in a window over that of another filter there, or in the window ``to``."""
    return lambda r: numbers.ratio(label, a, b, group, accept, at=when(r, *a, window), to=when(r, *b, to or window), **more)(r)


def by_axis(label: str, a: Flown, b: Flown, window: str, accept: Bounds) -> list[Decided]:
    """`over` of X, Y and Z."""
    return [over(f"{g.name}, {label}", a, b, window, accept, g.name) for g in AXES]


def average(label: str, a: Flown, window: str, accept: Bounds = (None, None), of: Callable[[Array], Array] = np.asarray) -> Decided:
    """Mean over runs and a window of an array ``(T, runs, ...)``, or of what is ``of`` it."""

    def number(r: Results) -> Number:
        values = of(r.get(*a)[when(r, a[0], a[1].rpartition("/")[0], window)])
        return estimate(label, np.mean, [values.reshape(*values.shape[:2], -1).mean((0, 2))], accept)

    return number


def peak(label: str, a: Flown, window: str, accept: Bounds) -> Decided:
    """Largest position error in a window of any run, m."""
    return lambda r: Number(label, float(np.linalg.norm(r.error(*a, "position")[when(r, *a, window)], axis=-1).max()), accept)


def apart(label: str, a: Flown, b: Flown, window: str, accept: Bounds) -> Decided:
    """Distance of two filters' estimates, in the RMSE of the second."""

    def number(r: Results) -> Number:
        away = (r.error(*a, "position") - r.error(*b, "position"))[when(r, *a, window)]
        return Number(label, float(np.sqrt(np.square(away).sum(-1).mean() / squares(r, b, window).mean())), accept)

    return number


def correlation(label: str, a: Flown, accept: Bounds) -> Decided:
    """Of the position error from one epoch to the next."""

    def number(r: Results) -> Number:
        e = r.error(*a, "position")[when(r, *a, "all")]
        return estimate(label, lambda x, y: x.mean() / y.mean(), [(e[1:] * e[:-1]).mean((0, 2)), np.square(e).mean((0, 2))], accept)

    return number


def same(r: Results) -> list[Number]:
    """EKF and UKF on the paper's runs: how far they are apart (m), that in RMSE, ratios by axis; where they part."""
    cases = [("main", "none", "all"), ("main", "ranges", "all"), ("1 km", "ranges", "start"), ("1 km", "ranges", "burst")]
    apart, whole, out = [], [], []
    for part, case, window in cases:
        ekf, ukf = ((part, f"{case}/{name}") for name in ("ekf", "ukf"))
        at = when(r, *ekf, window)
        apart.append(np.abs(r.error(*ekf, "position") - r.error(*ukf, "position"))[at].max())
        whole.append(np.sqrt(squares(r, ekf, window).mean()))
        out += [number(r) for number in by_axis(f"{part}, {case}, {window}", ukf, ekf, window, (None, 1.0))]
    far = np.divide(apart, whole)
    return [
        Number("largest difference, m", max(apart[:2])), Number("over the RMSE", far[:2].max(), (0.01, None)),
        Number("the same, from 1 km", far[2:].max()),
        *(Number(f"EKF over UKF from {km:g} km after epoch 5", ahead(r, km)) for km in (10.0, 100.0)), *out,
    ]  # fmt: skip


def medians(r: Results, km: float, filter: str, alpha: float = 1.0) -> Array:
    """Median over the runs of the position error ``(T,)`` m."""
    return np.asarray(np.median(np.linalg.norm(r.get("initial errors", f"{km:g}/{alpha:g}/{filter}/error"), axis=-1), axis=1))


def ahead(r: Results, km: float) -> float:
    """Median error of the EKF over that of the UKF after epoch 5."""
    return float(medians(r, km, "ekf")[5] / medians(r, km, "ukf")[5])


HALVES: dict[str, Callable[[Array], Array]] = {
    "ranges": lambda A: A[..., : A.shape[-1] // 2], "rates": lambda A: A[..., A.shape[-1] // 2 :],
    "ranges above 1": lambda A: A[..., : A.shape[-1] // 2] > 1.0, "rates above 1": lambda A: A[..., A.shape[-1] // 2 :] > 1.0,
}  # fmt: skip
"""Of factors."""
QUIETS = (("main", "none"), ("main", "ranges"), ("disturbed", "both"), *(("baselines", case) for case in BURSTS))


def undisturbed(*, share: bool = False, strict: bool = True) -> list[Decided]:
    """AUKF against UKF before any burst, by axis: over all runs, ratio of RMSE or in which share of them it is better."""

    def number(axis: str, r: Results) -> Number:
        u, a = (np.concatenate([squares(r, (part, f"{case}/{name}"), "quiet", axis) for part, case in QUIETS]) for name in PAIR)
        if share:
            return estimate(f"{axis}, share of runs", np.mean, [(a < u) * 1.0], (0.95, None))
        return estimate(f"{axis}, ratio", lambda x, y: np.sqrt(x.mean() / y.mean()), [a, u], (None, 1.0), strict=strict and r.full)

    return [partial(number, axis.name) for axis in AXES]


READINGS = {
    "ranges, 10 Hz": ("main", "ranges"), "ranges and rates, 10 Hz": ("disturbed", "both"), "one range, 10 Hz": ("one range", "one"),
    "ranges, 1 Hz": ("bursts, 1 Hz", "ranges"), "ranges and rates, 1 Hz": ("bursts, 1 Hz", "both"),
    "one range, 1 Hz": ("bursts, 1 Hz", "one"),
}  # fmt: skip
"""What the burst may be, as the paper does not say: part and case."""


def suppressed(reading: str) -> list[Decided]:
    """AUKF in the burst: over its own quiet error, and over the UKF by axis."""
    part, case = READINGS[reading]
    aukf, ukf = ((part, f"{case}/{name}") for name in ("aukf", "ukf"))
    own = over(f"{reading}: over its own quiet error", aukf, aukf, "burst", (None, SAME_ORDER), to="quiet")
    return [over(f"{reading}: over the UKF", aukf, ukf, "burst"), own, *by_axis(reading, aukf, ukf, "burst", (None, 1.0))]


def recovery(reading: str) -> list[Decided]:
    """Time after the burst until the position error is below twice the quiet RMSE, AUKF over UKF and alone; RMSE after it."""
    part, case = READINGS[reading]

    def seconds(r: Results, name: str) -> Array:
        a = (part, f"{case}/{name}")
        after, c = when(r, *a, "after").start, replace(r.parts[part].config, **plans(r.parts[part].config)[part][-1][case][0])
        below = np.linalg.norm(r.error(*a, "position")[after:], axis=-1) < 2.0 * np.sqrt(squares(r, a, "quiet").mean())
        return np.asarray(c.interval_s * np.where(below.any(0), below.argmax(0) + 1, len(below)))

    def faster(r: Results) -> Number:
        both = [seconds(r, name) for name in ("aukf", "ukf")]
        return estimate(f"{reading}: time, over the UKF", lambda x, y: x.mean() / y.mean(), both, (None, 1.0))

    def alone(r: Results) -> Number:
        return estimate(f"{reading}: time, s", np.mean, [seconds(r, "aukf")], (None, 10.0))

    aukf, ukf = ((part, f"{case}/{name}") for name in ("aukf", "ukf"))
    return [alone, faster, over(f"{reading}: RMSE of 5 s after, over the UKF", aukf, ukf, "after", (None, 1.0))]


def outliers(count: str, window: str, accept: tuple[Bounds, Bounds]) -> list[Decided]:
    """AUKF with outliers in so many ranges: over its own quiet error, and over the UKF."""
    part, case = {"1": ("one range", "one"), "15": ("main", "ranges")}.get(count, ("some ranges", count))
    a, u, label = (
        (part, f"{case}/aukf"),
        (part, f"{case}/ukf"),
        f"{count} ranges, {'one epoch' if window == 'first' else 'ten seconds'}",
    )
    own = over(f"{label}: over its own quiet error", a, a, window, accept[0], to="quiet")
    return [own, over(f"{label}: over the UKF", a, u, window, accept[1])]


def cost(case: str) -> Decided:
    """What a wrong assumption costs the UKF in RMSE."""
    return over(case, ("wrong", f"{case}/ukf"), ("wrong", "near/Q 1/ukf"), "all", (2.0, None))


def sensitive(r: Results) -> Tiers:
    """The largest cost of statistics that are wrong by no more than a factor 10, and of an initial error as wrong."""
    costs = [cost(f"near/{what}")(r) for what in ("Q 0.1", "Q 10", "R 0.3", "R 3")]
    ends = [v[-1] for part in ("wrong", "starts") for key, v in r.data[part].items() if key.endswith("/ukf/error")]
    lost = sum(int(np.isnan(end).any(-1).sum()) for end in ends)
    epochs = [Number(f"epochs from (m, taken for) {start}", float(np.median(settling(r, start, "ukf")))) for start in STARTS]
    return {
        "reproduced": [max(costs, key=lambda n: n.value)], "in part": [cost("far")(r)],
        "not reproduced": [*costs, Number("runs lost", lost), *epochs],
    }  # fmt: skip


def settling(r: Results, start: str, name: str) -> Array:
    """Epochs ``(runs,)`` until the position error is below twice the settled one, which is that of the last half from 10 m."""
    own, settled = (np.linalg.norm(r.get("starts", f"{s}/{name}/error"), axis=-1) for s in (start, STARTS[0]))
    below = own < 2.0 * np.sqrt(np.square(settled[len(settled) // 2 :]).mean())
    return np.where(below.any(0), below.argmax(0), len(below))


def converges(r: Results) -> Tiers:
    """Epochs that the AUKF needs more than the others, in the median; those of which the interval is one number have none."""
    more = [
        estimate(f"from (m, taken for) {start}: epochs more than the {name.upper()}",
                 lambda a, b: np.median(a) - np.median(b), [settling(r, start, "aukf"), settling(r, start, name)], (None, 0.5))
        for start in STARTS for name in ("ekf", "ukf")
    ]  # fmt: skip
    least, most = (sorted(more, key=lambda n: n.value)[i] for i in (0, -1))
    return {"reproduced": [most, least._replace(accept=(None, -0.5)), *more]}


def over_bound(name: str, accept: Bounds) -> Decided:
    """RMSE over the posterior Cramer-Rao bound, truth from the model."""
    a = ("matched", f"1 Hz/{name}")

    def number(r: Results) -> Number:
        least = np.square(r.get("bound", "std")[when(r, *a, "all")]).sum(-1).mean()
        return estimate(f"{name} over the bound", lambda x: np.sqrt(x.mean() / least), [squares(r, a, "all")], accept)

    return number


def rotation(r: Results) -> Tiers:
    """Growth of the deviations of node and position by each tenth of inclination; errors of the formulas."""
    drawn, place = r.get("nodes", "drawn"), r.get("nodes", "place")
    singular = [Number("growth of the node's deviation", float((drawn[2:4] / drawn[1:3]).min()), (10.0**0.5, None)),
                Number("of the position's", float(place.max() / place.min()), (None, 10.0**0.5))]  # fmt: skip
    others = r.get("orbits", "others")
    return {
        "reproduced": [*singular, of("orbits", "half hour", "usual formula, rotated, m", (None, 1.0))(r)],
        "in part": [*singular, of("orbits", "right", "rotated, node held in space, m", (None, 1.0))(r)],
        "not reproduced": [Number("usual formula, rotated, after a minute, km", 1e-3 * float(r.get("orbits", "minute").max())),
                           Number("usual formula, km, least", 1e-3 * float(others.min())),
                           Number("most", 1e-3 * float(others.max()))],
    }  # fmt: skip


def load(r: Results) -> list[Number]:
    """CPU time of a step of the UKF over that of the EKF, alone and in a batch; evaluations of the measurement."""
    both = r.get("timings", "ukf") / r.get("timings", "ekf")
    times = [
        Number(f"CPU time of a step over the EKF's, {how}", float(x), (None, 1.1)) for how, x in zip(("alone", "in a batch"), both)
    ]
    return [*times, Number("evaluations of the measurement", len(ukf(STANDARD).nodes))]


def real_number(i: int, accept: Bounds) -> Decided:
    """What `celnav.receiver.day.judged` gives."""
    return lambda r: Number("", day.judged(r.data["real"])[i], accept)


# -- the ledger ----------------------------------------------------------------------------------------------------------------
statement, remark, finding, check = (partial(Row, kind) for kind in ("statement", "remark", "finding", "check"))


def noise(T: float, q: float, name: str) -> Flown:
    """Flown with a process noise."""
    return "process noise", f"{T:g}/{q:g}/{name}"


def window(label: str, M: int, name: str = "aukf") -> Flown:
    """Flown with a window."""
    return "windows", f"{label}/{M}/{name}"


A = ("main", "none/aukf/factor")
STATEMENTS = [
    statement(
        "ls-rough", "Least squares takes each epoch by itself: its positions are rough; an EKF's errors are smaller and change "
                    "slowly.",
        all_of(*by_axis("LS over EKF", ("main", "none/ls"), ("main", "none/ekf"), "all", (1.0, None)),
               correlation("LS, from epoch to epoch", ("main", "none/ls"), (None, 0.1)),
               correlation("EKF, from epoch to epoch", ("main", "none/ekf"), (0.5, None))),
        place="introduction", why="larger on each axis; next to no correlation in one, and much in the other", figure="figure_04",
        found="{0}, {1} and {2} times by axis; from one epoch to the next errors are correlated by {3:.3f} in LS and by {4:.3f} in "
              "the EKF.",
    ),
    statement(
        "ukf-better-than-ekf", "The UKF makes no error of linearization and is somewhat better than the EKF.", same,
        place="introduction; §UKF",
        why="below 1 on each axis, and by more than 1 %, which is no difference", expected="not reproduced", figure="figure_13",
        found="They are one filter: {0:.1g} m apart, {2:.0e} of the error even from 1 km. They part from some 10 km on: the EKF's "
              "median error after "
        "five epochs is {3:.2f} times the UKF's there, and {4:.0f} times from 100 km.",
    ),
    statement(
        "no-extra-computation", "The UKF needs no Jacobians and does not raise the computing load over the EKF.", load,
        place="introduction; §UKF", why="at most 10 % more in either way of running", expected="not reproduced",
        found="{0:.2f} times the EKF's time alone and {1:.2f} times in a batch of 100, where {2:.0f} evaluations are not hidden by "
              "Python.",
    ),
    statement(
        "transform-second-order", "Mean and covariance by the unscented transform are right to the second order at least.",
        all_of(of("transform", "mean", "mean of random quadratic maps, error", (None, 1e-12)),
               of("transform", "slope", "order in which the covariance's error vanishes", (3.5, None), np.min),
               of("polar", "error", "the drawn example: mean y, error", (None, 1e-4))),
        place="§UKF, Fig. 3", printed=2, why="quadratic maps: mean to rounding, covariance to the fourth power of the deviation",
        figure="figure_03",
        found="The mean is exact ({0:.0e}), the covariance's error vanishes in order {1:.2f}; the drawn example's mean is off by "
              "{2:.1e}.",
    ),
    statement(
        "ukf-sensitive", "The UKF suffers from wrong initial values and noise statistics: slow, less accurate, divergent.",
        sensitive,
        place="introduction; end of §UKF", why="twice the error for statistics within a factor 10 of the truth",
        expected="not reproduced", figure="figure_12",
        found="At most {0} times the error, and {1} times from ten times the initial error; {5:.0f} runs are lost. It is slow only "
              "from far: {9:.0f} epochs "
        "from 100 km, {11:.0f} and more from 1000 km.",
    ),
    statement(
        "geo-needs-rotation", "For geostationary satellites the node is singular and the usual formula fails; one more rotation is "
                              "all it takes.", rotation,
        place="§GEO, Fig. 2, Eqs. 1-2", why="the node's deviation grows without bound, the position's does not; right to 1 m",
        expected="in part", figure="figure_02",
        found="The usual formula errs by {5:.0f} to {6:.0f} km, its result rotated by {4:.0f} km after a minute: the node has to "
              "stay in space as well ({3:.0e} m).",
    ),
    statement(
        "a-is-identity", "While the noise is normal the adaptive matrix is the identity and does nothing.",
        all_of(*(average(f"mean of {half}", A, "quiet", (0.99, 1.01), HALVES[half]) for half in ("ranges", "rates")),
               *(average(f"part of {half}", A, "quiet", of=HALVES[half]) for half in ("ranges above 1", "rates above 1")),
               apart("change of the estimate, in its error", ("main", "none/aukf"), ("main", "none/ukf"), "quiet", (None, 0.01))),
        place="§AUKF, after Eq. 20", why="1 within 1 %, and estimates alike within 1 % of their error", expected="not reproduced",
        figure="figure_10",
        found="Clipped at 1, its mean is {0} on ranges and {1} on rates; {2} and {3} of its entries are above 1, and estimates "
              "change by {4:.2f} of their error.",
    ),
    statement(
        "system-noise-weakened", "Adapting the gain to residuals lessens the effect of wrong system noise.",
        all_of(*(over(f"process noise times {q:g}", ("wrong", f"near/Q {q:g}/aukf"), ("wrong", f"near/Q {q:g}/ukf"), "all",
                      (None, 1.0)) for q in (0.01, 0.1, 10.0)),
               over("from ten times the initial error", ("wrong", "far/aukf"), ("wrong", "far/ukf"), "all")),
        place="introduction; §AUKF", why="smaller than the UKF's for every wrong process noise", expected="not reproduced",
        figure="figure_12",
        found="The opposite: too small a process noise costs {0} and {1} times the UKF's error, as the turn is taken for noise; "
              "too large a one {2} times.",
    ),
    statement(
        "several-outliers",
        "If noise jumps only its entry grows; even with several bad values the result stays comparatively accurate.",
        all_of(*(n for k in ("1", "3", "8") for w in ("first", "burst") for n in outliers(k, w, ((None, SAME_ORDER), (None, 1.0)))),
               *(n for w in ("first", "burst") for n in outliers("15", w, ((None, None), (None, None))))),
        place="§AUKF, last paragraph", why="the same order as without, and better than the UKF, for up to half of the ranges",
        figure="figure_11",
        found="Ten seconds in 1, 3 and 8 of 15 ranges: {2}, {6} and {10} times its own quiet error; in all of them {14}. Single "
              "epochs: {0}, {4}, {8} and {12}.",
    ),
    statement(
        "clearly-better-quiet", "Without disturbance the AUKF is clearly more accurate than UKF and EKF.",
        tiers(reproduced=[*undisturbed(share=True), *undisturbed()], in_part=undisturbed()),
        place="text on Figs 4-6", why="one run is shown: better in 95 % of runs on each axis", expected="in part",
        figure="figure_04",
        found="Better, not clearly: {3}, {4} and {5} of the UKF's error, in {0:.2f}, {1:.2f} and {2:.2f} of the runs; a side "
              "effect of clipping at 1.",
    ),
    statement(
        "table-1-order", "In every entry of the table AUKF is better than EKF and UKF.",
        all_of(*undisturbed(strict=False), apart("EKF and UKF", ("main", "none/ekf"), ("main", "none/ukf"), "all", (None, 1e-3))),
        place="text on Table 1",
        why="below 1 on each axis, against both, which are one filter", figure="figure_04",
        found="{0}, {1} and {2} of the UKF's error by axis; the EKF's differs from that by {3:.0e}. The table's numbers are lost.",
    ),
    statement(
        "burst-suppressed",
        "With noise of deviation 50 added from 60 to 70 s AUKF suppresses the disturbance better and is robust.",
        tiers(reproduced=[n for reading in READINGS for n in suppressed(reading)], in_part=suppressed("ranges, 10 Hz")),
        place="text on Figs 7-9", printed=[60, 70, 0, 50],
        why="better on each axis, and of the order of its own quiet error; channels and rate are not printed",
        expected="in part", figure="figure_07",
        found="On ranges at 10 Hz {0} of the UKF's error, {1} of its own quiet one; on rates too {5} and {6}; on one range {10}. "
              "At 1 Hz the window is as "
        "long as the burst: {15}, {20} and {25} of the UKF's.",
    ),
    statement(
        "fast-recovery", "AUKF removes the effect of a jump of the noise quickly.",
        tiers(reproduced=[n for reading in READINGS for n in recovery(reading)], in_part=recovery("ranges, 10 Hz")),
        place="text on Figs 7-9", why="sooner and smaller than the UKF, and within the length of the disturbance",
        expected="in part", figure="figure_07",
        found="After a burst on ranges at 10 Hz in {0} s, {1} of the UKF's time, with {2} of its error; on rates too in {3} s "
              "({4}), at 1 Hz in {9} s ({10}).",
    ),
    statement(
        "faster-convergence", "AUKF converges faster than EKF and UKF.", converges, place="text on Figs 7-9; conclusion",
        why="sooner in one case and later in none, in the median of 200 runs", expected="not reproduced", figure="figure_13",
        found="Later by up to {0} epochs: large innovations of the start are taken for noise. It is sooner than the EKF from 100 "
              "km ({1}), as the UKF is.",
    ),
]  # fmt: skip
OTHERS = [
    Row("erratum", "erratum-editorial", "A wrong character in pseudorange throughout; V and W, then w and v for the two noises.",
        place="throughout"),
    Row("reconstruction", "recon-adaptive",
        "The adaptive matrix: mean squares of the last M innovations less what the state explains, over R, clipped at 1.",
        place="Eqs. 12-20"),
    Row("reconstruction", "erratum-6-worse", "Points are drawn anew for the measurement: else the gain lacks the process noise.",
        all_of(over("quiet RMSE without over with", ("redraw", "none/no redraw"), ("redraw", "none/ukf"), "quiet", (5.0, None)),
               average("NEES without", ("redraw", "none/no redraw/nees"), "quiet", (80.0, None)),
               average("NIS without, truth from the model (30 if consistent)", ("matched", "1 Hz/no redraw/nis"), "all",
                       (50.7, 62.1))),
        place="Eqs. 3-11", found="Without, the error is {0} times as large, and NEES {1} where 8 is consistent.",
        figure="figure_11"),
    Row("reconstruction", "recon-geo", "Geostationary satellites: one more rotation, and a node that does not turn with the Earth.",
        all_of(of("orbits", "right", "against two bodies in space, m", (None, 1.0))), place="Eqs. 1-2",
        found="Right to {0:.0e} m."),
    Row("reconstruction", "recon-table-1", "Table 1: its numbers are lost; ours stand in their place.", place="Table 1"),
    remark("erratum-8-channels",
           "Fifty has neither unit nor channel: on ranges alone the rates carry the filter, on both nothing does.",
           all_of(over("AUKF in the burst, on ranges and rates over on ranges", ("baselines", "both/aukf"),
                       ("baselines", "ranges/aukf"), "burst", (10.0, None))),
           place="text on Figs 7-9", found="{0} times the error."),
    remark("remark-unsaid", "Adaptive fading here inflates the noise of the measurement; fading means that of the prediction. "
           "Rate, M, Q, R and alpha are not given, one run is shown, and least squares is no row of Table 1.", place="throughout"),
]  # fmt: skip
FINDINGS = [
    finding("baselines-group-ranges",
            "A factor from what no position explains (group parity) needs no window, is as good in the burst, better on rates too.",
            all_of(over("burst on ranges, over AUKF", ("main", "ranges/group"), ("main", "ranges/aukf"), "burst", (None, 1.1)),
                   over("on rates too, in it", ("baselines", "both/group"), ("baselines", "both/aukf"), "burst", (None, 1.1)),
                   over("on rates too, after it", ("baselines", "both/group"), ("baselines", "both/aukf"), "after", (None, 0.5))),
            found="{0} of the AUKF's error, {1} with the rates and {2} after it.", figure="figure_11"),
    finding("baselines-group-one", "On one range it inflates everybody: there a factor of each channel is better.",
            all_of(over("over AUKF", ("baselines", "one/group"), ("baselines", "one/aukf"), "burst", (1.1, None))),
            found="{0} of the AUKF's error.", figure="figure_11"),
    finding("figure-7b-gate",
            "A gate locks itself out where ranges and rates are struck, and loses to no gate where R is too small.",
            all_of(level("burst on ranges and rates, m", ("baselines", "both/gate"), "burst", (100.0, None)),
                   over("mistuned, over UKF", ("baselines", "mistuned/gate"), ("baselines", "mistuned/ukf"), "all", (1.0, None))),
            found="{0:.0f} m, and {1} times the UKF's error.", figure="figure_11"),
    finding("erratum-4-aukf",
            "With little process noise the AUKF takes the turn for noise and diverges by kilometers, where the EKF is at its best.",
            all_of(level("AUKF, m", noise(0.1, 1.0, "aukf"), "quiet", (1e3, None)),
                   level("EKF, m", noise(0.1, 1.0, "ekf"), "quiet", (None, 1.0))),
            found="{0:.0f} m for the AUKF and {1} m for the EKF.", figure="figure_12"),
    finding("figure-4-mistuned", "Where ranges are noisier than assumed the gap that the paper shows appears.",
            all_of(over("10 m for 3 m", ("disturbed", "mistuned/aukf"), ("disturbed", "mistuned/ukf"), "all", (None, 0.85))),
            found="{0} of the UKF's error.", figure="figure_04"),
    finding("windows-10hz-1", "The window has to be shorter than the burst, and longer than one epoch.",
            all_of(*(over(f"M = {M}", window("default", M), window("default", 3), "late", (1.05, None)) for M in (1, 50, 100)),
                   over("1 Hz, M = 10 over UKF", window("1 Hz", 10), window("1 Hz", 10, "ukf"), "late", (0.75, 1.25))),
            found="{0}, {1} and {2} times the error with 1, 50 and 100 epochs for 3.", figure="figure_13"),
    finding("start-ahead", "The UKF's only merit is its start from 100 km and more; an EKF from the first fix needs none.",
            lambda r: [Number("EKF over UKF from 1000 km after epoch 5", ahead(r, 1e3), (2.0, None)),
                       Number("EKF from a fix, m, worst", float(max(medians(r, km, "from a fix")[0] for km in INITIAL_KM)),
                              (None, 10.0))],
            found="{0:.0f} times the UKF's median error; {1:.1f} m.", figure="figure_13"),
    finding("matched-bound-ukf",
            "With truth from the filters' own model UKF and EKF are consistent and reach the Cramér-Rao bound; AUKF does not.",
            all_of(*(over_bound(name, accept) for name, accept in BOUND.items())),
            found="{1} of the bound for the UKF, {2} for the AUKF, {5} without drawing anew."),
]  # fmt: skip
CHECKS = [
    check("figure-7-factor", "Mean factor of the ranges in the burst, where 279 are right",
          average("A", ("main", "ranges/aukf/factor"), "burst", (220.0, 310.0), HALVES["ranges"])),
    check("process-default-nis", "NIS of the EKF with the turn's process noise (30 if consistent)",
          average("NIS", ("main", "none/ekf/nis"), "quiet", (27.0, 28.8))),
    check("process-none-lost", "Largest quiet error of the AUKF in any run (m)",
          peak("m", ("main", "none/aukf"), "quiet", (None, 3.0))),
    check("process-group", "Group parity does not mind: over the EKF, by process noise",
          all_of(*(over(f"{T:g} s, {q:g}", noise(T, q, "group"), noise(T, q, "ekf"), "quiet", (0.97, 1.03))
                   for T in PROCESS_NOISE for q in PROCESS_NOISE[T]))),
    check("process-nis", "NIS of the EKF (30 if consistent) falls with the process noise: 180 and 26.7 by a prototype",
          all_of(average("1", noise(0.1, 1.0, "ekf/nis"), "quiet", (171.0, 189.0)),
                 average("1000", noise(0.1, 1e3, "ekf/nis"), "quiet", (25.5, 27.9)))),
    check("process-factor", "The turn is read as noise of the rates: mean factor, 6800 by a prototype",
          all_of(average("A", noise(0.1, 10.0, "aukf/factor"), "quiet", (4800.0, 8800.0), HALVES["rates"]))),
    check("matched-nees-ukf", "NEES of the UKF, truth from the model (8 if consistent)",
          average("NEES", ("matched", "1 Hz/ukf/nees"), "all", (7.4, 8.6))),
    check("matched-nis-ekf", "NIS of the EKF, truth from the model (30 if consistent)",
          average("NIS", ("matched", "1 Hz/ekf/nis"), "all", (29.1, 30.3))),
    check("start-same", "From 1 km EKF and UKF are as fast: difference of medians after epoch 5 (part)",
          lambda r: Number("part", abs(ahead(r, 1.0) - 1.0), (None, 0.05))),
]  # fmt: skip
CHECKS += [check(f"real-{id}", f"Real receiver: {text}", real_number(i, accept), needs="real")
           for i, (id, (text, accept)) in enumerate(day.JUDGED.items())]  # fmt: skip
STUDY = Study(
    "aukf", (*GROUPS, *AXES), trial, parts, [*STATEMENTS, *OTHERS, *FINDINGS, *CHECKS],
    says="A UKF that adapts its measurement noise to the last innovations has smaller errors than EKF and UKF, converges faster, "
    "and hardly notices a burst of noise.",
    found="In a burst on the ranges at 10 Hz it has a tenth of the UKF's error, and recovers at once. Without one it gains a few "
    "percent, from clipping. EKF and UKF are the same. It takes maneuvers and wrong process noise for measurement noise, "
    "converges later from far away, and can err by kilometers; a factor made of what no position explains needs no window "
    "and does not.",
)  # fmt: skip
