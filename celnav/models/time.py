"""Instants in barycentric dynamical time (TDB), the time of ephemerides, and the way there from UTC.

An instant is a Julian date in two parts, so that centuries keep their microseconds; the scale is in the type. Leap seconds and
the difference of TDB and TT come from ERFA. An offline machine in years to come keeps its table and is warned by it.
"""

from __future__ import annotations

import re
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
    """TDB of an instant in UTC: "2015-10-17T04:00:00" (leap seconds too: 23:59:60), or a datetime that knows its zone.

    Raises
    ------
    ValueError: for a string of another form, an impossible date, or a datetime without a zone.
    """
    if isinstance(instant, datetime):
        if instant.tzinfo is None:
            raise ValueError(f"instant: expected a datetime with a time zone, got {instant!r}; its scale is not known")
        instant = instant.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%f")
    if not isinstance(instant, str):
        raise ValueError(f"instant: expected UTC as YYYY-MM-DDTHH:MM:SS, or a datetime, got {instant!r:.80}")
    match = re.fullmatch(r"(\d{4})-(\d\d)-(\d\d)(?:[T ](\d\d):(\d\d)(?::(\d\d(?:\.\d+)?))?)?Z?", instant.strip())
    if not match:
        raise ValueError(f"instant: expected UTC as YYYY-MM-DDTHH:MM:SS, got {instant!r}")
    year, month, day, hour, minute = (int(part or 0) for part in match.groups()[:5])
    second = float(match[6] or 0.0)
    leap = second >= 60.0 and (hour, minute) != (23, 59)
    if leap or second >= 61.0 or hour > 23 or minute > 59:
        raise ValueError(f"instant: expected a time of day, got {instant!r}")
    try:
        one, two = erfa.dtf2d("UTC", year, month, day, hour, minute, second)
    except erfa.ErfaError as error:
        raise ValueError(f"instant: expected a date that exists, got {instant!r} ({error})") from None
    return from_tt(*erfa.taitt(*erfa.utctai(one, two)))
