"""Broadcast orbits and clocks of BeiDou (B1I; MEO, IGSO and GEO) [BDS-SIS-ICD], GPS (L1 C/A)
[IS-GPS-200] and Galileo (E1) [Galileo-OS-SIS-ICD].

Positions are in m on the Earth-fixed axes at the time of the position. CGCS2000, WGS 84 and GTRF
agree to centimeters. Times are seconds of BDT since 2006-01-01 (week times 604,800 plus seconds of
week). GPS time and Galileo system time are ahead of BDT by 14 s. Satellites are on the last axis of
every element.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Array

GRAVITY_PARAMETER = 3.986004418e14  # m^3/s^2, of BeiDou and Galileo
ROTATION_RATE = 7.2921150e-5  # rad/s, of BeiDou
# GPS elements use these two constants; Galileo elements use this rotation rate too.
GPS_GRAVITY_PARAMETER, GPS_ROTATION_RATE = 3.986005e14, 7.2921151467e-5
LIGHT = 299792458.0  # m/s
B1I_HZ, L1_HZ = 1561.098e6, 1575.42e6
WEEK_S = 604800.0
GPS_AHEAD_S = 14.0
SYSTEM_LETTERS = "CGE"
"""BeiDou, GPS and Galileo, in the order of `Broadcast.system`."""
BEIDOU, GPS, GALILEO = range(3)
GEO_NUMBERS = frozenset({*range(1, 6), *range(59, 64)})
TILT = np.radians(5.0)
"""Tilt of the reference plane of geostationary orbits; without it the node would be undefined."""


@dataclass(frozen=True, eq=False)
class Broadcast:
    """Broadcast elements of satellites, each field ``(S,)``; angles in rad, lengths in m, times in
    s. ValueError if a field is not finite or is out of range.

    number: number of the satellite, 1 for C01.
    system: 0 for BeiDou, 1 for GPS, 2 for Galileo.
    toe, toc: reference times of orbit and clock, BDT.
    sqrt_a, e, i0, Omega0, omega, M0, delta_n, Omega_dot, i_dot, cuc, cus, crc, crs, cic, cis: orbit
        elements and corrections.
    a0, a1, a2: clock polynomial.
    tgd: group delay of B1I, L1 or E1, s; for Galileo, for the pair of signals of the clock.
    health: 0 if healthy.
    accuracy: range accuracy that the satellite predicts for its orbit and clock (URA, SISA), m; 0
        if it is unknown.
    """

    number: Array
    system: Array
    toe: Array
    sqrt_a: Array
    e: Array
    i0: Array
    Omega0: Array
    omega: Array
    M0: Array
    delta_n: Array
    Omega_dot: Array
    i_dot: Array
    cuc: Array
    cus: Array
    crc: Array
    crs: Array
    cic: Array
    cis: Array
    toc: Array
    a0: Array
    a1: Array
    a2: Array
    tgd: Array
    health: Array
    accuracy: Array

    def __post_init__(self) -> None:
        count = np.size(self.number)
        for field in fields(self):
            object.__setattr__(
                self, field.name, finite(field.name, getattr(self, field.name), (count,))
            )
        if not np.isin(self.system, range(len(SYSTEM_LETTERS))).all():
            raise ValueError(
                f"system: expected 0 (BeiDou), 1 (GPS) or 2 (Galileo), got {self.system}"
            )
        if count and (self.e.max() >= 1.0 or self.e.min() < 0.0):
            raise ValueError(f"e: expected eccentricities 0 <= e < 1, got {self.e}")
        if count and self.sqrt_a.min() <= 0.0:
            raise ValueError(
                f"sqrt_a: expected positive roots of semi-major axes, got {self.sqrt_a}"
            )

    def __len__(self) -> int:
        return len(self.number)

    @property
    def names(self) -> list[str]:
        """Names of the satellites ``(S,)``: C01, G02, E03, ..."""
        return [
            f"{SYSTEM_LETTERS[int(system)]}{int(n):02d}"
            for system, n in zip(self.system, self.number, strict=True)
        ]

    @property
    def geostationary(self) -> Array:
        """Mask ``(S,)`` of the satellites whose elements refer to the tilted plane."""
        geostationary = np.isin(self.number, sorted(GEO_NUMBERS))
        return np.asarray(geostationary & (self.system == BEIDOU))

    def chosen(self, which: Array) -> Broadcast:
        """The `Broadcast` of the satellites that an index or a mask selects."""
        return Broadcast(*(getattr(self, field.name)[which] for field in fields(self)))


class SatelliteState(NamedTuple):
    """Earth-fixed positions (m) and velocities (m/s) ``(..., S, 3)``; clock offsets (s, positive
    ahead of BDT) and their rates ``(..., S)``.
    """

    position: Array
    velocity: Array
    clock: Array
    drift: Array


def satellites(broadcast: Broadcast, t: Array | float) -> SatelliteState:
    """`SatelliteState` of all satellites at times ``t``, ``(..., S)`` or a number, s BDT.

    Velocities are the exact derivatives of the positions.
    """
    b, t = broadcast, np.asarray(t, dtype=np.float64)
    # Times since the reference, within half a week.
    tk, dt = ((since - WEEK_S * np.round(since / WEEK_S)) for since in (t - b.toe, t - b.toc))
    root_mu = np.sqrt(np.where(b.system == GPS, GPS_GRAVITY_PARAMETER, GRAVITY_PARAMETER))
    spin = np.where(b.system == BEIDOU, ROTATION_RATE, GPS_ROTATION_RATE)
    # Kepler's equation E - e sin E = M; shrunk = r / a, and E' = n / shrunk.
    n = root_mu / b.sqrt_a**3 + b.delta_n
    E = eccentric_anomaly(b.M0 + n * tk, b.e)
    sin_E, cos_E = np.sin(E), np.cos(E)
    shrunk = 1.0 - b.e * cos_E
    E_dot = n / shrunk
    root = np.sqrt(1.0 - b.e**2)
    phi, phi_dot = np.arctan2(root * sin_E, cos_E - b.e) + b.omega, root * E_dot / shrunk

    # In the plane of the orbit, with the corrections of latitude, radius and inclination.
    s, c = np.sin(2.0 * phi), np.cos(2.0 * phi)
    u, u_dot = phi + b.cus * s + b.cuc * c, phi_dot * (1.0 + 2.0 * (b.cus * c - b.cuc * s))
    A = b.sqrt_a**2
    r, r_dot = (
        A * shrunk + b.crs * s + b.crc * c,
        A * b.e * sin_E * E_dot + 2.0 * phi_dot * (b.crs * c - b.crc * s),
    )
    i, i_dot = (
        b.i0 + b.i_dot * tk + b.cis * s + b.cic * c,
        b.i_dot + 2.0 * phi_dot * (b.cis * c - b.cic * s),
    )
    x, y = r * np.cos(u), r * np.sin(u)
    x_dot, y_dot = r_dot * np.cos(u) - y * u_dot, r_dot * np.sin(u) + x * u_dot

    # Earth-fixed, from the longitude of the node. For a geostationary orbit the axes do not rotate
    # with the Earth until the end, after the tilt.
    geo = b.geostationary
    turning = b.Omega_dot - np.where(geo, 0.0, spin)
    # toe as seconds of the week in the time scale of the satellite's system.
    node = b.Omega0 + turning * tk - spin * np.mod(b.toe + ahead_s(b.system), WEEK_S)
    cos_O, sin_O, cos_i, sin_i = np.cos(node), np.sin(node), np.cos(i), np.sin(i)
    across, across_dot = y * cos_i, y_dot * cos_i - y * sin_i * i_dot
    P = np.stack([x * cos_O - across * sin_O, x * sin_O + across * cos_O, y * sin_i], -1)
    along = [
        x_dot * cos_O - across_dot * sin_O,
        x_dot * sin_O + across_dot * cos_O,
        y_dot * sin_i + y * cos_i * i_dot,
    ]
    V = np.stack(along, -1) + spun(P, turning)
    if geo.any():
        fixed = turned(tilted(P, -TILT), ROTATION_RATE * tk)
        moving = turned(tilted(V, -TILT), ROTATION_RATE * tk) - spun(fixed, ROTATION_RATE)
        P, V = np.where(geo[:, None], fixed, P), np.where(geo[:, None], moving, V)
    periodic = -2.0 * root_mu / LIGHT**2 * b.e * b.sqrt_a
    clock = b.a0 + dt * (b.a1 + dt * b.a2) + periodic * sin_E - b.tgd
    return SatelliteState(P, V, clock, b.a1 + 2.0 * b.a2 * dt + periodic * cos_E * E_dot)


def ahead_s(system: Array) -> Array:
    """A system's time minus BDT, s, in the shape of ``system``, which is as in `Broadcast`."""
    return np.where(np.asarray(system) == BEIDOU, 0.0, GPS_AHEAD_S)


def eccentric_anomaly(mean: Array, e: Array) -> Array:
    """Eccentric anomaly (rad) from the mean anomaly by Newton's method, to round-off for e < 0.9.

    The result has the shape of the arguments.
    """
    E = mean + e * np.sin(mean)
    for _ in range(8):
        E = E - (E - e * np.sin(E) - mean) / (1.0 - e * np.cos(E))
    return np.asarray(E)


def tilted(vectors: Array, angle: float) -> Array:
    """``R_x(angle)`` times vectors ``(..., 3)``."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack(
        [x, np.cos(angle) * y + np.sin(angle) * z, np.cos(angle) * z - np.sin(angle) * y], -1
    )


def turned(vectors: Array, angle: Array) -> Array:
    """``R_z(angle)`` times vectors ``(..., 3)``: components on axes rotated by ``angle (...)``."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack(
        [np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x, z], -1
    )


def spun(places: Array, rate: Array | float) -> Array:
    """Velocities of positions ``(..., 3)`` that rotate about z at a rate ``(...)`` rad/s."""
    x, y, z = np.moveaxis(places, -1, 0)
    return np.stack([-y * rate, x * rate, np.zeros_like(z)], -1)
