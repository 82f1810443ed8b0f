"""A user's study: a file with the same names as a paper's module (see `celnav.papers`), in any
folder.

``celnav new study.py`` writes one. The file needs ``TITLE`` and ``STUDY``; for missions it also
needs ``PRESETS`` and ``filters``. Everything else is optional. Its module is called
``celnav.papers.own.<path>_<hash>``, in hexadecimal digits. By this name other processes find the
file for a part of the study, and refuse it if it has changed since. Modules that it imports may lie
in the same folder.
"""

from __future__ import annotations

import ast
import re
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from hashlib import sha256
from importlib import import_module
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from types import ModuleType
from typing import Any

from celnav.files import InputError
from celnav.gaussian.checks import accepts, describe
from celnav.papers import is_file
from celnav.study.ledger import Row
from celnav.study.parameters import Timed
from celnav.study.study import Part, Study
from celnav.study.trial import Group

__path__: list[str] = []  # a package, whose modules `_Finder` finds


def name_of(paper: str) -> str:
    """Name of a study in folders and pages: for a file, its name without the extension."""
    return re.sub(r"[^\w.-]+", "-", Path(paper).stem) if is_file(paper) else paper


def identity(paper: str) -> str:
    """What identifies a study's results: for a file its name and contents, not its folder."""
    return f"{Path(paper).name}, {source(Path(paper))}" if is_file(paper) else paper


def load(paper: str | Path, *, mission: bool = False) -> ModuleType:
    """The checked module of a file. One error lists everything that is missing or has a wrong type.

    ``mission``: whether it is loaded for missions or lists of parameters.

    Raises
    ------
    InputError: naming the file and the line of an error in its code; or everything that is missing
        or wrong, with what was expected and what came.
    OSError: if the file cannot be read.
    """
    path = Path(paper).resolve()
    try:
        module = import_module(f"{__name__}.{str(path).encode().hex()}_{source(path)}")
    except Exception as error:
        if isinstance(error, OSError) and error.filename == str(path):
            raise
        raise InputError(
            explain_error(error, path) or f"{paper}: {type(error).__name__}: {error}"
        ) from None
    if wrong := list(_wrong(module, mission)):
        count = "1 thing is" if len(wrong) == 1 else f"{len(wrong)} things are"
        cure = "celnav new FILE.py writes a study that has all"
        listed = "".join(f"\n  {line}" for line in wrong)
        raise InputError(f"{paper}: {count} missing or not as expected ({cure}):{listed}")
    values = vars(module)
    study: Study = values["STUDY"]
    if not study.source:
        name = name_of(str(path))
        values["STUDY"] = study = replace(study, name=name, source=source(path))
    usual = {
        "CITATION": "",
        "FIGURES": {},
        "TABLES": {},
        "RECORDINGS": [],
        "record": _nothing,
        "trial": study.trial,
        "JUDGED": {group.name: group.unit for group in study.groups},
    }
    for name, value in usual.items():
        values.setdefault(name, value)
    return module


def _nothing(results: Any, outputs: Any) -> list[str]:  # noqa: ARG001
    """Write no recordings."""
    return []


# -- files and their modules ---------------------------------------------------------------------
def source(path: Path) -> str:
    """Hash of a file and of the modules in its folder that it imports, without comments and
    layout."""
    beside = tuple(
        sorted(
            (p.name, p.stat().st_mtime_ns, p.stat().st_size)
            for p in path.resolve().parent.glob("*.py")
        )
    )
    return _source(path.resolve(), beside)


@cache
def _source(path: Path, _beside: Any) -> str:
    digest, files = sha256(), [path]
    for file in files:  # the list grows in the loop
        tree = ast.parse(file.read_bytes(), str(file))
        digest.update(f"{file.name} {ast.dump(tree)} ".encode())
        imported: list[str] = []
        for node in ast.walk(tree):
            imported += [a.name for a in node.names] if isinstance(node, ast.Import) else []
            imported += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        for name in imported:
            other = path.parent / f"{name.partition('.')[0]}.py"
            if other not in files and other.is_file():
                files.append(other)
    return digest.hexdigest()[:16]


class _Loader(SourceFileLoader):
    """Uses no bytecode cache, which would miss a second change within one second."""

    def path_stats(self, path: str) -> Any:  # noqa: ARG002
        raise OSError


