"""Positions of a receiver from its files: clocks, atmosphere, gaps, jumps; invalid input gives one
line.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rinex_pair import ALPHA, BETA, PLACE, TOE, constellation, observed

from celnav.files import InputError
from celnav.filters.run import run
from celnav.models.gnss import LIGHT
from celnav.receiver import filters as positioning_filters
from celnav.receiver import position as positioning
from celnav.receiver import report as positioning_report
from celnav.receiver import tracks
from celnav.receiver.rinex import Navigation
from celnav.receiver.sky import TYPICAL_IONOSPHERE, klobuchar

LONG = TOE + 1800.0 + 30.0 * np.arange(12)


DRIFTING = 3e4 + 30.0 * (LONG - LONG[0])


@pytest.fixture(scope="module")
def pair():
    b = constellation()
    return Navigation(Path("nav.rnx"), b, (np.array(ALPHA), np.array(BETA))), observed(
        b, LONG, DRIFTING
    )


@pytest.fixture(scope="module")
def log(pair):
    nav, obs = pair
    return positioning.prepare(obs, nav)


def test_fixes_find_the_receiver_without_being_told_where_it_is(log):
    np.testing.assert_allclose(log.fixes[:, :3], np.broadcast_to(PLACE, (12, 3)), atol=1e-4)
    np.testing.assert_allclose(log.fixes[:, 3:6], 0.0, atol=1e-5)
    np.testing.assert_allclose(log.fixes[:, 6], DRIFTING, atol=1e-4)
    np.testing.assert_allclose(log.fixes[:, 7], 30.0, atol=1e-5)


def test_every_filter_finds_it_too(log):
    for name, filter in positioning_filters.filters(len(log.names)).items():
        mean = run(filter, log.prior(), log.epochs(), keep="mean").mean
        np.testing.assert_allclose(
            mean[:, :3], np.broadcast_to(PLACE, (12, 3)), atol=2e-3, err_msg=name
        )


def test_the_mask_leaves_out_what_is_low(pair, log):
    nav, obs = pair
    assert np.degrees(log.elevation[log.used]).min() >= 10.0
    high = positioning.prepare(obs, nav, mask_deg=30.0)
    assert np.degrees(high.elevation[high.used]).min() >= 30.0
    assert high.left_out["below the mask"] > log.left_out["below the mask"] > 0
    with pytest.raises(ValueError, match=r"^mask_deg"):
        positioning.prepare(obs, nav, mask_deg=90.0)
    with pytest.raises(ValueError, match=r"^sigma"):
        positioning.prepare(obs, nav, sigma=(1.0, 0.0))


def test_deviations_grow_towards_the_horizon(pair):
    log = positioning.prepare(pair[1], pair[0], sigma=(1.5, 0.05))
    S = len(log.names)
    np.testing.assert_allclose(log.sigma[:, :S][log.used], 1.5 / np.sin(log.elevation[log.used]))
    np.testing.assert_allclose(log.sigma[:, S:][log.used], 0.05 / np.sin(log.elevation[log.used]))


def test_clocks_that_are_set_by_milliseconds_leave_no_trace(pair, log):
    nav, _ = pair
    jumps = 1e-3 * LIGHT * np.repeat([0.0, 1.0, -1.0], 4)
    found = positioning.prepare(observed(nav.sets, LONG, DRIFTING + jumps), nav)
    np.testing.assert_allclose(found.fixes, log.fixes, atol=2e-4)
    # If the receiver samples a millisecond earlier or later, ranges change by less than a meter,
    # not by 300 km.
    np.testing.assert_allclose(found.z[:, :32][found.used], log.z[:, :32][log.used], atol=1.0)


def test_satellites_that_are_silent_or_of_bad_health_are_not_used(pair):
    nav, obs = pair
    silent = obs.code.copy()
    silent[3:6, 2] = np.nan
    sick = replace(nav, sets=replace(nav.sets, health=np.where(nav.sets.number == 1.0, 1.0, 0.0)))
    found = positioning.prepare(replace(obs, code=silent), sick)
    assert not found.used[3:6, 2].any()
    assert not found.used[:, obs.names.index("C01")].any()
    assert found.left_out["without a healthy broadcast set in its time"] == 12
    np.testing.assert_allclose(found.fixes[:, :3], np.broadcast_to(PLACE, (12, 3)), atol=1e-4)


def test_epochs_without_a_fix_are_predictions(pair):
    nav, obs = pair
    code = obs.code.copy()
    code[5] = np.nan
    code[0, 3:] = np.nan  # three are too few to start
    found = positioning.prepare(replace(obs, code=code), nav)
    assert len(found.times) == 11
    assert np.isnan(found.fixes[4]).all()
    result = positioning_report.position(found, "ukf", PLACE)
    assert np.isfinite(result.mean).all()
    assert "1 without a fix" in positioning_report.summary(result)


def test_pseudoranges_out_of_all_bounds_are_left_out_and_counted(pair):
    nav, obs = pair
    code = obs.code.copy()
    code[2, 0] = 1e6
    assert (
        positioning.prepare(replace(obs, code=code), nav).left_out["pseudorange out of all bounds"]
        == 1
    )


def test_rates_may_be_missing(pair):
    nav, obs = pair
    found = positioning.prepare(replace(obs, doppler=np.full_like(obs.doppler, np.nan)), nav)
    np.testing.assert_allclose(found.fixes[:, :3], np.broadcast_to(PLACE, (12, 3)), atol=1e-4)
    assert np.isnan(found.fixes[:, 3:6]).all()
    plain = run(
        positioning_filters.filters(len(found.names))["ekf"],
        found.prior(),
        found.epochs(),
        keep="mean",
    ).mean
    for name, filter in positioning_filters.filters(len(found.names)).items():
        mean = run(filter, found.prior(), found.epochs(), keep="mean").mean
        if name != "sage-husa":  # no model of the clock, which it treats as noise
            assert np.abs(mean[:, :3] - PLACE).max() < 1.0, name
        if name == "group":
            np.testing.assert_allclose(mean, plain, atol=0.1)


def test_wild_rates_are_left_out_and_counted(pair):
    nav, obs = pair
    doppler = obs.doppler.copy()
    doppler[4, 1] = 1e9
    found = positioning.prepare(replace(obs, doppler=doppler), nav)
    assert found.left_out["rate out of all bounds"] == 1
    assert np.isnan(found.z[4, len(found.names) + 1])
    assert np.isfinite(found.z[4, 1])


def test_it_starts_at_a_fix_that_was_tested(pair):
    """At the first epoch four satellites are left, one of which is wrong: this
    cannot be detected.
    """
    nav, obs = pair
    code = obs.code + np.random.default_rng(0).normal(size=obs.code.shape)
    seen = np.flatnonzero(np.isfinite(positioning.prepare(obs, nav).z[0, : len(obs.names)]))
    code[0, seen[0]] += 2e6
    code[0, seen[4:]] = np.nan
    code[0, np.setdiff1d(np.arange(len(obs.names)), seen)] = np.nan
    found = positioning.prepare(replace(obs, code=code), nav)
    assert found.times[0] == obs.times[1]
    assert found.left_out["before the first consistent fix"] == 4
    assert np.abs(positioning_report.position(found, "ekf", None).mean[:, :3] - PLACE).max() < 20.0


def test_a_clock_that_is_set_in_a_gap_costs_the_ranges_of_the_gap(pair):
    nav, _ = pair
    for rates in (True, False):
        log = observed(nav.sets, LONG, DRIFTING + 1e-3 * LIGHT * (np.arange(12) >= 5))
        code = log.code.copy()
        code[5:7, 3:] = np.nan  # three ranges give no fix
        doppler = log.doppler if rates else np.full_like(log.doppler, np.nan)
        found = positioning.prepare(replace(log, code=code, doppler=doppler), nav)
        assert not found.used[5:7].any()
        np.testing.assert_allclose(found.jumps, 1e-3 * LIGHT * (np.arange(12) >= 7))
        np.testing.assert_allclose(found.fixes[7:, 6], DRIFTING[7:], atol=1e-3)
        assert (
            np.abs(positioning_report.position(found, "ekf", None).mean[:, :3] - PLACE).max() < 1.0
        )


def test_a_fast_clock_without_rates_is_no_jump(pair):
    """300 m/s over half an hour without measurements is 540 km, nearly two milliseconds."""
    nav, _ = pair
    times = np.concatenate([LONG, LONG[-1] + 1800.0 + 30.0 * np.arange(3)])
    bias = 3e4 + 300.0 * (times - times[0])
    log = observed(nav.sets, times, bias)
    found = positioning.prepare(replace(log, doppler=np.full_like(log.doppler, np.nan)), nav)
    assert not found.jumps.any()
    np.testing.assert_allclose(found.fixes[:, 6], bias, atol=1e-3)


def test_a_log_that_is_too_short_for_its_clock_has_that_of_a_phone(pair, log):
    nav, obs = pair
    short = positioning_report.position(
        positioning.prepare(obs.part(slice(0, 4)), nav), "ekf", None
    )
    assert short.clock.densities == positioning_filters.PHONE
    assert "too few fixes" in positioning_report.summary(short)
    found = positioning_report.position(log, "ekf", None)
    assert (np.array(found.clock.densities) >= positioning_filters.OVEN).all()
    assert found.clock.densities[0] < 1.0
    with pytest.raises(ValueError, match=r"^clock: expected one of crystal, phone, auto, got 'x'"):
        positioning_report.position(log, "ekf", None, clock="x")


def test_one_epoch_is_enough(pair):
    nav, obs = pair
    found = positioning.prepare(obs.part(slice(0, 1)), nav)
    np.testing.assert_allclose(found.fixes[:, :3], PLACE[None], atol=1e-4)


def test_the_nearest_set_is_asked_for_its_health(pair):
    """A satellite that is flagged now is not used with its healthy set from an hour ago."""
    nav, _ = pair
    sets = nav.sets
    later = replace(sets.chosen(np.array([4])), toe=sets.toe[4:5] + 3600.0, health=np.ones(1))
    both = type(sets)(
        *(np.concatenate([getattr(sets, f), getattr(later, f)]) for f in sets.__dataclass_fields__)
    )
    name = sets.names[4]
    found = replace(nav, sets=both).nearest(name, [sets.toe[4] + 1700.0, sets.toe[4] + 1900.0])
    assert found.tolist() == [4, -1]


def test_what_corrects_the_ionosphere_is_told(pair):
    nav, obs = pair
    with_it, without = (positioning.prepare(obs, n) for n in (nav, replace(nav, klobuchar=None)))
    assert "by the broadcast coefficients" in positioning_report.summary(
        positioning_report.position(with_it, "ls", None)
    )
    typical = positioning_report.position(without, "ls", None)
    headline, *rest = positioning_report.summary(typical).splitlines()
    assert headline.endswith("ionosphere: typical, not broadcast")
    assert any(line.startswith("ionosphere   typical, not broadcast") for line in rest)
    assert "% ionos opt : typical, not broadcast" in tracks.pos(typical)
    (feature,) = json.loads(tracks.geojson(typical))["features"]
    assert feature["properties"]["ionosphere"] == "typical, not broadcast"


def test_without_a_message_the_ionosphere_is_typical(pair):
    """Klobuchar's delay for a day of medium activity, and the remaining delay may be as large."""
    nav, obs = pair
    given = replace(nav, klobuchar=TYPICAL_IONOSPHERE)
    with_it, without = (positioning.prepare(obs, n) for n in (given, replace(nav, klobuchar=None)))
    np.testing.assert_array_equal(with_it.z, without.z)
    zenith = klobuchar(*TYPICAL_IONOSPHERE, 50400.0, 0.7, 0.0, np.array(np.pi / 2), np.array(0.0))
    assert 3.0 < zenith < 6.0
    E = with_it.elevation[with_it.used]
    troposphere = 0.12 * 1.001 / np.sqrt(0.002001 + np.sin(E) ** 2)
    left = [np.sqrt(log.modeled[with_it.used] - troposphere**2 - 1.0) for log in (with_it, without)]
    np.testing.assert_allclose(left[1], 2.0 * left[0], rtol=1e-6)


