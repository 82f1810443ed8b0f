"""A study of one's own: a file of the shape of a paper's module (see `celnav.papers`), wherever it lies.

``celnav new study.py`` writes one. It needs ``TITLE`` and ``STUDY``, and to be flown by missions ``PRESETS`` and ``filters``; the
rest may be left out. Its module is called ``celnav.papers.own.<path>_<hash>``, in hexadecimal digits, so that other processes which
are given a part of it find the file, and refuse it if it has changed since. What it imports may lie beside it.
"""

from __future__ import annotations

import ast
import re
import sys
import traceback
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
from celnav.gaussian.checks import kind, takes
from celnav.papers import is_file
from celnav.study.ledger import Row
from celnav.study.parameters import Timed
from celnav.study.study import Part, Study
from celnav.study.trial import Group

__all__ = ["identity", "load", "name_of", "place", "told"]

__path__: list[str] = []  # a package, whose modules `_Finder` finds


def name_of(paper: str) -> str:
    """What folders and pages call it: the file's name without its end."""
    return re.sub(r"[^\w.-]+", "-", Path(paper).stem) if is_file(paper) else paper


def identity(paper: str) -> str:
    """What determines its results: of a file its contents, not its place."""
    return f"{Path(paper).name}, {source(Path(paper))}" if is_file(paper) else paper


def load(paper: str | Path, *, mission: bool = False) -> ModuleType:
    """The module of a file, checked: all that is missing or of another kind is told at once.

    ``mission``: whether missions and lists of parameters are to be made of it.

    Raises
    ------
    InputError: naming the file, and the line of what cannot be run; or everything that is missing, what was expected and what came.
    OSError: if it cannot be read.
    """
    path = Path(paper).resolve()
    try:
        module = import_module(f"{__name__}.{str(path).encode().hex()}_{source(path)}")
    except Exception as error:
        if isinstance(error, OSError) and error.filename == str(path):
            raise
        raise InputError(told(error, path) or f"{paper}: {type(error).__name__}: {error}") from None
    wrong = list(_wrong(module, mission))
    if wrong:
        count = "1 thing is" if len(wrong) == 1 else f"{len(wrong)} things are"
        listed = "".join(f"\n  {line}" for line in wrong)
        raise InputError(
            f"{paper}: {count} missing or not as expected (celnav new FILE.py writes a study that has all):{listed}"
        )
    if not module.STUDY.source:
        module.STUDY = replace(module.STUDY, name=name_of(str(path)), source=source(path))  # type: ignore[attr-defined]
    usual = {
        "CITATION": "",
        "FIGURES": {},
        "TABLES": {},
        "RECORDINGS": [],
        "record": _nothing,
        "trial": module.STUDY.trial,
    }
    for name, value in (
        usual | {"JUDGED": {group.name: group.unit for group in module.STUDY.groups}}
    ).items():
        vars(module).setdefault(name, value)
    return module


def _nothing(results: Any, outputs: Any) -> list[str]:  # noqa: ARG001
    """No recordings."""
    return []


# -- files and their modules -------------------------------------------------------------------------------------------------
def source(path: Path) -> str:
    """Hash of a file and of the modules beside it that it imports: of what they say, without comments and layout."""
    beside = tuple(
        sorted(
            (p.name, p.stat().st_mtime_ns, p.stat().st_size)
            for p in path.resolve().parent.glob("*.py")
        )
    )
    return _source(path.resolve(), beside)


@cache
def _source(path: Path, _beside: Any) -> str:
    digest, todo, seen = sha256(), [path], {path}
    for file in todo:
        tree = ast.parse(file.read_bytes(), str(file))
        digest.update(f"{file.name} {ast.dump(tree)} ".encode())
        found: list[str] = []
        for node in ast.walk(tree):
            found += [a.name for a in node.names] if isinstance(node, ast.Import) else []
            found += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        for name in found:
            other = path.parent / f"{name.partition('.')[0]}.py"
            if other not in seen and other.is_file():
                seen.add(other)
                todo.append(other)
    return digest.hexdigest()[:16]


class _Loader(SourceFileLoader):
    """Takes no bytecode, which goes by the second of the last change."""

    def path_stats(self, path: str) -> Any:  # noqa: ARG002
        raise OSError


