"""The flight of a compiled step: epochs as columns, blocks of runs through all of them, and what is kept of it.

The states of some runs before and after some epochs are kept too, to be compared with numpy's steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
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
from celnav.filters.records import Epoch, Epochs, check_interval
from celnav.filters.sequential import checked, measurements
from celnav.gaussian.checks import numbers
from celnav.gaussian.linalg import Array
from celnav.tape import llvm, ptx
from celnav.tape.cuda import Device
from celnav.tape.tape import CannotCompile

__all__ = ["Flight", "Sentinel", "as_data", "epoch_of", "fly", "part_of", "sensors"]

DRAWN = 4  # sentinels besides the first, the last and one of each record
FEW = 3  # rows of a flight that keeps nothing, by which it is checked
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
    if isinstance(epochs, Epochs):
        k, t, dt, u, z = epochs.columns(len(own))
        u = [(one, None) for one in u]
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
        u = [(epoch.u, epoch.about) for epoch in epochs]
        z = tuple(zip(*(measurements(epoch.z, len(own)) for epoch in epochs), strict=True))
    found = [_measured(sensor, parts) for sensor, parts in zip(own, z, strict=True)]
    shapes: dict[Any, int] = {}
    inputs: list[dict[int, list[Array]]] = []
    which = np.zeros(len(k), int)
    none = all(one is None and about is None for one, about in u)
    for i, one in enumerate(u[:1] if none else u):
        parts = [_input(x) for x, _ in leaves(one)]
        shape = rebuilt(one, iter(range(len(parts)))), tuple(x.shape for x in parts)
        which[i] = shapes.setdefault(shape, len(inputs))
        if which[i] == len(inputs):
            inputs.append({})
        inputs[which[i]][i] = parts
    moves = (dt.reshape(len(k), -1) != 0.0).any(-1)
    code = 2 * which + moves
    for status, _ in found:
        code = 4 * code + status  # of FULL, PART, SILENT and NONE
    _, first, kinds = np.unique(code, return_index=True, return_inverse=True)
    trees = list(shapes)
    known = [
        Kind(bool(moves[i]), tuple(int(status[i]) for status, _ in found), trees[which[i]])
        for i in first.tolist()
    ]
    return Data(
        k,
        t,
        dt,
        kinds,
        known,
        own,
        [values for _, values in found],
        dict(zip(trees, inputs, strict=True)),
    )


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
    inputs = data.u[kind.u].get(i, [])
    own = [part(x, x.ndim - len(batch)) if is_own(x, batch) else x for x in inputs]
    u, about = rebuilt(kind.u[0], iter(own))
    dt = data.dt[i]
    interval = part(dt, 0) if dt.ndim else float(dt)
    measured = z[0] if len(z) == 1 else z or None
    k: Any = float(data.k[i])
    return Epoch(
        int(k) if k.is_integer() else k, float(data.t[i]), interval, u, measured, about=about
    )


def _input(x: Any) -> Array:
    """A part of an input."""
    try:
        return numbers("u", x)
    except ValueError as error:
        raise CannotCompile(
            f"an input that is no array of numbers cannot be compiled: {error}"
        ) from None


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
    records, steps, shapes = _planned(engine, data, inputs, lanes)
    size = (engine.held + max(x.size for x in set(shapes))) * engine.stride
    shared, own = _shared(data, inputs), _own(engine, data, inputs, runs)
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
    table, loop = (np.array(steps, np.int32), stored.astype(np.int64)), _loop(records, size, device)

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
    kept_rows = {name: np.ascontiguousarray(x[:, :runs]) for name, x in rows.items()}
    before_after = zip(sentinels, *seen, strict=True)
    return Flight(
        kept_rows,
        tally,
        [Sentinel(at, shapes[at], x, shapes[at + 1], y) for at, x, y in before_after],
    )


def _sentinels(steps: list[int], number: int | None = None) -> list[int]:
    """Epochs whose steps are compared with numpy's: the first, the last, one of each record, and some drawn by a hash.

    number: of a flight that has one of them only.
    """
    if number is not None:
        return [crc32(b"flight %d" % number) % len(steps)]
    drawn = [crc32(b"%d of %d" % (i, len(steps))) % len(steps) for i in range(DRAWN)]
    return sorted({0, len(steps) - 1, *np.unique(steps, return_index=True)[1].tolist(), *drawn})


def _loop(records: Sequence[Recorded], size: int, device: Device | None) -> Callable[..., None]:
    """What takes ``(kinds, at, state, shared, own)`` through all epochs, and writes the rows of runs from the ``first`` on; a state
    is of ``size`` numbers."""
    if device is not None:
        return partial(
            _on_device,
            device,
            device.entry(ptx.program([record.kernel for record in records], size)),
        )
    addresses, loop = np.array([record.address for record in records], np.uint64), llvm.fly()
    cells = max(record.kernel.cells for record in records)

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


def _on_device(
    device: Device,
    entry: Any,
    kinds: Array,
    at: Array,
    state: Array,
    shared: Array,
    own: Array,
    rows: dict[str, Array],
    first: int,
) -> None:
    """The same on a device."""
    stored = at[at >= 0]
    begin, end = (int(stored[0]), int(stored[-1]) + 1) if len(stored) else (0, 0)
    kept = np.where(at >= 0, at - begin, -1)
    shapes = [(end - begin, own.shape[2], x.shape[2]) for x in rows.values()]
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
    out = np.empty(max(1, *ends))
    device.fly(entry, kinds, kept, state, shared, own, out)
    for x, shape, part in zip(rows.values(), shapes, np.split(out, ends), strict=False):
        x[begin:end, first : first + shape[1]] = part.reshape(shape)


def _planned(
    engine: Engine, data: Data, inputs: dict[Any, Any], lanes: int
) -> tuple[list[Recorded], list[int], list[Shape]]:
    """The records that are needed, which of them each epoch takes, and the shapes of the state before each, and at the end."""
    ids: dict[Shape, int] = {engine.begin: 0}
    records: dict[
        tuple[int, int], tuple[int, int, Recorded]
    ] = {}  # by the shape before and the kind; with the shape after
    at, steps, places = 0, [], [0]
    kinds = data.kinds.tolist()
    for i, kind in enumerate(kinds):
        if (at, kind) not in records:
            there = data.known[kind]
            made = engine.recorded_as(list(ids)[at], there, inputs[there.u], lanes)
            records[at, kind] = len(records), ids.setdefault(made.after, len(ids)), made
            stays = {k: n for (b, k), (n, after, _) in records.items() if b == at == after}
            if stays.keys() >= set(kinds[i:]):  # from here on the state keeps its shape
                steps += [stays[k] for k in kinds[i:]]
                places += [at] * (len(kinds) - i)
                break
        number, at, _ = records[at, kind]
        steps.append(number)
        places.append(at)
    known = list(ids)
    return [made for *_, made in records.values()], steps, [known[at] for at in places]


def _shared(data: Data, inputs: dict[Any, list[tuple[Array, bool]]]) -> Array:
    """What all runs have in common at each epoch ``(T, E)``: index, time, interval, inputs."""
    T = len(data.k)
    flat = [
        np.concatenate([np.zeros((T, 0)), *(x.reshape(T, -1) for x, own in parts if not own)], 1)
        for parts in inputs.values()
    ]
    out = np.zeros((T, 3 + max(x.shape[1] for x in flat)))
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
