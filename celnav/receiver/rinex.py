"""Receiver logs: code and Doppler of BeiDou's B1I and GPS's L1 C/A from RINEX 3 files, and
broadcast orbits.

Files in Hatanaka's compression are unpacked by hatanaka
(``.venv/bin/pip install -c constraints.txt -e ".[rinex]"``). Times become BDT seconds since
2006-01-01.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.files import InputError
from celnav.gaussian.linalg import Array
from celnav.models.gnss import B1I_HZ, GEO_NUMBERS, GPS_AHEAD_S, L1_HZ, WEEK_S, Broadcast
from celnav.receiver.geodesy import ELLIPSOID, ecef2geodetic
from celnav.receiver.rinex_text import (
    Measured,
    Set,
    epochs,
    finite_number,
    header_of,
    kinds_of,
    of_system,
    sets,
    three_numbers,
    unpacked,
)
from celnav.receiver.sky import local_axes, on_earth

AHEAD_S = {"BDT": 0.0, "GPS": GPS_AHEAD_S, "GAL": GPS_AHEAD_S}
"""How far time systems of observation files are ahead of BDT."""


class System(NamedTuple):
    """Of satellites: its name, and the signal that is used, with its carrier and its codes, the
    best first.
    """

    name: str
    signal: str
    hz: float
    codes: tuple[str, ...]


SYSTEMS = {
    # B1I's carrier: of the data, by the older name too, of both components, of the other.
    "C": System("BeiDou", "B1I", B1I_HZ, ("C2I", "C1I", "C2X", "C2Q")),
    "G": System("GPS", "L1 C/A", L1_HZ, ("C1C",)),
}
"""By their letters in RINEX, in the order in which they are first and second of a log."""
OTHERS = {"R": "GLONASS", "E": "Galileo", "J": "QZSS", "S": "SBAS", "I": "NavIC"}
"""That files may have besides, and that are not used."""


@dataclass(frozen=True, eq=False)
class Observations:
    """A receiver's log.

    Attributes
    ----------
    path: of the file. marker: name of the station, may be empty. place: ``(3,)`` m of the marker by
        the header; None if it has none. times: ``(T,)`` s of BDT, increasing. names: of the
        satellites, ``S``. code: pseudoranges ``(T, S)`` m; doppler: ``(T, S)`` Hz; nan where
        nothing was measured. antenna: ``(3,)`` m east, north and up of the marker.
        out_of_order: how many epochs were left out, as their time lies before or after those of
            both their neighbors.
        others: letters of systems in the file that are none of `SYSTEMS`.
        damaged: messages with the line, one for each epoch that was left out because it is damaged.
    """

    path: Path
    marker: str
    place: Array | None
    times: Array
    names: list[str]
    code: Array
    doppler: Array
    antenna: Array = field(default_factory=lambda: np.zeros(3))
    out_of_order: int = 0
    others: str = ""
    damaged: tuple[str, ...] = ()

    def part(self, which: Array | slice) -> Observations:
        """Some of the epochs."""
        return replace(
            self, times=self.times[which], code=self.code[which], doppler=self.doppler[which]
        )

    def of(self, systems: str) -> Observations:
        """Those of the satellites of some systems, by their letters."""
        which = [s for s, name in enumerate(self.names) if name[0] in systems]
        return replace(
            self,
            names=[self.names[s] for s in which],
            code=self.code[:, which],
            doppler=self.doppler[:, which],
        )

    def reference(self, marker: ArrayLike | None = None) -> Array | None:
        """Position ``(3,)`` m of the antenna, whose position ranges tell: that of the marker (None:
        the header's) and its offset.

        None if neither has been given.
        """
        place = self.place if marker is None else np.asarray(marker, dtype=np.float64)
        if place is None:
            return None
        latitude, longitude, _ = ecef2geodetic(*place, ell=ELLIPSOID, deg=False)
        return np.asarray(place + self.antenna @ local_axes(latitude, longitude))


@dataclass(frozen=True, eq=False)
class Navigation:
    """Broadcast sets, several of each satellite, by their reference times; Klobuchar's
    coefficients, None if absent.

    ``path``: of the file, or of several. ``left_out``: how many sets of a satellite are not whole,
    or hold what no message can. ``damaged``: messages with the line, one for each set that was left
    out because it is damaged.
    """

    path: Path | str
    sets: Broadcast
    klobuchar: tuple[Array, Array] | None
    left_out: dict[str, int] = field(default_factory=dict)
    damaged: tuple[str, ...] = ()

    def nearest(self, name: str, times: ArrayLike) -> Array:
        """Rows ``(...)`` of a satellite's sets of the nearest reference times; -1: not well, or not
        within an hour (GEO) or two.
        """
        t = np.asarray(times, dtype=np.float64)
        number, gps = int(name[1:]), name[0] == "G"
        rows = np.flatnonzero((self.sets.number == number) & (self.sets.gps == gps))
        if not rows.size:
            return np.full(t.shape, -1)
        away = np.abs(self.sets.toe[rows] - t[..., None])
        best = rows[away.argmin(-1)]
        good = (away.min(-1) <= (3600.0 if number in GEO_NUMBERS and not gps else 7200.0)) & (
            self.sets.health[best] == 0.0
        )
        return np.where(good, best, -1)


def read_observations(path: str | Path, *, strict: bool = False) -> Observations:
    """Code and Doppler of B1I and L1 C/A of an observation file, plain, gzipped or in Hatanaka's
    compression.

    Where a satellite has several codes of a carrier, the first of its `System` that is there is
    taken. A damaged epoch is left out as a whole, and named in ``damaged``.

    Raises
    ------
    InputError: naming file and line, if it is not a RINEX 3 observation file with one of these, if
    its header is damaged, or most of its epochs are; with ``strict`` if one is.
    OSError: if it cannot be read.
    """
    file = Path(path)
    text, called = unpacked(file)
    header, start = header_of(called, text, "O")
    places: dict[str, list[tuple[int, int]]] = {}
    older = (
        ("C1X", "C1Q") if float(text[:9]) < 3.03 else ()
    )  # version 3.02 alone called B1I's band 1, which is B1C's since
    for system in SYSTEMS:
        kinds = kinds_of(called, header, system)
        codes = [code for code in SYSTEMS[system].codes + older * (system == "C") if code in kinds]
        if codes:
            places[system] = [
                (kinds.index(c), kinds.index("D" + c[1:]) if "D" + c[1:] in kinds else -1)
                for c in codes
            ]
        if any(
            line[2:6].strip() not in ("", "1")
            for line in of_system(header.get("SYS / SCALE FACTOR", []), system)
        ):
            raise InputError(
                f"{file}: expected observations of {SYSTEMS[system].name} in their units, got a "
                "SYS / SCALE FACTOR"
            )
    given = header.get("SYS / # / OBS TYPES", [])
    if not places:
        got = (
            ", ".join(
                f"{s}: {' '.join(kinds_of(called, header, s))}"
                for s in SYSTEMS
                if of_system(given, s)
            )
            or "none of them"
        )
        raise InputError(
            f"{file}: expected BeiDou's B1I code (C2I or C2X) or GPS's C1C among the observations, "
            f"got {got}"
        )
    default = "BDT" if text[40:41] == "C" else "GPS"
    system = header.get("TIME OF FIRST OBS", [""])[0][48:51].strip() or default
    if system not in AHEAD_S:
        raise InputError(f"{file}: expected times in GPS, GAL or BDT, got {system!r}")
    log, damaged = epochs(called, text, start, "".join(places), strict)
    names, seconds, ranges, rates = _measured(log, places)
    if not np.isfinite(ranges).any():
        raise InputError(f"{file}: expected pseudoranges of BeiDou or GPS satellites, got none")
    between = np.ones(len(seconds), bool)
    before, here, after = seconds[:-2], seconds[1:-1], seconds[2:]
    between[1:-1] = ((before <= here) & (here <= after)) | (before >= after)
    order = np.flatnonzero(between)[np.argsort(seconds[between], kind="stable")]
    kept = order[
        np.concatenate([[True], np.diff(seconds[order]) > 0.0])
    ]  # an epoch that is there twice counts once
    return Observations(
        file,
        header.get("MARKER NAME", [""])[0].strip(),
        _place(file, header),
        seconds[kept] - AHEAD_S[system],
        names,
        ranges[kept],
        rates[kept],
        three_numbers(file, header, "ANTENNA: DELTA H/E/N")[[1, 2, 0]],
        int((~between).sum()),
        "".join(
            dict.fromkeys(line[0] for line in given if line[0].strip() and line[0] not in SYSTEMS)
        ),
        damaged,
    )


def _measured(
    log: list[Measured], places: Mapping[str, Sequence[tuple[int, int]]]
) -> tuple[list[str], Array, Array, Array]:
    """Satellites ``S``, times ``(T,)``, pseudoranges and Doppler ``(T, S)``; ``places`` of codes
    and their Doppler, -1: none.
    """
    names = sorted({name for epoch in log for name in epoch.fields})
    column = {name: s for s, name in enumerate(names)}
    ranges, rates = np.full((2, len(log), len(names)), np.nan)
    for k, epoch in enumerate(log):
        for name, values in epoch.fields.items():
            for code, doppler in places[name[0]]:
                if code < len(values) and np.isfinite(values[code]):
                    ranges[k, column[name]] = values[code]
                    if 0 <= doppler < len(values):
                        rates[k, column[name]] = values[doppler]
                    break
    return names, np.array([epoch.time for epoch in log]), ranges, rates


def _place(path: Path, header: dict[str, list[str]]) -> Array | None:
    """Position of the marker; None if there is none."""
    marker = three_numbers(path, header, "APPROX POSITION XYZ")
    if not marker.any():
        return None
    try:
        on_earth("APPROX POSITION XYZ", marker)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return marker


ORDER = (
    "a0",
    "a1",
    "a2",
    "",
    "crs",
    "delta_n",
    "M0",
    "cuc",
    "e",
    "cus",
    "sqrt_a",
    "toe",
    "cic",
    "Omega0",
    "cis",
    "i0",
    "crc",
    "omega",
    "Omega_dot",
    "i_dot",
    "",
    "",
    "",
    "",
    "health",
    "tgd",
)
"""Of a set's numbers in the file; what is spare, or not needed, may be blank."""
TURNS = 200.0 * np.pi
MOST = {
    "a0": 2.0**-10,
    "a1": 2.0**-29,
    "a2": 2.0**-56,
    "crs": 2048.0,
    "crc": 2048.0,
    "cuc": 2.0**-14,
    "cus": 2.0**-14,
    "cic": 2.0**-14,
    "cis": 2.0**-14,
    "delta_n": 2.0**-28 * np.pi,
    "Omega_dot": 2.0**-20 * np.pi,
    "i_dot": 2.0**-30 * np.pi,
    "M0": TURNS,
    "Omega0": TURNS,
    "omega": TURNS,
    "i0": TURNS,
    "e": 0.5,
    "sqrt_a": 8192.0,
    "tgd": 5.12e-8,
    "toe": WEEK_S,
}
"""What the message has room for (either sign), by its bits [BDS-SIS-ICD-B1I-3.0]; angles in a file
may have turned often.
"""
MOST_OF_GPS = {"a1": 2.0**-28, "a2": 2.0**-48, "tgd": 2.0**-24}
"""Where that of GPS has more [IS-GPS-200]."""
LEAST = {"e": 0.0, "sqrt_a": 4096.0, "toe": 0.0}
"""No satellite of theirs is lower than 10,000 km."""
MOST_ALPHA, MOST_BETA = (
    2.0 ** np.array([-22.0, -19.0, -16.0, -16.0]),
    2.0 ** np.array([19.0, 22.0, 24.0, 24.0]),
)
"""Likewise of the ionosphere's coefficients, twice what their eight bits hold [IS-GPS-200]."""


def read_navigation(path: str | Path, *more: str | Path, strict: bool = False) -> Navigation:
    """Broadcast sets of BeiDou's and GPS's satellites from a navigation file, or from several.

    Sets that lack a number, or have one that no message can hold, are left out and counted; damaged
    ones are left out and named in ``damaged``. Of several headers the first that has coefficients
    of the ionosphere gives them.

    Raises
    ------
    InputError: naming file and line, if one is not a RINEX 3 navigation file, if its header is
    damaged, or most of its sets are (with ``strict`` if one is), or if none has orbits.
    OSError: if one cannot be read.
    """
    read: list[Set] = []
    damaged: tuple[str, ...] = ()
    coefficients = None
    for file in (path, *more):
        text, called = unpacked(Path(file))
        header, start = header_of(called, text, "N")
        whole, lost = sets(called, text, start, "".join(SYSTEMS), strict)
        read, damaged = read + whole, damaged + lost
        coefficients = coefficients or _klobuchar(file, header)
    files = Path(path) if not more else ", ".join(map(str, (path, *more)))
    if not read:
        raise InputError(f"{files}: expected orbits of BeiDou or GPS satellites, got none")
    given = _columns(read)
    credible = np.isfinite(given["health"])
    for name, most in MOST.items():
        # Twice the range leaves room for what is rounded; blanks are nan, and fail.
        bound = np.where(given["gps"], MOST_OF_GPS.get(name, most), most) * (
            1.0 if name in LEAST else 2.0
        )
        credible &= (np.abs(given[name]) <= bound) & (given[name] >= LEAST.get(name, -np.inf))
    if not credible.any():
        raise InputError(
            f"{files}: expected orbits, got {len(read)} sets that lack a number, or have one that "
            "no message can hold"
        )
    given["toe"] += WEEK_S * np.round((given["toc"] - given["toe"]) / WEEK_S)
    for name in ("toc", "toe"):
        given[name] -= GPS_AHEAD_S * given["gps"]
    order = np.flatnonzero(credible)[np.argsort(given["toe"][credible], kind="stable")]
    chosen = Broadcast(**{part.name: given[part.name][order] for part in fields(Broadcast)})
    refused = Counter(read[k].name for k in np.flatnonzero(~credible))
    return Navigation(files, chosen, coefficients, dict(sorted(refused.items())), damaged)


def _columns(read: list[Set]) -> dict[str, Array]:
    """Numbers of all sets by name; a blank clock acceleration or group delay is none."""
    numbers = np.array([one.numbers[: len(ORDER)] for one in read]).T
    out = {name: column for name, column in zip(ORDER, numbers, strict=True) if name}
    out |= {name: np.nan_to_num(out[name]) for name in ("a2", "tgd")}
    named = np.array([[float(one.name[1:]), one.name[0] == "G", one.toc] for one in read])
    return out | dict(zip(("number", "gps", "toc"), named.T, strict=True))


def read_ionosphere(path: str | Path) -> tuple[Array, Array]:
    """Klobuchar's coefficients from a header of RINEX 2 or 3; InputError naming the file if there
    are none.
    """
    text, called = unpacked(Path(path))
    found = _klobuchar(path, header_of(called, text, "N", oldest=2)[0])
    if found is None:
        raise InputError(
            f"{path}: expected GPSA and GPSB in the header, got none; eight numbers may be given "
            "instead"
        )
    return found


def ionosphere(called: str | Path, numbers: ArrayLike) -> tuple[Array, Array]:
    """Klobuchar's coefficients of eight numbers, alpha and beta; InputError if no message can hold
    them.
    """
    alpha, beta = np.asarray(numbers, dtype=np.float64).reshape(2, 4)
    if not ((np.abs(alpha) <= MOST_ALPHA).all() and (np.abs(beta) <= MOST_BETA).all()):
        raise InputError(
            f"{called}: expected coefficients of the ionosphere that a message can hold, got "
            f"{alpha} and {beta}"
        )
    return alpha, beta


def _klobuchar(path: str | Path, header: dict[str, list[str]]) -> tuple[Array, Array] | None:
    rows = {line[:4]: line[5:53] for line in header.get("IONOSPHERIC CORR", [])}
    rows |= {
        f"GPS{k}": header[label][0][2:50]
        for k, label in (("A", "ION ALPHA"), ("B", "ION BETA"))
        if label in header
    }
    if not {"GPSA", "GPSB"} <= set(rows):
        return None
    try:
        found = [
            finite_number(rows[k][i : i + 12]) for k in ("GPSA", "GPSB") for i in range(0, 48, 12)
        ]
    except ValueError:
        raise InputError(
            f"{path}: expected four numbers in GPSA and GPSB of the header, got {rows['GPSA']!r}"
        ) from None
    return ionosphere(path, found)
