"""A trial: simulated runs of one configuration, the filters that may be flown on them, and how their estimates are judged.

Each paper has a function ``trial(config, rngs) -> Trial``; missions, campaigns and the linear bound need nothing else of it.
Scores are sums over runs, enough for every statistic of a campaign, so that no track is ever kept: a block of runs is scored,
scores of blocks are merged by adding, in whatever number they come, and a `Summary` reads the sum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaincinv, stdtrit

from celnav.analysis.metrics import chi_square_band
from celnav.filters.records import Epoch, Filter, Info
from celnav.filters.run import explain, steps
from celnav.gaussian.belief import Gaussian, any_lost, nees
from celnav.gaussian.checks import choice, instance, integer
from celnav.gaussian.linalg import Array, Belief

TOGETHER = 8
"""Epochs whose roots are evaluated at once; with more of them the filter's own arrays leave the cache."""


class Group(NamedTuple):
    """Components of the error that are judged together, such as a position.

    ``part`` of the error's components, times ``scale`` (a number, or one for each of them), are in ``unit``.
    """

    name: str
    unit: str
    part: slice
    scale: float | tuple[float, ...] = 1.0


class Trial(NamedTuple):
    """Simulated runs of a configuration.

    Attributes
    ----------
    groups: what is judged. filters: by name. prior: of all runs, ``(runs, n)``.
    epochs: ``name ->`` epochs for the filter of that name, from the start at every call. Those with a ``truth`` are judged.
    compare: ``(truth, belief) ->`` errors ``(runs, n)`` and roots ``(runs, n, n)`` of what the belief takes for their covariance.
    reference: name of a filter that is as good as can be where errors are small, for `bound`; empty if there is none.
    place: position ``(..., 3)`` km about the Earth's center of a state ``(..., n)``; None if it is no orbit.
    """

    groups: tuple[Group, ...]
    filters: Mapping[str, Filter]
    prior: Gaussian
    epochs: Callable[[str], Iterable[Epoch]]
    compare: Callable[[Any, Belief], tuple[Array, Array]]
    reference: str = ""
    place: Callable[[Array], Array] | None = None


def squares(groups: Sequence[Group], values: Array) -> Array:
    """Sums of squares ``(..., groups)`` of errors or deviations ``(..., n)``, in the units of the groups."""
    parts = [np.square(values[..., group.part] * np.asarray(group.scale)) for group in groups]
    # One by one: reductions over so few numbers take several times as long.
    return np.stack([reduce(np.add, np.moveaxis(part, -1, 0)) for part in parts], -1)


class Noiseless:
    """A generator of zeros: the run that it gives is the undisturbed one."""

    def standard_normal(self, shape: tuple[int, ...]) -> Array:
        """Zeros."""
        return np.zeros(shape)


class Followed(NamedTuple):
    """A filter's runs at the ``K`` epochs that were judged; nan where a run has no estimate.

    Attributes
    ----------
    times: ``(K,)`` s. error: ``(K, runs, n)``, and std: what the filter takes for its deviations.
    nees, nis, dof: ``(K, runs)``; ``dof`` is the number of measured components behind ``nis``.
    lost: ``(run, t, why)`` of each run whose estimate ceased to be finite. epochs: of the filter, judged or not.
    """

    times: Array
    error: Array
    std: Array
    nees: Array
    nis: Array
    dof: Array
    lost: list[tuple[int, float, str]]
    epochs: int


