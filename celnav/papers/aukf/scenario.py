"""[Fan]: a receiver on a circle with 4 g determines its position from BeiDou pseudoranges and range
rates.

Our copy of the paper lacks the display equations and Table 1. We use `celnav.models.pseudorange`
and `celnav.models.gnss` (measurements, orbits), `celnav.receiver.filters.transition` (constant
velocity), `celnav.receiver.least_squares` (each epoch by itself) and
`celnav.filters.adaptive.innovation_window` (the adaptive filter).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.joint import Hook
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter
from celnav.filters.sequential import Sequential, sigma_point
from celnav.filters.track import Track
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import number
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule, Taylor, unscented
from celnav.models import pseudorange
from celnav.papers import citation
from celnav.receiver.constellation import TOE_S, synthetic
from celnav.receiver.filters import CRYSTAL, hooks, process_noise, transition
from celnav.receiver.geodesy import ELLIPSOID, geodetic2ecef
from celnav.receiver.least_squares import least_squares
from celnav.receiver.sky import local_axes, look
from celnav.study.montecarlo import normals, steps
from celnav.study.parameters import Timed, param
from celnav.study.trial import Group, Trial

__all__ = [
    "CITATION",
    "GROUPS",
    "JUDGED",
    "PRESETS",
    "STANDARD",
    "START_S",
    "TITLE",
    "Config",
    "adapted",
    "axes",
    "burst",
    "circle",
    "filters",
    "noise_factors",
    "simulate",
    "trial",
    "ukf",
    "visible",
]

TITLE = "Adaptive unscented Kalman filter for BeiDou positioning"
CITATION = citation("Fan")
STANDARD_GRAVITY = 9.80665
START_S = TOE_S + 1800.0
"""First epoch, BDT seconds of its first week."""


@dataclass(frozen=True)
class Config(Timed):
    """All parameters of a run."""

    speed_m_per_s: float = param(
        400.0, "paper", "speed of the receiver on a level circle", above=0.0
    )
    acceleration_g: float = param(
        4.0, "paper", "acceleration towards the center of the circle", above=0.0
    )
    height_m: float = param(800.0, "paper", "height of the circle above the ellipsoid")
    latitude_deg: float = param(
        32.03, "inferred: the authors' city", "latitude of the circle", least=-90.0, most=90.0
    )
    longitude_deg: float = param(
        118.85, "inferred: the authors' city", "longitude of the circle", least=-360.0, most=360.0
    )
    interval_s: float = param(
        0.1,
        "chosen: at 10 Hz the paper's result in the burst appears",
        "interval between measurements",
        above=0.0,
    )
    duration_s: float = param(90.0, "chosen", "duration of a run", above=0.0)
    mask_deg: float = param(
        10.0, "chosen", "smallest elevation of the satellites", least=0.0, below=90.0
    )
    sigma_range_m: float = param(
        3.0,
        "chosen",
        "standard deviation of a range that the filters assume",
        above=0.0,
    )
    sigma_rate_m_per_s: float = param(
        0.1, "chosen", "standard deviation of a range rate", above=0.0
    )
    true_sigma_range_m: float = param(
        3.0, "chosen", "true standard deviation of a range", above=0.0
    )
    burst: str = param(
        "ranges",
        "chosen: the paper does not say which channels",
        "measurements that a burst disturbs: none, all ranges, both ranges and rates, or ranges of "
        "one or more satellites (one)",
        one_of=("none", "ranges", "both", "one"),
    )
    motion: str = param(
        "circle",
        "paper",
        "motion of the receiver: on the circle, or random as in the filters' model",
        one_of=("circle", "model"),
    )
    turn_s: tuple[float, float] = param(
        (0.0, 1e6),
        "paper: always",
        "start and end of the turn; the track is straight before and after it",
    )
    burst_s: tuple[float, float] = param((60.0, 70.0), "paper", "start and end of the burst")
    burst_sigma: float = param(
        50.0, "paper: without a unit", "size of the burst, m on ranges and m/s on rates", above=0.0
    )
    burst_satellite: int = param(
        2, "chosen", "first satellite that a burst 'one' disturbs, counted from 0", least=0
    )
    burst_count: int = param(
        1,
        "chosen",
        "number of satellites that a burst 'one' disturbs, evenly spread from the first",
        least=1,
    )
    burst_shape: str = param(
        "noise",
        "paper",
        "what a burst adds: white noise of its size, or a constant of its size",
        one_of=("noise", "constant"),
    )
    acceleration_noise_m2_per_s3: float | None = param(
        None,
        "inferred: compensates a constant acceleration",
        "density of the white acceleration in the filters; if omitted, the square of the true "
        "acceleration times interval_s",
    )
    clock_white_m2_per_s: float = param(
        CRYSTAL[0], "chosen", "density of the white noise of the clock's frequency", least=0.0
    )
    clock_walk_m2_per_s3: float = param(
        CRYSTAL[1], "chosen", "density of the random walk of the clock's frequency", least=0.0
    )
    bias_m: float = param(3e4, "chosen", "true clock bias of the receiver at the start, as a range")
    drift_m_per_s: float = param(30.0, "chosen", "true clock drift at the start")
    deviation: tuple[float, float, float, float] = param(
        (10.0, 1.0, 10.0, 1.0),
        "chosen",
        "initial standard deviations: position (m), velocity (m/s), clock (m), its rate (m/s)",
        above=0.0,
    )
    assumed_m: float | None = param(
        None,
        "chosen",
        "initial standard deviation of position that the filters assume; if omitted, the true one",
    )
    window: int = param(
        10,
        "chosen: the paper says M",
        "epochs in the window of the adaptive filter",
        least=1,
        most=100_000,
    )
    alpha: float = param(1.0, "chosen", "spread of the sigma points", above=0.0)
    beta: float = param(
        2.0,
        "paper",
        "enters the covariance weight of the central sigma point; 2 is optimal for Gaussians",
    )
    runs: int = param(
        100, "chosen: the paper shows one", "runs of the Monte Carlo simulation", least=1
    )

    def check(self) -> None:
        """Check the density, the order of start and end of turn and burst, and the number of
        epochs."""
        number("acceleration_noise_m2_per_s3", self.acceleration_noise, 0.0)
        if self.assumed_m is not None:
            number("assumed_m", self.assumed_m, above=0.0)
        for name in ("turn_s", "burst_s"):
            if (span := getattr(self, name))[0] >= span[1]:
                raise ValueError(f"{name}: expected a start before an end, got {span!r}")
        steps("duration_s", self.duration_s / self.interval_s)

    @property
    def idle(self) -> dict[str, str]:
        """Parameters without effect in this configuration, and why."""
        if self.burst == "none":
            return dict.fromkeys(
                (name for name in vars(self) if name.startswith("burst_")), "without a burst"
            )
        why = "where the burst is not on one satellite"
        return {} if self.burst == "one" else {"burst_satellite": why, "burst_count": why}

    @property
    def times(self) -> Array:
        """Epochs ``(T,)`` s."""
        return self.interval_s * np.arange(round(self.duration_s / self.interval_s) + 1)

    @property
    def acceleration(self) -> float:
        """Acceleration towards the center of the circle, m/s^2."""
        return self.acceleration_g * STANDARD_GRAVITY

    def R(self, S: int) -> Array:
        """Covariance of S ranges and S rates that the filters assume, ``(2 S, 2 S)``."""
        return np.diag(np.repeat([self.sigma_range_m, self.sigma_rate_m_per_s], S) ** 2)

    @property
    def F(self) -> Array:
        """Constant velocity and clock drift over an interval, ``(8, 8)``."""
        return transition(self.interval_s)

    @property
    def acceleration_noise(self) -> float:
        """Spectral density of the white acceleration, m^2/s^3; by default ``a^2 T``, which accounts
        for a constant acceleration."""
        density = self.acceleration_noise_m2_per_s3
        return self.acceleration**2 * self.interval_s if density is None else density

    @property
    def Q(self) -> Array:
        """Process noise covariance of an interval, ``(8, 8)``."""
        return process_noise(
            self.interval_s,
            self.acceleration_noise,
            self.clock_white_m2_per_s,
            self.clock_walk_m2_per_s3,
        )

    @property
    def P0(self) -> Array:
        """Covariance of the prior that the filters assume, ``(8, 8)``."""
        position, velocity, bias, drift = self.deviation
        return np.diag(np.square([self.assumed_m or position] * 3 + [velocity] * 3 + [bias, drift]))


STANDARD = Config()
PRESETS = {
    "burst": STANDARD,
    "quiet": replace(STANDARD, burst="none"),
    "mistuned": replace(STANDARD, burst="none", true_sigma_range_m=10.0),
    "1 Hz": replace(STANDARD, interval_s=1.0),
}


def axes(config: Config) -> Array:
    """East, north and up at the center of the circle, as rows ``(3, 3)``."""
    return local_axes(*np.radians([config.latitude_deg, config.longitude_deg]).tolist())


def circle(config: Config) -> tuple[Array, Array]:
    """Positions and velocities ``(T, 3)`` on the track, Earth-fixed: the circle, and its tangents
    before and after the turn."""
    east, north, _ = axes(config)
    v = config.speed_m_per_s
    a = config.acceleration
    turned = np.clip(config.times, *np.minimum(config.turn_s, config.end_s))
    angle = (a / v * turned)[:, None]
    straight = (config.times - turned)[:, None]
    middle = np.array(
        geodetic2ecef(config.latitude_deg, config.longitude_deg, config.height_m, ell=ELLIPSOID)
    )
    velocity = v * (np.cos(angle) * north - np.sin(angle) * east)
    return middle + v**2 / a * (
        np.cos(angle) * east + np.sin(angle) * north
    ) + straight * velocity, velocity


class Satellites(NamedTuple):
    """The visible satellites along the track: names, ``q, w (T, S, 3)``, elevations ``(T, S)`` rad;
    see `pseudorange.Sources`."""

    names: list[str]
    q: Array
    w: Array
    elevation: Array


@lru_cache(maxsize=32)
def visible(config: Config) -> Satellites:
    """The satellites of the synthetic constellation that rise above the mask at some time."""
    broadcast = synthetic()
    position, velocity = circle(config)
    sources = pseudorange.sources(broadcast, START_S + config.times, position, velocity)
    up = look(sources.q, position, axes(config)).elevation
    chosen = (up >= np.radians(config.mask_deg)).any(0)
    return Satellites(
        broadcast.chosen(chosen).names, sources.q[:, chosen], sources.w[:, chosen], up[:, chosen]
    )


class Scenario(NamedTuple):
    """Simulated runs: ``truth (T, runs, 8)``, and ``z (T, runs, 2 S)``, ranges then rates, nan
    below the mask."""

    config: Config
    truth: Array
    z: Array
    satellites: Satellites
    prior: Gaussian

    def epochs(self) -> Iterator[Epoch]:
        """Epochs; ``u`` is ``(q, w)`` at the epoch's time."""
        times = self.config.times.tolist()
        dt = self.config.interval_s
        for k, (t, z, truth) in enumerate(zip(times, self.z, self.truth, strict=True)):
            yield Epoch(
                k, t, dt if k else 0.0, (self.satellites.q[k], self.satellites.w[k]), z, truth
            )


