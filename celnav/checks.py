"""Numbers from outside: floats, finite or not, and whole ones; each error names the argument, what was expected and what came."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.linalg import Array


def numbers(name: str, value: Any) -> Array:
    """``value`` as float64, which may be the same array; what is masked becomes nan.

    Raises
    ------
    ValueError: naming it, for anything else than real numbers: dates and durations too, which would count in a unit of their own.
    """
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    try:
        if isinstance(value, list | tuple) and any(isinstance(part, np.ma.MaskedArray) for part in value):
            value = np.ma.stack(value)
        array = value if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
        kind = array.dtype.kind
        found = None if kind in "mMcSU" else np.ma.filled(array.astype(np.float64), np.nan)
    except (TypeError, ValueError):
        kind, found = "", None
    if kind in ("m", "M"):
        raise ValueError(f"{name}: expected numbers, got dates or durations; seconds are (t - t[0]) / numpy.timedelta64(1, 's')")
    if found is None:
        raise ValueError(f"{name}: expected numbers, got {value!r:.80}")
    return np.asarray(found)


def finite(name: str, value: ArrayLike | None, shape: tuple[int, ...] | None = None) -> Array:
    """A float64 copy of ``value``.

    Raises
    ------
    ValueError: naming it, if it is not numeric, not finite or not of ``shape``.
    """
    array = numbers(name, value).copy()
    if shape is not None and array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got {np.count_nonzero(~np.isfinite(array))} that are not")
    return array


def unmasked(name: str, value: Any) -> Any:
    """``value``, which a model gave.

    Raises
    ------
    ValueError: naming the model, if some of it is masked: what is missing at one point has no mean, and no measurement lacks it.
    """
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise ValueError(f"{name}: expected numbers, got masked ones; a component that was not measured is nan in z")
    return value


def integer(name: str, value: Any, least: int = 1) -> int:
    """A whole number of at least ``least``, which may have come as a float; ValueError names it if it is none."""
    number = whole(value)
    if number is None or number < least:
        expected = "a positive integer" if least == 1 else f"an integer of at least {least}"
        raise ValueError(f"{name}: expected {expected}, got {value!r}")
    return number


def whole(value: Any) -> int | None:
    """An integer that may have come as a float; None for anything else."""
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return int(value) if number and np.isfinite(value) and int(value) == value else None
