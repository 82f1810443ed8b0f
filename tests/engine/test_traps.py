"""Models with traps: every engine gives numpy's result, or names the line that it cannot record.

Tables hold models of a few lines, one trap each, and one expectation:
EQUAL   The model is pure arithmetic. It is compiled, and equals numpy to round-off.
ACCEPTED It is, and the problem ill-conditioned: it is compiled, and as far from numpy as numpy
        comes from itself by the last bits of its input.
EITHER  It is pure, but need not be compiled: it is equal, or refused with its line and the cure.
MEMORY  It remembers earlier calls, and each call shows it: it is refused.
HIDDEN  Its memory acts after many calls, which no comparison at some epochs can see: it is
        refused, or treated as what it was at first. A model is a function of its arguments.
COUPLED It looks at other points or runs on purpose: as EITHER, but numpy may refuse it, too.
DOOR    It treats points or runs as components: every engine refuses it before the first step.
"""

from __future__ import annotations

import bisect
import collections
import datetime
import decimal
import fractions
import functools
import inspect
import itertools
import json
import math
import operator
import random
import re
import statistics
import sys
import time
import warnings
from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.integrate
import scipy.interpolate
import scipy.linalg
import scipy.special
from scipy.spatial.transform import Rotation

import celnav
from celnav.filters import adaptive
from celnav.filters.sequential import SingleDraw
from celnav.filters.switching import Fallback
from celnav.gaussian.attitude import attitude, exp, multiply, rotate
from celnav.models import motion as motions
from celnav.models import orbit

pytest.importorskip("llvmlite")
from celnav.engine.compiled import CannotCompile

pytestmark = pytest.mark.usefixtures("eager")

T, RUNS = 80, 3
TIMES = np.arange(float(T))
RNG = np.random.default_rng(35)
EQUAL, EITHER, DOOR = "equal", "equal or refused", "refused at the door"
ACCEPTED = "ill-conditioned and accepted"
MEMORY, HIDDEN, COUPLED = "with memory", "with hidden memory", "of other points"
MAYBE_DOOR = (MEMORY, HIDDEN, COUPLED)  # numpy may refuse them, too


# -- filters around a model ----------------------------------------------------------------------
class Case(NamedTuple):
    """A filter and its arguments, and the model with the expectation from the table."""

    expected: str
    make: Any  # () -> (filter, arguments of `celnav.run`)
    model: Any  # the function whose line an error names
    squared: bool = False  # a covariance form: round-off grows with the square of the condition


CASES: dict[str, Case] = {}


def cases(expected, subject, build, models, squared=False, **given):
    """Add a table of models; ``build`` makes a filter of each."""
    for name, model in models.items():
        key = f"{subject}: {name}"
        assert key not in CASES, key
        CASES[key] = Case(expected, lambda model=model: (build(model), dict(given)), model, squared)


# A target on a line, its position measured: it passes 30 at a third of the flight.
F = np.array([[1.0, 1.0], [0.0, 1.0]])
Q = np.diag([0.01, 0.01])
GPS = celnav.Sensor(np.eye(1, 2), R=[[1.0]])
BOTH = celnav.Sensor(np.eye(2), np.diag([1.0, 0.25]))
START = celnav.Gaussian([0.0, 1.0], np.diag([4.0, 0.25]))
POSITIONS = TIMES[:, None, None] + RNG.standard_normal((T, RUNS, 1))
LINE = {"prior": START, "times": TIMES, "z": POSITIONS}
ALONE = {"prior": START, "times": TIMES, "z": POSITIONS[:, 0]}  # no axis of runs

# Three states between -5 and 5, the first measured.
F3 = np.array([[1.0, 0.1, 0.0], [0.0, 0.9, 0.1], [0.0, 0.0, 0.95]])
FIX = celnav.Sensor(np.eye(1, 3), R=[[1.0]])
WALK = np.cumsum(0.3 * RNG.standard_normal((T, 4, 1)), 0)
THREE = {"prior": celnav.Gaussian([0.0, 0.5, -0.5], np.eye(3)), "times": TIMES, "z": WALK}


def moved(x, _epoch=None):
    return x @ F.T


def pushed(a):
    """A motion that adds ``a(x, epoch)`` to the velocity."""

    def f(x, epoch):
        y = moved(x)
        return np.stack([y[..., 0], y[..., 1] + a(x, epoch)], -1)

    return celnav.Motion(f, Q)


def push(a):
    return celnav.ukf(pushed(a), GPS)


def push_both(a):
    return celnav.ukf(pushed(a), BOTH)


def push_fresh(make):
    return push(make())


def bend(a):
    """A filter whose third state moves by a bounded function of ``a(x, epoch)``."""

    def f(x, epoch):
        y = x @ F3.T
        bent = y[..., 2] + 0.1 * np.tanh(a(x, epoch))
        return np.stack([y[..., 0], y[..., 1], bent], -1)

    return celnav.ukf(celnav.Motion(f, 0.01 * np.eye(3)), FIX)


def by_motion(f):
    return celnav.ukf(celnav.Motion(f, Q), GPS)


def by_motion3(f):
    return celnav.ukf(celnav.Motion(f, 0.01 * np.eye(3)), FIX)


def by_sensor(h):
    return celnav.ukf(celnav.Motion(F, Q), celnav.Sensor(h, [[1.0]]))


def by_sensor2(h):
    return celnav.ukf(celnav.Motion(F, Q), celnav.Sensor(h, np.eye(2)))


def by_Q(noise):
    return celnav.ukf(celnav.Motion(moved, noise), GPS)


def by_R(noise):
    return celnav.ukf(celnav.Motion(F, Q), celnav.Sensor(np.eye(1, 2), noise))


def by_jacobian(jacobian):
    return celnav.ekf(celnav.Motion(moved, Q, jacobian=jacobian), GPS)


def itself(filter):
    return filter


WRAPPERS = (moved, pushed, push, bend)


# -- time and index ------------------------------------------------------------------------------
TIME = {
    "one epoch": lambda x, e: np.where(e.k == 50, 3.0, 0.0),
    "the first step": lambda x, e: np.where(e.k == 1, 3.0, 0.0),
    "the last step": lambda x, e: np.where(e.k == T - 1, 3.0, 0.0),
    "each 25th": lambda x, e: np.where(np.floor(e.k / 25) * 25 == e.k, 1.0, 0.0),
    "late": lambda x, e: np.where(e.t > 60, 0.1, 0.0),
    "late, with equality": lambda x, e: np.where(e.t >= 60.0, 0.1, 0.0),
    "a window": lambda x, e: np.where((e.t >= 30) & (e.t < 40), 0.1, 0.0),
    "two windows": lambda x, e: np.where(((e.t > 9) & (e.t < 12)) | (e.t > 70), 0.1, 0.0),
    "not equal": lambda x, e: np.where(e.k != 50, 0.01, 1.0),
    "floor": lambda x, e: 0.1 * np.floor(e.t / 49),
    "floor of sevenths": lambda x, e: 0.01 * np.floor(e.t / 7.0),
    "floor of tenths": lambda x, e: 1e-3 * np.floor(e.t / 0.1),
    "floor of a product": lambda x, e: 0.1 * np.floor(e.t * (1 / 49)),
    "ceil": lambda x, e: 0.01 * np.ceil(e.t / 49),
    "rint": lambda x, e: 0.01 * np.rint(e.t / 6.0),
    "trunc": lambda x, e: 0.01 * np.trunc(e.t / 3.0),
    "a sawtooth": lambda x, e: 0.1 * (e.t / 49 - np.floor(e.t / 49)),
    "a comparison of a quotient": lambda x, e: np.where(e.t / 49 >= 1.0, 0.1, 0.0),
    "equality of a quotient": lambda x, e: np.where(e.t / 49 == 1.0, 2.0, 0.0),
    "powers": lambda x, e: 1e-5 * e.t**2 + 0.01 * e.t**0.5,
    "a wave": lambda x, e: 0.1 * np.sin(0.2 * e.t) * np.exp(-e.t / 40.0),
    "limits": lambda x, e: 0.01 * np.minimum(np.maximum(e.t, 20.0), 60.0),
    "clip": lambda x, e: 0.01 * np.clip(e.t, 20.0, 60.0),
    "sign": lambda x, e: 0.01 * np.sign(e.t - 40.0),
    "abs": lambda x, e: 0.001 * abs(e.t - 40.0),
    "dt": lambda x, e: 0.1 * e.dt,
    "logical_and": lambda x, e: np.where(np.logical_and(e.t > 5, e.t < 9), 1.0, 0.0),
}
cases(EQUAL, "time", push, TIME, **LINE)

TABLE = np.sin(0.1 * np.arange(T))
TABLE_LIST = TABLE.tolist()
BURNS = {50: 3.0}
EVERY_BURN = dict(enumerate(TABLE_LIST))
SPLINE = scipy.interpolate.CubicSpline([0.0, 30.0, 80.0], [0.0, 0.1, 0.0])


@functools.lru_cache
def cached(k):
    return TABLE_LIST[int(k)]


def matched(x, e):
    match e.k:
        case 50:
            return 3.0
        case _:
            return 0.0


def anything_caught(x, e):
    try:
        return BURNS[e.k]
    except Exception:
        return 0.0


def key_error_caught(x, e):
    try:
        return BURNS[e.k]
    except KeyError:
        return 0.0


def float_caught(x, e):
    try:
        return 0.1 * (float(e.t) > 60)
    except (TypeError, ValueError):
        return 0.0


def comparison_caught(x, e):
    try:
        return 3.0 if e.k == 50 else 0.0
    except Exception:
        return 0.0


def looped(x, e):
    total = 0.0
    for _ in range(e.k):
        total += 1e-3
    return total


def looped_while(x, e):
    left, count = e.t, 0
    while left >= 49:
        left, count = left - 49, count + 1
    return 0.1 * count


LOG = []


def logged(x, e):
    LOG.append(f"step {e.k}")
    return 0.01


