"""A tape as machine code: straight-line LLVM on vectors of runs, compiled in memory by llvmlite.

A `Kernel` is one step. Its numbers are read from and written to these places::

    state   (blocks, S, lanes)       what a run carries from step to step; read and written
    shared  (steps, E)               inputs that all runs have in common
    own     (steps, M, runs)         inputs of each run
    rows    (rows stored, runs, n)   the stored results of a step, an array for each field
    cells   (C, lanes)               the memory of routines

`run_loop` takes blocks of ``lanes`` runs, one after the other, through all steps. Every operation
is IEEE arithmetic in a fixed order (a product and a sum are fused only where this module says so).
So a run has the same result, bit for bit, in any block, lane or thread.
"""

from __future__ import annotations

import ctypes
import struct
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import zip_longest
from typing import Any

import numpy as np

from celnav.lazy import requires_extra
from celnav.tape.elementary import EXPANSIONS
from celnav.tape.kernel import Kernel, digest
from celnav.tape.tape import Tape, TracedScalar, operands

LIBM = tuple(EXPANSIONS)
LINE = 64  # bytes in a cache line
# Blocks that are computed together through an epoch: the stored results of neighbors then share
# pages of memory.
TILE = 16
# Lines of a module above which it is compiled without optimization: this takes a tenth of the time,
# for code that runs a third longer.
QUICK = 30_000
BLOCK = 500  # most lines in a basic block
SIZE = {"double": 8, "i8": 1}
"""Bytes of a stored number."""
LOADED = ("in", "part", "const")
TURNS = 8  # sums that are interleaved: half the registers of a processor
_BINARY = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_COMPARED = {"lt": "olt", "le": "ole", "eq": "oeq", "ne": "une"}


def source(kernel: Kernel, lanes: int, fused: bool) -> str:
    """LLVM assembly of a kernel: ``step(state, shared, own, rows, runs, cells, at)``.

    rows: pointers to the fields. ``at``: the position in the rows for the run in the first lane; if
        it is negative, nothing is stored.
    """
    if fused:  # fused products make range reduction as exact as in the C library
        kernel = kernel.expanded()
    tape, results = kernel.tape, kernel.results()
    code = _Code(lanes, fused, kernel.inputs)
    code.body(tape, [x for *_, x in results])
    for place, at, x in results:
        if place == "state":
            code.store(place, at, x.i)
    # If no row is stored, the step ends here.
    code.lines += ["%none = icmp slt i64 %at, 0", "br i1 %none, label %done, label %keep", "keep:"]
    code.keep(kernel, [x.i for place, _, x in results if place == "rows"])
    called, functions, routines = code.called, list[str](), dict(code.routines)
    # Routines that a routine calls are appended while the loop runs.
    for routine in (pending := list(routines)):
        for k, stage in enumerate(routine.stages):
            inner = _stage(stage, routine.own_cells, lanes, fused)
            called |= inner.called
            pending += [callee for callee in inner.routines if callee not in routines]
            routines |= inner.routines
            functions += [
                f"define internal void @{routine.name}.{k}(ptr noalias %cells) noinline",
                "{",
                *inner.lines,
                "}",
            ]
    intrinsics = [
        f"declare {code.vector} @llvm.{name}.{code.suffix}({', '.join([code.vector] * count)})"
        for name, count in (
            ("sqrt", 1),
            ("fabs", 1),
            ("floor", 1),
            ("rint", 1),
            ("copysign", 2),
            ("fma", 3),
        )
    ]
    if lanes > 1:
        for kind in SIZE:
            intrinsics.append(
                f"declare void @llvm.masked.scatter.{_suffix(kind, lanes)}.v{lanes}p0("
                f"<{lanes} x {kind}>, <{lanes} x ptr>, i32, <{lanes} x i1>)"
            )
    signature = (
        "define void @step(ptr noalias %state, ptr %shared, ptr %own, ptr %rows, i64 %runs, "
        "ptr noalias %cells, i64 %at)"
    )
    return "\n".join(
        [
            *intrinsics,
            *(_libm(name, lanes, code.vector) for name in sorted(called)),
            *functions,
            signature,
            "{",
            *code.lines,
            "br label %done",
            "done:",
            "ret void",
            "}",
        ]
    )


def _suffix(kind: str, lanes: int) -> str:
    """The suffix of an intrinsic function's name for a vector with elements of this type."""
    name = {"double": "f64", "i8": "i8"}[kind]
    return f"v{lanes}{name}" if lanes > 1 else name


