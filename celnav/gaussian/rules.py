"""Rules for the mean and the covariance of a function of a Gaussian.

A `Rule` has nodes and weights; `Taylor` linearizes. Both give the points at which to evaluate the
function, and compute an `Image` from the function's values there. `unscented`, `cubature`,
`gauss_hermite`, `simplex` and `tensor_product` make rules; `celnav.smolyak` makes sparse grids. A
rule also has filterpy's interface, so it works as ``points=`` of
``filterpy.kalman.UnscentedKalmanFilter``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from itertools import combinations, product
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import (
    LIMIT,
    choice,
    describe,
    finite,
    instance,
    integer,
    number,
    numbers,
)
from celnav.gaussian.linalg import (
    EPS,
    POSITIVE,
    Array,
    semidefinite_root,
    side_by_side,
    sigma_deviations,
    solve_right,
)
from celnav.gaussian.spaces import EUCLIDEAN, Space, points_last
from celnav.tape.derivative import along, at_zero

__all__ = [
    "Rule",
    "Taylor",
    "cubature",
    "from_filterpy",
    "gauss_hermite",
    "simplex",
    "tensor_product",
    "unscented",
]

MAX_POINTS = 1_000_000
ROUND_OFF = 1e-3  # largest round-off of a weighted mean, as a fraction of the model's values


class Image(NamedTuple):
    """Mean and covariance of a function of a Gaussian.

    center: ``(..., N)``, the function's value at the center.
    shift: ``(..., k)``, the mean minus the center, a tangent.
    columns: ``(..., k, q)``, weighted deviations from the mean: the covariance is
        ``columns @ diag(sign) @ columns.mT``, see `Joint`.
    jacobian: ``() -> (..., k, n)``, the statistical Jacobian ``cov(y, x) cov(x)^-1``.
    """

    center: Array
    shift: Any
    columns: Array
    jacobian: Callable[[], Array]


def _points(
    center: Array, roots: Sequence[Array], nodes: Array, space: Space, batch: int
) -> list[Array]:
    """Points ``(p, ..., N)`` about a center, and points ``(p, ..., k)`` of each noise; the first
    rows of ``nodes (dimensions, p)`` belong to the first root, and so on.
    """
    root, *noise_roots = roots
    first = root.shape[-1]
    deviations = sigma_deviations(root, nodes[:first], batch)
    # In this order a sum keeps the memory layout of the deviations.
    points = [deviations + center if space is EUCLIDEAN else space.plus(center, deviations)]
    for E in noise_roots:
        noise = sigma_deviations(E, nodes[first : first + E.shape[-1]], batch)
        points.append(np.broadcast_to(noise, (*points[0].shape[:-1], noise.shape[-1])))
        first += E.shape[-1]
    return points


class Rule:
    """Nodes and weights for expectations under ``N(0, I)``.

    nodes: ``(p, n)``; node 0 is the center (its weights may be 0).
    wm: ``(p,)`` weights of the mean; they sum to 1, and ``sum wm nodes = 0``.
    wc: ``(p,)`` weights of the covariance (None: ``wm``); ``sum wc nodes nodes' = I``. They may be
        negative. A rule may have no nodes in some dimension, but filters reject it, because it
        would lose the variance of that dimension.

    The arrays are read-only. ``n`` is the dimension. ``sign (q,)`` is -1 for columns of negative
    weight and 1 otherwise; ``(1,)`` if no weight is negative. ValueError names the argument that
    breaks one of these conditions.

    >>> rule = celnav.Rule([[0.0], [1.0], [-1.0]], [0.0, 0.5, 0.5])
    """

    def __init__(self, nodes: ArrayLike, wm: ArrayLike, wc: ArrayLike | None = None):
        self.nodes = finite("nodes", nodes, ("p", "n"))
        p, self.n = self.nodes.shape
        self.wm = finite("wm", wm, (p,))
        self.wc = self.wm if wc is None else finite("wc", wc, (p,))
        if self.nodes[0].any():
            raise ValueError(f"nodes: expected the center first, got {self.nodes[0]}")
        rounding = 8.0 * EPS * np.abs(self.wm).sum()  # weights of size 1e8 come with a small alpha
        if rounding > 8.0 * ROUND_OFF:
            raise ValueError(
                "alpha, kappa, wm: expected weights that leave three digits of a mean, got "
                f"{np.abs(self.wm).max():.3g} times the round-off of a model's values; alpha = "
                "1e-3 is small"
            )
        if abs(self.wm.sum() - 1.0) > max(1e-9, rounding):
            raise ValueError(f"wm: expected a sum of 1, got {self.wm.sum()!r}")
        if np.abs(self.wm @ self.nodes).max() > 1e-6:
            raise ValueError(f"wm: expected sum wm nodes = 0, got {self.wm @ self.nodes}")
        covered = self.nodes.any(0)
        second = self.nodes.T @ (self.wc[:, None] * self.nodes)
        if not np.allclose(second, np.diag(covered.astype(float)), rtol=0.0, atol=1e-6):
            raise ValueError(f"wc: expected sum wc nodes nodes' = I, got {second.tolist()!r:.80}")
        self._idle = np.flatnonzero(~covered).tolist()
        for array in (self.nodes, self.wm, self.wc):
            array.flags.writeable = False
        # Means and columns are relative to the value at the center: its mean weight has no effect.
        used = (self.wm != 0.0) | (self.wc != 0.0)
        used[0] = self.wc[0] != 0.0
        self._used: Any = (
            slice(None)
            if used.all()
            else slice(1, None)
            if used[1:].all()
            else np.flatnonzero(used)
        )
        self._wm, self._scale = self.wm[used], np.sqrt(np.abs(self.wc[used]))
        negative = self.wc[used] < 0.0
        self.sign = np.where(negative, -1.0, 1.0) if negative.any() else POSITIVE
        self.sign.flags.writeable = False
        self._transposed = np.ascontiguousarray(self.nodes.T)
        # (n, q), the columns of the unit Gaussian itself
        self._unit = (self.nodes[used] * self._scale[:, None]).T

    def __repr__(self) -> str:
        center = " and a center of weight 0" if self.num_sigmas() < len(self.nodes) else ""
        negative = int((self.wc < 0).sum())
        points = f"{self.num_sigmas()}{center}"
        return f"Rule(n={self.n}, points={points}, negative weights={negative})"

    def points(
        self, mean: Array, root: Array, space: Space = EUCLIDEAN, augment: Sequence[Array] = ()
    ) -> list[Array]:
        """Points ``(p, ..., N)`` of ``N(mean, root @ root.mT)``, and points ``(p, ..., k)`` of each
        noise whose root is in ``augment``. The first dimensions of the rule belong to the state.
        ValueError if the dimensions do not match.
        """
        first, batch = root.shape[-1], max(mean.ndim - 1, root.ndim - 2)
        total = first if not augment else first + sum(E.shape[-1] for E in augment)
        if total != self.n:
            raise ValueError(
                f"rule: expected {total} dimensions (state and noise through the points), got "
                f"{self.n}"
            )
        if self._idle:
            raise ValueError(
                "rule: expected points in every dimension, got none in "
                f"{', '.join(map(str, self._idle))}"
            )
        return _points(mean, (root, *augment), self._transposed, space, batch)

    def image(self, y: Array, space: Space, root: Array) -> Image:
        """The `Image` of ``N(mean, root @ root.mT)`` under a function with the values
        ``y (p, ..., M)`` at the points.
        """
        # shift = sum wm (y - center); columns = sqrt(|wc|) (y - center - shift).
        # Point 0 is the center. If the space defines a mean, it is the center, with a shift of 0.
        center = y[0] if space.mean is None else space.mean(y, self.wm)
        values = (y if space is EUCLIDEAN else space.minus(y, center))[self._used]
        values = values.T if values.ndim == 2 else points_last(values)  # (..., k, q)
        columns = np.subtract(values, center[..., None] if space is EUCLIDEAN else 0.0, order="C")
        if space.mean is None:
            shift = columns @ self._wm
            columns -= shift[..., None]
        else:
            shift = np.zeros(columns.shape[-2])
        # `sign` holds the signs of the weights; the columns have only their magnitudes.
        columns *= self._scale
        return Image(center, shift, columns, partial(self._jacobian, columns, root))

    def state_columns(self, root: Array, augment: Sequence[Array]) -> Array:  # noqa: ARG002
        """Columns ``(..., n, q)`` of the state's own covariance, to match those of an `Image`."""
        return np.asanyarray(root @ self._unit[: root.shape[-1]])

    def _jacobian(self, columns: Array, root: Array) -> Array:
        # cov(y, x) = columns sign (root unit)', and J = cov(y, x) P^-1 with P = root root':
        # J root = columns sign unit'.
        cross = (columns * self.sign) @ self._unit[: root.shape[-1]].T
        return solve_right(root, cross)

    @cached_property
    def _filterpy(self) -> slice:
        return slice(1, None) if self.wm[0] == self.wc[0] == 0.0 else slice(None)

    @property
    def Wm(self) -> Array:
        """Mean weights ``(p,)`` of the points that `sigma_points` gives."""
        return self.wm[self._filterpy]

    @property
    def Wc(self) -> Array:
        """Covariance weights ``(p,)`` of the points that `sigma_points` gives."""
        return self.wc[self._filterpy]

    def num_sigmas(self) -> int:
        """Number of points, excluding a center of weight 0."""
        return len(self.wm[self._filterpy])

    def sigma_points(self, x: ArrayLike, P: ArrayLike) -> Array:
        """Points ``(num_sigmas, n)`` of ``N(x, P)``; ``P`` may be a scalar, as in filterpy."""
        mean = finite("x", x).ravel()
        if len(mean) != self.n:
            raise ValueError(f"x: expected {self.n} components, got {len(mean)}")
        cov = finite("P", P)
        root = semidefinite_root(
            finite(
                "P", cov * np.eye(self.n) if cov.ndim == 0 else np.atleast_2d(cov), (self.n, self.n)
            )
        )
        if not np.isfinite(root).all():
            raise ValueError(f"P: expected a positive semidefinite covariance, got {P!r:.80}")
        return np.ascontiguousarray(self.points(mean, root)[0][self._filterpy])


