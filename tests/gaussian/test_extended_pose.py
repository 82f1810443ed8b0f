"""Extended poses against the group's matrices, by scipy's exponential and logarithm."""

import numpy as np
import pytest
from scipy.linalg import expm, logm

from celnav.gaussian.attitude import attitude, from_euler, inverse, matrix, multiply, rotate
from celnav.gaussian.attitude import exp as turned_by
from celnav.gaussian.extended_pose import extended_pose
from celnav.gaussian.spaces import product

SPACE = extended_pose()
rng = np.random.default_rng(0)


def group(x):
    """The element ``(5, 5)`` of SE_2(3): body to reference axes, velocity, position."""
    X = np.eye(5)
    X[:3, :3], X[:3, 3], X[:3, 4] = matrix(x[:4]).T, x[4:7], x[7:]
    return X


def algebra(xi):
    A = np.zeros((5, 5))
    x, y, z = xi[:3]
    A[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    A[:3, 3], A[:3, 4] = xi[3:6], xi[6:]
    return A


def pose():
    return np.r_[from_euler(rng.uniform(-1.0, 1.0, 3)), 10.0 * rng.standard_normal(6)]


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.0999, 0.1001, 1.0, 3.0])
def test_points_move_and_differ_as_the_group_says(angle):
    x, axis = pose(), rng.standard_normal(3)
    xi = np.r_[angle * axis / np.linalg.norm(axis), 5.0 * rng.standard_normal(6)]
    moved = SPACE.plus(x, xi)
    np.testing.assert_allclose(group(moved), group(x) @ expm(algebra(xi)), rtol=1e-12, atol=1e-12)
    difference = SPACE.minus(moved, x)
    np.testing.assert_allclose(difference, xi, rtol=1e-10, atol=1e-12)
    between = logm(np.linalg.solve(group(x), group(moved))).real
    np.testing.assert_allclose(algebra(difference), between, rtol=1e-6, atol=1e-7)


def test_a_batch_is_its_rows():
    x = np.stack([pose() for _ in range(4)])
    xi = rng.standard_normal((7, 4, 9))
    every = SPACE.plus(x, xi)
    np.testing.assert_allclose(every[3, 2], SPACE.plus(x[2], xi[3, 2]), rtol=1e-14)
    np.testing.assert_allclose(SPACE.minus(every, x)[3, 2], SPACE.minus(every[3, 2], x[2]))


def test_the_error_propagates_by_the_inertial_measurements_alone():
    """The log-linear property: the same error about another estimate, at any size [Barrau2017, Theorem 4]."""
    gravity, dt = np.array([0.0, 0.0, 9.8]), 0.3
    turn, force = np.array([0.3, -0.5, 0.9]) * dt, np.array([2.0, -1.0, -12.0])

    def f(x):
        q, v, p = x[:4], x[4:7], x[7:]
        a = rotate(inverse(q), force) + gravity
        return np.r_[multiply(turned_by(turn), q), v + a * dt, p + v * dt + 0.5 * a * dt**2]

    xi = np.r_[0.8, -1.1, 0.4, 3.0, -2.0, 1.0, 5.0, 4.0, -8.0]
    here, there = (SPACE.minus(f(SPACE.plus(x, xi)), f(x)) for x in (pose(), pose()))
    np.testing.assert_allclose(here, there, rtol=1e-10)
    # It is linear in the error, too.
    x = pose()
    np.testing.assert_allclose(
        SPACE.minus(f(SPACE.plus(x, 0.5 * xi)), f(x)), 0.5 * here, rtol=1e-10
    )
    other = product(q=attitude(), v=3, p=3)
    apart = [other.minus(f(other.plus(x, xi)), f(x)) for x in (pose(), pose())]
    assert np.abs(apart[0] - apart[1]).max() > 0.1


def test_names_within_a_part():
    space = product(pose=SPACE, bias=3)
    x = np.r_[pose(), 1.0, 2.0, 3.0]
    np.testing.assert_array_equal(space.part(x, "p"), x[7:10])
    np.testing.assert_array_equal(space.part(x, "pose"), x[:10])
    np.testing.assert_array_equal(space.part(np.arange(12.0), "bias"), [9.0, 10.0, 11.0])
    with pytest.raises(ValueError, match=r"^parts: expected names that differ"):
        product(pose=SPACE, v=3)
    with pytest.raises(ValueError, match=r"^prior: expected quaternion, velocity and position"):
        SPACE.check(np.zeros(9), "prior")
    with pytest.raises(ValueError, match=r"^prior: expected unit quaternions"):
        SPACE.check(np.ones(10), "prior")
