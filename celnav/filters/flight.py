"""The flight of a compiled step: epochs as columns, blocks of runs through all of them, and what is kept of it.

The states of some runs before and after some epochs are kept too, to be compared with numpy's steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from celnav.filters.engine import (
    FULL,
    NONE,
    PART,
    SILENT,
    TALLY,
    Code,
    Data,
    Engine,
    Kind,
    Recorded,
    Shape,
    is_own,
    leaves,
    rebuilt,
)
from celnav.filters.model import Sensor
from celnav.filters.records import Epoch, Epochs, Inputs, check_interval
from celnav.filters.sequential import checked, measurements
from celnav.gaussian.checks import numbers
from celnav.gaussian.linalg import Array
from celnav.tape import llvm, ptx
from celnav.tape.cuda import Device
from celnav.tape.tape import CannotCompile, Number

__all__ = ["Flight", "Sentinel", "as_data", "epoch_of", "fly", "part_of", "sensors"]

DRAWN = 4  # sentinels besides the first, the last and one of each record
FEW = 3  # rows of a flight that keeps nothing, by which it is checked
APART = 100  # operations of a step that all runs have in common, from which on they are done once an epoch
MOST_COMMON = 1 << 25  # results of them in memory
CHUNK = 1 << 21  # bytes of the measurements of runs that are flown together: they stay in the cache


def sensors(filter: Any, z: Any) -> Sequence[Any]:
    """Sensors of a filter, or of the first one in it; of another filter what is taken for them, for measurements such as ``z``."""
    while not hasattr(filter, "sensors"):
        if (filter := getattr(filter, "first", getattr(filter, "filter", None))) is None:
            return (Sensor(lambda x, _epoch: x, R=lambda _mean, _epoch: np.eye(1)),) * (
                len(z) if isinstance(z, tuple) else 1
            )
    return tuple(filter.sensors)


def as_data(filter: Any, epochs: Epochs | Sequence[Epoch]) -> Data:
    """Epochs as columns."""
    if not len(epochs):
        raise ValueError("epochs: expected at least one, got none")
    own = sensors(filter, epochs[0].z)
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
    _, first, kinds = np.unique(code, return_index=True, return_inverse=True)
    shapes = list(u)
    known = [
        Kind(bool(moves[i]), tuple(int(status[i]) for status, _ in found), shapes[which[i]])
        for i in first.tolist()
    ]
    return Data(k, t, dt, kinds, known, own, [values for _, values in found], u)


def _parts(tree: Any) -> list[Array]:
    """The arrays of an input."""
    try:
        return [numbers("u", x) for x, _ in leaves(tree)]
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
        shape = rebuilt(tree, iter(range(len(parts)))), tuple(x.shape[1:] for x in parts)
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
    """Some runs of an array with ``own`` axes after those of the runs, which are numbered over all axes of a batch."""
    if not batch:
        return x
    whole: Array = np.broadcast_to(x, (*batch, *x.shape[x.ndim - own :]))
    return np.asarray(whole.reshape(-1, *whole.shape[len(batch) :])[runs])


def epoch_of(
    data: Data, i: int, part: Callable[[Array, int], Array], batch: tuple[int, ...]
) -> Epoch:
    """The epoch at an index, of the runs that ``part`` takes of an array with so many axes of its own."""
    kind = data.known[data.kinds[i]]
    z = tuple(
        None if what == NONE else part(values[i], 1)
        for what, values in zip(kind.z, data.z, strict=True)
    )
    at, columns = data.u[kind.u]
    inputs = [x[np.searchsorted(at, i)] for x in columns]
    own = [part(x, x.ndim - len(batch)) if is_own(x, batch) else x for x in inputs]
    u, about = rebuilt(kind.u[0], iter(own))
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
    values = checked(parts, sensor)
    if np.isfinite(np.add.reduce(values, None)):
        return np.where(present, FULL, NONE), values
    missing = np.isnan(values)
    axes = tuple(range(1, values.ndim))
    there = np.where(missing.all(axes), SILENT, np.where(missing.any(axes), PART, FULL))
    return np.where(present, there, NONE), values


class Sentinel(NamedTuple):
    """An epoch ``at`` an index, and the states of some runs ``(runs, size)`` before and after it."""

    at: int
    shape: Shape
    before: Array
    shape_after: Shape
    after: Array


class Flight(NamedTuple):
    """What a flight leaves.

    rows: ``(K, runs, ...)`` by name. tally: of each run ``(runs, 5 stride)``. sentinels: of the runs
    that are watched.
    """

    rows: dict[str, Array]
    tally: Array
    sentinels: list[Sentinel]


def fly(
    engine: Engine,
    data: Data,
    every: int,
    jobs: int,
    device: Device | None = None,
    watched: Sequence[int] = (),
    number: int | None = None,
) -> Flight:
    """All runs through all epochs, on a device, or None: on this processor.

    watched: the runs whose states are kept before and after the sentinels. number: of a flight whose
    steps were all compared before: it has one sentinel, at an epoch that depends on its number.
    """
    runs, T = int(np.prod(engine.batch)), len(data.k)
    lanes = 0 if device else 1 if runs == 1 else llvm.lanes()
    inputs = {shape: engine.inputs(found, T) for shape, found in data.u.items()}
    plan = _planned(engine, data, inputs)
    records, steps = plan.records, plan.steps
    code, common = _coded(engine, plan, lanes) if lanes else ([], [])
    size = (engine.held + max(x.size for x in plan.known)) * engine.stride
    width = max((one.first + one.results for one in code), default=0)
    shared, own = _shared(data, inputs, width), _own(engine, data, inputs, runs)
    stored = np.where(np.arange(T) % every == 0, np.arange(T) // every, -1)
    if engine.few:
        stored[FEW:] = -1
    names, K, M = (
        engine.columns(),
        int(stored.max()) + 1,
        max((at + x.shape[-1] for at, x in own), default=1),
    )
    unit = lanes or 1
    kept, whole = (
        sum(names.values()),
        -(-runs // unit) * unit,
    )  # the last run fills a vector that is not full
    rows = {name: np.empty((K, whole, count)) for name, count in names.items()}
    counts = len(TALLY) * engine.stride
    tally, start = np.empty((runs, counts)), np.concatenate(engine.start(), 1)
    sentinels = _sentinels(steps, None if engine.fresh else number)
    seen = np.empty((2, len(sentinels), len(watched), size))  # before and after
    table = np.array(steps, np.int32), stored.astype(np.int64)
    loop = (
        _on_device(records, size, device)
        if device
        else _on_host([one.each for one in code], max(one.cells for one in code))
    )
    once = _once(code, table[0], shared, start[0], size, sentinels)

    def some(first: int) -> None:
        """A chunk of runs."""
        part = slice(first, min(first + chunk, runs))
        count = part.stop - first
        vector = lanes or count  # a device has all of them side by side
        width = -(-count // vector) * vector
        values, state = np.zeros((T, M, width)), np.zeros((width // vector, size, vector))
        for at, x in own:
            values[:, at : at + x.shape[-1], :count] += (
                x if x.shape[1] == 1 else x[:, part]
            ).transpose(0, 2, 1)
        values[..., count:] = values[..., count - 1 : count]
        begin = np.concatenate(
            [start[part], np.repeat(start[part.stop - 1 : part.stop], width - count, 0)]
        )
        state[:, : start.shape[1]] = begin.reshape(-1, vector, start.shape[1]).transpose(0, 2, 1)
        mine = [i for i, run in enumerate(watched) if part.start <= run < part.stop]
        block, lane = np.divmod(np.array([watched[i] - first for i in mine], int), vector)
        ends = {end for at in sentinels for end in (at, at + 1)} if mine else set[int]()
        for start_at, end in pairwise(sorted({0, T, *ends})):
            here = slice(start_at, end)
            watch = sentinels.index(start_at) if mine and start_at in sentinels else None
            if watch is not None:
                seen[0, watch, mine] = state[block, :, lane]
            loop(*(x[here] for x in table), state, shared[here], values[here], rows, first)
            if watch is not None:
                seen[1, watch, mine] = state[block, :, lane]
        tally[part] = state[:, :counts].transpose(0, 2, 1).reshape(width, -1)[:count]

    room = (
        device.room() // jobs // (8 * (T * M + K * kept + size)) if device else CHUNK // (8 * T * M)
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
                entries = common[plan.at[at + side]]
                seen[side, k][:, entries] = once[side, k, entries]
    kept_rows = {name: np.ascontiguousarray(x[:, :runs]) for name, x in rows.items()}
    before_after = zip(sentinels, *seen, strict=True)
    return Flight(
        kept_rows,
        tally,
        [
            Sentinel(at, plan.known[plan.at[at]], x, plan.known[plan.at[at + 1]], y)
            for at, x, y in before_after
        ],
    )


def _sentinels(steps: list[int], number: int | None = None) -> list[int]:
    """Epochs whose steps are compared with numpy's: the first, the last, one of each record, and some drawn by a hash.

    number: of a flight that has one of them only.
    """
    if number is not None:
        return [crc32(b"flight %d" % number) % len(steps)]
    drawn = [crc32(b"%d of %d" % (i, len(steps))) % len(steps) for i in range(DRAWN)]
    return sorted({0, len(steps) - 1, *np.unique(steps, return_index=True)[1].tolist(), *drawn})


def _on_host(kernels: Sequence[int], cells: int) -> Callable[..., None]:
    """What takes ``(kinds, at, state, shared, own)`` through all epochs on this processor, and writes the
    rows of runs from the ``first`` on. kernels: their addresses. cells: of their memory."""
    addresses, loop = np.array(kernels, np.uint64), llvm.fly()

    def flown(
        kinds: Array,
        at: Array,
        state: Array,
        shared: Array,
        own: Array,
        rows: dict[str, Array],
        first: int,
    ) -> None:
        blocks, size, lanes = state.shape
        memory, fields = (
            llvm.aligned((cells, lanes)),
            np.array([x.ctypes.data for x in rows.values()], np.uint64),
        )
        pointers = (
            x.ctypes.data for x in (addresses, kinds, at, state, shared, own, fields, memory)
        )
        runs = next((x.shape[1] for x in rows.values()), 0)
        loop(
            *pointers,
            size,
            shared.shape[1],
            own.shape[1],
            runs,
            first,
            own.shape[2],
            lanes,
            0,
            blocks,
            len(own),
        )

    return flown


def _on_device(records: Sequence[Recorded], size: int, device: Device) -> Callable[..., None]:
    """The same on a device; a state is of ``size`` numbers."""
    entry = device.entry(ptx.program([record.kernel for record in records], size))

    def flown(
        kinds: Array,
        at: Array,
        state: Array,
        shared: Array,
        own: Array,
        rows: dict[str, Array],
        first: int,
    ) -> None:
        stored = at[at >= 0]
        begin, end = (int(stored[0]), int(stored[-1]) + 1) if len(stored) else (0, 0)
        kept = np.where(at >= 0, at - begin, -1)
        shapes = [(end - begin, own.shape[2], x.shape[2]) for x in rows.values()]
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
        out = np.empty(max(1, *ends))
        device.fly(entry, kinds, kept, state, shared, own, out)
        for x, shape, part in zip(rows.values(), shapes, np.split(out, ends), strict=False):
            x[begin:end, first : first + shape[1]] = part.reshape(shape)

    return flown


class _Plan(NamedTuple):
    """The records that a flight needs, and which of them each epoch takes.

    edges: of each record, the numbers of the shapes before and after it. steps: of each epoch, the
    number of its record. at: the number of the shape before each epoch, and at the end. known: shapes.
    """

    records: list[Recorded]
    edges: list[tuple[int, int]]
    steps: list[int]
    at: list[int]
    known: list[Shape]


def _planned(engine: Engine, data: Data, inputs: dict[Any, Any]) -> _Plan:
    """Steps of all epochs, recorded."""
    ids: dict[Shape, int] = {engine.begin: 0}
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
    return _Plan(records, edges, steps, places, list(ids))


def _coded(engine: Engine, plan: _Plan, lanes: int) -> tuple[list[Code], list[list[int]]]:
    """Machine code of all records, and the entries of the state of each shape that all runs have in common."""
    none: list[list[int]] = [[]] * len(plan.known)
    if lanes == 1 or engine.stride > 1:
        return [engine.code(made, lanes) for made in plan.records], none
    key = "common", tuple(map(id, plan.records)), engine.common()
    if key not in engine.kept.code:
        common = _common(engine, plan)
        splits = [
            made.kernel.split(common[before], common[after])
            for made, (before, after) in zip(plan.records, plan.edges, strict=True)
        ]
        engine.kept.code[key] = splits, [sorted(entries) for entries in common]
    splits, entries = engine.kept.code[key]
    T, count = len(plan.steps), np.bincount(plan.steps)
    saved = sum(int(n) * split.saved for n, split in zip(count, splits, strict=True))
    results = T * max(len(split.once.rows) for split in splits)
    if saved < APART * T or results > MOST_COMMON:
        return [engine.code(made, lanes) for made in plan.records], none
    pairs = zip(plan.records, splits, strict=True)
    return [engine.code(made, lanes, split) for made, split in pairs], entries


def _common(engine: Engine, plan: _Plan) -> list[frozenset[int]]:
    """Entries of the state of each shape that all runs have in common: the most that every record keeps so."""
    found: dict[int, frozenset[int]] = {0: engine.common()}
    while True:
        before = dict(found)
        for made, (begin, end) in zip(plan.records, plan.edges, strict=True):
            uniform = made.kernel.uniform(
                found[begin]
            )  # a record stands behind those that lead to it
            same = frozenset(
                i
                for i, x in made.kernel.state
                if i >= engine.held and (not isinstance(x, Number) or uniform[x.i])
            )
            found[end] = found.get(end, same) & same
        if found == before:
            return [found[i] for i in range(len(found))]


def _once(
    code: list[Code],
    kinds: Array,
    shared: Array,
    start: Array,
    size: int,
    sentinels: list[int],
) -> Array | None:
    """Take what all runs have in common through all epochs, which adds its results to ``shared``.

    start: the state before the first epoch of any run. Returns the states before and after the
    sentinels ``(2, sentinels, size)``; None where the runs have nothing in common.
    """
    kernels = [one.once for one in code if one.once is not None]
    if not kernels:
        return None
    T, width = shared.shape
    at = np.arange(T) * width + np.array([one.first for one in code])[kinds]
    loop = _on_host(kernels, max(one.cells for one in code))
    state = np.zeros((1, size, 1))
    state[0, : len(start), 0] = start
    seen, none = np.empty((2, len(sentinels), size)), np.zeros((T, 1, 1))
    for begin, end in pairwise(sorted({0, T, *sentinels, *(k + 1 for k in sentinels)})):
        here = slice(begin, end)
        if begin in sentinels:
            seen[0, sentinels.index(begin)] = state[0, :, 0]
        loop(kinds[here], at[here], state, shared[here], none[here], {"": shared[:, None]}, 0)
        if begin in sentinels:
            seen[1, sentinels.index(begin)] = state[0, :, 0]
    return seen


def _shared(data: Data, inputs: dict[Any, list[tuple[Array, bool]]], width: int) -> Array:
    """What all runs have in common at each epoch ``(T, E)``: index, time, interval, inputs, and room for at least ``width``."""
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
    """What each run has of its own at each epoch, ``(T, runs or 1, ...)``, and where it stands: measurements, interval, inputs."""
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
