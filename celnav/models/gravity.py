"""Gravity from spherical harmonics, on Earth-fixed axes, without a singularity at the poles
[Cunningham1970]. Units: m, s.

The potential is a sum of solid harmonics. Each derivative of a harmonic is a sum of harmonics of
the next degree [Montenbruck2000, Eq. 3.33]. So acceleration and gradient have coefficients of their
own, which are computed once. At a position only the harmonics are evaluated, by recursion over the
degree, for all orders together.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from celnav.files import InputError
from celnav.gaussian.checks import finite, instance, integer, number
from celnav.gaussian.linalg import Array

MOST_DEGREE = 2190
"""The largest degree that `read` accepts; its coefficients need 80 MB."""


@dataclass(frozen=True, eq=False)
class Gravity:
    """A gravity field.

    gm: gravitational parameter, m^3/s^2. radius: reference radius, m.
    C, S: fully normalized coefficients ``(N + 1, N + 1)`` by degree and order. Entries whose order
        exceeds their degree are ignored.

    The acceleration is gravitational only; on rotating axes add
    `celnav.models.earth.inertial_forces`. ValueError if an argument is not finite or the shapes
    differ.

    >>> field = celnav.models.gravity.read("EGM2008.gfc", degree=8)
    >>> field.acceleration(np.array([6.8e6, 0.0, 0.0]))  # m/s^2
    """

    gm: float
    radius: float
    C: Array
    S: Array

    def __post_init__(self) -> None:
        number("gm", self.gm, above=0.0), number("radius", self.radius, above=0.0)
        for name in ("C", "S"):
            object.__setattr__(self, name, finite(name, getattr(self, name), ("N", "N")))
        if self.C.shape != self.S.shape:
            raise ValueError(f"S: expected the shape of C, {self.C.shape}, got {self.S.shape}")

    @property
    def degree(self) -> int:
        """The highest degree of the coefficients."""
        return len(self.C) - 1

    def truncated(self, degree: int) -> Gravity:
        """The `Gravity` truncated to a lower degree."""
        count = integer("degree", degree, 0, self.degree) + 1
        return Gravity(self.gm, self.radius, self.C[:count, :count], self.S[:count, :count])

    def potential(self, position: Array) -> Array:
        """Positive potential ``(...)`` m^2/s^2 at positions ``(..., 3)`` m."""
        return self._sum((self.gm / self.radius) * np.stack([self.C, self.S])[None], position)[
            ..., 0
        ]

    def acceleration(self, position: Array) -> Array:
        """Acceleration ``(..., 3)`` m/s^2 at positions ``(..., 3)`` m, on the same axes."""
        return self._sum(self._first, position)

    def gradient(self, position: Array) -> Array:
        """Derivative ``(..., 3, 3)`` 1/s^2 of `acceleration`, symmetric and of trace zero."""
        xx, xy, xz, yy, yz, zz = np.moveaxis(self._sum(self._second, position), -1, 0)
        return np.stack(
            [np.stack(row, -1) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))], -2
        )

    @cached_property
    def _first(self) -> Array:
        """Coefficients ``(3, 2, N + 2, N + 2)`` of the acceleration."""
        return (self.gm / self.radius**2) * _derivatives(np.stack([self.C, self.S]))

    @cached_property
    def _second(self) -> Array:
        """Coefficients ``(6, 2, N + 3, N + 3)`` of the derivatives xx, xy, xz, yy, yz, zz."""
        x, y, z = (_derivatives(field) for field in _derivatives(np.stack([self.C, self.S])))
        return (self.gm / self.radius**3) * np.concatenate([x, y[1:], z[2:]])

    def _sum(self, fields: Array, position: Array) -> Array:
        """Values ``(..., k)`` of k fields with coefficients ``(k, 2, N + 1, N + 1)``."""
        place = np.moveaxis(position, -1, 0)
        harmonics = _harmonics(place.reshape(3, -1) / self.radius, fields.shape[-1] - 1)
        # (k, coefficients) @ (coefficients, places)
        values = fields.reshape(len(fields), -1) @ harmonics.reshape(-1, harmonics.shape[-1])
        return np.asanyarray(np.moveaxis(values.reshape(-1, *place.shape[1:]), 0, -1))


def _harmonics(place: Array, degree: int) -> Array:
    """Solid harmonics ``(2, N + 1, N + 1, K)``: cosine and sine terms by degree and order, at
    ``place (3, K)`` in units of the reference radius.
    """
    inverse = 1.0 / (place[0] * place[0] + place[1] * place[1] + place[2] * place[2])
    x, y, z = place * inverse
    out = np.zeros((2, degree + 1, degree + 1, place.shape[-1]), like=place)
    out[0, 0, 0] = np.sqrt(inverse)
    for n, (once, twice, corner) in enumerate(_recursion(degree), 1):
        # Degree n from degrees n - 1 and n - 2 for orders below n; order n from order n - 1.
        out[:, n, :n] = (once * z) * out[:, n - 1, :n]
        if n > 1:
            out[:, n, : n - 1] -= (twice * inverse) * out[:, n - 2, : n - 1]
        c, s = out[:, n - 1, n - 1]
        out[0, n, n], out[1, n, n] = corner * (x * c - y * s), corner * (x * s + y * c)
    return out


@cache
def _recursion(degree: int) -> list[tuple[Array, Array, float]]:
    """Factors of the recursion to each degree n >= 1.

    For each degree: the factors ``(n, 1)`` of degree n - 1 and ``(n - 1, 1)`` of degree n - 2, by
    order, and the factor of order n.
    """
    factors = []
    for n in range(1, degree + 1):
        m = np.arange(n)[:, None]
        across = (n - m) * (n + m) / (2 * n + 1)
        k = m[:-1]
        twice = np.sqrt((n + k - 1) * (n - k - 1) / ((2 * n - 3) * across[:-1]))
        factors.append(
            (
                np.sqrt((2 * n - 1) / across),
                twice,
                float(np.sqrt((2 * n + 1) / (2 * n) if n > 1 else 3.0)),
            )
        )
    return factors


def _derivatives(coefficients: Array) -> Array:
    """Coefficients ``(3, 2, N + 2, N + 2)`` of the derivatives with respect to x, y and z, times
    the radius, of a field with coefficients ``(2, N + 1, N + 1)`` [Montenbruck2000, Eq. 3.33].
    """
    N = coefficients.shape[-1]
    n, m = np.mgrid[:N, :N]
    C, S = np.where(m <= n, coefficients, 0.0)
    # The sine term of order 0 is zero, whatever its coefficient.
    S, m = np.where(m > 0, S, 0.0), np.minimum(m, n)
    # Ratio of the normalizations of degrees n and n + 1, times the factor of the equation, for an
    # order that increases, decreases or stays.
    scale = (2 * n + 1) / (2 * n + 3)
    up = np.sqrt(scale * (n + m + 1) * (n + m + 2) * np.where(m == 0, 2.0, 1.0)) * 0.5
    down = np.sqrt(scale * (n - m + 1) * (n - m + 2) * np.where(m == 1, 2.0, 1.0)) * 0.5
    same = np.sqrt(scale * (n + m + 1) * (n - m + 1))
    out = np.zeros((3, 2, N + 1, N + 1))
    out[:2, :, 1:, 1:] = [[-up * C, -up * S], [up * S, -up * C]]
    out[:2, :, 1:, : N - 1] += np.array([[down * C, down * S], [down * S, -down * C]])[..., 1:]
    out[2, :, 1:, :N] = -same * C, -same * S
    return out


def read(path: str | Path, degree: int | None = None) -> Gravity:
    """The `Gravity` from a file in ICGEM's format, ``.gfc``, up to ``degree`` (None: all of it).

    Time-dependent terms are ignored: only records ``gfc`` and ``gfct`` are used.

    Raises
    ------
    InputError: if the file has another format; it names the file and the line. OSError: if the file
        cannot be read.
    """
    most = MOST_DEGREE if degree is None else integer("degree", degree, 0, MOST_DEGREE)
    head: dict[str, str] = {}
    records: list[tuple[int, int, float, float]] = []
    body = False
    lines = (
        Path(instance("path", path, str | os.PathLike, "a path, such as 'EGM2008.gfc'"))
        .read_text("latin-1")
        .splitlines()
    )
    for number_, line in enumerate(lines, 1):
        words = line.replace("D", "e").replace("d", "e").split() if body else line.split()
        if not body:
            body = bool(words) and words[0] == "end_of_head"
            head |= {words[0]: words[1]} if len(words) > 1 else {}
        elif words and words[0] in ("gfc", "gfct"):
            try:
                n, m, c, s = int(words[1]), int(words[2]), float(words[3]), float(words[4])
            except (IndexError, ValueError):
                raise InputError(
                    f"{path}: line {number_}: expected gfc with degree, order, C and S, got "
                    f"{line[:60]!r}"
                ) from None
            if not (0 <= m <= n <= MOST_DEGREE and np.isfinite([c, s]).all()):
                raise InputError(
                    f"{path}: line {number_}: expected 0 <= order <= degree and finite numbers, "
                    f"got {line[:60]!r}"
                )
            if n <= most:
                records.append((n, m, c, s))
    if not body:
        raise InputError(
            f"{path}: expected a gravity field in ICGEM's format, got no line end_of_head"
        )
    return _field(path, head, records, degree)


def _field(
    path: str | Path,
    head: dict[str, str],
    records: list[tuple[int, int, float, float]],
    degree: int | None,
) -> Gravity:
    """The field from the records of a file."""
    sizes = []
    for key in ("earth_gravity_constant", "radius"):
        try:
            sizes.append(float(head[key].replace("D", "e").replace("d", "e")))
        except (KeyError, ValueError):
            raise InputError(
                f"{path}: expected a number for {key} in the header, got {head.get(key, 'none')!r}"
            ) from None
    if (norm := head.get("norm", "fully_normalized")) != "fully_normalized":
        raise InputError(f"{path}: norm: expected fully_normalized, got {norm!r}")
    highest = max((n for n, *_ in records), default=-1)
    if highest < (degree or 0):
        raise InputError(
            f"{path}: expected coefficients up to degree {degree or 0}, got degree {highest}"
        )
    C, S = np.zeros((2, highest + 1, highest + 1))
    for n, m, c, s in records:
        C[n, m], S[n, m] = c, s
    return Gravity(sizes[0], sizes[1], C, S)
