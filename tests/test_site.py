"""The site: its programs run as they stand, and what it says is in the house is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from celnav.papers import PAPERS, load
from docs.pages import errata, sources

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [
    path for path in sorted(DOCS.rglob("*.md")) if "```python" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("path", PAGES, ids=lambda p: p.stem)
def test_a_page_runs(path, capsys, tmp_path, monkeypatch):
    """The programs of a page, one after the other."""
    monkeypatch.chdir(tmp_path)
    program = "\n".join(
        re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)
    )
    exec(compile(program, str(path), "exec"), {})
    assert "nan" not in capsys.readouterr().out


def test_every_source_is_on_the_page_of_sources():
    """An entry that is not closed would swallow the next one."""
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
        assert all(row.says in page for row in load(paper).STUDY.rows if row.kind == "erratum")


def test_what_is_in_the_pages_is_in_the_house():
    """Names of celnav and paths of tests."""
    for path in DOCS.rglob("*.md"):
        text = path.read_text(encoding="utf-8")
        assert all((ROOT / name).exists() for name in re.findall(r"`(tests/[\w./]+)`", text)), path
