"""``celnav list``: what there is."""

from __future__ import annotations

import argparse
import textwrap
from dataclasses import asdict
from types import ModuleType
from typing import Any

from celnav import papers
from celnav.commands.arguments import load
from celnav.papers.own import name_of

WIDTH = 132
"""Of lines."""
UNBROKEN: Any = {
    "subsequent_indent": 70 * " ",
    "break_on_hyphens": False,
    "break_long_words": False,
}
"""How a line is wrapped."""


def run(options: argparse.Namespace) -> int:
    """Print papers, figures, filters and rules, or the parameters of a paper."""
    if options.paper is None:
        _everything()
        return 0
    study = load(options.paper)
    if options.paper not in papers.PAPERS:
        _drawn(name_of(options.paper), study)
    if hasattr(study, "PRESETS"):
        print(end="" if options.paper in papers.PAPERS else "\n")
        _parameters(options.paper)
    return 0


def _everything() -> None:
    for name in (*papers.PAPERS, *papers.REAL):
        study = load(name)
        _drawn(name, study)
        if name in papers.PAPERS:
            print(f"\n  filters: {', '.join(study.filters(next(iter(study.PRESETS.values()))))}")
            print(f"  presets: {', '.join(study.PRESETS)}")
            print(f"  parameters: celnav list {name}\n")
    print("rules: unscented (by default cubature of degree 3), simplex, cubature (degree 3 and 5),")
    print("  gauss_hermite, smolyak, from_filterpy, Taylor (EKF)")


def _drawn(name: str, study: ModuleType) -> None:
    print(f"{name}: {study.TITLE}\n")
    for stem, (caption, _) in {**study.FIGURES, **study.TABLES}.items():
        print(f"  {stem:12} {caption}")
    if name in papers.REAL:
        folder = papers.REAL[name]
        print(f"\n  on real data: celnav reproduce {name} --{name} DIR, folder of {folder}\n")


def _parameters(paper: str) -> None:
    """What stands under ``[config]`` of a mission, with units and what each preset changes."""
    from celnav.campaign.missions import flat
    from celnav.campaign.typed import described, unit_of

    study = papers.load(paper, mission=True)
    presets = {name: flat(asdict(config)) for name, config in study.PRESETS.items()}
    first, *others = presets.items()
    print(
        f"{paper}: {study.TITLE}\n\nAt the top of a "
        f"mission:\n\n{_TOP.format(runs=first[1]['runs'])}"
    )
    for name, unit in study.JUDGED.items():
        print(
            f"  limits.{name:25} {'':24} {unit:9} largest error at the end, of the vector's length"
        )
    print(f"\n[config] of a mission, with the values of preset {first[0]}:\n")
    said = described(type(study.PRESETS[first[0]]))
    for key, value in first[1].items():
        if key != "runs":
            meaning, source, words = said[key]
            choices = (
                f" One of {', '.join(_written(w) for w in words if w is not None)}."
                if words
                else ""
            )
            line = (
                f"  {key:32} {_written(value):24} {unit_of(key):9} {meaning}.{choices} [{source}]"
            )
            print(*textwrap.wrap(line, WIDTH, **UNBROKEN), sep="\n")
    for name, values in others:
        changed = {key: value for key, value in values.items() if value != first[1][key]}
        print(f"\npreset {name}: {_assigned(changed) or 'the same'}")
    if instead := getattr(study, "MISSION", {}):
        print(f"\na mission has instead, whatever its preset: {_assigned(instead)}")
    print(f"\nfilters: {', '.join(study.filters(study.PRESETS[first[0]]))}")


_TOP = """\
  title                            a line of your own
  paper, preset                    where models and values come from
  filters                          a list of names; none: all that are listed below
  runs                             of each configuration ({runs})
  seed                             of the random numbers, which all configurations share (0)
  block                            runs of a work unit (100); a campaign grows by whole ones
  every                            judge one epoch in so many, and the last (1)
  settle_s                         where means over time begin; none: in the middle of the run
  limits                           a table of largest errors at the end; a run beyond one has \
failed"""


def _assigned(values: dict[str, Any]) -> str:
    return ", ".join(f"{key} = {_written(value)}" for key, value in values.items())


def _written(value: Any) -> str:
    """As TOML has it."""
    if isinstance(value, tuple):
        return f"[{', '.join(_written(v) for v in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return "(left out)"
    return f'"{value}"' if isinstance(value, str) else str(value)
