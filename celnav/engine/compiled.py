"""A filter as machine code: `celnav.compiled`, and ``celnav.run`` with ``engine="compiled"``,
``"cuda"`` or ``"auto"``.

The numpy engine repeats the runs that fail, because it is the reference and can explain the
failure.
"""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from copy import copy
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from itertools import islice
from threading import Lock, local
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from celnav.engine.recording import NONE, Data, Engine, StepCache, map_run_constants, signature
from celnav.engine.runs import CompiledRun, as_data, epoch_of, run_compiled, runs_of
from celnav.engine.sentinels import (
    Watch,
    changed,
    difference,
    different_quantity,
    functions_of,
    model_contents,
    restorer,
)
from celnav.engine.stepper import Plan, plan_key
from celnav.filters.fixed_lag import FixedLag
from celnav.filters.joint import by_matrix
from celnav.filters.records import Epoch, Epochs, FilterError, Info, State
from celnav.filters.run import REPEATED, as_epochs, run, steps
from celnav.filters.sequential import Sequential
from celnav.filters.track import Track, rows_of
from celnav.gaussian.checks import choice, integer
from celnav.gaussian.linalg import Array, Covariance, SquareRoot
from celnav.tape.cuda import CudaError, device
from celnav.tape.tape import MOST, CannotCompile, place_of

__all__ = ["Compiled", "compiled"]

# Largest number of operations of a step that engine="auto" compiles (about 5 s), and that a device
# runs.
MOST_AUTO = 50_000
# Constants of engine="auto" in CPU seconds, measured for 1 to 30 states with AVX2 and AVX-512:
STEP_S = 5e-4  # of a numpy step, for models as in the five studies
OPERATION_S = 1.2e-9  # of an operation of a numpy step in each run
COMPILE_OPERATION_S = 6e-5  # to record and compile an operation: 4e-5 to 1e-4
USUAL_KINDS = 2  # kinds of steps in a usual run: with an interval and without
# Estimated operations of a step, times n^2 and times m^2, before the step is recorded:
EXPECTED_OPERATIONS = 100, 20
# Fraction of OPERATION_S if models are matrices: numpy computes one covariance for all runs.
SHARED = 0.02
MOST_CACHED = 16  # number of filters whose machine code is stored
COMPARE_ALL = 262_144  # steps times runs by stored code between comparisons of all sentinels
COMPARE_ONE = 4096  # largest number of steps between two comparisons with numpy
GROWTH = 4  # factor by which that interval grows each time
NUMPY_FIRST = 3  # epochs that numpy runs, for some runs, before a step is recorded
OTHER = "the model gives other values when it is recorded"
LOOKS = "it depends on more than the numbers that it is given; engine='numpy' runs it as it is"
Stepped = tuple[Any, tuple[Info, ...]]


