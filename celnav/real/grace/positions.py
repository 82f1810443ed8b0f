"""Files with positions of a satellite, one per line, and axes along its orbit. Units: m, s;
Earth-fixed axes.
"""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from celnav.files import InputError
from celnav.gaussian.linalg import Array
from celnav.models import earth

__all__ = ["EPOCH", "STEP_S", "Positions", "aligned", "axes", "read"]

STEP_S = 10.0
EPOCH = np.datetime64("2000-01-01T12:00:00")
"""Where the seconds of the files begin, in GPS time."""
MOST_BYTES, MOST_EPOCHS = 10_000_000, 100_000


class Positions(NamedTuple):
    """Epochs ``(T,)`` every `STEP_S`, GPS seconds since `EPOCH`, and positions ``(T, 3)``
    m, nan in gaps.
    """

    times: Array
    z: Array


def read(path: str | Path) -> Positions:
    """Read positions from a file of lines ``seconds x y z quality``, plain or gzipped.

    Raises
    ------
    InputError: naming the file, and the first invalid line or what is wrong with the whole file.
    OSError: if it cannot be read.
    """
    content = Path(path).read_bytes()
    if content[:2] == b"\x1f\x8b":
        try:
            with gzip.open(path) as file:
                content = file.read(MOST_BYTES + 1)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise InputError(f"{path}: expected a whole gzipped file, got {error}") from None
    if len(content) > MOST_BYTES:
        raise InputError(f"{path}: expected at most {MOST_BYTES:,} bytes when unpacked, got more")
    rows: list[list[float]] = []
    for number, line in enumerate(content.decode("latin-1").splitlines(), 1):
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            row = []
        if len(row) != 5 or not np.isfinite(row).all():
            raise InputError(
                f"{path}: line {number}: expected five numbers, seconds x y z quality, got "
                f"{line[:60]!r}"
            )
        late = (row[0] - rows[0][0]) / STEP_S if rows else 0.0
        if rows and not (
            row[0] > rows[-1][0] and late < MOST_EPOCHS and abs(late - round(late)) < 1e-6
        ):
            raise InputError(
                f"{path}: line {number}: expected increasing seconds at steps of {STEP_S:g}, got "
                f"{row[0]:.10g}"
            )
        rows.append(row)
    if len(rows) < 100:
        raise InputError(f"{path}: expected at least 100 positions, got {len(rows)}")
    t, *xyz = np.array(rows).T[:4]
    k = np.round((t - t[0]) / STEP_S).astype(int)
    z = np.full((k[-1] + 1, 3), np.nan)
    z[k] = np.transpose(xyz)
    if not 6.4e6 < (size := np.nanmedian(np.linalg.norm(z, axis=1))) < 5e7:
        raise InputError(
            f"{path}: expected positions in m from the Earth's center, got a distance of {size:.6g}"
        )
    return Positions(t[0] + STEP_S * np.arange(len(z)), z)


def aligned(log: Positions, other: Positions) -> Array:
    """Positions ``(T, 3)`` at the epochs of a log."""
    k = np.round((other.times - log.times[0]) / STEP_S).astype(int)
    there = (k >= 0) & (k < len(log.times))
    out = np.full(log.z.shape, np.nan)
    out[k[there]] = other.z[there]
    return out


def axes(truth: Array) -> Array:
    """Rotations ``(T, 3, 3)`` from Earth-fixed axes to axes radial, along and across the track; nan
    next to a gap.
    """
    velocity = np.gradient(truth, STEP_S, axis=0) + np.cross([0.0, 0.0, earth.ROTATION_RATE], truth)
    up, across = (
        v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (truth, np.cross(truth, velocity))
    )
    return np.stack([up, np.cross(across, up), across], -2)
