"""State and measurement spaces: the sum, the difference and the mean of points.

A filter does its algebra with differences (tangent vectors, of dimension ``n``). A space relates
them to points (arrays whose last axis has length ``N``, which need not equal ``n``). In a vector
space these are ordinary sums and differences; angles are wrapped; attitudes use a retraction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from celnav.gaussian.checks import choice, integer, integers, sequence
from celnav.gaussian.linalg import Array, side_by_side

__all__ = ["Space", "angles", "product"]


class NamedPart(NamedTuple):
    """A named part of a product: its index range ``(first, stop)`` in points and in tangents."""

    name: str
    points: tuple[int, int]
    tangents: tuple[int, int]


class Space(NamedTuple):
    """The relation between points and differences. Every function broadcasts over leading axes, and
    nan gives nan. Two spaces are equal if their plus, minus, transport and mean are equal.

    plus: ``(point (..., N), tangent (..., n)) -> point``.
    minus: ``(b, a) -> tangent`` at ``a`` that leads to ``b``: ``plus(a, minus(b, a)) == b``.
    transport: optional ``tangent -> (..., n, n)``, the matrix that maps deviations at a point to
        deviations at the point moved by ``tangent``. None: the identity.
    mean: optional ``(points (p, ..., N), weights (p,)) -> point``. None: the first point plus the
        mean difference to it, which avoids cancellation and wrapped angles.
    check: optional ``(point, name) -> point``, applied to points that a user passes, such as
        measurements; it raises ValueError with the name.
    size: N, if all points have the same length. parts: the named parts of a product, see `part`.
    """

    plus: Callable[[Array, Array], Array] = np.add
    minus: Callable[[Array, Array], Array] = np.subtract
    transport: Callable[[Array], Array] | None = None
    mean: Callable[[Array, Array], Array] | None = None
    check: Callable[[Array, str], Array] | None = None
    size: int | None = None
    parts: tuple[NamedPart, ...] = ()

    def part(self, x: Array, name: str) -> Array:
        """Components ``(..., k)`` of a named part of points ``x (..., N)`` or of tangents
        ``(..., n)``, such as ``track.std``. ValueError for an unknown name lists the names.

        >>> space = celnav.product(q=celnav.attitude(), p=3)
        >>> h = lambda x, epoch: space.part(x, "p")
        """
        points, tangents = self.places(name)
        n = max(part.tangents[1] for part in self.parts)
        if x.shape[-1] not in (self.size, n):
            raise ValueError(
                f"x: expected points of {self.size} components or deviations of {n}, got "
                f"{x.shape[-1]}"
            )
        return x[..., points if x.shape[-1] == self.size else tangents]

    def places(self, name: str) -> tuple[slice, slice]:
        """Slices of a named part in points and in tangents; ValueError for an unknown name."""
        if not self.parts:
            raise ValueError(
                "space: expected a product with names, such as celnav.product(p=3, v=3), got a "
                "space without names"
            )
        names = [part.name for part in self.parts]
        _, points, tangents = self.parts[names.index(choice("name", name, names))]
        return slice(*points), slice(*tangents)

    @property
    def labels(self) -> list[str]:
        """Names ``(n,)`` of a tangent's components, from the innermost parts: q0, q1, ...; empty
        without named parts.
        """
        return _labels((part.name, part.tangents) for part in self.parts)

    @property
    def point_labels(self) -> list[str]:
        """Names ``(N,)`` of a point's components, as in `labels`; an attitude has four."""
        return _labels((part.name, part.points) for part in self.parts)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Space) and self[:4] == other[:4]

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash(self[:4])

    def __repr__(self) -> str:
        return "EUCLIDEAN" if self is EUCLIDEAN else f"Space(minus={self.minus!r})"

    def __reduce__(self) -> Any:
        return "EUCLIDEAN" if self is EUCLIDEAN else (Space, tuple(self))


def _labels(places: Iterable[tuple[str, tuple[int, int]]]) -> list[str]:
    """Names of components; if several parts contain a component, the last part names it."""
    labels: dict[int, str] = {}
    for name, (first, stop) in places:
        for i in range(first, stop):
            labels[i] = f"{name}{i - first}" if stop - first > 1 else name
    return [labels[i] for i in sorted(labels)]


