"""A picture of a recording as the Rerun viewer shows it, without a screen."""

from __future__ import annotations

import os
import shutil
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import rerun as rr
from rerun.experimental import ViewerClient

from celnav.files import InputError, replacing
from celnav.views import TIMELINE

PATIENCE_S = 60.0
"""How long the viewer may take to draw."""
SETTLE_S = 8.0
"""How long the viewer shows notes about itself."""
LEAST_BYTES = 20_000
"""Of a picture that shows more than an empty window."""


def end(recording: str | Path) -> float:
    """Last time in a recording, seconds since its start; 0 without any.

    Raises
    ------
    ValueError: naming the file, if it cannot be read.
    """
    last = 0.0
    try:
        for chunk in rr.chunk.RrdReader(str(recording)).stream().to_chunks():
            if TIMELINE in chunk.timeline_names and chunk.num_rows:
                last = max(last, *chunk.to_record_batch().column(TIMELINE).cast("int64").to_pylist())
    except (RuntimeError, ValueError) as error:
        raise InputError(f"{recording}: expected a recording ({' '.join(str(error).split())[:200]})") from None
    return 1e-9 * last


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
    program = shutil.which("rerun", path=Path(sys.executable).parent) or shutil.which("rerun")
    with replacing(path) as target, _quiet(), socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        try:
            with ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True, executable_path=program) as viewer:
                viewer.open(str(Path(recording).resolve()))
                viewer.set_time(TIMELINE, duration=at, play_state="paused")
                target.write_bytes(_drawn(viewer, width))
        except (RuntimeError, ConnectionError, TimeoutError) as error:
            said = " ".join(str(error).split())[:200]
            raise OSError(f"{recording}: the viewer gave no picture ({said}); it needs a Vulkan driver") from None


@contextmanager
def _quiet() -> Iterator[None]:
    """What keeps the viewer from talking of itself, and of a desktop that is not there, in the environment."""
    with TemporaryDirectory() as folder:
        wanted = {name: value for name, value in (("RUST_LOG", "error"), ("XDG_RUNTIME_DIR", folder)) if name not in os.environ}
        os.environ.update(wanted)
        try:
            yield
        finally:
            for name in wanted:
                os.environ.pop(name, None)


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
