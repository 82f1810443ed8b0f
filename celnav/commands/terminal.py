"""Text wrapped to the width of the terminal; in a pipe or a file lines are not wrapped."""

from __future__ import annotations

import shutil
import sys
import textwrap
from typing import TYPE_CHECKING

from celnav.show.claims import style

if TYPE_CHECKING:
    from rich.text import Text

UNLIMITED = 1_000_000
INDENT = 26
"""Columns before the text of an entry."""
LOOKS = {
    "good": ("✓", "green"),
    "part": ("½", "yellow"),
    "bad": ("✗", "red"),
    "error": ("!", "magenta"),
    "open": ("?", "blue"),
}
"""Sign and color of each `style` of a verdict."""


def columns() -> int:
    """Width of the terminal; very large if the output is not a terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else UNLIMITED


def entry(name: str, text: str) -> None:
    """Print a name and its text, with further lines indented."""
    head, width = f"  {name}".ljust(INDENT - 1) + " ", columns()
    if len(head) > INDENT and width < UNLIMITED:
        print(*textwrap.wrap(head, width, subsequent_indent="    "), sep="\n")
        head = " " * INDENT
    lines = textwrap.wrap(
        text,
        width,
        initial_indent=head,
        subsequent_indent=" " * INDENT,
        break_on_hyphens=False,
    )
    print(*lines or [head.rstrip()], sep="\n")


def paragraph(text: str, indent: int = 0) -> None:
    """Print a text with its lines wrapped at words; continuations are indented."""
    for line in text.splitlines():
        hanging = " " * indent
        wrapped = textwrap.wrap(line, columns(), subsequent_indent=hanging, break_on_hyphens=False)
        print("\n".join(wrapped))


def marked(verdict: str, count: str = "") -> Text:
    """A verdict with its sign, in the color of the verdict."""
    from rich.text import Text

    sign, color = LOOKS[style(verdict)]
    return Text(" ".join(filter(None, [sign, count, verdict])), color)
