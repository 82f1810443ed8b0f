"""The result of a run: the `Track`, and the collector that fills it."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.model import Motion
from celnav.filters.records import Epoch, Info
from celnav.gaussian.belief import any_lost
from celnav.gaussian.checks import choice, integer
from celnav.gaussian.linalg import Array, Belief, Covariance, SquareRoot
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.lazy import requires_extra

if TYPE_CHECKING:
    import pandas as pd

    from celnav.show.report import Report

__all__ = ["Track"]


@dataclass(frozen=True, eq=False)
class Track:
    """The record of a run, time-major: ``(T, ..., n)``, the batch axes of the runs between time and
    component.

    ``print(track.report(truth))`` evaluates it.

    times: ``(T,)`` s, of the epochs stored. mean: ``(T, ..., N)``. std: ``(T, ..., n)``. None: not
        kept.
    belief: means and covariances in the filter's form, if ``run(keep="cov")`` stored them; see
        `cov`.
    innovation, whitened, used: ``(T, ..., m)`` of all sensors side by side, m the most that they
        had at an epoch: innovations, nan where not measured; whitened innovations, 0 where not
        used; bool, the components that were used.
    sensors: how many of these components each sensor has, in their order.
    columns: names of the measurements' columns, if they came as a table of pandas.
    log_likelihood: ``(...)`` of all measurements, also of epochs not stored.
    events: counts ``(...)`` over all epochs: "missing" and "rejected" components, "redone" steps.
        If ``z`` was None, as many are missing as that sensor has at other epochs.
    failed_at: ``(...)`` index of the first epoch at which a run is not finite, -1 for none.
    extra: the arrays from ``run(also=...)``; and "R" of a filter with hooks: ``(T, ..., m)``, the
        variances of the measurement noise after the hooks, such as those that `variational_bayes`
        estimates, of all sensors with hooks side by side.
    reduced: the final value of ``run(reduce=...)``.
    engine: the engine that ran it, "numpy", "compiled" or "cuda"; with ``run(engine="auto")`` also
        why it was not compiled.
    filter, epochs: for `celnav.smooth`; the epochs have no measurements, and a track that was
        pickled has no filter.

    >>> track.nis.sum() / track.dof.sum()  # 1 of a consistent filter
    >>> track.to_csv("track.csv")
    """

    times: Array
    mean: Array
    std: Array
    belief: Belief | None
    innovation: Array
    whitened: Array
    used: Array
    log_likelihood: Array
    events: dict[str, Array]
    failed_at: Array
    sensors: tuple[int, ...] = ()
    columns: tuple[str, ...] = ()
    extra: dict[str, Array] = field(default_factory=dict)
    reduced: Any = None
    filter: Any = None
    epochs: Sequence[Epoch] = ()
    engine: str = "numpy"

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"filter": None}

    def __repr__(self) -> str:
        batch, count = self.failed_at.shape, np.count_nonzero(self.failed_at >= 0)
        runs = (
            "one run" if not batch else f"{batch[0]} runs" if len(batch) == 1 else f"runs {batch}"
        )
        lost = f", {count} lost" if count else ""
        stored = ", ".join(
            name
            for name in ("mean", "std", "belief", "innovation")
            if getattr(self, name) is not None
        )
        span = f"{len(self.times)} epochs from {self.times[0]:g} to {self.times[-1]:g} s"
        return f"Track({span}, {runs}{lost}; {stored or 'no rows'} stored)"

    @property
    def nis(self) -> Array:
        """Normalized innovation squared ``(T, ...)``, chi-square of `dof`:
        ``nis.sum() / dof.sum()`` should be 1.
        """
        white = _stored("nis", self.whitened, "innovations")
        return np.asarray(np.einsum("...i,...i->...", white, white))

    @property
    def dof(self) -> Array:
        """Number of measured components used, ``(T, ...)``."""
        return np.asarray(_stored("dof", self.used, "innovations").sum(-1))

    @property
    def cov(self) -> Array:
        """Covariances ``(T, ..., n, n)``; needs ``run(keep="cov")``."""
        return np.asarray(_stored("cov", self.belief, "covariances; run with keep='cov'").cov)

    @property
    def sqrt_cov(self) -> Array:
        """Lower roots ``(T, ..., n, n)`` of the covariances."""
        return np.asarray(
            _stored("sqrt_cov", self.belief, "covariances; run with keep='cov'").sqrt_cov
        )

    def part(self, name: str) -> Covariance:
        """The belief of a named part of the state (`celnav.product`): ``mean (T, ..., k)``,
        ``cov (T, ..., k, k)`` and ``std``; needs ``run(keep="cov")``.

        >>> car_track.part("p").std[-1]
        """
        points, tangents = space_of(self.filter).places(name)
        return Covariance(self.mean[..., points], self.cov[..., tangents, tangents])

    def report(
        self,
        truth: ArrayLike,
        *,
        names: Sequence[str] | None = None,
        start: float | None = None,
        space: Space | None = None,
        level: float = 0.95,
    ) -> Report:
        """The accuracy with respect to the truth, a `celnav.show.report.Report`; NEES needs
        covariances from ``run(keep="cov")``.

        truth: ``(T, ..., N)`` at the track's epochs, nan where it is not known; ``(T, N)`` may
            serve all runs. For vector states it may have only the first components, without biases
            and colored noise that a filter estimates besides.
        names: ``(n,)`` of the components of the error; None: those of a product's parts, if there
            are, or ``x0, x1, ...``. start: s; earlier epochs are left out.
        space: of the states; None: the space of the track's filter. level: of intervals and bands.

        Errors are estimate minus truth. Values of a failed run that are not finite are left out;
        values before the failure count.

        >>> report = celnav.run(filter, prior, times, z, keep="cov").report(truth)
        >>> print(report)
        >>> report.figure().savefig("report.png")
        """
        from celnav.show.report import report  # of a higher room, but users look for it here

        return report(self, truth, names=names, start=start, space=space, level=level)

    @property
    def measured(self) -> list[str]:
        """Names of the components of the innovation: columns of a table, or ``z0, z1, ...``."""
        count = sum(self.sensors)
        return [*self.columns] if len(self.columns) == count else [f"z{i}" for i in range(count)]

    def to_dataframe(self, names: list[str] | None = None) -> pd.DataFrame:
        """A row for each stored epoch and run (batch axes count as one): time, run, means, standard
        deviations, NIS. Needs pandas.

        ``names``: of the state's components; default ``x0, x1, ...``.
        """
        with requires_extra("Track.to_dataframe", "notebooks"):
            import pandas as pd

        return pd.DataFrame(self._columns(names))

    def to_csv(self, path: str | Path, names: list[str] | None = None) -> None:
        """Write what `to_dataframe` would hold, with 17 significant digits, without needing
        pandas."""
        from celnav.files import write_text

        columns = self._columns(names)
        lines = [
            columns,
            *([f"{v:.17g}" for v in row] for row in zip(*columns.values(), strict=True)),
        ]
        write_text(Path(path), "".join(",".join(line) + "\n" for line in lines))

    def _columns(self, names: Any) -> dict[str, Array]:
        mean = _stored("to_dataframe", self.mean, "means")
        T, N, runs = len(mean), mean.shape[-1], int(np.prod(mean.shape[1:-1]))
        names = [f"x{i}" for i in range(N)] if names is None else names
        named = (
            not isinstance(names, str)
            and isinstance(names, Iterable)
            and all(isinstance(name, str) for name in names)
        )
        if not named or len(names) != N:
            raise ValueError(f"names: expected {N} words, such as ['x', 'y'], got {names!r:.80}")
        columns = {"t": np.repeat(self.times, runs), "run": np.tile(np.arange(runs), T)}
        columns |= dict(zip(names, mean.reshape(T * runs, N).T, strict=True))
        if self.std is not None:
            std = self.std.reshape(T * runs, -1)
            labels = names if std.shape[-1] == N else [f"d{i}" for i in range(std.shape[-1])]
            columns |= {f"std_{label}": column for label, column in zip(labels, std.T, strict=True)}
        return columns if self.whitened is None else columns | {"nis": self.nis.ravel()}


def space_of(filter: Any) -> Space:
    """The space of a filter's states, or of those of the filters within it."""
    if isinstance(motion := getattr(filter, "motion", None), Motion):
        return motion.space
    for name in ("first", "filter", "filters"):
        if within := getattr(filter, name, None):
            return space_of(within[0] if isinstance(within, tuple) else within)
    return EUCLIDEAN


