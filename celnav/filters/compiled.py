"""A filter as machine code: `celnav.compiled`, and what ``celnav.run`` does with ``engine="compiled"`` or ``"cuda"``.

Runs that are lost are flown again by the numpy engine, which is the reference and knows why.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from celnav.filters.engine import NONE, Data, Engine, each_run, entries
from celnav.filters.flight import Flight, as_data, epoch_of, fly, part_of
from celnav.filters.records import Epoch, Epochs, FilterError, Info, State
from celnav.filters.run import as_epochs, run, steps
from celnav.filters.sentinels import changed, difference, functions_of, held, restorer
from celnav.filters.sequential import Sequential, measurements, plain
from celnav.filters.track import Track
from celnav.gaussian.checks import choice, integer
from celnav.gaussian.linalg import Array, Covariance, SquareRoot
from celnav.tape.cuda import CudaError, device
from celnav.tape.tape import MOST, CannotCompile, place_of

__all__ = ["Compiled", "chosen", "compiled", "run_by", "steps_by"]

WORTH = 50_000  # operations of a step, the most that engine="auto" compiles, in some five seconds, and a device takes
CHECKED = 3  # epochs of some runs that numpy takes before a step is recorded
OTHER = "the model gives other values when it is recorded"
LOOKS = "it depends on more than the numbers that it is given; engine='numpy' runs it as it is"


class Compiled:
    """A filter as machine code; what `celnav.compiled` makes.

    The steps that were recorded are kept. They are compared with numpy in every run, at some epochs
    and for some runs, and recorded anew where what the models hold has changed since, a global
    number say. A model that changes what it holds whenever it is called cannot be compiled.

    >>> fast = celnav.compiled(celnav.ukf(motion, gps), jobs=2)
    >>> track = fast.run(prior, times, z)
    """

    def __init__(self, filter: Any, jobs: int, engine: str, most: int):
        self.filter, self.jobs, self.engine, self._most = filter, jobs, engine, most
        self._kept, self._holds = dict[Any, Any](), dict[str, Any]()

    def __repr__(self) -> str:
        return f"Compiled({self.filter!r})"

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_kept": {}}  # addresses of machine code are of this process

    def run(
        self,
        prior: Any,
        times: Any,
        z: Any = None,
        u: Any = None,
        *,
        every: int = 1,
        keep: str = "std",
        on_failure: str = "raise",
    ) -> Track:
        """The track, as `celnav.run` gives it with these arguments."""
        choice("keep", keep, ("std", "cov", "mean", "nothing"))
        choice("on_failure", on_failure, ("raise", "flag"))
        every = integer("every", every)
        epochs = as_epochs(times, z, u)
        epochs = epochs if isinstance(epochs, Epochs) else list(epochs)
        return self._run(prior, epochs, True, every=every, keep=keep, on_failure=on_failure)

    def _run(self, prior: Any, epochs: Any, compare: bool, **options: Any) -> Track:
        """The track; ``compare``: with numpy also if no step is recorded."""
        every, keep = options["every"], options["keep"]
        some = epochs
        holds = held(self.filter)
        if changed(self._holds, holds):
            self._kept.clear()
        restore = restorer(self.filter)  # numpy is to find what the recording found
        try:
            data = as_data(self.filter, epochs)
            some = epochs[:CHECKED]
            engine, flight = self._flown(prior, data, some, keep, every, compare)
        except CannotCompile as error:
            restore()
            if not error.somewhere:
                raise
            raise CannotCompile(f"{error}{functions_of(holds)}") from error
        except (CudaError, ImportError):
            raise
        except Exception as error:
            restore()
            run(self.filter, prior, some, engine="numpy", **options)  # what is wrong there too
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
        stored = islice(epochs, 0, len(epochs) if keep == "cov" else 0, every)
        known = tuple(epoch._replace(z=None, truth=None) for epoch in stored)
        track = replace(
            _track(engine, data, flight, every),
            epochs=known,
            filter=self.filter,
            engine=self.engine,
        )
        if keep == "nothing":
            nothing: dict[str, Any] = dict.fromkeys(
                ("mean", "std", "innovation", "whitened", "used")
            )
            track = replace(track, **nothing, sensors=())
        lost = np.flatnonzero(track.failed_at.ravel() >= 0)
        if not len(lost):
            return track
        return self._again(track, engine, prior, data, lost, **options)

    def _flown(
        self, prior: Any, data: Data, some: Any, keep: str, every: int, compare: bool
    ) -> tuple[Engine, Flight]:
        """The flight, after numpy has taken the same steps at some epochs, or `CannotCompile`."""
        fresh = not self._kept
        rolled, on = self.engine != "cuda", device() if self.engine == "cuda" else None
        engine = Engine(self.filter, prior, data, keep, self._kept, most=self._most, rolled=rolled)
        count = int(np.prod(engine.batch))
        # On a device those of one chunk, which alone is taken through its epochs in pieces.
        watched = sorted({0, count // 2, count - 1}) if on is None else list(range(min(count, 3)))
        if fresh:  # numpy goes first: what models keep of their first call is then made of floats
            few = _of(self.filter, prior, data, engine.batch, watched, CHECKED)
            try:
                run(*few, on_failure="flag", engine="numpy")
            except Exception:  # it may hold arrays of all runs
                run(self.filter, prior, some, on_failure="flag", engine="numpy")
            self._holds = held(self.filter)
        flight = fly(engine, data, every, self.jobs, on, watched)
        if not (compare or engine.fresh):
            return engine, flight
        why = next(
            (
                f"step {int(data.k[one.at])}: {name}"
                for one in flight.sentinels
                if (name := difference(self.filter, engine, data, one, watched))
            ),
            "",
        )
        path = changed(self._holds, held(self.filter))
        if not why and not path:
            return engine, flight
        self._kept.clear()
        if not fresh:  # what was recorded then may not hold now
            return self._flown(prior, data, some, keep, every, compare)
        if path:
            raise CannotCompile(
                f"the model has a memory: {path} changes when it is called; put what changes with "
                f"time into the input u, or use engine='numpy'{functions_of(self._holds, path)}"
            )
        raise CannotCompile(f"{OTHER} ({why}): {LOOKS}{functions_of(self._holds)}")

    def start(self, prior: Any) -> Any:
        """The filter's own state before the first epoch; `step` is for those that predict, then update."""
        return plain("filter", self.filter).start(prior)

    def step(self, state: Any, epoch: Epoch) -> tuple[Any, tuple[Info, ...]]:
        """State after an epoch, and an `Info` of each sensor with an equal part of the likelihood. Hundreds of runs repay it.

        `CannotCompile` too where hooks remember something, or where a start adds to the prior, as that of `celnav.augmented` does.
        """
        if state.belief.mean.dtype.hasobject:  # recorded itself, as a part of another filter
            return self.filter.step(state, epoch)  # type: ignore[no-any-return]
        if type(self.filter).start is not Sequential.start:
            raise CannotCompile(
                "a filter that adds to its prior is compiled for whole flights only"
            )
        track = self._run(state.belief, [epoch], False, every=1, keep="cov", on_failure="flag")
        if any(len(made.after.arrays) > 2 for made in self._kept.values()):
            raise CannotCompile("hooks that remember something are compiled for whole flights only")
        share, rows = (
            track.log_likelihood / max(len(track.sensors), 1),
            (track.innovation, track.whitened, track.used),
        )
        seen = zip(
            *(np.split(x[0], np.cumsum(track.sensors), -1) for x in rows if x is not None),
            strict=True,
        )
        z = measurements(epoch.z, len(self.filter.sensors))
        infos = tuple(
            Info(silent=True) if one is None else Info(*next(seen))._replace(mixture=share)
            for one in z
        )
        assert track.belief is not None
        return state._replace(belief=type(track.belief)(*(x[0] for x in track.belief))), infos

    def _again(
        self,
        track: Track,
        engine: Engine,
        prior: Any,
        data: Data,
        lost: Array,
        *,
        on_failure: str,
        **options: Any,
    ) -> Track:
        """The track, with the runs that were lost flown by the numpy engine."""
        filter, own, epochs = _of(self.filter, prior, data, engine.batch, lost)
        if not engine.batch:
            return replace(
                run(filter, own, epochs, on_failure=on_failure, engine="numpy", **options),
                engine=self.engine,
            )
        again = run(filter, own, epochs, on_failure="flag", engine="numpy", **options)
        still = np.flatnonzero(again.failed_at >= 0)
        if len(still) and on_failure == "raise":
            first = lost[still[np.argmin(again.failed_at[still])]]
            try:
                run(*_of(self.filter, prior, data, engine.batch, [first]), engine="numpy")
            except FilterError as error:
                at = tuple(int(i) for i in np.unravel_index(first, engine.batch))
                raise FilterError(str(error).replace("run (0,)", f"run {at}", 1)) from None
        for name in ("mean", "std", "innovation", "whitened", "used"):
            if (rows := getattr(track, name)) is not None:
                rows.reshape(len(rows), -1, rows.shape[-1])[:, lost] = getattr(again, name)
        if track.belief is not None and again.belief is not None:
            n = track.belief[1].shape[-1]
            track.belief[1].reshape(len(track.times), -1, n, n)[:, lost] = again.belief[1]
        for mine, theirs in ((track.failed_at, again.failed_at), (track.log_likelihood, again.log_likelihood),
                             *((track.events[name], again.events[name]) for name in track.events)):  # fmt: skip
            mine.reshape(-1)[lost] = theirs
        return track


