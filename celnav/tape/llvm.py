"""A tape as machine code: straight-line LLVM on vectors of runs, compiled in memory by llvmlite.

A `Kernel` is one step. Its numbers come from, and go to, four places::

    state   (blocks, S, lanes)       what a run carries from step to step; read and written
    shared  (steps, E)               inputs that all runs have in common
    own     (steps, M, runs)         inputs of each run
    rows    (rows stored, O, runs)   what is kept of a step

`fly` takes blocks of ``lanes`` runs, one after the other, through all steps. Every operation is IEEE arithmetic in a fixed order
(products and sums fused only where this module says so): a run has the same bytes in any block, lane or thread.
"""

from __future__ import annotations

import ctypes
import struct
import sys
from collections import Counter
from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from typing import Any, NamedTuple

from celnav.tape.elementary import lowered
from celnav.tape.tape import Number, Scalar, Tape, as_number

LIBM = (
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "pow", "sinh", "cosh", "tanh", "exp2", "log2", "log10",
    "log1p", "expm1", "cbrt",
)  # fmt: skip
BLOCK = 4000  # lines of a basic block
_BINARY = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_COMPARED = {"lt": "olt", "le": "ole", "eq": "oeq", "ne": "une"}


class Kernel(NamedTuple):
    """One step: a tape, where its inputs come from and where its results go.

    inputs: ``(place, index)`` of each input, place "state", "shared" or "own". state: ``(index, result)`` of what is written.
    rows: results that are kept.
    """

    tape: Tape
    inputs: Sequence[tuple[str, int]]
    state: Sequence[tuple[int, Scalar]]
    rows: Sequence[Scalar]

    def results(self) -> list[tuple[str, int, Number]]:
        """Where each result goes, "state" or "rows" and an index, and the result."""
        pairs = [("state", i, x) for i, x in self.state] + [("rows", i, x) for i, x in enumerate(self.rows)]
        return [(place, i, self.tape.lift(as_number(x))) for place, i, x in pairs]

    def lowered(self) -> Kernel:
        """With elementary functions as arithmetic."""
        tape, known = lowered(self.tape, [x for *_, x in self.results()])
        found = {(place, i): known[x.i] for place, i, x in self.results()}
        state = [(i, found["state", i]) for i, _ in self.state]
        return Kernel(tape, self.inputs, state, [found["rows", i] for i in range(len(self.rows))])


def source(kernel: Kernel, lanes: int, fused: bool) -> str:
    """LLVM assembly of a kernel, as the function ``step(state, shared, own, rows, runs)``; no rows are stored if that is null."""
    if fused:  # without that their ranges are reduced less exactly than the C library does it
        kernel = kernel.lowered()
    tape, ops, results = kernel.tape, kernel.tape.ops, kernel.results()
    needed = tape.needed([x for *_, x in results])
    uses = Counter(a for i in needed if ops[i][0] not in ("in", "const") for a in ops[i][1:])
    uses.update(x.i for *_, x in results)
    vector = f"<{lanes} x double>" if lanes > 1 else "double"
    code = _Code(lanes, vector, ops)
    joined = _fused(needed, ops, uses) if fused else {}
    within = set(joined.values())
    for i in needed:
        if ops[i][0] == "in":
            place, at = kernel.inputs[ops[i][1]]
            code.load(i, place, at)
        elif ops[i][0] != "const" and i not in within:
            code.operation(i, joined.get(i))
        if len(code.lines) > BLOCK * (code.blocks + 1):
            code.new_block()
    for place, at, x in results:
        if place == "state":
            code.store(place, at, x.i)
    kept = _Code(lanes, vector, ops)
    for place, at, x in results:
        if place == "rows":
            kept.store(place, at, x.i)
    called = {ops[i][0] for i in needed} & set(LIBM)
    intrinsics = [
        f"declare {vector} @llvm.{name}.{code.suffix}({', '.join([vector] * count)})"
        for name, count in (("sqrt", 1), ("fabs", 1), ("floor", 1), ("rint", 1), ("copysign", 2), ("fma", 3))
    ]
    signature = "define void @step(ptr noalias %state, ptr %shared, ptr %own, ptr noalias %rows, i64 %runs)"
    return "\n".join([
        *intrinsics, *(_libm(name, lanes, vector) for name in sorted(called)), signature, "{", *code.lines,
        "%none = icmp eq ptr %rows, null", "br i1 %none, label %done, label %keep", "keep:", *kept.lines,
        "br label %done", "done:", "ret void", "}",
    ])  # fmt: skip


