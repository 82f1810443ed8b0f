"""Every operation as machine code, against numpy: any number of lanes, with and without fused
products.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from taped import FUNCTIONS, inputs, values

from celnav.tape import llvm
from celnav.tape.numbers import in_model
from celnav.tape.tape import Tape, as_number, emit

pytest.importorskip("llvmlite")

OPTIMIZED = True  # machine code as users get it

NAN, INF = np.nan, np.inf
X = np.array(
    [
        0.0,
        -0.0,
        1.0,
        -1.0,
        0.5,
        -2.5,
        3.7,
        8.0,
        -7.0,
        1e-5,
        1e-310,
        -1e-310,
        1e300,
        -1e300,
        INF,
        -INF,
        NAN,
    ]
)
LANES, FUSED = [1, 4, 8], [False, True]
CELLS = 10_000
LOGICAL = ("and", "or", "not")
ALONE = [name for name, function in FUNCTIONS.items() if getattr(function, "nin", 3) == 1]


def addressed(kernel, lanes, fused):
    return llvm.compiled(llvm.source(kernel, lanes, fused), "step")


def flown(addresses, kinds, at, state, shared, own, kept, lanes):
    """Rows ``(stored, numbers, runs)`` of a run, and its final state ``(S, runs)``; runs are padded
    to full vectors.
    """
    runs = own.shape[-1]
    width = -(-runs // lanes) * lanes
    own = np.ascontiguousarray(np.pad(own, ((0, 0), (0, 0), (0, width - runs)), "edge"))
    wide = np.pad(state, ((0, 0), (0, width - runs)), "edge")
    blocks = np.ascontiguousarray(wide.reshape(len(state), -1, lanes).swapaxes(0, 1))
    rows = np.full((max(at) + 1, width, kept), -99.0)
    table = np.array(addresses, np.uint64), np.array(kinds, np.int32), np.array(at, np.int64)
    shared = np.ascontiguousarray(shared, float)
    cells = llvm.aligned((CELLS, lanes))
    fields = np.array([rows.ctypes.data], np.uint64)
    pointers = (x.ctypes.data for x in (*table, blocks, shared, own, fields, cells))
    llvm.run_loop()(
        *pointers,
        len(state),
        shared.shape[1],
        own.shape[1],
        width,
        0,
        width,
        lanes,
        0,
        width // lanes,
        len(own),
    )
    return rows[:, :runs].transpose(0, 2, 1), blocks.swapaxes(0, 1).reshape(len(state), -1)[
        :, :runs
    ]


def computed(tape, y, given, lanes, fused):
    """Values ``(O, runs)`` of the numbers ``(O,)`` for inputs ``(I, runs)``, computed by machine
    code.
    """
    kernel = llvm.Kernel(tape, [("own", i) for i in range(len(given))], [], list(y))
    state, shared = np.zeros((1, given.shape[1])), np.zeros((1, 1))
    return flown(
        [addressed(kernel, lanes, fused)], [0], [0], state, shared, given[None], len(y), lanes
    )[0][0]


def exactly(found, expected):
    """The same numbers, and the same signs of zeros."""
    np.testing.assert_array_equal(found, expected)
    there = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(found)[there], np.signbit(expected)[there])


PLAIN = [
    name for name in FUNCTIONS if name not in (*LOGICAL, *llvm.LIBM, "select", "pow2", "exponent")
]


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("name", PLAIN)
def test_operations(name, lanes):
    found, expected, _ = operated(name, lanes, True)
    exactly(found, expected)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("name", llvm.LIBM)
def test_functions(name, lanes):
    """Functions of the C library, and their versions as arithmetic; the latter give nan outside
    their range.
    """
    found, expected, _ = operated(name, lanes, False)
    np.testing.assert_allclose(found, expected, rtol=4e-16)
    zero = expected == 0.0
    np.testing.assert_array_equal(np.signbit(found[zero]), np.signbit(expected[zero]))
    found, expected, given = operated(name, lanes, True)
    far = np.zeros(len(expected), bool)
    if name in ("sin", "cos", "tan"):
        far = np.abs(given[0]) > 1e9
    if name == "pow":
        far = given[0] == -INF
    if name == "hypot":
        far = np.isnan(given).any(0)
    if name == "fmod":
        with np.errstate(all="ignore"):
            far = ~(np.abs(given[0] / given[1]) < 2.0**53)
    assert (np.isnan(found) | np.isclose(np.abs(found), np.abs(expected), rtol=1e-14, atol=0.0))[
        far
    ].all()
    np.testing.assert_allclose(
        found[~far], expected[~far], rtol={"tan": 2e-15, "pow": 3e-14}.get(name, 1e-15)
    )


WHOLE = np.arange(-40.0, 41.0)
EXACT = {
    "log2": [2.0 ** np.arange(-1074, 1024)],
    "log10": [10.0 ** np.arange(-300, 309)],
    "exp2": [np.arange(-1074.0, 1024.0)],
    "cbrt": [WHOLE**3],
    "pow": [x.ravel() for x in np.meshgrid(WHOLE, np.arange(10.0))],
    "hypot": [3.0 * WHOLE, 4.0 * WHOLE],
    "fmod": [np.arange(-5000.0, 5000.0) * 0.1, np.repeat([0.1, 0.7, -49.0, 1e-9], 2500)],
}


@pytest.mark.parametrize("name", EXACT)
def test_functions_are_exact_where_their_result_is_a_float(name):
    """Also as arithmetic, so that a following floor or comparison equals numpy's.

    numpy's own cube roots of cubes are exact on some processors only.
    """
    found, expected, _ = operated(name, 4, True, np.array(EXACT[name]))
    exactly(found, WHOLE if name == "cbrt" else expected)


@pytest.mark.parametrize("lanes", LANES)
def test_bits(lanes):
    for name, some in (
        ("pow2", np.arange(-1022.0, 1024.0, 31.0)),
        ("exponent", np.array([1e-300, 0.3, 1.0, 1.99, 2.0, 7e300])),
    ):
        found, expected, _ = operated(name, lanes, True, some[None])
        exactly(found, expected)


def operated(name, lanes, fused, given=None):
    """Results of an operation for unusual numbers, numpy's results, and the arguments."""
    if given is None:
        given = X[None] if name in ALONE else np.stack([x.ravel() for x in np.meshgrid(X, X)])
    tape = Tape()
    y = tape.node(name, *(x.i for x in inputs(tape, (len(given),))[0]))
    with np.errstate(all="ignore"):
        expected = np.asarray(FUNCTIONS[name](*given), float)
    return computed(tape, [as_number(y)], given, lanes, fused)[0], expected, given


