"""Versions 2.11 and 4 of RINEX, files of systems that are not used, and Galileo."""

from __future__ import annotations

import gzip
import re
from dataclasses import replace
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
    above,
    both,
    civil,
    constellation,
    galileo,
    gps,
    joined,
    label,
    navigation,
    observations,
    observed,
    written,
)

from celnav.files import InputError
from celnav.filters.run import run
from celnav.models import pseudorange
from celnav.models.gnss import L1_HZ, satellites
from celnav.receiver import position as positioning
from celnav.receiver import report
from celnav.receiver.filters import filters
from celnav.receiver.rinex import Navigation, read_ionosphere, read_navigation, read_observations
from celnav.receiver.sky import dilution, local_axes

LONG = TOE + 1800.0 + 30.0 * np.arange(40)
DRIFTING = 3e4 + 30.0 * (LONG - LONG[0])
KLOBUCHAR = (np.array(ALPHA), np.array(BETA))


def three_systems():
    return joined(constellation(), gps(), galileo())


# Version 2.11


def observations_2(b, times, bias, kinds=("C1", "L1", "D1", "S1", "P1", "C2")):
    """An observation file in version 2.11 with the satellites of one system."""
    log = observed(b, times, bias)
    text = label(
        f"{2.11:9.2f}{'':11}{'OBSERVATION DATA':<20}{'M (MIXED)':<20}", "RINEX VERSION / TYPE"
    )
    text += label("TEST", "MARKER NAME")
    text += label("".join(f"{v:14.4f}" for v in PLACE), "APPROX POSITION XYZ")
    text += label(f"{0.5:14.4f}{0.0:14.4f}{0.0:14.4f}", "ANTENNA: DELTA H/E/N")
    text += label(f"{len(kinds):6d}" + "".join(f"    {k}" for k in kinds), "# / TYPES OF OBSERV")
    text += label("", "TIME OF FIRST OBS") + label("", "END OF HEADER")
    for k, t in enumerate(times):
        y, mo, d, h, mi, sec = (int(part) for part in civil(t + 14.0))
        head = f" {y % 100:02d} {mo:2d} {d:2d} {h:2d} {mi:2d}{sec:11.7f}  0{len(b):3d}"
        for first in range(0, len(b), 12):
            names = [f"{n[0]}{int(n[1:]):2d}" for n in b.names[first : first + 12]]
            text += (head if first == 0 else " " * 32) + "".join(names) + "\n"
        for s in range(len(b)):
            values = {"C1": log.code[k, s], "D1": log.doppler[k, s], "S1": 45.0}
            fields = [f"{values[kind]:14.3f}  " if kind in values else " " * 16 for kind in kinds]
            for first in range(0, len(kinds), 5):
                text += "".join(fields[first : first + 5]).rstrip() + "\n"
    return text, log


def navigation_2(b, toe=TOE):
    """The GPS sets of version 3 in the columns of version 2.11."""
    lines = navigation(b, toe).splitlines()
    first = next(k for k, line in enumerate(lines) if "END OF HEADER" in line) + 1
    out = label(f"{2.11:9.2f}{'':11}{'N: GPS NAV DATA':<20}", "RINEX VERSION / TYPE")
    for row, name in ((ALPHA, "ION ALPHA"), (BETA, "ION BETA")):
        out += label("  " + "".join(f"{v:12.4E}".replace("E", "D") for v in row), name)
    out += label("", "END OF HEADER")
    for line in lines[first:]:
        if line[0] == "G":
            y, mo, d, h, mi, sec = (int(part) for part in line[4:23].split())
            head = f"{int(line[1:3]):2d} {y % 100:02d} {mo:2d} {d:2d} {h:2d} {mi:2d}{sec:5.1f}"
            out += head + line[23:].replace("E", "D") + "\n"
        else:
            out += line[1:].replace("E", "D") + "\n"
    return out


