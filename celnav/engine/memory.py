"""Memory of rows that is used again.

The system hands out fresh memory a page at a time and zeroes each, which takes as long as a
filter's arithmetic. So what a track held goes to the next rows of the same size, once nobody holds
it any more.
"""

from __future__ import annotations

import math
import weakref
from typing import Any

import numpy as np

from celnav.gaussian.linalg import Array

LEAST = 1 << 20  # bytes of what is used again: smaller arrays are used again by the allocator
MOST = 1 << 28  # bytes that wait to be used

_FREE: dict[int, list[Any]] = {}
"""Blocks that nobody uses, by size. What is given back may come from any thread, at any line: there
are no locks.
"""


def empty(shape: tuple[int, ...], dtype: type) -> Array:
    """An array with arbitrary contents."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < LEAST:
        return np.empty(shape, dtype)
    try:
        block = _FREE[size].pop()
    except (KeyError, IndexError):
        block = np.empty(size, np.uint8)
    # Views of this array keep it alive, not its block: between both stands what is no array.
    array: Array = np.frombuffer(memoryview(block), dtype)
    weakref.finalize(array, _give_back, block).atexit = False
    return array.reshape(shape)


def _give_back(block: Any) -> None:
    """Let a block be used again, unless too much waits for that already."""
    _FREE.setdefault(len(block), []).append(block)
    if sum(size * len(blocks) for size, blocks in list(_FREE.items())) > MOST:
        _FREE.clear()
