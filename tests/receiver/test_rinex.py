"""Receiver logs are read as written; damaged or other files raise an error with file and line."""

from __future__ import annotations

import gzip
import re
import sys
import tracemalloc
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import hatanaka
import numpy as np
import pytest
from rinex_pair import (
    ALPHA,
    BETA,
    PLACE,
    TIMES,
    TOE,
    both,
    constellation,
    navigation,
    observations,
    written,
)

import celnav
from celnav.models.gnss import satellites
from celnav.receiver.rinex import read_navigation, read_observations


@pytest.fixture(scope="module")
def texts():
    b = constellation()
    return b, navigation(b), *observations(b, TIMES)


def test_broadcast_orbits_are_read_as_written(texts, tmp_path):
    b, text, *_ = texts
    found = read_navigation(written(tmp_path, text))
    order = [found.sets.names.index(name) for name in b.names]
    ours, theirs = (
        satellites(found.sets.chosen(np.array(order)), TOE + 900.0),
        satellites(b, TOE + 900.0),
    )
    np.testing.assert_allclose(
        ours.position, theirs.position, rtol=0, atol=1e-3
    )  # twelve digits of the orbit
    np.testing.assert_allclose(ours.clock, theirs.clock, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.klobuchar, [ALPHA, BETA])


@pytest.mark.parametrize(("ahead", "system"), [(14.0, "GPS"), (0.0, "BDT")])
def test_observations_are_read_as_written(texts, tmp_path, ahead, system):
    text, code, doppler = observations(texts[0], TIMES, ahead, system)
    found = read_observations(written(tmp_path, text))
    order = [found.names.index(name) for name in texts[0].names]
    np.testing.assert_allclose(found.times, TIMES, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.code[:, order], code, rtol=0, atol=6e-4)
    np.testing.assert_allclose(found.doppler[:, order], doppler, rtol=0, atol=6e-4)
    assert found.marker == "TEST"
    np.testing.assert_allclose(found.place, PLACE)
    for marker in (None, PLACE):
        assert np.linalg.norm(found.reference(marker) - PLACE) == pytest.approx(0.5, abs=1e-6)
        assert found.reference(marker) @ PLACE > PLACE @ PLACE  # up


def test_zipped_files_and_other_ends_of_lines_are_the_same(texts, tmp_path):
    text = texts[2]
    plain = read_observations(written(tmp_path, text))
    zipped, other = tmp_path / "file.rnx.gz", tmp_path / "other.rnx"
    zipped.write_bytes(gzip.compress(text.encode()))
    other.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "  \r\n").encode())
    for path in (zipped, other):
        np.testing.assert_array_equal(read_observations(path).code, plain.code)


def test_a_set_is_chosen_by_time_kind_and_health(texts, tmp_path):
    b = texts[0]
    ill = replace(b, health=np.where(np.array(b.names) == "C20", 1.0, 0.0))
    found = read_navigation(written(tmp_path, navigation(ill)))
    assert found.nearest("C19", TOE + 7000.0) >= 0
    assert found.nearest("C19", TOE + 7300.0) == -1
    assert found.nearest("C01", TOE + 3500.0) >= 0
    assert (
        found.nearest("C01", TOE + 3700.0) == -1
    )  # a set of a geostationary satellite is valid for one hour
    assert found.nearest("C20", TOE) == -1
    assert found.nearest("C30", TOE) >= 0
    assert found.nearest("C58", TOE) == -1


