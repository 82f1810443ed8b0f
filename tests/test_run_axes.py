"""Without an axis of runs, with one run and with several, every public function gives the same
result for the same run.
"""

from __future__ import annotations

import csv

import numpy as np
import pytest

import celnav
from celnav.analysis import bounds, metrics, observability
from celnav.analysis.diagnose import diagnose, first_order
from celnav.analysis.tuning import likelihood_gradient, maximize_likelihood
from celnav.filters import adaptive
from celnav.filters.fixed_lag import FixedLag
from celnav.filters.switching import Fallback, Switching
from celnav.gaussian.belief import nees
from celnav.models.motion import constant_velocity
from celnav.show import diagnosis
from celnav.show.estimates import Estimate
from celnav.study.trial import Group

T, RUNS = 40, 3
TIMES = np.arange(float(T))
F = np.eye(4) + np.eye(4, k=2)
Q = 0.05 * np.kron([[1.0 / 3.0, 0.5], [0.5, 1.0]], np.eye(2))
MOTION, GPS = celnav.Motion(F, Q), celnav.Sensor(np.eye(2, 4), 4.0 * np.eye(2))
SMOOTH = constant_velocity(2, 0.05)
RADAR = celnav.Sensor(
    lambda x, _epoch: np.stack(
        [np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], -1
    ),
    np.diag([25.0, 1e-4]),
    space=celnav.angles([1]),
)
PRIOR = celnav.Gaussian([300.0, 200.0, 1.0, -1.0], np.diag([9.0, 9.0, 1.0, 1.0]))
PHI = 0.7 * np.eye(2)
TRUTH, Z = celnav.simulate(MOTION, GPS, PRIOR, TIMES, runs=RUNS, seed=4, Phi=PHI)
ANGLES = celnav.simulate(SMOOTH, RADAR, PRIOR, TIMES, runs=RUNS, seed=5)[1]
for z in (Z, ANGLES):
    z[20:24, :, 1] = np.nan
PICK = {"none": np.s_[:, 0], "one": np.s_[:, :1], "several": np.s_[:]}


def three(function, *data):
    """Results of a function of data ``(T, ..., m)`` for run 0 without the axis of runs, for run 0
    with the axis, and for all runs.
    """
    return tuple(function(*(x[pick] for x in data)) for pick in PICK.values())


def same(none, one, several, axis=1):
    """Compare the results for run 0 without an axis of runs, for one run, and for several runs."""
    for many, runs in ((one, 1), (several, RUNS)):
        assert many.shape == (*none.shape[:axis], runs, *none.shape[axis:])
        np.testing.assert_allclose(many.take(0, axis), none, rtol=1e-9, atol=1e-9)


def alike(a, b):
    """Compare records and tuples number by number."""
    if isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            alike(x, y)
    elif isinstance(a, float | np.ndarray):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9)
    else:
        assert a == b


ROWS = ("mean", "std", "cov", "innovation", "whitened", "used", "nis", "dof")


def same_tracks(tracks):
    for name in ROWS:
        same(*(getattr(track, name) for track in tracks))
    for name in ("log_likelihood", "failed_at"):
        same(*(getattr(track, name) for track in tracks), axis=0)
    for what in tracks[0].events:
        same(*(track.events[what] for track in tracks), axis=0)
    for name in tracks[0].extra:
        same(*(track.extra[name] for track in tracks))


