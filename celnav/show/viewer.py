"""Recordings in the browser without a network: a page, a script with the viewer, and a script for
each recording.

A page that is opened from disk may load scripts, but no other files. So the viewer's WebAssembly
and the recordings are text in scripts. The viewer is from the package ``rerun-notebook``.
"""

from __future__ import annotations

import gzip
from base64 import b64encode
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote

from celnav.lazy import installed, requires_extra

PAGE, SCRIPT = "viewer.html", "viewer.js"
PACKAGE = "rerun_notebook"
_OPEN, _CLOSE = "//!<INLINE-MARKER-OPEN>", "//!<INLINE-MARKER-CLOSE>"
"""Markers around the code with which the viewer's script fetches its WebAssembly."""
_EXPORT = "export {"
_START = """\
"use strict";
{
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const packed = "@WASM";
  window.celnavWasm = () =>
    new Response(new Blob([bytes(packed)]).stream().pipeThrough(new DecompressionStream("gzip")),
      { headers: { "Content-Type": "application/wasm" } });
  const module = document.createElement("script");
  module.type = "module";
  module.textContent = new TextDecoder().decode(bytes("@MODULE"));
  document.head.append(module);
}
"""


def available() -> bool:
    """Whether the viewer's package is installed."""
    return installed(PACKAGE)


def page() -> bytes:
    """The viewer's page, with the version of the viewer in it."""
    template = (Path(__file__).parent / "pages" / PAGE).read_text(encoding="utf-8")
    return template.replace("@VERSION", version(PACKAGE.replace("_", "-"))).encode()


def viewer() -> dict[str, bytes]:
    """The two files of the viewer by name, 23 MB; MissingError if its package is not installed."""
    with requires_extra("the viewer in the browser", "notebooks"):
        if (spec := find_spec(PACKAGE)) is None or spec.origin is None:
            raise ModuleNotFoundError(name=PACKAGE)
    static = Path(spec.origin).parent / "static"
    module = _patched((static / "widget.js").read_text(encoding="utf-8"))
    wasm = gzip.compress((static / "re_viewer_bg.wasm").read_bytes(), 6, mtime=0)
    script = _START.replace("@WASM", _text(wasm)).replace("@MODULE", _text(module.encode()))
    # The page has the version: it is written last, when the script is there.
    return {SCRIPT: script.encode(), PAGE: page()}


def is_current(folder: Path) -> bool:
    """Whether a folder has the viewer of the installed version."""
    files = folder / PAGE, folder / SCRIPT
    return all(path.is_file() for path in files) and files[0].read_bytes() == page()


def script_name(recording: str) -> str:
    """Name of the file with a recording's script, beside the recording."""
    return f"{recording}.js"


def as_script(recording: bytes, start: float) -> bytes:
    """The script of a recording, the bytes of an ``.rrd`` file, which opens at ``start`` s."""
    return f'celnavRecording("{_text(recording)}", {start!r});\n'.encode()


def is_script_of(script: bytes, recording: bytes) -> bool:
    """Whether a script is that of a recording."""
    return _text(recording).encode() in script


def address(recording: str) -> str:
    """The address that shows a recording, whose path is relative to the page.

    >>> address("csrukf/gaps.rrd")
    'viewer.html?csrukf/gaps'
    """
    return f"{PAGE}?{quote(recording.removesuffix('.rrd'))}"


def _patched(module: str) -> str:
    """The viewer's script, changed to take its WebAssembly from memory and to give its class to the
    page.
    """
    start, end = module.find(_OPEN), module.find(_CLOSE)
    export = module.rfind(_EXPORT)
    if min(start, end, export) < 0:
        other = version(PACKAGE.replace("_", "-"))
        raise RuntimeError(
            f"{PACKAGE}: expected a script of the form that version 0.41 has, got version {other}"
        )
    wasm = "\nreturn window.celnavWasm();\n"
    return module[: start + len(_OPEN)] + wasm + module[end:export] + "celnavViewer(WebViewer);\n"


def _text(data: bytes) -> str:
    return b64encode(data).decode()
