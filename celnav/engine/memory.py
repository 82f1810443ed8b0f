"""Reuse of the memory of stored rows.

The operating system provides new memory page by page and zeroes each page, which takes as long as a
filter's arithmetic. So the memory of a track is reused for the next rows of the same size, as soon
as nothing refers to it any more.
"""

from __future__ import annotations

import math
import weakref
from typing import Any

import numpy as np

from celnav.gaussian.linalg import Array

LEAST = 1 << 20  # smallest block that is reused, bytes; the allocator itself reuses smaller arrays
MOST = 1 << 28  # most bytes that are held for reuse

_FREE: dict[int, list[Any]] = {}
"""Unused blocks, by size. Any thread may return a block at any line, where a lock could block it
forever.
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
    # Views keep this array alive, not only its block, because the base of the array is a memoryview
    # and not an array.
    array: Array = np.frombuffer(memoryview(block), dtype)
    weakref.finalize(array, _give_back, block).atexit = False
    return array.reshape(shape)


def _give_back(block: Any) -> None:
    """Make a block available again, unless too many bytes are held already."""
    _FREE.setdefault(len(block), []).append(block)
    if sum(size * len(blocks) for size, blocks in list(_FREE.items())) > MOST:
        _FREE.clear()
