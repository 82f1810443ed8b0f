"""Sparse grids that fit themselves to one function: dimension-adaptive quadrature [Gerstner & Griebel 2003]."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache, lru_cache
from itertools import product
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian import checks
from celnav.gaussian.checks import finite, integer, number
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule
from celnav.gaussian.sparse_grid import CANCELED, ORDERS, check_orders, univariate

Index = tuple[int, ...]
"""Levels of the one-dimensional rules of each channel, from 0."""


class Adapted(NamedTuple):
    """A rule fitted to a function: its multi-indices (from 0) with their coefficients, and what each index contributed."""

    rule: Rule
    coefficients: dict[Index, int]
    contributions: dict[Index, float]


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
    x, orders = finite("mean", mean, ("n",)), check_orders(orders)
    n = len(x)
    L, most = finite("root", root, (n, n)), integer("most", most)
    number("tolerance", tolerance, 0.0)
    center = finite("function", function(x[None]), (1, "m"))[0]
    m = len(center)

    @cache
    def moments(index: Index) -> tuple[Array, Array]:
        """First and second moment of the function about the image of the center, by a tensor rule."""
        nodes, weights = _tensor(index, orders)
        d = finite("function", function(x + nodes @ L.T), (len(nodes), m)) - center
        return weights @ d, d.T @ (weights[:, None] * d)

    def difference(index: Index) -> tuple[Array, Array]:
        """What an index adds to both moments."""
        first, second = np.zeros(m), np.zeros((m, m))
        for own, sign in _differences(index):
            a, b = moments(own)
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
    border: dict[Index, float] = {}
    newest = list(accepted)
    while True:
        for up in (_up(index, j) for index in newest for j in range(n) if index[j] + 1 < len(orders)):
            below = all(_up(up, i, -1) in accepted for i in range(n) if up[i])
            if below and up not in accepted and up not in border:
                border[up] = size(difference(up))
        best = max(border, key=lambda i: border[i], default=None)
        if best is None or border[best] <= tolerance:
            break
        if len(accepted) >= most:
            raise ValueError(f"most: {most} indices do not reach the tolerance of {tolerance:g} ({border[best]:.3g} left)")
        contributions[best] = border.pop(best)
        accepted.add(best)
        newest = [best]
    coefficients = dict.fromkeys(accepted, 0)
    for own, sign in (part for index in accepted for part in _differences(index)):
        coefficients[own] += sign
    coefficients = {index: c for index, c in coefficients.items() if c}
    return Adapted(_combined(coefficients, orders), coefficients, contributions)


def _up(index: Index, j: int, by: int = 1) -> Index:
    return (*index[:j], index[j] + by, *index[j + 1 :])


def _differences(index: Index) -> Iterator[tuple[Index, int]]:
    """The tensor rules whose signed sum is the product of the differences between each channel's level and the one below it."""
    for own in product(*((level, level - 1) if level else (0,) for level in index)):
        yield own, (-1) ** (sum(index) - sum(own))


@lru_cache(maxsize=4096)
def _tensor(index: Index, orders: tuple[int, ...]) -> tuple[Array, Array]:
    """Nodes ``(p, n)`` and weights ``(p,)`` of the tensor product of the rules of these levels."""
    nodes, weights = [], []
    for order in (orders[level] for level in index):
        x, w = univariate(order)
        odd = order % 2
        nodes.append([*-x, *[0.0] * odd, *x])
        weights.append([*w[1:], *w[:odd], *w[1:]])
    return np.array(list(product(*nodes))), np.array([prod(w) for w in product(*weights)])


def _combined(coefficients: dict[Index, int], orders: tuple[int, ...]) -> Rule:
    """Rule of a combination of tensor rules. Only points whose nodes are of the same rules, or 0, are equal: bit for bit."""
    merged = {(0.0,) * len(next(iter(coefficients))): (0.0, 0.0)}
    for index, c in coefficients.items():
        nodes, weights = _tensor(index, orders)
        for point, term in zip(map(tuple, nodes.tolist()), (c * weights).tolist(), strict=True):
            value, scale = merged.get(point, (0.0, 0.0))
            merged[point] = value + term, scale + abs(term)
    left = {point: value if abs(value) > CANCELED * scale else 0.0 for point, (value, scale) in merged.items()}
    kept = {point: value for point, value in left.items() if value or not any(point)}
    return Rule(list(kept), list(kept.values()))
