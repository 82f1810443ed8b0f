"""[Liang2014]: an aircraft whose inertial system is badly misaligned, and is corrected by two star sensors and by SAR images.

Eqs. 11-14, 16-18, sparse rules: `celnav.gaussian.sparse_grid`. Eqs. 15, 19, degrees of observability and weights by a threshold:
`celnav.analysis.observability`. Eqs. 20-28, errors of the inertial system, its state, star sensors: `celnav.models.inertial`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
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
from celnav.models import earth, inertial
from celnav.models.earth import Flight
from celnav.models.inertial import Navigation
from celnav.study.montecarlo import MOST_STEPS, normals
from celnav.study.parameters import Parameters, param
from celnav.study.trial import Group, Trial

TITLE = "Adaptive anisotropic sparse Gauss-Hermite quadrature filter for star, SAR and inertial navigation"
CITATION = """\
@article{Liang2014,
  author  = {Liang, H. and Mu, R. and Cui, N. and Wang, D.},
  title   = {Adaptive anisotropic SGHQF and its application to integrated navigation},
  journal = {Control and Decision},
  year    = {2014},
  note    = {in Chinese; received May 2014, revised August 2014}
}"""
PAPER_WEIGHTS = (1, 1, 2, 2, 2, 1, 1, 2, 2, 2, 2, 2, 2)  # of the sparse grid [Liang2014, Table 2]: 75 points
NONLINEAR_WEIGHTS = (1, 1, 1) + (2,) * 10  # by nonlinearity: 57 points
MICRO_G = 1e-6 * earth.STANDARD_GRAVITY
DEGREE = float(np.radians(1.0))
BORESIGHTS = np.sqrt(0.5) * np.array([[0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])  # of the star sensors on body axes, and of the stars
FORM = "covariance"  # of all filters here
UNSAID = "chosen: not printed"


# -- parameters --------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Config(Parameters):
    """Everything that a run depends on."""

    longitude_deg: float = param(110.0, "paper", "of the start")
    latitude_deg: float = param(40.0, "paper", "of the start")
    height_m: float = param(20000.0, "chosen: a high-altitude vehicle", "above the ellipsoid, constant")
    speed_m_per_s: float = param(200.0, "paper", "over the ground, at the start")
    heading_deg: float = param(65.0, "paper", "from north to east, at the start")
    acceleration_m_per_s2: float = param(0.5, "paper", "along the track (inferred), constant")
    turn_rate_deg_per_s: float = param(0.1, "paper", "to the right (chosen), constant")
    step_s: float = param(1.0, "chosen", "interval of the filters' steps", above=0.0)
    steps: int = param(500, "paper", "in a run", least=1, most=MOST_STEPS)
    runs: int = param(50, "paper", "of a Monte Carlo", least=1)
    level: int = param(3, "paper", "accuracy level of the sparse grids", least=1)
    misalignment_deg: tuple[float, float, float] = param((10.0,) * 3, UNSAID, "at the start, standard deviations", above=0.0)
    velocity_m_per_s: float = param(1.0, UNSAID, "standard deviation of the velocity at the start, east and north", above=0.0)
    position_m: float = param(50.0, UNSAID, "standard deviation of the position at the start, east and north", above=0.0)
    drift_deg_per_h: float = param(0.1, "paper", "standard deviation of each gyro's constant drift", above=0.0)
    bias_ug: float = param(200.0, "paper", "standard deviation of each accelerometer's constant bias", above=0.0)
    angle_walk_deg_per_sqrt_h: float = param(0.01, UNSAID, "noise of the gyros", least=0.0)
    velocity_walk_ug_per_sqrt_hz: float = param(20.0, UNSAID, "noise of the accelerometers", least=0.0)
    star_arcsec: float = param(20.0, "paper", "noise of a star fix, standard deviation on each component of a direction", above=0.0)
    sar_m: float = param(18.0, "paper", "noise of a fix by radar, standard deviation east and north", above=0.0)
    star_interval: int = param(1, UNSAID, "steps from one star fix to the next", least=1)
    sar_interval: int = param(1, UNSAID, "steps from one radar fix to the next", least=1)

    @property
    def samples(self) -> int:
        """Of the trajectory, in a run."""
        return 2 * self.steps

    @property
    def end_s(self) -> float:
        """The last epoch, s."""
        return self.step_s * self.steps

    @property
    def times(self) -> Array:
        """Epochs ``(steps + 1,)`` s."""
        return self.step_s * np.arange(self.steps + 1)

    @cached_property
    def flight(self) -> Flight:
        """Truth at the epochs and in the middles between them, ``2 steps + 1`` epochs."""
        angles = {name: float(np.radians(getattr(self, f"{name}_deg"))) for name in ("longitude", "latitude", "heading")}
        return earth.turning_flight(
            0.5 * self.step_s * np.arange(2 * self.steps + 1), **angles, height_m=self.height_m, speed=self.speed_m_per_s,
            acceleration=self.acceleration_m_per_s2, turn_rate=float(np.radians(self.turn_rate_deg_per_s)),
        )  # fmt: skip

    def meters_at(self, latitude: float) -> Array:
        """Meters per radian of longitude and latitude, ``(2,)``."""
        north, east = earth.radii(latitude, self.height_m)
        return np.array([east * np.cos(latitude), north])

    @property
    def meters(self) -> Array:
        """Meters per radian of longitude and latitude at the start, ``(2,)``."""
        return self.meters_at(float(np.radians(self.latitude_deg)))

    @property
    def sigma0(self) -> Array:
        """Standard deviations ``(13,)`` of the prior."""
        angles, position = np.radians(self.misalignment_deg), self.position_m / self.meters
        drift, bias = np.radians(self.drift_deg_per_h) / 3600.0, self.bias_ug * MICRO_G
        return np.concatenate([angles, [self.velocity_m_per_s] * 2, position, [drift] * 3, [bias] * 3])

    @property
    def sqrt_Q(self) -> Array:
        """Columns ``(13, 5)`` of the process noise of one step: misalignment and velocity walk."""
        angle = np.radians(self.angle_walk_deg_per_sqrt_h) / 60.0
        velocity = self.velocity_walk_ug_per_sqrt_hz * MICRO_G
        return np.asarray(np.eye(13, 5) * (np.repeat([angle, velocity], [3, 2]) * np.sqrt(self.step_s)))

    def sigma_z(self, latitude: float) -> Array:
        """Deviations ``(8,)`` of all measurements at a latitude: two star vectors, longitude, latitude."""
        return np.concatenate([np.full(6, np.radians(self.star_arcsec / 3600.0)), self.sar_m / self.meters_at(latitude)])


A = Config()
NOISY = replace(A, angle_walk_deg_per_sqrt_h=1.0, velocity_walk_ug_per_sqrt_hz=50.0)
T3 = replace(NOISY, misalignment_deg=(25.0, 20.0, 12.0), star_interval=30, sar_interval=25)
PRESETS = {
    "T3": T3, "A": A, "A-slow": replace(A, star_interval=10, sar_interval=20),
    "T3-arcmin": replace(NOISY, misalignment_deg=(20.0, 15.0, 7.0), star_arcsec=1200.0, star_interval=20, sar_interval=10),
}  # fmt: skip
"""Fitted so that the levels of Table 3 come out; fixes at every step; slow fixes; star noise misread as arc minutes, fitted too."""


# -- what happens ------------------------------------------------------------------------------------------------------------
class Inputs(NamedTuple):
    """What filters know: the interval that ends here, C_b^n' ``(runs, 3, 3)``, directions on n ``(2, 3)``, root of R ``(8, 8)``."""

    interval: Navigation | None
    attitude: Array
    stars: Array
    sqrt_R: Array


