"""[Wu2012]: the attitude of a satellite from gyros and a star sensor. Our copy of the paper lacks
the equations."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.model import Model, Motion, Sensor
from celnav.filters.records import Epoch, State
from celnav.filters.sequential import Sequential, SingleDraw, ekf, sigma_point, ukf
from celnav.gaussian import attitude
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief
from celnav.gaussian.rules import Rule, unscented
from celnav.gaussian.spaces import EUCLIDEAN, Space, product
from celnav.models.gyro import Body, Gyro, preintegrate
from celnav.papers import citation
from celnav.study.montecarlo import normals, steps
from celnav.study.parameters import Timed, param
from celnav.study.trial import Group, Trial

__all__ = [
    "ARCSEC",
    "CITATION",
    "DEG_PER_H",
    "FULL_RATE",
    "GROUPS",
    "JUDGED",
    "PRESETS",
    "RADIUS_KM",
    "SIDES",
    "STANDARD",
    "TITLE",
    "Config",
    "Scenario",
    "augmentations",
    "compare",
    "displaced",
    "dynamics",
    "errors",
    "filters",
    "noise_root",
    "path",
    "simulate",
    "spread",
    "star",
    "state_space",
    "trial",
]

TITLE = "State-switching unscented Kalman filter for attitude"
CITATION = citation("Wu2012")
ARCSEC = DEG_PER_H = np.pi / 648000.0
"""rad, and rad/s."""
RADIUS_KM = 6378.137 + 800.0


# -- parameters ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Config(Timed):
    """All parameters of a run; angles in degrees, as the paper prints them."""

    orbit_rate_rad_per_s: float = param(
        1e-3, "paper", "rate of the circular orbit, also for the gravity gradient"
    )
    attitude_deg: tuple[float, float, float] = param(
        (1.0, 2.0, 10.0), "paper", "true roll, pitch and yaw at the start"
    )
    rate_deg_per_s: tuple[float, float, float] = param(
        (0.01, 0.01, 0.05), "paper", "true inertial rate at the start, body axes"
    )
    inertia: tuple[tuple[float, float, float], ...] = param(
        ((52.0, 1.2, -0.8), (1.2, 47.0, 0.6), (-0.8, 0.6, 61.0)),
        "chosen: lost",
        "inertia matrix, body axes, kg m^2",
    )
    wheels: tuple[float, float, float] = param(
        (0.0, -2.0, 0.0), "chosen", "angular momentum of the wheels, body axes, N m s"
    )
    torque: tuple[float, float, float] = param(
        (1e-6, -1e-6, 0.5e-6), "chosen", "constant disturbance torque, body axes, N m"
    )
    gyro_hz: float = param(
        100.0,
        "paper",
        "sampling rate of the gyro; a whole number of samples for each star sample",
        above=0.0,
    )
    star_hz: float = param(4.0, "paper", "sampling rate of the star sensor", above=0.0)
    gyro_deg_per_h: float = param(
        0.5,
        "paper: of a sample, inferred",
        "standard deviation of the white noise of one gyro sample on each axis",
        least=0.0,
    )
    drift_deg_per_h: float = param(
        0.02,
        "paper: inferred",
        "stationary standard deviation of the gyro's drift on each axis",
        least=0.0,
    )
    tau_s: float = param(3600.0, "chosen", "correlation time of the drift", above=0.0)
    bias_deg_per_h: tuple[float, float, float] = param(
        (1.0, 1.0, 1.0), "paper", "true drift at the start on each axis"
    )
    star_arcsec: float = param(
        20.0, "paper", "standard deviation of the star sensor's noise on each axis", above=0.0
    )
    prior_deg: tuple[float, float, float] = param(
        (1.0, 2.0, 10.0), "chosen", "initial standard deviations of roll, pitch and yaw", above=0.0
    )
    prior_drift_deg_per_h: float = param(
        1.0, "chosen", "initial standard deviation of the drift on each axis", above=0.0
    )
    alpha: float = param(0.1, "chosen: small", "spread of the sigma points", above=0.0)
    kappa: float = param(0.0, "paper", "second parameter of the spread of the sigma points")
    beta: float = param(
        2.0,
        "chosen",
        "enters the covariance weight of the central sigma point; 2 is optimal for Gaussians",
    )
    duration_s: float = param(600.0, "chosen", "duration of a run", above=0.0)
    runs: int = param(200, "chosen", "runs of the Monte Carlo simulation", least=1)
    preintegrated: bool = param(
        True,
        "chosen",
        "whether the gyro samples between two star samples are combined in one time update",
    )

    def check(self) -> None:
        """Check the ratio of the rates, the number of samples, and the inertia."""
        each = self.gyro_hz / self.star_hz
        if abs(each - self.ratio) > 1e-9:
            raise ValueError(
                f"gyro_hz: expected a whole number of samples for each star sample, got {each:g}"
            )
        for rate in (self.star_hz, self.gyro_hz):
            steps("duration_s", self.duration_s * rate)
        Body(self.inertia)

    @property
    def ratio(self) -> int:
        """Gyro samples for each star sample."""
        return round(self.gyro_hz / self.star_hz)

    @property
    def updates(self) -> int:
        """Time updates for each star sample."""
        return 1 if self.preintegrated else self.ratio

    @property
    def step_s(self) -> float:
        """Interval of the time updates, s."""
        return 1.0 / (self.star_hz if self.preintegrated else self.gyro_hz)

    @property
    def times(self) -> Array:
        """Epochs ``(T,)`` s of the star samples, the start first."""
        return np.arange(round(self.duration_s * self.star_hz) + 1) * self.updates * self.step_s

    @property
    def samples(self) -> int:
        """Gyro samples in a run."""
        return (len(self.times) - 1) * self.ratio

    @property
    def gyro(self) -> Gyro:
        """White noise of a sample and stationary drift, converted to noise densities."""
        sigma_v = self.gyro_deg_per_h * DEG_PER_H * float(np.sqrt(1.0 / self.gyro_hz))
        return Gyro(
            sigma_v, self.drift_deg_per_h * DEG_PER_H * float(np.sqrt(2.0 / self.tau_s)), self.tau_s
        )

    @property
    def sigma_n(self) -> float:
        """Standard deviation of the star sensor's noise on each axis, rad."""
        return self.star_arcsec * ARCSEC

    @property
    def sigma0(self) -> Array:
        """Standard deviations ``(6,)`` of the prior: rotation (rad) and drift (rad/s)."""
        return np.concatenate(
            [np.radians(self.prior_deg), np.full(3, self.prior_drift_deg_per_h * DEG_PER_H)]
        )


