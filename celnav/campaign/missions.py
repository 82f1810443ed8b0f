"""Missions and studies: a TOML file that configures a paper's models and filters.

A file names a paper, may start from one of its presets, and overrides any parameter of its
``Config``::

    paper = "csrukf"
    filters = ["srukf", "csrukf+z0"]
    runs = 500

    [config]
    inclination_deg = 98.2
    phi = 0.95

A list of values for a parameter makes the file a study: every combination of the lists is a
configuration. Instead of a paper the file may name a user's study, ``paper = "study.py"``, which
lies in the same folder (`celnav.papers.own`).
"""

from __future__ import annotations

import difflib
import itertools
import tomllib
import typing
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

from celnav.campaign.typed import depth, named, type_depth, typed
from celnav.files import InputError, did_you_mean
from celnav.filters.run import ENGINES
from celnav.gaussian.checks import choice
from celnav.papers import PAPERS, is_file, load
from celnav.papers.own import identity
from celnav.study.montecarlo import run_count

LARGEST_FILE = 1_000_000
"""Bytes."""
MOST_CONFIGURATIONS = 100_000
MOST_UNITS = 1_000_000
"""Largest total number of blocks of runs."""
MOST_SAMPLES = 200_000_000
"""Largest number of steps of all runs of a block, which are simulated at once. More would take tens
of gigabytes.
"""
BLOCK = 100
"""Runs of a work unit by default. Larger units are hardly faster, and a campaign grows by whole
units.
"""
KEYS = (
    "title",
    "paper",
    "preset",
    "filters",
    "runs",
    "seed",
    "block",
    "every",
    "settle_s",
    "limits",
    "engine",
    "config",
)


class MissionError(InputError):
    """A mission or study file that cannot be used; the message names file and key."""


class Configuration(typing.NamedTuple):
    """One point of a study: the values of its swept keys, and the whole configuration."""

    values: dict[str, Any]
    config: Any


@dataclass(frozen=True)
class MissionStudy:
    """The contents of a mission or study file; a mission is a study of one configuration.

    Attributes
    ----------
    title, paper: as given; the title does not affect results. filters: names. runs: number of runs
        of each configuration.
    seed: of the random numbers, which all configurations share.
    block: runs of a work unit. every: each ``every``-th judged epoch is scored.
    settle_s: start of means over time; None: in the middle. limits: largest error at the end, by
        group.
    engine: that of `celnav.run`.
    swept: dotted key -> values. configurations: every combination, the last key changing fastest.
    """

    title: str
    paper: str
    filters: tuple[str, ...]
    runs: int
    seed: int
    block: int
    every: int
    settle_s: float | None
    limits: dict[str, float]
    engine: str
    swept: dict[str, tuple[Any, ...]]
    configurations: tuple[Configuration, ...]

    @property
    def may_grow(self) -> set[str]:
        """Keys of `to_dict` whose values may be smaller in a store that is reused."""
        return {"runs", *(f"config.{key}" for key in self.swept)}

    def to_dict(self) -> dict[str, Any]:
        """Everything that determines the results, in plain types, to compare stores. It has no
        title.
        """
        first = {
            k: v
            for k, v in flat(asdict(self.configurations[0].config)).items()
            if k not in self.swept and k != "runs"
        }
        about = {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name not in ("title", "swept", "configurations")
        }
        about["paper"] = identity(self.paper)
        return {
            **flat(about),
            **{f"config.{k}": v for k, v in first.items()},
            **{f"config.{k}": v for k, v in self.swept.items()},
        }


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one table with dotted keys."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        out |= (
            flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
        )
    return out


def read(path: str | Path, effort: float = 1.0) -> MissionStudy:
    """The mission or study of a file. ``effort``, in (0, 1], is the part of its runs to do, at
    least 2.

    Raises
    ------
    MissionError: naming file and key, what was expected and what came. OSError: if the file cannot
        be read. ValueError: if ``effort`` is invalid.
    """
    source = Path(path)
    with source.open("rb") as file:
        content = file.read(LARGEST_FILE + 1)
    try:
        if len(content) > LARGEST_FILE:
            raise ValueError(f"expected at most {LARGEST_FILE} bytes, got more")
        table = tomllib.loads(content.decode("utf-8-sig"))
    except RecursionError:
        raise MissionError(f"{source}: {_DEEP}") from None
    except (ValueError, UnicodeDecodeError) as error:
        raise MissionError(f"{source}: not a TOML file ({error})") from None
    if isinstance(paper := table.get("paper"), str) and is_file(paper):
        table["paper"] = str((source.parent / paper).resolve())
    try:
        whole = study(table)
    except RecursionError:
        raise MissionError(f"{source}: {_DEEP}") from None
    except ValueError as error:
        raise MissionError(f"{source}: {error}") from None
    return whole if effort == 1.0 else replace(whole, runs=run_count(whole.runs, None, effort))


