"""One step, as it is compiled: a tape, where its inputs come from, and where its results go."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from typing import NamedTuple

from celnav.tape.elementary import lowered
from celnav.tape.tape import Number, Scalar, Tape, as_number

__all__ = ["Kernel", "digest"]


class Kernel(NamedTuple):
    """A step on a tape.

    inputs: ``(place, index)`` of each input, place "state", "shared" or "own". state: ``(index, result)`` of what is written.
    rows: results that are kept. fields: how many of them stand together, in their order; () for all.
    """

    tape: Tape
    inputs: Sequence[tuple[str, int]]
    state: Sequence[tuple[int, Scalar]]
    rows: Sequence[Scalar]
    fields: tuple[int, ...] = ()

    def results(self) -> list[tuple[str, int, Number]]:
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
        tape, known = lowered(self.tape, [x for *_, x in self.results()])
        found = {(place, i): known[x.i] for place, i, x in self.results()}
        state = [(i, found["state", i]) for i, _ in self.state]
        return Kernel(
            tape, self.inputs, state, [found["rows", i] for i in range(len(self.rows))], self.fields
        )

    def columns(self) -> list[tuple[int, int]]:
        """Field of each row, and its place there."""
        return [
            (field, i)
            for field, count in enumerate(self.fields or (len(self.rows),))
            for i in range(count)
        ]


def digest(kernel: Kernel) -> bytes:
    """The same for kernels that are the same operation by operation."""
    results = tuple((place, i, x.i) for place, i, x in kernel.results())
    return sha256(repr((kernel.inputs, kernel.fields, results, kernel.tape.key)).encode()).digest()
