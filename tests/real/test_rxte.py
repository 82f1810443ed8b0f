"""Photons of a pulsar: files, folding and positions, on simulated photons with known truth and on
real photons.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
from pathlib import Path

import erfa
import numpy as np
import pytest

from celnav.files import InputError
from celnav.models.ephemeris import DAY_S, de421, from_tt
from celnav.models.orbit import from_elements, step
from celnav.models.pulsar import LIGHT_KM_S, Timing
from celnav.real import photons, rxte
from celnav.show.drawing import render

fits = pytest.importorskip("astropy.io.fits")
REAL = Path(__file__).parents[3] / "shared" / "data" / "rxte"
PAR = "PSRJ J1513-5908\nRAJ 15:13:55.62\nDECJ -59:08:09.0\nF0 6.5972528555 2.1e-16\nF1 -6.65354963e-11\nPEPOCH 55308\nUNITS TDB\n"
DAY, START = 49353, 537721716.0


def written(path, name, columns, zero=0.0):
    """A FITS file in the format of the instrument's programs."""
    table = fits.BinTableHDU.from_columns(
        [fits.Column(n, form, array=a) for n, form, a in columns], name=name
    )
    table.header.update(MJDREFI=DAY, MJDREFF=0.000696574074, TIMEZERO=zero, TIMESYS="TT")
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(path, overwrite=True)


def made(folder, seed=0, rate=12.0, seconds=2400.0, fraction=0.6):
    """Photons of a pulse ``1 + fraction cos``, detected in a low orbit."""
    folder.mkdir(exist_ok=True)
    (folder / "model.par").write_text(PAR)
    rng = np.random.default_rng(seed)
    x, orbit = from_elements(6878.0, 0.001, *np.radians([23.0, 40.0, 10.0, 80.0])), []
    for _ in range(60):
        orbit.append(x)
        x = step(x, 60.0)
    at = START - 300.0 + 60.0 * np.arange(60)
    state = 1e3 * np.stack(orbit).T
    written(
        folder / "FPorbit_Day1",
        "XTE_PE",
        [(n, "D", a) for n, a in zip(("Time", "X", "Y", "Z", "Vx", "Vy", "Vz"), [at, *state])],
    )
    t = np.sort(START + seconds * rng.random(rng.poisson(2.0 * rate * seconds)))
    spin = photons.read_par(folder / "model.par")
    for _ in range(2):  # the second time with photons drawn from the pulse
        channels = rng.integers(5, 50, len(t))
        written(
            folder / "events.fits",
            "XTE_SE",
            [("TIME", "D", t - 3.378), ("PHA", "B", channels)],
            zero=3.378,
        )
        photons.read.cache_clear()
        light = 1.0 + fraction * np.cos(2.0 * np.pi * photons.read(folder).cycles(1.0))
        t = t[rng.random(len(t)) < 0.5 * light] if _ == 0 else t
    assert spin.rates[0] == 6.5972528555
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return made(tmp_path_factory.mktemp("photons") / "made")


# -- times -----------------------------------------------------------------------------------------
def test_a_time_at_the_barycenter_is_that_of_the_printed_formula(folder):
    """For one photon: the Einstein term from ERFA, the Roemer and Shapiro terms by hand."""
    p = photons.read(folder)
    tt = (
        DAY
        + 0.000696574074
        + (START + p.t[100] + (fits.getdata(folder / "events.fits", 1)["TIME"][0] + 3.378 - START))
        / DAY_S
    )
    tdb = tt + erfa.dtdb(2400000.5, tt, 0.0, 0.0, 0.0, 0.0) / DAY_S
    date = from_tt(2400000.5, tt)
    earth, sun = (de421().state(body, date).position for body in ("earth", "sun"))
    n, r = p.spin.pulsar.direction, earth + p.place[100]
    shapiro = (
        2.0
        * 1.32712440041e11
        / LIGHT_KM_S**3
        * np.log((n @ r + np.linalg.norm(r)) / (n @ -sun + np.linalg.norm(sun)) + 1.0)
    )
    t = (tdb - 55308.0) * DAY_S + n @ r / LIGHT_KM_S + shapiro
    cycles = 6.5972528555 * t - 0.5 * 6.65354963e-11 * t**2
    assert p.cycles(1.0)[100] == pytest.approx(cycles, abs=1e-4)  # one double of a date has 6e-7 s
    assert Timing([p.spin.pulsar]).delay(r, sun)[0] / LIGHT_KM_S == pytest.approx(
        n @ r / LIGHT_KM_S + shapiro, abs=1e-6
    )


