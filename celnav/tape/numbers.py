"""Arrays of numbers that have no values yet: numpy code runs on them once, and its arithmetic is
recorded on a `Tape`.

Numpy's functions work on a `TracedArray` as on floats: matrix products, sums, sines, comparisons,
choices with ``np.where``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, reduce
from math import inf
from numbers import Number as AnyNumber
from typing import Any

import numpy as np

from celnav.tape.routine import Loop, LoopRecorder, rolled_loop
from celnav.tape.tape import (
    Scalar,
    Tape,
    TracedScalar,
    as_number,
    cannot_compile,
    emit,
    is_known,
    is_logical,
    total,
)

LONG = 1000
"""Number of operations below which code that is the same for all rows is unrolled."""
LONG_PRODUCT = 10_000
"""The same limit for a product of matrices."""
SORTED = 64
"""The most numbers that are sorted; n numbers take n^2 / 2 exchanges."""


def _maximum(a: Scalar, b: Scalar) -> Scalar:
    """The larger number; nan if either number is nan."""
    if type(a) is not TracedScalar:
        a, b = b, a
    # b is known and not nan: only a may be nan.
    if type(b) is not TracedScalar and b == b:
        return emit("select", emit("lt", a, b), b, a)
    return emit("select", emit("lt", a, b), b, emit("select", emit("ne", b, b), b, a))


def _minimum(a: Scalar, b: Scalar) -> Scalar:
    return emit("neg", _maximum(emit("neg", as_number(a)), emit("neg", as_number(b))))


def _fmax(a: Scalar, b: Scalar) -> Scalar:
    """The larger number; if one is nan, the other."""
    # A comparison with nan is false: if a is nan, b is selected.
    return emit("select", emit("or", emit("le", b, a), emit("ne", b, b)), a, b)


def _power(x: Scalar, y: Scalar) -> Scalar:
    if type(y) is TracedScalar or type(x) is not TracedScalar:
        return emit("pow", x, y)
    # Half-integer powers: repeated squaring, and a square root for an odd half.
    half = 2.0 * float(y)
    if half != int(half) or abs(half) > 128:
        return emit("pow", x, y)
    out: Scalar = emit("sqrt", x) if int(half) % 2 else 1.0
    # x^|y| by repeated squaring.
    count, square = int(abs(half)) // 2, x
    while count:
        if count % 2:
            out = emit("mul", out, square)
        count, square = count // 2, emit("mul", square, square)
    return emit("div", 1.0, out) if half < 0 else out


def _remainder(x: Scalar, y: Scalar) -> Scalar:
    """Python's ``x % y``, with the sign of y."""
    left = emit("fmod", x, y)
    opposite = emit("lt", emit("mul", left, emit("copysign", 1.0, y)), 0.0)
    # fmod has the sign of x: add y if the signs differ.
    zero = emit("copysign", 0.0, y)
    return emit(
        "select", opposite, emit("add", left, y), emit("select", emit("eq", left, 0.0), zero, left)
    )


def _floor_divide(x: Scalar, y: Scalar) -> Scalar:
    """Python's ``x // y`` by the remainder, as in numpy: ``floor(x / y)`` may be one more."""
    left, ratio = emit("fmod", x, y), emit("div", x, y)
    whole = emit("div", emit("sub", x, left), y)
    opposite = emit("lt", emit("mul", left, emit("copysign", 1.0, y)), 0.0)
    whole = emit("select", opposite, emit("sub", whole, 1.0), whole)
    down = emit("floor", whole)
    # (x - left) / y is an integer up to rounding: take the nearest integer.
    down = emit("select", emit("lt", 0.5, emit("sub", whole, down)), emit("add", down, 1.0), down)
    down = emit("select", emit("eq", whole, 0.0), emit("copysign", 0.0, ratio), down)
    return emit("select", emit("eq", y, 0.0), ratio, down)


def _trunc(x: Scalar) -> Scalar:
    return emit("copysign", emit("floor", emit("abs", x)), x)


def _sign(x: Scalar) -> Scalar:
    zero = emit("select", emit("eq", x, 0.0), 0.0, x)  # or nan
    return emit("select", emit("lt", 0.0, x), 1.0, emit("select", emit("lt", x, 0.0), -1.0, zero))


def _heaviside(x: Scalar, at_zero: Scalar) -> Scalar:
    up = emit("select", emit("lt", 0.0, x), 1.0, emit("select", emit("eq", x, 0.0), at_zero, x))
    return emit("select", emit("lt", x, 0.0), 0.0, up)


def _logaddexp(x: Scalar, y: Scalar) -> Scalar:
    # log(e^x + e^y) = max(x, y) + log(1 + e^-|x - y|)
    rest = emit("log1p", emit("exp", emit("neg", emit("abs", emit("sub", x, y)))))
    rest = emit("select", emit("eq", x, y), emit("log", 2.0), rest)  # also for equal infinities
    return emit("add", _maximum(x, y), rest)


