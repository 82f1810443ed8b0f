"""Numpy's functions of numbers without values, compared with the same functions of floats."""

from __future__ import annotations

import copy
import math
import pickle
import re
from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from taped import inputs, recorded

from celnav.gaussian.linalg import present
from celnav.tape.numbers import TracedArray, in_model
from celnav.tape.numbers import recorded as as_recorded
from celnav.tape.tape import MOST, CannotCompile, Tape, TracedScalar, emit

NAN, INF = np.nan, np.inf
X = np.array([0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.7, 7.0, -7.0, 1e-5, 1e100, INF, -INF, NAN])
PLAIN = X[np.isfinite(X)]
RNG = np.random.default_rng(7)
V, W, M, S, T = (RNG.standard_normal(shape) for shape in ((4,), (4,), (3, 4), (3, 3), (2, 3, 3)))
HOLES = np.where(np.eye(3, 4) > 0.0, NAN, M)
ONE = """absolute fabs negative positive sqrt square reciprocal floor ceil sin cos tan arcsin arccos arctan exp log sinh cosh tanh
exp2 log2 log10 log1p expm1 cbrt isfinite isnan isinf logical_not conjugate deg2rad rad2deg radians degrees"""
TWO = """add subtract multiply divide arctan2 copysign maximum minimum fmax fmin less less_equal greater greater_equal equal
not_equal logical_and logical_or"""


def swapped(function, y, x):
    return function(x, y)


def assert_alike(function, *arrays, rtol=1e-13):
    with np.errstate(all="ignore"):
        expected = np.asarray(function(*arrays), float)
    found = recorded(function, *arrays)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=rtol)


@pytest.mark.parametrize("name", ONE.split())
def test_functions_of_one_number(name):
    assert_alike(getattr(np, name), X)


@pytest.mark.parametrize("name", TWO.split())
def test_functions_of_two_numbers(name):
    function = getattr(np, name)
    assert_alike(function, *(x.ravel() for x in np.meshgrid(X, X)))
    for known in (2.0, -0.5, 3):
        assert_alike(partial(function, known), X)
        assert_alike(partial(swapped, function, known), X)


@pytest.mark.parametrize("known", [NAN, INF])
@pytest.mark.parametrize(
    "name", ["maximum", "minimum", "fmax", "fmin", "less", "less_equal", "equal", "not_equal"]
)
def test_what_is_known_may_be_nan(name, known):
    assert_alike(partial(getattr(np, name), known), X)
    assert_alike(partial(swapped, getattr(np, name), known), X)


@pytest.mark.parametrize("power", [-8, -3, -2, -1, 0, 1, 2, 3, 8, 9, 20, 0.3, -0.7])
def test_powers(power):
    assert_alike(lambda x: x**power, X)
    assert_alike(lambda x: np.float_power(x, power), X)


@pytest.mark.parametrize("power", [-2.5, -1.5, -0.5, 0.5, 1.5, 2.5])
def test_powers_of_roots(power):
    assert_alike(lambda x: x**power, np.array([1e-3, 0.5, 1.0, 7.0, -1.0, INF, NAN]))


def test_powers_that_are_numbers():
    assert_alike(lambda x: 2.0**x, X)
    assert_alike(
        lambda x, y: x**y,
        *(x.ravel() for x in np.meshgrid([0.5, 1.0, 3.0, NAN], [-1.5, 0.0, 2.0, NAN])),
    )


def test_hypot_and_sign_and_remainders():
    assert_alike(np.hypot, *(x.ravel() for x in np.meshgrid(PLAIN, PLAIN)))
    assert_alike(np.sign, X[~np.isnan(X)])
    some = np.array([0.0, 1.0, -1.0, 3.2, -3.2, 100.0, -100.0])
    for period in (0.7, -0.7, 2.0 * np.pi, 360.0):
        assert_alike(partial(swapped, np.mod, period), some, rtol=1e-12)
    assert_alike(np.remainder, some, some[::-1] + 0.3, rtol=1e-12)


