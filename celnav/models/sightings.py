"""Celestial sightings: angles between the Earth's center and stars, and the Earth's angular
diameter. Units: km, rad.

Three angles ``(A1, A2, A3)`` fix a position up to the side of the plane of the two stars
[Sun2015, Eqs. 40-43, corrected]::

    A1, A2: between the satellite's position vector and the stars
    A3 = 2 arcsin(R_e / r): the Earth's diameter

The stars lie in the equatorial plane, the first along x, the second ``separation`` away, so the
side is the hemisphere.
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from celnav.gaussian.checks import finite, number, numbers, together
from celnav.gaussian.linalg import Array
from celnav.models.orbit import EARTH, UnitWarning, warn_of_degrees


def star_directions(separation: float) -> Array:
    """Unit vectors ``(2, 3)`` of the two stars, ``separation`` rad apart; ValueError if they are
    parallel.
    """
    theta = number("separation", separation)
    if abs(np.sin(theta)) < 1e-6:
        raise ValueError(
            f"separation: expected two directions, got parallel stars at {separation!r} rad"
        )
    warn_of_degrees("separation", theta)
    return np.array([[1.0, 0.0, 0.0], [np.cos(theta), np.sin(theta), 0.0]])


def angles(position: Array, stars: Array, radius_km: float = EARTH.radius_km) -> Array:
    """Angles ``(..., k + 1)`` of positions: to stars ``(k, 3)`` of unit length, then the Earth's
    diameter; nan inside the Earth.
    """
    r = np.sqrt(np.einsum("...i,...i->...", position, position))[..., None]
    cosines, ratio = np.clip(position / r @ stars.T, -1.0, 1.0), radius_km / r
    diameter = 2.0 * np.arcsin(np.where(ratio <= 1.0, ratio, np.nan))
    return np.concatenate([np.arccos(cosines), diameter], -1)


def visible(position: Array, stars: Array, radius_km: float = EARTH.radius_km) -> Array:
    """Mask ``(..., k)`` of the stars that the Earth does not hide from positions ``(..., 3)``."""
    A = angles(position, stars, radius_km)
    # Seen from the satellite the Earth's center lies opposite to the position vector.
    return np.asanyarray(np.pi - A[..., :-1] > 0.5 * A[..., -1:])


def observe(position: Array, stars: Array, radius_km: float = EARTH.radius_km) -> Array:
    """`angles`, with nan for each star that the Earth hides: a filter skips these components."""
    A = angles(position, stars, radius_km)
    A[..., :-1] = np.where(visible(position, stars, radius_km), A[..., :-1], np.nan)
    return A


def limb(position: Array, toward: Array, radius_km: float = EARTH.radius_km) -> Array:
    """Points ``(..., 2, 3)`` km where sight lines touch the Earth, in the plane of a position and a
    direction ``(..., 3)``.
    """
    r = np.linalg.norm(position, axis=-1, keepdims=True)
    up = position / r
    # The horizontal part of the direction, in the plane of the limb points.
    along = toward - np.sum(toward * up, -1, keepdims=True) * up
    along, sine = along / np.linalg.norm(along, axis=-1, keepdims=True), radius_km / r
    return radius_km * np.stack(
        [sine * up + side * np.sqrt(1.0 - sine**2) * along for side in (1.0, -1.0)], -2
    )


def position(
    A: ArrayLike,
    separation: float,
    hemisphere: ArrayLike = 1.0,
    *,
    radius_km: float = EARTH.radius_km,
    strict: bool = True,
) -> Array:
    """Pseudo-position ``(..., 3)`` from three angles ``(..., 3)``, see `angles`
    [Sun2015, Eqs. 41-42, corrected].

    A: angles, ``A3`` between 0 and pi; nan components give nan. separation: between the stars, rad.
    hemisphere: +1 or -1, the sign of z ``(...)``, which the angles do not determine.
    strict: raise ValueError for angles that no position has, which noise may cause; otherwise they
        give nan.
    """
    measured = numbers("A", A, (..., 3))
    if np.isinf(measured).any():
        raise ValueError(
            f"A: expected finite numbers or nan, got {np.count_nonzero(np.isinf(measured))} "
            "infinite ones"
        )
    warn_of_degrees("A", measured[..., :2])
    star_directions(separation)
    side, radius_km = finite("hemisphere", hemisphere), number("radius_km", radius_km, above=0.0)
    if together(A=measured.shape[:-1], hemisphere=side.shape) != measured.shape[:-1]:
        raise ValueError(
            f"hemisphere: expected one, or one for each of {measured.shape[:-1]} positions, got "
            f"shape {side.shape}"
        )
    if (np.abs(side) != 1.0).any():
        raise ValueError("hemisphere: expected +1 or -1")
    diameter = measured[..., 2]
    if ((diameter <= 0.0) | (diameter >= np.pi)).any():
        raise ValueError(
            f"A: expected an angular diameter between 0 and pi, got {diameter.min():.6g} to "
            f"{diameter.max():.6g}"
        )
    # cos A1 = u_x, cos A2 = u_x cos s + u_y sin s, and r = R / sin(A3 / 2).
    ux, c2 = np.cos(measured[..., 0]), np.cos(measured[..., 1])
    uy = (c2 - ux * np.cos(separation)) / np.sin(separation)
    square = 1.0 - ux * ux - uy * uy
    impossible = square < 0.0
    if strict and impossible.any():
        count = np.count_nonzero(impossible)
        raise ValueError(
            f"A: {count} sets of angles belong to no position (z^2 < 0); strict=False gives nan"
        )
    uz = side * np.sqrt(np.where(impossible, np.nan, square))
    r = radius_km / np.sin(0.5 * diameter)
    return np.stack([r * ux, r * uy, r * uz], -1)


def jacobian(
    A: Array, separation: float, hemisphere: ArrayLike = 1.0, radius_km: float = EARTH.radius_km
) -> Array:
    """Jacobian ``(..., 3, 3)`` of `position` with respect to the angles, km/rad; ValueError where z
    = 0, which has none.
    """
    place = position(A, separation, hemisphere, radius_km=radius_km)
    r = np.linalg.norm(place, axis=-1, keepdims=True)
    u = place / r
    # z is a square root: closer to 0 there is only rounding.
    if (np.abs(u[..., 2]) < 1e-7).any():
        raise ValueError("A: expected a position off the plane of the stars, got z = 0")
    A1, A2, A3 = np.moveaxis(numbers("A", A), -1, 0)
    # Derivatives of the unit vector with respect to A1 and A2, then of the radius to A3, along it.
    ux = np.stack([-np.sin(A1), np.zeros_like(A1)], -1)
    uy = np.stack([np.sin(A1) / np.tan(separation), -np.sin(A2) / np.sin(separation)], -1)
    uz = -(u[..., :1] * ux + u[..., 1:2] * uy) / u[..., 2:]
    along = -0.5 * (r / np.tan(0.5 * A3)[..., None]) * u
    return np.concatenate([r[..., None] * np.stack([ux, uy, uz], -2), along[..., None]], -1)


def pseudo_position_covariance(position_km: Array, separation: float, sigma: ArrayLike) -> Array:
    """Covariance ``(..., 3, 3)`` km^2 of the pseudo-position for standard deviations ``sigma (3,)``
    rad of the angles, with a warning above 1.
    """
    deviations, position_km = (
        finite("sigma", sigma, (3,)),
        finite("position_km", position_km, (..., 3)),
    )
    if (np.abs(deviations) > 1.0).any():
        text = (
            f"sigma: a deviation of {np.abs(deviations).max():.6g} rad tells nothing; "
            "angles are in radians"
        )
        warnings.warn(text, UnitWarning, stacklevel=2)
    # P = J diag(sigma^2) J', so J diag(sigma) is a root of it.
    half = deviations * jacobian(
        angles(position_km, star_directions(separation)), separation, np.sign(position_km[..., 2])
    )
    return np.asanyarray(half @ half.mT)
