"""Batched kernels for small matrices: triangular roots, substitution, downdates.

Every function accepts leading batch axes (a Monte-Carlo block of runs) and treats the last two as a matrix. Roots are *lower*
triangular with a non-negative diagonal, ``P = L @ L.mT``; "columns" means any ``(..., n, q)`` array ``A`` that stands for
``P = A @ A.mT``. A matrix of a batch that has no root becomes nan, its neighbors are untouched. `tria`, `cholesky` and
`solve_lower` carry nearly all of the arithmetic of a filter: they are the seam for a compiled kernel. A single matrix goes to
LAPACK directly, since numpy's batched functions spend most of a small one's time on preparations.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

Array = NDArray[Any]

EPS = float(np.finfo(np.float64).eps)
NEGLIGIBLE = 1e-12
"""Part of a deviation below which a direction of a singular root is round-off."""


def matvec(A: Array, x: Array) -> Array:
    """Product of matrices ``(..., n, m)`` and vectors ``(..., m)``, shape ``(..., n)``."""
    product: Array = (A @ x[..., None])[..., 0]
    return product


def leading(x: Array) -> Array:
    """``(..., n)`` with the component axis first, as a view; numpy's ``moveaxis`` takes longer than a product of small matrices."""
    last = x.ndim - 1
    return x.transpose((last, *range(last)))


def components(x: Array) -> Array:
    """`leading`, with each component in one piece of memory (in any order): models are fast on those.

    Sigma points lie so already; what does not is copied.
    """
    first = leading(x)
    part = first[0].flags
    return first if part.c_contiguous or part.f_contiguous else np.ascontiguousarray(first)


def outer(A: Array) -> Array:
    """``A @ A.mT``, the covariance of columns ``(..., n, q)``; symmetric to rounding.

    Of a matrix and its own transpose numpy makes one triangle and copies it, which for many small ones takes twice the time.
    """
    product: Array = A @ (A.mT if A.ndim == 2 else A.mT.copy())
    return product


def side_by_side(parts: Sequence[Array]) -> Array:
    """Arrays ``(..., k)`` joined along their last axis; their batch axes broadcast."""
    batch = parts[0].shape[:-1]
    if any(part.shape[:-1] != batch for part in parts):
        batch = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
        parts = [np.broadcast_to(part, (*batch, part.shape[-1])) for part in parts]
    return np.concatenate(parts, -1)


def tria(A: Array) -> Array:
    """Lower root ``L (..., n, n)``, diagonal >= 0, of the columns ``A (..., n, q)``: ``L @ L.mT == A @ A.mT``, by QR.

    No product ``A @ A.mT`` is formed, so half of the digits that a Cholesky factorization would lose are kept.
    """
    n, q = A.shape[-2:]
    if q < n:
        A = np.concatenate([A, np.zeros((*A.shape[:-1], n - q))], -1)
    L: Array
    if A.ndim == 2:
        L = lapack.dgeqrfp(A.T)[0][:n].T  # its diagonal is not negative
        return L * _lower(n)
    # "raw" leaves R' in the lower triangle and Householder vectors above it.
    L = np.linalg.qr(A.mT, mode="raw")[0][..., :n]
    # In C order whatever the order of A: products with L then take the same path for every number of runs.
    L = np.multiply(L, np.copysign(1.0, L.diagonal(0, -2, -1))[..., None, :], order="C")
    L *= _lower(n)
    return L


@cache
def _lower(n: int) -> Array:
    return np.tri(n)


@cache
def _identity(n: int) -> Array:
    return np.eye(n)


def solve_lower(L: Array, B: Array) -> Array:
    """Solve ``L @ X = B`` for lower triangular ``L (..., n, n)`` and ``B (..., n, k)``; a zero on the diagonal gives nan."""
    diagonal = L.diagonal(0, -2, -1)
    if L.ndim == B.ndim == 2 and 0.0 not in diagonal.tolist():
        solution: Array = blas.dtrsm(1.0, L, B, lower=1)  # LAPACK's dtrtrs would start threads, however small the matrix
        return solution
    if not diagonal.all():
        diagonal = np.where(diagonal == 0.0, np.nan, diagonal)
    batch = np.broadcast_shapes(L.shape[:-2], B.shape[:-2])
    X = np.empty(batch + B.shape[-2:])
    for i in range(L.shape[-1]):
        row = B[..., i, :]
        if i:
            row = row - (L[..., i, None, :i] @ X[..., :i, :])[..., 0, :]
        X[..., i, :] = row / diagonal[..., i, None]
    return X


