"""The order of imports: lower packages do not import higher ones, and filters
do not import models.
"""

from __future__ import annotations

import ast
import re
import tokenize
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import celnav
from celnav.papers import citation

ROOT = Path(celnav.__file__).parent
ROOMS = [
    {"lazy"},
    {"files"},
    {"tape"},
    {"gaussian"},
    {"filters"},
    {"engine"},
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
UPWARD = {
    ("track", f"celnav.show.{name}")
    for name in ("report", "report.report", "report.Report", "history", "history.figure")
}
"""`Track` imports its report and its plot at the call."""
UPWARD |= {("run", name) for name in ("celnav.engine.compiled", "celnav.engine.compiled.run_by")}
"""``run`` chooses an engine, and imports modules for machine code only at the call."""
MODULES = sorted(
    p for p in ROOT.rglob("*.py") if p.name not in ("__main__.py",) and p != ROOT / "__init__.py"
)


@cache
def nodes(path):
    """All nodes of a file's syntax tree."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def imports(path):
    """Names of all modules that a file imports, on any line."""
    for node in nodes(path):
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
    found = {
        p for p in ROOT.rglob("*.py") if any(name.split(".")[0] == "rerun" for name in imports(p))
    }
    names = ("recording", "views", "window", "reading", "streaming")
    assert found == {ROOT / "show" / f"{name}.py" for name in names}


def named(path):
    """The module name of a file."""
    return ".".join(["celnav", *path.relative_to(ROOT).with_suffix("").parts]).removesuffix(
        ".__init__"
    )


FILES = {named(path): path for path in [*MODULES, ROOT / "__init__.py"]}


def kind(name):
    """Constants first, then classes, then functions: the order that ruff sorts by."""
    return (not (len(name) > 1 and name.isupper()), not name[0].isupper(), name)


@pytest.mark.parametrize("module", FILES)
def test_a_module_names_what_is_public(module):
    """Without ``__all__`` an underscore marks private names; modules in the reference have
    ``__all__``.
    """
    found = import_module(module)
    names = vars(found).get("__all__", [])
    assert names == sorted(set(names), key=kind)
    assert [name for name in names if name.startswith("_") or not hasattr(found, name)] == []


def taken(path):
    """Names that a file uses from other modules of celnav, imported or as attributes of a module:
    ``(module, name)``.
    """
    modules = {}
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and node.module in FILES:
            for name in node.names:
                if f"{node.module}.{name.name}" in FILES:
                    modules[name.asname or name.name] = f"{node.module}.{name.name}"
                else:
                    yield node.module, name.name
    for node in nodes(path):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id in modules
        ):
            yield modules[node.value.id], node.attr


def test_nothing_private_is_imported_from_a_module():
    found = {
        (module, name)
        for path in FILES.values()
        for module, name in taken(path)
        if not name.startswith("__")
    }
    assert len(found) > 500
    assert {(module, name) for module, name in found if name.startswith("_")} == set()


LAYOUT = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
)


def tokens(path):
    """How many tokens of code a file has: comments, docstrings and layout cost nothing."""
    docstrings = {
        node.body[0].lineno
        for node in nodes(path)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node)
    }
    with path.open("rb") as file:
        return sum(
            token.type not in (*LAYOUT, tokenize.ENCODING)
            and not (token.type == tokenize.STRING and token.start[0] in docstrings)
            for token in with_whole_f_strings(tokenize.tokenize(file.readline))
        )


def with_whole_f_strings(stream):
    """Tokens as Python 3.11 has them: since 3.12 an f-string is many, of which its end is left."""
    depth = 0
    for token in stream:
        name = tokenize.tok_name[token.type]
        depth += (name == "FSTRING_START") - (name == "FSTRING_END")
        if depth == 0:
            yield token


LIBRARY = ("gaussian", "filters", "engine", "tape", "models", "analysis")
PAPERS = ("csrukf", "ssukf", "tstdkf", "aasghqf", "aukf", "mars")
LIMITS = {
    **dict.fromkeys((f"papers.{paper}" for paper in PAPERS), 15_000),
    "library": 108_000,
    "real": 34_000,
    "receiver": 24_000,
    "everything else": 52_000,
}
LARGER = {"library", "everything else", "papers.tstdkf", "receiver"}
"""Files above their limit; a file that is below its limit again must leave this set."""


def place(path):
    """The group with which a file is counted."""
    names = named(path).split(".")[1:3]
    if names[:1] == ["papers"] and names[-1] in PAPERS:
        return ".".join(names)
    own = names[0] if names else ""
    return "library" if own in LIBRARY else own if own in LIMITS else "everything else"


@pytest.mark.parametrize("limited", LIMITS)
def test_the_house_keeps_its_size(limited):
    size = sum(tokens(path) for path in FILES.values() if place(path) == limited)
    assert (size > LIMITS[limited]) == (limited in LARGER), size


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_records_do_not_change(path):
    """Every dataclass is frozen: changes create a new record."""
    for node in nodes(path):
        if isinstance(node, ast.ClassDef):
            for decorator in map(ast.unparse, node.decorator_list):
                assert not decorator.startswith("dataclass") or "frozen=True" in decorator, (
                    node.name
                )


@pytest.mark.parametrize("module", FILES)
def test_a_record_of_arrays_equals_itself_only(module):
    """Comparing values with ``==`` would need the truth value of an array, and ``hash`` the hash of
    an array.
    """
    for name, found in vars(import_module(module)).items():
        if is_dataclass(found) and isinstance(found, type) and found.__dataclass_params__.eq:
            assert not [
                f.name for f in fields(found) if re.search(r"\b(Array|ndarray)\b", str(f.type))
            ], name


def test_rooms_are_few():
    """The package root contains only the entry points."""
    assert len(list(ROOT.glob("*.py"))) <= 6
    assert len({p.relative_to(ROOT).parts[0] for p in MODULES}) <= 16


@pytest.mark.parametrize("paper", PAPERS)
def test_a_paper_is_data_in_few_files(paper):
    """Entry point, scenario, study and show; and a method if the filter is special."""
    files = (ROOT / "papers" / paper).glob("*.py")
    assert {p.stem for p in files} - {"method"} == {"__init__", "scenario", "show", "study"}


def test_code_and_prose_are_formatted_in_lines_of_at_most_100_characters():
    """Formatted by ruff, everywhere; the prose of the ledgers too."""
    for path in (*ROOT.rglob("*.py"), *ROOT.rglob("ledger.toml")):
        text = path.read_text(encoding="utf-8")
        assert "fmt: skip" not in text, path
        assert max(map(len, text.splitlines()), default=0) <= 100, path


def test_every_source_that_is_cited_is_in_the_bibliography():
    text = "".join(p.read_text(encoding="utf-8") for p in sorted(ROOT.rglob("*.py")))
    places = re.findall(r"\[([A-Z][A-Za-z]+\d{4}\b[^\]]*)\]", text)
    cited = {key for place in places for key in re.findall(r"\b[A-Z][A-Za-z]+\d{4}\b", place)}
    assert len(cited) > 9
    for key in sorted(cited):
        assert citation(key).startswith("@"), key
    with pytest.raises(ValueError, match=r"key: expected one of Sun2015, .*, got 'Moon2015'"):
        citation("Moon2015")
