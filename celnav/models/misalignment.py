"""Errors of a strapdown inertial navigation system at large misalignment, and measurements of them
by star sensors and SAR.

Error state ``(..., 13)``, computed minus true [Liang2014]: misalignment phi (3, rad), errors of
east and north velocity (2, m/s) and of longitude and latitude (2, rad), gyro drift eps (3, rad/s),
accelerometer bias nabla (3, m/s^2). Frames: n is east, north, up; n' is n as the system computes
it; b is the body. The misalignment consists of the Euler angles of
``C_n^n' = C_y(phi_y) C_x(phi_x) C_z(phi_z)``. Given phi, the dynamics are linear in the other ten
states, and the measurements are nonlinear in phi only. `mechanize` simulates the complete system,
as a reference for this error model.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from celnav.gaussian.checks import finite, instance
from celnav.gaussian.linalg import Array, matvec
from celnav.gaussian.spaces import component_major, components_first, points_last
from celnav.models import earth
from celnav.models.earth import Flight

PHI, VELOCITY, POSITION, DRIFT, BIAS = (
    slice(0, 3),
    slice(3, 5),
    slice(5, 7),
    slice(7, 10),
    slice(10, 13),
)
STATES = (
    "phi_x",
    "phi_y",
    "phi_z",
    "dVx",
    "dVy",
    "dlon",
    "dlat",
    "eps_x",
    "eps_y",
    "eps_z",
    "nabla_x",
    "nabla_y",
    "nabla_z",
)
SINGULAR = np.radians(89.0)
"""Limit of phi_x, rad: the Euler angles are singular at 90 degrees, and sigma points beyond are
meaningless.
"""
FLIGHT = "a Flight, such as celnav.models.earth.turning_flight(times, ...)"


class Navigation(NamedTuple):
    """Computed values of the navigation system, the inputs of the error model.

    attitude: ``(..., 3, 3)``, computed C_b^n'. force: ``(..., 3)`` m/s^2, measured specific force
        on n'.
    velocity: ``(..., 2)`` m/s, east and north (level flight). latitude: ``(...)`` rad. height_m: m.
    """

    attitude: Array
    force: Array
    velocity: Array
    latitude: Array
    height_m: float


def navigation(flight: Flight, at: Array | int | slice, phi: Array, bias: Array) -> Navigation:
    """`Navigation` at the epochs ``at`` (an index, indices or a slice) of a flight.

    phi, bias: true misalignment (rad) and accelerometer bias (m/s^2), ``(..., 3)``. ValueError for
    an epoch beyond the flight.
    """
    instance("flight", flight, Flight, FLIGHT)
    phi, bias = finite("phi", phi, (..., 3)), finite("bias", bias, (..., 3))
    try:
        if at is None:
            raise IndexError
        true = flight.attitude[at]
    except (IndexError, ValueError):
        count = len(flight.times)
        raise ValueError(
            f"at: expected an index below {count}, several, or a slice, got {at!r:.80}"
        ) from None
    attitude = misalignment_matrix(phi) @ true
    # Accelerometers measure on b; the computed attitude transforms this to n'.
    force = matvec(attitude, flight.force[at] + bias)
    return Navigation(
        attitude, force, flight.velocity[at, :2], flight.latitude[at], flight.height_m
    )


def misalignment_matrix(phi: Array) -> Array:
    """``C_n^n' (..., 3, 3)`` of Euler angles ``(..., 3)``."""
    return np.moveaxis(
        np.array(_rows(np.sin(components_first(phi)), np.cos(components_first(phi)))),
        (0, 1),
        (-2, -1),
    )


def _rows(s: Array, c: Array) -> tuple[tuple[Array, ...], ...]:
    """Rows of ``C_n^n'`` from the sines and cosines ``(3, ...)`` of the angles."""
    (sx, sy, sz), (cx, cy, cz) = s, c
    a, b = sy * sx, cy * sx
    return (
        (cy * cz - a * sz, cy * sz + a * cz, -sy * cx),
        (-cx * sz, cx * cz, sx),
        (sy * cz + b * sz, sy * sz - b * cz, cy * cx),
    )


def misalignment_angles(C: Array) -> Array:
    """Euler angles ``(..., 3)`` of ``C_n^n' (..., 3, 3)``."""
    x = np.arcsin(np.clip(C[..., 1, 2], -1.0, 1.0))
    return np.stack(
        [x, np.arctan2(-C[..., 0, 2], C[..., 2, 2]), np.arctan2(-C[..., 1, 0], C[..., 1, 1])], -1
    )


def _dot(row: Iterable[Array], v: Iterable[Array]) -> Array:
    """A row of a matrix times a vector, by components: for batches of sigma points several times as
    fast as small matrix products.
    """
    (a, b, c), (x, y, z) = row, v
    product: Array = a * x + b * y + c * z
    return product


