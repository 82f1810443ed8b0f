"""What a filter asks of a rule, whatever kind of rule it is: sigma points (`celnav.gaussian.rule`) or derivatives (`celnav.gaussian.taylor`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, Protocol

from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import Space


class _Keep:
    def __repr__(self) -> str:
        return "KEEP"

    def __reduce__(self) -> str:
        return "KEEP"


KEEP: Final = _Keep()
"""Stands for "the state itself" among the outputs of a function: its columns are then exact, on any space."""

Outputs = tuple[Any, ...]


class Image(NamedTuple):
    """One output of a transformed belief: the image of the center, the shift of the mean from there, and columns."""

    center: Array
    shift: Any
    columns: Array


class Transform(Protocol):
    """What a filter asks of a rule.

    ``transform`` pushes ``N(mean, root @ root.mT)`` through ``g``, which maps points ``(p, ..., N)`` and one array
    ``(p, ..., k)`` of noise points for each root in ``extra`` to a tuple of outputs, one for each of ``spaces``. It returns
    an `Image` of each output and the pre-array ``(..., sum of dimensions, q + room)`` that holds their columns above each
    other; the last ``room`` columns are for the caller. ``sign`` belongs to the first q columns. ``slope`` is the
    statistical Jacobian ``(..., k, n)`` of an image. ``epoch`` is for rules that know derivatives. ``linear``: whether columns
    are a matrix times the root, whatever the root.
    """

    sign: Array
    linear: bool

    def transform(
        self,
        g: Callable[..., Outputs],
        mean: Array,
        root: Array,
        space: Space,
        spaces: Sequence[Space],
        extra: Sequence[Array] = (),
        room: int = 0,
        epoch: Any = None,
    ) -> tuple[list[Image], Array]:
        """Images of all outputs of ``g``, and the pre-array of their columns."""

    def points(self, mean: Array, root: Array, space: Space, extra: Sequence[Array] = ()) -> list[Array]:
        """Points ``(p, ..., N)`` of the state, and ``(p, ..., k)`` of each noise in ``extra``: what ``g`` is called with."""

    def slope(self, image: Image, root: Array) -> Array:
        """Statistical Jacobian ``(..., k, n)`` of an image: its covariance with the state times the state's inverse one."""
