"""Recordings as scripts, and the viewer's page, which needs no network."""

from __future__ import annotations

import errno
import gzip
import json
import re
import shutil
import subprocess
from base64 import b64decode
from urllib.parse import unquote

import numpy as np
import pytest

from celnav import papers
from celnav.commands import reproduce
from celnav.commands.index import _shown, index
from celnav.files import Outputs
from celnav.lazy import MissingError
from celnav.show import recording, viewer, views
from celnav.show.claims import dumps

MODULE = """async function fetch_viewer_wasm(base_url) {
  //!<INLINE-MARKER-OPEN>
  return fetch(new URL("./re_viewer_bg.wasm", base_url));
  //!<INLINE-MARKER-CLOSE>
}
class WebViewer {}
export {
  widget_default as default
};
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with the viewer's layout that replaces the installed one."""
    static = tmp_path / viewer.PACKAGE / "static"
    static.mkdir(parents=True)
    (static.parent / "__init__.py").touch()
    (static / "widget.js").write_text(MODULE)
    (static / "re_viewer_bg.wasm").write_bytes(b"\0asm" + bytes(range(256)))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(viewer, "version", lambda name: "9.9")
    return static


def quoted(script):
    """The texts of base 64 in a script, decoded."""
    return [b64decode(text) for text in re.findall(r'"([A-Za-z0-9+/=]{20,})"', script.decode())]


def test_the_viewer_is_one_script_that_fetches_nothing(package):
    files = viewer.viewer()
    wasm, module = quoted(files[viewer.SCRIPT])
    assert gzip.decompress(wasm) == (package / "re_viewer_bg.wasm").read_bytes()
    assert b"fetch(" not in module
    assert b"return window.celnavWasm();" in module
    assert module.decode().endswith("class WebViewer {}\ncelnavViewer(WebViewer);\n")
    page = files[viewer.PAGE].decode()
    assert "://" not in page
    assert files == viewer.viewer()  # the same bytes each time


def test_a_recording_is_a_script_with_its_bytes():
    recording = bytes(range(256)) * 3
    script = viewer.as_script(recording, 65.0)
    assert quoted(script) == [recording]
    assert script.startswith(b'celnavRecording("')
    assert script.endswith(b'", 65.0);\n')
    assert viewer.is_script_of(script, recording)
    assert not viewer.is_script_of(script, recording[1:])


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (("a.rrd",), "viewer.html?a"),
        (("my study/a b.rrd",), "viewer.html?my%20study/a%20b"),
    ],
)
def test_addresses(given, text):
    assert viewer.address(*given) == text


def test_a_viewer_of_another_version_is_not_current(package, tmp_path, monkeypatch):
    assert not viewer.is_current(tmp_path)
    for name, content in viewer.viewer().items():
        (tmp_path / name).write_bytes(content)
    assert viewer.is_current(tmp_path)
    monkeypatch.setattr(viewer, "version", lambda name: "10.0")
    assert not viewer.is_current(tmp_path)


def test_another_viewer_is_refused_by_its_version(package):
    (package / "widget.js").write_text(MODULE.replace("//!<INLINE-MARKER-OPEN>", ""))
    with pytest.raises(RuntimeError, match=r"version 0\.41 has, got version 9\.9"):
        viewer.viewer()


def test_results_are_written_without_another_viewer(package, tmp_path, capsys):
    (package / "widget.js").write_text(MODULE.replace("export {", ""))
    reproduce.write_viewer(Outputs(tmp_path), {})
    assert "no viewer (rerun_notebook: expected a script of the form" in capsys.readouterr().err
    assert not (tmp_path / viewer.PAGE).exists()


def test_without_its_package(monkeypatch):
    monkeypatch.setattr(viewer, "find_spec", lambda name: None)
    with pytest.raises(MissingError, match="the viewer in the browser needs rerun_notebook"):
        viewer.viewer()


