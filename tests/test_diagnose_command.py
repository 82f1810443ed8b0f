"""``celnav diagnose``: tables in many forms, damaged tables, and the outputs."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from celnav.cli import main
from celnav.commands.diagnose import read
from celnav.files import InputError
from celnav.models.noise import ar1

RNG = np.random.default_rng(1)
WHITE = RNG.standard_normal(200)


def written(path, header, rows, mark=","):
    path.write_text(
        "\n".join([header, *(mark.join(map(str, row)) for row in rows)]) + "\n", encoding="utf-8"
    )
    return path


@pytest.mark.parametrize("width", [80, 120])
def test_in_a_terminal_the_text_has_its_width(tmp_path, monkeypatch, capsys, width):
    rows = [(k, x, 1.0, -x, 1.0) for k, x in enumerate(WHITE)]
    path = written(tmp_path / "a.csv", "t,east_m,std_east_m,north_m,std_north_m", rows)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    assert main(["diagnose", path.name]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    first = "component   east_m" if width == 80 else "component  samples"
    assert any(" ".join(line.split()).startswith(" ".join(first.split())) for line in lines)


def test_a_table_with_claims_is_diagnosed_and_written(tmp_path, capsys):
    slow = ar1([[0.8]], 0.6 * RNG.standard_normal((399, 1)), [0.3])[:, 0]
    rows = [
        (f"2026-01-01 {k}", 10 * k, 7000.0 + k, 2.0 * x, 1.0)
        for k, x in enumerate(slow)
        if not 50 <= k < 60
    ]
    path = written(tmp_path / "track.csv", "time_utc,seconds_utc,x_m,east_m,std_east_m", rows)
    assert main(["diagnose", str(path), "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out.replace("\n         ", " ")
    assert "one run, 390 epochs over 3990 s, 10 s apart" in out
    assert "not looked at: time_utc, x_m (--columns chooses)" in out
    assert "overconfident, " in out
    assert "suggested: celnav.colored(motion, sensor, Phi=[[0." in out
    assert {p.name for p in (tmp_path / "out").glob("d*")} == {
        f"diagnosis.{kind}" for kind in ("txt", "json", "png", "svg")
    }
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    (component,) = found["components"]
    low, high = component["coloring"]["phi_interval"]
    assert low < 0.8 < high
    assert f"Phi from sample to sample = {component['coloring']['phi']:.3f}" in out
    assert len(component["autocorrelation"]) == 20
    assert (
        main(["diagnose", str(path), "--columns", "x_m", "--time", "seconds_utc", "--lags", "5"])
        == 0
    )
    assert "x_m: no predicted σ is given" in capsys.readouterr().out


def test_a_slow_column_is_judged_on_its_own_samples(tmp_path, capsys):
    """Its lags in words, in numbers and in the figure count its samples only."""
    slow = ar1([[0.9]], np.sqrt(0.19) * RNG.standard_normal((99, 1)), [0.3])[:, 0]
    rows = [
        (k, RNG.standard_normal(), slow[k // 25] if k % 25 == 0 else "") for k in range(25 * 100)
    ]
    path = written(tmp_path / "log.csv", "t,fast_m,slow_m", rows)
    assert main(["diagnose", str(path), "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out.replace("\n         ", " ")
    assert "fast_m: yes (Ljung-Box" in out
    assert "slow_m: no (Ljung-Box" in out
    assert "20 lags of 25 s" in out
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert [component["step"] for component in found["components"]] == [1.0, 25.0]
    assert found["components"][1]["p"] < 1e-15


def test_a_column_that_jumps_by_turns_is_named(tmp_path, capsys):
    rows = [(k, x, 0.01 * x + (k % 40 == 20) * 2.0 * np.pi) for k, x in enumerate(WHITE)]
    path = written(tmp_path / "log.csv", "t,range_m,bearing", rows)
    assert main(["diagnose", str(path)]) == 0
    out = capsys.readouterr().out.replace("\n         ", " ")
    assert "wrap     bearing: 5 of 200 samples jump by 2 pi" in out
    assert "celnav.Sensor(..., space=celnav.angles([1]))" in out
    assert "range_m: " not in out.partition("size")[0].partition("wrap")[2]


@pytest.mark.parametrize("mark", [",", ";", "\t", " "])
def test_tables_as_they_come(tmp_path, mark):
    """Any separator, comments, empty lines, missing values, and runs one after the other."""
    rows = [
        (r, k, "nan" if k == 3 else f"{x:.17g}", 0.5)
        for r in range(2)
        for k, x in enumerate(WHITE[:50])
        if (r, k) != (1, 7)
    ]
    path = written(tmp_path / "a.csv", mark.join(["run", "t", "x", "sigma_x"]), rows, mark)
    path.write_text("# made by hand\n\n" + path.read_text(), encoding="utf-8-sig")
    table = read(path)
    assert table.names == ["x"]
    assert table.residuals.shape == table.std.shape == (50, 2, 1)
    known = np.stack([WHITE[:50], WHITE[:50]], -1)
    known[3] = np.nan
    known[7, 1] = np.nan
    np.testing.assert_array_equal(table.residuals[..., 0], known)
    assert table.ignored == []


GOOD = [(k, f"{x:.6g}", 1.0) for k, x in enumerate(WHITE)]


@pytest.mark.parametrize(
    ("text", "options", "match"),
    [
        ("", [], "expected a line of names and lines of numbers, got an empty file"),
        ("t,x\n", [], "expected a column of times"),
        ("0,1\n1,2\n", [], "line 1: expected names of columns"),
        ("t,x,x\n0,1,2\n", [], "line 1: expected names that differ"),
        ("t,x\n0,1\n1\n", [], "line 3: expected 2 columns, got 1"),
        ("t,x\n0,1\n1,2.5m\n", [], "line 3: expected a finite number or nothing as x, got '2.5m'"),
        ("t,x\n0,1\n1,inf\n", [], "line 3: expected a finite number or nothing as x, got 'inf'"),
        ("t,x\n0,1\n,2\n", [], "line 3: expected a time, got nothing"),
        ("t,x\n0,1\n2,2\n1,2\n", [], "line 4: expected a time after 2, got 1"),
        ("t,x\n0,1\n0,2\n", [], "line 3: expected a time after 0, got 0"),
        (
            "a,x\n0,1\n1,2\n",
            [],
            "expected a column of times, such as t, got a, x; name it with --time",
        ),
        ("t,a\n0,b\n1,c\n", [], "expected components beside t"),
        ("t,x\n0,1\n1,2\n", [], "expected at least 20 samples"),
        ("t,x\n0,1\n1,2\n", ["--columns", "y"], "expected a column 'y', got t, x"),
        ("t,x\n0,1\n1,2\n", ["--time", "y"], "expected a column 'y', got t, x"),
        (
            "t,x,std_x\n" + "".join(f"{k},{x},{k}\n" for k, x, _ in GOOD),
            [],
            "expected positive finite standard deviations for all residuals",
        ),
        ("t,x\n0,1\n1,\x00\n", [], "line 3: expected a finite number"),
    ],
)
def test_damaged_tables_are_told_by_file_and_line(tmp_path, capsys, text, options, match):
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    assert main(["diagnose", str(path), *options, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"celnav: {path}")
    assert match in said
    assert not list((tmp_path / "out").glob("d*"))


def test_what_is_no_text_and_options_that_are_none(tmp_path, capsys):
    (tmp_path / "a.csv").write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    with pytest.raises(InputError, match="expected a text table"):
        read(tmp_path / "a.csv")
    assert main(["diagnose", str(tmp_path / "none.csv")]) == 2
    assert "none.csv: no such file" in capsys.readouterr().err
    written(tmp_path / "b.csv", "t,x,std_x", GOOD)
    for options, match in (
        (["--lags", "0"], "--lags: expected"),
        (["--level", "2"], "--level: expected"),
    ):
        assert main(["diagnose", str(tmp_path / "b.csv"), *options]) == 2
        assert match in capsys.readouterr().err