def test_too_few_satellites_are_told_with_the_files(pair):
    nav, obs = pair
    code = obs.code.copy()
    code[:, 3:] = np.nan
    with pytest.raises(
        InputError, match=r"obs\.rnx, .*nav\.rnx: expected an epoch with four satellites"
    ):
        positioning.prepare(replace(obs, code=code), nav)


def test_unknown_filters_and_noises_are_told(log):
    with pytest.raises(ValueError, match=r"^filter: expected one of ls, ekf, ukf, aukf"):
        positioning_report.position(log, "kalman", None)
    with pytest.raises(ValueError, match=r"^acceleration"):
        positioning_filters.filters(4, acceleration=0.0)


def test_the_table_has_a_row_for_each_epoch(pair):
    log = positioning.prepare(pair[1], pair[0], sigma=(1.5, 0.05))
    rows = list(
        csv.DictReader(
            positioning_report.table(positioning_report.position(log, "ls", None)).splitlines()
        )
    )
    assert len(rows) == 12
    assert rows[0]["time_bdt"] == positioning_report.civil(LONG[0])
    assert float(rows[3]["x_m"]) == pytest.approx(PLACE[0], abs=1e-3)
    assert 1.0 < float(rows[0]["std_up_m"]) < 10.0
    assert float(rows[3]["clock_m"]) == pytest.approx(DRIFTING[3], abs=1e-3)


def test_the_recording_is_whole(log, tmp_path):
    positioning_report.record_positioned(
        positioning_report.position(log, "ekf", PLACE), tmp_path / "p.rrd"
    )
    (found,) = rr.chunk.RrdReader(tmp_path / "p.rrd").recordings()
    assert found.application_id == "celnav-position"
