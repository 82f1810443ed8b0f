"""Receiver logs: BeiDou's B1I code and Doppler from RINEX 3 observation files, broadcast orbits from navigation files.

Read by georinex and, where a file is compressed in Hatanaka's way, hatanaka (``pip install "celnav[rinex]"``). What is checked
here is what they do not tell: which file, and which line. Times become BDT seconds since 2006-01-01.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pymap3d import ecef2geodetic

from celnav.files import InputError
from celnav.linalg import Array
from celnav.models.beidou import ELLIPSOID, GEO_NUMBERS, GPS_AHEAD_S, WEEK_S, Broadcast
from celnav.models.pseudorange import local_axes
from celnav.models.receiver import on_earth
from celnav.rinex_text import epochs_alone, header_of, imported, of_system, sets_alone, three_numbers, unpacked

BDT_BEGINNING = np.datetime64("2006-01-01T00:00:00", "ns")
AHEAD_S = {"BDT": 0.0, "GPS": GPS_AHEAD_S, "GAL": GPS_AHEAD_S}
"""How far time systems of observation files are ahead of BDT."""


@dataclass(frozen=True)
class Observations:
    """A receiver's log.

    Attributes
    ----------
    path: of the file. marker: name of the station, may be empty. position: ``(3,)`` m of the antenna by the header; None if it has
        none. times: ``(T,)`` s of BDT, increasing. names: of the satellites, ``S``. code: pseudoranges ``(T, S)`` m;
        doppler: ``(T, S)`` Hz; nan where nothing was measured.
    """

    path: Path
    marker: str
    position: Array | None
    times: Array
    names: list[str]
    code: Array
    doppler: Array

    def part(self, which: Array | slice) -> Observations:
        """Some of the epochs."""
        return replace(self, times=self.times[which], code=self.code[which], doppler=self.doppler[which])


@dataclass(frozen=True)
class Navigation:
    """Broadcast sets, several of each satellite, by their reference times; Klobuchar's coefficients, None if absent."""

    path: Path
    sets: Broadcast
    klobuchar: tuple[Array, Array] | None

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


def _load(path: Path, text: str, **options: Any) -> Any:
    georinex = imported("georinex")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of xarray, about itself
        try:
            return georinex.load(io.StringIO(text), use="C", **options)
        except Exception as error:  # whatever it meets in a damaged file
            raise InputError(f"{path}: cannot be read as RINEX 3 ({type(error).__name__}: {error})") from None


def _seconds(times: Any) -> Array:
    return np.asarray((np.asarray(times, "datetime64[ns]") - BDT_BEGINNING) / np.timedelta64(1, "ns") * 1e-9)


def read_observations(path: str | Path) -> Observations:
    """B1I code and Doppler of an observation file, plain, gzipped or in Hatanaka's compression.

    Raises
    ------
    InputError: naming file and line, if it is no whole RINEX 3 observation file with BeiDou's B1I. OSError: if it cannot be read.
    """
    file = Path(path)
    text, called = unpacked(file)
    header = header_of(called, text, "O")
    kinds = " ".join(line[6:] for line in of_system(header.get("SYS / # / OBS TYPES", []), "C")).split()
    code = next((c for c in ("C2I", "C1I") if c in kinds), None)
    if code is None:
        raise InputError(f"{file}: expected BeiDou's B1I code (C2I) among the observations, got {', '.join(kinds) or 'no BeiDou'}")
    if any(line[2:6].strip() not in ("", "1") for line in of_system(header.get("SYS / SCALE FACTOR", []), "C")):
        raise InputError(f"{file}: expected BeiDou's observations in their units, got a SYS / SCALE FACTOR")
    doppler = "D" + code[1:]
    names, seconds, ranges, rates = _measured(file, epochs_alone(called, text), code, doppler if doppler in kinds else None)
    default = "BDT" if text[40:41] == "C" else "GPS"
    system = header.get("TIME OF FIRST OBS", [""])[0][48:51].strip() or default
    if system not in AHEAD_S:
        raise InputError(f"{file}: expected times in GPS, GAL or BDT, got {system!r}")
    if not names or not np.isfinite(ranges).any():
        raise InputError(f"{file}: expected pseudoranges of BeiDou satellites, got none")
    order = np.argsort(seconds, kind="stable")
    kept = order[np.concatenate([[True], np.diff(seconds[order]) > 0.0])]  # an epoch that is there twice counts once
    marker = header.get("MARKER NAME", [""])[0].strip()
    return Observations(file, marker, _position(file, header), seconds[kept] - AHEAD_S[system], names, ranges[kept], rates[kept])


AT_ONCE = 100
"""Epochs for georinex: it joins them one by one, in a time that grows with the square of their number."""


