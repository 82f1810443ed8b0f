"""Interacting multiple models: a system that switches between models, of which one holds at a time
[Blom1988].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.records import Epoch, Info, is_zero_interval
from celnav.gaussian.belief import Gaussian, mask_failed
from celnav.gaussian.checks import describe, finite, sequence
from celnav.gaussian.linalg import Array, Belief, SquareRoot, whiten
from celnav.gaussian.spaces import EUCLIDEAN, Space

__all__ = ["imm"]
LEAST = -float(np.finfo(float).max)  # what can be taken off minus infinity


class ImmState(NamedTuple):
    """The belief of all models together, logarithms of their probabilities ``(..., k)``, and the
    state of each model's filter.
    """

    belief: Any
    log_probabilities: Array
    states: tuple[Any, ...]

    @property
    def probabilities(self) -> Array:
        """Probability of each model ``(..., k)``, given what was measured so far."""
        return np.asanyarray(np.exp(self.log_probabilities))


@dataclass(frozen=True, eq=False)
class InteractingModels:
    """What `imm` makes; space and sensors are those of the first model."""

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
        """State before the first epoch, of one prior, or of one for each model."""
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
        states = tuple(filter.start(own) for filter, own in zip(self.filters, priors, strict=True))
        if not all("belief" in getattr(one, "_fields", ()) for one in states):
            raise ValueError(
                "filters: expected states with a belief that can be replaced, as those of "
                "celnav.ukf have"
            )
        if (
            len(
                {
                    (type(one.belief), one.belief.mean.shape[-1], one.belief[1].shape[-1])
                    for one in states
                }
            )
            > 1
        ):
            raise ValueError(
                "filters: expected models of the same state, and filters of the same form"
            )
        return self._state(states, self.log_initial)

    def step(self, state: ImmState, epoch: Epoch) -> tuple[ImmState, tuple[Info, ...]]:
        """State after an epoch, and what each sensor did to it; models take turns at the beginning
        of an interval.
        """
        weights, states = state.log_probabilities, state.states
        if not is_zero_interval(epoch):
            stay, chances = np.where(np.eye(len(states)), 0.0, -np.inf), self.log_transition
            if not isinstance(epoch.dt, float):  # of some runs it may be nothing
                chances = np.where(np.equal(epoch.dt, 0.0)[..., None, None], stay, chances)
            both = weights[..., :, None] + chances
            ahead = _total(both, -2)[..., None, :]
            # What no model leads to has no weight: any estimate will do for it.
            mu = np.exp(
                np.where(ahead == -np.inf, weights[..., :, None], both - np.maximum(ahead, LEAST))
            )
            beliefs = [one.belief for one in states]
            states = tuple(
                one._replace(belief=mixed(self.motion.space, beliefs, mu[..., j]))
                for j, one in enumerate(states)
            )
            weights = ahead[..., 0, :]
        stepped = [
            filter.step(one, epoch) for filter, one in zip(self.filters, states, strict=True)
        ]
        infos = []
        for each in zip(*(own for _, own in stepped), strict=True):
            info, weights = _weighed(each, weights)
            infos.append(info)
        return self._state(
            tuple(one._replace(belief=mask_failed(one.belief)) for one, _ in stepped), weights
        ), tuple(infos)

    def _state(self, states: tuple[Any, ...], weights: Array) -> ImmState:
        belief = mixed(self.motion.space, [one.belief for one in states], np.exp(weights))
        return ImmState(
            belief, np.broadcast_to(weights, (*belief.mean.shape[:-1], len(states))), states
        )


def mixed(space: Space, beliefs: Sequence[Belief], weights: Array) -> Belief:
    """The belief with mean and covariance of a mixture by ``weights (..., k)`` [Blom1988]."""
    mean, form, curved = beliefs[0].mean, type(beliefs[0]), space.transport
    for _ in range(
        1 if space is EUCLIDEAN else 3
    ):  # on a curved space the mean is where differences cancel
        way = np.stack(np.broadcast_arrays(*(space.minus(one.mean, mean) for one in beliefs)), -1)
        shift = np.add.reduce(way * weights[..., None, :], -1)
        mean = space.plus(mean, shift)
    spreads = [
        one[1] if curved is None else form.transported(curved(space.minus(mean, one.mean)), one[1])
        for one in beliefs
    ]
    return form(
        mean,
        form.mixed(spreads, weights, (way - shift[..., None]) * np.sqrt(weights)[..., None, :]),
    )


def _weighed(infos: Sequence[Any], weights: Array) -> tuple[Info, Array]:
    """What a sensor did to all models together, with innovation and covariance of their mixture,
    and their weights after it.
    """
    if any(info.sqrt_S is None for info in infos):
        return infos[0], weights
    both = weights + np.stack(np.broadcast_arrays(*(info.log_likelihood for info in infos)), -1)
    density, mu = _total(both, -1), np.exp(weights)
    used = reduce(np.logical_and, [info.used for info in infos])
    seen = np.stack(np.broadcast_arrays(*(info.innovation for info in infos)), -1)
    innovation = np.add.reduce(seen * mu[..., None, :], -1)
    apart = np.where(used[..., None], seen - innovation[..., None], 0.0) * np.sqrt(mu)[..., None, :]
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
    """Logarithm of the sum of exponentials, of which the largest cannot underflow."""
    most = np.maximum(np.maximum.reduce(x, axis, keepdims=True), LEAST)
    with np.errstate(divide="ignore"):
        return np.asanyarray(
            np.log(np.add.reduce(np.exp(x - most), axis)) + np.add.reduce(most, axis)
        )


def imm(
    filters: Sequence[Any], transition: ArrayLike, *, initial: ArrayLike | None = None
) -> InteractingModels:
    """A filter of several models that take turns as a Markov chain [Blom1988].

    filters: one for each model, such as `celnav.ukf`, of the same state and sensors and of one
        form. Hooks that leave measurements out are to do so for all models alike, since likelihoods
        are compared.
    transition: ``(k, k)``, ``[i, j]`` the probability that model j follows model i from one epoch
        to the next; rows sum to 1. Over an interval of no length models stay.
    initial: ``(k,)``, probabilities before the first epoch; None: all alike.

    The prior may be a list of one for each model. Mean and covariance are moments of the mixture,
    so are innovation and NIS; the likelihood is its own. ``state.probabilities (..., k)`` are those
    of the models, and ``also`` brings them into a `Track`. A run is lost when one of its models is.
    ValueError names an argument that cannot be meant.

    >>> models = [celnav.ukf(cruise, radar), celnav.ukf(turn, radar)]
    >>> filter = celnav.imm(models, [[0.95, 0.05], [0.1, 0.9]])
    >>> also = lambda epoch, state, infos: {"probabilities": state.probabilities}
    >>> track = celnav.run(filter, prior, times, z, also=also)
    """
    made = tuple(
        sequence("filters", filters, "[celnav.ukf(cruise, radar), celnav.ukf(turn, radar)]", 1)
    )
    k, wrong = (
        len(made),
        [
            one
            for one in made
            if not all(hasattr(one, name) for name in ("start", "step", "motion"))
        ],
    )
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
        return InteractingModels(made, np.log(chances), np.log(first))