def _stage(stage: Any, cells: int, lanes: int, fused: bool) -> _Code:
    """Lines of a loop over the rows of a stage; ``cells``: the memory of its routine."""
    code = _Code(lanes, fused, stage.inputs, cells)
    code.lines += ["start:", "br label %loop", "loop:", "%r = phi i64 [0, %start], [%r1, %end]"]
    for place, (first, stride) in stage.places.items():
        # Address of a place: (first + row * stride) * lanes numbers after the first cell.
        code.lines.append(f"%{place}o = mul i64 %r, {stride * lanes}")
        code.lines.append(f"%{place}a = add i64 %{place}o, {first * lanes}")
        code.lines.append(f"%{place} = getelementptr double, ptr %cells, i64 %{place}a")
    code.body(stage.tape, [x for *_, x in stage.results])
    for place, at, x in stage.results:
        code.store(place, at, x.i)
    code.lines += [
        "br label %end",
        "end:",
        "%r1 = add i64 %r, 1",
        f"%more = icmp slt i64 %r1, {stage.rows}",
    ]
    code.lines += ["br i1 %more, label %loop, label %done", "done:", "ret void"]
    return code


def _fused(needed: Sequence[int], tape: Tape, uses: Counter[int]) -> dict[int, int]:
    """Sums ``i`` with a term ``j`` that is a product used nowhere else: both
    become one operation.
    """
    joined, ops = {}, tape.ops
    for i in needed:
        if ops[i][0] in ("add", "sub") and i not in tape.sharp:
            # Numbers that decide a jump keep numpy's rounding of the product.
            products = [j for j in reversed(ops[i][1:]) if ops[j][0] == "mul" and uses[j] == 1]
            if products:
                joined[i] = products[0]
    return joined


def _sums(
    needed: Sequence[int], tape: Tape, uses: Counter[int], joined: dict[int, int]
) -> list[list[int]]:
    """Operations in a valid order; each chain that sums products is one unit, at the place of its
    last product.
    """
    within, units = set(joined.values()), dict[int, list[int]]()  # units by their last operation
    for i in needed:
        if i in within or tape.ops[i][0] in LOADED:
            continue
        before = [a for a in operands(tape.ops[i]) if a != joined.get(i)] if i in joined else []
        # A sum continues the unit of its previous term, if nothing else uses that term.
        begun = (
            units.pop(before[0]) if before and uses[before[0]] == 1 and before[0] in units else []
        )
        units[i] = [*begun, i]
    return list(units.values())


def _in_turn(units: Sequence[list[int]], tape: Tape, joined: dict[int, int]) -> Iterator[int]:
    """The operations, interleaved for neighboring sums.

    A number that several sums multiply, such as a component of the state in a matrix product, is
    then loaded once, and no sum waits for its previous term.
    """
    group, members = list[list[int]](), set[int]()

    def taken() -> Iterator[int]:
        for step in zip_longest(*group):
            yield from (i for i in step if i is not None)
        group.clear()
        members.clear()

    for unit in units:
        needs = {a for i in unit for j in (i, joined.get(i, i)) for a in operands(tape.ops[j])}
        same_length = bool(group) and len(unit) == len(group[0])
        # A unit that needs a result of the group is placed after the group.
        if len(group) == TURNS or not same_length or not needs.isdisjoint(members):
            yield from taken()
        group.append(unit)
        members |= set(unit)
    yield from taken()