def _track(engine: Engine, data: Data, flight: Flight, every: int) -> Track:
    """The record of a flight."""
    rows = {name: x.reshape(len(x), *engine.batch, x.shape[-1]) for name, x in flight.rows.items()}
    sensors = [i for i, m in enumerate(engine.innovations) if m]

    def beside(name: str) -> Any:
        parts = [rows[f"{name}/{i}"] for i in sensors if f"{name}/{i}" in rows]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, -1) if parts else None

    belief = None
    if "spread" in rows:
        lower = rows["spread"]
        n = rows["std"].shape[-1]
        spread = np.zeros((*lower.shape[:-1], n, n))
        for k, (i, j) in enumerate(
            entries((n, n), "lower")
        ):  # one by one, which is several times as fast as all by their indices
            spread[..., i, j] = lower[..., k]
            if engine.form is Covariance:
                spread[..., j, i] = lower[..., k]
        belief = engine.form(rows["mean"], spread)
    likelihood, missing, rejected, redone, failed = (
        x.reshape(engine.batch) for x in flight.tally.T.copy()
    )
    often = np.bincount(data.kinds, minlength=len(data.known))
    silent = sum(int(count) * m for count, kind in zip(often, data.known, strict=True)
                 for m, what in zip(engine.innovations, kind.z, strict=True) if what == NONE)  # fmt: skip
    used = beside("used")
    return Track(
        times=data.t[::every].copy(),
        mean=rows.get("mean"),  # type: ignore[arg-type]
        std=rows.get("std"),  # type: ignore[arg-type]
        belief=belief,
        innovation=beside("innovation"),
        whitened=beside("whitened"),
        used=None if used is None else used != 0.0,  # type: ignore[arg-type]
        log_likelihood=likelihood,
        events={
            "missing": missing.astype(int) + silent,
            "rejected": rejected.astype(int),
            "redone": redone.astype(int),
        },
        failed_at=failed.astype(int),
        sensors=tuple(
            rows[f"innovation/{i}"].shape[-1] for i in sensors if f"innovation/{i}" in rows
        ),
    )


