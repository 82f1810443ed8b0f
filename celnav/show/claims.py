"""The ledger as tables for people and as files: place, printed number, our number, verdict."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from celnav.files import InputError, read_json
from celnav.study.ledger import BETWEEN, KINDS, OPEN, VERDICTS, WORDS, Claim, Sentence

WrittenClaim = Mapping[str, Any]
"""A claim in the form that `written` returns."""
COLUMNS = ("Verdict", "Statement", "Quantity", "Printed", "Ours", "Accepted range")
WIDE = 10.0
"""Ratio of an interval's ends above which a note says "few runs or a heavy tail"."""
FEW = (
    "Only a part of the runs was done: intervals are wide, "
    "and what they do not decide is undecided."
)
_GOOD = {BETWEEN[0], *(WORDS[kind][0] for kind in ("statement", "finding", "check"))}
_BAD = {words[1] for words in WORDS.values()}
SIGNS = {
    "reproduced": ("#00795a", "✓"),
    "reproduced with fitted parameters": ("#3f7d23", "✓*"),
    "level only": ("#8a6d00", "≈"),
    "in part": ("#b35c00", "½"),
    "not reproduced": ("#b02a1a", "✗"),
}
"""Colors, on which white has a contrast of at least 4.5, and signs."""
OTHER = "#6b6b6b", "?"
MEANINGS = {
    "reproduced": "its numbers lie in the accepted ranges with their 95 % intervals, and agree "
    "with the printed number if there is one",
    "reproduced with fitted parameters": "the same, but parameters that the paper does not give "
    "were chosen so that the numbers agree",
    "level only": "the numbers have the printed order of magnitude (a factor of 3.2 at most), but "
    "differ by more than sampling error",
    "in part": "a weaker form of the statement holds, or one reading of it; the row says which",
    "not reproduced": "a number lies outside its accepted range, and no weaker form holds",
    "undecided": "a 95 % interval contains a limit of the accepted range",
    "not addressed": "nothing was computed",
    "not decidable": "the paper does not say enough for a number to decide",
    "no number": "a number that decides is not finite",
}
"""What each verdict on a statement means."""


def mark(verdict: str) -> tuple[str, str]:
    """Color and sign of a verdict on a statement."""
    return SIGNS.get(verdict, OTHER)


def meaning(verdict: str) -> str:
    """What a verdict on a statement means."""
    return MEANINGS.get(verdict, "")


def style(verdict: str) -> str:
    """Style of a verdict: "good" if it holds, "bad" if not, "error" (a paper's), "open", "part"."""
    if verdict in _GOOD:
        return "good"
    if verdict in _BAD:
        return "bad"
    if verdict in OPEN:
        return "open"
    return "error" if verdict == WORDS["erratum"][0] else "part"


def decisive(claim: WrittenClaim) -> WrittenClaim | None:
    """The number that decides a claim: the first that prevents the best verdict, else the first."""
    numbers = claim["numbers"]
    return next((n for n in numbers if not n["holds"]), numbers[0] if numbers else None)


def cells(claim: WrittenClaim) -> dict[str, str]:
    """The cell of each of `COLUMNS`; all numbers are of the one quantity that decides."""
    number = decisive(claim)
    texts = [claim["verdict"], claim["statement"], "", "", "", ""]
    if number is not None:
        texts[2:] = number["label"], printed(number), ours(number), accepted(number)
    return dict(zip(COLUMNS, texts, strict=True))


def columns(claims: Sequence[WrittenClaim]) -> list[str]:
    """Those of `COLUMNS` in which at least one claim has an entry."""
    every = [cells(claim) for claim in claims]
    return [name for name in COLUMNS if not every or any(row[name] for row in every)]


def printed(number: WrittenClaim) -> str:
    """The paper's value of the same quantity, verbatim; empty if it prints none."""
    return "" if number["printed"] is None else str(number["printed"])


def _printed(value: Any) -> str:
    """The paper's printed value, verbatim; if it has more than four numbers, their count."""
    flat = list(_flat(value))
    return ", ".join(map(str, flat)) if len(flat) <= 4 else f"{len(flat)} numbers"


