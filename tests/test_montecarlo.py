"""Blocks, generators and units of work."""

from __future__ import annotations

import numpy as np
import pytest

from celnav import montecarlo


def test_blocks_cover_all_runs_and_units_join_in_order():
    assert [list(b) for b in montecarlo.blocks(5, 2)] == [[0, 1], [2, 3], [4]]
    units = [montecarlo.Unit("a", lambda r: {"x": np.array([list(r)])}, (part,)) for part in montecarlo.blocks(5, 2)]
    np.testing.assert_array_equal(montecarlo.work(units)["a"].arrays["x"], [[0, 1, 2, 3, 4]])
    for bad in (0, -1, 1.5):
        with pytest.raises(ValueError, match=r"^block"):
            montecarlo.blocks(3, bad)


def test_a_run_has_its_own_numbers():
    draw = [montecarlo.generator(3, study, run).normal() for study in (0, 1) for run in (0, 1)]
    assert len(set(draw)) == 4
    assert montecarlo.generator(3, 1, 1).normal() == draw[3]
