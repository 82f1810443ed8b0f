"""Differences on Windows and macOS, as far as they can be tested on Linux;
``mypy --platform win32`` finds names that do not exist there.
"""

from __future__ import annotations

import ast
import errno
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import celnav
from celnav import cli
from celnav.campaign import executors
from celnav.commands import index

SOURCES = sorted(Path(celnav.__file__).parent.rglob("*.py"))


def test_a_pipe_that_nobody_reads_is_quiet_on_windows_too(monkeypatch):
    """Windows reports an invalid argument without a file."""
    closed, named = (
        OSError(errno.EINVAL, "Invalid argument"),
        OSError(errno.EINVAL, "Invalid argument", "a:b"),
    )
    assert not cli._nobody_reads(closed)
    assert cli._nobody_reads(BrokenPipeError())
    monkeypatch.setattr(sys, "platform", "win32")
    assert cli._nobody_reads(closed)
    assert not cli._nobody_reads(named)


def test_a_page_on_another_drive_links_to_the_whole_path(monkeypatch, tmp_path):
    def relpath(path, start):
        raise ValueError("path is on mount 'C:', start on mount 'D:'")

    own = tmp_path / "study.py"
    own.touch()
    for paper, module in (("csrukf", None), ("study", SimpleNamespace(file=str(own)))):
        assert index._notebook(tmp_path / "out", paper, module)["href"].startswith("../")
        with monkeypatch.context() as patch:
            patch.setattr(os.path, "relpath", relpath)
            assert index._notebook(tmp_path / "out", paper, module)["href"].startswith("file:///")


@pytest.mark.parametrize(("most", "count"), [(61, 61), (1_000_000, 64)])
def test_no_more_processes_than_windows_can_wait_for(monkeypatch, most, count):
    monkeypatch.setattr(executors, "MOST_PROCESSES", most)
    with executors.processes(64).open() as pool:
        assert pool._max_workers == count


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(SOURCES[0].parent)))
def test_text_is_read_and_written_as_utf8_whatever_the_locale(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr == "read_text"
        ):
            assert "encoding" in {word.arg for word in node.keywords} or node.args, (
                f"line {node.lineno}"
            )
        if isinstance(node, ast.Call) and getattr(
            node.func, "attr", getattr(node.func, "id", "")
        ) in ("open", "TemporaryFile"):
            modes = [
                arg.value
                for arg in node.args
                if isinstance(arg, ast.Constant) and set(str(arg.value)) <= set("rwab+x")
            ]
            named = "encoding" in {word.arg for word in node.keywords}
            assert named or all("b" in mode for mode in modes), f"line {node.lineno}"
