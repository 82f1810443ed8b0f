"""Noise tuning by the likelihood of the innovations [Schweppe 1965]: the parameters under which the data are most probable."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, logit

from celnav.filters.epochs import Epochs
from celnav.filters.records import Epoch, Filter
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
_MOST = 4096
"""Runs of a batch of parameters."""
_NO_DATA = "epochs: expected measurements, got none"
_VECTORIZED = "noises need the axes of the parameters, such as sqrt_R=parameters[..., :1, None]"


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
    vectorized: bool = False,
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
    vectorized: ``build`` also takes many parameters at once, ``(k, 1, ..., d)`` with an axis of 1 for each axis of the runs, and
        gives noises with these axes: ``sqrt_R=parameters[..., :1, None]``. All differences are then one batch, which for one run
        of data takes little longer than one of them.
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
    if not data:
        raise ValueError(_NO_DATA)
    likelihood = _Likelihood(function("build", build, "(parameters)"), data, scale, vectorized)
    s = np.zeros(len(x0))
    for left in (_ROUGH, 1e-3 * tolerance):  # the second where the first ends on a plateau
        s, converged, message = likelihood.searched(s, reach, left, max_iterations)
        at_end = np.abs(s) > 0.999 * reach
        if at_end.any():
            break
        s, curvature, gain = likelihood.refined(s, tolerance)
        if gain <= tolerance:
            break
    covariance = np.full((len(x0), len(x0)), np.inf)
    why = ""
    if at_end.any():
        i = int(np.argmax(at_end))
        why = f"parameter {i} ran to the end of its range, {scale(s)[i]:.6g}"
    elif not np.isfinite(curvature).all():
        why = "the filter fails beside the most probable parameters: they lie at an edge"
    else:
        eigenvalues, vectors = np.linalg.eigh(curvature)
        if eigenvalues[-1] >= 0.0:
            i = int(np.argmax(np.abs(vectors[:, -1])))
            why = f"the data do not determine parameter {i}: the likelihood has no maximum in it"
        else:
            covariance = (vectors / -eigenvalues) @ vectors.T
            why = "" if gain <= tolerance else f"{gain:.3g} of the log-likelihood is left to gain; {message}"
    errors = scale.slope(s) * np.sqrt(covariance.diagonal())
    best = float(likelihood(s[None])[0])
    return Tuned(
        scale(s), best, errors, covariance, likelihood.evaluations, converged and not why, why or message, likelihood.failures
    )


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
    """Logarithms ``(..., d)``, relative to the start, to parameters: of the distance to the ends of their domain."""

    def __init__(self, ends: Array, start: Array):
        self._low, high = ends
        inside = (start > self._low) & (start < high)
        if not inside.all():
            i = int(np.argmin(inside))
            between = f"parameter {i} between {self._low[i]:g} and {high[i]:g}"
            expected = "positive parameters" if (self._low[i], high[i]) == DOMAINS["positive"] else between
            raise ValueError(f"start: expected {expected}, got {start[i]:g}")
        self._bounded = np.isfinite(high)
        self._width = np.where(self._bounded, high - self._low, 1.0)
        part = (start - self._low) / self._width
        self.origin = np.where(self._bounded, logit(np.where(self._bounded, part, 0.5)), np.log(part))

    def __call__(self, s: Array) -> Array:
        s = self.origin + s
        part = np.where(self._bounded, expit(s), np.exp(np.where(self._bounded, 0.0, s)))
        return np.asarray(self._low + self._width * part)

    def slope(self, s: Array) -> Array:
        """Derivative of the parameters ``(d,)`` by their logarithms."""
        above = self(s) - self._low
        return np.asarray(np.where(self._bounded, above * (1.0 - above / self._width), above))


class _Likelihood:
    """Log-likelihood as a function of logarithms relative to the start, nan where there is none, with its derivatives."""

    def __init__(self, build: Build, epochs: Sequence[Epoch], scale: _Scale, vectorized: bool):
        self._build, self._epochs, self._scale = build, epochs, scale
        self.evaluations, self.failures = 1, 0
        start = np.zeros(len(scale.origin))
        try:
            likelihood = self._flown(scale(start))
        except ArithmeticError as error:
            raise ValueError(f"start: expected parameters at which the filter works; {error}") from error
        except ValueError as error:
            error.add_note(f"at the start, parameters {scale(start)}")
            raise
        self._runs, self.first = likelihood.shape, float(likelihood.sum())
        if not np.isfinite(self.first):
            raise ValueError(f"start: expected a finite log-likelihood, got {self.first}")
        self._known = {start.tobytes(): self.first}
        self._most = max(2, _MOST // max(1, likelihood.size)) if vectorized else 1
        if vectorized:  # parameters together must give what they give alone
            value = float(self._sums(np.array([start + _NEAR, start]))[1])
            self.evaluations += 2
            if not abs(value - self.first) <= 1e-6 * max(1.0, abs(self.first)):
                raise ValueError(f"vectorized: expected the same together and alone, got {value} and {self.first}; {_VECTORIZED}")

    def _flown(self, parameters: Array) -> Array:
        """Log-likelihood of each run, of one filter or of as many as there are parameters."""
        built = self._build(parameters)
        if not (isinstance(built, tuple) and len(built) == 2):
            raise ValueError(f"build: expected a filter and a prior, got {kind(built)}")
        (filter, prior), on_failure = built, "raise"
        if parameters.ndim > 1:  # models may hold the parameters, so points need their axes
            on_failure = "flag"
            batch = np.broadcast_shapes(parameters.shape[:-1], prior.mean.shape[:-1])
            prior = Gaussian(np.broadcast_to(prior.mean, (*batch, prior.mean.shape[-1])), sqrt_cov=prior.sqrt_cov)

        def measured(before: bool | None, _epoch: Epoch, _state: Any, infos: Any) -> bool:
            return bool(before) or any(info.used is not None and bool(np.any(info.used)) for info in infos)

        track = run(filter, prior, self._epochs, keep="nothing", reduce=measured, on_failure=on_failure)
        if not track.reduced:
            raise ValueError(_NO_DATA)
        return track.log_likelihood

    def _sums(self, points: Array) -> Array:
        """``(k,)`` at points ``(k, d)``, summed over the runs; several points are one batch, nan where a filter failed."""
        parameters = self._scale(points)
        if len(points) == 1:
            return np.array([self._flown(parameters[0]).sum()])
        likelihood = self._flown(parameters.reshape(len(points), *(1,) * len(self._runs), -1))
        if likelihood.shape != (len(points), *self._runs):
            expected = f"likelihoods of shape {(len(points), *self._runs)}, one for each of the parameters {parameters.shape}"
            raise ValueError(f"vectorized: expected {expected}, got {likelihood.shape}; {_VECTORIZED}")
        return np.asarray(likelihood.reshape(len(points), -1).sum(-1))

    def _tried(self, points: Array) -> Array:
        """The same, nan where there is no filter; which it was of a batch that fails is found one by one."""
        try:
            found = self._sums(points)
        except (ValueError, ArithmeticError):
            found = np.full(1, np.nan) if len(points) == 1 else np.concatenate([self._tried(one[None]) for one in points])
        return np.where(np.isfinite(found), found, np.nan)

    def __call__(self, points: Array) -> Array:
        """``(k,)`` at points ``(k, d)``, each of which is tried once."""
        new = list({key: s for s in points if (key := s.tobytes()) not in self._known}.values())
        for i in range(0, len(new), self._most):
            part = np.array(new[i : i + self._most])
            found = self._tried(part)
            self._known |= {s.tobytes(): value for s, value in zip(part, found.tolist(), strict=True)}
            self.failures += int(np.isnan(found).sum())
        self.evaluations += len(new)
        return np.array([self._known[s.tobytes()] for s in points])

    def cost(self, s: Array) -> tuple[float, Array]:
        """What an optimizer minimizes, and its gradient by differences to one side."""
        axes = 0.1 * _NEAR * np.eye(len(s))
        center, *beside = self(np.array([s, *(s + axes)])).tolist()
        if np.isnan(center):  # finite, so that a line search turns back, and worse the further out
            depth = 1e3 + abs(self.first)
            return depth * (1.0 + float(s @ s)) - self.first, 2.0 * depth * s
        slope = (np.array(beside) - center) / (0.1 * _NEAR)
        for i in np.flatnonzero(np.isnan(slope)):
            slope[i] = np.nan_to_num((center - self((s - axes[i])[None])[0]) / (0.1 * _NEAR))
        return -center, -slope

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
        start, curvature = s, self.curvature(s)
        axes = _NEAR * np.eye(len(s))
        gain = np.inf
        for _ in range(10):
            if not np.isfinite(curvature).all() or (np.linalg.eigvalsh(curvature) >= 0.0).any():
                return s, curvature, np.inf
            values = self(np.array([*(s + axes), *(s - axes), s]))
            gradient = (values[: len(s)] - values[len(s) : -1]) / (2.0 * _NEAR)
            step = -np.linalg.solve(curvature, gradient)
            gain = float(0.5 * gradient @ step)
            if not np.isfinite(gain):
                return s, np.full(curvature.shape, np.nan), np.inf
            step *= min(1.0, 0.5 / np.abs(step).max(initial=0.5))
            least = values[-1] - 1e-12 * abs(values[-1])
            taken = next((part for part in (1.0, 0.25, 0.0625) if self((s + part * step)[None])[0] >= least), 0.0)
            s = s + taken * step
            if gain <= tolerance or not taken:
                break
            if np.abs(s - start).max() > 50.0 * _FAR:
                start, curvature = s, self.curvature(s)
        return s, curvature, gain

    def curvature(self, s: Array) -> Array:
        """Second derivatives ``(d, d)``, nan where the filter fails beside s."""
        d, h = len(s), _FAR
        axes = h * np.eye(d)
        pairs = [(i, j) for i in range(d) for j in range(i)]
        corners = [s + a * axes[i] + b * axes[j] for i, j in pairs for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        values = self(np.array([s, *(s + axes), *(s - axes), *corners]))
        H = np.diag(values[1 : d + 1] - 2.0 * values[0] + values[d + 1 : 2 * d + 1])
        for (i, j), four in zip(pairs, values[2 * d + 1 :].reshape(-1, 4), strict=True):
            H[i, j] = H[j, i] = 0.25 * (four[0] - four[1] - four[2] + four[3])
        return np.asarray(H / h**2)
