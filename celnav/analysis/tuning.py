"""Noise tuning by the likelihood of the innovations [Schweppe 1965]: the parameters under which the data are most probable."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, logit

from celnav.filters.records import Epoch, Epochs, Filter
from celnav.filters.run import run
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import finite, function, integer, kind, number, numbers, sequence
from celnav.gaussian.linalg import Array

Build = Callable[[Array], tuple[Filter, Gaussian]]
Domain = str | tuple[float, float]
DOMAINS = {"positive": (0.0, np.inf), "unit interval": (0.0, 1.0)}
_NEAR, _FAR = 1e-3, 2e-3
"""Differences of gradients and of curvatures, in logarithms."""
_ROUGH = 1e-3
"""What the last step of the search has gained when Newton's method takes over."""


class Tuned(NamedTuple):
    """The maximum of a likelihood.

    Attributes
    ----------
    parameters: ``(d,)`` where the likelihood is largest.
    log_likelihood: there, of all runs together.
    standard_errors: ``(d,)`` of the parameters, by the curvature; inf where ``converged`` is False for want of one.
    covariance: ``(d, d)`` of the parameters' *logarithms* (in an interval, of ``log((p - low) / (high - p))``): an interval of a
        positive parameter is ``parameters * exp(+-2 sqrt(diagonal))``.
    evaluations: parameters that were tried, those for gradient and curvature included.
    converged: whether the parameters are an inner maximum of the likelihood.
    message: what the optimizer said, or why there is no such maximum.
    failures: how many of the parameters tried made no filter, or one that failed; they count as improbable.
    """

    parameters: Array
    log_likelihood: float
    standard_errors: Array
    covariance: Array
    evaluations: int
    converged: bool
    message: str
    failures: int = 0


def maximize_likelihood(
    build: Build,
    start: ArrayLike,
    epochs: Iterable[Epoch],
    *,
    domain: Domain | Sequence[Domain] = "positive",
    factor: float = 1e3,
    tolerance: float = 1e-6,
    max_iterations: int = 100,
) -> Tuned:
    """Maximize ``Track.log_likelihood``, summed over the runs, over parameters such as standard deviations and correlations.

    The search is on logarithms, so parameters may be of any size: L-BFGS-B, then Newton's method. Parameters at which ``build``
    or the filter fails count as improbable. For example, of a deviation and a correlation::

        maximize_likelihood(build, [0.1, 0.5], epochs, domain=["positive", "unit interval"])

    Parameters
    ----------
    build: ``parameters (d,) -> (filter, prior)``.
    start: ``(d,)``, within the domain, where the filter works.
    epochs: the data; the same for all parameters.
    domain: what parameters can be, one for all or one for each: "positive", "unit interval" (0 to 1) or ``(low, high)``.
    factor: the search stays within ``start / factor`` and ``start * factor``; in an interval, of the distances to its ends.
    tolerance: how much of the log-likelihood may be left to gain; a parameter one standard error off loses 0.5.
    max_iterations: of the optimizer.
    """
    x0 = finite("start", start)
    if x0.ndim != 1 or not len(x0):
        raise ValueError(f"start: expected positive parameters of shape (d,), got {x0!r:.80}")
    scale = _Scale(_ends(domain, len(x0)), x0)
    reach = float(np.log(number("factor", factor, above=1.0)))
    tolerance = number("tolerance", tolerance, above=0.0)
    max_iterations = integer("max_iterations", max_iterations)
    data = epochs if isinstance(epochs, Epochs) else sequence("epochs", epochs, "celnav.epochs(times, z)")
    if not any(map(_measured, data)):
        raise ValueError("epochs: expected measurements, got none")
    s = np.zeros(len(x0))
    likelihood = _Likelihood(function("build", build, "(parameters)"), data, scale, s)
    for left in (_ROUGH, 1e-3 * tolerance):  # the second where the first ends on a plateau
        s, converged, message = likelihood.searched(s, reach, left, max_iterations)
        at_end = np.abs(s) > 0.999 * reach
        if at_end.any():
            break
        s, curvature, gain = likelihood.refined(s, tolerance)
        if gain <= tolerance:
            break
    covariance, why = np.full((len(x0), len(x0)), np.inf), ""
    if at_end.any():
        i = int(np.argmax(at_end))
        why = f"parameter {i} ran to the end of its range, {scale(s)[i]:.6g}"
    elif not np.isfinite(curvature).all():
        why = "the filter fails beside the most probable parameters: they lie at an edge"
    else:
        eigenvalues, vectors = np.linalg.eigh(curvature)
        if eigenvalues[-1] < 0.0:
            covariance = (vectors / -eigenvalues) @ vectors.T
            why = "" if gain <= tolerance else f"{gain:.3g} of the log-likelihood is left to gain; {message}"
        else:
            i = int(np.argmax(np.abs(vectors[:, -1])))
            why = f"the data do not determine parameter {i}: the likelihood has no maximum in it"
    errors = scale.slope(s) * np.sqrt(covariance.diagonal())
    (best,), tried = likelihood([s]).tolist(), list(likelihood.known.values())
    failures = int(np.isnan(tried).sum())
    return Tuned(scale(s), best, errors, covariance, len(tried), converged and not why, why or message, failures)


