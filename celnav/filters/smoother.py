"""The fixed-interval smoother [Rauch1965; sigma points: Sarkka2008] for every rule, form and space.

It uses the filter's conditioning with ``g = (f, identity)``: the next state acts as a measurement
of the present state. The smoothed belief is the sum of two independent parts: the belief about the
present state given the next state, and the remaining uncertainty of the next state, carried back by
the gain. No covariances are subtracted, so the smoother remains in square-root form. A gain that is
not optimal increases the variance, but the covariance remains consistent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

import numpy as np

from celnav.filters.colored import Colored
from celnav.filters.fixed_lag import FixedLag
from celnav.filters.imm import InteractingModels
from celnav.filters.joint import condition
from celnav.filters.records import Epoch, Epochs, FilterError, Info
from celnav.filters.regression import pseudo_gain
from celnav.filters.run import run
from celnav.filters.sequential import Sequential, SingleDraw, is_zero_interval
from celnav.filters.switching import Fallback
from celnav.filters.track import Track
from celnav.filters.two_stage import TwoStage
from celnav.gaussian.checks import choice, describe, instance
from celnav.gaussian.linalg import NEGLIGIBLE, Array, Belief, is_concretely_true

__all__ = ["smooth"]

FORWARD_ONLY: dict[type, str] = {
    Colored: "whose differences of measurements share their noise with the motion; "
    "smooth a track of "
    "celnav.augmented(motion, sensor, Phi), which has the colored noise as states",
    TwoStage: "whose stages have no joint model of state and bias to go back by; "
    "smooth a track of celnav.ukf "
    "with the bias as a state",
    InteractingModels: "whose estimate is a mixture, which none of its models leads back from; "
    "smooth the track "
    "of one of its filters alone",
    SingleDraw: "which draws the noise of motion and sensor together; "
    "smooth a track of the filter that it was "
    "made of",
    FixedLag: "which smooths its last epochs by filter.track(state); "
    "smooth a track of its own filter",
}
"""Filters whose tracks cannot be smoothed: the reason, and the filter to use instead."""


def smooth(
    track: Track,
    filter: Any = None,
    *,
    gains: bool = False,
    on_failure: str = "raise",
    engine: str | None = None,
    jobs: int = 1,
) -> Track:
    """Estimates of all states given *all* measurements, from the track of a filter.

    track: the result of ``run(..., keep="cov")``, with every epoch stored.
    filter: the filter of the track; needed only for a track that was pickled. It must predict, then
        update, as `celnav.ukf` and the other sigma-point filters do. Instead of `celnav.colored`
        smooth `celnav.augmented`, instead of `celnav.two_stage` a filter with the bias as a state,
        instead of `celnav.imm` one of its models.
    gains: store the gains ``(T, ..., n, n)`` as ``extra["gain"]``: gain k acts from epoch k + 1 to
        k, and the last is 0.
    on_failure: "raise" a `FilterError` if the smoother fails in a run, or "flag" the run: it is nan
        from the failure *back*, and ``failed_at`` is set.

    engine, jobs: for the backward pass, as in `celnav.run`; gains need numpy.

    Returns the track with smoothed mean, std and covariances; everything else is from the filter. A
    run in which the filter failed is smoothed up to its last good epoch. Directions in which the
    predicted state has no uncertainty (a singular covariance) carry nothing back.

    >>> smoothed = celnav.smooth(celnav.run(filter, prior, times, z, keep="cov"))
    """
    instance("track", track, Track, "what celnav.run gave")
    if track.belief is None:
        raise ValueError("track: expected stored covariances, got none; run with keep='cov'")
    choice("on_failure", on_failure, ("raise", "flag"))
    choice("gains", gains, (False, True))
    chosen = track.filter if filter is None else filter
    if chosen is None:
        raise ValueError(
            "filter: expected the track's filter, because a pickled track has none: smooth(track, "
            "filter)"
        )
    chosen = chosen.first if isinstance(chosen, Fallback) else chosen
    if not isinstance(chosen, Sequential) or isinstance(chosen, Colored | SingleDraw):
        reason = next(
            (f", {why}" for of, why in FORWARD_ONLY.items() if isinstance(chosen, of)), ""
        )
        raise ValueError(
            "filter: expected a filter that predicts, then updates, such as celnav.ukf, got "
            f"{describe(chosen)}{reason}"
        )
    epochs = track.epochs
    if not isinstance(epochs, Epochs) and any(b.k != a.k + 1 for a, b in pairwise(epochs)):
        raise ValueError("track: expected every epoch, got some epochs; run with every=1")

    form, filtered, failed_at = type(track.belief), track.belief, track.failed_at
    batch, n = failed_at.shape, filtered[1].shape[-1]
    mean, cov = filtered.mean.copy(), filtered[1].copy()
    lost = np.isnan(filtered.mean).any(-1)
    G = np.zeros(cov.shape) if gains else None
    if len(mean) > 1:
        # Beliefs before each interval, and one component of the mean after it, in reverse order.
        about = form(mean[-2::-1], cov[-2::-1]), mean[:0:-1, ..., :1]
        backward: Any = (
            [
                epoch._replace(z=None, truth=None, about=(form(*belief), mean_after, epoch.about))
                for epoch, *belief, mean_after in zip(
                    epochs[:0:-1], *about[0], about[1], strict=True
                )
            ]
            if not isinstance(epochs, Epochs)
            else epochs.backward(about)
        )
        backward_track = run(
            backwards(chosen, gains),
            form(mean[-1], np.broadcast_to(cov[-1], (*batch, n, n))),
            backward,
            keep="cov",
            on_failure="flag",
            also=(lambda _epoch, state, _infos: {"gain": state.gain}) if gains else None,
            engine=engine,
            jobs=jobs,
        )
        assert backward_track.belief is not None
        # The last belief needs no smoothing: it already includes all measurements.
        mean[:-1], cov[:-1] = backward_track.belief.mean[::-1], backward_track.belief[1][::-1]
        if G is not None:
            G[:-1] = backward_track.extra["gain"][::-1]
    broken = np.asarray(np.isnan(mean).any(-1) & ~lost)
    if broken.any():
        k = len(broken) - 1 - np.argmax(broken[::-1], 0)  # the last epoch that failed, per run
        first = np.unravel_index(np.argmax(np.where(broken.any(0), k, -1)), batch)
        if on_failure == "raise":
            epoch = epochs[int(k[first]) + 1]
            where = f", run {tuple(int(i) for i in first)}" if batch else ""
            raise FilterError(
                f"smoothing back from step {epoch.k}, t = {epoch.t}{where}: the covariance of the "
                "predicted or "
                "smoothed state is not positive definite (on_failure='flag' continues the other "
                "runs)"
            )
        failed_at = np.where(broken.any(0) & (failed_at < 0), k, failed_at)
    belief, extra = form(mean, cov), track.extra | ({} if G is None else {"gain": G})
    return replace(
        track, mean=mean, std=belief.std, belief=belief, failed_at=failed_at, extra=extra
    )


class Smoothed(NamedTuple):
    """State of the backward pass: the belief given all measurements, and the gain if stored."""

    belief: Belief
    gain: Array | None = None


@dataclass(frozen=True, eq=False)
class Backward:
    """The backward pass as a filter, over the epochs in reverse.

    ``epoch.about`` has the filter's belief before the interval, a component of its mean after it
    (nan where the filter has failed there), and the ``about`` of the epoch itself.
    """

    filter: Sequential
    gains: bool
    sensors: ClassVar[tuple[()]] = ()

    def start(self, prior: Any) -> Smoothed:
        """The filter's last belief."""
        return Smoothed(prior, np.zeros(prior[1].shape) if self.gains else None)

    def step(self, state: Smoothed, epoch: Epoch) -> tuple[Smoothed, tuple[Info, ...]]:
        """The belief at the start of an epoch's interval, given all measurements."""
        before, mean_after, about = epoch.about
        after, gain = state.belief, np.eye(before[1].shape[-1])
        if not is_zero_interval(epoch):
            after, gain = back(self.filter, before, after, epoch._replace(about=about))
        # If the filter failed after the interval, its belief before the interval is the last good
        # belief.
        lost = np.isnan(mean_after)
        if not is_concretely_true(~lost.any()):
            form, here = self.filter.form, lost[..., None]
            mean = np.where(lost, before.mean, after.mean)
            after = form(mean, np.where(here, before[1], after[1]))
            gain = np.where(here, 0.0, gain)
        if not self.gains:
            return Smoothed(after), ()
        return Smoothed(after, np.broadcast_to(gain, before[1].shape)), ()


