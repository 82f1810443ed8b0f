"""A track compared with the truth: numbers from direct formulas, bands for consistent filters,
gaps, sensors, attitudes, engines.
"""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from readable import faults
from scipy.stats import binom, chi2

import celnav
from celnav.filters.adaptive import gate
from celnav.gaussian import attitude as at
from celnav.gaussian.spaces import wrap
from celnav.models import motion
from celnav.models.gyro import Gyro

MOTION = motion.constant_velocity(2, 0.1)
RADAR = celnav.Sensor(
    lambda x, _epoch: np.stack(
        [np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], -1
    ),
    np.diag([25.0, np.radians(1.0) ** 2]),
    space=celnav.angles([1]),
)
GPS = celnav.Sensor(np.eye(2, 4), R=lambda _mean, _epoch: 100.0 * np.eye(2))
PRIOR = celnav.Gaussian([500.0, 300.0, 10.0, -5.0], np.diag([400.0, 400.0, 4.0, 4.0]))
TIMES = np.arange(41.0)
FILTER = celnav.ukf(MOTION, RADAR, GPS)


def flown(runs=30, seed=0, filter=FILTER, keep="cov", **options):
    truth, z = celnav.simulate(MOTION, [RADAR, GPS], PRIOR, TIMES, runs=runs, seed=seed)
    return celnav.run(filter, PRIOR, TIMES, z, keep=keep, **options), truth


@pytest.fixture(scope="module")
def sound():
    return flown()


def test_numbers_are_those_of_the_formulas(sound):
    track, truth = sound
    found, error = track.report(truth, names=["x", "y", "u", "v"]), track.mean - truth
    for i, c in enumerate(found.components):
        assert c.rmse == pytest.approx(np.sqrt(np.mean(error[..., i] ** 2)))
        assert c.claimed == pytest.approx(np.sqrt(np.mean(track.std[..., i] ** 2)))
        assert c.mean == pytest.approx(error[..., i].mean())
        assert c.inside == np.mean(np.abs(error[..., i]) <= 1.959963985 * track.std[..., i])
        assert c.interval[0] < c.rmse < c.interval[1]
    nees = np.einsum("tri,trij,trj->tr", error, np.linalg.inv(track.cov), error)
    assert found.nees.nis == pytest.approx(nees.mean() / 4.0)
    low, high = chi2.ppf([0.025, 0.975], 4 * 30) / 30
    assert found.within == np.mean((low <= nees.mean(1)) & (nees.mean(1) <= high))
    np.testing.assert_allclose(found.rms, np.sqrt(np.mean(error**2, 1)))
    np.testing.assert_allclose(found.claims, np.sqrt(np.mean(track.std**2, 1)))
    assert [c.name for c in found.components] == ["x", "y", "u", "v"]


def test_sensors_are_told_apart_and_gaps_cost_only_themselves():
    """Also if R is a function, which does not determine the number of components."""
    truth, z = celnav.simulate(MOTION, [RADAR, GPS], PRIOR, TIMES, runs=20)
    z[0][::2], z[1][5:9, :, 1] = np.nan, np.nan
    track = celnav.run(FILTER, PRIOR, TIMES, z, keep="cov")
    found = track.report(truth)
    assert [sensor.names for sensor in found.sensors] == [("z0", "z1"), ("z2", "z3")]
    for sensor, own in zip(found.sensors, (slice(0, 2), slice(2, 4)), strict=True):
        dof = int(track.used[..., own].sum())
        assert sensor.nis == pytest.approx(np.sum(track.whitened[..., own] ** 2) / dof)
        assert sensor.band == pytest.approx(tuple(chi2.ppf([0.025, 0.975], dof) / dof))
    assert found.sensors[0].dof.sum() == 20 * 20 * 2
    assert found.sensors[1].dof.sum() == 20 * (41 * 2 - 4)
    assert found.events["missing"] == 21 * 20 * 2 + 4 * 20
    assert "of 800 components used" in str(found)
    assert "920 components missing" in str(found)