def _measured(epoch: Any) -> bool:
    z = getattr(epoch, "z", None)
    parts = z if isinstance(z, tuple) else (z,)
    return any(part is not None and bool(np.isfinite(numbers("z", part)).any()) for part in parts)


def _ends(domain: Domain | Sequence[Domain], d: int) -> Array:
    """Lower and upper ends ``(2, d)`` of the parameters."""
    alone = isinstance(domain, str) or (isinstance(domain, tuple) and not isinstance(domain[0], str | tuple | list))
    each: Any = [domain] * d if alone else sequence("domain", domain, "['positive', (0.0, 1.0)]")
    if len(each) != d:
        raise ValueError(f"domain: expected one for all or {d}, one for each parameter, got {len(each)}")
    pairs = [DOMAINS.get(one) if isinstance(one, str) else one for one in each]
    for one, pair in zip(each, pairs, strict=True):
        if not isinstance(pair, tuple | list) or len(pair) != 2 or not -np.inf < numbers("domain", pair)[0] < pair[1]:
            raise ValueError(f"domain: expected 'positive', 'unit interval' or (low, high), got {one!r}")
    return np.array(pairs, dtype=np.float64).T


class _Scale:
    """Logarithms ``(d,)``, relative to the start, to parameters: of the distance to the ends of their domain."""

    def __init__(self, ends: Array, start: Array):
        low, high = ends
        inside = (start > low) & (start < high)
        if not inside.all():
            i = int(np.argmin(inside))
            expected = "positive parameters" if (low[i], high[i]) == DOMAINS["positive"] else None
            raise ValueError(f"start: expected {expected or f'parameter {i} between {low[i]:g} and {high[i]:g}'}, got {start[i]:g}")
        self._low, self._bounded = low, np.isfinite(high)
        self._width = np.where(self._bounded, high - low, 1.0)
        part = (start - low) / self._width
        self._origin = np.where(self._bounded, logit(np.where(self._bounded, part, 0.5)), np.log(part))

    def __call__(self, s: Array) -> Array:
        s = self._origin + s
        part = np.where(self._bounded, expit(s), np.exp(np.where(self._bounded, 0.0, s)))
        return np.asarray(self._low + self._width * part)

    def slope(self, s: Array) -> Array:
        """Derivative of the parameters by their logarithms."""
        above = self(s) - self._low
        return np.asarray(np.where(self._bounded, above * (1.0 - above / self._width), above))


