"""Short runs that compare filters with each other and with exact ones: identities, degenerate cases, sensitivity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter
from celnav.filters.run import run
from celnav.filters.sequential import ukf
from celnav.gaussian import attitude
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.models.gyro import Gyro
from celnav.papers.ssukf.config import ARCSEC, UNITS, Config
from celnav.papers.ssukf.errata import printed_spread
from celnav.papers.ssukf.scenario import (
    Scenario,
    dynamics,
    errors,
    family,
    filters,
    noise_root,
    repeated,
    simulate,
    spread,
    star,
    star_sensor,
    state_space,
)
from celnav.papers.ssukf.variants import dense_filters, to_tangent, total_filters, total_prior
from celnav.study.montecarlo import generator, normals

SPREADS = (15.0, 7.0, 0.15)
"""Spreads ``c`` at which AUKF and SSUKF are compared."""
ALPHAS = (1.0, 0.1, 0.01, 1e-3, 1e-4)
PRIORS_DEG = (180.0, 90.0, 30.0, 10.0, 5.0, 1.0, 0.1, 20.0 / 3600.0)
"""Deviations of the attitude's prior, each axis; the true error is that of the paper."""
TURNS_DEG = (10.0, 30.0, 60.0, 90.0, 120.0, 150.0, 179.0)
"""Initial errors about one axis."""
LARGE = ("aukf", "ssukf", "usque", "mekf")
COMPARED = ("aukf", "ssukf", "additive", "usque", "mekf")
"""Compared with the exact linear filter."""
Runs = Sequence[np.random.Generator]


def _means(filter: Filter, prior: Gaussian, scenario: Scenario) -> Array:
    """Estimates ``(T, runs, 7)`` at the star epochs."""
    every = len(scenario.gyro) // (len(scenario.truth) - 1)
    mean = run(filter, prior, scenario.epochs(), keep="mean", every=every).mean
    assert mean is not None
    return mean


def apart(a: Array, b: Array) -> Array:
    """Largest differences of each run after the first star sample, ``(2, runs)``: of attitude (arcsec) and of drift (deg/h)."""
    difference = np.abs(errors(a[1:], b[1:])) / UNITS
    return np.stack([difference[..., :3].max((0, 2)), difference[..., 3:].max((0, 2))])


def identities(config: Config, rngs: Runs) -> dict[str, Array]:
    """Filters that must be one, at the gyro's full rate: differences ``(2, runs)`` as `apart` gives them.

    In square-root form, since the first star sample takes eight digits off a covariance; that form is compared too.
    """
    sim = simulate(replace(config, preintegrated=False), rngs)

    def all_of(names: Sequence[str], c: float | None, alpha: float = 0.1, form: str = "square root") -> dict[str, Array]:
        known = filters(replace(sim.config, alpha=alpha), c=c, form=form)
        return {name: _means(known[name], sim.prior, sim) for name in names}

    out = {}
    for c in SPREADS:
        others = {15.0: ("aukf-1", "additive"), 7.0: ("usque",)}.get(c, ())
        means = all_of(("aukf", "ssukf", *others), c)
        for name in means:
            if name != "aukf":
                out[f"{name}, c = {c:g}"] = apart(means["aukf"], means[name])
    for alpha in (1.0, 0.1):
        means = all_of(("aukf", "ssukf"), None, alpha)
        out[f"ssukf, alpha = {alpha:g}"] = apart(means["aukf"], means["ssukf"])
    means = all_of(("aukf", "ssukf"), 15.0, form="covariance")
    out["ssukf, covariance form"] = apart(means["aukf"], means["ssukf"])
    return out


def rates(config: Config, rngs: Runs) -> dict[str, Array]:
    """The paper's 100 Hz against 4 Hz on the same samples: differences ``(2, runs)``, and errors ``(T, runs, 6)`` at 100 Hz."""
    full = simulate(replace(config, preintegrated=False), rngs)
    few = full.integrated()
    out: dict[str, Array] = {}
    for name in ("aukf", "ssukf"):
        many = _means(filters(full.config)[name], full.prior, full)
        out[f"{name}/apart"] = apart(many, _means(filters(few.config)[name], few.prior, few))
        out[f"{name}/error"] = errors(full.truth, many) / UNITS
    return out


