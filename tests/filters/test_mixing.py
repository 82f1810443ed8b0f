"""A model that mixes runs raises an error; a model that only contains data of all runs does not."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import celnav
from celnav.filters.sequential import SingleDraw
from celnav.gaussian.linalg import SquareRoot
from celnav.receiver.least_squares import least_squares

pytestmark = pytest.mark.usefixtures("eager")

EYE = np.eye(2)
RULES = {"points": celnav.unscented(2), "differences": celnav.Taylor(), "Jacobian": celnav.Taylor()}
F = np.array([[1.0, 1.0], [0.0, 1.0]])
MIXED = {
    "product": lambda x, e: F @ x,
    "lower": lambda x, e: F.T @ x,
    "diagonal": lambda x, e: np.diag([1.0, 0.5]) @ x,
    "einsum": lambda x, e: np.einsum("ij,pjk->pik", F, x),
    "solve": lambda x, e: np.linalg.solve(F, x),
    "part": lambda x, e: np.concatenate([(F @ x[..., :1]), x[..., 1:]], -1),
    "in place": lambda x, e: (
        np.multiply(x, 0.0, out=x) + F @ (x + 1.0) if e is None else _overwritten(x)
    ),
}
PRIORS = {
    "different": celnav.Gaussian([[0.0, 1.0], [5.0, -2.0]], EYE),
    "alike": celnav.Gaussian(np.ones((2, 2)), EYE),
    "certain": celnav.Gaussian([[0.0, 1.0], [5.0, -2.0]], 0.0 * EYE),
}
FORM = {"certain": "covariance"}
EPOCHS = celnav.epochs(np.arange(3.0), np.zeros((3, 2)))


def _overwritten(x):
    y = F @ x
    x[...] = 0.0
    return y


def still(x, epoch):
    return x


def filter_of(f, h=None, rule="points", form="square root"):
    """With a rule, or with user-supplied Jacobians, which do not depend on the model's values."""
    known = {"jacobian": lambda mean, epoch: EYE} if rule == "Jacobian" else {}
    sensors = () if h is None else (celnav.Sensor(h, EYE, **known if callable(h) else {}),)
    return celnav.sigma_point(celnav.Motion(f, EYE, **known), *sensors, rule=RULES[rule], form=form)


@pytest.mark.parametrize("prior", PRIORS)
@pytest.mark.parametrize("name", MIXED)
@pytest.mark.parametrize("rule", RULES)
def test_a_model_that_mixes_runs_is_told(rule, name, prior):
    if (rule, name, prior) == ("Jacobian", "einsum", "alike"):
        pytest.skip("one point, the same for all runs: nothing to exchange")
    for f, h, told in ((MIXED[name], EYE, "f"), (still, MIXED[name], "h")):
        filter = filter_of(f, h, rule, FORM.get(prior, "square root"))
        with pytest.raises(
            ValueError, match=f"{told}: expected values of each run by itself.*x @ F.T"
        ):
            celnav.run(filter, PRIORS[prior], EPOCHS)


def test_other_filters_tell_it_too():
    f, Phi = MIXED["product"], 0.5 * EYE
    mixing, motion, sensor = (
        celnav.Motion(f, EYE),
        celnav.Motion(still, EYE),
        celnav.Sensor(EYE, EYE),
    )
    noisy = celnav.Motion(lambda x, e, w: f(x, e), augment=(EYE,))
    filters = [
        celnav.colored(mixing, sensor, Phi),
        celnav.colored(motion, celnav.Sensor(f, EYE), Phi),
        celnav.decorrelated(mixing, sensor, Phi),
        celnav.augmented(mixing, sensor, Phi),
        celnav.augmented(motion, celnav.Sensor(f, EYE), Phi),
        celnav.ekf(motion, celnav.Sensor(f, EYE), iterations=6),
        celnav.two_stage(mixing, sensor, EYE, celnav.Gaussian(np.zeros(2), EYE)),
        SingleDraw.of(celnav.ukf(noisy, celnav.Sensor(lambda x, e, *w: x, EYE))),
        SingleDraw.of(celnav.ukf(noisy, celnav.Sensor(EYE, EYE))),
    ]
    for filter in filters:
        with pytest.raises(ValueError, match="expected values of each run by itself"):
            celnav.run(filter, PRIORS["different"], EPOCHS)


