"""Verdicts as a picture: a row of squares for each paper, a square for each statement.

The picture is SVG, and for the site a list whose rows break on a phone. It is legible in light and
dark modes, in gray, and for color-blind readers, since each verdict has its own sign. The tooltip
of a square is the statement.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

from celnav.show.claims import mark, tally

SIDE, STEP, LEFT = 18, 22, 92  # px: a square, from square to square, the names on the left
STYLE = """<style>
.squares text{font:12px system-ui,sans-serif;fill:#222}.squares a{text-decoration:none}
.squares .sign{fill:#fff;text-anchor:middle;font-size:11px}
@media(prefers-color-scheme:dark){.squares .name{fill:#ddd}}
</style>"""


def squares(
    claims: Mapping[str, Sequence[Mapping[str, Any]]], link: Callable[[str, str], str]
) -> str:
    """The picture of the statements of studies, by name.

    link: ``(study, id) -> address`` of a statement.
    """
    most = max((len(rows) for rows in claims.values()), default=0)
    width = max(LEFT + STEP * most, 620)
    parts, y = [STYLE], 4
    for study, rows in claims.items():
        parts.append(_text(4, y + 14, study, "name"))
        for i, row in enumerate(rows):
            title = escape(f"{row['verdict']}: {row.get('statement', row['id'])}")
            square = _square(LEFT + STEP * i, y, *mark(row["verdict"]))
            address = escape(link(study, row["id"]))
            parts.append(f'<a href="{address}"><title>{title}</title>{square}</a>')
        y += STEP + 4
    y += 6
    x = LEFT
    counts = tally(row for rows in claims.values() for row in rows)
    for verdict, count in counts.items():
        text = f"{count} {verdict}"
        if x + 30 + 7 * len(text) > width:
            x, y = LEFT, y + STEP
        parts += [_square(x, y, *mark(verdict)), _text(x + 24, y + 14, text, "name")]
        x += 40 + 7 * len(text)
    label = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    size = f'width="{width}" height="{y + STEP + 4}" viewBox="0 0 {width} {y + STEP + 4}"'
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="squares" {size} role="img" '
        f'aria-label="{escape(label)}">'
    )
    return "\n".join([head, *parts, "</svg>", ""])


def square_list(
    claims: Mapping[str, Sequence[Mapping[str, Any]]], link: Callable[[str, str], str]
) -> str:
    """The same squares as a list in HTML."""
    lines = ['<ul class="squares" aria-label="Statements">']
    for study, rows in claims.items():
        lines.append(f"<li><span>{escape(study)}</span><div>")
        for row in rows:
            title = escape(f"{row['verdict']}: {row.get('statement', row['id'])}")
            address = escape(link(study, row["id"]))
            lines.append(
                f'<a href="{address}" title="{title}" aria-label="{title}">'
                f"{sign_html(row['verdict'])}</a>"
            )
        lines.append("</div></li>")
    return "\n".join([*lines, "</ul>", ""])


def sign_html(verdict: str) -> str:
    """The sign of a verdict on its color."""
    color, sign = mark(verdict)
    return f'<span class="sign" style="background:{color}" aria-hidden="true">{sign}</span>'


def _square(x: int, y: int, color: str, sign: str) -> str:
    """A square with its sign."""
    box = f'<rect x="{x}" y="{y}" width="{SIDE}" height="{SIDE}" rx="3" fill="{color}"/>'
    return box + _text(x + SIDE // 2, y + 13, sign, "sign")


def _text(x: int, y: int, text: str, style: str) -> str:
    return f'<text class="{style}" x="{x}" y="{y}">{escape(text)}</text>'
