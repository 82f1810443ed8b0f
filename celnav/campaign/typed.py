"""Values of a file as Python types, and units from the endings of parameter names."""

from __future__ import annotations

import types
import typing
from dataclasses import fields, is_dataclass
from typing import Any

_DIMENSIONS = (
    "km",
    "m",
    "s",
    "deg",
    "arcsec",
    "h",
    "hz",
    "g",
    "ug",
    "rad",
    "m2",
    "s2",
    "s3",
    "sqrt_h",
    "sqrt_hz",
)
LARGEST = 1e300
"""Largest magnitude of a number in a file."""
_PRINTED = {
    "hz": "Hz",
    "m2": "m^2",
    "s2": "s^2",
    "s3": "s^3",
    "sqrt_h": "sqrt(h)",
    "sqrt_hz": "sqrt(Hz)",
}


def unit_of(key: str) -> str:
    """Unit from the ending of a parameter's name, ``sigma_km`` -> "km", ``drift_deg_per_h`` ->
    "deg/h"; empty if there is none.
    """
    above, per, below = key.rpartition(".")[2].rpartition("_per_")
    if not per:
        above, below = below, ""
    top = next(
        (d for d in sorted(_DIMENSIONS, key=len, reverse=True) if above.endswith(f"_{d}")), ""
    )
    if not top or (per and below not in _DIMENSIONS):
        return ""
    return _PRINTED.get(top, top) + (f"/{_PRINTED.get(below, below)}" if per else "")


def depth(value: Any) -> int:
    """Nesting depth of lists in a value."""
    return 1 + max((depth(v) for v in value), default=0) if isinstance(value, list) else 0


def type_depth(hint: Any) -> int:
    """Nesting depth of lists in values of a type."""
    return 1 + type_depth(typing.get_args(hint)[0]) if typing.get_origin(hint) is tuple else 0


def described(of: type) -> dict[str, tuple[str, str, tuple[Any, ...]]]:
    """Meaning, source and possible words of each parameter of a configuration; nested parameters
    have dotted names.
    """
    parameters: dict[str, tuple[str, str, tuple[Any, ...]]] = {}
    hints = typing.get_type_hints(of)
    for f in fields(of):
        if is_dataclass(hints[f.name]) and isinstance(hints[f.name], type):
            parameters |= {
                f"{f.name}.{key}": about for key, about in described(hints[f.name]).items()
            }
        else:
            parameters[f.name] = (
                f.metadata.get("meaning", ""),
                f.metadata.get("source", ""),
                f.metadata.get("one_of", ()),
            )
    return parameters


_WORDS = {
    float: "a number",
    int: "a whole number",
    str: "a word",
    bool: "true or false",
    list: "a list",
    dict: "a table",
}


def typed(name: str, value: Any, hint: Any) -> Any:
    """A value of a file, checked and converted to a Python type.

    Raises
    ------
    ValueError: naming ``name``, its unit, what was expected and what came.
    """
    if typing.get_origin(hint) is types.UnionType:
        hint = next(part for part in typing.get_args(hint) if part is not type(None))
    if typing.get_origin(hint) is tuple:
        parts = typing.get_args(hint)
        if not isinstance(value, list):
            raise ValueError(f"{named(name)}: expected a list, got {value!r:.80}")
        if parts[-1] is not Ellipsis and len(value) != len(parts):
            raise ValueError(f"{named(name)}: expected {len(parts)} values, got {len(value)}")
        return tuple(typed(name, v, parts[0]) for v in value)
    number = (
        isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST
    )
    if hint is float and number:
        return float(value)
    if hint is int and number and float(value).is_integer():
        return int(value)
    if hint not in (float, int) and type(value) is hint:
        return value
    raise ValueError(f"{named(name)}: expected {_WORDS[hint]}, got {value!r:.80}")


def named(name: str) -> str:
    """A key and its unit, for messages."""
    unit = unit_of(name)
    return f"{name} ({unit})" if unit else name
