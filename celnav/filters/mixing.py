"""A model must leave its runs apart: ``F @ x`` multiplies runs, not components, and says nothing where there are as many of both.

`celnav.filters.run.steps` has each model looked at the first time that it is called. One run alone must then give what it gave
among the others. A model that cannot be evaluated for one run alone, since it carries arrays of all runs, has some runs exchanged
for other ones instead, and those left in place must not notice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextvars import ContextVar
from typing import Any

import numpy as np

from celnav.gaussian.linalg import Array

__all__ = ["LOOKED_AT", "POINTS", "WATCH", "check_runs_apart", "unknown"]

MOST = 16  # models looked at in a run of a filter: some are made anew at every step
LOOKED_AT: ContextVar[list[Any] | None] = ContextVar("looked_at", default=None)
"""The models looked at so far; None where none is to be."""
WATCH: ContextVar[Callable[[str, Array], None] | None] = ContextVar("watch", default=None)
"""Called with the name of each model and its values, where it is to be found out which of them are not finite."""
POINTS = "points are (p, ..., n): a component is x[..., 0], a product with a matrix x @ F.T"
Model = Callable[..., Any]


def unknown(function: Model, points: Array) -> bool:
    """Whether a model is to be looked at: the first time, and where there are runs that it could mix."""
    models = LOOKED_AT.get()
    if (
        models is None
        or points.shape[-2] < 2
        or len(models) == MOST
        or any(function is model for model in models)
    ):
        return False
    models.append(function)
    return True


def check_runs_apart(
    name: str, function: Model, arrays: Sequence[Array], epoch: Any, y: Array
) -> None:
    """Raise a ValueError if the values ``y`` of a model at ``arrays``, points of the state and of noises, mix runs."""
    which = int(np.argmax(np.isfinite(y).all(tuple(i for i in range(y.ndim) if i != y.ndim - 2))))
    here = slice(which, which + 1)
    alone, reason = _value(function, [a[..., here, :] for a in arrays], epoch, y.shape[-1])
    if alone is not None:
        among = y[..., here, :]
        # Solvers that choose their steps for all runs together do not agree in all digits.
        mixed = bool((np.abs(alone - among) > 0.5 * np.ptp(among, 0) + 0.01 * np.abs(among)).any())
    elif y.shape[-2] > max(a.shape[-1] for a in arrays):
        mixed = False  # no matrix of the model's goes with so many runs
    else:
        mixed = "core dimension" in reason or _noticed(function, arrays, epoch, y)
    again = _value(function, arrays, epoch, y.shape[-1])[0] if mixed else None
    if again is not None and np.array_equal(again, y, equal_nan=True):  # or it is random
        got = "runs that depend on each other, as F @ x makes them"
        raise ValueError(f"{name}: expected values of each run by itself, got {got}; {POINTS}")


def _value(
    function: Model, arrays: Sequence[Array], epoch: Any, dimension: int
) -> tuple[Array | None, str]:
    """Values of a model, or None and the reason where it cannot be evaluated there."""
    points, *noise = (np.array(a, order="K") for a in arrays)  # it may change its argument
    try:
        with np.errstate(all="ignore"):
            found = np.asarray(function(points, epoch, *noise), dtype=np.float64)
    except Exception as error:
        return None, str(error)
    return (found, "") if found.shape == (*arrays[0].shape[:-1], dimension) else (None, "")


def _noticed(function: Model, arrays: Sequence[Array], epoch: Any, y: Array) -> bool:
    """Whether a run changes where others are exchanged; of any two runs one is exchanged without the other, either way."""
    runs = np.arange(y.shape[-2])
    others = [np.roll(a, (1, 1), (0, -2)) for a in arrays]  # points that are visited anyhow
    for bit in range(int(runs[-1]).bit_length()):
        ones = (runs >> bit & 1) == 1
        for kept in (ones, ~ones):
            found, _ = _value(
                function,
                [np.where(kept[:, None], *pair) for pair in zip(arrays, others)],
                epoch,
                y.shape[-1],
            )
            if found is None:
                continue
            change = np.nan_to_num(np.abs(found - y))
            if (
                change[..., kept, :]
                > 1e-6 * change.max() + 1e-12 * np.nan_to_num(np.abs(y[..., kept, :]))
            ).any():
                return True
    return False