def _fused(needed: Sequence[int], ops: Sequence[tuple[Any, ...]], uses: Counter[int]) -> dict[int, int]:
    """Sums ``i`` whose term ``j`` is a product used nowhere else: both are one operation."""
    found = {}
    for i in needed:
        if ops[i][0] in ("add", "sub"):
            products = [j for j in reversed(ops[i][1:]) if ops[j][0] == "mul" and uses[j] == 1]
            if products:
                found[i] = products[0]
    return found


class _Code:
    """Lines of a function, as they are written."""

    def __init__(self, lanes: int, vector: str, ops: Sequence[tuple[Any, ...]]):
        self.lanes, self.vector, self.ops, self.lines = lanes, vector, ops, list[str]()
        self.suffix = f"v{lanes}f64" if lanes > 1 else "f64"
        self.blocks = 0

    def new_block(self) -> None:
        """Go on in another basic block: the time that one takes to compile grows faster than its length."""
        self.blocks += 1
        self.lines += [f"br label %b{self.blocks}", f"b{self.blocks}:"]

    def value(self, i: int) -> str:
        """The name of a number, or the number."""
        if self.ops[i][0] != "const":
            return f"%t{i}"
        bits = f"double 0x{struct.unpack('>Q', struct.pack('>d', self.ops[i][1]))[0]:016X}"
        return "<" + ", ".join([bits] * self.lanes) + ">" if self.lanes > 1 else bits.removeprefix("double ")

    def address(self, name: str, place: str, at: int) -> None:
        """Where a number lies."""
        if place == "state":
            self.lines.append(f"{name} = getelementptr double, ptr %state, i64 {at * self.lanes}")
        elif place == "shared":
            self.lines.append(f"{name} = getelementptr double, ptr %shared, i64 {at}")
        else:
            self.lines.append(f"{name}o = mul i64 %runs, {at}")
            self.lines.append(f"{name} = getelementptr double, ptr %{place}, i64 {name}o")

    def load(self, i: int, place: str, at: int) -> None:
        """Take an input."""
        self.address(f"%p{i}", place, at)
        if place == "shared" and self.lanes > 1:
            self.lines += [
                f"%s{i} = load double, ptr %p{i}, align 8",
                f"%e{i} = insertelement {self.vector} undef, double %s{i}, i32 0",
                f"%t{i} = shufflevector {self.vector} %e{i}, {self.vector} undef, <{self.lanes} x i32> zeroinitializer",
            ]
            return
        self.lines.append(f"%t{i} = load {self.vector}, ptr %p{i}, align 8")

    def store(self, place: str, at: int, i: int) -> None:
        """Hand a result on."""
        self.address(f"%{place}{at}", place, at)
        self.lines.append(f"store {self.vector} {self.value(i)}, ptr %{place}{at}, align 8")

    def operation(self, i: int, product: int | None) -> None:
        """One operation; a sum together with its ``product``."""
        name, *arguments = self.ops[i]
        value, vector = [self.value(a) for a in arguments], self.vector
        logical = f"<{self.lanes} x i1>" if self.lanes > 1 else "i1"
        put = self.lines.append
        if product is not None:
            a, b = (self.value(j) for j in self.ops[product][1:])
            first = arguments[0] == product
            c = value[1] if first else value[0]
            if name == "sub" and first:
                put(f"%n{i} = fneg {vector} {c}")
                c = f"%n{i}"
            elif name == "sub":
                put(f"%n{i} = fneg {vector} {a}")
                a = f"%n{i}"
            put(f"%t{i} = call {vector} @llvm.fma.{self.suffix}({vector} {a}, {vector} {b}, {vector} {c})")
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
            ones = "<" + ", ".join(["i1 true"] * self.lanes) + ">" if self.lanes > 1 else "true"
            put(f"%t{i} = xor {logical} {value[0]}, {ones}")
        elif name in ("pow2", "exponent"):
            self.bits(i, name, value[0])
        else:
            called = f"@{name}.{self.suffix}" if name in LIBM else f"@llvm.{ {'abs': 'fabs'}.get(name, name) }.{self.suffix}"
            put(f"%t{i} = call {vector} {called}({', '.join(f'{vector} {x}' for x in value)})")

    def bits(self, i: int, name: str, x: str) -> None:
        """Two to a whole number, or the exponent of a number, by the bits of a float."""
        whole = f"<{self.lanes} x i64>" if self.lanes > 1 else "i64"

        def all_of(kind: str, value: str) -> str:
            return "<" + ", ".join([f"{kind} {value}"] * self.lanes) + ">" if self.lanes > 1 else value

        put, vector = self.lines.append, self.vector
        if name == "pow2":  # 1.5 2^52 has the number in its last bits, and 1 is the exponent field 1023
            put(f"%w{i} = fadd {vector} {x}, {all_of('double', '0x4338000000000000')}")
            put(f"%x{i} = bitcast {vector} %w{i} to {whole}")
            put(f"%y{i} = shl {whole} %x{i}, {all_of('i64', '52')}")
            put(f"%z{i} = add {whole} %y{i}, {all_of('i64', '4607182418800017408')}")
            put(f"%t{i} = bitcast {whole} %z{i} to {vector}")
            return
        put(f"%w{i} = bitcast {vector} {x} to {whole}")
        put(f"%x{i} = lshr {whole} %w{i}, {all_of('i64', '52')}")
        put(f"%y{i} = and {whole} %x{i}, {all_of('i64', '2047')}")
        put(f"%z{i} = or {whole} %y{i}, {all_of('i64', '4841369599423283200')}")  # 2^52 with the field in its last bits
        put(f"%v{i} = bitcast {whole} %z{i} to {vector}")
        put(f"%t{i} = fsub {vector} %v{i}, {all_of('double', '0x43300000000003FF')}")


