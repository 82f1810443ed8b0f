"""Blocks, generators and units of work."""

from __future__ import annotations

import numpy as np
import pytest

from celnav.study import montecarlo


def test_blocks_cover_all_runs_and_units_join_in_order():
    assert [list(b) for b in montecarlo.blocks(5, 2)] == [[0, 1], [2, 3], [4]]
    units = [montecarlo.Unit("a", lambda r: {"x": np.array([list(r)])}, (part,)) for part in montecarlo.blocks(5, 2)]
    plan = montecarlo.Plan(units, lambda outcomes: outcomes["a"].arrays["x"])
    np.testing.assert_array_equal(montecarlo.carry_out(plan), [[0, 1, 2, 3, 4]])
    for bad in (0, -1, 1.5):
        with pytest.raises(ValueError, match=r"^block"):
            montecarlo.blocks(3, bad)


def test_a_run_has_its_own_numbers():
    draw = [montecarlo.generator(3, study, run).normal() for study in (0, 1) for run in (0, 1)]
    assert len(set(draw)) == 4
    assert montecarlo.generator(3, 1, 1).normal() == draw[3]


def one(run):
    return {"x": np.full((1, 1), float(run))}


def bad(run):
    return {"x": np.log(np.full((1, 1), float(run)))}


def test_units_in_processes_are_those_done_here():
    plan = montecarlo.Plan([montecarlo.Unit("a", one, (i,)) for i in range(5)], lambda outcomes: outcomes["a"].arrays["x"])
    done = []
    several = montecarlo.carry_out(plan, jobs=2, progress=lambda count, total, label: done.append((count, total, label)))
    np.testing.assert_array_equal(several, montecarlo.carry_out(plan))
    assert done == [(i, 5, "a") for i in range(1, 6)]
    with pytest.raises(ValueError, match=r"^jobs: expected a positive integer, got 0$"):
        montecarlo.carry_out(plan, jobs=0)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_warning_of_a_unit_is_an_error_wherever_it_is_done(jobs):
    plan = montecarlo.Plan([montecarlo.Unit("a", bad, (i,)) for i in range(2)], len)
    with pytest.raises(RuntimeWarning, match="divide by zero"):
        montecarlo.carry_out(plan, jobs=jobs)
