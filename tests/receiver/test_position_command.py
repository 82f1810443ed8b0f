"""`celnav position`: its outputs, and damaged files, which give one line."""

from __future__ import annotations

import json
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import rinex_pair
from rinex_pair import (
    PLACE,
    TIMES,
    above,
    both,
    constellation,
    navigation,
    observations,
    written,
)

from celnav import cli
from celnav.files import InputError, Outputs
from celnav.receiver import position as positioning
from celnav.receiver import report as positioning_report
from celnav.receiver.rinex import read_navigation, read_observations
from celnav.receiver.tracks import FORMATS

SKY = above(constellation(), TIMES)


@pytest.fixture
def files(tmp_path):
    return str(written(tmp_path, observations(SKY, TIMES)[0], "obs.rnx")), str(
        written(tmp_path, navigation(SKY), "nav.rnx")
    )


def test_position_writes_everything_and_replaces_its_own(files, tmp_path, capsys):
    out = tmp_path / "a folder"
    Outputs(out).text("summary.txt", "of an earlier run")
    assert cli.main(["position", *files, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert {p.name for p in out.iterdir()} == {
        *positioning_report.FILES,
        positioning_report.RECORDING,
        ".celnav.json",
    }
    assert float(printed.split("error")[1].split()[0]) == pytest.approx(
        0.5, abs=0.02
    )  # the antenna is half a meter above the marker
    assert (out / "summary.txt").read_text("utf-8").strip() in printed
    Outputs(out).check(positioning_report.FILES)


@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        (["--filter", "aukff"], 2, "celnav: --filter: expected one of ls, ekf"),
        (["--clock", "sundial"], 2, "celnav: --clock: expected one of crystal, phone, auto, got"),
        (["--mask", "ten"], 2, "celnav: --mask: expected a number"),
        (["--mask", "91"], 2, "celnav: --mask: expected degrees from 0 to below 90, got 91"),
        (
            ["--acceleration-noise", "-1"],
            2,
            "celnav: --acceleration-noise: expected a positive density",
        ),
        (["--position", "1", "2", "east"], 2, "celnav: --position: expected a number"),
        (["--position", "32", "118", "50"], 2, "celnav: --position: expected Earth-fixed meters"),
        (
            ["--position", "1e200", "1e200", "0"],
            2,
            "celnav: --position: expected Earth-fixed meters",
        ),
        (["--position", "nan", "0", "0"], 2, "celnav: --position: expected Earth-fixed meters"),
        (["--mask", "nan"], 2, "celnav: --mask: expected degrees"),
        (["--sigma", "1", "0"], 2, "celnav: --sigma: expected positive standard deviations"),
        (["--sigma", "1", "low"], 2, "celnav: --sigma: expected a number"),
        (
            ["--false-alarm", "1"],
            2,
            "celnav: --false-alarm: expected a probability from 0 to below 1",
        ),
    ],
)
def test_options_that_cannot_be_are_told_in_one_line(
    files, tmp_path, capsys, options, status, words
):
    assert cli.main(["position", *files, "--out", str(tmp_path / "out"), *options]) == status
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_another_position_is_compared_with_from_another_folder(
    files, tmp_path, monkeypatch, capsys
):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    away = [str(v) for v in PLACE + np.array([100.0, 0.0, 0.0])]
    assert cli.main(["position", *files, "--filter", "ls", "--position", *away]) == 0
    assert float(capsys.readouterr().out.split("error")[1].split()[0]) > 90.0
    assert Path("out/position/track.csv").exists()


