"""A filter's track over a log, and at which epochs it deserves trust.

A filter predicts an epoch from earlier ones, and a fix has the ranges of its own epoch alone: their
errors are independent. So the distance d between both positions has the covariance P + P_fix, and
``d' (P + P_fix)^-1 d`` is chi-square with three degrees if noise and motion are as assumed. Where
it is less probable than the false alarms that are allowed, both cannot be right. An epoch without
redundancy has no fix that was tested; its ranges are compared with the prediction instead, with
``S = H P H' + R`` and one degree each.

Trust is lost where prediction and fix of a redundant epoch are apart. It is doubted where ranges
contradict each other, or those of an epoch without redundancy contradict the prediction: then the
next redundant epoch that agrees ends the doubt. The filter coasts meanwhile. Lost trust returns
after `AGREEING` redundant epochs in a row whose ranges and rates agree among themselves: the filter
starts anew from the last of their fixes. Where that is farther from the track that was trusted than
both explain, a receiver cannot have got there, and every later position says so until it comes
back.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from celnav.filters.records import FilterError
from celnav.filters.sequential import Sequential
from celnav.gaussian.linalg import Array, Belief
from celnav.models import pseudorange
from celnav.receiver.position import Log

AGREEING = 5
"""Redundant epochs in a row, over as many seconds, after which a filter starts anew."""
SOUND_M = 100.0
"""A position that may be farther off is not sound."""


class Guarded(NamedTuple):
    """What a filter made of a log.

    Attributes
    ----------
    mean: ``(T, 8 or 9)``. cov: ``(T, 3, 3)`` m^2 of positions. nis, dof: ``(T,)``.
    apart: ``(T,)``, squared distance of prediction and measurements in units of the largest that
        noise explains; nan where there were none. trust: a word ``(T,)``: "" where the ranges were
        used, "apart" where they and the track contradict each other, "distrusted" where they were
        not used as trust was lost before, "displaced" where they were used far from the track that
        was trusted.
    """

    mean: Array
    cov: Array
    nis: Array
    dof: Array
    apart: Array
    trust: Array


def guarded(filter: Sequential, log: Log, false_alarm: float, compact: bool = False) -> Guarded:
    """Run a filter that starts at the first fix over a log, as long as it deserves trust.

    ``false_alarm``: probability that an epoch without a fault is called apart; 0: nothing is.
    ``compact``: see `Log.epochs`.

    Raises
    ------
    FilterError: if a state is not finite.
    """
    T, S = len(log.times), len(log.names)
    limit = chdtri(np.maximum(np.arange(S + 1), 1), false_alarm)
    redundant = log.tested[:, 0] & np.isfinite(log.fixes[:, 0])
    # Rates that contradict each other nearly always are useless, not a sign of bad ranges.
    rates_fail = log.unusable[:, 1] & (log.unusable[:, 1].mean() < 0.5)
    sound = redundant & ~rates_fail
    mean, cov = np.zeros(log.fixes.shape), np.zeros((T, 3, 3))
    nis, dof, apart = np.zeros(T), np.zeros(T), np.full(T, np.nan)
    trust = np.full(T, "", dtype="<U10")
    state, home, start, since = filter.start(log.prior()), None, 0, 0
    lost, doubted, confirmed = False, False, False
    for k, epoch in enumerate(log.epochs(compact)):
        state = filter.predict(state, epoch)
        home = home and filter.predict(home, epoch)
        since = since if sound[k] else k + 1
        agreed = k - since >= AGREEING - 1 and log.times[k] - log.times[since] >= AGREEING - 1.0
        if log.used[k].any():
            apart[k] = _apart(log, k, state.belief, redundant[k], limit)
        agrees = not apart[k] > 1.0
        if lost and agreed:
            origin = home or state
            away = np.linalg.norm(log.fixes[k, :3] - origin.belief.mean[:3])
            explained = _apart(log, k, origin.belief, True, limit) <= 1.0
            home = origin if confirmed and away > SOUND_M and not explained else None
            state, start, lost, doubted = filter.start(log.prior(k)), k, False, False
        elif redundant[k] and not lost:
            lost, doubted = not agrees, False
            if lost:
                trust[k], since, agreed = "apart", k, False
                if not confirmed:  # the track began at a fix that no later one agrees with
                    trust[start:k] = "apart"
        elif not redundant[k]:
            doubted |= bool(log.unusable[k, 0]) or not agrees
        confirmed |= agreed
        used = not (lost or doubted)
        if not used and not trust[k] and log.used[k].any():
            trust[k] = "distrusted" if agrees or lost else "apart"
        if used and home and log.used[k].any():
            trust[k] = "displaced"
        state, (info,) = filter.update(state, epoch if used else epoch._replace(z=None))
        mean[k], cov[k] = state.belief.mean, state.belief.cov[:3, :3]
        if info.nis is not None and info.used is not None:
            nis[k], dof[k] = info.nis, info.used.sum()
        if not np.isfinite(mean[k]).all():
            raise FilterError(f"its state is not finite at step {k}, t = {epoch.t}")
    return Guarded(mean, cov, nis, dof, apart, trust)


def _apart(log: Log, k: int, belief: Belief, redundant: bool, limit: Array) -> float:
    """Squared distance of a prediction from the fix of epoch k or, without redundancy, from its
    ranges, in units of the largest that noise explains.
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
