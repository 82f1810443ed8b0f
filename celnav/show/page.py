"""Pages that open from disk, with their style inside, and their pictures inside or in files beside them."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable

__all__ = ["document", "figure", "link", "linked", "table"]

_STYLE = """
:root{color-scheme:light dark;--line:#8884;--bad:#d55e00;--good:#009e73;--part:#e69f00;--error:#cc79a7;--open:#888}
body{font:15px/1.5 system-ui,sans-serif;max-width:72rem;margin:0 auto;padding:1rem}
table{border-collapse:collapse;display:block;overflow-x:auto;font-size:13px;margin:1rem 0}
td,th{border-bottom:1px solid var(--line);padding:.3rem .5rem;text-align:left;vertical-align:top}
figure{margin:1rem 0}img{max-width:100%;background:#fff;border-radius:4px}
[hidden]{display:none!important}pre{overflow-x:auto;font-size:12px}.bad{color:var(--bad);font-weight:600}.good{color:var(--good);font-weight:600}
.part{color:var(--part);font-weight:600}.error{color:var(--error)}.open{color:var(--open)}.numbers{border:0;padding:0}
.numbers summary{font-weight:400;font-size:12px;opacity:.7}.numbers ul{font-size:12px;margin:.2rem 0}
.wide figure{overflow-x:auto}.wide img{min-width:36rem}
details{border-bottom:1px solid var(--line);padding:.4rem 0}summary{cursor:pointer;font-weight:600}
h1,h2{line-height:1.2}section{margin-top:3rem}figcaption{font-size:13px}a{color:inherit}
@media print,(max-width:44rem){.cards thead{display:none}
.cards tr{display:block;border-bottom:1px solid var(--line);padding:.4rem 0}
.cards td{display:inline;border:0;padding:0 .6rem 0 0}.cards td:first-child{display:block}
.cards td[data-name]:not(:first-child)::before{content:attr(data-name)": ";opacity:.6}}
@media screen and (min-width:44rem){.cards td[data-name=printed],.cards td[data-name=ours],.cards td:last-child{white-space:nowrap}}
.card{border:1px solid var(--line);border-radius:6px;padding:.2rem 1rem 1rem}.card figcaption{opacity:.7}
.grid{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(24rem,100%),1fr));gap:1rem}select{font:inherit}
@media print{body{font-size:11px}.filter{display:none}details:not(.numbers)::details-content{content-visibility:visible}
.grid{grid-template-columns:1fr 1fr}figure,tr,.card{break-inside:avoid}table{font-size:9px}}
"""


def document(title: str, *parts: str) -> str:
    """A whole page of parts that are HTML."""
    body = "\n".join(parts)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>{body}\n</body></html>\n"
    )


def link(target: str, text: str) -> str:
    """A link to a file beside the page."""
    return f'<a href="{html.escape(target, quote=True)}">{html.escape(text)}</a>'


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table of plain text."""
    lines = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    names = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    return f"<table><thead><tr>{names}</tr></thead><tbody>{lines}</tbody></table>"


def figure(title: str, png: bytes, svg: str) -> str:
    """A picture, and a link to its file ``svg``."""
    data = base64.b64encode(png).decode("ascii")
    name = html.escape(title)
    picture = f'<img alt="{name}" src="data:image/png;base64,{data}">'
    return f"<figure>{picture}<figcaption>{name} ({link(svg, 'svg')})</figcaption></figure>"


def linked(title: str, png: str, svg: str, more: Iterable[str] = ()) -> str:
    """A picture in a file ``png`` beside the page, loaded when it is scrolled to; a click enlarges it, to the file ``svg``.
    ``more``: links that stand beside the one to it."""
    name, target, source = (html.escape(text, quote=True) for text in (title, svg, png))
    picture = f'<a href="{target}"><img alt="{name}" loading="lazy" src="{source}"></a>'
    return f"<figure>{picture}<figcaption>{name} ({' · '.join([link(svg, 'svg'), *more])})</figcaption></figure>"
