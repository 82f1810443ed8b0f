"""One set of points for prediction and update: exact in the linear case, also if the two noises are
correlated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from celnav import Epoch, Gaussian, Motion, Sensor, ckf, epochs, run, sigma_point, ukf
from celnav.filters.sequential import SingleDraw
from celnav.gaussian.rules import unscented

F, Z = np.array([[1.0, 0.2], [-0.1, 0.9]]), np.array([[1.0, 0.5]])
JOINT = np.array([[1.0, 0.3, 0.5], [0.3, 2.0, -0.4], [0.5, -0.4, 1.5]])
"""Covariance of process (2) and measurement noise (1)."""


ROOT, W, V = np.linalg.cholesky(JOINT), np.linalg.cholesky(JOINT[:2, :2]), np.sqrt(JOINT[2:, 2:])


def f(x, _epoch, *noise):
    """The first noise starts with the process noise, alone or together with the
    measurement noise.
    """
    return x @ F.T + noise[0][..., :2]


def h(y, _epoch, *noise):
    """The last noise ends with the measurement noise."""
    return y @ Z.T + noise[-1][..., 2:] if noise[-1].shape[-1] == 3 else y @ Z.T + noise[-1]


def kalman(z, x, P):
    """The exact filter of x' = F x + w, z = Z x' + v with correlated w, v."""
    Q, C, R = JOINT[:2, :2], JOINT[:2, 2:], JOINT[2:, 2:]
    x, P = F @ x, F @ P @ F.T + Q
    S = Z @ P @ Z.T + Z @ C + C.T @ Z.T + R
    K = (P @ Z.T + C) / S
    return x + K @ (z - Z @ x), P - K @ S @ K.T


PRIOR = Gaussian(np.zeros(2), np.eye(2))
NONE = np.zeros((1, 1))
MAKE = {
    "unscented": ukf,
    "negative weight": lambda *parts, **options: ukf(*parts, alpha=0.5, beta=2.0, **options),
    "cubature": ckf,
}


def correlated(make=ukf, **options):
    """As separate models each has its noise; in a single draw both functions
    get the joint noise.
    """
    plain = make(Motion(f, augment=(W,)), Sensor(h, augment=(V,)), **options)
    return replace(SingleDraw.of(plain), joint_noise=(ROOT,))


def stepped(filter, known, z):
    """The belief after an interval and its measurement, and the `Info`."""
    state, (info,) = filter.step(filter.start(known), Epoch(1, 1.0, 1.0, None, z))
    return state.belief, info


@pytest.mark.parametrize("form", ["square root", "covariance"])
@pytest.mark.parametrize("make", MAKE)
@pytest.mark.parametrize("whose", ["joint", "motion"])
def test_is_the_kalman_filter_with_correlated_noise(form, make, whose):
    """The noise of both functions is given as joint noise, or as the motion's noise, which reaches
    the measurement too.
    """
    filter = correlated(MAKE[make], form=form)
    if whose == "motion":
        filter = SingleDraw.of(MAKE[make](Motion(f, augment=(ROOT,)), Sensor(h, NONE), form=form))
    state, x, P = filter.start(PRIOR), np.zeros(2), np.eye(2)
    for k, z in enumerate(np.random.default_rng(0).standard_normal((10, 1)), start=1):
        state, (info,) = filter.step(state, Epoch(k, float(k), 1.0, None, z))
        x, P = kalman(z, x, P)
        np.testing.assert_allclose(state.belief.mean, x, atol=1e-10)
        np.testing.assert_allclose(state.belief.cov, P, atol=1e-10)
        assert info.used.all()


def test_additive_measurement_noise_is_the_same_as_through_the_points():
    motion = Motion(f, augment=(W,))
    through = SingleDraw.of(ukf(motion, Sensor(h, augment=(V,))))
    added = SingleDraw.of(ukf(motion, Sensor(lambda y, e, w: y @ Z.T, JOINT[2:, 2:])))
    known, z = Gaussian(np.ones((3, 2)), np.eye(2)), np.array([[0.5], [np.nan], [-2.0]])
    (a, _), (b, _) = stepped(through, known, z), stepped(added, known, z)
    np.testing.assert_allclose(a.mean, b.mean, atol=1e-12)
    np.testing.assert_allclose(a.cov, b.cov, atol=1e-12)
    plain = ukf(motion)
    moved = plain.predict(plain.start(known), Epoch(1, 1.0, 1.0)).belief
    np.testing.assert_allclose(a.cov[1], moved.cov[1], atol=1e-12)
    nothing, _ = stepped(through, known, np.full((3, 1), np.nan))
    np.testing.assert_allclose(nothing.mean, moved.mean, atol=1e-12)
    np.testing.assert_allclose(nothing.cov, moved.cov, atol=1e-12)


def test_a_missing_measurement_is_a_prediction_and_epochs_without_interval_an_update():
    z = np.array([[1.0], [np.nan], [0.5]])
    track = run(correlated(), PRIOR, epochs(np.arange(3.0), z))
    S = Z @ Z.T + JOINT[2:, 2:]
    start, P = (Z.T / S * z[0]).ravel(), np.eye(2) - Z.T @ Z / S
    np.testing.assert_allclose(track.mean[0], start, atol=1e-12)
    np.testing.assert_allclose(track.mean[1], F @ start, atol=1e-12)
    x, P = kalman(z[2], F @ start, F @ P @ F.T + JOINT[:2, :2])
    np.testing.assert_allclose(track.mean[2], x, atol=1e-10)
    np.testing.assert_allclose(track.std[2], np.sqrt(P.diagonal()), atol=1e-10)


SEEN, BOTH = Sensor(h, NONE), Motion(f, augment=(ROOT,))


@pytest.mark.parametrize(
    ("make", "z", "message"),
    [
        (lambda: ukf(BOTH, Sensor(h, np.eye(2))), np.zeros(1), r"^R: expected 1 rows"),
        (
            lambda: sigma_point(BOTH, SEEN, rule=unscented(4)),
            np.zeros(1),
            r"^rule: expected 5 dimensions",
        ),
        (lambda: ukf(BOTH, SEEN), np.zeros(2), r"^z: expected 1 components"),
        (
            lambda: ukf(Motion(f, np.eye(2), augment=(ROOT,)), SEEN),
            np.zeros(1),
            r"^filter: expected one sensor, and process noise",
        ),
        (
            lambda: ukf(Motion(f, sqrt_Q=np.eye(2), augment=(ROOT,)), SEEN),
            np.zeros(1),
            r"^filter: expected one sensor, and process noise",
        ),
        (
            lambda: ukf(BOTH, SEEN, SEEN),
            np.zeros(1),
            r"^filter: expected one sensor, and process noise",
        ),
    ],
)
def test_bad_input_is_refused_by_name(make, z, message):
    with pytest.raises(ValueError, match=message):
        stepped(SingleDraw.of(make()), PRIOR, z)
