"""Notebooks are executed in order, their outputs are committed, and lessons teach: the algorithm is there, not only figures."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import nbformat
import pytest

from celnav.papers import PAPERS

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


LESSONS = [path for path in NOTEBOOKS if path.stem[3:] in PAPERS]


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_a_lesson_has_the_algorithm_and_something_to_try(path):
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    by_hand = [cell.source for cell in cells if "allclose" in cell.source]
    assert any("def " in source and "celnav.run(" in source for source in by_hand)
    lines = [line for cell in cells for line in cell.source.splitlines() if line.strip()]
    assert sum("FIGURES" in line or "figures(" in line for line in lines) < 0.5 * len(lines)
    (one,) = [cell.metadata.execution for cell in cells if "try-it" in cell.metadata.get("tags", ())]
    begun, ended = (datetime.fromisoformat(one[when]) for when in ("iopub.execute_input", "shell.execute_reply"))
    assert (ended - begun).total_seconds() < 5.0


def test_there_are_notebooks():
    assert NOTEBOOKS
