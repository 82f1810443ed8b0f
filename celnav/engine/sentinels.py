"""Machine code is compared with numpy at some epochs of each run, and models with memory are found.

A recorded step holds for a whole flight only if the model is a function of its arguments. Nothing
says that it is. So at a few epochs, spread over the flight, numpy takes the same step from the same
states. Round-off is judged by the state's conditioning: by how much numpy's own step moves when
each number of the state, the measurement and the models' values is moved by an ulp or two. And what
the functions of a filter hold must be the same after they were called.
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
    map_run_constants,
    places,
    tree_leaves,
    tree_unflatten,
)
from celnav.engine.runs import Sentinel, epoch_of, part_of
from celnav.filters.mixing import WATCH
from celnav.gaussian.belief import mask_failed
from celnav.gaussian.linalg import EPS, Array
from celnav.gaussian.rules import AnyDimension, Taylor
from celnav.tape.numbers import TracedArray
from celnav.tape.tape import TracedScalar

CLOSE = 1e-6  # of a standard deviation, or of the size of any other number
DIFFERENCED = 1e-4  # likewise where numpy takes differences and machine code has derivatives
MOVES = 1e3  # numpy's own movements by round-off of what it is given
TRIES = 3
SAMPLE = 4096  # numbers of a large array by which it is known
MOST_NAMED = 3  # functions of a message
DEEP = 16  # objects within objects
GENERATES = ("bit_generator", "get_state", "getstate")  # attributes of what draws random numbers
FIXED = (tuple, partial, MethodType, BuiltinFunctionType, ModuleType, type)
EMPTY = CellType()  # of a name that has no value yet


# -- the same step by numpy --------------------------------------------------------------------
def difference(
    filter: Any, engine: Engine, data: Data, sentinel: Sentinel, watched: Sequence[int]
) -> str:
    """What the numpy engine computes otherwise from the states before a sentinel; empty:
    nothing."""
    failed = COUNTERS.index("failed_at")
    sound = np.flatnonzero((sentinel.before[:, failed] < 0) & (sentinel.after[:, failed] < 0))
    # Memories need not have the runs in front: then each run is taken alone.
    plain = len(sentinel.shape.arrays) == len(sentinel.shape_after.arrays) == 2
    groups: list[Any] = [sound] if plain and engine.batch else list(sound)
    for some in groups if len(sound) else ():
        runs = np.array(watched)[some]
        part = partial(part_of, batch=engine.batch, runs=runs)
        own = map_run_constants(filter, partial(part, own=2)) if engine.constants else filter
        epoch = epoch_of(data, sentinel.at, part, engine.batch)
        if not plain and _silent(epoch.z, data, sentinel.at):
            continue  # numpy calls no hook then, unless another run measures something
        state = _state(sentinel.shape, sentinel.before[some], engine.held)
        rows = sentinel.after[some]
        tally = (rows - sentinel.before[some])[..., :failed]
        try:
            after = _state(sentinel.shape_after, rows, engine.held)
            name = different_quantity(own, state, epoch, after, [*np.moveaxis(tally, -1, 0)])
        except Exception as error:
            return f"numpy raises {type(error).__name__}: {error}"
        if name:
            return f"another {name}"
    return ""


def _silent(z: Any, data: Data, at: int) -> bool:
    """Whether a sensor measured nothing of this run, but something of others."""
    parts = z if isinstance(z, tuple) else (z,)
    there = data.known[data.kinds[at]].z
    return any(what == PART and np.isnan(x).all() for what, x in zip(there, parts, strict=False))


def different_quantity(filter: Any, state: Any, epoch: Any, after: Any, tally: list[Array]) -> str:
    """What a step by numpy gives otherwise."""
    stepped, counts = _stepped(filter, state, epoch)
    # A fixed lag keeps nothing in machine code: then beliefs are compared.
    alike = [what for _, what in tree_leaves(stepped)] == [what for _, what in tree_leaves(after)]
    found, mine = list(_measured(stepped, counts, alike)), list(_measured(after, tally, alike))
    pairs = [(x, y) for (_, x, _), (_, y, _) in zip(found, mine, strict=True)]
    sizes = [size for *_, size in found]
    with np.errstate(all="ignore"):
        wrong = [i for i, (x, y) in enumerate(pairs) if not _within(CLOSE * sizes[i], x, y)]
    if not wrong:
        return ""
    apart = [np.broadcast_arrays(x, y) for x, y in pairs]
    close = DIFFERENCED if _has_taylor(filter) else CLOSE
    again = [value for _, value, _ in _measured(*_stepped(filter, state, epoch), alike)]
    if not all(np.array_equal(a[1], b, equal_nan=True) for a, b in zip(found, again, strict=True)):
        return f"{found[wrong[0]][0]}, and numpy gives another one at each call"
    moved = _moved(filter, state, epoch, alike)
    for i in wrong:
        x, y = apart[i]
        least = np.max([np.abs(each[i] - x) for each in moved], 0)
        # Each run is one draw of the same round-off: the largest movement, in sizes, is that of
        # all.
        there = (sizes[i] > 0.0) & np.isfinite(least)
        part = np.divide(least, sizes[i], out=np.zeros(x.shape), where=there)
        round_off = MOVES * np.maximum(least, part.max(initial=0.0) * sizes[i])
        with np.errstate(all="ignore"):
            if not _within(close * sizes[i] + round_off, x, y):
                return found[i][0]
    return ""


def _moved(filter: Any, state: Any, epoch: Any, memory: bool) -> list[list[Array]]:
    """What numpy's step gives where each number of it is moved by round-off, several times."""
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
    """Whether a filter, or one within it, is an extended one."""
    if isinstance(thing, tuple):
        return any(map(_has_taylor, thing))
    within = fields(thing) if is_dataclass(thing) and not isinstance(thing, type) else ()
    inner = (getattr(thing, field.name) for field in within)
    return isinstance(thing, Taylor) or any(map(_has_taylor, inner))


