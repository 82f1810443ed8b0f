"""Sparse grids that choose their own indices: dimension-adaptive quadrature for one function of a Gaussian."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian import checks
from celnav.gaussian.checks import finite, integer, number
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule
from celnav.gaussian.sparse_grid import CANCELED, ORDERS, checked_orders, univariate


class Adapted(NamedTuple):
    """A rule fitted to a function: its multi-indices (from 0) with their coefficients, and what each index contributed."""

    rule: Rule
    coefficients: dict[tuple[int, ...], int]
    contributions: dict[tuple[int, ...], float]


def adapt(
    function: Callable[[Array], Array],
    mean: ArrayLike,
    root: ArrayLike,
    *,
    tolerance: float = 1e-3,
    most: int = 200,
    orders: Sequence[int] = ORDERS,
) -> Adapted:
    """Dimension-adaptive sparse grid for the mean and covariance of a function of a Gaussian [Gerstner & Griebel 2003].

    It starts from level 2 and adds, again and again, the index that contributes most to the two moments (relative to the
    standard deviations there), until none that is next to those it has contributes more than ``tolerance``. An index that
    contributes nothing by itself hides those behind it.

    Parameters
    ----------
    function: ``(p, n) -> (p, m)``. mean: ``(n,)``. root: ``(n, n)``, lower. most: indices at the most.

    Raises
    ------
    ValueError: if the function is not finite at a point, or ``most`` indices do not reach the tolerance.
    """
    checks.function("function", function, "(points)")
    x, orders = finite("mean", mean, ("n",)), checked_orders(orders)
    n = len(x)
    L, most = finite("root", root, (n, n)), integer("most", most)
    number("tolerance", tolerance, 0.0)
    center = finite("function", function(x[None]), (1, "m"))[0]

    @cache
    def moments(index: tuple[int, ...]) -> tuple[Array, Array]:
        """First and second moment of the function about the image of the center, by a tensor rule."""
        nodes, weights = _tensor(index, orders)
        d = finite("function", function(x + nodes @ L.T), (len(nodes), len(center))) - center
        return weights @ d, d.T @ (weights[:, None] * d)

    def difference(index: tuple[int, ...]) -> tuple[Array, Array]:
        """What an index adds: the tensor product of the differences between levels."""
        first, second = np.zeros(len(center)), np.zeros((len(center), len(center)))
        active = [j for j, level in enumerate(index) if level]
        for lower in product((0, 1), repeat=len(active)):
            own = list(index)
            for j, less in zip(active, lower, strict=True):
                own[j] -= less
            a, b = moments(tuple(own))
            sign = (-1) ** sum(lower)
            first, second = first + sign * a, second + sign * b
        return first, second

    origin = (0,) * n
    accepted = {origin, *(_up(origin, j) for j in range(n))}
    parts = {index: difference(index) for index in accepted}
    mean_y, second_y = (sum(p[i] for p in parts.values()) for i in (0, 1))
    std = np.sqrt(np.maximum((second_y - np.outer(mean_y, mean_y)).diagonal(), 0.0))
    scale = np.where(std > 0.0, std, 1.0)

    def size(part: tuple[Array, Array]) -> float:
        return float(max(np.abs(part[0] / scale).max(), np.abs(part[1] / np.outer(scale, scale)).max()))

    contributions = {index: size(part) for index, part in parts.items()}
    border: dict[tuple[int, ...], float] = {}
    newest = list(accepted)
    while True:
        for index in newest:
            for j in range(n):
                up = _up(index, j)
                below = all(_up(up, i, -1) in accepted for i in range(n) if up[i])
                if up not in accepted and up not in border and below and up[j] < len(orders):
                    border[up] = size(difference(up))
        best = max(border, key=lambda i: border[i], default=None)
        if best is None or border[best] <= tolerance:
            break
        if len(accepted) >= most:
            raise ValueError(f"most: {most} indices do not reach the tolerance of {tolerance:g} ({border[best]:.3g} left)")
        contributions[best] = border.pop(best)
        accepted.add(best)
        newest = [best]
    coefficients = _coefficients(accepted)
    return Adapted(_combined(coefficients, orders), coefficients, contributions)


def _up(index: tuple[int, ...], j: int, by: int = 1) -> tuple[int, ...]:
    return (*index[:j], index[j] + by, *index[j + 1 :])


def _coefficients(indices: set[tuple[int, ...]]) -> dict[tuple[int, ...], int]:
    """Coefficients of the tensor rules in the combination technique, over a set that holds everything below its members."""
    out = dict.fromkeys(indices, 0)
    for index in indices:
        active = [j for j, level in enumerate(index) if level]
        for lower in product((0, 1), repeat=len(active)):
            own = list(index)
            for j, less in zip(active, lower, strict=True):
                own[j] -= less
            out[tuple(own)] += (-1) ** sum(lower)
    return {index: c for index, c in out.items() if c}


def _line(order: int) -> tuple[list[tuple[int, int]], Array, Array]:
    """Ids, nodes and weights of a whole one-dimensional rule; the node 0 has the id (0, 0) in all of them."""
    x, w = univariate(order)
    half = [(order, i + 1) for i in range(len(x))]
    middle = [(0, 0)] if order % 2 else []
    ids = [(a, -i) for a, i in half] + middle + half
    zero = [0.0] if order % 2 else []
    return ids, np.concatenate([-x, zero, x]), np.concatenate([w[1:], w[:1] if order % 2 else [], w[1:]])


@lru_cache(maxsize=4096)
def _tensor(index: tuple[int, ...], orders: tuple[int, ...]) -> tuple[Array, Array]:
    """Nodes and weights of the tensor product of the rules of these levels (from 0)."""
    active = [j for j, level in enumerate(index) if level]
    lines = [_line(orders[index[j]]) for j in active]
    weights = np.array([np.prod(w) for w in product(*(line[2] for line in lines))])
    nodes = np.zeros((len(weights), len(index)))
    if active:
        nodes[:, active] = list(product(*(line[1] for line in lines)))
    return nodes, weights


def _combined(coefficients: dict[tuple[int, ...], int], orders: tuple[int, ...]) -> Rule:
    """Rule of a combination of tensor rules, points merged by the ids of their nodes."""
    n = len(next(iter(coefficients)))
    merged: dict[tuple[tuple[int, tuple[int, int]], ...], tuple[float, float]] = {(): (0.0, 0.0)}
    for index, c in coefficients.items():
        active = [j for j, level in enumerate(index) if level]
        lines = [_line(orders[index[j]]) for j in active]
        for choice in product(*(range(len(line[0])) for line in lines)):
            key = tuple((j, line[0][i]) for j, line, i in zip(active, lines, choice, strict=True) if line[0][i][0])
            term = c * float(np.prod([line[2][i] for line, i in zip(lines, choice, strict=True)]))
            value, scale = merged.get(key, (0.0, 0.0))
            merged[key] = value + term, scale + abs(term)
    left = {key: value if abs(value) > CANCELED * scale else 0.0 for key, (value, scale) in merged.items()}
    kept = [(key, value) for key, value in left.items() if value or not key]
    nodes = np.zeros((len(kept), n))
    for row, (key, _) in enumerate(kept):
        for j, (order, i) in key:
            nodes[row, j] = np.sign(i) * univariate(order)[0][abs(i) - 1]
    return Rule(nodes, [v for _, v in kept])
