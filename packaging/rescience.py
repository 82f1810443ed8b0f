"""ReScience C articles, made from the results that ``celnav reproduce`` has written.

``python packaging/rescience.py OUT --results out`` writes a folder for each article, such as
``OUT/csrukf``: `content.tex`, `metadata.yaml`, `bibliography.bib` and ``figures`` replace the files
of these names in the journal's template; `standalone.tex` compiles without the template.

The prose is in `paper/rescience`. It has no numbers. It names a row of the ledger and the label of
a number, and it names the verdict on which a sentence depends. A name that the ledger does not
have, and a verdict that is another one, are errors.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import shutil
import sys
from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import metadata
from jinja2 import Environment, FileSystemLoader, StrictUndefined, TemplateError, Undefined

from celnav.files import did_you_mean
from celnav.papers import load
from celnav.show.claims import cells, ours, read_claims

TEMPLATES = metadata.ROOT / "paper" / "rescience"
ARTICLES = {"csrukf": "Sun2015", "aukf": "Fan"}
"""Papers that have an article -> key of the paper in `data/references.bib`."""
SIGNS = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "Φ": r"$\Phi$",
    "φ": r"$\phi$",
    "σ": r"$\sigma$",
    "≤": r"$\le$",
    "≥": r"$\ge$",
    "·": r"$\cdot$",
    "§": r"\S\,",
    "–": "--",
}
"""Signs of the ledger -> LaTeX."""
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
WIDTHS = ("X", "p{27mm}", "p{21mm}", "p{17mm}", "p{17mm}")
FLOATS = r"""\renewcommand\topfraction{0.9}
\renewcommand\bottomfraction{0.9}
\renewcommand\textfraction{0.07}
\renewcommand\floatpagefraction{0.8}
"""
"""Figures and tables may fill most of a page."""
COLUMNS = "".join(rf">{{\raggedright\arraybackslash}}{width}" for width in WIDTHS)
HEADS = ("Statement (place)", "Quantity that decides", r"Ours [95\,\%]", "Accepted", "Verdict")
"""Columns of the table of statements."""


def tex(text: str) -> str:
    """Text of the ledger in LaTeX, with signs of minus, powers of ten and thousands."""
    text = "".join(SIGNS.get(sign, sign) for sign in text)
    text = re.sub("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda n: f"$^{{{n[0].translate(RAISED)}}}$", text)
    if unknown := re.search(r"[^\x00-\xff]", text):
        raise ValueError(f"SIGNS: expected LaTeX for {unknown[0]!r}, which is in {text!r:.60}")
    text = re.sub(r"(?<=\d)-(?=\d)", "--", text)  # from one place to another
    text = re.sub(r"\b(\d[\d.]*)e([+-]?\d+)", _power, text)
    text = re.sub(r"(?<![\w.{}-])-(?=\d)", "$-$", text)
    return re.sub(r"(?<![\d.])\d{5,}", lambda n: f"{int(n[0]):,}".replace(",", r"\,"), text)


def _power(number: re.Match[str]) -> str:
    return rf"${number[1]}\times10^{{{int(number[2])}}}$"


def shown(value: Any) -> str:
    """What a template puts in its text: texts as they are, numbers as they are set."""
    return str(value) if isinstance(value, str | Undefined) else tex(f"{value:.10g}")


class Facts:
    """What the prose may say of a paper: verdicts, numbers, parameters, tables and figures.

    results: folder of ``celnav reproduce`` with all runs of this version. ValueError names what is
    missing. `said` are the rows whose verdict the prose has stated, `figures` those it shows.
    """

    def __init__(self, paper: str, results: Path) -> None:
        self.paper = paper
        self.folder = results / paper
        if not (self.folder / "claims.json").is_file():
            made = f"celnav reproduce {' '.join(ARTICLES)} --out {results}"
            raise ValueError(f"--results: expected results of `{made}`, got no {self.folder}")
        self.claims = {claim["id"]: claim for claim in read_claims(self.folder / "claims.json")}
        self.run = json.loads((self.folder / "timings.json").read_text(encoding="utf-8"))
        self.said = set[str]()
        self.figures = list[str]()
        if self.run["effort"] != 1.0:
            raise ValueError(f"{self.folder}: expected all runs, got effort {self.run['effort']}")

    def pick(self, what: str, name: str, known: Iterable[str]) -> str:
        """The name, if it is known."""
        known = list(known)
        if name not in known:
            hint = did_you_mean(name, known)
            raise ValueError(f"{self.paper}: {what}: not in the results: {name!r}{hint}")
        return name

    def verdict(self, id: str, word: str) -> str:
        """Nothing, if a row has the verdict that the next sentences state."""
        found = self.claims[self.pick("row", id, self.claims)]["verdict"]
        if found != word:
            raise ValueError(
                f"{self.paper}: {id}: the text says {word!r}, the ledger {found!r}: "
                "rewrite the sentences that follow from it"
            )
        self.said.add(id)
        return ""

    def number(self, id: str, label: str) -> dict[str, Any]:
        """A number of a row, by its label."""
        claim = self.claims[self.pick("row", id, self.claims)]
        numbers: dict[str, dict[str, Any]] = {
            number["label"]: number for number in claim["numbers"]
        }
        self.pick(f"number of {id}", label, numbers)
        if id not in self.said:
            raise ValueError(
                f"{self.paper}: {id}: expected its verdict before its number {label!r}"
            )
        return numbers[label]

    def interval(self, id: str, label: str) -> str:
        """A value with its interval: "0.71 [0.56, 0.87]"."""
        return tex(ours(self.number(id, label)))

    def value(self, id: str, label: str) -> str:
        """A value without its interval."""
        return tex(ours(self.number(id, label) | {"ci": None}))

    def percent(self, id: str, label: str) -> str:
        """A share in percent, with its interval."""
        number = self.number(id, label)
        ci = number["ci"] and [100.0 * end for end in number["ci"]]
        hundred = {"value": 100.0 * number["value"], "ci": ci, "accept": [None, None]}
        return tex(ours(number | hundred)) + r"\,\%"

    def runs(self, id: str, label: str) -> int:
        """Number of runs behind a number."""
        return int(self.number(id, label)["runs"])

    def printed(self, id: str, label: str) -> str:
        """The paper's value of a number."""
        return tex(str(self.number(id, label)["printed"]))

    @cached_property
    def configs(self) -> dict[str, Any]:
        """Parameters of presets and of parts of the study, by name; the first is the default."""
        module: ModuleType = load(self.paper)
        parts = {name: part.config for name, part in module.STUDY.parts().items()}
        return module.PRESETS | parts | module.PRESETS

    def parameter(self, name: str, of: str = "") -> Any:
        """A parameter of a preset or a part of the study, by default of the first preset."""
        of = self.pick("preset or part", of or next(iter(self.configs)), self.configs)
        return getattr(
            self.configs[of], self.pick(f"parameter of {of}", name, dir(self.configs[of]))
        )

    def count(self, verdict: str = "", kind: str = "statement") -> int:
        """Number of rows of a kind, all or those with a verdict."""
        rows = (claim for claim in self.claims.values() if claim["kind"] == kind)
        return sum(claim["verdict"] == verdict or not verdict for claim in rows)

    def revised(self) -> int:
        """Number of statements whose accepted range was changed after a result."""
        return sum(c["kind"] == "statement" and bool(c["revised"]) for c in self.claims.values())

    def rows(self, table: str) -> list[dict[str, str]]:
        """Rows of a table of the results."""
        tables = [path.stem for path in (self.folder / "tables").glob("*.csv")]
        path = self.folder / "tables" / f"{self.pick('table', table, tables)}.csv"
        with path.open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    def figure(self, stem: str, caller: Callable[[], str]) -> str:
        """A figure of the results; the caption is what a call block holds."""
        stems = [path.stem for path in (self.folder / "figures").glob("*.png")]
        self.figures.append(self.pick("figure", stem, stems))
        lines = (
            r"\begin{figure}[htbp]",
            r"\centering",
            rf"\includegraphics[width=\textwidth]{{figures/{stem}.png}}",
            rf"\caption{{{caller().strip()}}}",
            rf"\label{{{stem}}}",
            r"\end{figure}",
        )
        return "\n".join(lines) + "\n"

    def statements(self, first: int, last: int, **quantities: str) -> str:
        """Rows of the table of statements: the statement, and the number that decides it.

        quantities: by id, what the number is, where the label of the ledger is a short name.
        """
        claims = [claim for claim in self.claims.values() if claim["kind"] == "statement"]
        lines = [rf"\begin{{tabularx}}{{\textwidth}}{{{COLUMNS}}}"]
        lines += [r"\hline", " & ".join(HEADS) + r" \\", r"\hline\noalign{\vskip 2pt}"]
        for claim in claims[first:last]:
            verdict, says, quantity, printed, ours, accepted = map(tex, cells(claim).values())
            says += f" ({tex(claim['place'])})"
            quantity = quantities.get(claim["id"].replace("-", "_"), quantity)
            quantity += f"; printed: {printed}" if printed else ""
            row = " & ".join([says, quantity, ours, accepted, verdict])
            lines.append(rf"{row} \\ \noalign{{\vskip 2pt}}")
        return "\n".join([*lines, r"\hline", r"\end{tabularx}"])

    @property
    def names(self) -> dict[str, Any]:
        """Names that the prose may use."""
        functions = (
            self.verdict,
            self.interval,
            self.value,
            self.percent,
            self.runs,
            self.printed,
            self.parameter,
            self.count,
            self.revised,
            self.rows,
            self.figure,
            self.statements,
        )
        return {function.__name__: function for function in functions} | {
            "tex": tex,
            "three": lambda text: tex(f"{float(text):#.3g}".removesuffix(".")),
            "run": self.run,
            "repository": tex(metadata.load().owner["repository"]),
        }


