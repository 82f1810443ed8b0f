"""Inertial navigation with GNSS fixes and other sensors: a strapdown system as a motion, and
sensors of its states [Groves2013]::

    imu = Imu.datasheet(gyro_deg_s_sqrt_hz=0.004, accelerometer_ug_sqrt_hz=70.0, ...)
    system = strapdown(latitude, height_m, imu, states=("lever",))
    filter = celnav.ekf(system.motion, system.gnss(lever, sigma_position=0.02, sigma_velocity=0.05))
    merged = celnav.merge(imu=(t, (rate, force)), fixes=(t_fix, z_fix))
    track = celnav.run(filter, system.prior(level(force[:100].mean(0)), heading, ...), *merged)

Axes: n is north, east, down, Earth-fixed at the origin of the positions; b is the body, the axes of
the IMU. The attitude q rotates n to b, so ``rotate(inverse(q), force)`` is on n. The inputs of an
interval are angular rate (rad/s) and specific force (m/s^2) in its middle.

State, with names in ``system.space``: attitude q, velocity v (m/s) and position p (m) on n, biases
of gyros bg (rad/s) and accelerometers ba (m/s^2), and optional states from `STATES`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.model import Motion, Sensor
from celnav.gaussian.attitude import (
    attitude,
    cross_product,
    exp,
    from_euler,
    inverse,
    matrix,
    multiply,
    rotate,
)
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import choice, finite, instance, number, sequence, together
from celnav.gaussian.extended_pose import extended_pose
from celnav.gaussian.linalg import Array, outer, side_by_side
from celnav.gaussian.spaces import Space, product
from celnav.models import earth
from celnav.models.noise import allan_deviation

MICRO_G = 1e-6 * earth.STANDARD_GRAVITY  # m/s^2
ERRORS = ("body", "local", "invariant")
STATES = {
    "lag": (1, 0.05),
    "lever": (3, 0.1),
    "scale": (6, 0.01),
    "mount": (2, np.radians(2.0)),
    "axle": (1, 0.5),
    "wheel": (1, 0.02),
}
"""Optional states: number of components, and initial standard deviation.

