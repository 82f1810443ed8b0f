"""``out/index.html``: a page that opens from disk: what papers say, what we find, every row of their ledgers, every figure.

Studies of one's own and on real data follow the papers.
"""

from __future__ import annotations

import csv
import html
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType, ModuleType, SimpleNamespace
from typing import Any

import celnav
from celnav.commands.arguments import module as module_of
from celnav.files import InputError, read_json
from celnav.papers import PAPERS
from celnav.real import STUDIES
from celnav.show.claims import answer, counted, read_claims, table, tally
from celnav.show.page import document, link, linked
from celnav.show.page import table as plain_table
from celnav.study.ledger import VERDICTS, Sentence

__all__ = [
    "OWN",
    "described",
    "effort_of",
    "few",
    "index",
    "own_studies",
    "reproduced",
    "shown",
    "verdicts",
    "words",
]

_FOLDED = {
    "erratum": "Errata",
    "reconstruction": "Reconstructed: lost or unreadable in our text",
    "remark": "Remarks",
}

Claims = Sequence[Mapping[str, Any]]
OWN = "study.json"
"""What the page shows of a study of one's own, whose file may be gone."""


def index(out: Path) -> str:
    """The page for whatever papers and studies lie under ``out``."""
    done, own, real = reproduced(out), reproduced(out, own_studies(out)), reproduced(out, STUDIES)
    if not done and not own and not real:
        return document("celnav: what holds", "<h1>celnav</h1>", "<p>Nothing reproduced yet.</p>")
    return document(
        "celnav: what holds",
        f"<h1>What {'papers say' if done else 'is said'}, and what holds</h1>",
        *(f"<p><b>{html.escape(line)}</b></p>" for line in few(out, [*done, *own, *real])),
        '<div class="grid">',
        *(_opening(out, paper, claims) for paper, claims in (done | own).items()),
        "</div>",
        _filter([claim for claims in (done | own).values() for claim in _of(claims, "statement")]),
        "<p><small>Each statement is judged by numbers computed here. The accepted range follows from the paper's own words, or "
        "from a convention that the row names; first results were known when it was written, and where it was changed since, the "
        "row says so. A number with sampling error decides only if its whole 95 % interval does.</small></p>",
        *(_paper(out, paper, claims) for paper, claims in (done | own).items()),
        *_on_real_data(out, real),
    )


def own_studies(out: Path) -> list[str]:
    """Names of studies of one's own that lie under ``out``."""
    return sorted(path.parent.name for path in out.glob(f"*/{OWN}"))


def described(study: ModuleType, file: str) -> str:
    """What `shown` reads of a study of one's own."""
    captions = {
        kind: {stem: caption for stem, (caption, _) in getattr(study, kind).items()}
        for kind in ("FIGURES", "TABLES")
    }
    about = {
        "file": str(Path(file).resolve()),
        "TITLE": study.TITLE,
        "CITATION": study.CITATION,
        **captions,
    }
    said = {name: getattr(study.STUDY, name) for name in ("says", "found", "figure")}
    return (
        json.dumps(
            {**about, "RECORDINGS": list(study.RECORDINGS), "STUDY": said},
            indent=1,
            ensure_ascii=False,
        )
        + "\n"
    )


def shown(out: Path, name: str) -> Any:
    """The module of a paper or study, or of one's own what `described` says, with the names that a page shows."""
    if not (path := out / name / OWN).exists():
        return module_of(name)
    try:
        about = read_json(path)
        captions = {
            kind: {stem: (caption,) for stem, caption in about.pop(kind).items()}
            for kind in ("FIGURES", "TABLES")
        }
        study = about.pop("STUDY")
        study["found"] = [Sentence(text, dict(rests_on)) for text, rests_on in study["found"]]
        return SimpleNamespace(**captions, STUDY=SimpleNamespace(**study), **about)
    except (AttributeError, KeyError, TypeError, ValueError):
        raise InputError(f"{path}: not what celnav writes; reproduce the study again") from None


def _on_real_data(out: Path, done: Mapping[str, Claims]) -> list[str]:
    """What real data say, and what could be added."""
    absent = [
        f"{html.escape(holds)} (<code>--{name} DIR</code>)"
        for name, holds in STUDIES.items()
        if name not in done
    ]
    parts = ["<section><h2>On real data</h2>"] if STUDIES else []
    if done:
        parts += [
            "<p><small>Nothing here was stated by a paper: rows are what we find, each number with its 95 % interval by a "
            "bootstrap over blocks of time. What settings were chosen by is other data than what judges them.</small></p>",
            '<div class="grid">', *(_opening(out, study, claims) for study, claims in done.items()), "</div>",
        ]  # fmt: skip
    if absent:
        parts.append(
            f"<p><small><code>celnav reproduce</code> adds a study for a folder of {'; of '.join(absent)}.</small></p>"
        )
    return [
        *parts,
        *(_paper(out, study, claims) for study, claims in done.items()),
        "</section>" if STUDIES else "",
    ]


