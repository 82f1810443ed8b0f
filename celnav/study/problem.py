"""A problem of one's own, and how filters do on it: a model, the runs that it draws of itself, and filters by their parts.

A filter is consistent, and its accuracy can be compared with a bound, where what happens is what it believes: here truth and
measurements come from the very model that filters are made of, its outliers excepted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from time import process_time
from typing import Any, NamedTuple, cast

import numpy as np
from scipy.special import ndtri

from celnav.filters.adaptive import gate, huber, innovation_window, student_t
from celnav.filters.colored import colored
from celnav.filters.epochs import epochs
from celnav.filters.joint import Hook, evaluate
from celnav.filters.model import Model, Motion, Sensor
from celnav.filters.records import Epoch, Filter
from celnav.filters.run import steps
from celnav.filters.sequential import sigma_point
from celnav.gaussian.belief import Gaussian, symmetric
from celnav.gaussian.checks import choice, finite, function, instance, integer, number, sequence
from celnav.gaussian.linalg import Array, Belief
from celnav.gaussian.rules import Taylor, cubature, gauss_hermite, unscented
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.gaussian.sparse_grid import smolyak
from celnav.study.montecarlo import generator, normals
from celnav.study.scores import score, summarize
from celnav.study.trial import Group, Noiseless, Trial, bound, follow

WILD = 10.0
"""By how much an outlier's noise is larger."""


