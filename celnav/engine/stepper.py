"""Single steps by machine code: a `Plan` is a kernel with permanent buffers.

A step copies the state and the measurement into the buffers, calls the kernel, and copies the new
state out. It serves real-time use, `celnav.steps` and a `FixedLag` with a compiled filter.
"""

from __future__ import annotations

import math
import struct
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from celnav.engine.recording import (
    COUNTERS,
    FULL,
    NONE,
    PART,
    SILENT,
    Data,
    Engine,
    EpochKind,
    Recorded,
    Shape,
    entries,
    tree_leaves,
    tree_unflatten,
)
from celnav.engine.runs import as_data
from celnav.engine.sentinels import Watch
from celnav.filters.records import Epoch, Info, State
from celnav.filters.sequential import measurements
from celnav.gaussian.linalg import Array
from celnav.tape import llvm
from celnav.tape.tape import CannotCompile

FLOAT = np.dtype(np.float64)
FAILED = COUNTERS.index("failed_at")
INFO_COLUMNS = ("innovation", "whitened", "used")
SILENT_INFO = Info(silent=True)
START = tuple(-1.0 if name == "failed_at" else 0.0 for name in COUNTERS)


# -- what a plan is chosen by --------------------------------------------------------------------
def plan_key(state: Any, epoch: Epoch) -> tuple[Any, list[float]]:
    """The properties that steps with the same plan share, and the numbers of the epoch, for one
    run.

    The numbers are k, t, the interval, the inputs and the measurements.
    """
    k, t, dt, u, z, _, about = epoch
    if type(state) is State and state.memory.count(None) == len(state.memory):
        mean, matrix = belief = state.belief
        shapes: Any = (type(belief), mean.shape, matrix.shape)
    else:
        shapes = Shape.of(state)
    if isinstance(dt, float) or not np.ndim(dt):
        dt = float(dt)
        moves: Any = dt != 0.0
        numbers = [k, t, dt]
    else:
        moves = np.shape(dt), bool(np.any(dt))
        numbers = [k, t, 0.0]
    inputs = None if u is None and about is None else _input_key((u, about), numbers)
    if isinstance(z, tuple):
        return (shapes, moves, inputs, *[_measurement_key(x, numbers) for x in z]), numbers
    return (shapes, moves, inputs, _measurement_key(z, numbers)), numbers


def _input_key(u: Any, numbers: list[float]) -> Any:
    """Shapes of an input, and whether it is finite; its numbers are appended to ``numbers``."""
    if u is None:
        return None
    if isinstance(u, tuple):
        return type(u), *(_input_key(x, numbers) for x in u)
    values = np.asarray(u, np.float64)
    if not values.ndim:
        numbers.append(float(values))
        return (), bool(np.isfinite(values))
    flat = values.ravel().tolist()
    numbers += flat
    # nan and infinity survive a sum, and their difference to themselves is not 0.
    total = sum(flat)
    return values.shape, total - total == 0.0 or bool(np.isfinite(values).all())


def _measurement_key(z: Any, numbers: list[float]) -> Any:
    """Status and shape of a measurement; its numbers are appended to ``numbers``."""
    if z is None:
        return NONE
    if type(z) is not np.ndarray or z.dtype is not FLOAT:
        z = np.asarray(z, np.float64)
    shape = z.shape
    if len(shape) != 1:
        missing = np.isnan(z)
        return shape, SILENT if missing.all() else PART if missing.any() else FULL
    flat = z.tolist()
    numbers += flat
    total = sum(flat)
    if total - total == 0.0:
        return shape, FULL
    count = sum(x != x for x in flat)
    return shape, SILENT if count == len(flat) else PART if count else FULL


# -- a state whose matrices are whole ------------------------------------------------------------
class _SingleStep(Engine):
    """An engine that starts from a given state of a filter, and stores full matrices in it."""

    def __init__(self, filter: Any, state: Any, data: Data, most: int):
        self.state = state
        super().__init__(filter, state.belief, data, most=most)

    def started(self, _prior: Any) -> tuple[Any, Any]:
        if not self.batch:
            return self.state, self.state
        first_run = []
        for x, role in tree_leaves(self.state):
            axes = 1 if role == "belief" else 2 if role else np.ndim(x)
            first_run.append(x[(0,) * (np.ndim(x) - axes)])
        return tree_unflatten(self.state, iter(first_run)), self.state

    def record(self, before: Shape, kind: EpochKind, u: list[tuple[Array, bool]]) -> Recorded:
        recorded = super().record(before, kind, u)
        if self.batch and not all(
            role for shape in (before, recorded.after) for _, role, _ in shape.arrays
        ):
            raise CannotCompile(
                "a filter that remembers more than a belief is stepped by machine code for "
                "one run only; celnav.run compiles several runs"
            )
        begin, end = (_places(shape, self.state_offset) for shape in (before, recorded.after))
        inputs = [
            (place, begin[at][0] if place == "state" else at)
            for place, at in recorded.kernel.inputs
        ]
        results: list[tuple[int, Any]] = []
        if before.arrays != recorded.after.arrays:  # the places of the state may have changed
            results = [(i, 0.0) for i in range(self.state_offset, end[-1][-1]) if (i,) not in end]
        results += [(place, x) for at, x in recorded.kernel.state for place in end[at]]
        return recorded._replace(kernel=recorded.kernel._replace(inputs=inputs, state=results))


