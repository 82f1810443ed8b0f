"""Ask the log: are innovations or residuals white, without bias and as large as claimed? If not, what noise would explain them?

Errors that follow each other are not independent, so what is said of a mean or of a size counts an *effective* number of them, by
their autocorrelation [Geyer1992]. Whiteness is the test of [Ljung1978], of pairs of samples that both exist: gaps and
missing components cost nothing but themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, ndtri, stdtr, stdtrit

from celnav.analysis.metrics import chi_square_band
from celnav.filters.colored import colored
from celnav.filters.model import Sensor
from celnav.filters.records import epochs
from celnav.filters.run import run
from celnav.filters.sequential import Sequential
from celnav.filters.track import Track
from celnav.gaussian.checks import finite, integer, number, numbers, sequence
from celnav.gaussian.linalg import FORMS, Array
from celnav.gaussian.spaces import EUCLIDEAN

__all__ = [
    "Component",
    "Diagnosis",
    "Interval",
    "Model",
    "Sensed",
    "correlated",
    "diagnose",
    "first_order",
    "places",
]

LEAST = 20  # samples of a component, below which nothing can be said
SMALL = 1.1  # how much larger a deviation of a mean may be than white noise has it, for noise that is nearly white
REACH = -3.5, 5.5  # of the inverse hyperbolic tangent of a coefficient
EACH = 3  # components at most for each of which a coefficient of its own is estimated

Interval = tuple[float, float]


class Coloring(NamedTuple):
    """Noise ``V' = phi V + zeta`` of deviation ``sigma``, by restricted maximum likelihood, with intervals.

    rest_p: Ljung and Box's p of what it leaves over: small where a first-order noise does not explain the correlation.
    """

    phi: float
    phi_interval: Interval
    sigma: float
    sigma_interval: Interval
    rest_p: float


class Component(NamedTuple):
    """What is said of one component, in its own unit.

    sensor: index. samples: that exist. rms: of residuals. claimed: rms of the deviations that are claimed, None if unknown.
    bias, bias_interval: the mean. bias_p: the probability of one as far from 0 if there is none.
    effective: independent samples that know a mean as well, of what is normalized by its claim.
    size, size_band: mean square of what is normalized by its claim, None if unknown, and where it lies if the claim is right.
    effective_squares: independent samples that know a mean square as well.
    autocorrelation, band: ``(lags,)``, of lags 1, 2, ..., and the half width of the band in which one of white noise lies.
    ljung_box, p: the statistic, and the probability of one as large if the noise is white.
    coloring: what noise it would be, if it is not white; of a track that of the whitened innovations.
    """

    name: str
    sensor: int
    samples: int
    rms: float
    claimed: float | None
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
        """How much larger the deviation of a mean is than white noise has it."""
        return float(np.sqrt(self.samples / self.effective))


class Sensed(NamedTuple):
    """The size of what a sensor leaves: NIS over its degrees of freedom, nan without claims, and where it lies if they are right.

    squares, dof: ``(T,)`` of all runs together, whose ratio is that over time. shared: samples that vary as one, by correlation.
    """

    names: tuple[str, ...]
    nis: float
    band: Interval
    squares: Array
    dof: Array
    shared: float


class Model(NamedTuple):
    """The filter for colored noise that the data ask for: `celnav.colored` with ``Phi (m, m)`` and ``R (m, m)``.

    phi_interval, sigma_interval: ``(m, 2)``. gain: of the log-likelihood, over the filter that takes the noise for white.
    white_gain: that of a filter for white noise with the most probable factors of Q and R, nan where Q is a function.
    claims, white_claims: ``(n,)`` standard deviations at the end, of the new filter and of the old one. converged: of the search.
    """

    Phi: Array
    R: Array
    phi_interval: Array
    sigma_interval: Array
    gain: float
    white_gain: float
    claims: Array
    white_claims: Array
    converged: bool


class Diagnosis(NamedTuple):
    """What a log says; ``print`` it for a page of words, `celnav.show.diagnosis.figure` draws it.

    times: ``(T,)`` s. step: seconds of a lag, None where times are irregular: a lag is then an epoch. runs: how many.
    level: of all intervals and bands. components, sensors: what is said. model: the filter to take, where one is at hand.
    why: why there is none.
    """

    times: Array
    step: float | None
    runs: int
    level: float
    components: tuple[Component, ...]
    sensors: tuple[Sensed, ...]
    model: Model | None
    why: str

    @property
    def doubt(self) -> float:
        """The least p of a component that is believed, for the level to be that of all of them together."""
        return (1.0 - self.level) / len(self.components)

    def biased(self, component: Component) -> bool:
        """Whether its mean is too far from 0."""
        return component.bias_p < self.doubt

    def white(self, component: Component) -> str:
        """ "white", "nearly white" (detectably not, to little effect) or "colored"."""
        if component.p >= self.doubt:
            return "white"
        return "nearly white" if 1.0 / SMALL < component.longer < SMALL else "colored"

    @property
    def sound(self) -> bool:
        """Whether everything is white or nearly so, without bias, and as large as claimed."""
        quiet = all(self.white(c) != "colored" and not self.biased(c) for c in self.components)
        return quiet and all(
            np.isnan(s.nis) or s.band[0] <= s.nis <= s.band[1] for s in self.sensors
        )

    def __str__(self) -> str:
        from celnav.analysis.diagnosis_text import page

        return page(self)


def diagnose(
    residuals: Track | ArrayLike, times: ArrayLike | None = None, *, std: ArrayLike | None = None,
    names: Sequence[str] | None = None, prior: Any = None, z: ArrayLike | None = None, u: Any = None, lags: int = 20,
    level: float = 0.95,
) -> Diagnosis:  # fmt: skip
    """Whether innovations or residuals are white, without bias and as large as claimed; see `Diagnosis`.

    residuals: a track, whose innovations are taken; or an array ``(T, ..., m)``, nan where something is missing, with ``times
        (T,)`` s. All runs are taken for draws of the same noise.
    std: claimed deviations, broadcast to the residuals; without them nothing is said of their size.
    names: ``(m,)`` of the components.
    prior, z, u: what the filter of a track was given: then the filter for colored noise that the data ask for is fitted, by the
        likelihood, where the noise is not white.
    lags: of the autocorrelation, as far as the data go. level: of intervals and bands.

    >>> print(celnav.analysis.diagnose.diagnose(track, prior=prior, z=z))
    """
    lags, level = integer("lags", lags, 1, 10_000), number("level", level, above=0.0, below=1.0)
    filter, claimed = None, None
    widths: tuple[int, ...] = ()
    if isinstance(residuals, Track):
        filter, t, widths = residuals.filter, residuals.times, residuals.sensors
        if residuals.whitened is None:
            raise ValueError(
                "residuals: expected a track with innovations, got one without; run with keep='std'"
            )
        x, w = (
            np.where(residuals.used, rows, np.nan)
            for rows in (residuals.innovation, residuals.whitened)
        )
    else:
        x = numbers("residuals", residuals)
        if times is None:
            raise ValueError("times: expected them with an array of residuals, got None")
        t = finite("times", times, ("T",))
        if x.ndim < 2 or len(x) != len(t) or not x.size or np.isinf(x).any():
            raise ValueError(
                f"residuals: expected shape ({len(t)}, ..., m) to go with the times, finite or nan, got {x.shape}"
            )
        if std is not None:
            claimed = numbers("std", std)
            if claimed.ndim > x.ndim or any(
                k not in (1, n) for k, n in zip(claimed.shape[::-1], x.shape[::-1], strict=False)
            ):
                raise ValueError(
                    f"std: expected deviations that go with residuals {x.shape}, got {claimed.shape}"
                )
            claimed = np.broadcast_to(claimed, x.shape)
            if not ((claimed > 0.0) & (claimed < np.inf))[np.isfinite(x)].all():
                raise ValueError("std: expected positive deviations wherever there is a residual")
        w = x if claimed is None else x / claimed
    if (np.diff(t) <= 0.0).any():
        raise ValueError("times: expected them to increase")
    T, m = len(t), x.shape[-1]
    x, w = x.reshape(T, -1, m), w.reshape(T, -1, m)
    called = (
        [f"z{i}" for i in range(m)]
        if names is None
        else list(sequence("names", names, "['x', 'y']"))
    )
    if len(called) != m or not all(isinstance(name, str) for name in called):
        raise ValueError(
            f"names: expected {m} words, one for each component, such as ['x', 'y'], got {names!r:.80}"
        )
    place, step = places(t)
    widths = widths or (m,)
    sensor = np.repeat(range(len(widths)), widths)
    scaled = claimed is not None or filter is not None
    rms = None if claimed is None else claimed.reshape(T, -1, m)
    found = tuple(
        _component(
            called[i],
            int(sensor[i]),
            x[..., i],
            w[..., i],
            None if rms is None else rms[..., i],
            scaled,
            place,
            lags,
            level,
        )
        for i in range(m)
    )
    groups = tuple(
        _sensed(w, np.flatnonzero(sensor == k), found, scaled, level) for k in range(len(widths))
    )
    diagnosis = Diagnosis(t, step, x.shape[1], level, found, groups, None, "")
    if all(diagnosis.white(c) != "colored" for c in found):
        return diagnosis
    model, why = _model(filter, prior, t, z, u, found, level)
    return diagnosis._replace(model=model, why=why)


def places(t: Array) -> tuple[Array, float | None]:
    """Places ``(T,)`` of epochs on a grid, whole numbers, and its interval; where there is none, their order."""
    if len(t) < 3:
        return np.arange(len(t)), None
    d = np.diff(t)
    steps = np.maximum(np.rint(d / np.median(d)), 1.0)
    step = float((t[-1] - t[0]) / steps.sum())
    on_grid = (np.abs(d - steps * step) < 0.1 * step).all()
    return (
        (np.concatenate([[0], np.cumsum(steps.astype(np.int64))]), step)
        if on_grid
        else (np.arange(len(t)), None)
    )


def _products(x: Array, place: Array, lag: int) -> tuple[float, int]:
    """Mean of products of samples ``(T, runs)`` a lag apart, and how many there are."""
    there = np.minimum(np.searchsorted(place, place + lag), len(place) - 1)
    both = place[there] == place + lag
    products = x[both] * x[there[both]]
    count = int(np.isfinite(products).sum())
    return float(np.nansum(products)) / max(count, 1), count


def correlated(x: Array, place: Array, lags: int) -> tuple[Array, Array, float, float]:
    """Autocorrelation ``(lags,)`` about the mean and its numbers of pairs; variances of the means of x and of its square, times
    their number and over those of one sample, for Gaussian noise."""
    N = int(np.isfinite(x).sum())
    centered = x - np.nanmean(x)
    variance = float(np.nanmean(centered**2))
    rho, pairs = [1.0], [N]
    most = max(lags, int(place[-1]) // 2) + 1

    def value(lag: int) -> float:
        while len(rho) <= lag:
            product, count = _products(centered, place, len(rho))
            rho.append(product / variance)
            pairs.append(count)
        return rho[lag]

    end = 0
    while (
        end + 1 < most and value(end) + value(end + 1) > 0.0
    ):  # sums of two, which of a stationary process are positive
        end += 2
    value(lags)
    sums = np.array(rho[:end])
    weights = np.array([N, *(2.0 * count for count in pairs[1:end])]) / N
    longer = own = max(float(weights @ sums), 1.0 / N)
    for _ in range(
        20
    ):  # the mean was taken off, which hides as much of each product as its own variance
        shift = min(longer / N, 0.5)
        longer = max(float(weights @ ((1.0 - shift) * sums + shift)), own)
    squares = 1.0 + float(
        weights[1:] @ np.maximum(sums[1:] ** 2 - 1.0 / np.maximum(pairs[1:end], 1), 0.0)
    )
    return np.array(rho[1 : lags + 1]), np.array(pairs[1 : lags + 1]), min(longer, N / 2.0), squares


def _ljung_box(rho: Array, pairs: Array, N: int, fitted: int = 0) -> tuple[float, float]:
    statistic = float((rho**2 * pairs).sum() * (N + 2.0) / N)
    return statistic, float(chdtrc(max(int((pairs > 0).sum()) - fitted, 1), statistic))


def _component(
    name: str, sensor: int, x: Array, w: Array, claimed: Array | None, scaled: bool, place: Array, lags: int, level: float
) -> Component:  # fmt: skip
    there = np.isfinite(x)
    N = int(there.sum())
    if N < LEAST or np.ptp(x[there]) == 0.0:
        what = f"{N} samples" if N < LEAST else f"only {x[there][0]:g}"
        raise ValueError(
            f"residuals: expected at least {LEAST} samples that vary of each component, got {what} of {name}"
        )
    lags = max(1, min(lags, N // 5, int(place[-1]) // 2))
    even = (
        w if claimed is None else (x - np.nanmean(x)) / claimed
    )  # a bias over a claim that changes is no noise
    rho, pairs, shared, squares = correlated(even, place, lags)
    *_, longer, _ = correlated(x, place, lags)
    statistic, p = _ljung_box(rho, pairs, N)
    mean, deviation = float(np.nanmean(x)), float(np.nanstd(x))
    freedom, doubt = max(N / longer - 1.0, 1.0), deviation * float(np.sqrt(longer / N))
    half = float(stdtrit(freedom, 0.5 + level / 2)) * doubt
    z = float(ndtri(0.5 + level / 2))
    return Component(
        name, sensor, N, float(np.sqrt(np.nanmean(x**2))),
        None if claimed is None else float(np.sqrt(np.mean(claimed[there] ** 2))),
        mean, (mean - half, mean + half), float(2.0 * stdtr(freedom, -abs(mean) / doubt)), N / shared,
        float(np.nanmean(w**2)) if scaled else None, chi_square_band(1.0, N / squares, level), N / squares,
        rho, z / np.sqrt(np.maximum(pairs, 1)), statistic, p,
        first_order(w if claimed is None else x, place, lags, level) if p < 1.0 - level else None,
    )  # fmt: skip


def first_order(x: Array, place: Array, lags: int, level: float) -> Coloring:
    """First-order noise about a mean, of samples ``(T, runs)`` at whole ``place (T,)``, gaps and all.

    By the exact likelihood, restricted to what does not depend on the mean; intervals are those of its ratio.

    >>> found = celnav.analysis.diagnose.first_order(z[:, :1, 0], np.arange(len(z)), lags=5, level=0.95)
    """
    from scipy.optimize import brentq, minimize_scalar

    there, rows = np.isfinite(x), np.arange(len(x))[:, None]
    last = np.maximum.accumulate(np.where(there, rows, -1), 0)
    before = np.concatenate([np.full_like(last[:1], -1), last[:-1]])[there]
    at, run_of = np.nonzero(there)
    here, first, N = x[there], before < 0, int(there.sum())
    gap, past = (
        np.where(first, 1, place[at] - place[before]),
        np.where(first, 0.0, x[before, run_of]),
    )

    def parts(v: float) -> tuple[float, float, Array]:
        """The cost of ``phi = tanh v``, the deviation, and what is left of each sample, of unit variance."""
        a = np.where(first, 0.0, np.tanh(v) ** gap)
        scale = np.sqrt(1.0 - a * a)
        left, weight = (here - a * past) / scale, (1.0 - a) / scale
        information = float(weight @ weight)
        left = left - float(weight @ left) / information * weight
        variance = float(left @ left) / (N - 1)
        cost = 0.5 * ((N - 1) * np.log(variance) + np.log(information)) + float(np.log(scale).sum())
        return cost, float(np.sqrt(variance)), left / np.sqrt(variance)

    tried, half = np.linspace(*REACH, 37), 0.5 * float(ndtri(0.5 + level / 2)) ** 2
    best = float(tried[int(np.argmin([parts(v)[0] for v in tried]))])
    v = float(
        minimize_scalar(
            lambda v: parts(v)[0], bounds=(best - 0.25, best + 0.25), method="bounded"
        ).x
    )
    least, sigma, left = parts(v)

    def beyond(u: float) -> float:
        return parts(u)[0] - least - half

    ends = [float(brentq(beyond, v, end)) if beyond(end) > 0.0 else end for end in REACH]
    low, high = (float(np.hypot(np.log(parts(end)[1] / sigma), np.sqrt(half / N))) for end in ends)
    rest = np.full(x.shape, np.nan)
    rest[there] = left
    rho, pairs, *_ = correlated(rest, place, lags)
    p = _ljung_box(rho, pairs, N, fitted=1)[1]
    interval = float(np.tanh(ends[0])), float(np.tanh(ends[1]))
    return Coloring(
        float(np.tanh(v)),
        interval,
        sigma,
        (float(sigma * np.exp(-low)), float(sigma * np.exp(high))),
        p,
    )


def _sensed(
    w: Array, at: Array, components: Sequence[Component], scaled: bool, level: float
) -> Sensed:
    """Of the components of a sensor."""
    own = [components[i] for i in at]
    square, dof = np.nansum(w[..., at] ** 2, (1, 2)), np.isfinite(w[..., at]).sum((1, 2))
    # A sum of squares that are correlated varies as one of fewer.
    count = int(dof.sum())
    fewer = count**2 / sum(c.samples**2 / c.effective_squares for c in own)
    nis = float(square.sum() / count) if scaled else np.nan
    return Sensed(
        tuple(c.name for c in own),
        nis,
        chi_square_band(1.0, fewer, level),
        square,
        dof,
        count / fewer,
    )


def _model(
    filter: Any, prior: Any, t: Array, z: Any, u: Any, found: Sequence[Component], level: float
) -> tuple[Model | None, str]:  # fmt: skip
    """The filter for colored noise, and why there is none."""
    from celnav.analysis.tuning import maximize_likelihood  # only a search needs what searches

    if filter is None:
        return None, ""
    sensors: Any = getattr(filter, "sensors", ())
    noise = sensors[0].noise if len(sensors) == 1 else None
    flat = type(filter) is Sequential and all(
        one.space == EUCLIDEAN for one in (filter.motion, *sensors)
    )
    if not (flat and isinstance(noise, np.ndarray) and noise.ndim == 2 and filter.gain is None):
        return (
            None,
            "celnav.colored is for one sensor of vectors with a constant R; celnav.augmented carries other noise in the state",
        )
    if prior is None or z is None:
        return (
            None,
            "diagnose(track, prior=prior, z=z) estimates Phi and R, and says what the filter for them would claim",
        )
    sensor, motion, R, m = sensors[0], filter.motion, noise @ noise.T, len(noise)
    form = next(name for name, form in FORMS.items() if form is filter.form)
    own, data = m if m <= EACH else 1, epochs(t, z, u)

    def build(p: Array) -> tuple[Any, Any]:
        phi, s = (np.broadcast_to(part, m) for part in (p[:own], p[own:]))
        taken = Sensor(sensor.h, R * s * s[:, None], jacobian=sensor.jacobian)
        hooks = filter.hooks[0] if filter.hooks else ()
        return colored(motion, taken, np.diag(phi), rule=filter.rule, form=form, hooks=hooks), prior

    def white(p: Array) -> tuple[Any, Any]:
        moved = replace(motion, Q=None, sqrt_Q=p[0] * motion.noise)
        return replace(
            filter,
            motion=moved,
            sensors=(Sensor(sensor.h, p[1] ** 2 * R, jacobian=sensor.jacobian),),
        ), prior

    first = np.clip([c.autocorrelation[0] for c in found], 0.05, 0.95)
    start = np.concatenate([first if own == m else [first.mean()], np.ones(own)])
    try:
        with np.errstate(all="ignore"):  # a search goes far
            tuned = maximize_likelihood(
                build, start, data, domain=[(-1.0, 1.0)] * own + ["positive"] * own
            )
            constant = isinstance(motion.noise, np.ndarray)
            other = (
                maximize_likelihood(white, [1.0, 1.0], data).log_likelihood if constant else np.nan
            )
        tracks = [run(*each, data) for each in (build(tuned.parameters), (filter, prior))]
    except (ValueError, ArithmeticError) as error:
        return None, f"the filter for colored noise could not be fitted: {error}"
    phi, s = (np.broadcast_to(part, m) for part in (tuned.parameters[:own], tuned.parameters[own:]))
    reach = float(ndtri(0.5 + level / 2)) * np.sqrt(tuned.covariance.diagonal())
    doubt, factor = (np.broadcast_to(part, m) for part in (reach[:own], np.exp(reach[own:])))
    half, sigma = np.arctanh(phi), s * np.sqrt(R.diagonal())
    claims, before = (
        np.atleast_2d(track.std[-1]).mean(tuple(range(track.std.ndim - 2))) for track in tracks
    )
    known = tracks[1].log_likelihood.sum()
    return Model(
        np.diag(phi), R * s * s[:, None], np.tanh(np.stack([half - 0.5 * doubt, half + 0.5 * doubt], -1)),
        np.stack([sigma / factor, sigma * factor], -1), float(tracks[0].log_likelihood.sum() - known), float(other - known),
        claims, before, tuned.converged,
    ), ""  # fmt: skip