_DEEP = "lists or tables are nested too deeply"


def study(table: Mapping[str, Any]) -> MissionStudy:
    """A study from the tables of a file.

    Raises
    ------
    ValueError: naming the key, with its unit, what was expected and what came.
    """
    if "paper" not in table:
        _check_keys("", table, KEYS)
        raise ValueError(
            f"paper: expected one of {', '.join(PAPERS)}, or a study of your own, FILE.py, got none"
        )
    paper = typed("paper", table["paper"], str)
    module = (
        load(paper, mission=True)
        if is_file(paper)
        else _with_name("paper", lambda: load(paper, mission=True))
    )
    start = _preset(module, table)
    for key in (set(table) - set(KEYS)) & {f.name for f in fields(start)}:
        raise ValueError(f"{key}: expected it under [config]")
    _check_keys("", table, KEYS)
    chosen = {k: typed(k, table[k], hint) for k, hint in _OPTIONS.items() if k in table}
    if "runs" in typed("config", table.get("config", {}), dict):
        raise ValueError("config.runs: expected runs at the top of the file, outside of [config]")
    swept, fixed = _overrides(start, table.get("config", {}))
    points = _grid(start, fixed, swept)
    idle = [getattr(point.config, "idle", {}) for point in points]
    for key in (*swept, *fixed):
        if all(key in names for names in idle):
            raise ValueError(f"{named(f'config.{key}')}: has no effect {idle[0][key]}")
    usual = {
        "title": module.TITLE,
        "runs": start.runs,
        "seed": 0,
        "block": BLOCK,
        "every": 1,
        "settle_s": None,
        "engine": "auto",
    }
    options: dict[str, Any] = usual | chosen | {"limits": _limits(table, module.JUDGED)}
    for name, least in (("runs", 1), ("seed", 0), ("block", 1), ("every", 1)):
        if options[name] < least:
            raise ValueError(
                f"{name}: expected a whole number of at least {least}, got {options[name]}"
            )
    choice("engine", options["engine"], ENGINES)
    units = len(points) * -(-options["runs"] // options["block"])
    if units > MOST_UNITS:
        raise ValueError(
            f"runs: expected at most {MOST_UNITS} blocks of runs in all, got {units}; fewer runs, "
            "or a larger block"
        )
    _check_flights(points, options)
    names = _filters(module, table, points)
    return MissionStudy(paper=paper, filters=names, swept=swept, configurations=points, **options)


_OPTIONS: dict[str, Any] = {
    "title": str,
    "runs": int,
    "seed": int,
    "block": int,
    "every": int,
    "settle_s": float,
    "engine": str,
}


def _check_flights(points: Sequence[Configuration], options: Mapping[str, Any]) -> None:
    """Raise ValueError if runs end before ``settle_s``, or if a block does not fit into memory."""
    settle, runs = options["settle_s"], min(options["runs"], options["block"])
    if settle is not None and settle < 0.0:
        raise ValueError(f"settle_s (s): expected a number that is not negative, got {settle!r}")
    for values, config in points:
        where = f" where {at}" if (at := ", ".join(f"{k} = {v}" for k, v in values.items())) else ""
        if settle is not None and settle > config.end_s:
            raise ValueError(
                f"settle_s (s): expected at most {config.end_s:g}, the end of the run{where}, "
                f"got {settle:g}"
            )
        if config.samples * runs > MOST_SAMPLES:
            sizes = f"{runs} runs of {config.samples} steps{where}"
            raise ValueError(
                f"block: expected at most {MOST_SAMPLES} steps at once, got {sizes}; a smaller "
                "block needs less"
            )


def _with_name(name: str, make: Any) -> Any:
    """The result of ``make()``; its errors get the name in front."""
    try:
        return make()
    except ValueError as error:
        raise ValueError(f"{name}: {' '.join(str(error).split())}") from None
    except ArithmeticError as error:
        raise ValueError(f"{name}: expected numbers that can be computed with ({error})") from None


def _check_keys(where: str, table: Mapping[str, Any], names: Sequence[str]) -> None:
    """Raise ValueError for keys that are not among the names, with a hint at the nearest name."""
    for key in table:
        if key not in names and where and key in KEYS:
            raise ValueError(
                f"{where}{key}: expected {key} at the top of the file, outside of "
                f"[{where.partition('.')[0]}]"
            )
        if key not in names:
            close = difflib.get_close_matches(key, names, 1)
            hint = (
                f"did you mean {where}{close[0]}?"
                if close
                else f"expected one of {', '.join(names)}"
            )
            raise ValueError(f"{where}{key}: unknown key; {hint}")


def _preset(module: ModuleType, table: Mapping[str, Any]) -> Any:
    name = typed("preset", table.get("preset", next(iter(module.PRESETS))), str)
    if name not in module.PRESETS:
        raise ValueError(f"preset: expected one of {', '.join(module.PRESETS)}, got {name!r}")
    return replace(module.PRESETS[name], **getattr(module, "MISSION", {}))


def _limits(table: Mapping[str, Any], judged: Mapping[str, str]) -> dict[str, float]:
    _check_keys("limits.", typed("limits", table.get("limits", {}), dict), list(judged))
    limits = {k: typed(f"limits.{k}", v, float) for k, v in table.get("limits", {}).items()}
    for name, value in limits.items():
        if value <= 0.0:
            raise ValueError(f"limits.{name}: expected a positive number, got {value!r}")
    return limits


def _filters(
    module: ModuleType, table: Mapping[str, Any], points: Sequence[Configuration]
) -> tuple[str, ...]:
    """The requested names, each of which exists in some configuration; by default those of the
    first.
    """
    available: dict[str, Any] = _with_name("config", lambda: module.filters(points[0].config))
    names = [
        typed("filters", name, str)
        for name in typed("filters", table.get("filters", list(available)), list)
    ]
    if not names:
        raise ValueError(f"filters: expected some of {', '.join(available)}, got none")
    if len(set(names)) != len(names):
        raise ValueError(f"filters: expected different names, got {names!r}")
    for name in names:
        if not any(
            name in (available if i == 0 else module.filters(point.config))
            for i, point in enumerate(points)
        ):
            raise ValueError(
                f"filters: expected some of {', '.join(available)}, got "
                f"{name!r}{did_you_mean(name, available)}"
            )
    return tuple(names)


def _overrides(
    config: Any, table: Mapping[str, Any], prefix: str = ""
) -> tuple[dict[str, tuple[Any, ...]], dict[str, Any]]:
    """Lists of values, and single values, by dotted key."""
    hints = typing.get_type_hints(type(config))
    _check_keys(f"config.{prefix}", table, [f.name for f in fields(config)])
    swept: dict[str, tuple[Any, ...]] = {}
    fixed: dict[str, Any] = {}
    for key, value in table.items():
        name = prefix + key
        if is_dataclass(hints[key]):
            inner = typed(f"config.{name}", value, dict)
            lists, values = _overrides(getattr(config, key), inner, f"{name}.")
            swept |= lists
            fixed |= values
        elif depth(value) > type_depth(hints[key]):
            if not value:
                raise ValueError(f"config.{name}: expected at least one value, got an empty list")
            values_of = tuple(typed(f"config.{name}", item, hints[key]) for item in value)
            if len(set(values_of)) != len(values_of):
                raise ValueError(f"config.{name}: expected different values, got {value!r}")
            swept[name] = values_of
        else:
            fixed[name] = typed(f"config.{name}", value, hints[key])
    return swept, fixed


def _grid(
    start: Any, fixed: Mapping[str, Any], swept: Mapping[str, tuple[Any, ...]]
) -> tuple[Configuration, ...]:
    count = 1
    for values in swept.values():
        count *= len(values)
    if count > MOST_CONFIGURATIONS:
        raise ValueError(
            f"config: expected at most {MOST_CONFIGURATIONS} configurations, got {count}"
        )
    combinations = itertools.product(*swept.values())
    return tuple(
        _point(start, fixed, dict(zip(swept, values, strict=True))) for values in combinations
    )


def _point(start: Any, fixed: Mapping[str, Any], values: dict[str, Any]) -> Configuration:
    try:
        return Configuration(values, _replaced(start, {**fixed, **values}))
    except ArithmeticError as error:
        raise ValueError(f"config: expected numbers that can be computed with ({error})") from None
    except ValueError as error:
        name, colon, rest = " ".join(str(error).split()).partition(": ")
        at = ", ".join(f"{k} = {v}" for k, v in values.items() if k != name)
        where = f" (where {at})" if at else ""
        raise ValueError(
            f"{named(f'config.{name}') if colon else 'config: ' + name}{colon}{rest}{where}"
        ) from None


def _replaced(config: Any, values: Mapping[str, Any]) -> Any:
    """A configuration with new values for dotted keys."""
    inner: dict[str, dict[str, Any]] = {}
    changes: dict[str, Any] = {}
    for key, value in values.items():
        head, dot, rest = key.partition(".")
        if dot:
            inner.setdefault(head, {})[rest] = value
        else:
            changes[head] = value
    for head, parts in inner.items():
        try:
            changes[head] = _replaced(getattr(config, head), parts)
        except ValueError as error:
            raise ValueError(f"{head}.{error}") from None
    return replace(config, **changes)
