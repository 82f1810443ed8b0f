"""Studies on real data: one module each, with the names of a paper's module (see `celnav.papers`).
They judge no statements of others.

``CITATION``: the source of the data. ``TITLE``, ``STUDY``, ``FIGURES``, ``TABLES``, ``RECORDINGS``
and ``record`` are as in a paper's module. ``INPUTS`` has the name of the study, under which
``STUDY.parts`` takes the folder of its data. ``FILES`` are the patterns of files without which the
folder is refused. The ledger has checks, and findings with intervals from blocks of time
(`celnav.study.ledger.estimate`, ``block=``). Filters run once, and arrays are ``(T, 1, ...)``. The
data are not part of the package: without a folder a study does not run, and its rows are not on the
page.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from celnav.lazy import modules
from celnav.papers import REAL, load

__getattr__, __dir__ = modules(__name__)

__all__ = ["STUDIES", "found", "load"]

STUDIES = REAL


def found(folder: str | Path, patterns: Sequence[str]) -> list[Path]:
    """The first file of a folder that matches each pattern, such as ``["*.pos.gz"]``.

    Raises
    ------
    FileNotFoundError: naming the folder and the pattern without a file.
    """
    where = Path(folder)
    each = [sorted(where.glob(pattern)) if where.is_dir() else [] for pattern in patterns]
    for pattern, files in zip(patterns, each, strict=True):
        if not files:
            raise FileNotFoundError(f"{where}: expected a folder with a file {pattern}")
    return [files[0] for files in each]