class _Finder:
    @staticmethod
    def find_spec(name: str, _path: Any = None, _target: Any = None) -> ModuleSpec | None:
        package, _, own = name.rpartition(".")
        if package != __name__ or not re.fullmatch("[0-9a-f]+_[0-9a-f]{16}", own):
            return None
        code, _, expected = own.partition("_")
        path = Path(bytes.fromhex(code).decode())
        if source(path) != expected:
            raise ImportError(
                f"{path}: has changed since the work was begun; use the same command again"
            )
        if str(path.parent) not in sys.path:
            sys.path.append(str(path.parent))
        return spec_from_file_location(name, path, loader=_Loader(name, str(path)))


sys.meta_path.append(_Finder)


def place(error: BaseException, *paths: Path) -> tuple[str, int, str] | None:
    """Where in a file of one's own, or in one beside it, an error came about: file, line and what it says; None if in none.

    paths: of files that are no modules yet.
    """
    loaded = (
        Path(m.__file__ or "")
        for name, m in list(sys.modules.items())
        if name.startswith(f"{__name__}.")
    )
    folders = {path.parent for path in (*loaded, *paths)}
    frames = [
        f for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).parent in folders
    ]
    return (
        (Path(frames[-1].filename).name, frames[-1].lineno or 0, frames[-1].line or "")
        if frames
        else None
    )


def told(error: BaseException, *paths: Path) -> str:
    """An error with its line in a file of one's own, ``paths`` if they are no modules yet; empty if it has none there."""
    if isinstance(error, SyntaxError) and paths and error.filename:
        found: Any = Path(error.filename).name, error.lineno, (error.text or "").strip()
    elif (found := place(error, *paths)) is None:
        return ""
    file, line, text = found
    said = error.msg if isinstance(error, SyntaxError) else str(error)
    return f"{file}, line {line}: {type(error).__name__}: {said}\n    {text}"


# -- what is expected of one -------------------------------------------------------------------------------------------------
_Check = Callable[[Any], bool]
_FILE = re.compile(r"[\w.-]+")


def _drawn(value: Any) -> bool:
    pairs = value.values() if isinstance(value, dict) else [()]
    named = isinstance(value, dict) and all(
        isinstance(stem, str) and _FILE.fullmatch(stem) for stem in value
    )
    return named and all(
        isinstance(p, tuple)
        and len(p) == 2
        and isinstance(p[0], str)
        and callable(p[1])
        and takes(p[1], 1)
        for p in pairs
    )


def _is_preset(c: Any) -> bool:
    return (
        isinstance(c, Timed)
        and hasattr(c, "__dataclass_fields__")
        and isinstance(getattr(c, "runs", None), int)
    )


_DRAWN = '{"figure_01": ("What it shows.", function of the results)}, names of files'
EXPECTED: dict[str, tuple[_Check, str, str]] = {
    "TITLE": (lambda v: isinstance(v, str) and bool(v.strip()), "a text, what the study is about", "always"),
    "STUDY": (lambda v: isinstance(v, Study), "a celnav.study.study.Study(name, groups, trial, parts, rows)", "always"),
    "PRESETS": (
        lambda v: isinstance(v, dict) and bool(v) and all(isinstance(k, str) and _is_preset(c) for k, c in v.items()),
        '{"usual": Config()}, of a dataclass on celnav.study.parameters.Timed with a whole number of runs', "mission",
    ),
    "filters": (lambda v: callable(v) and takes(v, 1), "a function (config) that gives filters by name", "mission"),
    "trial": (lambda v: callable(v) and takes(v, 2), "a function (config, rngs) that gives a celnav.study.trial.Trial", ""),
    "FIGURES": (_drawn, _DRAWN, ""),
    "TABLES": (_drawn, _DRAWN.replace("figure", "table"), ""),
    "RECORDINGS": (
        lambda v: isinstance(v, list | tuple) and all(isinstance(n, str) and _FILE.fullmatch(n) and n.endswith(".rrd") for n in v),
        '["first.rrd"], names of what record writes', "",
    ),
    "record": (lambda v: callable(v) and takes(v, 2), "a function (results, outputs)", "RECORDINGS"),
    "CITATION": (lambda v: isinstance(v, str), "a text, a BibTeX entry", ""),
    "MISSION": (lambda v: isinstance(v, dict), "parameters by name", ""),
    "INPUTS": (lambda v: not v, "none: a study of one's own reads its files itself", ""),
}  # fmt: skip
"""Name -> whether a value is right, what is expected, and what needs it."""


