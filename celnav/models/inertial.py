"""Errors of a strapdown inertial navigation system at large misalignment, and what star sensors and SAR see of them.

State ``(..., 13)``: misalignment phi (3, rad), errors of the east and north velocity (2, m/s), of longitude and latitude
(2, rad), gyro drift eps (3, rad/s), accelerometer bias nabla (3, m/s^2); errors are computed minus true [Liang2014].
Frames: n east, north, up; n' the same as the system computes it; b the body. The misalignment are the Euler angles of
``C_n^n' = C_y(phi_y) C_x(phi_x) C_z(phi_z)``. Given phi, the dynamics are linear in the other ten states, and the
measurements are nonlinear in phi only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from celnav.gaussian.checks import finite, instance
from celnav.gaussian.linalg import Array, components, leading, matvec
from celnav.models import earth
from celnav.models.trajectory import Flight

PHI, VELOCITY, POSITION, DRIFT, BIAS = slice(0, 3), slice(3, 5), slice(5, 7), slice(7, 10), slice(10, 13)
STATES = ("phi_x", "phi_y", "phi_z", "dVx", "dVy", "dlon", "dlat", "eps_x", "eps_y", "eps_z", "nabla_x", "nabla_y", "nabla_z")
SINGULAR = np.radians(89.0)
"""The Euler angles end at phi_x = 90 degrees; `step` refuses points beyond this."""


class Navigation(NamedTuple):
    """What the system knows during an interval: inputs of the error model.

    Attributes
    ----------
    attitude: ``(..., 3, 3)``, C_b^n', computed. force: ``(..., 3)`` m/s^2, measured, on the axes n'.
    velocity: ``(..., 2)`` m/s, east and north (level flight). latitude: ``(...)`` rad. height_m.
    """

    attitude: Array
    force: Array
    velocity: Array
    latitude: Array
    height_m: float


def navigation(flight: Flight, at: Array | int | slice, phi: Array, bias: Array) -> Navigation:
    """Inputs at the epochs ``at`` of a flight whose system has a true misalignment and accelerometer bias ``(..., 3)``."""
    instance("flight", flight, Flight, "a Flight, such as celnav.models.trajectory.turning_flight(times, ...)")
    phi, bias = finite("phi", phi, (..., 3)), finite("bias", bias, (..., 3))
    try:
        if at is None:
            raise IndexError
        true = flight.attitude[at]
    except (IndexError, ValueError):
        count = len(flight.times)
        raise ValueError(f"at: expected numbers of epochs below {count}, one, several or a slice, got {at!r:.80}") from None
    attitude = misalignment_matrix(phi) @ true
    return Navigation(
        attitude, matvec(attitude, flight.force[at] + bias), flight.velocity[at, :2], flight.latitude[at], flight.height_m
    )


def misalignment_matrix(phi: Array) -> Array:
    """``C_n^n' (..., 3, 3)`` of Euler angles ``(..., 3)``."""
    out: Array = np.empty((*phi.shape[:-1], 3, 3))
    for i, row in enumerate(_rows(*_sines(leading(phi)))):
        for j, entry in enumerate(row):
            out[..., i, j] = entry
    return out


def misalignment_angles(C: Array) -> Array:
    """Euler angles ``(..., 3)`` of ``C_n^n' (..., 3, 3)``."""
    x = np.arcsin(np.clip(C[..., 1, 2], -1.0, 1.0))
    return np.stack([x, np.arctan2(-C[..., 0, 2], C[..., 2, 2]), np.arctan2(-C[..., 1, 0], C[..., 1, 1])], -1)


def _sines(phi: Array) -> tuple[Array, Array]:
    """Sines and cosines of angles with the component axis first."""
    return np.sin(phi), np.cos(phi)


def _rows(s: Array, c: Array) -> tuple[tuple[Array, ...], ...]:
    """Rows of ``C_n^n'``."""
    (sx, sy, sz), (cx, cy, cz) = s, c
    a, b = sy * sx, cy * sx
    return (
        (cy * cz - a * sz, cy * sz + a * cz, -sy * cx),
        (-cx * sz, cx * cz, sx),
        (sy * cz + b * sz, sy * sz - b * cz, cy * cx),
    )


def derivative(x: Array, nav: Navigation) -> Array:
    """Rate of the state ``(..., 13)``; gyro drift and accelerometer bias are constant [Liang2014, Eqs. 20-25, corrected]."""
    return np.moveaxis(_derivative(components(x), nav), 0, -1)


def step(x: Array, nav: Navigation, dt: float) -> Array:
    """State ``(..., 13)`` after ``dt`` seconds, inputs at the middle of the interval; conditionally linear given phi.

    Raises
    ------
    ValueError: if a misalignment phi_x is within a degree of +-90 degrees, where the Euler angles end.
    """
    worst = np.abs(x[..., 0]).max(initial=0.0)
    if worst >= SINGULAR:
        raise ValueError(
            f"phi_x: expected less than 89 degrees at every sigma point, got {np.degrees(worst):.1f} (take a star fix first)"
        )
    return advance(x, nav, dt)


def advance(x: Array, nav: Navigation, dt: float) -> Array:
    """As `step`, without the check: for the truth, which is no average of points, and for callers that look themselves."""
    X = components(x)
    rate = _derivative(X, nav)
    # The position moves with the velocity error in the middle of the interval.
    half = 0.5 * dt
    east, north = _radii(nav)
    rate[5] += half * rate[3] / (east * np.cos(nav.latitude))
    rate[6] += half * rate[4] / north
    out = X + dt * rate
    return out.transpose((*range(1, x.ndim), 0))