FILTERS = {
    "ukf": celnav.ukf(MOTION, GPS),
    "ekf": celnav.ekf(SMOOTH, GPS, iterations=2),
    "ckf": celnav.ckf(SMOOTH, GPS, form="covariance"),
    "ghkf": celnav.ghkf(MOTION, GPS),
    "sparse grid": celnav.sparse_grid_filter(MOTION, GPS),
    "sigma point": celnav.sigma_point(MOTION, GPS, rule=celnav.simplex),
    "colored": celnav.colored(MOTION, GPS, PHI),
    "decorrelated": celnav.decorrelated(MOTION, GPS, PHI),
    "augmented": celnav.augmented(MOTION, GPS, PHI),
    "two stage": celnav.two_stage(MOTION, GPS, np.eye(2), celnav.Gaussian([0.0, 0.0], np.eye(2))),
    "imm": celnav.imm([celnav.ukf(MOTION, GPS), celnav.ukf(SMOOTH, GPS)], 0.5 * np.ones((2, 2))),
    "gate": celnav.ukf(MOTION, GPS, hooks=[adaptive.gate(2.0)]),
    "chi-square gate": celnav.ukf(MOTION, GPS, hooks=[adaptive.chi_square_gate()]),
    "window": celnav.ukf(MOTION, GPS, hooks=[adaptive.innovation_window(10)]),
    "huber": celnav.ukf(MOTION, GPS, hooks=[adaptive.huber()]),
    "Student's t": celnav.ukf(MOTION, GPS, hooks=[adaptive.student_t()]),
    "variational Bayes": celnav.ukf(MOTION, GPS, hooks=[adaptive.variational_bayes()]),
    "fallback": Fallback(celnav.ukf(MOTION, GPS), celnav.ekf(MOTION, GPS)),
    "sage and husa": celnav.ukf(MOTION, GPS, hooks=[adaptive.sage_husa()]),
    "correntropy": celnav.ukf(MOTION, GPS, hooks=[adaptive.correntropy()]),
    "underweighting": celnav.ukf(MOTION, GPS, hooks=[adaptive.underweighting()]),
    "considered": celnav.ukf(MOTION, GPS, gain=adaptive.consider(3, 1)),
    "fixed lag": FixedLag(celnav.ukf(MOTION, GPS), 5),
    "switching": Switching(
        [celnav.ukf(MOTION, GPS), celnav.ekf(MOTION, GPS)].__getitem__,
        lambda belief, _epoch, _chosen: (belief.std[..., 0] < 1.0).astype(int),
    ),
}


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_runs_them_all(name):
    """Also for steps, exported tracks and reports."""
    filter = FILTERS[name]
    tracks = three(lambda z: celnav.run(filter, PRIOR, TIMES, z, keep="cov"), Z)
    same_tracks(tracks)
    last = [
        state.belief.mean
        for z in (Z[:, 0], Z[:, :1], Z)
        for *_, (_, state, _) in [celnav.steps(filter, PRIOR, celnav.epochs(TIMES, z))]
    ]
    same(*last, axis=0)
    none, one, _ = (
        track.report(truth) for track, truth in zip(tracks, three(np.copy, TRUTH), strict=True)
    )
    alike(none, one)
    assert str(none) == str(one)
    first, second = map(diagnose, tracks[:2])
    alike(first[:-2], second[:-2])
    assert str(first) == str(second)


def test_reports_and_diagnoses_of_several_runs_are_those_of_each(tmp_path):
    """They include the errors, predictions and innovations of run 0; figures and tables show all
    runs.
    """
    tracks = three(lambda z: celnav.run(FILTERS["ukf"], PRIOR, TIMES, z, keep="cov"), Z)
    truths = three(np.copy, TRUTH)
    alone, _, several = (t.report(x) for t, x in zip(tracks, truths, strict=True))
    each = [
        celnav.run(FILTERS["ukf"], PRIOR, TIMES, Z[:, r], keep="cov").report(TRUTH[:, r])
        for r in range(RUNS)
    ]
    for i in range(4):
        squares = [report.components[i].rmse ** 2 for report in each]
        assert several.components[i].rmse == pytest.approx(np.sqrt(np.mean(squares)))
    assert several.nees.nis == pytest.approx(np.mean([report.nees.nis for report in each]))
    np.testing.assert_allclose(alone.nees.squares, each[0].nees.squares)
    for track, truth, runs in zip(tracks, truths, (1, 1, RUNS), strict=True):
        shown = track.report(truth).figure()
        assert sum(ax.axison for ax in shown.axes) == 6
        assert len(diagnosis.figure(diagnose(track)).axes) == 2
        track.to_csv(tmp_path / "track.csv")
        with (tmp_path / "track.csv").open(encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if row["run"] == "0"]
        np.testing.assert_allclose([float(row["x0"]) for row in rows], tracks[0].mean[:, 0])
        assert len(track.to_dataframe()) == runs * T


def test_a_diagnosis_with_its_model_is_the_same():
    """For a log without an axis of runs it once raised a raw TypeError."""
    complete, filter = np.where(np.isnan(Z), TRUTH[..., :2], Z), FILTERS["ukf"]
    none, one, several = three(
        lambda z: diagnose(celnav.run(filter, PRIOR, TIMES, z), prior=PRIOR, z=z), complete
    )
    alike(none[:-2], one[:-2])
    for name in ("gain", "white_gain", "p", "predicted", "white_predicted"):
        found, expected = (getattr(each.model, name) for each in (none, one))
        np.testing.assert_allclose(found, expected, rtol=1e-3)
    assert none.model.predicted.shape == several.model.predicted.shape == (4,)
    assert "celnav.colored(motion, sensor, Phi=np.diag([" in str(none)
    assert str(several).startswith("3 runs")


