"""The problems that every library solves: motion, measurement matrix, noise, prior, and data.

``step(xp)`` gives the motion over one interval as a function of states ``(..., n)``; ``xp`` is
numpy or jax.numpy. Numpy alone simulates, so that all processes have the same measurements.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

MU, J2, RADIUS = 398600.4418, 1.08262668e-3, 6378.137  # of the Earth, km and s


class Problem(NamedTuple):
    """``x' = step(x) + N(0, Q)``, ``z = H x + N(0, R)``; ``mean`` and ``P`` are the prior's."""

    step: Callable[[Any], Callable[[Any], Any]]
    mean: Any
    P: Any
    Q: Any
    H: Any
    R: Any


def problem(name: str) -> Problem:
    """Of a name such as "orbit", or "lorenz 8" and "linear 30" with the number of states."""
    kind, _, n = name.partition(" ")
    makers: dict[str, Callable[..., Problem]] = {
        "pendulum": pendulum,
        "ballistic": ballistic,
        "turn": turn,
        "orbit": orbit,
        "lorenz": lorenz,
        "linear": linear,
    }
    return makers[kind](int(n)) if n else makers[kind]()


def measurements(given: Problem, runs: int, epochs: int) -> Any:
    """``z (epochs, runs, m)`` of simulated runs; ``(epochs, m)`` of one run."""
    rng, step = np.random.default_rng(0), given.step(np)
    sqrt_P, sqrt_Q, sqrt_R = (np.linalg.cholesky(each) for each in (given.P, given.Q, given.R))
    n, m = len(given.mean), len(given.H)
    x, z = given.mean + rng.standard_normal((runs, n)) @ sqrt_P.T, np.empty((epochs, runs, m))
    for k in range(epochs):
        if k:
            x = step(x) + rng.standard_normal((runs, n)) @ sqrt_Q.T
        z[k] = x @ given.H.T + rng.standard_normal((runs, m)) @ sqrt_R.T
    return z[:, 0] if runs == 1 else z


def pendulum() -> Problem:
    """Angle and rate, steps of 0.1 s; the angle is measured."""

    def step(xp: Any, x: Any) -> Any:
        angle, rate = x[..., 0], x[..., 1]
        return xp.stack([angle + 0.1 * rate, rate - 0.1 * xp.sin(angle)], -1)

    mean, I2 = np.array([0.0, 1.0]), np.eye(2)
    return Problem(lambda xp: partial(step, xp), mean, I2, 0.02 * I2, np.eye(1, 2), 0.1 * np.eye(1))


def ballistic() -> Problem:
    """Position and velocity in a plane with quadratic drag, m and s; the position is measured."""

    def step(xp: Any, x: Any) -> Any:
        u, v = x[..., 2], x[..., 3]
        drag = 1e-3 * xp.sqrt(u * u + v * v)
        return xp.stack(
            [
                x[..., 0] + 0.1 * u,
                x[..., 1] + 0.1 * v,
                u - 0.1 * drag * u,
                v - 0.1 * (drag * v + 9.81),
            ],
            -1,
        )

    mean, P = np.array([0.0, 0.0, 300.0, 300.0]), np.diag([100.0, 100.0, 25.0, 25.0])
    return Problem(lambda xp: partial(step, xp), mean, P, 0.01 * np.eye(4), np.eye(2, 4), np.eye(2))


def turn() -> Problem:
    """A coordinated turn: position, speed, heading and its rate; the position is measured."""

    def step(xp: Any, x: Any) -> Any:
        speed, heading, rate = x[..., 2], x[..., 3], x[..., 4]
        middle = heading + 0.5 * rate
        east, north = x[..., 0] + speed * xp.cos(middle), x[..., 1] + speed * xp.sin(middle)
        return xp.stack([east, north, speed, heading + rate, rate], -1)

    mean, P = np.array([0.0, 0.0, 50.0, 0.5, 0.02]), np.diag([100.0, 100.0, 4.0, 0.01, 1e-4])
    Q = np.diag([0.1, 0.1, 0.01, 1e-5, 1e-6])
    return Problem(lambda xp: partial(step, xp), mean, P, Q, np.eye(2, 5), 25.0 * np.eye(2))


def orbit() -> Problem:
    """A low orbit with J2, steps of 1 s, km and km/s; the position is measured to 0.2 km."""
    mean = np.array([6180.0, 3568.0, 0.0, -1.58, 2.74, 6.77])
    P = np.diag([0.15**2] * 3 + [3.5e-5**2] * 3)
    Q = np.diag([7.5e-3**2] * 3 + [1e-8**2] * 3)
    return Problem(orbit_step, mean, P, Q, np.eye(3, 6), 0.04 * np.eye(3))


def orbit_step(xp: Any) -> Callable[[Any], Any]:
    """A Runge-Kutta step of order 4 and 1 s; the same as ``celnav.models.orbit.step(x, 1.0)``."""
    axis = np.array([0.0, 0.0, 3.0])

    def gravity(r: Any) -> Any:
        inverse = 1.0 / (r * r).sum(-1)[..., None]
        k, z = -MU * inverse * xp.sqrt(inverse), r[..., 2:]
        oblate = J2 * RADIUS**2 * k * inverse
        return r * (k - oblate * (7.5 * z * z * inverse - 1.5) + oblate * axis)

    def step(x: Any) -> Any:
        r, v = x[..., :3], x[..., 3:]
        a1, a2 = gravity(r), gravity(r + 0.5 * v)
        a3, a4 = gravity(r + 0.5 * v + 0.25 * a1), gravity(r + v + 0.5 * a2)
        r, v = r + v + (a1 + a2 + a3) / 6.0, v + (a1 + 2.0 * (a2 + a3) + a4) / 6.0
        return xp.concatenate([r, v], -1)

    return step


def lorenz(n: int) -> Problem:
    """Lorenz-96 with a forcing of 8, Runge-Kutta steps of 0.01; every second one is measured."""

    def rate(xp: Any, x: Any) -> Any:
        ring = xp.concatenate([x[..., -2:], x, x[..., :1]], -1)
        return (ring[..., 3:] - ring[..., :-3]) * ring[..., 1:-2] - x + 8.0

    def step(xp: Any, x: Any) -> Any:
        a = rate(xp, x)
        b = rate(xp, x + 0.005 * a)
        c = rate(xp, x + 0.005 * b)
        return x + 0.01 / 6.0 * (a + 2.0 * (b + c) + rate(xp, x + 0.01 * c))

    H = np.eye(n)[::2]
    return Problem(
        lambda xp: partial(step, xp),
        np.full(n, 8.0),
        np.eye(n),
        0.01 * np.eye(n),
        H,
        np.eye(len(H)),
    )


def linear_matrix(n: int) -> Any:
    """A rotation of n states, slowly damped."""
    return 0.99 * np.linalg.qr(np.random.default_rng(n).standard_normal((n, n)))[0]


def linear(n: int) -> Problem:
    """A linear system with n / 2 measurements, which mix all states."""
    F, H = linear_matrix(n), np.random.default_rng(n + 1).standard_normal((n // 2, n))
    I = np.eye(n)  # noqa: E741
    return Problem(lambda _: lambda x: x @ F.T, np.zeros(n), I, 0.1 * I, H, np.eye(n // 2))
