"""Numbers that remember how they came about: run numpy code on them once, and its arithmetic is on a `Tape`.

`Tape.inputs` gives arrays of such numbers. numpy's functions work on them as they do on floats: products of matrices, sums, sines,
comparisons, choices with ``np.where``. What asks for a value that does not exist yet, an ``if`` or a ``float(x)``, raises
`CannotCompile`, which names the line.
"""

from __future__ import annotations

import linecache
import sys
from collections.abc import Callable, Sequence
from functools import reduce
from pathlib import Path
from typing import Any, Final

import numpy as np

Scalar = Any
"""A `Number`, or a float or bool that is known already."""


class CannotCompile(ValueError):
    """A computation is not arithmetic on numbers; the message says what it asked for, and on which line."""


def refused(what: str) -> CannotCompile:
    """The error, with the line of the model, or else of the package, that led to it."""
    frame: Any = sys._getframe(1)
    inside, place = Path(__file__).parents[1], ""
    while frame is not None and not isinstance(frame.f_locals.get("tape"), Tape):  # below who records
        path = Path(frame.f_code.co_filename)
        if path.parent != Path(__file__).parent and "numpy" not in path.parts:
            line = linecache.getline(str(path), frame.f_lineno).strip()
            said = f" ({path.name}, line {frame.f_lineno}: {line})" if line else f" ({path.name}, line {frame.f_lineno})"
            place = place or said
            if inside not in path.parents:
                place = said
                break
        frame = frame.f_back
    return CannotCompile(f"{what}{place}")


_FOLD: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative, "abs": np.abs, "sqrt": np.sqrt,
    "copysign": np.copysign, "floor": np.floor, "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos,
    "atan": np.arctan, "atan2": np.arctan2, "exp": np.exp, "log": np.log, "pow": np.power, "sinh": np.sinh, "cosh": np.cosh,
    "tanh": np.tanh, "exp2": np.exp2, "log2": np.log2, "log10": np.log10, "log1p": np.log1p, "expm1": np.expm1, "cbrt": np.cbrt,
    "lt": np.less, "le": np.less_equal, "eq": np.equal, "ne": np.not_equal, "and": np.logical_and, "or": np.logical_or,
    "not": np.logical_not, "select": lambda c, a, b: a if c else b,
}  # fmt: skip
MOST = 300_000  # operations on a tape
LOGICAL: Final = frozenset(("lt", "le", "eq", "ne", "and", "or", "not"))
"""Operations whose results are true or false."""


class Tape:
    """Operations in the order in which they were first done, each once.

    ``ops[i]`` is ``(name, *arguments)``: indices of earlier ones; ``("in", k)`` is the k-th input, ``("const", x)`` a number.
    ``absent[i]``: whether it comes of something that may be missing, nan; of other numbers ``x == x`` is true.
    """

    def __init__(self) -> None:
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

    def inputs(self, *shape: int) -> Numbers:
        """An array of new inputs."""
        out = Numbers(shape)
        for at in np.ndindex(*shape):
            out[at] = self.input()
        return out

    def node(self, *op: Any) -> Number:
        """The number that an operation gives."""
        key = (op[0], op[1].hex()) if op[0] == "const" else op
        at = self._known.get(key)
        if at is None:
            at = self._known[key] = len(self.ops)
            if at == MOST:
                raise CannotCompile(f"a step of more than {MOST} operations takes longer to compile than it saves")
            self.ops.append(op)
            self.absent.append(op[1] != op[1] if op[0] == "const" else op[0] not in ("in", "var") and any(self.absent[a] for a in op[1:]))
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
                if self.ops[i][0] not in ("in", "const"):
                    stack += [(a, False) for a in reversed(self.ops[i][1:])]
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


def _is(x: Scalar, value: float) -> bool:
    return type(x) is not Number and x == value


def _add(a: Scalar, b: Scalar) -> Scalar | None:
    if _is(a, 0.0):
        return b
    if _is(b, 0.0):
        return a
    return do("sub", a, b._argument(0)) if type(b) is Number and b.name == "neg" else None