def whiten(L: Array, x: Array) -> Array:
    """``L^-1 x`` for lower triangular ``L (..., n, n)`` and vectors ``(..., n)``; a zero on the diagonal gives nan."""
    if L.ndim == 2 and x.ndim == 1:
        return solve_lower(L, x[:, None])[:, 0]
    # By rows, for which products of matrices take twice the time.
    white = np.empty(np.broadcast_shapes(x.shape, L.shape[:-1]))
    diagonal = L.diagonal(0, -2, -1)
    if not diagonal.all():
        diagonal = np.where(diagonal == 0.0, np.nan, diagonal)
    for i in range(x.shape[-1]):
        rest = x[..., i] - np.vecdot(L[..., i, :i], white[..., :i]) if i else x[..., i]
        white[..., i] = rest / diagonal[..., i]
    return white


def solve_upper_transposed(L: Array, B: Array) -> Array:
    """Solve ``L.mT @ X = B`` for lower triangular ``L (..., n, n)`` and ``B (..., n, k)``."""
    flipped = L[..., ::-1, ::-1].mT
    return solve_lower(flipped, B[..., ::-1, :])[..., ::-1, :]


def _scaled(P: Array) -> tuple[Array, Array]:
    """Scales ``(..., n)`` and ``P`` in units of them: kilometers and radians in one matrix then weigh alike."""
    diagonal = P.diagonal(0, -2, -1)
    if P.ndim > 2 or not min(diagonal.tolist(), default=1.0) > 0.0:
        diagonal = np.where(diagonal > 0.0, diagonal, 1.0)
    scale = np.sqrt(diagonal)
    C = P / scale[..., None]
    C /= scale if P.ndim == 2 else scale[..., None, :]
    return scale, C


def _single(C: Array) -> Array | None:
    """Root of one matrix, by LAPACK itself; None where it has none."""
    L, info = lapack.dpotrf(C, lower=1)
    return L if info == 0 and (L.size == 0 or L[-1, -1] > 0.0) else None  # a nan anywhere leads to one in the last place


def cholesky(P: Array) -> Array:
    """Lower root of positive definite ``P (..., n, n)``; nan for each matrix that is not positive definite."""
    scale, C = _scaled(P)
    if P.ndim == 2:
        root = _single(C)
        return np.full(P.shape, np.nan) if root is None else scale[:, None] * root
    try:
        L = np.linalg.cholesky(C)
    except np.linalg.LinAlgError:  # numpy gives up on the whole block: find the culprits, keep the rest
        eye = np.eye(C.shape[-1])
        finite = np.asarray(np.isfinite(C).all((-2, -1)))[..., None, None]
        smallest = np.linalg.eigvalsh(np.where(finite, C, -eye))[..., :1, None]
        bad = smallest <= 4 * len(eye) * EPS
        L = np.where(bad, np.nan, np.linalg.cholesky(np.where(bad, eye, C)))
    return scale[..., None] * L


def semidefinite_root(P: Array) -> Array:
    """Lower root of a covariance ``P (..., n, n)`` that may be singular; nan where it is indefinite beyond round-off."""
    scale, C = _scaled(P)
    least = 1e-5  # below, a singular matrix may have slipped through on a rounding error
    if P.ndim == 2 and (one := _single(C)) is not None and min(one.diagonal().tolist(), default=1.0) > least:
        return scale[:, None] * one
    nothing = 4 * C.shape[-1] * EPS  # what is left of a variance that is none
    try:
        L = np.linalg.cholesky(C)
        if L.diagonal(0, -2, -1).min(initial=1.0) > least:
            return scale[..., None] * L
    except np.linalg.LinAlgError:
        pass
    finite = np.asarray(np.isfinite(C).all((-2, -1)))
    eigenvalues, vectors = np.linalg.eigh(np.where(finite[..., None, None], C, -np.eye(C.shape[-1])))
    indefinite = eigenvalues[..., 0] < -64 * C.shape[-1] * EPS * np.maximum(eigenvalues[..., -1], 1.0)
    kept = np.where(eigenvalues > nothing, eigenvalues, 0.0)
    root = tria(scale[..., None] * vectors * np.sqrt(kept)[..., None, :])
    singular = eigenvalues[..., :1, None] <= nothing
    if not singular.all():  # the neighbors get what they would get alone
        root = np.where(singular, root, scale[..., None] * np.linalg.cholesky(np.where(singular, np.eye(C.shape[-1]), C)))
    return np.where(indefinite[..., None, None], np.nan, root)