WHOLE = {
    "quotients": lambda x, y: np.floor(x / y),
    "known quotients": lambda x, _y: np.floor(x / 49.0),
    "known halves": lambda x, _y: x / 0.25,
    "remainders": lambda x, y: x % y,
    "known remainders": lambda x, _y: x % 0.1,
    "floor divisions": lambda x, y: x // y,
    "known floor divisions": lambda x, _y: x // 0.1,
    "divmod": lambda x, y: np.stack(np.divmod(x, y)),
    "fmod": np.fmod,
    "trunc": lambda x, y: np.trunc(x / y),
    "ceil": lambda x, y: np.ceil(x / y),
    "sign": lambda x, _y: np.sign(x),
    "heaviside": np.heaviside,
    "plus zero": lambda x, _y: x + 0.0,
    "less zero": lambda x, _y: x - 0.0,
    "from zero": lambda x, _y: 0.0 - x,
    "lengths": lambda x, _y: np.hypot(x, 1e-300),
}


@pytest.mark.parametrize("name", WHOLE)
def test_what_may_become_another_whole_number_is_that_of_numpy(name):
    """To the last bit, with the sign of zero: multiples of a period, their neighbors, and unusual
    numbers.
    """
    period = np.repeat([49.0, 0.1, 0.7, -0.3, 7.0], 100)
    multiples = period * np.tile(np.arange(100.0), 5)
    x = np.concatenate([multiples, *(np.nextafter(multiples, s) for s in (-INF, INF)), -multiples])
    grid = np.array(np.meshgrid(X, X)).reshape(2, -1)
    x, y = np.concatenate([x, grid[0]]), np.concatenate([np.tile(period, 4), grid[1]])
    with np.errstate(all="ignore"):
        expected = WHOLE[name](x, y)
    found = recorded(partial(in_model, WHOLE[name]), x, y)
    np.testing.assert_array_equal(found, expected)
    there = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(found)[there], np.signbit(expected)[there])


REDUCED = {
    "sum": np.sum,
    "sum of an axis": lambda x: x.sum(0),
    "sum kept": lambda x: x.sum(-1, keepdims=True),
    "sum with a start": lambda x: np.sum(x, 1, initial=0.5),
    "sum of nothing": lambda x: x[:0].sum(0),
    "product": lambda x: x.prod(1),
    "mean": lambda x: x.mean(),
    "mean of an axis": lambda x: np.mean(x, 0),
    "deviation": lambda x: x.std(1),
    "deviation of a sample": lambda x: np.std(x, 0, ddof=1),
    "variance": np.var,
    "largest": np.max,
    "largest of an axis": lambda x: x.max(1),
    "smallest": lambda x: np.min(x, 0),
    "largest with a start": lambda x: np.max(x, 1, initial=0.5),
    "range": lambda x: np.ptp(x, 1),
    "fmax": lambda x: np.fmax.reduce(x, 1),
    "any": lambda x: (x > 0.0).any(1),
    "any kept": lambda x: (x > 0.0).any(1, keepdims=True),
    "all": lambda x: (x > -1.0).all(),
    "all of an axis": lambda x: np.all(x > -1.0, 0),
    "any of floats": lambda x: np.any(x, 1),
    "any of none": lambda x: (x[:0] > 0.0).any(0),
    "count": lambda x: (x > 0.0).sum(1),
    "part": lambda x: (x > 0.0).mean(1),
    "running sum": lambda x: np.cumsum(x, 1),
    "running product": lambda x: x.cumprod(0),
    "running maximum": lambda x: np.maximum.accumulate(x, 1),
    "differences": lambda x: np.diff(x, axis=1),
    "trapezoids": lambda x: np.trapezoid(x, dx=0.1),
    "weighted": lambda x: np.average(x, 0, [1, 2, 3.0]),
}


