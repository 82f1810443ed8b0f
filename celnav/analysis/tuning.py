"""Maximum-likelihood tuning of noise parameters, from a filter's innovations [Schweppe1965]."""

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
STEP = 2e-3  # step of differences, in logarithms
WIDE = 3e-3  # step of fourth-order differences, relative to each parameter
FLIGHTS = 20  # expected number of gradients in a search; each costs 1 + 2 d runs by differences
# Newton's method starts when a step of the search gains less log-likelihood than this.
ROUGH = 1e-3
STEPS = 4  # largest number of Newton steps


class Tuned(NamedTuple):
    """The maximum of a likelihood.

    parameters: ``(d,)``, at the maximum. log_likelihood: maximum, the sum over all runs.
    standard_errors: ``(d,)``, from the curvature; inf if the curvature does not give any.
    covariance: ``(d, d)``, of the parameters' *logarithms* (in an interval, of
        ``log((p - low) / (high - p))``). A 95 % interval of a positive parameter is
        ``parameters * exp(+-2 sqrt(diagonal))``.
    evaluations: number of parameter vectors that were evaluated, including those for gradients and
        curvature.
    converged: whether the parameters are an interior maximum of the likelihood.
    message: the optimizer's message, or why there is no interior maximum.
    failures: number of evaluations without a filter, or with a filter that failed; they count as
        improbable.
    engine: "compiled" if one run gave likelihood and gradient, "numpy" if differences did; with
        "auto" also the reason.
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
    """The log-likelihood ``value (...)`` of each run, and its ``gradient (..., d)``; ``engine`` as
    in `Tuned`.
    """

    value: Array
    gradient: Array
    engine: str


def likelihood_gradient(
    build: Build, parameters: ArrayLike, epochs: Iterable[Epoch], *, engine: str = "auto"
) -> LikelihoodGradient:
    """The log-likelihood ``(...)`` of each run, and its gradient ``(..., d)`` with respect to the
    parameters: `LikelihoodGradient`.

    build: ``parameters (d,) -> (filter, prior)``; it is also called with parameters that differ by
        up to 1 %.
    parameters: ``(d,)``. epochs: the data, with at least one measurement.
    engine: "compiled" computes both exactly in one run, if the parameters enter matrices of the
        filter or the prior. "numpy" uses differences of runs, accurate to about seven digits.
        "auto" is "compiled" if possible.

    ValueError for other arguments; CannotCompile with "compiled" if it is not possible.

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
    """Maximize the sum of ``Track.log_likelihood`` over the runs with respect to parameters, such
    as standard deviations and correlations; return `Tuned`.

    The search uses logarithms, so parameters may be of any size. Parameters at which ``build`` or
    the filter fails count as improbable. For example, for a standard deviation and a correlation::

        maximize_likelihood(build, [0.1, 0.5], epochs, domain=["positive", "unit interval"])

    build: ``parameters (d,) -> (filter, prior)``.
    start: ``(d,)``, within the domain; the filter must work there (ValueError otherwise).
    epochs: the data; the same for all parameters.
    domain: range of all parameters, or a list with the range of each: "positive", "unit interval"
        (0 to 1) or ``(low, high)``.
    factor: the search stays between ``start / factor`` and ``start * factor``; in an interval this
        holds for ``(p - low) / (high - p)``.
    tolerance: largest gain of log-likelihood that may remain; a parameter one standard error from
        the maximum loses 0.5.
    max_iterations: largest number of iterations of the optimizer.
    engine: as in `likelihood_gradient`; "auto" also selects "numpy" if compilation would take
        longer than it saves.

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
    # Near failures of the filter a line search may discard its best point.
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
        # Gain of a Newton step if the log-likelihood were quadratic.
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
    """Checked epochs; ValueError if none of them has a measurement."""
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
    """Value and gradient of a compiled run. CannotCompile unless the value equals the numpy
    engine's ``reference`` and differences of values agree with the gradient.
    """
    value, gradient = compiled(x, lengths)
    above, below = (compiled(x + step * lengths, lengths)[0].sum() for step in (STEP, -STEP))
    # The derivative along the sum of all axes must equal the sum of the gradient.
    rise, slopes = (above - below) / (2.0 * STEP), gradient.reshape(-1, len(x)).sum(0) * lengths
    size = np.abs(reference).sum()
    if not (np.abs(value - reference) <= 1e-6 * (1.0 + np.abs(reference))).all():
        raise CannotCompile(
            "the model gives other values when it is recorded: it depends on the type of its input"
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
    """Map from logarithms ``(d,)``, relative to the start, to parameters.

    The logarithm is of ``p - low``, or of ``(p - low) / (high - p)`` in an interval.
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
                f"domain: expected one domain, or {len(start)}, one for each parameter, got "
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
        """Derivative ``(d,)`` of the parameters with respect to their logarithms."""
        above = self(s) - self._low
        return np.asarray(above * (1.0 - above / (self._high - self._low)))


class _Likelihood:
    """Log-likelihood and its derivatives as functions of logarithms relative to the start; nan
    where there is no filter or the filter fails.
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
        """First derivatives ``(d,)`` from the compiled engine; None if there are none."""
        self(s)
        return self.slopes.get(tuple(s.tolist()))

    def best(self) -> Array:
        """The logarithms ``(d,)`` with the largest likelihood so far."""
        return np.array(
            max((value, s) for s, value in self.values.items() if not np.isnan(value))[1]
        )

    def _neighbors(self, s: Array) -> tuple[Array, Array]:
        """Log-likelihoods ``(d,)`` one step above and one step below s along each axis."""
        axes = STEP * np.eye(len(s))
        return np.array([self(s + axis) for axis in axes]), np.array(
            [self(s - axis) for axis in axes]
        )

    def gradient(self, s: Array) -> Array:
        """First derivatives ``(d,)``. A difference is one-sided if the filter fails on one side,
        and 0 if it fails on both.
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
        """Second derivatives ``(d, d)`` from exact gradients; None if one is missing."""
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
        """Minus the log-likelihood, for an optimizer, and its gradient ``(d,)``."""
        if np.isnan(self(s)):  # finite, increasing outward, so that a line search turns back
            depth = 1e3 + abs(self.first)
            return depth * (1.0 + float(s @ s)) - self.first, 2.0 * depth * s
        return -self(s), -self.gradient(s)

    def curvature(self, s: Array) -> Array:
        """Second derivatives ``(d, d)``; nan where the filter fails near s."""
        if (rows := self._differences(s)) is not None:
            return 0.5 * (rows + rows.T)
        axes, here, (above, below) = STEP * np.eye(len(s)), self(s), self._neighbors(s)
        # Diagonal: second differences. Others: second differences along the sum of two axes.
        H = np.diag(above - 2.0 * here + below)
        for i, j in combinations(range(len(s)), 2):
            both = axes[i] + axes[j]
            H[i, j] = H[j, i] = 0.5 * (
                self(s + both) + self(s - both) + 2.0 * here - (above + below)[[i, j]].sum()
            )
        return np.asarray(H / STEP**2)
