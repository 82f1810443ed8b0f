"""A step in two parts gives the same results as the undivided step."""

from __future__ import annotations

import numpy as np
import pytest
from taped import values

from celnav.tape.kernel import Kernel
from celnav.tape.numbers import TracedArray, each_row
from celnav.tape.tape import Tape, TracedScalar, as_number, emit

OPERATIONS = ("add", "sub", "mul", "lt", "select", "sin", "neg")


def random_kernel(rng, size=60):
    """Inputs from all places, and operations on randomly chosen earlier numbers."""
    tape = Tape()
    inputs = [("shared", 0), ("shared", 3), ("own", 0), *(("state", i) for i in range(5))]
    made = [tape.input() for _ in inputs] + [0.5, -2.0]
    for _ in range(size):
        name = OPERATIONS[rng.integers(len(OPERATIONS))]
        numbers = [as_number(made[i]) for i in rng.integers(len(made), size=3)]
        if name == "select":
            made.append(emit(name, emit("lt", numbers[0], numbers[1]), numbers[2], numbers[0]))
        else:
            made.append(emit(name, *numbers[: 1 if name in ("sin", "neg") else 2]))
    results = [made[i] for i in rng.integers(len(made) // 2, len(made), size=8)]
    return Kernel(tape, inputs, list(enumerate(results[:5])), results[5:], (1, 2))


def worked_out(kernel, places):
    """The results of a kernel ``{(place, index): number}`` from input numbers by place."""
    results = kernel.results()
    given = [places[at] for at in kernel.inputs]
    found = values(kernel.tape, given, np.array([x for *_, x in results], object))
    return {(place, i): x for (place, i, _), x in zip(results, found, strict=True)}


@pytest.mark.parametrize("seed", range(40))
def test_two_parts_are_the_whole(seed):
    rng = np.random.default_rng(seed)
    kernel = random_kernel(rng)
    before = {i for i in range(5) if rng.random() < 0.5}
    uniform = kernel.uniform(before)
    same = {i for i, x in kernel.state if not isinstance(x, TracedScalar) or uniform[x.i]}
    after = {i for i in same if rng.random() < 0.7}
    split = kernel.split(before, after)

    places = {at: rng.standard_normal() for at in kernel.inputs}
    with np.errstate(all="ignore"):
        whole = worked_out(kernel, places)
        once = worked_out(split.once, places)
        results = {("shared", split.first + i): x for (p, i), x in once.items() if p == "rows"}
        each = worked_out(split.each, places | results)
    state = {at: x for at, x in once.items() if at[0] == "state"}
    assert {i for _, i in state} == after
    assert state.keys().isdisjoint(each)
    np.testing.assert_equal(state | each, whole)
    assert {at for at in split.once.inputs if at[0] == "state"} <= {("state", i) for i in before}
    assert all(place != "own" for place, _ in split.once.inputs)
    assert all(i not in before for place, i in split.each.inputs if place == "state")
    assert split.first >= 4  # behind the inputs that are there already


def test_nothing_that_all_runs_have_in_common_is_done_for_each():
    kernel = random_kernel(np.random.default_rng(0))
    split = kernel.split({0, 1}, ())
    uniform = split.each.uniform(())
    outputs = [x for *_, x in split.each.results()]
    idle = [i for i in split.each.tape.needed(outputs) if uniform[i]]
    assert {split.each.tape.ops[i][0] for i in idle} <= {"in", "const", "ne"}


def test_a_loop_over_rows_goes_where_its_numbers_are():
    tape = Tape()
    x = TracedArray((9, 2))
    for at in np.ndindex(*x.shape):
        x[at] = tape.input()
    y = each_row(lambda row: np.sin(row) * row[..., :1], x, least=0)
    inputs = [("state", i) for i in range(18)]
    total = y[0, 0] + y[8, 1]
    kernel = Kernel(tape, inputs, [(0, y[3, 1])], [total, tape.input()])
    kernel = kernel._replace(inputs=[*inputs, ("own", 0)])
    split = kernel.split(set(range(18)), ())
    assert [op[0] for op in split.each.tape.ops].count("call") == 0
    assert [op[0] for op in split.once.tape.ops].count("call") == 1
    assert split.each.cells == 0 < split.once.cells
    places = {at: 0.1 * k for k, at in enumerate(kernel.inputs)}
    once = worked_out(split.once, places)
    given = places | {("shared", split.first + i): x for (_, i), x in once.items()}
    np.testing.assert_equal(worked_out(split.each, given), worked_out(kernel, places))
