"""Truth and measurements of the satellite's attitude, and the filters that the paper and this study compare."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from celnav import attitude
from celnav.filters.driver import Epoch, Filter, sequential
from celnav.filters.info import Info
from celnav.filters.single_draw import drawn_once, single_draw
from celnav.filters.step import Model, Predict, Update, predict, update
from celnav.gaussian import Gaussian, covariance
from celnav.linalg import Array
from celnav.models.gyro import preintegrate
from celnav.montecarlo import normals
from celnav.papers.ssukf.config import DEG_PER_H, Config
from celnav.points import Rule, unscented
from celnav.spaces import EUCLIDEAN, Space, product
from celnav.taylor import Taylor


class Scenario(NamedTuple):
    """Simulated runs, time-major.

    Attributes
    ----------
    truth: ``(T, runs, 7)`` at the star epochs, the start first: quaternion and drift (rad/s).
    gyro: ``(gyro samples, runs, 3)`` rad/s. stars: ``(T, runs, 4)``, of random sign; nan at the start.
    """

    config: Config
    truth: Array
    gyro: Array
    stars: Array
    prior: Gaussian

    def epochs(self) -> Iterator[Epoch]:
        """Epochs of the filters. Gyro samples are pre-integrated by the filters, which know their own drift."""
        c = self.config
        yield Epoch(0, 0.0, 0.0, None, self.stars[0], self.truth[0])
        for k in range(1, len(self.truth)):
            samples = self.gyro[(k - 1) * c.ratio : k * c.ratio]
            if c.preintegrated:
                yield Epoch(k, k / c.star_hz, 1.0 / c.star_hz, samples, self.stars[k], self.truth[k])
                continue
            for j, sample in enumerate(samples):
                last = j == c.ratio - 1
                n = (k - 1) * c.ratio + j + 1
                z = self.stars[k] if last else np.full(4, np.nan)
                yield Epoch(n, n * c.gyro_dt, c.gyro_dt, sample[None], z, self.truth[k] if last else None)


def simulate(config: Config, rng: np.random.Generator | Sequence[np.random.Generator], *, drawn: bool = False) -> Scenario:
    """Simulate one run, or one for each generator.

    The initial error is that of the paper; ``drawn``: it is drawn from the prior, as consistency asks for, by moving the estimate.
    """
    single = isinstance(rng, np.random.Generator)
    rngs = [rng] if isinstance(rng, np.random.Generator) else list(rng)
    c, samples = config, config.star_epochs * config.ratio
    T = c.star_epochs + 1
    initial, white, walk, star, sign = normals(rngs, (6,), (samples, 3), (samples, 3), (T, 3), (T, 1))
    start = np.append(attitude.from_euler(np.radians(c.attitude_deg)), np.radians(c.rate_deg_per_s))
    path = c.body.propagate(start, c.gyro_dt, samples)[:, :4]
    q = np.broadcast_to(path[:, None], (samples + 1, len(rngs), 4))
    drift = np.empty((samples + 1, len(rngs), 3))
    drift[0] = np.asarray(c.bias_deg_per_h) * DEG_PER_H
    factor, deviation = c.gyro.factor(c.gyro_dt), c.gyro.drift_std(c.gyro_dt)
    for k in range(samples):
        drift[k + 1] = factor * drift[k] + deviation * walk[k]
    gyro = c.gyro.measure(q, drift, white, c.gyro_dt)
    at = np.arange(T) * c.ratio
    stars = np.where(sign < 0.0, -1.0, 1.0) * attitude.multiply(attitude.exp(c.sigma_n * star), q[at])
    stars[0] = np.nan
    truth = np.concatenate([q[at], drift[at]], -1)
    mean = np.tile(np.append(attitude.IDENTITY, np.zeros(3)), (len(rngs), 1))
    if drawn:
        error = initial * c.sigma0
        turned = attitude.multiply(attitude.inverse(attitude.exp(error[:, :3])), truth[0][:, :4])
        mean = np.concatenate([turned, truth[0][:, 4:] - error[:, 3:]], -1)
    prior = covariance(mean, np.diag(c.sigma0**2))
    if single:
        truth, gyro, stars = truth[:, 0], gyro[:, 0], stars[:, 0]
        prior = covariance(mean[0], np.diag(c.sigma0**2))
    return Scenario(c, truth, gyro, stars, prior)


def spread(dimension: int, config: Config, *, c: float | None = None) -> Rule:
    """Scaled unscented rule; ``c``: with the spread ``alpha^2 (L + kappa)`` given, the same for every dimension."""
    if c is None:
        return unscented(dimension, config.alpha, config.beta, config.kappa)
    return unscented(dimension, config.alpha, config.beta, c / config.alpha**2 - dimension)


def state_space(*, transported: bool = False, a: float = 1.0, b: float = 4.0) -> Space:
    """Attitude (quaternion, generalized Rodrigues parameters) and drift."""
    return product((attitude.attitude(a, b, transported=transported), 4, 3), (EUCLIDEAN, 3, 3))


def dynamics(config: Config, parts: slice | None = None) -> Any:
    """Model function; ``parts``: where the process noise (6) stands among noises that go through the points."""
    gyro = config.gyro

    def f(x: Array, epoch: Epoch, *noise: Array) -> Array:
        # The samples are composed about the drift of the center, as a filter that knows it does.
        measured = preintegrate(epoch.u, x[0][..., 4:], config.gyro_dt) if len(epoch.u) > 1 else epoch.u[0]
        if parts is None:
            return gyro.propagate(x, measured, epoch.dt)
        w = np.concatenate(noise, -1)[..., parts]
        y = gyro.propagate(x, measured, epoch.dt, w[..., :3])
        y[..., 4:] += w[..., 3:6]
        return y

    return f


def star(x: Array, _epoch: Any, *noise: Array) -> Array:
    """Measured quaternion; the last three noise components turn it, about body axes."""
    q = x[..., :4]
    return attitude.multiply(attitude.exp(noise[-1]), q) if noise else q


def filters(config: Config, *, c: float | None = None, transported: bool = False) -> dict[str, Filter]:
    """The filters by name.

    aukf: process and measurement noise through the points of both parts (15 dimensions, 31 points). aukf-1: the same, drawn
    once for both parts. ssukf: each noise where it acts (12 and 9 dimensions, 25 and 19 points). additive: neither
    (6 dimensions, 13 points). usque: half of the process noise before the prediction, half after it. mekf: linearized, in the
    Gibbs vector. ``c``: one spread for all rules instead of ``alpha^2 L``. ``transported``: the covariance follows the
    reference after an update.
    """
    dt, gyro, space, sky = config.step_s, config.gyro, state_space(transported=transported), attitude.attitude()
    gibbs, gibbs_sky = state_space(transported=transported, a=0.0, b=2.0), attitude.attitude(0.0, 2.0)
    W = np.diag(np.repeat([gyro.rate_std(dt), gyro.drift_std(dt)], 3))
    V = config.sigma_n * np.eye(3)
    Q = gyro.process_noise(dt)
    through, plain = dynamics(config, slice(0, 6)), dynamics(config)

    def rule(dimension: int) -> Rule:
        return spread(dimension, config, c=c)

    def measure(rule: Any, extra: tuple[Array, ...] = (), space: Space = space, sky: Space = sky) -> Update:
        return update(star, rule, sqrt_R=None if extra else V, extra=extra, space=space, measurement_space=sky)

    once = single_draw(through, star, rule(15), extra=(W, V), space=space, measurement_space=sky)
    crassidis = unscented(6, 1.0, 0.0, 1.0)
    return {
        "aukf": sequential(predict(through, rule(15), extra=(W, V), space=space), measure(rule(15), (W, V))),
        "aukf-1": drawn_once(once, measure(rule(9), (V,))),
        "ssukf": sequential(predict(through, rule(12), extra=(W,), space=space), measure(rule(9), (V,))),
        "additive": sequential(predict(plain, rule(6), Q, space=space), measure(rule(6))),
        "usque": sequential(_halved(plain, crassidis, config, space), measure(crassidis)),
        "mekf": sequential(predict(plain, Taylor(), Q, space=gibbs), measure(Taylor(), space=gibbs, sky=gibbs_sky)),
    }


def _halved(f: Model, rule: Rule, config: Config, space: Space) -> Predict:
    """Half of the process noise before and half after the propagation [Crassidis & Markley 2003]."""
    gyro, dt = config.gyro, config.step_s
    u2 = gyro.sigma_u**2
    half = 0.5 * np.diag(np.repeat([gyro.sigma_v**2 * dt - u2 * dt**3 / 6.0, u2 * dt], 3))
    forward, columns = predict(f, rule, half, space=space), np.sqrt(half)

    def part(belief: Gaussian, epoch: Any = None) -> tuple[Gaussian, Info]:
        return forward(belief._replace(spread=belief.form.sum(belief.spread, columns)), epoch)

    return part
