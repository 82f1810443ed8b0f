"""Loops over rows give the same values as unrolled code, whatever the rows have in common."""

from __future__ import annotations

import numpy as np
import pytest
from test_llvm import computed

from celnav.gaussian import recorded
from celnav.tape import llvm, numbers
from celnav.tape.numbers import TracedArray, each_row, rarely
from celnav.tape.tape import Tape, TracedScalar

RUNS = 11


@pytest.fixture(autouse=True)
def _everything_rolled(monkeypatch):
    monkeypatch.setattr(recorded, "LONG", 0)
    monkeypatch.setattr(recorded, "LONG_SOLUTION", 0)
    monkeypatch.setattr(numbers, "LONG_PRODUCT", 0)
    fresh = llvm.aligned

    def nothing(shape):
        memory = fresh(shape)
        memory.fill(np.nan)  # what was not written is seen
        return memory

    monkeypatch.setattr(llvm, "aligned", nothing)


def inputs(tape, *shape):
    """Numbers of a shape, the next inputs of a tape."""
    x = TracedArray(shape)
    for at in np.ndindex(*shape):
        x[at] = tape.input()
    return x


def values(count, seed=0):
    return np.random.default_rng(seed).standard_normal((count, RUNS))


def calls(tape):
    return [op[1] for op in tape.ops if op[0] == "call"]


def flown(tape, y, given, lanes=8, fused=True):
    out = np.asarray(y, object).ravel().tolist()
    return computed(tape, [tape.lift(x) for x in out], given, lanes, fused).reshape(
        *np.shape(y), RUNS
    )


def model(x, w, scale):
    """A model of rows ``(p, 3)`` and ``(p, 1)``: sines, a length, a choice, a constant, and an
    operation that all rows share.
    """
    length = np.sqrt(np.sum(np.square(x), -1, keepdims=True) + np.square(w))
    chosen = np.where(x[..., :1] > 0.0, scale * np.sin(x[..., 1:2]), np.exp(-np.abs(x[..., 2:])))
    shared = np.broadcast_to(scale, (*x.shape[:-1], 1)) if np.ndim(scale) == 0 else scale
    return np.concatenate([length, chosen, x[..., 1:2], 0.0 * x[..., :1] + 2.5, shared], -1)


@pytest.mark.parametrize("fused", [False, True])
@pytest.mark.parametrize("lanes", [1, 4, 8])
def test_each_row(lanes, fused):
    given = values(7 * 3 + 7 + 1)
    tape = Tape()
    x, w, scale = inputs(tape, 7, 3), inputs(tape, 7, 1), inputs(tape)[()]
    y = each_row(lambda x, w: model(x, w, scale), x, w, least=0)
    (routine,) = calls(tape)
    assert routine.stages[0].rows == 7
    expected = model(
        given[:21].reshape(7, 3, RUNS).transpose(2, 0, 1),
        given[21:28].T[..., None],
        given[28][:, None, None] * np.ones((RUNS, 7, 1)),
    )
    np.testing.assert_allclose(
        flown(tape, y, given, lanes, fused).transpose(2, 0, 1), expected, rtol=1e-14, atol=1e-15
    )


def test_short_code_is_written_out_and_a_tape_may_ask_for_that():
    for tape, least in ((Tape(), 10_000), (Tape(rolled=False), 0)):
        x = inputs(tape, 4, 3)
        y = each_row(lambda x: np.cumsum(x, -1), x, least=least)
        assert not calls(tape)
        given = values(12)
        expected = np.cumsum(given.reshape(4, 3, RUNS), 1)
        np.testing.assert_allclose(flown(tape, y, given), expected, rtol=1e-15)


def test_a_loop_is_compiled_once_and_its_size_does_not_depend_on_the_rows():
    def lines(rows):
        tape = Tape()
        x = inputs(tape, rows, 2)
        y = each_row(lambda x: np.sin(x) + np.cos(x[..., ::-1]), x, least=0)
        z = each_row(lambda x: np.sin(x) + np.cos(x[..., ::-1]), y, least=0)
        first, second = calls(tape)
        assert first == second
        assert repr(first) == repr(second)
        assert hash(first) == hash(second)
        kernel = llvm.Kernel(tape, [("own", i) for i in range(2 * rows)], [], list(z.flat))
        assert kernel.cells == 2 * first.cells == 8 * rows
        text = llvm.source(kernel, 4, True)
        assert text.count("define internal void @r") == 1
        return text[text.index("define internal void @r") : text.index("define void @step")].count(
            "\n"
        )

    assert lines(3) == lines(30)


def test_loops_of_other_code_are_others():
    tape = Tape()
    x = inputs(tape, 4, 2)
    each_row(np.sin, x, least=0), each_row(np.cos, x, least=0), each_row(np.sin, x[:3], least=0)
    assert len(set(calls(tape))) == 3


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (3, 3), (4, 2), (5, 9), (9, 21)])
@pytest.mark.parametrize("pattern", ["full", "lower", "holes", "empty rows"])
def test_factorization(shape, pattern):
    n, q = shape
    rng = np.random.default_rng(n + q)
    there = np.ones(shape, bool)
    if pattern == "lower":
        there = np.tril(there)
    elif pattern == "holes":
        there = rng.random(shape) < 0.5
    elif pattern == "empty rows":
        there[::2] = False
    given = values(n * q, seed=q) * np.geomspace(1.0, 1e-6, n * q)[:, None]
    tape = Tape()
    A = inputs(tape, n, q)
    A[~there] = 0.0
    L = flown(tape, recorded.tria(A), given).transpose(2, 0, 1)
    assert calls(tape) or not there.any()
    dense = np.where(there, given.reshape(n, q, RUNS).transpose(2, 0, 1), 0.0)
    assert (np.triu(L, 1) == 0.0).all()
    assert (L.diagonal(0, 1, 2) >= 0.0).all()
    size = np.sqrt(np.square(dense).sum(-1))
    error = np.abs(L @ L.mT - dense @ dense.mT)
    assert (error <= 1e-13 * size[:, :, None] * size[:, None, :]).all()


