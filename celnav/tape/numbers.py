"""Arrays of numbers that are not known yet: run numpy code on them once, and its arithmetic is on a `Tape`.

numpy's functions work on `Numbers` as they do on floats: products of matrices, sums, sines, comparisons, choices with ``np.where``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from math import inf, nan
from typing import Any

import numpy as np

from celnav.tape.routine import rolled
from celnav.tape.tape import Number, Scalar, Tape, as_number, do, is_known, refused, total

__all__ = ["Numbers", "each_row", "numbers", "recorded", "tape_of"]

LONG = 1000
"""Operations that are written out even so, where rows are treated alike."""
LONG_PRODUCT = 10_000
"""Likewise of a product of matrices."""


def _maximum(a: Scalar, b: Scalar) -> Scalar:
    """The larger one, nan if one of them is."""
    if type(a) is not Number:
        a, b = b, a
    if type(b) is not Number and b == b:
        return do("select", do("lt", a, b), b, a)
    return do("select", do("lt", a, b), b, do("select", do("ne", b, b), b, a))


def _minimum(a: Scalar, b: Scalar) -> Scalar:
    return do("neg", _maximum(do("neg", as_number(a)), do("neg", as_number(b))))


def _fmax(a: Scalar, b: Scalar) -> Scalar:
    """The larger one, or the one that is not nan."""
    return do("select", do("or", do("le", b, a), do("ne", b, b)), a, b)


def _power(x: Scalar, y: Scalar) -> Scalar:
    if type(y) is Number or type(x) is not Number:
        return do("pow", x, y)
    half = 2.0 * float(y)
    if half != int(half) or abs(half) > 128:
        return do("pow", x, y)
    out: Scalar = do("sqrt", x) if int(half) % 2 else 1.0
    count, square = int(abs(half)) // 2, x
    while count:
        if count % 2:
            out = do("mul", out, square)
        count, square = count // 2, do("mul", square, square)
    return do("div", 1.0, out) if half < 0 else out


def _remainder(x: Scalar, y: Scalar) -> Scalar:
    """Python's ``x % y``, of the sign of y, within round-off of x."""
    if is_known(y, 0.0):
        return nan
    left = do("sub", x, do("mul", do("floor", do("div", x, y)), y))
    left = do(
        "select", do("lt", do("mul", left, do("copysign", 1.0, y)), 0.0), do("add", left, y), left
    )
    return do("select", do("le", do("abs", y), do("abs", left)), do("sub", left, y), left)


def _logical(x: Scalar) -> Scalar:
    return x if type(x) is bool or getattr(x, "logical", False) else do("ne", x, 0.0)


def _both_logical(a: Scalar, b: Scalar) -> bool:
    return all(isinstance(x, bool | np.bool_) or getattr(x, "logical", False) for x in (a, b))


def _op(name: str) -> Callable[..., Scalar]:
    return lambda *arguments: do(name, *arguments)


_UFUNCS: dict[Any, Callable[..., Scalar]] = {
    np.add: lambda a, b: do("or" if _both_logical(a, b) else "add", a, b), np.subtract: _op("sub"),
    np.multiply: lambda a, b: do("and" if _both_logical(a, b) else "mul", a, b), np.divide: _op("div"), np.negative: _op("neg"),
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
    np.sign: lambda x: do("select", do("lt", 0.0, x), 1.0, do("select", do("lt", x, 0.0), -1.0, x)),
    np.floor_divide: lambda a, b: do("floor", do("div", a, b)), np.rint: _op("rint"),
    np.trunc: lambda x: do("copysign", do("floor", do("abs", x)), x),
    np.ceil: lambda x: do("neg", do("floor", do("neg", x))),
    np.isfinite: lambda x: do("eq", do("sub", x, x), 0.0), np.isnan: lambda x: do("ne", x, x),
    np.isinf: lambda x: do("eq", do("abs", x), inf),
    np.positive: lambda x: x, np.conjugate: lambda x: x,
    np.deg2rad: lambda x: do("mul", x, np.pi / 180.0), np.radians: lambda x: do("mul", x, np.pi / 180.0),
    np.rad2deg: lambda x: do("mul", x, 180.0 / np.pi), np.degrees: lambda x: do("mul", x, 180.0 / np.pi),
}  # fmt: skip


