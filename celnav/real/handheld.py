"""A gyro, an accelerometer and a magnetometer in a hand, as BROAD [Laidig2021] has them: what is
read, and what is believed.

Earth axes are east, north (of the magnetic field) and up. The state has the attitude, the drift of
the gyro, velocity and position of the hand, the disturbance of the field, and constants. A step has
`STEP` samples: an eighth of a second. Those of the gyro are integrated, the others are turned to
its end and averaged, those of the magnetometer as of `LAG` samples before, which makes the
innovations of the trials `TUNED` most probable.

Five facts of physics shape the model:

- A hand stays within reach. The specific force is integrated twice, and a position is measured that
  is zero within the reach of an arm. No spectrum of the acceleration is assumed.
- The field differs from place to place, and a hand comes back to the same places, so that errors of
  the field do not average out. The magnetometer therefore measures heading only, from the
  horizontal field; inclination is that of gyro and accelerometer.
- What is left of a calibrated magnetometer's bias and misalignments counts as noise. As constants
  of the state they are mistaken for a field that changes as the hand turns.
- The axes of the gyro are not exactly those of the accelerometer: its scale factors and
  misalignments are constants of the state.
- A sensor at rest neither turns nor moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from celnav.files import InputError
from celnav.filters.adaptive import student_t
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Epochs, epochs
from celnav.filters.sequential import Sequential, ekf
from celnav.gaussian import attitude
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief, side_by_side, tria
from celnav.gaussian.spaces import EUCLIDEAN, Space, product
from celnav.models.gyro import Gyro
from celnav.real import found
from celnav.study.trial import Group, Trial

TRIALS = (
    "01_undisturbed_slow_rotation_A",
    "02_undisturbed_slow_rotation_B",
    "06_undisturbed_fast_rotation_A",
    "10_undisturbed_slow_translation_A",
    "15_undisturbed_fast_translation_A",
    "21_undisturbed_fast_combined",
    "24_disturbed_tapping_A",
    "28_disturbed_stationary_magnet_A",
)
TUNED = (TRIALS[0], TRIALS[3], TRIALS[5])
GRAVITY = 9.8127  # m/s^2, in Berlin
STEP, LAG = 36, 4  # samples
QUIET, SLOW = 0.05, 0.03  # m/s^2 and rad/s: what moves less than that for a second is at rest


# -- what was recorded -----------------------------------------------------------------------------
class Log(NamedTuple):
    """A trial in steps of ``dt`` s.

    rate: ``(T, 3)`` rad/s, turns as the samples of a step do together.
    acc, mag: ``(T, 3)`` m/s^2 and uT, means of the step on the axes at its end.
    lively: ``(T, 1)`` m/s^2, RMS of the specific force about its mean of the last second, on axes
        that the gyro keeps.
    still: ``(T, 3)`` rad/s, the rate where the sensor was at rest for a second, else nan.
    truth: ``(T, 4)``, nan where the cameras lost it. moving: ``(T,)``, where the benchmark judges.
    """

    rate: Array
    acc: Array
    mag: Array
    lively: Array
    still: Array
    truth: Array
    moving: Array
    dt: float


class Samples(NamedTuple):
    """What a file has: rate rad/s, specific force m/s^2 and field uT ``(S, 3)``, quaternions
    ``(S, 4)``, scalar first, ``(S, 1)`` positive where the benchmark judges, and the rate Hz."""

    gyr: Array
    acc: Array
    mag: Array
    q: Array
    moving: Array
    hz: float


def read(path: Path, lag: int = LAG) -> Log:
    """A trial from its MATLAB file in steps; ``lag``: of the magnetometer, samples."""
    gyr, acc, mag, q, moving, hz = samples(path, lag)
    return steps(gyr, acc, mag, hz, lag)._replace(
        truth=_unit(q)[STEP - 1 :: STEP], moving=moving[STEP - 1 :: STEP, 0] > 0.0
    )


def samples(path: Path, lag: int = LAG) -> Samples:
    """A trial from its MATLAB file.

    Raises InputError, naming the file and the field, for one that is damaged.
    """
    try:
        every = loadmat(path)
    except FileNotFoundError:
        raise
    except Exception as error:  # whatever it stumbles over
        raise InputError(f"{path}: expected a file of MATLAB 5, got another ({error})") from None

    def field(name: str, columns: int, least: int = 2 * STEP + lag) -> Array:
        if name not in every:
            raise InputError(
                f"{path}: expected a field {name}, got "
                f"{', '.join(key for key in every if key[0] != '_')}"
            )
        values = every[name]
        if (
            values.dtype.kind not in "fiub"
            or values.ndim != 2
            or values.shape[1] != columns
            or len(values) < least
        ):
            raise InputError(
                f"{path}: {name}: expected numbers ({least} or more, {columns}), got "
                f"{values.dtype} {values.shape}"
            )
        if not np.isfinite(values).any(0).all() or np.isinf(values).any():
            raise InputError(
                f"{path}: {name}: expected finite numbers or nan, got infinite ones or a column of "
                "nan only"
            )
        return np.asarray(values, np.float64)

    named = {"imu_gyr": 3, "imu_acc": 3, "imu_mag": 3, "opt_quat": 4, "movement": 1}
    gyr, acc, mag, q, moving = (field(name, columns) for name, columns in named.items())
    hz = float(field("sampling_rate", 1, 1)[0, 0])
    for name, values in zip(named, (gyr, acc, mag, q, moving), strict=True):
        if len(values) != len(gyr):
            raise InputError(
                f"{path}: {name}: expected as many rows as imu_gyr has, {len(gyr)}, got "
                f"{len(values)}"
            )
    if np.isnan(gyr).any() or not hz > 0.0:
        raise InputError(
            f"{path}: expected an imu_gyr without nan and a positive sampling_rate, got others"
        )
    if not (moving > 0.0).any():
        raise InputError(f"{path}: movement: expected some samples that are to be judged, got none")
    return Samples(gyr, acc, mag, q, moving, hz)


def _unit(q: Array) -> Array:
    """Quaternions, which files have scalar first; nan where there is none."""
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.roll(q, -1, -1) / np.where(norm > 0.5, norm, np.nan))


def steps(gyr: Array, acc: Array, mag: Array, hz: float, lag: int = LAG) -> Log:
    """Samples ``(S, 3)`` in steps of `STEP`, without their truth."""
    T = len(gyr) // STEP
    turned = np.concatenate(
        [np.tile(attitude.IDENTITY, (lag, 1)), attitude.exp(gyr[: T * STEP] / hz)]
    )
    turn, sums = np.tile(attitude.IDENTITY, (T, 1)), np.zeros((2, T, 3))
    rate = np.zeros((T, 3))
    for i in range(
        STEP - 1, -lag - 1, -1
    ):  # of a sample in its step, or before it; `turn` leads from there to the end
        for total, values, late in zip(sums, (acc, mag), (0, lag), strict=True):
            if 0 <= i + late < STEP:
                total += attitude.rotate(turn, values[i + late : T * STEP : STEP])
        turn = attitude.multiply(turn, turned[i + lag :: STEP][:T])
        rate = attitude.log(turn) * hz / STEP if i == 0 else rate
    mean, dt = sums / STEP, STEP / hz
    width = max(2, round(1.0 / dt))
    q, kept = attitude.IDENTITY, np.zeros((T, 3))
    for k, turn in enumerate(attitude.exp(rate * dt)):
        q = attitude.multiply(turn, q)
        force = attitude.rotate(attitude.inverse(q), mean[0, k])
        kept[k] = np.where(np.isfinite(force), force, kept[k - 1])
    lively = np.sqrt(_last(kept, width, kept[0]).var(-1).mean(-1, keepdims=True))
    fastest = _last(np.abs(rate), width, np.inf).max((-1, -2))[:, None]
    still = np.where((lively < QUIET) & (fastest < SLOW), rate, np.nan)
    unknown = np.full((T, 4), np.nan)
    return Log(rate, mean[0], mean[1], lively, still, unknown, np.ones(T, bool), dt)


def _last(values: Array, width: int, before: Any) -> Array:
    """The last values ``(T, 3, width)`` at each epoch, with a value before the first."""
    values = np.concatenate([np.zeros((width - 1, 3)) + before, values])
    return np.lib.stride_tricks.sliding_window_view(values, width, axis=0)


# -- what is believed ------------------------------------------------------------------------------
@dataclass(frozen=True)
class Settings:
    """Deviations and times, each one for all trials (or one for each run, ``(runs, 1)``).

    gyro: angle random walk, rad/s^(1/2). turning: that of errors which grow with the rate, for each
        rad/s: 0.1 % for a second.
    acc, shaking: white noise of a step, m/s^2, and that for each 1 m/s^2 of `Log.lively`.
    reach: m s^(1/2), deviation of the position from zero, if it is anew each second.
    mag: white noise of a step, uT.
    field, stir: deviation, uT, of the field's disturbance on Earth axes; the rate, 1/s, at which
        it is forgotten for each m/s^2 of `Log.lively`.
    acc_bias: deviation, m/s^2, of a constant on the sensor's axes.
    scale: that of scale factors and misalignments of the gyro.
    """

    gyro: Any
    turning: Any
    acc: Any
    shaking: Any
    reach: Any
    mag: Any
    field: Any
    stir: Any
    acc_bias: Any
    scale: Any


DRIFT, DRIFT_WALK = 0.01, 1e-5  # rad/s at the start, and rad/s^(3/2)
TREMOR, SWAY = 1e-3, 0.01  # rad/s and m/s, of a sensor at rest
SETTINGS = Settings(
    gyro=7.43e-05,
    turning=0.001,
    acc=0.006,
    shaking=0.02,
    reach=0.3,
    mag=0.85,
    field=0.668,
    stir=0.316,
    acc_bias=0.056,
    scale=0.00418,
)
Q, BIAS, V, P, D, H, ACC, SCALE = (
    slice(0, 4),
    slice(4, 7),
    slice(7, 10),
    slice(10, 13),
    slice(13, 16),
    slice(16, 17),
    slice(17, 20),
    slice(20, 29),
)
"""Of a state ``(..., 29)``: attitude, drift (rad/s), velocity (m/s) and position (m) of the hand,
disturbance and horizontal part of the field (uT), bias of the accelerometer, matrix of the gyro by
rows. Of deviations ``(..., 28)`` those of the attitude are three."""
N, NOISY = 28, np.eye(28)[:, [*range(9), *range(12, 15)]]


VECTORS = (V, P, D)


def together() -> Space:
    """Space of states whose deviations turn the vectors on Earth axes along with the attitude,
    ``(..., 41)``: about Earth axes.

    What a sensor sees of a vector then does not depend on the attitude's deviation, and a turn of
    everything about the vertical, of which nothing but the mean of the field tells, is the same
    deviation whatever the vectors are estimated to be [Barrau2017].
    """

    def plus(x: Array, d: Array) -> Array:
        turn = attitude.from_rodrigues(d[..., :3])
        back, q = attitude.inverse(turn), x[..., Q]
        turned = [
            attitude.rotate(back, x[..., part] + d[..., part.start - 1 : part.stop - 1])
            for part in VECTORS
        ]
        q = attitude.multiply(
            q * (1.5 - 0.5 * (q * q).sum(-1)[..., None]), turn
        )  # round-off does not add up
        return side_by_side(
            [q, x[..., BIAS] + d[..., 3:6], *turned, x[..., D.stop :] + d[..., D.stop - 1 :]]
        )

    def minus(b: Array, a: Array) -> Array:
        turn = attitude.multiply(attitude.inverse(a[..., Q]), b[..., Q])
        turned = [attitude.rotate(turn, b[..., part]) - a[..., part] for part in VECTORS]
        return side_by_side(
            [
                attitude.to_rodrigues(turn),
                b[..., BIAS] - a[..., BIAS],
                *turned,
                (b - a)[..., D.stop :],
            ]
        )

    return Space(plus, minus)


def apart() -> Space:
    """Space of states whose attitude deviates on the sensor's axes, and the rest by itself."""
    return product((attitude.attitude(), 4, 3), (EUCLIDEAN, N - 3, N - 3))


