"""Truth, timings of pulsars, and the filters that the paper and this study compare. Settings of the noise lie side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.differenced import Noise, ar1_noise, differenced
from celnav.filters.driver import Epoch, Filter, sequential
from celnav.filters.step import predict, update
from celnav.filters.strong_tracking import excess, proportional, strong_tracking
from celnav.filters.two_stage import plain, two_stage
from celnav.gaussian import Gaussian, covariance
from celnav.linalg import Array, block, matvec
from celnav.models.ephemeris import de421
from celnav.models.pulsar import Timing
from celnav.models.variational import Flow, advance, flow
from celnav.montecarlo import normals
from celnav.papers.tstdkf.config import Config, Setting
from celnav.taylor import Taylor


class Sky(NamedTuple):
    """Where Earth and Sun are at each epoch, ``(T, 3)`` km; what the filters believe of the Earth."""

    earth: Array
    sun: Array


class Scenario(NamedTuple):
    """Simulated runs, time-major; the runs of several settings lie one after the other.

    Attributes
    ----------
    truth: ``(T, runs, 6)`` km and km/s. bias: ``(T, 3)`` km. z: ``(T, runs, m)`` km, nan at the start. noise: see `noise_of`.
    """

    config: Config
    truth: Array
    bias: Array
    z: Array
    sky: Sky
    prior: Gaussian
    noise: Noise

    @property
    def times(self) -> Array:
        """Seconds since the start, ``(T,)``."""
        return self.config.step_s * np.arange(len(self.truth))

    def epochs(self) -> Iterator[Epoch]:
        """Epochs from the first measurement on; ``u`` is ``(earth, sun)``."""
        for k, (z, truth) in enumerate(zip(self.z[1:], self.truth[1:], strict=True), start=1):
            yield Epoch(k, k * self.config.step_s, self.config.step_s, (self.sky.earth[k], self.sky.sun[k]), z, truth)


def noise_of(config: Config, settings: Sequence[Setting], runs: int) -> Noise:
    """Noises of each run, ``(settings * runs, ...)``."""
    xi, e = np.diag(config.sigma_km**2), np.diag(config.process_std**2)
    each = [ar1_noise(s.F * np.eye(3), s.L * np.eye(6), config.coupling(s.kappa), xi, e) for s in settings]
    return Noise(*(np.repeat(np.stack(matrices), runs, 0) for matrices in zip(*each, strict=True)))


def sky(config: Config) -> Sky:
    """Earth and Sun by DE421."""
    dates = config.start.after(config.step_s * np.arange(config.steps + 1))
    return Sky(de421().state("earth", dates).position, de421().state("sun", dates).position)


def simulate(config: Config, rngs: Sequence[np.random.Generator], settings: Sequence[Setting] = ()) -> Scenario:
    """Simulate one run for each setting and generator; settings see the same random numbers."""
    c, T, settings = config, config.steps + 1, tuple(settings) or (config.setting,)
    runs, many = len(rngs), len(rngs) * len(settings)
    noise, seen, timing = noise_of(c, settings, runs), sky(c), c.timing
    xi, e, first = normals(rngs, (T, 3), (T, 6), (9,))
    xi, e, first = np.tile(xi, (1, len(settings), 1)), np.tile(e, (1, len(settings), 1)), np.tile(first, (len(settings), 1))
    sigma, std = c.sigma_km, c.process_std
    V = first[:, :3] * np.sqrt(noise.V.diagonal(0, -2, -1))
    Q = first[:, 3:] * np.sqrt(noise.Q.diagonal(0, -2, -1))
    x = np.tile(c.orbit, (many, 1))
    nominal, bias = c.orbit, c.bias(c.step_s * np.arange(T))
    truth, z = np.empty((T, many, 6)), np.full((T, many, 3), np.nan)
    truth[0] = x
    for k in range(1, T):
        V = matvec(noise.F, V) + sigma * xi[k]
        Q = matvec(noise.L, Q) + std * e[k]
        # The disturbance is mapped by the nominal orbit's G, from which that of a run differs by 1e-4 of itself.
        moved = flow(nominal, c.step_s)
        x = advance(x, c.step_s) + (matvec(noise.J, V) + Q) @ moved.G.T
        nominal, truth[k] = moved.state, x
        z[k] = timing.delay(seen.earth[k] + bias[k] + x[:, :3], seen.sun[k]) + V
    start = np.tile(c.orbit + c.deviation, (many, 1))
    return Scenario(c, truth, bias, z, seen, covariance(start, np.diag(c.deviation**2)), noise)


class Orbit:
    """The orbit's flow about the last state asked for: what follows, Jacobian and noise input come from one integration."""

    def __init__(self) -> None:
        self._last: tuple[Array, float, Flow] | None = None

    def __call__(self, mean: Array, epoch: Epoch) -> Flow:
        """Flow of an interval from the orbit in ``mean (..., 6 or more)``."""
        x = mean[..., :6]
        if self._last is None or self._last[1] != epoch.dt or not np.array_equal(self._last[0], x):
            self._last = x.copy(), epoch.dt, flow(x, epoch.dt)
        return self._last[2]


def measurement(timing: Timing) -> Any:
    """Model function of the timings, km, with the Earth where the filter believes it."""
    return lambda x, epoch: timing.delay(epoch.u[0] + x[..., :3], epoch.u[1])