@pytest.mark.parametrize("most", [0, 10_000], ids=["loop", "written out"])
def test_a_product_with_its_own_transpose(monkeypatch, most):
    monkeypatch.setattr(numbers, "LONG_PRODUCT", most)
    monkeypatch.setattr(recorded, "LONG_PRODUCT", most)
    given, tape = values(5 * 7, seed=4), Tape()
    A = inputs(tape, 5, 7)
    A[np.triu_indices(5, 3, 7)] = 0.0
    P = recorded.outer(A)
    assert len(calls(tape)) == (1 if most == 0 else 0)
    if most:  # one product for each pair of entries in the lower triangle that are not zero
        full = np.tril(np.ones((5, 7)), 2)
        assert sum(op[0] == "mul" for op in tape.ops) == np.tril(full @ full.T).sum()
    dense = np.tril(given.reshape(5, 7, RUNS).transpose(2, 0, 1), 2)
    P = flown(tape, P, given).transpose(2, 0, 1)
    np.testing.assert_allclose(P, dense @ dense.mT, rtol=1e-13, atol=1e-13)


def test_a_factorization_of_zeros_that_are_known_only_later():
    given = np.zeros((12, RUNS))
    given[:, 1] = np.random.default_rng(0).standard_normal(12)
    given[[0, 4, 8], 2] = -2.0
    tape = Tape()
    L = flown(tape, recorded.tria(inputs(tape, 3, 4)), given)
    assert (L[..., 0] == 0.0).all()
    assert np.isfinite(L).all()
    np.testing.assert_allclose(L[..., 2], [[2.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.0, 0.0]])


@pytest.mark.parametrize("lanes", [1, 8])
def test_products_and_triangular_systems(lanes):
    n, k = 6, 4
    given = values(n * n + n * k, seed=3)
    given[: n * n : n + 1] += 5.0
    tape = Tape()
    A, B = inputs(tape, n, n), inputs(tape, n, k)
    L = A.copy()
    L[np.triu_indices(n, 1)] = 0.0
    product, solved = A @ B, recorded.solve_lower(L, B)
    assert len(calls(tape)) == 2
    a, b = (
        given[: n * n].reshape(n, n, RUNS).transpose(2, 0, 1),
        given[n * n :].reshape(n, k, RUNS).transpose(2, 0, 1),
    )
    np.testing.assert_allclose(
        flown(tape, product, given, lanes).transpose(2, 0, 1), a @ b, rtol=1e-13, atol=1e-13
    )
    np.testing.assert_allclose(
        flown(tape, solved, given, lanes).transpose(2, 0, 1),
        np.linalg.solve(np.tril(a), b),
        rtol=1e-11,
    )


@pytest.mark.parametrize("fused", [False, True])
@pytest.mark.parametrize("lanes", [1, 4, 8])
def test_what_is_rarely_needed_is_a_routine_with_routines_of_its_own(lanes, fused):
    n = 3
    given = values(2 * n * n + 1, seed=5)
    tape = Tape()
    A, B, c = inputs(tape, n, n), inputs(tape, n, n), inputs(tape)[()]
    (found,) = rarely(c > 0.0, lambda A, B: (A @ B @ A,), (A, B), (A,))
    (routine,) = calls(tape)
    assert routine.rare
    assert len(inner := calls(routine.stages[0].tape)) == 2
    assert routine.cells == routine.own_cells + sum(each.cells for each in inner)
    a, b = (part.reshape(n, n, RUNS).transpose(2, 0, 1) for part in np.split(given[:-1], 2))
    expected = np.where((given[-1] > 0.0)[:, None, None], a @ b @ a, a)
    np.testing.assert_allclose(
        flown(tape, found, given, lanes, fused).transpose(2, 0, 1), expected, rtol=1e-13
    )


@pytest.mark.parametrize("lanes", [1, 4, 8])
def test_what_is_rarely_needed_is_skipped_where_no_run_of_a_vector_needs_it(lanes):
    given = np.ones((2, RUNS))
    given[1] = -1.0
    given[1, 9] = 1.0
    tape = Tape()
    x, c = inputs(tape, 1, 1), inputs(tape)[()]
    rarely(c > 0.0, lambda x: (2.0 * x,), (x,), (x,))
    (part,) = (i for i, op in enumerate(tape.ops) if op[0] == "part")
    left = flown(tape, np.array([TracedScalar(tape, part)], object), given, lanes)[0]
    first = 9 // lanes * lanes
    assert left[9] == 2.0
    assert np.isnan(left[:first]).all()  # memory that was not written
    assert (left[first : first + lanes] == 2.0).all()


def test_what_is_rarely_needed_is_written_out_where_a_tape_asks_for_that():
    tape = Tape(rolled=False)
    x, c = inputs(tape, 2, 2), inputs(tape)[()]
    (found,) = rarely(c > 0.0, lambda x: (x + 1.0,), (x,), (x,))
    assert not calls(tape)
    given = values(5)
    expected = np.where(given[4] > 0.0, given[:4] + 1.0, given[:4]).reshape(2, 2, RUNS)
    np.testing.assert_array_equal(flown(tape, found, given), expected)
    known = np.eye(2), np.zeros((2, 2))
    np.testing.assert_array_equal(
        rarely(np.array(True), lambda x: (x,), known[:1], known[1:])[0], np.eye(2)
    )
