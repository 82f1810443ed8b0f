"""Arguments that the checks accept, and their messages."""

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from celnav.gaussian.checks import choice, finite, function, instance, integer, number, numbers
from celnav.gaussian.spaces import EUCLIDEAN, Space

DATES = np.array(["2026-01-01", "2026-01-02"], "datetime64[s]")


@pytest.mark.parametrize(
    "value",
    [2, 2.0, np.float32(2), np.int8(2), np.array(2.0), Fraction(2), Decimal(2), np.ma.array(2.0)],
)
def test_a_number_may_come_as_any_real_scalar(value):
    assert number("x", value, 0, above=1.0, most=2.0) == 2.0
    assert type(number("x", value)) is float


@pytest.mark.parametrize("value", [3, 3.0, np.int64(3), np.float64(3), np.array(3)])
def test_an_integer_may_come_as_a_float(value):
    assert integer("n", value) == 3


@pytest.mark.parametrize(
    "value",
    [[1, 2], (1.0, 2.0), np.array([1, 2], np.uint8), np.ma.array([1.0, 2.0]), [Fraction(1), 2]],
)
def test_arrays_may_come_as_anything_numeric(value):
    assert finite("x", value, ("n",)).tolist() == [1.0, 2.0]


def test_what_is_masked_or_none_is_missing():
    assert np.isnan(numbers("z", np.ma.array([1.0, 2.0], mask=[0, 1]))).tolist() == [False, True]
    assert np.isnan(numbers("z", [1.0, None])).tolist() == [False, True]


@pytest.mark.parametrize(
    ("shape", "wanted", "fits"),
    [
        ((3,), (3,), True),
        ((), (), True),
        ((3,), (), False),
        ((2, 2), ("n", "n"), True),
        ((2, 3), ("n", "n"), False),
        ((0, 0), ("n", "n"), False),
        ((0, 3), (None, 3), True),
        ((6,), (..., 6), True),
        ((0, 4, 6), (..., 6), True),
        ((), (..., 6), False),
        ((6,), (..., 6, 6), False),
    ],
)
def test_shapes(shape, wanted, fits):
    if fits:
        assert finite("x", np.ones(shape), wanted).shape == shape
    else:
        with pytest.raises(ValueError, match="x: expected shape"):
            finite("x", np.ones(shape), wanted)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: number("x", None), "x: expected a finite number, got None"),
        (lambda: number("x", "1"), "x: expected a finite number, got '1'"),
        (lambda: number("x", np.nan, above=0), "x: expected a positive number, got nan"),
        (
            lambda: number("x", 2, 0, 1),
            "x: expected a number of at least 0 and of at most 1, got 2",
        ),
        (lambda: number("x", 1j), "x: expected a finite number, got 1j"),
        (lambda: number("x", []), r"x: expected a finite number, got \[\]"),
        (lambda: number("x", 10**400), "x: expected a finite number, got 1000"),
        (lambda: integer("n", 0.5), "n: expected a positive integer, got 0.5"),
        (
            lambda: integer("n", 10**9, 0, 100),
            "n: expected an integer from 0 to 100, got 1000000000",
        ),
        (lambda: finite("x", None), "x: expected numbers, got None"),
        (lambda: finite("x", [[1], [2, 3]]), "x: expected numbers, got"),
        (lambda: finite("x", np.array(["1", 2.0], object)), "x: expected numbers, got"),
        (lambda: finite("x", [1, 2j]), "x: expected numbers, got"),
        (lambda: finite("x", {"a": 1}), "x: expected numbers, got"),
        (lambda: finite("x", DATES), "x: expected numbers, got dates or durations; seconds are"),
        (
            lambda: finite("x", [1, 2], (..., "n", 2)),
            r"x: expected shape \(..., n, 2\), got \(2,\)",
        ),
        (lambda: finite("x", 1.0, (3,)), r"x: expected shape \(3,\), got \(\)"),
        (
            lambda: choice("side", "lefd", ["left", "right"]),
            "side: expected one of left, right, got 'lefd'; did you mean left?",
        ),
        (lambda: choice("side", np.zeros(2), [1, 2]), "side: expected one of 1, 2, got array"),
        (lambda: choice("side", None, ["left"]), "side: expected one of left, got None"),
        (
            lambda: function("f", np.eye(2), "(points, epoch)"),
            r"f: expected a function \(points, epoch\), got ndarray",
        ),
        (
            lambda: instance("space", Space, Space, "a Space"),
            "space: expected a Space, got class Space",
        ),
    ],
)
def test_messages_name_the_argument(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_what_is_right_is_handed_on():
    assert choice("degree", 3.0, [3, 5]) == 3
    assert function("f", len, "(x)") is len
    assert instance("space", EUCLIDEAN, Space, "angles([0])") is EUCLIDEAN
    given = np.ones(3)
    assert numbers("x", given) is given
    assert finite("x", given) is not given