EUCLIDEAN = Space()


def wrap(angle: Any) -> Any:
    """Angle of any shape, rad, wrapped to ``[-pi, pi)``."""
    wrapped = (np.asanyarray(angle) + np.pi) % (2.0 * np.pi) - np.pi
    # Just below -pi the remainder rounds up to a full turn.
    return np.where(wrapped == np.pi, -np.pi, wrapped)[()]


def angles(components: Iterable[int] | None = None) -> Space:
    """Space of vectors whose ``components`` (None: all) are angles in radians, wrapped to
    ``[-pi, pi)``; ValueError for an index beyond the vector.

    >>> h = lambda x, epoch: np.arctan2(x[..., 1:2], x[..., :1])
    >>> bearing = celnav.Sensor(h, R=[[1e-4]], space=celnav.angles([0]))
    """
    indices = (
        None
        if components is None
        else integers("components", sequence("components", components, "[0]"))
    )
    return Space(partial(_wrapped, np.add, indices), partial(_wrapped, np.subtract, indices))


def _wrapped(operation: Any, indices: tuple[int, ...] | None, a: Array, b: Array) -> Array:
    """The sum or difference of vectors, with wrapped angles."""
    vector: Array = operation(a, b, dtype=np.float64)
    if indices and max(indices) >= vector.shape[-1]:
        raise ValueError(
            f"angles: expected components below {vector.shape[-1]}, the length of the vector, got "
            f"{max(indices)}"
        )
    chosen = slice(None) if indices is None else list(indices)
    # `operation` has made a new array, which may be written into.
    vector[..., chosen] = wrap(vector[..., chosen])
    return vector


def product(*factors: tuple[Space, int, int], **parts: Any) -> Space:
    """Product `Space` of spaces, with named parts or in order.

    parts: by name, each a space, a number (the length of a vector), or, for a space of any length,
        ``(space, N)``. `Space.part` and `Track.part` select a part by its name, or by a name within
        a part.
    factors: in order, each ``(space, N, n)`` with the lengths of its points and tangents.

    ValueError for a space that defines its own mean, for lengths that do not match the space, or
    for a name that occurs twice.

    >>> space = celnav.product(q=celnav.attitude(), v=3, course=(celnav.angles(), 1))
    >>> space = celnav.product((celnav.attitude(), 4, 3), (celnav.EUCLIDEAN, 3, 3))
    """
    if parts and factors:
        raise ValueError("factors: expected all parts of a product by name, or none, got some")
    if parts:
        factors = tuple(_factor(name, part) for name, part in parts.items())
    if not all(
        isinstance(factor, tuple | list) and len(factor) == 3 and isinstance(factor[0], Space)
        for factor in factors
    ):
        raise ValueError(
            "factors: expected triples (space, N, n) with the lengths of points and of tangents, "
            f"got {factors!r:.80}"
        )
    factors = tuple(
        (space, integer("factors", N, 0), integer("factors", n, 0)) for space, N, n in factors
    )
    if any(space.mean is not None for space, _, _ in factors):
        raise ValueError("factors: expected spaces without a mean of their own, got one with it")
    for space, N, n in factors:
        if (count := _tangent_length(space, N, f"factors: points of length {N}")) != n:
            raise ValueError(
                f"factors: expected tangents of length {count} to go with points of length {N}, "
                f"as in (space, {N}, {count}), got {n}"
            )
    points = np.cumsum([0, *(N for _, N, _ in factors)]).tolist()
    tangents = np.cumsum([0, *(n for _, _, n in factors)]).tolist()
    spaces = [space for space, _, _ in factors]
    # For each space its index range in points and its index range in tangents.
    places = list(zip(pairwise(points), pairwise(tangents), strict=True))
    named = [NamedPart(name, *place) for name, place in zip(parts, places, strict=False)]
    for (_, (at, _), (by, _)), space in zip(tuple(named), spaces, strict=False):
        for name, (a, b), (c, d) in space.parts:
            named.append(NamedPart(name, (at + a, at + b), (by + c, by + d)))
    if len({part.name for part in named}) < len(named):
        raise ValueError(
            "parts: expected names that differ from the names within a part, got "
            f"{', '.join(part.name for part in named)}"
        )
    blocks = tuple(
        (space, slice(*at), slice(*by)) for space, (at, by) in zip(spaces, places, strict=True)
    )
    joined = _Product(blocks, points[-1], tangents[-1])
    if parts and all(space == EUCLIDEAN for space in spaces):
        return EUCLIDEAN._replace(check=joined.check, size=joined.N, parts=tuple(named))
    curved = any(space.transport is not None for space in spaces)
    particular = any(space.check is not None for space in spaces)
    return Space(
        joined.plus,
        joined.minus,
        joined.transport if curved else None,
        check=joined.check if particular else None,
        size=joined.N,
        parts=tuple(named),
    )


