"""Derivatives of the operations on a tape by the chain rule in forward mode: exact, while
differences would lose half of the digits.

`along` and `at_zero` differentiate with respect to variables of a model, `with_slopes` a whole step
with respect to a parameter of its filter.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from math import log
from typing import Any

import numpy as np

from celnav.tape.kernel import Kernel
from celnav.tape.numbers import TracedArray, tape_of
from celnav.tape.routine import Loop
from celnav.tape.tape import Scalar, Tape, TracedScalar, emit, operands

Slopes = dict[int, Scalar]
"""Derivatives with respect to some variables, by index; all other derivatives are 0."""
Carried = tuple[Scalar, Slopes]
"""A value and its derivatives."""


def along(center: Any, roots: Sequence[Any]) -> list[Any]:
    """For each root ``(n, q)`` a point ``(1, n)``: the root times q new variables, which are 0 and
    with respect to which `at_zero` differentiates.
    """
    tape = tape_of(center, *roots)
    assert tape is not None
    tape.variables = [
        tape.node("var", len(tape.ops)) for _ in range(sum(E.shape[-1] for E in roots))
    ]
    unit, first, parts = np.array(tape.variables, object).view(TracedArray), 0, []
    for E in roots:
        parts.append((E @ unit[first : first + E.shape[-1]])[None])
        first += E.shape[-1]
    return parts


def at_zero(y: Any) -> tuple[TracedArray, TracedArray]:
    """Values ``(...)`` of numbers where the tape's last ``count`` variables are 0, and their
    derivatives ``(..., count)``.
    """
    first = next((x for x in y.flat if isinstance(x, TracedScalar)), None)
    count = len(first.tape.variables) if first is not None else 0
    value, slope = TracedArray(y.shape), TracedArray((*y.shape, count))
    if first is None:
        value[...] = y
        return value, slope
    # Variable k has value 0 and derivative 1 with respect to itself.
    duals: dict[int, Carried] = {x.i: (0.0, {k: 1.0}) for k, x in enumerate(first.tape.variables)}
    for at in np.ndindex(*y.shape):
        value[at], slopes = (
            _carried(y[at], duals) if isinstance(y[at], TracedScalar) else (y[at], {})
        )
        for k, x in slopes.items():
            slope[(*at, k)] = x
    return value, slope


def with_slopes(kernel: Kernel, seeds: Collection[int]) -> Kernel:
    """The step that also propagates the derivative of each number of its state with respect to one
    parameter; it stores no rows.

    Number ``i`` of the state is at ``2 i``, its derivative at ``2 i + 1``. seeds: indices of the
    numbers before the step whose derivatives may differ from 0.
    """
    tape, duals = kernel.tape, dict[int, Carried]()
    inputs = [(place, 2 * at if place == "state" else at) for place, at in kernel.inputs]
    for number, (place, at) in enumerate(kernel.inputs):
        if place == "state" and at in seeds:
            x = tape.node("in", number)
            duals[x.i] = x, {0: tape.input()}
            inputs.append(("state", 2 * at + 1))
    state = []
    for at, y in kernel.state:
        slopes = (
            _carried(y, duals, _SMOOTH)[1] if isinstance(y, TracedScalar) and not y.logical else {}
        )
        # A number that does not depend on a seed has derivative 0.
        state += [(2 * at, y), (2 * at + 1, slopes.get(0, 0.0))]
    return Kernel(tape, inputs, state, [])


def _carried(
    x: TracedScalar, duals: dict[int, Carried], partials: Mapping[str, Partials] | None = None
) -> Carried:
    """Value and derivatives of a number; ``duals``: values and derivatives of earlier numbers;
    ``partials``: partial derivatives of the operations, None: `_PARTIALS`.
    """
    # Without recursion: an operation remains on the stack until its operands are done.
    tape, stack = x.tape, [x.i]
    memory: dict[int, list[Carried] | None] = {}
    while stack:
        i = stack[-1]
        if i in duals or i in memory:
            stack.pop()
            continue
        op = tape.ops[i]
        missing = [a for a in operands(op) if a not in duals and a not in memory]
        if missing:
            stack += missing
            continue
        name, *arguments = op
        if name == "call":
            inputs = [duals[a] for a in arguments[1:]]
            same = all(
                _same(tape, a, value) for a, (value, _) in zip(arguments[1:], inputs, strict=True)
            )
            memory[i] = (
                None
                if same and not any(slopes for _, slopes in inputs)
                else _inside(arguments[0], inputs, partials or _PARTIALS)
            )
        elif name == "part":
            # None: the arguments of the call are unchanged and have no derivatives.
            cells = memory[arguments[0]]
            duals[i] = (TracedScalar(tape, i), {}) if cells is None else cells[arguments[1]]
        elif name in ("in", "const"):
            duals[i] = (TracedScalar(tape, i) if name == "in" else arguments[0], {})
        else:
            values, slopes = [duals[a][0] for a in arguments], [duals[a][1] for a in arguments]
            same = all(_same(tape, a, value) for a, value in zip(arguments, values, strict=True))
            # The operation is emitted with the flag `model` under which it was recorded.
            tape.model = tape.modeled[i]
            value = TracedScalar(tape, i) if same else emit(name, *values)
            tape.model = False
            duals[i] = (value, _chained(name, value, values, slopes, partials or _PARTIALS))
    return duals[x.i]


def _inside(
    routine: Loop, inputs: Sequence[Carried], partials: Mapping[str, Partials]
) -> list[Carried]:
    """Cells of a routine after its call, computed row by row."""
    cells: list[Any] = [*inputs, *[None] * (routine.cells - len(inputs))]
    for stage in routine.stages:
        # The loop is unrolled: each row is emitted once, on the cells left by the previous row.
        for row in range(stage.rows):
            at = {place: first + row * stride for place, (first, stride) in stage.places.items()}
            duals: list[Carried] = []
            for name, *arguments in stage.tape.ops:
                if name == "in":
                    place, index = stage.inputs[arguments[0]]
                    duals.append(cells[at[place] + index])
                elif name == "const":
                    duals.append((arguments[0], {}))
                else:
                    values, slopes = (
                        [duals[a][0] for a in arguments],
                        [duals[a][1] for a in arguments],
                    )
                    value = emit(name, *values)
                    duals.append((value, _chained(name, value, values, slopes, partials)))
            for place, index, x in stage.results:
                cells[at[place] + index] = duals[x.i]
    return cells


def _same(tape: Tape, i: int, value: Scalar) -> bool:
    return (isinstance(value, TracedScalar) and value.i == i) or tape.ops[i][0] == "const"


def _chained(
    name: str,
    value: Scalar,
    values: list[Scalar],
    slopes: list[Slopes],
    partials: Mapping[str, Partials],
) -> Slopes:
    """Derivatives of an operation: the sum of its partial derivatives times the operands'
    derivatives.
    """
    if name == "select":
        # The condition has no derivative.
        _, a, b = slopes
        return {
            k: emit("select", values[0], a.get(k, 0.0), b.get(k, 0.0))
            for k in sorted(a.keys() | b.keys())
        }
    # dv = sum over the operands x of (dv / dx) times the derivative of x.
    out: Slopes = {}
    for partial, slope in zip(partials.get(name, ()), slopes, strict=False):
        if slope:
            factor = partial(value, *values)
            for k, x in slope.items():
                out[k] = emit("add", out.get(k, 0.0), emit("mul", factor, x))
    return out


Partials = tuple[Callable[..., Scalar], ...]


def _square(x: Scalar) -> Scalar:
    return emit("mul", x, x)


_PARTIALS: dict[str, Partials] = {
    "add": (lambda *_: 1.0, lambda *_: 1.0),
    "sub": (lambda *_: 1.0, lambda *_: -1.0),
    "mul": (lambda _v, _a, b: b, lambda _v, a, _b: a),
    "div": (lambda _v, _a, b: emit("div", 1.0, b), lambda v, _a, b: emit("neg", emit("div", v, b))),
    "neg": (lambda *_: -1.0,),
    "abs": (lambda _v, a: emit("copysign", 1.0, a),),
    "copysign": (lambda _v, a, b: emit("mul", emit("copysign", 1.0, a), emit("copysign", 1.0, b)),),
    "sqrt": (lambda v, _a: emit("div", 0.5, v),),
    "hypot": (lambda v, a, _b: emit("div", a, v), lambda v, _a, b: emit("div", b, v)),
    "fmod": (lambda *_: 1.0, lambda v, a, b: emit("div", emit("sub", v, a), b)),
    "sin": (lambda _v, a: emit("cos", a),),
    "cos": (lambda _v, a: emit("neg", emit("sin", a)),),
    "tan": (lambda v, _a: emit("add", 1.0, _square(v)),),
    "asin": (lambda _v, a: emit("div", 1.0, emit("sqrt", emit("sub", 1.0, _square(a)))),),
    "acos": (lambda _v, a: emit("div", -1.0, emit("sqrt", emit("sub", 1.0, _square(a)))),),
    "atan": (lambda _v, a: emit("div", 1.0, emit("add", 1.0, _square(a))),),
    "atan2": (
        lambda _v, y, x: emit("div", x, emit("add", _square(x), _square(y))),
        lambda _v, y, x: emit("neg", emit("div", y, emit("add", _square(x), _square(y)))),
    ),
    "exp": (lambda v, _a: v,),
    "exp2": (lambda v, _a: emit("mul", log(2.0), v),),
    "expm1": (lambda v, _a: emit("add", v, 1.0),),
    "log": (lambda _v, a: emit("div", 1.0, a),),
    "log2": (lambda _v, a: emit("div", 1.0 / log(2.0), a),),
    "log10": (lambda _v, a: emit("div", 1.0 / log(10.0), a),),
    "log1p": (lambda _v, a: emit("div", 1.0, emit("add", 1.0, a)),),
    "sinh": (lambda _v, a: emit("cosh", a),),
    "cosh": (lambda _v, a: emit("sinh", a),),
    "tanh": (lambda v, _a: emit("sub", 1.0, _square(v)),),
    "cbrt": (lambda v, a: emit("div", v, emit("mul", 3.0, a)),),
    "pow": (
        lambda _v, a, b: emit("mul", b, emit("pow", a, emit("sub", b, 1.0))),
        lambda v, a, _b: emit("mul", v, emit("log", a)),
    ),
}
_SMOOTH = _PARTIALS | {
    "sqrt": (lambda v, _a: emit("select", emit("eq", v, 0.0), 0.0, emit("div", 0.5, v)),)
}
"""The square root has derivative 0 at 0, because a row of zeros in a singular
root keeps length 0.
"""
