"""The gradient of the likelihood: the chain rule through a filter's step, compared with recursions
by hand and with differences.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from taped import values

import celnav
from celnav import Gaussian, Motion, Sensor, epochs
from celnav.analysis.tuning import likelihood_gradient, maximize_likelihood
from celnav.engine.gradient import Gradient, same_program
from celnav.filters import adaptive
from celnav.tape import llvm
from celnav.tape.derivative import with_slopes
from celnav.tape.kernel import Kernel
from celnav.tape.numbers import TracedArray
from celnav.tape.tape import CannotCompile, Tape

pytest.importorskip("llvmlite")
RNG = np.random.default_rng(1)
F = np.array([[1.0, 0.5], [-0.1, 0.9]])
TIMES = np.arange(40.0)
Z = RNG.standard_normal((40, 3, 1)).cumsum(0) * 0.3
GAPS = np.where(RNG.random(Z.shape) < 0.2, np.nan, Z)
BEARINGS = np.array([6.4, 0.9]) + np.array([0.4, 0.1]) * RNG.standard_normal((40, 3, 2))


def noises(p):
    return p[0] ** 2 * np.array([[0.3, 0.1], [0.1, 0.5]]), [[p[1] ** 2]]


def prior(p=(0.0, 0.0, 1.0)):
    return Gaussian(
        np.stack([[0.1, -0.2], [0.0, 0.0], [0.3, 0.1]]), p[2] * np.array([[1.0, 0.2], [0.2, 0.5]])
    )


def f(x, epoch):
    return np.stack([x[..., 0] + 0.5 * np.sin(x[..., 1]), 0.9 * x[..., 1]], -1)


def h(x, epoch):
    return np.stack(
        [np.hypot(4.0 + x[..., 0], 5.0 + x[..., 1]), np.arctan2(5.0 + x[..., 1], 4.0 + x[..., 0])],
        -1,
    )


def linear(p, **options):
    Q, R = noises(p)
    return celnav.ukf(Motion(F, Q), Sensor(np.eye(1, 2), R), **options), prior(p)


def nonlinear(p, make=celnav.ukf, **options):
    Q, _ = noises(p)
    space = celnav.angles([1])
    return make(
        Motion(f, 0.1 * Q), Sensor(h, p[1] ** 2 * np.diag([1.0, 0.1]), space=space), **options
    ), prior(p)


def colored(p, motion=F):
    Q, R = noises(p)
    return celnav.colored(Motion(motion, Q), Sensor(np.eye(1, 2), R), [[0.5 * p[2]]]), prior()


def transition(p):
    """The parameter is in the motion's matrix, or in a noise that drives only one component."""
    motion = Motion(
        np.array([[1.0, 0.5], [-0.1, 0.8 * p[2]]]), sqrt_Q=p[0] * np.array([[0.0], [1.0]])
    )
    return celnav.ukf(motion, Sensor(np.eye(1, 2), sqrt_R=[[p[1]]])), Gaussian(
        np.zeros(2), np.zeros((2, 2))
    )


def biased(p):
    Q, R = noises(p)
    bias = Gaussian([0.1], [[p[2]]])
    return celnav.two_stage(Motion(F, Q), Sensor(np.eye(1, 2), R), [[1.0]], bias), prior()


def own(p):
    Q, _ = noises(p)
    R = p[1] ** 2 * np.array([0.5, 1.0, 2.0])[:, None, None]
    return celnav.ukf(Motion(F, Q), Sensor(np.eye(1, 2), R)), prior(p)


def augmented(p):
    Q, R = noises(p)
    return celnav.augmented(Motion(F, Q), Sensor(np.eye(1, 2), R), [[0.5 * p[2]]]), Gaussian(
        np.zeros(2), np.eye(2)
    )


def velocity(p):
    """A motion of the package, whose matrices depend on the epoch."""
    motion = celnav.models.motion.constant_velocity(1, p[0])
    return celnav.ukf(motion, Sensor(np.eye(1, 2), p[1])), Gaussian(np.zeros(2), p[2])