def test_fixes_of_each_run_tell_it_too():
    """There the arrays have no axis of points."""
    one = lambda x, e: np.broadcast_to(F, (*x.shape, 2))  # noqa: E731
    when = celnav.epochs([0.0, 1.0], np.ones((2, 2, 2)))
    with pytest.raises(ValueError, match="h: expected values of each run by itself"):
        celnav.run(
            least_squares(celnav.Sensor(lambda x, e: F @ x, EYE, jacobian=one)),
            PRIORS["different"],
            when,
        )
    for right, offset in (
        (lambda x, e: x @ F.T, 0.0 * OFFSET),
        (lambda x, e: (x @ F.T) + OFFSET, OFFSET),
    ):
        fixes = celnav.run(
            least_squares(celnav.Sensor(right, EYE, jacobian=one)), PRIORS["different"], when
        )
        expected = np.linalg.solve(F, (1.0 - offset)[..., None])[..., 0]
        np.testing.assert_allclose(fixes.mean, np.stack([expected, expected]), atol=1e-12)


def test_runs_that_only_the_measurements_have_are_mixed_later():
    with pytest.raises(ValueError, match="f: expected values of each run by itself"):
        celnav.run(
            filter_of(MIXED["product"], EYE),
            celnav.Gaussian(np.zeros(2), EYE),
            np.arange(2.0),
            np.zeros((2, 2, 2)),
        )


def test_an_average_over_runs_is_told():
    model = lambda x, e: x - x.mean(-2, keepdims=True)  # noqa: E731
    with pytest.raises(ValueError, match="f: expected values of each run by itself"):
        celnav.run(filter_of(model), PRIORS["different"], EPOCHS)


OFFSET, RATE, OWN = (
    np.array([[1.0, 2.0], [-3.0, 0.5]]),
    np.array([0.3, 2.0]),
    np.array([F, [[0.5, 0.0], [2.0, 1.0]]]),
)
RNG = np.random.default_rng(0)


def test_mixing_is_noticed_where_a_model_is_defined_for_some_states_only():
    """Here first components are positive and second ones negative: runs are replaced by runs of
    this kind.
    """
    prior = celnav.Gaussian([[4.0, -9.0], [25.0, -1.0]], 1e-4 * EYE)

    def roots(x):
        return np.sqrt(x * [1.0, -1.0]) * [1.0, -1.0]

    apart = filter_of(lambda x, e: 3.0 * roots(x) + 0.01 * OFFSET)
    mixed = filter_of(lambda x, e: 3.0 * roots(x)[..., ::-1, :] + 0.01 * OFFSET)
    found = celnav.run(apart, prior, EPOCHS[:2]).mean[1]
    np.testing.assert_allclose(found, 3.0 * roots(prior.mean) + 0.01 * OFFSET, atol=1e-3)
    with pytest.raises(ValueError, match="f: expected values of each run by itself"):
        celnav.run(mixed, prior, EPOCHS[:2])


@dataclass
class Drag:
    rate: np.ndarray

    def __call__(self, x, epoch):
        return x * np.exp(-self.rate * epoch.dt)[:, None]


def _all_together(x, epoch):
    """A common step size for all points and runs: the result of a run depends on the others, below
    the solver's tolerance.
    """
    flow = solve_ivp(lambda t, v: -v + np.sin(v), (0.0, 1.0), x.ravel(), rtol=1e-4, atol=1e-6)
    return flow.y[:, -1].reshape(x.shape)


