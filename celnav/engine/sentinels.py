"""Comparison of machine code with numpy at some epochs of each run, and detection of models with
memory.

A recorded step is valid for a whole run only if the model is a function of its arguments, which
nothing guarantees. So at a few epochs, spread over the run, numpy computes the same step from the
same states. The tolerance for round-off follows from the conditioning of the step: it is a multiple
of the change of numpy's step when each number of the state, the measurement and the models' values
changes by one or two ulp. The contents of a filter's functions must not change when they are
called.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from functools import cached_property, partial
from operator import is_
from pathlib import Path
from types import (
    BuiltinFunctionType,
    CellType,
    CodeType,
    FunctionType,
    GeneratorType,
    MethodType,
    ModuleType,
)
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from celnav.engine.recording import (
    COUNTERS,
    PART,
    Data,
    Engine,
    Shape,
    flat_entries,
    map_run_constants,
    tree_leaves,
    tree_unflatten,
)
from celnav.engine.runs import Sentinel, epoch_of, runs_of
from celnav.filters.mixing import WATCH
from celnav.gaussian.belief import mask_failed
from celnav.gaussian.linalg import EPS, Array
from celnav.gaussian.rules import AnyDimension, Taylor
from celnav.tape.numbers import TracedArray
from celnav.tape.tape import TracedScalar

CLOSE = 1e-6  # tolerance, relative to the standard deviation, or to the size of any other number
DIFFERENCED = 1e-4  # tolerance if numpy uses differences and machine code derivatives
MOVES = 1e3  # tolerance, times the change of numpy's step by round-off of its inputs
TRIES = 3
SAMPLE = 4096  # how many numbers of a large array identify it
MOST_NAMED = 3  # functions named in a message
DEEP = 16  # levels of nested objects that are examined
GENERATES = ("bit_generator", "get_state", "getstate")  # attributes of random generators
FIXED = (tuple, partial, MethodType, BuiltinFunctionType, ModuleType, type)
EMPTY = CellType()  # stands for a name that has no value yet


# -- the same step by numpy --------------------------------------------------------------------
def difference(
    filter: Any, engine: Engine, data: Data, sentinel: Sentinel, watched: Sequence[int]
) -> str:
    """The quantity in which a numpy step from the states before a sentinel differs; "" if none
    does.
    """
    failed = COUNTERS.index("failed_at")
    sound = np.flatnonzero((sentinel.before[:, failed] < 0) & (sentinel.after[:, failed] < 0))
    # Memories need not have the axes of runs first: then each run is computed separately.
    plain = len(sentinel.shape.arrays) == len(sentinel.shape_after.arrays) == 2
    groups: list[Any] = [sound] if plain and engine.batch else list(sound)
    for group in groups if len(sound) else ():
        runs = np.array(watched)[group]
        take = partial(runs_of, batch=engine.batch, runs=runs)
        run_filter = (
            map_run_constants(filter, partial(take, axes=2)) if engine.constants else filter
        )
        epoch = epoch_of(data, sentinel.at, take, engine.batch)
        if not plain and _silent(epoch.z, data, sentinel.at):
            continue  # numpy then calls no hook, unless another run has a measurement
        state = _state(sentinel.shape, sentinel.before[group], engine.state_offset)
        rows = sentinel.after[group]
        tally = (rows - sentinel.before[group])[..., :failed]
        try:
            after = _state(sentinel.shape_after, rows, engine.state_offset)
            name = different_quantity(run_filter, state, epoch, after, [*np.moveaxis(tally, -1, 0)])
        except Exception as error:
            return f"numpy raises {type(error).__name__}: {error}"
        if name:
            return f"another {name}"
    return ""


def _silent(z: Any, data: Data, at: int) -> bool:
    """Whether a sensor has no measurement in this run, but has one in others."""
    parts = z if isinstance(z, tuple) else (z,)
    statuses = data.distinct[data.kinds[at]].z
    return any(
        status == PART and np.isnan(x).all() for status, x in zip(statuses, parts, strict=False)
    )


def different_quantity(filter: Any, state: Any, epoch: Any, after: Any, tally: list[Array]) -> str:
    """The name of a quantity in which a numpy step differs; "" if none does."""
    stepped, counts = _stepped(filter, state, epoch)
    # With machine code a `FixedLag` stores nothing: only beliefs are compared.
    memory = [role for _, role in tree_leaves(stepped)] == [role for _, role in tree_leaves(after)]
    xs, ys = list(_measured(stepped, counts, memory)), list(_measured(after, tally, memory))
    pairs = [(x, y) for (_, x, _), (_, y, _) in zip(xs, ys, strict=True)]
    sizes = [size for *_, size in xs]
    with np.errstate(all="ignore"):
        wrong = [i for i, (x, y) in enumerate(pairs) if not _within(CLOSE * sizes[i], x, y)]
    if not wrong:
        return ""
    broadcast_pairs = [np.broadcast_arrays(x, y) for x, y in pairs]
    close = DIFFERENCED if _has_taylor(filter) else CLOSE
    again = [value for _, value, _ in _measured(*_stepped(filter, state, epoch), memory)]
    if not all(np.array_equal(a[1], b, equal_nan=True) for a, b in zip(xs, again, strict=True)):
        return f"{xs[wrong[0]][0]}, and numpy gives another one at each call"
    moved = _moved(filter, state, epoch, memory)
    for i in wrong:
        x, y = broadcast_pairs[i]
        least = np.max([np.abs(values[i] - x) for values in moved], 0)
        # The runs are samples of the same round-off: the largest relative change of any run bounds
        # all runs.
        scaled = (sizes[i] > 0.0) & np.isfinite(least)
        relative = np.divide(least, sizes[i], out=np.zeros(x.shape), where=scaled)
        round_off = MOVES * np.maximum(least, relative.max(initial=0.0) * sizes[i])
        with np.errstate(all="ignore"):
            if not _within(close * sizes[i] + round_off, x, y):
                return xs[i][0]
    return ""


def _moved(filter: Any, state: Any, epoch: Any, memory: bool) -> list[list[Array]]:
    """The results of several numpy steps, with each number of the inputs changed by round-off."""
    rng = np.random.default_rng(0)
    token = WATCH.set(lambda _name, y: _nudged(y, rng))
    try:
        steps = (
            _stepped(filter, _nudged(state, rng), epoch._replace(z=_nudged(epoch.z, rng)))
            for _ in range(TRIES)
        )
        return [[value for _, value, _ in _measured(*step, memory)] for step in steps]
    finally:
        WATCH.reset(token)


def _has_taylor(thing: Any) -> bool:
    """Whether a filter, or a filter inside it, is an extended Kalman filter."""
    if isinstance(thing, tuple):
        return any(map(_has_taylor, thing))
    within = fields(thing) if is_dataclass(thing) and not isinstance(thing, type) else ()
    inner = (getattr(thing, field.name) for field in within)
    return isinstance(thing, Taylor) or any(map(_has_taylor, inner))


def _within(least: Array, x: Array, y: Array) -> bool:
    """Whether two values differ by at most the tolerance, or are equal, or both nan."""
    distance = np.abs(x - y)
    if (distance <= least).all():
        return True
    close = ~(distance > least) & (np.isnan(x) == np.isnan(y))
    return bool((close | (x == y)).all())


def _stepped(filter: Any, state: Any, epoch: Any) -> tuple[Any, list[Array]]:
    """The state after an epoch, and the increments of the counters."""
    with np.errstate(all="ignore"):
        state, infos = filter.step(state, epoch)
    if "belief" in getattr(state, "_fields", ()):
        state = state._replace(belief=mask_failed(state.belief))
    counts: list[Any] = [0.0] * COUNTERS.index("failed_at")
    for info in infos:
        if (likelihood := info.log_likelihood) is not None:
            counts[0] = counts[0] + likelihood
            if not info.used.all():
                absent = np.isnan(info.innovation)
                counts[1] = counts[1] + absent.sum(-1)
                counts[2] = counts[2] + (~info.used & ~absent).sum(-1)
        if info.redone is not None:
            counts[3] = counts[3] + info.redone
    return state, counts


def _measured(state: Any, tally: list[Any], memory: bool) -> Iterator[tuple[str, Array, Array]]:
    """Names, values and sizes of the quantities that must agree; without ``memory`` only of the
    belief.
    """
    mean: Any = None
    for x, role in tree_leaves(state if memory else state.belief):
        if role == "belief":
            mean = x
        elif role:
            P = x if role == "symmetric" else x @ x.mT
            std = np.sqrt(np.abs(P.diagonal(0, -2, -1)))
            fits = mean.shape[-1] == std.shape[-1]
            size = std if fits else std.max(-1, keepdims=True)
            yield "mean", mean, size + 2e-7 * np.abs(mean)
            yield "covariance", P, std[..., :, None] * std[..., None, :]
        else:
            values = np.asarray(x, float)
            size = np.abs(values)
            yield "memory", values, size + 1e-6 * size.max(initial=1e-3)
    for name, count in zip(COUNTERS, tally, strict=False):
        yield name, np.asarray(count, float), 1.0 + np.abs(np.asarray(count, float))


def _state(shape: Shape, rows: Array, state_offset: int) -> Any:
    """The filter's state from stored ``rows (..., size)``."""
    arrays, at = [], state_offset
    for dims, role, _ in shape.arrays:
        index = flat_entries(dims, role)
        values = rows[..., at : at + len(index)]
        at += len(index)
        if role in ("lower", "symmetric"):
            x = np.zeros((*rows.shape[:-1], math.prod(dims)))
            x[..., index] = values
            if role == "symmetric":
                mirrored = np.arange(x.shape[-1]).reshape(dims).swapaxes(-1, -2).ravel()[index]
                x[..., mirrored] = values
            values = x
        arrays.append(values.reshape((*rows.shape[:-1], *dims)))
    return tree_unflatten(shape.tree, iter(arrays))


