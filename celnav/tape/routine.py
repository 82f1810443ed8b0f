"""Routines that machine code calls: loops, which would be slow to compile unrolled, and rare
branches.

The arguments of a `Loop` are the first cells of its memory, and it writes its results to this
memory. On a `Tape` the call is one operation.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from hashlib import sha256
from typing import NamedTuple

from celnav.tape.elementary import expand_elementary
from celnav.tape.tape import Scalar, Tape, TracedScalar, as_number, operands


class LoopBody(NamedTuple):
    """Code for ``rows`` rows.

    places: ``(first, stride)`` by name: the first cell of a place for the first row, and the
        distance in cells to the next row.
    inputs: ``(place, index)`` of each input of the tape. results: ``(place, index, number)`` of the
        numbers written.
    """

    rows: int
    places: dict[str, tuple[int, int]]
    tape: Tape
    inputs: Sequence[tuple[str, int]]
    results: Sequence[tuple[str, int, TracedScalar]]


class Loop:
    """Stages with a common memory, whose first cells are the arguments.

    own_cells: number of cells of the routine itself; the cells of the routines that it calls
        follow, and ``cells`` is the total. returned: cells that are returned. rare: whether the
        call is skipped if the first argument is 0 for every run of the vector; the returned cells
        are then undefined.
    """

    def __init__(
        self,
        stages: Sequence[LoopBody],
        own_cells: int,
        returned: Sequence[int],
        rare: bool = False,
    ):
        self.stages, self.own_cells, self.returned, self.rare = (
            tuple(stages),
            own_cells,
            tuple(returned),
            rare,
        )
        self.cells = own_cells + max(stage.tape.cells for stage in self.stages)

    @cached_property
    def name(self) -> str:
        """A name with a hash of the operations: equal routines have equal names."""
        parts = [
            (s.rows, s.places, s.inputs, [(p, i, x.i) for p, i, x in s.results], s.tape.key)
            for s in self.stages
        ]
        operations = repr((parts, self.own_cells, self.returned, self.rare))
        return "r" + sha256(operations.encode()).hexdigest()[:16]

    def __repr__(self) -> str:
        return self.name

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Loop) and other.name == self.name

    def __hash__(self) -> int:
        return hash(self.name)

    def expanded(self) -> Loop:
        """The loop with elementary functions replaced by arithmetic."""
        stages = []
        for stage in self.stages:
            tape, mapped = expand_elementary(stage.tape, [x for *_, x in stage.results])
            results = [
                (place, i, tape.lift(as_number(mapped[x.i]))) for place, i, x in stage.results
            ]
            stages.append(stage._replace(tape=tape, results=results))
        return Loop(stages, self.own_cells, self.returned, self.rare)

    def __call__(self, tape: Tape, arguments: Iterable[Scalar]) -> list[TracedScalar]:
        """Emit a call on a tape; returns the returned cells."""
        # The call is one operation; each returned cell is another operation, which reads the
        # memory.
        call = tape.node("call", self, *(tape.lift(as_number(x)).i for x in arguments))
        return [tape.node("part", call.i, cell) for cell in self.returned]


class LoopRecorder:
    """Records a stage, which reads numbers from places and writes numbers to places."""

    def __init__(self, rows: int, **places: tuple[int, int]):
        self.rows, self.places, self.tape = rows, places, Tape()
        self.inputs, self.results = list[tuple[str, int]](), list[tuple[str, int, TracedScalar]]()
        self._numbers = dict[tuple[str, int], TracedScalar]()

    def take(self, place: str, index: int, absent: bool = False) -> TracedScalar:
        """The number at an index of a place for the present row."""
        if (place, index) not in self._numbers:
            self.inputs.append((place, index))
            self._numbers[place, index] = self.tape.input(absent)
        return self._numbers[place, index]

    def put(self, place: str, index: int, value: Scalar) -> None:
        """Write a number to an index of a place for the present row."""
        self.results.append((place, index, self.tape.lift(as_number(value))))

    def stage(self) -> LoopBody:
        """The recorded stage."""
        return LoopBody(self.rows, self.places, self.tape, self.inputs, self.results)


def rolled_loop(
    tape: Tape,
    variables: Sequence[TracedScalar],
    outputs: Sequence[TracedScalar],
    rows: Sequence[Sequence[Scalar]],
    least: int,
) -> list[TracedScalar] | None:
    """The outputs as functions of the variables, evaluated in a loop for rows of values; None if
    unrolled code is better.

    least: number of operations in all rows from which on a loop is used.
    """
    body, inside, ops = list[int](), {x.i for x in variables}, tape.ops
    # The body: operations that depend on the variables.
    for i in tape.needed(outputs):
        if any(a in inside for a in operands(ops[i])):
            body.append(i)
            inside.add(i)
    if len(body) * len(rows) < least or any(ops[i][0] in ("call", "part") for i in body):
        return None
    n, m = len(variables), len(outputs)
    # Numbers from outside the body are common to all rows; constants are part of its code.
    used = {a for i in body for a in operands(ops[i])} | {x.i for x in outputs}
    # Memory: common numbers, then the values (rows, n), then the results (rows, m).
    common = sorted(i for i in used - inside if ops[i][0] != "const")
    at, first = len(common), len(common) + n * len(rows)
    stage = LoopRecorder(len(rows), common=(0, 0), values=(at, n), results=(first, m))
    # The body is recorded again on the tape of the stage.
    mapped = {i: stage.take("common", k, tape.absent[i]) for k, i in enumerate(common)}
    mapped |= {x.i: stage.take("values", k) for k, x in enumerate(variables)}
    mapped |= {i: stage.tape.lift(ops[i][1]) for i in used - inside if ops[i][0] == "const"}
    for i in body:
        mapped[i] = stage.tape.node(ops[i][0], *(mapped[a].i for a in ops[i][1:]))
        stage.tape.sharp |= {mapped[i].i} if i in tape.sharp else set()
    for k, x in enumerate(outputs):
        stage.put("results", k, mapped[x.i])
    cells = first + m * len(rows)
    arguments = [*(TracedScalar(tape, i) for i in common), *(x for row in rows for x in row)]
    return Loop([stage.stage()], cells, range(first, cells))(tape, arguments)
