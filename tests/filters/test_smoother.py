"""The smoother gives the marginals of the joint Gaussian of all states, and the results of
filterpy's smoother.
"""

import copy
import pickle
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from scipy.stats import chi2

from celnav import (
    Gaussian,
    Motion,
    Sensor,
    colored,
    decorrelated,
    ekf,
    epochs,
    imm,
    run,
    sigma_point,
    simulate,
    smooth,
    two_stage,
)
from celnav.filters.colored import augmented
from celnav.filters.fixed_lag import FixedLag
from celnav.filters.records import FilterError
from celnav.filters.sequential import SingleDraw
from celnav.filters.switching import Fallback
from celnav.gaussian.attitude import IDENTITY, attitude, exp
from celnav.gaussian.belief import nees
from celnav.gaussian.linalg import block
from celnav.gaussian.rules import Taylor, cubature, from_filterpy, gauss_hermite, simplex, unscented
from celnav.gaussian.spaces import EUCLIDEAN, Space, angles

A_ = np.array([[1.0, 0.1, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.3, 0.8]])
H_ = np.array([[1.0, 0.5, 0.0], [0.0, 1.0, -1.0]])
SQRT_Q = np.array([[0.3, 0.0], [0.1, 0.2], [0.0, 0.4]])
R = np.array([[0.5, 0.1], [0.1, 0.4]])
P0 = np.array([[1.0, 0.2, 0.0], [0.2, 0.8, 0.1], [0.0, 0.1, 0.5]])
PRIOR = Gaussian(np.zeros(3), P0)
T = 12
FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])


def linear(x, epoch):
    return x @ A_.T


MOTION, SEEN = Motion(linear, sqrt_Q=SQRT_Q), Sensor(H_, R)
JACOBIAN = Motion(linear, sqrt_Q=SQRT_Q, jacobian=lambda _mean, _epoch: A_)
RULES = {
    "unscented": (MOTION, unscented(3)),
    "negative center": (MOTION, unscented(3, alpha=1.0, beta=0.0, kappa=-1.0)),
    "simplex": (MOTION, simplex(3)),
    "cubature": (MOTION, cubature(3)),
    "fifth degree": (MOTION, cubature(3, degree=5)),
    "gauss-hermite": (MOTION, gauss_hermite(3)),
    "differences": (MOTION, Taylor()),
    "jacobian": (JACOBIAN, Taylor()),
    "matrix": (Motion(A_, sqrt_Q=SQRT_Q), unscented),
}


def filtered(motion, sensor, prior, when, rule=unscented, form="square root", **options):
    """The track of a filter with stored covariances."""
    return run(
        sigma_point(motion, sensor, rule=rule, form=form), prior, when, keep="cov", **options
    )


def measurements(rng, *batch):
    z = rng.normal(size=(T, *batch, 2))
    z[3, ..., 0] = np.nan
    z[7] = np.nan
    return z


def joint(z, prior_cov, transitions, noises, H=H_, R=R):
    """Mean and covariance of all states given all measurements, from their joint Gaussian, written
    out.
    """
    n, steps = len(prior_cov), len(z)
    sources = [np.linalg.cholesky(prior_cov + 0.0), *noises]
    rows = []
    for k in range(steps):
        row = []
        for j in range(steps):
            if j > k:
                row.append(np.zeros((n, sources[j].shape[1])))
                continue
            M = sources[j]
            for i in range(j, k):
                M = transitions[i] @ M
            row.append(M)
        rows.append(np.hstack(row))
    X = np.vstack(rows)
    P = X @ X.T
    Hall = np.kron(np.eye(steps), H)
    there = ~np.isnan(z.ravel())
    Hall, data = Hall[there], z.ravel()[there]
    noise = np.kron(np.eye(steps), R)[np.ix_(there, there)]
    K = np.linalg.solve(Hall @ P @ Hall.T + noise, Hall @ P).T
    cov = P - K @ Hall @ P
    at = [slice(n * k, n * k + n) for k in range(steps)]
    return (K @ data).reshape(steps, n), np.array([cov[i, i] for i in at])


