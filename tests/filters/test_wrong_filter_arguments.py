"""Wrong arguments of the filters' public functions: each raises an error that names it, or has the
effect that it states. No raw error comes through.
"""

import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest

import celnav
from celnav.filters.adaptive import (
    channel_parity,
    chi_square_gate,
    consider,
    correntropy,
    gate,
    group_parity,
    huber,
    innovation_window,
    sage_husa,
    student_t,
    underweighting,
    variational_bayes,
)
from celnav.filters.fixed_lag import FixedLag
from celnav.filters.sequential import Iterated, SingleDraw
from celnav.filters.switching import Fallback
from celnav.filters.two_stage import Plain, TwoStage
from celnav.gaussian.linalg import Covariance
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.models.noise import ar1_noise
from celnav.papers.tstdkf.method import Differenced, strong_tracking
from celnav.receiver.least_squares import least_squares

EYE = np.eye(2)
CSV = Path(mkdtemp(), "track.csv")
PRIOR = celnav.Gaussian(np.zeros(2), EYE)
TIMES = [0.0, 1.0, 2.0]
WHEN = celnav.epochs(TIMES, np.ones((3, 2)))
MANY = celnav.Gaussian(np.zeros((4, 2)), EYE)


def f(x, epoch, *noise):
    return x.copy()


def noisy(x, epoch, *noise):
    return x + sum(noise)


def one(mean, epoch):
    return np.broadcast_to(EYE, (*mean.shape, 2))


def moved(mean, epoch):
    return mean, EYE, EYE


MOTION, SENSOR, MATRIX = celnav.Motion(f, EYE), celnav.Sensor(f, EYE), celnav.Sensor(EYE, EYE)
OPTIONS = {"form": "square root", "hooks": (), "gain": 0.5 * EYE, "iterations": 2}
FILTER, OTHER = celnav.ukf(MOTION, SENSOR), celnav.ekf(MOTION, SENSOR)
NOISY = celnav.Motion(noisy, augment=(EYE,))
TRACK = celnav.run(FILTER, PRIOR, WHEN, keep="cov")
BIAS = celnav.Gaussian(np.zeros(2), EYE)
AGO = FixedLag(FILTER, 2).step(FixedLag(FILTER, 2).start(PRIOR), WHEN[0]._replace(z=None))[0]
AR1 = {"F": 0.5 * EYE, "L": 0.5 * EYE, "J": 0.1 * EYE, "Xi": EYE, "E": EYE}
COLORED = {"motion": MOTION, "Phi": 0.5 * EYE, "increments": EYE, "rule": celnav.unscented}


def flown(filter, prior=PRIOR, epochs=WHEN):
    return celnav.run(filter, prior, epochs)


def seen(hooks=(), gain=None):
    """A filter whose hook or gain is called with a complete, a partial and a
    missing measurement.
    """
    z = np.array([[1.0, 1.0], [np.nan, 1.0], [1.0, 1.0]])
    return celnav.run(celnav.ukf(MOTION, SENSOR, hooks=hooks, gain=gain), PRIOR, TIMES, z)


def made(make):
    """A function that runs the filter from ``make(motion, sensor, ...)``."""
    return lambda motion=MOTION, sensor=SENSOR, **a: flown(make(motion, sensor, **a))


def of(make, *fixed):
    """A filter with sigma points and a filter with Jacobians."""

    def call(**a):
        record = make(*fixed, **a)
        motion, sensor = (record, SENSOR) if make is celnav.Motion else (MOTION, record)
        for filter in (celnav.ukf, celnav.ekf):
            flown(filter(motion, sensor))

    return call


def linear(matrix):
    flown(celnav.ukf(celnav.Motion(celnav.Linear(matrix), EYE), MATRIX))
    flown(celnav.colored(MOTION, celnav.Sensor(celnav.Linear(matrix), EYE), 0.5 * EYE))


