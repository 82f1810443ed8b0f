"""Beliefs: a mean and its spread, in square-root or covariance form.

A filter is written once; the *form* of its prior decides what it carries along: a lower root (QR, half the digits needed) or
a covariance (fewer operations). Make priors with `square_root` or `covariance`, which check what they are given.
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import (
    Array,
    block,
    cholesky,
    downdate,
    matvec,
    outer,
    semidefinite_root,
    solve_lower,
    tria,
    unit,
    whiten,
)

_NEGLIGIBLE = 1e-12
"""Part of the largest variance that a negative one may be, which has been 0."""
PRECISE = 1e3
"""Deviations of the noise by which an innovation may vary before a difference of covariances loses too many digits."""


class Form(Protocol):
    """What the spread of a belief is, and how columns ``A`` (covariance ``A @ A.mT``) condense into it."""

    name: str

    def root(self, spread: Array) -> Array:
        """Lower root of a spread."""

    def covariance(self, spread: Array) -> Array:
        """Covariance of a spread."""

    def std(self, spread: Array) -> Array:
        """Standard deviations ``(..., n)`` of a spread."""

    def marginal(self, A: Array, sign: Array) -> Array:
        """Spread of the columns ``A (..., n, q)``; column ``j`` counts with ``sign[j]``, those beyond ``sign`` with +1.

        In covariance form ``sign`` may be a covariance ``(..., k, k)`` that the first k columns count with.
        """

    def condition(
        self, A: Array, sign: Array, m: int, gain: Array | None = None, known: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array, Array]:
        """Condition the last rows of ``A (..., m + n, q)`` on the first ``m``.

        Returns the root ``S (..., m, m)`` of the first rows, ``U = K @ S (..., n, m)`` and the spread of the rest. With a
        prescribed ``gain`` K ``(..., n, m)`` the spread is that of ``rest - K @ first`` (Joseph form). ``known``: the spread of
        the last rows, if it is at hand, and deviations ``(..., m)`` of the first beyond which nothing is taken off it (`PRECISE`).
        """

    def sum(self, spread: Array, columns: Array) -> Array:
        """Spread of the sum of two independent parts, one of them given by its columns."""


class SquareRootForm:
    """The spread is a lower root. Columns of negative sign are taken away by one block downdate."""

    name = "square root"

    def __reduce__(self) -> str:
        return "SQUARE_ROOT"  # a copy is the form itself

    def root(self, spread: Array) -> Array:
        return spread

    def covariance(self, spread: Array) -> Array:
        return outer(spread)

    def std(self, spread: Array) -> Array:
        std: Array = np.sqrt(np.vecdot(spread, spread))
        return std

    def marginal(self, A: Array, sign: Array) -> Array:
        negative = _negative(sign, A.shape[-1])
        return tria(A) if negative is None else downdate(tria(A[..., ~negative]), A[..., negative])

    def condition(
        self,
        A: Array,
        sign: Array,
        m: int,
        gain: Array | None = None,
        known: tuple[Array, Array] | None = None,  # noqa: ARG002
    ) -> tuple[Array, Array, Array]:
        if gain is not None:
            S = self.marginal(A[..., :m, :], sign)
            return S, gain @ S, self.marginal(A[..., m:, :] - gain @ A[..., :m, :], sign)
        L = self.marginal(A, sign)
        return L[..., :m, :m], L[..., m:, :m], L[..., m:, m:]

    def sum(self, spread: Array, columns: Array) -> Array:
        return tria(block([[spread, columns]]))


class CovarianceForm:
    """The spread is a covariance; only the innovation covariance is factored, and the prior's where measurements are precise."""

    name = "covariance"

    def __reduce__(self) -> str:
        return "COVARIANCE"

    def root(self, spread: Array) -> Array:
        return semidefinite_root(spread)

    def covariance(self, spread: Array) -> Array:
        return spread

    def std(self, spread: Array) -> Array:
        variances = spread.diagonal(0, -2, -1)
        if variances.min(initial=0.0) >= 0.0:
            return np.asarray(np.sqrt(variances))
        zero = (variances < 0.0) & _negligible(variances)
        return np.asarray(np.sqrt(np.where(zero, 0.0, np.where(variances < 0.0, np.nan, variances))))

    def marginal(self, A: Array, sign: Array) -> Array:
        P: Array = _counted(A, sign) @ A.mT
        # Of a covariance between columns the product is symmetric to rounding only, which modes that grow would make grow.
        return 0.5 * (P + P.mT) if sign.ndim > 1 else P

    def condition(
        self, A: Array, sign: Array, m: int, gain: Array | None = None, known: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array, Array]:
        if gain is None and known is not None:
            spread, most = known
            C = _counted(A[..., :m, :], sign) @ A.mT
            S = cholesky(C[..., :m])
            U = solve_lower(S, C[..., m:]).mT
            left = spread - outer(U)
            precise = S.diagonal(0, -2, -1) > most
            if not precise.any():
                return S, U, left
            again, chosen = self.condition(A, sign, m), np.asarray(precise.any(-1))[..., None, None]
            return np.where(chosen, again[0], S), np.where(chosen, again[1], U), np.where(chosen, again[2], left)
        if sign.ndim > 1:
            k = sign.shape[-1]
            A, sign = np.concatenate([A[..., :k] @ semidefinite_root(sign), A[..., k:]], -1), np.ones(1)
        Z, X = A[..., :m, :], A[..., m:, :]
        S = cholesky(_counted(Z, sign) @ Z.mT)
        if gain is not None:
            return S, gain @ S, self.marginal(X - gain @ Z, sign)
        # What the first rows explain is taken off the columns: of variances, a difference would have half the digits.
        W = solve_lower(S, Z)
        U = X @ _counted(W, sign).mT
        return S, U, self.marginal(X - U @ W, sign)

    def sum(self, spread: Array, columns: Array) -> Array:
        return np.asarray(spread + outer(columns))


