"""The satellites that the study simulates."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from scipy.spatial.transform import Rotation

from celnav.gaussian.checks import number
from celnav.models.beidou import GRAVITY_PARAMETER, ROTATION_RATE, TILT, WEEK_S, Broadcast

SYNCHRONOUS_M = (GRAVITY_PARAMETER / ROTATION_RATE**2) ** (1.0 / 3.0)


def synthetic(toe: float = 345600.0) -> Broadcast:
    """Broadcast elements of 32 satellites at a reference time, s of BDT, to try things with; their clocks are right.

    Five geostationary, three inclined geosynchronous on one ground track, and a Walker constellation 24/3/1 [Fan2015, chosen].
    """
    toe = number("toe", toe)
    rows: dict[int, tuple[float, ...]] = {}
    # Number: longitude, inclination, node. Their elements refer to the tilted plane, in which the orbit is never flat.
    over = {1: (140.0, 1.2, 40.0), 2: (80.0, 1.6, 70.0), 3: (110.5, 1.4, 55.0), 4: (160.0, 0.9, 100.0), 5: (58.75, 1.0, 20.0)}
    for C, (longitude, i, Omega) in over.items():
        tilted = Rotation.from_euler("x", -TILT) * Rotation.from_euler("ZXZ", [Omega, i, 30.0], degrees=True)
        rows[C] = (SYNCHRONOUS_M, 3e-4, *(tilted.as_euler("ZXZ", degrees=True) % 360.0), (longitude - Omega - 30.0) % 360.0)
    for k, C in enumerate((38, 39, 40)):
        rows[C] = (SYNCHRONOUS_M, 0.002, 118.0 + 120.0 * k - 95.0, 55.0, 190.0, 95.0 - 120.0 * k - 190.0)
    for k, C in enumerate(C for C in range(19, 47) if C not in (31, 38, 39, 40)):
        plane, slot = divmod(k, 8)
        rows[C] = (27906.1e3, 5e-4, 30.0 + 120.0 * plane, 55.0, 40.0, 45.0 * slot + 15.0 * plane + 10.0 - 40.0)
    a, e, *angles = np.transpose(list(rows.values()))
    Omega0, i0, omega, M0 = np.radians(angles)
    elements = {field.name: np.zeros(len(rows)) for field in fields(Broadcast)} | {
        "number": np.array(list(rows), float), "sqrt_a": np.sqrt(a), "e": e, "i0": i0, "omega": omega, "M0": M0,
        "Omega0": Omega0 + ROTATION_RATE * np.mod(toe, WEEK_S), "toe": np.full(len(rows), toe), "toc": np.full(len(rows), toe),
    }  # fmt: skip
    return Broadcast(**elements)
