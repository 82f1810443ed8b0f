"""The data that the parts of a step exchange: `Epoch` (and `epochs`, made of arrays), `Info`,
`State`; and the interface of a filter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from datetime import UTC, date, datetime, timedelta
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import describe, finite, numbers
from celnav.gaussian.linalg import Array

__all__ = ["Epoch", "Filter", "FilterError", "FromFunctions", "Info", "epochs"]

_LOG_2PI = float(np.log(2.0 * np.pi))


class FilterError(ArithmeticError):
    """A covariance lost positive definiteness, or a value is not finite. The message names the run,
    the time and the reason.
    """


class Epoch(NamedTuple):
    """The interval ``(t - dt, t]`` and the sample at its end.

    k: index. t: time, s. dt: length of the interval, s.
    u: the input that acts over the interval.
    z: a measurement ``(..., m)`` or a tuple of measurements, one for each sensor; nan or None where
        missing.
    truth: any data that a simulation passes on.
    about: beliefs at both ends of the interval, over which `celnav.iterated_smoother` linearizes;
        nothing else uses them.

    >>> state, infos = filter.step(filter.start(prior), celnav.Epoch(t=0.0, z=z[0]))
    """

    k: int = 0
    t: Any = 0.0
    dt: Any = 0.0
    u: Any = None
    z: Any = None
    truth: Any = None
    about: Any = None


class Info(NamedTuple):
    """The result of an update with one measurement.

    innovation: ``(..., m)`` measurement minus its prediction, before hooks; nan where nothing was
        measured.
    whitened: ``(..., m)`` ``S^-1 innovation``, where S is the lower root of the innovation
        covariance; 0 where not used.
    used: ``(..., m)`` bool, the components that were used.
    sqrt_S: ``(..., m, m)`` S, with unit rows for components not used.
    gain, jacobian: functions ``() -> (..., n, m)`` and ``() -> (..., m, n)``: the gain and the
        (statistical) Jacobian of the measurement.
    redone: ``(...)`` bool, the runs that the second filter of a `celnav.filters.switching.Fallback`
        has repeated; None without a `Fallback`.
    silent: whether there was no measurement at all, not even nan.
    R: ``(..., m)`` variances of the measurement noise after the hooks; None without hooks.
    mixture: ``(...)``, the log-likelihood where it does not follow from ``sqrt_S``: after a
        compiled step, and for a density that is not Gaussian (``whitened`` and ``sqrt_S`` then come
        from its moments); else None.

    >>> (info,) = infos
    >>> info.innovation, info.gain()  # the surprise, (..., m), and its weight in the update
    """

    innovation: Array | None = None
    whitened: Array | None = None
    used: Array | None = None
    sqrt_S: Array | None = None
    gain: Any = None
    jacobian: Any = None
    redone: Array | None = None
    silent: bool = False
    mixture: Array | None = None
    R: Array | None = None

    @property
    def nis(self) -> Array | None:
        """Normalized innovation squared, ``(...)``: chi-square with ``used.sum(-1)`` degrees of
        freedom.
        """
        return None if self.whitened is None else np.vecdot(self.whitened, self.whitened)

    @property
    def log_likelihood(self) -> Array | None:
        """Logarithm of the probability density of the components used, ``(...)``."""
        if self.whitened is None or self.used is None or self.mixture is not None:
            return self.mixture
        value: Array = -0.5 * (self.nis + np.add.reduce(self.used, -1, int) * _LOG_2PI)
        if self.sqrt_S is not None:
            with np.errstate(divide="ignore"):  # a run that has failed has nan in `whitened`
                value = value - np.add.reduce(np.log(self.sqrt_S.diagonal(0, -2, -1)), -1)
        return value


class State(NamedTuple):
    """State of a filter between epochs: the belief, and the memories of the hooks of each
    sensor."""

    belief: Any
    memory: tuple[Any, ...] = ()


class FromFunctions(NamedTuple):
    """A filter made from two functions; see `Filter` for what they must return.

    >>> filter = celnav.filters.records.FromFunctions(other.start, other.step)
    """

    start: Callable[[Gaussian], Any]
    step: Callable[[Any, Epoch], tuple[Any, tuple[Info, ...]]]


class Filter(Protocol):
    """The interface of a filter for `celnav.run`. All its memory is in the state, which can be
    stored, copied and resumed.
    """

    def start(self, prior: Gaussian) -> Any:
        """State before the first epoch; ``state.belief`` is the estimate."""

    def step(self, state: Any, epoch: Epoch) -> tuple[Any, tuple[Info, ...]]:
        """State after an epoch, and an `Info` of each sensor."""


class Inputs(NamedTuple):
    """Inputs ``(u, about)`` of the epochs with the indices ``at (K,)``, as columns ``(K, ...)``."""

    at: Array
    columns: Any


class Epochs(Sequence[Epoch]):
    """Epochs made from arrays on demand, one at a time; nothing is copied. See `epochs`.

    A slice is an `Epochs` too, numbered consecutively. Its first epoch keeps the interval before
    it, so that ``[k:]`` continues where ``[:k]`` ends. If a stride leaves epochs out, the intervals
    are between the remaining epochs.
    """

    def __init__(
        self,
        times: Array,
        z: Any,
        u: Any,
        truth: Any,
        rows: range | None = None,
        before: int = -1,
        first: int = 0,
        about: Any = None,
    ):
        self._times, self._z, self._u, self._truth = times, z, u, truth
        self._rows = range(len(times)) if rows is None else rows
        self._before, self._first, self._about = before, first, about

    def __len__(self) -> int:
        return len(self._rows)

    def __repr__(self) -> str:
        span = (
            f" from {self._times[self._rows[0]]:g} to {self._times[self._rows[-1]]:g} s"
            if self._rows
            else ""
        )
        return f"Epochs({len(self)}{span})"

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            rows, count = self._rows[k], k.indices(len(self))[2]
            if count < 1:
                raise ValueError(f"epochs: expected a slice that runs forward, got {k}")
            if count > 1 and self._u is not None:
                raise ValueError(
                    f"epochs: an interval of {count} epochs has {count} inputs, got one u per "
                    "epoch; create the epochs with celnav.epochs(times[::stride], ...)"
                )
            at = k.indices(len(self))[0]
            return self._with(
                _rows=rows,
                _before=self._row_before(at),
                _first=self._number(at),
                _about=_at(self._about, k),
            )
        at = range(len(self))[k]
        i, before = self._rows[at], self._row_before(at)
        t = float(self._times[i])
        dt, u = (
            (t - float(self._times[before]), _at(self._u, before)) if before >= 0 else (0.0, None)
        )
        about = _at(self._about, at)
        return Epoch(self._number(at), t, dt, u, _at(self._z, i), _at(self._truth, i), about)

    def columns(self, sensors: int) -> tuple[Array, Array, Array, list[Inputs], tuple[Any, ...]]:
        """All epochs at once: ``k``, ``t`` and ``dt``, each ``(T,)``; the inputs; and the
        measurements ``(T, ..., m)`` of each sensor.
        """
        rows = self._rows
        at = np.arange(rows.start, rows.stop, rows.step)
        before = np.concatenate([[self._row_before(0)], at[:-1]])
        if rows.step < 0:
            before = at + rows.step
        t, moved = self._times[at], before >= 0
        dt = np.where(moved, t - self._times[before], 0.0)
        z = self._z if isinstance(self._z, tuple) else (self._z,) * max(sensors, 1)
        measurements = tuple(
            [None] * len(at) if column is None else column[at[0] : at[-1] + 1 : rows.step]
            for column in z[:sensors]
        )
        inputs = []
        for acts in (False, True) if self._u is not None else (None,):
            index = np.arange(len(at)) if acts is None else np.flatnonzero(moved == acts)
            u = _at(self._u, before[index]) if acts else None
            if len(index):
                inputs.append(Inputs(index, (u, _at(self._about, index))))
        return self._number(0) + self._sign * np.arange(len(at)), t, dt, inputs, measurements

    @property
    def columnar(self) -> bool:
        """Whether the inputs are an array of numbers, or a tuple of such arrays."""
        return _is_columns(self._u)

    def unmeasured(self) -> Epochs:
        """The same epochs without measurements and truth."""
        return self._with(_z=None, _truth=None)

    def with_about(self, about: Any) -> Epochs:
        """The same epochs with ``about``: a tree of columns ``(T, ...)``."""
        return self._with(_about=about)

    def backward(self, about: tuple[Any, ...]) -> Epochs:
        """All epochs but the first, in reverse order, without measurements.

        about: columns to insert before the present ``about``.
        """
        return self.unmeasured()._with(
            _rows=self._rows[:0:-1],
            _first=self._number(len(self) - 1),
            _about=(*about, _at(self._about, slice(None, 0, -1))),
        )

    @property
    def _sign(self) -> int:
        return 1 if self._rows.step > 0 else -1

    def _number(self, at: int) -> int:
        return self._first + self._sign * at

    def _row_before(self, at: int) -> int:
        if self._sign < 0:
            return self._rows[at] + self._rows.step if at < len(self) else -1
        return self._rows[at - 1] if at else self._before

    def _with(self, **changes: Any) -> Epochs:
        other = copy(self)
        vars(other).update(changes)
        return other

    def __add__(self, other: Iterable[Epoch]) -> list[Epoch]:
        return [*self, *other]


def _at(values: Any, k: Any) -> Any:
    """Row ``k`` of each column in a tree of tuples, or the rows of a slice."""
    if values is None:
        return None
    if isinstance(values, tuple):
        make: Any = type(values)
        parts = [_at(v, k) for v in values]
        return make(*parts) if hasattr(values, "_fields") else tuple(parts)
    return values[k]


def _is_columns(values: Any) -> bool:
    if isinstance(values, tuple):
        return all(map(_is_columns, values))
    return values is None or (isinstance(values, np.ndarray) and values.dtype.kind in "biuf")


def epochs(times: ArrayLike, z: Any = None, u: Any = None, truth: Any = None) -> Epochs:
    """Epochs at ``times (T,)``, which may be irregular.

    times: s, not decreasing; dates, in any time zone, become seconds since the first. The first
        epoch has ``dt = 0``: it updates the prior.
    z: measurements ``(T, ..., m)``, time-major, nan where missing; a tuple of such arrays for
        several sensors.
    u: inputs; ``u[k]`` acts from ``times[k]`` to ``times[k + 1]``, so there are T - 1 inputs. In a
        tuple each array is indexed separately.
    truth: a sequence of T items of any kind, indexed by the epoch.

    Each may be a pandas DataFrame or Series, whose rows are used in their order. ValueError names
    an argument that does not fit.

    >>> track = celnav.run(filter, prior, celnav.epochs(times, z)[:100])
    """
    t = finite("times", as_seconds(times))
    if t.ndim != 1 or len(t) == 0:
        raise ValueError(f"times: expected shape (T,) with T > 0, got {t.shape}")
    back = np.flatnonzero(np.diff(t) < 0.0)
    if len(back):
        k = int(back[0]) + 1
        raise ValueError(
            f"times: expected times that do not decrease, got {t[k]} after {t[k - 1]} at index {k}"
        )
    if z is not None:
        z = (
            tuple(_measurements(v, len(t)) for v in z)
            if isinstance(z, tuple)
            else _measurements(z, len(t))
        )
    u, truth = _rows("u", u, len(t)), _rows("truth", truth, len(t))
    return Epochs(t, z, u, truth)


def as_seconds(times: Any) -> Any:
    """Times as numbers: dates in any time zone become seconds since the first; durations become
    seconds.
    """
    try:
        array = np.asarray(times)
        if array.dtype.kind == "M":
            return (array - array[:1]) / np.timedelta64(1, "s")
        if array.dtype.kind == "m":
            return array / np.timedelta64(1, "s")
        if array.dtype.kind == "O" and isinstance(array[0], date):
            # Within one time zone Python subtracts clock readings, which ignores daylight saving.
            utc = [t.astimezone(UTC) if getattr(t, "tzinfo", None) else t for t in array]
            return [(t - utc[0]) / timedelta(seconds=1) for t in utc]
    except (AttributeError, IndexError, TypeError, ValueError):
        pass  # not dates: the caller checks them as numbers
    return times


def first_date(times: Any) -> np.datetime64 | None:
    """The date in UTC from which `as_seconds` counts; None for numbers. Its resolution is 1 ns from
    1678 to 2262, else 1 µs.
    """
    if not isinstance(times, list | tuple):
        times = np.asarray(times).reshape(-1)
    first: Any = times[0] if len(times) else None
    if isinstance(first, datetime) and first.tzinfo is not None:
        first = first.astimezone(UTC).replace(tzinfo=None)
    if isinstance(first, date):  # a pandas Timestamp has nanoseconds
        first = first.to_datetime64() if hasattr(first, "to_datetime64") else np.datetime64(first)
    if not isinstance(first, np.datetime64):
        return None
    start: np.datetime64 = first.astype("datetime64[ns]")
    if start.astype("datetime64[D]") != first.astype("datetime64[D]"):
        start = first.astype("datetime64[us]")
    return start


def _rows(name: str, values: Any, times: int) -> Any:
    """Values with a row ``values[k]`` for each time; ValueError if the number of rows does not fit
    the times.
    """
    if isinstance(values, tuple):
        return tuple(_rows(name, column, times) for column in values)
    if values is None:
        return None
    if hasattr(values, "__array__") and not isinstance(values, np.ndarray):
        array = np.asarray(values)  # iterating a DataFrame gives columns, not rows
        values = array if array.dtype.kind in "biuf" else numbers(name, array)
    try:
        count = -1 if isinstance(values, str) else len(values)
        if count > 0:
            values[0]  # fails for a set or a dict
    except (TypeError, KeyError, IndexError):
        count = -1
    if count < 0:
        raise ValueError(
            f"{name}: expected a sequence with a row for each time, got {describe(values)}"
        )
    rows, acts, cure = times, "", ""
    if name == "u":
        rows, acts = times - 1, " (row k acts from times[k] to times[k + 1])"
        if count == times:  # as in a log; the interval of each row is known only to the user
            cure = "; its rows [:-1] if row k acts from times[k] on, [1:] if it acts up to times[k]"
    if count != rows:
        raise ValueError(f"{name}: expected {rows} rows for {times} times{acts}, got {count}{cure}")
    return _locked(values) if isinstance(values, np.ndarray) else values


def _locked(values: Array) -> Array:
    """A read-only view: a model is called more than once in an epoch and must not overwrite its
    input.
    """
    view = values.view()
    view.flags.writeable = False
    return view


def _measurements(z: ArrayLike, length: int) -> Array:
    measured = numbers("z", z)
    if measured.ndim < 2 or len(measured) != length:
        column = "z.to_frame()" if hasattr(z, "to_frame") else "z[:, None]"
        hint = f"; one component is {column}" if measured.shape == (length,) else ""
        raise ValueError(
            f"z: expected shape ({length}, ..., m) to go with the times, got {measured.shape}{hint}"
        )
    if np.isinf(measured).any():
        k = int(np.argwhere(np.isinf(measured))[0, 0])
        raise ValueError(f"z: expected finite numbers or nan, got an infinite one at index {k}")
    return _locked(measured)


def without_input(error: Exception, epoch: Any) -> Exception:
    """The error of a model; if it failed because the epoch has no input, an error that names the
    input.
    """
    names, trace = set[str](), error.__traceback__
    while trace is not None:
        names.update(trace.tb_frame.f_code.co_names)
        trace = trace.tb_next
    raw = isinstance(error, AttributeError | TypeError) and "NoneType" in str(error)
    if not raw or getattr(epoch, "u", None) is not None or "truth" in names:
        return error
    if np.any(epoch.dt):
        return ValueError(f"u: expected an input at t = {epoch.t}, where a model uses it, got None")
    return ValueError(
        f"u: expected models that need no input at t = {epoch.t}: there is no interval before the "
        "first epoch. "
        "Make its measurement nan, or let the model use a default value if epoch.u is None"
    )


def check_interval(filter: Any, epoch: Any, before: Any) -> None:
    """Raise a ValueError if the interval of an epoch is invalid, or is 0 although time has passed
    since ``before``.
    """
    dt = getattr(epoch, "dt", None)
    if isinstance(dt, float) and 0.0 < dt < np.inf:
        return
    if dt is None:
        raise ValueError(
            "epochs: expected celnav.epochs(times, z), or records like celnav.Epoch, got "
            f"{describe(epoch)}"
        )
    interval = numbers("dt", dt)
    if before is not None and not interval.any() and np.any(np.asarray(epoch.t) > before):
        raise ValueError(f"dt: expected the interval since t = {before}, got 0 at t = {epoch.t}")
    if not (np.isfinite(interval) & (interval >= 0.0)).all():
        raise ValueError(f"dt: expected a non-negative number, got {dt!r} at step {epoch.k}")
    motion = getattr(filter, "motion", None)
    if (
        np.any(dt)
        and not np.all(dt)
        and motion is not None
        and not (callable(motion.Q) or callable(motion.sqrt_Q))
    ):
        raise ValueError(
            "dt: expected an interval in every run or in none if Q is constant, got 0 in "
            "some runs; let Q be a function (mean, epoch)"
        )
