"""Scores: sums over runs that are enough for every statistic of a campaign, so that no track is ever kept.

A block of runs is scored, scores of blocks are merged by adding, in whatever number they come, and a `Summary` reads the sum.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaincinv, stdtrit

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.linalg import Array
from celnav.study.trial import Followed, Group, squares

BINS = 20
"""Bins of the histograms of NEES and NIS, equally probable for a consistent filter."""
Scores = dict[str, Array]
"""Sums over runs that did not fail.

times ``(K,)`` s. runs ``()``. count, nis, dof ``(K,)`` and square ``(K, groups)``: at each epoch, over the runs that have an
estimate there. known ``(K,)``, variance ``(K, groups)``: over those with a covariance too; nees ``(K,)``: with one that is positive
definite. own ``(2, groups)``, own_nees ``(2,)``: of each run's mean over the settled epochs, and of its square; judged ``()``: how
many runs have a NEES there. settled ``(K,)``: which epochs these are. error ``(n,)``, outer ``(n, n)``: at the last epoch.
nees_histogram, nis_histogram: ``(BINS,)``.
"""


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
    block = (square, variance, followed.nees, followed.nis, followed.dof, there, sound)
    square, variance, nees, nis, dof, there, sound = (values[:, chosen] for values in block)
    known = there & np.isfinite(variance).all(-1)
    judged, error = sound[settled].any(0), followed.error[-1, good]
    scores = {
        "times": times,
        "settled": settled,
        "runs": good.sum(),
        "count": there.sum(1),
        "square": _only(square, there).sum(1),
        "known": known.sum(1),
        "variance": _only(variance, known).sum(1),
        "nees": _only(nees, sound).sum(1),
        "nis": _only(nis, there).sum(1),
        "dof": _only(dof, there).sum(1),
        "judged": judged.sum(),
        "own": _moments(_mean(square[settled], there[settled])),
        "own_nees": _moments(_mean(nees[settled], sound[settled])[judged]),
        "error": error.sum(0),
        "outer": error.T @ error,
        "nees_histogram": _histogram(nees[settled], np.full(nees[settled].shape, error.shape[-1])),
        "nis_histogram": _histogram(nis[settled], np.where(there[settled], dof[settled], 0.0)),
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


def _histogram(values: Array, dof: Array) -> Array:
    """Counts of chi-square values in `BINS` bins of equal probability."""
    total = np.zeros(BINS)
    for freedom in np.unique(dof[dof > 0]):
        chosen = values[(dof == freedom) & np.isfinite(values)]
        edges = 2.0 * gammaincinv(0.5 * freedom, np.arange(1, BINS) / BINS)
        total += np.bincount(np.searchsorted(edges, chosen), minlength=BINS)
    return total


def check_scores(scores: Scores, groups: int) -> None:
    """Raise ValueError unless these are numbers of the names and shapes that `score` makes for so many groups."""
    none = np.empty(0)
    K, G, n = scores.get("times", none).shape[:1], (groups,), scores.get("error", none).shape[:1]
    shapes = dict.fromkeys(("times", "settled", "count", "known", "nees", "nis", "dof"), K) | {
        "runs": (), "judged": (), "square": K + G, "variance": K + G, "own": (2, *G), "own_nees": (2,), "error": n, "outer": n + n,
        "nees_histogram": (BINS,), "nis_histogram": (BINS,),
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
        total = {name: total[name] + part[name] if total and name not in ("times", "settled") else part[name] for name in part}
    if not total:
        raise ValueError("scores: expected at least one block, got none")
    return total


class Accuracy(NamedTuple):
    """Root mean squares of a group: over the settled epochs with a 95 % interval, at the end, and what the filter takes it for.

    The interval comes from how the runs differ, so it needs no Gaussian errors; nan with fewer than two runs. ``bound``: the
    `celnav.study.trial.bound` of the settled epochs; ``efficiency``: bound over rms.
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
    runs, n = int(scores["runs"]), len(scores["error"])
    settled = scores["settled"] > 0.0
    rms, low, high = _interval(scores["own"], runs)
    anees, least_anees, most_anees = (float(v[0]) / n for v in _interval(scores["own_nees"][:, None], int(scores["judged"])))
    with np.errstate(invalid="ignore", divide="ignore"):
        final = np.sqrt(scores["square"][-1] / scores["count"][-1])
        sigma = np.sqrt(scores["variance"][settled].sum(0) / scores["known"][settled].sum())
        nis = float(scores["nis"][settled].sum() / scores["dof"][settled].sum())
        least = np.full(len(rms), np.nan) if bound is None else np.sqrt(bound[settled].mean(0))
        columns = np.stack([np.sqrt(rms), np.sqrt(low), np.sqrt(high), final, sigma, least, least / np.sqrt(rms)], -1)
        nees_beyond, nis_beyond = (float(h[-1] / h.sum()) for h in (scores["nees_histogram"], scores["nis_histogram"]))
    accuracy = tuple(Accuracy(*row) for row in columns.tolist())
    a, b = chi_square_band(n, runs) if runs else (np.nan, np.nan)
    return Summary(runs, accuracy, anees, least_anees, most_anees, (a / n, b / n), nis, nees_beyond, nis_beyond)


def _interval(sums: Array, runs: int, level: float = 0.95) -> tuple[Array, Array, Array]:
    """Mean of positive values from their sum and sum of squares ``(2, ...)``, and its interval, symmetric in the logarithm."""
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums[0] / runs
        variance = np.maximum(sums[1] / runs - mean**2, 0.0) / (runs - 1)
        factor = np.exp(stdtrit(runs - 1, 0.5 + level / 2) * np.sqrt(variance) / mean)
        return mean, mean / factor, mean * factor
