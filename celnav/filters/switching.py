"""Several filters, one of which makes each step of a run. `Switching` chooses the filter before the
step; `Fallback` repeats the runs in which the first filter has failed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.joint import broadcast_belief
from celnav.filters.model import Motion
from celnav.filters.records import Epoch, Filter, Info, State
from celnav.filters.sequential import Sequential, require_sequential
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief, is_concretely_true
from celnav.tape.tape import CannotCompile

__all__ = ["Fallback", "Switching"]

Step = tuple[State, tuple[Info, ...]]
MERGED = ("innovation", "whitened", "used", "sqrt_S", "gain", "jacobian", "R")


# -- one filter in some runs, another in the rest --------------------------------------------------
def merged(mask: Array, chosen: Step, otherwise: Step) -> Step:
    """The step ``chosen`` in the runs where ``mask (...)`` is True, and ``otherwise`` in the rest;
    hooks keep the memory from ``otherwise``.
    """
    (state, infos), (other, others) = chosen, otherwise
    pairs = zip(state.belief, other.belief, strict=True)
    belief = type(other.belief)(*(_pick(mask, a, b) for a, b in pairs))
    return other._replace(belief=belief), tuple(
        _merged_info(mask, a, b) for a, b in zip(infos, others, strict=True)
    )


def _merged_info(mask: Array, info: Info, other: Info) -> Info:
    """The `Info` of both filters, run by run; gains and Jacobians are merged on demand."""

    def merge(name: str) -> Any:
        a, b = getattr(info, name), getattr(other, name)
        if a is None or b is None:
            return b
        return (lambda: _pick(mask, a(), b())) if callable(a) else _pick(mask, a, b)

    return other._replace(**{name: merge(name) for name in MERGED})


def _pick(mask: Array, chosen: Array, otherwise: Array) -> Array:
    """Arrays of runs ``(..., any axes)``: ``chosen`` where the mask is True, else ``otherwise``."""
    # The mask has axes of runs only: the axes of a vector or matrix follow them.
    rank = max(chosen.ndim - mask.ndim, 0)
    return np.where(mask.reshape(mask.shape + (1,) * rank), chosen, otherwise)


# -- chosen before a step --------------------------------------------------------------------------
class SwitchingState(NamedTuple):
    """State of a `Switching`; ``chosen (...)``: number of the filter that made the last step of
    each run, None before the first step.
    """

    belief: Any
    memory: tuple[Any, ...]
    chosen: Array | None = None


@dataclass(frozen=True, eq=False)
class Switching:
    """Several filters, one of which makes each step of a run; only mean and covariance pass from
    one filter to the next.

    filters: ``number ->`` filter; all with the same motion, sensors and form, with different rules,
        and without hooks. Filter 0 starts.
    choose: ``(belief, epoch, chosen) ->`` numbers ``(...)`` of the filters for a step, from the
        belief before the step; ``chosen``: the numbers of the previous step, None at the first.

    The step of a run equals its filter's step bit for bit. A step costs as much as all the filters
    chosen in at least one run.

    >>> filters = [celnav.ghkf(motion, gps), celnav.ekf(motion, gps)]
    >>> narrow = lambda belief, epoch, chosen: (belief.std[..., 0] < 0.1).astype(int)
    >>> filter = celnav.filters.switching.Switching(filters.__getitem__, narrow)
    >>> also = lambda epoch, state, infos: {"chosen": state.chosen}
    >>> track = celnav.run(filter, prior, times, z, also=also)
    """

    filters: Callable[[int], Filter]
    choose: Callable[[Any, Epoch, Array | None], Array]

    @property
    def motion(self) -> Any:
        """The motion of the filters, if they have one."""
        return getattr(self.filters(0), "motion", None)

    def start(self, prior: Gaussian) -> SwitchingState:

        state = self.filters(0).start(prior)
        return SwitchingState(broadcast_belief(type(state.belief), *state.belief), state.memory)

    def step(self, state: SwitchingState, epoch: Epoch) -> tuple[SwitchingState, tuple[Info, ...]]:

        if state.belief.mean.dtype.hasobject:
            raise CannotCompile("which filter makes a step is known only when it runs")
        chosen = np.asarray(self.choose(state.belief, epoch, state.chosen))
        if chosen.dtype.kind not in "iu" or not chosen.size or (chosen < 0).any():
            raise ValueError(
                "choose: expected whole numbers of filters, 0 or more, for each run, got "
                f"{chosen!r:.80}"
            )
        before = State(state.belief, state.memory)
        result: Any = None
        for number in np.unique(chosen).tolist():
            step = self.filters(number).step(before, epoch)
            if any(memory is not None for memory in step[0].memory):
                raise ValueError(
                    "filters: expected filters without hooks, whose memory would belong to one "
                    "filter only"
                )
            result = step if result is None else merged(chosen == number, step, result)
        after, infos = result
        numbers = np.broadcast_to(chosen, after.belief.mean.shape[:-1])
        return SwitchingState(after.belief, state.memory, numbers), infos


# -- repeated after a failure ----------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Fallback:
    """Repeat, with a second filter, the runs in which the first filter fails in a prediction or an
    update.

    first, second: filters with the same motion, sensors and hooks but different rules, for example
        one with negative weights and one without.

    The other runs keep the first filter's result bit for bit; hooks keep the memory from the first
    filter. `Info.redone` marks the repeated runs, and the `Track` counts them in
    ``events["redone"]``. A run fails if both filters fail.

    >>> grid, ckf = celnav.sparse_grid_filter(motion, sensor), celnav.ckf(motion, sensor)
    >>> filter = celnav.filters.switching.Fallback(grid, ckf)
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
                "second: expected a filter with the form and the number of sensors of the first"
            )

    @property
    def motion(self) -> Motion:
        """The motion of both filters."""
        return self.first.motion

    def start(self, prior: Gaussian) -> State:

        state = self.first.start(prior)
        # Single runs are repeated, so each run needs a covariance.
        return state._replace(belief=broadcast_belief(self.first.form, *state.belief))

    def step(self, state: State, epoch: Epoch) -> Step:

        (ahead, _), repredicted = self._repeated(
            state, lambda filter: (filter.predict(state, epoch), ())
        )
        (after, infos), updated_again = self._repeated(
            ahead, lambda filter: filter.update(ahead, epoch)
        )
        redone = repredicted | updated_again
        if not is_concretely_true(~redone.any()):
            first, *others = infos or (Info(),)
            infos = (first._replace(redone=redone), *others)
        return after, infos

    def _repeated(self, before: State, step: Callable[[Sequential], Step]) -> tuple[Step, Array]:
        """A step of the first filter, or of the second in runs where the first one fails, and the
        mask of these runs.
        """
        result = step(self.first)
        failed = _failed(result[0].belief)
        if not is_concretely_true(~failed.any()):
            failed = failed & ~_failed(before.belief)
        if not is_concretely_true(~failed.any()):
            result = merged(failed, step(self.second), result)
        return result, failed


def _failed(belief: Belief) -> Array:
    """Runs ``(...)`` whose belief is not finite or, in covariance form, not positive definite."""
    return np.asanyarray(
        ~(np.isfinite(belief.mean).all(-1) & np.isfinite(belief.sqrt_cov).all((-2, -1)))
    )