STANDARD = Config()
FULL_RATE = replace(STANDARD, preintegrated=False)
PRESETS = {"standard": STANDARD, "100 Hz": FULL_RATE}


# -- simulation ------------------------------------------------------------------------------------
class Scenario(NamedTuple):
    """Simulated runs, time-major.

    Attributes
    ----------
    truth: ``(T, runs, 7)`` at the star epochs: quaternion and drift (rad/s).
    gyro: ``(time updates, runs, 3)`` rad/s, samples of the gyro, or samples integrated between star
        samples.
    stars: ``(T, runs, 4)``, of random sign; nan at the start.
    prior: with the paper's initial error.
    drawn: prior whose initial error is drawn from it, as consistency requires.
    """

    config: Config
    truth: Array
    gyro: Array
    stars: Array
    prior: Gaussian
    drawn: Gaussian

    def epochs(self, _filter: str = "") -> Iterator[Epoch]:
        """Epochs of the filters: a time update for each row of ``gyro``, and a star sample after
        every `Config.updates` of them."""
        c = self.config
        nothing = np.full_like(self.stars[0], np.nan)
        yield Epoch(0, 0.0, 0.0, None, nothing, self.truth[0])
        for n, sample in enumerate(self.gyro, start=1):
            k, rest = divmod(n, c.updates)
            z, truth = (nothing, None) if rest else (self.stars[k], self.truth[k])
            yield Epoch(n, n * c.step_s, c.step_s, sample, z, truth)


def simulate(config: Config, rngs: Sequence[np.random.Generator]) -> Scenario:
    """One run for each generator."""
    c = config
    T = len(config.times)
    dt = 1.0 / config.gyro_hz
    q = path(config)[:, None]

    def sampled(rngs: Sequence[np.random.Generator]) -> tuple[Array, ...]:
        initial, white, walk, star, sign = normals(
            rngs, (6,), (c.samples, 3), (c.samples, 3), (T, 3), (T, 1)
        )
        drift = c.gyro.drift(np.asarray(c.bias_deg_per_h) * DEG_PER_H, walk, dt)
        gyro = c.gyro.measure(q, drift, white, dt)
        # Integrated with zero drift: for 1 deg/h the error from the order of rotations is below
        # 1e-12 rad.
        if c.preintegrated:
            gyro = preintegrate(
                gyro.reshape(-1, c.ratio, *gyro.shape[1:]).swapaxes(0, 1), np.zeros(3), dt
            )
        return initial[None], gyro, drift[:: c.ratio].copy(), star, sign

    few = [
        sampled(rngs[k : k + 50]) for k in range(0, len(rngs), 50)
    ]  # more runs at the gyro's rate take gigabytes
    (initial,), gyro, drift, star, sign = (
        np.concatenate(part, 1) for part in zip(*few, strict=True)
    )
    q = q[:: c.ratio]
    P = np.diag(c.sigma0**2)
    stars = np.where(sign < 0.0, -1.0, 1.0) * attitude.multiply(attitude.exp(c.sigma_n * star), q)
    stars[0] = np.nan
    truth = np.concatenate([np.broadcast_to(q, stars.shape), drift], -1)
    mean = np.tile(np.append(attitude.IDENTITY, np.zeros(3)), (len(rngs), 1))
    return Scenario(
        c,
        truth,
        gyro,
        stars,
        Gaussian(mean, P),
        Gaussian(displaced(truth[0], initial * c.sigma0), P),
    )


