"""The iterated smoother, compared with Gauss-Newton on the whole trajectory and with regressions
over the smoothed beliefs.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy.optimize import least_squares
from twice import assert_same

import celnav
from celnav.engine.recording import Engine
from celnav.filters.run import ENGINE
from celnav.gaussian.belief import nees
from celnav.gaussian.rules import gauss_hermite, unscented
from celnav.tape.tape import CannotCompile

pytestmark = pytest.mark.usefixtures("eager")

FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])
Q, R = np.diag([0.02, 0.02, 0.01]), np.diag([0.05**2, 0.02**2])
PRIOR = celnav.Gaussian([4.0, 1.0, 0.4], np.diag([1.0, 1.0, 0.3]))
TIMES = np.arange(12.0)


def f(x, epoch):
    return np.stack(
        [
            x[..., 0] + epoch.dt * np.cos(x[..., 2]),
            x[..., 1] + epoch.dt * np.sin(x[..., 2]),
            x[..., 2],
        ],
        -1,
    )


def h(x, epoch):
    return np.stack([np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], -1)


MOTION, RADAR = celnav.Motion(f, Q), celnav.Sensor(h, R)
TRUTH, Z = celnav.simulate(MOTION, RADAR, PRIOR, TIMES, runs=3, seed=1)


def test_taylor_is_gauss_newton_on_the_trajectory():
    """At the fixed point the means are the most probable trajectory."""
    track = celnav.iterated_smoother(celnav.ekf(MOTION, RADAR), PRIOR, TIMES, Z, iterations=30)
    w = [np.linalg.inv(np.linalg.cholesky(C)) for C in (PRIOR.cov, Q, R)]

    def residual(flat, z):
        x = flat.reshape(-1, 3)
        ahead = x[1:] - f(x[:-1], celnav.Epoch(dt=1.0))
        return np.concatenate(
            [
                w[0] @ (x[0] - PRIOR.mean),
                (ahead @ w[1].T).ravel(),
                ((z - h(x, None)) @ w[2].T).ravel(),
            ]
        )

    for run in range(3):
        start = track.mean[:, run] + 0.01
        best = least_squares(
            residual, start.ravel(), args=(Z[:, run],), xtol=1e-15, ftol=1e-15, gtol=1e-12
        )
        np.testing.assert_allclose(track.mean[:, run], best.x.reshape(-1, 3), atol=2e-6)
        cov = np.linalg.inv(best.jac.T @ best.jac)
        for k in range(12):
            np.testing.assert_allclose(
                track.cov[k, run], cov[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], rtol=1e-4, atol=1e-7
            )


def regression(function, rule, m, C):
    """``A, b, Omega`` of a function over ``N(m, C)``, by sums over points."""
    x = m + rule.nodes @ np.linalg.cholesky(C).T
    y = function(x)
    mean = rule.wm @ y
    A = np.linalg.solve(C, (x - m).T @ (rule.wc[:, None] * (y - mean))).T
    return A, mean - A @ m, (y - mean).T @ (rule.wc[:, None] * (y - mean)) - A @ C @ A.T


def written_out(rule, z, iterations):
    """The iterated posterior linearization smoother of one run, by covariances [Garcia2017]."""
    about = None
    for _ in range(iterations):
        m, C, filtered, steps = PRIOR.mean, PRIOR.cov, [], []
        for k in range(len(z)):
            if k:
                A, b, Omega = regression(
                    lambda x: f(x, celnav.Epoch(dt=1.0)), rule, *(about[k - 1] if about else (m, C))
                )
                steps.append((A, m, C, A @ m + b, A @ C @ A.T + Omega + Q))
                _, _, _, m, C = steps[-1]
            if not np.isnan(z[k]).all():
                A, b, Omega = regression(
                    lambda x: h(x, None), rule, *(about[k] if about else (m, C))
                )
                S = A @ C @ A.T + Omega + R
                K = np.linalg.solve(S, A @ C).T
                m, C = m + K @ (z[k] - A @ m - b), C - K @ S @ K.T
            filtered.append((m, C))
        smoothed = [filtered[-1]]
        for (m, C), (A, _, _, mp, Cp) in zip(filtered[-2::-1], steps[::-1], strict=True):
            G = np.linalg.solve(Cp, A @ C).T
            ms, Cs = smoothed[0]
            smoothed.insert(0, (m + G @ (ms - mp), C + G @ (Cs - Cp) @ G.T))
        about = smoothed
    return np.array([m for m, _ in about]), np.array([C for _, C in about])


@FORMS
@pytest.mark.parametrize("iterations", [1, 2, 4])
@pytest.mark.parametrize("rule", [partial(unscented, kappa=1.0), partial(gauss_hermite, order=3)])
def test_is_regression_over_the_smoothed_beliefs(form, iterations, rule):
    """Also without measurements; three runs in a batch equal three single runs."""
    z = Z.copy()
    z[5] = np.nan
    filter = celnav.sigma_point(MOTION, RADAR, rule=rule, form=form)
    track = celnav.iterated_smoother(filter, PRIOR, TIMES, z, iterations=iterations)
    for run in range(3):
        mean, cov = written_out(rule(3), z[:, run], iterations)
        np.testing.assert_allclose(track.mean[:, run], mean, atol=1e-8)
        np.testing.assert_allclose(track.cov[:, run], cov, atol=1e-8)
        alone = celnav.iterated_smoother(filter, PRIOR, TIMES, z[:, run], iterations=iterations)
        np.testing.assert_allclose(track.mean[:, run], alone.mean, atol=1e-10)


def test_one_iteration_is_the_smoother():
    filter = celnav.ukf(MOTION, RADAR)
    expected = celnav.smooth(celnav.run(filter, PRIOR, TIMES, Z, keep="cov"))
    found = celnav.iterated_smoother(filter, PRIOR, TIMES, Z, iterations=1)
    np.testing.assert_array_equal(found.mean, expected.mean)
    np.testing.assert_array_equal(found.cov, expected.cov)


@FORMS
def test_linear_models_need_one_iteration(form):
    F, H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.eye(1, 2)
    motion, sensor, prior = (
        celnav.Motion(F, 0.1 * np.eye(2)),
        celnav.Sensor(H, np.eye(1)),
        celnav.Gaussian(np.zeros(2), np.eye(2)),
    )
    _, z = celnav.simulate(motion, sensor, prior, TIMES, runs=2)
    for filter in (celnav.ukf(motion, sensor, form=form), celnav.ekf(motion, sensor, form=form)):
        one, many = (
            celnav.iterated_smoother(filter, prior, TIMES, z, iterations=i, gains=True)
            for i in (1, 4)
        )
        np.testing.assert_allclose(many.mean, one.mean, atol=1e-12)
        np.testing.assert_allclose(many.cov, one.cov, atol=1e-12)
        np.testing.assert_allclose(many.extra["gain"], one.extra["gain"], atol=1e-12)


def test_of_attitudes_is_consistent_and_converges():
    """Angular standard deviations of half a radian, two measured directions: the iterations agree,
    and their predicted σ equals their error.
    """
    space = celnav.attitude()

    def turned(q, epoch):
        return celnav.gaussian.attitude.multiply(
            celnav.gaussian.attitude.exp(np.array([0.2, -0.1, 0.3]) * epoch.dt), q
        )

    def seen(q, epoch):
        C = celnav.gaussian.attitude.matrix(q)
        return np.concatenate([C[..., :, 0], C[..., :, 2]], -1)

    motion, sensor = (
        celnav.Motion(turned, 1e-4 * np.eye(3), space=space),
        celnav.Sensor(seen, 0.05**2 * np.eye(6)),
    )
    prior = celnav.Gaussian([0.0, 0.0, 0.0, 1.0], 0.25 * np.eye(3))
    times = np.arange(6.0)
    truth, z = celnav.simulate(motion, sensor, prior, times, runs=400, seed=2)
    one, many, more = (
        celnav.iterated_smoother(celnav.ukf(motion, sensor), prior, times, z, iterations=i)
        for i in (1, 16, 24)
    )
    assert np.abs(space.minus(many.mean, more.mean)).max() < 1e-5
    for k in (0, 3, 5):
        first, last = (
            nees(space.minus(t.mean[k], truth[k]), t.sqrt_cov[k]).mean() for t in (one, more)
        )
        assert first > 4.0
        assert abs(last - 3.0) < 4.0 * np.sqrt(6.0 / 400)


def test_a_lost_run_leaves_its_neighbors():
    def broken(x, epoch):
        return np.where(x[..., :1] > 100.0, np.nan, h(x, epoch))

    z = Z.copy()
    z[4, 1] = 1e4, 0.0
    filter = celnav.ukf(MOTION, celnav.Sensor(broken, R))
    with pytest.raises(celnav.FilterError, match=r"run \(1,\): h is not finite"):
        celnav.iterated_smoother(filter, PRIOR, TIMES, z, iterations=3)
    track = celnav.iterated_smoother(filter, PRIOR, TIMES, z, iterations=3, on_failure="flag")
    whole = celnav.iterated_smoother(filter, PRIOR, TIMES, Z, iterations=3)
    np.testing.assert_allclose(track.mean[:, [0, 2]], whole.mean[:, [0, 2]], atol=1e-10)
    assert track.failed_at[0] == track.failed_at[2] == -1 != track.failed_at[1]
    assert np.isnan(track.mean[5:, 1]).all()


# -- machine code ----------------------------------------------------------------------------------
def driven(x, epoch):
    turned = (
        0.0 if epoch.u is None else epoch.dt * (epoch.u[0] + epoch.u[1]) * np.array([0.0, 0.0, 1.0])
    )
    return f(x, epoch) + turned


def noise(_mean, epoch):
    return R * (1.0 + 0.1 * epoch.k)


HEADED = celnav.Motion(driven, lambda _mean, epoch: Q * epoch.dt, space=celnav.angles([2]))
SIGHT, GPS = (
    celnav.Sensor(h, noise, space=celnav.angles([1])),
    celnav.Sensor(np.eye(2, 3), 0.1 * np.eye(2)),
)
RNG = np.random.default_rng(4)
UNEVEN = np.cumsum(RNG.uniform(0.5, 1.5, 12))
GAPS = Z.copy(), TRUTH[..., :2] + 0.3 * RNG.standard_normal((12, 3, 2))
GAPS[0][3, 1] = GAPS[0][7, :, 0] = GAPS[1][1::2] = np.nan
MANY = celnav.Gaussian(PRIOR.mean + 0.01 * RNG.standard_normal((2, 3, 3)), PRIOR.cov)
TURNS = 0.1 * RNG.standard_normal((11, 1)), 0.1 * RNG.standard_normal((11, 3, 1))
CASES = {
    "gaps": (PRIOR, GAPS, None),
    "one run": (PRIOR, tuple(part[:, 0] for part in GAPS), None),
    "two axes": (MANY, GAPS, None),
    "runs of the prior": (MANY, tuple(part[:, 0] for part in GAPS), None),
    "no measurement": (PRIOR, None, None),
    "inputs of all runs and of each": (PRIOR, GAPS, TURNS),
}


@pytest.mark.parametrize(
    ("case", "form"), [*((case, "square root") for case in CASES), ("gaps", "covariance")]
)
def test_either_engine_gives_the_same(case, form):
    """Angles in the state and in one of two sensors; changing noise and intervals."""
    pytest.importorskip("llvmlite")
    filter, (prior, z, u) = celnav.ukf(HEADED, SIGHT, GPS, form=form), CASES[case]
    known, found = (
        celnav.iterated_smoother(
            filter, prior, UNEVEN, z, u, iterations=3, gains=True, engine=engine
        )
        for engine in ("numpy", "compiled")
    )
    assert_same(known, found)
    np.testing.assert_allclose(found.extra["gain"], known.extra["gain"], rtol=1e-9, atol=1e-9)
    assert found.filter is filter
    assert all(epoch.about is None for epoch in found.epochs)


def test_either_engine_smooths_attitudes():
    pytest.importorskip("llvmlite")
    space = celnav.attitude()
    motion = celnav.Motion(lambda q, _epoch: q, 1e-3 * np.eye(3), space=space)
    sensor = celnav.Sensor(
        lambda q, _epoch: celnav.gaussian.attitude.matrix(q)[..., :, 0], 0.05**2 * np.eye(3)
    )
    prior, times = celnav.Gaussian([0.0, 0.0, 0.0, 1.0], 0.25 * np.eye(3)), np.arange(4.0)
    _, z = celnav.simulate(motion, sensor, prior, times, runs=5, seed=2)
    filter = celnav.ukf(motion, sensor)
    found = [
        celnav.iterated_smoother(filter, prior, times, z, iterations=3, engine=engine)
        for engine in ("numpy", "compiled")
    ]
    assert_same(*found)


def slope_f(x, epoch):
    one, zero = np.ones(x.shape[:-1]), np.zeros(x.shape[:-1])
    rows = (
        [one, zero, -epoch.dt * np.sin(x[..., 2])],
        [zero, one, epoch.dt * np.cos(x[..., 2])],
        [zero, zero, one],
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def slope_h(x, _epoch):
    zero, r = np.zeros(x.shape[:-1]), np.hypot(x[..., 0], x[..., 1])
    rows = [x[..., 0] / r, x[..., 1] / r, zero], [-x[..., 1] / r**2, x[..., 0] / r**2, zero]
    return np.stack([np.stack(row, -1) for row in rows], -2)


@FORMS
def test_either_engine_takes_derivatives(form):
    """Derivatives at the means of each run, with a prior that all runs share."""
    pytest.importorskip("llvmlite")
    filter = celnav.ekf(
        celnav.Motion(f, Q, jacobian=slope_f), celnav.Sensor(h, R, jacobian=slope_h), form=form
    )
    found = [
        celnav.iterated_smoother(filter, PRIOR, TIMES, Z, iterations=4, engine=engine)
        for engine in ("numpy", "compiled")
    ]
    assert_same(*found)
    differences = celnav.iterated_smoother(
        celnav.ekf(MOTION, RADAR, form=form), PRIOR, TIMES, Z, iterations=4
    )
    np.testing.assert_allclose(found[0].mean, differences.mean, atol=1e-6)


def test_later_flights_are_compiled_once(monkeypatch):
    """For any number of iterations: steps for the first epoch, the other epochs and the backward
    pass, for the filter and the relinearized filter.
    """
    pytest.importorskip("llvmlite")
    counts, record = [], Engine.record
    monkeypatch.setattr(Engine, "record", lambda *arguments: counts.append(1) or record(*arguments))

    def recordings(iterations):
        counts.clear()
        filter = celnav.ekf(
            MOTION, celnav.Sensor(lambda x, epoch: (1.0 + 0.01 * iterations) * h(x, epoch), R)
        )
        celnav.iterated_smoother(filter, PRIOR, TIMES, Z, iterations=iterations, engine="compiled")
        return len(counts)

    assert [recordings(count) for count in (1, 2, 3, 6)] == [3, 6, 6, 6]


@pytest.mark.parametrize("lost", [0, 2])
def test_either_engine_loses_the_same_run(lost):
    pytest.importorskip("llvmlite")
    z = Z.copy()
    z[4, lost] = 1e4, 0.0
    filter = celnav.ukf(
        MOTION, celnav.Sensor(lambda x, epoch: np.where(x[..., :1] > 100.0, np.nan, h(x, epoch)), R)
    )
    known, found = (
        celnav.iterated_smoother(
            filter, PRIOR, TIMES, z, iterations=2, on_failure="flag", engine=engine
        )
        for engine in ("numpy", "compiled")
    )
    assert known.failed_at[lost] >= 0
    assert_same(known, found)
    with pytest.raises(celnav.FilterError, match=rf"run \({lost},\): h is not finite"):
        celnav.iterated_smoother(filter, PRIOR, TIMES, z, iterations=2, engine="compiled")


def test_which_engine_flew():
    pytest.importorskip("llvmlite")

    def branch(x, epoch):
        return h(x, epoch) * (1.0 if x.sum() > 0.0 else 1.01)

    def engine(sensor, **options):
        return celnav.iterated_smoother(
            celnav.ukf(MOTION, sensor), PRIOR, TIMES, Z, iterations=3, **options
        ).engine

    assert engine(RADAR) == engine(RADAR, engine="numpy") == "numpy"
    assert engine(RADAR, engine="auto") == engine(RADAR, engine="compiled", jobs=2) == "compiled"
    token = ENGINE.set("compiled")
    assert engine(RADAR) == "compiled"
    ENGINE.reset(token)
    with pytest.raises(CannotCompile, match=r"^a branch depends on a number"):
        engine(celnav.Sensor(branch, R), engine="compiled")
    assert engine(celnav.Sensor(branch, R), engine="auto").startswith(
        "numpy: a branch depends on a number"
    )
    with pytest.raises(
        ValueError, match=r"^engine: expected one of numpy, compiled, cuda, auto, got 'fast'"
    ):
        engine(RADAR, engine="fast")
    with pytest.raises(ValueError, match=r"^jobs: expected a positive integer, got 0"):
        engine(RADAR, engine="compiled", jobs=0)


def test_says_what_it_takes():
    filter = celnav.ukf(MOTION, RADAR)
    with pytest.raises(ValueError, match="filter: expected"):
        celnav.iterated_smoother(
            celnav.augmented(MOTION, RADAR, 0.5 * np.eye(2)).step, PRIOR, TIMES, Z
        )
    with pytest.raises(ValueError, match="iterations: expected"):
        celnav.iterated_smoother(filter, PRIOR, TIMES, Z, iterations=0)