def _logical(x: Scalar) -> Scalar:
    return x if is_logical(x) else emit("ne", x, 0.0)


def _bitwise(name: str) -> Callable[..., Scalar]:
    def function(*arguments: Scalar) -> Scalar:
        if not all(map(is_logical, arguments)):
            raise cannot_compile(
                "bitwise operations on integers are not recorded; k % 2 is the last bit"
            )
        return emit(name, *arguments)

    return function


def _op(name: str) -> Callable[..., Scalar]:
    return lambda *arguments: emit(name, *arguments)


_UFUNCS: dict[Any, Callable[..., Scalar]] = {
    np.add: _op("add"),
    np.subtract: _op("sub"),
    np.multiply: _op("mul"),
    np.divide: _op("div"),
    np.negative: _op("neg"),
    np.absolute: _op("abs"),
    np.fabs: _op("abs"),
    np.sqrt: _op("sqrt"),
    np.copysign: _op("copysign"),
    np.floor: _op("floor"),
    np.sin: _op("sin"),
    np.cos: _op("cos"),
    np.tan: _op("tan"),
    np.arcsin: _op("asin"),
    np.arccos: _op("acos"),
    np.arctan: _op("atan"),
    np.arctan2: _op("atan2"),
    np.exp: _op("exp"),
    np.log: _op("log"),
    np.sinh: _op("sinh"),
    np.cosh: _op("cosh"),
    np.tanh: _op("tanh"),
    np.exp2: _op("exp2"),
    np.log2: _op("log2"),
    np.log10: _op("log10"),
    np.log1p: _op("log1p"),
    np.expm1: _op("expm1"),
    np.cbrt: _op("cbrt"),
    np.less: _op("lt"),
    np.less_equal: _op("le"),
    np.greater: lambda a, b: emit("lt", b, a),
    np.greater_equal: lambda a, b: emit("le", b, a),
    np.equal: _op("eq"),
    np.not_equal: _op("ne"),
    np.logical_and: lambda a, b: emit("and", _logical(a), _logical(b)),
    np.bitwise_and: _bitwise("and"),
    np.logical_or: lambda a, b: emit("or", _logical(a), _logical(b)),
    np.bitwise_or: _bitwise("or"),
    np.logical_not: lambda x: emit("not", _logical(x)),
    np.invert: _bitwise("not"),
    np.maximum: _maximum,
    np.minimum: _minimum,
    np.fmax: _fmax,
    np.fmin: lambda a, b: emit("neg", _fmax(emit("neg", a), emit("neg", b))),
    np.power: _power,
    np.float_power: _power,
    np.remainder: _remainder,
    np.square: lambda x: emit("mul", x, x),
    np.reciprocal: lambda x: emit("div", 1.0, x),
    np.hypot: _op("hypot"),
    np.sign: _sign,
    np.rint: _op("rint"),
    np.trunc: _trunc,
    np.fmod: _op("fmod"),
    np.floor_divide: _floor_divide,
    np.heaviside: _heaviside,
    np.logaddexp: _logaddexp,
    np.logical_xor: lambda a, b: emit("ne", _logical(a), _logical(b)),
    np.bitwise_xor: _bitwise("ne"),
    np.signbit: lambda x: emit("lt", emit("copysign", 1.0, x), 0.0),
    np.ceil: lambda x: emit("neg", emit("floor", emit("neg", x))),
    np.isfinite: lambda x: emit("eq", emit("sub", x, x), 0.0),
    np.isnan: lambda x: emit("ne", x, x),
    np.isinf: lambda x: emit("eq", emit("abs", x), inf),
    np.positive: lambda x: x,
    np.conjugate: lambda x: x,
    np.deg2rad: lambda x: emit("mul", x, np.pi / 180.0),
    np.radians: lambda x: emit("mul", x, np.pi / 180.0),
    np.rad2deg: lambda x: emit("mul", x, 180.0 / np.pi),
    np.degrees: lambda x: emit("mul", x, 180.0 / np.pi),
}


_TRUTH: dict[Any, Callable[..., Scalar]] = {
    np.add: _op("or"),
    np.multiply: _op("and"),
    np.maximum: _op("or"),
    np.minimum: _op("and"),
}
"""Functions for which truth values give another result than numbers."""


@cache
def _of_truth(ufunc: Any) -> Callable[..., Scalar]:
    """A function whose operands are all truth values. Numpy determines the type of its result,
    which may differ from float64.
    """
    try:
        kind = ufunc.resolve_dtypes((np.dtype(bool),) * ufunc.nin + (None,) * ufunc.nout)[-1]
    except TypeError:
        kind = None
    function = _TRUTH.get(ufunc, _UFUNCS[ufunc])
    if kind in (np.bool_,):
        return lambda *arguments: _logical(function(*arguments))
    if kind == np.float64:
        return function

    def refuse(*_arguments: Scalar) -> Scalar:
        raise cannot_compile(
            f"numpy.{ufunc.__name__} of booleans does not give floats; multiply them by 1.0"
        )

    return refuse


