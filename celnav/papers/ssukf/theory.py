"""What follows from the model alone: exact covariances of one axis, their limit, and readings of the gyro's printed numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from celnav.gaussian.linalg import Array
from celnav.models.gyro import Gyro
from celnav.papers.ssukf.config import ARCSEC, DEG_PER_H, Config

EPOCHS_S = (1.0, 10.0, 60.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0)


class Reading(NamedTuple):
    """One way to read "0.5 deg/h white, 0.02 deg/h driving", which have no bandwidth."""

    name: str
    gyro: Gyro
    remark: str


def readings(config: Config) -> list[Reading]:
    """The readings of the gyro's numbers, ours first."""
    white, drift, dt = config.gyro_deg_per_h * DEG_PER_H, config.drift_deg_per_h * DEG_PER_H, config.gyro_dt
    sample = white * float(np.sqrt(dt))

    def stationary(tau: float) -> Gyro:
        return Gyro(sample, drift * float(np.sqrt(2.0 / tau)), tau)

    return [
        Reading("A", config.gyro, "deviation of one 100 Hz sample; stationary drift, tau = 1 h (ours)"),
        Reading("A, tau = 100 s", stationary(100.0), "as A"),
        Reading("A, tau = 10 h", stationary(36000.0), "as A"),
        Reading("E", Gyro(sample, drift / 60.0), "as A; drift a random walk of 0.02 deg/h in an hour"),
        Reading("F", Gyro(sample, drift), "as A; random walk of 0.02 deg/h in a second: 1.2 deg/h in an hour"),
        Reading("C", Gyro(white, drift), "both densities: deg/h sqrt(s) and deg/h / sqrt(s)"),
        Reading("B", Gyro(sample, drift / float(np.sqrt(dt))), "0.02 deg/h added at every sample: 12 deg/h in an hour"),
        Reading("D", Gyro(white * 60.0, drift / 60.0), "0.5 deg / sqrt(h): the gyro hardly helps"),
    ]


def _axis(gyro: Gyro, dt: float) -> tuple[Array, Array]:
    """Transition and process noise ``(2, 2)`` of the errors of angle and drift on one axis."""
    return np.array([[1.0, -dt], [0.0, gyro.factor(dt)]]), gyro.process_noise(dt)[::3, ::3]


def limit(gyro: Gyro, sigma_n: float, dt: float) -> Array:
    """Deviations ``(2, 2)`` that settle, of angle (rad) and drift (rad/s), before (first row) and after a star sample."""
    F, Q = _axis(gyro, dt)
    # In units of about one, or the solver loses the drift beside the angle.
    scale = np.array([sigma_n, sigma_n / 100.0])
    unit = np.outer(scale, scale)
    H = np.array([[1.0, 0.0]])
    before = solve_discrete_are((F * scale / scale[:, None]).T, H.T, Q / unit, np.eye(1))
    gain = before @ H.T / (before[0, 0] + 1.0)
    after = before - gain @ (H @ before)
    return np.asarray(np.sqrt([np.diag(before), np.diag(after)]) * scale)


def exact_deviations(config: Config) -> Array:
    """Posterior deviations ``(T, 2)`` of angle (arcsec) and drift (deg/h) at the star epochs, of the widest axis of the prior."""
    F, Q = _axis(config.gyro, 1.0 / config.star_hz)
    P = np.diag(np.square(config.sigma0[[2, 5]]))
    out = [np.sqrt(P.diagonal())]
    for _ in range(config.star_epochs):
        P = F @ P @ F.T + Q
        P = P - np.outer(P[:, 0], P[0]) / (P[0, 0] + config.sigma_n**2)
        out.append(np.sqrt(P.diagonal()))
    return np.asarray(np.array(out) / [ARCSEC, DEG_PER_H])
