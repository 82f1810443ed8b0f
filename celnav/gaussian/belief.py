"""Gaussians: what a user knows (`Gaussian`), and what a filter carries along (`SquareRoot` or `Covariance`, its *form*).

A form is a mean and its covariance, as a lower root or as it is, with the algebra that goes with it. Nobody else asks which one
a filter has: the joint of measurement and state comes as columns ``A`` (covariance ``A @ A.mT``), and the form condenses them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import finite, integers, kind
from celnav.gaussian.linalg import (
    EPS,
    Array,
    block,
    cholesky,
    downdate,
    matvec,
    outer,
    semidefinite_root,
    solve_lower,
    tria,
    whiten,
)

NEGLIGIBLE = 1e-12
"""Part of the largest variance that a negative one may be, which has been 0."""
PRECISE = 1e3
"""Deviations of the noise by which an innovation may vary before a difference of covariances loses too many digits."""


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A Gaussian that somebody knows: the prior of a filter, say. It is checked here, once.

    Parameters
    ----------
    mean: ``(..., N)``; a run of a batch has a mean of its own.
    cov: covariance ``(..., n, n)``, which may be singular. It may be one and the same for many means: a linear filter then
        carries one covariance for all its runs.
    sqrt_cov: a lower triangular root of the covariance, instead of it.

    Raises
    ------
    ValueError: if a shape is wrong, a number not finite, ``cov`` not symmetric positive semidefinite, or ``sqrt_cov`` not lower
        triangular.

    >>> Gaussian([7000.0, 0.0], np.diag([1.0, 1e-4])).std
    array([1.  , 0.01])
    """

    mean: Array
    cov: Array

    def __init__(self, mean: ArrayLike, cov: ArrayLike | None = None, *, sqrt_cov: ArrayLike | None = None):
        x = finite("mean", mean)
        if (cov is None) == (sqrt_cov is None):
            raise ValueError("Gaussian: expected exactly one of cov and sqrt_cov")
        if cov is not None:
            P, root = symmetric(cov, "cov")
        else:
            root = finite("sqrt_cov", sqrt_cov)
            if root.ndim < 2 or root.shape[-1] != root.shape[-2]:
                raise ValueError(f"sqrt_cov: expected shape (..., n, n), got {root.shape}")
            if np.triu(root, 1).any():
                raise ValueError(
                    "sqrt_cov: expected a lower triangular matrix (`celnav.gaussian.linalg.tria` makes one of any root)"
                )
            P = outer(root)
        if x.ndim == 0:
            raise ValueError("mean: expected shape (..., n), got a scalar")
        if P.shape[-1] > x.shape[-1]:
            raise ValueError(f"mean: expected shape (..., {P.shape[-1]}) to go with the covariance, got {x.shape}")
        try:
            np.broadcast_shapes(x.shape[:-1], P.shape[:-2])
        except ValueError:
            raise ValueError(f"mean: batch axes {x.shape[:-1]} do not go with those of the covariance, {P.shape[:-2]}") from None
        for name, value in (("mean", x), ("cov", P), ("_root", root)):
            object.__setattr__(self, name, value)

    @property
    def sqrt_cov(self) -> Array:
        """Lower root ``(..., n, n)`` of the covariance."""
        root: Array = self.__dict__["_root"]
        return root

    @property
    def std(self) -> Array:
        """Standard deviations ``(..., n)``."""
        return np.asarray(np.sqrt(self.cov.diagonal(0, -2, -1)))

    def sample(self, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Array:
        """Draw vectors ``size + (..., n)``. On curved spaces they are tangents at the mean, which is then not added."""
        if not hasattr(rng, "standard_normal"):
            raise ValueError(f"rng: expected a generator, such as np.random.default_rng(0), got {kind(rng)}")
        n, size = self.cov.shape[-1], integers("size", size)
        batch = np.broadcast_shapes(self.mean.shape[:-1], self.cov.shape[:-2])
        draw = matvec(self.sqrt_cov, rng.standard_normal((*size, *batch, n)))
        return draw + self.mean if self.mean.shape[-1] == n else draw


class SquareRoot(NamedTuple):
    """A belief in square-root form: ``mean (..., N)`` and a lower root ``sqrt_cov (..., n, n)``.

    Nothing but QR factorizations touches the root. Columns of negative weight are taken away by one block downdate.
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
        std: Array = np.sqrt(np.vecdot(self.sqrt_cov, self.sqrt_cov))
        return std

    @classmethod
    def of(cls, belief: Any) -> Self:
        """Any Gaussian in this form."""
        return cls(belief.mean, belief.sqrt_cov)

    @staticmethod
    def rounding() -> float:
        """Part of a standard deviation that is round-off."""
        return EPS

    @staticmethod
    def marginal(A: Array, sign: Array) -> Array:
        """Root of the columns ``A (..., n, q)``; column j counts with ``sign[j]``, those after ``sign`` with +1."""
        negative = _negative(sign, A.shape[-1])
        return tria(A) if negative is None else downdate(tria(A[..., negative.others]), A[..., negative.those])

    @classmethod
    def condition(
        cls,
        A: Array,
        sign: Array,
        m: int,
        gain: Array | None = None,
        known: Array | None = None,  # noqa: ARG003
        noise: Array | None = None,  # noqa: ARG003
    ) -> tuple[Array, Array, Array]:
        """Condition the last rows of ``A (..., m + n, q)`` on the first ``m``.

        Returns the root ``S (..., m, m)`` of the first rows, ``U = K @ S (..., n, m)`` and the root of the rest. With a
        prescribed ``gain`` K ``(..., n, m)`` the rest is that of ``last - K @ first`` (Joseph form). ``known``: the root of the
        last rows by themselves, and ``noise``: the columns ``(..., m, s)`` of what is in the first rows only, if they are at hand.
        """
        if gain is not None:
            S = cls.marginal(A[..., :m, :], sign)
            return S, gain @ S, cls.marginal(A[..., m:, :] - gain @ A[..., :m, :], sign)
        L = cls.marginal(A, sign)
        return L[..., :m, :m], L[..., m:, :m], L[..., m:, m:]

    @staticmethod
    def transported(matrix: Array, root: Array) -> Array:
        """Root of deviations carried by ``matrix (..., n, n)``."""
        return tria(matrix @ root)

    @staticmethod
    def sum(root: Array, columns: Array) -> Array:
        """Root of the sum of two independent parts, one of them given by its columns."""
        return tria(block([[root, columns]]))

    def lost(self) -> Array:
        """Runs ``(...)`` that are not finite."""
        return np.asarray(~(np.isfinite(self.mean).all(-1) & np.isfinite(self.sqrt_cov).all((-2, -1))))


class Covariance(NamedTuple):
    """A belief in covariance form: ``mean (..., N)`` and ``cov (..., n, n)``. See `SquareRoot` for what its parts do.

    Fewer operations, half of the digits: only the innovation covariance is factored, and the state's where a rule needs a root or a
    measurement is precise.
    """

    mean: Array
    cov: Array

    @property
    def sqrt_cov(self) -> Array:
        """Lower root ``(..., n, n)`` of the covariance."""
        return semidefinite_root(self.cov)

    @property
    def std(self) -> Array:
        """Standard deviations ``(..., n)``; nan where a variance is negative."""
        variances = self.cov.diagonal(0, -2, -1)
        if variances.min(initial=0.0) >= 0.0:
            return np.asarray(np.sqrt(variances))
        return np.asarray(np.sqrt(np.where(variances < 0.0, np.where(_negligible(variances), 0.0, np.nan), variances)))

    @classmethod
    def of(cls, belief: Any) -> Self:
        """Any Gaussian in this form."""
        return cls(belief.mean, belief.cov)

    @staticmethod
    def rounding() -> float:
        """Part of a standard deviation that is round-off."""
        return float(EPS**0.5)

    @staticmethod
    def marginal(A: Array, sign: Array) -> Array:
        """Covariance of columns; see `SquareRoot.marginal`."""
        return outer(A) if _negative(sign, A.shape[-1]) is None else weighted(A, sign) @ A.mT

    @classmethod
    def condition(
        cls,
        A: Array,
        sign: Array,
        m: int,
        gain: Array | None = None,
        known: Array | None = None,
        noise: Array | None = None,
    ) -> tuple[Array, Array, Array]:
        """S, U and the covariance of the rest; see `SquareRoot.condition`."""
        Z, X = A[..., :m, :], A[..., m:, :]
        if gain is None and known is not None and noise is not None:
            C = weighted(Z, sign) @ A.mT
            S = cholesky(C[..., :m])
            U = solve_lower(S, C[..., m:]).mT
            left = known - outer(U)
            precise = S.diagonal(0, -2, -1) > PRECISE * np.sqrt(np.vecdot(noise, noise))
            if not np.logical_or.reduce(precise, None):
                return S, U, left
            again, chosen = cls.condition(A, sign, m), np.asarray(precise.any(-1))[..., None, None]
            return np.where(chosen, again[0], S), np.where(chosen, again[1], U), np.where(chosen, again[2], left)
        S = cholesky(weighted(Z, sign) @ Z.mT)
        if gain is not None:
            return S, gain @ S, cls.marginal(X - gain @ Z, sign)
        # What the first rows explain is taken off the columns: of variances, a difference would have half the digits.
        W = solve_lower(S, Z)
        U = X @ weighted(W, sign).mT
        return S, U, cls.marginal(X - U @ W, sign)

    @staticmethod
    def transported(matrix: Array, cov: Array) -> Array:
        """Covariance of deviations carried by a matrix."""
        return np.asarray(matrix @ cov @ matrix.mT)

    @staticmethod
    def sum(cov: Array, columns: Array) -> Array:
        """Covariance of a sum; see `SquareRoot.sum`."""
        return np.asarray(cov + outer(columns))

    def lost(self) -> Array:
        """Runs ``(...)`` that are not finite, or have a negative variance beyond round-off of the matrix's largest."""
        finite = np.isfinite(self.mean).all(-1) & np.isfinite(self.cov).all((-2, -1))
        return np.asarray(~(finite & _negligible(self.cov.diagonal(0, -2, -1)).all(-1)))


Belief = SquareRoot | Covariance
FORMS: dict[str, type[SquareRoot] | type[Covariance]] = {"square root": SquareRoot, "covariance": Covariance}


def _negligible(variances: Array) -> Array:
    """Which variances are not negative, or no more than by round-off."""
    return np.asarray(variances >= -NEGLIGIBLE * np.abs(variances).max(-1, keepdims=True, initial=0.0))


def settled(belief: Belief) -> Belief:
    """The belief, nan as a whole in runs that are lost."""
    if not any_lost(belief):
        return belief
    lost = belief.lost()
    return type(belief)(np.where(lost[..., None], np.nan, belief.mean), np.where(lost[..., None, None], np.nan, belief[1]))


def any_lost(belief: Belief) -> bool:
    """Whether any run is `lost`, most often decided without looking at each."""
    plain = isfinite(np.add.reduce(belief[0], None) + np.add.reduce(belief[1], None))  # what overflows is seen below
    if plain and (isinstance(belief, SquareRoot) or np.minimum.reduce(belief.cov.diagonal(0, -2, -1), None, initial=0.0) >= 0.0):
        return False
    return bool(belief.lost().any())


class _Negative(NamedTuple):
    """Which columns have a negative sign, which have not (slices, where they lie together), and the signs ``(q,)`` of all."""

    those: Any
    others: Any
    signs: Array


def _negative(sign: Array, q: int) -> _Negative | None:
    """What is to be known of the columns of negative sign, or None if there are none; ``sign`` belongs to the first columns."""
    return _found(np.asarray(sign, np.float64).tobytes(), q)


@lru_cache(maxsize=64)
def _found(sign: bytes, q: int) -> _Negative | None:
    given = np.frombuffer(sign)
    if not (given < 0.0).any():
        return None
    signs = np.concatenate([given, np.ones(q - len(given))])
    return _Negative(_run(np.flatnonzero(signs < 0.0)), _run(np.flatnonzero(signs > 0.0)), signs)


def _run(places: Array) -> Any:
    """Places as a slice if they lie together: a view, which takes half the time in a QR of many."""
    if not len(places) or places[-1] - places[0] + 1 != len(places):
        return places
    return slice(int(places[0]), int(places[-1]) + 1)


def weighted(A: Array, sign: Array) -> Array:
    """Columns times their signs."""
    negative = _negative(sign, A.shape[-1])
    return A if negative is None else A * negative.signs


def symmetric(cov: ArrayLike, name: str, n: int | None = None) -> tuple[Array, Array]:
    """A checked covariance, symmetrized at round-off, and its lower root.

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


def nees(error: Array, root: Array) -> Array:
    """Normalized estimation error squared ``e' P^-1 e``, shape ``(...)``, from ``error (..., n)`` and a root of P."""
    white = whiten(root, error)
    return np.asarray(np.vecdot(white, white))