def derivative(x: Array, nav: Navigation) -> Array:
    """Time derivative ``(..., 13)`` of the state; gyro drift and accelerometer bias are constant
    [Liang2014, Eqs. 20-25, corrected].
    """
    return np.moveaxis(_rates(component_major(x), nav), 0, -1)


def _rates(X: Array, nav: Navigation) -> Array:
    """`derivative` with the component axis first, ``(13, ...)``."""
    s, c = np.sin(X[PHI]), np.cos(X[PHI])
    C, Cb, f = (
        _rows(s, c),
        components_first(components_first(nav.attitude)),
        components_first(nav.force),
    )
    L, (north, east) = nav.latitude, earth.radii(nav.latitude, nav.height_m)
    (Vx, Vy, _, dL), (vx, vy) = X[3:7], components_first(nav.velocity)
    secL, tanL = 1.0 / np.cos(L), np.tan(L)
    ie, en = (
        components_first(earth.earth_rate(L)),
        components_first(earth.transport_rate(nav.velocity, L, nav.height_m)),
    )

    # Errors of the computed rates w_ie and w_en; the first has no east component.
    d_ie = 0.0, -ie[2] * dL, ie[1] * dL
    d_en = -Vy / north, Vx / east, Vx * (tanL / east) + dL * (vx * secL * secL / east)

    # Rotation rate of n' relative to n, on n', and the resulting rates of the Euler angles.
    rate, drift, bias = ie + en, X[DRIFT], X[BIAS]
    wx, wy, wz = (
        rate[i] - _dot(C[i], rate) - _dot(Cb[i], drift) + (d_ie[i] + d_en[i]) for i in range(3)
    )
    (sx, sy, _), (cx, cy, _) = s, c
    turn = cy * wz - sy * wx
    out = np.zeros_like(X, shape=np.broadcast_shapes(X.shape, (13, *wx.shape)))
    # Rates of the Euler angles from the rotation w on the axes n'.
    out[0], out[1], out[2] = cy * wx + sy * wz, wy - (sx / cx) * turn, turn / cx

    # Velocity: f' - C' (f' - C_b^n' nabla), Coriolis terms of velocity error and of rate errors.
    true = [f[i] - _dot(Cb[i], bias) for i in range(3)]
    fx, fy = (f[i] - _dot((C[0][i], C[1][i], C[2][i]), true) for i in range(2))
    spin, error = 2.0 * ie[2] + en[2], 2.0 * d_ie[2] + d_en[2]
    out[3], out[4] = fx + spin * Vy + error * vy, fy - spin * Vx - error * vx
    out[5], out[6] = (secL / east) * Vx + (vx * secL * tanL / east) * dL, Vy / north
    return out


def advance(x: Array, nav: Navigation, dt: float) -> Array:
    """State ``(..., 13)`` after ``dt`` seconds, with inputs at the middle of the interval; it is
    linear in all states but phi.

    A point near phi_x = 90 degrees is not detected, see `SINGULAR`.
    """
    X = component_major(x)
    rate = _rates(X, nav)
    # The position error uses the velocity error in the middle of the interval.
    half, (north, east) = 0.5 * dt, earth.radii(nav.latitude, nav.height_m)
    rate[5] += half * rate[3] / (east * np.cos(nav.latitude))
    rate[6] += half * rate[4] / north
    return points_last(X + dt * rate)


def star_residuals(x: Array, attitude: Array, stars: Array) -> Array:
    """Measured minus predicted star vectors on body axes, ``(..., 3 k)``: ``C_n'^b (C_n^n' - I) r``
    [Liang2014, Eqs. 26-28].

    x: state ``(..., 13)``. attitude: ``(..., 3, 3)``, C_b^n'. stars: ``(k, 3)`` or ``(..., k, 3)``,
        unit directions on n.
    """
    phi, back = component_major(x)[PHI], components_first(components_first(attitude.mT))
    C = _rows(np.sin(phi), np.cos(phi))
    shape = np.broadcast_shapes(phi.shape[1:], attitude.shape[:-2], stars.shape[:-2])
    out = np.empty_like(phi, shape=(3 * stars.shape[-2], *shape))
    for k, r in enumerate(components_first(stars.mT)):
        star = components_first(r)
        # (C_n^n' - I) r on n', then on body axes.
        moved = [_dot(C[i], star) - star[i] for i in range(3)]
        for i in range(3):
            out[3 * k + i] = _dot(back[i], moved)
    return np.moveaxis(out, 0, -1)


