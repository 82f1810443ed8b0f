"""Quaternions and Rodrigues parameters against scipy's rotations, closed forms and numerical
derivatives.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import celnav
from celnav.gaussian import attitude as at

RNG = np.random.default_rng(0)
VECTORS = st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3).map(np.array)
PARAMETERS = [(1.0, 4.0), (1.0, 1.0), (0.0, 2.0), (0.5, 3.0)]


def quaternions(*shape):
    q = RNG.standard_normal((*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def test_the_product_composes_matrices():
    q, p = quaternions(50), quaternions(50)
    np.testing.assert_allclose(
        at.matrix(at.multiply(q, p)), at.matrix(q) @ at.matrix(p), atol=1e-14
    )
    np.testing.assert_allclose(
        at.multiply(q, at.inverse(q)), np.broadcast_to(at.IDENTITY, (50, 4)), atol=1e-15
    )


def test_the_matrix_is_the_transpose_of_scipys():
    q = quaternions(50)
    np.testing.assert_allclose(
        at.matrix(q), Rotation.from_quat(q).as_matrix().transpose(0, 2, 1), atol=1e-14
    )


def test_a_small_rotation_is_its_cross_product():
    phi = 1e-6 * RNG.standard_normal(3)
    np.testing.assert_allclose(at.matrix(at.exp(phi)), np.eye(3) - at.cross(phi), atol=1e-11)


@given(VECTORS)
@settings(max_examples=60, deadline=None)
def test_exp_is_scipys_and_log_leads_back(phi):
    q = at.exp(phi)
    np.testing.assert_allclose(
        at.positive(q), at.positive(Rotation.from_rotvec(phi).as_quat()), atol=1e-14
    )
    back = at.log(q)
    assert np.linalg.norm(back) <= np.pi + 1e-12
    np.testing.assert_allclose(at.positive(at.exp(back)), at.positive(q), atol=1e-12)
    if np.linalg.norm(phi) < np.pi - 1e-6:
        np.testing.assert_allclose(back, phi, atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-150, 1e-12, 1e-9, 1e-6, np.pi - 1e-9])
def test_log_keeps_its_digits(size):
    phi = np.array([0.6, 0.0, -0.8]) * size
    np.testing.assert_allclose(at.log(at.exp(phi)), phi, rtol=1e-9, atol=1e-320)
    np.testing.assert_allclose(at.angle(at.exp(phi)), size, rtol=1e-9, atol=1e-320)


def test_euler_angles_are_roll_of_pitch_of_yaw():
    angles = RNG.uniform(-1.4, 1.4, (20, 3))
    roll, pitch, yaw = (
        Rotation.from_rotvec(angles[:, i, None] * np.eye(3)[i]).as_matrix().transpose(0, 2, 1)
        for i in range(3)
    )
    np.testing.assert_allclose(at.matrix(at.from_euler(angles)), roll @ pitch @ yaw, atol=1e-14)
    np.testing.assert_allclose(at.to_euler(at.from_euler(angles)), angles, atol=1e-12)


@pytest.mark.parametrize(("a", "b"), PARAMETERS)
@given(phi=VECTORS)
@settings(max_examples=40, deadline=None)
def test_rodrigues_parameters_lead_back(a, b, phi):
    q = at.exp(0.99 * phi)
    if a == 0.0 and abs(q[3]) < 1e-3:
        return
    p = at.to_rodrigues(q, a, b)
    back = at.from_rodrigues(p, a, b)
    np.testing.assert_allclose(np.linalg.norm(back), 1.0, atol=1e-12)
    np.testing.assert_allclose(at.matrix(back), at.matrix(q), atol=1e-9)


def test_the_default_parameters_are_four_tangents_of_a_quarter():
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3.0, 1.3
    np.testing.assert_allclose(
        at.to_rodrigues(at.exp(angle * axis)), 4.0 * np.tan(angle / 4.0) * axis, rtol=1e-14
    )
    np.testing.assert_allclose(
        at.to_rodrigues(at.exp(angle * axis), 0.0, 2.0),
        2.0 * np.tan(angle / 2.0) * axis,
        rtol=1e-14,
    )


def test_the_sign_of_a_quaternion_changes_no_bit():
    space, q, p = at.attitude(), quaternions(30), quaternions(30)
    for other in (-q, q * np.where(RNG.random((30, 1)) < 0.5, -1.0, 1.0)):
        np.testing.assert_array_equal(space.minus(q, p), space.minus(other, p))
        np.testing.assert_array_equal(space.minus(p, q), space.minus(p, other))


@pytest.mark.parametrize(("a", "b"), PARAMETERS)
def test_minus_leads_back_and_batches_are_singles(a, b):
    space = at.attitude(a, b)
    q, p = quaternions(5, 7), quaternions(7)
    d = space.minus(q, p)
    np.testing.assert_allclose(at.positive(space.plus(p, d)), at.positive(q), atol=1e-9)
    for i in range(5):
        for j in range(7):
            np.testing.assert_allclose(d[i, j], space.minus(q[i, j], p[j]), atol=1e-14)


@pytest.mark.parametrize(("a", "b"), [(1.0, 4.0), (0.0, 2.0), (1.0, 1.0)])
def test_transport_is_the_derivative(a, b):
    p, h = np.array([0.5, -0.8, 0.3]) * b / 4.0, 1e-6
    reference = at.inverse(at.from_rodrigues(p, a, b))

    def about(d):
        return at.to_rodrigues(at.multiply(at.from_rodrigues(p + d, a, b), reference), a, b)

    columns = [(about(h * e) - about(-h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(at.transport(p, a, b), np.stack(columns, -1), atol=1e-9)


@pytest.mark.parametrize(("a", "b"), [(1.0, 4.0), (0.0, 2.0), (1.0, 1.0)])
def test_a_space_transports_where_it_is_asked_to(a, b):
    """By the derivative of the space's differences at the moved point."""
    space, q, p, h = at.attitude(a, b, transported=True), quaternions(), np.full(3, 0.2 * b), 1e-6
    moved = space.plus(q, p)
    ahead, behind = (space.minus(space.plus(q, p + s * h * np.eye(3)), moved) for s in (1, -1))
    np.testing.assert_allclose(space.transport(p), (ahead - behind).T / (2 * h), atol=1e-9)
    assert at.attitude(a, b).transport is None


