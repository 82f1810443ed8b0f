"""A track is trusted as long as the ranges of each epoch agree with it: simulated receivers with
phone clocks, wrong filters, and falsified ranges.
"""

from __future__ import annotations

import csv
import json
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
    navigation,
    observations,
    observed,
    written,
)
from scipy.stats import chi2

from celnav import cli
from celnav.models import pseudorange
from celnav.models.gnss import B1I_HZ, LIGHT
from celnav.receiver import position as positioning
from celnav.receiver import report, tracks
from celnav.receiver.correlated import WINDOW, Correlation
from celnav.receiver.filters import COMPACT, CRYSTAL, filters, process_noise, transition
from celnav.receiver.rinex import Navigation
from celnav.receiver.trust import AGREEING, guarded

T = 90
TIMES = TOE + 1800.0 + np.arange(T)
SKY = above(constellation(), TIMES[[0, -1]])
NAVIGATION = Navigation(Path("nav.rnx"), SKY, (np.array(ALPHA), np.array(BETA)))
NOISE = 1.0
WHITE = Correlation(0.0, 1.0, 0.0)
PULL = np.array([4000.0, -3000.0, 2000.0])
"""From the receiver to the position that falsified ranges indicate."""


def logged(bias, seed=0):
    """A log of a receiver at rest whose clock is ahead by ``bias`` m, with noise."""
    rng, log = np.random.default_rng(seed), observed(SKY, TIMES, bias)
    code = log.code + NOISE * rng.normal(size=log.code.shape)
    doppler = log.doppler + 0.05 * B1I_HZ / LIGHT * rng.normal(size=log.doppler.shape)
    return replace(log, code=code, doppler=doppler)


@pytest.fixture(scope="module")
def steady():
    return logged(3e4 + 30.0 * (TIMES - TIMES[0]))


def pulled(log, epochs, satellites=slice(None)):
    """The log with ranges and rates of some satellites as if the receiver were at `PULL`."""
    sources = pseudorange.sources(SKY, TIMES, np.broadcast_to(PLACE, (T, 3)))
    here, there = (
        pseudorange.measure(np.concatenate([p, np.zeros(5)]), sources.q, sources.w)
        for p in (PLACE, PLACE + PULL)
    )
    ranges, rates = np.split(there - here, 2, -1)
    code, doppler = log.code.copy(), log.doppler.copy()
    code[epochs, satellites] += ranges[epochs, satellites]
    doppler[epochs, satellites] -= B1I_HZ / LIGHT * rates[epochs, satellites]
    return replace(log, code=code, doppler=doppler)


def positioned(log, filter="student", **options):
    return report.position(positioning.prepare(log, NAVIGATION), filter, PLACE, **options)


def error(found):
    return np.linalg.norm(found.mean[:, :3] - PLACE, axis=-1)


def four(log):
    """Indices of four satellites with a good geometry that are visible all the time."""
    names = ("C01", "C02", "C05", "C38")
    return [list(log.names).index(name) for name in names]


def test_a_sound_log_is_sound(steady):
    found = positioned(steady)
    assert set(found.trust) == {""}
    assert found.apart.max() < 1.0
    assert error(found).max() < 10.0
    assert report.summary(found).startswith("SOUND        all 90 positions")


def test_a_clock_that_is_set_anew_at_each_epoch_does_not_pull_the_track():
    """With the process noise of a crystal the clock steps become position errors; such positions
    are not called sound.
    """
    steps = 30.0 * np.random.default_rng(1).normal(size=T)
    log = logged(3e4 + 30.0 * (TIMES - TIMES[0]) + steps)
    own, phone = (positioned(log, clock=clock) for clock in ("auto", "phone"))
    assert error(own).max() < 6.0
    assert error(phone).max() < 6.0
    assert own.clock.densities[0] == pytest.approx(2 * 30.0**2, rel=0.3)
    assert "estimated from" in report.summary(own)
    for filter in ("ekf", "aukf", "student"):
        crystal = positioned(log, filter, clock="crystal")
        assert error(crystal)[~crystal.doubtful].max() < 100.0
        assert crystal.nis > 3.0 * positioned(log, filter).nis