class _Likelihood:
    """Log-likelihood as a function of logarithms relative to the start, nan where there is none, with its derivatives."""

    def __init__(self, build: Build, epochs: Sequence[Epoch], scale: _Scale, start: Array):
        self._build, self._epochs, self._scale = build, epochs, scale
        self.known: dict[bytes, float] = {}
        try:
            self.first = self.known[start.tobytes()] = self._flown(scale(start))
        except ArithmeticError as error:
            raise ValueError(f"start: expected parameters at which the filter works; {error}") from error
        except ValueError as error:
            error.add_note(f"at the start, parameters {scale(start)}")
            raise
        if not np.isfinite(self.first):
            raise ValueError(f"start: expected a finite log-likelihood, got {self.first}")

    def _flown(self, parameters: Array) -> float:
        built = self._build(parameters)
        if not (isinstance(built, tuple) and len(built) == 2):
            raise ValueError(f"build: expected a filter and a prior, got {kind(built)}")
        return float(run(*built, self._epochs, keep="nothing").log_likelihood.sum())

    def __call__(self, points: Iterable[Array]) -> Array:
        """``(k,)`` at k points ``(d,)``."""
        return np.array([self._at(s) for s in points])

    def _at(self, s: Array) -> float:
        if s.tobytes() not in self.known:
            try:
                found = self._flown(self._scale(s))
            except (ValueError, ArithmeticError):
                found = np.nan
            self.known[s.tobytes()] = found if np.isfinite(found) else np.nan
        return self.known[s.tobytes()]

    def cost(self, s: Array) -> tuple[float, Array]:
        """What an optimizer minimizes, and its gradient by differences to one side."""
        step = 0.1 * _NEAR
        axes = step * np.eye(len(s))
        center, *beside = self([s, *(s + axes)])
        if np.isnan(center):  # finite, so that a line search turns back, and worse the further out
            depth = 1e3 + abs(self.first)
            return depth * (1.0 + float(s @ s)) - self.first, 2.0 * depth * s
        slope = (np.array(beside) - center) / step
        for i in np.flatnonzero(np.isnan(slope)):
            slope[i] = np.nan_to_num((center - self._at(s - axes[i])) / step)
        return -float(center), -slope

    def searched(self, s: Array, reach: float, left: float, iterations: int) -> tuple[Array, bool, str]:
        """Where the search from s ends: when a step gains no more than ``left``."""
        from scipy.optimize import minimize  # takes a second to import

        found = minimize(
            self.cost, s, jac=True, method="L-BFGS-B", bounds=[(-reach, reach)] * len(s),
            options={"maxiter": iterations, "gtol": 1e-9, "ftol": left / max(1.0, abs(self.cost(s)[0]))},
        )  # fmt: skip
        return np.asarray(found.x), bool(found.success), str(found.message)

    def refined(self, s: Array, tolerance: float) -> tuple[Array, Array, float]:
        """The maximum by Newton's method, second derivatives ``(d, d)`` there, and what of the likelihood is left to gain.

        Where there is no maximum it stays where it is, and inf is left.
        """
        start, curvature, gain = s, self.curvature(s), np.inf
        axes = _NEAR * np.eye(len(s))
        for _ in range(10):
            if not np.isfinite(curvature).all() or (np.linalg.eigvalsh(curvature) >= 0.0).any():
                return s, curvature, np.inf
            gradient, here = (self(s + axes) - self(s - axes)) / (2.0 * _NEAR), self._at(s)
            step = -np.linalg.solve(curvature, gradient)
            gain = float(0.5 * gradient @ step)
            if not np.isfinite(gain):
                return s, np.full(curvature.shape, np.nan), np.inf
            step *= min(1.0, 0.5 / np.abs(step).max(initial=0.5))
            least = here - 1e-12 * abs(here)
            taken = next((part for part in (1.0, 0.25, 0.0625) if self._at(s + part * step) >= least), 0.0)
            s = s + taken * step
            if gain <= tolerance or not taken:
                break
            if np.abs(s - start).max() > 50.0 * _FAR:
                start, curvature = s, self.curvature(s)
        return s, curvature, gain

    def curvature(self, s: Array) -> Array:
        """Second derivatives ``(d, d)``, nan where the filter fails beside s."""
        axes = _FAR * np.eye(len(s))
        H = np.diag(self(s + axes) - 2.0 * self._at(s) + self(s - axes))
        for i, j in combinations(range(len(s)), 2):
            a, b = axes[i], axes[j]
            corners = self([s + a + b, s + a - b, s - a + b, s - a - b])
            H[i, j] = H[j, i] = 0.25 * (corners @ [1.0, -1.0, -1.0, 1.0])
        return np.asarray(H / _FAR**2)
