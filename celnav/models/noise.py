"""Noise: AR(1) sequences, discretization of continuous noise, Allan deviation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm, solve_discrete_lyapunov
from scipy.special import gammaincinv

from celnav.gaussian.belief import symmetric
from celnav.gaussian.checks import finite, number, together
from celnav.gaussian.linalg import Array


class Allan(NamedTuple):
    """Allan deviations ``(...)``, in the unit of the samples, and their 95 % confidence limits."""

    deviation: Array
    low: Array
    high: Array


def allan_deviation(t: ArrayLike, samples: ArrayLike, interval_s: float) -> Allan:
    """Overlapping Allan deviation (`Allan`) of means over ``interval_s`` s [Riley2008, Eq. 11].

    t: ``(T,)`` s, evenly spaced within half a period. samples: ``(T, ...)`` of a rate. For white
    noise of density N it is ``N / interval_s^(1/2)``; the confidence limits assume white noise.

    >>> deviation = celnav.models.noise.allan_deviation(t, rate, 1.0).deviation
    """
    times = finite("t", t, ("T",))
    x = finite("samples", samples)
    if not x.ndim or len(x) != len(times):
        raise ValueError(f"samples: expected shape ({len(times)}, ...) to go with t, got {x.shape}")
    if len(times) < 3:
        raise ValueError(f"t: expected three times or more, got {len(times)}")
    period = (times[-1] - times[0]) / (len(times) - 1)
    if not (np.abs(np.diff(times) - period) < 0.5 * period).all():
        raise ValueError(
            "t: expected increasing times, evenly spaced within half a period, got other intervals"
        )
    m, total = round(number("interval_s", interval_s, above=0.0) / period), len(times)
    if not 1 <= m <= (total - 1) // 2:
        most = (total - 1) // 2 * period
        raise ValueError(
            f"interval_s: expected {period:g} to {most:g} s, from one sample to half of them, got "
            f"{interval_s!r}"
        )
    sums = np.concatenate([np.zeros_like(x[:1]), np.cumsum(x - x.mean(0), 0)])
    second = sums[2 * m :] - 2.0 * sums[m:-m] + sums[: -2 * m]
    deviation = np.sqrt(0.5 * np.square(second).mean(0)) / m
    # Equivalent degrees of freedom for white noise of a rate [Riley2008, Sec. 5.4].
    dof = 1.5 * total / m - 2.0 * (total - 1.0) / (total + 1.0)
    dof *= 4.0 * m * m / (4.0 * m * m + 5.0)
    low, high = (np.sqrt(dof / (2.0 * gammaincinv(0.5 * dof, p))) for p in (0.975, 0.025))
    return Allan(deviation, low * deviation, high * deviation)


def stationary_covariance(Phi: ArrayLike, R: ArrayLike) -> Array:
    """Covariance ``(m, m)`` of the stationary sequence ``V' = Phi V + zeta``, ``zeta ~ N(0, R)``;
    ValueError if the spectral radius of ``Phi`` is not below 1.
    """
    phi = finite("Phi", Phi, ("m", "m"))
    noise = finite("R", symmetric(R, "R", len(phi))[0], phi.shape)
    radius = np.abs(np.linalg.eigvals(phi)).max()
    if radius >= 1.0:
        raise ValueError(
            f"Phi: expected a spectral radius below 1 for a stationary covariance, got {radius:.6g}"
        )
    return np.asarray(solve_discrete_lyapunov(phi, noise))


def effective_covariance(Phi: ArrayLike, R: ArrayLike) -> Array:
    """Covariance ``(m, m)`` of white noise with the spectral density at frequency 0 of the
    stationary sequence: ``(I - Phi)^-1 R (I - Phi)^-T``.
    """
    stationary_covariance(Phi, R)
    phi = finite("Phi", Phi)
    half = np.linalg.solve(np.eye(len(phi)) - phi, symmetric(R, "R")[1])
    return half @ half.T


def ar1(Phi: ArrayLike, increments: ArrayLike, first: ArrayLike) -> Array:
    """AR(1) sequence ``V (T, ..., m)`` with ``V' = Phi V + increment``.

    Phi: ``(..., m, m)``. increments: ``(T - 1, ..., m)``. first: ``(..., m)``, the first value.
    """
    Phi = finite("Phi", Phi, (..., "m", "m"))
    m = Phi.shape[-1]
    increments, first = finite("increments", increments, (..., m)), finite("first", first, (..., m))
    if increments.ndim < 2:
        raise ValueError(f"increments: expected shape (T - 1, ..., {m}), got {increments.shape}")
    batch = together(Phi=Phi.shape[:-2], increments=increments.shape[1:-1], first=first.shape[:-1])
    V = np.empty((len(increments) + 1, *batch, m))
    V[0] = first
    factors = Phi.diagonal(0, -2, -1)
    # A diagonal Phi needs no matrix products.
    if not (Phi - factors[..., None] * np.eye(m)).any():
        for k, zeta in enumerate(increments):
            np.add(factors * V[k], zeta, out=V[k + 1])
        return V
    for k, zeta in enumerate(increments):
        V[k + 1] = np.einsum("...ij,...j->...i", Phi, V[k]) + zeta
    return V


def van_loan(
    F: ArrayLike, G: ArrayLike, spectral_density: ArrayLike, dt: float
) -> tuple[Array, Array]:
    """Discretize ``dx = F x dt + G dw`` over ``dt >= 0`` s; return the transition matrix and the
    noise covariance, ``(n, n)`` [VanLoan1978].

    F: ``(n, n)`` 1/s. G: ``(n, k)``. spectral_density: ``(k, k)``, two-sided, of ``dw/dt``.

    >>> F, Q = van_loan([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[0.1]], 0.5)  # constant velocity
    """
    f, dt = finite("F", F, ("n", "n")), number("dt", dt, 0.0)
    n = len(f)
    g = finite("G", G, (n, "k"))
    q = g @ symmetric(spectral_density, "spectral_density", g.shape[1])[1]
    # exp([[-F, G q G'], [0, F']] dt) = [[., Phi^-1 Q], [0, Phi']]
    exponential = expm(np.block([[-f, q @ q.T], [np.zeros((n, n)), f.T]]) * dt)
    transition = exponential[n:, n:].T
    noise = transition @ exponential[:n, n:]
    return transition, 0.5 * (noise + noise.T)


class Noise(NamedTuple):
    """AR(1) measurement noise ``V' = F V + xi`` and process noise ``J V' + Q'`` with
    ``Q' = L Q + e``; make one with `ar1_noise`.

    F: ``(m, m)``. L: ``(q, q)``. J: ``(q, m)``. Xi: covariance ``(m, m)`` of xi. E: covariance
    ``(q, q)`` of e. V, Q: stationary covariances ``(m, m)`` and ``(q, q)``.
    """

    F: Array
    L: Array
    J: Array
    Xi: Array
    E: Array
    V: Array
    Q: Array

    @property
    def whites(self) -> tuple[tuple[Array, Array], ...]:
        """Two pairs of covariances ``((q, q), (m, m))`` for a filter that treats both noises as
        white: the driving noises, and the stationary noises.
        """
        return (self.E, self.Xi), (self.Q + self.J @ self.V @ self.J.mT, self.V)


def ar1_noise(F: ArrayLike, L: ArrayLike, J: ArrayLike, Xi: ArrayLike, E: ArrayLike) -> Noise:
    """Make a `Noise`. ValueError if ``F`` or ``L`` is not diagonal with magnitudes below 1, if
    ``Xi`` is not positive definite, or if ``E`` is not a covariance.
    """
    xi, e = finite("Xi", Xi, ("m", "m")), finite("E", E, ("q", "q"))
    m, q = len(xi), len(e)
    colors = finite("F", F, (m, m)), finite("L", L, (q, q))
    for name, a in zip("FL", colors, strict=True):
        if np.any(a - np.diag(a.diagonal())) or np.abs(a).max() >= 1.0:
            raise ValueError(
                f"{name}: expected a diagonal matrix with magnitudes below 1, got {a!r:.80}"
            )
    if np.linalg.eigvalsh(symmetric(xi, "Xi", m)[0])[0] <= 0.0:
        raise ValueError("Xi: expected a positive definite covariance, got a singular one")
    symmetric(e, "E", q)
    # A diagonal AR(1): V_ij = Xi_ij / (1 - F_i F_j).
    V, Q = (
        cov / (1.0 - np.outer(a.diagonal(), a.diagonal()))
        for cov, a in zip((xi, e), colors, strict=True)
    )
    return Noise(*colors, finite("J", J, (q, m)), xi, e, V, Q)