TIME_BY_VALUE = {
    "outside a window": lambda x, e: np.where(~((e.t >= 30) & (e.t < 40)), 0.1, 0.0),
    "a dictionary": lambda x, e: BURNS.get(e.k, 0.0),
    "a dictionary by time": lambda x, e: BURNS.get(e.t, 0.0),
    "a dictionary of all epochs": lambda x, e: EVERY_BURN[e.k],
    "a default dictionary": lambda x, e: collections.defaultdict(float, BURNS)[e.k],
    "a counting dictionary": lambda x, e: collections.Counter({50: 3})[e.k],
    "a set": lambda x, e: 3.0 * (e.k in {50}),
    "a frozen set of times": lambda x, e: 3.0 * (e.t in frozenset({50.0})),
    "a tuple": lambda x, e: 3.0 * (e.k in (50, 51)),
    "a list": lambda x, e: 3.0 * (e.k in [50]),
    "a range": lambda x, e: 3.0 * (e.k in range(50, 52)),
    "an array": lambda x, e: 3.0 * (e.k in np.array([50])),
    "isin": lambda x, e: 3.0 * np.isin(e.k, [50]),
    "a list of times": lambda x, e: 3.0 * [50.0, 51.0].count(e.t),
    "an index in a list": lambda x, e: 0.001 * list(range(T)).index(e.k),
    "str": lambda x, e: 0.1 * len(str(e.k)),
    "str of a time": lambda x, e: 0.1 * len(str(e.t)),
    "str compared": lambda x, e: 3.0 * (str(e.k) == "50"),
    "an f-string looked up": lambda x, e: {"50": 3.0}.get(f"{e.k}", 0.0),
    "an f-string with a format": lambda x, e: 3.0 * (f"{e.t:.0f}" == "50"),
    "format": lambda x, e: 3.0 * (format(e.t, ".1f") == "50.0"),
    "percent d": lambda x, e: 3.0 * ("%d" % e.k == "50"),  # noqa: UP031
    "percent s": lambda x, e: 3.0 * ("%s" % e.k == "50"),  # noqa: UP031
    "str.format": lambda x, e: 3.0 * ("{}".format(e.k) == "50"),  # noqa: UP032
    "repr": lambda x, e: 3.0 * (repr(e.k) == "50"),
    "json": lambda x, e: 3.0 * (json.dumps(e.k) == "50"),
    "array2string": lambda x, e: 3.0 * (np.array2string(np.asarray(e.t)) == "50."),
    "hash": lambda x, e: 3.0 * (hash(e.k) == 50),
    "hash, a remainder": lambda x, e: 0.1 * (hash(e.t) % 7),
    "a hash of a tuple": lambda x, e: 0.1 * (hash((e.k, 1)) % 7),
    "lru_cache of k": lambda x, e: cached(e.k),
    "lru_cache of t": lambda x, e: cached(e.t),
    "a table": lambda x, e: TABLE[e.k],
    "a table in a list": lambda x, e: TABLE_LIST[e.k],
    "a slice of a table": lambda x, e: 0.01 * TABLE[: e.k].sum(),
    "a table by time": lambda x, e: TABLE[int(e.t)],
    "take": lambda x, e: np.take(TABLE, e.k),
    "a string of flags": lambda x, e: 3.0 * (("0" * 50 + "1" + "0" * 29)[e.k] == "1"),
    "a floor division": lambda x, e: 0.1 * (e.t // 49),
    "a floor division of k": lambda x, e: 0.1 * (e.k // 49),
    "floor_divide": lambda x, e: 0.1 * np.floor_divide(e.t, 49),
    "a remainder": lambda x, e: 0.01 * (e.t % 7.3),
    "a remainder of tenths": lambda x, e: e.t % 0.1,
    "a remainder of a negative number": lambda x, e: 0.01 * (-e.t % 7.0),
    "a remainder of k": lambda x, e: np.where(e.k % 25 == 0, 1.0, 0.0),
    "fmod": lambda x, e: 0.01 * np.fmod(e.t, 7.3),
    "divmod, quotient": lambda x, e: 0.01 * divmod(e.t, 49.0)[0],
    "divmod, remainder": lambda x, e: 0.01 * divmod(e.t, 49.0)[1],
    "divmod of numpy": lambda x, e: 0.01 * np.divmod(e.t, 49.0)[0],
    "round": lambda x, e: 0.01 * round(e.t / 6),
    "round to digits": lambda x, e: 0.01 * round(e.t / 3, 1),
    "round of numpy": lambda x, e: 0.01 * np.round(e.t / 3, 1),
    "int": lambda x, e: 0.01 * int(e.t / 7),
    "float": lambda x, e: 0.01 * float(e.t),
    "float64": lambda x, e: 0.01 * np.float64(e.t),
    "bool": lambda x, e: 0.1 * bool(e.k > 60),
    "complex": lambda x, e: 0.01 * complex(e.t).real,
    "index": lambda x, e: 0.01 * operator.index(e.k),
    "bits": lambda x, e: 0.1 * (e.k & 1) + 0.1 * (e.k >> 5),
    "bit_count": lambda x, e: 0.1 * e.k.bit_count(),
    "is_integer": lambda x, e: 0.1 * (e.t / 2).is_integer(),
    "a branch": lambda x, e: 0.1 if e.t > 60 else 0.0,
    "a chain of comparisons": lambda x, e: 0.1 if 30 < e.t < 40 else 0.0,
    "and": lambda x, e: 0.1 * (e.t > 30 and e.t < 40),
    "or": lambda x, e: 0.01 * (e.k or 5),
    "not": lambda x, e: 0.1 * (not e.k > 40),
    "min and max": lambda x, e: 0.01 * min(max(e.t, 20.0), 60.0),
    "any": lambda x, e: 3.0 * any(e.k == k for k in (50, 51)),
    "a count of starts": lambda x, e: 0.1 * sum(1 for start in (20, 49) if e.t >= start),
    "next": lambda x, e: 0.1 * next(i for i in range(99) if i >= e.k / 20),
    "filter": lambda x, e: 0.1 * len(list(filter(lambda start: e.t > start, (20, 49)))),
    "sorted": lambda x, e: 0.01 * sorted([e.t, 50.0, 20.0])[1],
    "bisect": lambda x, e: 0.1 * bisect.bisect([20.0, 50.0], e.t),
    "searchsorted": lambda x, e: 0.1 * np.searchsorted([20.0, 50.0], e.t),
    "digitize": lambda x, e: 0.1 * np.digitize(e.t, [20.0, 50.0]),
    "interp": lambda x, e: 0.1 * np.interp(e.t, [0.0, 50.0, 80.0], [0.0, 1.0, -1.0]),
    "a spline": lambda x, e: SPLINE(e.t),
    "polyval": lambda x, e: 0.01 * np.polyval([1e-3, 1.0, 0.0], e.t),
    "math.sin": lambda x, e: 0.1 * math.sin(0.2 * e.t),
    "math.floor": lambda x, e: 0.1 * math.floor(e.t / 49),
    "math.isclose": lambda x, e: 3.0 * math.isclose(e.t, 50.0),
    "isclose": lambda x, e: 3.0 * np.isclose(e.t, 50.0),
    "allclose": lambda x, e: 3.0 * np.allclose(e.t, 50.0),
    "array_equal": lambda x, e: 3.0 * np.array_equal(e.k, 50),
    "heaviside": lambda x, e: 0.1 * np.heaviside(e.t - 60.0, 0.5),
    "select": lambda x, e: np.select([e.t < 20, e.t < 60], [0.1, 0.0], 0.2),
    "piecewise": lambda x, e: np.piecewise(e.t, [e.t < 20, e.t >= 60], [0.1, 0.2, 0.0]),
    "choose": lambda x, e: np.choose(e.k % 3, [0.1, 0.2, 0.3]),
    "a fraction": lambda x, e: float(fractions.Fraction(e.t) / 490),
    "a decimal": lambda x, e: float(decimal.Decimal(e.t) // 49) * 0.1,
    "a timedelta": lambda x, e: datetime.timedelta(seconds=e.t) / datetime.timedelta(hours=1),
    "an integer of numpy": lambda x, e: 0.1 * (np.asarray(e.t).astype(int) // 49),
    "single precision": lambda x, e: 0.01 * np.asarray(e.t, np.float32) / np.float32(7.0),
    "a comparison times a number": lambda x, e: 0.1 * (e.t > 60),
    "a comparison as an index": lambda x, e: (0.0, 0.1)[e.t > 60],
    "a comparison added": lambda x, e: 0.01 * ((e.t > 20) + (e.t > 60)),
    "the type of k": lambda x, e: 0.1 if type(e.k) is int else 0.0,
    "the type of t": lambda x, e: 0.1 if isinstance(e.t, float) else 0.0,
    "a type's name": lambda x, e: 0.01 * len(type(e.t).__name__),
    "the length of an epoch": lambda x, e: 0.01 * len(e),
    "an epoch as a tuple": lambda x, e: 0.001 * e[1],
    "an epoch as a dictionary": lambda x, e: 0.001 * e._asdict()["t"],
    "another epoch": lambda x, e: 0.001 * e._replace(t=e.t + 1.0).t,
    "a set of numbers": lambda x, e: 0.1 * len({e.k, 50}),
    "asarray": lambda x, e: 0.01 * np.asarray(e.t),
    "identity": lambda x, e: 3.0 * operator.is_(e.k, BURNS),
    "a match": matched,
    "any error caught": anything_caught,
    "a KeyError caught": key_error_caught,
    "an error of float caught": float_caught,
    "an error of a branch caught": comparison_caught,
    "a loop": looped,
    "a loop with a condition": looped_while,
    "a log": logged,
}
cases(EITHER, "time", push, TIME_BY_VALUE, **LINE)

# -- epochs of several kinds ---------------------------------------------------------------------
PAIRS = np.concatenate([POSITIONS, 1.0 + 0.5 * RNG.standard_normal(POSITIONS.shape)], -1)
GAPS = PAIRS.copy()
GAPS[[20, 50, 51]] = np.nan  # nothing is measured
GAPS[[33, 61], :, 1] = np.nan  # one component is missing
GAPS[47, 1, 0] = np.nan  # one run lacks one component
UNEVEN = np.cumsum(np.where(np.arange(T) == 50, 0.25, 1.0))
TRUTH = np.broadcast_to(TIMES[:, None, None], (T, RUNS, 2))
WITH_GAPS = {"prior": START, "times": TIMES, "z": GAPS}
WITH_NONE = [
    epoch._replace(z=None if epoch.k in (20, 50) else epoch.z)
    for epoch in celnav.epochs(TIMES, PAIRS)
]
GAPS_WHERE = {
    "nothing is measured": lambda x, e: np.where(e.k == 50, 1.0, 0.0),
    "a component is missing": lambda x, e: np.where(e.k == 33, 1.0, 0.0),
    "a run lacks a component": lambda x, e: np.where(e.k == 47, 1.0, 0.0),
}
GAPS_BY_VALUE = {
    "nothing is measured": lambda x, e: {50: 1.0}.get(e.k, 0.0),
    "a component is missing": lambda x, e: {33: 1.0, 61: 2.0}.get(e.k, 0.0),
    "a run lacks a component": lambda x, e: {47: 1.0}.get(e.k, 0.0),
    "epoch.z is missing": lambda x, e: np.where(np.isnan(e.z).any(), 1.0, 0.0),
    "epoch.z is missing, a branch": lambda x, e: 1.0 if np.isnan(e.z).any() else 0.0,
    "epoch.z, a component": lambda x, e: 0.01 * np.nan_to_num(e.z[..., 0]),
    "epoch.z, its length": lambda x, e: 0.01 * len(e.z),
    "epoch.z, its shape": lambda x, e: 0.01 * e.z.shape[-1],
}
NONE_BY_VALUE = {
    "epoch.z is None": lambda x, e: 1.0 if e.z is None else 0.0,
    "nothing is measured": lambda x, e: {50: 1.0}.get(e.k, 0.0),
    "epoch.about is None": lambda x, e: 0.1 if e.about is None else 0.0,
    "epoch.truth is None": lambda x, e: 0.1 if e.truth is None else 0.0,
    "epoch.u is None": lambda x, e: 0.1 if e.u is None else 0.0,
}
WITH_TRUTH = {
    "a component": lambda x, e: 0.01 * e.truth[..., 0],
    "a difference": lambda x, e: 0.001 * (x[..., 0] - e.truth[..., 0]),
    "float": lambda x, e: 0.001 * float(e.truth[0, 0]),
}
DT = {
    "a comparison": lambda x, e: np.where(e.dt < 0.5, 1.0, 0.0),
    "a quotient": lambda x, e: 0.1 * np.floor(e.dt / 0.25),
}
DT_BY_VALUE = {
    "a dictionary": lambda x, e: {0.25: 1.0}.get(e.dt, 0.0),
    "a branch": lambda x, e: 1.0 if e.dt < 0.5 else 0.0,
    "round": lambda x, e: 0.1 * round(e.dt),
    "steps": lambda x, e: sum(0.1 * e.dt / 4 for _ in range(math.ceil(e.dt * 4))),
    "a root of math": lambda x, e: 0.1 * math.sqrt(e.dt),
    "expm": lambda x, e: 0.1 * scipy.linalg.expm(F * e.dt)[0, 1],
    "a power of a matrix": lambda x, e: 0.1 * np.linalg.matrix_power(F, 1 + (e.dt < 0.5))[0, 1],
}
cases(EQUAL, "gaps", push_both, GAPS_WHERE, **WITH_GAPS)
cases(EITHER, "gaps by value", push_both, GAPS_BY_VALUE, **WITH_GAPS)
cases(EITHER, "epochs without z", push_both, NONE_BY_VALUE, prior=START, times=WITH_NONE)
cases(
    EITHER,
    "truth",
    push,
    WITH_TRUTH,
    prior=START,
    times=list(celnav.epochs(TIMES, POSITIONS, truth=TRUTH)),
)
cases(EQUAL, "dt", push, DT, prior=START, times=UNEVEN, z=POSITIONS)
cases(EITHER, "dt", push, DT_BY_VALUE, prior=START, times=UNEVEN, z=POSITIONS)

# -- nan -----------------------------------------------------------------------------------------
NAN = {
    "arccos": lambda x, e: np.where(np.isnan(np.arccos(x[..., 0] / 30)), 0.1, 0.0),
    "arcsin": lambda x, e: np.where(np.isnan(np.arcsin(x[..., 0] / 30)), 0.1, 0.0),
    "sqrt": lambda x, e: np.where(np.isnan(np.sqrt(x[..., 0] - 30)), 0.1, 0.0),
    "log": lambda x, e: np.where(np.isnan(np.log(x[..., 0] - 30)), 0.1, 0.0),
    "log1p": lambda x, e: np.where(np.isnan(np.log1p(-x[..., 0] / 30)), 0.1, 0.0),
    "arctanh": lambda x, e: np.where(np.isnan(np.arctanh(x[..., 0] / 30)), 0.1, 0.0),
    "arccosh": lambda x, e: np.where(np.isnan(np.arccosh(x[..., 0] / 30)), 0.1, 0.0),
    "a power": lambda x, e: np.where(np.isnan((30 - x[..., 0]) ** 0.5), 0.1, 0.0),
    "np.power": lambda x, e: np.where(np.isnan(np.power(30 - x[..., 0], 1.5)), 0.1, 0.0),
    "0 over 0": lambda x, e: np.where(np.isnan(over_itself(x)), 0.1, 0.0),
    "0 times infinity": lambda x, e: np.where(np.isnan(0.0 * np.exp(20 * x[..., 0])), 0.1, 0.0),
    "infinity minus infinity": lambda x, e: np.where(np.isnan(infinite(x) - infinite(x)), 0.1, 0.0),
    "the sine of infinity": lambda x, e: np.where(np.isnan(np.sin(infinite(x))), 0.1, 0.0),
    "a remainder": lambda x, e: np.where(
        np.isnan(np.mod(x[..., 0], np.maximum(30 - e.t, 0))), 0.1, 0.0
    ),
    "y == y": lambda x, e: np.where(root(x) == root(x), 0.1, 0.0),
    "y != y": lambda x, e: np.where(root(x) != root(x), 0.1, 0.0),
    "not y == y": lambda x, e: np.where(~(root(x) == root(x)), 0.1, 0.0),
    "y <= y": lambda x, e: np.where(root(x) <= root(x), 0.1, 0.0),
    "y - y == 0": lambda x, e: np.where(root(x) - root(x) == 0, 0.1, 0.0),
    "0 * y == 0": lambda x, e: np.where(0 * root(x) == 0, 0.1, 0.0),
    "y / y == 1": lambda x, e: np.where(root(x) / root(x) == 1, 0.1, 0.0),
    "y ** 0": lambda x, e: 0.1 * root(x) ** 0,
    "y > c": lambda x, e: np.where(root(x) > 1, 0.1, 0.0),
    "not y > c": lambda x, e: np.where(~(root(x) > 1), 0.1, 0.0),
    "y < c or y >= c": lambda x, e: np.where((root(x) < 1) | (root(x) >= 1), 0.1, 0.0),
    "isfinite": lambda x, e: np.where(np.isfinite(root(x)), 0.1, 0.0),
    "isinf": lambda x, e: np.where(np.isinf(np.exp(20 * x[..., 0])), 0.1, 0.0),
    "nan_to_num": lambda x, e: 0.01 * np.nan_to_num(root(x)),
    "nan_to_num with a number": lambda x, e: 0.01 * np.nan_to_num(root(x), nan=5.0),
    "where beside the other": lambda x, e: np.where(x[..., 0] > 30, 0.01 * root(x), 0.1),
    "fmax": lambda x, e: 0.01 * np.fmax(root(x), 0.5),
    "fmin": lambda x, e: 0.01 * np.fmin(root(x), 0.5),
    "maximum": lambda x, e: np.where(np.isnan(np.maximum(root(x), 0.5)), 0.1, 0.0),
    "minimum": lambda x, e: np.where(np.isnan(np.minimum(0.5, root(x))), 0.1, 0.0),
    "clip": lambda x, e: np.where(np.isnan(np.clip(root(x), 0.0, 1.0)), 0.1, 0.0),
    "sign": lambda x, e: np.where(np.isnan(np.sign(root(x))), 0.1, 0.0),
    "hypot of nan and infinity": lambda x, e: np.where(
        np.isinf(np.hypot(root(x), np.inf)), 0.1, 0.0
    ),
    "nansum": lambda x, e: 0.01 * np.nansum(np.stack([root(x), x[..., 1]], -1), -1),
    "nanmax": lambda x, e: 0.01 * np.nanmax(np.stack([root(x), x[..., 1]], -1), -1),
    "nanmean": lambda x, e: 0.01 * np.nanmean(np.stack([root(x), x[..., 1]], -1), -1),
    "any": lambda x, e: np.where(np.isnan(np.stack([root(x), x[..., 1]], -1)).any(-1), 0.1, 0.0),
    "all": lambda x, e: np.where(np.isfinite(np.stack([root(x), x[..., 1]], -1)).all(-1), 0.1, 0.0),
    "a branch": lambda x, e: 0.1 if np.isnan(root(x)).any() else 0.0,
    "a mask": lambda x, e: masked(0.01 * root(x)),
    "a masked array": lambda x, e: 0.01 * np.ma.masked_invalid(root(x)).filled(1.0),
    "a root of time": lambda x, e: np.where(np.isnan(np.sqrt(e.t - 40)), 0.1, 0.0),
    "a logarithm of time": lambda x, e: np.where(np.isinf(np.log(np.abs(e.t - 40))), 1.0, 0.0),
    "a power of time": lambda x, e: np.where(np.isnan(np.power(e.t - 40.0, 0.5)), 0.1, 0.0),
    "signbit": lambda x, e: 0.1 * np.signbit(-0.0 * x[..., 0]),
    "copysign": lambda x, e: 0.1 * np.copysign(1.0, 0.0 * (x[..., 0] - 30)),
    "a quotient by -0": lambda x, e: np.where(1 / (-0.0 * np.exp(x[..., 1])) < 0, 0.1, 0.0),
    "0 + -0": lambda x, e: 0.1 * np.copysign(1.0, -0.0 * np.exp(x[..., 1]) + 0.0),
    "arctan2 of zeros": lambda x, e: 0.1 * np.arctan2(0.0 * x[..., 1], -np.exp(x[..., 1])),
    "overflow that returns": lambda x, e: 0.1 / (1.0 + np.exp(30 * (x[..., 0] - 20))),
    "overflow in a where": lambda x, e: np.where(x[..., 0] < 20, 1e-9 * np.exp(x[..., 0]), 0.1),
    "an infinite limit": lambda x, e: 0.1 * np.tanh(np.minimum(np.exp(30 * x[..., 0]), np.inf)),
}


def root(x):
    """Missing before the target passes 30."""
    return np.sqrt(x[..., 0] - 30)


def infinite(x):
    """Infinite after the target passes 35."""
    return np.exp(20 * x[..., 0])


def over_itself(x):
    """0 / 0 before the target passes 30, 1 afterwards."""
    step = np.where(x[..., 0] > 30, 1.0, 0.0)
    return step / step


def masked(y):
    y = y.copy()
    y[np.isnan(y)] = 0.1
    return y


cases(EITHER, "nan", push, NAN, **LINE)

# -- inputs --------------------------------------------------------------------------------------
SHARED_U = 0.05 * RNG.standard_normal((T - 1, 1))
LATE_U = SHARED_U.copy()
LATE_U[60:63] = np.nan
RUN_U = 0.05 * RNG.standard_normal((T - 1, RUNS, 1))
RUN_LATE_U = RUN_U.copy()
RUN_LATE_U[60, 1] = np.nan
FLAG_U = np.where(np.arange(T - 1) == 60, 1.0, 0.0)[:, None]
NONE_U = [
    epoch._replace(u=None if epoch.k in (0, 40, 41) else epoch.u)
    for epoch in celnav.epochs(TIMES, POSITIONS, SHARED_U)
]
INPUT = {
    "a component": lambda x, e: e.u[..., 0],
    "a component of one vector": lambda x, e: e.u[0],
    "a sum": lambda x, e: e.u.sum(-1),
    "a comparison": lambda x, e: np.where(e.u[0] > 0, 0.1, 0.0),
}
INPUT_OF_RUNS = {
    "a component": lambda x, e: e.u[..., 0],
    "a comparison": lambda x, e: np.where(e.u[..., 0] > 0, 0.1, 0.0),
}
INPUT_NAN = {
    "isnan": lambda x, e: np.where(np.isnan(e.u[..., 0]), 0.5, 0.1),
    "where": lambda x, e: np.where(np.isnan(e.u[..., 0]), 0.5, e.u[..., 0]),
    "isfinite": lambda x, e: np.where(np.isfinite(e.u[..., 0]), e.u[..., 0], 0.5),
    "u == u": lambda x, e: np.where(e.u[..., 0] == e.u[..., 0], 0.0, 0.5),
    "nan_to_num": lambda x, e: np.nan_to_num(e.u[..., 0], nan=0.5),
    "nansum": lambda x, e: np.nansum(e.u, -1),
    "fmax": lambda x, e: np.fmax(e.u[..., 0], 0.02),
    "not u > 0": lambda x, e: np.where(~(e.u[..., 0] > 0), 0.1, 0.0),
    "a derived number": lambda x, e: np.where(np.isnan(2.0 * e.u[..., 0] + x[..., 1]), 0.5, 0.1),
    "any, a branch": lambda x, e: 0.5 if np.isnan(e.u).any() else 0.1,
    "any": lambda x, e: np.where(np.isnan(e.u).any(-1), 0.5, 0.1),
}
INPUT_BY_VALUE = {
    "a branch": lambda x, e: 1.0 if e.u[0] > 0.5 else 0.0,
    "or": lambda x, e: 0.1 * (e.u[0] or 0.5),
    "float": lambda x, e: 0.1 * float(e.u[0]),
    "int": lambda x, e: 0.1 * int(e.u[0]),
    "a table": lambda x, e: [0.0, 1.0][int(e.u[0])],
    "a table by astype": lambda x, e: np.array([0.0, 1.0])[e.u.astype(int)][0],
    "a dictionary": lambda x, e: {1.0: 1.0}.get(e.u[0], 0.0),
    "a set": lambda x, e: 1.0 * (e.u[0] in {1.0}),
    "tolist": lambda x, e: 0.1 * e.u.tolist()[0],
    "item": lambda x, e: 0.1 * e.u.item(),
    "tobytes": lambda x, e: 1.0 if e.u.tobytes() == np.array([1.0]).tobytes() else 0.0,
    "str": lambda x, e: 1.0 * (str(e.u[0]) == "1.0"),
    "any": lambda x, e: 1.0 * e.u.any(),
    "any of python": lambda x, e: 1.0 * any(e.u),
    "shape": lambda x, e: 0.1 * e.u.shape[0],
    "dtype": lambda x, e: 0.1 * (e.u.dtype == np.float64),
    "type": lambda x, e: 0.1 * (type(e.u) is np.ndarray),
    "len": lambda x, e: 0.1 * len(e.u),
    "count_nonzero": lambda x, e: 0.1 * np.count_nonzero(e.u),
    "argmax": lambda x, e: 0.1 * np.argmax([0.5, e.u[0]]),
    "a loop": lambda x, e: sum(0.1 * v for v in e.u),
}
INPUT_NONE = {
    "a branch": lambda x, e: 0.1 if e.u is None else e.u[0],
    "not a branch": lambda x, e: e.u[0] if e.u is not None else 0.1,
    "getattr": lambda x, e: 0.01 * getattr(e.u, "size", 5),
    "isinstance": lambda x, e: 0.1 if isinstance(e.u, np.ndarray) else 0.0,
}
MODES = np.where(np.arange(T - 1) == 60, "burn", "coast")
COUNTS = np.where(np.arange(T - 1) == 60, 2, 0)[:, None]
INPUT_COUNTS = {
    "a table": lambda x, e: TABLE[e.u[0]],
    "a shift": lambda x, e: 0.1 * (e.u[0] << 1),
    "range": lambda x, e: 0.1 * sum(range(e.u[0] + 1)),
    "a quotient": lambda x, e: 0.1 * (e.u[0] / 3),
    "a power": lambda x, e: 0.1 * 2 ** e.u[0],
}
cases(EQUAL, "input", push, INPUT, u=SHARED_U, **LINE)
cases(EQUAL, "input of runs", push, INPUT_OF_RUNS, u=RUN_U, **LINE)
OF_ALL_RUNS = {"any, a branch": INPUT_NAN.pop("any, a branch")}
cases(EITHER, "input, late nan", push, INPUT_NAN, u=LATE_U, **LINE)
cases(EITHER, "input, any nan", push, OF_ALL_RUNS, u=LATE_U, **LINE)
cases(COUPLED, "input of runs, any nan", push, OF_ALL_RUNS, u=RUN_LATE_U, **LINE)
cases(EITHER, "input of runs, late nan", push, INPUT_NAN, u=RUN_LATE_U, **LINE)
cases(EITHER, "input, a late flag", push, INPUT_BY_VALUE, u=FLAG_U, **LINE)
cases(EITHER, "input, None at times", push, INPUT_NONE, prior=START, times=NONE_U)
cases(
    EITHER,
    "input, words",
    push,
    {"compared": lambda x, e: 1.0 if e.u == "burn" else 0.0},
    u=MODES,
    **LINE,
)
cases(EITHER, "input, whole numbers", push, INPUT_COUNTS, u=COUNTS, **LINE)
cases(
    EITHER,
    "input, a tuple",
    push,
    {"unpacked": lambda x, e: e.u[0][0] + 0.1 * e.u[1][0]},
    u=(SHARED_U, FLAG_U),
    **LINE,
)


# -- models with memory --------------------------------------------------------------------------
def counter(act):
    """A model that counts its calls and depends on the count."""

    def make():
        calls = itertools.count()
        return lambda x, e: act(next(calls))

    return make


def counts_epochs():
    seen = set()

    def a(x, e):
        seen.add(float(e.t))
        return 0.1 * (len(seen) > 50)

    return a


def last_epoch():
    last = [0.0]

    def a(x, e):
        before, last[0] = last[0], e.t
        return 0.1 * (e.t - before)

    return a


def last_state():
    last = [0.0]

    def a(x, e):
        before, last[0] = last[0], x[..., 1]
        return 0.01 * np.mean(before)

    return a


def integral():
    total = [0.0]

    def a(x, e):
        total[0] = total[0] + e.dt
        return 0.01 * total[0]

    return a


def filtered():
    value = [0.0]

    def a(x, e):
        value[0] = 0.9 * value[0] + 0.1 * np.sin(e.t)
        return 0.1 * value[0]

    return a


def hysteresis():
    on = [False]

    def a(x, e):
        on[0] = np.mean(x[..., 0]) > (20 if on[0] else 40)
        return 0.1 * on[0]

    return a


def first_call():
    known = {}

    def a(x, e):
        return 0.01 * known.setdefault("dt", e.dt + e.k)

    return a


def cached_by_identity():
    known = {}

    def a(x, e):
        return known.setdefault(id(x), 0.01 * len(known))

    return a


def cached_by_epoch():
    known = {}

    def a(x, e):
        if e.k not in known:
            known[e.k] = 0.01 * np.mean(x[..., 1])
        return known[e.k]

    return a


def growing_list():
    calls = []

    def a(x, e):
        calls.append(e)
        return 1e-4 * len(calls)

    return a


def default_argument():
    def a(x, e, calls=[]):  # noqa: B006
        calls.append(0)
        return 0.1 * (len(calls) > 100)

    return a


def attribute():
    def a(x, e):
        a.calls += 1
        return 0.1 * (a.calls > 100)

    a.calls = 0
    return a


def generator():
    def values():
        yield from np.linspace(0.0, 0.1, 50)
        while True:
            yield 0.5

    return lambda x, e, values=values(): next(values)


def cycle():
    return lambda x, e, values=itertools.cycle([0.0, 0.1, -0.1]): next(values)


def queue():
    values = collections.deque([0.0] * 60 + [1.0] * 5000)
    return lambda x, e: 0.1 * values.popleft()


def noise_of_generator():
    rng = np.random.default_rng(1)
    return lambda x, e: 0.1 * rng.standard_normal(x.shape[:-1])


def noise_of_numpy():
    np.random.seed(1)  # noqa: NPY002
    return lambda x, e: 0.1 * np.random.rand()  # noqa: NPY002


def noise_of_python():
    rng = random.Random(1)
    return lambda x, e: 0.1 * rng.random()


def rare_noise():
    rng = random.Random(2)
    return lambda x, e: 1.0 * (rng.random() > 0.98)


def clock():
    return lambda x, e: 0.1 * (time.perf_counter_ns() % 1000) / 1000


SWITCH = {"on": 0.0}


def switch():
    SWITCH["on"] = 0.0
    calls = itertools.count()

    def a(x, e):
        if next(calls) == 100:
            SWITCH["on"] = 0.1
        return SWITCH["on"]

    return a


def random_sometimes():
    rng = np.random.default_rng(3)
    return lambda x, e: np.where(e.k > 40, 0.1 * rng.standard_normal(), 0.0)


MEMORIES = {
    "after 3 calls": counter(lambda n: 0.1 * (n >= 3)),
    "before 10 calls": counter(lambda n: 0.1 * (n < 10)),
    "each second call": counter(lambda n: 0.1 * (n % 2)),
    "each call a bit more": counter(lambda n: 1e-4 * n),
    "the last epoch": last_epoch,
    "the last state": last_state,
    "an integral": integral,
    "a filter inside": filtered,
    "hysteresis": hysteresis,
    "the first call": first_call,
    "a cache by id": cached_by_identity,
    "a cache by epoch": cached_by_epoch,
    "a list that grows": growing_list,
    "a generator": generator,
    "a cycle": cycle,
    "noise of a generator": noise_of_generator,
    "noise of numpy": noise_of_numpy,
    "noise of Python": noise_of_python,
    "noise at late epochs": random_sometimes,
    "a clock": clock,
}
HIDDEN_MEMORIES = {  # they have no effect at first
    "after 50 calls": counter(lambda n: 0.1 * (n >= 50)),
    "after 100 calls": counter(lambda n: 0.1 * (n >= 100)),
    "after 400 calls": counter(lambda n: 0.1 * (n >= 400)),
    "after 10,000 calls": counter(lambda n: 0.1 * (n >= 10_000)),
    "at call 20": counter(lambda n: 3.0 * (n == 20)),
    "at call 100": counter(lambda n: 3.0 * (n == 100)),
    "epochs counted": counts_epochs,
    "a default argument": default_argument,
    "an attribute": attribute,
    "a queue": queue,
    "rare noise": rare_noise,
    "a global switch": switch,
}
cases(MEMORY, "memory", push_fresh, MEMORIES, **LINE)
cases(HIDDEN, "hidden memory", push_fresh, HIDDEN_MEMORIES, **LINE)


# -- models that look at what they are given -----------------------------------------------------
def float_fails(x, e):
    try:
        float(x[0])
    except TypeError:
        return 0.1
    return 0.0


def branch_fails(x, e):
    try:
        return 0.1 if (x > 1e6).any() else 0.0
    except Exception:
        return 0.2


def write_fails(x, e):
    try:
        x[..., 0] = x[..., 0]
    except (ValueError, TypeError):
        return 0.1
    return 0.0


def number_of_warnings(x, e):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        np.sqrt(x[..., 0] - 30)
    return 0.1 * len(caught)


def raised_by_numpy(x, e):
    try:
        with np.errstate(invalid="raise"):
            np.sqrt(x[..., 0] - 30)
    except FloatingPointError:
        return 0.1
    return 0.0


LOOKS = {
    "type": lambda x, e: 0.1 if type(x) is np.ndarray else 0.0,
    "isinstance": lambda x, e: 0.1 if isinstance(x, np.ndarray) else 0.0,
    "dtype": lambda x, e: 0.1 if x.dtype == np.float64 else 0.0,
    "dtype.kind": lambda x, e: 0.1 * (x.dtype.kind == "f"),
    "itemsize": lambda x, e: 0.01 * x.itemsize,
    "ndim": lambda x, e: 0.01 * x.ndim,
    "np.ndim": lambda x, e: 0.1 if np.ndim(x) == 3 else 0.0,
    "the last length": lambda x, e: 0.01 * x.shape[-1],
    "nbytes": lambda x, e: 1e-4 * x.nbytes / x.size,
    "base": lambda x, e: 0.1 if x.base is None else 0.0,
    "hasattr": lambda x, e: 0.1 * hasattr(x, "__array_interface__"),
    "getattr": lambda x, e: 0.01 * getattr(x, "itemsize", 99),
    "the name of the type": lambda x, e: 0.01 * len(type(x).__name__),
    "isrealobj": lambda x, e: 0.1 * np.isrealobj(x),
    "result_type": lambda x, e: 0.1 * (np.result_type(x) == np.float64),
    "can_cast": lambda x, e: 0.1 * np.can_cast(x.dtype, np.float64),
    "finfo": lambda x, e: 1e15 * np.finfo(x.dtype).eps,
    "modules": lambda x, e: 0.1 * ("celnav" in sys.modules),
    "float, caught": float_fails,
    "a branch, caught": branch_fails,
    "a write, caught": write_fails,
    "warnings": number_of_warnings,
    "errors of numpy": raised_by_numpy,
}
cases(EITHER, "looks at", push, LOOKS, **LINE)
OTHERS_TOO = {
    "nditer": lambda x, e: np.array([2 * float(v) for v in np.nditer(x)]).reshape(x.shape)[..., 0],
    "flags": lambda x, e: 0.1 * x.flags.c_contiguous + 0.2 * x.flags.writeable,
    "strides": lambda x, e: 0.001 * x.strides[-1],
    "the number of points": lambda x, e: 0.01 * x.shape[0],
    "the number of runs": lambda x, e: 0.01 * x.shape[1],
    "len": lambda x, e: 0.01 * len(x),
    "size": lambda x, e: 0.001 * x.size,
    "shape": lambda x, e: 0.1 if x.shape == (5, RUNS, 2) else 0.0,
    "bytes": lambda x, e: 0.01 * (hash(x.tobytes()) % 7),
    "any number": lambda x, e: 0.1 if (x[..., 0] > 30).any() else 0.0,
    "all numbers": lambda x, e: 0.1 * np.all(x[..., 0] > e.t),
    "the largest number": lambda x, e: 0.001 * x.max(),
    "the mean of points": lambda x, e: 0.01 * (x[..., 1] - x[..., 1].mean(0)),
    "the mean of runs": lambda x, e: 0.01 * x[..., 1].mean(-1, keepdims=True),
    "a norm of everything": lambda x, e: 0.001 * np.linalg.norm(x),
    "a sum": lambda x, e: 0.001 * x.sum(),
    "a float of one number": lambda x, e: 0.001 * float(x.flat[0]),
    "allclose": lambda x, e: 0.1 if np.allclose(x, 0.0, atol=30.0) else 0.0,
    "a sum of runs' inputs": lambda x, e: 0.5 if np.isnan(e.u).any() else 0.1,
}
cases(COUPLED, "looks at all", push, OTHERS_TOO, u=RUN_LATE_U, **LINE)

# -- the surface of numpy ------------------------------------------------------------------------
TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
SPD = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.1], [0.0, 0.1, 3.0]])
GRID = np.linspace(-5.0, 5.0, 11)


def gram(x):
    """A positive definite matrix of each point."""
    return SPD + x[..., :, None] * x[..., None, :]


def filled(x, e):
    y = np.empty(x.shape[:-1])
    y[...] = x[..., 0] * x[..., 1]
    return y


def filled_by_component(x, e):
    y = np.empty_like(x)
    y[..., 0], y[..., 1], y[..., 2] = x[..., 1], x[..., 2], x[..., 0]
    return y @ TURN[0]


def filled_by_out(x, e):
    return np.multiply(x[..., 0], x[..., 1], out=np.empty(x.shape[:-1]))


def filled_where(x, e):
    return np.sqrt(x[..., 0], out=np.zeros(x.shape[:-1]), where=x[..., 0] > 0)


def masked_write(x, e):
    y = x[..., 0].copy()
    y[y < 0] = 0.5
    return y


def masked_sum(x, e):
    y = x[..., 0].copy()
    y[x[..., 1] > 0] += 1.0
    return y


def placed(x, e):
    y = x[..., 0].copy()
    np.place(y, y < 0, [0.5])
    return y


def put_by_mask(x, e):
    y = x[..., 0].copy()
    np.putmask(y, y < 0, 0.5)
    return y


def copied_where(x, e):
    y = x[..., 0].copy()
    np.copyto(y, 0.5, where=y < 0)
    return y


def added_at(x, e):
    y = np.zeros_like(x)
    np.add.at(y, (..., [0, 0, 1]), x)
    return y[..., 0]


def put_along(x, e):
    y = x.copy()
    np.put_along_axis(y, np.argmin(y, -1)[..., None], 0.5, -1)
    return y[..., 0]


def nonzero_write(x, e):
    y = x[..., 0].copy()
    y[np.nonzero(y < 0)] = 0.5
    return y


def looped_points(x, e):
    y = np.zeros(x.shape[:-1])
    for index in np.ndindex(y.shape):
        y[index] = math.sin(x[index][0]) if x[index][1] > 0 else 0.0
    return y


def looped_components(x, e):
    total = 0.0
    for i in range(x.shape[-1]):
        total = total + (i + 1) * x[..., i]
    return total


def newton(x, e):
    y = x[..., 0]
    for _ in range(5):
        y = y - (y - 0.5 * np.sin(y) - x[..., 0]) / (1 - 0.5 * np.cos(y))
    return y


def newton_until(x, e):
    y, step = x[..., 0], 1.0
    while np.abs(step).max() > 1e-13:
        step = (y - 0.5 * np.sin(y) - x[..., 0]) / (1 - 0.5 * np.cos(y))
        y = y - step
    return y


def tabulated(x, e):
    at = np.clip(np.floor(x[..., 0]) + 5, 0, 9).astype(int)
    return GRID[at] + (x[..., 0] - GRID[at]) * (GRID[at + 1] - GRID[at])


def rotated(x, e):
    turned = Rotation.from_rotvec(x.reshape(-1, 3)).apply([1.0, 0.0, 0.0])
    return turned[:, 1].reshape(x.shape[:-1])


def with_errstate(x, e):
    with np.errstate(all="ignore"):
        return np.where(x[..., 0] > 0, np.log(x[..., 0]), 0.0)


def in_single(x, e):
    return (x[..., 0].astype(np.float32) * np.float32(1.1)).astype(float)


PLAIN = {
    "arithmetic": lambda x, e: (x[..., 0] - 2 * x[..., 1]) * x[..., 2] / 3 + 1,
    "negative powers": lambda x, e: (2 + x[..., 0] ** 2) ** -1.5,
    "trigonometry": lambda x, e: np.sin(x[..., 0]) * np.cos(x[..., 1]) + np.tan(0.1 * x[..., 2]),
    "inverse trigonometry": lambda x, e: np.arctan2(x[..., 0], x[..., 1]) + np.arctan(x[..., 2]),
    "arcs of limited numbers": lambda x, e: (
        np.arcsin(np.tanh(x[..., 0])) + np.arccos(np.tanh(x[..., 1]))
    ),
    "hyperbolic functions": lambda x, e: np.tanh(x[..., 0]) + np.sinh(0.1 * x[..., 1]),
    "exp and log": lambda x, e: np.log(1 + np.exp(x[..., 0])) + np.expm1(-(x[..., 1] ** 2)),
    "log1p": lambda x, e: np.log1p(x[..., 0] ** 2),
    "roots": lambda x, e: np.sqrt(1 + x[..., 0] ** 2) + np.hypot(x[..., 1], x[..., 2]),
    "where": lambda x, e: np.where(x[..., 0] > 0.123, x[..., 1], -x[..., 2]),
    "nested where": lambda x, e: np.where(
        x[..., 0] > 1, 1.0, np.where(x[..., 0] < -1, -1.0, x[..., 0])
    ),
    "clip": lambda x, e: np.clip(x[..., 0], -1.0, 1.0),
    "clip of one side": lambda x, e: np.clip(x[..., 0], 0.0, None),
    "maximum": lambda x, e: np.maximum(x[..., 0], x[..., 1]),
    "abs and sign": lambda x, e: np.abs(x[..., 0]) * np.sign(x[..., 1]),
    "einsum": lambda x, e: np.einsum("...i,ij,...j->...", x, SPD, x),
    "matmul": lambda x, e: (x @ TURN.T)[..., 0],
    "matmul of a vector": lambda x, e: x @ TURN[0],
    "matrix times vector": lambda x, e: (TURN @ x[..., None])[..., 0, 0],
    "sum": lambda x, e: (x**2).sum(-1),
    "mean": lambda x, e: x.mean(-1),
    "norm": lambda x, e: np.linalg.norm(x, axis=-1),
    "a cross product": lambda x, e: np.cross(x, [1.0, 2.0, 3.0])[..., 0],
    "stack": lambda x, e: np.stack([x[..., 1], x[..., 0]], -1)[..., 0],
    "concatenate": lambda x, e: np.concatenate([x[..., 1:], x[..., :1]], -1)[..., 1],
    "a fancy index": lambda x, e: x[..., [2, 0, 1]][..., 1],
    "a slice backward": lambda x, e: x[..., ::-1][..., 0],
    "zeros_like": lambda x, e: np.zeros_like(x)[..., 0] + x[..., 1],
    "ones_like": lambda x, e: (x * np.ones_like(x))[..., 1],
    "a Python sum": lambda x, e: sum(x[..., i] for i in range(3)),
    "a list of components": lambda x, e: np.stack([np.sin(x[..., i]) for i in range(3)], -1).sum(
        -1
    ),
    "newaxis and squeeze": lambda x, e: x[..., None, :][..., 0, 1],
    "copy": lambda x, e: x.copy()[..., 1],
    "a loop over components": looped_components,
    "Newton's method": newton,
    "floor": lambda x, e: np.floor(10 * x[..., 0]),
    "a tree of functions": lambda x, e: functools.reduce(np.add, [x[..., 0], x[..., 1], 1.0]),
}
SURFACE = {
    "select": lambda x, e: np.select([x[..., 0] < -1, x[..., 0] < 1], [x[..., 1], 0.5], 2.0),
    "piecewise": lambda x, e: np.piecewise(x[..., 0], [x[..., 0] < 0], [lambda v: -v, 1.0]),
    "interp": lambda x, e: np.interp(x[..., 0], GRID, np.sin(GRID)),
    "a spline": lambda x, e: SPLINE(x[..., 0]),
    "sort": lambda x, e: np.sort(x, -1)[..., 0],
    "sort in place": lambda x, e: [y := x.copy(), y.sort(-1)][0][..., 2],
    "partition": lambda x, e: np.partition(x, 1, -1)[..., 1],
    "median": lambda x, e: np.median(x, -1),
    "quantile": lambda x, e: np.quantile(x, 0.3, axis=-1),
    "argsort": lambda x, e: np.argsort(x, -1)[..., 0],
    "argmax": lambda x, e: np.argmax(x, -1),
    "argmin of x": lambda x, e: x.argmin(-1),
    "take_along_axis": lambda x, e: np.take_along_axis(x, np.argsort(x, -1), -1)[..., 1],
    "searchsorted": lambda x, e: np.searchsorted(GRID, x[..., 0]),
    "digitize": lambda x, e: np.digitize(x[..., 0], GRID),
    "choose": lambda x, e: np.choose((x[..., 0] > 0).astype(int), [x[..., 1], x[..., 2]]),
    "heaviside": lambda x, e: np.heaviside(x[..., 0], 0.5),
    "fmod": lambda x, e: np.fmod(x[..., 0], 0.7),
    "mod": lambda x, e: np.mod(x[..., 0], 0.7),
    "percent": lambda x, e: x[..., 0] % 0.7,
    "a wrapped angle": lambda x, e: (x[..., 0] + np.pi) % (2 * np.pi) - np.pi,
    "floor division": lambda x, e: x[..., 0] // 0.7,
    "divmod": lambda x, e: divmod(x[..., 0], 0.7)[1],
    "modf": lambda x, e: np.modf(x[..., 0])[0],
    "frexp": lambda x, e: np.frexp(x[..., 0])[0],
    "ldexp": lambda x, e: np.ldexp(x[..., 0], 3),
    "rint": lambda x, e: np.rint(x[..., 0]),
    "round": lambda x, e: np.round(x[..., 0], 1),
    "fix": lambda x, e: np.fix(x[..., 0]),
    "trunc": lambda x, e: np.trunc(3 * x[..., 0]),
    "logaddexp": lambda x, e: np.logaddexp(x[..., 0], x[..., 1]),
    "logaddexp2": lambda x, e: np.logaddexp2(x[..., 0], x[..., 1]),
    "log2 and log10": lambda x, e: np.log2(1 + x[..., 0] ** 2) + np.log10(1 + x[..., 1] ** 2),
    "exp2": lambda x, e: np.exp2(x[..., 0]),
    "cbrt": lambda x, e: np.cbrt(x[..., 0]),
    "float_power": lambda x, e: np.float_power(np.abs(x[..., 0]), 1.5),
    "a power of a power": lambda x, e: np.abs(x[..., 0]) ** x[..., 1],
    "a power of a constant": lambda x, e: 2.0 ** x[..., 0],
    "reciprocal": lambda x, e: np.reciprocal(2 + x[..., 0] ** 2),
    "copysign": lambda x, e: np.copysign(x[..., 0], x[..., 1]),
    "signbit": lambda x, e: np.signbit(x[..., 0]),
    "arccosh and arctanh": lambda x, e: (
        np.arccosh(1 + x[..., 0] ** 2) + np.arctanh(0.1 * np.tanh(x[..., 1]))
    ),
    "arcsinh": lambda x, e: np.arcsinh(x[..., 0]),
    "sinc": lambda x, e: np.sinc(x[..., 0]),
    "i0": lambda x, e: np.i0(x[..., 0]),
    "degrees": lambda x, e: np.degrees(x[..., 0]) + np.deg2rad(x[..., 1]),
    "nextafter": lambda x, e: np.nextafter(x[..., 0], 9.0),
    "erf": lambda x, e: scipy.special.erf(x[..., 0]),
    "expit": lambda x, e: scipy.special.expit(x[..., 0]),
    "logsumexp": lambda x, e: scipy.special.logsumexp(x, axis=-1),
    "polyval": lambda x, e: np.polyval([0.1, -1.0, 0.5], x[..., 0]),
    "chebval": lambda x, e: np.polynomial.chebyshev.chebval(0.1 * x[..., 0], [1.0, 0.5, 0.2]),
    "a polynomial": lambda x, e: np.polynomial.Polynomial([0.5, -1.0, 0.1])(x[..., 0]),
    "inv": lambda x, e: np.linalg.inv(gram(x))[..., 0, 1],
    "solve": lambda x, e: np.linalg.solve(gram(x), x[..., None])[..., 0, 0],
    "det": lambda x, e: np.linalg.det(gram(x)),
    "slogdet": lambda x, e: np.linalg.slogdet(gram(x))[1],
    "cholesky": lambda x, e: np.linalg.cholesky(gram(x))[..., 2, 1],
    "qr": lambda x, e: np.linalg.qr(gram(x))[1][..., 0, 0],
    "svd": lambda x, e: np.linalg.svd(gram(x), compute_uv=False)[..., 0],
    "eigvalsh": lambda x, e: np.linalg.eigvalsh(gram(x))[..., -1],
    "eigh": lambda x, e: np.linalg.eigh(gram(x))[0][..., 0],
    "pinv": lambda x, e: np.linalg.pinv(gram(x))[..., 0, 1],
    "matrix_power": lambda x, e: np.linalg.matrix_power(0.1 * gram(x), 3)[..., 0, 1],
    "inv of a constant": lambda x, e: (np.linalg.inv(SPD) @ x[..., None])[..., 0, 0],
    "expm": lambda x, e: scipy.linalg.expm(0.1 * gram(x))[..., 0, 1],
    "norm of all kinds": lambda x, e: (
        np.linalg.norm(x, ord=1, axis=-1) + np.linalg.norm(x, np.inf, -1)
    ),
    "norm, kept": lambda x, e: (x / np.linalg.norm(x, axis=-1, keepdims=True))[..., 0],
    "vector_norm": lambda x, e: np.linalg.vector_norm(x, axis=-1),
    "vecdot": lambda x, e: np.vecdot(x, TURN[0]),
    "matvec": lambda x, e: np.matvec(TURN, x)[..., 0],
    "dot": lambda x, e: np.dot(x, TURN.T)[..., 0],
    "x.dot": lambda x, e: x.dot(TURN[0]),
    "inner": lambda x, e: np.inner(x, TURN)[..., 0],
    "tensordot": lambda x, e: np.tensordot(x, TURN, (-1, 1))[..., 0],
    "outer": lambda x, e: (x[..., :, None] * x[..., None, :])[..., 0, 1],
    "kron": lambda x, e: x @ np.kron(np.eye(1), TURN)[0],
    "einsum of indices": lambda x, e: np.einsum("ij,...j->...i", TURN, x)[..., 0],
    "einsum with optimize": lambda x, e: np.einsum("ij,...j->...i", TURN, x, optimize=True)[..., 0],
    "trace": lambda x, e: np.trace(gram(x), axis1=-2, axis2=-1),
    "diagonal": lambda x, e: np.diagonal(gram(x), axis1=-2, axis2=-1).sum(-1),
    "triu": lambda x, e: np.triu(gram(x)).sum((-2, -1)),
    "a cross product of points": lambda x, e: np.cross(x, x @ TURN.T)[..., 2],
    "cumsum": lambda x, e: np.cumsum(x, -1)[..., 1],
    "cumprod": lambda x, e: x.cumprod(-1)[..., 2],
    "diff": lambda x, e: np.diff(x, axis=-1)[..., 0],
    "gradient": lambda x, e: np.gradient(x, axis=-1)[..., 1],
    "trapezoid": lambda x, e: np.trapezoid(x, axis=-1),
    "roll": lambda x, e: np.roll(x, 1, -1)[..., 0],
    "flip": lambda x, e: np.flip(x, -1)[..., 0],
    "unwrap": lambda x, e: np.unwrap(3 * x, axis=-1)[..., 2],
    "prod": lambda x, e: np.prod(x, -1),
    "max and min": lambda x, e: x.max(-1) - np.min(x, -1),
    "ptp": lambda x, e: np.ptp(x, -1),
    "var and std": lambda x, e: np.var(x, -1) + x.std(-1),
    "average": lambda x, e: np.average(x, -1, weights=[1.0, 2.0, 3.0]),
    "maximum.reduce": lambda x, e: np.maximum.reduce(x, axis=-1),
    "minimum.accumulate": lambda x, e: np.minimum.accumulate(x, axis=-1)[..., 1],
    "add.reduce": lambda x, e: np.add.reduce(x, axis=-1),
    "multiply.outer": lambda x, e: np.multiply.outer(x[..., 0], [1.0, 2.0])[..., 1],
    "add.at": added_at,
    "any and all": lambda x, e: (x > 0).any(-1) + 0.5 * np.all(x > 0, -1),
    "count_nonzero": lambda x, e: np.count_nonzero(x > 0, axis=-1),
    "logical functions": lambda x, e: np.logical_xor(x[..., 0] > 0, x[..., 1] > 0),
    "a sum of comparisons": lambda x, e: (x > 0).sum(-1),
    "a mean of comparisons": lambda x, e: (x > 0).mean(-1),
    "a comparison as a number": lambda x, e: (x[..., 0] > 0) * x[..., 1],
    "a comparison as float": lambda x, e: (x[..., 0] > 0).astype(float),
    "vectorize": lambda x, e: np.vectorize(math.sin)(x[..., 0]),
    "vectorize with a branch": lambda x, e: np.vectorize(lambda v: v if v > 0 else 0.5)(x[..., 0]),
    "vectorize with a signature": lambda x, e: np.vectorize(
        lambda v: v[0] * v[1], signature="(n)->()"
    )(x),
    "frompyfunc": lambda x, e: np.frompyfunc(lambda v: 2.0 * v, 1, 1)(x[..., 0]).astype(float),
    "apply_along_axis": lambda x, e: np.apply_along_axis(lambda v: v[0] * v[1], -1, x),
    "apply_over_axes": lambda x, e: np.apply_over_axes(np.sum, x, [-1])[..., 0],
    "a comprehension over points": lambda x, e: np.array([p[..., 0] * 2 for p in x]),
    "a map": lambda x, e: np.stack(list(map(np.sin, [x[..., 0], x[..., 1]])), -1).sum(-1),
    "unpacked components": lambda x, e: (lambda a, b, c: a * b + c)(*np.moveaxis(x, -1, 0)),
    "unpacked by T": lambda x, e: (lambda a, b, c: a * b + c)(*x.T).T,
    "moveaxis": lambda x, e: np.moveaxis(x, -1, 0)[1],
    "rollaxis": lambda x, e: np.rollaxis(x, -1)[1],
    "swapaxes": lambda x, e: np.swapaxes(x, -1, 0)[1].T,
    "transpose": lambda x, e: x.T[1].T,
    "reshape": lambda x, e: x.reshape(-1, 3)[:, 1].reshape(x.shape[:-1]),
    "ravel": lambda x, e: x[..., 1].ravel().reshape(x.shape[:-1]),
    "squeeze": lambda x, e: np.squeeze(x[..., 1:2], -1),
    "expand_dims": lambda x, e: np.expand_dims(x[..., 1], -1).sum(-1),
    "atleast_2d": lambda x, e: np.atleast_2d(x)[..., 1],
    "broadcast_to": lambda x, e: np.broadcast_to(x[..., :1], x.shape).sum(-1),
    "broadcast_arrays": lambda x, e: np.broadcast_arrays(x[..., :1], x)[0].sum(-1),
    "tile": lambda x, e: np.tile(x[..., :1], 3).sum(-1),
    "repeat": lambda x, e: np.repeat(x, 2, -1)[..., 3],
    "pad": lambda x, e: np.pad(x, [(0, 0)] * (x.ndim - 1) + [(1, 0)])[..., 1],
    "split": lambda x, e: np.split(x, 3, -1)[1][..., 0],
    "hsplit of a list": lambda x, e: np.array_split(x, [1], axis=-1)[1][..., 0],
    "dstack": lambda x, e: np.dstack([x[..., 0], x[..., 1]])[..., 1].reshape(x.shape[:-1]),
    "append": lambda x, e: np.append(x, x[..., :1], -1)[..., 3],
    "delete": lambda x, e: np.delete(x, 0, -1)[..., 0],
    "insert": lambda x, e: np.insert(x, 1, 0.5, -1)[..., 2],
    "c_": lambda x, e: np.c_[x[..., :1], x[..., 1:]][..., 1],
    "block": lambda x, e: np.block([x[..., :1], x[..., 1:]])[..., 1],
    "take": lambda x, e: np.take(x, 1, -1) + x.take([0], -1)[..., 0],
    "compress": lambda x, e: np.compress([False, True, False], x, -1)[..., 0],
    "a constant mask": lambda x, e: x[..., np.array([False, True, False])][..., 0],
    "ix_": lambda x, e: gram(x)[..., *np.ix_([0, 1], [1, 2])][..., 0, 0],
    "a window view": lambda x, e: np.lib.stride_tricks.sliding_window_view(x, 2, -1).sum((-1, -2)),
    "full_like": lambda x, e: np.full_like(x, 0.5)[..., 0] * x[..., 1],
    "full": lambda x, e: np.full(x.shape[:-1], 0.5) * x[..., 1],
    "zeros of a shape": lambda x, e: np.zeros(x.shape[:-1]) + x[..., 1],
    "an array of arrays": lambda x, e: np.array([x[..., 0], x[..., 1]])[1],
    "asarray": lambda x, e: np.asarray(x)[..., 1] + np.ascontiguousarray(x)[..., 0],
    "np.array": lambda x, e: np.array(x, dtype=float)[..., 1],
    "x.astype": lambda x, e: x.astype(np.float64)[..., 1],
    "filled": filled,
    "filled by component": filled_by_component,
    "filled by out": filled_by_out,
    "filled where": filled_where,
    "a masked write": masked_write,
    "a masked sum": masked_sum,
    "a mask by nonzero": nonzero_write,
    "a masked read": lambda x, e: x[..., 0] + 0 * x[..., 0][x[..., 0] > 1e9].sum(),
    "place": placed,
    "putmask": put_by_mask,
    "put_along_axis": put_along,
    "copyto": copied_where,
    "where with one argument": lambda x, e: x[..., 0] + 0.0 * len(np.where(x > 1e9)[0]),
    "a loop over points": looped_points,
    "a loop until": newton_until,
    "a table": tabulated,
    "an integer": lambda x, e: x[..., 0].astype(int),
    "an integer of 8 bits": lambda x, e: (10 * x[..., 0]).astype(np.int8),
    "single precision": in_single,
    "single precision throughout": lambda x, e: np.sin(x.astype(np.float32))[..., 0],
    "half precision": lambda x, e: x[..., 0].astype(np.float16),
    "long double": lambda x, e: x[..., 0].astype(np.longdouble).astype(float),
    "view of bits": lambda x, e: (np.ascontiguousarray(x).view(np.int64)[..., 0] >> 52) * 0.01,
    "complex": lambda x, e: np.abs(x[..., 0] + 1j * x[..., 1]),
    "an angle of a complex number": lambda x, e: np.angle(x[..., 0] + 1j * x[..., 1]),
    "a complex exponential": lambda x, e: (np.exp(1j * x[..., 0]) * 1j).real,
    "conj and real": lambda x, e: np.real(np.conj(x[..., 0])) + x.imag[..., 0],
    "a complex root": lambda x, e: np.emath.sqrt(x[..., 0] - 9.0).imag,
    "fft": lambda x, e: np.abs(np.fft.fft(x, axis=-1))[..., 1],
    "convolve": lambda x, e: np.stack([x[..., 0], x[..., 1]], -1) @ np.convolve([1.0], [1.0, 0.5]),
    "statistics": lambda x, e: statistics.fmean([1.0, 2.0]) * x[..., 0],
    "math.sin": lambda x, e: 0.1 * math.sin(x.flat[0]) * 0.0 + x[..., 0],
    "a float": lambda x, e: 0.0 * float(x.flat[0]) + x[..., 0],
    "tolist": lambda x, e: np.array(x.tolist())[..., 0],
    "a rotation": rotated,
    "abs and pow": lambda x, e: pow(abs(x[..., 0]), 2),
    "max of Python": lambda x, e: np.stack([max(1.0, 2.0) * x[..., 0]], -1)[..., 0],
    "operator": lambda x, e: operator.mul(operator.itemgetter((..., 0))(x), 2.0),
    "errstate": with_errstate,
    "in place on a copy": lambda x, e: np.add(x, 1.0, out=x.copy())[..., 0],
    "augmented assignment": lambda x, e: [y := x[..., 0].copy(), y.__iadd__(x[..., 1])][0],
    "unique": lambda x, e: 0.0 * np.unique(x).size + x[..., 0],
    "histogram": lambda x, e: 0.0 * np.histogram(x)[0].sum() + x[..., 0],
    "isclose": lambda x, e: np.isclose(x[..., 0], x[..., 1], atol=0.5),
    "fabs and square": lambda x, e: np.fabs(x[..., 0]) + np.square(x[..., 1]),
    "positive and negative": lambda x, e: np.positive(x[..., 0]) + np.negative(x[..., 1]),
    "subtract and divide": lambda x, e: np.subtract(x[..., 0], np.divide(x[..., 1], 3)),
    "remainder by a state": lambda x, e: np.remainder(x[..., 0], 1 + x[..., 1] ** 2),
    "a matrix": lambda x, e: np.asarray(np.asmatrix(TURN[:1]) @ TURN)[0] @ x[..., None] @ [1.0],
    "ldexp of time": lambda x, e: np.ldexp(1.0, -2) * x[..., 0] + 0.0 * e.t,
}
cases(EQUAL, "numpy", bend, PLAIN, **THREE)
cases(EITHER, "numpy", bend, SURFACE, **THREE)

# -- rounding ------------------------------------------------------------------------------------
# A clock that is known exactly counts in the second state: each point has the same whole number.
STILL = celnav.Gaussian([0.0, 0.0], np.diag([4.0, 0.0]))


def counting(step, a):
    def f(x, epoch):
        clock = x[..., 1] + step
        return np.stack([x[..., 0] + a(x[..., 1]), clock], -1)

    return f


def by_clock(f):
    return celnav.ukf(celnav.Motion(f, np.diag([0.01, 0.0])), GPS)


CLOCKS = {
    "floor of c / 49": counting(49.0, lambda c: np.floor(c / 49) - c / 49),
    "ceil of c / 49": counting(49.0, lambda c: np.ceil(c / 49) - c / 49),
    "c / 49 >= k": counting(49.0, lambda c: np.where(c / 49 >= np.rint(c / 49), 0.1, 0.0)),
    "floor of c / 0.1": counting(0.1, lambda c: 0.1 * np.sin(np.floor(c / 0.1))),
    "rint of c / 6": counting(3.0, lambda c: 0.1 * np.sin(np.rint(c / 6))),
    "c % 0.1": counting(0.1, lambda c: c % 0.1),
    "c == 50": counting(1.0, lambda c: np.where(c == 50.0, 1.0, 0.0)),
    "c > 50": counting(1.0, lambda c: np.where(c > 50.0, 0.1, 0.0)),
    "c >= 50": counting(1.0, lambda c: np.where(c >= 50.0, 0.1, 0.0)),
    "a sum of tenths at 5": counting(0.1, lambda c: np.where(c >= 5.0, 0.1, 0.0)),
    "a sum of thirds": counting(1 / 3, lambda c: np.where(c * 3 >= np.rint(c * 3), 0.1, 0.0)),
    "the root of a square": counting(1.0, lambda c: np.where(np.sqrt(c * c) == c, 0.1, 0.0)),
    "a square by a power": counting(0.1, lambda c: np.where(c**2 == c * c, 0.1, 0.0)),
    "a root by a power": counting(0.1, lambda c: np.where(c**0.5 == np.sqrt(c), 0.1, 0.0)),
    "the sum of squares": counting(0.1, lambda c: np.where(c * c + c * c == 2 * c * c, 0.1, 0.0)),
    "a product and a sum": counting(
        0.1, lambda c: np.where(c * 0.1 + 0.1 == 0.1 * (c + 1), 0.1, 0.0)
    ),
    "a difference of products": counting(0.1, lambda c: 1e15 * (c * c - c * c)),
    "a fused product": counting(0.1, lambda c: 1e15 * (c * 0.1 - 0.1 * c)),
    "an order of sums": counting(0.1, lambda c: 1e15 * ((c + 1.0) - c - 1.0)),
    "a quotient and its product": counting(0.1, lambda c: 1e15 * (c / 0.7 * 0.7 - c)),
    "3 * (c / 3)": counting(1.0, lambda c: np.where(3 * (c / 3) == c, 0.1, 0.0)),
    "hypot of 3 and 4": counting(
        1.0, lambda c: np.where(np.hypot(3 * c, 4 * c) == 5 * c, 0.1, 0.0)
    ),
}
BESIDE = 1e-9  # a branch that the last bit of a power or a logarithm decides is nobody's to promise
CLOCKS |= {
    "a cube": counting(0.1, lambda c: np.where(c**3 > c * c * c - BESIDE, 0.1, 0.0)),
    "exp of log": counting(1.0, lambda c: np.where(np.exp(np.log(c + 1)) > c + BESIDE, 0.1, 0.0)),
    "floor of a logarithm": counting(
        1.0, lambda c: 0.1 * np.floor(np.log(c + 1) / np.log(3.0) + BESIDE)
    ),
    "floor of log10": counting(
        1.0, lambda c: 0.1 * np.floor(np.log10(10.0 ** np.floor(c / 9)) + BESIDE)
    ),
    "tanh near 1": counting(1.0, lambda c: np.where(np.tanh(c) > 1.0 - BESIDE, 0.1, 0.0)),
    "sin of whole turns": counting(1.0, lambda c: np.where(np.sin(np.pi * c) > BESIDE, 0.1, 0.0)),
}
cases(EITHER, "rounding of a clock", by_clock, CLOCKS, prior=STILL, times=TIMES, z=WALK[:, :3])

ROUNDING = {
    "x / 3 in a floor": lambda x, e: 0.1 * np.floor(x[..., 0] / 3.0),
    "x / 49 in a comparison": lambda x, e: np.where(x[..., 0] / 49 > 0.02, 0.1, 0.0),
    "x * 0.1 in rint": lambda x, e: 0.01 * np.rint(x[..., 0] * 10.0),
    "hypot of huge numbers": lambda x, e: np.hypot(1e200 * x[..., 0], 1e200) / 1e202,
    "hypot of tiny numbers": lambda x, e: np.hypot(1e-200 * x[..., 0], 1e-200) * 1e198,
    "a square that overflows": lambda x, e: np.where(np.isinf((1e160 * x[..., 0]) ** 2), 0.1, 0.0),
    "a product that overflows": lambda x, e: 0.1 * np.tanh(1e200 * x[..., 0] * 1e200 * 1e-300),
    "a product that underflows": lambda x, e: x[..., 0] * 1e-200 * 1e-200 * 1e300 * 1e98,
    "denormal numbers": lambda x, e: np.where(x[..., 0] * 1e-310 > 0, 0.1, 0.0),
    "a large power": lambda x, e: 0.1 * np.tanh((0.02 * x[..., 0]) ** 20),
    "a power of a negative number": lambda x, e: 1e-4 * (x[..., 0] - 30.0) ** 3,
    "a power that is not whole": lambda x, e: np.where(
        np.isnan((x[..., 0] - 30) ** (1 / 3)), 0.1, 0.0
    ),
    "a large number added": lambda x, e: (x[..., 0] + 1e12) - 1e12 - x[..., 0],
    "cancellation": lambda x, e: 0.1 * (1 - np.cos(1e-5 * x[..., 0])) / 1e-8,
    "sin of large numbers": lambda x, e: 0.1 * np.sin(1e6 * e.t),
    "tan near a pole": lambda x, e: 0.1 * np.tanh(1e-3 * np.tan(0.5 * np.pi * (1 + 1e-9 * e.t))),
    "a threshold of time": lambda x, e: np.where(0.1 * e.t >= 0.3, 0.1, 0.0),
    "a sum of a constant": lambda x, e: np.where(0.1 + 0.2 > 0.3, 0.1, 0.0) * (1.0 + 0.0 * e.t),
    "exp of large numbers": lambda x, e: 0.1 / (1 + np.exp(-40 * (x[..., 1] - 1))),
    "a steep switch": lambda x, e: 0.1 * np.tanh(1e6 * (x[..., 1] - 1.0)),
    "a threshold at the prior's mean": lambda x, e: np.where(x[..., 1] >= 1.0, 0.1, 0.0),
    "a threshold at the prior's mean, strictly": lambda x, e: np.where(x[..., 1] > 1.0, 0.1, 0.0),
}
cases(EITHER, "rounding", push, ROUNDING, **LINE)

# -- noises that are functions -------------------------------------------------------------------
Q_RUNS = np.array([1.0, 2.0, 3.0])[:, None, None] * Q
R_RUNS = np.array([1.0, 2.0, 3.0])[:, None, None]


def shared_buffer(make):
    """A function that returns the same array at each call, filled anew."""

    def fresh():
        buffer = np.zeros((2, 2))

        def noise(mean, epoch):
            buffer[0, 0] = 0.01 + 0.001 * epoch.k
            buffer[1, 1] = 0.01
            return buffer

        return noise

    return make(fresh())


def filled_noise(mean, epoch):
    noise = np.zeros((2, 2))
    noise[0, 0] = 0.01 + 0.001 * epoch.t
    noise[1, 1] = 0.01
    return noise


def filled_of_mean(mean, epoch):
    noise = np.zeros((*mean.shape[:-1], 2, 2))
    noise[..., 0, 0] = 0.01 + 0.001 * mean[..., 1] ** 2
    noise[..., 1, 1] = 0.01
    return noise


def white_jerk(mean, epoch):
    return 0.1 * np.array([[epoch.dt**3 / 3, epoch.dt**2 / 2], [epoch.dt**2 / 2, epoch.dt]])


def van_loan(mean, epoch):
    block = np.block([[-F, 0.01 * np.eye(2)], [np.zeros((2, 2)), F.T]]) * epoch.dt
    big = scipy.linalg.expm(block)
    return big[2:, 2:].T @ big[:2, 2:] + 0.01 * np.eye(2)


Q_EQUAL = {
    "a window": lambda m, e: Q * np.where(e.k == 50, 100.0, 1.0),
    "late": lambda m, e: Q * np.where(e.t > 60, 100.0, 1.0),
    "each 25th": lambda m, e: Q * (1 + 50 * (np.floor(e.t / 25) * 25 == e.t)),
    "of the mean": lambda m, e: Q * (1 + 0.01 * m[..., 0, None, None] ** 2),
    "of the mean, a branch": lambda m, e: Q * np.where(m[..., 0, None, None] > 30, 100.0, 1.0),
    "a constant": lambda m, e: Q,
    "dt": lambda m, e: Q * e.dt,
    "white jerk": white_jerk,
}
Q_EITHER = {
    "a dictionary": lambda m, e: Q * {50: 100.0}.get(e.k, 1.0),
    "a set": lambda m, e: Q * (100.0 if e.k in {50} else 1.0),
    "a branch": lambda m, e: 100 * Q if e.t > 60 else Q,
    "a table": lambda m, e: Q * (2 + TABLE[e.k]),
    "a list of matrices": lambda m, e: [Q, 2 * Q, 3 * Q][e.k % 3],
    "a matrix for each run": lambda m, e: Q_RUNS,
    "a matrix for each run and time": lambda m, e: Q_RUNS * (1 + 0.1 * e.t),
    "a matrix for each run and mean": lambda m, e: Q_RUNS * (1 + m[..., 0, None, None] ** 2),
    "filled": filled_noise,
    "filled by mean": filled_of_mean,
    "Van Loan's method": van_loan,
    "block_diag": lambda m, e: 0.01 * scipy.linalg.block_diag(1 + e.dt, 2.0),
    "diag of dt": lambda m, e: 0.01 * np.diag([1 + e.t, 2.0]),
    "outer": lambda m, e: Q + 0.01 * np.outer([0.5 * e.dt, 1.0], [0.5 * e.dt, 1.0]),
    "a list": lambda m, e: [[0.01 * (1 + e.t), 0.0], [0.0, 0.01]],
    "nan of the mean": lambda m, e: (
        Q * np.where(np.isnan(np.sqrt(m[..., 0, None, None] - 30)), 1.0, 50.0)
    ),
    "isfinite": lambda m, e: Q * (1 + np.isfinite(np.log(m[..., 0, None, None] - 30))),
    "lru_cache": lambda m, e: Q * (2 + cached(e.k)),
    "floor division": lambda m, e: Q * (1 + e.t // 49),
    "epoch.z": lambda m, e: Q * np.where(np.isnan(e.z).any(), 2.0, 1.0),
    "the mean's shape": lambda m, e: Q * m.shape[-1],
    "the mean's type": lambda m, e: Q * (2.0 if type(m) is np.ndarray else 1.0),
    "a buffer": shared_buffer(lambda noise: noise),
    "an argument by name": lambda mean, epoch: Q * (1 + 0.01 * mean[..., 1, None, None] ** 2),
}
R_EQUAL = {
    "a window": lambda m, e: np.where(e.k == 50, 100.0, 1.0) * np.eye(1),
    "late": lambda m, e: np.eye(1) * np.where(e.t > 60, 100.0, 1.0),
    "of the mean": lambda m, e: np.eye(1) * (1 + 0.01 * m[..., 0, None, None] ** 2),
    "of the mean, a branch": lambda m, e: np.eye(1) * np.where(m[..., :1, None] > 30, 100.0, 1.0),
    "a constant": lambda m, e: np.eye(1),
}
R_EITHER = {
    "a dictionary": lambda m, e: np.eye(1) * {50: 100.0}.get(e.k, 1.0),
    "a branch": lambda m, e: np.eye(1) * (100.0 if e.t > 60 else 1.0),
    "a table": lambda m, e: np.eye(1) * (2 + TABLE[e.k]),
    "a list": lambda m, e: [[1.0 + 0.1 * e.t]],
    "a list of a number": lambda m, e: [[1.0]],
    "a matrix for each run": lambda m, e: R_RUNS,
    "a matrix for each run and time": lambda m, e: R_RUNS * (1 + 0.1 * e.t),
    "nan of the mean": lambda m, e: (
        np.eye(1) * np.where(np.isnan(np.sqrt(m[..., :1, None] - 30)), 1.0, 50.0)
    ),
    "str": lambda m, e: np.eye(1) * len(str(e.k)),
    "zero at late times": lambda m, e: np.eye(1) * np.where(e.t > 60, 0.0, 1.0),
}
cases(EQUAL, "Q", by_Q, Q_EQUAL, **LINE)
cases(EITHER, "Q", by_Q, Q_EITHER, **LINE)
cases(EQUAL, "R", by_R, R_EQUAL, **LINE)
cases(EITHER, "R", by_R, R_EITHER, **LINE)


# -- measurements --------------------------------------------------------------------------------
def ranges(x, e):
    return np.hypot(x[..., :1] - 20.0, 5.0)


H_EQUAL = {
    "a range": ranges,
    "a range that moves": lambda x, e: np.hypot(x[..., :1] - 0.5 * e.t, 5.0),
    "late": lambda x, e: np.where(e.t > 60, 1.1, 1.0) * x[..., :1],
    "one epoch": lambda x, e: x[..., :1] + np.where(e.k == 50, 5.0, 0.0),
    "the first epoch": lambda x, e: x[..., :1] + np.where(e.k == 0, 5.0, 0.0),
    "the last epoch": lambda x, e: x[..., :1] + np.where(e.k == T - 1, 5.0, 0.0),
    "a branch of the state": lambda x, e: np.where(x[..., :1] > 30, 1.1 * x[..., :1], x[..., :1]),
    "a view": lambda x, e: x[..., 0:1],
    "a view with newaxis": lambda x, e: x[..., 0, None],
    "a sum": lambda x, e: x.sum(-1, keepdims=True),
}
H_EITHER = {
    "a dictionary": lambda x, e: x[..., :1] + {50: 5.0}.get(e.k, 0.0),
    "the last epoch, a dictionary": lambda x, e: x[..., :1] + {T - 1: 5.0}.get(e.k, 0.0),
    "a branch": lambda x, e: x[..., :1] + (5.0 if e.t > 60 else 0.0),
    "isnan": lambda x, e: np.where(
        np.isnan(np.sqrt(x[..., :1] - 30)), x[..., :1], 1.1 * x[..., :1]
    ),
    "y == y": lambda x, e: x[..., :1] + 1.0 * (np.log(x[..., :1] - 30) == np.log(x[..., :1] - 30)),
    "floor division": lambda x, e: x[..., :1] + e.t // 49,
    "a table": lambda x, e: x[..., :1] + TABLE[e.k],
    "fmod": lambda x, e: x[..., :1] + np.fmod(e.t, 7.0),
    "str": lambda x, e: x[..., :1] + len(str(e.k)),
    "a masked write": lambda x, e: masked(np.sqrt(x[..., :1] - 30)) * 0.01 + x[..., :1],
    "single precision": lambda x, e: x[..., :1].astype(np.float32),
    "a list": lambda x, e: [x[..., :1]][0],
    "filled": lambda x, e: [y := np.empty((*x.shape[:-1], 1)), y.__setitem__(..., x[..., :1])][0],
}
J_EQUAL = {
    "a constant": lambda m, e: F,
    "of time": lambda m, e: F * np.where(e.t > 60, 0.99, 1.0),
    "of the mean": lambda m, e: F * (1 + 1e-4 * np.cos(m[..., 0, None, None])),
}
J_EITHER = {
    "a dictionary": lambda m, e: F * {50: 0.9}.get(e.k, 1.0),
    "a branch": lambda m, e: 0.99 * F if e.t > 60 else F,
    "a list": lambda m, e: [[1.0, 1.0], [0.0, 1.0]],
    "isnan": lambda m, e: F * np.where(np.isnan(np.sqrt(m[..., 0, None, None] - 30)), 1.0, 0.99),
    "expm": lambda m, e: scipy.linalg.expm(np.array([[0.0, 1.0], [0.0, 0.0]]) * e.dt),
    "filled": lambda m, e: [y := np.zeros((*m.shape[:-1], 2, 2)), y.__iadd__(F)][0],
}
cases(EQUAL, "h", by_sensor, H_EQUAL, **LINE)
cases(EITHER, "h", by_sensor, H_EITHER, **LINE)
cases(EQUAL, "jacobian", by_jacobian, J_EQUAL, **LINE)
cases(EITHER, "jacobian", by_jacobian, J_EITHER, **LINE)


# -- points for components -----------------------------------------------------------------------
def in_place(x, epoch):
    x[0] += epoch.dt * x[1]
    return x


def in_place_of_copy(x, epoch):
    y = x.copy()
    y[0] = x[0] + epoch.dt * x[1]
    return y


def zeros_filled(x, epoch):
    y = np.zeros_like(x)
    y[0] = x[0] + epoch.dt * x[1]
    y[1] = x[1]
    return y


def empty_filled(x, epoch):
    y = np.empty_like(x)
    y[:] = x
    y[0] = x[0] + epoch.dt * x[1]
    return y


def rows_swapped(x, epoch):
    y = x + 0.0
    y[0], y[1] = y[1].copy(), y[0].copy()
    return y


def last_rows(x, epoch):
    y = x.copy()
    y[-2] += epoch.dt * y[-1]
    return y


def one_row_damped(x, epoch):
    y = x + 0.0
    y[1] *= 0.9
    return y


def one_row_late(x, epoch):
    y = x + 0.0
    y[1] = np.where(epoch.t > 5, 0.9, 1.0) * y[1]
    return y


def joined(x, epoch):
    return np.concatenate([x[:1] + epoch.dt * x[1:2], x[1:]])


def listed(x, epoch):
    return np.array([x[0] + epoch.dt * x[1], *x[1:]])


def split_points(x, epoch):
    position, velocity = np.split(x[1:] if len(x) % 2 else x, 2)
    moved_points = np.concatenate([position + epoch.dt * velocity, velocity])
    return np.concatenate([x[:1], moved_points]) if len(x) % 2 else moved_points


def reshaped(x, epoch):
    position, velocity = x.reshape(2, -1)
    return np.stack([position + epoch.dt * velocity, velocity]).reshape(x.shape)


DOOR_MOTIONS = {
    "in place": in_place,
    "in place of a copy": in_place_of_copy,
    "zeros, filled": zeros_filled,
    "empty, filled": empty_filled,
    "rows swapped": rows_swapped,
    "the last rows": last_rows,
    "one row damped": one_row_damped,
    "joined": joined,
    "a list": listed,
    "split": split_points,
    "rolled": lambda x, e: x + 0.1 * np.roll(x, 1, 0),
    "summed up": lambda x, e: x + 0.01 * np.cumsum(x, 0),
    "sorted": lambda x, e: np.sort(x, 0),
    "flipped": lambda x, e: x[::-1],
    "centered": lambda x, e: x - 0.1 * x.mean(0),
    "normalized": lambda x, e: x / np.linalg.norm(x),
    "a row added": lambda x, e: x + 0.1 * x[1],
    "a row broadcast": lambda x, e: np.broadcast_to(x[0], x.shape),
    "a gradient": lambda x, e: x + 0.1 * np.gradient(x, axis=0),
}
OF_RUNS = {  # three states and three runs
    "F @ x": lambda x, e: F3 @ x,
    "np.dot(F, x)": lambda x, e: np.moveaxis(np.dot(F3, x), 0, 1),
    "the second axis": lambda x, e: np.stack([x[:, 0] + x[:, 1], x[:, 1], x[:, 2]], 1),
    "einsum": lambda x, e: np.einsum("ij,pjk->pik", F3, x),
}


def second_axis_in_place(x, epoch):
    x[:, 0] += epoch.dt * x[:, 1]
    return x


DOOR_SENSORS = {
    "rows": lambda x, e: [y := x.copy(), y.__setitem__(0, x[0] + x[1])][0],
    "polar": lambda x, e: np.array([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0]), *x[2:]]),
    "normalized": lambda x, e: x / np.linalg.norm(x),
    "centered": lambda x, e: x - x.mean(0),
    "the second axis": lambda x, e: [y := x.copy(), y.__setitem__((..., 0, slice(None)), 0.0)][0],
}


