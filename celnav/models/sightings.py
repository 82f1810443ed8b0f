"""Celestial sightings of a satellite: angles to two stars, and the Earth's angular diameter. Units:
km, rad.

Three angles ``(A1, A2, A3)`` determine a position, except on which side of the plane of the two
stars it lies [Sun2015, Eqs. 40-43, corrected]::

    A1, A2: between the satellite's position vector and the stars
    A3 = 2 arcsin(R_e / r): the Earth's angular diameter

The stars lie in the equatorial plane: the first along x, the second at an angle ``separation``. So
the side is the hemisphere.
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
    """Angles ``(..., k + 1)`` rad at positions ``(..., 3)`` km: to stars ``(k, 3)``, unit vectors,
    then the Earth's angular diameter, which is nan inside the Earth.
    """
    r = np.sqrt(np.einsum("...i,...i->...", position, position))[..., None]
    cosines, ratio = np.clip(position / r @ stars.T, -1.0, 1.0), radius_km / r
    diameter = 2.0 * np.arcsin(np.where(ratio <= 1.0, ratio, np.nan))
    return np.concatenate([np.arccos(cosines), diameter], -1)


def visible(position: Array, stars: Array, radius_km: float = EARTH.radius_km) -> Array:
    """Mask ``(..., k)`` of the stars that the Earth does not hide from positions ``(..., 3)``."""
    A = angles(position, stars, radius_km)
    # As seen from the satellite, the Earth's center is opposite to the position vector.
    return np.asanyarray(np.pi - A[..., :-1] > 0.5 * A[..., -1:])


def observe(position: Array, stars: Array, radius_km: float = EARTH.radius_km) -> Array:
    """`angles` with nan for each star that the Earth hides; filters skip nan components."""
    A = angles(position, stars, radius_km)
    A[..., :-1] = np.where(visible(position, stars, radius_km), A[..., :-1], np.nan)
    return A


def limb(position: Array, toward: Array, radius_km: float = EARTH.radius_km) -> Array:
    """Limb points ``(..., 2, 3)`` km, where lines of sight touch the Earth, in the plane of a
    position and a direction ``toward``, ``(..., 3)``.
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
    """Pseudo-position ``(..., 3)`` km from three angles, see `angles`
    [Sun2015, Eqs. 41-42, corrected].

    A: angles ``(..., 3)`` rad, with ``A3`` between 0 and pi; nan gives nan.
    separation: angle between the stars, rad.
    hemisphere: +1 or -1, ``(...)``, the sign of z, which the angles do not determine.
    strict: raise ValueError for angles that no position has (noise may cause them); False gives nan
        for them.
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
            f"hemisphere: expected one sign, or one for each of {measured.shape[:-1]} positions, "
            f"got shape {side.shape}"
        )
    if (np.abs(side) != 1.0).any():
        raise ValueError(f"hemisphere: expected +1 or -1, got {hemisphere!r:.80}")
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
            f"A: expected angles of a position (z^2 >= 0), got {count} sets of other angles; "
            "strict=False gives nan for them"
        )
    uz = side * np.sqrt(np.where(impossible, np.nan, square))
    r = radius_km / np.sin(0.5 * diameter)
    return np.stack([r * ux, r * uy, r * uz], -1)


def jacobian(
    A: Array, separation: float, hemisphere: ArrayLike = 1.0, radius_km: float = EARTH.radius_km
) -> Array:
    """Jacobian ``(..., 3, 3)`` km/rad of `position` with respect to the angles; ValueError for
    z = 0, where there is none.
    """
    place = position(A, separation, hemisphere, radius_km=radius_km)
    r = np.linalg.norm(place, axis=-1, keepdims=True)
    u = place / r
    # z is a square root: closer to 0 it consists of round-off.
    if (np.abs(u[..., 2]) < 1e-7).any():
        raise ValueError("A: expected a position off the plane of the stars, got z = 0")
    A1, A2, A3 = np.moveaxis(numbers("A", A), -1, 0)
    # Derivatives of the unit vector with respect to A1 and A2, then of the radius w.r.t. A3.
    ux = np.stack([-np.sin(A1), np.zeros_like(A1)], -1)
    uy = np.stack([np.sin(A1) / np.tan(separation), -np.sin(A2) / np.sin(separation)], -1)
    uz = -(u[..., :1] * ux + u[..., 1:2] * uy) / u[..., 2:]
    along = -0.5 * (r / np.tan(0.5 * A3)[..., None]) * u
    return np.concatenate([r[..., None] * np.stack([ux, uy, uz], -2), along[..., None]], -1)


def pseudo_position_covariance(position_km: Array, separation: float, sigma: ArrayLike) -> Array:
    """Covariance ``(..., 3, 3)`` km^2 of the pseudo-position at ``position_km (..., 3)``.

    separation: angle between the stars, rad. sigma: ``(3,)`` rad, standard deviations of the
    angles; `UnitWarning` above 1 rad.
    """
    deviations, position_km = (
        finite("sigma", sigma, (3,)),
        finite("position_km", position_km, (..., 3)),
    )
    if (np.abs(deviations) > 1.0).any():
        text = (
            f"sigma: a standard deviation of {np.abs(deviations).max():.6g} rad is more than 1; "
            "angles are in radians"
        )
        warnings.warn(text, UnitWarning, stacklevel=2)
    # P = J diag(sigma^2) J', so J diag(sigma) is a root of it.
    half = deviations * jacobian(
        angles(position_km, star_directions(separation)), separation, np.sign(position_km[..., 2])
    )
    return np.asanyarray(half @ half.mT)
