"""A filter can be pickled unchanged if its models can."""

from __future__ import annotations

import pickle
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import celnav
from celnav.filters import adaptive
from celnav.filters.fixed_lag import FixedLag
from celnav.filters.sequential import SingleDraw
from celnav.filters.switching import Fallback
from celnav.gaussian.spaces import Space
from celnav.models import motion as motions
from celnav.models import pulsar

pytestmark = pytest.mark.usefixtures("eager")

HOOKS = {
    "gate": adaptive.gate(3.0),
    "chi_square_gate": adaptive.chi_square_gate(0.99),
    "innovation_window": adaptive.innovation_window(4, gaps="skip"),
    "huber": adaptive.huber(),
    "student_t": adaptive.student_t(),
    "correntropy": adaptive.correntropy(),
    "sage_husa": adaptive.sage_husa(),
    "variational_bayes": adaptive.variational_bayes(),
    "underweighting": adaptive.underweighting(),
    "group_parity": adaptive.group_parity([[0, 1, 2, 3]], unknowns=2),
    "channel_parity": adaptive.channel_parity(3),
}
Q4 = np.array([0.0, 0.0, 0.0, 1.0])
SPACES = {
    "vectors": (celnav.EUCLIDEAN, np.array([1.0, 2.0]), np.array([0.5, -3.0])),
    "angles": (celnav.angles([1]), np.array([1.0, 3.0]), np.array([0.5, 1.0])),
    "attitude": (celnav.attitude(), Q4, np.array([0.1, -0.2, 0.3])),
    "carried": (celnav.attitude(0.0, 2.0, transported=True), Q4, np.array([0.1, -0.2, 0.3])),
    "product": (
        celnav.product((celnav.attitude(transported=True), 4, 3), (celnav.angles(), 1, 1)),
        np.append(Q4, 3.0),
        np.array([0.1, -0.2, 0.3, 1.0]),
    ),
    "pulses": (
        pulsar.Timing(pulsar.pulsars(["B0531+21", "B1937+21"])).uncounted,
        np.array([1.0, 3.0]),
        np.array([0.5, 1.0]),
    ),
}


def f(x, epoch):
    return np.stack([x[..., 0] + epoch.dt * x[..., 1], x[..., 1]], -1)


def f_noisy(x, epoch, w):
    return f(x, epoch) + w


def h(x, _epoch):
    return np.stack([x[..., 0], x[..., 0], x[..., 1], x[..., 1] + 0.1 * np.sin(x[..., 0])], -1)


def h_noisy(x, epoch, *_noise):
    return h(x, epoch)


MOTION, SENSOR = celnav.Motion(f, 0.01 * np.eye(2)), celnav.Sensor(h, 0.1 * np.eye(4))
PRIOR, TIMES = celnav.Gaussian([0.0, 1.0], np.eye(2)), np.arange(12.0)
Z = np.random.default_rng(5).standard_normal((12, 4)) + h(
    np.stack([TIMES, 1.0 + 0.0 * TIMES], -1), 0
)
Z[7:, 2] = 30.0
PHI, BIAS = 0.5 * np.eye(4), celnav.Gaussian([0.0], [[1.0]])
GAMMA = np.ones((4, 1))
MATRIX = celnav.Sensor(np.repeat(np.eye(2), 2, 0), 0.1 * np.eye(4))


def turning(make, *densities):
    """A filter with one of the package's motions and a sensor of the full state."""
    motion, n = make(*densities), 5 if make is motions.coordinated_turn else 4
    return celnav.ekf(motion, celnav.Sensor(np.eye(4, n), np.eye(4)))


FILTERS = {
    "ukf": celnav.ukf(MOTION, SENSOR, alpha=0.1),
    "ekf": celnav.ekf(MOTION, SENSOR, iterations=3),
    "ckf": celnav.ckf(MOTION, SENSOR, degree=5, form="covariance"),
    "ghkf": celnav.ghkf(MOTION, SENSOR),
    "sparse": celnav.sparse_grid_filter(MOTION, SENSOR),
    "consider": celnav.ukf(MOTION, SENSOR, gain=adaptive.consider(1, 1)),
    "colored": celnav.colored(MOTION, SENSOR, PHI),
    "decorrelated": celnav.decorrelated(MOTION, MATRIX, PHI),
    "augmented": celnav.augmented(MOTION, SENSOR, PHI),
    "augmented matrix": celnav.augmented(MOTION, MATRIX, PHI),
    "two_stage": celnav.two_stage(MOTION, SENSOR, GAMMA, BIAS),
    "imm": celnav.imm([celnav.ukf(MOTION, SENSOR)] * 2, [[0.9, 0.1], [0.1, 0.9]]),
    "fallback": Fallback(celnav.ukf(MOTION, SENSOR), celnav.ekf(MOTION, SENSOR)),
    "lag": FixedLag(celnav.ukf(MOTION, SENSOR), 3),
    "single": SingleDraw.of(
        celnav.ukf(
            celnav.Motion(f_noisy, augment=[0.1 * np.eye(2)]),
            celnav.Sensor(h_noisy, 0.1 * np.eye(4)),
        )
    ),
    "compiled": celnav.compiled(celnav.ukf(MOTION, SENSOR)),
    "velocity": turning(motions.constant_velocity, 2, 0.1),
    "turn": turning(motions.known_turn, 0.1, 0.1),
    "turns": turning(motions.coordinated_turn, 0.1, 1e-3),
}