@pytest.mark.parametrize("name", REDUCED)
def test_reductions(name):
    assert_alike(REDUCED[name], M)
    if "deviation" not in name:
        assert_alike(REDUCED[name], HOLES)


def test_reductions_over_several_axes():
    assert_alike(lambda x: x.sum((0, 2)), T)
    assert_alike(lambda x: x.mean((-1, -2)), T)
    assert_alike(lambda x: np.max(x, (0, 1)), T)


PRODUCTS = {
    "matrices": (lambda a, b: a @ b, S, M),
    "matrix and vector": (lambda a, b: a @ b, M, V),
    "vector and matrix": (lambda a, b: b @ a.T, M, V),
    "vectors": (lambda a, b: a @ b, V, W),
    "batch": (lambda a, b: a @ b, T, M),
    "batch on the right": (lambda a, b: a @ b, S, T),
    "known": (lambda a: np.tri(3) @ a, M),
    "known on the right": (lambda a: a @ np.tri(4), M),
    "vecdot": (np.vecdot, M, V),
    "dot": (np.dot, S, M),
    "inner": (np.inner, M, V),
    "outer": (np.outer, V, W),
    "tensordot": (lambda a, b: np.tensordot(a, b, 1), S, M),
    "trace": (np.trace, S),
    "cross": (lambda a: np.cross(a[0], a[1]), S),
    "ij,jk": (lambda a, b: np.einsum("ij,jk->ik", a, b), S, M),
    "transposed": (lambda a, b: np.einsum("ij,jk->ki", a, b), S, M),
    "...ij,...j": (lambda a, b: np.einsum("...ij,...j->...i", a, b), T, S[:2]),
    "...ij,jk": (lambda a, b: np.einsum("...ij,jk->...ik", a, b), T, S),
    "i,ij,j": (lambda a, b: np.einsum("i, ij, j ->", a, b, a), V[:3], S),
    "ij->j": (lambda a: np.einsum("ij->j", a), S),
    "ij->": (lambda a: np.einsum("ij->", a), S),
    "i,j->ij": (lambda a, b: np.einsum("i,j->ij", a, b), V, W),
    "...j->...": (lambda a: np.einsum("...j->...", a), T),
    "i...->...i": (lambda a: np.einsum("i...->...i", a), T),
    "known i": (lambda a: np.einsum("ij,jk->ik", np.tri(3), a), M),
    "optimize": (lambda a, b: np.einsum("ij,jk->ik", a, b, optimize=True), S, M),
    "solve": (np.linalg.solve, S, M),
    "inverse": (np.linalg.inv, S),
    "inverses": (np.linalg.inv, T),
    "solve for a vector": (np.linalg.solve, S, V[:3]),
    "solve a batch": (np.linalg.solve, T, S),
    "solve, a pivot in the last row": (lambda b: np.linalg.solve(np.eye(3)[::-1], b), S),
    "solve, permuted": (lambda b: np.linalg.solve(np.eye(3)[[1, 2, 0]], b), M),
    "solve, a zero pivot": (lambda a, b: np.linalg.solve(a * (1.0 - np.eye(3)), b), S, M),
    "inverse of one": (np.linalg.inv, S[:1, :1]),
    "length": (np.linalg.norm, V),
    "lengths": (lambda a: np.linalg.norm(a, axis=-1), M),
    "lengths kept": (lambda a: np.linalg.norm(a, 2, 0, True), M),
}


@pytest.mark.parametrize("name", PRODUCTS)
def test_products_and_systems(name):
    function, *arrays = PRODUCTS[name]
    assert_alike(function, *arrays, rtol=1e-11)


def test_a_system_that_has_no_solution_is_not_finite():
    assert not np.isfinite(
        recorded(np.linalg.solve, np.ones((2, 2)), np.array([[1.0], [2.0]]))
    ).any()


def written(x):
    y = np.zeros_like(x)
    y[0], y[1:, 1] = x[1], 2.0
    y[2] += x[0]
    y *= 2.0
    return y


