"""Two-stage filters: a first filter that ignores the bias, and a second one that estimates the bias
from the innovations of the first.

The first stage runs as if the bias were zero. The sensitivity ``Lambda`` is the derivative of its
estimate with respect to the bias. The innovation of the first stage is the measurement of the
second stage, with ``Gamma + H Lambda`` as its Jacobian [Friedland1969]. For a constant bias, or a
bias that is a random walk [Hsieh1999], both stages together are the augmented Kalman filter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.joint import KEEP, condition, joint, marginal, shared_mask
from celnav.filters.model import Motion, Sensor, check_return, matrices_of
from celnav.filters.records import Epoch, Info, State
from celnav.filters.regression import pseudo_gain
from celnav.filters.sequential import Sequential, is_zero_interval, require_sequential, sigma_point
from celnav.gaussian.belief import Gaussian, symmetric
from celnav.gaussian.checks import as_matrix, describe, finite, function, instance, numbers
from celnav.gaussian.linalg import (
    Array,
    SquareRoot,
    block,
    matvec,
    outer,
    side_by_side,
    solve_lower,
    tria,
    whiten,
)
from celnav.gaussian.rules import UNSCENTED, Taylor
from celnav.gaussian.spaces import EUCLIDEAN

__all__ = ["two_stage"]

Slope = Array | Callable[[Array, Epoch], Array]
"""``Gamma (..., m, p)``: derivative of the measurement with respect to the bias, constant or a
function ``(mean, epoch) -> matrix``.
"""
LINEAR = Taylor()
# Fraction of a standard deviation below which a direction of the bias is treated as exact: the
# round-off of many steps.
KNOWN = 1e-6


class Stage(NamedTuple):
    """Results of a first stage in a step: the innovation ``(..., m)``, the root ``(..., m, m)`` of
    the innovation covariance, the gain ``(..., n, m)``, the measurement's Jacobian
    ``H (..., m, n)`` and the mask of used components ``(..., m)``.

    Omega: ``(..., n, m)``, how the measurement itself enters the prediction; None if it does not.
    lag: ``(m, m)``, the matrix Phi of a differenced measurement ``z - Phi z_last``. before:
        ``(..., m, n)``, the H of the last measurement. None without differencing.
    """

    innovation: Array
    sqrt_S: Array
    gain: Array
    H: Array
    used: Array
    Omega: Array | None = None
    lag: Array | None = None
    before: Array | None = None


@dataclass(frozen=True, eq=False)
class Plain:
    """A first stage from an ordinary filter with one sensor: any rule, either form, hooks included.
    Vector states only; ValueError otherwise.
    """

    filter: Sequential

    def __post_init__(self) -> None:
        space = require_sequential("filter", self.filter).motion.space
        if len(self.filter.sensors) != 1 or space != EUCLIDEAN:
            raise ValueError("filter: expected one sensor and states that are vectors")

    def start(self, prior: Gaussian) -> State:
        return self.filter.start(prior)

    def predict(self, state: State, epoch: Epoch) -> tuple[State, Array | None]:
        """State after the interval, and the transition matrix ``(..., n, n)``."""
        if is_zero_interval(epoch):
            return state, None
        moved = self.filter.predicted(state.belief, epoch)
        return state._replace(
            belief=marginal(self.filter.form, moved, EUCLIDEAN)
        ), moved.state.jacobian()

    def update(self, state: State, epoch: Epoch) -> tuple[State, Stage | None, Info]:
        """State given the measurement, its `Stage` and its `Info`."""
        after, infos = self.filter.update(state, epoch)
        info: Any = infos[0]
        if info.sqrt_S is None:
            return after, None, info
        used = shared_mask(info.used)
        H = np.where(used[..., None], info.jacobian(), 0.0)
        return (
            after,
            Stage(np.where(used, info.innovation, 0.0), info.sqrt_S, info.gain(), H, used),
            info,
        )


class TwoStageState(NamedTuple):
    """State of the first stage, belief about the bias ``(..., p)``, sensitivity ``(..., n, p)``,
    Gamma at the last measurement, memory of the boost.
    """

    first: Any
    bias: Any
    Lambda: Array
    Gamma: Array | None = None
    memory: Any = None

    @property
    def belief(self) -> Any:
        """State and bias ``(..., n + p)``, corrected: the belief of the augmented filter."""
        # x = x_free + Lambda b, with b independent of the error of x_free.
        free, bias, Lambda = self.first.belief, self.bias, self.Lambda
        mean = side_by_side([free.mean + matvec(Lambda, bias.mean), bias.mean])
        if isinstance(free, SquareRoot):
            return SquareRoot(
                mean, tria(block([[free.sqrt_cov, Lambda @ bias.sqrt_cov], [0, bias.sqrt_cov]]))
            )
        cross = Lambda @ bias.cov
        return type(free)(
            mean, block([[free.cov + cross @ Lambda.mT, cross], [cross.mT, bias.cov]])
        )


class Boost(NamedTuple):
    """Arguments of a boost: the innovation minus its prediction from the bias ``(..., m)`` and its
    covariance ``(..., m, m)``; the innovation and covariance of the first stage alone.
    """

    residual: Array
    total: Array
    innovation: Array
    own: Array


def two_stage(
    motion: Motion,
    sensor: Sensor,
    Gamma: Slope | ArrayLike,
    bias: Gaussian,
    *,
    Qb: ArrayLike | None = None,
    boost: Callable[[Any, Boost], tuple[Any, Array]] | None = None,
    rule: Any = UNSCENTED,
    **options: Any,
) -> TwoStage:
    """A filter that estimates a state and, in a second stage, a measurement bias.

    motion, sensor: the models of the first stage, without the bias.
    Gamma: ``(..., m, p)``, derivative of the measurement with respect to the bias, or a function
        ``(mean, epoch)`` that returns it.
    bias: the prior of the bias, ``(p,)``.
    Qb: covariance ``(p, p)`` of the steps of a random-walk bias; None: the bias is constant.
    boost: ``(memory, Boost) -> (memory, factors (..., p))``: the gain of the bias stage is computed
        from a covariance inflated by the factors; the covariance itself is not inflated. For an
        example see `celnav.papers.tstdkf.method.strong_tracking`.
    rule, options: for the first stage, as in `celnav.sigma_point`.

    The filter starts from a prior of the state alone; its belief is about state and bias,
    ``(..., n + p)``. Innovations, NIS and likelihood equal the augmented filter's; gain and
    Jacobian are from the first stage. If the runs of a linear model share the prior's covariance,
    they share all covariances and the sensitivity, which then have no axis of runs. ValueError
    names an argument that does not fit.

    >>> bias = celnav.Gaussian(np.zeros(3), np.eye(3))
    >>> filter = celnav.two_stage(motion, sensor, np.eye(3), bias)
    """
    return TwoStage.of(
        Plain(sigma_point(motion, sensor, rule=rule, **options)), Gamma, bias, Qb=Qb, boost=boost
    )


@dataclass(frozen=True, eq=False)
class TwoStage:
    """The filter of `two_stage`; `of` makes one from any first stage."""

    first: Any
    Gamma: Slope
    bias: Gaussian
    _: KW_ONLY
    walk: Array | None = None
    boost: Callable[[Any, Boost], tuple[Any, Array]] | None = None

    @classmethod
    def of(
        cls,
        first: Any,
        Gamma: Slope | ArrayLike,
        bias: Gaussian,
        *,
        Qb: ArrayLike | None = None,
        boost: Any = None,
    ) -> TwoStage:
        """A filter from any first stage, such as `Plain`; other arguments as in `two_stage`.

        ``first.start(prior)`` returns a state with a ``belief``. ``first.predict(state, epoch)``
        returns the state after the interval and the transition matrix (None if the interval is 0).
        ``first.update(state, epoch)`` returns the state, a `Stage` (None if nothing was measured)
        and an `Info`.
        """
        if isinstance(first, Sequential) or not all(
            hasattr(first, name) for name in ("start", "predict", "update")
        ):
            raise ValueError(
                "first: expected a first stage, such as celnav.filters.two_stage.Plain(filter), "
                f"got {describe(first)}"
            )
        instance("bias", bias, Gaussian, "celnav.Gaussian(mean, cov)")
        p = bias.mean.shape[-1]
        slope = (
            function("Gamma", Gamma, "(mean, epoch)") if callable(Gamma) else finite("Gamma", Gamma)
        )
        if not callable(slope) and (slope.ndim < 2 or slope.shape[-1] != p):
            raise ValueError(
                f"Gamma: expected shape (..., m, {p}) to go with the bias, got {slope.shape}"
            )
        if boost is not None:
            function("boost", boost, "(memory, boost)")
        walk = None if Qb is None else symmetric(as_matrix("Qb", Qb, p), "Qb", p)[1]
        return cls(first, slope, bias, walk=walk, boost=boost)

    def start(self, prior: Gaussian) -> TwoStageState:
        first = self.first.start(prior)
        *batch, n = first.belief.mean.shape
        bias, p = type(first.belief).of(self.bias), self.bias.mean.shape[-1]
        runs = np.broadcast_shapes(bias.mean.shape[:-1], bias[1].shape[:-2])
        pairs = zip(runs[::-1], batch[::-1], strict=False)
        if len(runs) > len(batch) or any(a not in (1, b) for a, b in pairs):
            raise ValueError(f"bias: expected one, or one for each run {tuple(batch)}, got {runs}")
        # Covariance and sensitivity get an axis of runs where the models' matrices have one.
        return TwoStageState(
            first, bias._replace(mean=np.broadcast_to(bias.mean, (*batch, p))), np.zeros((n, p))
        )

    def step(self, state: TwoStageState, epoch: Epoch) -> tuple[TwoStageState, tuple[Info, ...]]:
        first, Phi = self.first.predict(state.first, epoch)
        bias, Lambda = state.bias, state.Lambda
        if Phi is not None:
            # The bias does not enter the motion, so its effect on the state is propagated by Phi.
            Lambda = Phi @ Lambda
            if self.walk is not None:
                first, bias, Lambda = _walked(first, bias, Lambda, self.walk)
        first, stage, info = self.first.update(first, epoch)
        if stage is None:
            return TwoStageState(first, bias, Lambda, state.Gamma, state.memory), (info,)
        Gamma = self.Gamma
        if callable(Gamma):
            Gamma = matrices_of("Gamma", Gamma, first.belief.mean, epoch)
        direct = here = numbers("Gamma", Gamma, (..., stage.used.shape[-1], bias.mean.shape[-1]))
        # Gamma* = Gamma - Phi (Gamma_last + H_last Lambda_last) for differenced measurements.
        if state.Gamma is not None and stage.lag is not None:
            direct = here - stage.lag @ (state.Gamma + stage.before @ state.Lambda)
        if stage.Omega is not None:
            Lambda = Lambda - stage.Omega @ (direct + stage.H @ Lambda)
        # S = H Lambda + Gamma, (..., m, p): minus the derivative of the first stage's innovation to
        # the bias.
        S = np.where(stage.used[..., None], stage.H @ Lambda + direct, 0.0)
        # Condition the bias on the innovation of the first stage, with the Jacobian S.
        bias_joint = joint(
            LINEAR,
            bias,
            ((matvec(S, bias.mean), S), KEEP),
            z=stage.innovation,
            measurement_noise=stage.sqrt_S,
        )
        conditioned: Any = condition(type(bias), bias_joint, EUCLIDEAN)
        after, both, _ = conditioned
        memory = state.memory
        if self.boost is not None:
            boost = Boost(
                both.innovation, outer(both.sqrt_S), stage.innovation, outer(stage.sqrt_S)
            )
            memory, factors = check_return("boost", self.boost(memory, boost), "memory, factors")
            root = np.sqrt(numbers("boost", factors, (..., bias.mean.shape[-1])))
            after = after._replace(
                mean=bias.mean + _boosted(bias.cov, root, S, stage.sqrt_S, both.innovation)
            )
        # A component that a hook left out keeps the innovation of the first stage.
        innovation = np.where(stage.used, both.innovation, np.asanyarray(info.innovation))
        info = info._replace(innovation=innovation, whitened=both.whitened, sqrt_S=both.sqrt_S)
        # Lambda+ = Lambda - K S, with the gain K of the first stage.
        return TwoStageState(first, after, Lambda - stage.gain @ S, here, memory), (info,)


def _boosted(M: Array, d: Array, S: Array, root: Array, residual: Array) -> Array:
    """The change of a bias with covariance ``D M D`` by a residual:
    ``D M (I + D W D M)^-1 D S' R^-1 residual``, with ``W = S' R^-1 S`` and ``D = diag(d)``.
    """
    # Y = S_1^-1 S with R = S_1 S_1', so that W = Y' Y.
    Y, p = solve_lower(root, S), d.shape[-1]
    # W D M is linear in d: a matrix (p p, p), which runs may share, times d.
    terms = (Y.mT @ Y)[..., :, None, :] * M.mT[..., None, :, :]
    WDM = matvec(terms.reshape(*terms.shape[:-3], p * p, p), d).reshape(*d.shape, p)
    white = d * matvec(Y.mT, whiten(root, residual))
    return d * matvec(M, np.linalg.solve(np.eye(p) + d[..., None] * WDM, white[..., None])[..., 0])


def _walked(first: Any, bias: Any, Lambda: Array, walk: Array) -> tuple[Any, Any, Array]:
    """First stage, bias and sensitivity after a random-walk step of the bias [Hsieh1999].

    The bias before the step is conditioned on the bias after it. The sensitivity explains one part
    of the old bias, and the rest becomes noise of the first stage.
    """
    form, eye = type(bias), np.eye(bias.mean.shape[-1])
    # The bias after the step acts as a measurement with noise Q_b and innovation 0, so no mean
    # changes.
    both = joint(LINEAR, bias, ((bias.mean, eye), KEEP), z=bias.mean, measurement_noise=walk)
    left, info, _ = condition(form, both, EUCLIDEAN, gain=partial(pseudo_gain, least=KNOWN))

    # Lambda' = Lambda G with G = M (M + Q_b)^+; P' = P + Lambda (M - G M) Lambda'.
    after, less = form(bias.mean, form.sum(bias[1], walk)), Lambda @ info.gain()
    belief = first.belief
    # The corrected state x + Lambda b does not change: x absorbs the change of Lambda.
    free = type(belief)(
        belief.mean + matvec(Lambda - less, bias.mean),
        type(belief).sum(belief[1], Lambda @ left.sqrt_cov),
    )
    return first._replace(belief=free), after, less