class _Finder:
    @staticmethod
    def find_spec(name: str, _path: Any = None, _target: Any = None) -> ModuleSpec | None:
        package, _, digits = name.rpartition(".")
        if package != __name__ or not re.fullmatch("[0-9a-f]+_[0-9a-f]{16}", digits):
            return None
        code, _, expected = digits.partition("_")
        path = Path(bytes.fromhex(code).decode())
        if source(path) != expected:
            raise ImportError(
                f"{path}: changed while the work was running; run the same command again"
            )
        if str(path.parent) not in sys.path:
            sys.path.append(str(path.parent))
        return spec_from_file_location(name, path, loader=_Loader(name, str(path)))


sys.meta_path.append(_Finder)


def place(error: BaseException, *paths: Path) -> tuple[str, int, str] | None:
    """Place of an error in a user's file or in a file of the same folder: file name, line number
    and the line's text. None if the error occurred elsewhere.

    paths: of files that are not loaded as modules yet.
    """
    if isinstance(error, SyntaxError) and paths and error.filename:
        return Path(error.filename).name, error.lineno or 0, (error.text or "").strip()
    modules = [m for name, m in list(sys.modules.items()) if name.startswith(f"{__name__}.")]
    folders = {path.parent for path in (*(Path(m.__file__ or "") for m in modules), *paths)}
    frames = traceback.extract_tb(error.__traceback__)
    inside = [frame for frame in frames if Path(frame.filename).parent in folders]
    if not inside:
        return None
    return Path(inside[-1].filename).name, inside[-1].lineno or 0, inside[-1].line or ""


def explain_error(error: BaseException, *paths: Path) -> str:
    """The message of an error with its `place`; empty if it has none."""
    location = place(error, *paths)
    if location is None:
        return ""
    file, line, text = location
    message = error.msg if isinstance(error, SyntaxError) else str(error)
    return f"{file}, line {line}: {type(error).__name__}: {message}\n    {text}"


# -- what a study must contain -------------------------------------------------------------------
FILE = re.compile(r"[\w.-]+")
DRAWN = '{"figure_01": ("What it shows.", function of the results)}, names of files'
Check = Callable[[Any], bool]


def _is_drawn(value: Any) -> bool:
    """Whether a value has captions and functions of the results, by names of files."""
    return isinstance(value, dict) and all(
        isinstance(stem, str)
        and FILE.fullmatch(stem)
        and isinstance(pair, tuple)
        and [isinstance(part, str) for part in pair] == [True, False]
        and _takes(1)(pair[1])
        for stem, pair in value.items()
    )


def _are_recordings(value: Any) -> bool:
    return isinstance(value, list | tuple) and all(
        isinstance(name, str) and FILE.fullmatch(name) and name.endswith(".rrd") for name in value
    )


def _are_presets(value: Any) -> bool:
    return (isinstance(value, dict) and bool(value)) and all(
        isinstance(name, str)
        and isinstance(config, Timed)
        and hasattr(config, "__dataclass_fields__")
        and isinstance(getattr(config, "runs", None), int)
        for name, config in value.items()
    )


def _takes(count: int) -> Check:
    """A check that a value can be called with ``count`` arguments."""
    return lambda value: callable(value) and accepts(value, count)


def _is(*types: type) -> Check:
    return lambda value: isinstance(value, types)


EXPECTED: dict[str, tuple[Check, str, str]] = {
    "TITLE": (
        lambda value: isinstance(value, str) and bool(value.strip()),
        "a text, what the study is about",
        "always",
    ),
    "STUDY": (
        _is(Study),
        "a celnav.study.Study(name, groups, trial, parts, rows)",
        "always",
    ),
    "PRESETS": (
        _are_presets,
        '{"usual": Config()}, of a dataclass on celnav.study.Timed with a whole number of runs',
        "mission",
    ),
    "filters": (_takes(1), "a function (config) that gives filters by name", "mission"),
    "trial": (
        _takes(2),
        "a function (config, rngs) that gives a celnav.study.Trial",
        "",
    ),
    "FIGURES": (_is_drawn, DRAWN, ""),
    "TABLES": (_is_drawn, DRAWN.replace("figure", "table"), ""),
    "RECORDINGS": (_are_recordings, '["first.rrd"], names of what record writes', ""),
    "record": (_takes(2), "a function (results, outputs)", "RECORDINGS"),
    "CITATION": (_is(str), "a text, a BibTeX entry", ""),
    "MISSION": (_is(dict), "parameters by name", ""),
    "INPUTS": (
        lambda value: not value,
        "none: a user's study reads its files itself",
        "",
    ),
}
"""By name: check of the value, description of what is expected, and what requires the name."""


