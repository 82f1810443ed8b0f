"""A stand-in for NVIDIA's driver whose device is the host: the same LLVM assembly is compiled for
the host and run thread by thread.
"""

from __future__ import annotations

import ctypes
import re
from collections import Counter
from functools import cache

import numpy as np
from ptx_machine import Machine

from celnav.tape import cuda, llvm, ptx

ERRORS = {
    1: ("CUDA_ERROR_INVALID_VALUE", "invalid argument"),
    2: ("CUDA_ERROR_OUT_OF_MEMORY", "out of memory"),
    100: ("CUDA_ERROR_NO_DEVICE", "no CUDA-capable device is detected"),
    218: ("CUDA_ERROR_INVALID_PTX", "a PTX JIT compilation failed"),
    700: ("CUDA_ERROR_ILLEGAL_ADDRESS", "an illegal memory access was encountered"),
}
_NAMES = ("block", "width", "thread")


class Driver:
    """``failing``: the status that a function returns from its n-th call on; ``free``: free memory
    of the device in bytes.

    ``literal``: whether the PTX itself is interpreted, line by line.
    """

    def __init__(self, free=1 << 26, capability=(9, 0), failing=None, log=b"", literal=False):
        self.free, self.capability, self.failing, self.log, self.literal = (
            free,
            capability,
            failing or {},
            log,
            literal,
        )
        self.calls, self.memory, self.most, self.sources, self.entries = Counter(), {}, 0, {}, []
        self.locked, self.streams = {}, 0

    def __getattribute__(self, name):
        """Count every driver call, which may fail."""
        found = object.__getattribute__(self, name)
        if not name.startswith("cu") or name.startswith("cuGetError"):
            return found

        def counted(*arguments):
            self.calls[name] += 1
            status, first = self.failing.get(name, (0, 1))
            if status and self.calls[name] >= first:
                if name == "cuModuleLoadDataEx":
                    ctypes.memmove(arguments[4][0], self.log + b"\0", len(self.log) + 1)
                return status
            return found(*arguments)

        return counted

    def assembled(self, text):
        """PTX from LLVM assembly; the assembly is stored."""
        found = _ASSEMBLED(text)
        self.sources[found] = text
        return found

    # -- what the package calls --------------------------------------------------------------------
    def cuInit(self, flags):
        return 0

    cuCtxSetCurrent = cuInit

    def cuDeviceGet(self, device, number):
        device._obj.value = number.value
        return 0

    def cuDeviceGetAttribute(self, value, attribute, device):
        value._obj.value = self.capability[{75: 0, 76: 1}[attribute.value]]
        return 0

    def cuDevicePrimaryCtxRetain(self, context, device):
        context._obj.value = 1
        return 0

    def cuModuleLoadDataEx(self, module, image, count, options, values):
        text = image.value.decode()
        self.entries.append(Machine(text) if self.literal else on_the_host(self.sources[text]))
        module._obj.value = len(self.entries)
        return 0

    def cuModuleGetFunction(self, entry, module, name):
        assert name.value == b"entry"
        entry._obj.value = module.value
        return 0

    def cuMemGetInfo_v2(self, free, whole):
        free._obj.value, whole._obj.value = self.free - self.held, self.free
        return 0

    @property
    def held(self):
        return sum(map(len, list(self.memory.values())))

    def cuMemAlloc_v2(self, place, size):
        if not size.value:
            return 1
        if self.held + size.value > self.free:
            return 2
        buffer = (ctypes.c_char * size.value).from_buffer(
            bytearray(b"\xff" * size.value)
        )  # as floats they are nan
        place._obj.value = ctypes.addressof(buffer)
        self.memory[place._obj.value] = buffer
        self.most = max(self.most, self.held)
        return 0

    def cuMemFree_v2(self, place):
        return 0 if self.memory.pop(place.value, None) is not None else 1

    def cuStreamCreate(self, stream, flags):
        assert flags.value == 1
        stream._obj.value = 1
        self.streams += 1
        return 0

    def cuStreamDestroy_v2(self, stream):
        self.streams -= 1
        return 0

    def cuMemHostAlloc(self, place, size, flags):
        buffer = (ctypes.c_char * size.value).from_buffer(bytearray(b"\xff" * size.value))
        place._obj.value = ctypes.addressof(buffer)
        self.locked[place._obj.value] = buffer
        return 0

    def cuMemFreeHost(self, place):
        return 0 if self.locked.pop(place.value, None) is not None else 1

    def cuMemcpyHtoDAsync_v2(self, place, source, size, stream):
        return self.copied(place, place.value, source.value, size)

    def cuMemcpyDtoHAsync_v2(self, target, place, size, stream):
        return self.copied(place, target.value, place.value, size)

    def copied(self, place, target, source, size):
        """Copy from the start of a block that is large enough."""
        if len(self.memory.get(place.value, b"")) < size.value:
            return 1
        ctypes.memmove(target, source, size.value)
        return 0

    def cuLaunchKernel(self, entry, gx, gy, gz, bx, by, bz, shared, stream, parameters, extra):
        sizes = gy.value, gz.value, by.value, bz.value, shared.value
        assert (*sizes, stream.value, extra) == (1, 1, 1, 1, 0, 1, None)
        given = [ctypes.c_int64.from_address(at).value for at in parameters]
        if any(at not in self.memory for at in given[:6]):
            return 700
        threads = np.stack(np.divmod(np.arange(gx.value * bx.value), bx.value), 1)
        for block, thread in np.random.default_rng(0).permutation(threads).tolist():  # in any order
            self.entries[entry.value - 1](*given, block, bx.value, thread)
        return 0

    def cuStreamSynchronize(self, stream):
        return 0

    def cuGetErrorName(self, status, text):
        text._obj.value = ERRORS[status.value][0].encode()
        return 0

    def cuGetErrorString(self, status, text):
        text._obj.value = ERRORS[status.value][1].encode()
        return 0


def on_the_host(text):
    """The entry of a program, with block index, block width and thread index as further arguments
    instead of registers.
    """
    text, count = re.subn(r"(?m)^.*@llvm\.nvvm\.read\.ptx\.sreg\..*$\n", "", text)
    assert count == 6  # three declarations, three calls
    more = ", ".join(f"i32 %{name}" for name in _NAMES)
    text, count = re.subn(
        r"define ptx_kernel void @entry\((.*)\)", rf"define void @entry(\1, {more})", text
    )
    assert count == 1
    numbers = [ctypes.c_int64] * 11 + [ctypes.c_int32] * 3
    return ctypes.CFUNCTYPE(None, *numbers)(llvm.compiled(text, "entry"))


_ASSEMBLED = ptx.assembled


def installed(monkeypatch, driver):
    """A driver that replaces the machine's driver until the end of the test."""
    monkeypatch.setattr("celnav.engine.compiled.device", cache(lambda: cuda.Device(driver)))
    monkeypatch.setattr(ptx, "assembled", driver.assembled)
    monkeypatch.setattr(ptx, "_PROGRAMS", {})
    return driver