def test_the_norm_does_not_drift():
    space, q, step = at.attitude(), quaternions(3), np.array([0.01, -0.02, 0.03])
    for _ in range(5_000):  # products alone drift by 1e-13
        q = space.plus(q, step)
    assert np.abs(np.linalg.norm(q, axis=-1) - 1.0).max() < 1e-14


def test_checks():
    q = quaternions(4)
    np.testing.assert_allclose(at.unit(q * (1.0 + 1e-8)), q, atol=1e-15)
    q[1] = np.nan
    assert np.isnan(at.unit(q)[1]).all()
    for bad, words in (
        (np.zeros(4), "norm of 0"),
        (2.0 * at.IDENTITY, "norm of 2"),
        ([0.0, 0.0, np.inf, 1.0], "finite"),
        ([0.0, 0.0, np.nan, 1.0], "finite"),
        ([0.0, 0.0, 1.0], "shape"),
    ):
        with pytest.raises(ValueError, match=f"^q: expected .*{words}"):
            at.unit(bad)
    with pytest.raises(
        ValueError, match=r"^a: expected a number of at least 0 and of at most 1, got 1.5"
    ):
        at.attitude(1.5, 1.0)
    with pytest.raises(ValueError, match=r"^b: expected a positive number"):
        at.attitude(1.0, 0.0)
    with pytest.raises(ValueError, match=r"^a: expected 0"):
        at.transport(np.zeros(3), 0.5, 3.0)


def test_vectors_turn_as_the_matrix_turns_them():
    q = at.exp(np.random.default_rng(3).normal(size=(4, 5, 3)))
    v = np.random.default_rng(4).normal(size=3)
    np.testing.assert_allclose(at.rotate(q, v), at.matrix(q) @ v, atol=1e-15)


def seen(q, z):
    """Mean of a filter that measures a full attitude."""
    space = at.attitude()
    motion = celnav.Motion(lambda x, _epoch: x, np.zeros((3, 3)), space=space)
    filter = celnav.ukf(motion, celnav.Sensor(lambda x, _epoch: x, 1e-6 * np.eye(3), space=space))
    state, _ = filter.update(filter.start(celnav.Gaussian(q, 0.01 * np.eye(3))), celnav.Epoch(z=z))
    return state.belief.mean


@pytest.mark.parametrize(
    "bad",
    [[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0], [np.nan, 0.0, 0.0, 1.0], [np.inf, 0.0, 0.0, 1.0]],
)
def test_a_filter_refuses_what_is_no_attitude(bad):
    with pytest.raises(ValueError, match=r"^z: expected"):
        seen(at.IDENTITY, np.array(bad))
    if np.isfinite(bad).all():
        with pytest.raises(ValueError, match=r"^prior: expected unit quaternions"):
            seen(np.array(bad), at.IDENTITY)


def test_a_quaternion_that_is_off_by_round_off_is_normalized():
    z = at.exp(np.array([0.1, 0.0, 0.0]))
    np.testing.assert_allclose(
        seen(at.IDENTITY, z), seen(at.IDENTITY, (1.0 + 5e-7) * z), atol=1e-15
    )


def test_differences_on_reference_axes():
    """They equal the differences on body axes, rotated, and so does the covariance."""
    q = at.from_euler([0.3, -0.4, 2.0])
    p = np.array([0.2, 0.5, -0.3])
    local, body = at.attitude(axes="reference"), at.attitude()
    np.testing.assert_allclose(local.minus(local.plus(q, p), q), p, rtol=1e-13)
    moved = body.plus(q, at.rotate(q, p))
    np.testing.assert_allclose(local.plus(q, p), moved, rtol=1e-13)
    carried = at.attitude(axes="reference", transported=True)
    numeric = [
        (carried.minus(carried.plus(q, p + d), carried.plus(q, p))) / 1e-6 for d in 1e-6 * np.eye(3)
    ]
    np.testing.assert_allclose(carried.transport(p), np.transpose(numeric), atol=1e-6)
    with pytest.raises(ValueError, match=r"^axes: expected one of body, reference, got 'local'"):
        at.attitude(axes="local")
