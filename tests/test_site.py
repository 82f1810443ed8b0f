"""The site: its programs run unchanged, and the names and paths that it mentions exist."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

import celnav
from celnav.filters.track import Track
from celnav.papers import PAPERS, load
from docs.conf import SMALL, parameters, written
from docs.pages import errata, labeled, sources

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [
    path for path in sorted(DOCS.rglob("*.md")) if "```python" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("path", PAGES, ids=lambda p: p.stem)
def test_a_page_runs(path, capsys, tmp_path, monkeypatch):
    """The programs of a page, run one after the other, print the output on the page."""
    monkeypatch.chdir(tmp_path)
    text = path.read_text(encoding="utf-8")
    program = "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    exec(compile(program, str(path), "exec"), {})
    printed = capsys.readouterr().out
    assert "nan" not in printed
    shown = "".join(re.findall(r"```text\n(.*?)```", text, re.DOTALL))
    assert [line for line in shown.splitlines() if line not in printed.splitlines()] == []


def test_every_source_is_on_the_page_of_sources():
    """An entry without its closing brace would absorb the next entry."""
    text = (ROOT / "data" / "references.bib").read_text(encoding="utf-8")
    entries = re.split(r"^@", text, flags=re.MULTILINE)[1:]
    assert len(entries) > 20
    for entry in entries:
        assert entry.count("{") == entry.count("}"), entry[:60]
        assert "\\" not in entry.replace("\\&", ""), entry[:60]  # letters are Unicode's
    page = sources()
    assert {entry.split("{")[1].split(",")[0] for entry in entries} == set(
        re.findall(r"^\((\w+)\)=$", page, re.MULTILINE)
    )
    for doi in re.findall(r"doi\s*=(.*)", text):
        assert re.fullmatch(r" \{10\.\d{4,5}/\S+\}", doi), doi
        assert f"(https://doi.org/{doi[2:-1]})" in page, doi


def test_errata_are_those_of_the_ledgers():
    page = errata()
    for paper in PAPERS:
        rows = [row for row in load(paper).STUDY.rows if row.kind == "erratum"]
        assert all(labeled(row.says) in page for row in rows)
    assert labeled("Printed: a. Correct: b.") == "**Printed:** a.<br>**Correct:** b."
    assert labeled("Table 2 is wrong.") == "Table 2 is wrong."


def test_what_is_in_the_pages_is_in_the_house():
    """Names of celnav and paths of tests."""
    for path in DOCS.rglob("*.md"):
        text = path.read_text(encoding="utf-8")
        assert all((ROOT / name).exists() for name in re.findall(r"`(tests/[\w./]+)`", text)), path


def described(thing):
    """Fields that the reference makes from a docstring: text by name."""
    lines = inspect.getdoc(thing).splitlines()
    written(None, "", "", thing, None, lines)
    fields = re.split(rf"^:{SMALL}([\w, ]+): ", "\n".join(lines), flags=re.MULTILINE)
    return dict(zip(fields[1::2], fields[2::2], strict=True))


def test_each_parameter_on_a_line_of_a_docstring_has_its_entry():
    found = described(celnav.run)
    assert set(found) == set(inspect.signature(celnav.run).parameters) - {"z", "u"}
    assert found["filter"] == "any filter.\n"
    assert found["prior"].startswith("a `celnav.Gaussian`")
    found = described(Track)
    assert found["mean"] == "``(T, ..., N)``.\n"
    assert " ".join(found["std"].split()).startswith("``(T, ..., n)``. None: not stored.")
    assert {
        "times",
        "belief",
        "innovation, whitened, used",
        "events",
        "engine",
        "filter, epochs",
    } <= set(found)


def test_a_line_that_goes_on_is_no_paragraph():
    """A continuation line belongs to its argument even without indentation; a sentence of a module
    has no arguments.
    """
    space = described(celnav.Sensor)["space"]
    assert "wraps component 1." in " ".join(space.split())
    lines = ["Exact over an interval of any", "length: two steps equal one."]
    written(None, "module", "", celnav.models.motion, None, lines)
    assert lines == ["Exact over an interval of any", "length: two steps equal one."]


PUBLIC = [
    thing
    for name in dir(celnav)
    if not name.startswith("_")
    if inspect.isclass(thing := getattr(celnav, name)) or inspect.isfunction(thing)
]


@pytest.mark.parametrize("thing", PUBLIC, ids=lambda thing: thing.__name__)
def test_what_a_docstring_says_of_a_parameter_is_not_within_that_of_another(thing):
    names = parameters(thing)
    for text in described(thing).values():
        inner = re.findall(r"(?:^|[.)`]\s+)(\w+(?:, \w+)*): \S", text)
        assert [found for found in inner if names.issuperset(found.split(", "))] == []


def test_words_with_a_colon_that_are_no_parameters_stay_where_they_are():
    def thing(a, b):
        """Do it.

        a: one of two. None: the first. b: another,
            which is long. Note: it is. a, b: of both.
        """

    assert described(thing) == {
        "a": "one of two. None: the first.\n",
        "b": "another,\n    which is long. Note: it is.\n",
        "a, b": "of both.",
    }
