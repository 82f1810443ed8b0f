"""Articles for ReScience C: their prose states what is in the ledgers, and no number of its own."""

from __future__ import annotations

import csv
import json
import re
import shutil
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest
import yaml
from once import once

from celnav.papers import load
from celnav.show.claims import dumps

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "packaging"))  # its programs are no package
metadata, rescience = map(import_module, ("metadata", "rescience"))
PAPERS = list(rescience.ARTICLES)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Results of few runs, with the verdicts of all runs, in the form of ``celnav reproduce``."""
    out = tmp_path_factory.mktemp("out")
    for paper in PAPERS:
        module = load(paper)
        found = once(module.STUDY)
        document = json.loads(dumps(c for c in found.claims() if c.kind != "check"))
        for claim in document["claims"]:
            claim["verdict"] = claim["expected"]
        about = {"celnav": metadata.load().version, "machine": "a_machine, 2 cores"}
        about |= dict.fromkeys(("python", "numpy", "scipy"), "1.2.3")
        run = {"about": about, "effort": 1.0, "seed": 0, "cpu_s": 1.5}
        for folder in ("figures", "tables"):
            (out / paper / folder).mkdir(parents=True)
        (out / paper / "claims.json").write_text(json.dumps(document), encoding="utf-8")
        (out / paper / "timings.json").write_text(json.dumps(run), encoding="utf-8")
        for stem in module.FIGURES:
            (out / paper / "figures" / f"{stem}.png").write_bytes(stem.encode())
        for stem, (_, table) in module.TABLES.items():
            if rows := table(found):
                path = out / paper / "tables" / f"{stem}.csv"
                with path.open("w", encoding="utf-8", newline="") as file:
                    writer = csv.DictWriter(file, list(rows[0]))
                    writer.writeheader()
                    writer.writerows(rows)
    return out


def template(paper):
    return (rescience.TEMPLATES / f"{paper}.tex.j2").read_text(encoding="utf-8")


def changed(results, paper, out, name, change):
    """Results with a change in a file."""
    shutil.copytree(results / paper, out / paper)
    document = json.loads((results / paper / name).read_text(encoding="utf-8"))
    change(document)
    (out / paper / name).write_text(json.dumps(document), encoding="utf-8")
    return out


# -- what is written -------------------------------------------------------------------------------
@pytest.mark.parametrize("paper", PAPERS)
def test_an_article_fits_into_the_template_of_the_journal(results, tmp_path, paper):
    waiting = rescience.write(paper, results, tmp_path)
    folder = tmp_path / paper
    text = (folder / "content.tex").read_text(encoding="utf-8")
    assert not re.search(r"<<|>>|<%|%>|\bnan\b|None|Undefined", text)
    assert not re.search(r"[^\x00-\xff]", text)
    assert text.count("{") == text.count("}")
    for kind in ("figure", "table", "equation", "itemize", "tabularx"):
        assert text.count(rf"\begin{{{kind}}}") == text.count(rf"\end{{{kind}}}") > 0
    assert r"\usepackage" not in text
    labels = re.findall(r"\\label\{(\w+)\}", text)
    assert len(set(labels)) == len(labels)
    assert set(re.findall(r"\\ref\{(\w+)\}", text)) <= set(labels)
    shown = re.findall(r"\\includegraphics\[.*?\]\{(.*?)\}", text)
    assert 3 <= len(shown) <= 5
    assert {path.name for path in (folder / "figures").iterdir()} == {Path(s).name for s in shown}
    assert {Path(s).stem for s in shown} <= set(re.findall(r"\\ref\{(\w+)\}", text))
    cited = set(re.findall(r"\\cite\{(\w+)\}", text))
    bibliography = (folder / "bibliography.bib").read_text(encoding="utf-8")
    assert cited == set(re.findall(r"^@\w+\{(\w+),", bibliography, re.MULTILINE))
    rows = [row for row in load(paper).STUDY.rows if row.kind == "statement"]
    assert text.count(r"\noalign{\vskip 2pt}") == len(rows) + 2  # and two heads
    about = yaml.safe_load((folder / "metadata.yaml").read_text(encoding="utf-8"))
    assert about["title"].startswith("[Re] ")
    assert (about["type"], about["language"]) == ("Replication", "Python")
    assert about["bibliography"] == "bibliography.bib"
    for name in ("domain", "keywords", "abstract"):
        assert about[name]
    assert " ".join(about["abstract"].split()) in " ".join(text.split())
    pairs = {"code": "url doi swh", "data": "url doi", "replication": "cite bib url doi"}
    pairs |= {"review": "url", "dates": "received accepted published", "article": "number doi url"}
    pairs |= {"journal": "name issn volume issue"}
    for name, keys in pairs.items():
        assert [key for pair in about[name] for key in pair] == keys.split()
    assert about["replication"][1]["bib"] == rescience.ARTICLES[paper]
    assert about["authors"][0]["affiliations"] == "1,*"
    assert [each["role"] for each in about["contributors"]] == ["editor", "reviewer", "reviewer"]
    assert len(waiting) == str(about).count(metadata.PLACEHOLDER)
    assert r"\input{content}" in (folder / "standalone.tex").read_text(encoding="utf-8")


def test_people_come_from_the_list_of_the_owner():
    release = metadata.load()
    listed = [
        {"given": "Ada", "family": "Lovelace", "affiliation": "Here", "email": "ada@example.org"},
        {"given": "Mary", "family": "Somerville", "affiliation": "There", "orcid": "0000-1"},
        {"given": "Émilie", "family": "du Châtelet", "affiliation": "Here"},
    ]
    people = rescience.people(replace(release, owner=release.owner | {"authors": listed}))
    assert [author["affiliations"] for author in people["authors"]] == ["1,*", "2", "1"]
    assert [author["email"] for author in people["authors"]] == ["ada@example.org", "", ""]
    assert [place["name"] for place in people["affiliations"]] == ["Here", "There"]
    del listed[0]["email"]
    people = rescience.people(replace(release, owner=release.owner | {"authors": listed}))
    assert people["authors"][0]["email"] == metadata.PLACEHOLDER


@pytest.mark.parametrize(
    ("text", "latex"),
    [
        ("Φ = 0.8 I, 5 % & S_i", r"$\Phi$ = 0.8 I, 5 \% \& S\_i"),
        ("57000 [46700, 68500]", r"57\,000 [46\,700, 68\,500]"),
        ("-5.35 [-7.65, -3.16]", "$-$5.35 [$-$7.65, $-$3.16]"),
        ("≤ 1.5e-09, 1e6/1e6 m", r"$\le$ $1.5\times10^{-9}$, $1\times10^{6}$/$1\times10^{6}$ m"),
        ("§4, Figs 8-13, 8–13", r"\S\,4, Figs 8--13, 8--13"),
        ("0.123456, 1234", "0.123456, 1234"),
    ],
)
def test_text_of_the_ledger_in_latex(text, latex):
    assert rescience.tex(text) == latex


def test_a_sign_without_latex_is_refused():
    with pytest.raises(ValueError, match=r"SIGNS: expected LaTeX for 'Ω'"):
        rescience.tex("1 Ω")


# -- what is stated --------------------------------------------------------------------------------
TYPED = (
    r"<#.*?#>|<%.*?%>|<<.*?>>",  # comments and what comes from the results
    r"\\begin\{equation\}.*?\\end\{equation\}",
    r"\\(?:ref|label|cite)\{.*?\}|\\setlength\\\w+\{3pt\}",
    r"Eqs?\.[ ~]\d+(?:(?:, | and |--)\d+)*",
    r"(?:Tables?|Figs?\.)[ ~]\d+(?: and[ ~]\d+)*",  # of the original paper
    r"95\\,\\% (?:intervals?|ranges)",
)
"""Where prose may have digits."""


def typed(text):
    """Lines and formulas of a template with a number that does not come from the results."""
    for pattern in TYPED:
        text = re.sub(pattern, "", text, flags=re.DOTALL)
    formulas = re.findall(r"\$(.*?)\$", text, re.DOTALL)
    prose = re.sub(r"\$.*?\$", "", text, flags=re.DOTALL)
    # A formula may have x_1 and x / 2, which is not a result.
    wrong = [f for f in formulas if re.search(r"\d[.,]\d|\d\d", f) or not re.search("[A-Za-z]", f)]
    return wrong + re.findall(r".*\d.*", prose)


@pytest.mark.parametrize("paper", PAPERS)
def test_no_number_is_typed(paper):
    assert typed(template(paper)) == []


@pytest.mark.parametrize(
    "words", ["is 0.53 times", "is $0.53$ times", r"is 53\,\% of", "in 100 runs"]
)
def test_a_number_that_is_typed_is_found(words):
    assert typed(template("csrukf").replace(r"\section{Results}", words)) != []


@pytest.mark.parametrize("paper", PAPERS)
def test_every_verdict_that_the_prose_states_is_checked(results, tmp_path, paper):
    stated = set(re.findall(r'<< verdict\("([\w-]+)", "[\w ]+"\) >>', template(paper)))
    assert len(stated) > 15
    for id in sorted(stated):

        def change(document, id=id):
            (claim,) = (claim for claim in document["claims"] if claim["id"] == id)
            claim["verdict"] = "undecided"

        folder = tmp_path / id
        folder.mkdir()
        with pytest.raises(ValueError, match=rf"{paper}: {id}: the text says .* 'undecided'"):
            rescience.write(
                paper, changed(results, paper, folder, "claims.json", change), folder / "made"
            )


CASES = {
    'verdict("csrukf-converge", "in part")': "row: not in the results: 'csrukf-converge'; did you",
    'interval("consistent", "mean NEES at the end, Φ = 0")': (
        "consistent: expected its verdict before its number 'mean NEES at the end, Φ = 0'"
    ),
    'verdict("consistent", "shown") ~ value("consistent", "Φ = 2")': "number of consistent: not in",
    'parameter("sigma_m")': "parameter of P: not in the results: 'sigma_m'",
    'parameter("phi", "Q")': "preset or part: not in the results: 'Q'",
    'rows("table_9")': "table: not in the results: 'table_9'",
    "sigma_km": "'sigma_km' is undefined",
}


@pytest.mark.parametrize("expression", CASES)
def test_what_the_results_do_not_have_is_refused(results, expression):
    facts = rescience.Facts("csrukf", results)
    made = rescience.environment().from_string(f"<< {expression} >>")
    with pytest.raises(Exception, match=re.escape(CASES[expression])):
        made.render(facts.names)


def test_a_missing_figure_is_refused(results):
    facts = rescience.Facts("csrukf", results)
    with pytest.raises(ValueError, match=r"csrukf: figure: not in the results: 'figure_99'"):
        facts.figure("figure_99", lambda: "")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"effort": 0.1}, "expected all runs, got effort 0.1"),
        ({"about": {"celnav": "0.0.1"}}, "expected version .*, got 0.0.1"),
    ],
)
def test_results_of_few_runs_or_of_another_version_are_refused(results, tmp_path, change, said):
    folder = changed(results, "aukf", tmp_path, "timings.json", lambda run: run.update(change))
    with pytest.raises(ValueError, match=said):
        rescience.write("aukf", folder, tmp_path / "made")


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"--results: expected results of `celnav reproduce csr"):
        rescience.Facts("csrukf", tmp_path)