def _scalar(ufunc: Any) -> Callable[..., Scalar]:
    """A function of single numbers."""

    def function(*arguments: Scalar) -> Scalar:
        if len(arguments) != ufunc.nin:  # for example round(x, 2) and pow(x, y, z)
            raise cannot_compile(f"numpy.{ufunc.__name__} is recorded of {ufunc.nin} operands only")
        truth = all(map(is_logical, arguments))
        return (_of_truth(ufunc) if truth else _UFUNCS[ufunc])(*arguments)

    return function


# -- arrays of them --------------------------------------------------------------------------------
class TracedArray(np.ndarray):
    """An array of `TracedScalar` and floats; numpy's functions treat it like an array of floats."""

    def __new__(cls, shape: tuple[int, ...]) -> TracedArray:
        """Zeros."""
        out = super().__new__(cls, shape, dtype=object)
        out.fill(0.0)
        return out

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return _ufunc(ufunc, method, inputs, options)

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        replacement = _FUNCTIONS.get(function)
        if replacement is not None:
            return replacement(*arguments, **options)
        if function.__module__ != "numpy" or function.__name__ not in _PLAIN.split():
            raise cannot_compile(
                f"{function.__module__}.{function.__name__} cannot be recorded; "
                "numpy.where and arithmetic can"
            )
        result = super().__array_function__(function, types, arguments, options)
        return (
            type(result)(map(traced, result)) if type(result) in (tuple, list) else traced(result)
        )

    def astype(self, dtype: Any, *arguments: Any, **options: Any) -> Any:  # noqa: ARG002
        """The array as floats, integers or truth values. The numbers remain in float64, so other
        types raise `CannotCompile`.
        """
        kind = _as_float64(dtype, np.int64, np.int32, np.bool_)
        floats = traced(
            _elementwise(_logical if kind.kind == "b" else as_number, self.view(np.ndarray))
        )
        return np.trunc(floats) if kind.kind == "i" else floats

    def __getitem__(self, at: Any) -> Any:
        try:
            return super().__getitem__(at)
        except IndexError as error:
            raise _explained(error, at) from None

    def __setitem__(self, at: Any, value: Any) -> None:
        """Assign as in numpy: to an array of truth values as truth values, otherwise as floats."""
        value = _elementwise(_logical if _is_truth(self) else as_number, _bare(value))
        try:
            super().__setitem__(at, value if value.ndim else value[()])
        except IndexError as error:
            raise _explained(error, at) from None

    def tobytes(self, *_arguments: Any) -> Any:
        """Raise `CannotCompile`: the numbers are not known yet."""
        raise cannot_compile(
            "numbers that are known only when the filter runs are written as bytes"
        )

    __bytes__ = tobytes

    def any(self, *arguments: Any, **options: Any) -> Any:
        """Whether any number is true."""
        return np.logical_or.reduce(self, *_axis(arguments, options), **options)

    def all(self, *arguments: Any, **options: Any) -> Any:
        """Whether all numbers are true."""
        return np.logical_and.reduce(self, *_axis(arguments, options), **options)


def _explained(error: IndexError, at: Any) -> Exception:
    """The error for an index; `CannotCompile` if the index is known only when the filter runs."""
    if all(recorded(index) is None for index in (at if isinstance(at, tuple) else (at,))):
        return error
    return cannot_compile(
        "an index or a mask is known only when the filter runs; choose by numpy.where, and put a "
        "table that is looked up into u"
    )


def _as_float64(dtype: Any, *others: Any) -> Any:
    """Check a type. The numbers remain in float64, so types other than float, int and bool raise
    `CannotCompile`.
    """
    kind = np.dtype(dtype)
    if kind not in (np.float64, np.object_, *others):
        raise cannot_compile(f"numbers are recorded as float64, not as {kind}")
    return kind


def _axis(arguments: Any, options: dict[str, Any]) -> tuple[Any, ...]:
    return () if "axis" in options else arguments or (None,)


def traced(array: Any) -> Any:
    """An array of objects, or a single `TracedScalar`, as `TracedArray`."""
    if isinstance(array, TracedScalar):
        array = np.asarray(array, object)
    return (
        array.view(TracedArray)
        if isinstance(array, np.ndarray) and array.dtype.hasobject
        else array
    )


def tape_of(*arrays: Any) -> Tape | None:
    """The tape of the numbers in the arrays; None if all numbers are known."""
    return next(
        (x.tape for array in arrays for x in _bare(array).flat if isinstance(x, TracedScalar)), None
    )


