"""The table of a campaign: one row for each configuration and filter."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from itertools import takewhile
from typing import Any

import numpy as np

from celnav.campaign.missions import Configuration, MissionStudy
from celnav.campaign.scores import column, summarize
from celnav.campaign.units import Scored
from celnav.lazy import requires_extra

MOST_LINES = 40
TIME = "us_per_run_step"
TableRow = dict[str, Any]
"""Cells of a filter in a configuration, by column: the swept keys, "filter", the number of scored
"runs" and of "failed" runs, the statistics of `summarize` if a run was scored, the "reasons" of the
failures, and `TIME`.
"""


def rows_of(study: MissionStudy, point: Configuration, scored: Scored) -> Iterator[TableRow]:
    """Rows of a configuration, one for each filter."""
    values = {key: plain(value) for key, value in point.values.items()}
    for name in study.filters:
        failures = [
            (-count, why) for (filter, why), count in scored.reasons.items() if filter == name
        ]
        reasons = "; ".join(f"{-count} x {why}" for count, why in sorted(failures))
        cells: TableRow = {"runs": 0, "failed": -sum(count for count, _ in failures)}
        scores, steps = scored.scores.get(name), scored.steps[name]
        if scores and scores["runs"]:
            cells |= summarize(scores, scored.groups, scored.bound)
        elif not failures:
            reasons = "not a filter of this configuration"
        us = 1e6 * scored.cpu_s[name] / steps if steps else np.nan
        yield {**values, "filter": name, **cells, "reasons": reasons, TIME: us}


def plain(value: Any) -> Any:
    """A parameter's value for a cell; lists become text."""
    return " ".join(str(plain(v)) for v in value) if isinstance(value, tuple) else value


def swept(row: TableRow) -> list[str]:
    """The swept keys of a row."""
    return list(takewhile(lambda name: name != "filter", row))


def columns(rows: Sequence[TableRow]) -> dict[str, list[Any]]:
    """The table by column; None where there is no value.

    It has no CPU times, so that the same study gives the same table. `costs` has the times.
    """
    return _columns(rows, [name for name in max(rows, key=len) if name != TIME])


def costs(rows: Sequence[TableRow]) -> dict[str, list[Any]]:
    """CPU time of each row, per run and step."""
    return _columns(rows, [*swept(rows[0]), "filter", TIME])


def _columns(rows: Sequence[TableRow], names: Sequence[str]) -> dict[str, list[Any]]:
    return {name: [_cell(row.get(name)) for row in rows] for name in names}


def _cell(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value


def to_csv(table: dict[str, list[Any]]) -> str:
    """The table as CSV, with all digits of each number."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(
        ["" if v is None else repr(v) if isinstance(v, float) else v for v in row]
        for row in zip(*table.values(), strict=True)
    )
    return text.getvalue()


def to_parquet(table: dict[str, list[Any]]) -> bytes:
    """The table as a Parquet file."""
    with requires_extra("a table as Parquet", "papers"):
        import pyarrow as pa
        import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(pa.table({name: pa.array(values) for name, values in table.items()}), sink)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def summary(rows: Sequence[TableRow], groups: Sequence[tuple[str, str]]) -> str:
    """A few lines for a terminal: the accuracy of each row in the groups, and what failed."""
    lines = []
    for row in rows[:MOST_LINES]:
        where = ", ".join([*(f"{key} = {row[key]}" for key in swept(row)), row["filter"]])
        accuracies = [(name, row.get(column(name, "rms", unit)), unit) for name, unit in groups]
        parts = [f"{name} {rms:.4g} {unit}" for name, rms, unit in accuracies if rms is not None]
        parts += [f"anees {row['anees']:.3g}"] if "anees" in row else []
        parts += [f"failed: {row['reasons']}"] if row["failed"] else []
        lines.append(f"{where}: {', '.join(parts)}")
    rest = len(rows) - MOST_LINES
    return "\n".join([*lines, *([f"and {rest} more, in table.csv"] if rest > 0 else [])])
