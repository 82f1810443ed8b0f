"""The flight of a compiled step: epochs as columns, blocks of runs through all of them, and what is
kept of it.

The states of some runs before and after some epochs are kept too, to be compared with numpy's
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
    is_own,
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

DRAWN = 4  # sentinels besides the first, the last and one of each record
MANY = 20  # sensors, of which there are more kinds of epochs than integers
SHORT = 10_000  # epochs, the most of a flight whose schedule is kept
MOST_SCHEDULES = 16  # of an engine, that are kept
# operations of a step that all runs have in common, from which on they are done once an epoch
APART = 100
MOST_COMMON = 1 << 25  # results of them in memory
CHUNK = 1 << 21  # bytes of the measurements of runs that are flown together: they stay in the cache


def sensors(filter: Any, epochs: Sequence[Epoch] = ()) -> Sequence[Any]:
    """Sensors of a filter, or of the first one in it; of another filter what is taken for them, for
    measurements such as those of the first epoch."""
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
    own = sensors(filter, epochs)
    if isinstance(epochs, Epochs) and epochs.columnar:
        k, t, dt, inputs, z = epochs.columns(len(own))
        given: list[Any] = [(one.at, one.columns, _parts(one.columns)) for one in inputs]
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
        each = [(epoch.u, epoch.about) for epoch in epochs]
        given = [([i], one, [x[None] for x in _parts(one)]) for i, one in enumerate(each)]
        z = tuple(zip(*(measurements(epoch.z, len(own)) for epoch in epochs), strict=True))
    which, u = _gathered(given, len(k))
    found = [_measured(sensor, parts) for sensor, parts in zip(own, z, strict=True)]
    moves = (dt.reshape(len(k), -1) != 0.0).any(-1)
    code = 2 * which + moves
    for status, _ in found:
        code = 4 * code + status  # of FULL, PART, SILENT and NONE
        if len(found) > MANY:
            code = np.unique(code, return_inverse=True)[1]  # which would overflow
    there = sorted(set(code.tolist()))
    kinds, known, shapes = np.zeros(len(k), int), list[EpochKind](), list(u)
    for number, one in enumerate(there):
        alike = code == one
        i = int(alike.argmax())
        kinds[alike] = number
        present = tuple(int(status[i]) for status, _ in found)
        known.append(EpochKind(bool(moves[i]), present, shapes[which[i]]))
    return Data(k, t, dt, kinds, known, own, [values for _, values in found], u)


def _parts(tree: Any) -> list[Array]:
    """The arrays of an input."""
    try:
        return [numbers("u", x) for x, _ in tree_leaves(tree)]
    except ValueError as error:
        raise CannotCompile(
            f"an input that is no array of numbers cannot be compiled: {error}"
        ) from None


def _gathered(given: list[Any], count: int) -> tuple[Array, dict[Any, Inputs]]:
    """Of each of ``count`` epochs the number of its shape of inputs, and the inputs of each shape.

    given: epochs, trees, and their arrays ``(K, ...)``.
    """
    which, same = np.zeros(count, int), dict[Any, list[Any]]()
    for at, tree, parts in given:
        shape = tree_unflatten(tree, iter(range(len(parts)))), tuple(x.shape[1:] for x in parts)
        if len(given) == 1:
            return which, {shape: Inputs(at, parts)}
        some = same.setdefault(shape, [])
        some.append((at, parts))
        which[at] = list(same).index(shape)
    joined = {}
    for shape, some in same.items():
        at, columns = zip(*some, strict=True)
        arrays = [np.concatenate(column) for column in zip(*columns, strict=True)]
        joined[shape] = Inputs(np.concatenate(at), arrays)
    return which, joined


def part_of(x: Array, own: int, batch: tuple[int, ...], runs: Any) -> Array:
    """Some runs of an array with ``own`` axes after those of the runs, which are numbered over all
    axes of a batch.
    """
    if not batch:
        return x
    whole: Array = np.broadcast_to(x, (*batch, *x.shape[x.ndim - own :]))
    return np.asarray(whole.reshape(-1, *whole.shape[len(batch) :])[runs])


def epoch_of(
    data: Data, i: int, part: Callable[[Array, int], Array], batch: tuple[int, ...]
) -> Epoch:
    """The epoch at an index, of the runs that ``part`` takes of an array with so many axes of its
    own.
    """
    kind = data.known[data.kinds[i]]
    z = tuple(
        None if what == NONE else part(values[i], 1)
        for what, values in zip(kind.z, data.z, strict=True)
    )
    at, columns = data.u[kind.u]
    inputs = [x[np.searchsorted(at, i)] for x in columns]
    own = [part(x, x.ndim - len(batch)) if is_own(x, batch) else x for x in inputs]
    u, about = tree_unflatten(kind.u[0], iter(own))
    dt = data.dt[i]
    interval = part(dt, 0) if dt.ndim else float(dt)
    measured = z[0] if len(z) == 1 else z or None
    k: Any = float(data.k[i])
    return Epoch(
        int(k) if k.is_integer() else k, float(data.t[i]), interval, u, measured, about=about
    )


def _measured(sensor: Any, parts: Any) -> tuple[Array, Array]:
    """What there is of a sensor at each epoch, and its measurements ``(T, ..., m)``."""
    count = len(parts)
    present = (
        np.array([part is not None for part in parts])
        if not isinstance(parts, np.ndarray)
        else np.ones(count, bool)
    )
    if not present.any():
        return np.full(count, NONE), np.zeros((count, 0))
    if not isinstance(parts, np.ndarray):
        one = np.full(np.shape(parts[int(np.argmax(present))]), np.nan)
        parts = np.stack(
            np.broadcast_arrays(*(one if part is None else numbers("z", part) for part in parts))
        )
    values = as_measurement(parts, sensor)
    if np.isfinite(np.add.reduce(values, None)):
        return np.where(present, FULL, NONE), values
    missing = np.isnan(values)
    axes = tuple(range(1, values.ndim))
    there = np.where(missing.all(axes), SILENT, np.where(missing.any(axes), PART, FULL))
    return np.where(present, there, NONE), values


class Sentinel(NamedTuple):
    """An epoch ``at`` an index, and the states of some runs ``(runs, size)`` before and
    after it."""

    at: int
    shape: Shape
    before: Array
    shape_after: Shape
    after: Array


class CompiledRun(NamedTuple):
    """What a flight leaves.

    rows: ``(K, runs, ...)`` by name. tally: of each run ``(runs, 5 stride)``. sentinels: of the
        runs
    that are watched. fresh: whether a step was recorded for it.
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
    """All runs through all epochs, on a device, or None: on this processor.

    names: of the columns that are kept. watched: the runs whose states are kept before and after
        the
    sentinels. number: of a flight whose steps were all compared before: it has one sentinel, at an
    epoch that depends on its number; 0: it has none.
    """
    runs, T = engine.runs, len(data.k)
    lanes = 0 if device else 1 if runs == 1 else llvm.lanes()
    start = engine.start(prior)
    inputs = {shape: engine.inputs(found, T) for shape, found in data.u.items()}
    plan, fresh = _schedule(engine, data, inputs, start, lanes, names)
    shared, own = _shared(data, inputs, plan.width), _own(engine, data, inputs, runs)
    K, M = -(-T // every), max([1, *(at + x.shape[-1] for at, x in own)])
    stored = np.full(T, -1)
    stored[::every] = np.arange(K)
    unit = lanes or 1
    whole = -(-runs // unit) * unit  # the last run fills a vector that is not full
    columns = engine.columns()
    rows = {
        name: memory.empty((K, whole, columns[name]), bool if name.startswith("used") else float)
        for name in names
    }
    tally = np.empty((runs, len(COUNTERS) * engine.stride))
    sentinels = _sentinels(plan.steps, None if fresh else number)
    seen = np.empty((2, len(sentinels), len(watched), plan.size))  # before and after
    if device:
        begin = _on_device(plan, names, device)
    else:
        cells = max(one.cells for one in plan.code)
        begin = _on_host([one.each for one in plan.code], cells, plan.steps)
    once = _once(plan, shared, start.first, sentinels)

    def some(first: int) -> None:
        """A chunk of runs."""
        part = slice(first, min(first + chunk, runs))
        count = part.stop - first
        vector = lanes or count  # a device has all of them side by side
        width = -(-count // vector) * vector
        values, state = np.zeros((T, M, width)), np.zeros((width // vector, plan.size, vector))
        for at, x in own:
            mine = x if x.shape[1] == 1 else x[:, part]
            values[:, at : at + x.shape[-1], :count] += mine.transpose(0, 2, 1)
        values[..., count:] = values[..., count - 1 : count]
        size = 0
        for x in start.parts:
            mine, k = (x, 1) if len(x) == 1 else (x[part], vector)
            if k > 1 and width > count:
                mine = np.concatenate([mine, np.repeat(mine[-1:], width - count, 0)])
            state[:, size : size + x.shape[1]] = mine.reshape(-1, k, x.shape[1]).transpose(0, 2, 1)
            size += x.shape[1]
        here = [i for i, run in enumerate(watched) if part.start <= run < part.stop]
        block, lane = np.divmod(np.array([watched[i] - first for i in here], int), vector)
        through = begin(stored, state, shared, values, rows, first)
        for at, end in _pieces(T, sentinels if here else []):
            if here and at in sentinels:
                k = sentinels.index(at)
                seen[0, k, here] = state[block, :, lane]
                through(at, end)
                seen[1, k, here] = state[block, :, lane]
            else:
                through(at, end)
        counts = tally.shape[1]
        tally[part] = state[:, :counts].transpose(0, 2, 1).reshape(width, -1)[:count]

    kept = sum(x.shape[2] for x in rows.values())
    room = (
        device.room() // jobs // (8 * (T * M + K * kept + plan.size))
        if device
        else CHUNK // (8 * T * M)
    )
    chunk = max(unit, min(-(-runs // jobs), room) // unit * unit)
    if jobs > 1 and runs > chunk:
        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(some, range(0, runs, chunk)))
    else:
        for first in range(0, runs, chunk):
            some(first)
    if once is not None:
        for k, at in enumerate(sentinels):
            for side in range(2):
                entries = plan.common[plan.at[at + side]]
                seen[side, k][:, entries] = once[side, k, entries]
    if whole > runs:
        rows = {name: np.ascontiguousarray(x[:, :runs]) for name, x in rows.items()}
    return CompiledRun(
        rows,
        tally,
        [
            Sentinel(at, plan.shapes[plan.at[at]], x, plan.shapes[plan.at[at + 1]], y)
            for at, x, y in zip(sentinels, *seen, strict=True)
        ],
        fresh,
    )


def _pieces(T: int, sentinels: Sequence[int]) -> Iterable[tuple[int, int]]:
    """Where a flight begins and ends anew, to look at the states around the sentinels."""
    return pairwise(sorted({0, T, *sentinels, *(at + 1 for at in sentinels)}))


def _sentinels(steps: Array, number: int | None = None) -> list[int]:
    """Epochs whose steps are compared with numpy's: the first, the last, one of each record, and
    some drawn by a hash.

    number: of a flight that has one of them only; 0: none.
    """
    if number == 0:
        return []
    if number is not None:
        return [crc32(b"flight %d" % number) % len(steps)]
    drawn = [crc32(b"%d of %d" % (i, len(steps))) % len(steps) for i in range(DRAWN)]
    return sorted({0, len(steps) - 1, *np.unique(steps, return_index=True)[1].tolist(), *drawn})


def _on_host(
    kernels: Sequence[int], cells: int, steps: Array
) -> Callable[..., Callable[[int, int], None]]:
    """What begins a flight on this processor, and gives what takes it from one epoch to another.

    kernels: addresses of machine code. cells: of its memory. steps: which of it each epoch takes.
    The flight writes the rows of the runs from the ``first`` on.
    """
    addresses, loop = np.array(kernels, np.uint64), llvm.run_loop()

    def begin(
        stored: Array, state: Array, shared: Array, own: Array, rows: dict[str, Array], first: int
    ) -> Callable[[int, int], None]:
        (blocks, size, lanes), (_, M, width) = state.shape, own.shape
        E, runs = shared.shape[1], next((x.shape[1] for x in rows.values()), 0)
        fields = np.array([x.ctypes.data for x in rows.values()], np.uint64)
        fixed = addresses, state, fields, llvm.aligned((cells, lanes))
        code, states, to, work = (x.ctypes.data for x in fixed)
        kinds, at_rows, inputs, values = (x.ctypes.data for x in (steps, stored, shared, own))

        def through(at: int, end: int, _alive: Any = fixed) -> None:
            loop(
                *(code, kinds + 4 * at, at_rows + 8 * at, states),
                *(inputs + 8 * E * at, values + 8 * M * width * at, to, work),
                *(size, E, M, runs, first, width, lanes, 0, blocks, end - at),
            )

        return through

    return begin


def _on_device(
    plan: Schedule, names: Sequence[str], device: Device
) -> Callable[..., Callable[[int, int], None]]:
    """The same on a device."""
    whole = (made.keeping(names)._replace(flags=frozenset()) for made in plan.records)
    entry = device.entry(ptx.program([*whole], plan.size))

    def begin(
        stored: Array, state: Array, shared: Array, own: Array, rows: dict[str, Array], first: int
    ) -> Callable[[int, int], None]:
        def through(at: int, end: int) -> None:
            here = slice(at, end)
            places = stored[here]
            kept = places[places >= 0]
            low, high = (int(kept[0]), int(kept[-1]) + 1) if len(kept) else (0, 0)
            places = np.where(places >= 0, places - low, -1)
            shapes = [(high - low, own.shape[2], x.shape[2]) for x in rows.values()]
            ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
            out = np.empty(max(1, *ends, 1))
            device.fly(entry, plan.steps[here], places, state, shared[here], own[here], out)
            for x, shape, part in zip(rows.values(), shapes, np.split(out, ends), strict=False):
                x[low:high, first : first + shape[1]] = part.reshape(shape)

        return through

    return begin


class Schedule(NamedTuple):
    """The records that a flight needs, and which of them each epoch takes.

    edges: of each record, the numbers of the shapes before and after it. steps: of each epoch, the
    number of its record. at: the number of the shape before each epoch, and at the end. shapes: of
    the state. code: of the records, on this processor. common: of each shape, the entries of the
    state
    that all runs have in common. size: of a state. width: of what all runs have in common.
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
    """The schedule of a flight, and whether a step was recorded for it."""
    forms = tuple((shape, engine.forms(u)) for shape, u in inputs.items())
    about = start.shape, start.common, lanes, tuple(names)
    key = data.kinds.tobytes(), tuple(data.known), forms, about
    if key in engine.schedules:
        plan = engine.schedules[key]
        for made in plan.records:
            engine.check_length(made)
        return plan, False
    count = len(engine.kept.records)
    plan = _planned(engine, data, inputs, start)
    if lanes:
        code, common = _coded(engine, plan, start.common, lanes, names)
        width = max(one.first + one.results for one in code)
        plan = plan._replace(code=code, common=common, width=width)
    if len(data.k) <= SHORT:
        for oldest in [*engine.schedules][: 1 - MOST_SCHEDULES]:
            engine.schedules.pop(oldest, None)
        engine.schedules[key] = plan
    return plan, len(engine.kept.records) > count


def _planned(engine: Engine, data: Data, inputs: dict[Any, Any], start: Start) -> Schedule:
    """Steps of all epochs, recorded."""
    ids: dict[Shape, int] = {start.shape: 0}
    numbers: dict[tuple[int, int], int] = {}  # of records, by the shape before and the kind
    records, edges = list[Recorded](), list[tuple[int, int]]()
    steps, places = list[int](), [0]
    kinds = data.kinds.tolist()
    for i, kind in enumerate(kinds):
        at = places[-1]
        if (at, kind) not in numbers:
            there = data.known[kind]
            made = engine.recorded_as(list(ids)[at], there, inputs[there.u])
            numbers[at, kind] = len(records)
            records.append(made)
            edges.append((at, ids.setdefault(made.after, len(ids))))
            stays = {k: n for (_, k), n in numbers.items() if edges[n] == (at, at)}
            if stays.keys() >= set(kinds[i:]):  # from here on the state keeps its shape
                steps += [stays[k] for k in kinds[i:]]
                places += [at] * (len(kinds) - i)
                break
        steps.append(numbers[at, kind])
        places.append(edges[steps[-1]][1])
    shapes = list(ids)
    size = (engine.held + max(shape.size for shape in shapes)) * engine.stride
    return Schedule(records, edges, np.array(steps, np.int32), places, shapes, [], [], size, 0)


def _coded(
    engine: Engine, plan: Schedule, start: frozenset[int], lanes: int, names: Sequence[str]
) -> tuple[list[Code], list[list[int]]]:
    """Machine code of all records, and the entries of the state of each shape that all runs have in
    common.

    start: those of the state before the first epoch.
    """
    whole = [engine.code(made, lanes, names) for made in plan.records] if lanes == 1 else []
    none: list[list[int]] = [[]] * len(plan.shapes)
    if whole or engine.stride > 1:
        return whole or [engine.code(made, lanes, names) for made in plan.records], none
    key = "common", tuple(map(id, plan.records)), start, tuple(names)
    if key not in engine.kept.code:
        common = _common(engine, plan, start)
        splits = [
            made.keeping(names).split(common[before], common[after])
            for made, (before, after) in zip(plan.records, plan.edges, strict=True)
        ]
        engine.kept.code[key] = splits, [sorted(entries) for entries in common]
    splits, entries = engine.kept.code[key]
    T, count = len(plan.steps), np.bincount(plan.steps)
    saved = sum(int(n) * split.saved for n, split in zip(count, splits, strict=True))
    results = T * max(len(split.once.rows) for split in splits)
    if saved < APART * T or results > MOST_COMMON:
        return [engine.code(made, lanes, names) for made in plan.records], none
    pairs = zip(plan.records, splits, strict=True)
    return [engine.code(made, lanes, names, split) for made, split in pairs], entries


def _common(engine: Engine, plan: Schedule, start: frozenset[int]) -> list[frozenset[int]]:
    """Entries of the state of each shape that all runs have in common: the most that every record
    keeps so.
    """
    found: dict[int, frozenset[int]] = {0: start}
    while True:
        before = dict(found)
        for made, (begin, end) in zip(plan.records, plan.edges, strict=True):
            # A record stands behind those that lead to it.
            uniform = made.kernel.uniform(found[begin])
            same = frozenset(
                i
                for i, x in made.kernel.state
                if i >= engine.held and (not isinstance(x, TracedScalar) or uniform[x.i])
            )
            found[end] = found.get(end, same) & same
        if found == before:
            return [found[i] for i in range(len(found))]


def _once(plan: Schedule, shared: Array, start: Array, sentinels: list[int]) -> Array | None:
    """Take what all runs have in common through all epochs, which adds its results to ``shared``.

    start: the state before the first epoch of any run. Returns the states before and after the
    sentinels ``(2, sentinels, size)``; None where the runs have nothing in common.
    """
    kernels = [one.once for one in plan.code if one.once is not None]
    if not kernels:
        return None
    T, width = shared.shape
    at = np.arange(T) * width + np.array([one.first for one in plan.code])[plan.steps]
    state = np.zeros((1, plan.size, 1))
    state[0, : len(start), 0] = start
    seen = np.empty((2, len(sentinels), plan.size))
    rows, none = {"": shared[:, None]}, np.zeros((T, 1, 1))
    begin = _on_host(kernels, max(one.cells for one in plan.code), plan.steps)
    through = begin(at, state, shared, none, rows, 0)
    for first, end in _pieces(T, sentinels):
        if first in sentinels:
            seen[0, sentinels.index(first)] = state[0, :, 0]
        through(first, end)
        if first in sentinels:
            seen[1, sentinels.index(first)] = state[0, :, 0]
    return seen


def _shared(data: Data, inputs: dict[Any, list[tuple[Array, bool]]], width: int) -> Array:
    """What all runs have in common at each epoch ``(T, E)``: index, time, interval, inputs, and
    room for at least ``width``.
    """
    T = len(data.k)
    flat = [
        np.concatenate([np.zeros((T, 0)), *(x.reshape(T, -1) for x, own in parts if not own)], 1)
        for parts in inputs.values()
    ]
    out = np.zeros((T, max(width, 3 + max(x.shape[1] for x in flat))))
    out[:, 0], out[:, 1] = data.k, data.t
    if data.dt.ndim == 1:
        out[:, 2] = data.dt
    for x in flat:  # an epoch has one of them, and zeros of the others
        out[:, 3 : 3 + x.shape[1]] += x
    return out


def _own(
    engine: Engine, data: Data, inputs: dict[Any, list[tuple[Array, bool]]], runs: int
) -> list[tuple[int, Array]]:
    """What each run has of its own at each epoch, ``(T, runs or 1, ...)``, and where it stands:
    measurements, interval, inputs.
    """
    T, out, at = len(data.k), list[tuple[int, Array]](), 0
    values = [*data.z, data.dt[..., None]] if engine.apart else data.z
    for x in values:
        if x.shape[-1]:
            alone = x.ndim == 2 or x.shape[1:-1] == (1,)
            out.append((at, x.reshape(T, 1, -1) if alone else _flat(x, engine.batch, runs)))
            at += x.shape[-1]
    for parts in inputs.values():
        end = at
        for x, own in parts:
            if own:
                out.append((end, x.reshape(T, runs, -1)))
                end += out[-1][1].shape[-1]
    return out


def _flat(x: Array, batch: tuple[int, ...], runs: int) -> Array:
    """``(T, runs, k)`` of values ``(T, ..., k)``."""
    spread = x.reshape(len(x), *(1,) * (len(batch) + 2 - x.ndim), *x.shape[1:])
    whole: Array = np.broadcast_to(spread, (len(x), *batch, x.shape[-1]))
    return whole.reshape(len(x), runs, -1)