def _factor(name: str, part: Any) -> tuple[Space, int, int]:
    """A named part as a factor ``(space, N, n)``."""
    space, N = part if isinstance(part, tuple) and len(part) == 2 else (part, None)
    if not isinstance(part, Space) and N is None:
        space, N = EUCLIDEAN, part
    N = space.size if N is None and isinstance(space, Space) else N
    if not isinstance(space, Space) or N is None:
        raise ValueError(
            f"{name}: expected a number of components, a space, or a space of any length with the "
            f"length of its points, such as (celnav.angles(), 1), got {part!r:.80}"
        )
    N = integer(name, N)
    return space, N, _tangent_length(space, N, name)


def _tangent_length(space: Space, N: int, name: str) -> int:
    """Length of the tangents of a space whose points have length N."""
    point = np.full(N, np.nan)
    if space.check is not None:
        space.check(point, name)
    length: int = space.minus(point, point).shape[-1]
    return length


class _Product(NamedTuple):
    """Spaces with their slices in the points (length N) and in the tangents (length n)."""

    parts: tuple[tuple[Space, slice, slice], ...]
    N: int
    n: int

    def plus(self, point: Array, tangent: Array) -> Array:
        _check_length("point", point, self.N)
        _check_length("deviations", tangent, self.n)
        return side_by_side(
            [space.plus(point[..., at], tangent[..., by]) for space, at, by in self.parts]
        )

    def minus(self, b: Array, a: Array) -> Array:
        _check_length("point", b, self.N)
        return side_by_side([space.minus(b[..., at], a[..., at]) for space, at, _ in self.parts])

    def transport(self, tangent: Array) -> Array:
        # Block diagonal, one block per space.
        matrix = np.zeros((*tangent.shape[:-1], self.n, self.n), like=tangent)
        for space, _, by in self.parts:
            matrix[..., by, by] = (
                np.eye(by.stop - by.start)
                if space.transport is None
                else space.transport(tangent[..., by])
            )
        return matrix

    def check(self, point: Array, name: str) -> Array:
        _check_length(name, point, self.N)
        return side_by_side(
            [
                point[..., at] if space.check is None else space.check(point[..., at], name)
                for space, at, _ in self.parts
            ]
        )


def _check_length(name: str, vector: Array, length: int) -> None:
    if vector.shape[-1] != length:
        raise ValueError(
            f"{name}: expected {length} components for the product space, got {vector.shape[-1]}"
        )


def components_first(x: Array) -> Array:
    """View ``(n, ...)`` of an array ``(..., n)``; numpy's ``moveaxis`` would take longer than a
    product of small matrices.
    """
    last = x.ndim - 1
    return x.transpose((last, *range(last)))


def points_last(x: Array) -> Array:
    """View ``(..., n)`` of an array ``(n, ...)``: the inverse of `components_first`."""
    return x.transpose((*range(1, x.ndim), 0))


def component_major(x: Array) -> Array:
    """`components_first`, with each component contiguous in memory, the fast order for models.
    Sigma points have this order already; other arrays are copied.
    """
    if x.ndim == 1:
        return x
    first = components_first(x)
    flags = first[0].flags
    return first if flags.c_contiguous or flags.f_contiguous else np.ascontiguousarray(first)
