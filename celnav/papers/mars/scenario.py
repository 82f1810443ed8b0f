"""[Deng2013]: pulse delays of four millisecond pulsars, once a week from Earth to Mars.

The abstract names neither the pulsars, nor the telescope, nor the model of the motion. Our reading:

- The cruise is an ellipse about the Sun that leaves the Earth and reaches Mars after 36 weeks.
  Weekly accelerations disturb it, for solar radiation pressure that is not modeled.
- The four pulsars have published X-ray fluxes and are in the NANOGrav 15-year data. The photon
  noise of a delay follows from the fluxes [Sheikh2006].
- Spin irregularities are a Gaussian process with the power-law spectra of [NANOGrav2023]. The
  spacecraft predicts pulses with timing models (phase, frequency and its derivative) that were
  fitted on the ground before departure. What the models leave is `spin_noise`.

Delays include whole periods, the clock on board is exact, and the planets do not attract the
spacecraft.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter, epochs
from celnav.filters.sequential import ekf
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief, cholesky
from celnav.models.ephemeris import DAY_S, GM, Tdb, de421, from_utc
from celnav.models.orbit import Earth, advance, flow
from celnav.models.pulsar import LIGHT_KM_S, Timing, pulsars
from celnav.papers import citation
from celnav.study.montecarlo import normals
from celnav.study.parameters import Timed, param
from celnav.study.study import Rngs
from celnav.study.trial import Group, Trial

__all__ = [
    "CITATION",
    "COMMON",
    "GROUPS",
    "JUDGED",
    "PRESETS",
    "PRIOR_STD",
    "RED",
    "SUN",
    "TITLE",
    "Config",
    "Cruise",
    "cruise",
    "decomposed",
    "filters",
    "process",
    "spectrum",
    "spin_noise",
    "trial",
]

TITLE = "Interplanetary spacecraft navigation with pulsars"
CITATION = citation("Deng2013")
GROUPS = (Group("position", "km", slice(0, 3)), Group("velocity", "m/s", slice(3, 6), 1e3))
JUDGED = {group.name: group.unit for group in GROUPS}
YEAR_S = 365.25 * DAY_S
SUN = Earth(GM["sun"], 695_700.0, 0.0)
RED = {
    "B1937+21": (-13.5100, 3.8377),
    "J0030+0451": (-14.4119, 4.3160),
    "J0437-4715": (-16.8120, 1.6216),
    "J2124-3358": (-13.0942, 1.3417),
}
"""Spin noise by pulsar: log10 of the amplitude, and the exponent of the power law, the maximum of
the likelihood as released with [NANOGrav2023]."""
COMMON = (-14.6733, 13.0 / 3.0)
"""The process that all pulsars have in common, from the same source."""
PRIOR_STD = np.repeat([100.0, 1e-3], 3)
"""Standard deviations ``(6,)`` of the estimate at departure, km and km/s; chosen."""
FITTED = 200
"""Number of observations on the ground to which a timing model is fitted."""


# -- parameters ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Config(Timed):
    """All parameters of a run."""

    start_utc: str = param("2011-11-26T15:00:00", "chosen: a launch to Mars", "departure, UTC")
    weeks: int = param(36, "chosen", "length of the cruise, weeks", least=2, most=500)
    interval_days: float = param(7.0, "paper", "interval between observations", above=0.0)
    pulsars: tuple[str, ...] = param(
        tuple(RED), "chosen: their number is in the paper", "names of the pulsars"
    )
    runs: int = param(400, "chosen", "number of Monte-Carlo runs", least=2)
    area_m2: float = param(0.1, "chosen", "effective area of the telescope", above=0.0)
    hours: float = param(24.0, "chosen", "observation time of each pulsar", above=0.0, most=42.0)
    acceleration_km_per_s2: float = param(
        1e-11,
        "chosen: solar radiation pressure is about 1e-10",
        "σ of an unmodeled acceleration, constant between observations, each axis",
        above=0.0,
    )
    fit_years: float = param(
        15.0, "chosen: span of the NANOGrav data", "span of the fit of the timing models", above=0.0
    )
    age_years: float = param(
        0.0, "chosen", "time from the end of that fit to the departure", least=0.0
    )
    modes: int = param(
        8, "chosen", "modes of each pulsar's spin noise that are states", least=1, most=500
    )

    def check(self) -> None:
        """Check that the pulsars have known spin noise, and that there are enough modes."""
        for name in self.pulsars:
            if name not in RED:
                raise ValueError(f"pulsars: expected some of {', '.join(RED)}, got {name!r}")
        if self.modes > self.weeks:
            raise ValueError(f"modes: expected at most weeks, {self.weeks}, got {self.modes}")

    @property
    def times(self) -> Array:
        """Seconds since departure, ``(weeks + 1,)``; there is no measurement at the first epoch."""
        return self.interval_days * DAY_S * np.arange(self.weeks + 1.0)

    @property
    def dates(self) -> Tdb:
        """The epochs as dates."""
        return from_utc(self.start_utc).after(self.times)

    @property
    def timing(self) -> Timing:
        """Timing model of the pulsars."""
        return Timing(pulsars(self.pulsars))

    @property
    def sigma_km(self) -> Array:
        """Standard deviations ``(m,)`` of the delays due to the number of photons, km."""
        seconds, cm2 = 3600.0 * self.hours, 1e4 * self.area_m2
        return LIGHT_KM_S * np.array([p.timing_std(seconds, cm2) for p in self.timing.pulsars])


FINE = Config()
PRESETS = {"usual": FINE, "large": replace(FINE, area_m2=1.0)}


# -- spin noise ------------------------------------------------------------------------------------
def spectrum(f: Array, log10_A: float, gamma: float) -> Array:
    """One-sided spectral density (s^2/Hz) of arrival times at frequencies ``f`` (Hz), as in
    [NANOGrav2023]."""
    return np.asarray(
        10.0 ** (2.0 * log10_A) / (12.0 * np.pi**2) * YEAR_S**3 * (f * YEAR_S) ** -gamma
    )


@lru_cache(maxsize=16)
def spin_noise(config: Config) -> Array:
    """Covariances ``(m, T, T)`` km^2 of the error of the predicted delays at the T observations.

    The process is a sum of waves. A quadratic fit to the years on the ground is extrapolated and
    subtracted from each.
    """
    c = config
    end = -c.age_years * YEAR_S
    ground = np.linspace(end - c.fit_years * YEAR_S, end, FITTED)
    t = np.concatenate([ground, c.times[1:]])
    # The lowest frequency is a quarter of one wave in the whole span; the fit absorbs lower ones.
    length = 4.0 * (t[-1] - t[0])
    f = np.arange(1.0, length / (2.0 * c.times[1])) / length
    angle = 2.0 * np.pi * f * t[:, None]
    waves = np.concatenate([np.cos(angle), np.sin(angle)], 1)
    powers = (t[:, None] / YEAR_S) ** np.arange(3)
    fitted = np.linalg.lstsq(powers[:FITTED], waves[:FITTED])[0]
    left = waves[FITTED:] - powers[FITTED:] @ fitted
    each = [spectrum(f, *RED[name]) + spectrum(f, *COMMON) for name in c.pulsars]
    density = np.tile(np.stack(each) / length, 2)
    return np.asarray(LIGHT_KM_S**2 * np.stack([(left * s) @ left.T for s in density]))


def decomposed(config: Config) -> Array:
    """Modes ``(T, m, T)`` km of the spin noise: it is ``modes @ xi`` with standard normal xi. The
    last axis is the mode, the largest first (Karhunen-Loeve)."""
    values, vectors = np.linalg.eigh(spin_noise(config))
    modes = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
    return np.asarray(modes[..., ::-1].transpose(1, 0, 2))


# -- the cruise ------------------------------------------------------------------------------------
class Cruise(NamedTuple):
    """Heliocentric states ``(T + 1, 6)`` km, km/s; transitions ``(T, 6, 6)`` between observations;
    the Sun's barycentric position ``(T + 1, 3)`` km."""

    states: Array
    Phi: Array
    sun: Array


