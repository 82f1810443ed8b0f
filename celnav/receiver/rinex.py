"""Receiver logs from RINEX files of versions 2.11, 3 and 4: code, Doppler and broadcast orbits.

The signals are BeiDou's B1I, GPS's L1 C/A and Galileo's E1.
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
from celnav.models.gnss import (
    B1I_HZ,
    GALILEO,
    GPS,
    GPS_AHEAD_S,
    L1_HZ,
    SYSTEM_LETTERS,
    WEEK_S,
    Broadcast,
    ahead_s,
)
from celnav.receiver.geodesy import ELLIPSOID, ecef2geodetic
from celnav.receiver.rinex_text import (
    File,
    Measured,
    Set,
    finite_number,
    kinds_of,
    measurements,
    messages,
    of_system,
    read_text,
    three_numbers,
)
from celnav.receiver.sky import local_axes, on_earth

LONGEST_S = 14400.0
"""Longest validity of a broadcast set, s: Galileo's."""
AHEAD_S = {"BDT": 0.0, "GPS": GPS_AHEAD_S, "GAL": GPS_AHEAD_S}
"""Offsets of the time systems of observation files from BDT, s."""


class System(NamedTuple):
    """A satellite system: its name, and the signal used, with its carrier and its codes, best
    first.

    range_error_m: RMS error of ranges from broadcast orbits and clocks [Montenbruck2018]. It
        applies to satellites that broadcast the system's usual accuracy, accuracy_m.
    """

    name: str
    signal: str
    hz: float
    codes: tuple[str, ...]
    range_error_m: float
    accuracy_m: float


SYSTEMS = {
    # On the carrier of B1I: the data code, under its present and its older name; both codes; the
    # pilot.
    "C": System("BeiDou", "B1I", B1I_HZ, ("C2I", "C1I", "C2X", "C2Q"), 1.0, 2.4),
    # P code if a receiver has no C/A code.
    "G": System("GPS", "L1 C/A", L1_HZ, ("C1C", "C1W", "C1P"), 0.6, 2.4),
    # Pilot, both components, data.
    "E": System("Galileo", "E1", L1_HZ, ("C1C", "C1X", "C1B"), 0.2, 3.12),
}
"""Systems by their letters in RINEX, in the order of a log's satellites. The clocks of later
systems have an offset from the first.
"""
OTHERS = {"R": "GLONASS", "J": "QZSS", "S": "SBAS", "I": "NavIC"}
"""Systems that files may contain but that are not used."""