def displaced(truth: Array, error: Array) -> Array:
    """States ``(..., 7)`` whose error ``(..., 6)`` (rotation vector and drift) is ``error``: they
    become the truth if the error is applied."""
    turned = attitude.multiply(attitude.inverse(attitude.exp(error[..., :3])), truth[..., :4])
    return np.concatenate([turned, truth[..., 4:] - error[..., 3:]], -1)


@lru_cache(4)
def path(config: Config) -> Array:
    """True attitudes ``(samples + 1, 4)`` at the gyro's rate, equal in all runs."""
    start = np.append(
        attitude.from_euler(np.radians(config.attitude_deg)), np.radians(config.rate_deg_per_s)
    )
    body = Body(config.inertia, config.wheels, config.torque, config.orbit_rate_rad_per_s)
    q = body.propagate(start, 1.0 / config.gyro_hz, config.samples)[:, :4]
    q.flags.writeable = False
    return q


# -- the filters -----------------------------------------------------------------------------------
def spread(dimension: int, config: Config, *, c: float | None = None) -> Rule:
    """Scaled unscented rule; ``c``: replaces ``alpha^2 (L + kappa)``, the squared distance of the
    points, for every dimension."""
    kappa = config.kappa if c is None else c / config.alpha**2 - dimension
    return unscented(dimension, config.alpha, config.beta, kappa)


def state_space(*, transported: bool = False, a: float = 1.0, b: float = 4.0) -> Space:
    """Attitude (quaternion, generalized Rodrigues parameters) and drift."""
    return product((attitude.attitude(a, b, transported=transported), 4, 3), (EUCLIDEAN, 3, 3))


def dynamics(gyro: Gyro) -> Model:
    """Model function. The first augmented noise, if any, starts with the six components of gyro and
    drift."""

    def f(x: Array, epoch: Epoch, *noise: Array) -> Array:
        if not noise:
            return gyro.propagate(x, epoch.u, epoch.dt)
        y = gyro.propagate(x, epoch.u, epoch.dt, noise[0][..., :3])
        y[..., 4:] += noise[0][..., 3:6]
        return y

    return f


def star(x: Array, _epoch: Any, *noise: Array) -> Array:
    """Measured quaternion; the last three noise components turn it about body axes."""
    q = x[..., :4]
    return attitude.multiply(attitude.exp(noise[-1]), q) if noise else q


def noise_root(gyro: Gyro, dt: float) -> Array:
    """Square root ``(6, 6)`` of the noise covariance of gyro sample and drift over ``dt`` s."""
    return np.diag(np.repeat([gyro.rate_std(dt), gyro.drift_std(dt)], 3))