def _libm(name: str, lanes: int, vector: str) -> str:
    """A function of the C library, on each lane."""
    count = 2 if name in ("atan2", "pow") else 1
    suffix = f"v{lanes}f64" if lanes > 1 else "f64"
    arguments = ", ".join(f"{vector} %x{j}" for j in range(count))
    lines = [f"declare double @{name}({', '.join(['double'] * count)})"]
    lines.append(f"define internal {vector} @{name}.{suffix}({arguments}) noinline {{")
    last = "undef"
    for k in range(lanes):
        given = []
        for j in range(count):
            if lanes > 1:
                lines.append(f"%a{k}_{j} = extractelement {vector} %x{j}, i32 {k}")
            given.append(f"double %a{k}_{j}" if lanes > 1 else f"double %x{j}")
        lines.append(f"%r{k} = call double @{name}({', '.join(given)})")
        if lanes > 1:
            lines.append(f"%v{k} = insertelement {vector} {last}, double %r{k}, i32 {k}")
        last = f"%v{k}" if lanes > 1 else f"%r{k}"
    return "\n".join([*lines, f"ret {vector} {last}", "}"])


LOOP = """
define void @fly(ptr %kernels, ptr %kinds, ptr %at, ptr %state, ptr %shared, ptr %own, ptr %rows,
                 i64 %S, i64 %E, i64 %M, i64 %O, i64 %runs, i64 %lanes, i64 %first, i64 %last, i64 %steps)
{
start:
  %size = mul i64 %S, %lanes
  %M_runs = mul i64 %M, %runs
  %O_runs = mul i64 %O, %runs
  %any = icmp slt i64 %first, %last
  br i1 %any, label %block, label %done
block:
  %b = phi i64 [%first, %start], [%b1, %next]
  %s0 = mul i64 %b, %size
  %s = getelementptr double, ptr %state, i64 %s0
  %run = mul i64 %b, %lanes
  br label %epoch
epoch:
  %k = phi i64 [0, %block], [%k1, %stepped]
  %kp = getelementptr i32, ptr %kinds, i64 %k
  %kind = load i32, ptr %kp
  %fp = getelementptr ptr, ptr %kernels, i32 %kind
  %f = load ptr, ptr %fp
  %e0 = mul i64 %k, %E
  %e = getelementptr double, ptr %shared, i64 %e0
  %m0 = mul i64 %k, %M_runs
  %m1 = add i64 %m0, %run
  %m = getelementptr double, ptr %own, i64 %m1
  %rp = getelementptr i64, ptr %at, i64 %k
  %row = load i64, ptr %rp
  %not = icmp slt i64 %row, 0
  %o0 = mul i64 %row, %O_runs
  %o1 = add i64 %o0, %run
  %o2 = getelementptr double, ptr %rows, i64 %o1
  %o = select i1 %not, ptr null, ptr %o2
  call void %f(ptr %s, ptr %e, ptr %m, ptr %o, i64 %runs)
  br label %stepped
stepped:
  %k1 = add i64 %k, 1
  %more = icmp slt i64 %k1, %steps
  br i1 %more, label %epoch, label %next
next:
  %b1 = add i64 %b, 1
  %again = icmp slt i64 %b1, %last
  br i1 %again, label %block, label %done
done:
  ret void
}
"""
_LONG, _POINTER = ctypes.c_int64, ctypes.c_void_p
_FLY = ctypes.CFUNCTYPE(None, *[_POINTER] * 7, *[_LONG] * 9)