def truth_in_floats(x):
    y = np.zeros_like(x)
    y[...] = x > 0.0
    return y + y


SHAPED = {
    "where": lambda x: np.where(x > 0.0, x, -1.0),
    "where of a column": lambda x: np.where(x[:, :1] > 0.0, x, x[0]),
    "where it is known": lambda x: np.where([True, False, True, False], x, 0.0),
    "where nan": lambda x: np.where(np.isnan(x), 0.0, x),
    "where a number": lambda x: np.where(x, 1.0, 2.0),
    "where of truth": lambda x: np.where(x > 0.0, x > 1.0, x < -1.0),
    "clip": lambda x: np.clip(x, -0.5, 0.5),
    "clip from below": lambda x: x.clip(min=0.0),
    "clip from above": lambda x: np.clip(x, None, 0.5),
    "joined": lambda x: np.concatenate([x, np.ones((3, 1))], 1),
    "stacked": lambda x: np.stack([np.zeros((3, 4)), x]),
    "blocks": lambda x: np.block([[x, np.zeros((3, 3))], [np.ones((1, 7))]]),
    "padded": lambda x: np.pad(x, 1),
    "rolled": lambda x: np.roll(x, 1),
    "repeated": lambda x: np.repeat(x, 2, 0),
    "tiled": lambda x: np.tile(x, 2),
    "flipped": lambda x: np.flip(x, 1),
    "split": lambda x: np.split(x, 2, 1)[1],
    "taken": lambda x: np.take(x, [2, 0], 1),
    "chosen": lambda x: x[[2, 0]][:, [1]],
    "crossed": lambda x: x[np.ix_([0, 2], [1, 3])],
    "broadcast": lambda x: np.broadcast_to(x, (2, 3, 4)),
    "moved": lambda x: np.moveaxis(x[None], 0, -1),
    "lower": np.tril,
    "diagonal": np.diag,
    "written": written,
    "filled": lambda x: np.full_like(x, 2.0) + x,
    "filled truth": lambda x: np.full_like(x > 0.0, 2.5) + np.full_like(x, x > 0.0),
    "copied": lambda x: np.copy(x) * 2.0,
    "array of rows": lambda x: np.array([x[0], x[1]]) * 2.0,
    "function of an array of rows": lambda x: np.exp(np.array([x[0], x[1]])),
    "array of numbers": lambda x: np.array([[v + 1.0 for v in row] for row in x]),
    "truth as numbers": lambda x: (x > 0.0).astype(float) * 2.0,
    "truth less truth": lambda x: 1 - (x > 0.0),
    "truth times": lambda x: (x > 0.0) * np.where(np.isnan(x), 1.0, x),
    "both": lambda x: (x > 0.0) & ~(x > 1.0) | (x < -1.0),
    "truth as weights": lambda x: (x > 0.0) @ np.ones(4),
    "single": lambda x: x * np.float32(0.5),
    "sinc": np.sinc,
    "polynomial": lambda x: np.polyval([1.0, 2.0, 3.0], x),
    "close": lambda x: np.isclose(x, x + 1e-9),
    "counts of truth": lambda x: (x > 0.0) * 1.0 + (x > -1.0) * 1.0,
    "running counts": lambda x: np.cumsum(x > 0.0, 1),
    "truth in floats": truth_in_floats,
    "truth beside floats": lambda x: np.stack([x > 0.0, x]) + np.stack([x > 0.0, x]),
    "either": lambda x: (x > 0.0) ^ (x > 1.0),
    "quotients where": lambda x: np.divide(1.0, x, out=np.zeros_like(x), where=x > 0.0),
    "selected": lambda x: np.select([x > 1.0, x > 0.0], [x, 2.0 * x], -1.0),
    "interpolated": lambda x: np.interp(x, [-1.0, 0.2, 0.5, 2.0], [1.0, 3.0, 2.0, 5.0]),
    "interpolated inside": lambda x: np.interp(x, [-1.0, 2.0], [1.0, 3.0], left=-7.0, right=9.0),
    "sorted": np.sort,
    "sorted columns": lambda x: np.sort(x, 0),
    "sorted whole": lambda x: np.sort(x, None),
    "median": np.median,
    "median of rows": lambda x: np.median(x, 1, keepdims=True),
    "median of columns": lambda x: np.median(x, axis=0),
    "nan as numbers": lambda x: np.nan_to_num(x / (x * x > 1.0), nan=3.0, posinf=7.0),
    "nan as numbers in place": lambda x: np.nan_to_num(x, copy=False) + x,
    "sums of exponentials": lambda x: np.logaddexp(x, x[:, :1]),
}