def test_a_receiver_that_moves_has_no_error_from_its_header(tmp_path, monkeypatch, capsys):
    times = TIMES[0] + 30.0 * np.arange(8)
    code, doppler = [], []
    for k, t in enumerate(times):
        # 10 m/s to the east
        place = PLACE + 300.0 * k * np.array([-PLACE[1], PLACE[0], 0.0]) / np.hypot(*PLACE[:2])
        monkeypatch.setattr(rinex_pair, "PLACE", place)
        rows = rinex_pair.measurements(SKY, np.array([t]), [3e4 + 30.0 * (t - times[0])])
        code.append(rows[0][0])
        doppler.append(rows[1][0])
    monkeypatch.undo()
    for moving in (False, True):
        if moving:
            read = (np.array(code), np.array(doppler))
            monkeypatch.setattr(rinex_pair, "measurements", lambda *_, read=read: read)
        files = [
            str(written(tmp_path, observations(SKY, times)[0], "obs.rnx")),
            str(written(tmp_path, navigation(SKY), "nav.rnx")),
        ]
        command = ["position", *files, "--filter", "ls", "--out", str(tmp_path / "track.csv")]
        assert cli.main(command) == 0
        said = capsys.readouterr().out
        assert ("the receiver moved" in said) == moving
        assert ("\nerror " in said) == (not moving)
        assert cli.main([*command, "--position", *map(str, PLACE)]) == 0
        assert "\nerror " in capsys.readouterr().out


def first_row(text, name="C05"):
    return next(line for line in text.splitlines() if line.startswith(name))


KIND = "C    1 C2I".ljust(60) + "SYS / # / OBS TYPES"
SCALE = "C   10".ljust(60) + "SYS / SCALE FACTOR\n"
OBSERVATIONS = {
    "a garbled date": (
        lambda t: (
            t.replace("> 2011", "> 20x1", 1)
            if "> 2011" in t
            else re.sub(r"> (...)\d", r"> \1x", t, count=1)
        ),
        "expected date, flag and number of an epoch",
    ),
    "a count below nothing": (
        lambda t: re.sub(r"(> .{29}0).{3}", r"\1 -1", t, count=1),
        "expected date, flag and number of an epoch",
    ),
    "a garbled satellite": (
        lambda t: t.replace("\nC05", "\nCx5", 1),
        "expected a satellite (C01), got 'Cx5'",
    ),
    "a garbled range": (
        lambda t: t.replace(first_row(t), "C05" + "  3xxxxx16.123".rjust(14), 1),
        "expected a number, got '3xxxxx16.123'",
    ),
    "a row that is cut off": (
        lambda t: t.replace(first_row(t), first_row(t)[:-7], 1),
        "the last one is cut off",
    ),
    "a position in kilometers": (
        lambda t: t.replace(
            "".join(f"{v:14.4f}" for v in PLACE), "".join(f"{v / 1e3:14.4f}" for v in PLACE)
        ),
        "APPROX",
    ),
    "a garbled position": (
        lambda t: re.sub(r"-2611857\.0000", "-26xx857.0000", t),
        "expected three numbers in APPROX POSITION XYZ",
    ),
    "a new kind in an event": (
        lambda t: re.sub(
            r"(> .{29})0(.{3}.*\n)",
            "\\g<1>4  1\n" + "C    1 C2I".ljust(60) + "SYS / # / OBS TYPES\n\\g<0>",
            t,
            count=1,
        ),
        "expected observations of one kind",
    ),
    "a scale": (
        lambda t: t.replace("".ljust(60) + "END", SCALE + "".ljust(60) + "END", 1),
        "SCALE",
    ),
}


@pytest.mark.parametrize("name", OBSERVATIONS)
def test_damaged_observations_are_told(name, tmp_path):
    damage, words = OBSERVATIONS[name]
    text = observations(SKY, TIMES)[0]
    changed = damage(text)
    assert changed != text
    with pytest.raises(InputError, match=re.escape(words)):
        read_observations(written(tmp_path, changed), strict=True)


def test_events_in_a_log_are_passed_over(tmp_path):
    text = observations(SKY, TIMES)[0]
    whole = read_observations(written(tmp_path, text, "whole.rnx"))
    event = (
        ">                              4  2\n"
        + "CABLE CHANGED".ljust(60)
        + "COMMENT\n"
        + "C05 IS LOW".ljust(60)
        + "COMMENT\n"
    )
    lines = text.splitlines(keepends=True)
    second = [k for k, line in enumerate(lines) if line.startswith(">")][1]
    found = read_observations(
        written(tmp_path, "".join([*lines[:second], event, *lines[second:]]), "event.rnx")
    )
    np.testing.assert_array_equal(found.code, whole.code)
    assert len(found.times) == 3


