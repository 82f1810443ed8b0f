"""Truth and measurements of the satellite's attitude, and the filters that the paper and this study compare."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.model import Model, Motion, Sensor
from celnav.filters.records import Epoch, Filter, State
from celnav.filters.sequential import Sequential, SingleDraw, ekf, sigma_point, ukf
from celnav.gaussian import attitude
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule, unscented
from celnav.gaussian.spaces import EUCLIDEAN, Space, product, wrap
from celnav.models.gyro import Gyro, preintegrate
from celnav.papers.ssukf.config import DEG_PER_H, Config
from celnav.study.montecarlo import normals


class Scenario(NamedTuple):
    """Simulated runs, time-major.

    Attributes
    ----------
    truth: ``(T, runs, 7)`` at the star epochs, the start first: quaternion and drift (rad/s).
    gyro: ``(time updates, runs, 3)`` rad/s, samples of the gyro or what they are integrated to from star to star.
    stars: ``(T, runs, 4)``, of random sign; nan at the start.
    prior: with the paper's initial error. drawn: with one that is drawn from the prior, as consistency asks for.
    """

    config: Config
    truth: Array
    gyro: Array
    stars: Array
    prior: Gaussian
    drawn: Gaussian

    def epochs(self) -> Iterator[Epoch]:
        """Epochs of the filters: a time update for each row of ``gyro``, a star sample after every ``updates``-th."""
        c, per = self.config, len(self.gyro) // (len(self.truth) - 1)
        nothing = np.full_like(self.stars[0], np.nan)
        yield Epoch(0, 0.0, 0.0, None, nothing, self.truth[0])
        for n, sample in enumerate(self.gyro, start=1):
            k, rest = divmod(n, per)
            seen, truth = (nothing, None) if rest else (self.stars[k], self.truth[k])
            yield Epoch(n, n * c.step_s, c.step_s, sample, seen, truth)

    def shortened(self, seconds: float) -> Scenario:
        """The first part of the same runs."""
        c = self.config
        if seconds >= c.duration_s:
            return self
        T = round(seconds * c.star_hz) + 1
        samples = (T - 1) * (len(self.gyro) // (len(self.truth) - 1))
        config = replace(c, duration_s=seconds)
        return self._replace(config=config, truth=self.truth[:T], gyro=self.gyro[:samples], stars=self.stars[:T])

    def integrated(self) -> Scenario:
        """The same runs with one gyro sample from star to star, integrated from those in between.

        They are composed about a drift of zero, once for all filters: by a drift of 1 deg/h the order of such small turns
        matters less than 1e-12 rad.
        """
        c = self.config
        each = self.gyro.reshape(-1, c.ratio, *self.gyro.shape[1:]).swapaxes(0, 1)
        return self._replace(config=replace(c, preintegrated=True), gyro=preintegrate(each, np.zeros(3), c.gyro_dt))


def simulate(config: Config, rng: np.random.Generator | Sequence[np.random.Generator]) -> Scenario:
    """Simulate one run, or one for each generator."""
    single = isinstance(rng, np.random.Generator)
    rngs = [rng] if isinstance(rng, np.random.Generator) else list(rng)
    c, samples = config, config.star_epochs * config.ratio
    T = c.star_epochs + 1
    initial, white, walk, star, sign = normals(rngs, (6,), (samples, 3), (samples, 3), (T, 3), (T, 1))
    q = _path(c)[:, None]
    drift = np.empty((samples + 1, len(rngs), 3))
    drift[0] = np.asarray(c.bias_deg_per_h) * DEG_PER_H
    factor, deviation = c.gyro.factor(c.gyro_dt), c.gyro.drift_std(c.gyro_dt)
    for k in range(samples):
        drift[k + 1] = factor * drift[k] + deviation * walk[k]
    gyro = c.gyro.measure(q, drift, white, c.gyro_dt)
    at = np.arange(T) * c.ratio
    stars = np.where(sign < 0.0, -1.0, 1.0) * attitude.multiply(attitude.exp(c.sigma_n * star), q[at])
    stars[0] = np.nan
    truth = np.concatenate([np.broadcast_to(q[at], (T, len(rngs), 4)), drift[at]], -1)
    P = np.diag(c.sigma0**2)
    error = initial * c.sigma0
    turned = attitude.multiply(attitude.inverse(attitude.exp(error[:, :3])), truth[0][:, :4])
    moved = np.concatenate([turned, truth[0][:, 4:] - error[:, 3:]], -1)
    mean = np.tile(np.append(attitude.IDENTITY, np.zeros(3)), (len(rngs), 1))
    if single:
        truth, gyro, stars, mean, moved = truth[:, 0], gyro[:, 0], stars[:, 0], mean[0], moved[0]
    every = Scenario(replace(c, preintegrated=False), truth, gyro, stars, Gaussian(mean, P), Gaussian(moved, P))
    return every.integrated() if c.preintegrated else every


def repeated(sim: Scenario, count: int) -> Scenario:
    """The same runs several times, one after the other."""
    truth, gyro, stars = (np.tile(array, (1, count, 1)) for array in (sim.truth, sim.gyro, sim.stars))
    prior, drawn = (Gaussian(np.tile(b.mean, (count, 1)), b.cov) for b in (sim.prior, sim.drawn))
    return Scenario(sim.config, truth, gyro, stars, prior, drawn)


@lru_cache(4)
def _path(config: Config) -> Array:
    """True attitudes ``(samples + 1, 4)`` at the gyro's rate, the same in every run."""
    path = config.body.propagate(start(config), config.gyro_dt, config.star_epochs * config.ratio)[:, :4]
    path.flags.writeable = False
    return path


