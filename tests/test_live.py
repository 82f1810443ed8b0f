"""The *Run* buttons of the site: which files they need, and on which pages they are."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pytest

import celnav

pytest.importorskip("sphinx")
from docs.live import RUNTIME, WITHOUT, LiveError, add_live

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
WHEEL = f"celnav-{celnav.__version__}-py3-none-any.whl"
VERSIONS = {"numpy": "2.4.6", "scipy": "1.18.0", "openblas": "0.3.31", "matplotlib": "3.10.8"}
DEPENDS = {"scipy": ["numpy", "openblas"], "matplotlib": ["numpy"]}


@pytest.fixture
def folder(tmp_path):
    """A folder with files named as Pyodide names them; matplotlib's file is missing."""
    folder = tmp_path / "pyodide"
    folder.mkdir()
    packages = {
        name: {
            "version": version,
            "file_name": f"{name}-{version}.whl",
            "sha256": sha256(name.encode()).hexdigest(),
            "depends": DEPENDS.get(name, []),
        }
        for name, version in VERSIONS.items()
    }
    for name in ("numpy", "scipy", "openblas"):
        (folder / packages[name]["file_name"]).write_text(name, encoding="utf-8")
    for name in (*RUNTIME, "pyodide.asm.mjs", WHEEL, "other.whl"):
        (folder / name).write_text(name, encoding="utf-8")
    (folder / "pyodide-lock.json").write_text(json.dumps({"packages": packages}), encoding="utf-8")
    return folder


def test_the_site_gets_what_the_libraries_need_and_no_more(folder, tmp_path):
    assert add_live(folder, tmp_path / "static") == []
    out = tmp_path / "static" / "live"
    assert {path.name for path in out.iterdir()} == {
        *RUNTIME,
        "pyodide.asm.mjs",
        WHEEL,
        "numpy-2.4.6.whl",
        "scipy-1.18.0.whl",
        "openblas-0.3.31.whl",
        "run.js",
        "worker.js",
        "settings.json",
    }
    settings = json.loads((out / "settings.json").read_text(encoding="utf-8"))
    assert (settings["wheel"], settings["figures"]) == (WHEEL, [])
    (folder / "matplotlib-3.10.8.whl").write_text("matplotlib", encoding="utf-8")
    add_live(folder, tmp_path / "figures")
    settings = json.loads((tmp_path / "figures" / "live" / "settings.json").read_bytes())
    assert settings["figures"] == ["matplotlib"]


@pytest.mark.parametrize("name", ["pyodide.mjs", "pyodide-lock.json", "scipy-1.18.0.whl", WHEEL])
def test_a_missing_file_is_named(folder, tmp_path, name):
    (folder / name).unlink()
    with pytest.raises(LiveError, match=f"expected {re.escape(name)} in"):
        add_live(folder, tmp_path / "static")


def test_a_changed_file_is_refused(folder, tmp_path):
    (folder / "openblas-0.3.31.whl").write_text("other", encoding="utf-8")
    with pytest.raises(LiveError, match=r"openblas-0\.3\.31\.whl: expected the SHA-256"):
        add_live(folder, tmp_path / "static")
    command = [sys.executable, "-m", "docs", str(tmp_path / "site"), "--live", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert (done.returncode, "expected the SHA-256" in done.stderr) == (2, True)
    assert not (tmp_path / "site").exists()


def test_older_libraries_are_named(folder, tmp_path):
    lock = json.loads((folder / "pyodide-lock.json").read_text(encoding="utf-8"))
    lock["packages"]["numpy"]["version"] = "2.0.2"
    (folder / "pyodide-lock.json").write_text(json.dumps(lock), encoding="utf-8")
    (sentence,) = add_live(folder, tmp_path / "static")
    assert re.fullmatch(r"celnav requires numpy>=\S+; this Pyodide has 2\.0\.2", sentence)


def test_programs_with_a_button_need_only_the_light_core():
    """Pages with other programs are listed, and no page is listed that is not there."""
    pages = {
        str(path.relative_to(DOCS).with_suffix("")): re.findall(
            r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL
        )
        for path in DOCS.rglob("*.md")
    }
    assert all(pages[name] for name in WITHOUT)
    allowed = {"numpy", "scipy", "celnav", *sys.stdlib_module_names}
    for name in pages.keys() - set(WITHOUT):
        roots = re.findall(r"^(?:import|from) (\w+)", "\n".join(pages[name]), re.MULTILINE)
        assert set(roots) <= allowed, name