CASES = {
    "augmented": (augmented, Z),
    "velocity": (velocity, Z),
    "linear": (linear, Z),
    "linear, covariance": (lambda p: linear(p, form="covariance"), Z),
    "missing": (linear, GAPS),
    "one run": (lambda p: (linear(p)[0], Gaussian(np.zeros(2), p[2] * np.eye(2))), Z[:, 0]),
    "unscented": (nonlinear, BEARINGS),
    "unscented, covariance": (lambda p: nonlinear(p, form="covariance"), BEARINGS),
    "negative weights": (lambda p: nonlinear(p, alpha=0.5, kappa=0.5), BEARINGS),
    "extended": (lambda p: nonlinear(p, celnav.ekf), BEARINGS),
    "iterated": (lambda p: nonlinear(p, celnav.ekf, iterations=3), BEARINGS),
    "robust": (lambda p: nonlinear(p, hooks=[adaptive.huber()]), BEARINGS),
    "adaptive": (lambda p: linear(p, hooks=[adaptive.innovation_window(5)]), Z),
    "colored": (colored, Z),
    "colored, missing": (colored, GAPS),
    "colored, function": (lambda p: colored(p, f), Z),
    "decorrelated": (
        lambda p: (
            celnav.decorrelated(colored(p)[0].motion, colored(p)[0].sensors[0], [[0.5 * p[2]]]),
            prior(),
        ),
        Z,
    ),
    "transition, singular": (transition, Z[:, 0]),
    "two stages": (biased, Z),
    "noise of each run": (own, Z),
}
POINT = np.array([0.7, 0.4, 0.9])


@pytest.mark.parametrize("case", CASES)
def test_gradient_against_differences_of_flights(case):
    """The chain rule through the compiled step, compared with fourth-order differences of the numpy
    engine's likelihood.
    """
    build, z = CASES[case]
    when = epochs(TIMES, z)
    found = likelihood_gradient(build, POINT, when, engine="compiled")
    known = likelihood_gradient(build, POINT, when, engine="numpy")
    assert (found.engine, known.engine) == ("compiled", "numpy")
    assert found.value.shape == z.shape[1:-1]
    assert found.gradient.shape == (*z.shape[1:-1], 3)
    exact = case not in ("extended", "iterated")  # numpy takes differences for their Jacobians
    near = (
        1e-2 if case == "robust" else 1e-6 if exact else 1e-4
    )  # differences across kinks are inaccurate
    np.testing.assert_allclose(found.value, known.value, rtol=1e-9 if exact else 1e-6)
    np.testing.assert_allclose(
        found.gradient, known.gradient, rtol=0, atol=near * np.abs(known.gradient).max()
    )


def test_gradient_of_a_scalar_filter_by_hand():
    """The Kalman filter's recursion, differentiated line by line [Gupta & Mehra 1974]."""
    phi, q, r, P0 = parameters = np.array([0.9, 0.3, 0.5, 1.2])
    z = RNG.standard_normal(60)

    def build(p):
        return celnav.ukf(Motion([[p[0]]], [[p[1]]]), Sensor([[1.0]], [[p[2]]])), Gaussian(
            [0.2], [[p[3]]]
        )

    d_phi, d_q, d_r, d_P0 = np.eye(4)
    x, P, dx, dP, value, gradient = 0.2, P0, np.zeros(4), d_P0, 0.0, np.zeros(4)
    for k, measured in enumerate(z):
        if k:
            dx, dP = phi * dx + d_phi * x, phi**2 * dP + 2.0 * phi * P * d_phi + d_q
            x, P = phi * x, phi**2 * P + q
        e, S = measured - x, P + r
        de, dS = -dx, dP + d_r
        value += -0.5 * (np.log(2.0 * np.pi * S) + e**2 / S)
        gradient += -0.5 * (dS / S + 2.0 * e * de / S - e**2 * dS / S**2)
        K, dK = P / S, dP / S - P * dS / S**2
        x, dx = x + K * e, dx + dK * e + K * de
        P, dP = P - K * P, dP - dK * P - K * dP
    found = likelihood_gradient(
        build, parameters, epochs(np.arange(60.0), z[:, None]), engine="compiled"
    )
    assert found.value == pytest.approx(value, rel=1e-12)
    np.testing.assert_allclose(found.gradient, gradient, rtol=1e-9)
    by_flights = likelihood_gradient(
        build, parameters, epochs(np.arange(60.0), z[:, None]), engine="numpy"
    )
    np.testing.assert_allclose(by_flights.gradient, gradient, rtol=1e-6)


def test_what_is_not_chosen_spoils_no_derivative():
    """A choice discards the square root of a negative number and a division by 0; a row of zeros
    has length 0.
    """
    tape = Tape()
    x = TracedArray((2,))
    x[0], x[1] = tape.input(), tape.input()
    with np.errstate(all="ignore"):
        y = [
            np.where(x[0] < 0.0, -3.0 * x[0], np.sqrt(x[0])),
            np.where(x[1] == 0.0, x[0] ** 2, x[0] / x[1]),
            np.sqrt(x[1] * x[1]),
        ]
    kernel = with_slopes(
        Kernel(tape, [("state", 0), ("state", 1)], [(i, one[()]) for i, one in enumerate(y)], []),
        {0, 1},
    )
    assert kernel.inputs == [("state", 0), ("state", 2), ("state", 1), ("state", 3)]
    with np.errstate(all="ignore"):
        found = values(tape, [-4.0, 0.0, 1.0, 0.5], np.array([x for _, x in kernel.state], object))
    assert [at for at, _ in kernel.state] == list(range(6))
    np.testing.assert_array_equal(found, [12.0, -3.0, 16.0, -8.0, 0.0, 0.0])