def _within(least: Array, x: Array, y: Array) -> bool:
    """Whether two values are that close, or the same, or both nan."""
    apart = np.abs(x - y)
    if (apart <= least).all():
        return True
    close = ~(apart > least) & (np.isnan(x) == np.isnan(y))
    return bool((close | (x == y)).all())


def _stepped(filter: Any, state: Any, epoch: Any) -> tuple[Any, list[Array]]:
    """The state after an epoch, and what its records add to the tally."""
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
    """Names, values and sizes of what is to agree; without ``memory``: of the belief alone."""
    mean: Any = None
    for x, what in tree_leaves(state if memory else state.belief):
        if what == "belief":
            mean = x
        elif what:
            P = x if what == "symmetric" else x @ x.mT
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


def _state(shape: Shape, rows: Array, held: int) -> Any:
    """The state of runs that is kept as ``rows (..., size)``."""
    arrays, at = [], held
    for own, what, _ in shape.arrays:
        index = places(own, what)
        values = rows[..., at : at + len(index)]
        at += len(index)
        if what in ("lower", "symmetric"):
            x = np.zeros((*rows.shape[:-1], math.prod(own)))
            x[..., index] = values
            if what == "symmetric":
                mirrored = np.arange(x.shape[-1]).reshape(own).swapaxes(-1, -2).ravel()[index]
                x[..., mirrored] = values
            values = x
        arrays.append(values.reshape((*rows.shape[:-1], *own)))
    return tree_unflatten(shape.tree, iter(arrays))


def _nudged(tree: Any, rng: np.random.Generator) -> Any:
    """A tree with each number moved by an ulp or two, covariances alike on both sides."""
    moved = []
    for x, what in tree_leaves(tree):
        way = rng.choice([-2.0, -1.0, 1.0, 2.0], np.shape(x))
        if what == "symmetric":
            lower = np.tril(way)
            way = lower + np.tril(lower, -1).mT
        moved.append(np.asarray(x) * (1.0 + EPS * way))
    return tree_unflatten(tree, iter(moved))


# -- what functions hold -----------------------------------------------------------------------
def model_contents(filter: Any) -> dict[str, Any]:
    """What the functions of a filter hold, by its path: closures, attributes, globals that they
    name.
    """
    found: dict[str, Any] = {}
    _look(filter, "", found, set(), DEEP)
    return found


def restorer(filter: Any) -> Callable[[], None]:
    """What gives back to the things that functions hold what they hold now."""
    things: dict[str, Any] = {}
    _look(filter, "", {}, set(), DEEP, things)
    undo = [step for thing in things.values() for step in _undoing(thing)]

    def restore() -> None:
        for step in undo:
            step()

    return restore


def _undoing(thing: Any) -> Iterator[Callable[[], None]]:
    """What sets a thing back, where it can be."""
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
    """What the models of a filter held when it was made; `is_still` looks whether they hold it yet.

    Names and contents are compared by identity, which takes a microsecond or two. What cannot be
    compared so, such as an iterator, counts as changed: then `model_contents` says.
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
        """Remember what a thing holds."""
        if isinstance(thing, FunctionType):
            cells = [cell for cell in thing.__closure__ or () if cell != EMPTY]
            self._names += [(cell, "", cell.cell_contents) for cell in cells]
            own = set() if _is_ours(thing) else set(_names(thing.__code__))
            space = thing.__globals__
            self._names += [
                (space, name, space[name])
                for name in sorted(own & space.keys())
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
            pass  # what they hold stays, and is looked at by itself
        elif hasattr(thing, "__dict__"):
            self._contain(vars(thing))
        else:
            self._unsure = True

    def _contain(self, container: Any) -> None:
        """Remember the things in a container."""
        contents = container.values if isinstance(container, dict) else container.__iter__
        self._within.append((container, contents, [*contents()]))

    def is_still(self) -> bool:
        """Whether all is as it was."""
        if self._unsure:
            return False
        for space, name, value in self._names:
            if (space.get(name) if name else space.cell_contents) is not value:
                return False
        for container, contents, known in self._within:
            if len(container) != len(known) or not all(map(is_, contents(), known)):
                return False
        return [array.tobytes() for array in self._arrays] == self._contents


def changed(before: dict[str, Any], after: dict[str, Any]) -> str:
    """The first path whose value is another one; empty: none."""
    return next((k for k in {**before, **after} if before.get(k) != after.get(k)), "")


class Function(NamedTuple):
    """What stands for a function: its code, where it is defined if it is the user's, how many
    things it holds.
    """

    code: CodeType
    place: str
    parts: int


def functions_of(holds: dict[str, Any], path: str = "") -> str:
    """Where the user's functions are defined, or the one that holds what is at a path."""
    found = {name: mark for name, mark in holds.items() if isinstance(mark, Function)}
    if around := [name for name in found if path.startswith(name)]:
        found = {around[-1]: found[around[-1]]}
    places = [f"{name}: {mark.place}" for name, mark in found.items() if mark.place][:MOST_NAMED]
    return f" ({'; '.join(places)})" if places else ""


