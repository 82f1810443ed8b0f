"""One set of points for prediction and update: exact in the linear case, also where the two noises are correlated."""

from __future__ import annotations

import numpy as np
import pytest

import celnav
from celnav.filters.single_draw import drawn_once, single_draw

F, Z = np.array([[1.0, 0.2], [-0.1, 0.9]]), np.array([[1.0, 0.5]])
JOINT = np.array([[1.0, 0.3, 0.5], [0.3, 2.0, -0.4], [0.5, -0.4, 1.5]])
"""Covariance of process (2) and measurement noise (1)."""


def f(x, _epoch, n):
    return x @ F.T + n[..., :2]


def h(y, _epoch, n):
    return y @ Z.T + n[..., 2:]


def kalman(z, x, P):
    """The exact filter of x' = F x + w, z = Z x' + v with correlated w, v."""
    Q, C, R = JOINT[:2, :2], JOINT[:2, 2:], JOINT[2:, 2:]
    x, P = F @ x, F @ P @ F.T + Q
    S = Z @ P @ Z.T + Z @ C + C.T @ Z.T + R
    K = (P @ Z.T + C) / S
    return x + K @ (z - Z @ x), P - K @ S @ K.T


@pytest.mark.parametrize("form", [celnav.square_root, celnav.covariance])
@pytest.mark.parametrize("rule", [celnav.unscented(5), celnav.unscented(5, 0.5, 2.0, 0.0), celnav.cubature(5)], ids=str)
def test_is_the_kalman_filter_with_correlated_noise(form, rule):
    part = single_draw(f, h, rule, extra=(np.linalg.cholesky(JOINT),))
    belief, x, P = form(np.zeros(2), np.eye(2)), np.zeros(2), np.eye(2)
    for z in np.random.default_rng(0).standard_normal((10, 1)):
        belief, info, _ = part(belief, z)
        x, P = kalman(z, x, P)
        np.testing.assert_allclose(belief.mean, x, atol=1e-10)
        np.testing.assert_allclose(belief.cov, P, atol=1e-10)
    assert info.used.all()


def test_additive_measurement_noise_is_the_same_as_through_the_points():
    W, V = np.linalg.cholesky(JOINT[:2, :2]), np.sqrt(JOINT[2:, 2:])
    through = single_draw(lambda x, e, w, v: x @ F.T + w, lambda y, e, w, v: y @ Z.T + v, celnav.unscented(5), extra=(W, V))
    added = single_draw(lambda x, e, w: x @ F.T + w, lambda y, e, w: y @ Z.T, celnav.unscented(4), extra=(W,), R=JOINT[2:, 2:])
    prior = celnav.square_root(np.ones((3, 2)), np.eye(2))
    z = np.array([[0.5], [np.nan], [-2.0]])
    a, b = through(prior, z)[0], added(prior, z)[0]
    np.testing.assert_allclose(a.mean, b.mean, atol=1e-12)
    np.testing.assert_allclose(a.cov, b.cov, atol=1e-12)
    plain = celnav.predict(lambda x, e, w: x @ F.T + w, celnav.unscented(4), extra=(W,))(prior)[0]
    np.testing.assert_allclose(a.cov[1], plain.cov[1], atol=1e-12)


def test_a_missing_measurement_is_a_prediction_and_epochs_without_interval_an_update():
    W = np.linalg.cholesky(JOINT)
    part = single_draw(f, h, celnav.unscented(5), extra=(W,))
    first = celnav.update(Z, celnav.unscented(2), JOINT[2:, 2:])
    z = np.array([[1.0], [np.nan], [0.5]])
    track = celnav.run(drawn_once(part, first), celnav.square_root(np.zeros(2), np.eye(2)), celnav.epochs(np.arange(3.0), z))
    start = first(celnav.square_root(np.zeros(2), np.eye(2)), z[0])[0]
    np.testing.assert_allclose(track.mean[0], start.mean)
    np.testing.assert_allclose(track.mean[1], F @ start.mean, atol=1e-12)
    x, P = kalman(z[2], F @ start.mean, F @ start.cov @ F.T + JOINT[:2, :2])
    np.testing.assert_allclose(track.mean[2], x, atol=1e-10)
    np.testing.assert_allclose(track.std[2], np.sqrt(P.diagonal()), atol=1e-10)


def test_bad_input_is_refused_by_name():
    prior = celnav.square_root(np.zeros(2), np.eye(2))
    with pytest.raises(ValueError, match=r"^R: expected 1 rows"):
        single_draw(f, h, celnav.unscented(5), extra=(np.eye(3),), R=np.eye(2))(prior, np.zeros(1))
    with pytest.raises(ValueError, match=r"^rule: expected 5 dimensions"):
        single_draw(f, h, celnav.unscented(4), extra=(np.eye(3),))(prior, np.zeros(1))
    with pytest.raises(ValueError, match=r"^h returned shape"):
        single_draw(f, h, celnav.unscented(5), extra=(np.eye(3),))(prior, np.zeros(2))