@dataclass(frozen=True, eq=False)
class Problem:
    """``x' = f(x, epoch) + w`` and ``z = h(x, epoch) + V`` from a Gaussian start.

    Attributes
    ----------
    f, h: models of points ``(p, ..., N)`` and `celnav.Epoch`: the state ``(p, ..., N)`` after the interval, and the
        measurement ``(p, ..., M)``.
    mean: ``(N,)`` and cov ``(n, n)``: of the start.
    sqrt_Q: columns ``(n, r)`` of the process noise of an interval. R: covariance ``(m, m)`` of V.
    times: ``(T,)`` s, increasing. u: inputs, ``epoch.u``: ``u[k]`` acts from ``times[k]`` to ``times[k + 1]``.
    phi: correlation of V with the last one, in [0, 1): an AR(1) process.
    outliers: part of the components, in [0, 1), whose noise is `WILD` times as large; filters are not told.
    space, measurement_space: what a difference of states and of measurements is.
    groups: what is judged, by name; one group of all components if empty.

    >>> rows = compare({"falling body": Problem(f, h, mean, cov, sqrt_Q, R, times)}, runs=200)
    """

    f: Model
    h: Model
    mean: Array
    cov: Array
    sqrt_Q: Array
    R: Array
    times: Array
    u: Array | None = None
    phi: float = 0.0
    outliers: float = 0.0
    space: Space = EUCLIDEAN
    measurement_space: Space = EUCLIDEAN
    groups: Sequence[Group] = ()

    def __post_init__(self) -> None:
        for name in ("mean", "cov", "sqrt_Q", "R", "times"):
            object.__setattr__(self, name, finite(name, getattr(self, name)))
        for name in ("phi", "outliers"):
            number(name, getattr(self, name), 0.0, below=1.0)
        for name in ("f", "h"):
            function(name, getattr(self, name), "(points, epoch)")
        for name in ("space", "measurement_space"):
            instance(name, getattr(self, name), Space, "a Space, such as celnav.angles([0])")
        for name in ("cov", "R"):
            if getattr(self, name).ndim != 2:
                raise ValueError(f"{name}: expected a matrix, got shape {getattr(self, name).shape}")
            symmetric(getattr(self, name), name)
        if self.sqrt_Q.ndim != 2 or len(self.sqrt_Q) != self.n:
            raise ValueError(f"sqrt_Q: expected columns ({self.n}, r), got {self.sqrt_Q.shape}")
        if self.mean.ndim != 1 or (self.space == EUCLIDEAN and len(self.mean) != self.n):
            raise ValueError(f"mean: expected shape ({self.n},) to go with cov, got {self.mean.shape}")
        if self.times.ndim != 1 or len(self.times) < 2 or not (np.diff(self.times) > 0.0).all():
            raise ValueError(f"times: expected two or more increasing numbers, got shape {self.times.shape}")
        epochs(self.times, u=self.u)
        for group in sequence("groups", self.groups, "[Group('position', 'm', slice(0, 3))]"):
            instance("groups", group, Group, "each a Group, such as Group('position', 'm', slice(0, 3))")
            if not isinstance(group.part, slice) or not len(range(self.n)[group.part]):
                raise ValueError(f"groups: expected a slice of {self.n} components for {group.name}, got {group.part!r}")

    @property
    def n(self) -> int:
        """Dimension of the state's differences."""
        return len(self.cov)

    @property
    def m(self) -> int:
        """Dimension of the measurement's differences."""
        return len(self.R)

    @property
    def motion(self) -> Motion:
        """What a filter believes of the dynamics."""
        return Motion(self.f, sqrt_Q=self.sqrt_Q, space=self.space)

    @property
    def sensor(self) -> Sensor:
        """What a filter believes of the measurement."""
        return Sensor(self.h, self.R, space=self.measurement_space)

    @property
    def prior(self) -> Gaussian:
        """Belief about the start."""
        return Gaussian(self.mean, self.cov)

    def draw(self, rngs: Sequence[np.random.Generator]) -> tuple[Array, Array]:
        """Truth ``(T, runs, N)`` and measurements ``(T, runs, M)`` of one run with each generator."""
        T, r, m = len(self.times), self.sqrt_Q.shape[1], self.m
        start, walk, noise, lot = normals(rngs, (self.n,), (T, r), (T, m), (T, m))
        walk, noise = walk @ self.sqrt_Q.T, noise @ symmetric(self.R, "R")[1].T
        factor = np.where(np.abs(lot) > (ndtri(1.0 - 0.5 * self.outliers) if self.outliers else np.inf), WILD, 1.0)
        mean = np.tile(self.mean, (len(start), 1))
        x, V = self.space.plus(mean, start @ symmetric(self.cov, "cov")[1].T), noise[0]
        motion, sensor, truth, z = self.motion, self.sensor, [], []
        for epoch in epochs(self.times, u=self.u):
            if epoch.k:
                x = self.space.plus(_image("f", evaluate(motion, x[None].copy(), epoch), epoch), walk[epoch.k])
                V = self.phi * V + np.sqrt(1.0 - self.phi**2) * noise[epoch.k]
            truth.append(x)
            seen = _image("h", evaluate(sensor, x[None].copy(), epoch, m=m), epoch)
            z.append(self.measurement_space.plus(seen, factor[epoch.k] * V))
        return np.stack(truth), np.stack(z)

    def trial(self, filters: Mapping[str, Filter], rngs: Sequence[np.random.Generator], reference: str = "") -> Trial:
        """Runs for filters to be judged on; ``reference``: see `celnav.study.trial.Trial`."""
        instance("filters", filters, Mapping, "filters by name, such as {'ukf': filter}")
        choice("reference", reference, ("", *filters))
        truth, z = self.draw(rngs)
        prior = Gaussian(np.tile(self.mean, (truth.shape[1], 1)), self.cov)
        every = epochs(self.times, z, self.u, truth)
        groups = tuple(self.groups) or (Group("state", "", slice(0, self.n)),)
        return Trial(groups, filters, prior, lambda _name: every, self._compare, reference)

    def _compare(self, truth: Any, belief: Belief) -> tuple[Array, Array]:
        return -self.space.minus(truth, belief.mean), belief.sqrt_cov  # the root is that of tangents at the mean


def _image(name: str, points: Array, epoch: Epoch) -> Array:
    if not np.isfinite(points).all():
        raise ValueError(f"{name}: expected finite numbers, got others at t = {epoch.t}")
    return np.asarray(points[0])


RULES: dict[str, Callable[[int], Any]] = {
    "Taylor": lambda _n: Taylor(),
    "unscented": unscented,
    "cubature 5": lambda n: cubature(n, degree=5),
    "Gauss-Hermite": gauss_hermite,
    "sparse grid": lambda n: smolyak(n, 3),
}
FORMS = ("square root", "covariance")
HOOKS: dict[str, Callable[[], Hook]] = {
    "window": lambda: innovation_window(10),
    "gate": lambda: gate(4.0),
    "Huber": huber,
    "Student": student_t,
}
MOST_POINTS = 500
"""Rules of more points are left out: a product of Gauss-Hermite rules has 3^n."""
PASSES = 3


@dataclass(frozen=True)
class Composition:
    """A filter by its parts, of `RULES`, `FORMS` and `HOOKS`; ``colored``: whether it takes measurement noise for what it is."""

    rule: str
    _: KW_ONLY
    form: str = "square root"
    colored: bool = False
    hook: str = ""

    def __post_init__(self) -> None:
        for name, known in (("rule", RULES), ("form", FORMS), ("hook", ("", *HOOKS))):
            choice(name, getattr(self, name), known)

    def __str__(self) -> str:
        return " · ".join(filter(None, [self.rule, self.form, "colored" if self.colored else "", self.hook]))


