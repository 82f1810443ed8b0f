"""Recordings of celnav, read back into arrays in double precision."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from celnav.files import InputError
from celnav.gaussian.checks import instance
from celnav.gaussian.linalg import Array
from celnav.lazy import requires_extra

__all__ = ["Entity", "Recorded", "read"]

APPLICATION = "celnav"
"""How the application of a recording begins."""
STUDY, START = "study", "start_s"
"""The entity with facts about a recording, and the fact with its start time."""
SHAPE = "_shape"
"""End of the name of the shape of an exact array, whose rows are stored flat."""
ROW = "rerun.controls.RowId"


@dataclass(frozen=True, eq=False)
class Entity:
    """What a recording has at one path.

    Attributes
    ----------
    times: ``(T,)`` s, to a nanosecond.
    values: arrays ``(T, ...)`` by name. Exact arrays have their own names and are bit for bit what
        was logged. A curve is ``"scalars"``, a lane of states ``"state"``; geometry is in single
        precision. Rows with fewer numbers than others end with nan.
    """

    times: Array
    values: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        """An array by its name; KeyError with the names that there are."""
        values: Array = _named(self.values, name)
        return values


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording, read back by `read`.

    Attributes
    ----------
    entities: by path, without static ones. facts: about the whole recording.
    start: time s at which it is shown first. start_date: date and time of ``t = 0``; None: unknown.
    """

    entities: Mapping[str, Entity]
    facts: Mapping[str, Any]
    start: float
    start_date: np.datetime64 | None

    def __getitem__(self, path: str) -> Entity:
        """An entity by its path; KeyError with the paths that there are."""
        entity: Entity = _named(self.entities, path)
        return entity

    @property
    def end(self) -> float:
        """The last time, s; 0 if there is none."""
        return max((float(e.times[-1]) for e in self.entities.values()), default=0.0)


def read(path: str | os.PathLike[str]) -> Recorded:
    """Read a recording back. Needs rerun.

    Parameters
    ----------
    path: an ``.rrd`` file of ``celnav reproduce``, ``celnav run`` or `celnav.show.recording`.

    Raises
    ------
    FileNotFoundError: if there is no such file.
    ValueError: if the file is damaged, is not a recording, or was not made by celnav.

    >>> run = celnav.show.read("out/csrukf/csrukf_P_I.rrd")
    >>> run["state/csrukf"].times, run["state/csrukf"]["covariance"]  # (T,) s, (T, 6, 6)
    """
    with requires_extra("reading a recording", "record"):
        import rerun as rr
        from rerun.error_utils import RerunWarning

    file = Path(instance("path", path, str | os.PathLike, "a path, such as 'flight.rrd'"))
    if not file.is_file():
        raise FileNotFoundError(f"{file}: no such recording")
    try:
        # The reader only warns of a file whose end is missing, and reads the rest.
        with warnings.catch_warnings(action="error", category=RerunWarning):
            reader = rr.chunk.RrdReader(file)
            makers = [entry.application_id for entry in reader.recordings()]
            chunks = reader.stream().to_chunks() if makers else []
    except (RuntimeError, ValueError, OSError, RerunWarning) as error:
        said = " ".join(str(error).split())[:200]
        raise InputError(
            f"{file}: expected a recording, got a damaged or other file ({said})"
        ) from None
    if not makers or not all(maker.startswith(APPLICATION) for maker in makers):
        made = ", ".join(makers) or "nothing"
        raise InputError(f"{file}: expected a recording of celnav, got one of {made}")
    moving: dict[str, list[Any]] = {}
    static: dict[str, dict[str, Any]] = {}
    for chunk in chunks:
        path, batch = str(chunk.entity_path).lstrip("/"), chunk.to_record_batch()
        if not chunk.is_static:
            moving.setdefault(path, []).append(batch)
        else:
            static.setdefault(path, {}).update(zip(batch.schema.names, batch.columns, strict=True))
    return _recorded(moving, static)


def _named(table: Mapping[str, Any], name: str) -> Any:
    if name not in table:
        raise KeyError(f"expected one of {', '.join(table)}, got {name!r}")
    return table[name]


def _recorded(moving: Mapping[str, list[Any]], static: Mapping[str, dict[str, Any]]) -> Recorded:
    """A recording from the batches of each entity, and the columns that hold for the whole run."""
    import pyarrow as pa

    entities, start_date = {}, None
    for path, batches in moving.items():
        tables = [pa.Table.from_batches([batch]) for batch in batches]
        table = pa.concat_tables(tables, promote_options="default")
        if "t" not in table.column_names:
            continue
        ticks = table.column("t").cast("int64").to_numpy()
        order = np.argsort(ticks, kind="stable")
        table, ticks = table.take(order), ticks[order]
        if "date" in table.column_names:
            start_date = np.datetime64(
                int(table.column("date").cast("int64")[0].as_py() - ticks[0]), "ns"
            )
        values = {}
        for field in table.schema:
            if pa.types.is_list(field.type):
                rows, name = _dense(table.column(field.name).combine_chunks()), field.name
                shape = static.get(path, {}).get(f"{name}{SHAPE}")
                if shape is not None:
                    rows = rows.reshape(shape[0].as_py())
                elif rows.shape[1] == 1:
                    rows = rows[:, 0]
                values[name.rpartition(":")[2]] = rows
        entities[path] = Entity(ticks / 1e9, values)
    table = static.get(f"__properties/{STUDY}", {})
    facts = {name: column[0].as_py()[0] for name, column in table.items() if name != ROW}
    start = facts.pop(START, None)
    found = Recorded(entities, facts, 0.0, start_date)
    return replace(found, start=found.end if start is None else start)


def _dense(column: Any) -> Array:
    """Lists of an arrow column as one array ``(T, k, ...)``; short rows end with nan or ""."""
    import pyarrow as pa

    if pa.types.is_fixed_size_list(column.type):
        inner = _dense(column.flatten())
        return inner.reshape(-1, column.type.list_size, *inner.shape[1:])
    if not pa.types.is_list(column.type):
        flat = column.to_numpy(zero_copy_only=False)
        return flat.astype(str) if flat.dtype == object else np.asarray(flat)
    inner = _dense(column.flatten())
    counts = column.value_lengths().fill_null(0).to_numpy()
    k = int(counts.max(initial=0))
    there = np.arange(k) < counts[:, None]
    if there.all():
        return inner.reshape(len(counts), k, *inner.shape[1:])
    text = inner.dtype.kind == "U"
    dtype = inner.dtype if text else np.result_type(inner.dtype, np.float32)
    rows = np.full((len(counts), k, *inner.shape[1:]), "" if text else np.nan, dtype)
    rows[there] = inner
    return rows
