"""What holds for the studies of all papers."""

from __future__ import annotations

import pickle

import pytest

from celnav.papers import PAPERS, load


@pytest.mark.parametrize("paper", PAPERS)
def test_units_go_to_processes_and_are_told_apart(paper):
    units = load(paper).STUDY.units(effort=0.1)
    sent = {pickle.loads(pickle.dumps(unit)).key for unit in units}
    assert len(set(units)) == len(sent) == len(units)
