"""A scenario that does separate the filters: one unit vector, of a magnetic field, instead of the whole attitude."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from celnav.filters.records import Epoch, Filter
from celnav.filters.run import run
from celnav.gaussian import attitude
from celnav.gaussian.belief import Gaussian, nees
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import unscented
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.papers.ssukf.config import DEG_PER_H, Config
from celnav.papers.ssukf.scenario import Sensing, errors, family, start
from celnav.study.montecarlo import normals

PRIORS_DEG = (10.0, 30.0, 60.0)
"""Deviations of the initial attitude, each axis."""
STEP_S, STEPS, RUNS = 1.0, 1000, 40
NOISE = np.radians(0.2)
"""rad, on each axis of the measured unit vector."""
INCLINATION = np.radians(60.0)
FILTERS = ("mekf", "mekf, transported", "usque", "usque, transported", "ssukf", "aukf")
Run = dict[str, Array]


def field(t: float, rate: float) -> Array:
    """Direction ``(3,)`` of a dipole's field along the orbit, taken as inertial."""
    u = rate * t
    up = np.array([np.cos(u), np.sin(u) * np.cos(INCLINATION), np.sin(u) * np.sin(INCLINATION)])
    direction = 3.0 * up * up[2] - np.array([0.0, 0.0, 1.0])
    return np.asarray(direction / np.linalg.norm(direction))


def sensor(config: Config) -> Sensing:
    """The unit vector on body axes, with additive noise."""

    def h(x: Array, epoch: Epoch, *noise: Array) -> Array:
        seen = attitude.rotate(x[..., :4], field(epoch.t, config.orbit_rate_rad_per_s))
        return seen + noise[-1] if noise else seen

    def slope(x: Array, epoch: Epoch) -> Array:
        seen = attitude.rotate(x[..., :4], field(epoch.t, config.orbit_rate_rad_per_s))
        return np.concatenate([attitude.cross(seen), np.zeros((*seen.shape, 3))], -1)

    return Sensing(h, slope, NOISE * np.eye(3), EUCLIDEAN, EUCLIDEAN)


def filters(config: Config) -> dict[str, Filter]:
    """Those of `FILTERS`; the spread of the points is given by alpha = 1, kappa = 0, beta = 2 or as the name says."""

    def members(c: float | None = None, beta: float = 2.0, transported: bool = False) -> dict[str, Filter]:
        def rule(L: int) -> Any:
            return unscented(L, 1.0, beta, 0.0 if c is None else c - L)

        return family(config.gyro, STEP_S, sensor(config), rule, transported=transported)

    plain, moved = members(), members(transported=True)
    return {
        "mekf": plain["mekf"],
        "mekf, transported": moved["mekf"],
        "usque": plain["usque"],
        "usque, transported": moved["usque"],
        "ssukf": plain["ssukf"],
        "ssukf, c = 15": members(15.0)["ssukf"],
        "ssukf, c = 7": members(7.0, 0.0)["ssukf"],
        "aukf": plain["aukf"],
    }


def epochs(config: Config, rngs: Sequence[np.random.Generator], steps: int) -> tuple[Gaussian, list[Epoch]]:
    """Prior and epochs; the runs of `PRIORS_DEG` lie one after the other, on the same random numbers."""
    c, gyro, count = config, config.gyro, len(PRIORS_DEG)
    initial, white, walk, noise = normals(rngs, (6,), (steps, 3), (steps, 3), (steps + 1, 3))
    q = c.body.propagate(start(c), STEP_S, steps)[:, None, :4]
    drift = np.empty((steps + 1, len(rngs), 3))
    drift[0] = c.prior_drift_deg_per_h * DEG_PER_H * initial[:, 3:]
    for k in range(steps):
        drift[k + 1] = gyro.factor(STEP_S) * drift[k] + gyro.drift_std(STEP_S) * walk[k]
    samples = gyro.measure(q, drift, white, STEP_S)
    fields = np.stack([field(STEP_S * k, c.orbit_rate_rad_per_s) for k in range(steps + 1)])[:, None]
    seen = attitude.rotate(q, fields) + NOISE * noise
    sigma = np.radians(np.repeat(PRIORS_DEG, len(rngs)))[:, None]
    error = sigma * np.tile(initial[:, :3], (count, 1))
    mean = np.concatenate([attitude.multiply(attitude.inverse(attitude.exp(error)), q[0]), np.zeros((len(error), 3))], -1)
    deviation = np.concatenate([np.tile(sigma, 3), np.full_like(error, c.prior_drift_deg_per_h * DEG_PER_H)], -1)
    prior = Gaussian(mean, np.square(deviation)[..., None] * np.eye(6))
    truth = np.concatenate([np.broadcast_to(q, (*drift.shape[:2], 4)), drift], -1)
    listed = [Epoch(0, 0.0, 0.0, None, np.full((len(mean), 3), np.nan), np.tile(truth[0], (count, 1)))]
    for k in range(1, steps + 1):
        parts = (np.tile(part, (count, 1)) for part in (samples[k - 1], seen[k], truth[k]))
        u, z, x = parts
        listed.append(Epoch(k, k * STEP_S, STEP_S, u, z, x))
    return prior, listed


def compare(
    config: Config, rngs: Sequence[np.random.Generator], names: Sequence[str] = FILTERS, steps: int = STEPS
) -> dict[str, Array]:
    """Total attitude error (deg) and NEES of each filter, ``<filter>/<prior>/error`` and ``.../nees``, both ``(T, runs)``."""
    prior, listed = epochs(config, rngs, steps)
    known = filters(config)

    def also(epoch: Epoch, state: Any, info: Any) -> Run:  # noqa: ARG001
        error = errors(epoch.truth, state.belief.mean)
        return {"error": np.degrees(np.linalg.norm(error[..., :3], axis=-1)), "nees": nees(error, state.belief.sqrt_cov)}

    out: dict[str, Array] = {}
    for name in names:
        extra = run(known[name], prior, listed, keep="nothing", also=also, on_failure="flag").extra
        for key, values in extra.items():
            for degrees, part in zip(PRIORS_DEG, np.split(values, len(PRIORS_DEG), 1), strict=True):
                out[f"{name}/{degrees:g}/{key}"] = part
    return out
