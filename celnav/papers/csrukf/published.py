"""The numbers that the paper prints: RMSE of x, y, z (km) and v_x, v_y, v_z (m/s)."""

from __future__ import annotations

import numpy as np

from celnav.gaussian.linalg import Array

TABLE_1: dict[str, Array] = {
    "SRUKF": np.array([0.0355, 0.0321, 0.0356, 0.0338, 0.0343, 0.0384]),
    "CSRUKF": np.array([0.0340, 0.0356, 0.0363, 0.0382, 0.0349, 0.0359]),
}
"""Phi = 0."""
TABLE_2: dict[str, Array] = {
    "SRUKF": np.array([2.7618, 5.4616, 3.7964, 1.3072, 2.4412, 2.6518]),
    "CSRUKF": np.array([0.4071, 0.1994, 0.1565, 0.2672, 0.2743, 0.1969]),
}
"""Phi = I."""
TABLE_3: dict[str, dict[str, Array]] = {
    "0.8": {
        "SRUKF": np.array([17.346, 19.323, 18.184, 5.6096, 5.2659, 5.0236]),
        "CSRUKF": np.array([0.4218, 0.2694, 0.6928, 0.3623, 0.3979, 0.4783]),
    },
    "I": {
        "SRUKF": np.array([40.373, 34.767, 31.659, 10.281, 10.479, 11.694]),
        "CSRUKF": np.array([0.6935, 0.5870, 0.9375, 0.8720, 0.6347, 0.6273]),
    },
}
"""Phi = 0.8 I and Phi = I."""