APART = {
    "transposed": lambda x, e: x @ F.T,
    "matvec": lambda x, e: (F @ x[..., None])[..., 0],
    "swapped": lambda x, e: np.swapaxes(F @ np.swapaxes(x, -1, -2), -1, -2),
    "offsets of each run": lambda x, e: x + OFFSET,
    "rates of each run": lambda x, e: x + RATE[:, None] * x[..., ::-1],
    "components": lambda x, e: np.stack([x[..., 0] + RATE * x[..., 1], x[..., 1]], -1),
    "matrices of each run": lambda x, e: (OWN @ x[..., None])[..., 0],
    "contracted": lambda x, e: np.einsum("rij,prj->pri", OWN, x),
    "a partial": partial(lambda rate, x, e: x * rate[:, None], RATE),
    "an object": Drag(RATE),
    "inputs of each run": lambda x, e: x + (0.0 if e.u is None else e.u),
    "random": lambda x, e: x + RNG.normal(size=x.shape),
    "a solver for all": _all_together,
    "it looks at the shape": lambda x, e: x if x.shape[-2:] == (2, 2) else 1 / 0,
    "one for each run": lambda x, e: np.stack([x[:, i] * (i + 1.0) for i in range(2)], 1),
}


def _flow(x, epoch):
    """The same to ten digits, each point separately."""
    flows = [
        solve_ivp(lambda t, v: -v + np.sin(v), (0.0, 1.0), p, rtol=1e-10, atol=1e-12).y[:, -1]
        for p in x.reshape(-1, 2)
    ]
    return np.reshape(flows, x.shape)


def linear(matrix):
    return lambda x, e: x @ np.asarray(matrix).T


ALONE = {
    "transposed": lambda i: linear(F),
    "matvec": lambda i: linear(F),
    "swapped": lambda i: linear(F),
    "offsets of each run": lambda i: lambda x, e: x + OFFSET[i],
    "rates of each run": lambda i: linear([[1.0, RATE[i]], [RATE[i], 1.0]]),
    "components": lambda i: linear([[1.0, RATE[i]], [0.0, 1.0]]),
    "matrices of each run": lambda i: linear(OWN[i]),
    "contracted": lambda i: linear(OWN[i]),
    "a partial": lambda i: linear(RATE[i] * EYE),
    "an object": lambda i: lambda x, e: x * np.exp(-RATE[i] * e.dt),
    "inputs of each run": lambda i: lambda x, e: x + (0.0 if e.u is None else e.u),
    "a solver for all": lambda i: _flow,
    "it looks at the shape": lambda i: still,
    "one for each run": lambda i: linear((i + 1.0) * EYE),
}
"""The same models of run i alone."""


def assert_each_alone(track, made, prior, **tolerance):
    """Each run equals a single run; ``made(i)``: filter and epochs of run i."""
    for i in range(2):
        filter, when = made(i)
        alone = celnav.run(filter, celnav.Gaussian(prior.mean[i], prior.cov), when, keep="cov")
        np.testing.assert_allclose(track.mean[:, i], alone.mean, **tolerance)
        cov = np.broadcast_to(track.cov, (*track.mean.shape, 2))[:, i]
        np.testing.assert_allclose(cov, alone.cov, **tolerance)


@pytest.mark.parametrize("prior", PRIORS)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", APART)
def test_data_of_each_run_are_not_taken_for_it(name, rule, prior):
    times, z, form = np.arange(3.0), np.ones((3, 2, 2)), FORM.get(prior, "square root")
    u = np.ones((2, 2, 2)) * OFFSET
    filter = filter_of(APART[name], APART[name], rule, form)
    track = celnav.run(
        filter, PRIORS[prior], celnav.epochs(times, z, u=u), on_failure="flag", keep="cov"
    )
    if name == "random" or (name, rule) == ("a solver for all", "differences"):
        assert track.mean.shape == (3, 2, 2)  # differences of solver errors are inaccurate
        return

    def made(i):
        model = ALONE[name](i)
        return filter_of(model, model, rule, form), celnav.epochs(times, z[:, i], u=u[:, i])

    loose = name == "a solver for all"  # by its tolerance of 1e-4, at each of three epochs
    assert_each_alone(track, made, PRIORS[prior], rtol=1e-11, atol=3e-3 if loose else 1e-11)


