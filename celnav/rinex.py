"""Receiver logs: BeiDou's B1I code and Doppler from RINEX 3 observation files, broadcast orbits from navigation files.

Read by georinex and, where a file is compressed in Hatanaka's way, hatanaka (``pip install "celnav[rinex]"``). What is checked
here is what they do not tell: which file, and which line. Times become BDT seconds since 2006-01-01.
"""

from __future__ import annotations

import gzip
import io
import warnings
import zlib
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.files import InputError
from celnav.linalg import Array
from celnav.models.beidou import GEO_NUMBERS, GPS_AHEAD_S, WEEK_S, Broadcast

BDT_BEGINNING = np.datetime64("2006-01-01T00:00:00", "ns")
LARGEST_BYTES = 2_000_000_000
"""Of a file, unpacked: a day of a station at a second's rate is a tenth of that."""
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
        """Rows ``(...)`` of a satellite's sets of the nearest reference times; -1: none is well and within an hour (GEO) or two."""
        t = np.asarray(times, dtype=np.float64)
        number = int(name[1:])
        rows = np.flatnonzero((self.sets.number == number) & (self.sets.health == 0.0))
        if not rows.size:
            return np.full(t.shape, -1)
        away = np.abs(self.sets.toe[rows] - t[..., None])
        best = rows[away.argmin(-1)]
        return np.where(away.min(-1) <= (3600.0 if number in GEO_NUMBERS else 7200.0), best, -1)


