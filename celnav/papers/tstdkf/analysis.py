"""What needs no Monte Carlo: geometry, ephemerides, and what covariances say along the nominal orbit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.two_stage import TwoStage
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.models.pulsar import LIGHT_KM_S, pulsars
from celnav.papers.tstdkf import errata
from celnav.papers.tstdkf.config import DAY_S, SETTINGS, YEAR_S, Config, Setting
from celnav.papers.tstdkf.ephemerides import table
from celnav.papers.tstdkf.estimators import bias_prior, differencing, filters
from celnav.papers.tstdkf.forces import accelerations, spectrum
from celnav.papers.tstdkf.linear import LINEAR, epochs
from celnav.papers.tstdkf.scenario import noise_of, nominal_orbit, sky
from celnav.papers.tstdkf.sweeps import undifferenced

COLORS = (0.3, 0.5, 0.8, 0.9)
"""Coefficients F at which a differenced filter is compared with what is possible."""


def facts(config: Config) -> dict[str, Any]:
    """Everything that a `celnav.papers.tstdkf.study.Result` holds of it."""
    pulls = accelerations(config)
    month = replace(config, days=min(config.days, 30.0))
    return {
        "geometry": geometry(config),
        "fit": fit_residual(),
        "model error": model_error(config),
        "pulls": pulls,
        "spectrum": spectrum(np.asarray(sum(pulls.values()))[:-1], config.step_s),  # a whole month of samples
        "conjunctions": errata.conjunctions(config),
        "parallax": errata.parallax(config),
        "bounds": dict(zip(SETTINGS, bounds([replace(config, setting=setting) for setting in SETTINGS.values()]), strict=True)),
        "bias deviations": bias_deviations(replace(month, setting=SETTINGS[5])),
        "overconfidence": overconfidence(replace(config, days=min(config.days, 10.0)), COLORS),
        "lost correlation": lost_correlation(replace(config, days=min(config.days, 3.0))),
        "sensitivity": sensitivity(replace(config, days=min(config.days, 1.0), setting=SETTINGS[1])),
    }


class Geometry(NamedTuple):
    """At the start: satellite and Earth (km), direction of the first pulsar, its delay, and the delay's parts (km)."""

    satellite: Array
    earth: Array
    direction: Array
    delay: float
    roemer: float
    parallax: float
    shapiro: float


def geometry(config: Config) -> Geometry:
    """The first pulsar at the start (Fig. 1)."""
    timing, seen = config.timing, sky(replace(config, days=config.step_s / DAY_S))
    earth, sun = seen.earth[0], seen.sun[0]
    place = earth + config.orbit[:3]
    n, D, b = timing.directions[0], timing.distances[0], -sun
    cross = 2.0 * (n @ b) * (n @ place) - 2.0 * b @ place
    parallax = ((n @ place) ** 2 - place @ place + cross) / (2.0 * D)
    shapiro, delay = timing.shapiro(place, sun)[0], timing.delay(place, sun)[0]
    return Geometry(config.orbit[:3], earth, n, float(delay), float(n @ place), float(parallax), float(shapiro))


def fit_residual() -> Array:
    """RMS ``(3,)`` km of what a constant, a drift, a yearly and a half-yearly wave leave of DE405 - DE421 of the Earth."""
    days = np.asarray(table().dates.rest)
    t = (days - days[0]) * DAY_S / YEAR_S
    waves = [f(2.0 * np.pi * k * t) for k in (1, 2) for f in (np.sin, np.cos)]
    basis = np.stack([np.ones_like(t), t, *waves], 1)
    values = table().less_de421["de405"]["earth"]
    left = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return np.asarray(np.sqrt(np.square(left).mean(0)))


class ModelError(NamedTuple):
    """``Gamma delta r (T, 3)`` km; how far from the difference of delays at most; by how much Gamma's rows exceed 1 at most."""

    values: Array
    apart: float
    excess: float


def model_error(config: Config) -> ModelError:
    """What the ephemeris error makes of the timings (Fig. 6)."""
    orbit, seen, timing = nominal_orbit(config), sky(config), config.timing
    place, bias = seen.earth + orbit[:, :3], config.bias(config.step_s * np.arange(config.steps + 1))
    Gamma = timing.gradient(place, seen.sun)
    values = (Gamma @ bias[..., None])[..., 0]
    difference = timing.delay(place + bias, seen.sun) - timing.delay(place, seen.sun)
    excess = np.linalg.norm(Gamma, axis=2).max() - 1.0
    return ModelError(values, float(np.abs(difference - values).max()), float(excess))


