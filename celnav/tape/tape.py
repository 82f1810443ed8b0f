"""A tape of operations, and `TracedScalar`, the result of an operation. Operations on known numbers
are computed immediately, and no operation is recorded twice.

Code that needs a value that is not known yet, an ``if`` or a ``float(x)``, raises `CannotCompile`,
which names the line.
"""

from __future__ import annotations

import linecache
import sys
from collections.abc import Callable, Container, Sequence
from functools import partial, reduce
from math import copysign, frexp, isfinite
from numbers import Real
from pathlib import Path
from sysconfig import get_paths
from typing import Any, Final

import numpy as np

Scalar = Any
"""A `TracedScalar`, or a float or bool whose value is known."""


class CannotCompile(ValueError):
    """A computation cannot be recorded as arithmetic; the message names the obstacle and the line.

    ``somewhere``: whether the line is unknown.
    """

    somewhere = False


class TooLong(CannotCompile):
    """A computation has too many operations to be worth compiling."""


def cannot_compile(message: str) -> CannotCompile:
    """The error, with the line of the model, or else of the package, that caused it.

    The tape stores the error, so that the recording fails even if the model catches it.
    """
    frame: Any = sys._getframe(1)
    lines = []
    # The recording function has the tape in its local variable of this name.
    while frame is not None and not isinstance(frame.f_locals.get("tape"), Tape):
        lines.append((frame.f_code.co_filename, frame.f_lineno))
        frame = frame.f_back
    place = place_of(lines)
    error = CannotCompile(f"{message}; engine='numpy' runs it as it is{place}")
    error.somewhere = not place
    if frame is not None:
        tape: Tape = frame.f_locals["tape"]
        tape.refusal = tape.refusal or error
    return error


def place_of(lines: Sequence[tuple[str, int]]) -> str:
    """The innermost line of the user's code, at which the recording failed."""
    paths = [(Path(name), number) for name, number in lines if not name.startswith("<")]
    package = Path(__file__).parents[1]
    user_lines = [at for at in paths if package not in at[0].parents and not _is_installed(at[0])]
    if not user_lines:
        return ""
    path, number = user_lines[0]
    line = linecache.getline(str(path), number).strip()
    return f" ({path.name}, line {number}: {line})" if line else f" ({path.name}, line {number})"


def _is_installed(path: Path) -> bool:
    return "site-packages" in path.parts or Path(get_paths()["stdlib"]) in path.parents


_FOLD: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "copysign": np.copysign,
    "floor": np.floor,
    "rint": np.rint,
    "pow2": np.exp2,
    "exponent": lambda x: np.frexp(x)[1] - 1.0,
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
    "fmod": np.fmod,
    "hypot": np.hypot,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "not": np.logical_not,
    "select": lambda c, a, b: a if c else b,
}
"""The operations as functions of known numbers; "pow2" is two to the power of an integer,
"exponent" the exponent of a normal number.
"""
MOST = 400_000  # most operations on a tape, whether needed for the results or not
LOGICAL: Final = frozenset(("lt", "le", "eq", "ne", "and", "or", "not"))
"""Operations whose results are truth values."""
_SHARP: Final = LOGICAL | {"floor", "rint", "fmod"}
"""Discontinuous operations: a difference of round-off may change the result to another integer."""
_WILD: Final = frozenset(
    (
        "div",
        "sqrt",
        "tan",
        "asin",
        "acos",
        "log",
        "log2",
        "log10",
        "log1p",
        "exp",
        "exp2",
        "expm1",
        "sinh",
        "cosh",
        "pow",
        "fmod",
    )
)
"""Operations whose result for moderate numbers may be nan or infinite."""
_OPERANDS: Final = {
    "in": slice(0),
    "const": slice(0),
    "var": slice(0),
    "call": slice(2, None),
    "part": slice(1, 2),
}
_ALL: Final = slice(1, None)


