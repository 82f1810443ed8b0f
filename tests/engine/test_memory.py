"""The memory of rows is reused when nothing refers to it any more, and never before."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from celnav.engine import memory

SHAPE = (4, 40, 1000)


@pytest.fixture(autouse=True)
def _nothing_waits():
    memory._FREE.clear()


def test_what_nobody_holds_is_used_again():
    rows = memory.empty(SHAPE, float)
    assert rows.shape == SHAPE
    assert rows.dtype == float
    rows[...] = 7.0
    first = rows.ctypes.data
    view = rows[1:, ::2].T[3:]
    del rows
    assert memory.empty(SHAPE, float).ctypes.data != first  # a view still refers to it
    del view
    gc.collect()
    taken = [memory.empty((*SHAPE[::-1],), float) for _ in range(2)]
    assert first in [one.ctypes.data for one in taken]


def test_arrays_of_one_time_share_nothing():
    held = [memory.empty(SHAPE, float) for _ in range(3)]
    for i, one in enumerate(held):
        one[...] = i
    assert [one.min() for one in held] == [one.max() for one in held] == [0.0, 1.0, 2.0]


def test_truth_values_and_small_arrays():
    assert memory.empty((3000, 1000), bool).dtype == bool
    assert memory.empty((2, 3), float).base is None


def test_no_more_waits_than_the_limit(monkeypatch):
    monkeypatch.setattr(memory, "MOST", 3 * 8 * int(np.prod(SHAPE)))
    held = [memory.empty(SHAPE, float) for _ in range(5)]
    del held
    gc.collect()
    assert sum(size * len(blocks) for size, blocks in memory._FREE.items()) <= memory.MOST
