"""Checks of arguments: numbers, arrays, choices, functions.

Each ValueError names the argument, what was expected and what was passed. An argument is checked
once, when an object is made, and not again in each filter step.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from inspect import signature
from math import inf, isfinite
from typing import Any

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.tape.numbers import recorded

LIMIT = 1_000_000_000  # numbers (8 GB) that one argument may ask for
Shape = tuple[Any, ...]
"""Lengths of axes: an integer; a letter (any length from 1, the same for each axis with that
letter); None (any length). A leading ``...`` stands for any batch axes.
"""


def numbers(name: str, value: Any, shape: Shape | None = None) -> Array:
    """``value`` as a float64 array, copied only if necessary; masked entries, and None in a list,
    become nan.

    ValueError if the array does not have this `Shape`, or if it does not hold real numbers. Dates
    and durations raise it too, because they carry their own unit.
    """
    array: Array = (
        value
        if type(value) is np.ndarray and value.dtype == np.float64
        else _as_floats(name, value)
    )
    if shape is not None and not _fits(array.shape, shape):
        axes = ", ".join(
            "..." if axis is ... else "any" if axis is None else str(axis) for axis in shape
        )
        raise ValueError(
            f"{name}: expected shape ({axes}{',' * (len(shape) == 1)}), got {array.shape}"
        )
    return array


def _as_floats(name: str, value: Any) -> Any:
    if (traced := recorded(value)) is not None:
        return traced
    kind = "none"
    try:
        if isinstance(value, list | tuple) and any(
            isinstance(item, np.ma.MaskedArray) for item in value
        ):
            value = np.ma.stack(value)
        array = value if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
        kind = array.dtype.kind if value is not None else kind
        # Booleans, integers, unsigned integers, floats; or objects that convert, such as None.
        if kind in "biuf" or (
            kind == "O" and not any(isinstance(item, str | bytes) for item in array.flat)
        ):
            return np.ma.filled(array.astype(np.float64), np.nan)
    except (TypeError, ValueError, OverflowError):
        pass
    if kind in "mM":
        raise ValueError(
            f"{name}: expected numbers, got dates or durations; seconds are (t - t[0]) / "
            "numpy.timedelta64(1, 's')"
        )
    missing = "; use nan for missing entries, a row of nan for a row" if _has_none(value) else ""
    raise ValueError(f"{name}: expected numbers, got {value!r:.80}{missing}")


def _has_none(value: Any) -> bool:
    return isinstance(value, list | tuple) and any(
        item is None or _has_none(item) for item in value
    )


def _fits(lengths: tuple[int, ...], shape: Shape) -> bool:
    if shape[:1] == (...,):
        shape = shape[1:]
        lengths = lengths[max(len(lengths) - len(shape), 0) :]
    if lengths == shape:
        return True
    # A letter stands for the same length on each of its axes.
    letters: dict[str, int] = {}
    return len(lengths) == len(shape) and all(
        length > 0 and letters.setdefault(axis, length) == length
        if isinstance(axis, str)
        else axis in (None, length)
        for axis, length in zip(shape, lengths, strict=True)
    )


def finite(name: str, value: Any, shape: Shape | None = None) -> Array:
    """A float64 copy of ``value``; ValueError if an entry is not finite, or if the array does not
    have this `Shape`.
    """
    array = numbers(name, value, shape).copy()
    if array.dtype.hasobject:
        return array
    if not np.isfinite(array).all():
        raise ValueError(
            f"{name}: expected finite numbers, got {np.count_nonzero(~np.isfinite(array))} that "
            "are not"
        )
    return array


def as_matrix(name: str, value: Any, n: int | None) -> Array:
    """A finite matrix. A number becomes that multiple of the identity ``(n, n)``; it stays a number
    if n is None.
    """
    array = finite(name, value)
    return array if array.ndim or n is None else array * np.eye(n)


def unmasked(name: str, value: Any) -> Any:
    """The values that a model returned; ValueError names the model if an entry is masked, because
    the mean over sigma points needs every entry.
    """
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise ValueError(
            f"{name}: expected numbers, got masked ones; if a component was not measured, set it "
            "to nan in z instead"
        )
    return value


def number(
    name: str,
    value: Any,
    least: float = -inf,
    most: float = inf,
    *,
    above: float = -inf,
    below: float = inf,
) -> float:
    """A finite number, ``least <= value <= most`` and ``above < value < below``; ValueError
    otherwise.
    """
    try:
        candidate = float(finite(name, value, ()))
        if least <= candidate <= most and above < candidate < below:
            return candidate
    except ValueError:
        pass
    bounds = {"of at least": least, "above": above, "of at most": most, "below": below}
    said = " and ".join(f"{word} {bound:g}" for word, bound in bounds.items() if isfinite(bound))
    expected = {"": "a finite number", "above 0": "a positive number"}.get(said, f"a number {said}")
    raise ValueError(f"{name}: expected {expected}, got {value!r:.80}")


def integer(name: str, value: Any, least: int = 1, most: int | None = None) -> int:
    """An integer from ``least`` to ``most``, also of type float (3.0); ValueError otherwise."""
    candidate = as_integer(value)
    if candidate is None or candidate < least or (most is not None and candidate > most):
        bounds = "an integer" + (
            f" of at least {least}" if most is None else f" from {least} to {most}"
        )
        raise ValueError(
            f"{name}: expected {'a positive integer' if (least, most) == (1, None) else bounds}, "
            f"got {value!r:.80}"
        )
    return candidate


def as_integer(value: Any) -> int | None:
    """The integer equal to ``value``, also of type float (3.0); None for anything else."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, int) and not isinstance(value, bool):  # of any size
        return value
    number = isinstance(value, float | np.integer | np.floating)
    return int(value) if number and np.isfinite(value) and int(value) == value else None


