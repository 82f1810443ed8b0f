"""An interpreter of PTX, line by line according to NVIDIA's manual, for one thread; memory is the
host's.

64-bit registers contain integers; floats are packed into them. fma is rounded twice, to 64 and to
53 bits.
"""

from __future__ import annotations

import ctypes
import math
import re
from operator import itemgetter
from struct import pack, unpack

import numpy as np

MASK = (1 << 64) - 1


def bits(x):
    return unpack("<Q", pack("<d", x))[0]


def real(x):
    return unpack("<d", pack("<Q", x))[0]


def signed(x, width=64):
    return x - (1 << width) if x >> (width - 1) else x


def divided(a, b):
    return float(np.float64(a) / np.float64(b))


def fused(a, b, c):
    return float(np.longdouble(a) * np.longdouble(b) + np.longdouble(c))


def whole(function):
    """The integer part of a finite number; a zero keeps its sign."""
    return lambda a: math.copysign(float(function(a)), a) if math.isfinite(a) else a


FLOATS = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": divided,
    "fma": fused,
    "rcp": lambda a: divided(1.0, a),
    "sqrt": lambda a: math.sqrt(a) if a >= 0.0 else math.nan,
    "neg": lambda a: -a,
    "abs": abs,
    "max": lambda a, b: b if a != a or a < b else a,
    "min": lambda a, b: b if a != a or b < a else a,
    "copysign": lambda a, b: math.copysign(b, a),
    "cvt.rmi": whole(math.floor),
    "cvt.rni": whole(round),
}
INTEGERS = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul.lo": lambda a, b: a * b,
    "mad.lo": lambda a, b, c: a * b + c,
    "shl": lambda a, b: a << b,
    "shr": lambda a, b: a >> b,
    "or": lambda a, b: a | b,
    "and": lambda a, b: a & b,
    "mov": lambda a: a,
    "xor": lambda a, b: a ^ b,
    "not": lambda a: ~a,
    "cvta.to.global": lambda a: a,
    "cvt": lambda a: a,
}
COMPARED = {
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a < b or a > b,
    "nan": lambda a, b: a != a or b != b,
    "num": lambda a, b: a == a and b == b,
    "neu": lambda a, b: a != b,
}
for _name in ("lt", "le", "gt", "ge"):
    COMPARED[f"{_name}u"] = lambda a, b, of=COMPARED[_name]: a != a or b != b or of(a, b)
COMPARED["equ"] = lambda a, b: a != a or b != b or a == b


class Machine:
    """A program, called with its parameters, block index, block width and thread index."""

    def __init__(self, text):
        self.code, self.labels, self.tables = [], {}, {}
        body = text[text.index("{") :]
        for line in body.split(";"):
            line = re.sub(r"//.*", "", line).strip().lstrip("{").strip()
            while found := re.match(r"(\$\w+):\s*", line):
                self.labels[found[1]] = len(self.code)
                line = line[found.end() :]
                if line.startswith(".branchtargets"):
                    self.tables[found[1]] = [
                        name.strip() for name in line.removeprefix(".branchtargets").split(",")
                    ]
            if line and line[0] not in ".}":
                guard, op, rest = re.fullmatch(
                    r"(?:@(!?%\w+)\s+)?([\w.:]+)\s*(.*)", line, re.S
                ).groups()
                arguments = [x.strip() for x in rest.split(",")] if rest else []
                branches = op == "ret" or op.split(".")[0] in ("bra", "brx")
                do = None if branches else instruction(op, arguments)
                self.code.append((guard, op, arguments, do))

    @np.errstate(all="ignore")
    def __call__(self, *values):
        *given, block, width, thread = values
        registers = {f"[entry_param_{i}]": x & MASK for i, x in enumerate(given)}
        registers |= {"%ctaid.x": block, "%ntid.x": width, "%tid.x": thread}
        at = 0
        while True:
            guard, op, arguments, do = self.code[at]
            at += 1
            if guard is None or registers[guard.lstrip("!")] != guard.startswith("!"):
                if do is not None:
                    do(registers)
                elif op == "ret":
                    return
                elif op.split(".")[0] == "bra":
                    at = self.labels[arguments[0]]
                else:
                    at = self.labels[self.tables[arguments[1]][registers[arguments[0]]]]


def instruction(op, arguments):
    """A function of the registers that executes one instruction other than a branch."""
    name, kind = op.rsplit(".", 1)
    target, *given = arguments
    if op.startswith("ld.param"):
        return writing(target, itemgetter(given[0]))
    if op.startswith(("ld.global", "st.global")):
        register, _, offset = (given[0] if op[0] == "l" else target).strip("[]").partition("+")
        cell, offset = {"b64": ctypes.c_uint64, "b32": ctypes.c_uint32}[kind], int(offset or 0)
        if op[0] == "l":
            return writing(target, lambda r: cell.from_address(r[register] + offset).value)
        stored = reading(given[0])

        def store(r):
            cell.from_address(r[register] + offset).value = stored(r)

        return store
    if name == "selp":
        a, b, truth = reading(given[0]), reading(given[1]), itemgetter(given[2])
        return writing(target, lambda r: a(r) if truth(r) else b(r))
    if kind == "pred":
        a, b = itemgetter(given[0]), itemgetter(given[-1])
        function = {
            "and": lambda r: a(r) and b(r),
            "or": lambda r: a(r) or b(r),
            "not": lambda r: not a(r),
            "xor": lambda r: a(r) != b(r),
        }[name]
        return writing(target, function)
    if name.startswith("setp"):
        how = name.split(".")[1]
        function = COMPARED["neu" if how == "ne" and kind != "f64" else how]
        return writing(target, applied(function, [typed(x, kind) for x in given]))
    if kind == "f64":
        base = name.removesuffix(".f64").removesuffix(".rn")
        function = applied(FLOATS[base], [typed(x, kind) for x in given])
        return writing(target, lambda r: bits(function(r)))
    base = "cvt" if name.startswith("cvt.") else name
    mask = (1 << (int(kind[1:]) if base != "cvt" else 64)) - 1
    function = applied(INTEGERS[base], [reading(x) for x in given])
    return writing(target, lambda r: function(r) & mask)


def writing(target, function):
    """A function that writes the value of ``function(registers)`` to a register."""

    def do(r):
        r[target] = function(r)

    return do


def applied(function, readers):
    """A function of one, two or three values as a function of the registers."""
    if len(readers) == 1:
        (a,) = readers
        return lambda r: function(a(r))
    if len(readers) == 2:
        a, b = readers
        return lambda r: function(a(r), b(r))
    a, b, c = readers
    return lambda r: function(a(r), b(r), c(r))


def reading(x):
    """The value of a register, or a literal number."""
    if x[0] == "%":
        return itemgetter(x)
    number = bits_of(x)
    return lambda _: number


def typed(x, kind):
    """A value converted to the type of the operation."""
    value, size = reading(x), int(kind[1:])
    if kind == "f64":
        return lambda r: real(value(r))
    return (lambda r: signed(value(r), size)) if kind[0] == "s" else value


def bits_of(x):
    """The bits of a number in the text: 0d and sixteen digits for a float, or an integer."""
    return int(x[2:], 16) if x.startswith("0d") else int(x) & MASK
