"""Everything that a study leaves in its folder: tables, figures, and a page that shows them."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping
from platform import machine, python_version
from typing import TYPE_CHECKING, Any

from celnav.campaign import Outcome
from celnav.campaign.table import columns, costs, plain, to_csv, to_parquet
from celnav.files import Outputs
from celnav.papers.own import name_of
from celnav.show.drawing import render
from celnav.show.page import document, figure, link, table
from celnav.store import code

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["names", "write"]

TABLES = ("table.csv", "table.parquet", "times.csv")
PAGE = "index.html"
MOST_ROWS = 2000
_LEGEND = """All but failed: of the runs that did not fail. rms: of the length of the vector, over runs and settled epochs, low to
high with 95 %; final: at the end; sigma: what the filter takes it for; bound: linearized posterior Cramér–Rao bound of all runs;
efficiency: bound over rms; anees: NEES over its dimension, 1 if consistent; band: of a consistent filter at one epoch; nis:
likewise over its degrees of freedom; beyond: part of single values above the 95 % quantile, 0.05 if consistent."""


def names(stems: Iterable[str]) -> list[str]:
    """Files that `write` makes."""
    return [*TABLES, PAGE, *(f"figures/{stem}.{kind}" for stem in stems for kind in ("png", "svg"))]


def write(
    outcome: Outcome, drawings: Mapping[str, Figure], outputs: Outputs, recording: str = ""
) -> None:
    """Write tables, figures and page; ``recording``: the name of one to link to.

    Raises
    ------
    ForeignFileError: before anything is written, if a file is in the way. OSError: naming a file that cannot be written.
    """
    outputs.check(names(drawings))
    cells, times = columns(outcome.rows), costs(outcome.rows)
    outputs.text("table.csv", to_csv(cells))
    outputs.bytes("table.parquet", to_parquet(cells))
    outputs.text("times.csv", to_csv(times))
    pictures = {
        stem: {kind: render(drawing, kind) for kind in ("png", "svg")}
        for stem, drawing in drawings.items()
    }
    for stem, kinds in pictures.items():
        for kind, content in kinds.items():
            outputs.bytes(f"figures/{stem}.{kind}", content)
    shown = {**cells, "us_per_run_step": times["us_per_run_step"]}
    outputs.text(
        PAGE,
        _page(outcome, shown, {stem: kinds["png"] for stem, kinds in pictures.items()}, recording),
    )


def _page(
    outcome: Outcome, cells: Mapping[str, list[Any]], pictures: Mapping[str, bytes], recording: str
) -> str:
    study = outcome.study
    files = [*TABLES, *([recording] if recording else [])]
    failed = sum(row.failed for row in outcome.rows)
    asked = [[key, str(plain(value))] for key, value in study.to_dict().items()]
    versions = {**code(), "python": python_version(), "machine": machine()}
    return document(
        study.title,
        f"<h1>{html.escape(study.title)}</h1>",
        f"<p>{len(study.configurations)} configurations × {len(study.filters)} filters × {study.runs} runs of "
        f"<code>{html.escape(name_of(study.paper))}</code>, {failed} of them failed. "
        f"Files: {' · '.join(link(f, f) for f in files)}.</p>",
        '<div class="wide">',
        *(
            figure(stem.replace("_", " ").capitalize(), png, f"figures/{stem}.svg")
            for stem, png in pictures.items()
        ),
        "</div><h2>Table</h2>",
        f"<p>{_LEGEND}</p>",
        table(
            cells,
            zip(
                *([_cell(v) for v in column[:MOST_ROWS]] for column in cells.values()), strict=True
            ),
        ),
        f"<p>The other {len(outcome.rows) - MOST_ROWS} rows are in {TABLES[0]}.</p>"
        if len(outcome.rows) > MOST_ROWS
        else "",
        f"<h2>The first exception</h2><pre>{html.escape(outcome.trace)}</pre>"
        if outcome.trace
        else "",
        "<h2>What was asked</h2>",
        table(("key", "value"), asked),
        f"<p>{html.escape(', '.join(f'{k} {v}' for k, v in versions.items()))}</p>",
    )


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
