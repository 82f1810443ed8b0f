"""Iterated updates against Gauss-Newton written out, and expansion about another point."""

from __future__ import annotations

import numpy as np
import pytest

import celnav
from celnav.filters.iterated import iterated
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.gaussian.taylor import Taylor
from celnav.gaussian.transform import KEEP

P = np.array([[1.0, 0.3], [0.3, 2.0]])
R = np.diag([0.01, 0.04])


def h(x, epoch=None):
    return np.stack([np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], -1)


def jacobian(x, _epoch=None):
    r = np.hypot(x[..., 0], x[..., 1])
    rows = [np.stack([x[..., 0] / r, x[..., 1] / r], -1), np.stack([-x[..., 1] / r**2, x[..., 0] / r**2], -1)]
    return (np.stack(rows, -2),)


def gauss_newton(mean, z, iterations):
    x = mean
    for _ in range(iterations):
        H = jacobian(x)[0]
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        x = mean + K @ (z - h(x) - H @ (mean - x))
    return x, P - K @ H @ P


@pytest.mark.parametrize("jacobians", [None, jacobian], ids=["differences", "jacobians"])
@pytest.mark.parametrize("form", [celnav.square_root, celnav.covariance])
@pytest.mark.parametrize("iterations", [1, 2, 6])
def test_is_gauss_newton(form, jacobians, iterations):
    mean, z = np.array([5.0, 2.0]), np.array([5.0, 1.1])
    posterior, info, _ = iterated(h, R, iterations=iterations, jacobians=jacobians)(form(mean, P), z)
    x, cov = gauss_newton(mean, z, iterations)
    np.testing.assert_allclose(posterior.mean, x, atol=1e-6)
    np.testing.assert_allclose(posterior.cov, cov, atol=1e-6)
    assert info.used.all()


def test_one_iteration_is_the_extended_filter_and_more_come_to_the_mode():
    mean, z = np.array([5.0, 2.0]), np.array([5.0, 1.1])
    prior = celnav.square_root(mean, P)
    plain = celnav.update(h, Taylor(), R)(prior, z)[0]
    np.testing.assert_allclose(iterated(h, R, iterations=1)(prior, z)[0].mean, plain.mean, atol=1e-12)
    x = iterated(h, R, iterations=30)(prior, z)[0].mean
    gradient = np.linalg.solve(P, x - mean) - jacobian(x)[0].T @ np.linalg.solve(R, z - h(x))
    np.testing.assert_allclose(gradient, 0.0, atol=1e-3)


def test_a_start_and_a_batch_with_missing_components():
    means, z = np.array([[5.0, 2.0], [4.0, -1.0], [6.0, 3.0]]), np.array([[5.0, 1.1], [np.nan, 0.3], [6.0, np.nan]])
    part = iterated(h, R, iterations=3, start=lambda belief, z, epoch: belief.mean + 0.1)
    batch = part(celnav.square_root(means, P), z)[0]
    for mean, measured, got in zip(means, z, batch.mean, strict=True):
        np.testing.assert_allclose(part(celnav.square_root(mean, P), measured)[0].mean, got, atol=1e-12)


@pytest.mark.parametrize("given", [False, True])
def test_a_linear_function_does_not_care_where_it_is_expanded(given):
    F, noise = np.array([[1.0, 2.0], [0.5, -1.0], [3.0, 0.0]]), 0.3 * np.eye(1)
    mean, root, about = np.array([1.0, -2.0]), np.linalg.cholesky(P), np.array([7.0, 5.0])

    def g(x, w):
        return x @ F.T + w, KEEP

    J = (lambda _x, _epoch: (np.concatenate([F, np.ones((3, 1))], -1),)) if given else None
    plain, moved = (
        Taylor(J, about=a).transform(g, mean, root, EUCLIDEAN, (EUCLIDEAN, EUCLIDEAN), [noise], 2) for a in (None, about)
    )
    for a, b in zip(plain[0], moved[0], strict=True):
        np.testing.assert_allclose(a.center + a.shift, b.center + b.shift, atol=1e-9)
        np.testing.assert_allclose(a.columns, b.columns, atol=1e-9)


@pytest.mark.parametrize("iterations", [0, 1.5, True])
def test_bad_iterations(iterations):
    with pytest.raises(ValueError, match=r"^iterations"):
        iterated(h, R, iterations=iterations)