class _Code:
    """Lines of a function, as they are written.

    called: functions of the C library that it calls. routines: routines that it calls. cells:
        number of memory cells in use before its first call.
    """

    def __init__(self, lanes: int, fused: bool, inputs: Sequence[tuple[str, int]], cells: int = 0):
        self.lanes, self.fused, self.inputs, self.lines = lanes, fused, inputs, list[str]()
        self.vector = f"<{lanes} x double>" if lanes > 1 else "double"
        self.suffix = _suffix("double", lanes)
        self.every = "<" + ", ".join(["i1 true"] * lanes) + ">"
        self.blocks, self.cells = 0, cells
        self.called, self.routines = set[str](), dict[Any, None]()
        self.memory = dict[int, int]()  # first cell of each call
        self.loaded = set[int]()

    def body(self, tape: Tape, outputs: Sequence[TracedScalar]) -> None:
        """All operations that the outputs need."""
        self.ops, needed = tape.ops, tape.needed(outputs)
        uses = Counter(a for i in needed for a in operands(tape.ops[i]))
        uses.update(x.i for x in outputs)
        joined = _fused(needed, tape, uses) if self.fused else {}
        for i in _in_turn(_sums(needed, tape, uses, joined), tape, joined):
            # Load operands just before their first use.
            for a in (i, *(operands(self.ops[i])), *(operands(self.ops[joined.get(i, i)]))):
                self.take(a)
            name, *at = self.ops[i]
            if name == "call":
                self.call(i, *at)
            elif name not in LOADED:
                self.operation(i, joined.get(i))
                self.called |= {name} & set(LIBM)
            self.divide()
        for x in outputs:
            self.take(x.i)

    def take(self, i: int) -> None:
        """Load a number before its first use."""
        name, *at = self.ops[i]
        if name not in LOADED or i in self.loaded:
            return
        self.loaded.add(i)
        if name == "in":
            self.load(i, *self.inputs[at[0]])
        elif name == "part":
            self.load(i, "cells", self.memory[at[0]] + at[1])

    def call(self, i: int, routine: Any, *arguments: int) -> None:
        """Call a routine with a separate part of the memory."""
        self.routines[routine] = None
        self.memory[i] = self.cells
        if routine.rare:
            self.lines.append(
                f"%c{i}any = fcmp une {self.vector} {self.value(arguments[0])}, zeroinitializer"
            )
            if self.lanes > 1:
                self.lines.append(
                    f"%c{i}bits = bitcast <{self.lanes} x i1> %c{i}any to i{self.lanes}"
                )
                self.lines.append(f"%c{i}some = icmp ne i{self.lanes} %c{i}bits, 0")
            taken = f"%c{i}some" if self.lanes > 1 else f"%c{i}any"
            self.lines += [f"br i1 {taken}, label %rare{i}, label %usual{i}", f"rare{i}:"]
        for k, a in enumerate(arguments):
            # The arguments are the first cells of the routine's memory.
            self.address(f"%c{i}_{k}", "cells", self.cells + k)
            self.lines.append(f"store {self.vector} {self.value(a)}, ptr %c{i}_{k}, align 8")
            self.divide()
        self.address(f"%c{i}", "cells", self.cells)
        self.lines += [
            f"call void @{routine.name}.{k}(ptr %c{i})" for k in range(len(routine.stages))
        ]
        if routine.rare:
            self.lines += [f"br label %usual{i}", f"usual{i}:"]
        self.cells += routine.cells

    def divide(self) -> None:
        """Start a new basic block after some lines: the compile time of a block grows faster than
        its length.
        """
        if len(self.lines) <= BLOCK * (self.blocks + 1):
            return
        self.blocks += 1
        self.lines += [f"br label %b{self.blocks}", f"b{self.blocks}:"]

    def value(self, i: int) -> str:
        """The name of a number, or the number."""
        if self.ops[i][0] != "const":
            return f"%t{i}"
        bits = f"double 0x{struct.unpack('>Q', struct.pack('>d', self.ops[i][1]))[0]:016X}"
        return (
            "<" + ", ".join([bits] * self.lanes) + ">"
            if self.lanes > 1
            else bits.removeprefix("double ")
        )

    def address(self, name: str, place: str, at: int) -> None:
        """The address of a number."""
        if place == "own":
            self.lines.append(f"{name}o = mul i64 %runs, {at}")
            self.lines.append(f"{name} = getelementptr double, ptr %{place}, i64 {name}o")
        else:
            self.lines.append(
                f"{name} = getelementptr double, ptr %{place}, i64 "
                f"{at * (1 if place == 'shared' else self.lanes)}"
            )

    def load(self, i: int, place: str, at: int) -> None:
        """Load a number from its place."""
        self.address(f"%p{i}", place, at)
        # A shared number is broadcast to all lanes.
        if place == "shared" and self.lanes > 1:
            self.lines += [
                f"%s{i} = load double, ptr %p{i}, align 8",
                f"%e{i} = insertelement {self.vector} undef, double %s{i}, i32 0",
                f"%t{i} = shufflevector {self.vector} %e{i}, {self.vector} undef, <{self.lanes} x "
                "i32> zeroinitializer",
            ]
            return
        self.lines.append(f"%t{i} = load {self.vector}, ptr %p{i}, align 8")

    def store(self, place: str, at: int, i: int) -> None:
        """Store a result of the state."""
        name = f"%{place}{at}_{i}"
        self.address(name, place, at)
        self.lines.append(f"store {self.vector} {self.value(i)}, ptr {name}, align 8")

    def keep(self, kernel: Kernel, values: Sequence[int]) -> None:
        """Store the rows: in each field the numbers of a run are side by side."""
        columns, count = kernel.columns(), kernel.fields or (len(kernel.rows),)
        cell = ["i8" if field in kernel.flags else "double" for field in range(len(count))]
        for field, n in enumerate(count):
            self.lines += [
                f"%to{field} = getelementptr ptr, ptr %rows, i64 {field}",
                f"%field{field} = load ptr, ptr %to{field}",
                f"%from{field} = mul i64 %at, {n}",
                f"%row{field} = getelementptr {cell[field]}, ptr %field{field}, i64 %from{field}",
            ]
        for k, ((field, j), i) in enumerate(zip(columns, values, strict=True)):
            slot, value, kind = f"%kept{k}", self.value(i), cell[field]
            vector = f"<{self.lanes} x {kind}>" if self.lanes > 1 else kind
            if kind == "i8":
                truth = vector.replace("i8", "i1")
                self.lines += [
                    f"%true{k} = fcmp une {self.vector} {value}, zeroinitializer",
                    f"%flag{k} = zext {truth} %true{k} to {vector}",
                ]
                value = f"%flag{k}"
            if self.lanes == 1:
                self.lines += [
                    f"{slot} = getelementptr {kind}, ptr %row{field}, i64 {j}",
                    f"store {kind} {value}, ptr {slot}",
                ]
                continue
            # Rows of neighboring runs have a distance of count[field] numbers.
            places = ", ".join(f"i64 {lane * count[field] + j}" for lane in range(self.lanes))
            self.lines += [
                f"{slot} = getelementptr {kind}, ptr %row{field}, <{self.lanes} x i64> <{places}>",
                f"call void @llvm.masked.scatter.{_suffix(kind, self.lanes)}.v{self.lanes}p0("
                f"{vector} {value}, <{self.lanes} x ptr> {slot}, i32 {SIZE[kind]}, "
                f"<{self.lanes} x i1> {self.every})",
            ]

    def operation(self, i: int, product: int | None) -> None:
        """Write one operation; a sum together with its ``product``."""
        name, *arguments = self.ops[i]
        value, vector = [self.value(a) for a in arguments], self.vector
        logical = f"<{self.lanes} x i1>" if self.lanes > 1 else "i1"
        put = self.lines.append
        if product is not None:
            a, b = (self.value(j) for j in self.ops[product][1:])
            # fma(a, b, c): the product a b and the other term c; a difference negates a or c.
            first = arguments[0] == product
            c = value[1] if first else value[0]
            if name == "sub" and first:
                put(f"%n{i} = fneg {vector} {c}")
                c = f"%n{i}"
            elif name == "sub":
                put(f"%n{i} = fneg {vector} {a}")
                a = f"%n{i}"
            put(
                f"%t{i} = call {vector} @llvm.fma.{self.suffix}({vector} {a}, {vector} {b}, "
                f"{vector} {c})"
            )
        elif name in _BINARY:
            put(f"%t{i} = {_BINARY[name]} {vector} {value[0]}, {value[1]}")
        elif name == "neg":
            put(f"%t{i} = fneg {vector} {value[0]}")
        elif name in _COMPARED:
            put(f"%t{i} = fcmp {_COMPARED[name]} {vector} {value[0]}, {value[1]}")
        elif name == "select":
            put(f"%t{i} = select {logical} {value[0]}, {vector} {value[1]}, {vector} {value[2]}")
        elif name in ("and", "or"):
            put(f"%t{i} = {name} {logical} {value[0]}, {value[1]}")
        elif name == "not":
            ones = self.every if self.lanes > 1 else "true"
            put(f"%t{i} = xor {logical} {value[0]}, {ones}")
        elif name in ("pow2", "exponent"):
            self.bits(i, name, value[0])
        else:
            called = (
                f"@{name}.{self.suffix}"
                if name in LIBM
                else f"@llvm.{ {'abs': 'fabs'}.get(name, name) }.{self.suffix}"
            )
            put(f"%t{i} = call {vector} {called}({', '.join(f'{vector} {x}' for x in value)})")

    def bits(self, i: int, name: str, x: str) -> None:
        """Two to the power of an integer, or the exponent of a number, from the bits of a float."""
        whole = f"<{self.lanes} x i64>" if self.lanes > 1 else "i64"

        def all_of(kind: str, value: str) -> str:
            return (
                "<" + ", ".join([f"{kind} {value}"] * self.lanes) + ">" if self.lanes > 1 else value
            )

        put, vector = self.lines.append, self.vector
        # Adding 1.5 2^52 moves the integer to the last bits; the exponent field of 1.0 is 1023.
        if name == "pow2":
            put(f"%w{i} = fadd {vector} {x}, {all_of('double', '0x4338000000000000')}")
            put(f"%x{i} = bitcast {vector} %w{i} to {whole}")
            put(f"%y{i} = shl {whole} %x{i}, {all_of('i64', '52')}")
            put(f"%z{i} = add {whole} %y{i}, {all_of('i64', '4607182418800017408')}")
            put(f"%t{i} = bitcast {whole} %z{i} to {vector}")
            return
        put(f"%w{i} = bitcast {vector} {x} to {whole}")
        put(f"%x{i} = lshr {whole} %w{i}, {all_of('i64', '52')}")
        put(f"%y{i} = and {whole} %x{i}, {all_of('i64', '2047')}")
        # 2^52 with the exponent field in its last bits.
        put(f"%z{i} = or {whole} %y{i}, {all_of('i64', '4841369599423283200')}")
        put(f"%v{i} = bitcast {whole} %z{i} to {vector}")
        put(f"%t{i} = fsub {vector} %v{i}, {all_of('double', '0x43300000000003FF')}")


