"""``celnav verdicts``: what holds, as a table in Markdown."""

from __future__ import annotations

import argparse
from pathlib import Path

from celnav.report import reproduced, verdicts


def run(options: argparse.Namespace) -> int:
    """Count the verdicts of the papers that were reproduced."""
    found = reproduced(Path(options.out))
    if not found:
        raise FileNotFoundError(f"{options.out}: no paper was reproduced there; use: celnav reproduce --out {options.out}")
    print(verdicts(found))
    return 0