@dataclass(frozen=True, eq=False)
class Observations:
    """A receiver's log.

    Attributes
    ----------
    path: of the file. marker: name of the station, may be empty. place: ``(3,)`` m, the marker's
        position in the header; None if the header has none. times: ``(T,)`` s of BDT, increasing.
        names: of the satellites, ``S``. code: pseudoranges ``(T, S)`` m. doppler: ``(T, S)`` Hz;
        both nan where nothing was measured. antenna: ``(3,)`` m, offset of the antenna from the
        marker: east, north, up. out_of_order: how many epochs were left out because their time is
        before or after the times of both neighbors. others: letters of systems in the file that are
        not in `SYSTEMS`. damaged: one message for each damaged epoch that was left out, with its
        line.
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
        """The observations of some of the epochs."""
        return replace(
            self, times=self.times[which], code=self.code[which], doppler=self.doppler[which]
        )

    def of(self, systems: str) -> Observations:
        """The observations of some satellite systems, given by their letters."""
        which = [s for s, name in enumerate(self.names) if name[0] in systems]
        return replace(
            self,
            names=[self.names[s] for s in which],
            code=self.code[:, which],
            doppler=self.doppler[:, which],
        )

    def reference(self, marker: ArrayLike | None = None) -> Array | None:
        """Position ``(3,)`` m of the antenna, where ranges are measured: the marker's position plus
        the antenna's offset.

        ``marker``: ``(3,)`` m; None: the header's. The result is None if neither is given.
        """
        place = self.place if marker is None else np.asarray(marker, dtype=np.float64)
        if place is None:
            return None
        latitude, longitude, _ = ecef2geodetic(*place, ell=ELLIPSOID, deg=False)
        return np.asarray(place + self.antenna @ local_axes(latitude, longitude))


@dataclass(frozen=True, eq=False)
class Navigation:
    """Broadcast sets, several for each satellite, sorted by reference time; and Klobuchar's
    coefficients, None if absent.

    path: of the file, or of several files. left_out: by satellite, how many sets are incomplete or
        have an impossible number. damaged: one message for each damaged set that was left out, with
        its line. unused: number of records of other systems or messages, by name.
    """

    path: Path | str
    sets: Broadcast
    klobuchar: tuple[Array, Array] | None
    left_out: dict[str, int] = field(default_factory=dict)
    damaged: tuple[str, ...] = ()
    unused: dict[str, int] = field(default_factory=dict)

    def check_times(self, files: str, times: Array) -> None:
        """Raise InputError naming the files unless the reference time of some set is within four
        hours of ``times``.
        """
        toe = self.sets.toe
        if (np.abs(toe[:, None] - times[[0, -1]]).min() > LONGEST_S) and not (
            (toe > times[0]) & (toe < times[-1])
        ).any():
            dates = [
                str(np.datetime64("2006-01-01T00:00:00") + np.timedelta64(round(t), "s"))
                for t in (times[0], times[-1], toe[0], toe[-1])
            ]
            raise InputError(
                "{}: expected orbits for the time of the observations, {} to {} BDT, got some "
                "for {} to {}; give the navigation file of that day".format(files, *dates)
            )

    def nearest(self, name: str, times: ArrayLike) -> Array:
        """Rows ``(...)`` of a satellite's sets with the reference times nearest to ``times``. -1:
        the satellite is unhealthy, or has no set within one hour (geostationary), four hours
        (Galileo) or two hours (others).
        """
        t = np.asarray(times, dtype=np.float64)
        number, system = int(name[1:]), SYSTEM_LETTERS.index(name[0])
        rows = np.flatnonzero((self.sets.number == number) & (self.sets.system == system))
        if not rows.size:
            return np.full(t.shape, -1)
        # Sorted by reference time; for equal times the first set is used.
        toe, first = np.unique(self.sets.toe[rows], return_index=True)
        after = np.clip(np.searchsorted(toe, t), 0, len(toe) - 1)
        before = np.maximum(after - 1, 0)
        nearest = np.where(np.abs(toe[before] - t) <= np.abs(toe[after] - t), before, after)
        best = rows[first[nearest]]
        most = LONGEST_S if system == GALILEO else 0.5 * LONGEST_S
        if self.sets.geostationary[rows[0]]:
            most = 0.25 * LONGEST_S
        good = (np.abs(toe[nearest] - t) <= most) & (self.sets.health[best] == 0.0)
        return np.where(good, best, -1)


def read_observations(path: str | Path, *, strict: bool = False) -> Observations:
    """Code and Doppler of B1I, L1 C/A and E1 from an observation file, plain, gzipped or in
    Hatanaka's compression.

    If a satellite has several codes on a carrier, the first available code of its `System` is used.
    A damaged epoch is left out completely and listed in ``damaged``.

    Raises
    ------
    InputError: if it is not an observation file of RINEX 2 to 4 with one of these signals, or if
        its header or most of its epochs are damaged. With ``strict`` one damaged epoch is enough.
        The message names file and line.
    OSError: if it cannot be read.
    """
    file = read_text(Path(path), "O")
    header, kinds = file.header, {letter: kinds_of(file, letter) for letter in SYSTEMS}
    pairs = {letter: _columns_of(file, letter, kinds[letter]) for letter in SYSTEMS}
    pairs = {letter: columns for letter, columns in pairs.items() if columns}
    types = header.get("SYS / # / OBS TYPES", [])
    if not pairs:
        got = ", ".join(f"{letter}: {' '.join(names)}" for letter, names in kinds.items() if names)
        raise InputError(
            f"{path}: expected BeiDou's B1I code (C2I or C2X), GPS's C1C or Galileo's E1 code (C1C "
            f"or C1X) among the observations, got {got or 'none of them'}"
        )
    default = "BDT" if file.system == "C" else "GPS"
    scale = header.get("TIME OF FIRST OBS", [""])[0][48:51].strip() or default
    if scale not in AHEAD_S:
        raise InputError(f"{path}: expected times in GPS, GAL or BDT, got {scale!r}")
    columns = {
        letter: sorted({c for pair in pairs[letter] for c in pair if c >= 0}) for letter in pairs
    }
    seconds, measured, damaged = measurements(file, columns, strict)
    names, ranges, rates = _by_satellite(len(seconds), measured, columns, pairs)
    if not np.isfinite(ranges).any():
        raise InputError(
            f"{path}: expected pseudoranges of BeiDou, GPS or Galileo satellites, got none"
        )
    between = np.ones(len(seconds), bool)
    before, here, after = seconds[:-2], seconds[1:-1], seconds[2:]
    between[1:-1] = ((before <= here) & (here <= after)) | (before >= after)
    order = np.flatnonzero(between)[np.argsort(seconds[between], kind="stable")]
    # An epoch that occurs twice is used once.
    rows = order[np.concatenate([[True], np.diff(seconds[order]) > 0.0])]
    letters = (line[0] for line in types if line[0].strip() and line[0] not in SYSTEMS)
    return Observations(
        Path(path),
        header.get("MARKER NAME", [""])[0].strip(),
        _place(Path(path), header),
        seconds[rows] - AHEAD_S[scale],
        names,
        ranges[rows],
        rates[rows],
        three_numbers(Path(path), header, "ANTENNA: DELTA H/E/N")[[1, 2, 0]],
        int((~between).sum()),
        "".join(dict.fromkeys(letters)),
        damaged,
    )


def _columns_of(file: File, letter: str, kinds: list[str]) -> list[tuple[int, int]]:
    """Columns of a system's codes, best first, each with the column of its Doppler (-1: none)."""
    system = SYSTEMS[letter]
    # Only version 3.02 used band 1 for B1I; since then band 1 is B1C's.
    older = ("C1X", "C1Q") if letter == "C" and file.version < 3.03 else ()
    codes = [code for code in (*system.codes, *older) if code in kinds]
    scaled = of_system(file.header.get("SYS / SCALE FACTOR", []), letter)
    if any(line[2:6].strip() not in ("", "1") for line in scaled):
        raise InputError(
            f"{file.called}: expected observations of {system.name} in their units, got a SYS / "
            "SCALE FACTOR"
        )
    rates = ["D" + code[1:] for code in codes]
    return [
        (kinds.index(code), kinds.index(rate) if rate in kinds else -1)
        for code, rate in zip(codes, rates, strict=True)
    ]


