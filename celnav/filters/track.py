"""The result of a run: the `Track`, and the collector that fills it."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celnav.filters.model import Motion
from celnav.filters.records import Epoch, Info
from celnav.gaussian.belief import any_lost
from celnav.gaussian.checks import choice, integer
from celnav.gaussian.linalg import Array, Belief, Covariance, SquareRoot
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.lazy import requires_extra

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from celnav.show.report import Report

__all__ = ["Track"]


@dataclass(frozen=True, eq=False)
class Track:
    """The result of a run. Arrays are time-major, ``(T, ..., n)``: time, batch axes of the runs,
    component.

    ``print(track.report(truth))`` evaluates it.

    times: ``(T,)`` s, of the epochs stored. mean: ``(T, ..., N)``. std: ``(T, ..., n)``. None: not
        stored.
    belief: means and covariances in the filter's form, if ``run(keep="cov")`` stored them; see
        `cov`.
    innovation, whitened, used: ``(T, ..., m)``, the components of all sensors side by side, each
        sensor with its largest number at any epoch: innovations, nan where not measured; whitened
        innovations, 0 where not used; bool, the components that were used.
    sensors: how many of these components each sensor has, in their order.
    columns: names of the measurements' columns, if they were passed as a pandas DataFrame. start:
        the date of t = 0 in UTC, if times were passed as dates.
    log_likelihood: ``(...)`` of all measurements, also of epochs not stored.
    events: counts ``(...)`` over all epochs: "missing" and "rejected" components, "redone" steps.
        Where ``z`` is None, all components that the sensor has at other epochs are missing.
    failed_at: ``(...)`` index of the first epoch at which a run is not finite, -1 for none.
    extra: the arrays from ``run(also=...)``; and, for a filter with hooks, "R" ``(T, ..., m)``: the
        variances of the measurement noise after the hooks, with all sensors with hooks side by
        side.
    reduced: the final value of ``run(reduce=...)``.
    engine: the engine used, "numpy", "compiled" or "cuda"; with ``run(engine="auto")`` also why it
        was not "compiled".
    filter, epochs: for `celnav.smooth`; the epochs have no measurements, and a track that was
        pickled has no filter.

    >>> track.nis.sum() / track.dof.sum()  # 1 for a consistent filter
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
    start: np.datetime64 | None = None
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
        """The accuracy with respect to the truth, as a `celnav.show.report.Report`; NEES needs
        covariances from ``run(keep="cov")``.

        truth: ``(T, ..., N)`` at the track's epochs, nan where unknown; ``(T, N)`` if all runs have
            the same truth. For vector states it may have only the first components, without biases
            and colored noise that the filter also estimates.
        names: ``(n,)``, names of the components of the error; None: the names of a product's parts,
            or ``x0, x1, ...``. start: s; earlier epochs are left out.
        space: of the states; None: the space of the track's filter. level: probability of intervals
            and bands.

        Errors are estimate minus truth. Values of a failed run that are not finite are left out;
        values before the failure count.

        >>> report = celnav.run(filter, prior, times, z, keep="cov").report(truth)
        >>> print(report)
        >>> report.figure().savefig("report.png")
        """
        from celnav.show.report import report  # imported here: a higher layer

        return report(self, truth, names=names, start=start, space=space, level=level)

    def plot(
        self,
        truth: ArrayLike | None = None,
        run: int = 0,
        *,
        names: Sequence[str] | None = None,
        space: Space | None = None,
    ) -> Figure:
        """A figure of one run: the errors of all components with ±3 predicted standard deviations,
        and the whitened innovations with ±3.

        truth, names, space: as in `report`; without a truth only the standard deviations are drawn.
        run: index of the run; several batch axes are flattened to one. Needs matplotlib.

        >>> celnav.run(filter, prior, times, z).plot(truth).savefig("run.png")
        """
        from celnav.show.history import figure  # imported here: a higher layer

        return figure(self, truth, run, names=names, space=space)

    @property
    def measured(self) -> list[str]:
        """Names of the components of the innovation: the columns of a table, or ``z0, z1, ...``."""
        count = sum(self.sensors)
        return [*self.columns] if len(self.columns) == count else [f"z{i}" for i in range(count)]

    @property
    def dates(self) -> NDArray[np.datetime64] | None:
        """The epochs' dates ``(T,)`` in UTC, if times were passed as dates."""
        if self.start is None:
            return None
        per_second, unit = (1e9, "ns") if np.datetime_data(self.start)[0] == "ns" else (1e6, "us")
        return self.start + np.round(per_second * self.times).astype(f"timedelta64[{unit}]")

    def to_dataframe(self, names: list[str] | None = None) -> pd.DataFrame:
        """A DataFrame with a row for each stored epoch and run (batch axes flattened): time (s),
        date, run, means, standard deviations, NIS. Needs pandas.

        names: of the state's components; default: the names of a product's parts, or
            ``x0, x1, ...``.
        """
        with requires_extra("Track.to_dataframe", "notebooks"):
            import pandas as pd

        return pd.DataFrame(self._columns(names))

    def to_xarray(self, names: list[str] | None = None) -> xr.Dataset:
        """A Dataset with everything stored except ``extra``. Its dimensions are time (s), date, run
        (run0, run1, ... if there are several batch axes), state, error, measurement. Needs xarray.

        names: as in `to_dataframe`. ``error`` has the components of standard deviations and
            covariances: three for an attitude.

        >>> data = track.to_xarray()
        >>> data["std"].sel(error="x0").mean("run")
        """
        with requires_extra("Track.to_xarray", "notebooks"):
            import xarray as xr

        batch = self.failed_at.ndim
        runs = ["run"] if batch == 1 else [f"run{i}" for i in range(batch)]
        axes: dict[str, Any] = {"time": ("time", self.times, {"units": "s"})}
        if self.dates is not None:
            axes["date"] = "time", self.dates
        variables: dict[str, Any] = {name: (runs, x) for name, x in self.events.items()}
        variables |= {
            "log_likelihood": (runs, self.log_likelihood),
            "failed_at": (runs, self.failed_at),
        }
        if self.mean is not None:
            axes["state"] = self._names(names)
            variables["mean"] = ["time", *runs, "state"], self.mean
        if self.std is not None:
            axes["error"] = self._error_names(names)
            variables["std"] = ["time", *runs, "error"], self.std
        if self.belief is not None:
            axes["error_"] = axes["error"]
            variables["cov"] = ["time", *runs, "error", "error_"], self.cov
        if self.whitened is not None:
            axes["measurement"] = self.measured
            for name in INNOVATIONS:
                variables[name] = ["time", *runs, "measurement"], getattr(self, name)
            variables |= {"nis": (["time", *runs], self.nis), "dof": (["time", *runs], self.dof)}
        return xr.Dataset(variables, axes, {"engine": self.engine})

    def to_csv(self, path: str | Path, names: list[str] | None = None) -> None:
        """Write the table of `to_dataframe` with 17 significant digits; does not need pandas."""
        from celnav.files import write_text

        columns = self._columns(names)
        lines = [
            columns,
            *([_written(v) for v in row] for row in zip(*columns.values(), strict=True)),
        ]
        write_text(Path(path), "".join(",".join(line) + "\n" for line in lines))

    def _columns(self, names: Any) -> dict[str, Any]:
        mean = _stored("to_dataframe", self.mean, "means")
        T, N, runs = len(mean), mean.shape[-1], int(np.prod(mean.shape[1:-1]))
        columns: dict[str, Any] = {"t": np.repeat(self.times, runs)}
        if self.dates is not None:
            columns["date"] = np.repeat(self.dates, runs)
        columns["run"] = np.tile(np.arange(runs), T)
        labels = self._names(names)
        if len({*columns, *labels}) < len(columns) + N:
            raise ValueError(
                f"names: expected {N} different ones, none of them {', '.join(columns)}, got "
                f"{labels!r:.80}"
            )
        columns |= dict(zip(labels, mean.reshape(T * runs, N).T, strict=True))
        if self.std is not None:
            std = self.std.reshape(T * runs, -1)
            for label, column in zip(self._error_names(names), std.T, strict=True):
                columns[f"std_{label}"] = column
        return columns if self.whitened is None else columns | {"nis": self.nis.ravel()}

    def _names(self, names: Any) -> list[str]:
        """Names of the components of the mean."""
        N = self.mean.shape[-1]
        if names is None:
            return _fitting(space_of(self.filter).point_labels, N, "x")
        named = (
            not isinstance(names, str)
            and isinstance(names, Iterable)
            and all(isinstance(name, str) for name in names)
        )
        if not named or len(names) != N:
            raise ValueError(f"names: expected {N} words, such as ['x', 'y'], got {names!r:.80}")
        return list(names)

    def _error_names(self, names: Any) -> list[str]:
        """Names of the components of a standard deviation: the names for the mean, if the numbers
        agree.
        """
        n = self.std.shape[-1]
        if self.mean is not None and self.mean.shape[-1] == n:
            return self._names(names)
        return _fitting(space_of(self.filter).labels, n, "d")


def _fitting(labels: list[str], count: int, letter: str) -> list[str]:
    """The labels, if their number fits; else a letter with numbers."""
    return labels if len(labels) == count else [f"{letter}{i}" for i in range(count)]


def _written(value: Any) -> str:
    """A number with all its digits, or a date."""
    return str(value) if isinstance(value, np.datetime64) else f"{value:.17g}"


def space_of(filter: Any) -> Space:
    """The space of a filter's states, or of the states of a filter within it."""
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
"""Values for components that a sensor has only at other epochs."""


def rows_of(keep: Any) -> tuple[str, ...]:
    """Names of the rows for ``celnav.run(keep=...)``, which is a keyword or a list of names."""
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
            while rows:  # free each row once copied, to save memory
                k, row = rows.popitem()
                block[k, ..., : row.shape[-1]] = row
            blocks.append(block)
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks, -1) if blocks else None
