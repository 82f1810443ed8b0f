"""Kernels, spaces, rules and metrics against what they claim."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints
from hypothesis import given, settings
from hypothesis import strategies as st

import celnav
from celnav import linalg, metrics, montecarlo
from celnav.spaces import EUCLIDEAN, Space, angles, product, wrap

SHAPES = st.tuples(st.lists(st.integers(1, 3), max_size=2), st.integers(1, 6), st.integers(1, 9), st.integers(0, 2**31))


@given(SHAPES)
@settings(max_examples=40, deadline=None)
def test_tria_is_a_lower_root_of_any_columns(shape):
    batch, n, q, seed = shape
    A = np.random.default_rng(seed).normal(size=(*batch, n, q))
    L = linalg.tria(A)
    np.testing.assert_allclose(L @ L.mT, A @ A.mT, atol=1e-12)
    assert not np.triu(L, 1).any()
    assert (L.diagonal(0, -2, -1) >= 0).all()


@given(SHAPES)
@settings(max_examples=40, deadline=None)
def test_substitution_solves(shape):
    batch, n, k, seed = shape
    rng = np.random.default_rng(seed)
    L, B = np.tril(rng.normal(size=(*batch, n, n)), -1) + 2 * np.eye(n), rng.normal(size=(*batch, n, k))
    np.testing.assert_allclose(L @ linalg.solve_lower(L, B), B, atol=1e-9)
    np.testing.assert_allclose(L.mT @ linalg.solve_upper_transposed(L, B), B, atol=1e-9)


def test_a_matrix_without_a_root_is_nan_and_its_neighbors_are_not():
    P = np.stack([np.eye(2), np.diag([1.0, -1.0]), np.full((2, 2), np.nan), 4 * np.eye(2)])
    for function in (linalg.cholesky, linalg.semidefinite_root):
        root = function(P)
        np.testing.assert_array_equal(np.isfinite(root).all((-2, -1)), [True, False, False, True])
        np.testing.assert_array_equal(root[3], 2 * np.eye(2))


def test_roots_keep_kilometers_and_millimeters_apart():
    P = np.diag([1e2, 1e-18])
    np.testing.assert_allclose(linalg.semidefinite_root(P), np.diag([10.0, 1e-9]), rtol=1e-14)


def test_a_block_downdate_takes_columns_away_and_fails_exactly_when_indefinite():
    rng = np.random.default_rng(1)
    L, V = linalg.tria(rng.normal(size=(4, 9))), 0.3 * rng.normal(size=(4, 2))
    D = linalg.downdate(L, V)
    np.testing.assert_allclose(D @ D.T, L @ L.T - V @ V.T, atol=1e-12)
    assert np.isnan(linalg.downdate(np.eye(2), 1.01 * np.eye(2)[:, :1])).any()


def gaussian_moment(powers):
    return np.prod([0.0 if p % 2 else np.prod(np.arange(p - 1, 0, -2.0)) for p in powers])


@pytest.mark.parametrize(("rule", "degree"), [(celnav.cubature(3), 3), (celnav.cubature(3, 5), 5), (celnav.gauss_hermite(2, 4), 7),
                                              (celnav.unscented(3, 1.0, 0.0, 0.0), 3), (celnav.simplex(3), 2)])  # fmt: skip
def test_rules_integrate_polynomials_up_to_their_degree(rule, degree):
    from itertools import product as every

    for powers in every(range(degree + 1), repeat=rule.n):
        if sum(powers) <= degree:
            ours = rule.wm @ np.prod(rule.nodes ** np.array(powers), -1)
            np.testing.assert_allclose(ours, gaussian_moment(powers), atol=1e-10, err_msg=str(powers))


def test_the_unscented_rule_is_filterpys():
    for alpha, beta, kappa in ((1.0, 0.0, 1.0), (0.5, 2.0, -1.0), (0.1, 2.0, 1.0)):
        ours, theirs = celnav.unscented(4, alpha, beta, kappa), MerweScaledSigmaPoints(4, alpha, beta, kappa)
        P = np.diag([1.0, 2.0, 3.0, 4.0]) + 0.1
        np.testing.assert_allclose(ours.sigma_points(np.ones(4), P), theirs.sigma_points(np.ones(4), P), atol=1e-12)
        np.testing.assert_allclose(ours.Wm, theirs.Wm, rtol=1e-9)
        np.testing.assert_allclose(ours.Wc, theirs.Wc, rtol=1e-9)
        assert ours.num_sigmas() == theirs.num_sigmas()


def test_angles_wrap_in_differences_sums_and_means():
    space = angles([1])
    a, b = np.array([1.0, np.pi - 0.1]), np.array([3.0, -np.pi + 0.1])
    np.testing.assert_allclose(space.minus(b, a), [2.0, 0.2])
    np.testing.assert_allclose(space.plus(a, space.minus(b, a)), b)
    assert wrap(3 * np.pi) == -np.pi
    prior = celnav.square_root([np.pi - 0.01], [[0.04]])
    mean = celnav.predict(lambda x, epoch: wrap(x + 0.02), celnav.unscented(1), space=angles())(prior)[0].mean
    np.testing.assert_allclose(mean, [-np.pi + 0.01])


def test_a_product_of_spaces_is_its_factors():
    both = product((EUCLIDEAN, 2, 2), (angles(), 1, 1))
    a, d = np.array([[1.0, 2.0, 3.0]]), np.array([0.5, 0.5, 0.5])
    np.testing.assert_allclose(both.plus(a, d), [[1.5, 2.5, wrap(3.5)]])
    np.testing.assert_allclose(both.minus(both.plus(a, d), a), [d])
    with pytest.raises(ValueError, match=r"^factors"):
        product((Space(mean=lambda points, weights: points[0]), 1, 1))


def test_samples_have_the_beliefs_moments():
    P = np.array([[2.0, 0.5], [0.5, 1.0]])
    draw = celnav.square_root([1.0, -1.0], P).sample(np.random.default_rng(0), (40000,))
    np.testing.assert_allclose(draw.mean(0), [1.0, -1.0], atol=5 * np.sqrt(2 / 40000))
    np.testing.assert_allclose(np.cov(draw.T), P, atol=0.1)


def test_linear_analysis_of_a_white_filter_is_its_riccati_equation():
    F, H, Q, R, P0 = np.tile([[1.0, 1.0], [0.0, 1.0]], (30, 1, 1)), np.array([[1.0, 0.0]]), 0.1 * np.eye(2), np.eye(1), np.eye(2)
    solved = metrics.riccati(F, H, Q, R, P0)
    actual = metrics.actual_covariance(F, H, solved.gains, Q, np.zeros((1, 1)), R, P0, R)
    np.testing.assert_allclose(actual, solved.covariances, rtol=1e-10)
    bound = metrics.colored_bound(F, H, np.zeros((1, 1)), Q, R, P0)
    np.testing.assert_allclose(bound, solved.covariances, rtol=1e-10)


def test_bands_and_intervals_cover_as_they_say():
    rng = np.random.default_rng(2)
    low, high = metrics.chi_square_band(6, 100)
    np.testing.assert_allclose([low, high], [5.34, 6.70], atol=0.01)
    errors = rng.normal(size=(2000, 50, 1))
    a, b = metrics.rmse_interval(errors)
    assert abs(((a <= 1) & (b >= 1)).mean() - 0.95) < 0.02
    covered = [metrics.bootstrap(np.mean, rng.normal(size=30), resamples=200) for _ in range(200)]
    assert np.mean([c[0] <= 0 <= c[1] for c in covered]) > 0.88


def test_blocks_cover_all_runs_and_units_join_in_order():
    assert [list(b) for b in montecarlo.blocks(5, 2)] == [[0, 1], [2, 3], [4]]
    units = [montecarlo.Unit("a", lambda r: {"x": np.array([list(r)])}, (part,)) for part in montecarlo.blocks(5, 2)]
    np.testing.assert_array_equal(montecarlo.work(units)["a"].arrays["x"], [[0, 1, 2, 3, 4]])
    for bad in (0, -1, 1.5):
        with pytest.raises(ValueError, match=r"^block"):
            montecarlo.blocks(3, bad)


def test_a_track_exports_itself(tmp_path):
    filter = celnav.sequential(
        celnav.predict(lambda x, e: x, celnav.unscented(2), np.eye(2)), celnav.update(np.eye(2), celnav.unscented(2), np.eye(2))
    )
    track = celnav.run(filter, celnav.square_root(np.zeros((3, 2)), np.eye(2)), celnav.epochs([0.0, 1.0], np.ones((2, 3, 2))))
    frame = track.to_dataframe(["a", "b"])
    assert list(frame.columns) == ["t", "run", "a", "b", "std_a", "std_b", "nis"]
    assert len(frame) == 6
    track.to_csv(tmp_path / "t.csv", ["a", "b"])
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "t.csv", delimiter=",", skiprows=1), frame.to_numpy(float))
