"""``celnav new``: a template for a user's study."""

from __future__ import annotations

import argparse
from pathlib import Path

from celnav.commands.arguments import UsageError, check_name
from celnav.files import data
from celnav.papers import is_file


def run(options: argparse.Namespace) -> int:
    """Write the file, which must not exist yet."""
    path = Path(options.file)
    if not is_file(options.file):
        raise UsageError(f"{path}: expected the name of a file that ends in .py, such as study.py")
    check_name(options.file)
    if not path.parent.is_dir():
        raise UsageError(f"{path.parent}: no such folder; make it first")
    template = data("own/study.py").read_text(encoding="utf-8")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(template.replace("study.py", path.name))
    except FileExistsError:
        raise UsageError(
            f"{path}: exists already and is not overwritten; choose another name, or move it away"
        ) from None
    print(f"wrote {path}; run it with: celnav reproduce {path} --effort 0.1")
    return 0
