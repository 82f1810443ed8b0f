"""``celnav verdicts``: what studies say and what holds, in Markdown: a table and paragraphs."""

from __future__ import annotations

import argparse
from pathlib import Path

from celnav.commands.index import partial, reproduced, summary, verdicts
from celnav.papers import REAL


def run(options: argparse.Namespace) -> int:
    """Count the verdicts of the papers that were reproduced."""
    out = Path(options.out)
    found = {name: claims for name, claims in reproduced(out).items() if name not in REAL}
    if not found:
        raise FileNotFoundError(
            f"{options.out}: no paper was reproduced there; use: celnav reproduce --out "
            f"{options.out}"
        )
    print(*partial(out, found), verdicts(found), summary(list(found), out, found), sep="\n\n")
    return 0