def _of(
    filter: Any, prior: Any, data: Data, batch: tuple[int, ...], runs: Any, count: int | None = None
) -> tuple[Any, Any, Any]:
    """Filter, prior and the first epochs, None: all, of some runs, numbered over all axes of a batch, or of one run alone."""

    part = partial(part_of, batch=batch, runs=runs)
    # What all runs share stays one: where a covariance is singular its root depends on how it is computed.
    mean = prior.mean if prior.mean.ndim == 1 else part(prior.mean, 1)
    form = Covariance if isinstance(prior, Covariance) else SquareRoot
    spread = form.of(prior)[1]
    some = form(mean, spread if spread.ndim == 2 else part(spread, 2))
    epochs = [epoch_of(data, i, part, batch) for i in range(len(data.kinds))[:count]]
    return each_run(filter, lambda x: part(x, 2)), some, epochs


def compiled(filter: Any, *, jobs: int = 1, engine: str = "compiled") -> Compiled:
    """A filter as machine code, compiled when it first runs; needs ``.venv/bin/pip install -c constraints.txt -e ".[compiled]"``.

    filter: of `celnav.ukf` and its siblings, `celnav.colored`, `augmented`, `two_stage`, `imm`. Its models are recorded as they
        are: arithmetic, and numpy's functions of it. What asks for the value of a number, an ``if`` or a ``float(x)``, cannot be:
        `CannotCompile` says which line.
    jobs: threads. The bytes of the result do not depend on them.
    engine: "compiled" for this processor; "cuda" for an NVIDIA device (compute capability 7.0 or higher), with a run in each of its
        threads, while ``jobs`` arrange and copy. RuntimeError says what is missing, or which call of the driver failed.

    >>> flown = celnav.compiled(celnav.ukf(motion, gps)).run(prior, times, z)
    """
    choice("engine", engine, ("compiled", "cuda"))
    return Compiled(filter, integer("jobs", jobs), engine, MOST if engine == "compiled" else WORTH)


