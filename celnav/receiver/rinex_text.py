"""Text of RINEX files of versions 2.11 to 4: unpacked lines, headers, and checked records of some
systems. Damage is reported with its line.

Records of version 2 are moved to the columns of version 3, so that one reader handles all versions.
"""

from __future__ import annotations

import gzip
import io
import math
import os
import re
import subprocess
import tempfile
import zlib
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
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
"""Most bytes of an unpacked file: a station's day at one epoch per second has half as many."""
SMALL_BYTES = 10_000_000
"""Bytes to which even the smallest file may unpack."""
LETTERS = tuple("GRECJSI")
"""Letters of all systems, used or not."""
SET_LINES = 8
"""Lines of a broadcast set."""
EPOCH_ZERO = datetime(2006, 1, 1, tzinfo=UTC)
"""Start of BDT."""
ROWS_AT_ONCE = 20_000
"""Observation rows whose columns are read together, which limits the memory."""
HEADS = {
    2: re.compile(r" [ \d]\d(?: [ \d]\d){4}[ \d]{3}\.\d{7}  \d[ \d]{3}| {28}[2-5][ \d]{3}$"),
    3: re.compile(r">|..\d{4} .{,53}$"),
}
"""Patterns for the start of an epoch in versions 2 and 3. In version 3 a date also marks it,
because ">" may be damaged.
"""
TYPES_OF_2 = {
    "G": {"C1": "C1C", "P1": "C1P", "D1": "D1C"},
    "E": {"C1": "C1X", "D1": "D1X"},
}
"""Observations of version 2 that are read, with their names in version 3."""


class File(NamedTuple):
    """A RINEX file as text.

    called: its path, as named in messages. version: of RINEX. lines: all lines, without trailing
        blanks. header: lines of the header by label. start: index of the first line after the
        header.
    """

    called: str
    version: float
    lines: list[str]
    header: dict[str, list[str]]
    start: int

    @property
    def system(self) -> str:
        """Letter of the system in the first line; "M" or " " for several systems."""
        return self.lines[0][40:41]

    def error(self, k: int, words: str) -> InputError:
        """The error for a line, counted from 0."""
        return InputError(f"{self.called}, line {k + 1}: {words}")


def unpacked(path: Path) -> tuple[list[str], str]:
    """Lines of a RINEX file without trailing blanks, and the file's name for messages."""
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
            f"{path}: expected at most {most:,} bytes when unpacked; unpack it yourself if this "
            "size is right"
        )
    text = raw.removeprefix(b"\xef\xbb\xbf").decode("latin-1").replace("\0", "")
    text = (
        "".join(c if c.isascii() else "?" for c in text) if not text.isascii() else text
    )  # a letter is a column
    return [line.rstrip() for line in text.splitlines()], called


def _decompressed(path: Path, raw: bytes, most: int) -> bytes:
    """Bytes from hatanaka's program, which is stopped after ``most`` bytes. Hatanaka's Python
    function would store the whole output in memory.
    """
    with requires_extra(f"{path}: a log in Hatanaka's compression", "rinex"):
        import_module("hatanaka")
        program = files("hatanaka.bin") / ("crx2rnx.exe" if os.name == "nt" else "crx2rnx")
    with (
        tempfile.TemporaryFile() as packed,
        tempfile.TemporaryFile() as errors,
        as_file(program) as executable,
    ):
        packed.write(raw)
        packed.seek(0)
        with subprocess.Popen(
            [executable, "-"], stdin=packed, stdout=subprocess.PIPE, stderr=errors
        ) as process:
            assert process.stdout is not None
            out = process.stdout.read(most + 1)
            if len(out) > most:
                process.kill()
                return out
        errors.seek(0)
        message = errors.read().decode("ascii", "replace").strip()
    if process.returncode not in (0, 2):  # 2 is a warning
        line = " ".join(message.split())[:200] or f"exit status {process.returncode}"
        raise InputError(f"{path}: expected a whole file in Hatanaka's compression ({line})")
    return out