def _places(shape: Shape, first: int) -> list[tuple[int, ...]]:
    """Positions of each number in a state with full matrices: two for an off-diagonal entry of a
    covariance.
    """
    positions: list[tuple[int, ...]] = [(i,) for i in range(first)]
    for array_shape, role, _ in shape.arrays:
        at = np.arange(first, first + int(np.prod(array_shape))).reshape(array_shape)
        for place in entries(array_shape, role):
            both = (place, place[::-1]) if role == "symmetric" and len(set(place)) > 1 else (place,)
            positions.append(tuple(int(at[index]) for index in both))
        first += at.size
    return positions


def _spans(shape: Shape, first: int) -> list[tuple[slice, tuple[int, ...]]]:
    """Position and shape of each array of such a state."""
    ends = first + np.cumsum(
        [0, *(int(np.prod(array_shape)) for array_shape, _, _ in shape.arrays)]
    )
    return [
        (slice(int(a), int(b)), array_shape)
        for a, b, (array_shape, _, _) in zip(ends[:-1], ends[1:], shape.arrays, strict=True)
    ]


# -- the step ------------------------------------------------------------------------------------
class Plan:
    """A step of a filter by machine code, for states and epochs with the same `plan_key`.

    Its buffers belong to one thread. ``left``: steps until numpy repeats a step for comparison, one
    in each ``interval``. ``watch``: the contents of the models.
    """

    def __init__(self, filter: Any, state: Any, epoch: Epoch, most: int):
        data = as_data(filter, [epoch])
        engine, kind = _SingleStep(filter, state, data, most), data.distinct[0]
        inputs = engine.inputs(data.u[kind.u], 1)
        lanes = llvm.lanes() if engine.batch else 1
        recorded = engine.recorded_as(engine.begin, kind, inputs)
        every = engine.columns().items()
        columns = {name: m for name, m in every if name.partition("/")[0] in INFO_COLUMNS}
        kernel = recorded.keeping([*columns])
        if engine.batch:
            kernel = kernel._replace(flags=frozenset())  # truth values are stored as numbers too
        self.left, self.interval = 0, 1
        self.batch, self.runs = engine.batch, math.prod(engine.batch)
        self.begin, self.end = (
            _spans(engine.begin, engine.state_offset),
            _spans(recorded.after, engine.state_offset),
        )
        self.tree, self.form = recorded.after.tree, engine.form
        plain = type(state) is State and len(self.begin) == len(self.end) == 2
        self.hooks = state.memory if plain else None

        width = -(-self.runs // lanes) * lanes  # the last vector may not be full
        size = max(spans[-1][0].stop for spans in (self.begin, self.end))
        self.start = np.zeros((width, size))
        self.start[:, FAILED] = -1.0
        if engine.constants:
            constants = [x.reshape(self.runs, -1) for x in engine.constants]
            self.start[: self.runs, len(COUNTERS) : engine.state_offset] = np.concatenate(
                constants, 1
            )
        self.widths, self.dt_per_run = engine.widths, engine.dt_per_run
        self.inputs_per_run = [per_run for _, per_run in inputs]  # which inputs differ by run
        shared = 3 + sum(x.size for x, per_run in inputs if not per_run)
        input_size = sum(
            math.prod(x.shape[1 + len(self.batch) :]) for x, per_run in inputs if per_run
        )
        run_size = sum(self.widths) + self.dt_per_run + input_size

        # One block of memory: numbers of the epoch, numbers of each run, states, and the stored
        # columns.
        sizes = [shared, run_size * width, size * width, *(m * width for m in columns.values())]
        # States are aligned to a cache line.
        first = -(shared + run_size * width) % (llvm.LINE // FLOAT.itemsize)
        ends = first + np.cumsum([0, *sizes])
        parts = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.memory = llvm.aligned((int(ends[-1]),))
        self.shared = self.memory[parts[0]]
        self.run_data = self.memory[parts[1]].reshape(run_size, width)
        self.work = self.memory[parts[2]].reshape(width // lanes, size, lanes)
        buffers = dict(zip(columns, (self.memory[span] for span in parts[3:]), strict=True))
        self.rows = [
            None if status == NONE else tuple(buffers[f"{name}/{i}"] for name in INFO_COLUMNS)
            for i, status in enumerate(kind.z)
        ]
        self.measured = max(1, sum(row is not None for row in self.rows))
        if not self.batch:
            numbers_of_state = self.memory[parts[2]]
            numbers_of_state[:] = self.start[0]
            self.tally = numbers_of_state[: len(COUNTERS)]
            self.into = [
                numbers_of_state[at].reshape(array_shape) for at, array_shape in self.begin
            ]
            self.out = [numbers_of_state[at].reshape(array_shape) for at, array_shape in self.end]
            self.rows = [
                row and (*row[:2], row[2].view(np.bool_)[: row[2].size])  # a truth value is a byte
                for row in self.rows
            ]
            numbers = struct.Struct(f"{shared + run_size + len(COUNTERS)}d")
            self.pack = partial(numbers.pack_into, self.memory.data, 8 * first)

        fields = self.memory.ctypes.data + 8 * ends[3:-1].astype(np.uint64)
        cells = llvm.aligned((max(1, kernel.cells), lanes))
        address = llvm.kernel_address(kernel, lanes)
        self.call = llvm.caller(address, self.work, self.shared, self.run_data, fields, cells)
        self.watch = Watch(filter)

    def step(
        self, state: Any, epoch: Epoch, numbers: list[float]
    ) -> tuple[Any, tuple[Info, ...]] | None:
        """The state after an epoch, and an `Info` of each sensor; None if a run fails."""
        if self.batch:
            return self._step_all(state, epoch)
        self.pack(*numbers, *START)
        if self.hooks is not None:
            self.into[0][...], self.into[1][...] = state.belief
        else:
            for place, (x, _) in zip(self.into, tree_leaves(state), strict=True):
                place[...] = x
        self.call()
        if self.tally.item(FAILED) >= 0.0:
            return None
        likelihood = self.tally[0] / self.measured
        infos = [
            SILENT_INFO
            if buffers is None
            else _info(buffers[0].copy(), buffers[1].copy(), buffers[2].copy(), likelihood)
            for buffers in self.rows
        ]
        if self.hooks is None:
            return tree_unflatten(self.tree, (x.copy() for x in self.out)), tuple(infos)
        mean, matrix = self.out
        belief = tuple.__new__(self.form, (mean.copy(), matrix.copy()))
        return tuple.__new__(State, (belief, self.hooks)), tuple(infos)

    def _step_all(self, state: Any, epoch: Epoch) -> tuple[Any, tuple[Info, ...]] | None:
        """Like `step`, for several runs; None if a run fails that had not failed before."""
        batch, runs = self.batch, self.runs

        def per_run(x: Any, array_shape: tuple[int, ...]) -> Array:
            return np.broadcast_to(x, (*batch, *array_shape)).reshape(runs, -1)

        # values (padded runs, size); work (blocks, size, lanes): run i is lane i % lanes of block i
        # // lanes. Padding repeats the last run.
        values = self.start.copy()
        for (x, _), (at, array_shape) in zip(tree_leaves(state), self.begin, strict=True):
            values[:runs, at] = per_run(x, array_shape)
        values[runs:] = values[runs - 1]
        blocks, size, lanes = self.work.shape
        self.work[...] = values.reshape(blocks, lanes, size).transpose(0, 2, 1)
        self.shared[:3] = epoch.k, epoch.t, 0.0 if self.dt_per_run else epoch.dt
        parts = zip(measurements(epoch.z, len(self.widths)), self.widths, strict=True)
        run_values = [per_run(z, (m,)) for z, m in parts if m]
        if self.dt_per_run:
            run_values.append(per_run(epoch.dt, ()))
        first = 3
        for (x, _), differs in zip(
            tree_leaves((epoch.u, epoch.about)), self.inputs_per_run, strict=True
        ):
            if differs:
                run_values.append(np.asarray(x).reshape(runs, -1))
            else:
                self.shared[first : first + np.size(x)] = np.ravel(x)
                first += np.size(x)
        if run_values:
            self.run_data[:, :runs] = np.concatenate(run_values, 1).T
            self.run_data[:, runs:] = self.run_data[:, runs - 1 : runs]
        self.call()
        out = np.array(self.work.transpose(0, 2, 1)).reshape(-1, size)[:runs]
        lost = out[:, FAILED] >= 0.0
        if lost.any():
            mean = state.belief.mean
            if not np.isnan(per_run(mean, mean.shape[-1:])[lost]).any(-1).all():
                return None
        self.tally = out[:, : len(COUNTERS)].reshape(*batch, len(COUNTERS))
        likelihood = self.tally[..., 0] / self.measured

        def row(buffer: Array) -> Array:
            values: Array = buffer.reshape(len(self.start), -1)[:runs]
            return values.reshape(*batch, values.shape[-1]).copy()

        sound = 1.0 - lost.reshape(*batch, 1)
        infos = [
            SILENT_INFO
            if buffers is None
            else _info(row(buffers[0]), row(buffers[1]), sound * row(buffers[2]) != 0.0, likelihood)
            for buffers in self.rows
        ]
        after = [out[:, at].reshape(*batch, *array_shape) for at, array_shape in self.end]
        return tree_unflatten(self.tree, iter(after)), tuple(infos)


def _info(innovation: Array, whitened: Array, used: Array, likelihood: Any) -> Info:
    """The `Info` of a sensor after a step by machine code."""
    # `tuple.__new__` takes a third of the time of `Info(...)`; likewise below.
    values = (innovation, whitened, used, None, None, None, None, False, likelihood, None)
    return tuple.__new__(Info, values)