def _look(
    thing: Any,
    path: str,
    found: dict[str, Any],
    seen: set[int],
    deep: int,
    things: dict[str, Any] | None = None,
) -> None:
    """Set what a thing is known by, and what it holds; ``things``: set the things themselves
    too."""
    if isinstance(thing, TracedScalar | TracedArray):  # left by a recording
        found[path] = id(thing)
        return
    if isinstance(thing, bool | int | float | complex | str | bytes | np.number | None):
        found[path] = repr(thing)
        return
    if id(thing) in seen:
        return
    if not deep:
        found[path] = id(thing)
        return
    seen.add(id(thing))
    if things is not None:
        things[path] = thing
    parts = _parts_of(thing)
    if parts is None:
        found[path] = _mark(thing)
    else:  # what is not looked at whole is known by its address
        found[path] = type(thing), len(parts), id(thing) if len(parts) >= SAMPLE else 0
    if isinstance(thing, FunctionType):
        code = thing.__code__
        place = f"{Path(code.co_filename).name}, line {code.co_firstlineno}"
        found[path] = Function(code, "" if _is_ours(thing) else place, len(parts or ()))
    if isinstance(thing, AnyDimension):  # a rule that is made stays
        things = None
    for name, part in (parts or {}).items():
        _look(part, f"{path}.{name}" if path else name, found, seen, deep - 1, things)


def _mark(thing: Any) -> Any:
    """What stands for a thing that holds nothing to be looked at."""
    if isinstance(thing, np.ndarray):
        if thing.dtype.hasobject:
            return thing.shape, tuple(map(id, thing.ravel()[:SAMPLE]))
        some = thing.ravel()[:: max(1, thing.size // SAMPLE)]
        whole = 0 if len(some) == thing.size else id(thing)
        return thing.dtype, thing.shape, whole, crc32(np.ascontiguousarray(some).tobytes())
    for name in GENERATES:
        if hasattr(thing, name) and not isinstance(thing, type):
            state = getattr(thing, name)
            return repr(state.state if name == "bit_generator" else state())
    return repr(thing) if type(thing).__module__ in ("itertools", "builtins") else id(thing)


def _parts_of(thing: Any) -> dict[str, Any] | None:
    """What a thing holds, by name; None where it is to be taken as a whole."""
    ours = _is_ours(thing)
    if isinstance(thing, ModuleType | type | np.ndarray | BuiltinFunctionType):
        return None
    if isinstance(thing, dict):
        return {repr(key): thing[key] for key in list(thing)[:SAMPLE]} | _attributes(thing)
    if isinstance(thing, list | tuple | deque):
        within = {str(i): part for i, part in zip(range(SAMPLE), thing, strict=False)}
        return within | _attributes(thing)
    if isinstance(thing, partial):
        own = {"func": thing.func, "args": thing.args, "keywords": thing.keywords}
        return own | _attributes(thing)
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
    if hasattr(thing, "__wrapped__"):  # a cache of a function's values
        return {"wrapped": thing.__wrapped__}
    if ours and is_dataclass(thing):
        return {one.name: getattr(thing, one.name) for one in fields(thing)}
    if ours and not str(type(thing).__module__).startswith("celnav"):
        return None
    holds = _attributes(thing)
    if ours:  # without what it makes when it is asked for
        holds = {k: x for k, x in holds.items() if not (k[0] == "_" or _is_cached(thing, k))}
    return holds or ({} if hasattr(thing, "__dict__") else None)


def _attributes(thing: Any) -> dict[str, Any]:
    """What an object holds by name."""
    found = dict(getattr(thing, "__dict__", {}))
    for kind in type(thing).__mro__:
        slots = vars(kind).get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            if hasattr(thing, name):
                found[name] = getattr(thing, name)
    return found


def _is_cached(thing: Any, name: str) -> bool:
    return isinstance(getattr(type(thing), name, None), cached_property)


def _is_ours(thing: Any) -> bool:
    return str(getattr(thing, "__module__", "")).partition(".")[0] in ("celnav", "numpy", "scipy")


def _names(code: CodeType) -> Iterator[str]:
    """Names that code, and the functions within it, may take from the module."""
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _names(inner)
