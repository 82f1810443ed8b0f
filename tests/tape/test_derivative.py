"""Derivatives by the chain rule, compared with complex steps and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from taped import FUNCTIONS, inputs, values

from celnav.tape.derivative import along, at_zero
from celnav.tape.numbers import each_row
from celnav.tape.tape import Tape

STEP = 1e-200


def slopes(function, point):
    """A function's value at a point, and its Jacobian, from a tape."""
    tape = Tape()
    (center,) = inputs(tape, np.shape(point), absent=False)
    y = np.asanyarray(function(center + along(center, [np.eye(len(point))])[0][0]))
    value, slope = at_zero(y)
    with np.errstate(all="ignore"):
        return values(Padded(tape), point, value), values(Padded(tape), point, slope)


class Padded:
    """A tape whose variables are 0."""

    def __init__(self, tape):
        self.ops = [("const", 0.0) if op[0] == "var" else op for op in tape.ops]


def complex_slopes(function, point):
    """The same by complex steps [Squire & Trapp 1998]."""
    columns = [
        np.asarray(function(point + 1j * STEP * unit)).imag / STEP for unit in np.eye(len(point))
    ]
    return np.asarray(function(point)), np.stack(columns, -1)


POINT = np.array([0.7, -0.4, 1.9])
ANALYTIC = {
    "sum": lambda x: x.sum(),
    "difference": lambda x: x[0] - x[1:],
    "product": lambda x: x[0] * x,
    "quotient": lambda x: x[0] / x,
    "inverse": lambda x: 1.0 / x,
    "negative": lambda x: -x,
    "square": np.square,
    "cube": lambda x: x**3,
    "inverse square": lambda x: x**-2,
    "sine": np.sin,
    "cosine": np.cos,
    "tangent": np.tan,
    "exponential": np.exp,
    "two to": np.exp2,
    "less one": np.expm1,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "arctangent": np.arctan,
    "arcsine": lambda x: np.arcsin(x[:2]),
    "arccosine": lambda x: np.arccos(x[:2]),
    "root": lambda x: np.sqrt(x[[0, 2]]),
    "logarithm": lambda x: np.log(x[[0, 2]]),
    "to the base 2": lambda x: np.log2(x[[0, 2]]),
    "to the base 10": lambda x: np.log10(x[[0, 2]]),
    "of one more": lambda x: np.log1p(x),
    "power": lambda x: x[[0, 2]] ** 0.3,
    "root cubed": lambda x: x[[0, 2]] ** 1.5,
    "number to a power": lambda x: 2.0**x,
    "power of two": lambda x: x[0] ** x,
    "length": lambda x: np.sqrt(np.square(x).sum()),
    "unit": lambda x: x / np.sqrt(np.square(x).sum()),
    "matrix": lambda x: np.tri(3) @ x,
    "quadratic": lambda x: x @ np.tri(3) @ x,
    "outer": lambda x: x[:, None] * x,
    "chain": lambda x: np.exp(-(np.sin(x) ** 2)) * np.log1p(x[0] ** 2),
    "a constant": lambda x: 0.0 * x + 3.0,
    "itself": lambda x: x,
    "zero times": lambda x: np.zeros(3) * x,
}


@pytest.mark.parametrize("name", ANALYTIC)
def test_derivatives_are_exact(name):
    expected, found = complex_slopes(ANALYTIC[name], POINT), slopes(ANALYTIC[name], POINT)
    for x, y in zip(found, expected, strict=True):
        if x.size:  # what does not depend on the point has no column
            np.testing.assert_allclose(x, np.real(y), rtol=1e-13, atol=1e-14)


