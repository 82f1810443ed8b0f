"""A gyro, an accelerometer and a magnetometer in a hand, as BROAD [Laidig2021] has them: what is
read, and what is believed.

Earth axes are east, north (of the magnetic field) and up; the state is an attitude, the drift of
the gyro, the acceleration of the hand, the field's disturbance, and constants. Eight samples make a
step: those of the gyro are integrated, the others turned to its end and averaged, those of the
magnetometer as of `LAG` samples before, which makes the innovations of the trials `TUNED` most
probable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from celnav.files import InputError
from celnav.filters.adaptive import student_t
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, epochs
from celnav.filters.sequential import Sequential, ekf, ukf
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
STEP, LAG = 8, 4  # samples


# -- what was recorded -----------------------------------------------------------------------------
class Log(NamedTuple):
    """A trial in steps of ``dt`` s.

    rate: ``(T, 3)`` rad/s, turns as the samples of a step do together. acc, mag: ``(T, 3)`` m/s^2
        and uT, means of the step on the
    axes at its end. lively: ``(T, 1)`` m/s^2, by how much the accelerations of the last second were
    no gravity, in the mean.
    truth: ``(T, 4)``, nan where the cameras lost it. moving: ``(T,)``, where the benchmark judges.
    """

    rate: Array
    acc: Array
    mag: Array
    lively: Array
    truth: Array
    moving: Array
    dt: float


def read(path: Path, lag: int = LAG) -> Log:
    """A trial from its MATLAB file; ``lag``: of the magnetometer, samples.

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
    return steps(gyr, acc, mag, hz, lag)._replace(
        truth=_unit(q)[STEP - 1 :: STEP], moving=moving[STEP - 1 :: STEP, 0] > 0.0
    )


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
    odd = np.nan_to_num((np.linalg.norm(mean[0], axis=-1, keepdims=True) - GRAVITY) ** 2)
    width = max(1, round(1.0 / dt))
    total = np.cumsum(np.concatenate([np.zeros((width, 1)), odd]), 0)
    lively = np.sqrt(np.maximum(total[width:] - total[:-width], 0.0) / width)
    return Log(rate, mean[0], mean[1], lively, np.full((T, 4), np.nan), np.ones(T, bool), dt)


# -- what is believed ------------------------------------------------------------------------------
@dataclass(frozen=True)
class Settings:
    """Deviations and times, each one for all trials (or one for each run, ``(runs, 1)``).

    gyro: angle random walk, rad/s^(1/2). turning: that of errors which grow with the rate, for each
        rad/s.
    shaking, push: white noise of a step, and deviation of the hand's acceleration, each for 1 m/s^2
        of `Log.lively`.
    acc, rest: the same of a sensor at rest, m/s^2. tau, wash: times s of that acceleration: it is
        ``s - l``, with s a Gauss-Markov
    process and l what follows it, so that it has no mean: a hand comes back.
    mag: white noise of a step, uT. field, far: deviation, uT, and time, s, of the field's
        disturbance on Earth axes.
    acc_bias, mag_bias: deviations, m/s^2 and uT, of constants on the sensor's axes.
    """

    gyro: Any
    turning: Any
    acc: Any
    shaking: Any
    rest: Any
    push: Any
    tau: Any
    wash: Any
    mag: Any
    field: Any
    far: Any
    acc_bias: Any
    mag_bias: Any


DRIFT, DRIFT_WALK = 0.01, 1e-5  # rad/s at the start, and rad/s^(3/2)
SETTINGS = Settings(
    gyro=7.43e-05,
    turning=0.00562,
    acc=0.0119,
    shaking=0.0355,
    rest=0.00142,
    push=1.02,
    tau=0.107,
    wash=0.338,
    mag=0.433,
    field=1.05,
    far=6.34,
    acc_bias=0.0746,
    mag_bias=0.379,
)
WHITE = replace(
    SETTINGS,
    turning=0.00646,
    acc=0.00324,
    shaking=0.923,
    rest=0.0,
    push=0.0,
    mag=0.432,
    field=0.995,
    far=5.71,
    acc_bias=0.0831,
    mag_bias=0.294,
)
"""The same for a filter to which the hand's acceleration is white noise: where that one's
innovations are most probable.
"""
Q, BIAS, S, L, D, H, V, ACC, MAG = (
    slice(0, 4),
    slice(4, 7),
    slice(7, 10),
    slice(10, 13),
    slice(13, 16),
    slice(16, 17),
    slice(17, 18),
    slice(18, 21),
    slice(21, 24),
)
"""Of a state ``(..., 24)``: attitude, drift (rad/s), both parts of the acceleration (m/s^2),
disturbance, horizontal and downward part of the field (uT), constants of both sensors. Of
deviations ``(..., 23)`` those of the attitude are three."""
N, NOISY = 23, np.eye(23)[:, [*range(9), *range(12, 15)]]


VECTORS = (S, L, D)


def together() -> Space:
    """Space of states whose deviations turn the vectors on Earth axes along with the attitude,
    ``(..., 23)``: about Earth axes.

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


def apart(transported: bool = False) -> Space:
    """Space of states whose attitude deviates on the sensor's axes, and the rest by itself."""
    return product((attitude.attitude(transported=transported), 4, 3), (EUCLIDEAN, N - 3, N - 3))


