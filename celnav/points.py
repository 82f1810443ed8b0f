"""Rules: how a function of a Gaussian becomes a mean and columns.

A *rule is data*: nodes and weights for a unit Gaussian. `unscented`, `simplex`, `cubature` and `gauss_hermite` make rules,
`from_filterpy` turns filterpy's sigma-point classes into rules, and a `Rule` answers filterpy's own interface, so that it
works as ``points=`` of ``filterpy.kalman.UnscentedKalmanFilter``. The extended Kalman filter's linearization,
`celnav.taylor.Taylor`, follows the same protocol (`Transform`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import combinations, product
from math import prod
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian import finite
from celnav.linalg import Array, semidefinite_root, solve_upper_transposed
from celnav.spaces import EUCLIDEAN, Space

MAX_POINTS = 1_000_000


class _Keep:
    def __repr__(self) -> str:
        return "KEEP"


KEEP: Final = _Keep()
"""Stands for "the state itself" among the outputs of a function: its columns are then exact, on any space."""

Outputs = tuple[Any, ...]


class Image(NamedTuple):
    """One output of a transformed belief: the image of the center, the shift of the mean from there, and columns."""

    center: Array
    shift: Any
    columns: Array


class Transform(Protocol):
    """What a filter asks of a rule.

    ``transform`` pushes ``N(mean, root @ root.mT)`` through ``g``, which maps points ``(p, ..., N)`` and one array
    ``(p, ..., k)`` of noise points for each root in ``extra`` to a tuple of outputs, one for each of ``spaces``. It returns
    an `Image` of each output and the pre-array ``(..., sum of dimensions, q + room)`` that holds their columns above each
    other; the last ``room`` columns are for the caller. ``sign`` belongs to the first q columns. ``slope`` is the
    statistical Jacobian ``(..., k, n)`` of an image. ``epoch`` is for rules that know derivatives. ``linear``: whether columns
    are a matrix times the root, whatever the root.
    """

    sign: Array
    linear: bool

    def transform(
        self,
        g: Callable[..., Outputs],
        mean: Array,
        root: Array,
        space: Space,
        spaces: Sequence[Space],
        extra: Sequence[Array] = (),
        room: int = 0,
        epoch: Any = None,
    ) -> tuple[list[Image], Array]: ...

    def points(self, mean: Array, root: Array, space: Space, extra: Sequence[Array] = ()) -> list[Array]: ...

    def slope(self, image: Image, root: Array) -> Array: ...


# numpy transposes with a tuple are several times cheaper than moveaxis; keyed by the number of axes.
_POINTS_LAST = {d: (*range(1, d), 0) for d in range(2, 10)}  # (p, ..., k) -> (..., k, p)
_RUNS_LAST = {d: (d - 2, d - 1, *range(d - 2)) for d in range(2, 10)}  # (..., k, p) -> (k, p, ...)
_RUNS_LAST_POINTS = {d: (1, *range(2, d), 0) for d in range(2, 10)}  # (k, p, ...) -> (p, ..., k)
_POINTS_LAST_IN = {d: (d - 2, *range(d - 2), d - 1) for d in range(2, 10)}  # (..., k, p) -> (k, ..., p)
_POINTS_LAST_POINTS = {d: (d - 1, *range(1, d - 1), 0) for d in range(2, 10)}  # (k, ..., p) -> (p, ..., k)


class Rule:
    """Nodes and weights for expectations under ``N(0, I)``.

    Parameters
    ----------
    nodes: ``(p, n)``; node 0 is the center (its weights may be 0).
    wm: ``(p,)`` weights of the mean; they sum to 1, and ``sum wm nodes = 0``.
    wc: ``(p,)`` weights of the covariance (None: ``wm``); ``sum wc nodes nodes' = I``. They may be negative. A rule without
        nodes in some dimension is a quadrature, but no filter takes it: it would lose that variance.

    Raises
    ------
    ValueError: if a shape is wrong, a number not finite, or the moments above do not hold.
    """

    def __init__(self, nodes: ArrayLike, wm: ArrayLike, wc: ArrayLike | None = None):
        self.nodes = finite("nodes", nodes)
        if self.nodes.ndim != 2 or 0 in self.nodes.shape:
            raise ValueError(f"nodes: expected shape (p, n), got {self.nodes.shape}")
        p, self.n = self.nodes.shape
        self.wm = finite("wm", wm, (p,))
        self.wc = self.wm if wc is None else finite("wc", wc, (p,))
        if self.nodes[0].any():
            raise ValueError(f"nodes: expected the center first, got {self.nodes[0]}")
        rounding = 8.0 * np.finfo(np.float64).eps * np.abs(self.wm).sum()  # weights of size 1e8 come with a small alpha
        if abs(self.wm.sum() - 1.0) > max(1e-9, rounding):
            raise ValueError(f"wm: expected a sum of 1, got {self.wm.sum()!r}")
        if np.abs(self.wm @ self.nodes).max() > 1e-6:
            raise ValueError(f"wm: expected sum wm nodes = 0, got {self.wm @ self.nodes}")
        covered = self.nodes.any(0)
        second = self.nodes.T @ (self.wc[:, None] * self.nodes)
        if not np.allclose(second, np.diag(covered.astype(float)), rtol=0.0, atol=1e-6):
            raise ValueError("wc: expected sum wc nodes nodes' = I")
        self._idle = np.flatnonzero(~covered)
        for array in (self.nodes, self.wm, self.wc):
            array.flags.writeable = False
        # Means and columns are taken relative to the image of the center, so its mean weight never plays a part.
        used = (self.wm != 0.0) | (self.wc != 0.0)
        used[0] = self.wc[0] != 0.0
        self._used: Any = slice(None) if used.all() else slice(1, None) if used[1:].all() else np.flatnonzero(used)
        self._wm, self._scale = self.wm[used], np.sqrt(np.abs(self.wc[used]))
        self.sign = np.where(self.wc[used] < 0.0, -1.0, 1.0)
        self.linear = False

    @cached_property
    def _transposed(self) -> Array:
        return np.ascontiguousarray(self.nodes.T)

    @cached_property
    def unit(self) -> Array:
        """The columns of the unit Gaussian itself, ``(q, n)``."""
        return np.asarray(self.nodes[self._used] * self._scale[:, None])

    def __repr__(self) -> str:
        center = " and a center of weight 0" if self.num_sigmas() < len(self.nodes) else ""
        return f"Rule(n={self.n}, points={self.num_sigmas()}{center}, negative weights={int((self.wc < 0).sum())})"

    # -- filterpy's interface ------------------------------------------------------------------------------------------
    @property
    def _filterpy(self) -> slice:
        return slice(1, None) if self.wm[0] == self.wc[0] == 0.0 else slice(None)

    @property
    def Wm(self) -> Array:
        """Mean weights of the points that `sigma_points` gives."""
        return self.wm[self._filterpy]

    @property
    def Wc(self) -> Array:
        """Covariance weights of the points that `sigma_points` gives."""
        return self.wc[self._filterpy]

    def num_sigmas(self) -> int:
        """Number of points, without a center of weight 0."""
        return len(self.wm[self._filterpy])

    def sigma_points(self, x: ArrayLike, P: ArrayLike) -> Array:
        """Points ``(num_sigmas, n)`` of ``N(x, P)``; ``P`` may be a scalar, as in filterpy."""
        mean = np.atleast_1d(finite("x", x)).ravel()
        if len(mean) != self.n:
            raise ValueError(f"x: expected {self.n} components, got {len(mean)}")
        if self._idle.size:
            raise ValueError(f"rule: expected points in every dimension, got none in {', '.join(map(str, self._idle))}")
        cov = finite("P", P)
        root = semidefinite_root(cov * np.eye(self.n) if cov.ndim == 0 else np.atleast_2d(cov))
        if not np.isfinite(root).all():
            raise ValueError("P: expected a positive semidefinite covariance")
        return np.asarray(mean + self.nodes[self._filterpy] @ root.T)

    # -- the protocol of the filters -----------------------------------------------------------------------------------
    def points(self, mean: Array, root: Array, space: Space, extra: Sequence[Array] = ()) -> list[Array]:
        """State points ``(p, ..., N)`` and noise points ``(p, ..., k)``, one array for each root in ``extra``."""
        roots = (root, *extra)
        batch, channels = mean.shape[:-1], 0
        for E in roots:
            channels += E.shape[-1]
            if E.ndim > 2 and E.shape[:-2] != batch:
                batch = np.broadcast_shapes(batch, E.shape[:-2])
        if channels != self.n:
            raise ValueError(f"rule: expected {channels} dimensions (state and noise through the points), got {self.n}")
        if self._idle.size:
            raise ValueError(f"rule: expected points in every dimension, got none in {', '.join(map(str, self._idle))}")
        # Components first in memory, which models are fast on; then points or runs, the longer axis last.
        runs_last = len(self.nodes) < (batch[-1] if batch else 0)
        forth, back = (_RUNS_LAST, _RUNS_LAST_POINTS) if runs_last else (_POINTS_LAST_IN, _POINTS_LAST_POINTS)
        points, first = [], 0
        for E in roots:
            last = first + E.shape[-1]
            D = E @ self._transposed[first:last]
            if first and D.ndim == 2:  # the noise of every run: nothing to copy
                same = D.T.reshape(-1, *(1,) * len(batch), D.shape[0])
                points.append(np.broadcast_to(same, (same.shape[0], *batch, D.shape[0])))
                first = last
                continue
            if D.shape[:-2] != batch:
                D = np.broadcast_to(D, (*batch, *D.shape[-2:]))
            if first == 0 and space is EUCLIDEAN:  # moved and copied in one pass
                X = np.add(D.transpose(forth[D.ndim]), mean[..., None].transpose(forth[mean.ndim + 1]), order="C")
                points.append(X.transpose(back[D.ndim]))
            else:
                spread = np.ascontiguousarray(D.transpose(forth[D.ndim])).transpose(back[D.ndim])
                points.append(spread if first else space.plus(np.asfortranarray(mean), spread))
            first = last
        return points

    def transform(
        self,
        g: Callable[..., Outputs],
        mean: Array,
        root: Array,
        space: Space,
        spaces: Sequence[Space],
        extra: Sequence[Array] = (),
        room: int = 0,
        epoch: Any = None,  # noqa: ARG002
    ) -> tuple[list[Image], Array]:
        """See `Transform`."""
        X = self.points(mean, root, space, extra)
        outputs = g(*X)
        parts: list[tuple[Array, Array | None, int]] = []
        for y, sp in zip(outputs, spaces, strict=True):
            if y is KEEP:
                parts.append((mean, None, root.shape[-1]))
            else:
                center = y[0] if sp.mean is None else sp.mean(y, self.wm)
                values = y if sp is EUCLIDEAN else sp.minus(y, center)
                parts.append((center, values, values.shape[-1]))
        q = len(self._scale)
        A = np.empty((*X[0].shape[1:-1], sum(k for _, _, k in parts), q + room))
        images, top = [], 0
        for (center, values, k), sp in zip(parts, spaces, strict=True):
            columns = A[..., top : top + k, :q]
            shift: Any = 0.0
            if values is None:
                np.matmul(root, self.unit[:, :k].T, out=columns)
            else:
                moved = values[self._used].transpose(_POINTS_LAST[values.ndim])
                if sp is EUCLIDEAN:
                    np.subtract(moved, center[..., None], out=columns)
                else:
                    columns[...] = moved
                if sp.mean is None:
                    shift = columns @ self._wm
                    columns -= shift[..., None]
                columns *= self._scale
            images.append(Image(center, shift, columns))
            top += k
        return images, A

    def slope(self, image: Image, root: Array) -> Array:
        """Statistical Jacobian ``cov(y, x) P^-1`` of an image, ``(..., k, n)``."""
        cross = (image.columns * self.sign) @ self.unit[:, : root.shape[-1]]
        return solve_upper_transposed(root, cross.mT).mT


def integer(value: Any) -> int | None:
    """An integer that may have come as a float; None for anything else."""
    whole = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return int(value) if whole and np.isfinite(value) and int(value) == value else None


def _dimension(n: int) -> int:
    number = integer(n)
    if number is None or number < 1:
        raise ValueError(f"n: expected a positive integer, got {n!r}")
    return number


def _axes(n: int, radius: float) -> Array:
    """The center and two points on each axis, ``(2n + 1, n)``, in filterpy's order."""
    return radius * np.vstack([np.zeros(n), np.eye(n), -np.eye(n)])