def test_a_reset_that_is_no_millisecond_costs_nothing(steady):
    """The clock is set by 2 km in the middle: the track continues."""
    late = TIMES[50] <= TIMES
    found = positioned(replace(steady, code=steady.code + 2000.0 * late[:, None]))
    assert np.flatnonzero(found.log.clock.reset).tolist() == [50]
    assert not found.log.jumps.any()
    np.testing.assert_allclose(error(found), error(positioned(steady)), atol=0.5)
    assert "1 times by another step" in report.summary(found)


def without_redundancy(log, epochs):
    """Four satellites are left at some epochs."""
    code = log.code.copy()
    gone = np.setdiff1d(np.arange(code.shape[1]), four(log))
    code[np.ix_(epochs, gone)] = np.nan
    return replace(log, code=code)


@pytest.mark.parametrize("filter", ["student", "ekf", "aukf", "ls"])
def test_four_satellites_that_pull_the_track_away_are_not_followed(steady, filter):
    """They cannot be tested alone, but the track contradicts them: the filter only predicts until
    there is redundancy again.
    """
    bad = np.arange(40, 60)
    log = without_redundancy(pulled(steady, bad), bad)
    found = positioned(log, filter)
    assert set(found.trust[40:60]) == {"apart"}
    assert set(found.trust[:40]) | set(found.trust[60:]) == {""}
    assert error(found)[~found.doubtful].max() < 15.0
    if filter != "ls":  # which has no track to continue
        assert error(found)[bad].max() < 60.0
        assert not found.measured[bad].any()


def test_four_sound_satellites_are_followed_with_a_word(steady):
    some = np.arange(40, 60)
    found = positioned(without_redundancy(steady, some))
    assert found.measured.all()
    assert found.integrity[some].tolist() == ["untested"] * 20
    assert error(found).max() < 10.0


def test_after_a_contradiction_four_satellites_are_not_followed(steady):
    """Even if they agree with the track, because the track is doubted and there
    is no redundancy.
    """
    log = without_redundancy(steady, np.arange(41, 60))
    code = log.code.copy()
    code[40] += 1e4 * np.random.default_rng(3).normal(size=code.shape[1])
    found = positioned(replace(log, code=code))
    assert found.integrity[40] == "contradiction"
    assert set(found.trust[41:60]) == {"distrusted"}
    assert set(found.integrity[60:]) == {"tested"}


@pytest.mark.parametrize("back", [70, T])
def test_a_receiver_that_all_satellites_displace_says_so_until_it_is_back(steady, back):
    """All ranges are spoofed: they agree with each other, but no receiver moves
    5 km in one second.
    """
    found = positioned(pulled(steady, np.arange(40, back)))
    away = AGREEING - 1
    assert set(found.trust[:40]) == {""}
    assert found.trust[40] == "apart"
    assert set(found.trust[41 : 40 + away]) == {"distrusted"}
    assert set(found.trust[40 + away : back]) == {"displaced"}
    assert set(found.trust[back : back + away]) <= {"apart", "distrusted"}
    assert set(found.trust[back + away :]) <= {""}
    assert error(found)[~found.doubtful].max() < 15.0
    assert report.summary(found).startswith("NOT SOUND")


def test_a_track_that_begins_at_a_wrong_fix_is_not_the_one_that_is_trusted(steady):
    found = positioned(pulled(steady, np.arange(3)))
    assert set(found.trust[:4]) == {"apart"}
    assert set(found.trust[3 + AGREEING :]) == {""}
    assert error(found)[~found.doubtful].max() < 15.0


def test_a_log_without_any_trust_is_told_as_a_whole(steady):
    """Three fixes that later fixes contradict, and too few fixes after them."""
    found = positioned(pulled(steady, np.arange(3)).part(slice(0, 6)))
    assert found.doubtful.all()
    assert report.summary(found).startswith("NOT SOUND    do not trust 6 of 6 positions")
    for form in tracks.FORMATS.values():
        assert form(found)


