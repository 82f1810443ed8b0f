"""The store of a campaign: `celnav.study.store`, whose manifest says which study it is of."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from celnav.campaign.missions import Study
from celnav.files import InputError, Outputs, read_json, remove_leftovers, write_text
from celnav.study.store import FORMAT, MANIFEST, Store, code


class StoreError(InputError):
    """A folder that does not belong to this study."""


def open_store(folder: str | Path, study: Study) -> Store:
    """Begin a store, or go on with one of the same study, in a folder that is locked.

    A study may have grown since: by runs, and by values of swept keys, or of keys that had one.

    Raises
    ------
    StoreError: if the folder belongs to another study, or one of more, or was begun with another
        celnav, numpy or scipy (the message lists the differences), or holds something else.
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
            (
                "belongs to another study",
                found["study"],
                wanted,
                {"runs", *(f"config.{key}" for key in study.swept)},
            ),
            ("was begun with another celnav", found["code"], code(), ()),
        ):
            if changed := _differences(old, new, grown):
                raise StoreError(
                    f"{path}: {what} ({'; '.join(changed)}); choose another --out, or remove the "
                    "folder"
                )
        if found["study"] == wanted:
            return Store(path)
    elif (path / "units").exists():
        raise StoreError(
            f"{path}: has units but no {MANIFEST}; choose another --out, or remove the folder"
        )
    about = {"format": FORMAT, "study": wanted, "code": code()}
    write_text(manifest, json.dumps(about, indent=1, ensure_ascii=False) + "\n")
    return Store(path)


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        found = read_json(path)
        if (
            found["format"] == FORMAT
            and isinstance(found["study"], dict)
            and isinstance(found["code"], dict)
        ):
            return dict(found)
    except (ValueError, KeyError, TypeError):
        pass
    raise StoreError(
        f"{path}: not a manifest of a campaign of this celnav; choose another --out, or remove the "
        "folder"
    )


def _differences(
    old: Mapping[str, Any], new: Mapping[str, Any], grown: Collection[str]
) -> list[str]:
    """``key: old -> new`` of everything that differs, but for numbers and lists of some keys that
    have more in them now.
    """
    keys = [key for key in dict.fromkeys([*old, *new]) if _shown(old, key) != _shown(new, key)]
    same = {key for key in keys if key in grown and key in old and _within(old[key], new[key])}
    return [f"{key}: {_shown(old, key)} -> {_shown(new, key)}" for key in keys if key not in same]


def _within(old: Any, new: Any) -> bool:
    """Whether a list has the old value, or all of the old list, or a number is not smaller."""
    if not isinstance(new, list):
        return isinstance(old, int) and old <= new
    return old in new or (isinstance(old, list) and all(value in new for value in old))


def _shown(table: Mapping[str, Any], key: str) -> str:
    return json.dumps(table[key], ensure_ascii=False) if key in table else "absent"
