"""What the paper adds to two stages: a first stage on differenced measurements, and factors that
boost the gain of the second.

Differencing (Eqs. 21-56) is for AR(1) noise of measurement and process that are correlated::

    V_k = F V_k-1 + xi_k,   Q_k = L Q_k-1 + e_k,
    x_k = f(x_k-1) + G_k (J V_k + Q_k),   z_k = h(x_k) + V_k

The colored part of the last measurement's noise is taken off this one, ``Z' = z_k - F (z_k-1 -
h(x_k-1))``, with the last *estimate* in place of the state; what then correlates process and
measurement goes into the prediction, ``x + Omega (Z' - h(x))``, and the estimate's correlations
with V and Q are carried along. Exact for ``F = L = 0``, whatever J. With ``F`` the error of the
last estimate is overlooked: the filter is then overconfident, the more the nearer ``F`` is to 1.

Strong tracking (Eqs. 57-61) keeps an average of squared residuals over the last ``tau``
measurements and compares it with what it should be. Component i of the residual acts on component i
of the bias; nothing else connects the two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.joint import KEEP, condition, joint
from celnav.filters.model import check_prior, check_return
from celnav.filters.records import Epoch, Info
from celnav.filters.two_stage import LINEAR, Boost, Stage
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import finite, function, instance, numbers, together, unmasked
from celnav.gaussian.linalg import (
    Array,
    Covariance,
    block,
    cholesky,
    is_concretely_true,
    matvec,
    side_by_side,
)
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.models.noise import Noise

__all__ = ["LARGEST", "Differenced", "StrongTracking", "strong_tracking"]


class DifferencedState(NamedTuple):
    """Belief about x in covariance form; covariance ``cross (..., n, q + m)`` of its error with Q
    and V; ``V (..., m)``, the last measurement's noise as estimated, None before the first; its
    Jacobian ``H (..., m, n)``; and what `Differenced.move` gave."""

    belief: Covariance
    cross: Array
    V: Array | None
    H: Array
    moved: tuple[Array, Array, Array] | None = None


@dataclass(frozen=True, eq=False)
class Differenced:
    """The stage, for `celnav.filters.two_stage.TwoStage`. Each epoch moves and is measured in full,
    or not at all.

    move: ``(mean, epoch) ->`` state ``(..., n)`` after the interval, its Jacobian ``Phi``, effect
    ``G (..., n, q)`` of the noise. h, slope: ``(mean, epoch) ->`` measurement ``(..., m)`` and its
    Jacobian ``(..., m, n)``. noise: see `ar1_noise`. ValueError for a measurement that is missing
    in part, or where ``I + H G J`` is singular (determinant below 1e-12).
    """

    move: Callable[[Array, Epoch], tuple[Array, Array, Array]]
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
        belief = Covariance.of(prior)
        q, m = self.noise.J.shape[-2:]
        n = belief.mean.shape[-1]
        return DifferencedState(belief, np.zeros((n, q + m)), None, np.zeros((m, n)))

    def predict(
        self, state: DifferencedState, epoch: Epoch
    ) -> tuple[DifferencedState, Array | None]:
        """State that knows what the model says of the interval, and the transition matrix."""
        n = state.belief.mean.shape[-1]
        q = self.noise.L.shape[-1]
        found = check_return("move", self.move(state.belief.mean, epoch), "state, Phi, G")
        shapes = (..., n), (..., n, n), (..., n, q)
        x, Phi, G = (
            numbers("move", unmasked("move", a), shape)
            for a, shape in zip(found, shapes, strict=True)
        )
        return state._replace(moved=(x, Phi, G)), Phi

    def update(
        self, state: DifferencedState, epoch: Epoch
    ) -> tuple[DifferencedState, Stage | None, Info]:
        """State at the end of the interval given its measurement, and what was done."""
        assert state.moved is not None
        x, Phi, G = state.moved
        F, L, J, Xi, E, V, Q = self.noise
        n = x.shape[-1]
        q, m = J.shape[-2:]
        first = state.V is None
        z = numbers("z", epoch.z, () if epoch.z is None else (..., m))
        together(prior=x.shape[:-1], z=z.shape[:-1])
        if is_concretely_true(np.isnan(z).any()):
            raise ValueError(
                "z: expected a whole measurement at every epoch: what was missed cannot be "
                "differenced"
            )
        if first:  # nothing to difference with: all of V is new
            F = np.zeros_like(F)
            Xi = V
        y = z - self._seen(x, epoch) - (0.0 if state.V is None else matvec(F, state.V))

        # What correlates process and measurement goes into the prediction, by Omega.
        H = numbers("slope", unmasked("slope", self.slope(x, epoch)), (..., m, n))
        coupled = np.eye(m) + H @ G @ J
        if not coupled.dtype.hasobject and np.abs(np.linalg.det(coupled)).min() < 1e-12:
            raise ValueError("J: expected I + H G J to have an inverse, got a singular matrix")
        Omega = np.linalg.solve(coupled.mT, (G @ J).mT).mT
        into = matvec(Omega, y)
        Phi1 = Phi - Omega @ (H @ Phi)
        G1 = G - Omega @ (H @ G)

        # The joint of (x, Q, V): x = Phi1 x + G1 (J F V + L Q + e), Q = L Q + e, and V waits for
        # xi, which is measured with H x.
        moves = side_by_side([Phi1, G1 @ side_by_side([L, J @ F])])
        marginals = block([[Q, 0], [0, V]])
        ahead = moves @ block([[state.belief.cov, state.cross], [state.cross.mT, marginals]])
        driven = G1 @ E
        P = ahead @ moves.mT + driven @ G1.mT
        cross = side_by_side([ahead[..., n : n + q] @ L + driven, ahead[..., n + q :]])
        cov = block([[0.5 * (P + P.mT), cross], [cross.mT, marginals]])
        nothing = np.zeros(q + m)
        moved = Covariance(side_by_side([x + into, nothing]), cov)
        sensor = (nothing[:m], side_by_side([H, np.zeros((m, q + m))]))
        seen = joint(
            LINEAR,
            moved,
            (sensor, KEEP),
            z=y - matvec(H, into),
            measurement_noise=cholesky(Xi),
        )
        both, info, _ = condition(Covariance, seen, EUCLIDEAN)
        assert seen.innovation is not None
        assert info.sqrt_S is not None
        assert info.gain is not None

        # Kept is what concerns x; Q and V have their stationary marginals again. V = F V + xi, and
        # xi is what H x leaves over of z.
        belief = Covariance(both.mean[..., :n], both[1][..., :n, :n])
        cross = both[1][..., :n, n:]
        cross = side_by_side([cross[..., :q], cross[..., q:] @ F - belief.cov @ H.mT])
        after = DifferencedState(belief, cross, z - self._seen(belief.mean, epoch), H)
        lag = (None, None) if first else (F, state.H)
        return (
            after,
            Stage(
                seen.innovation,
                info.sqrt_S,
                info.gain()[..., :n, :],
                H,
                np.ones(m, bool),
                Omega,
                *lag,
            ),
            info,
        )

    def _seen(self, x: Array, epoch: Epoch) -> Array:
        return numbers("h", unmasked("h", self.h(x, epoch)), (..., self.noise.F.shape[-1]))


LARGEST = 1e6
"""Factors lie between 1 and this; what is not a number counts as 1."""


class Window(NamedTuple):
    """Memory: how many residuals were seen, mean of their squares ``(..., m)``, and the factors
    last used."""

    length: float
    squares: Array
    factors: Array


@dataclass(frozen=True, eq=False)
class StrongTracking:
    """What `strong_tracking` makes. Its numbers are rows, matrices that runs may have of their own.

    rho: ``(..., 1, m)``. tau: ``(..., 1, 1)``.
    least: ``(..., 1, m)``, what a factor is where the ratio is 0.
    """

    rho: Array
    tau: Array
    least: Array

    def __call__(self, memory: Window | None, seen: Boost) -> tuple[Window, Array]:
        rho, tau, least = (row[..., 0, :] for row in (self.rho, self.tau, self.least))
        square = seen.residual * seen.residual
        if square.shape[-1] != rho.shape[-1]:
            raise ValueError(
                f"rho: expected {square.shape[-1]} numbers to go with the measurement, "
                f"got {rho.shape[-1]}"
            )
        count = 1.0 if memory is None else memory.length + 1.0
        before = np.zeros_like(square) if memory is None else memory.squares
        squares = before + (square - before) / np.minimum(count, tau)
        found = least + rho * (squares / seen.total.diagonal(0, -2, -1))
        factors = np.minimum(np.maximum(np.where(np.isfinite(found), found, 1.0), 1.0), LARGEST)
        return Window(count, squares, factors), factors


def strong_tracking(
    rho: ArrayLike, tau: ArrayLike, *, proportional: ArrayLike = False
) -> StrongTracking:
    """A boost for `celnav.filters.two_stage.two_stage`: factors ``1 + rho (ratio - 1)``, of squared
    residuals over variances.

    rho: ``(..., m)``, not negative; 0 switches a component off. tau: ``(..., 1)``, length of the
    window in measurements. proportional: where factors are ``rho ratio`` instead, closest to the
    prose: near ``rho`` even while the filter is consistent.

    >>> boost = strong_tracking([8.0, 15.0, 9.0], 100.0)
    >>> filter = celnav.two_stage(motion, sensor, Gamma, bias, boost=boost)
    """
    weights = finite("rho", rho)
    length = finite("tau", tau)
    if (length < 1.0).any():
        raise ValueError(f"tau: expected numbers of at least 1, got {tau!r}")
    if weights.ndim == 0 or (weights < 0.0).any():
        raise ValueError(f"rho: expected numbers (..., m) that are not negative, got {rho!r}")
    form = finite("proportional", proportional)
    together(rho=weights.shape, tau=length.shape, proportional=form.shape)
    rows = weights, np.atleast_1d(length), np.where(form > 0.0, 0.0, 1.0 - weights)
    return StrongTracking(*(row[..., None, :] for row in rows))
