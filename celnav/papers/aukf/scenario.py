"""Truth, satellites, measurements, and the filters that the paper and this study compare."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from pymap3d import geodetic2ecef

from celnav.filters.joint import Hook
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter
from celnav.filters.sequential import sigma_point
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule, Taylor, unscented
from celnav.models import pseudorange
from celnav.models.beidou import ELLIPSOID
from celnav.papers.aukf.config import Config
from celnav.papers.aukf.constellation import synthetic
from celnav.receiver.filters import hooks
from celnav.receiver.least_squares import least_squares
from celnav.receiver.sky import local_axes, look
from celnav.study.montecarlo import normals

TOE_S = 345600.0
START_S = TOE_S + 1800.0
"""First epoch, BDT seconds of its first week."""


class Satellites(NamedTuple):
    """The visible satellites along the track: names, ``q, w (T, S, 3)``, elevations ``(T, S)`` rad; see `pseudorange.Sources`."""

    names: list[str]
    q: Array
    w: Array
    elevation: Array


class Scenario(NamedTuple):
    """Simulated runs, time-major.

    Attributes
    ----------
    truth: ``(T, runs, 8)``. z: ``(T, runs, 2 S)``, ranges then rates, nan below the mask.
    """

    config: Config
    truth: Array
    z: Array
    satellites: Satellites
    prior: Gaussian

    def epochs(self) -> Iterator[Epoch]:
        """Epochs; ``u`` is ``(q, w)`` at the epoch's time."""
        times, dt = self.config.times.tolist(), self.config.interval_s
        for k, (t, z, truth) in enumerate(zip(times, self.z, self.truth, strict=True)):
            yield Epoch(k, t, dt if k else 0.0, (self.satellites.q[k], self.satellites.w[k]), z, truth)


def axes(config: Config) -> Array:
    """East, north, up at the middle of the circle, the rows of ``(3, 3)``."""
    latitude, longitude = np.radians([config.latitude_deg, config.longitude_deg]).tolist()
    return local_axes(latitude, longitude)


def circle(config: Config) -> tuple[Array, Array]:
    """Positions and velocities ``(T, 3)`` on the track, Earth-fixed."""
    east, north, _ = axes(config)
    angle = (config.turn_rate * config.times)[:, None]
    middle = np.array(geodetic2ecef(config.latitude_deg, config.longitude_deg, config.height_m, ell=ELLIPSOID))
    position = middle + config.radius_m * (np.cos(angle) * east + np.sin(angle) * north)
    return position, config.speed_m_per_s * (np.cos(angle) * north - np.sin(angle) * east)


def visible(config: Config) -> Satellites:
    """The synthetic constellation along the track, those that are above the mask at some time."""
    broadcast, (position, velocity) = synthetic(TOE_S), circle(config)
    seen = pseudorange.sources(broadcast, START_S + config.times, position, velocity)
    up = look(seen.q, position, axes(config)).elevation
    chosen = (up >= np.radians(config.mask_deg)).any(0)
    return Satellites(broadcast.chosen(chosen).names, seen.q[:, chosen], seen.w[:, chosen], up[:, chosen])


def simulate(config: Config, rngs: Sequence[np.random.Generator]) -> Scenario:
    """Simulate one run with each generator: the track is the same, clock, noise and initial error are its own."""
    c, satellites, (position, velocity) = config, visible(config), circle(config)
    T, S, runs = len(c.times), len(satellites.names), len(rngs)
    first, walk, noise, extra = normals(rngs, (8,), (T, 2), (T, 2 * S), (T, 2 * S))
    F, root = c.F[6:, 6:], np.linalg.cholesky(c.Q[6:, 6:])
    truth = np.empty((T, runs, 8))
    truth[..., :3], truth[..., 3:6] = position[:, None], velocity[:, None]
    clock = np.tile([c.bias_m, c.drift_m_per_s], (runs, 1))
    for k in range(T):
        if k:
            clock = clock @ F.T + walk[k] @ root.T
        truth[k, :, 6:] = clock
    z = pseudorange.measure(truth, satellites.q[:, None], satellites.w[:, None])
    z += np.repeat([c.true_sigma_range_m, c.sigma_rate_m_per_s], S) * noise + burst(c, S)[:, None] * extra
    z[np.tile(satellites.elevation < np.radians(c.mask_deg), 2)[:, None].repeat(runs, 1)] = np.nan
    prior = truth[0] + first * np.sqrt(c.P0.diagonal())
    return Scenario(c, truth, z, satellites, Gaussian(prior, np.broadcast_to(c.P0, (runs, 8, 8))))


