"""``out/index.html``: one page that opens from disk, with every figure embedded and every verdict in view."""

from __future__ import annotations

import csv
import html
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import celnav
from celnav.files import InputError, read_json
from celnav.papers import PAPERS, figures, load, tables
from celnav.show.page import document, figure, link, table
from celnav.study.claims import KINDS, NUMBER, TYPES, VERDICTS, Claim

_HEADINGS = {
    "paper": "What the paper claims",
    "calibrated": "What the paper claims, with parameters that it does not give",
    "erratum": "Errors of the paper, shown by number",
    "beyond": "What the paper lacks",
}


def index(out: Path) -> str:
    """The page for whatever papers lie under ``out``."""
    done = reproduced(out)
    if not done:
        return document("celnav: what holds", "<h1>celnav</h1>", "<p>Nothing reproduced yet.</p>")
    return document(
        "celnav: what holds",
        "<h1>What holds</h1>",
        "<p>Navigation filters of five papers, every figure and table computed anew, and a verdict on every claim. A verdict comes "
        "from one number, computed here, and the interval that was accepted before; nothing was tuned to it unless it says "
        "<em>calibrated</em>.</p>",
        _overview(done),
        *(_paper(out, paper, claims) for paper, claims in done.items()),
    )


def verdicts(found: Mapping[str, Sequence[dict[str, Any]]]) -> str:
    """A table in Markdown of how many claims of each paper have which verdict."""
    counts = {paper: tally(claims) for paper, claims in found.items()}
    shown = [verdict for verdict in VERDICTS if any(verdict in count for count in counts.values())]
    rows = [["paper", "claims", *shown], ["---", *["---:"] * (len(shown) + 1)]]
    rows += [[f"`{p}`", str(sum(count.values())), *(str(count.get(v, "")) for v in shown)] for p, count in counts.items()]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def reproduced(out: Path) -> dict[str, list[dict[str, Any]]]:
    """Claims of whatever papers lie under ``out``."""
    return {paper: read_claims(out / paper / "claims.json") for paper in PAPERS if (out / paper / "claims.json").exists()}


def _overview(done: dict[str, list[dict[str, Any]]]) -> str:
    rows = []
    for paper, claims in done.items():
        surprises = sum(_surprise(claim) for claim in claims)
        odd = f'<br><span class="bad">{surprises} not as expected</span>' if surprises else ""
        title = f'<a href="#{paper}">{html.escape(load(paper).TITLE)}</a>'
        rows.append(f"<tr><td>{title}</td><td>{html.escape(_counted(claims))}{odd}</td></tr>")
    return f"<table><thead><tr><th>paper</th><th>claims</th></tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _counted(claims: Sequence[dict[str, Any]]) -> str:
    """How many have which verdict, in words."""
    return ", ".join(f"{number} {verdict}" for verdict, number in tally(claims).items())


def _paper(out: Path, paper: str, claims: list[dict[str, Any]]) -> str:
    module, folder = load(paper), out / paper
    files = [p.name for p in sorted(folder.iterdir()) if p.suffix in (".rrd", ".json", ".npz") and not p.name.startswith(".")]
    listed = " · ".join(link(f"{paper}/{name}", name) for name in files)
    parts = [
        f'<section id="{paper}"><h2>{html.escape(module.TITLE)}</h2><pre>{html.escape(module.CITATION)}</pre>',
        f"<p>Files: {listed}. A recording opens with <code>celnav view {paper}</code>, offline. Step by step: "
        f"{_notebook(out, paper)}.</p>",
        f"<p><small>{html.escape(_about(folder / 'timings.json'))}</small></p>",
    ]
    for kind in KINDS:
        own = [claim for claim in claims if claim["kind"] == kind]
        if own:
            opened = " open" if kind == "paper" or any(_surprise(c) for c in own) else ""
            parts.append(
                f"<details{opened}><summary>{_HEADINGS[kind]}: {html.escape(_counted(own))}</summary>{_claims(own)}</details>"
            )
    parts += [
        f"<details><summary>Errata of the paper, {len(module.ERRATA)}</summary>{_errata(module.ERRATA)}</details>",
        '<div class="grid">',
        *(_drawing(path, paper, module, claims) for path in sorted((folder / "figures").glob("*.png"))),
        "</div>",
        *(_listing(path, module) for path in sorted((folder / "tables").glob("*.csv"))),
        "</section>",
    ]
    return "\n".join(parts)


def _notebook(out: Path, paper: str) -> str:
    """A link to it in the checkout, if there is one."""
    name = f"{list(PAPERS).index(paper) + 1:02d}_{paper}.ipynb"
    path = Path(celnav.__file__).resolve().parents[1] / "notebooks" / name
    return link(Path(os.path.relpath(path, out.resolve())).as_posix(), name) if path.exists() else f"notebooks/{name}"


