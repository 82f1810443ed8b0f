"""Filters named by the parts that they are composed of, and how each does on problems of one's own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from time import process_time
from typing import Any, NamedTuple, cast

import numpy as np

from celnav.filters.adaptive import gate, huber, innovation_window, student_t
from celnav.filters.colored import colored
from celnav.filters.records import Filter, Hook
from celnav.filters.run import steps
from celnav.filters.sequential import sigma_point
from celnav.gaussian.checks import choice, instance, integer, sequence
from celnav.gaussian.rules import cubature, gauss_hermite, unscented
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.gaussian.sparse_grid import smolyak
from celnav.gaussian.taylor import Taylor
from celnav.study.montecarlo import generator
from celnav.study.problem import Problem
from celnav.study.scores import score, summarize
from celnav.study.trial import Noiseless, Trial, bound, follow

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
        return " · ".join([self.rule, self.form, *(["colored"] if self.colored else []), *([self.hook] if self.hook else [])])


COMPOSITIONS = (
    *(Composition(rule, form=form) for rule in RULES for form in FORMS),
    *(Composition(rule, colored=True) for rule in RULES),
    *(Composition("unscented", hook=hook) for hook in HOOKS),
    Composition("sparse grid", hook="Huber"),
    Composition("sparse grid", colored=True, hook="Huber"),
)


def compose(problem: Problem, parts: Composition) -> Filter | None:
    """The filter; None where the parts do not go together: the filter for colored noise is one of vectors, and takes the process
    noise through the points; and where there would be more than `MOST_POINTS`.
    """
    instance("problem", problem, Problem, "a Problem(f, h, ...)")
    instance("parts", parts, Composition, "a Composition, such as Composition('unscented')")
    n, m = problem.n, problem.m
    if parts.rule == "Gauss-Hermite" and 3 ** (n + parts.colored * problem.sqrt_Q.shape[1]) > MOST_POINTS:
        return None
    options: dict[str, Any] = {"rule": RULES[parts.rule], "form": parts.form, "hooks": [HOOKS[parts.hook]()] if parts.hook else []}
    if not parts.colored:
        return sigma_point(problem.motion, problem.sensor, **options)
    if problem.space == EUCLIDEAN and problem.measurement_space == EUCLIDEAN:
        return colored(problem.motion, problem.sensor, problem.phi * np.eye(m), **options)
    return None


PASSES = 3


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
            found = (first.rms, first.low, first.high, first.efficiency, summary.anees, summary.low, summary.high)
            rows.append(Row(name, filter, *found, len(failures), 1e6 * cost))
    return rows


def _seconds(filter: Filter, trial: Trial, name: str) -> float:
    """CPU time of one pass."""
    start = process_time()
    for _ in steps(filter, trial.prior, trial.epochs(name)):
        pass
    return process_time() - start