class Taylor:
    """First-order expansion about the mean: the rule that makes a filter an extended Kalman filter.

    It works for any dimension. It uses the ``jacobian`` of a `Motion` or a `Sensor` if there is
    one, and central differences along the columns of the root otherwise.

    step: length of the differences, in standard deviations.
    about: ``(..., N)``, the point to expand about instead of the mean, as in an iterated filter.
        The mean does not change; the linear approximation is evaluated there.

    >>> filter = celnav.sigma_point(motion, gps, rule=celnav.Taylor())  # celnav.ekf(motion, gps)
    """

    sign = POSITIVE

    def __init__(self, step: float = 1e-3, *, about: ArrayLike | None = None):
        self.step = number("step", step, above=0.0)
        self.about = None if about is None else numbers("about", about)

    def __repr__(self) -> str:
        return "Taylor()"

    def points(
        self, mean: Array, root: Array, space: Space = EUCLIDEAN, augment: Sequence[Array] = ()
    ) -> list[Array]:
        """The center and its neighbors ``(p, ..., N)``, and points ``(p, ..., k)`` of each noise,
        one direction at a time.

        With ``about``, the tangent from there to the mean is one more direction, after the columns
        of the root. ValueError if ``about`` has another length than the mean.
        """
        center = mean if self.about is None else self.about
        if center.shape[-1:] != mean.shape[-1:]:
            raise ValueError(f"about: expected shape (..., {mean.shape[-1]}), got {center.shape}")
        center = np.broadcast_to(center, np.broadcast_shapes(center.shape, mean.shape))
        if self.about is not None:
            root = side_by_side([root, space.minus(mean, center)[..., None]])
        roots = (root, *augment)
        if root.dtype.hasobject or center.dtype.hasobject:
            first, *noise = along(center, roots)
            return [space.plus(center, first), *noise]
        first, batch = root.shape[-1], max(center.ndim - 1, root.ndim - 2)
        total = first if not augment else first + sum(E.shape[-1] for E in augment)
        # Columns: the center, then + step, then - step in each direction.
        directions = self.step * np.hstack([np.zeros((total, 1)), np.eye(total), -np.eye(total)])
        return _points(center, roots, directions, space, batch)

    def image(self, y: Array, space: Space, root: Array) -> Image:
        """The `Image` from the values ``y (p, ..., M)`` at the `points`."""
        if y.dtype.hasobject:
            center: Array = at_zero(y)[0][0]
            columns: Array = at_zero(space.minus(y[0], center))[1]
        else:
            # (y(+ step) - y(- step)) / (2 step), one column (..., k) per direction.
            center, d = y[0], space.minus(y, y[0])
            # d[0] = 0 is the center; the + points follow, then the - points.
            total = (len(d) - 1) // 2
            columns = np.moveaxis(d[1 : total + 1] - d[total + 1 :], 0, -1) / (2.0 * self.step)
        shift = np.zeros(columns.shape[-2])
        if self.about is not None:
            n = root.shape[-1]
            # Column n is the image of mean - about; the noises follow it.
            shift = columns[..., n]
            columns = np.concatenate([columns[..., :n], columns[..., n + 1 :]], -1)
        return Image(center, shift, columns, partial(self._jacobian, columns, root))

    def state_columns(self, root: Array, augment: Sequence[Array]) -> Array:
        """Columns ``(..., n, q)`` of the state's own covariance, with zeros for each noise."""
        return (
            side_by_side([root, *(np.zeros((root.shape[-2], E.shape[-1])) for E in augment)])
            if augment
            else root
        )

    @staticmethod
    def _jacobian(columns: Array, root: Array) -> Array:
        # The state's columns are J root; the columns of the noises follow them.
        return solve_right(root, columns[..., : root.shape[-1]])