def test_distrust_is_in_every_track_and_in_the_exit_status(steady, tmp_path):
    found = positioned(pulled(steady, np.arange(40, T)))
    coasting = np.isin(found.trust, ("apart", "distrusted"))
    rows = list(csv.DictReader(tracks.table(found).splitlines()))
    assert [row["integrity"] for row in rows] == found.integrity.tolist()
    assert [float(row["apart"]) > 1.0 for row in rows[:42]] == [False] * 40 + [True] * 2
    lines = [line for line in tracks.pos(found).splitlines() if not line.startswith("%")]
    quality = np.array([int(line.split()[5]) for line in lines])
    np.testing.assert_array_equal(quality == 7, coasting)
    np.testing.assert_array_equal(quality == 0, found.trust == "displaced")
    assert set(quality[:40]) == {5}
    sentences = tracks.nmea(found).split("\r\n")[:-1]
    gga, rmc = ([s.partition("*")[0].split(",") for s in sentences[i::2]] for i in (0, 1))
    assert [s[6] for s in gga] == ["6" if k else "1" for k in coasting]
    assert [s[2] for s in rmc] == ["A"] * 40 + ["V"] * (T - 40)
    assert [s[-1] for s in rmc] == ["V"] * 40 + ["U"] * (T - 40)
    (feature,) = json.loads(tracks.geojson(found))["features"]
    assert feature["properties"]["integrity"] == found.integrity.tolist()


@pytest.mark.parametrize(("pull", "status"), [(0.0, 1), (5e3, 3)])
def test_strict_ends_with_3_where_ranges_contradict_the_track(tmp_path, capsys, pull, status):
    """After half a minute four satellites are left in the file, and the range of one is falsified;
    four satellites that agree are untested.
    """
    head, *epochs = observations(SKY, TIMES[:40])[0].split("\n>")
    names = [SKY.names[s] for s in four(SKY)]
    for k in range(30, 40):
        first, *rows = epochs[k].splitlines()
        rows = [row for row in rows if row[:3] in names]
        rows[0] = f"{rows[0][:3]}{float(rows[0][3:17]) + pull:14.3f}{rows[0][17:]}"
        epochs[k] = "\n".join([f"{first[:31]}{len(rows):3d}", *rows])
    files = [
        str(written(tmp_path, "\n>".join([head, *epochs]) + "\n", "obs.rnx")),
        str(written(tmp_path, navigation(SKY), "nav.rnx")),
    ]
    out = tmp_path / "track.pos"
    assert cli.main(["position", *files, "--out", str(out)]) == 0
    assert cli.main(["position", *files, "--strict", "--out", str(out)]) == status
    headline = capsys.readouterr().out.splitlines()[0]
    assert headline.startswith(
        "NOT SOUND    do not trust 10 of 40 positions, from 2020-06-25T00:30:30"
    )
    assert ("apart" in headline) == (status == 3)
    rows = [line.split() for line in out.read_text("utf-8").splitlines() if line[0] != "%"]
    assert [row[5] for row in rows] == ["5"] * 30 + ["7" if pull else "5"] * 10


def test_the_distance_is_that_of_the_plain_formula(steady):
    """From the covariances of prediction and fix, with explicit matrix inverses."""
    log = positioning.prepare(steady, NAVIGATION, sigma=(NOISE, 0.05))
    filter = filters(len(log.names))["ekf"]
    found = guarded(filter, log, 1e-3)
    state = filter.start(log.prior())
    for k, epoch in enumerate(log.epochs()):
        state = filter.predict(state, epoch)
        d = log.fixes[k, :3] - state.belief.mean[:3]
        S = state.belief.cov[:3, :3] + log.fix_cov[k]
        assert found.apart[k] == pytest.approx(d @ np.linalg.solve(S, d) / 16.266, rel=1e-3)
        state, _ = filter.update(state, epoch)


@pytest.mark.parametrize("name", COMPACT)
def test_satellites_without_measurements_make_no_difference(steady, name):
    log = positioning.prepare(steady, NAVIGATION)
    z = log.z.copy()
    z[::3, 0] = z[5, :] = np.nan  # a satellite with a rate alone, and an epoch without any
    log = replace(log, z=z)
    filter = filters(len(log.names))[name]
    full, compact = (guarded(filter, log, 1e-5, shortened) for shortened in (False, True))
    for part in ("mean", "cov", "nis", "dof"):
        expected = getattr(full, part)
        np.testing.assert_allclose(getattr(compact, part), expected, rtol=1e-9, atol=1e-7)
    assert (compact.trust == full.trust).all()
    assert (log.part(slice(2, 9)).used == log.used[2:9]).all()