def _counted(A: Array, sign: Array) -> Array:
    """Columns times what they count with."""
    if sign.ndim > 1:
        k = sign.shape[-1]
        weighed = A[..., :k] @ sign
        return weighed if k == A.shape[-1] else np.concatenate([weighed, A[..., k:]], -1)
    negative = _negative(sign, A.shape[-1])
    return A if negative is None else A * np.where(negative, -1.0, 1.0)


def _negative(sign: Array, q: int) -> Array | None:
    """Mask ``(q,)`` of the columns of negative sign, or None if there are none."""
    if -1.0 not in sign.tolist():
        return None
    negative = sign < 0.0
    return np.concatenate([negative, np.zeros(q - len(sign), bool)])


SQUARE_ROOT: Form = SquareRootForm()
COVARIANCE: Form = CovarianceForm()


class Gaussian(NamedTuple):
    """A Gaussian belief: ``mean (..., N)``, ``spread (..., n, n)`` and the form that says what the spread is, root or covariance.

    Nothing is checked here: make one with `square_root` or `covariance`.
    """

    mean: Array
    spread: Array
    form: Form

    @property
    def root(self) -> Array:
        """Lower root of the covariance, ``(..., n, n)``."""
        return self.form.root(self.spread)

    @property
    def columns(self) -> tuple[Array, Array]:
        """Columns that need no factoring, and the ``sign`` that `Form` takes for them: a root, or unit columns and a covariance."""
        if self.form.name == "covariance":
            return unit(self.spread.shape[-1]), self.spread
        return self.spread, np.ones(1)

    @property
    def cov(self) -> Array:
        """Covariance, ``(..., n, n)``."""
        return self.form.covariance(self.spread)

    @property
    def std(self) -> Array:
        """Standard deviations, ``(..., n)``."""
        return self.form.std(self.spread)

    def broadcast_to(self, batch: tuple[int, ...]) -> Gaussian:
        """The same belief for each run of a batch; its own batch axes must broadcast to it."""
        n = self.spread.shape[-1]
        mean, spread = np.broadcast_to(self.mean, (*batch, self.mean.shape[-1])), np.broadcast_to(self.spread, (*batch, n, n))
        return Gaussian(mean, spread, self.form)

    def sample(self, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Array:
        """Draw vectors ``size + (..., n)``. On curved spaces they are tangents at the mean, which is then not added."""
        n = self.spread.shape[-1]
        draw = matvec(self.root, rng.standard_normal((*size, *self.spread.shape[:-2], n)))
        return draw + self.mean if self.mean.shape[-1] == n else draw


def square_root(mean: ArrayLike, cov: ArrayLike | None = None, *, root: ArrayLike | None = None) -> Gaussian:
    """Belief in square-root form from a covariance (which may be singular) or from a lower root.

    Raises
    ------
    ValueError: if a shape is wrong, a number not finite, ``cov`` not symmetric positive semidefinite, or ``root`` not lower
        triangular.
    """
    x = finite("mean", mean)
    if (cov is None) == (root is None):
        raise ValueError("square_root: expected exactly one of cov and root")
    spread = sqrt_cov(cov, "cov") if cov is not None else finite("root", root)
    if np.triu(spread, 1).any():
        raise ValueError("root: expected a lower triangular matrix (`celnav.gaussian.linalg.tria` makes one of any root)")
    return _prior(x, spread, SQUARE_ROOT)


def covariance(mean: ArrayLike, cov: ArrayLike) -> Gaussian:
    """Belief in covariance form; `square_root` says what is checked."""
    x = finite("mean", mean)
    return _prior(x, symmetric(cov, "cov")[0], COVARIANCE)


def _prior(mean: Array, spread: Array, form: Form) -> Gaussian:
    if mean.ndim == 0:
        raise ValueError("mean: expected shape (..., n), got a scalar")
    if spread.ndim < 2 or spread.shape[-1] != spread.shape[-2]:
        raise ValueError(f"spread: expected shape (..., n, n), got {spread.shape}")
    if spread.shape[-1] > mean.shape[-1]:
        raise ValueError(f"mean: expected shape (..., {spread.shape[-1]}) to go with the covariance, got {mean.shape}")
    try:
        batch = np.broadcast_shapes(mean.shape[:-1], spread.shape[:-2])
    except ValueError:
        raise ValueError(
            f"mean: batch axes {mean.shape[:-1]} do not go with those of the covariance, {spread.shape[:-2]}"
        ) from None
    return Gaussian(mean, spread, form).broadcast_to(batch)


def all_sound(belief: Gaussian) -> bool:
    """Whether all runs are `sound`, most often decided without looking at each."""
    plain = isfinite(np.add.reduce(belief.mean, None) + np.add.reduce(belief.spread, None))  # what overflows is seen below
    if plain and (belief.form.name != "covariance" or belief.spread.diagonal(0, -2, -1).min(initial=0.0) >= 0.0):
        return True
    return bool(sound(belief).all())


def sound(belief: Gaussian) -> Array:
    """``(...)`` whether a run is finite and has no negative variance, beyond round-off of the matrix's largest correlation."""
    finite = np.isfinite(belief.mean).all(-1) & np.isfinite(belief.spread).all((-2, -1))
    if belief.form.name != "covariance":
        return np.asarray(finite)
    variances = belief.spread.diagonal(0, -2, -1)
    return np.asarray(finite & _negligible(variances).all(-1))


def _negligible(variances: Array) -> Array:
    """Which variances are not negative, or no more than by round-off."""
    return np.asarray(variances >= -_NEGLIGIBLE * np.abs(variances).max(-1, keepdims=True, initial=0.0))


def symmetric(cov: ArrayLike, name: str, n: int | None = None) -> tuple[Array, Array]:
    """Checked covariance, symmetrized at round-off, and its lower root.

    Raises
    ------
    ValueError: naming ``name``, if it is not finite, not ``(..., n, n)``, not symmetric or not positive semidefinite.
    """
    P = finite(name, cov)
    expected = "symmetric positive semidefinite" + (f" ({n}, {n})" if n is not None else "")
    if P.ndim < 2 or P.shape[-1] != P.shape[-2] or (n is not None and P.shape[-1] != n):
        alone = f"; [[{P:g}]] of one component, {P:g} * np.eye(n) of n alike" if P.ndim == 0 else ""
        hint = alone or ("; variances alone are np.diag(...)" if P.ndim == 1 else "")
        raise ValueError(f"{name}: expected {expected}, got shape {P.shape}{hint}")
    scale = np.sqrt(np.abs(P.diagonal(0, -2, -1)))
    skew = np.abs(P - P.mT)
    if (skew > 1e-8 * scale[..., :, None] * scale[..., None, :] + 1e-300).any():
        raise ValueError(f"{name}: expected {expected}, got asymmetry {skew.max():.3g}")
    P = 0.5 * (P + P.mT)
    root = semidefinite_root(P)
    if not np.isfinite(root).all():
        raise ValueError(f"{name}: expected {expected}, smallest eigenvalue {np.linalg.eigvalsh(P).min():.3g}")
    return P, root


def sqrt_cov(cov: ArrayLike, name: str = "cov", n: int | None = None) -> Array:
    """Lower root of a covariance that may be singular.

    Raises
    ------
    ValueError: naming ``name``, if ``cov`` is not finite, not symmetric or not positive semidefinite.
    """
    return symmetric(cov, name, n)[1]


def nees(error: Array, root: Array) -> Array:
    """Normalized estimation error squared ``e' P^-1 e``, shape ``(...)``, from ``error (..., n)`` and a root of P."""
    white = whiten(root, error)
    return np.asarray(np.vecdot(white, white))