def test_residuals_in_an_array():
    x = Z - TRUTH[..., :2]
    none, one, several = (diagnose(rows, TIMES, std=2.0) for rows in three(np.copy, x))
    alike(none, one)
    assert str(none) == str(one)
    assert several.runs == RUNS
    place = np.arange(T)
    alike(
        first_order(x[:, :1, 0], place, 5, 0.95),
        first_order(np.stack([x[:, 0, 0], np.full(T, np.nan)], 1), place, 5, 0.95),
    )


@pytest.mark.parametrize("filter", [celnav.ukf(SMOOTH, RADAR), celnav.ekf(SMOOTH, RADAR)])
def test_smoothers(filter):
    tracks = three(lambda z: celnav.run(filter, PRIOR, TIMES, z, keep="cov"), ANGLES)
    same_tracks(tracks)
    same_tracks([celnav.smooth(track, gains=True) for track in tracks])
    same_tracks(
        three(
            lambda z: celnav.iterated_smoother(filter, PRIOR, TIMES, z, iterations=3, gains=True),
            ANGLES,
        )
    )


def test_late_samples_of_a_fixed_lag():
    fixed = FixedLag(celnav.ukf(MOTION, GPS), 5)

    def delayed(z):
        state, on_time = fixed.start(PRIOR), z.copy()
        on_time[27] = np.nan
        for epoch in celnav.epochs(TIMES[:30], on_time[:30]):
            state, _ = fixed.step(state, epoch)
        return celnav.smooth(fixed.track(fixed.late(state, 27, z[27])[0]))

    same_tracks(three(delayed, Z))


@pytest.mark.parametrize("name", ["ukf", "ekf", "imm", "two stage", "augmented"])
def test_machine_code(name):
    pytest.importorskip("llvmlite")
    compiled = celnav.compiled(FILTERS[name])
    tracks = three(lambda z: compiled.run(PRIOR, TIMES, z, keep="cov"), Z)
    same_tracks(tracks)
    again = three(
        lambda z: celnav.run(FILTERS[name], PRIOR, TIMES, z, keep="cov", engine="auto"), Z
    )
    same_tracks(again)


def test_priors_inputs_and_two_sensors_with_an_axis_of_their_own():
    """Axes of runs in the prior, the inputs and the noise behave like axes of runs in the
    measurements.
    """

    def pushed(x, epoch):
        return x @ F.T + np.concatenate([0.0 * epoch.u, epoch.u], -1)

    filter = celnav.ukf(
        celnav.Motion(pushed, Q), GPS, celnav.Sensor(RADAR.h, RADAR.R, space=RADAR.space)
    )
    u = np.random.default_rng(1).normal(0.0, 0.1, (T - 1, RUNS, 2))
    same_tracks(
        three(
            lambda z, angles, u: celnav.run(filter, PRIOR, TIMES, (z, angles), u, keep="cov"),
            Z,
            ANGLES,
            u,
        )
    )
    means = PRIOR.mean + np.arange(3.0)[None, :, None] * np.ones(4)
    same_tracks(
        three(
            lambda z, mean: celnav.run(
                FILTERS["ukf"], celnav.Gaussian(mean[0], PRIOR.cov), TIMES, z, keep="cov"
            ),
            Z,
            means,
        )
    )


def test_drawn_runs_do_not_depend_on_their_number():
    alone, several = (celnav.simulate(MOTION, GPS, PRIOR, TIMES, runs=n, seed=4) for n in (1, RUNS))
    for one, many in zip(alone, several, strict=True):
        np.testing.assert_array_equal(one[:, 0], many[:, 0])


