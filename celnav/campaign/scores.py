"""Scores: sums over runs that suffice for every statistic of a campaign, so that no track is kept.

Each block of runs is scored, and the scores of any number of blocks are added. `summarize` computes
statistics from the sum.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaincinv, stdtrit

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.linalg import Array
from celnav.study.trial import Evaluation, Group, squares

Scores = dict[str, Array]
"""Sums over runs that did not fail.

times ``(K,)`` s. dimension ``()``: of the error. settled ``(K,)``: epochs of the statistics. runs
``()``: number of runs. count, nis, dof ``(K,)`` and square ``(K, groups)``: at each epoch, over the
runs with an estimate. predicted ``(K,)``, variance ``(K, groups)``: over the runs that also have a
covariance. run_square ``(2, groups)``, run_nees ``(2,)``: sums of each run's mean over the settled
epochs, and of the square of this mean. judged ``()``: how many runs have a NEES there. nees_beyond,
nis_beyond ``(2,)``: number of single values above their 95 % quantile, and number of all.
"""
CONSTANT = ("times", "dimension", "settled")
"""Scores that are not sums."""


class Failure(NamedTuple):
    """A run that is not scored, with the time and the reason of its failure."""

    run: int
    t: float
    why: str


def score(
    evaluation: Evaluation,
    groups: tuple[Group, ...],
    *,
    settle_s: float | None,
    limits: Mapping[str, float],
) -> tuple[Scores, list[Failure]]:
    """Scores of a block, and its failed runs: without an estimate, or with a final error above the
    limit of a group.

    ``settle_s``: start of the mean over time, at most the last epoch; None: the middle of the run.
    """
    times, end = evaluation.times, float(evaluation.times[-1])
    if settle_s is not None and settle_s > end:
        raise ValueError(
            f"settle_s: expected a time of at most {end:g} s, the last epoch, got {settle_s:g}"
        )
    settled = np.arange(len(times)) >= len(times) // 2 if settle_s is None else times >= settle_s
    square, variance = squares(groups, evaluation.error), squares(groups, evaluation.std)
    there = np.asarray(np.isfinite(square).all(-1))
    sound = there & np.isfinite(evaluation.nees)
    failures = {run: Failure(run, t, why) for run, t, why in evaluation.lost}

    def fail(which: Any, why: str) -> None:
        for run in np.flatnonzero(which).tolist():
            failures.setdefault(run, Failure(run, end, why))

    for group, last in zip(groups, square[-1].T, strict=True):
        limit = limits.get(group.name, np.inf)
        fail(last > limit**2, f"{group.name}: error above {limit:g} {group.unit} at the end")
    fail(~there[settled].any(0), "no estimate at any settled epoch")
    fail(
        np.isnan(variance[settled]).all((0, 2)),
        "no positive definite covariance at any settled epoch",
    )
    good = np.array([run not in failures for run in range(square.shape[1])], bool)
    chosen = slice(None) if good.all() else good
    nees, nis, dof = (
        evaluation.nees[:, chosen],
        evaluation.nis[:, chosen],
        evaluation.dof[:, chosen],
    )
    square, variance, there, sound = (
        values[:, chosen] for values in (square, variance, there, sound)
    )
    predicted = there & np.isfinite(variance).all(-1)
    judged, n = sound[settled].any(0), evaluation.error.shape[-1]
    scores = {
        "times": times,
        "dimension": n,
        "settled": settled,
        "runs": good.sum(),
        "count": there.sum(1),
        "square": _only(square, there).sum(1),
        "predicted": predicted.sum(1),
        "variance": _only(variance, predicted).sum(1),
        "nis": _only(nis, there).sum(1),
        "dof": _only(dof, there).sum(1),
        "judged": judged.sum(),
        "run_square": _moments(_mean(square[settled], there[settled])),
        "run_nees": _moments(_mean(nees[settled], sound[settled])[judged]),
        "nees_beyond": _beyond(nees[settled], np.full(nees[settled].shape, n)),
        "nis_beyond": _beyond(nis[settled], np.where(there[settled], dof[settled], 0.0)),
    }
    return {name: np.asarray(value, np.float64) for name, value in scores.items()}, list(
        failures.values()
    )


def _only(values: Array, there: Array) -> Array:
    """The values where ``there``, else 0; ``there`` has the first axes of the values."""
    return (
        values
        if there.all()
        else np.where(there.reshape(*there.shape, *(1,) * (values.ndim - 2)), values, 0.0)
    )


def _mean(values: Array, there: Array) -> Array:
    """Mean over time of the values where ``there``, for each run; 0 if a run has none."""
    count = np.maximum(there.sum(0), 1)
    return np.asarray(_only(values, there).sum(0) / count.reshape(-1, *(1,) * (values.ndim - 2)))


def _moments(values: Array) -> Array:
    """Sums over the runs of values and of their squares."""
    return np.stack([values.sum(0), np.square(values).sum(0)])


def _beyond(values: Array, dof: Array) -> Array:
    """How many chi-square values are above their 95 % quantile, and how many there are."""
    there = (dof > 0) & np.isfinite(values)
    freedom, which = np.unique(dof[there], return_inverse=True)
    return np.array(
        [(values[there] > 2.0 * gammaincinv(0.5 * freedom, 0.95)[which]).sum(), there.sum()]
    )


def check_scores(scores: Scores, groups: int, bound: Array | None) -> None:
    """Raise ValueError unless scores and bound have the names and shapes of `score` for ``groups``
    groups.
    """
    K, G = scores.get("times", np.empty(0)).shape[:1], (groups,)
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("dimension", "runs", "judged"), ())
    shapes |= dict.fromkeys(("times", "settled", "count", "predicted", "nis", "dof"), K)
    shapes |= dict.fromkeys(("run_nees", "nees_beyond", "nis_beyond"), (2,))
    shapes |= {"square": K + G, "variance": K + G, "run_square": (2, *G)}
    if set(scores) != set(shapes):
        raise ValueError(f"expected scores {', '.join(shapes)}, got {', '.join(scores)}")
    for name, shape in shapes.items():
        if scores[name].shape != shape or scores[name].dtype != np.float64:
            got = f"{scores[name].dtype} of {scores[name].shape}"
            raise ValueError(f"{name}: expected numbers of shape {shape}, got {got}")
    if bound is not None and bound.shape != K + G:
        raise ValueError(f"bound: expected shape {K + G}, got {bound.shape}")


def merge(parts: Iterable[Scores]) -> Scores:
    """Sum of one or more scores of the same epochs, in the given order."""
    total: Scores = {}
    for part in parts:
        if total and not np.array_equal(part["times"], total["times"]):
            raise ValueError("scores: expected the same epochs in all blocks")
        total = {
            name: total[name] + part[name] if total and name not in CONSTANT else part[name]
            for name in part
        }
    if not total:
        raise ValueError("scores: expected at least one block, got none")
    return total


STATISTICS = ("rms", "low", "high", "final", "sigma", "bound", "efficiency")
"""Statistics of each group: root mean square error over the settled epochs with its 95 % interval,
and at the last epoch; the filter's prediction; `celnav.study.trial.bound`, and the bound over rms.
The interval comes from the differences between runs, so errors need not be Gaussian.
"""


def column(group: str, statistic: str, unit: str) -> str:
    """The name of a column of the table, such as "velocity_rms_m_per_s"."""
    name = f"{group}_{statistic}"
    return name if statistic == "efficiency" else f"{name}_{unit.replace('/', '_per_')}"


def summarize(
    scores: Scores, groups: Iterable[Sequence[Any]], bound: Array | None = None
) -> dict[str, Any]:
    """Statistics of scores by column of the table; nan where no run is left.

    groups: name and unit of each. bound: mean squares ``(K, groups)``.

    Returns
    -------
    runs: number of scored runs. The `STATISTICS` of each group.
    anees, anees_low, anees_high: NEES averaged over runs and settled epochs, over its dimension (1
        if consistent), with a 95 % interval from the differences between runs. band_low, band_high:
        95 % range of a consistent filter for the mean over the runs at a single epoch.
    nis: NIS over its degrees of freedom, averaged over the settled epochs.
    nees_beyond, nis_beyond: part of single values above their 95 % quantiles, .05 if consistent.
    """
    runs, n = int(scores["runs"]), int(scores["dimension"])
    settled = scores["settled"] > 0.0
    mean_squares = _interval(scores["run_square"], runs)
    anees = [float(v) / n for v in _interval(scores["run_nees"], int(scores["judged"]))]
    band = chi_square_band(n, runs) if runs else (np.nan, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms, low, high = np.sqrt(mean_squares)
        final = np.sqrt(scores["square"][-1] / scores["count"][-1])
        sigma = np.sqrt(scores["variance"][settled].sum(0) / scores["predicted"][settled].sum())
        least = np.full(len(rms), np.nan) if bound is None else np.sqrt(bound[settled].mean(0))
        values = np.stack([rms, low, high, final, sigma, least, least / rms], -1)
        nis = float(scores["nis"][settled].sum() / scores["dof"][settled].sum())
        beyond = {
            name: float(scores[name][0] / scores[name][1]) for name in ("nees_beyond", "nis_beyond")
        }
    accuracies = {
        column(name, statistic, unit): value
        for (name, unit, *_), row in zip(groups, values.tolist(), strict=True)
        for statistic, value in zip(STATISTICS, row, strict=True)
    }
    consistency = dict(zip(("anees", "anees_low", "anees_high"), anees, strict=True))
    bands = {"band_low": band[0] / n, "band_high": band[1] / n}
    return {"runs": runs} | accuracies | consistency | bands | {"nis": nis} | beyond


def _interval(sums: Array, runs: int) -> tuple[Array, Array, Array]:
    """Mean of positive values from their sum and sum of squares ``(2, ...)``, and its 95 %
    interval, symmetric in the logarithm.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums[0] / runs
        variance = np.maximum(sums[1] / runs - mean**2, 0.0) / (runs - 1)
        factor = np.exp(stdtrit(runs - 1, 0.975) * np.sqrt(variance) / mean)
        return mean, mean / factor, mean * factor
