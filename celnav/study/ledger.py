"""The ledger of a paper: what it states, what it prints wrongly, what we found, each decided by numbers with intervals.

A `Row` says how something is decided, and if that was changed after a result; a `Claim` is what came of it. A number that has
sampling error is accepted only if its whole 95 % interval is, and refused only if none of it is: else it is undecided, with few
runs as with many.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from celnav.analysis.metrics import bootstrap
from celnav.gaussian.checks import choice
from celnav.gaussian.linalg import Array

__all__ = [
    "BETWEEN", "KINDS", "OPEN", "VERDICTS", "WORDS", "Bounds", "Claim", "Number", "Row", "Tiers", "check", "erratum", "estimate",
    "finding", "order", "reconstruction", "remark", "statement",
]  # fmt: skip

Bounds = tuple[float | None, float | None]
WORDS: dict[str, tuple[str, str]] = {
    "statement": ("reproduced", "not reproduced"),
    "erratum": ("paper in error", "not shown"),
    "reconstruction": ("reconstructed", "not shown"),
    "remark": ("noted", "not shown"),
    "finding": ("shown", "not shown"),
    "check": ("holds", "does not hold"),
}
"""Kind -> verdict where it holds, and where it does not."""
KINDS = tuple(WORDS)
BETWEEN = ("reproduced with fitted parameters", "level only", "in part")
"""Verdicts of a statement that are less than "reproduced", and more than nothing."""
OPEN = ("undecided", "not addressed", "not decidable", "no number")
"""Neither: by the interval; nothing was computed; nothing could be; what was computed is nan."""
VERDICTS = tuple(
    dict.fromkeys(
        ["reproduced", *BETWEEN, *(word for pair in WORDS.values() for word in pair), *OPEN]
    )
)
"""All that there are, in the order of tables."""


class Number(NamedTuple):
    """A number that decides something.

    Attributes
    ----------
    label: what it is, with its unit. value: nan where there is none. accept: ``(low, high)``, either may be None.
    ci: 95 % interval of ``value``; None for a number without sampling error.
    printed: what the paper has for it: a statement is not reproduced by a number whose interval excludes that.
    strict: an interval that contains a bar is refused, not undecided.
    """

    label: str
    value: float
    accept: Bounds = (None, None)
    ci: tuple[float, float] | None = None
    printed: float | None = None
    strict: bool = False

    @property
    def holds(self) -> bool | None:
        """Whether it is acceptable; None where its interval does not decide that, or there is no number."""
        low, high = (
            end if bound is None else bound
            for end, bound in zip((-np.inf, np.inf), self.accept, strict=True)
        )
        least, most = (self.value, self.value) if self.ci is None else self.ci
        if low <= least and most <= high:
            return True
        return (
            False
            if most < low or least > high or (self.strict and np.isfinite(self.value))
            else None
        )

    @property
    def reproduces(self) -> bool | None:
        """Whether it `holds` and its interval has the printed number in it."""
        excluded = (
            self.printed is not None
            and self.ci is not None
            and not self.ci[0] <= self.printed <= self.ci[1]
        )
        return False if excluded else self.holds

    def __format__(self, spec: str) -> str:
        """The value and its interval, "0.053 [0.048, 0.059]"; what a ``spec`` other than ".3g" asks for is of each of them."""
        shown = format(self.value, spec or ".3g")
        return (
            shown
            if self.ci is None
            else f"{shown} [{self.ci[0]:{spec or '.3g'}}, {self.ci[1]:{spec or '.3g'}}]"
        )


Tiers = Mapping[str, Sequence[Number]]
"""Verdict -> numbers that must all hold for it, the best one first; it may need numbers of better ones again."""


def estimate(
    label: str,
    statistic: Callable[..., Any],
    samples: Sequence[Array],
    accept: Bounds = (None, None),
    block: int = 1,
    **more: Any,
) -> Number:
    """A statistic of runs (the first axis of each sample) with its bootstrap interval; ``more``: see `Number`.

    Of one run the samples are its epochs, drawn in blocks of so many.
    """
    return Number(
        label,
        float(statistic(*samples)),
        accept,
        bootstrap(statistic, *samples, block=block),
        **more,
    )


@dataclass(frozen=True)
class Row:
    """How something that is said is decided.

    Attributes
    ----------
    kind: one of `KINDS`. id: short, unique and stable. place: where the paper says it. says: what, in our words.
    decide: ``(results) ->`` one `Number`, several that all have to hold, or `Tiers`; None: nothing is computed.
    why: how the accepted range follows from the paper's words. found: what we find, in a sentence; "{0}" is the first number.
    printed: what the paper prints, verbatim. expected: the verdict that we know of; empty: that it holds.
    revised: when and why the accepted range was changed after a result was seen. figure: stem of one that shows it.
    needs: a part without which nothing is said, as that of an optional input.

    >>> half = celnav.study.numbers.ratio("error", "new", "old", "position", (None, 0.5))
    >>> row = celnav.study.ledger.Row("statement", "half", "It halves the error.", half, place="Table 1", why="the word")
    """

    kind: str
    id: str
    says: str
    decide: Callable[[Any], Number | Sequence[Number] | Tiers] | None = None
    place: str = ""
    why: str = ""
    found: str = ""
    printed: Any = None
    expected: str = ""
    revised: str | None = None
    figure: str = ""
    needs: str = ""

    def __post_init__(self) -> None:
        choice("kind", self.kind, KINDS)
        choice("expected", self.expected, ("", *VERDICTS))

    def judged(self, results: Any) -> Claim:
        """The verdict: that of the first tier whose numbers all hold; "undecided" if one before it is."""
        good, bad = WORDS[self.kind]
        expected = self.expected or good
        if self.decide is None:
            verdict = (
                expected
                if expected in OPEN or self.kind in ("erratum", "reconstruction", "remark")
                else OPEN[1]
            )
            return Claim(self, (), verdict, expected)
        found = self.decide(results)
        tiers = (
            found
            if isinstance(found, Mapping)
            else {good: [found] if isinstance(found, Number) else found}
        )
        verdict = bad
        for word, numbers in tiers.items():
            outcomes = [
                n.reproduces if word in (WORDS["statement"][0], BETWEEN[0]) else n.holds
                for n in numbers
            ]
            if any(not np.isfinite(n.value) for n in numbers):
                verdict = "no number"
            elif False not in outcomes:
                verdict = word if all(outcomes) else "undecided"
            else:
                continue
            break
        told = list(dict.fromkeys(n for numbers in tiers.values() for n in numbers))
        return Claim(self, tuple(told), choice("verdict", verdict, VERDICTS), expected)


statement, erratum, reconstruction = (
    partial(Row, "statement"),
    partial(Row, "erratum"),
    partial(Row, "reconstruction"),
)
remark, finding, check = partial(Row, "remark"), partial(Row, "finding"), partial(Row, "check")


@dataclass(frozen=True)
class Claim:
    """A row of the ledger with its numbers and verdict."""

    row: Row
    numbers: tuple[Number, ...]
    verdict: str
    expected: str

    @property
    def id(self) -> str:
        """As in the `Row`."""
        return self.row.id

    @property
    def kind(self) -> str:
        """As in the `Row`."""
        return self.row.kind

    @property
    def holds(self) -> bool | None:
        """Whether what is said is so, as it is said; None where that is open."""
        if self.verdict in OPEN:
            return None
        return self.verdict == WORDS[self.kind][0] or self.verdict == BETWEEN[0]

    @property
    def failure(self) -> bool:
        """Whether the outcome is not the expected one, in either direction."""
        return self.verdict not in ("undecided", self.expected)

    @property
    def note(self) -> str:
        """What we find, with the numbers at hand."""
        known = np.isfinite([n.value for n in self.numbers]).all()
        return (
            self.row.found.format(*self.numbers)
            if known and (self.numbers or "{" not in self.row.found)
            else ""
        )


def order(value: float) -> float:
    """The power of ten at or above a size of which only that means anything: the digits of round-off differ between machines."""
    return 10.0 ** float(np.ceil(np.log10(value))) if value > 0.0 else 0.0