class Scenario(NamedTuple):
    """Simulated runs: ``truth (T, runs, 13)``, ``z (T, runs, 8)``: star residuals and position, nan where there is no fix."""

    config: Config
    truth: Array
    z: Array
    prior: Gaussian

    def epochs(self) -> Iterator[Epoch]:
        """Epochs, each with its `Inputs`."""
        times = self.config.times
        for k, t in enumerate(times):
            u = inputs(self.config, k, self.truth[k], self.truth[k - 1] if k else None)
            yield Epoch(k, float(t), float(t - times[k - 1]) if k else 0.0, u, self.z[k], self.truth[k])


def inputs(config: Config, k: int, truth: Array, before: Array | None) -> Inputs:
    """What is known at epoch k: the system's attitude and force follow from its errors, now and an epoch before."""
    true, sigma = config.flight.attitude[2 * k], config.sigma_z(float(config.flight.latitude[2 * k]))
    attitude = inertial.misalignment_matrix(truth[..., inertial.PHI]) @ true
    return Inputs(None if before is None else interval_before(config, k, before), attitude, BORESIGHTS @ true.T, np.diag(sigma))


def interval_before(config: Config, k: int, truth: Array) -> Navigation:
    """What the system knows in the middle of the interval that ends at epoch k; ``truth``: its errors at the start of it."""
    return inertial.navigation(config.flight, 2 * k - 1, truth[..., inertial.PHI], truth[..., inertial.BIAS])


