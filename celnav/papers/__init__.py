"""The papers: one module for each, all with the same names; the list of all studies, and functions
that load a study.

``CITATION``, ``TITLE``, ``Config``, ``PRESETS``, ``simulate``, ``filters``: the scenario.
``trial``, ``JUDGED``: the trial and its groups, see `celnav.study.trial`.
``STUDY``: parts, rows and findings, see `celnav.study.study`.
``FIGURES``, ``TABLES``: file stem -> caption and function of the results.
``RECORDINGS``, ``record``: names of recordings, and the function that writes them.
``INPUTS`` (optional): names of input folders, which are arguments of ``STUDY.parts`` and options of
``celnav reproduce``.
``MISSION`` (optional): default parameters of a mission for all presets.

Studies on real data (`celnav.real`) and a user's file (`celnav.papers.own`) have the same names.
"""

from __future__ import annotations

import re
from importlib import import_module
from types import ModuleType

from celnav.files import data, did_you_mean
from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)

PAPERS = {
    name: f"celnav.papers.{name}"
    for name in ("csrukf", "ssukf", "tstdkf", "aasghqf", "aukf", "mars")
}
"""Identifier -> module."""
REAL = {
    "grace": "GPS fixes and positions of GRACE-A, August 2008, and a gravity field",
    "nanograv": "pulsars' arrival times (daily_averages.npz)",
    "rxte": "photons of a pulsar, the satellite's orbit, a timing model (*.fits, FPorbit*, *.par)",
    "broad": "trials of BROAD (MATLAB files)",
    "ins": "a car's inertial unit and RTK fixes (imu*.csv, imu*.tag, gnss*.pos)",
}
"""Studies on real data: name of study, module and input -> contents of its folder."""


def is_file(study: str) -> bool:
    """Whether a study is a user's file (``.py``), not an identifier."""
    return study.endswith(".py")


def load(study: str, *, mission: bool = False) -> ModuleType:
    """Load the module of a paper, of a study on real data, or of a user's study, FILE.py
    (`celnav.papers.own.load`).

    mission: whether the module is loaded for missions, which need presets; studies on real data
        have none.

    Raises
    ------
    ValueError: for an unknown identifier; the message lists the known ones.
    """
    if is_file(study):
        module: ModuleType = import_module("celnav.papers.own").load(study, mission=mission)
        return module
    studies = PAPERS if mission else PAPERS | {name: f"celnav.real.{name}" for name in REAL}
    if study not in studies:
        names = [*studies, "a file FILE.py"]
        raise ValueError(
            f"unknown paper {study!r}: expected one of "
            f"{', '.join(names)}{did_you_mean(study, names)}"
        )
    return import_module(studies[study])


def citation(key: str) -> str:
    """The BibTeX entry of a source that docstrings cite, from ``data/references.bib``.

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
