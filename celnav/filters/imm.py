"""Interacting multiple models: a filter for a system that switches between several models
[Blom1988].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.records import Epoch, Info
from celnav.filters.sequential import is_zero_interval
from celnav.gaussian.belief import Gaussian, mask_failed
from celnav.gaussian.checks import describe, finite, sequence
from celnav.gaussian.linalg import Array, Belief, SquareRoot, whiten
from celnav.gaussian.spaces import EUCLIDEAN, Space

__all__ = ["imm"]
LEAST = -float(np.finfo(float).max)  # finite in place of -inf, because -inf - -inf is nan


class ImmState(NamedTuple):
    """The belief of the mixture, logarithms of the models' probabilities ``(..., k)``, and the
    state of each model's filter.
    """

    belief: Any
    log_probabilities: Array
    states: tuple[Any, ...]

    @property
    def probabilities(self) -> Array:
        """Probability of each model ``(..., k)`` given the measurements so far."""
        return np.asanyarray(np.exp(self.log_probabilities))


@dataclass(frozen=True, eq=False)
class InteractingModels:
    """The filter of `imm`; it takes its space and sensors from the first model."""

    filters: tuple[Any, ...]
    log_transition: Array = field(repr=False)
    log_initial: Array = field(repr=False)

    @property
    def motion(self) -> Any:
        return self.filters[0].motion

    @property
    def sensors(self) -> Any:
        return getattr(self.filters[0], "sensors", ())

    def start(self, prior: Gaussian | Sequence[Gaussian]) -> ImmState:
        """State before the first epoch, from one prior, or from one for each model."""
        priors = (
            prior
            if isinstance(prior, list | tuple) and not hasattr(prior, "mean")
            else [prior] * len(self.filters)
        )
        if len(priors) != len(self.filters):
            raise ValueError(
                f"prior: expected one Gaussian, or one for each of {len(self.filters)} models, got "
                f"{len(priors)}"
            )
        states = tuple(
            filter.start(belief) for filter, belief in zip(self.filters, priors, strict=True)
        )
        if not all("belief" in getattr(state, "_fields", ()) for state in states):
            raise ValueError(
                "filters: expected filters whose state has a belief that can be replaced, "
                "such as celnav.ukf"
            )
        if (
            len(
                {
                    (type(state.belief), state.belief.mean.shape[-1], state.belief[1].shape[-1])
                    for state in states
                }
            )
            > 1
        ):
            raise ValueError(
                "filters: expected filters with the same state and the same form of covariance"
            )
        return self._state(states, self.log_initial)

    def step(self, state: ImmState, epoch: Epoch) -> tuple[ImmState, tuple[Info, ...]]:
        """State after an epoch, and an `Info` of each sensor; the system may switch models at the
        start of an interval.
        """
        # Predicted probabilities w_j' = sum_i w_i p_ij and mixing weights mu_ij = w_i p_ij / w_j',
        # in logarithms.
        weights, states = state.log_probabilities, state.states
        if not is_zero_interval(epoch):
            stay, chances = np.where(np.eye(len(states)), 0.0, -np.inf), self.log_transition
            if not isinstance(epoch.dt, float):  # some runs may have an interval of length 0
                chances = np.where(np.equal(epoch.dt, 0.0)[..., None, None], stay, chances)
            both = weights[..., :, None] + chances  # (..., i, j)
            ahead = _total(both, -2)[..., None, :]
            # A model that cannot be reached has probability 0: its mixture has no influence, but
            # must be finite.
            mu = np.exp(
                np.where(ahead == -np.inf, weights[..., :, None], both - np.maximum(ahead, LEAST))
            )
            beliefs = [before.belief for before in states]
            states = tuple(
                before._replace(belief=mixed(self.motion.space, beliefs, mu[..., j]))
                for j, before in enumerate(states)
            )
            weights = ahead[..., 0, :]
        # The filter of each model steps from its mixture of all beliefs.
        stepped = [
            filter.step(before, epoch) for filter, before in zip(self.filters, states, strict=True)
        ]
        infos = []
        for sensor_infos in zip(*(model_infos for _, model_infos in stepped), strict=True):
            info, weights = _weighed(sensor_infos, weights)
            infos.append(info)
        return self._state(
            tuple(after._replace(belief=mask_failed(after.belief)) for after, _ in stepped), weights
        ), tuple(infos)

    def _state(self, states: tuple[Any, ...], weights: Array) -> ImmState:
        belief = mixed(self.motion.space, [state.belief for state in states], np.exp(weights))
        return ImmState(
            belief, np.broadcast_to(weights, (*belief.mean.shape[:-1], len(states))), states
        )


def mixed(space: Space, beliefs: Sequence[Belief], weights: Array) -> Belief:
    """The Gaussian with mean and covariance of a mixture with ``weights (..., k)`` [Blom1988]."""
    mean, form, curved = beliefs[0].mean, type(beliefs[0]), space.transport
    # On a curved space the weighted differences from the mean sum to zero: iterate for the mean.
    for _ in range(1 if space is EUCLIDEAN else 3):
        # (..., n, k): the difference of each model's mean from the mixture's mean, in columns.
        deviations = np.stack(
            np.broadcast_arrays(*(space.minus(belief.mean, mean) for belief in beliefs)), -1
        )
        shift = np.add.reduce(deviations * weights[..., None, :], -1)
        mean = space.plus(mean, shift)
    factors = [
        belief[1]
        if curved is None
        else form.transported(curved(space.minus(mean, belief.mean)), belief[1])
        for belief in beliefs
    ]
    # P = sum_i w_i (P_i + d_i d_i') with d_i = x_i - x.
    return form(
        mean,
        form.mixed(
            factors, weights, (deviations - shift[..., None]) * np.sqrt(weights)[..., None, :]
        ),
    )


def _weighed(infos: Sequence[Any], weights: Array) -> tuple[Info, Array]:
    """The `Info` of a sensor for the mixture, and the log-probabilities ``(..., k)`` of the models
    after the update.
    """
    # w_i+ = w_i p(z | i) / sum_j w_j p(z | j), in logarithms; density = log p(z).
    if any(info.sqrt_S is None for info in infos):
        return infos[0], weights
    both = weights + np.stack(np.broadcast_arrays(*(info.log_likelihood for info in infos)), -1)
    density, mu = _total(both, -1), np.exp(weights)
    # A component is used if every model uses it.
    used = reduce(np.logical_and, [info.used for info in infos])
    y = np.stack(np.broadcast_arrays(*(info.innovation for info in infos)), -1)
    innovation = np.add.reduce(y * mu[..., None, :], -1)
    # (..., m, k): columns of the covariance between the models' predictions.
    apart = np.where(used[..., None], y - innovation[..., None], 0.0) * np.sqrt(mu)[..., None, :]
    S = SquareRoot.mixed(
        [np.where(used[..., None], info.sqrt_S, np.eye(used.shape[-1])) for info in infos],
        mu,
        apart,
    )
    redone = reduce(
        lambda a, b: a if b is None else b if a is None else a | b, [info.redone for info in infos]
    )
    info = Info(
        innovation,
        whiten(S, np.where(used, innovation, 0.0)),
        used,
        S,
        redone=redone,
        mixture=density,
    )
    return info, both - density[..., None]


def _total(x: Array, axis: int) -> Array:
    """Logarithm of a sum of exponentials along an axis, scaled by the largest term to avoid
    underflow.
    """
    # If all terms are -inf, LEAST is subtracted instead, because -inf - -inf is nan.
    most = np.maximum(np.maximum.reduce(x, axis, keepdims=True), LEAST)
    with np.errstate(divide="ignore"):
        return np.asanyarray(
            np.log(np.add.reduce(np.exp(x - most), axis)) + np.add.reduce(most, axis)
        )


def imm(
    filters: Sequence[Any], transition: ArrayLike, *, initial: ArrayLike | None = None
) -> InteractingModels:
    """A filter for several models that alternate as a Markov chain [Blom1988].

    filters: one for each model, such as `celnav.ukf`, with the same state, sensors and form. Hooks
        that leave measurements out must do so for all models alike, because likelihoods are
        compared.
    transition: ``(k, k)``; element ``[i, j]`` is the probability that model j follows model i from
        one epoch to the next, and each row sums to 1. Over an interval of length 0 the model does
        not change.
    initial: ``(k,)``, the probabilities before the first epoch; None: all equal.

    The prior may be a list with one Gaussian for each model. Mean, covariance, innovation and NIS
    come from the moments of the mixture; the likelihood is the exact mixture density.
    ``state.probabilities (..., k)`` are the probabilities of the models; ``also`` stores them in a
    `Track`. A run fails if the filter of any model fails. ValueError names an invalid argument.

    >>> models = [celnav.ukf(cruise, radar), celnav.ukf(turn, radar)]
    >>> filter = celnav.imm(models, [[0.95, 0.05], [0.1, 0.9]])
    >>> also = lambda epoch, state, infos: {"probabilities": state.probabilities}
    >>> track = celnav.run(filter, prior, times, z, also=also)
    """
    example = "[celnav.ukf(cruise, radar), celnav.ukf(turn, radar)]"
    models = tuple(sequence("filters", filters, example, 1))
    k, verbs = len(models), ("start", "step", "motion")
    wrong = [model for model in models if not all(hasattr(model, verb) for verb in verbs)]
    if wrong:
        raise ValueError(
            "filters: expected filters, such as celnav.ukf(motion, sensor), got "
            f"{describe(wrong[0])}"
        )
    chances = finite("transition", transition, (k, k))
    first = np.full(k, 1.0 / k) if initial is None else finite("initial", initial, (k,))
    for name, p in (("transition", chances), ("initial", first)):
        if (p < 0.0).any() or np.abs(p.sum(-1) - 1.0).max() > 1e-9:
            raise ValueError(
                f"{name}: expected probabilities that sum to 1 in each row, got {p.tolist()}"
            )
    with np.errstate(divide="ignore"):
        return InteractingModels(models, np.log(chances), np.log(first))
