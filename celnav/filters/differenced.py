"""A first stage for AR(1) noise of measurement and process that are correlated, by differencing measurements.

    V_k = F V_k-1 + xi_k,   Q_k = L Q_k-1 + e_k,   x_k = f(x_k-1) + G_k (J V_k + Q_k),   z_k = h(x_k) + V_k

The colored part of the last measurement's noise is taken off this one, ``Z' = z_k - F (z_k-1 - h(x_k-1))``, with the last
*estimate* in place of the state. What then correlates process and measurement is removed by taking ``Z'`` into the prediction
as an input, and the correlations of the estimate with the AR(1) noises are carried along. Exact for ``F = L = 0``, whatever J.
With ``F`` the error of the last estimate is overlooked: the filter is then overconfident, the more the nearer ``F`` is to 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.arguments import check_model, given_back
from celnav.filters.driver import Epoch
from celnav.filters.info import Info
from celnav.filters.two_stage import First, Stage
from celnav.gaussian.belief import Gaussian, sqrt_cov
from celnav.gaussian.checks import finite, instance, numbers
from celnav.gaussian.linalg import Array, cholesky, matvec, side_by_side, solve_lower, solve_upper_transposed, whiten

Moved = tuple[Array, Array, Array]
"""State ``(..., n)`` after the interval, its Jacobian ``Phi (..., n, n)`` and the effect ``G (..., n, q)`` of the process noise."""


class Noise(NamedTuple):
    """AR(1) noises and how they are connected; see the module.

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

    Raises
    ------
    ValueError: if F or L is not diagonal with magnitudes below 1, a shape is wrong, ``Xi`` not positive definite, or ``E`` no
        covariance.
    """
    xi, e = finite("Xi", Xi, ("m", "m")), finite("E", E, ("q", "q"))
    m, q = len(xi), len(e)
    if not np.isfinite(sqrt_cov(xi, "Xi", m)).all() or np.linalg.eigvalsh(xi)[0] <= 0.0:
        raise ValueError("Xi: expected a positive definite covariance")
    sqrt_cov(e, "E", q)
    matrices = {}
    for name, value, size in (("F", F, m), ("L", L, q)):
        matrix = finite(name, value, (size, size))
        if np.any(matrix - np.diag(matrix.diagonal())) or np.abs(matrix).max() >= 1.0:
            raise ValueError(f"{name}: expected a diagonal matrix of magnitudes below 1, got {value!r:.80}")
        matrices[name] = matrix
    stationary = [c / (1.0 - np.outer(a.diagonal(), a.diagonal())) for c, a in ((xi, matrices["F"]), (e, matrices["L"]))]
    return Noise(matrices["F"], matrices["L"], finite("J", J, (q, m)), xi, e, *stationary)


class DifferencedState(NamedTuple):
    """State of the stage.

    Attributes
    ----------
    belief: about x, in covariance form. DV: ``(..., n, m)`` and DQ: ``(..., n, q)``, covariances of its error with V and Q.
    V: ``(..., m)``, the last measurement's noise as estimated; nan before the first. H: ``(..., m, n)``, its Jacobian.
    moved: what the model said of the interval, until the update.
    """

    belief: Gaussian
    DV: Array
    DQ: Array
    V: Array
    H: Array
    moved: Moved | None = None


def differenced(
    move: Callable[[Array, Epoch], Moved],
    h: Callable[[Array, Epoch], Array],
    slope: Callable[[Array, Epoch], Array],
    noise: Noise,
) -> First:
    """The stage; priors in covariance form.

    Parameters
    ----------
    move: ``(mean, epoch) -> (state, Phi, G)``; see `Moved`.
    h, slope: ``(mean, epoch) ->`` measurement ``(..., m)`` and its Jacobian ``(..., m, n)``. noise: see `ar1_noise`.

    Returns
    -------
    A `First` for `celnav.filters.two_stage.two_stage`. Each epoch moves and is measured in full, or not at all.

    Raises
    ------
    ValueError: from the stage, for a prior in another form, a measurement that is missing in part, or where ``I + H G J`` is
        singular (determinant below 1e-12).
    """
    for name, function in (("move", move), ("h", h), ("slope", slope)):
        check_model(name, function, "(mean, epoch)")
    instance("noise", noise, Noise, "a Noise, such as ar1_noise(F, L, J, Xi, E)")
    F, L, J, Xi, V, Q = noise.F, noise.L, noise.J, noise.Xi, noise.V, noise.Q
    m, n_q, JF = F.shape[-1], L.shape[-1], J @ F
    f_V, f_Q = (matrix.diagonal(0, -2, -1)[..., None, :] for matrix in (F, L))
    # The first measurement is not differenced: what it takes into the prediction is all of J V.
    begun = side_by_side([0.5 * Q, Q, np.zeros((n_q, m))])
    fresh = side_by_side([0.5 * (Q + JF @ V @ JF.mT), Q, JF @ V * f_V])

    def start(prior: Gaussian) -> DifferencedState:
        if prior.form.name != "covariance":
            raise ValueError(f"prior: expected one in covariance form, got {prior.form.name} form")
        batch, n = prior.mean.shape[:-1], prior.mean.shape[-1]
        zeros = (np.zeros((*batch, n, m)), np.zeros((*batch, n, L.shape[-1])))
        return DifferencedState(prior, *zeros, np.full((*batch, m), np.nan), np.zeros((*batch, m, n)))

    def predict(state: DifferencedState, epoch: Epoch) -> tuple[DifferencedState, Array | None]:
        found = given_back("move", move(state.belief.mean, epoch), "state, Phi, G")
        moved = numbers("move", found[0]), numbers("move", found[1]), numbers("move", found[2])
        return state._replace(moved=moved), moved[1]

    def update(state: DifferencedState, epoch: Epoch) -> tuple[DifferencedState, Stage | None, Info]:
        assert state.moved is not None
        x, Phi, G = state.moved
        z = numbers("z", epoch.z, (..., m))
        if np.isnan(z).any():
            raise ValueError("z: expected a whole measurement at every epoch: what was missed cannot be differenced")
        first = bool(np.isnan(state.V).all())
        Z = z if first else z - matvec(F, state.V)
        sensor = V if first else Xi
        H = numbers("slope", slope(x, epoch), (..., m, x.shape[-1]))
        coupled = np.eye(m) + H @ G @ J
        if np.abs(np.linalg.det(coupled)).min() < 1e-12:
            raise ValueError("J: expected I + H G J to have an inverse, got a singular matrix")
        Omega = np.linalg.solve(coupled.mT, (G @ J).mT).mT
        n = x.shape[-1]
        both = side_by_side([Phi, G])
        both = both - Omega @ (H @ both)
        Phi1, G1 = both[..., :n], both[..., n:]
        y = Z - numbers("h", h(x, epoch), (..., m))
        into = matvec(Omega, y)
        mean, innovation = x + into, y - matvec(H, into)
        ahead = Phi1 @ side_by_side([state.belief.spread, state.DQ, state.DV])
        ahead_Q, ahead_V = ahead[..., n : n + n_q] * f_Q, ahead[..., n + n_q :]
        driven = G1 @ (begun if first else fresh)
        cross = (ahead_Q + ahead_V @ JF.mT + driven[..., :n_q]) @ G1.mT
        P = ahead[..., :n] @ Phi1.mT + cross + cross.mT
        HP = H @ P
        root = cholesky(HP @ H.mT + sensor)
        K = solve_upper_transposed(root, solve_lower(root, HP)).mT
        spread = P - K @ HP
        kept = side_by_side([ahead_Q, ahead_V * f_V]) + driven[..., n_q:]
        kept = kept - K @ (H @ kept)
        DQ, DV = kept[..., :n_q], kept[..., n_q:] - K @ sensor
        belief = Gaussian(mean + matvec(K, innovation), 0.5 * (spread + spread.mT), state.belief.form)
        after = DifferencedState(belief, DV, DQ, z - h(belief.mean, epoch), H)
        used = np.ones(innovation.shape, bool)
        lag = None if first else F
        stage = Stage(innovation, root, K, H, used, Omega, lag, None if first else state.H)
        return after, stage, Info(innovation, whiten(root, innovation), used, root, lambda: K)

    return First(start, predict, update)