@lru_cache(maxsize=16)
def backwards(filter: Sequential, gains: bool) -> Backward:
    """The backward pass of a filter; cached, so that its machine code is kept."""
    return Backward(filter, gains)


def back(filter: Sequential, before: Belief, after: Belief, epoch: Epoch) -> tuple[Belief, Array]:
    """The smoothed belief before an epoch's interval, and the gain ``(..., n, n)``, from the
    filter's belief ``before`` the interval and the smoothed belief ``after`` it.
    """
    # x_s = x + G (x_s' - f), and P_s = (P - G S S' G') + G P_s' G' with G = cov(x, f) (S S')^+.
    form, space = filter.form, filter.motion.space
    both = filter.measured(filter.motion, before, after.mean, epoch)
    center = both.measurement.center
    if (both.sign < 0.0).any():
        # A state that the next state determines exactly, such as a constant, cancels to round-off.
        # Negative columns cannot be downdated from it, so the round-off is added as noise.
        size = np.sqrt(np.vecdot(both.state.columns, both.state.columns))
        both = both._replace(
            process_noise=(0, NEGLIGIBLE * size[..., None] * np.eye(size.shape[-1]))
        )

    # P - G S S' G' in the Joseph form for the gain G, which also holds for the pseudo-inverse.
    inner, info, _ = condition(form, both, space, gain=partial(pseudo_gain, center=center))
    gain = info.gain()

    def carried(to: Array, at: Array, root: Array) -> Array:
        return root if space.transport is None else space.transport(space.minus(to, at)) @ root

    # Columns of G P_s' G'. On a curved space deviations at the smoothed next state are transported
    # to the predicted next state, and deviations at the filter's mean to the smoothed mean.
    ahead = carried(inner.mean, before.mean, gain @ carried(center, after.mean, after.sqrt_cov))
    # Conditioning treats nan in the smoothed next state as not measured; here it is a failure.
    lost = ~np.isfinite(after.mean).all(-1, keepdims=True)
    return form(np.where(lost, np.nan, inner.mean), form.sum(inner[1], ahead)), gain
