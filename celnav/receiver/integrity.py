"""Receiver autonomous integrity monitoring (RAIM): residuals of fixes reveal faulty measurements,
which are excluded.

A fix from m measurements has n unknowns. The sum of its squared residuals over their variances is
chi-square with m - n degrees of freedom, the redundancy. With redundancy 0 nothing can be tested,
with 1 a fault can be detected, and with 2 or more it can be excluded. The test excludes the
smallest set of measurements without which the fix is consistent; among sets of equal size, the set
with the smallest remaining residuals [Parkinson1988; Brown1992]. The first axis is the fix, ``K``
or ``T``, the next the measurement ``S``.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from celnav.gaussian.linalg import Array

MOST_EXCLUDED = 3
"""Most measurements that are excluded from a fix; with more faults no measurement is used."""
ROUNDS = 5
"""Rounds of the search. Because the model is nonlinear far from the truth, each round linearizes at
the fix without the measurements excluded in the last round.
"""
AT_ONCE = 250
"""Fixes whose subsets are compared at a time, which limits the memory."""
ESSENTIAL = 1e-6
"""Least share of a measurement's noise in its residual. Below it the measurement is essential: part
of the fix depends on this measurement alone.
"""

Linear = Callable[[Array, Array], tuple[Array, Array]]
"""``(fixes (K,), states (K, n)) ->`` residuals ``(K, S)`` and Jacobians ``(K, S, n)``, both divided
by the noise's standard deviations.
"""


class Monitored(NamedTuple):
    """Which measurements may be used after the test.

    Attributes
    ----------
    kept: ``(T, S)``, the measurements that may be used. excluded: ``(T, S)``, the faulty
        measurements of fixes that are consistent without them.
    tested: ``(T,)``, whether there was redundancy. unusable: ``(T,)``, whether there is a fault
        that cannot be located; nothing is kept then.
    """

    kept: Array
    excluded: Array
    tested: Array
    unusable: Array


def probability(false_alarm: float) -> float:
    """The checked probability of a false alarm; ValueError unless it is from 0 to below 1."""
    if not 0.0 <= false_alarm < 1.0:
        raise ValueError(
            f"false_alarm: expected a probability from 0 to below 1, got {false_alarm!r}"
        )
    return false_alarm


def misfit(left: Array, kept: Array) -> Array:
    """Sum of squared residuals ``(K,)`` of the kept measurements; nan where there is no fix."""
    return np.asarray(np.square(np.where(kept, left, 0.0)).sum(-1))


def monitored(
    fit: Callable[[Array, Array], Array],
    linear: Linear,
    used: Array,
    start: Array,
    *,
    false_alarm: float,
) -> Monitored:
    """Which measurements may be used, after a test of all fixes.

    Parameters
    ----------
    fit: ``(fixes (K,), kept (K, S)) -> states (K, n)``, nan where they are not determined.
    linear: see `Linear`. used: ``(T, S)``, the measurements that exist.
    start: ``(T, n)``, states for the linearization if all measurements together give no fix.
    false_alarm: probability that a sound fix fails the test, from 0 (nothing is tested) to below 1.

    Raises
    ------
    ValueError: if ``false_alarm`` is not such a probability.
    """
    probability(false_alarm)
    n, spare = start.shape[-1], used.sum(-1) - start.shape[-1]
    limit = chdtri(np.arange(1.0, max(int(spare.max(initial=1)), 1) + 1.0), false_alarm)

    def consistent(rows: Array, x: Array, kept: Array) -> Array:
        size = misfit(linear(rows, np.where(np.isfinite(x), x, start[rows]))[0], kept)
        most = limit[np.maximum(kept.sum(-1) - n, 1) - 1]
        return np.asarray(np.isfinite(x).all(-1) & (size <= most))

    rows, tested = np.flatnonzero(spare > 0), spare > 0
    kept, excluded = used.copy(), np.zeros(used.shape, bool)
    if false_alarm == 0.0 or not rows.size:
        return Monitored(kept, excluded, tested & (false_alarm > 0.0), np.zeros(len(used), bool))
    x = fit(rows, used[rows])
    open_ = ~consistent(rows, x, used[rows])
    rows, x = rows[open_], np.where(np.isfinite(x), x, start[rows])[open_]
    for size in range(1, MOST_EXCLUDED + 1):
        some = np.flatnonzero(spare[rows] > size)
        if not some.size:
            break
        which, at, out = rows[some], x[some], np.zeros((some.size, used.shape[-1]), bool)
        for _ in range(ROUNDS):
            before, out = out, _best(*linear(which, at), used[which], size)
            if (before == out).all():
                break
            fixed = fit(which, used[which] & ~out)
            at = np.where(np.isfinite(fixed), fixed, at)
        good = consistent(which, fixed, used[which] & ~out) & out.any(-1)
        excluded[which[good]] = out[good]
        rows, x = (np.delete(values, some[good], 0) for values in (rows, x))
    unusable = np.isin(np.arange(len(used)), rows)
    return Monitored(used & ~excluded & ~unusable[:, None], excluded, tested, unusable)


def _best(left: Array, G: Array, used: Array, size: int) -> Array:
    """The set E of ``size`` measurements, as a mask ``(K, S)``, without which the sum of squared
    residuals is least; empty if all are essential.

    v are the residuals of the fix with all measurements, and I - Q Q' is their cofactor matrix.
    Without E the sum is smaller by ``v_E' (I - Q Q')_EE^-1 v_E``.
    """
    out = np.zeros(used.shape, bool)
    for first in range(0, len(used), AT_ONCE):
        block = slice(first, first + AT_ONCE)
        order = np.argsort(~used[block], axis=-1, kind="stable")[
            :, : int(used[block].sum(-1).max())
        ]
        there = np.take_along_axis(used[block], order, -1)
        its = np.take_along_axis(G[block], order[..., None], 1)
        v, cofactor = _residuals(np.take_along_axis(left[block], order, -1), its, there)
        subsets = np.array(list(combinations(range(order.shape[-1]), size)))
        values, vectors = np.linalg.eigh(cofactor[:, subsets[:, :, None], subsets[:, None, :]])
        projected = np.square((vectors * v[:, subsets][..., None]).sum(-2))
        can = (values[..., 0] > ESSENTIAL) & there[:, subsets].all(-1)
        gain = np.where(can, (projected / np.where(values > ESSENTIAL, values, 1.0)).sum(-1), -1.0)
        chosen = np.take_along_axis(order, subsets[gain.argmax(-1)], -1)
        np.put_along_axis(out[block], chosen, gain.max(-1, keepdims=True) >= 0.0, -1)
    return out


def _residuals(left: Array, G: Array, used: Array) -> tuple[Array, Array]:
    """Residuals ``(K, S)`` of a linear fix in standard deviations, and their covariance
    ``(K, S, S)``.
    """
    Q = np.linalg.qr(np.where(used[..., None], G, 0.0)).Q
    cofactor = np.eye(left.shape[-1]) - Q @ Q.mT
    return (cofactor @ np.where(used, left, 0.0)[..., None])[..., 0], cofactor


def noise_components(left: Array, G: Array, used: Array, parts: Array, known: Array) -> Array:
    """Variances ``(c,)`` of noise with several causes, estimated from the residuals of many fixes.

    The expected squared residuals are ``(I - Q Q')^2`` times the variances of the noise. These
    variances are sums over the causes, plus a known part. The estimate is a nonnegative
    least-squares fit to the squared residuals, each divided by its cofactor.

    Parameters
    ----------
    left, G: as from `Linear`. used: ``(K, S)``, the measurements in use.
    parts: ``(c, K, S)``, the variance of a measurement from each cause of unit size, over the
        measurement's own variance. known: ``(K, S)``, the known part, likewise.
    """
    from scipy.optimize import nnls  # takes a second to import

    v, cofactor = _residuals(left, G, used)
    there = used & (np.diagonal(cofactor, 0, -2, -1) > 0.01)
    parts = np.where(used, np.concatenate([parts, known[None]]), 0.0)
    *expected, besides = (np.square(cofactor) @ parts[..., None])[..., 0]
    weight = 1.0 / np.diagonal(cofactor, 0, -2, -1)[there]
    rows = np.stack([part[there] * weight for part in expected], -1)
    # R of a QR replaces hundreds of thousands of rows by one row for each cause.
    Q, R = np.linalg.qr(rows)
    variances, _ = nnls(R, Q.T @ ((np.square(v) - besides)[there] * weight))
    return np.asarray(variances)
