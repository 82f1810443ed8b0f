"""A number in place of a matrix means this multiple of the identity, for every filter and both
engines.
"""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest

import celnav
from celnav.receiver.least_squares import least_squares

EYE = np.eye(2)
F = np.array([[1.0, 0.5], [0.0, 0.9]])
H = np.array([[1.0, 0.0], [0.3, 1.0]])
TIMES = np.arange(10.0)


def f(x, epoch):
    return x @ F.T


def h(x, epoch):
    return np.stack([x[..., 0], x[..., 1] + 0.1 * x[..., 0] ** 2], -1)


PAIRS = {
    "functions": (
        (celnav.Motion(f, Q=0.01), celnav.Sensor(h, R=4.0)),
        (celnav.Motion(f, Q=0.01 * EYE), celnav.Sensor(h, R=4.0 * EYE)),
    ),
    "deviations": (
        (celnav.Motion(f, sqrt_Q=0.1), celnav.Sensor(h, sqrt_R=2.0)),
        (celnav.Motion(f, sqrt_Q=0.1 * EYE), celnav.Sensor(h, sqrt_R=2.0 * EYE)),
    ),
    "matrices": (
        (celnav.Motion(F, Q=np.float64(0.01)), celnav.Sensor(H, R=np.array(4))),
        (celnav.Motion(F, Q=0.01 * EYE), celnav.Sensor(H, R=4.0 * EYE)),
    ),
    "of the epoch": (
        (
            celnav.Motion(celnav.Linear(lambda e: F), Q=lambda mean, e: 0.01 * e.dt),
            celnav.Sensor(celnav.Linear(lambda e: H), sqrt_R=lambda mean, e: 2.0 + 0.1 * e.t),
        ),
        (
            celnav.Motion(celnav.Linear(lambda e: F), Q=lambda mean, e: 0.01 * e.dt * EYE),
            celnav.Sensor(
                celnav.Linear(lambda e: H), sqrt_R=lambda mean, e: (2.0 + 0.1 * e.t) * EYE
            ),
        ),
    ),
}
PRIOR = celnav.Gaussian([1.0, 2.0], EYE)
Z = celnav.simulate(*PAIRS["functions"][1], PRIOR, TIMES, runs=3)[1]
Z[4, 1] = Z[5, :, 0] = np.nan
MAKERS = {
    "ukf": celnav.ukf,
    "covariance": lambda m, s: celnav.ukf(m, s, form="covariance"),
    "ekf": celnav.ekf,
    "iterated": lambda m, s: celnav.ukf(m, s, iterations=2),
    "hooks": lambda m, s: celnav.ukf(m, s, hooks=[celnav.filters.adaptive.huber()]),
    "two stages": lambda m, s: celnav.two_stage(m, s, EYE, celnav.Gaussian([0.0, 0.0], EYE)),
    "models": lambda m, s: celnav.imm([celnav.ukf(m, s)] * 2, np.full((2, 2), 0.5)),
}


def assert_same(found, known):
    np.testing.assert_array_equal(found.mean, known.mean)
    np.testing.assert_array_equal(found.std, known.std)


FLIGHTS = [(make, pair, "numpy") for make in MAKERS for pair in PAIRS]
FLIGHTS += [("ukf", pair, "compiled") for pair in PAIRS]
FLIGHTS += [(make, "of the epoch", "compiled") for make in MAKERS if make != "ukf"]


@pytest.mark.parametrize(("make", "pair", "engine"), FLIGHTS)
def test_a_number_is_a_multiple_of_the_identity(make, pair, engine):
    found, known = (
        celnav.run(MAKERS[make](*models), PRIOR, TIMES, Z, engine=engine) for models in PAIRS[pair]
    )
    assert found.engine == known.engine == engine
    assert_same(found, known)


@pytest.mark.parametrize("pair", PAIRS)
def test_what_is_drawn_and_smoothed_is_the_same(pair):
    (truth, z), (same, alike) = (
        celnav.simulate(*models, PRIOR, TIMES, runs=3) for models in PAIRS[pair]
    )
    np.testing.assert_array_equal(truth, same)
    np.testing.assert_array_equal(z, alike)
    found, known = (
        celnav.smooth(celnav.run(celnav.ukf(*models), PRIOR, TIMES, Z, keep="cov"))
        for models in PAIRS[pair]
    )
    assert_same(found, known)


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
@pytest.mark.parametrize("make", [celnav.colored, celnav.decorrelated, celnav.augmented])
@pytest.mark.parametrize("Phi", [0.9, lambda epoch: 0.9], ids=["constant", "of the epoch"])
def test_one_coefficient_is_that_of_all_components(make, engine, Phi):
    (motion, sensor), known = PAIRS["matrices"]
    found = celnav.run(make(motion, sensor, Phi, increments=0.3), PRIOR, TIMES, Z, engine=engine)
    filter = make(*known, 0.9 * EYE, increments=0.3 * EYE)
    assert_same(found, celnav.run(filter, PRIOR, TIMES, Z, engine=engine))
    found = celnav.run(make(motion, sensor, Phi), PRIOR, TIMES, Z, engine=engine)
    assert_same(found, celnav.run(make(*known, 0.9 * EYE), PRIOR, TIMES, Z, engine=engine))