def chosen(engine: str, filter: Any, jobs: int) -> Compiled:
    """By an engine; "auto" compiles what is worth it, and takes a device only where that is asked for. What is compiled stays."""
    if isinstance(filter, Compiled):
        return filter
    made = compiled(filter, jobs=jobs, engine="compiled" if engine == "auto" else engine)
    return Compiled(filter, made.jobs, made.engine, WORTH) if engine == "auto" else made


def _listed(filter: Any, prior: Any, epochs: Any) -> Epochs | list[Epoch]:
    """Epochs that can be gone through twice; what is none is told as the numpy engine does."""
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
    """`celnav.run` with an engine that is "compiled" or "cuda", or "auto": compiled, and numpy where that cannot be."""
    epochs, made = _listed(filter, prior, epochs), chosen(engine, filter, jobs)
    try:
        if also is not None or reduce is not None:
            raise CannotCompile(
                f"also, reduce: expected none with engine={made.engine!r}, which keeps no states between epochs"
            )
        return made.run(prior, epochs, **options)
    except (CannotCompile, ImportError) as error:
        if engine != "auto":
            raise
        track = run(made.filter, prior, epochs, also=also, reduce=reduce, engine="numpy", **options)
        return replace(track, engine=f"numpy: {error}")


def steps_by(
    engine: str, filter: Any, prior: Any, epochs: Iterable[Epoch]
) -> Iterable[tuple[Epoch, State, tuple[Info, ...]]]:
    """`celnav.steps` likewise; by numpy too where a run is lost, since why is to be told. An `Info` is of all sensors together."""
    epochs = _listed(filter, prior, epochs)
    try:
        track = chosen(engine, filter, 1).run(prior, epochs, keep="cov", on_failure="flag")
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
    return ((epoch, State(form(mean, spread)), (info,)) for epoch, mean, spread, info in rows)
