"""Rules of sigma points: unscented, simplex, cubature, Gauss-Hermite, their products, and those of filterpy."""

from __future__ import annotations

from itertools import combinations, product
from math import prod
from typing import Any

import numpy as np

from celnav.gaussian.checks import LIMIT, choice, instance, integer, number
from celnav.gaussian.linalg import Array
from celnav.gaussian.rule import Rule

MAX_POINTS = 1_000_000


def few(name: str, points: int, n: int) -> None:
    """Refuse points before they are made: more than `MAX_POINTS`, or more numbers than `celnav.gaussian.checks.LIMIT`."""
    if points > MAX_POINTS or points * n > LIMIT:
        raise ValueError(f"{name}: {points} points of {n} components exceed the limit of {MAX_POINTS} points, {LIMIT} numbers")


def _axes(n: int, radius: float) -> Array:
    """The center and two points on each axis, ``(2n + 1, n)``, in filterpy's order."""
    return radius * np.vstack([np.zeros(n), np.eye(n), -np.eye(n)])


def unscented(n: int, alpha: float = 1.0, beta: float = 0.0, kappa: float = 0.0) -> Rule:
    """Scaled unscented rule of ``2n + 1`` points [van der Merwe 2004]; the defaults have no negative weight.

    With the defaults the center has no weight, and the rule is ``cubature(n)``, that of the cubature Kalman filter. The customary
    ``kappa = 3 - n`` matches fourth moments on the axes; a small ``alpha`` with ``beta = 2`` keeps the points near the mean.

    Raises
    ------
    ValueError: for ``n < 1``, ``alpha <= 0``, ``n + kappa <= 0`` or a number that is not finite.
    """
    n = integer("n", n)
    few("n", 2 * n + 1, n)
    alpha, beta, kappa = number("alpha", alpha, above=0.0), number("beta", beta), number("kappa", kappa, above=-n)
    c = alpha**2 * (n + kappa)
    wm = np.full(2 * n + 1, 0.5 / c)
    wm[0] = 1.0 - n / c
    wc = wm.copy()
    wc[0] += 1.0 - alpha**2 + beta
    return Rule(_axes(n, float(np.sqrt(c))), wm, wc)


def simplex(n: int) -> Rule:
    """Spherical simplex: ``n + 1`` points of equal weight, the fewest that a covariance needs [Moireau & Chapelle 2011].

    Raises
    ------
    ValueError: for ``n < 1``.
    """
    n = integer("n", n)
    few("n", n + 1, n)
    d = np.arange(1, n + 1)
    nodes = np.sqrt((n + 1) / (d * (d + 1))) * (np.triu(np.ones((n + 1, n))) - d * np.eye(n + 1, n, -1))
    nodes[:, 0] *= -1.0  # as filterpy has it
    weights = np.full(n + 1, 1.0 / (n + 1))
    return _centered(nodes, weights, weights)


def cubature(n: int, degree: int = 3) -> Rule:
    """Spherical-radial cubature rule: degree 3 with ``2n`` points, degree 5 with ``2n^2 + 1`` [Jia, Xin & Cheng 2013].

    The degree-3 rule is ``unscented(n)`` with its defaults. The degree-5 rule has ``2n`` negative weights for ``n > 4``.

    Raises
    ------
    ValueError: for ``n < 1`` or another degree.
    """
    n = integer("n", n)
    degree = choice("degree", degree, (3, 5))
    few("n", 2 * n if degree == 3 else 2 * n * n + 1, n)
    if degree == 3:
        return Rule(_axes(n, float(np.sqrt(n))), np.r_[0.0, np.full(2 * n, 0.5 / n)])
    pairs = np.zeros((2 * n * (n - 1), n))
    signs = product(combinations(range(n), 2), product((1.0, -1.0), repeat=2))
    for row, ((i, j), (s, t)) in zip(pairs, signs, strict=True):
        row[i], row[j] = s, t
    nodes = np.vstack([_axes(n, float(np.sqrt(n + 2))), np.sqrt((n + 2) / 2) * pairs])
    weights = np.full(len(nodes), 1.0 / (n + 2) ** 2)
    weights[0] = 2.0 / (n + 2)
    weights[1 : 2 * n + 1] = (4.0 - n) / (2.0 * (n + 2) ** 2)
    return Rule(nodes, weights)