@pytest.mark.parametrize("name", SHAPED)
def test_choices_and_shapes(name):
    assert_alike(SHAPED[name], M)
    assert_alike(SHAPED[name], HOLES)


SINGLE = {
    "a number": lambda x: 2.0 * x + x**2 - 1.0 / x,
    "swapped": lambda x: 3.0 - x,
    "numpy's": lambda x: np.float64(2.0) * x - np.int64(1),
    "compared": lambda x: np.float64(2.0) > x,
    "functions": lambda x: np.hypot(np.sin(x), np.exp(-x)),
    "remainder": lambda x: x % 0.3,
    "array times": lambda x: np.arange(3.0) * x,
    "stacked": lambda x: np.stack([x, 1.0 + x]),
    "largest": lambda x: np.maximum(x, 0.1),
    "minus": lambda x: -abs(x),
    "swapped power": lambda x: 2.0**x,
    "sum": lambda x: sum([x, x, 1.0]),
    "floor division": lambda x: x // 0.3 + 3.0 // x,
    "divmod": lambda x: np.stack(divmod(x, 0.3) + divmod(2.0, x)),
    "whole": lambda x: round(2.0 * x) + math.floor(x) + math.ceil(x) + math.trunc(2.0 * x),
    "copied": lambda x: copy.deepcopy(x) + copy.copy(x),
    "half of truth": lambda x: (x > 0.0) * 0.5,
}


@pytest.mark.parametrize("name", SINGLE)
def test_one_number_by_itself(name):
    for x in (0.7, -0.7):
        assert_alike(lambda a: SINGLE[name](a[0]), np.array([x]))


# -- what a tape does without being asked ----------------------------------------------------------
def place(x):
    """Of a number on its tape."""
    return np.asarray(x)[()].i


def test_nothing_is_done_twice_and_what_is_known_at_once():
    tape = Tape()
    (x,) = inputs(tape, (2,))
    first = place(np.sin(x[0]) + x[1])
    count = len(tape.ops)
    assert place(np.sin(x[0]) + x[1]) == place(x[1] + np.sin(x[0])) == first
    assert len(tape.ops) == count
    for same in (
        x[0] * 1.0,
        x[0] + 0.0,
        x[0] - 0.0,
        np.negative(-x[0]),
        x[0] / 1.0,
        np.where(True, x[0], x[1]),
    ):
        assert place(same) == place(x[0])
    assert emit("sub", 2.0, 3.0) == -1.0
    assert x[0] * 0.0 == 0.0
    assert TracedArray((2,)) @ x == 0.0
    assert len(tape.ops) == count + 1  # -x


def test_only_what_is_asked_for_as_present_is_taken_to_be_there():
    tape = Tape()
    maybe, sure = tape.input(absent=True), tape.input()
    for x in (sure, maybe, maybe + sure, np.arccos(sure)[()]):
        assert isinstance(x == x, TracedScalar)
        assert isinstance(np.isnan(x)[()], TracedScalar)
    there = present(as_recorded([sure, np.arccos(sure)[()], maybe, maybe + sure, 1.0, NAN]))
    assert [type(x) is TracedScalar for x in there] == [False, False, True, True, False, False]
    assert [bool(there[i]) for i in (0, 1, 4, 5)] == [True, True, True, False]
    np.testing.assert_array_equal(present(np.array([1.0, NAN])), [True, False])