def simulate(config: Config, rngs: Sequence[np.random.Generator]) -> Scenario:
    """Simulate one run for each generator. All have the same track, but their own clock, noise and
    initial error."""
    c = config
    satellites = visible(config)
    position, velocity = circle(config)
    T = len(c.times)
    S = len(satellites.names)
    runs = len(rngs)
    first, walk, noise, extra = normals(rngs, (8,), (T, 2), (T, 2 * S), (T, 2 * S))
    truth = np.empty((T, runs, 8))
    moved = slice(6, 8)
    truth[..., :3], truth[..., 3:6], truth[0, :, 6:] = (
        position[:, None],
        velocity[:, None],
        [c.bias_m, c.drift_m_per_s],
    )
    if c.motion == "model":  # the satellites have the same positions as for the circle
        first, walk, noise = normals(rngs, (8,), (T, 8), (T, 2 * S))
        moved = slice(0, 8)
    F = c.F[moved, moved]
    root = np.linalg.cholesky(c.Q[moved, moved])
    for k in range(1, T):
        truth[k, :, moved] = truth[k - 1, :, moved] @ F.T + walk[k] @ root.T
    z = pseudorange.measure(truth, satellites.q[:, None], satellites.w[:, None])
    extra = extra if c.burst_shape == "noise" else np.ones(())
    z += (
        np.repeat([c.true_sigma_range_m, c.sigma_rate_m_per_s], S) * noise
        + burst(c, S)[:, None] * extra
    )
    z[np.tile(satellites.elevation < np.radians(c.mask_deg), 2)[:, None].repeat(runs, 1)] = np.nan
    prior = truth[0] + first * np.repeat(c.deviation, (3, 3, 1, 1))
    return Scenario(c, truth, z, satellites, Gaussian(prior, np.broadcast_to(c.P0, (runs, 8, 8))))