def by_rows(matrix: Array, vector: Array) -> Array:
    """Product of matrices, by rows ``(..., 9)``, with vectors ``(..., 3)``."""
    parts = [(matrix[..., i : i + 3] * vector).sum(-1)[..., None] for i in (0, 3, 6)]
    return side_by_side(parts)


def motion(s: Settings, space: Space) -> Motion:
    """How a state goes on; ``epoch.u`` is rate ``(..., 3)``, `Log.lively` ``(..., 1)``, specific
    force and field ``(..., 3)``, and whether the force was measured ``(..., 1)``.
    """
    perfect = Gyro(0.0, 0.0)

    def same_place(epoch: Epoch) -> Array:
        """Correlation of the field's disturbance over the interval."""
        return np.asarray(np.exp(-epoch.dt * s.stir * epoch.u[1]))

    def f(x: Array, epoch: Epoch) -> Array:
        rate = epoch.u[0] - by_rows(x[..., SCALE], epoch.u[0])
        turned = perfect.propagate(x[..., : BIAS.stop], rate, epoch.dt)
        force = on_earth(turned, epoch.u[2] - x[..., ACC])
        velocity = x[..., V] + epoch.dt * epoch.u[4] * (force - np.array([0.0, 0.0, GRAVITY]))
        position = x[..., P] + epoch.dt * x[..., V]
        field = same_place(epoch) * x[..., D]
        return side_by_side([turned, velocity, position, field, x[..., D.stop :]])

    def noise(_mean: Array, epoch: Epoch) -> Array:
        (rate, lively), dt = epoch.u[:2], epoch.dt
        turn = np.sqrt((s.gyro**2 + s.turning**2 * (rate * rate).sum(-1)[..., None]) * dt)
        force = np.sqrt(s.acc**2 + (s.shaking * lively) ** 2) * dt
        field = s.field * np.sqrt(1.0 - same_place(epoch) ** 2)
        std = side_by_side(
            [part + 0.0 * turn for part in (turn, DRIFT_WALK * np.sqrt(dt), force, field)]
        )
        return np.repeat(std, 3, -1)[..., None, :] * NOISY

    return Motion(f, sqrt_Q=noise, space=space)


