"""A tape of operations, and the `Number` that one of them gives: what is known is computed at once, nothing is done twice.

What asks for a value that does not exist yet, an ``if`` or a ``float(x)``, raises `CannotCompile`, which names the line.
"""

from __future__ import annotations

import linecache
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

__all__ = [
    "LOGICAL", "MOST", "CannotCompile", "Number", "Scalar", "Tape", "as_number", "do", "is_known", "operands", "refused", "total",
]  # fmt: skip

Scalar = Any
"""A `Number`, or a float or bool that is known already."""


class CannotCompile(ValueError):
    """A computation is not arithmetic on numbers; the message says what it asked for, and on which line."""


def refused(what: str) -> CannotCompile:
    """The error, with the line of the model, or else of the package, that led to it."""
    frame: Any = sys._getframe(1)
    inside, place = Path(__file__).parents[1], ""
    while frame is not None and not isinstance(
        frame.f_locals.get("tape"), Tape
    ):  # below who records
        path = Path(frame.f_code.co_filename)
        if path.parent != Path(__file__).parent and "numpy" not in path.parts:
            line = linecache.getline(str(path), frame.f_lineno).strip()
            said = (
                f" ({path.name}, line {frame.f_lineno}: {line})"
                if line
                else f" ({path.name}, line {frame.f_lineno})"
            )
            place = place or said
            if inside not in path.parents:
                place = said
                break
        frame = frame.f_back
    return CannotCompile(f"{what}{place}")


_FOLD: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative, "abs": np.abs, "sqrt": np.sqrt,
    "copysign": np.copysign, "floor": np.floor, "rint": np.rint, "pow2": np.exp2, "exponent": lambda x: np.frexp(x)[1] - 1.0,
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2,
    "exp": np.exp, "log": np.log, "pow": np.power, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "exp2": np.exp2,
    "log2": np.log2, "log10": np.log10, "log1p": np.log1p, "expm1": np.expm1, "cbrt": np.cbrt,
    "lt": np.less, "le": np.less_equal, "eq": np.equal, "ne": np.not_equal, "and": np.logical_and, "or": np.logical_or,
    "not": np.logical_not, "select": lambda c, a, b: a if c else b,
}  # fmt: skip
"""What operations do to numbers that are known; "pow2" is two to a whole number, "exponent" the one of a normal number."""
MOST = 400_000  # operations on a tape, those that are not needed in the end included
LOGICAL: Final = frozenset(("lt", "le", "eq", "ne", "and", "or", "not"))
"""Operations whose results are true or false."""
_OPERANDS: Final = {
    "in": slice(0),
    "const": slice(0),
    "var": slice(0),
    "call": slice(2, None),
    "part": slice(1, 2),
}


def operands(op: tuple[Any, ...]) -> tuple[int, ...]:
    """Indices of the earlier operations that one needs."""
    return op[_OPERANDS.get(op[0], slice(1, None))]


class Tape:
    """Operations in the order in which they were first done, each once.

    ``ops[i]`` is ``(name, *arguments)``: indices of earlier ones; ``("in", k)`` is the k-th input, ``("const", x)`` a number.
    ``("call", routine, *arguments)`` leaves a memory, ``("part", i, cell)`` is a cell of it; ``rolled``: whether there may be such.
    ``absent[i]``: whether it comes of something that may be missing, nan; of other numbers ``x == x`` is true.
    """

    def __init__(self, rolled: bool = True) -> None:
        self.rolled = rolled
        self.ops: list[tuple[Any, ...]] = []
        self.absent: list[bool] = []
        self.variables: list[Number] = []  # see `celnav.tape.derivative`
        self._known: dict[Any, int] = {}
        self._inputs = 0

    @property
    def key(self) -> tuple[Any, ...]:
        """The same for tapes of the same operations."""
        return tuple(self._known)

    def input(self, absent: bool = False) -> Number:
        """A new input, the next in number; ``absent``: it may be nan where something is missing."""
        self._inputs += 1
        found = self.node("in", self._inputs - 1)
        self.absent[found.i] = absent
        return found

    def node(self, *op: Any) -> Number:
        """The number that an operation gives."""
        key = (op[0], op[1].hex()) if op[0] == "const" else op
        at = self._known.get(key)
        if at is None:
            at = self._known[key] = len(self.ops)
            if at == MOST:
                raise CannotCompile(
                    f"a step of more than {MOST} operations is too long to be compiled"
                )
            self.ops.append(op)
            self.absent.append(
                op[1] != op[1] if op[0] == "const" else any(self.absent[a] for a in operands(op))
            )
        return Number(self, at)

    def lift(self, x: Scalar) -> Number:
        """A number on the tape, of one that is known."""
        return x if type(x) is Number else self.node("const", float(x))

    def needed(self, outputs: Sequence[Number]) -> list[int]:
        """Operations that the outputs depend on, each as late as it can be: few numbers then wait in registers."""
        seen, order = set[int](), list[int]()
        stack = [(x.i, False) for x in reversed(outputs)]
        while stack:
            i, ready = stack.pop()
            if ready:
                order.append(i)
            elif i not in seen:
                seen.add(i)
                stack.append((i, True))
                stack += [(a, False) for a in reversed(operands(self.ops[i]))]
        return order


