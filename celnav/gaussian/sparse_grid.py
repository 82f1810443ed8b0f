"""Sparse grids: Smolyak rules of Gauss-Hermite rules, isotropic and anisotropic [Nobile, Tempone & Webster 2008].

A Smolyak rule adds up differences of one-dimensional rules over the multi-indices ``i`` with
``sum_j (i_j - 1) g_j <= (level - 1) min(g)``. Channels with a larger weight ``g_j`` get fewer points. Nothing is merged by
comparing coordinates: each point is enumerated once, as a choice of nodes in a few channels, and its weight is a coefficient
of a generating function. With ``d(v, l)`` the weight of node ``v`` in the rule of level ``l`` minus that of level ``l - 1``,

    W(p) = sum over k <= (level - 1) min(g) of [t^k] prod_j sum_l d(p_j, l) t^(g_j (l - 1)).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import chain, combinations, product
from math import comb, gcd
from typing import NamedTuple

import numpy as np

from celnav.gaussian.checks import integer, integers
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import MAX_POINTS, Rule, few

ORDERS = (1, 3, 7, 15, 31, 63)
"""Points of the one-dimensional rules of level 1, 2, ...: a level more doubles the number and the degree."""
DELAYED = (1, 3, 3, 7, 7, 7, 15)
"""Orders that rise only when the total degree of the isotropic rule asks for it: fewer points, nested in parts."""

CANCELED = 1e-12
"""A merged weight is nothing if it is this small against the sum of its absolute terms."""
Polynomial = dict[int, float]
"""Coefficients by power."""


class _Node(NamedTuple):
    """A pair of nodes ``-x, x`` with ``x > 0``: its first level, and its polynomial ``{level - 1: d(x, level)}``."""

    level: int
    value: float
    series: Polynomial


class _Pattern(NamedTuple):
    """Points that differ by channels and signs only: for each class the nodes of its active channels, and their weight."""

    nodes: tuple[tuple[int, ...], ...]
    weight: float
    number: int


def smolyak(n: int, level: int, weights: Sequence[int] | None = None, *, orders: Sequence[int] = ORDERS) -> Rule:
    """Smolyak rule of Gauss-Hermite rules in ``n`` dimensions.

    Parameters
    ----------
    n: dimension. level: 1 is the center alone, 2 of equal weights the unscented rule with ``kappa = 3 - n``.
    weights: ``(n,)`` positive integers g, 1 for the channels that matter most; None: all equal (isotropic). Only their ratios
        to the smallest count: weights that are all 2 are isotropic.
    orders: points of the one-dimensional rules by level, see `ORDERS` and `DELAYED`.

    Returns
    -------
    A cached rule of the points whose weight does not cancel, the center first. Its weights are partly negative. Channels with
    ``g_j > (level - 1) min(g)`` have no points: filters refuse such a rule.

    Raises
    ------
    ValueError: for a bad argument, a level beyond the orders, or more than `MAX_POINTS` points (before they are made).
    """
    grid = _checked(n, level, weights, orders)
    return _rule(*grid)


def point_count(n: int, level: int, weights: Sequence[int] | None = None, *, orders: Sequence[int] = ORDERS) -> int:
    """Number of points of `smolyak` (same arguments and errors, any number), without making them."""
    return sum(p.number for p in _patterns(*_checked(n, level, weights, orders)[1:])[1] if p.weight)


def integrates(powers: Sequence[int], level: int, weights: Sequence[int] | None = None, *, orders: Sequence[int] = ORDERS) -> bool:
    """Whether `smolyak` gives the exact mean of the monomial ``prod_j x_j^powers[j]`` of a unit Gaussian.

    Exact if and only if a power is odd or ``sum_j (l_j - 1) g_j <= (level - 1) min(g)``, where ``l_j`` is the lowest level
    whose rule is exact for ``x^powers[j]``. (That it is exact then follows since the sum of differences telescopes.)

    Raises
    ------
    ValueError: for powers that are not integers of at least 0; otherwise as `smolyak`.
    """
    numbers = integers("powers", powers)
    if not numbers:
        raise ValueError("powers: expected at least one, got none")
    _, depth, g, sizes = _checked(len(numbers), level, weights, orders)
    if any(a % 2 for a in numbers):
        return True
    lowest = [sum(2 * m - 1 < a for m in sizes) for a in numbers]  # a level less; the number of levels where none suffices
    return max(lowest) < depth and sum(k * c for k, c in zip(lowest, g, strict=True)) <= (depth - 1) * min(g)


def checked_orders(orders: object) -> tuple[int, ...]:
    """Numbers of points of the one-dimensional rules, level by level; ValueError if they are none."""
    sizes = integers("orders", orders, 1, 100)
    if sizes[:1] != (1,):
        raise ValueError(f"orders: expected numbers of points, the first 1, got {orders!r:.80}")
    return sizes


def _checked(n: object, level: object, weights: object, orders: Sequence[int]) -> tuple[int, int, tuple[int, ...], tuple[int, ...]]:
    dimension, sizes = integer("n", n, 1, MAX_POINTS), checked_orders(orders)
    depth = integer("level", level, 1, len(sizes))
    g = (1,) * dimension if weights is None else integers("weights", weights, 1, count=dimension)
    common = gcd(*g)
    return dimension, depth, tuple(w // common for w in g), sizes[:depth]


def univariate(order: int) -> tuple[Array, Array]:
    """Gauss-Hermite nodes ``x > 0``, ascending, and weights ``(order // 2 + 1,)``, that of the node 0 (or 0) first."""
    return _univariate(integer("order", order, 1, 100))


@lru_cache(maxsize=64)
def _univariate(order: int) -> tuple[Array, Array]:
    x, w = np.polynomial.hermite_e.hermegauss(order)
    w = w / w.sum()
    half = order // 2
    nodes, weights = 0.5 * (x[order - half :] - x[:half][::-1]), 0.5 * (w[order - half :] + w[:half][::-1])
    return nodes, np.concatenate([[w[half] if order % 2 else 0.0], weights])


def _nodes(sizes: Sequence[int]) -> tuple[Polynomial, list[_Node]]:
    """The polynomial of the node 0, and the other nodes, by first level."""
    center: Polynomial = {}
    found: dict[tuple[int, int], _Node] = {}
    for level, size in enumerate(sizes):
        x, w = univariate(size)
        _add(center, level, float(w[0]))
        _add(center, level + 1, -float(w[0]))
        for i in range(len(x)):
            node = found.setdefault((size, i), _Node(level, float(x[i]), {}))
            _add(node.series, level, float(w[i + 1]))
            _add(node.series, level + 1, -float(w[i + 1]))
    return center, list(found.values())


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


def _power(series: Polynomial, exponent: int, limit: int) -> Polynomial:
    out: Polynomial = {0: 1.0}
    while exponent:
        if exponent % 2:
            out = _times(out, series, limit)
        series, exponent = _times(series, series, limit), exponent // 2
    return out


@lru_cache(maxsize=256)
def _patterns(level: int, g: tuple[int, ...], sizes: tuple[int, ...]) -> tuple[tuple[float, ...], tuple[_Pattern, ...]]:
    """Values of the nodes, and the patterns whose weight does not cancel, the center first."""
    budget = (level - 1) * min(g)
    center, nodes = _nodes(sizes)
    classes = sorted(set(g))
    sizes_of = [g.count(c) for c in classes]
    per_class = [list(_multisets(nodes, budget // c, most)) for c, most in zip(classes, sizes_of, strict=True)]

    def series(power: int, chosen: tuple[int, ...], idle: int, absolute: bool) -> Polynomial:
        """Generating function of a class whose channels ``chosen`` are active."""

        def scaled(s: Polynomial) -> Polynomial:
            return {power * k: abs(v) if absolute else v for k, v in s.items() if power * k <= budget}

        out = _power(scaled(center), idle, budget)
        for i in chosen:
            out = _times(out, scaled(nodes[i].series), budget)
        return out

    found = []
    for choice in product(*per_class):
        if sum(c * cost for c, (cost, _) in zip(classes, choice, strict=True)) > budget:
            continue
        count = 1
        total: dict[bool, Polynomial] = {False: {0: 1.0}, True: {0: 1.0}}
        for c, size, (_, chosen) in zip(classes, sizes_of, choice, strict=True):
            for absolute, so_far in total.items():
                total[absolute] = _times(so_far, series(c, chosen, size - len(chosen), absolute), budget)
            left = size
            for i in sorted(set(chosen)):
                count *= comb(left, chosen.count(i)) * 2 ** chosen.count(i)
                left -= chosen.count(i)
        weight, scale = sum(total[False].values()), sum(total[True].values())
        canceled = abs(weight) <= CANCELED * scale
        if not canceled or not any(chosen for _, chosen in choice):  # a rule has its center first, be its weight 0
            found.append(_Pattern(tuple(chosen for _, chosen in choice), 0.0 if canceled else weight, count))
    found.sort(key=lambda p: sum(map(len, p.nodes)))
    return tuple(node.value for node in nodes), tuple(found)


def _multisets(nodes: Sequence[_Node], budget: int, most: int, first: int = 0) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Choices of at most ``most`` nodes, ascending and with repetition, whose levels fit the budget: ``(cost, nodes)``."""
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
    few("level", total, n)
    channels = [np.flatnonzero(np.array(g) == c) for c in sorted(set(g))]
    points, weights = np.zeros((total, n)), np.empty(total)
    row = 0
    for pattern in patterns:
        where, which = _placements(channels, pattern.nodes)
        active = where.shape[1]
        signs = np.array(list(product((1.0, -1.0), repeat=active))).reshape(2**active, active)
        rows = row + np.arange(pattern.number).reshape(len(where), len(signs))
        points[rows[..., None], where[:, None, :]] = signs * np.array(values)[which][:, None, :]
        weights[row : row + pattern.number] = pattern.weight
        row += pattern.number
    return Rule(points, weights)


def _placements(channels: Sequence[Array], nodes: Sequence[tuple[int, ...]]) -> tuple[Array, Array]:
    """Every way to give the nodes of each class to channels of that class: channels and nodes, both ``(ways, active)``."""
    where, which = np.zeros((1, 0), int), np.zeros((1, 0), int)
    for members, chosen in zip(channels, nodes, strict=True):
        if not chosen:
            continue
        k = len(chosen)
        flat = np.fromiter(chain.from_iterable(combinations(range(len(members)), k)), int)
        subsets = members[flat.reshape(-1, k)]
        arrangements = np.array(list(_arrangements(chosen)))
        own_where = np.repeat(subsets, len(arrangements), 0)
        own_which = np.tile(arrangements, (len(subsets), 1))
        where, which = (
            np.concatenate([np.repeat(a, len(b), 0), np.tile(b, (len(a), 1))], 1)
            for a, b in ((where, own_where), (which, own_which))
        )
    return where, which


def _arrangements(chosen: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Distinct orders of a multiset."""
    if len(chosen) < 2:
        yield chosen
        return
    for i, first in enumerate(chosen):
        if first not in chosen[:i]:
            for rest in _arrangements(chosen[:i] + chosen[i + 1 :]):
                yield (first, *rest)
