"""Linear covariance analysis: what a filter's errors are, or could be at best, without drawing any."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.belief import symmetric
from celnav.gaussian.checks import finite, together
from celnav.gaussian.linalg import Array


class Riccati(NamedTuple):
    """Gains ``(T, ..., n, m)`` and covariances after the update ``(T + 1, ..., n, n)``, the prior first."""

    gains: Array
    covariances: Array


def _gain(cross: Array, S: Array) -> Array:
    gain: Array = np.linalg.solve(S, cross.mT).mT
    return gain


def _system(F: ArrayLike, H: ArrayLike, **covariances: ArrayLike) -> tuple[Array, ...]:
    """Checked ``F (T, n, n)``, ``H (m, n)`` and covariances: P0 and Q of the state, others of the measurement."""
    f = finite("F", F, ("T", "n", "n"))
    h = finite("H", H, ("m", f.shape[-1]))
    sizes = {name: f.shape[-1] if name in ("P0", "Q") else len(h) for name in covariances}
    found = {name: symmetric(value, name, sizes[name])[0] for name, value in covariances.items()}
    together(**{name: value.shape[:-2] for name, value in found.items()})
    return f, h, *found.values()


def riccati(F: ArrayLike, H: ArrayLike, Q: ArrayLike, R: ArrayLike, P0: ArrayLike) -> Riccati:
    """Kalman filter covariances for ``x' = F x + w`` and white measurement noise.

    ``F (T, n, n)`` in time; ``H (m, n)``, ``Q (..., n, n)``, ``R (..., m, m)`` and ``P0 (..., n, n)`` are constant and broadcast
    over leading batch axes.
    """
    F, h, q, r, P = _system(F, H, Q=Q, R=R, P0=P0)
    gains, covariances = [], [P]
    eye = np.eye(P.shape[-1])
    for f in F:
        P = f @ P @ f.T + q
        K = _gain(P @ h.T, h @ P @ h.T + r)
        rest = eye - K @ h
        P = rest @ P @ rest.mT + K @ r @ K.mT
        gains.append(K)
        covariances.append(P)
    batch = np.broadcast_shapes(*(c.shape for c in covariances))
    return Riccati(np.stack(gains), np.stack([np.broadcast_to(c, batch) for c in covariances]))


def actual_covariance(
    F: ArrayLike, H: ArrayLike, gains: ArrayLike, Q: ArrayLike, Phi: ArrayLike, R: ArrayLike, P0: ArrayLike, Sigma0: ArrayLike
) -> Array:
    """True error covariances ``(T + 1, ..., n, n)`` of a filter with given gains when its noise is really colored.

    Exact for linear models: the covariance of ``[x_hat - x; V]`` is carried through prediction and update, with
    ``V' = Phi V + zeta``, ``zeta ~ N(0, R)``, ``V_0 ~ N(0, Sigma0)``. Arguments broadcast over leading batch axes.
    """
    F, h, q, r, P, V = _system(F, H, Q=Q, R=R, P0=P0, Sigma0=Sigma0)
    m, n = h.shape
    phi, gains = finite("Phi", Phi, (..., m, m)), finite("gains", gains, (..., n, m))
    if gains.ndim < 3 or len(gains) != len(F):
        raise ValueError(f"gains: expected {len(F)} of them, one for each F, got shape {gains.shape}")
    batch = together(
        gains=gains.shape[1:-2], Phi=phi.shape[:-2], Q=q.shape[:-2], R=r.shape[:-2], P0=P.shape[:-2], Sigma0=V.shape[:-2]
    )
    P, V = np.broadcast_to(P, (*batch, n, n)), np.broadcast_to(V, (*batch, m, m))
    C = np.zeros((*batch, n, m))
    out = [P]
    eye = np.eye(n)
    for f, K in zip(F, gains, strict=True):
        P, C, V = f @ P @ f.T + q, f @ C @ phi.mT, phi @ V @ phi.mT + r
        A = eye - K @ h
        cross = A @ C @ K.mT
        # The error after the update is A e + K V (of estimate minus truth).
        P, C = A @ P @ A.mT + cross + cross.mT + K @ V @ K.mT, A @ C + K @ V
        out.append(P)
    return np.stack(out)


def colored_bound(
    F: ArrayLike, H: ArrayLike, Phi: ArrayLike, Q: ArrayLike, R: ArrayLike, P0: ArrayLike, Sigma0: ArrayLike | None = None
) -> Array:
    """Posterior Cramer-Rao bounds ``(T + 1, ..., n, n)`` under colored measurement noise, for small process noise.

    ``F (T, n, n)`` along the true trajectory. ``Sigma0``: covariance of the first noise sample, if the first measurement is
    used; without it only differences of measurements inform. Arguments broadcast over leading batch axes.
    """
    F, h, q, r, P = _system(F, H, Q=Q, R=R, P0=P0)
    phi = finite("Phi", Phi, (..., len(h), len(h)))
    together(Phi=phi.shape[:-2], Q=q.shape[:-2], R=r.shape[:-2], P0=P.shape[:-2])
    eye = np.eye(P.shape[-1])
    if Sigma0 is not None:
        sigma = symmetric(Sigma0, "Sigma0", len(h))[0]
        together(Sigma0=sigma.shape[:-2], P0=P.shape[:-2])
        K = _gain(P @ h.T, h @ P @ h.T + sigma)
        rest = eye - K @ h
        P = rest @ P @ rest.mT + K @ sigma @ K.mT
    out = [P]
    for f in F:
        G = h @ f - phi @ h
        K = _gain(f @ P @ G.mT + q @ h.T, G @ P @ G.mT + h @ q @ h.T + r)
        A, B = f - K @ G, eye - K @ h
        P = A @ P @ A.mT + B @ q @ B.mT + K @ r @ K.mT
        out.append(P)
    batch = np.broadcast_shapes(*(p.shape for p in out))
    return np.stack([np.broadcast_to(p, batch) for p in out])
