"""Instants in barycentric dynamical time (TDB), the time of ephemerides, and the way there from UTC.

An instant is a Julian date in two parts, so that centuries keep their microseconds; the scale is in the type. Leap seconds and
the difference of TDB and TT come from ERFA. An offline machine in years to come keeps its table and is warned by it.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import NamedTuple

import erfa
import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import finite, instance, numbers
from celnav.gaussian.linalg import Array

DAY_S = 86400.0


class Tdb(NamedTuple):
    """Julian date TDB: whole days (or any fixed day) and the rest, in days; arrays of one shape, or numbers."""

    day: Array | float
    rest: Array | float

    def after(self, seconds: ArrayLike) -> Tdb:
        """The instants so many seconds later."""
        return Tdb(self.day, self.rest + numbers("seconds", seconds) / DAY_S)

    def since(self, other: Tdb) -> Array:
        """Seconds from another instant."""
        instance("other", other, Tdb, 'a Tdb, such as celnav.models.time.from_utc("2015-10-17")')
        return np.asarray(((self.day - other.day) + (self.rest - other.rest)) * DAY_S)


def from_tt(day: ArrayLike, rest: ArrayLike = 0.0) -> Tdb:
    """TDB of a Julian date in terrestrial time, at the center of the Earth."""
    one, two = finite("day", day), finite("rest", rest)
    return Tdb(one, two + erfa.dtdb(one, two, 0.0, 0.0, 0.0, 0.0) / DAY_S)


def from_utc(instant: str | datetime) -> Tdb:
    """TDB of an instant in UTC: "2015-10-17T04:00:00" (leap seconds too: 23:59:60), or a datetime that knows its zone."""
    when, leap = instant, "23:59:60" in str(instant)
    if isinstance(instant, str):
        try:
            when = datetime.fromisoformat(instant.strip().replace("23:59:60", "23:59:59"))
        except ValueError as error:
            raise ValueError(f"instant: expected UTC as YYYY-MM-DDTHH:MM:SS, got {instant!r} ({error})") from None
        when = when.replace(tzinfo=when.tzinfo or UTC)
    if not isinstance(when, datetime) or when.tzinfo is None:
        raise ValueError(f"instant: expected a datetime with a time zone, or UTC as YYYY-MM-DDTHH:MM:SS, got {instant!r:.80}")
    when = when.astimezone(UTC)
    second = when.second + leap + 1e-6 * when.microsecond
    days = erfa.dtf2d("UTC", when.year, when.month, when.day, when.hour, when.minute, second)
    return from_tt(*erfa.taitt(*erfa.utctai(*days)))