def test_what_is_not_known_of_the_truth_is_left_out(sound):
    track, truth = sound
    some = truth.copy()
    some[10:, :, 2] = np.nan
    found = track.report(some)
    error = (track.mean - truth)[:10, :, 2]
    assert found.components[2].rmse == pytest.approx(np.sqrt(np.mean(error**2)))
    assert found.components[2].claimed == pytest.approx(np.sqrt(np.mean(track.std[:10, :, 2] ** 2)))
    assert found.nees.dof.tolist() == [120] * 10 + [0] * 31
    late = track.report(truth, start=10.0)
    assert late.times[0] == 10.0
    assert late.components[2].rmse == pytest.approx(
        np.sqrt(np.mean((track.mean - truth)[10:, :, 2] ** 2))
    )


@pytest.mark.parametrize("runs", [1, 8])
def test_a_consistent_filter_is_in_the_bands_as_often_as_they_say(runs):
    """In 95 % of the simulations; the bands of NEES are estimated, so slightly
    fewer are accepted.
    """
    gps = celnav.Sensor(np.eye(2, 4), 100.0 * np.eye(2))
    filter, times, flights = celnav.ukf(MOTION, gps), np.arange(150.0), 120
    truth, z = celnav.simulate(MOTION, gps, PRIOR, times, runs=runs * flights, seed=7)
    held = np.zeros(2, int)
    for i in range(flights):
        own = slice(i * runs, (i + 1) * runs)
        found = celnav.run(filter, PRIOR, times, z[:, own], keep="cov").report(truth[:, own])
        held += [one.band[0] <= one.nis <= one.band[1] for one in (found.nees, found.sensors[0])]
    assert held[1] >= binom.ppf(1e-3, flights, 0.95)
    assert held[0] >= binom.ppf(1e-3, flights, 0.9)


def test_an_overconfident_filter_is_called_so():
    bold = celnav.ukf(
        MOTION,
        celnav.Sensor(RADAR.h, 0.25 * np.diag([25.0, np.radians(1.0) ** 2]), space=RADAR.space),
        GPS,
    )
    track, truth = flown(filter=bold)
    found = track.report(truth)
    assert found.nees.nis > found.nees.band[1]
    assert found.sensors[0].nis > found.sensors[0].band[1]
    assert "overconfident" in str(found)
    assert found.components[0].inside < 0.93


def test_nis_below_its_band_with_nees_above_it_is_called_correlated_noise():
    """A filter that treats AR(1) noise as white follows the noise, so its innovations are small; a
    small R makes NIS and NEES large.
    """
    said = "NIS 0    below its band while NEES is above it: the noise of the measurements is correlated"
    walk = motion.constant_velocity(2, 1e-4)
    gps = celnav.Sensor(np.eye(2, 4), R=19.0 * np.eye(2))
    colored = celnav.colored(walk, gps, 0.95)
    truth, z = celnav.simulate(walk, gps, PRIOR, TIMES, runs=40, seed=3, Phi=0.95 * np.eye(2))
    assert said in str(celnav.run(celnav.ukf(walk, gps), PRIOR, TIMES, z, keep="cov").report(truth))
    assert said not in str(celnav.run(colored, PRIOR, TIMES, z, keep="cov").report(truth))
    close = replace(gps, R=2.0 * np.eye(2))
    assert said not in str(
        celnav.run(celnav.ukf(walk, close), PRIOR, TIMES, z, keep="cov").report(truth)
    )


WALK = motion.constant_velocity(2, 0.1)
FIXES = celnav.Sensor(np.eye(2, 4), 100.0 * np.eye(2))


def fixed(runs, R=1.0, seed=0, **options):
    """Fixes of a nearly constant velocity, filtered with R times their covariance."""
    truth, z = celnav.simulate(WALK, FIXES, PRIOR, TIMES, runs=runs, seed=seed)
    filter = celnav.ukf(WALK, replace(FIXES, R=R * FIXES.R))
    return celnav.run(filter, PRIOR, TIMES, z, keep="cov", **options), truth


