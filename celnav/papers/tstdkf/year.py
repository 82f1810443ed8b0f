"""A year, by a linear driver: all filters about the nominal orbit, so that covariances and gains are computed once for all runs.

The filters are those of `celnav.papers.tstdkf.estimators`, written out for errors that are linear: 105,120 steps in less than a
minute. How far both are apart is a claim of the study (`compare`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.differenced import Noise
from celnav.filters.strong_tracking import excess, proportional, strong_tracking
from celnav.filters.two_stage import Boost
from celnav.linalg import Array, block
from celnav.models.variational import flow
from celnav.montecarlo import normals
from celnav.papers.tstdkf.config import Config
from celnav.papers.tstdkf.scenario import noise_of, nominal_orbit, sky

TRENDS = ("sine", "growing", "triangle")
FORMS = ("tdkf", "C", "B", "A")
"""Of the differenced filter: without strong tracking, and with the three forms of its factors."""
NAMES = ("ekf", "tkf", *FORMS, "aug")


class Linear(NamedTuple):
    """The nominal orbit, linearized: ``Phi``, ``G (T - 1, 6, 6)`` of the steps, ``Gamma (T, 3, 3)`` of the measurements."""

    Phi: Array
    G: Array
    Gamma: Array


def linear(config: Config, chunk: int = 8192) -> Linear:
    """Linearize the nominal orbit and its timings."""
    orbit, seen = nominal_orbit(config), sky(config)
    flows = [flow(orbit[k : min(k + chunk, config.steps)], config.step_s) for k in range(0, config.steps, chunk)]
    Gamma = config.timing.gradient(seen.earth + orbit[:, :3], seen.sun)
    return Linear(np.concatenate([f.Phi for f in flows]), np.concatenate([f.G for f in flows]), Gamma)


class Plain(NamedTuple):
    """EKF and TKF: errors ``x (runs, 6)`` with ``P``, bias ``b (runs, 3)`` with ``M``, sensitivity ``(6, 3)``."""

    x: Array
    P: Array
    b: Array
    M: Array
    Lambda: Array


def plain(s: Plain, Phi: Array, G: Array, Gamma: Array, z: Array, noise: Noise) -> Plain:
    """A step of `Plain` with the covariances of the driving noise."""
    H = _widened(Gamma)
    P, U = Phi @ s.P @ Phi.T + G @ noise.E @ G.T, Phi @ s.Lambda
    Sigma = H @ P @ H.T + noise.Xi
    K = np.linalg.solve(Sigma, H @ P).T
    x = s.x @ Phi.T
    innovation, S = z - x @ H.T, H @ U + Gamma
    Kb = np.linalg.solve(S @ s.M @ S.T + Sigma, S @ s.M).T
    left = np.eye(6) - K @ H
    P = left @ P @ left.T + K @ noise.Xi @ K.T
    b = s.b + (innovation - s.b @ S.T) @ Kb.T
    return Plain(x + innovation @ K.T, P, b, s.M - Kb @ S @ s.M, U - K @ S)


class Differenced(NamedTuple):
    """TDKF and TSTDKF: as `Plain`, with ``b (forms, runs, 3)``, correlations with V and Q, and what of the last epoch is needed.

    ``V (runs, 3)``: the last noise as estimated; before: ``(3, 3)``, what it owes to the bias.
    """

    x: Array
    P: Array
    b: Array
    M: Array
    Lambda: Array
    DV: Array
    DQ: Array
    V: Array
    before: Array
    memories: tuple[Any, Any]


def differenced(
    s: Differenced, Phi: Array, G: Array, Gamma: Array, z: Array, noise: Noise, boosts: tuple[Any, Any], first: bool
) -> Differenced:
    """A step of `Differenced`."""
    n, H, eye = noise, _widened(Gamma), np.eye(6)
    F, JF, sensor = n.F, n.J @ n.F, n.V if first else n.Xi
    Omega = np.linalg.solve((np.eye(3) + H @ G @ n.J).T, (G @ n.J).T).T
    B = eye - Omega @ H
    Phi1, G1 = B @ Phi, B @ G
    lag = np.zeros((3, 3)) if first else F
    seen = Gamma - lag @ s.before
    x = s.x @ Phi.T
    y = z - s.V @ lag.T - x @ H.T
    x = x + y @ Omega.T
    innovation = y - y @ (H @ Omega).T
    cross = Phi1 @ (s.DQ @ n.L.T + s.DV @ JF.T) @ G1.T
    P = Phi1 @ s.P @ Phi1.T + cross + cross.T + G1 @ (n.Q + JF @ n.V @ JF.T) @ G1.T
    Sigma = H @ P @ H.T + sensor
    K = np.linalg.solve(Sigma, H @ P).T
    left = eye - K @ H
    U = Phi1 @ s.Lambda - Omega @ seen
    S = H @ U + seen
    residual = innovation - s.b @ S.T
    total = S @ s.M @ S.T + Sigma
    given = Boost(residual, total, np.broadcast_to(innovation, residual.shape), Sigma)
    memory, factors = boosts[0](s.memories[0], given)
    memory_a, factors_a = boosts[1](s.memories[1], given)
    root = np.sqrt(np.concatenate([factors[:3], factors_a[3:]]))
    wide = s.M * root[..., :, None] * root[..., None, :]
    MS = wide @ S.T
    b = s.b + (MS @ np.linalg.solve(S @ MS + Sigma, residual[..., None]))[..., 0]
    Lambda, x = U - K @ S, x + innovation @ K.T
    return Differenced(
        x, left @ P @ left.T + K @ sensor @ K.T, b,
        s.M - s.M @ S.T @ np.linalg.solve(total, S @ s.M), Lambda,
        left @ (Phi1 @ s.DV @ F.T + G1 @ JF @ n.V @ F.T) - K @ sensor, left @ (Phi1 @ s.DQ @ n.L.T + G1 @ n.Q),
        z - x @ H.T, Gamma + H @ Lambda, (memory, memory_a),
    )  # fmt: skip


class Exact(NamedTuple):
    """AUG: errors ``x (runs, 18)`` of state, noises and bias."""

    x: Array
    P: Array


def exact(s: Exact, Phi: Array, G: Array, Gamma: Array, z: Array, noise: Noise, walk: Array) -> Exact:
    """A step of `Exact`; ``walk (18, 18)``: covariance of the bias's step."""
    n, A, B = noise, np.zeros((18, 18)), np.zeros((18, 9))
    A[:6, :6], A[:6, 6:9], A[:6, 9:15] = Phi, G @ n.J @ n.F, G @ n.L
    A[6:9, 6:9], A[9:15, 9:15], A[15:, 15:] = n.F, n.L, np.eye(3)
    B[:6, :3], B[:6, 3:], B[6:9, :3], B[9:15, 3:] = G @ n.J, G, np.eye(3), np.eye(6)
    B *= np.sqrt(np.concatenate([n.Xi.diagonal(), n.E.diagonal()]))
    H = np.concatenate([Gamma, np.zeros((3, 3)), np.eye(3), np.zeros((3, 6)), Gamma], 1)
    P = A @ s.P @ A.T + B @ B.T + walk
    HP = H @ P
    K = np.linalg.solve(HP @ H.T, HP).T
    x, P = s.x @ A.T, P - K @ HP
    return Exact(x + (z - x @ H.T) @ K.T, 0.5 * (P + P.T))


