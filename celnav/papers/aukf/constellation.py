"""The satellites that the study simulates: broadcast elements of satellites that move as two bodies.

Five geostationary, three inclined geosynchronous on one ground track, and a Walker constellation 24/3/1 [Fan2015, chosen].
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from celnav.gaussian import checks
from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Array
from celnav.models.beidou import GRAVITY_PARAMETER, ROTATION_RATE, TILT, Broadcast, eccentric_anomaly, tilted

SYNCHRONOUS_M = (GRAVITY_PARAMETER / ROTATION_RATE**2) ** (1.0 / 3.0)
MEDIUM_M = 27906.1e3
GEOSTATIONARY = {1: (140.0, 1.2, 40.0), 2: (80.0, 1.6, 70.0), 3: (110.5, 1.4, 55.0), 4: (160.0, 0.9, 100.0), 5: (58.75, 1.0, 20.0)}
"""Number -> longitude, inclination, node, deg."""
INCLINED = (38, 39, 40)
MEDIUM = tuple(n for n in range(19, 47) if n not in (31, *INCLINED))


def kepler(a: float, e: float, i: float, Omega: float, omega: float, M: float) -> tuple[Array, Array]:
    """Position (m) and velocity (m/s) of Keplerian elements (m, rad) in their frame; ``a > 0`` and ``0 <= e < 1``."""
    a, e = checks.number("a", a, above=0.0), checks.number("e", e, 0.0, below=1.0)
    i, Omega, omega, M = (checks.number(*p) for p in (("i", i), ("Omega", Omega), ("omega", omega), ("M", M)))
    E = float(eccentric_anomaly(np.array(M), np.array(e)))
    n, root = np.sqrt(GRAVITY_PARAMETER / a**3), np.sqrt(1.0 - e * e)
    plane = a * np.array([np.cos(E) - e, root * np.sin(E)])
    rates = a * n / (1.0 - e * np.cos(E)) * np.array([-np.sin(E), root * np.cos(E)])
    c, s = np.cos([Omega, i, omega]), np.sin([Omega, i, omega])
    P = np.array([c[0] * c[2] - s[0] * s[2] * c[1], s[0] * c[2] + c[0] * s[2] * c[1], s[2] * s[1]])
    Q = np.array([-c[0] * s[2] - s[0] * c[2] * c[1], -s[0] * s[2] + c[0] * c[2] * c[1], c[2] * s[1]])
    return plane[0] * P + plane[1] * Q, rates[0] * P + rates[1] * Q


def elements(position: Array, velocity: Array) -> tuple[float, float, float, float, float, float]:
    """Keplerian elements ``a, e, i, Omega, omega, M`` (m, rad) of an elliptic, inclined orbit."""
    position, velocity = finite("position", position, (3,)), finite("velocity", velocity, (3,))
    r, mu = float(np.linalg.norm(position)), GRAVITY_PARAMETER
    h = np.cross(position, velocity)
    node = np.array([-h[1], h[0], 0.0]) / np.hypot(h[0], h[1])
    eccentricity = np.cross(velocity, h) / mu - position / r
    e, a = float(np.linalg.norm(eccentricity)), 1.0 / (2.0 / r - velocity @ velocity / mu)
    side = np.cross(h / np.linalg.norm(h), node)
    omega = np.arctan2(eccentricity @ side, eccentricity @ node)
    nu = np.arctan2(position @ side, position @ node) - omega
    E = np.arctan2(np.sqrt(1.0 - e * e) * np.sin(nu), e + np.cos(nu))
    angles = np.mod([np.arctan2(node[1], node[0]), omega, E - e * np.sin(E)], 2.0 * np.pi).tolist()
    return float(a), e, float(np.arccos(h[2] / np.linalg.norm(h))), *angles


def synthetic(toe: float = 345600.0) -> Broadcast:
    """Broadcast elements of 32 satellites at a reference time, s of BDT; their clocks are right."""
    toe = checks.number("toe", toe)
    rows: dict[int, tuple[float, float, float, float, float, float]] = {}
    for number, (longitude, i, Omega) in GEOSTATIONARY.items():
        angles = np.radians([i, Omega, 30.0, longitude - Omega - 30.0]).tolist()
        # Elements that refer to the tilted plane, in which the orbit is never flat.
        rows[number] = elements(*(tilted(v, TILT) for v in kepler(SYNCHRONOUS_M, 3e-4, *angles)))
    for k, number in enumerate(INCLINED):
        angles = np.radians([55.0, 118.0 + 120.0 * k - 95.0, 190.0, 95.0 - 120.0 * k - 190.0]).tolist()
        rows[number] = (SYNCHRONOUS_M, 0.002, *angles)
    for k, number in enumerate(MEDIUM):
        plane, slot = divmod(k, 8)
        angles = np.radians([55.0, 30.0 + 120.0 * plane, 40.0, 45.0 * slot + 15.0 * plane + 10.0 - 40.0]).tolist()
        rows[number] = (MEDIUM_M, 5e-4, *angles)
    a, e, i, Omega, omega, M = np.array(list(rows.values())).T
    zeros = {field.name: np.zeros(len(rows)) for field in fields(Broadcast)}
    when = np.full(len(rows), toe)
    given = {"number": np.array(list(rows), float), "toe": when, "toc": when, "sqrt_a": np.sqrt(a), "e": e, "i0": i,
             "Omega0": Omega + ROTATION_RATE * np.mod(toe, 604800.0), "omega": omega, "M0": M}  # fmt: skip
    return Broadcast(**(zeros | given))
