"""``celnav verdicts``: what papers, and studies of one's own, say and what holds, in Markdown: a table and paragraphs."""

from __future__ import annotations

import argparse
from pathlib import Path

from celnav.commands.index import few, own_studies, reproduced, verdicts, words

__all__ = ["run"]


def run(options: argparse.Namespace) -> int:
    """Count the verdicts of the papers that were reproduced."""
    out = Path(options.out)
    found = reproduced(out) | reproduced(out, own_studies(out))
    if not found:
        raise FileNotFoundError(
            f"{options.out}: no paper was reproduced there; use: celnav reproduce --out {options.out}"
        )
    print(*few(out, found), verdicts(found), words(list(found), out, found), sep="\n\n")
    return 0