def _by_satellite(
    T: int,
    measured: Mapping[str, Measured],
    columns: Mapping[str, list[int]],
    pairs: Mapping[str, Sequence[tuple[int, int]]],
) -> tuple[list[str], Array, Array]:
    """Satellites ``S``, pseudoranges and Doppler ``(T, S)``, from the first available code of each
    row.
    """
    names = [str(name) for system in measured.values() for name in np.unique(system.names)]
    ranges, rates = np.full((2, T, len(names)), np.nan)
    for letter, system in measured.items():
        satellites, s = np.unique(system.names, return_inverse=True)
        s += names.index(satellites[0]) if satellites.size else 0
        missing = np.ones(len(system.names), bool)
        for code, doppler in pairs[letter]:
            values = system.values[:, columns[letter].index(code)]
            rows = missing & np.isfinite(values)
            ranges[system.epochs[rows], s[rows]] = values[rows]
            if doppler >= 0:
                rates[system.epochs[rows], s[rows]] = system.values[
                    rows, columns[letter].index(doppler)
                ]
            missing &= ~rows
    return names, ranges, rates


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
    "source",
    "",
    "",
    "accuracy",
    "health",
    "tgd",
    "second_tgd",
)
"""Order of a set's numbers in the file. Spare or unneeded numbers may be blank. Source and
second_tgd are Galileo's.
"""
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
"""Largest magnitudes that fit into the bits of a message [BDS-SIS-ICD-B1I-3.0]. Angles in a file
may include several turns.
"""
MOST_OF = {
    GPS: {"a1": 2.0**-28, "a2": 2.0**-48, "tgd": 2.0**-24},
    GALILEO: {"a0": 2.0**-4, "a1": 2.0**-26, "a2": 2.0**-54, "tgd": 2.0**-23},
}
"""Larger limits for messages of GPS and Galileo [IS-GPS-200; Galileo-OS-SIS-ICD]."""
LEAST = {"e": 0.0, "sqrt_a": 4096.0, "toe": 0.0}
"""Least values; no satellite of these systems is lower than 10,000 km."""
MOST_ALPHA, MOST_BETA = (
    2.0 ** np.array([-22.0, -19.0, -16.0, -16.0]),
    2.0 ** np.array([19.0, 22.0, 24.0, 24.0]),
)
"""Largest coefficients for the ionosphere: twice the largest value of eight bits [IS-GPS-200]."""


