"""Model of a hand-held gyro, accelerometer and magnetometer, and files of BROAD [Laidig2021].

Earth axes are east, north (of the magnetic field) and up. The state has the attitude, the drift of
the gyro, velocity and position of the hand, the disturbance of the field, and constants. A step has
`STEP` samples and lasts an eighth of a second. The gyro samples of a step are integrated. The other
samples are rotated to the axes at the end of the step and averaged. Magnetometer samples are
assumed to be late by `LAG` samples. This delay maximizes the likelihood of the innovations in the
trials `TUNED`.

The model uses five physical facts:

- A hand stays within reach. The specific force is integrated twice, and a pseudo-measurement of the
  position is zero, with the σ of an arm's reach. The acceleration needs no spectral model.
- The field differs from place to place, and a hand returns to the same places. Errors of the field
  therefore do not average out. So the magnetometer measures heading only, from the horizontal
  field. Gyro and accelerometer determine the inclination.
- The remaining bias and misalignments of a calibrated magnetometer are treated as noise. A filter
  with them as constant states confuses them with a field that changes as the hand turns.
- The axes of the gyro differ slightly from those of the accelerometer. The gyro's scale factors and
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
QUIET, SLOW = 0.05, 0.03  # m/s^2, rad/s: limits at rest, over a second


# -- logs ------------------------------------------------------------------------------------------
class Log(NamedTuple):
    """A trial in steps of ``dt`` s.

    rate: ``(T, 3)`` rad/s; the constant rate that gives the rotation of a step's samples.
    acc, mag: ``(T, 3)`` m/s^2 and uT, means over the step, on the axes at its end.
    lively: ``(T, 1)`` m/s^2, standard deviation of the specific force over the last second, on axes
    held fixed by the gyro.
    still: ``(T, 3)`` rad/s, the rate if the sensor was at rest for a second, else nan.
    truth: ``(T, 4)`` quaternions, nan where the cameras lost the sensor. moving: ``(T,)``, whether
    the benchmark evaluates the error.
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
    """Contents of a file.

    gyr, acc, mag: ``(S, 3)``, rate (rad/s), specific force (m/s^2) and field (uT). q: quaternions
    ``(S, 4)``, scalar first. moving: ``(S, 1)``, positive where the benchmark evaluates the error.
    hz: sampling rate, Hz.
    """

    gyr: Array
    acc: Array
    mag: Array
    q: Array
    moving: Array
    hz: float


def read(path: Path, lag: int = LAG) -> Log:
    """Read a trial from its MATLAB file, in steps; ``lag``: delay of the magnetometer, samples."""
    gyr, acc, mag, q, moving, hz = samples(path, lag)
    return steps(gyr, acc, mag, hz, lag)._replace(
        truth=_unit(q)[STEP - 1 :: STEP], moving=moving[STEP - 1 :: STEP, 0] > 0.0
    )


def samples(path: Path, lag: int = LAG) -> Samples:
    """Read the samples of a trial from its MATLAB file.

    Raises
    ------
    InputError: naming the file and the field, if the file is damaged.
    """
    try:
        every = loadmat(path)
    except FileNotFoundError:
        raise
    except Exception as error:  # scipy raises many kinds of errors
        raise InputError(
            f"{path}: expected a file of MATLAB 5, got another format ({error})"
        ) from None

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
                f"{path}: {name}: expected finite numbers or nan, got infinity or a column that is "
                "all nan"
            )
        return np.asarray(values, np.float64)

    named = {"imu_gyr": 3, "imu_acc": 3, "imu_mag": 3, "opt_quat": 4, "movement": 1}
    gyr, acc, mag, q, moving = (field(name, columns) for name, columns in named.items())
    hz = float(field("sampling_rate", 1, 1)[0, 0])
    for name, values in zip(named, (gyr, acc, mag, q, moving), strict=True):
        if len(values) != len(gyr):
            raise InputError(
                f"{path}: {name}: expected {len(gyr)} rows, as in imu_gyr, got {len(values)}"
            )
    if np.isnan(gyr).any() or not hz > 0.0:
        raise InputError(
            f"{path}: expected an imu_gyr without nan and a positive sampling_rate, got nan or "
            f"{hz:g} Hz"
        )
    if not (moving > 0.0).any():
        raise InputError(f"{path}: movement: expected some samples above 0, got none")
    return Samples(gyr, acc, mag, q, moving, hz)