def start(config: Config) -> Array:
    """True quaternion and angular velocity (rad/s) at the start, ``(7,)``."""
    return np.append(attitude.from_euler(np.radians(config.attitude_deg)), np.radians(config.rate_deg_per_s))


def errors(truth: Array, mean: Array) -> Array:
    """Rotation vector (rad, body axes) and drift (rad/s) of estimates, less those of the truth, ``(..., 6)``."""
    turned = attitude.log(attitude.multiply(mean[..., :4], attitude.inverse(truth[..., :4])))
    return np.concatenate([turned, mean[..., 4:] - truth[..., 4:]], -1)


def euler_errors(truth: Array, mean: Array) -> Array:
    """Errors ``(..., 3)`` rad of roll, pitch and yaw with respect to the orbital frame at the start, as the paper draws them."""
    return np.asarray(wrap(attitude.to_euler(mean[..., :4]) - attitude.to_euler(truth[..., :4])))


def spread(dimension: int, config: Config, *, c: float | None = None) -> Rule:
    """Scaled unscented rule; ``c``: with the spread ``alpha^2 (L + kappa)`` given, the same for every dimension."""
    if c is None:
        return unscented(dimension, config.alpha, config.beta, config.kappa)
    return unscented(dimension, config.alpha, config.beta, c / config.alpha**2 - dimension)


def state_space(*, transported: bool = False, a: float = 1.0, b: float = 4.0) -> Space:
    """Attitude (quaternion, generalized Rodrigues parameters) and drift."""
    return product((attitude.attitude(a, b, transported=transported), 4, 3), (EUCLIDEAN, 3, 3))


def dynamics(gyro: Gyro) -> Model:
    """Model function; the first noise that goes through the points, if any, begins with that of gyro and drift (6)."""

    def f(x: Array, epoch: Epoch, *noise: Array) -> Array:
        if not noise:
            return gyro.propagate(x, epoch.u, epoch.dt)
        y = gyro.propagate(x, epoch.u, epoch.dt, noise[0][..., :3])
        y[..., 4:] += noise[0][..., 3:6]
        return y

    return f


class Sensing(NamedTuple):
    """What is measured: ``h(x, epoch, *noise)``, whose last noise is the sensor's, of the root given.

    ``slope(x, epoch)`` is its Jacobian ``(..., m, 6)``. The spaces of the measurement are those of filters in modified Rodrigues
    parameters and in the Gibbs vector.
    """

    h: Model
    slope: Callable[[Array, Epoch], Array]
    root: Array
    space: Space
    gibbs: Space


def star(x: Array, _epoch: Any, *noise: Array) -> Array:
    """Measured quaternion; the last three noise components turn it, about body axes."""
    q = x[..., :4]
    return attitude.multiply(attitude.exp(noise[-1]), q) if noise else q


def star_sensor(config: Config) -> Sensing:
    """The paper's: a whole attitude."""
    H = np.eye(3, 6)
    return Sensing(star, lambda _x, _epoch: H, config.sigma_n * np.eye(3), attitude.attitude(), attitude.attitude(0.0, 2.0))


