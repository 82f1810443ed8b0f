"""A filter's track over a log, and a test at each epoch whether it can be trusted.

A filter predicts an epoch from earlier epochs, and a fix uses only the ranges of its epoch. So
their errors are independent, and the distance d between the two positions has the covariance P +
P_fix. If noise and motion are as assumed, ``d' (P + P_fix)^-1 d`` is chi-square with three degrees
of freedom. If its tail probability is below the false-alarm probability, prediction or fix is
wrong. An epoch without redundancy has no tested fix. Its ranges are compared with the prediction
instead, each with ``S = H P H' + R`` and one degree of freedom.

The track is distrusted if prediction and fix of a redundant epoch fail this test. It is doubted if
ranges contradict each other, or if ranges without redundancy contradict the prediction. The next
redundant epoch that passes the test ends the doubt. Meanwhile the filter only predicts. Trust
returns after `AGREEING` redundant epochs in a row whose ranges and rates agree among themselves.
The filter then restarts from the last of their fixes. This fix may be farther from the trusted
track than both covariances explain, so that no receiver can have moved there. All later positions
are then marked until the track returns to the trusted one.

A drift of the ranges that is too slow to be detected at one epoch appears in the mean distance m
over a window. Its covariance ``cov(m)`` includes correlated errors, see
`celnav.receiver.correlated`. Then ``m' cov(m)^-1 m`` is also chi-square with three degrees of
freedom. If its tail probability is below the false-alarm probability, ranges and rates disagree,
and the track drifts with the ranges. The track is also treated as drifting after a restart that is
farther from the track than both covariances explain, but within `SOUND_M`. It is no longer treated
as drifting when the mean has agreed for a whole window and ranges have moved the track back to
within `SOUND_M`. Windows overlap, so false alarms come in groups. A common drift of ranges and
rates looks like a motion, which a test of this kind cannot detect.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from celnav.filters.records import FilterError, Info
from celnav.filters.sequential import Sequential
from celnav.gaussian.linalg import Array, Belief
from celnav.models import pseudorange
from celnav.receiver.correlated import WINDOW, Errors
from celnav.receiver.filters import transition
from celnav.receiver.position import Log

AGREEING = 5
"""Number of redundant epochs in a row, and their least duration in s, after which a filter
restarts.
"""
SOUND_M = 100.0
"""A position whose possible error exceeds this, m, is not sound."""


class Guarded(NamedTuple):
    """A filter's track over a log, and its trust.

    Attributes
    ----------
    mean: ``(T, 8 + k)``. cov: ``(T, 3, 3)`` m^2 of positions, including correlated errors. nis,
        dof: ``(T,)``, as if all errors were white.
    apart: ``(T,)``, squared distance of prediction and measurements, over the largest value that
        noise explains; nan without measurements. drift: ``(T,)``, likewise for the mean distance
        over a window; nan until a window is full.
    trust: a word ``(T,)``:

    - "": the ranges were used.
    - "apart": ranges and track contradict each other.
    - "distrusted": the ranges were not used, because the track was distrusted before.
    - "displaced": the ranges were used, far from the track that was trusted.
    - "drifting": the ranges were used, and the track drifts with them.
    """

    mean: Array
    cov: Array
    nis: Array
    dof: Array
    apart: Array
    drift: Array
    trust: Array


def guarded(filter: Sequential, log: Log, false_alarm: float, compact: bool = False) -> Guarded:
    """A filter's track over a log from its first fix; ranges are used only where they are trusted.

    ``false_alarm``: probability that an epoch without a fault fails the test; 0: no test.
    ``compact``: see `Log.epochs`.

    Raises
    ------
    FilterError: if a state is not finite.
    """
    T, S, n = len(log.times), len(log.names), log.fixes.shape[1]
    limit = chdtri(np.maximum(np.arange(S + 1), 1), false_alarm)
    redundant = log.tested[:, 0] & np.isfinite(log.fixes[:, 0])
    # If rates contradict each other at most epochs, they are useless and do not indicate bad
    # ranges.
    rates_fail = log.unusable[:, 1] & (log.unusable[:, 1].mean() < 0.5)
    sound = redundant & ~rates_fail
    mean, cov = np.zeros((T, n)), np.zeros((T, 3, 3))
    shares, times = (
        np.repeat([[kind.short, kind.long] for kind in log.correlation], S, 0).T,
        np.repeat([[kind.time, np.inf] for kind in log.correlation], S, 0).T,
    )
    nis, dof, apart, drift = np.zeros(T), np.zeros(T), np.full(T, np.nan), np.full(T, np.nan)
    trust = np.full(T, "", dtype="<U10")
    state, home, start, since = filter.start(log.prior()), None, 0, 0
    errors, pulled, drifting, alarm = Errors.at_start(state.belief, 2 * S), 0.0, False, -WINDOW
    lost, doubted, confirmed = False, False, False
    for k, epoch in enumerate(log.epochs(compact)):
        before, state = state.belief.cov, filter.predict(state, epoch)
        F = np.eye(n)
        F[:8, :8] = transition(epoch.dt)
        errors = errors.predict(F, before, state.belief.cov, np.exp(-epoch.dt / times))
        home = home and filter.predict(home, epoch)
        since = since if sound[k] else k + 1
        agreed = k - since >= AGREEING - 1 and log.times[k] - log.times[since] >= AGREEING - 1.0
        if log.used[k].any():
            apart[k] = _apart(log, k, state.belief, redundant[k], limit)
        agrees = not apart[k] > 1.0
        if lost and agreed:
            origin = home or state
            away = np.linalg.norm(log.fixes[k, :3] - origin.belief.mean[:3])
            jumped = confirmed and _apart(log, k, origin.belief, True, limit) > 1.0
            home = origin if jumped and away > SOUND_M else None
            if jumped and not home:
                alarm, drifting = k, True
            pulled = pulled + drifting * (log.fixes[k, :3] - state.belief.mean[:3])
            state, start, lost, doubted = filter.start(log.prior(k)), k, False, False
            errors = Errors.at_start(state.belief, 2 * S)
        elif redundant[k] and not lost:
            lost, doubted = not agrees, False
            if lost:
                trust[k], since, agreed = "apart", k, False
                if not confirmed:  # the track began at a fix with which no later fix agrees
                    trust[start:k] = "apart"
        elif not redundant[k]:
            doubted |= bool(log.unusable[k, 0]) or not agrees
        confirmed |= agreed
        used = not (lost or doubted)
        if not used and not trust[k] and log.used[k].any():
            trust[k] = "distrusted" if agrees or lost else "apart"
        if used and home and log.used[k].any():
            trust[k] = "displaced"
        predicted = state.belief.mean
        state, (info,) = filter.update(state, epoch if used else epoch._replace(z=None))
        compared = bool(redundant[k]) and used and k > start
        rows = log.rows(k, compact)
        errors = _updated(errors, log, k, rows, predicted, state.belief, info, compared, shares)
        if k - start >= WINDOW:
            drift[k] = errors.squared_mean / limit[3]
        alarm = k if drift[k] > 1.0 else alarm
        pulled = drifting * (pulled + state.belief.mean[:3] - predicted[:3])
        drifting = k - alarm < WINDOW or bool(np.linalg.norm(pulled) > SOUND_M)
        if drifting and used and not trust[k] and log.used[k].any():
            trust[k] = "drifting"
        mean[k], cov[k] = state.belief.mean, errors.cov[:3, :3]
        if info.nis is not None and info.used is not None:
            nis[k], dof[k] = info.nis, info.used.sum()
        if not np.isfinite(mean[k]).all():
            raise FilterError(f"its state is not finite at step {k}, t = {epoch.t}")
    return Guarded(mean, cov, nis, dof, apart, drift, trust)


def _updated(
    errors: Errors,
    log: Log,
    k: int,
    rows: Array,
    predicted: Array,
    updated: Belief,
    info: Info,
    compared: bool,
    shares: Array,
) -> Errors:
    """Errors after an update with the ``rows`` of the log's ranges and rates, and after the
    comparison of a fix with the prediction.
    """
    sigma, S, n = log.sigma[k], len(log.names), len(predicted)
    K, H = np.zeros((n, 2 * S)), pseudorange.jacobian(predicted, log.q[k], log.w[k], log.second)
    R, G, distance = np.square(sigma), np.zeros((3, 2 * S)), None
    if info.used is not None:
        used, left = rows[info.used], R.copy()
        if info.R is not None:
            left[rows] = info.R
        # For an optimal gain and the noise after the hooks: K = P+ H' R^-1.
        K[:, used] = updated.cov @ (H[used].T / left[used])
        R = np.maximum(R, left)
    if compared:
        ranges = np.flatnonzero(log.used[k])
        J = np.delete(H[ranges], [3, 4, 5, 7], -1) / sigma[ranges, None]
        G[:, ranges] = np.linalg.pinv(J)[:3] / sigma[ranges]
        distance = log.fixes[k, :3] - predicted[:3]
    return errors.update(K, H, R, sigma * np.sqrt(shares), G, distance)


def _apart(log: Log, k: int, belief: Belief, redundant: bool, limit: Array) -> float:
    """Squared distance of a prediction from the fix at epoch k or, without redundancy, from the
    ranges, over the largest squared distance that noise explains.
    """
    x, P = belief.mean, belief.cov
    if redundant:
        y, S = log.fixes[k, :3] - x[:3], P[:3, :3] + log.fix_cov[k]
    else:
        ranges = np.flatnonzero(log.used[k])
        at = x, log.q[k], log.w[k], log.second
        y = (log.z[k] - pseudorange.measure(*at))[ranges]
        H = pseudorange.jacobian(*at)[ranges]
        S = H @ P @ H.T + np.diag(log.sigma[k, ranges] ** 2)
    return float(y @ np.linalg.solve(S, y) / limit[len(y)])
