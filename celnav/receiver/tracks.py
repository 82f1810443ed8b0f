"""Tracks in exchange formats: CSV with all quantities of each epoch, RTKLIB solutions, GeoJSON, and
NMEA 0183.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from datetime import timedelta
from functools import reduce
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import celnav
from celnav.gaussian.linalg import Array
from celnav.lazy import requires_extra
from celnav.models.gnss import GPS_AHEAD_S, WEEK_S
from celnav.receiver.geodesy import ELLIPSOID, ecef2geodetic
from celnav.receiver.rinex_text import EPOCH_ZERO
from celnav.receiver.sky import local_axes

with requires_extra("positioning a receiver", "rinex"):
    import erfa

if TYPE_CHECKING:
    from celnav.receiver.report import Positioned

GPS_WEEK = 1356
"""GPS week in which BDT began."""
BDT_DAY, TAI_AHEAD_S = 2453736.5, 33.0
"""Julian date at which BDT began, and how far TAI is ahead of BDT."""
KNOT = 1852.0 / 3600.0
COLUMNS = (
    "time_bdt",
    "seconds_bdt",
    "x_m",
    "y_m",
    "z_m",
    "vx_m_per_s",
    "vy_m_per_s",
    "vz_m_per_s",
    "clock_m",
    "drift_m_per_s",
    "east_m",
    "north_m",
    "up_m",
    "std_east_m",
    "std_north_m",
    "std_up_m",
    "satellites",
    "pdop",
    "integrity",
    "apart",
    "excluded",
)
DOUBTS = {
    "untested": "no redundancy shows a faulty satellite",
    "implausible height": "no receiver can be there",
    "weak": "its predicted error may exceed 100 m",
    "apart": "the ranges contradict the track by more than both explain",
    "distrusted": "trust was lost before, and the filter coasts",
    "drifting": "the fixes of the last epochs pull the track to one side",
    "displaced": "farther from the trusted track than a receiver can have moved",
}
"""Values of `celnav.receiver.report.Positioned.integrity` for which positions are marked, with the
reason.
"""


def civil(t: float, form: str = "%Y-%m-%dT%H:%M:%S") -> str:
    """Date and time from seconds of BDT; add `GPS_AHEAD_S` for GPS time."""
    return (EPOCH_ZERO + timedelta(milliseconds=round(t * 1e3))).strftime(form)


def table(result: Positioned) -> str:
    """All epochs as CSV; cells without a value are empty. ``clock_m`` is the receiver's clock
    including the steps by which it was set.

    ``integrity``: see `celnav.receiver.report.Positioned`. ``apart``: squared distance of the
    ranges from the track, over the largest value that noise explains. ``excluded``: satellites
    whose range was excluded; with "rate", whose rate alone was excluded.
    """
    local, log = result.local(result.mean), result.log
    mean = result.mean[:, :8].copy()
    mean[:, 6] += log.jumps
    numbers = np.column_stack(
        [log.times, mean, local, result.local_std, log.used.sum(1), log.dilution.position]
    )
    ranges, rates = np.split(log.excluded, 2, -1)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for k, row in enumerate(numbers):
        cells = [f"{v:.4f}".rstrip("0").rstrip(".") if np.isfinite(v) else "" for v in row]
        named = [n for n, out in zip(log.names, ranges[k], strict=True) if out]
        named += [f"{n} rate" for n, out in zip(log.names, rates[k], strict=True) if out]
        apart = f"{result.apart[k]:.3g}" if np.isfinite(result.apart[k]) else ""
        words = [result.integrity[k], apart, ", ".join(named)]
        writer.writerow([civil(log.times[k]), *cells, *words])
    return text.getvalue()


class Place(NamedTuple):
    """An epoch of an exported track: time (s of BDT), position (degrees, m above the ellipsoid),
    velocity and covariance (east, north, up).
    """

    time: float
    latitude: float
    longitude: float
    height: float
    velocity: Array
    cov: Array
    satellites: int
    hdop: float
    integrity: str
    measured: bool
    trusted: bool


def places(result: Positioned) -> list[Place]:
    """The `celnav.receiver.report.Positioned.reported` epochs: with at least one range, used or
    not.
    """
    k, log = np.flatnonzero(result.reported), result.log
    latitude, longitude, height = (
        np.reshape(v, k.size) for v in ecef2geodetic(*result.mean[k, :3].T, ell=ELLIPSOID)
    )
    axes = local_axes(np.radians(latitude), np.radians(longitude))
    velocity, cov = (axes @ result.mean[k, 3:6, None])[..., 0], axes @ result.cov[k] @ axes.mT
    rows = zip(
        log.times[k],
        latitude,
        longitude,
        height,
        velocity,
        cov,
        log.used[k].sum(1),
        log.dilution.horizontal[k],
        result.integrity[k].tolist(),
        result.measured[k].tolist(),
        (result.trust[k] == "").tolist(),
        strict=True,
    )
    return [Place(*row) for row in rows]


def pos(result: Positioned) -> str:
    """RTKLIB's solution file, in GPS time: latitude, longitude and height with their standard
    deviations.

    The quality is 5 (single), 7 (dead reckoning) for predicted positions, and 0 (none) for other
    positions that are not trusted. A comment line marks each position of `DOUBTS`.
    """
    rows, form = places(result), "%Y/%m/%d %H:%M:%S.%f"
    lines = [
        f"% program   : celnav {celnav.__version__} {result.filter}",
        *(f"% inp file  : {name}" for name in result.log.files),
        *(f"% left out  : {damage}" for damage in result.log.damaged),
    ]
    for name, place in (("start", rows[0]), ("end  ", rows[-1])):
        week, second = divmod(place.time + GPS_AHEAD_S, WEEK_S)
        when = civil(place.time + GPS_AHEAD_S, form)[:-5]
        lines.append(f"% obs {name} : {when} GPST (week{GPS_WEEK + int(week):04d} {second:8.1f}s)")
    systems = " ".join(
        {"C": "beidou", "G": "gps", "E": "galileo"}[letter] for letter in result.log.systems[::-1]
    )
    lines += [
        "% pos mode  : single",
        f"% ionos opt : {'broadcast' if result.log.ionosphere else 'typical, not broadcast'}",
        "% tropo opt : saastamoinen",
        "% ephemeris : broadcast",
        f"% navi sys  : {systems}",
        "%",
        "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,7:dr,"
        "ns=# of satellites)",
        "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns"
        "   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio",
    ]
    for place in rows:
        if place.integrity in DOUBTS:
            lines.append(
                f"% integrity : {place.integrity}, {DOUBTS[place.integrity]}, in the next line"
            )
        (ee, en, eu), (_, nn, nu), (_, _, uu) = place.cov
        deviations = "".join(
            f" {np.copysign(np.sqrt(abs(v)), v):8.4f}" for v in (nn, ee, uu, en, eu, nu)
        )
        quality = 7 if not place.measured else 5 if place.trusted else 0
        lines.append(
            f"{civil(place.time + GPS_AHEAD_S, form)[:-3]} {place.latitude:14.9f} "
            f"{place.longitude:14.9f} {place.height:10.4f}"
            f"   {quality} {place.satellites:3d}{deviations} {0.0:6.2f} {0.0:6.1f}"
        )
    return "\n".join(lines) + "\n"


def utc(times: ArrayLike) -> list[str]:
    """Date and time in UTC of seconds of BDT, to a millisecond: "2020-06-25T00:00:00.000Z"."""
    days = erfa.taiutc(BDT_DAY, (np.asarray(times) + TAI_AHEAD_S) / 86400.0)
    year, month, day, clock = erfa.d2dtf("UTC", 3, *days)
    return [
        "{}-{:02d}-{:02d}T{:02d}:{:02d}:{:02d}.{:03d}Z".format(*map(int, part))
        for part in zip(year, month, day, *(clock[field] for field in "hmsf"), strict=True)
    ]


def geojson(result: Positioned) -> str:
    """A line of longitude, latitude (degrees) and height above the ellipsoid (m) [RFC 7946].

    Its properties are the time in UTC and the ``integrity`` of each point, and messages of damage.
    """
    rows = places(result)
    line = [[round(row.longitude, 9), round(row.latitude, 9), round(row.height, 4)] for row in rows]
    shape = (
        {"type": "LineString", "coordinates": line}
        if len(line) > 1
        else {"type": "Point", "coordinates": line[0]}
    )
    about = {
        "filter": result.filter,
        "coordTimes": utc([row.time for row in rows]),
        "integrity": [row.integrity for row in rows],
        "ionosphere": "broadcast" if result.log.ionosphere else "typical, not broadcast",
        "damaged": result.log.damaged,
    }
    feature = {"type": "Feature", "geometry": shape, "properties": about}
    return json.dumps({"type": "FeatureCollection", "features": [feature]}) + "\n"


def nmea(result: Positioned) -> str:
    """GGA and RMC sentences of each epoch, in UTC.

    Heights are above the ellipsoid, and the geoid separation is 0, because celnav has no geoid
    model. For predicted positions the quality is 6 and the mode E (estimated). Positions that are
    not trusted are V (void). The last field of RMC [NMEA 4.1] is C (caution) for untested
    positions, U (unsafe) for other positions of `DOUBTS`, and V (not provided) elsewhere.
    """
    talker = {"C": "GB", "G": "GP", "E": "GA"}.get(result.log.systems, "GN")
    rows, lines = places(result), []
    for row, when in zip(rows, utc([row.time for row in rows]), strict=True):
        clock, date = when[11:-1].replace(":", ""), when[8:10] + when[5:7] + when[2:4]
        at = f"{_angle(row.latitude, 2, 'NS')},{_angle(row.longitude, 3, 'EW')}"
        east, north, _ = row.velocity
        moving = (
            f"{np.hypot(east, north) / KNOT:.2f},{np.degrees(np.arctan2(east, north)) % 360.0:.2f}"
            if east == east
            else ","
        )
        hdop = f"{row.hdop:.2f}" if np.isfinite(row.hdop) else ""
        quality, mode = (1, "A") if row.measured else (6, "E")
        lines.append(
            f"{talker}GGA,{clock},{at},{quality},{row.satellites:02d},{hdop},"
            f"{row.height:.3f},M,0.0,M,,"
        )
        status = "C" if row.integrity == "untested" else "U" if row.integrity in DOUBTS else "V"
        valid = "A" if row.trusted else "V"
        lines.append(f"{talker}RMC,{clock},{valid},{at},{moving},{date},,,{mode},{status}")
    return "".join(
        f"${line}*{reduce(lambda a, b: a ^ b, line.encode('ascii')):02X}\r\n" for line in lines
    )


def _angle(degrees: float, digits: int, signs: str) -> str:
    """Degrees and minutes in NMEA's format."""
    whole, minutes = divmod(round(abs(degrees) * 60.0, 6), 60.0)
    return f"{int(whole):0{digits}d}{minutes:09.6f},{signs[int(degrees < 0.0)]}"


FORMATS: dict[str, Callable[[Positioned], str]] = {
    ".csv": table,
    ".pos": pos,
    ".geojson": geojson,
    ".nmea": nmea,
}
"""Writers of the formats by file suffix."""
