"""Check that a model treats each sigma point, and each run, separately.

``x[0] += epoch.dt * x[1]`` adds *points*, not components, and ``F @ x`` multiplies runs. Both
return arrays with the right shape. Each model is therefore checked when a filter first calls it, on
copies of the points. If the points are reversed, the values must be reversed too; and some points
of one run must give the same values alone as among all others. A model with arrays of all runs
cannot be evaluated for one run alone. For such a model some runs are replaced by others, and the
remaining runs must not change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextvars import ContextVar
from functools import partial
from typing import Any

import numpy as np

from celnav.gaussian.linalg import Array

MOST = 16  # models checked in a run: a program may create a new model at every step
LOOKED_AT: ContextVar[list[Any] | None] = ContextVar("looked_at", default=None)
"""The models checked so far in this run; None if steps are called directly."""
BY_HAND: set[Any] = set()
"""The code objects of the models checked when steps are called directly."""
WATCH: ContextVar[Callable[[str, Array], Any] | None] = ContextVar("watch", default=None)
"""Called with the name and the values of each model; it may return other values, which replace
them.
"""
POINTS = (
    "points are (p, ..., n): a component is x[..., 0], np.stack([...], axis=-1) joins components, "
    "a product with a matrix is x @ F.T"
)
MEANS = "means are (..., n): a component is mean[..., 0]"
LOOSE = 0.01, 0.01  # relative to the values and their range: the error of an adaptive solver
Model = Callable[..., Any]


def unknown(function: Model, points: Array) -> bool:
    """Whether a model needs a check: once in a run, or once in all if steps are called directly."""
    if points.dtype.hasobject or not points.size or points.shape[:-1] in ((), (1,)):
        return False
    models = LOOKED_AT.get()
    if models is None:
        while isinstance(function, partial):
            function = function.func
        code = getattr(function, "__code__", type(function)), points.ndim
        new = len(points) > 1 and code not in BY_HAND
        BY_HAND.add(code)
        return new
    if len(models) == MOST or any(function is model for model in models):
        return False
    models.append(function)
    return True


def check_apart(
    name: str,
    function: Model,
    arrays: Sequence[Array],
    epoch: Any,
    y: Array,
    hint: str = POINTS,
) -> None:
    """Raise a ValueError if values ``y`` of a model mix points, runs, or inputs of runs.

    arrays: points ``(p, ..., n)`` of the state and of each noise.
    """
    wrong = _mixed(function, arrays, epoch, y) or _mixed_inputs(function, arrays, epoch, y)
    if not wrong:
        return
    again = _value(function, arrays, epoch, y)
    # Values that differ in a second call are random, and prove nothing.
    if not isinstance(again, str) and np.array_equal(again, y, equal_nan=True):
        raise ValueError(f"{name}: expected values of {wrong}; {hint}")


def check_matrices_apart(
    name: str, function: Model, mean: Array, epoch: Any, matrix: Array
) -> None:
    """Like `check_apart`, for a function ``(mean, epoch)`` that returned ``matrix (..., k, n)``."""
    if matrix.shape[:-2] not in ((), mean.shape[:-1]):
        return  # the matrix has axes of runs that the mean does not have
    size = matrix.shape[-2] * matrix.shape[-1]

    def values(points: Array, epoch: Any) -> Array:
        value = np.asarray(function(points[0], epoch), dtype=np.float64)
        runs = points.shape[1:-1]
        return np.broadcast_to(value, (*runs, *matrix.shape[-2:])).reshape(1, *runs, size)

    if matrix.ndim == 2:  # a matrix for all runs must not depend on the mean of any
        like = matrix.reshape(1, size)
        for near, same in ((mean + 0.1 * (1.0 + np.abs(mean)), False), (mean, True)):
            value = _value(values, [near[None]], epoch, like)
            if isinstance(value, str) or _same(value, np.broadcast_to(like, value.shape)) != same:
                return  # the matrix does not depend on the mean, or is random
        raise ValueError(
            f"{name}: expected values of each run by itself, got one matrix for all runs that "
            f"depends on the mean; {MEANS}"
        )
    y = np.broadcast_to(matrix, (*mean.shape[:-1], *matrix.shape[-2:]))
    check_apart(name, values, [mean[None]], epoch, y.reshape(1, *mean.shape[:-1], size), MEANS)


def _mixed(function: Model, arrays: Sequence[Array], epoch: Any, y: Array) -> str:
    """The error message if a value depends on other points or runs; "" if none does."""
    points = "each point by itself, got points that depend on each other"
    other = _value(function, [a[::-1] for a in arrays], epoch, y) if len(y) > 1 else ""
    if not isinstance(other, str) and not _same(other[::-1], y):
        return points
    here = slice(None)
    if y.ndim > 2:
        finite: Any = np.isfinite(y).all(tuple(i for i in range(y.ndim) if i != y.ndim - 2))
        last = len(finite) - 1 - int(np.argmax(finite[::-1]))
        here = slice(last, last + 1)
    subsets = slice(len(y) - len(y) // 2), slice(-1, None)
    follows = [_follows(function, arrays, epoch, y, subset, here) for subset in subsets]
    if all(follows):
        return ""
    if len(y) > 1 and y.ndim > 2:  # because of the other points, or of the other runs
        follows = [_follows(function, arrays, epoch, y, subset, slice(None)) for subset in subsets]
    if len(y) > 1 and False in follows:
        return points
    alone = _follows(function, arrays, epoch, y, slice(None), here) if y.ndim > 2 else True
    if alone or (alone is None and not _noticed(function, arrays, epoch, y)):
        return ""
    return "each run by itself, got runs that depend on each other, as F @ x makes them"


def _follows(
    function: Model, arrays: Sequence[Array], epoch: Any, y: Array, points: slice, runs: slice
) -> bool | None:
    """Whether some points of some runs give the same values as among all; None if they cannot be
    evaluated.
    """
    at: Any = (points, ..., runs, slice(None)) if y.ndim > 2 else points
    values = _value(function, [a[at] for a in arrays], epoch, y)
    if isinstance(values, str):  # a matrix that is multiplied by one run only does not fit
        return False if "core dimension" in values and runs != slice(None) else None
    among = y[..., runs, :] if y.ndim > 2 else y
    # A solver that chooses its steps for all points together does not reproduce all digits.
    error = LOOSE[0] * np.abs(among).max(0) + LOOSE[1] * np.ptp(among, 0)
    return not (np.abs(values - y[at]) > error).any()


def _noticed(function: Model, arrays: Sequence[Array], epoch: Any, y: Array) -> bool:
    """Whether a run changes when other runs are replaced.

    A model that confuses axes uses the index of a component or a row as the index of a run, and
    these indices are small. So any two of the first runs must differ in one of the exchanges, which
    select runs by the bits of their indices, in both ways.
    """
    runs = np.arange(y.shape[-2])
    # Points of other runs, at which the model is evaluated in any case.
    others = [np.roll(a, (1, 1), (0, -2)) for a in arrays]
    if all(map(np.array_equal, others, arrays)):
        others = [1.001 * a for a in arrays]
    most = min(y.shape[-2] - 1, max(a.shape[-1] for a in arrays))
    for bit in range(most.bit_length()):
        ones = (runs >> bit & 1) == 1
        for unchanged in (ones, ~ones):
            mixture = [np.where(unchanged[:, None], *pair) for pair in zip(arrays, others)]
            values = _value(function, mixture, epoch, y)
            if isinstance(values, str):
                continue
            change = np.nan_to_num(np.abs(values - y))
            least = 1e-6 * change.max() + 1e-12 * np.nan_to_num(np.abs(y[..., unchanged, :]))
            if (change[..., unchanged, :] > least).any():
                return True
    return False


def _mixed_inputs(function: Model, arrays: Sequence[Array], epoch: Any, y: Array) -> str:
    """The error message if a run uses the input of another run: ``u[0]`` of ``u (..., k)`` is the
    input of one run.
    """
    u, runs = getattr(epoch, "u", None), y.shape[1:-1]
    if not runs or runs[-1] == 1 or not any(_of_runs(item, runs) for item in _parts(u)):
        return ""

    def values(exchange: Callable[[Array], Array], arrays: Sequence[Array]) -> Array | str:
        """The values with the inputs of runs exchanged along the last axis of runs."""
        axis = len(runs) - 1

        def exchanged(item: Any) -> Any:
            if not _of_runs(item, runs):
                return item
            return np.moveaxis(exchange(np.moveaxis(item, axis, 0)), 0, axis)

        items = [exchanged(item) for item in _parts(u)]
        inputs = items[0] if not isinstance(u, tuple) else getattr(u, "_make", tuple)(items)
        return _value(function, arrays, epoch._replace(u=inputs), y)

    # If runs and their inputs are rolled together, the values must be rolled too: no run is mixed
    # up.
    turned = values(lambda x: np.roll(x, 1, 0), [np.roll(a, 1, -2) for a in arrays])
    if isinstance(turned, str) or _same(turned, np.roll(y, 1, -2)):
        return ""
    # A mix-up shows if the last run ignores its input, but depends on the inputs of the other runs.
    without = values(lambda x: np.concatenate([x[:-1], x[:1]]), arrays)
    others = values(lambda x: np.concatenate([np.roll(x[:-1], 1, 0) + x[-1:], x[-1:]]), arrays)
    if isinstance(without, str) or isinstance(others, str):
        return ""
    last = y[..., -1, :]
    if not _same(without[..., -1, :], last) or _same(others[..., -1, :], last):
        return ""
    return "each run with its own input, got the input of another run; a component is u[..., 0]"


def _parts(u: Any) -> tuple[Any, ...]:
    return u if isinstance(u, tuple) else (u,)


def _of_runs(item: Any, runs: tuple[int, ...]) -> bool:
    """Whether an input has axes of runs before its own."""
    if not isinstance(item, np.ndarray):
        return False
    return item.ndim > len(runs) and item.shape[: len(runs)] == runs


def _value(function: Model, arrays: Sequence[Array], epoch: Any, like: Array) -> Array | str:
    """Values of a model; the text of its error, or "", if it cannot be evaluated or has another
    shape.
    """
    points, *noise = (np.array(a, order="K") for a in arrays)  # the model may change its argument
    try:
        with np.errstate(all="ignore"):
            values = np.asarray(function(points, epoch, *noise), dtype=np.float64)
    except Exception as error:
        return str(error)
    return values if values.shape == (*points.shape[:-1], like.shape[-1]) else ""


def _same(a: Array, b: Array) -> bool:
    """Whether values are equal up to round-off (of single precision if all are single)."""
    least = 1e-4 if np.array_equal(b, b.astype(np.float32), equal_nan=True) else 1e-9
    size = np.nan_to_num(np.abs(b)).max(tuple(range(b.ndim - 1)), keepdims=True)
    return bool(((a == b) | (np.abs(a - b) <= least * size) | (np.isnan(a) & np.isnan(b))).all())
