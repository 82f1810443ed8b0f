"""Parameters of studies, with a meaning, a source and checks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import field, fields
from typing import Any

import numpy as np

from celnav.gaussian.checks import choice, finite, integer, number
from celnav.gaussian.linalg import Array

__all__ = ["SOURCES", "Parameters", "Timed", "param"]

SOURCES = ("paper", "inferred", "chosen")
"""Sources of a value: printed in the paper; inferred from printed values; chosen by us, because
nothing is printed.
"""


def param(
    value: Any, source: str, meaning: str, *, one_of: tuple[Any, ...] = (), **bounds: float
) -> Any:
    """A field of a `Parameters` class.

    value: the default; other values must have its type.
    source: one of `SOURCES`; a reason may follow after a colon.
    meaning: in words; the unit is in the parameter's name.
    one_of: the possible values of a word.
    bounds: least, most, above, below; for a number, or for each number of a tuple.

    >>> step_s: float = param(1.0, "paper", "interval of the measurements", above=0.0)
    """
    choice("source", source.partition(":")[0], SOURCES)
    return field(
        default=value,
        metadata={"source": source, "meaning": meaning, "one_of": one_of, "bounds": bounds},
    )


class Parameters:
    """Base of frozen dataclasses that check `param` fields; ValueError names a wrong field."""

    def __post_init__(self) -> None:
        for f in fields(self):  # type: ignore[arg-type]
            if "source" in f.metadata:
                _check(f.name, getattr(self, f.name), f.default, **f.metadata)
        self.check()

    def check(self) -> None:
        """Raise ValueError for invalid combinations of parameters; subclasses may override it."""


class Timed(Parameters, ABC):
    """Base of a configuration: parameters that determine the epochs of a run."""

    @property
    @abstractmethod
    def times(self) -> Array:
        """Epochs ``(T,)`` s of a run."""

    @property
    def samples(self) -> int:
        """Number of steps of a run."""
        return len(self.times) - 1

    @property
    def end_s(self) -> float:
        """The last epoch, s."""
        return float(self.times[-1])


def _check(
    name: str, value: Any, default: Any, one_of: tuple[Any, ...], bounds: dict[str, float], **_: str
) -> None:
    if one_of or isinstance(default, bool):
        if value is not None or None not in one_of:
            choice(name, value, [word for word in one_of if word is not None] or (True, False))
    elif isinstance(default, int):
        integer(name, value, **bounds)  # type: ignore[arg-type]
    elif isinstance(default, float):
        number(name, value, **bounds)
    elif isinstance(default, tuple) and not isinstance(default[0], str):
        for part in finite(name, value, np.shape(default)).flat:
            number(name, float(part), **bounds)
