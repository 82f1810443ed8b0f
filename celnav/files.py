"""Files that are written completely or not at all, and never replace files that celnav did not
write.

`Outputs` is a folder of files written by celnav. A small manifest has the hashes of their contents.
So a file that celnav did not write, or that has changed since, is an error and is not replaced.
"""

from __future__ import annotations

import difflib
import errno
import hashlib
import io
import json
import os
import secrets
import shutil
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celnav.lazy import requires_extra

MANIFEST = ".celnav.json"
LOCK = ".celnav.lock"
TEMPORARY = ".celnav-"
"""Prefix of the names of temporary folders; see `_temporary_name`."""
CURES = {
    errno.ENOSPC: "no space left to write the file; free some, or choose another disk",
    errno.EDQUOT: "the disk quota is used up; free some space, or choose another disk",
    errno.EFBIG: "larger than the limit of file sizes; raise the limit (ulimit -f), or choose "
    "another file system",
}
"""Messages with a remedy for write errors."""
DAMAGE = (
    OSError,
    ValueError,
    EOFError,
    zipfile.BadZipFile,
    KeyError,
    AttributeError,
    RuntimeError,
)
"""Exceptions from damaged archives; OSError is from an invalid seek."""
MOST_UNPACKED = 100
"""Largest unpacked size over the file's size; a regular archive of numbers is below this."""


Contents = Mapping[str, str] | Mapping[str, bytes]
"""Contents of files by name, all computed before the first file is written."""


class ForeignFileError(OSError):
    """A file that celnav did not write would be replaced."""


class InputError(ValueError):
    """An input file cannot be used; the message names the file, and the line if known."""


def did_you_mean(word: str, words: Iterable[str]) -> str:
    """The end of an error about an unknown word: the nearest known word, or "" if none is near."""
    near = difflib.get_close_matches(word, list(words), 1)
    return f"; did you mean {near[0]}?" if near else ""


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A context with a path of the same name in a temporary folder beside ``path``. At the end the
    temporary file replaces ``path``; after an error it is removed.

    A device or a pipe, such as /dev/null, is written directly. OSError names ``path``, and the
    remedy if the disk is full.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    device = target.exists() and not (target.is_file() or target.is_dir())
    beside, prefix = None if device else target.parent, _temporary_name(secrets.token_hex(8))
    try:
        with tempfile.TemporaryDirectory(prefix=prefix, dir=beside) as folder:
            temporary = Path(folder) / target.name
            yield temporary
            if device:
                target.write_bytes(temporary.read_bytes())
                return
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            os.replace(temporary, target)
    except OSError as error:
        of_another = error.filename is not None and TEMPORARY not in str(error.filename)
        if error.errno is None or of_another:
            raise
        words = CURES.get(error.errno, error.strerror)
        raise OSError(error.errno, words, str(target)) from None


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file atomically."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 file atomically."""
    write_bytes(path, text.encode("utf-8"))


def read_npz(path: str | Path) -> dict[str, NDArray[Any]]:
    """Arrays of an npz file. Objects are an error, so no code from the file is ever run.

    Raises
    ------
    ValueError: naming the file, if it is damaged or contains objects.
    """
    try:
        if not zipfile.is_zipfile(path):
            raise ValueError("not a zip archive")
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > MOST_UNPACKED * Path(path).stat().st_size:
            raise ValueError(f"unpacks to {size} bytes, more than {MOST_UNPACKED} times its size")
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except DAMAGE as error:
        raise ValueError(f"{path}: expected an npz file of plain arrays ({error})") from None


@contextmanager
def locked(folder: str | Path) -> Iterator[None]:
    """A lock on an existing folder against other processes that lock it. It is released when this
    process ends, even if the process is killed.

    Raises
    ------
    BlockingIOError: naming the folder, if another process has locked it.
    """
    with requires_extra("the lock of a folder", "papers"):
        from filelock import FileLock, Timeout

    lock = FileLock(Path(folder) / LOCK)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise BlockingIOError(
            f"{folder}: in use by another celnav process; wait for it, or choose another folder"
        ) from None
    try:
        yield
    finally:
        lock.release()


def remove_leftovers(*folders: str | Path) -> None:
    """Remove temporary files of processes that were killed while writing into folders.

    The caller must have `locked` the folders. Files that celnav did not write are not removed,
    whatever their names.
    """
    for folder in folders:
        for path in Path(folder).glob(f"{TEMPORARY}*"):
            token = path.name.removeprefix(TEMPORARY).partition("-")[0]
            if path.name.startswith(_temporary_name(token)) and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)


