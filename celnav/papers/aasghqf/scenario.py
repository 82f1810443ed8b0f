"""Truth and measurements of the flight, and the filters that the paper and this study compare."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.fallback import Fallback
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter, FromFunctions
from celnav.filters.sequential import Iterated, ekf, sigma_point
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief
from celnav.gaussian.rules import Rule, Taylor, cubature, gauss_hermite, simplex, tensor_product, unscented
from celnav.gaussian.sparse_grid import DELAYED, smolyak
from celnav.models import inertial
from celnav.models.earth import Flight
from celnav.models.inertial import Navigation
from celnav.papers.aasghqf.config import NONLINEAR_WEIGHTS, PAPER_WEIGHTS, Config
from celnav.study.montecarlo import normals

BORESIGHTS = np.sqrt(0.5) * np.array([[0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])
"""Directions of the star sensors on body axes, one forward and up, one aft and up; the stars are seen along them."""


FORM = "covariance"
"""Of all filters here."""


class Inputs(NamedTuple):
    """What the filters know at an epoch.

    Attributes
    ----------
    interval: of the interval that ends here; None at the first epoch. attitude: ``(runs, 3, 3)``, C_b^n' now.
    stars: ``(2, 3)``, directions on n. sqrt_R: ``(8, 8)``.
    """

    interval: Navigation | None
    attitude: Array
    stars: Array
    sqrt_R: Array


class Scenario(NamedTuple):
    """Simulated runs, time-major: ``truth (T, runs, 13)``; ``z (T, runs, 8)``, two star residuals and the position, nan where
    there is no fix.
    """

    config: Config
    flight: Flight
    truth: Array
    z: Array
    prior: Gaussian

    def epochs(self) -> Iterator[Epoch]:
        """Epochs, each with its `Inputs`."""
        times = self.config.times
        for k in range(len(times)):
            dt = float(times[k] - times[k - 1]) if k else 0.0
            yield Epoch(k, float(times[k]), dt, self.inputs(k), self.z[k], self.truth[k])

    def inputs(self, k: int) -> Inputs:
        """What is known at epoch k."""
        interval = None if k == 0 else _inputs_of(self.flight, 2 * k - 1, self.truth[k - 1])
        attitude = inertial.misalignment_matrix(self.truth[k][..., inertial.PHI]) @ self.flight.attitude[2 * k]
        stars = BORESIGHTS @ self.flight.attitude[2 * k].T
        sigma = self.config.sigma_z(float(self.flight.latitude[2 * k]))
        return Inputs(interval, attitude, stars, np.diag(sigma))


def _inputs_of(flight: Flight, at: int, truth: Array) -> Navigation:
    return inertial.navigation(flight, at, truth[..., inertial.PHI], truth[..., inertial.BIAS])


def simulate(config: Config, rng: np.random.Generator | Sequence[np.random.Generator]) -> Scenario:
    """Simulate one run, or one run for each generator: initial errors drawn from the prior, process and measurement noise."""
    single = isinstance(rng, np.random.Generator)
    rngs = [rng] if isinstance(rng, np.random.Generator) else list(rng)
    T, flight = config.steps + 1, config.flight
    initial, walk, noise = normals(rngs, (13,), (config.steps, 5), (T, 8))
    truth = np.empty((T, len(rngs), 13))
    truth[0] = initial * config.sigma0
    w = walk @ config.sqrt_Q.T
    for k in range(config.steps):
        truth[k + 1] = inertial.advance(truth[k], _inputs_of(flight, 2 * k + 1, truth[k]), config.step_s) + w[k]
    z = np.empty((T, len(rngs), 8))
    for k in range(T):
        stars = BORESIGHTS @ flight.attitude[2 * k].T
        attitude = inertial.misalignment_matrix(truth[k][..., inertial.PHI]) @ flight.attitude[2 * k]
        z[k, :, :6] = inertial.star_residuals(truth[k], attitude, stars)
        z[k, :, 6:] = truth[k][..., inertial.POSITION]
        z[k] += noise[k] * config.sigma_z(float(flight.latitude[2 * k]))
    z[np.arange(T) % config.star_interval != 0, :, :6] = np.nan
    z[np.arange(T) % config.sar_interval != 0, :, 6:] = np.nan
    if single:
        truth, z = truth[:, 0], z[:, 0]
    prior = Gaussian(np.zeros(truth.shape[1:]), np.diag(config.sigma0**2))
    return Scenario(config, flight, truth, z, prior)


def dynamics(x: Array, epoch: Epoch) -> Array:
    """One step of the error model; a point beyond 89 degrees of phi_x is lost (nan), and with it its run."""
    y = inertial.advance(x, epoch.u.interval, epoch.dt)
    if np.abs(x[..., 0]).max() >= inertial.SINGULAR:
        y = np.where(np.abs(x[..., :1]) < inertial.SINGULAR, y, np.nan)
    return y


def measurement(x: Array, epoch: Epoch) -> Array:
    """Two star residuals and the position, ``(..., 8)``."""
    out = np.empty_like(x, shape=(*x.shape[:-1], 8))  # in the order of x in memory
    out[..., :6] = inertial.star_residuals(x, epoch.u.attitude, epoch.u.stars)
    out[..., 6:] = x[..., inertial.POSITION]
    return out


def sqrt_R(_: Array, epoch: Epoch) -> Array:
    """Root of the measurement noise at an epoch."""
    return np.asarray(epoch.u.sqrt_R)


@cache
def rules(level: int = 3) -> dict[str, Any]:
    """Rules by the names that figures and tables use; those of the full state have 13 dimensions.

    ukf: kappa = 3 - n. sghqf: isotropic sparse grid. aasghqf: Table 2's weights. nonlinear: weights 1 for the misalignment only.
    delayed: orders 1, 3, 3. ckf, ckf5: cubature. ghqf3, ghqf5: tensor rules marginalized over the ten linear states.
    """
    linear = simplex(10)
    return {
        "ukf": unscented(13, kappa=-10.0),
        "sghqf": smolyak(13, level),
        "aasghqf": smolyak(13, level, PAPER_WEIGHTS),
        "nonlinear": smolyak(13, level, NONLINEAR_WEIGHTS),
        "delayed": smolyak(13, level, orders=DELAYED),
        "ckf": cubature(13),
        "ckf5": cubature(13, 5),
        "ghqf3": tensor_product(gauss_hermite(3, 3), linear),
        "ghqf5": tensor_product(gauss_hermite(3, 5), linear),
        "ekf": Taylor(),
    }


def model(config: Config) -> tuple[Motion, Sensor]:
    """What filters believe."""
    return Motion(dynamics, sqrt_Q=config.sqrt_Q), Sensor(measurement, sqrt_R=sqrt_R)


def quadrature_filter(rule: Any, config: Config) -> Filter:
    """A filter by any rule. Where negative weights lose definiteness, a run is done again with the positive rule "ghqf3"."""
    motion, sensor = model(config)
    first = sigma_point(motion, sensor, rule=rule, form=FORM)
    if isinstance(rule, Rule) and (rule.wc < 0.0).any():
        return Fallback(first, sigma_point(motion, sensor, rule=rules(config.level)["ghqf3"], form=FORM))
    return first


def filters(config: Config) -> dict[str, Filter]:
    """The filters by name: one for each of `rules`, and

    iekf: six Gauss-Newton steps at each of the first five epochs. triad-ekf: the first star fix is linearized about the attitude
    that it gives by itself (Wahba's problem).
    """
    out = {name: quadrature_filter(rule, config) for name, rule in rules(config.level).items()}
    motion, sensor = model(config)
    plain = ekf(motion, sensor, form=FORM)
    iterated = Iterated(motion, (sensor,), rule=plain.rule, form=plain.form)
    out["iekf"] = _first(5, iterated, plain)
    out["triad-ekf"] = _first(1, replace(iterated, iterations=1, first=wahba_start), plain)
    return out


def _first(epochs: int, start: Filter, later: Filter) -> Filter:
    """One filter for the first epochs, another for the rest."""
    return FromFunctions(start.start, lambda state, epoch: (start if epoch.k < epochs else later).step(state, epoch))


def wahba_start(belief: Belief, z: Array, epoch: Epoch) -> Array:
    """The mean, with the misalignment that both star vectors give."""
    at = np.array(np.broadcast_to(belief.mean, (*z.shape[:-1], 13)))
    at[..., inertial.PHI] = inertial.wahba_misalignment(z[..., :6], epoch.u.attitude, epoch.u.stars)
    return at
