"""One step in compiled form: a tape, the sources of its inputs, and the places of its results."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from hashlib import sha256
from types import MappingProxyType
from typing import NamedTuple

from celnav.tape.elementary import expand_elementary
from celnav.tape.tape import LOGICAL, Scalar, Tape, TracedScalar, as_number, emit, operands


class Kernel(NamedTuple):
    """A step on a tape.

    inputs: ``(place, index)`` of each input; the place is "state", "shared" or "own". state:
        ``(index, result)`` of each number written to the state.
    rows: results to store. fields: numbers per run in each array that stores rows; () for a single
        array.
    at: field and place of each row; None: side by side. flags: fields of truth values, which this
        processor stores as bytes.
    """

    tape: Tape
    inputs: Sequence[tuple[str, int]]
    state: Sequence[tuple[int, Scalar]]
    rows: Sequence[Scalar]
    fields: tuple[int, ...] = ()
    at: Sequence[tuple[int, int]] | None = None
    flags: frozenset[int] = frozenset()

    def results(self) -> list[tuple[str, int, TracedScalar]]:
        """Each result with its place: "state" or "rows", and an index."""
        pairs = [("state", i, x) for i, x in self.state] + [
            ("rows", i, x) for i, x in enumerate(self.rows)
        ]
        return [(place, i, self.tape.lift(as_number(x))) for place, i, x in pairs]

    @property
    def cells(self) -> int:
        """How many numbers the memory of its routines has."""
        return self.tape.cells

    def expanded(self) -> Kernel:
        """The kernel with elementary functions replaced by arithmetic."""
        tape, mapped = expand_elementary(self.tape, [x for *_, x in self.results()])
        placed = {(place, i): mapped[x.i] for place, i, x in self.results()}
        state = [(i, placed["state", i]) for i, _ in self.state]
        rows = [placed["rows", i] for i in range(len(self.rows))]
        return self._replace(tape=tape, state=state, rows=rows)

    def columns(self) -> Sequence[tuple[int, int]]:
        """Field of each row, and its place in the field."""
        if self.at is not None:
            return self.at
        counts = self.fields or (len(self.rows),)
        return [(field, i) for field, count in enumerate(counts) for i in range(count)]

    def uniform(self, state: Collection[int]) -> list[bool]:
        """For each operation, whether all runs have the same result if their ``state`` entries are
        equal.
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
        """The step in two parts: operations common to all runs, once per epoch, and the rest, for
        each run.

        before, after: entries of the state that all runs have in common before and after the step.
        """
        tape, results = self.tape, self.results()  # results() may add constants to the tape
        uniform = self.uniform(before)
        per_run = [(p, i, x) for p, i, x in results if p == "rows" or i not in after]
        # Common results that the second part needs, except constants and inputs.
        provided = {
            i
            for i in tape.needed([x for *_, x in per_run], {i for i, x in enumerate(uniform) if x})
            if uniform[i] and not self._is_at_hand(i)
        }
        # Common results follow the shared inputs: index, time, interval, then u.
        first = max([3, *(1 + at for place, at in self.inputs if place == "shared")])
        places = {i: ("shared", first + k) for k, i in enumerate(sorted(provided))}
        common = [(i, x) for p, i, x in results if p == "state" and i in after]
        common_results = [x for _, x in common] + [TracedScalar(tape, i) for i in places]
        shared, inputs, mapped = self._part(common_results)
        once = Kernel(
            shared,
            inputs,
            [(i, mapped[x.i]) for i, x in common],
            [as_number(mapped[i]) for i in places],
            (1,),  # the caller of the kernel passes the position of the first row
            [(0, k) for k in range(len(places))],
        )
        rest, inputs, mapped = self._part([x for *_, x in per_run], places)
        state = [(i, mapped[x.i]) for p, i, x in per_run if p == "state"]
        rows = [mapped[x.i] for p, _, x in per_run if p == "rows"]
        saved = sum(not self._is_at_hand(i) for i in tape.needed(common_results))
        each = self._replace(tape=rest, inputs=inputs, state=state, rows=rows)
        return Split(once, each, first, saved)

    def _is_at_hand(self, i: int) -> bool:
        """Whether an operation is a constant or a shared input."""
        name, *at = self.tape.ops[i]
        place = self.inputs[at[0]][0] if name == "in" else name
        return place in ("const", "shared")

    def _part(
        self,
        outputs: Sequence[TracedScalar],
        provided: Mapping[int, tuple[str, int]] = MappingProxyType({}),
    ) -> tuple[Tape, list[tuple[str, int]], dict[int, TracedScalar]]:
        """A new tape with the operations that the outputs need, its inputs, and its numbers by
        index on the present tape.

        provided: operations whose results become inputs, with their places.
        """
        old, new = self.tape, Tape(self.tape.rolled)
        inputs, mapped = list[tuple[str, int]](), dict[int, TracedScalar]()
        for i in old.needed(outputs, provided):
            name, *at = old.ops[i]
            if i in provided or name == "in":
                inputs.append(provided[i] if i in provided else self.inputs[at[0]])
                mapped[i] = new.input(old.absent[i])
                if name in LOGICAL:
                    mapped[i] = emit("ne", mapped[i], 0.0)
            elif name == "const":
                mapped[i] = new.lift(at[0])
            elif name == "call":
                mapped[i] = new.node(name, at[0], *(mapped[a].i for a in at[1:]))
            elif name == "part":
                mapped[i] = new.node(name, mapped[at[0]].i, at[1])
            else:
                mapped[i] = new.node(name, *(mapped[a].i for a in at))
            if i in old.sharp:
                new.sharp.add(mapped[i].i)
        return new, inputs, mapped


class Split(NamedTuple):
    """A step in two parts. The rows of ``once`` are shared inputs of ``each``, from ``first`` on.

    saved: number of operations in the part that is computed once.
    """

    once: Kernel
    each: Kernel
    first: int
    saved: int


def digest(kernel: Kernel) -> bytes:
    """A hash, equal for kernels with the same operations."""
    results = tuple((place, i, x.i) for place, i, x in kernel.results())
    layout = kernel.fields, kernel.columns(), sorted(kernel.flags)
    return sha256(repr((kernel.inputs, layout, results, kernel.tape.key)).encode()).digest()
