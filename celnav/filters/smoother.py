"""The fixed-interval smoother [Rauch, Tung & Striebel 1965; sigma points: Sarkka 2008] for every rule, form and space.

It is the core's conditioning once more: with ``g = (f, identity)`` the next state is a measurement of the present one. Given
the columns ``D_y, D_x`` of both, the noise ``N`` and the root ``L'`` of the next smoothed state, one QR gives the smoothed root::

    G = cov(x, y) cov(y)^-1        L = tria [ D_x - G D_y,  -G N,  G L' ]

No covariances are subtracted, so it stays a square-root smoother, and a gain that is not optimal costs variance, not honesty.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from celnav.filters.arguments import flag
from celnav.filters.conditioning import evaluate, images, innovation_of, set_noise
from celnav.filters.driver import Epoch, FilterError
from celnav.filters.step import Motion
from celnav.filters.track import Track
from celnav.gaussian.belief import SQUARE_ROOT, Gaussian
from celnav.gaussian.checks import choice, instance, kind
from celnav.gaussian.linalg import Array, matvec, solve_lower, solve_upper_transposed, tria
from celnav.gaussian.transform import KEEP, Outputs

_EPS = float(np.finfo(np.float64).eps)


def smooth(
    track: Track,
    epochs: Iterable[Epoch],
    motion: Motion,
    *,
    gains: bool = False,
    on_failure: str = "raise",
) -> Track:
    """Estimates of all states given *all* measurements, from the track of a filter that predicts with this motion.

    Parameters
    ----------
    track: of ``run(..., keep="spread")``, every epoch stored.
    epochs: those of the run; their inputs and intervals are used, their measurements are not.
    motion: the part of the filter that `celnav.filters.step.predict` made. Process and measurement noise must be independent:
        smooth colored measurement noise with the track of `celnav.filters.colored.augmented`.
    gains: store the gains ``(T, ..., n, n)``, ``extra["gain"]``: the k-th acts from epoch k + 1 to k, the last is 0.
    on_failure: "raise" a `FilterError` if the smoother loses a run, or "flag" it (nan from there *back*).

    Returns
    -------
    The track with smoothed mean, std and spread; innovations, likelihood and events remain those of the filter. A run that
    the filter lost is smoothed up to its last good epoch. ``failed_at`` also tells where the smoother lost a run.

    An epoch with ``dt == 0`` shares its state with the one before. Directions of the predicted state that are known (a
    singular covariance) carry nothing back.

    Raises
    ------
    ValueError: for a track without spreads, a part that is no motion, epochs that are not those of the track.
    FilterError: see ``on_failure``.
    """
    if not isinstance(motion, Motion):
        raise ValueError(f"motion: expected the filter's predict part, made by celnav.predict(f, rule, Q), got {kind(motion)}")
    instance("track", track, Track, "a Track, such as celnav.run(filter, prior, epochs, keep='spread')")
    if track.mean is None or track.spread is None:
        raise ValueError("track: expected stored spreads, got none; run with keep='spread'")
    choice("on_failure", on_failure, ("raise", "flag"))
    if not isinstance(epochs, Iterable):
        raise ValueError(f"epochs: expected those of the run, got {kind(epochs)}")
    interval = epochs if isinstance(epochs, Sequence) else list(epochs)
    _check_times(track.times, interval)

    mean, spread, std = track.mean.copy(), track.spread.copy(), np.empty(track.spread.shape[:-1])
    G = np.zeros(spread.shape) if flag("gains", gains) else None
    failed_at = track.failed_at.copy()
    after = Gaussian(mean[-1], spread[-1], track.form)
    std[-1] = after.std
    for k in range(len(mean) - 2, -1, -1):
        epoch, filtered = interval[k + 1], Gaussian(track.mean[k], track.spread[k], track.form)
        if np.any(epoch.dt):
            try:
                after, gain = back(filtered, after, epoch, motion)
            except Exception as error:
                error.add_note(f"in smoothing back from step {epoch.k}, t = {epoch.t}")
                raise
        else:
            gain = np.broadcast_to(np.eye(spread.shape[-1]), spread.shape[1:])
        lost = ~np.isfinite(track.mean[k + 1]).all(-1)
        if lost.any():
            after = Gaussian(
                np.where(lost[..., None], filtered.mean, after.mean),
                np.where(lost[..., None, None], filtered.spread, after.spread),
                track.form,
            )
            gain = np.where(lost[..., None, None], 0.0, gain)
        mean[k], spread[k], std[k] = after.mean, after.spread, after.std
        if G is not None:
            G[k] = gain
        broken = np.isfinite(track.mean[k]).all(-1) & ~(np.isfinite(after.mean).all(-1) & np.isfinite(after.spread).all((-2, -1)))
        if broken.any():
            if on_failure == "raise":
                run = tuple(int(i) for i in np.argwhere(broken)[0])
                where = f", run {run}" if run else ""
                raise FilterError(
                    f"smoothing back from step {epoch.k}, t = {epoch.t}{where}: the covariance of the predicted state, or the "
                    "smoothed one, is not positive definite (on_failure='flag' lets the other runs go on)"
                )
            failed_at = np.where(broken & (failed_at < 0), k, failed_at)
    kept = dict(track.extra) if G is None else {**track.extra, "gain": G}
    return replace(track, mean=mean, std=std, spread=spread, failed_at=failed_at, extra=kept)


def _check_times(times: Array, epochs: Sequence[Epoch]) -> None:
    if len(epochs) != len(times):
        raise ValueError(f"epochs: expected the {len(times)} of the track (run with every=1), got {len(epochs)}")
    for k, (t, epoch) in enumerate(zip(times, epochs, strict=True)):
        if not hasattr(epoch, "dt") or np.any(epoch.t != t):
            raise ValueError(
                f"epochs: expected the times of the track, got {getattr(epoch, 't', epoch)!r:.80} instead of {t} at index {k}"
            )


def back(filtered: Gaussian, after: Gaussian, epoch: Epoch, motion: Motion) -> tuple[Gaussian, Array]:
    """The belief before an epoch's interval given everything, from the one given the past and the smoothed one after it."""
    f, rule, space = motion.f, motion.rule, motion.space
    form, n = filtered.form, filtered.spread.shape[-1]
    W = evaluate(motion.noise, filtered.mean, epoch)
    r = 0 if W is None else W.shape[-1]
    root = form.root(filtered.spread)

    def g(points: Array, *w: Array) -> Outputs:
        return images("f", f, points, epoch, w, filtered.mean.shape[-1]), KEEP

    (y, x), A = rule.transform(g, filtered.mean, root, space, (space, space), motion.extra, r, epoch)
    if W is not None:
        set_noise("Q", A[..., :n, A.shape[-1] - r :], W)
        A[..., n:, A.shape[-1] - r :] = 0.0
    G = _gain(A[..., :n, :], A[..., n:, :], rule.sign, y.center)
    ahead = after.root
    if space.transport is not None:
        ahead = space.transport(space.minus(y.center, after.mean)) @ ahead
    step = matvec(G, innovation_of(after.mean, y, space))
    spread = form.marginal(np.concatenate([A[..., n:, :] - G @ A[..., :n, :], G @ ahead], -1), rule.sign)
    if space.transport is not None:
        carry = space.transport(step)
        spread = tria(carry @ spread) if form.name == SQUARE_ROOT.name else carry @ spread @ carry.mT
    return Gaussian(space.plus(x.center, step), spread, form), G