DAMAGE = {
    "empty": (lambda _t: "", r"expected a RINEX file, got an empty one"),
    "text": (lambda _t: "hello\nworld\n", r"line 1: expected RINEX VERSION / TYPE"),
    "version 1": (
        lambda t: t.replace("     3.04", "     1.00", 1),
        r"line 1: expected RINEX 2, 3 or 4, got version 1",
    ),
    "version 5": (
        lambda t: t.replace("     3.04", "     5.00", 1),
        r"line 1: expected RINEX 2, 3 or 4, got version 5",
    ),
    "no end": (lambda t: t.split("END OF HEADER")[0], r"line \d+: expected END OF HEADER"),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("kind", ["observations", "navigation"])
def test_what_is_damaged_is_refused_with_file_and_line(texts, tmp_path, kind, damage):
    change, message = DAMAGE[damage]
    text, read = (
        (texts[2], read_observations) if kind == "observations" else (texts[1], read_navigation)
    )
    path = written(tmp_path, change(text))
    with pytest.raises(ValueError, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda t: t[: 9 * len(t) // 10].rsplit("\n", 1)[0],
            r"line \d+: expected \d+ more after line \d+, .* cut off",
        ),
        (
            lambda t: t.split("END OF HEADER")[0] + "END OF HEADER\n",
            r"line 8: expected observations after the header, got none",
        ),
        (
            lambda t: t.replace("C2I", "C7I").replace("C1C", "C2W"),
            r"expected BeiDou's B1I code \(C2I or C2X\), GPS's C1C or Galileo's E1 code \(C1C or "
            r"C1X\) among the observations, got "
            r"C: C7I L2I D2I, G: C2W D1C",
        ),
        (lambda t: t.replace(" GPS ", " GLO ", 1), r"expected times in GPS, GAL or BDT, got 'GLO'"),
    ],
)
def test_observations_that_are_not_whole_are_refused(texts, tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        read_observations(written(tmp_path, change(texts[2])), strict=True)


def test_the_one_for_the_other_and_a_broken_archive_are_refused(texts, tmp_path):
    with pytest.raises(
        ValueError, match=r"line 1: expected a navigation file, got 'OBSERVATION DATA'"
    ):
        read_navigation(written(tmp_path, texts[2]))
    with pytest.raises(
        ValueError, match=r"line 1: expected an observation file, got 'N: GNSS NAV DATA'"
    ):
        read_observations(written(tmp_path, texts[1]))
    broken = tmp_path / "broken.gz"
    broken.write_bytes(gzip.compress(texts[1].encode())[:500])
    with pytest.raises(ValueError, match=r"broken\.gz: expected a whole gzip file"):
        read_navigation(broken)
    with pytest.raises(FileNotFoundError):
        read_navigation(tmp_path / "none.rnx")


def blanked(text, line, first, last, name="C21"):
    """Blank the columns from first to last in a line of a satellite's first set."""
    lines = text.split("\n")
    k = next(k for k, row in enumerate(lines) if row.startswith(name)) + line - 1
    lines[k] = lines[k][: first - 1] + " " * (last - first + 1) + lines[k][last:]
    return "\n".join(lines)


def test_fields_that_are_spare_may_be_blank(texts, tmp_path):
    whole = read_navigation(written(tmp_path, texts[1]))
    for line, first, last in ((6, 24, 42), (6, 62, 80), (6, 43, 61), (8, 24, 42)):
        found = read_navigation(written(tmp_path, blanked(texts[1], line, first, last)))
        assert found.sets.names == whole.sets.names
        assert not found.left_out
    everywhere = texts[1]
    for name in texts[0].names:
        everywhere = blanked(everywhere, 6, 24, 42, name)
    np.testing.assert_array_equal(
        read_navigation(written(tmp_path, everywhere)).sets.M0, whole.sets.M0
    )


WILD = {
    "a blank eccentricity": lambda t: blanked(t, 3, 24, 42),
    "blank health": lambda t: blanked(t, 7, 24, 42),
    "no ellipse": lambda t: re.sub(r"(\nC21.*\n.*\n.{23}).{19}", r"\g<1> 1.500000000000E+00", t),
    "less than no ellipse": lambda t: re.sub(
        r"(\nC21.*\n.*\n.{23}).{19}", r"\g<1>-1.000000000000E-09", t
    ),
    "inside the Earth": lambda t: re.sub(
        r"(\nC21.*\n.*\n.{61}).{19}", r"\g<1> 1.000000000000E+03", t
    ),
    "a clock of a day": lambda t: re.sub(r"(\nC21.{20}).{19}", r"\g<1> 8.640000000000E+04", t),
    "far too large": lambda t: re.sub(r"(\nC21.*\n.{23}).{19}", r"\g<1> 1.000000000000E+99", t),
}


@pytest.mark.parametrize("name", WILD)
def test_a_set_that_is_none_is_left_out_and_counted(texts, tmp_path, name):
    changed = WILD[name](texts[1])
    assert changed != texts[1]
    found = read_navigation(written(tmp_path, changed))
    assert found.left_out == {"C21": 1}
    assert sorted(found.sets.names) == sorted(set(texts[0].names) - {"C21"})


def signed(bits, scale):
    """The largest magnitude of a signed number in the message, in the units of the file."""
    return 2.0 ** (bits - 1) * scale


CIRCLE = np.pi  # the message has semicircles, the file radians
HOLDS = {
    "a0": (signed(24, 2.0**-33), signed(22, 2.0**-31)),
    "a1": (signed(22, 2.0**-50), signed(16, 2.0**-43)),
    "a2": (signed(11, 2.0**-66), signed(8, 2.0**-55)),
    "crs": (signed(18, 2.0**-6), signed(16, 2.0**-5)),
    "crc": (signed(18, 2.0**-6), signed(16, 2.0**-5)),
    "cuc": (signed(18, 2.0**-31), signed(16, 2.0**-29)),
    "cus": (signed(18, 2.0**-31), signed(16, 2.0**-29)),
    "cic": (signed(18, 2.0**-31), signed(16, 2.0**-29)),
    "cis": (signed(18, 2.0**-31), signed(16, 2.0**-29)),
    "delta_n": (signed(16, 2.0**-43) * CIRCLE, signed(16, 2.0**-43) * CIRCLE),
    "Omega_dot": (signed(24, 2.0**-43) * CIRCLE, signed(24, 2.0**-43) * CIRCLE),
    "i_dot": (signed(14, 2.0**-43) * CIRCLE, signed(14, 2.0**-43) * CIRCLE),
    "tgd": (signed(10, 1e-10), signed(8, 2.0**-31)),
}
"""Largest magnitudes in the messages of BeiDou and GPS, from the tables of their documents."""


def left_out(tmp_path, b, name, number, value):
    """Whether a set with the number ``value`` is left out."""
    values = getattr(b, name).copy()
    values[number] = value
    found = read_navigation(written(tmp_path, navigation(replace(b, **{name: values}))))
    assert found.left_out in ({}, {b.names[number]: 1})
    return bool(found.left_out)


@pytest.mark.parametrize("name", HOLDS)
@pytest.mark.parametrize("system", [0, 1])
def test_a_set_may_have_what_its_message_can_hold_and_not_twice_as_much(tmp_path, name, system):
    b = both()
    number, largest = b.names.index(("C21", "G07")[system]), HOLDS[name][system]
    factor = 4.0 if system and name in ("crs", "crc") else 2.0  # there BeiDou's limit is for both
    for sign in (-1.0, 1.0):
        assert not left_out(tmp_path, b, name, number, sign * 0.9999 * factor * largest)
        assert left_out(tmp_path, b, name, number, sign * 1.0001 * factor * largest)


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("e", (0.0, 0.5), (0.501, 0.9)),
        ("sqrt_a", (4096.0, 8191.0), (4095.0, 8193.0)),
        *((name, (-1256.0, 1256.0), (-1257.0, 1257.0)) for name in ("M0", "Omega0", "omega", "i0")),
    ],
)
def test_an_orbit_is_an_ellipse_and_its_angles_are_no_more_than_many_turns(
    tmp_path, name, good, bad
):
    for number in (both().names.index(satellite) for satellite in ("C21", "G07")):
        assert [left_out(tmp_path, both(), name, number, value) for value in good] == [False, False]
        assert [left_out(tmp_path, both(), name, number, value) for value in bad] == [True, True]


