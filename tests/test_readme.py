"""The README and the page of verdicts are short, and their numbers are the package's results."""

from __future__ import annotations

import json
import pydoc
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import celnav
from benchmarks.report import MEASURED, shown
from celnav import real
from celnav.papers import PAPERS, load
from celnav.real.ins import PEER
from docs.pages import judged, picture, verdict_page

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PROSE = re.sub(r"```.*?```|<!--.*?-->", "", README, flags=re.DOTALL)


def test_it_is_read_in_a_minute():
    assert README.count("\n") <= 120
    assert len(PROSE.split()) <= 900
    cells = [
        cell for line in PROSE.splitlines() if line.startswith("|") for cell in line.split("|")
    ]
    assert max(len(cell.strip()) for cell in cells) <= 90


def sentences(text):
    """Sentences of a page, without programs, tables and headings."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    lines = [line for line in text.splitlines() if not line.startswith(("|", "#", "<", "!"))]
    return re.split(r"(?<=[.:;!?])\s+|\n\n", "\n".join(lines))


def test_sentences_are_short():
    """In README, site and the papers' findings at most ten sentences have more than 35 words."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    texts = [path.read_text(encoding="utf-8") for path in pages]
    texts += [s.text for paper in PAPERS for s in load(paper).STUDY.found]
    long = too_long(texts)
    assert len(long) <= 10, long


def too_long(texts):
    return [s for text in texts for s in sentences(text) if len(s.split()) > 35]


def test_sentences_of_the_ledgers_are_short():
    """In the statements and explanations of all rows at most ten sentences have more than 35 words.

    Numbers are not filled in.
    """
    studies = [
        *(load(paper).STUDY for paper in PAPERS),
        *(real.load(s).STUDY for s in real.STUDIES),
    ]
    rows = [row for study in studies for row in study.rows]
    assert len(rows) > 200
    texts = [text for row in rows for text in (row.says, row.why, row.found, row.revised) if text]
    long = too_long(texts)
    assert len(long) <= 10, long


