"""The flight of a compiled step: epochs as columns, blocks of runs through all of them, and what is kept of it."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.engine import FULL, NONE, PART, SILENT, TALLY, Data, Engine, Kind, Recorded, Shape, leaves, rebuilt
from celnav.filters.model import Sensor
from celnav.filters.records import Epoch, Epochs, check_interval
from celnav.filters.sequential import checked, measurements
from celnav.gaussian.checks import numbers
from celnav.gaussian.linalg import Array
from celnav.tape import llvm
from celnav.tape.tape import CannotCompile

FEW = 3  # rows of a flight that keeps nothing, by which it is checked
CHUNK = 1 << 22  # bytes of measurements and rows of the runs that are flown together


def sensors(filter: Any, z: Any) -> Sequence[Any]:
    """Sensors of a filter, or of its first stage; of another filter what is taken for them, for measurements such as ``z``."""
    inner = filter if hasattr(filter, "sensors") else getattr(filter, "first", None)
    found = getattr(inner if hasattr(inner, "sensors") else getattr(inner, "filter", None), "sensors", None)
    if found is not None:
        return tuple(found)
    return (Sensor(lambda x, _epoch: x, R=lambda _mean, _epoch: np.eye(1)),) * (len(z) if isinstance(z, tuple) else 1)


def as_data(filter: Any, epochs: Epochs | Sequence[Epoch]) -> Data:
    """Epochs as columns."""
    if not len(epochs):
        raise ValueError("epochs: expected at least one, got none")
    own = sensors(filter, epochs[0].z)
    if isinstance(epochs, Epochs):
        k, t, dt, u, z = epochs.columns(len(own))
    else:
        before = None
        for epoch in epochs:
            check_interval(filter, epoch, before)
            before = epoch.t
        k, t = (np.array([getattr(epoch, name) for epoch in epochs], np.float64) for name in ("k", "t"))
        dt = np.stack(np.broadcast_arrays(*(np.asarray(epoch.dt, np.float64) for epoch in epochs)))
        u = [epoch.u for epoch in epochs]
        z = tuple(zip(*(measurements(epoch.z, len(own)) for epoch in epochs), strict=True))
    found = [_measured(sensor, parts) for sensor, parts in zip(own, z, strict=True)]
    shapes: dict[Any, int] = {}
    inputs: list[dict[int, list[Array]]] = []
    which = np.zeros(len(k), int)
    for i, one in enumerate(u):
        parts = [_input(x) for x, _ in leaves(one)]
        shape = rebuilt(one, iter(range(len(parts)))), tuple(x.shape for x in parts)
        which[i] = shapes.setdefault(shape, len(inputs))
        if which[i] == len(inputs):
            inputs.append({})
        inputs[which[i]][i] = parts
    moves = (dt.reshape(len(k), -1) != 0.0).any(-1)
    rows = np.stack([moves, which, *(status for status, _ in found)], -1)
    different, kinds = np.unique(rows, axis=0, return_inverse=True)
    trees = list(shapes)
    known = [Kind(bool(moves), tuple(z), trees[at]) for moves, at, *z in different.tolist()]
    return Data(k, t, dt, kinds.tolist(), known, own, [values for _, values in found], dict(zip(trees, inputs, strict=True)))


def _input(x: Any) -> Array:
    """A part of an input."""
    try:
        return numbers("u", x)
    except ValueError as error:
        raise CannotCompile(f"an input that is no array of numbers cannot be compiled: {error}") from None


def _measured(sensor: Any, parts: Any) -> tuple[Array, Array]:
    """What there is of a sensor at each epoch, and its measurements ``(T, ..., m)``."""
    count = len(parts)
    present = np.array([part is not None for part in parts]) if not isinstance(parts, np.ndarray) else np.ones(count, bool)
    if not present.any():
        return np.full(count, NONE), np.zeros((count, 0))
    if not isinstance(parts, np.ndarray):
        one = np.full(np.shape(parts[int(np.argmax(present))]), np.nan)
        parts = np.stack(np.broadcast_arrays(*(one if part is None else numbers("z", part) for part in parts)))
    values = checked(parts, sensor)
    if np.isfinite(np.add.reduce(values, None)):
        return np.where(present, FULL, NONE), values
    missing = np.isnan(values)
    axes = tuple(range(1, values.ndim))
    there = np.where(missing.all(axes), SILENT, np.where(missing.any(axes), PART, FULL))
    return np.where(present, there, NONE), values


class Flight(NamedTuple):
    """What a flight leaves: rows ``(K, runs, ...)`` by name, and the tally of each run ``(runs, 4)``."""

    rows: dict[str, Array]
    tally: Array


def fly(engine: Engine, data: Data, every: int, jobs: int) -> Flight:
    """All runs through all epochs."""
    runs = int(np.prod(engine.batch))
    lanes = 1 if runs == 1 else llvm.lanes()
    inputs = {shape: engine.inputs(found, len(data.k)) for shape, found in data.u.items()}
    ids: dict[Shape, int] = {engine.begin: 0}
    plan: dict[tuple[int, int], tuple[int, int]] = {}
    records: list[Recorded] = []
    shape, steps = engine.begin, []
    for kind in data.kinds:
        at = ids.setdefault(shape, len(ids))
        if (at, kind) not in plan:
            made = engine.recorded_as(shape, data.known[kind], inputs[data.known[kind].u], lanes)
            plan[at, kind] = len(records), ids.setdefault(made.after, len(ids))
            records.append(made)
        number, _ = plan[at, kind]
        steps.append(number)
        shape = records[number].after
    size = engine.held + max(x.size for x in ids)
    E = 3 + max(sum(x[0].size for x, own in parts if not own) for parts in inputs.values())
    own_sizes = [sum(int(np.prod(x.shape[1 + len(engine.batch) :])) for x, own in parts if own) for parts in inputs.values()]
    M, T = sum(engine.widths) + max(own_sizes) + (data.dt.ndim > 1), len(data.k)
    shared = np.zeros((T, E))
    shared[:, 0], shared[:, 1] = data.k, data.t
    if data.dt.ndim == 1:
        shared[:, 2] = data.dt
    for parts in inputs.values():
        flat = [x.reshape(T, -1) for x, own in parts if not own]
        if flat:
            values = np.concatenate(flat, -1)
            shared[:, 3 : 3 + values.shape[1]] += values
    stored = np.where(np.arange(T) % every == 0, np.arange(T) // every, -1)
    if engine.few:
        stored[FEW:] = -1
    names = engine.columns()
    kept, K = sum(names.values()), int(stored.max()) + 1
    rows = {name: np.empty((K, runs, count)) for name, count in names.items()}
    tally = np.empty((runs, len(TALLY)))
    table = (np.array([record.address for record in records], np.uint64), np.array(steps, np.int32), stored.astype(np.int64))
    z = [np.broadcast_to(x, (T, *engine.batch, x.shape[-1])).reshape(T, runs, -1) if x.ndim > 2 and x.shape[1:-1] != engine.batch
         else x.reshape(T, -1, x.shape[-1]) for x in data.z if x.shape[-1]]  # fmt: skip
    per_run = [x.reshape(T, runs, -1) for parts in inputs.values() for x, own in parts if own]
    loop = llvm.fly()

    def some(first: int, last: int) -> None:
        count = last - first
        width = -(-count // lanes) * lanes
        own = np.empty((T, M, width))
        at = 0
        for x in (*z, *per_run):
            part = x if x.shape[1] == 1 else x[:, first:last]
            own[:, at : at + x.shape[-1], :count] = part.transpose(0, 2, 1)
            at += x.shape[-1]
        own[..., count:] = own[..., count - 1 : count]
        state = np.zeros((width // lanes, size, lanes))
        start = np.concatenate([x[first:last] for x in engine.start()], 1)
        start = np.concatenate([start, np.repeat(start[-1:], width - count, 0)])
        state[:, : start.shape[1]] = start.reshape(-1, lanes, start.shape[1]).transpose(0, 2, 1)
        out = np.empty((K, kept, width))
        pointers = (x.ctypes.data for x in (*table, state, shared, own, out))
        loop(*pointers, size, E, M, kept, width, lanes, 0, width // lanes, T)
        at = 0
        for name, number in names.items():
            rows[name][:, first:last] = out[:, at : at + number, :count].transpose(0, 2, 1)
            at += number
        tally[first:last] = state[:, : len(TALLY)].transpose(0, 2, 1).reshape(width, -1)[:count]

    chunk = max(lanes, min(-(-runs // jobs), CHUNK // (8 * T * (kept + M))) // lanes * lanes)
    firsts = range(0, runs, chunk)
    if jobs > 1 and len(firsts) > 1:
        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(lambda first: some(first, min(first + chunk, runs)), firsts))
    else:
        for first in firsts:
            some(first, min(first + chunk, runs))
    return Flight(rows, tally)