def test_a_time_of_the_week_is_within_it(texts, tmp_path):
    time = re.search(r"\nC21.*\n.*\n.*\n    (.{19})", texts[1])[1]
    for value, outside in ((0.0, False), (604_800.0, False), (604_801.0, True), (-1.0, True)):
        text = re.sub(r"(\nC21.*\n.*\n.*\n    ).{19}", rf"\g<1>{value:19.12E}", texts[1], count=1)
        found = read_navigation(written(tmp_path, text))
        assert found.left_out == ({"C21": 1} if outside else {})
    assert float(time) == 345_600.0


def test_sets_that_are_all_none_are_refused(texts, tmp_path):
    text = texts[1]
    for name in texts[0].names:
        text = blanked(text, 3, 62, 80, name)
    with pytest.raises(
        ValueError,
        match=r"file\.rnx: expected orbits, got 32 sets that lack a number, or have one that no message",
    ):
        read_navigation(written(tmp_path, text))


@pytest.mark.parametrize(
    ("version", "kinds"),
    [
        ("3.04", "C2X L2X D2X"),
        ("3.05", "C2Q L2Q D2Q"),
        ("3.02", "C1I L1I D1I"),
        ("3.02", "C1X L1X D1X"),
    ],
)
def test_b1_is_taken_by_any_of_its_names(texts, tmp_path, version, kinds):
    text = texts[2].replace("     3.04", f"     {version}", 1).replace("C2I L2I D2I", kinds)
    whole, found = (
        read_observations(written(tmp_path, texts[2], "whole.rnx")),
        read_observations(written(tmp_path, text)),
    )
    np.testing.assert_array_equal(found.code, whole.code)
    np.testing.assert_array_equal(found.doppler, whole.doppler)


