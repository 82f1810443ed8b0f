"""A picture of a recording as the Rerun viewer shows it, without a screen."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from celnav.files import InputError, replacing
from celnav.lazy import needed_by
from celnav.show.views import TIMELINE

with needed_by("a picture of a recording", "record"):
    import rerun as rr
    from PIL import Image
    from rerun.experimental import ViewerClient

__all__ = ["command", "end", "picture"]

HOST = "127.0.0.1"
"""What the viewer listens to."""
PATIENCE_S = 60.0
"""How long the viewer may take to draw."""
SETTLE_S = 8.0
"""How long the viewer shows notes about itself."""
LEAST_BYTES = 20_000
"""Of a picture that shows more than an empty window."""
BAR = 31 / 900
"""Part of the window that is the viewer's own: its menu, and what it says of the machine."""


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
                last = max(
                    last, *chunk.to_record_batch().column(TIMELINE).cast("int64").to_pylist()
                )
    except (RuntimeError, ValueError) as error:
        raise InputError(
            f"{recording}: expected a recording ({' '.join(str(error).split())[:200]})"
        ) from None
    return 1e-9 * last


def picture(recording: str | Path, path: str | Path, at: float, width: int = 1600) -> None:
    """Write a PNG of a recording at a time, without the viewer's own bar.

    Needs a Vulkan driver; one in software will do (``mesa-vulkan-drivers`` of Debian).

    Parameters
    ----------
    recording: an ``.rrd`` file. at: seconds since its start. width: pixels, at most.

    Raises
    ------
    OSError: if the viewer cannot start or draws nothing, or the file cannot be written.
    """
    with replacing(path) as target:
        try:
            with _viewer() as viewer:
                viewer.open(str(Path(recording).resolve()))
                viewer.set_time(TIMELINE, duration=at, play_state="paused")
                drawn = Image.open(io.BytesIO(_drawn(viewer, width)))
                drawn.crop((0, round(BAR * drawn.height), *drawn.size)).save(target, "PNG")
        except (RuntimeError, ConnectionError, TimeoutError) as error:
            said = " ".join(str(error).split())[:200]
            raise OSError(
                f"{recording}: the viewer gave no picture ({said}); it needs a Vulkan driver"
            ) from None


def command(*arguments: str) -> list[str]:
    """How the viewer is started; it listens to this machine only, which it would not by itself."""
    return [sys.executable, "-m", "rerun", "--bind", HOST, *arguments]


@contextmanager
def _viewer() -> Iterator[ViewerClient]:
    """A viewer without a window, which does not talk of itself, nor of a desktop that is not there; it ends with the block."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port = probe.getsockname()[1]
    with TemporaryDirectory() as folder, Path(folder, "said").open("w+b") as said:
        words = command("--headless", "--hide-welcome-screen", "--port", str(port))
        env = {"RUST_LOG": "error", "XDG_RUNTIME_DIR": folder, **os.environ}
        process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            env=env,
            start_new_session=True,
        )
        try:
            deadline = time.monotonic() + PATIENCE_S
            while not _answers(port):
                if process.poll() is not None or time.monotonic() > deadline:
                    said.seek(0)
                    raise RuntimeError(
                        said.read().decode(errors="replace").strip() or "it does not start"
                    )
                time.sleep(0.1)
            yield ViewerClient.connect(f"rerun+http://{HOST}:{port}/proxy")
        finally:
            _end(process)


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) == 0


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process and what it started, which on Windows are one."""
    if sys.platform != "win32":
        for sign in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
                os.killpg(process.pid, sign)
                process.wait(5.0)
    else:
        subprocess.run(
            ["taskkill", "/PID", str(process.pid), "/T", "/F"], check=False, capture_output=True
        )
    process.wait()


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