def jacobian_rows(mean, epoch):
    jacobian = np.broadcast_to(F, (*mean.shape[:-1], 2, 2)).copy()
    jacobian[0, 1] = 1.0 - 0.01 * mean[1]
    return jacobian


def jacobian_of_one_run(mean, epoch):
    return F * (1.0 - 0.001 * mean[0, 0])


def noise_rows(mean, epoch):
    noise = np.broadcast_to(Q, (*mean.shape[:-1], 2, 2)).copy()
    noise[0] *= 1.0 + mean[1, 0] ** 2
    return noise


RUNS_FOR_COMPONENTS = {
    "diag of a row": lambda m, e: np.diag(0.01 + 0.001 * m[0] ** 2),
    "rows": noise_rows,
    "a norm of everything": lambda m, e: Q * (1 + np.linalg.norm(m)),
    "a mean of everything": lambda m, e: Q * (1 + m.mean() ** 2),
    "a number of the first run": lambda m, e: Q * (1 + m[0, 0] ** 2),
}
R_FOR_COMPONENTS = {
    "a norm of everything": lambda m, e: np.eye(1) * (1 + np.linalg.norm(m)),
}
SQUARE = {
    "prior": celnav.Gaussian([0.0, 0.5, -0.5], np.diag([1.0, 2.0, 3.0])),
    "times": TIMES,
    "z": WALK[:, :3],
}
DIAGONAL = {"prior": START, "times": TIMES, "z": PAIRS}
cases(COUPLED, "points, late", by_motion, {"one row damped": one_row_late}, **LINE)
cases(DOOR, "points", by_motion, DOOR_MOTIONS, **LINE)
cases(DOOR, "points, no runs", by_motion, DOOR_MOTIONS, **ALONE)
FEW = {name: DOOR_MOTIONS[name] for name in ("in place", "zeros, filled", "flipped", "centered")}
cases(DOOR, "points, one run", by_motion, FEW, **(LINE | {"z": POSITIONS[:, :1]}))
cases(DOOR, "points of three states", by_motion3, DOOR_MOTIONS, **THREE)
cases(DOOR, "runs, as many as states", by_motion3, OF_RUNS, **SQUARE)
cases(DOOR, "runs", by_motion, {"the second axis": second_axis_in_place}, **LINE)
cases(DOOR, "points, h", by_sensor2, DOOR_SENSORS, **DIAGONAL)
cases(
    DOOR,
    "runs, jacobian",
    by_jacobian,
    {"rows": jacobian_rows, "of one run": jacobian_of_one_run},
    **LINE,
)
cases(DOOR, "runs, Q", by_Q, RUNS_FOR_COMPONENTS, **LINE)
cases(DOOR, "runs, R", by_R, R_FOR_COMPONENTS, **LINE)
cases(
    DOOR,
    "runs, u",
    push,
    {"a row": lambda x, e: e.u[0], "an item": lambda x, e: e.u[0, 0]},
    u=RUN_U,
    **LINE,
)
OTHERS = {
    "ekf": lambda f: celnav.ekf(celnav.Motion(f, Q), GPS),
    "covariance": lambda f: celnav.ukf(celnav.Motion(f, Q), GPS, form="covariance"),
    "simplex": lambda f: celnav.sigma_point(celnav.Motion(f, Q), GPS, rule=celnav.simplex),
    "Gauss-Hermite": lambda f: celnav.ghkf(celnav.Motion(f, Q), GPS),
    "colored": lambda f: celnav.colored(celnav.Motion(f, Q), GPS, [[0.5]]),
    "augmented": lambda f: celnav.augmented(celnav.Motion(f, Q), GPS, [[0.5]]),
    "imm": lambda f: celnav.imm(
        [celnav.ukf(celnav.Motion(g, Q), GPS) for g in (moved, f)], [[0.9, 0.1], [0.1, 0.9]]
    ),
    "two_stage": lambda f: celnav.two_stage(
        celnav.Motion(f, Q), GPS, [[1.0]], celnav.Gaussian([0.0], [[1.0]])
    ),
    "iterated": lambda f: celnav.ukf(celnav.Motion(f, Q), GPS, iterations=2),
    "fallback": lambda f: Fallback(
        celnav.ukf(celnav.Motion(f, Q), GPS), celnav.ckf(celnav.Motion(f, Q), GPS)
    ),
    "no sensor": lambda f: celnav.ukf(celnav.Motion(f, Q)),
}
for name, build in OTHERS.items():
    given = (
        LINE
        if name != "no sensor"
        else {"prior": celnav.Gaussian(np.tile([0.0, 1.0], (RUNS, 1)), START.cov), "times": TIMES}
    )
    cases(
        DOOR,
        f"points, {name}",
        build,
        {"in place": in_place, "zeros, filled": zeros_filled},
        **given,
    )


