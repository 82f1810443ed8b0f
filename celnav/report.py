"""``out/index.html``: one page that opens from disk, with every figure embedded and every verdict in view."""

from __future__ import annotations

import base64
import csv
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from celnav.claims import COLUMNS, read_claims, row
from celnav.papers import PAPERS, load

_STYLE = """
:root{color-scheme:light dark;--line:#8884;--bad:#d55e00;--good:#009e73}
body{font:15px/1.5 system-ui,sans-serif;max-width:72rem;margin:0 auto;padding:1rem}
table{border-collapse:collapse;display:block;overflow-x:auto;font-size:13px;margin:1rem 0}
td,th{border-bottom:1px solid var(--line);padding:.3rem .5rem;text-align:left;vertical-align:top}
figure{margin:1rem 0}img{max-width:100%;background:#fff;border-radius:4px}
pre{overflow-x:auto;font-size:12px}.bad{color:var(--bad);font-weight:600}.good{color:var(--good)}
.grid{display:grid;grid-template-columns:repeat(auto-fill,minmax(20rem,1fr));gap:1rem}
"""


def index(out: Path) -> str:
    """The page for whatever papers lie under ``out``."""
    sections = [_paper(out, paper) for paper in PAPERS if (out / paper / "claims.json").exists()]
    body = "\n".join(sections) or "<p>Nothing reproduced yet.</p>"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>celnav: what holds</title><style>{_STYLE}</style></head><body><h1>celnav</h1>\n{body}\n</body></html>\n"
    )


def _paper(out: Path, paper: str) -> str:
    module, folder = load(paper), out / paper
    claims = read_claims(folder / "claims.json")
    surprises = sum(_surprise(c) for c in claims)
    links = " · ".join(
        _link(f"{paper}/{p.name}", p.name) for p in sorted(folder.iterdir()) if p.suffix in (".rrd", ".json", ".npz")
    )
    return "\n".join(
        [
            f"<section><h2>{html.escape(module.TITLE)}</h2><pre>{html.escape(module.CITATION)}</pre>",
            f"<p>{len(claims)} claims, {surprises} not as expected. Files: {links}. Recordings open with "
            f"<code>celnav view {paper}</code>.</p>",
            _claims(claims),
            f"<h3>Errata of the paper</h3>{_errata(module.ERRATA)}",
            *(_table(path) for path in sorted((folder / "tables").glob("*.csv"))),
            '<div class="grid">',
            *(_figure(path, paper) for path in sorted((folder / "figures").glob("*.png"))),
            "</div></section>",
        ]
    )


def _surprise(claim: dict[str, Any]) -> bool:
    return claim["holds"] is not None and claim["holds"] != claim["expected"]


def _link(target: str, text: str) -> str:
    return f'<a href="{html.escape(target, quote=True)}">{html.escape(text)}</a>'


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


def _table(path: Path) -> str:
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    lines = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in line) + "</tr>" for line in rows)
    names = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    title = html.escape(path.stem.replace("_", " ").capitalize())
    return f"<h3>{title}</h3><table><thead><tr>{names}</tr></thead><tbody>{lines}</tbody></table>"


def _figure(path: Path, paper: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    title = path.stem.replace("_", " ").capitalize()
    svg = _link(f"{paper}/figures/{path.stem}.svg", "svg")
    return f'<figure><img alt="{title}" src="data:image/png;base64,{data}"><figcaption>{title} ({svg})</figcaption></figure>'