def follow(trial: Trial, name: str, every: int = 1) -> Followed:
    """Run the filter of a name and judge it at each ``every``-th of the epochs that have a truth, and at the last.

    Whatever the models raise passes through, with the step as a note.
    """
    instance("trial", trial, Trial, "a Trial, such as problem.trial(filters, rngs)")
    filter, every = trial.filters[choice("name", name, trial.filters)], integer("every", every)
    lost: dict[int, tuple[float, str]] = {}
    count = 0

    def judged() -> Iterator[tuple[Any, ...]]:
        nonlocal count
        seen, before, left = 0, None, None
        for epoch, state, infos in steps(filter, trial.prior, trial.epochs(name)):
            count += 1
            why = ""
            if any_lost(state.belief):  # newly: a filter of single epochs may have had no estimate before
                start = filter.start(trial.prior) if before is None else before
                why = explain(filter, start, state, epoch) if (state.belief.lost() & ~start.belief.lost()).any() else ""
            before = state
            due = epoch.truth is not None and seen % every == 0
            if epoch.truth is not None:
                seen, left = seen + 1, None if due else (epoch, state.belief, infos)
            if due or why:
                _watch(lost, epoch, state.belief, why)
            if due:
                yield _row(trial, epoch, state.belief, infos)
        if left is not None:
            _watch(lost, *left[:2])
            yield _row(trial, *left)

    rows, blocks = judged(), []
    for block in iter(lambda: list(islice(rows, TOGETHER)), []):
        times, error, root, nis, dof = (np.array(column, np.float64) for column in zip(*block, strict=True))
        with np.errstate(invalid="ignore"):  # a lost run is nan
            blocks.append((times, error, np.sqrt(np.einsum("...ij,...ij->...i", root, root)), nees(error, root), nis, dof))
    if not blocks:
        raise ValueError("epochs: expected some with a truth, got none")
    times, error, std, normalized, nis, dof = (np.concatenate(column) for column in zip(*blocks, strict=True))
    return Followed(times, error, std, normalized, nis, dof, [(run, *what) for run, what in sorted(lost.items())], count)


def _row(trial: Trial, epoch: Epoch, belief: Belief, infos: tuple[Info, ...]) -> tuple[Any, ...]:
    """Time, errors and their roots, NIS and the components behind it, at an epoch."""
    with np.errstate(invalid="ignore"):
        error, root = trial.compare(epoch.truth, belief)
    runs = error.shape[:-1]
    nis = sum((value for info in infos if (value := info.nis) is not None), np.zeros(runs))
    dof = sum((info.used.sum(-1) for info in infos if info.used is not None), np.zeros(runs))
    return epoch.t, error, np.broadcast_to(root, (*runs, *root.shape[-2:])), nis, dof


def _watch(lost: dict[int, tuple[float, str]], epoch: Epoch, belief: Belief, why: str = "") -> None:
    """Note the runs that have no estimate, and forget those that have one again: a filter of single epochs comes back."""
    there = np.atleast_1d(np.isfinite(belief.mean).all(-1))
    for run in np.flatnonzero(~there).tolist():
        lost.setdefault(run, (float(epoch.t), why or "the estimate is not finite"))
    for run in [run for run in lost if there[run]]:
        del lost[run]


def bound(trial: Trial, every: int = 1) -> Array | None:
    """Linearized posterior Cramer-Rao bound, from a trial of one `Noiseless` run: mean squares ``(K, groups)``, or None.

    These are the variances of the reference filter along the undisturbed run: for small process noise and errors in the linear
    range, no filter with this model and these measurements has smaller mean squares.
    """
    instance("trial", trial, Trial, "a Trial, such as problem.trial(filters, rngs)")
    return squares(trial.groups, follow(trial, trial.reference, every).std)[:, 0] if trial.reference else None


Scores = dict[str, Array]
"""Sums over runs that did not fail.

times ``(K,)`` s. dimension ``()``: of the error. settled ``(K,)``: which epochs statistics are of. runs ``()``.
count, nis, dof ``(K,)`` and square ``(K, groups)``: at each epoch, over the runs that have an estimate there. known ``(K,)``,
variance ``(K, groups)``: over those with a covariance too. own ``(2, groups)``, own_nees ``(2,)``: of each run's mean over the
settled epochs, and of its square; judged ``()``: how many runs have a NEES there. nees_beyond, nis_beyond ``(2,)``: single values
above their 95 % quantile, and all.
"""
CONSTANT = ("times", "dimension", "settled")
"""Scores that are no sums."""


class Failure(NamedTuple):
    """A run that is not scored: when its estimate was lost, and why."""

    run: int
    t: float
    why: str