@cache
def _binding() -> Any:
    """llvmlite, ready to compile for this processor."""
    try:
        import llvmlite.binding as binding
    except ImportError:
        cure = '.venv/bin/pip install -c constraints.txt -e ".[compiled]"'
        raise ImportError(f"engine='compiled': expected llvmlite, which {cure} brings") from None
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    for name in LIBM:
        binding.add_symbol(name, ctypes.cast(getattr(library, name), _POINTER).value)
    return binding


@cache
def features() -> dict[str, bool]:
    """Of this processor."""
    return dict(_binding().get_host_cpu_features())


@cache
def lanes() -> int:
    """Runs in a vector."""
    return 8 if features().get("avx512f") else 4


def compiled(text: str, name: str) -> int:
    """Address of the function of a ``name``."""
    binding = _binding()
    module = binding.parse_assembly(text)
    module.verify()
    target = binding.Target.from_default_triple()
    machine = target.create_target_machine(
        cpu=binding.get_host_cpu_name(), features=binding.get_host_cpu_features().flatten(), opt=1
    )
    engine = binding.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    _ENGINES.append(engine)
    return int(engine.get_function_address(name))


_ENGINES: list[Any] = []
"""They own the machine code, which stays as long as the process."""
_ADDRESSES: dict[bytes, int] = {}
"""Of kernels, by the hash of their operations."""


def signature(kernel: Kernel, lanes: int) -> bytes:
    """The same for kernels that are the same operation by operation."""
    results = tuple((place, i, x.i) for place, i, x in kernel.results())
    return sha256(repr((lanes, kernel.inputs, results, kernel.tape.key)).encode()).digest()


def kernel_address(kernel: Kernel, lanes: int) -> int:
    """Of its compiled function; what is the same operation by operation is compiled once."""
    key = signature(kernel, lanes)
    if key not in _ADDRESSES:
        _ADDRESSES[key] = compiled(source(kernel, lanes, features().get("fma", False)), "step")
    return _ADDRESSES[key]


@cache
def fly() -> Any:
    """The function that takes blocks of runs through steps; Python's lock is free while it works."""
    return _FLY(compiled(LOOP, "fly"))