def burst(config: Config, S: int) -> Array:
    """Size ``(T, 2 S)`` of the burst; ValueError if there is no such satellite."""
    during = (config.times >= config.burst_s[0]) & (config.times < config.burst_s[1])
    hit = np.zeros(2 * S)
    if config.burst == "one":
        if config.burst_satellite >= S:
            raise ValueError(
                f"burst_satellite: expected an index below {S}, the number of satellites, got "
                f"{config.burst_satellite}"
            )
        hit[
            (config.burst_satellite + S * np.arange(config.burst_count) // config.burst_count) % S
        ] = 1.0
    elif config.burst != "none":
        hit[: S if config.burst == "ranges" else 2 * S] = 1.0
    return np.asarray(config.burst_sigma * during[:, None] * hit)


def ukf(config: Config) -> Rule:
    """The sigma-point rule of all unscented filters."""
    return unscented(8, config.alpha, config.beta, 0.0)


def adapted(config: Config, S: int, rule: Any, *hook: Hook, Q: Array | None = None) -> Sequential:
    """A filter with the paper's model for S satellites: constant velocity, which is linear, and a
    measurement with the ``rule``.

    Q: process noise covariance ``(..., 8, 8)`` that replaces the configuration's, optionally with
    one matrix per run.
    """
    sensor = Sensor(
        lambda x, epoch: pseudorange.measure(x, *epoch.u),
        config.R(S),
        jacobian=lambda x, epoch: pseudorange.jacobian(x, *epoch.u),
    )
    return sigma_point(
        Motion(config.F, config.Q if Q is None else Q),
        sensor,
        rule=rule,
        form="covariance",
        hooks=hook,
    )


def filters(config: Config, S: int | None = None, Q: Array | None = None) -> dict[str, Filter]:
    """The filters by name. S: number of satellites, by default the visible satellites; ``Q``: see
    `adapted`.

    ls: least squares for every epoch by itself. ekf, ukf. aukf: the paper's filter, adapted by a
    window of innovations. group, channel: adapted by the part of the residual that no state can
    explain. gate, huber, student, sage-husa: baselines. The filters after ukf are unscented too.
    """
    S = len(visible(config).names) if S is None else S
    rule = ukf(config)
    ekf = adapted(config, S, Taylor(), Q=Q)
    others = {
        name: adapted(config, S, rule, *hook, Q=Q) for name, hook in hooks(S, config.window).items()
    }
    return {"ls": least_squares(*ekf.sensors), "ekf": ekf, **others}


def noise_factors(track: Track, config: Config, S: int) -> Array:
    """Factors ``(T, ..., 2 S)`` of R in an adaptive filter's track; 1 for missing measurements."""
    R = track.extra["R"]
    return np.where(np.isnan(R), 1.0, R / config.R(S).diagonal())


GROUPS = (Group("position", "m", slice(0, 3)), Group("velocity", "m/s", slice(3, 6)))
JUDGED = {group.name: group.unit for group in GROUPS}


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """A trial with one run for each generator. There is no bound, because the track is not drawn
    from the filters' model."""
    sim = simulate(config, rngs)
    return Trial(
        GROUPS,
        filters(config),
        sim.prior,
        lambda _: sim.epochs(),
        lambda truth, belief: (belief.mean - truth, belief.sqrt_cov),
    )
