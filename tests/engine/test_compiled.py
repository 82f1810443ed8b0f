"""Every filter gives the same track with numpy and as machine code."""

from __future__ import annotations

import numpy as np
import pytest
from twice import assert_same, twice

import celnav
from celnav.filters.adaptive import (
    chi_square_gate,
    consider,
    correntropy,
    gate,
    huber,
    innovation_window,
    sage_husa,
    student_t,
    underweighting,
    variational_bayes,
)
from celnav.filters.sequential import SingleDraw
from celnav.filters.switching import Fallback
from celnav.gaussian.attitude import attitude, rotate
from celnav.gaussian.spaces import EUCLIDEAN, product
from celnav.models.gyro import Gyro

pytest.importorskip("llvmlite")

OPTIMIZED = True  # machine code as users get it

SCALE_M, AWAY_M, GRAVITY, DRAG = 7200.0, 100e3, 9.81, 0.5 * 1.225 / 500.0
RUNS = 3


# -- a falling body, seen by a radar ---------------------------------------------------------------
def fall(x, epoch):
    h, v, b = x[..., 0], x[..., 1], x[..., 2]
    return np.stack(
        [h - epoch.dt * v, v + epoch.dt * (GRAVITY - DRAG * np.exp(-h / SCALE_M - b) * v**2), b], -1
    )