def variants(config: Config, rngs: Runs) -> dict[str, Array]:
    """Other forms of the filters at the star's rate: differences ``(2, runs)``."""
    sim = simulate(config, rngs)
    known = filters(sim.config)
    plain = {name: _means(known[name], sim.prior, sim) for name in ("aukf", "ssukf")}
    dense = {name: _means(filter, sim.prior, sim) for name, filter in dense_filters(config).items()}
    total = {name: _means(filter, total_prior(sim.prior), sim) for name, filter in total_filters(config).items()}
    moved = _means(filters(config, transported=True)["ssukf"], sim.prior, sim)
    return {
        "dense aukf": apart(plain["aukf"], dense["aukf"]),
        "dense ssukf": apart(plain["ssukf"], dense["ssukf"]),
        "total": apart(total["aukf-total"], total["ssukf-total"]),
        "total to local": apart(plain["ssukf"], total["ssukf-total"]),
        "total to local, first": apart(plain["ssukf"][:2], total["ssukf-total"][:2]),
        "transported": apart(plain["ssukf"], moved),
        "as printed": apart(plain["aukf"], _means(_as_printed(config), sim.prior, sim)),
    }


def alphas(config: Config, rngs: Runs) -> dict[str, Array]:
    """SSUKF with `ALPHAS` against that of the configuration: differences ``(2, runs)``."""
    sim = simulate(config, rngs)
    means = {alpha: _means(filters(replace(config, alpha=alpha))["ssukf"], sim.prior, sim) for alpha in ALPHAS}
    return {f"{alpha:g}": apart(means[config.alpha], mean) for alpha, mean in means.items() if alpha != config.alpha}


def _as_printed(config: Config) -> Filter:
    """AUKF whose scaling is that of the paper."""
    return filters(config, c=printed_spread(15, config.alpha))["aukf"]


def total_covariance(config: Config, rng: np.random.Generator) -> float:
    """Largest difference, in deviations, of the total form's covariance in the tangent space from the local one at the end."""
    sim = simulate(config, [rng])
    every = [run(filter, prior, sim.epochs(), keep="cov") for filter, prior in (
        (filters(config)["ssukf"], sim.prior), (total_filters(config)["ssukf-total"], total_prior(sim.prior)),
    )]  # fmt: skip
    assert every[1].mean is not None
    G = to_tangent(every[1].mean[-1][..., :4])
    local, total = every[0].cov[-1], G @ every[1].cov[-1] @ G.mT
    scale = np.sqrt(local.diagonal(0, -2, -1))
    return float((np.abs(total - local) / (scale[..., :, None] * scale[..., None, :])).max())


def priors(config: Config, rngs: Runs) -> dict[str, Array]:
    """SSUKF from priors of `PRIORS_DEG`: errors ``(T, runs, 6)``, arcsec and deg/h."""
    sim = simulate(config, rngs)
    sigma = np.repeat(np.radians(PRIORS_DEG), len(rngs))
    deviation = np.stack([*[sigma] * 3, *[np.full_like(sigma, config.sigma0[3])] * 3], -1)
    count = len(PRIORS_DEG)
    wide = repeated(sim, count)
    prior = Gaussian(wide.prior.mean, np.square(deviation)[..., None] * np.eye(6))
    error = errors(wide.truth, _means(filters(config)["ssukf"], prior, wide)) / UNITS
    return {f"{s:g}": part for s, part in zip(PRIORS_DEG, np.split(error, count, 1), strict=True)}


def turns(config: Config, rngs: Runs) -> dict[str, Array]:
    """Initial errors of `TURNS_DEG`, told to the prior: errors ``(T, runs, 3)`` arcsec, ``<filter>/<deg>``."""
    sim, count = simulate(config, rngs), len(TURNS_DEG)
    wide = repeated(sim, count)
    size = np.radians(np.repeat(TURNS_DEG, len(rngs)))[:, None]
    turned = attitude.exp(-size * np.array([0.48, 0.6, 0.64]))
    mean = np.concatenate([attitude.multiply(turned, wide.truth[0][:, :4]), wide.prior.mean[:, 4:]], -1)
    deviation = np.concatenate([np.tile(size, 3), np.full((len(size), 3), config.sigma0[3])], -1)
    prior = Gaussian(mean, np.square(deviation)[..., None] * np.eye(6))
    known, out = filters(config), {}
    for name in LARGE:
        error = errors(wide.truth, _means(known[name], prior, wide))[..., :3] / ARCSEC
        for degrees, part in zip(TURNS_DEG, np.split(error, count, 1), strict=True):
            out[f"{name}/{degrees:g}"] = part
    return out


