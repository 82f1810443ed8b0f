"""The ledger of a paper: its statements, its errata and our findings, decided by numbers with
intervals.

A `Row` defines how an entry is decided, and whether this was changed after a result. A `Claim` is a
row with its result. A number with sampling error is accepted if its whole 95 % interval lies in the
accepted range, and rejected if the interval and the range are disjoint. Otherwise it is undecided,
whatever the number of runs.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from celnav.analysis.metrics import bootstrap
from celnav.gaussian.checks import choice
from celnav.gaussian.linalg import Array

__all__ = [
    "BETWEEN",
    "KINDS",
    "OPEN",
    "VERDICTS",
    "WORDS",
    "Bounds",
    "Claim",
    "Decision",
    "Number",
    "Row",
    "Sentence",
    "Tiers",
    "check",
    "erratum",
    "estimate",
    "finding",
    "order",
    "read_ledger",
    "read_printed",
    "reconstruction",
    "remark",
    "statement",
]

Bounds = tuple[float | None, float | None]
WORDS: dict[str, tuple[str, str]] = {
    "statement": ("reproduced", "not reproduced"),
    "erratum": ("paper in error", "not shown"),
    "reconstruction": ("reconstructed", "not shown"),
    "remark": ("noted", "not shown"),
    "finding": ("shown", "not shown"),
    "check": ("holds", "does not hold"),
}
"""Kind -> verdict if the row holds, and verdict if it does not."""
KINDS = tuple(WORDS)
BETWEEN = ("reproduced with fitted parameters", "level only", "in part")
"""Verdicts of a statement between "reproduced" and "not reproduced"."""
OPEN = ("undecided", "not addressed", "not decidable", "no number")
"""Open verdicts: the interval does not decide, nothing was computed, nothing can be computed, nan.
"""
VERDICTS = tuple(
    dict.fromkeys(
        ["reproduced", *BETWEEN, *(word for pair in WORDS.values() for word in pair), *OPEN]
    )
)
"""All verdicts, in the order of tables."""


class Number(NamedTuple):
    """A number that decides a row.

    Attributes
    ----------
    label: meaning, with the unit. value: nan if there is none.
    accept: accepted range ``(low, high)``; None for no limit.
    ci: 95 % interval of ``value``; None for a number without sampling error.
    printed: the paper's value of the same quantity, in the same unit. A statement is not reproduced
        if `agreement` excludes it.
    strict: whether an interval that contains a limit of ``accept`` is rejected, not undecided.
    runs, printed_runs: number of runs behind ``value`` and ``printed``; 0 if unknown.
    printed_count: number of printed numbers in a statement. All of them together must agree with
        95 % probability.
    """

    label: str
    value: float
    accept: Bounds = (None, None)
    ci: tuple[float, float] | None = None
    printed: float | None = None
    strict: bool = False
    runs: int = 0
    printed_runs: int = 0
    printed_count: int = 1

    @property
    def holds(self) -> bool | None:
        """Whether the number is accepted; None if its interval does not decide, or if it is nan."""
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
    def agreement(self) -> tuple[float, float] | None:
        """Interval for the printed number: ``ci``, wider by the sampling error of ``printed_runs``
        runs.

        The paper's runs are assumed to have the variance of ours, so the variance increases by the
        factor ``1 + runs / printed_runs``. With several printed numbers each interval is wider, so
        that all of them hold together with 95 % probability.
        """
        if self.printed is None or self.ci is None:
            return None
        wider = float(ndtri(1.0 - 0.025 / self.printed_count) / ndtri(0.975))
        if self.printed_runs:
            wider *= float(np.sqrt(1.0 + self.runs / self.printed_runs))
        low, high = (self.value + wider * (end - self.value) for end in self.ci)
        return low, high

    @property
    def reproduces(self) -> bool | None:
        """Whether it `holds` and agrees with the printed number."""
        among = self.agreement
        excluded = among is not None and not among[0] <= (self.printed or 0.0) <= among[1]
        return False if excluded else self.holds

    def __format__(self, spec: str) -> str:
        """The value and its interval, such as "0.053 [0.048, 0.059]"; ``spec`` formats each number,
        ".3g" by default.
        """
        shown = format(self.value, spec or ".3g")
        return (
            shown
            if self.ci is None
            else f"{shown} [{self.ci[0]:{spec or '.3g'}}, {self.ci[1]:{spec or '.3g'}}]"
        )


Tiers = Mapping[str, Sequence[Number]]
"""Verdict -> numbers that must all hold for it; the best verdict is first. A verdict may repeat
numbers of better verdicts.
"""
Decision = Callable[[Any], Number | Sequence[Number] | Tiers]
"""A function of the results that gives the numbers of a row."""


def estimate(
    label: str,
    statistic: Callable[..., Any],
    samples: Sequence[Array],
    accept: Bounds = (None, None),
    block: int = 1,
    **more: Any,
) -> Number:
    """A `Number`: a statistic of runs, and its bootstrap interval. Runs are the first axis of each
    sample.

    For a single run the samples are its epochs, resampled in blocks of ``block`` epochs. ``more``:
    further fields of `Number`.
    """
    return Number(
        label,
        float(statistic(*samples)),
        accept,
        bootstrap(statistic, *samples, block=block),
        runs=len(samples[0]) if block == 1 else 0,
        **more,
    )


@dataclass(frozen=True)
class Row:
    """A row of the ledger, and how it is decided.

    Attributes
    ----------
    kind: one of `KINDS`. id: short, unique and stable.
    says: the statement, in our words. place: where the paper makes it.
    decide: ``(results) ->`` one `Number`, several that all must hold, or `Tiers`; None if nothing
        is computed.
    why: how the accepted range follows from the paper's words.
    found: our finding, in a sentence; "{0}" is replaced by the first number.
    printed: the paper's printed value, verbatim.
    expected: the verdict of earlier results; empty if the row holds.
    revised: date and reason of a change of the accepted range after a result, such as "2026-11-23:
        more runs".
    figure: stem of a figure that shows the result.
    needs: name of a part; the row is omitted without it (a part of an optional input).

    >>> half = celnav.study.numbers.ratio("error", "new", "old", "position", (None, 0.5))
    >>> row = celnav.study.ledger.Row("statement", "half", "It halves the error.", half, "Table 1")
    """

    kind: str
    id: str
    says: str
    decide: Decision | None = None
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
        if self.revised is not None and not re.match(r"\d{4}-\d\d-\d\d: \S", self.revised):
            raise ValueError(
                "revised: expected a date and a reason, such as '2026-11-23: more runs', "
                f"got {self.revised!r:.60}"
            )

    @property
    def needs_no_decision(self) -> bool:
        """Whether the verdict needs no number, for a defect of the text or an undecidable
        statement.
        """
        return self.expected in OPEN or self.kind in ("erratum", "reconstruction", "remark")

    def judged(self, results: Any, full: bool = True) -> Claim:
        """The row with its verdict, a `Claim`: the first tier whose numbers all hold, or
        "undecided" if an earlier tier is undecided.

        full: whether all runs were done. With fewer runs, "undecided" is not a surprise.
        """
        good, bad = WORDS[self.kind]
        expected = self.expected or good
        if self.decide is None:
            verdict = expected if self.needs_no_decision else OPEN[1]
            return Claim(self, (), verdict, expected, full)
        tiers = self.decide(results)
        if not isinstance(tiers, Mapping):
            tiers = {good: [tiers] if isinstance(tiers, Number) else tiers}
        exact = (WORDS["statement"][0], BETWEEN[0])  # verdicts that require the printed number
        outcomes = [
            Outcome(word, number, number.reproduces if word in exact else number.holds)
            for word, numbers in tiers.items()
            for number in numbers
        ]
        for _, number, _ in outcomes:
            for name in ("accept", "ci"):
                pair = getattr(number, name)
                if pair is not None and None not in pair and pair[0] > pair[1]:
                    raise ValueError(
                        f"{self.id}: {name}: expected (low, high) with low <= high, got {pair}"
                    )
        verdict = bad
        for word in tiers:
            of_tier = [outcome for outcome in outcomes if outcome.tier == word]
            if any(not np.isfinite(outcome.number.value) for outcome in of_tier):
                verdict = "no number"
            elif all(outcome.holds is not False for outcome in of_tier):
                verdict = word if all(outcome.holds for outcome in of_tier) else "undecided"
            else:
                continue
            break
        return Claim(self, tuple(outcomes), choice("verdict", verdict, VERDICTS), expected, full)


class Outcome(NamedTuple):
    """A number and whether it ``holds`` for a ``tier``; None if it is undecided."""

    tier: str
    number: Number
    holds: bool | None


statement, erratum, reconstruction = (
    partial(Row, "statement"),
    partial(Row, "erratum"),
    partial(Row, "reconstruction"),
)
remark, finding, check = partial(Row, "remark"), partial(Row, "finding"), partial(Row, "check")


@dataclass(frozen=True)
class Claim:
    """A row of the ledger with the outcomes of its numbers, and its verdict. ``full``: see
    `Row.judged`.
    """

    row: Row
    outcomes: tuple[Outcome, ...]
    verdict: str
    expected: str
    full: bool = True

    @property
    def id(self) -> str:
        """Id of the `Row`."""
        return self.row.id

    @property
    def kind(self) -> str:
        """Kind of the `Row`."""
        return self.row.kind

    @property
    def numbers(self) -> tuple[Number, ...]:
        """All computed numbers, without repetition."""
        return tuple(dict.fromkeys(outcome.number for outcome in self.outcomes))

    @property
    def decisive(self) -> Number | None:
        """The first number that does not hold, or the first number if all hold; None without
        numbers.
        """
        return next(
            (outcome.number for outcome in self.outcomes if not outcome.holds),
            (*self.numbers, None)[0],
        )

    @property
    def holds(self) -> bool | None:
        """Whether the row holds exactly as stated; None for a verdict in `OPEN`."""
        if self.verdict in OPEN:
            return None
        return self.verdict == WORDS[self.kind][0] or self.verdict == BETWEEN[0]

    @property
    def surprise(self) -> bool:
        """Whether the verdict is not the expected one; "undecided" counts with all runs only."""
        return self.verdict != self.expected and (self.full or self.verdict != "undecided")

    @property
    def note(self) -> str:
        """Our finding with the present numbers; empty if the verdict differs from the expected one,
        for which the finding was written.
        """
        if self.verdict != self.expected or not np.isfinite([n.value for n in self.numbers]).all():
            return ""
        return self.row.found.format(*self.numbers)


class Sentence(NamedTuple):
    """A sentence of a study's answer. It is shown only if each row in ``rests_on`` has the verdict
    given there.

    text: "{row[0]:.2f}" is replaced by the first number of a row. rests_on: verdicts by row id.
    """

    text: str
    rests_on: Mapping[str, str]


# -- prose in a file -------------------------------------------------------------------------------
FIELDS = {
    "row": [field.name for field in fields(Row) if field.name != "decide"],
    "sentence": list(Sentence._fields),
}
"""Tables of a ledger's file, and their fields. All fields are strings, except ``printed`` and
``rests_on``.
"""


def read_ledger(
    path: str | Path, decisions: Mapping[str, Decision]
) -> tuple[list[Row], list[Sentence]]:
    """Read the rows and sentences of a study from a TOML file, in the order of the file.

    Each table ``[[row]]`` has the fields of a `Row` except ``decide``; ``decisions`` has these
    functions by row id. Each table ``[[sentence]]`` has the fields of a `Sentence`. A line break in
    a text becomes a space.

    >>> row = "[[row]]\\nkind = 'finding'\\nid = 'half'\\nsays = 'It halves the error.'"
    >>> _ = Path("ledger.toml").write_text(row)
    >>> half = celnav.study.numbers.ratio("error", "new", "old", "position", (None, 0.5))
    >>> rows, sentences = read_ledger("ledger.toml", {"half": half})

    Raises
    ------
    ValueError: if a field is wrong, or if rows, decisions and sentences do not match; it names the
        file and the id. OSError: if the file cannot be read.
    """
    tables = _read_tables(path)
    rows: dict[str, Row] = {}
    for table in tables["row"]:
        where = f"{path}, row {table['id']!r}"
        if table["id"] in rows:
            raise ValueError(f"{where}: expected different ids, got this id twice; rename a row")
        try:
            row = Row(**table, decide=decisions.get(table["id"]))
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None
        if row.decide is None and not row.needs_no_decision:
            raise ValueError(
                f"{where}: expected a decision for this id, got none; add it in Python"
            )
        rows[row.id] = row
    for id in decisions:
        choice(f"{path}, decision {id!r}: add its [[row]], or rename one; id", id, rows)
    sentences = [Sentence(**table) for table in tables["sentence"]]
    for sentence in sentences:
        for id, verdict in sentence.rests_on.items():
            where = f"{path}, sentence {sentence.text!r:.40}: rests_on"
            choice(where, id, rows)
            choice(f"{where} {id!r}", verdict, VERDICTS)
    return list(rows.values()), sentences


def read_printed(path: str | Path) -> dict[str, Any]:
    """Printed values of a paper by row id, from the file of `read_ledger`.

    Raises
    ------
    ValueError, OSError: as `read_ledger`.
    """
    rows = _read_tables(path)["row"]
    return {table["id"]: table["printed"] for table in rows if "printed" in table}


def _read_tables(path: str | Path) -> dict[str, list[dict[str, Any]]]:
    """Checked tables by kind; each text is on one line. ValueError for unknown, missing or wrong
    fields.
    """
    try:
        content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: expected TOML, got an error: {error}; fix that line") from None
    for kind in content:
        choice(f"{path}: table", kind, FIELDS)
    required = {"row": ("kind", "id", "says"), "sentence": ("text", "rests_on")}
    tables: dict[str, list[dict[str, Any]]] = {}
    for kind, names in required.items():
        tables[kind] = []
        for table in content.get(kind, []):
            where = f"{path}, {kind} {table.get(names[1], table.get(names[0], ''))!r:.40}"
            for name, value in table.items():
                choice(f"{where}: field", name, FIELDS[kind])
                expected = {"printed": object, "rests_on": dict}.get(name, str)
                if not isinstance(value, expected):
                    raise ValueError(
                        f"{where}: {name}: expected a {expected.__name__}, got {value!r:.60}"
                    )
                if isinstance(value, str):
                    table[name] = " ".join(value.split())
            for name in names:
                if not table.get(name):
                    raise ValueError(f"{where}: {name}: expected a value, got none; add it")
            tables[kind].append(table)
    return tables


def order(value: float) -> float:
    """The smallest power of ten at or above a value, for quantities such as round-off whose digits
    differ between machines; 0 for values up to 0.
    """
    return 10.0 ** float(np.ceil(np.log10(value))) if value > 0.0 else 0.0
