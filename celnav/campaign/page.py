"""The outputs of a study in its folder: tables, figures, and a page that shows them."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from platform import machine, python_version
from typing import TYPE_CHECKING, Any

from celnav.campaign import CampaignResult
from celnav.campaign.table import TIME, columns, costs, plain, to_csv, to_parquet
from celnav.files import Outputs
from celnav.papers.own import name_of
from celnav.show.draw import picture_names, pictures
from celnav.show.page import render
from celnav.study.store import code

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TABLES = ("table.csv", "table.parquet", "times.csv")
PAGE = "index.html"
MOST_ROWS = 2000


def names(stems: Iterable[str]) -> list[str]:
    """Files that `write` makes."""
    return [*TABLES, PAGE, *picture_names(f"figures/{stem}" for stem in stems)]


def write(
    outcome: CampaignResult, drawings: Mapping[str, Figure], outputs: Outputs, recording: str = ""
) -> None:
    """Write tables, figures and page; ``recording``: the name of one to link to.

    Raises
    ------
    ForeignFileError: before anything is written, if a file is in the way. OSError: naming a file
        that cannot be written.
    """
    cells, times = columns(outcome.rows), costs(outcome.rows)
    drawn = pictures((f"figures/{stem}", drawing) for stem, drawing in drawings.items())
    texts = {"table.csv": to_csv(cells), "times.csv": to_csv(times)}
    parquet = {"table.parquet": to_parquet(cells)}
    cells[TIME] = times[TIME]
    study, versions = outcome.study, {**code(), "python": python_version(), "machine": machine()}
    texts[PAGE] = render(
        "campaign.html",
        title=study.title,
        study=study,
        paper=name_of(study.paper),
        failed=sum(row["failed"] for row in outcome.rows),
        files=[*TABLES, recording] if recording else TABLES,
        pictures={
            stem: base64.b64encode(drawn[f"figures/{stem}.png"]).decode() for stem in drawings
        },
        head=cells,
        rows=zip(*([_cell(v) for v in column[:MOST_ROWS]] for column in cells.values())),
        more=len(outcome.rows) - MOST_ROWS,
        trace=outcome.trace,
        asked=[(key, plain(value)) for key, value in study.to_dict().items()],
        versions=", ".join(f"{name} {version}" for name, version in versions.items()),
    )
    outputs.publish(texts, parquet, drawn)


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
