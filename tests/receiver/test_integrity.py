"""Satellites that contradict the others are excluded, and noise is estimated from residuals."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rinex_pair import (
    ALPHA,
    BETA,
    PLACE,
    TOE,
    above,
    constellation,
    galileo,
    gps,
    joined,
    modeled_errors,
    observed,
)

from celnav.files import InputError
from celnav.models import pseudorange
from celnav.models.gnss import B1I_HZ, L1_HZ, LIGHT
from celnav.receiver import position as positioning
from celnav.receiver import report as positioning_report
from celnav.receiver.fixes import Seen, estimated
from celnav.receiver.geodesy import ELLIPSOID, ecef2geodetic
from celnav.receiver.rinex import Navigation
from celnav.receiver.sky import klobuchar

NOISE = 0.5


@pytest.fixture(scope="module")
def noisy():
    """A log of 40 epochs with noise, and its broadcast sets."""
    times = TOE + 1800.0 + 30.0 * np.arange(40)
    b = above(constellation(), times[[0, -1]])
    log = observed(b, times, 3e4 + 30.0 * (times - times[0]))
    rng = np.random.default_rng(5)
    code, doppler = (
        log.code + NOISE * rng.normal(size=log.code.shape),
        log.doppler + 0.1 * rng.normal(size=log.doppler.shape),
    )
    return Navigation(Path("nav.rnx"), b, (np.array(ALPHA), np.array(BETA))), replace(
        log, code=code, doppler=doppler
    )


def off(found, filter):
    return np.linalg.norm(
        positioning_report.position(found, filter, None).mean[:, :3] - PLACE, axis=-1
    )


def high(nav, obs, count):
    """The satellites that are visible all the time, the highest first."""
    log = positioning.prepare(obs, nav)
    there = np.flatnonzero(log.used.all(0))
    return there[np.argsort(-log.elevation[0, there])][:count]


@pytest.mark.parametrize("error", [1e5, -3e3, 60.0])
def test_a_faulty_satellite_is_excluded_for_every_filter(noisy, error):
    nav, obs = noisy
    code = obs.code.copy()
    (s,) = high(nav, obs, 1)
    code[:, s] += error
    found = positioning.prepare(replace(obs, code=code), nav)
    S = len(found.names)
    assert found.excluded[:, s].all()
    assert found.excluded[:, :S].sum() == 40
    assert np.isnan(found.z[:, [s, S + s]]).all()
    for filter in ("ls", "ekf", "aukf", "group", "huber", "sage-husa"):
        assert off(found, filter).max() < 8.0, filter
    lines = positioning_report.summary(positioning_report.position(found, "ls", None))
    assert f"ranges excluded at 40 epochs ({found.names[s]} 40)" in lines
    rows = list(
        csv.DictReader(
            positioning_report.table(positioning_report.position(found, "ls", None)).splitlines()
        )
    )
    assert {row["integrity"] for row in rows} == {"excluded"}
    assert {row["excluded"] for row in rows} == {found.names[s]}


def test_without_the_test_a_faulty_satellite_is_believed(noisy):
    nav, obs = noisy
    code = obs.code.copy()
    code[:, high(nav, obs, 1)] += 1e4
    found = positioning.prepare(replace(obs, code=code), nav, sigma=(1.5, 0.05), false_alarm=0.0)
    assert not found.excluded.any()
    assert off(found, "ls").min() > 1e3
    assert "not tested" in positioning_report.summary(
        positioning_report.position(found, "ls", None)
    )


@pytest.mark.parametrize("chance", [1.0, -1e-9, np.nan, np.inf])
def test_a_false_alarm_that_is_no_probability_is_refused(noisy, chance):
    nav, obs = noisy
    told = rf"^false_alarm: expected a probability from 0 to below 1, got {chance!r}$"
    with pytest.raises(ValueError, match=told):
        positioning.prepare(obs, nav, false_alarm=chance)


def test_several_faulty_satellites_are_excluded(noisy):
    nav, obs = noisy
    code, some = obs.code.copy(), high(nav, obs, 3)
    code[:, some] += [1e5, -4e4, 500.0]
    found = positioning.prepare(replace(obs, code=code), nav)
    assert found.excluded[:, some].all()
    assert off(found, "aukf").max() < 10.0


@pytest.mark.parametrize(
    ("part", "change"), [("M0", 1e-3), ("Omega0", -0.1), ("sqrt_a", 1.0), ("a0", 1e-4), ("e", 0.2)]
)
def test_a_wrong_broadcast_orbit_is_excluded(noisy, part, change):
    nav, obs = noisy
    (s,) = high(nav, obs, 1)
    values = getattr(nav.sets, part).copy()
    values[s] += change
    wrong = replace(nav.sets, **{part: values})
    found = positioning.prepare(obs, replace(nav, sets=wrong))
    # Excluded, or below the horizon according to this orbit; a range within 8 σ may pass the test.
    right, other = (pseudorange.sources(sets, obs.times, PLACE) for sets in (nav.sets, wrong))
    ranges = [np.linalg.norm(each.q - PLACE, axis=-1) - each.clock for each in (right, other)]
    used = found.used[:, s]
    assert (np.abs(ranges[1] - ranges[0])[used, s] < 8.0 * found.sigma[used, s]).all()
    assert used.mean() <= 0.1
    assert off(found, "ls").max() < 8.0
    assert off(found, "aukf").max() < 8.0


def test_a_faulty_rate_is_excluded_alone(noisy):
    nav, obs = noisy
    doppler, (s,) = obs.doppler.copy(), high(nav, obs, 1)
    doppler[7:9, s] += 300.0
    found = positioning.prepare(replace(obs, doppler=doppler), nav)
    S = len(found.names)
    np.testing.assert_array_equal(np.flatnonzero(found.excluded[:, S + s]), [7, 8])
    assert not found.excluded[:, :S].any()
    assert np.isfinite(found.z[7:9, s]).all()
    assert off(found, "ekf").max() < 8.0
    assert f"rates excluded at 2 epochs ({found.names[s]} 2)" in positioning_report.summary(
        positioning_report.position(found, "ls", None)
    )


@pytest.mark.parametrize(("left", "state"), [(5, "contradiction"), (4, "untested")])
def test_where_no_redundancy_is_left_it_is_said(noisy, left, state):
    """One of five is faulty: the fault is detected, but not located. With four
    nothing is detected.
    """
    nav, obs = noisy
    some = high(nav, obs, left)
    code = obs.code.copy()
    code[20] = np.nan
    code[20, some] = obs.code[20, some]
    code[20, some[0]] += 1e5 * (left == 5)
    found = positioning.prepare(replace(obs, code=code), nav)
    assert found.unusable[20, 0] == (left == 5)
    assert found.used[20].sum() == (0 if left == 5 else 4)
    result = positioning_report.position(found, "ekf", None)
    assert off(found, "ekf").max() < 50.0
    assert (
        list(csv.DictReader(positioning_report.table(result).splitlines()))[20]["integrity"]
        == state
    )
    words = (
        "ranges of 1 epochs and rates of 0 not used, as they contradict each other"
        if left == 5
        else "1 without redundancy, which nothing tests"
    )
    assert words in positioning_report.summary(result)


def test_an_epoch_that_is_dated_late_moves_nothing(noisy):
    nav, obs = noisy
    for late in (365.0 * 86400.0, 3600.0):
        times = obs.times.copy()
        times[-1] += late
        found = positioning.prepare(replace(obs, times=times), nav)
        for filter in ("ls", "ekf", "aukf"):
            result = positioning_report.position(found, filter, None)
            assert np.linalg.norm(result.place - PLACE) < 2.0
            assert result.measured.sum() == 39


def test_noise_is_estimated_from_residuals(noisy):
    nav, obs = noisy
    rng = np.random.default_rng(3)
    obs = replace(obs, code=obs.code + modeled_errors(positioning.prepare(obs, nav), rng))
    found = positioning.prepare(obs, nav)
    S, used = len(found.names), found.used
    assert found.noise[0].redundancy == used.sum() - 4 * 40
    size = np.sqrt(NOISE**2 + found.modeled[used].mean())
    assert np.sqrt(np.square(found.sigma[:, :S][used]).mean()) == pytest.approx(size, rel=0.1)
    assert np.sqrt(np.square(found.sigma[:, S:][used]).mean()) == pytest.approx(
        0.1 * LIGHT / B1I_HZ, rel=0.1
    )
    result = positioning_report.position(found, "ls", PLACE)
    error = result.mean[:, :3] - PLACE
    ratio = np.einsum("ti,tij,tj->t", error, np.linalg.pinv(result.cov), error).mean() / 3.0
    assert 0.6 < ratio < 1.5
    assert result.nis == pytest.approx(1.0, abs=0.1)
    lines = positioning_report.summary(result)
    assert f"NIS {result.nis:.3f}" in lines
    assert f"estimated from {found.noise[0].redundancy} redundant ones" in lines
    kept = positioning.prepare(noisy[1], nav, sigma=(1.5, 0.05))
    assert positioning_report.position(kept, "ls", PLACE).nis < 0.2
    assert "not estimated" in positioning_report.summary(
        positioning_report.position(kept, "ls", PLACE)
    )


def test_noise_that_grows_towards_the_horizon_is_told_from_noise_that_does_not(noisy):
    nav, obs = noisy
    b, times = nav.sets, obs.times[0] + 30.0 * np.arange(150)
    clean = observed(b, times, 3e4 + 30.0 * (times - times[0]))
    log = positioning.prepare(clean, nav, sigma=(1.5, 0.05))
    sky = np.nan_to_num(log.elevation, nan=1.0)
    size = np.hypot(0.6, 0.4 / np.sin(np.maximum(sky, 0.1)))
    z, S = log.z.copy(), len(log.names)
    z[:, :S] += size * np.random.default_rng(1).normal(size=size.shape)
    one = np.zeros((0, S))
    seen = Seen(z, log.q, log.w, sky, log.fixes[:, :3], np.zeros(size.shape), one)
    noise, _ = estimated(seen, 1e-5)
    assert noise.zenith == pytest.approx((0.4,), rel=0.15)
    assert noise.level == pytest.approx((0.6,), rel=0.2)
    # The known part of the variance is not included in the noise.
    noise, _ = estimated(seen._replace(modeled=np.full(size.shape, 0.36)), 1e-5)
    assert noise.zenith == pytest.approx((0.4,), rel=0.15)
    assert noise.level[0] < 0.3


def test_each_system_has_noise_of_its_own():
    """A jammed GPS signal does not change the noise of Galileo's ranges."""
    times = TOE + 1800.0 + 30.0 * np.arange(120)
    b = above(joined(gps(), galileo()), times[[0, -1]])
    nav = Navigation(Path("nav.rnx"), b, (np.array(ALPHA), np.array(BETA)))
    log = observed(b, times, 3e4 + 30.0 * (times - times[0]))
    rng = np.random.default_rng(4)
    errors = modeled_errors(positioning.prepare(log, nav), rng)
    size = np.where(b.system == 1, 15.0, 0.3)
    code = log.code + errors + size * rng.normal(size=log.code.shape)
    found = positioning.prepare(replace(log, code=code), nav)
    level, zenith = found.noise[0].level, found.noise[0].zenith
    assert np.hypot(level[0], 1.5 * zenith[0]) == pytest.approx(15.0, rel=0.25)
    assert np.hypot(level[1], zenith[1]) < 1.5
    alone = positioning.prepare(replace(log, code=code), nav, systems="E")
    pooled = positioning.prepare(replace(log, code=code), nav, sigma=(5.0, 0.05))
    errors = [
        np.sqrt(np.square(each.fixes[:, :3] - PLACE).sum(-1).mean())
        for each in (found, alone, pooled)
    ]
    assert errors[0] < 1.05 * errors[1]
    assert errors[0] < 0.7 * errors[2]
    lines = positioning_report.summary(positioning_report.position(found, "ls", PLACE))
    assert re.search(r"ranges GPS .* m / sin\(elevation\), Galileo .* m / sin", lines)
    assert "what atmosphere and orbits leave in ranges" in lines


