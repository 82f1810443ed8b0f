"""The one driver: epochs in, a stream of states or a `Track` out.

A filter is two functions, ``start(prior) -> state`` and ``step(state, epoch) -> (state, info)``. The state is any record with
a ``belief``; all memory of the filter lives in it, so states can be kept, copied and resumed. `sequential` makes a filter
of a predict part and update parts; `steps` streams any filter over epochs; `run` collects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.arguments import check_belief, check_model, given_back, takes
from celnav.filters.info import Info
from celnav.filters.mixing import LOOKED_AT
from celnav.filters.step import Conditioning, Motion, Predict, Update
from celnav.filters.track import Collector, Track
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import choice, finite, instance, integer, kind, numbers
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import EUCLIDEAN, Space


class Epoch(NamedTuple):
    """What is known about the interval ``(t - dt, t]`` and the sample at its end.

    ``z`` is one measurement ``(..., m)`` or a tuple of them, one for each sensor; nan or None where there is none. ``u`` is
    the input that acts over the interval, ``truth`` whatever a simulation wants to hand on.
    """

    k: int = 0
    t: Any = 0.0
    dt: Any = 0.0
    u: Any = None
    z: Any = None
    truth: Any = None


class State(NamedTuple):
    """State of a plain filter: the belief and one memory for each update."""

    belief: Gaussian
    memory: tuple[Any, ...] = ()


class Filter(NamedTuple):
    """``start(prior) -> state``; ``step(state, epoch) -> (state, info)``. ``state.belief`` is the estimate."""

    start: Callable[[Gaussian], Any]
    step: Callable[[Any, Epoch], tuple[Any, Any]]


class FilterError(ArithmeticError):
    """A run lost definiteness or met numbers that are not finite; the message says which run, when and why."""


def sequential(predict: Predict, *updates: Update) -> Filter:
    """A filter that predicts over the interval, then takes each update with its own part of ``epoch.z``.

    An epoch with ``dt == 0`` does not predict: the first one is an update of the prior. Each sensor has its own measurement
    (``z`` is a tuple when there are several), so sensors of different rates need nothing but nan where they are silent. Without
    updates it is the open loop, which looks at no measurement.

    Raises
    ------
    ValueError: for parts that are none, or not in this order; from the filter, unless there is a measurement for each update.
    """
    if isinstance(predict, Conditioning) or not takes(predict, 2):
        raise ValueError(f"predict: expected a part (belief, epoch), got {kind(predict)}")
    for part in updates:
        if isinstance(part, Motion) or not takes(part, 4):
            raise ValueError(f"updates: expected parts (belief, z, epoch, memory) after the predict part, got {kind(part)}")
        _check_spaces(predict, part)

    def step(state: State, epoch: Epoch) -> tuple[State, Any]:
        if not isinstance(state, State):
            raise ValueError(f"state: expected what the filter's start(prior) or last step gave, got {kind(state)}")
        belief, memory = state.belief, list(state.memory)
        predicted = Info()
        if epoch.dt if isinstance(epoch.dt, float) else np.any(epoch.dt):
            found = predict(belief, epoch)
            belief, predicted = found if type(found) is tuple else given_back("predict", found, "belief, info")
        z = epoch.z if isinstance(epoch.z, tuple) else (epoch.z,) if epoch.z is not None else (None,) * len(updates)
        if updates and len(z) != len(updates):
            raise ValueError(f"z: expected {len(updates)} measurements, got {len(z)}")
        infos = []
        for i, (update, measured) in enumerate(zip(updates, z, strict=False)):
            if measured is None:
                infos.append(Info(silent=True))
                continue
            after = update(belief, measured, epoch, memory[i])
            belief, info, memory[i] = after if type(after) is tuple else given_back("updates", after, "belief, info, memory")
            infos.append(info)
        infos = [i._replace(slopes=(predicted.slopes or (None,)) + i.slopes[1:]) for i in infos] or [predicted]
        if infos[0] is not predicted and (predicted.failure or predicted.redone is not None):
            redone = [r for r in (predicted.redone, infos[0].redone) if r is not None]
            infos[0] = infos[0]._replace(
                failure=predicted.failure or infos[0].failure, redone=np.logical_or(redone[0], redone[-1]) if redone else None
            )
        return State(belief, tuple(memory)), infos[0] if len(infos) == 1 else tuple(infos)

    return Filter(lambda prior: State(prior, (None,) * len(updates)), step)


def _check_spaces(predict: Any, update: Any) -> None:
    """Parts of one filter speak of the same state; of two spaces that are not vectors one cannot tell."""
    flat = [space == EUCLIDEAN for part in (predict, update) if isinstance(space := getattr(part, "space", None), Space)]
    if len(flat) == 2 and flat[0] != flat[1]:
        names = ["vectors" if each else "another space" for each in flat]
        hint = "; a measurement that wraps is measurement_space=" if flat[0] else ""
        raise ValueError(f"space: expected the same in predict and update, got {names[0]} and {names[1]}{hint}")


_BLOCK = 1024
"""Epochs whose times are taken out of the array at once."""


class Epochs(Sequence[Epoch]):
    """Epochs made from arrays when they are asked for, one at a time; nothing is copied. See `epochs`.

    A slice is one again, numbered on. Its first epoch keeps the interval that leads up to it, so that ``[k:]`` goes on where
    ``[:k]`` ends; where a stride leaves epochs out, intervals are those between the ones that are left.
    """

    def __init__(self, times: Array, z: Any, u: Any, truth: Any, rows: range | None = None, before: int = -1, first: int = 0):
        self._times, self._z, self._u, self._truth = times, z, u, truth
        self._rows, self._before, self._first = range(len(times)) if rows is None else rows, before, first

    def __len__(self) -> int:
        return len(self._rows)

    def __repr__(self) -> str:
        span = f" from {self._times[self._rows[0]]:g} to {self._times[self._rows[-1]]:g} s" if self._rows else ""
        return f"Epochs({len(self)}{span})"

    def __getitem__(self, k: Any) -> Any:
        if not isinstance(k, slice):
            return self._epoch(range(len(self))[k])
        rows = self._rows[k]
        if rows.step < 1:
            raise ValueError(f"epochs: expected a slice that runs forward, got {k}")
        if rows.step > 1 and self._u is not None:
            raise ValueError(
                f"epochs: an interval of {rows.step} epochs has {rows.step} inputs, got one u for each; make epochs anew"
            )
        at = self._rows.index(rows[0]) if rows else 0
        return Epochs(
            self._times, self._z, self._u, self._truth, rows, self._rows[at - 1] if at else self._before, self._first + at
        )

    def __iter__(self) -> Iterator[Epoch]:
        before = self._before
        last = float(self._times[before]) if before >= 0 else None
        for start in range(0, len(self), _BLOCK):
            rows = self._rows[start : start + _BLOCK]
            times = self._times[rows.start : rows.stop : rows.step].tolist()
            for k, i, t in zip(range(self._first + start, self._first + start + len(rows)), rows, times, strict=True):
                dt, u = (0.0, None) if last is None else (t - last, _at(self._u, before))
                yield Epoch(k, t, dt, u, _at(self._z, i), _at(self._truth, i))
                before, last = i, t

    def __add__(self, other: Iterable[Epoch]) -> list[Epoch]:
        return [*self, *other]

    def _epoch(self, j: int) -> Epoch:
        i, before = self._rows[j], self._rows[j - 1] if j else self._before
        t = float(self._times[i])
        dt, u = (t - float(self._times[before]), _at(self._u, before)) if before >= 0 else (0.0, None)
        return Epoch(self._first + j, t, dt, u, _at(self._z, i), _at(self._truth, i))


def _at(values: Any, k: int) -> Any:
    if values is None:
        return None
    return tuple(_at(v, k) for v in values) if isinstance(values, tuple) else values[k]


def epochs(times: ArrayLike, z: Any = None, u: Any = None, truth: Any = None) -> Epochs:
    """Epochs at ``times (T,)``, which may be irregular.

    Parameters
    ----------
    times: s, not decreasing. The first epoch has ``dt = 0``: it updates the prior.
    z: measurements ``(T, ..., m)``, time-major, nan where missing; a tuple of such arrays for several sensors.
    u: inputs; ``u[k]`` acts from ``times[k]`` to ``times[k + 1]``. A tuple is taken apart.
    truth: anything indexed by the epoch.

    Raises
    ------
    ValueError: if times are not finite or run back, if ``z`` is not numeric, infinite, or of another length.
    """
    t = finite("times", times)
    if t.ndim != 1 or len(t) == 0:
        raise ValueError(f"times: expected shape (T,) with T > 0, got {t.shape}")
    if (np.diff(t) < 0.0).any():
        k = int(np.argmax(np.diff(t) < 0.0)) + 1
        raise ValueError(f"times: expected them not to decrease, got {t[k]} after {t[k - 1]} at index {k}")
    if z is not None:
        z = tuple(_checked(v, len(t)) for v in z) if isinstance(z, tuple) else _checked(z, len(t))
    for name, values, least in (("u", u, len(t) - 1), ("truth", truth, len(t))):
        for part in values if isinstance(values, tuple) else (values,):
            if part is not None and _rows(name, part) < least:
                raise ValueError(f"{name}: expected at least {least} rows for {len(t)} times, got {len(part)}")
    return Epochs(t, z, u, truth)


def _rows(name: str, values: Any) -> int:
    """How many rows there are."""
    try:
        rows = 0 if isinstance(values, str) else len(values)
        if rows:
            values[0]
    except (TypeError, KeyError, IndexError):
        rows = -1
    if rows < 0 or isinstance(values, str):
        raise ValueError(f"{name}: expected a sequence with a row for each time, got {kind(values)}")
    return rows


def _checked(z: ArrayLike, length: int) -> Array:
    measured = numbers("z", z)
    if measured.ndim < 2 or len(measured) != length:
        hint = "; one component is z[:, None]" if measured.shape == (length,) else ""
        raise ValueError(f"z: expected shape ({length}, ..., m) to go with the times, got {measured.shape}{hint}")
    if np.isinf(measured).any():
        k = int(np.argwhere(np.isinf(measured))[0, 0])
        raise ValueError(f"z: expected finite numbers or nan, got an infinite one at index {k}")
    return measured


def steps(filter: Filter, prior: Gaussian, epochs: Iterable[Epoch]) -> Iterator[tuple[Epoch, Any, Any]]:
    """Stream a filter over epochs: yields ``(epoch, state, info)``. Nothing is stored.

    Raises
    ------
    ValueError: if an interval is negative, not finite, or 0 though time went on, what is given is no filter or no belief, or a
        model mixes runs, as ``F @ x`` does. An exception of the model carries the step as a note.
    """
    if not (hasattr(filter, "start") and hasattr(filter, "step")):
        raise ValueError(f"filter: expected a Filter, such as celnav.sequential makes, got {kind(filter)}")
    check_belief(prior, "prior")
    try:
        every = iter(epochs)
    except TypeError:
        raise ValueError(f"epochs: expected celnav.epochs(times, z), or records like celnav.Epoch, got {kind(epochs)}") from None
    state, before = filter.start(prior), None
    models: list[Any] = []
    for epoch in every:
        _check_interval(epoch, before)
        before = epoch.t
        token = LOOKED_AT.set(models)
        try:
            state, info = filter.step(state, epoch)
        except Exception as error:
            error.add_note(f"in step {epoch.k}, t = {epoch.t}")
            raise
        finally:
            LOOKED_AT.reset(token)
        yield epoch, state, info


def _check_interval(epoch: Any, before: Any) -> None:
    dt = getattr(epoch, "dt", None)
    if isinstance(dt, float) and 0.0 < dt < np.inf:
        return
    if dt is None:
        raise ValueError(f"epochs: expected celnav.epochs(times, z), or records like celnav.Epoch, got {kind(epoch)}")
    interval = numbers("dt", dt)
    if before is not None and not interval.any() and np.any(np.asarray(epoch.t) > before):
        raise ValueError(f"dt: expected the interval since t = {before}, got 0 at t = {epoch.t}")
    if not (np.isfinite(interval) & (interval >= 0.0)).all():
        raise ValueError(f"dt: expected a non-negative number, got {dt!r} at step {epoch.k}")


def run(
    filter: Filter,
    prior: Gaussian,
    epochs: Iterable[Epoch],
    *,
    every: int = 1,
    keep: str = "std",
    also: Callable[[Epoch, Any, Any], dict[str, Any]] | None = None,
    reduce: Callable[[Any, Epoch, Any, Any], Any] | None = None,
    on_failure: str = "raise",
) -> Track:
    """Run a filter over epochs and collect a `Track`.

    Parameters
    ----------
    filter, prior, epochs: any filter, a `Gaussian` of any batch shape, any iterable of `Epoch`.
    every: store each ``every``-th epoch (sums, likelihood and reduction take all of them).
    keep: what to store: "std" (mean and standard deviations), "spread" (also roots or covariances, for smoothing), "mean",
        or "nothing" (sums and the reduction only).
    also: ``(epoch, state, info) -> dict`` of further arrays to store, as ``Track.extra``.
    reduce: ``(accumulated, epoch, state, info) -> accumulated``, from None; the end is ``Track.reduced``. With it a study
        of any length runs in the memory of one step.
    on_failure: "raise" a `FilterError` for the first run that is lost, or "flag" it: it becomes nan from there
        (``Track.failed_at``), the other runs go on.

    Raises
    ------
    ValueError: for a bad option, measurement or time. FilterError: see ``on_failure``.
    """
    stored = integer("every", every)
    choice("keep", keep, ("std", "spread", "mean", "nothing"))
    choice("on_failure", on_failure, ("raise", "flag"))
    if also is not None:
        check_model("also", also, "(epoch, state, info)")
    if reduce is not None:
        check_model("reduce", reduce, "(accumulated, epoch, state, info)")
    collector = Collector(stored, keep)
    reduced = None
    for epoch, state, info in steps(filter, prior, epochs):
        infos = info if isinstance(info, tuple) and not isinstance(info, Info) else (info,)
        lost = collector.add(
            epoch,
            state,
            infos,
            {} if also is None else instance("also", also(epoch, state, info), dict, "a dict, such as {'gain': array}"),
        )
        if lost is not None and on_failure == "raise":
            why = next((i.failure for i in infos if i.failure), "the state is not finite")
            where = f", run {tuple(int(i) for i in lost)}" if lost else ""
            raise FilterError(f"step {epoch.k}, t = {epoch.t}{where}: {why} (on_failure='flag' lets the other runs go on)")
        if reduce is not None:
            reduced = reduce(reduced, epoch, state, info)
    return collector.track(reduced)
