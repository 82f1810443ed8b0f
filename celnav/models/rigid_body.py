"""Rotation of a rigid satellite with momentum wheels under gravity gradient. Units: kg m^2, N m s, N m, rad, s."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from celnav.gaussian.attitude import cross, multiply, rotate, unit
from celnav.gaussian.checks import LIMIT, finite, integer, number
from celnav.gaussian.linalg import Array, matvec


@dataclass(frozen=True, eq=False)
class Body:
    """A satellite on a circular orbit.

    Attributes
    ----------
    inertia: ``(3, 3)``, body axes; ValueError for one that no distribution of mass has. wheels: ``(3,)``, angular momentum of the
        wheels. torque: ``(3,)``, constant.
    orbit_rate: rad/s; the inertial frame is the orbital one at t = 0 (x along the velocity, z to nadir).
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
            raise ValueError("inertia: expected a symmetric positive definite (3, 3)")
        if large > 1.001 * (small + middle):  # a flat plate attains it, and numbers are rounded
            got = f"{small:.6g}, {middle:.6g} and {large:.6g}"
            raise ValueError(f"inertia: expected principal moments none of which is larger than the two others together, got {got}")

    def nadir(self, q: Array, t: float) -> Array:
        """Direction of the Earth's center ``(..., 3)`` on body axes."""
        at = self.orbit_rate * t
        return rotate(q, [-np.sin(at), 0.0, np.cos(at)])

    def rates(self, x: Array, t: float) -> Array:
        """Rate of the state ``(..., 7)``: quaternion and angular velocity (rad/s, body axes)."""
        q, w = x[..., :4], x[..., 4:]
        turning = 0.5 * multiply(np.concatenate([w, np.zeros_like(w[..., :1])], -1), q)
        c = self.nadir(q, t)
        gradient = 3.0 * self.orbit_rate**2 * matvec(cross(c), matvec(self.inertia, c))
        torque = gradient + self.torque - matvec(cross(w), matvec(self.inertia, w) + self.wheels)
        return np.concatenate([turning, np.linalg.solve(self.inertia, torque[..., None])[..., 0]], -1)

    def propagate(self, x: Array, dt: float, steps: int) -> Array:
        """States ``(steps + 1, ..., 7)`` from the first at equal intervals, integrated to a relative 1e-12."""
        start, dt = finite("x", x, (..., 7)), number("dt", dt)
        unit(start[..., :4], "x")
        steps = integer("steps", steps, 0, LIMIT // max(start.size, 1))
        if not dt:
            raise ValueError("dt: expected an interval, got 0")

        def rates(t: float, flat: Array) -> Array:
            return self.rates(flat.reshape(start.shape), t).ravel()

        times = dt * np.arange(steps + 1)
        solved = solve_ivp(rates, (0.0, times[-1]), start.ravel(), method="DOP853", t_eval=times, rtol=1e-12, atol=1e-14)
        out = solved.y.T.reshape(steps + 1, *start.shape)
        out[..., :4] /= np.linalg.norm(out[..., :4], axis=-1, keepdims=True)
        return np.asarray(out)