def test_a_sound_epoch_is_called_apart_as_often_as_is_allowed(steady):
    """Receivers that move, with clocks as the filter assumes: the squared distances are chi-square
    with three degrees of freedom.
    """
    log = positioning.prepare(steady, NAVIGATION, sigma=(NOISE, 0.05))
    S, rng, squares, means = len(log.names), np.random.default_rng(6), [], []
    filter = filters(S, acceleration=0.5)["ekf"]
    L = np.linalg.cholesky(process_noise(1.0, 0.5, *CRYSTAL))
    for _ in range(30):
        x = np.concatenate([PLACE, np.zeros(3), [3e4, 30.0]])
        z, fixes, fix_cov = log.z.copy(), log.fixes.copy(), log.fix_cov.copy()
        for k in range(T):
            at = log.q[k], log.w[k]
            z[k] = pseudorange.measure(x, *at) + log.sigma[k] * rng.normal(size=2 * S)
            z[k, ~np.isfinite(log.z[k])] = np.nan
            used = log.used[k]
            G = pseudorange.jacobian(x, *at)[:S, [0, 1, 2, 6]][used] / log.sigma[k, :S][used, None]
            left = (z[k] - pseudorange.measure(x, *at))[:S][used] / log.sigma[k, :S][used]
            fixes[k] = x
            fixes[k, :3] += np.linalg.lstsq(G, left)[0][:3]
            fix_cov[k] = np.linalg.pinv(G.T @ G)[:3, :3]
            x = transition(1.0) @ x + L @ rng.normal(size=8)
        drawn = replace(
            log, z=z, fixes=fixes, fix_cov=fix_cov, clock=None, correlation=(WHITE, WHITE)
        )
        found = guarded(filter, drawn, 1e-6)
        assert set(found.trust) == {""}
        squares.append(found.apart[3:] * chi2.isf(1e-6, 3))
        means.append(found.drift[WINDOW:] * chi2.isf(1e-6, 3))
    means, squares = np.concatenate(means), np.concatenate(squares)
    # Windows overlap: 30 receivers have some hundred independent means.
    assert means.mean() == pytest.approx(3.0, abs=0.8)
    assert (means > chi2.isf(0.1, 3)).mean() == pytest.approx(0.1, abs=0.07)
    assert squares.mean() == pytest.approx(3.0, abs=0.2)
    for p in (0.5, 0.1, 0.01):
        assert (squares > chi2.isf(p, 3)).mean() == pytest.approx(p, rel=0.25, abs=0.004)


def crept(log, speed, first, ranges=True):
    """The log with the ranges alone, or the rates alone, of a receiver that departs at ``speed``
    m/s.
    """
    along = np.array([0.6, -0.5, 0.62]) / np.linalg.norm([0.6, -0.5, 0.62])
    sources = pseudorange.sources(SKY, TIMES, np.broadcast_to(PLACE, (T, 3)))
    seconds = np.maximum(TIMES - TIMES[first], 0.0)[:, None]
    here, there = np.zeros((2, T, 8))
    here[:, :3] = there[:, :3] = PLACE
    there[:, :3] += speed * seconds * along
    there[:, 3:6] = speed * (seconds > 0.0) * along
    change = [pseudorange.measure(x, sources.q, sources.w) for x in (there, here)]
    change, S = change[0] - change[1], log.code.shape[1]
    if ranges:
        return replace(log, code=log.code + change[:, :S])
    return replace(log, doppler=log.doppler - B1I_HZ / LIGHT * change[:, S:])


@pytest.mark.parametrize("ranges", [True, False])
@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0])
def test_a_slow_pull_is_found_before_it_is_25_m(speed, ranges):
    """Fixes scatter by 2 m, so a single epoch cannot show a drift of a few
    decimeters per second.
    """
    first = 30
    for seed in range(3):
        log = crept(logged(3e4 + 30.0 * (TIMES - TIMES[0]), seed), speed, first, ranges)
        found = positioned(log)
        assert set(found.trust[: first + 1]) == {""}
        assert error(found)[~found.doubtful].max() < 25.0
        assert found.doubtful[-10:].all()
        assert speed > 1.0 or "drifting" in found.trust
        assert report.summary(found).startswith("NOT SOUND")


def test_a_pull_that_ends_costs_trust_only_for_a_while(steady):
    """Ranges drift by 8 m and are correct again afterwards."""
    log = crept(steady, 0.8, 30)
    code = np.where((np.arange(T) < 40)[:, None], log.code, steady.code)
    found = positioned(replace(log, code=code))
    assert set(found.trust[:30]) == set(found.trust[-40:]) == {""}
    assert (found.trust[30:45] != "").any()
    assert error(found).max() < 5.0


