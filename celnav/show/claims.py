"""The ledger as people read it, and as it lies in files: rows with place, printed number, ours, verdict."""

from __future__ import annotations

import html
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from celnav.files import InputError, read_json
from celnav.study.ledger import BETWEEN, KINDS, OPEN, VERDICTS, WORDS, Claim, Number

__all__ = [
    "TYPES",
    "Ledger",
    "answer",
    "counted",
    "dumps",
    "plain",
    "read_claims",
    "surprise",
    "table",
    "tally",
    "written",
]

COLUMNS = ("place", "what is said", "printed", "ours", "verdict")
_GOOD = {words[0] for kind, words in WORDS.items() if kind in ("statement", "finding", "check")} | {
    BETWEEN[0]
}
_BAD = {words[1] for words in WORDS.values()}


def style(verdict: str) -> str:
    """How a verdict looks: "good" for what holds, "bad" for what does not, "error" of a paper, "open", or "part"."""
    if verdict in _GOOD:
        return "good"
    return (
        "bad"
        if verdict in _BAD
        else "open"
        if verdict in OPEN
        else "error"
        if verdict == WORDS["erratum"][0]
        else "part"
    )


def row(claim: Mapping[str, Any]) -> tuple[str, ...]:
    """The cells of a claim (as a dictionary) under `COLUMNS`."""
    return (
        claim["place"],
        claim["statement"],
        _printed(claim["printed"]),
        _ours(claim),
        claim["verdict"],
    )


def _printed(value: Any) -> str:
    flat = list(_flat(value))
    return (
        ", ".join(f"{v:g}" if isinstance(v, float | int) else str(v) for v in flat)
        if len(flat) <= 4
        else f"{len(flat)} numbers"
    )


def _flat(value: Any) -> Iterable[Any]:
    if isinstance(value, Mapping | list):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _flat(part)
    elif value is not None:
        yield value


def _ours(claim: Mapping[str, Any]) -> str:
    if claim["value"] is None:
        return ""
    interval = (
        ""
        if claim["ci"] is None or None in claim["ci"]
        else f" [{claim['ci'][0]:.3g}, {claim['ci'][1]:.3g}]"
    )
    return f"{claim['value']:.4g}{interval}"


def accepted(number: Mapping[str, Any]) -> str:
    """The accepted range of a number, in words."""
    low, high = number["accept"]
    if low is None and high is None:
        return "told only"
    return f"≥ {low:g}" if high is None else f"≤ {high:g}" if low is None else f"{low:g} … {high:g}"


