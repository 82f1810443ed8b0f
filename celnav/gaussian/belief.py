"""Checked Gaussian beliefs (`Gaussian`), and checks of the covariances that a user passes."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import as_matrix, broadcast_batches, describe, finite, integers
from celnav.gaussian.linalg import (
    LEFT_OVER,
    Array,
    Belief,
    SquareRoot,
    matvec,
    outer,
    semidefinite_root,
    whiten,
)

__all__ = ["Gaussian", "nees"]


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A Gaussian, such as the prior of a filter.

    mean: ``(..., N)``; each run of a batch has its own mean.
    cov: covariance ``(..., n, n)``, which may be singular; a number means that multiple of the
        identity. One ``(n, n)`` may serve many means. If the filter's matrices are also the same
        for all runs, it propagates one covariance, until the runs miss different measurements.
    sqrt_cov: instead of ``cov``, its lower triangular root ``(..., n, n)``, or one standard
        deviation.

    On curved spaces the covariance may have fewer components than the mean (``n < N``). ValueError
    names the argument if the shapes do not match or if ``cov`` is not a covariance.

    >>> Gaussian([7000.0, 0.0], np.diag([1.0, 1e-4])).std
    array([1.  , 0.01])
    """

    mean: Array
    cov: Array
    sqrt_cov: Array = field(init=False, repr=False)

    def __init__(
        self, mean: ArrayLike, cov: ArrayLike | None = None, *, sqrt_cov: ArrayLike | None = None
    ):
        x = finite("mean", mean, (..., None))
        if (cov is None) == (sqrt_cov is None):
            got = "neither" if cov is None else "both"
            raise ValueError(f"Gaussian: expected exactly one of cov and sqrt_cov, got {got}")
        if cov is not None:
            P, root = symmetric(as_matrix("cov", cov, x.shape[-1]), "cov")
        else:
            root = as_matrix("sqrt_cov", sqrt_cov, x.shape[-1])
            root = finite("sqrt_cov", root, (..., "n", "n"))
            if np.triu(root, 1).any():
                raise ValueError(
                    "sqrt_cov: expected a lower triangular matrix, got entries above the diagonal; "
                    "celnav.gaussian.linalg.tria(root) is lower triangular"
                )
            P = outer(root)
        # n < N is possible (a quaternion has N = 4, n = 3); n > N is not.
        if P.shape[-1] > x.shape[-1]:
            raise ValueError(
                f"mean: expected shape (..., {P.shape[-1]}) to go with the covariance, got "
                f"{x.shape}"
            )
        broadcast_batches("mean", x.shape[:-1], P.shape[:-2], "the covariance")
        for name, value in (("mean", x), ("cov", P), ("sqrt_cov", root)):
            object.__setattr__(self, name, value)

    @property
    def std(self) -> Array:
        """Standard deviations ``(..., n)``."""
        return np.asarray(np.sqrt(self.cov.diagonal(0, -2, -1)))

    def sample(self, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Array:
        """Draw vectors ``(*size, ..., n)``. On curved spaces (``n < N``) they are tangents at the
        mean; the mean is not added.
        """
        if not hasattr(rng, "standard_normal"):
            raise ValueError(
                f"rng: expected a generator, such as np.random.default_rng(0), got {describe(rng)}"
            )
        n, size = self.cov.shape[-1], integers("size", size)
        batch = np.broadcast_shapes(self.mean.shape[:-1], self.cov.shape[:-2])
        draw = matvec(self.sqrt_cov, rng.standard_normal((*size, *batch, n)))
        return draw + self.mean if self.mean.shape[-1] == n else draw


def mask_failed(belief: Belief) -> Belief:
    """The belief, with nan in every entry of the runs that have failed (`lost`)."""
    if not belief[1].dtype.hasobject and not any_lost(belief):
        return belief
    lost = belief.lost()
    return type(belief)(
        np.where(lost[..., None], np.nan, belief.mean),
        np.where(lost[..., None, None], np.nan, belief[1]),
    )


def any_lost(belief: Belief) -> bool:
    """Whether any run has failed (`lost`); two sums usually decide, without a test of each run."""
    # A sum may overflow although no entry is infinite: the last line decides that case.
    plain = isfinite(np.add.reduce(belief[0], None) + np.add.reduce(belief[1], None))
    if plain and (
        isinstance(belief, SquareRoot)
        or np.minimum.reduce(belief.cov.diagonal(0, -2, -1), None, initial=0.0) >= 0.0
    ):
        return False
    return bool(belief.lost().any())


def symmetric(cov: ArrayLike, name: str, n: int | None = None) -> tuple[Array, Array]:
    """Check a covariance ``(..., n, n)``; return it, symmetrized at round-off, and its lower root.

    ValueError names the argument if it is not symmetric positive semidefinite.
    """
    P = finite(name, cov)
    expected = "symmetric positive semidefinite" + (f" ({n}, {n})" if n is not None else "")
    if P.ndim < 2 or P.shape[-1] != P.shape[-2] or (n is not None and P.shape[-1] != n):
        hint = "; pass np.diag(...) of variances" if P.ndim == 1 else ""
        if P.ndim == 0:
            hint = f"; pass [[{P:g}]] for one component, {P:g} * np.eye(n) for n"
        raise ValueError(f"{name}: expected {expected}, got shape {P.shape}{hint}")
    if P.dtype.hasobject:  # traced numbers are checked when the compiled step runs
        return P, semidefinite_root(P)
    scale = np.sqrt(np.abs(P.diagonal(0, -2, -1)))
    skew = np.abs(P - P.mT)
    # |P_ij - P_ji| is compared with sigma_i sigma_j, so that units do not matter.
    if (skew > 1e-8 * scale[..., :, None] * scale[..., None, :] + 1e-300).any():
        raise ValueError(f"{name}: expected {expected}, got asymmetry {skew.max():.3g}")
    P = 0.5 * (P + P.mT)
    # The covariance form of a filter leaves round-off of this size in its own results.
    root = semidefinite_root(P, LEFT_OVER)
    if not np.isfinite(root).all():
        raise ValueError(
            f"{name}: expected {expected}, got an eigenvalue {np.linalg.eigvalsh(P).min():.3g}"
        )
    return P, root


def nees(error: Array, root: Array) -> Array:
    """Normalized estimation error squared (NEES) ``e' P^-1 e``, shape ``(...)``.

    error: ``(..., n)``, estimate minus truth. root: lower root ``(..., n, n)`` of P.

    >>> value = celnav.gaussian.belief.nees(track.mean - truth, track.sqrt_cov)  # (T, ...)
    """
    white = whiten(root, error)
    return np.asanyarray(np.vecdot(white, white))