def gauss_hermite(n: int, order: int = 3) -> Rule:
    """Tensor product of Gauss-Hermite rules of ``order`` points, ``order ** n`` in all (odd orders have a center).

    Raises
    ------
    ValueError: for ``n < 1``, ``order < 2`` or more than `MAX_POINTS` points, before anything is allocated.
    """
    n, size = integer("n", n), integer("order", order, 2, 100)
    if (count := size ** min(n, 20)) > MAX_POINTS:  # 2**20 are too many already, 2**1000000000 has 300 million digits
        many = f"order: {size}**{n} = {count}" if n <= 20 else f"n: {size}**{n}"
        raise ValueError(f"{many} points exceed the limit of {MAX_POINTS}")
    x, w = np.polynomial.hermite_e.hermegauss(size)
    x[np.abs(x) < 1e-12] = 0.0
    nodes = np.stack(np.meshgrid(*[x] * n, indexing="ij"), -1).reshape(-1, n)
    weights = np.prod(np.stack(np.meshgrid(*[w / w.sum()] * n, indexing="ij"), -1).reshape(-1, n), -1)
    return _centered(nodes, weights, weights)


def tensor_product(*rules: Rule) -> Rule:
    """Rule of the joint of independent parts: every node of each rule with every node of the others.

    For a model that is nonlinear in the first k states only and, given these, linear in the other n - k, the product
    ``tensor_product(gauss_hermite(k, m), simplex(n - k))`` has ``m**k (n - k + 1)`` points and gives exactly what the full
    tensor rule of ``m**n`` points gives (the marginalized rule; with lower roots and the nonlinear states first).

    Raises
    ------
    ValueError: for more than `MAX_POINTS` points, before anything is allocated.
    """
    for rule in rules:
        instance("rules", rule, Rule, "a Rule, such as celnav.unscented(2)")
    count = prod(rule.num_sigmas() for rule in rules)
    if not rules or count > MAX_POINTS:
        raise ValueError(f"rules: expected a product of at most {MAX_POINTS} points, got {count} of {len(rules)} rules")
    nodes: Array = np.zeros((1, 0))
    wm: Array = np.ones(1)
    wc: Array = np.ones(1)
    for rule in rules:
        kept = (rule.wm != 0.0) | (rule.wc != 0.0)
        at = rule.nodes[kept]
        nodes = np.concatenate([np.repeat(nodes, len(at), 0), np.tile(at, (len(nodes), 1))], 1)
        wm, wc = np.kron(wm, rule.wm[kept]), np.kron(wc, rule.wc[kept])
    return _centered(nodes, wm, wc)


def from_filterpy(points: Any) -> Rule:
    """Rule of a filterpy sigma-point object (Merwe, Julier, Simplex, or any of that interface).

    Raises
    ------
    ValueError: if its weights do not have the moments that a `Rule` needs, or it is no such object.
    """
    if isinstance(points, type) or not all(hasattr(points, name) for name in ("n", "sigma_points", "Wm", "Wc")):
        raise ValueError(f"points: expected a filterpy sigma-point object, such as MerweScaledSigmaPoints(...), got {points!r:.80}")
    nodes = points.sigma_points(np.zeros(points.n), np.eye(points.n))
    return _centered(nodes, np.ravel(points.Wm), np.ravel(points.Wc))


def _centered(nodes: Array, wm: Array, wc: Array) -> Rule:
    """Rule with its center first: moved there, or added with weight 0."""
    nearest = int(np.argmin(np.abs(nodes).sum(-1)))
    if np.abs(nodes[nearest]).max() > 1e-12:
        return Rule(np.vstack([np.zeros(nodes.shape[-1]), nodes]), np.r_[0.0, wm], np.r_[0.0, wc])
    order = np.r_[nearest, np.delete(np.arange(len(wm)), nearest)]
    nodes = nodes[order]
    nodes[0] = 0.0
    return Rule(nodes, wm[order], wc[order])