def _measured(path: Path, text: str, code: str, doppler: str | None) -> tuple[list[str], Array, Array, Array]:
    """Satellites ``S``, times ``(T,)`` in the file's system, pseudoranges and Doppler ``(T, S)``, in the order of the file."""
    lines = text.rstrip("\n").split("\n")
    begin = [k for k, line in enumerate(lines) if line.startswith(">")]
    if not begin:
        return [], np.empty(0), np.empty((0, 0)), np.empty((0, 0))
    ends = [*begin[AT_ONCE::AT_ONCE], len(lines)]
    parts = []
    for first, last in zip([begin[0], *ends], ends, strict=False):
        some = "\n".join([*lines[: begin[0]], *lines[first:last]]) + "\n"
        data = _load(path, some, meas=[code] if doppler is None else [code, doppler])
        if code not in data:
            raise InputError(f"{path}: expected pseudoranges of BeiDou satellites, got none")
        parts.append(data)
    names = sorted({str(name) for data in parts for name in data.sv.values})
    ranges: list[Array] = []
    rates: list[Array] = []
    for data in parts:
        columns = [names.index(str(name)) for name in data.sv.values]
        for kind, rows in ((code, ranges), (doppler, rates)):
            block = np.full((len(data.time), len(names)), np.nan)
            if kind in data:
                block[:, columns] = np.asarray(data[kind].values, float)
            rows.append(block)
    times = np.concatenate([_seconds(data.time.values) for data in parts])
    return names, times, np.concatenate(ranges), np.concatenate(rates)


def _position(path: Path, header: dict[str, list[str]]) -> Array | None:
    """Position of the antenna: that of the marker, raised by the offset; None if there is none."""
    marker = three_numbers(path, header, "APPROX POSITION XYZ")
    up, east, north = three_numbers(path, header, "ANTENNA: DELTA H/E/N")
    if not marker.any():
        return None
    try:
        on_earth("APPROX POSITION XYZ", marker)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    latitude, longitude, _ = ecef2geodetic(*marker, ell=ELLIPSOID, deg=False)
    return np.asarray(marker + np.array([east, north, up]) @ local_axes(latitude, longitude))


FIELDS = {
    "sqrt_a": "sqrtA", "e": "Eccentricity", "i0": "Io", "Omega0": "Omega0", "omega": "omega", "M0": "M0", "delta_n": "DeltaN",
    "Omega_dot": "OmegaDot", "i_dot": "IDOT", "cuc": "Cuc", "cus": "Cus", "crc": "Crc", "crs": "Crs", "cic": "Cic", "cis": "Cis",
    "a0": "SVclockBias", "a1": "SVclockDrift", "a2": "SVclockDriftRate", "tgd": "TGD1", "health": "SatH1",
}  # fmt: skip


def read_navigation(path: str | Path) -> Navigation:
    """Broadcast sets of BeiDou's satellites from a navigation file.

    Raises
    ------
    InputError: naming file and line, if it is no RINEX 3 navigation file with BeiDou's orbits. OSError: if it cannot be read.
    """
    file = Path(path)
    text, called = unpacked(file)
    header = header_of(called, text, "N")
    data = _load(file, sets_alone(called, text))
    if "sqrtA" not in data:
        raise InputError(f"{file}: expected orbits of BeiDou satellites, got none")
    there = np.isfinite(np.asarray(data["sqrtA"].values, float))
    when, which = np.nonzero(there)
    if not when.size:
        raise InputError(f"{file}: expected orbits of BeiDou satellites, got none")
    columns = {ours: np.asarray(data[theirs].values, float)[when, which] for ours, theirs in FIELDS.items()}
    # georinex counts a satellite that is there twice at a time as another one: C05_1.
    number = np.array([float(str(name)[1:3]) for name in data.sv.values[which]])
    toc = _seconds(data.time.values[when])
    toe = np.asarray(data["Toe"].values, float)[when, which]
    toe = toe + WEEK_S * np.round((toc - toe) / WEEK_S)
    columns = {name: np.nan_to_num(values) if name in ("tgd", "a2") else values for name, values in columns.items()}
    whole = np.isfinite(np.stack(list(columns.values()))).all(0) & np.isfinite(toe)
    given = columns | {"number": number, "toc": toc, "toe": toe}
    order = np.flatnonzero(whole)[np.argsort(toe[whole], kind="stable")]
    try:
        sets = Broadcast(**{field.name: given[field.name][order] for field in fields(Broadcast)})
    except ValueError as error:
        raise InputError(f"{file}: expected orbits of satellites: {error}") from None
    return Navigation(file, sets, _klobuchar(file, header))


def _klobuchar(path: Path, header: dict[str, list[str]]) -> tuple[Array, Array] | None:
    rows = {line[:4]: line[5:53] for line in header.get("IONOSPHERIC CORR", [])}
    if not {"GPSA", "GPSB"} <= set(rows):
        return None
    try:
        alpha, beta = (
            np.array([float(rows[k][12 * i : 12 * i + 12].replace("D", "E")) for i in range(4)]) for k in ("GPSA", "GPSB")
        )
    except ValueError:
        raise InputError(f"{path}: expected four numbers in GPSA and GPSB of the header, got {rows['GPSA']!r}") from None
    return alpha, beta