def _radii(nav: Navigation) -> tuple[Array, Array]:
    """Radii of curvature plus height, across and along the meridian, m."""
    return earth.transverse_radius(nav.latitude) + nav.height_m, earth.meridian_radius(nav.latitude) + nav.height_m


def _derivative(X: Array, nav: Navigation) -> Array:
    """As `derivative`, component axis first."""
    s, c = _sines(X[:3])
    C = _rows(s, c)
    Vx, Vy, dL = X[3], X[4], X[6]
    L, (east, north) = nav.latitude, _radii(nav)
    secL, tanL = 1.0 / np.cos(L), np.tan(L)
    vx, vy = nav.velocity[..., 0], nav.velocity[..., 1]
    ie = leading(earth.earth_rate(L))
    en = leading(earth.transport_rate(nav.velocity, L, nav.height_m))
    in_ = ie + en
    Cb = leading(leading(nav.attitude))
    f = leading(nav.force)
    eps, nabla = X[7:10], X[10:13]

    # The errors of the computed rates; that of the Earth's rate has no east component.
    d_ie = (0.0, -ie[2] * dL, ie[1] * dL)
    d_en = (-Vy / north, Vx / east, Vx * (tanL / east) + dL * (vx * secL * secL / east))

    # Rotation of n' against n, on the axes n'.
    w = [
        in_[i] - (C[i][0] * in_[0] + C[i][1] * in_[1] + C[i][2] * in_[2])
        - (Cb[i, 0] * eps[0] + Cb[i, 1] * eps[1] + Cb[i, 2] * eps[2]) + (d_ie[i] + d_en[i])
        for i in range(3)
    ]  # fmt: skip
    out = np.zeros_like(X, shape=np.broadcast_shapes(X.shape, (13, *w[0].shape)))
    (sx, sy, _), (cx, cy, _) = s, c
    turn = cy * w[2] - sy * w[0]  # C_omega w, row by row
    out[0] = cy * w[0] + sy * w[2]
    out[1] = w[1] - (sx / cx) * turn
    out[2] = turn / cx

    # Velocity: f' - C' (f' - C_b^n' nabla), Coriolis terms of the error and of the rates' errors.
    g = [f[i] - (Cb[i, 0] * nabla[0] + Cb[i, 1] * nabla[1] + Cb[i, 2] * nabla[2]) for i in range(3)]
    spin = 2.0 * ie + en
    error_z = 2.0 * d_ie[2] + d_en[2]
    out[3] = f[0] - (C[0][0] * g[0] + C[1][0] * g[1] + C[2][0] * g[2]) + spin[2] * Vy + error_z * vy
    out[4] = f[1] - (C[0][1] * g[0] + C[1][1] * g[1] + C[2][1] * g[2]) - spin[2] * Vx - error_z * vx
    out[5] = (secL / east) * Vx + (vx * secL * tanL / east) * dL
    out[6] = Vy / north
    return out


def star_residuals(x: Array, attitude: Array, stars: Array) -> Array:
    """Measured minus predicted star vectors on body axes, ``(..., 3 k)``: ``C_n'^b (C_n^n' - I) r`` [Liang2014, Eqs. 26-28].

    Parameters
    ----------
    x: state ``(..., 13)``. attitude: ``(..., 3, 3)``, C_b^n'. stars: ``(k, 3)`` or ``(..., k, 3)``, unit directions on n.
    """
    X = components(x)
    C = _rows(*_sines(X[:3]))
    Cb = leading(leading(attitude))
    shape = np.broadcast_shapes(x.shape[:-1], attitude.shape[:-2], stars.shape[:-2])
    out = np.empty_like(X, shape=(3 * stars.shape[-2], *shape))
    for k in range(stars.shape[-2]):
        r = leading(stars[..., k, :])
        turned = [C[i][0] * r[0] + C[i][1] * r[1] + C[i][2] * r[2] - r[i] for i in range(3)]
        for j in range(3):
            out[3 * k + j] = Cb[0, j] * turned[0] + Cb[1, j] * turned[1] + Cb[2, j] * turned[2]
    return np.moveaxis(out, 0, -1)


def check_stars(stars: Array, name: str = "stars") -> Array:
    """Unit star directions ``(..., k, 3)``.

    Raises
    ------
    ValueError: if one is not finite or not of unit length to 1e-6.
    """
    directions = finite(name, stars, (..., "k", 3))
    length = np.linalg.norm(directions, axis=-1)
    if (np.abs(length - 1.0) > 1e-6).any():
        raise ValueError(f"{name}: expected unit vectors, got lengths from {length.min():.6g} to {length.max():.6g}")
    return directions


def wahba_misalignment(z: Array, attitude: Array, stars: Array) -> Array:
    """Misalignment ``(..., 3)`` that fits measured star residuals ``z (..., 3 k)`` best: Wahba's problem, by SVD [Markley1988].

    Raises
    ------
    ValueError: if all stars are parallel (``|r_1 x r_2| < 1e-3``), which leaves a rotation about them free.
    """
    directions = check_stars(stars)
    k = directions.shape[-2]
    if k < 2 or (np.linalg.norm(np.cross(directions[..., 0, :], directions[..., 1, :]), axis=-1) < 1e-3).all():
        raise ValueError("stars: expected two directions that are not parallel (|r_1 x r_2| >= 1e-3)")
    z, attitude = finite("z", z, (..., 3 * k)), finite("attitude", attitude, (..., 3, 3))
    body = z.reshape(*z.shape[:-1], k, 3)
    seen = np.einsum("...ij,...kj->...ki", attitude, body) + directions  # C_n^n' r on n'
    U, _, Vt = np.linalg.svd(np.einsum("...ki,...kj->...ij", seen, np.broadcast_to(directions, seen.shape)))
    U[..., :, -1] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return misalignment_angles(U @ Vt)