def motion(s: Settings, space: Space) -> Motion:
    """How a state goes on; ``epoch.u`` is rate ``(..., 3)`` and `Log.lively` ``(..., 1)``."""
    perfect = Gyro(0.0, 0.0)

    def f(x: Array, epoch: Epoch) -> Array:
        tau, wash, far = (np.exp(-epoch.dt / time) for time in (s.tau, s.wash, s.far))
        followed = wash * x[..., L] + (1.0 - wash) * x[..., S]
        turned = perfect.propagate(x[..., : BIAS.stop], epoch.u[0], epoch.dt)
        return side_by_side([turned, tau * x[..., S], followed, far * x[..., D], x[..., D.stop :]])

    def noise(_mean: Array, epoch: Epoch) -> Array:
        (rate, lively), dt = epoch.u, epoch.dt
        turn = np.sqrt((s.gyro**2 + s.turning**2 * (rate * rate).sum(-1)[..., None]) * dt)
        push = np.sqrt((s.rest**2 + (s.push * lively) ** 2) * (1.0 - np.exp(-2.0 * dt / s.tau)))
        field = s.field * np.sqrt(1.0 - np.exp(-2.0 * dt / s.far))
        std = side_by_side(
            [part + 0.0 * turn for part in (turn, DRIFT_WALK * np.sqrt(dt), push, field)]
        )
        return np.repeat(std, 3, -1)[..., None, :] * NOISY

    return Motion(f, sqrt_Q=noise, space=space)


def sensors(s: Settings) -> tuple[Sensor, Sensor]:
    """Accelerometer and magnetometer."""

    def acc(x: Array, _epoch: Epoch) -> Array:
        return np.asarray(
            attitude.rotate(x[..., Q], x[..., S] - x[..., L] + np.array([0.0, 0.0, GRAVITY]))
            + x[..., ACC]
        )

    def mag(x: Array, _epoch: Epoch) -> Array:
        field = x[..., D] + side_by_side([0.0 * x[..., H], x[..., H], -x[..., V]])
        return np.asarray(attitude.rotate(x[..., Q], field) + x[..., MAG])

    def acc_noise(_mean: Array, epoch: Epoch) -> Array:
        return np.asarray(np.sqrt(s.acc**2 + (s.shaking * epoch.u[1]) ** 2)[..., None] * np.eye(3))

    return Sensor(acc, sqrt_R=acc_noise), Sensor(
        mag, sqrt_R=lambda _mean, _epoch: np.asarray(s.mag)[..., None] * np.eye(3)
    )


def filters(s: Settings = SETTINGS, white: Settings = WHITE) -> dict[str, Sequential]:
    """The filters that are compared, by name; all but "white" believe the same."""
    seen, believed = sensors(s), (motion(s, together()), *sensors(s))
    return {
        "mekf": ekf(*believed),
        "ukf": ukf(*believed),
        "robust": ekf(*believed, hooks=[student_t()]),
        "white": ekf(motion(white, together()), *sensors(white)),
        "apart": ekf(motion(s, apart()), *seen),
        "transported": ekf(motion(s, apart(transported=True)), *seen),
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
    mean[:, Q], mean[:, H], mean[:, V] = Rotation.from_matrix(axes.mT).as_quat(), 18.0, 40.0
    std = [0.1, 0.1, 0.3, DRIFT, s.rest, s.field, 4.0, s.acc_bias, s.mag_bias]
    each = side_by_side([np.zeros((len(logs), 1)) + part for part in std])
    return Gaussian(
        mean, np.square(np.repeat(each, [1, 1, 1, 3, 6, 3, 2, 3, 3], -1))[..., None] * np.eye(N)
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

    def logs(self) -> list[Log]:
        """The trials, as long as the longest: nothing is measured after the end of the others."""
        logs = [
            read(path, self.lag)
            for path in found(self.folder, [f"{name}.mat" for name in self.trials])
        ]
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
    "truth": np.nan,
    "moving": False,
}


def _padded(values: Array, T: int, fill: Any) -> Array:
    more = np.full((max(0, T - len(values)), *values.shape[1:]), fill)
    return np.concatenate([values[:T], more])


GROUPS = (Group("attitude", "deg", slice(0, 3), 180.0 / np.pi),)


def trial(
    config: Flight, _rngs: Sequence[Any] = (), *, s: Settings = SETTINGS, on_earth: bool = True
) -> Trial:
    """The trials, with the filters; errors are rotation vectors on Earth axes. ``on_earth``: so are
    the filters' own deviations.
    """
    logs = config.logs()
    rate, acc, mag, lively, truth = (
        np.stack(part, 1) for part in list(zip(*logs, strict=True))[:5]
    )
    acc[0] = mag[0] = np.nan  # the start is made of it
    every = epochs(logs[0].dt * np.arange(len(rate)), (acc, mag), (rate[1:], lively[1:]), truth)

    def compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
        q, root = belief.mean[..., Q], belief.sqrt_cov[..., :3, :]
        error = attitude.log(attitude.multiply(attitude.inverse(truth), q))
        return error, tria(root if on_earth else attitude.matrix(q).mT @ root)

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
