"""``celnav new``: a study of one's own to begin with."""

from __future__ import annotations

import argparse
from pathlib import Path

from celnav.commands.arguments import UsageError
from celnav.files import data
from celnav.papers import PAPERS
from celnav.papers.own import is_own, name_of
from celnav.real import STUDIES

__all__ = ["run"]


def run(options: argparse.Namespace) -> int:
    """Write the file, which must not be there."""
    path = Path(options.file)
    if not is_own(options.file):
        raise UsageError(f"{path}: expected the name of a file that ends in .py, such as study.py")
    if (name := name_of(options.file)) in (*PAPERS, *STUDIES):
        raise UsageError(f"{path}: expected another name than {name}, which celnav has")
    if not path.parent.is_dir():
        raise UsageError(f"{path.parent}: no such folder; make it first")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(
                data("own/study.py").read_text(encoding="utf-8").replace("study.py", path.name)
            )
    except FileExistsError:
        raise UsageError(
            f"{path}: is there already, and nothing is overwritten; choose another name, or move it away"
        ) from None
    print(f"wrote {path}; fly it with: celnav reproduce {path} --effort 0.1")
    return 0
