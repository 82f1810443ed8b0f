"""filterpy: one run at a time, one sigma point at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from benchmarks.problems import J2, MU, RADIUS, linear_matrix, measurements, problem

Work = Callable[[], Any]


def unscented(name: str, epochs: int, model: str = "numpy") -> Work:
    """An unscented filter of one run."""
    given = problem(name)
    n, m, H, z = len(given.mean), len(given.H), given.H, measurements(given, 1, epochs)
    step = numba_orbit() if model == "numba" else given.step(np)
    if name == "orbit" and model == "numpy":
        from celnav.models import orbit

        step = partial(orbit.step, dt=1.0)

    def work() -> Any:
        points = MerweScaledSigmaPoints(n, alpha=1.0, beta=0.0, kappa=0.0)
        ukf = UnscentedKalmanFilter(
            n, m, dt=1.0, hx=lambda x: H @ x, fx=lambda x, _dt: step(x), points=points
        )
        ukf.x, ukf.P, ukf.Q, ukf.R = given.mean.copy(), given.P.copy(), given.Q, given.R
        ukf.sigmas_f = points.sigma_points(ukf.x, ukf.P)  # for an update before the first predict
        means = []
        for k in range(epochs):
            if k:
                ukf.predict()
            ukf.update(z[k])
            means.append(ukf.x.copy())
        return np.array(means)

    return work


def kalman(name: str, runs: int, epochs: int) -> Work:
    """A Kalman filter of the first of many runs of a linear problem."""
    given = problem(name)
    n, m, z = len(given.mean), len(given.H), measurements(given, runs, epochs)[:, 0]

    def work() -> Any:
        kf = KalmanFilter(n, m)
        kf.x, kf.P, kf.F, kf.Q = given.mean.copy(), given.P.copy(), linear_matrix(n), given.Q
        kf.H, kf.R = given.H, given.R
        means = []
        for k in range(epochs):
            if k:
                kf.predict()
            kf.update(z[k])
            means.append(kf.x.copy())
        return np.array(means)

    return work


def numba_orbit() -> Callable[[Any], Any]:
    """The orbit's step, compiled by numba: as fast as a model in filterpy gets."""
    from numba import njit

    c = J2 * RADIUS**2

    @njit
    def gravity(x, y, z):  # type: ignore[no-untyped-def]
        inverse = 1.0 / (x * x + y * y + z * z)
        k = -MU * inverse * np.sqrt(inverse)
        oblate = c * k * inverse
        common = k - oblate * (7.5 * z * z * inverse - 1.5)
        return x * common, y * common, z * (common + 3.0 * oblate)

    @njit
    def step(s):  # type: ignore[no-untyped-def]
        x, y, z, u, v, w = s
        a1, b1, c1 = gravity(x, y, z)
        a2, b2, c2 = gravity(x + 0.5 * u, y + 0.5 * v, z + 0.5 * w)
        a3, b3, c3 = gravity(
            x + 0.5 * u + 0.25 * a1, y + 0.5 * v + 0.25 * b1, z + 0.5 * w + 0.25 * c1
        )
        a4, b4, c4 = gravity(x + u + 0.5 * a2, y + v + 0.5 * b2, z + w + 0.5 * c2)
        out = np.empty(6)
        out[0] = x + u + (a1 + a2 + a3) / 6.0
        out[1] = y + v + (b1 + b2 + b3) / 6.0
        out[2] = z + w + (c1 + c2 + c3) / 6.0
        out[3] = u + (a1 + 2.0 * (a2 + a3) + a4) / 6.0
        out[4] = v + (b1 + 2.0 * (b2 + b3) + b4) / 6.0
        out[5] = w + (c1 + 2.0 * (c2 + c3) + c4) / 6.0
        return out

    return step  # type: ignore[no-any-return]