def operands(op: tuple[Any, ...]) -> tuple[int, ...]:
    """Indices of the operands of an operation."""
    return op[_OPERANDS.get(op[0], _ALL)]


class Tape:
    """Operations in the order in which they were first emitted, each once.

    ``ops[i]`` is ``(name, *arguments)``, with indices of earlier operations as arguments;
    ``("in", k)`` is the k-th input, ``("const", x)`` a number. ``("call", routine, *arguments)``
    fills the memory of a routine, and ``("part", i, cell)`` is a cell of this memory; ``rolled``:
    whether such calls are allowed. ``cells``: how many numbers the memory of the routines has.
    ``most``: the number of operations beyond which `TooLong` is raised.
    ``refusal``: the first error of `cannot_compile`. ``absent[i]``: whether the operation depends
    on an input that may be missing, nan. ``model``: whether the recorded code is the arithmetic of
    a model, which must have exactly numpy's values. For such code ``wild[i]`` is whether the result
    may be nan or infinite, and ``sharp`` has the numbers that decide a discontinuity, whose
    products and sums are rounded separately. ``modeled``: the operations of such code.
    """

    def __init__(self, rolled: bool = True, most: int = MOST) -> None:
        self.rolled, self.most = rolled, min(most, MOST)
        self.refusal: CannotCompile | None = None
        self.ops: list[tuple[Any, ...]] = []
        self.absent: list[bool] = []
        self.model, self.wild = False, list[bool]()
        self.sharp, self.modeled = set[int](), list[bool]()
        self.variables: list[TracedScalar] = []  # see `celnav.tape.derivative`
        self._positions: dict[Any, int] = {}
        self._inputs = self.cells = 0

    @property
    def key(self) -> tuple[Any, ...]:
        """A key, equal for tapes with the same operations."""
        return *self._positions, *sorted(self.sharp)

    def input(self, absent: bool = False) -> TracedScalar:
        """A new input with the next index; ``absent``: whether it may be nan for a missing
        measurement.
        """
        self._inputs += 1
        number = self.node("in", self._inputs - 1)
        self.absent[number.i] = self.wild[number.i] = absent
        return number

    def node(self, *op: Any) -> TracedScalar:
        """The result of an operation, which is recorded unless it is on the tape already."""
        # As keys, hexadecimal digits distinguish 0.0 from -0.0, and make nan equal to nan.
        key = (op[0], op[1].hex()) if op[0] == "const" else op
        at = self._positions.get(key)
        if at is None:
            at = self._positions[key] = len(self.ops)
            if at == self.most:
                raise TooLong(f"a step of more than {at} operations is too long to be compiled")
            self.ops.append(op)
            self.cells += op[1].cells if op[0] == "call" else 0
            if op[0] == "const":
                self.absent.append(op[1] != op[1])
                self.wild.append(not isfinite(op[1]))
            else:
                # absent and wild propagate from the operands.
                absent, wild, needs = False, self.model and op[0] in _WILD, operands(op)
                for a in needs:
                    absent = absent or self.absent[a]
                    wild = wild or (self.model and self.wild[a])
                self.absent.append(absent)
                self.wild.append(wild)
                if self.model and op[0] in _SHARP:
                    self._sharpen(needs)
            self.modeled.append(self.model)
        return TracedScalar(self, at)

    def _sharpen(self, indices: Sequence[int]) -> None:
        """Mark the numbers on which a discontinuity in a model depends."""
        stack = list(indices)
        while stack:
            i = stack.pop()
            if self.modeled[i] and i not in self.sharp:
                self.sharp.add(i)
                stack += operands(self.ops[i])

    def lift(self, x: Scalar) -> TracedScalar:
        """A number as a number on this tape; a known number becomes a constant."""
        if type(x) is not TracedScalar:
            return self.node("const", float(x))
        if x.tape is not self:
            raise cannot_compile(
                "a number of another recording: the model stored an argument of an earlier call"
            )
        return x

    def needed(self, outputs: Sequence[TracedScalar], provided: Container[int] = ()) -> list[int]:
        """Operations on which the outputs depend, each as late as possible, so that few numbers
        occupy registers.

        provided: operations whose results are known, so that their operands are not needed.
        """
        # Depth-first search; ~i marks an operation whose operands have been visited.
        visited, order = set[int](), list[int]()
        stack = [x.i for x in reversed(outputs)]
        while stack:
            i = stack.pop()
            if i < 0:
                order.append(~i)
            elif i not in visited:
                visited.add(i)
                stack.append(~i)
                if i not in provided:
                    stack += reversed(operands(self.ops[i]))
        return order


