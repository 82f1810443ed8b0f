"""The models of a filter: `Motion` and `Sensor`, with their noise, and how they are called.

Models are functions of *points*: ``f(x, epoch)`` maps points ``x (p, ..., N)`` to points. The point
axis comes first, so that the inputs of each run broadcast without further axes. A component is
``x[..., 0]``; a product with a matrix is ``x @ F.T``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property, partial
from typing import Any, ClassVar
from warnings import warn

import numpy as np

from celnav.filters.mixing import check_matrices_apart, unknown
from celnav.gaussian.belief import Gaussian, symmetric
from celnav.gaussian.checks import accepts, describe, finite, function, instance, numbers, unmasked
from celnav.gaussian.linalg import Array, Covariance, SquareRoot, matvec
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.tape.numbers import in_model

__all__ = ["Linear", "Motion", "Sensor"]

Model = Callable[..., Any]
"""``(points (p, ..., N), epoch, *noise points (p, ..., k)) -> (p, ..., M)``."""
Jacobian = Callable[[Array, Any], Any]
"""``(mean (..., N), epoch) -> (..., k, n)``; with noise through the points the noise columns follow
the state columns.
"""


@dataclass(frozen=True, eq=False)
class Linear:
    """A linear model whose matrix depends on the epoch. Like a constant matrix, it is exact and
    cheap under any rule.

    ``matrix``: ``epoch -> (..., m, n)``.

    >>> F = celnav.Linear(lambda epoch: np.array([[1.0, epoch.dt], [0.0, 1.0]]))
    >>> motion = celnav.Motion(F, Q)
    """

    matrix: Callable[[Any], Array]

    def __post_init__(self) -> None:
        function("matrix", self.matrix, "(epoch)")

    def __call__(self, x: Array, epoch: Any) -> Array:
        return matvec(self.at(epoch, x.shape[-1]), x)

    def at(self, epoch: Any, n: int) -> Array:
        """The matrix ``(..., m, n)`` of an epoch."""
        return numbers("matrix", unmasked("matrix", self.matrix(epoch)), (..., None, n))


@dataclass(frozen=True, eq=False)
class _Model:
    """The checks that `Motion` and `Sensor` share: a function or a matrix, a valid space, and a
    noise.
    """

    name: ClassVar[str]
    noise_name: ClassVar[str]
    _: KW_ONLY
    space: Space = EUCLIDEAN
    jacobian: Jacobian | None = None
    augment: Sequence[Array] = ()

    def __post_init__(self) -> None:
        name, noise = self.name, self.noise_name
        model = getattr(self, name)
        if not callable(model):
            matrix = finite(name, model)
            if matrix.ndim < 2 or (name == "f" and matrix.shape[-1] != matrix.shape[-2]):
                shape = "(..., n, n)" if name == "f" else "(..., m, n)"
                raise ValueError(
                    f"{name}: expected a function (points, epoch) or a matrix {shape}, got shape "
                    f"{matrix.shape}"
                )
            object.__setattr__(self, name, matrix)
            columns = self.noise
            if isinstance(columns, np.ndarray) and columns.shape[-2] != matrix.shape[-2]:
                raise ValueError(
                    f"{noise}: expected {matrix.shape[-2]} rows to go with {name}, got "
                    f"{columns.shape[-2]}"
                )
        # How many noises go through the function is decided by the filter.
        elif not any(accepts(model, count) for count in range(2, 10)):
            raise ValueError(
                f"{name}: expected a function (points, epoch, *noise), got {describe(model)} with "
                f"other arguments; pass lambda x, epoch: {name}(x) for a function of the state"
            )
        if self.jacobian is not None:
            function(
                "jacobian",
                self.jacobian,
                "(mean, epoch)",
                f"; a linear {name} is the matrix itself",
            )
        instance("space", self.space, Space, "a Space, such as celnav.angles([0])")
        roots = check_roots("augment", self.augment)
        if len(roots) and self.linear:
            raise ValueError(
                f"augment: expected a function {name}(points, epoch, *noise) with it, got a "
                f"matrix; {noise} is its noise"
            )
        if self.noise is None and not len(roots):
            raise ValueError(
                f"{noise}: expected the noise's covariance, {noise} or sqrt_{noise}; without noise "
                "it is np.zeros((k, k))"
            )

    @cached_property
    def linear(self) -> bool:
        """Whether the model is a matrix, constant or of the epoch."""
        model = getattr(self, self.name)
        return isinstance(model, Linear) or not callable(model)

    @cached_property
    def noise(self) -> Noise:
        """Columns ``(..., k, r)`` of the noise, or a function ``(mean, epoch)``
        that returns them.
        """
        model, name = getattr(self, self.name), self.noise_name
        # A sensor has as many rows as measured components; a motion as differences in its space.
        rows: Rows = self.space if self.name == "f" else None
        if not callable(model):
            rows = model.shape[-2]
        return noise_of(name, getattr(self, name), getattr(self, f"sqrt_{name}"), rows)

    def columns(self, mean: Array, epoch: Any, rows: int) -> Any:
        """Columns ``(..., rows, r)`` of the noise at an epoch; None if all noise goes through the
        points.
        """
        columns = self.noise(mean, epoch) if callable(self.noise) else self.noise
        return None if columns is None else _widened(columns, rows)


@dataclass(frozen=True, eq=False)
class Motion(_Model):
    """The model of the dynamics: ``x' = f(x, epoch) + w``, ``w ~ N(0, Q)``.

    f: function ``(points (p, ..., N), epoch) -> (p, ..., N)``, or a matrix ``(..., n, n)``, or a
        `Linear` matrix that depends on the epoch. ``epoch.dt`` is the interval in s, ``epoch.u``
        the input.
    Q: covariance ``(..., n, n)`` of the process noise over an interval, or a function
        ``(mean, epoch)`` that returns it. Without noise it is ``np.zeros((n, n))``. A number means
        this multiple of the identity.
    sqrt_Q: instead of ``Q``: columns ``(..., n, r)`` of the noise, or a function ``(mean, epoch)``
        that returns them; a number is a standard deviation.
    space: how states are subtracted, if they are not vectors: `celnav.angles`,
        `celnav.gaussian.attitude`.
    jacobian: ``(mean, epoch) -> (..., n, n)``, which an extended filter uses instead of numerical
        differences.
    augment: roots ``(k, k)`` of noises that go *through* the points: ``f(x, epoch, *noise)``.

    ValueError names an argument that does not fit.

    >>> motion = celnav.Motion(lambda x, epoch: orbit.step(x, epoch.dt), Q=1e-8 * np.eye(6))
    """

    name, noise_name = "f", "Q"
    f: Any
    Q: Any = None
    _: KW_ONLY
    sqrt_Q: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not callable(self.f) and self.space != EUCLIDEAN:
            raise ValueError("f: expected a function where states are not vectors, got a matrix")


@dataclass(frozen=True, eq=False)
class Sensor(_Model):
    """The model of a measurement: ``z = h(x, epoch) + v``, ``v ~ N(0, R)``.

    h: function ``(points (p, ..., N), epoch) -> (p, ..., m)``, or a matrix ``(..., m, n)``, which
        is exact and cheap under any rule.
    R, sqrt_R, jacobian, augment: as in `Motion`, with m rows. All the noise may go through the
        points.
    space: how measurements are subtracted, if they are not vectors: ``celnav.angles([1])`` wraps
        component 1.

    ValueError names an argument that does not fit.

    >>> gps = celnav.Sensor(np.eye(3, 6), R=0.04 * np.eye(3))
    """

    name, noise_name = "h", "R"
    h: Any
    R: Any = None
    _: KW_ONLY
    sqrt_R: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        # Evaluated now, because R may have no numerical values while a step is recorded.
        _ = self.noisy

    @cached_property
    def m(self) -> int | None:
        """Number of components, from the rows of the noise; None if the noise is a function or a
        number.
        """
        columns = self.noise
        return columns.shape[-2] if isinstance(columns, np.ndarray) and columns.ndim else None

    @cached_property
    def noisy(self) -> bool:
        """Whether each component certainly has noise. Only a component without noise can repeat
        what the prior already determines.
        """
        return bool(len(self.augment)) or (
            isinstance(self.noise, np.ndarray) and bool(self.noise.any(-1).all())
        )


Noise = Array | Callable[[Array, Any], Array] | None
"""Columns ``(..., k, r)`` of a noise, or a function ``(mean, epoch)`` that returns them; None: no
noise.