def on_earth(x: Array, vector: Array) -> Array:
    """Vectors ``(..., 3)`` on the sensor's axes, turned to Earth axes by the states' attitudes."""
    return attitude.rotate(attitude.inverse(x[..., Q]), vector)


def sensors(s: Settings) -> tuple[Sensor, ...]:
    """Reach, velocity at rest, horizontal field, and gyro at rest; the first three measure 0."""

    def horizontal(x: Array, epoch: Epoch) -> Array:
        field = on_earth(x, epoch.u[3]) - x[..., D]
        return side_by_side([field[..., :1], field[..., 1:2] - x[..., H]])

    def by_heading(mean: Array, epoch: Epoch) -> Array:
        """Derivative of the horizontal field ``(..., 2, N)``, but none by an inclination."""
        field = on_earth(mean, epoch.u[3]) - mean[..., D]
        turned = side_by_side([-field[..., 1:2], field[..., :1]])
        return np.asarray(turned[..., None] * np.eye(N)[2] - np.eye(N)[[12, 13]] - NORTH)

    def reach(_mean: Array, epoch: Epoch) -> Array:
        return np.asarray(s.reach / np.sqrt(epoch.dt))[..., None] * np.eye(3)

    return (
        Sensor(partial(on_sensor, P), sqrt_R=reach),
        Sensor(partial(on_sensor, V), sqrt_R=SWAY * np.eye(3)),
        Sensor(
            horizontal,
            sqrt_R=lambda _mean, _epoch: np.asarray(s.mag)[..., None] * np.eye(2),
            jacobian=by_heading,
        ),
        Sensor(lambda x, _epoch: x[..., BIAS], sqrt_R=TREMOR * np.eye(3)),
    )


