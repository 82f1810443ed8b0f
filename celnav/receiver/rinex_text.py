"""RINEX files as text: unpacked, their headers, and the records of some systems, each checked:
damage is told by its line.
"""

from __future__ import annotations

import gzip
import io
import math
import os
import subprocess
import tempfile
import zlib
from datetime import UTC, datetime, timedelta
from importlib import import_module
from importlib.resources import as_file, files
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from celnav.files import MOST_UNPACKED, InputError
from celnav.gaussian.linalg import Array
from celnav.lazy import requires_extra

LARGEST_BYTES = 2_000_000_000
"""Of a file, unpacked: a day of a station at a second's rate is half of that."""
SMALL_BYTES = 10_000_000
"""What a file may unpack to however small it is."""
LETTERS = tuple("GRECJSI")
"""Of all systems, used or not."""
SET_LINES = 8
"""Of a broadcast set."""
EPOCH_ZERO = datetime(2006, 1, 1, tzinfo=UTC)
"""Of BDT."""


def unpacked(path: Path) -> tuple[str, str]:
    """The unpacked text of a RINEX file, and what to call it when a line is told."""
    called = str(path)
    raw = path.read_bytes()
    most = min(LARGEST_BYTES, max(MOST_UNPACKED * len(raw), SMALL_BYTES))
    try:
        if raw[:2] == b"\x1f\x8b":
            called = f"{path}, unpacked"
            with gzip.open(io.BytesIO(raw)) as file:
                raw = file.read(most + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"{path}: expected a whole gzip file ({error})") from None
    if not raw[: most + 1].strip(b"\0 \r\n\t"):
        raise InputError(f"{path}: expected a RINEX file, got an empty one")
    first = raw[:200].lstrip(b"\xef\xbb\xbf").split(b"\n", 1)[0]
    if b"CRINEX" in first[60:] and len(raw) <= most:
        called = f"{path}, unpacked"
        raw = _decompressed(path, raw, most)
    if len(raw) > most:
        raise InputError(
            f"{path}: expected at most {most:,} bytes when unpacked; unpack it yourself if it is "
            "what it should be"
        )
    text = raw.removeprefix(b"\xef\xbb\xbf").decode("latin-1").replace("\0", "")
    text = (
        "".join(c if c.isascii() else "?" for c in text) if not text.isascii() else text
    )  # a letter is a column
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n", called


def _decompressed(path: Path, raw: bytes, most: int) -> bytes:
    """By the program of hatanaka, which is stopped after ``most`` bytes: its own function would
    hold all that comes.
    """
    with requires_extra(f"{path}: a log in Hatanaka's compression", "rinex"):
        import_module("hatanaka")
        program = files("hatanaka.bin") / ("crx2rnx.exe" if os.name == "nt" else "crx2rnx")
    with (
        tempfile.TemporaryFile() as given,
        tempfile.TemporaryFile() as told,
        as_file(program) as executable,
    ):
        given.write(raw)
        given.seek(0)
        with subprocess.Popen(
            [executable, "-"], stdin=given, stdout=subprocess.PIPE, stderr=told
        ) as process:
            assert process.stdout is not None
            out = process.stdout.read(most + 1)
            if len(out) > most:
                process.kill()
                return out
        told.seek(0)
        said = told.read().decode("ascii", "replace").strip()
    if process.returncode not in (0, 2):  # 2 is a warning
        line = " ".join(said.split())[:200] or f"exit status {process.returncode}"
        raise InputError(f"{path}: expected a whole file in Hatanaka's compression ({line})")
    return out


def _at_line(called: str, k: int, words: str) -> InputError:
    return InputError(f"{called}, line {k + 1}: {words}")


def header_of(
    called: str, text: str, kind: str, oldest: int = 3
) -> tuple[dict[str, list[str]], int]:
    """Header lines by label, and how many there are; the file is one of ``kind``, "O" or "N", in a
    version from ``oldest`` to 3.
    """
    lines = text.split("\n")
    words = {"O": "an observation file", "N": "a navigation file"}
    if len(lines[0]) < 60 or "RINEX VERSION" not in lines[0][60:]:
        raise _at_line(called, 0, f"expected RINEX VERSION / TYPE, got {lines[0][:40]!r}")
    try:
        version = float(lines[0][:9])
    except ValueError:
        raise _at_line(called, 0, f"expected a version number, got {lines[0][:9]!r}") from None
    if not oldest <= version < 4.0:
        raise _at_line(called, 0, f"expected RINEX 3, got version {version:g}")
    if lines[0][20:21] != kind:
        raise _at_line(called, 0, f"expected {words[kind]}, got {lines[0][20:40].strip()!r}")
    if lines[0][40:41] not in ("C", "G", "M", " ", ""):
        raise _at_line(
            called,
            0,
            f"expected BeiDou (C), GPS (G) or mixed (M) data, got system {lines[0][40:41]!r}",
        )
    header: dict[str, list[str]] = {}
    for k, line in enumerate(lines):
        label = line[60:].strip()
        header.setdefault(label, []).append(line[:60])
        if label == "END OF HEADER":
            return header, k + 1
    raise _at_line(called, len(lines) - 2, "expected END OF HEADER before the end of the file")


