"""A filter that stores its last epochs: samples may arrive late, and the recent past can be
smoothed.

A late sample is assigned to its epoch, and the filter runs again from there. The result equals the
result with the sample on time. (Formulas for linear models [BarShalom2002] avoid the second run.)
`celnav.smooth` over the stored epochs is a fixed-lag smoother [Moore1973].
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
    """State of a `FixedLag`: the states of its filter before and after each stored epoch, these
    epochs, and their `Info` records.
    """

    states: tuple[Any, ...]
    epochs: tuple[Epoch, ...] = ()
    infos: tuple[tuple[Info, ...], ...] = ()

    @property
    def belief(self) -> Belief:
        """The present belief."""
        return self.states[-1].belief  # type: ignore[no-any-return]


@dataclass(frozen=True, eq=False)
class FixedLag:
    """A filter that stores its last ``lag`` epochs and the present one, with their measurements and
    states.

    filter: any filter; its results do not change. lag: how many epochs a sample may be late, and
        how many are smoothed.

    A step costs one step of the filter. A late sample costs one step for each epoch from its own to
    the present. The state stores ``lag + 2`` states of the filter. Epochs must be numbered
    consecutively, as from `celnav.epochs`. With `celnav.compiled(filter)` the steps run as machine
    code.

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
        """The `Motion` of the filter; None if it has none."""
        return getattr(self.filter, "motion", None)

    def start(self, prior: Gaussian) -> FixedLagState:
        """State before the first epoch, from the prior."""
        return FixedLagState((self.filter.start(prior),))

    def step(self, state: FixedLagState, epoch: Epoch) -> tuple[FixedLagState, tuple[Info, ...]]:
        """State after an epoch, and an `Info` of each sensor."""
        instance("state", state, FixedLagState, "what the filter's start(prior) or last step gave")
        if state.belief.mean.dtype.hasobject:
            # A compiled run stores no intermediate states.
            after, infos = self.filter.step(state.states[-1], epoch)
            return FixedLagState((after,)), infos
        checked = instance("epoch", epoch, Epoch, "a record of celnav.Epoch")
        # The caller may fill its buffers again.
        epoch = checked._replace(u=_copied(checked.u), z=_copied(checked.z))
        if state.epochs and epoch.k != (expected := state.epochs[-1].k + 1):
            raise ValueError(
                f"epoch: expected k = {expected}, after the last epoch, got {epoch!r:.80}"
            )
        after, infos = self.filter.step(state.states[-1], epoch)
        if not hasattr(self.filter, "run") and "belief" in getattr(after, "_fields", ()):
            after = after._replace(belief=mask_failed(after.belief))  # as `celnav.run` does
        count = self.lag + 1
        return FixedLagState(
            (*state.states, after)[-count - 1 :],
            (*state.epochs, epoch)[-count:],
            (*state.infos, infos)[-count:],
        ), infos

    def late(self, state: FixedLagState, k: Any, z: Any) -> tuple[FixedLagState, tuple[Info, ...]]:
        """State as if a late sample had been on time, and the `Info` of each sensor at the present
        epoch.

        k: index ``epoch.k`` of the sample's epoch; ``(...)`` if it differs between runs.
        z: measurement ``(..., m)``, or a tuple of them, one for each sensor; nan or None where
            there is no sample.

        ValueError if the epoch is no longer stored, or already has a measurement of that component.
        """
        instance("state", state, FixedLagState, "what the filter's last step gave")
        at = numbers("k", k)
        samples = [
            None if sample is None else numbers("z", sample, (..., "m"))
            for sample in (z if isinstance(z, tuple) else (z,))
        ]
        # Runs with a late sample.
        come = np.zeros(at.shape, bool)
        for sample in (sample for sample in samples if sample is not None):
            if np.isinf(sample).any():
                raise ValueError("z: expected finite numbers or nan, got an infinite one")
            broadcast_batches("z", sample.shape[:-1], at.shape, "k")
            come = come | ~np.isnan(sample).all(-1)
        indices = [epoch.k for epoch in state.epochs]
        beyond = come & ~np.isin(at, indices)
        if beyond.any():
            span = (
                f"a stored epoch, {indices[0]} to {indices[-1]} (lag = {self.lag})"
                if indices
                else "none before the first step"
            )
            raise ValueError(
                f"k: expected {span}, got {np.broadcast_to(at, beyond.shape)[beyond][0]:g}"
            )
        epochs = [_filled(epoch, samples, at == epoch.k) for epoch in state.epochs]
        first = next(
            (
                i
                for i, (old, new) in enumerate(zip(state.epochs, epochs, strict=True))
                if new is not old
            ),
            len(epochs),
        )
        # Return to the state before the first changed epoch, and run again from there.
        replayed = FixedLagState(
            state.states[: first + 1], state.epochs[:first], state.infos[:first]
        )
        for epoch in epochs[first:]:
            replayed, _ = self.step(replayed, epoch)
        return replayed, replayed.infos[-1] if replayed.infos else ()

    def track(self, state: FixedLagState) -> Track:
        """The `Track` of the stored epochs, late samples included. The first epoch of
        `celnav.smooth(track)` is the fixed-lag estimate. ValueError before the first step.
        """
        if not instance("state", state, FixedLagState, "what the filter's last step gave").epochs:
            raise ValueError("state: expected a state after a step, got one before the first")
        collector = Collector(1, KEEP["cov"])
        for after, epoch, infos in zip(state.states[1:], state.epochs, state.infos, strict=True):
            collector.add(epoch, after.belief, infos, {})
        # A compiled filter stores the original filter in `filter`.
        return collector.track(None, getattr(self.filter, "filter", self.filter))


def _copied(x: Any) -> Any:
    """A copy with its own memory."""
    if x is None or isinstance(x, float | int):
        return x
    if type(x) is np.ndarray:
        return x.copy()
    return tuple(map(_copied, x)) if type(x) is tuple else deepcopy(x)


def _filled(epoch: Epoch, late: list[Array | None], here: Any) -> Epoch:
    """The epoch with the late measurements that belong to it; the same object if none does."""
    z = (
        epoch.z
        if isinstance(epoch.z, tuple)
        else (None,) * len(late)
        if epoch.z is None
        else (epoch.z,)
    )
    if len(z) != len(late):
        raise ValueError(f"z: expected {len(z)} measurements, one for each sensor, got {len(late)}")
    samples = tuple(
        _both(on_time, sample, here, epoch.k) for on_time, sample in zip(z, late, strict=True)
    )
    if all(sample is on_time for sample, on_time in zip(samples, z, strict=True)):
        return epoch
    return epoch._replace(
        z=samples if len(samples) > 1 or isinstance(epoch.z, tuple) else samples[0]
    )


def _both(on_time: Any, late: Array | None, here: Any, k: int) -> Any:
    """The measurement ``(..., m)`` of one sensor with the late sample inserted; ValueError if a
    component has both.
    """
    if late is None or np.isnan(new := np.where(here[..., None], late, np.nan)).all():
        return on_time
    if on_time is None:
        return new
    new, on_time = numbers("z", new, (..., on_time.shape[-1])), numbers("z", on_time)
    broadcast_batches("z", new.shape[:-1], on_time.shape[:-1], f"epoch {k}")
    twice = ~(np.isnan(on_time) | np.isnan(new))
    if twice.any():
        which = ", ".join(str(int(i)) for i in np.argwhere(twice)[0])
        raise ValueError(
            f"z: expected components not yet measured at epoch {k}, got [{which}] a second time; "
            "make it nan"
        )
    return np.where(np.isnan(new), on_time, new)