def on_sensor(part: slice, x: Array, _epoch: Epoch) -> Array:
    """A vector of states, on the sensor's axes: there it tells nothing of the attitude."""
    return attitude.rotate(x[..., Q], x[..., part])


NORTH = np.outer([0.0, 1.0], np.eye(N)[H.start - 1])


def filters(s: Settings = SETTINGS) -> dict[str, Sequential]:
    """The filters that are compared, by name, of the same model."""
    move, measured = motion(s, together()), sensors(s)
    doubted = [[], [], [student_t()], []]
    return {
        "mekf": ekf(move, *measured),
        "robust": ekf(move, *measured, hooks=doubted),
    }


def prior(logs: Sequence[Log], s: Settings = SETTINGS) -> Gaussian:
    """What is believed at the start of each trial, made of its first second, at rest, and of the
    field in a building.
    """
    count = round(1.0 / logs[0].dt)
    up, mag = (
        np.stack([np.nanmean(values[:count], 0) for values in each])
        for each in zip(*((x.acc, x.mag) for x in logs))
    )
    east = np.cross(mag, up)
    axes = np.stack(
        [
            part / np.linalg.norm(part, axis=-1, keepdims=True)
            for part in (east, np.cross(up, east), up)
        ],
        -1,
    )
    mean = np.zeros((len(logs), N + 1))
    mean[:, Q] = Rotation.from_matrix(axes.mT).as_quat()
    mean[:, H] = (mag * axes[..., 1]).sum(-1)[:, None]  # that of the data: no heading is learned
    std = [0.1, 0.1, 0.3, DRIFT, SWAY, SWAY, s.field, 4.0, s.acc_bias, s.scale]
    each = side_by_side([np.zeros((len(logs), 1)) + part for part in std])
    return Gaussian(
        mean, np.square(np.repeat(each, [1, 1, 1, 3, 3, 3, 3, 1, 3, 9], -1))[..., None] * np.eye(N)
    )