def read_text(path: Path, kind: str) -> File:
    """A file of a ``kind``, "O" (observations) or "N" (navigation), of version 2 to 4."""
    text, called = unpacked(path)
    file = File(called, math.nan, text, {}, 0)
    first = text[0]
    if len(first) < 60 or "RINEX VERSION" not in first[60:]:
        raise file.error(0, f"expected RINEX VERSION / TYPE, got {first[:40]!r}")
    try:
        version = float(first[:9])
    except ValueError:
        raise file.error(0, f"expected a version number, got {first[:9]!r}") from None
    if not 2.0 <= version < 5.0:
        raise file.error(0, f"expected RINEX 2, 3 or 4, got version {version:g}")
    # In version 2 a blank line may be a line of missing measurements.
    while version >= 3.0 and not text[-1]:
        text.pop()
    # In version 2, navigation files of other systems have other letters.
    letters = "NGHEJL" if kind == "N" and version < 3.0 else kind
    if first[20:21] not in tuple(letters):
        words = {"O": "an observation file", "N": "a navigation file"}
        raise file.error(0, f"expected {words[kind]}, got {first[20:40].strip()!r}")
    header: dict[str, list[str]] = {}
    for k, line in enumerate(text):
        label = line[60:].strip()
        header.setdefault(label, []).append(line[:60])
        if label == "END OF HEADER":
            return File(called, version, text, header, k + 1)
    raise file.error(len(text) - 1, "expected END OF HEADER before the end of the file")


def kinds_of(file: File, system: str) -> list[str]:
    """Names of a system's observations in the order of the fields; empty if it has no header line.

    The names follow version 3. Other observations of version 2 keep their names.
    """
    if file.version < 3.0:
        rows = file.header.get("# / TYPES OF OBSERV", [])
        label, count = "# / TYPES OF OBSERV", rows[0][:6] if rows else ""
    else:
        label = "SYS / # / OBS TYPES"
        rows = of_system(file.header.get(label, []), system)
        label, count = f"{label} of {system}", rows[0][3:6] if rows else ""
    kinds = " ".join(row[6:] for row in rows).split()
    if rows and count.strip().lstrip("0") != str(len(kinds)):
        raise InputError(
            f"{file.called}: expected {count.strip()!r} kinds in {label}, got {len(kinds)}"
        )
    if file.version < 3.0:
        return [TYPES_OF_2.get(system, {}).get(kind, kind) for kind in kinds]
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
    text = header.get(label, [""])[0]
    try:
        values = np.array([float(word) for word in text.split()] or [0.0, 0.0, 0.0])
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InputError(f"{path}: expected three numbers in {label}, got {text.strip()!r}")
    return values


def accept(damage: Mapping[int, InputError], sound: int, strict: bool) -> tuple[str, ...]:
    """Messages of the damage in a file, in the order of its lines.

    The first error is raised if ``strict``, or if there are more damaged records than ``sound``
    records.
    """
    ordered = [damage[k] for k in sorted(damage)]
    if ordered and (strict or len(ordered) > sound):
        raise ordered[0]
    return tuple(map(str, ordered))


class Rows:
    """Observation rows of one system: epoch, satellite, line and text of each row."""

    def __init__(self) -> None:
        self.epochs: list[int] = []
        self.names: list[str] = []
        self.lines: list[int] = []
        self.texts: list[str] = []


class Measured(NamedTuple):
    """Measurements of one system: epochs ``(R,)``, names of satellites ``(R,)`` and values.

    The values ``(R, C)`` are of the requested columns, nan where a field is blank or 0.
    """

    epochs: Array
    names: Array
    values: Array