def test_a_place_between_rows_is_that_of_the_orbit(folder):
    p = photons.read(folder)
    x = from_elements(6878.0, 0.001, *np.radians([23.0, 40.0, 10.0, 80.0]))
    for k in (10, 5000, len(p.t) - 1):
        t = p.t[k] + fits.getdata(folder / "events.fits", 1)["TIME"][0] + 3.378 - (START - 300.0)
        y = x
        for _ in range(int(t // 60.0)):
            y = step(y, 60.0)
        np.testing.assert_allclose(p.place[k], step(y, t % 60.0)[:3], atol=0.02)


# -- folding ---------------------------------------------------------------------------------------
def test_the_h_test_is_that_of_its_definition():
    rng = np.random.default_rng(1)
    phase = rng.random(500)
    z = [
        2.0 / 500 * sum(np.abs(np.exp(2j * np.pi * k * phase).sum()) ** 2 for k in range(1, m + 1))
        for m in range(1, 21)
    ]
    expected = max(value - 4.0 * m + 4.0 for m, value in enumerate(z, 1))
    assert rxte.h_test(rxte.harmonics(phase, np.arange(500) % 7)) == pytest.approx(expected)


def test_without_a_pulse_the_h_test_has_its_known_law():
    """P(H > h) = exp(-0.4 h) [de Jager & Buesching 2010]."""
    rng = np.random.default_rng(2)
    h = np.array(
        [rxte.h_test(rxte.harmonics(rng.random(400), np.zeros(400, int))) for _ in range(1500)]
    )
    for level in (2.0, 5.0, 8.0):
        expected = np.exp(-0.4 * level)
        assert (h > level).mean() == pytest.approx(
            expected, abs=4.0 * np.sqrt(expected / 1500) + 0.02
        )


def test_a_light_curve_has_the_information_of_its_formula():
    """For 1 + a cos: (2 pi)^2 (1 - sqrt(1 - a^2))."""
    light = rxte.Light(np.array([0.3 + 0.0j]), 1.0)
    assert light.information == pytest.approx((2.0 * np.pi) ** 2 * (1.0 - np.sqrt(1.0 - 0.36)))
    phase = np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(light(phase), 1.0 + 0.6 * np.cos(2.0 * np.pi * phase))


def test_shifts_are_found_and_err_by_what_they_claim():
    """Shifts of four sizes, each in a quarter of the runs; a wrapped shift would appear as a large
    error.
    """
    rng, light = np.random.default_rng(3), rxte.Light(np.array([0.3, 0.1j, 0.05]), 1.0)
    errors, inside, count, often = [], [], 600, 400
    for k in range(often):
        true = (-0.31, 0.0, 0.2, 0.49)[k % 4]
        phase = rng.random(8 * count)
        phase = phase[rng.random(len(phase)) < light(phase) / 2.5][:count]
        assert len(phase) == count
        shift, logs = rxte.shifted(light, phase - true)
        errors.append((shift - true + 0.5) % 1.0 - 0.5)
        inside.append(-2.0 * np.interp(true, rxte.SHIFTS, logs) < 3.84)
    claimed = 1.0 / np.sqrt(count * light.information)
    # Four standard deviations for this number of photons.
    rms = np.sqrt(np.mean(np.square(errors)))
    assert rms == pytest.approx(claimed, rel=4.0 / np.sqrt(2.0 * often))
    assert np.mean(inside) == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / often))


# -- the study -------------------------------------------------------------------------------------
def test_places_of_made_photons_err_by_what_they_claim(tmp_path):
    errors = []
    for seed in range(3):
        photons.read.cache_clear()
        out = rxte.placed(made(tmp_path / str(seed), seed=seed), [])
        errors.append((out["place"] - out["truth"]) / out["std"])
        assert np.abs(out["truth"]).max() > 2000.0
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.25)


def test_the_whole_study_on_made_photons(folder):
    photons.read.cache_clear()
    results = rxte.STUDY.reproduce(rxte=folder)
    verdicts = {claim.id: claim.verdict for claim in results.claims()}
    assert verdicts["rxte-sharper"] == verdicts["rxte-scale"] == verdicts["rxte-place"] == "shown"
    for _, draw in rxte.FIGURES.values():
        assert render(draw(results), "png")[:4] == b"\x89PNG"
    assert len(rxte.TABLES["table_1"][1](results)) == 19
    assert rxte.parts() == {}


