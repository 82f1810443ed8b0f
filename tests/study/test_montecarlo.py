"""Blocks of runs, and their random numbers."""

from __future__ import annotations

import pytest

from celnav.study import montecarlo


def test_blocks_cover_all_runs():
    assert [list(b) for b in montecarlo.blocks(5, 2)] == [[0, 1], [2, 3], [4]]
    for bad in (0, -1, 1.5):
        with pytest.raises(ValueError, match=r"^block"):
            montecarlo.blocks(3, bad)


def test_a_run_has_its_own_numbers():
    draw = [montecarlo.generator(3, study, run).normal() for study in (0, 1) for run in (0, 1)]
    assert len(set(draw)) == 4
    assert montecarlo.generator(3, 1, 1).normal() == draw[3]