@pytest.mark.parametrize("lanes", LANES)
def test_truth_and_choice(lanes):
    given = np.stack([x.ravel() for x in np.meshgrid(X, X, [1.0, -1.0])])
    tape = Tape()
    a, b, c = inputs(tape, (3,))[0]
    x, y = emit("lt", a, b), emit("le", c, 0.0)
    told = [
        emit("and", x, y),
        emit("or", x, y),
        emit("not", x),
        emit("select", x, a, b),
        emit("select", x, 2.0, b),
        emit("select", emit("not", y), a, -0.0),
    ]
    told += [emit("select", emit("or", emit("not", x), y), emit("select", y, a, b), NAN)]
    found = computed(tape, [as_number(one) for one in told], given, lanes, False)
    u, v, w = given
    p, q = u < v, w <= 0.0
    expected = [
        p & q,
        p | q,
        ~p,
        np.where(p, u, v),
        np.where(p, 2.0, v),
        np.where(q, -0.0, u),
        np.where(~p | q, np.where(q, u, v), NAN),
    ]
    for one, other in zip(found, expected, strict=True):
        exactly(one, np.asarray(other, float))


@pytest.mark.parametrize("lanes", LANES)
def test_constants_inputs_and_what_is_stored_twice(lanes):
    tape = Tape()
    a, _ = inputs(tape, (2,))[0]
    constants = [0.0, -0.0, 1.0 / 3.0, 5e-324, INF, -INF, NAN, 1e300]
    found = computed(
        tape, [a, a, *constants, True, emit("neg", a)], np.stack([X, X[::-1]]), lanes, True
    )
    exactly(found, np.stack([X, X, *(np.full(len(X), x) for x in constants), np.ones(len(X)), -X]))


@pytest.mark.parametrize("lanes", LANES)
def test_products_and_sums_are_fused_where_that_is_asked_for(lanes):
    a, b = 1.0 + 2.0**-30, 1.0 - 2.0**-30
    given = np.array([[a, 3.0], [b, 5.0], [-1.0, 7.0]])
    forms = [
        lambda x, y, z: x * y + z,
        lambda x, y, z: z + x * y,
        lambda x, y, z: x * y - z,
        lambda x, y, z: z - x * y,
    ]
    exact = [-(2.0**-60), -(2.0**-60), 2.0, -2.0]
    for form, known in zip(forms, exact, strict=True):
        results = {}
        for fused in FUSED:
            tape = Tape()
            y = form(*inputs(tape, (3,))[0])
            results[fused] = computed(tape, [y], given, lanes, fused)[0]
        np.testing.assert_array_equal(results[False], form(*given))
        assert results[True][0] == known
        assert results[True][1] == form(*given)[1]


