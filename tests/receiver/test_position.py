"""A receiver is positioned from its files: clocks, atmosphere, gaps, jumps; what cannot be is told in one line."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rinex_pair import ALPHA, BETA, PLACE, TIMES, TOE, constellation, measurements, navigation, observations, written

from celnav import cli
from celnav.files import InputError, Outputs
from celnav.filters.run import run
from celnav.models.beidou import B1I_HZ, LIGHT
from celnav.receiver import filters as positioning_filters
from celnav.receiver import position as positioning
from celnav.receiver import report as positioning_report
from celnav.receiver.rinex import Navigation, Observations, read_navigation, read_observations

LONG = TOE + 1800.0 + 30.0 * np.arange(12)


def observed(b, times, bias):
    """A log of a receiver at `PLACE` whose clock is ahead by ``bias`` m."""
    return Observations(Path("obs.rnx"), "TEST", PLACE, times, b.names, *measurements(b, times, bias))


DRIFTING = 3e4 + 30.0 * (LONG - LONG[0])


@pytest.fixture(scope="module")
def pair():
    b = constellation()
    return Navigation(Path("nav.rnx"), b, (np.array(ALPHA), np.array(BETA))), observed(b, LONG, DRIFTING)


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
        np.testing.assert_allclose(mean[:, :3], np.broadcast_to(PLACE, (12, 3)), atol=2e-3, err_msg=name)


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
    # The receiver samples a millisecond earlier or later: ranges change by less than a meter, not by 300 km.
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
    code[0, 3:] = np.nan  # three are too few to begin with
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
    assert positioning.prepare(replace(obs, code=code), nav).left_out["pseudorange out of all bounds"] == 1


def test_rates_may_be_missing(pair):
    nav, obs = pair
    found = positioning.prepare(replace(obs, doppler=np.full_like(obs.doppler, np.nan)), nav)
    np.testing.assert_allclose(found.fixes[:, :3], np.broadcast_to(PLACE, (12, 3)), atol=1e-4)
    assert np.isnan(found.fixes[:, 3:6]).all()
    plain = run(positioning_filters.filters(len(found.names))["ekf"], found.prior(), found.epochs(), keep="mean").mean
    for name, filter in positioning_filters.filters(len(found.names)).items():
        mean = run(filter, found.prior(), found.epochs(), keep="mean").mean
        if name != "sage-husa":  # nothing says how the clock runs, and it takes that for noise
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
    """At the first epoch four satellites are left, of which one is wrong: nothing tells."""
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
        code[5:7, 3:] = np.nan  # three ranges are no fix
        doppler = log.doppler if rates else np.full_like(log.doppler, np.nan)
        found = positioning.prepare(replace(log, code=code, doppler=doppler), nav)
        assert not found.used[5:7].any()
        np.testing.assert_allclose(found.jumps, 1e-3 * LIGHT * (np.arange(12) >= 7))
        np.testing.assert_allclose(found.fixes[7:, 6], DRIFTING[7:], atol=1e-3)
        assert np.abs(positioning_report.position(found, "ekf", None).mean[:, :3] - PLACE).max() < 1.0


def test_a_fast_clock_without_rates_is_no_jump(pair):
    """300 m/s and half an hour of silence make 540 km: nearly two milliseconds."""
    nav, _ = pair
    times = np.concatenate([LONG, LONG[-1] + 1800.0 + 30.0 * np.arange(3)])
    bias = 3e4 + 300.0 * (times - times[0])
    log = observed(nav.sets, times, bias)
    found = positioning.prepare(replace(log, doppler=np.full_like(log.doppler, np.nan)), nav)
    assert not found.jumps.any()
    np.testing.assert_allclose(found.fixes[:, 6], bias, atol=1e-3)


def test_one_epoch_is_enough(pair):
    nav, obs = pair
    found = positioning.prepare(obs.part(slice(0, 1)), nav)
    np.testing.assert_allclose(found.fixes[:, :3], PLACE[None], atol=1e-4)


def test_the_nearest_set_is_asked_for_its_health(pair):
    """A satellite that is flagged now is not used by its sound set of an hour ago."""
    nav, _ = pair
    sets = nav.sets
    later = replace(sets.chosen(np.array([4])), toe=sets.toe[4:5] + 3600.0, health=np.ones(1))
    both = type(sets)(*(np.concatenate([getattr(sets, f), getattr(later, f)]) for f in sets.__dataclass_fields__))
    name = sets.names[4]
    found = replace(nav, sets=both).nearest(name, [sets.toe[4] + 1700.0, sets.toe[4] + 1900.0])
    assert found.tolist() == [4, -1]


def test_what_corrects_the_ionosphere_is_told(pair):
    nav, obs = pair
    with_it, without = (positioning.prepare(obs, n) for n in (nav, replace(nav, klobuchar=None)))
    assert "by the broadcast coefficients" in positioning_report.summary(positioning_report.position(with_it, "ls", None))
    assert "not corrected" in positioning_report.summary(positioning_report.position(without, "ls", None))


def test_too_few_satellites_are_told_with_the_files(pair):
    nav, obs = pair
    code = obs.code.copy()
    code[:, 3:] = np.nan
    with pytest.raises(InputError, match=r"obs\.rnx, .*nav\.rnx: expected an epoch with four satellites"):
        positioning.prepare(replace(obs, code=code), nav)


def test_unknown_filters_and_noises_are_told(log):
    with pytest.raises(ValueError, match=r"^filter: expected one of ls, ekf, ukf, aukf"):
        positioning_report.position(log, "kalman", None)
    with pytest.raises(ValueError, match=r"^acceleration"):
        positioning_filters.filters(4, acceleration=0.0)


def test_the_table_has_a_row_for_each_epoch(pair):
    log = positioning.prepare(pair[1], pair[0], sigma=(1.5, 0.05))
    rows = list(csv.DictReader(positioning_report.table(positioning_report.position(log, "ls", None)).splitlines()))
    assert len(rows) == 12
    assert rows[0]["time_bdt"] == positioning_report.civil(LONG[0])
    assert float(rows[3]["x_m"]) == pytest.approx(PLACE[0], abs=1e-3)
    assert 1.0 < float(rows[0]["std_up_m"]) < 10.0
    assert float(rows[3]["clock_m"]) == pytest.approx(DRIFTING[3], abs=1e-3)


def test_the_recording_is_whole(log, tmp_path):
    positioning_report.record_positioned(positioning_report.position(log, "ekf", PLACE), tmp_path / "p.rrd")
    (found,) = rr.chunk.RrdReader(tmp_path / "p.rrd").recordings()
    assert found.application_id == "celnav-position"


# -- integrity -----------------------------------------------------------------------------------------------------------------
NOISE = 0.5


@pytest.fixture(scope="module")
def noisy():
    """A log of 40 epochs with noise, and its broadcast sets."""
    b, times = constellation(), TOE + 1800.0 + 30.0 * np.arange(40)
    log = observed(b, times, 3e4 + 30.0 * (times - times[0]))
    rng = np.random.default_rng(5)
    code, doppler = log.code + NOISE * rng.normal(size=log.code.shape), log.doppler + 0.1 * rng.normal(size=log.doppler.shape)
    return Navigation(Path("nav.rnx"), b, (np.array(ALPHA), np.array(BETA))), replace(log, code=code, doppler=doppler)


def off(found, filter):
    return np.linalg.norm(positioning_report.position(found, filter, None).mean[:, :3] - PLACE, axis=-1)


def high(nav, obs, count):
    """The satellites that are seen all the time, the highest first."""
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
    rows = list(csv.DictReader(positioning_report.table(positioning_report.position(found, "ls", None)).splitlines()))
    assert {row["integrity"] for row in rows} == {"excluded"}
    assert {row["excluded"] for row in rows} == {found.names[s]}


def test_without_the_test_a_faulty_satellite_is_believed(noisy):
    nav, obs = noisy
    code = obs.code.copy()
    code[:, high(nav, obs, 1)] += 1e4
    found = positioning.prepare(replace(obs, code=code), nav, sigma=(1.5, 0.05), false_alarm=0.0)
    assert not found.excluded.any()
    assert off(found, "ls").min() > 1e3
    assert "not tested" in positioning_report.summary(positioning_report.position(found, "ls", None))


def test_several_faulty_satellites_are_excluded(noisy):
    nav, obs = noisy
    code, some = obs.code.copy(), high(nav, obs, 3)
    code[:, some] += [1e5, -4e4, 500.0]
    found = positioning.prepare(replace(obs, code=code), nav)
    assert found.excluded[:, some].all()
    assert off(found, "aukf").max() < 10.0


@pytest.mark.parametrize(("part", "change"), [("M0", 1e-3), ("Omega0", -0.1), ("sqrt_a", 1.0), ("a0", 1e-4), ("e", 0.2)])
def test_a_wrong_broadcast_orbit_is_excluded(noisy, part, change):
    nav, obs = noisy
    (s,) = high(nav, obs, 1)
    values = getattr(nav.sets, part).copy()
    values[s] += change
    found = positioning.prepare(obs, replace(nav, sets=replace(nav.sets, **{part: values})))
    assert not found.used[:, s].any()  # excluded, or below the horizon by that orbit
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
    """Of five one is faulty: that is seen, not which. Of four nothing is seen."""
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
    assert list(csv.DictReader(positioning_report.table(result).splitlines()))[20]["integrity"] == state
    words = "1 epochs not used whose ranges contradict each other" if left == 5 else "1 without redundancy, which nothing tests"
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
    found = positioning.prepare(obs, nav)
    S, used = len(found.names), found.used
    assert found.noise[0].redundancy == used.sum() - 4 * 40
    assert np.sqrt(np.square(found.sigma[:, :S][used]).mean()) == pytest.approx(NOISE, rel=0.1)
    assert np.sqrt(np.square(found.sigma[:, S:][used]).mean()) == pytest.approx(0.1 * LIGHT / B1I_HZ, rel=0.1)
    result = positioning_report.position(found, "ls", PLACE)
    error = result.mean[:, :3] - PLACE
    ratio = np.einsum("ti,tij,tj->t", error, np.linalg.pinv(result.cov), error).mean() / 3.0
    assert 0.6 < ratio < 1.5
    assert result.nis == pytest.approx(1.0, abs=0.1)
    lines = positioning_report.summary(result)
    assert f"NIS {result.nis:.3f}" in lines
    assert f"estimated from {found.noise[0].redundancy} redundant ones" in lines
    kept = positioning.prepare(obs, nav, sigma=(1.5, 0.05))
    assert positioning_report.position(kept, "ls", PLACE).nis < 0.2
    assert "not estimated" in positioning_report.summary(positioning_report.position(kept, "ls", PLACE))


def test_noise_that_grows_towards_the_horizon_is_told_from_noise_that_does_not(noisy):
    nav, obs = noisy
    b, times = nav.sets, obs.times[0] + 30.0 * np.arange(150)
    clean = observed(b, times, 3e4 + 30.0 * (times - times[0]))
    sky = np.nan_to_num(positioning.prepare(clean, nav, sigma=(1.5, 0.05), mask_deg=0.0).elevation, nan=1.0)
    size = np.hypot(0.6, 0.4 / np.sin(np.maximum(sky, 0.1)))
    found = positioning.prepare(replace(clean, code=clean.code + size * np.random.default_rng(1).normal(size=size.shape)), nav)
    assert found.noise[0].zenith == pytest.approx(0.4, rel=0.15)
    assert found.noise[0].level == pytest.approx(0.6, rel=0.2)


def test_a_receiver_that_is_noisy_is_no_fault(noisy):
    nav, obs = noisy
    code = obs.code + 8.0 * np.random.default_rng(2).normal(size=obs.code.shape)
    found = positioning.prepare(replace(obs, code=code), nav)
    assert found.excluded.sum() <= 2
    assert not found.unusable.any()
    assert np.sqrt(np.square(found.sigma[:, : len(found.names)][found.used]).mean()) == pytest.approx(8.0, rel=0.1)


def test_too_little_to_estimate_noise_of_keeps_what_is_usual(noisy):
    nav, obs = noisy
    found = positioning.prepare(obs.part(slice(0, 2)), nav)
    assert found.noise[0] == (0.0, 1.5, 0)


def test_fewer_than_four_satellites_are_told(noisy):
    nav, obs = noisy
    for count in (1, 2, 3):
        few = replace(obs, names=obs.names[:count], code=obs.code[:, :count], doppler=obs.doppler[:, :count])
        with pytest.raises(InputError, match=r"expected an epoch with four satellites"):
            positioning.prepare(few, nav)


def test_sets_that_are_none_and_epochs_out_of_order_are_in_the_summary(noisy):
    nav, obs = noisy
    found = positioning.prepare(replace(obs, out_of_order=2), replace(nav, left_out={"C05": 3}))
    lines = positioning_report.summary(positioning_report.position(found, "ls", None))
    assert "2 epochs out of order" in lines
    assert "3 broadcast sets that are incomplete or hold what no message can (C05 3)" in lines


def test_positions_far_from_the_earth_are_none(noisy):
    """In months of silence a velocity of 50 m/s leads out of the world."""
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


# -- the command ---------------------------------------------------------------------------------------------------------------
@pytest.fixture
def files(tmp_path):
    b = constellation()
    return str(written(tmp_path, observations(b, TIMES)[0], "obs.rnx")), str(written(tmp_path, navigation(b), "nav.rnx"))


def test_position_writes_everything_and_replaces_its_own(files, tmp_path, capsys):
    out = tmp_path / "a folder"
    Outputs(out).text("summary.txt", "of an earlier run")
    assert cli.main(["position", *files, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert {p.name for p in out.iterdir()} == {*positioning_report.FILES, positioning_report.RECORDING, ".celnav.json"}
    assert float(printed.split("error")[1].split()[0]) == pytest.approx(
        0.5, abs=0.02
    )  # the antenna is half a meter above the marker
    assert (out / "summary.txt").read_text("utf-8").strip() in printed
    Outputs(out).check(positioning_report.FILES)


@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        (["--filter", "aukff"], 2, "celnav: --filter: expected one of ls, ekf"),
        (["--mask", "ten"], 2, "celnav: --mask: expected a number"),
        (["--mask", "91"], 2, "celnav: --mask: expected degrees from 0 to below 90, got 91"),
        (["--acceleration-noise", "-1"], 2, "celnav: --acceleration-noise: expected a positive density"),
        (["--position", "1", "2", "east"], 2, "celnav: --position: expected a number"),
        (["--position", "32", "118", "50"], 2, "celnav: --position: expected Earth-fixed meters"),
        (["--position", "1e200", "1e200", "0"], 2, "celnav: --position: expected Earth-fixed meters"),
        (["--position", "nan", "0", "0"], 2, "celnav: --position: expected Earth-fixed meters"),
        (["--mask", "nan"], 2, "celnav: --mask: expected degrees"),
        (["--sigma", "1", "0"], 2, "celnav: --sigma: expected positive deviations"),
        (["--sigma", "1", "low"], 2, "celnav: --sigma: expected a number"),
        (["--false-alarm", "1"], 2, "celnav: --false-alarm: expected a probability from 0 to below 1"),
    ],
)
def test_options_that_cannot_be_are_told_in_one_line(files, tmp_path, capsys, options, status, words):
    assert cli.main(["position", *files, "--out", str(tmp_path / "out"), *options]) == status
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_another_position_is_compared_with_from_another_folder(files, tmp_path, monkeypatch, capsys):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    away = [str(v) for v in PLACE + np.array([100.0, 0.0, 0.0])]
    assert cli.main(["position", *files, "--filter", "ls", "--position", *away]) == 0
    assert float(capsys.readouterr().out.split("error")[1].split()[0]) > 90.0
    assert Path("out/position/track.csv").exists()


def first_row(text, name="C05"):
    return next(line for line in text.splitlines() if line.startswith(name))


KIND = "C    1 C2I".ljust(60) + "SYS / # / OBS TYPES"
SCALE = "C   10".ljust(60) + "SYS / SCALE FACTOR\n"
OBSERVATIONS = {
    "a garbled date": (
        lambda t: t.replace("> 2011", "> 20x1", 1) if "> 2011" in t else re.sub(r"> (...)\d", r"> \1x", t, count=1),
        "expected date, flag and number of an epoch",
    ),
    "a count below nothing": (
        lambda t: re.sub(r"(> .{29}0).{3}", r"\1 -1", t, count=1),
        "expected date, flag and number of an epoch",
    ),
    "a garbled satellite": (lambda t: t.replace("\nC05", "\nCx5", 1), "expected a satellite (C01), got 'Cx5'"),
    "a garbled range": (
        lambda t: t.replace(first_row(t), "C05" + "  3xxxxx16.123".rjust(14), 1),
        "expected a number, got '3xxxxx16.123'",
    ),
    "a row that is cut off": (lambda t: t.replace(first_row(t), first_row(t)[:-7], 1), "the last one is cut off"),
    "a position in kilometers": (
        lambda t: t.replace("".join(f"{v:14.4f}" for v in PLACE), "".join(f"{v / 1e3:14.4f}" for v in PLACE)),
        "APPROX",
    ),
    "a garbled position": (
        lambda t: re.sub(r"-2611857\.0000", "-26xx857.0000", t),
        "expected three numbers in APPROX POSITION XYZ",
    ),
    "a new kind in an event": (
        lambda t: re.sub(
            r"(> .{29})0(.{3}.*\n)", "\\g<1>4  1\n" + "C    1 C2I".ljust(60) + "SYS / # / OBS TYPES\n\\g<0>", t, count=1
        ),
        "expected observations of one kind",
    ),
    "a scale": (lambda t: t.replace("".ljust(60) + "END", SCALE + "".ljust(60) + "END", 1), "SCALE"),
}


@pytest.mark.parametrize("name", OBSERVATIONS)
def test_damaged_observations_are_told(name, tmp_path):
    damage, words = OBSERVATIONS[name]
    text = observations(constellation(), TIMES)[0]
    changed = damage(text)
    assert changed != text
    with pytest.raises(InputError, match=re.escape(words)):
        read_observations(written(tmp_path, changed))


def test_events_in_a_log_are_passed_over(tmp_path):
    text = observations(constellation(), TIMES)[0]
    whole = read_observations(written(tmp_path, text, "whole.rnx"))
    event = ">                              4  2\n" + "CABLE CHANGED".ljust(60) + "COMMENT\n" + "C05 IS LOW".ljust(60) + "COMMENT\n"
    lines = text.splitlines(keepends=True)
    second = [k for k, line in enumerate(lines) if line.startswith(">")][1]
    found = read_observations(written(tmp_path, "".join([*lines[:second], event, *lines[second:]]), "event.rnx"))
    np.testing.assert_array_equal(found.code, whole.code)
    assert len(found.times) == 3


def test_a_log_of_beidou_alone_is_in_its_own_time(tmp_path):
    text = observations(constellation(), TIMES, 0.0, "   ")[0].replace("M: Mixed", "C: BDS  ", 1)
    np.testing.assert_allclose(read_observations(written(tmp_path, text)).times, TIMES, atol=1e-6)


NAVIGATION = {
    "a set that is cut off": (lambda t: "\n".join(t.splitlines()[:-3]) + "\n", "expected 8 lines of a broadcast set from line"),
    "a garbled number": (lambda t: t[: t.index("C01") + 30] + "x" + t[t.index("C01") + 31 :], "expected a number, got"),
}  # fmt: skip


@pytest.mark.parametrize("name", NAVIGATION)
def test_damaged_orbits_are_told(name, tmp_path):
    damage, words = NAVIGATION[name]
    text = navigation(constellation())
    changed = damage(text)
    assert changed != text
    with pytest.raises(InputError, match=re.escape(words)):
        read_navigation(written(tmp_path, changed))


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda t: "", "got an empty one"),
        (lambda t: t[: t.index("END OF HEADER") - 100], "expected END OF HEADER"),
        (lambda t: t[: t.index("END OF HEADER") + 14], "got n"),
        (lambda t: t.replace("     3.04", "     2.11", 1), "line 1: expected RINEX 3, got version 2.11"),
        (lambda t: t.replace("     3.04", "     4.00", 1), "line 1: expected RINEX 3, got version 4"),
        (
            lambda t: t.replace("C: BDS  ", "G: GPS  ", 1).replace("M: Mixed", "G: GPS  ", 1),
            "line 1: expected BeiDou (C) or mixed (M)",
        ),
    ],
)
def test_damaged_files_are_one_line_and_nothing_is_written(files, tmp_path, capsys, which, damage, words):
    path = Path(files[which])
    path.write_text(damage(path.read_text("ascii")), "ascii")
    out = tmp_path / "out"
    assert cli.main(["position", *files, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert str(path) in error
    assert error.count("\n") == 1
    assert not [p for p in out.iterdir() if not p.name.startswith(".")]


def test_a_truncated_log_is_told_with_its_line(files, tmp_path, capsys):
    kept = Path(files[0]).read_text("ascii").splitlines()[:-4]
    Path(files[0]).write_text("\n".join(kept) + "\n", "ascii")
    assert cli.main(["position", *files, "--out", str(tmp_path / "out")]) == 2
    assert f"obs.rnx, line {len(kept)}: expected" in capsys.readouterr().err


def test_a_log_of_one_epoch_is_positioned_without_a_recording(files, tmp_path, capsys):
    lines = Path(files[0]).read_text("ascii").splitlines(keepends=True)
    second = [k for k, line in enumerate(lines) if line.startswith(">")][1]
    Path(files[0]).write_text("".join(lines[:second]), "ascii")
    assert cli.main(["position", *files, "--out", str(tmp_path / "out")]) == 0
    assert "no recording (times: expected two or more" in capsys.readouterr().err


def test_absent_files_and_foreign_results_are_told(files, tmp_path, capsys):
    assert cli.main(["position", files[0], str(tmp_path / "none.rnx"), "--out", str(tmp_path / "out")]) == 2
    assert "none.rnx" in capsys.readouterr().err
    (tmp_path / "out" / "track.csv").write_text("mine", encoding="ascii")
    assert cli.main(["position", *files, "--out", str(tmp_path / "out")]) == 2
    assert "track.csv" in capsys.readouterr().err
    assert (tmp_path / "out" / "track.csv").read_text() == "mine"


def damaged(text, rng):
    """With a letter, a field or a line that is another, or nothing from somewhere on."""
    lines = text.split("\n")
    k = int(rng.integers(len(lines) - 1))
    at = int(rng.integers(max(len(lines[k]), 1)))
    match rng.choice(["letter", "digit", "field", "line", "end", "name"]):
        case "letter":
            lines[k] = lines[k][:at] + chr(rng.integers(32, 127)) + lines[k][at + 1 :]
        case "digit":
            lines[k] = lines[k][:at] + str(rng.integers(10)) + lines[k][at + 1 :]
        case "field":
            wild = str(rng.choice(["1e99", "nan", "-inf", "0", "", "1e308", "-1", "1_0"]))
            lines[k] = lines[k][:at] + wild.rjust(14) + lines[k][at + 14 :]
        case "line":
            lines[k] = lines[int(rng.integers(len(lines)))]
        case "end":
            return text[: int(rng.integers(len(text)))]
        case "name":
            lines[k] = str(rng.choice(["Cxx", "C00", "C 1", "X01"])) + lines[k][3:]
    return "\n".join(lines)


@pytest.mark.parametrize("which", ["observations", "navigation"])
def test_damage_is_an_error_of_input_or_is_told_in_the_summary(tmp_path, which):
    b = constellation()
    texts = {"observations": observations(b, TIMES)[0], "navigation": navigation(b)}
    refused = []
    for n in range(60):
        changed = texts | {which: damaged(texts[which], np.random.default_rng(n))}
        try:
            nav = read_navigation(written(tmp_path, changed["navigation"], "nav.rnx"))
            obs = read_observations(written(tmp_path, changed["observations"], "obs.rnx"))
            result = positioning_report.position(positioning.prepare(obs, nav), "ls", None)
        except InputError as error:
            refused.append(str(error))
        else:
            positioning_report.summary(result)
            positioning_report.table(result)
            assert np.nanmax(np.linalg.norm(result.mean[:, :3] - PLACE, axis=-1)) < 30.0, n
    assert 10 < len(refused) < 60
    assert all("rnx" in line for line in refused)


def test_the_nearest_epoch_with_a_fix():
    there = np.array([False, False, True, False, False, True, True, False])
    np.testing.assert_array_equal(positioning._nearest(there), [2, 2, 2, 2, 5, 5, 6, 6])
