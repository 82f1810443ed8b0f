"""Studies on real data: one module each, of the shape of a paper's (see `celnav.papers`); nothing
there was stated by anybody.

``CITATION``: where the data come from. ``TITLE``, ``STUDY``, ``FIGURES``, ``TABLES``,
``RECORDINGS`` and ``record`` are as a paper's; ``INPUTS`` is the study's own name: ``STUDY.parts``
takes the folder of its data under it. The ledger has findings, with intervals by blocks of time
(`celnav.study.ledger.estimate`, ``block=``), and checks; filters fly one run, and arrays are
``(T, 1, ...)``. The data are nobody's here: without a folder a study is not done, and its rows are
not on the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType

from celnav.lazy import modules

__getattr__, __dir__ = modules(__name__)

STUDIES: dict[str, str] = {
    "grace": "GPS fixes and positions of GRACE-A, August 2008, and a gravity field",
    "nanograv": "pulsars' arrival times (daily_averages.npz)",
    "rxte": "photons of a pulsar, the satellite's orbit, a timing model (*.fits, FPorbit*, *.par)",
    "broad": "trials of BROAD (MATLAB files)",
}
"""Identifier, which is also the option of ``celnav reproduce`` and the module -> what the folder
holds.
"""


def load(study: str) -> ModuleType:
    """The module of a study.

    Raises
    ------
    ValueError: for an unknown identifier; the message lists the known ones.
    """
    if study not in STUDIES:
        raise ValueError(f"unknown study {study!r}: expected one of {', '.join(STUDIES)}")
    return import_module(f"celnav.real.{study}")


def found(folder: str | Path, patterns: Sequence[str]) -> list[Path]:
    """The first file of a folder by each pattern, such as ``["*.pos.gz"]``.

    Raises
    ------
    FileNotFoundError: naming the folder, and the pattern of which there is none.
    """
    where = Path(folder)
    each = [sorted(where.glob(pattern)) if where.is_dir() else [] for pattern in patterns]
    for pattern, files in zip(patterns, each, strict=True):
        if not files:
            raise FileNotFoundError(f"{where}: expected a folder with a file {pattern}")
    return [files[0] for files in each]