def _stored(name: str, value: Any, quantity: str) -> Any:
    if value is None:
        raise ValueError(f"{name}: this track stored no {quantity}")
    return value


INNOVATIONS = ("innovation", "whitened", "used")
KEEP = {
    "std": ("mean", "std", *INNOVATIONS),
    "cov": ("mean", "std", "cov", *INNOVATIONS),
    "mean": ("mean", *INNOVATIONS),
    "nothing": (),
}
"""Rows of a track, by keyword."""
NAMED = {
    "mean": ("mean",),
    "std": ("std",),
    "cov": ("mean", "std", "cov"),
    **dict.fromkeys(INNOVATIONS, INNOVATIONS),
}
"""Rows that can be requested, and the rows that come with them."""
_BLANK = {"innovation": np.nan, "whitened": 0.0, "used": False, "R": np.nan}
"""Values of components that a sensor has only at other epochs."""


def rows_of(keep: Any) -> tuple[str, ...]:
    """Names of the rows for ``celnav.run(keep=...)``, which is one keyword or names of rows."""
    if isinstance(keep, str) or not isinstance(keep, Iterable):
        return KEEP[choice("keep", keep, tuple(KEEP))]
    asked = list(keep)
    if not all(isinstance(name, str) and name in NAMED for name in asked):
        names = ", ".join(NAMED)
        raise ValueError(f"keep: expected a word, or some of ({names}), got {keep!r:.80}")
    wanted = {row for name in asked for row in NAMED[name]}
    return tuple(row for row in KEEP["cov"] if row in wanted)