def test_the_coefficient_says_how_many_components_there_are():
    (motion, sensor), known = PAIRS["functions"]
    found = celnav.run(celnav.colored(motion, sensor, 0.9 * EYE), PRIOR, TIMES, Z)
    assert_same(found, celnav.run(celnav.colored(*known, 0.9 * EYE), PRIOR, TIMES, Z))


def test_deviations_are_counted_where_states_are_no_vectors():
    space = celnav.product((celnav.attitude(), 4, 3), (celnav.EUCLIDEAN, 3, 3))
    prior = celnav.Gaussian([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 0.01 * np.eye(6))
    seen = celnav.Sensor(lambda x, e: x[..., :4], R=1e-4, space=celnav.attitude())
    wide = celnav.Sensor(lambda x, e: x[..., :4], R=1e-4 * np.eye(3), space=celnav.attitude())
    found, known = (
        celnav.run(
            celnav.ukf(celnav.Motion(lambda x, e: x, Q, space=space), sensor),
            prior,
            TIMES[:3],
            np.tile([0.1, 0.0, 0.0, np.sqrt(0.99)], (3, 1)),
        )
        for Q, sensor in ((1e-5, seen), (1e-5 * np.eye(6), wide))
    )
    assert_same(found, known)
    alone = celnav.ukf(celnav.Motion(lambda x, e: x, 1e-5, space=celnav.attitude()))
    with pytest.raises(ValueError, match=r"^prior: expected a covariance \(3, 3\) of differences"):
        alone.start(celnav.Gaussian([0.0, 0.0, 0.0, 1.0], 0.01))


def test_a_variance_is_that_of_all_states():
    for prior in (
        celnav.Gaussian(np.zeros((3, 2)), 4.0),
        celnav.Gaussian([0.0, 0.0], sqrt_cov=2.0),
    ):
        np.testing.assert_array_equal(prior.cov, 4.0 * EYE)
        np.testing.assert_array_equal(prior.sqrt_cov, 2.0 * EYE)
    walk = celnav.two_stage(*PAIRS["matrices"][0], EYE, celnav.Gaussian([0.0, 0.0], 1.0), Qb=0.25)
    np.testing.assert_array_equal(walk.walk, 0.5 * EYE)


def test_fixes_have_one_variance_for_all_components():
    guess, z = celnav.Gaussian([0.0, 0.0], 1.0), Z[:3, 0]
    found, known = (
        celnav.run(least_squares(celnav.Sensor(h, R, jacobian=lambda x, e: H)), guess, TIMES[:3], z)
        for R in (4.0, 4.0 * EYE)
    )
    assert_same(found, known)


def test_a_filter_of_numbers_travels():
    filter = celnav.ukf(*PAIRS["functions"][0])
    found = celnav.run(pickle.loads(pickle.dumps(filter)), PRIOR, TIMES, Z)
    assert_same(found, celnav.run(filter, PRIOR, TIMES, Z))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: celnav.Sensor(h, -4.0),
            "R: expected symmetric positive semidefinite, got an eigenvalue",
        ),
        (
            lambda: celnav.Motion(f, -1.0),
            "Q: expected symmetric positive semidefinite, got an eigenvalue",
        ),
        (lambda: celnav.Motion(f, np.nan), "Q: expected finite numbers, got 1 that are not"),
        (lambda: celnav.Sensor(h, "4"), "R: expected numbers, got '4'"),
        (
            lambda: celnav.Sensor(H, [1.0, 2.0]),
            "R: expected symmetric .*; pass np.diag",
        ),
        (lambda: celnav.Gaussian([0.0], -1.0), "cov: expected symmetric positive semidefinite"),
        (
            lambda: celnav.colored(*PAIRS["functions"][0], 0.9),
            r"Phi: expected a matrix \(m, m\) where neither R nor h is one, got the number 0.9$",
        ),
        (
            lambda: celnav.augmented(*PAIRS["functions"][0], 0.9),
            r"R: expected a constant covariance \(m, m\) of the noise, got a number$",
        ),
        (
            lambda: celnav.colored(*PAIRS["matrices"][0], 1.5),
            "Phi: expected a spectral radius of at most 1, got 1.5",
        ),
        (
            lambda: celnav.export_c(celnav.ukf(*PAIRS["functions"][0]), "filter.c", PRIOR),
            "m: expected the length of each of 1 measurements, which R does not say",
        ),
    ],
)
def test_what_a_number_cannot_be(make, message):
    with pytest.raises(ValueError, match="^" + message):
        make()


def test_a_run_that_fails_is_explained():
    """A number as noise may be 0."""
    twice = celnav.Sensor(lambda x, e: np.stack([x[..., 0], x[..., 0]], -1), R=0.0)
    message = re.escape("a measurement without noise must not repeat what is determined already")
    with pytest.raises(celnav.FilterError, match=message):
        celnav.run(celnav.ukf(celnav.Motion(f, 0.01), twice), PRIOR, TIMES, Z[:, 0])