def _nudged(tree: Any, rng: np.random.Generator) -> Any:
    """A tree with each number changed by one or two ulp, covariances symmetrically."""
    moved = []
    for x, role in tree_leaves(tree):
        ulps = rng.choice([-2.0, -1.0, 1.0, 2.0], np.shape(x))
        if role == "symmetric":
            lower = np.tril(ulps)
            ulps = lower + np.tril(lower, -1).mT
        moved.append(np.asarray(x) * (1.0 + EPS * ulps))
    return tree_unflatten(tree, iter(moved))


# -- what functions hold -----------------------------------------------------------------------
def model_contents(filter: Any) -> dict[str, Any]:
    """The contents of a filter's functions, by path: closures, attributes, and the global variables
    that they name.
    """
    contents: dict[str, Any] = {}
    _look(filter, "", contents, set(), DEEP)
    return contents


def restorer(filter: Any) -> Callable[[], None]:
    """A function that restores the present contents of the functions of a filter."""
    things: dict[str, Any] = {}
    _look(filter, "", {}, set(), DEEP, things)
    undo = [step for thing in things.values() for step in _undoing(thing)]

    def restore() -> None:
        for step in undo:
            step()

    return restore


def _undoing(thing: Any) -> Iterator[Callable[[], None]]:
    """Functions that restore an object, as far as possible."""
    if isinstance(thing, np.ndarray):
        if thing.flags.writeable and thing.size <= SAMPLE:
            yield partial(np.copyto, thing, thing.copy())
    elif isinstance(thing, list | deque):
        yield partial(_refill, thing, thing.extend, thing.copy())
    elif isinstance(thing, dict | set):
        yield partial(_refill, thing, thing.update, thing.copy())
    elif isinstance(thing, FunctionType):
        for cell in thing.__closure__ or ():
            if cell != EMPTY:
                yield partial(setattr, cell, "cell_contents", cell.cell_contents)
        if not _is_ours(thing):
            names = set(_names(thing.__code__)) & thing.__globals__.keys()
            yield partial(thing.__globals__.update, {k: thing.__globals__[k] for k in names})
    elif isinstance(thing, np.random.Generator):
        generator = thing.bit_generator
        yield partial(setattr, generator, "state", generator.state)
    if (
        hasattr(thing, "__dict__")
        and not isinstance(thing, ModuleType | type)
        and not _is_ours(thing)
    ):
        yield partial(_refill, vars(thing), vars(thing).update, dict(vars(thing)))