class Collector:
    """Collects some ``rows`` of a `Track` at each ``every``-th epoch; sums cover every epoch."""

    def __init__(self, every: int, rows: Collection[str]):
        self._every, self._row_names, self._count = every, rows, 0
        self._form: Any = SquareRoot
        self._rows: defaultdict[tuple[str, int], dict[int, Array]] = defaultdict(
            dict
        )  # by name and sensor: rows by epoch
        self._extra: defaultdict[str, list[Any]] = defaultdict(list)
        self._times: list[Any] = []
        self._epochs: list[Epoch] = []
        self._failed_at: Array = np.array(-1)
        self._silent: Counter[int] = Counter()
        self._widths: Counter[int] = Counter()
        self._sums: dict[str, Any] = {
            "log_likelihood": 0.0,
            "missing": 0,
            "rejected": 0,
            "redone": 0,
        }

    def add(
        self, epoch: Epoch, belief: Belief, infos: tuple[Info, ...], extra: dict[str, Any]
    ) -> tuple[int, ...] | None:
        """Add one step. Returns the index of the first run that fails in it, or None."""
        self._form = type(belief)
        for i, info in enumerate(infos):
            self._sum(i, info)
        if self._count % self._every == 0:
            self._store(epoch, belief, infos, extra)
        self._count += 1
        batch = belief.mean.shape[:-1]
        # At the first epoch, or if a later measurement adds axes of runs.
        if self._failed_at.shape != batch:
            self._failed_at = np.broadcast_to(self._failed_at, batch).copy()
        if not any_lost(belief):
            return None
        new = belief.lost() & (self._failed_at < 0)
        self._failed_at[new] = integer("k", epoch.k, 0, 2**62)
        return tuple(int(i) for i in np.argwhere(new)[0]) if new.any() else None

    def _sum(self, i: int, info: Info) -> None:
        sums, likelihood = self._sums, info.log_likelihood
        if info.silent:
            self._silent[i] += 1
        elif info.innovation is not None:
            self._widths[i] = max(self._widths[i], info.innovation.shape[-1])
        if likelihood is not None:
            assert info.used is not None
            sums["log_likelihood"] = sums["log_likelihood"] + likelihood
            if not info.used.all():
                absent = np.isnan(np.asarray(info.innovation))
                sums["missing"] = sums["missing"] + absent.sum(-1)
                sums["rejected"] = sums["rejected"] + (~info.used & ~absent).sum(-1)
        if info.redone is not None:
            sums["redone"] = sums["redone"] + info.redone

    def _store(
        self, epoch: Epoch, belief: Belief, infos: tuple[Info, ...], extra: dict[str, Any]
    ) -> None:
        row = len(self._times)
        self._times.append(epoch.t)
        for name, value in extra.items():
            self._extra[name].append(value)
        if "mean" in self._row_names:
            self._rows["mean", 0][row] = belief.mean
        if "std" in self._row_names:
            self._rows["std", 0][row] = belief.std
        if "cov" in self._row_names:
            self._rows["cov", 0][row] = belief[1]
            self._epochs.append(epoch._replace(z=None, truth=None))
        for name in _BLANK:
            if name not in self._row_names and not (
                name == "R" and "innovation" in self._row_names
            ):
                continue
            for i, info in enumerate(infos):
                if (value := getattr(info, name)) is not None:
                    self._rows[name, i][row] = value

    def track(self, reduced: Any, filter: Any) -> Track:
        """The collected rows, stacked over time."""
        if not self._count:
            raise ValueError("epochs: expected at least one, got none")
        try:
            times = np.array(self._times)
        except ValueError:
            raise ValueError(
                f"t: expected a number at each epoch, got {self._times[-1]!r:.80}"
            ) from None
        self._sums["missing"] = self._sums["missing"] + sum(
            count * self._widths[i] for i, count in self._silent.items()
        )
        sums = {
            name: np.broadcast_to(value, self._failed_at.shape)
            for name, value in self._sums.items()
        }
        measured = sorted(key for key in self._rows if key[0] in INNOVATIONS)
        by_sensor = {i: self._rows[name, i].values() for name, i in measured}
        widths = tuple(max(row.shape[-1] for row in rows) for rows in by_sensor.values())
        rows: dict[str, Any] = {name: self._stacked(name) for name in ("mean", "std", *_BLANK)}
        cov, R = self._stacked("cov", axes=2), rows.pop("R")
        extra = {} if R is None else {"R": R}
        return Track(
            times=times,
            **rows,
            belief=None if cov is None else self._form(rows["mean"], cov),
            log_likelihood=sums.pop("log_likelihood"),
            events=sums,
            failed_at=self._failed_at,
            sensors=widths,
            extra=extra | {name: np.stack(values) for name, values in self._extra.items()},
            reduced=reduced,
            filter=filter,
            epochs=tuple(self._epochs),
        )

    def _stacked(self, name: str, axes: int = 1) -> Array | None:
        """Rows over time, all sensors side by side, broadcast to the batch of the last epoch."""
        blocks = []
        for key in sorted(key for key in self._rows if key[0] == name):
            rows = self._rows.pop(key)
            first, width = next(iter(rows.values())), max(row.shape[-1] for row in rows.values())
            shape = len(self._times), *self._failed_at.shape, *first.shape[-axes:-1], width
            block = np.full(shape, _BLANK.get(name, np.nan), first.dtype)
            while rows:  # one copy at a time, not two of everything
                k, row = rows.popitem()
                block[k, ..., : row.shape[-1]] = row
            blocks.append(block)
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks, -1) if blocks else None