CLOSED = {
    "absolute": (np.abs, np.diag([1.0, -1.0, 1.0])),
    "hypot": (lambda x: np.hypot(x[0], x[1]), np.array([0.7, -0.4, 0.0]) / np.hypot(0.7, 0.4)),
    "angle": (lambda x: np.arctan2(x[0], x[1]), np.array([-0.4, -0.7, 0.0]) / (0.7**2 + 0.4**2)),
    "angle to what is known": (
        lambda x: np.arctan2(x[0], 2.0),
        np.array([2.0, 0.0, 0.0]) / (0.7**2 + 4.0),
    ),
    "angle of what is known": (
        lambda x: np.arctan2(2.0, x[0]),
        np.array([-2.0, 0.0, 0.0]) / (0.7**2 + 4.0),
    ),
    "sign of another": (lambda x: np.copysign(x[0], x[1]), [-1.0, 0.0, 0.0]),
    "cube root": (lambda x: np.cbrt(x[:1]), [[0.7 ** (-2.0 / 3.0) / 3.0, 0.0, 0.0]]),
    "largest": (lambda x: np.maximum(x[0], x[2]), [0.0, 0.0, 1.0]),
    "smallest": (lambda x: np.minimum(x[0] ** 2, x[2]), [1.4, 0.0, 0.0]),
    "clipped": (lambda x: np.clip(x, -0.5, 0.5), np.diag([0.0, 1.0, 0.0])),
    "chosen": (lambda x: np.where(x > 0.0, x**2, -x), np.diag([1.4, -1.0, 3.8])),
    "chosen by truth": (lambda x: (x > 0.0) * x, np.diag([1.0, 0.0, 1.0])),
    "floor": (lambda x: x - np.floor(x), np.eye(3)),
    "remainder": (lambda x: (x + np.pi) % (2.0 * np.pi), np.eye(3)),
}


@pytest.mark.parametrize("name", CLOSED)
def test_derivatives_where_there_are_branches(name):
    function, expected = CLOSED[name]
    value, slope = slopes(function, POINT)
    np.testing.assert_allclose(value, function(POINT), rtol=1e-13)
    np.testing.assert_allclose(slope, expected, rtol=1e-13, atol=1e-14)


def test_loops_over_rows():
    def row(x):
        return np.stack(
            [np.sin(x[..., 0]) * x[..., 1], x[..., 1] / x[..., 2], 0.0 * x[..., 0] + 1.0], -1
        )

    def whole(x, each=lambda function, rows: function(rows)):
        return each(row, np.stack([x, x[::-1] ** 2, np.array([1.0, 2.0, 3.0]) + x[0]]))

    def rolled(x):
        y = whole(x, lambda function, rows: each_row(function, rows, least=0))
        assert any(op[0] == "call" for op in x.flat[0].tape.ops)
        return y

    for mine, exact in zip(slopes(rolled, POINT), complex_slopes(whole, POINT), strict=True):
        np.testing.assert_allclose(mine, exact, rtol=1e-14, atol=1e-15)


def test_a_loop_over_what_does_not_change_stays_one():
    tape = Tape()
    center, other = inputs(tape, (2,), (3, 2), absent=False)
    x = center + along(center, [np.eye(2)])[0][0]
    value, slope = at_zero(
        x + each_row(lambda rows: rows[..., ::-1] * np.cos(rows), other, least=0)[1]
    )
    assert {tape.ops[i][0] for i in tape.needed(list(value.flat))} >= {"call", "part"}
    np.testing.assert_array_equal(slope.astype(float), np.eye(2))


def test_what_is_far_away_has_no_part():
    """A branch that is not selected may be infinite there."""
    point = np.array([-1.0, 4.0])
    np.testing.assert_allclose(
        slopes(lambda x: np.where(x > 0.0, np.sqrt(np.abs(x)), 2.0 * x), point)[1],
        np.diag([2.0, 0.25]),
    )
    value, slope = slopes(lambda x: np.where(x > 0.0, np.log(x), x), point)
    np.testing.assert_allclose(value, [-1.0, np.log(4.0)])
    np.testing.assert_allclose(slope, np.diag([1.0, 0.25]))


def test_what_does_not_depend_on_the_variables():
    tape = Tape()
    (x,) = inputs(tape, (2,))
    along(x, [np.eye(2, 3)])
    value, slope = at_zero(np.sin(x))
    assert slope.shape == (2, 3)
    assert not np.asarray(slope, float).any()
    np.testing.assert_allclose(values(Padded(tape), [0.1, 0.2], value), np.sin([0.1, 0.2]))
    value, slope = at_zero(np.ones((2, 2)))
    assert (value == 1.0).all()
    assert slope.shape == (2, 2, 0)


def test_every_operation_that_has_a_slope_has_been_tried():
    """By name, so that new operations are not forgotten."""
    tape, done = Tape(), set()
    for name, function in (
        ANALYTIC | {name: function for name, (function, _) in CLOSED.items()}
    ).items():
        tape = Tape()
        (center,) = inputs(tape, (3,), absent=False)
        function(center + along(center, [np.eye(3)])[0][0])
        done |= {op[0] for op in tape.ops}
        assert name
    assert set(FUNCTIONS) - done <= {
        "eq",
        "ne",
        "le",
        "and",
        "or",
        "not",
        "rint",
        "pow2",
        "exponent",
    }
