"""Receiver logs: BeiDou's B1 code and Doppler from RINEX 3 observation files, broadcast orbits from navigation files.

Files in Hatanaka's compression are unpacked by hatanaka (``.venv/bin/pip install -c constraints.txt -e ".[rinex]"``). Times become
BDT seconds since 2006-01-01.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pymap3d import ecef2geodetic

from celnav.files import InputError
from celnav.gaussian.linalg import Array
from celnav.models.beidou import ELLIPSOID, GEO_NUMBERS, GPS_AHEAD_S, WEEK_S, Broadcast
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

BDT_BEGINNING = np.datetime64("2006-01-01T00:00:00", "ns")
AHEAD_S = {"BDT": 0.0, "GPS": GPS_AHEAD_S, "GAL": GPS_AHEAD_S}
"""How far time systems of observation files are ahead of BDT."""


@dataclass(frozen=True)
class Observations:
    """A receiver's log.

    Attributes
    ----------
    path: of the file. marker: name of the station, may be empty. place: ``(3,)`` m of the marker by the header; None if it has
        none. times: ``(T,)`` s of BDT, increasing. names: of the satellites, ``S``. code: pseudoranges ``(T, S)`` m;
        doppler: ``(T, S)`` Hz; nan where nothing was measured. antenna: ``(3,)`` m east, north and up of the marker.
        out_of_order: how many epochs were left out, as their time lies before or after those of both their neighbors.
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

    def part(self, which: Array | slice) -> Observations:
        """Some of the epochs."""
        return replace(self, times=self.times[which], code=self.code[which], doppler=self.doppler[which])

    def reference(self, marker: ArrayLike | None = None) -> Array | None:
        """Position ``(3,)`` m of the antenna, whose position ranges tell: that of the marker (None: the header's) and its offset.

        None if neither has been given.
        """
        place = self.place if marker is None else np.asarray(marker, dtype=np.float64)
        if place is None:
            return None
        latitude, longitude, _ = ecef2geodetic(*place, ell=ELLIPSOID, deg=False)
        return np.asarray(place + self.antenna @ local_axes(latitude, longitude))


@dataclass(frozen=True)
class Navigation:
    """Broadcast sets, several of each satellite, by their reference times; Klobuchar's coefficients, None if absent.

    ``left_out``: how many sets of a satellite are not whole, or hold what no message can.
    """

    path: Path
    sets: Broadcast
    klobuchar: tuple[Array, Array] | None
    left_out: dict[str, int] = field(default_factory=dict)

    def nearest(self, name: str, times: ArrayLike) -> Array:
        """Rows ``(...)`` of a satellite's sets of the nearest reference times; -1: not well, or not within an hour (GEO) or two."""
        t = np.asarray(times, dtype=np.float64)
        number = int(name[1:])
        rows = np.flatnonzero(self.sets.number == number)
        if not rows.size:
            return np.full(t.shape, -1)
        away = np.abs(self.sets.toe[rows] - t[..., None])
        best = rows[away.argmin(-1)]
        good = (away.min(-1) <= (3600.0 if number in GEO_NUMBERS else 7200.0)) & (self.sets.health[best] == 0.0)
        return np.where(good, best, -1)


def b1_codes(version: float) -> list[str]:
    """Codes of B1I's carrier by their RINEX names, the best first: of the data, of both components, of the other.

    Version 3.02 alone called this band 1, which is B1C's since.
    """
    return ["C2I", "C1I", "C2X", "C2Q"] + (["C1X", "C1Q"] if version < 3.03 else [])


def read_observations(path: str | Path) -> Observations:
    """B1I code and Doppler of an observation file, plain, gzipped or in Hatanaka's compression.

    Where a satellite has several codes of this carrier, the first of `b1_codes` that is there is taken.

    Raises
    ------
    InputError: naming file and line, if it is no whole RINEX 3 observation file with BeiDou's B1I. OSError: if it cannot be read.
    """
    file = Path(path)
    text, called = unpacked(file)
    header, start = header_of(called, text, "O")
    kinds = kinds_of(called, header, "C")
    codes = [code for code in b1_codes(float(text[:9])) if code in kinds]
    if not codes:
        got = ", ".join(kinds) or "no BeiDou"
        raise InputError(f"{file}: expected BeiDou's B1I code (C2I or C2X) among the observations, got {got}")
    if any(line[2:6].strip() not in ("", "1") for line in of_system(header.get("SYS / SCALE FACTOR", []), "C")):
        raise InputError(f"{file}: expected BeiDou's observations in their units, got a SYS / SCALE FACTOR")
    default = "BDT" if text[40:41] == "C" else "GPS"
    system = header.get("TIME OF FIRST OBS", [""])[0][48:51].strip() or default
    if system not in AHEAD_S:
        raise InputError(f"{file}: expected times in GPS, GAL or BDT, got {system!r}")
    places = [(kinds.index(code), kinds.index("D" + code[1:]) if "D" + code[1:] in kinds else -1) for code in codes]
    names, seconds, ranges, rates = _measured(list(epochs(called, text, start)), places)
    if not np.isfinite(ranges).any():
        raise InputError(f"{file}: expected pseudoranges of BeiDou satellites, got none")
    between = np.ones(len(seconds), bool)
    before, here, after = seconds[:-2], seconds[1:-1], seconds[2:]
    between[1:-1] = ((before <= here) & (here <= after)) | (before >= after)
    order = np.flatnonzero(between)[np.argsort(seconds[between], kind="stable")]
    kept = order[np.concatenate([[True], np.diff(seconds[order]) > 0.0])]  # an epoch that is there twice counts once
    return Observations(
        file, header.get("MARKER NAME", [""])[0].strip(), _place(file, header), seconds[kept] - AHEAD_S[system], names,
        ranges[kept], rates[kept], three_numbers(file, header, "ANTENNA: DELTA H/E/N")[[1, 2, 0]], int((~between).sum()),
    )  # fmt: skip


