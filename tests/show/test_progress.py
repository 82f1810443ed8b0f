"""The progress of a command: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import io
import re
import sys

import pytest

from celnav.show import progress
from celnav.show.progress import Progress


class Terminal(io.StringIO):
    """What is drawn on it."""

    def isatty(self):
        return True

    def frames(self):
        """The successive states of the bar's line, without codes for color and cursor."""
        text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self.getvalue())
        return [" ".join(frame.replace("━", " ").split()) for frame in re.split(r"[\r\n]+", text)]


def terminal(monkeypatch):
    """A terminal of 80 columns at standard error."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", shown := Terminal())
    return shown


@pytest.fixture
def clock(monkeypatch):
    """A clock that returns the first number of a list."""
    now = [0.0]
    monkeypatch.setattr(progress, "monotonic", lambda: now[0])
    return now


def test_a_bar_has_the_share_and_the_last_label_and_goes(monkeypatch, capsys):
    shown = terminal(monkeypatch)
    bar = Progress("units", 8.0, 2.0)
    bar.add(2.0, "first")
    bar._bar.refresh()
    bar.add(2.0)
    bar._bar.refresh()
    sys.stdout.write("a line\n")
    bar.add(2.0, "second")
    bar._bar.refresh()
    lines = shown.frames()
    for start, end in [("units 25 %", ""), ("units 50 %", "first"), ("units 75 %", "first")]:
        assert any(line.startswith(start) and line.endswith(end) for line in lines)
    assert lines[-1].startswith("units 100 %")
    assert lines[-1].endswith(" second")
    bar.close()
    assert shown.getvalue().endswith("\x1b[1A\x1b[2K")  # one line up, and it is erased
    assert capsys.readouterr().out == "a line\n"


@pytest.mark.parametrize("name", ["dumb", "unknown"])
def test_a_terminal_without_a_cursor_gets_lines(name, monkeypatch, capsys):
    shown = terminal(monkeypatch)
    monkeypatch.setenv("TERM", name)
    bar = Progress("units", 8.0)
    bar.add(2.0, "first")
    bar.close()
    assert capsys.readouterr().out == "units: 25%: first\n"
    assert shown.getvalue() == ""


def test_a_label_that_is_too_long_does_not_wrap(monkeypatch):
    shown = terminal(monkeypatch)
    bar = Progress("units", 8.0)
    bar.add(2.0, 20 * "a long label ")
    bar._bar.refresh()
    bar.close()
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.getvalue())
    frames = re.split(r"[\r\n]+", text)
    assert any("a long label" in frame for frame in frames)
    assert max(map(len, frames)) <= 80


def test_lines_have_the_share_and_the_time_left(clock, capsys):
    lines = Progress("units", 102.0, 2.0)
    clock[0] = 30.0
    lines.add(2.0, "a")  # how fast the rest goes is not known: processes have just started
    clock[0] = 32.0
    lines.add(8.0, "b")  # 8 in 2 s; that is less than a tenth of the rest
    lines.add(2.0)
    clock[0] = 40.0
    lines.add(38.0, "c")  # 48 in 10 s; 50 are left
    lines.add(50.0, "d")
    lines.close()
    assert capsys.readouterr().out.splitlines() == [
        "units: 2% was done before",
        "units: 4%: a",
        "units: 12%: b",
        "units: 51%, 10 s left: c",
        "units: 100%: d",
    ]


def test_work_that_begins_says_no_time(clock, capsys):
    lines = Progress("units", 10.0)
    lines.add(0.0, "a")
    assert capsys.readouterr().out == "units: 0%: a\n"


def test_runs_have_lines_with_their_rate(clock, capsys):
    runs = Progress("study")
    for clock[0], done in [(0.0, 200), (4.9, 300), (5.0, 310), (9.9, 600), (10.0, 1000)]:
        runs.runs(done, 1000)
    assert capsys.readouterr().out.splitlines() == [
        "study: 20% was done before",
        "study: 20%: 200/1000 runs",
        "study: 31%: 310/1000 runs, 100 a second",
        "study: 100%: 1000/1000 runs, 137 a second",
    ]


def test_runs_without_a_rate_say_no_time(clock, capsys):
    runs = Progress("study")
    runs.runs(0, 10)
    clock[0] = 6.0
    runs.runs(0, 10)
    assert capsys.readouterr().out == "study: 0%: 0/10 runs\n" * 2


def test_runs_have_a_bar(monkeypatch, capsys):
    shown = terminal(monkeypatch)
    runs = Progress("study")
    for done in (20, 30, 40):
        runs.runs(done, 100)
    runs._bar.refresh()
    last = shown.frames()[-1]
    runs.close()
    assert last.startswith("study 40 %")
    assert " 40/100 runs, " in last
    assert capsys.readouterr().out == ""
