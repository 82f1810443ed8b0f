"""A car with a consumer's inertial unit and RTK fixes, of which 15 s are withheld again and again
[GnssImu2025].

Settings are the data sheet's, those of the receiver, and the noise of the first half minute, in
which the car stands; a factor of the noise is the most probable of `FACTORS` for the fixes of the
first two minutes outside of outages. Which further states and sensors there are was decided after
outages had been seen, with the first values that were tried; so was that a factor is needed. How
the unit is mounted, and that its samples are late by `LATE_S`, is its owner's, as are the outages.
Standstill is left out: with the engine on a rest shakes as much as a smooth ride.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import celnav
from celnav.filters.merge import Merged, merge
from celnav.filters.run import run
from celnav.gaussian import attitude
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.models import earth, inertial
from celnav.real import found
from celnav.real.drive import read_imu, read_pos

MOUNT = np.radians([180.0, -6.79, 185.35])  # roll, pitch, yaw of the unit's axes against the car's
LEVER = np.array([0.0, -0.05, 0.0])  # m, from the unit to the antenna: forward, right, down
LATE_S = 0.125
GYRO_WALK = np.radians(3.8e-5)  # of the data sheet
ACCELEROMETER_WALK = 7.0 * inertial.MICRO_G
REST_S, TUNED_S = 30.0, 120.0
FACTORS = (1.0, 2.0, 3.0, 4.0)
FACTOR = 3.0
"""The most probable of them."""
BIASES = {"gyro_bias": np.radians(0.2), "accelerometer_bias": 0.2}
FIX = {"sigma_position": 0.01, "sigma_velocity": 0.0577}  # as the receiver claims
START = {
    "sigma_level": 0.03,
    "sigma_heading": np.radians(10.0),
    "sigma_velocity": 0.1,
    "sigma_position": 0.05,
}
MOVES = 1.0  # m/s, from which on the course is the heading
FIRST_S, LENGTH_S, LAST_S = 40.0, 15.0, 30.0  # of outages; twice as long on as off
MORE = {"lag": 0.05, "lever": 0.1, "mount": np.radians(2.0), "axle": 1.0}
SIDEWAYS, SIDEWAYS_S, AXLE = 0.1, 0.25, np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Drive:
    """A filter on the log of a folder.

    kind: name of a filter. error: see `celnav.models.inertial.strapdown`. constrained: with the
    states `MORE` and a sideways speed of zero. factor: of the white noise at rest. end_s: of the
    log. smoothed: whether to smooth.
    """

    folder: Path
    kind: str = "ekf"
    error: str = "invariant"
    constrained: bool = False
    factor: float = 1.0
    end_s: float = np.inf
    smoothed: bool = False


class Log(NamedTuple):
    """What was measured, s since the first fix, on forward, right, down; fixes on north, east,
    down at the first one, ``(T, 6)`` of position and velocity.
    """

    t: Array
    rate: Array
    force: Array
    t_fix: Array
    fixes: Array
    fixed: Array
    latitude: float
    height_m: float


def log(folder: Path) -> Log:
    """The log of a folder."""
    table, tags, solution = found(folder, ["imu*.csv*", "imu*.tag", "gnss*.pos*"])
    fixes, samples = read_pos(solution), read_imu(table, tags)
    origin = fixes.latitude[0], fixes.longitude[0], fixes.height_m[0]
    p = earth.local_position(fixes.latitude, fixes.longitude, fixes.height_m, origin)
    mounted, start = attitude.from_euler(MOUNT), fixes.t[0]
    return Log(
        samples.t - start - LATE_S,
        attitude.rotate(mounted, samples.rate),
        attitude.rotate(mounted, samples.force),
        fixes.t - start,
        np.concatenate([p, fixes.velocity], -1),
        fixes.quality == 1,
        float(origin[0]),
        float(origin[2]),
    )


def outages(t_fix: Array) -> Array:
    """First and last times ``(K, 2)`` of the outages, by the unit's late clock."""
    end = t_fix[-1] - LAST_S
    first = np.arange(FIRST_S, end, 3.0 * LENGTH_S)
    return np.stack([first, np.minimum(first + LENGTH_S, end)], -1) - LATE_S


def withheld(t_fix: Array) -> Array:
    """Numbers of the outages in which fixes are, -1 for none."""
    inside = [(t_fix > first) & (t_fix <= last) for first, last in outages(t_fix)]
    return np.where(np.any(inside, 0), np.argmax(inside, 0), -1)


def system(log: Log, config: Drive) -> inertial.Strapdown:
    """The strapdown system, with the noise of the rest at the start."""
    rest = log.t < log.t[0] + REST_S
    imu = inertial.Imu.at_rest(
        log.t[rest],
        log.rate[rest],
        log.force[rest],
        **BIASES,
        gyro_walk=GYRO_WALK,
        accelerometer_walk=ACCELEROMETER_WALK,
    )
    imu = replace(
        imu,
        gyro_noise=config.factor * imu.gyro_noise,
        accelerometer_noise=config.factor * imu.accelerometer_noise,
    )
    states = MORE if config.constrained else {}
    return inertial.strapdown(log.latitude, log.height_m, imu, states, error=config.error)


def task(log: Log, config: Drive) -> tuple[Any, Gaussian, Merged, inertial.Strapdown]:
    """Filter, prior, and what it is given."""
    made = system(log, config)
    used = log.fixed & (withheld(log.t_fix) < 0) & (log.t_fix <= config.end_s)
    own = log.t <= min(config.end_s, log.t_fix[-1])
    t, inputs = log.t[own], (log.rate[own], log.force[own])
    moving = int(np.flatnonzero(used & (np.hypot(*log.fixes[:, 3:5].T) > MOVES))[0])
    first = int(np.searchsorted(log.t_fix, t[0]))
    prior = made.prior(
        inertial.level(log.force[log.t < t[0] + 1.0].mean(0)),
        np.arctan2(log.fixes[moving, 4], log.fixes[moving, 3]),
        position=log.fixes[first, :3],
        velocity=log.fixes[first, 3:],
        **START,
    )
    sensors = [made.gnss(LEVER, **FIX)]
    streams: dict[str, Any] = {"fixes": (log.t_fix[used], log.fixes[used])}
    if config.constrained:
        rolling = np.arange(log.t_fix[moving], t[-1], SIDEWAYS_S)
        sensors.append(made.sideways(SIDEWAYS, lever=AXLE))
        streams["sideways"] = rolling, np.zeros((len(rolling), 2))
    filter = getattr(celnav, config.kind)(made.motion, *sensors)
    return filter, prior, merge(imu=(t, inputs), trim=True, **streams), made


def probable(config: Drive, _rngs: Sequence[Any]) -> dict[str, Array]:
    """Log-likelihood of the fixes of the first `TUNED_S`, with each of `FACTORS`."""
    measured = log(config.folder)
    values = []
    for factor in FACTORS:
        filter, prior, merged, _ = task(measured, replace(config, factor=factor, end_s=TUNED_S))
        values.append(float(run(filter, prior, *merged, keep="nothing").log_likelihood))
    return {"log_likelihood": np.array(values)}