class AnyDimension:
    """A rule for any dimension; the function ``n -> rule`` is called once per dimension."""

    def __init__(self, make: Callable[[int], Any]):
        self.make, self._rules = make, dict[int, Any]()

    def __repr__(self) -> str:
        return describe(getattr(self.make, "func", self.make)).removeprefix("function ")

    def __call__(self, n: int) -> Any:
        """The rule for n dimensions; ValueError if the function does not make one."""
        if n not in self._rules:
            try:
                rule = self.make(n)
            except TypeError as error:
                raise ValueError(
                    f"rule: expected a function of the dimension, got {describe(self.make)}: "
                    f"{error}"
                ) from error
            if isinstance(rule, type) or not hasattr(rule, "image"):
                raise ValueError(
                    f"rule: expected a rule for {n} dimensions, such as celnav.unscented(n), got "
                    f"{describe(rule)}"
                )
            self._rules[n] = rule
        return self._rules[n]


# -- made for a dimension --------------------------------------------------------------------------
def check_point_count(name: str, points: int, n: int) -> None:
    """Raise ValueError, before points are made, for more than `MAX_POINTS` points or more than
    `celnav.gaussian.checks.LIMIT` numbers.
    """
    if points > MAX_POINTS or points * n > LIMIT:
        raise ValueError(
            f"{name}: expected at most {MAX_POINTS} points and {LIMIT} numbers, got {points} "
            f"points of {n} components"
        )


