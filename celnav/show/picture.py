"""A picture of a recording as the Rerun viewer shows it, without a screen."""

from __future__ import annotations

import contextlib
import io
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from celnav.files import replacing
from celnav.lazy import requires_extra
from celnav.show.views import TIMELINE

with requires_extra("a picture of a recording", "record"):
    from PIL import Image
    from rerun.experimental import ViewerClient

Ask = Callable[[Callable[[ViewerClient], Any]], Any]
"""Calls a function with the viewer's client, repeatedly until the viewer answers."""

HOST = "127.0.0.1"
"""Address at which the viewer listens."""
PATIENCE_S = 180.0
"""How long the viewer may take to start, to load and to draw."""
SETTLE_S = 8.0
"""How long the viewer shows notes about itself."""
CHANGES = 40
"""How often the window is captured while it changes."""
GRAPHICS = "vulkan|adapter|render context|wgpu|surface"
"""Words in the output of a viewer that finds no graphics driver."""
LEAST_BYTES = 20_000
"""Least size of a picture that shows more than an empty window."""
BAR = 31 / 900
"""Part of the window for the viewer's own bar: its menu and facts about the machine."""


def picture(recording: str | Path, path: str | Path, at: float, width: int = 1600) -> None:
    """Write a PNG of a recording at a time, without the viewer's own bar.

    Needs a Vulkan driver; a software driver will do (``mesa-vulkan-drivers`` of Debian). On a busy
    machine the viewer is asked repeatedly, for `PATIENCE_S` in all.

    Parameters
    ----------
    recording: an ``.rrd`` file. at: seconds since its start. width: pixels, at most.

    Raises
    ------
    OSError: with the reason, if the viewer ends or draws nothing in time, or if the file cannot be
        written.
    """
    try:
        with _viewer() as ask:
            ask(lambda viewer: viewer.open(str(Path(recording).resolve())))
            ask(lambda viewer: viewer.set_time(TIMELINE, duration=at, play_state="paused"))
            drawn = Image.open(io.BytesIO(_drawn(ask, width)))
    except (RuntimeError, TimeoutError) as error:
        raise OSError(f"{recording}: the viewer gave no picture {error}") from None
    with replacing(path) as target:
        drawn.crop((0, round(BAR * drawn.height), *drawn.size)).save(target, "PNG")


def command(*arguments: str) -> list[str]:
    """The viewer's command line; with it the viewer listens to this machine only."""
    return [sys.executable, "-m", "rerun", "--bind", HOST, *arguments]


@contextmanager
def _viewer() -> Iterator[Ask]:
    """A function that asks a viewer without a window; the viewer ends with the block.

    Hints about the viewer and a missing desktop are turned off. A failed request is repeated while
    the viewer runs. RuntimeError with its output if it has ended; TimeoutError after `PATIENCE_S`.
    """
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port = probe.getsockname()[1]
    deadline = time.monotonic() + PATIENCE_S
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

        def ask(request: Callable[[ViewerClient], Any]) -> Any:
            why: object = "it does not start"
            while time.monotonic() < deadline:
                if process.poll() is not None:
                    said.seek(0)
                    raise RuntimeError(_ended(process.returncode, said.read()))
                try:
                    if _answers(port):
                        return request(ViewerClient.connect(f"rerun+http://{HOST}:{port}/proxy"))
                except (RuntimeError, ConnectionError, TimeoutError) as error:
                    why = error
                time.sleep(0.1)
            raise TimeoutError(f"in {PATIENCE_S:g} s ({_line(why)}); try again on an idle machine")

        try:
            yield ask
        finally:
            _end(process)


def _ended(status: int, said: bytes) -> str:
    """Why a viewer ended, and the cure if it is known."""
    words = _line(said.decode(errors="replace").partition("stack backtrace")[0])
    hint = "; it needs a Vulkan driver" if re.search(GRAPHICS, words.lower()) else ""
    return f"({words or f'it ended with exit status {status}'}){hint}"


def _line(words: object) -> str:
    return " ".join(str(words).split())[:200]


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) == 0


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process and its children."""
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


def _drawn(ask: Ask, width: int) -> bytes:
    """The window when it has stopped changing, or after `CHANGES` looks."""
    time.sleep(SETTLE_S)
    last = b""
    for _ in range(CHANGES):
        time.sleep(1.5)
        content = bytes(ask(lambda viewer: viewer.take_screenshot(max_size=width)))
        if content == last and len(content) > LEAST_BYTES:
            break
        last = content
    if len(last) < LEAST_BYTES:
        raise TimeoutError(f"in {CHANGES} looks at its window, which stayed empty")
    return last
