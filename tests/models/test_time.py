"""Instants: published values, leap seconds, and invalid arguments."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest

from celnav.models.ephemeris import Tdb, from_tt, from_utc


def test_utc_is_tdb_less_leap_seconds():
    start = from_utc("2015-10-17T04:00:00")
    assert start.since(Tdb(2457312.5, 4.0 / 24.0)) == pytest.approx(
        68.184, abs=2e-3
    )  # 36 + 32.184 s, TDB - TT below 2 ms
    for text, leap in (
        ("2016-12-31T12:00:00", 36.0),
        ("2017-01-01T12:00:00", 37.0),
        ("1999-06-01T00:00:00", 32.0),
    ):
        instant, day = from_utc(text), np.datetime64(text)
        julian = 2440587.5 + (day - np.datetime64("1970-01-01T00:00:00")) / np.timedelta64(1, "D")
        assert instant.since(Tdb(julian, 0.0)) == pytest.approx(leap + 32.184, abs=2e-3)


def test_tdb_swings_about_tt_once_a_year():
    days = np.arange(0.0, 365.25, 1.0)
    apart = from_tt(2457023.5, days).since(Tdb(2457023.5, days))
    assert np.abs(apart).max() == pytest.approx(1.67e-3, abs=5e-5)
    # At perihelion (about January 3) and aphelion the mean anomaly, and with it the difference, is
    # zero.
    assert abs(apart[3]) < 1e-4
    assert apart[93] > 1.6e-3


def test_a_leap_second_is_a_second():
    before, leap, after = (
        from_utc(t) for t in ("2016-12-31T23:59:59", "2016-12-31T23:59:60", "2017-01-01T00:00:00")
    )
    assert leap.since(before) == pytest.approx(1.0, abs=1e-6)
    assert after.since(before) == pytest.approx(2.0, abs=1e-6)


def test_two_parts_keep_microseconds_of_a_century():
    start = from_utc("1975-01-01")
    for seconds in (1e-6, 2.3e9 + 1e-6):
        assert start.after(seconds).since(start) == pytest.approx(seconds, abs=1e-6)


def test_a_datetime_must_know_its_zone():
    instant = datetime(2015, 10, 17, 4, 0, 0, tzinfo=UTC)
    assert from_utc(instant) == from_utc("2015-10-17T04:00:00")
    assert from_utc(
        datetime(2015, 10, 17, 6, 0, 0, tzinfo=timezone(timedelta(hours=2)))
    ) == from_utc(instant)
    with pytest.raises(ValueError, match=r"^instant: expected a datetime with a time zone"):
        from_utc(datetime(2015, 10, 17, 4, 0, 0))


@pytest.mark.parametrize(
    "text",
    [
        "yesterday",
        "2015-13-01",
        "2015-02-30",
        "2015-10-17T25:00:00",
        "2015-10-17T04:00:60",
        "17.10.2015",
        "",
    ],
)
def test_what_is_no_date_is_refused(text):
    with pytest.raises(ValueError, match=r"^instant: expected"):
        from_utc(text)


def test_beyond_the_table_of_leap_seconds_is_a_warning():
    with pytest.warns(UserWarning, match="dubious year"):
        from_utc("2060-01-01")
