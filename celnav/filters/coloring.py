"""What filters for colored measurement noise have in common: the coefficient, the difference, the state from epoch to epoch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.arguments import check_model, measurement
from celnav.filters.conditioning import noise_columns
from celnav.filters.driver import Epoch
from celnav.filters.info import Info
from celnav.filters.step import update
from celnav.gaussian.belief import Gaussian, sqrt_cov
from celnav.gaussian.checks import finite, numbers
from celnav.gaussian.linalg import Array, matvec
from celnav.gaussian.transform import Transform

Coloring = ArrayLike | Callable[[Any], Array]
"""``Phi (..., m, m)`` or ``epoch -> Phi``."""


class Colored(NamedTuple):
    """State of a colored-noise filter: the estimate without latency, the last measurement, and the lagged estimate.

    ``lagged`` is the estimate of the *previous* state given the present measurement (the prior at the first epoch, and where
    a filter does not compute it).
    """

    belief: Gaussian
    z: Any
    lagged: Gaussian
    memory: Any = None


def coloring(Phi: Coloring, m: int | None = None) -> Callable[[Any], Array]:
    """Checked ``epoch -> Phi (..., m, m)``.

    Raises
    ------
    ValueError: if Phi is not finite, not ``(..., m, m)``, or has a spectral radius above 1. Radius 1, a random walk, is
        allowed: differences then say nothing about position, only about its changes.
    """
    if callable(Phi):
        check_model("Phi", Phi, "(epoch)")
        return lambda epoch: _matrix(numbers("Phi", Phi(epoch)), m)
    matrix = _matrix(finite("Phi", Phi), m)
    radius = np.abs(np.linalg.eigvals(matrix)).max()
    if radius > 1.0 + 1e-9:
        raise ValueError(f"Phi: expected a spectral radius of at most 1, got {radius:.6g}")
    return lambda epoch: matrix


def _matrix(Phi: Array, m: int | None) -> Array:
    if Phi.ndim < 2 or Phi.shape[-1] != Phi.shape[-2] or (m is not None and Phi.shape[-1] != m):
        size = "m, m" if m is None else f"{m}, {m}"
        raise ValueError(f"Phi: expected shape (..., {size}), got {Phi.shape}")
    return Phi


def difference(Phi: Array, z: Array, z_next: Array) -> Array:
    """``z_next - Phi z (..., m)``. A missing component spoils those differences that it enters, not the others."""
    absent = np.isnan(z)
    if not absent.any():
        return np.asarray(z_next - matvec(Phi, z))
    spoiled = matvec((Phi != 0.0).astype(float), absent.astype(float)) > 0.0
    return np.asarray(np.where(spoiled, np.nan, z_next - matvec(Phi, np.where(absent, 0.0, z))))


def first_update(h: Any, rule: Transform, Sigma0: ArrayLike | None) -> Callable[[Gaussian, Epoch], tuple[Gaussian, Info]]:
    """The update of the prior by the first sample; without ``Sigma0`` that sample only anchors the first difference."""
    if Sigma0 is None:
        return lambda prior, epoch: (prior, Info())
    part = update(h, rule, sqrt_R=sqrt_cov(Sigma0, "Sigma0"))

    def absolute(prior: Gaussian, epoch: Epoch) -> tuple[Gaussian, Info]:
        posterior, info, _ = part(prior, epoch.z, epoch)
        return posterior, info

    return absolute


def measurement_matrix(name: str, H: ArrayLike | Callable[..., Any]) -> Array:
    """A checked matrix ``(..., m, n)``.

    Raises
    ------
    ValueError: naming it, for a function or another shape.
    """
    if callable(H):
        raise ValueError(f"{name}: expected a matrix (m, n), got a function; `colored` takes one")
    matrix = finite(name, H)
    if matrix.ndim < 2:
        raise ValueError(f"{name}: expected a matrix (m, n), got shape {matrix.shape}")
    return matrix


def noises(Q: Any, sqrt_Q: Any, R: Any, sqrt_R: Any, m: int | None) -> tuple[Any, Any, int]:
    """Columns of process noise and of increments, and the number of components measured.

    Raises
    ------
    ValueError: if one of the noises is missing, or R does not go with ``m``, or m is None and R a function that does not tell it.
    """
    process, increments = noise_columns(Q, sqrt_Q, "Q"), noise_columns(R, sqrt_R, "R")
    if process is None or increments is None:
        raise ValueError("Q, R: expected process noise (Q or sqrt_Q) and increments (R or sqrt_R)")
    if callable(increments):
        if m is None:
            raise ValueError("R: expected a constant where the measurement is a function")
        return process, increments, m
    rows = increments.shape[-2]
    if m is not None and rows != m:
        raise ValueError(f"R: expected {m} rows to go with h, got {rows}")
    return process, increments, rows


def taken(state: Colored, epoch: Epoch, m: int) -> tuple[Colored, Array]:
    """The measurement ``(..., m)`` of an epoch, nan where there is none, and the state with a belief for each run of it.

    Raises
    ------
    ValueError: for another number of components, and for intervals that are none: the first sample only anchors the difference
        to the second, so that nothing leads up to it, and each later one ends an interval.
    """
    first = state.z is None
    if bool(np.any(epoch.dt)) is first:
        expected = "0 at the first epoch (start from a prior at that time)" if first else "an interval after the first epoch"
        raise ValueError(f"dt: expected {expected}, got {epoch.dt!r}")
    if epoch.z is None:
        return state, np.full(m, np.nan)
    z, belief = measurement(epoch.z, state.belief)
    if z.shape[-1] != m:
        raise ValueError(f"z: expected {m} components to go with h, got {z.shape[-1]}")
    return state._replace(belief=belief), z
