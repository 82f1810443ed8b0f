"""Noise models: AR(1) sequences, and continuous noise made discrete."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm, solve_discrete_lyapunov

from celnav.checks import finite
from celnav.gaussian import sqrt_cov
from celnav.linalg import Array


def stationary_covariance(Phi: ArrayLike, R: ArrayLike) -> Array:
    """Covariance ``(m, m)`` of the stationary AR(1) sequence ``V' = Phi V + zeta``, ``zeta ~ N(0, R)``.

    It solves ``Sigma = Phi Sigma Phi' + R``.

    Raises
    ------
    ValueError: if the spectral radius of Phi is not below 1, or R is not a covariance.
    """
    phi = finite("Phi", Phi)
    if phi.ndim != 2 or len(phi) != phi.shape[-1]:
        raise ValueError(f"Phi: expected shape (m, m), got {phi.shape}")
    sqrt_cov(R, "R", len(phi))
    radius = np.abs(np.linalg.eigvals(phi)).max()
    if radius >= 1.0:
        raise ValueError(f"Phi: expected a spectral radius below 1 for a stationary covariance, got {radius:.6g}")
    sigma: Array = solve_discrete_lyapunov(phi, finite("R", R))
    return sigma


def initial_covariance(initial: str | ArrayLike, Phi: ArrayLike, R: ArrayLike) -> Array:
    """Covariance ``(m, m)`` of ``V_0``: "R", "stationary", "zero" or a matrix.

    Raises
    ------
    ValueError: for another word, if R or the matrix is no covariance, and where Phi has no stationary one.
    """
    increments = finite("R", R)
    sqrt_cov(increments, "R")
    if not isinstance(initial, str):
        sqrt_cov(initial, "Sigma0", len(increments))
        return finite("Sigma0", initial)
    if initial == "R":
        return increments
    if initial == "stationary":
        return stationary_covariance(Phi, R)
    if initial == "zero":
        return np.zeros_like(increments)
    raise ValueError(f"Sigma0: expected 'R', 'stationary', 'zero' or a matrix, got {initial!r}")


def effective_covariance(Phi: ArrayLike, R: ArrayLike) -> Array:
    """White noise of the same spectrum at zero frequency, ``(I - Phi)^-1 R (I - Phi)^-T``.

    Raises
    ------
    ValueError: if the spectral radius of Phi is not below 1.
    """
    stationary_covariance(Phi, R)
    phi = finite("Phi", Phi)
    half = np.linalg.solve(np.eye(len(phi)) - phi, sqrt_cov(R, "R"))
    return half @ half.T


def ar1(Phi: Array, increments: Array, first: Array) -> Array:
    """AR(1) sequence ``(T, ..., m)`` from increments ``(T - 1, ..., m)`` and its first value ``(..., m)``."""
    V = np.empty((len(increments) + 1, *np.broadcast_shapes(first.shape, increments.shape[1:])))
    V[0] = first
    for k, zeta in enumerate(increments):
        V[k + 1] = np.einsum("...ij,...j->...i", Phi, V[k]) + zeta
    return V


def van_loan(F: ArrayLike, G: ArrayLike, spectral_density: ArrayLike, dt: float) -> tuple[Array, Array]:
    """Discretize ``dx = F x dt + G dw`` over ``dt``: the transition matrix and the covariance of the noise [Van Loan 1978].

    Parameters
    ----------
    F: ``(n, n)``, 1/s. G: ``(n, k)``. spectral_density: ``(k, k)``, two-sided, of ``w``.
    dt: s, not negative.

    Raises
    ------
    ValueError: if a shape is wrong, a number not finite, the density no covariance or ``dt`` negative.
    """
    f, g = finite("F", F), finite("G", G)
    n = f.shape[0] if f.ndim else 0
    if f.shape != (n, n) or g.ndim != 2 or len(g) != n:
        raise ValueError(f"F: expected shapes F (n, n) and G (n, k), got {f.shape} and {g.shape}")
    if not (np.isfinite(dt) and dt >= 0.0):
        raise ValueError(f"dt: expected a non-negative number, got {dt!r}")
    density = sqrt_cov(spectral_density, "spectral_density", g.shape[1])
    q = g @ density
    exponential = expm(np.block([[-f, q @ q.T], [np.zeros((n, n)), f.T]]) * dt)
    transition = exponential[n:, n:].T
    noise = transition @ exponential[:n, n:]
    return transition, 0.5 * (noise + noise.T)