NOT_NUMBERS = {
    "arccos": lambda x: np.isnan(np.arccos(x)),
    "log": lambda x: np.log(x) != np.log(x),
    "root": lambda x: np.sqrt(x) == np.sqrt(x),
    "power": lambda x: np.isnan(x**0.3),
    "quotient": lambda x: np.isnan(x / x),
    "difference": lambda x: np.isnan(x - x),
    "product": lambda x: np.isnan(0.0 * np.log(x)),
    "a known product": lambda x: np.array([[0.0, 0.0]]) @ np.log(x)[:2],
    "a known dividend": lambda x: np.isnan(0.0 / x),
    "larger": lambda x: np.isnan(np.maximum(1.0, np.maximum(x, np.log(x)))),
    "smaller": lambda x: np.isnan(np.minimum(np.arcsin(x), x)),
    "finite": lambda x: np.isfinite(np.exp(1e3 * x)),
}


@pytest.mark.parametrize("name", NOT_NUMBERS)
def test_what_is_no_number_in_a_model_is_noticed_as_in_numpy(name):
    assert_alike(partial(in_model, NOT_NUMBERS[name]), X)


def test_a_known_zero_costs_nothing_of_what_is_finite():
    tape = Tape()
    (x,) = inputs(tape, (3,), absent=False)
    in_model(lambda x: np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ np.sin(x), x)
    assert len(tape.ops) == 6


def test_constants_that_are_not_alike_are_two():
    tape = Tape()
    assert len({tape.lift(x).i for x in (0.0, -0.0, 1.0, np.nan, np.inf, -np.inf)}) == 6
    assert tape.lift(np.nan).i == tape.lift(np.nan).i


def test_tapes_have_the_same_key_if_they_are_the_same():
    def key(factor):
        tape = Tape()
        (x,) = inputs(tape, (2,))
        np.exp(factor * x[0]) + x[1]
        return tape.key

    assert key(2.0) == key(2.0) != key(3.0)