def score(
    followed: Followed, groups: tuple[Group, ...], *, settle_s: float | None, limits: Mapping[str, float]
) -> tuple[Scores, list[Failure]]:
    """Scores of a block, and its runs that failed: lost their estimate, or ended with an error above the limit of its group.

    ``settle_s``: the mean over time begins here, not after the last epoch; None: in the middle of the run.
    """
    times, end = followed.times, float(followed.times[-1])
    if settle_s is not None and settle_s > end:
        raise ValueError(f"settle_s: expected a time of at most {end:g} s, the last epoch, got {settle_s:g}")
    settled = np.arange(len(times)) >= len(times) // 2 if settle_s is None else times >= settle_s
    square, variance = squares(groups, followed.error), squares(groups, followed.std)
    there = np.asarray(np.isfinite(square).all(-1))
    sound = there & np.isfinite(followed.nees)
    failures = {run: Failure(run, t, why) for run, t, why in followed.lost}

    def fail(which: Any, why: str) -> None:
        for run in np.flatnonzero(which).tolist():
            failures.setdefault(run, Failure(run, end, why))

    for group, last in zip(groups, square[-1].T, strict=True):
        limit = limits.get(group.name, np.inf)
        fail(last > limit**2, f"{group.name}: error above {limit:g} {group.unit} at the end")
    fail(~there[settled].any(0), "no estimate at any settled epoch")
    fail(np.isnan(variance[settled]).all((0, 2)), "no positive definite covariance at any settled epoch")
    good = np.array([run not in failures for run in range(square.shape[1])], bool)
    chosen = slice(None) if good.all() else good
    nees, nis, dof = followed.nees[:, chosen], followed.nis[:, chosen], followed.dof[:, chosen]
    square, variance, there, sound = (values[:, chosen] for values in (square, variance, there, sound))
    known = there & np.isfinite(variance).all(-1)
    judged, n = sound[settled].any(0), followed.error.shape[-1]
    scores = {
        "times": times,
        "dimension": n,
        "settled": settled,
        "runs": good.sum(),
        "count": there.sum(1),
        "square": _only(square, there).sum(1),
        "known": known.sum(1),
        "variance": _only(variance, known).sum(1),
        "nis": _only(nis, there).sum(1),
        "dof": _only(dof, there).sum(1),
        "judged": judged.sum(),
        "own": _moments(_mean(square[settled], there[settled])),
        "own_nees": _moments(_mean(nees[settled], sound[settled])[judged]),
        "nees_beyond": _beyond(nees[settled], np.full(nees[settled].shape, n)),
        "nis_beyond": _beyond(nis[settled], np.where(there[settled], dof[settled], 0.0)),
    }
    return {name: np.asarray(value, np.float64) for name, value in scores.items()}, list(failures.values())


def _only(values: Array, there: Array) -> Array:
    """Zero where nothing is; ``there`` has the first axes of the values."""
    return values if there.all() else np.where(there.reshape(*there.shape, *(1,) * (values.ndim - 2)), values, 0.0)


def _mean(values: Array, there: Array) -> Array:
    """Mean over time of what is there, for each run; zero where nothing is."""
    count = np.maximum(there.sum(0), 1)
    return np.asarray(_only(values, there).sum(0) / count.reshape(-1, *(1,) * (values.ndim - 2)))


def _moments(own: Array) -> Array:
    """Sums over the runs of values and of their squares."""
    return np.stack([own.sum(0), np.square(own).sum(0)])


def _beyond(values: Array, dof: Array) -> Array:
    """How many chi-square values are above their 95 % quantile, and how many there are."""
    there = (dof > 0) & np.isfinite(values)
    freedom, which = np.unique(dof[there], return_inverse=True)
    return np.array([(values[there] > 2.0 * gammaincinv(0.5 * freedom, 0.95)[which]).sum(), there.sum()])


