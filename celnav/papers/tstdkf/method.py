"""The paper's additions to a two-stage filter: a first stage on differenced measurements, and
factors that boost the gain of the second stage.

Differencing (Eqs. 21-56) handles correlated AR(1) noises of measurement and process::

    V_k = F V_k-1 + xi_k,   Q_k = L Q_k-1 + e_k,
    x_k = f(x_k-1) + G_k (J V_k + Q_k),   z_k = h(x_k) + V_k

The predictable part of the noise is subtracted from each measurement, ``Z' = z_k - F (z_k-1 -
h(x_k-1))``, with the last *estimate* instead of the state. The remaining correlation of process and
measurement noise enters the prediction, ``x + Omega (Z' - h(x))``. The filter also propagates the
correlations of its estimate with V and Q. The method is exact for ``F = L = 0`` and any J. For
``F > 0`` it neglects the error of the last estimate: the closer F is to 1, the more overconfident
it is.

Strong tracking (Eqs. 57-61) averages the squared residuals over the last ``tau`` measurements and
compares the average with the predicted variance. Component i of the residual boosts component i of
the bias.
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
    """State of `Differenced`.

    belief: mean and covariance of x. cross: ``(..., n, q + m)``, covariance of its error with Q and
    V. V: ``(..., m)``, estimated noise of the last measurement, None before the first. H: ``(...,
    m, n)``, Jacobian of the last measurement. moved: result of `Differenced.move`.
    """

    belief: Covariance
    cross: Array
    V: Array | None
    H: Array
    moved: tuple[Array, Array, Array] | None = None


@dataclass(frozen=True, eq=False)
class Differenced:
    """The first stage, for `celnav.filters.two_stage.TwoStage`. Each epoch needs a prediction and a
    complete measurement.

    move: ``(mean, epoch) ->`` state ``(..., n)`` after the interval, its Jacobian ``Phi``, and the
    noise input matrix ``G (..., n, q)``. h, slope: ``(mean, epoch) ->`` measurement ``(..., m)``
    and its Jacobian ``(..., m, n)``. noise: see `ar1_noise`. ValueError for an incomplete
    measurement, or if ``I + H G J`` is singular (determinant below 1e-12).
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
        """State with the model's prediction for the interval, and the transition matrix."""
        n = state.belief.mean.shape[-1]
        q = self.noise.L.shape[-1]
        moved = check_return("move", self.move(state.belief.mean, epoch), "state, Phi, G")
        shapes = (..., n), (..., n, n), (..., n, q)
        x, Phi, G = (
            numbers("move", unmasked("move", a), shape)
            for a, shape in zip(moved, shapes, strict=True)
        )
        return state._replace(moved=(x, Phi, G)), Phi

    def update(
        self, state: DifferencedState, epoch: Epoch
    ) -> tuple[DifferencedState, Stage | None, Info]:
        """State at the end of the interval given its measurement, the stage, and information."""
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
                "z: expected a complete measurement at every epoch, because the next measurement "
                "is differenced with it, got nan"
            )
        if first:  # there is no earlier measurement: V has its stationary covariance
            F = np.zeros_like(F)
            Xi = V
        y = z - self._seen(x, epoch) - (0.0 if state.V is None else matvec(F, state.V))

        # Omega moves the correlation of process and measurement noise into the prediction.
        H = numbers("slope", unmasked("slope", self.slope(x, epoch)), (..., m, n))
        coupled = np.eye(m) + H @ G @ J
        if not coupled.dtype.hasobject and np.abs(np.linalg.det(coupled)).min() < 1e-12:
            raise ValueError("J: expected I + H G J to have an inverse, got a singular matrix")
        Omega = np.linalg.solve(coupled.mT, (G @ J).mT).mT
        into = matvec(Omega, y)
        Phi1 = Phi - Omega @ (H @ Phi)
        G1 = G - Omega @ (H @ G)

        # Joint covariance of (x, Q, V): x = Phi1 x + G1 (J F V + L Q + e), Q = L Q + e. V does not
        # change before the update, because its increment xi is measured together with H x.
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
        measured = joint(
            LINEAR,
            moved,
            (sensor, KEEP),
            z=y - matvec(H, into),
            measurement_noise=cholesky(Xi),
        )
        both, info, _ = condition(Covariance, measured, EUCLIDEAN)
        assert measured.innovation is not None
        assert info.sqrt_S is not None
        assert info.gain is not None

        # Only x is updated; Q and V are reset to their stationary covariances. V = F V + xi, where
        # xi is the measurement minus H x.
        belief = Covariance(both.mean[..., :n], both[1][..., :n, :n])
        cross = both[1][..., :n, n:]
        cross = side_by_side([cross[..., :q], cross[..., q:] @ F - belief.cov @ H.mT])
        after = DifferencedState(belief, cross, z - self._seen(belief.mean, epoch), H)
        lag = (None, None) if first else (F, state.H)
        return (
            after,
            Stage(
                measured.innovation,
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
"""Factors lie between 1 and this limit; nan counts as 1."""


class Window(NamedTuple):
    """Memory of the factors: number of residuals, mean of their squares ``(..., m)``, and the last
    factors."""

    length: float
    squares: Array
    factors: Array


@dataclass(frozen=True, eq=False)
class StrongTracking:
    """Fading factors made by `strong_tracking`. The parameters are rows that may differ by run.

    rho: ``(..., 1, m)``. tau: ``(..., 1, 1)``.
    least: ``(..., 1, m)``, factor at a ratio of 0.
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
        raw = least + rho * (squares / seen.total.diagonal(0, -2, -1))
        factors = np.minimum(np.maximum(np.where(np.isfinite(raw), raw, 1.0), 1.0), LARGEST)
        return Window(count, squares, factors), factors


def strong_tracking(
    rho: ArrayLike, tau: ArrayLike, *, proportional: ArrayLike = False
) -> StrongTracking:
    """A boost for `celnav.filters.two_stage.two_stage`: factors ``1 + rho (ratio - 1)``, with the
    ratio of averaged squared residuals to predicted variances.

    rho: ``(..., m)``, not negative; 0 switches a component off. tau: ``(..., 1)``, length of the
    window in measurements. proportional: whether the factors are ``rho ratio`` instead. This form
    is closest to the paper's prose; its factors are near ``rho`` even for a consistent filter.

    >>> boost = strong_tracking([8.0, 15.0, 9.0], 100.0)
    >>> filter = celnav.two_stage(motion, sensor, Gamma, bias, boost=boost)
    """
    weights = finite("rho", rho)
    length = finite("tau", tau)
    if (length < 1.0).any():
        raise ValueError(f"tau: expected numbers of at least 1, got {tau!r}")
    if weights.ndim == 0 or (weights < 0.0).any():
        raise ValueError(f"rho: expected numbers (..., m) of at least 0, got {rho!r}")
    form = finite("proportional", proportional)
    together(rho=weights.shape, tau=length.shape, proportional=form.shape)
    rows = weights, np.atleast_1d(length), np.where(form > 0.0, 0.0, 1.0 - weights)
    return StrongTracking(*(row[..., None, :] for row in rows))