def kinds_of(called: str, header: dict[str, list[str]], system: str) -> list[str]:
    """What is measured of a system, in the order of the fields; nothing if it has no line."""
    rows = of_system(header.get("SYS / # / OBS TYPES", []), system)
    kinds = " ".join(row[6:] for row in rows).split()
    if rows and rows[0][3:6].strip().lstrip("0") != str(len(kinds)):
        raise InputError(
            f"{called}: expected {rows[0][3:6].strip()!r} kinds in SYS / # / OBS TYPES of "
            f"{system}, got {len(kinds)}"
        )
    return kinds


def of_system(lines: list[str], system: str) -> list[str]:
    """Header lines of one system with their continuations."""
    out, current = [], ""
    for line in lines:
        current = line[:1].strip() or current
        if current == system:
            out.append(line)
    return out


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


class Measured(NamedTuple):
    """An epoch: s since the beginning of BDT by the clock of the file, and fields of satellites,
    nan where blank or 0.
    """

    time: float
    fields: dict[str, list[float]]


def accept(damage: list[InputError], sound: int, strict: bool) -> tuple[str, ...]:
    """Messages of what is damaged.

    The first is raised if ``strict``, or if there are more of them than of what is ``sound``.
    """
    if damage and (strict or len(damage) > sound):
        raise damage[0]
    return tuple(map(str, damage))


def epochs(
    called: str, text: str, start: int, systems: str, strict: bool
) -> tuple[list[Measured], tuple[str, ...]]:
    """Epochs with a satellite of ``systems``, and what is damaged, which is left out; see `accept`.

    Every line is checked. Events are passed over. ``start``: lines of the header.
    """
    lines = text.rstrip("\n").split("\n")
    if len(lines) <= start:
        raise _at_line(called, start - 1, "expected observations after the header, got none")
    for k in range(start, len(lines)):
        if (label := lines[k][60:].strip()) in ("SYS / # / OBS TYPES", "SYS / SCALE FACTOR"):
            raise _at_line(called, k, f"expected observations of one kind, got another {label}")
    # The date tells the first line of an epoch too, where its ">" is damaged.
    dated = [line[2:6].isdecimal() and line[6:7] == " " and not line[60:] for line in lines]
    heads = [k for k in range(start, len(lines)) if dated[k] or lines[k].startswith(">")]
    damage = [] if heads[:1] == [start] else [_no_epoch(called, start, lines[start])]
    read, sound = list[Measured](), 0
    for k, end in pairwise([*heads, len(lines)]):
        try:
            flag, count, time = _epoch(called, k, lines[k])
            rows, surplus = lines[k + 1 : k + 1 + count], lines[k + 1 + count : end]
            if k + 1 + count > end:
                got = "the file is cut off" if end == len(lines) else f"got {end - k - 1}"
                raise _at_line(called, end - 1, f"expected {count} more after line {k + 1}, {got}")
            fields = _fields(called, k + 1, rows, systems) if flag <= 1 else {}
            if surplus:
                damage.append(_no_epoch(called, k + 1 + count, surplus[0]))
                # Another satellite is of this epoch; a repeated one is of the next, headless one.
                if surplus[0][:3] not in {row[:3] for row in rows}:
                    continue
        except InputError as error:
            damage.append(error)
            continue
        sound += 1
        if fields:
            read.append(Measured(time, fields))
    return read, accept(damage, sound, strict)


def _no_epoch(called: str, k: int, line: str) -> InputError:
    return _at_line(called, k, f"expected an epoch (>), got {line[:40]!r}")


def _epoch(called: str, k: int, line: str) -> tuple[int, int, float]:
    """Flag, number of lines and time of an epoch; an event has no time."""
    if not line.startswith(">"):
        raise _no_epoch(called, k, line)
    try:
        flag, count = _whole(line[31:32]), _whole(line[32:35])
        if flag > 6:
            raise ValueError
        return (
            flag,
            count,
            _seconds(
                [line[i:j] for i, j in ((2, 6), (7, 9), (10, 12), (13, 15), (16, 18), (18, 29))]
                * (flag <= 1)
            ),
        )
    except ValueError:
        raise _at_line(
            called, k, f"expected date, flag and number of an epoch, got {line[:35]!r}"
        ) from None


