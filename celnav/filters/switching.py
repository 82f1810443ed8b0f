"""Filters that alternate: before each step, a function chooses for each run which filter makes
it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.fallback import merged, pick
from celnav.filters.joint import broadcast_belief
from celnav.filters.records import Epoch, Filter, Info, State
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.tape.tape import CannotCompile

__all__ = ["Switching"]


class SwitchingState(NamedTuple):
    """State of a `Switching`; ``chosen (...)``: numbers of the filters of the last step, None
    before the first.
    """

    belief: Any
    memory: tuple[Any, ...]
    chosen: Array | None = None


@dataclass(frozen=True, eq=False)
class Switching:
    """Filters of which one makes each step of a run; only mean and covariance pass from one to the
    next.

    filters: ``number ->`` filter: of the same motion, sensors and form, with different rules and
        without hooks. Number 0 starts.
    choose: ``(belief, epoch, chosen) ->`` numbers ``(...)`` of the filters for a step, from the
        belief before it; ``chosen``: the numbers of the previous step, None at the first.

    The step of a run is bit for bit that of its filter. A step costs as much as all the filters
    chosen by at least one run.

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
        """The filters' own, if they have one."""
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
        belief: Any = None
        infos: tuple[Info, ...] = ()
        for number in np.unique(chosen).tolist():
            after, more = self.filters(number).step(State(state.belief, state.memory), epoch)
            if any(memory is not None for memory in after.memory):
                raise ValueError(
                    "filters: expected filters without hooks, whose memory would be of one filter "
                    "only"
                )
            if belief is None:
                belief, infos = after.belief, more
            else:
                mask = chosen == number
                belief = type(belief)(
                    *(pick(mask, b, a) for a, b in zip(belief, after.belief, strict=True))
                )
                infos = tuple(merged(mask, a, b) for a, b in zip(infos, more, strict=True))
        return SwitchingState(
            belief, state.memory, np.broadcast_to(chosen, belief.mean.shape[:-1])
        ), infos