def _flat(value: Any) -> Iterable[Any]:
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from _flat(item)
    elif value is not None:
        yield value


def ours(number: WrittenClaim) -> str:
    """A number with its 95 % interval: "0.71 [0.56, 0.87]"."""
    value, ci = number["value"], number["ci"]
    if value is None:
        return ""
    shown = [_rounded(x, number) for x in (value, *(ci or ())) if x is not None]
    if len(shown) < 3 or len(set(shown)) == 1:
        return shown[0]
    heavy = ", few runs or a heavy tail" if 0.0 < WIDE * ci[0] < ci[1] else ""
    return f"{shown[0]} [{shown[1]}, {shown[2]}]{heavy}"


def _rounded(x: float, number: WrittenClaim) -> str:
    """A value of a number without an exponent, unless it is tiny.

    It has three digits. It has up to six if the paper prints more, or if fewer do not show the
    width of the interval or on which side of a bound the value lies.
    """
    if 0.0 < abs(x) < 1e-4:
        return _typeset(f"{x:.3g}")
    value, ci = number["value"], number["ci"]
    ends = [] if ci is None or None in ci else ci
    if all(float(end).is_integer() for end in (value, *ends)):
        return f"{x:.0f}"
    lengths = [abs(value - bound) for bound in number["accept"] if bound is not None]
    lengths += [(ends[1] - ends[0]) / 3.0] if ends else []
    places = [2 - _decade(abs(x) or 1.0), *(-_decade(length) for length in lengths if length > 0.0)]
    if printed(number):
        places.append(len(printed(number).partition(".")[2]))
    shown = min(max(places), 5 - _decade(abs(x) or 1.0))
    return f"{round(x, shown):.{max(shown, 0)}f}"


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _typeset(number: str) -> str:
    """A number as a person writes it: "8.12e-16" is "8.12·10⁻¹⁶"."""
    factor, _, power = number.partition("e")
    if not power:
        return number
    front = "" if factor == "1" else f"{factor}·"
    return f"{front}10{str(int(power)).translate(_RAISED)}"


def _decade(x: float) -> int:
    """The place of the first digit: 0 for 5.2, -1 for 0.52."""
    return int(np.floor(np.log10(x)))


def accepted(number: WrittenClaim) -> str:
    """The accepted range of a number, and where the printed value has to lie; empty for a number
    that decides nothing.
    """
    low, high = number["accept"]
    least, most = (_typeset(f"{end or 0.0:.15g}") for end in (low, high))
    strictly = "<" if high == number["value"] and number["holds"] is False else "≤"
    text = "" if high is None else f"{strictly} {most}"
    if low is not None:
        strictly = ">" if low == number["value"] and number["holds"] is False else "≥"
        text = f"{strictly} {least}" if high is None else f"{least} to {most}"
    if low is not None and low == high:
        text = least
    if (among := number["agreement"]) and None not in among:
        text += (
            f"; the printed value from {_rounded(among[0], number)} to {_rounded(among[1], number)}"
        )
    return text.removeprefix("; ")


def tally(claims: Iterable[WrittenClaim]) -> dict[str, int]:
    """Number of claims by verdict, in the order of `VERDICTS`."""
    count = Counter(claim["verdict"] for claim in claims)
    return {verdict: count[verdict] for verdict in VERDICTS if count[verdict]}


def counted(claims: Iterable[WrittenClaim]) -> str:
    """The same in words: "4 reproduced, 1 undecided"."""
    return ", ".join(f"{number} {verdict}" for verdict, number in tally(claims).items())


def notes(claim: WrittenClaim) -> list[str]:
    """Sentences below a claim: what we find, what the paper prints, the criterion, and when it was
    revised.
    """
    texts = [claim["note"]]
    values = _printed(claim["printed"])
    if values != cells(claim)["Printed"]:
        texts.append(values and f"The paper prints {values}.")
    texts.append(claim["why"] and f"The criterion: {claim['why']}")
    texts.append(claim["revised"] and f"Accepted range revised: {claim['revised']}")
    return [text for text in texts if text]


