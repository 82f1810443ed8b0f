"""Pulsars: published accuracies, the delay against exact geometry, and its derivative."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from celnav.models.pulsar import GM_SUN, KPC_KM, LIGHT_KM_S, Timing, known, pulsars

NAMES = ("B0531+21", "B1821-24", "B1937+21")
AU = 149597870.7


def places(*shape):
    rng = np.random.default_rng(7)
    return AU * rng.normal(size=(*shape, 3)), 0.01 * AU * rng.normal(size=(*shape, 3))


def test_timing_accuracy_is_as_published():
    std = [p.timing_std(500.0) * LIGHT_KM_S * 1e3 for p in pulsars(NAMES)]
    np.testing.assert_allclose(std, [109.0, 326.0, 345.0], atol=1.0)
    np.testing.assert_allclose(
        [p.timing_std(300.0) * LIGHT_KM_S * 1e3 for p in pulsars(NAMES)],
        [140.7, 420.6, 444.8],
        atol=0.5,
    )


def test_accuracy_grows_with_time_and_area():
    crab = known()["B0531+21"]
    assert crab.timing_std(1200.0) == pytest.approx(0.5 * crab.timing_std(300.0))
    assert crab.timing_std(300.0, area_cm2=4e4) == pytest.approx(0.5 * crab.timing_std(300.0))
    assert crab.timing_std(300.0, background=0.0) < crab.timing_std(300.0)


def test_the_delay_is_the_difference_of_distances():
    """Roemer and parallax terms against exact geometry, with a pulsar near enough to show the
    second order.
    """
    (crab,) = pulsars(NAMES[:1])
    near = replace(crab, distance_kpc=1e4 * AU / KPC_KM)
    timing = Timing([near])
    r, sun = places(20)
    source = near.distance_km * near.direction + sun  # distance from the Sun
    exact = np.linalg.norm(source, axis=-1) - np.linalg.norm(source - r, axis=-1)
    geometric = timing.delay(r, sun)[:, 0] - timing.shapiro(r, sun)[:, 0]
    # The remaining error is of third order, r (r / D)^2.
    assert np.abs(geometric - exact).max() < 10.0 * AU * 1e-8
    assert np.abs(r @ near.direction - exact).max() > 1e3 * np.abs(geometric - exact).max()


def test_shapiro_terms_agree_where_the_sun_is_far():
    timing = Timing(pulsars(NAMES))
    r, sun = places(50)
    np.testing.assert_allclose(
        timing.shapiro(r, 0.0 * sun + 1e-3), timing.shapiro_exact(r, 0.0 * sun + 1e-3), rtol=1e-6
    )
    assert np.abs(timing.shapiro(r, sun) - timing.shapiro_exact(r, sun)).max() > 1e-3
    assert pytest.approx(2.953, abs=1e-3) == 2.0 * GM_SUN / LIGHT_KM_S**2  # km


def test_the_gradient_is_the_difference():
    timing = Timing(pulsars(NAMES))
    r, sun = places(3, 4)
    steps = 1e3 * np.eye(3)
    differences = np.stack(
        [(timing.delay(r + s, sun) - timing.delay(r - s, sun)) / 2e3 for s in steps], -1
    )
    np.testing.assert_allclose(timing.gradient(r, sun), differences, atol=1e-10)
    assert timing.gradient(r, sun).shape == (3, 4, 3, 3)
    assert np.abs(np.linalg.norm(timing.gradient(r, sun), axis=-1) - 1.0).max() < 1e-6


def test_the_pulsars_span_space_badly():
    assert np.linalg.cond(Timing(pulsars(NAMES)).directions) == pytest.approx(11.3, abs=0.05)


def test_pulses_that_nobody_counted_are_folded_into_half_a_period():
    timing = Timing(pulsars(NAMES))
    here, sun = np.array([1.4e8, 5e7, 2e7]), np.array([5e5, 1e5, 0.0])
    there = here + np.array([30.0, -20.0, 10.0])
    periods = LIGHT_KM_S * np.array([p.period_s for p in timing.pulsars])
    measured = timing.delay(there, sun) + periods * np.array([3.0, -2.0, 170.0])
    plain = timing.delay(there, sun) - timing.delay(here, sun)
    np.testing.assert_allclose(
        timing.uncounted.minus(measured, timing.delay(here, sun)), plain, atol=1e-6
    )
    far = timing.uncounted.minus(
        np.array([0.0, 0.0, 0.6 * periods[2]]), np.zeros(3)
    )  # beyond this another pulse is identified
    np.testing.assert_allclose(far, [0.0, 0.0, -0.4 * periods[2]], atol=1e-9)


def test_bad_pulsars_are_refused_by_name():
    crab = known()["B0531+21"]
    for change, name in (
        ({"distance_kpc": 0.0}, "distance_kpc"),
        ({"flux": -1.0}, "flux"),
        ({"pulsed_fraction": 1.5}, "pulsed_fraction"),
        ({"declination_deg": 91.0}, "declination_deg"),
        ({"period_s": np.nan}, "period_s"),
    ):
        with pytest.raises(ValueError, match=f"^{name}: expected .* B0531"):
            replace(crab, **change)
    with pytest.raises(
        ValueError, match=r"^pulsar: expected one of B0531\+21, B1821-24, B1937\+21, .*, got 'Vela'"
    ):
        pulsars(["Vela"])
    with pytest.raises(ValueError, match=r"^pulsars: expected directions that span space"):
        Timing([crab, crab, known()["B1821-24"]])
    for arguments, name in (
        ((0.0,), "seconds"),
        ((300.0, -1.0), "area_cm2"),
        ((300.0, 1e4, -1.0), "background"),
    ):
        with pytest.raises(ValueError, match=f"^{name}: expected"):
            crab.timing_std(*arguments)