def test_a_log_of_beidou_alone_is_in_its_own_time(tmp_path):
    text = observations(SKY, TIMES, 0.0, "   ")[0].replace("M: Mixed", "C: BDS  ", 1)
    np.testing.assert_allclose(read_observations(written(tmp_path, text)).times, TIMES, atol=1e-6)


NAVIGATION = {
    "a set that is cut off": (
        lambda t: "\n".join(t.splitlines()[:-3]) + "\n",
        "expected 8 lines of a broadcast set from line",
    ),
    "a garbled number": (
        lambda t: t[: t.index("C01") + 30] + "x" + t[t.index("C01") + 31 :],
        "expected a number, got",
    ),
}


@pytest.mark.parametrize("name", NAVIGATION)
def test_damaged_orbits_are_told(name, tmp_path):
    damage, words = NAVIGATION[name]
    text = navigation(SKY)
    changed = damage(text)
    assert changed != text
    with pytest.raises(InputError, match=re.escape(words)):
        read_navigation(written(tmp_path, changed), strict=True)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda t: "", "got an empty one"),
        (lambda t: t[: t.index("END OF HEADER") - 100], "expected END OF HEADER"),
        (lambda t: t[: t.index("END OF HEADER") + 14], "got n"),
        (
            lambda t: t.replace("     3.04", "     1.00", 1),
            "line 1: expected RINEX 2, 3 or 4, got version 1",
        ),
    ],
)
def test_damaged_files_are_one_line_and_nothing_is_written(
    files, tmp_path, capsys, which, damage, words
):
    path = Path(files[which])
    path.write_text(damage(path.read_text("ascii")), "ascii")
    out = tmp_path / "out"
    assert cli.main(["position", *files, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert str(path) in error
    assert error.count("\n") == 1
    assert not [p for p in out.iterdir() if not p.name.startswith(".")]


@pytest.mark.parametrize("to", ["", "/track.csv", "/track.pos", "/track.geojson", "/track.nmea"])
def test_a_truncated_log_is_positioned_and_its_line_is_told(files, tmp_path, capsys, to):
    """The last epoch, in which four satellites are missing, is left out completely."""
    kept = Path(files[0]).read_text("ascii").splitlines()[:-4]
    head = max(k for k, line in enumerate(kept) if line.startswith(">"))
    Path(files[0]).write_text("\n".join(kept) + "\n", "ascii")
    out = tmp_path / f"out{to}"
    assert cli.main(["position", *files, "--out", str(out)]) == 0
    line = f"{files[0]}, line {len(kept)}: expected {len(kept) - head + 3} more after line "
    line += f"{head + 1}, the file is cut off"
    printed = capsys.readouterr().out
    assert f"damaged      1 epochs or broadcast sets left out: {line}\n" in printed
    assert "epochs       2, " in printed
    if not to:
        assert line in (out / "summary.txt").read_text("utf-8")
        assert (out / "track.csv").read_text("utf-8").count("\n") == 3
    if to == "/track.pos":
        assert f"% left out  : {line}\n" in out.read_text("utf-8")
    if to == "/track.geojson":
        (feature,) = json.loads(out.read_text("utf-8"))["features"]
        assert feature["properties"]["damaged"] == [line]


def test_a_truncated_log_is_refused_where_that_is_asked_for(files, tmp_path, capsys):
    kept = Path(files[0]).read_text("ascii").splitlines()[:-4]
    Path(files[0]).write_text("\n".join(kept) + "\n", "ascii")
    assert cli.main(["position", *files, "--strict", "--out", str(tmp_path / "out")]) == 2
    assert f"obs.rnx, line {len(kept)}: expected" in capsys.readouterr().err


def test_a_log_of_one_epoch_is_positioned_without_a_recording(files, tmp_path, capsys):
    lines = Path(files[0]).read_text("ascii").splitlines(keepends=True)
    second = [k for k, line in enumerate(lines) if line.startswith(">")][1]
    Path(files[0]).write_text("".join(lines[:second]), "ascii")
    assert cli.main(["position", *files, "--out", str(tmp_path / "out")]) == 0
    assert "no recording (times: expected two or more" in capsys.readouterr().err


def test_absent_files_and_foreign_results_are_told(files, tmp_path, capsys):
    assert (
        cli.main(["position", files[0], str(tmp_path / "none.rnx"), "--out", str(tmp_path / "out")])
        == 2
    )
    assert "none.rnx" in capsys.readouterr().err
    (tmp_path / "out" / "track.csv").write_text("mine", encoding="ascii")
    assert cli.main(["position", *files, "--out", str(tmp_path / "out")]) == 2
    assert "track.csv" in capsys.readouterr().err
    assert (tmp_path / "out" / "track.csv").read_text() == "mine"


def damaged(text, rng):
    """A file with a changed letter, field or line, or cut off at some place."""
    lines = text.split("\n")
    k = int(rng.integers(len(lines) - 1))
    at = int(rng.integers(max(len(lines[k]), 1)))
    match rng.choice(["letter", "digit", "field", "line", "end", "name"]):
        case "letter":
            lines[k] = lines[k][:at] + chr(rng.integers(32, 127)) + lines[k][at + 1 :]
        case "digit":
            lines[k] = lines[k][:at] + str(rng.integers(10)) + lines[k][at + 1 :]
        case "field":
            wild = str(rng.choice(["1e99", "nan", "-inf", "0", "", "1e308", "-1", "1_0"]))
            lines[k] = lines[k][:at] + wild.rjust(14) + lines[k][at + 14 :]
        case "line":
            lines[k] = lines[int(rng.integers(len(lines)))]
        case "end":
            return text[: int(rng.integers(len(text)))]
        case "name":
            lines[k] = (
                str(rng.choice(["Cxx", "C00", "C 1", "X01", "G1", "Gxx", "G99", "C05"]))
                + lines[k][3:]
            )
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("b", "seeds"), [(SKY, range(20)), (above(both(), TIMES), range(20, 40))], ids=["C", "CG"]
)
@pytest.mark.parametrize("which", ["observations", "navigation"])
def test_damage_is_an_error_of_input_or_is_told_in_the_summary(tmp_path, which, b, seeds):
    texts = {"observations": observations(b, TIMES)[0], "navigation": navigation(b)}
    read = {"observations": read_observations, "navigation": read_navigation}
    whole = {
        name: read[name](written(tmp_path, text, f"{name}.rnx")) for name, text in texts.items()
    }
    refused, told = [], 0
    for n in seeds:
        path = written(tmp_path, damaged(texts[which], np.random.default_rng(n)), f"{which}.rnx")
        try:
            result = positioning_report.position(
                positioning.prepare(**(whole | {which: read[which](path)})), "ls", None
            )
        except InputError as error:
            refused.append(str(error))
        else:
            summary = positioning_report.summary(result)
            assert ("damaged  " in summary) == bool(result.log.damaged)
            told += bool(result.log.damaged)
            for track in FORMATS.values():
                track(result)
            assert np.nanmax(np.linalg.norm(result.mean[:, :3] - PLACE, axis=-1)) < 30.0, n
    assert told + len(refused) > 0.25 * len(seeds)
    assert all("rnx" in line for line in refused)


def test_the_nearest_epoch_with_a_fix():
    """The earlier of two equally near epochs, for all combinations of fixes at nine epochs."""
    for there in product([False, True], repeat=9):
        fixes = [k for k, fix in enumerate(there) if fix]
        if fixes:
            nearest = [min(fixes, key=lambda k: (abs(k - own), k)) for own in range(9)]
            np.testing.assert_array_equal(positioning._nearest(np.array(there)), nearest)
