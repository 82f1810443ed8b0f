"""Accelerations of a satellite of the Earth by other bodies. Units: km, km/s^2."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.linalg import Array


def acceleration(position: Array, body: Array, gm: float) -> Array:
    """Acceleration ``(..., 3)`` relative to the Earth's center of a satellite at ``position (..., 3)`` by a ``body (..., 3)``.

    Both geocentric. In Battin's form, which does not subtract two attractions that are nearly the same [Battin 1987, Eq. 8.61].
    """
    away = position - body
    square = np.square(body).sum(-1)[..., None]
    q = ((position * (position - 2.0 * body)).sum(-1)[..., None]) / square
    f = q * (3.0 + q * (3.0 + q)) / (1.0 + (1.0 + q) ** 1.5)
    cube = np.square(away).sum(-1)[..., None] ** 1.5
    return np.asarray(-gm / cube * (position + f * body))