REFUSED = {
    "if": (lambda x: 1.0 if x[0] > 0.0 else 2.0, "a branch depends on a number"),
    "float": (lambda x: float(x[0]), "is asked for as a float"),
    "index": (lambda x: [1.0, 2.0][x[0]], "asked for as an index or a whole number"),
    "svd": (lambda x: np.linalg.svd(x[:, None]), r"numpy\.linalg\.svd cannot be recorded"),
    "spacing": (np.spacing, r"numpy\.spacing cannot be recorded"),
    "sorted": (sorted, "a branch depends on a number"),
    "indices": (np.argsort, r"numpy\.argsort cannot be recorded; numpy\.where and arithmetic can"),
    "many": (lambda x: np.sort(np.tile(x, 40)), "numpy.sort is recorded for at most 64 numbers"),
    "equality": (lambda x: np.array_equal(x, x), r"numpy\.array_equal cannot be recorded"),
    "key": (lambda x: {50: 1.0}.get(x[0], 0.0), r"looked up in a dict.*put the table into u"),
    "member": (lambda x: x[0] in {50}, "looked up in a dict, a set or a cache"),
    "text": (lambda x: str(x[0]) == "50", "is written as text or bytes"),
    "formatted": (lambda x: f"{x[0]:.1f}", "is written as text or bytes"),
    "array as text": (str, "is written as text or bytes"),
    "bytes": (lambda x: x.tobytes(), "are written as bytes"),
    "pickle": (pickle.dumps, "is written as text or bytes"),
    "whole": (lambda x: int(x[0]), "asked for as an index or a whole number; put the table into u"),
    "mask": (lambda x: x[x > 0.0], "an index or a mask is known only when the filter runs"),
    "place": (lambda x: x[x[0]], "put a table that is looked up into u"),
    "written by mask": (lambda x: x.__setitem__(x > 0.0, 1.0), "choose by numpy.where"),
    "filled": (
        lambda x: np.empty(2).__setitem__(0, x[0]),
        r"numpy\.empty_like\(x\) makes an array",
    ),
    "bits": (
        lambda x: x[0] & 1,
        r"bitwise operations on integers are not recorded; k % 2 is the last bit",
    ),
    "sum of truth": (
        lambda x: (x[0] > 0.0) + (x[1] > 0.0),
        "another number in Python than in numpy",
    ),
    "inverted truth": (lambda x: ~(x[0] > 0.0), "another number in Python than in numpy"),
    "half precision": (lambda x: np.sin(x > 0.0), "of booleans does not give floats; multiply"),
    "single precision": (lambda x: np.add(x, x, dtype=np.float32), "as float64, not as float32"),
    "digits": (lambda x: round(x[0], 2), r"numpy\.rint is recorded of 1 operands only"),
    "fraction": (lambda x: x[0] == Fraction(1, 2), "recorded with floats, not with Fraction"),
    "kept": (lambda x: x[0] + Tape().input(), "a number of another recording"),
    "into floats": (
        lambda x: np.add(x, 1.0, out=np.zeros(2)),
        "is written into an array of floats",
    ),
    "norm of a matrix": (
        lambda x: np.linalg.norm(x[:, None] * x),
        r"numpy\.linalg\.norm is recorded for lengths of vectors only",
    ),
    "a part": (
        lambda x: np.sum(x, where=np.array([True, False])),
        "with where= cannot be recorded",
    ),
    "outer": (lambda x: np.add.outer(x, x), r"numpy\.add\.outer cannot be recorded"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_arithmetic_is_refused_with_its_line(name):
    function, why = REFUSED[name]
    (x,) = inputs(Tape(), (2,))
    with pytest.raises(CannotCompile) as caught:
        function(x)
    told, _, place = str(caught.value).partition(" (test_numbers.py, line ")
    assert re.search(why, told)  # not in the line itself, which holds the pattern too
    assert place


def test_a_tape_that_is_too_long_is_refused(monkeypatch):
    assert MOST > 100_000
    monkeypatch.setattr("celnav.tape.tape.MOST", 1000)
    inputs(Tape(), (1000,))
    with pytest.raises(CannotCompile, match="a step of more than 1000 operations"):
        inputs(Tape(), (1001,))


def test_what_holds_numbers_is_recognized():
    tape = Tape()
    (x,) = inputs(tape, (2,))
    assert type(as_recorded([x[0], 1.0])) is TracedArray
    assert type(as_recorded(x[0])) is TracedArray
    assert type(as_recorded(np.array([x[0], 1.0], object))) is TracedArray
    assert as_recorded([1.0, 2.0]) is None
    assert as_recorded(np.ones(2)) is None
    assert as_recorded(np.array([object()])) is None


MIXED = {
    "add": lambda a: a + a,
    "multiply": lambda a: a * a,
    "maximum": lambda a: np.maximum(a, a[::-1]),
    "negative": np.negative,
    "sum": np.sum,
    "dot": lambda a: a @ a,
    "matmul": lambda a: a.reshape(2, 3) @ a.reshape(3, 2),
}


@pytest.mark.parametrize("name", MIXED)
def test_truth_values_among_numbers_are_numbers(name):
    def mixed(x):
        both = np.empty(6) if type(x) is np.ndarray else np.empty(6, object).view(TracedArray)
        for i in range(3):
            both[i], both[3 + i] = (x > 0.0)[i], x[i]
        return MIXED[name](both)

    assert_alike(mixed, np.array([0.5, -1.0, 2.0]))


def test_what_is_known_is_folded_without_a_warning():
    with np.errstate(all="raise"):
        assert emit("div", 1.0, 0.0) == INF
        assert emit("log", 0.0) == -INF
        assert emit("exp", 1e4) == INF
        assert math.isnan(emit("sqrt", -1.0))
