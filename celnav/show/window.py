"""The process of the Rerun viewer, in a window or without one, and a recording in its window."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, Any

from celnav.lazy import requires_extra
from celnav.show.views import TIMELINE

with requires_extra("the viewer", "record"):
    from rerun.experimental import ViewerClient

HOST = "127.0.0.1"
"""Address at which the viewer listens."""
SIZE = "--window-size", "1600x900"
"""Size of a window for which recordings are laid out."""
PATIENCE_S = 180.0
"""How long the viewer may take to start, to load and to draw."""
GRAPHICS = "vulkan|adapter|render context|wgpu|surface"
"""Words in the output of a viewer that finds no graphics driver."""


@dataclass(frozen=True, eq=False)
class Viewer:
    """A viewer that was started. ``said`` is a file with its output."""

    process: subprocess.Popen[bytes]
    port: int
    said: IO[bytes]
    deadline: float

    @property
    def address(self) -> str:
        """The address at which it listens."""
        return f"rerun+http://{HOST}:{self.port}/proxy"

    def ask(self, request: Callable[[ViewerClient], Any]) -> Any:
        """What a function of the viewer's client returns. It is called until the viewer answers.

        Raises
        ------
        RuntimeError: with the viewer's output, if it has ended. TimeoutError: after `PATIENCE_S`.
        """
        why: object = "it does not start"
        while time.monotonic() < self.deadline:
            if self.process.poll() is not None:
                self.said.seek(0)
                raise RuntimeError(_ended(self.process.returncode, self.said.read()))
            try:
                if _answers(self.port):
                    return request(ViewerClient.connect(self.address))
            except (RuntimeError, ConnectionError, TimeoutError) as error:
                why = error
            time.sleep(0.1)
        raise TimeoutError(f"in {PATIENCE_S:g} s ({_line(why)}); try again on an idle machine")

    def open(self, recording: str | Path, at: float) -> None:
        """Open a recording at a time, s, and pause there. The viewer's files and command line have
        no place for a time, so it is set when the recording is loaded.
        """
        self.ask(lambda viewer: viewer.open(str(Path(recording).resolve())))
        self.ask(lambda viewer: viewer.set_time(TIMELINE, duration=at, play_state="paused"))


def show(recording: str | Path, at: float) -> None:
    """Open a recording in a window at a time, s; returns when the window is closed.

    Raises
    ------
    OSError: with the reason, if the viewer ends or does not open the recording in `PATIENCE_S`.
    """
    try:
        with viewer(*SIZE) as window:
            window.open(recording, at)
            window.process.wait()
    except (RuntimeError, TimeoutError) as error:
        if window.process.returncode != 0:  # or it was closed before the recording was loaded
            raise OSError(f"{recording}: the viewer opened no window {error}") from None


def require_display(hint: str) -> None:
    """OSError with a hint, if there is no display for a window."""
    variables = "DISPLAY", "WAYLAND_DISPLAY"
    if sys.platform.startswith("linux") and not any(map(os.environ.get, variables)):
        raise OSError(f"no display for a window; {hint}")


def command(*arguments: str) -> list[str]:
    """The viewer's command line; with it the viewer listens to this machine only."""
    return [sys.executable, "-m", "rerun", "--bind", HOST, *arguments]


def start(said: IO[bytes], *options: str, **env: str) -> Viewer:
    """Start a viewer, which goes on when this process ends. Hints about the viewer are turned off.

    said: a file for its output. env: variables that are set unless they are set already.
    """
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port = probe.getsockname()[1]
    process = subprocess.Popen(
        command(*options, "--hide-welcome-screen", "--port", str(port)),
        stdin=subprocess.DEVNULL,
        stdout=said,
        stderr=said,
        env={"RUST_LOG": "error", **env, **os.environ},
        start_new_session=True,
    )
    return Viewer(process, port, said, time.monotonic() + PATIENCE_S)


@contextmanager
def viewer(*options: str) -> Iterator[Viewer]:
    """A viewer that ends with the block. A missing desktop is made up for."""
    with TemporaryDirectory() as folder, TemporaryFile() as said:
        started = start(said, *options, XDG_RUNTIME_DIR=folder)
        try:
            yield started
        finally:
            _end(started.process)


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
