"""One step, as it is compiled: a tape, where its inputs come from, and where its results go."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from hashlib import sha256
from types import MappingProxyType
from typing import NamedTuple

from celnav.tape.elementary import expand_elementary
from celnav.tape.tape import LOGICAL, Scalar, Tape, TracedScalar, as_number, emit, operands


class Kernel(NamedTuple):
    """A step on a tape.

    inputs: ``(place, index)`` of each input, place "state", "shared" or "own". state:
        ``(index, result)`` of what is written.
    rows: results that are kept. fields: of the arrays where they are kept, the numbers of a run; ()
        for one array.
    at: field and place of each row; None for one beside the other. flags: fields of truth values,
    which this processor keeps as bytes.
    """

    tape: Tape
    inputs: Sequence[tuple[str, int]]
    state: Sequence[tuple[int, Scalar]]
    rows: Sequence[Scalar]
    fields: tuple[int, ...] = ()
    at: Sequence[tuple[int, int]] | None = None
    flags: frozenset[int] = frozenset()

    def results(self) -> list[tuple[str, int, TracedScalar]]:
        """Where each result goes, "state" or "rows" and an index, and the result."""
        pairs = [("state", i, x) for i, x in self.state] + [
            ("rows", i, x) for i, x in enumerate(self.rows)
        ]
        return [(place, i, self.tape.lift(as_number(x))) for place, i, x in pairs]

    @property
    def cells(self) -> int:
        """How many numbers its routines have in memory."""
        return self.tape.cells

    def lowered(self) -> Kernel:
        """With elementary functions as arithmetic."""
        tape, known = expand_elementary(self.tape, [x for *_, x in self.results()])
        found = {(place, i): known[x.i] for place, i, x in self.results()}
        state = [(i, found["state", i]) for i, _ in self.state]
        rows = [found["rows", i] for i in range(len(self.rows))]
        return self._replace(tape=tape, state=state, rows=rows)

    def columns(self) -> Sequence[tuple[int, int]]:
        """Field of each row, and its place there."""
        if self.at is not None:
            return self.at
        counts = self.fields or (len(self.rows),)
        return [(field, i) for field, count in enumerate(counts) for i in range(count)]

    def uniform(self, state: Collection[int]) -> list[bool]:
        """Of each operation whether all runs have the same result, if they have the same ``state``
        entries.
        """
        out = list[bool]()
        for op in self.tape.ops:
            if op[0] == "in":
                place, index = self.inputs[op[1]]
                out.append(place == "shared" or (place == "state" and index in state))
            else:
                out.append(all(out[a] for a in operands(op)))
        return out

    def split(self, before: Collection[int], after: Collection[int]) -> Split:
        """The step in two parts: what all runs have in common, once an epoch, and the rest, for
        each run.

        before, after: entries of the state that all runs have in common before and after the step.
        """
        tape, results = self.tape, self.results()  # which may put constants on the tape
        uniform = self.uniform(before)
        own = [(p, i, x) for p, i, x in results if p == "rows" or i not in after]
        # What a run takes of the common part: results that are neither constants nor inputs
        # already.
        given = {
            i
            for i in tape.needed([x for *_, x in own], {i for i, x in enumerate(uniform) if x})
            if uniform[i] and not self._is_at_hand(i)
        }
        first = max([3, *(1 + at for place, at in self.inputs if place == "shared")])
        places = {i: ("shared", first + k) for k, i in enumerate(sorted(given))}
        common = [(i, x) for p, i, x in results if p == "state" and i in after]
        common_results = [x for _, x in common] + [TracedScalar(tape, i) for i in places]
        shared, inputs, known = self._part(common_results)
        once = Kernel(
            shared,
            inputs,
            [(i, known[x.i]) for i, x in common],
            [as_number(known[i]) for i in places],
            (1,),  # the flight says where the first of them goes
            [(0, k) for k in range(len(places))],
        )
        rest, inputs, known = self._part([x for *_, x in own], places)
        state = [(i, known[x.i]) for p, i, x in own if p == "state"]
        rows = [known[x.i] for p, _, x in own if p == "rows"]
        saved = sum(not self._is_at_hand(i) for i in tape.needed(common_results))
        each = self._replace(tape=rest, inputs=inputs, state=state, rows=rows)
        return Split(once, each, first, saved)

    def _is_at_hand(self, i: int) -> bool:
        """Whether an operation is a constant or an input that all runs have in common."""
        name, *at = self.tape.ops[i]
        place = self.inputs[at[0]][0] if name == "in" else name
        return place in ("const", "shared")

    def _part(
        self,
        outputs: Sequence[TracedScalar],
        given: Mapping[int, tuple[str, int]] = MappingProxyType({}),
    ) -> tuple[Tape, list[tuple[str, int]], dict[int, TracedScalar]]:
        """A tape of what the outputs need, its inputs, and its numbers by those of this tape.

        given: operations whose results are inputs, and their places.
        """
        old, new = self.tape, Tape(self.tape.rolled)
        inputs, known = list[tuple[str, int]](), dict[int, TracedScalar]()
        for i in old.needed(outputs, given):
            name, *at = old.ops[i]
            if i in given or name == "in":
                inputs.append(given[i] if i in given else self.inputs[at[0]])
                known[i] = new.input(old.absent[i])
                if name in LOGICAL:
                    known[i] = emit("ne", known[i], 0.0)
            elif name == "const":
                known[i] = new.lift(at[0])
            elif name == "call":
                known[i] = new.node(name, at[0], *(known[a].i for a in at[1:]))
            elif name == "part":
                known[i] = new.node(name, known[at[0]].i, at[1])
            else:
                known[i] = new.node(name, *(known[a].i for a in at))
            if i in old.sharp:
                new.sharp.add(known[i].i)
        return new, inputs, known


class Split(NamedTuple):
    """A step in two parts. The rows of ``once`` are the shared inputs of ``each`` from the
    ``first`` on.

    saved: operations of the first part.
    """

    once: Kernel
    each: Kernel
    first: int
    saved: int


def digest(kernel: Kernel) -> bytes:
    """The same for kernels that are the same operation by operation."""
    results = tuple((place, i, x.i) for place, i, x in kernel.results())
    layout = kernel.fields, kernel.columns(), sorted(kernel.flags)
    return sha256(repr((kernel.inputs, layout, results, kernel.tape.key)).encode()).digest()