def recorded(value: Any) -> Any:
    """A value that contains a `TracedScalar`, as `TracedArray`; None for any other value."""
    if isinstance(value, TracedScalar | TracedArray):
        return np.asanyarray(value, object).view(TracedArray)
    if isinstance(value, list | tuple) or getattr(
        getattr(value, "dtype", None), "hasobject", False
    ):
        array = np.asarray(value, object)
        if any(isinstance(x, TracedScalar) for x in array.flat):
            return array.view(TracedArray)
    return None


def _bare(x: Any) -> Any:
    """A plain array of objects."""
    array = np.asarray(x, object) if isinstance(x, TracedScalar) else np.asarray(x)
    return array if array.dtype.hasobject else array.astype(object)


def _elementwise(function: Callable[[Scalar], Scalar], array: Any) -> Any:
    """A plain array of a function's results for each element."""
    return np.asarray(np.frompyfunc(function, 1, 1)(array), object)


def _is_truth(array: Any) -> bool:
    """Whether an array has truth values."""
    return array.size > 0 and all(map(is_logical, array.flat))


def _operand(x: Any) -> Any:
    """A plain array of objects, either truth values or numbers."""
    bare = _bare(x)
    if not any(map(is_logical, bare.flat)) or _is_truth(bare):
        return bare
    return _elementwise(as_number, bare)


# From numpy 2.5 on, a comparison with nan inside one of these functions would warn.
@np.errstate(all="ignore")
def _ufunc(ufunc: Any, method: str, inputs: Sequence[Any], options: dict[str, Any]) -> Any:
    outs, where = options.pop("out", None), options.pop("where", True)
    dtype = options.pop("dtype", None)
    # An int is np.intp, which has 4 bytes on a 32-bit machine such as WebAssembly.
    counts = (np.int64, np.intp, np.bool_) if method == "reduce" else ()
    _as_float64(dtype, *counts)
    options.pop("order", None), options.pop("casting", None)
    if ufunc in (np.matmul, np.vecdot) and method == "__call__":
        result = traced(_products(ufunc, *map(_operand, inputs)))
    elif ufunc.__name__ in ("clip", "real"):  # numpy 2.5 turns x.real into the latter
        result = inputs[0] if ufunc.nin == 1 else np.minimum(np.maximum(*inputs[:2]), inputs[2])
    elif ufunc is np.divmod and method == "__call__":
        return np.floor_divide(*inputs), np.remainder(*inputs)
    elif ufunc not in _UFUNCS:
        raise cannot_compile(f"numpy.{ufunc.__name__} cannot be recorded")
    elif method == "__call__":
        function = np.frompyfunc(_scalar(ufunc), ufunc.nin, 1)
        result = traced(function(*map(_operand, inputs), **options))
    elif method == "reduce" and ufunc in _REDUCED:
        return _reduced(ufunc, inputs[0], dtype=dtype, out=outs, where=where, **options)
    elif method == "accumulate" and ufunc in _REDUCED:
        array, *more = map(_operand, inputs)
        array = _elementwise(_REDUCED[ufunc], array)
        result = traced(np.frompyfunc(_scalar(ufunc), 2, 1).accumulate(array, *more, **options))
    else:
        raise cannot_compile(f"numpy.{ufunc.__name__}.{method} cannot be recorded")
    if outs is None and where is True:
        return result
    # With out= the result is written into the caller's array, with where= only in part.
    (out,) = outs or (None,)
    if out is None or not out.dtype.hasobject:
        raise cannot_compile(
            "a number that is known only when the filter runs is written into an array of floats, "
            "or into none; numpy.stack or numpy.empty_like(x) makes one for it"
        )
    out[...] = result if where is True else _where(where, result, out)
    return out


_REDUCED: dict[Any, Callable[..., Scalar]] = {
    **dict.fromkeys((np.add, np.multiply, np.maximum, np.minimum, np.fmax, np.fmin), as_number),
    **dict.fromkeys((np.logical_and, np.logical_or), _logical),
}
"""The functions that can reduce or accumulate, and the conversion of their elements."""
_EMPTY = {np.add: 0.0, np.multiply: 1.0, np.logical_and: True, np.logical_or: False}