def test_few_runs_that_dominate_the_nees_are_told_with_the_median():
    """Three runs with large errors, the largest in run 70, from the middle on in run 5."""
    track, truth = fixed(100)
    sound = track.report(truth)
    assert sound.dominant is None
    spoiled = truth.copy()
    spoiled[:, 70, 0] += 300.0
    spoiled[:, 11, 1] -= 200.0
    spoiled[20:, 5, 2] += 20.0
    found = track.report(spoiled)
    assert found.nees.nis > 5.0
    assert found.dominant.runs == (70, 11, 5)
    assert found.dominant.median == pytest.approx(1.0, abs=0.1)
    kept = np.delete(np.arange(100), [70, 11, 5])
    alone = replace(track, **{name: getattr(track, name)[:, kept] for name in ("mean", "std")})
    alone = replace(alone, belief=type(track.belief)(*(x[:, kept] for x in track.belief)))
    others = alone.report(truth[:, kept]).nees
    assert found.dominant.others[:3] == others[:3]
    said = str(found).replace("\n         ", " ")
    assert (
        f"NEES     dominated by 3 of 100 runs (largest: run 70); median run "
        f"{found.dominant.median:.4g}; the others {others.nis:.4g}, consistent (95 % of"
    ) in said
    assert "dominated" not in str(sound)
    spoiled[:, 70] = np.nan  # a run without a truth
    assert track.report(spoiled).dominant.runs == (11, 5)
    spoiled[:, 20:70] = spoiled[:, 71:] = np.nan  # two of twenty that count, then two of three
    assert track.report(spoiled).dominant.runs == (11, 5)
    spoiled[:, 6:11] = spoiled[:, 12:20] = spoiled[:, 1:5] = np.nan
    assert track.report(spoiled).dominant is None


def test_a_filter_that_is_overconfident_in_all_runs_is_not_excused_by_few():
    """And neither is one with a band of its own error in half of the runs."""
    track, truth = fixed(100, R=0.5)
    truth[:, 70, 0] += 300.0
    assert track.report(truth).dominant is None
    track, truth = fixed(20)
    truth[:, ::2, 0] += 300.0
    found = track.report(truth)
    assert found.nees.nis > found.nees.band[1]
    assert found.dominant is None


@pytest.mark.parametrize("R", [1.0, 0.9])
def test_large_runs_are_no_false_alarm(R):
    """Consistent filters, and filters that are slightly overconfident in all runs: 200 reports."""
    track, truth = fixed(4000, R, seed=1)
    every = (track.mean, track.std, *track.belief)
    inconsistent = 0
    for first in range(0, 4000, 20):
        some = slice(first, first + 20)
        mean, std, *belief = (x[:, some] if x.shape[1] > 1 else x for x in every)
        part = replace(track, mean=mean, std=std, belief=type(track.belief)(*belief), sensors=())
        found = part.report(truth[:, some])
        inconsistent += found.nees.nis > found.nees.band[1]
        assert found.dominant is None
    assert inconsistent >= 3