def environment() -> Environment:
    """jinja2 with delimiters that LaTeX does not have: ``<< >>``, ``<% %>``, ``<# #>``."""
    return Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        finalize=shown,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        variable_start_string="<<",
        variable_end_string=">>",
        block_start_string="<%",
        block_end_string="%>",
        comment_start_string="<#",
        comment_end_string="#>",
    )


def people(release: metadata.Release) -> dict[str, Any]:
    """Authors and affiliations; the first author is the corresponding one."""
    listed = release.owner["authors"] or [
        {"given": "The celnav", "family": "authors", "affiliation": metadata.PLACEHOLDER}
    ]
    places = list(dict.fromkeys(author["affiliation"] for author in listed))
    authors = [
        {
            "name": metadata.full_name(author),
            "orcid": author.get("orcid", ""),
            "email": author.get("email", "" if i else metadata.PLACEHOLDER),
            "affiliations": f"{places.index(author['affiliation']) + 1}" + ("" if i else ",*"),
        }
        for i, author in enumerate(listed)
    ]
    affiliations = [
        {"code": str(code), "name": place, "address": ""} for code, place in enumerate(places, 1)
    ]
    return {"authors": authors, "affiliations": affiliations}


def about(release: metadata.Release, paper: str, prose: Any) -> dict[str, Any]:
    """`metadata.yaml`: what the journal asks of an author; its editors fill in the rest."""
    source = metadata.bibliography()[ARTICLES[paper]]
    reviewers = [{"name": "", "orcid": "", "role": role} for role in ("editor", *2 * ["reviewer"])]
    return {
        "title": f"[Re] {source['title']}",
        **people(release),
        "keywords": " ".join(prose.keywords.split()),
        "code": [
            {"url": release.owner["repository"]},
            {"doi": release.owner["software_doi"]},
            {"swh": ""},
        ],
        "data": [{"url": ""}, {"doi": ""}],
        "replication": [
            {"cite": metadata.sentence(source)},
            {"bib": source["key"]},
            {"url": source.get("url", "")},
            {"doi": source.get("doi", "")},
        ],
        "abstract": " ".join(prose.abstract.split()),
        "bibliography": "bibliography.bib",
        "type": "Replication",
        "domain": "Navigation",
        "language": "Python",
        "review": [{"url": ""}],
        "contributors": reviewers,
        "dates": [{"received": ""}, {"accepted": ""}, {"published": ""}],
        "article": [{"number": ""}, {"doi": ""}, {"url": ""}],
        "journal": [{"name": "ReScience C"}, {"issn": "2430-3658"}, {"volume": ""}, {"issue": ""}],
    }


