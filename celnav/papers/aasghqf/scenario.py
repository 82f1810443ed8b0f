"""[Liang2014]: an aircraft with a large misalignment of its inertial system; two star sensors and
SAR images correct it.

Eqs. 11-14, 16-18, sparse-grid rules: `celnav.gaussian.sparse_grid`. Eqs. 15, 19, degrees of
observability and weights by a threshold: `celnav.analysis.observability`. Eqs. 20-28, errors of the
inertial system, its state, star sensors: `celnav.models.misalignment`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from math import radians
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from celnav.analysis.observability import (
    hysteresis,
    jacobian,
    nonlinearity_degree,
    observability_matrix,
    state_singular_values,
)
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter, FromFunctions
from celnav.filters.sequential import Iterated, ekf, sigma_point
from celnav.filters.switching import Fallback, Switching
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief, is_concretely_true, side_by_side
from celnav.gaussian.rules import (
    Rule,
    Taylor,
    cubature,
    gauss_hermite,
    simplex,
    tensor_product,
    unscented,
)
from celnav.gaussian.sparse_grid import DELAYED, smolyak
from celnav.models import earth, misalignment
from celnav.models.misalignment import BIAS, DRIFT, PHI, POSITION, VELOCITY, Navigation
from celnav.papers import citation
from celnav.study.montecarlo import MOST_STEPS, normals
from celnav.study.parameters import Timed, param
from celnav.study.study import Rngs
from celnav.study.trial import Group, Trial

__all__ = [
    "CITATION",
    "JUDGED",
    "NONLINEAR_WEIGHTS",
    "PAPER_WEIGHTS",
    "PRESETS",
    "TITLE",
    "A",
    "Config",
    "filters",
    "model",
    "quadrature_filter",
    "simulate",
    "trial",
]

TITLE = (
    "Adaptive anisotropic sparse Gauss-Hermite quadrature filter for star, SAR and inertial "
    "navigation"
)
CITATION = citation("Liang2014")
PAPER_WEIGHTS = (1, 1, 2, 2, 2, 1, 1) + (2,) * 6  # of the sparse grid [Liang2014, Table 2]
NONLINEAR_WEIGHTS = (1, 1, 1) + (2,) * 10
"""Weights by nonlinearity: 57 points; the paper's weights give 75."""
MICRO_G = 1e-6 * earth.STANDARD_GRAVITY
DEGREE = radians(1.0)
BORESIGHTS = np.sqrt(0.5) * np.array([[0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])
"""Boresights of the star sensors on body axes, and directions of the stars."""
FORM = "covariance"  # all filters here use the covariance form
UNSAID = "chosen: not printed"


# -- parameters ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Config(Timed):
    """All parameters of a run."""

    longitude_deg: float = param(110.0, "paper", "initial longitude")
    latitude_deg: float = param(40.0, "paper", "initial latitude")
    height_m: float = param(
        20000.0, "chosen: a high-altitude vehicle", "constant height above the ellipsoid"
    )
    speed_m_per_s: float = param(200.0, "paper", "initial ground speed")
    heading_deg: float = param(65.0, "paper", "initial heading, from north to east")
    acceleration_m_per_s2: float = param(
        0.5, "paper", "constant acceleration, along the track (inferred)"
    )
    turn_rate_deg_per_s: float = param(0.1, "paper", "constant turn rate, to the right (chosen)")
    step_s: float = param(1.0, "chosen", "step of the filters", above=0.0)
    steps: int = param(500, "paper", "number of steps of a run", least=1, most=MOST_STEPS)
    runs: int = param(50, "paper", "number of Monte-Carlo runs", least=1)
    level: int = param(3, "paper", "accuracy level of the sparse grids", least=1)
    misalignment_deg: tuple[float, float, float] = param(
        (10.0,) * 3, UNSAID, "standard deviations of the initial misalignment", above=0.0
    )
    velocity_m_per_s: float = param(
        1.0, UNSAID, "standard deviation of the initial velocity error, east and north", above=0.0
    )
    position_m: float = param(
        50.0, UNSAID, "standard deviation of the initial position error, east and north", above=0.0
    )
    drift_deg_per_h: float = param(
        0.1, "paper", "standard deviation of each gyro's constant drift", above=0.0
    )
    bias_ug: float = param(
        200.0, "paper", "standard deviation of each accelerometer's constant bias", above=0.0
    )
    angle_walk_deg_per_sqrt_h: float = param(
        0.01, UNSAID, "angle random walk of the gyros", least=0.0
    )
    velocity_walk_ug_per_sqrt_hz: float = param(
        20.0, UNSAID, "velocity random walk of the accelerometers", least=0.0
    )
    star_arcsec: float = param(
        20.0,
        "paper",
        "standard deviation of a star fix, each component of the direction",
        above=0.0,
    )
    sar_m: float = param(
        18.0, "paper", "standard deviation of a radar (SAR) fix, east and north", above=0.0
    )
    star_interval: int = param(1, UNSAID, "steps from one star fix to the next", least=1)
    sar_interval: int = param(1, UNSAID, "steps from one radar fix to the next", least=1)

    @property
    def times(self) -> Array:
        """Epochs ``(steps + 1,)`` s."""
        return self.step_s * np.arange(self.steps + 1)

    @cached_property
    def flight(self) -> earth.Flight:
        """True flight at the epochs and half-way between them, ``2 steps + 1`` epochs."""
        return earth.turning_flight(
            0.5 * self.step_s * np.arange(2 * self.steps + 1),
            longitude=radians(self.longitude_deg),
            latitude=radians(self.latitude_deg),
            heading=radians(self.heading_deg),
            height_m=self.height_m,
            speed=self.speed_m_per_s,
            acceleration=self.acceleration_m_per_s2,
            turn_rate=radians(self.turn_rate_deg_per_s),
        )

    def meters(self, latitude: Any = None) -> Array:
        """Meters per radian of longitude and latitude, ``(2,)``, at a latitude (rad), by default
        the initial one."""
        at = radians(self.latitude_deg) if latitude is None else latitude
        north, east = earth.radii(at, self.height_m)
        return np.array([east * np.cos(at), north])

    @property
    def units(self) -> tuple[Array, Array]:
        """Units of states ``(13,)`` (rad, m/s, m, deg/h, micro g) and outputs ``(8,)`` (1, m).

        With these units the degrees of observability are nearest to Table 2.
        """
        rates = np.repeat([DEGREE / 3600.0, MICRO_G], 3)
        return np.r_[np.ones(5), 1.0 / self.meters(), rates], np.r_[np.ones(6), self.meters()]

    @property
    def sigma0(self) -> Array:
        """Standard deviations ``(13,)`` of the prior."""
        others = self.velocity_m_per_s, self.position_m, self.drift_deg_per_h, self.bias_ug
        sigmas: Array = np.r_[np.radians(self.misalignment_deg), np.repeat(others, [2, 2, 3, 3])]
        return sigmas * self.units[0]

    @property
    def sqrt_Q(self) -> Array:
        """Square root ``(13, 5)`` of the process noise covariance of one step: random walks of
        misalignment and velocity."""
        angle = np.radians(self.angle_walk_deg_per_sqrt_h) / 60.0
        velocity = self.velocity_walk_ug_per_sqrt_hz * MICRO_G
        walk: Array = np.repeat([angle, velocity], [3, 2]) * np.sqrt(self.step_s)
        return walk * np.eye(13, 5)


A = Config()
NOISY = replace(A, angle_walk_deg_per_sqrt_h=1.0, velocity_walk_ug_per_sqrt_hz=50.0)
T3 = replace(NOISY, misalignment_deg=(25.0, 20.0, 12.0), star_interval=30, sar_interval=25)
PRESETS = {
    "T3": T3,
    "A": A,
    "A-slow": replace(A, star_interval=10, sar_interval=20),
    "T3-arcmin": replace(
        NOISY,
        misalignment_deg=(20.0, 15.0, 7.0),
        star_arcsec=1200.0,
        star_interval=20,
        sar_interval=10,
    ),
}
"""T3: fitted to the levels of Table 3. A: fixes at every step. A-slow: fewer fixes. T3-arcmin: also
fitted, with star noise in arc minutes."""
TURNING = replace(PRESETS["A-slow"], turn_rate_deg_per_s=2.0)
"""Twenty times the paper's turn rate (chosen). In the middle of the flight the horizontal specific
force exceeds the vertical one."""


# -- truth and measurements -----------------------------------------------------------------------
class Inputs(NamedTuple):
    """Inputs of the filters: navigation over the interval that ends here, C_b^n' ``(runs, 3, 3)``,
    star directions on n ``(2, 3)``, square root of R ``(8, 8)``."""

    interval: Navigation
    attitude: Array
    stars: Array
    sqrt_R: Array


class Scenario(NamedTuple):
    """Simulated runs: ``truth (T, runs, 13)``; ``z (T, runs, 8)``, star residuals and position, nan
    without a fix."""

    config: Config
    truth: Array
    z: Array
    prior: Gaussian

    def interval(self, k: int) -> Navigation:
        """Navigation solution in the middle of the interval that ends at epoch ``k``, with the
        system's errors of the epoch before. The first epoch has no interval: its own solution."""
        x = self.truth[max(k - 1, 0)]
        return misalignment.navigation(self.config.flight, max(2 * k - 1, 0), x[:, PHI], x[:, BIAS])

    def epochs(self) -> Iterator[Epoch]:
        """Epochs with `Inputs`, which depend on the system's errors at this epoch and the previous
        epoch."""
        c = self.config
        flight = c.flight
        star = np.full(6, radians(c.star_arcsec / 3600.0))
        for k, t in enumerate(c.times.tolist()):
            x = self.truth[k]
            attitude = flight.attitude[2 * k]
            computed = misalignment.misalignment_matrix(x[:, PHI]) @ attitude
            fix = c.sar_m / c.meters(flight.latitude[2 * k])
            stars = BORESIGHTS @ attitude.T
            u = Inputs(self.interval(k), computed, stars, np.diag([*star, *fix]))
            yield Epoch(k, t, c.step_s if k else 0.0, u, self.z[k], x)


def simulate(
    config: Config,
    rngs: Rngs,
    advance: Callable[[Array, Navigation, float], Array] = misalignment.advance,
    free: Sequence[int] = range(13),
) -> Scenario:
    """One run for each generator, with initial errors from the prior, process and measurement
    noise.

    advance: one step of the errors. free: indices of states with errors; the others stay zero.
    """
    T = config.steps + 1
    has_error = np.isin(range(13), free)
    initial, walk, z = normals(rngs, (13,), (config.steps, 5), (T, 8))
    truth = np.empty((T, len(rngs), 13))
    w = walk @ config.sqrt_Q.T
    truth[0] = initial * config.sigma0 * has_error
    prior = Gaussian(np.zeros(truth.shape[1:]), np.diag(config.sigma0**2))
    runs = Scenario(config, truth, z, prior)
    for k in range(1, T):
        after = advance(truth[k - 1], runs.interval(k), config.step_s)
        truth[k] = (after + w[k - 1]) * has_error
    for epoch in runs.epochs():
        z[epoch.k] = measurement(epoch.truth, epoch) + epoch.z * epoch.u.sqrt_R.diagonal()
    z[np.arange(T) % config.star_interval != 0, :, :6] = np.nan
    z[np.arange(T) % config.sar_interval != 0, :, 6:] = np.nan
    return runs


# -- the filters -----------------------------------------------------------------------------------
def dynamics(x: Array, epoch: Epoch) -> Array:
    """One step of the error model. A sigma point with phi_x beyond 89 degrees becomes nan, and its
    run fails."""
    y = misalignment.advance(x, epoch.u.interval, epoch.dt)
    if is_concretely_true(np.abs(x[..., 0]).max() >= misalignment.SINGULAR):
        y = np.where(np.abs(x[..., :1]) < misalignment.SINGULAR, y, np.nan)
    return y


def measurement(x: Array, epoch: Epoch) -> Array:
    """Two star residuals and the position, ``(..., 8)`` [Liang2014, Eqs. 26-28]."""
    out = np.empty_like(x, shape=(*x.shape[:-1], 8))  # with the memory layout of x
    out[..., :6] = misalignment.star_residuals(x, epoch.u.attitude, epoch.u.stars)
    out[..., 6:] = x[..., POSITION]
    return out


def model(config: Config) -> tuple[Motion, Sensor]:
    """Motion and sensor of the filters."""
    sensor = Sensor(measurement, sqrt_R=lambda _, epoch: epoch.u.sqrt_R)
    return Motion(dynamics, sqrt_Q=config.sqrt_Q), sensor


@cache
def rules(level: int = 3) -> dict[str, Any]:
    """Rules in 13 dimensions.

    ukf: kappa = 3 - n. sghqf: isotropic sparse grid. aasghqf: weights of Table 2. nonlinear: weight
    1 for the misalignment only. delayed: 1, 3 and 3 points by level. ghqf3, ghqf5: tensor rules,
    marginalized over the ten linear states.
    """
    return {
        "ukf": unscented(13, kappa=-10.0),
        "sghqf": smolyak(13, level),
        "aasghqf": smolyak(13, level, PAPER_WEIGHTS),
        "nonlinear": smolyak(13, level, NONLINEAR_WEIGHTS),
        "delayed": smolyak(13, level, orders=DELAYED),
        "ckf": cubature(13),
        "ckf5": cubature(13, 5),
        "ghqf3": tensor_product(gauss_hermite(3, 3), simplex(10)),
        "ghqf5": tensor_product(gauss_hermite(3, 5), simplex(10)),
        "ekf": Taylor(),
    }


def quadrature_filter(rule: Any, config: Config) -> Filter:
    """A filter with any rule. If negative weights make a covariance indefinite, the filter repeats
    the step with the rule "ghqf3", whose weights are positive."""
    by_rule = partial(sigma_point, *model(config), form=FORM)
    if not isinstance(rule, Rule) or (rule.wc >= 0.0).all():
        return by_rule(rule=rule)
    return Fallback(by_rule(rule=rule), by_rule(rule=rules(config.level)["ghqf3"]))


def filters(config: Config) -> dict[str, Filter]:
    """The filters by name: one for each of the `rules`, and triad-ekf. The latter linearizes the
    first star fix about the attitude that the fix itself gives (Wahba's problem)."""
    plain = ekf(*model(config), form=FORM)
    wahba = Iterated(**vars(plain), iterations=1, first=wahba_start)

    def step(state: Any, epoch: Epoch) -> Any:
        return (plain if epoch.k else wahba).step(state, epoch)

    return {
        **{name: quadrature_filter(rule, config) for name, rule in rules(config.level).items()},
        "triad-ekf": FromFunctions(plain.start, step),
    }


def wahba_start(belief: Belief, z: Array, epoch: Epoch) -> Array:
    """The prior mean, but with the misalignment from both star vectors. Beyond phi_x = 90 deg the
    angles are on another branch."""
    at = np.array(np.broadcast_to(belief.mean, (*z.shape[:-1], 13)))
    at[..., PHI] = misalignment.wahba_misalignment(z[..., :6], epoch.u.attitude, epoch.u.stars)
    return at


# -- weights that change along the flight ----------------------------------------------------------
Choose = Callable[[Any, Epoch, Array | None], Array]
BITS = 1 << np.arange(13)
"""Weights encoded as a number: one bit for each state with weight 1."""


def ones(chosen: Array | None) -> Array:
    """Mask ``(..., 13)`` of the states with weight 1; all False before the first choice."""
    return np.asarray(np.asarray(0 if chosen is None else chosen)[..., None] & BITS) > 0


def observability(x: Array, epoch: Epoch, units: tuple[Array, Array], order: int = 3) -> Array:
    """Observability matrix ``(..., 8 (order + 1), 13)`` at states ``(..., 13)``; ``units``: of
    states and outputs."""
    states, outputs = units
    F = (
        jacobian(lambda x: misalignment.derivative(x, epoch.u.interval), x)
        * states
        / states[:, None]
    )
    H = jacobian(lambda x: measurement(x, epoch), x) * states * outputs[:, None]
    return observability_matrix(F, H, order)


def by_observability(config: Config, threshold: float = 5.0, *, weigh: bool = False) -> Choose:
    """Weights by Eqs. 15 and 19 at the estimate, with degrees relative to the degree of the east
    velocity. weigh: whether singular vectors are weighted by the filter's covariance.

    If no state is above the threshold, the weights do not change: weights that are all 2 would give
    the isotropic rule, with which the filter starts.
    """

    def choose(belief: Any, epoch: Epoch, chosen: Array | None) -> Array:
        cov = belief.cov / np.multiply.outer(config.units[0], config.units[0]) if weigh else None
        values = state_singular_values(observability(belief.mean, epoch, config.units), cov)
        above = hysteresis(values / values[..., 3:4], threshold, ones(chosen)) @ BITS
        return np.where(above, above, BITS.sum() if chosen is None else chosen)

    return choose


def by_nonlinearity(threshold: float = 0.1) -> Choose:
    """Weight 1 for states whose nonlinearity exceeds the threshold, in the star residuals (in σ of
    their noise) or in one step of the dynamics (in σ of the belief)."""

    def choose(belief: Any, epoch: Epoch, chosen: Array | None) -> Array:
        x = belief.mean
        std = belief.std
        noise = epoch.u.sqrt_R.diagonal()
        degree = nonlinearity_degree(lambda x: measurement(x, epoch), x, std, noise)
        if epoch.dt:
            after = lambda x: misalignment.advance(x, epoch.u.interval, epoch.dt)  # noqa: E731
            degree = np.maximum(degree, nonlinearity_degree(after, x, std, std))
        return np.asarray(hysteresis(degree, threshold, ones(chosen)) @ BITS)

    return choose


@cache
def weighted(number: int, level: int = 3) -> Rule:
    """The rule for a number whose bits mark the states with weight 1. For 0 the level is 2, as for
    the UKF."""
    return smolyak(13, level, np.where(number & BITS, 1, 2).tolist()) if number else smolyak(13, 2)


def adaptive(choose: Choose, config: Config) -> Switching:
    """A filter that chooses its weights before each step, separately for each run."""
    return Switching(
        cache(lambda number: quadrature_filter(weighted(number, config.level), config)), choose
    )


# -- the star sensors' mounting --------------------------------------------------------------------
def mounted(sim: Scenario, errors: Array) -> Scenario:
    """The runs with mounting errors ``(runs, 2, 3)`` rad that the filters do not model
    [Liang2014, Eqs. 26-28]; the stars are on the boresights."""
    stars = np.tile(BORESIGHTS, (len(errors), 1))
    turned = Rotation.from_rotvec(errors.reshape(-1, 3)).apply(stars) - stars
    return sim._replace(z=sim.z + np.pad(turned.reshape(-1, 6), ((0, 0), (0, 2))))


def mounting_filter(config: Config, sigma: float, runs: int = 1) -> tuple[Filter, Gaussian]:
    """A filter with 19 states, of which the last six are mounting errors with standard deviation
    ``sigma`` rad, and its prior."""

    def h(x: Array, epoch: Epoch) -> Array:
        z = measurement(x[..., :13], epoch)
        angles = x[..., 13:].reshape(*x.shape[:-1], 2, 3)
        on_body = z[..., :6].reshape(angles.shape) + epoch.u.stars @ epoch.u.attitude
        z[..., :6] += np.cross(angles, on_body).reshape(*x.shape[:-1], 6)
        return z

    def f(x: Array, epoch: Epoch) -> Array:
        return side_by_side([dynamics(x[..., :13], epoch), x[..., 13:]])

    motion = Motion(f, sqrt_Q=np.pad(config.sqrt_Q, ((0, 6), (0, 0))))
    rule = smolyak(19, config.level, (1,) * 3 + (2,) * 16)
    filter = sigma_point(motion, replace(model(config)[1], h=h), rule=rule, form=FORM)
    std = np.r_[config.sigma0, [sigma] * 6]
    return filter, Gaussian(np.zeros((runs, 19)), np.diag(std**2))


# -- six states, for which a tensor rule is feasible -----------------------------------------------
SIX = [0, 1, 2, 5, 6, 9]
"""Misalignment, position, and the drift of the vertical gyro (chosen). A tensor rule of these six
states has 729 points."""


def euler(x: Array, nav: Navigation, dt: float) -> Array:
    """One Euler step of the error model, for states without velocity errors. It does not add half a
    step of acceleration to the position."""
    return x + dt * misalignment.derivative(x, nav)


@cache
def six_rules() -> dict[str, Rule]:
    """Rules in six dimensions, as in `rules`: UKF with kappa = 3 - n, isotropic sparse grid, tensor
    rule with three points per dimension."""
    return {
        "six/ukf": unscented(6, kappa=-3.0),
        "six/sghqf": smolyak(6, 3),
        "six/ghqf": gauss_hermite(6, 3),
    }


def six_states(config: Config, rngs: Rngs) -> tuple[Scenario, dict[str, Any], Gaussian]:
    """The flight with errors of the states `SIX` only; filters with these states (ekf, ukf, sghqf,
    ghqf), and their prior."""
    sim = simulate(config, rngs, euler, SIX)

    def widened(x: Array) -> Array:
        out = np.zeros_like(x, shape=(*x.shape[:-1], 13))
        out[..., SIX] = x
        return out

    def f(x: Array, epoch: Epoch) -> Array:
        return euler(widened(x), epoch.u.interval, epoch.dt)[..., SIX]

    motion = Motion(f, sqrt_Q=config.sqrt_Q[SIX])
    sensor = replace(model(config)[1], h=lambda x, epoch: measurement(widened(x), epoch))
    ukf, sghqf, ghqf = (
        sigma_point(motion, sensor, rule=rule, form=FORM) for rule in six_rules().values()
    )
    by_name = {
        "ekf": ekf(motion, sensor, form=FORM),
        "ghqf": ghqf,
        "ukf": Fallback(ukf, ghqf),
        "sghqf": Fallback(sghqf, ghqf),
    }
    return sim, by_name, Gaussian(sim.prior.mean[:, SIX], np.diag(config.sigma0[SIX] ** 2))


# -- evaluation ------------------------------------------------------------------------------------
def groups(config: Config, angle: float = DEGREE / 60.0, unit: str = "arcmin") -> tuple[Group, ...]:
    """Groups of states that are evaluated; ``angle``: unit of the misalignment in radians."""
    return (
        Group("misalignment", unit, PHI, 1.0 / angle),
        Group("velocity", "m/s", VELOCITY),
        Group("position", "m", POSITION, tuple(config.meters().tolist())),
        Group("drift", "deg/h", DRIFT, 3600.0 / DEGREE),
        Group("bias", "ug", BIAS, 1.0 / MICRO_G),
    )


JUDGED = {group.name: group.unit for group in groups(A)}


def trial(config: Config, rngs: Rngs) -> Trial:
    """One run for each generator, for missions, campaigns and the study."""
    return trial_of(simulate(config, rngs))


def trial_of(sim: Scenario, *unit: Any) -> Trial:
    """The trial of simulated runs; ``unit``: of the misalignment, see `groups`."""
    return Trial(
        groups(sim.config, *unit),
        filters(sim.config),
        sim.prior,
        lambda _name: sim.epochs(),
        # The first 13 states. Their square root is the leading block of the lower triangular one.
        lambda truth, belief: (belief.mean[..., :13] - truth, belief.sqrt_cov[..., :13, :13]),
        "ekf",
    )