# -- what looks like a trap and is none ----------------------------------------------------------
def right_in_place(x, epoch):
    x[..., 0] += epoch.dt * x[..., 1]
    return x


def right_filled(x, epoch):
    y = np.zeros_like(x)
    y[..., 0] = x[..., 0] + epoch.dt * x[..., 1]
    y[..., 1] = x[..., 1]
    return y


def each_point(x, epoch):
    y = np.empty_like(x)
    for i, point in enumerate(x):
        y[i] = point @ F.T
    return y


def row_kept(x, epoch):
    y = x @ F.T
    y[0] = y[0]
    return y


def solved_by_scipy(rtol):
    """All points together, with a common step size."""

    def f(x, epoch):
        def rate(t, flat):
            y = flat.reshape(x.shape)
            return np.stack([y[..., 1], -0.1 * np.sin(y[..., 0])], -1).ravel()

        if epoch.dt == 0:
            return x
        given = scipy.integrate.solve_ivp(rate, (0.0, epoch.dt), x.ravel(), rtol=rtol)
        return given.y[:, -1].reshape(x.shape)

    return f


def adaptive_steps(x, epoch):
    """Euler and Heun steps, halved until they agree for all points."""

    def rate(y):
        return np.stack([y[..., 1], -0.1 * np.sin(y[..., 0])], -1)

    for count in 2 ** np.arange(4, 14):
        y, h = x, epoch.dt / count
        for _ in range(count):
            a = rate(y)
            b = rate(y + h * a)
            error, y = h * np.abs(b - a).max(), y + h * (a + b) / 2
        if error < 1e-3:
            return y
    return y


