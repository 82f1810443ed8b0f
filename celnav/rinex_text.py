"""RINEX files as text: unpacked, their headers, and BeiDou's lines alone, each checked: damage is told by its line."""

from __future__ import annotations

import gzip
import io
import zlib
from datetime import UTC, datetime
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from celnav.files import InputError
from celnav.linalg import Array

LARGEST_BYTES = 2_000_000_000
"""Of a file, unpacked: a day of a station at a second's rate is a tenth of that."""
SET_LINES = 8
"""Of a broadcast set."""


def unpacked(path: Path) -> tuple[str, str]:
    """The unpacked text of a RINEX file, and what to call it when a line is told."""
    called = str(path)
    try:
        raw = path.read_bytes()
        if raw[:2] == b"\x1f\x8b":
            called = f"{path}, unpacked"
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
        called = f"{path}, unpacked"
        hatanaka = imported("hatanaka")
        try:
            raw = hatanaka.decompress(raw)
        except Exception as error:  # whatever it meets in a damaged file
            line = str(error).strip().splitlines()[-1] if str(error).strip() else type(error).__name__
            raise InputError(f"{path}: expected a whole file in Hatanaka's compression ({line})") from None
    text = raw.removeprefix(b"\xef\xbb\xbf").decode("latin-1").replace("\0", "")
    text = "".join(c if c.isascii() else "?" for c in text) if not text.isascii() else text  # a letter is a column
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n", called


def imported(name: str) -> Any:
    """A package that only receiver logs need; ImportError says how to get it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f'{error}; receiver logs need it: pip install "celnav[rinex]"') from None


def header_of(called: str, text: str, kind: str) -> dict[str, list[str]]:
    """Header lines by label; the file is one of ``kind``, "O" or "N"."""
    lines = text.split("\n")
    words = {"O": "an observation file", "N": "a navigation file"}
    if len(lines[0]) < 60 or "RINEX VERSION" not in lines[0][60:]:
        raise InputError(f"{called}, line 1: expected RINEX VERSION / TYPE, got {lines[0][:40]!r}")
    try:
        version = float(lines[0][:9])
    except ValueError:
        raise InputError(f"{called}, line 1: expected a version number, got {lines[0][:9]!r}") from None
    if not 3.0 <= version < 4.0:
        raise InputError(f"{called}, line 1: expected RINEX 3, got version {version:g}")
    if lines[0][20:21] != kind:
        raise InputError(f"{called}, line 1: expected {words[kind]}, got {lines[0][20:40].strip()!r}")
    if lines[0][40:41] not in ("C", "M", " ", ""):
        raise InputError(f"{called}, line 1: expected BeiDou (C) or mixed (M) data, got system {lines[0][40:41]!r}")
    header: dict[str, list[str]] = {}
    for line in lines:
        label = line[60:].strip()
        header.setdefault(label, []).append(line[:60])
        if label == "END OF HEADER":
            return header
    raise InputError(f"{called}, line {len(lines) - 1}: expected END OF HEADER before the end of the file")


def of_system(lines: list[str], system: str) -> list[str]:
    """Header lines of one system with their continuations."""
    out, current = [], ""
    for line in lines:
        current = line[:1].strip() or current
        if current == system:
            out.append(line)
    return out


def epochs_alone(called: str, text: str) -> str:
    """The text with the lines of BeiDou's satellites alone, every epoch and line of them checked; events are left out."""
    lines = text.rstrip("\n").split("\n")
    start = next(i for i, line in enumerate(lines) if line[60:].strip() == "END OF HEADER") + 1
    k, kept = start, lines[:start]
    while k < len(lines):
        flag, count = _epoch(called, k, lines[k])
        if k + count >= len(lines):
            raise InputError(f"{called}, line {len(lines)}: expected {count} more after line {k + 1}, the file is cut off")
        rows = lines[k + 1 : k + count + 1]
        if flag <= 1:
            own = [_satellite(called, k + 1 + i, row) for i, row in enumerate(rows) if row[:1] == "C"]
            if own:
                kept += [f"{lines[k][:32]}{len(own):3d}{lines[k][35:]}", *own]
        else:
            for i, row in enumerate(rows):
                if row[60:].strip() in ("SYS / # / OBS TYPES", "SYS / SCALE FACTOR"):
                    raise InputError(
                        f"{called}, line {k + 2 + i}: expected observations of one kind, got another {row[60:].strip()}"
                    )
        k += count + 1
    if k == start:
        raise InputError(f"{called}, line {start}: expected observations after the header, got none")
    return "\n".join(kept) + "\n"