def unscented(n: int, alpha: float = 1.0, beta: float = 0.0, kappa: float = 0.0) -> Rule:
    """Scaled unscented rule of ``2n + 1`` points [van der Merwe 2004]; the defaults have no negative weight.

    Raises
    ------
    ValueError: for ``n < 1``, ``alpha <= 0``, ``n + kappa <= 0`` or a number that is not finite.
    """
    n = _dimension(n)
    if not (np.isfinite(alpha) and alpha > 0.0):
        raise ValueError(f"alpha: expected a positive number, got {alpha!r}")
    if not np.isfinite(beta):
        raise ValueError(f"beta: expected a finite number, got {beta!r}")
    if not (np.isfinite(kappa) and n + kappa > 0.0):
        raise ValueError(f"kappa: expected n + kappa > 0, got {kappa!r} with n = {n}")
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
    n = _dimension(n)
    d = np.arange(1, n + 1)
    nodes = np.sqrt((n + 1) / (d * (d + 1))) * (np.triu(np.ones((n + 1, n))) - d * np.eye(n + 1, n, -1))
    nodes[:, 0] *= -1.0  # as filterpy has it
    weights = np.full(n + 1, 1.0 / (n + 1))
    return _centered(nodes, weights, weights)


def cubature(n: int, degree: int = 3) -> Rule:
    """Spherical-radial cubature rule: degree 3 with ``2n`` points, degree 5 with ``2n^2 + 1`` [Jia, Xin & Cheng 2013].

    The degree-5 rule has ``2n`` negative weights for ``n > 4``.

    Raises
    ------
    ValueError: for ``n < 1`` or another degree.
    """
    n = _dimension(n)
    if degree == 3:
        return Rule(_axes(n, float(np.sqrt(n))), np.r_[0.0, np.full(2 * n, 0.5 / n)])
    if degree != 5:
        raise ValueError(f"degree: expected 3 or 5, got {degree!r}")
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
    n = _dimension(n)
    size = integer(order)
    if size is None or not 2 <= size <= 100:
        raise ValueError(f"order: expected an integer between 2 and 100, got {order!r}")
    if size**n > MAX_POINTS:
        raise ValueError(f"order: {size}**{n} = {size**n} points exceed the limit of {MAX_POINTS}")
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
    count = prod(rule.num_sigmas() for rule in rules)
    if not rules or count > MAX_POINTS:
        raise ValueError(f"rules: expected a product of at most {MAX_POINTS} points, got {count} of {len(rules)} rules")
    nodes: Array = np.zeros((1, 0))
    wm: Array = np.ones(1)
    wc: Array = np.ones(1)
    for rule in rules:
        at = rule.nodes[rule._filterpy]
        nodes = np.concatenate([np.repeat(nodes, len(at), 0), np.tile(at, (len(nodes), 1))], 1)
        wm, wc = np.kron(wm, rule.Wm), np.kron(wc, rule.Wc)
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
