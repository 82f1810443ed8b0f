"""A filter as C: `export_c` writes its step as one file for flight software."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from celnav.engine.recording import COUNTERS, PART, Engine, EpochKind, Shape, entries
from celnav.engine.runs import as_data, sensors
from celnav.files import write_text
from celnav.filters.model import check_prior
from celnav.filters.records import Epoch
from celnav.filters.track import KEEP
from celnav.gaussian.checks import integers, number
from celnav.tape import c
from celnav.tape.tape import CannotCompile

__all__ = ["export_c"]


def export_c(
    filter: Any,
    path: str | Path,
    prior: Any,
    *,
    u: Any = None,
    m: Sequence[int] | None = None,
    dt: float | None = None,
    name: str = "filter",
) -> None:
    """Write a filter's step as one C99 file without allocations, loops, branches or libraries
    except ``math.h``.

    filter: as for `celnav.compiled`. path: the file to write. prior: for one run; it becomes
        ``<name>_start``.
    u: an example of the input, if the models use one. m: number of components of each measurement,
        if the sensors' R does not determine it.
    dt: length of every interval, s; None: ``<name>_step`` has it as an argument. name: prefix of
        the function names.

    The functions are ``<name>_start(state)``, ``<name>_first(state, in, z, out)`` for a measurement
    at the time of the prior, and ``<name>_step(state, in, z, out)`` for the end of an interval. The
    head of the file lists sizes and orders. A component of ``z`` is nan if it was not measured. The
    state is nan after a failure. ValueError names an invalid argument, and `CannotCompile` the line
    of a model that cannot be recorded.

    >>> celnav.export_c(celnav.ukf(motion, gps), "filter.c", celnav.Gaussian(x0, P0), dt=1.0)
    """
    if not re.fullmatch(r"[A-Za-z_]\w*", name):
        raise ValueError(f"name: expected an identifier of C, got {name!r:.80}")
    check_prior(prior)
    if np.ndim(prior.mean) != 1:
        raise ValueError(
            f"prior: expected the prior of one run with mean (N,), got {np.shape(prior.mean)}"
        )
    every = None if dt is None else number("dt", dt, above=0.0)
    z_sensors = sensors(filter)
    widths = (
        [sensor.m for sensor in z_sensors]
        if m is None
        else list(integers("m", m, 1, count=len(z_sensors)))
    )
    if None in widths:
        raise ValueError(
            f"m: expected the length of each of {len(z_sensors)} measurements, which R does not say"
        )
    z = tuple(np.zeros(int(width or 0)) for width in widths)
    data = as_data(
        filter, [Epoch(0, 0.0, 0.0, None, z), Epoch(1, every or 1.0, every or 1.0, u, z)]
    )
    engine = Engine(filter, prior, data, rolled=False)
    names = engine.keeping(KEEP["std"])
    engine.dt = every
    inputs = {shape: engine.inputs(group, 2) for shape, group in data.u.items()}
    # Any component may be missing: one function serves all epochs.
    kinds = (PART,) * len(z_sensors)
    before, moving = (
        EpochKind(False, kinds, data.distinct[data.kinds[0]].u),
        EpochKind(True, kinds, data.distinct[data.kinds[1]].u),
    )
    first = engine.record(engine.begin, before, inputs[before.u])
    step = engine.record(first.after, moving, inputs[moving.u])
    if step.after != first.after:  # a step determines which entries may be nan
        step = engine.record(step.after, moving, inputs[moving.u])
        if [shape for shape, *_ in step.after.arrays] != [
            shape for shape, *_ in first.after.arrays
        ]:
            raise CannotCompile(
                "a memory that changes its shape after the first step cannot be exported"
            )
    size = engine.state_offset + max(
        shape.size for shape in (engine.begin, first.after, step.after)
    )
    count = 3 + sum(x[0].size for x, _ in inputs[moving.u])
    places = {"state": "state", "shared": "in", "own": "z", "rows": "out"}
    start = engine.start(prior).first
    sizes = {
        "STATE": size,
        "IN": count,
        "Z": sum(engine.widths),
        "OUT": sum(engine.columns()[name] for name in names),
    }
    text = [
        _head(name, engine, first.after, every),
        "#include <math.h>\n",
        *(f"#define {name.upper()}_{label} {number}" for label, number in sizes.items()),
        f"\nvoid {name}_start(double *state)\n{{",
        *(f"    state[{i}] = {x.hex()};" for i, x in enumerate(start.tolist())),
        *(f"    state[{i}] = 0.0;" for i in range(len(start), size)),
        "}\n",
        c.function(
            first.keeping(names),
            f"{name}_first",
            places,
            ["A measurement at the time of the prior."],
        ),
        c.function(
            step.keeping(names),
            f"{name}_step",
            places,
            ["An interval, and the measurement at its end."],
        ),
    ]
    write_text(Path(path), "\n".join(text))


def _head(name: str, engine: Engine, after: Shape, dt: float | None) -> str:
    """The comment at the head of the file: the meaning and position of each number."""
    lines = [f"A navigation filter in C99, recorded from celnav: {engine.filter!r}.", ""]
    lines.append(f"state[{name.upper()}_STATE], to be kept from call to call:")
    lines += [f"  {at}: {counter}" for at, counter in enumerate(COUNTERS)]
    at = engine.state_offset
    for shape, role, _ in after.arrays:
        size = len(entries(shape, role))
        kind = {"belief": "mean", "lower": "root of the covariance", "symmetric": "covariance"}.get(
            role, "memory"
        )
        order = ", lower triangle by rows" if role in ("lower", "symmetric") else ""
        lines.append(f"  {at} to {at + size - 1}: {kind} {'x'.join(map(str, shape))}{order}")
        at += size
    interval = (
        "not used: every interval is " + f"{dt:g} s"
        if dt is not None
        else "length of the interval, s"
    )
    lines += [
        f"in[{name.upper()}_IN]: index of the epoch, its time, {interval}; then the inputs u."
    ]
    lines += [
        f"z[{name.upper()}_Z]: the measurements of all sensors; nan is what was not measured.",
        f"out[{name.upper()}_OUT]:",
    ]
    at = 0
    for column in engine.keeping(KEEP["std"]):
        size = engine.columns()[column]
        lines.append(f"  {at} to {at + size - 1}: {column}")
        at += size
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in lines), " */"])