PARTS = {"motion": MOTION, "sensor": SENSOR}
DOORS = {
    "epochs": (
        lambda **a: flown(FILTER, epochs=celnav.epochs(**a)),
        {"times": [0.0, 1.0], "z": np.ones((2, 2)), "u": [1.0], "truth": [1, 2]},
    ),
    "run": (
        lambda **a: celnav.run(**a),
        {
            "filter": FILTER,
            "prior": PRIOR,
            "times": TIMES,
            "z": np.ones((3, 2)),
            "u": [1.0, 2.0],
            "every": 1,
            "keep": "std",
            "also": lambda *a: {},
            "reduce": lambda *a: 0,
            "on_failure": "raise",
        },
    ),
    "steps": (
        lambda **a: list(celnav.steps(**a)),
        {"filter": FILTER, "prior": PRIOR, "epochs": WHEN},
    ),
    "step": (lambda **a: FILTER.step(**a), {"state": FILTER.start(PRIOR), "epoch": WHEN[1]}),
    "epoch": (
        lambda **a: flown(FILTER, epochs=[celnav.Epoch(**a)]),
        {"k": 0, "t": 0.0, "dt": 1.0, "u": 0.0, "z": np.ones(2)},
    ),
    "Gaussian": (
        lambda **a: flown(FILTER, celnav.Gaussian(**a)),
        {"mean": np.zeros(2), "cov": EYE},
    ),
    "Gaussian sqrt": (
        lambda **a: flown(FILTER, celnav.Gaussian(np.zeros(2), **a)),
        {"sqrt_cov": EYE},
    ),
    "Motion": (
        of(celnav.Motion),
        {"f": f, "Q": EYE, "space": EUCLIDEAN, "jacobian": lambda mean, epoch: EYE, "augment": ()},
    ),
    "Motion sqrt": (of(celnav.Motion, f), {"sqrt_Q": EYE}),
    "Sensor": (
        of(celnav.Sensor),
        {"h": f, "R": EYE, "space": EUCLIDEAN, "jacobian": lambda mean, epoch: EYE, "augment": ()},
    ),
    "Sensor sqrt": (of(celnav.Sensor, EYE), {"sqrt_R": EYE}),
    "augment": (
        lambda **a: flown(celnav.ukf(celnav.Motion(noisy, **a), celnav.Sensor(noisy, **a))),
        {"augment": (EYE,)},
    ),
    "Linear": (linear, {"matrix": lambda epoch: EYE}),
    "Taylor": (
        lambda **a: flown(celnav.sigma_point(MOTION, SENSOR, rule=celnav.Taylor(**a))),
        {"step": 1e-3, "about": np.ones(2)},
    ),
    "sigma_point": (made(celnav.sigma_point), PARTS | OPTIONS | {"rule": celnav.unscented}),
    "sigma_point rule": (made(celnav.sigma_point), {"rule": celnav.unscented(2)}),
    "ukf": (made(celnav.ukf), PARTS | OPTIONS | {"alpha": 1.0, "beta": 0.0, "kappa": 0.5}),
    "ckf": (made(celnav.ckf), PARTS | OPTIONS | {"degree": 3}),
    "ghkf": (made(celnav.ghkf), PARTS | OPTIONS | {"order": 3}),
    "sparse_grid_filter": (
        made(celnav.sparse_grid_filter),
        PARTS | OPTIONS | {"level": 3, "weights": [1, 2]},
    ),
    "ekf": (made(celnav.ekf), PARTS | OPTIONS),
    "ekf matrix": (
        lambda **a: flown(celnav.ekf(celnav.Motion(EYE, EYE), MATRIX, **a)),
        {"gain": lambda A, sign, m: 0.5 * EYE},
    ),
    "Iterated": (
        lambda **a: flown(Iterated(MOTION, (SENSOR,), rule=celnav.Taylor(), form=Covariance, **a)),
        {"iterations": 2, "first": lambda belief, z, epoch: belief.mean},
    ),
    "Iterated points": (
        lambda **a: flown(
            Iterated(MOTION, (SENSOR,), rule=celnav.unscented(2), form=Covariance, **a)
        ),
        {"iterations": 2, "first": lambda belief, z, epoch: belief.mean},
    ),
    "imm": (
        lambda prior=PRIOR, **a: flown(celnav.imm(**a), prior),
        {
            "filters": [FILTER, OTHER],
            "transition": 0.5 * np.ones((2, 2)),
            "initial": [0.5, 0.5],
            "prior": PRIOR,
        },
    ),
    "hook": (lambda **a: seen([a["hook"]]), {"hook": lambda memory, joint, epoch: (memory, joint)}),
    "smooth": (
        lambda **a: celnav.smooth(**a),
        {"track": TRACK, "filter": FILTER, "gains": False, "on_failure": "raise"},
    ),
    "colored": (
        made(celnav.colored),
        COLORED | {"sensor": SENSOR, "first": True, "form": "covariance", "hooks": [gate(3.0)]},
    ),
    "colored matrix": (made(celnav.colored), COLORED | {"sensor": MATRIX, "first": False}),
    "decorrelated": (
        made(celnav.decorrelated),
        COLORED | {"sensor": MATRIX, "first": True, "hooks": [gate(3.0)]},
    ),
    "decorrelated hook": (
        lambda hook: flown(celnav.decorrelated(MOTION, MATRIX, 0.5 * EYE, hooks=[hook])),
        {"hook": lambda memory, joint, epoch: (memory, joint)},
    ),
    "augmented": (made(celnav.augmented), COLORED | {"sensor": SENSOR}),
    "two_stage": (
        made(celnav.two_stage),
        PARTS
        | OPTIONS
        | {"Gamma": EYE, "bias": BIAS, "Qb": EYE, "boost": strong_tracking([1.0, 1.0], 5.0)},
    ),
    "TwoStage.of": (
        lambda **a: flown(TwoStage.of(**a)),
        {"first": Plain(FILTER), "Gamma": one, "bias": BIAS, "Qb": 0.0 * EYE},
    ),
    "Plain": (lambda **a: flown(TwoStage.of(Plain(**a), EYE, BIAS)), {"filter": FILTER}),
    "strong_tracking": (
        lambda **a: flown(celnav.two_stage(MOTION, SENSOR, EYE, BIAS, boost=strong_tracking(**a))),
        {"rho": [1.0, 1.0], "tau": 5.0, "proportional": False},
    ),
    "ar1_noise": (lambda **a: ar1_noise(**a), AR1),
    "Differenced": (
        lambda prior=PRIOR, **a: flown(
            TwoStage.of(Differenced(**a), EYE, BIAS),
            prior,
            [celnav.Epoch(0, 1.0, 1.0, z=np.ones(2))],
        ),
        {"move": moved, "h": f, "slope": one, "noise": ar1_noise(**AR1), "prior": PRIOR},
    ),
    "least_squares": (
        lambda prior=PRIOR, **a: flown(least_squares(**a), prior),
        {"sensor": celnav.Sensor(f, EYE, jacobian=one), "rounds": 3, "prior": PRIOR},
    ),
    "least_squares of": (
        lambda **a: flown(least_squares(celnav.Sensor(**a))),
        {"h": f, "R": EYE, "jacobian": one},
    ),
    "Fallback": (
        lambda prior=PRIOR, **a: flown(Fallback(**a), prior),
        {"first": FILTER, "second": OTHER, "prior": PRIOR},
    ),
    "FixedLag": (lambda **a: flown(FixedLag(**a)), {"filter": FILTER, "lag": 2}),
    "FixedLag.step": (
        lambda **a: FixedLag(FILTER, 2).step(**a),
        {"state": FixedLag(FILTER, 2).start(PRIOR), "epoch": WHEN[0]},
    ),
    "FixedLag.late": (
        lambda **a: FixedLag(FILTER, 2).late(**a),
        {"state": AGO, "k": 0, "z": np.ones(2)},
    ),
    "FixedLag.track": (lambda **a: celnav.smooth(FixedLag(FILTER, 2).track(**a)), {"state": AGO}),
    "SingleDraw": (lambda **a: flown(SingleDraw.of(**a)), {"filter": celnav.ukf(NOISY, SENSOR)}),
    "SingleDraw noise": (
        lambda **a: flown(replace(SingleDraw.of(celnav.ukf(NOISY, SENSOR)), **a)),
        {"joint_noise": (EYE,)},
    ),
    "simulate": (
        lambda **a: celnav.simulate(**a),
        {
            "motion": MOTION,
            "sensor": SENSOR,
            "prior": PRIOR,
            "times": TIMES,
            "runs": 2,
            "seed": 1,
            "u": [1.0, 2.0],
            "Phi": 0.5 * EYE,
        },
    ),
    "simulate sensors": (
        lambda **a: celnav.simulate(MOTION, prior=PRIOR, times=TIMES, runs=2, **a),
        {"sensor": [SENSOR, MATRIX]},
    ),
    "simulate models": (
        lambda f, h, Q, R: celnav.simulate(
            celnav.Motion(f, Q), celnav.Sensor(h, R), PRIOR, TIMES, runs=2
        ),
        {"f": f, "h": f, "Q": EYE, "R": EYE},
    ),
    "to_dataframe": (lambda **a: TRACK.to_dataframe(**a), {"names": ["a", "b"]}),
    "to_csv": (lambda **a: TRACK.to_csv(CSV, **a), {"names": ["a", "b"]}),
}
HOOKS = {
    gate: {"gamma": 3.0},
    chi_square_gate: {"probability": 0.9},
    innovation_window: {"M": 2, "gaps": "skip"},
    huber: {"threshold": 1.0, "rounds": 2},
    student_t: {"dof": 1.0, "rounds": 2},
    sage_husa: {"forgetting": 0.9, "least": 0.5, "smallest": 0.1},
    correntropy: {"bandwidth": 1.0, "rounds": 2},
    variational_bayes: {"forgetting": 1.0, "samples": 3.0, "rounds": 2},
    underweighting: {"beta": 0.2, "share": 0.0},
    group_parity: {"groups": [[0, 1]], "unknowns": 1, "deviations": 3.0},
    channel_parity: {"M": 2},
}
DOORS |= {
    hook.__name__: (lambda hook=hook, **a: seen([hook(**a)]), good) for hook, good in HOOKS.items()
}
DOORS["consider"] = lambda **a: seen(gain=consider(**a)), {"n": 1, "k": 1}
WRONG = {
    "None": None,
    "text": "x",
    "no list": [],
    "no array": np.zeros((0, 2)),
    "complex": 1j * EYE,
    "imaginary": 1j,
    "object": object(),
    "nan": np.nan,
    "infinite": np.inf,
    "negative": -1,
    "half": 0.5,
    "true": True,
    "a billion": 10**9,
    "huge": 10**400,
    "table": {"a": 1},
    "set": {1, 2},
    "words": ["a", "b"],
    "nones": [None, None],
    "pair": [1.0, 2.0],
    "ragged": [[1.0], [1.0, 2.0]],
    "deep": np.zeros((2, 2, 2)),
    "wide": np.zeros((2, 3)),
    "nans": np.full((2, 2), np.nan),
    "dates": np.array(["2026-01-01", "2026-01-02"], "datetime64[s]"),
    "class": celnav.Gaussian,
    "function": len,
    "of nothing": lambda: 1.0,
    "of anything": lambda *a, **k: None,
    "of text": lambda *a, **k: "x",
    "generator": 7,
}
NAMES = {name for _, good in DOORS.values() for name in good} | {
    "Gaussian",
    "consider",
    "deviations",
    "innovation_window",
    "name",
    "names",
    "sensors",
}


