"""An NVIDIA device, used through its driver with ctypes: memory, and runs of programs from
`celnav.tape.ptx`.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.tape.ptx import TARGET

THREADS = 64  # threads in a block: few, because registers are the scarce resource
MOST = 1 << 25  # most bytes in the arrays of a lane, which the host stores too
_ERROR_LOG, _ERROR_LOG_SIZE = 5, 6  # options of the driver's compiler
_MAJOR, _MINOR = 75, 76  # attributes of a device: its compute capability
_NON_BLOCKING = 1  # a stream that does not wait for the default stream


class CudaError(RuntimeError):
    """There is no driver or no device, or a call of the driver failed; the
    message names the cause.
    """


@cache
def device() -> Device:
    """The first device in CUDA_VISIBLE_DEVICES."""
    return Device(_driver())


def _driver() -> Any:
    """The driver's functions."""
    name = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
    try:
        return ctypes.CDLL(name)
    except OSError as error:
        raise CudaError(
            f"engine='cuda': expected the driver of an NVIDIA device, {name}, got none ({error})"
        ) from None


class Device:
    """A device, and the programs loaded on it."""

    def __init__(self, driver: Any):
        self.driver, self._entries, self._idle = driver, dict[str, Any](), list[Lane]()
        number, self._context, capability = ctypes.c_int(), ctypes.c_void_p(), list[int]()
        self.do("cuInit", ctypes.c_uint(0))
        self.do("cuDeviceGet", ctypes.byref(number), ctypes.c_int(0))
        for attribute in (_MAJOR, _MINOR):
            value = ctypes.c_int()
            self.do("cuDeviceGetAttribute", ctypes.byref(value), ctypes.c_int(attribute), number)
            capability.append(value.value)
        if tuple(capability) < TARGET:
            least, its = (".".join(map(str, version)) for version in (TARGET, capability))
            raise CudaError(
                f"engine='cuda': expected a device of compute capability {least} or higher, got "
                f"{its}"
            )
        self.do("cuDevicePrimaryCtxRetain", ctypes.byref(self._context), number)

    def entry(self, program: str) -> Any:
        """The entry of a program, which the driver compiles at the first use."""
        if program not in self._entries:
            self.do("cuCtxSetCurrent", self._context)
            module, entry, log = (
                ctypes.c_void_p(),
                ctypes.c_void_p(),
                ctypes.create_string_buffer(8192),
            )
            options = (ctypes.c_int * 2)(_ERROR_LOG, _ERROR_LOG_SIZE)
            values = (ctypes.c_void_p * 2)(ctypes.addressof(log), len(log))
            image = ctypes.c_char_p(program.encode())
            self.do(
                "cuModuleLoadDataEx",
                ctypes.byref(module),
                image,
                ctypes.c_uint(2),
                options,
                values,
                log=log,
            )
            self.do("cuModuleGetFunction", ctypes.byref(entry), module, ctypes.c_char_p(b"entry"))
            self._entries[program] = entry
        return self._entries[program]

    def room(self, lanes: int) -> int:
        """Bytes that each of ``lanes`` lanes may use: together half of the free memory, because the
        threads' memory comes from the free memory too.
        """
        self.do("cuCtxSetCurrent", self._context)
        free, whole = ctypes.c_size_t(), ctypes.c_size_t()
        self.do("cuMemGetInfo_v2", ctypes.byref(free), ctypes.byref(whole))
        return min(free.value // 2 // lanes, MOST)

    @contextmanager
    def lane(self) -> Iterator[Lane]:
        """A lane for exclusive use; `release` frees the memory of the lanes."""
        self.do("cuCtxSetCurrent", self._context)
        try:
            lane = self._idle.pop()
        except IndexError:
            lane = Lane(self)
        try:
            yield lane
        finally:
            self._idle.append(lane)

    def release(self) -> None:
        """Free the memory of all idle lanes. After a fault no call may succeed, so later errors are
        ignored: they must not hide the first error.
        """
        self.driver.cuCtxSetCurrent(self._context)
        while self._idle:
            self._idle.pop().close()

    def do(self, name: str, *arguments: Any, log: Any = None, asked: int | None = None) -> None:
        """Call a function of the driver; an error includes the compiler's ``log``, or the number of
        bytes ``asked`` for.
        """
        status = getattr(self.driver, name)(*arguments)
        if status == 0:
            return
        said = []
        for of in ("cuGetErrorName", "cuGetErrorString"):
            text = ctypes.c_char_p()
            getattr(self.driver, of)(ctypes.c_int(status), ctypes.byref(text))
            said.append((text.value or f"error {status}".encode()).decode())
        more = "" if asked is None else f" of {asked} bytes"
        more += f": {said[0]} ({said[1]})"
        more += "" if log is None else f": {log.value.decode(errors='replace').strip()}"
        raise CudaError(f"engine='cuda': {name}{more}")


class Lane:
    """A queue of work on a device, side by side with other lanes.

    It keeps its memory from call to call, because a device waits for all its work before it frees
    memory. Results are copied to page-locked memory of the host, which the driver writes directly,
    without an intermediate buffer.
    """

    def __init__(self, device: Device):
        self._device, self._stream = device, ctypes.c_void_p()
        self._blocks = dict[int, tuple[ctypes.c_uint64, int]]()  # on the device, with their sizes
        self._locked, self._size = ctypes.c_void_p(), 0
        device.do("cuStreamCreate", ctypes.byref(self._stream), ctypes.c_uint(_NON_BLOCKING))

    def run(
        self,
        entry: Any,
        kinds: NDArray[np.int32],
        at: NDArray[np.int64],
        *arrays: NDArray[np.float64],
        results: int,
    ) -> NDArray[np.float64]:
        """Call an entry with the contiguous ``arrays`` state, shared and own; the state is updated
        in place.

        Returns the rows of all fields, ``results`` numbers, valid until the next call.
        """
        do, (state, shared, own) = self._device.do, arrays
        inputs: tuple[NDArray[Any], ...] = kinds, at, state, shared, own
        rows = self._page_locked(results)
        places = [self._block(i, x.nbytes) for i, x in enumerate((*inputs, rows))]
        for place, x in zip(places, inputs, strict=False):
            source, size = ctypes.c_void_p(x.ctypes.data), ctypes.c_size_t(x.nbytes)
            do("cuMemcpyHtoDAsync_v2", place, source, size, self._stream)
        steps, width, runs = own.shape
        sizes = shared.shape[1], width, int(at.max()) + 1, runs, steps
        values = [*places, *map(ctypes.c_int64, sizes)]
        pointers = (ctypes.c_void_p * len(values))(*map(ctypes.addressof, values))
        # Grid size (3 dimensions), block size (3 dimensions), bytes of shared memory.
        grid = (-(-runs // THREADS), 1, 1, THREADS, 1, 1, 0)
        do("cuLaunchKernel", entry, *map(ctypes.c_uint, grid), self._stream, pointers, None)
        for place, x in ((places[2], state), (places[5], rows)):
            target, size = ctypes.c_void_p(x.ctypes.data), ctypes.c_size_t(x.nbytes)
            do("cuMemcpyDtoHAsync_v2", target, place, size, self._stream)
        do("cuStreamSynchronize", self._stream)
        return rows

    def close(self) -> None:
        """Free the memory, on the device and on the host."""
        driver = self._device.driver
        for place, _ in self._blocks.values():
            driver.cuMemFree_v2(place)
        if self._locked:
            driver.cuMemFreeHost(self._locked)
        driver.cuStreamDestroy_v2(self._stream)

    def _block(self, number: int, size: int) -> ctypes.c_uint64:
        """A block of device memory with at least ``size`` bytes."""
        place, known = self._blocks.get(number, (None, 0))
        if place is None or known < size:
            if place is not None:
                self._device.driver.cuMemFree_v2(self._blocks.pop(number)[0])
            place = ctypes.c_uint64()
            self._device.do("cuMemAlloc_v2", ctypes.byref(place), ctypes.c_size_t(size), asked=size)
            self._blocks[number] = place, size
        return place

    def _page_locked(self, count: int) -> NDArray[np.float64]:
        """Page-locked memory of the host for ``count`` numbers."""
        size = 8 * count
        if self._size < size:
            if self._locked:
                self._device.driver.cuMemFreeHost(self._locked)
            self._locked, self._size = ctypes.c_void_p(), 0
            self._device.do(
                "cuMemHostAlloc",
                ctypes.byref(self._locked),
                ctypes.c_size_t(size),
                ctypes.c_uint(0),
                asked=size,
            )
            self._size = size
        memory = (ctypes.c_double * count).from_address(self._locked.value or 0)
        return np.ctypeslib.as_array(memory)
