"""A filter that keeps its last epochs: samples may come late, and the recent past can be smoothed.

A late sample goes back to its epoch, and the filter flies again from there: it ends where it would
have ended with the sample on time. (Formulas of linear models [BarShalom2002] spare the flight.)
`celnav.smooth` of what is kept is a fixed-lag one [Moore1973].
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.records import Epoch, Filter, Info
from celnav.filters.track import KEEP, Collector, Track
from celnav.gaussian.belief import Gaussian, mask_failed
from celnav.gaussian.checks import broadcast_batches, describe, instance, integer, numbers
from celnav.gaussian.linalg import Array, Belief

__all__ = ["FixedLag"]
MOST_KEPT = 1_000_000


class FixedLagState(NamedTuple):
    """State of a `FixedLag`: states of its filter before and after each of the epochs kept, these
    epochs, and what each did.
    """

    states: tuple[Any, ...]
    epochs: tuple[Epoch, ...] = ()
    infos: tuple[tuple[Info, ...], ...] = ()

    @property
    def belief(self) -> Belief:
        """The present one."""
        return self.states[-1].belief  # type: ignore[no-any-return]


@dataclass(frozen=True, eq=False)
class FixedLag:
    """A filter that keeps its last ``lag`` epochs and the present one, with their measurements and
    states.

    filter: any filter; what it gives is not changed. lag: how many epochs a sample may be late, and
        how many are smoothed.

    A step costs what the filter's does; a late sample a step for each epoch since its own. It holds
    ``lag + 2`` states. Epochs are numbered on, as those of `celnav.epochs` are. Of
    `celnav.compiled(filter)` steps are machine code.

    >>> filter = celnav.filters.fixed_lag.FixedLag(celnav.ukf(motion, gps, camera), lag=20)
    >>> state = filter.start(prior)
    >>> for epoch in celnav.epochs(times, (z, pictures)):
    ...     state, infos = filter.step(state, epoch)
    >>> state, infos = filter.late(state, epoch.k - 12, (None, picture))  # 12 epochs late
    >>> smoothed = celnav.smooth(filter.track(state))  # the last 21 epochs
    """

    filter: Filter
    lag: int

    def __post_init__(self) -> None:
        if isinstance(self.filter, type) or not (
            hasattr(self.filter, "start") and hasattr(self.filter, "step")
        ):
            raise ValueError(
                "filter: expected a filter, such as celnav.ukf(motion, sensor), got "
                f"{describe(self.filter)}"
            )
        object.__setattr__(self, "lag", integer("lag", self.lag, 0, MOST_KEPT))

    @property
    def motion(self) -> Any:
        """The filter's own `Motion`; None if it has none."""
        return getattr(self.filter, "motion", None)

    def start(self, prior: Gaussian) -> FixedLagState:
        """State before the first epoch."""
        return FixedLagState((self.filter.start(prior),))

    def step(self, state: FixedLagState, epoch: Epoch) -> tuple[FixedLagState, tuple[Info, ...]]:
        """State after an epoch, and an `Info` of each sensor."""
        instance("state", state, FixedLagState, "what the filter's start(prior) or last step gave")
        if state.belief.mean.dtype.hasobject:
            after, infos = self.filter.step(
                state.states[-1], epoch
            )  # nobody sees the states of a compiled flight: none are kept
            return FixedLagState((after,)), infos
        given = instance("epoch", epoch, Epoch, "a record of celnav.Epoch")
        epoch = given._replace(
            u=_copied(given.u), z=_copied(given.z)
        )  # buffers may be filled again
        if state.epochs and epoch.k != (expected := state.epochs[-1].k + 1):
            raise ValueError(
                f"epoch: expected one with k = {expected}, after the last, got {epoch!r:.80}"
            )
        after, infos = self.filter.step(state.states[-1], epoch)
        if not hasattr(self.filter, "run") and "belief" in getattr(after, "_fields", ()):
            after = after._replace(belief=mask_failed(after.belief))  # as `celnav.run` goes on
        count = self.lag + 1
        return FixedLagState(
            (*state.states, after)[-count - 1 :],
            (*state.epochs, epoch)[-count:],
            (*state.infos, infos)[-count:],
        ), infos

    def late(self, state: FixedLagState, k: Any, z: Any) -> tuple[FixedLagState, tuple[Info, ...]]:
        """State as if a sample had come on time, and what the sensors did to it in the present
        epoch.

        k: index of the epoch of the sample, ``epoch.k``; of runs whose samples are of different
            epochs ``(...)``.
        z: measurement ``(..., m)``, or a tuple of them, one for each sensor; nan or None where
            nothing has come.

        ValueError if an epoch is not kept any more, or has a measurement of that component already.
        """
        instance("state", state, FixedLagState, "what the filter's last step gave")
        at = numbers("k", k)
        parts = [
            None if part is None else numbers("z", part, (..., "m"))
            for part in (z if isinstance(z, tuple) else (z,))
        ]
        come = np.zeros(at.shape, bool)
        for part in (part for part in parts if part is not None):
            if np.isinf(part).any():
                raise ValueError("z: expected finite numbers or nan, got an infinite one")
            broadcast_batches("z", part.shape[:-1], at.shape, "k")
            come = come | ~np.isnan(part).all(-1)
        kept = [epoch.k for epoch in state.epochs]
        beyond = come & ~np.isin(at, kept)
        if beyond.any():
            span = (
                f"an epoch that is kept, {kept[0]} to {kept[-1]} (lag = {self.lag})"
                if kept
                else "none before the first step"
            )
            raise ValueError(
                f"k: expected {span}, got {np.broadcast_to(at, beyond.shape)[beyond][0]:g}"
            )
        epochs = [_filled(epoch, parts, at == epoch.k) for epoch in state.epochs]
        first = next(
            (
                i
                for i, (old, new) in enumerate(zip(state.epochs, epochs, strict=True))
                if new is not old
            ),
            len(epochs),
        )
        held = FixedLagState(state.states[: first + 1], state.epochs[:first], state.infos[:first])
        for epoch in epochs[first:]:
            held, _ = self.step(held, epoch)
        return held, held.infos[-1] if held.infos else ()

    def track(self, state: FixedLagState) -> Track:
        """The `Track` of the epochs kept, late samples included; `celnav.smooth` of it begins with
        the fixed-lag estimate.
        """
        if not instance("state", state, FixedLagState, "what the filter's last step gave").epochs:
            raise ValueError("state: expected one after a step, got one before the first")
        collector = Collector(1, KEEP["cov"])
        for after, epoch, infos in zip(state.states[1:], state.epochs, state.infos, strict=True):
            collector.add(epoch, after.belief, infos, {})
        return collector.track(
            None, getattr(self.filter, "filter", self.filter)
        )  # that which was compiled


