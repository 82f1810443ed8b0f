"""Sparse grids of Gauss-Hermite rules: isotropic, or anisotropic [Nobile2008].

A Smolyak rule sums tensor products of differences of one-dimensional rules over the multi-indices
``i`` with ``sum_j (i_j - 1) g_j <= (level - 1) min(g)``. Channels (dimensions) with a larger weight
``g_j`` get fewer points. The code does not merge points by comparing coordinates. It enumerates
each point once, as a choice of nodes in a few channels; its weight follows from a generating
function. With ``d(v, l)`` the weight of node ``v`` at level ``l`` minus its weight at level
``l - 1``,

    W(p) = sum over k <= (level - 1) min(g) of [t^k] prod_j sum_l d(p_j, l) t^(g_j (l - 1)).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import combinations, permutations, product
from math import factorial, gcd, perm, prod
from typing import NamedTuple

import numpy as np

from celnav.gaussian.checks import integer, integers
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import MAX_POINTS, Rule, check_point_count

__all__ = ["integrates", "point_count", "smolyak"]

ORDERS = (1, 3, 7, 15, 31, 63)
"""Points of the one-dimensional rules of level 1, 2, ...: each level doubles the number of points
and the degree.
"""
DELAYED = (1, 3, 3, 7, 7, 7, 15)
"""Orders that increase only when the total degree of the isotropic rule requires it. They give
fewer points, which are partly nested.
"""
CANCELED = 1e-12  # a merged weight below this fraction of the sum of its absolute terms is zero
Polynomial = dict[int, float]  # coefficients by power


class _Node(NamedTuple):
    """A pair of nodes ``-x, x`` with ``x > 0``: its first level, and its polynomial
    ``{level - 1: d(x, level)}``.
    """

    level: int
    value: float
    series: Polynomial


class _Pattern(NamedTuple):
    """Points that differ only in their active channels and signs.

    nodes: for each class, indices of the nodes in its active channels. weight: of each point.
    number: of points.
    """

    nodes: tuple[tuple[int, ...], ...]
    weight: float
    number: int


def smolyak(
    n: int, level: int, weights: Sequence[int] | None = None, *, orders: Sequence[int] = ORDERS
) -> Rule:
    """Smolyak `Rule` of Gauss-Hermite rules in ``n`` dimensions, the center first; points whose
    weight cancels are left out.

    Some weights are negative. Channels with ``g_j > (level - 1) min(g)`` have no points, and
    filters reject such a rule. Results are cached. ValueError for a level beyond the orders, or
    for more than `MAX_POINTS` points.

    n: dimension.
    level: 1 gives the center only; 2 with equal weights gives the unscented rule with
        ``kappa = 3 - n``.
    weights: ``(n,)`` positive integers g, 1 for the most important channels; None: all equal
        (isotropic). Only ratios to the smallest matter: weights that are all 2 are isotropic.
    orders: numbers of points of the one-dimensional rules by level, see `ORDERS` and `DELAYED`.

    >>> filter = celnav.sigma_point(motion, sensor, rule=celnav.smolyak(6, 3, [1, 1, 1, 2, 2, 2]))
    """
    return _rule(*_checked(n, level, weights, orders))


def point_count(
    n: int, level: int, weights: Sequence[int] | None = None, *, orders: Sequence[int] = ORDERS
) -> int:
    """Number of points of `smolyak` with the same arguments, without making them; there is no
    limit.

    >>> celnav.gaussian.sparse_grid.point_count(13, 3)
    417
    """
    return sum(p.number for p in _patterns(*_checked(n, level, weights, orders)[1:])[1] if p.weight)


def integrates(
    powers: Sequence[int],
    level: int,
    weights: Sequence[int] | None = None,
    *,
    orders: Sequence[int] = ORDERS,
) -> bool:
    """Whether `smolyak` gives the exact mean of the monomial ``prod_j x_j^powers[j]`` of a unit
    Gaussian.

    It is exact if and only if a power is odd or ``sum_j (l_j - 1) g_j <= (level - 1) min(g)``,
    where ``l_j`` is the lowest level whose rule is exact for ``x^powers[j]``. (The condition
    suffices because the sum of differences telescopes.)

    >>> celnav.gaussian.sparse_grid.integrates([2, 2], level=3)
    True
    """
    numbers = integers("powers", powers)
    if not numbers:
        raise ValueError("powers: expected at least one, got none")
    _, depth, g, sizes = _checked(len(numbers), level, weights, orders)
    if any(a % 2 for a in numbers):
        return True
    # For each power the lowest sufficient level minus 1, or the number of levels if none suffices.
    lowest = [sum(2 * m - 1 < a for m in sizes) for a in numbers]
    return max(lowest) < depth and sum(k * c for k, c in zip(lowest, g, strict=True)) <= (
        depth - 1
    ) * min(g)


def index_set(level: int, weights: Sequence[int]) -> dict[tuple[int, ...], int]:
    """Coefficients of the tensor rules in a `smolyak` rule by multi-index, which counts from 1;
    some are 0 [Liang2014, Eqs. 16, 17].

    >>> index_set(3, (2, 1))
    {(1, 1): -1, (1, 2): 0, (1, 3): 1, (2, 1): 1}
    """
    if not (count := len(integers("weights", weights, 1))):
        raise ValueError("weights: expected at least one, got none")
    _, depth, g, _ = _checked(count, level, weights, ORDERS)
    budget, c = (depth - 1) * min(g), np.ones(1)
    # A coefficient depends on the slack alone: [t^slack] prod_j (1 - t^g_j) / (1 - t).
    for weight in g:
        c = np.convolve(c, [1, *[0] * (weight - 1), -1])
    every = product(*(range(1, budget // weight + 2) for weight in g))
    slack = {
        index: budget - sum((i - 1) * weight for i, weight in zip(index, g, strict=True))
        for index in every
    }
    return {index: int(c[: left + 1].sum()) for index, left in slack.items() if left >= 0}


def check_orders(orders: object) -> tuple[int, ...]:
    """Check numbers of points of the one-dimensional rules; ValueError unless the first is 1."""
    sizes = integers("orders", orders, 1, 100)
    if sizes[:1] != (1,):
        raise ValueError(
            f"orders: expected numbers of points that start with 1, got {orders!r:.80}"
        )
    return sizes


def _checked(
    n: object, level: object, weights: object, orders: object
) -> tuple[int, int, tuple[int, ...], tuple[int, ...]]:
    dimension, sizes = integer("n", n, 1, MAX_POINTS), check_orders(orders)
    depth = integer("level", level, 1, len(sizes))
    g = (1,) * dimension if weights is None else integers("weights", weights, 1, count=dimension)
    common = gcd(*g)
    return dimension, depth, tuple(w // common for w in g), sizes[:depth]


@lru_cache(maxsize=64)
def univariate(order: int) -> tuple[Array, Array]:
    """Gauss-Hermite nodes ``x > 0``, ascending, and weights ``(order // 2 + 1,)``; the first weight
    belongs to the node 0, and is 0 if the order is even.
    """
    x, w = np.polynomial.hermite_e.hermegauss(order)
    w = w / w.sum()
    half = order // 2
    # The mean of x and -(-x) makes the rule exactly symmetric.
    nodes, weights = (
        0.5 * (x[order - half :] - x[:half][::-1]),
        0.5 * (w[order - half :] + w[:half][::-1]),
    )
    return nodes, np.concatenate([[w[half] if order % 2 else 0.0], weights])


def _nodes(sizes: Sequence[int]) -> tuple[Polynomial, list[_Node]]:
    """The polynomial of the node 0, and the other nodes in the order of their first levels."""
    center: Polynomial = {}
    distinct: dict[tuple[int, int], _Node] = {}
    for level, size in enumerate(sizes):
        x, w = univariate(size)
        nodes = [
            distinct.setdefault((size, i), _Node(level, value, {}))
            for i, value in enumerate(x.tolist())
        ]
        for series, weight in zip(
            (center, *(node.series for node in nodes)), w.tolist(), strict=True
        ):
            _add(series, level, weight)
            # d(v, l) = w(v, l) - w(v, l - 1): + at the weight's level, - at the next.
            _add(series, level + 1, -weight)
    return center, list(distinct.values())


def _add(series: Polynomial, power: int, value: float) -> None:
    """Add to a coefficient; equal weights of neighboring levels cancel exactly."""
    series[power] = series.get(power, 0.0) + value


def _times(a: Polynomial, b: Polynomial, limit: int) -> Polynomial:
    out: Polynomial = {}
    for i, x in a.items():
        for j, y in b.items():
            if i + j <= limit:
                _add(out, i + j, x * y)
    return out


@lru_cache(maxsize=256)
def _patterns(
    level: int, g: tuple[int, ...], sizes: tuple[int, ...]
) -> tuple[tuple[float, ...], tuple[_Pattern, ...]]:
    """Values of the nodes, and the patterns whose weight does not cancel, the center first. A class
    contains the channels with the same weight g.
    """
    budget = (level - 1) * min(g)
    center, nodes = _nodes(sizes)
    classes = [(c, g.count(c)) for c in sorted(set(g))]

    def weight(choice: tuple[tuple[int, ...], ...], of: Callable[[float], float]) -> float:
        """Weight of the points with these nodes in each class; ``of`` is applied to coefficients
        (float or abs).
        """
        # The sum of the coefficients of prod_j sum_l d(p_j, l) t^(g_j (l - 1)) up to the budget.
        total: Polynomial = {0: 1.0}
        for (c, count), chosen in zip(classes, choice, strict=True):
            idle, *active = (
                {c * k: of(v) for k, v in series.items() if c * k <= budget}
                for series in (center, *(nodes[i].series for i in chosen))
            )
            for series in [idle] * (count - len(chosen)) + active:
                total = _times(total, series, budget)
        return sum(total.values())

    patterns = []
    for picked in product(*(list(_multisets(nodes, budget // c, count)) for c, count in classes)):
        if sum(c * cost for (c, _), (cost, _) in zip(classes, picked, strict=True)) > budget:
            continue
        choice = tuple(chosen for _, chosen in picked)
        pattern_weight = weight(choice, float)
        canceled = abs(pattern_weight) <= CANCELED * weight(choice, abs)
        if not canceled or not any(choice):  # a rule keeps its center, even with weight 0
            # Number of ways to assign the signed nodes of each class to its channels.
            repeats = prod(factorial(chosen.count(i)) for chosen in choice for i in set(chosen))
            ways = prod(
                perm(count, len(chosen)) << len(chosen)
                for (_, count), chosen in zip(classes, choice, strict=True)
            )
            patterns.append(_Pattern(choice, 0.0 if canceled else pattern_weight, ways // repeats))
    patterns.sort(key=lambda p: sum(map(len, p.nodes)))
    return tuple(node.value for node in nodes), tuple(patterns)


def _multisets(
    nodes: Sequence[_Node], budget: int, most: int, first: int = 0
) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Yield ``(cost, nodes)`` for each choice of at most ``most`` nodes, ascending and with
    repetition, whose levels sum to a cost within the budget.
    """
    yield 0, ()
    if not most:
        return
    for i in range(first, len(nodes)):
        if nodes[i].level <= budget:
            for cost, rest in _multisets(nodes, budget - nodes[i].level, most - 1, i):
                yield cost + nodes[i].level, (i, *rest)


@lru_cache(maxsize=32)
def _rule(n: int, level: int, g: tuple[int, ...], sizes: tuple[int, ...]) -> Rule:
    values, patterns = _patterns(level, g, sizes)
    total = sum(p.number for p in patterns)
    check_point_count("level", total, n)
    channels = [[j for j in range(n) if g[j] == c] for c in sorted(set(g))]
    points, weights = (
        np.zeros((total, n)),
        np.repeat([p.weight for p in patterns], [p.number for p in patterns]),
    )
    row = 0
    for pattern in patterns:
        # Per class: which channels are active, and which of the chosen nodes each of them has.
        placements = [
            [
                (where, which)
                for where in combinations(members, len(chosen))
                for which in sorted(set(permutations(chosen)))
            ]
            for members, chosen in zip(channels, pattern.nodes, strict=True)
        ]
        # (number of placements, 2, active channels): the channels, and the indices of their nodes.
        placed = np.array(
            [
                [sum(tuples, ()) for tuples in zip(*placement, strict=True)]
                for placement in product(*placements)
            ],
            dtype=int,
        )
        active = placed.shape[-1]
        signs = np.array(list(product((1.0, -1.0), repeat=active))).reshape(2**active, active)
        rows = row + np.arange(pattern.number).reshape(len(placed), len(signs))
        points[rows[..., None], placed[:, :1]] = signs * np.array(values)[placed[:, 1:]]
        row += pattern.number
    return Rule(points, weights)
