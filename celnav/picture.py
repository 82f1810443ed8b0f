"""A picture of a recording as the Rerun viewer shows it, without a screen."""

from __future__ import annotations

import os
import shutil
import socket
import sys
import time
from pathlib import Path

from rerun.experimental import ViewerClient

from celnav.files import write_bytes

TIMELINE = "t"
"""Of celnav's recordings, seconds."""
PATIENCE_S = 60.0
"""How long the viewer may take to draw."""
SETTLE_S = 8.0
"""How long the viewer shows notes about itself."""
LEAST_BYTES = 20_000
"""Of a picture that shows more than an empty window."""


def picture(recording: str | Path, path: str | Path, at: float, width: int = 1600) -> None:
    """Write a PNG of a recording at a time.

    Needs a Vulkan driver; one in software will do (``mesa-vulkan-drivers`` of Debian).

    Parameters
    ----------
    recording: an ``.rrd`` file. at: seconds since its start. width: pixels, at most.

    Raises
    ------
    OSError: if the viewer cannot start or draws nothing, or the file cannot be written.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    try:
        os.environ.setdefault("RUST_LOG", "error")  # what the viewer says of itself
        program = shutil.which("rerun", path=Path(sys.executable).parent) or shutil.which("rerun")
        with ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True, executable_path=program) as viewer:
            viewer.open(str(Path(recording).resolve()))
            viewer.set_time(TIMELINE, duration=at, play_state="paused")
            content = _drawn(viewer, width)
    except (RuntimeError, ConnectionError, TimeoutError) as error:
        said = " ".join(str(error).split())[:200]
        raise OSError(f"{recording}: the viewer gave no picture ({said}); it needs a Vulkan driver") from None
    write_bytes(path, content)


def _drawn(viewer: ViewerClient, width: int) -> bytes:
    """The window once it does not change any more."""
    deadline = time.monotonic() + PATIENCE_S
    time.sleep(SETTLE_S)
    last = b""
    while time.monotonic() < deadline:
        time.sleep(1.5)
        content = bytes(viewer.take_screenshot(max_size=width))
        if content == last and len(content) > LEAST_BYTES:
            return content
        last = content
    if len(last) > LEAST_BYTES:
        return last
    raise TimeoutError(f"nothing was drawn in {PATIENCE_S:g} s")