def integers(
    name: str, value: Any, least: int = 0, most: int | None = None, count: int | None = None
) -> tuple[int, ...]:
    """A tuple of ``count`` integers from ``least`` to ``most`` (count None: any number of them);
    ValueError otherwise.
    """
    parts = np.asarray(value, dtype=object)
    candidates = [None] if parts.ndim != 1 else [as_integer(item) for item in parts]
    out = tuple(
        item
        for item in candidates
        if item is not None and least <= item and (most is None or item <= most)
    )
    if len(out) != len(candidates) or count not in (None, len(out)):
        bounds = "positive integers" if least == 1 else f"integers of at least {least}"
        expected = ("" if count is None else f"{count} ") + (
            bounds if most is None else f"integers from {least} to {most}"
        )
        raise ValueError(f"{name}: expected {expected}, got {value!r:.80}")
    return out


def choice(name: str, value: Any, options: Iterable[Any]) -> Any:
    """The ``value``, if it is one of the ``options`` (words or numbers); otherwise ValueError lists
    the options and suggests the closest.
    """
    names = list(options)
    value = value[()] if isinstance(value, np.ndarray) else value
    if (value is None or np.isscalar(value)) and value in names:
        return value
    close = get_close_matches(value, map(str, names), 1) if isinstance(value, str) else []
    hint = f"; did you mean {close[0]}?" if close else ""
    raise ValueError(
        f"{name}: expected one of {', '.join(map(str, names))}, got {value!r:.80}{hint}"
    )


def sequence(name: str, value: Any, example: str, least: int = 0) -> list[Any]:
    """The items of an iterable as a list; ValueError, with an ``example``, for a string, a dict, a
    scalar, or fewer than ``least`` items.
    """
    try:
        if not isinstance(value, str | bytes | dict):
            parts = list(value)
            if len(parts) < least:
                raise ValueError(f"{name}: expected a length of at least {least}, got {len(parts)}")
            return parts
    except TypeError:
        pass
    raise ValueError(f"{name}: expected a sequence, such as {example}, got {value!r:.80}")


def together(**batches: tuple[int, ...]) -> tuple[int, ...]:
    """Broadcast shape of batch axes; ValueError names all arguments if they do not broadcast."""
    try:
        return np.broadcast_shapes(*batches.values())
    except ValueError:
        shapes = ", ".join(map(str, batches.values()))
        raise ValueError(
            f"{', '.join(batches)}: expected batch axes that broadcast, got {shapes}"
        ) from None


def broadcast_batches(
    name: str, batch: tuple[int, ...], other: tuple[int, ...], whose: str
) -> tuple[int, ...]:
    """Broadcast shape of an argument's batch axes with the axes ``other`` of ``whose``; ValueError
    if they do not broadcast.
    """
    try:
        return np.broadcast_shapes(batch, other)
    except ValueError:
        raise ValueError(
            f"{name}: expected batch axes that broadcast with {other} of {whose}, got {batch}"
        ) from None


def function(name: str, value: Any, arguments: str, hint: str = "") -> Any:
    """The function, if it can be called with its ``arguments``, such as "(mean, epoch)"; ValueError
    otherwise.
    """
    if not accepts(value, arguments.count(",") + 1):
        other = " with other arguments" if callable(value) else ""
        raise ValueError(
            f"{name}: expected a function {arguments}, got {describe(value)}{other}{hint}"
        )
    return value


def instance(name: str, value: Any, of: Any, expected: str) -> Any:
    """The object, if it is an instance of the class or classes ``of``; otherwise ValueError says
    what was ``expected``.
    """
    if not isinstance(value, of):
        raise ValueError(f"{name}: expected {expected}, got {describe(value)}")
    return value


def describe(value: Any) -> str:
    """A short description for messages: a function or class by name, anything else by type."""
    if isinstance(value, type):
        return f"class {value.__name__}"
    return (
        f"function {value.__name__}"
        if callable(value) and hasattr(value, "__name__")
        else type(value).__name__
    )


def accepts(function: Any, count: int) -> bool:
    """Whether something can be called with ``count`` arguments, judged by its signature."""
    try:
        signature(function).bind(*(None,) * count)
    except TypeError:
        return False
    except ValueError:  # some functions written in C have no signature
        return callable(function)
    return True