def test_band_one_is_another_carrier_since(texts, tmp_path):
    found = read_observations(written(tmp_path, texts[2].replace("C2I L2I D2I", "C1X L1X D1X")))
    assert found.names == ["G01"]


def test_a_satellite_is_taken_by_the_code_that_it_has(texts, tmp_path):
    whole = read_observations(written(tmp_path, texts[2], "whole.rnx"))
    text = texts[2].replace("C    3 C2I L2I D2I    ", "C    5 C2I C2X L2I D2I D2X", 1)
    rows = []
    for row in text.split("\n"):
        if re.match(r"C\d\d", row):
            code, rate = row[3:19], row[35:49]
            blank = " " * 16
            # C19 has no data component; the others have both.
            row = row[:3] + (
                blank + code + blank + blank + rate
                if row[:3] == "C19"
                else code + code + blank + rate + "  " + rate
            )
        rows.append(row.rstrip())
    found = read_observations(written(tmp_path, "\n".join(rows)))
    np.testing.assert_array_equal(found.code, whole.code)
    np.testing.assert_array_equal(found.doppler, whole.doppler)


def test_what_is_zero_was_not_measured(texts, tmp_path):
    row = next(row for row in texts[2].split("\n") if row.startswith("C05"))
    found = read_observations(
        written(tmp_path, texts[2].replace(row, f"C05{0.0:14.3f}" + row[17:], 1))
    )
    assert np.isnan(found.code[0, found.names.index("C05")])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("\nC05", "\nC04", "expected each satellite once in an epoch, got C04 again"),
        (
            "C    3 C2I L2I D2I",
            "C    4 C2I L2I D2I",
            "expected '4' kinds in SYS / # / OBS TYPES of C, got 3",
        ),
        (" 14.0000000  0", "       1e99  0", "expected date, flag and number of an epoch"),
        ("\nC05", "\nC00", r"expected a satellite \(C01\), got 'C00'"),
    ],
)
def test_what_cannot_be_is_told_by_its_line(texts, tmp_path, old, new, words):
    changed = texts[2].replace(old, new, 1)
    assert changed != texts[2]
    with pytest.raises(ValueError, match=words):
        read_observations(written(tmp_path, changed), strict=True)


def test_a_set_of_no_satellite_or_date_is_told_by_its_line(texts, tmp_path):
    for old, new, words in (
        ("\nC21", "\nCxx", r"line \d+: expected a satellite \(C01\), got 'Cxx'"),
        ("C21 2020", "C21 20x0", r"line \d+: expected a date"),
    ):
        text = re.sub(r"C21 \d{4}", "C21 2020", texts[1])
        with pytest.raises(ValueError, match=words):
            read_navigation(written(tmp_path, text.replace(old, new, 1)), strict=True)


def test_an_epoch_out_of_order_is_left_out_and_counted(texts, tmp_path):
    heads = [row for row in texts[2].split("\n") if row.startswith(">")]
    year = int(heads[1][2:6])
    for wrong in (year + 1, year - 1):
        found = read_observations(
            written(tmp_path, texts[2].replace(heads[1], f"> {wrong}" + heads[1][6:]))
        )
        np.testing.assert_allclose(found.times, TIMES[[0, 2]])
        assert found.out_of_order == 1
    assert read_observations(written(tmp_path, texts[2])).out_of_order == 0


