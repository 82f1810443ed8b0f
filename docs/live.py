"""A *Run* button on the programs of the site: Python in the browser, without any other server.

``python -m docs OUT --live DIR`` copies the files that it needs from DIR: a release of Pyodide, and
celnav's wheel. Both are large, so they are not in the repository; the page "Try it" names them.
"""

from __future__ import annotations

import json
import shutil
import tomllib
from hashlib import sha256
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

import celnav

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = ROOT / "docs" / "_live"
LIBRARIES = ("numpy", "scipy")
FIGURES = "matplotlib"  # optional; loaded when a program calls savefig
RUNTIME = ("pyodide.mjs", "pyodide.asm.wasm", "python_stdlib.zip", "pyodide-lock.json")
BINDING = ("pyodide.asm.js", "pyodide.asm.mjs")  # named .js until Pyodide 0.29
WITHOUT = (
    "howto/filterpy",  # needs filterpy
    "howto/logs",  # needs pandas
    "howto/machine_code",  # needs llvmlite
    "howto/own_study",  # is for the command line
    "howto/recordings",  # needs Rerun
)
"""Pages whose programs need more than a browser has."""


class LiveError(Exception):
    """The folder lacks a file, or a file differs from the one that Pyodide's lock file names."""


def closure(packages: dict[str, Any], *names: str) -> list[str]:
    """Names of packages of a lock file, with what they depend on."""
    found: list[str] = []
    for name in names:
        if name not in packages:
            raise LiveError(f"pyodide-lock.json: expected the package {name}, got none")
        depends = packages[name]["depends"]
        found += [one for one in (*closure(packages, *depends), name) if one not in found]
    return found


def existing(folder: Path, name: str) -> Path:
    """A file of the folder."""
    if not (folder / name).is_file():
        raise LiveError(f"--live: expected {name} in {folder}, got no such file")
    return folder / name


def package_file(folder: Path, package: dict[str, Any]) -> Path:
    """The file of a package, which has to have the hash of the lock file."""
    path = existing(folder, package["file_name"])
    if sha256(path.read_bytes()).hexdigest() != package["sha256"]:
        raise LiveError(f"{path}: expected the SHA-256 in pyodide-lock.json, got another")
    return path


def older(packages: dict[str, Any]) -> list[str]:
    """A sentence for each library that is older than celnav's wheel requires."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = {one.name: one.specifier for one in map(Requirement, project["dependencies"])}
    return [
        f"celnav requires {name}{wanted[name]}; this Pyodide has {packages[name]['version']}"
        for name in LIBRARIES
        if not wanted[name].contains(packages[name]["version"], prereleases=True)
    ]


def add_live(folder: Path, static: Path) -> list[str]:
    """Copy Pyodide, its packages, celnav's wheel and the scripts of the button. Returns a sentence
    for each library that is older than celnav requires.

    folder: of Pyodide's files and celnav's wheel. static: the folder of the site's static files.
    Raises LiveError if a file is missing or is not the one that the lock file names.
    """
    packages = json.loads(existing(folder, "pyodide-lock.json").read_bytes())["packages"]
    figures = FIGURES in packages and (folder / packages[FIGURES]["file_name"]).is_file()
    names = closure(packages, *LIBRARIES, *([FIGURES] if figures else []))
    wheel = existing(folder, f"celnav-{celnav.__version__}-py3-none-any.whl")
    files = [existing(folder, name) for name in RUNTIME]
    files += [folder / name for name in BINDING if (folder / name).is_file()]
    files += [package_file(folder, packages[name]) for name in names]
    out = static / "live"
    out.mkdir(parents=True)
    for path in (*files, wheel, *SCRIPTS.glob("*.js")):
        shutil.copy(path, out)
    settings = {
        "wheel": wheel.name,
        "libraries": LIBRARIES,
        "figures": [FIGURES] if figures else [],
        "without": WITHOUT,
    }
    (out / "settings.json").write_text(json.dumps(settings), encoding="utf-8")
    return older(packages)
