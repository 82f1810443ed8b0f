"""Wrong arguments at the doors of the filters: each is refused by its name, or does what it says. No raw error comes through."""

import re
from itertools import product

import numpy as np
import pytest

import celnav
from celnav.filters.adaptive import chi_square_gate, consider, fallback, gate, innovation_window
from celnav.filters.colored import augmented, colored
from celnav.filters.decorrelated import decorrelated
from celnav.filters.differenced import ar1_noise, differenced
from celnav.filters.iterated import iterated
from celnav.filters.least_squares import least_squares
from celnav.filters.parity import channel_parity, group_parity
from celnav.filters.robust import huber, sage_husa, student_t
from celnav.filters.single_draw import drawn_once, single_draw
from celnav.filters.strong_tracking import strong_tracking
from celnav.filters.two_stage import plain, two_stage
from celnav.gaussian.spaces import EUCLIDEAN

EYE, RULE = np.eye(2), celnav.unscented(2)
PRIOR = celnav.square_root(np.zeros(2), EYE)
WHEN = celnav.epochs([0.0, 1.0, 2.0], np.ones((3, 2)))


def f(x, epoch, *noise):
    return x.copy()


MOTION, SEE = celnav.predict(f, RULE, EYE), celnav.update(f, RULE, EYE)
FILTER = celnav.sequential(MOTION, SEE)
FIRST = plain(MOTION, SEE)
TRACK = celnav.run(FILTER, PRIOR, WHEN, keep="spread")
AR1 = {"F": 0.5 * EYE, "L": 0.5 * EYE, "J": 0.1 * EYE, "Xi": EYE, "E": EYE}


def flown(filter, prior=PRIOR, epochs=WHEN):
    return celnav.run(filter, prior, epochs)


def seen(hooks):
    """A filter of which the hook sees all: a whole measurement, a part of it, none."""
    z = np.array([[1.0, 1.0], [np.nan, 1.0], [1.0, 1.0]])
    return celnav.run(celnav.sequential(MOTION, celnav.update(f, RULE, EYE, hooks=hooks)), PRIOR, celnav.epochs([0.0, 1.0, 2.0], z))


def moved(mean, epoch):
    return mean, EYE, EYE


def one(mean, epoch):
    return np.broadcast_to(EYE, (*mean.shape, 2))