def test_reproduce_writes_it_and_the_page_links_it(package, tmp_path):
    """An existing recording becomes a script; a missing recording has no link."""
    out, outputs = tmp_path / "out", Outputs(tmp_path / "out" / "csrukf")
    times, layout = np.arange(3.0), views.text(origin="info")
    with (
        outputs.path_for("csrukf_P_08.rrd") as path,
        recording.recording(path, times, name="a", layout=layout, start=1.5) as written,
    ):
        written.text("info", "a text")
    content = (outputs.directory / "csrukf_P_08.rrd").read_bytes()
    for kind in ("claims", "checks"):
        outputs.text(f"{kind}.json", dumps([]))
    outputs.bytes("figures/csrukf_figure_08.png", b"")
    assert "viewer.html" not in index(out)
    task = reproduce.Task("csrukf", papers.load("csrukf"), None, outputs)
    reproduce.write_viewer(Outputs(out), {"csrukf": task})
    assert viewer.is_current(out)
    script = (out / "csrukf" / "csrukf_P_08.rrd.js").read_bytes()
    assert quoted(script) == [content]
    assert script.endswith(b", 1.5);\n")
    assert not (out / "csrukf" / "csrukf_P_0.rrd.js").exists()
    before = (out / viewer.SCRIPT).stat().st_mtime_ns
    reproduce.write_viewer(Outputs(out), {"csrukf": task})
    assert (out / viewer.SCRIPT).stat().st_mtime_ns == before  # made once

    def live():
        return {found["name"]: found["live"] for found in _shown(out, "csrukf", [])["recordings"]}

    assert live() == {"csrukf_P_08": viewer.address("csrukf/csrukf_P_08.rrd")}
    outputs.bytes("csrukf_P_08.rrd", b"a later one, reproduced with --no-viewer")
    assert live() == {"csrukf_P_08": ""}


def test_without_the_viewer_a_recording_is_its_picture_or_the_file(tmp_path):
    outputs = Outputs(tmp_path / "csrukf")
    outputs.bytes("csrukf_P_08.rrd", b"a" * 1_200_000)
    for kind in ("claims", "checks"):
        outputs.text(f"{kind}.json", dumps([]))
    assert 'href="csrukf/csrukf_P_08.rrd">csrukf_P_08 (1.2 MB)</a>' in index(tmp_path)
    outputs.bytes("csrukf_P_08.png", b"")
    assert 'href="csrukf/csrukf_P_08.png">csrukf_P_08 (picture)</a>' in index(tmp_path)


def test_a_viewer_that_is_half_written_is_written_again(package, tmp_path, monkeypatch):
    """The disk is full when another version replaces the present one."""
    top = Outputs(tmp_path)
    top.publish(viewer.viewer())
    monkeypatch.setattr(viewer, "version", lambda name: "10.0")
    (package / "widget.js").write_text(MODULE.replace("class", "class of 10.0:"))
    write = Outputs.bytes

    def full(self, name, content):
        if name == viewer.SCRIPT:
            raise OSError(errno.ENOSPC, "no space left")
        write(self, name, content)

    with monkeypatch.context() as now:
        now.setattr(Outputs, "bytes", full)
        with pytest.raises(OSError, match="no space"):
            reproduce.write_viewer(top, {})
    reproduce.write_viewer(top, {})
    assert b"class of 10.0:" in quoted((tmp_path / viewer.SCRIPT).read_bytes())[1]


LOADED = """
const script = require("fs").readFileSync(0, "utf8").split("<script>")[1].split("</script>")[0];
const loaded = [];
const element = {append: (child) => loaded.push(child.src)};
const document = {getElementById: () => element, createElement: () => ({}), head: element};
const search = process.argv[1].slice(process.argv[1].indexOf("?"));
new Function("window", "document", "location", script)({}, document, {search});
console.log(JSON.stringify([loaded[0], document.title]));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
@pytest.mark.parametrize("name", ["a", "a b", "a#b", "a@2", "50%", "a?b", 'it\'s "q"', "ä"])
def test_the_page_loads_the_script_of_the_recording(name, package):
    recording = f"my study/{name}.rrd"
    command = ["node", "-e", LOADED, viewer.address(recording)]
    page = viewer.page()
    done = subprocess.run(command, input=page, capture_output=True, check=True)
    source, title = json.loads(done.stdout)
    assert not set(source) & set("#?@ ")
    assert unquote(source) == viewer.script_name(recording)
    assert title == name
