"""The driver of all filters: from epochs to a stream of states (`steps`) or a `Track` (`run`)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.joint import noise_at
from celnav.filters.mixing import LOOKED_AT, WATCH
from celnav.filters.records import (
    Epoch,
    Filter,
    FilterError,
    Info,
    check_interval,
    epochs,
    first_date,
    without_input,
)
from celnav.filters.sequential import Sequential
from celnav.filters.track import Collector, Track, rows_of
from celnav.gaussian.belief import mask_failed
from celnav.gaussian.checks import choice, describe, function, instance, integer
from celnav.gaussian.linalg import Array

__all__ = ["run", "steps"]

ENGINES = ("numpy", "compiled", "cuda", "auto")
ENGINE: ContextVar[str] = ContextVar("engine", default="auto")
"""The default engine of `run` and of the studies; ``celnav reproduce --engine`` sets it."""
REPEATED: ContextVar[int] = ContextVar("repeated", default=0)
"""How many runs of equal filters are expected; engine="auto" decides for all of them. 0: unknown.
"""


@contextmanager
def repeated(times: int) -> Iterator[None]:
    """A context in which engine="auto" expects ``times`` times as many runs of equal filters."""
    token = REPEATED.set(times * max(1, REPEATED.get()))
    try:
        yield
    finally:
        REPEATED.reset(token)


def run(
    filter: Filter,
    prior: Any,
    times: ArrayLike | Iterable[Epoch],
    z: Any = None,
    u: Any = None,
    *,
    every: int = 1,
    keep: str | Collection[str] = "std",
    on_failure: str = "raise",
    also: Callable[[Epoch, Any, tuple[Info, ...]], dict[str, Any]] | None = None,
    reduce: Callable[[Any, Epoch, Any, tuple[Info, ...]], Any] | None = None,
    engine: str | None = None,
    jobs: int = 1,
) -> Track:
    """Run a filter over epochs and collect a `Track`.

    filter: any filter. prior: a `celnav.Gaussian` with any batch shape.
    times: ``(T,)`` s, or dates, with measurements ``z (T, ..., m)`` (nan where missing; a tuple for
        several sensors) and inputs ``u``, as for `celnav.epochs`; or, instead of the three, the
        result of `celnav.epochs`, or any iterable of `Epoch`.
    every: store each ``every``-th epoch (sums, likelihood and reduction use all epochs).
    keep: what to store: "std" (mean, standard deviations, innovations), "cov" (also covariances,
        for smoothing), "mean" (mean and innovations), or "nothing" (sums and the reduction only). A
        tuple such as ("mean", "std") names the only rows to store: "mean", "std", "cov",
        "innovation" (with whitened innovations and the mask of used components).
    also: ``(epoch, state, infos) -> dict`` of further arrays to store, as ``Track.extra``.
    reduce: ``(accumulated, epoch, state, infos) -> accumulated``, starting from None; the final
        value is ``Track.reduced``. With ``reduce`` and keep="nothing" a run of any length needs the
        memory of one step.
    engine: "auto" (unless `ENGINE` is set otherwise): machine code if available, and if this run is
        long enough to repay recording and compiling or the same filter was recorded before; else
        numpy. ``Track.engine`` names the engine and the reason. "numpy". "compiled": the filter's
        steps as machine code, see `celnav.compiled`. "cuda": on an NVIDIA device (experimental).
    jobs: threads of compiled code.
    on_failure: "raise" a `FilterError` for the first run that fails, or "flag" it: the failed run
        is nan from this epoch on (``Track.failed_at``), and the other runs continue.

    ValueError names an argument that does not fit.

    >>> track = celnav.run(celnav.ukf(motion, gps), celnav.Gaussian(x0, P0), times, z)
    """
    if also is not None:
        function("also", also, "(epoch, state, infos)")
    if reduce is not None:
        function("reduce", reduce, "(accumulated, epoch, state, infos)")
    if (
        engine := choice("engine", ENGINE.get() if engine is None else engine, ENGINES)
    ) != "numpy" or hasattr(filter, "run"):  # a compiled filter
        from celnav.engine.compiled import run_by

        stream = as_epochs(times, z, u)
        options: Any = {"every": every, "keep": keep, "on_failure": on_failure}
        track = run_by(engine, filter, prior, stream, jobs, also, reduce, **options)
        return labeled(track, times, z)
    collector = Collector(integer("every", every), rows_of(keep))
    choice("on_failure", on_failure, ("raise", "flag"))
    reduced, before = None, None
    for epoch, state, infos in steps(filter, prior, as_epochs(times, z, u)):
        more = (
            {}
            if also is None
            else instance(
                "also", also(epoch, state, infos), dict, "a dict, such as {'gain': array}"
            )
        )
        lost = collector.add(epoch, state.belief, infos, more)
        if lost is not None and on_failure == "raise":
            why = explain(filter, filter.start(prior) if before is None else before, state, epoch)
            where = f", run {lost}" if lost else ""
            raise FilterError(
                f"step {epoch.k}, t = {epoch.t}{where}: {why} (on_failure='flag' continues "
                "the other runs)"
            )
        if reduce is not None:
            reduced = reduce(reduced, epoch, state, infos)
        before = state
    return labeled(collector.track(reduced, filter), times, z)


def labeled(track: Track, times: Any, z: Any) -> Track:
    """The track with the date of t = 0, and with column names if all measurements are tables."""
    tables = z if isinstance(z, tuple) else (z,)
    columns: tuple[str, ...] = ()
    if all(hasattr(table, "columns") for table in tables):
        columns = tuple(str(name) for table in tables for name in table.columns)
    listed = hasattr(times, "__array__") or isinstance(times, list | tuple)
    start = first_date(times) if listed else None
    if start is None and not columns:
        return track
    return replace(track, columns=columns, start=start)


def as_epochs(times: Any, z: Any, u: Any) -> Iterable[Epoch]:
    """Epochs from arrays, or the epochs as passed; a stream is not consumed."""
    listed = isinstance(times, list | tuple) and not any(hasattr(item, "dt") for item in times[:1])
    if listed or hasattr(times, "__array__") or np.isscalar(times):
        return epochs(times, z, u)
    if z is not None or u is not None:
        raise ValueError("z: expected none beside epochs, which already have measurements")
    return times  # type: ignore[no-any-return]


def steps(
    filter: Filter, prior: Any, epochs: Iterable[Epoch]
) -> Iterator[tuple[Epoch, Any, tuple[Info, ...]]]:
    """Yield ``(epoch, state, infos)`` after each step; ``state.belief`` is the estimate.

    >>> for epoch, state, infos in celnav.steps(filter, prior, celnav.epochs(times, z)): ...
    """
    if not (hasattr(filter, "start") and hasattr(filter, "step")):
        raise ValueError(
            f"filter: expected a filter, such as celnav.ukf(motion, sensor), got {describe(filter)}"
        )
    state, before = filter.start(prior), None
    try:
        every = iter(epochs)
    except TypeError:
        raise ValueError(
            "epochs: expected celnav.epochs(times, z), or records like celnav.Epoch, got "
            f"{describe(epochs)}"
        ) from None
    models: list[Any] = []
    settles = not hasattr(filter, "run")  # a compiled filter does it itself
    for epoch in every:
        check_interval(filter, epoch, before)
        before = epoch.t
        token = LOOKED_AT.set(models)
        try:
            state, infos = filter.step(state, epoch)
        except Exception as error:
            cause = without_input(error, epoch)
            cause.add_note(f"in step {epoch.k}, t = {epoch.t}")
            if cause is error:
                raise
            raise cause from error
        finally:
            LOOKED_AT.reset(token)
        if settles and "belief" in getattr(state, "_fields", ()):
            state = state._replace(belief=mask_failed(state.belief))
        yield epoch, state, infos


def explain(filter: Any, before: Any, after: Any, epoch: Epoch) -> str:
    """One sentence on why a run failed at an epoch; found by repeating the step with a check of
    each model.
    """
    lost = after.belief.lost() & ~np.broadcast_to(
        before.belief.lost(), after.belief.mean.shape[:-1]
    )
    for sample in epoch.z if isinstance(epoch.z, tuple) else (epoch.z,):
        if sample is not None and np.isinf(np.asarray(sample, dtype=np.float64)).any():
            return "z is infinite"
    if (lost & np.isnan(before.belief.sqrt_cov).any((-2, -1))).any():
        return (
            "the covariance lost positive definiteness in the step before; "
            "the square-root form has twice the digits"
        )
    causes: list[str] = []

    def look(name: str, y: Array) -> None:
        bad = ~np.isfinite(y).all(-1) & lost
        if bad.any() and not causes:
            causes.append(f"{name} is not finite at sigma point {int(np.argwhere(bad)[0, 0])}")

    token = WATCH.set(look)
    try:
        with np.errstate(all="ignore"):
            filter.step(before, epoch)
    finally:
        WATCH.reset(token)
    predicted = (
        filter.predict(before, epoch)
        if getattr(type(filter), "step", None) is Sequential.step
        else before
    )
    unpredicted = (predicted.belief.lost() & lost).any()
    if causes and not (
        unpredicted and causes[0].startswith("h ")
    ):  # h is not to blame for its points
        return causes[0]
    within = (
        filter if hasattr(filter, "sensors") else getattr(filter, "first", filter)
    )  # of two filters, or of two stages
    if not hasattr(getattr(within, "filter", within), "sensors"):
        return "the estimate is not finite"
    if epoch.z is None or unpredicted:
        return "the covariance lost positive definiteness"
    why = "the innovation covariance is not positive definite"
    for sensor in getattr(filter, "sensors", ()):
        columns = noise_at(sensor.noise, predicted.belief.mean, epoch)
        if not len(sensor.augment) and (columns is None or not columns.any(-1).all()):
            return (
                f"{why}; a measurement without noise must not repeat what is determined already: "
                "of redundant sensors, or "
                "repeated constraints, leave out all but one (z is nan), or give them a "
                "small R"
            )
    return why
