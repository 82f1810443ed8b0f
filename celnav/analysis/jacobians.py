"""Check analytic Jacobians against central differences, batched, in the units of the quantities themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian import checks
from celnav.gaussian.checks import finite, instance, number, numbers, sequence, together
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import EUCLIDEAN, Space

_EPS = float(np.finfo(np.float64).eps)


class JacobianCheck(NamedTuple):
    """What `check_jacobian` found: the numerical Jacobian ``(..., M, N)``, and the largest relative error of the given one."""

    numerical: Array
    error: float


def check_jacobian(
    function: Callable[..., Any],
    jacobian: Callable[..., Any] | ArrayLike,
    point: ArrayLike,
    *,
    args: Sequence[Any] = (),
    step: ArrayLike | None = None,
    rtol: float = 1e-6,
    output_space: Space = EUCLIDEAN,
) -> JacobianCheck:
    """Compare an analytic Jacobian with central differences of order 8.

    An entry's error is taken relative to the largest effect that a step of any component has on the same output: with steps
    of the size of what they perturb, units do not matter and an entry that is rightly 0 can be checked as well.

    Parameters
    ----------
    function: ``(points (p, ..., N), *args) -> (p, ..., M)``, a model function, say.
    jacobian: ``(point (..., N), *args) -> (..., M, N)``, or that matrix. A tuple, as `Taylor` takes it, counts with its
        first matrix.
    point: ``(..., N)``; batch axes may go with batched ``args``.
    args: passed on to both: the epoch, say.
    step: ``(N,)`` or scalar, length of the largest difference in each component; an eighth of it is tried as well. Default:
        1 % of the component, or 0.01 where that is larger.
    rtol: largest relative error allowed.
    output_space: of the function's values: angles that wrap need theirs.

    Raises
    ------
    ValueError: naming the worst entry, with its value, the one expected and the relative error; for shapes that do not fit;
        and where the function is not smooth enough over ``step`` to judge at ``rtol``.
    """
    checks.function("function", function, "(points, *args)")
    instance("output_space", output_space, Space, "a Space, such as celnav.angles([0])")
    x, rtol = finite("point", point, (..., "N")), number("rtol", rtol, above=0.0, below=1.0)
    args = sequence("args", args, "(epoch,)")
    lengths = np.maximum(0.01 * np.abs(x), 0.01) if step is None else finite("step", step)
    if together(step=lengths.shape, point=x.shape) != x.shape:
        raise ValueError(f"step: expected one number, or one for each of {x.shape[-1]} components, got shape {lengths.shape}")
    h = np.broadcast_to(lengths, x.shape)
    if not (h > 0.0).all():
        raise ValueError(f"step: expected positive numbers, got {h.min()}")
    center = numbers("function", function(x[None].copy(), *args), (1, *x.shape[:-1], "M"))
    given = jacobian(x.copy(), *args) if callable(jacobian) else jacobian
    J = numbers("jacobian", given[0] if isinstance(given, tuple) else given, (*x.shape[:-1], center.shape[-1], x.shape[-1]))

    numerical, doubt = _differences(function, x, h, center, args, output_space)
    size = np.abs(numerical) * h[..., None, :]
    effect = np.maximum(size, np.abs(J) * h[..., None, :]).max(-1, keepdims=True)
    unit = np.where(effect > 0.0, effect, 1.0)
    unsure = doubt * h[..., None, :] / unit
    if not np.isfinite(numerical).all() or (unsure > 0.5 * rtol).any():
        worst = _worst(np.where(np.isfinite(unsure), unsure, np.inf))
        raise ValueError(
            f"function: expected it to be smooth within a step of the point, to {rtol:.1g}; the difference at {_name(worst)} is "
            f"{numerical[worst]:.9g} give or take {doubt[worst]:.2g} (choose another step)"
        )
    error = np.abs(J - numerical) * h[..., None, :] / unit
    error = np.where(np.isnan(error), np.inf, error)
    worst = _worst(error)
    if error[worst] > rtol:
        raise ValueError(
            f"jacobian: expected {numerical[worst]:.9g} at {_name(worst)}, got {J[worst]:.9g} (relative error {error[worst]:.3g})"
        )
    return JacobianCheck(numerical, float(error[worst]))


_ORDER_8 = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
_ORDER_6 = np.array([3 / 4, -3 / 20, 1 / 60, 0.0])


def _differences(
    function: Callable[..., Any], x: Array, h: Array, center: Array, args: Sequence[Any], space: Space
) -> tuple[Array, Array]:
    """Jacobian ``(..., M, N)`` and an estimate of its error: order 8 and what order 6 says otherwise, at the better scale."""
    n = x.shape[-1]
    best = np.full((*x.shape[:-1], center.shape[-1], n), np.nan)
    doubt = np.full_like(best, np.inf)
    for scale in (1.0, 1.0 / 8.0):
        reach = scale * np.arange(1, 5) / 4.0
        moves = np.einsum("k,ij->kij", np.concatenate([reach, -reach]), np.eye(n)).reshape(8 * n, *(1,) * (x.ndim - 1), n)
        y = np.asarray(function(x + h * moves, *args), dtype=np.float64)
        d = space.minus(y, center).reshape(2, 4, n, *center.shape[1:])
        odd = np.moveaxis(d[0] - d[1], 1, -1) / (0.25 * scale * h[..., None, :])  # (4, ..., M, N)
        eighth, sixth = (np.tensordot(c, odd, 1) for c in (_ORDER_8, _ORDER_6))
        # the spread of both orders, and the round-off of the values themselves
        floor = 4.0 * _EPS * np.abs(center[0])[..., None] / (0.25 * scale * h[..., None, :])
        estimate = np.abs(eighth - sixth) + floor
        better = estimate < doubt
        best, doubt = np.where(better, eighth, best), np.where(better, estimate, doubt)
    return best, doubt


def _worst(error: Array) -> tuple[int, ...]:
    return tuple(int(i) for i in np.unravel_index(int(np.argmax(error)), error.shape))


def _name(index: tuple[int, ...]) -> str:
    entry = f"entry {index[-2:]}"
    return entry if len(index) == 2 else f"{entry} of run {index[:-2]}"
