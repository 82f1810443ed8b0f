"""Results of notebook 07, their figures, and their ledgers."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from IPython.display import Markdown, display

from celnav import real
from celnav.show.claims import Ledger, answer, written
from celnav.show.notebook import Folded, Table

DATA = Path(os.environ.get("CELNAV_DATA", "real"))
"""A folder with the data of each study in a subfolder."""
OUT = os.environ.get("CELNAV_OUT", "../out")
"""Where `celnav reproduce STUDY --STUDY DIR` stores results, which are reused."""


def at_hand(study: str):
    """Results of a study, or None without its data."""
    if not (DATA / study).is_dir():
        print(
            f"{study}: no data in this folder. Set CELNAV_DATA, or run:",
            f"celnav reproduce {study} --{study} DIR ({real.STUDIES[study]})",
        )
        return None
    return real.load(study).STUDY.reproduce(out=OUT, **{study: DATA / study})


def figure(results, number: int):
    """A figure of a study."""
    return results and real.load(results.study.name).FIGURES[f"figure_{number:02d}"][1](results)


def ledger(results, *deciding: str) -> None:
    """What we find, the rows that decide it, and the other rows behind a click. A reason why
    accepted ranges were revised is said once, with the number of rows that it holds for.
    """
    if not results:
        return
    claims = results.claims()
    findings = [claim for claim in claims if claim.kind == "finding"]
    order = sorted(findings, key=lambda claim: claim.id not in deciding)
    count = Counter(claim.row.revised for claim in findings)
    for i, claim in enumerate(order):
        reason = claim.row.revised
        if reason and count[reason] != 1:
            said = f"{reason} (this and {count[reason] - 1} other rows)" if count[reason] else None
            order[i] = replace(claim, row=replace(claim.row, revised=said))
            count[reason] = 0
    shown, rest = order[: len(deciding)], order[len(deciding) :]
    display(Markdown(f"**We find.** {answer(results.study.found, map(written, claims))}"))
    display(Ledger(shown, "finding"))
    display(Folded(f"The other {len(rest)} findings", Ledger(rest, "finding")))


def folded(title: str, rows: Sequence[dict], columns: Sequence[str] = ()) -> Folded:
    """A table behind a click, with numbers of three digits."""
    names = list(columns or rows[0])
    words = [[x if isinstance(x, str) else f"{x:.3g}" for x in map(row.get, names)] for row in rows]
    return Folded(title, Table(names, words))