def _refill(thing: Any, fill: Callable[[Any], None], contents: Any) -> None:
    thing.clear()
    fill(contents)


class Watch:
    """The contents of a filter's models at its creation; `is_still` returns whether they are
    unchanged.

    Names and contents are compared by identity, which takes 1 or 2 µs. Objects that cannot be
    compared by identity, such as an iterator, are treated as changed: then `model_contents`
    decides.
    """

    def __init__(self, filter: Any):
        things: dict[str, Any] = {}
        self.holds: dict[str, Any] = {}
        _look(filter, "", self.holds, set(), DEEP, things)
        self._names = list[tuple[Any, str, Any]]()
        self._within = list[tuple[Any, Callable[[], Any], list[Any]]]()
        self._arrays, self._contents = list[Array](), list[bytes]()
        self._unsure = False
        for thing in things.values():
            self._note(thing)

    def _note(self, thing: Any) -> None:
        """Remember the contents of an object."""
        if isinstance(thing, FunctionType):
            cells = [cell for cell in thing.__closure__ or () if cell != EMPTY]
            self._names += [(cell, "", cell.cell_contents) for cell in cells]
            names = set() if _is_ours(thing) else set(_names(thing.__code__))
            space = thing.__globals__
            self._names += [
                (space, name, space[name])
                for name in sorted(names & space.keys())
                if not isinstance(space[name], ModuleType)
            ]
        elif isinstance(thing, np.ndarray):
            self._arrays.append(thing)
            self._contents.append(thing.tobytes())
            self._unsure |= thing.size > SAMPLE or thing.dtype.hasobject
        elif isinstance(thing, list | deque | dict | set):
            self._contain(thing)
        elif any(hasattr(thing, name) for name in GENERATES):
            self._unsure = True
        elif _is_ours(thing) or isinstance(thing, FIXED):
            pass  # their contents do not change, and are examined separately
        elif hasattr(thing, "__dict__"):
            self._contain(vars(thing))
        else:
            self._unsure = True

    def _contain(self, container: Any) -> None:
        """Remember the objects in a container."""
        contents = container.values if isinstance(container, dict) else container.__iter__
        self._within.append((container, contents, [*contents()]))

    def is_still(self) -> bool:
        """Whether everything is unchanged."""
        if self._unsure:
            return False
        for space, name, value in self._names:
            if (space.get(name) if name else space.cell_contents) is not value:
                return False
        for container, contents, before in self._within:
            if len(container) != len(before) or not all(map(is_, contents(), before)):
                return False
        return [array.tobytes() for array in self._arrays] == self._contents


