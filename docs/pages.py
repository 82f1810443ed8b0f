"""Pages that are made of what the package holds: sources of the bibliography, errata of the
ledgers.
"""

from __future__ import annotations

import re

from celnav.files import data
from celnav.papers import PAPERS, load

FIELD = re.compile(r"(\w+)\s*=\s*\{((?:[^{}]|\{[^{}]*\})*)\}")


def sources() -> str:
    """Every entry as a paragraph to which the docstrings link."""
    text = data("references.bib").read_text(encoding="utf-8")
    entries = re.findall(r"^@\w+\{(\w+),(.*?)(?=^@|\Z)", text, re.DOTALL | re.MULTILINE)
    made = [
        f"({key})=\n**[{key}]** {reference(dict(FIELD.findall(body)))}\n"
        for key, body in sorted(entries)
    ]
    return "# Sources\n\n" + "\n".join(made)


def reference(entry: dict[str, str]) -> str:
    """An entry in words."""
    entry = {
        name: re.sub(r"\s+", " ", re.sub(r"[{}\\]", "", value)).replace("--", "–")
        for name, value in entry.items()
    }
    authors = [
        " ".join(reversed(name.split(", ")))
        for name in entry.get("author", "").split(" and ")
        if name != "others"
    ]
    where = (
        entry.get("journal")
        or entry.get("booktitle")
        or entry.get("publisher")
        or entry.get("school")
        or entry.get("institution")
        or entry.get("howpublished")
    )
    volume = entry.get("volume", "") + (f"({entry['number']})" if "number" in entry else "")
    others = " and others" * ("others" in entry.get("author", ""))
    parts = [
        ", ".join(authors) + others,
        f"*{entry.get('title', '')}*",
        " ".join(part for part in (where, volume) if part),
    ]
    parts += [entry["pages"]] if "pages" in entry else []
    said = ". ".join(part for part in parts if part) + f", {entry.get('year', 'no year')}."
    said += f" {entry['note'][0].upper()}{entry['note'][1:]}." if "note" in entry else ""
    return said + (
        f" [doi:{entry['doi']}](https://doi.org/{entry['doi']})" if "doi" in entry else ""
    )


KINDS = {
    "erratum": "Printed wrongly",
    "reconstruction": "Lost or unreadable in the text at hand, and rebuilt",
    "remark": "Remarks",
}


def errata() -> str:
    """What the five papers print wrongly, and what had to be rebuilt, each shown by a number in the
    paper's notebook.
    """
    made = [
        "# Errata of the five papers",
        "What is printed and demonstrably wrong, and what was lost in the texts at hand and "
        "rebuilt. What can be "
        "computed has its number on the page of `celnav reproduce`, and the notebook shows it. If "
        "your copy differs, tell us.",
    ]
    for i, paper in enumerate(PAPERS, 1):
        rows = load(paper).STUDY.rows
        made.append(
            f"## {load(paper).TITLE}\n\n[The notebook](notebooks/{i:02d}_{paper}.ipynb) shows them."
        )
        for kind, head in KINDS.items():
            those = [row for row in rows if row.kind == kind]
            if those:
                made.append(
                    f"### {head}\n\n"
                    + "\n".join(
                        f"- {row.says}" + f" *({row.place})*" * bool(row.place) for row in those
                    )
                )
    return "\n\n".join(made) + "\n"
