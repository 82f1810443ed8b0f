"""The log-likelihood of data and its gradient with respect to parameters of a filter, from one run
of the compiled step.

The prior, and the arrays of the filter that depend on the parameters, become part of the state
before the first epoch. Their derivatives are numerical differences, which need no run. The compiled
step propagates these derivatives by the chain rule.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from types import FunctionType
from typing import Any

import numpy as np

from celnav.engine.recording import (
    COUNTERS,
    Data,
    Engine,
    EpochKind,
    Recorded,
    Shape,
    Start,
    StepCache,
    map_constants,
)
from celnav.engine.runs import as_data, run_compiled
from celnav.filters.records import Epoch, Epochs
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import AnyDimension
from celnav.tape.derivative import with_slopes
from celnav.tape.kernel import digest
from celnav.tape.tape import CannotCompile

STEP = 1e-3
"""Step of the fourth-order differences of arrays: round-off and truncation are below 1e-12."""
SMOOTH = 1e-3  # largest difference of derivatives from steps h and 2 h, relative to the largest
COMPILE_S, CALL_S, OPERATION_S = 3e-4, 3e-4, 1.4e-9
"""About how long compiling takes per operation of a step, and numpy per step and per operation of
it in one run; s.
"""
Build = Callable[[Array], tuple[Any, Any]]


class Gradient:
    """Log-likelihood and gradient as functions of parameters ``(d,)``, from which ``build`` makes a
    filter and a prior.

    Compiled code is stored. At other parameters the step is recorded again and must be the same,
    operation by operation, unless the models are provably the same functions of the same numbers.

    flights: how many runs of the numpy engine one evaluation replaces; `CannotCompile` if compiling
        takes longer than these runs.
    """

    def __init__(self, build: Build, epochs: Epochs | Sequence[Epoch], flights: float = np.inf):
        self.build, self.epochs, self.flights = build, epochs, flights
        self.cache = StepCache()
        self.recorded: list[tuple[Shape, EpochKind, Any, bytes]] = []
        self.seeds = np.zeros(0, bool)
        self.first: Any = None

    def __call__(self, x: Array, lengths: Array) -> tuple[Array, Array]:
        """Log-likelihood ``(...)`` of each run, nan if it fails, and its gradient ``(..., d)``.

        lengths: ``(d,)``, changes of the parameters over which the arrays of the filter are smooth;
            the differences use a thousandth of each. `CannotCompile` if a model cannot be recorded,
            or depends on the parameters other than through matrices of the filter. ImportError if
            the compiler is not installed.
        """
        built, neighbors = (
            self.build(x),
            [
                [self.build(x + j * STEP * axis) for j in (-2, -1, 1, 2)]
                for axis in np.diag(lengths)
            ],
        )
        # Arrays that change with the parameters become part of the state, whose numbers have
        # derivatives.
        varying = _varying([built[0], *(filter for four in neighbors for filter, _ in four)])
        data = as_data(built[0], self.epochs)
        starts = [[_start(variant, varying, data) for variant in four] for four in neighbors]
        # A second filter at other parameters shows whether the step depends on them in another way.
        other, _ = self.build(x + STEP * lengths * np.linspace(0.5, 1.0, len(x)))
        engine, twin = (
            _WithGradient((_lifted(filter, varying), built[1]), data, self.cache)
            for filter in (built[0], other)
        )
        engine.twin, engine.flight_steps = twin, self.flights * len(data.k)
        # The derivative of the state before the first epoch to each parameter, by differences.
        slopes = [
            fourth_order(four, STEP, SMOOTH) / length
            for four, length in zip(starts, lengths, strict=True)
        ]
        seeds = np.any(slopes, (0, 1))
        # An array that had no derivative may have one now.
        if len(seeds) != len(self.seeds) or (seeds & ~self.seeds).any():
            self.seeds, self.cache, engine.cache, self.recorded = (
                seeds,
                StepCache(),
                StepCache(),
                [],
            )
        engine.seeds = set(np.flatnonzero(self.seeds).tolist())
        for record in () if same_program(self.first, built[0]) else self.recorded:
            engine.check(engine, *record)
        tallies = []
        # One run for each parameter: they differ in the derivatives of the state before the first
        # epoch.
        for engine.slopes in slopes:
            tallies.append(
                run_compiled(engine, built[1], data, (), 1, 1).tally.reshape(-1, len(COUNTERS), 2)
            )
        self.cache, self.recorded, self.first = (
            engine.cache,
            self.recorded + engine.recorded,
            self.first or built[0],
        )
        lost = tallies[0][:, COUNTERS.index("failed_at"), 0] >= 0.0
        batch = Engine(*built, data).batch  # without the axis that lifting adds
        gradient = np.stack([tally[:, 0, 1] for tally in tallies], -1)
        return np.where(lost, np.nan, tallies[0][:, 0, 0]).reshape(batch), gradient.reshape(
            *batch, len(x)
        )


class _WithGradient(Engine):
    """An engine whose state has the derivative after each number; ``slopes (runs, numbers)`` are
    the derivatives before the first epoch.
    """

    stride = 2
    slopes: Array
    seeds: set[int]
    twin: _WithGradient
    flight_steps: float

    def __init__(self, built: tuple[Any, Any], data: Data, cache: StepCache):
        super().__init__(*built, data, cache, rolled=False)
        self.recorded: list[tuple[Shape, EpochKind, Any, bytes]] = []

    def columns(self) -> dict[str, int]:
        return {}

    def start(self, prior: Any) -> Start:
        start = super().start(prior)
        # Number i of the state is at 2 i, its derivative at 2 i + 1.
        both = np.stack(np.broadcast_arrays(start.numbers, self.slopes), -1)
        return start._replace(parts=[both.reshape(self.runs, -1)])

    def plain(
        self, before: Shape, kind: EpochKind, u: list[tuple[Array, bool]]
    ) -> tuple[Recorded, bytes]:
        """The step without derivatives, and its digest."""
        recorded = super().record(before, kind, u)
        return recorded, digest(recorded.kernel)

    def check(
        self,
        engine: _WithGradient,
        before: Shape,
        kind: EpochKind,
        u: list[tuple[Array, bool]],
        expected: bytes,
    ) -> None:
        """Raise `CannotCompile` if another filter's step is not the same."""
        if engine.plain(before, kind, u)[1] != expected:
            raise CannotCompile(
                "a model uses the parameters elsewhere than in matrices of the filter"
            )

    def record(self, before: Shape, kind: EpochKind, u: list[tuple[Array, bool]]) -> Recorded:
        recorded, step_digest = self.plain(before, kind, u)
        self.check(self.twin, before, kind, u, step_digest)
        size = len(recorded.kernel.tape.ops)
        # Compiling is worthwhile if it takes less time than the numpy runs that it replaces.
        if COMPILE_S * size > self.flight_steps * (
            CALL_S + OPERATION_S * size * float(np.prod(self.batch))
        ):
            raise CannotCompile(
                f"a step of {size} operations takes longer to compile than it saves"
            )
        self.recorded.append((before, kind, u, step_digest))
        seeds = {
            0,
            *(at for at in range(self.state_offset) if at in self.seeds),
            *range(self.state_offset, self.state_offset + before.size),
        }
        return recorded._replace(kernel=with_slopes(recorded.kernel, seeds))


