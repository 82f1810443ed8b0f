"""Studies on real data: one module each, of the shape of a paper's (see `celnav.papers`); nothing
there was stated by anybody.

``CITATION``: where the data come from. ``TITLE``, ``STUDY``, ``FIGURES``, ``TABLES``,
``RECORDINGS`` and ``record`` are as a paper's; ``INPUTS`` is the study's own name: ``STUDY.parts``
takes the folder of its data under it, and reads it or leaves that to its parts; then ``FILES`` are
the patterns of files without which the folder is refused.
The ledger has findings, with intervals by blocks of time (`celnav.study.ledger.estimate`,
``block=``), and checks; filters run once, and arrays are ``(T, 1, ...)``. The data are nobody's
here: without a folder a study is not done, and its rows are not on the page.
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
