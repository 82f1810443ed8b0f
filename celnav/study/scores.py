"""Scores: sums over runs that are enough for every statistic of a campaign, so that no track is ever kept.

A block of runs is scored, scores of blocks are merged by adding, in whatever number they come, and a `Summary` reads the sum.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

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

    ``settle_s``: the mean over time begins here; None: in the middle of the run.

    Raises
    ------
    ValueError: if no epoch is as late as ``settle_s``.
    """
    if settle_s is not None and settle_s > followed.times[-1]:
        raise ValueError(f"settle_s: expected a time of at most {followed.times[-1]:g} s, the last epoch, got {settle_s:g}")
    f, K = followed, len(followed.times)
    square, variance = squares(groups, f.error), squares(groups, f.std)
    failures = {run: Failure(run, t, why) for run, t, why in f.lost}
    for i, group in enumerate(groups):
        limit = limits.get(group.name, np.inf)
        for run in np.flatnonzero(square[-1, :, i] > limit**2).tolist():
            why = f"{group.name}: error above {limit:g} {group.unit} at the end"
            failures.setdefault(run, Failure(run, float(f.times[-1]), why))
    settled = np.arange(K) >= K // 2 if settle_s is None else f.times >= settle_s
    there = np.asarray(np.isfinite(square).all(-1))
    sound = there & np.isfinite(f.nees)
    for run in np.flatnonzero(~there[settled].any(0)).tolist():
        failures.setdefault(run, Failure(run, float(f.times[-1]), "no estimate at any settled epoch"))
    for run in np.flatnonzero(np.isnan(variance[settled]).all((0, 2))).tolist():
        failures.setdefault(run, Failure(run, float(f.times[-1]), "no positive definite covariance at any settled epoch"))
    good = np.array([run not in failures for run in range(square.shape[1])], bool)
    chosen = slice(None) if good.all() else good
    square, variance, nees, nis, dof, there, sound = (a[:, chosen] for a in (square, variance, f.nees, f.nis, f.dof, there, sound))
    known = there & np.isfinite(variance).all(-1)
    judged = sound[settled].any(0)
    own, own_nees = _mean_of(square[settled], there[settled]), _mean_of(nees[settled], sound[settled])[judged]
    last = f.error[-1, good]
    scores = {
        "times": f.times,
        "settled": settled.astype(np.float64),
        "runs": np.array(float(good.sum())),
        "count": there.sum(1).astype(np.float64),
        "square": _sum(square, there),
        "known": known.sum(1).astype(np.float64),
        "variance": _sum(variance, known),
        "nees": _sum(nees, sound),
        "nis": _sum(nis, there),
        "dof": _sum(dof, there),
        "judged": np.array(float(judged.sum())),
        "own": np.stack([own.sum(0), np.square(own).sum(0)]),
        "own_nees": np.stack([own_nees.sum(0), np.square(own_nees).sum(0)]),
        "error": last.sum(0),
        "outer": last.T @ last,
        "nees_histogram": _histogram(nees[settled], np.full(nees[settled].shape, last.shape[-1])),
        "nis_histogram": _histogram(nis[settled], np.where(there[settled], dof[settled], 0.0)),
    }
    return scores, list(failures.values())


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


def _sum(values: Array, there: Array) -> Array:
    """Sum over the runs of those that are there."""
    return np.asarray(_only(values, there).sum(1))


def _mean_of(values: Array, there: Array) -> Array:
    """Mean over time of what is there, for each run; zero where nothing is."""
    count = np.maximum(there.sum(0), 1)
    return np.asarray(_only(values, there).sum(0) / (count if values.ndim == 2 else count[..., None]))


def _only(values: Array, there: Array) -> Array:
    """Zero where nothing is."""
    if there.all():
        return values
    return np.where(there if values.ndim == 2 else there[..., None], values, 0.0)


def _histogram(values: Array, dof: Array) -> Array:
    """Counts of chi-square values in `BINS` bins of equal probability."""
    total = np.zeros(BINS)
    for freedom in np.unique(dof[dof > 0]):
        chosen = values[(dof == freedom) & np.isfinite(values)]
        edges = 2.0 * gammaincinv(0.5 * freedom, np.arange(1, BINS) / BINS)
        total += np.bincount(np.searchsorted(edges, chosen), minlength=BINS)
    return total


def merge(parts: Iterable[Scores]) -> Scores:
    """Sum of scores of the same epochs, in the order given.

    Raises
    ------
    ValueError: if there is none, or epochs differ.
    """
    total: Scores = {}
    for part in parts:
        if not total:
            total = dict(part)
            continue
        if not np.array_equal(part["times"], total["times"]):
            raise ValueError("scores: expected the same epochs in all blocks")
        total |= {name: total[name] + part[name] for name in part if name not in ("times", "settled")}
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
    with np.errstate(invalid="ignore", divide="ignore"):
        final = np.sqrt(scores["square"][-1] / scores["count"][-1])
        sigma = np.sqrt(scores["variance"][settled].sum(0) / scores["known"][settled].sum())
        nis = float(scores["nis"][settled].sum() / scores["dof"][settled].sum())
        least = np.full(len(rms), np.nan) if bound is None else np.sqrt(bound[settled].mean(0))
        columns = np.stack([np.sqrt(rms), np.sqrt(low), np.sqrt(high), final, sigma, least, least / np.sqrt(rms)], -1)
    accuracy = tuple(Accuracy(*row) for row in columns.tolist())
    anees, anees_low, anees_high = (float(v[0]) / n for v in _interval(scores["own_nees"][:, None], int(scores["judged"])))
    a, b = chi_square_band(n, runs) if runs else (np.nan, np.nan)
    return Summary(
        runs,
        accuracy,
        anees,
        anees_low,
        anees_high,
        (a / n, b / n),
        nis,
        _beyond(scores["nees_histogram"]),
        _beyond(scores["nis_histogram"]),
    )


def _beyond(histogram: Array) -> float:
    """Part in the last of `BINS` bins; nan of nothing."""
    return float(histogram[-1] / histogram.sum()) if histogram.any() else float("nan")


def _interval(sums: Array, runs: int, level: float = 0.95) -> tuple[Array, Array, Array]:
    """Mean of positive values from their sum and sum of squares ``(2, ...)``, and its interval, symmetric in the logarithm."""
    nothing = np.full(sums.shape[1:], np.nan)
    if runs < 1:
        return nothing, nothing, nothing
    mean = sums[0] / runs
    if runs < 2:
        return mean, nothing, nothing
    variance = np.maximum(sums[1] / runs - mean**2, 0.0) / (runs - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.exp(stdtrit(runs - 1, 0.5 + level / 2) * np.sqrt(variance) / mean)
    return mean, mean / factor, mean * factor
