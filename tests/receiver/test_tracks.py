"""Tracks in exchange formats: read back by simple readers, they contain the receiver's positions
and times.
"""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from pymap3d import geodetic2ecef
from rinex_pair import (
    ALPHA,
    BETA,
    PLACE,
    TOE,
    above,
    both,
    navigation,
    observations,
    observed,
    written,
)

from celnav import cli
from celnav.receiver import geodesy, report, tracks
from celnav.receiver import position as positioning
from celnav.receiver.geodesy import ELLIPSOID
from celnav.receiver.rinex import Navigation
from celnav.receiver.sky import local_axes

LONG = TOE + 1800.0 + 30.0 * np.arange(6)


@pytest.fixture(scope="module", params=["CG", "G"])
def found(request):
    sky = above(both(), LONG)
    nav = Navigation(Path("nav.rnx"), sky, (np.array(ALPHA), np.array(BETA)))
    obs = observed(sky, LONG, 3e4 + 30.0 * (LONG - LONG[0]))
    return report.position(positioning.prepare(obs, nav, systems=request.param), "ekf", PLACE)


def test_positions_are_those_of_pymap3d():
    place = np.random.default_rng(1).normal(size=(3, 50))
    place *= np.linspace(6.35e6, 6.4e6, 50) / np.linalg.norm(place, axis=0)
    angles = geodesy.ecef2geodetic(*place)
    np.testing.assert_allclose(geodetic2ecef(*angles, ell=ELLIPSOID), place, rtol=0, atol=1e-8)
    np.testing.assert_allclose(geodesy.geodetic2ecef(*angles), place, rtol=0, atol=1e-8)
    radians = geodesy.ecef2geodetic(*place, deg=False)
    np.testing.assert_allclose(np.degrees(radians[:2]), angles[:2], rtol=1e-14)
    np.testing.assert_allclose(geodesy.geodetic2ecef(*radians, deg=False), place, atol=1e-8)


def test_a_solution_of_rtklib_has_its_columns_and_its_time(found):
    """The columns are read by position, as in RTKPLOT: the header has a word above each column."""
    *header, names = [line for line in tracks.pos(found).splitlines() if line.startswith("%")]
    rows = [line for line in tracks.pos(found).splitlines() if not line.startswith("%")]
    assert "% inp file  : obs.rnx" in header
    assert "% inp file  : nav.rnx" in header
    assert f"% navi sys  : {'gps' if found.log.systems == 'G' else 'gps beidou'}" in header
    assert re.search(
        r"% obs start : \d{4}/\d\d/\d\d 00:30:14\.0 GPST \(week2111 347414\.0s\)", "\n".join(header)
    )
    assert names.split()[1:] == [
        "GPST",
        "latitude(deg)",
        "longitude(deg)",
        "height(m)",
        "Q",
        "ns",
        "sdn(m)",
        "sde(m)",
        "sdu(m)",
        "sdne(m)",
        "sdeu(m)",
        "sdun(m)",
        "age(s)",
        "ratio",
    ]
    assert len(rows) == 6
    for k, row in enumerate(rows):
        assert len(row) == len(names)
        assert row[:23] == tracks.civil(LONG[k] + 14.0, "%Y/%m/%d %H:%M:%S.000")
        latitude, longitude, height, q, ns, *std = (float(v) for v in row[23:].split())
        np.testing.assert_allclose(
            geodetic2ecef(latitude, longitude, height, ell=ELLIPSOID), found.mean[k, :3], atol=2e-4
        )
        assert (q, ns) == (5.0, found.log.used[k].sum())
        axes = local_axes(np.radians(latitude), np.radians(longitude))
        cov = axes @ found.cov[k] @ axes.T
        expected = [cov[1, 1], cov[0, 0], cov[2, 2], cov[0, 1], cov[0, 2], cov[1, 2], 0.0, 0.0]
        np.testing.assert_allclose(std, np.sign(expected) * np.sqrt(np.abs(expected)), atol=6e-5)


