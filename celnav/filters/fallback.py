"""A second filter for the runs that the first one loses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from celnav.filters.model import Motion
from celnav.filters.records import Epoch, Info, State
from celnav.filters.sequential import Sequential, plain
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief


@dataclass(frozen=True, eq=False)
class Fallback:
    """Does again, with a second filter, those runs which the first one loses in a prediction or an update.

    Attributes
    ----------
    first, second: filters of the same motion and sensors with different rules: one of negative weights, say, and one without. Hooks
        must be the same; their memory is that of the first. The other runs keep the first one's result bit for bit.

    `Info.redone` says which runs were done again, and the `Track` counts them in ``events["redone"]``. A run that both lose stays
    lost.
    """

    first: Sequential
    second: Sequential

    def __post_init__(self) -> None:
        plain("first", self.first)
        plain("second", self.second)
        if self.first.form is not self.second.form or len(self.first.sensors) != len(self.second.sensors):
            raise ValueError("second: expected a filter of the same form and as many sensors as the first")

    @property
    def motion(self) -> Motion:
        """Of both filters."""
        return self.first.motion

    def start(self, prior: Gaussian) -> State:
        """State before the first epoch."""
        return self.first.start(prior)

    def step(self, state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        """State after an epoch, and what each sensor did to it."""
        ahead, redone, _ = self._done(state, self.first.predict(state, epoch), lambda: (self.second.predict(state, epoch), ()), ())
        after, infos = self.first.update(ahead, epoch)
        after, again, infos = self._done(ahead, after, lambda: self.second.update(ahead, epoch), infos)
        if redone is not None or again is not None:
            both = np.logical_or(False if redone is None else redone, False if again is None else again)
            infos = (infos[0]._replace(redone=both), *infos[1:]) if infos else (Info(redone=both),)
        return after, infos

    def _done(
        self, before: State, after: State, again: Callable[[], tuple[State, tuple[Info, ...]]], infos: tuple[Info, ...]
    ) -> tuple[State, Array | None, tuple[Info, ...]]:
        if not _unsound(after.belief).any():
            return after, None, infos
        lost = _unsound(after.belief) & ~_unsound(before.belief)
        if not lost.any():
            return after, None, infos
        other, others = again()
        belief = self.first.form(*(_pick(lost, b, a) for a, b in zip(after.belief, other.belief, strict=True)))
        return after._replace(belief=belief), lost, tuple(_merged(lost, a, b) for a, b in zip(infos, others, strict=True))


def _unsound(belief: Belief) -> Array:
    """Runs ``(...)`` whose belief is not finite or, in covariance form too, not definite."""
    root = belief.sqrt_cov
    return np.asarray(~(np.isfinite(belief.mean).all(-1) & np.isfinite(root).all((-2, -1))))


def _pick(where: Array, chosen: Array, otherwise: Array) -> Array:
    rank = max(chosen.ndim - where.ndim, 0)
    return np.where(where.reshape(where.shape + (1,) * rank), chosen, otherwise)


def _merged(lost: Array, info: Info, other: Info) -> Info:
    """What was done, run by run; gains and Jacobians are merged when asked for."""
    if info.innovation is None or other.innovation is None:
        return info
    arrays: dict[str, Any] = {
        name: _pick(lost, getattr(other, name), getattr(info, name)) for name in ("innovation", "whitened", "used")
    }
    if info.sqrt_S is not None and other.sqrt_S is not None:
        arrays["sqrt_S"] = _pick(lost, other.sqrt_S, info.sqrt_S)
    later: dict[str, Any] = {
        name: partial(_merged_later, lost, getattr(info, name), getattr(other, name)) for name in ("gain", "jacobian")
    }
    return info._replace(**arrays, **later)


def _merged_later(lost: Array, mine: Callable[[], Array], theirs: Callable[[], Array]) -> Array:
    return _pick(lost, theirs(), mine())