def cruise(config: Config) -> Cruise:
    """The undisturbed cruise, from the Earth's center to that of Mars."""
    return _cruise(config.start_utc, config.interval_days, config.weeks)


@lru_cache(maxsize=16)
def _cruise(start_utc: str, interval_days: float, weeks: int) -> Cruise:
    times = interval_days * DAY_S * np.arange(weeks + 1.0)
    dates = from_utc(start_utc).after(times)
    earth, mars, sun = (de421().state(body, dates) for body in ("earth", "mars", "sun"))
    start, end = earth.position[0] - sun.position[0], mars.position[-1] - sun.position[-1]
    velocity = 1.1 * (earth.velocity[0] - sun.velocity[0])
    for _ in range(9):  # Newton's method for the velocity at departure; the last pass keeps it
        states, transitions = [np.concatenate([start, velocity])], []
        total = np.eye(6)
        for dt in np.diff(times):
            state, Phi, _ = flow(states[-1][None], dt, SUN)
            states.append(state[0])
            transitions.append(Phi[0])
            total = Phi[0] @ total
        velocity = velocity + np.linalg.solve(total[:3, 3:], end - states[-1][:3])
    return Cruise(np.stack(states), np.stack(transitions), sun.position)


def process(config: Config) -> Array:
    """Columns ``(6, 3)`` of the process noise: an acceleration that is constant for a week."""
    dt = config.times[1]
    i = np.eye(3)
    return np.asarray(config.acceleration_km_per_s2 * np.vstack([0.5 * dt * dt * i, dt * i]))