def test_the_program_prints_what_is_shown(capsys):
    program, output = re.search(r"```python\n(.*?)```\n\n```\n(.*?)```", README, re.DOTALL).groups()
    exec(compile(program, "README.md", "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    assert [line for line in output.splitlines() if line not in (*printed, "...")] == []


def test_the_diagnosis_is_what_is_shown(tmp_path):
    """For fixes whose errors have a correlation of 0.95 from one second to the next."""
    rng, error = np.random.default_rng(1), np.zeros(1200)
    for k in range(1, 1200):
        error[k] = 0.95 * error[k - 1] + np.sqrt(1 - 0.95**2) * 1.5 * rng.standard_normal()
    rows = np.c_[np.arange(1200.0), error, np.full(1200, 1.5)]
    log = tmp_path / "residuals.csv"
    np.savetxt(log, rows, "%.4f", ",", header="t,east_m,std_east_m", comments="")
    command = [sys.executable, "-m", "celnav", "diagnose", str(log)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    output = re.search(r"predicted σ:\n\n```\n(.*?)```", README, re.DOTALL)[1]
    assert [line for line in output.splitlines() if line not in done.stdout.splitlines()] == []


def test_the_verdicts_are_those_of_the_notebooks():
    """``python -m docs.pages`` writes the page and its picture."""
    assert (ROOT / "docs" / "verdicts.md").read_text(encoding="utf-8") == verdict_page()
    assert (ROOT / "docs" / "verdicts.svg").read_text(encoding="utf-8") == picture()
    rows = [row for paper in PAPERS for row in load(paper).STUDY.rows if row.kind == "statement"]
    tested = sum(row.expected != "not addressed" for row in rows)
    assert f"judge {tested} of {len(rows)} statements" in README
    assert f"![{len(rows)} verdicts" in README


@pytest.mark.parametrize("paper", PAPERS)
def test_what_is_said_of_a_paper_is_one_of_its_findings(paper):
    line = re.search(rf"- \[`{paper}`\]\(notebooks/\d\d_{paper}.ipynb\): (.*)", README)[1]
    found = " ".join(sentence.text for sentence in load(paper).STUDY.found)
    assert line in found


def test_a_step_takes_what_was_measured():
    rows = json.loads(MEASURED.read_text(encoding="utf-8"))["cells"]["filtering"]["rows"]
    row = next(
        row
        for row in rows
        if (row["problem"], row["method"])
        == ("4,096 runs, 48 epochs", "celnav compiled, square root")
    )
    assert f"machine code: {shown(float(np.median(row['values'])))} µs per step" in README


@pytest.mark.parametrize("paper", PAPERS)
def test_a_notebook_shows_every_statement(paper):
    assert [claim["id"] for claim in judged(paper)] == [
        row.id for row in load(paper).STUDY.rows if row.kind == "statement"
    ]


def test_the_drift_of_a_car_is_that_of_the_notebook():
    """The largest error, and the ratio of the median to the median of the program published with
    the log.
    """
    notebook = (ROOT / "notebooks" / "07_real_data.ipynb").read_text(encoding="utf-8")
    largest = float(re.search(r"largest drift \(m\)</td><.*?>([\d.]+)", notebook)[1])
    row = re.search(r'<tr id=\\"wheels-peer\\".*?</tr>', notebook, re.DOTALL)[0]
    median = PEER["wheels"][0] * float(re.search(r"of the program</td><.*?>([\d.]+) \[", row)[1])
    assert f"do not slip, {median:.1f} m ({largest:.1f} m at most)" in README


def test_links_and_pictures_are_there():
    targets = re.findall(r"\]\(([^)#:]+)\)", README)
    assert "docs/csrukf.png" in targets
    assert all((ROOT / target).exists() for target in targets)


SUBJECTS = {
    "square root": "square-root",
    "IMM": "IMM",
    "late samples": "late",
    "NEES, NIS": "NEES",
    "many runs": "many runs",
    "C code": "C code",
    "particle filters": "particle",
    "gradients, GPU": "gradients",
}


def test_what_others_have_in_part_is_explained():
    """Each ``~`` in the comparison, and nothing else, has its reason on the page of other
    libraries.
    """
    table = re.search(r"## Compared with.*?\n(\|.*?)\n\n", README, re.DOTALL)[1].splitlines()
    names = [name.strip() for name in table[0].split("|")[2:-1]]
    in_part = {
        (line.split("|")[1].strip(), name)
        for line in table[2:]
        for name, cell in zip(names, line.split("|")[2:-1], strict=True)
        if cell.strip() == "~"
    }
    page = (ROOT / "docs" / "neighbors.md").read_text(encoding="utf-8")
    explained = {
        (row, name)
        for subject, libraries in re.findall(r"^\| ([^|:]+): ([^|]+) \|", page, re.MULTILINE)
        for name in libraries.split(", ")
        for row in {row for row, _ in in_part if row.startswith(SUBJECTS[subject])}
    }
    assert len(in_part) > 10
    assert in_part == explained


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
    """Packages for studies and figures are imported on first use, and a missing
    package is named.
    """
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
    assert "(CITATION.cff)" in README
    assert f"version: {celnav.__version__}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_constraints_say_why_they_have_no_hashes():
    """And they have no hashes: with hashes the command above would fail."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert "no hashes" in " ".join(line for line in lines if line.startswith("#"))
    assert not any("--hash" in line for line in lines)


def test_help_names_every_public_function_first():
    """Its first chapter lists them by subject, without methods of tuples."""
    chapter = (celnav.__doc__ or "").split("Conventions")[0]
    assert set(re.findall(r"`(\w+)`", chapter)) >= set(celnav.__all__) - {"EUCLIDEAN", "Filter"}
    assert "count(self, value" not in pydoc.plaintext.document(celnav)