@pytest.mark.parametrize("form", ["square root", "covariance"])
def test_attitudes_are_judged_by_rotation_vectors_whatever_the_sign(form):
    gyro, rng, dt, T, runs = (
        Gyro.datasheet(3.0, rate_random_walk=20.0),
        np.random.default_rng(3),
        1.0,
        60,
        40,
    )
    space = celnav.product((celnav.attitude(), 4, 3), (celnav.EUCLIDEAN, 3, 3))
    believed = celnav.Motion(
        lambda x, epoch: gyro.propagate(x, epoch.u, epoch.dt), Q=gyro.process_noise(dt), space=space
    )
    star = celnav.Sensor(
        lambda x, _epoch: x[..., :4], R=np.radians(0.01) ** 2 * np.eye(3), space=celnav.attitude()
    )
    prior = celnav.Gaussian(
        np.r_[at.IDENTITY, 0.0, 0.0, 0.0], np.diag(np.repeat([np.radians(0.5), 1e-5], 3) ** 2)
    )
    u = np.broadcast_to([0.02, -0.01, 0.03], (T - 1, 3))
    truth, z = celnav.simulate(believed, star, prior, dt * np.arange(T), runs=runs, u=u)
    track = celnav.run(
        celnav.ukf(believed, star, form=form), prior, dt * np.arange(T), z, u, keep="cov"
    )
    found = track.report(
        truth * np.where(rng.random((T, runs, 1)) < 0.5, np.r_[-np.ones(4), np.ones(3)], 1.0)
    )
    angle = 2.0 * np.arccos(
        np.clip(np.abs(np.vecdot(track.mean[..., :4], truth[..., :4])), 0.0, 1.0)
    )
    assert len(found.components) == 6
    assert np.sqrt(sum(c.rmse**2 for c in found.components[:3])) == pytest.approx(
        np.sqrt(np.mean(angle**2)), rel=1e-3
    )
    assert found.nees.band[0] <= found.nees.nis <= found.nees.band[1]
    alone = pickle.loads(pickle.dumps(track)).report(
        truth, space=space
    )  # a pickled track has no filter
    assert alone.nees.nis == pytest.approx(found.nees.nis)
    with pytest.raises(
        ValueError, match=r"space: expected the space of the states, which are no vectors"
    ):
        replace(track, filter=None).report(truth)


@pytest.mark.parametrize(
    "wrap",
    [
        lambda f: f,
        lambda f: celnav.imm([f, f], 0.5 * np.ones((2, 2))),
        lambda f: celnav.filters.switching.Switching(
            [f].__getitem__, lambda belief, epoch, chosen: np.zeros(10, int)
        ),
    ],
)
def test_angles_of_a_state_wrap_in_filters_within_filters_too(wrap):
    believed = celnav.Motion(
        lambda x, epoch: x + epoch.dt * 0.5, Q=1e-4 * np.eye(1), space=celnav.angles([0])
    )
    compass = celnav.Sensor(lambda x, _epoch: x, 0.01 * np.eye(1), space=celnav.angles([0]))
    prior, times = celnav.Gaussian([3.0], [[0.01]]), np.arange(50.0)
    truth, z = celnav.simulate(believed, compass, prior, times, runs=10)
    track = celnav.run(wrap(celnav.ukf(believed, compass)), prior, times, z, keep="cov")
    plain, turned = (
        track.report(truth + turns * 2.0 * np.pi).components[0].rmse for turns in (0, 1)
    )
    assert turned == pytest.approx(plain)
    assert plain < 0.1


@pytest.mark.parametrize("make", [celnav.ukf, celnav.ekf])
def test_compiled_flights_are_judged_the_same(make):
    truth, z = celnav.simulate(MOTION, [RADAR, GPS], PRIOR, TIMES, runs=12)
    z[1][::3] = np.nan
    filter = make(MOTION, RADAR, GPS)
    plain, machine = (
        celnav.run(filter, PRIOR, TIMES, z, keep="cov", engine=engine).report(truth)
        for engine in ("numpy", "compiled")
    )
    assert str(machine) == str(plain)
    np.testing.assert_allclose(machine.rms, plain.rms, rtol=1e-8)
    np.testing.assert_allclose(machine.nees.squares, plain.nees.squares, rtol=1e-6)


def test_a_state_may_hold_more_than_the_truth():
    gps = celnav.Sensor(np.eye(2, 4), 100.0 * np.eye(2))
    truth, z = celnav.simulate(MOTION, gps, PRIOR, TIMES, runs=10, Phi=0.8 * np.eye(2))
    track = celnav.run(celnav.augmented(MOTION, gps, 0.8 * np.eye(2)), PRIOR, TIMES, z, keep="cov")
    found = track.report(truth)
    cov = track.cov[..., :4, :4]
    error = track.mean[..., :4] - truth
    assert len(found.components) == 4
    assert found.nees.nis == pytest.approx(
        np.einsum("tri,trij,trj->tr", error, np.linalg.inv(cov), error).mean() / 4.0
    )


