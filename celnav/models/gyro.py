"""Rate gyros with drift [Farrenkopf1978]: measurements, propagation of an attitude, and
steady-state accuracy; and the rotation of a rigid satellite.

A gyro measures the mean rate over an interval, plus drift, plus white noise,
``measured = rate + beta + eta_v``. The drift is a Gauss-Markov process or a random walk. States
``(..., 7)`` are quaternion (see `celnav.gaussian.attitude`) and drift, rad/s. Errors ``(..., 6)``
are rotation vector on body axes, and drift.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from celnav.gaussian.attitude import cross, exp, inverse, log, multiply, rotate, unit
from celnav.gaussian.checks import LIMIT, finite, instance, integer, number, numbers, together
from celnav.gaussian.linalg import Array, matvec, side_by_side


@dataclass(frozen=True)
class Gyro:
    """Noise of a gyro triad; ValueError for negative values.

    sigma_v: angle random walk, rad/s^(1/2). sigma_u: drift random walk, rad/s^(3/2).
    tau: correlation time of the drift, s; inf for a random walk.
    """

    sigma_v: float
    sigma_u: float
    tau: float = np.inf

    def __post_init__(self) -> None:
        number("sigma_v", self.sigma_v, 0.0)
        number("sigma_u", self.sigma_u, 0.0)
        if not float(numbers("tau", self.tau, ())) > 0.0:
            raise ValueError(
                f"tau: expected a positive time (inf for a random walk), got {self.tau!r}"
            )

    @classmethod
    def datasheet(
        cls,
        angle_random_walk: float,
        *,
        rate_random_walk: float = 0.0,
        bias_instability: float = 0.0,
        tau: float = np.inf,
    ) -> Gyro:
        """A `Gyro` from a data sheet [IEEE1997]; the drift is a random walk, or a Gauss-Markov
        process.

        angle_random_walk: N, deg/h^(1/2), which is 60 times a noise density in deg/s/Hz^(1/2).
        rate_random_walk: K, deg/h^(3/2); 0 if ``bias_instability`` is positive.
        bias_instability: B, deg/h, used as the standard deviation of a drift with correlation time
            ``tau`` s. Its Allan deviation has a maximum of 0.62 B at 1.9 tau; the Allan deviation
            of flicker noise is 0.66 B everywhere.

        >>> celnav.models.gyro.Gyro.datasheet(0.3, bias_instability=5.0, tau=600.0)
        """
        white = np.radians(number("angle_random_walk", angle_random_walk, 0.0)) / 60.0
        walk = np.radians(number("rate_random_walk", rate_random_walk, 0.0)) / 3600.0 / 60.0
        if not number("bias_instability", bias_instability, 0.0):
            return cls(float(white), float(walk), tau)
        if walk:
            raise ValueError(
                "rate_random_walk: expected 0 together with a bias_instability, got "
                f"{rate_random_walk!r}"
            )
        time = number("tau", tau, above=0.0)  # a standard deviation alone does not define a process
        return cls(
            float(white), float(np.radians(bias_instability / 3600.0) * np.sqrt(2.0 / time)), time
        )

    def factor(self, dt: float) -> float:
        """Factor by which the drift decays in ``dt`` seconds."""
        return float(np.exp(-dt / self.tau))

    def rate_std(self, dt: float) -> float:
        """Standard deviation of the white noise of a sample over ``dt`` seconds, rad/s."""
        return self.sigma_v / float(np.sqrt(dt))

    def drift_std(self, dt: float) -> float:
        """Standard deviation of the drift's change over ``dt`` seconds, rad/s; for an infinite
        ``dt`` it is the stationary drift's, ``sigma_u sqrt(tau / 2)``.
        """
        if np.isinf(self.tau):
            return self.sigma_u * float(np.sqrt(dt))
        return self.sigma_u * float(np.sqrt(-0.5 * self.tau * np.expm1(-2.0 * dt / self.tau)))

    def drift(self, start: Array, walk: Array, dt: float) -> Array:
        """Drift ``(T, ..., 3)`` rad/s from ``start (..., 3)`` in steps of ``dt`` s;
        ``walk (T - 1, ..., 3)`` is standard normal.
        """
        drift = np.empty((len(walk) + 1, *walk.shape[1:]))
        drift[0], factor, deviation = start, self.factor(dt), self.drift_std(dt)
        for k, draw in enumerate(walk):
            drift[k + 1] = factor * drift[k] + deviation * draw
        return drift

    def process_noise(self, dt: float) -> Array:
        """Covariance ``(6, 6)`` of the errors of rotation vector and drift over ``dt`` seconds
        [Crassidis2003].
        """
        # [[sigma_v^2 T + sigma_u^2 T^3 / 3, -sigma_u^2 T^2 / 2], [., sigma_u^2 T]] on each axis.
        u2 = self.sigma_u**2
        angle, both, drift = (
            self.sigma_v**2 * dt + u2 * dt**3 / 3.0,
            -0.5 * u2 * dt**2,
            self.drift_std(dt) ** 2,
        )
        return np.kron([[angle, both], [both, drift]], np.eye(3))

    def measure(self, q: Array, drift: Array, noise: Array, dt: float) -> Array:
        """Gyro samples ``(T - 1, ..., 3)`` rad/s for attitudes ``q (T, ..., 4)``.

        drift: ``(T - 1, ..., 3)`` rad/s, or with all T epochs, or constant ``(..., 3)``.
        noise: standard normal ``(T - 1, ..., 3)``. dt: interval, s. ValueError for arguments that
        do not broadcast.
        """
        q, dt = unit(q, "q"), number("dt", dt, above=0.0)
        if q.ndim < 2 or len(q) < 2:
            raise ValueError(
                f"q: expected attitudes (T, ..., 4) at two epochs or more, got shape {q.shape}"
            )
        # Rotation vectors (T - 1, ..., 3) in body axes.
        turns = log(multiply(q[1:], inverse(q[:-1])))
        drift, noise = finite("drift", drift, (..., 3)), finite("noise", noise, (..., 3))
        # A drift with all T epochs: the last epoch has no sample.
        if drift.ndim >= max(turns.ndim, noise.ndim) and len(drift) == len(q):
            drift = drift[:-1]
        together(q=turns.shape[:-1], drift=drift.shape[:-1], noise=noise.shape[:-1])
        return np.asanyarray(turns / dt + drift + self.rate_std(dt) * noise)

    def propagate(
        self, x: Array, measured: Array, dt: float, rate_noise: Array | float = 0.0
    ) -> Array:
        """State ``(..., 7)`` after ``dt`` s; the rate is ``measured (..., 3)`` minus drift and
        ``rate_noise``, rad/s.
        """
        drift = x[..., 4:]
        # q' = exp(w dt) (x) q
        q = multiply(exp((measured - drift - rate_noise) * dt), x[..., :4])
        return side_by_side([q, self.factor(dt) * drift])

    def transition(self, x: Array, measured: Array, dt: float) -> Array:
        """Jacobian ``(..., 6, 6)`` of `propagate` for the errors of rotation vector and drift."""
        turn = (measured - x[..., 4:]) * dt
        angle = np.linalg.norm(turn, axis=-1)[..., None, None]
        small = angle < 1e-3
        safe = np.where(small, 1.0, angle)
        first = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(angle)) / safe**2)
        second = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
        T, eye = cross(turn), np.eye(3)
        square = T @ T
        matrix = np.zeros((*turn.shape[:-1], 6, 6), like=turn)
        # exp(-[turn x]), and minus its integral over the interval.
        matrix[..., :3, :3] = eye - np.sinc(angle / np.pi) * T + first * square
        matrix[..., :3, 3:] = -dt * (eye - first * T + second * square)
        matrix[..., 3:, 3:] = self.factor(dt) * eye
        return matrix


def preintegrate(measured: Array, drift: Array, dt: float) -> Array:
    """One gyro sample ``(..., 3)`` rad/s that gives the same rotation as the k samples
    ``measured (k, ..., 3)``, each over ``dt`` s, for a drift ``(..., 3)`` rad/s.
    """
    measured, drift, dt = (
        finite("measured", measured, (..., 3)),
        finite("drift", drift, (..., 3)),
        number("dt", dt, above=0.0),
    )
    if measured.ndim < 2 or not len(measured):
        raise ValueError(
            f"measured: expected one sample or more, (k, ..., 3), got shape {measured.shape}"
        )
    together(measured=measured.shape[1:-1], drift=drift.shape[:-1])
    turned = exp((measured[0] - drift) * dt)
    for sample in measured[1:]:
        turned = multiply(exp((sample - drift) * dt), turned)
    return np.asanyarray(log(turned) / (len(measured) * dt) + drift)


class SteadyState(NamedTuple):
    """Standard deviations of attitude (rad) and drift (rad/s) before and after a star update, on
    each axis.
    """

    attitude_before: float
    attitude_after: float
    drift_before: float
    drift_after: float


def steady_state(sigma_n: float, gyro: Gyro, interval: float) -> SteadyState:
    """`SteadyState` of a filter with attitude measurements of ``sigma_n`` rad every ``interval`` s
    and a random-walk drift [Farrenkopf1978].
    """
    sigma_n, interval = (
        number("sigma_n", sigma_n, above=0.0),
        number("interval", interval, above=0.0),
    )
    instance("gyro", gyro, Gyro, "a Gyro, such as Gyro(sigma_v, sigma_u)")
    if np.isfinite(gyro.tau):
        raise ValueError(f"gyro: expected a random-walk drift (tau = inf), got tau = {gyro.tau!r}")
    T, u, v = interval, gyro.sigma_u, gyro.sigma_v
    Su, Sv = u * T**1.5 / sigma_n, v * np.sqrt(T) / sigma_n
    small = Sv**2 / 4.0 + Su**2 / 48.0
    g = np.sqrt(1.0 + small)
    # zeta - 1, without a subtraction, which would lose the digits that matter for a good gyro.
    excess = small / (g + 1.0) + Su / 4.0 + 0.5 * np.sqrt(2.0 * g * Su + Sv**2 + Su**2 / 3.0)
    zeta = 1.0 + excess
    before = sigma_n * np.sqrt(excess * (zeta + 1.0))
    cross_before = -u * np.sqrt(T) * sigma_n * zeta
    drift = (cross_before / zeta**2 - cross_before) / T - 0.5 * u**2 * T  # variance after
    return SteadyState(
        float(before), float(before / zeta), float(np.sqrt(drift + u**2 * T)), float(np.sqrt(drift))
    )


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid satellite with momentum wheels on a circular orbit, under gravity-gradient torque.

    inertia: ``(3, 3)`` kg m^2, body axes; ValueError if no distribution of mass has it.
    wheels: ``(3,)`` N m s, angular momentum of the wheels. torque: ``(3,)`` N m, a constant.
    orbit_rate: rad/s. The inertial frame is the orbital frame at t = 0: x along the velocity, z to
        nadir.
    """

    inertia: Any
    wheels: Any = (0.0, 0.0, 0.0)
    torque: Any = (0.0, 0.0, 0.0)
    orbit_rate: float = 0.0

    def __post_init__(self) -> None:
        for name, shape in (("inertia", (3, 3)), ("wheels", (3,)), ("torque", (3,))):
            object.__setattr__(self, name, finite(name, getattr(self, name), shape))
        number("orbit_rate", self.orbit_rate)
        small, middle, large = np.linalg.eigvalsh(self.inertia).tolist()
        if not np.allclose(self.inertia, self.inertia.T) or small <= 0.0:
            raise ValueError(
                f"inertia: expected a symmetric positive definite (3, 3), got {self.inertia!r:.80}"
            )
        if large > 1.001 * (small + middle):  # a flat plate has equality, up to rounding
            got = f"{small:.6g}, {middle:.6g} and {large:.6g}"
            raise ValueError(
                "inertia: expected principal moments that satisfy the triangle inequality, got "
                f"{got}"
            )

    def nadir(self, q: Array, t: float) -> Array:
        """Unit vector ``(..., 3)`` to the Earth's center on body axes, at attitudes ``q (..., 4)``
        and time ``t`` s.
        """
        at = self.orbit_rate * t
        return rotate(q, [-np.sin(at), 0.0, np.cos(at)])

    def rates(self, x: Array, t: float) -> Array:
        """Time derivative ``(..., 7)`` of the state: quaternion and angular velocity (rad/s, body
        axes).
        """
        q, w = x[..., :4], x[..., 4:]
        turning = 0.5 * multiply(np.concatenate([w, np.zeros_like(w[..., :1])], -1), q)
        c = self.nadir(q, t)
        # J w' = 3 n^2 c x J c + torque - w x (J w + h), with c the nadir and h the wheels.
        gradient = 3.0 * self.orbit_rate**2 * matvec(cross(c), matvec(self.inertia, c))
        torque = gradient + self.torque - matvec(cross(w), matvec(self.inertia, w) + self.wheels)
        return np.concatenate(
            [turning, np.linalg.solve(self.inertia, torque[..., None])[..., 0]], -1
        )

    def propagate(self, x: Array, dt: float, steps: int) -> Array:
        """States ``(steps + 1, ..., 7)`` at intervals of ``dt`` s, the start ``x (..., 7)`` first,
        integrated with a relative tolerance of 1e-12.
        """
        start, dt = finite("x", x, (..., 7)), number("dt", dt)
        unit(start[..., :4], "x")
        steps = integer("steps", steps, 0, LIMIT // max(start.size, 1))
        if not dt:
            raise ValueError("dt: expected an interval other than 0, got 0")

        def rates(t: float, flat: Array) -> Array:
            return self.rates(flat.reshape(start.shape), t).ravel()

        times = dt * np.arange(steps + 1)
        solved = solve_ivp(
            rates,
            (0.0, times[-1]),
            start.ravel(),
            method="DOP853",
            t_eval=times,
            rtol=1e-12,
            atol=1e-14,
        )
        out = solved.y.T.reshape(steps + 1, *start.shape)
        out[..., :4] /= np.linalg.norm(out[..., :4], axis=-1, keepdims=True)
        return np.asanyarray(out)
