"""Where notebooks write their recordings, so that a click opens them in the browser."""

from __future__ import annotations

import os
from pathlib import Path

from celnav.files import write_bytes
from celnav.show import read, viewer

OUT = Path(os.environ.get("CELNAV_OUT", "../out"))
"""The folder of `celnav reproduce`, which has the viewer of all recordings."""


def place(name):
    """The file of a recording, such as "tour/fall", in its folder."""
    file = OUT / f"{name}.rrd"
    file.parent.mkdir(parents=True, exist_ok=True)
    return file


def for_browser(file):
    """Write the recording as a script, and the viewer if it is missing. A line about both."""
    content = file.read_bytes()
    script = viewer.as_script(content, read(file).start)
    write_bytes(file.with_name(viewer.script_name(file.name)), script)
    if viewer.available() and not viewer.is_current(OUT):
        for name, data in viewer.viewer().items():
            write_bytes(OUT / name, data)
    print(f"{file.name}: {len(content) / 1e3:.0f} kB, start at {read(file).start:g} s")
