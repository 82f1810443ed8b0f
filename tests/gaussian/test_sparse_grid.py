"""Sparse grids against the textbook combination technique, exact moments, published counts and
filterpy.
"""

from collections import defaultdict
from itertools import pairwise, product
from math import prod

import numpy as np
import pytest
from filterpy.kalman import UnscentedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

import celnav
from celnav.gaussian.rules import unscented
from celnav.gaussian.sparse_grid import DELAYED, ORDERS, index_set, integrates, point_count, smolyak

PAPER = [2 - (j in (0, 1, 5, 6)) for j in range(13)]


def indices(n, budget, g):
    """Multi-indices from 0 with ``sum i_j g_j <= budget``."""
    if n == 0:
        yield ()
        return
    for i in range(budget // g[0] + 1):
        for rest in indices(n - 1, budget - i * g[0], g[1:]):
            yield (i, *rest)


def combination(n, level, g, orders=ORDERS):
    """The combination technique as in the textbook: tensor rules with signed coefficients, merged
    by the ids of their nodes.

    Returns ``{ids: (point, weight, sum of absolute terms)}``; an id is (0, 0) for the node 0, else
    (order, index).
    """
    budget = (level - 1) * min(g)
    inside = set(indices(n, budget, g))
    merged = defaultdict(lambda: [None, 0.0, 0.0])
    for i in inside:
        shifts = product((0, 1), repeat=n)
        c = sum((-1) ** sum(s) for s in shifts if tuple(np.add(i, s)) in inside)
        if not c:
            continue
        rules = []
        for k in i:
            x, w = np.polynomial.hermite_e.hermegauss(orders[k])
            x[orders[k] // 2] = 0.0
            ids = [(0, 0) if v == 0.0 else (orders[k], j) for j, v in enumerate(x)]
            rules.append(list(zip(ids, x, w / w.sum(), strict=True)))
        for nodes in product(*rules):
            entry = merged[tuple(node[0] for node in nodes)]
            term = c * prod(node[2] for node in nodes)
            entry[0] = [node[1] for node in nodes]
            entry[1] += term
            entry[2] += abs(term)
    return {k: v for k, v in merged.items() if abs(v[1]) > 1e-12 * v[2]}


def gaussian_moment(power):
    return 0.0 if power % 2 else prod(range(1, power, 2))


@pytest.mark.parametrize(
    ("g", "isotropic", "anisotropic"),
    [
        ([1], 7, 7),
        ([2, 1], 21, 9),
        ([2, 1, 1], 37, 23),
        ([2, 2, 1, 1], 57, 25),
        ([2, 2, 1, 1, 1], 81, 41),
        ([2, 2, 2, 1, 1, 1], 109, 43),
    ],
)
def test_published_counts(g, isotropic, anisotropic):
    assert smolyak(len(g), 3).num_sigmas() == point_count(len(g), 3) == isotropic
    assert smolyak(len(g), 3, g).num_sigmas() == point_count(len(g), 3, g) == anisotropic


def test_counts_in_thirteen_dimensions():
    nonlinear = [1] * 3 + [2] * 10
    counts = [
        point_count(13, 2),
        point_count(13, 3),
        point_count(13, 3, PAPER),
        point_count(13, 3, nonlinear),
    ]
    assert counts == [27, 417, 75, 57]
    assert point_count(13, 3, orders=DELAYED) == 2 * 13**2 + 1
    assert point_count(13, 4, [1] * 3 + [3] * 10) == 179
    assert [point_count(n, 4) for n in (13, 20, 30, 40)] == [4759, 14881, 45321, 101761]


@given(m=st.integers(2, 7), k=st.integers(0, 7))
def test_count_formula_of_level_three(m, k):
    assert point_count(m + k, 3, [1] * m + [2] * k) == 1 + 2 * k + 8 * m + 2 * m * (m - 1)


@given(k=st.integers(1, 7))
def test_a_single_fine_channel_cancels_its_three_point_nodes(k):
    assert point_count(1 + k, 3, [1] + [2] * k) == 7 + 2 * k
    assert point_count(1, 3) == 7


@st.composite
def grids(draw):
    """``n, level, g``, up to sizes for which the textbook's method takes less than a second."""
    n = draw(st.integers(1, 8))
    g = draw(st.lists(st.integers(1, 4), min_size=n, max_size=n))
    level = draw(st.integers(1, 5))
    while point_count(n, level, g) > 1500:
        level -= 1
    return n, level, g


@settings(max_examples=60, deadline=None)
@given(grids())
def test_equals_the_combination_technique(grid):
    n, level, g = grid
    expected = combination(n, level, g)
    rule = smolyak(n, level, g)
    assert rule.num_sigmas() == point_count(n, level, g) == len(expected)
    assert abs(rule.wm.sum() - 1.0) <= 1e-12 * np.abs(rule.wm).sum()
    want = np.array([v[0] for v in expected.values()])
    weights, scale = (np.array([v[k] for v in expected.values()]) for k in (1, 2))
    got, got_weights = rule.nodes[rule.wm != 0.0], rule.wm[rule.wm != 0.0]
    order, own = np.lexsort(np.round(want, 9).T), np.lexsort(np.round(got, 9).T)
    np.testing.assert_allclose(got[own], want[order], rtol=0.0, atol=1e-12)
    assert (np.abs(got_weights[own] - weights[order]) <= 1e-12 * scale[order]).all()


def test_no_true_point_is_lost_at_level_five():
    rule = smolyak(2, 5)
    assert len(combination(2, 5, [1, 1])) == rule.num_sigmas()
    assert np.abs(rule.wm[rule.wm != 0.0]).min() < 1e-20
    moment = rule.wm @ rule.nodes[:, 0] ** 40
    assert moment == pytest.approx(gaussian_moment(40), rel=1e-11)


@settings(max_examples=60, deadline=None)
@given(grids(), st.data())
def test_moments_are_exact_where_the_predicate_says(grid, data):
    n, level, g = grid
    powers = data.draw(st.lists(st.integers(0, 6), min_size=n, max_size=n))
    rule = smolyak(n, level, g)
    values = np.prod(rule.nodes ** np.array(powers), -1)
    exact = prod(gaussian_moment(a) for a in powers)
    scale = np.abs(rule.wm) @ np.abs(values) + abs(exact)
    agrees = abs(rule.wm @ values - exact) <= 1e-10 * scale
    assert agrees == integrates(powers, level, g)


def test_exactness_of_every_monomial_in_four_dimensions():
    for g in ([1, 1, 1, 1], [1, 1, 2, 2], [1, 2, 2, 3], [2, 2, 2, 2]):
        rule = smolyak(4, 3, g)
        for powers in product(range(7), repeat=4):
            if sum(powers) > 10:
                continue
            values = np.prod(rule.nodes ** np.array(powers), -1)
            exact = prod(gaussian_moment(a) for a in powers)
            close = abs(rule.wm @ values - exact) <= 1e-10 * (
                np.abs(rule.wm) @ np.abs(values) + abs(exact)
            )
            assert close == integrates(powers, 3, g), (g, powers)


def test_isotropic_level_three_has_total_degree_five_and_mixed_anisotropic_ones_three():
    for g, degree in (([1, 1, 1], 5), ([1, 1, 2], 3), ([1, 2, 2], 3)):
        bad = [sum(p) for p in product(range(8), repeat=3) if not integrates(p, 3, g)]
        assert min(bad) == degree + 1


def test_level_one_is_the_center():
    rule = smolyak(4, 1)
    assert rule.nodes.tolist() == [[0.0] * 4]
    assert rule.wm.tolist() == [1.0]
    filter = celnav.sparse_grid_filter(
        celnav.Motion(lambda x, _: x, sqrt_Q=np.zeros((4, 0))), level=1
    )
    with pytest.raises(
        ValueError, match="rule: expected points in every dimension, got none in 0, 1, 2, 3"
    ):
        filter.predict(
            filter.start(celnav.Gaussian(np.zeros(4), sqrt_cov=np.eye(4))),
            celnav.Epoch(1, 1.0, 1.0),
        )
    with pytest.raises(ValueError, match="got none in 0, 1, 2, 3"):
        rule.sigma_points(np.zeros(4), np.eye(4))


def test_level_two_is_the_unscented_rule():
    for n in (1, 2, 4, 13):
        sparse, known = smolyak(n, 2), unscented(n, kappa=3.0 - n)
        a, b = (r.nodes[np.lexsort(r.nodes.T)] for r in (sparse, known))
        np.testing.assert_allclose(a, b, atol=1e-14)
        a, b = (r.wm[np.lexsort(r.nodes.T)] for r in (sparse, known))
        np.testing.assert_allclose(a, b, atol=4e-15 * n)


@pytest.mark.parametrize("constant", [1, 2, 3])
def test_equal_weights_are_isotropic(constant):
    assert smolyak(5, 3, [constant] * 5) is smolyak(5, 3)


def test_one_dimension_is_gauss_hermite():
    for level, order in enumerate(ORDERS, start=1):
        rule, (x, w) = smolyak(1, level), np.polynomial.hermite_e.hermegauss(order)
        own = np.argsort(rule.nodes[:, 0])
        np.testing.assert_allclose(rule.nodes[own, 0], x, atol=1e-13)
        np.testing.assert_allclose(rule.wm[own], w / w.sum(), rtol=1e-9, atol=1e-300)


def test_delayed_rules():
    for n, level in ((3, 3), (5, 3), (3, 4), (2, 7)):
        expected, rule = combination(n, level, [1] * n, DELAYED), smolyak(n, level, orders=DELAYED)
        assert len(expected) == rule.num_sigmas()
        assert np.sort(rule.wm[rule.wm != 0.0]) == pytest.approx(
            np.sort([v[1] for v in expected.values()]), abs=1e-13
        )
    assert integrates((2, 2, 0), 3, orders=DELAYED)
    assert not integrates((6, 0, 0), 3, orders=DELAYED)
    assert integrates((6, 0, 0), 3)


def test_weights_grow_with_the_dimension():
    assert np.abs(smolyak(13, 3).wm).sum() == pytest.approx(35.6667, abs=1e-3)
    assert (smolyak(13, 3).wm < 0).sum() == 26
    assert (smolyak(13, 3, PAPER).wm < 0).sum() == 9
    assert smolyak(13, 3, PAPER).wm[0] == pytest.approx(-3.50, abs=0.01)


def test_inside_filterpy():
    rule = smolyak(2, 3, [1, 2])
    ukf = UnscentedKalmanFilter(
        2, 1, 1.0, lambda x: x[:1], lambda x, dt: np.array([x[0] + dt * x[1], x[1]]), rule
    )
    ukf.x, ukf.P = np.array([1.0, 2.0]), np.array([[2.0, 0.3], [0.3, 1.0]])
    ukf.Q, ukf.R = 0.1 * np.eye(2), np.eye(1)
    ukf.predict()
    ukf.update([4.0])
    F, H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    P = F @ np.array([[2.0, 0.3], [0.3, 1.0]]) @ F.T + 0.1 * np.eye(2)
    K = P @ H.T / (H @ P @ H.T + 1.0)
    np.testing.assert_allclose(ukf.x, np.array([3.0, 2.0]) + K @ [1.0], atol=1e-12)
    np.testing.assert_allclose(ukf.P, P - K @ H @ P, atol=1e-12)


@pytest.mark.parametrize("form", ["square root", "covariance"])
def test_in_the_filter_for_colored_noise(form):
    """With a linear model any exact rule gives the same estimates; negative weights are subtracted
    by a downdate.
    """
    F, Phi = (
        np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.1], [0.0, -0.1, 1.0]]),
        np.array([[0.7, 0.2], [-0.1, 0.9]]),
    )
    z = np.random.default_rng(0).standard_normal((12, 4, 2))
    motion, sensor = (
        celnav.Motion(lambda x, _: x @ F.T, 0.1 * np.eye(3)),
        celnav.Sensor(np.eye(2, 3), np.eye(2)),
    )
    means = []
    for rule in (smolyak(3, 3), smolyak(3, 3, [1, 2, 2]), unscented(3)):
        filter = celnav.colored(motion, sensor, Phi, increments=np.eye(2), rule=rule, form=form)
        means.append(
            celnav.run(
                filter, celnav.Gaussian(np.zeros((4, 3)), np.eye(3)), np.arange(12.0), z
            ).mean
        )
    np.testing.assert_allclose(means[0], means[2], atol=1e-10)
    np.testing.assert_allclose(means[1], means[2], atol=1e-10)


