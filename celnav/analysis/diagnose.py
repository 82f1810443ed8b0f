"""Tests of a log: whether innovations or residuals are white, unbiased and as large as predicted;
and which noise explains them if they are not.

Correlated errors are not independent, so intervals of means and mean squares use an *effective*
number of samples, from the autocorrelation [Geyer1992]. The whiteness test is Ljung and Box's
[Ljung1978], with the pairs of samples that both exist. Lags count samples of a component on its own
time grid: a slow sensor has its own lags, and a gap removes only the pairs across it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike
from scipy.special import bdtrc, chdtrc, expit, ndtri, stdtr, stdtrit

from celnav.analysis.metrics import chi_square_band
from celnav.filters.colored import augmented, colored
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import as_seconds, epochs
from celnav.filters.run import run
from celnav.filters.sequential import Sequential
from celnav.filters.track import Track
from celnav.gaussian.checks import finite, integer, number, numbers, sequence
from celnav.gaussian.linalg import FORMS, Array
from celnav.gaussian.spaces import EUCLIDEAN, wrap

__all__ = ["Diagnosis", "diagnose", "first_order"]

LEAST = 20  # smallest number of samples of a component, and of pairs of samples, for a test
SMALL = 1.1  # largest ratio of a mean's σ to its σ under white noise, for nearly white noise
REACH = -3.5, 5.5  # search range of arctanh(phi)
SHARE = -14.0, 7.0  # search range of the logit of the white share of the variance
EACH = 3  # largest number of components with a coefficient of their own
BETTER = 3.0  # difference of log-likelihoods that decides between two explanations
QUIET = 5  # number of innovations near 0 before a jump by a turn
CHANCE = 1e-3  # largest accepted probability that jumps of random size are turns by chance

Interval = tuple[float, float]


class Mixture(NamedTuple):
    """First-order noise plus white noise: ``phi``, and σ of both.

    mean_sigma: σ of the mean of the samples, by generalized least squares. gain: increase of the
    log-likelihood relative to first-order noise alone. p: Ljung and Box's p of the innovations.
    """

    phi: float
    sigma: float
    white_sigma: float
    mean_sigma: float
    gain: float
    p: float


class Coloring(NamedTuple):
    """Noise ``V' = phi V + zeta`` with σ ``sigma``, by restricted maximum likelihood.

    Intervals are from the likelihood ratio. mean_sigma: σ of the mean of the samples under this
    noise, by generalized least squares. p: Ljung and Box's p of the innovations. If it is small,
    first-order noise does not explain the correlation, and ``mixture`` is fitted too.
    """

    phi: float
    phi_interval: Interval
    sigma: float
    sigma_interval: Interval
    mean_sigma: float
    p: float
    mixture: Mixture | None


class Component(NamedTuple):
    """Statistics of one component, in its own unit.

    sensor: index of its sensor. samples: number of samples. step: interval of its samples, s; None
        if it is irregular.
    rms: RMS of the residuals. predicted: RMS of the predicted σ; None if unknown.
    bias, bias_interval: mean of the residuals. bias_p: probability of a mean at least as far from 0
        without a bias.
    effective: number of independent samples whose mean has the same uncertainty, for residuals
        divided by their predicted σ.
    size, size_band: mean square of the residuals divided by their predicted σ (None if unknown),
        and its band if the prediction is correct.
    effective_squares: number of independent samples whose mean square has the same uncertainty.
    autocorrelation, band: ``(lags,)``, at lags of 1, 2, ... samples, and the half width of the band
        of white noise; nan without pairs.
    ljung_box, p: the statistic, and the probability of a value at least as large for white noise;
        nan for too few pairs of samples.
    coloring: fitted first-order noise, None for white noise; for a track, of the whitened
        innovations.
    """

    name: str
    sensor: int
    samples: int
    step: float | None
    rms: float
    predicted: float | None
    bias: float
    bias_interval: Interval
    bias_p: float
    effective: float
    size: float | None
    size_band: Interval
    effective_squares: float
    autocorrelation: Array
    band: Array
    ljung_box: float
    p: float
    coloring: Coloring | None

    @property
    def longer(self) -> float:
        """Ratio of the σ of its mean to the σ under white noise."""
        return float(np.sqrt(self.samples / self.effective))


class SensorConsistency(NamedTuple):
    """Consistency of a sensor's residuals with their predicted σ.

    nis: mean NIS per degree of freedom; nan without predicted σ. band: its band if consistent.
    squares, dof: ``(T,)``, sums over all runs; their ratio is the NIS per degree of freedom over
        time.
    shared: ratio of the number of samples to the effective number.
    """

    names: tuple[str, ...]
    nis: float
    band: Interval
    squares: Array
    dof: Array
    shared: float


class Factors(NamedTuple):
    """The filter of the track with the maximum-likelihood factors of Q and R, for white noise.

    Q, R: factors of the matrices. Q_interval, R_interval: intervals of the factors.
    gain: increase of the log-likelihood relative to the original filter.
    predicted: ``(n,)`` standard deviations at the end.
    p: ``(m,)``, Ljung and Box's p of the innovations.
    degenerate: why the likelihood has no interior maximum; "" if it has one.
    """

    Q: float
    R: float
    Q_interval: Interval
    R_interval: Interval
    gain: float
    predicted: Array
    p: Array
    degenerate: str


class Model(NamedTuple):
    """A filter for colored noise, fitted to the data: ``Phi (m, m)`` and ``R (m, m)``.

    name: "colored", or "augmented" if samples are missing or `celnav.colored` does not support the
        noises. Phi acts from epoch to epoch.
    phi_interval, sigma_interval: ``(m, 2)``.
    gain: increase of the log-likelihood relative to the original filter, which assumes white noise.
    factors: the alternative, other Q and R; None if not compared. not_compared: why not.
    predicted, white_predicted: ``(n,)`` standard deviations at the end, of this filter and of the
        original filter.
    p: ``(m,)``, Ljung and Box's p of the innovations. degenerate: as in `Factors`.
    """

    name: str
    Phi: Array
    R: Array
    phi_interval: Array
    sigma_interval: Array
    gain: float
    factors: Factors | None
    not_compared: str
    predicted: Array
    white_predicted: Array
    p: Array
    degenerate: str

    @property
    def white_gain(self) -> float:
        """The gain of white noise with maximum-likelihood factors; nan if not compared."""
        return np.nan if self.factors is None else self.factors.gain

    @property
    def is_color(self) -> bool:
        """Whether colored noise has a higher likelihood than white noise with other Q and R."""
        return self.gain > self.white_gain + BETTER

    @property
    def is_white(self) -> bool:
        """Whether white noise with other Q and R has a higher likelihood than colored noise."""
        return self.white_gain > self.gain + BETTER


class Diagnosis(NamedTuple):
    """Results of the tests of a log. ``print`` shows them as a page, `celnav.show.diagnosis.figure`
    as a figure.

    times: ``(T,)`` s. step: interval of the epochs, s; None if it is irregular. runs: number of
        runs.
    level: probability of all intervals and bands. components, sensors: statistics.
    wraps: a sentence for each sensor whose angles seem to lack a wrap.
    model: the filter for colored noise; None if it could not be fitted. why: why it could not.
    """

    times: Array
    step: float | None
    runs: int
    level: float
    components: tuple[Component, ...]
    sensors: tuple[SensorConsistency, ...]
    wraps: tuple[str, ...]
    model: Model | None
    why: str

    @property
    def doubt(self) -> float:
        """The smallest accepted p of one component, so that `level` holds for all components
        together.
        """
        return (1.0 - self.level) / len(self.components)

    def biased(self, component: Component) -> bool:
        """Whether the mean of a component differs significantly from 0."""
        return component.bias_p < self.doubt

    def white(self, component: Component) -> str:
        """Return "white", "nearly white" (correlation is significant, but has little effect),
        "colored" or "unknown".
        """
        if np.isnan(component.p):
            return "unknown"
        if component.p >= self.doubt:
            return "white"
        return "nearly white" if 1.0 / SMALL < component.longer < SMALL else "colored"

    @property
    def sound(self) -> bool:
        """Whether all components are white or nearly white, unbiased, and as large as predicted."""
        quiet = all("white" in self.white(c) and not self.biased(c) for c in self.components)
        return (
            quiet
            and not self.wraps
            and all(np.isnan(s.nis) or s.band[0] <= s.nis <= s.band[1] for s in self.sensors)
        )

    def __str__(self) -> str:
        from celnav.analysis.diagnosis_text import page

        return page(self)


def diagnose(
    residuals: Track | ArrayLike,
    times: ArrayLike | None = None,
    *,
    std: ArrayLike | None = None,
    names: Sequence[str] | None = None,
    prior: Any = None,
    z: Any = None,
    u: Any = None,
    lags: int = 20,
    level: float = 0.95,
) -> Diagnosis:
    """Test whether innovations or residuals are white, unbiased and as large as predicted; return a
    `Diagnosis`.

    residuals: a track, whose innovations are used; or an array ``(T, ..., m)``, nan where missing,
        with ``times (T,)`` s. All runs are assumed to be draws of the same noise.
    std: predicted standard deviations, which broadcast to the residuals. Without them, the size of
        an array's residuals is not tested.
    names: names ``(m,)`` of the components.
    prior, z, u: the arguments of the run that made the track. With them, if the noise is not white,
        a filter for colored noise is fitted by maximum likelihood.
    lags: largest lag of the autocorrelation, in samples of a component; fewer for short data.
    level: probability of intervals and bands.

    ValueError for a track without innovations, arrays that do not match, times that do not
    increase, or a component with fewer than 20 samples.

    >>> print(celnav.analysis.diagnose.diagnose(track, prior=prior, z=z))
    """
    lags, level = integer("lags", lags, 1, 10_000), number("level", level, above=0.0, below=1.0)
    filter, predicted = None, None
    widths: tuple[int, ...] = ()
    if isinstance(residuals, Track):
        filter, t, widths = residuals.filter, residuals.times, residuals.sensors
        if residuals.whitened is None:
            raise ValueError(
                "residuals: expected a track with innovations, got one without; run with keep='std'"
            )
        raw = residuals.innovation
        x, w = (np.where(residuals.used, rows, np.nan) for rows in (raw, residuals.whitened))
    else:
        raw = x = numbers("residuals", residuals)
        if times is None:
            raise ValueError("times: expected times with an array of residuals, got None")
        t = finite("times", as_seconds(times), ("T",))
        if x.ndim and len(x) != len(t) == 1:
            raise ValueError(f"times: expected one time for each of {len(x)} residuals, got 1")
        if x.ndim < 2 or len(x) != len(t) or not x.size or np.isinf(x).any():
            raise ValueError(
                f"residuals: expected shape ({len(t)}, ..., m) to go with the times, "
                f"finite or nan, got {x.shape}"
            )
        if std is not None:
            predicted = _predicted(numbers("std", std), x)
        w = x if predicted is None else x / predicted
    if (np.diff(t) <= 0.0).any():
        raise ValueError(
            f"times: expected increasing times, got a difference of {np.diff(t).min():.6g} s"
        )
    T, m = len(t), x.shape[-1]
    x, w, raw = (rows.reshape(T, -1, m) for rows in (x, w, raw))
    if names is None:
        names = residuals.measured if isinstance(residuals, Track) else [f"z{i}" for i in range(m)]
    called = list(sequence("names", names, "['x', 'y']"))
    if len(called) != m or not all(isinstance(name, str) for name in called):
        raise ValueError(
            f"names: expected {m} strings, one for each component, such as ['x', 'y'], "
            f"got {names!r:.80}"
        )
    widths = widths or (m,)
    sensor = np.repeat(range(len(widths)), widths)
    scaled = predicted is not None or filter is not None
    sigma = None if predicted is None else predicted.reshape(T, -1, m)
    components = tuple(
        _component(
            called[i],
            int(sensor[i]),
            x[..., i],
            w[..., i],
            None if sigma is None else sigma[..., i],
            scaled,
            t,
            lags,
            level,
        )
        for i in range(m)
    )
    sensors = tuple(
        _sensor(w, np.flatnonzero(sensor == k), components, scaled, level)
        for k in range(len(widths))
    )
    wraps = forgotten_wraps(raw, widths, called, z)
    diagnosis = Diagnosis(
        t, grid_index(t)[1], x.shape[1], level, components, sensors, wraps, None, ""
    )
    if all(diagnosis.white(c) != "colored" for c in components):
        return diagnosis
    if wraps:
        return diagnosis._replace(why="wrap the angle first: the jumps alone make noise colored")
    gaps = not np.isfinite(x).all()
    model, why = _model(filter, prior, t, z, u, components, gaps, diagnosis.step, level)
    return diagnosis._replace(model=model, why=why)


def _predicted(std: Array, x: Array) -> Array:
    """Checked standard deviations with the shape of the residuals."""
    if std.ndim > x.ndim or any(
        k not in (1, n) for k, n in zip(std.shape[::-1], x.shape[::-1], strict=False)
    ):
        raise ValueError(
            f"std: expected a shape that broadcasts to the residuals' {x.shape}, got {std.shape}"
        )
    std = np.broadcast_to(std, x.shape)
    if not ((std > 0.0) & (std < np.inf))[np.isfinite(x)].all():
        raise ValueError(
            "std: expected positive finite standard deviations for all residuals, got others"
        )
    return std


def grid_index(t: Array) -> tuple[Array, float | None]:
    """Integer positions ``(T,)`` of times on a regular grid, and the grid's step, s; without a
    grid, the indices of the times and None.

    The step is near the median interval or, if most samples are missing, near the smallest.
    """
    d = np.diff(t)
    for unit in (np.median(d), d.min()) if len(t) > 2 else ():
        steps = np.maximum(np.rint(d / unit), 1.0)
        step = float((t[-1] - t[0]) / steps.sum())
        if (np.abs(d - steps * step) < 0.1 * step).all():
            return np.concatenate([[0], np.cumsum(steps.astype(np.int64))]), step
    return np.arange(len(t)), None


def _products(x: Array, place: Array, lag: int) -> tuple[float, int]:
    """Mean product of samples ``(T, runs)`` at a lag (nan without pairs), and number of pairs."""
    later = np.minimum(np.searchsorted(place, place + lag), len(place) - 1)
    both = place[later] == place + lag
    products = x[both] * x[later[both]]
    count = int(np.isfinite(products).sum())
    return float(np.nansum(products)) / count if count else np.nan, count


def autocorrelation(x: Array, place: Array, lags: int) -> tuple[Array, Array, float, float]:
    """Autocorrelation ``(lags,)`` of ``x (T, runs)`` about its mean, numbers of pairs ``(lags,)``,
    and two variance ratios.

    These are the variances of the means of x and of x^2, relative to independent samples, for
    Gaussian noise. Lags without pairs are nan.
    """
    N = int(np.isfinite(x).sum())
    centered = x - np.nanmean(x)
    variance = float(np.nanmean(centered**2))
    rho, pairs, used, end = [1.0], [N], [0], 0  # the first `end` of the lags used are summed
    for lag in range(1, max(lags, min(int(place[-1]) // 2, len(place))) + 1):
        product, count = _products(centered, place, lag)
        rho.append(product / variance)
        pairs.append(count)
        if count:
            used.append(lag)
        if end + 1 < len(used):  # sums of two adjacent lags are positive for a stationary process
            if rho[used[end]] + rho[used[end + 1]] > 0.0:
                end += 2
            elif lag >= lags:
                break
    summed = used[: end if len(used) > 1 else 1]
    sums = np.array(rho)[summed]
    weights = np.where(np.array(summed) > 0, 2.0, 1.0) * np.array(pairs)[summed] / N
    longer = plain = max(float(weights @ sums), 1.0 / N)
    # Subtracting the mean reduces each product by the variance of the mean: iterate.
    for _ in range(20):
        shift = min(longer / N, 0.5)
        longer = max(float(weights @ ((1.0 - shift) * sums + shift)), plain)
    excess = np.maximum(sums[1:] ** 2 - 1.0 / np.array(pairs)[summed[1:]], 0.0)
    squares = 1.0 + float(weights[1:] @ excess)
    shown = slice(1, lags + 1)
    return np.array(rho[shown]), np.array(pairs[shown]), min(longer, N / 2.0), squares


def _ljung_box(rho: Array, pairs: Array, N: int, fitted: int = 0) -> tuple[float, float]:
    """Ljung and Box's statistic and its p; nan for too few pairs."""
    if pairs.sum() < LEAST:
        return np.nan, np.nan
    statistic = float(np.nansum(rho**2 * pairs) * (N + 2.0) / N)
    return statistic, float(chdtrc(max(int((pairs > 0).sum()) - fitted, 1), statistic))