# -- arrays of them ------------------------------------------------------------------------------------------------------
class Numbers(np.ndarray):
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
        """As floats, whole numbers or truth values; they stay numbers of full precision, so no other type will do."""
        kind = np.dtype(dtype)
        if kind.kind not in "biuO" and kind != np.float64:
            raise refused(f"numbers are recorded as float64, not as {kind}")
        floats = numbers(
            np.frompyfunc(_logical if kind.kind == "b" else as_number, 1, 1)(self.view(np.ndarray))
        )
        return np.trunc(floats) if kind.kind in "iu" else floats

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
    return next(
        (x.tape for array in arrays for x in _bare(array).flat if isinstance(x, Number)), None
    )


def recorded(value: Any) -> Any:
    """What holds a `Number`, as `Numbers`; None where nothing does."""
    if isinstance(value, Number | Numbers):
        return np.asanyarray(value, object).view(Numbers)
    if isinstance(value, list | tuple) or getattr(
        getattr(value, "dtype", None), "hasobject", False
    ):
        array = np.asarray(value, object)
        if any(isinstance(x, Number) for x in array.flat):
            return array.view(Numbers)
    return None


def _bare(x: Any) -> Any:
    """As a plain array of objects."""
    array = np.asarray(x, object) if isinstance(x, Number) else np.asarray(x)
    return array if array.dtype.hasobject else array.astype(object)


@np.errstate(
    all="ignore"
)  # from numpy 2.5 on a comparison with nan within a function of ours would warn
def _ufunc(ufunc: Any, method: str, inputs: Sequence[Any], options: dict[str, Any]) -> Any:
    given = options.pop("out", None)
    options.pop("dtype", None), options.pop("order", None), options.pop("casting", None)
    if ufunc in (np.matmul, np.vecdot) and method == "__call__":
        found = numbers(_products(ufunc, *map(_bare, inputs)))
    elif ufunc.__name__ in ("clip", "real"):  # the latter is what numpy 2.5 makes of x.real
        found = inputs[0] if ufunc.nin == 1 else np.minimum(np.maximum(*inputs[:2]), inputs[2])
    elif ufunc not in _UFUNCS:
        raise refused(f"numpy.{ufunc.__name__} cannot be recorded")
    elif method == "__call__":
        found = numbers(np.frompyfunc(_UFUNCS[ufunc], ufunc.nin, 1)(*map(_bare, inputs), **options))
    elif method == "reduce":
        found = _reduced(ufunc, *inputs, **options)
    elif method == "accumulate":
        found = numbers(
            np.frompyfunc(_UFUNCS[ufunc], 2, 1).accumulate(*map(_bare, inputs), **options)
        )
    else:
        raise refused(f"numpy.{ufunc.__name__}.{method} cannot be recorded")
    if given is None:
        return found
    (out,) = given
    if not out.dtype.hasobject:
        raise refused(
            "a number that is known only when the filter runs is written into an array of floats; numpy.stack makes a new one"
        )
    out[...] = found
    return out


_EMPTY = {np.add: 0.0, np.multiply: 1.0, np.logical_and: True, np.logical_or: False}


def _reduced(
    ufunc: Any,
    array: Any,
    axis: Any = 0,
    dtype: Any = None,
    out: Any = None,
    keepdims: bool = False,
    **more: Any,
) -> Any:
    """Over one axis, several or all (None)."""
    initial = more.get("initial")
    if more.get("where", True) is not True or out is not None:
        raise refused(f"numpy.{ufunc.__name__} over a part cannot be recorded")
    bare = _bare(array)
    axes = (
        tuple(range(bare.ndim))
        if axis is None
        else tuple(np.atleast_1d(np.array(axis, int)) % max(bare.ndim, 1))
    )
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
        if ufunc in (np.logical_or, np.logical_and):
            parts = [_logical(x) for x in parts]
        if initial is not None and initial is not np._NoValue:
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
    if a.ndim == b.ndim == 2 and 2 * a.size * b.shape[1] >= LONG_PRODUCT:
        out = each_row(lambda row: _product(_bare(row), b), numbers(a), least=LONG_PRODUCT)
    else:
        out = _product(a, b)
    return (
        out[..., 0, 0]
        if row and columns
        else out[..., 0, :]
        if row
        else out[..., 0]
        if columns
        else out
    )


