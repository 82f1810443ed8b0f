"""A tape as C: one C99 function without loops, branches or static memory, which needs only
``math.h``.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from celnav.tape.kernel import Kernel
from celnav.tape.tape import LOGICAL, Tape

_INFIX = {
    "add": "+",
    "sub": "-",
    "mul": "*",
    "div": "/",
    "lt": "<",
    "le": "<=",
    "eq": "==",
    "ne": "!=",
    "and": "&&",
    "or": "||",
}


def function(kernel: Kernel, name: str, places: dict[str, str], comment: Sequence[str]) -> str:
    """The C function of a kernel; ``places``: the argument name for each place, also "rows"."""
    tape, results = kernel.tape, kernel.results()
    lines = [f"/* {comment[0]}", *(f" * {line}" for line in comment[1:]), " */"] if comment else []
    lines += [f"void {name}({arguments(places)})", "{"]
    lines += [f"    (void){argument};" for argument in places.values()]
    # One const variable for each operation; operands come before the operations that use them.
    for i in tape.needed([x for *_, x in results]):
        op, *at = tape.ops[i]
        if op == "in":
            place, index = kernel.inputs[at[0]]
            lines.append(f"    const double t{i} = {places[place]}[{index}];")
        elif op != "const":
            lines.append(
                f"    const {'int' if op in LOGICAL else 'double'} t{i} = "
                f"{_expression(tape, op, at)};"
            )
    lines += [f"    {places[place]}[{index}] = {_value(tape, x.i)};" for place, index, x in results]
    return "\n".join([*lines, "}", ""])


def arguments(places: dict[str, str]) -> str:
    """The arguments of the function; const if they are only read."""
    return ", ".join(
        f"{'' if place in ('state', 'rows') else 'const '}double *{name}"
        for place, name in places.items()
    )


def _value(tape: Tape, i: int) -> str:
    """The name of a number, or its exact value in hexadecimal digits."""
    op, *at = tape.ops[i]
    if op != "const":
        return f"t{i}"
    x = at[0]
    # C has no literal of nan or infinity; a negative number needs parentheses after a minus.
    return (
        "NAN"
        if x != x
        else ("-" if x < 0.0 else "") + "INFINITY"
        if abs(x) == inf
        else f"({x.hex()})"
        if x < 0.0
        else x.hex()
    )


def _expression(tape: Tape, op: str, at: Sequence[int]) -> str:
    value = [_value(tape, i) for i in at]
    if op in _INFIX:
        return f"{value[0]} {_INFIX[op]} {value[1]}"
    if op == "select":
        return f"{value[0]} ? {value[1]} : {value[2]}"
    if op in ("neg", "not"):
        return ("-" if op == "neg" else "!") + value[0]
    return f"{'fabs' if op == 'abs' else op}({', '.join(value)})"