def measurements(
    file: File, columns: Mapping[str, Sequence[int]], strict: bool
) -> tuple[Array, dict[str, Measured], tuple[str, ...]]:
    """Epochs ``(T,)``, s since the start of BDT by the file's clock; measurements of the
    ``columns`` by system; and messages of damage, see `accept`.

    Damaged epochs are left out. All rows of these systems are checked, whichever columns are read.
    Events are skipped.
    """
    lines, start = file.lines, file.start
    if len(lines) <= start:
        raise file.error(start - 1, "expected observations after the header, got none")
    labels = ("SYS / # / OBS TYPES", "SYS / SCALE FACTOR", "# / TYPES OF OBSERV")
    for k in range(start, len(lines)):
        if (label := lines[k][60:].strip()) in labels:
            raise file.error(k, f"expected observations of one kind, got another {label}")
    is_head = HEADS[min(int(file.version), 3)].match
    heads = [k for k in range(start, len(lines)) if is_head(lines[k])]
    damage = {} if heads[:1] == [start] else {start: _no_epoch(file, start)}
    times, rows, head_of = list[float](), {letter: Rows() for letter in columns}, list[int]()
    sound = 0
    for k, end in pairwise([*heads, len(lines)]):
        try:
            complete, time = _read_epoch(file, k, end, rows, len(times), damage)
        except InputError as error:
            damage[k] = error
            continue
        sound += complete
        if complete and not math.isnan(time):
            times.append(time)
            head_of.append(k)
    whole = np.ones(len(times), bool)
    values = {
        letter: _values(file, part, columns[letter], whole, head_of, damage)
        for letter, part in rows.items()
    }
    messages = accept(damage, sound - int((~whole).sum()), strict)
    order = np.cumsum(whole) - 1  # new indices of epochs without the damaged ones
    out = {}
    for letter, part in rows.items():
        epochs = np.array(part.epochs, dtype=int)
        keep = whole[epochs]
        names = np.array(part.names, dtype="U3")
        out[letter] = Measured(order[epochs[keep]], names[keep], values[letter][keep])
    return np.array(times)[whole], out, messages


