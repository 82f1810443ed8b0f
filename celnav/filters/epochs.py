"""Epochs made from arrays: times, measurements and inputs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.records import Epoch
from celnav.gaussian.checks import finite, kind, numbers
from celnav.gaussian.linalg import Array


class Epochs(Sequence[Epoch]):
    """Epochs made from arrays when they are asked for, one at a time; nothing is copied. See `epochs`.

    A slice is one again, numbered on. Its first epoch keeps the interval that leads up to it, so that ``[k:]`` goes on where
    ``[:k]`` ends; where a stride leaves epochs out, intervals are those between the ones that are left.
    """

    def __init__(self, times: Array, z: Any, u: Any, truth: Any, rows: range | None = None, before: int = -1, first: int = 0):
        self._times, self._z, self._u, self._truth = times, z, u, truth
        self._rows, self._before, self._first = range(len(times)) if rows is None else rows, before, first

    def __len__(self) -> int:
        return len(self._rows)

    def __repr__(self) -> str:
        span = f" from {self._times[self._rows[0]]:g} to {self._times[self._rows[-1]]:g} s" if self._rows else ""
        return f"Epochs({len(self)}{span})"

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            rows, count = self._rows[k], self._rows[k].step
            if count < 1:
                raise ValueError(f"epochs: expected a slice that runs forward, got {k}")
            if count > 1 and self._u is not None:
                raise ValueError(f"epochs: an interval of {count} epochs has {count} inputs, got one u for each; make epochs anew")
            at = k.indices(len(self))[0]
            return Epochs(self._times, self._z, self._u, self._truth, rows, self._row_before(at), self._first + at)
        at = range(len(self))[k]
        i, before = self._rows[at], self._row_before(at)
        t = float(self._times[i])
        dt, u = (t - float(self._times[before]), _at(self._u, before)) if before >= 0 else (0.0, None)
        return Epoch(self._first + at, t, dt, u, _at(self._z, i), _at(self._truth, i))

    def _row_before(self, at: int) -> int:
        return self._rows[at - 1] if at else self._before

    def __add__(self, other: Iterable[Epoch]) -> list[Epoch]:
        return [*self, *other]


def _at(values: Any, k: int) -> Any:
    if values is None:
        return None
    return tuple(_at(v, k) for v in values) if isinstance(values, tuple) else values[k]


def epochs(times: ArrayLike, z: Any = None, u: Any = None, truth: Any = None) -> Epochs:
    """Epochs at ``times (T,)``, which may be irregular.

    Parameters
    ----------
    times: s, not decreasing. The first epoch has ``dt = 0``: it updates the prior.
    z: measurements ``(T, ..., m)``, time-major, nan where missing; a tuple of such arrays for several sensors.
    u: inputs; ``u[k]`` acts from ``times[k]`` to ``times[k + 1]``. A tuple is taken apart.
    truth: anything indexed by the epoch.

    >>> track = celnav.run(filter, prior, celnav.epochs(times, z)[:100])
    """
    t = finite("times", times)
    if t.ndim != 1 or len(t) == 0:
        raise ValueError(f"times: expected shape (T,) with T > 0, got {t.shape}")
    back = np.flatnonzero(np.diff(t) < 0.0)
    if len(back):
        k = int(back[0]) + 1
        raise ValueError(f"times: expected them not to decrease, got {t[k]} after {t[k - 1]} at index {k}")
    if z is not None:
        z = tuple(_measurements(v, len(t)) for v in z) if isinstance(z, tuple) else _measurements(z, len(t))
    for name, values, least in (("u", u, len(t) - 1), ("truth", truth, len(t))):
        for part in values if isinstance(values, tuple) else (values,):
            if part is not None and _rows(name, part) < least:
                raise ValueError(f"{name}: expected at least {least} rows for {len(t)} times, got {len(part)}")
    return Epochs(t, z, u, truth)


def _rows(name: str, values: Any) -> int:
    """How many rows there are."""
    try:
        if not isinstance(values, str):
            count = len(values)
            if count:
                values[0]  # a set or a table has none
            return count
    except (TypeError, KeyError, IndexError):
        pass
    raise ValueError(f"{name}: expected a sequence with a row for each time, got {kind(values)}")


def _measurements(z: ArrayLike, length: int) -> Array:
    measured = numbers("z", z)
    if measured.ndim < 2 or len(measured) != length:
        hint = "; one component is z[:, None]" if measured.shape == (length,) else ""
        raise ValueError(f"z: expected shape ({length}, ..., m) to go with the times, got {measured.shape}{hint}")
    if np.isinf(measured).any():
        k = int(np.argwhere(np.isinf(measured))[0, 0])
        raise ValueError(f"z: expected finite numbers or nan, got an infinite one at index {k}")
    return measured