def test_intervals_of_each_run():
    dt = np.array([0.5, 2.0])

    def when(dt):
        return [celnav.Epoch(k, float(k), dt * (k > 0), z=np.ones(2)) for k in range(3)]

    f = lambda x, e: np.stack([x[..., 0] + e.dt * x[..., 1], x[..., 1]], -1)  # noqa: E731
    track = celnav.run(filter_of(f, EYE), PRIORS["different"], when(dt), keep="cov")

    def made(i):
        return filter_of(linear([[1.0, dt[i]], [0.0, 1.0]]), EYE), when(1.0)

    assert_each_alone(track, made, PRIORS["different"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("lost", [0, 1])
def test_a_lost_run_hides_nothing_and_blames_nobody(lost):
    mean = PRIORS["different"].mean.copy()
    mean[lost] = np.nan
    prior = SquareRoot(mean, EYE)
    with pytest.raises(ValueError, match="f: expected values of each run by itself"):
        celnav.run(filter_of(MIXED["product"], EYE), prior, EPOCHS, on_failure="flag")
    for name in ("transposed", "offsets of each run"):
        track = celnav.run(filter_of(APART[name], EYE), prior, EPOCHS, on_failure="flag")
        alone = celnav.run(
            filter_of(ALONE[name](1 - lost), EYE), celnav.Gaussian(mean[1 - lost], EYE), EPOCHS
        )
        np.testing.assert_allclose(track.mean[:, 1 - lost], alone.mean, rtol=0, atol=1e-13)
        assert np.isnan(track.mean[:, lost]).all()


@pytest.mark.parametrize("runs", [2, 5])
def test_a_model_with_a_buffer_is_not_disturbed(runs):
    """The model is called once more before its values are used."""
    buffers = np.empty((5, runs, 2)), np.empty((5, 1, 2))
    offset = np.arange(2.0 * runs).reshape(runs, 2)
    both = {
        "own": lambda x, e: np.add(x, offset, out=buffers[0]),
        "any": lambda x, e: np.add(x, 1.0, out=buffers[x.shape[1] == 1]),
    }
    for name, clean in (("own", lambda x, e: x + offset), ("any", lambda x, e: x + 1.0)):
        found, expected = (
            celnav.run(filter_of(f), celnav.Gaussian(offset**2, EYE), celnav.epochs([0.0, 1.0]))
            for f in (both[name], clean)
        )
        np.testing.assert_array_equal(found.mean, expected.mean)


def test_a_model_is_looked_at_once():
    calls = []

    def f(x, epoch):
        calls.append(x.shape)
        return x.copy()

    celnav.run(
        filter_of(f, EYE), celnav.Gaussian(np.zeros((50, 2)), EYE), np.arange(5.0), np.zeros((5, 2))
    )
    whole, few = (5, 50, 2), [(3, 1, 2), (1, 1, 2)]
    assert calls == [whole, whole, *few, whole, whole, whole]


# -- points that are taken for components ------------------------------------------------------
def in_place(x, epoch):
    x[0] += epoch.dt * x[1]
    return x


def written(x, epoch):
    y = np.zeros_like(x)
    y[0], y[1] = x[0] + epoch.dt * x[1], x[1]
    return y


def normalized(x, epoch):
    return x / np.linalg.norm(x)


def centered(x, epoch):
    return x - x.mean(0)


def pushed(x, epoch):
    x[0] += 1e-3
    return x


POINTS_MIXED = (in_place, written, normalized, centered, pushed)
TIMES = 0.01 * np.arange(8.0)


def flown(filter, runs, engine, **options):
    """A short run with two states, without an axis of runs, with one run or with several."""
    mean = np.array([1.0, 2.0]) + np.arange(2.0 * np.prod(runs, dtype=int)).reshape(*runs, 2)
    prior = celnav.Gaussian(mean, EYE)
    z = np.zeros((8, *runs, 1))
    z[0] = np.nan
    return celnav.run(filter, prior, TIMES, z, engine=engine, **options)


@pytest.mark.parametrize("engine", ["numpy", "compiled", "auto"])
@pytest.mark.parametrize("runs", [(), (1,), (2,), (7,), (2, 3)])
@pytest.mark.parametrize("model", POINTS_MIXED)
def test_a_model_that_mixes_points_is_refused_at_the_door(model, runs, engine):
    told = r"expected values of each point by itself.*a component is x\[\.\.\., 0\]"
    right = celnav.Motion(lambda x, e: x.copy(), EYE), celnav.Sensor(EYE[:1], EYE[:1, :1])
    refused = "recorded" if engine == "compiled" and model is normalized else told
    with pytest.raises(ValueError, match=f"f: {told}|{refused}"):
        flown(celnav.ukf(celnav.Motion(model, EYE), right[1]), runs, engine)
    seen = celnav.Sensor(lambda x, e: model(x, e)[..., :1], EYE[:1, :1])
    with pytest.raises(ValueError, match=f"h: {told}|{refused}"):
        flown(celnav.ukf(right[0], seen), runs, engine)


@pytest.mark.parametrize("name", ["UKF", "EKF", "cubature", "noise through the points"])
def test_every_rule_tells_it(name):
    sensor = celnav.Sensor(EYE[:1], EYE[:1, :1])
    made = {
        "UKF": celnav.ukf(celnav.Motion(in_place, EYE), sensor),
        "EKF": celnav.ekf(celnav.Motion(in_place, EYE), sensor),
        "cubature": celnav.ckf(celnav.Motion(in_place, EYE), sensor, degree=5),
        "noise through the points": celnav.ukf(
            celnav.Motion(lambda x, e, w: in_place(x, e) + w, augment=(EYE,)), sensor
        ),
    }
    with pytest.raises(ValueError, match="f: expected values of each point by itself"):
        flown(made[name], (3,), "numpy")


def test_steps_by_hand_tell_it_too():
    filter = celnav.ukf(celnav.Motion(lambda x, e: in_place(x, e), EYE), celnav.Sensor(EYE, EYE))
    state = filter.start(celnav.Gaussian([1.0, 2.0], EYE))
    with pytest.raises(ValueError, match="f: expected values of each point by itself"):
        filter.step(state, celnav.Epoch(1, 1.0, 1.0, z=np.zeros(2)))


def test_runs_that_are_taken_for_components_are_told_however_many_there_are():
    def f(x, epoch):  # right without an axis of runs
        x[:, 0] += epoch.dt * x[:, 1]
        return x

    sensor = celnav.Sensor(EYE[:1], EYE[:1, :1])
    assert np.isfinite(flown(celnav.ukf(celnav.Motion(f, EYE), sensor), (), "numpy").mean).all()
    for runs in (2, 5, 300):
        with pytest.raises(ValueError, match="f: expected values of each run by itself"):
            flown(celnav.ukf(celnav.Motion(f, EYE), sensor), (runs,), "numpy")


def first_run(mean, epoch):
    J = np.eye(2)
    J[0] = mean[0]
    return J


def test_matrices_of_the_mean_that_mix_runs_are_told():
    x = lambda x, e: x.copy()  # noqa: E731
    sensor = celnav.Sensor(EYE[:1], EYE[:1, :1])
    square = lambda mean, epoch: first_run(mean, epoch) @ first_run(mean, epoch).T  # noqa: E731
    filters = {
        "jacobian": celnav.ekf(celnav.Motion(x, EYE, jacobian=first_run), sensor),
        "sqrt_Q": celnav.ukf(celnav.Motion(x, sqrt_Q=first_run), sensor),
        "Q": celnav.ukf(celnav.Motion(x, square), sensor),
        "R": celnav.ukf(celnav.Motion(x, EYE), celnav.Sensor(EYE, square)),
    }
    prior = celnav.Gaussian(np.arange(8.0).reshape(4, 2), EYE)
    for name, filter in filters.items():
        z = np.zeros((8, 4, 2 if name == "R" else 1))
        told = rf"{name}: expected values of each run by itself.*is mean\[\.\.\., 0\]"
        with pytest.raises(ValueError, match=told):
            celnav.run(filter, prior, TIMES, z)
    right = celnav.Motion(x, lambda mean, epoch: mean[..., :1, None] ** 2 * EYE)
    assert np.isfinite(flown(celnav.ukf(right, sensor), (4,), "numpy").mean).all()


def test_a_matrix_of_the_mean_may_change_its_argument():
    def Q(mean, epoch):
        mean *= 0.0
        return EYE

    filters = [
        celnav.ukf(celnav.Motion(lambda x, e: x.copy(), noise), celnav.Sensor(EYE[:1], EYE[:1, :1]))
        for noise in (Q, EYE)
    ]
    found, expected = (flown(filter, (3,), "numpy") for filter in filters)
    np.testing.assert_array_equal(found.mean, expected.mean)


@pytest.mark.parametrize("runs", [2, 3, 6])
def test_inputs_of_another_run_are_told(runs):
    sensor = celnav.Sensor(EYE[:1], EYE[:1, :1])
    u = np.random.default_rng(3).standard_normal((7, runs, 1))
    mistaken = celnav.Motion(lambda x, e: x + e.u[0], EYE)
    with pytest.raises(ValueError, match=r"f: .*its own input.*a component is u\[\.\.\., 0\]"):
        flown(celnav.ukf(mistaken, sensor), (runs,), "numpy", u=u)
    pure = {
        "own": (lambda x, e: x + e.u[..., :1], u),
        "one for all": (lambda x, e: x + e.u[0], u[:, 0]),
        "beacons, as many as runs": (lambda x, e: x + np.sum(e.u, 0)[0], u * np.ones(2)),
        "a tuple": (lambda x, e: x + e.u[0] + e.u[1], (u, u[:, 0])),
        "not used": (lambda x, e: x.copy(), u),
    }
    for f, given in pure.values():
        track = flown(celnav.ukf(celnav.Motion(f, EYE), sensor), (runs,), "numpy", u=given)
        assert np.isfinite(track.mean).all()


def fields(x, epoch):
    """A quaternion's product with a constant one, by components."""
    w, x, y, z = np.moveaxis(x, -1, 0)
    return np.stack([-x, w, z, -y], -1) * 0.99


PURE = {
    "as many points as runs and components": lambda x, e: x @ F.T,
    "cross product": lambda x, e: (
        x + np.cross(np.append(x, x[..., :1], -1), [0.0, 0.0, 1.0])[..., :2]
    ),
    "length of each point": lambda x, e: x / np.linalg.norm(x, axis=-1, keepdims=True),
    "mean of components": lambda x, e: x - 0.1 * x.mean(-1, keepdims=True),
    "components in turn": lambda x, e: np.moveaxis([x[..., 1], 0.5 * x[..., 0]], 0, -1),
    "single precision": lambda x, e: (x.astype(np.float32) @ F.T.astype(np.float32)).astype(float),
    "its argument": lambda x, e: x,
    "in place": lambda x, e: np.multiply(x, 0.9, out=x),
    "a solver for all": _all_together,
    "random": lambda x, e: x + RNG.normal(size=x.shape),
    "nan for some": lambda x, e: np.where(x > 1e9, np.nan, x),
}


@pytest.mark.filterwarnings("ignore:f returns float32")
@pytest.mark.parametrize("runs", [(), (1,), (2,), (5,)])
@pytest.mark.parametrize("name", PURE)
def test_a_pure_model_is_not_refused(name, runs):
    for rule in RULES.values():
        sensor = celnav.Sensor(EYE[:1], EYE[:1, :1])
        filter = celnav.sigma_point(celnav.Motion(PURE[name], EYE), sensor, rule=rule)
        assert flown(filter, runs, "numpy", on_failure="flag").mean.shape == (8, *runs, 2)


def test_four_components_of_a_quaternion_may_trade_places():
    filter = celnav.ukf(celnav.Motion(fields, np.eye(4)), celnav.Sensor(np.eye(4), np.eye(4)))
    prior = celnav.Gaussian(np.ones((9, 4)), np.eye(4))  # as many points as runs
    assert np.isfinite(celnav.run(filter, prior, TIMES, np.zeros((8, 9, 4))).mean).all()
