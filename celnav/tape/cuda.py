"""An NVIDIA device, through its driver by ctypes: memory, and runs by the programs of
`celnav.tape.ptx`.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.tape.ptx import TARGET

THREADS = 64  # of a block: registers are the scarce resource
MOST = 1 << 32  # bytes copied at once, which the host must hold, too
_ERROR_LOG, _ERROR_LOG_SIZE = 5, 6  # options of the driver's compiler
_MAJOR, _MINOR = 75, 76  # attributes of a device: its compute capability


class CudaError(RuntimeError):
    """There is no driver or no device, or a call of the driver failed; the message says which."""


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
        self.driver, self._entries = driver, dict[str, Any]()
        number, self._context, capability = ctypes.c_int(), ctypes.c_void_p(), list[int]()
        self._do("cuInit", ctypes.c_uint(0))
        self._do("cuDeviceGet", ctypes.byref(number), ctypes.c_int(0))
        for attribute in (_MAJOR, _MINOR):
            value = ctypes.c_int()
            self._do("cuDeviceGetAttribute", ctypes.byref(value), ctypes.c_int(attribute), number)
            capability.append(value.value)
        if tuple(capability) < TARGET:
            least, its = (".".join(map(str, version)) for version in (TARGET, capability))
            raise CudaError(
                f"engine='cuda': expected a device of compute capability {least} or higher, got "
                f"{its}"
            )
        self._do("cuDevicePrimaryCtxRetain", ctypes.byref(self._context), number)

    def entry(self, program: str) -> Any:
        """The entry of a program, which the driver compiles at its first use."""
        if program not in self._entries:
            self._do("cuCtxSetCurrent", self._context)
            module, entry, log = (
                ctypes.c_void_p(),
                ctypes.c_void_p(),
                ctypes.create_string_buffer(8192),
            )
            options = (ctypes.c_int * 2)(_ERROR_LOG, _ERROR_LOG_SIZE)
            values = (ctypes.c_void_p * 2)(ctypes.addressof(log), len(log))
            image = ctypes.c_char_p(program.encode())
            self._do(
                "cuModuleLoadDataEx",
                ctypes.byref(module),
                image,
                ctypes.c_uint(2),
                options,
                values,
                log=log,
            )
            self._do("cuModuleGetFunction", ctypes.byref(entry), module, ctypes.c_char_p(b"entry"))
            self._entries[program] = entry
        return self._entries[program]

    def room(self) -> int:
        """Bytes that a run may use: half of the free memory, because the memory of the threads
        comes out of it, too.
        """
        self._do("cuCtxSetCurrent", self._context)
        free, whole = ctypes.c_size_t(), ctypes.c_size_t()
        self._do("cuMemGetInfo_v2", ctypes.byref(free), ctypes.byref(whole))
        return min(free.value // 2, MOST)

    def fly(
        self,
        entry: Any,
        kinds: NDArray[np.int32],
        at: NDArray[np.int64],
        *arrays: NDArray[np.float64],
    ) -> None:
        """Call an entry with the ``arrays`` state, shared, own and rows (of all fields),
        contiguous; state and rows come back.
        """
        state, shared, own, rows = arrays
        self._do("cuCtxSetCurrent", self._context)
        inputs: tuple[NDArray[Any], ...] = kinds, at, state, shared, own
        with self._memory([x.nbytes for x in (*inputs, rows)]) as places:
            for place, x in zip(places, inputs, strict=False):
                self._do(
                    "cuMemcpyHtoD_v2",
                    place,
                    ctypes.c_void_p(x.ctypes.data),
                    ctypes.c_size_t(x.nbytes),
                )
            steps, width, runs = own.shape
            values = [
                *places,
                *map(ctypes.c_int64, (shared.shape[1], width, int(at.max()) + 1, runs, steps)),
            ]
            pointers = (ctypes.c_void_p * len(values))(*map(ctypes.addressof, values))
            # Blocks in three dimensions, threads in three dimensions, bytes of shared memory.
            grid = (-(-runs // THREADS), 1, 1, THREADS, 1, 1, 0)
            self._do("cuLaunchKernel", entry, *map(ctypes.c_uint, grid), None, pointers, None)
            self._do("cuCtxSynchronize")
            for place, x in ((places[2], state), (places[5], rows)):
                self._do(
                    "cuMemcpyDtoH_v2",
                    ctypes.c_void_p(x.ctypes.data),
                    place,
                    ctypes.c_size_t(x.nbytes),
                )

    @contextmanager
    def _memory(self, sizes: Sequence[int]) -> Iterator[list[ctypes.c_uint64]]:
        """Blocks of device memory of the given sizes, freed at the end in any case."""
        places = list[ctypes.c_uint64]()
        try:
            for size in sizes:
                place = ctypes.c_uint64()
                self._do("cuMemAlloc_v2", ctypes.byref(place), ctypes.c_size_t(size), asked=size)
                places.append(place)
            yield places
        finally:
            for place in places:
                self.driver.cuMemFree_v2(place)

    def _do(self, name: str, *arguments: Any, log: Any = None, asked: int | None = None) -> None:
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
