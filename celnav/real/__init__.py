"""Studies on real data, one module for each. They do not test published statements.

``CITATION``: the source of the data. ``TITLE``, ``STUDY``, ``FIGURES``, ``TABLES``, ``RECORDINGS``
and ``record`` are as in a paper's module (see `celnav.papers`). ``INPUTS`` has the name of the
study, which is also the argument of ``STUDY.parts`` for the folder of the data. ``FILES``: patterns
of the files that the folder must have.

The ledger has checks and findings. Findings have intervals from a bootstrap over blocks of time
(`celnav.study.ledger.estimate`, ``block=``). Filters run once, so arrays are ``(T, 1, ...)``. The
data are not part of the package. Without a folder a study does not run, and the page omits its
rows.
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
    """First file of a folder that matches each pattern, such as ``["*.pos.gz"]``.

    Raises
    ------
    FileNotFoundError: naming the folder and the pattern without a file.
    """
    where = Path(folder)
    each = [sorted(where.glob(pattern)) if where.is_dir() else [] for pattern in patterns]
    for pattern, files in zip(patterns, each, strict=True):
        if not files:
            raise FileNotFoundError(f"{where}: expected a folder with a file {pattern}, got none")
    return [files[0] for files in each]
