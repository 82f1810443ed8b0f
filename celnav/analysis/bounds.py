"""Linear covariance analysis: the error covariance of a filter, or a lower bound, without
simulation.

The system is ``x' = F x + w``, ``w ~ N(0, Q)``, with measurements ``z = H x + V``. The transition
matrices ``F (T, n, n)`` are linearized at the true trajectory, and ``H (m, n)`` is constant. All
other arguments may have leading batch axes, which broadcast.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.belief import symmetric
from celnav.gaussian.checks import finite, together
from celnav.gaussian.linalg import Array

__all__ = ["actual_covariance", "colored_bound", "riccati"]


class Riccati(NamedTuple):
    """Gains ``(T, ..., n, m)``, and covariances after the updates ``(T + 1, ..., n, n)``, the prior
    first.
    """

    gains: Array
    covariances: Array


def riccati(F: ArrayLike, H: ArrayLike, Q: ArrayLike, R: ArrayLike, P0: ArrayLike) -> Riccati:
    """Gains and covariances of the Kalman filter with white noise: `Riccati`.

    F: ``(T, n, n)``. H: ``(m, n)``. Q, P0: ``(..., n, n)``. R: ``(..., m, m)``. ValueError if a
    covariance is not positive semidefinite or a shape does not match.

    >>> bound = celnav.analysis.bounds.riccati(np.tile(F, (100, 1, 1)), H, Q, R, P0).covariances
    """
    transitions, h, q, r, P = _system(F, H, Q=Q, R=R, P0=P0)
    # The loop is over time; P is (..., n, n).
    gains, covariances = [], [P]
    for f in transitions:
        K, P = _updated(f @ P @ f.T + q, h, r)
        gains.append(K)
        covariances.append(P)
    return Riccati(np.stack(gains), np.stack(covariances))


def actual_covariance(
    F: ArrayLike,
    H: ArrayLike,
    gains: ArrayLike,
    Q: ArrayLike,
    Phi: ArrayLike,
    R: ArrayLike,
    P0: ArrayLike,
    Sigma0: ArrayLike,
) -> Array:
    """True error covariances ``(T + 1, ..., n, n)`` of a filter with the given ``gains`` under
    colored measurement noise.

    The noise is ``V' = Phi V + zeta``, ``zeta ~ N(0, R)``, ``V_0 ~ N(0, Sigma0)``. The function
    propagates the covariance of ``[x_hat - x; V]``, which is exact for linear models.

    gains: ``(T, ..., n, m)``, as from `riccati`. Phi, R, Sigma0: ``(..., m, m)``.

    >>> gains = celnav.analysis.bounds.riccati(Fs, H, Q, R, P0).gains  # assumes white noise
    >>> Phi, W = 0.9 * np.eye(3), 0.19 * R
    >>> cov = celnav.analysis.bounds.actual_covariance(Fs, H, gains, Q, Phi, W, P0, R)
    """
    transitions, h, q, phi, r, P, V = _system(F, H, Q=Q, Phi=Phi, R=R, P0=P0, Sigma0=Sigma0)
    m, n = h.shape
    gains = finite("gains", gains, (..., n, m))
    if gains.ndim < 3 or len(gains) != len(transitions):
        raise ValueError(
            f"gains: expected {len(transitions)} gains, one for each F, got shape {gains.shape}"
        )
    batch = together(gains=gains.shape[1:-2], P0=P.shape[:-2])
    # C = cov(e, V) is zero at the start: no measurement has been used.
    P, C = np.broadcast_to(P, (*batch, n, n)), np.zeros((*batch, n, m))
    out = [P]
    for f, K in zip(transitions, gains, strict=True):
        # Prediction: e' = F e - w, V' = Phi V + zeta.
        P, C, V = f @ P @ f.T + q, f @ C @ phi.mT, phi @ V @ phi.mT + r
        A = np.eye(n) - K @ h
        cross = A @ C @ K.mT
        # The error after the update is A e + K V, as estimate minus truth; C = cov(e, V).
        P, C = A @ P @ A.mT + cross + cross.mT + K @ V @ K.mT, A @ C + K @ V
        out.append(P)
    return np.stack(out)


def colored_bound(
    F: ArrayLike,
    H: ArrayLike,
    Phi: ArrayLike,
    Q: ArrayLike,
    R: ArrayLike,
    P0: ArrayLike,
    Sigma0: ArrayLike | None = None,
) -> Array:
    """Posterior Cramer-Rao bounds ``(T + 1, ..., n, n)`` under colored measurement noise, for small
    process noise.

    Phi, R: as in `actual_covariance`.
    Sigma0: covariance of the first noise sample. With it, the first measurement is used; without
        it, only differences of measurements give information.

    >>> Phi, W = 0.9 * np.eye(3), 0.19 * R
    >>> cov = celnav.analysis.bounds.colored_bound(Fs, H, Phi, Q, W, P0, Sigma0=R)
    """
    first = R if Sigma0 is None else Sigma0
    transitions, h, q, phi, r, P, sigma = _system(F, H, Q=Q, Phi=Phi, R=R, P0=P0, Sigma0=first)
    if Sigma0 is not None:
        P = _updated(P, h, sigma)[1]
    out = [P]
    for f in transitions:
        # z* = z' - Phi z = G x + H w + zeta.
        G = h @ f - phi @ h
        cross, S = f @ P @ G.mT + q @ h.T, G @ P @ G.mT + h @ q @ h.T + r
        # K = cross S^-1, solved from the left because S is symmetric.
        K = np.linalg.solve(S, cross.mT).mT
        # x' = F x + w and z* give the error A e - B w + K zeta.
        A, B = f - K @ G, np.eye(len(f)) - K @ h
        P = A @ P @ A.mT + B @ q @ B.mT + K @ r @ K.mT
        out.append(P)
    return np.stack(out)


def _system(F: ArrayLike, H: ArrayLike, **matrices: ArrayLike) -> list[Array]:
    """Check ``F``, ``H`` and the other ``matrices``, and return them in this order; P0 gets the
    batch axes of all.
    """
    f = finite("F", F, ("T", "n", "n"))
    h = finite("H", H, ("m", f.shape[-1]))
    m, n = h.shape
    checked = {
        name: finite(name, value, (..., m, m))
        if name == "Phi"
        else symmetric(value, name, n if name in ("P0", "Q") else m)[0]
        for name, value in matrices.items()
    }
    batch = together(**{name: value.shape[:-2] for name, value in checked.items()})
    return [f, h, *(checked | {"P0": np.broadcast_to(checked["P0"], (*batch, n, n))}).values()]


def _updated(P: Array, h: Array, r: Array) -> tuple[Array, Array]:
    """Gain and covariance after an update (Joseph form)."""
    K = np.linalg.solve(h @ P @ h.T + r, h @ P.mT).mT
    A = np.eye(h.shape[-1]) - K @ h
    return K, A @ P @ A.mT + K @ r @ K.mT