def _axes(n: int, radius: float) -> Array:
    """The center and two points on each axis, ``(2n + 1, n)``, in filterpy's order."""
    return radius * np.vstack([np.zeros(n), np.eye(n), -np.eye(n)])


def unscented(n: int, alpha: float = 1.0, beta: float = 0.0, kappa: float = 0.0) -> Rule:
    """Scaled unscented rule of ``2n + 1`` points [Merwe2004]; the defaults have no negative weight.

    With the defaults the center has weight 0, and the rule equals ``cubature(n)``, the rule of the
    cubature Kalman filter. The customary ``kappa = 3 - n`` matches fourth moments on the axes. A
    small ``alpha`` with ``beta = 2`` places the points near the mean.

    >>> celnav.unscented(6, alpha=0.1, beta=2.0)
    Rule(n=6, points=13, negative weights=1)
    """
    n = integer("n", n)
    check_point_count("n", 2 * n + 1, n)
    alpha, beta, kappa = (
        number("alpha", alpha, above=0.0),
        number("beta", beta),
        number("kappa", kappa, above=-n),
    )
    # c = n + lambda: the points lie at a distance sqrt(c) on the axes.
    c = alpha**2 * (n + kappa)
    wm = np.full(2 * n + 1, 0.5 / c)
    wm[0] = 1.0 - n / c
    wc = wm.copy()
    # Only the covariance weight of the center has beta [Merwe2004].
    wc[0] += 1.0 - alpha**2 + beta
    return Rule(_axes(n, float(np.sqrt(c))), wm, wc)