def tally(claims: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """How many claims have which verdict, in the order of `VERDICTS`."""
    count = Counter(claim["verdict"] for claim in claims)
    return {verdict: count[verdict] for verdict in VERDICTS if count[verdict]}


def counted(claims: Iterable[Mapping[str, Any]]) -> str:
    """The same in words: "4 reproduced, 1 undecided"."""
    return ", ".join(f"{number} {verdict}" for verdict, number in tally(claims).items())


def surprise(claim: Mapping[str, Any]) -> bool:
    """Whether the verdict is not the expected one, in either direction."""
    return claim["verdict"] not in ("undecided", claim["expected"])


def table(claims: Sequence[Mapping[str, Any]], link: str = "", cell: str = "") -> str:
    """Rows as HTML, every number behind a fold; ``link``: where figures lie, ``cell``: what is before an id where it is decided.

    A column in which no row has anything, as "printed" of what nobody printed, is left out.
    """
    shown = [
        name
        for i, name in enumerate(COLUMNS)
        if not claims or any(row(claim)[i] for claim in claims)
    ]
    head = "".join(f"<th>{name}</th>" for name in shown)
    lines = "".join(_line(claim, link, cell, shown) for claim in claims)
    return f'<table class="cards"><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table>'


def _line(claim: Mapping[str, Any], link: str, cell: str, columns: Sequence[str]) -> str:
    place, says, printed, ours, verdict = (html.escape(text) for text in row(claim))
    notes = claim["note"], claim["revised"] and f"Accepted range revised: {claim['revised']}"
    told = [f"<small>{html.escape(note)}</small>" for note in notes if note]
    if len(claim["numbers"]) > 1 or claim["why"]:
        listed = "".join(f"<li>{html.escape(_number(number))}</li>" for number in claim["numbers"])
        why = f"<p>Accepted because: {html.escape(claim['why'])}</p>" if claim["why"] else ""
        told.append(
            f"<details class=numbers><summary>{len(claim['numbers'])} numbers</summary>{why}<ul>{listed}</ul></details>"
        )
    figure = (
        f' <a href="{link}{claim["figure"]}.svg">figure</a>' if claim["figure"] and link else ""
    )
    odd = " <b>(not as expected)</b>" if surprise(claim) else ""
    cells = {
        "place": place,
        "what is said": "<br>".join([says, *told]),
        "printed": printed,
        "ours": ours,
    }
    known = ((name, text) for name, text in cells.items() if name in columns)
    named = "".join(
        f'<td data-name="{name}">{text}</td>' if text else "<td></td>" for name, text in known
    )
    shown = (
        f'<a href="{cell}{html.escape(claim["id"])}">{verdict}</a>'
        if cell and claim["kind"] == "statement"
        else verdict
    )
    said = f'<td class="{style(claim["verdict"])}">{shown}{odd}{figure}</td>'
    return f'<tr id="{html.escape(claim["id"])}" data-verdict="{verdict}">{named}{said}</tr>'


def _number(number: Mapping[str, Any]) -> str:
    return f"{number['label']}: {_ours(number)} ({accepted(number)})"


class Ledger:
    """Claims as a table: for a notebook (HTML; a statement's verdict leads to the cell that decides it), Markdown or a terminal."""

    def __init__(self, claims: Sequence[Claim], kind: str = "statement"):
        self._claims = [written(claim) for claim in claims if claim.kind == kind]

    def __str__(self) -> str:
        return "\n".join(f"{c['verdict']:24} {_ours(c):26}  {c['statement']}" for c in self._claims)

    def _repr_markdown_(self) -> str:
        lines = [
            " | ".join(COLUMNS),
            " | ".join("---" for _ in COLUMNS),
            *(" | ".join(row(c)) for c in self._claims),
        ]
        return "\n".join(f"| {line} |" for line in lines)

    def _repr_html_(self) -> str:
        return table(self._claims, cell="#say-")


def answer(study: Any, claims: Iterable[Mapping[str, Any]]) -> str:
    """What a study finds, in sentences: "{axes[0]:.1f}" in them is the first number of the row "axes"."""
    numbers = {
        c["id"]: [np.nan if n["value"] is None else n["value"] for n in c["numbers"]]
        for c in claims
    }
    try:
        return str(study.found.format(**numbers))
    except (AttributeError, IndexError, KeyError, ValueError) as error:
        if (name := getattr(study, "name", None)) is None:  # one's own
            return f"(what it finds cannot be said of its rows: {error!r})"
        return f"(of another version; celnav reproduce {name})"  # claims that it has left there


# -- files -------------------------------------------------------------------------------------------------------------------
def written(claim: Claim) -> dict[str, Any]:
    """As it stands in ``claims.json``: ``value``, ``ci`` and ``accept`` of the number that decides, all in ``numbers``."""
    row, first = (
        claim.row,
        next((n for n in claim.numbers if not n.holds), (*claim.numbers, Number("", np.nan))[0]),
    )
    return {
        "id": row.id, "kind": row.kind, "place": row.place, "statement": row.says, "printed": plain(row.printed),
        "value": plain(first.value), "ci": plain(first.ci), "accept": plain(first.accept), "why": row.why,
        "revised": row.revised, "expected": claim.expected, "holds": claim.holds, "verdict": claim.verdict,
        "note": claim.note, "figure": row.figure,
        "numbers": [{key: plain(value) for key, value in n._asdict().items()} for n in claim.numbers],
    }  # fmt: skip


def plain(value: Any) -> Any:
    """As JSON has it: numbers of 6 significant digits, None for those that are not finite."""
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, tuple | list | np.ndarray):
        return [plain(part) for part in value]
    if isinstance(value, bool | np.bool_ | str) or value is None:
        return bool(value) if isinstance(value, np.bool_) else value
    return float(f"{float(value):.6g}") if np.isfinite(value) else None


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
    "id": (str,), "kind": (str,), "place": (str,), "statement": (str,), "printed": (str, bool, list, dict, *NUMBER),
    "value": NUMBER, "ci": (list, NoneType), "accept": (list,), "why": (str,), "revised": (str, NoneType), "expected": (str,),
    "holds": (bool, NoneType), "verdict": (str,), "note": (str,), "figure": (str,), "numbers": (list,),
}  # fmt: skip
"""What `written` writes, in its order."""


def read_claims(path: str | Path) -> list[dict[str, Any]]:
    """Claims of a ``claims.json`` as dictionaries; InputError names the file, and the claim that is not whole."""
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
                    f"{path}: claim {number}: {key}: not what celnav writes, {got}; reproduce the paper again"
                )
    return loaded


def _right(key: str, value: Any) -> bool:
    known = {"kind": KINDS, "verdict": VERDICTS, "expected": VERDICTS}.get(key, (value,))
    if type(value) not in TYPES[key] or value not in known:
        return False
    if key == "numbers":
        return all(
            isinstance(one, dict) and set(one) >= {"label", "value", "accept", "ci"} and _pairs(one)
            for one in value
        )
    return key not in ("ci", "accept") or value is None or _pair(value)


def _pairs(number: Mapping[str, Any]) -> bool:
    return (
        _pair(number["accept"])
        and (number["ci"] is None or _pair(number["ci"]))
        and type(number["value"]) in NUMBER
    )


def _pair(value: Any) -> bool:
    return (
        isinstance(value, list) and len(value) == 2 and all(type(part) in NUMBER for part in value)
    )
