"""Runs of a compiled step: epochs as columns, blocks of runs through all epochs, and the stored
rows.

The states of some runs before and after some epochs are also stored, for comparison with numpy's
steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from celnav.engine import memory
from celnav.engine.recording import (
    COUNTERS,
    FULL,
    NONE,
    PART,
    SILENT,
    Code,
    Data,
    Engine,
    EpochKind,
    Recorded,
    Shape,
    Start,
    is_per_run,
    tree_leaves,
    tree_unflatten,
)
from celnav.filters.model import Sensor
from celnav.filters.records import Epoch, Epochs, Inputs, check_interval
from celnav.filters.sequential import as_measurement, measurements
from celnav.gaussian.checks import numbers
from celnav.gaussian.linalg import Array
from celnav.tape import llvm, ptx
from celnav.tape.cuda import Device
from celnav.tape.tape import CannotCompile, TracedScalar

RANDOM_SENTINELS = 4  # sentinels besides the first, the last and one for each recorded step
MANY = 20  # sensors; more would overflow the integer that encodes the kinds of epochs
SHORT = 10_000  # most epochs of a run whose schedule is stored
MOST_SCHEDULES = 16  # schedules stored for an engine
# Number of operations common to all runs from which on they are computed once per epoch.
APART = 100
MOST_COMMON = 1 << 25  # most results of the common operations in memory
CHUNK = 1 << 21  # bytes of measurements in a chunk of runs, which fit in the cache
HOST = 1 << 32  # bytes of measurements in all chunks on a device at the same time


def sensors(filter: Any, epochs: Sequence[Epoch] = ()) -> Sequence[Any]:
    """Sensors of a filter, or of the first filter inside it. For any other filter: stand-ins for
    measurements with the shapes of the first epoch.
    """
    while not hasattr(filter, "sensors"):
        if (filter := getattr(filter, "first", getattr(filter, "filter", None))) is None:
            z = epochs[0].z if len(epochs) else None
            count = len(z) if isinstance(z, tuple) else 1
            return (Sensor(lambda x, _epoch: x, R=lambda _mean, _epoch: np.eye(1)),) * count
    return tuple(filter.sensors)


def as_data(filter: Any, epochs: Epochs | Sequence[Epoch]) -> Data:
    """Epochs as columns."""
    if not len(epochs):
        raise ValueError("epochs: expected at least one, got none")
    filter_sensors = sensors(filter, epochs)
    if isinstance(epochs, Epochs) and epochs.columnar:
        k, t, dt, inputs, z = epochs.columns(len(filter_sensors))
        groups: list[Any] = [(group.at, group.columns, _parts(group.columns)) for group in inputs]
    else:
        before = None
        for epoch in epochs:
            check_interval(filter, epoch, before)
            before = epoch.t
            if not isinstance(epoch.k, int | float | np.integer | np.floating):
                raise CannotCompile(f"epochs: expected numbers k, got {epoch.k!r}")
        k, t = (
            np.array([epoch.k for epoch in epochs], np.float64),
            np.array([epoch.t for epoch in epochs]),
        )
        dt = np.stack(np.broadcast_arrays(*(np.asarray(epoch.dt, np.float64) for epoch in epochs)))
        pairs = [(epoch.u, epoch.about) for epoch in epochs]
        groups = [([i], pair, [x[None] for x in _parts(pair)]) for i, pair in enumerate(pairs)]
        z = tuple(
            zip(*(measurements(epoch.z, len(filter_sensors)) for epoch in epochs), strict=True)
        )
    which, u = _group_inputs(groups, len(k))
    measured = [_measured(sensor, parts) for sensor, parts in zip(filter_sensors, z, strict=True)]
    moves = (dt.reshape(len(k), -1) != 0.0).any(-1)
    code = 2 * which + moves
    for status, _ in measured:
        # A number in base 4 identifies the statuses of all sensors.
        code = 4 * code + status  # FULL, PART, SILENT or NONE
        if len(measured) > MANY:
            code = np.unique(code, return_inverse=True)[1]  # renumbered, to avoid overflow
    codes = sorted(set(code.tolist()))
    kinds, distinct, shapes = np.zeros(len(k), int), list[EpochKind](), list(u)
    for number, value in enumerate(codes):
        mask = code == value
        i = int(mask.argmax())
        kinds[mask] = number
        present = tuple(int(status[i]) for status, _ in measured)
        distinct.append(EpochKind(bool(moves[i]), present, shapes[which[i]]))
    return Data(k, t, dt, kinds, distinct, filter_sensors, [values for _, values in measured], u)


def _parts(tree: Any) -> list[Array]:
    """The arrays of an input."""
    try:
        return [numbers("u", x) for x, _ in tree_leaves(tree)]
    except ValueError as error:
        raise CannotCompile(
            f"an input that is not an array of numbers cannot be compiled: {error}"
        ) from None


def _group_inputs(groups: list[Any], count: int) -> tuple[Array, dict[Any, Inputs]]:
    """For each of ``count`` epochs the index of its input shape, and the inputs of each shape.

    groups: indices of epochs, trees, and their arrays ``(K, ...)``.
    """
    which, same = np.zeros(count, int), dict[Any, list[Any]]()
    for at, tree, parts in groups:
        shape = tree_unflatten(tree, iter(range(len(parts)))), tuple(x.shape[1:] for x in parts)
        if len(groups) == 1:
            return which, {shape: Inputs(at, parts)}
        members = same.setdefault(shape, [])
        members.append((at, parts))
        which[at] = list(same).index(shape)
    joined = {}
    for shape, members in same.items():
        at, columns = zip(*members, strict=True)
        arrays = [np.concatenate(column) for column in zip(*columns, strict=True)]
        joined[shape] = Inputs(np.concatenate(at), arrays)
    return which, joined


def runs_of(x: Array, axes: int, batch: tuple[int, ...], runs: Any) -> Array:
    """Some runs, numbered over all batch axes, of an array with ``axes`` axes after the axes of
    runs.
    """
    if not batch:
        return x
    every: Array = np.broadcast_to(x, (*batch, *x.shape[x.ndim - axes :]))
    return np.asarray(every.reshape(-1, *every.shape[len(batch) :])[runs])


def epoch_of(
    data: Data, i: int, select: Callable[[Array, int], Array], batch: tuple[int, ...]
) -> Epoch:
    """The epoch at an index, for the runs that ``select(array, axes)`` selects from an array with
    ``axes`` axes after the axes of runs.
    """
    kind = data.distinct[data.kinds[i]]
    z = tuple(
        None if status == NONE else select(values[i], 1)
        for status, values in zip(kind.z, data.z, strict=True)
    )
    at, columns = data.u[kind.u]
    inputs = [x[np.searchsorted(at, i)] for x in columns]
    arrays = [select(x, x.ndim - len(batch)) if is_per_run(x, batch) else x for x in inputs]
    u, about = tree_unflatten(kind.u[0], iter(arrays))
    dt = data.dt[i]
    interval = select(dt, 0) if dt.ndim else float(dt)
    measured = z[0] if len(z) == 1 else z or None
    k: Any = float(data.k[i])
    return Epoch(
        int(k) if k.is_integer() else k, float(data.t[i]), interval, u, measured, about=about
    )


def _measured(sensor: Any, samples: Any) -> tuple[Array, Array]:
    """The status of a sensor at each epoch, and its measurements ``(T, ..., m)``."""
    count = len(samples)
    present = (
        np.array([sample is not None for sample in samples])
        if not isinstance(samples, np.ndarray)
        else np.ones(count, bool)
    )
    if not present.any():
        return np.full(count, NONE), np.zeros((count, 0))
    if not isinstance(samples, np.ndarray):
        # A sensor without a measurement at an epoch has nan there.
        blank = np.full(np.shape(samples[int(np.argmax(present))]), np.nan)
        samples = np.stack(
            np.broadcast_arrays(
                *(blank if sample is None else numbers("z", sample) for sample in samples)
            )
        )
    values = as_measurement(samples, sensor)
    if np.isfinite(np.add.reduce(values, None)):
        return np.where(present, FULL, NONE), values
    missing = np.isnan(values)
    axes = tuple(range(1, values.ndim))
    status = np.where(missing.all(axes), SILENT, np.where(missing.any(axes), PART, FULL))
    return np.where(present, status, NONE), values


class Sentinel(NamedTuple):
    """An epoch ``at`` an index, and the states of some runs ``(runs, size)`` before and
    after it."""

    at: int
    shape: Shape
    before: Array
    shape_after: Shape
    after: Array


class CompiledRun(NamedTuple):
    """The result of a compiled run.

    rows: ``(K, runs, ...)`` by name. tally: ``(runs, 5 stride)``, the counters. sentinels: for the
        watched runs. fresh: whether a step was recorded for this run.
    """

    rows: dict[str, Array]
    tally: Array
    sentinels: list[Sentinel]
    fresh: bool


def run_compiled(
    engine: Engine,
    prior: Any,
    data: Data,
    names: Sequence[str],
    every: int,
    jobs: int,
    device: Device | None = None,
    watched: Sequence[int] = (),
    number: int | None = None,
) -> CompiledRun:
    """Run all runs through all epochs, on a device if there is one, else on this processor.

    names: the columns to store. watched: the runs whose states are stored before and after the
        sentinels. number: None: all sentinels; 0: no sentinel; else the number of a run whose steps
        were all compared before, with one sentinel at an epoch that depends on this number.
    """
    runs, T = engine.runs, len(data.k)
    lanes = 0 if device else 1 if runs == 1 else llvm.lanes()
    start = engine.start(prior)
    inputs = {shape: engine.inputs(group, T) for shape, group in data.u.items()}
    plan, fresh = _schedule(engine, data, inputs, start, lanes, names)
    shared, per_run = _common_data(data, inputs, plan.width), _run_data(engine, data, inputs, runs)
    K, M = -(-T // every), max([1, *(at + x.shape[-1] for at, x in per_run)])
    stored = np.full(T, -1)
    stored[::every] = np.arange(K)
    unit = lanes or 1
    padded = -(-runs // unit) * unit  # copies of the last run fill the last vector
    columns = engine.columns()
    rows = {
        name: memory.empty((K, padded, columns[name]), bool if name.startswith("used") else float)
        for name in names
    }
    tally = np.empty((runs, len(COUNTERS) * engine.stride))
    sentinels = _sentinels(plan.steps, None if fresh else number)
    states = np.empty((2, len(sentinels), len(watched), plan.size))  # before and after
    if device:
        lane = device.room(jobs)
        begin = _on_device(plan, names, device, lane)
    else:
        cells = max(code.cells for code in plan.code)
        begin = _on_host([code.each for code in plan.code], cells, plan.steps)
    once = _run_common(plan, shared, start.first, sentinels)

    def run_chunk(first: int) -> None:
        """A chunk of runs."""
        members = slice(first, min(first + chunk, runs))
        count = members.stop - first
        vector = lanes or count  # on a device all runs are side by side
        width = -(-count // vector) * vector
        values, state = np.zeros((T, M, width)), np.zeros((width // vector, plan.size, vector))
        for at, x in per_run:
            values_in = x if x.shape[1] == 1 else x[:, members]
            values[:, at : at + x.shape[-1], :count] += values_in.transpose(0, 2, 1)
        values[..., count:] = values[..., count - 1 : count]
        # Copy each part of the state to its place; a part with one row is equal in all runs.
        size = 0
        for x in start.parts:
            values_in, k = (x, 1) if len(x) == 1 else (x[members], vector)
            if k > 1 and width > count:
                values_in = np.concatenate([values_in, np.repeat(values_in[-1:], width - count, 0)])
            state[:, size : size + x.shape[1]] = values_in.reshape(-1, k, x.shape[1]).transpose(
                0, 2, 1
            )
            size += x.shape[1]
        # Watched runs in this chunk: the block and the lane of each.
        here = [i for i, run in enumerate(watched) if members.start <= run < members.stop]
        block, lane = np.divmod(np.array([watched[i] - first for i in here], int), vector)
        through = begin(stored, state, shared, values, rows, first)
        for at, end in _pieces(T, sentinels if here else []):
            if here and at in sentinels:
                k = sentinels.index(at)
                states[0, k, here] = state[block, :, lane]
                through(at, end)
                states[1, k, here] = state[block, :, lane]
            else:
                through(at, end)
        counts = tally.shape[1]
        tally[members] = state[:, :counts].transpose(0, 2, 1).reshape(width, -1)[:count]

    row_size = sum(x.shape[2] for x in rows.values())
    room = (HOST // jobs if device else CHUNK) // (8 * T * M)
    if device:
        room = min(room, lane // (8 * (M + row_size + plan.size)))
    chunk = max(unit, min(-(-runs // jobs), room) // unit * unit)
    try:
        if jobs > 1 and runs > chunk:
            with ThreadPoolExecutor(jobs) as pool:
                list(pool.map(run_chunk, range(0, runs, chunk)))
        else:
            for first in range(0, runs, chunk):
                run_chunk(first)
    finally:
        if device:
            device.release()
    if once is not None:
        for k, at in enumerate(sentinels):
            for side in range(2):
                entries = plan.common[plan.at[at + side]]
                states[side, k][:, entries] = once[side, k, entries]
    if padded > runs:
        rows = {name: np.ascontiguousarray(x[:, :runs]) for name, x in rows.items()}
    return CompiledRun(
        rows,
        tally,
        [
            Sentinel(at, plan.shapes[plan.at[at]], x, plan.shapes[plan.at[at + 1]], y)
            for at, x, y in zip(sentinels, *states, strict=True)
        ],
        fresh,
    )


def _pieces(T: int, sentinels: Sequence[int]) -> Iterable[tuple[int, int]]:
    """The pieces of a run between the epochs at which states are read for the sentinels."""
    return pairwise(sorted({0, T, *sentinels, *(at + 1 for at in sentinels)}))


def _sentinels(steps: Array, number: int | None = None) -> list[int]:
    """Epochs whose steps are compared with numpy's: the first, the last, one for each recorded
    step, and some chosen by a hash.

    number: None: all of these; 0: no epoch; else a single epoch that depends on this number.
    """
    if number == 0:
        return []
    if number is not None:
        return [crc32(b"flight %d" % number) % len(steps)]
    drawn = [crc32(b"%d of %d" % (i, len(steps))) % len(steps) for i in range(RANDOM_SENTINELS)]
    return sorted({0, len(steps) - 1, *np.unique(steps, return_index=True)[1].tolist(), *drawn})


def _on_host(
    kernels: Sequence[int], cells: int, steps: Array
) -> Callable[..., Callable[[int, int], None]]:
    """A function that starts a run on this processor and returns a function that advances it from
    one epoch to another.

    kernels: addresses of machine code. cells: number of its memory cells. steps: the kernel of each
        epoch. Rows are written from run ``first`` on.
    """
    addresses, loop = np.array(kernels, np.uint64), llvm.run_loop()

    def begin(
        stored: Array,
        state: Array,
        shared: Array,
        per_run: Array,
        rows: dict[str, Array],
        first: int,
    ) -> Callable[[int, int], None]:
        (blocks, size, lanes), (_, M, width) = state.shape, per_run.shape
        E, runs = shared.shape[1], next((x.shape[1] for x in rows.values()), 0)
        fields = np.array([x.ctypes.data for x in rows.values()], np.uint64)
        fixed = addresses, state, fields, llvm.aligned((cells, lanes))
        code, states, to, work = (x.ctypes.data for x in fixed)
        kinds, at_rows, inputs, values = (x.ctypes.data for x in (steps, stored, shared, per_run))

        # `_alive` keeps the arrays, whose addresses the code uses, from being freed.
        def through(at: int, end: int, _alive: Any = fixed) -> None:
            loop(
                *(code, kinds + 4 * at, at_rows + 8 * at, states),
                *(inputs + 8 * E * at, values + 8 * M * width * at, to, work),
                *(size, E, M, runs, first, width, lanes, 0, blocks, end - at),
            )

        return through

    return begin


def _on_device(
    plan: Schedule, names: Sequence[str], device: Device, room: int
) -> Callable[..., Callable[[int, int], None]]:
    """Like `_on_host`, for a device.

    room: bytes for the measurements and rows of one piece of the epochs.
    """
    kernels = (recorded.keeping(names)._replace(flags=frozenset()) for recorded in plan.records)
    entry = device.entry(ptx.program([*kernels], plan.size))

    def begin(
        stored: Array,
        state: Array,
        shared: Array,
        per_run: Array,
        rows: dict[str, Array],
        first: int,
    ) -> Callable[[int, int], None]:
        width = per_run.shape[1] + sum(x.shape[2] for x in rows.values())
        left = room - state.nbytes
        most = max(1, left // (8 * width * per_run.shape[2] + shared[0].nbytes))

        def through(at: int, end: int) -> None:
            for first_epoch in range(at, end, most):
                piece(first_epoch, min(first_epoch + most, end))

        def piece(at: int, end: int) -> None:
            span = slice(at, end)
            places = stored[span]
            written = places[places >= 0]
            low, high = (int(written[0]), int(written[-1]) + 1) if len(written) else (0, 0)
            places = np.where(places >= 0, places - low, -1)
            shapes = [(high - low, per_run.shape[2], x.shape[2]) for x in rows.values()]
            ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
            inputs = plan.steps[span], places, state, shared[span], per_run[span]
            with device.lane() as lane:
                out = np.split(lane.run(entry, *inputs, results=max(1, *ends, 1)), ends)
                for x, shape, values in zip(rows.values(), shapes, out, strict=False):
                    x[low:high, first : first + shape[1]] = values.reshape(shape)

        return through

    return begin


class Schedule(NamedTuple):
    """The recorded steps that a run needs, and the recorded step of each epoch.

    edges: for each recorded step, the indices of the shapes before and after it. steps: for each
        epoch, the index of its recorded step. at: the index of the shape before each epoch, and at
        the end. shapes: the shapes of the state. code: of the recorded steps, on this processor.
        common: for each shape, the entries of the state that are equal in all runs. size: numbers
        in a state. width: number of shared results.
    """

    records: list[Recorded]
    edges: list[tuple[int, int]]
    steps: Array
    at: list[int]
    shapes: list[Shape]
    code: list[Code]
    common: list[list[int]]
    size: int
    width: int


def _schedule(
    engine: Engine,
    data: Data,
    inputs: dict[Any, Any],
    start: Start,
    lanes: int,
    names: Sequence[str],
) -> tuple[Schedule, bool]:
    """The schedule of a run, and whether a step was recorded for it."""
    forms = tuple((shape, engine.forms(u)) for shape, u in inputs.items())
    about = start.shape, start.common, lanes, tuple(names)
    key = data.kinds.tobytes(), tuple(data.distinct), forms, about
    if key in engine.schedules:
        plan = engine.schedules[key]
        for recorded in plan.records:
            engine.check_length(recorded)
        return plan, False
    count = len(engine.cache.records)
    plan = _record_steps(engine, data, inputs, start)
    if lanes:
        code, common = _compile_steps(engine, plan, start.common, lanes, names)
        width = max(step_code.first + step_code.results for step_code in code)
        plan = plan._replace(code=code, common=common, width=width)
    if len(data.k) <= SHORT:
        for oldest in [*engine.schedules][: 1 - MOST_SCHEDULES]:
            engine.schedules.pop(oldest, None)
        engine.schedules[key] = plan
    return plan, len(engine.cache.records) > count


def _record_steps(engine: Engine, data: Data, inputs: dict[Any, Any], start: Start) -> Schedule:
    """Record the steps of all epochs."""
    ids: dict[Shape, int] = {start.shape: 0}
    numbers: dict[tuple[int, int], int] = {}  # index of a recorded step, by shape before and kind
    records, edges = list[Recorded](), list[tuple[int, int]]()
    steps, places = list[int](), [0]
    kinds = data.kinds.tolist()
    for i, kind in enumerate(kinds):
        at = places[-1]
        if (at, kind) not in numbers:
            epoch_kind = data.distinct[kind]
            recorded = engine.recorded_as(list(ids)[at], epoch_kind, inputs[epoch_kind.u])
            numbers[at, kind] = len(records)
            records.append(recorded)
            edges.append((at, ids.setdefault(recorded.after, len(ids))))
            stays = {k: n for (_, k), n in numbers.items() if edges[n] == (at, at)}
            # From here on the shape of the state does not change.
            if stays.keys() >= set(kinds[i:]):
                steps += [stays[k] for k in kinds[i:]]
                places += [at] * (len(kinds) - i)
                break
        steps.append(numbers[at, kind])
        places.append(edges[steps[-1]][1])
    shapes = list(ids)
    size = (engine.state_offset + max(shape.size for shape in shapes)) * engine.stride
    return Schedule(records, edges, np.array(steps, np.int32), places, shapes, [], [], size, 0)


def _compile_steps(
    engine: Engine, plan: Schedule, start: frozenset[int], lanes: int, names: Sequence[str]
) -> tuple[list[Code], list[list[int]]]:
    """Machine code of all recorded steps, and, for each shape, the entries of the state that are
    equal in all runs.

    start: these entries before the first epoch.
    """
    one_run = (
        [engine.code(recorded, lanes, names) for recorded in plan.records] if lanes == 1 else []
    )
    no_common: list[list[int]] = [[]] * len(plan.shapes)
    if one_run or engine.stride > 1:
        return one_run or [
            engine.code(recorded, lanes, names) for recorded in plan.records
        ], no_common
    key = "common", tuple(map(id, plan.records)), start, tuple(names)
    if key not in engine.cache.code:
        common = _common_entries(engine, plan, start)
        splits = [
            recorded.keeping(names).split(common[before], common[after])
            for recorded, (before, after) in zip(plan.records, plan.edges, strict=True)
        ]
        engine.cache.code[key] = splits, [sorted(entries) for entries in common]
    splits, entries = engine.cache.code[key]
    T, count = len(plan.steps), np.bincount(plan.steps)
    saved = sum(int(n) * split.saved for n, split in zip(count, splits, strict=True))
    results = T * max(len(split.once.rows) for split in splits)
    if saved < APART * T or results > MOST_COMMON:
        return [engine.code(recorded, lanes, names) for recorded in plan.records], no_common
    pairs = zip(plan.records, splits, strict=True)
    return [engine.code(recorded, lanes, names, split) for recorded, split in pairs], entries


def _common_entries(engine: Engine, plan: Schedule, start: frozenset[int]) -> list[frozenset[int]]:
    """For each shape the entries of the state that are equal in all runs: the largest sets that
    every recorded step preserves.
    """
    common: dict[int, frozenset[int]] = {0: start}
    while True:
        before = dict(common)
        for recorded, (begin, end) in zip(plan.records, plan.edges, strict=True):
            # A recorded step is listed after the steps that lead to its shape, so `common` has the
            # shape.
            uniform = recorded.kernel.uniform(common[begin])
            same = frozenset(
                i
                for i, x in recorded.kernel.state
                if i >= engine.state_offset and (not isinstance(x, TracedScalar) or uniform[x.i])
            )
            common[end] = common.get(end, same) & same
        if common == before:
            return [common[i] for i in range(len(common))]


def _run_common(plan: Schedule, shared: Array, start: Array, sentinels: list[int]) -> Array | None:
    """Run the common part through all epochs and write its results to ``shared``.

    start: the state of any run before the first epoch. Returns the states before and after the
        sentinels ``(2, sentinels, size)``, or None if the runs have nothing in common.
    """
    kernels = [step_code.once for step_code in plan.code if step_code.once is not None]
    if not kernels:
        return None
    T, width = shared.shape
    at = np.arange(T) * width + np.array([step_code.first for step_code in plan.code])[plan.steps]
    state = np.zeros((1, plan.size, 1))
    state[0, : len(start), 0] = start
    states = np.empty((2, len(sentinels), plan.size))
    rows, no_values = {"": shared[:, None]}, np.zeros((T, 1, 1))
    begin = _on_host(kernels, max(step_code.cells for step_code in plan.code), plan.steps)
    through = begin(at, state, shared, no_values, rows, 0)
    for first, end in _pieces(T, sentinels):
        if first in sentinels:
            states[0, sentinels.index(first)] = state[0, :, 0]
        through(first, end)
        if first in sentinels:
            states[1, sentinels.index(first)] = state[0, :, 0]
    return states


def _common_data(data: Data, inputs: dict[Any, list[tuple[Array, bool]]], width: int) -> Array:
    """Data common to all runs at each epoch ``(T, E)``: index, time, interval, inputs, and room for
    at least ``width`` results.
    """
    T = len(data.k)
    flat = [
        np.concatenate(
            [np.zeros((T, 0)), *(x.reshape(T, -1) for x, per_run in parts if not per_run)], 1
        )
        for parts in inputs.values()
    ]
    out = np.zeros((T, max(width, 3 + max(x.shape[1] for x in flat))))
    out[:, 0], out[:, 1] = data.k, data.t
    if data.dt.ndim == 1:
        out[:, 2] = data.dt
    for x in flat:  # each epoch has one input shape, and zeros for the other shapes
        out[:, 3 : 3 + x.shape[1]] += x
    return out


def _run_data(
    engine: Engine, data: Data, inputs: dict[Any, list[tuple[Array, bool]]], runs: int
) -> list[tuple[int, Array]]:
    """Data that differ between runs at each epoch, ``(T, runs or 1, ...)``, and their positions:
    measurements, interval, inputs.
    """
    T, out, at = len(data.k), list[tuple[int, Array]](), 0
    values = [*data.z, data.dt[..., None]] if engine.dt_per_run else data.z
    for x in values:
        if x.shape[-1]:
            alone = x.ndim == 2 or x.shape[1:-1] == (1,)
            out.append((at, x.reshape(T, 1, -1) if alone else _flatten_runs(x, engine.batch, runs)))
            at += x.shape[-1]
    for parts in inputs.values():
        end = at
        for x, per_run in parts:
            if per_run:
                out.append((end, x.reshape(T, runs, -1)))
                end += out[-1][1].shape[-1]
    return out


def _flatten_runs(x: Array, batch: tuple[int, ...], runs: int) -> Array:
    """Values ``(T, ..., k)`` as ``(T, runs, k)``."""
    with_axes = x.reshape(len(x), *(1,) * (len(batch) + 2 - x.ndim), *x.shape[1:])
    every: Array = np.broadcast_to(with_axes, (len(x), *batch, x.shape[-1]))
    return every.reshape(len(x), runs, -1)