def write(paper: str, results: Path, out: Path) -> list[str]:
    """Write the article of a paper into ``out/<paper>``; returns the lines of `metadata.yaml` that
    wait for the owner.
    """
    release, facts, jinja = metadata.load(), Facts(paper, results), environment()
    if facts.run["about"]["celnav"] != release.version:
        made = facts.run["about"]["celnav"]
        raise ValueError(f"{facts.folder}: expected version {release.version}, got {made}")
    prose: Any = jinja.get_template(f"{paper}.tex.j2").make_module(facts.names)
    content = FLOATS + re.sub(r"\n{3,}", "\n\n", str(prose).lstrip())
    cited = set(re.findall(r"[\w-]+", " ".join(re.findall(r"\\cite\{([^}]*)\}", content))))
    for key in cited:
        facts.pick("\\cite", key, metadata.bibliography())
    fields = about(release, paper, prose)
    texts = {
        "content.tex": content,
        "metadata.yaml": "\n".join(metadata.yaml_lines(fields)) + "\n",
        "bibliography.bib": metadata.entries_of(cited) + "\n",
        "standalone.tex": jinja.get_template("standalone.tex.j2").render(
            title=tex(fields["title"]), authors=[tex(a["name"]) for a in fields["authors"]]
        ),
    }
    (out / paper / "figures").mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (out / paper / name).write_text(text, encoding="utf-8", newline="\n")
    for stem in facts.figures:
        shutil.copy(facts.folder / "figures" / f"{stem}.png", out / paper / "figures")
    return [line for line in texts["metadata.yaml"].splitlines() if metadata.PLACEHOLDER in line]


def main() -> None:
    """The command line; see the top of this file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="folder for the articles")
    parser.add_argument("--results", type=Path, default="out", help="folder of celnav reproduce")
    given = parser.parse_args()
    for paper in ARTICLES:
        try:
            waiting = write(paper, given.results, given.out)
        except (ValueError, OSError, TemplateError) as error:
            sys.exit(f"{error}")
        print(f"wrote {given.out / paper}")
        for line in waiting:
            print(f"  packaging/owner.toml has a placeholder: {line.strip(' -')}")


if __name__ == "__main__":
    main()