# -- the filters -----------------------------------------------------------------------------------
def filters(config: Config) -> dict[str, Filter]:
    """The filters by name. All have the same states: position, velocity, and for each pulsar the
    coefficients of its modes.

    ignoring: as if there were no spin noise. inflated: the variance of the spin noise is added to
    that of the photons. walk: the first states after the velocity are pulse phases that walk at
    random. modes: the coefficients of the modes are constant states, and what the modes lack is
    white noise. openloop: without observations.
    """
    timing, m, r = config.timing, len(config.pulsars), config.modes
    n = 6 + m * r
    every = np.square(decomposed(config))
    variance, lacking = every.sum(-1), every[..., r:].sum(-1).mean(0)
    first = np.sqrt(variance[0])
    steps = np.sqrt(np.square(np.diff(decomposed(config), axis=0)).sum(-1).mean(0))
    R = config.sigma_km**2

    def f(x: Array, epoch: Epoch) -> Array:
        return np.concatenate([advance(x[..., :6], epoch.dt, SUN), x[..., 6:]], -1)

    def f_jacobian(mean: Array, epoch: Epoch) -> Array:
        F = np.zeros((*mean.shape, n)) + np.eye(n)
        F[..., :6, :6] = flow(mean[..., :6], epoch.dt, SUN).Phi
        return F

    def motion(*more: Array) -> Motion:
        column = np.pad(process(config), ((0, n - 6), (0, 0)))
        return Motion(f, sqrt_Q=np.hstack([column, *more]), jacobian=f_jacobian)

    def sensor(B: Callable[[Any], Array], R: Array) -> Sensor:
        """``B``: function of the epoch, Jacobian ``(m, n - 6)`` of the spin noise."""

        def h(x: Array, epoch: Epoch) -> Array:
            sun = epoch.u[0]
            return np.asanyarray(timing.delay(sun + x[..., :3], sun) + x[..., 6:] @ B(epoch).T)

        def h_jacobian(mean: Array, epoch: Epoch) -> Array:
            sun = epoch.u[0]
            H = np.zeros((*mean.shape[:-1], m, n))
            H[..., :3] = timing.gradient(sun + mean[..., :3], sun)
            H[..., 6:] = B(epoch)
            return H

        return Sensor(h, np.diag(R), jacobian=h_jacobian)

    def modes(epoch: Epoch) -> Array:
        B = np.zeros((m, m, r))
        B[range(m), range(m)] = epoch.u[1]
        return B.reshape(m, m * r)

    nothing, phases = np.zeros((2, m, m * r))
    phases[:, :m] = np.diag(first)
    walks = np.zeros((n, m))
    walks[6 : 6 + m] = np.diag(steps / first)
    return {
        "ignoring": ekf(motion(), sensor(lambda _: nothing, R)),
        "inflated": ekf(motion(), sensor(lambda _: nothing, R + variance.mean(0))),
        "walk": ekf(motion(walks), sensor(lambda _: phases, R)),
        "modes": ekf(motion(), sensor(modes, R + lacking)),
        "openloop": ekf(motion()),
    }


# -- truth and measurements ------------------------------------------------------------------------
def trial(config: Config, rngs: Rngs) -> Trial:
    """One run for each generator: the disturbed cruise, delays with photon noise and spin noise,
    and an initial estimate drawn from the prior."""
    c, (nominal, _, sun) = config, cruise(config)
    modes, m, T = decomposed(c), len(c.pulsars), c.weeks
    initial, w, xi, v = normals(rngs, (6,), (T, 3), (m, T), (T, m))
    states = [np.tile(nominal[0], (len(rngs), 1))]
    for k in range(T):
        states.append(advance(states[-1], c.times[1], SUN) + w[k] @ process(c).T)
    truth = np.stack(states)
    z = c.timing.delay(sun[:, None] + truth[..., :3], sun[:, None])
    # Modes (T, m, mode), coefficients (m, runs, mode) -> spin noise (T, runs, m).
    z[1:] += np.einsum("kmj,mrj->krm", modes, xi) + v * c.sigma_km
    coefficients = np.zeros((len(rngs), m * c.modes))
    std = np.append(PRIOR_STD, np.ones(m * c.modes))
    prior = Gaussian(np.hstack([truth[0] + initial * PRIOR_STD, coefficients]), np.diag(std**2))
    every = epochs(c.times, z, (sun[1:], modes[..., : c.modes]), truth)[1:]
    return Trial(GROUPS, filters(c), prior, lambda _: every, _compare, "modes")


def _compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
    return belief.mean[..., :6] - truth, cholesky(belief.cov[..., :6, :6])
