"""The README: its table of verdicts is that of the executed notebooks, its links and pictures are there."""

from __future__ import annotations

import pydoc
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest

import celnav
from celnav.commands.index import summary, verdicts
from celnav.papers import PAPERS, load

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def found(paper):
    """Verdicts in the ledger of a paper's notebook, which was executed with all runs."""
    path = ROOT / "notebooks" / f"{list(PAPERS).index(paper) + 1:02d}_{paper}.ipynb"
    cells = nbformat.read(path, as_version=4).cells
    pages = [
        o.data.get("text/html", "")
        for c in cells
        if c.cell_type == "code"
        for o in c.outputs
        if "data" in o
    ]
    ledger = next(page for page in pages if "<th>verdict</th>" in page)
    found = re.findall(
        r'<tr id="([^"]*)"[^>]*>.*?<td class="\w+">(?:<a [^>]*>)?([^<]*)(?:</a>)?</td></tr>', ledger
    )
    return [{"kind": "statement", "id": id, "verdict": verdict} for id, verdict in found]


def test_the_table_of_verdicts_is_not_stale():
    assert verdicts({paper: found(paper) for paper in PAPERS}) in README


def test_the_words_are_those_of_the_page():
    assert summary(list(PAPERS)) in README
    count = sum(row.kind == "statement" for paper in PAPERS for row in load(paper).STUDY.rows)
    assert f"make {count} statements" in README


@pytest.mark.parametrize("paper", PAPERS)
def test_a_notebook_shows_every_statement(paper):
    assert [claim["id"] for claim in found(paper)] == [
        row.id for row in load(paper).STUDY.rows if row.kind == "statement"
    ]


def test_links_and_pictures_are_there():
    targets = re.findall(r"\]\(([^)#:]+)\)", README)
    assert "docs/csrukf.png" in targets
    assert all((ROOT / target).exists() for target in targets)


TEXTS = [
    ROOT / "README.md",
    *(p for room in ("benchmarks", "docs") for p in (ROOT / room).rglob("*.md")),
]
TEXTS += [*(ROOT / "celnav").rglob("*.py"), *(ROOT / "notebooks").glob("*.ipynb")]


def test_import_celnav_is_enough_for_every_name_with_dots():
    """Names of the README, the docs, the notebooks and all docstrings, in a fresh process that imports nothing else."""
    names = {
        name
        for path in TEXTS
        for name in re.findall(r"`(celnav(?:\.\w+)+)\b", path.read_text(encoding="utf-8"))
    }
    assert len(names) > 70
    program = "import sys, celnav\nfor name in sys.argv[1:]:\n    eval(name)\n"
    done = subprocess.run(
        [sys.executable, "-c", program, *sorted(names)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_import_celnav_stays_fast():
    """What only studies and drawings need is not imported before it is asked for, and what is not there is told."""
    program = (
        "import sys, celnav\nassert not {'matplotlib', 'rerun', 'celnav.analysis.tuning', 'celnav.papers'} & set(sys.modules)\n"
        "assert 'tuning' in dir(celnav.analysis)\n"
        "assert not hasattr(celnav, 'nonsense') and not hasattr(celnav.models, 'nonsense')\n"
        "from celnav.analysis import metrics\nassert celnav.analysis.metrics is metrics\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_it_says_how_to_cite_this_version():
    assert f"version = {{{celnav.__version__}}}" in README
    assert f"version: {celnav.__version__}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_constraints_say_why_they_have_no_hashes():
    """And have none: the command above would fail."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert "no hashes" in " ".join(line for line in lines if line.startswith("#"))
    assert not any("--hash" in line for line in lines)


def test_help_names_every_public_function_first():
    """Its first chapter has them by subject, and no method of tuples is in it."""
    chapter = (celnav.__doc__ or "").split("Conventions")[0]
    assert set(re.findall(r"`(\w+)`", chapter)) >= set(celnav.__all__) - {"EUCLIDEAN", "Filter"}
    assert "count(self, value" not in pydoc.plaintext.document(celnav)
