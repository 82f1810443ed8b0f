"""Claims: what is said, what we got, and the verdict, computed by one rule."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from types import NoneType
from typing import Any

import numpy as np

from celnav.analysis.metrics import bootstrap
from celnav.gaussian.linalg import Array

_VERDICTS = {
    "paper": ("reproduced", "not reproduced"),
    "calibrated": ("reproduced (calibrated)", "not reproduced"),
    "erratum": ("paper in error", "not shown"),
    "beyond": ("shown", "not shown"),
}
KINDS = tuple(_VERDICTS)
VERDICTS = (
    "reproduced", "reproduced (calibrated)", "not reproduced", "paper in error", "shown", "not shown", "undecided", "input absent",
)  # fmt: skip
"""All that there are, in the order of tables."""

Bounds = tuple[float | None, float | None]


@dataclass(frozen=True)
class Claim:
    """One statement and the number that decides it.

    Attributes
    ----------
    id: short and unique, "table-2-position-ratio". kind: one of `KINDS`: what the paper claims; the same with parameters chosen
        so that it comes out; what the paper states and we show wrong; what the paper lacks.
    value: computed from the run at hand; None where an optional input is absent.
    accept: ``(low, high)``, either may be None; it does not widen with fewer runs.
    expected: whether the claim should hold, as found before.
    paper: what the paper prints. ci: interval of ``value``; None for a number without sampling error.
    full: whether the run had the full number of runs.
    """

    id: str
    kind: str
    statement: str
    value: float | None
    accept: Bounds
    expected: bool = True
    paper: Any = None
    ci: tuple[float, float] | None = None
    full: bool = True
    note: str = ""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {self.kind!r}")

    @property
    def holds(self) -> bool | None:
        """Whether the value is acceptable; None where that is undecided or an input is absent."""
        if self.value is None or not np.isfinite(self.value):
            return None
        low, high = (end if bound is None else bound for end, bound in zip((-np.inf, np.inf), self.accept, strict=True))
        least, most = (self.value, self.value) if self.full or self.ci is None else self.ci
        if low <= least and most <= high:
            return True
        return False if most < low or least > high else None

    @property
    def verdict(self) -> str:
        """In words, one of `VERDICTS`."""
        if self.holds is None:
            return "input absent" if self.value is None or not np.isfinite(self.value) else "undecided"
        return _VERDICTS[self.kind][0 if self.holds else 1]

    @property
    def failure(self) -> bool:
        """Whether the outcome is not the expected one, in either direction."""
        return self.holds is not None and self.holds != self.expected

    def to_dict(self) -> dict[str, Any]:
        """As it stands in ``claims.json``; numbers have 6 significant digits."""
        numbers = {key: _plain(getattr(self, key)) for key in ("paper", "value", "ci")}
        return {key: getattr(self, key) for key in TYPES} | numbers | {"accept": list(self.accept)}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_plain(part) for part in value]
    if isinstance(value, (bool, str)) or value is None:
        return value
    return float(f"{float(value):.6g}") if np.isfinite(value) else None


class Judge:
    """Makes the claims of a study with the ``full`` number of runs, or not; what else a claim has is named as in `Claim`."""

    def __init__(self, full: bool):
        self.full = full

    def number(self, id: str, kind: str, statement: str, value: float, accept: Bounds, **more: Any) -> Claim:
        """A claim on a number without sampling error, or with an interval ``ci`` known otherwise."""
        return Claim(id, kind, statement, float(value), accept, full=self.full, **more)

    def statistic(
        self, id: str, kind: str, statement: str, of: Callable[..., Any], samples: Sequence[Array], accept: Bounds, **more: Any
    ) -> Claim:
        """A claim on a statistic of runs (the first axis of each sample), with its bootstrap interval."""
        return self.number(id, kind, statement, of(*samples), accept, ci=bootstrap(of, *samples), **more)

    def lengthy(self, *arguments: Any, **named: Any) -> Claim:
        """A `statistic` that depends on how long the runs are: undecided where they are shortened."""
        return self.whole(self.statistic(*arguments, **named))

    def whole(self, claim: Claim) -> Claim:
        """The claim, undecided unless runs have their whole length."""
        return claim if self.full else replace(claim, ci=(-np.inf, np.inf))


def about(value: float, part: float) -> Bounds:
    """A value within a part of itself."""
    return value - abs(value) * part, value + abs(value) * part


def within(value: float, size: float) -> Bounds:
    """A value within a size."""
    return value - size, value + size


def order(value: float) -> float:
    """The power of ten at or above a size of which only that means anything: the digits of round-off differ between machines."""
    return 10.0 ** float(np.ceil(np.log10(value))) if value > 0.0 else 0.0


def dumps(claims: Iterable[Claim]) -> str:
    """The text of ``claims.json``; ValueError if two claims have the same id."""
    listed = list(claims)
    twice = sorted(id for id, count in Counter(claim.id for claim in listed).items() if count > 1)
    if twice:
        raise ValueError(f"claims: expected different ids, got {', '.join(twice)} more than once")
    return json.dumps([claim.to_dict() for claim in listed], indent=1, ensure_ascii=False, allow_nan=False) + "\n"


NUMBER = (int, float, NoneType)
TYPES: dict[str, tuple[type, ...]] = {
    "id": (str,), "kind": (str,), "statement": (str,), "paper": (str, bool, *NUMBER), "value": NUMBER, "ci": (list, NoneType),
    "accept": (list,), "expected": (bool,), "holds": (bool, NoneType), "verdict": (str,), "note": (str,),
}  # fmt: skip
"""What `Claim.to_dict` writes, in its order. Lists are pairs of numbers."""