def test_models_that_know_the_parameters_are_flown_by_numpy():
    """A value in a function's closure is a constant of the program: the change is detected and
    reported.
    """

    def build(p):
        return celnav.ukf(
            Motion(lambda x, _: p[0] * x, 0.1 * np.eye(1)), Sensor([[1.0]], [[p[1]]])
        ), Gaussian([0.0], [[1.0]])

    when = epochs(TIMES, Z[:, 0])
    with pytest.raises(
        CannotCompile, match="a model uses the parameters elsewhere than in matrices"
    ):
        likelihood_gradient(build, [0.9, 0.4], when, engine="compiled")
    with pytest.raises(CannotCompile, match="a model uses the parameters"):
        maximize_likelihood(build, [0.9, 0.4], when, engine="compiled")
    found = likelihood_gradient(build, [0.9, 0.4], when)
    assert found.engine.startswith("numpy: a model uses")

    def matrix(p):
        return celnav.ukf(Motion([[p[0]]], 0.1 * np.eye(1)), Sensor([[1.0]], [[p[1]]])), Gaussian(
            [0.0], [[1.0]]
        )

    np.testing.assert_allclose(
        found.gradient, likelihood_gradient(matrix, [0.9, 0.4], when).gradient, rtol=1e-6
    )


def test_arrays_that_change_their_shapes_are_flown_by_numpy():
    """A noise with one column, and with two columns on the other side of the point."""

    def build(p):
        root = p[0] * np.array([[0.3], [0.1]])
        if p[0] > 1.0:
            root = np.concatenate([root, 0.0 * root], 1)
        return celnav.ukf(Motion(F, sqrt_Q=root), Sensor(np.eye(1, 2), [[0.2]])), prior()

    when = epochs(TIMES, Z)
    with pytest.raises(CannotCompile, match=r"^the filter's arrays change their shapes with the"):
        likelihood_gradient(build, [1.0], when, engine="compiled")
    found = likelihood_gradient(build, [1.0], when)
    assert found.engine.startswith("numpy: the filter's arrays change their shapes")

    def wide(p):
        root = p[0] * np.array([[0.3, 0.0], [0.1, 0.0]])
        return celnav.ukf(Motion(F, sqrt_Q=root), Sensor(np.eye(1, 2), [[0.2]])), prior()

    expected = likelihood_gradient(wide, [1.0], when, engine="compiled").gradient
    np.testing.assert_allclose(found.gradient, expected, rtol=1e-5)


def test_where_a_likelihood_jumps_it_has_no_compiled_gradient():
    """A measurement of 6 is at the gate of 3 standard deviations if R is 3 and the prior variance
    1.
    """

    def build(p):
        motion, sensor = Motion([[0.0]], [[1.0]]), Sensor([[1.0]], [[p[0]]])
        return celnav.ukf(motion, sensor, hooks=[adaptive.gate(3.0)]), Gaussian([0.0], [[1.0]])

    when, jump = epochs(np.arange(3.0), np.array([[0.5], [6.0], [1.0]])), "is not smooth in the"
    for call in (likelihood_gradient, maximize_likelihood):
        with pytest.raises(CannotCompile, match=jump):
            call(build, [3.0], when, engine="compiled")
    assert jump in likelihood_gradient(build, [3.0], when).engine
    for R in (2.0, 4.0):
        assert likelihood_gradient(build, [R], when).engine == "compiled"


def test_a_model_that_changes_with_a_parameter_later_is_noticed():
    """A branch on a parameter gives another step on the other side of the start."""

    def build(p):
        scale = 2.0 if p[0] > 1.0 else 1.0
        return celnav.ukf(
            Motion(F, np.eye(2)), Sensor(lambda x, _: scale * x[..., :1], [[p[0]]])
        ), prior()

    when = epochs(TIMES, Z)
    tuned = maximize_likelihood(build, [0.5], when)
    plain = maximize_likelihood(build, [0.5], when, engine="numpy")
    assert tuned.engine == "compiled"
    assert tuned.log_likelihood == pytest.approx(plain.log_likelihood, abs=1e-5)


