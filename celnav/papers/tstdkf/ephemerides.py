"""How far ephemerides are apart: the table behind Fig. 2, and DE421 as it is installed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from celnav.files import data, read_npz
from celnav.gaussian.linalg import Array
from celnav.models.ephemeris import Tdb, de421


@dataclass(frozen=True)
class Table:
    """``data/ephemeris_2015.npz``: 1753 instants, every 5 h from the start of the paper's year. Positions in km.

    Attributes
    ----------
    dates: the instants. de421: body -> ``(T, 3)`` of "earth" and "sun". less_de421: ephemeris -> body -> its difference.
    apart: km, how far the installed DE421 is from this one at most.
    """

    dates: Tdb
    de421: dict[str, Array]
    less_de421: dict[str, dict[str, Array]]
    apart: float


@cache
def table() -> Table:
    """The table, checked against the installed DE421.

    Raises
    ------
    ValueError: if the two DE421 are not the same.
    """
    path = data("ephemeris_2015.npz")
    stored = read_npz(path)
    dates = Tdb(float(stored["day"]), stored["rest"])
    bodies = ("earth", "sun")
    ours = {body: stored[f"de421/{body}"] for body in bodies}
    apart = float(max(np.abs(de421().state(body, dates).position - ours[body]).max() for body in bodies))
    if apart > 1e-6:
        raise ValueError(f"{path}: expected the DE421 that is installed, got one that differs by {apart:.3g} km")
    names = ("de405", "de406", "de423")
    return Table(dates, ours, {name: {body: stored[f"{name}-de421/{body}"] for body in bodies} for name in names}, apart)