def _unit(q: Array) -> Array:
    """Unit quaternions, scalar last, from quaternions of a file, scalar first; nan stays nan."""
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.roll(q, -1, -1) / np.where(norm > 0.5, norm, np.nan))


def steps(gyr: Array, acc: Array, mag: Array, hz: float, lag: int = LAG) -> Log:
    """Combine samples ``(S, 3)`` into steps of `STEP` samples; their truth is nan."""
    T = len(gyr) // STEP
    turned = np.concatenate(
        [np.tile(attitude.IDENTITY, (lag, 1)), attitude.exp(gyr[: T * STEP] / hz)]
    )
    turn, sums = np.tile(attitude.IDENTITY, (T, 1)), np.zeros((2, T, 3))
    rate = np.zeros((T, 3))
    # i: index of a sample in its step, negative before it. `turn`: rotation from sample i to the
    # end of the step.
    for i in range(STEP - 1, -lag - 1, -1):
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
    """The last ``width`` values at each epoch, ``(T, 3, width)``; ``before`` pads the start."""
    values = np.concatenate([np.zeros((width - 1, 3)) + before, values])
    return np.lib.stride_tricks.sliding_window_view(values, width, axis=0)


# -- the model -------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Settings:
    """Standard deviations and rates, the same for all trials (or one for each run, ``(runs, 1)``).

    gyro: angle random walk, rad/s^(1/2). turning: angle random walk per rad/s of rate, from errors
    proportional to the rate; 0.001 gives 0.1 % over a second.
    acc, shaking: white noise of a step, m/s^2, and its increase for each 1 m/s^2 of `Log.lively`.
    reach: m s^(1/2), σ of the position about zero for one independent measurement per second.
    mag: white noise of a step, uT.
    field, stir: uT, σ of the field's disturbance on Earth axes; 1/s, its decay rate for each m/s^2
    of `Log.lively`.
    acc_bias: m/s^2, σ of the accelerometer's constant bias, on the sensor's axes.
    scale: σ of the gyro's scale factors and misalignments.
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


DRIFT, DRIFT_WALK = 0.01, 1e-5  # σ at the start, rad/s; random walk, rad/s^(3/2)
TREMOR, SWAY = 1e-3, 0.01  # rad/s, m/s: σ for a sensor at rest
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
"""Parts of a state ``(..., 29)``: attitude, gyro drift (rad/s), velocity (m/s) and position (m) of
the hand, disturbance and horizontal component of the field (uT), accelerometer bias (m/s^2), gyro
matrix by rows. In deviations ``(..., 28)`` the attitude has three components.
"""
N, NOISY = 28, np.eye(28)[:, [*range(9), *range(12, 15)]]


VECTORS = (V, P, D)


def together() -> Space:
    """Space of states whose deviations rotate the `VECTORS` on Earth axes with the attitude.

    Deviations of the attitude are about Earth axes. So the measurement of a vector on the sensor's
    axes does not depend on the attitude's deviation. A rotation of the complete state about the
    vertical is the same deviation for all estimates of the vectors [Barrau2017]. Only the mean of
    the field measures this rotation.
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
        )  # normalized, against accumulation of round-off
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
    """Space of states with attitude deviations on the sensor's axes; other deviations are
    additive.
    """
    return product((attitude.attitude(), 4, 3), (EUCLIDEAN, N - 3, N - 3))


def by_rows(matrix: Array, vector: Array) -> Array:
    """Product of matrices, given by rows ``(..., 9)``, with vectors ``(..., 3)``."""
    parts = [(matrix[..., i : i + 3] * vector).sum(-1)[..., None] for i in (0, 3, 6)]
    return side_by_side(parts)


