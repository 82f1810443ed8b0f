"""The table of a campaign: one row for each configuration and filter."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from celnav.campaign.missions import Configuration, MissionStudy
from celnav.campaign.scores import Accuracy, Summary, summarize
from celnav.campaign.units import Scored
from celnav.lazy import requires_extra

MOST_LINES = 40


class TableRow(NamedTuple):
    """What a filter comes to in a configuration.

    Attributes
    ----------
    values: of the swept keys. groups: name and unit of what was judged. summary: None if no run is
        left, and then there may be no groups. reasons: why runs failed, and how many of them. us:
        CPU microseconds per run and step.
    """

    values: dict[str, Any]
    filter: str
    groups: tuple[tuple[str, str], ...]
    summary: Summary | None
    reasons: Counter[str]
    us: float

    @property
    def failed(self) -> int:
        """Runs that are not in the summary."""
        return self.reasons.total()

    def accuracy(self, group: str) -> Accuracy | None:
        """Of a group by name."""
        names = [name for name, _ in self.groups]
        return (
            self.summary.accuracy[names.index(group)]
            if self.summary is not None and group in names
            else None
        )


def rows_of(study: MissionStudy, point: Configuration, found: Scored) -> Iterator[TableRow]:
    """Rows of a configuration, one for each filter."""
    for name in study.filters:
        scores, steps = found.scores.get(name), found.steps[name]
        reasons = {why: count for (filter, why), count in found.reasons.items() if filter == name}
        summary = summarize(scores, found.bound) if scores and scores["runs"] else None
        us = 1e6 * found.cpu_s[name] / steps if steps else np.nan
        yield TableRow(point.values, name, found.groups, summary, Counter(reasons), us)


def plain(value: Any) -> Any:
    """A parameter's value for a cell: lists become words."""
    return " ".join(str(plain(v)) for v in value) if isinstance(value, tuple) else value


def columns(rows: Sequence[TableRow]) -> dict[str, list[Any]]:
    """The table by column: swept keys, filter, runs, failures, accuracies with their units,
    consistency; None where there is none.

    No times: the same study gives the same table. They are in `costs`.
    """
    groups = next((row.groups for row in rows if row.groups), ())
    table = [_cells(row, groups) for row in rows]
    return {name: [cells[name] for cells in table] for name in table[0]}


def costs(rows: Sequence[TableRow]) -> dict[str, list[Any]]:
    """CPU time of each row, per run and step."""
    keys = {key: [plain(row.values[key]) for row in rows] for key in rows[0].values}
    return {
        **keys,
        "filter": [row.filter for row in rows],
        "us_per_run_step": [_number(row.us) for row in rows],
    }


def _cells(row: TableRow, groups: tuple[tuple[str, str], ...]) -> dict[str, Any]:
    cells: dict[str, Any] = {key: plain(value) for key, value in row.values.items()} | {
        "filter": row.filter
    }
    s = row.summary
    cells |= {"runs": s.runs if s else 0, "failed": row.failed}
    for name, unit in groups:
        found, slug = row.accuracy(name), unit.replace("/", "_per_")
        for stat in Accuracy._fields:
            label = f"{name}_{stat}" if stat == "efficiency" else f"{name}_{stat}_{slug}"
            cells[label] = None if found is None else _number(getattr(found, stat))
    names = (
        "anees",
        "anees_low",
        "anees_high",
        "band_low",
        "band_high",
        "nis",
        "nees_beyond",
        "nis_beyond",
    )
    values = (
        (s.anees, s.low, s.high, *s.band, s.nis, s.nees_beyond, s.nis_beyond)
        if s
        else (np.nan,) * 8
    )
    cells |= {name: _number(value) for name, value in zip(names, values, strict=True)}
    listed = sorted(row.reasons.items(), key=lambda item: (-item[1], item[0]))
    absent = s is None and not listed
    cells["reasons"] = (
        "not a filter of this configuration"
        if absent
        else "; ".join(f"{count} x {why}" for why, count in listed)
    )
    return cells


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def to_csv(table: dict[str, list[Any]]) -> str:
    """CSV, every number with all its digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(
        ["" if v is None else repr(v) if isinstance(v, float) else v for v in row]
        for row in zip(*table.values(), strict=True)
    )
    return text.getvalue()


def to_parquet(table: dict[str, list[Any]]) -> bytes:
    """The same as a Parquet file."""
    with requires_extra("a table as Parquet", "papers"):
        import pyarrow as pa
        import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(pa.table({name: pa.array(values) for name, values in table.items()}), sink)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def summary(rows: Sequence[TableRow]) -> str:
    """A few lines for a terminal: the accuracy of each row, and what failed."""
    lines = []
    for row in rows[:MOST_LINES]:
        where = ", ".join(
            [*(f"{key} = {plain(value)}" for key, value in row.values.items()), row.filter]
        )
        found = [(name, unit, row.accuracy(name)) for name, unit in row.groups]
        parts = [f"{name} {a.rms:.4g} {unit}" for name, unit, a in found if a is not None]
        parts += [f"anees {row.summary.anees:.3g}"] if row.summary is not None else []
        parts += [f"{row.failed} failed ({row.reasons.most_common(1)[0][0]})"] if row.failed else []
        lines.append(f"{where}: {', '.join(parts)}")
    rest = len(rows) - MOST_LINES
    return "\n".join([*lines, *([f"and {rest} more, in table.csv"] if rest > 0 else [])])