def _text(path: Path) -> str:
    """The unpacked text of a RINEX file."""
    try:
        raw = path.read_bytes()
        if raw[:2] == b"\x1f\x8b":
            with gzip.open(io.BytesIO(raw)) as file:
                raw = file.read(LARGEST_BYTES + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: expected a whole gzip file ({error})") from None
    if len(raw) > LARGEST_BYTES:
        raise InputError(f"{path}: expected at most {LARGEST_BYTES:,} bytes when unpacked")
    if not raw.strip(b"\0 \r\n\t"):
        raise InputError(f"{path}: expected a RINEX file, got an empty one")
    first = raw.lstrip(b"\xef\xbb\xbf").split(b"\n", 1)[0]
    if b"CRINEX" in first[60:]:
        import hatanaka

        try:
            raw = hatanaka.decompress(raw)
        except Exception as error:  # whatever it meets in a damaged file
            line = str(error).strip().splitlines()[-1] if str(error).strip() else type(error).__name__
            raise InputError(f"{path}: expected a whole file in Hatanaka's compression ({line})") from None
    text = raw.decode("ascii", errors="replace").lstrip("\ufeff").replace("\ufffd", "").replace("\0", "")
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n"


def _header(path: Path, text: str, kind: str) -> dict[str, list[str]]:
    """Header lines by label; the file is one of ``kind``, "O" or "N"."""
    lines = text.split("\n")
    words = {"O": "an observation file", "N": "a navigation file"}
    if len(lines[0]) < 60 or "RINEX VERSION" not in lines[0][60:]:
        raise InputError(f"{path}, line 1: expected RINEX VERSION / TYPE, got {lines[0][:40]!r}")
    try:
        version = float(lines[0][:9])
    except ValueError:
        raise InputError(f"{path}, line 1: expected a version number, got {lines[0][:9]!r}") from None
    if not 3.0 <= version < 4.0:
        raise InputError(f"{path}, line 1: expected RINEX 3, got version {version:g}")
    if lines[0][20:21] != kind:
        raise InputError(f"{path}, line 1: expected {words[kind]}, got {lines[0][20:40].strip()!r}")
    if lines[0][40:41] not in ("C", "M", " ", ""):
        raise InputError(f"{path}, line 1: expected BeiDou (C) or mixed (M) data, got system {lines[0][40:41]!r}")
    header: dict[str, list[str]] = {}
    for line in lines:
        label = line[60:].strip()
        header.setdefault(label, []).append(line[:60])
        if label == "END OF HEADER":
            return header
    raise InputError(f"{path}, line {len(lines) - 1}: expected END OF HEADER before the end of the file")


def _load(path: Path, text: str, **options: Any) -> Any:
    import georinex

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
    text = _text(file)
    header = _header(file, text, "O")
    kinds = " ".join(line[6:] for line in _of_system(header.get("SYS / # / OBS TYPES", []), "C")).split()
    code = next((c for c in ("C2I", "C1I") if c in kinds), None)
    if code is None:
        raise InputError(f"{file}: expected BeiDou's B1I code (C2I) among the observations, got {', '.join(kinds) or 'no BeiDou'}")
    doppler = "D" + code[1:]
    data = _load(file, _beidou_alone(file, text), meas=[code, doppler] if doppler in kinds else [code])
    system = header.get("TIME OF FIRST OBS", [" " * 60])[0][48:51].strip() or "GPS"
    if system not in AHEAD_S:
        raise InputError(f"{file}: expected times in GPS, GAL or BDT, got {system!r}")
    order = np.argsort(data.time.values, kind="stable")
    times = _seconds(data.time.values[order]) - AHEAD_S[system]
    names = [str(name) for name in data.sv.values]
    ranges = np.asarray(data[code].values, float)[order]
    rates = np.asarray(data[doppler].values, float)[order] if doppler in data else np.full_like(ranges, np.nan)
    if not names or not np.isfinite(ranges).any():
        raise InputError(f"{file}: expected pseudoranges of BeiDou satellites, got none")
    kept = np.concatenate([[True], np.diff(times) > 0.0])  # an epoch that is there twice counts once
    return Observations(
        file, header.get("MARKER NAME", [""])[0].strip(), _position(header), times[kept], names, ranges[kept], rates[kept]
    )


def _of_system(lines: list[str], system: str) -> list[str]:
    """Header lines of one system with their continuations."""
    out, current = [], ""
    for line in lines:
        current = line[:1].strip() or current
        if current == system:
            out.append(line)
    return out


def _beidou_alone(path: Path, text: str) -> str:
    """The text with the lines of BeiDou's satellites alone, checked that every epoch has as many lines as it says."""
    lines = text.rstrip("\n").split("\n")
    start = next(i for i, line in enumerate(lines) if line[60:].strip() == "END OF HEADER") + 1
    k, kept = start, lines[:start]
    while k < len(lines):
        line = lines[k]
        if not line.startswith(">"):
            raise InputError(f"{path}, line {k + 1}: expected an epoch (>), got {line[:40]!r}")
        try:
            count = int(line[32:35])
        except ValueError:
            raise InputError(f"{path}, line {k + 1}: expected the number of satellites of an epoch, got {line[32:35]!r}") from None
        if k + count >= len(lines):
            raise InputError(f"{path}, line {len(lines)}: expected {count} satellites after line {k + 1}, the file is cut off")
        own = [row for row in lines[k + 1 : k + count + 1] if row[:1] == "C"]
        if own:
            kept += [f"{line[:32]}{len(own):3d}{line[35:]}", *own]
        k += count + 1
    if k == start:
        raise InputError(f"{path}, line {start}: expected observations after the header, got none")
    return "\n".join(kept) + "\n"


def _position(header: dict[str, list[str]]) -> Array | None:
    """Position of the antenna: that of the marker, raised by the offset."""
    lines = header.get("APPROX POSITION XYZ")
    if not lines:
        return None
    marker = np.array([float(part) for part in lines[0].split()[:3]])
    if not marker.any():
        return None
    up, east, north = (float(part) for part in header.get("ANTENNA: DELTA H/E/N", ["0 0 0"])[0].split()[:3])
    from pymap3d import ecef2geodetic

    from celnav.models.pseudorange import local_axes

    latitude, longitude, _ = ecef2geodetic(*marker, deg=False)
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
    text = _text(file)
    header = _header(file, text, "N")
    data = _load(file, text)
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
    sets = Broadcast(**{field.name: given[field.name][order] for field in fields(Broadcast)})
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