def changed(before: dict[str, Any], after: dict[str, Any]) -> str:
    """The first path whose value has changed; "": none."""
    return next((k for k in {**before, **after} if before.get(k) != after.get(k)), "")


class Function(NamedTuple):
    """The identity of a function: its code, the place of its definition if it is the user's, and
    the number of objects in it.
    """

    code: CodeType
    place: str
    parts: int


def functions_of(holds: dict[str, Any], path: str = "") -> str:
    """Text with the places where the user's functions are defined, or of the function that contains
    the object at a path.
    """
    functions = {name: mark for name, mark in holds.items() if isinstance(mark, Function)}
    if around := [name for name in functions if path.startswith(name)]:
        functions = {around[-1]: functions[around[-1]]}
    places = [f"{name}: {mark.place}" for name, mark in functions.items() if mark.place][
        :MOST_NAMED
    ]
    return f" ({'; '.join(places)})" if places else ""


def _look(
    thing: Any,
    path: str,
    contents: dict[str, Any],
    visited: set[int],
    deep: int,
    things: dict[str, Any] | None = None,
) -> None:
    """Record the identity of an object and its contents by path; ``things``: also the objects."""
    if isinstance(thing, TracedScalar | TracedArray):  # left by a recording
        contents[path] = id(thing)
        return
    if isinstance(thing, bool | int | float | complex | str | bytes | np.number | None):
        contents[path] = repr(thing)
        return
    if id(thing) in visited:
        return
    if not deep:
        contents[path] = id(thing)
        return
    visited.add(id(thing))
    if things is not None:
        things[path] = thing
    parts = _parts_of(thing)
    if parts is None:
        contents[path] = _mark(thing)
    else:  # an object that is not examined further is identified by its address
        contents[path] = type(thing), len(parts), id(thing) if len(parts) >= SAMPLE else 0
    if isinstance(thing, FunctionType):
        code = thing.__code__
        place = f"{Path(code.co_filename).name}, line {code.co_firstlineno}"
        contents[path] = Function(code, "" if _is_ours(thing) else place, len(parts or ()))
    if isinstance(thing, AnyDimension):  # a rule, once made, does not change
        things = None
    for name, item in (parts or {}).items():
        _look(item, f"{path}.{name}" if path else name, contents, visited, deep - 1, things)


