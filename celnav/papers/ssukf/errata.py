"""What the paper prints or says where it is wrong: the list, and as code what is needed to show it."""

from __future__ import annotations

import numpy as np

from celnav.gaussian import attitude
from celnav.papers.ssukf.config import Config

ERRATA = (
    ("lambda = alpha^2 (n + kappa) - n with 2 n + m points to each side", "L in place of n; L = 15, 12 or 9"),
    ("dimension 2 n + m, 4 n + 2 m + 1 points", "n + n_w + m and 2 (n + n_w + m) + 1; the same here because n_w = n = 6"),
    (
        '"about 1/3" less time, "SUKF with UKF"',
        "29.0 % fewer points at 1:1, 20.1 % at 25:1; an ordinary UKF has 26, fewer still",
    ),
    ('"SUKF converges faster" (Fig. 3)', "at equal spread both filters are the same, point by point"),
    ("10 deg of yaw as a large initial error", "the first star quaternion fixes the attitude, from any error"),
    (
        "all 2 n + m components are drawn anew before the update",
        "12 of the 31 points of the update and 6 of the 31 of the prediction are copies of the center",
    ),
    ('"early UKF ignores noise"', "it adds Q and R; with these noises to the same effect"),
    ("MRP with (a, b)", "generalized Rodrigues parameters; the MRP only for a = 1. The values are not given"),
    ("total attitude in MRP", "singular at 360 deg: needs the switch to the shadow set"),
    ("orbital rate 0.001 rad/s at 800 km", "1.0381e-3 rad/s"),
    ("0.5 deg/h white, 0.02 deg/h driving", "have no bandwidth; the readings settle between 0.9 and 14 arcsec (table 2)"),
    (
        "references 6 and 7 in the introduction; 1: vol. 63; 5 as second-order EKF",
        "interchanged; vol. 26, no. 2; super-iterated",
    ),
    ("initial errors 1, 2, 10 deg", "Euler angles; as a rotation vector 0.823, 2.082, 9.981 deg"),
)
"""What is printed and what is right, in the order of their numbers (from 1)."""
RADIUS_M, MU = 6378.137e3 + 800e3, 3.986004418e14


def printed_spread(L: int, alpha: float, n: int = 6) -> float:
    """``c = L + lambda`` with the printed ``lambda = alpha^2 n - n`` (kappa = 0), which should have L where it has n."""
    return L - n + alpha**2 * n


def orbit_rate() -> float:
    """Rate of a circular orbit at 800 km, rad/s."""
    return float(np.sqrt(MU / RADIUS_M**3))


def rotation_vector(config: Config) -> tuple[float, float, float]:
    """The initial Euler angles as a rotation vector, deg."""
    x, y, z = np.degrees(attitude.log(attitude.from_euler(np.radians(config.attitude_deg)))).tolist()
    return x, y, z