def _temporary_name(token: str) -> str:
    """The prefix of a temporary folder's name. It includes a hash of the random part, so that
    folders of other programs do not have such names by chance.
    """
    return f"{TEMPORARY}{token}-{hashlib.sha256(f'celnav {token}'.encode()).hexdigest()[:16]}-"


def read_json(path: str | Path) -> Any:
    """The contents of a JSON file.

    Raises
    ------
    InputError: naming the file, if it is not JSON, or if lists are nested too deeply. OSError: if
        it cannot be read.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except RecursionError:
        raise InputError(f"{path}: lists or tables are nested too deeply") from None
    except ValueError as error:
        raise InputError(f"{path}: not a JSON file ({error})") from None


class Outputs:
    """A folder of files written by celnav.

    Raises
    ------
    OSError: if the folder cannot be created or written. ForeignFileError: see `check`.
    """

    def __init__(self, directory: str | Path):
        self.directory = Path(directory)
        if self.directory.exists() and not self.directory.is_dir():
            raise NotADirectoryError(f"{self.directory}: expected a folder to write to")
        self.directory.mkdir(parents=True, exist_ok=True)
        try:
            with tempfile.TemporaryFile(dir=self.directory):
                pass  # an unwritable folder raises an error here, before anything is computed
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.directory)) from None
        self._manifest()

    def _manifest(self) -> dict[str, list[str]]:
        """Hashes of files by name; read each time, because another celnav process may have written
        files.
        """
        manifest = self.directory / MANIFEST
        if not manifest.exists():
            return {}
        try:
            return {str(k): [str(h) for h in v] for k, v in read_json(manifest).items()}
        except (ValueError, AttributeError, TypeError):
            raise ForeignFileError(f"{manifest}: not a manifest of celnav") from None

    def check(self, names: Iterable[str]) -> None:
        """Raise `ForeignFileError` if one of the files exists and differs from
        what celnav wrote.
        """
        for name in names:
            self._owned(name)

    def _owned(self, name: str) -> Path:
        path = self.directory / name
        if Path(name).anchor or ".." in Path(name).parts:
            raise ValueError(f"name: expected a path inside the folder, got {name!r}")
        for above in list(Path(name).parents)[:-1]:
            if (self.directory / above).is_symlink():
                raise ForeignFileError(
                    f"{self.directory / above}: expected a folder, got a symbolic link; remove "
                    "it first"
                )
            if (self.directory / above).exists() and not (self.directory / above).is_dir():
                raise NotADirectoryError(f"{self.directory / above}: expected a folder to write to")
        if path.is_symlink() or (
            path.exists() and sha256(path) not in self._manifest().get(name, [])
        ):
            raise ForeignFileError(
                f"{path}: exists, and celnav did not write it or it has changed; move it away first"
            )
        return path

    @contextmanager
    def path_for(self, name: str) -> Iterator[Path]:
        """A context with a temporary path, which becomes the file ``name`` at the end."""
        path = self._owned(name)
        with replacing(path) as temporary:
            yield temporary
            # The manifest lists old and new contents before the file is replaced, so a crash in
            # between leaves no foreign file.
            manifest = self._manifest()
            manifest[name] = [*manifest.get(name, [])[-1:], sha256(temporary)]
            write_text(
                self.directory / MANIFEST, json.dumps(manifest, indent=1, sort_keys=True) + "\n"
            )

    def bytes(self, name: str, content: bytes) -> None:
        """Write a file."""
        with self.path_for(name) as path:
            path.write_bytes(content)

    def text(self, name: str, text: str) -> None:
        """Write a UTF-8 file."""
        self.bytes(name, text.encode("utf-8"))

    def publish(self, *contents: Contents) -> None:
        """Write files; if `check` refuses one of their names, none is written."""
        self.check(name for some in contents for name in some)
        for name, content in (file for some in contents for file in some.items()):
            self.bytes(name, content.encode("utf-8") if isinstance(content, str) else content)


def npz(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Write arrays as an npz file."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **dict(arrays))
    return buffer.getvalue()


def sha256(path: Path) -> str:
    """Hash of a file's content, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def data(name: str) -> Path:
    """Path of a data file: in ``data/`` of the repository, or in its copy inside an installed
    package.

    Raises
    ------
    FileNotFoundError: naming it.
    """
    inside = Path(__file__).parent / "data" / name
    path = inside if inside.exists() else Path(__file__).parents[1] / "data" / name
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such data file of celnav")
    return path