def test_one_run_one_truth_of_many_and_no_covariances(sound):
    track, truth = sound
    alone = celnav.run(
        FILTER,
        PRIOR,
        TIMES,
        (np.tile([580.0, 0.5], (41, 1)), np.tile([500.0, 300.0], (41, 1))),
        keep="std",
    )
    found = alone.report(truth[:, 0])
    assert found.nees is None
    assert "no covariances are stored: run with keep='cov'" in str(found)
    assert str(found).startswith("one run, 41 epochs from 0 to 40 s")
    assert "to" not in str(found).splitlines()[3]  # no interval of one run
    assert track.report(truth[:, 0]).runs == 30


def test_a_forgotten_wrap_of_a_sensor_or_of_the_state_is_said_by_name():
    south = celnav.Gaussian([-300.0, -100.0, 0.0, 3.0], np.diag([100.0, 100.0, 1.0, 1.0]))
    times = np.arange(200.0)
    truth, z = celnav.simulate(MOTION, RADAR, south, times, runs=20, seed=3)
    unwrapped = celnav.Sensor(RADAR.h, RADAR.R)
    lost, sound = (
        celnav.run(celnav.ekf(MOTION, sensor), south, times, z, on_failure="flag").report(truth)
        for sensor in (unwrapped, RADAR)
    )
    (line,) = lost.wraps
    assert line.startswith("z1: ")
    assert line.endswith("the cure is celnav.Sensor(..., space=celnav.angles([1]))")
    assert "wrap     z1: " in str(lost)
    assert sound.wraps == ()
    assert "wrap " not in str(sound)
    turning = celnav.Motion([[1.0, 1.0], [0.0, 1.0]], np.diag([1e-5, 1e-7]))
    compass, start = (
        celnav.Sensor(np.eye(1, 2), [[0.01]]),
        celnav.Gaussian([2.0, 0.02], np.diag([0.01, 1e-6])),
    )
    truth, z = celnav.simulate(turning, compass, start, times, runs=10, seed=3)
    track = celnav.run(celnav.ukf(turning, compass), start, times, z)
    assert track.report(truth).wraps == ()
    truth[..., 0] = wrap(truth[..., 0])
    (line,) = track.report(truth, names=["heading", "rate"]).wraps
    assert line.startswith("heading: 10 of 2000 samples jump by 2 pi")
    assert line.endswith("the cure is celnav.Motion(..., space=celnav.angles([0]))")


def test_a_truth_that_is_known_now_and_then_counts_as_samples_of_its_own():
    """At each tenth epoch, as if there were no other epochs."""
    gps = celnav.Sensor(np.eye(2, 4), 100.0 * np.eye(2))
    truth, z = celnav.simulate(MOTION, gps, PRIOR, np.arange(400.0), runs=1, seed=2)
    track = celnav.run(celnav.ukf(MOTION, gps), PRIOR, np.arange(400.0), z, keep="cov")
    some = np.full_like(truth, np.nan)
    some[::10] = truth[::10]
    sparse, alone = (
        report.nees
        for report in (
            track.report(some),
            celnav.run(
                celnav.ukf(MOTION, gps), PRIOR, np.arange(400.0), z, keep="cov", every=10
            ).report(truth[::10]),
        )
    )
    assert sparse.nis == pytest.approx(alone.nis)
    assert sparse.shared == pytest.approx(alone.shared)
    assert sparse.shared > 1.0
    assert sparse.band == pytest.approx(alone.band)