def noise_root(gyro: Gyro, dt: float) -> Array:
    """Root ``(6, 6)`` of the noise of a gyro sample and of the drift over ``dt`` seconds."""
    return np.diag(np.repeat([gyro.rate_std(dt), gyro.drift_std(dt)], 3))


def warn_of_wrapping(rule: Rule, sigma: float) -> None:
    """Warn if points of a rule lie half a turn or more from a mean known to ``sigma`` rad: they would be other, shorter rotations.

    Such a rule still runs; its covariance is then no longer that of the attitude.
    """
    reach = np.degrees(np.abs(rule.nodes).max() * sigma)
    if reach > 180.0:
        text = f"sigma points reach {reach:.0f} deg from the mean, and wrap at 180: take a smaller spread (alpha, kappa)"
        warnings.warn(text, RuntimeWarning, stacklevel=3)


def filters(config: Config, *, c: float | None = None, transported: bool = False, form: str = "covariance") -> dict[str, Filter]:
    """The paper's filters and those it is compared with, by name; see `family`.

    ``c``: one spread for all rules instead of ``alpha^2 (L + kappa)``. Warns if points of the prior wrap at 180 deg.
    """
    warn_of_wrapping(spread(15, config, c=c), float(config.sigma0[:3].max()))

    def rule(L: int) -> Rule:
        return spread(L, config, c=c)

    return family(config.gyro, config.step_s, star_sensor(config), rule, transported=transported, form=form)


def family(
    gyro: Gyro, dt: float, sensor: Sensing, rule: Callable[[int], Rule], *, transported: bool = False, form: str = "covariance"
) -> dict[str, Filter]:
    """Filters of attitude and drift for any sensor, by name.

    aukf: process and measurement noise through the points of both parts (15 dimensions, 31 points). aukf-1: the same, drawn
    once for both parts. ssukf: each noise where it acts (12 and 9 dimensions, 25 and 19 points). additive: neither
    (6 dimensions, 13 points). usque: half of the process noise before the prediction, half after it. mekf: linearized, in the
    Gibbs vector.

    Parameters
    ----------
    rule: the rule of a dimension. transported: the covariance follows the reference after an update. form: of all filters.
    """
    space, gibbs = state_space(transported=transported), state_space(transported=transported, a=0.0, b=2.0)
    W, V, Q = noise_root(gyro, dt), sensor.root, gyro.process_noise(dt)
    f = dynamics(gyro)

    def through(time: tuple[Array, ...], measured: tuple[Array, ...]) -> Sequential:
        motion = Motion(f, augment=time, space=space) if time else Motion(f, Q, space=space)
        seen = Sensor(sensor.h, sqrt_R=None if measured else V, augment=measured, space=sensor.space)
        return sigma_point(motion, seen, rule=rule, form=form)

    mekf = ekf(
        Motion(f, Q, space=gibbs, jacobian=lambda x, epoch: gyro.transition(x, epoch.u, epoch.dt)),
        Sensor(sensor.h, sqrt_R=V, space=sensor.gibbs, jacobian=sensor.slope),
        form=form,
    )
    return {
        "aukf": through((W, V), (W, V)),
        "aukf-1": SingleDraw.of(through((W,), (V,))),
        "ssukf": through((W,), (V,)),
        "additive": through((), ()),
        "usque": _halved(f, sensor, gyro, dt, space, form),
        "mekf": mekf,
    }


@dataclass(frozen=True, eq=False)
class Halved(Sequential):
    """Half of the process noise before and half after the propagation [Crassidis & Markley 2003]."""

    def predict(self, state: State, epoch: Epoch) -> State:
        """State at the end of the interval."""
        columns = self.motion.noise
        if not np.any(epoch.dt) or not isinstance(columns, np.ndarray):
            return state
        belief = state.belief
        noisier = self.form(belief.mean, self.form.sum(belief[1], columns))
        return super().predict(state._replace(belief=noisier), epoch)


def _halved(f: Model, sensor: Sensing, gyro: Gyro, dt: float, space: Space, form: str) -> Filter:
    u2 = gyro.sigma_u**2
    half = 0.5 * np.diag(np.repeat([gyro.sigma_v**2 * dt - u2 * dt**3 / 6.0, u2 * dt], 3))
    seen = Sensor(sensor.h, sqrt_R=sensor.root, space=sensor.space)
    crassidis = ukf(Motion(f, half, space=space), seen, kappa=1.0, form=form)
    return Halved(crassidis.motion, crassidis.sensors, rule=crassidis.rule, form=crassidis.form)