def slope(timing: Timing) -> Any:
    """``Gamma (..., m, 3)``: its derivative with respect to position, and to an error of the Earth's."""
    return lambda x, epoch: timing.gradient(epoch.u[0] + x[..., :3], epoch.u[1])


def widened(gradient: Array) -> Array:
    """``H = [Gamma 0]``."""
    return np.concatenate([gradient, np.zeros_like(gradient)], -1)


def kalman(config: Config, Q: Array, R: Array) -> tuple[Any, Any]:
    """Predict and update of an EKF that takes all noise for white, with process noise ``Q (..., 6, 6)`` of the rates."""
    timing, motion, root = config.timing, Orbit(), np.linalg.cholesky(Q)
    along = slope(timing)

    def f(x: Array, epoch: Epoch) -> Array:
        return motion(x[0], epoch).state[None]

    moved = Taylor(lambda x, epoch: (motion(x, epoch).Phi,))
    seen = Taylor(lambda x, epoch: (widened(along(x, epoch)),))
    return (
        predict(f, moved, sqrt_Q=lambda mean, epoch: motion(mean, epoch).G @ root),
        update(measurement(timing), seen, R=R),
    )


def filters(config: Config, noise: Noise) -> dict[str, Filter]:
    """The filters by name.

    tkf: two stages on an EKF with the covariances of the driving noise; its first stage is the paper's EKF. tkf-fair: the same
    with the stationary covariances. tstdkf: two stages on differenced measurements, without (0) and with (1) strong tracking
    along a leading axis: TDKF and TSTDKF. aug: all noises and the bias among the states, exact.
    """
    c, timing = config, config.timing
    bias = covariance(np.zeros(3), c.bias_prior_km**2 * np.eye(3))
    along = slope(timing)
    driving = kalman(c, np.diag(c.process_std**2), np.diag(c.sigma_km**2))
    fair = kalman(c, noise.Q + noise.J @ noise.V @ noise.J.mT, noise.V)
    move = differenced(flow_of, measurement(timing), lambda x, epoch: widened(along(x, epoch)), noise)
    rho = np.stack([np.zeros(3), np.asarray(c.rho)])[:, None]
    boost = strong_tracking(rho, c.tau, factor={"excess": excess, "proportional": proportional}[c.factor])
    return {
        "tkf": two_stage(plain(*driving), along, bias),
        "tkf-fair": two_stage(plain(*fair), along, bias),
        "tstdkf": two_stage(move, along, bias, boost=boost),
        "aug": augmented(c, noise),
    }


def flow_of(mean: Array, epoch: Epoch) -> Flow:
    """Flow of an interval."""
    return flow(mean, epoch.dt)


def augmented(config: Config, noise: Noise) -> Filter:
    """The exact filter: 18 states ``(x, V, Q, b)``, the bias a random walk, and no noise left in the measurement."""
    c, n = config, noise
    timing, along = c.timing, slope(c.timing)
    motion, measure = Orbit(), measurement(timing)
    JF, batch = n.J @ n.F, n.F.shape[:-2]

    def f(x: Array, epoch: Epoch) -> Array:
        mean = x[0]
        moved = motion(mean, epoch)
        V, Q, b = mean[..., 6:9], mean[..., 9:15], mean[..., 15:]
        rates = matvec(JF, V) + matvec(n.L, Q)
        return np.concatenate([moved.state + matvec(moved.G, rates), matvec(n.F, V), matvec(n.L, Q), b], -1)[None]

    def transition(x: Array, epoch: Epoch) -> tuple[Array, ...]:
        Phi, G = motion(x, epoch)[1:]
        return (block([[Phi, G @ JF, G @ n.L, 0], [0, n.F, 0, np.zeros((3, 3))], [np.zeros((6, 6)), 0, n.L, 0],
                       [0, 0, 0, np.eye(3)]]),)  # fmt: skip

    xi, e, walk = np.sqrt(n.Xi), np.sqrt(n.E), c.walk_km * np.eye(3)

    def columns(mean: Array, epoch: Epoch) -> Array:
        G = motion(mean, epoch).G
        return block([[G @ n.J @ xi, G @ e, 0], [xi, 0, 0], [0, e, 0], [0, 0, walk]])

    def h(x: Array, epoch: Epoch) -> Array:
        return np.asarray(measure(x, epoch) + x[..., 6:9] + matvec(along(x, epoch), x[..., 15:]))

    def jacobian(x: Array, epoch: Epoch) -> tuple[Array, ...]:
        Gamma = along(x, epoch)
        rest = np.broadcast_to(np.hstack([np.zeros((3, 3)), np.eye(3), np.zeros((3, 6))]), (*Gamma.shape[:-1], 12))
        return (np.concatenate([Gamma, rest, Gamma], -1),)

    parts = sequential(predict(f, Taylor(transition), sqrt_Q=columns), update(h, Taylor(jacobian), sqrt_R=np.zeros((3, 1))))

    def start(prior: Gaussian) -> Any:
        runs = prior.mean.shape[:-1]
        mean = np.concatenate([prior.mean, np.zeros((*runs, 12))], -1)
        P = block([[prior.cov, 0, 0, 0], [0, n.V, 0, 0], [0, 0, n.Q, 0], [0, 0, 0, c.bias_prior_km**2 * np.eye(3)]])
        return parts.start(covariance(mean, np.broadcast_to(P, (*batch, 18, 18))))

    return Filter(start, parts.step)
