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
COLUMNS = ("place", "what is said", "printed", "ours", "verdict")
WIDE = 10.0
"""Ratio of an interval's ends above which a note says "few runs or a heavy tail"."""
FEW = (
    "Only a part of the runs was done: intervals are wide, "
    "and what they do not decide is undecided."
)
_GOOD = {BETWEEN[0], *(WORDS[kind][0] for kind in ("statement", "finding", "check"))}
_BAD = {words[1] for words in WORDS.values()}


def style(verdict: str) -> str:
    """Style of a verdict: "good" if it holds, "bad" if not, "error" (a paper's), "open", "part"."""
    if verdict in _GOOD:
        return "good"
    if verdict in _BAD:
        return "bad"
    if verdict in OPEN:
        return "open"
    return "error" if verdict == WORDS["erratum"][0] else "part"


def cells(claim: WrittenClaim) -> dict[str, str]:
    """The cell of each of `COLUMNS`; "printed" is the paper's value of the number "ours"."""
    printed = claim["printed_value"]
    shown = "" if printed is None else str(printed)
    values = claim["place"], claim["statement"], shown, _ours(claim), claim["verdict"]
    return dict(zip(COLUMNS, values, strict=True))


def columns(claims: Sequence[WrittenClaim]) -> list[str]:
    """Those of `COLUMNS` in which at least one claim has an entry."""
    every = [cells(claim) for claim in claims]
    return [name for name in COLUMNS if not every or any(row[name] for row in every)]


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


def _ours(number: WrittenClaim) -> str:
    """A number with its interval, with as many digits as the paper prints of it."""
    value, ci = number["value"], number["ci"]
    if value is None:
        return ""
    printed = str(number.get("printed_value", number.get("printed")))
    digits = max(4, sum(map(str.isdigit, printed.lstrip("0."))))
    if ci is None or None in ci:
        return f"{value:.{digits}g}"
    heavy = ", few runs or a heavy tail" if 0.0 < WIDE * ci[0] < ci[1] else ""
    return f"{value:.{digits}g} [{ci[0]:.3g}, {ci[1]:.3g}]{heavy}"


def _accepted(number: WrittenClaim) -> str:
    """The accepted range of a number, in words."""
    low, high = number["accept"]
    if low is None:
        return "any" if high is None else f"≤ {high:g}"
    return f"≥ {low:g}" if high is None else f"{low:g} … {high:g}"


def tally(claims: Iterable[WrittenClaim]) -> dict[str, int]:
    """Number of claims by verdict, in the order of `VERDICTS`."""
    count = Counter(claim["verdict"] for claim in claims)
    return {verdict: count[verdict] for verdict in VERDICTS if count[verdict]}


def counted(claims: Iterable[WrittenClaim]) -> str:
    """The same in words: "4 reproduced, 1 undecided"."""
    return ", ".join(f"{number} {verdict}" for verdict, number in tally(claims).items())


def notes(claim: WrittenClaim) -> list[str]:
    """Sentences below a claim: what we find, what else the paper prints, what was revised."""
    printed = _printed(claim["printed"])
    texts = [claim["note"]]
    if printed != cells(claim)["printed"]:
        texts.append(printed and f"The paper prints {printed}.")
    texts.append(claim["revised"] and f"Accepted range revised: {claim['revised']}")
    return [text for text in texts if text]


def numbers(claim: WrittenClaim) -> list[str]:
    """A line for each number: its accepted range, its verdict if there are several, and the
    outcome.
    """
    several = len({number["tier"] for number in claim["numbers"]}) > 1
    return [_number(number, several) for number in claim["numbers"]]


def _number(number: WrittenClaim, several: bool) -> str:
    about = f"for {number['tier']}, " * several + f"{number['label']}: {_ours(number)}"
    if number["accept"] == [None, None] and number["printed"] is None:
        return f"{about} (told only)"
    asked = _accepted(number)
    if (among := number["agreement"]) and None not in among:
        within = f"[{among[0]:.4g}, {among[1]:.4g}]"
        asked = f"{asked}; printed {number['printed']}, agrees within {within}"
    outcome = {True: "met", False: "not met", None: "undecided"}[number["holds"]]
    return f"{about} ({asked}): {outcome}"


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
        lines = [f"{c['verdict']:24} {_ours(c):26}  {c['statement']}" for c in self._claims]
        return "\n".join([*self._head, *lines])

    def _repr_markdown_(self) -> str:
        return "\n\n".join([*self._head, ledger(self._claims)])

    def _repr_html_(self) -> str:
        from celnav.show.page import aligned_left, macro

        table = macro("ledger", self._claims, anchor="#say-")
        return macro("paragraphs", self._head) + aligned_left(table)


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
        plain(number) | {"tier": tier, "agreement": plain(number.agreement), "holds": holds}
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
    return json.dumps(listed, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


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
    if not isinstance(loaded, list):
        raise InputError(f"{path}: expected a list of claims")
    for number, claim in enumerate(loaded):
        if not isinstance(claim, dict):
            raise InputError(f"{path}: claim {number}: expected a table, got {claim!r:.80}")
        for key in TYPES:
            if key not in claim or not _right(key, claim[key]):
                got = f"got {claim[key]!r:.80}" if key in claim else "got none"
                raise InputError(
                    f"{path}: claim {number}: {key}: not what celnav writes, {got}; reproduce the "
                    "paper again"
                )
    return loaded


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
    return isinstance(value, list) and [type(end) in NUMBER for end in value] == [True, True]