def _mark(thing: Any) -> Any:
    """The identity of an object without contents to be examined."""
    if isinstance(thing, np.ndarray):
        if thing.dtype.hasobject:
            return thing.shape, tuple(map(id, thing.ravel()[:SAMPLE]))
        sample = thing.ravel()[:: max(1, thing.size // SAMPLE)]
        whole = 0 if len(sample) == thing.size else id(thing)
        return thing.dtype, thing.shape, whole, crc32(np.ascontiguousarray(sample).tobytes())
    for name in GENERATES:
        if hasattr(thing, name) and not isinstance(thing, type):
            state = getattr(thing, name)
            return repr(state.state if name == "bit_generator" else state())
    return repr(thing) if type(thing).__module__ in ("itertools", "builtins") else id(thing)


def _parts_of(thing: Any) -> dict[str, Any] | None:
    """The contents of an object, by name; None if it is compared as a whole."""
    ours = _is_ours(thing)
    if isinstance(thing, ModuleType | type | np.ndarray | BuiltinFunctionType):
        return None
    if isinstance(thing, dict):
        return {repr(key): thing[key] for key in list(thing)[:SAMPLE]} | _attributes(thing)
    if isinstance(thing, list | tuple | deque):
        within = {str(i): item for i, item in zip(range(SAMPLE), thing, strict=False)}
        return within | _attributes(thing)
    if isinstance(thing, partial):
        arguments = {"func": thing.func, "args": thing.args, "keywords": thing.keywords}
        return arguments | _attributes(thing)
    if isinstance(thing, MethodType):
        return {"self": thing.__self__, "function": thing.__func__}
    if isinstance(thing, GeneratorType):
        return dict(thing.gi_frame.f_locals) if thing.gi_frame else {}
    if isinstance(thing, FunctionType):
        cells = zip(thing.__code__.co_freevars, thing.__closure__ or (), strict=True)
        parts = {name: cell.cell_contents for name, cell in cells if cell != EMPTY}
        parts |= {"defaults": thing.__defaults__, "keywords": thing.__kwdefaults__, **vars(thing)}
        named = set() if ours else set(_names(thing.__code__)) & thing.__globals__.keys()
        return parts | {name: thing.__globals__[name] for name in sorted(named)}
    if hasattr(thing, "__wrapped__"):  # a cached function
        return {"wrapped": thing.__wrapped__}
    if ours and is_dataclass(thing):
        return {field.name: getattr(thing, field.name) for field in fields(thing)}
    if ours and not str(type(thing).__module__).startswith("celnav"):
        return None
    holds = _attributes(thing)
    if ours:  # without private and cached attributes
        holds = {k: x for k, x in holds.items() if not (k[0] == "_" or _is_cached(thing, k))}
    return holds or ({} if hasattr(thing, "__dict__") else None)


def _attributes(thing: Any) -> dict[str, Any]:
    """The attributes and slots of an object."""
    attributes = dict(getattr(thing, "__dict__", {}))
    for kind in type(thing).__mro__:
        slots = vars(kind).get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            if hasattr(thing, name):
                attributes[name] = getattr(thing, name)
    return attributes


def _is_cached(thing: Any, name: str) -> bool:
    return isinstance(getattr(type(thing), name, None), cached_property)


def _is_ours(thing: Any) -> bool:
    return str(getattr(thing, "__module__", "")).partition(".")[0] in ("celnav", "numpy", "scipy")


def _names(code: CodeType) -> Iterator[str]:
    """Names that code, and the functions within it, may read from the module."""
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _names(inner)
