"""What a command says while it works: frames of a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import io
import sys

import pytest

from celnav.show import progress
from celnav.show.progress import Progress


class Terminal(io.StringIO):
    """What is drawn on it."""

    def isatty(self):
        return True

    def frame(self):
        """The last line, as it stands."""
        return self.getvalue().split("\r")[-1].strip()


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands at the first of a list."""
    now = [0.0]
    monkeypatch.setattr(progress, "monotonic", lambda: now[0])
    return now


def test_a_bar_has_the_share_and_the_last_label(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    bar = Progress("units", 8.0, 2.0)
    assert terminal.frame().startswith("units:  25%|")
    bar.add(2.0, "first")
    assert terminal.frame().startswith("units:  50%|")
    assert terminal.frame().endswith(", first")
    bar.add(2.0)
    assert terminal.frame().startswith("units:  75%|")
    assert terminal.frame().endswith(", first")
    bar.add(2.0, "second")
    assert terminal.frame().startswith("units: 100%|")
    assert terminal.frame().endswith(", second")
    bar.say("a line")
    assert terminal.frame() == ""
    assert capsys.readouterr().out == "a line\n"
    bar.close()
    assert terminal.frame().startswith("units: 100%|")


def test_lines_have_the_share_and_the_time_left(clock, capsys):
    lines = Progress("units", 10.0, 2.0)
    clock[0] = 30.0
    lines.add(2.0, "a")  # 2 in 30 s; 6 are left
    lines.add(1.0)
    clock[0] = 40.0
    lines.add(3.0, "b")  # 6 in 40 s; 2 are left
    lines.say("a line")
    lines.add(2.0, "c")
    lines.close()
    assert capsys.readouterr().out.splitlines() == [
        "units: 20% was done before",
        "units: 40%, 2 min left: a",
        "units: 80%, 13 s left: b",
        "a line",
        "units: 100%, 0 s left: c",
    ]


def test_work_that_begins_says_no_time(clock, capsys):
    lines = Progress("units", 10.0)
    lines.add(0.0, "a")
    assert capsys.readouterr().out == "units: 0%: a\n"


def test_runs_have_lines_with_their_rate(clock, capsys):
    runs = Progress("study")
    for clock[0], done in [(0.0, 200), (4.9, 300), (5.0, 400), (9.9, 600), (10.0, 1000)]:
        runs.runs(done, 1000)
    assert capsys.readouterr().out.splitlines() == [
        "study: 20% was done before",
        "study: 20%: 200/1000 runs",
        "study: 40%, 15 s left: 400/1000 runs, 40 a second",
        "study: 100%, 0 s left: 1000/1000 runs, 80 a second",
    ]


def test_runs_without_a_rate_say_no_time(clock, capsys):
    runs = Progress("study")
    runs.runs(0, 10)
    clock[0] = 6.0
    runs.runs(0, 10)
    assert capsys.readouterr().out == "study: 0%: 0/10 runs\n" * 2


def test_runs_have_a_bar(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    runs = Progress("study")
    for done in (20, 30, 40):
        runs.runs(done, 100)
    runs.close()
    assert terminal.frame().startswith("study:  40%|")
    assert ", 40/100 runs, " in terminal.frame()
    assert terminal.frame().endswith(" a second")
    assert capsys.readouterr().out == ""