def read_navigation(path: str | Path, *more: str | Path, strict: bool = False) -> Navigation:
    """Broadcast sets for the satellites of `SYSTEMS` from one or several navigation files.

    Sets with a missing number, or a number that no message can contain, are left out and counted in
    ``left_out``. Damaged sets are left out and listed in ``damaged``. Other records are counted in
    ``unused``. The ionosphere's coefficients are from the first header that has them; in version 4
    they are a record.

    Raises
    ------
    InputError: if a file is not a navigation file of RINEX 2 to 4, if its header or most of its
        sets are damaged, or if no file has orbits. With ``strict`` one damaged set is enough. The
        message names file and line.
    OSError: if a file cannot be read.
    """
    read: list[Set] = []
    damaged: tuple[str, ...] = ()
    coefficients, unused = None, Counter[str]()
    for each in (path, *more):
        file = read_text(Path(each), "N")
        content = messages(file, "".join(SYSTEMS), strict)
        read, damaged = read + content.sets, damaged + content.damaged
        unused += Counter({_named(key): count for key, count in content.unused.items()})
        coefficients = coefficients or _klobuchar(each, file.header, content.klobuchar)
    files = Path(path) if not more else ", ".join(map(str, (path, *more)))
    if not read:
        others = ", ".join(f"{name} {count}" for name, count in unused.items())
        raise InputError(
            f"{files}: expected orbits of BeiDou, GPS or Galileo satellites, got none"
            + (f" (not used: {others})" if others else "")
        )
    values = _columns(read)
    credible = np.isfinite(values["health"])
    for name, most in MOST.items():
        bound = np.full(len(read), most)
        for system, its in MOST_OF.items():
            bound[values["system"] == system] = its.get(name, most)
        # Twice the range allows for rounding; blanks are nan and fail the comparison.
        bound *= 1.0 if name in LEAST else 2.0
        credible &= (np.abs(values[name]) <= bound) & (values[name] >= LEAST.get(name, -np.inf))
    if not credible.any():
        raise InputError(
            f"{files}: expected orbits, got {len(read)} sets that lack a number, or have one that "
            "no message can hold"
        )
    values["toe"] += WEEK_S * np.round((values["toc"] - values["toe"]) / WEEK_S)
    for name in ("toc", "toe"):
        values[name] -= ahead_s(values["system"])
    # For equal reference times I/NAV, which has the health of E1, comes before F/NAV.
    order = np.lexsort((values["fnav"], values["toe"]))
    order = order[credible[order]]
    chosen = Broadcast(**{field.name: values[field.name][order] for field in fields(Broadcast)})
    refused = Counter(read[k].name for k in np.flatnonzero(~credible))
    return Navigation(
        files, chosen, coefficients, dict(sorted(refused.items())), damaged, dict(unused)
    )


def _named(unused: str) -> str:
    """An unused record, with the name of its system."""
    letter, rest = unused[0], unused[1:]
    names = OTHERS | {letter: system.name for letter, system in SYSTEMS.items()}
    return names[letter] + rest