def _widened(Gamma: Array) -> Array:
    return np.concatenate([Gamma, np.zeros((3, 3))], 1)


def _factor(ratios: Array, rho: Array) -> Array:
    """Of the forms along the first axis; see `FORMS`."""
    return np.concatenate([np.ones_like(ratios[:1]), excess(ratios[1:2], rho), proportional(ratios[2:], rho)])


def track(
    config: Config, rngs: Sequence[np.random.Generator], trends: Sequence[str] = TRENDS, given: Linear | None = None
) -> dict[str, Array]:
    """Every filter along trends of the ephemeris error, on the same noise for each trend.

    Returns
    -------
    ``bias (T - 1, trends * rngs, 3)`` km, the truth; ``<filter>/bias``: as estimated; ``<filter>/position``: squared errors
    ``(T - 1, trends * rngs)`` km^2; see `NAMES`.
    """
    c, noise, T, count = config, noise_of(config), config.steps + 1, len(trends)
    lin = linear(config) if given is None else given
    xi, e, first, _ = (np.tile(d, (count, 1)) for d in normals(rngs, (T, 3), (T, 6), (9,), (9,)))
    runs = count * len(rngs)
    times = c.step_s * np.arange(T)
    bias = np.concatenate([np.tile(replace(c, trend=name).bias(times)[:, None], (1, len(rngs), 1)) for name in trends], 1)
    V, Q = first[:, :3] * np.sqrt(noise.V.diagonal()), first[:, 3:] * np.sqrt(noise.Q.diagonal())
    truth, start = np.zeros((runs, 6)), np.tile(c.deviation, (runs, 1))
    P, M, b = np.diag(c.deviation**2), c.bias_prior_km**2 * np.eye(3), np.zeros((runs, 3))
    walk = np.zeros((18, 18))
    walk[15:, 15:] = c.walk_km**2 * np.eye(3)
    whole = block([[P, 0, 0, 0], [0, noise.V, 0, 0], [0, 0, noise.Q, 0], [0, 0, 0, M]])
    s1 = Plain(start, P, b, M, np.zeros((6, 3)))
    s2 = Differenced(start, P, np.zeros((len(FORMS), runs, 3)), M, np.zeros((6, 3)), np.zeros((6, 3)), np.zeros((6, 6)), b,
                     np.zeros((3, 3)), (None, None))  # fmt: skip
    s3 = Exact(np.concatenate([start, np.zeros((runs, 12))], 1), whole)
    boosts = strong_tracking(c.rho, c.tau, factor=_factor), strong_tracking(c.rho, c.tau, factor=proportional, corrected=False)
    out = {"bias": bias[1:]}
    out |= {f"{name}/bias": np.zeros((T - 1, runs, 3)) for name in NAMES}
    out |= {f"{name}/position": np.empty((T - 1, runs)) for name in NAMES}
    for k in range(1, T):
        Phi, G, Gamma = lin.Phi[k - 1], lin.G[k - 1], lin.Gamma[k]
        V = V @ noise.F + c.sigma_km * xi[k]
        Q = Q @ noise.L + c.process_std * e[k]
        truth = truth @ Phi.T + (V @ noise.J.T + Q) @ G.T
        z = (truth[:, :3] + bias[k]) @ Gamma.T + V
        s1 = plain(s1, Phi, G, Gamma, z, noise)
        s2 = differenced(s2, Phi, G, Gamma, z, noise, boosts, k == 1)
        s3 = exact(s3, Phi, G, Gamma, z, noise, walk)
        found = [(s1.x, b), (s1.x + s1.b @ s1.Lambda.T, s1.b)]
        found += [(s2.x + form @ s2.Lambda.T, form) for form in s2.b]
        found.append((s3.x, s3.x[:, 15:]))
        for name, (x, estimate) in zip(NAMES, found, strict=True):
            away = x[:, :3] - truth[:, :3]
            out[f"{name}/bias"][k - 1] = estimate
            out[f"{name}/position"][k - 1] = np.add.reduce(away * away, 1)
    return out