def _wrong(module: ModuleType, mission: bool) -> Iterator[str]:
    """What is missing or of another kind, a line each."""
    needed = {
        "always": True,
        "mission": mission,
        "RECORDINGS": bool(getattr(module, "RECORDINGS", ())),
        "": False,
    }
    for name, (right, expected, by) in EXPECTED.items():
        if name not in vars(module):
            if needed[by]:
                yield f"{name}: expected {expected}, got none"
        elif not right(value := getattr(module, name)):
            got = f"{value!r:.60}" if isinstance(value, str | dict | list | tuple) else kind(value)
            yield f"{name}: expected {expected}, got {got}"
    study = getattr(module, "STUDY", None)
    if isinstance(study, Study):
        figures = getattr(module, "FIGURES", {})
        yield from _wrong_study(study, figures if isinstance(figures, dict) else {}, mission)


def _wrong_study(study: Study, figures: Mapping[str, Any], mission: bool) -> Iterator[str]:
    if not _all(study.groups, Group) or not all(isinstance(g.part, slice) for g in study.groups):
        yield (
            'STUDY.groups: expected (celnav.Group("position", "m", slice(0, 2)), ...)'
            + f", got {study.groups!r:.60}"
        )
    if not (study.trial is None and not mission) and not (
        callable(study.trial) and takes(study.trial, 2)
    ):
        yield f"STUDY.trial: expected a function (config, rngs), got {kind(study.trial)}"
    parts: Mapping[str, Any] = {}
    try:
        parts = study.parts(1.0)
    except Exception as error:  # whatever a person's function does
        yield "STUDY.parts: expected a function (effort) that gives parts, got an error: " + (
            told(error) or f"{type(error).__name__}: {error}"
        )
    else:
        if (
            not isinstance(parts, Mapping)
            or not parts
            or not all(isinstance(part, Part) for part in parts.values())
        ):
            yield f'STUDY.parts: expected {{"usual": celnav.study.study.Part(work, config, runs=100)}} of them, got {parts!r:.60}'
            parts = {}
    for name, part in parts.items():
        if not (callable(part.work) and takes(part.work, 2)):
            yield f"STUDY.parts {name!r}: expected a work (config, rngs) that gives arrays by name, got {kind(part.work)}"
            continue
        try:
            ForkingPickler.dumps(part)
        except Exception as error:
            yield f"STUDY.parts {name!r}: expected what other processes can be given, functions of the file itself, got {error}"
    if study.figure and study.figure not in figures:
        yield f"STUDY.figure: expected one of FIGURES ({', '.join(figures) or 'none'}), got {study.figure!r}"
    if not _all(study.rows, Row):
        yield f"STUDY.rows: expected rows of celnav.study.ledger, such as statement(id, says, decide), got {study.rows!r:.60}"
        return
    ids = [row.id for row in study.rows]
    for row in study.rows:
        if ids.count(row.id) > 1 and row is study.rows[ids.index(row.id)]:
            yield f"STUDY.rows: expected different ids, got {row.id!r} {ids.count(row.id)} times"
        if row.decide is not None and not (callable(row.decide) and takes(row.decide, 1)):
            yield f"STUDY.rows {row.id!r}: expected a function of the results that decides it, got {kind(row.decide)}"
        if row.figure and row.figure not in figures:
            yield f"STUDY.rows {row.id!r}: expected a figure of FIGURES ({', '.join(figures) or 'none'}), got {row.figure!r}"
        if row.needs and parts and row.needs not in parts:
            yield f"STUDY.rows {row.id!r}: expected it to need one of the parts ({', '.join(parts)}), got {row.needs!r}"


def _all(values: Any, of: type) -> bool:
    return (
        isinstance(values, Sequence)
        and not isinstance(values, str)
        and all(isinstance(value, of) for value in values)
    )
