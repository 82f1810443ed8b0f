"""PTX, read and done line by line as NVIDIA's manual has it, for one thread; memory is the host's.

Registers of 64 bits hold integers, as which floats are unpacked and packed again. fma is rounded twice, at 64 and at 53 bits.
"""

from __future__ import annotations

import ctypes
import math
import re
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
    """Of what is finite, with its sign where it is zero."""
    return lambda a: math.copysign(float(function(a)), a) if math.isfinite(a) else a


FLOATS = {
    "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b, "div": divided, "fma": fused,
    "rcp": lambda a: divided(1.0, a), "sqrt": lambda a: math.sqrt(a) if a >= 0.0 else math.nan, "neg": lambda a: -a, "abs": abs,
    "max": lambda a, b: b if a != a or a < b else a, "min": lambda a, b: b if a != a or b < a else a,
    "copysign": lambda a, b: math.copysign(b, a), "cvt.rmi": whole(math.floor), "cvt.rni": whole(round),
}  # fmt: skip
INTEGERS = {
    "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul.lo": lambda a, b: a * b, "mad.lo": lambda a, b, c: a * b + c,
    "shl": lambda a, b: a << b, "shr": lambda a, b: a >> b, "or": lambda a, b: a | b, "and": lambda a, b: a & b, "mov": lambda a: a,
    "xor": lambda a, b: a ^ b, "not": lambda a: ~a, "cvta.to.global": lambda a: a, "cvt": lambda a: a,
}  # fmt: skip
COMPARED = {
    "lt": lambda a, b: a < b, "le": lambda a, b: a <= b, "gt": lambda a, b: a > b, "ge": lambda a, b: a >= b,
    "eq": lambda a, b: a == b, "ne": lambda a, b: a < b or a > b, "nan": lambda a, b: a != a or b != b,
    "num": lambda a, b: a == a and b == b, "neu": lambda a, b: a != b,
}  # fmt: skip
for _name in ("lt", "le", "gt", "ge"):
    COMPARED[f"{_name}u"] = lambda a, b, of=COMPARED[_name]: a != a or b != b or of(a, b)
COMPARED["equ"] = lambda a, b: a != a or b != b or a == b


class Machine:
    """A program, to be called with its parameters, a block, the width of blocks and a thread, which it takes through."""

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
                self.code.append((guard, op, [x.strip() for x in rest.split(",")] if rest else []))

    @np.errstate(all="ignore")
    def __call__(self, *values):
        *given, block, width, thread = values
        self.parameters = {f"[entry_param_{i}]": x & MASK for i, x in enumerate(given)}
        self.registers = {"%ctaid.x": block, "%ntid.x": width, "%tid.x": thread}
        at = 0
        while (instruction := self.code[at])[1] != "ret":
            guard, op, arguments = instruction
            at += 1
            if guard is None or self.registers[guard.lstrip("!")] != guard.startswith("!"):
                if op.split(".")[0] == "bra":
                    at = self.labels[arguments[0]]
                elif op == "brx.idx":
                    at = self.labels[self.tables[arguments[1]][self.registers[arguments[0]]]]
                else:
                    self.do(op, arguments)

    def value(self, x):
        """Of a register, or a number that stands there."""
        return self.registers[x] if x[0] == "%" else bits_of(x)

    def do(self, op, arguments):
        """One instruction that is no branch."""
        name, kind = op.rsplit(".", 1)
        target, *given = arguments
        if op.startswith("ld.param"):
            self.registers[target] = self.parameters[given[0]]
        elif op.startswith(("ld.global", "st.global")):
            place = given[0] if op[0] == "l" else target
            register, _, offset = place.strip("[]").partition("+")
            cell = {"b64": ctypes.c_uint64, "b32": ctypes.c_uint32}[kind].from_address(
                self.registers[register] + int(offset or 0)
            )
            if op[0] == "l":
                self.registers[target] = cell.value
            else:
                cell.value = self.value(given[0])
        elif name.startswith("setp"):
            how = name.split(".")[1]
            pair = [self.typed(x, kind) for x in given]
            self.registers[target] = COMPARED["neu" if how == "ne" and kind != "f64" else how](
                *pair
            )
        elif name == "selp":
            self.registers[target] = self.value(given[0] if self.registers[given[2]] else given[1])
        elif kind == "pred":
            pair = [self.registers[x] for x in given]
            self.registers[target] = {
                "and": all(pair),
                "or": any(pair),
                "not": not pair[0],
                "xor": pair[0] != pair[-1],
            }[name]
        elif kind == "f64":
            base = name.removesuffix(".f64").removesuffix(".rn")
            self.registers[target] = bits(FLOATS[base](*(real(self.value(x)) for x in given)))
        else:
            base = "cvt" if name.startswith("cvt.") else name
            size = int(kind[1:]) if base != "cvt" else 64
            self.registers[target] = INTEGERS[base](*(self.value(x) for x in given)) & (
                (1 << size) - 1
            )

    def typed(self, x, kind):
        """A value as what it is compared."""
        found = self.value(x)
        return (
            real(found)
            if kind == "f64"
            else signed(found, int(kind[1:]))
            if kind[0] == "s"
            else found
        )


def bits_of(x):
    """Of a number in the text: 0d and sixteen digits of a float, or an integer."""
    return int(x[2:], 16) if x.startswith("0d") else int(x) & MASK