def _whole(text: str) -> int:
    """A number of digits alone: Python reads 1_0 too."""
    if not text.strip().isdecimal():
        raise ValueError
    return int(text)


def _seconds(date: list[str]) -> float:
    """Of BDT, of a date in six parts; nan of none, ValueError of what is no date."""
    if not date:
        return math.nan
    year, month, day, hour, minute = map(_whole, date[:5])
    second = finite_number(date[5])
    if not 0.0 <= second <= 60.0:
        raise ValueError
    return (datetime(year, month, day, hour, minute, tzinfo=UTC) - EPOCH_ZERO) / timedelta(
        seconds=1
    ) + second


def _fields(called: str, first: int, rows: list[str], systems: str) -> dict[str, list[float]]:
    """Fields of an epoch's satellites of ``systems`` by name; ``first``: index of its first row."""
    fields = dict[str, list[float]]()
    for k, row in enumerate(rows, first):
        if row[:1] in systems or row[:1] not in LETTERS:
            name = _name(called, k, row)
            if name in fields:
                raise _at_line(
                    called, k, f"expected each satellite once in an epoch, got {name} again"
                )
            if (len(row) - 3) % 16 not in (0, 14, 15):
                raise _at_line(called, k, "expected fields of 16 columns, the last one is cut off")
            values = [_number(called, k, row[i : i + 14]) for i in range(3, len(row), 16)]
            fields[name] = [value or math.nan for value in values]
    return fields


def _name(called: str, k: int, line: str) -> str:
    name = line[:3].replace(" ", "0")
    if name[:1] not in LETTERS or not name[1:].isdecimal() or name[1:] == "00" or len(name) < 3:
        raise _at_line(called, k, f"expected a satellite (C01), got {line[:3]!r}")
    return name


class Set(NamedTuple):
    """A broadcast set: whose, s of its clock by its system's time, and its numbers in the order of
    the file, nan where blank.
    """

    name: str
    toc: float
    numbers: list[float]


def sets(
    called: str, text: str, start: int, systems: str, strict: bool
) -> tuple[list[Set], tuple[str, ...]]:
    """Sets of ``systems``, and what is damaged, which is left out; see `accept`.

    Each has all its lines, of numbers alone. ``start``: lines of the header.
    """
    lines = text.rstrip("\n").split("\n")
    # The date tells the first line of a set too, where its name is damaged.
    dated = [line[4:8].isdecimal() and line[8:9] == " " for line in lines]
    heads = [k for k in range(start, len(lines)) if dated[k] or lines[k][:1] in LETTERS]
    read, damage = list[Set](), list[InputError]()
    blocks = list(pairwise(dict.fromkeys([start, *heads, len(lines)])))
    for k, end in blocks:
        if lines[k][:1] in systems or lines[k][:1] not in LETTERS:
            try:
                read.append(_set(called, lines, k, end))
            except InputError as error:
                damage.append(error)
    return read, accept(damage, len(blocks) - len(damage), strict)


def _set(called: str, lines: list[str], k: int, end: int) -> Set:
    """The set of the lines from k to before ``end``."""
    name = _name(called, k, lines[k])
    if end - k != SET_LINES:
        raise _at_line(
            called,
            end - 1,
            f"expected {SET_LINES} lines of a broadcast set from line {k + 1}, got {end - k}",
        )
    try:
        toc = _seconds((lines[k][4:23].split() + [""] * 6)[:6])
    except ValueError:
        raise _at_line(called, k, f"expected a date, got {lines[k][4:23]!r}") from None
    numbers = []
    for i in range(k, end):
        before = 23 if i == k else 4
        if i > k and lines[i][:before].strip():
            raise _at_line(
                called, i, f"expected {before} blanks and numbers, got {lines[i][:40]!r}"
            )
        if len(lines[i][before:]) % 19:
            raise _at_line(called, i, "expected fields of 19 columns, the last one is cut off")
        numbers += [_number(called, i, lines[i][at : at + 19]) for at in range(before, 80, 19)]
    return Set(name, toc, numbers)


def _number(called: str, k: int, field: str) -> float:
    """nan where it is blank."""
    text = field.strip()
    try:
        return finite_number(text) if text else math.nan
    except ValueError:
        raise _at_line(called, k, f"expected a number, got {text!r}") from None


def finite_number(text: str) -> float:
    """A number, or ValueError; what else Python takes for one, no file has: 1_0, nan and
    infinity."""
    value = float(text.replace("D", "E").replace("d", "e"))
    if "_" in text or not math.isfinite(value):
        raise ValueError
    return value
