"""A second filter for the runs in which the first one fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from celnav.filters.joint import broadcast_belief
from celnav.filters.model import Motion
from celnav.filters.records import Epoch, Info, State
from celnav.filters.sequential import Sequential, require_sequential
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief, is_concretely_true

__all__ = ["Fallback"]

Step = tuple[State, tuple[Info, ...]]


@dataclass(frozen=True, eq=False)
class Fallback:
    """Repeats, with a second filter, the runs in which the first one fails in a prediction or an
    update.

    ``first``, ``second``: filters of the same motion, sensors and hooks with different rules, for
    example one with negative weights and one without. The other runs keep the first filter's result
    bit for bit, and the memory of hooks is the first one's. `Info.redone` marks the repeated runs,
    and the `Track` counts them in ``events["redone"]``. A run fails if both filters fail.

    >>> filter = Fallback(celnav.sparse_grid_filter(motion, sensor), celnav.ckf(motion, sensor))
    """

    first: Sequential
    second: Sequential

    def __post_init__(self) -> None:
        require_sequential("first", self.first)
        require_sequential("second", self.second)
        if self.first.form is not self.second.form or len(self.first.sensors) != len(
            self.second.sensors
        ):
            raise ValueError(
                "second: expected a filter of the same form and as many sensors as the first"
            )

    @property
    def motion(self) -> Motion:
        """The motion of both filters."""
        return self.first.motion

    def start(self, prior: Gaussian) -> State:

        state = self.first.start(prior)
        # Runs are repeated one by one, so each needs its own covariance.
        return state._replace(belief=broadcast_belief(self.first.form, *state.belief))

    def step(self, state: State, epoch: Epoch) -> Step:

        ahead, _, moved = self._done(state, lambda filter: (filter.predict(state, epoch), ()))
        after, infos, updated = self._done(ahead, lambda filter: filter.update(ahead, epoch))
        redone = moved | updated
        if not is_concretely_true(~redone.any()):
            infos = (
                (infos[0]._replace(redone=redone), *infos[1:]) if infos else (Info(redone=redone),)
            )
        return after, infos

    def _done(
        self, before: State, step: Callable[[Sequential], Step]
    ) -> tuple[State, tuple[Info, ...], Array]:
        """A step of the first filter, or of the second in runs where the first one fails, and the
        mask of these runs.
        """
        after, infos = step(self.first)
        lost = _unsound(after.belief)
        if not is_concretely_true(~lost.any()):
            lost = lost & ~_unsound(before.belief)
        if not is_concretely_true(~lost.any()):
            other, others = step(self.second)
            belief = self.first.form(
                *(pick(lost, b, a) for a, b in zip(after.belief, other.belief, strict=True))
            )
            after, infos = (
                after._replace(belief=belief),
                tuple(merged(lost, a, b) for a, b in zip(infos, others, strict=True)),
            )
        return after, infos, lost


def _unsound(belief: Belief) -> Array:
    """Runs ``(...)`` whose belief is not finite or, in covariance form too, not definite."""
    return np.asanyarray(
        ~(np.isfinite(belief.mean).all(-1) & np.isfinite(belief.sqrt_cov).all((-2, -1)))
    )


def pick(where: Array, chosen: Array, otherwise: Array) -> Array:
    """Arrays of runs ``(..., any axes)``: ``chosen`` where ``where (...)``, else ``otherwise``."""
    rank = max(chosen.ndim - where.ndim, 0)
    return np.where(where.reshape(where.shape + (1,) * rank), chosen, otherwise)


def merged(lost: Array, info: Info, other: Info) -> Info:
    """The `Info` of both filters, run by run; gains and Jacobians are merged on demand."""

    def merge(name: str) -> Any:
        first, second = getattr(info, name), getattr(other, name)
        if first is None or second is None:
            return first
        return (
            (lambda: pick(lost, second(), first()))
            if callable(first)
            else pick(lost, second, first)
        )

    return info._replace(
        **{
            name: merge(name)
            for name in ("innovation", "whitened", "used", "sqrt_S", "gain", "jacobian", "R")
        }
    )
