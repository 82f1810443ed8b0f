"""Iterated sigma-point filters: statistical linear regression over the posterior, compared with the
same written out.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import celnav
from celnav.analysis.metrics import chi_square_band
from celnav.filters.joint import KEEP, condition, joint
from celnav.filters.regression import pseudo_gain, regressed
from celnav.filters.sequential import Iterated, SingleDraw
from celnav.gaussian.belief import nees
from celnav.gaussian.linalg import SquareRoot
from celnav.gaussian.rules import Taylor, unscented
from celnav.gaussian.spaces import EUCLIDEAN

FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])
P = np.array([[1.0, 0.3], [0.3, 2.0]])
R = np.diag([0.01, 0.04])
MEAN, Z = np.array([5.0, 2.0]), np.array([5.0, 1.1])
STILL = celnav.Motion(np.eye(2), np.zeros((2, 2)))


def h(x, epoch=None):
    return np.stack([np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], -1)


SEEN = celnav.Sensor(h, R, space=celnav.angles([1]))


def given(filter, z=Z, mean=MEAN, cov=P):
    state, (info,) = filter.update(filter.start(celnav.Gaussian(mean, cov)), celnav.Epoch(z=z))
    return state.belief, info


def regression(rule, m, C):
    """``A, b, Omega`` of h over ``N(m, C)``, by sums over points."""
    x = m + rule.nodes @ np.linalg.cholesky(C).T
    y = h(x)
    mean = rule.wm @ y
    cross = (x - m).T @ (rule.wc[:, None] * (y - mean))
    A = np.linalg.solve(C, cross).T
    return A, mean - A @ m, (y - mean).T @ (rule.wc[:, None] * (y - mean)) - A @ C @ A.T


def posterior_linearization(rule, z, iterations):
    m, C = MEAN, P
    for _ in range(iterations):
        A, b, Omega = regression(rule, m, C)
        S = A @ P @ A.T + Omega + R
        K = np.linalg.solve(S, A @ P).T
        m, C = MEAN + K @ (z - A @ MEAN - b), P - K @ S @ K.T
    return m, C


@FORMS
@pytest.mark.parametrize("iterations", [1, 2, 5])
@pytest.mark.parametrize(
    "rule",
    [
        partial(unscented, kappa=1.0),
        unscented,
        partial(unscented, alpha=0.5, beta=2.0),
        partial(celnav.gauss_hermite, order=5),
        partial(celnav.smolyak, level=3),
    ],
)
def test_is_regression_about_the_posterior(form, rule, iterations):
    """With positive and with negative weights."""
    belief, _ = given(celnav.sigma_point(STILL, SEEN, rule=rule, form=form, iterations=iterations))
    mean, cov = posterior_linearization(rule(2), Z, iterations)
    np.testing.assert_allclose(belief.mean, mean, atol=1e-9)
    np.testing.assert_allclose(belief.cov, cov, atol=1e-9)


def test_is_a_fixed_point():
    """The regression about the posterior gives the posterior."""
    mean, cov = (
        given(celnav.ukf(STILL, SEEN, iterations=60))[0].mean,
        given(celnav.ukf(STILL, SEEN, iterations=60))[0].cov,
    )
    A, b, Omega = regression(unscented(2), mean, cov)
    S = A @ P @ A.T + Omega + R
    K = np.linalg.solve(S, A @ P).T
    np.testing.assert_allclose(MEAN + K @ (Z - A @ MEAN - b), mean, atol=1e-9)
    np.testing.assert_allclose(P - K @ S @ K.T, cov, atol=1e-9)


@FORMS
@pytest.mark.parametrize("matrix", [True, False], ids=["matrix", "function"])
def test_of_a_linear_model_one_iteration_is_all(form, matrix):
    H = np.array([[1.0, 0.5], [0.0, 2.0]])
    sensor = celnav.Sensor(H if matrix else lambda x, epoch: x @ H.T, R)
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    for by in (celnav.ukf, celnav.ghkf, celnav.ckf):
        for iterations in (1, 2, 5):
            belief, info = given(by(STILL, sensor, form=form, iterations=iterations))
            np.testing.assert_allclose(belief.mean, MEAN + K @ (Z - H @ MEAN), atol=1e-10)
            np.testing.assert_allclose(belief.cov, P - K @ H @ P, atol=1e-10)
            np.testing.assert_allclose(info.jacobian(), H, atol=1e-9)


def test_by_taylors_rule_it_is_the_iterated_extended_filter():
    prior = SquareRoot(MEAN, np.linalg.cholesky(P))
    about = prior
    for _ in range(4):
        seen = joint(Taylor(), about, (SEEN, KEEP), z=Z, measurement_noise=SEEN.noise)
        about, _, _ = condition(
            SquareRoot, regressed(seen, prior, prior.mean - about.mean), EUCLIDEAN
        )
    belief, _ = given(celnav.ekf(STILL, SEEN, iterations=4))
    np.testing.assert_allclose(about.mean, belief.mean, atol=1e-6)
    np.testing.assert_allclose(about.cov, belief.cov, atol=1e-6)


def test_is_consistent_where_the_unscented_filter_is_overconfident():
    """A fix from precise range and bearing; the prior position has a standard deviation of a third
    of the distance.
    """
    rng, runs, noise = np.random.default_rng(1), 1000, np.diag([0.1, 0.01])
    sensor, prior = (
        celnav.Sensor(h, noise**2, space=celnav.angles([1])),
        celnav.Gaussian([3.0, 3.0], np.eye(2)),
    )
    x = prior.sample(rng, (runs,))
    z = h(x) + rng.standard_normal((runs, 2)) @ noise
    low, high = chi_square_band(2, runs)

    def error(filter):
        track = celnav.run(filter, prior, [0.0], z[None], keep="cov")
        return nees(x - track.mean[0], track.sqrt_cov[0]).mean()

    for form in ("square root", "covariance"):
        assert error(celnav.ukf(STILL, sensor, form=form)) > 1.5 * high
        assert low < error(celnav.ukf(STILL, sensor, form=form, iterations=10)) < high


@FORMS
def test_runs_of_a_batch_are_those_alone_whatever_is_missing(form):
    moving = celnav.Motion(lambda x, epoch: x + 0.1 * np.sin(x), 0.1 * np.eye(2))
    filter = celnav.ukf(moving, SEEN, form=form, iterations=4)
    times, prior = np.arange(6.0), celnav.Gaussian(MEAN, P)
    z = celnav.simulate(moving, SEEN, prior, times, runs=20)[1]
    z[1, ::2] = np.nan
    z[2, :, 0] = np.nan
    z[3] = np.nan
    z[4, 1::3, 1] = np.nan
    many = celnav.run(filter, prior, times, z, keep="cov")
    for i in range(20):
        alone = celnav.run(filter, prior, times, z[:, i], keep="cov")
        for name in ("mean", "cov", "whitened", "used"):
            np.testing.assert_allclose(getattr(many, name)[:, i], getattr(alone, name), atol=1e-10)
        np.testing.assert_allclose(many.log_likelihood[i], alone.log_likelihood, rtol=1e-10)


@FORMS
def test_a_component_that_is_known(form):
    """With a singular covariance the regression uses the pseudo-inverse, as if the component were a
    constant.
    """
    known = given(celnav.ukf(STILL, SEEN, form=form, iterations=5), cov=np.diag([1.0, 0.0]))[0]
    line = celnav.Sensor(
        lambda x, epoch: h(np.stack([x[..., 0], np.full(x.shape[:-1], MEAN[1])], -1)),
        R,
        space=celnav.angles([1]),
    )
    alone = celnav.sigma_point(
        celnav.Motion(np.eye(1), np.zeros((1, 1))),
        line,
        iterations=5,
        form=form,
        rule=lambda n: unscented(1, kappa=1.0),
    )
    belief = given(alone, mean=MEAN[:1], cov=np.eye(1))[0]
    np.testing.assert_allclose(known.mean, [belief.mean[0], MEAN[1]], atol=1e-9)
    np.testing.assert_allclose(known.cov, np.diag([belief.cov[0, 0], 0.0]), atol=1e-9)


def test_noise_through_the_points_and_a_first_point():
    through = celnav.Sensor(lambda x, epoch, v: h(x) + v, augment=(np.linalg.cholesky(R),))
    filter = partial(celnav.sigma_point, STILL, iterations=3)
    one = given(filter(through, rule=lambda n: celnav.gauss_hermite(n, 5)))[0]
    two = given(filter(celnav.Sensor(h, R), rule=lambda n: celnav.gauss_hermite(n, 5)))[0]
    np.testing.assert_allclose(one.mean, two.mean, atol=1e-9)
    np.testing.assert_allclose(one.cov, two.cov, atol=1e-9)
    plain = celnav.ukf(STILL, SEEN)
    started = Iterated(
        **vars(plain), iterations=40, first=lambda belief, z, epoch: np.array([2.3, 4.5])
    )
    end = given(celnav.ukf(STILL, SEEN, iterations=60))[0]
    np.testing.assert_allclose(given(started)[0].mean, end.mean, atol=1e-8)


@FORMS
def test_compiled(form):
    pytest.importorskip("llvmlite")
    moving = celnav.Motion(lambda x, epoch: x + 0.1 * np.sin(x), 0.1 * np.eye(2))
    filter, times, prior = (
        celnav.ukf(moving, SEEN, form=form, iterations=3),
        np.arange(6.0),
        celnav.Gaussian([5.0, 2.0], 0.1 * P),
    )
    z = celnav.simulate(moving, SEEN, prior, times, runs=10)[1]
    z[2, ::2, 0] = np.nan
    there, here = (
        celnav.run(filter, prior, times, z, keep="cov", engine=engine)
        for engine in ("compiled", "numpy")
    )
    for name in ("mean", "cov", "whitened", "log_likelihood"):
        np.testing.assert_allclose(getattr(there, name), getattr(here, name), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("iterations", [0, 1.5, True, "x", 10**9])
def test_bad_iterations(iterations):
    for by in (celnav.ukf, celnav.ghkf, partial(celnav.sigma_point, rule=unscented)):
        with pytest.raises(ValueError, match=r"^iterations: expected an integer from 1"):
            by(STILL, SEEN, iterations=iterations)


def test_where_there_is_no_posterior_to_go_back_to():
    with pytest.raises(
        ValueError, match="iterations: expected 1, because process and measurement are one"
    ):
        celnav.colored(STILL, celnav.Sensor(h, R), 0.5 * np.eye(2), iterations=2)
    through = celnav.Motion(lambda x, epoch, w: x + w, augment=(np.eye(2),))
    with pytest.raises(ValueError, match="filter: expected iterations=1"):
        SingleDraw.of(
            celnav.ukf(through, celnav.Sensor(lambda x, epoch, *w: h(x), R), iterations=2)
        )


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("std", [1e-3, 1.0, 1e3])
def test_what_is_below_the_round_off_of_where_it_lies_is_known(unit, std):
    """Two components that differ by 1e-7 of their standard deviation, in any unit: at a distance of
    1e10 standard deviations from zero their difference is round-off, and near zero it is precise.
    """
    x, y = np.array([[2.0, 3.0]]), std * unit * np.array([[1.0, 0.0], [1.0, 1e-7]])
    A, sign = np.concatenate([y, x]), np.ones(2)
    exact = x @ np.linalg.inv(y)
    together = np.full((1, 2), 2.0 / (2.0 * std * unit))
    for far, expected in ((0.0, exact), (1e5, exact), (1e10, together)):
        center = np.full(2, far * std * unit)
        np.testing.assert_allclose(pseudo_gain(A, sign, 2, center), expected, rtol=1e-6)
        elsewhere = np.full(3, far * std * unit)  # of another length: the largest counts
        np.testing.assert_allclose(pseudo_gain(A, sign, 2, elsewhere), expected, rtol=1e-6)
    np.testing.assert_allclose(pseudo_gain(A, sign, 2), exact, rtol=1e-6)
    np.testing.assert_allclose(pseudo_gain(A, sign, 2, least=1e-6), together, rtol=1e-6)