def again(thing):
    return pickle.loads(pickle.dumps(thing))


def start(filter):
    """A prior with the filter's number of states."""
    name = next(name for name, other in FILTERS.items() if other is filter)
    n = {"velocity": 4, "turn": 4, "turns": 5}.get(name, 2)
    return celnav.Gaussian(np.linspace(0.0, 1.0, n), np.eye(n))


def test_every_hook_is_tried():
    gains, other = {"consider"}, {"range_basis"}
    assert set(HOOKS) | gains | other == set(adaptive.__all__)


@pytest.mark.parametrize("engine", ["numpy", "auto"])
@pytest.mark.parametrize("name", HOOKS)
def test_a_hook_that_travelled_does_the_same(name, engine):
    filter = celnav.ukf(MOTION, SENSOR, hooks=[HOOKS[name]])
    known, found = (
        celnav.run(one, PRIOR, TIMES, Z, engine=engine) for one in (filter, again(filter))
    )
    np.testing.assert_array_equal(found.mean, known.mean)
    np.testing.assert_array_equal(found.std, known.std)
    plain = celnav.run(celnav.ukf(MOTION, SENSOR), PRIOR, TIMES, Z, engine=engine)
    assert not np.array_equal(known.mean, plain.mean), "a hook that does nothing shows nothing"


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_that_travelled_does_the_same(name):
    filter = FILTERS[name]
    known = celnav.run(filter, start(filter), TIMES, Z)
    found = celnav.run(again(filter), start(filter), TIMES, Z)
    np.testing.assert_array_equal(found.mean, known.mean)
    np.testing.assert_array_equal(found.std, known.std)


def test_machine_code_stays_where_it_is():
    """Its addresses are not valid in another process."""
    made = celnav.ukf(celnav.Motion(np.eye(2), np.eye(2)), celnav.Sensor(np.eye(2), np.eye(2)))
    fast, z = celnav.compiled(made), Z[:, :2]
    known = fast.run(PRIOR, TIMES, z)
    program = (
        "import pickle, sys; fast, *rest = pickle.load(sys.stdin.buffer); "
        "sys.stdout.buffer.write(fast.run(*rest).mean.tobytes())"
    )
    sent = subprocess.run(
        [sys.executable, "-c", program],
        input=pickle.dumps((fast, PRIOR, TIMES, z)),
        capture_output=True,
        check=True,
    )
    assert sent.stdout == known.mean.tobytes()


@pytest.mark.parametrize("name", SPACES)
def test_a_space_that_travelled_is_the_same(name):
    space, point, tangent = SPACES[name]
    found = again(space)
    assert isinstance(found, Space)
    assert (found is celnav.EUCLIDEAN) is (space is celnav.EUCLIDEAN)
    there = space.plus(point, tangent)
    np.testing.assert_array_equal(found.plus(point, tangent), there)
    np.testing.assert_array_equal(found.minus(there, point), space.minus(there, point))
    if space.transport is not None:
        np.testing.assert_array_equal(found.transport(tangent), space.transport(tangent))
    if space.check is not None:
        np.testing.assert_array_equal(found.check(there, "q"), there)


def held(x, _epoch):
    return x


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
@pytest.mark.parametrize("name", [name for name in SPACES if name != "pulses"])
def test_a_filter_on_a_space_travels(name, engine):
    space, point, tangent = SPACES[name]
    n = len(tangent)
    filter = celnav.ukf(
        celnav.Motion(held, np.eye(n), space=space), celnav.Sensor(held, np.eye(n), space=space)
    )
    prior, z = celnav.Gaussian(point, np.eye(n)), np.stack([point, space.plus(point, tangent)])
    known, found = (
        celnav.run(one, prior, [0.0, 1.0], z, engine=engine) for one in (filter, again(filter))
    )
    np.testing.assert_array_equal(found.mean, known.mean)


def test_hooks_show_what_they_are():
    assert isinstance(HOOKS["gate"], partial)
    assert "gate" in repr(HOOKS["gate"])
    assert "3.0" in repr(HOOKS["gate"])
