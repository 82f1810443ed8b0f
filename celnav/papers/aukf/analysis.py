"""What needs no Monte Carlo of filters: geometry, the unscented transform, nodes of flat orbits, times of a step."""

from __future__ import annotations

from dataclasses import replace
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch
from celnav.filters.run import run
from celnav.filters.sequential import sigma_point
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import unscented
from celnav.models import pseudorange
from celnav.models.beidou import LIGHT, ROTATION_RATE, satellites
from celnav.papers.aukf.config import Config
from celnav.papers.aukf.constellation import synthetic
from celnav.papers.aukf.errata import clipped_mean
from celnav.papers.aukf.real import as_others
from celnav.papers.aukf.scenario import EKF, START_S, TOE_S, axes, circle, filters, sensor, simulate, ukf, visible
from celnav.receiver.sky import Dilution, dilution
from celnav.study.montecarlo import generator

INCLINATIONS_DEG = (55.0, 10.0, 1.0, 0.1, 0.01)
NORMAL_ERROR = 1e-4
"""rad, of an orbit's normal, in each direction across it."""
POLAR = (1.0, np.radians(90.0))
POLAR_STD = (0.02, np.radians(15.0))


class Nodes(NamedTuple):
    """Deviation of the node (deg) by inclination: by the formula, and of draws."""

    formula: Array
    drawn: Array


def nodes(rng: np.random.Generator, draws: int = 200_000) -> Nodes:
    """How well the node is known when the orbit's normal is, to `NORMAL_ERROR`."""
    i = np.radians(INCLINATIONS_DEG)
    along, across = NORMAL_ERROR * rng.standard_normal((2, draws, 1))
    # With the node on the x axis the normal is (0, -sin i, cos i); errors lie along the node and up the slope.
    x, y = along, -np.sin(i) - across * np.cos(i)
    return Nodes(np.degrees(NORMAL_ERROR / np.sin(i)), np.degrees(np.sqrt(np.square(np.arctan2(x, -y)).mean(0))))


class Moments(NamedTuple):
    """Mean and deviations ``(2,)`` of a Cartesian position: by the unscented transform, exactly or by draws, linearized."""

    points: Array
    images: Array
    drawn: Array
    unscented_mean: Array
    unscented_std: Array
    exact_mean: Array
    drawn_std: Array
    linear_mean: Array
    linear_std: Array


def polar(rng: np.random.Generator, draws: int = 1_000_000) -> Moments:
    """From polar to Cartesian coordinates: the textbook's example of an unscented transform."""
    rule, mean, std = unscented(2, 1.0, 0.0, 1.0), np.array(POLAR), np.array(POLAR_STD)
    points = mean + rule.nodes * std
    samples = _cartesian(mean + std * rng.standard_normal((draws, 2)))
    images = _cartesian(points)
    middle = rule.wm @ images
    spread = np.sqrt(rule.wc @ np.square(images - middle))
    shrunk = np.exp(-0.5 * std[1] ** 2)
    exact = shrunk * _cartesian(mean)
    linear = np.abs(np.array([mean[0] * std[1], std[0]]))
    return Moments(points, images, samples[:2000], middle, spread, exact, samples.std(0), _cartesian(mean), linear)


def _cartesian(polar: Array) -> Array:
    r, theta = polar[..., 0], polar[..., 1]
    return np.stack([r * np.cos(theta), r * np.sin(theta)], -1)


class Geometry(NamedTuple):
    """Of the track: visible satellites and their kinds, DOP ``(T,)``, and what a simpler model would be wrong by."""

    names: list[str]
    geostationary: int
    inclined: int
    dilution: Dilution
    turn_m: float
    rate_error: float
    misplaced_m: Array