def outcome(number: WrittenClaim) -> str:
    """Whether a number meets its criterion; empty for a number that decides nothing."""
    if number["accept"] == [None, None] and number["printed"] is None:
        return ""
    return {True: "met", False: "not met", None: "undecided"}[number["holds"]]


class Ledger:
    """Claims as a table for a notebook (HTML), Markdown or a terminal.

    In HTML a statement's verdict links to the cell that decides it. found: sentences that answer
    for all claims, see `answer`.

    >>> Ledger(results.claims(), found=csrukf.STUDY.found)
    """

    def __init__(
        self, claims: Sequence[Claim], kind: str = "statement", found: Sequence[Sentence] = ()
    ):
        self._claims = [written(claim) for claim in claims if claim.kind == kind]
        self._head = [] if all(claim.full for claim in claims) else [FEW]
        if found:
            self._head.append(f"We find: {answer(found, map(written, claims))}")

    def __str__(self) -> str:
        lines = [f"{c['verdict']:24} {cells(c)['Ours']:26}  {c['statement']}" for c in self._claims]
        return "\n".join([*self._head, *lines])

    def _repr_markdown_(self) -> str:
        return "\n\n".join([*self._head, ledger(self._claims)])

    def _repr_html_(self) -> str:
        from celnav.show.page import macro

        style = f"<style>{macro('cards_style')}</style>"
        table = macro("ledger", self._claims, anchor="#say-")
        return macro("paragraphs", self._head) + style + table


def ledger(claims: Sequence[WrittenClaim]) -> str:
    """A table in Markdown, a row for each claim."""
    return markdown([COLUMNS, ["---"] * len(COLUMNS), *(cells(c).values() for c in claims)])


