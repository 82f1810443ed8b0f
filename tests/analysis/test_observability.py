"""Observability against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from celnav.analysis import observability as ob

A = np.array([[0.0, 1.0, 0.0], [-0.4, -0.1, 0.3], [0.0, 0.0, 0.0]])
H = np.array([[1.0, 0.0, 0.0], [0.5, 0.0, 2.0]])


def test_jacobians_are_exact():
    def function(x):
        return np.stack([np.sin(x[:, 0]) * x[:, 1], np.exp(x[:, 1])], -1)

    x = np.array([0.7, -0.3])
    expected = [[np.cos(0.7) * -0.3, np.sin(0.7)], [0.0, np.exp(-0.3)]]
    np.testing.assert_allclose(ob.jacobian(function, x), expected, rtol=1e-15)


def test_jacobians_of_a_batch_are_those_of_its_states():
    x = np.random.default_rng(0).standard_normal((2, 4, 3))
    every = ob.jacobian(lambda x: np.sin(x @ A.T) * x[..., :1], x)
    for at in np.ndindex(2, 4):
        np.testing.assert_array_equal(
            every[at], ob.jacobian(lambda x: np.sin(x @ A.T) * x[..., :1], x[at])
        )


def test_gradients_of_a_linear_system_are_h_times_powers_of_a():
    gradients = ob.lie_gradients(
        lambda x: x @ A.T, lambda x: x @ H.T, np.array([1.0, -2.0, 0.5]), 4
    )
    for k in range(5):
        np.testing.assert_allclose(gradients[k], H @ np.linalg.matrix_power(A, k), atol=1e-8)


def test_gradients_of_a_nonlinear_system():
    """x' = x^2, y = x: the Lie derivatives are k! x^(k+1), their gradients (k + 1)! x^k."""
    gradients = ob.lie_gradients(lambda x: x**2, lambda x: x, np.array([0.3]), 3)
    np.testing.assert_allclose(
        gradients[:, 0, 0], [1.0, 2 * 0.3, 6 * 0.3**2, 24 * 0.3**3], rtol=1e-7
    )


def test_a_window_that_fits_the_time_scale_keeps_the_digits():
    slow = 1e-4
    gradients = ob.lie_gradients(
        lambda x: slow * x @ A.T, lambda x: x @ H.T, np.zeros(3), 3, window=1e4
    )
    for k in range(4):
        np.testing.assert_allclose(
            gradients[k], H @ np.linalg.matrix_power(slow * A, k), atol=1e-8 * slow**k
        )


def test_the_information_degree_is_that_of_a_kalman_filter_and_ignores_units():
    P0, R, F, rows = (
        np.diag([4.0, 1.0, 2.0]),
        np.diag([0.1, 0.2]),
        np.eye(3) + 0.1 * A,
        np.tile(H, (6, 1, 1)),
    )
    mean_P = P0
    for k in range(6):
        S = H @ mean_P @ H.T + R
        mean_P = mean_P - mean_P @ H.T @ np.linalg.solve(S, H @ mean_P)
        if k < 5:
            mean_P = F @ mean_P @ F.T
    back = np.linalg.matrix_power(np.linalg.solve(F, np.eye(3)), 5)
    start = back @ mean_P @ back.T
    degree = ob.information_degree(P0, np.tile(F, (5, 1, 1)), rows, R)
    np.testing.assert_allclose(degree, np.sqrt(P0.diagonal() / start.diagonal()), rtol=1e-10)
    T = np.diag([1e3, 1e-6, 1.0])
    back = np.linalg.solve(T, np.eye(3))
    other = ob.information_degree(T @ P0 @ T, np.tile(T @ F @ back, (5, 1, 1)), rows @ back, R)
    np.testing.assert_allclose(other, degree, rtol=1e-9)
    unseen = ob.information_degree(
        P0, np.tile(np.eye(3), (5, 1, 1)), np.tile(np.eye(1, 3), (6, 1, 1)), np.eye(1)
    )
    np.testing.assert_allclose(unseen[1:], 1.0, rtol=1e-12)


def test_degrees_depend_on_units_in_closed_form():
    """Three integrators of which the first is measured: O is the unit matrix, in units of 1/c of
    the third it is diag(1, 1, c).
    """
    chain, c = np.eye(3, k=1), 7.0
    np.testing.assert_array_equal(ob.observability_matrix(chain, np.eye(1, 3), 2), np.eye(3))
    own = ob.observability_matrix(
        np.diag([1.0, 1.0, 1.0 / c]) @ chain @ np.diag([1.0, 1.0, c]), np.eye(1, 3), 2
    )
    np.testing.assert_allclose(ob.state_singular_values(own), [1.0, 1.0, c], rtol=1e-15)
    np.testing.assert_array_equal(
        ob.state_singular_values(np.stack([own, own]))[1], ob.state_singular_values(own)
    )


