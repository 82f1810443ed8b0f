"""The filters written out for errors that are linear about the nominal orbit: covariances and gains are those of all runs at once.

They are those of `celnav.papers.tstdkf.estimators`; how far both are apart is a claim of the study. Covariances need no data at
all: `celnav.papers.tstdkf.analysis` follows them along the orbit.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import lapack

from celnav.filters.two_stage import Boost
from celnav.gaussian.linalg import Array, block
from celnav.models.orbit import flow
from celnav.papers.tstdkf.config import Config
from celnav.papers.tstdkf.method import Noise
from celnav.papers.tstdkf.scenario import Sky, noise_of, nominal_orbit, sky


class Linear(NamedTuple):
    """The nominal orbit, linearized, and what filters make of it whatever the data: of a step, or of all along a leading axis.

    Attributes
    ----------
    Phi, G: ``(6, 6)``. Gamma: ``(3, 3)``. H: ``(3, 6)``. driven: ``(6, 6)``, effect of the driving noise.
    Omega: ``(6, 3)``, how a differenced measurement enters its prediction; Phi1, G1: ``(6, 6)``, what it leaves of Phi and G.
    lagged, fresh: ``(6, 6)``: G1 times L', and covariance of its noise. through: ``(6, 3)``, G1 J F.
    A: ``(18, 18)`` and noise ``(18, 18)`` of the exact filter. whole: ``(3, 18)``, its H.
    """

    Phi: Array
    G: Array
    Gamma: Array
    H: Array
    driven: Array
    Omega: Array
    Phi1: Array
    G1: Array
    lagged: Array
    fresh: Array
    through: Array
    A: Array
    noise: Array
    whole: Array


def linearize(config: Config, orbit: Array, seen: Sky) -> Linear:
    """Linearize steps from one state of the orbit to the next ``(T, 6)``, and the timings after them."""
    n = noise_of(config)
    _, Phi, G = flow(orbit[:-1], config.step_s)
    Gamma = config.timing.gradient(seen.earth + orbit[:, :3], seen.sun)[1:]
    T, JF = len(Phi), n.J @ n.F
    H = np.concatenate([Gamma, np.zeros_like(Gamma)], -1)
    GJ = G @ n.J
    Omega = np.linalg.solve((np.eye(3) + H @ GJ).mT, GJ.mT).mT
    B = np.eye(6) - Omega @ H
    G1 = B @ G
    columns = block([[GJ @ np.sqrt(n.Xi), G @ np.sqrt(n.E)], [np.sqrt(n.Xi), 0], [0, np.sqrt(n.E)]])
    noise = np.zeros((T, 18, 18))
    noise[:, :15, :15] = columns @ columns.mT
    noise[:, 15:, 15:] = config.walk_km**2 * np.eye(3)
    A = block([[Phi, G @ JF, G @ n.L, 0], [0, n.F, 0, 0], [0, 0, n.L, 0], [0, 0, 0, np.eye(3)]])
    unit = np.broadcast_to(np.hstack([np.eye(3), np.zeros((3, 6))]), (T, 3, 9))
    return Linear(
        Phi, G, Gamma, H, G @ n.E @ G.mT, Omega, B @ Phi, G1, G1 @ n.L, G1 @ (n.Q + JF @ n.V @ JF.T) @ G1.mT, G1 @ JF,
        A, noise, np.concatenate([H, unit, Gamma], -1),
    )  # fmt: skip


class Plain(NamedTuple):
    """EKF and TKF: errors ``x (runs, 6)`` with ``P``, bias ``b (runs, 3)`` with ``M``, sensitivity ``(6, 3)``."""

    x: Array
    P: Array
    b: Array
    M: Array
    Lambda: Array


def plain(s: Plain, at: Linear, z: Array, noise: Noise) -> Plain:
    """A step of `Plain` with the covariances of the driving noise."""
    H = at.H
    P, U, x = at.Phi @ s.P @ at.Phi.T + at.driven, at.Phi @ s.Lambda, s.x @ at.Phi.T
    HP = H @ P
    Sigma = HP @ H.T + noise.Xi
    K = _solve(Sigma, HP).T
    innovation, S = z - x @ H.T, H @ U + at.Gamma
    SM = S @ s.M
    Kb = _solve(SM @ S.T + Sigma, SM).T
    P = P - K @ HP
    b = s.b + (innovation - s.b @ S.T) @ Kb.T
    return Plain(x + innovation @ K.T, 0.5 * (P + P.T), b, s.M - Kb @ SM, U - K @ S)


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
    memory: Any


def differenced(s: Differenced, at: Linear, z: Array, noise: Noise, boost: Any, first: bool) -> Differenced:
    """A step of `Differenced`."""
    H, Omega = at.H, at.Omega
    lag, sensor = (np.zeros((3, 3)), noise.V) if first else (noise.F, noise.Xi)
    seen, x = at.Gamma - lag @ s.before, s.x @ at.Phi.T
    y = z - s.V @ lag - x @ H.T
    into = y @ Omega.T
    x, innovation = x + into, y - into @ H.T
    ahead_V, ahead_Q = at.Phi1 @ s.DV, at.Phi1 @ s.DQ
    P = _ahead(s, at, ahead_V, ahead_Q, noise, first)
    HP = H @ P
    Sigma = HP @ H.T + sensor
    K = _solve(Sigma, HP).T
    left, P = np.eye(6) - K @ H, P - K @ HP
    U = at.Phi1 @ s.Lambda - Omega @ seen
    S = H @ U + seen
    SM, residual = S @ s.M, innovation - s.b @ S.T
    total = SM @ S.T + Sigma
    given = Boost(residual, total, innovation, Sigma)
    memory, factors = boost(s.memory, given)
    root = np.sqrt(factors)
    MS = (s.M * root[..., :, None] * root[..., None, :]) @ S.T
    b = s.b + (MS @ np.linalg.solve(S @ MS + Sigma, residual[..., None]))[..., 0]
    Lambda, x = U - K @ S, x + innovation @ K.T
    return Differenced(
        x, 0.5 * (P + P.T), b, s.M - SM.T @ _solve(total, SM), Lambda,
        left @ (ahead_V + at.through @ noise.V) @ lag - K @ sensor, left @ (ahead_Q @ noise.L + at.G1 @ noise.Q),
        z - x @ H.T, at.Gamma + H @ Lambda, memory,
    )  # fmt: skip


def _ahead(s: Differenced, at: Linear, ahead_V: Array, ahead_Q: Array, noise: Noise, first: bool) -> Array:
    """Covariance before the measurement; the first one, not differenced, takes all of V into the prediction."""
    cross = ahead_Q @ at.lagged.T + ahead_V @ at.through.T
    fresh = at.fresh - at.through @ noise.V @ at.through.T if first else at.fresh
    return np.asarray(at.Phi1 @ s.P @ at.Phi1.T + cross + cross.T + fresh)


def gain(s: Differenced, at: Linear, noise: Noise, first: bool) -> Array:
    """The gain ``(6, 3)`` of the next step."""
    P = _ahead(s, at, at.Phi1 @ s.DV, at.Phi1 @ s.DQ, noise, first)
    return _solve(at.H @ P @ at.H.T + (noise.V if first else noise.Xi), at.H @ P).T


class Exact(NamedTuple):
    """AUG: errors ``x (runs, 18)`` of state, noises and bias."""

    x: Array
    P: Array


def exact(s: Exact, at: Linear, z: Array) -> Exact:
    """A step of `Exact`."""
    P, x = at.A @ s.P @ at.A.T + at.noise, s.x @ at.A.T
    HP = at.whole @ P
    K = _solve(HP @ at.whole.T, HP).T
    P = P - K @ HP
    return Exact(x + (z - x @ at.whole.T) @ K.T, 0.5 * (P + P.T))


def _solve(P: Array, B: Array) -> Array:
    """``P^-1 B`` for one positive definite matrix; numpy's own costs several times as much for three rows."""
    solution: Array
    _, solution, failed = lapack.dposv(P, B)
    if failed:
        raise np.linalg.LinAlgError("an innovation covariance is not positive definite")
    return solution