def _read_epoch(
    file: File, k: int, end: int, rows: dict[str, Rows], epoch: int, damage: dict[int, InputError]
) -> tuple[bool, float]:
    """Whether the lines from k to before ``end`` are one complete epoch or event, and its time.

    The time is nan for an event, or if the epoch has no satellite of these systems. The epoch's
    rows are added to ``rows``.
    """
    lines = file.lines
    flag, count, time = _head(file, k)
    size, texts = count, lines[k + 1 : k + 1 + count]
    if file.version < 3.0 and flag in (0, 1, 6):
        # The list has 12 satellites per line; then each satellite has lines of 5 fields.
        more, each = -(-count // 12), -(-len(kinds_of(file, "")) // 5)
        size = more - 1 + count * each
        texts = _texts_of_2(file, k, count, each)
    if k + 1 + size > end:
        got = "the file is cut off" if end == len(lines) else f"got {end - k - 1}"
        raise file.error(end - 1, f"expected {size} more after line {k + 1}, {got}")
    satellites = _checked(file, k + 1, texts, rows) if flag <= 1 else []
    surplus = k + 1 + size
    if surplus < end:
        damage[surplus] = _no_epoch(file, surplus)
        # A surplus row of another satellite belongs to this epoch. A repeated satellite belongs to
        # the next epoch, whose first line is missing. Rows of version 2 have no names.
        if file.version < 3.0 or lines[surplus][:3] not in {text[:3] for text in texts}:
            return False, math.nan
    for line, name, text in satellites:
        system_rows = rows[name[0]]
        system_rows.epochs.append(epoch)
        system_rows.names.append(name)
        system_rows.lines.append(line)
        system_rows.texts.append(text)
    return True, time if satellites else math.nan


def _no_epoch(file: File, k: int) -> InputError:
    return file.error(k, f"expected an epoch (>), got {file.lines[k][:40]!r}")


def _head(file: File, k: int) -> tuple[int, int, float]:
    """Flag, number of lines and time of an epoch; an event has no time."""
    line = file.lines[k]
    if file.version < 3.0:
        flag, count, width = line[28:29], line[29:32], 32
        date = [_year(line[1:3]), line[4:6], line[7:9], line[10:12], line[13:15], line[15:26]]
    else:
        if not line.startswith(">"):
            raise _no_epoch(file, k)
        flag, count, width = line[31:32], line[32:35], 35
        date = [line[2:6], line[7:9], line[10:12], line[13:15], line[16:18], line[18:29]]
    try:
        kind = _whole(flag)
        if kind > 6:
            raise ValueError
        return kind, _whole(count), _seconds(date if kind <= 1 else [])
    except ValueError:
        raise file.error(
            k, f"expected date, flag and number of an epoch, got {line[:width]!r}"
        ) from None


def _year(text: str) -> str:
    """Year of two digits, from 1980 to 2079."""
    return f"{'20' if text.strip().zfill(2) < '80' else '19'}{text.strip():0>2}"


def _texts_of_2(file: File, k: int, count: int, each: int) -> list[str]:
    """Rows of a version 2 epoch in the columns of version 3: name, then all fields."""
    lines, first = file.lines, k + max(-(-count // 12), 1)
    names = "".join(lines[i][32:68].ljust(36) for i in range(k, min(first, len(lines))))
    texts = []
    for s in range(count):
        name = names[3 * s : 3 * s + 3]
        fields = lines[first + s * each : first + (s + 1) * each]
        for i, field in enumerate(fields):
            if len(field) % 16 not in (0, 14, 15) or len(field) > 80:
                raise file.error(
                    first + s * each + i, "expected fields of 16 columns, the last one is cut off"
                )
        system = file.system if file.system.strip() not in ("", "M") else "G"
        letter = name[:1].strip() or system
        texts.append((letter + name[1:] + "".join(f.ljust(80) for f in fields)).rstrip())
    return texts


def _whole(text: str) -> int:
    """An integer that consists of digits; Python would also read 1_0."""
    if not text.strip().isdecimal():
        raise ValueError
    return int(text)


def _seconds(date: list[str]) -> float:
    """Seconds of BDT from a date in six parts; nan without a date, ValueError if it is invalid."""
    if not date:
        return math.nan
    year, month, day, hour, minute = map(_whole, date[:5])
    second = finite_number(date[5])
    if not 0.0 <= second <= 60.0:
        raise ValueError
    return (datetime(year, month, day, hour, minute, tzinfo=UTC) - EPOCH_ZERO) / timedelta(
        seconds=1
    ) + second


def _checked(
    file: File, first: int, texts: list[str], systems: Collection[str]
) -> list[tuple[int, str, str]]:
    """Line, satellite and text of an epoch's rows of ``systems``; ``first``: index of its first
    row.
    """
    satellites = dict[str, tuple[int, str, str]]()
    for k, text in enumerate(texts, first):
        if text[:1] in systems or text[:1] not in LETTERS:
            name = _name(file, k, text)
            if name in satellites:
                raise file.error(k, f"expected each satellite once in an epoch, got {name} again")
            if (len(text) - 3) % 16 not in (0, 14, 15):
                raise file.error(k, "expected fields of 16 columns, the last one is cut off")
            satellites[name] = (k, name, text)
    return list(satellites.values())


def _name(file: File, k: int, line: str) -> str:
    name = line[:3].replace(" ", "0")
    if name[:1] not in LETTERS or not name[1:].isdecimal() or name[1:] == "00" or len(name) < 3:
        raise file.error(k, f"expected a satellite (C01), got {line[:3]!r}")
    return name


BLANK, SIGN, DIGIT, POINT, OTHER = range(5)
CLASSES = np.full(256, OTHER, np.uint8)
"""Classes of the characters of a number, in the order in which they follow each other."""
CLASSES[list(b" ")], CLASSES[list(b"+-")] = BLANK, SIGN
CLASSES[list(b"0123456789")], CLASSES[list(b".")] = DIGIT, POINT
THOUSANDTHS = np.array([*10.0 ** np.arange(12, 2, -1), 0.0, 100.0, 10.0, 1.0])
"""Weight of each digit in a field with format F14.3, in thousandths; sums are exact."""


def _values(
    file: File,
    rows: Rows,
    columns: Sequence[int],
    whole: Array,
    head_of: list[int],
    damage: dict[int, InputError],
) -> Array:
    """Values ``(R, C)`` of rows; an epoch with an invalid field becomes false in ``whole (T,)``.

    Fields with format F14.3 are read together, other fields one by one.
    """
    width = 3 + 16 * (max(columns) + 1)
    out = np.full((len(rows.texts), len(columns)), np.nan)
    for first in range(0, len(rows.texts), ROWS_AT_ONCE):
        some = rows.texts[first : first + ROWS_AT_ONCE]
        most = max(width, 3 + -(-max(map(len, some)) // 16) * 16)
        text = np.frombuffer("".join(row.ljust(most) for row in some).encode("ascii"), np.uint8)
        # (R, fields, 14): each field has 16 columns; the last two are flags.
        fields = text.reshape(len(some), most)[:, 3:].reshape(len(some), -1, 16)[..., :14]
        kinds = CLASSES[fields]
        before = kinds[..., :10]
        regular = (before[..., :-1] <= before[..., 1:]).all(-1) & (before[..., 9] == DIGIT)
        regular &= ((before == SIGN).sum(-1) <= 1) & (kinds[..., 10] == POINT)
        regular &= (kinds[..., 11:] == DIGIT).all(-1)
        blank = (kinds == BLANK).all(-1)
        digits = np.where(kinds == DIGIT, fields - ord("0"), 0)[:, columns]
        values = digits @ THOUSANDTHS / 1000.0
        values[(fields[:, columns] == ord("-")).any(-1)] *= -1.0
        out[first : first + len(some)] = np.where(values == 0.0, np.nan, values)
        for r in np.flatnonzero(~(regular | blank).all(-1)) + first:
            row, line = rows.texts[r], rows.lines[r]
            try:
                numbers = [_number(file, line, row[i : i + 14]) for i in range(3, len(row), 16)]
            except InputError as error:
                epoch = rows.epochs[r]
                whole[epoch] = False
                damage.setdefault(head_of[epoch], error)
                continue
            numbers += [math.nan] * (max(columns) + 1 - len(numbers))
            out[r] = [numbers[c] or math.nan for c in columns]
    return out


class Set(NamedTuple):
    """A broadcast set: its satellite, the reference time of its clock (s in the system's time), and
    its numbers.

    The numbers have the order of the file and are nan where blank. ``message``: the name of the
    message in version 4.
    """

    name: str
    toc: float
    numbers: list[float]
    message: str = ""


class Messages(NamedTuple):
    """Contents of a navigation file: sets of the used systems, and Klobuchar's eight coefficients
    from a message.

    unused: number of records of other systems or messages. damaged: messages about damaged records
        that were left out.
    """

    sets: list[Set]
    klobuchar: list[float] | None
    unused: Counter[str]
    damaged: tuple[str, ...]


MESSAGES = {"C": ("D1", "D2"), "G": ("LNAV",), "E": ("INAV", "FNAV")}
"""Messages of version 4 that are read, by system: the messages that version 3 has too."""


def messages(file: File, systems: str, strict: bool) -> Messages:
    """Complete and valid broadcast sets of ``systems``; for damaged sets see `accept`."""
    lines, start = file.lines, file.start
    read, unused, damage = list[Set](), Counter[str](), dict[int, InputError]()
    klobuchar: list[float] | None = None
    if file.version < 3.0:
        heads = [k for k in range(start, len(lines)) if lines[k][:2].strip()]
    elif file.version < 4.0:
        # A date also marks the first line of a set, because its name may be damaged.
        dated = re.compile(r".{4}\d{4} ").match
        heads = [k for k in range(start, len(lines)) if dated(lines[k]) or lines[k][:1] in LETTERS]
    else:
        heads = [k for k in range(start, len(lines)) if lines[k].startswith(">")]
    blocks = list(pairwise(dict.fromkeys([start, *heads, len(lines)])))
    for k, end in blocks:
        try:
            first, letter, kind, message = k, lines[k][:1], "EPH", ""
            if file.version < 3.0:
                letter = {"N": "G", "G": "R", "H": "S"}.get(lines[0][20:21], lines[0][20:21])
            elif file.version >= 4.0:
                kind, satellite, message = _title(file, k)
                first, letter = k + 1, satellite[:1]
            if letter in LETTERS and letter not in systems and kind == "EPH":
                unused[letter] += 1
            elif kind == "ION" and (letter, message) == ("G", "LNAV"):
                klobuchar = klobuchar or _numbers(file, first, end, 3)[:8]
            elif kind != "EPH" or (message and message not in MESSAGES[letter]):
                unused[f"{letter} {message} {kind}"] += 1
            else:
                read.append(_set(file, first, end, message))
        except InputError as error:
            damage[k] = error
    return Messages(read, klobuchar, unused, accept(damage, len(blocks) - len(damage), strict))


def _title(file: File, k: int) -> tuple[str, str, str]:
    """Kind, satellite and message of a record of version 4."""
    words = file.lines[k].split()
    if len(words) < 4 or words[0] != ">" or words[1] not in ("EPH", "STO", "EOP", "ION"):
        raise file.error(k, f"expected a record (> EPH G01 LNAV), got {file.lines[k][:40]!r}")
    return words[1], _name(file, k, words[2]), words[3]


def _set(file: File, k: int, end: int, message: str) -> Set:
    """The set of the lines from k to before ``end``."""
    line, old = file.lines[k], file.version < 3.0
    name = _name(file, k, f"G{line[:2]}" if old else line)
    if old:
        date = [_year(line[3:5]), line[6:8], line[9:11], line[12:14], line[15:17], line[17:22]]
    else:
        date = (line[4:23].split() + [""] * 6)[:6]
    numbers = _numbers(file, k, end, SET_LINES)
    try:
        return Set(name, _seconds(date), numbers, message)
    except ValueError:
        raise file.error(k, f"expected a date, got {line[3:22] if old else line[4:23]!r}") from None


def _numbers(file: File, k: int, end: int, count: int) -> list[float]:
    """Numbers of a record's ``count`` lines, after the date of the first."""
    if end - k != count:
        raise file.error(
            end - 1, f"expected {count} lines of a broadcast set from line {k + 1}, got {end - k}"
        )
    date, indent = (22, 3) if file.version < 3.0 else (23, 4)
    numbers = []
    for i in range(k, end):
        line, before = file.lines[i], date if i == k else indent
        if i > k and line[:before].strip():
            raise file.error(i, f"expected {before} blanks and numbers, got {line[:40]!r}")
        if len(line[before:]) % 19:
            raise file.error(i, "expected fields of 19 columns, the last one is cut off")
        last = before + 19 * (3 if i == k else 4)
        numbers += [_number(file, i, line[at : at + 19]) for at in range(before, last, 19)]
    return numbers


def _number(file: File, k: int, field: str) -> float:
    """The number in a field, nan if blank."""
    text = field.strip()
    try:
        return finite_number(text) if text else math.nan
    except ValueError:
        raise file.error(k, f"expected a number, got {text!r}") from None


def finite_number(text: str) -> float:
    """A finite number, or ValueError. Python would also read 1_0, nan and infinity, which are not
    valid in these files.
    """
    value = float(text.replace("D", "E").replace("d", "e"))
    if "_" in text or not math.isfinite(value):
        raise ValueError
    return value