def _product(a: Any, b: Any) -> Any:
    """Of two matrices, in pairs of rows and columns."""
    return _contracted(
        np.broadcast_arrays(a[..., :, None, :], np.swapaxes(b, -1, -2)[..., None, :, :])
    )


def _contracted(pair: Sequence[Any]) -> Any:
    a, b = pair
    out = np.empty(a.shape[:-1], object)
    for at in np.ndindex(*a.shape[:-1]):
        out[at] = total(
            do("mul", as_number(x), as_number(y)) for x, y in zip(a[at], b[at], strict=True)
        )
    return out if out.ndim else out[()]


def each_row(function: Callable[..., Any], *points: Any, least: int = LONG) -> Any:
    """Values ``(p, m)`` of a function at points ``(p, n)``, each of its values that of one point.

    It is recorded for one of them. Code of ``least`` operations or more becomes a loop over the points; what is shorter is written
    out, where what points have in common is done once.
    """
    tape, count = tape_of(*points), len(points[0])
    if tape is None or count == 1 or not tape.rolled:
        return function(*points)
    widths = [x.shape[-1] for x in points]
    variables = [tape.node("var", len(tape.ops)) for _ in range(sum(widths))]
    ends = np.cumsum(widths)
    one = [
        np.array([variables[end - n : end]], object).view(Numbers)
        for end, n in zip(ends, widths, strict=True)
    ]
    y = function(*one)
    outputs = [tape.lift(as_number(x)) for x in np.asarray(y, object).flat]
    rows = np.concatenate([_bare(x) for x in points], -1)
    left = (
        rolled(tape, variables, outputs, rows.tolist(), least) if np.shape(y)[:-1] == (1,) else None
    )
    return (
        function(*points)
        if left is None
        else numbers(np.array(left, object).reshape(count, len(outputs)))
    )


# -- functions that are no ufuncs ------------------------------------------------------------------------------------------
@np.errstate(all="ignore")
def _where(condition: Any, a: Any, b: Any) -> Any:
    choose = np.frompyfunc(lambda c, x, y: do("select", _logical(c), x, y), 3, 1)
    return numbers(choose(_bare(condition), _bare(a), _bare(b)))


def _einsum(subscripts: str, *operands: Any, **_options: Any) -> Any:
    """By broadcasting: each operand's axes in the order of all letters, then a product and a sum."""
    left, right = subscripts.replace(" ", "").split("->")
    parts, bare = left.split(","), [_bare(x) for x in operands]
    more = [x.ndim - len(part.replace("...", "")) for part, x in zip(parts, bare, strict=True)]
    free = "".join(chr(ord("A") + i) for i in range(max(more)))
    named = [
        part.replace("...", free[max(more) - count :])
        for part, count in zip(parts, more, strict=True)
    ]
    right = right.replace("...", free)
    letters = right + "".join(sorted({c for part in named for c in part} - set(right)))
    whole: Any = 1.0
    for part, x in zip(named, bare, strict=True):
        order = [part.index(c) for c in letters if c in part]
        whole = whole * numbers(
            x.transpose(order)[tuple(slice(None) if c in part else None for c in letters)]
        )
    summed = tuple(range(len(right), len(letters)))
    return np.add.reduce(whole, summed) if summed else whole


def _like(value: float) -> Callable[..., Any]:
    def made(prototype: Any, *_arguments: Any, shape: Any = None, **_options: Any) -> Numbers:
        if shape is None:
            shape = (
                prototype.shape
                if isinstance(prototype, np.ndarray) and prototype.dtype.hasobject
                else prototype
            )
        out = Numbers(tuple(np.atleast_1d(shape)))
        out.fill(value)
        return out

    return made


def _alike_arrays(a: Any, b: Any) -> bool:
    """Whether arrays are known to be the same: of the same numbers."""
    a, b = _bare(a), _bare(b)
    pairs = zip(a.flat, b.flat, strict=False)
    return a.shape == b.shape and all(x is y or (_key(x) == _key(y)) for x, y in pairs)


def _key(x: Scalar) -> Any:
    return (id(x.tape), x.i) if type(x) is Number else x


def _dot(a: Any, b: Any) -> Any:
    if np.ndim(a) > 2 or np.ndim(b) > 2:
        raise refused("numpy.dot is recorded for vectors and matrices; a @ b takes batches of them")
    return np.matmul(a, b)


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    if ord not in (None, 2) or (axis is None and np.ndim(x) > 1):
        raise refused("numpy.linalg.norm is recorded for lengths of vectors only")
    return np.sqrt(np.sum(np.square(x), axis, keepdims=keepdims))


