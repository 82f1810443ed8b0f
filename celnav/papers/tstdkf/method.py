"""What the paper adds to two stages: a first stage on differenced measurements, and factors that boost the gain of the second.

Differencing (Eqs. 21-56) is for AR(1) noise of measurement and process that are correlated::

    V_k = F V_k-1 + xi_k,   Q_k = L Q_k-1 + e_k,   x_k = f(x_k-1) + G_k (J V_k + Q_k),   z_k = h(x_k) + V_k

The colored part of the last measurement's noise is taken off this one, ``Z' = z_k - F (z_k-1 - h(x_k-1))``, with the last
*estimate* in place of the state. What then correlates process and measurement is removed by taking ``Z'`` into the prediction
as an input, and the correlations of the estimate with the AR(1) noises are carried along. Exact for ``F = L = 0``, whatever J.
With ``F`` the error of the last estimate is overlooked: the filter is then overconfident, the more the nearer ``F`` is to 1.

Strong tracking (Eqs. 57-61) keeps an average of squared residuals over the last ``tau`` measurements and compares it with what
it should be. Component i of the residual acts on component i of the bias; nothing else connects the two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.model import check_prior, given_back
from celnav.filters.records import Epoch, Info
from celnav.filters.two_stage import Boost, Stage
from celnav.gaussian.belief import Gaussian, symmetric
from celnav.gaussian.checks import finite, function, instance, number, numbers, together, unmasked
from celnav.gaussian.linalg import Array, Covariance, cholesky, matvec, side_by_side, solve_lower, solve_right, whiten

Moved = tuple[Array, Array, Array]
"""State ``(..., n)`` after the interval, its Jacobian ``Phi (..., n, n)`` and the effect ``G (..., n, q)`` of the process noise."""


class Noise(NamedTuple):
    """AR(1) noises and how they are connected, as `ar1_noise` makes them; see the module.

    Attributes
    ----------
    F: ``(m, m)``. L: ``(q, q)``. J: ``(q, m)``. Xi: ``(m, m)``, covariance of ``xi``. E: ``(q, q)``, covariance of ``e``.
    V, Q: stationary covariances ``(m, m)`` and ``(q, q)``.
    """

    F: Array
    L: Array
    J: Array
    Xi: Array
    E: Array
    V: Array
    Q: Array


def ar1_noise(F: ArrayLike, L: ArrayLike, J: ArrayLike, Xi: ArrayLike, E: ArrayLike) -> Noise:
    """Checked noises, with their stationary covariances.

    ValueError names what cannot be: ``F`` or ``L`` that is not diagonal with magnitudes below 1, or no covariance.
    """
    xi, e = finite("Xi", Xi, ("m", "m")), finite("E", E, ("q", "q"))
    m, q = len(xi), len(e)
    if np.linalg.eigvalsh(symmetric(xi, "Xi", m)[0])[0] <= 0.0:
        raise ValueError("Xi: expected a positive definite covariance")
    symmetric(e, "E", q)
    F, L = _coefficients("F", F, m), _coefficients("L", L, q)
    V, Q = (cov / (1.0 - np.outer(a.diagonal(), a.diagonal())) for cov, a in ((xi, F), (e, L)))
    return Noise(F, L, finite("J", J, (q, m)), xi, e, V, Q)


def _coefficients(name: str, value: ArrayLike, size: int) -> Array:
    matrix = finite(name, value, (size, size))
    if np.any(matrix - np.diag(matrix.diagonal())) or np.abs(matrix).max() >= 1.0:
        raise ValueError(f"{name}: expected a diagonal matrix of magnitudes below 1, got {value!r:.80}")
    return matrix


class DifferencedState(NamedTuple):
    """State of the stage.

    Attributes
    ----------
    belief: about x, in covariance form. DV: ``(..., n, m)`` and DQ: ``(..., n, q)``, covariances of its error with V and Q.
    V: ``(..., m)``, the last measurement's noise as estimated; nan before the first. H: ``(..., m, n)``, its Jacobian.
    moved: what the model said of the interval, until the update.
    """

    belief: Covariance
    DV: Array
    DQ: Array
    V: Array
    H: Array
    moved: Moved | None = None


@dataclass(frozen=True, eq=False)
class Differenced:
    """The stage, for `celnav.filters.two_stage.TwoStage`. Each epoch moves and is measured in full, or not at all.

    Attributes
    ----------
    move: ``(mean, epoch) -> (state, Phi, G)``; see `Moved`.
    h, slope: ``(mean, epoch) ->`` measurement ``(..., m)`` and its Jacobian ``(..., m, n)``. noise: see `ar1_noise`.

    Its belief is in covariance form. It raises a ValueError for a measurement that is missing in part, or where ``I + H G J`` is
    singular (determinant below 1e-12).
    """

    move: Callable[[Array, Epoch], Moved]
    h: Callable[[Array, Epoch], Array]
    slope: Callable[[Array, Epoch], Array]
    noise: Noise

    def __post_init__(self) -> None:
        for name in ("move", "h", "slope"):
            function(name, getattr(self, name), "(mean, epoch)")
        instance("noise", self.noise, Noise, "a Noise, such as ar1_noise(F, L, J, Xi, E)")

    def start(self, prior: Gaussian) -> DifferencedState:
        """State before the first epoch."""
        check_prior(prior)
        belief, (q, m) = Covariance.of(prior), self.noise.J.shape[-2:]
        shape = belief.cov.shape[:-1]
        V = np.full((*belief.mean.shape[:-1], m), np.nan)
        return DifferencedState(belief, np.zeros((*shape, m)), np.zeros((*shape, q)), V, np.zeros((*shape[:-1], m, shape[-1])))

    def predict(self, state: DifferencedState, epoch: Epoch) -> tuple[DifferencedState, Array | None]:
        """State that knows what the model says of the interval, and the transition matrix."""
        n, q = state.belief.mean.shape[-1], self.noise.L.shape[-1]
        found = given_back("move", self.move(state.belief.mean, epoch), "state, Phi, G")
        shapes = (..., n), (..., n, n), (..., n, q)
        x, Phi, G = (numbers("move", unmasked("move", a), shape) for a, shape in zip(found, shapes, strict=True))
        return state._replace(moved=(x, Phi, G)), Phi

    def update(self, state: DifferencedState, epoch: Epoch) -> tuple[DifferencedState, Stage | None, Info]:
        """State at the end of the interval given its measurement, and what was done."""
        assert state.moved is not None
        x, Phi, G = state.moved
        F, L, J, Xi, _, V, Q = self.noise
        JF, f_V, f_Q = J @ F, *(matrix.diagonal(0, -2, -1)[..., None, :] for matrix in (F, L))
        n, (q, m) = x.shape[-1], J.shape[-2:]
        z = numbers("z", epoch.z, () if epoch.z is None else (..., m))
        together(prior=x.shape[:-1], z=z.shape[:-1])
        if np.isnan(z).any():
            raise ValueError("z: expected a whole measurement at every epoch: what was missed cannot be differenced")
        first = bool(np.isnan(state.V).all())
        Z, sensor = (z, V) if first else (z - matvec(F, state.V), Xi)

        # What correlates process and measurement goes into the prediction, by Omega.
        H = numbers("slope", unmasked("slope", self.slope(x, epoch)), (..., m, n))
        coupled = np.eye(m) + H @ G @ J
        if np.abs(np.linalg.det(coupled)).min() < 1e-12:
            raise ValueError("J: expected I + H G J to have an inverse, got a singular matrix")
        Omega = np.linalg.solve(coupled.mT, (G @ J).mT).mT
        both = side_by_side([Phi, G])
        both = both - Omega @ (H @ both)
        Phi1, G1 = both[..., :n], both[..., n:]
        y = Z - self._seen(x, epoch)
        into = matvec(Omega, y)
        mean, innovation = x + into, y - matvec(H, into)

        ahead = Phi1 @ side_by_side([state.belief.cov, state.DQ, state.DV])
        ahead_Q, ahead_V = ahead[..., n : n + q] * f_Q, ahead[..., n + q :]
        # What the noises add to the state, and to DQ and DV; the first measurement has taken all of J V into the prediction.
        carried = np.zeros_like(JF) if first else JF @ V
        driven = G1 @ side_by_side([0.5 * (Q + carried @ JF.mT), Q, carried * f_V])
        cross = (ahead_Q + ahead_V @ JF.mT + driven[..., :q]) @ G1.mT
        P = ahead[..., :n] @ Phi1.mT + cross + cross.mT
        HP = H @ P
        root = cholesky(HP @ H.mT + sensor)
        K = solve_right(root, solve_lower(root, HP).mT)
        cov = P - K @ HP
        kept = side_by_side([ahead_Q, ahead_V * f_V]) + driven[..., q:]
        kept = kept - K @ (H @ kept)
        DQ, DV = kept[..., :q], kept[..., q:] - K @ sensor

        belief = Covariance(mean + matvec(K, innovation), 0.5 * (cov + cov.mT))
        after = DifferencedState(belief, DV, DQ, z - self._seen(belief.mean, epoch), H)
        used = np.ones(innovation.shape, bool)
        stage = Stage(innovation, root, K, H, used[(0,) * (used.ndim - 1)], Omega, None if first else F, None if first else state.H)
        return after, stage, Info(innovation, whiten(root, innovation), used, root, lambda: K)

    def _seen(self, x: Array, epoch: Epoch) -> Array:
        return numbers("h", unmasked("h", self.h(x, epoch)), (..., self.noise.F.shape[-1]))


LARGEST = 1e6
"""Factors lie between 1 and this; what is not a number counts as 1."""
Factor = Callable[[Array, Array], Array]
"""``(ratios (..., m), rho (m,)) -> factors`` from the ratios of squared residuals to their variances."""


class Window(NamedTuple):
    """Memory: how many residuals were seen, mean of their squares ``(..., m)``, and the factors last used."""

    length: int
    squares: Array
    factors: Array


def excess(ratios: Array, rho: Array) -> Array:
    """``1 + rho (ratio - 1)``: near 1 while the filter is consistent."""
    return np.asarray(1.0 + rho * (ratios - 1.0))


def proportional(ratios: Array, rho: Array) -> Array:
    """``rho ratio``: near ``rho`` even while the filter is consistent, the reading closest to the prose; 1 where ``rho`` is 0."""
    return np.where(rho > 0.0, rho * ratios, 1.0)


def strong_tracking(rho: ArrayLike, tau: float, *, factor: Factor = excess) -> Any:
    """A boost for `celnav.filters.two_stage.two_stage`.

    Parameters
    ----------
    rho: ``(..., m)``, not negative; 0 switches a component off. tau: length of the window, in measurements, at least 1.
    factor: `excess` or `proportional`.

    >>> filter = celnav.two_stage(motion, sensor, Gamma, bias, boost=strong_tracking([8.0, 15.0, 9.0], 100.0))
    """
    weights, length = finite("rho", rho), number("tau", tau, 1.0)
    if weights.ndim == 0 or (weights < 0.0).any():
        raise ValueError(f"rho: expected numbers (..., m) that are not negative, got {rho!r}")
    function("factor", factor, "(ratios, rho)")

    def boost(memory: Window | None, seen: Boost) -> tuple[Window, Array]:
        square = seen.residual * seen.residual
        if square.shape[-1] != weights.shape[-1]:
            raise ValueError(f"rho: expected {square.shape[-1]} numbers to go with the measurement, got {weights.shape[-1]}")
        count = 1 if memory is None else memory.length + 1
        before = np.zeros_like(square) if memory is None else memory.squares
        squares = before + (square - before) / min(count, length)
        found = numbers("factor", factor(squares / seen.total.diagonal(0, -2, -1), weights), (..., square.shape[-1]))
        factors = np.minimum(np.maximum(np.where(np.isfinite(found), found, 1.0), 1.0), LARGEST)
        return Window(count, squares, factors), factors

    return boost
