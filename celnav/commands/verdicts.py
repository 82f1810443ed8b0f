"""``celnav verdicts``: what studies say and what holds, in Markdown: a table and paragraphs."""

from __future__ import annotations

import argparse
from pathlib import Path

from celnav.commands.index import partial, reproduced, summary, verdicts
from celnav.papers import REAL


def run(options: argparse.Namespace) -> int:
    """Count the verdicts of the papers that were reproduced."""
    out = Path(options.out)
    claims = {name: listed for name, listed in reproduced(out).items() if name not in REAL}
    if not claims:
        raise FileNotFoundError(
            f"{options.out}: no paper was reproduced there; use: celnav reproduce --out "
            f"{options.out}"
        )
    print(*partial(out, claims), verdicts(claims), summary(list(claims), out, claims), sep="\n\n")
    return 0