def _measured(log: list[Measured], places: Sequence[tuple[int, int]]) -> tuple[list[str], Array, Array, Array]:
    """Satellites ``S``, times ``(T,)``, pseudoranges and Doppler ``(T, S)``; ``places`` of codes and their Doppler, -1: none."""
    names = sorted({name for epoch in log for name in epoch.fields})
    column = {name: s for s, name in enumerate(names)}
    ranges, rates = np.full((2, len(log), len(names)), np.nan)
    for k, epoch in enumerate(log):
        for name, values in epoch.fields.items():
            for code, doppler in places:
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
    "a0", "a1", "a2", "", "crs", "delta_n", "M0", "cuc", "e", "cus", "sqrt_a", "toe", "cic", "Omega0", "cis", "i0", "crc", "omega",
    "Omega_dot", "i_dot", "", "", "", "", "health", "tgd",
)  # fmt: skip
"""Of a set's numbers in the file; what is spare, or not needed, may be blank."""
TURNS = 200.0 * np.pi
MOST = {
    "a0": 2.0**-10, "a1": 2.0**-29, "a2": 2.0**-56, "crs": 2048.0, "crc": 2048.0, "cuc": 2.0**-14, "cus": 2.0**-14,
    "cic": 2.0**-14, "cis": 2.0**-14, "delta_n": 2.0**-28 * np.pi, "Omega_dot": 2.0**-20 * np.pi, "i_dot": 2.0**-30 * np.pi,
    "M0": TURNS, "Omega0": TURNS, "omega": TURNS, "i0": TURNS, "e": 0.5, "sqrt_a": 8192.0, "tgd": 5.12e-8, "toe": WEEK_S,
}  # fmt: skip
"""What the message has room for (either sign), by its bits [BDS-SIS-ICD-B1I-3.0]; angles in a file may have turned often."""
LEAST = {"e": 0.0, "sqrt_a": 4096.0, "toe": 0.0}
"""No satellite of BeiDou is lower than 10,000 km."""
MOST_ALPHA, MOST_BETA = 2.0 ** np.array([-22.0, -19.0, -16.0, -16.0]), 2.0 ** np.array([19.0, 22.0, 24.0, 24.0])
"""Likewise of the ionosphere's coefficients, twice what their eight bits hold [IS-GPS-200]."""


def read_navigation(path: str | Path) -> Navigation:
    """Broadcast sets of BeiDou's satellites from a navigation file.

    Sets that lack a number, or have one that no message can hold, are left out and counted.

    Raises
    ------
    InputError: naming file and line, if it is no RINEX 3 navigation file with BeiDou's orbits. OSError: if it cannot be read.
    """
    file = Path(path)
    text, called = unpacked(file)
    header, start = header_of(called, text, "N")
    read = list(sets(called, text, start))
    if not read:
        raise InputError(f"{file}: expected orbits of BeiDou satellites, got none")
    given = _columns(read)
    credible = np.ones(len(read), bool)
    for name, most in MOST.items():
        # Twice the range leaves room for what is rounded; blanks are nan, and fail.
        credible &= (np.abs(given[name]) <= (most if name in LEAST else 2.0 * most)) & (given[name] >= LEAST.get(name, -np.inf))
    credible &= np.isfinite(given["health"])
    if not credible.any():
        raise InputError(
            f"{file}: expected orbits of BeiDou satellites, got {len(read)} sets that lack a number, or have one that no message "
            "can hold"
        )
    given["toe"] += WEEK_S * np.round((given["toc"] - given["toe"]) / WEEK_S)
    order = np.flatnonzero(credible)[np.argsort(given["toe"][credible], kind="stable")]
    chosen = Broadcast(**{part.name: given[part.name][order] for part in fields(Broadcast)})
    refused = Counter(read[k].name for k in np.flatnonzero(~credible))
    return Navigation(file, chosen, _klobuchar(file, header), dict(sorted(refused.items())))


def _columns(read: list[Set]) -> dict[str, Array]:
    """Numbers of all sets by name; a blank clock acceleration or group delay is none."""
    numbers = np.array([one.numbers[: len(ORDER)] for one in read]).T
    out = {name: column for name, column in zip(ORDER, numbers, strict=True) if name}
    out |= {name: np.nan_to_num(out[name]) for name in ("a2", "tgd")}
    return out | {"number": np.array([float(one.name[1:]) for one in read]), "toc": np.array([one.toc for one in read])}


def _klobuchar(path: Path, header: dict[str, list[str]]) -> tuple[Array, Array] | None:
    rows = {line[:4]: line[5:53] for line in header.get("IONOSPHERIC CORR", [])}
    if not {"GPSA", "GPSB"} <= set(rows):
        return None
    try:
        alpha, beta = (np.array([finite_number(rows[k][i : i + 12]) for i in range(0, 48, 12)]) for k in ("GPSA", "GPSB"))
    except ValueError:
        raise InputError(f"{path}: expected four numbers in GPSA and GPSB of the header, got {rows['GPSA']!r}") from None
    if (np.abs(alpha) > MOST_ALPHA).any() or (np.abs(beta) > MOST_BETA).any():
        raise InputError(f"{path}: expected coefficients that a message can hold in GPSA and GPSB, got {alpha} and {beta}")
    return alpha, beta