def _reduced(
    ufunc: Any,
    array: Any,
    axis: Any = 0,
    dtype: Any = None,
    out: Any = None,
    keepdims: bool = False,
    initial: Any = np._NoValue,
    where: Any = True,
) -> Any:
    """The reduction over one axis, several or all (None)."""
    if where is not True or out is not None:
        raise cannot_compile(f"numpy.{ufunc.__name__} with where= cannot be recorded")
    bare = _bare(array)
    truth = _is_truth(bare)
    if ufunc not in _EMPTY if truth else np.dtype(dtype).kind in "bi":
        raise cannot_compile(f"numpy.{ufunc.__name__} is recorded of floats only; multiply by 1.0")
    axes = (
        tuple(range(bare.ndim))
        if axis is None
        else tuple(np.atleast_1d(np.array(axis, int)) % max(bare.ndim, 1))
    )
    remaining = [i for i in range(bare.ndim) if i not in axes]
    # (reduced axes flattened, remaining axes...)
    rows = bare.transpose([*axes, *remaining]).reshape(-1, *(bare.shape[i] for i in remaining))
    first = [initial] if initial is not None and initial is not np._NoValue else []
    if ufunc in _EMPTY and not len(rows):
        first = first or [_EMPTY[ufunc]]
    result = np.empty(rows.shape[1:], object)
    for at in np.ndindex(*rows.shape[1:]):
        parts = [*first, *(rows[(i, *at)] for i in range(len(rows)))]
        result[at] = reduce(_scalar(ufunc), map(_REDUCED[ufunc], parts))
    if keepdims:
        result = result.reshape([1 if i in axes else bare.shape[i] for i in range(bare.ndim)])
    return traced(result)


def _products(ufunc: Any, a: Any, b: Any) -> Any:
    """Matrix products as sums without the terms that are known to be zero."""
    if _is_truth(a) and _is_truth(b):
        raise cannot_compile("products of matrices of booleans are not floats; multiply by 1.0")
    if ufunc is np.vecdot:
        return _contracted(np.broadcast_arrays(a, b))
    # A vector becomes a matrix of one row or column, whose axis is removed at the end.
    column, row = b.ndim == 1, a.ndim == 1
    a, b = a[None] if row else a, b[:, None] if column else b
    if a.ndim == b.ndim == 2 and 2 * a.size * b.shape[1] >= LONG_PRODUCT:
        out = each_row(lambda row: _product(_bare(row), b), traced(a), least=LONG_PRODUCT)
    else:
        out = _product(a, b)
    out = out[..., 0, :] if row else out
    return out[..., 0] if column else out


def _product(a: Any, b: Any) -> Any:
    """Product of two matrices, as sums over pairs of rows and columns."""
    return _contracted(
        np.broadcast_arrays(a[..., :, None, :], np.swapaxes(b, -1, -2)[..., None, :, :])
    )


def _contracted(pair: Sequence[Any]) -> Any:
    a, b = pair
    # (..., k), (..., k) -> (...)
    out = np.empty(a.shape[:-1], object)
    for at in np.ndindex(*a.shape[:-1]):
        out[at] = total(
            emit("mul", as_number(x), as_number(y)) for x, y in zip(a[at], b[at], strict=True)
        )
    return out if out.ndim else out[()]


def in_model(function: Callable[..., Any], x: Any, *arguments: Any) -> Any:
    """The result of a model's function for an array; its recorded operations have exactly numpy's
    values.
    """
    tape = tape_of(x) if x.dtype.hasobject else None
    if tape is None or tape.model:
        return function(x, *arguments)
    tape.model = True
    try:
        return function(x, *arguments)
    finally:
        tape.model = False


def known_alike(a: Any, b: Any) -> bool:
    """Whether two arrays provably have the same numbers."""
    if not a.dtype.hasobject:
        return np.array_equal(a, b)
    pairs = zip(_bare(a).flat, _bare(b).flat, strict=False)
    return a.shape == b.shape and all(_key(x) == _key(y) for x, y in pairs)


def _key(x: Scalar) -> Any:
    return x.i if type(x) is TracedScalar else x.hex()


def each_row(function: Callable[..., Any], *points: Any, least: int = LONG) -> Any:
    """Values ``(p, m)`` of a function at points ``(p, n)``; each row depends on one point only.

    The function is recorded for one point. Code with ``least`` operations or more becomes a loop
    over the points. Shorter code is unrolled, so that operations common to several points are done
    once.
    """
    tape, count = tape_of(*points), len(points[0])
    if tape is None or count == 1 or not tape.rolled:
        return function(*points)
    widths = [x.shape[-1] for x in points]
    variables = [tape.node("var", len(tape.ops)) for _ in range(sum(widths))]
    ends = np.cumsum(widths)
    # One point (1, n) of variables represents all points.
    symbols = [
        np.array([variables[end - n : end]], object).view(TracedArray)
        for end, n in zip(ends, widths, strict=True)
    ]
    y = function(*symbols)
    outputs = [tape.lift(as_number(x)) for x in np.asarray(y, object).flat]
    # (p, number of variables): the values of the variables at each point.
    rows = np.concatenate([_bare(x) for x in points], -1)
    results = (
        rolled_loop(tape, variables, outputs, rows.tolist(), least)
        if np.shape(y)[:-1] == (1,)
        else None
    )
    return (
        function(*points)
        if results is None
        else traced(np.array(results, object).reshape(count, len(outputs)))
    )