def _sub(a: Scalar, b: Scalar) -> Scalar | None:
    if _is(b, 0.0):
        return a
    if _is(a, 0.0):
        return do("neg", b)
    return do("add", a, b._argument(0)) if type(b) is Number and b.name == "neg" else None


def _mul(a: Scalar, b: Scalar) -> Scalar | None:
    if type(a) is not Number:
        a, b = b, a
    if type(b) is not Number:
        # A structural zero: what is not finite shows elsewhere.
        return 0.0 if b == 0.0 else a if b == 1.0 else do("neg", a) if b == -1.0 else None
    for x, y in ((a, b), (b, a)):
        if x.logical:
            return do("select", x, y, 0.0)
    return None


def _div(a: Scalar, b: Scalar) -> Scalar | None:
    if type(b) is not Number and b != 0.0:
        return do("mul", a, float(1.0 / b))
    return 0.0 if _is(a, 0.0) else None


def _select(c: Scalar, a: Scalar, b: Scalar) -> Scalar | None:
    if type(c) is not Number:
        return a if c else b
    same = type(a) is type(b) is Number and a.i == b.i
    if (type(a) is bool or getattr(a, "logical", False)) and (type(b) is bool or getattr(b, "logical", False)):
        return do("or", do("and", c, a), do("and", do("not", c), b))
    return a if same else None


def _and(a: Scalar, b: Scalar) -> Scalar | None:
    if type(a) is not Number:
        return b if a else False
    if type(b) is not Number:
        return a if b else False
    return a if a.i == b.i else None


def _or(a: Scalar, b: Scalar) -> Scalar | None:
    if type(a) is not Number:
        return True if a else b
    if type(b) is not Number:
        return True if b else a
    return a if a.i == b.i else None


def _alike(alike: bool) -> Callable[[Scalar, Scalar], Scalar | None]:
    def short(a: Scalar, b: Scalar) -> Scalar | None:
        same = type(a) is type(b) is Number and a.i == b.i and not a.tape.absent[a.i]
        return alike if same else None

    return short


def _undone(name: str) -> Callable[[Scalar], Scalar | None]:
    return lambda x: x._argument(0) if x.name == name else None


_SHORT: dict[str, Callable[..., Scalar | None]] = {
    "add": _add, "sub": _sub, "mul": _mul, "div": _div, "select": _select, "and": _and, "or": _or, "eq": _alike(True),
    "ne": _alike(False),
    "neg": _undone("neg"), "not": _undone("not"),
}  # fmt: skip


def as_number(x: Scalar) -> Scalar:
    """What is true or false as 1 or 0."""
    if isinstance(x, bool | np.bool_):
        return float(x)
    return do("select", x, 1.0, 0.0) if getattr(x, "logical", False) else x


# -- what numpy's functions are made of -----------------------------------------------------------------------------------
def _maximum(a: Scalar, b: Scalar) -> Scalar:
    """The larger one, nan if one of them is."""
    if type(a) is not Number:
        a, b = b, a
    if type(b) is not Number and b == b:
        return do("select", do("lt", a, b), b, a)
    return do("select", do("lt", a, b), b, do("select", do("ne", b, b), b, a))


def _minimum(a: Scalar, b: Scalar) -> Scalar:
    return do("neg", _maximum(do("neg", a), do("neg", b)))


def _fmax(a: Scalar, b: Scalar) -> Scalar:
    """The larger one, or the one that is not nan."""
    return do("select", do("or", do("le", b, a), do("ne", b, b)), a, b)


