"""A picture of a recording as the Rerun viewer shows it, without a screen."""

from __future__ import annotations

import io
import time
from pathlib import Path

from celnav.files import replacing
from celnav.lazy import requires_extra
from celnav.show import window

with requires_extra("a picture of a recording", "record"):
    from PIL import Image

SETTLE_S = 8.0
"""How long the viewer shows notes about itself."""
CHANGES = 40
"""How often the window is captured while it changes."""
LEAST_BYTES = 20_000
"""Least size of a picture that shows more than an empty window."""
BAR = 31 / 900
"""Part of the window for the viewer's own bar: its menu and facts about the machine."""


def picture(recording: str | Path, path: str | Path, at: float, width: int = 1600) -> None:
    """Write a PNG of a recording at a time, without the viewer's own bar.

    Needs a Vulkan driver; a software driver will do (``mesa-vulkan-drivers`` of Debian). On a busy
    machine the viewer is asked repeatedly, for `celnav.show.window.PATIENCE_S` in all.

    Parameters
    ----------
    recording: an ``.rrd`` file. at: seconds since its start. width: pixels, at most.

    Raises
    ------
    OSError: with the reason, if the viewer ends or draws nothing in time, or if the file cannot be
        written.
    """
    try:
        with window.viewer("--headless") as viewer:
            viewer.open(recording, at)
            drawn = Image.open(io.BytesIO(_drawn(viewer, width)))
    except (RuntimeError, TimeoutError) as error:
        raise OSError(f"{recording}: the viewer gave no picture {error}") from None
    with replacing(path) as target:
        drawn.crop((0, round(BAR * drawn.height), *drawn.size)).save(target, "PNG")


def _drawn(viewer: window.Viewer, width: int) -> bytes:
    """The window when it has stopped changing, or after `CHANGES` looks."""
    time.sleep(SETTLE_S)
    last = b""
    for _ in range(CHANGES):
        time.sleep(1.5)
        content = bytes(viewer.ask(lambda client: client.take_screenshot(max_size=width)))
        if content == last and len(content) > LEAST_BYTES:
            break
        last = content
    if len(last) < LEAST_BYTES:
        raise TimeoutError(f"in {CHANGES} looks at its window, which stayed empty")
    return last
