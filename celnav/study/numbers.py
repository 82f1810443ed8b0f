"""Functions of a study's results that give the numbers to decide rows of a ledger: ratios, levels,
consistency, bands of tables.

>>> worse = ratio("without z_0", ("D", "csrukf"), ("D", "srukf"), "position", (1.3, None))
>>> finding("poor-prior", "…", worse)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.study.ledger import Bounds, Number, Tiers, estimate
from celnav.study.study import Results, When

__all__ = [
    "SAME_ORDER",
    "Decided",
    "PartFilter",
    "all_of",
    "consistency",
    "constant",
    "correlation",
    "count_holding",
    "entries",
    "lagged",
    "of",
    "operations",
    "over",
    "over_time",
    "ratio",
    "rmse",
    "settling",
    "some",
    "tiers",
]

Decided = Callable[[Results], Number]
PartFilter = tuple[str, str]
"""Name of a part, and name of one of its filters."""
SAME_ORDER = 3.2
"""Largest factor between two levels of the same order of magnitude."""


def ratio(
    label: str,
    a: PartFilter,
    b: PartFilter,
    group: str,
    accept: Bounds = (None, None),
    *,
    at: When = -1,
    to: When | None = None,
    axes: slice = slice(None),
    median: bool = False,
    **more: Any,
) -> Decided:
    """RMSE ratio of filter ``a`` to filter ``b``, for the norm of a group's error.

    at: epochs of ``a``. to: epochs of ``b``; None for the same. axes: components of the group.
    median: whether to use medians over the runs instead of RMSE.
    """
    both, statistic = ((a, at), (b, at if to is None else to)), _medians if median else _ratio
    return lambda r: estimate(
        label,
        statistic,
        [r.squares(*source, group, when)[:, axes].sum(-1) for source, when in both],
        accept,
        **more,
    )


def over(
    label: str,
    part: str,
    a: str,
    b: str,
    accept: Bounds = (None, None),
    group: str = "position",
    **more: Any,
) -> Decided:
    """`ratio` of two filters that run in the same part."""
    return ratio(label, (part, a), (part, b), group, accept, **more)


def rmse(
    label: str,
    a: PartFilter,
    group: str,
    accept: Bounds = (None, None),
    *,
    at: When = -1,
    each: bool = False,
    **more: Any,
) -> Decided:
    """RMSE of the norm of a group's error in its unit, or with ``each`` the RMS over components."""
    over = np.mean if each else np.sum
    return lambda r: estimate(
        label, _rms, [over(r.squares(*a, group, at), axis=-1)], accept, **more
    )


def settling(
    label: str,
    a: PartFilter,
    group: str,
    level: float,
    accept: Bounds = (None, None),
    *,
    sooner: PartFilter | None = None,
    axes: slice = slice(None),
    window: slice = slice(None),
    **more: Any,
) -> Decided:
    """Time (s) after which the RMSE of a group's components stays below a level.

    sooner: another filter, whose time is subtracted. window: the epochs used; the RMSE must stay
    below the level until the last of them.
    """
    sources = [a] if sooner is None else [a, sooner]

    def number(r: Results) -> Number:
        t = r.times(a[0])[window]
        times = np.append(t, 2.0 * t[-1] - t[-2])  # the last entry means that it never settles

        def settled(*squares: Array) -> float:
            last = [
                np.flatnonzero(np.append(True, runs.mean(0) >= level**2))[-1] for runs in squares
            ]
            return float(times[last[0]] - (times[last[1]] if len(last) > 1 else 0.0))

        return estimate(
            label,
            settled,
            [np.square(r.error(*source, group)[window, :, axes]).mean(-1).T for source in sources],
            accept,
            **more,
        )

    return number


def consistency(
    label: str,
    a: PartFilter,
    accept: Bounds = (None, None),
    *,
    at: When = -1,
    what: str = "nees",
    **more: Any,
) -> Decided:
    """Mean NEES over the runs, or mean NIS with ``what="nis"``."""
    return lambda r: estimate(label, _mean, [r.nees(*a, at, what)], accept, **more)


def over_time(
    label: str,
    statistic: Callable[..., float],
    columns: Callable[[Results], Sequence[Array]],
    accept: Bounds = (None, None),
    *,
    start: int = 0,
    block: int,
    **more: Any,
) -> Decided:
    """A statistic of one run, from columns ``(T, ...)`` at epochs from ``start`` on where all
    columns are finite.

    block: number of epochs in a bootstrap block, several correlation lengths of the errors.
    """

    def decide(r: Results) -> Number:
        samples = [np.asarray(column)[start:] for column in columns(r)]
        finite = np.all(
            [np.isfinite(column.reshape(len(column), -1)).all(-1) for column in samples], 0
        )
        return estimate(
            label, statistic, [column[finite] for column in samples], accept, block=block, **more
        )

    return decide