def test_what_decides_a_jump_in_a_model_is_rounded_as_in_numpy():
    """0.3 is less than three tenths: fused, its tenfold is less than 3."""
    for function in (
        lambda t: np.floor(t * 0.3 - 3.0),
        lambda t: np.where(t * 0.3 < 3.0, 1.0, 2.0),
    ):
        tape = Tape()
        t = inputs(tape, (1,))[0]
        y = in_model(function, t)
        smooth = t[0] * 0.7 + 1.0
        given = np.arange(200.0)[None]
        found = computed(tape, [y[0], smooth], given, 4, True)
        np.testing.assert_array_equal(found[0], function(given[0]))
        assert (found[1] != given[0] * 0.7 + 1.0).any()


@pytest.mark.parametrize("lanes", LANES)
def test_a_product_that_is_used_again_is_not_fused(lanes):
    tape = Tape()
    x, y, z = inputs(tape, (3,))[0]
    product = x * y
    found = computed(
        tape,
        [product + z, product, product - product, product + product],
        np.array([[1.0 + 2.0**-30], [1.0 - 2.0**-30], [-1.0]]),
        lanes,
        True,
    )
    np.testing.assert_array_equal(found[:, 0], [0.0, 1.0, 0.0, 2.0])


def test_fused_products_keep_the_signs_of_zeros():
    given = np.stack([x.ravel() for x in np.meshgrid(*[[0.0, -0.0, 1.0, -1.0]] * 3)])
    for form in (lambda x, y, z: x * y + z, lambda x, y, z: x * y - z, lambda x, y, z: z - x * y):
        tape = Tape()
        y = form(*inputs(tape, (3,))[0])
        exactly(computed(tape, [y], given, 4, True)[0], form(*given))


# -- whole tapes -----------------------------------------------------------------------------------
def tangled(steps, seed):
    """A tape of many operations on each other's results."""
    rng, tape = np.random.default_rng(seed), Tape()
    known = list(inputs(tape, (4,))[0])
    names = [
        "add",
        "sub",
        "mul",
        "div",
        "sqrt",
        "sin",
        "exp",
        "atan2",
        "abs",
        "copysign",
        "floor",
        "tanh",
    ]
    for _ in range(steps):
        name = names[rng.integers(len(names))]
        two = name in ("add", "sub", "mul", "div", "atan2", "copysign")
        known.append(
            emit(
                name,
                *(known[i] for i in rng.integers(max(0, len(known) - 12), len(known), 1 + two)),
            )
        )
        if rng.random() < 0.2:
            a, b = (known[i] for i in rng.integers(0, len(known), 2))
            known.append(
                emit("select", emit("lt", a, b), emit("select", emit("ne", a, a), b, a), 0.5)
            )
    return tape, known[-10:]


@pytest.mark.parametrize("seed", range(3))
def test_tapes_are_worked_out_and_lanes_do_not_matter(seed):
    tape, y = tangled(300, seed)
    given = np.random.default_rng(seed).uniform(-2.0, 2.0, (4, 13))
    plain = computed(tape, y, given, 1, False)
    with np.errstate(all="ignore"):
        expected = np.stack([values(tape, one, y) for one in given.T], -1)
    np.testing.assert_allclose(plain, expected, rtol=1e-6)
    for fused in FUSED:
        each = [computed(tape, y, given, lanes, fused).tobytes() for lanes in LANES]
        assert each[0] == each[1] == each[2]
        assert (
            computed(tape, y, given[:, 7:8], 1, fused).tobytes()
            == computed(tape, y, given, 8, fused)[:, 7].tobytes()
        )


@settings(max_examples=5, deadline=None, derandomize=True)
@given(seed=st.integers(10, 1000))
def test_any_tape(seed):
    tape, y = tangled(40, seed)
    given = X[:16].reshape(4, 4)
    with np.errstate(all="ignore"):
        expected = np.stack([values(tape, one, y) for one in given.T], -1)
    found = computed(tape, y, given, 4, False)
    far = np.isfinite(expected) & (np.abs(expected) > 1e250)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    np.testing.assert_allclose(found[~far], expected[~far], rtol=1e-6)