lag: delay of the fixes relative to the IMU's clock, s. lever: correction of the antenna's lever
arm, m. scale: scale-factor errors of gyros (3) and accelerometers (3), measured / true - 1. mount:
pitch and yaw of the vehicle axes relative to the body axes, rad. axle: correction of the forward
lever arm of the axle that does not steer, m. wheel: scale-factor error of the wheel speed,
measured / true - 1.
"""
WALK = 1e-3
"""Random walk of an optional state over 1 s, relative to its initial standard deviation."""


@dataclass(frozen=True)
class Imu:
    """Noise of an IMU, the same on every axis; ValueError for negative numbers.

    gyro_noise: noise density, rad/s/Hz^(1/2). accelerometer_noise: noise density, m/s^2/Hz^(1/2).
    gyro_bias, accelerometer_bias: initial standard deviations of the biases, rad/s and m/s^2.
    gyro_walk, accelerometer_walk: random walks of the biases, rad/s/s^(1/2) and m/s^2/s^(1/2).
    """

    gyro_noise: float
    accelerometer_noise: float
    gyro_bias: float
    accelerometer_bias: float
    gyro_walk: float = 0.0
    accelerometer_walk: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, number(name, value, 0.0))

    @classmethod
    def datasheet(
        cls,
        *,
        gyro_deg_s_sqrt_hz: float | None = None,
        gyro_deg_sqrt_h: float | None = None,
        accelerometer_ug_sqrt_hz: float | None = None,
        accelerometer_m_s_sqrt_h: float | None = None,
        gyro_bias_deg_s: float,
        accelerometer_bias_mg: float,
        gyro_instability_deg_h: float = 0.0,
        accelerometer_instability_ug: float = 0.0,
        instability_s: float | None = None,
    ) -> Imu:
        """An `Imu` in the units of data sheets [IEEE1997].

        gyro_deg_s_sqrt_hz, gyro_deg_sqrt_h: noise density, or angle random walk; pass one of them.
        accelerometer_ug_sqrt_hz, accelerometer_m_s_sqrt_h: noise density, or velocity random walk;
            pass one of them.
        gyro_bias_deg_s, accelerometer_bias_mg: initial standard deviations of the biases.
        gyro_instability_deg_h, accelerometer_instability_ug: bias instability B.
        instability_s: correlation time of the biases, s. Over 1 s the biases change by
            ``B sqrt(2 / instability_s)``, as a Gauss-Markov process with standard deviation B does.

        >>> imu = Imu.datasheet(gyro_deg_sqrt_h=0.3, accelerometer_ug_sqrt_hz=70.0,
        ...                     gyro_bias_deg_s=0.1, accelerometer_bias_mg=5.0)
        """
        gyro = _one_of(
            gyro_deg_s_sqrt_hz=(gyro_deg_s_sqrt_hz, np.radians(1.0)),
            gyro_deg_sqrt_h=(gyro_deg_sqrt_h, np.radians(1.0) / 60.0),
        )
        accelerometer = _one_of(
            accelerometer_ug_sqrt_hz=(accelerometer_ug_sqrt_hz, MICRO_G),
            accelerometer_m_s_sqrt_h=(accelerometer_m_s_sqrt_h, 1.0 / 60.0),
        )
        instabilities = (
            number("gyro_instability_deg_h", gyro_instability_deg_h, 0.0),
            number("accelerometer_instability_ug", accelerometer_instability_ug, 0.0),
        )
        rate = 0.0
        if any(instabilities) or instability_s is not None:
            rate = np.sqrt(2.0 / number("instability_s", instability_s, above=0.0))
        return cls(
            gyro,
            accelerometer,
            np.radians(number("gyro_bias_deg_s", gyro_bias_deg_s, 0.0)),
            1e3 * MICRO_G * number("accelerometer_bias_mg", accelerometer_bias_mg, 0.0),
            rate * np.radians(instabilities[0]) / 3600.0,
            rate * MICRO_G * instabilities[1],
        )

    @classmethod
    def at_rest(
        cls,
        t: ArrayLike,
        rate: ArrayLike,
        force: ArrayLike,
        *,
        interval_s: float = 1.0,
        gyro_bias: float,
        accelerometer_bias: float,
        gyro_walk: float = 0.0,
        accelerometer_walk: float = 0.0,
    ) -> Imu:
        """An `Imu` with the white noise of a log at rest: the Allan deviation over ``interval_s``
        s, RMS of the axes (`celnav.models.noise.allan_deviation`).

        t: ``(T,)`` s, evenly spaced. rate, force: ``(T, 3)``, rad/s and m/s^2.
        gyro_bias, accelerometer_bias, gyro_walk, accelerometer_walk: as in `Imu`; a short log does
            not determine them.
        """
        gyro, accelerometer = (
            np.sqrt(np.square(allan_deviation(t, x, interval_s).deviation).mean() * interval_s)
            for x in (finite("rate", rate, ("T", 3)), finite("force", force, ("T", 3)))
        )
        return cls(
            gyro, accelerometer, gyro_bias, accelerometer_bias, gyro_walk, accelerometer_walk
        )


def _one_of(**given: tuple[float | None, float]) -> float:
    """The only number that is not None, in SI units; ValueError for none or several."""
    values = {
        name: number(name, x, 0.0) * unit for name, (x, unit) in given.items() if x is not None
    }
    if len(values) != 1:
        names = " and ".join(given)
        raise ValueError(f"{', '.join(given)}: expected one of {names}, got {len(values)}")
    return next(iter(values.values()))


def level(force: ArrayLike) -> Array:
    """Roll and pitch ``(..., 2)`` rad of a body at rest from its mean specific force ``(..., 3)``
    m/s^2 on forward, right, down axes.

    >>> roll, pitch = celnav.models.inertial.level(force[:100].mean(0))
    """
    x, y, z = np.moveaxis(finite("force", force, (..., 3)), -1, 0)
    return np.stack([np.arctan2(-y, -z), np.arctan2(x, np.hypot(y, z))], -1)


def standing(
    t: ArrayLike,
    rate: ArrayLike,
    force: ArrayLike,
    *,
    window_s: float,
    most_rate: float,
    rate_spread: float,
    force_spread: float,
) -> tuple[Array, Array]:
    """Detect standstill in windows of ``window_s`` s; return times ``(K,)`` s and measurements
    ``(K, 6)`` for `Strapdown.standstill`.

    A measurement has the last time of its window, zero velocity (m/s) and the mean rate (rad/s).

    t: ``(T,)`` s. rate, force: ``(T, 3)``, rad/s and m/s^2.
    most_rate: upper limit of the mean rate on each axis, including the gyro bias, rad/s.
    rate_spread, force_spread: upper limits of the standard deviations within a window on each axis,
        rad/s and m/s^2.

    At rest with the engine running, the vibration may equal a smooth, straight ride: compare the
    times with the speeds of the fixes.

    >>> limits = dict(window_s=0.5, most_rate=0.01, rate_spread=0.005, force_spread=0.2)
    >>> rows = celnav.models.inertial.standing(t, rate, force, **limits)
    >>> merged = celnav.merge(imu=(t, (rate, force)), fixes=(t_fix, z_fix), still=rows)
    """
    times = finite("t", t, ("T",))
    samples = [finite(name, x, (len(times), 3)) for name, x in (("rate", rate), ("force", force))]
    window = np.floor((times - times[0]) / number("window_s", window_s, above=0.0))
    most = number("most_rate", most_rate, above=0.0)
    spreads = [
        number("rate_spread", rate_spread, above=0.0),
        number("force_spread", force_spread, above=0.0),
    ]
    last = np.flatnonzero(np.diff(window))  # last row of each window; the final window is partial
    if not len(last):
        return times[:0], np.zeros((0, 6))
    first = np.append(0, last[:-1] + 1)
    count = last - first + 1
    x = np.concatenate(samples, -1)[: last[-1] + 1]
    mean = np.add.reduceat(x, first) / count[:, None]
    squares = np.add.reduceat(np.square(x - np.repeat(mean, count, 0)), first)
    spread = np.sqrt(squares / count[:, None])
    still = (spread < np.repeat(spreads, 3)).all(-1) & (np.abs(mean[:, :3]) < most).all(-1)
    rows = np.concatenate([np.zeros_like(mean[:, :3]), mean[:, :3]], -1)
    return times[last][still], rows[still]


@dataclass(frozen=True, eq=False)
class Strapdown:
    """A strapdown system: a motion, and sensors of its states. Make one with `strapdown`."""

    latitude: float
    height_m: float
    imu: Imu
    states: dict[str, float] = field(default_factory=dict)
    error: str = "invariant"

    @cached_property
    def space(self) -> Space:
        """The space of the states; `Space.part` selects a state by its name."""
        axes = "reference" if self.error == "local" else "body"
        pose: dict[str, Any] = {"q": attitude(axes=axes), "v": 3, "p": 3}
        if self.error == "invariant":
            pose = {"pose": extended_pose()}
        return product(**pose, bg=3, ba=3, **{name: STATES[name][0] for name in self.states})

    @cached_property
    def motion(self) -> Motion:
        """The `Motion` of the state over an interval; ``epoch.u`` is ``(rate, force)``."""
        return Motion(self._move, sqrt_Q=self._noise, space=self.space)

    @cached_property
    def _spin(self) -> Array:
        """Rotation rate ``(3,)`` of the Earth on n, rad/s."""
        east, north, up = earth.earth_rate(self.latitude)
        return np.array([north, east, -up])

    @cached_property
    def _gravity(self) -> tuple[Array, Array]:
        """Gravity ``(3,)`` m/s^2 at the origin, and its gradient ``(3, 3)`` 1/s^2, on n."""
        L, h = self.latitude, self.height_m
        g, above = (float(earth.normal_gravity(L, h + up)) for up in (0.0, 1.0))
        north, east = earth.radii(L, h)
        # Along a meridian the vertical turns. Gravity also increases, a thousand times less.
        step = 1e-4
        sides = [float(earth.normal_gravity(L + s * step, h)) for s in (0.5, -0.5)]
        growth = (sides[0] - sides[1]) / (step * north)
        gradient = np.diag([-g / north, -g / east, g - above])
        gradient[0, 2] = gradient[2, 0] = growth
        return np.array([0.0, 0.0, g]), gradient

    def _measured(self, x: Array, u: Any) -> tuple[Array, Array]:
        """Rate and force ``(..., 3)``, corrected for biases and scale-factor errors."""
        rate, force = u if isinstance(u, tuple) else (u[..., :3], u[..., 3:])
        rate, force = rate - self.space.part(x, "bg"), force - self.space.part(x, "ba")
        if "scale" in self.states:
            scale = 1.0 + self.space.part(x, "scale")
            rate, force = rate / scale[..., :3], force / scale[..., 3:]
        return rate, force

    def _acceleration(self, back: Array, force: Array, v: Array, p: Array, ahead: Any) -> Array:
        """Acceleration ``C' f + g - 2 w x v`` on n, ``ahead`` seconds after v and p; the quaternion
        ``back`` rotates b to n.
        """
        at_origin, gradient = self._gravity
        a = rotate(back, force) + at_origin + (p + ahead * v) @ gradient
        return np.asanyarray(a - 2.0 * cross_product(self._spin + 0.0 * v, v + ahead * a))

    def _move(self, x: Array, epoch: Any) -> Array:
        # q' = exp(w dt) q exp(-w_ie dt): exact if rate and force are constant on b.
        dt, part = epoch.dt, partial(self.space.part, x)
        dt = np.asanyarray(np.multiply(dt, 1.0))[..., None]
        rate, force = self._measured(x, epoch.u)
        half, frame = exp(0.5 * dt * rate), exp(-0.5 * dt * self._spin)
        middle = multiply(half, multiply(part("q"), frame))
        v, p = part("v"), part("p")
        a = self._acceleration(inverse(middle), force, v, p, 0.5 * dt)
        return side_by_side(
            [
                multiply(half, multiply(middle, frame)),
                v + a * dt,
                p + (v + 0.5 * dt * a) * dt,
                x[..., 10:],
            ]
        )

    def _noise(self, _mean: Array, epoch: Any) -> Array:
        once, integrated, remaining = self._columns
        dt = np.asanyarray(np.multiply(epoch.dt, 1.0))[..., None, None]
        columns = np.sqrt(dt) * (once + dt * (integrated + remaining))
        # Entries that are zero for any interval become constants, which compiled code omits.
        return np.where(once + integrated + remaining != 0.0, columns, 0.0)

    @cached_property
    def _columns(self) -> tuple[Array, Array, Array]:
        """Noise columns ``(n, r)`` over 1 s: the noise of each state, and the effect of the
        velocity noise on the position.

        The effect is ``dt / 2`` times the velocity noise, plus ``dt / 12^(1/2)`` times an
        independent noise.
        """
        imu, places = self.imu, self.space.places
        sigma = {
            "q": imu.gyro_noise,
            "v": imu.accelerometer_noise,
            "bg": imu.gyro_walk,
            "ba": imu.accelerometer_walk,
            **{name: WALK * size for name, size in self.states.items()},
        }
        std = np.zeros(self.n)
        for name, size in sigma.items():
            std[places(name)[1]] = size
        v, p = places("v")[1], places("p")[1]
        same, other = np.zeros((2, self.n, self.n))
        same[p, v] = 0.5 * imu.accelerometer_noise * np.eye(3)
        other[p, p] = imu.accelerometer_noise / np.sqrt(12.0) * np.eye(3)
        used = (std > 0.0) | other.any(0)
        return np.diag(std)[:, used], same[:, used], other[:, used]

    @property
    def n(self) -> int:
        """Number of components of an error."""
        return 15 + sum(STATES[name][0] for name in self.states)

    def prior(
        self,
        level: ArrayLike,
        heading: ArrayLike,
        *,
        sigma_level: float,
        sigma_heading: float,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        position: ArrayLike = (0.0, 0.0, 0.0),
        sigma_velocity: float,
        sigma_position: float,
    ) -> Gaussian:
        """The prior `Gaussian`. Biases and optional states have mean 0 and the standard deviations
        of the `Imu` and of the states.

        level: roll and pitch ``(..., 2)`` rad, as from `level`.
        heading: ``(...)`` rad clockwise from north. For a car, it is the course
            ``arctan2(v_east, v_north)``. If it is unknown, pass several headings as runs of a
            batch, and select one by likelihood.
        velocity, position: ``(..., 3)`` m/s and m, on n.
        sigma_level, sigma_heading: rad, about the horizontal axes and the vertical axis.
        sigma_velocity, sigma_position: m/s and m, on each axis.
        """
        roll_pitch, psi = finite("level", level, (..., 2)), finite("heading", heading)
        v, p = finite("velocity", velocity, (..., 3)), finite("position", position, (..., 3))
        batch = together(
            level=roll_pitch.shape[:-1],
            heading=psi.shape,
            velocity=v.shape[:-1],
            position=p.shape[:-1],
        )
        q = from_euler(
            np.concatenate(
                [
                    np.broadcast_to(roll_pitch, (*batch, 2)),
                    np.broadcast_to(psi, batch)[..., None],
                ],
                -1,
            )
        )
        zeros = np.zeros(self.n - 9)
        mean = np.concatenate(
            [np.broadcast_to(part, (*batch, part.shape[-1])) for part in (q, v, p, zeros)], -1
        )
        tilt = number("sigma_level", sigma_level, 0.0)
        std = np.repeat(
            [
                tilt,
                number("sigma_heading", sigma_heading, 0.0),
                number("sigma_velocity", sigma_velocity, 0.0),
                number("sigma_position", sigma_position, 0.0),
                self.imu.gyro_bias,
                self.imu.accelerometer_bias,
                *self.states.values(),
            ],
            [2, 1, 3, 3, 3, 3, *(STATES[name][0] for name in self.states)],
        )
        if self.error == "local":
            return Gaussian(mean, np.diag(std**2))
        # Rotate errors from n to b: attitude errors, or errors of the whole extended pose.
        turned = np.zeros((*batch, self.n, self.n)) + np.eye(self.n)
        for at in range(0, 9 if self.error == "invariant" else 3, 3):
            turned[..., at : at + 3, at : at + 3] = matrix(q)
        return Gaussian(mean, outer(turned * std))

    # -- sensors -----------------------------------------------------------------------------------
    def gnss(
        self,
        lever: ArrayLike = (0.0, 0.0, 0.0),
        *,
        sigma_position: ArrayLike,
        sigma_velocity: ArrayLike | None = None,
    ) -> Sensor:
        """`Sensor` of fixes of an antenna, on n: position ``(..., 3)``, or position and velocity
        ``(..., 6)`` with ``sigma_velocity``.

        lever: ``(3,)`` m from the IMU to the antenna, on b.
        sigma_position, sigma_velocity: m and m/s, one number or ``(3,)``.
        """
        sigmas = [_sigmas("sigma_position", sigma_position, 3)]
        if sigma_velocity is not None:
            sigmas.append(_sigmas("sigma_velocity", sigma_velocity, 3))
        arm = finite("lever", lever, (3,))
        return Sensor(
            partial(self._fix, arm, len(sigmas) > 1), sqrt_R=np.diag(np.concatenate(sigmas))
        )

    def _fix(self, lever: Array, with_velocity: bool, x: Array, epoch: Any) -> Array:
        part = partial(self.space.part, x)
        back = inverse(part("q"))
        arm = lever + (part("lever") if "lever" in self.states else 0.0 * part("p"))
        p, v = part("p") + rotate(back, arm), part("v")
        if epoch.u is not None:
            v = v + rotate(back, cross_product(self._turning(x, epoch), arm))
        if "lag" in self.states:
            p = p + part("lag") * v
            if epoch.u is not None:
                _, force = self._measured(x, epoch.u)
                v = v + part("lag") * self._acceleration(back, force, part("v"), p, 0.0)
        return side_by_side([p, v]) if with_velocity else p

    def _turning(self, x: Array, epoch: Any) -> Array:
        """Rotation rate of b relative to n, on b; 0 at the first epoch, which has no interval."""
        q = self.space.part(x, "q")
        spin = rotate(q, self._spin + 0.0 * q[..., :3])
        if epoch.u is None:
            return 0.0 * spin
        return np.asanyarray(self._measured(x, epoch.u)[0] - spin)

    def standstill(self, *, sigma_velocity: ArrayLike, sigma_rate: ArrayLike) -> Sensor:
        """`Sensor` of zero velocity and mean rate ``(..., 6)`` at standstill; `standing` makes the
        measurements.

        sigma_velocity, sigma_rate: m/s and rad/s, one number or ``(3,)``.
        """
        velocity = _sigmas("sigma_velocity", sigma_velocity, 3)
        rate = _sigmas("sigma_rate", sigma_rate, 3)
        return Sensor(self._still, sqrt_R=np.diag(np.concatenate([velocity, rate])))

    def _still(self, x: Array, _epoch: Any) -> Array:
        part = partial(self.space.part, x)
        spin = rotate(part("q"), self._spin + 0.0 * part("p"))
        return side_by_side([part("v"), part("bg") + spin])

    def sideways(self, sigma: ArrayLike, *, lever: ArrayLike = (0.0, 0.0, 0.0)) -> Sensor:
        """`Sensor` of zero speed to the right and down (nonholonomic constraint), on the vehicle
        axes, at the axle that does not steer.

        The measurements are zeros ``(..., 2)``. Omit them while the vehicle skids or stands. The
        states mount and axle correct the vehicle axes and the lever arm.

        sigma: m/s, one number or ``(2,)``.
        lever: ``(3,)`` m from the IMU to the middle of the axle, on b.
        """
        arm = finite("lever", lever, (3,))
        return Sensor(
            partial(self._vehicle, arm, slice(1, 3)), sqrt_R=np.diag(_sigmas("sigma", sigma, 2))
        )

    def wheel_speed(self, sigma: float, *, lever: ArrayLike = (0.0, 0.0, 0.0)) -> Sensor:
        """`Sensor` of the forward speed ``(..., 1)`` m/s of the wheels on the axle that does not
        steer; arguments as in `sideways`. The state wheel is its scale-factor error.
        """
        arm = finite("lever", lever, (3,))
        return Sensor(
            partial(self._vehicle, arm, slice(0, 1)), sqrt_R=np.diag(_sigmas("sigma", sigma, 1))
        )

    def _vehicle(self, lever: Array, at: slice, x: Array, epoch: Any) -> Array:
        part, states = partial(self.space.part, x), self.states
        arm = lever + 0.0 * part("p")
        if "axle" in states:
            arm = arm + part("axle") * np.array([1.0, 0.0, 0.0])
        v = rotate(part("q"), part("v")) + cross_product(self._turning(x, epoch), arm)
        if "mount" in states:
            mount = part("mount")
            v = rotate(exp(side_by_side([0.0 * mount[..., :1], mount])), v)
        if "wheel" in states and at.start == 0:
            v = v * (1.0 + part("wheel"))
        return np.asanyarray(v[..., at])


def strapdown(
    latitude: float,
    height_m: float,
    imu: Imu,
    states: Iterable[str] | dict[str, float] = (),
    *,
    error: str = "invariant",
) -> Strapdown:
    """A `Strapdown` system near an origin. It models Earth rotation, Coriolis acceleration, and
    normal gravity with its first derivatives.

    The error of the gravity model is 1e-5 m/s^2 at 6 km from the origin and 1e-3 m/s^2 at 60 km.

    latitude, height_m: origin of the positions, rad and m above the ellipsoid.
    imu: noise of the IMU.
    states: names from `STATES`, or a dict from names to initial standard deviations.
    error: "invariant" uses the errors of `celnav.gaussian.extended_pose.extended_pose`, which are
        least sensitive to a poor heading. "body" has attitude errors on b, and velocity and
        position errors on n. "local" has all errors on n.

    Within an interval, process noise of attitude and biases is assumed not to affect the velocity.
    At 100 Hz this changes correlations of the process noise by less than 0.01.

    >>> system = celnav.models.inertial.strapdown(0.8, 100.0, imu, states=("lag", "lever"))
    >>> filter = celnav.ekf(system.motion, system.gnss(sigma_position=0.02))
    """
    place = number("latitude", latitude, -np.pi / 2, np.pi / 2), number("height_m", height_m)
    instance("imu", imu, Imu, "an Imu, such as celnav.models.inertial.Imu.datasheet(...)")
    names = sequence("states", states if not isinstance(states, dict) else [*states], '("lever",)')
    sizes = states if isinstance(states, dict) else {}
    chosen = {choice("states", name, STATES): sizes.get(name, STATES[name][1]) for name in names}
    sigmas = {name: number("states", size, above=0.0) for name, size in chosen.items()}
    return Strapdown(*place, imu, sigmas, choice("error", error, ERRORS))


def _sigmas(name: str, value: ArrayLike, count: int) -> Array:
    """Standard deviations ``(count,)``."""
    sigma = finite(name, value)
    if sigma.shape not in ((), (count,)) or (sigma <= 0.0).any():
        raise ValueError(
            f"{name}: expected a positive number, or {count} positive numbers, got {value!r:.80}"
        )
    return np.broadcast_to(sigma, count)
