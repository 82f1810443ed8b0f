"""Correlated errors of ranges and rates: their correlation times, and the true covariance of a
filter that treats them as white.

An error of standard deviation ``sigma`` is the sum of three parts. The first is white, the short
part has the correlation time ``time``, and the long part lasts while a satellite is in view:

    eps_k = w_k + s_1 beta_1,k + s_2 beta_2,k,    s_i = sigma sqrt(share_i),

with ``beta_i`` of unit variance, ``beta_i,k = phi_i beta_i,k-1 + ...``, and ``phi_2 = 1``. A filter
has the gain K and the state error e. Over a window, m is the mean distance of fixes from
predictions. Both follow from the recursion for ``a = (e, m)``,

    a- = Phi a,    a+ = A a- + B eps,    A = [[I - K H, 0], [-g E, (1 - g) I]],    B = [K; g G],

where E selects the position, G maps measurements to the fix, and ``g`` is one over the window's
length. C_i is the cross-covariance of a with ``beta_i``. With the filter's process noise added, the
covariance of a is

    cov+ = A cov- A' + B R B' + sum_i (A C_i- s_i B' + its transpose),    C_i+ = A C_i- + B s_i.

This is Schmidt's covariance of considered states, as in `celnav.filters.adaptive.consider`, with
the filter's gain unchanged.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array, Belief, block

LEAST_LAGS = 3
"""Least number of lags for an estimate of the correlation; with fewer, the whole error is treated
as the long part.
"""
WINDOW = 30
"""Epochs in the mean of the distances between fixes and predictions."""


class Correlation(NamedTuple):
    """Shares ``short`` and ``long`` of the variance of ranges or of rates, and the correlation
    ``time`` (s) of the short part.
    """

    short: float
    time: float
    long: float


def correlation(times: Array, left: Array, kept: Array, redundancy: int) -> Correlation:
    """Correlation of the residuals ``left (T, S)`` of fixes, in standard deviations, where the mask
    ``kept`` is true.

    An exponential and a constant are fitted to the autocorrelation at lags of 1, 2, 4, ... epochs,
    up to a quarter of the log. The constant, the long part, is raised by one standard error,
    because a value that is too small makes a filter overconfident. ``redundancy``: total redundancy
    of the fixes.
    """
    from scipy.optimize import nnls  # takes a second to import

    lags = 2 ** np.arange(int(np.log2(max(len(times) // 4, 1))) + 1)
    if len(lags) < LEAST_LAGS or not redundancy:
        return Correlation(0.0, 1.0, 1.0)
    values, spans = np.zeros((2, len(lags)))
    for i, lag in enumerate(lags.tolist()):
        both = kept[lag:] & kept[:-lag]
        early, late = np.where(both, left[:-lag], 0.0), np.where(both, left[lag:], 0.0)
        total = np.square(early).sum() + np.square(late).sum()
        values[i] = 2.0 * (early * late).sum() / total if total else 0.0
        spans[i] = np.median(times[lag:] - times[:-lag])
    fits = []
    for time in spans[:-1].tolist():
        rows = np.stack([np.exp(-spans / time), np.ones(len(spans))], -1)
        (short, long), misfit = nnls(rows, values)
        fits.append((misfit, short, time, long))
    _, short, time, long = min(fits)
    long = min(long + redundancy**-0.5, 1.0)
    return Correlation(min(short, 1.0 - long), time, long)


class Errors(NamedTuple):
    """True covariance of a filter's errors.

    cov: ``(n + 3, n + 3)``, of the errors of the state and of `mean`. cross: ``(2, n + 3, m)``,
        their cross-covariance with the short and the long errors of the measurements.
    mean: ``(3,)`` m, mean distance of fixes from predictions.
    """

    cov: Array
    cross: Array
    mean: Array

    @classmethod
    def at_start(cls, belief: Belief, m: int) -> Errors:
        """The errors of a filter that has just started."""
        cov = np.pad(belief.cov, (0, 3))
        return cls(cov, np.zeros((2, len(cov), m)), np.zeros(3))

    def predict(self, F: Array, before: Array, after: Array, decay: Array) -> Errors:
        """The errors after an interval.

        F: transition matrix ``(n, n)``. before, after: the filter's covariances. decay: ``phi``,
            ``(2, m)``.
        """
        n = len(F)
        Phi = block([[F, 0], [0, np.eye(3)]])
        cov = Phi @ self.cov @ Phi.T
        cov[:n, :n] += after - F @ before @ F.T  # the process noise
        return self._replace(cov=cov, cross=decay[:, None] * (Phi @ self.cross))

    def update(
        self, K: Array, H: Array, R: Array, slow: Array, G: Array, distance: Array | None
    ) -> Errors:
        """The errors after an update.

        K: gain ``(n, m)``. H: Jacobian ``(m, n)``. R: variances ``(m,)``.
        slow: ``(2, m)``, standard deviations of the short and the long errors.
        G: ``(3, m)``, maps measurements to the fix. distance: ``(3,)`` m, from the prediction to
            the fix; None: there is no fix.
        """
        n, mean = len(K), self.mean
        # A = [[I - K H, 0], [-g E, (1 - g) I]] and B = [K; g G], with g = 1 / WINDOW (see above).
        A, B = np.eye(n + 3), np.concatenate([K, np.zeros((3, K.shape[1]))])
        A[:n, :n] -= K @ H
        if distance is not None:
            share = 1.0 / WINDOW
            A[n:, :3], A[n:, n:] = -share * np.eye(3), (1.0 - share) * np.eye(3)
            B[n:] = share * G
            mean = (1.0 - share) * mean + share * distance
        cross = A @ self.cross
        lasting = ((cross * slow[:, None]) @ B.T).sum(0)
        cov = A @ self.cov @ A.T + (B * R) @ B.T + lasting + lasting.T
        return Errors(cov, cross + B * slow[:, None], mean)

    @property
    def squared_mean(self) -> float:
        """Squared Mahalanobis length of `mean`: chi-square with three degrees of freedom."""
        return float(self.mean @ np.linalg.lstsq(self.cov[-3:, -3:], self.mean)[0])
