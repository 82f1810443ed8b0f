"""`merge` puts an inertial unit and other sensors, each with its own clock, on common epochs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from celnav.gaussian.checks import describe, finite, number, numbers
from celnav.gaussian.linalg import Array

__all__ = ["Merged", "merge"]

MOST_PERIODS = 5.0
"""The longest gap in the inputs, in periods; a longer gap is an error."""
SAME = 1e-6
"""Times closer than this, in periods, are treated as equal."""


class Merged(NamedTuple):
    """Arguments of `celnav.run` after filter and prior, see `celnav.epochs`.

    times: ``(T,)`` s. z: measurements ``(T, ..., m)``, or a tuple of such arrays in the order of
        the sensors; nan where a sensor has no sample.
    u: inputs ``(T - 1, ..., k)`` in the middle of each interval, or a tuple of such arrays.
    """

    times: Array
    z: Any
    u: Any


def merge(*, imu: Any, max_gap: float | None = None, trim: bool = False, **sensors: Any) -> Merged:
    """Common epochs of an inertial unit and of sensors with other clocks or rates.

    imu: ``(t, u)``: times ``(K,)`` s, increasing, and samples ``(K, ..., k)``, or a tuple of arrays
        such as ``(rate, force)``. They are interpolated linearly; the input of an interval is the
        value in its middle.
    max_gap: the longest interval between samples of the unit, s; None: 5 times their median.
    trim: whether to leave out measurements before the unit's first sample or after its last;
        otherwise they are an error.
    sensors: by name, each ``(t, z)``: times ``(K,)`` s, increasing, and measurements
        ``(K, ..., m)``. The filter's sensors have the same order.

    Returns `Merged`: the times of all samples, ``z`` and ``u``. Times closer than a millionth of
    the unit's period are treated as equal. ValueError names the argument that does not fit.

    >>> merged = celnav.merge(imu=(t, (rate, force)), fixes=(t_fix, z_fix))
    >>> track = celnav.run(filter, prior, *merged)
    """
    if not sensors:
        raise ValueError("sensors: expected at least one, such as fixes=(t, z), got none")
    t, inputs = _stream("imu", imu)
    if len(t) < 2:
        raise ValueError(f"imu: expected two samples or more, got {len(t)}")
    u = inputs if isinstance(inputs, tuple) else (inputs,)
    u = tuple(_column("imu", finite("imu", column), len(t)) for column in u)
    steps = np.diff(t)
    period = float(np.median(steps))
    longest = MOST_PERIODS * period if max_gap is None else number("max_gap", max_gap, above=0.0)
    if (steps > longest * (1.0 + SAME)).any():
        k = int(steps.argmax())
        raise ValueError(
            f"imu: expected samples at most {longest:g} s apart (their period is {period:g} s), "
            f"got none between t = {t[k]:g} and {t[k + 1]:g} s; max_gap={steps[k]:.6g} allows it"
        )
    streams = {}
    for name, stream in sensors.items():
        at, z = _stream(name, stream)
        z = _column(name, numbers(name, z), len(at))
        inside = (at >= t[0] - SAME * period) & (at <= t[-1] + SAME * period)
        if not inside.any() or not (trim or inside.all()):
            cure = "; trim=True leaves them out" if inside.any() else ""
            raise ValueError(
                f"{name}: expected times within those of the imu, {t[0]:g} to {t[-1]:g} s, got "
                f"{np.count_nonzero(~inside)} of {len(at)} that are not{cure}"
            )
        streams[name] = at[inside], z[inside]
    # Union of all times; times closer than SAME periods become one epoch. row: its index for each
    # time.
    every = np.unique(np.concatenate([t, *(at for at, _ in streams.values())]))
    new = np.diff(every, prepend=-np.inf) > SAME * period
    times, row = every[new], np.cumsum(new) - 1
    columns = []
    for name, (at, z) in streams.items():
        rows = row[np.searchsorted(every, at)]
        if not np.diff(rows, prepend=-1).all():
            raise ValueError(f"{name}: expected samples at least {SAME * period:g} s apart")
        column = np.full((len(times), *z.shape[1:]), np.nan)
        column[rows] = z
        columns.append(column)
    # Input of an interval: linear interpolation of the samples at its middle.
    middle = 0.5 * (times[1:] + times[:-1])
    before = np.clip(np.searchsorted(t, middle, "right") - 1, 0, len(t) - 2)
    weight = (middle - t[before]) / steps[before]
    middles = tuple(_between(column, before, weight) for column in u)
    return Merged(
        times,
        tuple(columns) if len(columns) > 1 else columns[0],
        middles if isinstance(inputs, tuple) else middles[0],
    )


def _stream(name: str, stream: Any) -> tuple[Array, Any]:
    """Increasing times ``(K,)``, and their samples ``(K, ..., k)``."""
    if not isinstance(stream, tuple | list) or len(stream) != 2:
        raise ValueError(f"{name}: expected (times, samples), got {describe(stream)}")
    t = finite(name, stream[0], ("T",))
    back = np.flatnonzero(np.diff(t) <= 0.0)
    if len(back):
        k = int(back[0]) + 1
        raise ValueError(
            f"{name}: expected times that increase, got {t[k]:.9g} after {t[k - 1]:.9g} at index "
            f"{k}"
        )
    return t, stream[1]


def _column(name: str, values: Array, count: int) -> Array:
    if values.ndim < 2 or len(values) != count:
        raise ValueError(
            f"{name}: expected samples ({count}, ..., any) to go with the times, got shape "
            f"{values.shape}"
        )
    return values


def _between(values: Array, before: Array, weight: Array) -> Array:
    """Values interpolated between row ``before`` and the next row."""
    w = weight.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asanyarray((1.0 - w) * values[before] + w * values[before + 1])