def test_the_matrix_of_a_system_at_rest_is_its_lie_gradients():
    gradients = ob.lie_gradients(lambda x: np.sin(x) @ A.T, lambda x: x @ H.T, np.zeros(3), 4)
    at_rest = ob.observability_matrix(ob.jacobian(lambda x: np.sin(x) @ A.T, np.zeros(3)), H, 4)
    np.testing.assert_allclose(at_rest, gradients.reshape(-1, 3), atol=1e-8)


def test_two_stars_at_right_angles_see_the_misalignment_by_one_one_and_root_two():
    r = np.array([[0.0, 1.0, 1.0], [0.0, -1.0, 1.0]]) / np.sqrt(2.0)
    cross = [np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]]) for a, b, c in r]
    np.testing.assert_allclose(
        np.sort(ob.state_singular_values(np.concatenate(cross))), [1.0, 1.0, np.sqrt(2.0)]
    )


def test_what_is_not_seen_has_degree_zero_and_the_covariance_weighs_what_is():
    np.testing.assert_array_equal(
        ob.state_singular_values([[3.0, 0.0, 0.0], [0.0, 2.0, 0.0]]), [3.0, 2.0, 0.0]
    )
    # The singular values 5 and 1 belong to (0.8, 0.6) and (-0.6, 0.8). An initial state along the
    # second vector depends on the second value, in both components.
    matrix = np.diag([5.0, 1.0]) @ [[0.8, 0.6], [-0.6, 0.8]]
    np.testing.assert_allclose(ob.state_singular_values(matrix), [5.0, 1.0])
    np.testing.assert_allclose(ob.state_singular_values(matrix, np.eye(2)), [5.0, 1.0])
    second = np.outer([-0.6, 0.8], [-0.6, 0.8])
    np.testing.assert_allclose(
        ob.state_singular_values(matrix, second + 1e-6 * np.eye(2)), [1.0, 1.0]
    )
    # The same by many draws x0: (v_i x0) v_ij in the mean square.
    cov = np.array([[1.0, 0.3], [0.3, 0.1]])
    _, values, Vt = np.linalg.svd(matrix)
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(2), cov, 10000)
    size = np.sqrt(np.square((draws @ Vt.T)[..., None] * Vt).mean(0))
    np.testing.assert_allclose(ob.state_singular_values(matrix, cov), values[size.argmax(0)])


def test_hysteresis_follows_what_leaves_the_band_only():
    degrees = np.array([4.0, 4.9, 5.2, 5.6, 5.2, 4.9, 4.4, 5.2])[:, None]
    above, seen = np.zeros(1, bool), []
    for degree in degrees:
        above = ob.hysteresis(degree, 5.0, above)
        seen.append(bool(above[0]))
    assert seen == [False, False, False, True, True, True, False, False]
    np.testing.assert_array_equal(ob.hysteresis(degrees, 5.0, np.zeros(1), 1.0), degrees > 5.0)


def test_degrees_of_nonlinearity_in_closed_form():
    """x^2 deviates from its tangent by std^2, x y along no axis, sin by |sin| (1 - cos std)."""

    def function(x):
        return np.stack([x[..., 0] ** 2, x[..., 1] * x[..., 0] + np.sin(x[..., 2])], -1)

    mean, std = (
        np.array([[1.0, 2.0, 0.3], [0.0, 1.0, 1.2]]),
        np.array([[0.1, 1.0, 0.2], [3.0, 1.0, 0.5]]),
    )
    found = ob.nonlinearity_degree(function, mean, std, [0.5, 0.1])
    expected = np.stack(
        [
            np.square(std[:, 0]) / 0.5,
            [0.0, 0.0],
            np.sin(mean[:, 2]) * (1.0 - np.cos(std[:, 2])) / 0.1,
        ],
        -1,
    )
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_selectors():

    def step(x):
        return np.stack([np.sin(x[:, 0]), x[:, 1] * np.cos(x[:, 0]) + x[:, 2], x[:, 2]], -1)

    def measure(x):
        return x[:, 2:] ** 2

    assert ob.nonlinearity_weights([step], np.zeros(3), np.ones(3)) == (1, 2, 2)
    assert ob.nonlinearity_weights([step, measure], np.zeros(3), np.ones(3), coarse=3) == (1, 3, 1)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: ob.lie_gradients(lambda x: x, lambda x: x, [0.0], 7), "order"),
        (lambda: ob.lie_gradients(lambda x: x, lambda x: x, [0.0], 2, window=0.0), "window"),
        (lambda: ob.lie_gradients(lambda x: x, lambda x: x, [np.nan], 2), "x"),
        (lambda: ob.nonlinearity_weights([], [0.0, 0.0], [1.0]), "std"),
        (lambda: ob.nonlinearity_weights([], [0.0], [0.0]), "std"),
        (
            lambda: ob.information_degree(
                -np.eye(1), np.zeros((0, 1, 1)), np.ones((1, 1, 1)), np.eye(1)
            ),
            "P0",
        ),
    ],
)
def test_bad_input_is_refused_by_name(call, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        call()