def do(name: str, *arguments: Scalar) -> Scalar:
    """The result of an operation, done at once where the arguments are known."""
    tape = next((x.tape for x in arguments if type(x) is Number), None)
    if tape is None:
        with np.errstate(all="ignore"):
            return _FOLD[name](*arguments)
    short = _SHORT.get(name)
    if short is not None and (found := short(*arguments)) is not None:
        return found
    if name not in ("and", "or", "not"):
        start = 1 if name == "select" else 0
        arguments = (*arguments[:start], *(as_number(x) for x in arguments[start:]))
    at = [tape.lift(x).i for x in arguments]
    if name in ("add", "mul", "and", "or") and at[0] > at[1]:
        at.reverse()
    return tape.node(name, *at)


def is_known(x: Scalar, value: float) -> bool:
    """Whether a number is known, and this one."""
    return type(x) is not Number and x == value


def _add(a: Scalar, b: Scalar) -> Scalar | None:
    if is_known(a, 0.0):
        return b
    if is_known(b, 0.0):
        return a
    return do("sub", a, b._argument(0)) if type(b) is Number and b.name == "neg" else None


def _sub(a: Scalar, b: Scalar) -> Scalar | None:
    if is_known(b, 0.0):
        return a
    if is_known(a, 0.0):
        return do("neg", b)
    return do("add", a, b._argument(0)) if type(b) is Number and b.name == "neg" else None


def _mul(a: Scalar, b: Scalar) -> Scalar | None:
    if type(a) is not Number:
        a, b = b, a
    if type(b) is not Number:
        # A structural zero: what is not finite shows elsewhere.
        return 0.0 if b == 0.0 else a if b == 1.0 else do("neg", a) if b == -1.0 else None
    return None


def _div(a: Scalar, b: Scalar) -> Scalar | None:
    if type(b) is not Number and b != 0.0:
        return do("mul", a, float(1.0 / b))
    return 0.0 if is_known(a, 0.0) else None


def _select(c: Scalar, a: Scalar, b: Scalar) -> Scalar | None:
    if type(c) is not Number:
        return a if c else b
    same = type(a) is type(b) is Number and a.i == b.i
    if (type(a) is bool or getattr(a, "logical", False)) and (
        type(b) is bool or getattr(b, "logical", False)
    ):
        return do("or", do("and", c, a), do("and", do("not", c), b))
    return a if same else None


def _joined(neutral: bool) -> Callable[[Scalar, Scalar], Scalar | None]:
    """ "and" or "or", by the truth value that changes nothing in it."""

    def short(a: Scalar, b: Scalar) -> Scalar | None:
        for x, y in ((a, b), (b, a)):
            if type(x) is not Number:
                return y if bool(x) is neutral else not neutral
        return a if a.i == b.i else None

    return short


def _alike(alike: bool) -> Callable[[Scalar, Scalar], Scalar | None]:
    def short(a: Scalar, b: Scalar) -> Scalar | None:
        same = type(a) is type(b) is Number and a.i == b.i and not a.tape.absent[a.i]
        return alike if same else None

    return short


def _undone(name: str) -> Callable[[Scalar], Scalar | None]:
    return lambda x: x._argument(0) if x.name == name else None


_SHORT: dict[str, Callable[..., Scalar | None]] = {
    "add": _add, "sub": _sub, "mul": _mul, "div": _div, "select": _select, "and": _joined(True), "or": _joined(False),
    "eq": _alike(True), "ne": _alike(False), "neg": _undone("neg"), "not": _undone("not"),
}  # fmt: skip


def as_number(x: Scalar) -> Scalar:
    """What is true or false as 1 or 0."""
    if isinstance(x, bool | np.bool_):
        return float(x)
    return do("select", x, 1.0, 0.0) if getattr(x, "logical", False) else x


def total(terms: Any) -> Scalar:
    """Sum of numbers, in their order."""
    out: Scalar = 0.0
    for term in terms:
        out = do("add", out, term)
    return out


class Number:
    """A number that is known only when the tape is run."""

    __slots__ = ("i", "tape")

    def __init__(self, tape: Tape, i: int):
        self.tape, self.i = tape, i

    @property
    def name(self) -> str:
        """Of the operation that gives it."""
        return str(self.tape.ops[self.i][0])

    @property
    def logical(self) -> bool:
        """Whether it is true or false."""
        return self.name in LOGICAL

    def _argument(self, k: int) -> Number:
        return Number(self.tape, self.tape.ops[self.i][1 + k])

    def __repr__(self) -> str:
        return f"Number({self.name} {self.i})"

    def __bool__(self) -> bool:
        raise refused(
            "a branch depends on a number that is known only when the filter runs; numpy.where chooses without one"
        )

    def __float__(self) -> float:
        raise refused(
            "a number that is known only when the filter runs is asked for as a float; numpy's functions take it as it is"
        )

    __int__ = __index__ = __float__
    __hash__ = object.__hash__

    def any(self, *_arguments: Any, **_options: Any) -> Number:
        """Itself, as that of an array of one; `all` is the same."""
        return self

    all = conjugate = any
    shape, ndim, dtype = (), 0, np.dtype(object)
