"""The numbers that the paper prints."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.linalg import Array

TABLE_1_WEIGHTS = ((1,), (2, 1), (2, 1, 1), (2, 2, 1, 1), (2, 2, 1, 1, 1), (2, 2, 2, 1, 1, 1))
TABLE_1 = {"SGHQF": (7, 21, 37, 57, 81, 109), "AASGHQF": (7, 9, 23, 25, 41, 43)}
"""Points for n = 1 to 6, level 3."""
TABLE_3: dict[str, Array] = {
    "UKF": np.array([0.350, 0.367, 0.412, 0.527, 0.609, 18.16, 17.82]),
    "SGHQF": np.array([0.217, 0.203, 0.251, 0.328, 0.397, 16.27, 16.18]),
    "AASGHQF": np.array([0.223, 0.201, 0.256, 0.303, 0.426, 16.00, 16.29]),
}
"""Misalignment (deg), velocity (m/s), longitude and latitude (m)."""
TABLE_4 = {"UKF": (27, 0.0021), "SGHQF": (417, 0.0065), "AASGHQF": (99, 0.0028)}
"""Points, and seconds for a cycle."""
TABLE_2_DEGREE = np.array([9.845, 9.845, 4.635, 1.0, 1.0, 9.639, 9.639, 7e-5, 7e-5, 7e-6, 4e-5, 4e-5, 4e-7])
"""Degree of observability; of drifts and biases the largest and the smallest."""
