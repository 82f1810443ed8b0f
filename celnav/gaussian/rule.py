"""A rule is data: nodes and weights for a unit Gaussian, and what they make of a function of any Gaussian.

`celnav.gaussian.points` and `celnav.gaussian.sparse_grid` make rules. A `Rule` also answers filterpy's own interface, so that it works as
``points=`` of ``filterpy.kalman.UnscentedKalmanFilter``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Array, semidefinite_root, solve_upper_transposed
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.gaussian.transform import KEEP, Image, Outputs

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
        self.nodes = finite("nodes", nodes, ("p", "n"))
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
        self.sign.flags.writeable = False
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
        mean = finite("x", x).ravel()
        if len(mean) != self.n:
            raise ValueError(f"x: expected {self.n} components, got {len(mean)}")
        if self._idle.size:
            raise ValueError(f"rule: expected points in every dimension, got none in {', '.join(map(str, self._idle))}")
        cov = finite("P", P)
        root = semidefinite_root(finite("P", cov * np.eye(self.n) if cov.ndim == 0 else np.atleast_2d(cov), (self.n, self.n)))
        if not np.isfinite(root).all():
            raise ValueError("P: expected a positive semidefinite covariance")
        return np.asarray(mean + self.nodes[self._filterpy] @ root.T)

    # -- of one vector -------------------------------------------------------------------------------------------------
    def drawn(self, mean: Array, root: Array) -> Array:
        """Points ``(p, n)`` of one Gaussian, one after the other in memory."""
        points: Array = self.nodes.dot(root.T)
        points += mean
        return points

    def moments(self, images: Array) -> tuple[Array, Array]:
        """Mean ``(k,)`` and columns ``(k, q)`` of images ``(p, k)`` of such points, as `transform` makes them."""
        center = images[0]
        apart = images[self._used] - center
        shift = self._wm.dot(apart)
        apart -= shift
        apart *= self._scale[:, None]
        return center + shift, apart.T

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
