"""Pages that are made of what the package holds: sources of the bibliography, errata of the
ledgers, and verdicts of the executed notebooks.

``python -m docs.pages`` writes the page of verdicts and its picture, which the README shows, and the
manifest in ``codecheck.yml``.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import nbformat

from celnav.commands.crate import FIELD
from celnav.commands.index import summary
from celnav.files import data
from celnav.papers import PAPERS, load
from celnav.show.claims import MEANINGS, markdown, tally
from docs.squares import squares

HERE = Path(__file__).parent


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
    """What the six papers print wrongly, and what had to be rebuilt, each shown by a number in the
    paper's notebook.
    """
    made = [
        "# Errata of the six papers",
        "What is printed and demonstrably wrong, and what was lost in the texts at hand and "
        "rebuilt. What can be "
        "computed has its number on the page of `celnav reproduce`, and the notebook shows it. If "
        "your copy differs, tell us.",
    ]
    for paper in PAPERS:
        rows = load(paper).STUDY.rows
        made.append(
            f"## {load(paper).TITLE}\n\n[The notebook](notebooks/{notebook_of(paper)}) shows them."
        )
        for kind, head in KINDS.items():
            those = [row for row in rows if row.kind == kind]
            if those:
                made.append(
                    f"### {head}\n\n"
                    + "\n".join(
                        f"- {labeled(row.says)}" + f" *({row.place})*" * bool(row.place)
                        for row in those
                    )
                )
    return "\n\n".join(made) + "\n"


def labeled(erratum: str) -> str:
    """What is printed and what is correct, each on a line of its own behind its name in bold."""
    erratum = re.sub(r"\b(Printed|Correct): ", r"**\1:** ", erratum)
    return re.sub(r" (?=\*\*(?:Printed|Correct):)", "<br>", erratum)


# -- verdicts --------------------------------------------------------------------------------------
ROW = re.compile(r'<tr id="([^"]*)" data-verdict="([^"]*)"')


def notebook_of(paper: str) -> str:
    """The name of a paper's notebook."""
    (path,) = (HERE.parent / "notebooks").glob(f"[0-9][0-9]_{paper}.ipynb")
    return path.name


def judged(paper: str) -> list[dict[str, Any]]:
    """Statements of a paper with the verdicts of its notebook, which was executed with all runs."""
    cells = nbformat.read(HERE.parent / "notebooks" / notebook_of(paper), as_version=4).cells
    outputs = [output for cell in cells if cell.cell_type == "code" for output in cell.outputs]
    pages = [output.data.get("text/html", "") for output in outputs if "data" in output]
    ledger = next(page for page in pages if ROW.search(page))
    rows = {row.id: row for row in load(paper).STUDY.rows}
    return [
        {
            "kind": "statement",
            "id": id,
            "verdict": verdict,
            "statement": rows[id].says,
            "place": rows[id].place,
        }
        for id, verdict in ROW.findall(ledger)
    ]


def picture() -> str:
    """The verdicts of all papers as squares, each linked to its row on the page of verdicts."""
    return squares({paper: judged(paper) for paper in PAPERS}, lambda paper, id: f"#{paper}-{id}")


def occurring(claims: dict[str, list[dict[str, Any]]]) -> dict[str, int]:
    """Number of statements of all papers by verdict, for the verdicts that occur."""
    return tally(row for rows in claims.values() for row in rows)


def counts(claims: dict[str, list[dict[str, Any]]]) -> str:
    """A table in Markdown with the number of statements by verdict: a column for each paper."""
    papers = {paper: tally(rows) for paper, rows in claims.items()} | {"all": occurring(claims)}
    lines = [["verdict", *papers], ["---", *["---:"] * len(papers)]]
    for verdict in papers["all"]:
        lines.append([verdict, *(str(count.get(verdict, "")) for count in papers.values())])
    lines.append(["statements", *(str(sum(count.values())) for count in papers.values())])
    return markdown(lines)


def verdict_page() -> str:
    """What each paper says, what holds, and the verdict on every statement."""
    claims = {paper: judged(paper) for paper in PAPERS}
    parts = [
        "# Verdicts",
        "Each statement of a paper is judged by numbers with 95 % intervals, against a range that "
        "follows from the paper's own words. `celnav reproduce` computes them, and `celnav "
        "verdicts` prints the table. [The ledger as a file](ledger.md) describes its form.",
        "![Verdicts as squares, a row for each paper](verdicts.svg)",
        counts(claims),
        "\n".join(f"- **{verdict}**: {MEANINGS[verdict]}." for verdict in occurring(claims)),
    ]
    for paper, rows in claims.items():
        parts += [f"## {paper}", summary([paper])]
        notebook = f"[the notebook](notebooks/{notebook_of(paper)})"
        parts.append(f"Numbers and figures are in {notebook}; errors in print are in the errata.")
        lines = ["| verdict | statement | place |", "|---|---|---|"]
        for row in rows:
            anchor = f'<a id="{paper}-{row["id"]}"></a>'
            statement = row["statement"].replace("|", "\\|")
            lines.append(f"| {anchor}{row['verdict']} | {statement} | {row['place']} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


# -- CODECHECK -------------------------------------------------------------------------------------
CODECHECK = HERE.parent / "codecheck.yml"


def manifest() -> list[dict[str, str]]:
    """A file of ``celnav reproduce`` for each numbered figure and table of a paper, and its ledger."""
    listed = []
    for paper in PAPERS:
        module = load(paper)
        items = {f"figures/{stem}.png": module.FIGURES[stem][0] for stem in module.FIGURES}
        items |= {f"tables/{stem}.csv": module.TABLES[stem][0] for stem in module.TABLES}
        for file, caption in items.items():
            if numbered := re.match(r"(?:Fig\.|Table) \d+", caption):
                listed.append({"file": f"out/{paper}/{file}", "comment": f"{paper}, {numbered[0]}"})
        listed.append({"file": f"out/{paper}/claims.json", "comment": f"{paper}, all verdicts"})
    return listed


def codecheck() -> str:
    """The text of ``codecheck.yml`` with the present manifest."""
    head = CODECHECK.read_text(encoding="utf-8").partition("manifest:\n")[0]
    lines = [f"  - file: {item['file']}\n    comment: {item['comment']}\n" for item in manifest()]
    return head + "manifest:\n" + "".join(lines)


if __name__ == "__main__":
    CODECHECK.write_text(codecheck(), encoding="utf-8")
    (HERE / "verdicts.svg").write_text(picture(), encoding="utf-8")
    (HERE / "verdicts.md").write_text(verdict_page(), encoding="utf-8")