def markdown(rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown; the second row says how columns are aligned."""
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def answer(sentences: Iterable[Sentence], claims: Iterable[WrittenClaim]) -> str:
    """The sentences whose rows have the required verdicts, and a list of the rows that do not."""
    by_id = {claim["id"]: claim for claim in claims}
    verdicts = {id: claim["verdict"] for id, claim in by_id.items()}
    numbers = {
        id: [np.nan if n["value"] is None else n["value"] for n in claim["numbers"]]
        for id, claim in by_id.items()
    }
    said, different = list[str](), dict[str, str]()
    for text, rests_on in sentences:
        others = {
            id: verdicts.get(id, "not among these rows")
            for id, verdict in rests_on.items()
            if verdicts.get(id) != verdict
        }
        different |= others
        if not others:
            said.append(_filled(text, numbers))
    if different:
        listed = ", ".join(f"{id} ({verdict})" for id, verdict in different.items())
        said.append(f"Not said here, since rows that it rests on have other verdicts: {listed}.")
    return " ".join(said)


def _filled(text: str, numbers: Mapping[str, Sequence[float]]) -> str:
    try:
        return text.format(**numbers)
    except (AttributeError, IndexError, KeyError, ValueError) as error:
        return f"(a sentence that cannot be made of its rows: {error!r})"


# -- files ----------------------------------------------------------------------------------------
def written(claim: Claim) -> dict[str, Any]:
    """The claim as in ``claims.json``: ``value`` and the like are of the decisive number,
    ``numbers`` has all.
    """
    row, first = claim.row, claim.decisive
    numbers = [
        plain(number)
        | {"printed": plain(number.printed, 17), "agreement": plain(number.agreement)}
        | {"tier": tier, "holds": holds}
        for tier, number, holds in claim.outcomes
    ]
    return {
        "id": row.id,
        "kind": row.kind,
        "place": row.place,
        "statement": row.says,
        "printed": plain(row.printed, 17),
        "value": plain(first and first.value),
        "ci": plain(first and first.ci),
        "accept": plain(first.accept if first else (None, None)),
        "printed_value": plain(first and first.printed, 17),
        "why": row.why,
        "revised": row.revised,
        "expected": claim.expected,
        "holds": claim.holds,
        "verdict": claim.verdict,
        "surprise": claim.surprise,
        "note": claim.note,
        "figure": row.figure,
        "numbers": numbers,
    }


def plain(value: Any, digits: int = 6) -> Any:
    """A value for JSON, with records as tables, numbers rounded to ``digits`` significant digits,
    and None for numbers that are not finite.
    """
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {key: plain(part, digits) for key, part in value.items()}
    if isinstance(value, tuple | list | np.ndarray):
        return [plain(part, digits) for part in value]
    value = value.item() if isinstance(value, np.generic) else value
    if not isinstance(value, float):
        return value
    return float(f"{value:.{digits}g}") if np.isfinite(value) else None


def dumps(claims: Iterable[Claim]) -> str:
    """The text of ``claims.json`` or ``checks.json``; ValueError if two claims have the same id."""
    listed = [written(claim) for claim in claims]
    twice = sorted(
        id for id, count in Counter(claim["id"] for claim in listed).items() if count > 1
    )
    if twice:
        raise ValueError(f"claims: expected different ids, got {', '.join(twice)} more than once")
    document = {"schema": SCHEMA, "claims": listed}
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


SCHEMA = "urn:celnav:claims:1.0"
"""Name of the form of these files, which ``data/claims.schema.json`` describes."""
NUMBER = (int, float, NoneType)
TYPES: dict[str, tuple[type, ...]] = {
    "id": (str,),
    "kind": (str,),
    "place": (str,),
    "statement": (str,),
    "printed": (str, bool, list, dict, *NUMBER),
    "value": NUMBER,
    "ci": (list, NoneType),
    "accept": (list,),
    "printed_value": NUMBER,
    "why": (str,),
    "revised": (str, NoneType),
    "expected": (str,),
    "holds": (bool, NoneType),
    "verdict": (str,),
    "surprise": (bool,),
    "note": (str,),
    "figure": (str,),
    "numbers": (list,),
}
"""Keys of `written` in its order, with the types of their values."""
PARTS = {"label", "value", "accept", "ci", "tier", "holds", "printed", "agreement"}
"""Keys that each number has at least."""


def read_claims(path: str | Path) -> list[dict[str, Any]]:
    """Claims of a ``claims.json``; InputError names the file, and the claim that is not whole."""
    loaded = read_json(path)
    claims = loaded.get("claims") if isinstance(loaded, dict) else None
    if not isinstance(claims, list) or loaded.get("schema") != SCHEMA:
        raise InputError(
            f"{path}: expected a table with schema {SCHEMA!r} and a list of claims; reproduce the "
            "paper again"
        )
    for number, claim in enumerate(claims):
        if not isinstance(claim, dict):
            raise InputError(f"{path}: claim {number}: expected a table, got {claim!r:.80}")
        for key in TYPES:
            if key not in claim or not _right(key, claim[key]):
                got = f"got {claim[key]!r:.80}" if key in claim else "got none"
                raise InputError(
                    f"{path}: claim {number}: {key}: not what celnav writes, {got}; reproduce the "
                    "paper again"
                )
    return claims


def _right(key: str, value: Any) -> bool:
    allowed = {"kind": KINDS, "verdict": VERDICTS, "expected": VERDICTS}.get(key, (value,))
    if type(value) not in TYPES[key] or value not in allowed:
        return False
    if key == "numbers":
        return all(isinstance(number, dict) and _whole(number) for number in value)
    return key not in ("ci", "accept") or value is None or _pair(value)


def _whole(number: WrittenClaim) -> bool:
    return (
        set(number) >= PARTS
        and _pair(number["accept"])
        and (number["ci"] is None or _pair(number["ci"]))
        and type(number["value"]) in NUMBER
    )


def _pair(value: Any) -> bool:
    """Whether a value is a list of two ends in order; None is no limit."""
    if not isinstance(value, list) or [type(end) in NUMBER for end in value] != [True, True]:
        return False
    return None in value or bool(value[0] <= value[1])