def reproduced(out: Path, among: Iterable[str] | None = None) -> dict[str, list[dict[str, Any]]]:
    """Claims and checks of whatever papers, or studies ``among`` others, lie under ``out``."""
    found = {
        name: out / name
        for name in (PAPERS if among is None else among)
        if (out / name / "claims.json").exists()
    }
    return {
        paper: [c for name in ("claims", "checks") for c in read_claims(folder / f"{name}.json")]
        for paper, folder in found.items()
    }


def words(
    papers: Sequence[str],
    out: Path = Path("out"),
    found: Mapping[str, Claims] = MappingProxyType({}),
) -> str:
    """Paragraphs in Markdown: what papers, or studies under ``out``, say and what we find; ``found``: their claims, if at hand."""
    every = {paper: shown(out, paper) for paper in papers}
    answers = {
        paper: answer(one.STUDY.found, found[paper])
        if paper in found
        else " ".join(sentence.text for sentence in one.STUDY.found)
        for paper, one in every.items()
    }
    return "\n\n".join(
        f"**{one.TITLE}** (`{paper}`{': ' * bool(one.CITATION)}{cited(one.CITATION)}). {_whose(paper)}{one.STUDY.says}\n"
        f"*We find:* {answers[paper]}"
        for paper, one in every.items()
    )


def _whose(name: str) -> str:
    """Who says what is said."""
    return "The paper: " if name in PAPERS else "" if name in STUDIES else "It is said: "


def cited(citation: str) -> str:
    """Authors and year of a BibTeX entry."""
    authors, year = (
        found[1] if (found := re.search(rf"{key} *= *{{(.*?)}}", citation, re.DOTALL)) else ""
        for key in ("author", "year")
    )
    names = [name.partition(",")[0].strip() for name in authors.split(" and ")]
    told = (
        f"{names[0]} et al."
        if len(names) > 4
        else " & ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names)
    )
    return f"{told} ({year})" if year else told


