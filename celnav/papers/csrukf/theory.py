"""Exact linear covariance analysis along the nominal orbit: the curves that Monte Carlo must follow."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from celnav.analysis.bounds import actual_covariance, colored_bound, riccati
from celnav.gaussian.linalg import Array
from celnav.models import orbit
from celnav.papers.csrukf.config import Config
from celnav.papers.csrukf.published import TABLE_1, TABLE_2
from celnav.papers.csrukf.scenario import H

UNITS = np.repeat([1.0, 1e3], 3)
"""From km and km/s to the km and m/s of the paper's tables."""
SWEEP = (-0.5, 0.0, 0.5, 0.8, 0.95, 0.99, 0.999, 1.0)


class Expected(NamedTuple):
    """Standard deviations ``(T, ..., 6)`` km, m/s that the filters really have; the batch axis runs over Phi."""

    srukf: Array
    csrukf: Array
    first: Array
    openloop: Array


def transitions(config: Config, steps: int) -> Array:
    """Transition matrices ``(steps, 6, 6)`` along the nominal orbit."""
    return orbit.transition(config.nominal(steps)[:-1], config.step_s)


def expected(config: Config, phis: tuple[float, ...], steps: int | None = None) -> Expected:
    """True standard deviations of SRUKF, CSRUKF, CSRUKF with the first sample, and open loop, for each ``Phi = phi I``."""
    F = transitions(config, config.steps if steps is None else steps)
    Phi = np.asarray(phis)[:, None, None] * np.eye(3)
    Q, P0, R = config.sqrt_Q @ config.sqrt_Q.T, config.sqrt_P0 @ config.sqrt_P0.T, config.R
    gains = riccati(F, H, Q, R, P0).gains
    srukf = actual_covariance(F, H, gains, Q, Phi, R, P0, R)
    csrukf, first = (colored_bound(F, H, Phi, Q, R, P0, Sigma0) for Sigma0 in (None, R))
    free = actual_covariance(F, H, 0.0 * gains, Q, Phi, R, P0, R)
    return Expected(*(UNITS * np.sqrt(P.diagonal(0, -2, -1)) for P in (srukf, csrukf, first, free)))


def misfit(stds: Expected, *, average: bool) -> float:
    """R.m.s. factor between the paper's Tables 1 and 2 and a configuration, ``exp(rms log ratio)``.

    Over eight numbers: position and velocity (rms over the axes), two filters, Phi = 0 and I; final or time-averaged errors.
    """
    logs = []
    for table, i in ((TABLE_1, 0), (TABLE_2, -1)):
        for filter, std in (("SRUKF", stds.srukf[:, i]), ("CSRUKF", stds.csrukf[:, i])):
            ours = np.sqrt(np.square(std[1:]).mean(0)) if average else std[-1]
            for part in (slice(0, 3), slice(3, 6)):
                logs.append(np.log(np.linalg.norm(ours[part]) / np.linalg.norm(table[filter][part])))
    return float(np.exp(np.sqrt(np.mean(np.square(logs)))))


def position(std: Array) -> Array:
    """3-D position standard deviation, km."""
    return np.asarray(np.linalg.norm(std[..., :3], axis=-1))


def long_arc(config: Config, steps: int) -> dict[str, Array]:
    """3-D position (km) for Phi = I and 0.8 I, ``(T, 2)``, from a poor prior without process noise.

    The bound uses the first sample, SRUKF does not.
    """
    poor = replace(
        config, prior_position_km=100.0, prior_velocity_m_per_s=100.0, noise_position_km=0.0, noise_velocity_km_per_s=1e-15
    )
    F = transitions(poor, steps)
    Phi = np.array([1.0, 0.8])[:, None, None] * np.eye(3)
    Q, P0, R = poor.sqrt_Q @ poor.sqrt_Q.T, poor.sqrt_P0 @ poor.sqrt_P0.T, poor.R
    bound = colored_bound(F, H, Phi, Q, R, P0, R)
    srukf = actual_covariance(F, H, riccati(F, H, Q, R, P0).gains, Q, Phi, R, P0, R)
    return {name: position(np.sqrt(P.diagonal(0, -2, -1))) for name, P in (("bound", bound), ("srukf", srukf))}


class Settings(NamedTuple):
    """Ratios of time-averaged errors over random settings (erratum 21), each ``(settings,)``."""

    growth: Array
    gain: Array


def random_settings(config: Config, count: int, rng: np.random.Generator) -> Settings:
    """How much SRUKF can grow from Phi = 0.8 I to I, and CSRUKF gain at 0.8 I, over random sigma, P0, Q and Sigma0.

    Drawn log-uniformly: sigma 0.03 to 3 km, the prior 0.1 to 10 sigma and 3 mm/s to 0.3 m/s, process noise 1e-4 to 0.1 sigma
    and 1e-6 to 1e-4 m/s, Sigma0 0.1 to 10 R. These are the priors with which Table 1 can come out at all.
    """
    sigma = 10.0 ** rng.uniform(-1.5, 0.5, count)
    p_r, p_v = sigma * 10.0 ** rng.uniform(-1.0, 1.0, count), 10.0 ** rng.uniform(-5.5, -3.5, count)
    q_r, q_v = sigma * 10.0 ** rng.uniform(-4.0, -1.0, count), 10.0 ** rng.uniform(-9.0, -7.0, count)
    s0 = 10.0 ** rng.uniform(-0.5, 0.5, count)

    def diagonal(a: Array, b: Array) -> Array:
        return np.asarray(np.eye(6) * np.repeat(np.stack([a, b], -1) ** 2, 3, -1)[:, None, :])

    P0, Q = diagonal(p_r, p_v), diagonal(q_r, q_v)
    R = sigma[:, None, None] ** 2 * np.eye(3)
    F = transitions(config, config.steps)
    gains = riccati(F, H, Q, R, P0).gains
    rms = []
    for phi in (0.8, 1.0):
        P = actual_covariance(F, H, gains, Q, phi * np.eye(3), R, P0, R * s0[:, None, None] ** 2)
        rms.append(np.sqrt(P[..., :3, :3].diagonal(0, -2, -1).sum(-1).mean(0)))
    best = colored_bound(F, H, 0.8 * np.eye(3), Q, R, P0)
    optimal = np.sqrt(best[..., :3, :3].diagonal(0, -2, -1).sum(-1).mean(0))
    return Settings(rms[1] / rms[0], rms[0] / optimal)