def test_without_a_compiler_it_is_numpy(monkeypatch):
    def none():
        raise ImportError("engine='compiled': expected llvmlite, which pip brings")

    monkeypatch.setattr(llvm, "toolchain", none)
    monkeypatch.setattr(llvm, "_ADDRESSES", {})
    llvm.lanes.cache_clear(), llvm.features.cache_clear()
    when = epochs(TIMES, Z)
    assert likelihood_gradient(linear, POINT, when).engine.startswith(
        "numpy: engine='compiled': expected llvmlite"
    )
    tuned = maximize_likelihood(lambda p: linear([p[0], p[1], 1.0]), [0.5, 0.5], when)
    assert tuned.engine.startswith("numpy: engine='compiled': expected llvmlite")
    assert tuned.converged


def test_both_engines_find_the_same_maximum():
    """And the compiled engine needs a fraction of the runs."""
    truth = Motion(F, 0.1 * np.eye(2)), Sensor(np.eye(1, 2), [[0.3]])
    start = Gaussian(np.zeros(2), np.eye(2))
    _, z = celnav.simulate(*truth, start, TIMES, runs=20, seed=3)

    def build(p):
        return celnav.ukf(
            Motion(F, p[0] ** 2 * np.eye(2)), Sensor(np.eye(1, 2), [[p[1] ** 2]])
        ), start

    one, other = (
        maximize_likelihood(build, [1.0, 0.1], epochs(TIMES, z), engine=engine)
        for engine in ("compiled", "numpy")
    )
    assert one.converged
    assert other.converged
    assert (one.engine, other.engine) == ("compiled", "numpy")
    np.testing.assert_allclose(one.parameters, other.parameters, rtol=1e-4)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-3, atol=1e-8)
    assert one.log_likelihood == pytest.approx(other.log_likelihood, abs=1e-6)
    assert 2 * one.evaluations < other.evaluations


def test_bad_parameters_are_refused_by_name():
    with pytest.raises(ValueError, match=r"parameters: expected shape \(d,\), got \(\)"):
        likelihood_gradient(linear, 1.0, epochs(TIMES, Z))
    with pytest.raises(ValueError, match="build: expected a filter and a prior, got Gaussian"):
        likelihood_gradient(lambda p: prior(), POINT, epochs(TIMES, Z))


def test_what_is_known_to_be_the_same_program():
    """Functions with the same code and equal values, and data except matrices; everything else is
    checked again.
    """

    def made(gain, Q=1.0, table=(1.0, 2.0)):
        table = np.array(table)
        return celnav.ukf(
            Motion(lambda x, _, k=2.0: gain * k * x + table[0], Q * np.eye(1)),
            Sensor([[1.0]], [[1.0]]),
        )

    assert same_program(made(0.5), made(0.5))
    assert same_program(made(0.5), made(0.5, Q=2.0))
    assert not same_program(made(0.5), made(0.6))
    assert not same_program(made(0.5), made(0.5, table=(1.0, 3.0)))
    assert not same_program(made([0.5]), made([0.6]))
    assert not same_program(made(0.5), celnav.ckf(made(0.5).motion, made(0.5).sensors[0]))
    assert not same_program(object(), object())


def test_the_values_of_names_are_part_of_a_program():
    """Keywords of a partial, defaults of a function's keywords, tables by name."""

    def decay(x, _, *, rate=1.0):
        return rate * x

    def slow(rate):
        return lambda x, _, *, rate=rate: rate * x

    def table(**values):
        return lambda x, _: values["rate"] * x

    for make in (lambda rate: partial(decay, rate=rate), slow, lambda rate: table(rate=rate)):
        assert same_program(make(0.5), make(0.5))
        assert not same_program(make(0.5), make(0.6))
    assert not same_program(table(rate=0.5), table(other=0.5))
    assert not same_program({"a": 1.0, "b": 2.0}, {"b": 2.0, "a": 1.0})
    assert not same_program({"a": 1.0}, {"a": 1.0, "b": 2.0})

    def build(p):
        motion = Motion(partial(decay, rate=1.0 if p[0] < 0.5 else 0.5), p[0] * np.eye(1))
        return celnav.ukf(motion, Sensor([[1.0]], [[1.0]])), Gaussian([0.0], [[1.0]])

    when, gradient = epochs(TIMES, Z[:, 0]), Gradient(build, epochs(TIMES, Z[:, 0]))
    gradient(np.array([0.2]), np.ones(1))
    with pytest.raises(CannotCompile, match="a model uses the parameters elsewhere than in"):
        gradient(np.array([0.8]), np.ones(1))  # the step at 0.2 is recorded again
    found = likelihood_gradient(build, [0.8], when).gradient
    np.testing.assert_allclose(
        Gradient(build, when)(np.array([0.8]), np.ones(1))[1], found, rtol=1e-6
    )
