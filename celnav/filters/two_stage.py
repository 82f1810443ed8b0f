"""Two-stage filters: a filter that knows of no bias, a second one that estimates the bias from what the first leaves over.

The first stage runs as if the bias were zero. A sensitivity ``Lambda`` says what a unit of bias does to its estimate; its
innovation, less what the sensitivity explains, is the measurement of the second stage [Friedland 1969]. For a constant bias, or
one that walks at random [Hsieh & Chen 1999], both together are the augmented Kalman filter.

Any first stage will do that hands on a `Stage` with each step: `plain` makes one of a predict and an update part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.arguments import check_belief, check_model, given_back, takes
from celnav.filters.conditioning import evaluate
from celnav.filters.driver import Epoch, Filter
from celnav.filters.info import Info
from celnav.filters.step import Conditioning, Motion, Predict, Update
from celnav.gaussian.belief import Gaussian, sqrt_cov
from celnav.gaussian.checks import finite, kind, numbers
from celnav.gaussian.linalg import Array, block, matvec, outer, side_by_side, tria, unit, whiten

Slope = Array | Callable[[Array, Epoch], Array]
"""``Gamma (..., m, p)``: derivative of the measurement with respect to the bias; constant or ``(mean, epoch) -> matrix``."""


class Stage(NamedTuple):
    """What a first stage did in a step.

    Attributes
    ----------
    innovation: ``(..., m)``. root: ``(..., m, m)``, of its covariance.
    gain: ``(..., n, m)``. H: ``(..., m, n)``, Jacobian of the measurement. used: ``(..., m)``, the components that took part.
    Omega: ``(..., n, m)``, how the measurement itself enters the prediction; None if it does not.
    lag: ``(m, m)``, what of the last measurement is taken off this one, and before: ``(..., m, n)``, that one's H; None without.
    """

    innovation: Array
    root: Array
    gain: Array
    H: Array
    used: Array
    Omega: Array | None = None
    lag: Array | None = None
    before: Array | None = None


class First(NamedTuple):
    """A first stage: ``start(prior) -> state`` with a ``belief``; ``predict(state, epoch) -> (state, Phi)``, None where it does
    not move; ``update(state, epoch) -> (state, stage, info)``, no stage where nothing was measured.
    """

    start: Callable[[Gaussian], Any]
    predict: Callable[[Any, Epoch], tuple[Any, Array | None]]
    update: Callable[[Any, Epoch], tuple[Any, Stage | None, Info]]


class PlainState(NamedTuple):
    """Belief without the bias, and the memory of the update part."""

    belief: Gaussian
    memory: Any = None


def plain(predict: Predict, update: Update) -> First:
    """A first stage of the common parts: any rule, either form, hooks included. Vector states only.

    Raises
    ------
    ValueError: for parts that are none, or not in this order.
    """
    if isinstance(predict, Conditioning) or not takes(predict, 2):
        raise ValueError(f"predict: expected a part (belief, epoch), got {kind(predict)}")
    if isinstance(update, Motion) or not takes(update, 4):
        raise ValueError(f"update: expected a part (belief, z, epoch, memory), got {kind(update)}")

    def move(state: PlainState, epoch: Epoch) -> tuple[PlainState, Array | None]:
        if not np.any(epoch.dt):
            return state, None
        belief, info = given_back("predict", predict(state.belief, epoch), "belief, info")
        slopes = info.slopes[0]
        assert slopes is not None
        return state._replace(belief=belief), slopes()[0]

    def see(state: PlainState, epoch: Epoch) -> tuple[PlainState, Stage | None, Info]:
        if epoch.z is None:
            return state, None, Info(silent=True)
        found = update(state.belief, epoch.z, epoch, state.memory)
        belief, info, memory = given_back("update", found, "belief, info, memory")
        after = PlainState(belief, memory)
        slopes = info.slopes[-1] if info.slopes else None
        if info.innovation_root is None or info.gain is None or slopes is None or info.innovation is None:
            return after, None, info
        used = np.ones(info.innovation.shape, bool) if info.used is None else info.used
        H = np.where(used[..., None], slopes()[0], 0.0)
        return after, Stage(np.where(used, info.innovation, 0.0), info.innovation_root, info.gain(), H, used), info

    return First(lambda prior: PlainState(prior), move, see)


class TwoStageState(NamedTuple):
    """State of a two-stage filter.

    Attributes
    ----------
    first: of the first stage. bias: belief about the bias ``(..., p)``. Lambda: ``(..., n, p)``.
    Gamma: ``(..., m, p)`` of the last measurement; None before it. memory: of ``boost``.
    """

    first: Any
    bias: Gaussian
    Lambda: Array
    Gamma: Array | None = None
    memory: Any = None

    @property
    def belief(self) -> Gaussian:
        """State and bias ``(..., n + p)``, corrected: what the augmented filter would have."""
        free, own, Lambda = self.first.belief, self.bias, self.Lambda
        mean = side_by_side([free.mean + matvec(Lambda, own.mean), own.mean])
        if free.form.name == "covariance":
            cross = Lambda @ own.spread
            return Gaussian(mean, block([[free.spread + cross @ Lambda.mT, cross], [cross.mT, own.spread]]), free.form)
        return Gaussian(mean, tria(block([[free.spread, Lambda @ own.spread], [0, own.spread]])), free.form)


class Boost(NamedTuple):
    """What a boost sees of the bias stage.

    Attributes
    ----------
    residual: ``(..., m)``, the innovation less what the estimated bias explains. total: ``(..., m, m)``, its covariance.
    innovation, own: the same of the first stage alone.
    """

    residual: Array
    total: Array
    innovation: Array
    own: Array


def two_stage(
    first: First,
    Gamma: Slope | ArrayLike,
    bias: Gaussian,
    *,
    Qb: ArrayLike | None = None,
    boost: Callable[[Any, Boost], tuple[Any, Array]] | None = None,
) -> Filter:
    """A filter of two stages.

    Parameters
    ----------
    first: see `First`. Gamma: see `Slope`.
    bias: belief about the bias ``(p,)`` at the start.
    Qb: covariance ``(p, p)`` of the steps of a bias that walks at random; None: it is constant. With a `plain` first stage only.
    boost: ``(memory, Boost) -> (memory, factors (..., p))``: the gain of the bias stage is that of a covariance inflated by the
        factors, while the covariance itself is not; see `celnav.filters.strong_tracking`.

    Returns
    -------
    A `Filter` whose belief is about state and bias, ``(..., n + p)``. The prior is about the state alone. Innovations, NIS and
    likelihood are those of both stages, what the augmented filter would have; gain and slopes are of the first.

    Raises
    ------
    ValueError: if ``Gamma`` or ``Qb`` is not what it should be.
    """
    if not isinstance(first, First):
        raise ValueError(f"first: expected a first stage, such as plain(predict, update), got {kind(first)}")
    check_belief(bias, "bias")
    if callable(Gamma):
        check_model("Gamma", Gamma, "(mean, epoch)")
    if boost is not None:
        check_model("boost", boost, "(memory, seen)")
    p = bias.mean.shape[-1]
    slope: Any = Gamma if callable(Gamma) else finite("Gamma", Gamma)
    if not callable(Gamma) and (slope.ndim < 2 or slope.shape[-1] != p):
        raise ValueError(f"Gamma: expected shape (..., m, {p}) to go with the bias, got {slope.shape}")
    walk = None if Qb is None else sqrt_cov(Qb, "Qb", p)

    def start(prior: Gaussian) -> TwoStageState:
        batch, n = prior.mean.shape[:-1], prior.mean.shape[-1]
        spread = prior.form.marginal(bias.root, np.ones(p))
        own = Gaussian(np.broadcast_to(bias.mean, (*batch, p)), np.broadcast_to(spread, (*batch, p, p)), prior.form)
        return TwoStageState(first.start(prior), own, np.zeros((*batch, n, p)))

    def step(state: TwoStageState, epoch: Epoch) -> tuple[TwoStageState, Info]:
        known, Phi = first.predict(state.first, epoch)
        own, Lambda = state.bias, state.Lambda
        if Phi is not None:
            Lambda = Phi @ Lambda
            if walk is not None:
                known, own, Lambda = _walked(known, own, Lambda, walk)
        known, stage, info = first.update(known, epoch)
        if stage is None:
            return TwoStageState(known, own, Lambda, state.Gamma, state.memory), info
        here = numbers("Gamma", evaluate(slope, known.belief.mean, epoch))
        if here.shape[-2:] != (stage.used.shape[-1], p):
            raise ValueError(f"Gamma: expected shape (..., {stage.used.shape[-1]}, {p}), got {here.shape}")
        seen = here
        if state.Gamma is not None and stage.lag is not None:
            seen = here - stage.lag @ (state.Gamma + stage.before @ state.Lambda)
        if stage.Omega is not None:
            Lambda = Lambda - stage.Omega @ (seen + stage.H @ Lambda)
        S = np.where(stage.used[..., None], stage.H @ Lambda + seen, 0.0)
        residual = stage.innovation - matvec(S, own.mean)
        own, memory, white, root = _estimate(own, S, residual, stage, boost, state.memory)
        # What a hook left out keeps the innovation of the first stage.
        both = info._replace(
            innovation=np.where(stage.used, residual, np.asarray(info.innovation)), white=white, innovation_root=root
        )
        return TwoStageState(known, own, Lambda - stage.gain @ S, here, memory), both

    return Filter(start, step)


def _walked(known: Any, own: Gaussian, Lambda: Array, walk: Array) -> tuple[Any, Gaussian, Array]:
    """Sensitivity and first stage before an update when the bias has moved [Hsieh & Chen 1999]."""
    M = own.cov
    after = Gaussian(own.mean, own.form.sum(own.spread, walk), own.form)
    share = _quotient(after.cov, M, walk)
    less = Lambda @ share.mT
    left = unit(M.shape[-1]) - share
    # M - M share of the bias's variance goes to the state: left' M left + share' Qb share, which takes no difference.
    columns = Lambda @ side_by_side([left.mT @ own.root, share.mT @ walk])
    belief = known.belief
    mean = belief.mean + matvec(Lambda - less, own.mean)
    return known._replace(belief=belief._replace(mean=mean, spread=belief.form.sum(belief.spread, columns))), after, less


def _quotient(total: Array, M: Array, walk: Array) -> Array:
    """``(M^-)^-1 M`` with ``M^- = M + walk @ walk.mT``; a bias that is known exactly and does not move has no part in it."""
    if (walk.diagonal(0, -2, -1) > 1e-6 * np.sqrt(np.vecdot(walk, walk))).all():
        return np.linalg.solve(total, M)
    variances = total.diagonal(0, -2, -1)
    std = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    whole = np.asarray(np.isfinite(total).all((-2, -1)))[..., None, None]
    correlation = np.where(whole, total / std[..., :, None] / std[..., None, :], 0.0)
    inverse = np.linalg.pinv(correlation, rtol=1e-12, hermitian=True) / std[..., :, None] / std[..., None, :]
    return np.asarray(np.where(whole, inverse, np.nan) @ M)


def _estimate(
    own: Gaussian, S: Array, residual: Array, stage: Stage, boost: Any, memory: Any
) -> tuple[Gaussian, Any, Array, Array]:
    """The bias stage: condition on the residual, which is the innovation of both stages; the boosted gain moves the mean only.

    Returns the belief, the memory, the whitened residual and its root.
    """
    m, p = S.shape[-2:]
    root, sign = own.columns
    A = block([[S @ root, stage.root], [root, np.zeros((p, m))]])
    total_root, U, spread = own.form.condition(A, sign, m)
    white = whiten(total_root, residual)
    if boost is None:
        return Gaussian(own.mean + matvec(U, white), spread, own.form), memory, white, total_root
    own_cov, total = outer(stage.root), outer(total_root)
    found = boost(memory, Boost(residual, total, stage.innovation, own_cov))
    memory, factors = given_back("boost", found, "memory, factors")
    scale = np.sqrt(numbers("boost", factors, (..., p)))
    cross = S @ (scale[..., :, None] * own.cov * scale[..., None, :])
    moved = np.linalg.solve(cross @ S.mT + own_cov, residual[..., None])[..., 0]
    return Gaussian(own.mean + matvec(cross.mT, moved), spread, own.form), memory, white, total_root