def _libm(name: str, lanes: int, vector: str) -> str:
    """Call a function of the C library for each lane."""
    count = 2 if name in ("atan2", "pow", "fmod", "hypot") else 1
    suffix = f"v{lanes}f64" if lanes > 1 else "f64"
    arguments = ", ".join(f"{vector} %x{j}" for j in range(count))
    lines = [f"declare double @{name}({', '.join(['double'] * count)})"]
    lines.append(f"define internal {vector} @{name}.{suffix}({arguments}) noinline {{")
    last = "undef"
    for k in range(lanes):
        passed = []
        for j in range(count):
            if lanes > 1:
                lines.append(f"%a{k}_{j} = extractelement {vector} %x{j}, i32 {k}")
            passed.append(f"double %a{k}_{j}" if lanes > 1 else f"double %x{j}")
        lines.append(f"%r{k} = call double @{name}({', '.join(passed)})")
        if lanes > 1:
            lines.append(f"%v{k} = insertelement {vector} {last}, double %r{k}, i32 {k}")
        last = f"%v{k}" if lanes > 1 else f"%r{k}"
    return "\n".join([*lines, f"ret {vector} {last}", "}"])


LOOP = """
define void @fly(ptr %kernels, ptr %kinds, ptr %at, ptr %state, ptr %shared, ptr %own, ptr %rows,
                 ptr %cells, i64 %S, i64 %E, i64 %M, i64 %all, i64 %before, i64 %runs, i64 %lanes,
                 i64 %first, i64 %last, i64 %steps)
{
start:
  %size = mul i64 %S, %lanes
  %M_runs = mul i64 %M, %runs
  %any = icmp slt i64 %first, %last
  br i1 %any, label %tile, label %done
tile:
  %from = phi i64 [%first, %start], [%to, %flown]
  %far = add i64 %from, @TILE
  %less = icmp slt i64 %far, %last
  %to = select i1 %less, i64 %far, i64 %last
  br label %epoch
epoch:
  %k = phi i64 [0, %tile], [%k1, %stepped]
  %kp = getelementptr i32, ptr %kinds, i64 %k
  %kind = load i32, ptr %kp
  %fp = getelementptr ptr, ptr %kernels, i32 %kind
  %f = load ptr, ptr %fp
  %e0 = mul i64 %k, %E
  %e = getelementptr double, ptr %shared, i64 %e0
  %m0 = mul i64 %k, %M_runs
  %rp = getelementptr i64, ptr %at, i64 %k
  %row = load i64, ptr %rp
  %o0 = mul i64 %row, %all
  %o1 = add i64 %o0, %before
  br label %block
block:
  %b = phi i64 [%from, %epoch], [%b1, %block]
  %s0 = mul i64 %b, %size
  %s = getelementptr double, ptr %state, i64 %s0
  %run = mul i64 %b, %lanes
  %m1 = add i64 %m0, %run
  %m = getelementptr double, ptr %own, i64 %m1
  %o2 = add i64 %o1, %run
  call void %f(ptr %s, ptr %e, ptr %m, ptr %rows, i64 %runs, ptr %cells, i64 %o2)
  %b1 = add i64 %b, 1
  %again = icmp slt i64 %b1, %to
  br i1 %again, label %block, label %stepped
stepped:
  %k1 = add i64 %k, 1
  %more = icmp slt i64 %k1, %steps
  br i1 %more, label %epoch, label %flown
flown:
  %left = icmp slt i64 %to, %last
  br i1 %left, label %tile, label %done
done:
  ret void
}
"""
_POINTERS, _SIZES = 8, 10
_FLY = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * _POINTERS, *[ctypes.c_int64] * _SIZES)
_CALL = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