def rarely(
    condition: Any, function: Callable[..., Any], arrays: Sequence[Any], usual: Sequence[Any]
) -> tuple[Any, ...]:
    """``np.where(condition, function(*arrays), usual)`` for each matrix, with a condition ``(...)``
    that is rarely true.

    The compiled code calls the function only if the condition is true for at least one run of the
    vector.
    """
    condition, tape = traced(np.asanyarray(condition)), tape_of(condition)
    if tape is None or not tape.rolled:
        results = function(*arrays)
    else:
        inputs = {x.i: x for array in arrays for x in _bare(array).flat if type(x) is TracedScalar}
        first = 1 + len(inputs)
        # Memory: the condition, the inputs, then the results.
        stage = LoopRecorder(1, inputs=(1, 0), results=(first, 0))
        # Inside the routine each input represents a number of the outer tape.
        inside = {i: stage.take("inputs", k, tape.absent[i]) for k, i in enumerate(inputs)}
        images = [
            traced(
                _elementwise(lambda x: inside[x.i] if type(x) is TracedScalar else x, _bare(array))
            )
            if recorded(array) is not None
            else array
            for array in arrays
        ]
        values = [_bare(array) for array in function(*images)]
        for k, x in enumerate(x for array in values for x in array.flat):
            stage.put("results", k, x)
        sizes = [array.size for array in values]
        cells = range(first, first + sum(sizes))
        routine = Loop([stage.stage()], cells.stop, cells, rare=True)
        returned = np.array(routine(tape, [condition.item(), *inputs.values()]), object)
        parts = np.split(returned, np.cumsum(sizes)[:-1])
        results = [traced(x.reshape(array.shape)) for x, array in zip(parts, values, strict=True)]
    return tuple(
        np.where(condition[..., None, None], x, y) for x, y in zip(results, usual, strict=True)
    )


# -- functions that are no ufuncs ------------------------------------------------------------------
@np.errstate(all="ignore")
def _where(condition: Any, a: Any, b: Any) -> Any:
    a, b = _operand(a), _operand(b)
    # Truth values together with numbers are treated as numbers.
    if not (_is_truth(a) and _is_truth(b)):
        a, b = (_elementwise(as_number, x) for x in (a, b))
    choose = np.frompyfunc(lambda c, x, y: emit("select", _logical(c), x, y), 3, 1)
    return traced(choose(_bare(condition), a, b))


def _select(conditions: Any, choices: Any, default: Any = 0.0) -> Any:
    for condition, choice in zip(reversed(conditions), reversed(choices), strict=True):
        default = _where(condition, choice, default)
    return default


@np.errstate(all="ignore")
def _interp(x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None) -> Any:
    """Linear interpolation on the line that starts at the last knot at or below x."""
    xp, fp = _bare(xp).tolist(), _bare(fp).tolist()
    slopes = [
        emit("div", emit("sub", fp[j + 1], fp[j]), emit("sub", xp[j + 1], xp[j]))
        for j in range(len(xp) - 1)
    ]

    def interpolated(v: Scalar) -> Scalar:
        y = fp[0] if left is None else left
        # Each knot at or below v replaces the line from the previous knot.
        for knot, f, slope in zip(xp, fp, [*slopes, 0.0], strict=True):
            line = emit("add", emit("mul", slope, emit("sub", v, knot)), f)
            y = emit("select", emit("le", knot, v), line, y)
        y = emit("select", emit("lt", xp[-1], v), fp[-1] if right is None else right, y)
        return emit("select", emit("ne", v, v), v, y)

    return traced(_elementwise(interpolated, _bare(x)))


def _sort(x: Any, axis: Any = -1) -> Any:
    """Sort by exchanging neighbors, nan last."""
    moved = np.ravel(x) if axis is None else np.moveaxis(x, axis, 0)
    rows = list(moved)
    if len(rows) > SORTED:
        raise cannot_compile(f"numpy.sort is recorded for at most {SORTED} numbers")
    # Each pass moves the largest remaining number to `end`.
    for end in range(len(rows) - 1, 0, -1):
        for j in range(end):
            a, b = rows[j : j + 2]
            right = np.logical_or(np.less_equal(a, b), np.isnan(b))
            rows[j : j + 2] = np.where(right, a, b), np.where(right, b, a)
    return np.moveaxis(np.stack(rows), 0, 0 if axis is None else axis)