def runge_kutta(x, epoch):
    def rate(y):
        return np.stack([y[..., 1], -0.1 * np.sin(y[..., 0])], -1)

    h = epoch.dt / 2
    for _ in range(2):
        a = rate(x)
        b = rate(x + h / 2 * a)
        c = rate(x + h / 2 * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))
    return x


def same_buffer():
    buffer = {}

    def f(x, epoch):
        y = buffer.setdefault(x.shape, np.empty(x.shape))
        np.matmul(x, F.T, out=y)
        return y

    return f


PURE = {
    "x @ F.T": lambda x, e: x @ F.T,
    "np.matmul": lambda x, e: np.matmul(F, x[..., None])[..., 0],
    "einsum": lambda x, e: np.einsum("ij,...j->...i", F, x),
    "a sum of products": lambda x, e: (F * x[..., None, :]).sum(-1),
    "concatenate": lambda x, e: np.concatenate([x[..., :1] + e.dt * x[..., 1:], x[..., 1:]], -1),
    "stack": lambda x, e: np.stack([x[..., 0] + e.dt * x[..., 1], x[..., 1]], -1),
    "of itself": lambda x, e: x,
    "a slice of itself": lambda x, e: x[...],
    "a view backward twice": lambda x, e: x[..., ::-1][..., ::-1],
    "a damped mean of components": lambda x, e: 0.5 * x + 0.5 * x.mean(-1, keepdims=True),
    "a deviation of components": lambda x, e: x - 0.1 * x.mean(-1, keepdims=True),
    "each point normalized": lambda x, e: x / np.sqrt(1 + (x * x).sum(-1, keepdims=True)),
    "each point's norm": lambda x, e: x / (1 + np.linalg.norm(x, axis=-1, keepdims=True)),
    "Runge and Kutta": runge_kutta,
    "components swapped": lambda x, e: x[..., ::-1],
    "components alike": lambda x, e: np.stack([x[..., 0] + x[..., 1]] * 2, -1) / 2,
    "a constant": lambda x, e: 0.0 * x + [1.0, 2.0],
    "a right write": right_filled,
}
PURE_BY_LOOKS = {
    "a right write in place": right_in_place,
    "a loop over points": each_point,
    "a list of points": lambda x, e: np.array([point @ F.T for point in x]),
    "a row that stays": row_kept,
    "reshaped by points": lambda x, e: (x.reshape(-1, 2) @ F.T).reshape(x.shape),
    "vectorize": lambda x, e: np.vectorize(lambda v: F @ v, signature="(n)->(n)")(x),
    "apply_along_axis": lambda x, e: np.apply_along_axis(lambda v: F @ v, -1, x),
    "tensordot": lambda x, e: np.tensordot(x, F, (-1, 1)),
    "inner": lambda x, e: np.inner(x, F),
    "np.dot": lambda x, e: np.dot(x, F.T),
    "solve_ivp, tight": solved_by_scipy(1e-8),
    "solve_ivp as it comes": solved_by_scipy(1e-3),
    "steps that adapt": adaptive_steps,
    "the same buffer": same_buffer(),
    "a matrix of each point": lambda x, e: (gram2(x) @ x[..., None])[..., 0] * 0.1,
    "an inverse of each point": lambda x, e: np.linalg.solve(gram2(x), x[..., None])[..., 0],
}
NO_RUNS = {  # right without an axis of runs, where points are (p, 2)
    "columns": lambda x, e: np.column_stack([x[:, 0] + e.dt * x[:, 1], x[:, 1]]),
    "columns of an array": lambda x, e: np.array([x[:, 0] + e.dt * x[:, 1], x[:, 1]]).T,
    "F @ x.T": lambda x, e: (F @ x.T).T,
    "the second axis": second_axis_in_place,
    "unpacked": lambda x, e: (lambda position, v: np.c_[position + e.dt * v, v])(*x.T),
    "a comprehension": lambda x, e: np.array([[p + e.dt * v, v] for p, v in x]),
    "np.dot": lambda x, e: np.dot(F, x.T).T,
}
NOISE_NO_RUNS = {
    "a component": lambda m, e: Q * (1 + m[0] ** 2),
    "diag": lambda m, e: np.diag([0.01 * (1 + m[0] ** 2), 0.01]),
    "a norm": lambda m, e: Q * (1 + np.linalg.norm(m)),
    "an array": lambda m, e: np.array([[0.01 + 1e-4 * m[1] ** 2, 0.0], [0.0, 0.01]]),
}
JACOBIAN_NO_RUNS = {
    "an array": lambda m, e: np.array([[1.0, 1.0 - 1e-3 * m[1]], [0.0, 1.0]]),
    "a component": lambda m, e: F * (1 - 1e-4 * np.cos(m[0])),
}
GAIN_RUNS = np.array([0.9, 1.0, 1.1])
OF_EACH_RUN = {
    "a gain": lambda x, e: np.stack([x[..., 0] + x[..., 1], GAIN_RUNS * x[..., 1]], -1),
    "an offset": lambda x, e: x @ F.T + np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]),
    "a matrix": lambda x, e: np.einsum("rij,...rj->...ri", F * GAIN_RUNS[:, None, None], x),
    "a matrix by matmul": lambda x, e: (F * GAIN_RUNS[:, None, None] @ x[..., None])[..., 0],
    "a choice": lambda x, e: np.where(np.arange(RUNS)[:, None] == 1, 0.9 * x, x),
}