def lagged(values: Array, lag: int = 1) -> tuple[Array, Array]:
    """A column ``(T, ...)``, and its values ``lag`` epochs later ``(T, ...)``, nan at the end."""
    later = np.full(values.shape, np.nan)
    later[:-lag] = values[lag:]
    return values, later


def correlation(a: Array, b: Array) -> float:
    """Correlation coefficient about zero of two columns, over all components together."""
    return float((a * b).sum() / np.sqrt(np.square(a).sum() * np.square(b).sum()))


def of(
    part: str,
    name: str,
    label: str,
    accept: Bounds = (None, None),
    reduce: Callable[[Array], Any] = np.max,
) -> Decided:
    """A number without sampling error, reduced from the array ``name`` of a part."""
    return lambda r: Number(label, float(reduce(r.get(part, name))), accept)


def constant(label: str, value: float, accept: Bounds = (None, None)) -> Decided:
    """A number that needs no run, such as one computed from printed values."""
    return lambda _: Number(label, float(value), accept)


def operations(
    label: str, a: str, b: str, accept: Bounds = (None, None), compare: Any = np.divide
) -> Decided:
    """Ratio of the operations per step of filters ``a`` and ``b``, or another function ``compare``
    of them.

    The part "operations" has the counts, see `celnav.study.operations.counted`.
    """
    return lambda r: Number(
        label, float(compare(r.get("operations", a)[0], r.get("operations", b)[0])), accept
    )


def count_holding(
    label: str, numbers: Sequence[Number], accept: Bounds, leading: bool = False
) -> Number:
    """How many numbers hold, or with ``leading`` how many hold before the first that does not.

    The interval is from the count without undecided numbers to the count with them.
    """
    count = []
    for outcomes in ((True,), (True, None)):
        holds = [number.holds in outcomes for number in numbers]
        count.append(float([*holds, False].index(False) if leading else sum(holds)))
    sure, perhaps = count
    return Number(label, sure, accept, (sure, perhaps))


def some(label: str, least: int, numbers: Sequence[Decided]) -> Decided:
    """How many of several numbers hold; at least ``least`` must hold."""
    return lambda r: Number(label, sum(n(r).holds is True for n in numbers), (least, None))


def all_of(*numbers: Decided) -> Callable[[Results], list[Number]]:
    """Several numbers, all of which must hold."""
    return lambda r: [number(r) for number in numbers]


def tiers(**words: Sequence[Decided]) -> Callable[[Results], Tiers]:
    """Numbers by verdict, the best verdict first; underscores become spaces."""
    return lambda r: {
        word.replace("_", " "): [number(r) for number in numbers] for word, numbers in words.items()
    }


def entries(
    cells: Sequence[tuple[PartFilter, Sequence[float]]],
    groups: Sequence[str],
    best: str,
    printed_runs: int,
    most: int,
    *,
    at: When = -1,
) -> Callable[[Results], Tiers]:
    """Tiers for a printed table of RMSE by component: ``best``, then "level only".

    ``best`` holds if at most ``most`` entries lie outside a band, and "level only" if the order of
    magnitude agrees.

    The band contains 95 % of the RMSEs from ``printed_runs`` runs, relative to the true RMSE: the
    paper's sampling error. The intervals of the counts include our own sampling error.

    cells: part, filter, and the printed values for the components of all groups.
    """
    printed = np.concatenate([row for _, row in cells])
    # The logarithm of an RMSE of N normal errors has a variance of 1 / (2 N).
    factor = float(np.exp(1.96 * np.sqrt(0.5 / printed_runs)))

    def decide(r: Results) -> Tiers:
        samples = [r.squares(*source, group, at) for source, _ in cells for group in groups]

        def logs(*squares: Array) -> Array:
            rms = np.concatenate([np.sqrt(runs.mean(0)) for runs in squares])
            return np.asarray(np.abs(np.log(rms / printed)))

        def beyond(*squares: Array) -> float:
            return float((logs(*squares) > np.log(factor)).sum())

        def farthest(*squares: Array) -> float:
            return float(np.exp(logs(*squares).max()))

        label = (
            f"printed values that differ by more than a factor of {factor:.2f}, of {len(printed)}"
        )
        outside = estimate(label, beyond, samples, (None, most))
        if outside.ci is not None:  # of whole numbers
            low, high = outside.ci
            outside = outside._replace(ci=(float(np.ceil(low)), float(np.floor(high))))
        level = estimate(
            "largest factor between a printed value and ours", farthest, samples, (None, SAME_ORDER)
        )
        return {best: [outside], "level only": [level]}

    return decide


def _mean(x: Array) -> Any:
    """Mean of a few numbers, for each resample; `numpy.mean` would be several times slower."""
    return np.add.reduce(x, None) / x.size


def _rms(squares: Array) -> float:
    return float(np.sqrt(_mean(squares)))


def _medians(a: Array, b: Array) -> float:
    return float(np.sqrt(np.median(a) / np.median(b)))


def _ratio(a: Array, b: Array) -> float:
    return float(np.sqrt(_mean(a) / _mean(b)))
