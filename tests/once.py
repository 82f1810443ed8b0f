"""The study of a paper with few runs, computed once in a session: where its notebook looks for it, too."""

from __future__ import annotations

import os
from pathlib import Path

from celnav.store import RESULTS, resumed
from celnav.study.montecarlo import effort


def once(study):
    """All results, which are kept as ``celnav reproduce`` keeps them."""
    store = resumed(Path(os.environ["CELNAV_OUT"], study.name, RESULTS))
    for unit in study.units(effort=effort()):
        if not store.has(unit):
            store.write(unit, unit.do())
    return study.at_hand()