def effort_of(folder: Path) -> float | None:
    """With what part of its runs a paper was reproduced; None if there is no record of it."""
    try:
        return float(read_json(folder / "timings.json")["effort"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def few(part: float) -> str:
    """What less than the whole effort means."""
    return f"only {part:.3g} of the runs: intervals are wide, and what they do not decide, or needs whole runs, is undecided"


def _about(path: Path) -> str:
    """Versions, machine and time of a ``timings.json``."""
    try:
        found = read_json(path)
        versions = ", ".join(f"{name} {version}" for name, version in found["about"].items())
        return f"{versions}; effort {found['effort']:g}, {found['cpu_s']:.0f} s of CPU time"
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "no record of versions"


def _surprise(claim: dict[str, Any]) -> bool:
    return claim["holds"] is not None and claim["holds"] != claim["expected"]


def _claims(claims: list[dict[str, Any]]) -> str:
    head = "".join(f"<th>{name}</th>" for name in COLUMNS)
    lines = []
    for claim in claims:
        *cells, verdict = (html.escape(str(cell)) for cell in row(claim))
        style = "bad" if _surprise(claim) else "good" if claim["holds"] else ""
        note = f"<br><small>{html.escape(claim['note'])}</small>" if claim["note"] else ""
        cells[0] += note
        surprise = " (not as expected)" if _surprise(claim) else ""
        named = "".join(
            f'<td data-name="{name}">{cell}</td>' if cell else "<td></td>" for name, cell in zip(COLUMNS, cells, strict=False)
        )
        lines.append(f'<tr>{named}<td class="{style}">{verdict}{surprise}</td></tr>')
    return f'<table class="cards"><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table>'


def _errata(errata: Sequence[tuple[str, str]]) -> str:
    rows = "".join(f"<li>{html.escape(printed)}: <em>{html.escape(right)}</em></li>" for printed, right in errata)
    return f"<ol>{rows}</ol>"


def _listing(path: Path, module: ModuleType) -> str:
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    caption = _reading(path, tables(module))
    return f"<details><summary>{html.escape(caption)}</summary>{table(head, rows)}</details>"


def _drawing(path: Path, paper: str, module: ModuleType, claims: Sequence[dict[str, Any]]) -> str:
    name = path.stem.removeprefix("figure_").lstrip("0")
    said = _counted([claim for claim in claims if re.match(rf"figure-{name}(-|$)", claim["id"])])
    caption = _reading(path, figures(module)) + (f" Claims: {said}." if said else "")
    return figure(caption, path.read_bytes(), f"{paper}/figures/{path.stem}.svg")


def _reading(path: Path, functions: Mapping[str, Callable[[Any], Any]]) -> str:
    """What a figure or table shows, in a line: the first of its function's documentation."""
    line = (getattr(functions.get(path.stem), "__doc__", None) or path.stem.replace("_", " ")).partition("\n")[0]
    return line.replace("``", "").replace("`", "")


# -- claims as tables ----------------------------------------------------------------------------------------------------
COLUMNS = ("claim", "paper", "ours", "interval", "accepted", "verdict")


def row(claim: dict[str, Any]) -> tuple[str, ...]:
    """The cells of one claim (as a dictionary) under `COLUMNS`."""
    low, high = claim["accept"]
    accepted = f"≥ {low:g}" if high is None and low is not None else f"≤ {high:g}" if low is None else f"{low:g} … {high:g}"
    interval = "" if claim["ci"] is None or None in claim["ci"] else f"{claim['ci'][0]:.3g} … {claim['ci'][1]:.3g}"
    number = "" if claim["value"] is None else f"{claim['value']:.4g}"
    paper = "" if claim["paper"] is None else f"{claim['paper']:g}" if isinstance(claim["paper"], float | int) else claim["paper"]
    return claim["statement"], paper, number, interval, accepted, claim["verdict"]


def tally(claims: Iterable[dict[str, Any]]) -> dict[str, int]:
    """How many claims have which verdict, in the order of `VERDICTS`."""
    count = Counter(claim["verdict"] for claim in claims)
    return {verdict: count[verdict] for verdict in VERDICTS if count[verdict]}


class ClaimsTable:
    """Claims as a table: for a notebook (HTML), a page (Markdown) or a terminal."""

    def __init__(self, claims: Sequence[Claim]):
        self._rows = [row(claim.to_dict()) for claim in claims]

    def __str__(self) -> str:
        return "\n".join(f"{verdict:24} {ours:>10}  {statement}" for statement, _, ours, _, _, verdict in self._rows)

    def _repr_markdown_(self) -> str:
        lines = [" | ".join(COLUMNS), " | ".join("---" for _ in COLUMNS)] + [" | ".join(cells) for cells in self._rows]
        return "\n".join(f"| {line} |" for line in lines)

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{name}</th>" for name in COLUMNS)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>" for cells in self._rows)
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


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
                raise InputError(f"{path}: claim {number}: {key}: not what celnav writes, {got}; reproduce the paper again")
    return loaded


def _right(key: str, value: Any) -> bool:
    known = {"kind": KINDS, "verdict": VERDICTS}.get(key, (value,))
    pair = not isinstance(value, list) or (len(value) == 2 and all(type(part) in NUMBER for part in value))
    return type(value) in TYPES[key] and value in known and pair
