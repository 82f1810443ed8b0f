"""Notebooks were executed in order, their outputs are committed, and lessons contain the algorithm,
not only figures.
"""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path

import nbformat
import pytest

from celnav import real
from celnav.papers import PAPERS, load
from celnav.study.ledger import WORDS

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_is_read_in_one_sitting_and_executed(path):
    assert path.stat().st_size < 1_000_000
    notebook = nbformat.read(path, as_version=4)
    assert notebook.metadata.kernelspec.name == "python3"
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    lines = [line for cell in cells for line in cell.source.splitlines() if line.strip()]
    assert len(lines) <= 260
    assert not any(line.lstrip().startswith(("class ", "%", "!")) for line in lines)
    assert not any(output.output_type == "error" for cell in cells for output in cell.outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_begins_with_an_equation_or_a_picture_and_is_as_wide_as_a_page(path):
    """No line of code runs out of its cell, and figures have the width of the page's text."""
    cells = nbformat.read(path, as_version=4).cells
    assert any(
        "$$" in cell.source
        or any("image/png" in output.get("data", {}) for output in cell.get("outputs", ()))
        for cell in cells[:3]
    )
    code = [cell.source for cell in cells if cell.cell_type == "code"]
    assert not [line for source in code for line in source.splitlines() if len(line) > 100]
    assert not [source for source in code if re.search(r"\bsize=\(", source)]


LESSONS = [path for path in NOTEBOOKS if path.stem[3:] in PAPERS]


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_a_lesson_has_the_algorithm_and_something_to_try(path):
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    (by_hand, *_) = [i for i, cell in enumerate(cells) if "allclose" in cell.source]
    assert any("def " in cell.source for cell in cells[: by_hand + 1])
    assert "celnav.run(" in cells[by_hand].source
    lines = [line for cell in cells for line in cell.source.splitlines() if line.strip()]
    assert sum("FIGURES" in line or "figures(" in line for line in lines) < 0.5 * len(lines)
    (one,) = [
        cell.metadata.execution for cell in cells if "try-it" in cell.metadata.get("tags", ())
    ]
    begun, ended = (
        datetime.fromisoformat(one[when]) for when in ("iopub.execute_input", "shell.execute_reply")
    )
    assert (ended - begun).total_seconds() < 5.0


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_a_lesson_begins_with_the_idea_and_ends_with_what_holds(path):
    """An equation and a picture first, the algorithm before the ledger, questions with answers."""
    cells = nbformat.read(path, as_version=4).cells
    assert cells[0].source.count("$$") >= 2
    assert any("image/png" in output.get("data", {}) for output in cells[1].outputs)
    (second,) = [i for i, cell in enumerate(cells) if cell.source.startswith("## What holds")]
    lesson, rest = cells[:second], cells[second:]
    assert any("allclose" in cell.source for cell in lesson[: len(lesson) // 2 + 1])
    assert not any("Ledger(" in cell.source for cell in lesson)
    assert any("Folded(" in cell.source for cell in rest)
    prose = "".join(cell.source for cell in cells if cell.cell_type == "markdown")
    assert prose.count("<summary>Answer</summary>") >= 2
    assert not [text for text, id in re.findall(r"\[([^\]]+)\]\(#([\w-]+)\)", prose) if text == id]


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_a_lesson_shows_a_recording_that_a_click_opens(path):
    cells = nbformat.read(path, as_version=4).cells
    (shown,) = [cell for cell in cells if cell.get("attachments")]
    ((name, images),) = shown.attachments.items()
    assert images["image/png"].startswith("iVBOR")
    (recording,) = re.findall(
        rf"\]\(attachment:{name}\)\]\(\.\./out/viewer\.html\?(\S+)\)", shown.source
    )
    assert f"{recording}.rrd".removeprefix(f"{path.stem[3:]}/") in load(path.stem[3:]).RECORDINGS


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_each_verdict_leads_to_the_cell_that_decides_it(path):
    cells = nbformat.read(path, as_version=4).cells
    statements = sorted(row.id for row in load(path.stem[3:]).STUDY.rows if row.kind == "statement")
    told = [
        i
        for i, cell in enumerate(cells)
        if cell.cell_type == "markdown" and "<a id=" in cell.source
    ]
    assert (
        sorted(id for i in told for id in re.findall(r'<a id="say-([\w-]+)"></a>', cells[i].source))
        == statements
    )
    assert all(cells[i + 1].cell_type == "code" for i in told)
    shown = [
        output.get("data", {}).get("text/html", "")
        for cell in cells
        for output in cell.get("outputs", ())
    ]
    assert (
        sorted(id for text in shown for id in re.findall(r'href="#say-([\w-]+)"', text))
        == statements
    )


def verdicts(path):
    """Verdicts by id in the ledgers of an executed notebook."""
    cells = nbformat.read(path, as_version=4).cells
    shown = "".join(
        output.get("data", {}).get("text/html", "")
        for cell in cells
        for output in cell.get("outputs", ())
    )
    return dict(re.findall(r'<tr id="([^"]*)" data-verdict="([^"]*)"', shown))


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_a_lesson_has_the_verdicts_that_are_expected(path):
    """It was executed with all runs."""
    expected = {
        row.id: row.expected or WORDS[row.kind][0] for row in load(path.stem[3:]).STUDY.rows
    }
    found = verdicts(path)
    assert found
    assert found == {id: expected[id] for id in found}


@pytest.mark.parametrize("study", real.STUDIES)
def test_the_notebook_on_real_data_has_the_verdicts_that_are_expected(study):
    """Its outputs come from the real files, which are not available in tests."""
    found = verdicts(next(path for path in NOTEBOOKS if path.stem[3:] == "real_data"))
    for row in real.load(study).STUDY.rows:
        # Without the package that a row compares with, no verdict is expected.
        if row.kind == "finding" and row.expected != "no number":
            assert found[row.id] in ("undecided", row.expected or "shown"), row.id


def test_the_notebook_on_real_data_says_once_why_ranges_were_revised():
    """Each study's rows that were revised for one reason share one note, which counts them."""
    (path,) = [path for path in NOTEBOOKS if path.stem[3:] == "real_data"]
    cells = nbformat.read(path, as_version=4).cells
    html = "".join(
        output.get("data", {}).get("text/html", "")
        for cell in cells
        for output in cell.get("outputs", ())
    )
    notes = re.findall(r"Accepted range revised: (.*?)(?:<|$)", html, re.MULTILINE)
    assert notes
    assert len(notes) == len(set(notes))
    others = [int(count) for note in notes for count in re.findall(r"this and (\d+) other", note)]
    rows = [row for study in real.STUDIES for row in real.load(study).STUDY.rows]
    assert len(notes) + sum(others) == sum(
        row.revised is not None and row.kind == "finding" for row in rows
    )


def test_there_are_notebooks():
    assert NOTEBOOKS