def test_where_fixes_scatter_by_more_than_20_m_no_position_is_sound(steady):
    """The track is better, but no test would detect an error of 100 m."""
    log = positioning.prepare(steady, NAVIGATION, sigma=(20.0, 0.05))
    found = report.position(log, "student", PLACE)
    scatter = np.sqrt(np.linalg.eigvalsh(log.fix_cov)[:, -1])
    assert np.sqrt(np.linalg.eigvalsh(found.cov[-30:])[:, -1]).max() < scatter.min()
    assert set(found.integrity[scatter > 20.0]) == {"weak"}
    assert (scatter > 20.0).any()


def test_errors_that_last_are_claimed():
    """Constant errors of satellites do not average out, and the covariance includes them."""
    squares, white = [], []
    for seed in range(8):
        log = logged(3e4 + 30.0 * (TIMES - TIMES[0]), seed)
        constant = 4.0 * np.random.default_rng(100 + seed).normal(size=log.code.shape[1])
        prepared = positioning.prepare(replace(log, code=log.code + constant), NAVIGATION)
        assert prepared.correlation[0].long > 0.5
        found = report.position(prepared, "ekf", PLACE)
        same = replace(prepared, correlation=(WHITE, WHITE))
        for values, each in (
            (squares, found),
            (white, report.position(same, "ekf", PLACE)),
        ):
            values.append(np.square(each.local(each.mean[-1]) / each.local_std[-1]))
        np.testing.assert_array_equal(found.mean, each.mean)
    # Standard deviations are estimated from about five constant residuals, so the mean is above 1:
    # 5/3.
    assert 0.6 < np.mean(squares) < 3.0
    assert np.mean(white) > 3.0 * np.mean(squares)


@pytest.mark.parametrize("many", [2, 3, 4])
def test_epochs_without_redundancy_say_nothing_of_what_lasts(steady, many):
    """Without a fix there are no residuals, and with four satellites the residuals are zero."""
    few, none = steady.code.copy(), steady.code.copy()
    none[40:60] = few[40:60, np.setdiff1d(np.arange(few.shape[1]), four(steady)[:many])] = np.nan
    found, expected = (
        np.array(positioning.prepare(replace(steady, code=code), NAVIGATION).correlation)
        for code in (few, none)
    )
    assert expected[:, [0, 2]].max() < 0.3
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


def moving(path, velocity):
    """A log of a receiver that moves from `PLACE`, ``(T, 3)`` m and m/s."""
    log = logged(3e4 + 30.0 * (TIMES - TIMES[0]))
    sources = pseudorange.sources(SKY, TIMES, np.broadcast_to(PLACE, (T, 3)))
    at_rest, away = (
        pseudorange.measure(np.concatenate([p, v, np.zeros((T, 2))], -1), sources.q, sources.w)
        for p, v in ((PLACE + 0.0 * path, 0.0 * velocity), (PLACE + path, velocity))
    )
    ranges, rates = np.split(away - at_rest, 2, -1)
    return replace(log, code=log.code + ranges, doppler=log.doppler - B1I_HZ / LIGHT * rates)


SECONDS = TIMES[:, None] - TIMES[0]
EAST = np.cross([0.0, 0.0, 1.0], PLACE / np.hypot(*PLACE[:2]))
CIRCLE = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
MOTIONS = {
    "circles of 30 m at 10 m/s": (
        30.0 * (np.cos(SECONDS / 3.0) - 1.0) * CIRCLE[0] + 30.0 * np.sin(SECONDS / 3.0) * CIRCLE[1],
        -10.0 * np.sin(SECONDS / 3.0) * CIRCLE[0] + 10.0 * np.cos(SECONDS / 3.0) * CIRCLE[1],
    ),
    "straight on at 200 m/s": (200.0 * SECONDS * EAST, 200.0 * EAST + 0.0 * SECONDS),
}


@pytest.mark.parametrize("rates", [True, False])
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_receiver_that_moves_is_followed(motion, rates):
    """Its acceleration is estimated from the log, and its velocity from the ranges if there are no
    rates.
    """
    path, velocity = MOTIONS[motion]
    log = moving(path, velocity)
    log = log if rates else replace(log, doppler=np.full_like(log.doppler, np.nan))
    found = positioned(log)
    off = np.linalg.norm(found.mean[:, :3] - PLACE - path, axis=-1)
    assert off.max() < 15.0
    assert not found.doubtful.any()
    assert (found.acceleration > 1.0) == motion.startswith("circles")
