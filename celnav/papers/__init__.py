"""The papers: one module each, all with the same names.

``CITATION``, ``TITLE``, ``Config``, ``PRESETS``, ``simulate``, ``filters``, ``reproduce``, ``figure_N``, ``table_N``, ``claims``,
``record``: see `celnav.papers.csrukf`. ``INPUTS``, if there: names of optional inputs of ``reproduce``, folders. ``trial`` and
``JUDGED``, what it judges and in which units: see `celnav.study.trial`. ``MISSION``, if there: parameters that a mission has by
default, whatever the preset.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)

PAPERS = {name: f"celnav.papers.{name}" for name in ("csrukf", "ssukf", "tstdkf", "aasghqf", "aukf")}
"""Identifier -> module."""


def load(paper: str) -> ModuleType:
    """The module of a paper.

    Raises
    ------
    ValueError: for an unknown identifier; the message lists the known ones.
    """
    if paper not in PAPERS:
        close = difflib.get_close_matches(paper, PAPERS, 1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise ValueError(f"unknown paper {paper!r}: expected one of {', '.join(PAPERS)}{hint}")
    return import_module(PAPERS[paper])


def figures(module: ModuleType) -> dict[str, Callable[[Any], Any]]:
    """File stem ("figure_01", "figure_02b") -> function, in order."""
    return _numbered(module, "figure", 2)


def tables(module: ModuleType) -> dict[str, Callable[[Any], Any]]:
    """File stem ("table_1") -> function, in order."""
    return _numbered(module, "table", 1)


def _numbered(module: ModuleType, kind: str, digits: int) -> dict[str, Callable[[Any], Any]]:
    found = []
    for name in dir(module):
        match = re.fullmatch(rf"{kind}_(\d+)([a-z]?)", name)
        if match:
            found.append((int(match[1]), match[2], name))
    return {f"{kind}_{number:0{digits}d}{letter}": getattr(module, name) for number, letter, name in sorted(found)}