A single standard deviation, ``()``, means this multiple of the identity, with as many rows as the
model.
"""
Rows = int | Space | None


def noise_of(name: str, cov: Any, sqrt: Any, rows: Rows = None) -> Noise:
    """Columns of a noise from a covariance or a root: a constant, checked once, or a function.

    rows: number of rows for a single standard deviation, or the space of the mean; None: it remains
        a number.
    """
    if cov is not None and sqrt is not None:
        raise ValueError(f"{name}: expected one of {name} and sqrt_{name}, got both")
    if cov is None and sqrt is None:
        return None
    value, name, columns = (sqrt, f"sqrt_{name}", _root) if cov is None else (cov, name, _cov)
    if callable(value):
        return partial(_noise_at, function(name, value, "(mean, epoch)"), columns, name, rows)
    constant = columns(name, finite(name, value))
    if constant.ndim or not isinstance(rows, Space):
        return _widened(constant, rows)
    return partial(_widened, constant, rows)


def _root(name: str, value: Any) -> Array:
    root = numbers(name, value)
    return numbers(name, root, (..., "n", None)) if root.ndim else root


def _cov(name: str, value: Any) -> Array:
    P = numbers(name, value)
    return symmetric(P, name)[1] if P.ndim else symmetric(P.reshape(1, 1), name)[1][..., 0, 0]


def _noise_at(model: Any, columns: Any, name: str, rows: Rows, mean: Array, epoch: Any) -> Array:
    return _widened(columns(name, matrices_of(name, model, mean, epoch)), rows, mean)


def _widened(columns: Array, rows: Rows, mean: Any = None, _epoch: Any = None) -> Array:
    """The columns ``(..., k, r)``; a single standard deviation becomes a
    multiple of the identity.
    """
    if columns.ndim or rows is None:
        return columns
    count = rows.minus(mean, mean).shape[-1] if isinstance(rows, Space) else rows
    return np.asanyarray(columns * np.eye(count))


def matrices_of(name: str, function: Any, mean: Array, epoch: Any) -> Array:
    """Matrices ``(..., k, n)`` from a function ``(mean, epoch)``, which may change its argument."""
    x = mean.copy()
    matrices = in_model(function, x, epoch) if x.dtype.hasobject else function(x, epoch)
    if type(matrices) is not np.ndarray or matrices.dtype != np.float64:
        matrices = numbers(name, unmasked(name, matrices))
    if matrices.ndim > 1 and unknown(function, mean):
        check_matrices_apart(name, function, mean, epoch, matrices)
    return np.asanyarray(matrices)


def check_roots(name: str, roots: Any) -> Sequence[Array]:
    """The roots of noises through the points, a sequence of matrices ``(..., k, k)``; ValueError
    otherwise.
    """
    if not isinstance(roots, tuple | list) or not all(
        isinstance(root, np.ndarray) and root.ndim >= 2 for root in roots
    ):
        raise ValueError(
            f"{name}: expected a sequence of matrices, a root (k, k) for each noise, such as "
            "(np.eye(2),)"
        )
    return roots


def check_matrices(N: int, n: int, *models: Motion | Sensor) -> None:
    """Check matrices of models against a state with N components and an n x n covariance;
    ValueError names a matrix that does not fit.
    """
    for model in models:
        name, matrix = model.name, getattr(model, model.name)
        if n != N and model.linear:
            raise ValueError(
                f"{name}: expected a function where states have {N} components, {n} differences, "
                "such as lambda x, epoch: x[..., -3:], got a matrix"
            )
        if not callable(matrix) and matrix.shape[-1] != n:
            raise ValueError(
                f"{name}: expected a matrix ({'n' if name == 'f' else 'm'}, {n}) to go with a "
                f"state of {n} components, as in the prior, got {matrix.shape[-2:]}"
            )


def check_prior(prior: Any) -> None:
    """Check that a prior is a `celnav.Gaussian`, or the belief of a filter."""
    instance(
        "prior",
        prior,
        (Gaussian, SquareRoot, Covariance),
        "a Gaussian, such as celnav.Gaussian(mean, cov)",
    )


def check_return(name: str, value: Any, contents: str) -> Any:
    """The value that a user's function returned, if it is a tuple of the named ``contents``;
    ValueError otherwise.
    """
    if not isinstance(value, tuple | list) or len(value) != contents.count(",") + 1:
        raise ValueError(f"{name}: expected ({contents}) from the function, got {describe(value)}")
    return value


def as_floats(name: str, values: Any, points: Array) -> Array:
    """Values of a model as float64, with a warning if they are in single precision and differ by
    little more than round-off.
    """
    dtype, y = np.asarray(values).dtype, numbers(name, unmasked(name, values))
    if dtype.kind == "f" and dtype.itemsize < y.itemsize and len(points) > 1 and y.size:
        differences, moved = np.ptp(y, 0), np.ptp(points, 0) > 0.0
        moved = moved if moved.shape == differences.shape else moved.any(-1, keepdims=True)
        if (moved & (differences < 1e3 * np.finfo(dtype).eps * np.abs(y).max(0))).any():
            text = (
                "its values differ from point to point by little more than round-off. "
                "Compute in float64."
            )
            warn(f"{name} returns {dtype}: {text}", RuntimeWarning, stacklevel=4)
    return y