def _solve(A: Any, b: Any) -> Any:
    """By elimination with the largest pivot, chosen without a branch: rows are exchanged by selection."""
    A, b = _bare(A), _bare(b)
    if A.ndim != 2 or b.ndim != 2:
        raise refused("numpy.linalg.solve is recorded for matrices (n, n) and (n, k)")
    rows = [[*A[i], *b[i]] for i in range(len(A))]
    for i in range(len(rows)):
        for j in range(i + 1, len(rows)):
            if is_known(rows[j][i], 0.0):
                continue
            larger = do("lt", do("abs", rows[i][i]), do("abs", rows[j][i]))
            both = [
                (do("select", larger, y, x), do("select", larger, x, y))
                for x, y in zip(rows[i], rows[j], strict=True)
            ]
            rows[i], rows[j] = [p for p, _ in both], [q for _, q in both]
            factor = do("div", rows[j][i], rows[i][i])
            rows[j] = [
                do("sub", y, do("mul", factor, x)) for x, y in zip(rows[i], rows[j], strict=True)
            ]
    n, X = len(rows), np.empty(b.shape, object)
    for k in range(b.shape[-1]):
        for i in reversed(range(n)):
            left = do(
                "sub",
                rows[i][n + k],
                total(do("mul", rows[i][j], X[j, k]) for j in range(i + 1, n)),
            )
            X[i, k] = do("div", left, rows[i][i])
    return numbers(X)


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.einsum: _einsum,
    np.broadcast_to: lambda array, shape, **_options: numbers(np.broadcast_to(_bare(array), shape)),
    np.array_equal: _alike_arrays,
    **dict.fromkeys((np.empty_like, np.zeros_like, np.empty, np.zeros), _like(0.0)),
    np.ones_like: _like(1.0),
    np.linalg.norm: _norm,
    np.linalg.solve: _solve,
    np.linalg.inv: lambda A: _solve(A, np.eye(len(A))),
    np.dot: _dot,
}


# -- one of them by itself -------------------------------------------------------------------------------------------------
def _operator(function: Callable[..., Scalar], swapped: bool = False) -> Any:
    def method(self: Number, *other: Any) -> Any:
        if other and not isinstance(
            other[0], Number | float | int | np.floating | np.integer | np.bool_
        ):
            return NotImplemented
        return function(*other, self) if swapped else function(self, *other)

    return method


_BINARY = {"add": np.add, "sub": np.subtract, "mul": np.multiply, "truediv": np.divide, "pow": np.power, "mod": np.remainder,
           "and": np.bitwise_and, "or": np.bitwise_or}  # fmt: skip
_OTHER = {"neg": np.negative, "pos": np.positive, "abs": np.absolute, "invert": np.invert, "lt": np.less, "le": np.less_equal,
          "gt": np.greater, "ge": np.greater_equal, "eq": np.equal, "ne": np.not_equal}  # fmt: skip
for _name, _of in {**_BINARY, **_OTHER}.items():
    setattr(Number, f"__{_name}__", _operator(_UFUNCS[_of]))
for _name, _of in _BINARY.items():
    setattr(Number, f"__r{_name}__", _operator(_UFUNCS[_of], swapped=True))
for _of in _UFUNCS:  # an array of objects that has lost its class calls methods of these names
    if not hasattr(Number, _of.__name__):
        setattr(Number, _of.__name__, _operator(_UFUNCS[_of]))


def _through(_self: Number, function: Any, _types: Any, arguments: Any, options: Any) -> Any:
    """numpy's functions of single numbers: as of arrays without axes."""

    def whole(x: Any) -> Any:
        return (
            numbers(x)
            if isinstance(x, Number)
            else type(x)(map(whole, x))
            if type(x) in (tuple, list)
            else x
        )

    return function(*map(whole, arguments), **{name: whole(x) for name, x in options.items()})


for _name, _method in (
    (
        "__array_ufunc__",
        lambda _self, ufunc, method, *inputs, **options: _ufunc(ufunc, method, inputs, options),
    ),
    ("__array_function__", _through),
    ("__getitem__", lambda self, at: numbers(np.asarray(self, object))[at]),
):
    setattr(Number, _name, _method)