def test_a_long_tape_is_cut_into_blocks():
    tape = Tape()
    (x,) = inputs(tape, (2,))
    y = x[0]
    for k in range(llvm.BLOCK + 500):
        y = emit("add", y, emit("mul", x[1], 1.0 / (1.0 + k)))
    text = llvm.source(llvm.Kernel(tape, [("own", 0), ("own", 1)], [], [y]), 4, True)
    assert re.search(r"^b1:$", text, re.MULTILINE)
    found = computed(tape, [y], np.array([[1.0, 2.0], [0.5, -1.0]]), 4, True)[0]
    harmonic = (1.0 / np.arange(1.0, llvm.BLOCK + 501.0)).sum()
    np.testing.assert_allclose(found, [1.0 + 0.5 * harmonic, 2.0 - harmonic], rtol=1e-12)


# -- flights ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("lanes", LANES)
def test_states_are_carried_and_rows_are_stored(lanes):
    """Two alternating kernels: x grows by a shared input, or by an input of each run; every second
    row is stored.
    """
    kernels = []
    for place in ("shared", "own"):
        tape = Tape()
        x, y, u = inputs(tape, (3,))[0]
        places = [("state", 0), ("state", 2), (place, 1)]
        kernels.append(llvm.Kernel(tape, places, [(0, x + u), (2, y * 2.0)], [x + u, y, u]))
    rng = np.random.default_rng(1)
    state, shared, own = (
        rng.standard_normal((3, 11)),
        rng.standard_normal((6, 2)),
        rng.standard_normal((6, 2, 11)),
    )
    kinds, at = [0, 1, 1, 0, 1, 0], [0, -1, 1, -1, 2, -1]
    rows, after = flown(
        [addressed(k, lanes, True) for k in kernels], kinds, at, state, shared, own, 3, lanes
    )
    x, y = state[0].copy(), state[2].copy()
    for k in range(6):
        u = np.broadcast_to(shared[k, 1], 11) if kinds[k] == 0 else own[k, 1]
        x = x + u
        if at[k] >= 0:
            np.testing.assert_array_equal(rows[at[k]], [x, y, u])
        y = 2.0 * y
    np.testing.assert_array_equal(after, [x, state[1], y])


def test_what_is_the_same_is_compiled_once():
    def made(factor):
        tape = Tape()
        x, y = inputs(tape, (2,))[0]
        return llvm.Kernel(
            tape, [("own", 0), ("own", 1)], [], [emit("mul", emit("add", x, y), factor)]
        )

    first, again, other = (
        llvm.kernel_address(made(factor), 4) for factor in (0.12345, 0.12345, 0.54321)
    )
    assert first == again
    assert other != first
    assert llvm.kernel_address(made(0.12345), 1) != first


def test_neighboring_sums_of_products_take_turns(monkeypatch):
    """Their numbers are the same bit for bit; a sum that needs another sum comes after it."""
    rng = np.random.default_rng(5)
    A, B = rng.standard_normal((2, 12, 12))
    given = rng.standard_normal((12, 7))

    def order_and_numbers():
        tape = Tape()
        x = inputs(tape, (12,))[0]
        y = A @ (B @ x)
        kernel = llvm.Kernel(tape, [("own", i) for i in range(12)], [], list(y))
        sums = re.findall(r"%t(\d+) = call .*@llvm.fma", llvm.source(kernel, 4, True))
        return list(map(int, sums)), computed(tape, y, given, 4, True)

    turns, found = order_and_numbers()
    monkeypatch.setattr(llvm, "TURNS", 1)
    alone, expected = order_and_numbers()
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(found, A @ (B @ given), rtol=1e-12)
    assert sorted(turns) == sorted(alone)
    assert turns != alone
    assert alone == sorted(alone)


def test_numbers_that_are_known_may_be_results():
    tape = Tape()
    inputs(tape, (1,))
    found = computed(tape, [1.0, np.float64(2.0)], np.ones((1, 3)), 4, True)
    np.testing.assert_array_equal(found, [[1.0] * 3, [2.0] * 3])


def test_aligned_arrays_begin_with_a_line_of_the_cache():
    arrays = [
        llvm.aligned((rows, 3)) for rows in range(60)
    ]  # all kept, so none lies where another did
    assert [array.shape for array in arrays] == [(rows, 3) for rows in range(60)]
    assert all(array.dtype == np.float64 and array.flags.c_contiguous for array in arrays)
    assert {array.ctypes.data % llvm.LINE for array in arrays[1:]} == {0}
