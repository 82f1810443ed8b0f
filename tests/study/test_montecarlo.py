"""Blocks of runs, and their random numbers."""

from __future__ import annotations

import numpy as np
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


@pytest.mark.parametrize("seed", [0, 20261123, 2**40 + 7, 2**127 + 1, 2**130])
def test_generators_made_at_once_are_those_made_one_by_one(seed):
    """Equal to numpy's seeding, word for word, also for long seeds."""
    for study in (0, 3, 2**32 - 1, 2**32):
        made = montecarlo.generators(seed, study, 9)
        for run, rng in enumerate(made):
            assert (
                rng.bit_generator.state
                == montecarlo.generator(seed, study, run).bit_generator.state
            )
    assert montecarlo.generators(0, 0, 0) == []
    with pytest.raises(ValueError, match=r"^seed"):
        montecarlo.generators(-1, 0, 3)


@pytest.mark.parametrize("owned", [False, True])
def test_numbers_drawn_ahead_are_those_asked_for_each_time(owned):
    """And the generators continue after the last number used; a generator of zeros is called each
    time.
    """

    class Zeros:
        def standard_normal(self, shape):
            return np.zeros(shape)

    counts = [2, 0, 3, 1, 500, 7]
    made, known = (montecarlo.generators(1, 0, 4) for _ in range(2))
    draws = montecarlo.Draws(made, owned)
    for count in counts:
        expected = np.stack([rng.standard_normal(count) for rng in known])
        np.testing.assert_array_equal(draws(count), expected)
    draws.close()
    if not owned:
        np.testing.assert_array_equal(
            [rng.random() for rng in made], [rng.random() for rng in known]
        )
    np.testing.assert_array_equal(montecarlo.Draws([Zeros()])(3), np.zeros((1, 3)))