def _copied(x: Any) -> Any:
    """The same numbers, in memory of their own."""
    if x is None or isinstance(x, float | int):
        return x
    if type(x) is np.ndarray:
        return x.copy()
    return tuple(map(_copied, x)) if type(x) is tuple else deepcopy(x)


def _filled(epoch: Epoch, late: list[Array | None], here: Any) -> Epoch:
    """The epoch with late measurements where they belong; the same one if none does."""
    z = (
        epoch.z
        if isinstance(epoch.z, tuple)
        else (None,) * len(late)
        if epoch.z is None
        else (epoch.z,)
    )
    if len(z) != len(late):
        raise ValueError(f"z: expected {len(z)} measurements, one for each sensor, got {len(late)}")
    parts = tuple(_both(known, part, here, epoch.k) for known, part in zip(z, late, strict=True))
    if all(part is known for part, known in zip(parts, z, strict=True)):
        return epoch
    return epoch._replace(z=parts if len(parts) > 1 or isinstance(epoch.z, tuple) else parts[0])


def _both(known: Any, late: Array | None, here: Any, k: int) -> Any:
    """What was measured on time and what came late, of one sensor."""
    if late is None or np.isnan(new := np.where(here[..., None], late, np.nan)).all():
        return known
    if known is None:
        return new
    new, known = numbers("z", new, (..., known.shape[-1])), numbers("z", known)
    broadcast_batches("z", new.shape[:-1], known.shape[:-1], f"epoch {k}")
    twice = ~(np.isnan(known) | np.isnan(new))
    if twice.any():
        which = ", ".join(str(int(i)) for i in np.argwhere(twice)[0])
        raise ValueError(
            f"z: expected what epoch {k} does not have yet, got component [{which}] a second time; "
            "make it nan"
        )
    return np.where(np.isnan(new), known, new)