def range_basis(A: Array, least: float) -> Array:
    """Orthonormal columns ``(..., m, n)`` that span the range of tall matrices ``(..., m, n)``: ``Q @ Q.mT`` projects on it.

    Directions in which A is not larger than ``least`` (a singular value) have a column of zeros; what is not finite gives nan.
    """
    Q, R = np.linalg.qr(A)
    # Far from dependence QR will do. Near it a column without a direction of its own would lend an arbitrary one to the others.
    lost = np.asarray(~np.isfinite(A).all((-2, -1)))
    clear = lost | (np.abs(R.diagonal(0, -2, -1)).min(-1) > 1e3 * least)
    if clear.all():
        return np.asarray(Q)
    U, s, _ = np.linalg.svd(np.where(lost[..., None, None], 0.0, A), full_matrices=False)
    return np.where(clear[..., None, None], Q, np.where(s[..., None, :] > least, U, 0.0))


def downdate(L: Array, V: Array) -> Array:
    """Lower root of ``L @ L.mT - V @ V.mT``, all columns of ``V (..., n, k)`` at once; nan exactly where that is indefinite.

    L may be singular where V adds nothing to its range.
    """
    W = solve_lower(L, V)
    rest = _identity(L.shape[-1]) - outer(W)
    if rest.ndim == 2 and (one := _single(rest)) is not None:
        return np.asarray(L @ one)
    root: Array = L @ cholesky(rest)
    lost = np.isnan(root[..., 0, 0])
    if not lost.any():
        return root
    # Of what solves L W = V for a singular L the shortest decides, which substitution does not find.
    lost = np.asarray(lost & np.isfinite(L).all((-2, -1)) & np.isfinite(V).all((-2, -1)))[..., None, None]
    size = np.sqrt(np.vecdot(L, L))[..., None]
    size = np.where(size > 0.0, size, 1.0)
    safe, wanted = np.where(lost, L, 0.0) / size, np.where(lost, V, 0.0) / size
    U, s, Qt = np.linalg.svd(safe)
    kept = s > NEGLIGIBLE * s[..., :1]
    W = Qt.mT @ (np.where(kept, 1.0 / np.where(kept, s, 1.0), 0.0)[..., None] * (U.mT @ wanted))
    outside = np.asarray((np.abs(wanted - safe @ W) > NEGLIGIBLE * np.maximum(1.0, np.abs(wanted))).any((-2, -1)))
    again = np.where(outside[..., None, None], np.nan, L @ cholesky(np.eye(L.shape[-1]) - outer(W)))
    return np.where(lost, again, root)


def block(rows: Sequence[Sequence[Any]]) -> Array:
    """Block matrix of matrices ``(..., k, q)`` whose batch axes broadcast; a plain ``0`` is a block of zeros that fits."""
    heights, widths, batch = [0] * len(rows), [0] * len(rows[0]), None
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            if type(cell) is not int:
                shape = cell.shape
                heights[i], widths[j] = shape[-2:]
                if batch is None:
                    batch = shape[:-2]
                elif shape[:-2] != batch:
                    batch = np.broadcast_shapes(batch, shape[:-2])
    assert batch is not None
    out = np.zeros((*batch, sum(heights), sum(widths)))
    top = 0
    for row, height in zip(rows, heights, strict=True):
        left = 0
        for cell, width in zip(row, widths, strict=True):
            if type(cell) is not int:
                out[..., top : top + height, left : left + width] = cell
            left += width
        top += height
    return out


def fan(E: Array, nodes: Array, batch: int) -> Array:
    """``E @ node`` of every node: points ``(p, ..., n)`` from ``E (..., n, k)`` and ``nodes (k, p)``, for ``batch`` axes of runs.

    Components lie first in memory, which models are fast on, and all runs take part in n products, not each in one of its own.
    """
    axes = E.ndim - 2
    if not axes:
        points = (E @ nodes).T
        return points.reshape(len(points), *(1,) * batch, points.shape[-1]) if batch else points
    D = E.transpose((axes, *range(axes), axes + 1)) @ nodes
    points = D.transpose((axes + 1, *range(1, axes + 1), 0))
    return points if axes >= batch else points.reshape(len(points), *(1,) * (batch - axes), *points.shape[1:])
