"""``out/index.html``: one page that opens from disk, with every figure embedded and every verdict in view."""

from __future__ import annotations

import csv
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from celnav.claims import COLUMNS, read_claims, row
from celnav.page import document, figure, link, table
from celnav.papers import PAPERS, load


def index(out: Path) -> str:
    """The page for whatever papers lie under ``out``."""
    sections = [_paper(out, paper) for paper in PAPERS if (out / paper / "claims.json").exists()]
    return document("celnav: what holds", "<h1>celnav</h1>", *(sections or ["<p>Nothing reproduced yet.</p>"]))


def _paper(out: Path, paper: str) -> str:
    module, folder = load(paper), out / paper
    claims = read_claims(folder / "claims.json")
    surprises = sum(_surprise(c) for c in claims)
    links = " · ".join(link(f"{paper}/{p.name}", p.name) for p in sorted(folder.iterdir()) if p.suffix in (".rrd", ".json", ".npz"))
    return "\n".join(
        [
            f"<section><h2>{html.escape(module.TITLE)}</h2><pre>{html.escape(module.CITATION)}</pre>",
            f"<p>{len(claims)} claims, {surprises} not as expected. Files: {links}. Recordings open with "
            f"<code>celnav view {paper}</code>.</p>",
            _claims(claims),
            f"<h3>Errata of the paper</h3>{_errata(module.ERRATA)}",
            *(_listing(path) for path in sorted((folder / "tables").glob("*.csv"))),
            '<div class="grid">',
            *(_drawing(path, paper) for path in sorted((folder / "figures").glob("*.png"))),
            "</div></section>",
        ]
    )


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
        lines.append("<tr>" + "".join(f"<td>{c}</td>" for c in cells) + f'<td class="{style}">{verdict}{surprise}</td></tr>')
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>"


def _errata(errata: Sequence[tuple[str, str]]) -> str:
    rows = "".join(f"<li>{html.escape(printed)}: <em>{html.escape(right)}</em></li>" for printed, right in errata)
    return f"<ol>{rows}</ol>"


def _listing(path: Path) -> str:
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    return f"<h3>{html.escape(_title(path))}</h3>{table(head, rows)}"


def _drawing(path: Path, paper: str) -> str:
    return figure(_title(path), path.read_bytes(), f"{paper}/figures/{path.stem}.svg")


def _title(path: Path) -> str:
    return path.stem.replace("_", " ").capitalize()
