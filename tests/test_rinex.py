"""Receiver logs are read as they were written; what is damaged or something else is refused with file and line."""

from __future__ import annotations

import gzip
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from rinex_pair import ALPHA, BETA, PLACE, TIMES, TOE, constellation, navigation, observations, written

from celnav.models.beidou import satellites
from celnav.rinex import read_navigation, read_observations


@pytest.fixture(scope="module")
def texts():
    b = constellation()
    return b, navigation(b), *observations(b, TIMES)


def test_broadcast_orbits_are_read_as_written(texts, tmp_path):
    b, text, *_ = texts
    found = read_navigation(written(tmp_path, text))
    order = [found.sets.names.index(name) for name in b.names]
    ours, theirs = satellites(found.sets.chosen(np.array(order)), TOE + 900.0), satellites(b, TOE + 900.0)
    np.testing.assert_allclose(ours.position, theirs.position, rtol=0, atol=1e-3)  # twelve digits of the orbit
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
    assert np.linalg.norm(found.position - PLACE) == pytest.approx(0.5, abs=1e-6)
    assert found.position @ PLACE > PLACE @ PLACE  # up


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
    assert found.nearest("C01", TOE + 3700.0) == -1  # of a geostationary satellite a set is good for an hour
    assert found.nearest("C20", TOE) == -1
    assert found.nearest("C30", TOE) >= 0
    assert found.nearest("C58", TOE) == -1


DAMAGE = {
    "empty": (lambda _t: "", r"expected a RINEX file, got an empty one"),
    "text": (lambda _t: "hello\nworld\n", r"line 1: expected RINEX VERSION / TYPE"),
    "version 2": (lambda t: t.replace("     3.04", "     2.11", 1), r"line 1: expected RINEX 3, got version 2\.11"),
    "version 4": (lambda t: t.replace("     3.04", "     4.00", 1), r"line 1: expected RINEX 3, got version 4"),
    "no end": (lambda t: t.split("END OF HEADER")[0], r"line \d+: expected END OF HEADER"),
    "glonass": (lambda t: t.replace("M: Mixed", "R: GLONASS", 1).replace("C: BDS", "R: GLONASS", 1), r"line 1: .*got system 'R'"),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("kind", ["observations", "navigation"])
def test_what_is_damaged_is_refused_with_file_and_line(texts, tmp_path, kind, damage):
    change, message = DAMAGE[damage]
    text, read = (texts[2], read_observations) if kind == "observations" else (texts[1], read_navigation)
    path = written(tmp_path, change(text))
    with pytest.raises(ValueError, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t[: 9 * len(t) // 10].rsplit("\n", 1)[0], r"line \d+: expected \d+ more after line \d+, .* cut off"),
        (lambda t: t.split("END OF HEADER")[0] + "END OF HEADER\n", r"line 8: expected observations after the header, got none"),
        (lambda t: t.replace("C2I", "C7I"), r"expected BeiDou's B1I code \(C2I\) among the observations, got C7I, L2I, D2I"),
        (lambda t: t.replace(" GPS ", " GLO ", 1), r"expected times in GPS, GAL or BDT, got 'GLO'"),
    ],
)  # fmt: skip
def test_observations_that_are_not_whole_are_refused(texts, tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        read_observations(written(tmp_path, change(texts[2])))


def test_the_one_for_the_other_and_a_broken_archive_are_refused(texts, tmp_path):
    with pytest.raises(ValueError, match=r"line 1: expected a navigation file, got 'OBSERVATION DATA'"):
        read_navigation(written(tmp_path, texts[2]))
    with pytest.raises(ValueError, match=r"line 1: expected an observation file, got 'N: GNSS NAV DATA'"):
        read_observations(written(tmp_path, texts[1]))
    broken = tmp_path / "broken.gz"
    broken.write_bytes(gzip.compress(texts[1].encode())[:500])
    with pytest.raises(ValueError, match=r"broken\.gz: expected a whole gzip file"):
        read_navigation(broken)
    with pytest.raises(FileNotFoundError):
        read_navigation(tmp_path / "none.rnx")


REAL = Path(__file__).parents[2] / "shared" / "data" / "rinex"


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_a_real_navigation_file_is_continuous():
    found = read_navigation(next(REAL.glob("*MN.rnx.gz")))
    sets = found.sets
    rows = np.flatnonzero(sets.number == 5)
    apart = []
    for one, two in pairwise(rows.tolist()):
        if sets.toe[two] - sets.toe[one] == 3600.0:
            middle = 0.5 * (sets.toe[one] + sets.toe[two])
            states = satellites(sets.chosen(np.array([one, two])), middle).position
            apart.append(np.linalg.norm(states[0] - states[1]))
    assert len(apart) > 15
    assert max(apart) < 2.0
    wrong = satellites(replace(sets.chosen(rows[:1]), number=np.array([21.0])), sets.toe[rows[0]] + 1800.0).position
    assert np.linalg.norm(wrong - satellites(sets.chosen(rows[:1]), sets.toe[rows[0]] + 1800.0).position) > 1e6