def _power(x: Scalar, y: Scalar) -> Scalar:
    if type(y) is Number or type(x) is not Number:
        return do("pow", x, y)
    half = 2.0 * float(y)
    if half != int(half) or abs(half) > 16:
        return do("pow", x, y)
    out: Scalar = do("sqrt", x) if int(half) % 2 else 1.0
    for _ in range(int(abs(half)) // 2):
        out = do("mul", out, x)
    return do("div", 1.0, out) if half < 0 else out


def _remainder(x: Scalar, y: Scalar) -> Scalar:
    """Python's ``x % y``, of the sign of y, within round-off of x."""
    left = do("sub", x, do("mul", do("floor", do("div", x, y)), y))
    left = do("select", do("lt", do("mul", left, do("copysign", 1.0, y)), 0.0), do("add", left, y), left)
    return do("select", do("le", do("abs", y), do("abs", left)), do("sub", left, y), left)


def _finite(x: Scalar) -> Scalar:
    left = do("sub", x, x)
    return do("eq", left, 0.0)


def _logical(x: Scalar) -> Scalar:
    return x if type(x) is bool or getattr(x, "logical", False) else do("ne", x, 0.0)


def _op(name: str) -> Callable[..., Scalar]:
    return lambda *arguments: do(name, *arguments)


_UFUNCS: dict[Any, Callable[..., Scalar]] = {
    np.add: _op("add"), np.subtract: _op("sub"), np.multiply: _op("mul"), np.divide: _op("div"), np.negative: _op("neg"),
    np.absolute: _op("abs"), np.fabs: _op("abs"), np.sqrt: _op("sqrt"), np.copysign: _op("copysign"), np.floor: _op("floor"),
    np.sin: _op("sin"), np.cos: _op("cos"), np.tan: _op("tan"), np.arcsin: _op("asin"), np.arccos: _op("acos"),
    np.arctan: _op("atan"), np.arctan2: _op("atan2"), np.exp: _op("exp"), np.log: _op("log"), np.sinh: _op("sinh"),
    np.cosh: _op("cosh"), np.tanh: _op("tanh"), np.exp2: _op("exp2"), np.log2: _op("log2"), np.log10: _op("log10"),
    np.log1p: _op("log1p"), np.expm1: _op("expm1"), np.cbrt: _op("cbrt"),
    np.less: _op("lt"), np.less_equal: _op("le"), np.greater: lambda a, b: do("lt", b, a),
    np.greater_equal: lambda a, b: do("le", b, a), np.equal: _op("eq"), np.not_equal: _op("ne"),
    np.logical_and: lambda a, b: do("and", _logical(a), _logical(b)), np.bitwise_and: _op("and"),
    np.logical_or: lambda a, b: do("or", _logical(a), _logical(b)), np.bitwise_or: _op("or"),
    np.logical_not: lambda x: do("not", _logical(x)), np.invert: _op("not"),
    np.maximum: _maximum, np.minimum: _minimum, np.fmax: _fmax, np.fmin: lambda a, b: do("neg", _fmax(do("neg", a), do("neg", b))),
    np.power: _power, np.float_power: _power, np.remainder: _remainder,
    np.square: lambda x: do("mul", x, x), np.reciprocal: lambda x: do("div", 1.0, x),
    np.hypot: lambda a, b: do("sqrt", do("add", do("mul", a, a), do("mul", b, b))),
    np.sign: lambda x: do("select", do("eq", x, 0.0), x, do("add", do("copysign", 1.0, x), do("mul", 0.0, x))),
    np.ceil: lambda x: do("neg", do("floor", do("neg", x))),
    np.isfinite: _finite, np.isnan: lambda x: do("ne", x, x),
    np.isinf: lambda x: do("and", do("eq", x, x), do("not", _finite(x))),
    np.positive: lambda x: x, np.conjugate: lambda x: x,
    np.deg2rad: lambda x: do("mul", x, np.pi / 180.0), np.radians: lambda x: do("mul", x, np.pi / 180.0),
    np.rad2deg: lambda x: do("mul", x, 180.0 / np.pi), np.degrees: lambda x: do("mul", x, 180.0 / np.pi),
}  # fmt: skip


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

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return _ufunc(ufunc, method, inputs, options)

    def __bool__(self) -> bool:
        raise refused("a branch depends on a number that is known only when the filter runs; numpy.where chooses without one")

    def __float__(self) -> float:
        raise refused("a number that is known only when the filter runs is asked for as a float; numpy's functions take it as it is")

    __int__ = __index__ = __float__  # type: ignore[assignment]
    __hash__ = object.__hash__

    def __getitem__(self, at: Any) -> Any:
        return numbers(np.asarray(self, object))[at]

    def any(self, *_arguments: Any, **_options: Any) -> Number:
        """Itself, as that of an array of one; `all` is the same."""
        return self

    all = conjugate = any
    shape, ndim, dtype = (), 0, np.dtype(object)


def _operator(function: Callable[..., Scalar], swapped: bool = False) -> Any:
    def method(self: Number, *other: Any) -> Any:
        if other and not isinstance(other[0], Number | float | int | np.floating | np.integer | np.bool_):
            return NotImplemented
        return function(*other, self) if swapped else function(self, *other)

    return method


for _name, _ufunc_of in (
    ("add", np.add), ("sub", np.subtract), ("mul", np.multiply), ("truediv", np.divide), ("pow", np.power), ("mod", np.remainder),
    ("and", np.bitwise_and), ("or", np.bitwise_or),
):  # fmt: skip
    setattr(Number, f"__{_name}__", _operator(_UFUNCS[_ufunc_of]))
    setattr(Number, f"__r{_name}__", _operator(_UFUNCS[_ufunc_of], swapped=True))
for _name, _ufunc_of in (
    ("neg", np.negative), ("pos", np.positive), ("abs", np.absolute), ("invert", np.invert),
    ("lt", np.less), ("le", np.less_equal), ("gt", np.greater), ("ge", np.greater_equal), ("eq", np.equal), ("ne", np.not_equal),
):  # fmt: skip
    setattr(Number, f"__{_name}__", _operator(_UFUNCS[_ufunc_of]))
for _ufunc_of in _UFUNCS:  # an array of objects that has lost its class calls methods of these names
    if not hasattr(Number, _ufunc_of.__name__):
        setattr(Number, _ufunc_of.__name__, _operator(_UFUNCS[_ufunc_of]))


# -- arrays of them ------------------------------------------------------------------------------------------------------
class Numbers(np.ndarray):  # type: ignore[type-arg]
    """An array of `Number` and of floats that are known; numpy's functions take it as they take arrays of floats."""

    def __new__(cls, shape: tuple[int, ...]) -> Numbers:
        """Zeros."""
        out = super().__new__(cls, shape, dtype=object)
        out.fill(0.0)
        return out

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return _ufunc(ufunc, method, inputs, options)

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        own = _FUNCTIONS.get(function)
        if own is not None:
            return own(*arguments, **options)
        if getattr(function, "__module__", "") == "numpy.linalg":
            raise refused(f"numpy.linalg.{function.__name__} is not arithmetic")
        found = super().__array_function__(function, types, arguments, options)
        return type(found)(map(numbers, found)) if type(found) in (tuple, list) else numbers(found)

    def astype(self, dtype: Any, *arguments: Any, **options: Any) -> Any:  # noqa: ARG002
        """Itself, with what is true or false as 1 or 0."""
        return numbers(np.frompyfunc(as_number, 1, 1)(self.view(np.ndarray))) if dtype not in (bool, np.bool_) else self

    def any(self, *arguments: Any, **options: Any) -> Any:
        """Whether one of them is true."""
        return np.logical_or.reduce(self, *_axis(arguments, options), **options)

    def all(self, *arguments: Any, **options: Any) -> Any:
        """Whether all of them are true."""
        return np.logical_and.reduce(self, *_axis(arguments, options), **options)


def _axis(arguments: Any, options: dict[str, Any]) -> tuple[Any, ...]:
    return () if "axis" in options else arguments or (None,)


def numbers(array: Any) -> Any:
    """An array of objects as `Numbers`; one by itself too."""
    if isinstance(array, Number):
        array = np.asarray(array, object)
    return array.view(Numbers) if isinstance(array, np.ndarray) and array.dtype.hasobject else array


def tape_of(*arrays: Any) -> Tape | None:
    """The tape on which some of the numbers of arrays are; None where all are known."""
    return next((x.tape for array in arrays for x in _bare(array).flat if isinstance(x, Number)), None)


def recorded(value: Any) -> Any:
    """What holds a `Number`, as `Numbers`; None where nothing does."""
    if isinstance(value, Number | Numbers):
        return np.asanyarray(value, object).view(Numbers)
    if isinstance(value, list | tuple) or getattr(getattr(value, "dtype", None), "hasobject", False):
        array = np.asarray(value, object)
        if any(isinstance(x, Number) for x in array.flat):
            return array.view(Numbers)
    return None


def _bare(x: Any) -> Any:
    """As a plain array of objects."""
    array = np.asarray(x, object) if isinstance(x, Number) else np.asarray(x)
    return array if array.dtype.hasobject else array.astype(object)


def _ufunc(ufunc: Any, method: str, inputs: Sequence[Any], options: dict[str, Any]) -> Any:
    given = options.pop("out", None)
    options.pop("dtype", None), options.pop("order", None), options.pop("casting", None)
    if ufunc in (np.matmul, np.vecdot) and method == "__call__":
        found = numbers(_products(ufunc, *map(_bare, inputs)))
    elif ufunc.__name__ == "clip":
        low, high = inputs[1:]
        found = np.minimum(np.maximum(inputs[0], low), high)
    elif ufunc not in _UFUNCS:
        raise refused(f"numpy.{ufunc.__name__} cannot be recorded")
    elif method == "__call__":
        function = np.frompyfunc(_UFUNCS[ufunc], ufunc.nin, 1)
        found = numbers(function(*map(_bare, inputs), **options))
    elif method == "reduce":
        found = _reduced(ufunc, *inputs, **options)
    elif method == "accumulate":
        found = numbers(np.frompyfunc(_UFUNCS[ufunc], 2, 1).accumulate(*map(_bare, inputs), **options))
    else:
        raise refused(f"numpy.{ufunc.__name__}.{method} cannot be recorded")
    if given is None:
        return found
    (out,) = given
    if not out.dtype.hasobject:
        raise refused("a number that is known only when the filter runs is written into an array of floats; numpy.stack makes a new one")
    out[...] = found
    return out


_EMPTY = {np.add: 0.0, np.multiply: 1.0, np.logical_and: True, np.logical_or: False}


def _reduced(
    ufunc: Any, array: Any, axis: Any = 0, dtype: Any = None, out: Any = None, keepdims: bool = False, initial: Any = None, where: Any = True
) -> Any:
    """Over one axis, several or all (None)."""
    if where is not True or out is not None:
        raise refused(f"numpy.{ufunc.__name__} over a part cannot be recorded")
    bare = _bare(array)
    axes = tuple(range(bare.ndim)) if axis is None else tuple(np.atleast_1d(np.array(axis, int)) % max(bare.ndim, 1))
    kept = [i for i in range(bare.ndim) if i not in axes]
    rows = bare.transpose([*axes, *kept]).reshape(-1, *(bare.shape[i] for i in kept))
    function = _UFUNCS[ufunc]
    if dtype is int or ufunc in (np.add, np.multiply):
        rows = np.frompyfunc(as_number, 1, 1)(rows) if rows.size else rows
    if ufunc in _EMPTY and not len(rows):
        initial = _EMPTY[ufunc]
    result = np.empty(rows.shape[1:], object)
    for at in np.ndindex(*rows.shape[1:]):
        parts = [rows[(i, *at)] for i in range(len(rows))]
        if initial is not None and type(initial) is not type(np._NoValue):
            parts = [initial, *parts]
        result[at] = reduce(function, parts)
    if keepdims:
        result = result.reshape([1 if i in axes else bare.shape[i] for i in range(bare.ndim)])
    return numbers(result)


def _products(ufunc: Any, a: Any, b: Any) -> Any:
    """Sums of products, of what is not known to be zero."""
    if ufunc is np.vecdot:
        return _contracted(np.broadcast_arrays(a, b))
    columns, row = b.ndim == 1, a.ndim == 1
    a, b = a[None] if row else a, b[:, None] if columns else b
    out = _contracted(np.broadcast_arrays(a[..., :, None, :], np.swapaxes(b, -1, -2)[..., None, :, :]))
    return out[..., 0, 0] if row and columns else out[..., 0, :] if row else out[..., 0] if columns else out


def _contracted(pair: Sequence[Any]) -> Any:
    a, b = pair
    out = np.empty(a.shape[:-1], object)
    for at in np.ndindex(*a.shape[:-1]):
        out[at] = total(do("mul", as_number(x), as_number(y)) for x, y in zip(a[at], b[at], strict=True))
    return out if out.ndim else out[()]


def total(terms: Any) -> Scalar:
    """Sum of numbers, in their order."""
    out: Scalar = 0.0
    for term in terms:
        out = do("add", out, term)
    return out


# -- functions that are no ufuncs ------------------------------------------------------------------------------------------
def _where(condition: Any, a: Any, b: Any) -> Any:
    choose = np.frompyfunc(lambda c, x, y: do("select", _logical(c), x, y), 3, 1)
    return numbers(choose(_bare(condition), _bare(a), _bare(b)))


def _einsum(subscripts: str, *operands: Any, **_options: Any) -> Any:
    """By broadcasting: each operand's axes in the order of all letters, then a product and a sum."""
    left, right = subscripts.replace(" ", "").split("->")
    parts, bare = left.split(","), [np.asarray(_bare(x)) for x in operands]
    spare = max(x.ndim - len(part.replace("...", "")) for part, x in zip(parts, bare, strict=True))
    free = "".join(chr(ord("A") + i) for i in range(spare))
    named = [part.replace("...", free[spare - (x.ndim - len(part.replace("...", ""))) :]) for part, x in zip(parts, bare, strict=True)]
    right = right.replace("...", free)
    letters = right + "".join(sorted({c for part in named for c in part} - set(right)))
    whole: Any = 1.0
    for part, x in zip(named, bare, strict=True):
        order = [part.index(c) for c in letters if c in part]
        whole = whole * numbers(x.transpose(order)[tuple(slice(None) if c in part else None for c in letters)])
    summed = tuple(range(len(right), len(letters)))
    return np.add.reduce(whole, summed) if summed else whole


def _like(value: float) -> Callable[..., Any]:
    def made(shape: Any, *_arguments: Any, **_options: Any) -> Numbers:
        if isinstance(shape, np.ndarray) and shape.dtype.hasobject:
            shape = shape.shape
        out = Numbers(tuple(np.atleast_1d(shape)))
        out.fill(value)
        return out

    return made


def _broadcast_to(array: Any, shape: Any, **_options: Any) -> Any:
    return numbers(np.broadcast_to(_bare(array), shape))


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    if ord not in (None, 2) or (axis is None and np.ndim(x) > 1):
        raise refused("numpy.linalg.norm is recorded for lengths of vectors only")
    return np.sqrt(np.add.reduce(np.square(x), axis, keepdims=keepdims))


def _solve(A: Any, b: Any) -> Any:
    """By elimination with the largest pivot, chosen without a branch: rows are exchanged by selection."""
    A, b = _bare(A), _bare(b)
    if A.ndim != 2 or b.ndim != 2:
        raise refused("numpy.linalg.solve is recorded for matrices (n, n) and (n, k)")
    rows = [[*A[i], *b[i]] for i in range(len(A))]
    for i in range(len(rows)):
        for j in range(i + 1, len(rows)):
            if _is(rows[j][i], 0.0):
                continue
            larger = do("lt", do("abs", rows[i][i]), do("abs", rows[j][i]))
            both = [(do("select", larger, y, x), do("select", larger, x, y)) for x, y in zip(rows[i], rows[j], strict=True)]
            rows[i], rows[j] = [p for p, _ in both], [q for _, q in both]
            factor = do("div", rows[j][i], rows[i][i])
            rows[j] = [do("sub", y, do("mul", factor, x)) for x, y in zip(rows[i], rows[j], strict=True)]
    n, X = len(rows), np.empty(b.shape, object)
    for k in range(b.shape[-1]):
        for i in reversed(range(n)):
            left = do("sub", rows[i][n + k], total(do("mul", rows[i][j], X[j, k]) for j in range(i + 1, n)))
            X[i, k] = do("div", left, rows[i][i])
    return numbers(X)


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.einsum: _einsum,
    np.broadcast_to: _broadcast_to,
    np.zeros_like: _like(0.0),
    np.ones_like: _like(1.0),
    np.zeros: _like(0.0),
    np.empty: _like(0.0),
    np.linalg.norm: _norm,
    np.linalg.solve: _solve,
    np.dot: np.matmul,
    np.abs: np.absolute,
}