BIAS = celnav.square_root(np.zeros(2), EYE)
COLORED = {"f": f, "h": EYE, "rule": RULE, "Phi": 0.5 * EYE, "Q": EYE, "R": EYE, "Sigma0": EYE, "hooks": ()}
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
            "epochs": WHEN,
            "every": 1,
            "keep": "std",
            "also": lambda *a: {},
            "reduce": lambda *a: 0,
            "on_failure": "raise",
        },
    ),
    "steps": (lambda **a: list(celnav.steps(**a)), {"filter": FILTER, "prior": PRIOR, "epochs": WHEN}),
    "sequential": (lambda predict, update: flown(celnav.sequential(predict, update)), {"predict": MOTION, "update": SEE}),
    "epoch": (lambda **a: flown(FILTER, epochs=[celnav.Epoch(**a)]), {"k": 0, "t": 0.0, "dt": 1.0, "u": 0.0, "z": np.ones(2)}),
    "predict": (
        lambda **a: flown(celnav.sequential(celnav.predict(**a))),
        {"f": f, "rule": RULE, "Q": EYE, "extra": (), "space": EUCLIDEAN},
    ),
    "predict sqrt": (lambda **a: flown(celnav.sequential(celnav.predict(f, RULE, **a))), {"sqrt_Q": EYE}),
    "predict called": (lambda **a: MOTION(**a), {"belief": PRIOR, "epoch": WHEN[1]}),
    "update": (
        lambda **a: flown(celnav.sequential(MOTION, celnav.update(**a))),
        {
            "h": f,
            "rule": RULE,
            "R": EYE,
            "extra": (),
            "space": EUCLIDEAN,
            "measurement_space": EUCLIDEAN,
            "hooks": (),
            "gain": 0.5 * EYE,
        },
    ),
    "update matrix": (lambda **a: flown(celnav.sequential(MOTION, celnav.update(rule=RULE, **a))), {"h": EYE, "sqrt_R": EYE}),
    "update called": (lambda **a: SEE(**a), {"belief": PRIOR, "z": [1.0, 1.0], "memory": None}),
    "hooked called": (lambda **a: celnav.update(f, RULE, EYE, hooks=[gate(3.0)])(PRIOR, [1.0, 1.0], **a), {"memory": None}),
    "smooth": (
        lambda **a: celnav.smooth(**a),
        {"track": TRACK, "epochs": WHEN, "motion": MOTION, "gains": False, "on_failure": "raise"},
    ),
    "colored": (lambda **a: flown(colored(**a)), COLORED),
    "colored sqrt": (
        lambda **a: flown(colored(f, f, celnav.unscented(4), 0.5 * EYE, **a)),
        {"sqrt_Q": EYE, "sqrt_R": EYE, "Sigma0": EYE, "first_rule": RULE},
    ),
    "decorrelated": (lambda h, **a: flown(decorrelated(H=h, **a)), COLORED),
    "augmented": (
        lambda **a: flown(augmented(**a)),
        {"f": f, "H": EYE, "rule": celnav.unscented(4), "Phi": 0.5 * EYE, "Q": EYE, "R": EYE, "Sigma0": EYE},
    ),
    "iterated": (
        lambda **a: flown(celnav.sequential(MOTION, iterated(**a))),
        {
            "h": f,
            "R": EYE,
            "iterations": 2,
            "start": lambda b, z, e: b.mean,
            "jacobians": lambda x, e: (EYE,),
            "space": EUCLIDEAN,
            "measurement_space": EUCLIDEAN,
        },
    ),
    "least_squares": (lambda **a: flown(least_squares(**a)), {"h": f, "jacobian": one, "sigma": [1.0, 1.0], "rounds": 3}),
    "single_draw": (
        lambda **a: flown(drawn_once(single_draw(**a), SEE)),
        {
            "f": f,
            "h": f,
            "rule": celnav.unscented(4),
            "extra": (EYE,),
            "R": EYE,
            "space": EUCLIDEAN,
            "measurement_space": EUCLIDEAN,
            "hooks": (),
        },
    ),
    "drawn_once": (
        lambda **a: flown(drawn_once(**a)),
        {"part": single_draw(f, f, celnav.unscented(4), extra=(EYE,), R=EYE), "first": SEE},
    ),
    "plain": (lambda **a: flown(two_stage(plain(**a), EYE, BIAS)), {"predict": MOTION, "update": SEE}),
    "two_stage": (
        lambda **a: flown(two_stage(**a)),
        {"first": FIRST, "Gamma": EYE, "bias": BIAS, "Qb": EYE, "boost": strong_tracking([1.0, 1.0], 5.0)},
    ),
    "strong_tracking": (
        lambda **a: flown(two_stage(FIRST, EYE, BIAS, boost=strong_tracking(**a))),
        {"rho": [1.0, 1.0], "tau": 5.0, "factor": celnav.filters.strong_tracking.excess},
    ),
    "ar1_noise": (lambda **a: ar1_noise(**a), AR1),
    "differenced": (
        lambda **a: celnav.run(two_stage(differenced(**a), EYE, BIAS), celnav.covariance(np.zeros(2), EYE), WHEN),
        {"move": moved, "h": f, "slope": one, "noise": ar1_noise(**AR1)},
    ),
    "gate": (lambda **a: seen([gate(**a)]), {"gamma": 3.0}),
    "chi_square_gate": (lambda **a: seen([chi_square_gate(**a)]), {"probability": 0.9}),
    "innovation_window": (lambda **a: seen([innovation_window(**a)]), {"M": 2, "gaps": "skip"}),
    "huber": (lambda **a: seen([huber(**a)]), {"threshold": 1.0, "rounds": 2}),
    "student_t": (lambda **a: seen([student_t(**a)]), {"dof": 1.0, "rounds": 2}),
    "sage_husa": (lambda **a: seen([sage_husa(**a)]), {"forgetting": 0.9, "least": 0.5, "smallest": 0.1}),
    "group_parity": (lambda **a: seen([group_parity(**a)]), {"groups": [[0, 1]], "unknowns": 1, "deviations": 3.0}),
    "channel_parity": (lambda **a: seen([channel_parity(**a)]), {"M": 2}),
    "consider": (lambda **a: flown(celnav.sequential(MOTION, celnav.update(f, RULE, EYE, gain=consider(**a)))), {"n": 1, "k": 1}),
    "fallback": (lambda **a: flown(celnav.sequential(MOTION, fallback(**a))), {"first": SEE, "second": SEE}),
    "to_dataframe": (lambda **a: TRACK.to_dataframe(**a), {"names": ["a", "b"]}),
    "to_csv": (lambda **a: TRACK.to_csv("/dev/null", **a), {"names": ["a", "b"]}),
}
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
    "H",
    "mean",
    "cov",
    "epochs",
    "gain",
    "hooks",
    "jacobians",
    "name",
    "names",
    "deviations",
    "spread",
    "start",
    "state",
    "updates",
    "consider",
    "belief",
    "root",
    "also",
    "reduce",
    "innovation_window",
    "channel_parity",
}