def burst(config: Config, S: int) -> Array:
    """Deviations ``(T, 2 S)`` of the noise that the burst adds.

    Raises
    ------
    ValueError: if there is no such satellite.
    """
    during = (config.times >= config.burst_s[0]) & (config.times < config.burst_s[1])
    hit = np.zeros(2 * S)
    if config.burst == "one":
        if config.burst_satellite >= S:
            raise ValueError(f"burst_satellite: expected a place below {S}, the number of satellites, got {config.burst_satellite}")
        hit[config.burst_satellite] = 1.0
    elif config.burst != "none":
        hit[: S if config.burst == "ranges" else 2 * S] = 1.0
    return np.asarray(config.burst_sigma * during[:, None] * hit)


def side_by_side(sims: Sequence[Scenario]) -> Scenario:
    """Scenarios of the same epochs and satellites as one, their runs one after the other."""
    truth, z = (np.concatenate([getattr(sim, name) for sim in sims], 1) for name in ("truth", "z"))
    mean, cov = (np.concatenate([getattr(sim.prior, name) for sim in sims]) for name in ("mean", "cov"))
    return sims[0]._replace(truth=truth, z=z, prior=Gaussian(mean, cov))


EKF = Taylor()


def _measured(x: Array, epoch: Epoch) -> Array:
    return pseudorange.measure(x, *epoch.u)


def _slope(x: Array, epoch: Epoch) -> Array:
    return pseudorange.jacobian(x, *epoch.u)


def _late_slope(x: Array, epoch: Epoch) -> Array:
    """At where the receiver was an interval ago."""
    before = x.copy()
    before[..., :3] -= epoch.dt * x[..., 3:6]
    return _slope(before, epoch)


def ukf(config: Config) -> Rule:
    """The rule of all unscented filters."""
    return unscented(8, config.alpha, config.beta, 0.0)


def sensor(sigma: Array, *, late: bool = False) -> Sensor:
    """Ranges and rates with deviations ``sigma (2 S,)``; ``late``: their Jacobian is that at the last estimate."""
    return Sensor(_measured, np.diag(sigma**2), jacobian=_late_slope if late else _slope)


def adapted(config: Config, S: int, rule: Any, *hook: Hook, Q: Array | None = None, late: bool = False) -> Filter:
    """A filter of the paper's model: constant velocity, which every rule moves alike, and the measurement by a rule.

    ``Q``: process noise ``(..., 8, 8)`` instead of the configuration's, with one for each run if it has that axis. ``late``: see
    `sensor`.
    """
    motion = Motion(config.F, config.Q if Q is None else Q)
    return sigma_point(motion, sensor(config.sigma(S), late=late), rule=rule, form="covariance", hooks=hook)


def filters(config: Config) -> dict[str, Filter]:
    """The filters by name, for the satellites that are visible in this configuration.

    ls: every epoch by itself. ekf, ukf. aukf: the paper's, adapted by a window of innovations. group, channel: adapted by what no
    state explains. gate, huber, student, sage-husa: baselines. Those after ukf are unscented too.
    """
    S = len(visible(config).names)
    out: dict[str, Filter] = {"ls": least_squares(sensor(config.sigma(S))), "ekf": adapted(config, S, EKF)}
    return out | {name: adapted(config, S, ukf(config), *hook) for name, hook in hooks(S, config.window).items()}