def _gain(D_y: Array, D_x: Array, sign: Array, center: Array) -> Array:
    """Gain ``cov(x, y) cov(y)^+ (..., n, n)`` of the columns; the pseudo-inverse where the covariance of y is singular."""
    S = SQUARE_ROOT.marginal(D_y, sign)
    signed = D_x if not (sign < 0.0).any() else D_x * np.concatenate([sign, np.ones(D_x.shape[-1] - len(sign))])
    std = np.sqrt(np.einsum("...ij,...ij->...i", S, S))
    known = std == 0.0
    unit = np.where(known, 1.0, std)
    # Differences of images carry the round-off of the images: below it a direction of y is known, not merely well known.
    if center.shape[-1] == S.shape[-1]:
        noise = _EPS * np.where(known, 0.0, np.abs(center) / unit).max(-1)
    else:
        noise = _EPS * np.abs(center).max(-1) / unit.min(-1)
    least = 4.0 * (S.shape[-1] * _EPS + noise)
    singular = (S.diagonal(0, -2, -1) <= least[..., None] * unit).any(-1)
    if not singular.any():
        U = signed @ solve_lower(S, D_y).mT
        return solve_upper_transposed(S, U.mT).mT
    eye = np.eye(S.shape[-1])
    regular = np.where(singular[..., None, None], eye, S)
    U = signed @ solve_lower(regular, D_y).mT
    gain = solve_upper_transposed(regular, U.mT).mT
    u, s, _ = np.linalg.svd(np.where(singular[..., None, None], S / unit[..., None], eye))
    kept = s > least[..., None]
    inverse = np.where(kept, 1.0 / np.where(kept, s, 1.0), 0.0)[..., None]
    # S = unit u s v': cov(y)^+ = (u / s) (u / s)' in units of the standard deviations
    half = inverse * (u.mT / unit[..., None, :])
    pseudo = (signed @ (half @ D_y).mT) @ half
    return np.where(singular[..., None, None], pseudo, gain)
