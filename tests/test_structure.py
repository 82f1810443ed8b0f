"""The order of imports: lower rooms know nothing of higher ones, filters nothing of models."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import celnav
from celnav.papers import citation

ROOT = Path(celnav.__file__).parent
ROOMS = [
    {"lazy"},
    {"files"},
    {"store", "tape"},
    {"gaussian"},
    {"filters"},
    {"models"},
    {"analysis"},
    {"study"},
    {"show"},
    {"receiver"},
    {"papers"},
    {"real"},
    {"campaign"},
    {"commands"},
    {"cli"},
]
LEVEL = {room: level for level, rooms in enumerate(ROOMS) for room in rooms}
UPWARD = {("track", name) for name in ("celnav.show.report", "celnav.show.report.report", "celnav.show.report.Report")}
"""A track is asked for its report, which is made, and imported, at the call."""
MODULES = sorted(p for p in ROOT.rglob("*.py") if p.name not in ("__main__.py",) and p != ROOT / "__init__.py")


def imports(path):
    """Names of the modules that a file imports, wherever it does so."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{name.name}" for name in node.names)
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)


def room(name):
    return name.split(".")[1]


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_room_imports_lower_ones_only(path):
    own = path.relative_to(ROOT).with_suffix("").parts[0]
    assert own in LEVEL, f"{own} has no place in the order of rooms"
    for name in imports(path):
        if name.startswith("celnav.") and room(name) in LEVEL and room(name) != own:
            upward = (path.stem, name) in UPWARD
            assert LEVEL[room(name)] < LEVEL[own] or upward, f"{own} imports {name}"


def test_only_what_records_and_shows_imports_rerun():
    found = {p for p in ROOT.rglob("*.py") if any(name.split(".")[0] == "rerun" for name in imports(p))}
    assert found == {ROOT / "show" / f"{name}.py" for name in ("recording", "views", "picture")}


def lines(path):
    return len(path.read_text(encoding="utf-8").splitlines())


def test_the_house_keeps_its_size():
    """The core can be read in a day, a module in one sitting; the root is a door, and there are few rooms."""
    core = {p: lines(p) for room in ("gaussian", "filters", "models", "analysis", "study") for p in (ROOT / room).glob("*.py")}
    engine = {p: core.pop(p) for p in list(core) if p.stem in ("engine", "flight", "compiled", "export", "recorded", "gradient")}
    engine |= {p: lines(p) for p in (ROOT / "tape").glob("*.py")}
    assert sum(core.values()) <= 10300, sum(core.values())
    assert sum(engine.values()) <= 3360, sum(engine.values())
    assert len(list(ROOT.glob("*.py"))) <= 6
    assert len({p.relative_to(ROOT).parts[0] for p in MODULES}) <= 16
    long = {str(p.relative_to(ROOT)): lines(p) for p in MODULES if lines(p) > 450 and p.relative_to(ROOT).parts[0] != "papers"}
    assert not long, long


@pytest.mark.parametrize(
    ("paper", "most"), [("csrukf", 1239), ("ssukf", 1163), ("tstdkf", 1585), ("aasghqf", 1119), ("aukf", 1229)]
)
def test_a_paper_is_data_in_few_files(paper, most):
    """A door, a scenario, a study, and what is shown; a method only where the filter is too particular for the library."""
    files = sorted((ROOT / "papers" / paper).glob("*.py"))
    assert {p.stem for p in files} - {"method"} == {"__init__", "scenario", "show", "study"}
    assert sum(map(lines, files)) <= most


def test_every_source_that_is_cited_is_in_the_bibliography():
    text = "".join(p.read_text(encoding="utf-8") for p in sorted(ROOT.rglob("*.py")))
    places = re.findall(r"\[([A-Z][A-Za-z]+\d{4}\b[^\]]*)\]", text)
    cited = {key for place in places for key in re.findall(r"\b[A-Z][A-Za-z]+\d{4}\b", place)}
    assert len(cited) > 9
    for key in sorted(cited):
        assert citation(key).startswith("@"), key
    with pytest.raises(ValueError, match=r"key: expected one of Sun2015, .*, got 'Moon2015'"):
        citation("Moon2015")