def test_problems_are_compared_of_one_run_and_of_several():
    problem = celnav.Problem(MOTION, GPS, PRIOR, TIMES)
    makes = {"UKF": lambda p: celnav.ukf(p.motion, p.sensor)}
    (one,), (several,) = (celnav.compare({"walk": problem}, makes, runs=n) for n in (1, RUNS))
    truth, z = problem.draw([celnav.study.montecarlo.generator(0, 0, run) for run in range(RUNS)])
    error = (celnav.run(celnav.ukf(MOTION, GPS), PRIOR, TIMES, z).mean - truth)[T // 2 :]
    assert one.rms == pytest.approx(np.sqrt((error[:, 0] ** 2).sum(-1).mean()))
    assert several.rms == pytest.approx(np.sqrt((error**2).sum(-1).mean()))
    assert np.isnan([one.rms_low, one.rms_high]).all()


def test_likelihoods_and_their_maximum():
    def build(parameters):
        return celnav.ukf(MOTION, celnav.Sensor(GPS.h, parameters[0] ** 2 * np.eye(2))), PRIOR

    def gradient(z, engine):
        return likelihood_gradient(build, [2.0], celnav.epochs(TIMES, z), engine=engine)

    for engine in ("numpy", "auto"):
        found = three(lambda z, engine=engine: gradient(z, engine), Z)
        same(*(each.value for each in found), axis=0)
        same(*(each.gradient for each in found), axis=0)
    none, one, several = three(
        lambda z: maximize_likelihood(build, [1.0], celnav.epochs(TIMES, z)), Z
    )
    np.testing.assert_allclose(none.parameters, one.parameters)
    assert none.log_likelihood == pytest.approx(one.log_likelihood)
    each = [run_of.value for run_of in (gradient(Z[:, r], "numpy") for r in range(RUNS))]
    assert gradient(Z, "numpy").value.sum() == pytest.approx(np.sum(each))
    assert several.converged


def test_bounds():
    P0, R = PRIOR.cov, 4.0 * np.eye(2)
    Fs, H = np.tile(F, (10, 1, 1)), np.eye(2, 4)
    sizes = np.array([1.0, 2.0, 3.0])[:, None, None]

    def batches(function):
        return function(R, P0), function(R[None], P0), function(sizes * R, P0)

    for found in (
        batches(lambda R, P0: bounds.riccati(Fs, H, Q, R, P0).gains),
        batches(lambda R, P0: bounds.riccati(Fs, H, Q, R, P0).covariances),
        batches(lambda R, P0: bounds.colored_bound(Fs, H, PHI, Q, R, P0)),
        batches(
            lambda R, P0: bounds.actual_covariance(
                Fs, H, bounds.riccati(Fs, H, Q, R, P0).gains, Q, PHI, R, P0, R
            )
        ),
    ):
        same(*found)


def test_observability_and_metrics():
    x = np.stack([PRIOR.mean, PRIOR.mean + 10.0, PRIOR.mean - 20.0])
    states = x[0], x[:1], x

    def h(points):
        return np.stack([(points**2).sum(-1), np.sin(points[..., 0])], -1)

    def each(function):
        return [function(state) for state in states]

    slopes = each(lambda x: observability.jacobian(h, x))
    A = np.eye(4, k=2)
    same(*slopes, axis=0)
    same(
        *each(lambda x: observability.nonlinearity_degree(h, x, np.ones(x.shape), np.ones(2))),
        axis=0,
    )
    matrices = [observability.observability_matrix(A, H, 1) for H in slopes]
    same(*matrices, axis=0)
    same(*(observability.state_singular_values(matrix) for matrix in matrices), axis=0)
    same(*(observability.state_singular_values(matrix, PRIOR.cov) for matrix in matrices), axis=0)
    same(*each(lambda x: observability.hysteresis(x, 200.0, 0.0 * x)), axis=0)
    tracks = three(lambda z: celnav.run(FILTERS["ukf"], PRIOR, TIMES, z, keep="cov"), Z)
    errors = [t.mean - x for t, x in zip(tracks, three(np.copy, TRUTH), strict=True)]
    same(*(nees(error, t.sqrt_cov) for error, t in zip(errors, tracks, strict=True)))
    none, one, several = errors
    np.testing.assert_allclose(metrics.rmse(one), np.abs(none))
    assert metrics.rms(none**2) == pytest.approx(metrics.rms(one**2))
    assert metrics.ratio(none**2, several**2) == pytest.approx(metrics.ratio(one**2, several**2))
    low, high = metrics.rmse_interval(one)
    assert ((low < np.abs(none)) & (np.abs(none) < high)).all()


def test_estimates_of_a_showcase():
    tracks = three(lambda z: celnav.run(FILTERS["ukf"], PRIOR, TIMES, z, keep="cov"), Z)
    group = Group("position", "km", slice(0, 2), 1e-3)
    found = [
        Estimate("UKF", "k", t.mean - x, t.cov)
        for t, x in zip(tracks, three(np.copy, TRUTH), strict=True)
    ]
    same(*(estimate.error(group) for estimate in found))
    np.testing.assert_allclose(found[0].sigma(group), 1e-3 * tracks[0].std[:, :2])