def _epoch(called: str, k: int, line: str) -> tuple[int, int]:
    """Flag and number of lines of an epoch or event; the date of an epoch is checked."""
    if not line.startswith(">"):
        raise InputError(f"{called}, line {k + 1}: expected an epoch (>), got {line[:40]!r}")
    try:
        flag, count = int(line[31:32]), int(line[32:35])
        if count < 0:
            raise ValueError
        if flag <= 1:
            second = float(line[18:29])
            year, month, day, hour, minute = (int(line[i:j]) for i, j in ((2, 6), (7, 9), (10, 12), (13, 15), (16, 18)))
            datetime(year, month, day, hour, minute, int(second), tzinfo=UTC)
    except ValueError:
        raise InputError(f"{called}, line {k + 1}: expected date, flag and number of an epoch, got {line[:35]!r}") from None
    return flag, count


def _satellite(called: str, k: int, row: str) -> str:
    """A satellite's line, whole to the end of a field."""
    name = row[:3].replace(" ", "0")
    if not name[1:].isdigit():
        raise InputError(f"{called}, line {k + 1}: expected a satellite (C01), got {row[:3]!r}")
    if (len(row) - 3) % 16 not in (0, 14, 15):
        raise InputError(f"{called}, line {k + 1}: expected fields of 16 columns, the last one is cut off")
    for i in range(3, len(row), 16):
        field = row[i : i + 14].strip()
        try:
            float(field or "0")
        except ValueError:
            raise InputError(f"{called}, line {k + 1}: expected a number, got {field!r}") from None
    return name + row[3:]


def three_numbers(path: Path, header: dict[str, list[str]], label: str) -> Array:
    """Three numbers of a header line; zeros if it is absent or blank."""
    given = header.get(label, [""])[0]
    try:
        values = np.array([float(part) for part in given.split()] or [0.0, 0.0, 0.0])
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InputError(f"{path}: expected three numbers in {label}, got {given.strip()!r}")
    return values


def sets_alone(called: str, text: str) -> str:
    """The text with BeiDou's sets alone, checked that each has all its lines and that these are numbers."""
    lines = text.rstrip("\n").split("\n")
    start = next(i for i, line in enumerate(lines) if line[60:].strip() == "END OF HEADER") + 1
    heads = [k for k in range(start, len(lines)) if lines[k][:1].strip()]
    kept = lines[:start]
    for k, end in pairwise([*heads, len(lines)]):
        if lines[k][:1] != "C":
            continue
        if end - k != SET_LINES:
            raise InputError(
                f"{called}, line {end}: expected {SET_LINES} lines of a broadcast set from line {k + 1}, got {end - k}"
            )
        for i in range(k, end):
            _numbers(called, i, lines[i][23:] if i == k else lines[i][4:])
        kept += lines[k:end]
    if len(kept) == start:
        raise InputError(f"{called}, line {len(lines)}: expected orbits of BeiDou satellites, got none")
    return "\n".join(kept) + "\n"


def _numbers(called: str, k: int, line: str) -> None:
    """Fields of 19 columns, each blank or a whole number with its exponent."""
    for i in range(0, len(line), 19):
        field = line[i : i + 19].strip().replace("D", "E").replace("d", "e")
        try:
            float(field or "0")
        except ValueError:
            raise InputError(f"{called}, line {k + 1}: expected a number, got {field!r}") from None