def test_mean_of_a_nonlinear_function():
    """E[cos(a x)] = exp(-|a|^2 / 2): the error falls with the level."""
    a = np.array([0.6, 0.4, 0.2])
    errors = [
        abs(r.wm @ np.cos(r.nodes @ a) - np.exp(-0.5 * a @ a))
        for r in (smolyak(3, k) for k in range(1, 6))
    ]
    assert all(b < 0.3 * a for a, b in pairwise(errors))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 2), "n: expected an integer from 1 to 1000000, got 0"),
        ((2.5, 2), "n: expected an integer from 1 to 1000000, got 2.5"),
        ((2, 0), "level: expected an integer from 1 to 6"),
        ((2, 7), "level: expected an integer from 1 to 6"),
        ((2, 3, [1]), "weights: expected 2 positive integers"),
        ((2, 3, [1, 0]), "weights: expected 2 positive integers"),
        ((2, 3, [1, 1.5]), "weights: expected 2 positive integers"),
        ((2, 3, "ab"), "weights: expected 2 positive integers"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        smolyak(*arguments)


def test_bad_orders_and_powers():
    with pytest.raises(ValueError, match="orders: expected numbers of points that start with 1"):
        smolyak(2, 2, orders=(3, 5))
    with pytest.raises(ValueError, match="powers: expected integers of at least 0"):
        integrates((2, -1), 2)


def test_too_many_points_are_refused_before_they_are_made():
    count = point_count(60, 5)
    assert count > 1_000_000
    with pytest.raises(
        ValueError,
        match=f"level: expected at most 1000000 points .*, got {count} points of 60 components",
    ):
        smolyak(60, 5)


def test_cached_and_read_only():
    rule = smolyak(3, 3)
    assert smolyak(3, 3) is rule
    with pytest.raises(ValueError, match="read-only"):
        rule.nodes[0, 0] = 1.0


def test_large_weights_do_no_harm():
    assert point_count(3, 3, [10**9, 10**9 + 1, 2 * 10**9]) == point_count(3, 3, [3, 4, 6])


@pytest.mark.parametrize(
    ("level", "weights"), [(3, (2, 1)), (4, (1, 1, 2)), (4, (2, 3)), (2, (5, 1))]
)
def test_the_index_set_has_the_coefficients_of_the_combination_technique(level, weights):
    """Indices within the budget, each with the signed number of its upper neighbors in the set."""
    budget = (level - 1) * min(weights)
    every = {
        index
        for index in product(range(1, budget + 2), repeat=len(weights))
        if sum(g * (i - 1) for g, i in zip(weights, index, strict=True)) <= budget
    }
    expected = {
        index: sum(
            (-1) ** sum(up)
            for up in product((0, 1), repeat=len(weights))
            if tuple(map(sum, zip(index, up, strict=True))) in every
        )
        for index in every
    }
    assert index_set(level, weights) == expected
