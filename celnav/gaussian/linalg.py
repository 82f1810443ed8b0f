"""Batched kernels for small matrices, and beliefs in square-root form (`SquareRoot`) and covariance
form (`Covariance`).

Every function accepts leading batch axes (the runs of a Monte-Carlo simulation) and treats the last
two axes as a matrix. Roots are *lower* triangular with a non-negative diagonal, ``P = L @ L.mT``.
"Columns" are any ``(..., n, q)`` array ``A`` with ``P = A @ A.mT``. If a matrix of a batch has no
root, its result is nan, and the other matrices are not affected. A single matrix goes to LAPACK
directly: for a small matrix, numpy's batched functions spend most of their time on overhead.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import accumulate
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from celnav.gaussian import recorded
from celnav.lazy import LazyModule
from celnav.tape.numbers import rarely, traced

Array = NDArray[Any]
blas, lapack = LazyModule("scipy.linalg.blas"), LazyModule("scipy.linalg.lapack")
EPS = float(np.finfo(np.float64).eps)
NEGLIGIBLE = 1e-12
"""Fraction of the largest standard deviation, or variance, below which a value is round-off."""
PRECISE = 1e3
"""Ratio of an innovation's σ to its noise's σ, above which a difference of covariances loses too
many digits.
"""
LEFT_OVER = PRECISE**2 * EPS
"""Fraction of a covariance that is round-off after such a difference."""
POSITIVE: Array = np.broadcast_to(1.0, 1)
"""The ``sign`` of columns that all have sign +1."""


def is_concretely_true(condition: Any) -> bool:
    """Whether a condition on numbers holds. False while a step is recorded, because the numbers
    have no values yet. For shortcuts and checks.
    """
    return isinstance(condition, bool | np.bool_) and bool(condition)


def present(x: Array) -> Array:
    """Mask, of the shape of ``x``, of the components that were measured (are not nan)."""
    return np.asanyarray(recorded.present(x) if x.dtype.hasobject else x == x)


def matvec(A: Array, x: Array) -> Array:
    """Product ``(..., n)`` of matrices ``(..., n, m)`` and vectors ``(..., m)``; a single matrix
    multiplies all vectors at once.
    """
    return np.asanyarray(x @ A.mT if A.ndim == 2 else (A @ x[..., None])[..., 0])


def outer(A: Array) -> Array:
    """``A @ A.mT``, the covariance of the columns ``A (..., n, q)``; symmetric to rounding."""
    return np.asanyarray(recorded.outer(A) if A.dtype.hasobject else A @ A.mT)


def side_by_side(parts: Sequence[Array]) -> Array:
    """Join arrays ``(..., k)`` along their last axis; their batch axes broadcast."""
    batches = {array.shape[:-1] for array in parts}
    if len(batches) > 1:
        batch = np.broadcast_shapes(*batches)
        parts = [np.broadcast_to(array, (*batch, array.shape[-1])) for array in parts]
    return np.concatenate(parts, -1)


def tria(A: Array) -> Array:
    """Lower root ``L (..., n, n)``, diagonal >= 0, of the columns ``A (..., n, q)``:
    ``L @ L.mT == A @ A.mT``, by QR.

    The product ``A @ A.mT`` is not formed, because its Cholesky factorization would lose half of
    the digits.
    """
    if A.dtype.hasobject:
        return np.asanyarray(recorded.tria(A))
    n, q = A.shape[-2:]
    if q < n:
        # QR needs q >= n: columns of zeros change nothing.
        A = np.concatenate([A, np.zeros((*A.shape[:-1], n - q))], -1)
    if A.ndim == 2:
        R = lapack.dgeqrfp(A.T)[0][:n]  # its diagonal is not negative
        return np.asanyarray(R.T * _lower(n))
    # "raw" leaves R' in the lower triangle and Householder vectors above it.
    L = np.linalg.qr(A.mT, mode="raw")[0][..., :n] * _lower(n)
    # In C order whatever the order of A: products with L then take the same path for every number
    # of runs.
    return np.asanyarray(
        np.multiply(L, np.copysign(1.0, L.diagonal(0, -2, -1))[..., None, :], order="C")
    )


@cache
def _lower(n: int) -> Array:
    return np.broadcast_to(np.tri(n), (n, n))  # read-only, because it is shared


def solve_lower(L: Array, B: Array) -> Array:
    """Solve ``L @ X = B`` for lower triangular ``L (..., n, n)`` and ``B (..., n, k)``; a zero on
    the diagonal gives nan.
    """
    if L.dtype.hasobject or B.dtype.hasobject:
        return np.asanyarray(recorded.solve_lower(L, B))
    # Row i: X_i = (B_i - sum over j < i of L_ij X_j) / L_ii.
    diagonal = L.diagonal(0, -2, -1)
    if L.ndim == B.ndim == 2 and diagonal.all():
        # LAPACK's dtrtrs would start threads, however small the matrix.
        return np.asanyarray(blas.dtrsm(1.0, L, B, lower=1))
    diagonal = np.where(diagonal == 0.0, np.nan, diagonal)
    X = np.empty(np.broadcast_shapes(L.shape[:-2], B.shape[:-2]) + B.shape[-2:])
    for i in range(L.shape[-1]):
        explained = (L[..., i, None, :i] @ X[..., :i, :])[..., 0, :]
        X[..., i, :] = (B[..., i, :] - explained) / diagonal[..., i, None]
    return X


def whiten(L: Array, x: Array) -> Array:
    """``L^-1 x`` for lower triangular ``L (..., n, n)`` and vectors ``(..., n)``; a zero on the
    diagonal gives nan.
    """
    if L.ndim == 2:  # one matrix for all vectors
        return solve_lower(L, x.reshape(-1, x.shape[-1]).T).T.reshape(x.shape)
    return solve_lower(L, x[..., None])[..., 0]


def solve_right(L: Array, U: Array) -> Array:
    """Solve ``K @ L = U`` for lower triangular ``L (..., n, n)`` and ``U (..., k, n)``: the gain
    K from ``U = K @ L``.
    """
    # L' K' = U'; reversing rows and columns makes the upper triangular L' lower triangular.
    flipped = L[..., ::-1, ::-1].mT
    return solve_lower(flipped, U.mT[..., ::-1, :])[..., ::-1, :].mT


def solve_positive(S: Array, x: Array) -> Array:
    """``S^-1 x`` for symmetric ``S (..., m, m)``, as a rule positive definite, and vectors
    ``(..., m)``.
    """
    if S.ndim == 2 and x.ndim == 1 and not S.dtype.hasobject:
        _, solution, info = lapack.dposv(S, x, lower=1)
        if info == 0:
            return np.asanyarray(solution)
    return np.asanyarray(np.linalg.solve(S, x[..., None])[..., 0])


def _root(P: Array) -> Array | None:
    """Roots of positive definite matrices; None where one of them has none."""
    if P.ndim > 2:
        try:
            return np.linalg.cholesky(P)
        except np.linalg.LinAlgError:
            return None
    L, info = lapack.dpotrf(P, lower=1)
    # A nan anywhere leads to one in the last place.
    return L if info == 0 and (L.size == 0 or L[-1, -1] > 0.0) else None


def _scaled(P: Array) -> tuple[Array, Array]:
    """Scales ``(..., n)``, and P in units of them, so that kilometers and radians count alike; a
    matrix that is not finite becomes -I, which is indefinite.
    """
    diagonal = P.diagonal(0, -2, -1)
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    C = P / scale[..., None] / scale[..., None, :]
    return scale, np.where(np.isfinite(C).all((-2, -1), keepdims=True), C, -np.eye(P.shape[-1]))


def cholesky(P: Array) -> Array:
    """Lower root of positive definite ``P (..., n, n)``; nan for each matrix that is not positive
    definite.
    """
    if P.dtype.hasobject:
        return np.asanyarray(recorded.cholesky(P))
    root = _root(P)
    if root is not None or P.ndim == 2:
        return np.full(P.shape, np.nan) if root is None else root
    # LAPACK rejects the whole batch: find the matrices without a root, and factor the others.
    bad = np.linalg.eigvalsh(_scaled(P)[1])[..., :1, None] <= 4 * P.shape[-1] * EPS
    return np.where(bad, np.nan, np.linalg.cholesky(np.where(bad, np.eye(P.shape[-1]), P)))


def semidefinite_root(P: Array, round_off: float = 64 * EPS) -> Array:
    """Lower root of a covariance ``P (..., n, n)`` that may be singular; nan where it is indefinite
    beyond ``n * round_off``.
    """
    if P.dtype.hasobject:
        return np.asanyarray(
            recorded.semidefinite_root(P, 64 * P.shape[-1] * EPS, round_off * P.shape[-1])
        )
    root, least = _root(P), 1e-5
    # Below ``least`` a singular matrix may have passed because of a rounding error.
    if root is not None:
        std = np.sqrt(P.diagonal(0, -2, -1))
        if (root.diagonal(0, -2, -1) > least * std).all():
            return root
    # With D the standard deviations: C = D^-1 P D^-1 = V lambda V', L = tria(D V sqrt(lambda)).
    scale, C = _scaled(P)
    eigenvalues, vectors = np.linalg.eigh(C)
    nothing = 4 * C.shape[-1] * EPS  # the round-off that a variance of zero leaves
    indefinite = eigenvalues[..., 0] < -round_off * C.shape[-1] * np.maximum(
        eigenvalues[..., -1], 1.0
    )
    clipped = np.where(eigenvalues > nothing, eigenvalues, 0.0)
    root = tria(scale[..., None] * vectors * np.sqrt(clipped)[..., None, :])
    singular = eigenvalues[..., :1, None] <= nothing
    if not singular.all():  # the other matrices get the root that they would get alone
        root = np.where(
            singular, root, np.linalg.cholesky(np.where(singular, np.eye(C.shape[-1]), P))
        )
    return np.where(indefinite[..., None, None], np.nan, root)


def downdate(L: Array, V: Array) -> Array:
    """Lower root ``(..., n, n)`` of ``L @ L.mT - V @ V.mT``, for all columns of ``V (..., n, k)``
    at once; nan exactly where this difference is indefinite.

    L may be singular if the columns of V lie in its range.
    """
    # L L' - V V' = L (I - W W') L' with L W = V.
    W = solve_lower(L, V)
    root: Array = L @ cholesky(np.eye(L.shape[-1]) - outer(W))
    lost = np.isnan(root[..., 0, 0])
    if root.dtype.hasobject or not lost.any():
        return root
    # For a singular L, L W = V has many solutions. The shortest one decides, but substitution does
    # not find it: use the pseudoinverse from L = U s Q', in units of the row norms of L.
    lost = np.asanyarray(lost & np.isfinite(L).all((-2, -1)) & np.isfinite(V).all((-2, -1)))[
        ..., None, None
    ]
    size = np.sqrt(np.vecdot(L, L))[..., None]
    size = np.where(size > 0.0, size, 1.0)
    safe, wanted = np.where(lost, L, 0.0) / size, np.where(lost, V, 0.0) / size
    U, s, Qt = np.linalg.svd(safe)
    significant = s > NEGLIGIBLE * s[..., :1]
    W = Qt.mT @ (
        np.where(significant, 1.0 / np.where(significant, s, 1.0), 0.0)[..., None] * (U.mT @ wanted)
    )
    # V has a part outside the range of L: the difference is indefinite.
    outside = np.asanyarray(
        (np.abs(wanted - safe @ W) > NEGLIGIBLE * np.maximum(1.0, np.abs(wanted))).any((-2, -1))
    )
    again = np.where(outside[..., None, None], np.nan, L @ cholesky(np.eye(L.shape[-1]) - outer(W)))
    return np.where(lost, again, root)


def block(rows: Sequence[Sequence[Any]]) -> Array:
    """Block matrix of matrices ``(..., k, q)`` whose batch axes broadcast; the integer ``0`` means
    a block of zeros.
    """
    heights, widths = [0] * len(rows), [0] * len(rows[0])
    batches, like = set(), np.empty(0)
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            if type(cell) is not int:
                heights[i], widths[j] = cell.shape[-2:]
                batches.add(cell.shape[:-2])
                if cell.dtype.hasobject:
                    like = traced(cell)
    batch = batches.pop() if len(batches) == 1 else np.broadcast_shapes(*batches)
    out = np.zeros((*batch, sum(heights), sum(widths)), like=like)
    for row, height, bottom in zip(rows, heights, accumulate(heights), strict=True):
        for cell, width, right in zip(row, widths, accumulate(widths), strict=True):
            if type(cell) is not int:
                out[..., bottom - height : bottom, right - width : right] = cell
    return out


def sigma_deviations(E: Array, nodes: Array, batch: int) -> Array:
    """``E @ node`` for every node: points ``(p, ..., n)`` from ``E (..., n, k)`` and
    ``nodes (k, p)``, with ``batch`` axes of runs.

    Components come first in memory, the fast order for models. The runs share n matrix products;
    there is no product per run.
    """
    axes = E.ndim - 2
    if not axes:
        points = (E @ nodes).T
        return points.reshape(len(points), *(1,) * batch, points.shape[-1]) if batch else points
    # (n, ..., k) @ (k, p) -> (n, ..., p), then a view (p, ..., n).
    D = E.transpose((axes, *range(axes), axes + 1)) @ nodes
    points = D.transpose((axes + 1, *range(1, axes + 1), 0))
    return (
        points
        if axes >= batch
        else points.reshape(len(points), *(1,) * (batch - axes), *points.shape[1:])
    )


# -- forms -----------------------------------------------------------------------------------------
class SquareRoot(NamedTuple):
    """A belief in square-root form: ``mean (..., N)`` and a lower root ``sqrt_cov (..., n, n)``.

    The root changes by QR factorizations only. Columns of negative sign are subtracted by one block
    downdate.
    """

    mean: Array
    sqrt_cov: Array

    @property
    def cov(self) -> Array:
        """Covariance ``(..., n, n)``."""
        return outer(self.sqrt_cov)

    @property
    def std(self) -> Array:
        """Standard deviations ``(..., n)``."""
        return np.asanyarray(np.sqrt(np.vecdot(self.sqrt_cov, self.sqrt_cov)))

    @classmethod
    def of(cls, belief: Any) -> Self:
        """Convert any Gaussian to this form."""
        return cls(belief.mean, belief.sqrt_cov)

    @staticmethod
    def rounding() -> float:
        """Fraction of a standard deviation that is round-off."""
        return EPS

    @staticmethod
    def marginal(A: Array, sign: Array) -> Array:
        """Root of the covariance ``A @ diag(sign) @ A.mT`` of the columns ``A (..., n, q)``."""
        if len(sign) == 1:
            return tria(A)
        return downdate(tria(A[..., sign > 0.0]), A[..., sign < 0.0])

    @classmethod
    def condition(
        cls, A: Array, sign: Array, m: int, gain: Array | None = None, **_shortcut: Array | None
    ) -> tuple[Array, Array, Array]:
        """Condition the last rows of ``A (..., m + n, q)`` on the first ``m``.

        Returns the root ``S (..., m, m)`` of the first rows, ``U = K @ S (..., n, m)`` and the root
        ``(..., n, n)`` of the last rows given the first. With a prescribed ``gain`` K
        ``(..., n, m)`` this last root is the root of ``last - K @ first`` (Joseph form). The
        covariance form has a shortcut with ``prior_factor``, the covariance of the last rows, and
        ``noise (..., m, s)``, the columns that are zero in the last rows.
        """
        if gain is not None:
            S = cls.marginal(A[..., :m, :], sign)
            return S, gain @ S, cls.marginal(A[..., m:, :] - gain @ A[..., :m, :], sign)
        # L = [[S, 0], [U, root of the rest]]
        L = cls.marginal(A, sign)
        return L[..., :m, :m], L[..., m:, :m], L[..., m:, m:]

    @staticmethod
    def transported(matrix: Array, root: Array) -> Array:
        """Root of ``matrix @ P @ matrix.mT``, with ``matrix (..., n, n)``."""
        return tria(matrix @ root)

    @staticmethod
    def sum(root: Array, columns: Array) -> Array:
        """Root of ``P + columns @ columns.mT``, with ``columns (..., n, q)``."""
        return tria(block([[root, columns]]))

    @staticmethod
    def mixed(roots: Sequence[Array], weights: Array, columns: Array) -> Array:
        """Root of the covariance of a mixture: the sum of k covariances times their
        ``weights (..., k)``, plus ``columns @ columns.mT`` from the differences of the means,
        ``columns (..., n, k)``.
        """
        scale = np.sqrt(weights)[..., None, None, :]
        return tria(block([[*(root * scale[..., i] for i, root in enumerate(roots)), columns]]))

    def lost(self) -> Array:
        """Runs ``(...)`` that have failed: an entry is not finite."""
        return np.asanyarray(
            ~(np.isfinite(self.mean).all(-1) & np.isfinite(self.sqrt_cov).all((-2, -1)))
        )


class Covariance(NamedTuple):
    """A belief in covariance form: ``mean (..., N)`` and ``cov (..., n, n)``. `SquareRoot`
    documents the methods, whose ``sqrt_cov`` or root becomes the covariance here.

    It needs fewer operations than the square-root form, and loses half of the digits. Only the
    innovation covariance is factored. The state's covariance is factored too if a rule needs its
    root, or if a measurement is precise.
    """

    mean: Array
    cov: Array

    @property
    def sqrt_cov(self) -> Array:
        """Lower root ``(..., n, n)`` of the covariance."""
        return semidefinite_root(self.cov, LEFT_OVER)

    @property
    def std(self) -> Array:
        """Standard deviations ``(..., n)``; nan where a variance is negative."""
        variances = self.cov.diagonal(0, -2, -1)
        if is_concretely_true(variances.min(initial=0.0) >= 0.0):
            return np.asanyarray(np.sqrt(variances))
        return np.asanyarray(
            np.sqrt(
                np.where(variances < 0.0, np.where(_negligible(variances), 0.0, np.nan), variances)
            )
        )

    @classmethod
    def of(cls, belief: Any) -> Self:
        return cls(belief.mean, belief.cov)

    @staticmethod
    def rounding() -> float:
        return float(EPS**0.5)

    @staticmethod
    def marginal(A: Array, sign: Array) -> Array:
        return outer(A) if len(sign) == 1 else np.asanyarray((A * sign) @ A.mT)

    @classmethod
    def condition(
        cls,
        A: Array,
        sign: Array,
        m: int,
        gain: Array | None = None,
        *,
        prior_factor: Array | None = None,
        noise: Array | None = None,
    ) -> tuple[Array, Array, Array]:
        # U = K S = P_xz S^-T, and the rest is P - U U'.
        Z, X = A[..., :m, :], A[..., m:, :]  # (..., m, q), (..., n, q)
        S = cholesky(cls.marginal(Z, sign))
        if gain is not None:
            return S, gain @ S, cls.marginal(X - gain @ Z, sign)
        if prior_factor is None or noise is None:
            return S, *cls._condition_columns(A, sign, S)
        U = solve_lower(S, (Z * sign) @ X.mT).mT
        left = prior_factor - outer(U)
        # Where the state's uncertainty dominates the noise, P - U U' loses too many digits.
        precise = S.diagonal(0, -2, -1) > PRECISE * np.sqrt(np.vecdot(noise, noise))
        if not is_concretely_true(~precise.any()):
            U, left = rarely(precise.any(-1), cls._condition_columns, (A, sign, S), (U, left))
        return S, U, left

    @classmethod
    def _condition_columns(cls, A: Array, sign: Array, S: Array) -> tuple[Array, Array]:
        """``U = K @ S (..., n, m)`` and the conditional covariance ``(..., n, n)`` of the last
        rows, from the innovation root ``S (..., m, m)``.

        It subtracts columns; a difference of covariances would lose half of the digits.
        """
        # W = S^-1 Z (..., m, q), so W sign W' = I; U = X sign W'; the rest has columns X - U W.
        m = S.shape[-1]
        Z, X = A[..., :m, :], A[..., m:, :]
        W = solve_lower(S, Z)
        U = X @ (W * sign).mT
        return U, cls.marginal(X - U @ W, sign)

    @staticmethod
    def transported(matrix: Array, cov: Array) -> Array:
        return np.asanyarray(matrix @ cov @ matrix.mT)

    @staticmethod
    def sum(cov: Array, columns: Array) -> Array:
        return np.asanyarray(cov + outer(columns))

    @staticmethod
    def mixed(covs: Sequence[Array], weights: Array, columns: Array) -> Array:
        scale = weights[..., None, None, :]
        return np.asanyarray(
            sum([cov * scale[..., i] for i, cov in enumerate(covs)], outer(columns))
        )

    def lost(self) -> Array:
        """Runs ``(...)`` that have failed: an entry is not finite, or a variance is negative beyond
        the round-off of the largest variance.
        """
        finite = np.isfinite(self.mean).all(-1) & np.isfinite(self.cov).all((-2, -1))
        return np.asanyarray(~(finite & _negligible(self.cov.diagonal(0, -2, -1)).all(-1)))


def _negligible(variances: Array) -> Array:
    """Mask of the variances ``(..., n)`` that are at least zero, up to round-off."""
    return np.asanyarray(
        variances >= -NEGLIGIBLE * np.abs(variances).max(-1, keepdims=True, initial=0.0)
    )


Belief = SquareRoot | Covariance
Form = type[SquareRoot] | type[Covariance]
FORMS: dict[str, Form] = {"square root": SquareRoot, "covariance": Covariance}
