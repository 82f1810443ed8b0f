"""Memory of rows that is reused.

The system hands out fresh memory a page at a time and zeroes each page, which takes as long as a
filter's arithmetic. So the memory of a track is reused for the next rows of the same size, once
nothing refers to it any more.
"""

from __future__ import annotations

import math
import weakref
from typing import Any

import numpy as np

from celnav.gaussian.linalg import Array

LEAST = 1 << 20  # bytes of a block that is reused; the allocator reuses smaller arrays by itself
MOST = 1 << 28  # bytes that wait for reuse

_FREE: dict[int, list[Any]] = {}
"""Unused blocks, by size. Blocks may be returned by any thread, at any line: there are no locks."""


def empty(shape: tuple[int, ...], dtype: type) -> Array:
    """An array with arbitrary contents."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < LEAST:
        return np.empty(shape, dtype)
    try:
        block = _FREE[size].pop()
    except (KeyError, IndexError):
        block = np.empty(size, np.uint8)
    # Views of this array keep it alive, not its block: an object between both is not an array.
    array: Array = np.frombuffer(memoryview(block), dtype)
    weakref.finalize(array, _give_back, block).atexit = False
    return array.reshape(shape)


def _give_back(block: Any) -> None:
    """Make a block available again, unless too many bytes wait already."""
    _FREE.setdefault(len(block), []).append(block)
    if sum(size * len(blocks) for size, blocks in list(_FREE.items())) > MOST:
        _FREE.clear()