@cache
def toolchain() -> Any:
    """The binding of llvmlite, initialized for this processor."""
    with requires_extra("machine code", "compiled"):
        import llvmlite.binding as binding
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    for name in LIBM:
        binding.add_symbol(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)
    return binding


@cache
def features() -> dict[str, bool]:
    """Features of this processor."""
    return dict(toolchain().get_host_cpu_features())


@cache
def lanes() -> int:
    """Runs in a vector."""
    return 8 if features().get("avx512f") else 4


def aligned(shape: tuple[int, ...]) -> Any:
    """An array of floats that starts at a cache line, so that no vector crosses two lines."""
    size = 8 * int(np.prod(shape))
    memory = np.empty(size + LINE, np.uint8)
    first = -memory.ctypes.data % LINE
    return memory[first : first + size].view(np.float64).reshape(shape)


def compiled(text: str, name: str) -> int:
    """Address of the function with this ``name``."""
    binding = toolchain()
    module = binding.parse_assembly(text)
    module.verify()
    target = binding.Target.from_default_triple()
    machine = target.create_target_machine(
        cpu=binding.get_host_cpu_name(),
        features=binding.get_host_cpu_features().flatten(),
        opt=0 if text.count("\n") > QUICK else 1,
    )
    engine = binding.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    _ENGINES.append(engine)
    return int(engine.get_function_address(name))