@pytest.mark.parametrize("name", RULES)
@FORMS
def test_equals_the_joint_gaussian(name, form):
    """With a linear model every rule is exact; the process noise has rank 2, so the joint of two
    states is singular.
    """
    motion, rule = RULES[name]
    z = measurements(np.random.default_rng(1))
    track = filtered(motion, SEEN, PRIOR, epochs(np.arange(T), z), rule, form)
    smoothed = smooth(track, gains=True)
    mean, cov = joint(z, P0, [A_] * (T - 1), [SQRT_Q] * (T - 1))
    np.testing.assert_allclose(smoothed.mean, mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(smoothed.cov, cov, rtol=0, atol=1e-9)
    np.testing.assert_allclose(smoothed.std, np.sqrt(cov.diagonal(0, -2, -1)), rtol=0, atol=1e-9)
    # the textbook gain P F' (F P F' + Q)^-1
    P = track.cov[4]
    G = P @ A_.T @ np.linalg.inv(A_ @ P @ A_.T + SQRT_Q @ SQRT_Q.T)
    np.testing.assert_allclose(smoothed.extra["gain"][4], G, rtol=0, atol=1e-9)
    assert not smoothed.extra["gain"][-1].any()
    assert "gain" not in smooth(track).extra
    assert (track.mean[:-1] != smoothed.mean[:-1]).any()
    np.testing.assert_array_equal(track.mean[-1], smoothed.mean[-1])


@FORMS
def test_irregular_times_inputs_and_noise_functions(form):
    """Intervals, inputs and noise belong to the epoch that ends them; an interval of 0 shares its
    state.
    """
    rng = np.random.default_rng(2)
    times = np.array([0.0, 1.0, 1.5, 1.5, 4.0, 4.25])
    z, u = rng.normal(size=(6, 2)), rng.normal(size=(5, 3))
    dts = np.diff(times)

    def matrix(dt):
        return np.eye(3) + dt * (A_ - np.eye(3))

    def f(x, epoch):
        return x @ matrix(epoch.dt).T + epoch.dt * epoch.u

    def noise(mean, epoch):
        return np.sqrt(epoch.dt) * SQRT_Q

    smoothed = smooth(
        filtered(Motion(f, sqrt_Q=noise), SEEN, PRIOR, epochs(times, z, u), form=form)
    )
    # the input is a known offset of the states: take its effect out of the data, then put it back
    offset = np.zeros((6, 3))
    for k in range(5):
        offset[k + 1] = matrix(dts[k]) @ offset[k] + dts[k] * u[k]
    mean, cov = joint(
        z - offset @ H_.T, P0, [matrix(dt) for dt in dts], [np.sqrt(dt) * SQRT_Q for dt in dts]
    )
    np.testing.assert_allclose(smoothed.mean, mean + offset, rtol=0, atol=1e-9)
    np.testing.assert_allclose(smoothed.cov, cov, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(smoothed.mean[2], smoothed.mean[3])


def pendulum(x, epoch):
    angle, rate = x[..., 0] + epoch.dt * x[..., 1], x[..., 1] - epoch.dt * np.sin(x[..., 0])
    return np.stack([angle, rate], -1)


def sine(x, epoch):
    return np.sin(x[..., :1])


@pytest.mark.parametrize(
    "points", [(1.0, 0.0, 1.0), (0.6, 0.0, 1.0)], ids=["positive", "negative weight"]
)
@FORMS
def test_equals_filterpy(points, form):
    """filterpy smooths with the interval and the noise at the earlier index; our epochs end
    intervals.
    """
    rng = np.random.default_rng(3)
    times = np.array([0.0, 0.3, 0.5, 1.1, 1.3, 2.0, 2.2, 2.9])
    z = np.sin(0.6 + times)[:, None] + 0.1 * rng.normal(size=(len(times), 1))
    Q, cov, mean = np.diag([0.01, 0.02]), np.diag([0.3, 0.2]), np.array([0.5, 0.4])
    theirs = MerweScaledSigmaPoints(2, *points)

    class At:
        def __init__(self, dt):
            self.dt = dt

    ukf = UnscentedKalmanFilter(
        2, 1, 0.1, hx=lambda x: np.sin(x[:1]), fx=lambda x, dt: pendulum(x, At(dt)), points=theirs
    )
    ukf.x, ukf.P, ukf.Q, ukf.R = mean.copy(), cov.copy(), Q, np.array([[0.01]])
    means, covs = [], []
    for dt, measured in zip(np.diff(times), z[1:], strict=True):
        ukf.predict(dt=dt)
        ukf.update(measured)
        means.append(ukf.x.copy())
        covs.append(ukf.P.copy())
    expected, expected_cov, gains = ukf.rts_smoother(
        np.array(means), np.array(covs), dts=[*np.diff(times)[1:], 0.0]
    )

    z[0] = np.nan  # filterpy has no update of the prior
    motion, sensor, prior = Motion(pendulum, Q), Sensor(sine, [[0.01]]), Gaussian(mean, cov)
    smoothed = smooth(
        filtered(motion, sensor, prior, epochs(times, z), from_filterpy(theirs), form), gains=True
    )
    np.testing.assert_allclose(smoothed.mean[1:], expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(smoothed.cov[1:], expected_cov, rtol=0, atol=1e-10)
    np.testing.assert_allclose(smoothed.extra["gain"][1:-1], gains[:-1], rtol=0, atol=1e-9)


def simulate_pendulum(rng, runs, steps=60):
    Q, R = np.diag([1e-4, 4e-3]), np.array([[0.04]])
    times = 0.2 * np.arange(steps)
    x = np.array([0.5, 0.0]) + rng.normal(size=(runs, 2)) * [0.3, 0.3]
    when = epochs(times)
    truth, z = [x], [sine(x, None)]
    for epoch in when[1:]:
        x = pendulum(x, epoch) + rng.normal(size=(runs, 2)) @ np.sqrt(Q)
        truth.append(x)
        z.append(sine(x, epoch))
    z = np.array(z) + 0.2 * rng.normal(size=(steps, runs, 1))
    return np.array(truth), z, times, Motion(pendulum, Q), Sensor(sine, R)


def test_better_than_the_filter():
    """On average the smoother's error is smaller, its covariance says so, and it is consistent."""
    truth, z, times, motion, sensor = simulate_pendulum(np.random.default_rng(4), 40)
    prior = Gaussian(np.tile([0.5, 0.0], (40, 1)), np.diag([0.09, 0.09]))
    track = filtered(motion, sensor, prior, epochs(times, z))
    smoothed = smooth(track)
    inner = slice(5, -5)
    filter_error = np.sqrt(np.mean((track.mean - truth)[inner] ** 2))
    smoother_error = np.sqrt(np.mean((smoothed.mean - truth)[inner] ** 2))
    assert smoother_error < 0.9 * filter_error
    assert (smoothed.std[inner] < track.std[inner]).all()
    total = nees(smoothed.mean[30] - truth[30], smoothed.sqrt_cov[30]).sum()
    low, high = chi2.ppf([0.001, 0.999], 80)
    assert low < total < high


@pytest.mark.parametrize("rule", [unscented(2), unscented(2, 0.5, 2.0), Taylor()], ids=repr)
@FORMS
def test_batch_is_singles(rule, form):
    """Runs are independent, for any number of batch axes; forms agree."""
    _, z, times, motion, sensor = simulate_pendulum(np.random.default_rng(5), 6, 15)
    z[4, 2] = np.nan
    z = z.reshape(15, 2, 3, 1)
    P = np.diag([0.09, 0.09])
    many = smooth(
        filtered(
            motion,
            sensor,
            Gaussian(np.tile([0.5, 0.0], (2, 3, 1)), P),
            epochs(times, z),
            rule,
            form,
        )
    )
    assert many.mean.shape == (15, 2, 3, 2)
    for i, j in np.ndindex(2, 3):
        one = smooth(
            filtered(motion, sensor, Gaussian([0.5, 0.0], P), epochs(times, z[:, i, j]), rule, form)
        )
        np.testing.assert_allclose(one.mean, many.mean[:, i, j], rtol=0, atol=1e-11)
        np.testing.assert_allclose(one.cov, many.cov[:, i, j], rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    "rule",
    [unscented, partial(cubature, degree=5), Taylor()],
    ids=["unscented", "cubature 5", "Taylor"],
)
def test_noise_through_the_points(rule):
    """Noise through the points gives the same result as additive noise if it enters additively,
    also with negative weights.
    """
    z = measurements(np.random.default_rng(6))

    def f(x, epoch, w):
        return x @ A_.T + w @ SQRT_Q.T

    smoothed = smooth(
        filtered(Motion(f, augment=(np.eye(2),)), SEEN, PRIOR, epochs(np.arange(T), z), rule)
    )
    mean, cov = joint(z, P0, [A_] * (T - 1), [SQRT_Q] * (T - 1))
    np.testing.assert_allclose(smoothed.mean, mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(smoothed.cov, cov, rtol=0, atol=1e-9)


def test_a_turn_more_changes_nothing():
    """A heading on the circle: the smoother gives the same result if the heading starts half a turn
    away, so that it wraps.
    """
    rng = np.random.default_rng(7)
    times, turn = np.arange(15.0), 0.3
    space = angles([0])

    def f(x, epoch):
        return np.stack([x[..., 0] + x[..., 1] * epoch.dt, x[..., 1]], -1)

    Q, R, P = np.diag([1e-3, 1e-4]), np.array([[0.01]]), np.diag([0.1, 0.01])
    z = (turn * times + 0.1 * rng.normal(size=15))[:, None]

    def estimate(start, sp, zsp):
        motion, sensor = Motion(f, Q, space=sp), Sensor(lambda x, e: x[..., :1], R, space=zsp)
        return smooth(
            filtered(
                motion,
                sensor,
                Gaussian([start, turn], P),
                epochs(times, zsp.plus(np.array([start]), z)),
            )
        )

    wrapped = estimate(1.0, space, angles())
    plain = estimate(0.0, EUCLIDEAN, EUCLIDEAN)
    assert plain.mean[-1, 0] + 1.0 > np.pi  # it has wrapped
    assert (np.abs(wrapped.mean[:, 0]) <= np.pi).all()
    np.testing.assert_allclose(
        space.minus(wrapped.mean, plain.mean), np.tile([1.0, 0.0], (15, 1)), rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(wrapped.cov, plain.cov, rtol=0, atol=1e-10)


@FORMS
def test_deviations_are_carried_to_where_they_belong(form):
    """A position with differences in body axes: a moving frame of a flat space must give the
    results of the fixed frame.
    """

    def turned(heading, vector):
        c, s = np.cos(heading), np.sin(heading)
        x, y = vector[..., 0], vector[..., 1]
        return np.stack([c * x - s * y, s * x + c * y], -1)

    def plus(p, d):
        return np.concatenate(
            [p[..., :2] + turned(p[..., 2], d[..., :2]), p[..., 2:] + d[..., 2:]], -1
        )

    def minus(b, a):
        return np.concatenate(
            [turned(-a[..., 2], b[..., :2] - a[..., :2]), b[..., 2:] - a[..., 2:]], -1
        )

    def frame(heading):
        out = np.zeros((*np.shape(heading), 3, 3))
        out[..., 0, 0] = out[..., 1, 1] = np.cos(heading)
        out[..., 1, 0] = np.sin(heading)
        out[..., 0, 1] = -out[..., 1, 0]
        out[..., 2, 2] = 1.0
        return out

    body = Space(plus, minus, transport=lambda d: frame(-d[..., 2]))
    Q, start = np.diag([0.2, 0.1, 0.05]), np.array([1.0, -1.0, 0.4])
    when = epochs(np.arange(8), np.random.default_rng(8).normal(size=(8, 2)))

    def estimate(space, axes):
        def noise(mean, epoch):
            return axes(mean @ A_[2]).mT @ np.sqrt(Q)

        motion, sensor = Motion(linear, sqrt_Q=noise, space=space), Sensor(lambda x, e: x @ H_.T, R)
        prior = Gaussian(start, axes(start[2]).T @ P0 @ axes(start[2]))
        return smooth(filtered(motion, sensor, prior, when, form=form))

    flat = estimate(EUCLIDEAN, lambda heading: frame(0.0 * heading))
    moving = estimate(body, frame)
    np.testing.assert_allclose(moving.mean, flat.mean, rtol=0, atol=1e-10)
    axes = frame(moving.mean[:, 2])
    np.testing.assert_allclose(axes @ moving.cov @ axes.mT, flat.cov, rtol=0, atol=1e-10)
    assert np.abs(moving.cov - flat.cov).max() > 0.01


def test_colored_noise():
    """The augmented filter's track smooths states and colored noise together, and equals the joint
    Gaussian of both.
    """
    Phi, increments, first = np.diag([0.9, 0.6]), np.diag([0.02, 0.05]), np.diag([0.3, 0.2])
    Q = SQRT_Q @ SQRT_Q.T + 0.01 * np.eye(3)
    z = np.random.default_rng(9).normal(size=(T, 2))
    z[4, 1] = np.nan
    filter = augmented(Motion(linear, Q), Sensor(H_, first), Phi, increments=increments)
    smoothed = smooth(run(filter, PRIOR, epochs(np.arange(T), z), keep="cov"))
    both = block([[Q, 0], [0, increments]])
    transition, H = block([[A_, 0], [0, Phi]]), np.hstack([H_, np.eye(2)])
    mean, cov = joint(
        z,
        block([[P0, 0], [0, first]]),
        [transition] * (T - 1),
        [np.linalg.cholesky(both)] * (T - 1),
        H,
        np.zeros((2, 2)),
    )
    np.testing.assert_allclose(smoothed.mean, mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(smoothed.cov, cov, rtol=0, atol=1e-9)


def walked(x, epoch, *noise):
    return sum(noise, linear(x, epoch))


KNOWN, THROUGH = (
    Motion(A_, np.eye(3)),
    sigma_point(Motion(walked, augment=[np.eye(3)]), SEEN, rule=unscented),
)
MODELS = [sigma_point(KNOWN, SEEN, rule=unscented)] * 2
BIASED = Motion(block([[A_, 0], [0, np.eye(2)]]), np.eye(5)), Sensor(np.hstack([H_, np.eye(2)]), R)
FORWARD_ONLY = {
    "colored": (
        colored(KNOWN, SEEN, 0.5 * np.eye(2)),
        "whose differences of measurements share their noise with the motion; smooth a track of "
        "celnav.augmented(motion, sensor, Phi), which has the colored noise as states",
        augmented(KNOWN, SEEN, 0.5 * np.eye(2)),
    ),
    "decorrelated": (
        decorrelated(KNOWN, SEEN, 0.5 * np.eye(2)),
        "whose differences of measurements share their noise with the motion; smooth a track of "
        "celnav.augmented(motion, sensor, Phi), which has the colored noise as states",
        augmented(KNOWN, SEEN, 0.5 * np.eye(2)),
    ),
    "two stages": (
        two_stage(KNOWN, SEEN, np.eye(2), Gaussian(np.zeros(2), np.eye(2))),
        "whose stages have no joint model of state and bias to go back by; smooth a track of "
        "celnav.ukf with the bias as a state",
        sigma_point(*BIASED, rule=unscented),
    ),
    "models": (
        imm(MODELS, np.full((2, 2), 0.5)),
        "whose estimate is a mixture, which none of its models leads back from; smooth the track "
        "of one of its filters alone",
        MODELS[0],
    ),
    "single draw": (
        SingleDraw.of(THROUGH),
        "which draws the noise of motion and sensor together; smooth a track of the filter that "
        "it was made of",
        THROUGH,
    ),
    "lag": (
        FixedLag(MODELS[0], 3),
        "which smooths its last epochs by filter.track(state); smooth a track of its own filter",
        MODELS[0],
    ),
}


@pytest.mark.parametrize("name", FORWARD_ONLY)
def test_what_cannot_be_smoothed_says_why_and_what_can(name):
    filter, reason, instead = FORWARD_ONLY[name]
    z = measurements(np.random.default_rng(14))
    expected = "filter: expected a filter that predicts, then updates, such as celnav.ukf, got "
    with pytest.raises(ValueError, match="^" + re.escape(expected) + r"\w+, " + re.escape(reason)):
        smooth(run(filter, PRIOR, np.arange(T), z, keep="cov"))
    prior = Gaussian(np.zeros(5), np.eye(5)) if name == "two stages" else PRIOR
    assert np.isfinite(smooth(run(instead, prior, np.arange(T), z, keep="cov")).std).all()


@FORMS
def test_known_directions(form):
    """An exact constant, and an exact combination of two states, have no effect on the other
    states.
    """
    z = measurements(np.random.default_rng(10))
    when = epochs(np.arange(T), z)
    turn = np.linalg.qr(np.random.default_rng(11).normal(size=(5, 5)))[0]
    F = block([[A_, np.full((3, 2), 0.1)], [0, np.diag([1.0, 0.5])]])
    mean, P = np.array([0.0, 0.0, 0.0, 2.0, -1.0]), block([[P0, 0], [0, np.zeros((2, 2))]])
    noise = block([[SQRT_Q], [np.zeros((2, 2))]])
    H = np.hstack([H_, np.zeros((2, 2))])
    offset = np.zeros((T, 5))
    offset[0] = mean
    for k in range(T - 1):
        offset[k + 1] = F @ offset[k]
    expected, cov = joint(z - offset @ H.T, P0, [A_] * (T - 1), [SQRT_Q] * (T - 1))
    for M in (np.eye(5), turn):

        def f(x, epoch, M=M):
            return x @ (M @ F @ M.T).T

        prior = Gaussian(M @ mean, M @ P @ M.T)
        smoothed = smooth(
            filtered(Motion(f, sqrt_Q=M @ noise), Sensor(H @ M.T, R), prior, when, form=form)
        )
        straight = smoothed.mean @ M - offset
        np.testing.assert_allclose(straight[:, :3], expected, rtol=0, atol=1e-6)
        np.testing.assert_allclose(straight[:, 3:], 0.0, rtol=0, atol=1e-6)
        full = M.T @ smoothed.cov @ M
        np.testing.assert_allclose(full[:, :3, :3], cov, rtol=0, atol=1e-6)
        np.testing.assert_allclose(full[:, 3:, 3:], 0.0, rtol=0, atol=1e-6)


def breaks(x, epoch):
    """A model with which the second run fails in the sixth interval."""
    y = x @ A_.T
    if epoch.k == 6:
        y[:, 1] = np.nan
    return y


PAIR = Gaussian(np.zeros((2, 3)), P0)
BROKEN = Motion(breaks, sqrt_Q=SQRT_Q)


@FORMS
@pytest.mark.parametrize("kappa", [-1.0, -1.9])
def test_a_state_that_the_next_one_tells_exactly(form, kappa):
    """A constant together with a random walk: only round-off remains of its columns, also with
    negative weights.
    """
    F, seen = np.array([[1.0, 1.0], [0.0, 1.0]]), Sensor(np.eye(1, 2), R=[[1.0]])
    motion, prior = Motion(F, Q=np.diag([0.01, 0.0])), Gaussian(np.zeros(2), np.diag([1.0, 1e-4]))
    times = np.arange(100.0)
    _, z = simulate(motion, seen, prior, times, runs=20)
    exact = smooth(run(ekf(motion, seen), prior, times, z, keep="cov"))
    by_points = replace(motion, f=lambda x, epoch: x @ F.T)
    smoothed = smooth(
        filtered(by_points, seen, prior, epochs(times, z), unscented(2, kappa=kappa), form)
    )
    np.testing.assert_allclose(smoothed.mean, exact.mean, atol=1e-11)
    np.testing.assert_allclose(smoothed.cov, exact.cov, atol=1e-11)


def test_a_lost_run_is_smoothed_up_to_its_loss():
    """Up to its failure it equals the smoother of the shorter run; the other
    run is not affected.
    """
    z = measurements(np.random.default_rng(12), 2)
    both = smooth(filtered(BROKEN, SEEN, PAIR, epochs(np.arange(T), z), on_failure="flag"))
    np.testing.assert_array_equal(both.failed_at, [-1, 6])
    assert np.isnan(both.mean[6:, 1]).all()
    shorter = smooth(filtered(MOTION, SEEN, PRIOR, epochs(np.arange(6), z[:6, 1])))
    np.testing.assert_allclose(both.mean[:6, 1], shorter.mean, rtol=0, atol=1e-12)
    whole = smooth(filtered(MOTION, SEEN, PRIOR, epochs(np.arange(T), z[:, 0])))
    np.testing.assert_allclose(both.mean[:, 0], whole.mean, rtol=0, atol=1e-12)


def test_a_run_that_the_smoother_loses_is_told():
    """The dynamics fail only in the backward pass: the error names the step, or the run is flagged
    at it.
    """
    track = filtered(
        MOTION, SEEN, PAIR, epochs(np.arange(T), measurements(np.random.default_rng(13), 2))
    )
    other = sigma_point(BROKEN, SEEN, rule=unscented)
    with pytest.raises(FilterError, match=r"from step 6, t = 6.0, run \(1,\)"):
        smooth(track, other)
    flagged = smooth(track, other, on_failure="flag")
    np.testing.assert_array_equal(flagged.failed_at, [-1, 5])
    assert np.isnan(flagged.mean[:6, 1]).all()
    whole = smooth(track)
    np.testing.assert_array_equal(flagged.mean[:, 0], whole.mean[:, 0])
    np.testing.assert_array_equal(flagged.mean[6:], whole.mean[6:])


def track_of(filter, **options):
    return run(
        filter,
        PRIOR,
        epochs(np.arange(T), measurements(np.random.default_rng(14))),
        **{"keep": "cov"} | options,
    )


PLAIN = sigma_point(MOTION, SEEN, rule=unscented)
TWO, THREE = np.eye(2), 0.01 * np.eye(3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: smooth(PLAIN), r"^track: expected what celnav.run gave, got "),
        (
            lambda: smooth(track_of(PLAIN, keep="std")),
            r"^track: expected stored covariances, got none; run with keep='cov'",
        ),
        (
            lambda: smooth(track_of(PLAIN, every=3)),
            r"^track: expected every epoch, got some epochs; run with every=1",
        ),
        (
            lambda: smooth(pickle.loads(pickle.dumps(track_of(PLAIN)))),
            r"^filter: expected the track's filter, because",
        ),
        (
            lambda: smooth(track_of(PLAIN), MOTION),
            r"^filter: expected a filter that predicts, then updates, such as .*, got Motion$",
        ),
        (
            lambda: smooth(track_of(colored(Motion(linear, THREE), SEEN, 0.5 * TWO))),
            r"^filter: expected a filter that predicts, .*, got Colored, whose differences of "
            r"measurements "
            r"share their noise with the motion; smooth a track of celnav.augmented\(motion",
        ),
        (
            lambda: smooth(track_of(PLAIN), sigma_point(Motion(linear, TWO), SEEN, rule=unscented)),
            r"^Q: expected 3 rows",
        ),
        (
            lambda: smooth(
                track_of(PLAIN), replace(PLAIN, motion=Motion(lambda x, e: x[..., :2], THREE))
            ),
            r"^f returned shape",
        ),
        (lambda: smooth(track_of(PLAIN), on_failure="ignore"), r"^on_failure: expected "),
    ],
)
def test_bad_input_is_refused_by_name(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_one_epoch_a_stream_of_epochs_a_pickle_and_a_fallback():
    """With one epoch nothing changes; epochs may be a generator; a pickled track needs its filter
    as an argument.
    """
    z = measurements(np.random.default_rng(15))
    one = run(PLAIN, PRIOR, epochs([0.0], z[:1]), keep="cov")
    np.testing.assert_array_equal(smooth(one).mean, one.mean)
    when = epochs(np.arange(T), z)
    track = run(PLAIN, PRIOR, when, keep="cov")
    others = (
        smooth(run(PLAIN, PRIOR, (epoch for epoch in when), keep="cov")),
        smooth(pickle.loads(pickle.dumps(track)), PLAIN),
        smooth(run(Fallback(PLAIN, PLAIN), PRIOR, when, keep="cov")),
    )
    for other in others:
        np.testing.assert_array_equal(other.mean, smooth(track).mean)
        np.testing.assert_array_equal(other.belief[1], smooth(track).belief[1])


@pytest.mark.parametrize(
    "copied", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy], ids=["pickle", "deepcopy"]
)
@FORMS
def test_a_copied_track_is_smoothed_like_the_track(form, copied):
    motion = Motion(lambda x, epoch: x, THREE, space=attitude(transported=True))
    filter = sigma_point(
        motion,
        Sensor(lambda x, epoch: x, 0.1 * np.eye(3), space=attitude()),
        rule=unscented,
        form=form,
    )
    z = exp(0.8 * np.random.default_rng(5).normal(size=(6, 3)))
    track = run(
        filter, Gaussian(IDENTITY, np.diag([1.0, 0.5, 0.1])), epochs(np.arange(6), z), keep="cov"
    )
    again, plain = smooth(copied(track), filter), smooth(track)
    np.testing.assert_array_equal(again.std, plain.std)
    np.testing.assert_array_equal(again.cov, plain.cov)
    assert type(copied(track).belief) is type(track.belief)


@FORMS
def test_an_epoch_at_the_same_time_has_the_gain_one(form):
    """Nothing moves between the two epochs, so both have the later estimate."""
    motion, rule = RULES["unscented"]
    times, z = np.array([0.0, 1.0, 1.0, 2.0]), measurements(np.random.default_rng(1))[:4]
    track = filtered(motion, SEEN, PRIOR, epochs(times, z), rule, form)
    smoothed = smooth(track, gains=True)
    np.testing.assert_array_equal(smoothed.extra["gain"][1], np.eye(3))
    np.testing.assert_allclose(smoothed.mean[1], smoothed.mean[2], rtol=1e-12)
    np.testing.assert_allclose(smoothed.cov[1], smoothed.cov[2], rtol=1e-12)