def _whiteness(x: Array, place: Array, lags: int, fitted: int) -> float:
    """Ljung and Box's p of innovations ``(T, runs)`` of a fitted model."""
    rho, pairs, *_ = autocorrelation(x, place, lags)
    return _ljung_box(rho, pairs, int(np.isfinite(x).sum()), fitted)[1]


def _component(
    name: str,
    sensor: int,
    x: Array,
    w: Array,
    sigma: Array | None,
    scaled: bool,
    t: Array,
    lags: int,
    level: float,
) -> Component:
    """Statistics of residuals ``x (T, runs)``; ``w`` is x divided by the predicted ``sigma``."""
    present = np.isfinite(x)
    N = int(present.sum())
    if N < LEAST or np.ptp(x[present]) == 0.0:
        got = f"{N} samples" if N < LEAST else f"only {x[present][0]:g}"
        raise ValueError(
            f"residuals: expected at least {LEAST} samples that vary for each component, "
            f"got {got} for {name}"
        )
    sampled = present.any(1)
    place, step = grid_index(t[sampled])
    rms_sigma = None if sigma is None else float(np.sqrt(np.mean(sigma[present] ** 2)))
    x, w = x[sampled], w[sampled]
    lags = max(1, min(lags, N // 5, int(place[-1]) // 2))
    # A bias divided by a σ that changes would look like noise.
    even = w if sigma is None else (x - np.nanmean(x)) / sigma[sampled]
    rho, pairs, shared, squares = autocorrelation(even, place, lags)
    *_, longer, _ = autocorrelation(x, place, lags)
    statistic, p = _ljung_box(rho, pairs, N)
    mean, deviation = float(np.nanmean(x)), float(np.nanstd(x))
    freedom, mean_sigma = max(N / longer - 1.0, 1.0), deviation * float(np.sqrt(longer / N))
    half = float(stdtrit(freedom, 0.5 + level / 2)) * mean_sigma
    noise = w if sigma is None else x
    return Component(
        name=name,
        sensor=sensor,
        samples=N,
        step=step,
        rms=float(np.sqrt(np.nanmean(x**2))),
        predicted=rms_sigma,
        bias=mean,
        bias_interval=(mean - half, mean + half),
        bias_p=float(2.0 * stdtr(freedom, -abs(mean) / mean_sigma)),
        effective=N / shared,
        size=float(np.nanmean(w**2)) if scaled else None,
        size_band=chi_square_band(1.0, N / squares, level),
        effective_squares=N / squares,
        autocorrelation=rho,
        band=float(ndtri(0.5 + level / 2)) / np.sqrt(np.where(pairs > 0, pairs, np.nan)),
        ljung_box=statistic,
        p=p,
        coloring=first_order(noise, place, lags, level) if p < 1.0 - level else None,
    )


def first_order(x: Array, place: Array, lags: int, level: float) -> Coloring:
    """Fit first-order noise with an unknown mean to samples ``(T, runs)`` at integer positions
    ``place (T,)``; return a `Coloring`.

    It maximizes the exact restricted likelihood, which does not depend on the mean; gaps are
    allowed. If correlation remains, a mixture with white noise is fitted too.

    >>> place = np.arange(len(z))
    >>> coloring = celnav.analysis.diagnose.first_order(z[:, :1, 0], place, lags=5, level=0.95)
    """
    from scipy.linalg import cholesky_banded, solve_banded
    from scipy.optimize import brentq, minimize, minimize_scalar

    present = np.isfinite(x).T
    run_of, at = np.nonzero(present)  # one run after the other
    samples, N = x.T[present], int(present.sum())
    first = np.diff(run_of, prepend=-1) > 0
    gap = np.where(first, 1, np.diff(place[at], prepend=0))
    before = np.where(first, 0.0, np.roll(samples, 1))

    def fit(v: float, logit: float = -np.inf) -> tuple[float, float, Array, float]:
        """Cost, σ, innovations of unit variance, and σ of the mean, for ``phi = tanh v`` and white
        noise with the fraction ``expit(logit)`` of the variance.
        """
        a = np.where(first, 0.0, np.tanh(v) ** gap)
        scale = np.sqrt(1.0 - a * a)
        rows = np.stack([samples - a * before, 1.0 - a], -1) / scale[:, None]
        half_log_det, white = float(np.log(scale).sum()), float(expit(logit))
        if white > 0.0:
            # With B, the bidiagonal whitening of first-order noise alone, the covariance of B x is
            # (1 - white) I + white B B', tridiagonal. Its Cholesky factor gives the innovations.
            diagonal = 1.0 - white + white * (1.0 + a * a) / scale**2
            below = -white * np.roll(a / scale, -1) / scale
            factor = cholesky_banded(np.stack([diagonal, below]), lower=True)
            rows = solve_banded((1, 0), factor, rows)
            half_log_det += float(np.log(factor[0]).sum())
        left, weight = rows.T
        information = float(weight @ weight)
        # Generalized least squares for the mean, then the restricted likelihood of what remains.
        left = left - float(weight @ left) / information * weight
        variance = float(left @ left) / (N - 1)
        cost = 0.5 * ((N - 1) * np.log(variance) + np.log(information)) + half_log_det
        return cost, np.sqrt(variance), left / np.sqrt(variance), np.sqrt(variance / information)

    def whiteness(innovations: Array, fitted: int) -> float:
        rest = np.full(present.shape, np.nan)
        rest[present] = innovations
        return _whiteness(rest.T, place, lags, fitted)

    tried, half = np.linspace(*REACH, 37), 0.5 * float(ndtri(0.5 + level / 2)) ** 2
    best = float(tried[int(np.argmin([fit(v)[0] for v in tried]))])
    near = max(best - 0.25, REACH[0]), min(best + 0.25, REACH[1])
    v = float(minimize_scalar(lambda v: fit(v)[0], bounds=near, method="bounded").x)
    least, sigma, innovations, mean_sigma = fit(v)
    p, mixture = whiteness(innovations, 1), None
    if p < 1.0 - level:
        grid = [(v, logit) for v in np.linspace(*REACH, 10) for logit in np.linspace(*SHARE, 8)]
        start: Any = min([(v, SHARE[0]), *grid], key=lambda point: fit(*point)[0])
        optimum = minimize(  # type: ignore[call-overload]
            lambda point: fit(*point)[0], start, method="Nelder-Mead", bounds=[REACH, SHARE]
        )
        cost, total, innovations, uncertainty = fit(*optimum.x)
        share = float(expit(optimum.x[1]))
        mixture = Mixture(
            phi=float(np.tanh(optimum.x[0])),
            sigma=float(total * np.sqrt(1.0 - share)),
            white_sigma=float(total * np.sqrt(share)),
            mean_sigma=float(uncertainty),
            gain=max(float(least - cost), 0.0),  # its limit is first-order noise alone
            p=whiteness(innovations, 2),
        )

    def beyond(u: float) -> float:
        return fit(u)[0] - least - half

    ends = [float(brentq(beyond, v, end)) if beyond(end) > 0.0 else end for end in REACH]
    low, high = (float(np.hypot(np.log(fit(end)[1] / sigma), np.sqrt(half / N))) for end in ends)
    return Coloring(
        phi=float(np.tanh(v)),
        phi_interval=(float(np.tanh(ends[0])), float(np.tanh(ends[1]))),
        sigma=float(sigma),
        sigma_interval=(float(sigma * np.exp(-low)), float(sigma * np.exp(high))),
        mean_sigma=float(mean_sigma),
        p=p,
        mixture=mixture,
    )


def _sensor(
    w: Array, at: Array, components: Sequence[Component], scaled: bool, level: float
) -> SensorConsistency:
    """Consistency of the components ``at`` of a sensor, from normalized residuals
    ``w (T, runs, m)``.
    """
    members = [components[i] for i in at]
    squares, dof = np.nansum(w[..., at] ** 2, (1, 2)), np.isfinite(w[..., at]).sum((1, 2))
    # A sum of correlated squares varies like a sum of fewer independent squares.
    count = int(dof.sum())
    fewer = count**2 / sum(c.samples**2 / c.effective_squares for c in members)
    return SensorConsistency(
        names=tuple(c.name for c in members),
        nis=float(squares.sum() / count) if scaled else np.nan,
        band=chi_square_band(1.0, fewer, level),
        squares=squares,
        dof=dof,
        shared=count / fewer,
    )


def forgotten_wraps(
    x: Array, widths: Sequence[int], names: Sequence[str], z: Any = None, model: str = "Sensor"
) -> tuple[str, ...]:
    """A sentence for each model with angles that lack a wrap, whose innovations jump by 2 pi.

    x: ``(T, runs, m)``, innovations of all models. widths: number of components of each model.
    z: measurements, if available; an angle that wraps lies in [-pi, pi] or [0, 2 pi].
    """
    tables = [table for table in (z if isinstance(z, tuple) else (z,)) if table is not None]
    columns = [
        column
        for table in tables
        for column in np.moveaxis(numbers("z", table, (..., "T", "m")), -1, 0)
    ]
    measured: Sequence[Array | None] = (
        columns if len(columns) == x.shape[-1] else [None] * x.shape[-1]
    )
    counts = [_jumps(x[..., i], column) for i, column in enumerate(measured)]
    sentences, first = [], 0
    for width in widths:
        angles = np.flatnonzero(counts[first : first + width]).tolist()
        if angles:
            called = ", ".join(names[first + i] for i in angles)
            jumps = sum(counts[first + i] for i in angles)
            samples = int(np.isfinite(x[..., [first + i for i in angles]]).sum())
            sentences.append(
                f"{called}: {jumps} of {samples} samples jump by 2 pi, as those of an angle whose "
                f"wrap is forgotten; the cure is celnav.{model}(..., space=celnav.angles({angles}))"
            )
        first += width
    return tuple(sentences)


def _jumps(x: Array, z: Array | None) -> int:
    """Number of innovations ``(T, runs)`` that jump from near 0 to near a multiple of 2 pi; 0 if
    chance may explain them.

    If the measurements z are wrapped, one jump suffices. Otherwise, jumps of random size must be
    very unlikely to produce so many turns.
    """
    x = x[np.isfinite(x).any(1)]
    size = np.abs(x)
    calm = size[np.logical_and.accumulate(~(size >= np.pi))]  # of each run, before its first jump
    if len(x) <= QUIET or not np.isfinite(calm).any():
        return 0
    near = 4.0 * 1.4826 * float(np.nanmedian(calm))
    before = np.fmax.reduce(sliding_window_view(size, QUIET, 0)[:-1], -1)
    jump = (before <= near) & (size[QUIET:] > np.pi)
    turn = jump & (np.abs(wrap(x[QUIET:])) <= near)
    jumps, turns = int(jump.sum()), int(turn.sum())
    chance = float(bdtrc(turns - 1, jumps, min(near / np.pi, 1.0))) if turns else 1.0
    if z is not None:
        low, high = np.nanmin(z), np.nanmax(z)
        wrapped = max(-np.pi - low, high - np.pi) < near or max(-low, high - 2.0 * np.pi) < near
        chance = 0.0 if wrapped else 1.0
    return turns if near < 0.5 * np.pi and 3 * turns >= jumps and chance < CHANCE else 0


def _model(
    filter: Any,
    prior: Any,
    t: Array,
    z: Any,
    u: Any,
    components: Sequence[Component],
    gaps: bool,
    step: float | None,
    level: float,
) -> tuple[Model | None, str]:
    """The fitted filter for colored noise, or None and the reason."""
    from celnav.analysis.tuning import maximize_likelihood  # imported only for a search

    if filter is None:
        return None, ""
    sensors: Any = getattr(filter, "sensors", ())
    noise: Any = sensors[0].noise if len(sensors) == 1 else None
    flat = type(filter) is Sequential and all(
        model.space == EUCLIDEAN and not model.augment for model in (filter.motion, *sensors)
    )
    constant = isinstance(noise, np.ndarray) and noise.ndim == 2
    if not (flat and constant and filter.gain is None):
        return (
            None,
            "celnav.colored is for one sensor of vectors with a constant R; celnav.augmented "
            "carries other noise in the state",
        )
    if prior is None or z is None:
        return (
            None,
            "diagnose(track, prior=prior, z=z) estimates Phi and R, and gives the σ that a filter "
            "with them predicts",
        )
    sensor, motion, R, m = sensors[0], filter.motion, noise @ noise.T, len(noise)
    form = next(name for name, form in FORMS.items() if form is filter.form)
    hooks = filter.hooks[0] if filter.hooks else ()
    count, data = m if m <= EACH else 1, epochs(t, z, u)
    # `colored` uses differences of measurements: each missing sample costs two, and noise must be
    # constant.
    through = callable(sensor.h) and callable(motion.noise)
    make: Any = augmented if gaps or through else colored

    def matrices(p: Array) -> tuple[Array, Array]:
        phi, s = (np.broadcast_to(values, m) for values in (p[:count], p[count:]))
        return np.diag(phi), R * s * s[:, None]

    def build(p: Array) -> tuple[Any, Any]:
        Phi, cov = matrices(p)
        noisy = Sensor(sensor.h, cov, jacobian=sensor.jacobian)
        return make(motion, noisy, Phi, rule=filter.rule, form=form, hooks=hooks), prior

    def white(p: Array) -> tuple[Any, Any]:
        noisy = Sensor(sensor.h, p[1] ** 2 * R, jacobian=sensor.jacobian)
        return replace(filter, motion=_louder(motion, p[0]), sensors=(noisy,)), prior

    strides = [(c.step or 1.0) / (step or c.step or 1.0) for c in components]
    first = np.array([np.nan_to_num(c.autocorrelation[0], nan=0.5) for c in components])
    first = np.clip(first, 0.05, 0.95) ** (1.0 / np.maximum(strides, 1.0))
    start = np.concatenate([first if count == m else [first.mean()], np.ones(count)])
    z_level = float(ndtri(0.5 + level / 2))

    def at_end(track: Track) -> Array:
        """Final standard deviations ``(n,)`` of the original filter's states, mean over runs."""
        std = track.std[-1, ..., : baseline.std.shape[-1]]
        return np.asarray(std.reshape(-1, std.shape[-1]).mean(0))

    def whiteness(track: Track) -> Array:
        """Ljung and Box's p ``(m,)`` of the innovations, each component on its own grid."""
        innovations = np.where(track.used, track.whitened, np.nan).reshape(len(t), -1, m)
        sampled = [np.isfinite(innovations[..., i]).any(1) for i in range(m)]
        return np.array(
            [
                _whiteness(innovations[at, :, i], grid_index(t[at])[0], len(c.band), 1)
                for i, (at, c) in enumerate(zip(sampled, components, strict=True))
            ]
        )

    factors, not_compared = None, ""
    with np.errstate(all="ignore"):  # a search tries extreme parameters
        try:
            tuned = maximize_likelihood(
                build, start, data, domain=[(-1.0, 1.0)] * count + ["positive"] * count
            )
            fitted, baseline = (
                run(*built, data) for built in (build(tuned.parameters), (filter, prior))
            )
        except (ValueError, ArithmeticError) as error:
            return None, f"the filter for colored noise could not be fitted: {error}"
        before = float(baseline.log_likelihood.sum())
        try:
            scaled = maximize_likelihood(white, [1.0, 1.0], data)
            track = run(*white(scaled.parameters), data)
        except (ValueError, ArithmeticError) as error:
            not_compared = str(error)
        else:
            # The parameters scale standard deviations; the factors scale variances.
            squares = scaled.parameters**2
            reach = np.exp(2.0 * z_level * np.sqrt(scaled.covariance.diagonal()))
            low, high = (squares / reach).tolist(), (squares * reach).tolist()
            factors = Factors(
                Q=float(squares[0]),
                R=float(squares[1]),
                Q_interval=(low[0], high[0]),
                R_interval=(low[1], high[1]),
                gain=scaled.log_likelihood - before,
                predicted=at_end(track),
                p=whiteness(track),
                degenerate=_degenerate(scaled, ["Q", "R"]),
            )
    Phi, cov = matrices(tuned.parameters)
    reach = z_level * np.sqrt(tuned.covariance.diagonal())
    doubt, ratio = (np.broadcast_to(values, m) for values in (reach[:count], np.exp(reach[count:])))
    half, sigma = np.arctanh(Phi.diagonal()), np.sqrt(cov.diagonal())
    called = [c.name for c in components] if count > 1 else [""]
    parameters = [f"{what} {name}".strip() for what in ("Phi", "R") for name in called]
    return Model(
        name=make.__name__,
        Phi=Phi,
        R=cov,
        phi_interval=np.tanh(np.stack([half - 0.5 * doubt, half + 0.5 * doubt], -1)),
        sigma_interval=np.stack([sigma / ratio, sigma * ratio], -1),
        gain=float(fitted.log_likelihood.sum()) - before,
        factors=factors,
        not_compared=not_compared,
        predicted=at_end(fitted),
        white_predicted=at_end(baseline),
        p=whiteness(fitted),
        degenerate=_degenerate(tuned, parameters),
    ), ""


def _degenerate(tuned: Any, names: Sequence[str]) -> str:
    """Why a search has no interior maximum, with the parameters' names; "" if it has one."""
    why = re.sub(r"parameter (\d+)", lambda match: names[int(match[1])], tuned.message)
    return "" if tuned.converged else re.split(r";|(?<=of its range),", why)[0]


def _louder(motion: Motion, factor: float) -> Motion:
    """A motion with its noise times a factor."""
    noise: Any = motion.noise
    if callable(noise):
        return replace(motion, Q=None, sqrt_Q=lambda mean, epoch: factor * noise(mean, epoch))
    return replace(motion, Q=None, sqrt_Q=factor * noise)
