"""The study of a paper with few runs, computed once per test session, and stored where its notebook
looks for it.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from celnav.engine import compiled
from celnav.study.montecarlo import effort
from celnav.study.store import RESULTS, existing, resumed


def once(study):
    """All results, stored as by ``celnav reproduce``; computed with the numpy engine."""
    folder = Path(os.environ["CELNAV_OUT"], study.name, RESULTS)
    store = existing(folder) or resumed(folder)
    units = study.units(effort=effort())
    if os.environ.get("PYTEST_XDIST_WORKER") == "gw1":
        units.reverse()  # if two processes need the same results, each computes half
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "operation_limit", lambda *_work: 0)
        for unit in units:
            if not store.has(unit):
                store.write(unit, unit.do())
    return study.at_hand()
