"""A synthetic constellation: broadcast elements of 32 satellites on two-body orbits.

There are five geostationary satellites, three inclined geosynchronous satellites on one ground
track, and a Walker constellation 24/3/1.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from celnav.gaussian import checks
from celnav.gaussian.linalg import Array
from celnav.models.gnss import (
    GRAVITY_PARAMETER,
    ROTATION_RATE,
    TILT,
    Broadcast,
    eccentric_anomaly,
    tilted,
)
from celnav.models.orbit import Earth, from_elements, to_elements

POINT = Earth(mu=1e-9 * GRAVITY_PARAMETER, j2=0.0)
"""The Earth as a point mass: the orbits are two-body orbits."""
SYNCHRONOUS_M = (GRAVITY_PARAMETER / ROTATION_RATE**2) ** (1.0 / 3.0)
MEDIUM_M = 27906.1e3
GEOSTATIONARY = {
    1: (140.0, 1.2, 40.0),
    2: (80.0, 1.6, 70.0),
    3: (110.5, 1.4, 55.0),
    4: (160.0, 0.9, 100.0),
    5: (58.75, 1.0, 20.0),
}
"""Number -> longitude, inclination, node, deg."""
INCLINED = (38, 39, 40)
MEDIUM = tuple(n for n in range(19, 47) if n not in (31, *INCLINED))
TOE_S = 345600.0


def geostationary(number: int, elapsed_s: float = 0.0) -> Array:
    """State ``(6,)`` km, km/s at ``elapsed_s`` after the reference time. The axes are inertial:
    they coincide with the Earth-fixed axes at the reference time.
    """
    longitude, i, Omega = np.radians(
        GEOSTATIONARY[checks.choice("number", number, GEOSTATIONARY)]
    ).tolist()
    elapsed_s = checks.number("elapsed_s", elapsed_s)
    e, omega = 3e-4, np.radians(30.0)
    E = float(
        eccentric_anomaly(
            np.array(longitude - Omega - omega + ROTATION_RATE * elapsed_s), np.array(e)
        )
    )
    nu = 2.0 * np.arctan(np.sqrt((1.0 + e) / (1.0 - e)) * np.tan(0.5 * E))
    return from_elements(1e-3 * SYNCHRONOUS_M, e, i, Omega, omega, float(nu), POINT)


def synthetic(toe: float = TOE_S) -> Broadcast:
    """Broadcast elements of the 32 satellites at a time (s of BDT), without clock errors."""
    toe = checks.number("toe", toe)
    rows: dict[int, tuple[float, ...]] = {}
    for number in GEOSTATIONARY:
        # Elements with respect to the tilted plane, in which the inclination is never 0.
        state = np.concatenate([tilted(v, TILT) for v in np.split(geostationary(number), 2)])
        a, e, i, Omega, omega, nu = to_elements(state, POINT).tolist()
        E = 2.0 * np.arctan(np.sqrt((1.0 - e) / (1.0 + e)) * np.tan(0.5 * nu))
        rows[number] = (1e3 * a, e, i, Omega, omega, E - e * np.sin(E))
    for k, number in enumerate(INCLINED):
        angles = np.radians(
            [55.0, 118.0 + 120.0 * k - 95.0, 190.0, 95.0 - 120.0 * k - 190.0]
        ).tolist()
        rows[number] = (SYNCHRONOUS_M, 0.002, *angles)
    for k, number in enumerate(MEDIUM):
        plane, slot = divmod(k, 8)
        angles = np.radians(
            [55.0, 30.0 + 120.0 * plane, 40.0, 45.0 * slot + 15.0 * plane + 10.0 - 40.0]
        ).tolist()
        rows[number] = (MEDIUM_M, 5e-4, *angles)
    a, e, i, Omega, omega, M = np.array(list(rows.values())).T
    zeros = {field.name: np.zeros(len(rows)) for field in fields(Broadcast)}
    when = np.full(len(rows), toe)
    elements = {
        "number": np.array(list(rows), float),
        "toe": when,
        "toc": when,
        "sqrt_a": np.sqrt(a),
        "e": e,
        "i0": i,
        "Omega0": Omega + ROTATION_RATE * np.mod(toe, 604800.0),
        "omega": omega,
        "M0": M,
    }
    return Broadcast(**(zeros | elements))