def snapshot(config: Config) -> float:
    """Deviation (km) of a position from one timing of each pulsar."""
    rows = config.timing.directions / config.sigma_km[:, None]
    return float(np.sqrt(np.trace(np.linalg.pinv(rows.T @ rows))))


def timing_deviations(config: Config, seconds: float) -> Array:
    """Deviations (km) of the timings after so many seconds."""
    return LIGHT_KM_S * np.array([p.timing_std(seconds) for p in pulsars(config.pulsars)])


def _covariances(cases: Sequence[Config], name: str) -> Iterator[Any]:
    """States of a filter along the nominal orbit, of each case or one; covariances are the same whatever is measured."""
    filter, c, nothing = filters(cases, seen=LINEAR)[name], cases[0], np.zeros((len(cases), 3))
    state = filter.start(Gaussian(np.zeros((len(cases), 6)), np.diag(c.deviation**2)))
    for epoch in epochs(c):
        state, _ = filter.step(state, epoch._replace(z=nothing))
        yield state


def bounds(cases: Sequence[Config]) -> Array:
    """Posterior Cramer-Rao bounds of position (km), velocity (km/s) and bias (km), ``(cases, K, 3)``: the exact filter's."""
    std = np.stack([np.atleast_2d(state.belief.std) for state in _covariances(cases, "aug")], 1)
    return np.stack([np.linalg.norm(std[..., part], axis=-1) for part in (slice(3), slice(3, 6), slice(15, 18))], -1)


def bias_deviations(config: Config) -> Array:
    """Deviations (km) of the two-stage filter's bias after each timing, ``(K, 3)``."""
    return np.stack([state.bias.std for state in _covariances([config], "tkf")])


def _position(belief: Any) -> Array:
    """Trace of the position's covariance."""
    return np.asarray(np.square(belief.std[..., :3]).sum(-1))


def overconfidence(config: Config, colors: Sequence[float]) -> dict[float, float]:
    """Trace of the position's covariance as the differenced filter has it to the least possible one, by color; without a bias."""
    cases = [replace(config, setting=Setting(F, 0.0, 0.0), bias_prior_km=1e-9, walk_km=0.0) for F in colors]
    *_, said = _covariances(cases, "tdkf")
    *_, least = _covariances(cases, "aug")
    return dict(zip(colors, (_position(said.first.belief) / _position(least.belief)).tolist(), strict=True))


class Lost(NamedTuple):
    """Trace of the covariance to the exact one: with the correlation of estimate and process noise, and without it."""

    kept: float
    dropped: float


def lost_correlation(config: Config, L: float = 0.9) -> Lost:
    """Colored process noise alone."""
    c = replace(config, setting=Setting(0.0, L, 0.0), bias_prior_km=1e-9, walk_km=0.0)
    *_, kept = _covariances([c], "tdkf")
    *_, least = _covariances([c], "aug")
    stage = differencing(LINEAR, noise_of(c))
    state = stage.start(Gaussian(np.zeros(6), np.diag(c.deviation**2)))
    for epoch in epochs(c):
        state, _ = stage.predict(state._replace(DQ=np.zeros((6, 6))), epoch)
        state, _, _ = stage.update(state, epoch._replace(z=np.zeros(3)))
    return Lost(*(float(_position(belief) / _position(least.belief)) for belief in (kept.first.belief, state.belief)))


class Sensitivity(NamedTuple):
    """Largest error of the sensitivity to the bias (km per km), as it should be and as the prose has it."""

    right: float
    plain: float


def sensitivity(config: Config) -> Sensitivity:
    """Against what a bias of 1 km on each axis, a run of its own, does to the differenced filter."""
    noise, prior = noise_of(config), Gaussian(np.zeros((3, 6)), np.diag(config.deviation**2))
    stages = differencing(LINEAR, noise), undifferenced(LINEAR, noise)
    both = [TwoStage.of(stage, LINEAR.Gamma, bias_prior((config,), 1)) for stage in stages]
    states, worst = [filter.start(prior) for filter in both], np.zeros(2)
    for epoch in epochs(config):
        states = [filter.step(s, epoch._replace(z=epoch.u.Gamma.T))[0] for filter, s in zip(both, states, strict=True)]
        worst = np.maximum(worst, [np.abs(s.first.belief.mean.T + s.Lambda)[:3].max() for s in states])
    return Sensitivity(*worst.tolist())
