"""Where Sun, Moon and planets are: JPL's development ephemerides, barycentric, ICRS axes. Units: km, km/s.

`de421` needs no files but those of the package; `Kernel` reads any such SPK file, `Arrays` the older ephemerides in the form of
Chebyshev arrays (DE405, DE406, DE421, DE423). Planets are their systems' barycenters, except the Earth.
"""

from __future__ import annotations

import os
from functools import cache, cached_property
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from jplephem.daf import DAF
from jplephem.spk import SPK
from numpy.polynomial.chebyshev import chebder, chebval

from celnav.gaussian.checks import choice, instance
from celnav.gaussian.linalg import Array
from celnav.models.time import DAY_S, Tdb

BODIES = ("sun", "mercury", "venus", "earth", "moon", "mars", "jupiter", "saturn", "uranus", "neptune", "pluto")
GM = {
    "sun": 132712440040.944, "mercury": 22032.090, "venus": 324858.592, "earth": 398600.436233, "moon": 4902.800076,
    "mars": 42828.375214, "jupiter": 126712764.8, "saturn": 37940585.2, "uranus": 5794548.6, "neptune": 6836535.0, "pluto": 977.0,
}  # fmt: skip
"""Gravitational parameters of DE421, km^3/s^2; planets beyond the Earth with their moons."""
_SPK = {
    "sun": ((0, 10),), "mercury": ((0, 1),), "venus": ((0, 2),), "earth": ((0, 3), (3, 399)), "moon": ((0, 3), (3, 301)),
    "mars": ((0, 4),), "jupiter": ((0, 5),), "saturn": ((0, 6),), "uranus": ((0, 7),), "neptune": ((0, 8),), "pluto": ((0, 9),),
}  # fmt: skip


class BodyState(NamedTuple):
    """Position (km) and velocity (km/s), ``(..., 3)``, with respect to the solar system's barycenter."""

    position: Array
    velocity: Array


class Ephemeris(Protocol):
    """What a model asks of an ephemeris."""

    def state(self, body: str, date: Tdb) -> BodyState:
        """State of one of `BODIES` at dates of any shape."""


class Kernel:
    """A binary SPK file.

    Raises
    ------
    ValueError: naming the file, if it is none, is cut off, or lacks a body that is asked for; for a date outside of it.
    OSError: if it cannot be read.
    """

    def __init__(self, path: str | Path):
        self.path = Path(instance("path", path, str | os.PathLike, "a path, such as 'de440.bsp'"))
        content = self.path.read_bytes()
        try:
            self._spk = SPK(DAF(BytesIO(content)))
            size = 8 * (self._spk.daf.free - 1)
        except Exception as error:  # jplephem raises whatever the bytes lead it to
            raise ValueError(f"{self.path}: expected a binary SPK ephemeris ({error})") from None
        if len(content) < size:
            raise ValueError(f"{self.path}: expected {size} bytes, got {len(content)}: the file is cut off")

    def _segments(self, body: str) -> list[Any]:
        choice("body", body, BODIES)
        try:
            return [self._spk[pair] for pair in _SPK[body]]
        except KeyError:
            present = ", ".join(sorted(b for b in BODIES if all(pair in self._spk.pairs for pair in _SPK[b])))
            raise ValueError(f"{self.path}: no data for {body!r}; it has {present}") from None

    def state(self, body: str, date: Tdb) -> BodyState:
        """See `Ephemeris`."""
        segments = self._segments(body)
        _check(date, max(s.start_jd for s in segments), min(s.end_jd for s in segments), str(self.path))
        day, rest = np.broadcast_arrays(np.asarray(date.day, dtype=np.float64), np.asarray(date.rest, dtype=np.float64))
        position, rate = np.zeros((3, day.size)), np.zeros((3, day.size))
        for segment in segments:
            p, v = segment.compute_and_differentiate(day.ravel(), rest.ravel())
            position, rate = position + p, rate + v
        shape = (*day.shape, 3)
        return BodyState(position.T.reshape(shape), rate.T.reshape(shape) / DAY_S)


@cache
def de421() -> Kernel:
    """DE421 [Folkner et al. 2009], 1899 to 2053, from the package skyfield-data."""
    return Kernel(str(files("skyfield_data") / "data" / "de421.bsp"))