def geometry(config: Config) -> Geometry:
    """See `Geometry`. ``turn_m``: by the turn of the Earth while a signal travels. ``rate_error`` (m/s): against differences."""
    seen, (position, velocity) = visible(config), circle(config)
    broadcast = synthetic(TOE_S)
    own = broadcast.chosen(broadcast.geostationary)
    t = START_S + config.times[:: max(1, round(10.0 / config.interval_s))]
    misplaced = np.concatenate([np.linalg.norm(as_others(own, s) - satellites(own, s).position, axis=-1) for s in t])
    used = broadcast.chosen(np.isin(broadcast.names, seen.names))
    away = seen.q - position[:, None]
    distance = np.linalg.norm(away, axis=-1)
    turn = ROTATION_RATE / LIGHT * (seen.q[..., 0] * position[:, None, 1] - seen.q[..., 1] * position[:, None, 0])
    step, k = 0.5, len(config.times) // 2
    around = [_range(used, START_S + config.times[k] + s, position[k] + s * velocity[k]) for s in (-step, step)]
    rate = (away[k] / distance[k][:, None] * (seen.w[k] - velocity[k])).sum(-1)
    return Geometry(
        seen.names,
        int(used.geostationary.sum()),
        sum(name in ("C38", "C39", "C40") for name in seen.names),
        dilution(seen.q, position, axes(config)),
        float(np.abs(turn).max()),
        float(np.abs((around[1] - around[0]) / (2.0 * step) - rate).max()),
        misplaced,
    )


def _range(broadcast: Any, t: float, position: Array) -> Array:
    return np.asarray(np.linalg.norm(pseudorange.sources(broadcast, t, position).q - position, axis=-1))


def curvature(config: Config, away_m: float) -> float:
    """What the linearized range is wrong by (m) when the position is off by so much across it: largest of all satellites."""
    seen, (position, _) = visible(config), circle(config)
    sight = seen.q[0] - position[0]
    distance = np.linalg.norm(sight, axis=-1)
    # Exact: sqrt(d^2 + s^2) - d, without its cancellation.
    return float((away_m**2 / (np.sqrt(distance**2 + away_m**2) + distance)).max())


TIMED = ("ekf", "ukf", "aukf", "group", "huber")


def evaluations(config: Config) -> dict[str, int]:
    """How many points the measurement is evaluated at in an update of EKF and UKF, counted."""
    sim, out = simulate(replace(config, duration_s=config.interval_s), [generator(0, 97, 0)]), {}
    epoch, S = next(iter(sim.epochs())), len(sim.satellites.names)
    rules: dict[str, Any] = {"ekf": EKF, "ukf": ukf(config)}
    for name, rule in rules.items():
        asked: list[int] = []

        def counting(x: Array, epoch: Epoch, asked: list[int] = asked) -> Array:
            asked.append(len(x))
            return pseudorange.measure(x, *epoch.u)

        seen = Sensor(counting, np.diag(config.sigma(S) ** 2), jacobian=sensor(config.sigma(S)).jacobian)
        counted = sigma_point(Motion(config.F, config.Q), seen, rule=rule, form="covariance")
        counted.update(counted.start(sim.prior), epoch)
        out[name] = sum(asked)
    return out


def step_times(config: Config) -> dict[str, float]:
    """CPU seconds of a step of `TIMED`: of one run alone, and of one run among 100."""
    out = {}
    short = replace(config, duration_s=10 * config.interval_s, burst="none")
    known = filters(short)
    for runs in (1, 100):
        sim = simulate(short, [generator(0, 98, r) for r in range(runs)])
        for name in TIMED:
            times = []
            for _ in range(3):
                start = process_time()
                run(known[name], sim.prior, sim.epochs(), keep="nothing")
                times.append((process_time() - start) / (len(sim.truth) * runs))
            out[f"step {name}, {runs} run{'s' if runs > 1 else ''}, s"] = min(times)
    return out


def facts(config: Config, seed: int) -> dict[str, Any]:
    """All of it, by name; ``clipped``: by how much a clipped mean of M squares exceeds 1."""
    return {
        "nodes": nodes(generator(seed, 50, 0)),
        "polar": polar(generator(seed, 51, 0)),
        "geometry": geometry(config),
        "curvature": {away: curvature(config, away) for away in (10.0, 1e3, 1e5)},
        "evaluations": evaluations(config),
        "clipped": {M: clipped_mean(M) for M in (5, 10, 30)},
    }