def _median(x: Any, axis: Any = None, keepdims: bool = False) -> Any:
    ordered = 1.0 * _sort(x, axis)
    n, along = ordered.shape[axis or 0], 0 if axis is None else axis
    low, high, last = (np.take(ordered, [k], along) for k in ((n - 1) // 2, n // 2, n - 1))
    # nan is sorted last: the last number shows whether there is one.
    middle = np.where(np.isnan(last), last, low if n % 2 else (low + high) / 2.0)
    if axis is None:
        return middle.reshape((1,) * np.ndim(x)) if keepdims else middle[0]
    return middle if keepdims else np.squeeze(middle, along)


def _nan_to_num(
    x: Any, copy: bool = True, nan: Any = 0.0, posinf: Any = None, neginf: Any = None
) -> Any:
    x, most = traced(_bare(x)), np.finfo(float).max
    high, low = (
        bound if value is None else value for value, bound in ((posinf, most), (neginf, -most))
    )
    result = np.where(np.isnan(x), nan, np.where(x == inf, high, np.where(x == -inf, low, x)))
    if copy:
        return result
    x[...] = result
    return x


def _einsum(subscripts: str, *operands: Any, **_options: Any) -> Any:
    """Einstein summation by broadcasting: the axes of each operand in the order of all letters,
    then a product and a sum.
    """
    left, right = subscripts.replace(" ", "").split("->")
    terms, bare = left.split(","), [_bare(x) for x in operands]
    more = [x.ndim - len(term.replace("...", "")) for term, x in zip(terms, bare, strict=True)]
    # Capital letters represent the axes of an ellipsis, counted from the last axis.
    free = "".join(chr(ord("A") + i) for i in range(max(more)))
    named = [
        term.replace("...", free[max(more) - count :])
        for term, count in zip(terms, more, strict=True)
    ]
    right = right.replace("...", free)
    letters = right + "".join(sorted({c for term in named for c in term} - set(right)))
    product: Any = 1.0
    for term, x in zip(named, bare, strict=True):
        # The axes in the order of all letters, with an axis of length 1 for each missing letter.
        order = [term.index(c) for c in letters if c in term]
        product = product * traced(
            x.transpose(order)[tuple(slice(None) if c in term else None for c in letters)]
        )
    summed = tuple(range(len(right), len(letters)))
    return np.add.reduce(product, summed) if summed else product


def _like(value: float) -> Callable[..., Any]:
    def made(
        prototype: Any, dtype: Any = None, *_arguments: Any, shape: Any = None, **_: Any
    ) -> Any:
        array = recorded(prototype)
        if shape is None:
            shape = prototype if array is None else array.shape
        if np.dtype(dtype) not in (np.float64, np.object_):
            return np.full(shape, value, dtype)
        out = TracedArray(tuple(np.atleast_1d(shape)))
        out.fill(value if array is None or not _is_truth(array) else bool(value))
        return out

    return made


def _full_like(a: Any, fill_value: Any, *arguments: Any, **options: Any) -> Any:
    out = np.zeros_like(a, *arguments, **options)
    out[...] = fill_value
    return out


def _dot(a: Any, b: Any) -> Any:
    if np.ndim(a) > 2 or np.ndim(b) > 2:
        raise cannot_compile(
            "numpy.dot is recorded for vectors and matrices; a @ b takes batches of them"
        )
    return np.matmul(a, b)


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    if ord not in (None, 2) or (axis is None and np.ndim(x) > 1):
        raise cannot_compile("numpy.linalg.norm is recorded for lengths of vectors only")
    return np.sqrt(np.sum(np.square(x), axis, keepdims=keepdims))


def _solve(A: Any, b: Any) -> Any:
    A, b = _bare(A), _bare(b)
    # A vector b (n,) is one right-hand side (n, 1).
    columns = b[:, None] if b.ndim == 1 else b
    batch = np.broadcast_shapes(A.shape[:-2], columns.shape[:-2])
    A, columns = (np.broadcast_to(x, (*batch, *x.shape[-2:])) for x in (A, columns))
    X = np.empty(columns.shape, object)
    for at in np.ndindex(*batch):
        X[at] = _eliminated(A[at], columns[at])
    return traced(X[..., 0] if b.ndim == 1 else X)


def _eliminated(A: Any, b: Any) -> Any:
    """``A^-1 b`` by Gaussian elimination with partial pivoting; rows are exchanged by selection,
    without a branch.
    """
    rows = [[*A[i], *b[i]] for i in range(len(A))]
    for i in range(len(rows)):
        below = [j for j in range(i + 1, len(rows)) if not is_known(rows[j][i], 0.0)]
        for j in below:
            # Exchange rows i and j if row j has the larger pivot.
            larger = emit("lt", emit("abs", rows[i][i]), emit("abs", rows[j][i]))
            both = [
                (emit("select", larger, y, x), emit("select", larger, x, y))
                for x, y in zip(rows[i], rows[j], strict=True)
            ]
            rows[i], rows[j] = [p for p, _ in both], [q for _, q in both]
        for j in below:
            # Row j minus a multiple of row i has a zero below the pivot.
            factor = emit("div", rows[j][i], rows[i][i])
            rows[j] = [
                emit("sub", y, emit("mul", factor, x))
                for x, y in zip(rows[i], rows[j], strict=True)
            ]
    n, X = len(rows), np.empty(b.shape, object)
    for k in range(b.shape[-1]):
        # Back substitution, starting at the last unknown.
        for i in reversed(range(n)):
            left = emit(
                "sub",
                rows[i][n + k],
                total(emit("mul", rows[i][j], X[j, k]) for j in range(i + 1, n)),
            )
            X[i, k] = emit("div", left, rows[i][i])
    return X


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.einsum: _einsum,
    np.broadcast_to: lambda array, shape, **_options: traced(np.broadcast_to(_bare(array), shape)),
    np.select: _select,
    np.interp: _interp,
    np.sort: _sort,
    np.median: _median,
    np.nan_to_num: _nan_to_num,
    **dict.fromkeys((np.empty_like, np.zeros_like, np.empty, np.zeros), _like(0.0)),
    np.ones_like: _like(1.0),
    np.full_like: _full_like,
    np.linalg.norm: _norm,
    np.linalg.solve: _solve,
    np.linalg.inv: lambda A: _solve(A, np.eye(A.shape[-1])),
    np.dot: _dot,
}


_PLAIN = """
all amax amin angle any append apply_along_axis around array2string array_repr array_split
array_str atleast_1d atleast_2d atleast_3d average block broadcast_arrays clip column_stack
compress concatenate convolve copy correlate cross cumprod cumsum cumulative_prod
cumulative_sum delete diag diagflat diagonal diff dsplit dstack ediff1d expand_dims extract
fill_diagonal fix flip fliplr flipud gradient hsplit hstack imag inner iscomplexobj
isclose isneginf isposinf isrealobj kron matrix_transpose max mean meshgrid min moveaxis ndim
outer pad polyadd polyder polyint polysub polyval prod ptp ravel real repeat result_type reshape
roll rollaxis rot90 round shape sinc size split squeeze stack std sum swapaxes take
take_along_axis tensordot tile trace transpose trapezoid tril tril_indices_from triu
triu_indices_from unstack vander var vdot vsplit vstack
"""
"""numpy's functions that work unchanged on objects, because they do not depend on the type."""


# -- one of them by itself -------------------------------------------------------------------------
def _operator(function: Callable[..., Any], swapped: bool = False) -> Any:
    def method(self: TracedScalar, *other: Any) -> Any:
        if other and not isinstance(
            other[0], TracedScalar | float | int | np.floating | np.integer | np.bool_
        ):
            if isinstance(other[0], AnyNumber):
                raise cannot_compile(f"a number is recorded with floats, not with {other[0]!r}")
            return NotImplemented
        return function(*other, self) if swapped else function(self, *other)

    return method


def _python(ufunc: Any) -> Callable[..., Scalar]:
    """The operator for single numbers. Python's truth values are integers there, but numpy's are
    not.
    """

    def function(*arguments: Scalar) -> Scalar:
        if ufunc in (np.add, np.invert) and all(map(is_logical, arguments)):
            raise cannot_compile(
                "a sum or an inversion of single truth values is another number in Python than in "
                "numpy; use numpy.logical_or, numpy.logical_not, or multiply them by 1.0"
            )
        return _scalar(ufunc)(*arguments)

    return function


_BINARY = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "truediv": np.divide,
    "pow": np.power,
    "mod": np.remainder,
    "floordiv": np.floor_divide,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
}
_OTHER = {
    "neg": np.negative,
    "pos": np.positive,
    "abs": np.absolute,
    "invert": np.invert,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "floor": np.floor,
    "ceil": np.ceil,
    "trunc": np.trunc,
    "round": np.rint,
}
for _name, _of in {**_BINARY, **_OTHER}.items():
    setattr(TracedScalar, f"__{_name}__", _operator(_python(_of)))
for _name, _of in _BINARY.items():
    setattr(TracedScalar, f"__r{_name}__", _operator(_python(_of), swapped=True))
for _name, _swapped in (("divmod", False), ("rdivmod", True)):
    _pair = lambda x, y: (_floor_divide(x, y), _remainder(x, y))  # noqa: E731
    setattr(TracedScalar, f"__{_name}__", _operator(_pair, _swapped))
for _of in _UFUNCS:  # a plain array of objects calls methods of these names
    if not hasattr(TracedScalar, _of.__name__):
        setattr(TracedScalar, _of.__name__, _operator(_scalar(_of)))


def _through(_self: TracedScalar, function: Any, _types: Any, arguments: Any, options: Any) -> Any:
    """Numpy's functions of single numbers, computed as for arrays without axes."""

    def whole(x: Any) -> Any:
        return (
            traced(x)
            if isinstance(x, TracedScalar)
            else type(x)(map(whole, x))
            if type(x) in (tuple, list)
            else x
        )

    return function(*map(whole, arguments), **{name: whole(x) for name, x in options.items()})


for _name, _method in (
    ("__array_ufunc__", TracedArray.__array_ufunc__),
    ("__array_function__", _through),
):
    setattr(TracedScalar, _name, _method)
