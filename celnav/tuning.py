"""Noise tuning by the likelihood of the innovations [Schweppe 1965]: the deviations under which the data are most probable."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.checks import finite, integer
from celnav.filters.driver import Epoch, Filter, FilterError, run
from celnav.filters.info import Info
from celnav.gaussian import Gaussian
from celnav.linalg import Array


class Tuned(NamedTuple):
    """The maximum of a likelihood.

    Attributes
    ----------
    parameters: ``(d,)`` where the likelihood is largest.
    log_likelihood: there, of all runs together.
    standard_errors: ``(d,)`` of the parameters, by the curvature; inf where ``converged`` is False for want of one.
    covariance: ``(d, d)`` of the parameters' *logarithms*: an interval is ``parameters * exp(+-2 sqrt(diagonal))``.
    evaluations: filter runs that it took, those for gradient and curvature included.
    converged: whether the parameters are an inner maximum of the likelihood.
    message: what the optimizer said, or why there is no such maximum.
    """

    parameters: Array
    log_likelihood: float
    standard_errors: Array
    covariance: Array
    evaluations: int
    converged: bool
    message: str


def maximize_likelihood(
    build: Callable[[Array], tuple[Filter, Gaussian]],
    start: ArrayLike,
    epochs: Iterable[Epoch],
    *,
    factor: float = 1e3,
    tolerance: float = 1e-3,
    max_iterations: int = 100,
) -> Tuned:
    """Maximize ``Track.log_likelihood``, summed over the runs, over positive parameters (standard deviations, say).

    The search is on logarithms (L-BFGS-B with central differences), so parameters may be of any size. Each evaluation runs
    the filter once; parameters at which it fails count as improbable.

    Parameters
    ----------
    build: ``parameters (d,) -> (filter, prior)``.
    start: ``(d,)``, positive.
    epochs: the data; the same for all parameters.
    factor: the search stays within ``start / factor`` and ``start * factor``.
    tolerance: of the gradient of the log-likelihood by the logarithm of a parameter.
    max_iterations: of the optimizer.

    Raises
    ------
    ValueError: for a start that is not positive, at which the filter fails, or without any measurement; for a bad option.
    """
    x0 = finite("start", start)
    if x0.ndim != 1 or not len(x0) or not (x0 > 0.0).all():
        raise ValueError(f"start: expected positive parameters of shape (d,), got {x0!r:.80}")
    if not factor > 1.0:
        raise ValueError(f"factor: expected a number above 1, got {factor!r}")
    if not tolerance > 0.0:
        raise ValueError(f"tolerance: expected a positive number, got {tolerance!r}")
    integer("max_iterations", max_iterations)
    likelihood = _Likelihood(build, epochs if isinstance(epochs, Sequence) else list(epochs), np.log(x0))
    reach = np.log(factor)
    from scipy.optimize import minimize  # takes a second to import

    found = minimize(
        likelihood.cost, np.zeros(len(x0)), jac=likelihood.slope, method="L-BFGS-B",
        bounds=[(-reach, reach)] * len(x0), options={"maxiter": max_iterations, "gtol": tolerance, "ftol": 1e-12},
    )  # fmt: skip
    s = np.asarray(found.x)
    parameters, best = x0 * np.exp(s), likelihood(s)
    curvature = likelihood.curvature(s)
    converged, message = bool(found.success), str(found.message)
    at_bound = np.abs(s) > 0.999 * reach
    eigenvalues, vectors = np.linalg.eigh(curvature)
    peaked = bool((eigenvalues < 0.0).all())
    if at_bound.any():
        i = int(np.argmax(at_bound))
        converged, message = False, f"parameter {i} ran to the end of its range, {parameters[i]:.6g}"
    elif not peaked:
        i = int(np.argmax(np.abs(vectors[:, -1])))
        converged, message = False, f"the data do not determine parameter {i}: the likelihood has no maximum in it"
    covariance = (vectors / -eigenvalues) @ vectors.T if peaked else np.full(curvature.shape, np.inf)
    errors = parameters * np.sqrt(covariance.diagonal())
    return Tuned(parameters, best, errors, covariance, likelihood.evaluations, converged, message)


def _measured(known: bool | None, _epoch: Epoch, _state: Any, info: Any) -> bool:
    """Whether anything was measured so far."""
    infos = (info,) if isinstance(info, Info) else info
    return bool(known) or any(i.used is not None and bool(np.any(i.used)) for i in infos)


class _Likelihood:
    """Log-likelihood as a function of the logarithms of the parameters relative to the start, with its derivatives."""

    def __init__(self, build: Callable[[Array], tuple[Filter, Gaussian]], epochs: Sequence[Epoch], origin: Array):
        self._build, self._epochs, self._origin = build, epochs, origin
        self._known: dict[bytes, float] = {}
        self.evaluations = 0
        try:
            self._first = self._run(np.zeros(len(origin)))
        except FilterError as error:
            raise ValueError(f"start: expected parameters at which the filter works; {error}") from error
        if not np.isfinite(self._first):
            raise ValueError(f"start: expected a finite log-likelihood, got {self._first}")

    def _run(self, s: Array) -> float:
        self.evaluations += 1
        built = self._build(np.exp(self._origin + s))
        if not (isinstance(built, tuple) and len(built) == 2):
            raise ValueError(f"build: expected a filter and a prior, got {type(built).__name__}")
        track = run(*built, self._epochs, keep="nothing", reduce=_measured)
        if not track.reduced:
            raise ValueError("epochs: expected measurements, got none")
        return float(track.log_likelihood.sum())

    def __call__(self, s: Array) -> float:
        key = s.tobytes()
        if key not in self._known:
            try:
                value = self._run(s)
            except FilterError:
                value = np.nan
            # finite, so that a line search turns back, and worse the further out
            improbable = self._first - (1e3 + abs(self._first)) * (1.0 + float(s @ s))
            self._known[key] = value if np.isfinite(value) else improbable
        return self._known[key]

    def cost(self, s: Array) -> float:
        """What an optimizer minimizes."""
        return -self(s)

    def slope(self, s: Array) -> Array:
        """Gradient of the cost, by central differences: the likelihood is smooth in the logarithms."""
        h = 1e-4
        return np.array([self(s - h * e) - self(s + h * e) for e in np.eye(len(s))]) / (2.0 * h)

    def curvature(self, s: Array, h: float = 1e-2) -> Array:
        """Second derivatives ``(d, d)``."""
        d, axes, center = len(s), h * np.eye(len(s)), self(s)
        H = np.empty((d, d))
        for i in range(d):
            H[i, i] = self(s + axes[i]) - 2.0 * center + self(s - axes[i])
            for j in range(i):
                a, b = axes[i], axes[j]
                H[i, j] = H[j, i] = 0.25 * (self(s + a + b) - self(s + a - b) - self(s - a + b) + self(s - a - b))
        return H / h**2