def test_sentences_of_nmea_are_whole_and_in_utc(found):
    lines = tracks.nmea(found).split("\r\n")[:-1]
    assert len(lines) == 12
    for k, line in enumerate(lines):
        body, check = line[1:].split("*")
        assert line[0] == "$"
        total = 0
        for letter in body:
            total ^= ord(letter)
        assert int(check, 16) == total
        kind, clock, *rest = body.split(",")
        assert kind == ("GP" if found.log.systems == "G" else "GN") + ("GGA", "RMC")[k % 2]
        minute, second = divmod(30 * (k // 2) + 1800 - 4, 60)  # UTC is 4 s behind BDT since 2017
        assert clock == f"00{minute:02d}{second:02d}.000"
        at = rest[:4] if k % 2 == 0 else rest[1:5]
        latitude, longitude = (
            float(v[:d]) + float(v[d:]) / 60.0 for v, d in ((at[0], 2), (at[2], 3))
        )
        height = float(rest[7]) + float(rest[9]) if k % 2 == 0 else 50.0
        if k % 2 == 0:
            np.testing.assert_allclose(
                geodetic2ecef(latitude, longitude, height, ell=ELLIPSOID),
                found.mean[k // 2, :3],
                atol=2e-3,
            )
            assert (rest[4], rest[5]) == ("1", f"{found.log.used[k // 2].sum():02d}")
        else:
            assert float(rest[5]) == 0.0
            assert (
                rest[7]
                == tracks.utc(LONG[:1])[0][8:10]
                + tracks.utc(LONG[:1])[0][5:7]
                + tracks.utc(LONG[:1])[0][2:4]
            )


@pytest.mark.parametrize(
    ("degrees", "digits", "signs", "text"),
    [
        (-33.5, 2, "NS", "3330.000000,S"),
        (-0.25, 3, "EW", "00015.000000,W"),
        (12.0 - 1e-12, 2, "NS", "1200.000000,N"),
    ],
)
def test_angles_of_nmea(degrees, digits, signs, text):
    assert tracks._angle(degrees, digits, signs) == text


def test_leap_seconds_are_those_of_the_day():
    second = {
        day: (np.datetime64(day) - np.datetime64("2006-01-01")) / np.timedelta64(1, "s")
        for day in ("2008-06-01", "2017-01-02")
    }
    assert tracks.utc(np.array([*second.values()])) == [
        "2008-06-01T00:00:00.000Z",
        "2017-01-01T23:59:56.000Z",
    ]


def test_geojson_is_a_line_or_a_point(found):
    (feature,) = json.loads(tracks.geojson(found))["features"]
    assert feature["geometry"]["type"] == "LineString"
    for k, (longitude, latitude, height) in enumerate(feature["geometry"]["coordinates"]):
        np.testing.assert_allclose(
            geodetic2ecef(latitude, longitude, height, ell=ELLIPSOID), found.mean[k, :3], atol=2e-4
        )
    assert feature["properties"]["coordTimes"] == tracks.utc(LONG)
    nav = Navigation(Path("nav.rnx"), both(), None)
    one = report.position(
        positioning.prepare(observed(both(), LONG[:1], np.full(1, 3e4)), nav), "ls", None
    )
    assert json.loads(tracks.geojson(one))["features"][0]["geometry"]["type"] == "Point"


@pytest.fixture(scope="module")
def doubtful():
    """In two epochs four satellites are left, and the range of one satellite is 10 km too long."""
    sky = above(both(), LONG)
    nav = Navigation(Path("nav.rnx"), sky, (np.array(ALPHA), np.array(BETA)))
    obs = observed(sky, LONG, 3e4 + 30.0 * (LONG - LONG[0]))
    obs, code = obs.of("C"), obs.of("C").code.copy()
    four = [obs.names.index(name) for name in ("C01", "C02", "C05", "C38")]
    code[2:4] = np.nan
    code[2:4, four] = obs.code[2:4, four] + [1e4, 0.0, 0.0, 0.0]
    log = positioning.prepare(replace(obs, code=code), nav)
    return report.position(log, "ls", PLACE, false_alarm=0.0)


def test_a_position_that_nothing_tests_is_marked_in_every_track(doubtful):
    off = np.linalg.norm(doubtful.mean[:, :3] - PLACE, axis=1)
    np.testing.assert_array_equal(off > 1e4, [False, False, True, True, False, False])
    np.testing.assert_array_equal(doubtful.doubtful, off > 1e4)
    rows = list(csv.DictReader(tracks.table(doubtful).splitlines()))
    words = ["tested", "tested", "untested", "untested", "tested", "tested"]
    assert [row["integrity"] for row in rows] == words
    (feature,) = json.loads(tracks.geojson(doubtful))["features"]
    assert feature["properties"]["integrity"] == words
    rows = tracks.nmea(doubtful).split("\r\n")[1:-1:2]
    assert [row.partition("*")[0][-4:] for row in rows] == [
        *(",A,V", ",A,V", ",A,C", ",A,C", ",A,V", ",A,V"),
    ]
    lines = tracks.pos(doubtful).splitlines()
    first = next(k for k, line in enumerate(lines) if not line.startswith("%"))
    mark = "% integrity : untested, no redundancy shows a faulty satellite, in the next line"
    assert [line == mark for line in lines[first:]] == [0, 0, 1, 0, 1, 0, 0, 0]


def test_a_position_that_nothing_tests_is_counted_at_the_top_and_drawn(doubtful, tmp_path):
    assert report.summary(doubtful).splitlines()[0] == (
        "NOT SOUND    do not trust 2 of 6 positions, from 2020-06-25T00:31:00 to 2020-06-25T00:31:30 BDT: "
        "2 untested (no redundancy shows a faulty satellite)"
    )
    figure = report.figures(doubtful)["track"]
    (drawn,) = [line for line in figure.axes[0].lines if line.get_label() == "doubtful"]
    assert len(drawn.get_xdata()) == 2
    report.record_positioned(doubtful, tmp_path / "a.rrd")
    chunks = rr.chunk.RrdReader(str(tmp_path / "a.rrd")).stream().to_chunks()
    points = [c for c in chunks if c.entity_path == "/track/doubtful" and c.timeline_names]
    column = points[0].to_record_batch().column("Points3D:positions").to_pylist()
    assert [len(at) for at in column] == [0, 0, 1, 1, 0, 0]


def test_a_track_without_doubt_has_no_marks(found):
    headline = "SOUND        all 6 positions agree with the ranges of their epochs"
    assert report.summary(found).splitlines()[0] == headline
    assert "integrity" not in tracks.pos(found)
    assert not [
        line
        for line in report.figures(found)["track"].axes[0].lines
        if line.get_label() == "doubtful"
    ]


@pytest.mark.parametrize(
    ("height", "word"),
    [
        (-1500.0, "implausible height"),
        (-400.0, "tested"),
        (4e4, "tested"),
        (1e5, "implausible height"),
        (4e5, "tested"),
    ],
)
def test_a_height_where_no_receiver_is_is_marked(found, height, word):
    up = local_axes(*np.radians([32.0, 118.9]))[2]
    place = np.array(geodetic2ecef(32.0, 118.9, 0.0, ell=ELLIPSOID)) + height * up
    moved = found.mean.copy()
    moved[1, :3] = place
    result = replace(found, mean=moved)
    assert result.integrity.tolist() == ["tested", word, *["tested"] * 4]
    assert result.doubtful.tolist() == [k == 1 and word != "tested" for k in range(6)]
    text = report.summary(result).splitlines()[0]
    assert text.startswith("NOT SOUND    do not trust 1 of 6 positions") == (word != "tested")
    assert ("1 implausible height (no receiver can be there)" in text) == (word != "tested")
    assert (",A,U*" in tracks.nmea(result)) == (word != "tested")


@pytest.fixture
def files(tmp_path):
    b = both()
    return [
        str(written(tmp_path, observations(b, LONG)[0], "obs.rnx")),
        str(written(tmp_path, navigation(b), "nav.rnx")),
    ]


@pytest.mark.parametrize("suffix", tracks.FORMATS)
def test_out_is_a_file_by_its_suffix_and_nobody_elses_is_replaced(files, tmp_path, capsys, suffix):
    out = tmp_path / "new" / f"track{suffix}"
    for _ in range(2):
        assert cli.main(["position", *files, "--filter", "ls", "--out", str(out)]) == 0
    assert f"wrote {out}" in capsys.readouterr().out
    assert {path.name for path in out.parent.iterdir()} == {out.name, ".celnav.json"}
    out.write_text("mine", encoding="ascii")
    assert cli.main(["position", *files, "--filter", "ls", "--out", str(out)]) == 2
    assert out.read_text("ascii") == "mine"


@pytest.mark.parametrize(("alarm", "status"), [("1e-5", 0), ("0", 1)])
def test_strict_ends_with_1_where_a_position_is_doubtful(files, tmp_path, capsys, alarm, status):
    words = ["position", *files, "--false-alarm", alarm, "--out", str(tmp_path / "track.csv")]
    assert cli.main(words) == 0
    assert cli.main([*words, "--strict"]) == status
    headline = ("SOUND        all 6 positions", "NOT SOUND    do not trust 6 of 6 positions")[
        status
    ]
    assert capsys.readouterr().out.startswith(headline)


def test_systems_and_the_ionosphere_are_given_by_options(files, tmp_path, capsys):
    plain = written(
        tmp_path,
        "".join(line for line in navigation(both()).splitlines(True) if "CORR" not in line),
        "plain.rnx",
    )
    given, out = [files[0], str(plain), "--filter", "ls"], ["--out", str(tmp_path / "track.pos")]
    errors = []
    numbers = ",".join(str(v) for v in (*ALPHA, *BETA))
    for more in (
        [],
        ["--ion", files[1]],
        [f"--ion={numbers}"],
        ["--ion", numbers, "--systems", "g"],
        ["--systems", "G,C"],
    ):
        assert cli.main(["position", *given, *out, *more]) == 0
        errors.append(float(capsys.readouterr().out.split("error")[1].split()[0]))
    assert errors[0] == errors[4] > 1.0
    np.testing.assert_allclose(
        errors[1:4], 0.5, atol=0.01
    )  # the antenna is half a meter above the marker
    assert cli.main(["position", *given[:2], files[1], *given[2:], *out]) == 0
    assert float(capsys.readouterr().out.split("error")[1].split()[0]) == pytest.approx(
        0.5, abs=0.01
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ["--systems", "R"],
            "--systems: expected letters of C (BeiDou), G (GPS), E (Galileo), got 'R'",
        ),
        (
            ["--ion", "1,2"],
            "--ion: expected a navigation file, or eight numbers with commas between, got 2",
        ),
        (["--ion", "1,2,3,4,5,6,7,x"], "--ion: expected a number"),
        (
            ["--ion", "1,2,3,4,5,6,7,8"],
            "--ion: expected coefficients of the ionosphere that a message can hold",
        ),
        (["--ion", "none.rnx"], "none.rnx"),
        (
            ["--out", "track.kml"],
            "--out: expected a folder, or a file with one of .csv, .pos, .geojson, .nmea, got "
            "'track.kml'",
        ),
    ],
)
def test_what_cannot_be_is_told_in_one_line(files, tmp_path, monkeypatch, capsys, options, words):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["position", *files, *options]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
