"""Hooks that adapt a measurement before its update (gates, innovation windows, robust weights,
parity checks), and Schmidt's gain.

A hook gets the `Joint` of measurement and state before the update and may replace it. Hooks act one
after the other, each with its own memory, and on each run separately. They assume that the noise of
each component is independent of the others. The measurement's (statistical) Jacobian gives the part
of an innovation that a correction of the state explains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from celnav.filters.joint import Gain, Hook, Joint
from celnav.gaussian.checks import LIMIT, choice, integer, integers, number, sequence
from celnav.gaussian.linalg import (
    Array,
    cholesky,
    matvec,
    present,
    semidefinite_root,
    side_by_side,
    solve_lower,
    solve_positive,
    solve_right,
    whiten,
)

__all__ = [
    "channel_parity",
    "chi_square_gate",
    "consider",
    "correntropy",
    "gate",
    "group_parity",
    "huber",
    "innovation_window",
    "range_basis",
    "sage_husa",
    "student_t",
    "underweighting",
    "variational_bayes",
]


# -- gates -----------------------------------------------------------------------------------------
def gate(gamma: float) -> Hook:
    """Leave out each component whose innovation exceeds ``gamma`` standard deviations (``inf``
    leaves out nothing).

    A rejected component is nan for the hooks that follow and for the update;
    ``Track.events["rejected"]`` counts it. If the gate is too narrow for the model's errors, the
    filter rejects all its measurements from then on.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.gate(4.0)])
    """
    if not np.array_equal(gamma, np.inf):
        number("gamma", gamma, above=0.0)
    return partial(_gate, gamma)


def _gate(gamma: float, memory: Any, joint: Joint, _epoch: Any) -> tuple[Any, Joint]:
    prior, noise = joint.variances()
    return memory, joint.leaving_out(
        np.asanyarray(joint.innovation) ** 2 > gamma**2 * (prior + noise)
    )


def chi_square_gate(probability: float = 0.999) -> Hook:
    """Leave out the whole measurement of a run whose normalized innovation squared is improbably
    large.

    probability: between 0 and 1, the probability of keeping a measurement that fits the model. The
        bound is the chi-square quantile for the number of components measured in the run.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.chi_square_gate(0.999)])
    """
    return partial(_chi_square_gate, number("probability", probability, above=0.0, below=1.0))


def _chi_square_gate(
    probability: float, memory: Any, joint: Joint, _epoch: Any
) -> tuple[Any, Joint]:
    e, V = np.asanyarray(joint.innovation), joint.measurement_noise
    used, S = present(e), joint.covariances()[0]
    S = S if V is None else S + V @ V.mT
    # Components that are missing get unit variance and zero innovation: they add nothing.
    S = np.where(used[..., None] & used[..., None, :], S, np.eye(e.shape[-1]))
    white = whiten(cholesky(S), np.where(used, e, 0.0))
    count, bounds = np.arange(e.shape[-1] + 1), _chi_square_bounds(probability, e.shape[-1])
    # (...): the bound of each run, by its number of measured components.
    most = np.where(used.sum(-1)[..., None] == count, bounds, 0.0).sum(-1)
    return memory, joint.leaving_out((np.vecdot(white, white) > most)[..., None])


@cache
def _chi_square_bounds(probability: float, m: int) -> Array:
    """Quantiles ``(m + 1,)`` of 0 to m degrees of freedom."""
    return np.concatenate([[np.inf], 2.0 * gammaincinv(0.5 * np.arange(1, m + 1), probability)])


# -- windows ---------------------------------------------------------------------------------------
class Window(NamedTuple):
    """Memory of a window: the last samples ``(M, ..., m)``, nan before the first sample, and the
    index of the last epoch.
    """

    samples: Array
    k: Any


def innovation_window(M: int, gaps: str = "restart") -> Hook:
    """Inflate the measurement noise of each component to match its last ``M`` innovations.

    C is the mean square of the last M innovations, the present one included. S0 is the variance of
    the innovation without measurement noise, and R the variance of the measurement noise.
    ``C = S0 + A R`` gives the factor ``A = max(1, (C - S0) / R)`` by which R is multiplied. A is 1
    until M samples are available. The noise is never reduced. A maneuver inflates it too, so the
    process noise must cover maneuvers. ``Track.extra["R"]`` has the variances used.

    gaps: "restart" restarts a component's window after a missing sample; "skip" uses the last M
        samples that exist, for sensors that are slower than the epochs.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.innovation_window(10)])
    """
    choice("gaps", gaps, ("restart", "skip"))
    return partial(_innovation_window, integer("M", M), gaps)


def _innovation_window(
    size: int, gaps: str, memory: Window | None, joint: Joint, epoch: Any
) -> tuple[Window, Joint]:
    window = _moved(memory, np.asanyarray(joint.innovation), epoch, size, gaps)
    prior, noise = joint.variances()
    # A component without noise, R = 0, gets A = 0 or -0: it is not inflated.
    A = (np.square(window.samples).mean(0) - prior) / np.where(noise > 0.0, noise, np.inf)
    return window, joint.inflated(np.sqrt(np.fmax(1.0, A)))  # A is nan until the window is full


def _moved(
    memory: Window | None, values: Array, epoch: Any, size: int, gaps: str = "restart"
) -> Window:
    """The window ``(size, ..., m)`` of the last ``size`` values, the present ones included."""
    k = getattr(epoch, "k", None)
    if memory is None:
        if size * values.size > LIMIT:
            raise ValueError(
                f"M: expected a window of at most {LIMIT} numbers, got {size} samples of "
                f"{values.size} each"
            )
        memory = Window(np.full((size, *values.shape), np.nan), None)
    # New axes of runs go after the window axis: (size, ..., m).
    before = memory.samples.reshape(
        size, *(1,) * (values.ndim + 1 - memory.samples.ndim), *memory.samples.shape[1:]
    )
    ring = np.broadcast_to(before, (size, *np.broadcast_shapes(before.shape[1:], values.shape)))
    moved = np.concatenate([ring[1:], np.broadcast_to(values, ring.shape[1:])[None]])
    if gaps == "skip":
        moved = np.where(present(values), moved, ring)
    # A hook is not called if no run has a measurement: every component has a gap there.
    elif k is not None and memory.k is not None:
        moved[:-1] = np.where(k > memory.k + 1, np.nan, moved[:-1])
    return Window(moved, k)


# -- robust weights --------------------------------------------------------------------------------
def huber(threshold: float = 1.345, rounds: int = 6) -> Hook:
    """Weight a component by ``min(1, threshold / u)`` [Huber1964], where u is its residual after
    the update, divided by the standard deviation of its noise.

    rounds: number of reweightings. The noise variance of a component is divided by its weight.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.huber()])
    """
    return _reweighted(partial(_huber, number("threshold", threshold, above=0.0)), rounds)


def _huber(bound: float, u: Array) -> Array:
    return np.asanyarray(bound / np.maximum(u, bound))


def student_t(dof: float = 4.0, rounds: int = 6) -> Hook:
    """Weight a component by ``(dof + 1) / (dof + u^2)``, the weight for noise with Student's t
    distribution; u and rounds as in `huber`.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.student_t(4.0)])
    """
    return _reweighted(partial(_student_t, number("dof", dof, above=0.0)), rounds)


def _student_t(nu: float, u: Array) -> Array:
    return np.asanyarray((nu + 1.0) / (nu + u * u))


def correntropy(bandwidth: float = 2.0, rounds: int = 6) -> Hook:
    """Weight a component by ``exp(-u^2 / (2 bandwidth^2))``, the maximum correntropy criterion
    [Chen2017]; u and rounds as in `huber`.

    Chen's filter also weights the prediction; this hook weights only the measurement. The smallest
    weight is 1e-9.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.correntropy()])
    """
    return _reweighted(partial(_correntropy, number("bandwidth", bandwidth, above=0.0)), rounds)


def _correntropy(sigma: float, u: Array) -> Array:
    return np.maximum(np.exp(-0.5 * (u / sigma) ** 2), 1e-9)


def _reweighted(weight: Callable[[Array], Array], rounds: int) -> Hook:
    return partial(_reweight, weight, integer("rounds", rounds, 1, 10_000))


def _reweight(
    weight: Callable[[Array], Array], rounds: int, memory: Any, joint: Joint, _epoch: Any
) -> tuple[Any, Joint]:
    e, R, used = _noisy(joint)
    S0, cross = joint.covariances()
    S0 = np.where(used[..., None] & used[..., None, :], S0, 0.0)
    explained = np.where(used[..., None], joint.measurement.jacobian() @ cross, 0.0)
    W, sigma, eye = np.ones_like(R), np.sqrt(R), np.eye(e.shape[-1])
    # Reweighting: v = e - H G S(W)^-1 e with R / W in S; then W = weight(|v| / sigma).
    for _ in range(rounds):
        S = S0 + (R / W)[..., None] * eye
        fitted = matvec(explained, solve_positive(S, e))
        W = np.where(used, weight(np.abs(e - fitted) / sigma), 1.0)
    return memory, joint.inflated(1.0 / np.sqrt(W))


def _noisy(joint: Joint) -> tuple[Array, Array, Array]:
    """Innovation (0 where unused), noise variances (1 where unused), and the mask of the components
    that are measured and have noise; all ``(..., m)``.
    """
    e, noise = np.asanyarray(joint.innovation), joint.noise_variances()
    used = present(e) & (noise > 0.0)
    return np.where(used, e, 0.0), np.where(used, noise, 1.0), used


class Estimated(NamedTuple):
    """Memory of `sage_husa`: the estimated noise variances, and the number of samples in each
    estimate; both ``(..., m)``.
    """

    noise: Array
    epochs: Array


def sage_husa(forgetting: float = 0.95, least: float = 0.25, smallest: float = 0.01) -> Hook:
    """Estimate the noise's variances from innovations with fading memory [Sage1969].

    For a measured component, ``R_k+1 = (1 - d) R_k + d max(e^2 - S0, smallest R)``, with
    ``d = (1 - b) / (1 - b^(k+1))``; b is ``forgetting``, between 0 and 1, and R the nominal
    variance. The update uses at least ``least R``, which may be below R. ``Track.extra["R"]`` has
    the variances used.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.sage_husa(0.98)])
    """
    b = number("forgetting", forgetting, above=0.0, below=1.0)
    floor, bottom = number("least", least, above=0.0), number("smallest", smallest, above=0.0)
    return partial(_sage_husa, b, floor, bottom)


def _sage_husa(
    b: float, floor: float, bottom: float, memory: Estimated | None, joint: Joint, _epoch: Any
) -> tuple[Estimated, Joint]:
    e = np.asanyarray(joint.innovation)
    prior, nominal = joint.variances()
    shape = np.broadcast_shapes(e.shape, nominal.shape)
    noise, count = (np.broadcast_to(nominal, shape), np.zeros(shape)) if memory is None else memory
    used = np.broadcast_to(present(e), shape)
    # The weight of a new sample falls from 1 to 1 - b.
    d = (1.0 - b) / (1.0 - b ** (count + 1.0))
    sample = np.maximum(np.where(used, e, 0.0) ** 2 - prior, bottom * nominal)
    noise = np.where(used, (1.0 - d) * noise + d * sample, noise)
    # The variance of a component without noise stays 0.
    ratio = np.maximum(noise, floor * nominal) / np.where(nominal > 0.0, nominal, 1.0)
    return Estimated(noise, count + used), joint.inflated(np.sqrt(ratio))


class InverseGamma(NamedTuple):
    """Memory of `variational_bayes`: shape and scale ``(..., m)`` of the distribution of the
    variances, in units of the nominal variances.
    """

    alpha: Array
    beta: Array


def variational_bayes(forgetting: float = 0.95, samples: float = 2.0, rounds: int = 3) -> Hook:
    """Estimate the noise's variances together with the state, by variational Bayes
    [Sarkka2009; nonlinear: Sarkka2013].

    The variance of a component has an inverse-gamma distribution; the update uses
    ``R = beta / alpha``. A sample changes ``(alpha, beta)`` to
    ``(b alpha + 1/2, b beta + E[v^2] / 2)``; b is ``forgetting``, above 0 and at most 1. The mean
    square of the noise v given the innovation e is ``E[v^2] = (R S^-1 e)^2 + R - R S^-1 R``; a
    fixed-point iteration of ``rounds`` rounds solves for R. (For a linear h these are the paper's
    terms, ``z - h`` and the variance of h after the update; for a nonlinear h they approximate the
    paper's integral by the statistical linearization of the update.) At the start the nominal
    variances have the weight of ``samples`` samples. A component without a measurement keeps its
    estimate. With the numpy engine ``Track.extra["R"]`` has the estimates.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.variational_bayes(0.98)])
    >>> sigma = np.sqrt(celnav.run(filter, prior, times, z).extra["R"])  # (T, ..., m)
    """
    b, first = (
        number("forgetting", forgetting, above=0.0, most=1.0),
        0.5 * number("samples", samples, above=0.0),
    )
    return partial(_variational_bayes, b, first, integer("rounds", rounds, 1, 10_000))


def _variational_bayes(
    b: float, first: float, rounds: int, memory: InverseGamma | None, joint: Joint, _epoch: Any
) -> tuple[InverseGamma, Joint]:
    e, nominal, used = _noisy(joint)
    S0 = np.where(used[..., None] & used[..., None, :], joint.covariances()[0], 0.0)
    eye, start = np.eye(e.shape[-1]), np.full(e.shape, first)
    alpha, beta = (start, start) if memory is None else memory
    alpha, before = np.where(used, b * alpha + 0.5, alpha), np.where(used, b * beta, beta)
    beta = before
    for _ in range(rounds):
        factor = beta / alpha
        R = factor * nominal
        white = solve_lower(cholesky(S0 + R[..., None] * eye), eye)  # S^-1 = white' white
        # v = R S^-1 e, and its variance R - R S^-1 R.
        v = R * matvec(white.mT, matvec(white, e))
        variance = R - R**2 * np.square(white).sum(-2)
        beta = np.where(used, before + 0.5 * (v**2 + variance) / nominal, beta)
    return InverseGamma(alpha, beta), joint.inflated(np.sqrt(factor))


# -- underweighting --------------------------------------------------------------------------------
def underweighting(beta: float = 0.2, share: float = 0.5) -> Hook:
    """Lear's underweighting: while the prior is poor, inflate its part of the innovation covariance
    by the factor ``1 + beta`` [Carpenter2018].

    ``S = (1 + beta) S0 + R``, where S0 is the innovation covariance without measurement noise. It
    acts in runs where S0 exceeds the fraction ``share`` (below 1; 0: always) of the innovation
    variance of any measured component. Precise measurements then improve a poor prior gradually,
    which leaves a margin for linearization errors. The added covariance is treated as measurement
    noise, so the updated covariance fits the gain. In ``hooks`` it stands after the gates.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.underweighting()])
    """
    factor, least = number("beta", beta, above=0.0), number("share", share, 0.0, below=1.0)
    return partial(_underweight, factor, least)


def _underweight(
    factor: float, least: float, memory: Any, joint: Joint, _epoch: Any
) -> tuple[Any, Joint]:
    prior, noise = joint.variances()
    measured = present(joint.innovation)
    poor = np.asanyarray((measured & (prior > least * (prior + noise))).any(-1))
    S0, V = joint.covariances()[0], joint.measurement_noise
    S0 = np.where(np.abs(S0) < np.inf, S0, 0.0)  # not finite in a run that has failed
    extra = np.where(poor[..., None, None], semidefinite_root(factor * S0), 0.0)
    return memory, joint._replace(
        measurement_noise=extra if V is None else side_by_side([V, extra])
    )


# -- parity ----------------------------------------------------------------------------------------
def _residual(joint: Joint) -> tuple[Array, Array, Array, Array]:
    """Residuals of the weighted fit of an innovation by all states, the variances of the residuals,
    the noise variances, and the mask of components used; all ``(..., m)``.

    A maneuver, or any other prediction error, lies in the range of the measurement matrix and
    leaves these residuals unchanged.
    """
    # r = (I - Q Q') R^-1/2 e in units of the noise, where Q spans R^-1/2 H D, D = diag(sigma).
    e, R, used = _noisy(joint)
    root = np.where(used, np.sqrt(1.0 / R), 0.0)
    D, W = joint.state.columns, joint.process_noise
    variance = np.einsum("...ij,...ij,j->...i", D, D, np.broadcast_to(joint.sign, D.shape[-1:]))
    std = np.sqrt(np.maximum(variance if W is None else variance + np.square(W[1]).sum(-1), 0.0))
    # A state whose standard deviation changes a measurement by less than 1e-6 of the noise's
    # standard deviation is treated as unobservable.
    Q = range_basis(root[..., None] * joint.measurement.jacobian() * std[..., None, :], 1e-6)
    y = root * e
    left = y - matvec(Q, matvec(Q.mT, y))
    # Diagonal of I - Q Q', (..., m): the share of each component that no state explains.
    share = np.maximum(1.0 - np.square(Q).sum(-1), 0.0)
    return np.where(used, left * np.sqrt(R), 0.0), np.where(used, share * R, 0.0), R, used


def range_basis(A: Array, least: float) -> Array:
    """Orthonormal columns Q ``(..., m, n)`` that span the range of tall matrices ``(..., m, n)``:
    ``Q @ Q.mT`` projects onto it.

    A singular value of at most ``least`` gives a column of zeros; a matrix that is not finite gives
    nan.
    """
    Q, R = np.linalg.qr(A)
    # QR suffices if the columns are clearly independent. A nearly dependent column would get an
    # arbitrary direction from QR, so the singular value decomposition replaces it.
    lost = np.asanyarray(~np.isfinite(A).all((-2, -1)))
    clear = lost | (np.abs(R.diagonal(0, -2, -1)).min(-1) > 1e3 * least)
    if clear.all():
        return np.asanyarray(Q)
    U, s, _ = np.linalg.svd(np.where(lost[..., None, None], 0.0, A), full_matrices=False)
    return np.where(clear[..., None, None], Q, np.where(s[..., None, :] > least, U, 0.0))


def group_parity(groups: Sequence[ArrayLike], unknowns: int, *, deviations: float = 3.0) -> Hook:
    """Inflate the noise of a whole group of components to match the residual that no state error
    explains, immediately and without a window.

    groups: index arrays of components, such as all ranges and all rates.
    unknowns: how many states a group determines.
    deviations: threshold, in standard deviations of s.

    The residuals r of the N measured components of a group give
    ``s = sum r^2 / R / (N - unknowns)``. The noise variance is multiplied by s if s exceeds
    ``1 + deviations sqrt(2 / (N - unknowns))`` and N is at least ``unknowns + 2``. ValueError if
    groups overlap.

    >>> hook = celnav.filters.adaptive.group_parity([[0, 1, 2, 3, 4, 5]], unknowns=4)
    """
    members = [
        list(integers("groups", group))
        for group in sequence("groups", groups, "[[0, 1], [2, 3]]", least=1)
    ]
    every = [i for group in members for i in group]
    if not all(members) or len(set(every)) != len(every):
        raise ValueError(
            f"groups: expected groups of components that do not overlap, got {members}"
        )
    unknowns = min(integer("unknowns", unknowns), 10**9)  # no group is as large
    return partial(_group_parity, members, unknowns, number("deviations", deviations, 0.0))


def _group_parity(
    groups: Sequence[list[int]],
    unknowns: int,
    deviations: float,
    memory: Any,
    joint: Joint,
    _epoch: Any,
) -> tuple[Any, Joint]:
    r, _, R, used = _residual(joint)
    if (last := max(map(max, groups))) >= r.shape[-1]:
        raise ValueError(f"groups: expected components below {r.shape[-1]}, got {last}")
    factor, squares = np.ones(r.shape), r**2 / R
    for group in groups:
        spare = used[..., group].sum(-1) - unknowns
        enough, spare = spare >= 2, np.maximum(spare, 1)
        # s (...) is a chi-square divided by its degrees of freedom: mean 1, variance 2 / spare.
        s = squares[..., group].sum(-1) / spare
        bound = 1.0 + deviations * np.sqrt(2.0 / spare)
        factor[..., group] = np.where(enough & (s > bound), s, 1.0)[..., None]
    return memory, joint.inflated(np.sqrt(factor))


def channel_parity(M: int) -> Hook:
    """Inflate the noise of each component to match the last ``M`` residuals of the fit in
    `group_parity`.

    The noise variance is multiplied by ``max(1, mean of r^2 / C)``, where C is the variance of the
    residual r. The factor is 1 until a component has M samples at consecutive epochs.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.channel_parity(10)])
    """
    return partial(_channel_parity, integer("M", M))


def _channel_parity(
    size: int, memory: Window | None, joint: Joint, epoch: Any
) -> tuple[Window, Joint]:
    r, variances, R, _ = _residual(joint)
    spare = variances > 1e-6 * R  # below this the fit absorbs the component: no residual
    ratio = np.where(spare, r**2 / np.where(spare, variances, 1.0), np.nan)
    window = _moved(memory, ratio, epoch, size)
    return window, joint.inflated(np.sqrt(np.fmax(1.0, window.samples.mean(0))))


# -- a gain ----------------------------------------------------------------------------------------
def consider(n: int, k: int) -> Gain:
    """Schmidt's gain: optimal for the first ``n`` states, 0 for the ``k`` considered states after
    them.

    Considered states (biases, constants of a model) are not estimated. Their uncertainty, and their
    correlation with the other states, is propagated exactly. A fixed gain needs no function: with
    ``gain=K (n, m)`` the filter computes the covariance for K, optimal or not. The filter raises
    ValueError if the state does not have n + k components.

    >>> filter = celnav.ukf(motion, sensor, gain=consider(6, 3))
    >>> alpha_beta = celnav.ukf(motion, sensor, gain=np.array([[0.4], [0.1]]))
    """
    return partial(_consider, integer("n", n), integer("k", k, 0))


def _consider(n: int, k: int, A: Array, sign: Array, m: int) -> Array:
    if A.shape[-2] - m != n + k:
        raise ValueError(
            f"consider: expected a state of {n} + {k} components, got {A.shape[-2] - m}"
        )
    # K = P_xz (S S')^-1 for the first n states, 0 for the k considered ones.
    C = (A[..., : m + n, :] * sign) @ A[..., :m, :].mT
    S = cholesky(C[..., :m, :])
    K = solve_right(S, solve_lower(S, C[..., m:, :].mT).mT)
    return np.concatenate([K, np.zeros((*K.shape[:-2], k, m))], -2)