def test_version_2_is_read_as_version_3(tmp_path):
    """With two lines of satellites and two lines of fields for each of them, the last one blank."""
    b = gps()
    text, log = observations_2(b, TIMES, 3e4 + 0.0 * TIMES)
    found = read_observations(written(tmp_path, text))
    order = [found.names.index(name) for name in b.names]
    np.testing.assert_allclose(found.times, TIMES, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.code[:, order], log.code, rtol=0, atol=6e-4)
    np.testing.assert_allclose(found.doppler[:, order], log.doppler, rtol=0, atol=6e-4)
    np.testing.assert_allclose(found.place, PLACE)
    assert not found.damaged
    packed = tmp_path / "file.24d.gz"
    packed.write_bytes(gzip.compress(hatanaka.rnx2crx(text.encode())))
    assert b"1.0" in gzip.decompress(packed.read_bytes())[:10]
    np.testing.assert_array_equal(read_observations(packed).code, found.code)
    ours, theirs = (
        read_navigation(written(tmp_path, t, f"{n}.nav")).sets
        for n, t in enumerate((navigation_2(b), navigation(b)))
    )
    assert ours.names == theirs.names
    for name in ("toe", "toc", "M0", "a0", "tgd", "accuracy"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    nav = read_navigation(written(tmp_path, navigation_2(b), "0.nav"))
    np.testing.assert_allclose(nav.klobuchar, KLOBUCHAR)
    log = positioning.prepare(found, nav)
    np.testing.assert_allclose(log.fixes[:, :3], np.broadcast_to(PLACE, (3, 3)), atol=0.01)


def test_version_2_takes_p_code_where_there_is_no_other(tmp_path):
    text, _ = observations_2(gps(), TIMES, 0.0 * TIMES)
    whole = read_observations(written(tmp_path, text))
    other = text.replace("    C1    L1    D1    S1    P1", "    P1    L1    D1    S1    C1", 1)
    np.testing.assert_array_equal(
        read_observations(written(tmp_path, other, "p.obs")).code, whole.code
    )


@pytest.mark.parametrize(
    ("year", "digits"), [(1980, "80"), (1999, "99"), (2006, " 6"), (2024, "24"), (2079, "79")]
)
def test_years_of_two_digits(tmp_path, year, digits):
    text, _ = observations_2(gps(), TIMES[:1], 0.0 * TIMES[:1])
    head = next(line for line in text.splitlines() if re.match(r" \d\d  ?\d", line))
    found = read_observations(written(tmp_path, text.replace(head[:3], " " + digits, 1)))
    when = np.datetime64("2006-01-01T00:00:00") + np.timedelta64(round(found.times[0] + 14.0), "s")
    assert str(when)[:4] == str(year)


def test_damage_in_version_2_costs_its_epoch(tmp_path):
    b = gps()
    text, _ = observations_2(b, LONG[:6], DRIFTING[:6])
    whole = read_observations(written(tmp_path, text))
    lines = text.splitlines()
    heads = [k for k, line in enumerate(lines) if re.match(r" \d\d +\d+ +\d+ +\d+ +\d+", line)]
    head = heads[2]
    row = lines[head + 2]  # after two lines of satellites; its second line is blank
    assert lines[head + 3] == ""
    changes = {
        "a letter": [row[:5] + "x" + row[6:], ""],
        "a lost line": [row],
        "a line twice": [row, row, ""],
        "a blank line twice": [row, "", ""],
        "a cut line": [row[:9], ""],
    }
    for what, rows in changes.items():
        changed = "\n".join([*lines[: head + 2], *rows, *lines[head + 4 :]]) + "\n"
        found = read_observations(written(tmp_path, changed))
        np.testing.assert_array_equal(found.times, np.delete(whole.times, 2), err_msg=what)
        np.testing.assert_array_equal(found.code, np.delete(whole.code, 2, 0), err_msg=what)
        assert len(found.damaged) == 1, what
        number = int(re.search(r", line (\d+): expected", found.damaged[0])[1])
        assert head < number <= heads[3] + 1, what
    # Without its first line an epoch's rows cannot be distinguished from the rows of the epoch
    # before.
    changed = "\n".join([*lines[:head], "x" + lines[head][1:], *lines[head + 1 :]]) + "\n"
    found = read_observations(written(tmp_path, changed))
    np.testing.assert_array_equal(found.times, np.delete(whole.times, [1, 2]))
    assert len(found.damaged) == 1


# Version 4


def navigation_4(text):
    """The records of a file of version 3, with their titles, and others between them."""
    names = {"C": "D1", "G": "LNAV", "E": "INAV"}
    head, body = re.split(r"(?<=END OF HEADER {7}\n)", text.replace("     3.04", "     4.00", 1))
    head = "".join(line for line in head.splitlines(True) if "IONO" not in line)
    numbers = [*ALPHA, *BETA]
    rows = [numbers[:3], numbers[3:7], [numbers[7], 0.0]]
    ionosphere = "> ION G03 LNAV\n    2024 05 01 00 00 00"
    ionosphere += "    ".join("".join(f"{v:19.12E}" for v in row) + "\n" for row in rows)
    others = (
        "> STO G01 LNAV\n    2024 05 01 00 00 00 GPUT                                  UTC\n"
        "     2.880000000000E+05 1.862645149231E-09 8.881784197001E-16 0.000000000000E+00\n"
        "> EPH R05 FDMA\nR05 2024 05 01 00 15 00 1.0E-04\n     7.0\n     7.0\n     7.0\n"
        "> EPH G02 CNAV\n" + "G02 2024 05 01 00 00 00 1.000000000000E-04\n" * 9
    )
    out = re.sub(
        r"(?m)^([CGE])(\d\d) (?=\d{4} )",
        lambda m: f"> EPH {m[1]}{m[2]} {names[m[1]]}\n{m[0]}",
        body,
    )
    return head + others + ionosphere + out


def test_version_4_is_read_as_version_3(tmp_path):
    b = three_systems()
    text = navigation(b)
    whole = read_navigation(written(tmp_path, text, "three.rnx"))
    path = written(tmp_path, navigation_4(text), "four.rnx")
    found = read_navigation(path)
    assert found.sets.names == whole.sets.names
    for name in vars(whole.sets):
        np.testing.assert_array_equal(getattr(found.sets, name), getattr(whole.sets, name))
    np.testing.assert_allclose(found.klobuchar, whole.klobuchar)
    np.testing.assert_allclose(read_ionosphere(path), whole.klobuchar)
    assert found.unused == {"GPS LNAV STO": 1, "GLONASS": 1, "GPS CNAV EPH": 1}
    obs, code, _ = observations(b, TIMES)
    new = read_observations(written(tmp_path, obs.replace("     3.04", "     4.00", 1), "obs.rnx"))
    order = [new.names.index(name) for name in b.names]
    np.testing.assert_allclose(new.code[:, order], code, rtol=0, atol=6e-4)
    log = positioning.prepare(new, found)
    assert log.systems == "CGE"
    np.testing.assert_allclose(log.fixes[:, :3], np.broadcast_to(PLACE, (3, 3)), atol=0.05)
    said = report.summary(report.position(log, "ls", PLACE))
    assert (
        "3 records of orbits that are not used (GPS LNAV STO 1, GLONASS 1, GPS CNAV EPH 1)" in said
    )


def test_damaged_records_of_version_4_are_left_out_and_told(tmp_path):
    text = navigation_4(navigation(both()))
    path = written(tmp_path, text.replace("> EPH C21 D1", "> EPX C21 D1", 1))
    found = read_navigation(path)
    assert sorted(set(both().names) - set(found.sets.names)) == ["C21"]
    (message,) = found.damaged
    number = text.split("> EPH C21")[0].count("\n") + 1
    assert f"line {number}: expected a record (> EPH G01 LNAV), got '> EPX C21 D1'" in message
    with pytest.raises(InputError, match=re.escape(message)):
        read_navigation(path, strict=True)
    lost = re.sub(r"(> EPH G07 LNAV\n.*\n).*\n", r"\1", text)
    found = read_navigation(written(tmp_path, lost))
    assert sorted(set(both().names) - set(found.sets.names)) == ["G07"]
    assert "expected 8 lines of a broadcast set" in found.damaged[0]


# Files of other systems, and of another day


def glonass(version):
    """Two GLONASS sets in a separate file."""
    kind = "N: GNSS NAV DATA" if version == 3 else "GLONASS NAV DATA"
    text = label(
        f"{3.04 if version == 3 else 2.11:9.2f}{'':11}{kind:<20}R: GLONASS", "RINEX VERSION / TYPE"
    ) + label("", "END OF HEADER")
    for slot in (1, 2):
        text += (
            f"R{slot:02d} 2024 05 01 00 15 00" if version == 3 else f"{slot:2d} 24  5  1  0 15  0.0"
        )
        text += "".join(f"{v:19.12E}" for v in (1e-4, 0.0, 8.6e4)) + "\n"
        numbers = "".join(f"{v:19.12E}" for v in (1e4, 1.0, 0.0, 0.0))
        text += 3 * ((" " * 4 if version == 3 else " " * 3) + numbers + "\n")
    return text


@pytest.mark.parametrize("version", [2, 3])
def test_a_file_of_a_system_that_is_not_used_is_counted(tmp_path, version):
    other = written(tmp_path, glonass(version), "glonass.rnx")
    b = gps()
    found = read_navigation(other, written(tmp_path, navigation(b), "gps.rnx"))
    assert found.unused == {"GLONASS": 2}
    assert len(found.sets) == 24
    log = positioning.prepare(observed(b, TIMES, 0.0 * TIMES), found)
    said = report.summary(report.position(log, "ls", PLACE))
    assert "2 records of orbits that are not used (GLONASS 2)" in said
    with pytest.raises(
        InputError,
        match=r"glonass\.rnx: expected orbits of BeiDou, GPS or Galileo satellites, got none \(not "
        r"used: GLONASS 2\)",
    ):
        read_navigation(other)


def test_orbits_of_another_day_are_told(tmp_path):
    b = gps()
    nav = Navigation(Path("nav.rnx"), b, KLOBUCHAR)
    with pytest.raises(
        InputError,
        match=r"nav\.rnx: expected orbits for the time of the observations, 2020-06-27T00:30:00 to "
        r".* BDT, got some for 2020-06-25T00:00:00 to 2020-06-25T00:00:00",
    ):
        positioning.prepare(observed(b, TIMES + 172_800.0, 0.0 * TIMES), nav)


# Galileo


def test_galileo_alone_and_beside_the_others_finds_the_receiver():
    b = above(three_systems(), LONG[[0, -1]])
    nav, obs = Navigation(Path("nav.rnx"), b, KLOBUCHAR), observed(b, LONG, DRIFTING, -37.0)
    obs.code[:, b.system == 2] += 12.0
    for systems, offsets in (
        ("E", []),
        ("GE", [12.0 + 37.0]),
        ("CE", [12.0]),
        ("CGE", [-37.0, 12.0]),
    ):
        log = positioning.prepare(obs, nav, systems=systems)
        assert log.systems == systems
        assert log.fixes.shape[1] == 8 + len(offsets)
        np.testing.assert_allclose(log.fixes[:, :3], np.broadcast_to(PLACE, (40, 3)), atol=1e-3)
        np.testing.assert_allclose(log.fixes[:, 8:], np.tile(offsets, (40, 1)), atol=1e-3)
        assert (log.spare == log.used.sum(1) - 4 - len(offsets)).all()
        for name in ("ekf", "aukf"):
            filter = filters(len(log.names), second=log.second)[name]
            mean = run(filter, log.prior(), log.epochs(), keep="mean").mean
            np.testing.assert_allclose(mean[:, :3], np.broadcast_to(PLACE, (40, 3)), atol=5e-3)
        said = report.summary(report.position(log, "ls", PLACE))
        assert "Galileo E1" in said
        for letter, offset in zip(systems[1:], offsets, strict=True):
            name = {"G": "GPS", "E": "Galileo"}[letter]
            assert f"ranges of {name} are longer by {offset:.2f} m (median)" in said


@pytest.mark.parametrize("missing", ["C", "G", "E", "CG", "GE"])
def test_where_systems_are_missing_the_others_go_on(missing):
    b = above(three_systems(), LONG[[0, -1]])
    nav, obs = Navigation(Path("nav.rnx"), b, KLOBUCHAR), observed(b, LONG, DRIFTING, -37.0)
    obs.code[10:20, [name[0] in missing for name in b.names]] = np.nan
    log = positioning.prepare(obs, nav)
    np.testing.assert_allclose(log.fixes[:, :3], np.broadcast_to(PLACE, (40, 3)), atol=1e-3)
    unknown = [letter in missing or "C" in missing for letter in "GE"]
    np.testing.assert_array_equal(np.isnan(log.fixes[10:20, 8:]), np.tile(unknown, (10, 1)))
    assert (log.spare[10:20] == log.used[10:20].sum(1) - 3 - (3 - len(missing))).all()
    assert not log.jumps.any()


def test_offsets_that_satellites_leave_open():
    """Against the rank of the clocks' columns, for all combinations of available systems."""
    offsets = np.array([[0.0, 0.0, 1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0, 1.0]])
    columns = np.column_stack([np.ones(6), offsets.T])
    for pattern in range(8):
        used = np.repeat([bool(pattern >> j & 1) for j in range(3)], 2)
        found = pseudorange.undetermined(used, offsets)
        rank = np.linalg.matrix_rank(columns[used]) if used.any() else 1
        assert found.sum() == 3 - rank
        rows = np.concatenate([columns[used], np.eye(3)[1:][found]])
        assert np.linalg.matrix_rank(rows) == (3 if used.any() else 2)


def test_dilution_with_three_clocks():
    rng = np.random.default_rng(4)
    place, axes = np.array([6378137.0, 0.0, 0.0]), local_axes(0.0, 0.0)
    q = place + 2e7 * rng.normal(size=(3, 12, 3))
    system, used = np.repeat([0, 1, 2], 4), np.ones((3, 12), bool)
    used[1, :4] = used[2, 4:8] = False
    found = dilution(q, place, axes, used, np.array([system == 1, system == 2], float))
    for k in range(3):
        e = (q[k] - place) / np.linalg.norm(q[k] - place, axis=-1, keepdims=True)
        G = np.column_stack([-e, system == 0, system == 1, system == 2])[used[k]]
        expected = np.sqrt(np.trace(np.linalg.pinv(G.T @ G)[:3, :3]))
        assert found.position[k] == pytest.approx(expected)


def written_galileo(tmp_path, change):
    """Values read from Galileo sets whose lines are changed by a function of satellite and line."""
    lines = navigation(galileo()).splitlines()
    first = next(k for k, line in enumerate(lines) if "END OF HEADER" in line) + 1
    for k in range(first, len(lines), 8):
        lines[k : k + 8] = change(lines[k][:3], lines[k : k + 8])
    return read_navigation(written(tmp_path, "\n".join(lines) + "\n"))


def with_field(rows, line, field, value):
    at = 4 + 19 * field
    rows = list(rows)
    rows[line] = rows[line][:at] + f"{value:19.12E}" + rows[line][at + 19 :]
    return rows


@pytest.mark.parametrize(("source", "delay"), [(513, "b"), (516, "b"), (517, "b"), (258, "a")])
def test_the_data_source_says_which_group_delay_goes_with_the_clock(tmp_path, source, delay):
    b = galileo()
    found = written_galileo(tmp_path, lambda _, rows: with_field(rows, 5, 1, source)).sets
    order = [found.names.index(name) for name in b.names]
    expected = b.tgd if delay == "b" else np.full(24, -3e-9)
    np.testing.assert_allclose(found.tgd[order], expected, rtol=1e-12)
    np.testing.assert_allclose(found.accuracy, 3.12)
    clocks = satellites(found.chosen(np.array(order)), TOE + 60.0).clock
    np.testing.assert_allclose(
        clocks, satellites(replace(b, tgd=expected), TOE + 60.0).clock, rtol=0, atol=1e-15
    )


def test_of_two_messages_of_one_time_that_of_e1_is_taken(tmp_path):
    def doubled(_, rows):
        other = with_field(with_field(rows, 5, 1, 258.0), 0, 1, 1e-3)
        other[0] = rows[0][:23] + f"{2e-4:19.12E}" + rows[0][42:]
        return [*other, *rows]

    found = written_galileo(tmp_path, lambda name, rows: rows).sets
    lines = navigation(galileo()).splitlines()
    first = next(k for k, line in enumerate(lines) if "END OF HEADER" in line) + 1
    body = [row for k in range(first, len(lines), 8) for row in doubled(None, lines[k : k + 8])]
    both_messages = read_navigation(
        written(tmp_path, "\n".join([*lines[:first], *body]) + "\n", "two.rnx")
    )
    assert len(both_messages.sets) == 2 * len(found)
    for name in ("E01", "E13"):
        row = both_messages.nearest(name, TOE + 60.0)
        assert both_messages.sets.a0[row] == found.a0[found.names.index(name)]


@pytest.mark.parametrize(
    ("source", "health", "accuracy", "good"),
    [
        (517, 0b000000000, 3.12, True),
        (517, 0b000000001, 3.12, False),  # data of E1-B are not valid
        (517, 0b000000010, 3.12, False),  # E1-B is out of service
        (517, 0b000001000, 3.12, True),  # only E5a is unhealthy
        (258, 0b000010000, 3.12, False),
        (258, 0b000000010, 3.12, True),  # F/NAV has no health of E1
        (517, 0b000000000, -1.0, False),  # no accuracy is predicted
    ],
)
def test_the_health_of_the_signal_that_is_used(tmp_path, source, health, accuracy, good):
    def changed(name, rows):
        if name != "E07":
            return rows
        rows = with_field(with_field(rows, 5, 1, source), 6, 1, health)
        return with_field(rows, 6, 0, accuracy)

    found = written_galileo(tmp_path, changed)
    assert (found.nearest("E07", TOE) >= 0) == good
    assert found.nearest("E08", TOE) >= 0
    assert found.nearest("E08", TOE + 14_300.0) >= 0  # four hours
    assert found.nearest("E08", TOE + 14_500.0) == -1


def test_e1_is_on_the_carrier_of_l1(tmp_path):
    """The ionospheric delay equals the delay at L1, and Doppler is in cycles of L1."""
    b = above(galileo(), LONG[[0, -1]])
    nav, obs = Navigation(Path("nav.rnx"), b, KLOBUCHAR), observed(b, LONG, DRIFTING)
    np.testing.assert_allclose(positioning.prepare(obs, nav).fixes[:, 3:6], 0.0, atol=1e-4)
    text = observations(b, TIMES)[0]
    for code in ("C1X D1X", "C1B D1B"):
        found = read_observations(
            written(tmp_path, text.replace("E    2 C1C D1C", f"E    2 {code}", 1))
        )
        assert {name[0] for name in found.names} == {"E"}
    assert L1_HZ == 1575.42e6


REAL = Path(__file__).parents[3] / "shared" / "data" / "gnss"


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_real_orbits_of_galileo_are_continuous():
    """Consecutive sets differ by less than a meter and a nanosecond half-way between them."""
    found = read_navigation(next(REAL.glob("*_EN.rnx.gz")))
    sets, apart, clocks = found.sets, [], []
    for number in np.unique(sets.number):
        rows = np.flatnonzero(sets.number == number)
        rows = rows[np.unique(sets.toe[rows], return_index=True)[1]]
        near = np.flatnonzero(np.diff(sets.toe[rows]) <= 1800.0)
        middle = 0.5 * (sets.toe[rows][near] + sets.toe[rows][near + 1])
        before, after = (satellites(sets.chosen(rows[near + j]), middle) for j in (0, 1))
        apart += np.linalg.norm(after.position - before.position, axis=-1).tolist()
        clocks += np.abs(after.clock - before.clock).tolist()
    assert len(apart) > 500
    assert np.median(apart) < 0.3
    assert np.median(clocks) < 1e-9
