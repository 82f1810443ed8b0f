"""A state from one measurement alone, by weighted least squares: no memory but the point to start from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.arguments import check_model, measurement
from celnav.filters.conditioning import evaluate
from celnav.filters.driver import Epoch, Filter, State
from celnav.filters.info import Info
from celnav.filters.mixing import check_runs_apart, unknown
from celnav.gaussian.belief import COVARIANCE, Gaussian
from celnav.gaussian.checks import finite, integer, numbers
from celnav.gaussian.linalg import Array, matvec, outer, unit

RANK = 1e-10
"""Part of a column of the Jacobian that must be its own, or its state is not determined."""
AT_REST = 1e-4
"""Deviations: the round after a step this small would move nothing that matters."""


def least_squares(
    h: Callable[[Array, Epoch], Array],
    jacobian: Callable[[Array, Epoch], Array],
    sigma: ArrayLike | Callable[[Array, Epoch], Array],
    *,
    rounds: int = 10,
) -> Filter:
    """A filter that makes a fix of every measurement by Gauss and Newton, from the last fix, or from the prior's mean.

    Components that are nan are left out. A run whose measurement does not determine the state, or is missing, becomes nan for this
    epoch and starts from its last fix at the next.

    Parameters
    ----------
    h, jacobian: ``(mean (..., n), epoch) ->`` ``(..., m)`` and ``(..., m, n)``.
    sigma: deviations ``(..., m)`` of the noise, which is of independent components; constant or ``(mean, epoch) -> deviations``.
    rounds: of Gauss and Newton at most; a run stops when a step is below a ten-thousandth of its deviations.

    Returns
    -------
    A filter in covariance form. Its innovations are the residuals of the fix, its ``white`` those in deviations.

    Raises
    ------
    ValueError: unless ``sigma`` is positive and ``rounds`` a positive integer.
    """
    check_model("h", h, "(mean, epoch)")
    check_model("jacobian", jacobian, "(mean, epoch)")
    most = integer("rounds", rounds)
    if callable(sigma):
        check_model("sigma", sigma, "(mean, epoch)")
    deviations: Any = sigma if callable(sigma) else finite("sigma", sigma)
    if not callable(sigma) and not (deviations > 0.0).all():
        raise ValueError(f"sigma: expected positive deviations, got {sigma!r:.80}")

    def step(state: State, epoch: Epoch) -> tuple[State, Info]:
        x = state.memory[0]
        if epoch.z is None:
            lost = Gaussian(np.full(x.shape, np.nan), np.full((*x.shape, x.shape[-1]), np.nan), COVARIANCE)
            return State(lost, (x,)), Info(silent=True)
        z, belief = measurement(epoch.z, state.belief)
        x = np.broadcast_to(x, belief.mean.shape)
        used = np.broadcast_to(~np.isnan(z), (*x.shape[:-1], z.shape[-1]))
        sigmas = numbers("sigma", evaluate(deviations, x, epoch))
        if sigmas.shape[-1:] not in ((), (1,), z.shape[-1:]):
            raise ValueError(f"sigma: expected shape (..., {z.shape[-1]}) to go with the measurement, got {sigmas.shape}")
        weight = np.where(used, 1.0 / sigmas, 0.0)
        n = x.shape[-1]
        if x.ndim > 1 and unknown(h, x[None]):
            values = numbers("h", h(x.copy(), epoch), (..., z.shape[-1]))
            check_runs_apart("h", lambda points, e: np.asarray(h(points[0], e))[None], (x[None],), epoch, values[None].copy())
        enough, moving = used.sum(-1) >= n, np.ones(x.shape[:-1], bool)
        V, known = np.zeros((*x.shape, n)), enough
        for _ in range(most if z.shape[-1] >= n else 0):  # too few determine nothing
            G = weight[..., None] * numbers("jacobian", jacobian(x, epoch), (..., z.shape[-1], n))
            length = np.sqrt(np.square(G).sum(-2))
            Q, R = np.linalg.qr(G / np.where(length > 0.0, length, 1.0)[..., None, :])
            found = (np.abs(R.diagonal(0, -2, -1)).min(-1) > RANK) & enough
            root = np.linalg.solve(np.where(found[..., None, None], R * length[..., None, :], unit(n)), unit(n))
            white = np.where(
                found[..., None], matvec(Q.mT, weight * np.where(used, z - numbers("h", h(x, epoch), (..., z.shape[-1])), 0.0)), 0.0
            )
            # A run that has come to rest stays as it is while others of its block still move.
            x = np.where(moving[..., None], x + matvec(root, white), x)
            V, known = np.where(moving[..., None, None], root, V), np.where(moving, found, known)
            moving = moving & (np.abs(white).max(-1) > AT_REST)
            if not moving.any():
                break
        left = np.where(used, z - h(x, epoch), np.nan)
        fix = np.where(known[..., None], x, np.nan)
        belief = Gaussian(fix, np.where(known[..., None, None], outer(V), np.nan), COVARIANCE)
        info = Info(left, np.where(used, weight * left, 0.0), used)
        return State(belief, (x,)), info

    return Filter(lambda prior: State(prior, (prior.mean,)), step)
