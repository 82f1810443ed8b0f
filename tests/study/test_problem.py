"""User-defined problems with every combination of filter and noise: exact if possible, otherwise
consistent.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from celnav import (
    Gaussian,
    Motion,
    Sensor,
    Taylor,
    colored,
    cubature,
    epochs,
    gauss_hermite,
    run,
    sigma_point,
    smolyak,
    unscented,
)
from celnav.filters.adaptive import gate, huber, innovation_window, student_t
from celnav.gaussian import spaces
from celnav.gaussian.attitude import attitude, rotate
from celnav.gaussian.linalg import FORMS, side_by_side
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.models.gyro import Gyro
from celnav.models.motion import constant_velocity, coordinated_turn
from celnav.study import problem
from celnav.study.montecarlo import generator
from celnav.study.problem import WILD, Problem, compare
from celnav.study.trial import Group, Noiseless

F = np.array([[1.0, 1.0], [0.0, 1.0]])
RULES = {
    "Taylor": Taylor(),
    "unscented": unscented,
    "cubature 5": lambda n: cubature(n, degree=5),
    "Gauss-Hermite": gauss_hermite,
    "sparse grid": lambda n: smolyak(n, 3),
}
HOOKS = {
    "window": innovation_window(10),
    "gate": gate(4.0),
    "Huber": huber(),
    "Student": student_t(),
}


def composed(rule, form="square root", color="", hook=""):
    """Names and functions that make a problem's filters; none for colored noise on a curved space,
    and none with 729 points.
    """

    def make(problem):
        if color and problem.motion.space != EUCLIDEAN:
            return None
        if rule == "Gauss-Hermite" and problem.n + bool(color) * problem.motion.noise.shape[1] > 5:
            return None
        options = {"rule": RULES[rule], "form": form, "hooks": [HOOKS[hook]] if hook else []}
        if color:
            return colored(
                problem.motion, problem.sensor, problem.phi * np.eye(problem.sensor.m), **options
            )
        return sigma_point(problem.motion, problem.sensor, **options)

    return " · ".join(filter(None, [rule, form, color, hook])), make


COMPOSITIONS = dict(
    [
        *(composed(rule, form) for rule in RULES for form in FORMS),
        *(composed(rule, color="colored") for rule in RULES),
        *(composed("unscented", hook=hook) for hook in HOOKS),
        composed("sparse grid", hook="Huber"),
        composed("sparse grid", color="colored", hook="Huber"),
    ]
)


def chosen(*names):
    return {name: COMPOSITIONS[name] for name in names}


def f(x, _epoch):
    return x @ F.T


def h(x, _epoch):
    return x[..., :1]


NOISE, R, PRIOR = [[0.05], [0.1]], [[0.25]], Gaussian([1.0, 2.0], [[4.0, 0.5], [0.5, 1.0]])


def line(**changes):
    """A body on a line whose position is measured."""
    problem = Problem(
        Motion(f, sqrt_Q=NOISE),
        Sensor(h, R),
        PRIOR,
        np.arange(21.0),
        groups=[Group("position", "m", slice(0, 1))],
    )
    return replace(problem, **changes)


RATES = np.tile([0.0, 1e-3, 0.0], (30, 1))


def satellite(**changes):
    gyro = Gyro(1e-5, 1e-6)
    problem = Problem(
        Motion(
            lambda x, epoch: gyro.propagate(x, epoch.u, epoch.dt),
            sqrt_Q=np.linalg.cholesky(gyro.process_noise(1.0)),
            space=spaces.product((attitude(), 4, 3), (EUCLIDEAN, 3, 3)),
        ),
        Sensor(
            lambda x, epoch: side_by_side([rotate(x[..., :4], star) for star in np.eye(3)[:2]]),
            R=1e-6 * np.eye(6),
        ),
        Gaussian([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], np.diag([0.02] * 3 + [1e-4] * 3) ** 2),
        times=np.arange(31.0),
        u=RATES,
        groups=[Group("attitude", "arcsec", slice(0, 3), 206265.0)],
    )
    return replace(problem, **changes)


def kalman(problem, z):
    """The textbook filter: means ``(T, runs, 2)`` and the last covariance."""
    W = problem.motion.noise
    P, Q, H = problem.prior.cov, W @ W.T, np.array([[1.0, 0.0]])
    x, out = np.tile(problem.prior.mean, (z.shape[1], 1)), []
    for k, measured in enumerate(z):
        if k:
            x, P = x @ F.T, F @ P @ F.T + Q
        K = P @ H.T / (H @ P @ H.T + R)
        x, P = x + (measured - x @ H.T) @ K.T, P - K @ H @ P
        out.append(x)
    return np.stack(out), P


@pytest.mark.parametrize(
    "name", [name for name in COMPOSITIONS if name.split(" · ")[-1] not in HOOKS]
)
def test_on_a_line_every_composition_is_the_kalman_filter(name):
    problem = line()
    _, z = problem.draw([generator(0, 0, r) for r in range(4)])
    mean, P = kalman(problem, z)
    prior = Gaussian(np.tile(PRIOR.mean, (4, 1)), PRIOR.cov)
    track = run(COMPOSITIONS[name](problem), prior, epochs(problem.times, z), keep="cov")
    np.testing.assert_allclose(track.mean, mean, atol=1e-8)
    np.testing.assert_allclose(track.cov[-1], np.tile(P, (4, 1, 1)), atol=1e-8)
    assert type(track.belief) is FORMS[name.split(" · ")[1]]


def test_all_parts_go_together_on_vectors():
    every = dict(composed(*parts) for parts in product(RULES, FORMS, ("", "colored"), ("", *HOOKS)))
    assert len(every) == 100
    rows = compare({"line": line(phi=0.6, times=np.arange(5.0))}, every, runs=3)
    assert [row.filter for row in rows] == [*every]
    assert all(np.isfinite(row[2:8]).all() and row.lost == 0 for row in rows)


def test_draws_are_of_the_model():
    problem = line(phi=0.8)
    truth, z = problem.draw([generator(1, 0, r) for r in range(4000)])
    assert truth.shape == (21, 4000, 2)
    # Four standard deviations for 4000 samples; five for 21 epochs.
    variance = PRIOR.cov.diagonal()
    scatter = np.sqrt((np.outer(variance, variance) + PRIOR.cov**2) / 4000)
    assert (np.abs(np.cov(truth[0].T) - PRIOR.cov) < 4.0 * scatter).all()
    V = (z - truth[..., :1])[..., 0]
    np.testing.assert_allclose(V.std(1), 0.5, rtol=5.0 / np.sqrt(8000.0))
    for lag in (1, 3):
        found, expected = np.corrcoef(V[9], V[9 + lag])[0, 1], 0.8**lag
        assert found == pytest.approx(expected, abs=4.0 * (1.0 - expected**2) / np.sqrt(4000.0))
    w = truth[1:] - truth[:-1] @ F.T
    np.testing.assert_allclose(
        np.cov(w.reshape(-1, 2).T), problem.motion.noise @ problem.motion.noise.T, rtol=0.05
    )


def test_outliers_are_as_many_and_as_large_as_they_are_said_to_be():
    rngs = [generator(1, 0, r) for r in range(2000)]
    truth, z = line(outliers=0.1).draw(rngs)
    same, clean = line().draw([generator(1, 0, r) for r in range(2000)])
    np.testing.assert_array_equal(truth, same)
    V, plain = (z - truth[..., :1]).ravel(), (clean - truth[..., :1]).ravel()
    wild = np.abs(V / plain) > 0.5 * WILD
    assert wild.mean() == pytest.approx(0.1, abs=0.01)
    np.testing.assert_allclose(V[wild], WILD * plain[wild])


def test_a_problem_may_have_dates():
    dated = line(times=np.datetime64("2026-01-01", "ns") + np.timedelta64(1, "s") * np.arange(21))
    (truth, z), (same, alike) = (p.draw([generator(1, 0, 0)]) for p in (dated, line()))
    np.testing.assert_array_equal(truth, same)
    np.testing.assert_array_equal(z, alike)


def test_an_outlier_of_colored_noise_leaves_the_next_sample_alone():
    rngs = [[generator(1, 0, r) for r in range(300)] for _ in range(2)]
    z, clean = line(outliers=0.1, phi=0.8).draw(rngs[0])[1], line(phi=0.8).draw(rngs[1])[1]
    assert (z == clean).mean() == pytest.approx(0.9, abs=0.02)


def test_huber_takes_most_of_the_harm_out_of_outliers():
    misled, kept = compare(
        {"line": line(outliers=0.1)},
        chosen("unscented · square root", "unscented · square root · Huber"),
        runs=200,
    )
    assert kept.rms_high < misled.rms_low
    assert kept.anees < 0.5 * misled.anees


def test_models_that_write_to_their_argument_change_nothing():
    def moved(x, _epoch):
        x[..., 0] += x[..., 1]
        return x

    def seen(x, _epoch):
        x[..., 0] -= 100.0
        return x[..., :1]

    kinds = chosen(
        "unscented · square root",
        "unscented · square root · colored",
        "Taylor · square root · colored",
    )
    writing = line(motion=Motion(moved, sqrt_Q=NOISE), sensor=Sensor(seen, R), phi=0.5)
    pure = line(sensor=Sensor(lambda x, _epoch: x[..., :1] - 100.0, R), phi=0.5)
    for mine, other in zip(
        compare({"line": writing}, kinds, runs=5),
        compare({"line": pure}, kinds, runs=5),
        strict=True,
    ):
        np.testing.assert_allclose(mine[2:8], other[2:8], rtol=1e-9)


def test_a_noiseless_run_is_the_undisturbed_one():
    truth, z = line(outliers=0.1, phi=0.5).draw([Noiseless()])
    np.testing.assert_allclose(
        truth[:, 0], [np.linalg.matrix_power(F, k) @ [1.0, 2.0] for k in range(21)]
    )
    np.testing.assert_array_equal(z[..., 0], truth[..., 0])


def test_where_the_model_holds_filters_reach_the_bound_and_know_it():
    rows = compare(
        {"line": line()}, chosen("unscented · square root", "sparse grid · covariance"), runs=400
    )
    for row in rows:
        assert row.efficiency == pytest.approx(1.0, abs=0.05)
        assert row.low < 1.0 < row.high
        assert row.lost == 0
        assert row.us_per_step > 0.0


def test_sparse_grids_for_colored_noise_are_consistent_and_filters_for_white_noise_are_not():
    both = chosen("sparse grid · square root", "sparse grid · square root · colored")
    white, knowing = compare({"line": line(phi=0.9)}, both, runs=400)
    assert knowing.low < 1.0 < knowing.high
    assert knowing.efficiency == pytest.approx(1.0, abs=0.05)
    assert white.low > 2.0


def test_adaptive_square_root_attitude_is_consistent_and_survives_outliers():
    filters = chosen(
        "unscented · square root",
        "unscented · square root · window",
        "unscented · square root · Huber",
    )
    clean = compare({"satellite": satellite()}, filters, runs=300)
    assert all(abs(row.anees - 1.0) < 0.15 for row in clean)
    assert all(row.rms < 1.1 * clean[0].rms for row in clean)
    misled, inflated, kept = compare({"satellite": satellite(outliers=0.05)}, filters, runs=300)
    assert misled.anees > 4.0
    assert inflated.anees < 0.8 * misled.anees
    assert kept.rms < 0.75 * misled.rms
    assert kept.anees < 0.5 * misled.anees


def test_what_does_not_go_together_is_left_out():
    assert COMPOSITIONS["unscented · square root · colored"](satellite()) is None
    rows = compare(
        {"satellite": satellite(times=np.arange(4.0), u=RATES[:3])}, COMPOSITIONS, runs=2
    )
    left = [
        name for name in COMPOSITIONS if "colored" not in name and "Gauss-Hermite" not in name
    ]  # of 729 points
    assert [row.filter for row in rows] == left
    assert all(np.isfinite([row.rms, row.efficiency, row.anees]).all() for row in rows)
    # Without a filter that models the correlation there is no bound.
    (row,) = compare(
        {"satellite": satellite(times=np.arange(4.0), u=RATES[:3], phi=0.5)},
        chosen("unscented · square root"),
        runs=2,
    )
    assert np.isnan(row.efficiency)


@pytest.mark.parametrize("phi", [0.0, 0.6])
def test_motions_of_the_package_are_problems(phi):
    """Their noise depends on the interval; here intervals are 1 s and 3 s long."""
    problem = Problem(
        constant_velocity(1, q=0.02),
        Sensor(lambda x, epoch: x[..., :1], R=lambda mean, epoch: 0.25),
        PRIOR,
        np.cumsum([0.0, *[1.0, 3.0] * 10]),
        phi=phi,
        groups=[Group("position", "m", slice(0, 1))],
    )
    truth, z = problem.draw([generator(3, 0, r) for r in range(4000)])
    for k, T in ((1, 1.0), (2, 3.0)):
        w = truth[k] - truth[k - 1] @ np.array([[1.0, T], [0.0, 1.0]]).T
        Q = 0.02 * np.array([[T**3 / 3.0, T**2 / 2.0], [T**2 / 2.0, T]])
        np.testing.assert_allclose(np.cov(w.T), Q, rtol=0.1)
    V = (z - truth[..., :1])[..., 0]
    np.testing.assert_allclose(V.std(1), 0.5, rtol=0.06)
    assert np.corrcoef(V[9], V[10])[0, 1] == pytest.approx(phi, abs=0.05)
    (row,) = compare(
        {"walk": problem},
        {"one": lambda p: colored(p.motion, p.sensor, phi * np.eye(1))},
        runs=2000,
    )
    assert row.low < 1.0 < row.high
    assert row.efficiency == pytest.approx(1.0, abs=0.05)


def test_a_noise_of_the_state_is_drawn_where_the_state_is():
    """A turn with process noise along its heading, and a range whose noise grows with the range."""
    turn = coordinated_turn(q=1e-2, q_rate=1e-6)
    problem = Problem(
        turn,
        Sensor(
            lambda x, epoch: x[..., :2],
            R=lambda mean, epoch: (0.1 + mean[..., :1, None] ** 2) * np.eye(2),
        ),
        Gaussian([0.0, 0.0, 1.0, 0.0, 0.5], 1e-6 * np.eye(5)),
        np.arange(3.0),
    )
    truth, z = problem.draw([generator(4, 0, r) for r in range(4000)])
    W = turn.columns(problem.prior.mean, problem.epochs[1], 5)
    np.testing.assert_allclose(np.cov(truth[1].T)[:2, :2], (W @ W.T)[:2, :2], rtol=0.1, atol=2e-4)
    near = np.abs(truth[2, :, 0]) < np.median(np.abs(truth[2, :, 0]))
    noise = z[2] - truth[2, :, :2]
    expected = [np.sqrt(0.1 + (truth[2, part, 0] ** 2).mean()) for part in (near, ~near)]
    np.testing.assert_allclose([noise[near].std(), noise[~near].std()], expected, rtol=0.05)


def test_a_row_does_not_depend_on_the_others():
    both, one = (
        chosen("Taylor · square root", "unscented · square root · gate"),
        chosen("unscented · square root · gate"),
    )
    together = compare({"a": line(), "b": line(phi=0.5)}, both, runs=5)
    alone = compare({"a": line(), "b": line(phi=0.5)}, one, runs=5)
    assert [row[:-1] for row in together[1::2]] == [row[:-1] for row in alone]
    turned = compare({"b": line(phi=0.5), "a": line()}, one, runs=5)
    assert [row[:-1] for row in turned[::-1]] == [row[:-1] for row in alone]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"phi": 1.0}, "^phi: expected a number of at least 0 and below 1, got 1.0"),
        ({"outliers": -0.1}, "^outliers: expected a number of at least 0 and below 1, got -0.1"),
        ({"motion": f}, r"^motion: expected celnav.Motion\(f, Q\), got function f"),
        ({"sensor": None}, r"^sensor: expected celnav.Sensor\(h, R\), got NoneType"),
        ({"prior": [1.0, 2.0]}, r"^prior: expected celnav.Gaussian\(mean, cov\), got list"),
        (
            {"motion": Motion(f, lambda mean, epoch: np.eye(3))},
            r"^prior, Q: expected a covariance \(2, 2\) that all runs share, got \(3, 3\)",
        ),
        (
            {"sensor": Sensor(h, lambda mean, epoch: np.eye(2))},
            r"^R: expected a covariance \(1, 1\) that all runs share, got \(2, 2\)",
        ),
        (
            {"sensor": Sensor(h, np.ones((3, 1, 1)))},
            r"^R: expected a covariance \(1, 1\) that all runs share, got \(3, 1, 1\)",
        ),
        (
            {"motion": Motion(f, np.eye(3))},
            r"^prior, Q: expected a covariance \(2, 2\) that all runs share, got \(3, 3\)",
        ),
        (
            {"prior": Gaussian(np.zeros(3), np.eye(2))},
            r"^prior: expected one mean \(N,\) and covariance \(n, n\)",
        ),
        (
            {"motion": Motion(f, np.eye(2), augment=(np.eye(1),))},
            r"^augment: expected models with additive noise \(Q, R\), got augmented noise",
        ),
        (
            {"prior": Gaussian(np.zeros((3, 2)), np.eye(2))},
            r"^prior: expected one mean \(N,\) and covariance \(n, n\)",
        ),
        ({"phi": "much"}, "^phi: expected a number of at least 0 and below 1, got 'much'"),
        ({"times": [0.0, 1.0, 1.0]}, r"^times: expected two or more increasing numbers"),
        ({"times": []}, r"^times: expected two or more increasing numbers"),
        ({"u": np.zeros((3, 1))}, r"^u: expected 20 rows for 21 times .*, got 3"),
        (
            {"groups": [Group("x", "m", slice(5, 6))]},
            r"^groups: expected a slice of 2 components for x",
        ),
    ],
)
def test_a_problem_that_cannot_be_is_refused_by_name(change, message):
    with pytest.raises(ValueError, match=message):
        line(**change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"sensor": Sensor(lambda x, epoch: x, R)},
            r"^h returned shape \(1, 2, 2\), expected \(1, 2, 1\)",
        ),
        (
            {"sensor": Sensor(lambda x, epoch: x[..., 0], R)},
            r"^h returned shape \(1, 2\), expected",
        ),
        (
            {"motion": Motion(lambda x, epoch: x * 1e200, sqrt_Q=NOISE)},
            r"^f: expected finite numbers, got others at t = ",
        ),
    ],
)
def test_a_model_that_cannot_be_is_told_when_it_is_drawn(change, message):
    with pytest.raises(ValueError, match=message), np.errstate(over="ignore"):
        line(**change).draw([generator(0, 0, r) for r in range(2)])


@pytest.mark.parametrize(
    ("filters", "message"),
    [
        ([COMPOSITIONS], "^filters: expected functions by name, such as .*, got list"),
        ({"UKF": unscented(2)}, r"^filters: expected a function \(problem\), got Rule"),
        (
            {"UKF": lambda problem: problem.motion},
            r"^filter: expected a filter, such as .*, got Motion",
        ),
    ],
)
def test_what_makes_no_filter_is_refused(filters, message):
    with pytest.raises(ValueError, match=message):
        compare({"line": line()}, filters, runs=2)


@pytest.mark.parametrize("runs", [0, -1, 2.5])
def test_runs_are_a_positive_integer(runs):
    with pytest.raises(ValueError, match=r"^runs: expected a positive integer"):
        compare({"line": line()}, COMPOSITIONS, runs=runs)


@pytest.mark.parametrize(("seconds", "passes"), [(0.01, 3), (0.3, 2), (5.0, 1)])
def test_a_filter_that_takes_long_is_not_timed_again(monkeypatch, seconds, passes):
    """The clock advances by ``seconds`` in each measurement, and is read twice."""
    clock = iter(np.arange(100.0) * seconds)
    monkeypatch.setattr(problem, "process_time", lambda: next(clock))
    walk = Problem(
        Motion(F, Q=0.1),
        Sensor(np.eye(1, 2), R=[[1.0]]),
        Gaussian([0, 0], np.eye(2)),
        np.arange(4.0),
    )
    (row,) = compare(
        {"walk": walk}, {"EKF": lambda p: sigma_point(p.motion, p.sensor, rule=Taylor())}, runs=5
    )
    assert row.us_per_step == pytest.approx(1e6 * seconds / (5 * 4))
    assert round(next(clock) / seconds) == 2 * passes