def fall_slope(x, epoch):
    """Its Jacobian."""
    h, v, b = x[..., 0], x[..., 1], x[..., 2]
    drag = DRAG * epoch.dt * np.exp(-h / SCALE_M - b) * v
    one, zero = np.ones(h.shape), np.zeros(h.shape)
    rows = (
        [one, -epoch.dt * one, zero],
        [drag * v / SCALE_M, 1.0 - 2.0 * drag, drag * v],
        [zero, zero, one],
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def distance(x, _epoch):
    return np.hypot(x[..., :1], AWAY_M)


def distance_slope(x, _epoch):
    zero = np.zeros(x.shape[:-1])
    return np.stack([x[..., 0] / np.hypot(x[..., 0], AWAY_M), zero, zero], -1)[..., None, :]


def both_seen(x, _epoch):
    return np.stack([x[..., 0], x[..., 1]], -1)


W = np.diag([0.0, 0.2, 0.001])
TIMES = 0.5 * np.arange(12)
MOTION, RADAR = celnav.Motion(fall, sqrt_Q=W), celnav.Sensor(distance, R=[[25.0]])
EXACT = (
    celnav.Motion(fall, sqrt_Q=W, jacobian=fall_slope),
    celnav.Sensor(distance, R=[[25.0]], jacobian=distance_slope),
)
HEIGHT, BOTH = (
    celnav.Sensor(np.eye(1, 3), [[25.0]]),
    celnav.Sensor(both_seen, np.diag([100.0, 4.0])),
)
START = celnav.Gaussian([40e3, 3000.0, 0.0], np.diag([1000.0, 100.0, 0.3]) ** 2)
TRUTH, Z = celnav.simulate(MOTION, RADAR, START, TIMES, runs=RUNS)
MANY = celnav.Gaussian(np.tile(START.mean, (RUNS, 1)), START.cov)
RNG = np.random.default_rng(3)
GAPS = np.where(RNG.random(Z.shape) < 0.25, np.nan, Z)
GAPS[10:12] = np.nan
Z2 = TRUTH[..., :2] + RNG.standard_normal((len(TIMES), RUNS, 2)) * [10.0, 2.0]
GAPS2 = np.where(RNG.random(Z2.shape) < 0.3, np.nan, Z2)
RATES = Z2.copy()
RATES[np.arange(len(TIMES)) % 3 > 0] = np.nan
OWN = 1.0 + np.arange(RUNS)[:, None, None]
BIAS = celnav.Gaussian([0.0], [[50.0**2]])
HOOKS = {
    "gate": gate(1.0),
    "chi-square": chi_square_gate(0.5),
    "window": innovation_window(5),
    "window skip": innovation_window(5, "skip"),
    "Huber": huber(),
    "Student": student_t(),
    "Sage-Husa": sage_husa(),
    "correntropy": correntropy(),
    "variational": variational_bayes(),
    "underweighted": underweighting(0.3, 0.2),
}
RULES = {
    "unscented": celnav.unscented,
    "unscented alpha": lambda n: celnav.unscented(n, 0.5, 2.0),
    "simplex": celnav.simplex,
    "cubature": celnav.cubature,
    "cubature 5": lambda n: celnav.cubature(n, degree=5),
    "Gauss-Hermite": celnav.gauss_hermite,
    "sparse grid": lambda n: celnav.smolyak(n, 3),
}


def noisy_fall(x, epoch, *noise):
    return fall(x, epoch) + noise[0]


def noisy_distance(x, epoch, *noise):
    return distance(x, epoch) + noise[-1]


def drag_noise(mean, epoch):
    return epoch.dt * np.diag([0.0, 0.04, 1e-6]) * (1.0 + 1e-10 * mean[..., 0, None, None] ** 2)


def both_noise(mean, epoch):
    return (
        np.diag([100.0, 4.0])
        * (1.0 + 1e-10 * mean[..., 0, None, None] ** 2)
        * (1.0 + 0.01 * epoch.k)
    )


NOISY = celnav.Motion(noisy_fall, augment=(W,))
NOISY_RADAR = celnav.Sensor(noisy_distance, augment=(np.array([[5.0]]),))
FALLS = {name: (celnav.sigma_point(MOTION, RADAR, rule=rule), Z) for name, rule in RULES.items()}
FALLS |= {
    f"{name}, cov": (celnav.sigma_point(MOTION, RADAR, rule=rule, form="covariance"), Z)
    for name, rule in RULES.items()
}
FALLS |= {
    f"{name} hook": (celnav.ukf(MOTION, BOTH, hooks=[hook]), GAPS2) for name, hook in HOOKS.items()
}
FALLS |= {
    f"{name} hook, cov": (celnav.ukf(MOTION, RADAR, hooks=[hook], form="covariance"), GAPS)
    for name, hook in HOOKS.items()
}
FALLS |= {
    "colored": (celnav.colored(MOTION, RADAR, [[0.9]]), Z),
    "colored, gaps": (celnav.colored(MOTION, RADAR, [[0.9]]), GAPS),
    "colored, two": (celnav.colored(MOTION, BOTH, np.diag([0.9, 0.8])), GAPS2),
    "colored, cov": (celnav.colored(MOTION, RADAR, [[0.9]], form="covariance"), GAPS),
    "colored, not the first": (celnav.colored(MOTION, RADAR, [[0.9]], first=False), GAPS),
    "colored sparse grid": (celnav.colored(MOTION, RADAR, [[0.9]], rule=RULES["sparse grid"]), Z),
    "colored Huber": (celnav.colored(MOTION, RADAR, [[0.9]], hooks=[huber()]), GAPS),
    "colored of runs": (celnav.colored(MOTION, RADAR, 0.3 * OWN), GAPS),
    "decorrelated": (celnav.decorrelated(MOTION, HEIGHT, [[0.9]]), Z),
    "decorrelated, gaps": (celnav.decorrelated(MOTION, HEIGHT, [[0.9]]), GAPS),
    "augmented": (celnav.augmented(MOTION, RADAR, [[0.9]]), GAPS),
    "augmented, cov": (celnav.augmented(MOTION, RADAR, [[0.9]], form="covariance"), Z),
    "two stages": (celnav.two_stage(MOTION, RADAR, [[1.0]], BIAS), GAPS),
    "two stages, drifting": (celnav.two_stage(MOTION, RADAR, [[1.0]], BIAS, Qb=[[1.0]]), Z),
    "noise through the points": (celnav.ukf(NOISY, NOISY_RADAR), GAPS),
    "single draw": (SingleDraw.of(celnav.ukf(NOISY, NOISY_RADAR)), GAPS),
    "fallback": (
        Fallback(
            celnav.sigma_point(MOTION, RADAR, rule=RULES["sparse grid"]), celnav.ckf(MOTION, RADAR)
        ),
        GAPS,
    ),
    "two sensors": (celnav.ukf(MOTION, RADAR, BOTH), (GAPS, GAPS2)),
    "two rates": (celnav.ukf(MOTION, RADAR, BOTH), (Z, RATES)),
    "one of two": (celnav.ukf(MOTION, RADAR, BOTH), (np.full_like(Z, np.nan), GAPS2)),
    "no measurement": (celnav.ukf(MOTION, RADAR), None),
    "no sensor": (celnav.ukf(MOTION), None),
    "noises that are functions": (
        celnav.ukf(celnav.Motion(fall, drag_noise), celnav.Sensor(both_seen, both_noise)),
        GAPS2,
    ),
    "noises of runs": (
        celnav.ukf(
            celnav.Motion(fall, 1e-2 * OWN * np.eye(3)), celnav.Sensor(distance, 25.0 * OWN)
        ),
        GAPS,
    ),
    "consider": (celnav.ukf(MOTION, RADAR, gain=consider(2, 1)), GAPS),
    "a fixed gain": (celnav.ukf(MOTION, RADAR, gain=np.array([[0.1], [0.01], [0.0]])), GAPS),
    "gains of runs": (celnav.ukf(MOTION, RADAR, gain=OWN * np.array([[0.1], [0.01], [0.0]])), GAPS),
}


@pytest.mark.parametrize("name", FALLS)
def test_filters_of_a_falling_body(name):
    filter, z = FALLS[name]
    assert_same(*twice(filter, MANY, TIMES, z, keep="cov"))


@pytest.mark.parametrize("form", ["square root", "covariance"])
@pytest.mark.parametrize(
    "options", [{}, {"hooks": [gate(1.0)]}, {"iterations": 3}], ids=["plain", "gate", "iterated"]
)
def test_jacobians_that_are_given_or_found(form, options):
    """A recorded model has exact derivatives; for numpy they are passed as Jacobians."""
    known = celnav.ekf(*EXACT, form=form, **options)
    assert_same(*twice(known, MANY, TIMES, GAPS, keep="cov"))
    assert_same(
        *twice(
            celnav.ekf(MOTION, RADAR, form=form, **options), MANY, TIMES, GAPS, of=known, keep="cov"
        )
    )


def test_jacobians_of_colored_noise_and_of_two_stages():
    for make in (
        lambda *parts: celnav.colored(*parts, [[0.9]], rule=celnav.Taylor()),
        lambda *parts: celnav.two_stage(*parts, [[1.0]], BIAS, rule=celnav.Taylor()),
    ):
        assert_same(*twice(make(MOTION, RADAR), MANY, TIMES, Z, of=make(*EXACT)))


# -- a target in polar coordinates -----------------------------------------------------------------
def polar(x, _epoch):
    return np.stack([np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], -1)


AHEAD = celnav.Linear(lambda epoch: np.eye(4) + epoch.dt * np.eye(4, k=2))
STRAIGHT = celnav.Motion(AHEAD, Q=lambda _mean, epoch: epoch.dt * np.diag([0.01, 0.01, 0.25, 0.25]))
TOWER = celnav.Sensor(polar, R=np.diag([30.0, 0.005]) ** 2, space=celnav.angles([1]))
ENTRY = celnav.Gaussian([-8e3, -2e3, 0.0, 200.0], np.diag([300.0, 300.0, 20.0, 20.0]) ** 2)
SCANS = np.cumsum(np.random.default_rng(3).uniform(1.0, 4.0, 15))
PLOTS = celnav.simulate(STRAIGHT, TOWER, ENTRY, SCANS, runs=RUNS)[1]


@pytest.mark.parametrize("form", ["square root", "covariance"])
@pytest.mark.parametrize(
    "hooks", [[], [huber()], [innovation_window(4)]], ids=["plain", "Huber", "window"]
)
def test_angles_that_cross_the_cut_at_irregular_times(form, hooks):
    assert np.ptp(PLOTS[..., 1]) > 6.0
    assert_same(
        *twice(celnav.ukf(STRAIGHT, TOWER, form=form, hooks=hooks), ENTRY, SCANS, PLOTS, keep="cov")
    )


def test_angles_of_the_state():
    motion = celnav.Motion(
        lambda x, epoch: x + epoch.dt * epoch.u, 1e-3 * np.eye(1), space=celnav.angles([0])
    )
    sensor = celnav.Sensor(
        lambda x, _epoch: np.concatenate([np.cos(x), np.sin(x)], -1), 0.01 * np.eye(2)
    )
    prior, times, u = celnav.Gaussian([3.0], [[0.01]]), np.arange(20.0), np.full((19, 1), 0.1)
    z = celnav.simulate(motion, sensor, prior, times, u=u, runs=RUNS)[1]
    assert_same(*twice(celnav.ukf(motion, sensor), prior, times, z, u, keep="cov"))


# -- an attitude and a gyro's drift ----------------------------------------------------------------
GYRO = Gyro(sigma_v=1e-5, sigma_u=1e-6)
SECONDS, TURNS = np.arange(11.0), np.tile([0.0, 1e-3, 0.0], (10, 1))
UPRIGHT = celnav.Gaussian(
    [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], np.diag([0.02] * 3 + [1e-4] * 3) ** 2
)
STARS = celnav.Sensor(
    lambda x, _epoch: np.concatenate([rotate(x[..., :4], star) for star in np.eye(3)[:2]], -1),
    1e-6 * np.eye(6),
)
TRACKER = celnav.Sensor(lambda x, _epoch: x[..., :4], 1e-6 * np.eye(3), space=attitude())


def turning(transported):
    def turn(x, epoch):
        return GYRO.propagate(x, epoch.u, epoch.dt)

    space = product((attitude(transported=transported), 4, 3), (EUCLIDEAN, 3, 3))
    return celnav.Motion(turn, sqrt_Q=np.linalg.cholesky(GYRO.process_noise(1.0)), space=space)


@pytest.mark.parametrize("transported", [False, True])
@pytest.mark.parametrize("own", [False, True], ids=["shared input", "input of each run"])
def test_attitudes(transported, own):
    motion = turning(transported)
    truth, z = celnav.simulate(motion, STARS, UPRIGHT, SECONDS, u=TURNS, runs=4)
    u = (
        TURNS[:, None] + 1e-5 * np.random.default_rng(1).standard_normal((10, 4, 3))
        if own
        else TURNS
    )
    if own:
        z[3, 1] = np.nan
    assert_same(
        *twice(
            celnav.ukf(motion, STARS, hooks=[gate(2.0)] if own else []),
            UPRIGHT,
            SECONDS,
            z,
            u,
            keep="cov",
        )
    )
    if not own:
        assert_same(
            *twice(celnav.ukf(motion, TRACKER), UPRIGHT, SECONDS, truth[..., :4], u, keep="cov")
        )
