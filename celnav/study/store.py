"""A store of results: a folder with a manifest, and one file with a checksum for each finished
unit.

Every file is written under a temporary name and then renamed, so the folder is valid after any
interruption. The manifest identifies the code that made the results; results from other code are
not used. The manifest of a campaign also describes its study.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import celnav
from celnav.files import (
    InputError,
    Outputs,
    data,
    read_json,
    read_npz,
    remove_leftovers,
    replacing,
    write_text,
)

if TYPE_CHECKING:
    from celnav.study.study import Unit

FORMAT = 2
MANIFEST, RESULTS = "manifest.json", ".results"
"""Name of a store's manifest, and of the subfolder of a paper's outputs that has its results."""
DATA = ("pulsars.toml", "ephemeris_2015.npz", "ephemeris_years.npz")
"""Data files of celnav that studies read."""
Array = NDArray[Any]


@cache
def code() -> dict[str, str]:
    """Versions that determine the results: of celnav (with a hash of its sources and data), numpy
    and scipy.
    """
    root = Path(celnav.__file__).parent
    digest = hashlib.sha256()
    for path in [*sorted(root.rglob("*.py")), *map(data, DATA)]:
        digest.update(path.name.encode("utf-8") + path.read_bytes())
    return {
        "celnav": celnav.__version__,
        "code": digest.hexdigest()[:12],
        **{name: metadata.version(name) for name in ("numpy", "scipy")},
    }


class Store:
    """Finished units in ``folder / "units"``; see `resumed`, `existing` and `open_store`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, unit: Unit) -> Path:
        """The file of a unit's result."""
        return self.folder / "units" / f"{unit.key}.npz"

    def write(self, unit: Unit, arrays: Mapping[str, Array]) -> None:
        """Store a result. OSError names the file if it cannot be written."""
        with replacing(self.path(unit)) as path:
            np.savez(path, allow_pickle=False, **arrays, checksum=np.array(_checksum(unit, arrays)))

    def has(self, unit: Unit, say: Callable[[str], Any] = print) -> bool:
        """Whether a unit is finished and its file valid; ``say`` gets a line if it is damaged."""
        try:
            return self.path(unit).exists() and bool(self.read(unit))
        except ValueError as error:
            say(f"{error}; it is computed again")
            return False

    def forget_all_but(self, units: Iterable[Unit]) -> None:
        """Remove the results of all other units."""
        wanted = {self.path(unit) for unit in units}
        for path in (self.folder / "units").glob("*.npz"):
            if path not in wanted:
                path.unlink(missing_ok=True)

    def read(self, unit: Unit) -> dict[str, Array]:
        """The result of a finished unit.

        Raises
        ------
        ValueError: if the file is damaged; it names the file. OSError: if it does not exist.
        """
        path = self.path(unit)
        arrays = read_npz(path)
        stored = arrays.pop("checksum", None)
        if stored is None or str(stored) != _checksum(unit, arrays):
            raise ValueError(
                f"{path}: expected the checksum of the contents and the name, got another"
            )
        try:
            unit.check(arrays)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        return arrays


def _checksum(unit: Unit, arrays: Mapping[str, Array]) -> str:
    """Checksum of arrays and the unit's key, which detects a file of another unit."""
    digest = hashlib.sha256(f"{unit.key} ".encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(array.data)
    return digest.hexdigest()


def existing(folder: Path) -> Store | None:
    """The store in a folder; None if there is none, or if other code made it. It writes nothing."""
    try:
        return Store(folder) if read_json(folder / MANIFEST) == _manifest() else None
    except (OSError, ValueError):
        return None


def resumed(folder: Path) -> Store:
    """The store in a locked folder. If other code made it, it is replaced by an empty store."""
    if existing(folder) is None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        _write_manifest(folder, _manifest())
    remove_leftovers(folder, folder / "units")
    return Store(folder)


class StoreError(InputError):
    """Error for a folder that does not belong to this study."""


def open_store(folder: str | Path, study: Mapping[str, Any], may_grow: Collection[str]) -> Store:
    """Open a campaign's store in a locked folder, or make a new store.

    study: everything that determines the results, in JSON types.
    may_grow: keys of ``study`` whose numbers or lists may be smaller in the store.

    Raises
    ------
    StoreError: if the folder belongs to another or a larger study, was begun with another version
        of celnav, numpy or scipy, or has other contents. The message lists the differences.
    OSError: if the folder cannot be made or written.
    """
    path = Path(folder)
    Outputs(path)
    remove_leftovers(path, path / "units")
    wanted = json.loads(json.dumps(_manifest(study=study)))
    cure = "choose another --out, or remove the folder"
    if (path / MANIFEST).exists():
        stored = _read_manifest(path / MANIFEST)
        if stored is None:
            raise StoreError(
                f"{path / MANIFEST}: not a manifest of a campaign of this celnav; {cure}"
            )
        for key, what in (
            ("study", "belongs to another study"),
            ("code", "was begun with another celnav"),
        ):
            if changed := _differences(stored[key], wanted[key], may_grow):
                raise StoreError(f"{path}: {what} ({'; '.join(changed)}); {cure}")
        if stored["study"] == wanted["study"]:
            return Store(path)
    elif (path / "units").exists():
        raise StoreError(f"{path}: has units but no {MANIFEST}; {cure}")
    _write_manifest(path, wanted)
    return Store(path)


def _manifest(**about: Any) -> dict[str, Any]:
    return {"format": FORMAT, **about, "code": code()}


def _write_manifest(folder: Path, about: Mapping[str, Any]) -> None:
    text = json.dumps(about, indent=1, ensure_ascii=False)
    write_text(folder / MANIFEST, text + "\n")


def _read_manifest(path: Path) -> dict[str, Any] | None:
    """The manifest of a campaign; None if the file is not a manifest."""
    try:
        manifest: dict[str, Any] = read_json(path)
        tables = isinstance(manifest["study"], dict) and isinstance(manifest["code"], dict)
        return manifest if tables and manifest["format"] == FORMAT else None
    except (ValueError, KeyError, TypeError):
        return None


def _differences(
    old: Mapping[str, Any], new: Mapping[str, Any], may_grow: Collection[str]
) -> list[str]:
    """``key: old -> new`` for each difference, except numbers and lists that may grow and did."""

    def is_same(key: str) -> bool:
        return key in may_grow and key in old and _is_within(old[key], new[key])

    keys = [key for key in {**old, **new} if _text(old, key) != _text(new, key)]
    return [f"{key}: {_text(old, key)} -> {_text(new, key)}" for key in keys if not is_same(key)]


def _is_within(old: Any, new: Any) -> bool:
    """Whether a new list contains the old value or all of an old list; a number must not shrink."""
    if not isinstance(new, list):
        return isinstance(old, int) and old <= new
    return old in new or (isinstance(old, list) and all(value in new for value in old))


def _text(table: Mapping[str, Any], key: str) -> str:
    return json.dumps(table[key], ensure_ascii=False) if key in table else "absent"
