"""The benchmark measures all installed libraries, and the READMEs quote its results."""

from __future__ import annotations

import inspect
import json
from importlib import import_module

import numpy as np
import pytest

from benchmarks import cells, measure, problems, report
from benchmarks.using_celnav import compiled, run

CELLS = {cell.name: cell for cell in cells.cells()}


@pytest.mark.parametrize("path", report.PAGES, ids=lambda path: path.parent.name)
def test_a_page_quotes_what_was_measured(path):
    """``python -m benchmarks --quote`` writes both."""
    result = json.loads(report.MEASURED.read_text(encoding="utf-8"))
    text = path.read_text(encoding="utf-8")
    assert text.count("<!-- speed: ") == text.count("<!-- end of speed -->") >= 1
    assert report.quoted(text, result) == text


def test_all_cells_were_measured():
    """Each problem with each method, or the reason why not."""
    result = json.loads(report.MEASURED.read_text(encoding="utf-8"))
    assert {
        (name, row["problem"], row["method"])
        for name, cell in result["cells"].items()
        for row in cell["rows"]
    } == {
        (name, entry.problem, entry.method)
        for name, cell in CELLS.items()
        for entry in cell.entries
    }
    assert all(row.get("agrees", True) for cell in result["cells"].values() for row in cell["rows"])


@pytest.mark.parametrize("name", CELLS)
def test_entries_fit_their_functions(name):
    for entry in CELLS[name].entries:
        library, _, function = entry.work.partition(".")
        if library in ("celnav", "numpy", "filterpy"):  # others come with [bench]
            found = getattr(import_module(f"benchmarks.using_{library}"), function)
            inspect.signature(found).bind(*entry.arguments)


def test_orbits_of_peers_are_those_of_celnav():
    z = problems.measurements(problems.problem("orbit"), 3, 5)
    assert z.shape == (5, 3, 3)
    numpy = run("orbit", 3, 5, "numpy")()
    assert measure.apart(compiled("orbit", 3, 5)(), numpy) < 1e-12
    x = problems.problem("orbit").mean
    from celnav.models import orbit

    np.testing.assert_allclose(problems.orbit_step(np)(x), orbit.step(x, 1.0), rtol=1e-14)


def row(problem, method, values, checkout="here"):
    about = {"problem": problem, "method": method, "checkout": checkout}
    return about | {"values": values, "apart": None, "absent": ""}


def test_a_line_through_times_of_runs_is_fixed_cost_and_slope():
    rows = [row(f"n = 2, {T} epochs", "celnav", [50.0 + 0.7 * T]) for T in (3, 30, 300)]
    text = report.fixed_table({"cells": {"fixed": {"rows": rows}}})
    assert text.splitlines()[-1] == "| n = 2, celnav | 52.1 | 71.0 | 260 | 50.0 | 0.70 |"


def test_ratios_are_taken_within_rounds():
    rows = [row("p", "m", [1.0, 2.0, 4.0]), row("p", "m", [2.0, 4.0, 9.0], "beside")]
    result = {"cells": {"c": {"rows": rows, "unit": "s"}}}
    assert report.beside_table(result).splitlines()[-1] == "| c, p, m | s | 2.0 | 4.0 | 2.00 |"
