"""``celnav verdicts``: the claims of studies and their verdicts, as a table and paragraphs. The
output is Markdown in a pipe or a file.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from celnav.commands.arguments import UsageError
from celnav.commands.index import Claims, deciding, partial, reproduced, summary, verdicts
from celnav.commands.terminal import marked, paragraph
from celnav.files import did_you_mean
from celnav.papers import REAL
from celnav.papers.own import name_of
from celnav.show.claims import cells, columns, ledger, tally

if TYPE_CHECKING:
    from rich.table import Table


def run(options: argparse.Namespace) -> int:
    """Print the number of verdicts of each reproduced paper, or the verdicts of one paper."""
    out = Path(options.out)
    every = reproduced(out)
    counted = [name for name in every if options.paper is not None or name not in REAL]
    if not counted:
        raise FileNotFoundError(
            f"{options.out}: no paper was reproduced here; use: celnav reproduce --out "
            f"{options.out}"
        )
    if options.paper is None:
        claims = {name: every[name] for name in counted}
    else:
        name = name_of(options.paper)
        if name not in every:
            raise UsageError(
                f"PAPER: expected a paper reproduced in {out} ({', '.join(every)}), got "
                f"{options.paper!r}{did_you_mean(name, every)}"
            )
        claims = {name: every[name]}
    low, said = partial(out, claims), summary(list(claims), out, claims)
    if sys.stdout.isatty():
        from rich.console import Console
        from rich.markdown import Markdown

        console = Console(markup=False, emoji=False, highlight=False)
        for line in low:
            paragraph(line)
        console.print(_ledger(*claims.values()) if options.paper else _counts(claims))
        console.print(Markdown(said))
    else:
        table = ledger(deciding(*claims.values())) if options.paper else verdicts(claims)
        print(*low, table, said, sep="\n\n")
    return 0


def _counts(studies: Mapping[str, Claims]) -> Table:
    """A table with the number of statements of each study by verdict."""
    from rich.text import Text

    rows: list[list[Any]] = []
    for name, claims in studies.items():
        count = tally(claim for claim in claims if claim["kind"] == "statement")
        marks = [marked(verdict, str(n)) for verdict, n in count.items()]
        rows.append([name, str(sum(count.values())), Text("\n").join(marks)])
    return _table(["study", "statements", "verdicts"], rows)


def _ledger(claims: Claims) -> Table:
    """A table with a row for each claim of a study."""
    rows = deciding(claims)
    shown = [name for name in columns(rows) if name not in ("Verdict", "Accepted range")]
    said = [[marked(row["verdict"]), *map(cells(row).get, shown)] for row in rows]
    return _table(["Verdict", *shown], said)


def _table(head: Sequence[str], rows: Iterable[Iterable[Any]]) -> Table:
    from rich.box import SIMPLE
    from rich.table import Table

    table = Table(*head, show_lines=True, box=SIMPLE)
    for row in rows:
        table.add_row(*row)
    return table