def _arrays(filter: Any) -> list[Array]:
    arrays: list[Array] = []

    def collect(array: Array) -> Array:
        arrays.append(array)
        return array

    map_constants(filter, collect)
    return arrays


def _varying(filters: Sequence[Any]) -> set[int]:
    """For each array of the filters, in order, whether it differs between them."""
    first, *others = map(_arrays, filters)
    if any([x.shape for x in other] != [x.shape for x in first] for other in others):
        raise CannotCompile("the filter's arrays change their shapes with the parameters")
    return {
        i
        for other in others
        for i, (x, y) in enumerate(zip(first, other, strict=True))
        if not np.array_equal(x, y)
    }


def _lifted(filter: Any, varying: set[int]) -> Any:
    """The filter, with its varying matrices given an axis of runs."""
    count = iter(range(10**6))
    return map_constants(filter, lambda x: x[None] if next(count) in varying and x.ndim == 2 else x)


def _start(built: tuple[Any, Any], varying: set[int], data: Any) -> Array:
    """The state before the first epoch ``(runs, numbers)``, the filter's matrices first."""
    return Engine(_lifted(built[0], varying), built[1], data).start(built[1]).numbers


def same_program(a: Any, b: Any, matrices: bool = True) -> bool:
    """Whether parts of two filters are provably the same program: the same data, except the
    filters' ``matrices``, and functions with the same code and the same values in their closures.
    """
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and ((matrices and a.ndim > 1) or np.array_equal(a, b))
    if isinstance(a, str | float | int):
        return bool(a == b)
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(
            same_program(x, y, matrices) for x, y in zip(a, b, strict=True)
        )
    if isinstance(a, dict):
        return list(a) == list(b) and all(same_program(a[name], b[name], matrices) for name in a)
    if isinstance(a, partial):
        return same_program((a.func, a.args, a.keywords), (b.func, b.args, b.keywords), matrices)
    # Functions with the same code are the same if their closures are.
    if isinstance(a, FunctionType):
        x, y = (
            [f.__defaults__, f.__kwdefaults__, [cell.cell_contents for cell in f.__closure__ or ()]]
            for f in (a, b)
        )
        return a.__code__ is b.__code__ and same_program(x, y, matrices=False)
    names = (
        ["make"]
        if isinstance(a, AnyDimension)
        else [field.name for field in fields(a)]
        if is_dataclass(a)
        else []
    )
    return bool(names) and all(
        same_program(getattr(a, name), getattr(b, name), matrices) for name in names
    )


def fourth_order(values: Sequence[Array], step: float, smooth: float | None = None) -> Array:
    """The derivative from values at -2, -1, 1 and 2 steps; `CannotCompile` if the derivatives from
    one step and from two steps differ by more than `SMOOTH`.
    """
    # Central differences D(h) and D(2 h); (4 D(h) - D(2 h)) / 3 cancels the error of order h^2.
    far, near = (values[3] - values[0]) / (4.0 * step), (values[2] - values[1]) / (2.0 * step)
    if (
        smooth
        and not np.abs(far - near).max()
        <= smooth * np.abs(near).max() + 1e-9 * np.abs(values[0]).max()
    ):
        raise CannotCompile(
            "matrices of the filter, or the prior, do not change smoothly with the parameters"
        )
    return np.asarray((4.0 * near - far) / 3.0)