class Compiled:
    """A filter as machine code; `celnav.compiled` makes it.

    The recorded steps are stored. Some steps are compared with numpy's. In the first run and in
    long runs they are spread over all epochs. In later short runs one step is compared: at first in
    each run, finally once in 4,096 steps. Steps are recorded again if the contents of the models
    have changed, such as a global number. A model that changes its contents at every call cannot be
    compiled.

    >>> fast = celnav.compiled(celnav.ukf(motion, gps), jobs=2)
    >>> track = fast.run(prior, times, z)
    """

    def __init__(self, filter: Any, jobs: int, engine: str, most: int | Callable[[int], int]):
        # most: largest number of operations of a step, or a function of the number of kinds.
        self.filter, self.jobs, self.engine, self.most = filter, jobs, engine, most
        self._cache, self._watch = StepCache(), Watch(None)
        self._left = 0  # steps of all runs until numpy repeats all sentinels
        self._next, self._interval = 0, 1  # steps of all runs until numpy repeats one sentinel
        self._run_count = 0
        self._local, self._lock = local(), Lock()  # plans of steps, per thread

    def __repr__(self) -> str:
        return f"Compiled({self.filter!r})"

    def limit(self, kinds: int) -> int:
        """The largest number of operations of a step that may be compiled.

        kinds: number of kinds of epochs in the run. After the first run most steps are recorded
            already, so further kinds do not lower the limit.
        """
        if isinstance(self.most, int):
            return self.most
        return self.most(USUAL_KINDS if self._run_count else kinds)

    @property
    def recorded(self) -> bool:
        """Whether a step has been recorded and compiled."""
        return bool(self._cache.code)

    def adopt(self, other: Compiled) -> Compiled:
        """This filter, with the records of another filter whose models have equal contents.

        Its first run compares all sentinels with this filter's steps by numpy.
        """
        self._cache, self._watch = other._cache.shared(), Watch(self.filter)
        return self

    def holds(self, contents: dict[str, Any]) -> bool:
        """Whether the contents of the models have not changed since they were recorded."""
        return self.recorded and not changed(self._watch.holds, contents)

    def __reduce__(self) -> Any:  # addresses of machine code are valid only in this process
        return Compiled, (self.filter, self.jobs, self.engine, self.most)

    def run(
        self,
        prior: Any,
        times: Any,
        z: Any = None,
        u: Any = None,
        *,
        every: int = 1,
        keep: str | Collection[str] = "std",
        on_failure: str = "raise",
    ) -> Track:
        """The track, as `celnav.run` returns it with these arguments."""
        choice("on_failure", on_failure, ("raise", "flag"))
        every = integer("every", every)
        epochs = as_epochs(times, z, u)
        epochs = epochs if isinstance(epochs, Epochs) else list(epochs)
        return self._run(prior, epochs, every=every, keep=rows_of(keep), on_failure=on_failure)

    def _run(self, prior: Any, epochs: Any, **options: Any) -> Track:
        """The track."""
        every, keep = options["every"], options["keep"]
        count = len(epochs)

        def by_numpy() -> None:
            """Raise numpy's error; the first epochs suffice if all epochs are stored as columns."""
            run(self.filter, prior, epochs[:count], engine="numpy", **options)

        with self._recording(by_numpy):
            data = as_data(self.filter, epochs)
            count = NUMPY_FIRST
            engine, result = self._run_and_compare(prior, data, epochs, keep, every)
        track_epochs: Any = ()
        if "cov" in keep and every == 1 and isinstance(epochs, Epochs):
            track_epochs = epochs.unmeasured()
        elif "cov" in keep:
            stored = islice(epochs, 0, None, every)
            track_epochs = tuple(epoch._replace(z=None, truth=None) for epoch in stored)
        about = {"epochs": track_epochs, "filter": self.filter, "engine": self.engine}
        track = _track(engine, data, result, every, about)
        failed = np.flatnonzero(track.failed_at.ravel() >= 0)
        if not len(failed):
            return track
        return self._rerun_failed(track, engine, prior, data, failed, **options)

    def _recording(self, by_numpy: Callable[[], Any]) -> AbstractContextManager[None]:
        """A context for recording steps; records of models whose contents have changed are
        dropped.
        """
        if self._cache and self._watch.is_still():
            return recording(self._watch.holds, by_numpy, lambda: None)
        holds = model_contents(self.filter)
        if changed(self._watch.holds, holds):
            self._cache = StepCache()
        return recording(holds, by_numpy, restorer(self.filter))

    def _run_and_compare(
        self, prior: Any, data: Data, epochs: Any, keep: Collection[str], every: int
    ) -> tuple[Engine, CompiledRun]:
        """Run the filter after numpy has run the first epochs; `CannotCompile` if a step
        differs.
        """
        fresh, first = not self._cache, not self._run_count
        on = device() if self.engine == "cuda" else None
        engine = self._engine(prior, data)
        count = engine.runs
        # On a device the watched runs must be in the first chunk, because only this chunk runs in
        # pieces.
        watched = sorted({0, count // 2, count - 1}) if on is None else list(range(min(count, 3)))
        # numpy runs first: values that models store at their first call must be floats.
        if fresh or first:
            few = _of(self.filter, prior, data, engine.batch, watched, NUMPY_FIRST)
            try:
                run(*few, on_failure="flag", engine="numpy")
            except Exception:  # a model may have arrays of all runs
                run(self.filter, prior, epochs[:NUMPY_FIRST], on_failure="flag", engine="numpy")
            self._watch = Watch(self.filter)
        steps = count * len(data.k)
        self._left -= steps
        self._next -= steps
        due = fresh or first or self._left < 0 or steps >= COMPARE_ALL
        self._run_count += 1
        number = None if due else self._run_count if self._next < 0 else 0
        if number != 0:
            self._next, self._interval = self._interval, min(GROWTH * self._interval, COMPARE_ONE)
        names = engine.keeping(keep)
        result = run_compiled(engine, prior, data, names, every, self.jobs, on, watched, number)
        why = next(
            (
                f"step {int(data.k[sentinel.at])}: {name}"
                for sentinel in result.sentinels
                if (name := difference(self.filter, engine, data, sentinel, watched))
            ),
            "",
        )
        due = due or result.fresh
        path = changed(self._watch.holds, model_contents(self.filter)) if due or why else ""
        if not why and not path:
            if due:
                self._left = COMPARE_ALL
            return engine, result
        self._cache = StepCache()
        if not fresh:  # the stored records may be outdated
            return self._run_and_compare(prior, data, epochs, keep, every)
        raise _has_memory(self._watch.holds, path) if path else _differs(self._watch.holds, why)

    def _engine(self, prior: Any, data: Data) -> Engine:
        """The engine that records and compiles steps for priors and epochs with this signature."""
        key, engines = signature(prior, data), self._cache.engines
        if key not in engines:
            for oldest in [*engines][: 1 - MOST_CACHED]:
                engines.pop(oldest, None)
            rolled = self.engine != "cuda"
            engines[key] = Engine(self.filter, prior, data, self._cache, rolled=rolled)
        engine = copy(engines[key])  # with the data of this run
        engine.most = self.limit(len(data.distinct))
        return engine

    def start(self, prior: Any) -> Any:
        """The state of the original filter before the first epoch."""
        if isinstance(self.filter, FixedLag):
            raise ValueError(
                "filter: expected one that keeps no epochs; of celnav.compiled(filter) "
                "FixedLag(celnav.compiled(filter), lag) keeps them"
            )
        return self.filter.start(prior)

    def step(self, state: Any, epoch: Epoch) -> Stepped:
        """State after an epoch, and an `Info` of each sensor with an equal part of the
        log-likelihood.

        The first step of each kind is recorded and compiled. Numpy repeats it for comparison, and
        also the fourth step after it, the 16th, and so on, finally each 4096th; and the next step
        if the contents of the models have changed. If a run fails in a step, numpy repeats the
        step.

        >>> fast = celnav.compiled(filter)
        >>> state, infos = fast.step(fast.start(prior), celnav.Epoch(t=0.0, z=z[0]))
        """
        if state.belief[0].dtype.hasobject:  # the step is being recorded, inside another filter
            return self.filter.step(state, epoch)  # type: ignore[no-any-return]
        plans = self._local.__dict__
        key, numbers = plan_key(state, epoch)
        plan: Plan = plans.get(key) or self._planned(key, state, epoch)
        result = plan.step(state, epoch, numbers)
        if result is None:
            return self.filter.step(state, epoch)  # type: ignore[no-any-return]
        plan.left -= 1
        if plan.left < 0 or not plan.watch.is_still():
            result = self._compared(plan, state, epoch, result)
        return result

    def _planned(self, key: Any, state: Any, epoch: Epoch) -> Plan:
        """A plan for steps of a signature, for this thread."""
        with self._lock:
            holds = model_contents(self.filter)
            undo, again = restorer(self.filter), lambda: self.filter.step(state, epoch)
            with recording(holds, again, undo):
                # numpy runs first: values that models store at their first call must be floats.
                self.filter.step(state, epoch)
                plan = Plan(self.filter, state, epoch, self.limit(1))
        self._local.__dict__[key] = plan
        return plan

    def _compared(self, plan: Plan, state: Any, epoch: Epoch, result: Stepped) -> Stepped:
        """The result of a step if numpy agrees; recorded and computed again if the contents of the
        models have changed.
        """
        if changed(plan.watch.holds, model_contents(self.filter)):
            self._local.__dict__.clear()
            return self.step(state, epoch)
        *tally, failed = np.moveaxis(plan.tally, -1, 0)
        if (failed >= 0.0).any():  # the numbers of a failed run cannot be compared
            return result
        try:
            name = different_quantity(self.filter, state, epoch, result[0], tally)
            why = f"step {epoch.k}: another {name}" if name else ""
        except Exception as error:
            why = f"step {epoch.k}: numpy raises {type(error).__name__}: {error}"
        path = changed(plan.watch.holds, model_contents(self.filter))
        if path or why:
            self._local.__dict__.clear()
            raise _has_memory(plan.watch.holds, path) if path else _differs(plan.watch.holds, why)
        if not plan.watch.is_still():  # other objects with equal values
            plan.watch = Watch(self.filter)
        plan.interval = min(GROWTH * plan.interval, COMPARE_ONE)
        plan.left = plan.interval - 1
        return result

    def _rerun_failed(
        self,
        track: Track,
        engine: Engine,
        prior: Any,
        data: Data,
        failed: Array,
        *,
        on_failure: str,
        **options: Any,
    ) -> Track:
        """The track, with the failed runs run again by the numpy engine."""
        filter, run_prior, epochs = _of(self.filter, prior, data, engine.batch, failed)
        if not engine.batch:
            return replace(
                run(filter, run_prior, epochs, on_failure=on_failure, engine="numpy", **options),
                engine=self.engine,
            )
        again = run(filter, run_prior, epochs, on_failure="flag", engine="numpy", **options)
        still = np.flatnonzero(again.failed_at >= 0)
        if len(still) and on_failure == "raise":
            first = failed[still[np.argmin(again.failed_at[still])]]
            try:
                run(*_of(self.filter, prior, data, engine.batch, [first]), engine="numpy")
            except FilterError as error:
                at = tuple(int(i) for i in np.unravel_index(first, engine.batch))
                raise FilterError(str(error).replace("run (0,)", f"run {at}", 1)) from None
        for name in ("mean", "std", "innovation", "whitened", "used"):
            if (rows := getattr(track, name)) is not None:
                rows.reshape(len(rows), -1, rows.shape[-1])[:, failed] = getattr(again, name)
        if (R := track.extra.get("R")) is not None:
            R.reshape(len(R), -1, R.shape[-1])[:, failed] = again.extra["R"]
        if track.belief is not None and again.belief is not None:
            n = track.belief[1].shape[-1]
            track.belief[1].reshape(len(track.times), -1, n, n)[:, failed] = again.belief[1]
        for values, rerun_values in (
            (track.failed_at, again.failed_at),
            (track.log_likelihood, again.log_likelihood),
            *((track.events[name], again.events[name]) for name in track.events),
        ):
            values.reshape(-1)[failed] = rerun_values
        return track


@contextmanager
def recording(
    holds: dict[str, Any], by_numpy: Callable[[], Any], restore: Callable[[], None]
) -> Iterator[None]:
    """Raise the error of a recording as numpy raises it; if numpy raises none, as `CannotCompile`.

    holds: the contents of the models. restore: a function that undoes the recording's changes to
        the models, so that numpy starts from the same contents.
    """
    try:
        yield
    except CannotCompile as error:
        restore()
        if not error.somewhere:
            raise
        raise CannotCompile(f"{error}{functions_of(holds)}") from error
    except (CudaError, ImportError):
        raise
    except Exception as error:
        restore()
        by_numpy()  # raises the error, if numpy fails too
        restore()
        frames = reversed(traceback.extract_tb(error.__traceback__))
        place = place_of([(frame.filename, frame.lineno or 0) for frame in frames])
        if not place and "expected" in str(error):
            raise CannotCompile(str(error)) from error
        raise CannotCompile(
            f"{type(error).__name__} where a step is recorded: its numbers are arrays for "
            "numpy's functions only; put a table into u, choose by numpy.where, or use "
            f"engine='numpy'{place or functions_of(holds)}"
        ) from error


def _has_memory(holds: dict[str, Any], path: str) -> CannotCompile:
    """The error for a model that changes its contents at a path."""
    return CannotCompile(
        f"the model has a memory: {path} changes when it is called; put what changes with "
        f"time into the input u, or use engine='numpy'{functions_of(holds, path)}"
    )


def _differs(holds: dict[str, Any], why: str) -> CannotCompile:
    """The error for a model that differs from its record."""
    return CannotCompile(f"{OTHER} ({why}): {LOOKS}{functions_of(holds)}")


def _track(
    engine: Engine, data: Data, result: CompiledRun, every: int, about: dict[str, Any]
) -> Track:
    """The track of a run."""
    rows = {name: x.reshape(len(x), *engine.batch, x.shape[-1]) for name, x in result.rows.items()}
    sensors = [i for i, m in enumerate(engine.innovations) if m]

    def joined(name: str) -> Any:
        parts = [rows[f"{name}/{i}"] for i in sensors if f"{name}/{i}" in rows]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, -1) if parts else None

    belief = None
    if "cov" in rows:
        n = rows["std"].shape[-1]
        belief = engine.form(rows["mean"], rows["cov"].reshape(*rows["cov"].shape[:-1], n, n))
    likelihood, missing, rejected, redone, failed = (
        x.reshape(engine.batch) for x in result.tally.T.copy()
    )
    counts = np.bincount(data.kinds, minlength=len(data.distinct))
    silent = sum(
        int(count) * m
        for count, kind in zip(counts, data.distinct, strict=True)
        for m, status in zip(engine.innovations, kind.z, strict=True)
        if status == NONE
    )
    sensor_rows = [[rows[name] for name in rows if name.endswith(f"/{i}")] for i in sensors]
    widths = tuple(columns[0].shape[-1] for columns in sensor_rows if columns)
    return Track(
        times=data.t[::every].copy(),
        mean=rows.get("mean"),  # type: ignore[arg-type]
        std=rows.get("std"),  # type: ignore[arg-type]
        belief=belief,
        innovation=joined("innovation"),
        whitened=joined("whitened"),
        extra={} if (R := joined("R")) is None else {"R": R},
        used=joined("used"),
        log_likelihood=likelihood,
        events={
            "missing": missing.astype(int) + silent,
            "rejected": rejected.astype(int),
            "redone": redone.astype(int),
        },
        failed_at=failed.astype(int),
        sensors=widths,
        **about,
    )


def _of(
    filter: Any, prior: Any, data: Data, batch: tuple[int, ...], runs: Any, count: int | None = None
) -> tuple[Any, Any, Any]:
    """Filter, prior and the first ``count`` epochs (None: all) for some runs, or for one; runs are
    numbered over all batch axes.
    """

    select = partial(runs_of, batch=batch, runs=runs)
    # Shared matrices remain shared, because the root of a singular covariance depends on how it is
    # computed.
    mean = prior.mean if prior.mean.ndim == 1 else select(prior.mean, 1)
    form = Covariance if isinstance(prior, Covariance) else SquareRoot
    factor = form.of(prior)[1]
    run_prior = form(mean, factor if factor.ndim == 2 else select(factor, 2))
    epochs = [epoch_of(data, i, select, batch) for i in range(len(data.kinds))[:count]]
    return map_run_constants(filter, lambda x: select(x, 2)), run_prior, epochs


def compiled(filter: Any, *, jobs: int = 1, engine: str = "compiled") -> Compiled:
    """A filter as machine code, compiled when it first runs; needs
    ``.venv/bin/pip install -c constraints.txt -e ".[compiled]"``.

    filter: from `celnav.ukf` or another sigma-point filter, `celnav.colored`, `augmented`,
        `two_stage` or `imm`. Its models are recorded unchanged if they consist of arithmetic and
        numpy functions. Code that needs the value of a number, an ``if`` or a ``float(x)``, cannot
        be recorded: `CannotCompile` names the line.
    jobs: number of threads; it does not change the result, not even in the last bit.
    engine: "compiled" for this processor; "cuda" for an NVIDIA device (compute capability 7.0 or
        higher), with a run in each of its threads, while ``jobs`` threads arrange and copy data.
        RuntimeError names what is missing, or the driver call that failed.

    >>> track = celnav.compiled(celnav.ukf(motion, gps)).run(prior, times, z)
    """
    choice("engine", engine, ("compiled", "cuda"))
    return Compiled(
        filter, integer("jobs", jobs), engine, MOST if engine == "compiled" else MOST_AUTO
    )


def resolve_engine(engine: str, filter: Any, jobs: int, prior: Any, epochs: Any) -> Compiled:
    """A filter with an engine; "auto" raises `CannotCompile` if numpy takes less time. Compiled
    code is stored.

    A filter that runs repeatedly is compiled as soon as its runs together repay the compilation. A
    device is used only on request.
    """
    if isinstance(filter, Compiled):
        return filter
    if engine != "auto":
        return _cached(filter, engine, jobs, MOST if engine == "compiled" else MOST_AUTO)
    if find_spec("llvmlite") is None:
        raise CannotCompile("llvmlite is not installed")
    previous = _CACHE.get((id(filter), "compiled", jobs))
    if previous is not None and previous.recorded:
        return previous
    if not (hasattr(prior, "mean") and hasattr(prior, "cov")):
        raise CannotCompile("the prior has no mean and covariance")
    steps, (runs, measured) = len(epochs), _sizes(prior, epochs)
    shared = runs > 1 and prior.cov.ndim == 2 and _by_matrices(filter)
    work = np.array([steps, steps * runs * (SHARED if shared else 1.0)])
    expected = REPEATED.get()
    work = work * expected if expected else _added(filter, work)
    most: Callable[[int], int] = partial(operation_limit, *work.tolist())
    sizes = np.square([prior.cov.shape[-1], measured])
    if sizes @ EXPECTED_OPERATIONS > most(USUAL_KINDS):
        times = f"{steps} steps of " + ("one run" if runs == 1 else f"{runs} runs")
        raise CannotCompile(f"{times} take less time than compiling one")
    return _cached(filter, "compiled", jobs, most)


_WORK: WeakKeyDictionary[Any, Array] = WeakKeyDictionary()
"""For each filter, the number of epochs, and of epochs times runs, in all its runs so far."""


def _added(filter: Any, work: Array) -> Array:
    """The work of all runs of a filter so far, the present run included; the same amount is
    expected to follow.
    """
    try:
        total: Array = _WORK.get(filter, 0.0) + work
        _WORK[filter] = total
    except TypeError:  # this filter is not hashable
        return work
    return total


def operation_limit(steps: float, run_steps: float, kinds: int) -> int:
    """The largest number of operations of a step for which compiling saves time.

    steps: number of epochs. run_steps: epochs times runs. kinds: number of kinds of epochs, each of
        which is recorded and compiled separately.
    """
    left = max(kinds, USUAL_KINDS) * COMPILE_OPERATION_S - run_steps * OPERATION_S
    return MOST_AUTO if left <= 0.0 else int(min(MOST_AUTO, steps * STEP_S / left))


def _sizes(prior: Any, epochs: Any) -> tuple[int, int]:
    """Numbers of runs and of measured components, from the prior and the last epoch."""
    z = getattr(epochs[-1], "z", None) if len(epochs) else None
    shapes = [np.shape(x) for x in (z if isinstance(z, tuple) else (z,)) if x is not None]
    try:
        parts = (shape[:-1] for shape in shapes)
        runs = math.prod(np.broadcast_shapes(np.shape(prior.mean)[:-1], *parts))
    except ValueError:  # the engine raises the error for axes that do not broadcast
        runs = 1
    return runs, sum(shape[-1] for shape in shapes if shape)


def _by_matrices(filter: Any) -> bool:
    """Whether all models are matrices."""
    return isinstance(filter, Sequential) and all(
        by_matrix(model, filter.rule) for model in (filter.motion, *filter.sensors)
    )


def _equal(filter: Any, engine: str) -> Compiled | None:
    """The last stored filter whose models have equal contents, such as a filter from an earlier
    unit of work.
    """
    candidates = [
        x for x in _CACHE.values() if x.engine == engine and type(x.filter) is type(filter)
    ]
    holds = model_contents(filter) if candidates else {}
    return next((other for other in reversed(candidates) if other.holds(holds)), None)


def _cached(filter: Any, engine: str, jobs: int, most: int | Callable[[int], int]) -> Compiled:
    """The filter as machine code, with the records of the same object or of an equal filter.

    Only records are shared: whether a run is compiled must not depend on other filters.
    """
    with _CACHE_LOCK:
        previous = _CACHE.pop((id(filter), engine, jobs), None)
        fast: Compiled = previous or compiled(filter, jobs=jobs, engine=engine)
        if isinstance(most, int) or not fast.recorded:
            fast.most = most
        if not fast.recorded and (other := _equal(filter, engine)) is not None:
            fast.adopt(other)
        _CACHE[id(filter), engine, fast.jobs] = fast  # the most recently used last
        while len(_CACHE) > MOST_CACHED:
            del _CACHE[next(iter(_CACHE))]
    return fast


_CACHE_LOCK = Lock()
_CACHE: dict[tuple[int, str, int], Compiled] = {}
"""Filters by their addresses, which remain valid while this dictionary refers to the filters."""


def _listed(filter: Any, prior: Any, epochs: Any) -> Epochs | list[Epoch]:
    """Epochs as a sequence that can be iterated twice; for other objects
    numpy's error is raised.
    """
    if (
        not isinstance(epochs, Epochs)
        and not hasattr(epochs, "__iter__")
        and not hasattr(epochs, "__getitem__")
    ):
        run(filter, prior, epochs, engine="numpy")
    return epochs if isinstance(epochs, Epochs) else list(epochs)


def run_by(
    engine: str,
    filter: Any,
    prior: Any,
    epochs: Any,
    jobs: int,
    also: Any,
    reduce: Any,
    **options: Any,
) -> Track:
    """`celnav.run` with engine "compiled", "cuda" or "auto"; "auto" uses numpy if the filter cannot
    be compiled.
    """
    by_numpy: Callable[..., Track] = partial(
        run, also=also, reduce=reduce, engine="numpy", **options
    )
    alone = engine == "auto" and not isinstance(filter, Compiled)
    if alone and not isinstance(epochs, Epochs | list | tuple):  # a stream, which may be endless
        return replace(by_numpy(filter, prior, epochs), engine="numpy: a stream of epochs")
    epochs = _listed(filter, prior, epochs)
    try:
        if also is not None or reduce is not None:
            raise CannotCompile(
                f"also, reduce: expected none with engine={engine!r}, which keeps no states "
                "between epochs"
            )
        return resolve_engine(engine, filter, jobs, prior, epochs).run(prior, epochs, **options)
    except (CannotCompile, ImportError) as error:
        if engine != "auto":
            raise
        inner = filter.filter if isinstance(filter, Compiled) else filter
        return replace(by_numpy(inner, prior, epochs), engine=f"numpy: {error}")


def steps_by(
    engine: str, filter: Any, prior: Any, epochs: Iterable[Epoch]
) -> Iterable[tuple[Epoch, State, tuple[Info, ...]]]:
    """`celnav.steps` with engine "compiled", "cuda" or "auto". If a run fails, numpy repeats the
    steps to explain the failure. An `Info` covers all sensors together.
    """
    epochs = _listed(filter, prior, epochs)
    try:
        fast = resolve_engine(engine, filter, 1, prior, epochs)
        track = fast.run(prior, epochs, keep="cov", on_failure="flag")
    except (CannotCompile, ImportError):
        if engine != "auto":
            raise
        return steps(filter, prior, epochs)
    if track.belief is None or (track.failed_at >= 0).any():
        return steps(filter, prior, epochs)
    form, whitened = type(track.belief), track.whitened
    infos = (
        [Info()] * len(epochs)
        if whitened is None
        else map(Info, track.innovation, whitened, track.used)
    )
    rows = zip(epochs, *track.belief, infos, strict=True)
    return ((epoch, State(form(mean, factor)), (info,)) for epoch, mean, factor, info in rows)