def gram2(x):
    return np.eye(2) + 0.01 * x[..., :, None] * x[..., None, :]


def with_runs(runs):
    return LINE | {
        "z": TIMES[:, None, None] + np.random.default_rng(runs).normal(size=(T, runs, 1))
    }


cases(EQUAL, "pure", by_motion, PURE, **LINE)
cases(EITHER, "pure", by_motion, PURE_BY_LOOKS, **LINE)
cases(EQUAL, "pure, no runs", by_motion, PURE, **ALONE)
cases(EITHER, "pure, no runs", by_motion, NO_RUNS, **ALONE)
cases(EITHER, "pure, no runs, Q", by_Q, NOISE_NO_RUNS, **ALONE)
cases(EITHER, "pure, no runs, jacobian", by_jacobian, JACOBIAN_NO_RUNS, **ALONE)
cases(EITHER, "of each run", by_motion, OF_EACH_RUN, **LINE)
for runs in (1, 2, 5, 8, 9):  # 2 states, 5 points, 8 runs per vector
    cases(
        EQUAL,
        f"pure, {runs} runs",
        by_motion,
        {name: PURE[name] for name in ("x @ F.T", "each point normalized")},
        **with_runs(runs),
    )
cases(
    EITHER,
    "of each run, as many as points",
    by_motion,
    {"a gain": lambda x, e: np.stack([x[..., 0], np.linspace(0.9, 1.1, 5) * x[..., 1]], -1)},
    **with_runs(5),
)
cases(
    EITHER,
    "of each run, as many as states",
    by_motion,
    {"a gain": lambda x, e: x @ F.T + np.array([0.1, -0.1])[:, None]},
    **with_runs(2),
)
FEW_PURE = {name: PURE[name] for name in ("stack", "components swapped", "components alike")}
WHITE = celnav.Gaussian([0.0, 0.0], np.eye(2))
cases(EQUAL, "a prior without structure", by_motion, FEW_PURE, prior=WHITE, times=TIMES, z=WALK)