def test_deviations_hold_what_atmosphere_and_orbits_leave(noisy):
    nav, obs = noisy
    worse = replace(nav, sets=replace(nav.sets, accuracy=np.where(nav.sets.number == 38, 4.8, 2.0)))
    log, plain = positioning.prepare(obs, worse), positioning.prepare(obs, nav, sigma=(1.5, 0.05))
    assert not plain.modeled.any()
    S = len(log.names)
    k, s = np.nonzero(log.used)
    latitude, longitude, _ = ecef2geodetic(*PLACE, ell=ELLIPSOID, deg=False)
    for i in range(0, k.size, 7):
        E = log.elevation[k[i], s[i]]
        ionosphere = 0.5 * (L1_HZ / B1I_HZ) ** 2
        ionosphere *= klobuchar(
            ALPHA, BETA, log.times[k[i]] + 14.0, latitude, longitude, E, log.azimuth[k[i], s[i]]
        )
        troposphere = 0.12 * 1.001 / np.sqrt(0.002001 + np.sin(E) ** 2)
        orbit = 2.0 if log.names[s[i]] == "C38" else 1.0
        size = np.sqrt(ionosphere**2 + troposphere**2 + orbit**2)
        assert np.sqrt(log.modeled[k[i], s[i]]) == pytest.approx(size, rel=1e-4)
    receiver = log.noise[0].variance(log.elevation, np.zeros(S, int))
    np.testing.assert_allclose(
        np.square(log.sigma[:, :S])[log.used], (log.modeled + receiver)[log.used]
    )