def linear(config: Config, rngs: Runs) -> dict[str, Array]:
    """A satellite at rest and errors of an arc minute: differences ``(2, runs)`` from the exact linear Kalman filter."""
    c, gyro = config, config.gyro
    T, dt = c.star_epochs + 1, 1.0 / c.star_hz
    initial, white, walk, star = normals(rngs, (6,), (T - 1, 3), (T - 1, 3), (T, 3))
    deviation = np.concatenate([np.full(3, 60.0 * ARCSEC), c.sigma0[3:]])
    drift = [deviation[3:] * initial[:, 3:]]
    for k in range(T - 1):
        drift.append(gyro.factor(dt) * drift[-1] + gyro.drift_std(dt) * walk[k])
    q = np.broadcast_to(attitude.IDENTITY, (T, len(rngs), 4))
    samples = gyro.measure(q, np.array(drift), white, dt)
    turned = c.sigma_n * star
    stars = attitude.exp(turned)
    stars[0] = np.nan
    truth = np.concatenate([q, drift], -1)
    start = -deviation[:3] * initial[:, :3]
    prior = Gaussian(np.concatenate([attitude.exp(start), np.zeros_like(start)], -1), np.diag(deviation**2))
    sim = Scenario(replace(c, preintegrated=True), truth, samples, stars, prior, prior)

    def f(x: Array, epoch: Epoch) -> Array:
        return np.concatenate([x[..., :3] + (epoch.u - x[..., 3:]) * epoch.dt, gyro.factor(dt) * x[..., 3:]], -1)

    H = np.hstack([np.eye(3), np.zeros((3, 3))])
    exact = ukf(Motion(f, gyro.process_noise(dt)), Sensor(H, sqrt_R=c.sigma_n * np.eye(3)), form="covariance")
    epochs = [Epoch(k, k * dt, dt if k else 0.0, samples[k - 1] if k else None, turned[k] if k else None) for k in range(T)]
    belief = Gaussian(np.concatenate([start, np.zeros_like(start)], -1), np.diag(deviation**2))
    flat = run(exact, belief, epochs, keep="mean").mean
    assert flat is not None
    reference = np.concatenate([attitude.exp(flat[..., :3]), flat[..., 3:]], -1)
    known = filters(sim.config)
    return {name: apart(reference, _means(known[name], prior, sim)) for name in COMPARED}


def dead_points(config: Config) -> tuple[int, int]:
    """Points of the AUKF that are the center over again, of 31: in the prediction and in the update."""
    sim = simulate(replace(config, duration_s=1.0 / config.star_hz), generator(0, 0, 0))
    epoch = list(sim.epochs())[-1]
    extra = (noise_root(config.gyro, config.step_s), config.sigma_n * np.eye(3))
    x, *noise = spread(15, config).points(sim.prior.mean, sim.prior.sqrt_cov, state_space(), extra)
    moved = dynamics(config.gyro)(x, epoch, *noise)
    seen = np.concatenate([star(x, epoch, *noise), x], -1)
    time, measured = (int((y[1:] == y[0]).all(-1).sum()) for y in (moved, seen))
    return time, measured


def evaluations(config: Config) -> dict[str, tuple[int, int]]:
    """Evaluations of ``f`` and ``h`` of each filter, counted, from one star sample to the next, at the configuration's rates."""
    count = {"f": 0, "h": 0}

    class Counting(Gyro):
        def propagate(self, x: Array, measured: Array, dt: float, rate_noise: Array | float = 0.0) -> Array:
            count["f"] += len(x)
            return super().propagate(x, measured, dt, rate_noise)

    sensor = star_sensor(config)

    def h(x: Array, epoch: Any, *noise: Array) -> Array:
        count["h"] += len(x)
        return np.asarray(sensor.h(x, epoch, *noise))

    gyro = Counting(config.gyro.sigma_v, config.gyro.sigma_u, config.gyro.tau)
    known = family(gyro, config.step_s, sensor._replace(h=h), lambda L: spread(L, config))
    sim = simulate(replace(config, duration_s=1.0 / config.star_hz), generator(0, 0, 0))
    out = {}
    for name in ("aukf", "ssukf", "additive", "mekf"):
        count.update(f=0, h=0)
        run(known[name], sim.prior, sim.epochs(), keep="nothing")
        out[name] = count["f"], count["h"]
    return out
