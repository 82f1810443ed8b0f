"""Process noise of a receiver, estimated from its log: the random walks of its clock and velocity.

A value ``b`` and its rate ``d`` follow ``b' = d + white noise``, ``d' = white noise``, with the
densities ``white`` and ``walk``. For a clock in meters these densities describe white and
random-walk frequency noise. The Allan variance, times the speed of light squared, is
``white / t + walk t / 3``. A log has b and d at each epoch with errors of known variance. Over an
interval ``dt``

    u = b2 - b1 - dt (d1 + d2) / 2    has the variance  white dt + walk dt^3 / 12,
    v = d2 - d1                       has the variance  walk dt,

plus the variances of the errors; u and v are uncorrelated. Without rates the second difference
over two intervals,

    x = b3 - b2 - (b2 - b1) dt2 / dt1,

has the variance ``white dt2 (dt1 + dt2) / dt1 + walk dt2^2 (dt1 + dt2) / 3``. A short and a long
interval together determine both densities.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array

RESET = 5.0
"""A step above this number of standard deviations is not noise: the clock was set."""
ENOUGH = 10
"""Least number of steps for an estimate."""
LONG = 10
"""Epochs in a long interval, used without rates."""
ROUNDS = 30
MEDIAN_SQUARE = 0.4549364231195724
"""Median of the square of a standard normal variable."""


class Walk(NamedTuple):
    """Densities of process noise, ``white`` (m^2/s) of the value and ``walk`` (m^2/s^3) of its
    rate, and their standard deviations.

    ``steps``: how many steps the estimate used. ``reset``: ``(T,)`` m, steps to an epoch that are
    not noise; 0 elsewhere.
    """

    white: float
    walk: float
    white_std: float
    walk_std: float
    steps: int
    reset: Array

    @property
    def cautious(self) -> tuple[float, float]:
        """White and walk, each raised by its standard deviation. Process noise that is too small
        makes a filter overconfident; too much costs little.
        """
        return self.white + self.white_std, self.walk + self.walk_std


class Steps(NamedTuple):
    """Steps ``(K,)`` with mean 0 and the variance ``weights (K, c) @ densities + noise``; ``last``:
    the epochs ``(K,)`` at which they end.
    """

    size: Array
    weights: Array
    noise: Array
    last: Array


def walk_noise(
    times: Array, value: Array, rate: Array, value_var: Array, rate_var: Array
) -> Walk | None:
    """Process noise of a value, all arguments ``(T,)``, nan where unknown; None: too few steps.

    Steps of more than `RESET` standard deviations are left out.

    >>> walk_noise(log.times, bias, drift, bias_variance, drift_variance)
    """
    families = _with_rates(times, value, rate, value_var, rate_var)
    if len(families[0].size) < ENOUGH:
        short = _second_differences(times, value, value_var, 1)
        if len(short.size) < ENOUGH:
            return None
        reset = _resets(len(times), short, fit([short], RESET)[2])
        families = [short, _second_differences(times, value, value_var, LONG, reset > 0.0)]
    (white, walk), (white_std, walk_std), sudden = fit(families, RESET)
    reset = _resets(len(times), families[0], sudden)
    return Walk(white, walk, white_std, walk_std, len(families[0].size), reset)


def _resets(T: int, steps: Steps, sudden: Array) -> Array:
    """Sizes ``(T,)`` of the steps that are not noise."""
    reset, sudden = np.zeros(T), sudden[: len(steps.size)]
    reset[steps.last[sudden]] = np.abs(steps.size[sudden])
    return reset


def acceleration_noise(
    times: Array, position: Array, velocity: Array, position_var: Array, velocity_var: Array
) -> float | None:
    """Density (m^2/s^3) of a receiver's white acceleration per axis, raised by its standard
    deviation; None: too few steps.

    All arguments except ``times`` are ``(T, 3)``. All steps of the velocity are used, because
    maneuvers are rare and large. Without rates the estimate uses second differences of positions,
    except those above `RESET`.
    """
    series = zip(position.T, velocity.T, position_var.T, velocity_var.T, strict=True)
    walks, most = [_with_rates(times, *axis)[1] for axis in series], np.inf
    if len(walks[0].size) < ENOUGH:
        pairs = zip(position.T, position_var.T, strict=True)
        walks = [_second_differences(times, *pair, lag) for pair in pairs for lag in (1, LONG)]
        most = RESET
    if len(walks[0].size) < ENOUGH:
        return None
    density, std, _ = fit([steps._replace(weights=steps.weights[:, 1:]) for steps in walks], most)
    return float(density[0] + std[0])


def _with_rates(
    times: Array, value: Array, rate: Array, value_var: Array, rate_var: Array
) -> list[Steps]:
    """The steps u and v."""
    k = np.flatnonzero(np.isfinite(value) & np.isfinite(rate))
    t, b, d, b_var, d_var = (v[k] for v in (times, value, rate, value_var, rate_var))
    dt, zero = np.diff(t), np.zeros(max(len(k) - 1, 0))
    d_noise = d_var[1:] + d_var[:-1]
    u = np.diff(b) - 0.5 * dt * (d[1:] + d[:-1])
    u_noise = b_var[1:] + b_var[:-1] + 0.25 * dt**2 * d_noise
    return [
        Steps(u, np.stack([dt, dt**3 / 12.0], -1), u_noise, k[1:]),
        Steps(np.diff(d), np.stack([zero, dt], -1), d_noise, k[1:]),
    ]


def _second_differences(
    times: Array, value: Array, value_var: Array, lag: int, reset: Array | None = None
) -> Steps:
    """The steps x over two intervals of ``lag`` epochs, except intervals in which the clock was
    reset.

    Long intervals do not overlap.
    """
    k = np.flatnonzero(np.isfinite(value))[::lag]
    t, b, var = times[k], value[k], value_var[k]
    dt1, dt2 = np.diff(t)[:-1], np.diff(t)[1:]
    ratio = dt2 / dt1
    x = np.diff(b)[1:] - ratio * np.diff(b)[:-1]
    weights = np.stack([ratio * (dt1 + dt2), dt2**2 * (dt1 + dt2) / 3.0], -1)
    noise = var[2:] + (1.0 + ratio) ** 2 * var[1:-1] + ratio**2 * var[:-2]
    count = np.cumsum(np.zeros(len(times)) if reset is None else reset)
    calm = count[k[2:]] == count[k[:-2]]
    return Steps(x[calm], weights[calm], noise[calm], k[2:][calm])


def fit(families: Sequence[Steps], most: float) -> tuple[Array, Array, Array]:
    """Densities ``(c,)`` estimated from squared steps, their standard deviations, and which steps
    ``(K,)`` exceed ``most`` of their own standard deviations.

    The estimate is a weighted least-squares fit to the squared steps, with weights from the fitted
    variances; it solves the likelihood equations for normal steps. It starts from medians, which
    are robust to a few resets.
    """
    from scipy.optimize import nnls  # takes a second to import

    families = [steps for steps in families if len(steps.size)]
    middle = np.array([np.median(steps.weights, 0) for steps in families])
    excess = [
        np.median(steps.size**2) / MEDIAN_SQUARE - np.median(steps.noise) for steps in families
    ]
    density, _ = nnls(middle, np.maximum(excess, 0.0))
    square = np.concatenate([steps.size for steps in families]) ** 2
    weights = np.concatenate([steps.weights for steps in families])
    noise = np.concatenate([steps.noise for steps in families])
    for _ in range(ROUNDS):
        variance = weights @ density + noise
        usual = square <= most**2 * variance
        rows = (weights / variance[:, None])[usual]
        Q, R = np.linalg.qr(rows)
        before, (density, _) = density, nnls(R, Q.T @ ((square - noise) / variance)[usual])
        if np.allclose(density, before, rtol=1e-6, atol=0.0):
            break
    # The variance of a square is twice the squared variance. The diagonal of (R' R)^-1 has the sums
    # of squares of the rows of R^-1.
    std = np.sqrt(2.0 * np.square(np.linalg.pinv(R)).sum(-1))
    return density, std, ~usual
