"""The fixed-interval smoother [Rauch1965; sigma points: Sarkka2008] for every rule, form and space.

It is the core's conditioning once more: with ``g = (f, identity)`` the next state is a measurement of the present one. The belief
about the present state given the next, and what is left open about the next one carried back by the gain, are independent; their
sum is the smoothed belief. No covariances are subtracted, so it stays a square-root smoother, and a gain that is not optimal
costs variance, not honesty.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from celnav.filters.colored import Colored
from celnav.filters.fallback import Fallback
from celnav.filters.fixed_lag import FixedLag
from celnav.filters.imm import InteractingModels
from celnav.filters.joint import condition
from celnav.filters.records import Epoch, FilterError
from celnav.filters.regression import pseudo_gain
from celnav.filters.sequential import Sequential, SingleDraw
from celnav.filters.track import Track
from celnav.filters.two_stage import TwoStage
from celnav.gaussian.checks import choice, instance, kind
from celnav.gaussian.linalg import NEGLIGIBLE, Array, Belief

__all__ = ["back", "smooth"]

FORWARD_ONLY: dict[type, str] = {
    Colored: "whose differences of measurements share their noise with the motion; smooth a track of "
    "celnav.augmented(motion, sensor, Phi), which has the colored noise as states",
    TwoStage: "whose stages have no joint model of state and bias to go back by; smooth a track of celnav.ukf "
    "with the bias as a state",
    InteractingModels: "whose estimate is a mixture, which none of its models leads back from; smooth the track "
    "of one of its filters alone",
    SingleDraw: "which draws the noise of motion and sensor together; smooth a track of the filter that it was "
    "made of",
    FixedLag: "which smooths its last epochs by filter.track(state); smooth a track of its own filter",
}
"""Filters of which a track cannot be smoothed: why, and which one takes their place."""


def smooth(
    track: Track, filter: Any = None, *, gains: bool = False, on_failure: str = "raise"
) -> Track:
    """Estimates of all states given *all* measurements, from the track of a filter.

    track: of ``run(..., keep="cov")``, every epoch stored.
    filter: the filter of the track, which has it unless it was pickled. It predicts, then updates, as
        `celnav.ukf` and its siblings do. In place of `celnav.colored` smooth `celnav.augmented`, in place
        of `celnav.two_stage` a filter with the bias as a state, in place of `celnav.imm` one of its models.
    gains: store the gains ``(T, ..., n, n)``, ``extra["gain"]``: the k-th acts from epoch k + 1 to k, the last is 0.
    on_failure: "raise" a `FilterError` if the smoother loses a run, or "flag" it (nan from there *back*, and ``failed_at``).

    Returns the track with smoothed mean, std and covariances; all else remains the filter's. A run that the filter lost is smoothed
    up to its last good epoch. Directions of the predicted state that are known (a singular covariance) carry nothing back.

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
            "filter: expected that of the track, which was lost when it was pickled: smooth(track, filter)"
        )
    chosen = chosen.first if isinstance(chosen, Fallback) else chosen
    if not isinstance(chosen, Sequential) or isinstance(chosen, Colored | SingleDraw):
        reason = next(
            (f", {why}" for of, why in FORWARD_ONLY.items() if isinstance(chosen, of)), ""
        )
        raise ValueError(
            f"filter: expected one that predicts, then updates, such as celnav.ukf, got {kind(chosen)}{reason}"
        )
    epochs = track.epochs
    if any(b.k != a.k + 1 for a, b in pairwise(epochs)):
        raise ValueError("track: expected every epoch, got some of them; run with every=1")

    form, filtered, failed_at = type(track.belief), track.belief, track.failed_at
    mean, cov = filtered.mean.copy(), filtered[1].copy()
    G = np.zeros(cov.shape) if gains else None
    after: Any = form(mean[-1], cov[-1])
    for k in range(len(mean) - 2, -1, -1):
        epoch, before = epochs[k + 1], form(filtered.mean[k], filtered[1][k])
        if np.any(epoch.dt):
            try:
                after, gain = back(chosen, before, after, epoch)
            except Exception as error:
                error.add_note(f"in smoothing back from step {epoch.k}, t = {epoch.t}")
                raise
        else:
            gain = np.broadcast_to(np.eye(cov.shape[-1]), cov.shape[1:])
        lost = ~np.isfinite(filtered.mean[k + 1]).all(-1)
        if lost.any():
            after = form(
                np.where(lost[..., None], before.mean, after.mean),
                np.where(lost[..., None, None], before[1], after[1]),
            )
            gain = np.where(lost[..., None, None], 0.0, gain)
        mean[k], cov[k] = after.mean, after[1]
        if G is not None:
            G[k] = gain
        broken = after.lost() & np.isfinite(filtered.mean[k]).all(-1)
        if broken.any():
            if on_failure == "raise":
                run = tuple(int(i) for i in np.argwhere(broken)[0])
                where = f", run {run}" if run else ""
                raise FilterError(
                    f"smoothing back from step {epoch.k}, t = {epoch.t}{where}: the covariance of the predicted state, or the "
                    "smoothed one, is not positive definite (on_failure='flag' lets the other runs go on)"
                )
            failed_at = np.where(broken & (failed_at < 0), k, failed_at)
    belief, extra = form(mean, cov), track.extra | ({} if G is None else {"gain": G})
    return replace(
        track, mean=mean, std=belief.std, belief=belief, failed_at=failed_at, extra=extra
    )


def back(filter: Sequential, before: Belief, after: Belief, epoch: Epoch) -> tuple[Belief, Array]:
    """The belief before an epoch's interval given everything, from the one given the past and the smoothed one after it."""
    form, space = filter.form, filter.motion.space
    both = filter.onward(before, epoch, after.mean)
    center = both.measurement.center
    if both.sign.ndim == 1 and (both.sign < 0.0).any():
        # What the next state tells exactly, such as a constant, cancels to round-off, from which no negative columns can be taken
        # away: the round-off counts as the noise that it is.
        size = np.sqrt(np.vecdot(both.state.columns, both.state.columns))
        both = both._replace(
            process_noise=(0, NEGLIGIBLE * size[..., None] * np.eye(size.shape[-1]))
        )

    inner, info, _ = condition(form, both, space, gain=partial(pseudo_gain, center=center))

    gain = info.gain()

    def carried(to: Array, at: Array, root: Array) -> Array:
        return root if space.transport is None else space.transport(space.minus(to, at)) @ root

    ahead = carried(inner.mean, before.mean, gain @ carried(center, after.mean, after.sqrt_cov))
    lost = ~np.isfinite(after.mean).all(-1, keepdims=True)  # not a next state that was not measured
    return form(np.where(lost, np.nan, inner.mean), form.sum(inner[1], ahead)), gain