def emit(name: str, *arguments: Scalar) -> Scalar:
    """The result of an operation, computed immediately if the arguments are known."""
    for x in arguments:
        if type(x) is TracedScalar:
            recording = x.tape
            break
    else:
        # All arguments are known: compute with numpy.
        with np.errstate(all="ignore"):
            value = _FOLD[name](*arguments)
        return value.item() if isinstance(value, np.generic) else value
    # Arithmetic treats truth values as 1 and 0.
    if name not in ("and", "or", "not", "select"):
        arguments = tuple(map(as_number, arguments))
    short = _SHORT.get(name)
    if short is not None and (shortcut := short(*arguments)) is not None:
        return shortcut
    if name == "select":
        arguments = (arguments[0], *map(as_number, arguments[1:]))
    at = [recording.lift(x).i for x in arguments]
    # Operands of commutative operations are ordered, so that each operation is recorded once.
    if name in ("add", "mul", "and", "or") and at[0] > at[1]:
        at.reverse()
    return recording.node(name, *at)


def is_known(x: Scalar, value: float) -> bool:
    """Whether a number is known and equals this value."""
    return type(x) is not TracedScalar and x == value


def _is_zero(x: Scalar, beside: Scalar) -> bool:
    """Whether a number is a known zero without effect on a sum. (In a model +0.0 changes -0.0 to
    0.0.)
    """
    return is_known(x, 0.0) and not (beside.tape.model and copysign(1.0, x) > 0.0)


def _add(a: Scalar, b: Scalar) -> Scalar | None:
    if type(a) is not TracedScalar:
        a, b = b, a
    if type(b) is not TracedScalar:
        return a if _is_zero(b, a) else None
    # a + (-b) = a - b
    if a.name == "neg":
        a, b = b, a
    return emit("sub", a, b._argument(0)) if type(b) is TracedScalar and b.name == "neg" else None


def _sub(a: Scalar, b: Scalar) -> Scalar | None:
    if type(b) is not TracedScalar:
        return a if _is_zero(-float(b), a) else None
    # 0 - b = -b, except for the sign of a zero, which counts in a model.
    if is_known(a, 0.0) and not b.tape.model:
        return emit("neg", b)
    return emit("add", a, b._argument(0)) if type(b) is TracedScalar and b.name == "neg" else None


def _mul(a: Scalar, b: Scalar) -> Scalar | None:
    if type(a) is not TracedScalar:
        a, b = b, a
    if type(b) is not TracedScalar:
        # A structural zero: 0 times a number is 0 here, because the filter detects numbers that are
        # not finite elsewhere.
        if b == 0.0:
            return None if a.tape.model and a.tape.wild[a.i] else 0.0
        return a if b == 1.0 else emit("neg", a) if b == -1.0 else None
    return None


def _div(a: Scalar, b: Scalar) -> Scalar | None:
    if type(b) is not TracedScalar:  # the reciprocal of a power of 2 is exact
        exact = abs(frexp(b)[0]) == 0.5 and abs(b) > 1e-300
        return emit("mul", a, 1.0 / b) if exact else None
    return 0.0 if is_known(a, 0.0) and not b.tape.model else None