def filters(
    config: Config,
    *,
    c: float | None = None,
    transported: bool = False,
    form: str = "covariance",
    vector: Sensor | None = None,
) -> dict[str, Sequential]:
    """The paper's filters and others for comparison, by name; it warns if sigma points of the prior
    wrap at 180 deg.

    aukf: augmented with process and measurement noise in prediction and update (15 dimensions, 31
    points). aukf-1: aukf with one draw of points for both, which preserves their common noise.
    ssukf: augmented with each noise only where it acts (12 and 9 dimensions, 25 and 19 points). pa,
    ma: augmented with process noise only, with measurement noise only [Merwe2004]. additive: not
    augmented (6 dimensions, 13 points). usque: half of the process noise before the prediction,
    half after it. mekf: linearized, with the Gibbs vector.

    c: replaces ``alpha^2 (L + kappa)`` in all rules. transported: whether the covariance is
    transported to the new reference after an update. vector: a sensor instead of the star sensor.
    """
    reach = np.degrees(np.abs(spread(15, config, c=c).nodes).max() * config.sigma0[:3].max())
    if reach > 180.0:  # longer rotations would be read as shorter ones
        text = (
            f"sigma points reach {reach:.0f} deg from the mean, and wrap at 180: take a smaller "
            "spread (alpha, kappa)"
        )
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    gyro = config.gyro
    dt = config.step_s
    f = dynamics(config.gyro)
    W = noise_root(gyro, dt)
    V = config.sigma_n * np.eye(3)
    Q = gyro.process_noise(dt)
    half = 0.5 * np.diag(
        np.repeat([gyro.sigma_v**2 * dt - gyro.sigma_u**2 * dt**3 / 6.0, gyro.sigma_u**2 * dt], 3)
    )
    space, gibbs = (
        state_space(transported=transported, a=a, b=2.0 * (a + 1.0)) for a in (1.0, 0.0)
    )
    sensor = vector or Sensor(star, sqrt_R=V, space=attitude.attitude())
    linear = vector or Sensor(
        star, sqrt_R=V, space=attitude.attitude(0.0, 2.0), jacobian=lambda _x, _epoch: np.eye(3, 6)
    )

    mekf = Motion(
        f, Q, space=gibbs, jacobian=lambda x, epoch: gyro.transition(x, epoch.u, epoch.dt)
    )
    by_name = augmentations(
        Motion(f, Q, space=space), sensor, W, V, rule=lambda L: spread(L, config, c=c), form=form
    )
    return by_name | {
        "aukf-1": SingleDraw.of(by_name["ssukf"]),
        "mekf": ekf(mekf, linear, form=form),
        "usque": Halved(**vars(ukf(Motion(f, half, space=space), sensor, kappa=1.0, form=form))),
    }


SIDES = {
    "aukf": ("wv", "wv"),
    "ssukf": ("w", "v"),
    "pa": ("w", ""),
    "ma": ("", "v"),
    "additive": ("", ""),
}
"""Filter -> noises that augment the prediction and the update (w: process, v: measurement); other
noises are additive."""


def augmentations(
    motion: Motion, sensor: Sensor, W: Array, V: Array, **options: Any
) -> dict[str, Sequential]:
    """The filters of `SIDES` from models that add their noise; ``W``, ``V``: square roots of the
    augmented process and measurement noise."""
    roots = {"wv": (W, V), "w": (W,), "v": (V,)}
    motions = {"": motion} | {
        key: replace(motion, Q=None, sqrt_Q=None, augment=roots[key]) for key in roots
    }
    sensors = {"": sensor} | {
        key: replace(sensor, R=None, sqrt_R=None, augment=roots[key]) for key in roots
    }
    return {
        name: sigma_point(motions[time], sensors[seen], **options)
        for name, (time, seen) in SIDES.items()
    }


@dataclass(frozen=True, eq=False)
class Halved(Sequential):
    """Half of the process noise before and half after the propagation [Crassidis2003]."""

    def predict(self, state: State, epoch: Epoch) -> State:
        """The state at the end of the interval."""
        columns = self.motion.noise
        belief = state.belief
        if not np.any(epoch.dt) or not isinstance(columns, np.ndarray):
            return state
        noisier = self.form(belief.mean, self.form.sum(belief[1], columns))
        return super().predict(state._replace(belief=noisier), epoch)


# -- evaluation ------------------------------------------------------------------------------------
GROUPS = (
    Group("attitude", "arcsec", slice(0, 3), 1.0 / ARCSEC),
    Group("drift", "deg/h", slice(3, 6), 1.0 / DEG_PER_H),
)
JUDGED = {group.name: group.unit for group in GROUPS}


def trial(
    config: Config, rngs: Sequence[np.random.Generator], *, drawn: bool = True, **options: Any
) -> Trial:
    """A trial with one run for each generator. Initial errors are ``drawn`` from the prior, or
    equal the paper's; ``options``: see `filters`."""
    sim = simulate(config, rngs)
    return Trial(
        GROUPS,
        filters(config, **options),
        sim.drawn if drawn else sim.prior,
        sim.epochs,
        compare,
        "mekf",
    )


def errors(truth: Array, mean: Array) -> Array:
    """Errors ``(..., 6)`` of estimates: rotation vector (rad, body axes) and drift (rad/s)."""
    turned = attitude.log(attitude.multiply(mean[..., :4], attitude.inverse(truth[..., :4])))
    return np.concatenate([turned, mean[..., 4:] - truth[..., 4:]], -1)


def compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
    """Errors of a belief ``(runs, 6)`` and the square root of its covariance."""
    return errors(truth, belief.mean), belief.sqrt_cov
