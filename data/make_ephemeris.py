"""Make ``ephemeris_2015.npz``: Earth and Sun by four ephemerides at 1753 instants, every 5 h from 2015-10-17 04:00 UTC.

    python data/make_ephemeris.py FOLDER

FOLDER holds the unpacked source packages de405-1997.1, de406-1997.1, de421-2008.1 and de423-2010.1 of the package index. The
table holds DE421 (from these arrays) and the others less DE421, km, barycentric, ICRS axes.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.polynomial.chebyshev import chebval

from celnav.models.ephemeris import from_utc

PACKAGES = {"de405": "1997.1", "de406": "1997.1", "de421": "2008.1", "de423": "2010.1"}


def position(folder, body, date):
    """Position ``(..., 3)`` km of ``"sun"``, ``"earth"`` or ``"moon"`` from a folder of Chebyshev coefficients."""
    table = np.load(folder / "constants.npy")
    constants = {bytes(row["name"]).decode().strip(): float(row["value"]) for row in table}

    def series(name):
        coefficients = np.load(folder / f"jpl-{name}.npy", mmap_mode="r")  # (sets, 3, coefficients)
        sets, first = len(coefficients), constants["jalpha"]
        span = (constants["jomega"] - first) / sets
        # The whole days first: the sum of both parts has lost the digits that a hundredth of a millimeter is about.
        k = np.clip(np.floor(((date.day - first) + date.rest) / span).astype(int), 0, sets - 1)
        u = 2.0 * ((date.day - (first + k * span)) + date.rest) / span - 1.0
        return chebval(u[..., None], np.moveaxis(coefficients[k], -1, 0), tensor=False)

    if body == "sun":
        return series("sun")
    share = 1.0 / (1.0 + constants["EMRAT"]) - (body == "moon")
    return series("earthmoon") - share * series("moon")


def main(folder: str) -> None:
    """Read the packages and write the table beside this script."""
    dates = from_utc("2015-10-17T04:00:00").after(18000.0 * np.arange(1753))
    states = {
        name: {
            body: position(Path(folder) / f"{name}-{version}" / name, body, dates)
            for body in ("earth", "sun")
        }
        for name, version in PACKAGES.items()
    }
    table = {"day": np.asarray(dates.day), "rest": np.asarray(dates.rest)}
    for body in ("earth", "sun"):
        table[f"de421/{body}"] = states["de421"][body]
        for name in ("de405", "de406", "de423"):
            table[f"{name}-de421/{body}"] = states[name][body] - states["de421"][body]
    np.savez(Path(__file__).with_name("ephemeris_2015.npz"), allow_pickle=False, **table)


if __name__ == "__main__":
    main(sys.argv[1])
