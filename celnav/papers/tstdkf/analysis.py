"""What needs no Monte Carlo: geometry, ephemerides, and what covariances say along the nominal orbit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.models.pulsar import LIGHT_KM_S, pulsars
from celnav.papers.tstdkf import errata
from celnav.papers.tstdkf.config import DAY_S, SETTINGS, YEAR_S, Config, Setting
from celnav.papers.tstdkf.ephemerides import table
from celnav.papers.tstdkf.forces import accelerations, spectrum
from celnav.papers.tstdkf.linear import differenced, exact, gain, plain, start_differenced, start_exact, start_plain, steps
from celnav.papers.tstdkf.scenario import noise_of, nominal_orbit, sky

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
        "bounds": {i: bounds(replace(config, setting=setting)) for i, setting in SETTINGS.items()},
        "bias deviations": bias_deviations(replace(month, setting=SETTINGS[5])),
        "overconfidence": {F: overconfidence(replace(config, days=min(config.days, 10.0)), F) for F in COLORS},
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


def bounds(config: Config) -> Array:
    """Posterior Cramer-Rao bounds of position (km), velocity (km/s) and bias (km), ``(K, 3)``: the exact filter's covariance."""
    state, found = start_exact(config, 1), []
    for at in steps(config):
        state = exact(state, at, np.zeros((1, 3)))
        found.append(state.P.diagonal())
    variances = np.stack(found)
    return np.asarray(np.sqrt(np.stack([variances[:, part].sum(1) for part in (slice(3), slice(3, 6), slice(15, 18))], 1)))


def bias_deviations(config: Config) -> Array:
    """Deviations (km) of the two-stage filter's bias after each timing, ``(K, 3)``."""
    state, noise, found = start_plain(config, 1), noise_of(config), []
    for at in steps(config):
        state = plain(state, at, np.zeros((1, 3)), noise)
        found.append(np.sqrt(state.M.diagonal()))
    return np.stack(found)


def _unboosted(memory: None, seen: Any) -> tuple[None, Array]:
    return memory, np.ones_like(seen.residual)


def overconfidence(config: Config, F: float) -> float:
    """Trace of the position's covariance as the differenced filter has it to the least possible one, without a bias."""
    c = replace(config, setting=Setting(F, 0.0, 0.0), bias_prior_km=1e-9, walk_km=0.0)
    noise, said, least = noise_of(c), start_differenced(c, 1, 1), start_exact(c, 1)
    z = np.zeros((1, 3))
    for k, at in enumerate(steps(c)):
        said = differenced(said, at, z, noise, _unboosted, k == 0)
        least = exact(least, at, z)
    return float(np.trace(said.P[:3, :3]) / np.trace(least.P[:3, :3]))


class Lost(NamedTuple):
    """Trace of the covariance to the exact one: with the correlation of estimate and process noise, and without it."""

    kept: float
    dropped: float


def lost_correlation(config: Config, L: float = 0.9) -> Lost:
    """Colored process noise alone."""
    c = replace(config, setting=Setting(0.0, L, 0.0), bias_prior_km=1e-9, walk_km=0.0)
    noise, z = noise_of(c), np.zeros((1, 3))
    kept, dropped, least = start_differenced(c, 1, 1), start_differenced(c, 1, 1), start_exact(c, 1)
    for k, at in enumerate(steps(c)):
        kept = differenced(kept, at, z, noise, _unboosted, k == 0)
        dropped = differenced(dropped, at, z, noise, _unboosted, k == 0)._replace(DQ=np.zeros((6, 6)))
        least = exact(least, at, z)
    best, with_it, without = (np.trace(s.P[:3, :3]) for s in (least, kept, dropped))
    return Lost(float(with_it / best), float(without / best))


class Sensitivity(NamedTuple):
    """Largest error of the sensitivity to the bias (km per km), as it should be and as the prose has it."""

    right: float
    plain: float


def sensitivity(config: Config) -> Sensitivity:
    """Against what a bias of 1 km on each axis does to the differenced filter."""
    noise, s = noise_of(config), start_differenced(config, 3, 1)
    s, prose, right, wrong = s._replace(x=np.zeros((3, 6))), np.zeros((6, 3)), 0.0, 0.0
    for k, at in enumerate(steps(config)):
        ahead = s
        s = differenced(s, at, at.Gamma.T, noise, _unboosted, k == 0)
        # Both sensitivities go through the same gain, which takes U - K (H U + Gamma') to what it became.
        K = gain(ahead, at, noise, first=k == 0)
        U = at.Phi1 @ prose
        prose = U - K @ (at.H @ U + at.Gamma)
        right, wrong = (max(worst, float(np.abs(s.x.T + L)[:3].max())) for worst, L in ((right, s.Lambda), (wrong, prose)))
    return Sensitivity(right, wrong)