def verdicts(found: Mapping[str, Claims]) -> str:
    """A table in Markdown of how many statements of each paper have which verdict."""
    counts = {paper: tally(_of(claims, "statement")) for paper, claims in found.items()}
    shown = [verdict for verdict in VERDICTS if any(verdict in count for count in counts.values())]
    rows = [["paper", "statements", *shown], ["---", *["---:"] * (len(shown) + 1)]]
    rows += [
        [f"`{p}`", str(sum(count.values())), *(str(count.get(v, "")) for v in shown)]
        for p, count in counts.items()
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _of(claims: Claims, kind: str) -> list[Mapping[str, Any]]:
    return [claim for claim in claims if claim["kind"] == kind]


def _opening(out: Path, paper: str, claims: Claims) -> str:
    """A card: what a paper says and what we find, in sentences, and the figure that decides with the recordings."""
    module = shown(out, paper)
    odd = [claim for claim in claims if claim["surprise"]]
    told = f' <b class="bad">{len(odd)} not as expected.</b>' if odd else ""
    kind, stem = _kind(paper, claims), module.STUDY.figure
    rows, whose = _of(claims, kind), _whose(paper)
    picture = out / paper / "figures" / f"{stem}.png"
    drawn = _drawing(picture, paper, module) if picture.exists() else ""
    return (
        f'<article class="card"><h3><a href="#{paper}">{html.escape(module.TITLE)}</a></h3>{drawn}'
        f"<p>{whose}{html.escape(module.STUDY.says)}</p><p>We find: {html.escape(answer(module.STUDY.found, claims))}</p>"
        f"<p><small>{len(rows)} {kind}s: {counted(rows)}.{told}</small></p></article>"
    )


def _kind(name: str, claims: Claims) -> str:
    """Of the rows that decide: what a paper states, or what is found in data."""
    return "statement" if name in PAPERS or _of(claims, "statement") else "finding"


_FILTER = """<p class="filter"><label>Show rows <select id="shown"><option value="">of any verdict</option>{}</select></label></p>
<script>document.getElementById("shown").onchange = (event) => document.querySelectorAll("tr[data-verdict]").forEach(
(row) => row.hidden = event.target.value && row.dataset.verdict != event.target.value)</script>"""


def _filter(claims: Claims) -> str:
    """A choice of verdicts; rows of other ones are hidden."""
    options = (
        f'<option value="{verdict}">{verdict} ({count})' for verdict, count in tally(claims).items()
    )
    return _FILTER.format("".join(options))


def _paper(out: Path, paper: str, claims: Claims) -> str:
    module, folder, figures, kind = (
        shown(out, paper),
        out / paper,
        f"{paper}/figures/",
        _kind(paper, claims),
    )
    files = [
        p.name
        for p in sorted(folder.iterdir())
        if p.suffix in (".rrd", ".json", ".npz") and not p.name.startswith(".")
    ]
    listed = " · ".join(link(f"{paper}/{name}", name) for name in files)
    findings = _of(claims, "finding") if kind == "statement" else []
    parts = [
        f'<section id="{paper}"><h2>{html.escape(module.TITLE)}</h2><p><small>{html.escape(cited(module.CITATION))}'
        f"{' · ' * bool(module.CITATION)}{_notebook(out, paper, module)}</small></p>",
        table(_of(claims, kind), figures),
        '<div class="grid">',
        *(_drawing(path, paper, module) for path in sorted((folder / "figures").glob("*.png"))),
        "</div>",
        *(_listing(path, module) for path in sorted((folder / "tables").glob("*.csv"))),
    ]
    for kind, heading in _FOLDED.items():
        if own := _of(claims, kind):
            opened = " open" if kind == "erratum" else ""
            parts.append(
                f"<details{opened}><summary>{heading}: {len(own)}</summary>{table(own, figures)}</details>"
            )
    if findings:
        parts.append(f"<h3>Found besides</h3>{table(findings, figures)}")
    if checks := _of(claims, "check"):
        parts.append(
            f"<details><summary>{len(checks)} checks: {counted(checks)}</summary>{table(checks, figures)}</details>"
        )
    parts += [
        f"<p><small>Files: {listed}. A recording opens with <code>celnav view {paper}</code>, offline. "
        f"{html.escape(_about(folder / 'timings.json'))}</small></p>",
        f"<details><summary>Citation</summary><pre>{html.escape(module.CITATION)}</pre></details>"
        * bool(module.CITATION),
        "</section>",
    ]
    return "\n".join(parts)


def _notebook(out: Path, paper: str, module: Any) -> str:
    """A link to it in the checkout, if there is one; to the file of a study of one's own."""
    if paper not in PAPERS and paper not in STUDIES:
        path = Path(module.file)
        return _linked(path, out) if path.exists() else html.escape(path.name)
    name = (
        "07_real_data.ipynb"
        if paper in STUDIES
        else f"{list(PAPERS).index(paper) + 1:02d}_{paper}.ipynb"
    )
    path = Path(celnav.__file__).resolve().parents[1] / "notebooks" / name
    return _linked(path, out) if path.exists() else f"notebooks/{name}"


def _linked(path: Path, out: Path) -> str:
    try:
        return link(Path(os.path.relpath(path, out.resolve())).as_posix(), path.name)
    except ValueError:  # on another drive of Windows
        return link(path.resolve().as_uri(), path.name)


def effort_of(folder: Path) -> float | None:
    """With what part of its runs a paper was reproduced; None if there is no record of it."""
    try:
        return float(read_json(folder / "timings.json")["effort"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def few(out: Path, names: Iterable[str]) -> list[str]:
    """A line for each part of the runs, less than all, with which papers or studies were reproduced."""
    by = dict[float, list[str]]()
    for name in names:
        if (part := effort_of(out / name)) is not None and part < 1.0:
            by.setdefault(part, []).append(name)
    return [
        f"{', '.join(some)}: only {part:.3g} of the runs: intervals are wide, and what they do not decide is undecided"
        for part, some in by.items()
    ]


def _about(path: Path) -> str:
    """Versions, machine and time of a ``timings.json``."""
    try:
        found = read_json(path)
        versions = ", ".join(f"{name} {version}" for name, version in found["about"].items())
        return f"{versions}; effort {found['effort']:g}, {found['cpu_s']:.0f} s of CPU time"
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "no record of versions"


def _listing(path: Path, module: Any) -> str:
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    caption = module.TABLES.get(path.stem, (path.stem,))[0]
    return f"<details><summary>{html.escape(caption)}</summary>{plain_table(head, rows)}</details>"


def _drawing(path: Path, paper: str, module: Any) -> str:
    """A figure of a paper; beside the one that decides, what recordings there are."""
    caption = module.FIGURES.get(path.stem, (path.stem.replace("_", " "),))[0]
    names = [
        n
        for n in module.RECORDINGS
        if path.stem == module.STUDY.figure and (path.parents[1] / n).exists()
    ]
    png, svg = (f"{paper}/figures/{path.stem}.{kind}" for kind in ("png", "svg"))
    return linked(caption, png, svg, [link(f"{paper}/{name}", name) for name in names])
