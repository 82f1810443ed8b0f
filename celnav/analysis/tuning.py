"""Noise tuning by the likelihood of the innovations [Schweppe1965]: the parameters that make the
data most probable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit

from celnav.engine.gradient import Gradient, fourth_order
from celnav.filters.records import Epoch, Epochs, Filter
from celnav.filters.run import ENGINES, run
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import (
    choice,
    describe,
    finite,
    function,
    integer,
    number,
    numbers,
    sequence,
)
from celnav.gaussian.linalg import Array
from celnav.tape.tape import CannotCompile

__all__ = ["likelihood_gradient", "maximize_likelihood"]

Build = Callable[[Array], tuple[Filter, Gaussian]]
Domain = str | tuple[float, float]
DOMAINS = {"positive": (0.0, np.inf), "unit interval": (0.0, 1.0)}
STEP = 2e-3  # of differences, in logarithms
WIDE = 3e-3  # of fourth-order differences, relative to each parameter
FLIGHTS = 20  # runs of a search, about, for each parameter twice and once more
# gain in log-likelihood of the last step of the search at which Newton's method takes over
ROUGH = 1e-3
STEPS = 4  # of Newton's method, at most


class Tuned(NamedTuple):
    """The maximum of a likelihood.

    parameters: ``(d,)`` at the maximum of the likelihood. log_likelihood: there, of all runs
        together.
    standard_errors: ``(d,)`` of the parameters, from the curvature; inf if ``converged`` is False
        because there is no curvature.
    covariance: ``(d, d)`` of the parameters' *logarithms* (in an interval, of
        ``log((p - low) / (high - p))``): an interval of a positive parameter is
        ``parameters * exp(+-2 sqrt(diagonal))``.
    evaluations: parameters that were tried, including those for gradient and curvature.
    converged: whether the parameters are an inner maximum of the likelihood.
    message: the optimizer's message, or why there is no such maximum.
    failures: how many of the parameters tried gave no filter, or one that failed; they count as
        improbable.
    engine: "compiled" if one run gave likelihood and gradient, "numpy" if differences did; with
        "auto" also why.
    """

    parameters: Array
    log_likelihood: float
    standard_errors: Array
    covariance: Array
    evaluations: int
    converged: bool
    message: str
    failures: int = 0
    engine: str = "numpy"


class LikelihoodGradient(NamedTuple):
    """The log-likelihood ``value (...)`` of each run, and its ``gradient (..., d)``. engine: as in
    `Tuned`.
    """

    value: Array
    gradient: Array
    engine: str


def likelihood_gradient(
    build: Build, parameters: ArrayLike, epochs: Iterable[Epoch], *, engine: str = "auto"
) -> LikelihoodGradient:
    """The log-likelihood ``(...)`` of each run, and its derivatives ``(..., d)`` by parameters.

    build: ``parameters (d,) -> (filter, prior)``; it is also called at neighboring parameters, up
        to a hundredth of each away.
    parameters: ``(d,)``. epochs: the data.
    engine: "compiled": one run gives both, exactly, if the parameters are in matrices of the filter
        or in the prior; "numpy": by differences of runs, to some seven digits; "auto": compiled if
        possible.

    >>> value, gradient, engine = likelihood_gradient(build, [0.1, 0.5], epochs)
    """
    x = finite("parameters", parameters)
    if x.ndim != 1 or not len(x):
        raise ValueError(f"parameters: expected shape (d,), got {x.shape}")
    data, build = _data(epochs), function("build", build, "(parameters)")
    lengths, why = np.where(x == 0.0, 1.0, np.abs(x)), ""
    here = _flight(build, x, data)
    if choice("engine", engine, ENGINES) != "numpy":
        try:
            return LikelihoodGradient(
                *_checked(Gradient(partial(_built, build), data), x, lengths, here), "compiled"
            )
        except (CannotCompile, ImportError) as error:
            if engine == "compiled":
                raise
            why = f": {error}"
    steps = WIDE * np.diag(lengths)
    slopes = [
        fourth_order([_flight(build, x + j * step, data) for j in (-2, -1, 1, 2)], WIDE)
        for step in steps
    ]
    return LikelihoodGradient(here, np.stack(slopes, -1) / lengths, f"numpy{why}")


def maximize_likelihood(
    build: Build,
    start: ArrayLike,
    epochs: Iterable[Epoch],
    *,
    domain: Domain | Sequence[Domain] = "positive",
    factor: float = 1e3,
    tolerance: float = 1e-6,
    max_iterations: int = 100,
    engine: str = "auto",
) -> Tuned:
    """`Tuned`: parameters, such as deviations and correlations, that maximize
    ``Track.log_likelihood``, summed over the runs.

    The search uses logarithms, so parameters may be of any size. Parameters at which ``build`` or
    the filter fails count as improbable. For example, for a standard deviation and a correlation::

        maximize_likelihood(build, [0.1, 0.5], epochs, domain=["positive", "unit interval"])

    build: ``parameters (d,) -> (filter, prior)``.
    start: ``(d,)``, within the domain, where the filter works.
    epochs: the data; the same for all parameters.
    domain: range of the parameters, one for all or one for each: "positive", "unit interval" (0 to
        1) or ``(low, high)``.
    factor: the search stays within ``start / factor`` and ``start * factor``; in an interval, of
        the distances to its ends.
    tolerance: log-likelihood that may be left to gain; a parameter one standard error off loses
    0.5.
    max_iterations: of the optimizer.
    engine: as in `likelihood_gradient`; "auto" is "numpy" also if compiling would take longer than
        it saves.

    >>> domain = ["positive", "unit interval"]
    >>> tuned = celnav.analysis.tuning.maximize_likelihood(build, [0.1, 0.5], epochs, domain=domain)
    """
    from scipy.optimize import minimize  # takes a second to import

    x0 = finite("start", start)
    if x0.ndim != 1 or not len(x0):
        raise ValueError(f"start: expected positive parameters of shape (d,), got {x0!r:.80}")
    scale = _Scale(domain, x0)
    reach = float(np.log(number("factor", factor, above=1.0)))
    tolerance = number("tolerance", tolerance, above=0.0)
    max_iterations = integer("max_iterations", max_iterations)
    data = _data(epochs)
    likelihood = _Likelihood(
        function("build", build, "(parameters)"),
        data,
        scale,
        len(x0),
        choice("engine", engine, ENGINES),
    )
    optimum = minimize(
        likelihood.cost,
        np.zeros(len(x0)),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-reach, reach)] * len(x0),
        options={
            "maxiter": max_iterations,
            "gtol": 1e-9,
            "ftol": ROUGH / max(1.0, abs(likelihood.first)),
        },
    )
    # Near failures a line search may discard the best point that it has tried.
    s = optimum.x if optimum.success else likelihood.best()
    for left in range(STEPS, -1, -1):
        covariance, why = np.full((len(x0), len(x0)), np.inf), ""
        at_end, curvature = np.abs(s) > 0.999 * reach, likelihood.curvature(s)
        if at_end.any():
            i = int(np.argmax(at_end))
            why = f"parameter {i} ran to the end of its range, {scale(s)[i]:.6g}"
            break
        if not np.isfinite(curvature).all():
            why = "the filter fails beside the most probable parameters: they lie at an edge"
            break
        # The covariance of the logarithms is minus the inverse of the curvature.
        eigenvalues, vectors = np.linalg.eigh(curvature)
        if eigenvalues[-1] >= 0.0:
            i = int(np.argmax(np.abs(vectors[:, -1])))
            why = f"the data do not determine parameter {i}: the likelihood has no maximum in it"
            break
        covariance, gradient = (vectors / -eigenvalues) @ vectors.T, likelihood.gradient(s)
        # What a quadratic likelihood would gain by Newton's step.
        gain = 0.5 * gradient @ covariance @ gradient
        ahead = np.clip(s + covariance @ gradient, -reach, reach)
        if gain <= tolerance or not left or not likelihood(ahead) > likelihood(s):
            why = (
                ""
                if gain <= tolerance
                else f"{gain:.3g} of the log-likelihood is left to gain; {optimum.message}"
            )
            break
        s = ahead
    errors = scale.slope(s) * np.sqrt(covariance.diagonal())
    tried, converged = list(likelihood.values.values()), bool(optimum.success) and not why
    failures = int(np.isnan(tried).sum())
    return Tuned(
        scale(s),
        likelihood(s),
        errors,
        covariance,
        len(tried),
        converged,
        why or optimum.message,
        failures,
        likelihood.engine,
    )


def _data(epochs: Iterable[Epoch]) -> Sequence[Epoch]:
    """Epochs, at least one of them with measurements."""
    data = (
        epochs
        if isinstance(epochs, Epochs)
        else sequence("epochs", epochs, "celnav.epochs(times, z)")
    )
    if not any(map(_measured, data)):
        raise ValueError("epochs: expected measurements, got none")
    return data


def _built(build: Build, parameters: Array) -> tuple[Filter, Gaussian]:
    built = build(parameters)
    if not (isinstance(built, tuple) and len(built) == 2):
        raise ValueError(f"build: expected a filter and a prior, got {describe(built)}")
    return built


def _flight(build: Build, parameters: Array, epochs: Sequence[Epoch]) -> Array:
    """Log-likelihood ``(...)`` of each run, by the numpy engine."""
    return run(*_built(build, parameters), epochs, keep="nothing", engine="numpy").log_likelihood


def _checked(compiled: Gradient, x: Array, lengths: Array, reference: Array) -> tuple[Array, Array]:
    """The results of a compiled run, if the value equals the numpy engine's ``reference`` and
    differences of values agree with the gradient.
    """
    value, gradient = compiled(x, lengths)
    above, below = (compiled(x + step * lengths, lengths)[0].sum() for step in (STEP, -STEP))
    # The rise along the diagonal of the parameters must equal the sum of the gradient.
    rise, slopes = (above - below) / (2.0 * STEP), gradient.reshape(-1, len(x)).sum(0) * lengths
    size = np.abs(reference).sum()
    if not (np.abs(value - reference) <= 1e-6 * (1.0 + np.abs(reference))).all():
        raise CannotCompile(
            "the model gives other values when it is recorded: it looks at what it is given"
        )
    if not np.abs(rise - slopes.sum()) <= 1e-3 * np.abs(slopes).sum() + 1e-5 * (1.0 + size):
        raise CannotCompile("the likelihood is not smooth in the parameters")
    return value, gradient


def _measured(epoch: Any) -> bool:
    z = getattr(epoch, "z", None)
    samples = z if isinstance(z, tuple) else (z,)
    return any(
        sample is not None and bool(np.isfinite(numbers("z", sample)).any()) for sample in samples
    )


class _Scale:
    """From logarithms ``(d,)``, relative to the start, to parameters; the logarithms are of the
    distances to the ends of the domain.
    """

    def __init__(self, domain: Domain | Sequence[Domain], start: Array):
        alone = isinstance(domain, str) or (
            isinstance(domain, tuple) and not isinstance(domain[0], str | tuple | list)
        )
        domains: Any = (
            [domain] * len(start)
            if alone
            else sequence("domain", domain, "['positive', (0.0, 1.0)]")
        )
        if len(domains) != len(start):
            raise ValueError(
                f"domain: expected one for all or {len(start)}, one for each parameter, got "
                f"{len(domains)}"
            )
        pairs = [DOMAINS.get(spec) if isinstance(spec, str) else spec for spec in domains]
        for i, (spec, pair) in enumerate(zip(domains, pairs, strict=True)):
            if (
                not isinstance(pair, tuple | list)
                or len(pair) != 2
                or not -np.inf < numbers("domain", pair)[0] < pair[1]
            ):
                raise ValueError(
                    f"domain: expected 'positive', 'unit interval' or (low, high), got {spec!r}"
                )
            if not pair[0] < start[i] < pair[1]:
                interval = f"parameter {i} between {pair[0]:g} and {pair[1]:g}"
                raise ValueError(
                    f"start: expected {'positive parameters' if spec == 'positive' else interval}, "
                    f"got {start[i]:g}"
                )
        self._low, self._high = low, high = np.array(pairs, np.float64).T
        self._bounded = np.isfinite(high)
        # The start in logarithms of p - low, or of (p - low) / (high - p) in an interval.
        self._origin = np.log((start - low) / np.where(self._bounded, high - start, 1.0))

    def __call__(self, s: Array) -> Array:
        s = self._origin + s
        return np.asarray(
            self._low + np.where(self._bounded, (self._high - self._low) * expit(s), np.exp(s))
        )

    def slope(self, s: Array) -> Array:
        """Derivative of the parameters by their logarithms."""
        above = self(s) - self._low
        return np.asarray(above * (1.0 - above / (self._high - self._low)))


class _Likelihood:
    """Log-likelihood as a function of logarithms relative to the start, nan where there is none,
    with its derivatives.
    """

    def __init__(self, build: Build, epochs: Sequence[Epoch], scale: _Scale, d: int, engine: str):
        self._build, self._epochs, self._scale, self._ones = build, epochs, scale, np.ones(d)
        start = scale(np.zeros(d))
        try:
            here = _flight(build, start, epochs)
            self.first = float(here.sum())
        except ArithmeticError as error:
            raise ValueError(
                f"start: expected parameters at which the filter works; {error}"
            ) from error
        except ValueError as error:
            error.add_note(f"at the start, parameters {start}")
            raise
        if not np.isfinite(self.first):
            raise ValueError(f"start: expected a finite log-likelihood, got {self.first}")
        self.values, self.slopes = {(0.0,) * d: self.first}, dict[tuple[float, ...], Array]()
        self.engine, self._compiled = engine.replace("auto", "compiled"), None
        if engine != "numpy":
            flights = FLIGHTS * (1 + 2 * d) if engine == "auto" else np.inf
            compiled = Gradient(lambda s: _built(build, scale(s)), epochs, flights)
            try:
                _, gradient = _checked(compiled, np.zeros(d), self._ones, here)
                self._compiled, self.slopes[(0.0,) * d] = compiled, gradient.reshape(-1, d).sum(0)
            except (ValueError, ArithmeticError, ImportError) as error:
                if engine == "compiled":
                    raise
                self.engine = f"numpy: {error}"

    def _evaluated(self, s: Array, key: tuple[float, ...]) -> float:
        if self._compiled is not None:
            try:
                value, gradient = self._compiled(s, self._ones)
                if np.isfinite(value).all() and np.isfinite(gradient).all():
                    self.slopes[key] = gradient.reshape(-1, len(s)).sum(0)
                    return float(value.sum())
            except (ValueError, ArithmeticError):
                # The numpy engine decides whether there is no filter, or only no gradient.
                pass
        return float(_flight(self._build, self._scale(s), self._epochs).sum())

    def __call__(self, s: Array) -> float:
        key = tuple(s.tolist())
        if key not in self.values:
            try:
                value = self._evaluated(s, key)
            except (ValueError, ArithmeticError):
                value = np.nan
            self.values[key] = value if np.isfinite(value) else np.nan
        return self.values[key]

    def exact(self, s: Array) -> Array | None:
        """First derivatives ``(d,)`` from the compiled step, None if it has none."""
        self(s)
        return self.slopes.get(tuple(s.tolist()))

    def best(self) -> Array:
        """The most probable of the parameters tried ``(d,)``."""
        return np.array(
            max((value, s) for s, value in self.values.items() if not np.isnan(value))[1]
        )

    def _neighbors(self, s: Array) -> tuple[Array, Array]:
        """Likelihoods ``(d,)`` a step above and below s."""
        axes = STEP * np.eye(len(s))
        return np.array([self(s + axis) for axis in axes]), np.array(
            [self(s - axis) for axis in axes]
        )

    def gradient(self, s: Array) -> Array:
        """First derivatives ``(d,)``; as differences on the side where the filter works, 0 if it
        works on neither.
        """
        if (exact := self.exact(s)) is not None:
            return exact
        above, below = self._neighbors(s)
        forward, backward = above - self(s), self(s) - below
        mean = 0.5 * (
            np.where(np.isnan(forward), backward, forward)
            + np.where(np.isnan(backward), forward, backward)
        )
        return np.nan_to_num(mean / STEP)

    def _differences(self, s: Array) -> Array | None:
        """Differences of exact gradients ``(d, d)``, None if one is missing."""
        rows = []
        for axis in STEP * np.eye(len(s)):
            above, below = (
                self.exact(at) if self._compiled else None for at in (s + axis, s - axis)
            )
            if above is None or below is None:
                return None
            rows.append((above - below) / (2.0 * STEP))
        return np.array(rows)

    def cost(self, s: Array) -> tuple[float, Array]:
        """The function that an optimizer minimizes, and its gradient."""
        if np.isnan(self(s)):  # finite, increasing outward, so that a line search turns back
            depth = 1e3 + abs(self.first)
            return depth * (1.0 + float(s @ s)) - self.first, 2.0 * depth * s
        return -self(s), -self.gradient(s)

    def curvature(self, s: Array) -> Array:
        """Second derivatives ``(d, d)``, nan where the filter fails beside s."""
        if (rows := self._differences(s)) is not None:
            return 0.5 * (rows + rows.T)
        axes, here, (above, below) = STEP * np.eye(len(s)), self(s), self._neighbors(s)
        # Second differences on the diagonal; beside it those along the sum of two axes.
        H = np.diag(above - 2.0 * here + below)
        for i, j in combinations(range(len(s)), 2):
            both = axes[i] + axes[j]
            H[i, j] = H[j, i] = 0.5 * (
                self(s + both) + self(s - both) + 2.0 * here - (above + below)[[i, j]].sum()
            )
        return np.asarray(H / STEP**2)
