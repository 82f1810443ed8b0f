"""The papers: one module each, all with the same names.

``CITATION``, ``TITLE``, ``Config``, ``PRESETS``, ``simulate``, ``filters``: the scenario. ``trial`` and ``JUDGED``, what it judges
and in which units: see `celnav.study.trial`. ``STUDY``: what is flown and said, see `celnav.study.study`. ``FIGURES``, ``TABLES``:
file stem -> caption and function of the results; ``RECORDINGS`` and ``record``. ``INPUTS``, if there: names of optional folders
that the study takes. ``MISSION``, if there: parameters that a mission has by default, whatever the preset.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from importlib import import_module
from types import ModuleType

from celnav.files import data
from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)

__all__ = ["PAPERS", "citation", "load"]

PAPERS = {
    name: f"celnav.papers.{name}" for name in ("csrukf", "ssukf", "tstdkf", "aasghqf", "aukf")
}
"""Identifier -> module."""


def load(paper: str, others: Iterable[str] = ()) -> ModuleType:
    """The module of a paper, or of a study of one's own, a file (`celnav.papers.own`); ``others``: identifiers known where it is
    asked for.

    Raises
    ------
    ValueError: for an unknown identifier; the message lists the known ones; or for a file, see `celnav.papers.own.load`.
    """
    if paper not in PAPERS:
        if paper.endswith(".py"):
            own: ModuleType = import_module("celnav.papers.own").load(paper)
            return own
        known = [*PAPERS, *others, "a file FILE.py"]
        close = difflib.get_close_matches(paper, known, 1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise ValueError(f"unknown paper {paper!r}: expected one of {', '.join(known)}{hint}")
    return import_module(PAPERS[paper])


def citation(key: str) -> str:
    """The BibTeX entry of a source that docstrings cite, of all that are in ``data/references.bib``.

    >>> print(celnav.papers.citation("Sun2015"))

    Raises
    ------
    ValueError: for an unknown key; the message lists the known ones.
    """
    text = data("references.bib").read_text(encoding="utf-8")
    entries = {
        entry.partition("{")[2].partition(",")[0]: entry.strip()
        for entry in re.split(r"\n(?=@)", text)
    }
    if key not in entries:
        raise ValueError(f"key: expected one of {', '.join(entries)}, got {key!r}")
    return entries[key]
