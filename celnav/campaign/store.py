"""The store: a folder with a manifest and one checksummed file for each finished unit.

Every file is written under a temporary name and renamed, so the folder is right after any interruption.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from celnav.campaign.missions import Study
from celnav.campaign.units import Work, code
from celnav.files import InputError, Outputs, read_json, read_npz, remove_leftovers, write_bytes, write_text
from celnav.gaussian.linalg import Array

FORMAT = 2
MANIFEST = "manifest.json"


class StoreError(InputError):
    """A folder that does not belong to this study."""


class Store:
    """Finished units in ``folder / "units"``; see `open_store` and `resumed`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, unit: Work) -> Path:
        """Where a unit's result is."""
        return self.folder / "units" / f"{unit.key}.npz"

    def write(self, unit: Work, arrays: Mapping[str, Array]) -> None:
        """Keep a result. OSError names the file if it cannot be written."""
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays, checksum=np.array(_checksum(unit, arrays)))
        write_bytes(self.path(unit), buffer.getvalue())

    def has(self, unit: Work) -> bool:
        """Whether a unit is finished and whole.

        Raises
        ------
        ValueError: see `read`.
        """
        return self.path(unit).exists() and bool(self.read(unit))

    def remove(self, unit: Work) -> None:
        """Forget a result that is needed no more."""
        self.path(unit).unlink(missing_ok=True)

    def read(self, unit: Work) -> dict[str, Array]:
        """The result of a finished unit.

        Raises
        ------
        ValueError: naming the file, if it is damaged: nothing in it is used. OSError: if it is not there.
        """
        path = self.path(unit)
        arrays = read_npz(path)
        stored = arrays.pop("checksum", None)
        if stored is None or str(stored) != _checksum(unit, arrays):
            raise ValueError(f"{path}: checksum does not agree with the contents and the name")
        try:
            unit.check(arrays)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        return arrays


def _checksum(unit: Work, arrays: Mapping[str, Array]) -> str:
    """Of the key too: a copy of another unit is no result of this one."""
    digest = hashlib.sha256(f"{unit.key} ".encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def open_store(folder: str | Path, study: Study) -> Store:
    """Begin a store, or go on with one of the same study, in a folder that is locked.

    A study may have grown since: by runs, and by values of swept keys, or of keys that had one value.

    Raises
    ------
    StoreError: if the folder belongs to another study, or one of more, or was begun with another celnav, numpy or scipy (the
    message lists the differences), or holds something else.
    OSError: if it cannot be made or written.
    """
    path = Path(folder)
    Outputs(path)
    remove_leftovers(path, path / "units")
    wanted = json.loads(json.dumps(study.to_dict()))
    manifest = path / MANIFEST
    if manifest.exists():
        found = _read_manifest(manifest)
        for what, old, new, grown in (
            ("belongs to another study", found["study"], wanted, {"runs", *(f"config.{key}" for key in study.swept)}),
            ("was begun with another celnav", found["code"], code(), ()),
        ):
            if changed := _differences(old, new, grown):
                raise StoreError(f"{path}: {what} ({'; '.join(changed)}); choose another --out, or remove the folder")
        if found["study"] == wanted:
            return Store(path)
    elif (path / "units").exists():
        raise StoreError(f"{path}: has units but no {MANIFEST}; choose another --out, or remove the folder")
    about = {"format": FORMAT, "study": wanted, "code": code()}
    write_text(manifest, json.dumps(about, indent=1, ensure_ascii=False) + "\n")
    return Store(path)


def resumed(folder: Path) -> Store:
    """A store of units that are not all done yet, in a folder that is locked; what another celnav left there is removed."""
    manifest, wanted = folder / MANIFEST, {"format": FORMAT, "code": code()}
    try:
        same = read_json(manifest) == wanted
    except (OSError, ValueError):
        same = False
    if not same:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        write_text(manifest, json.dumps(wanted, indent=1) + "\n")
    remove_leftovers(folder, folder / "units")
    return Store(folder)


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        found = read_json(path)
        if found["format"] == FORMAT and isinstance(found["study"], dict) and isinstance(found["code"], dict):
            return dict(found)
    except (ValueError, KeyError, TypeError):
        pass
    raise StoreError(f"{path}: not a manifest of a campaign of this celnav; choose another --out, or remove the folder")


def _differences(old: Mapping[str, Any], new: Mapping[str, Any], grown: Collection[str]) -> list[str]:
    """``key: old -> new`` of everything that differs, but for numbers and lists of some keys that have more in them now."""
    keys = [key for key in dict.fromkeys([*old, *new]) if _shown(old, key) != _shown(new, key)]
    same = {key for key in keys if key in grown and key in old and _within(old[key], new[key])}
    return [f"{key}: {_shown(old, key)} -> {_shown(new, key)}" for key in keys if key not in same]


def _within(old: Any, new: Any) -> bool:
    """Whether a list has an old value, or all of an old list, and a number is not below the old one."""
    if not isinstance(new, list):
        return isinstance(old, int) and old <= new
    return old in new or (isinstance(old, list) and all(value in new for value in old))


def _shown(table: Mapping[str, Any], key: str) -> str:
    return json.dumps(table[key], ensure_ascii=False) if key in table else "absent"