def _wrong(module: ModuleType, mission: bool) -> Iterator[str]:
    """Names that are missing or have a wrong value, one line each."""
    values = vars(module)
    needed = {"always"}
    needed |= {"mission"} if mission else set()
    needed |= {"RECORDINGS"} if values.get("RECORDINGS") else set()
    for name, (is_right, expected, by) in EXPECTED.items():
        if name not in values and by in needed:
            yield f"{name}: expected {expected}, got none"
        elif name in values and not is_right(values[name]):
            yield f"{name}: expected {expected}, got {_shown(values[name])}"
    if isinstance(study := values.get("STUDY"), Study):
        figures = values.get("FIGURES")
        listed = _wrong_study(study, figures if isinstance(figures, dict) else {}, mission)
        yield from (f"STUDY.{line}" for line in listed)


def _shown(value: Any) -> str:
    return f"{value!r:.60}" if isinstance(value, str | dict | list | tuple) else describe(value)


def _wrong_study(study: Study, figures: Mapping[str, Any], mission: bool) -> Iterator[str]:
    if not _all(study.groups, Group) or not all(isinstance(g.part, slice) for g in study.groups):
        example = '(celnav.Group("position", "m", slice(0, 2)), ...)'
        yield f"groups: expected {example}, got {study.groups!r:.60}"
    if (mission or study.trial is not None) and not _takes(2)(study.trial):
        yield f"trial: expected a function (config, rngs), got {describe(study.trial)}"
    parts: Mapping[str, Any] = {}
    try:
        parts = study.parts(1.0)
    except Exception as error:  # a user's function may raise anything
        got = explain_error(error) or f"{type(error).__name__}: {error}"
        yield f"parts: expected a function (effort) that gives parts, got an error: {got}"
    else:
        if not isinstance(parts, Mapping) or not parts or not _all([*parts.values()], Part):
            example = '{"usual": celnav.study.Part(work, config, runs=100)}'
            yield f"parts: expected {example}, got {parts!r:.60}"
            parts = {}
    for name, part in parts.items():
        yield from (f"parts {name!r}: {line}" for line in _wrong_part(part))
    drawn = f"FIGURES ({', '.join(figures) or 'none'})"
    if study.figure and study.figure not in figures:
        yield f"figure: expected one of {drawn}, got {study.figure!r}"
    if not _all(study.rows, Row):
        example = "rows, such as celnav.study.statement(id, says, decide)"
        yield f"rows: expected {example}, got {study.rows!r:.60}"
        return
    ids = Counter(row.id for row in study.rows)
    for id, count in ids.items():
        if count > 1:
            yield f"rows: expected different ids, got {id!r} {count} times"
    for row in study.rows:
        where, got = f"rows {row.id!r}", describe(row.decide)
        if row.decide is not None and not _takes(1)(row.decide):
            yield f"{where}: expected a function of the results that decides it, got {got}"
        if row.figure and row.figure not in figures:
            yield f"{where}: expected a figure of {drawn}, got {row.figure!r}"
        if row.needs and parts and row.needs not in parts:
            listed = f"one of the parts ({', '.join(parts)})"
            yield f"{where}: expected needs to be {listed}, got {row.needs!r}"


def _wrong_part(part: Part) -> Iterator[str]:
    if not _takes(2)(part.work):
        got = describe(part.work)
        yield f"expected a function work (config, rngs) that gives arrays by name, got {got}"
        return
    try:
        ForkingPickler.dumps(part)
    except Exception as error:
        expected = "functions of the file itself, which can be sent to other processes"
        yield f"expected {expected}, got {error}"


def _all(values: Any, of: type) -> bool:
    """Whether a value is a sequence of objects of one type."""
    several = isinstance(values, Sequence) and not isinstance(values, str)
    return several and all(isinstance(value, of) for value in values)
