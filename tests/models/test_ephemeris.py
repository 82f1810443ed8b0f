"""Ephemerides: DE421 against the older arrays and against facts, and files that are not what they should be."""

from __future__ import annotations

from datetime import datetime
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from celnav.models import time as time_module
from celnav.models.ephemeris import BODIES, GM, Arrays, Kernel, de421
from celnav.models.time import Tdb, from_utc

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
        np.testing.assert_allclose((b.position - a.position) / 60.0, middle.velocity, rtol=1e-6, atol=1e-7, err_msg=body)


def test_the_barycenter_of_earth_and_moon_is_between_them():
    ratio = GM["earth"] / GM["moon"]
    assert ratio == pytest.approx(81.3005690699153, rel=1e-9)
    earth, moon = (de421().state(body, START).position for body in ("earth", "moon"))
    assert 3.5e5 < np.linalg.norm(earth - moon) < 4.1e5


def test_batches_are_singles():
    many = de421().state("moon", START.after(np.arange(6.0).reshape(2, 3) * 1e5))
    assert many.position.shape == (2, 3, 3)
    np.testing.assert_array_equal(many.position[1, 2], de421().state("moon", START.after(5e5)).position)


def test_a_date_outside_is_refused_with_the_range():
    for date in (Tdb(2400000.5, 0.0), Tdb(2600000.5, 0.0), Tdb(np.nan, 0.0)):
        with pytest.raises(ValueError, match=r"^date: expected JD TDB between 2414864.5 and 2471184.5, which .*de421.bsp covers"):
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


# -- arrays of Chebyshev coefficients, made here ----------------------------------------------------------------------------
def made(folder, **left_out):
    """A small ephemeris of polynomials: 4 sets of 8 days."""
    values = {"jalpha": 2457300.5, "jomega": 2457332.5, "EMRAT": 81.3, "AU": AU, "GMS": 3e-4, "GMB": 9e-10}
    values |= {f"GM{i}": 1e-10 for i in (1, 2, 4, 5, 6, 7, 8, 9)}
    rows = [(name.encode(), value) for name, value in values.items() if name not in left_out]
    np.save(folder / "constants.npy", np.array(rows, dtype=[("name", "S6"), ("value", "f8")]))
    rng = np.random.default_rng(0)
    for body in ("sun", "earthmoon", "moon"):
        if body not in left_out:
            np.save(folder / f"jpl-{body}.npy", rng.normal(size=(4, 3, 6)) * 1e6)
    return folder


def test_arrays_are_chebyshev_series_on_equal_spans(tmp_path):
    arrays = Arrays(made(tmp_path))
    date = Tdb(2457312.5, np.array([0.25, 3.9999, 4.0001]))
    coefficients = np.load(tmp_path / "jpl-sun.npy")
    for i, k, u in ((0, 1, 2 * 4.25 / 8 - 1), (2, 2, 2 * 0.0001 / 8 - 1)):
        expected = [np.polynomial.chebyshev.Chebyshev(c)(u) for c in coefficients[k]]
        np.testing.assert_allclose(arrays.state("sun", date).position[i], expected, rtol=1e-9)
    a, b = (arrays.state("sun", Tdb(2457312.5, 0.25 + s / 86400.0)).position for s in (-1.0, 1.0))
    np.testing.assert_allclose((b - a) / 2.0, arrays.state("sun", date).velocity[0], rtol=1e-6, atol=1e-6)
    end = arrays.state("sun", Tdb(2457332.5, 0.0)).position
    np.testing.assert_allclose(end, coefficients[3].sum(-1), rtol=1e-12)


def test_the_earth_comes_from_the_barycenter(tmp_path):
    arrays = Arrays(made(tmp_path))
    date = Tdb(2457310.5, 0.1)
    earth, moon = arrays.state("earth", date), arrays.state("moon", date)
    together = arrays._series("earthmoon", date).position
    np.testing.assert_allclose((81.3 * earth.position + moon.position) / 82.3, together, rtol=1e-12)
    assert arrays.gm["earth"] / arrays.gm["moon"] == pytest.approx(81.3)


def test_arrays_that_are_not_whole_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"constants.npy: no such file; the folder has nothing"):
        Arrays(tmp_path)
    with pytest.raises(ValueError, match=r"expected constants EMRAT"):
        Arrays(made(tmp_path, EMRAT=True))
    arrays = Arrays(made(tmp_path))
    (tmp_path / "jpl-sun.npy").write_bytes((tmp_path / "jpl-sun.npy").read_bytes()[:300])
    with pytest.raises(ValueError, match=r"jpl-sun.npy: expected an array of numbers"):
        arrays.state("sun", Tdb(2457310.5, 0.0))
    with pytest.raises(ValueError, match=r"jpl-mars.npy: no such file; the folder has earthmoon, moon, sun"):
        arrays.state("mars", Tdb(2457310.5, 0.0))
    with pytest.raises(ValueError, match=r"^date: expected JD TDB between 2457300.5 and 2457332.5"):
        arrays.state("moon", Tdb(2457333.5, 0.0))


def test_an_array_of_objects_is_not_run(tmp_path):
    made(tmp_path)
    np.save(tmp_path / "jpl-sun.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match=r"jpl-sun.npy: expected an array of numbers"):
        Arrays(tmp_path).state("sun", Tdb(2457310.5, 0.0))


def test_nothing_asks_what_day_it_is(monkeypatch):
    class Later(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime(2031, 11, 21, tzinfo=tz)

    monkeypatch.setattr(time_module, "datetime", Later)
    assert from_utc("2015-10-17T04:00:00") == START
