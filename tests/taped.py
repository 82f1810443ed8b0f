"""Evaluation of a tape in floats."""

from __future__ import annotations

import numpy as np

from celnav.tape.numbers import TracedArray
from celnav.tape.tape import Tape, TracedScalar

FUNCTIONS = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "copysign": np.copysign,
    "floor": np.floor,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "exp": np.exp,
    "log": np.log,
    "pow": np.power,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "exp2": np.exp2,
    "log2": np.log2,
    "log10": np.log10,
    "log1p": np.log1p,
    "expm1": np.expm1,
    "cbrt": np.cbrt,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "not": np.logical_not,
    "select": np.where,
    "fmod": np.fmod,
    "hypot": np.hypot,
    "rint": np.rint,
    "pow2": np.exp2,
    "exponent": lambda x: np.frexp(x)[1] - 1.0,
}


def inputs(tape, *shapes, absent=True):
    """An array of inputs for each shape."""
    found = []
    for shape in shapes:
        x = TracedArray(shape)
        for at in np.ndindex(*shape):
            x[at] = tape.input(absent)
        found.append(x)
    return found


def values(tape, given, y):
    """An array of numbers as floats, if the tape's inputs have the values ``given``."""
    known = []
    for name, *arguments in tape.ops:
        if name == "in":
            known.append(np.float64(given[arguments[0]]))
        elif name == "const":
            known.append(np.float64(arguments[0]))
        elif name == "var":  # of a loop over rows, which has its own tape
            known.append(np.nan)
        elif name == "call":
            known.append(_left(arguments[0], [known[a] for a in arguments[1:]]))
        elif name == "part":
            known.append(known[arguments[0]][arguments[1]])
        else:
            known.append(FUNCTIONS[name](*(known[a] for a in arguments)))
    array = np.asarray(y, object)
    return np.array(
        [float(known[x.i]) if isinstance(x, TracedScalar) else float(x) for x in array.flat]
    ).reshape(array.shape)


def _left(routine, given):
    """The memory of a routine after its call."""
    cells = np.full(routine.cells, np.nan)
    cells[: len(given)] = given
    for stage in routine.stages:
        for row in range(stage.rows):
            at = [
                stage.places[place][0] + row * stage.places[place][1] + index
                for place, index in stage.inputs
            ]
            found = values(stage.tape, cells[at], [x for *_, x in stage.results])
            for (place, index, _), x in zip(stage.results, found, strict=True):
                cells[stage.places[place][0] + row * stage.places[place][1] + index] = x
    return cells


def recorded(function, *arrays):
    """The result of a function of arrays that is recorded on `TracedArray` and then evaluated."""
    tape = Tape()
    y = function(*inputs(tape, *map(np.shape, arrays)))
    with np.errstate(all="ignore"):
        return values(tape, np.concatenate([np.ravel(x) for x in arrays]), y)