UNSCENTED = AnyDimension(unscented)
"""The default rule of filters that accept any rule."""


def simplex(n: int) -> Rule:
    """Spherical simplex: ``n + 1`` points of equal weight, the fewest that a covariance needs
    [Moireau2011].

    >>> celnav.simplex(6)
    Rule(n=6, points=7 and a center of weight 0, negative weights=0)
    """
    n = integer("n", n)
    check_point_count("n", n + 1, n)
    # Column d: 1 in d nodes, -d in the next, 0 in the rest, so that the sum is 0.
    d = np.arange(1, n + 1)
    nodes = np.sqrt((n + 1) / (d * (d + 1))) * (
        np.triu(np.ones((n + 1, n))) - d * np.eye(n + 1, n, -1)
    )
    nodes[:, 0] *= -1.0  # the sign that filterpy uses
    weights = np.full(n + 1, 1.0 / (n + 1))
    return _centered(nodes, weights, weights)


def cubature(n: int, degree: int = 3) -> Rule:
    """Spherical-radial cubature rule: degree 3 with ``2n`` points, degree 5 with ``2n^2 + 1``
    [Jia2013].

    The degree-3 rule is ``unscented(n)`` with its defaults. The degree-5 rule has ``2n`` negative
    weights for ``n > 4``.

    >>> celnav.cubature(6, degree=5)
    Rule(n=6, points=73, negative weights=12)
    """
    n = integer("n", n)
    degree = choice("degree", degree, (3, 5))
    check_point_count("n", 2 * n if degree == 3 else 2 * n * n + 1, n)
    if degree == 3:
        return Rule(_axes(n, float(np.sqrt(n))), np.r_[0.0, np.full(2 * n, 0.5 / n)])
    # Points (+-1, +-1) on each pair of axes.
    pairs = np.zeros((2 * n * (n - 1), n))
    signs = product(combinations(range(n), 2), product((1.0, -1.0), repeat=2))
    for row, ((i, j), (s, t)) in zip(pairs, signs, strict=True):
        row[i], row[j] = s, t
    nodes = np.vstack([_axes(n, float(np.sqrt(n + 2))), np.sqrt((n + 2) / 2) * pairs])
    weights = np.full(len(nodes), 1.0 / (n + 2) ** 2)
    weights[0] = 2.0 / (n + 2)
    # Weights of the points on the axes; negative for n > 4.
    weights[1 : 2 * n + 1] = (4.0 - n) / (2.0 * (n + 2) ** 2)
    return Rule(nodes, weights)


