"""A study: parts that are drawn and flown, one labelled store of what they gave, and a ledger that is judged from it.

A paper is data over this: configurations, filters by name, parts, rows of a ledger, figures and tables as calls.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.study.ledger import Claim, Row
from celnav.study.montecarlo import Outcome, Plan, Progress, Unit, blocks, carry_out, generator, run_count
from celnav.study.trial import Group, Trial, follow

Rngs = Sequence[np.random.Generator]


class Part(NamedTuple):
    """Runs of one configuration, or anything else that is computed: the piece that `Results` knows by a name.

    Attributes
    ----------
    work: ``(config, rngs) ->`` arrays by name. Those of two axes or more have the runs second, ``(T, runs, ...)``, and are joined
        over blocks; the others have to be the same in all of them.
    config: first argument of ``work``. number: of its random numbers. runs: at full effort.
    block: runs computed together at most; it changes nothing beyond round-off. cost: CPU seconds of the whole, roughly.
    """

    work: Callable[[Any, Rngs], dict[str, Array]]
    config: Any
    number: int = 0
    runs: int = 1
    block: int = 100
    cost: float = 1.0


def fly(trial: Trial, names: Sequence[str], every: int = 1) -> dict[str, Array]:
    """Filters of a trial by name, judged at each ``every``-th epoch that has a truth.

    Returns
    -------
    times ``(T,)`` s; of each filter ``<name>/error`` and ``<name>/std`` ``(T, runs, n)`` in the units of the groups,
    ``<name>/nees`` and ``<name>/nis`` ``(T, runs)``, the latter nan where nothing was measured. A run that is lost is nan.
    """
    out: dict[str, Array] = {}
    for name in names:
        found = follow(trial, name, every)
        scale = np.ones(found.error.shape[-1])
        for group in trial.groups:
            scale[group.part] = group.scale
        nis = np.where(found.dof > 0, found.nis, np.nan)
        each = {"error": found.error * scale, "std": found.std * scale, "nees": found.nees, "nis": nis}
        out |= {"times": found.times} | {f"{name}/{what}": values for what, values in each.items()}
    return out


@dataclass(frozen=True, eq=False)
class Study:
    """What is computed for a paper, and what is said of it.

    Attributes
    ----------
    name: of the paper. groups: what is judged. rows: the ledger.
    trial: ``(config, rngs) ->`` runs and their filters, see `celnav.study.trial`.
    parts: ``(effort) ->`` parts by name; ``effort``, in (0, 1], may shorten what is long. Runs are scaled by it elsewhere.
    """

    name: str
    groups: tuple[Group, ...]
    trial: Callable[[Any, Rngs], Trial]
    parts: Callable[..., Mapping[str, Part]]
    rows: Sequence[Row]

    def plan(self, *, effort: float = 1.0, seed: int = 0, only: Sequence[str] = (), **inputs: Any) -> Plan[Results]:
        """The units of work, and what makes `Results` of them; ``only``: names of the parts wanted, all if empty."""
        parts = {name: part for name, part in self.parts(effort, **inputs).items() if not only or name in only}
        units = []
        for name, part in parts.items():
            count = part.runs if part.runs == 1 else run_count(part.runs, None, effort)
            units += [Unit(name, _do, (part, seed, runs), part.cost * len(runs) / count) for runs in blocks(count, part.block)]

        def results(outcomes: Mapping[str, Outcome]) -> Results:
            spent = {name: outcome.cpu_s for name, outcome in outcomes.items()}
            return Results(self, seed, effort, parts, {name: outcome.arrays for name, outcome in outcomes.items()}, spent)

        return Plan(units, results)

    def reproduce(self, *, jobs: int = 1, progress: Progress | None = None, **options: Any) -> Results:
        """Carry out `plan` in ``jobs`` processes; the other arguments are those of `plan`.

        >>> results = csrukf.STUDY.reproduce(effort=0.1, only=["0", "I"])
        """
        return carry_out(self.plan(**options), jobs=jobs, progress=progress)


def _do(part: Part, seed: int, runs: range) -> dict[str, Array]:
    return part.work(part.config, [generator(seed, part.number, run) for run in runs])


@dataclass(frozen=True, eq=False)
class Results:
    """What the parts of a study gave; figures, tables and the ledger read nothing else.

    Attributes
    ----------
    parts: as flown. data: ``data[part][name]``, arrays as `Part.work` returns them. spent: CPU seconds of each part.
    """

    study: Study
    seed: int
    effort: float
    parts: Mapping[str, Part]
    data: Mapping[str, Mapping[str, Array]]
    spent: Mapping[str, float] = field(default_factory=dict)

    def get(self, part: str, name: str) -> Array:
        """An array of a part."""
        return self.data[part][name]

    def value(self, part: str, name: str, *at: int) -> float:
        """A number of an array."""
        return float(self.data[part][name][at])

    def times(self, part: str) -> Array:
        """Epochs ``(T,)`` s that were judged."""
        return self.data[part]["times"]

    def error(self, part: str, filter: str, group: str, what: str = "error") -> Array:
        """Errors, or with ``what="std"`` what the filter takes for their deviations, ``(T, runs, k)`` in the unit of a group."""
        return self.data[part][f"{filter}/{what}"][..., self.group(group).part]

    def squares(self, part: str, filter: str, group: str, at: int | slice = -1) -> Array:
        """Squared errors ``(runs, k)`` of a group's components at an epoch, or their means over a slice of epochs."""
        square = np.square(self.error(part, filter, group)[at])
        return square if isinstance(at, int) else np.asarray(square.mean(0))

    def nees(self, part: str, filter: str, at: int | slice = -1, what: str = "nees") -> Array:
        """NEES, or with ``what="nis"`` NIS, of each run ``(runs,)`` at an epoch, or its mean over a slice of them."""
        values = self.data[part][f"{filter}/{what}"][at]
        return values if isinstance(at, int) else np.asarray(values.mean(0))

    def group(self, name: str) -> Group:
        """What is judged under a name."""
        return next(group for group in self.study.groups if group.name == name)

    def first(self, part: str) -> Trial:
        """The first run of a part alone, with its filters, to be flown again in full."""
        config, number = self.parts[part].config, self.parts[part].number
        return self.study.trial(config, [generator(self.seed, number, 0)])

    @property
    def full(self) -> bool:
        """Whether all runs were done."""
        return self.effort == 1.0

    def claims(self, rows: Sequence[Row] = ()) -> list[Claim]:
        """All rows of the ledger, or some, judged; those that need a part which is absent are left out."""
        return [row.judged(self) for row in rows or self.study.rows if not row.needs or row.needs in self.data]