def test_a_receiver_that_is_noisy_is_no_fault(noisy):
    nav, obs = noisy
    code = obs.code + 8.0 * np.random.default_rng(2).normal(size=obs.code.shape)
    found = positioning.prepare(replace(obs, code=code), nav)
    assert found.excluded.sum() <= 2
    assert not found.unusable.any()
    assert np.sqrt(
        np.square(found.sigma[:, : len(found.names)][found.used]).mean()
    ) == pytest.approx(8.0, rel=0.1)


def test_too_little_to_estimate_noise_of_keeps_what_is_usual(noisy):
    nav, obs = noisy
    found = positioning.prepare(obs.part(slice(0, 2)), nav)
    assert found.noise[0] == ((0.0,), (1.5,), 0)


def test_fewer_than_four_satellites_are_told(noisy):
    nav, obs = noisy
    for count in (1, 2, 3):
        few = replace(
            obs, names=obs.names[:count], code=obs.code[:, :count], doppler=obs.doppler[:, :count]
        )
        with pytest.raises(InputError, match=r"expected an epoch with four satellites"):
            positioning.prepare(few, nav)


def test_sets_that_are_none_and_epochs_out_of_order_are_in_the_summary(noisy):
    nav, obs = noisy
    found = positioning.prepare(replace(obs, out_of_order=2), replace(nav, left_out={"C05": 3}))
    lines = positioning_report.summary(positioning_report.position(found, "ls", None))
    assert "2 epochs out of order" in lines
    assert (
        "3 broadcast sets that are incomplete or have a number that no message can hold (C05 3)"
        in lines
    )


def test_positions_far_from_the_earth_are_none(noisy):
    """In months without measurements a velocity of 50 m/s leads far away from the Earth."""
    nav, obs = noisy
    log = positioning.prepare(obs, nav)
    z = log.z.copy()
    z[1:] = z[:, len(log.names) :] = np.nan
    away = replace(log, times=np.concatenate([log.times[:1], log.times[1:] + 8640000.0]), z=z)
    away.fixes[0, 3] = 50.0
    result = positioning_report.position(away, "ekf", None)
    size = np.linalg.norm(result.mean[:, :3], axis=-1)
    assert np.isnan(size[1:]).all()
    assert np.nanmax(size) < 1e7
    assert "without a position" in positioning_report.summary(result)