def check_scores(scores: Scores, groups: int) -> None:
    """Raise ValueError unless these are numbers of the names and shapes that `score` makes for so many groups."""
    K, G = scores.get("times", np.empty(0)).shape[:1], (groups,)
    shapes = {
        "times": K, "settled": K, "count": K, "known": K, "nis": K, "dof": K, "square": K + G, "variance": K + G, "own": (2, *G),
        "own_nees": (2,), "nees_beyond": (2,), "nis_beyond": (2,), "dimension": (), "runs": (), "judged": (),
    }  # fmt: skip
    if set(scores) != set(shapes):
        raise ValueError(f"expected scores {', '.join(shapes)}, got {', '.join(scores)}")
    for name, shape in shapes.items():
        if scores[name].shape != shape or scores[name].dtype != np.float64:
            raise ValueError(f"{name}: expected numbers of shape {shape}, got {scores[name].dtype} of {scores[name].shape}")


def merge(parts: Iterable[Scores]) -> Scores:
    """Sum of scores of the same epochs, one or more, in the order given."""
    total: Scores = {}
    for part in parts:
        if total and not np.array_equal(part["times"], total["times"]):
            raise ValueError("scores: expected the same epochs in all blocks")
        total = {name: total[name] + part[name] if total and name not in CONSTANT else part[name] for name in part}
    if not total:
        raise ValueError("scores: expected at least one block, got none")
    return total


class Accuracy(NamedTuple):
    """Root mean squares of a group: over the settled epochs with a 95 % interval, at the end, and what the filter takes it for.

    The interval comes from how the runs differ: no errors need be Gaussian. ``efficiency``: `celnav.study.trial.bound` over rms.
    """

    rms: float
    low: float
    high: float
    final: float
    sigma: float
    bound: float
    efficiency: float


class Summary(NamedTuple):
    """What scores say.

    Attributes
    ----------
    runs: scored. accuracy: of each group.
    anees, low, high: NEES averaged over runs and settled epochs, over its dimension (1 if consistent), with a 95 % interval from
        how the runs differ. band: where the mean over the runs at a single epoch lies with 95 %, if consistent.
    nis: NIS over its degrees of freedom, averaged over the settled epochs.
    nees_beyond, nis_beyond: part of single values above their 95 % quantiles, .05 if consistent.
    """

    runs: int
    accuracy: tuple[Accuracy, ...]
    anees: float
    low: float
    high: float
    band: tuple[float, float]
    nis: float
    nees_beyond: float
    nis_beyond: float


def summarize(scores: Scores, bound: Array | None = None) -> Summary:
    """Statistics of scores; ``bound (K, groups)``: mean squares. nan where no run is left."""
    runs, n = int(scores["runs"]), int(scores["dimension"])
    settled = scores["settled"] > 0.0
    rms, low, high = _interval(scores["own"], runs)
    anees, least_anees, most_anees = (float(v[0]) / n for v in _interval(scores["own_nees"][:, None], int(scores["judged"])))
    with np.errstate(invalid="ignore", divide="ignore"):
        final = np.sqrt(scores["square"][-1] / scores["count"][-1])
        sigma = np.sqrt(scores["variance"][settled].sum(0) / scores["known"][settled].sum())
        nis = float(scores["nis"][settled].sum() / scores["dof"][settled].sum())
        least = np.full(len(rms), np.nan) if bound is None else np.sqrt(bound[settled].mean(0))
        columns = np.stack([np.sqrt(rms), np.sqrt(low), np.sqrt(high), final, sigma, least, least / np.sqrt(rms)], -1)
        nees_beyond, nis_beyond = (float(scores[name][0] / scores[name][1]) for name in ("nees_beyond", "nis_beyond"))
    accuracy = tuple(Accuracy(*row) for row in columns.tolist())
    a, b = chi_square_band(n, runs) if runs else (np.nan, np.nan)
    return Summary(runs, accuracy, anees, least_anees, most_anees, (a / n, b / n), nis, nees_beyond, nis_beyond)


def _interval(sums: Array, runs: int) -> tuple[Array, Array, Array]:
    """Mean of positive values from their sum and sum of squares ``(2, ...)``, and its 95 % interval, symmetric in the logarithm."""
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums[0] / runs
        variance = np.maximum(sums[1] / runs - mean**2, 0.0) / (runs - 1)
        factor = np.exp(stdtrit(runs - 1, 0.975) * np.sqrt(variance) / mean)
        return mean, mean / factor, mean * factor