class Arrays:
    """An ephemeris as arrays of Chebyshev coefficients: a folder with ``constants.npy`` and ``jpl-<body>.npy``.

    Raises
    ------
    ValueError: naming the folder or file, if something is missing or not what it should be; for a date outside.
    """

    def __init__(self, folder: str | Path):
        self.folder = Path(instance("folder", folder, str | os.PathLike, "a path, such as 'de405'"))
        table = self._load("constants")
        if table.dtype.names is None or not {"name", "value"} <= set(table.dtype.names):
            raise ValueError(f"{self.folder}: expected constants.npy with names and values")
        self.constants = {bytes(row["name"]).decode().strip(): float(row["value"]) for row in table}
        missing = [name for name in ("jalpha", "jomega", "EMRAT", "AU") if name not in self.constants]
        if missing:
            raise ValueError(f"{self.folder}: expected constants {', '.join(missing)}")
        self.first, self.last = self.constants["jalpha"], self.constants["jomega"]

    def _load(self, name: str) -> Array:
        path = self.folder / f"{name}.npy"
        try:
            return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
        except FileNotFoundError:
            present = ", ".join(sorted(p.stem.removeprefix("jpl-") for p in self.folder.glob("jpl-*.npy"))) or "nothing"
            raise ValueError(f"{path}: no such file; the folder has {present}") from None
        except (ValueError, EOFError, OSError) as error:
            raise ValueError(f"{path}: expected an array of numbers ({error})") from None

    @cached_property
    def gm(self) -> dict[str, float]:
        """Gravitational parameters of this ephemeris, km^3/s^2."""
        unit, ratio = self.constants["AU"] ** 3 / DAY_S**2, self.constants["EMRAT"]
        names = {"sun": "GMS", "mercury": "GM1", "venus": "GM2", "mars": "GM4", "jupiter": "GM5", "saturn": "GM6",
                 "uranus": "GM7", "neptune": "GM8", "pluto": "GM9"}  # fmt: skip
        out = {body: self.constants[name] * unit for body, name in names.items()}
        both = self.constants["GMB"] * unit
        return out | {"earth": both * ratio / (1.0 + ratio), "moon": both / (1.0 + ratio)}

    def state(self, body: str, date: Tdb) -> BodyState:
        """See `Ephemeris`."""
        choice("body", body, BODIES)
        _check(date, self.first, self.last, str(self.folder))
        if body not in ("earth", "moon"):
            return self._series(body, date)
        together, moon = self._series("earthmoon", date), self._series("moon", date)
        share = 1.0 / (1.0 + self.constants["EMRAT"])
        if body == "moon":
            share -= 1.0
        return BodyState(together.position - share * moon.position, together.velocity - share * moon.velocity)

    def _series(self, name: str, date: Tdb) -> BodyState:
        coefficients = self._load(f"jpl-{name}")
        if coefficients.ndim != 3 or coefficients.shape[1] != 3:
            raise ValueError(f"{self.folder}/jpl-{name}.npy: expected shape (sets, 3, coefficients), got {coefficients.shape}")
        day, rest = np.broadcast_arrays(np.asarray(date.day, dtype=np.float64), np.asarray(date.rest, dtype=np.float64))
        sets = len(coefficients)
        span = (self.last - self.first) / sets
        # The whole days first: the sum of both parts has lost the digits that a hundredth of a millimeter is about.
        k = np.clip(np.floor(((day - self.first) + rest) / span).astype(int), 0, sets - 1)
        u = 2.0 * ((day - (self.first + k * span)) + rest) / span - 1.0
        chosen = np.moveaxis(coefficients[k], -1, 0)  # (coefficients, ..., 3)
        position = chebval(u[..., None], chosen, tensor=False)
        velocity = chebval(u[..., None], chebder(chosen, axis=0), tensor=False) * (2.0 / (span * DAY_S))
        return BodyState(np.asarray(position), np.asarray(velocity))


def _check(date: Tdb, first: float, last: float, where: str) -> None:
    instance("date", date, Tdb, 'a Tdb, such as celnav.models.time.from_utc("2015-10-17")')
    from_first = (np.asarray(date.day) - first) + date.rest
    outside = (from_first < 0.0) | (from_first > last - first)
    if np.any(outside) or not np.isfinite(from_first).all():
        worst = float(np.ravel(from_first)[int(np.argmax(np.ravel(outside | ~np.isfinite(from_first))))]) + first
        raise ValueError(f"date: expected JD TDB between {first} and {last}, which {where} covers, got {worst:.6f}")