def _columns(read: list[Set]) -> dict[str, Array]:
    """Numbers of all sets by name; a blank clock acceleration or group delay is 0.

    Galileo's clock depends on the message: I/NAV has the clock for E1 and E5b, F/NAV the clock for
    E1 and E5a. Each message has a separate group delay, and the health of its signal
    [Galileo-OS-SIS-ICD].
    """
    numbers = np.array([each.numbers[: len(ORDER)] for each in read]).T
    out = {name: column for name, column in zip(ORDER, numbers, strict=True) if name}
    out |= {name: np.nan_to_num(out[name]) for name in ("a2", "tgd", "second_tgd", "source")}
    named = np.array(
        [[float(each.name[1:]), SYSTEM_LETTERS.index(each.name[0]), each.toc] for each in read]
    )
    out |= dict(zip(("number", "system", "toc"), named.T, strict=True))
    galileo = out["system"] == GALILEO
    source, bits = (
        np.where(galileo, np.nan_to_num(out[k]), 0.0).astype(int) for k in ("source", "health")
    )
    fnav = (source & F_NAV_CLOCK) > 0
    out["tgd"] = np.where(galileo & ~fnav, out["second_tgd"], out["tgd"])
    signal = np.where(fnav, E5A_HEALTH, E1_HEALTH)
    sick = ((bits & signal) > 0) | (out["accuracy"] < 0.0)
    out["health"] = np.where(galileo & np.isfinite(out["health"]), sick, out["health"])
    out["accuracy"] = np.maximum(np.nan_to_num(out["accuracy"]), 0.0)
    return out | {"fnav": fnav}


F_NAV_CLOCK = 1 << 8
"""Bit of Galileo's data source: if set, the clock is for E1 and E5a, else for E1 and E5b."""
E1_HEALTH, E5A_HEALTH = 0b000000111, 0b000111000
"""Bits of Galileo's health, of E1 and of E5a: validity of the data and status of the signal. A
predicted accuracy below 0 means that there is no prediction; such a satellite must not be used.
"""


def read_ionosphere(path: str | Path) -> tuple[Array, Array]:
    """Klobuchar's coefficients from a navigation file of RINEX 2 to 4; InputError naming the file
    if it has none.
    """
    file = read_text(Path(path), "N")
    message = messages(file, "", False).klobuchar if file.version >= 4.0 else None
    coefficients = _klobuchar(path, file.header, message)
    if coefficients is None:
        raise InputError(
            f"{path}: expected GPSA and GPSB in the header, got none; eight numbers may be given "
            "instead"
        )
    return coefficients


def ionosphere(called: str | Path, numbers: ArrayLike) -> tuple[Array, Array]:
    """Klobuchar's coefficients alpha and beta, each ``(4,)``, from eight numbers; InputError if no
    message can contain them.
    """
    alpha, beta = np.asarray(numbers, dtype=np.float64).reshape(2, 4)
    if not ((np.abs(alpha) <= MOST_ALPHA).all() and (np.abs(beta) <= MOST_BETA).all()):
        raise InputError(
            f"{called}: expected coefficients of the ionosphere that a message can hold, got "
            f"{alpha} and {beta}"
        )
    return alpha, beta


def _klobuchar(
    path: str | Path, header: dict[str, list[str]], message: list[float] | None
) -> tuple[Array, Array] | None:
    """Klobuchar's coefficients from a header, or from a message if the header has none."""
    rows = {line[:4]: line[5:53] for line in header.get("IONOSPHERIC CORR", [])}
    rows |= {
        f"GPS{k}": header[label][0][2:50]
        for k, label in (("A", "ION ALPHA"), ("B", "ION BETA"))
        if label in header
    }
    if not {"GPSA", "GPSB"} <= set(rows):
        return None if message is None else ionosphere(path, message)
    try:
        numbers = [
            finite_number(rows[k][i : i + 12]) for k in ("GPSA", "GPSB") for i in range(0, 48, 12)
        ]
    except ValueError:
        raise InputError(
            f"{path}: expected four numbers in GPSA and GPSB of the header, got {rows['GPSA']!r}"
        ) from None
    return ionosphere(path, numbers)
