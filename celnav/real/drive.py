"""Files of a drive with a receiver and an inertial unit: RTKLIB solutions, time tags, and the
unit's table of samples.

Times are GPS time in s since 1970, counted by the calendar without leap seconds.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from celnav.files import InputError
from celnav.gaussian.linalg import Array
from celnav.models.earth import STANDARD_GRAVITY
from celnav.receiver.rinex_text import unpacked

__all__ = ["Samples", "Solution", "read_imu", "read_pos", "read_tags"]

PLACE = ("latitude(deg)", "longitude(deg)", "height(m)", "Q", "sdn(m)", "sde(m)", "sdu(m)")
SPEED = ("vn(m/s)", "ve(m/s)", "vu(m/s)", "sdvn", "sdve", "sdvu")
DOWN = np.array([1.0, 1.0, -1.0])
"""Signs from north, east, up to north, east, down."""
TAG_BYTES, TAGGED = 60, b"TIMETAG RTKLIB"
"""Length of the header of a time-tag file, and its first bytes."""


class Solution(NamedTuple):
    """Fixes of a receiver.

    t: ``(T,)`` s. latitude, longitude: ``(T,)`` rad. height_m: ``(T,)``. velocity: ``(T, 3)`` m/s,
    north, east, down; nan if the file has none.
    sigma_position, sigma_velocity: ``(T, 3)``, m and m/s, standard deviations reported by the
    receiver. quality: ``(T,)``, 1 for a fixed solution, 2 for a float solution.
    """

    t: Array
    latitude: Array
    longitude: Array
    height_m: Array
    velocity: Array
    sigma_position: Array
    sigma_velocity: Array
    quality: Array


class Samples(NamedTuple):
    """Samples of an inertial unit on its own axes: times ``(T,)`` s, rate ``(T, 3)`` rad/s,
    specific force ``(T, 3)`` m/s^2.
    """

    t: Array
    rate: Array
    force: Array


def read_pos(path: str | Path) -> Solution:
    """Read the fixes of an RTKLIB solution file, plain or gzipped. Its columns are GPS time,
    latitude, longitude, height, and optionally velocity.

    Raises
    ------
    InputError: naming the file, and a column that its header lacks or a line that is not a fix.
    OSError: if it cannot be read.

    >>> fixes = read_pos("rover.pos")
    """
    lines, called = unpacked(Path(path))
    names: list[str] = []
    rows: list[list[float]] = []
    times: list[np.datetime64] = []
    for k, line in enumerate(lines, 1):
        words = line.lstrip("% ").split()
        if line.startswith("%"):
            names = words if PLACE[0] in words else names
            continue
        if not words:
            continue
        if not times:
            missing = [name for name in ("GPST", *PLACE) if name not in names]
            if missing:
                raise InputError(
                    f"{called}: expected a header line % GPST {' '.join(PLACE)} ..., got none with "
                    f"{', '.join(missing)}"
                )
        try:
            date, clock, *values = words
            times.append(np.datetime64(f"{date.replace('/', '-')}T{clock}", "us"))
            rows.append([float(word) for word in values])
            if len(values) != len(names) - 1 or not np.isfinite(rows[-1]).all():
                raise ValueError
        except ValueError:
            raise InputError(
                f"{called}, line {k}: expected a date, a time and {max(len(names) - 1, 0)} "
                f"numbers, got {line[:60]!r}"
            ) from None
    if not rows:
        raise InputError(f"{called}: expected fixes, got none")
    column = dict(zip(names[1:], np.transpose(rows), strict=True))
    t = (np.array(times) - np.datetime64(0, "s")) / np.timedelta64(1, "s")
    if (np.diff(t) <= 0.0).any():
        raise InputError(f"{called}: expected increasing times, got others")
    nothing = np.full(len(t), np.nan)
    place, speed = (
        np.stack([column.get(name, nothing) for name in group], -1) for group in (PLACE, SPEED)
    )
    return Solution(
        t,
        np.radians(place[:, 0]),
        np.radians(place[:, 1]),
        place[:, 2],
        speed[:, :3] * DOWN,
        place[:, 4:],
        speed[:, 3:],
        place[:, 3].astype(int),
    )


def read_tags(path: str | Path) -> tuple[float, float]:
    """Read the GPS times (s) of the first and last tag in an RTKLIB time-tag file. Tags record when
    the bytes of a stream arrived.

    Raises
    ------
    InputError: naming the file, if it is not a time-tag file. OSError: if it cannot be read.
    """
    raw = Path(path).read_bytes()
    count = (len(raw) - TAG_BYTES - 16) // 8
    if not raw.startswith(TAGGED) or count < 1:
        raise InputError(f"{path}: expected time tags of RTKLIB, {TAGGED.decode()}, got none")
    _, whole, fraction = struct.unpack_from("<IId", raw, TAG_BYTES)
    (last,) = struct.unpack_from("<I", raw, TAG_BYTES + 16 + 8 * (count - 1))
    start = whole + fraction
    return start, start + last / 1000.0


def read_imu(path: str | Path, tags: str | Path) -> Samples:
    """Read the samples of a unit whose stream has time tags, plain or gzipped. A line has three
    accelerations (g), three rates (deg/s) and the unit's clock (ms).

    The clock is scaled so that the first and last samples coincide with the first and last tags.
    The first and last lines are omitted, because they may be incomplete.

    Raises
    ------
    InputError: naming the file, and a line that is not a sample. OSError: if it cannot be read.

    >>> samples = read_imu("imu.csv", "imu.csv.tag")
    """
    text, called = unpacked(Path(path))
    lines = text[1:-1]
    rows = []
    for k, line in enumerate(lines, 2):
        try:
            rows.append([float(word) for word in line.split(",")])
            if len(rows[-1]) != 7 or not np.isfinite(rows[-1]).all():
                raise ValueError
        except ValueError:
            raise InputError(
                f"{called}, line {k}: expected seven numbers with commas, got {line[:60]!r}"
            ) from None
    if len(rows) < 2:
        raise InputError(f"{called}: expected four lines or more, got {len(lines) + 2}")
    table = np.array(rows)
    clock = table[:, 6] - table[0, 6]
    if (np.diff(clock) <= 0.0).any():
        k = int(np.argmax(np.diff(clock) <= 0.0)) + 3
        raise InputError(f"{called}, line {k}: expected an increasing clock, got another value")
    start, end = read_tags(tags)
    return Samples(
        start + clock * (end - start) / clock[-1],
        np.radians(table[:, 3:6]),
        STANDARD_GRAVITY * table[:, :3],
    )