# -- innocent filters ----------------------------------------------------------------------------
def spin(x, epoch):
    return multiply(exp(0.01 * epoch.dt * np.array([1.0, -2.0, 0.5])), x)


def body(x, epoch):
    """Euler's equations of a rigid body."""
    inertia = np.array([1.0, 2.0, 3.0])
    return x - 0.1 * epoch.dt * np.cross(x, inertia * x) / inertia


ORBIT = orbit.from_elements(7000.0, 0.01, 0.9, 0.3, 0.2, 0.1)
MINUTES = 60.0 * TIMES
ORBITS = orbit.propagate(ORBIT, 60.0, T - 1)
ORBIT_GIVEN = {
    "prior": celnav.Gaussian(ORBIT, np.diag([1.0] * 3 + [1e-3] * 3) ** 2),
    "times": MINUTES,
    "z": ORBITS[:, None, :3] + 0.1 * RNG.standard_normal((T, RUNS, 3)),
}
STARS = celnav.Sensor(
    lambda x, e: np.concatenate([rotate(x, star) for star in np.eye(3)[:2]], -1), 1e-4 * np.eye(6)
)
ATTITUDES = np.tile([0.0, 0.0, 0.0, 1.0], (T, RUNS, 1))
NOISY = celnav.Motion(
    lambda x, e, *w: np.stack([x[..., 0] + x[..., 1], x[..., 1] * (1 + w[0][..., 0])], -1) + w[0],
    augment=(0.1 * np.eye(2),),
)
NOISY_GPS = celnav.Sensor(lambda x, e, *v: x[..., :1] * (1 + 0.01 * v[-1]), augment=(np.eye(1),))
TURNS = motions.coordinated_turn(0.01, 1e-4)
AROUND = celnav.Gaussian([0.0, 0.0, 1.0, 0.0, 0.05], np.diag([1.0, 1.0, 0.1, 0.1, 1e-3]))


def linear(n, runs, m=1, prior=None, q=0.01, r=1.0, F=None, **options):
    """A linear filter with ``n`` states, its models as functions, and its data."""
    rng = np.random.default_rng(100 * n + runs)
    F = np.eye(n) + 0.1 * np.eye(n, k=1) if F is None else np.asarray(F)
    filter = celnav.ukf(
        celnav.Motion(lambda x, e: x @ F.T, np.asarray(q) * (np.eye(n) if np.ndim(q) == 0 else 1)),
        celnav.Sensor(lambda x, e: x[..., :m], r * np.eye(m)),
        **options,
    )
    z = np.cumsum(rng.standard_normal((T, runs, m)), 0) * np.sqrt(r)
    return filter, {
        "prior": prior or celnav.Gaussian(np.zeros(n), np.eye(n)),
        "times": TIMES,
        "z": z,
    }


def innocent(name, filter, expected=EQUAL, squared=False, **given):
    assert name not in CASES
    CASES[name] = Case(expected, lambda: (filter, dict(given)), None, squared)


HOOKS = {
    "gate": adaptive.gate(2.0),
    "chi-square": adaptive.chi_square_gate(0.5),
    "Huber": adaptive.huber(),
    "Student": adaptive.student_t(),
    "window": adaptive.innovation_window(5),
    "Sage and Husa": adaptive.sage_husa(),
    "variational": adaptive.variational_bayes(),
}
ROBUST = celnav.Motion(lambda x, e: x @ F.T + [0.0, 0.01] * np.sin(x), Q)
for name, hook in HOOKS.items():
    innocent(f"hook: {name}", celnav.ukf(ROBUST, BOTH, hooks=[hook]), **WITH_GAPS)
for name, ready in {
    "ekf": celnav.ekf(ROBUST, GPS),
    "iterated": celnav.ekf(ROBUST, GPS, iterations=3),
    "Gauss-Hermite": celnav.ghkf(ROBUST, GPS),
    "simplex": celnav.sigma_point(ROBUST, GPS, rule=celnav.simplex),
    "colored": celnav.colored(ROBUST, GPS, [[0.5]]),
    "augmented": celnav.augmented(ROBUST, GPS, [[0.5]]),
    "two stages": celnav.two_stage(ROBUST, GPS, [[1.0]], celnav.Gaussian([0.0], [[1.0]])),
    "models that take turns": celnav.imm(
        [celnav.ukf(celnav.Motion(moved, q * Q), GPS) for q in (1.0, 100.0)],
        [[0.9, 0.1], [0.1, 0.9]],
    ),
    "noise through the points": celnav.ukf(NOISY, NOISY_GPS),
    "single draw": SingleDraw.of(celnav.ukf(NOISY, NOISY_GPS)),
    "fallback": Fallback(celnav.ukf(ROBUST, GPS), celnav.ekf(ROBUST, GPS)),
    "considered": celnav.ukf(ROBUST, GPS, gain=adaptive.consider(1, 1)),
}.items():
    innocent(f"filter: {name}", ready, **LINE)
    if name in ("colored", "two stages", "models that take turns", "noise through the points"):
        innocent(f"filter: {name}, no runs", ready, **ALONE)
innocent(
    "an orbit",
    celnav.ukf(
        celnav.Motion(lambda x, e: orbit.step(x, e.dt), 1e-10 * np.eye(6)),
        celnav.Sensor(lambda x, e: x[..., :3], 0.01 * np.eye(3)),
    ),
    **ORBIT_GIVEN,
)
innocent(
    "a quaternion",
    celnav.ukf(celnav.Motion(spin, 1e-6 * np.eye(3), space=attitude()), STARS),
    prior=celnav.Gaussian([0.0, 0.0, 0.0, 1.0], 0.01 * np.eye(3)),
    times=TIMES,
    z=np.concatenate([rotate(ATTITUDES, star) for star in np.eye(3)[:2]], -1)
    + 0.01 * RNG.standard_normal((T, RUNS, 6)),
)
innocent("a rigid body", celnav.ukf(celnav.Motion(body, 0.01 * np.eye(3)), FIX), **THREE)
innocent(
    "a turning target",
    celnav.ukf(TURNS, celnav.Sensor(lambda x, e: x[..., :2], np.eye(2))),
    prior=AROUND,
    times=TIMES,
    z=celnav.simulate(TURNS, celnav.Sensor(np.eye(2, 5), np.eye(2)), AROUND, TIMES, runs=RUNS)[1],
)
innocent("constant velocity", celnav.ukf(motions.constant_velocity(1, 0.01), GPS), **LINE)
innocent(
    "intervals of each run",
    celnav.ukf(
        celnav.Motion(lambda x, e: np.stack([x[..., 0] + e.dt * x[..., 1], x[..., 1]], -1), Q), GPS
    ),
    prior=START,
    times=[
        celnav.Epoch(k, float(k), np.array([0.5, 1.0, 2.0]) if k else 0.0, z=POSITIONS[k])
        for k in range(T)
    ],
)
for name, (n, runs, m, prior) in {
    "one state": (1, 3, 1, None),
    "one state, one run": (1, 1, 1, None),
    "as many runs as states": (3, 3, 1, None),
    "as many runs as points": (2, 5, 1, None),
    "as many measurements as runs": (3, 2, 2, None),
    "states, runs and measurements alike": (3, 3, 3, None),
    "as many runs as a vector has": (2, 8, 1, None),
    "states alike": (2, 3, 1, celnav.Gaussian([1.0, 1.0], np.eye(2))),
}.items():
    ready, given = linear(n, runs, m, prior)
    innocent(f"shapes: {name}", ready, **given)
UNSTABLE = [[1.2, 0.1], [0.0, 1.1]]
for form in ("square root", "covariance"):
    for name, (options, more) in {
        "a precise measurement": ({"r": 1e-12}, {}),
        "a wide prior, a precise measurement": (
            {"r": 1e-6, "prior": celnav.Gaussian([0.0, 0.0], 1e12 * np.eye(2))},
            {},
        ),
        "a very wide prior": (
            {
                "prior": celnav.Gaussian(
                    [0.0, 0.0], (1e16 if form == "square root" else 1e10) * np.eye(2)
                )
            },
            {},
        ),
        "units that differ": (
            {"prior": celnav.Gaussian([1e6, 1e-6], np.diag([1e8, 1e-16])), "q": 1e-18},
            {},
        ),
        "almost no process noise": ({"q": 1e-16}, {}),
        "no process noise": ({"q": 0.0}, {}),
        "an almost singular process noise": (
            {"q": [[0.01, 0.01 - 1e-14], [0.01 - 1e-14, 0.01]]},
            {},
        ),
        "a state that is not observed": ({"F": np.eye(2)}, {}),
        "a correlated prior": (
            {"prior": celnav.Gaussian([0.0, 0.0], [[1.0, 1 - 1e-9], [1 - 1e-9, 1.0]])},
            {},
        ),
        "an unstable open loop": ({"F": UNSTABLE}, {"z": None}),
        "a long unstable open loop": ({"F": UNSTABLE}, {"z": None, "times": np.arange(300.0)}),
        "an unstable loop": ({"F": UNSTABLE}, {}),
        "a large mean": (
            {"prior": celnav.Gaussian([1e9, 0.0], np.eye(2))},
            {"z": 1e9 + 0.1 * RNG.standard_normal((T, RUNS, 1))},
        ),
        "a state that is known": ({"prior": celnav.Gaussian([0.0, 1.0], np.diag([1.0, 0.0]))}, {}),
        "a loop that forgets": ({"F": 1e-3 * np.eye(2)}, {}),
        "a measurement without noise": ({"r": 0.0}, {"z": WALK[:, :RUNS]}),
    }.items():
        ready, given = linear(2, RUNS, **options, form=form)
        innocent(f"{form}: {name}", ready, squared=form == "covariance", **(given | more))
    ready, given = linear(4, RUNS, 2, F=np.triu(np.ones((4, 4))), q=1e-10, form=form)
    innocent(f"{form}: a chain of integrators", ready, squared=form == "covariance", **given)
    _, given = linear(2, RUNS, r=1e-8, prior=celnav.Gaussian([0.0, 0.0], 1e4 * np.eye(2)))
    near = celnav.Sensor(
        lambda x, e: np.stack([x[..., 0], x[..., 0] + 1e-6 * x[..., 1]], -1), 1e-8 * np.eye(2)
    )
    innocent(
        f"{form}: measurements almost alike",
        celnav.ukf(celnav.Motion(moved, 1e-6 * np.eye(2)), near, form=form),
        squared=form == "covariance",
        **(given | {"z": given["z"].repeat(2, -1)}),
    )
# Two measurements that are almost the same, much more precise than the prior.
ALIKE = np.eye(2, 4)[:1] + 1e-6 * np.array([[0.0] * 4, [0.0, 1.0, 0.0, 0.0]])
CHAIN = np.eye(4) + np.eye(4, k=1)
for r, p in ((1e-14, 1.0), (1e-10, 1.0), (1e-6, 1e8)):
    near = celnav.Sensor(lambda x, e: x @ ALIKE.T, r * np.eye(2))
    chain = celnav.Motion(lambda x, e: x @ CHAIN.T, 1e-12 * np.eye(4))
    twice = {
        "prior": celnav.Gaussian(np.zeros(4), p * np.eye(4)),
        "times": TIMES[:12],
        "z": np.sqrt(r) * np.cumsum(RNG.standard_normal((12, RUNS, 2)), 0),
    }
    for form in ("square root", "covariance"):
        for name, ready in {
            "ukf": celnav.ukf(chain, near, form=form),
            "small alpha": celnav.ukf(chain, near, alpha=1e-3, form=form),
            "colored": celnav.colored(chain, near, 0.9 * np.eye(2), form=form),
            "augmented": celnav.augmented(chain, near, 0.9 * np.eye(2), form=form),
        }.items():
            if (form, p) != ("covariance", 1e8):  # round-off there is larger than σ, in numpy too
                innocent(
                    f"almost alike, r={r:g}, P={p:g}, {form}: {name}", ready, ACCEPTED, **twice
                )
innocent(
    "derivatives by differences of a wide prior",
    celnav.ekf(
        celnav.Motion(lambda x, e: x @ F.T + np.array([0.0, 0.1]) * np.sin(x), Q),
        celnav.Sensor(lambda x, e: x[..., :1], [[1.0]]),
    ),
    EITHER,
    **(LINE | {"prior": celnav.Gaussian([0.0, 1.0], np.diag([4.0, 1e6]))}),
)
LOST = np.array([0.0, np.nan, 0.0])
FLAGGED = {
    "nan in one run": lambda x, e: np.where(e.t > 40, LOST, 0.0) * x[..., 1],
    "nan by the input": lambda x, e: e.u[..., 0],
    "a root of a negative number": lambda x, e: 0.0 * np.sqrt(40 - x[..., 0]) * e.u[..., 0],
}
cases(EITHER, "a run that fails", push, FLAGGED, u=RUN_LATE_U, on_failure="flag", **LINE)
cases(EITHER, "no flag", push, {"nan by the input": lambda x, e: e.u[..., 0]}, u=RUN_U, **LINE)
SENSORS = {
    "of two rates": (POSITIONS, np.where(np.arange(T)[:, None, None] % 10, np.nan, PAIRS[..., 1:])),
    "one of them silent": (np.full_like(POSITIONS, np.nan), PAIRS[..., 1:]),
    "one of them late": (
        POSITIONS,
        np.where(np.arange(T)[:, None, None] < 60, np.nan, PAIRS[..., 1:]),
    ),
}
for name, z in SENSORS.items():
    ready = celnav.ukf(ROBUST, GPS, celnav.Sensor(lambda x, e: x[..., 1:], [[0.25]]))
    innocent(f"sensors: {name}", ready, prior=START, times=TIMES, z=z)
    ready = celnav.ukf(
        ROBUST,
        GPS,
        celnav.Sensor(lambda x, e: x[..., 1:] + {60: 1.0, 70: 0.5}.get(e.k, 0.0), [[0.25]]),
    )
    innocent(f"sensors, a dictionary: {name}", ready, EITHER, prior=START, times=TIMES, z=z)


# -- how a case is judged ------------------------------------------------------------------------
RAW = re.compile(
    r"unsupported operand|has no attribute|are valid indices|'Number|Traced|not subscriptable"
    r"|indices must|Expecting value"
    r"|positional argument|cannot be interpreted|unhashable|__\w+__|not iterable|required from"
    r"|must be (a |an )?(real|str|int)|inhomogeneous|object arrays|not supported between"
    r"|setting an array element|could not be broadcast|is not JSON|matmul: Input|too many indices"
)
"""Messages of Python and numpy about the recorder's types: they name no remedy."""
CURE = re.compile(
    r"numpy\.where|numpy's functions|engine=|instead"
    r"|\b(put|write|take|use|give|pass|call|make|keep|let|replace)\b"
)


