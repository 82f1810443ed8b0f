"""``celnav list``: the studies, and the contents of a study."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Mapping
from dataclasses import asdict
from types import ModuleType
from typing import Any

from celnav import papers
from celnav.commands.arguments import load
from celnav.commands.terminal import columns, entry, paragraph
from celnav.papers.own import name_of
from celnav.study.ledger import KINDS

PLURALS = {"statement": "statements", "erratum": "errata"}
MORE = "celnav list NAME lists figures, tables, statements, filters and parameters."


def run(options: argparse.Namespace) -> int:
    """Print a line for each study, or the contents of one study."""
    if options.paper is None:
        for name in (*papers.PAPERS, *papers.REAL):
            title = load(name).TITLE + " (real data)" * (name in papers.REAL)
            print(f"{name:9}", textwrap.shorten(title, max(columns() - 10, 10), placeholder=" ..."))
        print(MORE)
        return 0
    study = load(options.paper)
    name = name_of(options.paper)
    paragraph(f"{name}: {study.TITLE}")
    if name in papers.REAL:
        paragraph(f"Run it with celnav reproduce {name} --{name} DIR: {papers.REAL[name]}.")
    _show("figures", {stem: study.FIGURES[stem][0] for stem in sorted(study.FIGURES)})
    _show("tables", {stem: study.TABLES[stem][0] for stem in sorted(study.TABLES)})
    for kind in KINDS:
        rows = {row.id: row.says for row in study.STUDY.rows if row.kind == kind}
        _show(PLURALS.get(kind, f"{kind}s"), rows)
    if hasattr(study, "PRESETS"):
        _parameters(papers.load(options.paper, mission=True))
    return 0


def _show(heading: str, entries: Mapping[str, str]) -> None:
    """Print a heading and its entries; nothing if there are no entries."""
    if entries:
        print(f"\n{heading}")
        for name, text in entries.items():
            entry(name, text)


def _parameters(study: ModuleType) -> None:
    """Print the parameters of a mission with units, and the changes of each preset."""
    from celnav.campaign.missions import flat
    from celnav.campaign.typed import described, unit_of

    presets = {name: flat(asdict(config)) for name, config in study.PRESETS.items()}
    first, *others = presets
    filters = study.filters(study.PRESETS[first])
    _show("filters and presets", {"filters": ", ".join(filters), "presets": ", ".join(presets)})
    limits = {
        f"limits.{name} ({unit})": "largest length of the error at the end"
        for name, unit in study.JUDGED.items()
    }
    _show(
        "at the top of a mission",
        TOP
        | {"runs": f"Monte-Carlo runs of each configuration ({presets[first]['runs']})"}
        | limits,
    )
    print(f"\n[config] of a mission, with the values of preset {first}")
    said = described(type(study.PRESETS[first]))
    for key, value in presets[first].items():
        if key != "runs":
            meaning, source, words = said[key]
            listed = ", ".join(_written(word) for word in words or () if word is not None)
            choices = f" One of {listed}." if listed else ""
            head = f"{key} = {_written(value)} {unit_of(key)}".rstrip()
            entry(head, f"{meaning}.{choices} [{source}]")
    for name in others:
        changed = {k: v for k, v in presets[name].items() if v != presets[first][k]}
        print()
        paragraph(f"preset {name}: {_assigned(changed) or 'the same'}")
    if instead := getattr(study, "MISSION", {}):
        print()
        paragraph(f"a mission has instead, whatever its preset: {_assigned(instead)}")


TOP = {
    "title": "a line of your own",
    "paper, preset": "where models and values come from",
    "filters": "a list of names; all that are listed above if it is left out",
    "runs": "",
    "seed": "of the random numbers, which all configurations share (0)",
    "block": "runs of a work unit (100); a campaign grows by whole units",
    "every": "interval of judged epochs, in epochs; the last one is judged too (1)",
    "settle_s": "start of averages over time; the middle of the run if it is left out",
    "limits": "a table of largest errors at the end; a run beyond one of them has failed",
}


def _assigned(values: dict[str, Any]) -> str:
    return ", ".join(f"{key} = {_written(value)}" for key, value in values.items())


def _written(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, tuple):
        return f"[{', '.join(_written(v) for v in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return "(left out)"
    return f'"{value}"' if isinstance(value, str) else str(value)