def named(error):
    """Whether an error says which argument it is about and what was expected of it."""
    said = re.match(r"(\w+)(?:, \w+)*(?: returned shape|: )", str(error))
    return isinstance(error, ValueError | TypeError | celnav.FilterError) and said is not None and said[1] in NAMES


@pytest.mark.parametrize("door", DOORS)
def test_right_arguments_are_accepted(door):
    call, good = DOORS[door]
    call(**good)


@pytest.mark.parametrize("door", DOORS)
def test_wrong_arguments_are_told_by_name(door):
    """What is accepted does what it says; whatever is not is told by its name, before anything takes long or much memory."""
    call, good = DOORS[door]
    for argument, (what, wrong) in product(good, WRONG.items()):
        value = (i for i in range(3)) if what == "generator" else wrong
        try:
            call(**{**good, argument: value})
        except celnav.FilterError:
            pass
        except Exception as error:
            if not named(error):
                raise AssertionError(f"{argument} = {what}: {type(error).__name__}: {error}") from error


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: huber(rounds=10**9), "rounds: expected at most 10000 at every step, got 1000000000"),
        (lambda: student_t(rounds=10**9), "rounds: expected at most 10000 at every step"),
        (lambda: iterated(f, EYE, iterations=10**9), "iterations: expected at most 10000 at every step"),
        (
            lambda: seen([innovation_window(10**9)]),
            "M: expected a window of at most 1000000000 numbers, got 1000000000 samples of 2",
        ),
        (lambda: seen([channel_parity(10**9)]), "M: expected a window of at most 1000000000 numbers, got 1000000000 samples of 2"),
        (lambda: celnav.predict(lambda x: x, RULE, EYE), "f: expected a function (points, epoch), got function <lambda> of other"),
        (
            lambda: single_draw(f, lambda x, e: x, RULE, extra=(EYE,)),
            "h: expected a function (points, epoch, *noise), got function",
        ),
        (lambda: flown(celnav.sequential(celnav.predict(lambda x, e: 1j * x, RULE, EYE))), "f: expected numbers, got array([["),
        (lambda: flown(celnav.sequential(MOTION, lambda b, z, e, m: b)), "updates: expected (belief, info, memory) from what"),
        (lambda: fallback(SEE, MOTION), "second: expected a part like the first, got Conditioning and Motion"),
        (lambda: fallback(SEE, 3), "second: expected a part (belief, epoch) or (belief, z, epoch, memory), got int"),
        (
            lambda: celnav.run(FILTER, PRIOR, WHEN, keep="spreads"),
            "keep: expected one of std, spread, mean, nothing, got",
        ),
        (lambda: celnav.run(FILTER, PRIOR, WHEN, also=lambda *a: 3), "also: expected a dict, such as {'gain': array}, got int"),
        (lambda: celnav.smooth(TRACK, list(range(3)), MOTION), "epochs: expected the times of the track, got 0 instead of 0.0"),
        (lambda: TRACK.to_dataframe("xy"), "names: expected 2 words, such as ['x', 'y'], got 'xy'"),
        (lambda: SEE(np.zeros(2), [1.0, 1.0]), "belief: expected a Gaussian, such as celnav.square_root(mean, cov), got ndarray"),
    ],
)
def test_what_is_said(make, told):
    with pytest.raises(ValueError, match=re.escape(told)):
        make()
