"""Number of operations of a filter's step, counted on its recording, whatever the engine and the
machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from celnav.engine.recording import Engine
from celnav.engine.runs import as_data
from celnav.filters.records import Epoch, Filter
from celnav.filters.track import KEEP
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array


def step_operations(filter: Filter, prior: Gaussian, epochs: Sequence[Epoch]) -> int:
    """Number of arithmetic operations of a step (prediction and update) of one run, at the second
    epoch.

    >>> count = celnav.study.operations.step_operations(filter, prior, epochs)
    """
    data = as_data(filter, epochs)
    engine, kind = Engine(filter, prior, data, rolled=False), data.distinct[data.kinds[1]]
    inputs, shape = engine.inputs(data.u[kind.u], len(epochs)), engine.begin
    for _ in range(2):  # only after the first step does a state have all its parts
        made = engine.record(shape, kind, inputs)
        kernel, shape = made.keeping(engine.keeping(KEEP["mean"])), made.after
    needed = kernel.tape.needed([number for *_, number in kernel.results()])
    return sum(kernel.tape.ops[i][0] not in ("in", "const") for i in needed)


def counted(
    filters: Mapping[str, Filter], prior: Gaussian, epochs: Iterable[Epoch]
) -> dict[str, Array]:
    """`step_operations` of filters by name, each ``(1,)``, as arrays for a study's part.

    >>> arrays = celnav.study.operations.counted({"ukf": filter}, prior, epochs)
    """
    listed = list(epochs)
    return {
        name: np.array([step_operations(filter, prior, listed)]) for name, filter in filters.items()
    }
