"""Ephemerides: DE421 against known values, invalid files, and the older ephemerides of the data."""

from __future__ import annotations

import runpy
from datetime import datetime
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from celnav.files import data
from celnav.models import ephemeris as module
from celnav.models.ephemeris import BODIES, GM, Kernel, Tdb, de421, from_utc

START = from_utc("2015-10-17T04:00:00")
BSP = Path(str(files("skyfield_data") / "data" / "de421.bsp"))
AU = 149597870.700


def test_the_earth_is_where_it_is():
    year = START.after(np.arange(0.0, 366.0) * 86400.0)
    earth, sun = de421().state("earth", year), de421().state("sun", year)
    distance = np.linalg.norm(earth.position - sun.position, axis=-1)
    assert distance.min() == pytest.approx(0.98330 * AU, rel=2e-5)  # perihelion, 2016-01-02 at 23 h
    assert distance.max() == pytest.approx(1.01675 * AU, rel=2e-5)
    assert int(np.argmin(distance)) == 78
    assert np.linalg.norm(earth.velocity, axis=-1) == pytest.approx(29.78, rel=0.02)


def test_velocities_are_rates_of_positions():
    for body in BODIES:
        a, b, middle = (de421().state(body, START.after(s)) for s in (-30.0, 30.0, 0.0))
        np.testing.assert_allclose(
            (b.position - a.position) / 60.0, middle.velocity, rtol=1e-6, atol=1e-7, err_msg=body
        )


def test_the_barycenter_of_earth_and_moon_is_between_them():
    ratio = GM["earth"] / GM["moon"]
    assert ratio == pytest.approx(81.3005690699153, rel=1e-9)
    earth, moon = (de421().state(body, START).position for body in ("earth", "moon"))
    assert 3.5e5 < np.linalg.norm(earth - moon) < 4.1e5


def test_batches_are_singles():
    many = de421().state("moon", START.after(np.arange(6.0).reshape(2, 3) * 1e5))
    assert many.position.shape == (2, 3, 3)
    np.testing.assert_array_equal(
        many.position[1, 2], de421().state("moon", START.after(5e5)).position
    )


def test_a_date_outside_is_refused_with_the_range():
    for date in (Tdb(2400000.5, 0.0), Tdb(2600000.5, 0.0), Tdb(np.nan, 0.0)):
        with pytest.raises(
            ValueError,
            match=r"^date: expected JD TDB between 2414864.5 and 2471184.5, which .*de421.bsp covers",
        ):
            de421().state("earth", date)
    with pytest.raises(ValueError, match=r"^body: expected one of sun, .*got 'vulcan'"):
        de421().state("vulcan", START)


@pytest.mark.parametrize("cut", [0, 100, 5000, 1_000_000])
def test_a_file_that_is_cut_off_is_refused(tmp_path, cut):
    path = tmp_path / "short.bsp"
    path.write_bytes(BSP.read_bytes()[:cut])
    with pytest.raises(ValueError, match=r"short.bsp: expected"):
        Kernel(path)


@pytest.mark.parametrize("content", [b"DAF/XYZ " + bytes(2000), b"hello\n" * 1000, bytes(4096)])
def test_another_file_is_refused(tmp_path, content):
    path = tmp_path / "other.bsp"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"other.bsp: expected a binary SPK ephemeris"):
        Kernel(path)


def test_a_missing_file_is_an_error_of_the_system(tmp_path):
    with pytest.raises(OSError, match=r"none\.bsp"):
        Kernel(tmp_path / "none.bsp")


# -- the older ephemerides, arrays of Chebyshev coefficients, from which the data was made ---------
@pytest.fixture
def older(tmp_path):
    """A small ephemeris of polynomials, 4 sets of 8 days, and positions from it."""
    values = {"jalpha": 2457300.5, "jomega": 2457332.5, "EMRAT": 81.3}
    rows = [(name.encode(), value) for name, value in values.items()]
    np.save(tmp_path / "constants.npy", np.array(rows, dtype=[("name", "S6"), ("value", "f8")]))
    rng = np.random.default_rng(0)
    coefficients = {
        body: rng.normal(size=(4, 3, 6)) * 1e6 for body in ("sun", "earthmoon", "moon", "mars")
    }
    for body, values in coefficients.items():
        np.save(tmp_path / f"jpl-{body}.npy", values)
    position = runpy.run_path(str(data("make_ephemeris.py")))["position"]
    return coefficients, lambda body, rest: position(
        tmp_path, body, Tdb(2457312.5, np.asarray(rest))
    )


def test_arrays_are_chebyshev_series_on_equal_spans(older):
    coefficients, position = older
    found = position("sun", [0.25, 3.9999, 4.0001])
    for i, k, u in ((0, 1, 2 * 4.25 / 8 - 1), (2, 2, 2 * 0.0001 / 8 - 1)):
        expected = [np.polynomial.chebyshev.Chebyshev(c)(u) for c in coefficients["sun"][k]]
        np.testing.assert_allclose(found[i], expected, rtol=1e-9)
    for body in ("sun", "mars"):
        np.testing.assert_allclose(position(body, 20.0), coefficients[body][3].sum(-1), rtol=1e-12)


def test_the_earth_comes_from_the_barycenter(older):
    coefficients, position = older
    together = [
        np.polynomial.chebyshev.Chebyshev(c)(2 * 4.1 / 8 - 1) for c in coefficients["earthmoon"][1]
    ]
    np.testing.assert_allclose(
        (81.3 * position("earth", 0.1) + position("moon", 0.1)) / 82.3, together, rtol=1e-9
    )


def test_nothing_asks_what_day_it_is(monkeypatch):
    class Later(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime(2031, 11, 21, tzinfo=tz)

    monkeypatch.setattr(module, "datetime", Later)
    assert from_utc("2015-10-17T04:00:00") == START