def gauss_hermite(n: int, order: int = 3) -> Rule:
    """Tensor product of Gauss-Hermite rules of ``order`` points: ``order ** n`` points in all.

    For an odd order the center is one of them. ValueError for more than `MAX_POINTS`.

    >>> celnav.gauss_hermite(3, order=3)
    Rule(n=3, points=27, negative weights=0)
    """
    n, size = integer("n", n), integer("order", order, 2, 100)
    # 2**20 points already exceed the limit; the exact 2**1000000000 has 300 million digits.
    if (count := size ** min(n, 20)) > MAX_POINTS:
        name, many = ("order", f" = {count}") if n <= 20 else ("n", "")
        raise ValueError(
            f"{name}: expected at most {MAX_POINTS} points, got {size}**{n}{many} points"
        )
    x, w = np.polynomial.hermite_e.hermegauss(size)
    x[np.abs(x) < 1e-12] = 0.0
    nodes = np.stack(np.meshgrid(*[x] * n, indexing="ij"), -1).reshape(-1, n)
    weights = np.prod(
        np.stack(np.meshgrid(*[w / w.sum()] * n, indexing="ij"), -1).reshape(-1, n), -1
    )
    return _centered(nodes, weights, weights)


def tensor_product(*rules: Rule) -> Rule:
    """Rule for the joint distribution of independent Gaussians: it combines every node of each rule
    with every node of the others.

    Marginalized rule: suppose that a model is nonlinear in the first k states only and, given
    these, linear in the other n - k. Then ``tensor_product(gauss_hermite(k, m), simplex(n - k))``,
    with ``m**k (n - k + 1)`` points, gives exactly the result of the full tensor rule with ``m**n``
    points. The nonlinear states must come first, and roots must be lower triangular.

    >>> rule = celnav.gaussian.rules.tensor_product(celnav.gauss_hermite(2, 3), celnav.simplex(4))
    """
    for rule in rules:
        instance("rules", rule, Rule, "a Rule, such as celnav.unscented(2)")
    if not rules:
        raise ValueError("rules: expected at least one, got none")
    check_point_count(
        "rules", prod(rule.num_sigmas() for rule in rules), sum(rule.n for rule in rules)
    )
    nodes: Array = np.zeros((1, 0))
    wm: Array = np.ones(1)
    wc: Array = np.ones(1)
    for rule in rules:
        used = (rule.wm != 0.0) | (rule.wc != 0.0)
        at = rule.nodes[used]
        # (p q, n + k): every node with every node of the next rule; the weights multiply.
        nodes = np.concatenate([np.repeat(nodes, len(at), 0), np.tile(at, (len(nodes), 1))], 1)
        wm, wc = np.kron(wm, rule.wm[used]), np.kron(wc, rule.wc[used])
    return _centered(nodes, wm, wc)


def from_filterpy(points: Any) -> Rule:
    """`Rule` with the points of a filterpy sigma-point object (Merwe, Julier, Simplex, or any with
    the same interface); ValueError for other objects.

    >>> points = MerweScaledSigmaPoints(6, 0.1, 2.0, -3.0)
    >>> filter = celnav.sigma_point(motion, gps, rule=celnav.from_filterpy(points))
    """
    if isinstance(points, type) or not all(
        hasattr(points, name) for name in ("n", "sigma_points", "Wm", "Wc")
    ):
        raise ValueError(
            "points: expected a filterpy sigma-point object, such as MerweScaledSigmaPoints(...), "
            f"got {points!r:.80}"
        )
    nodes = points.sigma_points(np.zeros(points.n), np.eye(points.n))
    return _centered(nodes, np.ravel(points.Wm), np.ravel(points.Wc))


def _centered(nodes: Array, wm: Array, wc: Array) -> Rule:
    """Make a rule with the center first; a missing center is added with weight 0."""
    nearest = int(np.argmin(np.abs(nodes).sum(-1)))
    if np.abs(nodes[nearest]).max() > 1e-12:
        return Rule(np.vstack([np.zeros(nodes.shape[-1]), nodes]), np.r_[0.0, wm], np.r_[0.0, wc])
    order = np.r_[nearest, np.delete(np.arange(len(wm)), nearest)]
    nodes = nodes[order]
    nodes[0] = 0.0
    return Rule(nodes, wm[order], wc[order])