# -- damaged files ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("PEPOCH 55308\n", "", "expected a timing model with PEPOCH"),
        ("F0 6.5972528555", "F0 fast", "expected a number as F0, got 'fast'"),
        ("F0 6.5972528555", "F0 nan", "expected a number as F0"),
        ("F0 6.5972528555", "F0 -1", "expected F0 in pulses per second"),
        ("15:13:55.62", "15h", "expected RAJ as 15:13:55.62, got '15h'"),
        ("-59:08:09.0", "-99:08:09.0", "declination_deg"),
        ("UNITS TDB", "UNITS TCB", "expected UNITS TDB, got TCB"),
        ("UNITS TDB", "BINARY ELL1", "expected a pulsar without a companion"),
    ],
)
def test_a_timing_model_that_cannot_be_is_named(tmp_path, old, new, message):
    path = tmp_path / "model.par"
    path.write_text(PAR.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        photons.read_par(path)
    assert str(path) in str(caught.value)


def test_a_model_in_tempos_own_words_is_read(tmp_path):
    (tmp_path / "a.par").write_text(
        PAR.replace("6.5972528555", "0.65972528555D+01").replace("-59:08", "+59:08")
    )
    spin = photons.read_par(tmp_path / "a.par")
    assert spin.rates[0] == pytest.approx(6.5972528555)
    assert spin.pulsar.declination_deg == pytest.approx(59.0 + 8.0 / 60.0 + 9.0 / 3600.0)


def test_an_orbit_of_another_day_and_too_few_photons_are_refused(folder, tmp_path):
    place = shutil.copytree(folder, tmp_path / "other")
    t = fits.getdata(folder / "events.fits", 1)["TIME"]
    cases = [
        (t + 1e5, "expected the orbit from"),
        (t[:50], "expected at least 1000 photons"),
        (t[::-1], "do not decrease in TIME"),
    ]
    for times, message in [
        *cases,
        (np.where(np.arange(len(t)) == 7, np.nan, t), r"expected finite numbers \(N,\) in TIME"),
    ]:
        written(
            place / "events.fits",
            "XTE_SE",
            [("TIME", "D", times), ("PHA", "B", np.full(len(times), 9))],
        )
        photons.read.cache_clear()
        with pytest.raises(InputError, match=message):
            photons.read(place)


def test_damaged_tables_are_named(folder, tmp_path):
    place = shutil.copytree(folder, tmp_path / "broken")
    path, rng = place / "events.fits", np.random.default_rng(4)
    whole = path.read_bytes()
    refused = 0
    for trial in range(60):
        broken = bytearray(whole[: rng.integers(1, len(whole))] if trial % 3 == 0 else whole)
        for at in rng.integers(0, min(len(broken), 9000), 1 + 15 * (trial % 3)):
            broken[at] = rng.integers(256)
        path.write_bytes(bytes(broken))
        photons.read.cache_clear()
        try:
            photons.read(place)
        except InputError as error:
            refused += str(place) in str(error)
    assert refused > 30
    path.write_bytes(b"")
    photons.read.cache_clear()
    with pytest.raises(InputError, match=r"expected a FITS file with a table XTE_SE of TIME, PHA"):
        photons.read(place)
    path.unlink()
    with pytest.raises(FileNotFoundError, match=r"expected a folder with a file \*\.fits\*"):
        photons.read(place)


def test_what_is_missing_is_said_with_a_command(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "astropy.io", None)
    with (
        pytest.raises(
            ImportError, match=r'\.venv/bin/pip install -c constraints\.txt -e "\.\[real\]"'
        ),
        contextlib.nullcontext(),
    ):
        photons.table(folder / "events.fits", "XTE_SE", ("TIME",))


# -- the real ones ---------------------------------------------------------------------------------
@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_the_satellite_by_real_photons():
    photons.read.cache_clear()
    folds = rxte.folded(REAL, [])
    assert [round(rxte.h_test(folds[place])) for place in rxte.PLACES] == [46, 648, 728]
    out = rxte.placed(REAL, [])
    assert len(out["place"]) == 29
    assert np.sqrt(np.mean(np.square(out["place"] - out["truth"]))) < 1500.0
    assert 0.7 < np.sqrt(np.mean(np.square((out["place"] - out["truth"]) / out["std"]))) < 1.3