def test_lost_runs_and_rejections_are_told():
    gated = celnav.ukf(MOTION, RADAR, GPS, hooks=[gate(2.0)])
    track, truth = flown(filter=gated)
    found = track.report(truth)
    assert sum(found.rejected) == found.events["rejected"] > 0
    assert f"{found.rejected[0]} rejected" in str(found).replace("\n         ", " ")
    calls = celnav.Motion(
        lambda x, epoch: (
            np.where((epoch.k == 20) & (x[..., :1] > 700.0), np.nan, 1.0)
            * (x @ MOTION.f.matrix(epoch).T)
        ),
        np.eye(4),
    )
    truth, z = celnav.simulate(MOTION, GPS, PRIOR, TIMES, runs=30)
    lost = celnav.run(celnav.ukf(calls, GPS), PRIOR, TIMES, z, keep="cov", on_failure="flag")
    assert 0 < np.count_nonzero(lost.failed_at >= 0) < 30
    told = lost.report(truth)
    assert [run for run, _ in told.lost] == np.flatnonzero(lost.failed_at >= 0).tolist()
    assert {t for _, t in told.lost} == {20.0}
    assert f"{len(told.lost)} of 30 runs lost, the first (run {told.lost[0][0]}) at 20 s" in str(
        told
    )
    assert np.isfinite([c.rmse for c in told.components]).all()
    assert told.nees.dof.tolist() == [120] * 20 + [4 * (30 - len(told.lost))] * 21