def attempt(filter, given, engine):
    """A track, or the error that a run ends with."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return celnav.run(filter, **given, engine=engine)
        except Exception as error:
            return error


def lines_of(function, lines=frozenset(), seen=()):
    """Source lines of a model, of its closure, and of functions in this file that it calls."""
    code = getattr(getattr(function, "__wrapped__", function), "__code__", None)
    if code is None or code in seen or code.co_filename != __file__:
        return lines
    last = max(line for _, _, line in code.co_lines() if line)
    inside = [constant for constant in code.co_consts if inspect.iscode(constant)]
    last = max([last, *(line for c in inside for _, _, line in c.co_lines() if line)])
    lines = lines | set(range(code.co_firstlineno, last + 1))
    others = [cell.cell_contents for cell in getattr(function, "__closure__", None) or ()]
    others += [globals()[name] for name in code.co_names if name in globals()]
    for other in others:
        lines = lines_of(other, lines, (*seen, code))
    return lines


def assert_refused(error, model):
    """An error names a line of the model and the remedy, or the faulty argument."""
    assert isinstance(error, CannotCompile), f"{type(error).__name__}: {error}"
    text = str(error)
    if re.search(r"\b(u|z|times|prior): expected", text):
        return
    assert not RAW.search(re.sub(r" \([\w.]+\.py, line .*", "", text)), f"raw: {text}"
    line = re.search(rf"{re.escape(__name__)}\.py, line (\d+)", text)
    assert line, f"no line: {text}"
    if model is not None:
        lines = lines_of(model).union(*map(lines_of, WRAPPERS))
        assert int(line[1]) in lines, f"another line: {text}"
    assert CURE.search(re.sub(r"\([^()]*line \d+.*", "", text)), f"no cure: {text}"


def assert_equal(known, found, squared=False):
    """Two tracks within 1e-7 standard deviations and 1e-9 of the number, and the state's round-off.

    A number that has been ``c`` times larger than its standard deviation has ``c`` times the
    round-off; the covariance form squares ``c``. No track may differ by a hundredth of a standard
    deviation.
    """
    for field in ("failed_at", "used"):
        np.testing.assert_array_equal(getattr(found, field), getattr(known, field), field)
    np.testing.assert_array_equal(np.isnan(found.mean), np.isnan(known.mean))
    std = known.std
    states = known.mean[..., : std.shape[-1]]  # a quaternion has more numbers than errors
    largest = np.nanmax(np.abs(states) + std, 0)
    condition = np.divide(largest, std, out=np.ones_like(std), where=std > 0).max(-1)
    rounding = 1e3 * np.finfo(float).eps * condition[..., None] ** (2 if squared else 1)
    allowed = (1e-7 + rounding) * std + 1e-9 * np.abs(states)
    allowed = np.minimum(allowed, 0.01 * std) + 1e-12 * largest
    off = np.abs(found.mean - known.mean)[..., : std.shape[-1]]
    first = np.argmax((off > allowed).reshape(len(off), -1).any(-1))
    assert worst(off, allowed) <= 1, (
        f"off by {worst(off, std):.3g} standard deviations, from epoch {first} on"
    )
    spread = np.abs(found.std - std)
    assert worst(spread, 10 * allowed) <= 1, f"deviations off by {worst(spread, std):.3g}"


def assert_as_near_as_itself(filter, given, known, found):
    """Within 10,000 times the change of numpy's result when the last bits of z and the prior
    change.
    """
    np.testing.assert_array_equal(found.failed_at, known.failed_at)
    rng, moves = np.random.default_rng(0), [1e-7]
    for sign in (-1.0, 1.0):
        prior = celnav.Gaussian(given["prior"].mean, given["prior"].cov * (1 + sign * 2.0**-52))
        z = given["z"] * (1 + 2.0**-52 * rng.choice([-1.0, 1.0], given["z"].shape))
        other = attempt(filter, given | {"prior": prior, "z": z}, "numpy")
        moves.append(worst(np.abs(other.mean - known.mean), known.std))
    assert worst(np.abs(found.mean - known.mean), known.std) <= 1e4 * max(moves)


def worst(error, scale):
    """The largest ratio where both are finite."""
    ratio = np.divide(error, scale, out=np.where(error > 0, np.inf, 0.0), where=scale > 0)
    return np.nanmax(ratio, initial=0.0)


@pytest.mark.parametrize("name", CASES)
def test_no_engine_gives_wrong_numbers_without_a_word(name):
    case = CASES[name]
    known, auto = attempt(*case.make(), "numpy"), attempt(*case.make(), "auto")
    is_compiled = isinstance(auto, celnav.Track) and auto.engine == "compiled"
    compiled = auto if is_compiled else attempt(*case.make(), "compiled")
    if case.expected == DOOR or (case.expected in MAYBE_DOOR and isinstance(known, ValueError)):
        for engine, found in {"numpy": known, "auto": auto, "compiled": compiled}.items():
            assert isinstance(found, ValueError), f"{engine} takes it"
            if case.expected == DOOR:
                assert re.search(r"\[\.\.\., ", str(found)), f"{engine}: {found}"
        return None
    assert isinstance(known, celnav.Track), f"numpy: {type(known).__name__}: {known}"
    if isinstance(compiled, celnav.Track) and case.expected == ACCEPTED:
        filter, given = case.make()
        return assert_as_near_as_itself(filter, given, known, compiled)
    if isinstance(compiled, celnav.Track):
        if case.expected == HIDDEN:
            known = attempt(push(lambda x, e: 0.0), LINE, "numpy")
        assert compiled.engine == "compiled"
        return assert_equal(known, compiled, case.squared)
    assert case.expected not in (EQUAL, ACCEPTED), f"refused: {type(compiled).__name__}: {compiled}"
    assert_refused(compiled, case.model)
    assert isinstance(auto, celnav.Track), f"auto: {type(auto).__name__}: {auto}"
    if case.expected in (MEMORY, HIDDEN):  # its memory differs
        assert auto.engine.startswith("numpy: ")
    else:
        assert auto.engine == f"numpy: {compiled}"
        np.testing.assert_array_equal(auto.mean, known.mean)
        np.testing.assert_array_equal(auto.std, known.std)
    return None


@pytest.mark.parametrize("engine", ["numpy", "compiled", "auto"])
def test_a_lost_run_ends_alike(engine):
    filter, given = push(lambda x, e: e.u[..., 0]), LINE | {"u": RUN_LATE_U}
    error = attempt(filter, given, engine)
    assert isinstance(error, celnav.FilterError)
    assert str(error) == str(attempt(filter, given, "numpy"))
    assert "61" in str(error)


@pytest.mark.parametrize("engine", ["numpy", "compiled", "auto"])
def test_an_error_in_a_model_at_a_late_step_is_no_track(engine):
    found = attempt(push(lambda x, e: 0.1 / (50 - e.k)), LINE, engine)
    assert isinstance(found, (ZeroDivisionError, celnav.FilterError, CannotCompile)), found


# -- models that write into what they are given --------------------------------------------------
def writes_position(x, e):
    x[..., 0] += e.dt * x[..., 1]
    return x


def doubled_in_place(x, e):
    x *= 2.0
    return x[..., :1]


def measured_in_place(x, e):
    x[..., 0] = np.hypot(x[..., 0] - 20.0, 5.0)
    return x[..., :1]


def added_by_out(x, e):
    return np.add(x, [0.5, 0.0], out=x)


def damped_mean(mean, e):
    mean[..., 1] *= 0.5
    return Q * (1 + mean[..., 0, None, None] ** 2)


def used_up_input(x, e):
    if e.u is not None:
        e.u[...] *= 0.5
    return 0.0 if e.u is None else e.u[..., 0]


def reusing():
    """Motion and sensor share one buffer."""
    buffer = np.empty((99, RUNS, 2))

    def into(x):
        y = buffer[: len(x), : x.shape[-2]] if x.ndim == 3 else buffer[: len(x), 0]
        np.matmul(x, F.T, out=y)
        return y

    return celnav.ukf(
        celnav.Motion(lambda x, e: into(x), Q), celnav.Sensor(lambda x, e: into(x), np.eye(2))
    )


def noise_in_buffer():
    buffer = np.zeros((2, 2))

    def noise(mean, e):
        buffer[:] = Q * (1 + e.k)
        return buffer

    return noise


TWINS = {  # (the filter, one that is right, what both are given)
    "f writes its points": (
        lambda: by_motion(writes_position),
        lambda: by_motion(right_filled),
        LINE,
    ),
    "f adds into its points": (
        lambda: by_motion(added_by_out),
        lambda: by_motion(lambda x, e: x + np.array([0.5, 0.0])),
        LINE,
    ),
    "h doubles its points": (
        lambda: by_sensor(doubled_in_place),
        lambda: by_sensor(lambda x, e: 2 * x[..., :1]),
        LINE,
    ),
    "h writes its points": (lambda: by_sensor(measured_in_place), lambda: by_sensor(ranges), LINE),
    "Q writes the mean": (
        lambda: by_Q(damped_mean),
        lambda: by_Q(lambda m, e: Q * (1 + m[..., 0, None, None] ** 2)),
        LINE,
    ),
    "f and h share a buffer": (
        reusing,
        lambda: celnav.ukf(celnav.Motion(moved, Q), celnav.Sensor(moved, np.eye(2))),
        DIAGONAL,
    ),
    "Q returns a buffer": (
        lambda: by_Q(noise_in_buffer()),
        lambda: by_Q(lambda m, e: Q * (1 + e.k)),
        LINE,
    ),
    "h returns its points": (
        lambda: by_sensor2(lambda x, e: x),
        lambda: by_sensor2(lambda x, e: x + 0.0),
        DIAGONAL,
    ),
    "h returns a view backward": (
        lambda: by_sensor2(lambda x, e: x[..., ::-1]),
        lambda: by_sensor2(lambda x, e: x[..., [1, 0]]),
        DIAGONAL,
    ),
    "f returns a locked array": (
        lambda: by_motion(lambda x, e: np.broadcast_to(x @ F.T, x.shape)),
        lambda: by_motion(moved),
        LINE,
    ),
    "f returns Fortran's order": (
        lambda: by_motion(lambda x, e: np.asfortranarray(x @ F.T)),
        lambda: by_motion(moved),
        LINE,
    ),
    "f returns lists": (
        lambda: by_motion(lambda x, e: (x @ F.T).tolist()),
        lambda: by_motion(moved),
        LINE,
    ),
    "f returns objects": (
        lambda: by_motion(lambda x, e: (x @ F.T).astype(object)),
        lambda: by_motion(moved),
        LINE,
    ),
    "f returns a masked array": (
        lambda: by_motion(lambda x, e: np.ma.array(x @ F.T)),
        lambda: by_motion(moved),
        LINE,
    ),
}


@pytest.mark.parametrize("engine", ["numpy", "compiled", "auto"])
@pytest.mark.parametrize("name", TWINS)
def test_what_a_model_writes_and_returns_does_not_matter(name, engine):
    make, right, given = TWINS[name]
    known, found = attempt(right(), given, "numpy"), attempt(make(), given, engine)
    assert isinstance(known, celnav.Track), known
    if isinstance(found, CannotCompile):
        assert engine == "compiled"
        return assert_refused(found, None)
    assert isinstance(found, celnav.Track), f"{type(found).__name__}: {found}"
    return assert_equal(known, found)


@pytest.mark.parametrize("engine", ["numpy", "compiled", "auto"])
def test_inputs_that_a_model_writes_stay_what_they_were(engine):
    u = SHARED_U.copy()
    found = attempt(push(used_up_input), LINE | {"u": u}, engine)
    assert isinstance(found, (celnav.Track, ValueError)), f"{type(found).__name__}: {found}"
    np.testing.assert_array_equal(u, SHARED_U)


# -- a filter that is kept -----------------------------------------------------------------------
class World:
    """Data that models read and that may change between two runs."""

    def __init__(self):
        self.value, self.array, self.late = 0.01, np.array([0.01, 0.0]), 0.0
        self.table, self.matrix = {50: 1.0}, F.copy()


def change(name, value):
    return lambda world: setattr(world, name, value)


def write(name, index, value):
    return lambda world: getattr(world, name).__setitem__(index, value)


def nothing(world):
    return None


def of_world(a):
    """A filter from a model that reads a `World`."""
    return lambda world: push(lambda x, e: a(world, x, e))


TWICE = 2.0 * TIMES
LONGER = {
    "prior": START,
    "times": np.arange(2.0 * T),
    "z": np.concatenate([POSITIONS, T + POSITIONS]),
}
WITH_U, WITH_LATE, WITH_RUN_U = LINE | {"u": SHARED_U}, LINE | {"u": LATE_U}, LINE | {"u": RUN_U}
WIDE_U = LINE | {"u": np.concatenate([SHARED_U, 0.1 + SHARED_U], -1)}
IN_GAPS = LINE | {"z": np.where(np.arange(T)[:, None, None] % 7 == 3, np.nan, POSITIONS)}
OTHER_PRIOR = LINE | {"prior": celnav.Gaussian([25.0, 1.0], START.cov)}
KEPT = {  # (a filter of a world, the first run, what changes, the second run)
    "nan in the inputs": (
        of_world(lambda w, x, e: np.nan_to_num(e.u[..., 0], nan=0.5)),
        WITH_U,
        nothing,
        WITH_LATE,
    ),
    "nan in the inputs, isnan": (
        of_world(lambda w, x, e: np.where(np.isnan(e.u[..., 0]), 0.5, 0.0)),
        WITH_U,
        nothing,
        WITH_LATE,
    ),
    "nan in the inputs, u == u": (
        of_world(lambda w, x, e: np.where(e.u[..., 0] == e.u[..., 0], 0.0, 0.5)),
        WITH_U,
        nothing,
        WITH_LATE,
    ),
    "nan in the inputs of a run": (
        of_world(lambda w, x, e: np.where(np.isnan(e.u[..., 0]), 0.5, 0.0)),
        WITH_RUN_U,
        nothing,
        LINE | {"u": RUN_LATE_U},
    ),
    "no nan in the second": (
        of_world(lambda w, x, e: np.where(np.isnan(e.u[..., 0]), 0.5, e.u[..., 0])),
        WITH_LATE,
        nothing,
        WITH_U,
    ),
    "inputs of runs": (of_world(lambda w, x, e: e.u[..., 0]), WITH_U, nothing, WITH_RUN_U),
    "wider inputs": (of_world(lambda w, x, e: e.u.sum(-1)), WITH_U, nothing, WIDE_U),
    "narrower inputs": (of_world(lambda w, x, e: e.u.mean(-1)), WIDE_U, nothing, WITH_U),
    "no inputs": (
        of_world(lambda w, x, e: 0.1 if e.u is None else e.u[..., 0]),
        WITH_U,
        nothing,
        LINE,
    ),
    "inputs at last": (
        of_world(lambda w, x, e: 0.1 if e.u is None else e.u[..., 0]),
        LINE,
        nothing,
        WITH_U,
    ),
    "a value": (of_world(lambda w, x, e: w.value), LINE, change("value", 0.1), LINE),
    "a value that is 0 at first": (
        of_world(lambda w, x, e: w.late * x[..., 1]),
        LINE,
        change("late", 0.1),
        LINE,
    ),
    "a value that is 1 at first": (
        of_world(lambda w, x, e: 0.01 * x[..., 1] ** (1 + w.late)),
        LINE,
        change("late", 1.0),
        LINE,
    ),
    "a value late": (
        of_world(lambda w, x, e: np.where(e.t > 60, w.late, 0.0)),
        LINE,
        change("late", 0.1),
        LINE,
    ),
    "a value at one epoch": (
        of_world(lambda w, x, e: np.where(e.k == 50, w.late, 0.0)),
        LINE,
        change("late", 3.0),
        LINE,
    ),
    "an array written": (
        of_world(lambda w, x, e: x @ w.array),
        LINE,
        write("array", 0, 0.001),
        LINE,
    ),
    "an array replaced": (
        of_world(lambda w, x, e: x @ w.array),
        LINE,
        change("array", np.ones(2) / 99),
        LINE,
    ),
    "a matrix written": (
        lambda w: by_motion(lambda x, e: x @ w.matrix.T),
        LINE,
        write("matrix", (1, 1), 0.9),
        LINE,
    ),
    "a matrix of the motion written": (
        lambda w: celnav.ukf(celnav.Motion(w.matrix, Q), GPS),
        LINE,
        write("matrix", (1, 1), 0.9),
        LINE,
    ),
    "a table replaced": (
        of_world(lambda w, x, e: w.table.get(e.k, 0.0)),
        LINE,
        change("table", {40: 1.0}),
        LINE,
    ),
    "a branch": (of_world(lambda w, x, e: 0.1 if w.late else 0.0), LINE, change("late", 1.0), LINE),
    "a function replaced": (
        lambda w: push(lambda x, e: getattr(w, "model", lambda t: 0.0)(e.t)),
        LINE,
        change("model", lambda t: 0.1 * np.sin(t)),
        LINE,
    ),
    "other intervals": (
        of_world(lambda w, x, e: 0.1 * e.dt),
        LINE,
        nothing,
        LINE | {"times": TWICE},
    ),
    "other intervals, a branch": (
        of_world(lambda w, x, e: 0.1 if e.dt > 1.5 else 0.0),
        LINE,
        nothing,
        LINE | {"times": TWICE},
    ),
    "intervals that vary": (
        of_world(lambda w, x, e: np.where(e.dt < 0.5, 1.0, 0.0)),
        LINE,
        nothing,
        LINE | {"times": UNEVEN},
    ),
    "later times": (of_world(lambda w, x, e: {120: 5.0}.get(e.k, 0.0)), LINE, nothing, LONGER),
    "later times, where": (
        of_world(lambda w, x, e: np.where(e.k == 120, 5.0, 0.0)),
        LINE,
        nothing,
        LONGER,
    ),
    "more runs": (of_world(lambda w, x, e: 0.01 * x[..., 1]), LINE, nothing, with_runs(5)),
    "as many runs as a vector": (
        of_world(lambda w, x, e: 0.01 * x[..., 1]),
        LINE,
        nothing,
        with_runs(8),
    ),
    "one run": (of_world(lambda w, x, e: 0.01 * x[..., 1]), LINE, nothing, with_runs(1)),
    "no runs": (of_world(lambda w, x, e: 0.01 * x[..., 1]), LINE, nothing, ALONE),
    "runs at last": (of_world(lambda w, x, e: 0.01 * x[..., 1]), ALONE, nothing, LINE),
    "a gain of each run": (
        of_world(lambda w, x, e: np.array([0.0, 0.1, 0.2]) * w.late),
        LINE,
        change("late", 1.0),
        LINE,
    ),
    "gaps": (of_world(lambda w, x, e: 0.01 * np.sin(x[..., 1])), LINE, nothing, IN_GAPS),
    "no measurements": (
        of_world(lambda w, x, e: 0.01 * x[..., 1]),
        LINE,
        nothing,
        {"prior": START, "times": TIMES},
    ),
    "another prior": (
        of_world(lambda w, x, e: 0.01 * np.cos(x[..., 1])),
        LINE,
        nothing,
        OTHER_PRIOR,
    ),
    "another prior, nan": (
        of_world(lambda w, x, e: np.where(np.isnan(np.sqrt(35 - x[..., 0])), 0.1, 0.0)),
        LINE | {"times": TIMES[:20], "z": POSITIONS[:20]},
        nothing,
        OTHER_PRIOR,
    ),
}


@functools.cache
def both_by_numpy(name):
    """Both runs with numpy, each with a new filter."""
    make, first, changed, second = KEPT[name]
    world = World()
    filter = make(world)
    known = attempt(filter, first, "numpy")
    changed(world)
    return known, attempt(filter, second, "numpy")


@pytest.mark.parametrize("again", ["kept", "compiled", "auto"])
@pytest.mark.parametrize("name", KEPT)
def test_a_second_flight_is_as_right_as_the_first(name, again):
    make, first, changed, second = KEPT[name]
    by_numpy, known = both_by_numpy(name)
    world = World()
    filter = make(world)
    kept = celnav.compiled(filter) if again == "kept" else None

    def fly(given):
        if kept is None:
            return attempt(filter, given, again)
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                return kept.run(**given)
            except Exception as error:
                return error

    before = fly(first)
    if isinstance(before, celnav.Track):
        assert_equal(by_numpy, before)
    else:
        assert_refused(before, None)
    changed(world)
    found = fly(second)
    assert isinstance(known, celnav.Track), known
    if isinstance(found, celnav.Track):
        assert_equal(known, found)
    else:
        assert again != "auto", f"{type(found).__name__}: {found}"
        assert isinstance(found, CannotCompile), f"{type(found).__name__}: {found}"


def test_there_are_traps_enough():
    assert len(CASES) > 160
