"""Barycentric positions of Sun, Moon and planets from JPL's ephemerides, on ICRS axes. Units: km,
km/s.

`de421` needs no download; `Kernel` reads any SPK file of this type. A planet is the barycenter of
its system, except the Earth. An instant is a Julian date TDB in two parts, which resolves
microseconds over centuries. ERFA provides leap seconds and TDB minus TT; it warns if its table of
leap seconds is old.
"""

from __future__ import annotations

import os
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import choice, finite, instance, numbers
from celnav.gaussian.linalg import Array
from celnav.lazy import requires_extra

with requires_extra("celnav.models.ephemeris", "papers"):
    import erfa
    from jplephem.daf import DAF
    from jplephem.spk import SPK

GM = {
    "sun": 132712440040.944,
    "mercury": 22032.090,
    "venus": 324858.592,
    "earth": 398600.436233,
    "moon": 4902.800076,
    "mars": 42828.375214,
    "jupiter": 126712764.8,
    "saturn": 37940585.2,
    "uranus": 5794548.6,
    "neptune": 6836535.0,
    "pluto": 977.0,
}
"""Gravitational parameters of DE421, km^3/s^2; planets beyond the Earth include their moons."""
BODIES = tuple(GM)
_SPK = {
    "sun": ((0, 10),),
    "mercury": ((0, 1),),
    "venus": ((0, 2),),
    "earth": ((0, 3), (3, 399)),
    "moon": ((0, 3), (3, 301)),
    "mars": ((0, 4),),
    "jupiter": ((0, 5),),
    "saturn": ((0, 6),),
    "uranus": ((0, 7),),
    "neptune": ((0, 8),),
    "pluto": ((0, 9),),
}
"""SPK segments (center, target) whose sum is the position of a body."""


class BodyState(NamedTuple):
    """Position (km) and velocity (km/s), ``(..., 3)``, with respect to the solar system's
    barycenter.
    """

    position: Array
    velocity: Array


class Kernel:
    """A binary SPK file; ValueError if the file has another format or is truncated.

    >>> date = celnav.models.ephemeris.from_utc("2015-10-17")
    >>> position, velocity = Kernel("de440.bsp").state("mars", date)
    """

    def __init__(self, path: str | Path):
        self.path = Path(instance("path", path, str | os.PathLike, "a path, such as 'de440.bsp'"))
        content = self.path.read_bytes()
        try:
            self._spk = SPK(DAF(BytesIO(content)))
            size = 8 * (self._spk.daf.free - 1)
        except Exception as error:  # jplephem raises many types of errors for wrong bytes
            raise ValueError(
                f"{self.path}: expected a binary SPK ephemeris, got another format ({error})"
            ) from None
        if len(content) < size:
            raise ValueError(
                f"{self.path}: expected {size} bytes, got {len(content)}: the file is truncated"
            )

    def state(self, body: str, date: Tdb) -> BodyState:
        """`BodyState` of one of `BODIES` at dates of any shape ``(...)``; ValueError if the file
        does not have the body or does not cover a date.
        """
        choice("body", body, BODIES)
        present = [b for b in sorted(BODIES) if all(pair in self._spk.pairs for pair in _SPK[b])]
        if body not in present:
            raise ValueError(
                f"body: expected one that {self.path} has ({', '.join(present)}), got {body!r}"
            )
        segments = [self._spk[pair] for pair in _SPK[body]]
        instance("date", date, Tdb, 'a Tdb, such as celnav.models.ephemeris.from_utc("2015-10-17")')
        first, last = max(s.start_jd for s in segments), min(s.end_jd for s in segments)
        day, rest = np.broadcast_arrays(
            np.asarray(date.day, dtype=np.float64), np.asarray(date.rest, dtype=np.float64)
        )
        # Days from the start of the data; this order of operations keeps the digits of the rest.
        since = ((day - first) + rest).ravel()
        outside = since[~((since >= 0.0) & (since <= last - first))]  # nan too
        if outside.size:
            covered = f"between {first} and {last}, which {self.path} covers"
            raise ValueError(f"date: expected JD TDB {covered}, got {outside[0] + first:.6f}")
        # Each segment gives position and rate (3, K); the segments of a body add up.
        computed = (
            segment.compute_and_differentiate(day.ravel(), rest.ravel()) for segment in segments
        )
        position, rate = (
            np.add.reduce(parts).T.reshape(*day.shape, 3) for parts in zip(*computed, strict=True)
        )
        return BodyState(position, rate / DAY_S)


@cache
def de421() -> Kernel:
    """The `Kernel` DE421 [Folkner2009], 1899 to 2053, from the package skyfield-data."""
    with requires_extra("de421", "papers"):
        return Kernel(str(files("skyfield_data") / "data" / "de421.bsp"))


DAY_S = 86400.0


class Tdb(NamedTuple):
    """Julian date TDB in two parts, ``day + rest``, both in days: numbers, or arrays of the same
    shape.
    """

    day: Array | float
    rest: Array | float

    def after(self, seconds: ArrayLike) -> Tdb:
        """The `Tdb` that is ``seconds (...)`` later."""
        return Tdb(self.day, self.rest + numbers("seconds", seconds) / DAY_S)

    def since(self, other: Tdb) -> Array:
        """Seconds ``(...)`` since another `Tdb`."""
        instance(
            "other", other, Tdb, 'a Tdb, such as celnav.models.ephemeris.from_utc("2015-10-17")'
        )
        return np.asarray(((self.day - other.day) + (self.rest - other.rest)) * DAY_S)


def from_tt(day: ArrayLike, rest: ArrayLike = 0.0) -> Tdb:
    """`Tdb` of Julian dates ``day + rest (...)`` in terrestrial time, at the Earth's center."""
    days, rests = finite("day", day), finite("rest", rest)
    return Tdb(days, rests + erfa.dtdb(days, rests, 0.0, 0.0, 0.0, 0.0) / DAY_S)


def from_utc(instant: str | datetime) -> Tdb:
    """`Tdb` of an instant in UTC: "2015-10-17T04:00:00" (or a leap second, 23:59:60), or a datetime
    with a time zone; ValueError otherwise.
    """
    when, leap = instant, "23:59:60" in str(instant)
    if isinstance(instant, str):
        try:
            when = datetime.fromisoformat(instant.strip().replace("23:59:60", "23:59:59"))
        except ValueError as error:
            raise ValueError(
                f"instant: expected UTC as YYYY-MM-DDTHH:MM:SS, got {instant!r} ({error})"
            ) from None
        when = when.replace(tzinfo=when.tzinfo or UTC)
    if not isinstance(when, datetime) or when.tzinfo is None:
        raise ValueError(
            "instant: expected a datetime with a time zone, or UTC as YYYY-MM-DDTHH:MM:SS, got "
            f"{instant!r:.80}"
        )
    when = when.astimezone(UTC)
    second = when.second + leap + 1e-6 * when.microsecond
    days = erfa.dtf2d("UTC", when.year, when.month, when.day, when.hour, when.minute, second)
    return from_tt(*erfa.taitt(*erfa.utctai(*days)))