_ENGINES: list[Any] = []
"""The owners of the machine code, which lives as long as the process."""
_ADDRESSES: dict[tuple[bytes, int], int] = {}
"""Addresses of kernels, with the hash of their operations and the number of lanes as keys."""


def kernel_address(kernel: Kernel, lanes: int) -> int:
    """Address of the compiled function; equal kernels are compiled once."""
    key = digest(kernel), lanes
    if key not in _ADDRESSES:
        _ADDRESSES[key] = compiled(source(kernel, lanes, features().get("fma", False)), "step")
    return _ADDRESSES[key]


@cache
def run_loop() -> Any:
    """The compiled function that advances blocks of runs through steps; it releases Python's global
    lock.
    """
    return _FLY(compiled(LOOP.replace("@TILE", str(TILE)), "fly"))


@cache
def _with_arguments() -> Any:
    """Like `run_loop`, with its arguments in one array, which is passed in a fifth of the time."""
    kinds = ["ptr"] * _POINTERS + ["i64"] * _SIZES
    lines = [LOOP.replace("@TILE", str(TILE)), "define void @call(ptr %given) {"]
    for i, kind in enumerate(kinds):
        lines += [
            f"%p{i} = getelementptr i64, ptr %given, i64 {i}",
            f"%a{i} = load {kind}, ptr %p{i}",
        ]
    passed = ", ".join(f"{kind} %a{i}" for i, kind in enumerate(kinds))
    return _CALL(
        compiled("\n".join([*lines, f"call void @fly({passed})", "ret void", "}"]), "call")
    )


def caller(
    kernel: int, state: Any, shared: Any, own: Any, fields: Any, cells: Any
) -> Callable[[], None]:
    """A function that advances all blocks of ``state`` by one step on these buffers.

    fields: addresses of the rows, one row each.
    """
    blocks, size, lanes = state.shape
    # One epoch of one kind, stored in row 0.
    once = np.array([kernel], np.uint64), np.zeros(1, np.int32), np.zeros(1, np.int64)
    buffers = *once, state, shared, own, fields, cells
    width = blocks * lanes
    sizes = size, len(shared), len(own), width, 0, width, lanes, 0, blocks, 1
    passed = np.array([*(x.ctypes.data for x in buffers), *sizes], np.int64)
    step, address = _with_arguments(), ctypes.c_void_p(passed.ctypes.data)

    def call(_alive: Any = (passed, buffers)) -> None:
        step(address)

    return call