def simulate(config: Config, rngs: Sequence[np.random.Generator]) -> Scenario:
    """One run for each generator: initial errors drawn from the prior, process and measurement noise."""
    T = config.steps + 1
    initial, walk, noise = normals(rngs, (13,), (config.steps, 5), (T, 8))
    truth, z = np.empty((T, len(rngs), 13)), np.empty_like(noise)
    truth[0], w = initial * config.sigma0, walk @ config.sqrt_Q.T
    for k in range(T):
        if k:
            truth[k] = inertial.advance(truth[k - 1], interval_before(config, k, truth[k - 1]), config.step_s) + w[k - 1]
        u = inputs(config, k, truth[k], None)
        z[k] = measurement(truth[k], Epoch(u=u)) + noise[k] * u.sqrt_R.diagonal()
    z[np.arange(T) % config.star_interval != 0, :, :6] = np.nan
    z[np.arange(T) % config.sar_interval != 0, :, 6:] = np.nan
    return Scenario(config, truth, z, Gaussian(np.zeros(truth.shape[1:]), np.diag(config.sigma0**2)))


# -- the filters -------------------------------------------------------------------------------------------------------------
def dynamics(x: Array, epoch: Epoch) -> Array:
    """One step of the error model; a point beyond 89 degrees of phi_x is lost (nan), and with it its run."""
    y = inertial.advance(x, epoch.u.interval, epoch.dt)
    if np.abs(x[..., 0]).max() >= inertial.SINGULAR:
        y = np.where(np.abs(x[..., :1]) < inertial.SINGULAR, y, np.nan)
    return y


def measurement(x: Array, epoch: Epoch) -> Array:
    """Two star residuals and the position, ``(..., 8)`` [Liang2014, Eqs. 26-28]."""
    out = np.empty_like(x, shape=(*x.shape[:-1], 8))  # in the order of x in memory
    out[..., :6] = inertial.star_residuals(x, epoch.u.attitude, epoch.u.stars)
    out[..., 6:] = x[..., inertial.POSITION]
    return out


def model(config: Config) -> tuple[Motion, Sensor]:
    """What filters believe."""
    return Motion(dynamics, sqrt_Q=config.sqrt_Q), Sensor(measurement, sqrt_R=lambda _, epoch: epoch.u.sqrt_R)