def _select(c: Scalar, a: Scalar, b: Scalar) -> Scalar | None:
    if type(c) is not TracedScalar:
        return a if c else b
    same = type(a) is type(b) is TracedScalar and a.i == b.i
    # For truth values: (c and a) or (not c and b).
    if is_logical(a) and is_logical(b):
        return emit("or", emit("and", c, a), emit("and", emit("not", c), b))
    return a if same else None


def _logical_shortcut(neutral: bool) -> Callable[[Scalar, Scalar], Scalar | None]:
    """The simplification of "and" or "or"; ``neutral``: the operand without effect."""

    def short(a: Scalar, b: Scalar) -> Scalar | None:
        for x, y in ((a, b), (b, a)):
            if type(x) is not TracedScalar:
                return y if bool(x) is neutral else not neutral
        return a if a.i == b.i else None

    return short


def _cancelling(name: str) -> Callable[[Scalar], Scalar | None]:
    return lambda x: x._argument(0) if x.name == name else None


_SHORT: dict[str, Callable[..., Scalar | None]] = {
    "add": _add,
    "sub": _sub,
    "mul": _mul,
    "div": _div,
    "select": _select,
    "and": _logical_shortcut(True),
    "or": _logical_shortcut(False),
    "neg": _cancelling("neg"),
    "not": _cancelling("not"),
}


def is_logical(x: Scalar) -> bool:
    """Whether a number is a truth value."""
    return x.logical if type(x) is TracedScalar else type(x) is bool or type(x) is np.bool_


def as_number(x: Scalar) -> Scalar:
    """A truth value as 1 or 0; any other number unchanged."""
    if type(x) is TracedScalar:
        return emit("select", x, 1.0, 0.0) if x.logical else x
    return float(x) if is_logical(x) else x


def total(terms: Any) -> Scalar:
    """The sum, in order, of the numbers that are not known zeros."""
    parts = [x for x in terms if not is_known(x, 0.0)]
    return reduce(partial(emit, "add"), parts) if parts else 0.0


class TracedScalar:
    """A number whose value is known only when the tape runs."""

    __slots__ = ("i", "tape")

    def __init__(self, tape: Tape, i: int):
        self.tape, self.i = tape, i

    @property
    def name(self) -> str:
        """The name of the operation with this result."""
        return str(self.tape.ops[self.i][0])

    @property
    def logical(self) -> bool:
        """Whether it is a truth value."""
        return self.name in LOGICAL

    def _argument(self, k: int) -> TracedScalar:
        return TracedScalar(self.tape, self.tape.ops[self.i][1 + k])

    def any(self, *_arguments: Any, **_options: Any) -> TracedScalar:
        """Whether the number is not 0, as for an array with one element; `all` is the same."""
        return self if self.logical else emit("ne", self, 0.0)

    def __copy__(self, _memory: Any = None) -> TracedScalar:
        return self

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise cannot_compile(f"a number that is known only when the filter runs has no {name}")

    all, __deepcopy__ = any, __copy__
    shape, ndim, dtype = (), 0, np.dtype(object)


def _refusing(message: str) -> Callable[..., Any]:
    def method(*_arguments: Any) -> Any:
        raise cannot_compile(message)

    return method


_LATER = "a number that is known only when the filter runs is"
for _names, _what in (
    (
        "bool",
        "a branch depends on a number that is known only when the filter runs; numpy.where "
        "chooses without one",
    ),
    (
        "float complex",
        f"{_LATER} asked for as a float; numpy's functions take it as it is, and "
        "numpy.stack or numpy.empty_like(x) makes an array of such numbers",
    ),
    (
        "int index",
        f"{_LATER} asked for as an index or a whole number; put the table into u, or "
        "choose by numpy.where",
    ),
    (
        "hash",
        f"{_LATER} looked up in a dict, a set or a cache; put the table into u, or choose by "
        "numpy.where",
    ),
    ("str repr format reduce_ex", f"{_LATER} written as text or bytes"),
):
    for _name in _names.split():
        setattr(TracedScalar, f"__{_name}__", _refusing(_what))
Real.register(TracedScalar)
