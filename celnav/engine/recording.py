"""The compiled engine: a filter's step is recorded on numbers that have no values yet, compiled,
and run over all epochs.

The recorded function is `Sequential.step`, or the step of another filter, unchanged: there is no
second implementation. A step is recorded for each *kind* of epoch (with or without an interval;
each sensor complete, partly missing, all nan or absent) and for each shape of the filter's memory.
The numpy engine repeats the runs that fail, because it is the reference and can explain the
failure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import fields, is_dataclass
from functools import cache, partial
from itertools import count, repeat
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.records import Epoch, Info, Inputs
from celnav.gaussian.belief import Gaussian, mask_failed
from celnav.gaussian.checks import describe, together
from celnav.gaussian.linalg import Array, Covariance, SquareRoot, present
from celnav.tape import llvm
from celnav.tape.kernel import Kernel
from celnav.tape.numbers import TracedArray
from celnav.tape.tape import (
    MOST,
    CannotCompile,
    Tape,
    TooLong,
    TracedScalar,
    as_number,
    cannot_compile,
    emit,
    operands,
)

COUNTERS = ("log_likelihood", "missing", "rejected", "redone", "failed_at")
"""The sums and counts of each run; they come first in its state."""


# -- trees: nested tuples of arrays ----------------------------------------------------------------
def tree_leaves(tree: Any, role: str = "") -> Iterator[tuple[Any, str]]:
    """Arrays of a tree, and the role of each: "lower" a root, "symmetric" a covariance, "belief" a
    mean, "" anything else.
    """
    if isinstance(tree, SquareRoot | Covariance):
        yield tree[0], "belief"
        yield tree[1], "lower" if isinstance(tree, SquareRoot) else "symmetric"
    elif isinstance(tree, tuple):
        for item in tree:
            yield from tree_leaves(item, role)
    elif tree is not None:
        yield tree, role


def tree_unflatten(tree: Any, parts: Iterator[Any]) -> Any:
    """The tree with its arrays replaced, in the order of `tree_leaves`."""
    if tree is None:
        return None
    if not isinstance(tree, tuple):
        return next(parts)
    make: Any = type(tree)
    inner = [tree_unflatten(item, parts) for item in tree]
    return make(*inner) if hasattr(tree, "_fields") else tuple(inner)


@cache
def entries(shape: tuple[int, ...], role: str) -> tuple[tuple[int, ...], ...]:
    """Indices of the stored numbers of an array: the lower triangle of a root or covariance, all
    numbers of any other array.
    """
    places = tuple(np.ndindex(*shape))
    lower = role in ("lower", "symmetric")
    return tuple(at for at in places if at[-1] <= at[-2]) if lower else places


@cache
def flat_entries(shape: tuple[int, ...], role: str) -> Array:
    """Positions of the stored numbers in the array flattened by rows."""
    index = np.arange(math.prod(shape)).reshape(shape)
    lower = role in ("lower", "symmetric")
    return index[np.tril(np.ones(shape, bool))] if lower else index.ravel()


class Shape(NamedTuple):
    """Shape of a filter's state: its tree, with the index of each array in its place; and for each
    array the shape, the role and the mask of entries that may be nan.
    """

    tree: Any
    arrays: tuple[tuple[tuple[int, ...], str, tuple[bool, ...]], ...]

    @property
    def size(self) -> int:
        """How many numbers are stored."""
        return sum(len(entries(shape, role)) for shape, role, _ in self.arrays)

    @classmethod
    def of(cls, state: Any) -> Shape:
        """The shape of a state of one run."""
        arrays = []
        for array, role in tree_leaves(state):
            x = np.asanyarray(array)
            indices = entries(x.shape, role)
            absent = (False,) * len(indices) if role else tuple(_absent(x[at]) for at in indices)
            arrays.append((x.shape, role, absent))
        return cls(tree_unflatten(state, iter(range(len(arrays)))), tuple(arrays))


def _absent(x: Any) -> bool:
    """Whether a number depends on an input that may be missing."""
    return x.tape.absent[x.i] if isinstance(x, TracedScalar) else bool(x != x)


# -- kinds of epochs -------------------------------------------------------------------------------
FULL, PART, SILENT, NONE = range(4)
"""Measurements of a sensor at an epoch: all components of all runs; some components; only nan;
None.
"""


class EpochKind(NamedTuple):
    """The properties that epochs with the same recorded step share. ``z``: the status of each
    sensor; ``u``: the shape of the inputs.
    """

    moves: bool
    z: tuple[int, ...]
    u: Any


class Data(NamedTuple):
    """Epochs as columns.

    k, t, dt: ``(T,)``. kinds: of each epoch, an index into ``distinct``. z: ``(T, ..., m)`` of each
        sensor.
    u: for each shape of the inputs, ``about`` included: the indices of the epochs with this shape,
        and the input arrays ``(K, ...)``.
    """

    k: Array
    t: Array
    dt: Array
    kinds: Array
    distinct: list[EpochKind]
    sensors: Sequence[Any]
    z: list[Array]
    u: dict[Any, Inputs]

    @property
    def interval(self) -> float | None:
        """The length of the interval if it is always the same, and thus a constant of the program.

        None also for a single epoch, because the next interval may differ.
        """
        moving = self.dt[self.dt != 0.0]
        same = len(self.dt) > 1 and moving.size and (moving == moving[0]).all()
        return float(moving[0]) if same else None


class Start(NamedTuple):
    """The state before the first epoch.

    shape: of the state. parts: ``(runs, k)``, or ``(1, k)`` if equal in all runs, in stored order:
        the counters, the filter's matrices that differ between runs, then the state. common:
        entries of the state that are equal in all runs.
    """

    shape: Shape
    parts: list[Array]
    common: frozenset[int]

    @property
    def numbers(self) -> Array:
        """All stored numbers, ``(runs, size)``."""
        runs = max(map(len, self.parts))
        return np.concatenate([np.broadcast_to(x, (runs, x.shape[1])) for x in self.parts], 1)

    @property
    def first(self) -> Array:
        """The stored numbers of the first run, ``(size,)``."""
        return np.concatenate([x[0] for x in self.parts])


def signature(prior: Any, data: Data) -> tuple[Any, ...]:
    """The properties that priors and epochs share if one `Engine` can run them."""
    cov: Any = prior[1] if isinstance(prior, SquareRoot | Covariance) else getattr(prior, "cov", 0)
    shapes = [np.shape(x) for x in (getattr(prior, "mean", 0), cov)]
    z = tuple(x.shape[1:] for x in data.z)
    return type(prior), *shapes, z, data.dt.shape[1:], data.interval


class Recorded(NamedTuple):
    """A recorded step: a kernel with all rows, the shape of the state after it, and its number of
    operations.

    columns: names of the rows' quantities, in order, and the size of each.
    """

    kernel: Kernel
    after: Shape
    size: int
    columns: dict[str, int]

    def keeping(self, names: Sequence[str]) -> Kernel:
        """The kernel with the rows of the named columns only; each column is a field."""
        rows, fields, first = list[Any](), list[int](), 0
        for name, size in self.columns.items():
            if name in names:
                rows += self.kernel.rows[first : first + size]
                fields.append(size)
            first += size
        flags = frozenset(i for i, name in enumerate(names) if name.startswith("used"))
        return self.kernel._replace(rows=rows, fields=tuple(fields), flags=flags)


class Code(NamedTuple):
    """Machine code of a recorded step.

    each: address of the code for each vector of runs. once: address of the code that runs once for
        all runs, or None; its ``results`` are shared inputs of ``each``, starting at ``first``.
        cells: number of memory cells.
    """

    each: int
    cells: int
    once: int | None = None
    first: int = 0
    results: int = 0


class StepCache:
    """The recorded steps of a filter, and their machine code, with the properties that they depend
    on as keys.

    longer: for a step whose recording stopped at a limit, this limit. Such a step is recorded again
        only after the limit has doubled.
    """

    def __init__(self) -> None:
        self.records, self.longer = dict[Any, Recorded](), dict[Any, int]()
        self.code, self.engines = dict[Any, Any](), dict[Any, Engine]()

    def __bool__(self) -> bool:
        return bool(self.records)

    def shared(self) -> StepCache:
        """The same records and code, for another filter."""
        other = StepCache()
        other.records, other.code = self.records, self.code
        return other


class Engine:
    """Records and compiles the steps of a filter, for runs with the batch axes ``batch``.

    One engine serves all priors and data with the same `signature`.

    most: largest number of operations of a step. rolled: whether long code that repeats for several
        rows becomes a loop.
    stride: how many numbers of the compiled state represent one number of the filter's state.
    """

    stride = 1

    def __init__(
        self,
        filter: Any,
        prior: Any,
        data: Data,
        cache: StepCache | None = None,
        *,
        most: int = MOST,
        rolled: bool = True,
    ):
        self.filter, self.most, self.rolled = filter, most, rolled
        self.cache = StepCache() if cache is None else cache
        self.schedules, self.named = dict[Any, Any](), dict[frozenset[str], tuple[str, ...]]()
        if not hasattr(prior, "mean"):
            raise TypeError(f"prior: expected one Gaussian, for all models, got {describe(prior)}")
        constants: list[Array] = []

        def collect(array: Array) -> Array:
            constants.append(array)
            return array

        map_run_constants(filter, collect)
        axes = {f"z{i}": z.shape[1:-1] for i, z in enumerate(data.z)}
        # The axes of runs are broadcast from the prior, the measurements, the intervals and the
        # filter's arrays.
        axes |= {f"matrix {i}": array.shape[:-2] for i, array in enumerate(constants)}
        self.batch = together(
            mean=prior.mean.shape[:-1], cov=prior.cov.shape[:-2], dt=data.dt.shape[1:], **axes
        )
        if 0 in self.batch:
            raise CannotCompile("there are no runs")
        self.runs = math.prod(self.batch)
        self.constants = [
            np.broadcast_to(array, (*self.batch, *array.shape[-2:])) for array in constants
        ]
        self.tally = np.zeros((self.runs, len(COUNTERS)))
        self.tally[:, COUNTERS.index("failed_at")] = -1.0
        self.state_offset = len(COUNTERS) + sum(math.prod(x.shape[-2:]) for x in constants)
        self.dt = data.interval
        self.dt_per_run = data.dt.ndim > 1  # the interval differs between runs
        self.widths = [z.shape[-1] for z in data.z]
        self.innovations = [
            sensor.space.minus(z[:1], z[:1]).shape[-1] if z.shape[-1] else 0
            for sensor, z in zip(data.sensors, data.z, strict=True)
        ]
        state, _ = self.started(prior)
        self.belief, self.form, self.begin = state.belief, type(state.belief), Shape.of(state)

    def started(self, prior: Any) -> tuple[Any, Any]:
        """The state before the first epoch, for the first run alone and for all runs."""
        if not self.batch:
            state = self.filter.start(prior)
            return state, state
        # The step is recorded for the first run, which represents all runs.
        first_run = map_run_constants(self.filter, lambda array: array[(0,) * (array.ndim - 2)])
        return first_run.start(_first_run(prior)), self.filter.start(prior)

    def columns(self) -> dict[str, int]:
        """Names of the quantities of a step that can be stored, and their sizes."""
        (N,), (n, _) = (np.shape(x) for x in self.belief)
        sizes = {"mean": N, "std": n, "cov": n * n}
        for i, m in enumerate(self.innovations):
            sizes |= {f"{name}/{i}": m for name in ("innovation", "whitened", "used")}
        return sizes | {f"R/{i}": self.innovations[i] for i in self.adapted()}

    def keeping(self, rows: Collection[str]) -> tuple[str, ...]:
        """Names of the columns that a track with these rows needs; with innovations also the noise
        variances from hooks.
        """
        wanted = frozenset({*rows, "R"} if "innovation" in rows else rows)
        if wanted not in self.named:
            every = self.columns()
            self.named[wanted] = tuple(x for x in every if x.partition("/")[0] in wanted)
        return self.named[wanted]

    def adapted(self) -> list[int]:
        """Sensors whose noise hooks may change."""
        hooks = getattr(self.filter, "hooks", ())
        return [i for i, sensor_hooks in enumerate(hooks) if sensor_hooks and self.innovations[i]]

    def start(self, prior: Any) -> Start:
        """The state before the first epoch."""
        state, states = self.started(prior)
        shape = Shape.of(state)
        axes, first, common = len(self.batch), self.state_offset, set[int]()
        parts = [self.tally, *(x.reshape(self.runs, -1) for x in self.constants)]
        for (x, role), (array_shape, _, _) in zip(tree_leaves(states), shape.arrays, strict=True):
            values = np.asarray(x, np.float64)
            if values.shape != (*self.batch, *array_shape):
                values = np.broadcast_to(values, (*self.batch, *array_shape))
            # Strides of 0 along the runs: a broadcast array, equal in all runs.
            shared = not any(values.strides[:axes])
            if shared:
                values = values[(0,) * axes]
            rows = values.reshape(1 if shared else self.runs, -1)
            matrix = role in ("lower", "symmetric")
            parts.append(rows[:, flat_entries(array_shape, role)] if matrix else rows)
            count = parts[-1].shape[1]
            if shared:
                common.update(range(first, first + count))
            first += count
        return Start(shape, parts, frozenset(common))

    def inputs(self, inputs: Inputs, count: int) -> list[tuple[Array, bool]]:
        """The arrays of the inputs over ``count`` epochs, zero at epochs without them, and for each
        array whether it has axes of runs.
        """
        out = []
        for x in inputs.columns:
            values = x
            # Epochs with another input shape have zeros here.
            if len(x) < count:
                values = np.zeros((count, *x.shape[1:]))
                values[inputs.at] = x
            out.append((values, is_per_run(x[0], self.batch)))
        return out

    def recorded_as(self, before: Shape, kind: EpochKind, u: list[tuple[Array, bool]]) -> Recorded:
        """The recorded step."""
        key = before, kind, self.forms(u), self.dt, tuple(self.widths), bool(self.batch)
        if key not in self.cache.records:
            longer = self.cache.longer.get(key, 0)
            if longer and self.most < 2 * longer:  # do not try again in each run
                raise self._too_long(f"more than {longer}")
            try:
                self.cache.records[key] = self.record(before, kind, u)
            except TooLong:
                self.cache.longer[key] = self.most
                if self.most == MOST:
                    raise
                raise self._too_long(f"more than {self.most}") from None
        recorded = self.cache.records[key]
        self.check_length(recorded)
        return recorded

    def _too_long(self, size: Any) -> TooLong:
        """The error for a step with too many operations."""
        return TooLong(
            f"a step of {size} operations takes longer than it saves: at most {self.most} "
            "are compiled"
        )

    def check_length(self, recorded: Recorded) -> None:
        """Raise `TooLong` if a step is too long for this run, even if it was compiled for another
        filter.
        """
        if recorded.size > self.most:
            raise self._too_long(recorded.size)

    def forms(self, u: list[tuple[Array, bool]]) -> tuple[Any, ...]:
        """For each array of an input: its shape, whether each run has its own, and whether it is
        finite.
        """
        axes = len(self.batch)
        return tuple(
            (x.shape[1 + axes * per_run :], per_run, bool(np.isfinite(x).all())) for x, per_run in u
        )

    def code(self, recorded: Recorded, lanes: int, names: Sequence[str], split: Any = None) -> Code:
        """Machine code of a recorded step that stores some columns; ``split``: into the common part
        and the part of each run.
        """
        key = id(recorded), lanes, tuple(names), id(split)
        if key not in self.cache.code:
            if split is None:
                kernel = recorded.keeping(names)
                code = Code(llvm.kernel_address(kernel, lanes), kernel.cells)
            else:
                code = Code(
                    llvm.kernel_address(split.each, lanes),
                    max(split.once.cells, split.each.cells),
                    llvm.kernel_address(split.once, 1),
                    split.first,
                    len(split.once.rows),
                )
            self.cache.code[key] = code
        machine_code: Code = self.cache.code[key]
        return machine_code

    def record(self, before: Shape, kind: EpochKind, u: list[tuple[Array, bool]]) -> Recorded:
        """Record the step from a state with this shape over an epoch of this kind."""
        tape, inputs = Tape(self.rolled, self.most), list[tuple[str, int]]()

        def take(place: str, at: int, absent: bool = False) -> TracedScalar:
            inputs.append((place, at))
            return tape.input(absent)

        def traced_array(
            shape: Any,
            role: str,
            place: str,
            at: Iterable[int],
            absent: Iterable[bool] = repeat(False),
        ) -> TracedArray:
            """An array of traced numbers; ``at``: the positions of its stored numbers."""
            x = TracedArray(shape)
            for where, i, missing in zip(entries(shape, role), at, absent, strict=False):
                x[where] = take(place, i, missing)
                if role == "symmetric":
                    x[where[::-1]] = x[where]
            return x

        # A state in order: counters, run constants, then the arrays of the filter.
        tally, positions = [take("state", i) for i in range(len(COUNTERS))], count(len(COUNTERS))
        # Matrices that differ from run to run are inputs too: they follow the counters in the
        # state.
        filter = map_run_constants(
            self.filter, lambda array: traced_array(array.shape[-2:], "", "state", positions)
        )
        arrays = [
            traced_array(shape, role, "state", positions, absent)
            for shape, role, absent in before.arrays
        ]
        state = tree_unflatten(before.tree, iter(arrays))

        z: list[Any] = []
        first = 0
        for m, status in zip(self.widths, kind.z, strict=True):
            if status in (FULL, PART):
                z.append(traced_array((m,), "", "own", count(first), repeat(status == PART)))
            else:
                z.append(np.full(m, np.nan) if status == SILENT else None)
            first += m
        at_dt, first = first, first + self.dt_per_run
        # Inputs shared by all runs follow k, t and dt; inputs that differ between runs follow the
        # measurements.
        shared, inputs_u = 3, []
        for (values, per_run), (_, role) in zip(u, tree_leaves(kind.u[0]), strict=True):
            shape = values.shape[1 + len(self.batch) * per_run :]
            places = np.arange(int(np.prod(shape))).reshape(shape) + (first if per_run else shared)
            x = traced_array(
                shape,
                role,
                "own" if per_run else "shared",
                (int(places[where]) for where in entries(shape, role)),
                repeat(not np.isfinite(values).all()),
            )
            first, shared = first + places.size * per_run, shared + places.size * (not per_run)
            inputs_u.append(x if shape else x[()])
        k: Any = take("shared", 0)
        t = take("shared", 1)
        dt: Any = 0.0
        if kind.moves:
            dt = (
                self.dt
                if self.dt is not None
                else take("own", at_dt)
                if self.dt_per_run
                else take("shared", 2)
            )
        u_epoch, about = tree_unflatten(kind.u[0], iter(inputs_u))
        epoch = Epoch(
            k, t, dt, u_epoch, z[0] if len(z) == 1 else tuple(z) if z else None, about=about
        )

        # The filter runs once, on numbers without values: this is the whole recording.
        state, infos = filter.step(state, epoch)
        if tape.refusal is not None:  # a model caught the error and continued
            raise tape.refusal
        # A recorded model computes one run and must not use measurements, which have an axis of all
        # runs.
        measured = {x.i for sample in z for x in np.ravel(sample) if isinstance(x, TracedScalar)}
        if self.batch and any(
            tape.modeled[i] and not measured.isdisjoint(operands(op))
            for i, op in enumerate(tape.ops)
        ):
            raise cannot_compile(
                "a model reads epoch.z, the measurements of all runs; pass it what it needs in u"
            )
        after = Shape.of(state)
        if "belief" in getattr(state, "_fields", ()):
            state = state._replace(belief=self._mask_failed_mean(state.belief))
        tally = self._count(tally, state.belief, infos, k)
        # Results written to the state: counters first, then the arrays from the offset on.
        stored = [(i, x) for i, x in enumerate(tally)]
        at = self.state_offset
        for array, role in tree_leaves(state):
            x = np.asanyarray(array)
            for place in entries(x.shape, role):
                stored.append((at, x[place]))
                at += 1
        columns = self.columns()
        rows = list(self._rows(state.belief, infos)) if columns else []
        kernel = Kernel(tape, inputs, stored, rows)
        kernel.results()  # adds its constants to the tape while the limit still applies
        tape.most = MOST
        return Recorded(kernel, after, len(tape.ops), columns)

    def _mask_failed_mean(self, belief: Any) -> Any:
        """The belief, with mean nan if the run has failed; with a single run the matrix becomes nan
        too.

        With several runs the matrix does not change, because runs may share it. The numpy engine
        computes the rows of failed runs.
        """
        if not self.batch:
            return mask_failed(belief)
        return type(belief)(np.where(belief.lost()[..., None], np.nan, belief.mean), belief[1])

    def _count(self, tally: list[Any], belief: Any, infos: Sequence[Info], k: Any) -> list[Any]:
        """Log-likelihood, counts of missing and rejected components, and the epoch of a failure; as
        in `celnav.filters.track.Collector`.
        """
        # The order of `COUNTERS`.
        likelihood, missing, rejected, redone, failed = tally
        for info in infos:
            if (more := info.log_likelihood) is not None:
                likelihood = emit("add", likelihood, _as_scalar(more))
                absent = ~present(np.asanyarray(info.innovation))
                missing = emit("add", missing, _as_scalar(np.add.reduce(absent, -1, int)))
                rejected = emit(
                    "add",
                    rejected,
                    _as_scalar(np.add.reduce(~np.asanyarray(info.used) & ~absent, -1, int)),
                )
            if info.redone is not None:
                redone = emit("add", redone, as_number(_as_scalar(info.redone)))
        lost = emit("and", _as_scalar(belief.lost()), emit("lt", failed, 0.0))
        return [likelihood, missing, rejected, redone, emit("select", lost, k, failed)]

    def _rows(self, belief: Any, infos: Sequence[Info]) -> Iterator[Any]:
        """The quantities of an epoch that may be stored, in the order of `columns`."""
        yield from belief.mean
        yield from belief.std
        yield from np.ravel(belief[1])
        for info, m in zip(infos, self.innovations, strict=True):
            for name, blank in (("innovation", np.nan), ("whitened", 0.0), ("used", 0.0)):
                value = getattr(info, name)
                yield from np.full(m, blank) if value is None else value
        for i in self.adapted():
            R = infos[i].R
            yield from np.full(self.innovations[i], np.nan) if R is None else R


def is_per_run(x: Array, batch: tuple[int, ...]) -> bool:
    """Whether an input has axes of runs before its other axes; an input without other axes is
    shared.
    """
    return 0 < len(batch) < x.ndim and x.shape[: len(batch)] == batch


def _as_scalar(x: Any) -> Any:
    """A number, also if it was an array of shape ()."""
    return x[()] if isinstance(x, np.ndarray) else x


def map_run_constants(thing: Any, function: Callable[[Array], Array]) -> Any:
    """The filter with ``function`` applied to the arrays that differ from run to run: matrices
    ``(..., n, m)`` with axes of runs.
    """

    def matrices(array: Array) -> Array:
        return function(array) if array.ndim > 2 else array

    def gaussian(belief: Gaussian) -> Gaussian:
        mean = belief.mean
        if mean.ndim > 1:  # differs between runs: a matrix (..., n, 1)
            mean = function(mean[..., None])[..., 0]
        arrays = {"mean": mean, "cov": matrices(belief.cov), "sqrt_cov": matrices(belief.sqrt_cov)}
        same: Gaussian = _changed(belief, arrays)
        return same

    return map_constants(thing, matrices, gaussian)


def map_constants(
    thing: Any,
    function: Callable[[Array], Array],
    gaussian: Callable[[Gaussian], Gaussian] = lambda belief: belief,
) -> Any:
    """The filter with ``function`` applied to its arrays; the same object if no array changes.

    gaussian: the function for Gaussians.
    """
    if isinstance(thing, np.ndarray):
        return function(thing)
    if isinstance(thing, Gaussian):
        return gaussian(thing)
    if isinstance(thing, partial):
        items = (thing.func, *thing.args)
        return (
            thing
            if (inner := map_constants(items, function, gaussian)) is items
            else partial(*inner, **thing.keywords)
        )
    if isinstance(thing, tuple):
        make: Any = type(thing)
        parts = [map_constants(item, function, gaussian) for item in thing]
        if all(a is b for a, b in zip(parts, thing, strict=True)):
            return thing
        return make(*parts) if hasattr(thing, "_fields") else tuple(parts)
    if not is_dataclass(thing) or isinstance(thing, type):
        return thing
    values = {
        name: getattr(thing, name)
        for name in sorted({field.name for field in fields(thing)} | set(vars(thing)))
    }
    return _changed(
        thing, {name: map_constants(value, function, gaussian) for name, value in values.items()}
    )


def _changed(thing: Any, attributes: dict[str, Any]) -> Any:
    """A copy with other attributes; the same object if no attribute changes."""
    if all(getattr(thing, name) is value for name, value in attributes.items()):
        return thing
    other = copy(thing)
    other.__dict__.update(attributes)
    return other


def _first_run(prior: Any) -> Any:
    """The prior of the first run."""
    form = Covariance if isinstance(prior, Covariance) else SquareRoot
    mean, factor = form.of(prior)
    return form(mean[(0,) * (mean.ndim - 1)], factor[(0,) * (factor.ndim - 2)])