def named(error):
    """Whether an error names the argument and what was expected."""
    said = re.match(r"(\w+)(?:, \w+)*(?: returned shape|: )", str(error))
    return (
        isinstance(error, ValueError | TypeError | celnav.FilterError)
        and said is not None
        and said[1] in NAMES
    )


@pytest.mark.parametrize("door", DOORS)
def test_right_arguments_are_accepted(door):
    call, good = DOORS[door]
    call(**good)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("door", DOORS)
def test_wrong_arguments_are_told_by_name(door):
    """An accepted argument has its stated effect; any other raises an error that names it, before
    long or memory-consuming work.
    """
    call, good = DOORS[door]
    for argument, (what, wrong) in product(good, WRONG.items()):
        value = (i for i in range(3)) if what == "generator" else wrong
        try:
            call(**{**good, argument: value})
        except celnav.FilterError:
            pass
        except Exception as error:
            if not named(error):
                raise AssertionError(
                    f"{argument} = {what}: {type(error).__name__}: {error}"
                ) from error


def hooked(hook):
    return flown(celnav.ukf(MOTION, SENSOR, hooks=[hook]))


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (
            lambda: huber(rounds=10**9),
            "rounds: expected an integer from 1 to 10000, got 1000000000",
        ),
        (lambda: variational_bayes(rounds=10**9), "rounds: expected an integer from 1 to 10000"),
        (lambda: correntropy(rounds=10**9), "rounds: expected an integer from 1 to 10000"),
        (lambda: student_t(rounds=10**9), "rounds: expected an integer from 1 to 10000"),
        (
            lambda: least_squares(MATRIX, rounds=10**9),
            "rounds: expected an integer from 1 to 10000",
        ),
        (
            lambda: celnav.ekf(MOTION, SENSOR, iterations=10**9),
            "iterations: expected an integer from 1 to 10000",
        ),
        (
            lambda: seen([innovation_window(10**9)]),
            "M: expected a window of at most 1000000000 numbers, got 1000000000 samples of 2",
        ),
        (
            lambda: seen([channel_parity(10**9)]),
            "M: expected a window of at most 1000000000 numbers, got 1000000000 samples of 2",
        ),
        (
            lambda: celnav.simulate(MOTION, SENSOR, PRIOR, TIMES, runs=10**9),
            "runs: expected at most 1000000, got 1000000000",
        ),
        (
            lambda: celnav.Motion(lambda x: x, EYE),
            "f: expected a function (points, epoch, *noise), got function <lambda> with other",
        ),
        (
            lambda: celnav.Sensor(f, lambda x: EYE),
            "R: expected a function (mean, epoch), got function <lambda> with other arguments",
        ),
        (lambda: celnav.Linear(EYE), "matrix: expected a function (epoch), got ndarray"),
        (
            lambda: linear(lambda epoch: np.eye(3)),
            "matrix: expected shape (..., any, 2), got (3, 3)",
        ),
        (
            lambda: linear(lambda epoch: np.eye(3, 2)),
            "matrix: expected shape (..., 2, 2), got (3, 2)",
        ),
        (
            lambda: flown(celnav.ukf(celnav.Motion(lambda x, e: 1j * x, EYE))),
            "f: expected numbers, got array([[",
        ),
        (
            lambda: hooked(lambda m, j, e: j.innovation),
            "hooks: expected (memory, joint) from the function, got ndarray",
        ),
        (
            lambda: hooked(lambda m, j, e: (m, None)),
            "hooks: expected hooks that give back (memory, joint), got NoneType",
        ),
        (
            lambda: flown(celnav.sigma_point(MOTION, rule=len)),
            "rule: expected a function of the dimension, got function len: object",
        ),
        (
            lambda: flown(celnav.sigma_point(MOTION, rule=lambda n: 3)),
            "rule: expected a rule for 2 dimensions, such as celnav.unsc",
        ),
        (
            lambda: celnav.ukf(MOTION, SENSOR, gain=lambda A: A),
            "gain: expected a function (A, sign, m), got function <lambda> with ot",
        ),
        (
            lambda: Fallback(FILTER, MOTION),
            "second: expected celnav.ukf(motion, sensor), got Motion",
        ),
        (
            lambda: Fallback(celnav.colored(MOTION, SENSOR, 0.5 * EYE), FILTER),
            "first: expected a filter that predicts, then updates",
        ),
        (
            lambda: Plain(SingleDraw.of(celnav.ukf(NOISY, SENSOR))),
            "filter: expected a filter that predicts, then updates",
        ),
        (
            lambda: Plain(celnav.ukf(MOTION, SENSOR, SENSOR)),
            "filter: expected one sensor and states that are vectors",
        ),
        (
            lambda: celnav.run(FILTER, PRIOR, WHEN, keep="covs"),
            "keep: expected one of std, cov, mean, nothing, got 'covs'; did you",
        ),
        (
            lambda: celnav.run(FILTER, PRIOR, WHEN, also=lambda *a: 3),
            "also: expected a dict, such as {'gain': array}, got int",
        ),
        (
            lambda: celnav.run(FILTER, PRIOR, None),
            "epochs: expected celnav.epochs(times, z), or records like celnav.Epoch, got None",
        ),
        (
            lambda: FILTER.step(FILTER.start(PRIOR), 1.0),
            "epoch: expected a record like celnav.Epoch, got float",
        ),
        (
            lambda: celnav.run(FILTER, celnav.Gaussian, WHEN),
            "prior: expected a Gaussian, such as celnav.Gaussian(mean, cov), got cl",
        ),
        (
            lambda: celnav.smooth(TRACK, MOTION),
            "filter: expected a filter that predicts, then updates, such as celnav.ukf, got Motion",
        ),
        (lambda: TRACK.to_dataframe("xy"), "names: expected 2 words, such as ['x', 'y'], got 'xy'"),
        (
            lambda: celnav.two_stage(
                MOTION, SENSOR, EYE, celnav.Gaussian(np.zeros((3, 2)), EYE)
            ).start(PRIOR),
            "bias: expected one, or one for each run (), got (3,)",
        ),
        (
            lambda: flown(
                celnav.colored(MOTION, SENSOR, lambda e: np.zeros((3, 2, 2)), increments=EYE), MANY
            ),
            "Phi: expected batch axes that broadcast with (4,) of the belief, got (3,)",
        ),
    ],
)
def test_what_is_said(make, told):
    with pytest.raises(ValueError, match=re.escape(told)):
        make()