@cache
def rules(level: int = 3) -> dict[str, Any]:
    """Rules by the names that figures and tables use; those of the full state have 13 dimensions.

    ukf: kappa = 3 - n. sghqf: isotropic sparse grid. aasghqf: Table 2's weights. nonlinear: weights 1 for the misalignment only.
    delayed: orders 1, 3, 3. ckf, ckf5: cubature. ghqf3, ghqf5: tensor rules marginalized over the ten linear states.
    """
    return {
        "ukf": unscented(13, kappa=-10.0), "sghqf": smolyak(13, level), "aasghqf": smolyak(13, level, PAPER_WEIGHTS),
        "nonlinear": smolyak(13, level, NONLINEAR_WEIGHTS), "delayed": smolyak(13, level, orders=DELAYED), "ckf": cubature(13),
        "ckf5": cubature(13, 5), "ghqf3": tensor_product(gauss_hermite(3, 3), simplex(10)),
        "ghqf5": tensor_product(gauss_hermite(3, 5), simplex(10)), "ekf": Taylor(),
    }  # fmt: skip


def quadrature_filter(rule: Any, config: Config) -> Filter:
    """A filter by any rule. Where negative weights lose definiteness, a run is done again with the positive rule "ghqf3"."""
    first = sigma_point(*model(config), rule=rule, form=FORM)
    if isinstance(rule, Rule) and (rule.wc < 0.0).any():
        return Fallback(first, sigma_point(*model(config), rule=rules(config.level)["ghqf3"], form=FORM))
    return first


def filters(config: Config) -> dict[str, Filter]:
    """The filters by name: one for each of `rules`; iekf: six Gauss-Newton steps at each of the first five epochs; triad-ekf: the
    first star fix is linearized about the attitude that it gives by itself (Wahba's problem)."""
    plain = ekf(*model(config), form=FORM)
    iterated = Iterated(plain.motion, plain.sensors, rule=plain.rule, form=plain.form)
    return {name: quadrature_filter(rule, config) for name, rule in rules(config.level).items()} | {
        "iekf": _first(5, iterated, plain), "triad-ekf": _first(1, replace(iterated, iterations=1, first=wahba_start), plain),
    }  # fmt: skip


def _first(epochs: int, start: Filter, later: Filter) -> Filter:
    """One filter for the first epochs, another for the rest."""
    return FromFunctions(start.start, lambda state, epoch: (start if epoch.k < epochs else later).step(state, epoch))


def wahba_start(belief: Belief, z: Array, epoch: Epoch) -> Array:
    """The mean, with the misalignment that both star vectors give."""
    at = np.array(np.broadcast_to(belief.mean, (*z.shape[:-1], 13)))
    at[..., inertial.PHI] = inertial.wahba_misalignment(z[..., :6], epoch.u.attitude, epoch.u.stars)
    return at


# -- how they are judged -----------------------------------------------------------------------------------------------------
JUDGED = {"misalignment": "arcmin", "velocity": "m/s", "position": "m", "drift": "deg/h", "bias": "ug"}


def groups(config: Config, angle: float = DEGREE / 60.0, unit: str = "arcmin") -> tuple[Group, ...]:
    """What is judged; the misalignment in a unit of so many radians."""
    east, north = config.meters.tolist()
    return (
        Group("misalignment", unit, inertial.PHI, 1.0 / angle), Group("velocity", "m/s", inertial.VELOCITY),
        Group("position", "m", inertial.POSITION, (east, north)), Group("drift", "deg/h", inertial.DRIFT, 3600.0 / DEGREE),
        Group("bias", "ug", inertial.BIAS, 1.0 / MICRO_G),
    )  # fmt: skip


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """One run with each generator, for missions, campaigns and the study."""
    sim = simulate(config, rngs)
    return Trial(groups(config), filters(config), sim.prior, lambda _name: sim.epochs(), _compare, "ekf")


def _compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
    return belief.mean - truth, belief.sqrt_cov
