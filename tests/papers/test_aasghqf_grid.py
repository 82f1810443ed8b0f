"""Sparse grids that fit themselves to a function, against exact moments and the Smolyak rules that they become."""

import numpy as np
import pytest

from celnav.gaussian.sparse_grid import smolyak
from celnav.papers.aasghqf.adaptive_grid import adapt


def test_finds_the_nonlinear_channels():
    def function(x):
        return np.stack([np.sin(2.0 * x[:, 0]) + x[:, 3], np.cos(x[:, 1]) + 0.5 * x[:, 0] * x[:, 1] + x[:, 4]], -1)

    found = adapt(function, np.zeros(6), np.eye(6), tolerance=1e-3)
    deep = {j for index in found.contributions for j, level in enumerate(index) if level > 1 or (level and sum(index) > 1)}
    assert deep == {0, 1}
    exact_mean = np.array([0.0, np.exp(-0.5)])
    exact_variance = np.array([0.5 * (1 - np.exp(-8.0)) + 1.0, 0.5 * (1 + np.exp(-2.0)) - np.exp(-1.0) + 0.25 + 1.0])
    y = function(found.rule.nodes)
    mean = found.rule.wm @ y
    np.testing.assert_allclose(mean, exact_mean, atol=2e-3)
    np.testing.assert_allclose(found.rule.wm @ np.square(y - mean), exact_variance, rtol=1e-2)


def test_a_linear_function_needs_no_more_than_level_two():
    found = adapt(lambda x: x @ np.array([[1.0], [2.0], [3.0]]), np.ones(3), np.tril(np.ones((3, 3))), tolerance=1e-10)
    two = smolyak(3, 2)
    assert found.rule.num_sigmas() == two.num_sigmas()
    np.testing.assert_allclose(sorted(found.rule.wm), sorted(two.wm), atol=1e-14)


def test_with_the_indices_of_a_smolyak_rule_it_is_that_rule():
    """A product of quadratics in all channels: every index of level 3 contributes, none beyond it to the tolerance asked."""

    def function(x):
        return np.concatenate([x**4, x[:, :1] ** 2 * x[:, 1:] ** 2], -1)

    found = adapt(function, np.zeros(2), np.eye(2), tolerance=1e-9)
    assert {(0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1)} <= set(found.contributions)
    moments = [np.prod(found.rule.nodes ** np.array(p), -1) @ found.rule.wm for p in ((4, 0), (2, 2), (8, 0), (4, 4))]
    np.testing.assert_allclose(moments, [3.0, 1.0, 105.0, 9.0], rtol=1e-11)


def test_limits_and_functions_that_cannot_be_adapted_to():
    with pytest.raises(ValueError, match="most: 8 indices do not reach the tolerance"):
        adapt(lambda x: np.exp(x).sum(-1, keepdims=True), np.zeros(7), 2.0 * np.eye(7), tolerance=1e-12, most=8)
    with pytest.raises(ValueError, match="function: expected finite numbers"):
        adapt(lambda x: np.where(x > 1.0, np.nan, x), np.zeros(2), np.eye(2))