def test_the_figure_shows_each_component_and_each_ratio(sound):
    track, truth = sound
    fig = track.report(truth, names=["x (m)", "y (m)", "u (m/s)", "v (m/s)"]).figure()
    drawn = [ax for ax in fig.axes if ax.axison]
    assert [ax.get_ylabel() for ax in drawn[:4]] == ["x (m)", "y (m)", "u (m/s)", "v (m/s)"]
    assert [ax.get_title() for ax in drawn[4:]] == [
        "NEES / n",
        "NIS / dof: z0, z1",
        "NIS / dof: z2, z3",
    ]
    np.testing.assert_allclose(
        drawn[0].lines[0].get_ydata(), np.sqrt(np.mean((track.mean - truth)[..., 0] ** 2, 1))
    )
    assert not faults(fig)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (
            lambda truth: {"truth": truth[:5]},
            r"truth: expected shape \(41, 30, 4\), at the track's epochs, got \(5, 30, 4\)$",
        ),
        (
            lambda truth: {"truth": np.repeat(truth, 2, 0)},
            r"got \(82, 30, 4\); truth\[::every\] goes with",
        ),
        (lambda truth: {"truth": truth[:, :7]}, r"got \(41, 7, 4\)$"),
        (
            lambda truth: {"truth": truth, "names": ["x"]},
            r"names: expected 4 words, one for each component of the error, got \['x'\]",
        ),
        (
            lambda truth: {"truth": truth, "start": 99.0},
            r"start: expected at most 40, the last epoch, got 99.0",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(sound, change, text):
    with pytest.raises(ValueError, match=text):
        sound[0].report(**change(sound[1]))


def test_a_track_without_deviations_is_refused():
    track, truth = flown(runs=2, keep="mean")
    with pytest.raises(
        ValueError,
        match="track: expected one with means and deviations; run with keep='cov', or 'std'",
    ):
        track.report(truth)


# -- texts -----------------------------------------------------------------------------------------
def by_hand(sigma, runs, spoiled=False, **options):
    """The report for fixes and speeds at six epochs, with the errors given here."""
    error = (
        0.5
        * np.array(
            [
                [1, -1, 2, -2, 0],
                [0, 1, -1, 0, 1],
                [-1, 2, 0, 1, 1],
                [2, 0, -2, -1, 0],
                [1, 1, -1, 9, 0],
                [0, -2, 1, 1, -1],
            ]
        )[:, :runs, None]
    )
    start = np.array([0.0, 0.0, 0.0, 0.0, 50.0])[:runs]
    times = 0.5 * np.arange(6.0)
    truth = np.stack(np.broadcast_arrays(start + times[:, None], 1.0), -1)
    fixes, speeds = truth[..., :1] + error, truth[..., 1:] - 0.5 * error[::-1]
    if spoiled:
        speeds[2, 1] = fixes[3] = np.nan

    def f(x, epoch):
        """The last run fails at the fifth epoch."""
        lost = spoiled & (epoch.k == 4) & (x[..., :1] > 40.0)
        return np.where(lost, np.nan, x @ np.array([[1.0, epoch.dt], [0.0, 1.0]]).T)

    filter = celnav.ukf(
        celnav.Motion(f, np.diag([0.0, 0.04])),
        celnav.Sensor([[1.0, 0.0]], [[sigma**2]]),
        celnav.Sensor([[0.0, 1.0]], [[sigma**2 / 4.0]]),
        hooks=[gate(3.0)] if spoiled else [],
    )
    prior = celnav.Gaussian(np.stack(np.broadcast_arrays(start, 1.0), -1), np.diag([4.0, 1.0]))
    track = celnav.run(filter, prior, times, (fixes, speeds), on_failure="flag", **options)
    return str(track.report(truth, names=["position (m)", "speed (m/s)"]))


def test_the_text_of_many_runs_with_all_that_can_happen():
    assert (
        by_hand(1.0, 5, spoiled=True, keep="cov")
        == """\
5 runs, 6 epochs from 0 to 2.5 s

component       RMSE              95 %  predicted σ  mean error  inside 95 %
position (m)  0.3172  0.2004 to 0.4129       0.6633      0.0685      100.0 %
speed (m/s)   0.1518  0.1179 to 0.1976       0.3498   -0.000421      100.0 %

NEES     over 2: 0.1844, conservative (95 % of consistent ones: 0.6645 to 1.403), correlation of errors
         counted; in the band of the runs' mean at 17 % of the epochs
NIS 0    z0: 0.2726, conservative (95 % of consistent ones: 0.4992 to 1.672); of 22 components used, 1
         rejected
NIS 1    z1: 0.3197, conservative (95 % of consistent ones: 0.5325 to 1.612); of 26 components used, 1
         rejected
events   10 components missing, 2 components rejected, 1 of 5 runs lost, the first (run 4) at 2 s; earlier
         epochs count"""
    )


def test_the_text_of_runs_without_events():
    assert (
        by_hand(0.6, 4, keep="cov")
        == """\
4 runs, 6 epochs from 0 to 2.5 s

component       RMSE               95 %  predicted σ  mean error  inside 95 %
position (m)  0.4347   0.1713 to 0.7916       0.3878      0.0311       91.7 %
speed (m/s)   0.3523  0.08347 to 0.8036       0.2261      -0.109       91.7 %

NEES     over 2: 1.726, overconfident (95 % of consistent ones: 0.586 to 1.523), correlation of errors
         counted; in the band of the runs' mean at 83 % of the epochs
NEES     dominated by 1 of 4 runs (largest: run 3); median run 0.6378; the others 0.585, conservative (95 % of
         consistent ones: 0.5927 to 1.512)
NIS 0    z0: 3.558, overconfident (95 % of consistent ones: 0.5167 to 1.64); of 24 components used
NIS 1    z1: 2.081, overconfident (95 % of consistent ones: 0.5167 to 1.64); of 24 components used
events   none: nothing missing, rejected or lost"""
    )


def test_the_text_of_one_run_that_claims_too_little():
    assert (
        by_hand(0.1, 1, keep="std")
        == """\
one run, 6 epochs from 0 to 2.5 s

component       RMSE  predicted σ  mean error  inside 95 %
position (m)  0.2655      0.06686       0.189       33.3 %
speed (m/s)   0.2573      0.04881      -0.122       33.3 %

NEES     no covariances are stored: run with keep='cov'
NIS 0    z0: 29.68, overconfident (95 % of consistent ones: 0.2062 to 2.408); of 6 components used
NIS 1    z1: 2.228, consistent (95 % of consistent ones: 0.2062 to 2.408); of 6 components used
events   none: nothing missing, rejected or lost"""
    )
