"""What notebooks show besides figures: tables of parameters, and parts that a click opens.

>>> Folded("The parameters", parameters(config))
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from html import escape
from typing import Any

from celnav.gaussian.checks import instance
from celnav.show.claims import markdown


class Table:
    """Rows of texts below a head, aligned to the left."""

    def __init__(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        self._head, self._rows = list(head), [list(row) for row in rows]

    def __str__(self) -> str:
        return "\n".join("  ".join(row) for row in [self._head, *self._rows])

    def _repr_markdown_(self) -> str:
        return markdown([self._head, ["---"] * len(self._head), *self._rows])

    def _repr_html_(self) -> str:
        from celnav.show.page import aligned_left, macro

        return aligned_left(macro("plain_table", self._head, self._rows))


class Folded:
    """Objects behind a title; a click on it opens them."""

    def __init__(self, title: str, *shown: Any) -> None:
        self._title, self._shown = instance("title", title, str, "a text"), shown

    def __str__(self) -> str:
        return "\n\n".join([self._title, *map(str, self._shown)])

    def _repr_markdown_(self) -> str:
        return "\n\n".join([f"**{self._title}**", *(x._repr_markdown_() for x in self._shown)])

    def _repr_html_(self) -> str:
        inside = "".join(x._repr_html_() for x in self._shown)
        return f"<details><summary><b>{escape(self._title)}</b></summary>{inside}</details>"


def parameters(config: Any) -> Table:
    """The parameters of a study's configuration: value, where it is from, and what it means."""
    rows = [
        [field.name, str(getattr(config, field.name)), *map(str, _explained(field))]
        for field in dataclasses.fields(config)
    ]
    return Table(["parameter", "value", "source", "meaning"], rows)


def _explained(field: dataclasses.Field[Any]) -> tuple[str, str]:
    return field.metadata.get("source", ""), field.metadata.get("meaning", "")
