"""Iterated updates compared with Gauss-Newton written out, and expansion about another point."""

from __future__ import annotations

import numpy as np
import pytest

from celnav import Epoch, Gaussian, Motion, Sensor, ekf
from celnav.filters.joint import KEEP, joint
from celnav.filters.sequential import Iterated
from celnav.gaussian.linalg import SquareRoot
from celnav.gaussian.rules import Taylor

P = np.array([[1.0, 0.3], [0.3, 2.0]])
R = np.diag([0.01, 0.04])


def h(x, epoch=None):
    return np.stack([np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], -1)


def jacobian(x, _epoch=None):
    r = np.hypot(x[..., 0], x[..., 1])
    rows = [
        np.stack([x[..., 0] / r, x[..., 1] / r], -1),
        np.stack([-x[..., 1] / r**2, x[..., 0] / r**2], -1),
    ]
    return np.stack(rows, -2)


def gauss_newton(mean, z, iterations):
    x = mean
    for _ in range(iterations):
        H = jacobian(x)
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        x = mean + K @ (z - h(x) - H @ (mean - x))
    return x, P - K @ H @ P


STILL, SEEN = Motion(np.eye(2), np.zeros((2, 2))), Sensor(h, R)
MEAN, Z = np.array([5.0, 2.0]), np.array([5.0, 1.1])


def iterated(sensor, iterations, first=None):
    plain = ekf(STILL, sensor)
    return Iterated(
        plain.motion,
        plain.sensors,
        rule=plain.rule,
        form=plain.form,
        iterations=iterations,
        first=first,
    )


def given(filter, mean, z):
    """The belief given a measurement, and what it did."""
    state, (info,) = filter.update(filter.start(Gaussian(mean, P)), Epoch(z=z))
    return state.belief, info


@pytest.mark.parametrize("known", [None, jacobian], ids=["differences", "jacobian"])
@pytest.mark.parametrize("form", ["square root", "covariance"])
@pytest.mark.parametrize("iterations", [1, 2, 6])
def test_is_gauss_newton(form, known, iterations):
    posterior, info = given(
        ekf(STILL, Sensor(h, R, jacobian=known), form=form, iterations=iterations), MEAN, Z
    )
    x, cov = gauss_newton(MEAN, Z, iterations)
    np.testing.assert_allclose(posterior.mean, x, atol=1e-6)
    np.testing.assert_allclose(posterior.cov, cov, atol=1e-6)
    assert info.used.all()


def test_one_iteration_is_the_extended_filter_and_more_come_to_the_mode():
    once = iterated(SEEN, 1)
    np.testing.assert_allclose(
        given(once, MEAN, Z)[0].mean, given(ekf(STILL, SEEN), MEAN, Z)[0].mean, atol=1e-12
    )
    x = given(ekf(STILL, SEEN, iterations=30), MEAN, Z)[0].mean
    gradient = np.linalg.solve(P, x - MEAN) - jacobian(x).T @ np.linalg.solve(R, Z - h(x))
    np.testing.assert_allclose(gradient, 0.0, atol=1e-3)


def test_a_start_and_a_batch_with_missing_components():
    means, z = (
        np.array([[5.0, 2.0], [4.0, -1.0], [6.0, 3.0]]),
        np.array([[5.0, 1.1], [np.nan, 0.3], [6.0, np.nan]]),
    )
    filter = iterated(SEEN, 3, lambda belief, z, epoch: belief.mean + 0.1)
    batch = given(filter, means, z)[0]
    for mean, measured, got in zip(means, z, batch.mean, strict=True):
        np.testing.assert_allclose(given(filter, mean, measured)[0].mean, got, atol=1e-12)


def test_a_linear_function_does_not_care_where_it_is_expanded():
    F, noise = np.array([[1.0, 2.0], [0.5, -1.0], [3.0, 0.0]]), 0.3 * np.eye(1)
    mean, root, about = np.array([1.0, -2.0]), np.linalg.cholesky(P), np.array([7.0, 5.0])

    def g(x, epoch, w):
        return x @ F.T + w, KEEP

    belief, both = SquareRoot(mean, root), (mean @ F.T, np.concatenate([F, np.ones((3, 1))], -1))
    plain, moved, exact = (
        joint(rule, belief, outputs, z=np.zeros(3), augment=[noise])[1:3]
        for rule, outputs in ((Taylor(), g), (Taylor(about=about), g), (Taylor(), (both, KEEP)))
    )
    for a, b, c in zip(plain, moved, exact, strict=True):
        for other in (a, b):
            np.testing.assert_allclose(other.center + other.shift, c.center + c.shift, atol=1e-9)
            np.testing.assert_allclose(other.columns, c.columns, atol=1e-9)
            np.testing.assert_allclose(other.jacobian(), c.jacobian(), atol=1e-9)


@pytest.mark.parametrize("known", [None, lambda _x, _epoch: P], ids=["differences", "jacobian"])
def test_a_linear_update_does_not_care_where_it_is_expanded(known):
    """The same holds for a filter with a Jacobian."""
    sensor = Sensor(lambda x, _epoch: x @ P.T, R, jacobian=known)
    one = given(ekf(STILL, sensor), MEAN, Z)[0]
    two = given(iterated(sensor, 1, lambda belief, z, epoch: belief.mean + 9.0), MEAN, Z)[0]
    np.testing.assert_allclose(two.mean, one.mean, atol=1e-9)
    np.testing.assert_allclose(two.cov, one.cov, atol=1e-9)


@pytest.mark.parametrize("iterations", [0, 1.5, True])
def test_bad_iterations(iterations):
    with pytest.raises(ValueError, match=r"^iterations: expected"):
        ekf(STILL, SEEN, iterations=iterations)