def motion(s: Settings, space: Space) -> Motion:
    """Motion model of the state.

    ``epoch.u`` is rate ``(..., 3)``, `Log.lively` ``(..., 1)``, specific force and field ``(...,
    3)``, and 1 if the force was measured, else 0 ``(..., 1)``.
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
    """Rotate vectors ``(..., 3)`` from the sensor's axes to Earth axes, by states' attitudes."""
    return attitude.rotate(attitude.inverse(x[..., Q]), vector)


def sensors(s: Settings) -> tuple[Sensor, ...]:
    """Sensors for reach, velocity at rest, horizontal field, and gyro at rest; measurements of the
    first three are zero.
    """

    def horizontal(x: Array, epoch: Epoch) -> Array:
        field = on_earth(x, epoch.u[3]) - x[..., D]
        return side_by_side([field[..., :1], field[..., 1:2] - x[..., H]])

    def by_heading(mean: Array, epoch: Epoch) -> Array:
        """Derivative of the horizontal field ``(..., 2, N)``, without its part from inclination."""
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
    """A vector of the state on the sensor's axes, on which it does not depend on the attitude's
    deviation.
    """
    return attitude.rotate(x[..., Q], x[..., part])


NORTH = np.outer([0.0, 1.0], np.eye(N)[H.start - 1])


def filters(s: Settings = SETTINGS) -> dict[str, Sequential]:
    """The compared filters by name; all have the same model."""
    move, measured = motion(s, together()), sensors(s)
    doubted = [[], [], [student_t()], []]
    return {
        "mekf": ekf(move, *measured),
        "robust": ekf(move, *measured, hooks=doubted),
    }


def prior(logs: Sequence[Log], s: Settings = SETTINGS) -> Gaussian:
    """Prior of each trial, from its first second at rest and typical fields in a building."""
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
    # The field comes from the data, so that the prior has no information about heading.
    mean[:, H] = (mag * axes[..., 1]).sum(-1)[:, None]
    std = [0.1, 0.1, 0.3, DRIFT, SWAY, SWAY, s.field, 4.0, s.acc_bias, s.scale]
    each = side_by_side([np.zeros((len(logs), 1)) + part for part in std])
    return Gaussian(
        mean, np.square(np.repeat(each, [1, 1, 1, 3, 3, 3, 3, 1, 3, 9], -1))[..., None] * np.eye(N)
    )


@dataclass(frozen=True)
class Flight:
    """Trials in a ``folder`` that run together, as runs; ``part``: fraction of their time. ``lag``:
    see `read`.
    """

    folder: Path
    trials: tuple[str, ...] = TRIALS
    lag: int = LAG
    part: float = 1.0

    def paths(self) -> list[Path]:
        """Files of the trials."""
        return found(self.folder, [f"{name}.mat" for name in self.trials])

    def logs(self) -> list[Log]:
        """The trials, padded to the length of the longest with missing measurements."""
        logs = [read(path, self.lag) for path in self.paths()]
        if max(log.dt for log in logs) > 1.001 * min(log.dt for log in logs):
            raise InputError(
                f"{self.folder}: sampling_rate: expected the same rate in all trials, got "
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
    """Epochs of logs with equal length, as runs: measurements and inputs of the filters."""
    rate, acc, mag, lively, still, truth = (
        np.stack(part, 1) for part in list(zip(*logs, strict=True))[:6]
    )
    acc[0] = mag[0] = np.nan  # the prior already uses it
    has_force = np.isfinite(acc).all(-1, keepdims=True) * 1.0
    u = rate, lively, np.nan_to_num(acc), np.nan_to_num(mag), has_force
    z = 0.0 * acc, 0.0 * still, 0.0 * mag[..., :2], still
    times = logs[0].dt * np.arange(len(rate))
    return epochs(times, z, tuple(values[1:] for values in u), truth)


def trial(config: Flight, _rngs: Sequence[Any] = (), *, s: Settings = SETTINGS) -> Trial:
    """The trials with their filters; errors are rotation vectors on Earth axes."""
    logs = config.logs()
    every = measured(logs)

    def compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
        error = attitude.log(attitude.multiply(attitude.inverse(truth), belief.mean[..., Q]))
        return error, tria(belief.sqrt_cov[..., :3, :])

    return Trial(GROUPS, filters(s), prior(logs, s), lambda _name: every, compare)


def judged(error: Array) -> Array:
    """Total, heading and inclination errors ``(..., 3)`` deg, from rotation vectors ``(..., 3)``
    deg on Earth axes [Laidig2021].
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