COMPOSITIONS = (
    *(Composition(rule, form=form) for rule in RULES for form in FORMS),
    *(Composition(rule, colored=True) for rule in RULES),
    *(Composition("unscented", hook=hook) for hook in HOOKS),
    Composition("sparse grid", hook="Huber"),
    Composition("sparse grid", colored=True, hook="Huber"),
)


def compose(problem: Problem, parts: Composition) -> Filter | None:
    """The filter; None where the parts do not go together: the one for colored noise is a filter of vectors, and no rule may have
    more than `MOST_POINTS` (for colored noise that of the process goes through the points, too).
    """
    instance("problem", problem, Problem, "a Problem(f, h, ...)")
    instance("parts", parts, Composition, "a Composition, such as Composition('unscented')")
    if parts.colored and not problem.space == problem.measurement_space == EUCLIDEAN:
        return None
    if parts.rule == "Gauss-Hermite" and 3 ** (problem.n + parts.colored * problem.sqrt_Q.shape[1]) > MOST_POINTS:
        return None
    options: dict[str, Any] = {"rule": RULES[parts.rule], "form": parts.form, "hooks": [HOOKS[parts.hook]()] if parts.hook else []}
    if parts.colored:
        return colored(problem.motion, problem.sensor, problem.phi * np.eye(problem.m), **options)
    return sigma_point(problem.motion, problem.sensor, **options)


class Row(NamedTuple):
    """How a filter does on a problem.

    Attributes
    ----------
    problem, filter: names. rms: of the first group over the second half of the epochs; rms_low, rms_high: its 95 % interval.
    efficiency: the linearized posterior Cramer-Rao bound (see `celnav.study.trial.bound`) over it: about 1 if it is as good as can
        be; a little more by chance, or where process noise leads away from the run about which it is linearized.
    anees, low, high: NEES over its dimension, 1 if consistent, with its interval. Intervals come from how the runs differ.
    lost: runs without an estimate. us_per_step: CPU time of a run's step, microseconds, the least of `PASSES`.
    """

    problem: str
    filter: str
    rms: float
    rms_low: float
    rms_high: float
    efficiency: float
    anees: float
    low: float
    high: float
    lost: int
    us_per_step: float


def compare(
    problems: Mapping[str, Problem], parts: Iterable[Composition] = COMPOSITIONS, *, runs: int = 200, seed: int = 0
) -> list[Row]:
    """Fly all compositions on all problems, on the same noise; those that do not go together are left out.

    The bound is the linearized one, of the filter that knows the color (where it can be composed) along the undisturbed run. It
    takes no notice of outliers.

    >>> pandas.DataFrame(compare({"falling body": problem}, runs=200))
    """
    runs, chosen = integer("runs", runs), sequence("parts", parts, "[Composition('unscented')]")
    rows = []
    for name, problem in instance("problems", problems, Mapping, "problems by name, such as {'turn': problem}").items():
        instance("problems", problem, Problem, "each a Problem(f, h, ...)")
        best = Composition("Taylor", colored=problem.phi > 0.0)
        filters = {str(p): made for p in dict.fromkeys([best, *chosen]) if (made := compose(problem, p)) is not None}
        reference = str(best) if str(best) in filters else ""
        trial = problem.trial(filters, [generator(seed, 0, run) for run in range(runs)], reference)
        least = bound(problem.trial(filters, cast(Any, [Noiseless()]), reference))
        for filter in (str(p) for p in chosen if str(p) in filters):
            scores, failures = score(follow(trial, filter), trial.groups, settle_s=None, limits={})
            summary = summarize(scores, least)
            cost = min(_seconds(filters[filter], trial, filter) for _ in range(PASSES)) / (runs * len(problem.times))
            first = summary.accuracy[0]
            accuracy = first.rms, first.low, first.high, first.efficiency
            rows.append(Row(name, filter, *accuracy, summary.anees, summary.low, summary.high, len(failures), 1e6 * cost))
    return rows


def _seconds(filter: Filter, trial: Trial, name: str) -> float:
    """CPU time of one pass."""
    start = process_time()
    for _ in steps(filter, trial.prior, trial.epochs(name)):
        pass
    return process_time() - start