def test_files_joined_in_another_order_are_whole(texts, tmp_path):
    times = TOE + 1800.0 + 30.0 * np.arange(6)
    text = observations(texts[0], times)[0]
    head, *parts = re.split(r"(?m)^(?=>)", text)
    found = read_observations(written(tmp_path, "".join([head, *parts[3:], *parts[:3]])))
    np.testing.assert_allclose(found.times, times)
    assert found.out_of_order == 0


def test_an_archive_that_would_fill_the_memory_is_refused(tmp_path, texts):
    bomb = tmp_path / "bomb.rnx.gz"
    bomb.write_bytes(gzip.compress(texts[2].encode() + b" " * 60_000_000, 9))
    tracemalloc.start()
    with pytest.raises(
        ValueError, match=r"bomb\.rnx\.gz: expected at most 10,000,000 bytes when unpacked"
    ):
        read_observations(bomb)
    assert tracemalloc.get_traced_memory()[1] < 40e6
    tracemalloc.stop()


def test_hatanakas_compression_is_read_and_is_no_way_around_the_limit(tmp_path, texts):
    packed = hatanaka.rnx2crx(texts[2].encode())
    path = tmp_path / "file.crx.gz"
    path.write_bytes(gzip.compress(packed))
    plain = read_observations(written(tmp_path, texts[2]))
    np.testing.assert_array_equal(read_observations(path).code, plain.code)
    # Constant values take few bytes in this compression.
    head, first, *_ = re.split(r"(?m)^(?=>)", texts[2])
    day = np.datetime64("2020-06-25T00:00:00") + np.arange(20_000) * np.timedelta64(1, "s")
    dates = (str(t).replace("-", " ").replace("T", " ").replace(":", " ") for t in day)
    long = head + "".join(f"> {date}" + first[21:] for date in dates)
    small = hatanaka.rnx2crx(long.encode())
    path.write_bytes(gzip.compress(small, 9))
    assert len(small) < 8e6
    assert len(long) > 25e6
    with pytest.raises(ValueError, match=r"expected at most 10,000,000 bytes when unpacked"):
        read_observations(path)
    path.write_bytes(gzip.compress(packed[:-3]))
    with pytest.raises(ValueError, match=r"a whole file in Hatanaka's .*seems to be truncated"):
        read_observations(path)
    path.write_bytes(gzip.compress(packed[: len(packed) // 2] + b"\n&garbage\n"))
    with pytest.raises(
        ValueError, match=r"expected a whole file in Hatanaka's compression|cut off"
    ):
        read_observations(path)


REAL = Path(__file__).parents[3] / "shared" / "data" / "rinex"


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_a_real_navigation_file_is_continuous():
    found = read_navigation(next(REAL.glob("*MN.rnx.gz")))
    sets = found.sets
    rows = np.flatnonzero((sets.number == 5) & (sets.system == 0))
    apart = []
    for one, two in pairwise(rows.tolist()):
        if sets.toe[two] - sets.toe[one] == 3600.0:
            middle = 0.5 * (sets.toe[one] + sets.toe[two])
            states = satellites(sets.chosen(np.array([one, two])), middle).position
            apart.append(np.linalg.norm(states[0] - states[1]))
    assert len(apart) > 15
    assert max(apart) < 2.0
    wrong = satellites(
        replace(sets.chosen(rows[:1]), number=np.array([21.0])), sets.toe[rows[0]] + 1800.0
    ).position
    assert (
        np.linalg.norm(
            wrong - satellites(sets.chosen(rows[:1]), sets.toe[rows[0]] + 1800.0).position
        )
        > 1e6
    )


def test_what_is_missing_is_said_with_a_command_that_works_in_a_clone(texts, tmp_path, monkeypatch):
    path = tmp_path / "file.crx"
    path.write_bytes(hatanaka.rnx2crx(texts[2].encode()))
    monkeypatch.setitem(sys.modules, "hatanaka", None)
    with pytest.raises(
        ImportError, match=re.escape('.venv/bin/pip install -c constraints.txt -e ".[rinex]"')
    ):
        read_observations(path)
    root = Path(celnav.__file__).parents[1]
    for file in (
        root / "README.md",
        *(root / "celnav").rglob("*.py"),
    ):  # celnav is in no index of packages
        assert "celnav[" not in file.read_text("utf-8"), file
