"""Notebooks are thin, executed in order, and their outputs are committed."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_is_thin_and_executed(path):
    assert path.stat().st_size < 1_000_000
    notebook = nbformat.read(path, as_version=4)
    assert notebook.metadata.kernelspec.name == "python3"
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    lines = [line for cell in cells for line in cell.source.splitlines() if line.strip()]
    own = path.stem == "00_tour"  # where a newcomer writes a model
    assert len(lines) <= (165 if own else 60)
    assert not any(line.lstrip().startswith(("class ", "%", "!")) for line in lines)
    assert not any(output.output_type == "error" for cell in cells for output in cell.outputs)


def test_there_are_notebooks():
    assert NOTEBOOKS
