"""Errors of ranges and rates that last: how long, and the covariance of a filter that treats them
as new at each epoch.

An error of standard deviation ``sigma`` is the sum of a white part, of a short part with the
correlation time ``time``, and of a long part that lasts as long as a satellite is in view:

    eps_k = w_k + s_1 beta_1,k + s_2 beta_2,k,    s_i = sigma sqrt(share_i),

with ``beta_i`` of unit variance, ``beta_i,k = phi_i beta_i,k-1 + ...``, and ``phi_2 = 1``. A filter
with gain K whose position errs by e, and the mean m of the distances of fixes from predictions over
a window, follow with ``a = (e, m)``

    a- = Phi a,    a+ = A a- + B eps,    A = [[I - K H, 0], [-g E, (1 - g) I]],    B = [K; g G],

where E picks the position, G gives the fix, and ``g`` is one over the window's length. So the
covariance of a, with the filter's own process noise and its cross-covariance C_i with ``beta_i``,
is

    cov+ = A cov- A' + B R B' + sum_i (A C_i- s_i B' + its transpose),    C_i+ = A C_i- + B s_i.

It is Schmidt's covariance of considered states, as in `celnav.filters.adaptive.consider`, for a
gain that stays the filter's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array, Belief, block

LEAST_LAGS = 3
"""Lags, or the correlation is not estimated, and all of an error counts as long."""
WINDOW = 30
"""Epochs in the mean of the distances between fixes and predictions."""


class Correlation(NamedTuple):
    """Shares ``short`` and ``long`` of the variance of a kind of measurement, and the correlation
    ``time`` (s) of the short part.
    """

    short: float
    time: float
    long: float


def correlation(times: Array, left: Array, kept: Array, redundancy: int) -> Correlation:
    """Correlation of the residuals ``left (T, S)`` of fixes, in deviations, where ``kept``.

    Their autocorrelation at lags of 1, 2, 4, ... epochs, up to a quarter of the log, is fitted by
    an exponential and a constant. The constant, the long part, is a standard error larger than
    estimated: too small a one makes a filter overconfident. ``redundancy``: of all fixes.
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
    """Covariance ``(n + 3, n + 3)`` of the errors of a filter's state and of `mean`, the mean
    ``(3,)`` of the distances of fixes from predictions; and the cross-covariance
    ``(2, n + 3, m)`` with the short and the long errors of the measurements.
    """

    cov: Array
    cross: Array
    mean: Array

    @classmethod
    def at_start(cls, belief: Belief, m: int) -> Errors:
        """Of a filter that has just started."""
        cov = np.pad(belief.cov, (0, 3))
        return cls(cov, np.zeros((2, len(cov), m)), np.zeros(3))

    def predict(self, F: Array, before: Array, after: Array, decay: Array) -> Errors:
        """After an interval: the transition matrix, the filter's covariances before and after it,
        and ``phi (2, m)``.
        """
        n = len(F)
        Phi = block([[F, 0], [0, np.eye(3)]])
        cov = Phi @ self.cov @ Phi.T
        cov[:n, :n] += after - F @ before @ F.T  # the process noise
        return self._replace(cov=cov, cross=decay[:, None] * (Phi @ self.cross))

    def update(
        self, K: Array, H: Array, R: Array, slow: Array, G: Array, distance: Array | None
    ) -> Errors:
        """After an update with gain ``K (n, m)``, Jacobian ``H (m, n)``, variances ``R (m,)``,
        deviations ``slow (2, m)`` of the short and the long errors, and the ``distance (3,)`` of a
        fix from the prediction; ``G (3, m)`` gives the fix. None: there is no fix.
        """
        n, mean = len(K), self.mean
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
        """Squared size of `mean` in deviations, chi-square with three degrees."""
        return float(self.mean @ np.linalg.lstsq(self.cov[-3:, -3:], self.mean)[0])