def wahba_misalignment(z: Array, attitude: Array, stars: Array) -> Array:
    """Misalignment ``(..., 3)`` rad that best fits measured star residuals ``z (..., 3 k)``:
    Wahba's problem, solved by SVD [Markley1988].

    attitude: ``(..., 3, 3)``, C_b^n'. stars: ``(..., k, 3)``, unit vectors on n. ValueError if all
    stars are parallel (``|r_i x r_j| < 1e-3``), because the rotation about them is undetermined.
    """
    directions = finite("stars", stars, (..., "k", 3))
    k, length = directions.shape[-2], np.linalg.norm(directions, axis=-1)
    if (np.abs(length - 1.0) > 1e-6).any():
        raise ValueError(
            f"stars: expected unit vectors, got lengths from {length.min():.6g} to "
            f"{length.max():.6g}"
        )
    pairs = np.cross(directions[..., :, None, :], directions[..., None, :, :])
    if (np.linalg.norm(pairs, axis=-1).max((-2, -1), initial=0.0) < 1e-3).any():
        raise ValueError(
            "stars: expected two directions that are not parallel (|r_i x r_j| >= 1e-3), got "
            "parallel ones"
        )
    z, attitude = finite("z", z, (..., 3 * k)), finite("attitude", attitude, (..., 3, 3))
    body = z.reshape(*z.shape[:-1], k, 3)
    rotated = np.einsum("...ij,...kj->...ki", attitude, body) + directions  # C_n^n' r on n'
    U, _, Vt = np.linalg.svd(
        np.einsum("...ki,...kj->...ij", rotated, np.broadcast_to(directions, rotated.shape))
    )
    # The nearest rotation is U diag(1, 1, det(U V')) V'.
    U[..., :, -1] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return misalignment_angles(U @ Vt)


class Solution(NamedTuple):
    """The computed navigation solution: attitude C_b^n' ``(T, 3, 3)``, velocity ``(T, 2)`` m/s,
    longitude and latitude ``(T,)`` rad.
    """

    attitude: Array
    velocity: Array
    longitude: Array
    latitude: Array


def mechanize(flight: Flight, attitude: Array, drift: Array, bias: Array) -> Solution:
    """The `Solution` along a flight from a wrong initial attitude ``(3, 3)``, with gyro ``drift``
    (rad/s) and accelerometer ``bias`` (m/s^2), ``(3,)``.

    Only the horizontal channels are computed; the height is exact. Each step uses the flight at its
    start, middle and end, so the flight has an odd number of epochs (ValueError otherwise). The
    solution has one row per step, after the start.
    """
    t = instance("flight", flight, Flight, FLIGHT).times
    if len(t) < 3 or len(t) % 2 == 0:
        raise ValueError(f"flight: expected an odd number of epochs, three or more, got {len(t)}")
    drift, bias, C = (
        finite("drift", drift, (3,)),
        finite("bias", bias, (3,)),
        finite("attitude", attitude, (3, 3)),
    )
    dt, h, (first, middle, last) = (
        t[2] - t[0],
        flight.height_m,
        (slice(0, -2, 2), slice(1, None, 2), slice(2, None, 2)),
    )
    # Measurements at the middle of each step. Gyros measure rotation relative to inertial space.
    L, b = flight.latitude[middle], flight.attitude
    spin = earth.earth_rate(L) + earth.transport_rate(flight.velocity[middle], L, h)
    turn = Rotation.from_matrix(b[first].mT @ b[last]).as_rotvec()
    gyros, forces = turn / dt + matvec(b[middle].mT, spin) + drift, flight.force[middle] + bias

    def after(dt: float, start: Solution, at: Solution, gyro: Array, force: Array) -> Solution:
        """The solution ``dt`` seconds after ``start``, with the rates at the solution ``at``."""
        # C' = exp(-w_in dt) C exp(w_ib dt), and v' = C f - (2 w_ie + w_en) x v.
        ie, en = earth.earth_rate(at.latitude), earth.transport_rate(at.velocity, at.latitude, h)
        change = at.attitude @ force - np.cross(2.0 * ie + en, np.append(at.velocity, 0.0))
        body, axes = (
            Rotation.from_rotvec(gyro * dt).as_matrix(),
            Rotation.from_rotvec(-(ie + en) * dt).as_matrix(),
        )
        (Vx, Vy), (north, east), cosine = (
            at.velocity,
            earth.radii(at.latitude, h),
            np.cos(at.latitude),
        )
        longitude, latitude = (
            start.longitude + dt * (Vx / (east * cosine)),
            start.latitude + dt * (Vy / north),
        )
        return Solution(
            axes @ start.attitude @ body, start.velocity + dt * change[:2], longitude, latitude
        )

    rows = [Solution(C, flight.velocity[0, :2], flight.longitude[0], flight.latitude[0])]
    for measured in zip(gyros, forces, strict=True):
        halfway = after(0.5 * dt, rows[-1], rows[-1], *measured)
        rows.append(after(dt, rows[-1], halfway, *measured))
    return Solution(*(np.stack(column) for column in zip(*rows, strict=True)))
