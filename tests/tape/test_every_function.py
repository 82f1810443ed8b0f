"""Every public function of numpy, recorded in a model, gives numpy's result or raises an error."""

from __future__ import annotations

import numpy as np
import pytest
from taped import inputs, values

from celnav.tape.numbers import in_model
from celnav.tape.tape import Tape

RNG = np.random.default_rng(3)
NICE = np.array([0.0, 1.0, -1.0, 2.0, -3.0, 0.5, -2.5, 3.5, 7.0, 49.0, 0.1, 0.3, -0.7])
ODD = np.concatenate([NICE, [1e200, -1e-200, np.inf, np.nan]])
T = np.array([-1.0, 0.0, 0.5, 2.0])
UNLIKE = ("empty_like", "full_like", "result_type", "min_scalar_type")
"""The first has no values, the second looks for a type in a list, the others tell that numbers are
objects.
"""
FUNCTIONS = {
    f"{space.__name__}.{name}": function
    for space in (np, np.linalg, np.fft)
    for name, function in vars(space).items()
    if type(function).__name__ in ("ufunc", "_ArrayFunctionDispatcher") and name not in UNLIKE
}
CALLS = {
    "x": lambda f, x, y: f(x),
    "x y": lambda f, x, y: f(x, y),
    "x y out": lambda f, x, y: f(x, y, np.ones_like(x)),
    "T x": lambda f, x, y: f(T, x),
    "x T": lambda f, x, y: f(x, T),
    "x T T^2": lambda f, x, y: f(x, T, T**2),
    "x 2": lambda f, x, y: f(x, 2.0),
    "x 0": lambda f, x, y: f(x, 0.0),
    "x 3": lambda f, x, y: f(x, 3),
    "x -1": lambda f, x, y: f(x, -1),
    "0.1 x": lambda f, x, y: f(0.1, x),
    "0 x": lambda f, x, y: f(0.0, x),
    "one": lambda f, x, y: f(x[0]),
    "two": lambda f, x, y: f(x[0], y[0]),
    "listed": lambda f, x, y: f([x, y]),
    "truth": lambda f, x, y: f(x > 0.0),
    "truths": lambda f, x, y: f(x > 0.0, y > 0.0),
    "truth y x": lambda f, x, y: f(x > 0.0, y, x),
    "conditions": lambda f, x, y: f([x > 0.0, x < -1.0], [y, x]),
    "mixed": lambda f, x, y: f(np.stack([x > 0.0, x]), np.stack([y > 0.0, y])),
    "matrix": lambda f, x, y: f(x[:, None] * y),
    "matrix first": lambda f, x, y: f(x[:, None] * y, axis=0),
    "matrix last": lambda f, x, y: f(x[:, None] * y, axis=-1, keepdims=True),
    "matrices": lambda f, x, y: f(np.diag(x) + 9.0, np.diag(y)),
    "matrix vector": lambda f, x, y: f(np.diag(x) + 9.0, y),
    "single": lambda f, x, y: f(x, dtype=np.float32),
    "whole": lambda f, x, y: f(x, dtype=int),
    "as truth": lambda f, x, y: f(x, dtype=bool),
    "where": lambda f, x, y: f(x, where=x > 0.0),
    "where out": lambda f, x, y: f(x, where=x > 0.0, out=np.ones_like(x)),
    "where two": lambda f, x, y: f(x, y, where=x > 0.0, out=np.ones_like(x)),
    "reduced": lambda f, x, y: f.reduce(x),
    "accumulated": lambda f, x, y: f.accumulate(x),
    "outer": lambda f, x, y: f.outer(x, y),
}


def parts(y):
    return [p for one in y for p in parts(one)] if isinstance(y, tuple | list) else [y]


def tried(function, call):
    """Whether the function is recorded, and compared at least once."""
    tape = Tape()
    x, y = inputs(tape, (4,), (4,))
    try:
        mine = in_model(lambda x, y: CALLS[call](function, x, y), x, y)
    except Exception:
        return False
    if tape.refusal is not None:  # numpy's loops over objects may forget an error
        return False
    pools = [NICE, ODD] if isinstance(function, np.ufunc) and function.signature is None else [NICE]
    compared = False
    for pool in [pool for pool in pools for _ in range(6)]:
        given = RNG.choice(pool, (2, 4), replace=False)
        given[1].sort()  # as knots are
        try:
            with np.errstate(all="ignore"):
                theirs = CALLS[call](function, *given.copy())  # it may be written into
        except (TypeError, ValueError, IndexError, np.linalg.LinAlgError):
            continue
        assert len(parts(mine)) == len(parts(theirs))
        for one, other in zip(parts(mine), parts(theirs), strict=True):
            if isinstance(other, np.ndarray | np.generic | float | int):
                with np.errstate(all="ignore"):
                    found = values(tape, given.ravel(), one)
                np.testing.assert_allclose(
                    found, np.asarray(other, float), rtol=1e-12, atol=1e-12, err_msg=call
                )
                compared = True
    return compared


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.filterwarnings("ignore")
def test_every_function_gives_what_numpy_gives_or_is_refused(name):
    for call in CALLS:
        tried(FUNCTIONS[name], call)


def test_the_comparison_is_not_one_with_nothing():
    for name in ("add", "fmod", "divide", "cumsum", "interp", "select", "sort", "median", "where"):
        assert any(tried(FUNCTIONS[f"numpy.{name}"], call) for call in CALLS)