def steps(config: Config, chunk: int = 4096) -> Iterator[Linear]:
    """The steps of the nominal orbit, linearized some at a time."""
    orbit, seen = nominal_orbit(config), sky(config)
    for first in range(0, config.steps, chunk):
        part = slice(first, first + chunk + 1)
        linear = linearize(config, orbit[part], Sky(seen.earth[part], seen.sun[part], None))
        yield from (Linear(*matrices) for matrices in zip(*linear, strict=True))


def start_plain(config: Config, runs: int) -> Plain:
    """As the filters begin, with the paper's initial error."""
    P, M = np.diag(config.deviation**2), config.bias_prior_km**2 * np.eye(3)
    return Plain(np.tile(config.deviation, (runs, 1)), P, np.zeros((runs, 3)), M, np.zeros((6, 3)))


def start_differenced(config: Config, runs: int, forms: int) -> Differenced:
    """The same of `Differenced`."""
    x, P, b, M, Lambda = start_plain(config, runs)
    return Differenced(x, P, np.zeros((forms, runs, 3)), M, Lambda, np.zeros((6, 3)), np.zeros((6, 6)), b, np.zeros((3, 3)), None)


def start_exact(config: Config, runs: int) -> Exact:
    """The same of `Exact`."""
    x, P, _, M, _ = start_plain(config, runs)
    noise = noise_of(config)
    return Exact(
        np.concatenate([x, np.zeros((runs, 12))], 1), block([[P, 0, 0, 0], [0, noise.V, 0, 0], [0, 0, noise.Q, 0], [0, 0, 0, M]])
    )