@dataclass(frozen=True)
class Flight:
    """Trials that are flown together, as runs, in a ``folder``; ``part`` of their time. ``lag``:
    see `read`.
    """

    folder: Path
    trials: tuple[str, ...] = TRIALS
    lag: int = LAG
    part: float = 1.0

    def paths(self) -> list[Path]:
        """Their files."""
        return found(self.folder, [f"{name}.mat" for name in self.trials])

    def logs(self) -> list[Log]:
        """The trials, as long as the longest: nothing is measured after the end of the others."""
        logs = [read(path, self.lag) for path in self.paths()]
        if max(log.dt for log in logs) > 1.001 * min(log.dt for log in logs):
            raise InputError(
                f"{self.folder}: sampling_rate: expected the same in all trials, got "
                f"{[STEP / x.dt for x in logs]} Hz"
            )
        T = round(self.part * max(len(log.rate) for log in logs))
        return [
            Log(
                **{name: _padded(getattr(log, name), T, fill) for name, fill in PADDING.items()},
                dt=log.dt,
            )
            for log in logs
        ]


PADDING: dict[str, Any] = {
    "rate": 0.0,
    "acc": np.nan,
    "mag": np.nan,
    "lively": 0.0,
    "still": np.nan,
    "truth": np.nan,
    "moving": False,
}


def _padded(values: Array, T: int, fill: Any) -> Array:
    more = np.full((max(0, T - len(values)), *values.shape[1:]), fill)
    return np.concatenate([values[:T], more])


GROUPS = (Group("attitude", "deg", slice(0, 3), 180.0 / np.pi),)


def measured(logs: Sequence[Log]) -> Epochs:
    """Epochs of logs of the same length, as runs: what the filters measure, and what they are
    given.
    """
    rate, acc, mag, lively, still, truth = (
        np.stack(part, 1) for part in list(zip(*logs, strict=True))[:6]
    )
    acc[0] = mag[0] = np.nan  # the start is made of it
    known = np.isfinite(acc).all(-1, keepdims=True) * 1.0
    u = rate, lively, np.nan_to_num(acc), np.nan_to_num(mag), known
    z = 0.0 * acc, 0.0 * still, 0.0 * mag[..., :2], still
    times = logs[0].dt * np.arange(len(rate))
    return epochs(times, z, tuple(values[1:] for values in u), truth)


def trial(config: Flight, _rngs: Sequence[Any] = (), *, s: Settings = SETTINGS) -> Trial:
    """The trials, with the filters; errors are rotation vectors on Earth axes."""
    logs = config.logs()
    every = measured(logs)

    def compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
        error = attitude.log(attitude.multiply(attitude.inverse(truth), belief.mean[..., Q]))
        return error, tria(belief.sqrt_cov[..., :3, :])

    return Trial(GROUPS, filters(s), prior(logs, s), lambda _name: every, compare)


def judged(error: Array) -> Array:
    """Total, heading and inclination errors ``(..., 3)`` deg of rotation vectors ``(..., 3)`` deg
    on Earth axes [Laidig2021].
    """
    q = np.abs(attitude.exp(np.radians(error)))
    inclined = 2.0 * np.arccos(np.minimum(np.hypot(q[..., 2], q[..., 3]), 1.0))
    return np.degrees(
        np.stack(
            [
                2.0 * np.arccos(np.minimum(q[..., 3], 1.0)),
                2.0 * np.arctan2(q[..., 2], q[..., 3]),
                inclined,
            ],
            -1,
        )
    )
