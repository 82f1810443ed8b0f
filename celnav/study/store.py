"""A store of results: a folder with a manifest and one checksummed file for each finished unit of
work.

Every file is written under a temporary name and renamed: the folder is right after any
interruption. The manifest says which code
made the results: another one's are not used.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import celnav
from celnav.files import data, read_json, read_npz, remove_leftovers, replacing, write_text

FORMAT = 2
MANIFEST, RESULTS = "manifest.json", ".results"
"""Of a store; folder of a paper's results below the folder of what is shown of it."""
Array = NDArray[Any]


class Keyed(Protocol):
    """What a result is of."""

    @property
    def key(self) -> str:
        """Hash of everything that determines the result, but the code."""

    def check(self, arrays: dict[str, Array]) -> None:
        """Raise ValueError if these are not arrays of such a result."""


@cache
def code() -> dict[str, str]:
    """What determines the numbers: versions of celnav, with a hash of its sources and data, and of
    what it computes with.
    """
    root = Path(celnav.__file__).parent
    digest = hashlib.sha256()
    for path in [
        *sorted(root.rglob("*.py")),
        data("pulsars.toml"),
        data("ephemeris_2015.npz"),
        data("ephemeris_years.npz"),
    ]:
        digest.update(path.name.encode("utf-8") + path.read_bytes())
    return {
        "celnav": celnav.__version__,
        "code": digest.hexdigest()[:12],
        **{name: metadata.version(name) for name in ("numpy", "scipy")},
    }


class Store:
    """Finished units in ``folder / "units"``; see `resumed`, `existing` and
    `celnav.campaign.open_store`.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, unit: Keyed) -> Path:
        """Where a unit's result is."""
        return self.folder / "units" / f"{unit.key}.npz"

    def write(self, unit: Keyed, arrays: Mapping[str, Array]) -> None:
        """Keep a result. OSError names the file if it cannot be written."""
        with replacing(self.path(unit)) as path:
            np.savez(path, allow_pickle=False, **arrays, checksum=np.array(_checksum(unit, arrays)))

    def has(self, unit: Keyed, say: Callable[[str], Any] = print) -> bool:
        """Whether a unit is finished and whole; ``say`` takes a line about one that is damaged."""
        try:
            return self.path(unit).exists() and bool(self.read(unit))
        except ValueError as error:
            say(f"{error}; it is computed again")
            return False

    def forget_all_but(self, units: Iterable[Keyed]) -> None:
        """Remove the results of others."""
        wanted = {self.path(unit) for unit in units}
        for path in (self.folder / "units").glob("*.npz"):
            if path not in wanted:
                path.unlink(missing_ok=True)

    def read(self, unit: Keyed) -> dict[str, Array]:
        """The result of a finished unit.

        Raises
        ------
        ValueError: naming the file, if it is damaged: nothing in it is used. OSError: if it is not
            there.
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


def _checksum(unit: Keyed, arrays: Mapping[str, Array]) -> str:
    """Of the key too: a copy of another unit is no result of this one."""
    digest = hashlib.sha256(f"{unit.key} ".encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(array.data)
    return digest.hexdigest()


def existing(folder: Path) -> Store | None:
    """The store in a folder, if there is one and this code made it; nothing is written."""
    try:
        return (
            Store(folder)
            if read_json(folder / MANIFEST) == {"format": FORMAT, "code": code()}
            else None
        )
    except (OSError, ValueError):
        return None


def resumed(folder: Path) -> Store:
    """The store in a folder that is locked, a new one if another code made what is there."""
    if existing(folder) is None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        write_text(
            folder / MANIFEST, json.dumps({"format": FORMAT, "code": code()}, indent=1) + "\n"
        )
    remove_leftovers(folder, folder / "units")
    return Store(folder)
